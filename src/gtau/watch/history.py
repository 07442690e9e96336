"""The history of a watched robot: an SQLite file in WAL mode, from which everything else is computed.

A log is added in one transaction, forced to the disk before anything is said of it, and recognised by its digests; so
whatever happens, and however many programs write, each log is in the history once or is still to be read. Logs beyond
the last ``KEPT`` are condensed to one row a day.
"""

from __future__ import annotations

import json
import os
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from datetime import date as calendar
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, FiniteFloat

from gtau.errors import GtauError

HISTORY, LINES = "history.db", "history.jsonl"  # LINES: of earlier versions, read once
KEPT, SLACK = 4000, 1000  # logs kept one by one, and by how many more before they are condensed
DIGITS = 32  # of a digest that are kept
PATIENCE = 60.0  # s to wait for another program that writes
APPLICATION = 0x67746175  # "gtau", of SQLite files that are histories
TABLES = f"""
PRAGMA application_id = {APPLICATION};
CREATE TABLE settings (id INTEGER PRIMARY KEY, document TEXT NOT NULL);
CREATE TABLE seen (digest TEXT PRIMARY KEY) WITHOUT ROWID;
CREATE TABLE logs (id INTEGER PRIMARY KEY, log TEXT, date TEXT, count INTEGER, numbers BLOB, alarm TEXT);
CREATE TABLE events (id INTEGER PRIMARY KEY, date TEXT, kind TEXT, subject TEXT, note TEXT, details TEXT,
                     undone INTEGER DEFAULT 0);
"""


class _Document(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class WatchSettings(_Document):
    """Head of a history: the model, its charts, and the settings that determine the time between false alarms.

    ``baseline`` logs set what is normal; of ``robots`` that send ``logs_per_year`` each there are ``false_alarms`` a
    year. ``tolerances`` are those of the experiment file.
    """

    model: str
    robot: str
    charts: tuple[str, ...]
    baseline: int = 10
    false_alarms: FiniteFloat = 1.0
    robots: int = 1
    logs_per_year: FiniteFloat = 365.0
    tolerances: dict[str, FiniteFloat | None] = {}

    @property
    def limit(self) -> float:
        """Average number of logs between false alarms of one robot."""
        return max(self.robots * self.logs_per_year / self.false_alarms, 1.0)


class Explained(_Document):
    """One cause of an alarm: size with the half width of its 95 % interval, and its unit; ``and_also`` a second one."""

    kind: str
    joint: str
    quantity: str
    size: FiniteFloat
    half: FiniteFloat
    unit: str
    relative: FiniteFloat | None = None
    misfit: FiniteFloat
    and_also: Explained | None = None


class Alarm(_Document):
    """An alarm: a ``change``, a quantity beyond ``tolerance``, or a ``log`` that is odd by itself and set aside.

    ``explanations`` cannot be distinguished, the best first; ``since`` is the first log, ``date`` its date, ``charts``
    are those that changed, and ``healthy`` and ``changed`` their means.
    """

    kind: Literal["change", "tolerance", "log"]
    explanations: tuple[Explained, ...]
    since: str
    date: str
    charts: tuple[str, ...]
    healthy: tuple[FiniteFloat, ...]
    changed: tuple[FiniteFloat, ...]


@dataclass(frozen=True, eq=False)
class LogRow:
    """A log, or ``count`` condensed ones: ``numbers`` hold values, standard deviations, unevenness and speeds."""

    id: int
    log: str
    date: str
    count: int
    numbers: np.ndarray
    alarm: str = ""


@dataclass(frozen=True)
class Event:
    """Something that was done: its kind, the log or joint that it is about, a note, and details as data."""

    id: int
    date: str
    kind: str
    subject: str
    note: str = ""
    details: Any = None
    undone: bool = False


def open_history(folder: Path | None, settings: WatchSettings) -> sqlite3.Connection:
    """Open the history in a folder, or make it there, in memory without a folder; raises GtauError."""
    if folder is None:
        return _made(settings, None)
    path = folder / HISTORY
    if not path.exists():
        with closing(_made(settings, folder / LINES)) as made, _refusals(path):
            _put(made.serialize(), path)
    return _opened(path)


def _made(settings: WatchSettings, lines: Path | None) -> sqlite3.Connection:
    """Make a history in memory, with the entries of an earlier version's; raises GtauError."""
    database = sqlite3.connect(":memory:", isolation_level=None, check_same_thread=False)
    database.executescript(TABLES)
    taken = lines is not None and lines.exists()
    save_settings(database, _take_lines(database, lines, settings) if taken and lines else settings)
    return database


def _put(content: bytes, path: Path) -> None:
    """Write a file at once, unless another program has written it meanwhile."""
    handle, part = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            os.fsync(handle)
        os.chmod(part, 0o644)
        with suppress(FileExistsError):
            os.link(part, path)
    finally:
        os.unlink(part)


def _opened(path: Path) -> sqlite3.Connection:
    """Open a history; raises GtauError where the file is none."""
    with _refusals(path):
        if not path.stat().st_size:
            raise GtauError(f"{path} is empty; restore it from a backup, or give another --out.")
        uri = f"{path.absolute().as_uri()}?mode=rw"
        database = sqlite3.connect(uri, PATIENCE, isolation_level=None, check_same_thread=False, uri=True)
        if database.execute("PRAGMA application_id").fetchone() != (APPLICATION,):
            raise GtauError(f"{path} is not a history of gtau; restore it from a backup, or give another --out.")
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA synchronous = FULL")
    return database


def _take_lines(database: sqlite3.Connection, path: Path, settings: WatchSettings) -> WatchSettings:
    """Read a history of lines; a last line that was torn is left out with a note. Return its settings."""
    *lines, torn = path.read_bytes().split(b"\n")
    number = 1
    try:
        head = json.loads(lines[0]) if lines else None
        for line in lines[1:]:
            number += 1
            entry = json.loads(line)
            values = [[entry[key].get(name, np.nan) for name in settings.charts] for key in ("values", "std")]
            late = np.array([-1.0 if name.startswith("delay_") else 1.0 for name in settings.charts])  # was the lead
            numbers = np.concatenate([values[0] * late, values[1], [*entry["uneven"].values()] * 2])
            numbers[-len(entry["uneven"]) :] = np.nan  # speeds were not kept
            add_row(database, [entry["digest"]], entry["log"], entry["date"], numbers)
            if entry.get("begins"):
                add_event(database, entry["begins"], "reset", entry["begins"])
        if not isinstance(head, dict) or head.get("schema_") != "gtau-watch/1":
            raise ValueError("it does not begin with gtau-watch/1")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise GtauError(
            f"{path}, line {number} is damaged ({str(error) or 'empty'}); restore the file from a backup, or give "
            "another --out."
        ) from None
    if torn:
        add_event(database, calendar.today().isoformat(), "torn", path.name)
    known = {name: head[name] for name in ("model", "baseline", "false_alarms", "robots", "logs_per_year")}
    return settings.model_copy(update=known)


@contextmanager
def _refusals(path: Path) -> Iterator[None]:
    """Turn errors of SQLite and of the system into one sentence."""
    try:
        yield
    except sqlite3.Error as error:
        advice = {"full": "free some space", "locked": "end the other program that writes it"}
        hint = next((what for word, what in advice.items() if word in str(error)), "restore it from a backup")
        raise GtauError(f"{path} cannot be used ({error}); {hint}, or give another --out.") from None
    except OSError as error:
        raise GtauError(f"{path} cannot be written ({error.strerror}); free some space or check the path.") from None


@contextmanager
def writing(database: sqlite3.Connection) -> Iterator[None]:
    """Hold the lock of the history, and write all that is changed meanwhile, or nothing; raises GtauError."""
    _, _, name = database.execute("PRAGMA database_list").fetchone()
    with _refusals(Path(name or "history")):
        database.execute("BEGIN IMMEDIATE")
        try:
            yield
            database.execute("COMMIT")
        except BaseException:
            if database.in_transaction:
                database.execute("ROLLBACK")
            raise


def settings_of(database: sqlite3.Connection) -> WatchSettings:
    """Read the head."""
    return WatchSettings.model_validate_json(database.execute("SELECT document FROM settings").fetchone()[0])


def save_settings(database: sqlite3.Connection, settings: WatchSettings) -> None:
    """Write the head."""
    database.execute("INSERT OR REPLACE INTO settings VALUES (0, ?)", (settings.model_dump_json(),))


def add_row(database: sqlite3.Connection, digests: list[str], log: str, date: str, numbers: np.ndarray) -> LogRow:
    """Add a log, which is recognised by these digests."""
    database.executemany("INSERT OR IGNORE INTO seen VALUES (?)", [(digest[:DIGITS],) for digest in digests])
    values = (log, date, numbers.tobytes())
    done = database.execute("INSERT INTO logs (log, date, count, numbers, alarm) VALUES (?, ?, 1, ?, '')", values)
    return LogRow(int(done.lastrowid or 0), log, date, 1, numbers)


def rows_after(database: sqlite3.Connection, row: int) -> Iterator[LogRow]:
    """Read the logs that were added after that with the number ``row``."""
    columns = "SELECT id, log, date, count, numbers, alarm FROM logs WHERE id > ? ORDER BY id"
    for number, log, date, count, numbers, alarm in database.execute(columns, (row,)):
        yield LogRow(number, log, date, count, np.frombuffer(numbers), alarm)


def add_event(
    database: sqlite3.Connection, date: str, kind: str, subject: str = "", note: str = "", details: Any = None
) -> None:
    """Add an event."""
    values = (date, kind, subject, note, json.dumps(details))
    database.execute("INSERT INTO events (date, kind, subject, note, details) VALUES (?, ?, ?, ?, ?)", values)


def events_of(database: sqlite3.Connection) -> list[Event]:
    """Read the events, the oldest first."""
    found = database.execute("SELECT id, date, kind, subject, note, details, undone FROM events ORDER BY id")
    return [
        Event(number, date, kind, subject, note, json.loads(details), bool(undone))
        for number, date, kind, subject, note, details, undone in found
    ]


def summary_of(folder: Path) -> tuple[WatchSettings, list[Event], int, LogRow | None]:
    """Read the settings and events of a history, the number of its logs and the last of them; raises GtauError."""
    with closing(_opened(folder / HISTORY)) as database:
        (count, newest) = database.execute("SELECT total(count), max(id) FROM logs").fetchone()
        last = next(rows_after(database, newest - 1), None) if newest is not None else None
        return settings_of(database), events_of(database), int(count), last


def condense(database: sqlite3.Connection) -> bool:
    """Condense logs beyond the last ``KEPT`` to one row a day; return whether any were."""
    ids = [number for (number,) in database.execute("SELECT id FROM logs ORDER BY id DESC")]
    if len(ids) <= KEPT + SLACK:
        return False
    days: dict[str, list[LogRow]] = {}
    for row in rows_after(database, -1):
        if row.id < ids[KEPT - 1]:
            days.setdefault(row.date[:10], []).append(row)
    for day, rows in days.items():
        count = np.array([row.count for row in rows], dtype=float)[:, None]
        numbers = np.array([row.numbers for row in rows])
        there = np.where(np.isfinite(numbers), count, 0.0)
        mean = (there * np.nan_to_num(numbers)).sum(axis=0) / np.where(there.any(axis=0), there.sum(axis=0), np.nan)
        database.executemany("DELETE FROM logs WHERE id = ?", [(row.id,) for row in rows])
        database.execute(
            "INSERT INTO logs VALUES (?, ?, ?, ?, ?, ?)",
            (rows[-1].id, rows[-1].log, day, int(count.sum()), mean.tobytes(), rows[-1].alarm),
        )
    return True
