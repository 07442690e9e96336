"""The command line in a process of its own, and waiting with a limit."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO

import psutil

ROOT = Path(__file__).parents[2]
LIMIT = 120.0  # s; a command that compiles takes 15 s on an idle machine
SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


def start(folder: Path, *arguments: str, first: str = "", stdout: IO[str] | int = subprocess.PIPE) -> subprocess.Popen:
    """Start ``gtau`` in a session of its own, after what is to be done ``first`` in its process."""
    code = f"{first}\nimport sys; from gtau.cli import main; sys.argv[0] = 'gtau'; main()"
    return start_python(folder, "-c", code, *arguments, stdout=stdout)


def start_python(folder: Path, *arguments: str, stdout: IO[str] | int = subprocess.PIPE) -> subprocess.Popen:
    """Start Python with gtau and the tests' support modules, in a session of its own."""
    path = os.pathsep.join(str(ROOT / part) for part in ("src", "tests/support"))
    return subprocess.Popen(
        [sys.executable, *arguments],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": path},
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=_hear_signals if os.name == "posix" else None,
    )


def _hear_signals() -> None:
    """Let a program begun by tests hear signals that the tests ignore, as they do in the background of a shell."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_DFL)


def wait_until(condition: Callable[[], bool], process: subprocess.Popen | None = None, limit: float = LIMIT) -> None:
    """Wait for a condition; fail after ``limit`` seconds, or where ``process`` ends before."""
    deadline = time.monotonic() + limit
    while not condition():
        if process is not None and process.poll() is not None:
            raise AssertionError(f"the program ended early: {process.communicate()}")
        if time.monotonic() > deadline:
            if process is not None:
                process.kill()
            raise AssertionError(f"still waiting after {limit:.0f} s")
        time.sleep(0.02)


def work_of(process: subprocess.Popen) -> float:
    """Seconds of processor time that a program has taken: other programs do not make it longer."""
    try:
        return sum(psutil.Process(process.pid).cpu_times()[:2])
    except (psutil.NoSuchProcess, psutil.ZombieProcess):
        return math.inf


def has_ended(process: psutil.Process) -> bool:
    """Whether a process has ended; one that nobody has collected yet, too."""
    try:
        return not process.is_running() or process.status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True
