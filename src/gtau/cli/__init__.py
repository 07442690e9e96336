"""The command line: parses, calls, prints."""

from __future__ import annotations

import os
import sys


def main() -> None:
    """Run the command line; what it refuses, wrong options too, is one sentence on stderr and exit code 2.

    The other exit codes: 0 done, 1 a fault of gtau itself, 3 done but no drive gain can be believed, 130 interrupted.
    """
    try:
        sys.exit(_run())
    except KeyboardInterrupt:  # before a command has begun: while Python is still importing
        print("gtau: interrupted; nothing has been written.", file=sys.stderr)
        sys.exit(130)


def _run() -> int:
    import typer

    from gtau.cli.commands import app
    from gtau.cli.console import refused

    if len(sys.argv) < 2:
        app()
    usage_error: type[Exception] = typer.BadParameter.__mro__[1]  # of the click that typer brings or finds
    try:
        code = app(standalone_mode=False)
    except typer.Abort:
        return 130
    except usage_error as error:
        message = error.format_message().replace("Value error, ", "").rstrip(".")  # type: ignore[attr-defined]
        stop = "" if message.endswith("?") else "."
        return refused(f"{message}{stop} See 'gtau --help'.", "--json" in sys.argv).exit_code
    except Exception as error:
        if "GTAU_DEBUG" in os.environ:
            raise
        typer.echo(
            f"gtau: this should not have happened ({type(error).__name__}: {error}); please report it with what "
            "GTAU_DEBUG=1 shows.",
            err=True,
        )
        return 1
    return code if isinstance(code, int) else 0
