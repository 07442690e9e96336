"""Follow a robot in production: a folder of finished logs, or a growing text log, block by block.

Each block goes through the batch pipeline as a log of its own, so that its numbers are those of finished logs; they
come as soon as the block is whole. Blocks are recognised by their content: after an end at any moment, following the
same folder or file again goes on behind the last block of the history. A log that is rotated, cut or replaced is
followed from its beginning.
"""

from __future__ import annotations

import hashlib
import os
import re
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO

from gtau.documents.files import in_order
from gtau.errors import GtauError
from gtau.signals.reading.logs import find_columns, is_log_folder
from gtau.signals.run import Run
from gtau.watch.quantities import TooShort
from gtau.watch.watch import Status, Watch, now

SETTLED = 1.0  # s without changes after which a log of a folder counts as finished
POLL = 0.5  # s between polls
FIRST_LINES = 500  # of a log that grows, from which its rate is found
HEADED = 250  # lines, among which the table has begun
CHUNK = 1 << 20  # bytes read at once

Read = Callable[[Path], Run]
_DATE = re.compile(r"(?<!\d)(\d{4}|\d{2})[-_](\d{2})[-_](\d{2})(?!\d)|(?<!\d)(20\d{2})(\d{2})(\d{2})(?!\d)")


@dataclass(frozen=True)
class Skipped:
    """A log that is set aside, or a block without information, such as that of a robot at rest, and the reason."""

    log: str
    why: str


def logs_of(paths: Iterable[Path]) -> list[Path]:
    """List logs in the order given, those of a folder in the order of their names; raises GtauError."""
    logs: list[Path] = []
    for path in paths:
        if not path.exists():
            raise GtauError(f"there is no log '{path}'; check the path.")
        if not path.is_dir() or is_log_folder(path):
            logs.append(path)
            continue
        entries = in_order(entry for entry in path.iterdir() if not entry.name.startswith("."))
        inside = [entry for entry in entries if entry.is_file() or is_log_folder(entry)]
        if not inside:
            raise GtauError(f"the folder {path} holds no log; check the path.")
        logs += inside
    return logs


def date_of(log: Path) -> str:
    """Find the recording date of a log, ISO 8601: the date in its name, else the last change of its file."""
    for match in reversed(list(_DATE.finditer(log.name))):
        year, month, day = map(int, filter(None, match.groups()))
        try:
            return date(year if year > 99 else 2000 + year, month, day).isoformat()
        except ValueError:
            continue
    return datetime.fromtimestamp(log.stat().st_mtime, UTC).isoformat(timespec="seconds")


def digest_of(path: str | Path) -> str:
    """Compute the SHA-256 of a log, or of all files in a folder; raises GtauError."""
    path, digest = Path(path), hashlib.sha256()
    try:
        for part in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if part.is_file():
                with part.open("rb") as file:
                    while block := file.read(1 << 20):
                        digest.update(block)
    except OSError as error:
        raise GtauError(f"{path} cannot be read ({(error.strerror or str(error)).lower()}); check the path.") from None
    return digest.hexdigest()


def take(watch: Watch, log: Path, read: Read) -> Status | Skipped | None:
    """Add a finished log; one that cannot be read is set aside with the reason. None where its samples are known."""
    try:
        digest = digest_of(log)
        if watch.seen(digest):
            return None
        status = watch.update(replace(read(log), name=log.stem), digest, date_of(log))
    except GtauError as refusal:
        watch.set_aside(log.stem, str(refusal))
        return Skipped(log.stem, str(refusal))
    return None if status.copied else status


def follow(
    watch: Watch, source: Path, read: Read, seconds: float, ended: Callable[[], bool] = lambda: False
) -> Iterator[Status | Skipped]:
    """Follow a folder of finished logs, or a growing text log in blocks of ``seconds``; raises GtauError.

    ``read`` reads the log at a path. ``ended`` is called when there is nothing new: whether the source has ended.
    """
    if source.is_dir():
        yield from _folder(watch, source, read, ended)
    elif source.is_file():
        yield from _growing(watch, source, read, seconds, ended)
    else:
        raise GtauError(f"there is nothing to follow at {source}; give a folder or a growing text log.")


def _folder(watch: Watch, folder: Path, read: Read, ended: Callable[[], bool]) -> Iterator[Status | Skipped]:
    done: dict[Path, tuple[int, float]] = {}
    while True:
        idle = True
        for log in logs_of([folder]) if any(folder.iterdir()) else []:
            with suppress(FileNotFoundError):  # rotated away meanwhile
                stamp = (log.stat().st_size, log.stat().st_mtime)
                if done.get(log) == stamp or time.time() - stamp[1] < SETTLED:
                    idle = idle and done.get(log) == stamp
                    continue
                idle, done[log] = False, stamp
                if (status := take(watch, log, read)) is not None:
                    yield status
        if idle:
            if ended():
                return
            time.sleep(POLL)


def _growing(
    watch: Watch, log: Path, read: Read, seconds: float, ended: Callable[[], bool]
) -> Iterator[Status | Skipped]:
    """Follow a log, and what takes its place when it is rotated."""
    number = 0
    while True:
        while not log.exists() or _lines_of(log) < HEADED:
            if ended():
                return
            time.sleep(POLL)
        with TemporaryDirectory() as temporary, log.open("rb") as file:
            head = b"".join(islice(file, (find_columns(log).first_line or 1) - 1))
            part = Path(temporary) / f"{log.stem}{log.suffix or '.csv'}"
            lines: list[bytes] = []
            torn, wanted = b"", 0
            while True:
                chunk = file.read(CHUNK)
                *complete, torn = (torn + chunk).split(b"\n")
                lines += complete
                if not wanted and len(lines) >= FIRST_LINES:
                    part.write_bytes(head + b"\n".join([*lines[:FIRST_LINES], b""]))
                    wanted = max(round(read(part).rate * seconds), FIRST_LINES)
                while wanted and len(lines) >= wanted:
                    block, number = b"\n".join([*lines[:wanted], b""]), number + 1
                    del lines[:wanted]
                    part.write_bytes(head + block)
                    if (status := _block(watch, part, read, block, f"{log.stem} block {number}")) is not None:
                        yield status
                if not chunk:
                    if _replaced(log, file):
                        break
                    if ended():
                        return
                    time.sleep(POLL)


def _block(watch: Watch, part: Path, read: Read, block: bytes, name: str) -> Status | Skipped | None:
    """Add a block; raises GtauError where no block of this length can be used."""
    digest = hashlib.sha256(block).hexdigest()
    if watch.seen(digest):
        return None
    try:
        return watch.update(replace(read(part), name=name), digest, now())
    except TooShort as refusal:
        raise GtauError(f"blocks are too short: {refusal}") from None
    except GtauError as refusal:
        return Skipped(name, str(refusal))


def _replaced(log: Path, file: BinaryIO) -> bool:
    """Return whether a log is no longer the file that is read, or has been cut."""
    try:
        state, opened = log.stat(), os.fstat(file.fileno())
    except FileNotFoundError:
        return True
    return (state.st_ino, state.st_dev) != (opened.st_ino, opened.st_dev) or state.st_size < file.tell()


def _lines_of(log: Path) -> int:
    with log.open("rb") as file:
        return file.read(CHUNK).count(b"\n")
