"""Watch a robot: judge it log by log against its model and its own past; the history is the only state."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from gtau.documents.files import folder_of
from gtau.documents.validation import TEXT, read_group, takes
from gtau.errors import GtauError, UnknownName
from gtau.estimation.results.model_file import to_document
from gtau.estimation.results.result import IdentifiedModel
from gtau.model.program import single_threaded_blas
from gtau.signals.reading.statements import Tolerances
from gtau.signals.run import Run
from gtau.watch.alarms import accepted, judge, view_of
from gtau.watch.history import Alarm, History, WatchSettings, now
from gtau.watch.statistics import LogStatistics, charts_of, statistics_of


class Status(BaseModel):
    """State after a log: estimates and standard deviations of the charts that the log shows, and the alarm.

    The ``phase`` is ``baseline``, ``watching`` or ``aside``. ``skipped`` is the reason why a log cannot be used, such
    as a robot at rest. ``copied`` means that the log was in the history; this is the state after the last log.
    """

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    log: str
    date: str
    phase: str = "aside"
    values: dict[str, FiniteFloat] = {}
    std: dict[str, FiniteFloat] = {}
    alarm: Alarm | None = None
    skipped: str = ""
    copied: bool = Field(default=False, exclude=True)

    @property
    def healthy(self) -> bool:
        """True without an alarm."""
        return self.alarm is None


DAYS = 30  # of a simulated healthy history


class Watch:
    """Watch a robot: feed it finished logs, and it reports whether the robot has changed.

    This is not a safety function: it detects wear and mistakes between logs and protects nobody.

    Parameters
    ----------
    model : IdentifiedModel
        From :func:`gtau.identify` or :meth:`gtau.load`.
    out : path, optional
        Folder of the history, continued if it exists; in memory if omitted. A history of another model is refused.
    tolerances : Tolerances, optional
        Tolerances of an experiment file.
    settings : int or float, optional
        ``baseline`` (number of healthy logs that form it, 10 if omitted), ``false_alarms_per_year`` of the whole fleet
        (1), ``robots`` in the fleet (1) and ``logs_per_year`` of each robot (365). A history keeps the values that it
        was begun with.
    """

    @takes(model=("the result of gtau.identify or gtau.load", (IdentifiedModel,)))
    def __init__(
        self,
        model: IdentifiedModel,
        out: str | Path | None = None,
        tolerances: Tolerances | None = None,
        **settings: float | None,
    ):
        self.model, self.charts = model, charts_of(model)
        given = {name: value for name, value in settings.items() if value is not None}
        document = to_document(model)
        identity = {key: document[key] for key in ("robot_file", "drive_gains", "parameters") if key in document}
        digest = hashlib.sha256(repr(identity).encode()).hexdigest()
        head = {"model": digest, "robot": model.robot.name, "charts": [chart.name for chart in self.charts]}
        begun = read_group(WatchSettings, "settings", {**head, **given})
        folder = None if out is None else folder_of(out)
        self.history = History(folder, begun)
        known = self.history.settings
        if known.model != begun.model:
            raise GtauError(
                f"{folder} holds the history of another model, of robot '{known.robot}'; give that, or another folder."
            )
        for name, value in given.items():
            if (before := getattr(known, name)) != value:
                raise GtauError(
                    f"{folder} was begun with {name.replace('_', ' ')} {before}, not {value}: another value would "
                    "change what its alarms mean; leave it out, or give another folder."
                )
        if tolerances is not None:
            with self.history.writing():
                self.history.save(known.model_copy(update={"tolerances": tolerances}))
        self.settings = self.history.settings
        self._read()

    def __repr__(self) -> str:
        alarm = "no alarm" if self.alarm is None else f"alarm since {self.alarm.since}"
        return f"Watch({self.model.robot.name!r}: {self.phase}, logs: {self.count}, {alarm})"

    def _read(self) -> None:
        """Read the history, to which other programs may have added."""
        self.events, self.alarm = self.history.events, self.history.alarm
        self.view = view_of(self.model, self.charts, self.history)

    @property
    def count(self) -> int:
        """Number of logs since the last maintenance that are not set aside."""
        return self.view.baseline

    @property
    def phase(self) -> str:
        """``baseline`` until the baseline is complete, then ``watching``."""
        return "baseline" if self.count < self.settings.baseline else "watching"

    @takes(run=("a run: gtau.read_run(log, model.recording.signals)", (Run,)), digest=TEXT, date=TEXT)
    @single_threaded_blas()
    def update(self, run: Run, digest: str = "", date: str = "") -> Status:
        """Add a finished log unless its samples are in the history; return the state after it.

        The model is loaded with the payload of the ``run``. A ``digest`` identifies the log in addition to its samples;
        ``date`` is its time of recording (ISO 8601), now if omitted. Raises GtauError if the log does not fit the
        model, and leaves the history unchanged.
        """
        arrays = (run.time, run.position, run.command)
        samples = hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()
        log = None if self.history.seen(samples) else statistics_of(self.model, run)
        return self._add(run.name, log, date or now(), samples, digest or samples)

    def update_statistics(self, log: LogStatistics, digest: str, date: str) -> Status:
        """Add the statistics of a log with this digest, see :meth:`update`."""
        return self._add(log.name, log, date, digest)

    def _add(self, name: str, log: LogStatistics | None, date: str, *digests: str) -> Status:
        """Add a log in one transaction, unless it has no statistics or the history knows one of its digests."""
        history = self.history
        with history.writing():
            known = log is None or any(map(history.seen, digests))
            history.remember(name, digests)
            if log is not None and not known:
                before = history.alarm
                number = history.add_row(name, date, [log.values, log.std, log.uneven, log.speed])
                view = view_of(self.model, self.charts, history)
                ids = view.logs.ids.tolist()
                alarm, inside = judge(self.model, view, log, ids.index(number), before)
                if before is not None and inside is not None:
                    warmings = [cause.size for cause in before.explanations if cause.kind == "warming"]
                    details = {"first": ids[view.logs.place(before)], "inside": ids[inside], "warmings": warmings}
                    history.add_event("repaired", ", ".join(before.charts), date, details=details)
                history.alarm = alarm
                history.condense()
        self._read()
        return self.status.model_copy(update={"copied": known})

    @property
    def status(self) -> Status:
        """The state after the log that was added last."""
        logs, at = self.view.logs, int(np.argmax(self.view.logs.ids))
        phase = "baseline" if self.count <= self.settings.baseline else "watching"
        values, std = (
            dict(zip(self.settings.charts, row[at].tolist(), strict=True)) for row in (logs.charts, logs.std)
        )
        shown = [name for name in values if np.isfinite(values[name])]
        return Status(
            log=logs.names[at],
            date=logs.dates[at],
            phase="aside" if self.view.odd[at].any() else phase,
            values={name: values[name] for name in shown},
            std={name: std[name] for name in shown},
            alarm=self.alarm,
        )

    def imagine(self, run: Run) -> None:
        """Simulate healthy days, which scatter by the covariance of a log, to predict visible changes."""
        log = statistics_of(self.model, run)
        values, vectors = np.linalg.eigh(log.covariance)
        root, rng = vectors * np.sqrt(np.maximum(values, 0.0)), np.random.default_rng(0)
        with self.history.writing():
            for day in range(DAYS):
                drawn = np.where(log.shown, root @ rng.normal(size=len(root)), np.nan)
                date = str(np.datetime64("2000-01-01") + np.timedelta64(day, "D"))
                self.history.add_row(run.name, date, [drawn, log.std, log.uneven, log.speed])
        self._read()

    def set_aside(self, log: str, why: str) -> None:
        """Note a log that cannot be read, until it can."""
        with self.history.writing():
            self.history.remember(log, ())
            self.history.add_event("refused", log, note=why)
        self._read()

    @takes(date=TEXT)
    def reset(self, date: str) -> None:
        """Begin a new baseline with the first log from a date on, as after maintenance; once for each date.

        The date is ISO 8601, such as ``2026-03-28``, or with a time; raises GtauError for other texts.
        """
        try:
            date = datetime.fromisoformat(date).isoformat()[: 19 if "T" in date else 10]
        except ValueError:
            raise GtauError(f"the date of the maintenance is '{date}'; write it as 2026-03-28.") from None
        if not any((event.kind, event.subject, event.undone) == ("reset", date, False) for event in self.events):
            self._do("reset", date, None if (date <= self.view.logs.dates).any() else self.alarm)

    @takes(note=TEXT)
    def acknowledge(self, note: str) -> None:
        """End an alarm and accept the change as the new reference; raises GtauError without an alarm."""
        if self.alarm is None or self.alarm.kind == "log":
            advice = "" if self.alarm is None else f"; forget the log '{self.alarm.since}' instead"
            raise GtauError(f"there is no alarm to acknowledge{advice or '; watch further logs first'}.")
        self._do("acknowledge", self.alarm.since, note=note, details=accepted(self.view, self.alarm))

    @takes(log=TEXT)
    def forget(self, log: str) -> None:
        """Leave out a log of another robot or state; raises GtauError if the history has no such log."""
        names = self.view.logs.names.tolist()
        if log not in names:
            advice = (
                f"give one of its names, such as {', '.join(names[-3:])}" if names else "it is empty, watch logs first"
            )
            raise UnknownName(f"the history holds no log '{log}'; {advice}.")
        self._do("forget", log)

    @takes(subject=TEXT)
    def undo(self, subject: str) -> None:
        """Undo the last action on a log or a maintenance date; raises GtauError if there is none."""
        events = [event for event in self.events if event.subject == subject and not event.undone]
        done = [event for event in events if "alarm" in (event.details or {})]  # actions of the user
        if not done:
            raise UnknownName(f"nothing was done about '{subject}'; give a log or a date of the report's events.")
        with self.history.writing():
            self.history.undo(done[-1])
        self._read()

    def _do(
        self, kind: str, subject: str, alarm: Alarm | None = None, note: str = "", details: Mapping[str, object] = {}
    ) -> None:
        with self.history.writing():
            before = self.alarm and self.alarm.model_dump_json()
            self.history.add_event(kind, subject, note=note, details={**details, "alarm": before})
            self.history.alarm = alarm
        self._read()
