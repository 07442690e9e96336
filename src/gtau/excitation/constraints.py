"""Usage of limits by a motion, normalised: at most 1 within the limit."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from gtau.errors import GtauError
from gtau.excitation.clearance import FLOOR, Clearance, Nearest
from gtau.excitation.evaluation import Grid, Point, along
from gtau.excitation.gradients import Slopes
from gtau.excitation.task import DesignProblem, close
from gtau.excitation.trajectory import approach_duration, quintic
from gtau.robots.parameter import torque_unit

ORDERS = ("position", "velocity", "acceleration", "jerk")
APPROACH = 12  # poses between rest and the beginning of the motion, in which the search checks distances
WAY = quintic(np.zeros(1), np.ones(1), 1.0, np.linspace(0.0, 1.0, APPROACH + 2))[0][0]  # from 0 to 1
MARGIN = 0.97  # share of every limit for a first design: between instants speeds exceed it by up to 2 %
CONDITION, TOOL_SPEED = "condition", "tool speed"
SLOWER = (1.0, 1.4, 2.0, 3.0, 4.0)  # durations of an approach to try; four times takes 1/16 of the acceleration


@dataclass(frozen=True, eq=False)
class ConstraintUsage:
    """Usage of a limit along a motion.

    Attributes
    ----------
    kind, what : str
        Kind of the limit, and the limit in words.
    limit, unit : float, str
        Value of the limit, counted from ``middle`` where it is an interval.
    values : (N,)
        Within -1 and 1 if the limit holds; at least 1 for a lower limit (``least``).
    rows : callable
        Jacobian of the values by x.
    logarithmic : bool
        Whether values are ratios of logarithms.
    """

    kind: str
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
        """The limit in words."""
        if self.middle is not None:
            low, high = self.middle - self.limit, self.middle + self.limit
            return f"between {low:.4g} and {high:.4g} {self.unit}"
        return f"{'at least' if self.least else 'at most'} {self.limit:.4g} {self.unit}".rstrip()

    @property
    def excess(self) -> float:
        """Ratio of used to allowed; above 1 the limit is violated."""
        if self.least:
            return float(1.0 / max(self.values.min(), 1e-9))
        return float(np.abs(self.values).max(initial=0.0))

    @property
    def shortfall(self) -> float:
        """Violation as a share of the limit; at most 1 for a lower limit."""
        return 1 - float(self.values.min()) if self.least else self.excess - 1

    @property
    def reached(self) -> float:
        """Extreme value of the motion, in ``unit``."""
        if self.middle is not None:
            return float(self.middle + self.limit * self.values[np.argmax(np.abs(self.values))])
        if self.logarithmic:
            return float(np.exp(self.excess * np.log(self.limit)))
        return self.limit * float(self.values.min()) if self.least else self.limit * self.excess


def constraint_usages(points: Sequence[Point], shares: Sequence[np.ndarray] = ()) -> Iterator[ConstraintUsage]:
    """Compute the usage of all limits by all motions, with Jacobians (N, task.size)."""
    for k, point in enumerate(points):
        usages = usages_of_motion(point, shares[k] if shares else None)
        if len(points) == 1:
            yield from usages
            continue
        size = point.task.series.size
        around = (0, 0), (k * size, (len(points) - 1 - k) * size)
        for usage in usages:
            rows = partial(_padded, usage.rows, around)
            yield replace(usage, what=f"{usage.what} in run {k + 1}", rows=rows)


def _padded(rows: Callable[[], np.ndarray], around: tuple[tuple[int, int], tuple[int, int]]) -> np.ndarray:
    return np.pad(rows(), around)


def usages_of_motion(point: Point, share: np.ndarray | None = None) -> Iterator[ConstraintUsage]:
    """Compute the usage of all limits by one motion, with Jacobians (N, series.size).

    ``share`` (n,), the counted share of samples away from reversals, replaces the smooth estimate if given.
    """
    task = point.task
    yield from _kinematic(point)
    yield from _drives(point)
    if task.limits.workspace:
        yield from _workspace(point)
    yield from tool_speed(point)
    if task.limits.clearance is not None:
        yield from _clearances(point, task.limits.clearance)
    if task.pullback is not None and np.isfinite(task.limits.condition):
        largest = np.log(task.limits.condition)
        values, slopes = task.pullback.condition(point.motion)
        yield ConstraintUsage(
            CONDITION, "condition number of the closures", task.limits.condition, "", values / largest,
            lambda: point.to_rows(point.to_joints(slopes)) / largest, logarithmic=True,
        )  # fmt: skip
    if task.limits.away > 0:
        yield from _away_from_reversals(point, share)


def _kinematic(point: Point) -> Iterator[ConstraintUsage]:
    task, limits = point.task, point.task.limits
    for j, joint in enumerate(task.model.actuated):
        unit = task.model.robot.joint(joint).unit
        low, high = limits.position[j]
        middle, half = ((low + high) / 2, (high - low) / 2) if np.isfinite(high - low) else (0.0, np.inf)
        scales = [(middle, half), *((0.0, float(rate)) for rate in limits.rates[:, j])]
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
            kind, per = ORDERS[order], unit + ("", "/s", "/s2", "/s3")[order]
            what = f"{kind} of joint '{joint}'"
            yield ConstraintUsage(kind, what, scale, per, values, rows, middle=None if order else middle)


def _drives(point: Point) -> Iterator[ConstraintUsage]:
    """Compute the usage of torque limits, and of stated current limits, at the worst end of the gain's interval."""
    task, n = point.task, len(point.task.model.actuated)
    torques, currents = (np.broadcast_to(limit, n) for limit in (task.limits.torque, task.limits.current))
    payloads = [task.payloads[run] for run in point.runs]
    for number, (run, payload) in enumerate(zip(point.runs, payloads, strict=True)):
        if payload in payloads[:number]:
            continue
        carried = "" if payload is None else f" with payload '{payload.name}'"
        for j, joint in enumerate(task.model.actuated):
            gain, unit = task.prior.known[j], torque_unit(task.model.robot, joint)
            kinds = (("torque", torques[j], 1 / gain.excess, unit), ("current", currents[j], gain.least, "A"))
            for kind, limit, factor, unit in kinds:
                if not np.isfinite(limit):
                    continue
                load = task.information.cautious[run] / (factor * limit)

                def rows(j: int = j, load: np.ndarray = load) -> np.ndarray:
                    weights = np.zeros_like(point.W)
                    weights[j] = load
                    return point.to_rows(point.to_joints(task.regressor.slopes(point.motion, weights)))

                what = f"{kind} of joint '{joint}'{carried}"
                yield ConstraintUsage(kind, what, float(limit), unit, point.W[j] @ load, rows)


def _workspace(point: Point) -> Iterator[ConstraintUsage]:
    task, motion = point.task, point.motion
    position = task.tool[0](motion.c)
    for axis, (low, high) in task.limits.workspace.items():
        k, middle, half = "xyz".index(axis), (low + high) / 2, (high - low) / 2

        def rows(k: int = k, half: float = half) -> np.ndarray:
            weights = np.zeros_like(position)
            weights[k] = 1.0 / half
            return point.rows_by_configuration(task.tool[1](motion.c, weights))

        values = (position[k] - middle) / half
        yield ConstraintUsage("workspace", f"{axis} of the tool's frame", half, "m", values, rows, middle=middle)


def tool_speed(point: Point) -> Iterator[ConstraintUsage]:
    """Compute the usage of the limit of the tool's speed, if there is one."""
    task, motion, limit = point.task, point.motion, point.task.limits.tool_speed
    if not np.isfinite(limit):
        return

    def rows() -> np.ndarray:
        slopes = Slopes.by_configuration(np.zeros_like(motion.c), motion, task.model.layout)
        by_c, by_yd = np.split(task.tool_speed[1](motion.c, motion.yd) / limit, [len(motion.c)])
        return point.to_rows(point.to_joints(replace(slopes, c=by_c, yd=by_yd)))

    values = task.tool_speed[0](motion.c, motion.yd)[0] / limit
    yield ConstraintUsage(TOOL_SPEED, "speed of the tool's frame", limit, "m/s", values, rows)


def _clearances(point: Point, clearance: Clearance) -> Iterator[ConstraintUsage]:
    """Compute distances between bodies along the motion and the approach to it."""
    parts = [point] if (way := _approach(point)) is None else [point, way]
    by_part = [clearance.all_nearest(part.motion.c, clearance.pairs) for part in parts]
    for body in dict.fromkeys(second for _, second in clearance.pairs):
        places = [k for k, (_, second) in enumerate(clearance.pairs) if second == body]
        pairs = [clearance.pairs[k] for k in places]
        nearest = [[contacts[k] for k in places] for contacts in by_part]

        def rows(pairs: list[tuple[str, str]] = pairs, nearest: list[list[Nearest]] = nearest) -> np.ndarray:
            ways = zip(parts, nearest, strict=True)
            return np.vstack([_nearing(part, clearance, pairs, near) for part, near in ways])

        obstacles = [first if first == FLOOR else f"'{first}'" for first, _ in pairs]
        distance = np.concatenate([np.min([near.distance for near in contacts], axis=0) for contacts in nearest])
        what = f"distance of '{body}' from {', '.join(obstacles)}"
        yield ConstraintUsage("distance", what, clearance.least, "m", distance / clearance.least, rows, True)


def _nearing(
    point: Point, clearance: Clearance, pairs: Sequence[tuple[str, str]], nearest: Sequence[Nearest]
) -> np.ndarray:
    """Compute the Jacobian (N, series.size) of the smallest distance of several pairs."""
    motion = point.motion
    which = np.argmin([near.distance for near in nearest], axis=0)
    by_c = np.zeros_like(motion.c)
    for k, (pair, near) in enumerate(zip(pairs, nearest, strict=True)):
        if (chosen := which == k).any():
            by_c[:, chosen] = clearance.slopes(motion.c, pair, near)[:, chosen] / clearance.least
    return point.rows_by_configuration(by_c)


def _approach(point: Point) -> Point | None:
    """Return poses between rest and the beginning of a motion on a design grid; None without an approach."""
    task, basis = point.task, point.grid.basis
    if task.rest is None or point.platform is not None or not basis.size:
        return None
    way = np.zeros((4, APPROACH, basis.shape[2]))
    way[0] = np.outer(WAY[1:-1], basis[0, 0])
    joints = np.zeros((4, len(task.rest), APPROACH))
    joints[0] = task.rest[:, None] + np.outer(point.joints[0, :, 0] - task.rest, WAY[1:-1])
    try:
        motion = close(task.model, joints)
    except GtauError:  # the check of the whole run reports it
        return None
    return Point(task, Grid(point.grid.step, way), point.runs, joints, motion, None, point.W[:, :APPROACH])


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
        yield ConstraintUsage("away", what, task.limits.away, "of the time", share[[j]] / task.limits.away, rows, True)


def whole_run(task: DesignProblem, period: Point, rate: float) -> np.ndarray:
    """Sample a run at ``rate``, Hz, (4, n, N): approach, all periods of a motion, and return."""
    joints = period.joints
    periods = np.concatenate([np.tile(joints, task.repetitions), joints[:, :, :1]], axis=2)
    if task.rest is None:
        return periods
    home, start = task.rest, joints[0, :, 0]
    count = int(np.ceil(_approach_duration(task, home, start, period.runs) * rate))
    time = np.arange(count) / rate
    there = np.stack(quintic(home, start, count / rate, time))
    back = np.stack(quintic(start, home, count / rate, time + 1 / rate))
    return np.concatenate([there, periods, back], axis=2)


def _approach_duration(task: DesignProblem, home: np.ndarray, start: np.ndarray, runs: tuple[int, ...]) -> float:
    """Compute the duration, s, of an approach within the limits of tool speed and, if slowing down helps, torque."""
    span = approach_duration(start - home, task.limits.rates)

    def lasting(duration: float) -> Point:
        joints = np.stack(quintic(home, start, duration, np.linspace(0.0, duration, 8 * APPROACH)))
        return along(task, joints, duration, runs)

    span *= max((usage.excess / MARGIN for usage in tool_speed(lasting(span)) if usage.excess > MARGIN), default=1.0)
    for slower in SLOWER:
        duration = slower * span
        if all(usage.excess <= 1 for usage in _drives(lasting(duration))):
            return duration
    return span
