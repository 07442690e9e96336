"""URDF files of serial arms and trees: their geometry and limits.

Masses and inertias in the file are left aside: they are what is to be identified.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import atan2, cos, isfinite, pi, sin
from pathlib import Path
from typing import Literal
from xml.etree.ElementTree import Element, ParseError

import numpy as np

from idim.errors import IdimError
from idim.robots.robot import GROUND, Joint, Limits, Pose, Robot

MAX_BYTES = 1 << 24
ROUNDING = 1e-10  # exporters write pi/2 as 1.57079632679 and zero as 2.8e-17
Kind = Literal["revolute", "prismatic", "fixed"]
KINDS: dict[str, Kind] = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic", "fixed": "fixed"}


@dataclass(frozen=True)
class _Edge:
    """A URDF joint as it stands in the file."""

    name: str
    kind: Kind
    parent: str
    child: str
    origin: Pose
    element: Element


def read_urdf(path: str | Path) -> Robot:
    """Read a robot from a URDF file.

    Links that hang on fixed joints become part of the link that carries them. Joints stand depth first in the order
    of the file; each keeps its name, and its link bears the name too. Gravity is along -z of the root link. Angles
    within 1e-10 rad of a multiple of pi/2, and lengths below 1e-10 m, are taken as exact.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    Robot
        All joints actuated; positions in rad or m. A velocity or effort limit of 0 counts as not known.

    Raises
    ------
    IdimError
        The file cannot be read, is no URDF, or its links are no tree of revolute, continuous, prismatic and fixed
        joints.
    """
    path = Path(path)
    try:
        root = _parse(path)
        edges = [_edge(element) for element in root.findall("joint")]
        links = [_attribute(element, "name", "a link") for element in root.findall("link")]
        joints = tuple(_moving(_depth_first(links, edges)))
        return Robot(root.get("name") or path.stem, joints, source=path.name)
    except IdimError as error:
        raise IdimError(f"{path}: {error}") from None


def _parse(path: Path) -> Element:
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import fromstring

    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise IdimError(
            f"the file cannot be read ({(error.strerror or str(error)).lower()}); check the path."
        ) from None
    if len(content) > MAX_BYTES:
        raise IdimError("the file is larger than 16 MiB; a URDF is text without meshes, so check the path.")
    try:
        root: Element = fromstring(content, forbid_dtd=True)
    except DefusedXmlException:
        raise IdimError("the file declares entities or a document type; write their values out.") from None
    except (ParseError, ValueError, LookupError) as error:
        raise IdimError(f"this is not valid XML ({error}); correct the file.") from None
    if root.tag != "robot":
        raise IdimError(f"the outermost element is <{root.tag}>, not <robot>; give a URDF file.")
    if any("/xacro}" in str(element.tag) for element in root.iter()):
        raise IdimError("the file holds xacro macros; expand it with the program xacro first.")
    return root


def _edge(element: Element) -> _Edge:
    name = _attribute(element, "name", "a joint")
    kind = _attribute(element, "type", f"joint '{name}'")
    if kind not in KINDS:
        raise IdimError(
            f"joint '{name}' is {kind}; only revolute, continuous, prismatic and fixed joints are read, "
            "so build it from these or describe the robot in a robot file (YAML)."
        )
    if element.find("mimic") is not None:
        raise IdimError(
            f"joint '{name}' mimics another; make it fixed, or describe the mechanism with closures in a robot file."
        )
    ends = []
    for tag in ("parent", "child"):
        end = element.find(tag)
        if end is None:
            raise IdimError(f"joint '{name}' has no <{tag} link=...>; add it.")
        ends.append(_attribute(end, "link", f"<{tag}> of joint '{name}'"))
    return _Edge(name, KINDS[kind], ends[0], ends[1], _origin(element, name), element)


def _depth_first(links: list[str], edges: list[_Edge]) -> list[_Edge]:
    """The joints from the root outwards, in the order of the file; refuses what is not a tree."""
    for kind, names in (("link", links), ("joint", [edge.name for edge in edges])):
        if repeated := _repeated(names):
            raise IdimError(f"two {kind}s are called '{repeated}'; give each its own name.")
    known = set(links)
    followers: dict[str, list[_Edge]] = {link: [] for link in links}
    for edge in edges:
        for link in (edge.parent, edge.child):
            if link not in known:
                raise IdimError(f"joint '{edge.name}' refers to the link '{link}', which is not in the file; add it.")
        followers[edge.parent].append(edge)
    children = [edge.child for edge in edges]
    if shared := _repeated(children):
        raise IdimError(
            f"link '{shared}' is the child of two joints; a URDF is a tree, so describe loops "
            "with closures in a robot file (YAML)."
        )
    roots = sorted(known.difference(children))
    if len(roots) > 1:
        raise IdimError(
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
        raise IdimError(
            f"joint '{lost.name}' is in a loop of parents and children; a URDF is a tree, so correct its parent."
        )
    return ordered


def _repeated(names: list[str]) -> str | None:
    return next((name for name, count in Counter(names).items() if count > 1), None)


def _moving(ordered: list[_Edge]) -> Iterator[Joint]:
    """The joints that move, each placed in the frame of the last one before it that moves."""
    carried: dict[str, tuple[str, Pose]] = {}
    for edge in ordered:
        antecedent, placement = carried.get(edge.parent, (GROUND, Pose()))
        placement = _compose(placement, edge.origin)
        if edge.kind == "fixed":
            carried[edge.child] = (antecedent, placement)
            continue
        carried[edge.child] = (edge.name, Pose())
        yield Joint(
            name=edge.name,
            antecedent=antecedent,
            kind=edge.kind,
            placement=placement,
            axis=_axis(edge),
            limits=_limits(edge),
        )


def _compose(first: Pose, second: Pose) -> Pose:
    """The pose `second`, given in the frame `first`, in the frame where `first` is given."""
    if first == Pose():
        return second
    rotation = first.rotation @ second.rotation
    # Whatever the yaw where the angles are degenerate, what is left over then gives matching pitch and roll.
    yaw = atan2(rotation[1, 0], rotation[0, 0])
    c, s = cos(yaw), sin(yaw)
    pitch = atan2(-rotation[2, 0], c * rotation[0, 0] + s * rotation[1, 0])
    roll = atan2(s * rotation[0, 2] - c * rotation[1, 2], c * rotation[1, 1] - s * rotation[0, 1])
    return _pose(first.position + first.rotation @ second.position, (roll, pitch, yaw))


def _pose(xyz: Iterable[float], rpy: Iterable[float]) -> Pose:
    roll, pitch, yaw = (_exact(angle, pi / 2) for angle in rpy)
    x, y, z = (_exact(length) for length in xyz)
    return Pose((x, y, z), (roll, pitch, yaw))


def _exact(number: float, unit: float = 1.0) -> float:
    """The multiple of `unit` in place of a number that only rounding keeps from it."""
    multiple = round(number / unit) * unit
    return multiple if abs(number - multiple) < ROUNDING else float(number)


def _origin(element: Element, name: str) -> Pose:
    origin = element.find("origin")
    if origin is None:
        return Pose()
    xyz, rpy = (_numbers(origin.get(key, "0 0 0"), 3, f"{key} of joint '{name}'") for key in ("xyz", "rpy"))
    return _pose(xyz, rpy)


def _axis(edge: _Edge) -> tuple[float, float, float]:
    axis = edge.element.find("axis")
    if axis is None:
        return (1.0, 0.0, 0.0)  # as the URDF specification says
    vector = np.array(_numbers(axis.get("xyz", "1 0 0"), 3, f"axis of joint '{edge.name}'"))
    length = float(np.linalg.norm(vector))
    if length < ROUNDING:
        raise IdimError(f"the axis of joint '{edge.name}' is zero; give it a direction.")
    x, y, z = (_exact(component) for component in vector / length)
    return (x, y, z)


def _limits(edge: _Edge) -> Limits:
    limit = edge.element.find("limit")
    if limit is None:
        return Limits()
    values = {
        key: _numbers(text, 1, f"{key} of joint '{edge.name}'")[0]
        for key in ("lower", "upper", "velocity", "effort")
        if (text := limit.get(key)) is not None
    }
    endless = edge.element.get("type") == "continuous" or not values.keys() & {"lower", "upper"}
    return Limits(
        position=None if endless else (values.get("lower", 0.0), values.get("upper", 0.0)),
        velocity=values.get("velocity") or None,
        effort=values.get("effort") or None,
    )


def _numbers(text: str, count: int, what: str) -> list[float]:
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not all(map(isfinite, values)):
        numbers = "a number" if count == 1 else f"{count} numbers"
        raise IdimError(f"the {what} is '{text}'; write {numbers}.")
    return values


def _attribute(element: Element, key: str, what: str) -> str:
    value = element.get(key)
    if not value:
        raise IdimError(f'{what} has no {key}; write {key}="...".')
    return value
