"""URDF files: geometry and limits of serial arms and trees, and of loops, in the file or described beside it.

Loops are written in the elements ``<loop>`` (generalized_rbda), ``<loop_joint>`` (Isaac Sim),
``<drake:ball_constraint>`` or a ``<joint>`` that Gazebo adds to its model; what ties links otherwise is refused by
name. Or they are in a YAML file, as in the Gepetto models of parallel robots: ``closed_loop`` lists pairs of frames
that a loop ties, ``type`` their kind (``3d`` or ``6d``, the default), ``name_mot`` the motors, and ``joint_name`` with
``joint_type`` joints that a URDF cannot describe.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal
from xml.etree.ElementTree import Element

import numpy as np
from pydantic import field_validator

from gtau.documents.markup import all_numbers, attribute, line_of, numbers, read_yaml
from gtau.documents.validation import Keys, some_of, unknown, validate
from gtau.errors import GtauError, errors_at
from gtau.robots.geometry import drawn_base
from gtau.robots.parameter import RigidBody, lumped
from gtau.robots.parts import listed, without_idle_pins
from gtau.robots.placement import compose, digits_of, exact_placement, pose_of
from gtau.robots.readers.source import BaseChoice
from gtau.robots.readers.urdf_tree import WORLD, UrdfTree, axis_of, driven_joints, origin_of, read_urdf_tree
from gtau.robots.robot import GROUND, Attachment, Closure, Joint, Placement, Pose, Robot, RobotFile

POINTS = {"spherical": 1, "ball": 1, "revolute": 2, "continuous": 2}
"""Number of points of its axis that a joint ties: two make a hinge."""
APART = 0.1  # m, between two points of an axis
SIDES = ("predecessor", "successor", "link1", "link2")
UNREAD = re.compile(r"constraint|coupling|\w+_constraint|linear_bushing\w*|joint")
"""Elements, without their prefix, that tie links and are not read."""
CLOSING = "closing_"  # links that onshape-to-robot writes in pairs where a loop is cut
TENSOR = [[0, 3, 4], [3, 1, 5], [4, 5, 2]]  # places of xx yy zz xy xz yz in a tensor
TINY = 1e-9  # kg m2: smaller inertias belong to frames that have none
SLACK = 1e-2  # of the largest principal moment over the sum of the others, as files round
HEAVIEST = 1000.0  # largest mass in kg, and over the median mass of the file
SHOWN = 4  # bodies that a note lists
BY_HAND = (
    "is not read; write the frames that it ties under 'closed_loop', and the motors under 'name_mot', in a YAML file "
    "of the same name beside this one, or describe the robot in a robot file"
)


def read_urdf(path: str | Path, base: BaseChoice = None) -> Robot:
    """Read a robot from a URDF file.

    Links on fixed joints become part of their carriers. Joints are listed depth first in the order of the file; each
    keeps its name, and its link has the same name. A joint that mimics another is passive and coupled to it. Gravity is
    along -z of the root link. Rounded angles (1.5708) are replaced by exact ones, with a note. A velocity or effort
    limit of 0 means unknown. With a ``base`` a floating joint is fixed, and its child becomes the ground.
    """
    path = Path(path)
    tree = read_urdf_tree(path, {}, base)
    notes = []
    if base is None and sum(joint.antecedent == GROUND for joint in tree.joints) > 1:
        notes.append(
            "the root link was taken as fixed, as a URDF does not say whether it floats; write --base floating "
            "(base: floating) if it moved"
        )
    with errors_at(path):
        file = _file(tree, path.name)
        closures, said = _written_closures(tree)
        joints, motors = _with_motors(tree, closures)
        robot = _closed(tree, joints, closures, file).noted(*notes, *said, *motors)
        return _without_motors_of_base(without_idle_pins(robot), tree)


def _file(tree: UrdfTree, source: str) -> RobotFile:
    parts = [part for joint in tree.root.findall("joint") for part in joint]
    lengths, angles = (all_numbers((part for part in parts if part.tag == "origin"), [key]) for key in ("xyz", "rpy"))
    angles += all_numbers((part for part in parts if part.tag == "axis"), ["xyz"])
    # roll, pitch, yaw and the direction of the axis turn a joint
    rounding = replace(digits_of(lengths), turn=4 * digits_of(angles).half_unit(1.0))
    notes = (*_masses(tree.root, tree.frames), *tree.notes)
    stated = lumped((tree.frames[name], body) for name, body in _bodies(tree.root) if name in tree.frames)
    return RobotFile(source, notes, inertias=tuple(stated.items()) if any(stated.values()) else (), rounding=rounding)


def _closed(tree: UrdfTree, joints: Sequence[Joint], closures: Sequence[Closure], file: RobotFile) -> Robot:
    file = replace(file, home_given=not closures)
    return Robot(tree.name, tuple(joints), (), tuple(closures), tree.couplings, file=file)


def _with_motors(tree: UrdfTree, closures: Sequence[Closure]) -> tuple[Sequence[Joint], Sequence[str]]:
    """Decide which joints of loops have motors, with a note: those with a transmission, or the first of each branch."""
    if not closures:
        return tree.joints, ()
    carriers: dict[str, set[str]] = {GROUND: set()}
    for joint in tree.joints:
        carriers[joint.name] = carriers[joint.antecedent] | {joint.name}
    branches = [carriers[tie.a.body] ^ carriers[tie.b.body] for tie in closures]
    looped = set[str]().union(*branches)
    before = {joint.name: joint.antecedent for joint in tree.joints}
    motors = driven_joints(tree.root) & looped
    why = "as their transmissions say"
    if not motors:
        motors = {joint for branch in branches for joint in branch if before[joint] not in branch}
        why = "as they are the first of each branch, and the file has no transmissions of them"
    passive = (looped - motors) | {joint.name for joint in tree.joints if not joint.actuated}
    names = [joint.name for joint in tree.joints if joint.name in looped - passive]
    note = (
        f"of the joints in the loops, {listed(names)} have motors, {why}; if others have, name those under 'name_mot' "
        "in a YAML file of the same name beside this one"
    )
    return [replace(joint, actuated=joint.name not in passive) for joint in tree.joints], [note]


def _without_motors_of_base(robot: Robot, tree: UrdfTree) -> Robot:
    """Remove the motors, unknown in a URDF, of six joints that carry all others and represent a floating base.

    The six have none if all other joints have a transmission (or ros2_control interface), or else an effort limit, or
    links with mass, and the six do not.
    """
    if len(robot.joints) <= 6:
        return robot
    joints = tuple(replace(joint, actuated=k >= 6) for k, joint in enumerate(robot.joints))
    six = drawn_base(replace(robot, joints=joints))
    rest = set(robot.actuated).difference(six)
    driven = driven_joints(tree.root)
    if not six or not rest:
        return robot
    if rest <= driven:
        drawn = driven.isdisjoint(six)
    else:
        strong = {joint.name for joint in robot.joints if joint.limits.effort}
        links = (link for link in tree.root.findall("link") if any(all_numbers(link.iter("mass"), ["value"])))
        heavy = {tree.frames[name].body for link in links if (name := link.get("name", "")) in tree.frames}
        drawn = (rest <= strong and strong.isdisjoint(six)) or (rest <= heavy and heavy.isdisjoint(six[:-1]))
    if not drawn:
        return robot
    joints = tuple(replace(joint, actuated=joint.actuated and joint.name not in six) for joint in robot.joints)
    return replace(robot, joints=joints)


class _Loops(Keys):
    closed_loop: tuple[tuple[str, str], ...] = ()
    type: tuple[Literal["3d", "6d"], ...] = ()
    name_mot: list[str]
    joint_name: tuple[str, ...] = ()
    joint_type: tuple[Literal["SPHERICAL", "CARDAN", "UJOINT_XY", "UJOINT_YZ", "UJOINT_ZX", "FIXED"], ...] = ()

    @field_validator("type", mode="before")
    @classmethod
    def _lower(cls, types: object) -> object:
        if not isinstance(types, list):
            return types
        return [kind.lower() if isinstance(kind, str) else kind for kind in types]


def read_urdf_with_loops(urdf: Path, loops: Path) -> Robot:
    """Read a robot from a URDF file and the YAML file beside it; only the joints in ``name_mot`` are actuated."""
    document = read_yaml(loops)
    entry = validate(_Loops, document)
    for key, other in (("type", "closed_loop"), ("joint_type", "joint_name")):
        count = len(getattr(entry, key))
        needed = len(getattr(entry, other))
        if count != needed and (count or key == "joint_type"):
            raise document.error(
                (key,), f"{count} types are written for {needed} entries of {other}; write one for each"
            )
    tree = read_urdf_tree(urdf, dict(zip(entry.joint_name, entry.joint_type, strict=True)))
    with errors_at(urdf):
        file = _file(tree, f"{urdf.name} with {loops.name}")
    names = [joint.name for joint in tree.joints]
    for key, known in (("name_mot", names), ("joint_name", tree.frames)):
        for position, name in enumerate(getattr(entry, key)):
            if name not in known:
                raise document.error((key, position), unknown(f"joint '{name}'", name, names))
    types = entry.type or ("6d",) * len(entry.closed_loop)
    closures = list[Closure]()
    for k, (kind, pair) in enumerate(zip(types, entry.closed_loop, strict=True)):
        for position, name in enumerate(pair):
            if name not in tree.frames:
                raise document.error(("closed_loop", k, position), unknown(f"frame '{name}'", name, tree.frames))
        a, b = (tree.frames[name] for name in pair)
        closures.append(Closure("connect" if kind == "3d" else "weld", a, b))
    with errors_at(document.path):
        joints = [replace(joint, actuated=joint.name in entry.name_mot) for joint in tree.joints]
        closures, said = (closures, list[str]()) if closures else _written_closures(tree)
        return without_idle_pins(_closed(tree, joints, closures, file).noted(*said))


def _written_closures(tree: UrdfTree) -> tuple[list[Closure], list[str]]:
    """Read the loop closures of a file, with notes; refuse other closing elements by name."""
    closures, notes, known = list[Closure](), list[str](), {WORLD, *tree.frames}
    for element in tree.root:
        # without a namespace, and with the colon of an undeclared prefix
        written = str(element.tag).rpartition("}")[2].replace(".", ":")
        what = f"line {line_of(element)}: <{written}> '{element.get('name', '')}'".removesuffix(" ''")
        match written.rpartition(":")[2]:
            case "loop" | "loop_joint":
                closures += _joined(element, [_side(tree, part, what) for part in element if part.tag in SIDES], what)
            case "ball_constraint":
                closures += _joined(element, [_side_of_ball(tree, element, k, what) for k in ("A", "B")], what)
            case "gazebo":
                for joint in element.findall("joint"):
                    if not {(joint.findtext(side) or "").strip() for side in ("parent", "child")} <= known:
                        continue  # it joins a link that Gazebo adds
                    what = f"line {line_of(joint)}: <joint> '{joint.get('name', '')}' of <gazebo>"
                    parent, child = sides = _sides_in_gazebo(tree, joint, what)
                    if parent.body == child.body:
                        continue  # it bolts the base down
                    closures += _joined(joint, sides, what)
                    x, y, z = parent.placement.position
                    notes.append(
                        f"{what} joins '{child.body}' to the point {x:zg} {y:zg} {z:zg} m of '{parent.body}', where it "
                        "is while all joints are at zero, as in Gazebo"
                    )
            case "mujoco" if element.find("equality") is not None:
                raise GtauError(f"{what}: its <equality> {BY_HAND}.")
            case tag if element.tag != "joint" and UNREAD.fullmatch(tag):
                raise GtauError(f"{what} {BY_HAND}.")
    links = (link.get("name", "") for link in tree.root.findall("link"))
    if len(frames := [link for link in links if link.startswith(CLOSING)]) > 1:
        raise GtauError(f"what the frames {listed(frames)} of onshape-to-robot close {BY_HAND}.")
    return closures, notes


def _joined(element: Element, sides: Sequence[Attachment], what: str) -> list[Closure]:
    kind = element.get("type", "ball")
    if len(sides) != 2 or kind not in (*POINTS, "fixed"):
        raise GtauError(f"{what}, of type '{kind}' and between {len(sides)} links, {BY_HAND}.")
    if kind == "fixed":
        return [Closure("weld", *sides)]
    axis = np.array(axis_of(element, what))
    points = [pose_of(np.eye(3), APART * k * axis) for k in range(POINTS[kind])]
    return [Closure("connect", *(side.at(point) for side in sides)) for point in points]


def _on(tree: UrdfTree, link: str, placement: Placement, what: str) -> Attachment:
    frames = {WORLD: Attachment(GROUND), **tree.frames}
    if link not in frames:
        raise GtauError(f"{what}: {unknown(f'link {link!r}', link, frames)}.")
    return frames[link].at(placement)


def _side(tree: UrdfTree, part: Element, what: str) -> Attachment:
    origin = part.find("origin")
    placement, _ = origin_of(part if origin is None else origin, what)
    return _on(tree, attribute(part, "link", f"{what}: <{part.tag}>"), placement, what)


def _side_of_ball(tree: UrdfTree, element: Element, side: str, what: str) -> Attachment:
    values = {str(part.tag).rpartition("_constraint_")[2]: part.get("name", part.get("value", "")) for part in element}
    point = f"p_{side}{'PQ'[side == 'B']}"
    x, y, z = numbers(values.get(point, ""), 3, f"{point} of {what}")
    return _on(tree, values.get(f"body_{side}", ""), Pose((x, y, z)), what)


def _sides_in_gazebo(tree: UrdfTree, joint: Element, what: str) -> list[Attachment]:
    """Place the two frames of a joint, whose pose is in its child, as Gazebo does with all other joints at zero."""
    if joint.find("pose[@relative_to]") is not None or joint.find("axis/xyz[@expressed_in]") is not None:
        raise GtauError(f"{what}, placed in another frame than its child's, {BY_HAND}.")
    x, y, z, roll, pitch, yaw = numbers(joint.findtext("pose") or "0 0 0 0 0 0", 6, f"pose of {what}")
    pose, _ = exact_placement(Pose((x, y, z), (roll, pitch, yaw)))
    child, parent = (
        _on(tree, (joint.findtext(tag) or "").strip(), placement, what)
        for tag, placement in (("child", pose), ("parent", Pose()))
    )
    drawn: dict[str, Placement] = {GROUND: Pose()}
    for moving in tree.joints:
        drawn[moving.name] = compose(drawn[moving.antecedent], moving.placement)
    there = compose(drawn[child.body], child.placement)
    R = drawn[parent.body].rotation.T
    from_parent = pose_of(R @ there.rotation, R @ (there.position - drawn[parent.body].position))
    return [replace(parent, placement=from_parent), child]


# Masses and inertias, to compare them with the identified ones, or as priors


def _bodies(root: Element) -> Iterator[tuple[str, RigidBody]]:
    for link in root.findall("link"):
        if (inertial := link.find("inertial")) is not None:
            yield link.get("name", ""), _body(link.get("name", ""), inertial)


def _body(name: str, inertial: Element) -> RigidBody:
    def read(tag: str, key: str, default: str, what: str) -> list[float]:
        element, count = inertial.find(tag), len(default.split()) or 1
        if element is None:
            return [0.0] * count
        return numbers(element.get(key, default), count, f"{what} of link '{name}'")

    (mass,) = read("mass", "value", "", "mass")
    moments = [read("inertia", f"i{axes}", "0", f"i{axes}")[0] for axes in ("xx", "yy", "zz", "xy", "xz", "yz")]
    xyz, rpy = (read("origin", key, "0 0 0", f"inertial {key}") for key in ("xyz", "rpy"))
    rotation = Pose(rpy=(rpy[0], rpy[1], rpy[2])).rotation
    return RigidBody(mass, np.array(xyz), rotation @ np.array(moments)[TENSOR] @ rotation.T)


def _masses(root: Element, frames: Mapping[str, Attachment]) -> Iterator[str]:
    """Note implausible masses and inertias of a URDF file; ``frames`` say which body carries each link."""
    links = {link.get("name", ""): link for link in root.findall("link")}
    bodies = dict(_bodies(root))
    carried = {link: at.body for link, at in frames.items() if link in links and at.body != GROUND}
    odd = []
    for name in bodies:
        if name in carried:
            odd += _impossible(f"link '{name}'", links[name], bodies[name].inertia)
    masses = {name: bodies[name].mass if name in bodies else 0.0 for name in links}
    typical = float(np.median([mass for mass in masses.values() if mass > 1e-6] or [1.0]))
    for name, mass in masses.items():
        if mass < 0.0 or mass > max(HEAVIEST * typical, HEAVIEST):
            odd.append(f"link '{name}' (line {line_of(links[name])}) weighs {mass:,.0f} kg")
    if odd:
        yield (
            f"physically impossible masses and inertias: {some_of(odd, SHOWN, '; ')}; they are identified, not read, "
            "but correct them before you use the file elsewhere"
        )
    moved: dict[str, list[str]] = {}
    for link, joint in carried.items():
        moved.setdefault(joint, []).append(link)
    light = [group[0] for group in moved.values() if not any(masses[link] for link in group)]
    if light and any(masses.values()):  # else the file has no masses at all
        names = some_of([f"'{name}' (line {line_of(links[name])})" for name in light], SHOWN)
        yield (
            f"these links have no mass in the file, though a joint moves them: {names}; here they have parameters "
            "all the same, and where one is really massless, write 'parameters: none' for it in a saved robot file"
        )


def _impossible(name: str, element: Element, tensor: np.ndarray) -> list[str]:
    """Report impossible moments of an inertia (3, 3), kg m2: negative ones, or one above the sum of the others."""
    moments = np.linalg.eigvalsh(tensor)
    if np.abs(moments).max() < TINY:
        return []
    shown = ", ".join(f"{moment:.3g}" for moment in moments)
    where = f"{name} (line {line_of(element)}) has the principal moments {shown} kg m2"
    if moments[0] < -SLACK * abs(moments[2]):
        return [f"{where}, one of them negative"]
    if moments[2] > (1.0 + SLACK) * (moments[0] + moments[1]):
        return [f"{where}, the largest above the sum of the others"]
    return []
