"""Watch a robot: update its charts log by log, and raise an alarm."""

from __future__ import annotations

import hashlib
from collections import deque
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import numpy as np

from gtau.documents.files import folder_of
from gtau.documents.validation import NUMBER, TEXT, WHOLE, takes
from gtau.errors import GtauError
from gtau.estimation.results.model_file import to_document
from gtau.estimation.results.result import Result
from gtau.model.interpreter.program import single_threaded_blas
from gtau.robots.robot import PLAIN_FRICTION
from gtau.signals.run import Run
from gtau.watch.alarms import alarm_of
from gtau.watch.detectors import (
    FEWEST,
    MEMORY,
    OF_FRICTION,
    WINDOW,
    Baseline,
    Chart,
    Evidence,
    add,
    baseline_of,
    combined,
    cusum_limit,
    evidence,
)
from gtau.watch.quantities import Quantity
from gtau.watch.state import Alarm, Entry, Settings, append, open_history, reset_date
from gtau.watch.statistics import RESIDUAL, LogStatistics, statistics_of


@dataclass(frozen=True, eq=False)
class Status:
    """Entry in the history, charts (k,) with baseline and evidence, and the larger CUSUM of each over its limit."""

    entry: Entry
    charts: tuple[Quantity, ...]
    baseline: Baseline
    evidences: tuple[Evidence, ...]
    cusums: np.ndarray

    @property
    def healthy(self) -> bool:
        """True without an alarm."""
        return self.entry.alarm is None


class Watch:
    """Watch a robot: feed it finished logs, oldest first, and it reports whether the robot has changed.

    This is not a safety function: it detects wear and mistakes between logs and protects nobody.

    Parameters
    ----------
    model : Result
        From :func:`gtau.identify` or :meth:`gtau.Result.load`.
    out : path, optional
        Folder of the history, continued if it exists; in memory if omitted.
    baseline : int
        Number of healthy logs that form the baseline.
    false_alarms_per_year : float
        False alarms of the whole fleet per year.
    robots : int
        Number of robots in the fleet.
    logs_per_year : float
        Logs of each robot per year.

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
        baseline: int = 10,
        false_alarms_per_year: float = 1.0,
        robots: int = 1,
        logs_per_year: float = 365.0,
    ):
        if baseline < FEWEST:
            raise GtauError(f"a baseline of {baseline} logs is too short; use at least {FEWEST} healthy logs.")
        if not (false_alarms_per_year > 0 and robots >= 1 and logs_per_year > 0):
            raise GtauError("false alarms per year, robots and logs per year are positive numbers; correct them.")
        self.model = model
        self.settings = Settings(
            model=model_digest(model),
            robot=model.robot.name,
            baseline=baseline,
            false_alarms=false_alarms_per_year,
            robots=robots,
            logs_per_year=logs_per_year,
        )
        self.folder = None if out is None else folder_of(out)
        self.seen: set[str] = set()
        self.began = self.maintained = ""  # dates of the last maintenance, and of one still without a log
        self.alarm: Alarm | None = None
        self._clear()
        for entry in () if self.folder is None else open_history(self.folder, self.settings):
            self._take(entry)

    def _clear(self) -> None:
        """Begin a baseline."""
        self.names: tuple[str, ...] = ()
        self.charts: dict[str, Chart] = {}
        self.reference: dict[str, float] = {}  # variance by the formula of the first log in which a chart is observable
        self.first: list[dict[str, float]] = []  # values of the baseline
        self.recent: deque[Entry] = deque(maxlen=WINDOW)
        self.count = 0
        self.uneven: dict[str, float] = {}
        self.alarm = None

    @property
    def limit(self) -> float:
        """Limit of the mean e-detector: the average number of logs between false alarms of this robot."""
        return self.settings.limit

    @property
    def phase(self) -> Literal["baseline", "watching"]:
        """``baseline`` until the baseline is complete, then ``watching``."""
        return "baseline" if self.count < self.settings.baseline else "watching"

    @property
    def baseline(self) -> Baseline:
        """Healthy mean and scatter of the charts in ``names``."""
        table = [[values.get(name, np.nan) for name in self.names] for values in self.first]
        return baseline_of(np.reshape(np.array(table, dtype=float), (len(table), len(self.names))))

    @takes(date=TEXT)
    def reset(self, date: str) -> None:
        """Begin a new baseline with the first further log from a date on, as after maintenance; once for each date.

        Parameters
        ----------
        date : str
            Such as ``2026-03-28``, or with a time, ISO 8601.

        Raises
        ------
        GtauError
            It is not a date.
        """
        date = reset_date(date)
        self.maintained = date if date > self.began else ""

    @single_threaded_blas()
    def update(self, run: Run, digest: str = "", date: str = "") -> Status:
        """Add a finished log.

        Parameters
        ----------
        run : Run
            From :func:`gtau.read_run`. Its payload, if any, is part of what is expected.
        digest : str
            Identifies the log; that of its samples if omitted.
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
        return self.update_statistics(statistics_of(self.model, run), digest or run_digest(run), date or now())

    def update_statistics(self, log: LogStatistics, digest: str, date: str) -> Status:
        """Add the statistics of a log, as :meth:`update` does."""
        begins = bool(self.maintained) and date >= self.maintained
        names, shown = [chart.name for chart in log.charts], np.flatnonzero(log.shown)
        values, std, formula = (
            {names[k]: float(column[k]) for k in shown}
            for column in (log.values, log.std, np.sqrt(np.diag(log.formula)))
        )
        entry = Entry(
            log=log.name,
            digest=digest,
            date=date,
            begins=self.maintained if begins else "",
            values=values,
            std=std,
            formula=formula,
            uneven=dict(zip(log.joints, map(float, log.uneven), strict=True)),
            not_shown=log.not_shown,
            phase="baseline" if begins else self.phase,
        )
        self._take(entry)
        evidences = {name: evidence(chart) for name, chart in self.charts.items()}
        limit = cusum_limit(self.limit * max(len(self.charts), 1))
        cusums = np.array([max(chart.cusum) / limit for chart in self.charts.values()])
        if entry.phase == "watching":
            log_e = combined(np.array([chart.log_e for chart in evidences.values()]))
            if log_e >= np.log(self.limit):
                self.alarm = alarm_of(self.model, list(self.recent), self.charts, evidences, log, self.uneven)
            state = {
                "log_e": log_e if np.isfinite(log_e) else None,
                "cusum": float(cusums.max(initial=0.0)),
                "leading": max(evidences, key=lambda name: evidences[name].log_e, default=""),
                "alarm": self.alarm,
            }
            self.recent[-1] = entry = entry.model_copy(update=state)
        if self.folder is not None:
            append(self.folder, entry)
        charts = {chart.name: chart for chart in log.charts}
        listed = tuple(charts[name] for name in self.names if name in charts)
        return Status(entry, listed, self.baseline, tuple(evidences.values()), cusums)

    def _take(self, entry: Entry) -> None:
        """Add an entry to the charts."""
        if entry.begins:
            self._clear()
            self.began, self.maintained = entry.begins, ""
        for name, value in entry.values.items():
            variance = entry.formula[name] ** 2
            known = self.reference.setdefault(name, variance)
            chart = self.charts.get(name) or _begun(name, self.settings.baseline)
            self.charts[name] = add(chart, value, max(1.0, variance / known if known > 0 else 1.0))
        if self.phase == "baseline":
            self.first.append(dict(entry.values))
            for joint, uneven in entry.uneven.items():
                self.uneven[joint] = max(self.uneven.get(joint, 1.0), uneven)
        self.names = tuple(self.charts)
        self.recent.append(entry)
        self.seen.add(entry.digest)
        self.count += 1
        self.alarm = entry.alarm or self.alarm


def _begun(name: str, baseline: int) -> Chart:
    """Begin the chart of this name."""
    kind = name.partition("_")[0]
    return Chart(baseline, kind == RESIDUAL, OF_FRICTION if kind in (*PLAIN_FRICTION, RESIDUAL) else MEMORY)


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
