"""Logs on disk: which ones there are, when they were recorded, and by what they are recognised."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable
from datetime import UTC, date, datetime
from pathlib import Path

import numpy as np

from gtau.documents.files import in_order
from gtau.errors import GtauError
from gtau.signals.reading.logs import is_log_folder
from gtau.signals.run import Run

_DATE = re.compile(r"(?<!\d)(\d{4}|\d{2})[-_](\d{2})[-_](\d{2})(?!\d)|(?<!\d)(20\d{2})(\d{2})(\d{2})(?!\d)")


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


def checked_date(text: str) -> str:
    """Read the date of a maintenance; raises GtauError."""
    try:
        return datetime.fromisoformat(text).isoformat() if "T" in text else date.fromisoformat(text).isoformat()
    except ValueError:
        raise GtauError(f"the date of the maintenance is '{text}'; write it as 2026-03-28.") from None


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


def run_digest(run: Run) -> str:
    """Compute the SHA-256 of the samples of a run."""
    digest = hashlib.sha256()
    for samples in (run.time, run.position, run.command):
        digest.update(np.ascontiguousarray(samples).tobytes())
    return digest.hexdigest()


def now() -> str:
    """Return the time, ISO 8601, in seconds."""
    return datetime.now(UTC).isoformat(timespec="seconds")
