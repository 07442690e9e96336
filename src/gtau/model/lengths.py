"""Geometric constants of a robot, lengths and encoder zeros, and the sensitivity of a body's pose to them.

With another length the loops close at other passive coordinates (eqs. 3 and 4); differentiated, they give the
derivative of a pose by each length at constant motor positions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, repeat

import casadi as ca
import numpy as np

from gtau.model.closures import closure_expressions
from gtau.model.interpreter.program import Program, compile_program
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.kinematics import Coordinates, Varied, constant, coordinates, frames, twists
from gtau.robots.geometry import characteristic_length, moved_ends
from gtau.robots.parameter import Parameter
from gtau.robots.placement import pose_of
from gtau.robots.robot import Mdh, Placement, Pose, Robot

# Measured on 17 robots, those of the catalog and of third-party robot files: the shortest length is 0.046 of the
# characteristic length and the closest two differ by 0.0013, while rounding parts equal ones by 1e-13 at most.
SHORT = 1e-4  # of the characteristic length: anything shorter is not intended as a length
SAME = 1e-6  # relative difference of lengths intended to be equal
HOLDING = 1e-6  # of a length's change: largest closure error with which the closures still follow it
CLOSED = 1e-11  # last correction of the passive coordinates, rad or characteristic lengths
STEPS = 20

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Constant:
    """A geometric constant: a length in m used in one or several placements, or the zero of an encoder.

    ``value`` is 0 for a zero. ``directions`` are its places with the unit vectors along which it is laid off, and
    ``joint`` the number of the actuated joint whose zero it is.
    """

    name: str
    value: float
    unit: str
    directions: tuple[tuple[int, Vector], ...] = ()
    joint: int | None = None


@dataclass(frozen=True, eq=False)
class BodyPose:
    """Position (N, 3) and orientation (N, 3, 3) of a body in the base.

    ``by_constants`` (N, 6, constants) and ``by_joints`` (N, 6, n) are their derivatives, m and rad in base axes; those
    by a constant that the closures cannot follow are nan.
    """

    position: np.ndarray
    rotation: np.ndarray
    by_constants: np.ndarray
    by_joints: np.ndarray


@dataclass(frozen=True, eq=False)
class VariableGeometry:
    """A robot with variable geometric ``constants``, and the pose of one of its bodies.

    ``program`` maps c and, for all samples alike, the shifts of all places to the residual of the closures, their
    derivatives by the scaled passive coordinates, the actuated ones and the shifts, and to the pose of the body with
    its derivatives by yd and the shifts.
    """

    layout: Coordinates
    constants: tuple[Constant, ...]
    shifts: np.ndarray  # (3 places, constants) shift of each place for a unit of each constant
    unit: np.ndarray  # (n_passive,) of the scaled passive coordinates, rad or m
    rows: int
    program: Program

    def close(self, c: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray | None:
        """Close the loops after a change of the constants, with the motors at the same logged positions.

        Configurations ``c`` (n_c, N) are closed with the changes ``before`` (constants,) from the values in the robot's
        file, and are to be with those of ``after``; None where the closures cannot follow.
        """
        layout, change = self.layout, after - before
        step = np.zeros((layout.n_y, c.shape[1]))
        for k, varied in enumerate(self.constants):
            if varied.joint is not None:
                step[layout.actuated[varied.joint]] += change[k]
        c = layout.retract(c, step)
        if not self.rows:
            return c
        shift = self.shifts @ after
        for _ in range(STEPS):
            residual, G_p, *_ = self._evaluate(c, shift)
            correction = -(np.linalg.pinv(G_p) @ residual[:, :, None])[:, :, 0]
            step = np.zeros((layout.n_y, c.shape[1]))
            step[layout.passive] = (correction * self.unit).T
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
        moved = direct + J[:, :, layout.passive] @ (follow * self.unit[:, None])
        moved[:, :, gap > HOLDING * np.maximum(np.abs(G).max(axis=(0, 1), initial=0.0), 1e-300)] = np.nan
        by_joints, by_constants = moved[:, :, :n], moved[:, :, n:]
        for k, varied in enumerate(self.constants):
            if varied.joint is not None:
                by_constants[:, :, k] = by_joints[:, :, varied.joint]
        return BodyPose(position, rotation, by_constants, by_joints)

    def _evaluate(self, c: np.ndarray, shift: np.ndarray) -> list[np.ndarray]:
        """Evaluate the program, samples first: (N, rows), (N, rows, n_passive), ..., (N, 6, 3 places)."""
        layout, samples = self.layout, c.shape[1]
        shapes = [
            (self.rows,),
            (self.rows, len(layout.passive)),
            (self.rows, len(layout.actuated)),
            (self.rows, shift.size),
            (3,),
            (3, 3),
            (6, layout.n_y),
            (6, shift.size),
        ]
        values = self.program(c, parameters=shift)
        parts = np.split(values, np.cumsum([int(np.prod(shape)) for shape in shapes])[:-1])
        return [part.T.reshape(samples, *shape) for part, shape in zip(parts, shapes, strict=True)]


def variable_geometry(robot: Robot, body: str) -> VariableGeometry:
    """Derive the pose of a ``body`` as a function of the robot's geometric constants.

    The constants are the lengths of all placements (a distance and, where it is oblique, its components; d, r and b
    of MDH placements), each by itself and those that are the same together, and the zeros of the actuated joints.
    """
    layout = coordinates(robot)
    places = list(_places(robot))
    s = ca.SX.sym("s", 3 * len(places))
    varied = replace(layout, robot=_shifted(robot, [s[3 * k : 3 * k + 3] for k in range(len(places))]))
    c, yd = ca.SX.sym("c", layout.n_c), ca.SX.sym("yd", layout.n_y)
    residual, velocity, _ = closure_expressions(varied, c, yd)
    unit = np.where(layout.angular, 1.0, characteristic_length(robot))[layout.passive]
    frame = frames(varied, c)
    twist, at = twists(varied, frame, yd)[body], frame[body]
    G = ca.jacobian(velocity, yd)
    G_p = G[:, layout.passive.tolist()] @ ca.diag(ca.DM(unit))
    J = ca.jacobian(ca.vertcat(at.R_0 @ twist.linear, at.R_0 @ twist.angular), yd)
    J_s = ca.vertcat(ca.jacobian(at.p_0, s), ca.SX(3, s.numel()))
    outputs = [residual, G_p.T, G[:, layout.actuated.tolist()].T, ca.jacobian(residual, s).T, at.p_0, at.R_0.T]
    constants = [*_constants(robot, places), *_zeros(robot)]
    shifts = np.zeros((s.numel(), len(constants)))
    for k, length in enumerate(constants):
        for place, direction in length.directions:
            shifts[3 * place : 3 * place + 3, k] += direction
    program = compile_program([c], [*outputs, J.T, J_s.T], [s])
    return VariableGeometry(layout, tuple(constants), shifts, unit, residual.numel(), program)


def models_alike(robots: Sequence[Robot], standard: Sequence[Parameter]) -> list[InverseDynamics]:
    """Make models of robots that differ only in lengths, with one shared regressor of the ``standard`` parameters.

    It is derived once, with the shifts of places as parameters of its program: to derive it for each robot takes most
    of the time in which several lengths are tried.
    """
    where = np.array([[placement.position for _, placement in _places(robot, springs=True)] for robot in robots])
    shifts = where - where[0]  # (robots, places, 3)
    varies = np.abs(shifts).max(axis=0) > 0
    s = ca.SX(ca.Sparsity.triplet(*varies.shape, *(index.tolist() for index in np.nonzero(varies))))
    symbols = ca.SX.sym("s", int(varies.sum()))
    for symbol, (place, axis) in zip(ca.vertsplit(symbols), np.argwhere(varies).tolist(), strict=True):
        s[place, axis] = symbol
    varied = InverseDynamics(_shifted(robots[0], [s[k, :].T for k in range(len(varies))]))
    general = varied.columns(standard)
    program = compile_program(general.inputs, [general.matrix.nz[:]], [symbols])
    models = [InverseDynamics(robot) for robot in robots]
    for model, shift in zip(models, shifts, strict=True):
        model.adopt(replace(general, compiled=program.at(shift[varies])))
    return models


def _places(robot: Robot, springs: bool = False) -> Iterator[tuple[str, Placement]]:
    """Iterate over all placements with their descriptions; those of ``springs`` come last."""
    for joint in robot.joints:
        yield f"'{joint.name}'", joint.placement
    for number, closure in enumerate(robot.closures, start=1):
        for end in (closure.a, closure.b):
            yield f"closure {number} on '{end.body}'", end.placement
    for spring in robot.springs if springs else ():
        for end in (spring.a, spring.b):
            yield f"'{spring.name}' on '{end.body}'", end.placement


def _shifted(robot: Robot, shifts: Sequence[ca.SX]) -> Robot:
    """Shift the placements of joints and closures, and of springs where there are shifts of these too."""
    of_place = chain(shifts, repeat(ca.SX(3, 1)))

    def shifted(placement: Placement) -> Varied:
        pose = placement if isinstance(placement, Pose) else pose_of(placement.rotation, placement.position)
        return Varied(pose.xyz, pose.rpy, constant(pose.rotation), constant(pose.position) + next(of_place))

    joints = tuple(replace(joint, placement=shifted(joint.placement)) for joint in robot.joints)
    closures, springs = moved_ends(robot, lambda end: replace(end, placement=shifted(end.placement)))
    return replace(robot, joints=joints, closures=closures, springs=springs)


def _constants(robot: Robot, places: Sequence[tuple[str, Placement]]) -> Iterator[Constant]:
    """Iterate over the lengths, each by itself, then equal ones together."""
    shortest = SHORT * characteristic_length(robot)
    same: dict[float, list[tuple[str, tuple[int, Vector]]]] = {}
    for k, (where, placement) in enumerate(places):
        for what, value, direction in _lengths(placement):
            if value > shortest:
                key = next((known for known in same if abs(known - value) < SAME * known), value)
                same.setdefault(key, []).append((f"{what} of {where}", (k, direction)))
    for value, uses in same.items():
        called = [name for name, constant in robot.file.constants if abs(abs(constant) - value) < SAME * value]
        prefix = f"{'/'.join(called)}, " if called else ""
        for where, at in uses:
            yield Constant(f"{prefix}{where}", value, "m", (at,))
        if len(uses) > 1:
            name = "/".join(called) or f"{1e3 * value:.4g} mm"
            yield Constant(f"{name} at all {len(uses)} places", value, "m", tuple(at for _, at in uses))


def _lengths(placement: Placement) -> Iterator[tuple[str, float, Vector]]:
    """Iterate over the lengths of a placement, with its directions of displacement as they grow."""
    if isinstance(placement, Mdh):
        before = replace(placement, d=0.0, b=0.0, r=0.0)
        for name in ("d", "r", "b"):
            value = getattr(placement, name)
            if value:
                yield name, abs(value), _vector(replace(before, **{name: float(np.sign(value))}).position)
        return
    position = placement.position
    if np.count_nonzero(position) > 1:
        length = float(np.linalg.norm(position))
        yield "distance", length, _vector(position / length)
    for name, value, axis in zip("xyz", position.tolist(), np.eye(3), strict=True):
        if value:
            yield name, abs(value), _vector(np.sign(value) * axis)


def _vector(values: np.ndarray) -> Vector:
    x, y, z = values.tolist()
    return x, y, z


def _zeros(robot: Robot) -> Iterator[Constant]:
    for k, name in enumerate(robot.actuated):
        unit = robot.joint(name).unit
        yield Constant(f"zero of '{name}'", 0.0, unit, joint=k)
