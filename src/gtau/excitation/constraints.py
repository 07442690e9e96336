"""Usage of limits by a motion, normalised: at most 1 within the limit."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from gtau.errors import GtauError
from gtau.excitation.clearance import FLOOR, Clearance, Nearest, Pair
from gtau.excitation.task import DesignProblem, Grid, Point, along, close
from gtau.excitation.trajectory import approach_duration, quintic
from gtau.robots.parameter import torque_unit
from gtau.robots.robot import Joint

ORDERS = ("position", "velocity", "acceleration", "jerk")
PER = ("", "/s", "/s2", "/s3")
APPROACH = 12  # poses between rest and the beginning of the motion, in which the search checks distances
WAY = quintic(np.zeros(1), np.ones(1), 1.0, np.linspace(0.0, 1.0, APPROACH + 2))[0][0]  # from 0 to 1
MARGIN = 0.97  # share of every limit for a first design: between instants speeds exceed it by up to 2 %
CONDITION, TOOL_SPEED = "condition", "tool speed"
SLOWER = (1.0, 1.4, 2.0, 3.0, 4.0)  # durations of an approach to try; four times takes 1/16 of the acceleration


@dataclass(frozen=True, eq=False)
class ConstraintUsage:
    """Usage of a limit along a motion."""

    kind: str
    what: str  # the limit in words
    limit: float  # counted from ``middle`` if it is an interval
    unit: str
    # (N,) within -1 and 1 if the limit holds; at least 1 for a lower limit (``least``)
    values: np.ndarray
    rows: Callable[[], np.ndarray]  # Jacobian of the values by x
    least: bool = False
    middle: float | None = None
    logarithmic: bool = False  # whether values are ratios of logarithms

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


def constraint_usages(point: Point, share: np.ndarray | None = None) -> Iterator[ConstraintUsage]:
    """Compute the usage of all limits by a motion, with Jacobians (N, series.size).

    ``share`` (n,), the counted share of samples away from reversals, replaces the smooth estimate if given.
    """
    limits = point.task.limits
    yield from _kinematic(point)
    yield from _passive(point)
    yield from _drives(point)
    yield from _workspace(point)
    yield from tool_speed(point)
    if limits.clearance is not None:
        yield from _clearances(point, limits.clearance)
    if point.task.model.loops is not None and np.isfinite(limits.condition):
        condition, largest = point.motion.condition, np.log(limits.condition)
        yield ConstraintUsage(
            CONDITION,
            "condition number of the closures",
            limits.condition,
            "",
            np.log(condition) / largest,
            lambda: point.rows(np.zeros((0, len(condition))), 1 / largest),
            logarithmic=True,
        )
    if limits.away > 0:
        yield from _away_from_reversals(point, share)


def _kinematic(point: Point) -> Iterator[ConstraintUsage]:
    task, limits = point.task, point.task.limits
    for j, joint in enumerate(map(task.model.robot.joint, task.model.actuated)):
        low, high = limits.position[j].tolist()
        for order, scale in enumerate([(high - low) / 2, *limits.rates[:, j].tolist()]):
            rows = partial(point.rows_of, order, j, scale)
            yield from _of_joint(joint, order, point.joints[order, j], scale, (low + high) / 2, rows)


def _passive(point: Point) -> Iterator[ConstraintUsage]:
    """Compute the usage of limits of joints that motors move by couplings or closed loops."""
    motion, n_c = point.motion, point.task.model.layout.n_c
    for row, joint in enumerate(point.task.model.robot.joints):
        if not joint.actuated:
            low, high = joint.limits.position or (-np.inf, np.inf)
            scales = (high - low) / 2, joint.limits.velocity or np.inf
            for order, (values, scale) in enumerate(zip((motion.c, motion.yd), scales, strict=True)):
                slopes = np.zeros((2 * n_c, motion.c.shape[1]))
                slopes[n_c * order + row] = 1 / scale
                yield from _of_joint(joint, order, values[row], scale, (low + high) / 2, partial(point.rows, slopes))


def _of_joint(
    joint: Joint, order: int, values: np.ndarray, scale: float, middle: float, rows: Callable[[], np.ndarray]
) -> Iterator[ConstraintUsage]:
    """Compare a joint's position, counted from the middle of its range, or a rate with its limit, if it has one."""
    if np.isfinite(scale):
        what, unit = f"{ORDERS[order]} of joint '{joint.name}'", joint.unit + PER[order]
        used, center = (values / scale, None) if order else ((values - middle) / scale, middle)
        kind = ORDERS[order] if joint.actuated else "passive"
        yield ConstraintUsage(kind, what, scale, unit, used, rows, middle=center)


def _drives(point: Point) -> Iterator[ConstraintUsage]:
    """Compute the usage of torque limits, and of stated current limits, at the worst end of the gain's interval."""
    task, payloads = point.task, point.task.payloads
    torques = np.broadcast_to(task.limits.torque, len(task.model.actuated))
    for run, payload in enumerate(payloads):
        if payload in payloads[:run]:
            continue
        carried = "" if payload is None else f" with payload '{payload.name}'"
        for j, joint in enumerate(task.model.actuated):
            gain, kind, limit = task.prior.known[j], "torque", torques[j]
            factor, unit = gain.excess, torque_unit(task.model.robot, joint)
            if np.isfinite(task.limits.current[j]):
                kind, limit, factor, unit = "current", task.limits.current[j], 1 / gain.least, "A"
            if np.isfinite(limit):
                load = task.information.cautious[run] * factor / limit
                what = f"{kind} of joint '{joint}'{carried}"
                rows = partial(_load_rows, point, j, load)
                yield ConstraintUsage(kind, what, float(limit), unit, point.W[j] @ load, rows)


def _load_rows(point: Point, j: int, load: np.ndarray) -> np.ndarray:
    weights = np.zeros_like(point.W)
    weights[j] = load
    return point.to_rows(point.by_joints(weights))


def _workspace(point: Point) -> Iterator[ConstraintUsage]:
    c, (place, back) = point.motion.c, point.task.tool
    for axis, (low, high) in point.task.limits.workspace.items():
        k, middle, half = "xyz".index(axis), (low + high) / 2, (high - low) / 2
        weights = np.outer(np.eye(3)[k], np.full(c.shape[1], 1 / half))
        values = (place(c)[k] - middle) / half
        yield ConstraintUsage(
            "workspace",
            f"{axis} of the tool's frame",
            half,
            "m",
            values,
            lambda weights=weights: point.rows(back(c, weights)),  # type: ignore[misc]
            middle=middle,
        )


def tool_speed(point: Point) -> Iterator[ConstraintUsage]:
    """Compute the usage of the limit of the tool's speed."""
    task, motion, limit = point.task, point.motion, point.task.limits.tool_speed
    speed, slopes = task.tool_speed

    def rows() -> np.ndarray:
        return point.rows(slopes(motion.c, motion.yd) / limit)

    values = speed(motion.c, motion.yd)[0] / limit
    yield ConstraintUsage(TOOL_SPEED, "speed of the tool's frame", limit, "m/s", values, rows)


def _clearances(point: Point, clearance: Clearance) -> Iterator[ConstraintUsage]:
    """Compute distances between bodies along the motion and the approach to it."""
    parts = [part for part in (point, _approach(point)) if part is not None]
    c = np.concatenate([part.motion.c for part in parts], axis=1)
    contacts = dict(zip(clearance.pairs, clearance.all_nearest(c, clearance.pairs), strict=True))
    for body in dict.fromkeys(second for _, second in contacts):
        nearest = {pair: near for pair, near in contacts.items() if pair[1] == body}
        obstacles = [first if first == FLOOR else f"'{first}'" for first, _ in nearest]
        what = f"distance of '{body}' from {', '.join(obstacles)}"
        values = np.min([near.distance for near in nearest.values()], axis=0) / clearance.least
        rows = partial(_nearing, parts, c, clearance, nearest)
        yield ConstraintUsage("distance", what, clearance.least, "m", values, rows, True)


def _nearing(
    parts: Sequence[Point], c: np.ndarray, clearance: Clearance, nearest: Mapping[Pair, Nearest]
) -> np.ndarray:
    """Compute the Jacobian (N, series.size) of the smallest distance of several pairs along all parts of a motion."""
    which = np.argmin([near.distance for near in nearest.values()], axis=0)
    by_c = np.zeros_like(c)
    for k, (pair, near) in enumerate(nearest.items()):
        if (chosen := which == k).any():
            by_c[:, chosen] = clearance.slopes(c, pair, near)[:, chosen] / clearance.least
    along = np.split(by_c, np.cumsum([part.motion.c.shape[1] for part in parts])[:-1], axis=1)
    return np.vstack([part.rows(by) for part, by in zip(parts, along, strict=True)])


def _approach(point: Point) -> Point | None:
    """Return poses between rest and the beginning of a motion on a design grid; None without an approach."""
    task, basis = point.task, point.grid.basis
    if task.rest is None or not basis.size:
        return None
    way = np.zeros((4, APPROACH, basis.shape[2]))
    way[0] = np.outer(WAY[1:-1], basis[0, 0])
    joints = np.zeros((4, len(task.rest), APPROACH))
    joints[0] = task.rest[:, None] + np.outer(point.joints[0, :, 0] - task.rest, WAY[1:-1])
    try:
        motion = close(task.model, joints)
    except GtauError:  # the check of the whole run reports it
        return None
    return Point(task, Grid(point.grid.step, way), joints, motion, point.W[:, :APPROACH])


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
    count = int(np.ceil(_approach_duration(task, home, start) * rate))
    time = np.arange(count) / rate
    there = quintic(home, start, count / rate, time)
    return np.concatenate([there, periods, quintic(start, home, count / rate, time + 1 / rate)], axis=2)


def _approach_duration(task: DesignProblem, home: np.ndarray, start: np.ndarray) -> float:
    """Compute the duration, s, of an approach within the limits of tool speed and, if slowing down helps, others."""
    span = approach_duration(start - home, task.limits.rates)

    def lasting(duration: float) -> Point:
        return along(task, quintic(home, start, duration, np.linspace(0.0, duration, 8 * APPROACH)), duration)

    span *= max((usage.excess / MARGIN for usage in tool_speed(lasting(span)) if usage.excess > MARGIN), default=1.0)
    for slower in SLOWER:
        duration = slower * span
        way = lasting(duration)
        if all(usage.excess <= 1 for usage in (*_drives(way), *_passive(way))):
            return duration
    return span
