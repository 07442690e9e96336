"""Follow a robot in production: a folder of finished logs, or a growing text log, block by block.

Each block is treated as a finished log and recognised by its content: following the same folder or file again
continues after the last block of the history, wherever it was interrupted. A log that is rotated, cut or replaced is
followed from its beginning.
"""

from __future__ import annotations

import hashlib
import os
import re
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import replace
from datetime import UTC, date, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO

from gtau.documents.files import digest_of, in_order, system_refusals
from gtau.errors import GtauError
from gtau.signals.reading.logs import find_columns, is_log_folder
from gtau.signals.run import Run
from gtau.watch.history import now
from gtau.watch.statistics import TooShort
from gtau.watch.watch import Status, Watch

SETTLED = 1.0  # s without changes after which a log of a folder counts as finished
POLL = 0.5  # s between polls
FIRST_LINES = 500  # of a log that grows, from which its head and rate are found
CHUNK = 1 << 20  # bytes read at once
LONGEST = 1 << 24  # bytes; a growing file with fewer than FIRST_LINES lines in them is no text log

Read = Callable[[Path], Run]
_DATE = re.compile(r"(?<!\d)(\d{4}|\d{2})[-_](\d{2})[-_](\d{2})(?!\d)|(?<!\d)(20\d{2})(\d{2})(\d{2})(?!\d)")


def logs_of(paths: Iterable[Path]) -> list[Path]:
    """List logs in the order given, and the logs of a folder by name; raises GtauError."""
    logs: list[Path] = []
    for path in paths:
        inside = _logs_in(path) if path.is_dir() else [path] * path.exists()
        if not inside:
            raise GtauError(f"there is no log at {path}; check the path.")
        logs += inside
    return logs


def _logs_in(folder: Path) -> list[Path]:
    if is_log_folder(folder):
        return [folder]
    return [entry for entry in in_order(folder.glob("[!.]*")) if entry.is_file() or is_log_folder(entry)]


def date_of(log: Path) -> str:
    """Find the recording date of a log, ISO 8601: the date in its name, else the last change of its file."""
    for match in reversed(list(_DATE.finditer(log.name))):
        year, month, day = map(int, filter(None, match.groups()))
        with suppress(ValueError):
            return date(year if year > 99 else 2000 + year, month, day).isoformat()
    return datetime.fromtimestamp(log.stat().st_mtime, UTC).isoformat(timespec="seconds")


def take(watch: Watch, log: Path, read: Read) -> Status | None:
    """Add a finished log, or set it aside with the reason why it cannot be read; None if its samples are known."""
    try:
        digest = digest_of(log)
        if watch.history.seen(digest):
            return None
        status = watch.update(replace(read(log), name=log.stem), digest, date_of(log))
    except GtauError as refusal:
        watch.set_aside(log.stem, str(refusal))
        return Status(log=log.stem, date=now(), alarm=watch.alarm, skipped=str(refusal))
    return None if status.copied else status


def follow(
    watch: Watch,
    source: Path,
    read: Read,
    seconds: float,
    ended: Callable[[], bool] = lambda: False,
    busy: Callable[[str], AbstractContextManager[object]] = nullcontext,
) -> Iterator[Status]:
    """Add new logs, ``busy`` meanwhile, or blocks of ``seconds``, until ``ended``, asked when nothing is new."""
    if not source.exists():
        raise GtauError(f"there is nothing to follow at {source}; give a folder or a growing text log.")
    with system_refusals(source, "give a folder or a growing text log"):
        pass  # of a pipe, reading never ends
    for status in _folder(watch, source, read, busy) if source.is_dir() else _growing(watch, source, read, seconds):
        if status is not None:
            yield status
        elif ended():
            return
        else:
            time.sleep(POLL)


def _folder(
    watch: Watch, folder: Path, read: Read, busy: Callable[[str], AbstractContextManager[object]]
) -> Iterator[Status | None]:
    """Add the logs of a folder once they are finished; yield None after each scan."""
    done: dict[Path, tuple[int, float]] = {}
    while True:
        for log in _logs_in(folder):
            with suppress(FileNotFoundError):  # rotated away meanwhile
                stamp = (log.stat().st_size, log.stat().st_mtime)
                if done.get(log) == stamp or time.time() - stamp[1] < SETTLED:
                    continue
                done[log] = stamp
                with busy(log.name):
                    status = take(watch, log, read)
                if status is not None:
                    yield status
        yield None


def _growing(watch: Watch, log: Path, read: Read, seconds: float) -> Iterator[Status | None]:
    """Add the blocks of a log and of its successors when it is rotated; yield None while it does not grow."""
    number = 0
    with TemporaryDirectory() as temporary:
        part = Path(temporary) / f"{log.stem}{log.suffix or '.csv'}"
        while True:
            while not log.exists():
                yield None
            with log.open("rb") as file:
                head, text, wanted = b"", b"", 0
                while (chunk := file.read(CHUNK)) or not _replaced(log, file):
                    text += chunk
                    if not wanted and text.count(b"\n") >= FIRST_LINES:
                        head = _lines(text, (find_columns(log).first_line or 1) - 1)
                        text = text[len(head) :]
                        part.write_bytes(head + _lines(text, FIRST_LINES))
                        wanted = max(round(read(part).rate * seconds), FIRST_LINES)
                    elif not wanted and len(text) > LONGEST:
                        raise GtauError(
                            f"{log} is no text log: its first {len(text) >> 20} MiB have fewer than {FIRST_LINES} "
                            "lines; give a folder or a growing text log."
                        )
                    while wanted and text.count(b"\n") >= wanted:
                        block, number = _lines(text, wanted), number + 1
                        text = text[len(block) :]
                        part.write_bytes(head + block)
                        if (status := _block(watch, part, read, block, f"{log.stem} block {number}")) is not None:
                            yield status
                    if not chunk:
                        yield None


def _block(watch: Watch, part: Path, read: Read, block: bytes, name: str) -> Status | None:
    """Add a block; raises GtauError if blocks of this length are too short."""
    digest = hashlib.sha256(block).hexdigest()
    if watch.history.seen(digest):
        return None
    try:
        return watch.update(replace(read(part), name=name), digest, now())
    except TooShort as refusal:
        raise GtauError(f"blocks are too short: {refusal}") from None
    except GtauError as refusal:
        return Status(log=name, date=now(), alarm=watch.alarm, skipped=str(refusal))


def _lines(text: bytes, count: int) -> bytes:
    return text[: len(text) - len(text.split(b"\n", count)[-1])]


def _replaced(log: Path, file: BinaryIO) -> bool:
    with suppress(FileNotFoundError):
        state = log.stat()
        return not os.path.samestat(state, os.fstat(file.fileno())) or state.st_size < file.tell()
    return True
