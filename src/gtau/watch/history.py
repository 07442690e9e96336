"""The history of a watched robot: an SQLite file in WAL mode, from which everything else is computed.

A log is added in one transaction, flushed to disk before it is reported, and recognised by its digests. So each log is
added exactly once, after crashes and with several writers too. Logs beyond the last ``KEPT`` are condensed to one row
a day.
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import AliasChoices, Field, FiniteFloat

from gtau.documents.files import json_in
from gtau.documents.validation import Keys, Positive, read_group
from gtau.errors import GtauError
from gtau.signals.reading.statements import Tolerances
from gtau.watch.detectors import FEWEST

HISTORY = "history.db"
FALSE_ALARMS = "false_alarms_per_year"
KEPT, SLACK = 4000, 1000  # logs kept one by one, and the excess at which older ones are condensed
DIGITS = 32  # stored of a digest
PATIENCE = 60.0  # s to wait for another writer
APPLICATION = 0x67746175  # "gtau": application id of the SQLite file
TABLES = f"""
PRAGMA application_id = {APPLICATION};
CREATE TABLE settings (id INTEGER PRIMARY KEY, document TEXT NOT NULL);
CREATE TABLE seen (digest TEXT PRIMARY KEY) WITHOUT ROWID;
CREATE TABLE logs (id INTEGER PRIMARY KEY, log TEXT, date TEXT, count INTEGER, numbers BLOB, alarm TEXT);
CREATE TABLE events (id INTEGER PRIMARY KEY, date TEXT, kind TEXT, subject TEXT, note TEXT, details TEXT,
                     undone INTEGER DEFAULT 0);
"""


class WatchSettings(Keys):
    """Settings of a history: its model and charts, the rate of false alarms of all robots, and the tolerances."""

    model: str
    robot: str
    charts: tuple[str, ...]
    baseline: Annotated[int, Field(ge=FEWEST)] = 10
    false_alarms_per_year: Annotated[Positive, Field(validation_alias=AliasChoices(FALSE_ALARMS, "false_alarms"))] = 1.0
    robots: Annotated[int, Field(ge=1)] = 1
    logs_per_year: Positive = 365.0
    tolerances: Tolerances = Tolerances()

    @property
    def limit(self) -> float:
        """Average number of logs between false alarms of one robot."""
        return max(self.robots * self.logs_per_year / self.false_alarms_per_year, 1.0)


class Cause(Keys):
    """A cause of an alarm; ``and_also`` is a second, simultaneous cause.

    The change ``size`` of a ``quantity`` has the 95 % interval ± ``half``; ``relative`` is its share of the model's
    value. ``text`` names the cause and ``advice`` the remedy, without full stops.
    """

    kind: str
    joint: str
    quantity: str = "rms"
    size: FiniteFloat
    half: FiniteFloat = 0.0
    unit: str = "1"
    relative: FiniteFloat | None = None
    text: str
    advice: str
    and_also: Cause | None = None

    @property
    def parts(self) -> tuple[Cause, ...]:
        """The cause and its simultaneous one, if any."""
        return (self,) if self.and_also is None else (self, self.and_also)

    def __str__(self) -> str:
        return " and ".join(part.text for part in self.parts)


class Alarm(Keys):
    """An alarm: a ``change``, a quantity beyond ``tolerance``, or an outlying ``log``, which is set aside.

    It lasts since a log and its date. The ``explanations``, best first, cannot be distinguished; ``charts`` changed
    from their ``healthy`` to their ``changed`` means.
    """

    kind: Literal["change", "tolerance", "log"]
    explanations: tuple[Cause, ...]
    since: str
    date: str
    charts: tuple[str, ...]
    healthy: tuple[FiniteFloat, ...]
    changed: tuple[FiniteFloat, ...]


class Logs(NamedTuple):
    """The N logs of a history by date: their ids in the order of arrival, names, dates, and how many each averages.

    ``charts`` and ``std`` (N, k), ``uneven`` and ``speeds`` (N, n) are described in :class:`LogStatistics`.
    """

    ids: np.ndarray
    names: np.ndarray
    dates: np.ndarray
    counts: np.ndarray
    charts: np.ndarray
    std: np.ndarray
    uneven: np.ndarray
    speeds: np.ndarray

    @property
    def days(self) -> np.ndarray:
        """Days (N,) since 1970."""
        return self.dates.astype("U19").astype("datetime64[s]").astype(float) / 86400

    def place(self, alarm: Alarm) -> int:
        """Find the row in which an alarm began, 0 if it has been condensed."""
        return int(np.argmax((self.names == alarm.since) & (self.dates == alarm.date)))


class Event(NamedTuple):
    """An event: its kind, the log or date concerned, a note, and details as data."""

    id: int
    date: str
    kind: str
    subject: str
    note: str
    undone: int
    details: Any


class History:
    """A history in a folder, created with ``settings`` if missing, or in memory without a folder; raises GtauError."""

    def __init__(self, folder: Path | None, settings: WatchSettings | None = None):
        self.path = (folder or Path()) / HISTORY
        with self._refusals():
            if folder is None:
                self._connect(":memory:", settings)
                return
            if settings and not self.path.exists():
                with TemporaryDirectory(prefix=f".{HISTORY}.", dir=folder) as aside:
                    self._connect(f"{aside}/{HISTORY}", settings)
                    self._database.close()
                    with suppress(FileExistsError):  # another program was faster
                        os.link(f"{aside}/{HISTORY}", self.path)
            self._connect(f"{self.path.absolute().as_uri()}?mode=rw")
            if not self.path.stat().st_size or self._one("PRAGMA application_id") != APPLICATION:
                raise GtauError(
                    f"{self.path} is not a history of gtau; restore it from a backup, or give another folder."
                )
            self._database.executescript("PRAGMA journal_mode = WAL; PRAGMA synchronous = FULL")
            document = self._document(self._one("SELECT document FROM settings"))
            self.settings = read_group(WatchSettings, str(self.path), document)

    def _connect(self, uri: str, settings: WatchSettings | None = None) -> None:
        self._database = sqlite3.connect(uri, PATIENCE, isolation_level=None, check_same_thread=False, uri=True)
        if settings:
            self._database.executescript(TABLES)
            self.save(settings)

    @contextmanager
    def _refusals(self) -> Iterator[None]:
        try:
            yield
        except (sqlite3.Error, OSError) as error:
            why = getattr(error, "strerror", None) or error
            raise GtauError(
                f"{self.path} cannot be used ({why}); free some space, end other programs that write it, or restore it "
                "from a backup."
            ) from None

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Hold the lock of the history, and write all changes made meanwhile, or none; raises GtauError."""
        with self._refusals(), self._database:
            self._database.execute("BEGIN IMMEDIATE")
            yield

    def _document(self, text: str) -> Any:
        try:
            return json_in(text)
        except ValueError as error:
            raise GtauError(f"{self.path} holds a damaged document ({error}); restore it from a backup.") from None

    def _alarm(self, text: str | None) -> Alarm | None:
        return read_group(Alarm, str(self.path), self._document(text)) if text else None

    def _do(self, query: str, *values: Any) -> sqlite3.Cursor:
        return self._database.execute(query, values)

    def _one(self, query: str, *values: Any) -> Any:
        return (self._do(query, *values).fetchone() or (None,))[0]

    def save(self, settings: WatchSettings) -> None:
        """Write the settings."""
        self._do("INSERT OR REPLACE INTO settings VALUES (0, ?)", settings.model_dump_json())
        self.settings = settings

    def logs(self, charts: int, joints: int) -> Logs:
        """Read the logs, given the numbers of charts and joints."""
        rows = self._do("SELECT id, log, date, count, numbers FROM logs ORDER BY date, id").fetchall()
        *columns, parts = zip(*rows, strict=True) if rows else ((),) * 5
        numbers = np.frombuffer(b"".join(parts)).reshape(len(rows), 2 * (charts + joints))
        arrays: list[np.ndarray] = list(map(np.array, columns, (int, str, str, int)))
        return Logs(*arrays, *np.split(numbers, [charts, 2 * charts, 2 * charts + joints], axis=1))

    @property
    def extent(self) -> tuple[int, str]:
        """Number of logs, and date of the last one, or an empty text."""
        return int(self._one("SELECT total(count) FROM logs")), self._one("SELECT max(date) FROM logs") or ""

    @property
    def events(self) -> list[Event]:
        """Events, the oldest first."""
        columns = "SELECT id, date, kind, subject, note, undone, details FROM events ORDER BY id"
        return [Event(*(*event[:6], self._document(event[6]))) for event in self._do(columns)]

    @property
    def alarm(self) -> Alarm | None:
        """The state after the log that was added last."""
        return self._alarm(self._one("SELECT alarm FROM logs ORDER BY id DESC LIMIT 1"))

    @alarm.setter
    def alarm(self, alarm: Alarm | None) -> None:
        text = alarm.model_dump_json() if alarm else ""
        self._do("UPDATE logs SET alarm = ? WHERE id = (SELECT max(id) FROM logs)", text)

    def seen(self, digest: str) -> bool:
        """Return whether a log of this digest is in the history."""
        return self._one("SELECT 1 FROM seen WHERE digest = ?", digest[:DIGITS]) is not None

    def remember(self, log: str, digests: Iterable[str]) -> None:
        """Store the digests of a log, and drop the note that it could not be read."""
        for digest in digests:
            self._do("INSERT OR IGNORE INTO seen VALUES (?)", digest[:DIGITS])
        self._do("DELETE FROM events WHERE kind = 'refused' AND subject = ?", log)

    def add_row(self, log: str, date: str, numbers: Sequence[np.ndarray]) -> int:
        """Add a log; return its number."""
        row = "INSERT INTO logs (log, date, count, numbers, alarm) VALUES (?, ?, 1, ?, '')"
        return int(self._do(row, log, date, np.concatenate(numbers).tobytes()).lastrowid or 0)

    def add_event(self, kind: str, subject: str, date: str = "", note: str = "", details: Any = None) -> None:
        """Add an event, stamped now if no date is given."""
        row = "INSERT INTO events (date, kind, subject, note, details) VALUES (?, ?, ?, ?, ?)"
        self._do(row, date or now(), kind, subject, note, json.dumps(details))

    def undo(self, event: Event) -> None:
        """Mark an event as undone, and restore the alarm before it."""
        self._do("UPDATE events SET undone = 1 WHERE id = ?", event.id)
        self.alarm = self._alarm(event.details["alarm"])

    def condense(self) -> None:
        """Condense logs beyond the last ``KEPT`` to one row a day, once there are ``SLACK`` more."""
        if self._one("SELECT count(*) FROM logs WHERE count = 1") <= KEPT + SLACK:
            return
        columns = "SELECT id, log, substr(date, 1, 10), count, numbers FROM logs ORDER BY id"
        rows = self._do(columns).fetchall()[:-KEPT]
        self._do("DELETE FROM logs WHERE id <= ?", rows[-1][0])
        for day, day_rows in groupby(sorted(rows, key=itemgetter(2)), itemgetter(2)):
            ids, names, _, counts, parts = zip(*day_rows, strict=True)
            numbers = np.array([np.frombuffer(part) for part in parts])
            weights = np.isfinite(numbers) * np.array(counts)[:, None]
            total = (weights * np.nan_to_num(numbers)).sum(axis=0)
            mean = total / np.where(weights.any(axis=0), weights.sum(axis=0), np.nan)
            row = "INSERT INTO logs VALUES (?, ?, ?, ?, ?, '')"
            self._do(row, ids[-1], names[-1], day, sum(counts), mean.tobytes())


def now() -> str:
    """Return the time, ISO 8601, in seconds."""
    return datetime.now(UTC).isoformat(timespec="seconds")
