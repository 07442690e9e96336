"""Express positions, twists and accelerations of all bodies symbolically.

Twists and accelerations are those of a body's frame origin in the body's own axes, the form in which
its inertial parameters are constant.

``c`` is the configuration: all joint coordinates, then for every platform its position and, if it
turns, a unit quaternion (w, x, y, z), which has no singular angles. ``y`` counts the velocities
``yd``: all joint rates, then for every platform the components of its twist named by its degrees of
freedom. The two differ only where a platform turns (paper, eq. 9: T).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from gtau.robots.robot import GROUND, ROTATIONS, TRANSLATIONS, Attachment, Joint, Placement, Platform, Pose, Robot


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
        from scipy.spatial.transform import Rotation

        return np.asarray(Rotation.from_quat(c[self.quaternion], scalar_first=True).as_matrix())

    def displacement(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Compute the platform's displacement between configurations (n_c,), in its degrees of freedom, m and rad."""
        shifted, turned = after[self.position] - before[self.position], np.zeros(3)
        if self.quaternion is not None:
            from scipy.spatial.transform import Rotation

            turned = Rotation.from_matrix(self.rotation(after) @ self.rotation(before).T).as_rotvec()
        components = dict(zip(TRANSLATIONS + ROTATIONS, (*shifted, *turned), strict=True))
        return np.array([components[dof] for dof in self.platform.dof])


@dataclass(frozen=True)
class Coordinates:
    """Layout of ``c`` (n_c,) and ``yd`` (n_y,) of a robot, and its actuated part ``q`` (n,)."""

    robot: Robot
    platforms: tuple[PlatformSlots, ...]
    n_c: int
    n_y: int
    actuated: np.ndarray  # (n,) indices into yd and c
    passive: np.ndarray  # (n_y - n,) indices into yd
    names: tuple[str, ...]  # (n_y,)
    angular: np.ndarray  # (n_y,) True where a rate is in rad/s

    @property
    def home(self) -> np.ndarray:
        """Configuration given in the robot's file, (n_c,)."""
        c = np.zeros(self.n_c)
        c[: len(self.robot.joints)] = [joint.home for joint in self.robot.joints]
        for slots in self.platforms:
            c[slots.position] = slots.platform.home.position
            if slots.quaternion is not None:
                from scipy.spatial.transform import Rotation

                c[slots.quaternion] = Rotation.from_matrix(slots.platform.home.rotation).as_quat(scalar_first=True)
        return c

    def retract(self, c: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Move configurations (n_c, N) by small displacements (n_y, N)."""
        moved = c.copy()
        n_t = len(self.robot.joints)
        moved[:n_t] += step[:n_t]
        for slots in self.platforms:
            displacement = dict(zip(slots.platform.dof, step[slots.rates], strict=True))
            for k, dof in enumerate(TRANSLATIONS):
                if dof in displacement:
                    moved[slots.position.start + k] += displacement[dof]
            if slots.quaternion is not None:
                from scipy.spatial.transform import Rotation

                zero = np.zeros(c.shape[1])
                turn = Rotation.from_rotvec(np.stack([displacement.get(dof, zero) for dof in ROTATIONS], axis=1))
                before = Rotation.from_quat(c[slots.quaternion].T, scalar_first=True)
                moved[slots.quaternion] = (turn * before).as_quat(scalar_first=True).T
        return moved


def coordinates(robot: Robot) -> Coordinates:
    """Lay out the coordinates of ``robot``."""
    n_c = n_y = len(robot.joints)
    names = [joint.name for joint in robot.joints]
    angular = [joint.turns for joint in robot.joints]
    platforms = []
    for platform in robot.platforms:
        turns = any(dof in ROTATIONS for dof in platform.dof)
        position = slice(n_c, n_c + 3)
        quaternion = slice(n_c + 3, n_c + 7) if turns else None
        rates = slice(n_y, n_y + len(platform.dof))
        n_c += 7 if turns else 3
        n_y += len(platform.dof)
        names += [f"{dof}_{platform.name}" for dof in platform.dof]
        angular += [dof in ROTATIONS for dof in platform.dof]
        platforms.append(PlatformSlots(platform, position, quaternion, rates))
    actuated = np.array([k for k, joint in enumerate(robot.joints) if joint.actuated], dtype=int)
    passive = np.setdiff1d(np.arange(n_y), actuated)
    return Coordinates(
        robot, tuple(platforms), n_c, n_y, actuated, passive, tuple(names), np.array(angular, dtype=bool)
    )  # fmt: skip


Vector = ca.SX  # (3, 1)


@dataclass(frozen=True)
class Frame:
    """A frame's pose in its antecedent (``R``, ``p``) and in the base (``R_0``, ``p_0``)."""

    R: ca.SX
    p: Vector
    R_0: ca.SX
    p_0: Vector


@dataclass(frozen=True)
class Twist:
    """Angular and linear velocity, or acceleration."""

    angular: Vector
    linear: Vector

    @property
    def moves(self) -> bool:
        """Return whether it is structurally non-zero."""
        return bool(self.angular.nnz() or self.linear.nnz())


def constant(matrix: np.ndarray) -> ca.SX:
    """Return a constant matrix whose entries that are zero up to rounding are structural zeros."""
    return ca.sparsify(ca.SX(ca.DM(np.where(np.abs(matrix) < 1e-15, 0.0, matrix))))


@dataclass(frozen=True)
class Varied(Pose):
    """A placement with a symbolic orientation ``R`` and position ``p`` near its pose, to vary a robot's geometry."""

    R: ca.SX = field(default_factory=lambda: ca.SX.eye(3))
    p: Vector = field(default_factory=lambda: ca.SX(3, 1))


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


def _moved(joint: Joint, q: ca.SX) -> tuple[ca.SX, Vector]:
    rotation, position = placed(joint.placement)
    axis = np.array(joint.axis)
    if joint.kind == "prismatic":
        return rotation, position + rotation @ constant(axis) * q
    return rotation @ turned(axis, q), position


def frames(layout: Coordinates, c: ca.SX) -> dict[str, Frame]:
    """Express the pose of every body at configuration ``c`` (n_c,)."""
    origin, axes = constant(np.zeros(3)), constant(np.eye(3))
    poses = {GROUND: Frame(axes, origin, axes, origin)}
    for k, joint in enumerate(layout.robot.joints):
        before = poses[joint.antecedent]
        R, p = _moved(joint, c[k])
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


def configuration_rates(layout: Coordinates, c: ca.SX, yd: ca.SX) -> ca.SX:
    """Express the time derivative of the configuration c (n_c,) for velocities ``yd`` (n_y,), T of eq. (9)."""
    n_t = len(layout.robot.joints)
    rates = [yd[:n_t]]
    for slots in layout.platforms:
        v = dict(zip(slots.platform.dof, ca.vertsplit(yd[slots.rates]), strict=True))
        rates.append(ca.vertcat(*(v.get(dof, ca.SX(1, 1)) for dof in TRANSLATIONS)))
        if slots.quaternion is not None:
            omega = ca.vertcat(*(v.get(dof, ca.SX(1, 1)) for dof in ROTATIONS))
            w, vector = c[slots.quaternion][0], c[slots.quaternion][1:]
            rates.append(ca.vertcat(-ca.dot(omega, vector), w * omega + ca.cross(omega, vector)) / 2)
    return ca.vertcat(*rates)


def platform_twist(layout: Coordinates, rates: ca.SX, frame: dict[str, Frame]) -> dict[str, Twist]:
    """Express the twists ``t = D v`` of the platforms, eq. (10), in their own axes."""
    twists = {}
    for slots in layout.platforms:
        v = dict(zip(slots.platform.dof, ca.vertsplit(rates[slots.rates]), strict=True))
        R_t = frame[slots.platform.name].R_0.T
        linear = ca.vertcat(*(v.get(dof, ca.SX(1, 1)) for dof in TRANSLATIONS))
        angular = ca.vertcat(*(v.get(dof, ca.SX(1, 1)) for dof in ROTATIONS))
        twists[slots.platform.name] = Twist(R_t @ angular, R_t @ linear)
    return twists


def twists(layout: Coordinates, frame: dict[str, Frame], rates: ca.SX) -> dict[str, Twist]:
    """Express the twist of every body for the velocities ``rates`` (n_y,).

    With a column of ``J`` for ``rates`` these are the partial twists of Jourdain's principle.
    """
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
    layout: Coordinates,
    frame: dict[str, Frame],
    twist: dict[str, Twist],
    yd: ca.SX,
    ydd: ca.SX,
    gravity: Vector,
) -> dict[str, Twist]:
    """Express the acceleration of every body less gravity, which acts as an acceleration of the base."""
    accelerations = {GROUND: Twist(ca.SX(3, 1), -gravity)}
    for k, joint in enumerate(layout.robot.joints):
        before, at, axis = accelerations[joint.antecedent], frame[joint.name], constant(np.array(joint.axis))
        omega = twist[joint.antecedent].angular
        angular = at.R.T @ before.angular
        linear = at.R.T @ (
            before.linear + ca.cross(before.angular, at.p) + ca.cross(omega, ca.cross(omega, at.p))
        )  # fmt: skip
        turning = ca.cross(twist[joint.name].angular, axis) * yd[k]
        if joint.turns:
            angular = angular + axis * ydd[k] + turning
        else:
            linear = linear + axis * ydd[k] + 2 * turning
        accelerations[joint.name] = Twist(angular, linear)
    for name, motion in platform_twist(layout, ydd, frame).items():
        accelerations[name] = Twist(motion.angular, motion.linear - frame[name].R_0.T @ gravity)
    return accelerations
