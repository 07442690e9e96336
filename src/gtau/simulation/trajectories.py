"""Trajectories of a simulation file: sums of sines, point-to-point moves, Fourier series, or samples of a CSV file.

A trajectory maps instants (N,), s, to positions, velocities and accelerations (N, n), rad or m and s. It starts and
ends at rest, and is constant outside its duration.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field, FiniteFloat, ValidationInfo, model_validator

from gtau.documents.files import beside
from gtau.documents.validation import Keys, Positive
from gtau.errors import GtauError
from gtau.robots.robot import Joint, Robot
from gtau.signals.reading.logs import read_log

Trajectory = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]

FREQUENCIES = np.array([0.1, 0.2, 0.35, 0.55, 0.85, 1.35, 2.15, 3.45])  # Hz
RAMP = 1.5  # s, from rest to full motion and back
REST = 0.05  # s, between two moves
ROUNDED = 1.01  # tolerance factor on limits of speed and acceleration, for rounded samples
PerJoint = dict[str, FiniteFloat]
NotNegative = Annotated[FiniteFloat, Field(ge=0)]
LONGEST = 3600  # s, of a run
Duration = Annotated[FiniteFloat, Field(ge=3, le=LONGEST)]
Share = Annotated[FiniteFloat, Field(gt=0, le=1)]


@dataclass(frozen=True, eq=False)
class Envelope:
    """Motion range of a trajectory (n,): ``reach`` on either side of ``center``, velocity and acceleration."""

    center: np.ndarray
    reach: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray


def envelope(robot: Robot, share: float = 0.9) -> Envelope:
    """Take a share of the joints' limits; a missing acceleration limit is the speed limit over 0.1 s."""
    rows = []
    for name in robot.actuated:
        limit = robot.joint(name).limits
        if limit.position is None or limit.velocity is None:
            raise GtauError(
                f"robot '{robot.name}': joint '{name}' has no {'position' if limit.position is None else 'velocity'} "
                "limit to move within; add it to the robot file."
            )
        rows.append((*limit.position, limit.velocity, limit.acceleration or 10.0 * limit.velocity))
    low, high, velocity, acceleration = np.array(rows, dtype=float).T
    return Envelope((low + high) / 2, share * (high - low) / 2, share * velocity, share * acceleration)


def _blend(u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Evaluate the quintic from 0 to 1 with zero slope and curvature at both ends, and its two derivatives."""
    u = np.clip(u, 0.0, 1.0)
    return u**3 * (10 - 15 * u + 6 * u**2), 30 * u**2 * (1 - u) ** 2, 60 * u * (1 - u) * (1 - 2 * u)


@dataclass(frozen=True, eq=False)
class Sines:
    """Sum of sines (n, K) about ``center``, rad or m, Hz and rad, faded in and out within ``duration``, s."""

    center: np.ndarray
    amplitude: np.ndarray
    phase: np.ndarray
    frequency: np.ndarray
    duration: float

    def __call__(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Evaluate positions, velocities and accelerations (N, n)."""
        t = np.clip(time, 0.0, self.duration)
        omega = 2 * np.pi * self.frequency
        angle = t[:, None, None] * omega + self.phase
        s = np.sum(self.amplitude * np.sin(angle), axis=2)
        sd = np.sum(self.amplitude * omega * np.cos(angle), axis=2)
        sdd = -np.sum(self.amplitude * omega**2 * np.sin(angle), axis=2)
        rise, fall = _blend(t[:, None] / RAMP), _blend((self.duration - t[:, None]) / RAMP)
        w = rise[0] * fall[0]
        wd = (rise[1] * fall[0] - rise[0] * fall[1]) / RAMP
        wdd = (rise[2] * fall[0] - 2 * rise[1] * fall[1] + rise[0] * fall[2]) / RAMP**2
        return self.center + w * s, wd * s + w * sd, wdd * s + 2 * wd * sd + w * sdd


def sines(within: Envelope, duration: float, rng: np.random.Generator) -> Sines:
    """Draw a random sum of sines that fills the envelope, slower if its acceleration would keep it small."""
    shape = (len(within.center), len(FREQUENCIES))
    amplitude, phase = rng.uniform(0.5, 1.0, shape), rng.uniform(0, 2 * np.pi, shape)
    q, qd, qdd = _peaks(Sines(within.center, amplitude, phase, FREQUENCIES, duration))
    size = within.acceleration / qdd  # largest size within the accelerations
    slower = np.maximum(size * qd / within.velocity, np.sqrt(size * q / within.reach))
    frequency = np.minimum(slower, 1.0)[:, None] * FREQUENCIES
    q, qd, qdd = _peaks(Sines(within.center, amplitude, phase, frequency, duration))
    scale = np.minimum(np.minimum(within.reach / q, within.velocity / qd), within.acceleration / qdd)
    return Sines(within.center, amplitude * scale[:, None], phase, frequency, duration)


def _peaks(motion: Sines) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the largest distances from the center, speeds and accelerations, (n,) each."""
    q, qd, qdd = motion(np.arange(0.0, motion.duration, 0.05 / FREQUENCIES[-1]))
    return np.abs(q - motion.center).max(axis=0), np.abs(qd).max(axis=0), np.abs(qdd).max(axis=0)


@dataclass(frozen=True, eq=False)
class PointToPoint:
    """Fifth-order moves through ``points`` (K, n), beginning at ``starts`` (K - 1,), s, and lasting ``spans``, s."""

    points: np.ndarray
    starts: np.ndarray
    spans: np.ndarray

    def __call__(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Evaluate positions, velocities and accelerations (N, n)."""
        k = np.clip(np.searchsorted(self.starts, time, side="right") - 1, 0, len(self.starts) - 1)
        span, start = self.spans[k][:, None], self.points[k]
        s, sd, sdd = _blend((time - self.starts[k])[:, None] / span)
        step = self.points[k + 1] - start
        return start + s * step, sd / span * step, sdd / span**2 * step


def point_to_point(within: Envelope, duration: float, rng: np.random.Generator) -> PointToPoint:
    """Plan moves through random points with short rests, as many as end within ``duration``, but at least one."""
    points, planned = [within.center], None
    while True:
        points.append(within.center + within.reach * rng.uniform(-1.0, 1.0, len(within.center)))
        longer = moves_through(np.array(points), within, REST)
        if planned is not None and longer.starts[-1] + longer.spans[-1] > duration:
            return planned
        planned = longer


def moves_through(points: np.ndarray, within: Envelope, rest: float) -> PointToPoint:
    """Plan fifth-order moves through ``points`` (K, n), as fast as the envelope allows, ``rest`` s between them."""
    way = np.abs(np.diff(points, axis=0))
    # the largest speed and acceleration of the quintic are 15/8 and 10/sqrt(3), rounded up
    spans = np.maximum(1.875 * way / within.velocity, np.sqrt(5.7736 * way / within.acceleration)).max(axis=1)
    spans = np.maximum(spans, 1e-3)  # for a move to the same point
    return PointToPoint(points, np.concatenate([[0.0], np.cumsum(spans[:-1] + rest)]), spans)


def _existing(path: Path, info: ValidationInfo) -> Path:
    path = path if info.context is None else beside(info.context, path)
    if not path.is_file():
        raise ValueError(f"there is no file '{path}'; paths are relative to the simulation file")
    return path


Existing = Annotated[Path, AfterValidator(_existing)]


class RandomMotion(Keys):
    """Random trajectory within a share of the joints' limits."""

    seed: Annotated[int, Field(ge=0)] = 0
    duration: Duration = 20.0
    share: Share = 0.9


class Points(Keys):
    """Fifth-order moves from point to point, as fast as a share of the joints' limits allows."""

    through: tuple[PerJoint, ...] = Field(min_length=2)
    rest: NotNegative = 0.05
    share: Share = 0.9


class Fourier(Keys):
    """The series ``center + sum amplitude sin(2 pi frequency t + phase)``, faded in and out; rad or m, Hz, rad, s."""

    duration: Duration
    frequency: tuple[Positive, ...] = Field(min_length=1)
    center: PerJoint
    amplitude: dict[str, tuple[FiniteFloat, ...]]
    phase: dict[str, tuple[FiniteFloat, ...]]

    @model_validator(mode="after")
    def _equal_lengths(self) -> Fourier:
        for what in ("amplitude", "phase"):
            for joint, numbers in getattr(self, what).items():
                given, frequencies = len(numbers), len(self.frequency)
                if given != frequencies:
                    raise ValueError(
                        f"joint '{joint}' has {given} values of '{what}' for {frequencies} frequencies; "
                        "write one per frequency"
                    )
        return self


class MotionEntry(Keys):
    """A trajectory of one kind; ``csv`` has the columns ``t`` and ``q_<joint>``, as 'gtau excite' writes them."""

    sines: RandomMotion | None = None
    moves: RandomMotion | None = None
    points: Points | None = None
    fourier: Fourier | None = None
    csv: Existing | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> MotionEntry:
        if len(self.model_fields_set) != 1:
            raise ValueError("give one trajectory: 'sines', 'moves', 'points', 'fourier' or 'csv'")
        return self


def make_trajectory(motion: MotionEntry, robot: Robot, where: str) -> tuple[Trajectory, float]:
    """Make the trajectory that a file describes, with its duration, s; ``where`` names the run in messages."""
    trajectory, duration = _unchecked(motion, robot, where)
    if duration > LONGEST:
        raise GtauError(f"{where} would last {duration:.4g} s; give a trajectory of at most {LONGEST} s.")
    _check_limits(trajectory(np.arange(0.0, duration, 0.005)), robot, where)
    return trajectory, duration


def _unchecked(motion: MotionEntry, robot: Robot, where: str) -> tuple[Trajectory, float]:
    def in_order(values: Mapping[str, Any]) -> np.ndarray:
        require_joints(values, robot, f"{where}, trajectory")
        return np.array([values[joint] for joint in robot.actuated])

    if (random := motion.sines or motion.moves) is not None:
        draw = sines if motion.sines else point_to_point
        within, rng = envelope(robot, random.share), np.random.default_rng(random.seed)
        return draw(within, random.duration, rng), random.duration
    if (described := motion.points) is not None:
        points = np.array([in_order(point) for point in described.through])
        moves = moves_through(points, envelope(robot, described.share), described.rest)
        return moves, float(moves.starts[-1] + moves.spans[-1] + described.rest)
    if (series := motion.fourier) is not None:
        center = in_order(series.center)
        amplitude = in_order(series.amplitude)
        phase = in_order(series.phase)
        return Sines(center, amplitude, phase, np.array(series.frequency), series.duration), series.duration
    assert motion.csv is not None
    return _from_csv(motion.csv, robot)


def require_joints(values: Mapping[str, Any], robot: Robot, where: str) -> None:
    """Refuse values by joint that lack an actuated joint or name another; ``where`` begins the message."""
    missing = [joint for joint in robot.actuated if joint not in values]
    extra = [joint for joint in values if joint not in robot.actuated]
    if missing or extra:
        wrong = f"joint '{missing[0]}' is missing" if missing else f"'{extra[0]}' is no actuated joint"
        joints = ", ".join(robot.actuated)
        raise GtauError(f"{where}: {wrong}; the actuated joints of robot '{robot.name}' are {joints}.")


def log_column(letter: str, joint: str) -> str:
    """Name the column of a joint, without trailing blanks."""
    return f"{letter}{joint}".rstrip()


def _from_csv(path: Path, robot: Robot) -> tuple[Trajectory, float]:
    """Interpolate the samples of a file by a fifth-order spline."""
    from scipy.interpolate import make_interp_spline

    names = [log_column("q_", joint) for joint in robot.actuated]  # as 'gtau excite' writes them
    columns = read_log(path, ("t", *names)).arrays()
    time, q = columns["t"], np.column_stack([columns[name] for name in names])
    if not (np.isfinite(time).all() and np.isfinite(q).all() and len(time) > 5 and (np.diff(time) > 0).all()):
        raise GtauError(
            f"{path}: the columns t and {', '.join(names)} must hold at least six rows of numbers with rising times; "
            "correct the file."
        )
    spline, duration = make_interp_spline(time - time[0], q, k=5), float(time[-1] - time[0])

    def sampled(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        t = np.clip(time, 0.0, duration)
        inside = (t == time)[:, None]
        return spline(t), inside * spline(t, 1), inside * spline(t, 2)

    return sampled, duration


def _check_limits(samples: tuple[np.ndarray, np.ndarray, np.ndarray], robot: Robot, where: str) -> None:
    """Refuse positions, velocities and accelerations (N, n) beyond the limits of the robot's file."""
    q, *rates = samples
    for j, name in enumerate(robot.actuated):
        joint, limits = robot.joint(name), robot.joint(name).limits
        check_positions(q[:, j], joint, where)
        allowed = {f"{joint.unit}/s": limits.velocity, f"{joint.unit}/s2": limits.acceleration}
        for rate, (unit, limit) in zip(rates, allowed.items(), strict=True):
            most = np.abs(rate[:, j]).max()
            if limit is not None and most > ROUNDED * limit:
                raise GtauError(
                    f"{where}: joint '{name}' would reach {most:.4g} {unit}, beyond its limit of {limit:.4g} {unit}; "
                    "make the motion slower, smaller or smoother."
                )


def check_positions(q: np.ndarray, joint: Joint, where: str) -> None:
    """Refuse positions (N,) of a joint, rad or m, beyond its limits; ``where`` names the run in the message."""
    low, high = joint.limits.position or (-np.inf, np.inf)
    if q.min() < low - 1e-9 or q.max() > high + 1e-9:
        raise GtauError(
            f"{where}: joint '{joint.name}' would move from {q.min():.4g} to {q.max():.4g}, beyond its limits "
            f"{low:.4g} to {high:.4g}; make the motion smaller."
        )
