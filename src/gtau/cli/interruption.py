"""Interruptions: Ctrl-C, SIGTERM and SIGHUP alike give one sentence and exit code 128 + signal, within two seconds.

The first signal raises KeyboardInterrupt, so that unfinished files are removed and child processes ended. Compilers
and solvers that call back into Python swallow this exception or report it as a traceback; therefore a thread ends the
program after :data:`GRACE`, as does a second Ctrl-C. Worker processes end by themselves.
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

_said = threading.Lock()  # held once the interruption is reported
_received: list[int] = []  # the signal that interrupts the program
_searches: list[tuple[threading.Event, str]] = []  # of each search with a usable result: stop request, hint at Ctrl-C


def interrupted() -> bool:
    """Return whether a signal has interrupted the program, which then causes all later failures."""
    return bool(_received)


def exit_code() -> int:
    """Return the exit code of the interrupted program by the shells' rule: 128 + signal, 130 for Ctrl-C."""
    return 128 + (_received or [signal.SIGINT])[0]


def listen() -> None:
    """Install the handlers of Ctrl-C, SIGTERM and SIGHUP."""
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
    report_ending()
    os._exit(exit_code())


def begin() -> None:
    """Forget earlier interruptions: one process may run several commands, as notebooks and tests do."""
    _received.clear()
    if _said.locked():
        _said.release()


def report_ending(finished: str = "") -> None:
    """Report once that the program was interrupted and which files it left, with ``--json`` also on stdout."""
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
    """Report unraisable exceptions, except interruptions that a callback swallowed."""
    if not issubclass(unraisable.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(unraisable)


@contextmanager
def stop_request(hint: str) -> Iterator[Callable[[], bool]]:
    """Make the first Ctrl-C print ``hint`` and request a stop, as the yielded function reports; the second ends all.

    For a search with a usable intermediate result. SIGTERM and SIGHUP, and Ctrl-C without a ``hint``, request a stop
    after which the program ends.
    """
    request = threading.Event()
    _searches.append((request, hint))
    try:
        yield request.is_set
        if interrupted():
            raise KeyboardInterrupt
    finally:
        _searches.pop()
