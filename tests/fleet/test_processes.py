"""Work in processes of this machine, some of which die."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from process_functions import fragile, limits, square
from programs import start_python, wait_until

from gtau.fleet.processes import process_map


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_item_once(jobs: int) -> None:
    assert sorted(process_map(square, range(12), jobs)) == [(k, k * k) for k in range(12)]


def test_an_item_that_kills_its_process_is_reported_and_the_others_are_done() -> None:
    found = dict(process_map(fragile, range(8), 2))
    assert "died" in str(found.pop(3))
    assert found == {k: k * k for k in range(8) if k != 3}


def test_a_process_has_one_thread() -> None:
    assert dict(process_map(limits, range(2), 2)) == {0: "1", 1: "1"}


def test_ctrl_c_ends_all_processes_at_once_and_without_a_word(tmp_path: Path) -> None:
    code = """
import sys, pathlib
from gtau.fleet.processes import process_map
from process_functions import slow
if __name__ == "__main__":
    try:
        list(process_map(slow, [pathlib.Path(sys.argv[1]) / str(k) for k in range(4)], 2))
    except KeyboardInterrupt:
        sys.exit(130)
"""
    (tmp_path / "main.py").write_text(code)
    process = start_python(tmp_path, "main.py", str(tmp_path))
    wait_until(lambda: len(list(tmp_path.glob("[0-9]"))) == 2, process)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: all of them
    assert process.communicate(timeout=20) == ("", "")
    assert process.returncode == 130
