"""Ctrl-C, in one way for all commands: one sentence and exit code 130, within two seconds, wherever it arrives.

The first one raises KeyboardInterrupt, so that unfinished files are removed and child processes ended. Compilers and
solvers that call back into Python swallow that exception, or report it as a traceback; so a thread ends the program
where it still runs after :data:`GRACE`, and so does a second Ctrl-C.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

GRACE = 1.5  # s to clean up; removing an unfinished file takes milliseconds, ending eight worker processes 0.3 s
CODE = 130  # 128 + SIGINT, as shells have it
UNFINISHED = "unfinished files were not written"

_said = threading.Lock()  # held by whoever reports the interruption
_pressed = threading.Event()


def pressed() -> bool:
    """Return whether Ctrl-C has been pressed; what fails afterwards fails because of it."""
    return _pressed.is_set()


def listen() -> None:
    """Let Ctrl-C end this program as described above."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # begun in the background by a shell
        return
    signal.signal(signal.SIGINT, _interrupt)
    sys.unraisablehook = _without_interruptions


def _interrupt(number: int, frame: FrameType | None) -> None:
    _pressed.set()
    signal.signal(signal.SIGINT, lambda number, frame: _end())
    threading.Thread(target=_insist, daemon=True).start()
    raise KeyboardInterrupt


def _insist() -> None:
    time.sleep(GRACE)
    _end()


def _end() -> None:
    """End the program at once, and the processes that it started."""
    report(UNFINISHED)
    if "multiprocessing" in sys.modules:
        from multiprocessing import active_children

        for child in active_children():
            child.terminate()
    os._exit(CODE)


def begin() -> None:
    """Forget earlier interruptions: one process may run several commands, as notebooks and tests do."""
    _pressed.clear()
    if _said.locked():
        _said.release()


def report(finished: str) -> None:
    """Say once that the program was interrupted, and what has become of its files; with ``--json`` on stdout too."""
    if not _said.acquire(blocking=False):
        return
    sentence = f"interrupted; {finished}."
    if sys.stderr.isatty():
        sys.stderr.write("\r\x1b[2K\x1b[?25h")  # an unfinished progress bar, and the cursor that it hides
    print(f"gtau: {sentence}", file=sys.stderr, flush=True)
    if "--json" in sys.argv:
        import json

        print(json.dumps({"error": sentence}, indent=1), flush=True)


def _without_interruptions(unraisable: Any) -> None:
    """Report what Python cannot raise, but no interruption that a callback swallowed."""
    if not issubclass(unraisable.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(unraisable)


@contextmanager
def stop_request(hint: str) -> Iterator[Callable[[], bool]]:
    """Print ``hint`` at the first Ctrl-C, a request that the yielded function reports; the second ends the program.

    For a search that has something to show for what it has done so far.
    """
    before = signal.getsignal(signal.SIGINT)
    pressed = threading.Event()

    def request(number: int, frame: FrameType | None) -> None:
        pressed.set()
        signal.signal(signal.SIGINT, lambda number, frame: _end())
        print(f"gtau: {hint}", file=sys.stderr, flush=True)

    if before is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, request)
    try:
        yield pressed.is_set
    finally:
        signal.signal(signal.SIGINT, before)
