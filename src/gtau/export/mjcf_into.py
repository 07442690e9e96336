"""Identified model written into the robot's original MJCF file."""

from __future__ import annotations

from codecs import BOM_UTF8
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import casadi as ca
import numpy as np

from gtau.errors import GtauError
from gtau.estimation.results.result import IdentifiedModel
from gtau.export import mjcf
from gtau.export.consistent import ConsistentModel, consistent_model, differences
from gtau.export.exported import Export, Exported, digits
from gtau.export.input_file import InputFile, input_file
from gtau.export.mjcf import imported, notes
from gtau.model.kinematics import frames
from gtau.robots.parameter import Parameter, RigidBody, rigid_body
from gtau.robots.readers.mjcf_file import SHAPES, compile_mjcf
from gtau.robots.readers.xml_document import read_xml
from gtau.robots.robot import SPRING, STIFFNESS
from gtau.simulation.mujoco_plant import spring_attributes

NO_BODY = RigidBody(0.0, np.zeros(3), np.zeros((3, 3)))


def export(result: IdentifiedModel, source: Path, out: Path) -> Exported:
    """Write a copy of the MJCF file ``source`` with identified inertias, friction and gears into ``out``.

    Raises GtauError without consistent parameters, or if the file describes another robot or includes or repeats
    bodies.
    """
    mujoco = imported()
    model = consistent_model(result, "MJCF")
    file = input_file(source, result.robot)
    compiled = compile_mjcf(read_xml(source), source).model
    elements = [element for world in file.root.findall("worldbody") for element in _within(world, "body")]
    if len(elements) != compiled.nbody - 1 or file.root.find(".//replicate") is not None:
        raise GtauError(
            f"{source} includes or repeats bodies from outside the file itself; save it from MuJoCo as one file and "
            f"give that."
        )
    inertias, lumped = _inertias(mujoco, model, compiled), []
    for number, element in enumerate(elements, start=1):
        file.put(element, _inertial(inertias.get(number, NO_BODY)))
        if number not in inertias:
            lumped.append(element.get("name", f"body {number}"))
        for place, joint in enumerate(_within(element, "joint", "freejoint"), start=compiled.body_jntadr[number]):
            _put_friction(file, joint, model, _joint_name(compiled, place))
    unchanged = _put_springs(file, model)
    said = [*_put_gears(file, model), *_allow_inertias(file)]
    if unchanged:
        said.append(f"these springs are not tendons with a stiffness and were left unchanged: {', '.join(unchanged)}")
    _check(mujoco, file, inertias)
    unable = {Parameter("off", joint.name) for joint in result.robot.joints}
    unable |= {Parameter(kind, name) for kind in SPRING for name in unchanged}
    expressed = {name: value for name, value in model.values.items() if name not in unable}
    figures, difference = differences(model, expressed)
    if lumped:
        said.append(f"bodies without joints are part of those that carry them, and weigh nothing: {', '.join(lumped)}")
    said.append("meshes and textures are named as in the original: put the file where they are found")
    return Exported(file.save(out), (difference, *notes(model, expressed), *said), figures)


def _within(element: Element, *tags: str) -> Iterator[Element]:
    """List elements in MuJoCo's order: bodies at any depth, or joints of one body."""
    for child in element:
        if child.tag in tags:
            yield child
        if child.tag == "frame" or (child.tag == "body" and "body" in tags):
            yield from _within(child, *tags)


def _joint_name(compiled: Any, number: int) -> str:
    return compiled.joint(number).name or f"joint {number + 1}"


def _inertias(mujoco: Any, model: ConsistentModel, compiled: Any) -> dict[int, RigidBody]:
    robot, layout = model.result.robot, model.result.idm.layout
    data = mujoco.MjData(compiled)
    mujoco.mj_kinematics(compiled, data)
    number = {_joint_name(compiled, place): int(compiled.jnt_bodyid[place]) for place in range(compiled.njnt)}
    for body in range(1, compiled.nbody):
        number.setdefault(compiled.body(body).name or f"body {body + 1}", body)
    c = np.zeros(layout.n_c)
    single = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    for k, joint in enumerate(robot.joints):
        if joint.name in number and int(compiled.joint(joint.name).type[0]) in single:
            c[k] = data.qpos[compiled.joint(joint.name).qposadr[0]]
    for slots in layout.platforms:
        body = data.body(slots.platform.name)
        c[slots.position], c[slots.quaternion] = body.xpos, body.xquat
    frame = frames(layout, ca.SX(c))
    inertias = {}
    for name in robot.bodies:
        if Parameter("m", name) in model.values:
            at = data.body(number[name])
            R, p = np.array(ca.evalf(frame[name].R_0)), np.array(ca.evalf(frame[name].p_0)).ravel()
            rotation, position = R.T @ at.xmat.reshape(3, 3), R.T @ (at.xpos - p)
            inertias[number[name]] = rigid_body(model.values, name).seen_from(rotation, position)
    return inertias


def _inertial(body: RigidBody) -> Element:
    entries = body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    inertia = {"fullinertia": digits(entries)} if body.mass else {"diaginertia": "0 0 0"}
    return Element("inertial", {"pos": digits(body.center), "mass": digits(body.mass), **inertia})


def _put_friction(file: InputFile, element: Element, model: ConsistentModel, joint: str) -> None:
    attributes = {}
    if Parameter("fv", joint) in model.values:
        viscous, cubic = model.of("fv", joint), model.of("f3", joint)
        attributes["armature"] = digits(model.of("ia", joint))
        attributes["damping"] = digits((viscous, 0.0, cubic) if cubic else viscous)
        attributes["frictionloss"] = digits(model.of("fs", joint))
    if Parameter(STIFFNESS, joint) in model.values:
        attributes["stiffness"] = digits(model.of(STIFFNESS, joint))
    if attributes:
        file.set(element, **attributes)


def _put_springs(file: InputFile, model: ConsistentModel) -> list[str]:
    """Write springs into their original tendons; return the names of springs that these cannot represent."""
    tendons, unchanged = {tendon.get("name"): tendon for tendon in file.root.iter("spatial")}, []
    for spring in model.result.robot.springs:
        attributes = spring_attributes(spring, model.values)
        if attributes is None or spring.name not in tendons:
            unchanged.append(spring.name)
        else:
            file.set(tendons[spring.name], **{name: digits(value) for name, value in attributes.items()})
    return unchanged


def _put_gears(file: InputFile, model: ConsistentModel) -> list[str]:
    put, unchanged, notes = [], [], []
    for actuator in file.root.iterfind("actuator/*[@joint]"):
        joint = actuator.get("joint", "")
        if actuator.tag == "motor" and joint in model.gains:
            file.set(actuator, gear=digits(model.gains[joint]))
            put.append(joint)
        elif joint in model.gains:
            unchanged.append(joint)
    if put:
        notes.append(f"ctrl of the motors of {', '.join(put)} is now the current in A; check their ctrlrange")
    if unchanged:
        notes.append(f"actuators other than motors were left unchanged: {', '.join(unchanged)}")
    return notes


def _allow_inertias(file: InputFile) -> list[str]:
    """Make MuJoCo take inertias from the file, not from the shapes."""
    notes = []
    for compiler in file.root.findall("compiler"):
        if compiler.get("inertiafromgeom") == "true":
            file.set(compiler, inertiafromgeom="auto")
            notes.append("inertiafromgeom is now 'auto', so that the identified inertias count")
    return notes


def _check(mujoco: Any, file: InputFile, inertias: Mapping[int, RigidBody]) -> None:
    """Refuse a file that MuJoCo does not compile, or to other masses and inertias than those identified."""
    try:
        text = file.text().removeprefix(BOM_UTF8).decode("latin-1")  # of names only whether they differ matters
        spec = mujoco.MjSpec.from_string(text)
        for kind in SHAPES:
            for shape in list(getattr(spec, kind)):
                spec.delete(shape)
        compiled = spec.compile()
    except ValueError as error:
        said = " ".join(str(error).split()).rstrip(".")
        raise GtauError(f"{file.path}: MuJoCo refuses the identified parameters in it ({said}).") from None
    for number in range(1, compiled.nbody):
        body = inertias.get(number, NO_BODY)
        made, wanted = (
            [compiled.body_mass[number], *sorted(compiled.body_inertia[number])],
            [body.mass, *body.principal[0]],
        )
        if not np.allclose(made, wanted, rtol=1e-6, atol=1e-9):
            raise GtauError(
                f"{file.path}: MuJoCo takes another mass or inertia of '{compiled.body(number).name}' than the "
                "identified one; remove settotalmass, boundmass, boundinertia and balanceinertia from <compiler> first."
            )


EXPORTS = {"mjcf": Export(mjcf.export, into=export, simulates=True)}
