"""Columns of a log that say how a floating base moved, and what acted on it from outside.

A pose and wrenches become positions and forces of the six joints by which the base moves (see
:mod:`gtau.robots.floating`), row by row, so that all that follows treats them as any joint's.
"""

from __future__ import annotations

import numpy as np
from pydantic import FiniteFloat, model_validator

from gtau.documents.validation import Keys
from gtau.errors import GtauError
from gtau.robots.geometry import turn
from gtau.robots.robot import base_rows
from gtau.signals.units import is_angle, si_factor
from gtau.signals.wrench_columns import VERTICAL, BaseWrench, Vector

STEEPEST = np.radians(80.0)  # pitch at which the angles' accelerations are 1 / cos = 6 times those of the base
UNIT = 0.01  # by which the length of a quaternion may differ from 1: logs round to 2 digits and more


class BaseUnits(Keys):
    """Unit of the position of a base."""

    length: str = "m"

    @model_validator(mode="after")
    def _of_length(self) -> BaseUnits:
        si_factor(self.length, "position")
        if is_angle(self.length):
            raise ValueError(f"'{self.length}' is not a unit of length; write m or mm")
        return self


class BaseColumns(Keys):
    """Columns of the pose of a floating ``body`` in a world whose z axis points up, and of the wrenches on it.

    ``position`` are x, y and z, ``quaternion`` w, x, y and z of its orientation; left out, it does not move so.
    ``yaw`` (rad) turns the world about the vertical.
    """

    body: str = "base"
    position: Vector | None = None
    quaternion: tuple[str, str, str, str] | None = None
    yaw: FiniteFloat = 0.0
    wrenches: tuple[BaseWrench, ...] = ()

    @model_validator(mode="after")
    def _each_column_once(self) -> BaseColumns:
        columns = (*self.pose, *self.forces)
        for column in columns:
            if columns.count(column) > 1:
                raise ValueError(f"the column '{column}' is given twice; give each component its own")
        if not columns:
            raise ValueError("it names no columns; give 'position' and 'quaternion', 'wrenches', or both")
        return self

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the six joints."""
        return base_rows(self.body)

    @property
    def pose(self) -> tuple[str, ...]:
        """Columns of the pose, (p,)."""
        return (*(self.position or ()), *(self.quaternion or ()))

    @property
    def forces(self) -> tuple[str, ...]:
        """Columns of the wrenches, (w,)."""
        return tuple(column for each in self.wrenches for column in each.columns)

    def scale(self, units: BaseUnits) -> list[float]:
        """Return the factors to SI units of the pose's columns."""
        lengths = [si_factor(units.length, "position")] * len(self.position or ())
        return lengths + [1.0] * (len(self.pose) - len(lengths))

    @property
    def labels(self) -> tuple[str, ...]:
        """Columns behind the positions of the six joints, then those behind their forces, for messages (12,)."""
        places = self.position or ("no column",) * 3
        turned = "quaternion" if self.quaternion is None else ", ".join(self.quaternion)
        acting = ", ".join(self.forces) or "no wrench"
        return (*places, *(turned,) * 3, *(acting,) * 6)

    def converted(self, pose: np.ndarray, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Convert a pose (M, p) and wrenches (M, w) to positions and forces (M, 6) of the six joints.

        Raises
        ------
        GtauError
            Where a quaternion's length is not 1, or the pitch is close to 90 degrees, where the angles of the base are
            singular.
        """
        p = pose[:, :3] if self.position else np.zeros((len(pose), 3))
        angles = np.zeros((len(pose), 3)) if self.quaternion is None else self._angles(pose[:, -4:])
        yaw = turn(VERTICAL, self.yaw)
        p = p @ yaw.T
        R = _rotations(angles)
        force, moment = np.zeros((2, len(pose), 3))
        start = 0
        for each in self.wrenches:
            values, start = forces[:, start : start + len(each.columns)], start + len(each.columns)
            turned = np.broadcast_to(yaw, R.shape) if each.axes == "world" else R
            f = np.einsum("mij,mj->mi", turned, values[:, :3])
            arm = np.einsum("mij,j->mi", turned, each.at) - (p if each.axes == "world" else 0.0)
            force += f
            moment += np.cross(arm, f)
            if each.moment:
                moment += np.einsum("mij,mj->mi", turned, values[:, 3:])
        # axes of the turns in the world: x, the turned y, and z of the base
        a, zero = angles[:, 0], np.zeros(len(angles))
        second = np.stack([zero, np.cos(a), np.sin(a)], axis=1)
        turns = [moment[:, 0], np.sum(second * moment, axis=1), np.sum(R[:, :, 2] * moment, axis=1)]
        return np.hstack([p, angles]), np.hstack([force, np.stack(turns, axis=1)])

    def _angles(self, quaternion: np.ndarray) -> np.ndarray:
        """Convert quaternions to angles (M, 3) about x, the rotated y and the twice rotated z; NaN stays NaN."""
        norms = np.linalg.norm(quaternion, axis=1)
        known = np.isfinite(norms)
        if (wrong := known & (np.abs(norms - 1.0) > UNIT)).any():
            raise GtauError(
                f"the quaternion {', '.join(self.quaternion or ())} has the length {norms[wrong][0]:.3g} in "
                f"{int(wrong.sum())} rows; give the columns of w, x, y and z of an orientation, in this order."
            )
        w, x, y, z = (quaternion / np.where(known, norms, 1.0)[:, None]).T
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        columns = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        R = np.einsum("ij,jkm->ikm", [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]], columns)
        pitch = np.arcsin(np.clip(R[0, 2], -1.0, 1.0))
        if known.any() and (steep := np.nanmax(np.abs(pitch))) > STEEPEST:
            raise GtauError(
                f"the z axis of the base comes within {90 - np.degrees(steep):.0f} degrees of the x axis of the world, "
                "where the angles of the base are singular; turn the world about the vertical, by 'yaw: 1.57' under "
                "'base', or leave out the part of the log in which the base turns over ('from', 'to')."
            )
        return np.stack([np.arctan2(-R[1, 2], R[2, 2]), pitch, np.arctan2(-R[0, 1], R[0, 0])], axis=1)


def _rotations(angles: np.ndarray) -> np.ndarray:
    """Compute the orientations (M, 3, 3) of a base rotated by the angles (M, 3) of its joints."""
    (ca, cb, cc), (sa, sb, sc) = np.cos(angles).T, np.sin(angles).T
    rows = [
        [cb * cc, -cb * sc, sb],
        [ca * sc + sa * sb * cc, ca * cc - sa * sb * sc, -sa * cb],
        [sa * sc - ca * sb * cc, sa * cc + ca * sb * sc, ca * cb],
    ]
    return np.moveaxis(np.array(rows), 2, 0)
