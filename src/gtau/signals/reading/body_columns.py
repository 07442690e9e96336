"""Columns of a log on bodies: wrenches, the motion of a floating base, and a pose that tests the geometry.

The pose of a base becomes positions of the six joints by which it moves (see :mod:`gtau.robots.geometry`); wrenches on
the base are wrenches on a body.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field, FiniteFloat, model_validator

from gtau.documents.validation import Keys
from gtau.errors import GtauError
from gtau.robots.placement import WrenchFrame, turn
from gtau.robots.robot import base_rows

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

VERTICAL = np.array([0.0, 0.0, 1.0])

Vector = tuple[str, str, str]
Point = tuple[FiniteFloat, FiniteFloat, FiniteFloat]


class Wrench(Keys):
    """Columns of an external force (N) and moment (N m; zero without columns) about the point ``at`` (m)."""

    force: Vector
    moment: Vector | None = None
    at: Point = (0.0, 0.0, 0.0)

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the force, then of the moment if there are any, (3,) or (6,)."""
        return (*self.force, *(self.moment or ()))


class BaseWrench(Wrench):
    """External wrench on a floating base, in world or base axes."""

    axes: Literal["world", "base"] = "world"


class BodyWrench(Wrench):
    """External wrench on another ``body``, in world or body axes."""

    body: str
    axes: Literal["world", "body"] = "world"

    @property
    def frame(self) -> WrenchFrame:
        """Frame in which it is expressed."""
        return WrenchFrame(self.body, self.axes == "world")

    @property
    def labels(self) -> tuple[str, ...]:
        """Column labels of the wrench components, for messages, (6,)."""
        return (*(self.moment or (", ".join(self.force),) * 3), *self.force)


def at_origins(wrenches: Sequence[BodyWrench], values: np.ndarray, yaw: float = 0.0) -> np.ndarray:
    """Convert logged columns (M, .) to moments and forces (M, 6 k) about the origins of the axes, the world turned."""
    turned, parts, start = turn(VERTICAL, yaw), [], 0
    for wrench in wrenches:
        f, m = values[:, start : start + 3], np.cross(wrench.at, values[:, start : start + 3])
        if wrench.moment:
            m = m + values[:, start + 3 : start + 6]
        start += len(wrench.columns)
        parts += [m @ turned.T, f @ turned.T] if wrench.axes == "world" else [m, f]
    return np.hstack(parts) if parts else np.zeros((len(values), 0))


def refuse_repeated(columns: Sequence[str], measured: Sequence[str] = (), where: str = "") -> None:
    """Refuse columns that occur twice among those measured, ``where`` these are; raises ValueError."""
    for column in columns:
        if (measured or columns).count(column) > 1:
            raise ValueError(f"the column '{column}'{where} is given twice; give each component its own")


STEEPEST = np.radians(80.0)  # pitch at which the angles' accelerations are 1 / cos = 6 times the base's
UNIT = 0.01  # tolerance of a quaternion's norm: logs round to 2 digits and more


class BaseColumns(Keys):
    """Columns of the pose of a floating ``body`` in a world whose z axis points up, and of the wrenches on it.

    ``position`` are x, y and z, ``quaternion`` w, x, y and z; an omitted one is constant. ``yaw`` (rad) turns the
    world.
    """

    body: str = "base"
    position: Vector | None = None
    quaternion: tuple[str, str, str, str] | None = None
    yaw: FiniteFloat = 0.0
    wrenches: tuple[BaseWrench, ...] = ()

    @model_validator(mode="after")
    def _each_column_once(self) -> BaseColumns:
        columns = (*self.pose, *(column for wrench in self.wrenches for column in wrench.columns))
        refuse_repeated(columns)
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
    def acting(self) -> tuple[BodyWrench, ...]:
        """Wrenches on the base, in the form used for any body."""
        named = ({"body": self.body, "axes": wrench.axes.replace("base", "body")} for wrench in self.wrenches)
        return tuple(BodyWrench(**dict(wrench) | names) for wrench, names in zip(self.wrenches, named, strict=True))

    @property
    def labels(self) -> tuple[str, ...]:
        """Column labels of the six joint positions, for messages."""
        places = self.position or ("no column",) * 3
        turned = "quaternion" if self.quaternion is None else ", ".join(self.quaternion)
        return (*places, *(turned,) * 3)

    def positions(self, pose: np.ndarray) -> np.ndarray:
        """Convert a pose (M, p) to positions (M, 6) of the six joints; refuse quaternions that give none."""
        p = pose[:, :3] if self.position else np.zeros((len(pose), 3))
        angles = np.zeros((len(pose), 3)) if self.quaternion is None else self._angles(pose[:, -4:])
        return np.hstack([p @ turn(VERTICAL, self.yaw).T, angles])

    def _angles(self, quaternion: np.ndarray) -> np.ndarray:
        """Convert quaternions to angles (M, 3) about x, the rotated y and the twice rotated z; NaN stays NaN."""
        from scipy.spatial.transform import Rotation

        norms = np.linalg.norm(quaternion, axis=1)
        known = np.isfinite(norms)
        if (wrong := known & (np.abs(norms - 1.0) > UNIT)).any():
            raise GtauError(
                f"the quaternion {', '.join(self.quaternion or ())} has the length {norms[wrong][0]:.3g} in "
                f"{int(wrong.sum())} rows; give the columns of w, x, y and z of an orientation, in this order."
            )
        angles = np.full((len(quaternion), 3), np.nan)
        if not known.any():
            return angles
        turned = Rotation.from_rotvec(self.yaw * VERTICAL) * Rotation.from_quat(np.roll(quaternion[known], -1, axis=1))
        pitch = np.arcsin(np.clip(turned.as_matrix()[:, 0, 2], -1.0, 1.0))
        if (steep := np.max(np.abs(pitch))) > STEEPEST:
            raise GtauError(
                f"the z axis of the base comes within {90 - np.degrees(steep):.0f} degrees of the x axis of the world, "
                "where the angles of the base are singular; turn the world about the vertical, by 'yaw: 1.57' under "
                "'base', or leave out the part of the log in which the base turns over ('from', 'to')."
            )
        angles[known] = turned.as_euler("XYZ")
        return angles


class Angles(Keys):
    """Columns of Euler angles, one for each axis of a ``sequence``, intrinsic (``YZ``) or extrinsic (``xyz``).

    With fewer than three columns the remaining angles are not logged.
    """

    sequence: str = Field(pattern="^([XYZ]{1,3}|[xyz]{1,3})$")
    columns: tuple[str, ...]

    @model_validator(mode="after")
    def _column_for_each(self) -> Angles:
        if len(self.columns) != len(self.sequence):
            raise ValueError(
                f"the sequence '{self.sequence}' has {len(self.sequence)} angles, but {len(self.columns)} columns are "
                "given; give one for each"
            )
        if any(a == b for a, b in zip(self.sequence, self.sequence[1:], strict=False)):
            raise ValueError(f"the sequence '{self.sequence}' repeats an axis; write a different axis between")
        return self

    @property
    def turning(self) -> tuple[str, tuple[str, ...]]:
        """Three intrinsic axes, and the columns of the first angles."""
        fixed = self.sequence.islower()
        sequence = self.sequence[::-1].upper() if fixed else self.sequence
        sequence += "".join(axis for axis in "ZYX" if axis not in sequence)
        return sequence[:3], self.columns[::-1] if fixed else self.columns


class PoseColumns(Keys):
    """The logged components of the pose of a ``body`` (the tool, if left out).

    ``source``: the pose of the body in the base (``controller``), of a tool with unknown mounting on the body, in the
    base (``tool``), or of a marker on the body in the frame of a tracker (``tracker``), both with unknown placement.
    """

    source: Literal["controller", "tool", "tracker"]
    body: str | None = None
    position: dict[Literal["x", "y", "z"], str] = Field(default_factory=dict)
    angles: Angles | None = None
    quaternion: dict[Literal["w", "x", "y", "z"], str] | None = None
    rotation_vector: tuple[str, str, str] | None = None

    @model_validator(mode="after")
    def _each_column_once(self) -> PoseColumns:
        if self.quaternion is not None and len(self.quaternion) < 4:
            raise ValueError("a quaternion has four columns; give w, x, y and z")
        if (self.angles, self.quaternion, self.rotation_vector).count(None) < 2:
            raise ValueError("give the orientation once, as 'angles', as a 'quaternion' or as a 'rotation_vector'")
        if not self.columns:
            raise ValueError("a pose needs columns; give a 'position', 'angles', a 'quaternion' or a 'rotation_vector'")
        refuse_repeated(self.columns)
        return self

    @property
    def axes(self) -> tuple[int, ...]:
        """Numbers of the axes along which the position is logged, in the order of its columns."""
        return tuple("xyz".index(axis) for axis in self.position)

    @property
    def columns(self) -> tuple[str, ...]:
        """All columns: of the position, then of turning angles, of w, x, y and z, or of the vector."""
        angles = self.angles.turning[1] if self.angles else ()
        quaternion = [self.quaternion[axis] for axis in ("w", "x", "y", "z")] if self.quaternion else ()
        return (*self.position.values(), *angles, *quaternion, *(self.rotation_vector or ()))

    @property
    def components(self) -> tuple[tuple[str, str], ...]:
        """Names and units of what is compared: of a whole orientation the rotation between two."""
        position = [(column, "m") for column in self.position.values()]
        if self.angles is not None:
            return (*position, *((column, "rad") for column in self.angles.turning[1]))
        whole = self.quaternion is not None or self.rotation_vector is not None
        return (*position, *((f"turn about {axis}", "rad") for axis in "xyz" if whole))

    def orientations(self, turned: np.ndarray) -> Rotation | None:
        """Convert the columns behind the position (N, .); None where these are no whole orientation."""
        from scipy.spatial.transform import Rotation

        if self.quaternion is not None:
            return Rotation.from_quat(turned, scalar_first=True)
        if self.rotation_vector is not None:
            return Rotation.from_rotvec(turned)
        if self.angles is not None and len(self.angles.columns) == 3:
            return Rotation.from_euler(self.angles.turning[0], turned)
        return None
