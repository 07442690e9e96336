"""Identified parameters in a copy of the robot's own URDF or MJCF file, which is otherwise unchanged."""

from __future__ import annotations

import re
from codecs import BOM_UTF8
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, indent, tostring
from xml.parsers.expat import ParserCreate

import casadi as ca
import numpy as np

from gtau.documents.files import identifier
from gtau.documents.markup import read_xml
from gtau.errors import GtauError, errors_at
from gtau.estimation.results.result import IdentifiedModel
from gtau.export import mjcf, urdf
from gtau.export.consistent import ConsistentModel, consistent_model, differences
from gtau.export.exported import Export, Exported, digits, written
from gtau.model.home import load_robot
from gtau.model.kinematics import frames
from gtau.robots.parameter import Parameter, RigidBody, rigid_body
from gtau.robots.readers.mjcf_file import SHAPES, compile_mjcf
from gtau.robots.robot import SPRING, STIFFNESS, Robot
from gtau.simulation.mujoco_plant import spring_attributes

SAME = 1e-6  # m, and entries of rotations: readers round
NO_BODY = RigidBody(0.0, np.zeros(3), np.zeros((3, 3)))


class Span(NamedTuple):
    """Location of an element in the bytes of its file: from ``start`` to ``stop``, its start tag up to ``inner``."""

    start: int
    inner: int
    stop: int


@dataclass(frozen=True, eq=False)
class InputFile:
    """Unchanged XML file, its elements with their spans, and the pending ``edits``: start, stop, new bytes."""

    path: Path
    content: bytes
    root: Element
    spans: dict[Element, Span]
    edits: list[tuple[int, int, bytes]] = field(default_factory=list)

    def set(self, element: Element, **attributes: str) -> None:
        """Set attributes of an element; all others stay unchanged."""
        span = self.spans[element]
        tag = self.content[span.start : span.inner].decode("ascii", "surrogateescape")
        for name, value in attributes.items():
            tag, count = re.subn(rf"(\s{name}\s*=\s*)(\"[^\"]*\"|'[^']*')", rf'\g<1>"{value}"', tag, count=1)
            if not count:
                tag = re.sub(r"\s*(/?>)$", rf' {name}="{value}"\g<1>', tag)
        self.edits.append((span.start, span.inner, tag.encode("ascii", "surrogateescape")))

    def put(self, parent: Element, new: Element) -> None:
        """Put an element into another, in place of one of its kind, or as the first content on its own line."""
        indent(new)
        text, old = tostring(new, encoding="unicode").encode(), parent.find(new.tag)
        span = self.spans[parent if old is None else old]
        line = self.content[self.content.rfind(b"\n", 0, span.start) + 1 : span.start]
        margin = b"\n" + line * line.isspace()  # where nothing else precedes it
        inside = (b"\n" + text).replace(b"\n", margin + b"  ")
        if old is not None:
            self.edits.append((span.start, span.stop, text.replace(b"\n", margin)))
        elif span.inner == span.stop:  # <a/>
            tag = self.content[span.start : span.inner].rstrip(b"/>").rstrip()
            self.edits.append((span.start, span.stop, tag + b">" + inside + margin + f"</{parent.tag}>".encode()))
        else:
            self.edits.append((span.inner, span.inner, inside))

    def remove(self, element: Element) -> None:
        """Remove an element, with the white space before it."""
        span = self.spans[element]
        self.edits.append((len(self.content[: span.start].rstrip()), span.stop, b""))

    def text(self) -> bytes:
        """Return the file with all edits made."""
        made = self.content
        for start, stop, new in sorted(self.edits, reverse=True):
            made = made[:start] + new + made[stop:]
        return made


def input_file(path: Path, robot: Robot) -> InputFile:
    """Read the file of ``robot`` for edits; raises GtauError if it is unreadable or describes another robot."""
    if problem := _difference(load_robot(path), robot):
        raise GtauError(f"{path} is not the file of the model's robot '{robot.name}': {problem}; give its own file.")
    with errors_at(path):
        root = read_xml(path)  # safe: no entities, no document types
    content = path.read_bytes()
    if b"\0" in content:
        raise GtauError(f"{path} is UTF-16 text, which cannot be edited in place; save it as UTF-8.")
    return InputFile(path, content, root, dict(zip(root.iter(), _spans(content), strict=True)))


def _spans(content: bytes) -> list[Span]:
    parser = ParserCreate()
    spans: dict[int, Span] = {}  # by where the elements begin
    inside: list[int] = []

    def start(name: str, attributes: object) -> None:
        at = parser.CurrentByteIndex
        inside.append(at)
        spans[at] = Span(at, _tag_end(content, at), 0)

    def end(name: str) -> None:
        span = spans[inside.pop()]
        empty = content.endswith(b"/>", 0, span.inner)  # its end is reported at its beginning, or after it
        stop = span.inner if empty else _tag_end(content, parser.CurrentByteIndex)
        spans[span.start] = span._replace(stop=stop)

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.Parse(content, True)
    return list(spans.values())


def _tag_end(content: bytes, start: int) -> int:
    """Find where a tag that begins at ``start`` ends; a > within quotes does not end it."""
    tag = re.compile(rb"<(?:[^>\"']|\"[^\"]*\"|'[^']*')*>").match(content, start)
    assert tag is not None
    return tag.end()


def _difference(file_robot: Robot, robot: Robot) -> str:
    if file_robot.bodies != robot.bodies:
        missing = [name for name in robot.bodies if name not in file_robot.bodies]
        return f"'{missing[0]}' is missing there" if missing else f"it has {len(file_robot.bodies)} bodies"
    for one, other in zip(file_robot.joints, robot.joints, strict=True):
        if (one.antecedent, one.kind) != (other.antecedent, other.kind):
            return f"joint '{one.name}' has another parent or is of another kind"
        a, b = (np.vstack([j.placement.rotation, j.placement.position, j.axis]) for j in (one, other))
        if np.abs(a - b).max() > SAME:
            return f"joint '{one.name}' is placed otherwise"
    return ""


def into_urdf(result: IdentifiedModel, source: Path, out: Path) -> Exported:
    """Write a copy of the URDF ``source`` with identified inertias and friction, and the drives, into ``out``."""
    model = consistent_model(result, "URDF")
    if source.suffix.lower() != ".urdf":
        raise GtauError(f"{source} is no URDF; give the .urdf file that the robot came from.")
    file = input_file(source, result.robot)
    joints = {joint.name for joint in result.robot.joints}
    carriers, lumped = _carriers(file, joints), []
    for element in file.root.findall("link"):
        name, inertial = element.get("name", ""), element.find("inertial")
        carrier, direct = carriers.get(name, ("", False))
        if direct:
            file.put(element, urdf.inertial_element(rigid_body(model.values, carrier)))
        elif carrier and inertial is not None:
            file.remove(inertial)
            lumped.append(name)
    for element in file.root.findall("joint"):
        if (name := element.get("name", "")) in joints:
            friction, dynamics = urdf.friction_attributes(model, name), element.find("dynamics")
            if dynamics is None:
                file.put(element, Element("dynamics", friction))
            else:
                file.set(dynamics, **friction)
    notes = []
    if lumped:
        notes = [f"links on fixed joints are part of those that carry them, and have no inertia: {', '.join(lumped)}"]
    texts: dict[str, str | bytes] = {source.name: file.text()}
    texts[f"{identifier(result.robot.name)}_drives.yaml"] = urdf.drives_text(model)
    return urdf.with_notes(model, written(out, texts), notes, "the robot's own YAML file")


def _carriers(file: InputFile, joints: set[str]) -> dict[str, tuple[str, bool]]:
    """Find each link's joint of the robot that moves it, and whether the joint carries the link directly."""
    above: dict[str, tuple[str, str]] = {}
    for joint in file.root.findall("joint"):
        parent, child = joint.find("parent"), joint.find("child")
        if parent is not None and child is not None:
            above[child.get("link", "")] = (joint.get("name", ""), parent.get("link", ""))
    carriers = {}
    for name, (carrier, parent_link) in above.items():
        direct = carrier in joints
        while carrier not in joints and parent_link in above:
            carrier, parent_link = above[parent_link]
        if carrier in joints:
            carriers[name] = (carrier, direct)
    return carriers


def into_mjcf(result: IdentifiedModel, source: Path, out: Path) -> Exported:
    """Write a copy of the MJCF ``source`` with identified inertias, friction and gears into ``out``."""
    mujoco = mjcf.imported()
    model = consistent_model(result, "MJCF")
    file = input_file(source, result.robot)
    compiled = compile_mjcf(read_xml(source), source).model
    elements = [element for world in file.root.findall("worldbody") for element in _within(world, "body")]
    if len(elements) != compiled.nbody - 1 or file.root.find(".//replicate") is not None:
        raise GtauError(
            f"{source} includes or repeats bodies from outside the file itself; save it from MuJoCo as one file and "
            "give that."
        )
    inertias, lumped = _inertias(mujoco, model, compiled), []
    for number, element in enumerate(elements, start=1):
        file.put(element, _inertial(inertias.get(number, NO_BODY)))
        if number not in inertias:
            lumped.append(element.get("name", f"body {number}"))
        for place, joint in enumerate(_within(element, "joint", "freejoint"), start=compiled.body_jntadr[number]):
            if attributes := _joint_attributes(model, _joint_name(compiled, place)):
                file.set(joint, **attributes)
    unchanged = _put_springs(file, model)
    said = _put_gears(file, model)
    for compiler in file.root.findall("compiler"):
        if compiler.get("inertiafromgeom") == "true":
            file.set(compiler, inertiafromgeom="auto")
            said.append("inertiafromgeom is now 'auto', so that the identified inertias count")
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
    notes = (difference, *mjcf.notes(model, expressed), *said)
    return Exported(written(out, {source.name: file.text()}), notes, figures)


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
    """Compute the bodies in the frames of the file, by their numbers there."""
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


def _joint_attributes(model: ConsistentModel, joint: str) -> dict[str, str]:
    attributes = {}
    if Parameter("fv", joint) in model.values:
        viscous, cubic = model.of("fv", joint), model.of("f3", joint)
        attributes["armature"] = digits(model.of("ia", joint))
        attributes["damping"] = digits((viscous, 0.0, cubic) if cubic else viscous)
        attributes["frictionloss"] = digits(model.of("fs", joint))
    if Parameter(STIFFNESS, joint) in model.values:
        attributes["stiffness"] = digits(model.of(STIFFNESS, joint))
    return attributes


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
        made = [compiled.body_mass[number], *sorted(compiled.body_inertia[number])]
        if not np.allclose(made, [body.mass, *body.principal[0]], rtol=1e-6, atol=1e-9):
            raise GtauError(
                f"{file.path}: MuJoCo takes another mass or inertia of '{compiled.body(number).name}' than the "
                "identified one; remove settotalmass, boundmass, boundinertia and balanceinertia from <compiler> first."
            )


EXPORTS = {
    "urdf": Export(urdf.export, into=into_urdf, simulates=True),
    "mjcf": Export(mjcf.export, into=into_mjcf, simulates=True),
}
