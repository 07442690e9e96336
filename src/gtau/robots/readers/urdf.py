"""URDF files: geometry and limits of serial arms and trees, and of loops described beside them.

Masses and inertias in the file are kept for comparison with the identified ones. Loops are described in a YAML file, as
in the Gepetto models of parallel robots: ``closed_loop`` lists pairs of frames that a loop ties, ``type`` their kind
(``3d`` or ``6d``, the default), ``name_mot`` the motors, and ``joint_name`` with ``joint_type`` joints that a URDF
cannot describe.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, field_validator

from gtau.documents.validation import unknown, validate
from gtau.documents.yaml_document import Document, read_yaml
from gtau.errors import GtauError
from gtau.robots.floating import drawn_base
from gtau.robots.parts import without_idle_pins
from gtau.robots.readers.source import BaseChoice
from gtau.robots.readers.urdf_loops import joints_of_loops, written_closures
from gtau.robots.readers.urdf_tree import UrdfTree, driven_joints, read_urdf_tree
from gtau.robots.readers.xml_document import decimals
from gtau.robots.robot import GROUND, Attachment, Closure, Joint, Robot, RobotFile


def read_urdf(path: str | Path, base: BaseChoice = None) -> Robot:
    """Read a robot from a URDF file.

    Links on fixed joints become part of their carriers. Joints are listed depth first in the order of the file; each
    keeps its name, and its link has the same name. A joint that mimics another is passive and coupled to it. Gravity is
    along -z of the root link. Angles within 1e-10 rad of a multiple of pi/2, and lengths below 1e-10 m, are exact;
    rounded angles (1.5708) are replaced by exact ones, with a note. A velocity or effort limit of 0 means unknown. With
    a ``base`` a floating joint is fixed, and its child becomes the ground, which may float.
    """
    path = Path(path)
    tree = read_urdf_tree(path, {}, base)
    notes = tree.file.notes
    if base is None and sum(joint.antecedent == GROUND for joint in tree.joints) > 1:
        notes += (
            "the root link was taken as fixed, as a URDF does not say whether it floats; write --base floating "
            "(base: floating) if it moved",
        )
    try:
        closures, said = written_closures(tree)
        joints, motors = joints_of_loops(tree, closures)
        robot = _closed(tree, joints, closures, replace(tree.file, notes=(*notes, *said, *motors)))
        return _without_motors_of_base(robot, tree)
    except GtauError as error:
        raise type(error)(f"{path}: {error}") from None


def _without_motors_of_base(robot: Robot, tree: UrdfTree) -> Robot:
    """Remove the motors of six joints that carry all others and represent a floating base.

    A URDF does not define which joints have motors; ``robot`` has one at every joint that mimics no other. The six have
    none if all other joints have a transmission (or ros2_control interface), an effort limit, or links with mass, and
    the six do not. Transmissions take precedence.
    """
    if len(robot.joints) <= 6:
        return robot
    joints = tuple(replace(joint, actuated=k >= 6) for k, joint in enumerate(robot.joints))
    six = drawn_base(replace(robot, joints=joints))
    rest = set(robot.actuated).difference(six)
    if not six or not rest:
        return robot
    driven = driven_joints(tree.root)
    strong = {joint.name for joint in robot.joints if joint.limits.effort}
    masses = {link.get("name", ""): link.find("inertial/mass") for link in tree.root.findall("link")}
    heavy = {
        tree.frames[name].body
        for name, mass in masses.items()
        if name in tree.frames and mass is not None and any(decimals(mass.get("value", "")) or [])
    }
    if rest <= driven:
        drawn = driven.isdisjoint(six)
    else:
        drawn = (rest <= strong and strong.isdisjoint(six)) or (rest <= heavy and heavy.isdisjoint(six[:-1]))
    if not drawn:
        return robot
    joints = tuple(replace(joint, actuated=joint.actuated and joint.name not in six) for joint in robot.joints)
    return replace(robot, joints=joints)


class _Loops(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    closed_loop: list[tuple[str, str]] = []
    type: list[Literal["3d", "6d"]] = []
    name_mot: list[str]
    joint_name: list[str] = []
    joint_type: list[Literal["SPHERICAL", "CARDAN", "UJOINT_XY", "UJOINT_YZ", "UJOINT_ZX", "FIXED"]] = []

    @field_validator("type", mode="before")
    @classmethod
    def _lower(cls, types: object) -> object:
        if not isinstance(types, list):
            return types
        return [kind.lower() if isinstance(kind, str) else kind for kind in types]


def read_urdf_with_loops(urdf: str | Path, loops: str | Path) -> Robot:
    """Read a robot from a URDF file and the YAML file beside it; only the joints in ``name_mot`` are actuated.

    The tree is read as in :func:`read_urdf`. One of two coaxial pins at a loop is locked, with a note.
    """
    document = read_yaml(loops)
    entry = validate(_Loops, document)
    for key, other in (("type", "closed_loop"), ("joint_type", "joint_name")):
        count, needed = len(getattr(entry, key)), len(getattr(entry, other))
        if count != needed and (count or key == "joint_type"):
            raise document.error(
                (key,), f"{count} types are written for {needed} entries of {other}; write one for each"
            )
    tree = read_urdf_tree(Path(urdf), dict(zip(entry.joint_name, entry.joint_type, strict=True)))
    names = [joint.name for joint in tree.joints]
    for key, known in (("name_mot", names), ("joint_name", tree.frames)):
        for position, name in enumerate(getattr(entry, key)):
            if name not in known:
                raise document.error((key, position), unknown(f"joint '{name}'", name, names))
    types = entry.type or ["6d"] * len(entry.closed_loop)
    try:
        closures = [_closure(document, tree, k, types[k], pair) for k, pair in enumerate(entry.closed_loop)]
        joints = tuple(replace(joint, actuated=joint.name in entry.name_mot) for joint in tree.joints)
        closures, said = (closures, []) if closures else written_closures(tree)
        source, notes = f"{Path(urdf).name} with {Path(loops).name}", (*tree.file.notes, *said)
        file = replace(tree.file, source=source, notes=notes)
        return _closed(tree, joints, closures, file)
    except GtauError as error:
        raise error if str(error).startswith(str(document.path)) else GtauError(f"{document.path}: {error}") from None


def _closed(tree: UrdfTree, joints: tuple[Joint, ...], closures: list[Closure], file: RobotFile) -> Robot:
    file = replace(file, home_given=not closures)
    return without_idle_pins(Robot(tree.name, joints, (), tuple(closures), tree.couplings, file=file))


def _closure(document: Document, tree: UrdfTree, k: int, kind: str, pair: tuple[str, str]) -> Closure:
    ends: list[Attachment] = []
    for position, name in enumerate(pair):
        if name not in tree.frames:
            raise document.error(("closed_loop", k, position), unknown(f"frame '{name}'", name, tree.frames))
        ends.append(tree.frames[name])
    return Closure("connect" if kind == "3d" else "weld", *ends)
