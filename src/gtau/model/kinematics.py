"""Express positions, twists and accelerations of all bodies symbolically, at the bodies' origins and in their axes.

``c`` is the configuration: all joint coordinates, then for every platform its position and, if it turns, a unit
quaternion (w, x, y, z). ``y`` counts the velocities ``yd``: all joint rates, then for every platform the components of
its twist named by its degrees of freedom. The two differ only where a platform turns (paper, eq. 9: T).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, repeat
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from gtau.robots.geometry import characteristic_length, moved_ends
from gtau.robots.placement import pose_of
from gtau.robots.robot import GROUND, ROTATIONS, TRANSLATIONS, Attachment, Placement, Platform, Pose, Robot

SAME_LENGTH = 1e-6  # relative difference of lengths intended to be equal


def _rotations() -> Any:
    """Import SciPy's rotations only for robots with platforms."""
    from scipy.spatial.transform import Rotation

    return Rotation


@dataclass(frozen=True)
class PlatformSlots:
    """Indices of a platform's coordinates in ``c`` and ``yd``."""

    platform: Platform
    position: slice
    quaternion: slice | None
    rates: slice

    def rotation(self, c: np.ndarray) -> np.ndarray:
        """Compute the orientation (3, 3) of the platform at a configuration (n_c,)."""
        if self.quaternion is None:
            return self.platform.home.rotation
        return np.asarray(_rotations().from_quat(c[self.quaternion], scalar_first=True).as_matrix())

    def displacement(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Compute the platform's displacement between configurations (n_c,), in its degrees of freedom, m and rad."""
        shifted = after[self.position] - before[self.position]
        turned = np.zeros(3)
        if self.quaternion is not None:
            turned = _rotations().from_matrix(self.rotation(after) @ self.rotation(before).T).as_rotvec()
        components = dict(zip(TRANSLATIONS + ROTATIONS, (*shifted, *turned), strict=True))
        return np.array([components[dof] for dof in self.platform.dof])


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Layout of ``c`` (n_c,) and ``yd`` (n_y,) of a robot, and its actuated part ``q`` (n,)."""

    robot: Robot

    @cached_property
    def platforms(self) -> tuple[PlatformSlots, ...]:
        """Places of the platforms' coordinates, behind the coordinates of the joints."""
        slots = []
        n_c = n_y = len(self.robot.joints)
        for platform in self.robot.platforms:
            turns = not set(ROTATIONS).isdisjoint(platform.dof)
            quaternion = slice(n_c + 3, n_c + 7) if turns else None
            rates = slice(n_y, n_y + len(platform.dof))
            slots.append(PlatformSlots(platform, slice(n_c, n_c + 3), quaternion, rates))
            n_c, n_y = n_c + (7 if turns else 3), rates.stop
        return tuple(slots)

    @cached_property
    def n_c(self) -> int:
        """Length of c."""
        return len(self.robot.joints) + sum(7 if slots.quaternion else 3 for slots in self.platforms)

    @property
    def n_y(self) -> int:
        """Length of yd."""
        return len(self.names)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names (n_y,) of the coordinates: a joint's, or a freedom and its platform."""
        freedoms = [f"{dof}_{platform.name}" for platform in self.robot.platforms for dof in platform.dof]
        return (*(joint.name for joint in self.robot.joints), *freedoms)

    @cached_property
    def angular(self) -> np.ndarray:
        """Mask (n_y,) of the rates in rad/s."""
        freedoms = [dof in ROTATIONS for platform in self.robot.platforms for dof in platform.dof]
        return np.array([*(joint.turns for joint in self.robot.joints), *freedoms], dtype=bool)

    @cached_property
    def actuated(self) -> np.ndarray:
        """Indices (n,) of the actuated joints in yd and c."""
        return np.flatnonzero([joint.actuated for joint in self.robot.joints])

    @cached_property
    def passive(self) -> np.ndarray:
        """Indices (n_y - n,) of the other coordinates in yd."""
        return np.setdiff1d(np.arange(self.n_y), self.actuated)

    @cached_property
    def length(self) -> float:
        """Characteristic length of the robot, m."""
        return characteristic_length(self.robot)

    @cached_property
    def unit(self) -> np.ndarray:
        """Size (n_y,) of one unit of each scaled coordinate, rad or m."""
        return np.where(self.angular, 1.0, self.length)

    @property
    def home(self) -> np.ndarray:
        """Configuration given in the robot's file, (n_c,)."""
        c = np.zeros(self.n_c)
        c[: len(self.robot.joints)] = [joint.home for joint in self.robot.joints]
        for slots in self.platforms:
            c[slots.position] = slots.platform.home.position
            if slots.quaternion is not None:
                c[slots.quaternion] = _rotations().from_matrix(slots.platform.home.rotation).as_quat(scalar_first=True)
        return c

    def retract(self, c: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Move configurations (n_c, N) by small displacements (n_y, N)."""
        moved, n_t = c.copy(), len(self.robot.joints)
        moved[:n_t] += step[:n_t]
        for slots in self.platforms:
            moves = dict(zip(slots.platform.dof, step[slots.rates], strict=True))
            zero = np.zeros(c.shape[1])
            shift, turn = (np.stack([moves.get(dof, zero) for dof in dofs]) for dofs in (TRANSLATIONS, ROTATIONS))
            moved[slots.position] += shift
            if slots.quaternion is not None:
                before = _rotations().from_quat(c[slots.quaternion].T, scalar_first=True)
                moved[slots.quaternion] = (_rotations().from_rotvec(turn.T) * before).as_quat(scalar_first=True).T
        return moved


Vector = ca.SX  # (3, 1)


class Frame(NamedTuple):
    """A frame's pose in its antecedent (``R``, ``p``) and in the base (``R_0``, ``p_0``)."""

    R: ca.SX
    p: Vector
    R_0: ca.SX
    p_0: Vector


class Twist(NamedTuple):
    """Angular and linear velocity, or acceleration."""

    angular: Vector
    linear: Vector

    @property
    def moves(self) -> bool:
        """Return whether it is structurally non-zero."""
        return bool(self.angular.nnz() or self.linear.nnz())


def constant(matrix: np.ndarray) -> ca.SX:
    """Return a constant matrix whose entries that are zero up to rounding are structural zeros."""
    return ca.SX(ca.sparsify(ca.DM(matrix), 1e-15))


@dataclass(frozen=True)
class Varied(Pose):
    """A placement with a symbolic orientation ``R`` and position ``p`` near its pose, to vary a robot's geometry."""

    R: ca.SX = field(default_factory=lambda: ca.SX.eye(3))
    p: Vector = field(default_factory=lambda: ca.SX(3, 1))


def placements(robot: Robot) -> list[Placement]:
    """List the placements of joints, and of the ends of closures and springs."""
    return [*(joint.placement for joint in robot.joints), *(end.placement for end in robot.ends)]


def shifted(robot: Robot, shifts: Sequence[ca.SX]) -> Robot:
    """Shift the :func:`placements` by symbolic vectors (3,), those beyond the last one not at all."""
    shift = chain(shifts, repeat(ca.SX(3, 1)))

    def varied(placement: Placement) -> Varied:
        pose = placement if isinstance(placement, Pose) else pose_of(placement.rotation, placement.position)
        return Varied(pose.xyz, pose.rpy, constant(pose.rotation), constant(pose.position) + next(shift))

    joints = tuple(replace(joint, placement=varied(joint.placement)) for joint in robot.joints)
    closures, springs = moved_ends(robot, lambda end: replace(end, placement=varied(end.placement)))
    return replace(robot, joints=joints, closures=closures, springs=springs)


def placed(placement: Placement) -> tuple[ca.SX, Vector]:
    """Express orientation and origin of a placed frame."""
    if isinstance(placement, Varied):
        return placement.R, placement.p
    return constant(placement.rotation), constant(placement.position)


def turned(axis: np.ndarray, angle: ca.SX) -> ca.SX:
    """Express the rotation by ``angle`` about the unit vector ``axis`` (Rodrigues)."""
    outer = constant(np.outer(axis, axis))
    return outer + ca.cos(angle) * (constant(np.eye(3)) - outer) + ca.sin(angle) * ca.skew(constant(axis))


def _rotation_of(quaternion: ca.SX) -> ca.SX:
    w, x, y, z = ca.vertsplit(quaternion)
    return ca.vertcat(
        ca.horzcat(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        ca.horzcat(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        ca.horzcat(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def frames(layout: Coordinates, c: ca.SX) -> dict[str, Frame]:
    """Express the pose of every body at configuration ``c`` (n_c,)."""
    origin, axes = constant(np.zeros(3)), constant(np.eye(3))
    poses = {GROUND: Frame(axes, origin, axes, origin)}
    for k, joint in enumerate(layout.robot.joints):
        before, axis = poses[joint.antecedent], np.array(joint.axis)
        R, p = placed(joint.placement)
        if joint.turns:
            R = R @ turned(axis, c[k])
        else:
            p = p + R @ constant(axis) * c[k]
        poses[joint.name] = Frame(R, p, before.R_0 @ R, before.p_0 + before.R_0 @ p)
    for slots in layout.platforms:
        p = c[slots.position]
        R = constant(slots.platform.home.rotation) if slots.quaternion is None else _rotation_of(c[slots.quaternion])
        poses[slots.platform.name] = Frame(R, p, R, p)
    return poses


def poses(layout: Coordinates, c: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Compute orientation (3, 3) and origin (3,), m, of every body in the base at a configuration (n_c,)."""
    symbolic = frames(layout, ca.SX(c))
    return {name: (ca.evalf(at.R_0).full(), ca.evalf(at.p_0).full().ravel()) for name, at in symbolic.items()}


def _velocities(slots: PlatformSlots, rates: ca.SX) -> tuple[Vector, Vector]:
    """Split the ``rates`` (n_y,) of a platform into linear and angular velocity in base axes, ``D v`` of eq. (10)."""
    v = dict(zip(slots.platform.dof, ca.vertsplit(rates[slots.rates]), strict=True))
    linear, angular = (ca.vertcat(*(v.get(dof, ca.SX(1, 1)) for dof in dofs)) for dofs in (TRANSLATIONS, ROTATIONS))
    return linear, angular


def configuration_rates(layout: Coordinates, c: ca.SX, yd: ca.SX) -> ca.SX:
    """Express the time derivative of the configuration c (n_c,) for velocities ``yd`` (n_y,), T of eq. (9)."""
    rates = [yd[: len(layout.robot.joints)]]
    for slots in layout.platforms:
        linear, omega = _velocities(slots, yd)
        rates.append(linear)
        if slots.quaternion is not None:
            w, vector = c[slots.quaternion][0], c[slots.quaternion][1:]
            rates.append(ca.vertcat(-ca.dot(omega, vector), w * omega + ca.cross(omega, vector)) / 2)
    return ca.vertcat(*rates)


def platform_twist(layout: Coordinates, rates: ca.SX, frame: dict[str, Frame]) -> dict[str, Twist]:
    """Express the twists ``t = D v`` of the platforms, eq. (10), in their own axes."""
    twists = {}
    for slots in layout.platforms:
        linear, angular = _velocities(slots, rates)
        R_t = frame[slots.platform.name].R_0.T
        twists[slots.platform.name] = Twist(R_t @ angular, R_t @ linear)
    return twists


def twists(layout: Coordinates, frame: dict[str, Frame], rates: ca.SX) -> dict[str, Twist]:
    """Express the twist of every body for velocities (n_y,), or the partial twists for a column of ``J``."""
    zero = ca.SX(3, 1)
    twists = {GROUND: Twist(zero, zero)}
    for k, joint in enumerate(layout.robot.joints):
        before, at = twists[joint.antecedent], frame[joint.name]
        if not before.moves and not rates[k].nnz():
            twists[joint.name] = before
            continue
        axis = constant(np.array(joint.axis))
        angular = at.R.T @ before.angular
        linear = at.R.T @ (before.linear + ca.cross(before.angular, at.p))
        if joint.turns:
            angular = angular + axis * rates[k]
        else:
            linear = linear + axis * rates[k]
        twists[joint.name] = Twist(angular, linear)
    return twists | platform_twist(layout, rates, frame)


def attached_frame(end: Attachment, frame: dict[str, Frame]) -> tuple[ca.SX, Vector]:
    """Express orientation and position of an attached frame in the base."""
    body = frame[end.body]
    rotation, arm = placed(end.placement)
    return body.R_0 @ rotation, body.p_0 + body.R_0 @ arm


def attached_velocity(end: Attachment, frame: dict[str, Frame], twist: dict[str, Twist]) -> Twist:
    """Express the twist of an attached frame, at its origin, in base axes."""
    body, (_, arm) = twist[end.body], placed(end.placement)
    R_0 = frame[end.body].R_0
    return Twist(R_0 @ body.angular, R_0 @ (body.linear + ca.cross(body.angular, arm)))


def accelerations(
    layout: Coordinates, frame: dict[str, Frame], twist: dict[str, Twist], yd: ca.SX, ydd: ca.SX, gravity: Vector
) -> dict[str, Twist]:
    """Express the acceleration of every body less gravity, which acts as an acceleration of the base."""
    accelerations = {GROUND: Twist(ca.SX(3, 1), -gravity)}
    for k, joint in enumerate(layout.robot.joints):
        before = accelerations[joint.antecedent]
        at = frame[joint.name]
        axis = constant(np.array(joint.axis))
        omega = twist[joint.antecedent].angular
        angular = at.R.T @ before.angular
        linear = before.linear + ca.cross(before.angular, at.p) + ca.cross(omega, ca.cross(omega, at.p))
        linear = at.R.T @ linear
        turning = ca.cross(twist[joint.name].angular, axis) * yd[k]
        if joint.turns:
            angular = angular + axis * ydd[k] + turning
        else:
            linear = linear + axis * ydd[k] + 2 * turning
        accelerations[joint.name] = Twist(angular, linear)
    for name, motion in platform_twist(layout, ydd, frame).items():
        accelerations[name] = Twist(motion.angular, motion.linear - frame[name].R_0.T @ gravity)
    return accelerations
