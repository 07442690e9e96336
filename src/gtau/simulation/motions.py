"""Trajectory of a simulation file: of one of five kinds, within the robot's limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gtau.errors import GtauError
from gtau.robots.robot import Joint, Robot
from gtau.signals.log_file import read_log
from gtau.simulation.simulation_file import MotionEntry
from gtau.simulation.trajectories import Envelope, PointToPoint, Sines, Trajectory, envelope, point_to_point, sines

ROUNDED = 1.01  # times a limit: tolerance on speeds and accelerations of rounded samples


@dataclass(frozen=True, eq=False)
class SampledTrajectory:
    """A fifth-order spline through samples ``q`` (N, n) at ``time`` (N,), s."""

    time: np.ndarray
    q: np.ndarray

    def __call__(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Evaluate positions, velocities and accelerations (N, n)."""
        from scipy.interpolate import make_interp_spline

        spline = make_interp_spline(self.time, self.q, k=5)
        inside = ((time >= self.time[0]) & (time <= self.time[-1]))[:, None]
        t = np.clip(time, self.time[0], self.time[-1])
        return spline(t), inside * spline(t, 1), inside * spline(t, 2)


def moves_through(points: np.ndarray, within: Envelope, rest: float) -> PointToPoint:
    """Plan fifth-order moves through ``points`` (K, n), as fast as the envelope allows, ``rest`` s between them."""
    way = np.abs(np.diff(points, axis=0))
    # the greatest speed and acceleration of the polynomial are 15/8 and 10/sqrt(3)
    spans = np.maximum(1.875 * way / within.velocity, np.sqrt(10 / np.sqrt(3) * way / within.acceleration)).max(axis=1)
    spans = np.maximum(spans, 1e-3)  # a move to the same point
    starts = np.concatenate([[0.0], np.cumsum(spans[:-1] + rest)])
    return PointToPoint(points, starts, spans)


def make_trajectory(motion: MotionEntry, robot: Robot, where: str) -> tuple[Trajectory, float]:
    """Make the trajectory that a file describes, and return its duration in s.

    Parameters
    ----------
    motion : MotionEntry
        From a simulation file.
    robot : Robot
        Whose actuated joints move.
    where : str
        Name of the run in messages.

    Raises
    ------
    GtauError
        Where the description lacks a joint, leaves the robot's limits, or needs limits that the robot lacks.
    """
    made: Trajectory
    if (random := motion.sines or motion.moves) is not None:
        kind = sines if motion.sines else point_to_point
        rng = np.random.default_rng(random.seed)
        made, duration = kind(envelope(robot, random.share), random.duration, rng), random.duration
    elif motion.points is not None:
        points = np.array([_of_joints(point, robot, where) for point in motion.points.through])
        moves = moves_through(points, envelope(robot, motion.points.share), motion.points.rest)
        made, duration = moves, float(moves.starts[-1] + moves.spans[-1] + motion.points.rest)
    elif (series := motion.fourier) is not None:
        center, amplitude, phase = (
            np.array(_of_joints(each, robot, where)) for each in (series.center, series.amplitude, series.phase)
        )
        made, duration = Sines(center, amplitude, phase, np.array(series.frequency), series.duration), series.duration
    else:
        assert motion.csv is not None
        made, duration = _from_csv(motion.csv, robot)
    _check_limits(made(np.arange(0.0, duration, 0.005)), robot, where)
    return made, duration


def _of_joints(values: Mapping[str, Any], robot: Robot, where: str) -> Sequence[Any]:
    missing = [joint for joint in robot.actuated if joint not in values]
    extra = [joint for joint in values if joint not in robot.actuated]
    if missing or extra:
        raise GtauError(
            f"{where}: the trajectory "
            + (f"lacks the joint '{missing[0]}'" if missing else f"names '{extra[0]}'")
            + f"; give one value for each actuated joint, {', '.join(robot.actuated)}."
        )
    return [values[joint] for joint in robot.actuated]


def _from_csv(path: Path, robot: Robot) -> tuple[SampledTrajectory, float]:
    names = [f"q_{joint}" for joint in robot.actuated]  # as 'gtau excite' writes them
    columns = read_log(path, ("t", *names)).columns
    time, q = columns["t"], np.column_stack([columns[name] for name in names])
    if not (np.isfinite(time).all() and np.isfinite(q).all() and len(time) > 5 and (np.diff(time) > 0).all()):
        raise GtauError(
            f"{path}: the columns t and {', '.join(names)} must hold at least six rows of numbers with rising times; "
            "correct the file."
        )
    return SampledTrajectory(time - time[0], q), float(time[-1] - time[0])


def _check_limits(made: tuple[np.ndarray, np.ndarray, np.ndarray], robot: Robot, where: str) -> None:
    """Refuse positions, velocities and accelerations (N, n) beyond the limits that the robot's file has."""
    q, qd, qdd = made
    for j, name in enumerate(robot.actuated):
        joint, limits = robot.joint(name), robot.joint(name).limits
        check_positions(q[:, j], joint, where)
        for most, limit, what in (
            (np.abs(qd[:, j]).max(), limits.velocity, f"{joint.unit}/s"),
            (np.abs(qdd[:, j]).max(), limits.acceleration, f"{joint.unit}/s2"),
        ):
            if limit is not None and most > ROUNDED * limit:
                raise GtauError(
                    f"{where}: joint '{name}' is to reach {most:.4g} {what}, beyond its limit of {limit:.4g} {what}; "
                    "make the motion slower, smaller or smoother."
                )


def check_positions(q: np.ndarray, joint: Joint, where: str) -> None:
    """Refuse positions (N,) of a joint, rad or m, beyond its limits; ``where`` names the run in the message.

    Raises
    ------
    GtauError
        Where there are some.
    """
    low, high = joint.limits.position or (-np.inf, np.inf)
    if q.min() < low - 1e-9 or q.max() > high + 1e-9:
        raise GtauError(
            f"{where}: joint '{joint.name}' is to move from {q.min():.4g} to {q.max():.4g}, beyond its limits "
            f"{low:.4g} to {high:.4g}; make the motion smaller."
        )
