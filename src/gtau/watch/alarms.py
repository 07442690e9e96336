"""Judge a robot after a log: beyond tolerance, changed, a single outlier, repaired or healthy.

The quantities are the charts of the logs, except that each joint has one friction: Coulomb and viscous friction
together at the mean speed, relative to the model, because a motion hardly separates the two. Warming changes the
friction of all joints by one factor, their median; the change beyond this factor is compared from log to log.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import stdtrit

from gtau.estimation.results.result import IdentifiedModel
from gtau.robots.robot import PLAIN_FRICTION
from gtau.watch.causes import SIGNAL_FAULTS, causes_of, contacts_of, signal_faults
from gtau.watch.detectors import FEWEST, WINDOW, ChangeEvidence, alone, evidence, far_off, mean_of, median
from gtau.watch.history import Alarm, Cause, History, Logs, WatchSettings
from gtau.watch.statistics import RESIDUAL, LogStatistics, Quantity, identified

WEEK, WEEKLY = 7.0, 7  # days, and logs that count as a week where they have one date
FEWEST_OF_WEEK = 3  # logs of a week; earlier logs fill up a shorter week
ODD = 5.0  # standard deviations of an outlier, and tolerances from the model while there are too few logs to compare
COMMON = 2  # least joints for a median of friction; of two, a change of one is seen in both by half
LOUDER = float(np.log(2))  # growth of a residual that counts as odd
RATED = 50.0  # kg of a payload where none is stated; no load is twice as heavy
SIZES = np.geomspace(0.5, 60.0, 25)  # candidates for the smallest visible change, in standard deviations
PERIODS = (7, 30)  # days within which it is visible
DRAWS, FOUND = 40, 0.9  # simulated histories with white scatter, and the share in which the change must be found
MOST = 120  # last logs that the simulated logs follow


@dataclass(frozen=True, eq=False)
class View:
    """The ``logs`` of a history and the quantities to judge.

    The quantities have ``values`` and ``std`` (N, m), NaN where not counted, a ``tolerance`` about a ``reference``
    (m,) and, relative to an identified gain, the standard deviation ``model_std`` of the gain. ``logged`` (N, m) has
    the values of all logs not forgotten. ``warmings`` are the sizes of earlier changes of all joints that went away:
    only a larger one raises a new alarm.
    """

    settings: WatchSettings
    logs: Logs
    quantities: tuple[Quantity, ...]
    logged: np.ndarray
    values: np.ndarray
    std: np.ndarray
    tolerance: np.ndarray
    reference: np.ndarray
    model_std: np.ndarray
    warmings: list[float]

    @property
    def names(self) -> list[str]:
        """Names of the quantities."""
        return [quantity.name for quantity in self.quantities]

    @cached_property
    def excess(self) -> np.ndarray:
        """Values (N, m), friction without the factor common to all joints, so that warm days are no changes."""
        x, friction = self.values.copy(), self.has_kind("friction")
        rows = np.isfinite(x[:, friction]).sum(axis=1) >= COMMON
        x[np.ix_(rows, friction)] -= median(x[np.ix_(rows, friction)].T)[:, None]
        return x

    @cached_property
    def odd(self) -> np.ndarray:
        """Mask (N, m) of values of a single log, far from the others (if few, the model) and beyond tolerance."""
        shown = np.isfinite(self.excess)
        few = shown.sum(axis=0) < FEWEST
        change = self.excess - np.where(few, self.reference, median(self.excess))
        size = np.abs(change)
        material = np.where(self.has_kind(RESIDUAL), LOUDER, self.tolerance)
        known = self.has_kind("m", "gain")  # the model is right about these in other motions too
        far = np.where(few, known & (size > ODD * material), far_off(self.excess) & (size > material))
        far &= size > ODD * np.nan_to_num(self.std)
        rows, odd = shown.any(axis=1), np.zeros(shown.shape, dtype=bool)
        single = alone(np.where(far, np.sign(change), 0.0)[rows])
        odd[rows] = single & ~(far[rows] & ~single).any(axis=1, keepdims=True)
        return odd

    @cached_property
    def counted(self) -> np.ndarray:
        """Values (N, m) without outlying logs."""
        return np.where(self.odd.any(axis=1, keepdims=True), np.nan, self.values)

    @cached_property
    def compared(self) -> np.ndarray:
        """Values (N, m) compared from log to log: :attr:`excess` without outlying logs."""
        return np.where(np.isfinite(self.counted), self.excess, np.nan)

    def judged(self, kind: str) -> np.ndarray:
        """Values (N, m) that an alarm of a ``kind`` judges; tolerances include the common factor of friction."""
        return self.counted if kind == "tolerance" else self.compared

    @cached_property
    def there(self) -> np.ndarray:
        """Rows of the logs that count since the last maintenance."""
        return np.flatnonzero(np.isfinite(self.counted).any(axis=1))

    @property
    def baseline(self) -> int:
        """Number of logs that count since the last maintenance."""
        return int(self.logs.counts[self.there].sum())

    def certain(self, proof: ChangeEvidence) -> np.ndarray:
        """Mask of e-detectors beyond their limit, which grows with the number of quantities."""
        quantities = max(np.isfinite(self.values).any(axis=0).sum(), 1)
        return (proof.log_e >= float(np.log(self.settings.limit * quantities))) & proof.confirmed

    def has_kind(self, *kinds: str) -> np.ndarray:
        """Mask (m,) of the quantities of some kinds."""
        return np.array([quantity.kind in kinds for quantity in self.quantities])


def view_of(model: IdentifiedModel, charts: Sequence[Quantity], history: History) -> View:
    """Select the logs that count, given the events: maintenance, forgotten and repaired logs, new references."""
    logs = history.logs(len(charts), len(model.robot.actuated))
    parts = [chart._replace(kind=chart.group, unit="1") if chart.group == "friction" else chart for chart in charts]
    quantities = tuple(dict.fromkeys(parts))
    speed = dict(zip(model.robot.actuated, np.nan_to_num(median(logs.speeds), nan=1.0), strict=True))
    known = [identified(model, chart.name) if chart.group == "friction" else 1.0 for chart in charts]
    S = np.zeros((len(charts), len(quantities)))  # combinations of charts
    for k, chart in enumerate(charts):
        S[k, quantities.index(parts[k])] = speed[chart.joint] if chart.kind == "fv" else 1.0
    total = known @ S
    S /= np.where(total > 0, total, np.nan)
    shown = np.isfinite(logs.charts).astype(float) @ (S != 0) > 0
    values = np.where(shown, np.nan_to_num(logs.charts) @ S, np.nan)
    logged, reference = values.copy(), np.zeros(len(quantities))
    std = np.where(shown, np.nan_to_num(logs.std) @ np.abs(S), np.nan)
    limits = history.settings.tolerances
    accepted = {"m": limits.mass, **limits.model_dump(include={"gain", "friction", "zero", "delay"})}
    tolerance = np.array([accepted.get(quantity.kind, np.inf) for quantity in quantities])
    vague = median(std) > np.maximum(tolerance, np.abs(median(values)) / ODD)
    tolerance[vague] = np.inf  # one log does not determine these; errors of the model are larger
    gain_std = {("gain", joint): (gain.rel_std or 0.0) / 100 for joint, gain in model.drive_gains.items()}
    model_std = np.array([gain_std.get((quantity.kind, quantity.joint), 0.0) for quantity in quantities])
    view = View(history.settings, logs, quantities, logged, values, std, tolerance, reference, model_std, [])
    for event in (event for event in history.events if not event.undone):
        if event.kind == "reset" and (logs.dates >= event.subject).any():
            values[logs.dates < event.subject] = np.nan
        elif event.kind == "forget":
            values[logs.names == event.subject] = logged[logs.names == event.subject] = np.nan
        elif event.kind == "repaired":
            values[(logs.ids >= event.details["first"]) & (logs.ids < event.details["inside"])] = np.nan
            view.warmings.extend(event.details.get("warmings", ()))
        elif event.kind == "acknowledge":
            changed = [view.names.index(name) for name in event.details["changed"]]
            values[np.ix_(logs.ids < event.details["first"], changed)] = np.nan
            reference[changed] = [*event.details["changed"].values()]
    return view


def judge(
    model: IdentifiedModel, view: View, log: LogStatistics, row: int, previous: Alarm | None
) -> tuple[Alarm | None, int | None]:
    """Judge the robot after the log in a ``row``: the alarm, if any, and the row since which it is repaired."""
    if previous is not None and previous.kind == "log":
        previous = None
    if view.odd[row].any():
        return previous or _alarm("log", model, view, log, np.flatnonzero(view.odd[row]), row), None
    if previous is not None:
        healthy, changed = np.array(previous.healthy), np.array(previous.changed)
        x = view.judged(previous.kind)[:, [view.names.index(name) for name in previous.charts]]
        back = _last(x, (np.abs(x - healthy) / np.abs(changed - healthy) > 0.5).any(axis=1))
        if len(back):  # all of these are nearer to the healthy means
            spent = np.ptp(view.logs.days[back])
            repaired = spent >= WEEK or (spent < 1 and len(back) >= WEEKLY)
            return (None, int(back[0])) if repaired else (previous, None)
    alarm = _fresh(model, view, log)
    if alarm is not None and previous is not None:
        alarm = alarm.model_copy(update={"since": previous.since, "date": previous.date})
    return alarm or previous, None


def _fresh(model: IdentifiedModel, view: View, log: LogStatistics) -> Alarm | None:
    start, changed = 0, np.zeros(0, dtype=int)
    if view.baseline > view.settings.baseline:
        proof = _evidence_of(view)
        certain = view.certain(proof)
        changed = np.array([k for k in np.argsort(-proof.log_e) if certain[k]], dtype=int)
        if len(changed):
            start = int(view.there[-WINDOW:][proof.start[changed[0]]])
    if (far := beyond(view, start)).any():
        x = np.abs(view.counted - view.reference)[:, far]
        last = [*_last(x, ~(x > view.tolerance[far]).any(axis=1)), view.there[-1]]
        alarm = _alarm("tolerance", model, view, log, np.flatnonzero(far), int(last[0]))
        parts = [part for cause in alarm.explanations for part in cause.parts]  # without any, it may be the motion
        if any(_is_beyond(view, part, far) for part in parts) or (not parts and beyond(view, start, 2.0).any()):
            return alarm
    return _alarm("change", model, view, log, changed, start) if len(changed) else None


def _is_beyond(view: View, cause: Cause, far: np.ndarray) -> bool:
    """Return whether a cause and its quantity, by ``far`` (m,), are both beyond tolerance."""
    if cause.kind in ("rate", *SIGNAL_FAULTS):
        return True  # it falsifies all quantities
    kind = "friction" if cause.quantity in PLAIN_FRICTION else cause.quantity
    size = np.inf if cause.kind == "units" else abs(cause.size if cause.relative is None else cause.relative)
    if cause.kind == "warming":
        size -= max((abs(before) for before in view.warmings if before * cause.size > 0), default=0.0)
    concerned = [cause.joint in ("", quantity.joint) for quantity in view.quantities] & view.has_kind(kind)
    return bool((concerned & far & (size > view.tolerance)).any())


def _evidence_of(view: View) -> ChangeEvidence:
    """Compute the evidence of a change over the last logs."""
    rows = view.there[-WINDOW:]
    learning = view.settings.baseline if view.baseline <= WINDOW else FEWEST
    return evidence(view.compared[rows], view.std[rows] ** 2, learning, view.has_kind(RESIDUAL))


def accepted(view: View, alarm: Alarm) -> dict[str, object]:
    """Return the new reference after a change: the first log of an alarm, and the means by quantity since then."""
    first = view.logs.place(alarm)
    moved, means = _evidence_of(view).log_e > 0, mean_of(view.counted[first:])
    changed = {
        name: float(mean)
        for name, mean, has_moved in zip(view.names, means, moved, strict=True)
        if np.isfinite(mean) and (has_moved or name in alarm.charts)
    }
    return {"first": int(view.logs.ids[first]), "changed": changed}


def _last(x: np.ndarray, excluded: np.ndarray) -> np.ndarray:
    """Find the rows of ``x`` with a value after the last ``excluded`` one."""
    rows = np.flatnonzero(np.isfinite(x).any(axis=1))
    return rows[len(rows) - int(np.argmax([*excluded[rows][::-1], True])) :]


def _alarm(kind: str, model: IdentifiedModel, view: View, log: LogStatistics, columns: np.ndarray, start: int) -> Alarm:
    """Make an alarm for the quantities ``columns`` since the row ``start``, with its explanations."""
    logs, rows, x = view.logs, view.there, view.judged(kind)
    before, after = rows[rows < start], rows[rows >= start]
    if kind == "log":
        x, before, after = view.excess, rows, np.array([start])
    by_model = kind == "tolerance" or len(before) < FEWEST
    healthy = view.reference if by_model else mean_of(x[before])
    changed = mean_of(x[after])
    columns = columns[np.isfinite(healthy[columns]) & np.isfinite(changed[columns])]
    chart_means = np.zeros(logs.charts.shape[1]) if by_model else mean_of(logs.charts[before])
    uneven = np.nanmax(logs.uneven[before], axis=0, initial=1.0)
    causes = signal_faults(model, log, chart_means, mean_of(logs.speeds[before]), uneven)
    if not causes and not view.has_kind(RESIDUAL)[columns].all():
        rated = view.settings.tolerances.rated_payload or RATED
        causes = causes_of(model, log, logs.charts[before], logs.charts[after], chart_means, 2 * rated)
    return Alarm(
        kind=kind,  # type: ignore[arg-type]  # pydantic checks it
        explanations=causes or contacts_of(log, uneven),
        since=logs.names[start],
        date=logs.dates[start],
        charts=tuple(view.names[k] for k in columns),
        healthy=tuple(healthy[columns].tolist()),
        changed=tuple(changed[columns].tolist()),
    )


def week_of(view: View, since: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Average the last week, at least a few logs, ``since`` a row: means and half the 95 % intervals (m,)."""
    days = view.logs.days
    seen = np.isfinite(view.counted) & (np.arange(len(days)) >= since)[:, None]
    recent = (days > days.max(initial=-np.inf) - WEEK)[:, None]
    part = seen & (recent | (np.cumsum(seen[::-1], axis=0)[::-1] <= FEWEST_OF_WEEK))
    x, n = np.where(part, view.counted, np.nan), part.sum(axis=0)
    mean, freedom = mean_of(x), np.maximum(n - 1, 1)
    scatter = np.nansum((x - mean) ** 2, axis=0) / freedom
    friction = view.has_kind("friction")  # whose two parts compensate each other
    jackknife = np.where(friction, 0.0, mean_of(np.where(part, np.nan_to_num(view.std) ** 2, np.nan)))
    mean_half = stdtrit(freedom, 0.975) * np.sqrt(np.fmax(scatter, jackknife) / np.maximum(n, 1))
    half = np.hypot(mean_half, 1.96 * view.model_std)
    few = n < FEWEST_OF_WEEK
    return np.where(few, np.nan, mean), np.where(few, np.nan, half)


def beyond(view: View, since: int = 0, times: float = 1.0) -> np.ndarray:
    """Find the quantities (m,) whose whole interval lies beyond ``times`` their tolerance."""
    mean, half = week_of(view, since)
    return np.asarray(np.abs(mean - view.reference) - half > times * view.tolerance)


def visible_changes(view: View) -> np.ndarray:
    """Compute the smallest detectable change of each quantity within a week, within a month, and slowly: (m, 3).

    The last logs are continued for such a period with the same scatter, and judged by the detector and the tolerance;
    a slow change is detected by its tolerance. NaN where no change is detected.
    """
    rows = view.there[-MOST:]
    x, std = view.compared[rows], view.std[rows]
    if len(rows) < FEWEST:
        return np.full((x.shape[1], len(PERIODS) + 1), np.nan)
    scale = 1.4826 * median(np.abs(x - median(x)))
    columns = np.flatnonzero(scale > 0)
    sizes = np.outer(scale[columns], SIZES)
    before, white = (np.repeat(part[:, columns], len(SIZES), axis=1) for part in (x, std))
    smallest = _seen_by_tolerance(view)
    for p, logs in _periods(view):
        values = np.vstack([before, np.resize(before[-logs:], (logs, before.shape[1])) + sizes.ravel()])
        proof = evidence(values, np.resize(white, values.shape) ** 2, FEWEST)
        change = np.where(view.certain(proof).reshape(sizes.shape), sizes, np.inf).min(axis=1)
        smallest[columns, p] = np.minimum(smallest[columns, p], change)
    return np.where(np.isfinite(smallest), smallest, np.nan)


def power(view: View) -> np.ndarray:
    """Compute :func:`visible_changes` for uncorrelated days, found in the share ``FOUND`` of simulated cases."""
    rows = view.there
    shown = np.isfinite(view.compared[rows]).any(axis=0)
    scale = np.full(len(shown), np.nan)
    scale[shown] = np.nanstd(view.compared[rows][:, shown], axis=0)
    smallest = _seen_by_tolerance(view)
    for p, logs in _periods(view):
        x = np.random.default_rng(0).normal(size=(len(rows) + logs, len(SIZES), DRAWS))
        x[len(rows) :] += SIZES[:, None]
        proof = evidence(x.reshape(len(x), -1), np.ones((len(x), SIZES.size * DRAWS)), view.settings.baseline)
        share = view.certain(proof).reshape(len(SIZES), DRAWS).mean(axis=1)
        smallest[:, p] = np.fmin(smallest[:, p], scale * SIZES[share >= FOUND].min(initial=np.inf))
    return np.where(np.isfinite(smallest), smallest, np.nan)


def _seen_by_tolerance(view: View) -> np.ndarray:
    return np.tile((view.tolerance + 2 * np.nan_to_num(week_of(view)[1], nan=np.inf))[:, None], len(PERIODS) + 1)


def _periods(view: View) -> Iterator[tuple[int, int]]:
    """Count the logs of each period, with its number."""
    logs = np.array(PERIODS) * view.settings.logs_per_year / 365
    return enumerate(np.clip(np.rint(logs).astype(int), 2, WINDOW // 2).tolist())
