"""Follow a robot in production: a folder of finished logs, or a growing text log, block by block.

Each block goes through the batch pipeline as a log of its own, so that its numbers are those of finished logs; they
come as soon as the block is whole. Blocks are recognised by their content: after an end at any moment, following the
same folder or file again goes on behind the last block of the history.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory

from gtau.errors import GtauError
from gtau.signals.reading.logs import find_columns
from gtau.signals.run import Run
from gtau.watch.state import date_of, digest_of, logs_of
from gtau.watch.watch import Status, Watch, now

SETTLED = 1.0  # s without changes after which a log of a folder counts as finished
POLL = 0.5  # s between polls
FIRST_LINES = 500  # of a log that grows, from which its rate is found
HEADED = 250  # lines, among which the table has begun
CHUNK = 1 << 20  # bytes read at once

Read = Callable[[Path], Run]


@dataclass(frozen=True)
class Skipped:
    """A block without information, such as that of a robot at rest, and the reason."""

    log: str
    why: str


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
            stamp = (log.stat().st_size, log.stat().st_mtime)
            if done.get(log) == stamp or time.time() - stamp[1] < SETTLED:
                idle = idle and done.get(log) == stamp
                continue
            idle, done[log] = False, stamp
            if (digest := digest_of(log)) not in watch.seen:
                yield _update(watch, log, read, digest, log.stem, date_of(log))
        if idle:
            if ended():
                return
            time.sleep(POLL)


def _growing(
    watch: Watch, log: Path, read: Read, seconds: float, ended: Callable[[], bool]
) -> Iterator[Status | Skipped]:
    while _lines_of(log) < HEADED:
        if ended():
            return
        time.sleep(POLL)
    with TemporaryDirectory() as temporary, log.open("rb") as file:
        head = b"".join(islice(file, (find_columns(log).first_line or 1) - 1))
        part = Path(temporary) / f"{log.stem}{log.suffix or '.csv'}"
        lines: list[bytes] = []
        torn, wanted, number = b"", 0, 0
        while True:
            if log.stat().st_size < file.tell():
                raise GtauError(f"{log} has become shorter while it was followed; start following the new log.")
            chunk = file.read(CHUNK)
            *whole_lines, torn = (torn + chunk).split(b"\n")
            lines += whole_lines
            if not wanted and len(lines) >= FIRST_LINES:
                part.write_bytes(head + _text(lines[:FIRST_LINES]))
                wanted = max(round(read(part).rate * seconds), FIRST_LINES)
            while wanted and len(lines) >= wanted:
                block, number = _text(lines[:wanted]), number + 1
                del lines[:wanted]
                digest = hashlib.sha256(block).hexdigest()
                if digest not in watch.seen:
                    part.write_bytes(head + block)
                    yield _update(watch, part, read, digest, f"{log.stem} block {number}", now())
            if not chunk:
                if ended():
                    return
                time.sleep(POLL)


def _text(lines: list[bytes]) -> bytes:
    return b"\n".join(lines) + b"\n"


def _update(watch: Watch, log: Path, read: Read, digest: str, name: str, date: str) -> Status | Skipped:
    try:
        return watch.update(replace(read(log), name=name), digest, date)
    except GtauError as refusal:
        watch.seen.add(digest)
        return Skipped(name, str(refusal))


def _lines_of(log: Path) -> int:
    with log.open("rb") as file:
        return file.read(CHUNK).count(b"\n")
