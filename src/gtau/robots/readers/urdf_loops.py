"""Loops that a URDF file writes itself, in the elements of several programs.

Read are ``<loop>`` (generalized_rbda), ``<loop_joint>`` (Isaac Sim), ``<drake:ball_constraint>`` and a ``<joint>`` that
Gazebo adds to its model. What ties links otherwise is refused by name: without it the robot would be an open tree.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from xml.etree.ElementTree import Element

import numpy as np

from gtau.documents.validation import unknown
from gtau.errors import GtauError
from gtau.robots.parts import listed
from gtau.robots.placement import compose, exact_placement, pose_of
from gtau.robots.readers.urdf_tree import WORLD, UrdfTree, axis_of, driven_joints, origin_of
from gtau.robots.readers.xml_document import attribute, line_of, numbers
from gtau.robots.robot import GROUND, Attachment, Closure, Joint, Placement, Pose

POINTS = {"spherical": 1, "ball": 1, "revolute": 2, "continuous": 2}
"""Number of points of its axis that a joint ties: two make a hinge."""
APART = 0.1  # m, between two points of an axis
SIDES = ("predecessor", "successor", "link1", "link2")
UNREAD = re.compile(r"constraint|coupling|\w+_constraint|linear_bushing\w*|joint")
"""Elements, without their prefix, that tie links and are not read."""
CLOSING = "closing_"  # links that onshape-to-robot writes in pairs where a loop is cut
BY_HAND = (
    "is not read; write the frames that it ties under 'closed_loop', and the motors under 'name_mot', in a YAML file "
    "of the same name beside this one, or describe the robot in a robot file"
)


def written_closures(tree: UrdfTree) -> tuple[list[Closure], list[str]]:
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
    """Make the closures of a joint between two frames."""
    kind = element.get("type", "ball")
    if len(sides) != 2 or kind not in (*POINTS, "fixed"):
        raise GtauError(f"{what}, of type '{kind}' and between {len(sides)} links, {BY_HAND}.")
    if kind == "fixed":
        return [Closure("weld", *sides)]
    points = [pose_of(np.eye(3), APART * k * np.array(axis_of(element, what))) for k in range(POINTS[kind])]
    return [
        Closure("connect", *(replace(it, placement=compose(it.placement, point)) for it in sides)) for point in points
    ]


def _on(tree: UrdfTree, link: str, placement: Placement, what: str) -> Attachment:
    frames = {WORLD: Attachment(GROUND), **tree.frames}
    if link not in frames:
        raise GtauError(f"{what}: {unknown(f'link {link!r}', link, frames)}.")
    return Attachment(frames[link].body, compose(frames[link].placement, placement))


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
    there, R = compose(drawn[child.body], child.placement), drawn[parent.body].rotation.T
    from_parent = pose_of(R @ there.rotation, R @ (there.position - drawn[parent.body].position))
    return [replace(parent, placement=from_parent), child]


def joints_of_loops(tree: UrdfTree, closures: Sequence[Closure]) -> tuple[tuple[Joint, ...], Sequence[str]]:
    """Decide which joints of loops have motors, with a note: those with a transmission, or the first of each branch."""
    carriers: dict[str, set[str]] = {GROUND: set()}
    for joint in tree.joints:
        carriers[joint.name] = carriers[joint.antecedent] | {joint.name}
    branches = [carriers[closure.a.body] ^ carriers[closure.b.body] for closure in closures]
    looped, before = set[str]().union(*branches), {joint.name: joint.antecedent for joint in tree.joints}
    motors, why = driven_joints(tree.root) & looped, "as their transmissions say"
    if not motors:
        motors = {joint for branch in branches for joint in branch if before[joint] not in branch}
        why = "as they are the first of each branch, and the file has no transmissions of them"
    passive = (looped - motors) | {joint.name for joint in tree.joints if not joint.actuated}
    joints = tuple(replace(joint, actuated=joint.name not in passive) for joint in tree.joints)
    names = [joint.name for joint in joints if joint.name in looped - passive]
    note = (
        f"of the joints in the loops, {listed(names)} have motors, {why}; if others have, name those under 'name_mot' "
        "in a YAML file of the same name beside this one"
    )
    return joints, [note] * bool(closures)
