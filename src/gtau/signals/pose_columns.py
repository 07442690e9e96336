"""Columns of a log that hold the pose of a body, and what they mean."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field, field_validator, model_validator

from gtau.documents.validation import Keys
from gtau.signals.units import is_angle, si_factor

AXES = "xyz"


class Angles(Keys):
    """Columns of angles about the axes of a ``sequence``, one for each.

    Capitals turn about axes that turn with the body (``YZ`` is Ry(first) Rz(second)), small letters about fixed ones
    (``xyz`` is roll, pitch and yaw). Of fewer than three the further ones are not logged.
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
            raise ValueError(f"the sequence '{self.sequence}' turns twice about one axis; write another axis between")
        return self

    @property
    def turning(self) -> tuple[str, tuple[str, ...]]:
        """Three axes that turn with the body, and the columns of the first of them."""
        fixed = self.sequence.islower()
        sequence = self.sequence[::-1].upper() if fixed else self.sequence
        for axis in "ZYX":
            if len(sequence) < 3 and axis not in sequence:
                sequence += axis
        return sequence, self.columns[::-1] if fixed else self.columns


class PoseColumns(Keys):
    """The pose of a ``body`` (the tool, if left out), as far as it is logged.

    ``source`` says whose pose it is: of the body in the base (``controller``), of a tool whose place on the body is
    not known in the base (``tool``), or of a marker on the body in the frame of a tracker (``tracker``), which both
    stand where nobody measured.
    """

    source: Literal["controller", "tool", "tracker"]
    body: str | None = None
    position: dict[Literal["x", "y", "z"], str] = Field(default_factory=dict)
    angles: Angles | None = None
    quaternion: dict[Literal["w", "x", "y", "z"], str] | None = None
    rotation_vector: tuple[str, str, str] | None = None

    @field_validator("quaternion")
    @classmethod
    def _whole(cls, quaternion: dict[str, str] | None) -> dict[str, str] | None:
        if quaternion is not None and len(quaternion) < 4:
            raise ValueError("a quaternion has four columns; give w, x, y and z")
        return quaternion

    @model_validator(mode="after")
    def _something(self) -> PoseColumns:
        if sum(each is not None for each in (self.angles, self.quaternion, self.rotation_vector)) > 1:
            raise ValueError("give the orientation once, as 'angles', as a 'quaternion' or as a 'rotation_vector'")
        if not self.columns:
            raise ValueError("a pose needs columns; give a 'position', 'angles', a 'quaternion' or a 'rotation_vector'")
        repeated = [column for column in self.columns if self.columns.count(column) > 1]
        if repeated:
            raise ValueError(f"the column '{repeated[0]}' is given twice; give each component its own")
        return self

    @property
    def axes(self) -> tuple[int, ...]:
        """Numbers of the axes along which the position is logged, in the order of its columns."""
        return tuple(AXES.index(axis) for axis in self.position)

    @property
    def columns(self) -> tuple[str, ...]:
        """All columns: the position's, then those of turning angles, of w, x, y and z, or of the vector."""
        angles = () if self.angles is None else self.angles.turning[1]
        turned = () if self.quaternion is None else tuple(self.quaternion[axis] for axis in ("w", "x", "y", "z"))
        return (*self.position.values(), *angles, *turned, *(self.rotation_vector or ()))


def _unit(angle: bool) -> AfterValidator:
    def checked(text: str) -> str:
        si_factor(text, "position")
        if is_angle(text) != angle:
            raise ValueError(f"'{text}' is no unit of {'an angle' if angle else 'a length'}; write "
                             f"{'rad or deg' if angle else 'm or mm'}")  # fmt: skip
        return text

    return AfterValidator(checked)


class PoseUnits(Keys):
    """Units of the lengths and the angles of a pose."""

    length: Annotated[str, _unit(False)] = "m"
    angle: Annotated[str, _unit(True)] = "rad"

    def scale(self, pose: PoseColumns) -> list[float]:
        """Return the factors to SI units of the pose's columns."""
        angles = 3 if pose.rotation_vector else 0 if pose.angles is None else len(pose.angles.columns)
        length, angle = si_factor(self.length, "position"), si_factor(self.angle, "position")
        return [length] * len(pose.position) + [angle] * angles + [1.0] * (4 if pose.quaternion else 0)
