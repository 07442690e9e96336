"""The logs of a watched robot, and its history: one line of JSON per log, from which the charts are recomputed.

A line is added whole and forced to the disk before anything is said of its log, and a line that was cut off by a power
failure or a kill is dropped when the file is next opened; so whatever happens, the next run goes on with the same
numbers as if nothing had happened, and a log is either in the history or still to be read.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable, Iterator
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, FiniteFloat, ValidationError

from gtau.documents.files import in_order, write_atomically
from gtau.errors import GtauError
from gtau.signals.reading.logs import is_log_folder

SCHEMA: Literal["gtau-watch/1"] = "gtau-watch/1"
HISTORY = "history.jsonl"
_DATE = re.compile(r"(?<!\d)(\d{4}|\d{2})[-_](\d{2})[-_](\d{2})(?!\d)|(?<!\d)(20\d{2})(\d{2})(\d{2})(?!\d)")


class _Line(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Settings(_Line):
    """Head of a history: the model, and the settings that determine the time between false alarms.

    ``baseline`` logs set what is normal; of ``robots`` that send ``logs_per_year`` each there are ``false_alarms`` a
    year.
    """

    schema_: Literal["gtau-watch/1"] = SCHEMA
    model: str
    robot: str
    baseline: int = 10
    false_alarms: FiniteFloat = 1.0
    robots: int = 1
    logs_per_year: FiniteFloat = 365.0

    @property
    def limit(self) -> float:
        """Alarm limit of the mean of a robot's e-detectors: the average number of logs between its false alarms."""
        return max(self.robots * self.logs_per_year / self.false_alarms, 1.0)


class Explained(_Line):
    """One explanation of an alarm: size with the half width of its 95 % interval, and its unit."""

    kind: str
    joint: str
    quantity: str
    size: FiniteFloat
    half: FiniteFloat
    unit: str
    relative: FiniteFloat | None = None
    misfit: FiniteFloat


class Alarm(_Line):
    """An alarm: explanations that cannot be distinguished, the best first, and the log since which they hold."""

    explanations: tuple[Explained, ...]
    since: str
    earliest: str
    latest: str
    charts: tuple[str, ...]


class Entry(_Line):
    """A log in the history.

    ``values``, ``std`` and ``formula`` by chart: estimate, standard deviation by the jackknife and by the formula;
    ``uneven`` of each joint. ``begins`` is the date of the maintenance, in the first log of a new one. ``log_e`` is
    the logarithm of the mean e-detector, ``cusum`` the largest sum of a chart over its limit.
    """

    log: str
    digest: str
    date: str
    begins: str = ""
    values: dict[str, FiniteFloat]
    std: dict[str, FiniteFloat]
    formula: dict[str, FiniteFloat]
    uneven: dict[str, FiniteFloat]
    not_shown: tuple[str, ...]
    phase: Literal["baseline", "watching"]
    log_e: FiniteFloat | None = None
    cusum: FiniteFloat | None = None
    leading: str = ""
    alarm: Alarm | None = None


def logs_of(paths: Iterable[Path]) -> list[Path]:
    """List logs in the order given, those of a folder in the order of their names; raises GtauError."""
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


def digest_of(path: str | Path) -> str:
    """Compute the SHA-256 of a log, or of all files in a folder; raises GtauError."""
    path = Path(path)
    found = hashlib.sha256()
    try:
        for each in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if each.is_file():
                with each.open("rb") as file:
                    while block := file.read(1 << 20):
                        found.update(block)
    except OSError as error:
        raise GtauError(f"{path} cannot be read ({(error.strerror or str(error)).lower()}); check the path.") from None
    return found.hexdigest()


def open_history(folder: Path, settings: Settings) -> Iterator[Entry]:
    """Read the entries of a history, or create it; raises GtauError."""
    path = folder / HISTORY
    if not path.exists():
        write_atomically(path, settings.model_dump_json() + "\n")
        return
    _drop_unfinished(path)
    with path.open(encoding="utf-8") as file:
        for number, line in enumerate(file, start=1):
            try:
                if number == 1:
                    _require_same(Settings.model_validate_json(line), settings, path)
                else:
                    yield Entry.model_validate_json(line)
            except ValidationError as error:
                raise GtauError(
                    f"{path}, line {number} is damaged ({error.errors()[0]['msg'].lower()}); restore the file from a "
                    "backup, or begin a new history in another folder."
                ) from None


def append(folder: Path, entry: Entry) -> None:
    """Append an entry and force it to disk; raises GtauError."""
    path = folder / HISTORY
    try:
        with path.open("ab") as file:
            file.write(entry.model_dump_json().encode() + b"\n")
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise GtauError(f"{path} cannot be written ({error.strerror}); free some space.") from None


def _drop_unfinished(path: Path) -> None:
    """Remove an incomplete last line, left by a program killed while writing."""
    with path.open("rb+") as file:
        size = file.seek(0, os.SEEK_END)
        at, tail = size, b""
        while at > 0 and b"\n" not in tail:
            at = max(at - (1 << 16), 0)
            file.seek(at)
            tail = file.read(size - at)
        whole = at + tail.rfind(b"\n") + 1
        if whole < size:
            file.truncate(whole)


def _require_same(found: Settings, wanted: Settings, path: Path) -> None:
    if found.model != wanted.model:
        raise GtauError(
            f"{path} is the history of another model (of robot '{found.robot}'); give that model, or another --out."
        )
    words = {
        "baseline": "--baseline",
        "false_alarms": "--false-alarms-per-year",
        "robots": "--robots",
        "logs_per_year": "--logs-per-year",
    }
    for name, option in words.items():
        before, now = getattr(found, name), getattr(wanted, name)
        if before != now:
            raise GtauError(
                f"{path} was begun with {option} {before:g}, not {now:g}: another value would change what its alarms "
                "mean; give the same one, or another --out."
            )
