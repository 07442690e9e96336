"""Ending the program: Ctrl-C, SIGTERM and SIGHUP leave a sentence, and no signal leaves worker processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import psutil
import pytest
from five_bar_logs import DESIGN
from programs import LIMIT, has_ended, start, wait_until, work_of

from gtau.documents.files import hold_folder, write_atomically

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")

SLOW = "import gtau.fleets.fleet, process_functions; gtau.fleets.fleet.identify_member = process_functions.slow_member"
USUAL = [("SIGINT", True), ("SIGKILL", False)]
ENDINGS = [(name, group) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGKILL") for group in (False, True)]
FINISHED = "gtau: interrupted; finished robots stay in out/models, and the same command continues with the others.\n"


@contextmanager
def working_fleet(folder: Path, *options: str) -> Iterator[tuple[subprocess.Popen, list[psutil.Process]]]:
    """Start ``gtau fleet`` on robots that take minutes; the program and its descendants once two are begun."""
    for name in map(str, range(8)):  # more than two workers are handed at once
        (folder / name).mkdir()
        (folder / name / "experiment.yaml").touch()
    process = start(folder, "fleet", "*/experiment.yaml", "--out", "out", *options, first=SLOW)
    descendants: list[psutil.Process] = []
    try:
        wait_until(lambda: len(list(folder.glob("*/*.begun"))) >= 2, process)
        descendants = psutil.Process(process.pid).children(recursive=True)
        workers = {int(sign.stem) for sign in folder.glob("*/*.begun")}
        assert workers <= {each.pid for each in descendants}
        yield process, descendants
    finally:
        for each in (*descendants, process):
            if not has_ended(each) if isinstance(each, psutil.Process) else each.poll() is None:
                each.kill()


@pytest.mark.parametrize(
    ("name", "whole_group"),
    [end if end in USUAL else pytest.param(*end, marks=pytest.mark.slow) for end in ENDINGS],
)
def test_workers_end_with_the_program(tmp_path: Path, name: str, whole_group: bool) -> None:
    """A supervisor or a terminal that closes signals the whole group, ``kill`` the program alone."""
    number = signal.Signals[name]
    with working_fleet(tmp_path, "--jobs", "2") as (process, descendants):
        (os.killpg if whole_group else os.kill)(process.pid, number)
        process.wait(LIMIT)
        wait_until(lambda: all(map(has_ended, descendants)), limit=LIMIT)
        stdout, stderr = process.communicate(timeout=LIMIT)
    killed = name == "SIGKILL"
    assert process.returncode == (-number if killed else 128 + number)
    assert killed or (stdout, stderr) == ("", FINISHED)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP", "SIGKILL"])
def test_dask_workers_end_with_the_program(tmp_path: Path, name: str) -> None:
    pytest.importorskip("distributed")
    number = signal.Signals[name]
    with working_fleet(tmp_path, "--dask", "local") as (process, descendants):
        process.send_signal(number)
        process.wait(LIMIT)
        wait_until(lambda: all(map(has_ended, descendants)), limit=LIMIT)
        _, stderr = process.communicate(timeout=LIMIT)
    killed = name == "SIGKILL"
    assert process.returncode == (-number if killed else 128 + number)
    assert killed or stderr.startswith("gtau: interrupted; ")


@pytest.mark.parametrize("name", ["SIGTERM", pytest.param("SIGHUP", marks=pytest.mark.slow)])
def test_a_search_ends_without_a_word_of_its_solver(tmp_path: Path, name: str) -> None:
    """IPOPT reports an exception of its callbacks and goes on with the search."""
    (tmp_path / "design.yaml").write_text(DESIGN)
    process = start(tmp_path, "excite", "design.yaml", "--out", "plan", "--starts", "1000")
    wait_until((tmp_path / "plan" / "trajectory.csv").exists, process)
    begun = work_of(process)
    wait_until(lambda: work_of(process) > begun + 1.0)  # into a search
    process.send_signal(signal.Signals[name])
    stdout, stderr = process.communicate(timeout=LIMIT)
    assert process.returncode == 128 + signal.Signals[name]
    said = [line for line in stderr.splitlines() if not line.startswith("gtau: searching,")]
    assert (stdout, said) == ("", ["gtau: interrupted; unfinished files were not written."])
    assert [path.name for path in (tmp_path / "plan").iterdir()] == ["trajectory.csv"]


SEARCHING = """
import pathlib, gtau.excitation.design as d
solve = d.solve
d.solve = lambda *them: pathlib.Path("searching").touch() or solve(*them)
"""


def test_a_stopped_search_leaves_an_older_design_whole(tmp_path: Path) -> None:
    (tmp_path / "design.yaml").write_text(DESIGN)
    (tmp_path / "plan").mkdir()
    names = ("design.json", "report.html", "trajectory.csv")
    for name in names:
        (tmp_path / "plan" / name).write_text("older")
    process = start(tmp_path, "excite", "design.yaml", "--out", "plan", "--starts", "1000", first=SEARCHING)
    wait_until((tmp_path / "searching").exists, process)
    process.send_signal(signal.SIGTERM)
    _, stderr = process.communicate(timeout=LIMIT)
    assert stderr == "gtau: interrupted; unfinished files were not written.\n"
    assert {path.name: path.read_text() for path in (tmp_path / "plan").iterdir()} == dict.fromkeys(names, "older")


def test_ctrl_c_ends_the_search_of_a_campaign_without_a_word_of_its_solver(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "temporary").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    process = start(tmp_path, "campaign", "c", "--robot", "five-bar", "--payload-mass", "1", first=SEARCHING)
    wait_until((tmp_path / "searching").exists, process)
    time.sleep(0.2)  # into a search, which takes about a second
    process.send_signal(signal.SIGINT)
    stdout, stderr = process.communicate(timeout=LIMIT)
    assert process.returncode == 130
    said = [line for line in stderr.splitlines() if not line.startswith("gtau: searching,")]
    assert (stdout, said) == ("", ["gtau: interrupted; unfinished files were not written."])
    assert not list((tmp_path / "temporary").iterdir())


def test_two_commands_do_not_write_into_one_folder(tmp_path: Path) -> None:
    release = hold_folder(tmp_path / "a" / "b")
    process = start(tmp_path, "identify", "experiment.yaml", "--out", "a/b")
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == 2
    assert stderr == "gtau: another command is writing to a/b; wait for its end, or choose another one.\n"
    release()
    assert not list(tmp_path.iterdir())
    hold_folder(tmp_path / "a")()


def test_an_interruption_at_any_line_leaves_no_unfinished_file(tmp_path: Path) -> None:
    """The exception of a signal is raised between two lines, whichever."""
    for number in range(1, 100):
        lines = 0

        def interrupt(frame: FrameType, event: str, argument: object) -> Any:
            nonlocal lines
            if frame.f_code is not write_atomically.__code__:
                return None
            lines += event == "line"
            if lines == number:  # noqa: B023
                sys.settrace(None)
                raise KeyboardInterrupt
            return interrupt

        before = sys.gettrace()
        sys.settrace(interrupt)
        try:
            write_atomically(tmp_path / "file", "content")
        except KeyboardInterrupt:
            assert {path.name for path in tmp_path.iterdir()} <= {"file"}
        else:
            break
        finally:
            sys.settrace(before)
    assert number > 5
