"""Watch a robot: judge it log by log against its model and its own past; the history is the only state."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, FiniteFloat

from gtau.documents.files import folder_of
from gtau.documents.validation import NUMBER, TEXT, WHOLE, takes
from gtau.errors import GtauError, UnknownName
from gtau.estimation.results.model_file import to_document
from gtau.estimation.results.result import Result
from gtau.model.interpreter.program import single_threaded_blas
from gtau.robots.parameter import torque_unit
from gtau.signals.reading.statements import Tolerances
from gtau.signals.run import Run
from gtau.watch import history
from gtau.watch.alarms import evidence_of, judge
from gtau.watch.detectors import FEWEST, mean_of
from gtau.watch.history import Alarm, Event, LogRow, WatchSettings
from gtau.watch.quantities import Quantity, charts_of
from gtau.watch.statistics import RESIDUAL, LogStatistics, statistics_of
from gtau.watch.table import View, view_of

DONE = ("acknowledge", "forget", "reset")  # events that can be undone


class Entry(BaseModel):
    """A log: estimates and standard deviations by chart, unevenness by joint, and the state after it."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    log: str
    date: str
    phase: Literal["baseline", "watching", "aside"]
    values: dict[str, FiniteFloat]
    std: dict[str, FiniteFloat]
    uneven: dict[str, FiniteFloat]
    not_shown: tuple[str, ...]
    alarm: Alarm | None = None


@dataclass(frozen=True, eq=False)
class Status:
    """The last log of the history, and whether the log given was in it already (``copied``)."""

    entry: Entry
    copied: bool = False

    @property
    def healthy(self) -> bool:
        """True without an alarm."""
        return self.entry.alarm is None


class Watch:
    """Watch a robot: feed it finished logs, and it reports whether the robot has changed.

    This is not a safety function: it detects wear and mistakes between logs and protects nobody.

    Parameters
    ----------
    model : Result
        From :func:`gtau.identify` or :meth:`gtau.Result.load`.
    out : path, optional
        Folder of the history, continued if it exists; in memory if omitted.
    baseline : int, optional
        Number of healthy logs that form the baseline, 10 if omitted. This and the following stand in the history and
        need not be repeated.
    false_alarms_per_year : float, optional
        False alarms of the whole fleet per year, 1 if omitted.
    robots : int, optional
        Number of robots in the fleet, 1 if omitted.
    logs_per_year : float, optional
        Logs of each robot per year, 365 if omitted.
    tolerances : Tolerances, optional
        Those of an experiment file.

    Raises
    ------
    GtauError
        The history belongs to another model or other settings.
    """

    @takes(
        model=("the result of gtau.identify or gtau.Result.load", (Result,)),
        baseline=WHOLE,
        false_alarms_per_year=NUMBER,
        robots=WHOLE,
        logs_per_year=NUMBER,
    )
    def __init__(
        self,
        model: Result,
        out: str | Path | None = None,
        baseline: int | None = None,
        false_alarms_per_year: float | None = None,
        robots: int | None = None,
        logs_per_year: float | None = None,
        tolerances: Tolerances | None = None,
    ):
        if baseline is not None and baseline < FEWEST:
            raise GtauError(f"a baseline of {baseline} logs is too short; use at least {FEWEST} healthy logs.")
        numbers = {"false_alarms": false_alarms_per_year, "robots": robots, "logs_per_year": logs_per_year}
        if any(number is not None and not number > 0 for number in numbers.values()):
            raise GtauError("false alarms per year, robots and logs per year are positive numbers; correct them.")
        self.model = model
        self.folder = None if out is None else folder_of(out)
        self.charts: tuple[Quantity, ...] = (
            *charts_of(model),
            *(Quantity(RESIDUAL, joint, torque_unit(model.robot, joint)) for joint in model.robot.actuated),
        )
        given: dict[str, Any] = {"baseline": baseline, **numbers}
        given = {name: value for name, value in given.items() if value is not None}
        names = tuple(chart.name for chart in self.charts)
        begun = WatchSettings(model=model_digest(model), robot=model.robot.name, charts=names, **given)
        self._database = history.open_history(self.folder, begun)
        self.settings = history.settings_of(self._database)
        _require_same(self.settings, begun, given, self.folder)
        if tolerances is not None and (wanted := tolerances.model_dump()) != self.settings.tolerances:
            self.settings = self.settings.model_copy(update={"tolerances": wanted})
            with history.writing(self._database):
                history.save_settings(self._database, self.settings)
        self._rows: list[LogRow] = []
        self._read()

    def _read(self, whole: bool = False) -> None:
        """Take the logs that this or another program has added to the history, or all of them again."""
        known = [] if whole else self._rows
        newest = max((row.id for row in known), default=-1)
        self._rows = [*known, *history.rows_after(self._database, newest)]
        self.events: list[Event] = history.events_of(self._database)
        self.view = self._viewed(self._rows)
        text = max(self._rows, key=lambda row: row.id).alarm if self._rows else ""
        self.alarm = Alarm.model_validate_json(text) if text else None

    def _viewed(self, rows: list[LogRow]) -> View:
        return view_of(self.model, self.charts, rows, self.events, Tolerances.model_validate(self.settings.tolerances))

    @property
    def count(self) -> int:
        """Number of logs since the last maintenance that are not set aside."""
        return self.view.baseline

    @property
    def phase(self) -> Literal["baseline", "watching"]:
        """``baseline`` until the baseline is complete, then ``watching``."""
        return "baseline" if self.count < self.settings.baseline else "watching"

    def seen(self, digest: str) -> bool:
        """Return whether a log of this digest is in the history."""
        found = self._database.execute("SELECT 1 FROM seen WHERE digest = ?", (digest[: history.DIGITS],))
        return found.fetchone() is not None

    @single_threaded_blas()
    def update(self, run: Run, digest: str = "", date: str = "") -> Status:
        """Add a finished log; one whose samples are in the history is not added again.

        Parameters
        ----------
        run : Run
            From :func:`gtau.read_run`. Its payload, if any, is part of what is expected.
        digest : str
            Identifies the log, beside its samples.
        date : str
            Time of recording, ISO 8601; now if omitted.

        Returns
        -------
        Status
            State after the log.

        Raises
        ------
        GtauError
            If the log does not fit the model; the history is then unchanged.
        """
        samples = run_digest(run)
        if self.seen(samples):
            with history.writing(self._database):
                self._database.execute("INSERT OR IGNORE INTO seen VALUES (?)", (digest[: history.DIGITS] or samples,))
                self._forgive(run.name)
            self._read()
            return Status(self.entry, copied=True)
        return self.update_statistics(statistics_of(self.model, run), samples, date or now(), digest or samples)

    def update_statistics(self, log: LogStatistics, digest: str, date: str, other: str = "") -> Status:
        """Add the statistics of a log that has this digest, and an ``other`` one, as :meth:`update` does."""
        digests = [digest, other or digest]
        numbers = np.concatenate([log.values, log.std, log.uneven, log.speed])
        with history.writing(self._database):
            self._read()
            if any(map(self.seen, digests)):
                return Status(self.entry, copied=True)
            row = history.add_row(self._database, digests, log.name, date, numbers)
            view = self._viewed([*self._rows, row])
            place = int(np.flatnonzero(view.ids == row.id)[0])
            alarm, repaired = judge(self.model, self.settings, view, log, place, self.alarm)
            if repaired is not None and self.alarm is not None:
                details = {"first": int(view.ids[view.place(self.alarm.since, self.alarm.date)]), "inside": repaired}
                history.add_event(self._database, date, "repaired", ", ".join(self.alarm.charts), details=details)
            self._set_alarm(alarm)
            self._forgive(log.name)
            condensed = history.condense(self._database)
        self._read(whole=condensed)
        return Status(self.entry)

    def _set_alarm(self, alarm: Alarm | None) -> None:
        """Write the state after the log that was added last."""
        text = "" if alarm is None else alarm.model_dump_json()
        self._database.execute("UPDATE logs SET alarm = ? WHERE id = (SELECT max(id) FROM logs)", (text,))

    def _forgive(self, log: str) -> None:
        """Drop the note that a log could not be read."""
        self._database.execute("DELETE FROM events WHERE kind = 'refused' AND subject = ?", (log,))

    @property
    def entry(self) -> Entry:
        """The log that was added last."""
        row, joints = max(self._rows, key=lambda row: row.id), self.model.robot.actuated
        names = [chart.name for chart in self.charts]
        values, std, uneven = np.split(row.numbers[: -len(joints)], [len(names), 2 * len(names)])
        shown = np.flatnonzero(np.isfinite(values))
        phase = "baseline" if self.count <= self.settings.baseline else "watching"
        return Entry(
            log=row.log,
            date=row.date,
            phase="aside" if self.view.odd[self.view.ids == row.id].any() else phase,  # type: ignore[arg-type]
            values={names[k]: float(values[k]) for k in shown},
            std={names[k]: float(std[k]) for k in shown},
            uneven=dict(zip(joints, uneven.tolist(), strict=True)),
            not_shown=tuple(name for name, value in zip(names, values, strict=True) if not np.isfinite(value)),
            alarm=self.alarm,
        )

    def set_aside(self, log: str, why: str) -> None:
        """Note a log that cannot be read, until it can."""
        with history.writing(self._database):
            self._forgive(log)
            history.add_event(self._database, now(), "refused", log, why)
        self._read()

    @takes(date=TEXT)
    def reset(self, date: str) -> None:
        """Begin a new baseline with the first log from a date on, as after maintenance; once for each date.

        Parameters
        ----------
        date : str
            Such as ``2026-03-28``, or with a time, ISO 8601.

        Raises
        ------
        GtauError
            It is not a date.
        """
        try:
            date = datetime.fromisoformat(date).isoformat()[: 19 if "T" in date else 10]
        except ValueError:
            raise GtauError(f"the date of the maintenance is '{date}'; write it as 2026-03-28.") from None
        if not any((event.kind, event.subject, event.undone) == ("reset", date, False) for event in self.events):
            begun = any(date <= row.date for row in self._rows)
            self._do("reset", date, "", {}, None if begun else self.alarm)

    @takes(note=TEXT)
    def acknowledge(self, note: str) -> None:
        """End an alarm: what has changed is accepted as the new reference; raises GtauError without an alarm."""
        if self.alarm is None or self.alarm.kind == "log":
            advice = "" if self.alarm is None else f"; forget the log '{self.alarm.since}' instead"
            raise GtauError(f"there is no alarm to acknowledge{advice or '; watch further logs first'}.")
        place = self.view.place(self.alarm.since, self.alarm.date)
        moved, _ = evidence_of(self.view, self.settings)
        means = mean_of(self.view.counted[place:])
        accepted = {
            name: float(mean)
            for name, mean, log_e in zip(self.view.names, means, moved.log_e, strict=True)
            if np.isfinite(mean) and (name in self.alarm.charts or log_e > 0)
        }
        details = {"first": int(self.view.ids[place]), "changed": accepted}
        self._do("acknowledge", self.alarm.since, note, details, None)

    @takes(log=TEXT)
    def forget(self, log: str) -> None:
        """Leave out a log that was not of this robot or of this state; raises GtauError where there is none."""
        names = self.view.logs
        if log not in names:
            some = ", ".join(names[-3:]) or "none yet"
            raise UnknownName(f"the history holds no log '{log}'; give one of its names, such as {some}.")
        self._do("forget", log, "", {}, None)

    @takes(subject=TEXT)
    def undo(self, subject: str) -> None:
        """Undo what was last done about a log (forgotten, or first of an acknowledged alarm) or a date of maintenance.

        Raises GtauError where nothing was.
        """
        events = [
            event for event in self.events if event.subject == subject and event.kind in DONE and not event.undone
        ]
        if not events:
            raise UnknownName(f"nothing was done about '{subject}'; give a log or a date of the report's events.")
        alarm = events[-1].details["alarm"]
        with history.writing(self._database):
            self._database.execute("UPDATE events SET undone = 1 WHERE id = ?", (events[-1].id,))
            history.add_event(self._database, now(), "undone", subject, events[-1].kind)
            self._set_alarm(None if alarm is None else Alarm.model_validate_json(alarm))
        self._read(whole=True)

    def _do(self, kind: str, subject: str, note: str, details: dict[str, Any], alarm: Alarm | None) -> None:
        """Note an event, and the alarm that remains after it."""
        before = None if self.alarm is None else self.alarm.model_dump_json()
        with history.writing(self._database):
            history.add_event(self._database, now(), kind, subject, note, {**details, "alarm": before})
            self._set_alarm(alarm)
        self._read(whole=True)


def _require_same(known: WatchSettings, begun: WatchSettings, given: dict[str, Any], folder: Path | None) -> None:
    """Refuse the history of another model, or other settings than those it was begun with."""
    if known.model != begun.model:
        raise GtauError(
            f"{folder} holds the history of another model (of robot '{known.robot}'); give that model, or another "
            "--out."
        )
    for name, value in given.items():
        option = f"--{name.replace('_', '-')}{'-per-year' * (name == 'false_alarms')}"
        if (before := getattr(known, name)) != value:
            raise GtauError(
                f"{folder} was begun with {option} {before:g}, not {value:g}: another value would change what its "
                "alarms mean; leave the option out, or give another --out."
            )


def model_digest(model: Result) -> str:
    """Compute the digest that identifies a model: its robot, gains and parameters."""
    document = to_document(model)
    known = {key: document[key] for key in ("robot_file", "drive_gains", "parameters") if key in document}
    return hashlib.sha256(repr(known).encode()).hexdigest()


def run_digest(run: Run) -> str:
    """Compute the SHA-256 of the samples of a run."""
    digest = hashlib.sha256()
    for samples in (run.time, run.position, run.command):
        digest.update(np.ascontiguousarray(samples).tobytes())
    return digest.hexdigest()


def now() -> str:
    """Return the time, ISO 8601, in seconds."""
    return datetime.now(UTC).isoformat(timespec="seconds")
