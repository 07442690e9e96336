"""Robot files: a `Robot` from YAML. The format is explained in ``docs/lookup/robot-file.md``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo, model_validator

from gtau.documents.validation import validate
from gtau.documents.yaml_document import Document, read_yaml
from gtau.errors import GtauError
from gtau.robots.floating import base_joints
from gtau.robots.placement import DEGREES_ADVICE, exact_placement, in_degrees, short_angles_note
from gtau.robots.readers.expressions import RESERVED, AffineInQ, evaluate, linear
from gtau.robots.readers.source import gravity_of
from gtau.robots.robot import (
    DAMPING,
    INERTIAL,
    PRELOAD,
    SPRING,
    STANDARD_GRAVITY,
    STIFFNESS,
    Attachment,
    Closure,
    Coupling,
    Joint,
    JointKind,
    Limits,
    Mdh,
    Placement,
    Platform,
    Pose,
    Robot,
    RobotFile,
    Spring,
)


def _number(text: str, info: ValidationInfo) -> float:
    return evaluate(text, info.context)


def _angle(text: str, info: ValidationInfo) -> float:
    angle = evaluate(text, info.context)
    if in_degrees(angle):
        raise ValueError(f"{text} rad is more than a turn; {DEGREES_ADVICE}, such as deg({text})")
    return angle


def _coordinate(text: str, info: ValidationInfo) -> AffineInQ:
    factor, constant = linear(text, info.context)
    if info.field_name == "theta" and in_degrees(constant):
        raise ValueError(f"{text} adds more than a turn, in rad; {DEGREES_ADVICE}, such as deg({constant:g})")
    return factor, constant


Number = Annotated[float, BeforeValidator(_number)]
Angle = Annotated[float, BeforeValidator(_angle)]
Coordinate = Annotated[AffineInQ, BeforeValidator(_coordinate)]
"""A number that may hold the joint coordinate ``q``."""
Triple = tuple[Number, Number, Number]
Angles = tuple[Angle, Angle, Angle]


MDH_KEYS = ("gamma", "b", "alpha", "d", "theta", "r")
POSE_KEYS = ("xyz", "rpy")
INERTIAL_KEYS = {"mass", "masses", "inertia", "inertial", "com", "cog", *INERTIAL}


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

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
    rpy: Angles = (0.0, 0.0, 0.0)


class _PlacedEntry(_PoseEntry):
    gamma: Angle = 0.0
    b: Number = 0.0
    alpha: Angle = 0.0
    d: Number = 0.0

    @model_validator(mode="after")
    def _one_way_of_placing(self) -> _PlacedEntry:
        if self.written(*MDH_KEYS) and self.written(*POSE_KEYS):
            raise ValueError("place it either by gamma, b, alpha, d, theta, r or by xyz and rpy, not by both")
        return self


class _AttachmentEntry(_PlacedEntry):
    body: str
    theta: Angle = 0.0
    r: Number = 0.0


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
    def _spring_of_a_stiffness(self) -> _JointEntry:
        if self.written("springref") and not self.stiffness:
            raise ValueError("'springref' is given without a spring; write 'stiffness: true' beside it, or remove it")
        return self

    @model_validator(mode="after")
    def _one_coordinate(self) -> _JointEntry:
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


class _CouplingEntry(_Entry):
    joint: str
    ratios: dict[str, Number]
    offset: Number = 0.0


class _SpringEntry(_Entry):
    between: tuple[_AttachmentEntry, _AttachmentEntry]
    preload: bool = True
    stiffness: bool = True
    damping: bool = False


class _RobotEntry(_Entry):
    robot: str = Field(min_length=1)
    source: str = ""
    notes: list[str] = []
    constants: dict[str, Any] = {}  # evaluated first, see _constants
    gravity: Annotated[Triple, BeforeValidator(gravity_of)] = (0.0, 0.0, -STANDARD_GRAVITY)
    joints: dict[str, _JointEntry]
    platforms: dict[str, _PlatformEntry] = {}
    closures: list[_ClosureEntry] = []
    couplings: list[_CouplingEntry] = []
    springs: dict[str, _SpringEntry] = {}
    tool: str = Field("", min_length=1)
    floating: str = Field("", min_length=1)


def read_native(path: str | Path) -> Robot:
    """Read a robot file (YAML); ``docs/lookup/robot-file.md`` explains the format."""
    return _with_exact_angles(_robot(read_yaml(path)))


def parse_native(text: str, path: str | Path) -> Robot:
    """Read a robot from the text of a robot file, with angles as written; ``path`` is for messages."""
    return _robot(Document(path, text))


def _robot(document: Document) -> Robot:
    entry = validate(_RobotEntry, document, context=_constants(document))
    # Loops and couplings leave most joints passive, an open chain none: each default is the common case.
    actuated_by_default = not (entry.closures or entry.couplings)
    joints = tuple(_joint(name, joint, actuated_by_default) for name, joint in entry.joints.items())
    try:
        return Robot(
            name=entry.robot,
            joints=(base_joints(entry.floating) if entry.floating else ()) + joints,
            platforms=tuple(
                Platform(name, tuple(platform.dof), Pose(platform.home.xyz, platform.home.rpy))
                for name, platform in entry.platforms.items()
            ),
            closures=tuple(map(_closure, entry.closures)),
            couplings=tuple(
                Coupling(coupling.joint, tuple(coupling.ratios.items()), coupling.offset)
                for coupling in entry.couplings
            ),
            gravity=entry.gravity,
            named_tool=entry.tool,
            floating=entry.floating,
            springs=tuple(_spring(name, spring) for name, spring in entry.springs.items()),
            file=RobotFile(entry.source, tuple(entry.notes), constants=tuple(_constants(document).items())),
        )
    except GtauError as error:
        raise GtauError(f"{document.path}: {error}") from None


def _with_exact_angles(robot: Robot) -> Robot:
    """Replace rounded angles of placements by the exact ones, with a note."""
    changes: dict[str, float] = {}

    def exact(name: str, placement: Placement) -> Placement:
        meant, change = exact_placement(placement)
        changes[name] = max(change, changes.get(name, 0.0))
        return meant if change else placement

    def end(at: Attachment) -> Attachment:
        return Attachment(at.body, exact(at.body, at.placement))

    joints = tuple(replace(joint, placement=exact(joint.name, joint.placement)) for joint in robot.joints)
    closures = tuple(replace(closure, a=end(closure.a), b=end(closure.b)) for closure in robot.closures)
    notes = short_angles_note(changes)
    return replace(robot, joints=joints, closures=closures).noted(*notes) if notes else robot


def _constants(document: Document) -> dict[str, float]:
    written = document.data.get("constants", {})
    if not isinstance(written, Mapping):
        raise document.error(("constants",), "write 'name: value' lines under it")
    values: dict[str, float] = {}
    for name, text in written.items():
        keys = ("constants", name)
        if name in RESERVED or not name.isidentifier() or not name.isascii():
            raise document.error(keys, f"'{name}' cannot name a constant; use letters, digits and _, and none of "
                                       f"{', '.join(sorted(RESERVED))}")  # fmt: skip
        try:
            values[name] = evaluate(text, values)
        except ValueError as error:
            raise document.error(keys, str(error)) from None
    return values


def _joint(name: str, entry: _JointEntry, actuated_by_default: bool) -> Joint:
    kind: JointKind | None = entry.type
    placement: Placement = Pose(entry.xyz, entry.rpy)
    if kind is None:
        kind = "revolute" if entry.theta[0] else "prismatic"
        placement = Mdh(entry.gamma, entry.b, entry.alpha, entry.d, entry.theta[1], entry.r[1])
    return Joint(
        name=name,
        antecedent=entry.antecedent,
        kind=kind,
        placement=placement,
        axis=entry.axis,
        actuated=actuated_by_default if entry.actuated is None else entry.actuated,
        home=entry.home,
        limits=Limits(**dict(entry.limits)),
        parameters=entry.parameters,
        spring=entry.springref if entry.stiffness else None,
    )


def _closure(entry: _ClosureEntry) -> Closure:
    ends = entry.connect or entry.weld
    assert ends is not None  # by _one_kind
    return Closure("connect" if entry.connect else "weld", *map(_attachment, ends))


def _spring(name: str, entry: _SpringEntry) -> Spring:
    has = {PRELOAD: entry.preload, STIFFNESS: entry.stiffness, DAMPING: entry.damping}
    a, b = map(_attachment, entry.between)
    return Spring(name, a, b, tuple(kind for kind in SPRING if has[kind]))


def _attachment(entry: _AttachmentEntry) -> Attachment:
    if entry.written(*MDH_KEYS):
        return Attachment(entry.body, Mdh(entry.gamma, entry.b, entry.alpha, entry.d, entry.theta, entry.r))
    return Attachment(entry.body, Pose(entry.xyz, entry.rpy))
