"""What the logs of a history say of each watched quantity, against the model and its tolerances.

Quantities are the charts of the logs, but friction is one a joint: Coulomb and viscous together, at the mean speed of
the motion and relative to the model's, as a motion hardly separates the two. Warming changes the friction of all
joints by one factor; their median is that factor, and what is compared from log to log is what exceeds it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from gtau.estimation.results.result import Result
from gtau.robots.parameter import Parameter
from gtau.robots.robot import PLAIN_FRICTION
from gtau.signals.reading.statements import Tolerances
from gtau.watch.detectors import FEWEST, alone, far_off, median
from gtau.watch.history import Event, LogRow
from gtau.watch.quantities import Quantity
from gtau.watch.statistics import RESIDUAL

WEEK = 7.0  # days
FEWEST_OF_WEEK = 3  # logs of a week; fewer are filled up with earlier ones
ODD = 5.0  # standard deviations, and tolerances from the model where there are too few logs to compare with
COMMON = 3  # joints from which the friction of all has a median that one of them does not set
LOUDER = float(np.log(2))  # growth of a residual that counts as odd


@dataclass(frozen=True, eq=False)
class View:
    """Logs by date, and what is judged of them.

    Numbers, names, dates, days and counts of the N rows; ``charts`` (N, k) as logged, and ``uneven`` (N, n); values and
    standard deviations (N, m) of the quantities, NaN where not counted, with ``tolerance`` and ``reference`` (m,).
    ``odd`` (N, m) are values by which a log is odd by itself; those of an odd log count nowhere.
    """

    ids: np.ndarray
    logs: tuple[str, ...]
    dates: tuple[str, ...]
    counts: np.ndarray
    charts: np.ndarray
    uneven: np.ndarray
    quantities: tuple[Quantity, ...]
    values: np.ndarray
    std: np.ndarray
    tolerance: np.ndarray
    reference: np.ndarray
    odd: np.ndarray

    @property
    def names(self) -> list[str]:
        """Names of the quantities."""
        return [quantity.name for quantity in self.quantities]

    @property
    def counted(self) -> np.ndarray:
        """Values (N, m) without those of odd logs."""
        return np.where(self.odd.any(axis=1, keepdims=True), np.nan, self.values)

    @property
    def compared(self) -> np.ndarray:
        """Values (N, m) that are compared from log to log: friction less the factor common to all joints."""
        x, friction = self.counted, self.of_kind("friction")
        rows = np.isfinite(x[:, friction]).sum(axis=1) >= COMMON
        x[np.ix_(rows, friction)] -= np.nanmedian(x[np.ix_(rows, friction)], axis=1, keepdims=True)
        return x

    @property
    def baseline(self) -> int:
        """Number of logs that count since the last maintenance."""
        return int(self.counts[np.isfinite(self.counted).any(axis=1)].sum())

    @property
    def days(self) -> np.ndarray:
        """Days (N,) since 1970."""
        return np.array([day_of(date) for date in self.dates])

    def place(self, log: str, date: str) -> int:
        """Find the row of a log, the first where there is none."""
        return next((k for k, row in enumerate(zip(self.logs, self.dates, strict=True)) if row == (log, date)), 0)

    def of_kind(self, *kinds: str) -> np.ndarray:
        """Find the quantities (m,) of these kinds."""
        return np.array([quantity.kind in kinds for quantity in self.quantities])


def day_of(date: str) -> float:
    """Convert a date, ISO 8601, to days since 1970."""
    return float(np.datetime64(date[:19], "s").astype(float)) / 86400


def view_of(
    model: Result, charts: Sequence[Quantity], rows: Sequence[LogRow], events: Sequence[Event], tolerances: Tolerances
) -> View:
    """Take the logs that count after what was done: maintenance, forgotten and repaired logs, new references."""
    rows, k = sorted(rows, key=lambda row: (row.date, row.id)), len(charts)
    numbers = np.array([row.numbers for row in rows]).reshape(len(rows), -1 if rows else 2 * k)
    of_charts, of_std, (uneven, speed) = numbers[:, :k], numbers[:, k : 2 * k], np.split(numbers[:, 2 * k :], 2, axis=1)
    plain = [k for k, chart in enumerate(charts) if chart.kind not in PLAIN_FRICTION]
    joints = list(dict.fromkeys(chart.joint for chart in charts if chart.kind in PLAIN_FRICTION))
    quantities = (*(charts[k] for k in plain), *(Quantity("friction", joint, "1") for joint in joints))
    S = _friction(model, charts, joints, speed)
    seen = np.isfinite(of_charts).astype(float) @ (S != 0) > 0
    values = np.hstack([of_charts[:, plain], np.where(seen, np.nan_to_num(of_charts) @ S, np.nan)])
    std = np.hstack([of_std[:, plain], np.where(seen, np.nan_to_num(of_std) @ np.abs(S), np.nan)])
    limits = {"m": tolerances.mass, **tolerances.model_dump(include={"gain", "friction", "zero", "delay"})}
    tolerance = np.array([limits.get(quantity.kind, np.inf) for quantity in quantities])
    vague = median(std) > np.maximum(tolerance, np.abs(median(values)) / ODD)
    tolerance[vague] = np.inf  # one log does not determine these, and errors of the model exceed them
    logs, dates = tuple(row.log for row in rows), tuple(row.date for row in rows)
    ids, counts = (np.array([getattr(row, name) for row in rows], dtype=int) for name in ("id", "count"))
    reference, names = np.zeros(len(quantities)), [quantity.name for quantity in quantities]
    for event in events:
        if event.undone:
            continue
        if event.kind == "reset" and any(date >= event.subject for date in dates):
            values[[date < event.subject for date in dates]] = np.nan
        elif event.kind == "forget":
            values[[event.subject == log for log in logs]] = np.nan
        elif event.kind == "repaired":
            values[(ids >= event.details["first"]) & (ids < event.details["inside"])] = np.nan
        elif event.kind == "acknowledge":
            known = {names.index(name): value for name, value in event.details["changed"].items()}
            values[np.ix_(ids < event.details["first"], [*known])] = np.nan
            reference[[*known]] = [*known.values()]
    odd = np.zeros(values.shape, dtype=bool)
    view = View(ids, logs, dates, counts, of_charts, uneven, quantities, values, std, tolerance, reference, odd)
    return replace(view, odd=_odd(view))


def _friction(model: Result, charts: Sequence[Quantity], joints: list[str], speeds: np.ndarray) -> np.ndarray:
    """Find the combinations (k, joints) of charts that are friction at the mean speed, relative to the model's."""
    known, S = {**model.parameters, **model.friction_parameters}, np.zeros((len(charts), len(joints)))
    for j, joint in enumerate(joints):
        columns = [k for k, chart in enumerate(charts) if chart.joint == joint and chart.kind in PLAIN_FRICTION]
        speed = median(speeds[:, [model.robot.actuated.index(joint)]])[0] if len(speeds) else 1.0
        shares = [np.nan_to_num(speed, nan=1.0) if charts[k].kind == "fv" else 1.0 for k in columns]
        sizes = [getattr(known.get(Parameter(charts[k].kind, joint)), "value", None) or 0.0 for k in columns]
        total = float(np.dot(shares, sizes))
        S[columns, j] = np.array(shares) / total if total > 0 else np.nan
    return S


def _odd(view: View) -> np.ndarray:
    """Find the values (N, m) by which a log is odd by itself: far off both the others and what its tolerance allows.

    The next log confirms it where that is far off on the same side. Where there are too few logs to compare with, they
    are compared with the model.
    """
    odd = np.zeros(view.values.shape, dtype=bool)
    rows = np.flatnonzero(np.isfinite(view.values).any(axis=1))
    x, std = view.values[rows], np.nan_to_num(view.std[rows])
    material = np.where(view.of_kind(RESIDUAL), LOUDER, view.tolerance)
    few = np.isfinite(x).sum(axis=0) < FEWEST
    change = x - np.where(few, view.reference, median(x))
    size = np.abs(change)
    known = view.of_kind("m", "gain")  # of which the model is right in other motions too
    far = np.where(few, known & (size > ODD * material), (size > material) & far_off(x)) & (size > ODD * std)
    single = alone(np.where(far, np.sign(change), 0.0))
    odd[rows] = single & ~(far & ~single).any(axis=1, keepdims=True)
    return odd


def week_of(view: View, std_of_model: np.ndarray, since: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Average the logs of the last week, at least the last few, and compute half the 95 % interval of the mean.

    ``std_of_model`` (m,) are the standard deviations of what the quantities are relative to. Only logs ``since`` a row
    count, such as that of a change. Both are (m,), NaN without enough logs.
    """
    x, days = view.counted, view.days
    seen = np.isfinite(x) & (np.arange(len(x)) >= since)[:, None]
    recent = (days > days.max(initial=-np.inf) - WEEK)[:, None]
    part = seen & (recent | (np.cumsum(seen[::-1], axis=0)[::-1] <= FEWEST_OF_WEEK))
    n = np.maximum(part.sum(axis=0), 1)
    mean = np.where(part, x, 0.0).sum(axis=0) / n
    scatter = (np.where(part, x - mean, 0.0) ** 2).sum(axis=0) / np.maximum(n - 1, 1)
    friction = view.of_kind("friction")  # whose two parts compensate each other
    jackknife = (np.where(part & ~friction, np.nan_to_num(view.std), 0.0) ** 2).sum(axis=0) / n
    half = np.hypot(
        stdtrit(np.maximum(n - 1, 1), 0.975) * np.sqrt(np.maximum(scatter, jackknife) / n), 1.96 * std_of_model
    )
    few = part.sum(axis=0) < FEWEST_OF_WEEK
    return np.where(few, np.nan, mean), np.where(few, np.nan, half)


def beyond(view: View, week: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Find the quantities (m,) that are beyond their tolerance with their whole interval."""
    mean, half = week
    return np.asarray(np.abs(mean - view.reference) - half > view.tolerance)
