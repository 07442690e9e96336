"""Handle Ctrl-C, SIGTERM and SIGHUP alike: one sentence and exit code 128 + signal, within two seconds.

The first one raises KeyboardInterrupt, so that unfinished files are removed and child processes ended. Compilers and
solvers that call back into Python swallow that exception, or report it as a traceback; so a thread ends the program
where it still runs after :data:`GRACE`, and so does a second Ctrl-C. Worker processes notice the end by themselves.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

GRACE = 1.5  # s to clean up; removing an unfinished file takes milliseconds, ending eight worker processes 0.3 s
UNFINISHED = "unfinished files were not written"

_said = threading.Lock()  # held by whoever reports the interruption
_received: list[int] = []  # the signal that interrupts the program
_searches: list[tuple[threading.Event, str]] = []  # what can stop with a result: its request, and the hint at Ctrl-C


def interrupted() -> bool:
    """Return whether a signal has interrupted the program; what fails afterwards fails because of it."""
    return bool(_received)


def exit_code() -> int:
    """Return the exit code of the interrupted program, as shells have it: 128 + signal, 130 for Ctrl-C."""
    return 128 + (_received or [signal.SIGINT])[0]


def listen() -> None:
    """Let Ctrl-C, SIGTERM and SIGHUP end this program as described above."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # Windows has no SIGHUP
        if number and signal.getsignal(number) is not signal.SIG_IGN:  # as in the background of a shell, under nohup
            signal.signal(number, _interrupt)
    sys.unraisablehook = _without_interruptions


def _interrupt(number: int, frame: FrameType | None) -> None:
    request, hint = _searches[-1] if _searches else (None, "")
    if request is not None and hint and number == signal.SIGINT and not request.is_set():
        request.set()
        print(f"gtau: {hint}", file=sys.stderr, flush=True)
    elif number == signal.SIGINT and (hint or interrupted()):
        _end()
    elif not interrupted():  # a terminal that closes sends SIGHUP twice, once by its shell
        _received.append(number)
        insist = threading.Timer(GRACE, _end)
        insist.daemon = True
        insist.start()
        if request is None:
            raise KeyboardInterrupt
        request.set()  # an exception would be lost in the solver, which reports it and goes on


def _end() -> None:
    """End the program at once."""
    report()
    os._exit(exit_code())


def begin() -> None:
    """Forget earlier interruptions: one process may run several commands, as notebooks and tests do."""
    _received.clear()
    if _said.locked():
        _said.release()


def report(finished: str = "") -> None:
    """Say once that the program was interrupted, and what has become of its files; with ``--json`` on stdout too."""
    if not _said.acquire(blocking=False):
        return
    sentence = f"interrupted; {finished or UNFINISHED}."
    with suppress(OSError):  # the terminal may be gone: SIGHUP
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

    For a search that has something to show for what it has done so far. SIGTERM and SIGHUP are such requests without a
    hint, after which the program ends; so is Ctrl-C where the ``hint`` is empty.
    """
    request = threading.Event()
    _searches.append((request, hint))
    try:
        yield request.is_set
        if interrupted():
            raise KeyboardInterrupt
    finally:
        _searches.pop()
