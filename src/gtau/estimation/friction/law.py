"""Friction of an identified model at any speed, load and temperature: it never adds energy to the robot.

A joint's friction is

    ``fv qd + (fs + fb exp(-|qd| / v_s) + fl |tau_load|) z``,

with ``z = sign(qd)`` where it slides, and where its logs show presliding the state of a stop operator of its width
(``stop``). ``fb`` is the excess of friction at rest over fast sliding: Stribeck's effect where positive, viscous
friction that saturates where negative. Both and ``fl`` come from all samples
(:mod:`gtau.estimation.friction.selection`), with coefficients for which the law dissipates energy at every speed.

The plain law of the equations of identification has ``z = sign(qd)`` and a cubic term ``f3 qd^3``. Its coefficients may
be negative, and a polynomial says nothing beyond the speeds of the logs: with ``f3 < 0`` it turns into propulsion. So

- beyond the fastest logged speed V of an actuated joint friction goes on along its slope at V, or stays at its value
  where that slope is negative;
- where some terms still propel, as a negative ``fs`` does near standstill or a negative ``fl`` under a great load, they
  are scaled down until they add no more power than the others dissipate.

Powers are computed for sliding joints. They are balanced joint by joint, and together for joints that move each other:
of a coupling, or of closed loops. Where friction is dissipative, it is not changed. Offsets are constant torques, of
the amplifiers for instance: they do no work around a closed path, and stay as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import ModuleType
from typing import Any

import numpy as np

from gtau.estimation.regression.plausibility import motor_to_joint_speed
from gtau.estimation.regression.rows import FORMULAS, SLOPES, Sliding, stop
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.loops import Motion
from gtau.robots.parameter import Parameter
from gtau.robots.robot import DAMPING, PLAIN_FRICTION

JOINT_TERMS = [kind for kind in FORMULAS if kind not in SLOPES]
LEAST_POWER = 1e-300  # W: keeps 0/0 out of a joint at rest
SPEEDS = 200  # at which a straight line is fitted


class PreslidingState:
    """Elements of some widths along a path in blocks, which may overlap: states continue from block to block.

    They begin at 0: where a joint rests, the direction of approach is unknown, and a moving joint slips after its
    width.
    """

    def __init__(self, widths: np.ndarray) -> None:
        self._widths = widths
        self._time = np.zeros(0)
        self._states = np.zeros((len(widths), 0))

    def __call__(self, time: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Follow positions (N,) at times (N,), s: states (w, N)."""
        known = int(np.searchsorted(self._time, time[0]))
        start = self._states[:, known] if known < len(self._time) else np.zeros(len(self._widths))
        self._time, self._states = time, stop(q, self._widths, start)
        return self._states


@dataclass(frozen=True, eq=False)
class FrictionLaw:
    """Friction of a robot as a function of its parameters, some of which may add energy.

    ``logged_speeds`` are V by actuated joint, rad/s or m/s, 0 where missing, so that its ``f3`` does not count;
    ``shapes`` widths and speeds by name (:data:`.parameter.SHAPES`): a joint without a width slides at once.
    """

    model: InverseDynamics
    logged_speeds: Mapping[str, float]
    shapes: Mapping[Parameter, float] = field(default_factory=dict)

    @cached_property
    def states(self) -> tuple[int, ...]:
        """Rows of the joints with presliding among the robot's joints, in the order of ``z``."""
        joints = self.model.robot.joints
        return tuple(row for row, joint in enumerate(joints) if Parameter("width", joint.name) in self.shapes)

    @property
    def widths(self) -> np.ndarray:
        """Widths (s,) of the presliding of ``states``, rad or m."""
        return np.array([self.shapes[Parameter("width", self.model.robot.joints[row].name)] for row in self.states])

    def followers(self, path: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
        """Make the followers of a run in blocks: from times (N,) to states z (s, N), by actuated positions."""
        ratios = self.ratios[list(self.states)]
        elements = [PreslidingState(np.array([width])) for width in self.widths]

        def follow(time: np.ndarray) -> np.ndarray:
            moved = zip(elements, ratios @ path(time), strict=True)
            return np.reshape([element(time, q)[0] for element, q in moved], (len(elements), len(time)))

        return follow

    @cached_property
    def ratios(self) -> np.ndarray:
        """Speeds (joints, n) of all joints for unit speeds of actuated ones, where these are constant."""
        layout, robot = self.model.layout, self.model.robot
        if robot.couplings and not robot.closures:
            return motor_to_joint_speed(self.model)[: len(robot.joints)]
        ratios = np.zeros((len(robot.joints), len(layout.actuated)))
        ratios[layout.actuated, np.arange(len(layout.actuated))] = 1.0
        return ratios

    @cached_property
    def groups(self) -> np.ndarray:
        """Membership (groups, joints + n) of joints and then of the terms of actuated joints; 0 or 1."""
        joints, n = self.ratios.shape
        if self.model.robot.closures:
            return np.ones((1, joints + n))
        from scipy.sparse.csgraph import connected_components

        driven = self.ratios != 0
        count, group = connected_components(driven.T.astype(int) @ driven.astype(int), directed=False)
        members = np.eye(count)[:, group]
        return np.hstack([(members @ driven.T > 0).astype(float), members])

    def directions(self, math: ModuleType, yd: Any, z: Any) -> list[Any]:
        """List the direction factor of each joint's friction: its presliding state (``z`` (s,)), else ``sign(yd)``."""
        states = {row: z[k] for k, row in enumerate(self.states)}
        return [states[row] if row in states else math.sign(yd[row]) for row in range(len(self.ratios))]

    def forces(
        self, math: ModuleType, values: Mapping[str, Any], yd: Any, load: Any, z: Sequence[Any] | None = None
    ) -> tuple[list[Any], list[Any]]:
        """Compute friction torques and the speeds that they oppose: of all joints, then the f3 of actuated ones.

        ``math`` is numpy for arrays, casadi for expressions. ``values`` are ``fv``, ``fs``, ``fb``, ``fl`` and ``f3``
        by name, zero where missing; ``yd`` velocities of the tree, ``load`` torques (n,) that the actuated joints
        transmit, ``z`` the :meth:`directions` of the joints, without which all slide.
        """
        forces, speeds = [], []
        for row, joint in enumerate(self.model.robot.joints):
            speed, motor = yd[row], self.motor(row)
            direction = math.sign(speed) if z is None else z[row]
            felt = 0.0 if motor is None else math.fabs(load[motor] / self.ratios[row, motor])
            at = Sliding(speed, direction, felt, self._falling(math, speed, joint.name))
            forces.append(_summed(values, joint.name, at, JOINT_TERMS))
            speeds.append(speed)
        for j, name in enumerate(self.model.actuated):
            speed = yd[self.model.layout.actuated[j]]
            top = float(self.logged_speeds.get(name, 0.0))
            within = math.fmax(math.fmin(speed, top), -top)
            slope = sum(derivative(top) * values.get(Parameter(kind, name), 0.0) for kind, derivative in SLOPES.items())
            moved = zip(self.model.robot.joints, self.ratios[:, j], strict=True)
            viscous = sum(values.get(Parameter("fv", joint.name), 0.0) * ratio**2 for joint, ratio in moved if ratio)
            slope = math.fmax(slope, -viscous)  # together at least 0
            forces.append(_summed(values, name, Sliding(within, 0.0), SLOPES) + slope * (speed - within))
            speeds.append(speed)
        return forces, speeds

    def _falling(self, math: ModuleType, speed: Any, joint: str) -> Any:
        v_s = self.shapes.get(Parameter("vs", joint))
        return math.exp(-math.fabs(speed) / v_s) if v_s else 0.0

    def motor(self, row: int) -> int | None:
        """Return the motor that alone moves a joint, whose load is its own; None where several do, or none."""
        moving = np.flatnonzero(self.ratios[row])
        return int(moving[0]) if len(moving) == 1 else None

    def scales(self, math: ModuleType, forces: Any, speeds: Any) -> Any:
        """Compute the scale factor of each force (joints + n,): 1, or less where it adds more power than allowed."""
        groups = self.groups if math is np else math.DM(self.groups)
        power = forces * speeds
        drawn = groups @ math.fmax(power, 0.0)
        given = groups @ math.fmax(-power, 0.0)
        allowed = groups.T @ (drawn / math.fmax(math.fmax(drawn, given), LEAST_POWER))
        return 1.0 - (1.0 - allowed) * math.fmax(-math.sign(power), 0.0)

    def logged(self, joint: str) -> str:
        """Write V of a joint with its unit."""
        return f"{self.fastest(joint):.3g} {self.model.robot.joint(joint).unit}/s"

    @property
    def range_sentence(self) -> str:
        """Describe the range of speeds over which friction was identified, and its extrapolation."""
        listed = ", ".join(f"{joint} {self.logged(joint)}" for joint in self.logged_speeds)
        return (
            f"Friction is identified up to the fastest logged speeds ({listed}). Beyond it is extrapolated: along its "
            "slope there, or constant where that is negative. Friction never adds energy: terms that would are scaled "
            "down."
        )

    def straight(self, values: Mapping[str, float], joint: str) -> tuple[float, float]:
        """Fit viscous and Coulomb friction, neither negative, to a joint that slides up to V, for engines."""
        from scipy.optimize import nnls

        speed = np.linspace(0.0, self.fastest(joint), SPEEDS)[1:]
        at = Sliding(speed, 1.0, 0.0, self._falling(np, speed, joint))
        friction = np.maximum(_summed(values, joint, at, FORMULAS), 0.0)
        (viscous, coulomb), _ = nnls(np.stack([speed, np.ones_like(speed)], axis=1), friction)
        return float(viscous), float(coulomb)

    def fastest(self, joint: str) -> float:
        """Return V of any joint, from the speeds of the motors that move it, rad/s or m/s."""
        logged = [self.logged_speeds.get(name, 0.0) for name in self.model.actuated]
        return float(np.abs(self.ratios[self._row(joint)]) @ logged)

    def torques(
        self, motion: Motion, values: Mapping[str, Any], load: np.ndarray, z: np.ndarray | None = None
    ) -> np.ndarray:
        """Compute torques (n, N) of friction and offsets along a motion of N samples.

        ``values`` are the parameters of :meth:`forces`, and ``off``, by name, numbers or (N,); ``load`` (n, N) are
        torques that the actuated joints transmit, ``z`` (s, N) states of presliding; without them all joints slide.
        """
        joints, n_joints = self.model.robot.joints, len(self.model.robot.joints)
        forces, speeds = map(np.stack, self.forces(np, values, motion.yd, load))
        scales = self.scales(np, forces, speeds)
        if z is not None and self.states:
            forces = np.stack(self.forces(np, values, motion.yd, load, self.directions(np, motion.yd, z))[0])
        forces = forces * scales
        for row, joint in enumerate(joints):
            forces[row] += values.get(Parameter("off", joint.name), 0.0)
        joint_part = np.einsum("kjm,km->jm", motion.J[:n_joints], forces[:n_joints])
        return np.asarray(joint_part + forces[n_joints:])

    def motor_of(self, joint: str) -> str | None:
        """Return the name of the motor that alone moves a joint; see :meth:`motor`."""
        motor = self.motor(self._row(joint))
        return None if motor is None else self.model.actuated[motor]

    def _row(self, name: str) -> int:
        return next(row for row, joint in enumerate(self.model.robot.joints) if joint.name == name)


def _summed(values: Mapping[str, Any], joint: str, at: Sliding, kinds: Iterable[str]) -> Any:
    named = ((FORMULAS[kind], values.get(Parameter(kind, joint))) for kind in kinds)
    return sum((value * formula(at) for formula, value in named if value is not None), 0.0 * at.speed)


def transmitted(math: ModuleType, standard: tuple[Parameter, ...], chi: Any) -> list[Any]:
    """Return the base parameters (n_b) of the torques that joints transmit: no friction, no propelling damper."""
    return [
        0.0 * chi[k] if name.kind in PLAIN_FRICTION else math.fmax(chi[k], 0.0) if name.kind == DAMPING else chi[k]
        for k, name in enumerate(standard)
    ]
