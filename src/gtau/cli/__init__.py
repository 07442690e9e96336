"""The command line: parse, call, print."""

from __future__ import annotations

import errno
import gc
import os
import sys

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)


def main() -> None:
    """Run the command line; what it refuses, wrong options too, is one sentence on stderr and exit code 2.

    The other exit codes: 0 done, 1 a fault of gtau itself, 3 done but not to be believed, 128 + signal where
    Ctrl-C (130), SIGHUP (129) or SIGTERM (143) ended it.
    """
    gc.set_threshold(50_000)  # imports make many objects and no garbage: collections took a fifth of their time
    try:
        from gtau.cli.interruption import exit_code, interrupted, listen, report

        listen()
        try:
            code = _run()
            if code == 130 and interrupted():  # typer makes this of an interruption outside of the commands
                raise KeyboardInterrupt
        except KeyboardInterrupt as interruption:
            report(str(interruption))
            code = exit_code()
    except KeyboardInterrupt:  # while the lines above are still being imported
        print("gtau: interrupted; unfinished files were not written.", file=sys.stderr)
        code = 130
    sys.exit(code)


def _run() -> int:
    import typer

    from gtau.cli.commands import app
    from gtau.cli.console import refused
    from gtau.cli.interruption import interrupted

    if len(sys.argv) < 2:
        app()
    usage_error: type[Exception] = typer.BadParameter.__mro__[1]  # of the click that typer brings or finds
    try:
        code = app(standalone_mode=False)
    except typer.Abort:  # what click makes of Ctrl-C
        raise KeyboardInterrupt from None
    except usage_error as error:
        message = error.format_message().replace("Value error, ", "").rstrip(".")  # type: ignore[attr-defined]
        stop = "" if message.endswith("?") else "."
        context = getattr(error, "ctx", None)
        command = "gtau" if context is None else context.command_path
        return refused(f"{message}{stop} See '{command} --help'.", "--json" in sys.argv).exit_code
    except Exception as error:
        if interrupted():
            raise KeyboardInterrupt from None
        if "GTAU_DEBUG" in os.environ:
            raise
        if isinstance(error, MemoryError):
            typer.echo("gtau: the memory does not suffice; give shorter logs, or more memory.", err=True)
            return 2
        if isinstance(error, OSError) and (error.filename or error.errno in FULL):
            where = error.filename or "the output"  # without a name it is what was printed
            deed = "written ({}); free some space" if error.errno in FULL else "opened ({}); check the path"
            typer.echo(f"gtau: {where} cannot be {deed.format(error.strerror)}.", err=True)
            return 2
        bug = f"this is a bug in gtau ({type(error).__name__}: {error}); report it with the output of GTAU_DEBUG=1."
        typer.echo(f"gtau: {bug}", err=True)
        return 1
    return code if isinstance(code, int) else 0
