"""Exciting trajectories of the actuated joints: sums of sines, and moves from point to point.

A trajectory takes instants (N,) in s and returns positions, velocities and accelerations, each (N, n)
in rad or m and s. It starts and ends at rest, and is constant outside its duration.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count

import numpy as np

from gtau.errors import GtauError
from gtau.robots.robot import Robot

Trajectory = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]

FREQUENCIES = np.array([0.1, 0.2, 0.35, 0.55, 0.85, 1.35, 2.15, 3.45])  # Hz
RAMP = 1.5  # s, from rest to full motion and back
REST = 0.05  # s, between two moves


@dataclass(frozen=True, eq=False)
class Envelope:
    """Motion range of a trajectory, (n,) each: ``reach`` on either side of ``center``, speed, acceleration."""

    center: np.ndarray
    reach: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray


def envelope(robot: Robot, share: float = 0.9) -> Envelope:
    """Take a share of the actuated joints' limits; ten times the speed in a second where no acceleration is given.

    Raises
    ------
    GtauError
        Where a joint has no limits of position or velocity.
    """
    limits = {name: robot.joint(name).limits for name in robot.actuated}
    for name, each in limits.items():
        if each.position is None or each.velocity is None:
            raise GtauError(
                f"robot '{robot.name}': joint '{name}' has no {'position' if each.position is None else 'velocity'} "
                "limit to move within; add it to the robot file."
            )
    low, high = np.array([each.position for each in limits.values()], dtype=float).T
    velocity = np.array([each.velocity for each in limits.values()], dtype=float)
    given = [each.acceleration or 10.0 * speed for each, speed in zip(limits.values(), velocity, strict=True)]
    return Envelope((low + high) / 2, share * (high - low) / 2, share * velocity, share * np.array(given))


def _blend(u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Evaluate the quintic from 0 to 1, at rest at both ends of [0, 1], and its first two derivatives."""
    u = np.clip(u, 0.0, 1.0)
    return u**3 * (10 - 15 * u + 6 * u**2), 30 * u**2 * (1 - u) ** 2, 60 * u * (1 - u) * (1 - 2 * u)


@dataclass(frozen=True, eq=False)
class Sines:
    """A sum of sines about ``center``, faded in and out.

    ``amplitude`` and ``phase`` (n, K) in rad or m and rad, ``frequency`` (K,) or (n, K) in Hz, ``duration`` in s.
    """

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
        rise, fall = _blend(t / RAMP), _blend((self.duration - t) / RAMP)
        w = (rise[0] * fall[0])[:, None]
        wd = ((rise[1] * fall[0] - rise[0] * fall[1]) / RAMP)[:, None]
        wdd = ((rise[2] * fall[0] - 2 * rise[1] * fall[1] + rise[0] * fall[2]) / RAMP**2)[:, None]
        return self.center + w * s, wd * s + w * sd, wdd * s + 2 * wd * sd + w * sdd


def sines(within: Envelope, duration: float, rng: np.random.Generator) -> Sines:
    """Draw a random sum of sines, as large as the envelope allows.

    Where a joint's acceleration would keep it small, its sines are slower instead, until its speed or reach is used.
    """
    shape = (len(within.center), len(FREQUENCIES))
    amplitude, phase = rng.uniform(0.5, 1.0, shape), rng.uniform(0, 2 * np.pi, shape)
    q, qd, qdd = _peaks(Sines(within.center, amplitude, phase, FREQUENCIES, duration))
    size = within.acceleration / qdd  # to which the accelerations keep the draft
    slower = np.maximum(size * qd / within.velocity, np.sqrt(size * q / within.reach))
    frequency = np.minimum(slower, 1.0)[:, None] * FREQUENCIES
    q, qd, qdd = _peaks(Sines(within.center, amplitude, phase, frequency, duration))
    scale = np.minimum(np.minimum(within.reach / q, within.velocity / qd), within.acceleration / qdd)
    return Sines(within.center, amplitude * scale[:, None], phase, frequency, duration)


def _peaks(motion: Sines) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the greatest distances from the center, speeds and accelerations, (n,) each."""
    q, qd, qdd = motion(np.arange(0.0, motion.duration, 0.05 / FREQUENCIES[-1]))
    return np.abs(q - motion.center).max(axis=0), np.abs(qd).max(axis=0), np.abs(qdd).max(axis=0)


@dataclass(frozen=True, eq=False)
class PointToPoint:
    """Fifth-order moves through ``points`` (K, n), from each at the instant ``starts`` (K - 1,) during ``spans``, s."""

    points: np.ndarray
    starts: np.ndarray
    spans: np.ndarray

    def __call__(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Evaluate positions, velocities and accelerations (N, n)."""
        k = np.clip(np.searchsorted(self.starts, time, side="right") - 1, 0, len(self.starts) - 1)
        span = self.spans[k]
        s, sd, sdd = _blend((time - self.starts[k]) / span)
        step = self.points[k + 1] - self.points[k]
        return (
            self.points[k] + s[:, None] * step,
            (sd / span)[:, None] * step,
            (sdd / span**2)[:, None] * step,
        )


def point_to_point(within: Envelope, duration: float, rng: np.random.Generator) -> PointToPoint:
    """Plan moves between random points, each as fast as the envelope allows, with a short rest between them."""
    return through(within, duration, (rng.uniform(-1.0, 1.0, len(within.center)) for _ in count()))


def through(within: Envelope, duration: float, targets: Iterator[np.ndarray], rest: float = REST) -> PointToPoint:
    """Plan moves from the center through ``targets``, each as fast as the envelope allows.

    Parameters
    ----------
    within : Envelope
        Motion range of the moves.
    duration : float
        Duration, s; only moves that end before it are made, but at least one.
    targets : iterator of ndarray
        Points (n,), from -1 to 1 of the envelope's reach to either side of its center; without end.
    rest : float
        Between two moves, s.
    """
    points, now = [within.center], 0.0
    starts: list[float] = []
    spans: list[float] = []
    while True:
        target = within.center + within.reach * next(targets)
        way = np.abs(target - points[-1])
        # the greatest speed and acceleration of the blend are 15/8 and 10/sqrt(3)
        span = float(max((1.875 * way / within.velocity).max(), np.sqrt(5.7736 * way / within.acceleration).max()))
        if starts and now + span > duration:
            return PointToPoint(np.array(points), np.array(starts), np.array(spans))
        points.append(target)
        starts.append(now)
        spans.append(span)
        now += span + rest
