"""Limits as normalised usages of a motion: a usage of at most 1 satisfies its limit."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gtau.excitation.clearance import Clearance, Nearest
from gtau.excitation.evaluation import Point
from gtau.excitation.gradients import Slopes
from gtau.excitation.task import DesignProblem
from gtau.excitation.trajectory import approach_duration, quintic
from gtau.signals.payload import Payload

ORDERS = ("position", "velocity", "acceleration", "jerk")


@dataclass(frozen=True, eq=False)
class ConstraintUsage:
    """Usage of a limit: ``values`` (N,), within -1 and 1 if satisfied, or at least 1 for a lower (``least``) limit.

    ``what`` names the limit, ``limit`` is its value in ``unit``, counted from ``middle`` where it is an interval;
    ``rows`` is the Jacobian by x, one row per value. ``logarithmic`` values are logarithms over that of the limit.
    """

    what: str
    limit: float
    unit: str
    values: np.ndarray
    rows: Callable[[], np.ndarray]
    least: bool = False
    middle: float | None = None
    logarithmic: bool = False

    @property
    def allowed(self) -> str:
        """Required condition, in words."""
        if self.middle is not None:
            low, high = self.middle - self.limit, self.middle + self.limit
            return f"between {low:.4g} and {high:.4g} {self.unit}"
        return f"{'at least' if self.least else 'at most'} {self.limit:.4g} {self.unit}".rstrip()

    @property
    def excess(self) -> float:
        """Ratio of used to allowed: above 1 the limit is violated."""
        if self.least:
            return float(1.0 / max(self.values.min(), 1e-9))
        return float(np.abs(self.values).max(initial=0.0))

    @property
    def shortfall(self) -> float:
        """Violation as a share of the limit; at most 1 for a lower limit."""
        return 1 - float(self.values.min()) if self.least else self.excess - 1

    @property
    def reached(self) -> float:
        """Extreme value in ``unit``."""
        if self.middle is not None:
            return float(self.middle + self.limit * self.values[np.argmax(np.abs(self.values))])
        if self.logarithmic:
            return float(np.exp(self.excess * np.log(self.limit)))
        return self.limit * float(self.values.min()) if self.least else self.limit * self.excess


def constraint_usages(points: Sequence[Point], shares: Sequence[np.ndarray] = ()) -> Iterator[ConstraintUsage]:
    """Compute the usage of all limits along all motions, with gradients (N, task.size) as :func:`usages_of_motion`."""
    for k, point in enumerate(points):
        padding = (0, 0), (k * point.task.series.size, (len(points) - 1 - k) * point.task.series.size)
        for usage in usages_of_motion(point, shares[k] if shares else None):
            if len(points) == 1:
                yield usage
                continue

            def rows(own: Callable[[], np.ndarray] = usage.rows, padding: tuple[tuple[int, int], ...] = padding) -> Any:
                return np.pad(own(), padding)

            yield replace(usage, what=f"{usage.what} in run {k + 1}", rows=rows)


def usages_of_motion(point: Point, share: np.ndarray | None = None) -> Iterator[ConstraintUsage]:
    """Compute the usage of all limits along one motion, with gradients (N, series.size) with respect to its numbers.

    ``share`` (n,) is the part of each joint's samples that lies away from its reversals, where it has been counted;
    left out it is the smooth estimate of a design grid.
    """
    task = point.task
    yield from _kinematic(point)
    if np.isfinite(task.limits.current).any():
        yield from _currents(point)
    if task.limits.workspace:
        yield from _workspace(point)
    if task.limits.clearance is not None:
        yield from _clearances(point, task.limits.clearance)
    if task.pullback is not None and np.isfinite(task.limits.condition):
        largest = np.log(task.limits.condition)
        values, slopes = task.pullback.condition(point.motion)
        yield ConstraintUsage(
            "condition number of the closures", task.limits.condition, "", values / largest,
            lambda: point.to_rows(point.to_joints(slopes)) / largest, logarithmic=True,
        )  # fmt: skip
    if task.limits.away > 0:
        yield from _away_from_reversals(point, share)


def _kinematic(point: Point) -> Iterator[ConstraintUsage]:
    task, limits = point.task, point.task.limits
    for j, joint in enumerate(task.model.actuated):
        unit = task.model.robot.joint(joint).unit
        low, high = limits.position[j]
        middle, half = (low + high) / 2, (high - low) / 2
        scales = [(middle, half), *((0.0, float(getattr(limits, order)[j])) for order in ORDERS[1:])]
        for order, (offset, scale) in enumerate(scales):
            if not np.isfinite(scale):
                continue

            def rows(j: int = j, order: int = order, scale: float = scale) -> np.ndarray:
                if order == 3:
                    return point.jerk_rows(j) / scale
                seed = np.zeros((3, *point.joints.shape[1:]))
                seed[order, j] = 1.0 / scale
                return point.to_rows(seed)

            values = (point.joints[order, j] - offset) / scale
            per = unit + ("", "/s", "/s2", "/s3")[order]
            yield ConstraintUsage(
                f"{ORDERS[order]} of joint '{joint}'", scale, per, values, rows, middle=None if order else middle
            )


def _currents(point: Point) -> Iterator[ConstraintUsage]:
    task = point.task
    carried_before: list[Payload | None] = []
    for run in point.runs:
        payload = task.payloads[run]
        if payload in carried_before:
            continue
        carried_before.append(payload)
        carried = "" if payload is None else f" with payload '{payload.name}'"
        for j, joint in enumerate(task.model.actuated):
            limit = float(task.limits.current[j])
            if not np.isfinite(limit):
                continue
            load = task.unknowns.load[run] / (abs(task.gains[j]) * limit)

            def rows(j: int = j, load: np.ndarray = load) -> np.ndarray:
                weights = np.zeros_like(point.W)
                weights[j] = load
                return point.to_rows(point.to_joints(task.regressor.slopes(point.motion, weights)))

            yield ConstraintUsage(f"current of joint '{joint}'{carried}", limit, "A", point.W[j] @ load, rows)


def _workspace(point: Point) -> Iterator[ConstraintUsage]:
    task, motion = point.task, point.motion
    position = task.tool[0](motion.c)
    zero, no_J = np.zeros_like(motion.yd), np.zeros_like(motion.J[task.model.layout.passive])
    for axis, (low, high) in task.limits.workspace.items():
        k, middle, half = "xyz".index(axis), (low + high) / 2, (high - low) / 2

        def rows(k: int = k, half: float = half) -> np.ndarray:
            weights = np.zeros_like(position)
            weights[k] = 1.0 / half
            slopes = Slopes(task.tool[1](np.vstack([motion.c, weights])), zero, zero, no_J)
            return point.to_rows(point.to_joints(slopes))

        yield ConstraintUsage(
            f"{axis} of the tool's frame", half, "m", (position[k] - middle) / half, rows, middle=middle
        )


def _clearances(point: Point, clearance: Clearance) -> Iterator[ConstraintUsage]:
    motion, least = point.motion, clearance.least
    zero, no_J = np.zeros_like(motion.yd), np.zeros_like(motion.J[point.task.model.layout.passive])
    for pair in clearance.pairs:
        nearest = clearance.nearest(motion.c, pair)

        def rows(pair: tuple[str, str] = pair, nearest: Nearest = nearest) -> np.ndarray:
            slopes = Slopes(clearance.slopes(motion.c, pair, nearest) / least, zero, zero, no_J)
            return point.to_rows(point.to_joints(slopes))

        what = f"distance between '{pair[0]}' and '{pair[1]}'"
        yield ConstraintUsage(what, least, "m", nearest.distance / least, rows, True)


def _away_from_reversals(point: Point, counted: np.ndarray | None) -> Iterator[ConstraintUsage]:
    task, qd = point.task, point.joints[1]
    window = task.window(point.grid.step)
    share = window.weights(qd).mean(axis=1) if counted is None else counted
    for j, joint in enumerate(task.model.actuated):

        def rows(j: int = j) -> np.ndarray:
            mean, seed = np.zeros_like(qd), np.zeros((3, *qd.shape))
            mean[j] = 1.0 / (qd.shape[1] * task.limits.away)
            seed[1] = window.back(qd, mean)
            return point.to_rows(seed).sum(axis=0, keepdims=True)

        what = f"time of joint '{joint}' away from its reversals"
        yield ConstraintUsage(what, task.limits.away, "of the time", share[[j]] / task.limits.away, rows, True)


def whole_run(task: DesignProblem, period: np.ndarray, rate: float) -> np.ndarray:
    """Sample a run at ``rate``, Hz: approach from rest, all periods, and return; (4, n, N) with q, qd, qdd and jerk.

    ``period`` are the joints (4, n, .) at the instants of one period at that rate.
    """
    periods = np.concatenate([np.tile(period, task.repetitions), period[:, :, :1]], axis=2)
    if task.rest is None:
        return periods
    home, start, limits = task.rest, period[0, :, 0], task.limits
    span = approach_duration(start - home, limits.velocity, limits.acceleration, limits.jerk)
    count = int(np.ceil(span * rate))
    time = np.arange(count) / rate
    there = np.stack(quintic(home, start, count / rate, time))
    back = np.stack(quintic(start, home, count / rate, time + 1 / rate))
    return np.concatenate([there, periods, back], axis=2)
