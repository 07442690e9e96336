"""List finished logs of a watched robot, their order, and when they were recorded."""

from __future__ import annotations

import re
from collections.abc import Iterable
from datetime import UTC, date, datetime
from pathlib import Path

from gtau.documents.files import in_order
from gtau.errors import GtauError
from gtau.signals.formats import is_log_folder

_DATE = re.compile(r"(?<!\d)(\d{4}|\d{2})[-_](\d{2})[-_](\d{2})(?!\d)|(?<!\d)(20\d{2})(\d{2})(\d{2})(?!\d)")


def logs_of(paths: Iterable[Path]) -> list[Path]:
    """List logs in the order given, those of a folder in the order of their names.

    Raises
    ------
    GtauError
        Where a path does not exist, or a folder holds no log.
    """
    found: list[Path] = []
    for path in paths:
        if not path.exists():
            raise GtauError(f"there is no log '{path}'; check the path.")
        if not path.is_dir() or is_log_folder(path):
            found.append(path)
            continue
        inside = in_order(each for each in path.iterdir() if not each.name.startswith("."))
        inside = [each for each in inside if each.is_file() or is_log_folder(each)]
        if not inside:
            raise GtauError(f"the folder {path} holds no log; check the path.")
        found += inside
    return found


def date_of(log: Path) -> str:
    """Find the recording date of a log, ISO 8601: the date in its name, else the last change of its file."""
    for match in reversed(list(_DATE.finditer(log.name))):
        year, month, day = (int(each) for each in match.groups() if each is not None)
        try:
            return date(year if year > 99 else 2000 + year, month, day).isoformat()
        except ValueError:
            continue
    return datetime.fromtimestamp(log.stat().st_mtime, UTC).isoformat(timespec="seconds")


def reset_date(text: str) -> str:
    """Read the date of a maintenance; raises GtauError."""
    try:
        return datetime.fromisoformat(text).isoformat() if "T" in text else date.fromisoformat(text).isoformat()
    except ValueError:
        raise GtauError(f"the date of the maintenance is '{text}'; write it as 2026-03-28.") from None
