"""URDF with inertias and friction, new or in the robot's own file, and YAML files for loops and drives beside it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import yaml

from gtau.documents.files import identifier, write_atomically
from gtau.errors import GtauError
from gtau.estimation.results.result import Result
from gtau.export.consistent import (
    ConsistentModel,
    consistent_model,
    difference_note,
    differences,
    friction_comments,
    serial_equivalent,
    term_notes,
    terms_left_out,
    what_is_lost,
)
from gtau.export.exported import Export, Exported, written
from gtau.export.input_file import InputFile, input_file
from gtau.robots.geometry import compose, pose_of, turn
from gtau.robots.parameter import gain_unit, torque_unit, unit_of
from gtau.robots.rigid_body import RigidBody, rigid_body
from gtau.robots.robot import (
    DAMPING,
    GROUND,
    PRELOAD,
    ROTATIONS,
    STIFFNESS,
    TRANSLATIONS,
    Attachment,
    Joint,
    Placement,
    Platform,
    Pose,
    Robot,
    Spring,
)

ROOT = "base"
UNLIMITED = 1e6  # rad, m: the format requires limits of prismatic joints


def export(result: Result, out: Path) -> Exported:
    """Write ``NAME.urdf``, ``NAME.yaml`` where the robot has loops, and ``NAME_drives.yaml`` into ``out``.

    A platform is the end of a chain with one passive joint per degree of freedom, with massless links in between.

    Raises
    ------
    GtauError
        Where the result has no physically consistent parameters, or a joint is coupled to more than one other.
    """
    model = consistent_model(result, "URDF")
    robot, name = result.robot, identifier(result.robot.name)
    texts = {f"{name}.urdf": _text(robot_element(model)), f"{name}_drives.yaml": drives_text(model)}
    if robot.closures:
        texts[f"{name}.yaml"] = _loops_text(robot)
    found, lost = differences(model, model.standard, cubic=True), what_is_lost(robot, "a URDF", name)
    said = (lost,) if lost else ()
    return Exported(written(out, texts), (*said, difference_note(found), *notes(model, name)), found, lost)


def export_into(result: Result, source: Path, out: Path) -> Exported:
    """Write a copy of the URDF ``source`` with identified inertias and friction into ``out``, and the drives beside it.

    Raises
    ------
    GtauError
        Where the result has no physically consistent parameters, or the file is not that of its robot.
    """
    model = consistent_model(result, "URDF")
    if source.suffix.lower() != ".urdf":
        raise GtauError(f"{source} is no URDF; give the .urdf file that the robot came from.")
    file = input_file(source, result.robot)
    carrier = _carriers(file, {joint.name for joint in result.robot.joints})
    lumped = []
    for element in file.root.findall("link"):
        name, inertial = element.get("name", ""), element.find("inertial")
        body, moves = carrier.get(name, (GROUND, False))
        if moves:
            new = inertial_element(rigid_body(model.standard, body))
            ElementTree.indent(new)
            text = ElementTree.tostring(new, encoding="unicode")
            if inertial is None:
                file.insert(element, text)
            else:
                file.replace(inertial, text)
        elif body != GROUND and inertial is not None:
            file.remove(inertial)
            lumped.append(name)
    for joint in file.root.findall("joint"):
        name = joint.get("name", "")
        if name in {each.name for each in result.robot.joints}:
            friction = {"damping": repr(model.of("fv", name)), "friction": repr(model.of("fs", name))}
            dynamics = joint.find("dynamics")
            if dynamics is None:
                file.insert(joint, ElementTree.tostring(Element("dynamics", friction), encoding="unicode"))
            else:
                file.set(dynamics, **friction)
    found = differences(model, model.standard, cubic=True)
    said = [difference_note(found), *notes(model, identifier(result.robot.name))]
    if lumped:
        said.append(
            f"links on fixed joints are part of those that carry them, and have no inertia: {', '.join(lumped)}"
        )
    name = identifier(result.robot.name)
    lost = what_is_lost(result.robot, "a URDF", "the robot's own")
    exported = file.save(out, [lost, *said] if lost else said, found)
    drives = out / f"{name}_drives.yaml"
    write_atomically(drives, drives_text(model))
    return Exported((*exported.files, drives), exported.notes, exported.figures, lost)


def notes(model: ConsistentModel, name: str) -> list[str]:
    """List the quantities missing in the URDF, and where they are written instead."""
    robot = model.result.robot
    sprung = bool(robot.springs) or any(joint.spring is not None for joint in robot.joints)
    springs = " and springs" if sprung else ""
    found = [f"a URDF has no place for drive gains, rotor inertias, offsets{springs}: they are in {name}_drives.yaml"]
    found += [f"friction cubic in speed is in {name}_drives.yaml too"] if model.cubics else []
    return found + term_notes(model, "URDF", terms_left_out(model))


def robot_element(model: ConsistentModel) -> Element:
    """Build the robot as an XML element."""
    robot = model.result.robot
    _check(robot)
    turned = _to_vertical(robot)
    root = Element("robot", name=robot.name)
    root.extend(friction_comments(model))
    SubElement(root, "link", name=ROOT)
    couplings = {coupling.joint: coupling for coupling in robot.couplings}
    for joint in robot.joints:
        _link(root, joint.name, rigid_body(model.standard, joint.name) if joint.has_mass else None)
        placement = compose(turned, joint.placement) if joint.antecedent == GROUND else joint.placement
        element = _joint(root, joint, placement, ROOT if joint.antecedent == GROUND else link(joint.antecedent))
        SubElement(
            element,
            "dynamics",
            damping=_number(model.of("fv", joint.name)),
            friction=_number(model.of("fs", joint.name)),
        )
        if joint.name in couplings:
            (other, ratio), *_ = couplings[joint.name].ratios
            mimic = {"joint": other, "multiplier": _number(ratio), "offset": _number(couplings[joint.name].offset)}
            SubElement(element, "mimic", mimic)
    for platform in robot.platforms:
        _platform(root, platform, turned, rigid_body(model.standard, platform.name))
    for end_name, end in _ends(robot):
        _link(root, link(end_name), None)
        fixed = SubElement(root, "joint", name=end_name, type="fixed")
        placement = compose(turned, end.placement) if end.body == GROUND else end.placement
        _place(fixed, placement, ROOT if end.body == GROUND else link(end.body), link(end_name))
    return root


def link(name: str) -> str:
    """Name of the link of a joint, platform or closure's end, which has its name in gtau."""
    return f"link_{name}"


def _check(robot: Robot) -> None:
    for coupling in robot.couplings:
        if len(coupling.ratios) > 1:
            raise GtauError(
                f"joint '{coupling.joint}' is coupled to {len(coupling.ratios)} joints, and a joint of a URDF mimics "
                "one; export to c instead."
            )


def _to_vertical(robot: Robot) -> Pose:
    """Compute the pose of the robot's ground in the root link, whose -z is gravity."""
    down = np.array(robot.gravity) / (np.linalg.norm(robot.gravity) or 1.0)
    axis, cosine = np.cross(down, (0.0, 0.0, -1.0)), -down[2]
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        rotation = np.eye(3) if cosine >= 0 else turn(np.array([1.0, 0.0, 0.0]), np.pi)
    else:
        rotation = turn(axis / sine, float(np.arctan2(sine, cosine)))
    return pose_of(rotation, np.zeros(3))


def _link(root: Element, name: str, body: RigidBody | None) -> None:
    element = SubElement(root, "link", name=name if name.startswith("link_") else link(name))
    if body is not None and body.mass:
        element.append(inertial_element(body))


def inertial_element(body: RigidBody) -> Element:
    """Build the ``<inertial>`` of a rigid body in its link's frame."""
    element = Element("inertial")
    SubElement(element, "origin", xyz=_numbers(body.center), rpy="0 0 0")
    SubElement(element, "mass", value=_number(body.mass))
    entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    SubElement(element, "inertia", {name: _number(body.inertia[entry]) for name, entry in entries.items()})
    return element


def _joint(root: Element, joint: Joint, placement: Placement, parent: str) -> Element:
    limits, turns = joint.limits, joint.turns
    endless = turns and limits.position is None
    kind = "continuous" if endless else "revolute" if turns else "prismatic"
    element = SubElement(root, "joint", name=joint.name, type=kind)
    _place(element, placement, parent, link(joint.name))
    SubElement(element, "axis", xyz=_numbers(joint.axis))
    low, high = limits.position or (-UNLIMITED, UNLIMITED)
    bounds = {} if endless else {"lower": _number(low), "upper": _number(high)}
    SubElement(
        element,
        "limit",
        {**bounds, "velocity": _number(limits.velocity or 0.0), "effort": _number(limits.effort or 0.0)},
    )
    return element


def _place(element: Element, placement: Placement, parent: str, child: str) -> None:
    pose = pose_of(placement.rotation, placement.position)
    SubElement(element, "origin", xyz=_numbers(pose.xyz), rpy=_numbers(pose.rpy))
    SubElement(element, "parent", link=parent)
    SubElement(element, "child", link=child)


def _platform(root: Element, platform: Platform, turned: Pose, body: RigidBody) -> None:
    """Build slides along base axes, then hinges about base axes at home, and the platform's frame at the end."""
    home = platform.home
    placement = compose(turned, Pose(home.xyz))
    parent = ROOT
    chain = [f"{dof}_{platform.name}" for dof in platform.dof]
    for name, dof in zip(chain, platform.dof, strict=True):
        axis = tuple(np.eye(3)[(TRANSLATIONS if dof in TRANSLATIONS else ROTATIONS).index(dof)])
        joint = Joint(name, "", "prismatic" if dof in TRANSLATIONS else "revolute", axis=axis, actuated=False)
        _link(root, link(name), None)
        _joint(root, joint, placement, parent)
        parent, placement = link(name), Pose()
    _link(root, platform.name, body)
    fixed = SubElement(root, "joint", name=f"frame_{platform.name}", type="fixed")
    _place(fixed, Pose(rpy=home.rpy), parent, link(platform.name))


def _ends(robot: Robot) -> Iterator[tuple[str, Attachment]]:
    for number, closure in enumerate(robot.closures, start=1):
        yield f"closure_{number}_a", closure.a
        yield f"closure_{number}_b", closure.b


def _loops_text(robot: Robot) -> str:
    """Write the loops in the form that gtau and the Gepetto models of parallel robots use."""
    document = {
        "closed_loop": [[f"closure_{k}_a", f"closure_{k}_b"] for k in range(1, len(robot.closures) + 1)],
        "type": ["3d" if closure.kind == "connect" else "6d" for closure in robot.closures],
        "name_mot": list(robot.actuated),
    }
    return str(yaml.safe_dump(document, sort_keys=False))


def drives_text(model: ConsistentModel) -> str:
    """Write drive gains, rotor inertias and other drive data as YAML."""
    joints: dict[str, dict[str, object]] = {}
    for joint in model.result.robot.joints:
        unit = torque_unit(model.result.robot, joint.name)
        entry: dict[str, object] = {}
        if joint.name in model.gains:
            entry["drive_gain"] = {
                "value": model.gains[joint.name],
                "unit": gain_unit(model.result.robot, joint.name, model.result.kind),
            }
        turns = joint.turns
        if armature := model.of("ia", joint.name):
            entry["armature"] = {"value": armature, "unit": "kg m2" if turns else "kg"}
        if offset := model.of("off", joint.name):
            entry["offset"] = {"value": offset, "unit": unit}
        if cubic := model.cubic(joint.name):
            entry["cubic_friction"] = {"value": cubic, "unit": "N m s3/rad3" if turns else "N s3/m3"}
        if joint.spring is not None:
            stiffness = {"value": model.of(STIFFNESS, joint.name), "unit": f"{unit}/{'rad' if turns else 'm'}"}
            entry |= {"stiffness": stiffness, "springref": {"value": joint.spring, "unit": "rad" if turns else "m"}}
        if entry:
            joints[joint.name] = entry
    document: dict[str, object] = {"robot": model.result.robot.name, "joints": joints}
    if springs := {spring.name: _spring_data(model, spring) for spring in model.result.robot.springs}:
        document["springs"] = springs
    if model.result.robot.closures:
        document["serial_equivalent"] = serial_equivalent(model)
    return str(yaml.safe_dump(document, sort_keys=False))


def _spring_data(model: ConsistentModel, spring: Spring) -> dict[str, object]:
    """Describe a spring between two points: its attachments, and its ``preload - stiffness l - damping dl/dt``."""
    robot, ends = model.result.robot, []
    for end in (spring.a, spring.b):
        placement = compose(_to_vertical(robot), end.placement) if end.body == GROUND else end.placement
        xyz = [float(component) for component in placement.position]
        ends.append({"link": ROOT if end.body == GROUND else link(end.body), "xyz": xyz})
    words = {PRELOAD: "preload", STIFFNESS: "stiffness", DAMPING: "damping"}
    units = {kind: unit_of(kind, robot, spring.name) for kind in spring.parameters}
    values = {words[kind]: {"value": model.of(kind, spring.name), "unit": unit} for kind, unit in units.items()}
    return {"between": ends, **values}


def _number(value: float) -> str:
    return repr(float(value))


def _numbers(values: Iterable[float]) -> str:
    return " ".join(_number(value) for value in values)


def _text(root: Element) -> str:
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _carriers(file: InputFile, joints: set[str]) -> dict[str, tuple[str, bool]]:
    """Find each link's joint of the robot that moves it, and whether the joint carries the link directly."""
    above: dict[str, tuple[str, str]] = {}
    for joint in file.root.findall("joint"):
        parent, child = joint.find("parent"), joint.find("child")
        if parent is not None and child is not None:
            above[child.get("link", "")] = (joint.get("name", ""), parent.get("link", ""))
    found = {}
    for link in above:
        at, direct = link, True
        while at in above:
            joint_name, parent_name = above[at]
            if joint_name in joints:
                found[link] = (joint_name, direct)
                break
            at, direct = parent_name, False
    return found


EXPORTS = {"urdf": Export(export, into=export_into, simulates=True)}
