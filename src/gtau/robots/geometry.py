"""Geometry of a whole robot: its lengths and legs, entries that are doubtful, and bases that float.

A floating base is a free body that carries the rest of a robot, modelled as six joints of the tree: it moves in the
world by three slides and three turns without motors, about x, the turned y, and z of the base. The last of these six
joints has the name of the base, and its link is the base. Their rows of the model are the six base equations: external
forces along, and moments about, their axes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from math import pi

import numpy as np
from numpy.typing import ArrayLike

from gtau.errors import GtauError
from gtau.robots.parameter import Parameter, parameter_of, stated_inertias
from gtau.robots.placement import Placement, Pose
from gtau.robots.robot import (
    GROUND,
    INERTIAL,
    ROTATIONS,
    TRANSLATIONS,
    Attachment,
    Closure,
    Joint,
    Robot,
    Spring,
    base_rows,
)

SAME = 9  # decimals in which identical legs agree, lengths in m and directions
TURNS = 2  # a wider range either way suggests limits in degrees
FAR = 20.0  # m; a longer link suggests mm
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
REACHED = 1e-9  # rad or m; tolerance of a home at a limit

Frame = tuple[np.ndarray, np.ndarray]
"""Orientation (3, 3) and origin (3,) in m, in base axes."""


def characteristic_length(robot: Robot) -> float:
    """Compute the mean length (m) of the robot's placements that have one: the scale between m and rad."""
    placements = [joint.placement for joint in robot.joints]
    placements += [end.placement for tie in robot.closures for end in (tie.a, tie.b)]
    lengths = [float(np.linalg.norm(placement.position)) for placement in placements]
    return float(np.mean([length for length in lengths if length > 1e-9] or [1.0]))


def places_on(robot: Robot, body: str) -> list[np.ndarray]:
    """List the origins (3,), m, of the frames of joints and closures on a body, in its frame."""
    joints = [joint.placement.position for joint in robot.joints if joint.antecedent == body]
    ends = (end for tie in robot.closures for end in (tie.a, tie.b))
    return joints + [end.placement.position for end in ends if end.body == body]


def extent(robot: Robot, body: str) -> tuple[np.ndarray, float, bool]:
    """Bound the frames on a body by a ball: centre (3,) and radius, m, in its frame; and whether it ends a chain."""
    points = places_on(robot, body)
    frames = np.array([np.zeros(3), *points])
    centre = (frames.min(axis=0) + frames.max(axis=0)) / 2
    return centre, float(np.linalg.norm(frames - centre, axis=1).max()), not points


def longest_placement(robot: Robot) -> float:
    """Return the largest distance (m) from a body's frame to a joint or closure on it; 1 without any."""
    return max([2 * extent(robot, body)[1] for body in robot.bodies], default=0.0) or 1.0


def moved_ends(
    robot: Robot, moved: Callable[[Attachment], Attachment]
) -> tuple[tuple[Closure, ...], tuple[Spring, ...]]:
    """Move both ends of all closures and springs."""
    closures = tuple(replace(tie, a=moved(tie.a), b=moved(tie.b)) for tie in robot.closures)
    return closures, tuple(replace(spring, a=moved(spring.a), b=moved(spring.b)) for spring in robot.springs)


def attached(end: Attachment, frames: dict[str, Frame]) -> Frame:
    """Express the frame of a closure's end in the base."""
    R, p = frames[end.body]
    return R @ end.placement.rotation, p + R @ end.placement.position


def legs(robot: Robot) -> list[tuple[str, ...]]:
    """List the joints of every chain or tree from the ground or the floating base, in order."""
    root: dict[str, str] = {}
    chains: dict[str, list[str]] = {}
    for joint in robot.joints:
        root[joint.name] = joint.name if joint.antecedent in (GROUND, robot.floating) else root[joint.antecedent]
        chains.setdefault(root[joint.name], []).append(joint.name)
    return [tuple(names) for names in chains.values()]


def identical_legs(robot: Robot) -> list[list[tuple[str, ...]]]:
    """Group legs of the same geometry and parameters, whatever their mounting pose, home and limits."""
    groups: dict[tuple, list[tuple[str, ...]]] = {}
    for leg in legs(robot):
        joints = [robot.joint(name) for name in leg]
        alike = [(joint.kind, joint.actuated, joint.parameters, joint.spring, _numbers(joint.axis)) for joint in joints]
        mounted = tuple((leg.index(joint.antecedent), _placement(joint.placement)) for joint in joints[1:])
        ties: list[tuple[tuple[str, ...], Attachment]] = []
        ties += [((tie.kind,), end) for tie in robot.closures for end in (tie.a, tie.b)]
        ties += [(tie.parameters, end) for tie in robot.springs for end in (tie.a, tie.b)]
        held = [(kind, end) for kind, end in ties if end.body in leg]
        tied = sorted((kind, leg.index(end.body), _placement(end.placement)) for kind, end in held)
        coupled = sorted(
            (name == coupling.joint, leg.index(name), ratio)
            for coupling in robot.couplings
            for name, ratio in ((coupling.joint, 1.0), *coupling.ratios)
            if name in leg
        )
        groups.setdefault((tuple(alike), mounted, tuple(tied), tuple(coupled)), []).append(leg)
    return list(groups.values())


def _placement(placement: Placement) -> tuple[float, ...]:
    return _numbers(placement.rotation) + _numbers(placement.position)


def _numbers(array: ArrayLike) -> tuple[float, ...]:
    return tuple((np.round(np.asarray(array, dtype=float), SAME) + 0.0).ravel().tolist())


def oddities(robot: Robot) -> Iterator[str]:
    """Describe implausible entries, a sentence each: links of 350 m, limits of 130 rad, a home outside the limits."""
    placed: list[tuple[str, Placement]] = [(f"joint '{joint.name}'", joint.placement) for joint in robot.joints]
    placed += [(f"home of platform '{platform.name}'", platform.home) for platform in robot.platforms]
    for number, closure in enumerate(robot.closures, start=1):
        placed += [(f"closure {number} on '{end.body}'", end.placement) for end in (closure.a, closure.b)]
    for spring in robot.springs:
        placed += [(f"spring '{spring.name}' on '{end.body}'", end.placement) for end in (spring.a, spring.b)]
    sizes = [(what, np.linalg.norm(place.position)) for what, place in placed]
    long = [f"{what} is placed {size:.4g} m away" for what, size in sizes if size > FAR]
    slides = [joint for joint in robot.joints if not joint.turns and _reach(joint) > FAR]
    long += [f"the position limits of joint '{joint.name}' are {_limits(joint)}" for joint in slides]
    if long:
        yield f"{'; '.join(long)}: lengths are in m, so check whether these are mm"
    # except motor shafts before a gear
    links = (joint for joint in robot.joints if joint.turns and joint.parameters != "drive")
    if far := [f"joint '{joint.name}' ({_limits(joint)})" for joint in links if _reach(joint) > TURNS * 2 * pi]:
        yield (
            f"position limits of many turns: {', '.join(far)}; angles are in rad; if these are degrees, divide them by"
            " 57.2958, or write deg(...) in a robot file"
        )
    outside = []
    for joint in robot.joints:
        low, high = joint.limits.position or (-np.inf, np.inf)
        if not low - REACHED <= joint.home <= high + REACHED:
            outside.append(f"joint '{joint.name}' ({joint.home:.4g} {joint.unit}, limits {_limits(joint)})")
    if outside:
        names = ", ".join(outside)
        yield f"home lies outside the position limits of {names}; write a 'home' within them in the robot file"


def tool_note(robot: Robot) -> tuple[str, ...]:
    """Note which body is assumed to carry the payload, if the file names none and several are possible."""
    links = [joint.name for joint in robot.joints if joint.has_mass]
    ends = set(links).difference(joint.antecedent for joint in robot.joints)
    if robot.named_tool or robot.platforms or not (robot.closures or len(ends) > 1):
        return ()
    why = "the last link of the robot's file" if links[-1:] == [robot.tool] else "which carries the fingers"
    return (
        f"the payload is assumed to be on '{robot.tool}', {why}; if it is on another body, write"
        " 'tool: BODY' in the robot file (gtau robot --save makes one of any robot)",
    )


def massless(robot: Robot, parameters: Iterable[str]) -> tuple[str, ...]:
    """List links and platforms without a mass, moment or inertia in ``parameters``."""
    named = {name.body for name in map(parameter_of, parameters) if name.kind in INERTIAL}
    bodies = [joint.name for joint in robot.joints if joint.has_mass]
    bodies += [platform.name for platform in robot.platforms]
    return tuple(body for body in bodies if body not in named)


def _reach(joint: Joint) -> float:
    return max(map(abs, joint.limits.position or (0.0,)))


def _limits(joint: Joint) -> str:
    assert joint.limits.position is not None
    low, high = joint.limits.position
    return f"{low:.4g} to {high:.4g} {joint.unit}"


def base_joints(name: str) -> tuple[Joint, ...]:
    """Build the six joints of a floating base, on the ground, the last with its name."""
    return _chain(base_rows(name), TRANSLATIONS + ROTATIONS, GROUND, Pose())


def turning(name: str, antecedent: str, placement: Placement, axes: str) -> tuple[Joint, ...]:
    """Make a spherical or universal joint: revolute ones about `axes` in turn, with massless links in between."""
    names = [*(f"{name}_{axis}" for axis in axes[:-1]), name]
    return _chain(names, [f"r{axis}" for axis in axes], antecedent, placement)


def _chain(names: Sequence[str], kinds: Sequence[str], antecedent: str, placement: Placement) -> tuple[Joint, ...]:
    """Make joints one after the other, all but the last with massless links: ``x`` slides along x, ``rx`` turns."""
    joints = []
    for name, kind in zip(names, kinds, strict=True):
        joint = Joint(name, antecedent, "revolute" if kind in ROTATIONS else "prismatic", placement, AXES[kind[-1]])
        joints.append(replace(joint, parameters="inertial" if name == names[-1] else "none"))
        antecedent, placement = name, Pose()
    return tuple(joints)


def float_base(robot: Robot, name: str = "base") -> Robot:
    """Let the base of a robot float: a body ``name`` then carries everything mounted on the ground."""
    if robot.floating:
        raise GtauError(f"robot '{robot.name}': its base '{robot.floating}' floats already.")
    for platform in robot.platforms:
        if len(platform.dof) < len(TRANSLATIONS + ROTATIONS):
            raise GtauError(
                f"robot '{robot.name}': platform '{platform.name}' moves in {' '.join(platform.dof)} of the ground "
                "alone, which a floating base carries along; write "
                f"'dof: [{', '.join(TRANSLATIONS + ROTATIONS)}]', its closures constrain the rest."
            )

    def on(body: str) -> str:
        return name if body == GROUND else body

    joints = tuple(replace(joint, antecedent=on(joint.antecedent)) for joint in robot.joints)
    closures, springs = moved_ends(robot, lambda end: replace(end, body=on(end.body)))
    stated = {Parameter(key.kind, on(key.body)): value for key, value in stated_inertias(robot).items()}
    floated = replace(robot, joints=base_joints(name) + joints, closures=closures, springs=springs, floating=name)
    return floated.with_file(inertias=tuple(stated.items()))


def drawn_base(robot: Robot) -> tuple[str, ...]:
    """Find the three slides and three turns, unactuated and untied, that carry all other joints as a floating base."""
    before, six = GROUND, list[Joint]()
    while len(six) < 6:
        following = [joint for joint in robot.joints if joint.antecedent == before]
        if len(following) != 1 or following[0].actuated:
            return ()
        six.append(following[0])
        before = following[0].name
    names = tuple(joint.name for joint in six)
    ends = {GROUND, *names[:-1]}.intersection(end.body for end in robot.ends)
    coupled = {name for tie in robot.couplings for name in tie.terms}
    axes = ([joint.axis for joint in six if joint.kind == kind] for kind in ("prismatic", "revolute"))
    spanning = all(len(directions) == 3 and np.linalg.matrix_rank(directions) == 3 for directions in axes)
    return names if spanning and not ends and coupled.isdisjoint(names) else ()


def refuse_floating(robot: Robot, what: str) -> None:
    """Refuse a robot with a floating base where ``what`` ("exciting trajectories are") requires a fixed one."""
    if robot.floating:
        raise GtauError(
            f"robot '{robot.name}': its base '{robot.floating}' floats, and {what} not supported there; if the base "
            "did not move, fix it by 'robot: {file: ..., base: fixed}'."
        )
