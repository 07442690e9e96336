"""What the logs of a history say of each watched quantity, against the model and its tolerances.

Quantities are the charts of the logs, but friction is one a joint: Coulomb and viscous together, at the mean speed of
the motion and relative to the model's, as a motion hardly separates the two. Warming changes the friction of all
joints by one factor; their median is that factor, and what is compared from log to log is what exceeds it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import stdtrit

from gtau.estimation.results.result import Result
from gtau.watch.detectors import FEWEST, alone, far_off, mean_of, median
from gtau.watch.history import History, Logs, WatchSettings
from gtau.watch.quantities import Quantity, identified
from gtau.watch.statistics import RESIDUAL

WEEK = 7.0  # days
FEWEST_OF_WEEK = 3  # logs of a week; fewer are filled up with earlier ones
ODD = 5.0  # standard deviations, and tolerances from the model where there are too few logs to compare with
COMMON = 3  # joints from which the friction of all has a median that one of them does not set
LOUDER = float(np.log(2))  # growth of a residual that counts as odd


@dataclass(frozen=True, eq=False)
class View:
    """The ``logs`` of a history, and what is judged of them.

    ``values`` and ``std`` (N, m) are those of the quantities, NaN where not counted. They have a ``tolerance`` about a
    ``reference`` (m,) and, where they are relative to an identified gain, its standard deviation ``of_model``.
    """

    settings: WatchSettings
    logs: Logs
    quantities: tuple[Quantity, ...]
    values: np.ndarray
    std: np.ndarray
    tolerance: np.ndarray
    reference: np.ndarray
    of_model: np.ndarray

    @property
    def names(self) -> list[str]:
        """Names of the quantities."""
        return [quantity.name for quantity in self.quantities]

    @cached_property
    def odd(self) -> np.ndarray:
        """Values (N, m) by which a log is odd by itself: far off both the others and what its tolerance allows.

        The next log confirms it where that is far off on the same side. Where there are too few logs to compare with,
        they are compared with the model.
        """
        shown = np.isfinite(self.values)
        few, middle = shown.sum(axis=0) < FEWEST, median(self.values)
        change = self.values - np.where(few, self.reference, middle)
        size, certain = np.abs(change), ODD * np.nan_to_num(self.std)
        material = np.where(self.of_kind(RESIDUAL), LOUDER, self.tolerance)
        known = self.of_kind("m", "gain")  # of which the model is right in other motions too
        far = np.where(few, known & (size > ODD * material), (size > material) & far_off(self.values))
        far &= size > certain
        rows, odd = shown.any(axis=1), np.zeros(shown.shape, dtype=bool)
        single = alone(np.where(far, np.sign(change), 0.0)[rows])
        odd[rows] = single & ~(far[rows] & ~single).any(axis=1, keepdims=True)
        return odd

    @cached_property
    def counted(self) -> np.ndarray:
        """Values (N, m) without those of odd logs, which count nowhere."""
        return np.where(self.odd.any(axis=1, keepdims=True), np.nan, self.values)

    @cached_property
    def compared(self) -> np.ndarray:
        """Values (N, m) that are compared from log to log: friction less the factor common to all joints."""
        x, friction = self.counted.copy(), self.of_kind("friction")
        rows = np.isfinite(x[:, friction]).sum(axis=1) >= COMMON
        x[np.ix_(rows, friction)] -= median(x[np.ix_(rows, friction)].T)[:, None]
        return x

    @cached_property
    def there(self) -> np.ndarray:
        """Rows of the logs that count since the last maintenance."""
        return np.flatnonzero(np.isfinite(self.counted).any(axis=1))

    @property
    def baseline(self) -> int:
        """Number of logs that count since the last maintenance."""
        return int(self.logs.counts[self.there].sum())

    @property
    def limit(self) -> float:
        """Logarithm of the limit of each quantity's e-detector, which grows with their number."""
        return float(np.log(self.settings.limit * max(np.isfinite(self.values).any(axis=0).sum(), 1)))

    def of_kind(self, *kinds: str) -> np.ndarray:
        """Find the quantities (m,) of these kinds."""
        return np.array([quantity.kind in kinds for quantity in self.quantities])


def view_of(model: Result, charts: Sequence[Quantity], settings: WatchSettings, history: History) -> View:
    """Take the logs that count after what was done: maintenance, forgotten and repaired logs, new references."""
    logs, limits = history.logs(len(charts), len(model.robot.actuated)), settings.tolerances
    quantities, S = _combined(model, charts, logs.speeds)
    shown = np.isfinite(logs.charts).astype(float) @ (S != 0) > 0
    values = np.where(shown, np.nan_to_num(logs.charts) @ S, np.nan)
    std = np.where(shown, np.nan_to_num(logs.std) @ np.abs(S), np.nan)
    accepted = {"m": limits.mass, **limits.model_dump(include={"gain", "friction", "zero", "delay"})}
    tolerance = np.array([accepted.get(quantity.kind, np.inf) for quantity in quantities])
    vague = median(std) > np.maximum(tolerance, np.abs(median(values)) / ODD)
    tolerance[vague] = np.inf  # one log does not determine these, and errors of the model exceed them
    gains = [model.drive_gains.get(quantity.joint) if quantity.kind == "gain" else None for quantity in quantities]
    of_model = np.array([(gain.std or 0.0) / abs(gain.value or 1.0) if gain else 0.0 for gain in gains])
    view = View(settings, logs, quantities, values, std, tolerance, np.zeros(len(quantities)), of_model)
    for event in history.events:
        if event.undone:
            continue
        if event.kind == "reset" and (logs.dates >= event.subject).any():
            values[logs.dates < event.subject] = np.nan
        elif event.kind == "forget":
            values[logs.names == event.subject] = np.nan
        elif event.kind == "repaired":
            values[(logs.ids >= event.details["first"]) & (logs.ids < event.details["inside"])] = np.nan
        elif event.kind == "acknowledge":
            changed = [view.names.index(name) for name in event.details["changed"]]
            values[np.ix_(logs.ids < event.details["first"], changed)] = np.nan
            view.reference[changed] = [*event.details["changed"].values()]
    return view


def _combined(model: Result, charts: Sequence[Quantity], speeds: np.ndarray) -> tuple[tuple[Quantity, ...], np.ndarray]:
    """List the quantities, and the combinations (k, m) of charts that they are, friction at mean ``speeds`` (N, n)."""
    friction = [k for k, chart in enumerate(charts) if chart.group == "friction"]
    plain = [k for k in range(len(charts)) if k not in friction]
    joints = list(dict.fromkeys(charts[k].joint for k in friction))
    S = np.zeros((len(charts), len(plain) + len(joints)))
    S[plain, range(len(plain))] = 1.0
    speed = dict(zip(model.robot.actuated, np.nan_to_num(median(speeds), nan=1.0), strict=True))
    for k in friction:
        S[k, len(plain) + joints.index(charts[k].joint)] = speed[charts[k].joint] if charts[k].kind == "fv" else 1.0
    total = np.array([identified(model, charts[k]) for k in friction]) @ S[friction, len(plain) :]
    S[:, len(plain) :] /= np.where(total > 0, total, np.nan)
    return (*(charts[k] for k in plain), *(Quantity("friction", joint, "1") for joint in joints)), S


def week_of(view: View, since: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Average the logs of the last week, at least the last few, and compute half the 95 % interval of the mean.

    Only logs ``since`` a row count, such as that of a change. Both are (m,), NaN without enough logs.
    """
    days = view.logs.days
    seen = np.isfinite(view.counted) & (np.arange(len(days)) >= since)[:, None]
    recent = (days > days.max(initial=-np.inf) - WEEK)[:, None]
    part = seen & (recent | (np.cumsum(seen[::-1], axis=0)[::-1] <= FEWEST_OF_WEEK))
    x, n = np.where(part, view.counted, np.nan), part.sum(axis=0)
    mean, freedom = mean_of(x), np.maximum(n - 1, 1)
    scatter = np.nansum((x - mean) ** 2, axis=0) / freedom
    friction = view.of_kind("friction")  # whose two parts compensate each other
    jackknife = np.where(friction, 0.0, mean_of(np.where(part, np.nan_to_num(view.std) ** 2, np.nan)))
    of_mean = stdtrit(freedom, 0.975) * np.sqrt(np.fmax(scatter, jackknife) / np.maximum(n, 1))
    half = np.hypot(of_mean, 1.96 * view.of_model)
    few = n < FEWEST_OF_WEEK
    return np.where(few, np.nan, mean), np.where(few, np.nan, half)


def beyond(view: View, since: int = 0, times: float = 1.0) -> np.ndarray:
    """Find the quantities (m,) that are beyond so many ``times`` their tolerance with their whole interval."""
    mean, half = week_of(view, since)
    return np.asarray(np.abs(mean - view.reference) - half > times * view.tolerance)
