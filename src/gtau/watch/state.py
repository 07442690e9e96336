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


def reset_date(text: str) -> str:
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


def open_history(folder: Path, settings: Settings) -> Iterator[Entry]:
    """Read the entries of a history, or create it; raises GtauError."""
    path = folder / HISTORY
    if not path.exists():
        write_atomically(path, settings.model_dump_json() + "\n")
        return
    size = 0
    with path.open("rb+") as file:
        for number, line in enumerate(file, start=1):
            if not line.endswith(b"\n"):  # left by a program killed while writing
                file.truncate(size)
                return
            size += len(line)
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


def _require_same(begun: Settings, wanted: Settings, path: Path) -> None:
    if begun.model != wanted.model:
        raise GtauError(
            f"{path} is the history of another model (of robot '{begun.robot}'); give that model, or another --out."
        )
    for name in ("baseline", "false_alarms", "robots", "logs_per_year"):
        before, now = getattr(begun, name), getattr(wanted, name)
        option = "--false-alarms-per-year" if name == "false_alarms" else f"--{name.replace('_', '-')}"
        if before != now:
            raise GtauError(
                f"{path} was begun with {option} {before:g}, not {now:g}: another value would change what its alarms "
                "mean; give the same one, or another --out."
            )
