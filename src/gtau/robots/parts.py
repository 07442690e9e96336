"""Hold some joints of a robot, to isolate one leg, one arm of two, or an arm without its gripper."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase

import numpy as np

from gtau.documents.validation import unknown
from gtau.errors import GtauError
from gtau.robots.geometry import compose, pose_of, turn
from gtau.robots.parameter import parameter_of
from gtau.robots.rigid_body import lumped, rigid_body
from gtau.robots.robot import GROUND, INERTIAL, Attachment, Closure, Coupling, Joint, Placement, Pose, Robot

NAMED = 6  # joints that a note lists


def select_joints(robot: Robot, patterns: Sequence[str], held: Mapping[str, float]) -> Robot:
    """Let some joints of a robot move and hold the others.

    Parameters
    ----------
    robot : Robot
    patterns : sequence of str
        Names of the joints that move, with ``*`` and ``?``; if empty, all joints not in ``held`` move.
    held : mapping of str to float
        Positions of held joints, rad or m; those not named are held at home.

    Returns
    -------
    Robot
        With a note on the joints that are held.

    Raises
    ------
    GtauError
        A pattern matches no joint, or a joint is both selected and held.
    """
    names = [joint.name for joint in robot.joints if joint.name not in robot.base]
    for name in held:
        if name not in names:
            raise GtauError(f"'held': {unknown(f'joint {name!r}', name, names)}.")
    moving = set() if patterns else set(names) - held.keys()
    for pattern in patterns:
        if not (matched := {name for name in names if fnmatchcase(name, pattern)}):
            raise GtauError(
                f"no joint of robot '{robot.name}' is called '{pattern}'; choose from {', '.join(names)} (* stands for "
                "any letters)."
            )
        moving |= matched
    moving |= set(robot.base)
    if both := moving & held.keys():
        raise GtauError(f"joint '{min(both)}' is both among the 'joints' that move and 'held'; remove one of them.")
    positions = {joint.name: held.get(joint.name, joint.home) for joint in robot.joints if joint.name not in moving}
    if not positions:
        return robot
    return hold_joints(robot, positions, "as chosen")


def hold_joints(robot: Robot, positions: Mapping[str, float], why: str) -> Robot:
    """Hold joints at ``positions``, rad or m, and note which and ``why``.

    Joints determined from them through couplings are held too.
    """
    positions = _with_coupled(robot, positions)
    shown = [f"'{name}' at {position:.4g}" for name, position in positions.items()]
    note = f"{len(shown)} joint{'s' * (len(shown) > 1)} held {why} (rad, m): {_first(shown)}"
    return replace(lock_joints(robot, positions), notes=(*robot.notes, note))


def lock_joints(robot: Robot, positions: Mapping[str, float]) -> Robot:
    """Merge the links of joints, at ``positions``, into their carriers, which then have a mass if the links had.

    Closures and springs with both ends on one body are dropped.

    Raises
    ------
    GtauError
        No moving joint remains.
    """
    carried = {GROUND: Attachment(GROUND)} | {platform.name: Attachment(platform.name) for platform in robot.platforms}
    joints: list[Joint] = []
    heavy = set()
    for joint in robot.joints:
        before = carried[joint.antecedent]
        placement = joint.placement if before.placement == Pose() else compose(before.placement, joint.placement)
        if joint.name not in positions:
            joints.append(replace(joint, antecedent=before.body, placement=placement))
            carried[joint.name] = Attachment(joint.name)
            continue
        carried[joint.name] = Attachment(before.body, _after(joint, placement, positions[joint.name]))
        if joint.has_mass:
            heavy.add(before.body)
    if not joints:
        raise GtauError(f"robot '{robot.name}': all joints are held; hold fewer of them.")

    def moved(end: Attachment) -> Attachment:
        at = carried[end.body]
        return end if at.body == end.body else Attachment(at.body, compose(at.placement, end.placement))

    closures = (Closure(each.kind, moved(each.a), moved(each.b)) for each in robot.closures)
    springs = (replace(each, a=moved(each.a), b=moved(each.b)) for each in robot.springs)
    tool = carried[robot.named_tool].body if robot.named_tool else ""
    return replace(
        robot,
        joints=tuple(_heavy(joint) if joint.name in heavy else joint for joint in joints),
        closures=tuple(each for each in closures if each.a.body != each.b.body),
        couplings=tuple(_couplings(robot, positions)),
        springs=tuple(each for each in springs if each.a.body != each.b.body),
        named_tool="" if tool == GROUND else tool,
        floating="" if robot.floating in positions else robot.floating,
        inertias=_inertias(robot, carried),
    )


def _inertias(robot: Robot, carried: Mapping[str, Attachment]) -> tuple[tuple[str, float], ...]:
    """Add the stated inertias of locked links to those of the links that carry them; their rotors no longer turn."""
    stated = dict(robot.inertias)
    bodies = dict.fromkeys(parameter_of(name).body for name in stated if parameter_of(name).kind in INERTIAL)
    rotors = {name: value for name, value in stated.items() if parameter_of(name).kind not in INERTIAL}
    turning = {body for body, at in carried.items() if at.body == body}
    kept = ((name, value) for name, value in rotors.items() if parameter_of(name).body in turning)
    summed = lumped((carried[body], rigid_body(stated, body)) for body in bodies)
    return (*summed.items(), *kept)


def _after(joint: Joint, placement: Placement, position: float) -> Placement:
    """Place a joint's link at a position, its frame being at ``placement`` at zero."""
    if not position:
        return placement
    axis = np.array(joint.axis)
    if joint.kind == "revolute":
        return compose(placement, pose_of(turn(axis, position), np.zeros(3)))
    return compose(placement, pose_of(np.eye(3), axis * position))


def _heavy(joint: Joint) -> Joint:
    if joint.has_mass:
        return joint
    return replace(joint, parameters="all" if joint.parameters == "drive" else "inertial")


def _with_coupled(robot: Robot, positions: Mapping[str, float]) -> dict[str, float]:
    """Complete the positions of held joints by those determined through couplings."""
    found = dict(positions)
    settled = False
    while not settled:
        settled = True
        for coupling in robot.couplings:
            terms = {coupling.joint: 1.0} | {name: -ratio for name, ratio in coupling.ratios}
            free = [name for name in terms if name not in found]
            if len(free) == 1:
                rest = sum(factor * found[name] for name, factor in terms.items() if name in found)
                found[free[0]] = (coupling.offset - rest) / terms[free[0]]
                settled = False
    return found


def _couplings(robot: Robot, positions: Mapping[str, float]) -> Iterator[Coupling]:
    """List the couplings of the joints that are not held."""
    for coupling in robot.couplings:
        terms = {coupling.joint: 1.0} | {name: -ratio for name, ratio in coupling.ratios}
        free = [name for name in terms if name not in positions]
        if free:
            offset = coupling.offset - sum(terms[name] * positions[name] for name in terms if name in positions)
            first, *others = free
            ratios = tuple((name, -terms[name] / terms[first]) for name in others)
            yield Coupling(first, ratios, offset / terms[first])


def listed(names: Sequence[str]) -> str:
    """List names in quotes, the first few of many."""
    return _first([f"'{name}'" for name in names])


def _first(texts: Sequence[str]) -> str:
    return ", ".join(texts[:NAMED]) + (f" and {len(texts) - NAMED} more" if len(texts) > NAMED else "")
