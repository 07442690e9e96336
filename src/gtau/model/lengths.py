"""Geometric constants of a robot, lengths and encoder zeros: how poses of bodies, and torques, depend on them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from gtau.model.equations import closed_motion, closure_expressions, newton_step, scaled
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.kinematics import SAME_LENGTH, Coordinates, constant, frames, placements, shifted, twists
from gtau.model.loops import Motion
from gtau.model.program import Program, compile_program
from gtau.robots.geometry import characteristic_length
from gtau.robots.parameter import Parameter
from gtau.robots.robot import Mdh, Placement, Robot

# Measured on 17 robots of the catalog and of third-party robot files: the shortest length is 0.046 of the
# characteristic length and the closest two differ by 0.0013, while rounding parts equal ones by 1e-13 at most.
SHORT = 1e-4  # of the characteristic length: anything shorter is no length
HOLDING = 1e-6  # of a length's change: closure error with which the closures follow it
CLOSED = 1e-11  # last correction of the passive coordinates, rad or characteristic lengths
STEPS = 20
FEW_STEPS = 3  # of Newton's method after changes of 1e-4: each squares the error


@dataclass(frozen=True)
class Constant:
    """A length, m, with the places and unit vectors along which it is laid off, or the zero of an encoder (value 0)."""

    name: str
    value: float
    unit: str
    directions: tuple[tuple[int, np.ndarray], ...] = ()


@dataclass(frozen=True, eq=False)
class BodyPose:
    """Pose of a body in the base, with derivatives in m and rad."""

    position: np.ndarray  # (N, 3)
    rotation: np.ndarray  # (N, 3, 3)
    by_constants: np.ndarray  # (N, 6, constants); nan by a constant that the closures cannot follow
    by_joints: np.ndarray  # (N, 6, n)


@dataclass(frozen=True, eq=False)
class VariableGeometry:
    """A robot with variable ``constants``, lengths and then the actuated joints' zeros, and the pose of a body.

    ``program`` maps c and, for all samples alike, the shifts of all places to the residual (``rows``,) of the closures,
    their derivatives by the scaled passive coordinates, the actuated ones and the shifts, and to the pose of the body
    with its derivatives by yd and the shifts.
    """

    layout: Coordinates
    constants: tuple[Constant, ...]
    shifts: np.ndarray  # (3 places, constants) shift of each place for a unit of each constant
    rows: int
    program: Program

    def close(self, c: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray | None:
        """Close ``c`` (n_c, N), closed with changes ``before`` of the constants, with those ``after``, if it can be."""
        layout, shift = self.layout, self.shifts @ after
        step = np.zeros((layout.n_y, c.shape[1]))
        step[layout.actuated] = (after - before)[-len(layout.actuated) :, None]
        c = layout.retract(c, step)
        if not self.rows:
            return c
        for _ in range(STEPS):
            residual, G_p, *_ = self._evaluate(c, shift)
            correction = -(np.linalg.pinv(G_p) @ residual[:, :, None])[:, :, 0]
            step = np.zeros((layout.n_y, c.shape[1]))
            step[layout.passive] = (correction * layout.unit[layout.passive]).T
            c = layout.retract(c, step)
            if np.abs(correction).max(initial=0.0) < CLOSED:
                residual = self._evaluate(c, shift)[0]
                return c if np.abs(residual).max(initial=0.0) < HOLDING else None
        return None

    def pose(self, c: np.ndarray, change: np.ndarray) -> BodyPose:
        """Compute the pose of the body at configurations ``c`` (n_c, N) closed with these changes of the constants."""
        layout, n = self.layout, len(self.layout.actuated)
        _, G_p, G_a, G_s, position, rotation, J, J_s = self._evaluate(c, self.shifts @ change)
        G = np.concatenate([G_a, G_s @ self.shifts], axis=2)
        follow = -np.linalg.pinv(G_p) @ G if self.rows else np.zeros((len(position), len(layout.passive), G.shape[2]))
        gap = np.abs(G + G_p @ follow).max(axis=(0, 1), initial=0.0)
        direct = np.concatenate([J[:, :, layout.actuated], J_s @ self.shifts], axis=2)
        moved = direct + J[:, :, layout.passive] @ (follow * layout.unit[layout.passive][:, None])
        moved[:, :, gap > HOLDING * np.maximum(np.abs(G).max(axis=(0, 1), initial=0.0), 1e-300)] = np.nan
        by_joints, by_constants = moved[:, :, :n], moved[:, :, n:]
        by_constants[:, :, -n:] = by_joints
        return BodyPose(position, rotation, by_constants, by_joints)

    def _evaluate(self, c: np.ndarray, shift: np.ndarray) -> list[np.ndarray]:
        """Evaluate the program, samples first: (N, rows), (N, rows, n_passive), ..., (N, 6, 3 places)."""
        layout, places = self.layout, shift.size
        by_rows = [(self.rows, size) for size in (len(layout.passive), len(layout.actuated), places)]
        shapes = [(self.rows,), *by_rows, (3,), (3, 3), (6, layout.n_y), (6, places)]
        ends = np.cumsum([int(np.prod(shape)) for shape in shapes])
        parts = np.split(self.program(c, parameters=shift), ends[:-1])
        return [part.T.reshape(c.shape[1], *shape) for part, shape in zip(parts, shapes, strict=True)]


def variable_geometry(robot: Robot, body: str) -> VariableGeometry:
    """Derive the pose of a ``body`` as a function of all lengths, also of equal ones together, and encoder zeros."""
    layout = Coordinates(robot)
    lengths = [length for _, alike in _equal_lengths(robot) for length in alike]
    zeros = [Constant(f"zero of '{name}'", 0.0, robot.joint(name).unit) for name in robot.actuated]
    s = ca.SX.sym("s", 3 * (len(robot.joints) + 2 * len(robot.closures)))
    varied = Coordinates(shifted(robot, ca.vertsplit(s, 3)))
    c, yd = ca.SX.sym("c", layout.n_c), ca.SX.sym("yd", layout.n_y)
    residual, velocity, _ = closure_expressions(varied, c, yd)
    frame = frames(varied, c)
    twist, at = twists(varied, frame, yd)[body], frame[body]
    G_p, G_a = scaled(layout, velocity, yd)
    J = ca.jacobian(ca.vertcat(at.R_0 @ twist.linear, at.R_0 @ twist.angular), yd)
    J_s = ca.vertcat(ca.jacobian(at.p_0, s), ca.SX(3, s.numel()))
    outputs = [output.T for output in (G_p, G_a, ca.jacobian(residual, s), at.p_0.T, at.R_0, J, J_s)]
    shifts = np.zeros((s.numel(), len(lengths) + len(zeros)))
    for k, length in enumerate(lengths):
        for place, direction in length.directions:
            shifts[3 * place : 3 * place + 3, k] += direction
    program = compile_program([c], [residual, *outputs], [s])
    return VariableGeometry(layout, (*lengths, *zeros), shifts, residual.numel(), program)


@dataclass(frozen=True, eq=False)
class VariableTorques:
    """Torques of a ``model`` with values of the parameters ``names``, as functions of the lengths of its robot."""

    model: InverseDynamics
    names: tuple[Parameter, ...]

    @cached_property
    def constants(self) -> tuple[Constant, ...]:
        """The lengths along axes: those of one name in the file together, in robots with loops equal ones as well."""
        return tuple(
            length
            for called, alike in _equal_lengths(self.model.robot, distances=False)
            for length in (alike[-1:] if called else alike)
            if called or self.model.robot.closures or len(length.directions) == 1
        )

    @cached_property
    def _programs(self) -> tuple[Program, Program, Program]:
        """Programs of a step that closes the loops, of the motion, and of the torques, by changes of the lengths."""
        robot, change = self.model.robot, ca.SX.sym("change", len(self.constants))
        shifts = [ca.SX(3, 1)] * len(placements(robot))
        for k, length in enumerate(self.constants):
            for place, direction in length.directions:
                shifts[place] += constant(direction) * change[k]
        varied = InverseDynamics(shifted(robot, shifts))
        regressor, chi = varied.columns(self.names), ca.SX.sym("chi", len(self.names))
        (c, step), (inputs, motion) = newton_step(varied.layout), closed_motion(varied.layout)
        return (
            compile_program([c], step[:1], [change]),
            compile_program(inputs, [output.T for output in motion[1:]], [change]),
            compile_program(regressor.inputs, [regressor.matrix @ chi], [chi, change]),
        )

    def __call__(self, motion: Motion, values: np.ndarray, change: np.ndarray) -> np.ndarray:
        """Compute the torques (n, N) of the positions of a ``motion`` with a small ``change`` of the lengths, m."""
        layout, (step, rates, torques) = self.model.layout, self._programs
        c, yd, ydd, J = motion.c, motion.yd, motion.ydd, motion.J
        if layout.passive.size:
            for _ in range(FEW_STEPS):
                c = step(c, parameters=change)
            yd, ydd, J = np.split(rates(c, yd[layout.actuated], ydd[layout.actuated], parameters=change),
                                  np.cumsum([layout.n_y, layout.n_y]))  # fmt: skip
            J = J.reshape(layout.n_y, -1, c.shape[1])
        passive = J[layout.passive].reshape(-1, c.shape[1])
        return torques(c, yd, ydd, passive, parameters=np.concatenate([values, change]))


def _equal_lengths(robot: Robot, distances: bool = True) -> Iterator[tuple[str, list[Constant]]]:
    """Iterate over equal lengths and their name in the file: each by itself, then all together.

    Without ``distances`` along the axes of placements alone.
    """
    names = [f"'{joint.name}'" for joint in robot.joints]
    for number, closure in enumerate(robot.closures, start=1):
        names += [f"closure {number} on '{end.body}'" for end in (closure.a, closure.b)]
    shortest = SHORT * characteristic_length(robot)
    same: dict[float, list[tuple[str, tuple[int, np.ndarray]]]] = {}
    for k, (place, placement) in enumerate(zip(names, placements(robot), strict=False)):  # springs come last
        for what, value, direction in _lengths(placement):
            if value > shortest and (distances or what != "distance"):
                key = next((known for known in same if abs(known - value) < SAME_LENGTH * known), value)
                same.setdefault(key, []).append((f"{what} of {place}", (k, direction)))
    for value, uses in same.items():
        named = [name for name, constant in robot.file.constants if abs(abs(constant) - value) < SAME_LENGTH * value]
        called = "/".join(named)
        prefix = f"{called}, " if called else ""
        alike = [Constant(f"{prefix}{place}", value, "m", (at,)) for place, at in uses]
        if len(uses) > 1:
            name = called or f"{1e3 * value:.4g} mm"
            alike.append(Constant(f"{name} at all {len(uses)} places", value, "m", tuple(at for _, at in uses)))
        yield called, alike


def _lengths(placement: Placement) -> Iterator[tuple[str, float, np.ndarray]]:
    """Iterate over the lengths of a placement, with its directions of displacement as they grow."""
    if isinstance(placement, Mdh):
        before = replace(placement, d=0.0, b=0.0, r=0.0)
        for name in ("d", "r", "b"):
            value = getattr(placement, name)
            if value:
                yield name, abs(value), replace(before, **{name: float(np.sign(value))}).position
        return
    position = placement.position
    if np.count_nonzero(position) > 1:
        length = float(np.linalg.norm(position))
        yield "distance", length, position / length
    for name, value, axis in zip("xyz", position.tolist(), np.eye(3), strict=True):
        if value:
            yield name, abs(value), np.sign(value) * axis
