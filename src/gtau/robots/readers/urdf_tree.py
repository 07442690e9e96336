"""The tree of a URDF file: joints with their limits, frames of links, and mimic joints."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from gtau.documents.markup import LARGEST, attribute, decimals, line_of, numbers, position_limits, read_xml
from gtau.documents.validation import some_of
from gtau.errors import GtauError, errors_at
from gtau.robots.geometry import turning
from gtau.robots.placement import ROUNDING, exact_placement, in_degrees, rounded, short_angles_note
from gtau.robots.readers.source import BASE_ADVICE, FLOATING, BaseChoice
from gtau.robots.robot import GROUND, Attachment, Coupling, Joint, JointKind, Limits, Placement, Pose, refuse_many

LOOSE = ("floating", "planar")
WORLD = "world"  # a link that files for Drake need not declare
TURNS = {"SPHERICAL": "xyz", "CARDAN": "xy", "UJOINT_XY": "xy", "UJOINT_YZ": "yz", "UJOINT_ZX": "zx"}
"""Axes, in turn, of joints that a URDF cannot describe."""
KINDS: dict[str, JointKind | None] = {
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
    "fixed": None,
}


@dataclass(frozen=True)
class _Edge:
    name: str
    kind: JointKind | None  # None where nothing moves
    parent: str
    child: str
    origin: Placement
    short: float  # largest change (rad) of an angle of its origin
    element: Element


@dataclass(frozen=True)
class UrdfTree:
    """Tree of a URDF file; ``frames`` of all links and, as in Pinocchio the same, of the joints that move them."""

    name: str
    joints: tuple[Joint, ...]
    couplings: tuple[Coupling, ...]
    frames: Mapping[str, Attachment]
    root: Element
    notes: list[str]


def read_urdf_tree(path: Path, types: Mapping[str, str], base: BaseChoice = None) -> UrdfTree:
    """Read the tree of a URDF file, with the joints in ``types`` read as FIXED or as one of ``TURNS``.

    A spherical joint becomes three revolute ones, about x, y and z, a universal joint two, with massless links in
    between; the last one has the joint's name.
    """
    with errors_at(path):
        root = read_xml(path)
        if root.tag != "robot":
            raise GtauError(f"the outermost element is <{root.tag}>, not <robot>; give a URDF file.")
        if any("/xacro}" in str(element.tag) or str(element.tag).startswith("xacro.") for element in root.iter()):
            raise GtauError("the file holds xacro macros; end its name in .xacro, so that they are expanded.")
        refuse_many(len(root.findall("joint")), "joints")
        edges = [_edge(element, base) for element in root.findall("joint")]
        links = [attribute(element, "name", "a link") for element in root.findall("link")]
        links += [WORLD] * (WORLD not in links and any(edge.parent == WORLD for edge in edges))
        ordered = _depth_first(links, edges)
        first = [edge.name for edge in ordered if edge.parent == ordered[0].parent]
        for edge in ordered if base == FLOATING else ():
            if edge.element.get("type") in LOOSE and first != [edge.name]:
                raise GtauError(
                    f"joint '{edge.name}' floats and does not carry the whole robot; give the file of the robot alone."
                )
        joints, frames = _moving(ordered, types)
        couplings = [coupling for edge in ordered if (coupling := _mimic(edge))]
        moving = {joint.name for joint in joints}
        in_gazebo = _mimics_of_gazebo(root, moving - {tie.joint for tie in couplings})
        couplings += in_gazebo
        _check_couplings(couplings, moving)
        slaves = {tie.joint for tie in couplings}
        joints = [replace(joint, actuated=joint.name not in slaves) for joint in joints]
        empty = ", ".join(filter(None, (_limits(edge)[1] for edge in ordered if edge.kind is not None)))
        notes = [f"empty position limits were ignored: joint {empty}"] if empty else []
        notes += _transmission_notes(root, [joint.name for joint in joints if joint.actuated])
        notes += short_angles_note({edge.name: edge.short for edge in ordered})
        if in_gazebo:
            names = some_of([f"'{coupling.joint}' to '{coupling.ratios[0][0]}'" for coupling in in_gazebo], 4)
            notes.append(f"joints coupled as a plugin of <gazebo> moves them, without <mimic>: {names}")
        return UrdfTree(root.get("name") or path.stem, tuple(joints), tuple(couplings), frames, root, notes)


def _edge(element: Element, base: BaseChoice) -> _Edge:
    name = attribute(element, "name", "a joint")
    kind = attribute(element, "type", f"joint '{name}'")
    if kind == "planar" and base == FLOATING:
        raise GtauError(
            f"joint '{name}' is planar, so unknown guiding forces act on the base; fix the base by "
            "'base: fixed', or --base fixed."
        )
    if kind in LOOSE and base is not None:
        kind = "fixed"
    if kind in LOOSE:
        raise GtauError(f"joint '{name}' is {kind}; {BASE_ADVICE}.")
    if kind not in KINDS:
        raise GtauError(
            f"joint '{name}' is {kind}; only revolute, continuous, prismatic and fixed joints are read, "
            "so build it from these or describe the robot in a robot file (YAML)."
        )
    ends = []
    for tag in ("parent", "child"):
        end = element.find(tag)
        if end is None:
            raise GtauError(f"joint '{name}' has no <{tag} link=...>; add it.")
        ends.append(attribute(end, "link", f"<{tag}> of joint '{name}'"))
    return _Edge(name, KINDS[kind], ends[0], ends[1], *origin_of(element.find("origin"), f"joint '{name}'"), element)


def _depth_first(links: list[str], edges: list[_Edge]) -> list[_Edge]:
    """Order the joints from the root outwards, in the order of the file; refuse what is not a tree."""
    for kind, names in (("link", links), ("joint", [edge.name for edge in edges])):
        if repeated := _repeated(names):
            raise GtauError(f"two {kind}s are called '{repeated}'; give each its own name.")
    known = set(links)
    followers: dict[str, list[_Edge]] = {link: [] for link in links}
    for edge in edges:
        for link in (edge.parent, edge.child):
            if link not in known:
                raise GtauError(f"joint '{edge.name}' refers to the link '{link}', which is not in the file; add it.")
        followers[edge.parent].append(edge)
    children = [edge.child for edge in edges]
    if shared := _repeated(children):
        raise GtauError(
            f"link '{shared}' is the child of two joints; a URDF is a tree, so describe loops "
            "with closures in a robot file (YAML)."
        )
    roots = sorted(known.difference(children))
    if len(roots) > 1:
        raise GtauError(
            f"the links {', '.join(roots)} are no joint's child; a robot has one root link, "
            "so join the others to it or remove them."
        )
    ordered: list[_Edge] = []
    pending = [edge for root in roots for edge in reversed(followers[root])]
    while pending:
        edge = pending.pop()
        ordered.append(edge)
        pending += reversed(followers[edge.child])
    if len(ordered) < len(edges):
        lost = next(edge for edge in edges if edge not in ordered)
        raise GtauError(
            f"joint '{lost.name}' is in a loop of parents and children; a URDF is a tree, so correct its parent."
        )
    return ordered


def _repeated(names: list[str]) -> str | None:
    return next((name for name, count in Counter(names).items() if count > 1), None)


def _moving(ordered: list[_Edge], types: Mapping[str, str]) -> tuple[list[Joint], dict[str, Attachment]]:
    """Place each moving joint in the frame of the previous moving one, and attach all frames."""
    joints: list[Joint] = []
    frames: dict[str, Attachment] = {}
    for edge in ordered:
        at = frames.setdefault(edge.parent, Attachment(GROUND)).at(edge.origin)
        kind = types.get(edge.name, edge.kind)
        if kind in ("FIXED", None):
            frames[edge.child] = frames[edge.name] = at
            continue
        if kind in TURNS:
            joints += turning(edge.name, at.body, at.placement, TURNS[kind])
        elif edge.kind:
            axis = axis_of(edge.element, f"joint '{edge.name}'")
            joints.append(Joint(edge.name, at.body, edge.kind, at.placement, axis, limits=_limits(edge)[0]))
        frames[edge.child] = frames[edge.name] = Attachment(edge.name)
    return joints, frames


def _mimic(edge: _Edge) -> Coupling | None:
    mimic = edge.element.find("mimic")
    if mimic is None or edge.kind is None:
        return None
    what = f"<mimic> of joint '{edge.name}'"
    master = attribute(mimic, "joint", what)
    return _coupling(edge.name, master, mimic.get("multiplier", "1"), mimic.get("offset", "0"), what)


def _mimics_of_gazebo(root: Element, free: Collection[str]) -> list[Coupling]:
    """Read couplings of ``free`` joints from Gazebo plugins: ``mimicJoint`` follows ``joint``."""
    couplings = {}
    for plugin in root.iterfind("gazebo/plugin"):
        follower = (plugin.findtext("mimicJoint") or "").strip()
        leader = (plugin.findtext("joint") or plugin.findtext("jointName") or "").strip()
        if leader and follower in free:
            what = f"<plugin> of mimicJoint '{follower}' (line {line_of(plugin)})"
            ratio, offset = plugin.findtext("multiplier") or "1", plugin.findtext("offset") or "0"
            couplings[follower] = _coupling(follower, leader, ratio, offset, what)
    return list(couplings.values())


def _coupling(joint: str, master: str, multiplier: str, offset: str, what: str) -> Coupling:
    (ratio,) = numbers(multiplier, 1, f"multiplier of {what}")
    (shift,) = numbers(offset, 1, f"offset of {what}")
    return Coupling(joint, ((master, ratio),), shift)


def _check_couplings(couplings: Sequence[Coupling], moving: Collection[str]) -> None:
    master = {tie.joint: tie.ratios[0][0] for tie in couplings}
    for joint, leader in master.items():
        if leader not in moving:
            raise GtauError(
                f"joint '{joint}' mimics '{leader}', which is not a joint that moves; correct its "
                "<mimic>, or remove it where the joint has a motor of its own."
            )
    for first in master:
        circle = [first]
        while (following := master.get(circle[-1], "")) not in ("", *circle):
            circle.append(following)
        if following == first:
            raise GtauError(
                f"joint {' mimics '.join(repr(name) for name in (*circle, first))}, so none of them leads; remove the "
                "<mimic> of the one that has the motor."
            )


def _transmission_notes(root: Element, motors: Sequence[str]) -> Iterator[str]:
    """Note gear ratios, which predict the gains but are not geometry, and transmissions that are not read."""
    ratios, shared = [], []
    for transmission in root.iter("transmission"):
        joints = [joint.get("name", "") for joint in transmission.findall("joint")]
        kind = transmission.findtext("type") or transmission.findtext("plugin") or ""
        if "Differential" in kind or "FourBar" in kind:
            shared.append(f"{' and '.join(map(repr, joints))} (line {line_of(transmission)})")
        for reduction in (*transmission.iter("mechanicalReduction"), *transmission.iter("mechanical_reduction")):
            ratio, *_ = decimals(reduction.text or "1") or [1.0]
            if joints and ratio not in (0.0, 1.0):
                ratios.append(f"'{joints[0]}' {ratio:g}")
    if ratios:
        yield (
            f"gear ratios of the file's transmissions: {', '.join(dict.fromkeys(ratios))}; positions and gains are "
            "those at the joint, and with the motors' data sheets they go under 'drives' in the experiment file"
        )
    if shared:
        yield (
            f"differential or four-bar transmissions were not read: {', '.join(shared)}; positions and commands "
            "belong to the joints, and where the motors' are logged, write 'couplings' in a robot file"
        )
    controlled = root.findall("ros2_control/joint")
    driven = driven_joints(root)
    names = {joint.get("name", "") for joint in controlled}
    if names & driven and (idle := [repr(joint) for joint in motors if joint in names - driven]):
        yield (
            f"<ros2_control> has no command for {some_of(idle, 4)}, here taken as driven all the same; hold the "
            "joints that stand still in the logs"
        )


def origin_of(origin: Element | None, what: str) -> tuple[Placement, float]:
    """Read a placement, and the largest change (rad) of a rounded angle in it."""
    if origin is None:
        return Pose(), 0.0
    xyz, rpy = (numbers(origin.get(key, "0 0 0"), 3, f"{key} of {what}") for key in ("xyz", "rpy"))
    if degrees := [angle for angle in rpy if in_degrees(angle)]:
        raise GtauError(
            f"line {line_of(origin)}: rpy of {what} holds {degrees[0]:g}; angles are in rad, so divide it by "
            f"57.2958 if it is in degrees."
        )
    x, y, z, roll, pitch, yaw = *xyz, *rpy
    return exact_placement(Pose((x, y, z), (roll, pitch, yaw)))


def axis_of(element: Element, what: str) -> tuple[float, float, float]:
    """Read the direction of a joint's axis, an attribute, or a text in Gazebo."""
    axis = element.find("axis")
    if axis is None:
        return (1.0, 0.0, 0.0)  # default of the URDF specification
    text = axis.findtext("xyz") or axis.get("xyz") or "1 0 0"
    vector = np.array(numbers(text, 3, f"axis of {what}"))
    length = float(np.linalg.norm(vector))
    if length < ROUNDING:
        raise GtauError(f"the axis of {what} is zero; give it a direction.")
    x, y, z = (rounded(component) for component in vector / length)
    return (x, y, z)


def driven_joints(root: Element) -> set[str]:
    """Find the joints with a transmission, or with a command interface of ros2_control."""
    driven = root.findall(".//transmission/joint") + root.findall(".//ros2_control/joint[command_interface]")
    return {joint.get("name", "") for joint in driven}


def _limits(edge: _Edge) -> tuple[Limits, str]:
    """Read the limits of a joint, and an empty range of its position, which is ignored, as text."""
    limit = edge.element.find("limit")
    if limit is None:
        return Limits(), ""
    low, high, velocity, effort = (
        numbers(limit.get(key, "0"), 1, f"{key} of joint '{edge.name}'", endless=True)[0]
        for key in ("lower", "upper", "velocity", "effort")
    )
    ranged = edge.element.get("type") != "continuous" and not {"lower", "upper"}.isdisjoint(limit.keys())
    limits = Limits(
        position=position_limits(low, high) if ranged else None,
        velocity=velocity if 0.0 < velocity <= LARGEST else None,
        effort=effort if 0.0 < effort <= LARGEST else None,
    )
    return limits, f"'{edge.name}' ({low:g} to {high:g})" if ranged and low >= high else ""
