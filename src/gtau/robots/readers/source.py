"""What users write of a robot: the keys of robot files, and of ``robot`` in other files, its source.

A source names the file, the pose of the base and the selected joints; ``docs/lookup/robot-file.md`` explains files.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, FiniteFloat, Tag, field_validator, model_validator

from gtau.documents.expressions import AffineInQ, evaluate, linear
from gtau.documents.validation import Keys, Positive, text_or_group
from gtau.robots.placement import DEGREES_ADVICE, Mdh, Placement, Pose, in_degrees
from gtau.robots.robot import (
    INERTIAL,
    SPRING_WORDS,
    STANDARD_GRAVITY,
    Attachment,
    Closure,
    Joint,
    JointKind,
    Limits,
    Spring,
)

FLOATING: Literal["floating"] = "floating"
BASE_ADVICE = (
    "write 'robot: {file: ..., base: fixed}' in the experiment file ('gtau init' and 'gtau robot' have --base fixed) "
    "if the robot was hung up or bolted down, or 'base: floating' if its base moved and the motion is logged"
)


def _base(value: Any) -> Any:
    if value == "fixed":
        return {}
    if isinstance(value, str) and value != FLOATING:
        raise ValueError(
            f"write 'fixed', how the base is turned, '{{rpy: [roll, pitch, yaw]}}' in rad, or 'floating', not '{value}'"
        )
    return value


def angle(value: Any, constants: Mapping[str, float] | None = None) -> Any:
    """Evaluate an angle, rad, written as a number or an expression; refuse what looks like degrees."""
    number = evaluate(value, constants) if isinstance(value, str) else value
    if isinstance(number, int | float) and isfinite(number) and in_degrees(number):
        raise ValueError(f"{value} rad is more than a turn; {DEGREES_ADVICE}, such as deg({value})")
    return number


Angle = Annotated[FiniteFloat, BeforeValidator(lambda value: angle(value))]


class Base(Keys):
    """A fixed base, at its pose in the file or turned by ``rpy`` in a world whose z axis points up."""

    rpy: tuple[Angle, Angle, Angle] | None = None


BaseChoice = Base | Literal["floating"] | None


class GivenLimits(Keys):
    """Limits of a joint, in SI units, which replace limits of the robot's file."""

    position: tuple[Angle, Angle] | None = None
    velocity: Positive | None = None
    acceleration: Positive | None = None
    effort: Positive | None = None

    @field_validator("position")
    @classmethod
    def _in_order(cls, position: tuple[float, float] | None) -> tuple[float, float] | None:
        if position is not None and position[0] >= position[1]:
            raise ValueError(
                f"the limits {position[0]:g} and {position[1]:g} are not in order; write the lower one first"
            )
        return position


GRAVITIES = {"none": ("0", "0", "0"), "moon": ("0", "0", "-1.62")}


def gravity_of(value: Any) -> Any:
    """Replace a word for gravity by the numbers, as text; raises ValueError."""
    value = GRAVITIES.get(value, value) if isinstance(value, str) else value
    if isinstance(value, str):
        raise ValueError(f"write three numbers, m/s2 in base axes, such as [0, 0, -9.81], moon or none, not '{value}'")
    return value


class RobotSource(Keys):
    """A robot's file or catalog name, with the selected joints and the pose of its base.

    ``base`` fixes a floating base, states how a fixed one is mounted, or lets it float. ``joints`` are patterns of the
    moving joints; the others are held, at the positions in ``held`` or at home. ``limits``, by joint, and ``gravity``,
    m/s2, replace values of the file; gravity is zero if the driver removes it from the logged torques. ``xacro`` are
    arguments of a xacro file, and ``packages`` folders that hold the packages that it names.
    """

    file: str
    base: Annotated[BaseChoice, BeforeValidator(_base)] = None
    joints: tuple[str, ...] = ()
    held: dict[str, FiniteFloat] = Field(default_factory=dict)
    limits: dict[str, GivenLimits] = Field(default_factory=dict)
    gravity: Annotated[tuple[FiniteFloat, FiniteFloat, FiniteFloat] | None, BeforeValidator(gravity_of)] = None
    xacro: dict[str, bool | int | float | str] = Field(default_factory=dict)
    packages: tuple[str, ...] = ()


AnySource = Annotated[Annotated[str, Tag("text")] | Annotated[RobotSource, Tag("group")], Discriminator(text_or_group)]
"""Value of the key 'robot': a file or catalog name, or the group of a ``RobotSource``."""


def _coordinate(text: str, info: Any) -> AffineInQ:
    factor, constant = linear(text, info.context)
    if info.field_name == "theta" and in_degrees(constant):
        raise ValueError(f"{text} adds more than a turn, in rad; {DEGREES_ADVICE}, such as deg({constant:g})")
    return factor, constant


Number = Annotated[float, BeforeValidator(lambda text, info: evaluate(text, info.context))]
WrittenAngle = Annotated[float, BeforeValidator(lambda text, info: angle(text, info.context))]
Coordinate = Annotated[AffineInQ, BeforeValidator(_coordinate)]
"""A number that may hold the joint coordinate ``q``."""
Triple = tuple[Number, Number, Number]
MDH_KEYS = ("gamma", "b", "alpha", "d", "theta", "r")
POSE_KEYS = ("xyz", "rpy")
INERTIAL_KEYS = {"mass", "masses", "inertia", "inertial", "com", "cog", *INERTIAL}


class _Entry(Keys):
    def written(self, *keys: str) -> bool:
        return not self.model_fields_set.isdisjoint(keys)


class _BodyEntry(_Entry):
    @model_validator(mode="before")
    @classmethod
    def _no_masses(cls, written: Any) -> Any:
        for key in INERTIAL_KEYS.intersection(written if isinstance(written, dict) else ()):
            raise ValueError(
                f"masses and inertias are identified, so leave '{key}' out; values known beforehand, as from CAD, go "
                "under 'priors' in the experiment file"
            )
        return written


class _PoseEntry(_Entry):
    xyz: Triple = (0.0, 0.0, 0.0)
    rpy: tuple[WrittenAngle, WrittenAngle, WrittenAngle] = (0.0, 0.0, 0.0)


class _PlacedEntry(_PoseEntry):
    gamma: WrittenAngle = 0.0
    b: Number = 0.0
    alpha: WrittenAngle = 0.0
    d: Number = 0.0

    @model_validator(mode="after")
    def _one_way_of_placing(self) -> _PlacedEntry:
        if self.written(*MDH_KEYS) and self.written(*POSE_KEYS):
            raise ValueError("place it either by gamma, b, alpha, d, theta, r or by xyz and rpy, not by both")
        return self

    def placement(self, theta: float, r: float) -> Placement:
        if self.written(*MDH_KEYS):
            return Mdh(self.gamma, self.b, self.alpha, self.d, theta, r)
        return Pose(self.xyz, self.rpy)


class _AttachmentEntry(_PlacedEntry):
    body: str
    theta: WrittenAngle = 0.0
    r: Number = 0.0

    @property
    def attachment(self) -> Attachment:
        return Attachment(self.body, self.placement(self.theta, self.r))


class _LimitsEntry(_Entry):
    position: tuple[Number, Number] | None = None
    velocity: Number | None = None
    acceleration: Number | None = None
    effort: Number | None = None


class _JointEntry(_PlacedEntry, _BodyEntry):
    antecedent: str
    theta: Coordinate = (0.0, 0.0)
    r: Coordinate = (0.0, 0.0)
    type: JointKind | None = None
    axis: Triple = (0.0, 0.0, 1.0)
    actuated: bool | None = None
    home: Number = 0.0
    limits: _LimitsEntry = _LimitsEntry()
    parameters: Literal["all", "inertial", "drive", "none"] = "all"
    stiffness: bool = False
    springref: Number = 0.0

    @model_validator(mode="after")
    def _one_coordinate(self) -> _JointEntry:
        if self.written("springref") and not self.stiffness:
            raise ValueError("'springref' is given without a spring; write 'stiffness: true' beside it, or remove it")
        by_pose = self.written("type", "axis", *POSE_KEYS)
        if by_pose and self.written(*MDH_KEYS):
            raise ValueError(
                "the keys type and axis go with xyz and rpy; with gamma, b, alpha, d, theta, r the axis is z, "
                "and q in theta or r says the type"
            )
        if by_pose and self.type is None:
            raise ValueError("the key 'type' is missing; write 'type: revolute' or 'type: prismatic'")
        if by_pose:
            return self
        factors = [self.theta[0], self.r[0]]
        if factors[0] and in_degrees(self.home) and self.parameters != "drive":
            raise ValueError(f"home is {self.home:g} rad, many turns; {DEGREES_ADVICE}, such as deg({self.home:g})")
        if factors == [0.0, 0.0]:
            raise ValueError(
                "the joint coordinate q is missing; write it in theta (revolute) or in r (prismatic), as 'theta: q'"
            )
        if 0.0 not in factors:
            raise ValueError("q appears in both theta and r; a joint has one coordinate, so make two joints of it")
        if sum(factors) != 1.0:
            raise ValueError(
                f"q is multiplied by {sum(factors):g}; write it plain, and turn the z axis around to reverse a joint"
            )
        return self

    def joint(self, name: str, actuated_by_default: bool) -> Joint:
        return Joint(
            name=name,
            antecedent=self.antecedent,
            kind=self.type or ("revolute" if self.theta[0] else "prismatic"),
            placement=self.placement(self.theta[1], self.r[1]),
            axis=self.axis,
            actuated=actuated_by_default if self.actuated is None else self.actuated,
            home=self.home,
            limits=Limits(**dict(self.limits)),
            parameters=self.parameters,
            spring=self.springref if self.stiffness else None,
        )


class _PlatformEntry(_BodyEntry):
    dof: list[str]
    home: _PoseEntry = _PoseEntry()


class _ClosureEntry(_Entry):
    connect: tuple[_AttachmentEntry, _AttachmentEntry] | None = None
    weld: tuple[_AttachmentEntry, _AttachmentEntry] | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> _ClosureEntry:
        if (self.connect is None) == (self.weld is None):
            raise ValueError("a closure is either 'connect: [.., ..]' (points) or 'weld: [.., ..]' (frames)")
        return self

    @property
    def closure(self) -> Closure:
        a, b = (end.attachment for end in self.connect or self.weld or ())
        return Closure("connect" if self.connect else "weld", a, b)


class _CouplingEntry(_Entry):
    joint: str
    ratios: dict[str, Number]
    offset: Number = 0.0


class _SpringEntry(_Entry):
    between: tuple[_AttachmentEntry, _AttachmentEntry]
    preload: bool = True
    stiffness: bool = True
    damping: bool = False

    def spring(self, name: str) -> Spring:
        a, b = (end.attachment for end in self.between)
        return Spring(name, a, b, tuple(kind for word, kind in SPRING_WORDS.items() if getattr(self, word)))


class RobotEntry(_Entry):
    """The keys of a robot file."""

    robot: str = Field(min_length=1)
    source: str = ""
    notes: tuple[str, ...] = ()
    constants: dict[str, Any] = Field(default_factory=dict)  # evaluated first
    gravity: Annotated[Triple, BeforeValidator(gravity_of)] = (0.0, 0.0, -STANDARD_GRAVITY)
    joints: dict[str, _JointEntry]
    platforms: dict[str, _PlatformEntry] = Field(default_factory=dict)
    closures: tuple[_ClosureEntry, ...] = ()
    couplings: tuple[_CouplingEntry, ...] = ()
    springs: dict[str, _SpringEntry] = Field(default_factory=dict)
    tool: str = Field("", min_length=1)
    floating: str = Field("", min_length=1)
