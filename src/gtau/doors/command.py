"""Run a command of gtau in a project's folder: pages and agents get the answers and sentences of the command line."""

from __future__ import annotations

import asyncio
import json
import os
import re
import sys
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gtau.errors import GtauError

STAGE = re.compile(r"gtau: (.+), \d+ s$")  # a line of progress
EVERY = "0.4"  # s between lines of progress
LONGEST = 1 << 26  # bytes of a document


@dataclass(frozen=True)
class Answer:
    """Answer of a command: its exit code, the document that ``--json`` prints, and what it said besides."""

    code: int
    document: Any
    said: str

    @property
    def refusal(self) -> str:
        """The sentence with which the command refused, empty where it did not."""
        return str(self.document["error"]) if isinstance(self.document, dict) and "error" in self.document else ""


@dataclass
class Command:
    """A command that runs in a process of its own; a page that reloads finds its ``stage`` here."""

    arguments: Sequence[str]
    folder: Path
    stage: str = "starting"
    process: Process | None = field(default=None, repr=False)

    async def run(self) -> Answer:
        """Run it to its end."""
        self.process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-P", "-m", "gtau", *self.arguments, "--json"),  # modules in the folder are none of ours
            cwd=self.folder,
            env=os.environ | {"GTAU_PROGRESS_EVERY": EVERY, "PYTHONUNBUFFERED": "1"},
            stdin=DEVNULL,
            stdout=PIPE,
            stderr=PIPE,
            limit=LONGEST,
            start_new_session=True,  # Ctrl-C in the terminal of the page ends the page, which ends the command
        )
        assert self.process.stdout is not None
        assert self.process.stderr is not None
        said, output = [], asyncio.ensure_future(self.process.stdout.read())
        async for line in self.process.stderr:
            text = line.decode(errors="replace").rstrip()
            if match := STAGE.match(text):
                self.stage = match[1]
            elif text:
                said.append(text.removeprefix("gtau: "))
        printed, code = await output, await self.process.wait()
        try:
            document = json.loads(printed) if printed.strip() else None
        except ValueError:
            document = {"error": printed.decode(errors="replace")[-2000:]}
        if document is None and code not in (0, 3):
            document = {"error": " ".join(said) or f"the command ended with exit code {code}."}
        return Answer(code, document, "\n".join(said))

    def cancel(self) -> None:
        """End it as Ctrl-C does: unfinished files are not written."""
        if self.process is not None:
            with suppress(ProcessLookupError):
                self.process.terminate()


def within(folder: Path, name: str) -> Path:
    """Return the path of a ``name`` in a project's folder; raises GtauError if it leads out of it."""
    with suppress(OSError, RuntimeError, ValueError):  # links in a circle, a null character
        path = (folder / name).resolve()
        if path.is_relative_to(folder.resolve()):
            return path
    raise GtauError(f"{name} is outside of the project's folder; give a file in it.")
