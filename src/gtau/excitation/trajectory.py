"""Fourier series that begin and end at rest, quintic moves to them, and gradients through closed loops.

:mod:`gtau.model.loops` closes the loops numerically. The gradients come from CasADi: along closed loops the
configuration moves by ``J qd``, and eqs. (5) to (8) give yd, ydd and J.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from gtau.model.equations import closed_motion, torques
from gtau.model.inverse_dynamics import InverseDynamics, Regressor
from gtau.model.kinematics import Coordinates, configuration_rates
from gtau.model.loops import Motion
from gtau.model.program import Program, compile_program
from gtau.robots.parameter import Parameter

SHORTEST_APPROACH = 1.0  # s
GENTLE = 2.0  # duration over the shortest within speed, acceleration and jerk, so that currents stay within theirs
PEAKS = (1.875, 10 / 3**0.5, 60.0)  # largest speed, acceleration and jerk of a quintic move by 1 in 1 s


@dataclass(frozen=True, eq=False)
class FourierSeries:
    """Periodic motion of m coordinates, at rest at the beginning of every period.

    A coordinate is ``center + sum over k of a_k sin(k w t) + b_k cos(k w t)``, with k up to ``harmonics`` and w the
    angular ``base_frequency`` (Hz). Zero speed and acceleration at t = 0 leave ``2 harmonics - 1`` free numbers per
    coordinate. The vector x (size,) holds these numbers, coordinate by coordinate, in units of ``half`` (m,), with
    amplitudes that fall with k. The coordinates are the actuated joints.
    """

    center: np.ndarray
    half: np.ndarray
    base_frequency: float
    harmonics: int

    @property
    def period(self) -> float:
        """Duration of a period, s."""
        return 1.0 / self.base_frequency

    @property
    def free(self) -> int:
        """Free numbers per coordinate: the center, and the coefficients that the two rest conditions leave free."""
        return 2 * self.harmonics - 1

    @property
    def size(self) -> int:
        """Length of x."""
        return len(self.center) * self.free

    def basis(self, time: np.ndarray) -> np.ndarray:
        """Compute the derivatives (4, N, free) of position to jerk by the free numbers of a coordinate, half = 1."""
        k = np.arange(1, self.harmonics + 1)
        omega = 2 * np.pi * self.base_frequency * k
        # speed at t = 0: sum of a_k = 0; acceleration at t = 0: sum of k b_k = 0
        at_rest = np.zeros((2, 2 * self.harmonics))
        at_rest[0, : self.harmonics] = 1.0
        at_rest[1, self.harmonics :] = k / np.linalg.norm(k)
        null = np.linalg.svd(at_rest)[2][2:].T
        basis = np.zeros((4, len(time), self.free))
        basis[0, :, 0] = 1.0
        for order in range(4):
            # a derivative is a quarter turn ahead
            angle = np.multiply.outer(time, omega) + order * np.pi / 2
            waves = np.hstack([np.sin(angle), np.cos(angle)])
            # divided by k, every harmonic has the same speed
            basis[order, :, 1:] = waves * np.tile(omega**order / k, 2) @ null
        return basis

    def along(self, x: np.ndarray, basis: np.ndarray) -> np.ndarray:
        """Evaluate positions, velocities, accelerations and jerks (4, m, N), rad or m and s, at a :meth:`basis`."""
        numbers = x.reshape(-1, self.free) * self.half[:, None]
        table = (basis @ numbers.T).transpose(0, 2, 1)
        table[0] += self.center[:, None]
        return np.asarray(table)

    def random(self, rng: np.random.Generator) -> np.ndarray:
        """Draw a random x whose harmonics all have about the same speed."""
        x = rng.normal(size=(len(self.center), self.free))
        x[:, 0] *= 0.1
        return x.reshape(-1)


def quintic(start: np.ndarray, end: np.ndarray, duration: float, time: np.ndarray) -> np.ndarray:
    """Evaluate a straight move from rest to rest at ``time``: position, velocity, acceleration and jerk (4, m, N)."""
    u = np.clip(time / duration, 0.0, 1.0)
    shares = [
        u**3 * (10 - 15 * u + 6 * u**2),
        30 * u**2 * (1 - u) ** 2 / duration,
        60 * u * (1 - u) * (1 - 2 * u) / duration**2,
        60 * (1 - 6 * u + 6 * u**2) / duration**3,
    ]
    moves = np.stack(shares)[:, None] * (end - start)[:, None]
    moves[0] += start[:, None]
    return moves


def move_duration(way: np.ndarray, rates: np.ndarray) -> float:
    """Compute the shortest duration, s, of a quintic move by ``way`` (m,) within speed, acceleration, jerk (3, m)."""
    powers = (np.abs(way) * peak / limit for peak, limit in zip(PEAKS, rates, strict=True))
    return float(np.max([power ** (1 / order) for order, power in enumerate(powers, start=1)]))


def approach_duration(way: np.ndarray, rates: np.ndarray) -> float:
    """Compute the duration, s, of the approach to a motion that begins ``way`` (m,) away from rest."""
    return max(GENTLE * move_duration(way, rates), SHORTEST_APPROACH)


class Pullback:
    """Conversion of derivatives by the motion of the whole robot into derivatives by q, qd and qdd of its motors."""

    def __init__(self, model: InverseDynamics):
        layout = self.layout = model.layout
        n = len(layout.actuated)
        self._rows = layout.n_c + 2 * layout.n_y + n * len(layout.passive)
        self._program: Program | None = None
        if model.loops is None:
            return
        (c, qd, qdd), (condition, yd, ydd, J) = closed_motion(layout)
        values = ca.vertcat(c, yd, ydd, ca.vec(J[layout.passive.tolist(), :].T), ca.log(condition))
        weights, rate = ca.SX.sym("weights", self._rows + 1), ca.SX.sym("rate", n)
        total = ca.dot(weights, values)
        along_c = ca.dot(configuration_rates(layout, c, J @ rate), ca.gradient(total, c))
        slopes = ca.gradient(along_c, rate), ca.gradient(total, qd), ca.gradient(total, qdd)
        self._program = compile_program([c, qd, qdd, weights], [ca.densify(ca.vertcat(*slopes))])

    def __call__(self, motion: Motion, slopes: np.ndarray, by_condition: float = 0.0) -> np.ndarray:
        """Return the derivatives (3, n, N) of one scalar per sample by q, qd and qdd of the actuated joints.

        ``slopes`` (rows, N) are its derivatives by c, yd, ydd and the passive rows of J; rows left out at the end are
        zero. ``by_condition`` is its derivative by the logarithm of the condition number of the closures.
        """
        actuated, samples = self.layout.actuated, motion.c.shape[1]
        slopes = np.pad(slopes, ((0, self._rows - len(slopes)), (0, 0)))
        if self._program is not None:
            weights = np.vstack([slopes, np.full(samples, by_condition)])
            slopes = self._program(motion.c, motion.yd[actuated], motion.ydd[actuated], weights)
        return slopes.reshape(3, -1, samples)


@dataclass(frozen=True, eq=False)
class SmoothRegressor:
    """Columns of a robot's regressor with smooth Coulomb friction; ``back`` is the gradient of their weighted sum."""

    layout: Coordinates
    entries: Regressor
    back: Program
    width: np.ndarray  # (joints,) rad/s or m/s, speed range in which Coulomb friction changes its sign

    def __call__(self, motion: Motion) -> np.ndarray:
        """Evaluate the columns in the rows of all actuated joints, (n, N, columns)."""
        entries = self.entries.program(*self._inputs(motion))
        W = np.zeros((len(self.layout.actuated), entries.shape[1], len(self.entries.names)))
        W[self.entries.rows, :, self.entries.columns] = entries
        return W

    def slopes(self, motion: Motion, weights: np.ndarray) -> np.ndarray:
        """Differentiate ``sum(weights * W)`` of every sample, weights (n, N, columns), by c, yd, ydd and passive J."""
        return self.back(*self._inputs(motion), weights[self.entries.rows, :, self.entries.columns])

    def _inputs(self, motion: Motion) -> tuple[np.ndarray, ...]:
        width = np.broadcast_to(self.width[:, None], (len(self.width), motion.c.shape[1]))
        return *self.entries.sources(self.layout, motion), width


def smooth_regressor(model: InverseDynamics, names: Sequence[Parameter], width: np.ndarray) -> SmoothRegressor:
    """Compile columns of a regressor and their gradient, with Coulomb friction ``v / sqrt(v^2 + width^2)``."""
    inputs, J = model.symbols
    (c, yd, ydd, _), wide = inputs, ca.SX.sym("width", len(model.robot.joints))
    chi = {name: ca.SX.sym(name) for name in model.parameter_names}
    tau = torques(model.layout, c, yd, ydd, J, {name: value for name, value in chi.items() if name.kind != "fs"})
    for k, joint in enumerate(model.robot.joints):
        if (dry := Parameter("fs", joint.name)) in chi:
            tau += J[k, :].T * chi[dry] * yd[k] / ca.sqrt(yd[k] ** 2 + wide[k] ** 2)
    columns = ca.jacobian(tau, ca.vertcat(*(chi[name] for name in names)))
    entries = Regressor(tuple(names), [*inputs, wide], columns)
    values = ca.vec(columns.nz[:])
    weights = ca.SX.sym("weights", values.numel())
    back = ca.gradient(ca.dot(weights, values), ca.veccat(*inputs))
    return SmoothRegressor(model.layout, entries, compile_program([*inputs, wide, weights], [back]), width)
