"""Work in processes of this machine, some of which die."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from process_functions import fragile, limits, square
from programs import LIMIT, start_python, wait_until

from gtau.fleets.workers import processes


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_item_once(jobs: int) -> None:
    with processes(jobs) as mapper:
        assert sorted(mapper(square, range(12))) == [(k, k * k) for k in range(12)]


def test_an_item_that_kills_its_process_is_reported_and_the_others_are_done() -> None:
    with processes(2) as mapper:
        results = dict(mapper(fragile, range(8)))
    assert "died" in str(results.pop(3))
    assert results == {k: k * k for k in range(8) if k != 3}


def test_a_process_has_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GTAU_THREADS", raising=False)
    with processes(2) as mapper:
        assert dict(mapper(limits, range(2))) == {0: "1", 1: "1"}


def test_ctrl_c_ends_all_processes_at_once_and_without_a_word(tmp_path: Path) -> None:
    code = """
import sys, pathlib
from gtau.fleets.workers import processes
from process_functions import slow
if __name__ == "__main__":
    try:
        with processes(2) as mapper:
            list(mapper(slow, [pathlib.Path(sys.argv[1]) / str(k) for k in range(4)]))
    except KeyboardInterrupt:
        sys.exit(130)
"""
    (tmp_path / "main.py").write_text(code)
    process = start_python(tmp_path, "main.py", str(tmp_path))
    wait_until(lambda: len(list(tmp_path.glob("[0-9]"))) == 2, process)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: all of them
    assert process.communicate(timeout=LIMIT) == ("", "")
    assert process.returncode == 130
