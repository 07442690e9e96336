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
from gtau.watch.history import Event, Row
from gtau.watch.quantities import Quantity
from gtau.watch.statistics import RESIDUAL

WEEK = 7.0  # days
FEWEST_OF_WEEK = 3  # logs of a week; fewer are filled up with earlier ones
ODD = 5.0  # standard deviations, and tolerances from the model where there are too few logs to compare with
COMMON = 3  # joints from which the friction of all has a median that one of them does not set
LOUDER = float(np.log(2))  # growth of a residual that counts as odd


@dataclass(frozen=True, eq=False)
class Table:
    """Logs by date: number, name, date and day of each (N,), values and standard deviations (N, k) of the charts.

    ``uneven`` and ``speed`` are (N, n), and ``alarms`` the states after each as JSON.
    """

    ids: np.ndarray
    logs: tuple[str, ...]
    dates: tuple[str, ...]
    days: np.ndarray
    values: np.ndarray
    std: np.ndarray
    uneven: np.ndarray
    speed: np.ndarray
    counts: np.ndarray


def table_of(rows: Sequence[Row], charts: int, joints: int) -> Table:
    """Arrange the rows of a history by date."""
    rows = sorted(rows, key=lambda row: (row.date, row.id))
    numbers = np.array([row.numbers for row in rows]).reshape(-1, 2 * (charts + joints))
    values, std, uneven, speed = np.split(numbers, np.cumsum([charts, charts, joints]), axis=1)
    days = np.array([np.datetime64(row.date[:19], "s").astype(float) / 86400 for row in rows])
    names, dates = tuple(row.log for row in rows), tuple(row.date for row in rows)
    ids, counts = np.array([row.id for row in rows], dtype=int), np.array([row.count for row in rows], dtype=int)
    return Table(ids, names, dates, days, values, std, uneven, speed, counts)


@dataclass(frozen=True, eq=False)
class View:
    """What is judged: the table, its quantities, their values and standard deviations (N, m), NaN where not counted.

    ``tolerance`` and ``reference`` are (m,), and ``factor`` (N,) is the common factor of friction less 1. ``odd``
    (N, m) are values by which a log is odd by itself; those of an odd log count nowhere.
    """

    table: Table
    quantities: tuple[Quantity, ...]
    values: np.ndarray
    std: np.ndarray
    tolerance: np.ndarray
    reference: np.ndarray
    factor: np.ndarray
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
        """Values (N, m) that are compared from log to log: friction less the common factor."""
        friction = np.array([quantity.kind == "friction" for quantity in self.quantities])
        return np.where(friction, self.counted - self.factor[:, None], self.counted)

    @property
    def baseline(self) -> int:
        """Number of logs that count since the last maintenance."""
        return int(self.table.counts[np.isfinite(self.counted).any(axis=1)].sum())


def view_of(
    model: Result, charts: Sequence[Quantity], table: Table, events: Sequence[Event], tolerances: Tolerances
) -> View:
    """Take the logs that count after what was done: maintenance, forgotten and repaired logs, new references."""
    quantities, columns = _quantities(charts)
    values, std = (_friction(model, charts, table, part) for part in (table.values, table.std))
    values, std = (
        np.concatenate([part[0][:, columns], part[1]], axis=1) for part in ((table.values, values), (table.std, std))
    )
    limits = {"m": tolerances.mass, **tolerances.model_dump(include={"gain", "friction", "zero", "delay"})}
    tolerance = np.array([limits.get(quantity.kind, np.inf) for quantity in quantities])
    vague = median(std) > np.maximum(tolerance, np.abs(median(values)) / ODD)
    tolerance[vague] = np.inf  # one log does not determine these, and errors of the model exceed them
    reference, names = np.zeros(len(quantities)), [quantity.name for quantity in quantities]
    for event in events:
        details = event.details or {}
        if event.undone:
            continue
        if event.kind == "reset" and any(date >= event.subject for date in table.dates):
            values[[date < event.subject for date in table.dates]] = np.nan
        elif event.kind == "forget":
            values[[event.subject == log for log in table.logs]] = np.nan
        elif event.kind == "repaired":
            values[(table.ids >= details["first"]) & (table.ids < details["inside"])] = np.nan
        elif event.kind == "acknowledge":
            known = {names.index(name): value for name, value in details["changed"].items() if name in names}
            values[np.ix_(table.ids < details["first"], [*known])] = np.nan
            reference[[*known]] = [*known.values()]
    friction = [k for k, quantity in enumerate(quantities) if quantity.kind == "friction"]
    factor = np.zeros(len(values))
    if len(friction) >= COMMON and len(values):
        complete = np.isfinite(values[:, friction]).sum(axis=1) >= COMMON
        factor[complete] = np.nanmedian(values[np.ix_(complete, friction)], axis=1)
    view = View(table, quantities, values, std, tolerance, reference, factor, np.zeros(values.shape, dtype=bool))
    return replace(view, odd=_odd(view))


def _quantities(charts: Sequence[Quantity]) -> tuple[tuple[Quantity, ...], list[int]]:
    """List the judged quantities, and the charts that are their first ones: friction comes last, one a joint."""
    plain = [k for k, chart in enumerate(charts) if chart.kind not in PLAIN_FRICTION]
    joints = dict.fromkeys(chart.joint for chart in charts if chart.kind in PLAIN_FRICTION)
    return (*(charts[k] for k in plain), *(Quantity("friction", joint, "1") for joint in joints)), plain


def _friction(model: Result, charts: Sequence[Quantity], table: Table, values: np.ndarray) -> np.ndarray:
    """Relate Coulomb and viscous friction (N, joints) at the motion's mean speed to the model's."""
    known = {**model.parameters, **model.friction_parameters}
    columns = []
    for joint in dict.fromkeys(chart.joint for chart in charts if chart.kind in PLAIN_FRICTION):
        speeds = table.speed[:, model.robot.actuated.index(joint)]
        speed = float(np.median(speeds[np.isfinite(speeds)])) if np.isfinite(speeds).any() else 1.0
        total, size = np.full(len(values), np.nan), 0.0
        for k, chart in enumerate(charts):
            if chart.joint == joint and chart.kind in PLAIN_FRICTION:
                share = speed if chart.kind == "fv" else 1.0
                total = np.where(np.isfinite(values[:, k]), np.nan_to_num(total) + share * values[:, k], total)
                size += share * (getattr(known.get(Parameter(chart.kind, joint)), "value", None) or 0.0)
        columns.append(total / size if size > 0 else np.full(len(values), np.nan))
    return np.array(columns).T.reshape(len(values), len(columns))


def _odd(view: View) -> np.ndarray:
    """Find the values (N, m) by which a log is odd by itself: far off both the others and what its tolerance allows.

    The next log confirms it where that is far off on the same side. Where there are too few logs to compare with, they
    are compared with the model.
    """
    odd = np.zeros(view.values.shape, dtype=bool)
    rows = np.flatnonzero(np.isfinite(view.values).any(axis=1))
    x, std = view.values[rows], np.nan_to_num(view.std[rows])
    material = np.where([quantity.kind == RESIDUAL for quantity in view.quantities], LOUDER, view.tolerance)
    few = np.isfinite(x).sum(axis=0) < FEWEST
    change = x - np.where(few, view.reference, median(x))
    size = np.abs(change)
    plain = np.array(
        [quantity.kind in ("m", "gain") for quantity in view.quantities]
    )  # a model misses other motions' lags
    far = np.where(few, plain & (size > ODD * material), (size > material) & far_off(x)) & (size > ODD * std)
    single = alone(np.where(far, np.sign(change), 0.0))
    odd[rows] = single & ~(far & ~single).any(axis=1, keepdims=True)
    return odd


def week_of(view: View, std_of_model: np.ndarray, since: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Average the logs of the last week, at least the last few, and compute half the 95 % interval of the mean.

    ``std_of_model`` (m,) are the standard deviations of what the quantities are relative to. Only logs ``since`` a row
    count, such as that of a change. Both are (m,), NaN without enough logs.
    """
    x, days = view.counted, view.table.days
    seen = np.isfinite(x) & (np.arange(len(x)) >= since)[:, None]
    recent = (days > days.max(initial=-np.inf) - WEEK)[:, None]
    part = seen & (recent | (np.cumsum(seen[::-1], axis=0)[::-1] <= FEWEST_OF_WEEK))
    n = np.maximum(part.sum(axis=0), 1)
    mean = np.where(part, x, 0.0).sum(axis=0) / n
    scatter = (np.where(part, x - mean, 0.0) ** 2).sum(axis=0) / np.maximum(n - 1, 1)
    friction = np.array([quantity.kind == "friction" for quantity in view.quantities])  # whose two parts compensate
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
