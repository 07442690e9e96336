"""The robot: a spanning tree of one-dof joints, optional free platforms, and closures, as frozen data."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from gtau.documents.validation import name_problem
from gtau.errors import GtauError, UnknownName, spelled
from gtau.robots.placement import Digits, Mdh as Mdh, Placement as Placement, Pose as Pose, compose

GROUND = "ground"
JointKind = Literal["revolute", "prismatic"]
STANDARD_GRAVITY = 9.80665  # m/s2
INERTIAL = ("xx", "xy", "xz", "yy", "yz", "zz", "mx", "my", "mz", "m")
"""Inertial parameters of a body in its own frame, at the frame's origin; ``xy = -int x y dm``."""
DRIVE = ("ia", "fv", "fs", "off")
"""Rotor inertia, viscous and Coulomb friction, and offset of a joint."""
PLAIN_FRICTION = DRIVE[1:]
STIFFNESS = "k"  # of a spring across a joint, or between two points
PRELOAD, DAMPING = "f0", "c"  # of a spring between two points: force at length zero
SPRING_WORDS = {"preload": PRELOAD, "stiffness": STIFFNESS, "damping": DAMPING}
SPRING = tuple(SPRING_WORDS.values())
MOST_PARTS = 2000  # links or rows: humanoids with all their frames have some 300
MOST_JOINTS = 200  # 150 in one chain take 50 s and 1 GB, and both grow as the cube


@dataclass(frozen=True)
class Limits:
    """Limits of an actuated joint; SI units, ``None`` where unknown."""

    position: tuple[float, float] | None = None
    velocity: float | None = None
    acceleration: float | None = None
    effort: float | None = None


@dataclass(frozen=True)
class Joint:
    """A one-dof joint and the link it moves; both have the joint's name.

    At coordinate zero the link's frame is at ``placement`` in the antecedent's frame; it turns about (or slides along)
    ``axis``, a unit vector of its own frame. ``parameters`` says which standard parameters the joint has: all 14, only
    the link's (``inertial``), only the drive's (``drive``, for a motor's shaft), or ``none`` (a massless link of a
    spherical joint). ``spring`` is the rest position of a spring across the joint; its stiffness is a parameter, ``k``.
    """

    name: str
    antecedent: str
    kind: JointKind
    placement: Placement = Mdh()
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    actuated: bool = True
    home: float = 0.0
    limits: Limits = Limits()
    parameters: Literal["all", "inertial", "drive", "none"] = "all"
    spring: float | None = None

    @property
    def turns(self) -> bool:
        """True for a revolute joint, False for a prismatic one."""
        return self.kind == "revolute"

    @property
    def unit(self) -> str:
        """Unit of its position: rad or m."""
        return "rad" if self.turns else "m"

    @property
    def has_mass(self) -> bool:
        """True if its link has inertial parameters."""
        return self.parameters in ("all", "inertial")


@dataclass(frozen=True)
class Coupling:
    """A joint that moves with others, ``q = sum of ratio * q_other + offset``: by gears, or by one motor of several."""

    joint: str
    ratios: tuple[tuple[str, float], ...]
    offset: float = 0.0

    @property
    def terms(self) -> dict[str, float]:
        """Factors of the joints in the sum that equals the offset."""
        return {self.joint: 1.0} | {name: -ratio for name, ratio in self.ratios}

    @classmethod
    def solved(cls, terms: Mapping[str, float], joint: str, total: float) -> Coupling:
        """Give a ``joint`` from the others whose sum with it, by the factors in ``terms``, is the ``total``."""
        factor = terms[joint]
        others = {name: -value / factor for name, value in terms.items() if value and name != joint}
        return cls(joint, tuple(others.items()), total / factor)


TRANSLATIONS, ROTATIONS = ("x", "y", "z"), ("rx", "ry", "rz")
RATIO = 1e6  # a screw of 1 mm a turn has 6283 rad/m; beyond 1e7 the rank of the closures fails


def base_rows(name: str) -> tuple[str, ...]:
    """Name the six joints of a floating base in the world; the last has the name of the base."""
    return (*(f"{name}_{kind}" for kind in TRANSLATIONS + ROTATIONS[:2]), name) if name else ()


@dataclass(frozen=True)
class Platform:
    """A free rigid body, not the link of a joint, held by closures.

    ``dof`` names its independent twist components in base axes (paper, eq. 10): any of ``x y z rx ry rz``, with none,
    one or all three rotations. ``home`` is its pose in the base.
    """

    name: str
    dof: tuple[str, ...]
    home: Pose = Pose()


@dataclass(frozen=True)
class Attachment:
    """A frame fixed to a link, a platform or the ground."""

    body: str
    placement: Placement = Pose()

    def at(self, placement: Placement) -> Attachment:
        """Attach the frame that is at ``placement`` in this one."""
        return Attachment(self.body, placement if self.placement == Pose() else compose(self.placement, placement))


@dataclass(frozen=True)
class Closure:
    """A loop closed between two frames: ``connect`` joins their origins, ``weld`` the whole frames."""

    kind: Literal["connect", "weld"]
    a: Attachment
    b: Attachment


@dataclass(frozen=True)
class Spring:
    """A spring, gas spring, counterbalance or damper between a point of one body and a point of another.

    It pushes the points, at a distance ``l``, apart along their line by ``f0 - k l - c dl/dt``. So all three parameters
    are usually positive, and ``f0 = k l0`` for a coil at rest at ``l0``. ``parameters`` says which terms it has.
    """

    name: str
    a: Attachment
    b: Attachment
    parameters: tuple[str, ...] = (PRELOAD, STIFFNESS)


@dataclass(frozen=True)
class RobotFile:
    """Content of a robot's file beside the robot itself; robots compare only the ``source``.

    ``notes`` state what a reader found odd or decided for the user, ``inertias`` the parameters of bodies and rotors by
    name, SI units. Without ``home_given`` homes are only starting points of a search. ``rounding`` is of the numbers
    from which a reader computes placements; without it, the file states the placements themselves.
    """

    source: str = ""
    notes: tuple[str, ...] = field(default=(), compare=False)
    home_given: bool = field(default=True, compare=False)
    constants: tuple[tuple[str, float], ...] = field(default=(), compare=False)
    inertias: tuple[tuple[str, float], ...] = field(default=(), compare=False)
    rounding: Digits | None = field(default=None, compare=False)


@spelled(
    plot="gtau.plot(robot)",
    **dict.fromkeys(("rnea", "rne", "gravload"), "gtau.InverseDynamics(robot).torques(q, qd, qdd, parameters)"),
    regressor="gtau.InverseDynamics(robot).regressor(q, qd, qdd)",
    **dict.fromkeys(("n", "nq", "nv"), "len(robot.actuated)"),
    joint_names="robot.actuated",
)
@dataclass(frozen=True, repr=False)
class Robot:
    """A spanning tree of joints, platforms and closures, and springs between its bodies.

    Every antecedent precedes its followers. ``gravity`` is the acceleration of gravity in base axes, m/s2.
    ``named_tool`` is the body that carries a payload, if the robot's file names it (see :attr:`tool`), and ``floating``
    the link that is a floating base (see :mod:`gtau.robots.geometry`). ``file`` is further content of the file.
    """

    name: str
    joints: tuple[Joint, ...] = None  # type: ignore[assignment]  # refused below
    platforms: tuple[Platform, ...] = ()
    closures: tuple[Closure, ...] = ()
    couplings: tuple[Coupling, ...] = ()
    gravity: tuple[float, float, float] = (0.0, 0.0, -STANDARD_GRAVITY)
    springs: tuple[Spring, ...] = ()
    floating: str = ""
    named_tool: str = ""
    file: RobotFile = field(default_factory=RobotFile)

    def __post_init__(self) -> None:
        if problem := name_problem(self.name):
            raise GtauError(f"robot: {problem}.")
        if self.joints is None:
            raise GtauError(f"a robot has joints; did you mean gtau.load_robot({self.name!r})?")
        refuse_many(len(self.joints), "joints that move", MOST_JOINTS)
        if problem := next(_problems(self), None):
            raise GtauError(f"robot '{self.name}': {problem}.")

    def __repr__(self) -> str:
        return (
            f"Robot({self.name!r}, {len(self.joints)} joints, actuated: {', '.join(self.actuated)}, platforms: "
            f"{len(self.platforms)}, closures: {len(self.closures)})"
        )

    @property
    def source(self) -> str:
        """Origin of the robot's file."""
        return self.file.source

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes of the reader of the robot file."""
        return self.file.notes

    @property
    def inertias(self) -> dict[str, float]:
        """Parameters that the robot's file states, by name, SI units."""
        return {str(name): value for name, value in self.file.inertias}

    def with_file(self, **changes: Any) -> Robot:
        """Return the robot with other fields of its ``file``."""
        return replace(self, file=replace(self.file, **changes))

    def noted(self, *notes: str) -> Robot:
        """Return the robot with further notes."""
        return self.with_file(notes=(*self.notes, *notes))

    @property
    def actuated(self) -> tuple[str, ...]:
        """Names of the actuated joints, in order."""
        return tuple(joint.name for joint in self.joints if joint.actuated)

    @property
    def base(self) -> tuple[str, ...]:
        """Names of the six joints without motors of a floating base, whose rows are the base equations; else none."""
        return base_rows(self.floating)

    @property
    def motors(self) -> tuple[str, ...]:
        """Names of the actuated joints with a motor: all except the joints of a floating base."""
        return tuple(joint for joint in self.actuated if joint not in self.base)

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of all links and platforms, in order."""
        return tuple(joint.name for joint in self.joints) + tuple(platform.name for platform in self.platforms)

    @property
    def tool(self) -> str:
        """Body that carries a payload: the named one, the last platform, or the last link with a mass or its palm."""
        if self.named_tool:
            return self.named_tool
        if self.platforms:
            return self.platforms[-1].name
        links = [joint.name for joint in self.joints if joint.has_mass]
        return _palm(self, links) if links else self.joints[-1].name

    @property
    def ends(self) -> tuple[Attachment, ...]:
        """Attachments of closures and springs, both ends of each in turn."""
        ties: tuple[Closure | Spring, ...] = (*self.closures, *self.springs)
        return tuple(end for tie in ties for end in (tie.a, tie.b))

    @property
    def driven(self) -> frozenset[str]:
        """Names of the joints that a motor moves itself, or that are coupled to one."""
        return frozenset(self.actuated).union(*(tie.terms for tie in self.couplings))

    def joint(self, name: str) -> Joint:
        """Return the joint with this name; raises GtauError if there is none."""
        joints = {joint.name: joint for joint in self.joints}
        if name not in joints:
            raise UnknownName(f"robot '{self.name}' has no joint '{name}'; choose from {', '.join(joints)}.")
        return joints[name]


def refuse_many(count: int, what: str, most: int = MOST_PARTS) -> None:
    """Refuse more parts than robots have, before hours of work; raises GtauError."""
    if count > most:
        raise GtauError(f"it holds {count} {what}, and at most {most} are read; give the file of the robot alone.")


def _problems(robot: Robot) -> Iterator[str]:
    names = Counter((GROUND, *robot.bodies, *(spring.name for spring in robot.springs)))
    yield from filter(None, map(name_problem, names))
    if not robot.joints:
        yield "it has no joints; list at least one under 'joints'"
    for name, count in names.items():
        if count > 1:
            yield f"the name '{name}' is used twice; give every joint, platform and spring its own"
        if "@" in name:
            yield f"the name '{name}' holds '@', which marks the run of a parameter (fs_left@2); write another"
    known = {GROUND}
    for joint in robot.joints:
        if joint.antecedent not in known:
            which = f"joint '{joint.name}' has the antecedent '{joint.antecedent}'"
            yield f"{which}, which is not a joint listed before it; write '{GROUND}' or move the antecedent up"
        yield from _joint_problems(joint)
        known.add(joint.name)
    for platform in robot.platforms:
        dof = platform.dof
        if unknown := [component for component in dof if component not in TRANSLATIONS + ROTATIONS]:
            yield f"platform '{platform.name}' has the degree of freedom '{unknown[0]}'; choose from x y z rx ry rz"
        if len(set(dof)) < len(dof) or not dof:
            which = f"the degrees of freedom of platform '{platform.name}'"
            yield f"{which} must be one or more different ones of x y z rx ry rz"
        if len(set(dof).intersection(ROTATIONS)) == 2:
            advice = "give it none, one or all three (the closures constrain the rest)"
            yield f"platform '{platform.name}' has two rotations; {advice}"
        if not any(platform.name in (closure.a.body, closure.b.body) for closure in robot.closures):
            yield f"no closure holds platform '{platform.name}'; add one or remove the platform"
    known.update(robot.bodies)
    for number, closure in enumerate(robot.closures, start=1):
        yield from _tie_problems(f"closure {number}", closure, known)
    for spring in robot.springs:
        yield from _tie_problems(f"spring '{spring.name}'", spring, known)
        if not spring.parameters:
            yield f"spring '{spring.name}' has none of preload, stiffness and damping; give it one, or remove it"
    joints = {joint.name for joint in robot.joints}
    for number, coupling in enumerate(robot.couplings, start=1):
        yield from _coupling_problems(f"coupling {number}", coupling, joints)
    carriers = [joint.name for joint in robot.joints if joint.has_mass]
    carriers += [platform.name for platform in robot.platforms]
    if robot.named_tool and robot.named_tool not in carriers:
        yield f"the tool '{robot.named_tool}' is not a body with a mass; choose from {', '.join(carriers)}"
    if robot.floating and tuple(joint.name for joint in robot.joints[: len(robot.base)]) != robot.base:
        yield f"its base '{robot.floating}' floats, but its first joints are not {', '.join(robot.base)}"
    if not robot.motors:
        yield "no joint is actuated; mark the motors' joints with 'actuated: true'"


def _joint_problems(joint: Joint) -> Iterator[str]:
    if abs(np.linalg.norm(joint.axis) - 1.0) > 1e-9:
        yield f"the axis of joint '{joint.name}' is not a unit vector; divide it by its length"
    low, high = joint.limits.position or (0.0, 1.0)
    if not low < high:
        which = f"the position limits of joint '{joint.name}' are {low:g} to {high:g}"
        yield f"{which}; write the lower one first, or leave them out"
    for quantity in ("velocity", "acceleration", "effort"):
        value = getattr(joint.limits, quantity)
        if value is not None and not value > 0.0:
            yield f"the {quantity} limit of joint '{joint.name}' is {value:g}; write a positive number, or leave it out"


def _tie_problems(what: str, tie: Closure | Spring, known: Collection[str]) -> Iterator[str]:
    for end in (tie.a, tie.b):
        if end.body not in known:
            yield f"{what} is attached to '{end.body}', which is not a joint, a platform or '{GROUND}'"
    if tie.a.body == tie.b.body:
        yield f"{what} ties '{tie.a.body}' to itself; attach its ends to two bodies"


def _coupling_problems(what: str, coupling: Coupling, joints: Collection[str]) -> Iterator[str]:
    others = [name for name, _ in coupling.ratios]
    for name in (coupling.joint, *others):
        if name not in joints:
            yield f"{what} names '{name}', which is not a joint"
    if not others or coupling.joint in others or len(set(others)) < len(others):
        yield f"{what} must give '{coupling.joint}' from one or more other joints, each named once"
    for name, ratio in coupling.ratios:
        if not ratio:
            yield f"{what} of '{coupling.joint}' has a ratio of zero; leave that joint out"
        elif not 1.0 / RATIO <= abs(ratio) <= RATIO:
            which = f"{what} gives '{coupling.joint}' from '{name}' by a ratio of {ratio:g}, which no gear has"
            yield f"{which}; write one between {1.0 / RATIO:g} and {RATIO:g} in size, rad and m"


def _palm(robot: Robot, links: list[str]) -> str:
    """Find the link that carries the fingers, if the last of the ``links`` with a mass is one; else that link."""
    # Fingers are branches of an arm: another one has as many joints, or three others are alike as beside a thumb, and
    # none has more joints than the arm before them, unlike the arms of a torso, and legs.
    before: dict[str, tuple[str, ...]] = {}  # from the ground to each joint
    for joint in robot.joints:
        before[joint.name] = (*before.get(joint.antecedent, ()), joint.name)
    last = before[links[-1]]
    for depth, palm in enumerate(last[:-1], start=1):
        lengths: dict[str, int] = {}
        for chain in before.values():
            if len(chain) > depth and chain[depth - 1] == palm:
                lengths[chain[depth]] = max(lengths.get(chain[depth], 0), len(chain) - depth)
        alike = Counter(lengths.values())
        fingers = alike[lengths[last[depth]]] > 1 or max(alike.values()) > 2
        arm = depth - len(robot.base)
        if palm in links and fingers and max(lengths.values()) <= arm:
            return palm
    return links[-1]
