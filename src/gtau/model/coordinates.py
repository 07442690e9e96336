"""Coordinates of the virtual tree: the numbers that give the pose of every body, and its rates.

``c`` is the configuration: all joint coordinates, then for every platform its position and, if it
turns, a unit quaternion (w, x, y, z), which has no singular angles. ``y`` counts the velocities
``yd``: all joint rates, then for every platform the components of its twist named by its degrees of
freedom. The two differ only where a platform turns (paper, eq. 9: T).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gtau.robots.robot import ROTATIONS, TRANSLATIONS, Platform, Robot


@dataclass(frozen=True)
class PlatformSlots:
    """Where a platform's numbers stand in ``c`` and ``yd``."""

    platform: Platform
    position: slice
    quaternion: slice | None
    rates: slice

    def rotation(self, c: np.ndarray) -> np.ndarray:
        """Compute the orientation (3, 3) of the platform at a configuration (n_c,)."""
        from scipy.spatial.transform import Rotation

        if self.quaternion is None:
            return self.platform.home.rotation
        return np.asarray(Rotation.from_quat(c[self.quaternion], scalar_first=True).as_matrix())

    def displacement(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Compute the platform's displacement between configurations (n_c,), in its degrees of freedom, m and rad."""
        from scipy.spatial.transform import Rotation

        turned = Rotation.from_matrix(self.rotation(after) @ self.rotation(before).T).as_rotvec()
        shifted = after[self.position] - before[self.position]
        whole = dict(zip(TRANSLATIONS + ROTATIONS, (*shifted, *turned), strict=True))
        return np.array([whole[dof] for dof in self.platform.dof])


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
        """The configuration that the robot's file gives, (n_c,)."""
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
    angular = [joint.kind == "revolute" for joint in robot.joints]
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
