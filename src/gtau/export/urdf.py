"""URDF with inertias and friction, and YAML files for loops and drives beside it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from gtau.documents.files import identifier
from gtau.errors import GtauError
from gtau.estimation.results.result import IdentifiedModel
from gtau.export.consistent import (
    ConsistentModel,
    consistent_model,
    differences,
    friction_comments,
    serial_equivalent,
    term_notes,
    what_is_lost,
)
from gtau.export.exported import Exported, digits, written, xml_text
from gtau.robots.parameter import KINDS, RigidBody, gain_unit, rigid_body, torque_unit, unit_of
from gtau.robots.placement import Placement, Pose, compose, pose_of
from gtau.robots.robot import GROUND, ROTATIONS, STIFFNESS, TRANSLATIONS, Coupling, Joint, Platform, Robot, Spring

ROOT = "base"
# SI units: the format requires limits, simulators hold a joint at 0, and readers take more than 1e9 for none
UNLIMITED = 1e10


def export(result: IdentifiedModel, out: Path) -> Exported:
    """Write ``NAME.urdf``, ``NAME_drives.yaml``, and ``NAME.yaml`` where there are loops, into ``out``."""
    model = consistent_model(result, "URDF")
    robot = result.robot
    name = identifier(result.robot.name)
    texts = {f"{name}.urdf": '<?xml version="1.0"?>\n' + xml_text(_robot_element(model))}
    texts[f"{name}_drives.yaml"] = drives_text(model)
    if robot.closures:
        loops = {  # as gtau and the Gepetto models of parallel robots write them
            "closed_loop": [[f"closure_{k}_a", f"closure_{k}_b"] for k in range(1, len(robot.closures) + 1)],
            "type": ["3d" if closure.kind == "connect" else "6d" for closure in robot.closures],
            "name_mot": list(robot.actuated),
        }
        texts[f"{name}.yaml"] = yaml.safe_dump(loops, sort_keys=False)
    return with_notes(model, written(out, texts))


def with_notes(model: ConsistentModel, files: tuple[Path, ...], more: Sequence[str] = (), loops: str = "") -> Exported:
    """Return the files, with notes on the loops, which are in the file ``loops``, and on effects that a URDF lacks."""
    robot, name = model.result.robot, identifier(model.result.robot.name)
    figures, difference = differences(model, model.values)
    lost = what_is_lost(robot, "a URDF", name, loops)
    sprung = robot.springs or any(joint.spring is not None for joint in robot.joints)
    springs = " and springs" if sprung else ""
    notes = [f"a URDF has no place for drive gains, rotor inertias, offsets{springs}: they are in {name}_drives.yaml"]
    if model.cubic:
        notes.append(f"friction cubic in speed is in {name}_drives.yaml too")
    notes += [*term_notes(model, "URDF", model.values), *more]
    return Exported(files, (*([lost] * bool(lost)), difference, *notes), figures, lost)


def _robot_element(model: ConsistentModel) -> Element:
    robot = model.result.robot
    turned, root = _to_vertical(robot), Element("robot", name=robot.name)
    root.extend(friction_comments(model))
    SubElement(root, "link", name=ROOT)
    couplings = {coupling.joint: coupling for coupling in robot.couplings}
    for joint in robot.joints:
        body = rigid_body(model.values, joint.name) if joint.has_mass else None
        element = _attach(root, joint.name, *_on(joint.antecedent, joint.placement, turned), body)
        _moving(element, joint)
        SubElement(element, "dynamics", friction_attributes(model, joint.name))
        if joint.name in couplings:
            _mimic(element, couplings[joint.name])
    for platform in robot.platforms:
        _platform(root, platform, turned, rigid_body(model.values, platform.name))
    for number, closure in enumerate(robot.closures, start=1):
        for side, end in (("a", closure.a), ("b", closure.b)):
            _attach(root, f"closure_{number}_{side}", *_on(end.body, end.placement, turned))
    return root


def _on(body: str, placement: Placement, turned: Pose) -> tuple[str, Placement]:
    """Return a body's link, and a placement on it; the ground is ``turned`` in the root link."""
    return (ROOT, compose(turned, placement)) if body == GROUND else (f"link_{body}", placement)


def _attach(
    root: Element, name: str, parent: str, placement: Placement, body: RigidBody | None = None, link: str = ""
) -> Element:
    """Add a link, with its inertia where it has one, and the fixed joint that holds it; returns the joint."""
    link = f"link_{link or name}"
    element = SubElement(root, "link", name=link)
    if body is not None and body.mass:
        element.append(inertial_element(body))
    pose = pose_of(placement.rotation, placement.position)
    joint = SubElement(root, "joint", name=name, type="fixed")
    SubElement(joint, "origin", xyz=digits(pose.xyz), rpy=digits(pose.rpy))
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=link)
    return joint


def _moving(element: Element, joint: Joint) -> None:
    limits, endless = joint.limits, joint.turns and joint.limits.position is None
    element.set("type", "continuous" if endless else "revolute" if joint.turns else "prismatic")
    SubElement(element, "axis", xyz=digits(joint.axis))
    low, high = limits.position or (-UNLIMITED, UNLIMITED)
    bounds = {} if endless else {"lower": low, "upper": high}
    bounds |= {"velocity": limits.velocity or UNLIMITED, "effort": limits.effort or UNLIMITED}
    SubElement(element, "limit", {kind: digits(bound) for kind, bound in bounds.items()})


def friction_attributes(model: ConsistentModel, joint: str) -> dict[str, str]:
    """Return the attributes of a joint's ``<dynamics>``."""
    return {"damping": digits(model.of("fv", joint)), "friction": digits(model.of("fs", joint))}


def _mimic(element: Element, coupling: Coupling) -> None:
    if len(coupling.ratios) > 1:
        raise GtauError(
            f"joint '{coupling.joint}' is coupled to {len(coupling.ratios)} joints, and a joint of a URDF mimics "
            "one; export to c instead."
        )
    ((other, ratio),) = coupling.ratios
    SubElement(element, "mimic", joint=other, multiplier=digits(ratio), offset=digits(coupling.offset))


def _platform(root: Element, platform: Platform, turned: Pose, body: RigidBody) -> None:
    """Build slides along base axes, then hinges about base axes at home, and the platform's frame at the end."""
    parent, placement = ROOT, compose(turned, Pose(platform.home.xyz))
    for dof in platform.dof:
        name, slides = f"{dof}_{platform.name}", dof in TRANSLATIONS
        axis = tuple(np.eye(3)[(TRANSLATIONS if slides else ROTATIONS).index(dof)])
        joint = Joint(name, "", "prismatic" if slides else "revolute", axis=axis, actuated=False)
        _moving(_attach(root, name, parent, placement), joint)
        parent, placement = f"link_{name}", Pose()
    _attach(root, f"frame_{platform.name}", parent, Pose(rpy=platform.home.rpy), body, platform.name)


def _to_vertical(robot: Robot) -> Pose:
    """Compute the pose of the robot's ground in the root link, whose -z is gravity."""
    vertical = (0.0, 0.0, -1.0)
    turned, _ = Rotation.align_vectors([vertical], [robot.gravity if any(robot.gravity) else vertical])
    return pose_of(turned.as_matrix(), np.zeros(3))


def inertial_element(body: RigidBody) -> Element:
    """Build the ``<inertial>`` of a rigid body in its link's frame."""
    element = Element("inertial")
    SubElement(element, "origin", xyz=digits(body.center), rpy="0 0 0")
    SubElement(element, "mass", value=digits(body.mass))
    entries = zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), body.inertia[np.triu_indices(3)], strict=True)
    SubElement(element, "inertia", {name: digits(entry) for name, entry in entries})
    return element


def drives_text(model: ConsistentModel) -> str:
    """Write drive gains, rotor inertias and other drive data as YAML."""
    robot = model.result.robot
    document: dict[str, Any] = {"robot": robot.name, "joints": {}}
    for joint in robot.joints:
        name, given = joint.name, {}
        if name in model.gains:
            given["drive_gain"] = _quantity(model.gains[name], gain_unit(robot, name, model.result.kind))
        for key, kind in (("armature", "ia"), ("offset", "off"), ("cubic_friction", "f3")):
            if value := model.of(kind, name):
                given[key] = _quantity(value, unit_of(kind, robot, name))
        if joint.spring is not None:
            unit = f"{torque_unit(robot, name)}/{joint.unit}"
            given["stiffness"] = _quantity(model.of(STIFFNESS, name), unit)
            given["springref"] = _quantity(joint.spring, joint.unit)
        if given:
            document["joints"][name] = given
    if robot.springs:
        document["springs"] = {spring.name: _spring_data(model, spring) for spring in robot.springs}
    if robot.closures:
        document["serial_equivalent"] = serial_equivalent(model)
    return str(yaml.safe_dump(document, sort_keys=False))


def _spring_data(model: ConsistentModel, spring: Spring) -> dict[str, object]:
    """Describe a spring between two points: its attachments, and its ``preload - stiffness l - damping dl/dt``."""
    robot, ends = model.result.robot, []
    for end in (spring.a, spring.b):
        parent, placement = _on(end.body, end.placement, _to_vertical(robot))
        ends.append({"link": parent, "xyz": [float(component) for component in placement.position]})
    values = {
        KINDS[kind].words: _quantity(model.of(kind, spring.name), unit_of(kind, robot, spring.name))
        for kind in spring.parameters
    }
    return {"between": ends, **values}


def _quantity(value: float, unit: str) -> dict[str, object]:
    return {"value": value, "unit": unit}
