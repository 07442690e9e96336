"""The command line: parse, call, print."""

from __future__ import annotations

import errno
import gc
import os
import sys

from gtau.cli.interruption import exit_code, interrupted, listen, report_ending

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)


def main() -> None:
    """Run the command line. Refusals, bad options included, print one sentence to stderr and exit with code 2.

    Other exit codes: 0 finished, 1 a fault of gtau itself, 3 finished, but the result needs attention, 128 + signal
    after Ctrl-C (130), SIGHUP (129) or SIGTERM (143).
    """
    gc.set_threshold(200_000)  # imports create many objects and no garbage: collections took a fifth of their time
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # in SciPy's too, loaded later: threads wait for each other
    listen()
    try:
        code = _run()
        if code == 130 and interrupted():  # as typer returns if interrupted outside of the commands
            raise KeyboardInterrupt
    except KeyboardInterrupt as interruption:
        report_ending(str(interruption))
        code = exit_code()
    gc.freeze()  # else the interpreter searches everything for garbage before it ends, which takes 0.5 s
    sys.exit(code)


def _run() -> int:
    import typer

    from gtau.cli.commands import app
    from gtau.cli.console import refused

    if len(sys.argv) < 2:
        app()
    as_json = "--json" in sys.argv
    usage_error: type[Exception] = typer.BadParameter.__mro__[1]  # of typer's own click or the installed one
    try:
        code = app(standalone_mode=False)
    except typer.Abort:  # Ctrl-C in click
        raise KeyboardInterrupt from None
    except usage_error as error:
        message = error.format_message().replace("Value error, ", "").rstrip(".")  # type: ignore[attr-defined]
        stop = "" if message.endswith("?") else "."
        context = getattr(error, "ctx", None)
        command = "gtau" if context is None else context.command_path
        return refused(f"{message}{stop} See '{command} --help'.", as_json).exit_code
    except Exception as error:
        if interrupted():
            raise KeyboardInterrupt from None
        if "GTAU_DEBUG" in os.environ:
            raise
        if isinstance(error, MemoryError):
            return refused("out of memory; give shorter logs, or more memory.", as_json).exit_code
        if isinstance(error, OSError) and (error.filename or error.errno in FULL):
            where = error.filename or "the output"  # without a name it is stdout
            deed = "written ({}); free some space" if error.errno in FULL else "opened ({}); check the path"
            return refused(f"{where} cannot be {deed.format(error.strerror)}.", as_json).exit_code
        bug = f"this is a bug in gtau ({type(error).__name__}: {error}); report it with the output of GTAU_DEBUG=1."
        refused(bug, as_json)
        return 1
    return code if isinstance(code, int) else 0
