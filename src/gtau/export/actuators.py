"""Actuators for simulators: identified and unidentified quantities of each motor and its joint.

MuJoCo takes them from a file that a model of the bodies includes; mjlab and Isaac Lab from keywords, written as YAML
beside the bodies as MJCF and URDF:

- of ``mjlab.actuator.BuiltinMotorActuatorCfg`` and its base ``ActuatorCfg`` (mjlab of 2026,
  https://mujocolab.github.io/mjlab/source/actuators.html). A field left out keeps the value of the body's XML;
- of ``isaaclab.actuators.DelayedPDActuatorCfg`` and its base ``ActuatorBaseCfg``
  (https://isaac-sim.github.io/IsaacLab/main/source/api/lab/isaaclab.actuators.html). ``dynamic_friction`` and
  ``viscous_friction`` came with Isaac Lab 2.2; Isaac Sim before 5.0 takes ``friction`` as a coefficient, not a torque.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from gtau.documents.files import identifier
from gtau.documents.yaml_document import yaml_text
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.result import Result
from gtau.export import urdf
from gtau.export.consistent import ConsistentModel, consistent_model, serial_equivalent, what_is_lost
from gtau.export.exported import Export, Exported, written
from gtau.export.mjcf import compiled, digits, imported, model_text
from gtau.robots.parameter import Parameter

TIMESTEP = 0.005  # s: of physics in the files, in which delays are counted
OF_DRIVE = ("armature", "damping", "frictionloss")
"""Attributes of a joint of MJCF that belong to its drive."""
MJLAB_HEAD = """\
Actuators of '{robot}', identified from logs. Not run in mjlab.
Each entry of 'actuators' has the fields of one BuiltinMotorActuatorCfg (commands are torques, N m or N):
  BuiltinMotorActuatorCfg(**entry)
Delays are in physics steps of 'timestep' (s); stiffness and damping of a position controller are yours.
'{body}' holds the bodies, without actuators, and what a field left out keeps."""
ISAACLAB_HEAD = """\
Actuators of '{robot}', identified from logs. Not run in Isaac Lab.
'actuator' has the fields of one DelayedPDActuatorCfg, but for the gains of your controller (0 for torques):
  DelayedPDActuatorCfg(stiffness=..., damping=..., **actuator)
Delays are in physics steps of 'timestep' (s), the same for all joints. Both frictions are the Coulomb friction.
A joint missing under 'armature' has one that is not identifiable apart from its link: see 'measured'."""

OPEN_HEAD = """
The bodies are an OPEN TREE, without the loops of the robot, so this is another robot. 'serial_equivalent' is the
inertia at each motor with loops closed (at home, 'range' over random poses, 'coupling' to each motor): the armature of
a tree of the motors alone. Such a tree has no weight and moves like the robot near home only."""


@dataclass(frozen=True, eq=False)
class Actuator:
    """Motor and joint, SI units at the joint.

    ``gain`` turns current (or the logged torque) into torque; ``armature`` is None where it is not identifiable apart
    from the inertia of links: it is part of the base parameter ``regrouped``, and ``chosen`` is its value in the
    exported bodies. ``damping``, ``frictionloss`` and ``cubic`` are viscous, Coulomb and cubic
    friction. ``effort`` and ``velocity`` are limits of the robot's file, None where it has none.
    """

    joint: str
    gain: Estimate
    armature: Estimate | None
    regrouped: str
    chosen: float
    damping: float
    frictionloss: float
    cubic: float
    offset: float
    effort: float | None
    velocity: float | None
    delay: Estimate

    @property
    def lag(self) -> float:
        """Delay from command to torque, s; 0 if negative (no simulator allows that) or not identifiable."""
        return max(self.delay.value or 0.0, 0.0) if self.delay.std is not None else 0.0

    @property
    def lags(self) -> tuple[int, int]:
        """Ends of the interval of the delay, in steps of ``TIMESTEP``."""
        low, high = self.delay.interval() or (self.lag, self.lag)
        return max(round(low / TIMESTEP), 0), max(round(high / TIMESTEP), 0)


def export_mujoco(result: Result, out: Path) -> Exported:
    """Write ``NAME_actuators.xml``, and ``NAME.xml``, the bodies that include it, into ``out``.

    Raises
    ------
    GtauError
        Where the result has no physically consistent parameters, or MuJoCo is not installed or refuses them.
    """
    model, name = consistent_model(result, "mujoco-actuators"), identifier(result.robot.name)
    (_, whole, motors), notes, figures = _body_texts(model)
    found = actuators(model)
    said = _notes(found)
    if limited := [each.joint for each in found if each.velocity is not None]:
        said.append(f"MuJoCo has no limit of speed, so those of {', '.join(limited)} are not in the files")
    if not _delays(imported()) and any(each.lag for each in found):
        said.append("this MuJoCo has no delay of actuators: delays are not in the files")
    files = written(out, {f"{name}.xml": whole, f"{name}_actuators.xml": motors})
    return Exported(files, (*notes, *said), figures)


def export_mjlab(result: Result, out: Path) -> Exported:
    """Write ``NAME_mjlab.yaml`` and the bodies, ``NAME_body.xml``, into ``out``.

    Raises
    ------
    GtauError
        Where the result has no physically consistent parameters, or MuJoCo is not installed or refuses them.
    """
    model, name = consistent_model(result, "mjlab"), identifier(result.robot.name)
    found, body = actuators(model), f"{name}_body.xml"
    (bodies, *_), notes, figures = _body_texts(model)
    document = {"timestep": TIMESTEP, "actuators": list(map(_fields, found)), "measured": _measured(found)}
    head = MJLAB_HEAD.format(robot=result.robot.name, body=body)
    files = written(out, {f"{name}_mjlab.yaml": _yaml_file(head, document), body: bodies})
    return Exported(files, (*notes, *_notes(found), *_notes_beside(found, "mjlab")), figures)


def _fields(each: Actuator) -> dict[str, Any]:
    fields: dict[str, Any] = {"target_names_expr": [each.joint]}
    if each.armature is not None:
        fields["armature"] = each.armature.value
    fields |= {"frictionloss": each.frictionloss, "viscous_damping": each.damping}
    fields |= {} if each.effort is None else {"effort_limit": each.effort}
    fields |= {} if each.velocity is None else {"velocity_limit": each.velocity}
    low, high = each.lags
    return fields | {"delay_min_lag": low, "delay_max_lag": high}


def export_isaaclab(result: Result, out: Path) -> Exported:
    """Write ``NAME_isaaclab.yaml``, and the bodies as the export to URDF does, into ``out``.

    Raises
    ------
    GtauError
        Where the result has no physically consistent parameters, or the robot has no URDF.
    """
    model, name = consistent_model(result, "isaaclab"), identifier(result.robot.name)
    bodies, found = urdf.export(result, out), actuators(model)
    lags = [each.lags for each in found]
    fields: dict[str, Any] = {
        "joint_names_expr": [each.joint for each in found],
        "armature": {each.joint: each.armature.value for each in found if each.armature is not None},
        "friction": {each.joint: each.frictionloss for each in found},
        "dynamic_friction": {each.joint: each.frictionloss for each in found},
        "viscous_friction": {each.joint: each.damping for each in found},
        "effort_limit": {each.joint: each.effort for each in found if each.effort is not None},
        "velocity_limit": {each.joint: each.velocity for each in found if each.velocity is not None},
        "min_delay": min(low for low, _ in lags),
        "max_delay": max(high for _, high in lags),
    }
    document: dict[str, Any] = {"timestep": TIMESTEP, "actuator": {k: v for k, v in fields.items() if v != {}}}
    if result.robot.closures:
        document["serial_equivalent"] = serial_equivalent(model)
    head = ISAACLAB_HEAD.format(robot=result.robot.name) + (OPEN_HEAD if result.robot.closures else "")
    text = _yaml_file(head, document | {"measured": _measured(found)})
    files = written(out, {f"{name}_isaaclab.yaml": text})
    lost = what_is_lost(result.robot, "Isaac Lab", name)
    said = [each for each in bodies.notes if each != bodies.lost]
    notes = (*([lost] if lost else []), *said, *_notes(found), *_notes_beside(found, "Isaac Lab"))
    return Exported((*files, *bodies.files), notes, bodies.figures, lost)


def actuators(model: ConsistentModel) -> tuple[Actuator, ...]:
    """List the actuators of an identified model."""
    return tuple(_actuator(model, joint) for joint in model.result.robot.motors)


def _actuator(model: ConsistentModel, joint: str) -> Actuator:
    result, limits = model.result, model.result.robot.joint(joint).limits
    armature, regrouped = _armature(model, joint)
    gain = replace(result.drive_gains[joint], value=model.gains[joint])
    return Actuator(
        joint,
        gain,
        armature,
        regrouped,
        model.of("ia", joint),
        model.of("fv", joint),
        model.of("fs", joint),
        model.cubic(joint),
        model.of("off", joint),
        limits.effort,
        limits.velocity,
        result.delays[joint],
    )


def _armature(model: ConsistentModel, joint: str) -> tuple[Estimate | None, str]:
    """Find the rotor inertia if it is a base parameter of its own, else the base parameter that contains it."""
    base, name = model.result.base, Parameter("ia", joint)
    column = base.matrix[:, model.result.idm.parameter_names.index(name)]
    parts = [k for k, factor in enumerate(column) if factor]
    if len(parts) == 1 and (base.matrix[parts[0]] != 0).sum() == 1:
        found = model.result.parameters[base.names[parts[0]]]
        if found.value is not None:
            return replace(found, value=model.of("ia", joint)), ""
    return None, base.names[parts[0]] if parts else ""


def _notes(found: Sequence[Actuator]) -> list[str]:
    """List the actuator quantities that are not identifiable or missing in the robot's file."""
    notes = []
    together = [f"'{each.joint}' ({each.regrouped or 'no effect'})" for each in found if each.armature is None]
    if together:
        notes.append(
            "the armature is not identifiable apart from the inertia of links, whose sum is the base parameter in "
            f"brackets: {', '.join(together)}; its value in the exported bodies was chosen and goes with them alone"
        )
    if missing := [each.joint for each in found if each.effort is None]:
        notes.append(f"the robot file has no effort limit of {', '.join(missing)}: none is in the files")
    if unknown := [each.joint for each in found if each.delay.std is None]:
        notes.append(f"the delay of {', '.join(unknown)} is not identifiable, and 0 in the files")
    if early := [each.joint for each in found if each.delay.std is not None and (each.delay.value or 0.0) < 0]:
        notes.append(f"the delay of {', '.join(early)} is estimated below 0, and 0 in the files")
    return notes


def _notes_beside(found: Sequence[Actuator], target: str) -> list[str]:
    """List the quantities for which a ``target`` has no field."""
    notes = [f"the YAML file was not run in {target}: its keys are the fields of its documentation"]
    if bent := [each.joint for each in found if each.cubic]:
        notes.append(f"{target} has no friction cubic in speed, which is under 'measured': {', '.join(bent)}")
    if offset := [each.joint for each in found if each.offset]:
        notes.append(f"offsets of torque are under 'measured', as {target} has none: {', '.join(offset)}")
    return notes


def _measured(found: Sequence[Actuator]) -> dict[str, Any]:
    """Describe the actuators by joint, with intervals, for people and programs."""
    described = {}
    for each in found:
        if each.armature is not None:
            armature = _estimate(each.armature, each.armature.unit)
        else:
            armature = {"not_identifiable_apart_from": each.regrouped, "with_exported_bodies": each.chosen}
        entry = {
            "current_to_torque": _estimate(each.gain, each.gain.unit),
            "delay": _estimate(each.delay, "s"),
            "armature": armature,
            "damping": each.damping,
            "frictionloss": each.frictionloss,
            "offset": each.offset,
        }
        more = {"damping_cubic": each.cubic, "effort": each.effort, "velocity": each.velocity}
        described[each.joint] = entry | {key: value for key, value in more.items() if value}
    return described


def _estimate(each: Estimate, unit: str) -> dict[str, Any]:
    interval = each.interval()
    found: dict[str, Any] = {"value": each.value, "unit": unit}
    return found | ({} if interval is None else {"interval": list(interval)})


def _yaml_file(head: str, document: dict[str, Any]) -> str:
    """Write a YAML file with a comment on top."""
    text = yaml_text(document)
    return "".join(f"# {line}\n" for line in head.splitlines()) + text


def _body_texts(model: ConsistentModel) -> tuple[tuple[str, str, str], tuple[str, ...], dict[str, float]]:
    """Split the MJCF export: bodies alone, a whole that includes the actuators, and these; with notes and figures."""
    mujoco = imported()
    text, notes, figures = model_text(mujoco, model, delays=True)
    root = ElementTree.fromstring(text)
    section = root.find("actuator")
    assert section is not None
    drives = {each.joint: each for each in actuators(model)}
    for motor in [each for each in section if each.get("name") in drives]:
        section.remove(motor)  # those of springs stay
    if not len(section):
        root.remove(section)
    option = root.find("option")
    step = float("0.002" if option is None else option.get("timestep", "0.002"))
    body = _text(root)
    defaults = Element("mujoco")
    outer = SubElement(SubElement(defaults, "default"), "default", {"class": "drives"})
    for joint in root.iter("joint"):
        if joint.get("name") in drives:  # those of equalities have none
            values = {key: joint.attrib.pop(key) for key in OF_DRIVE if key in joint.attrib}
            SubElement(SubElement(outer, "default", {"class": f"drive {joint.get('name')}"}), "joint", values)
            joint.set("class", f"drive {joint.get('name')}")
    motors = SubElement(defaults, "actuator")
    delays = _delays(mujoco)
    for each in drives.values():
        SubElement(motors, "general", _general(each, step if delays else 0.0))
    name = f"{identifier(model.result.robot.name)}_actuators.xml"
    root.insert(0, Element("include", {"file": name}))
    whole, included = _text(root), _text(defaults)
    compiled(lambda: mujoco.MjModel.from_xml_string(whole, {name: included.encode()}))
    return (body, whole, included), notes, figures


def _general(each: Actuator, step: float) -> dict[str, str]:
    """Make an actuator whose ``ctrl`` is the current (A) and whose force is the torque at the joint."""
    gain = float(each.gain.value or 1.0)
    attributes = {"name": each.joint, "joint": each.joint, "gainprm": digits(gain)}
    if each.offset:
        attributes |= {"biastype": "affine", "biasprm": digits((-each.offset, 0.0, 0.0))}
    if each.effort is not None:
        largest = each.effort / abs(gain)
        attributes |= {"forcerange": digits((-each.effort, each.effort)), "ctrlrange": digits((-largest, largest))}
    if step and each.lag:
        attributes |= {"delay": digits(each.lag), "nsample": str(ceil(each.lag / step) + 1)}
    return attributes


def _delays(mujoco: ModuleType) -> bool:
    """Decide whether this MuJoCo has delays of actuators."""
    return hasattr(mujoco.MjsActuator, "delay")


def _text(root: Element) -> str:
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


EXPORTS = {
    "mujoco-actuators": Export(export_mujoco, simulates=True),
    "mjlab": Export(export_mjlab, simulates=True),
    "isaaclab": Export(export_isaaclab, simulates=True),
}
