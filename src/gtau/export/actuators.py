"""Actuators for simulators: identified and unidentified quantities of each motor and its joint.

MuJoCo takes them from a file that a model of the bodies includes; mjlab and Isaac Lab from keywords, written as YAML
beside the bodies as MJCF and URDF:

- of ``mjlab.actuator.BuiltinMotorActuatorCfg`` and its base ``ActuatorCfg`` (mjlab of 2026,
  https://mujocolab.github.io/mjlab/source/actuators.html). A field left out keeps the value of the body's XML;
- of ``isaaclab.actuators.DelayedPDActuatorCfg``, of ``DCMotorCfg`` and their base ``ActuatorBaseCfg``
  (https://isaac-sim.github.io/IsaacLab/main/source/api/lab/isaaclab.actuators.html). ``dynamic_friction`` and
  ``viscous_friction`` came with Isaac Lab 2.2; Isaac Sim before 5.0 takes ``friction`` as a coefficient, not a torque.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from gtau.documents.files import identifier
from gtau.documents.markup import yaml_text
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.result import IdentifiedModel
from gtau.export import urdf
from gtau.export.consistent import ConsistentModel, consistent_model, serial_equivalent, what_is_lost
from gtau.export.exported import Export, Exported, digits, written, xml_text
from gtau.export.mjcf import compiled, imported, model_text
from gtau.robots.parameter import Parameter
from gtau.robots.robot import Limits
from gtau.simulation.mujoco_plant import STEP

TIMESTEP = 0.005  # s: of physics in the files, in which delays are counted
ELECTRICAL = {"resistance": "R", "back_emf": "ke"}  # of motors whose voltages were logged
DRIVE_ATTRIBUTES = ("armature", "damping", "frictionloss")
"""Attributes of a joint of MJCF that belong to its drive."""
ISAACLAB = {
    "armature": "armature",
    "friction": "frictionloss",
    "dynamic_friction": "frictionloss",
    "viscous_friction": "viscous_damping",
    "effort_limit": "effort_limit",
    "velocity_limit": "velocity_limit",
}
"""Fields of Isaac Lab by joint, with the equal fields of mjlab."""
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
DC_MOTOR_HEAD = """
'dc_motor_per_volt', times the supply voltage, are fields of a DCMotorCfg in its place, without delays: the stall torque
g / R and the speed without load 1 / ke, which is 3/2 as fast with amplitude-invariant voltages of the q axis."""

OPEN_HEAD = """
The bodies are an OPEN TREE, without the loops of the robot, so this is another robot. 'serial_equivalent' is the
inertia at each motor with loops closed (at home, 'range' over random poses, 'coupling' to each motor): the armature of
a tree of the motors alone. Such a tree has no weight and moves like the robot near home only."""


@dataclass(frozen=True, eq=False)
class Actuator:
    """Motor and joint, SI units at the joint.

    ``gain`` and ``delay`` lead from the command to the torque; ``electrical`` are known if voltages were logged;
    ``chosen`` are parameters of the exported bodies by kind (ia, fv, fs, f3, off). ``armature`` is None where it is not
    identifiable apart from the inertia of links: it is part of the base parameter ``regrouped``.
    """

    joint: str
    limits: Limits
    gain: Estimate
    delay: Estimate
    electrical: dict[str, Estimate]
    chosen: dict[str, float]
    armature: Estimate | None
    regrouped: str

    @property
    def lag(self) -> float:
        """Delay, s; 0 if negative (no simulator allows that) or not identifiable."""
        return max(self.delay.value or 0.0, 0.0) if self.delay.std is not None else 0.0

    @property
    def measured(self) -> dict[str, Any]:
        """Identified values with their intervals."""
        chosen, armature = self.chosen, self.armature
        regrouped = {"not_identifiable_apart_from": self.regrouped, "with_exported_bodies": chosen["ia"]}
        entry = {
            "current_to_torque": _described(self.gain),
            "delay": _described(self.delay),
            "armature": regrouped if armature is None else _described(armature),
            "damping": chosen["fv"],
            "frictionloss": chosen["fs"],
            "offset": chosen["off"],
        }
        entry |= {key: _described(estimate) for key, estimate in self.electrical.items()}
        more = {"damping_cubic": chosen["f3"], "effort": self.limits.effort, "velocity": self.limits.velocity}
        return entry | {key: value for key, value in more.items() if value}


def _described(estimate: Estimate) -> dict[str, Any]:
    interval = estimate.interval()
    return {"value": estimate.value, "unit": estimate.unit} | ({"interval": list(interval)} if interval else {})


def _actuators(model: ConsistentModel) -> list[Actuator]:
    result, actuators = model.result, []
    base = result.base
    for joint in result.robot.motors:
        limits, delay = result.robot.joint(joint).limits, result.delays[joint]
        gain = replace(result.drive_gains[joint], value=model.gains[joint])
        chosen = {kind: model.of(kind, joint) for kind in ("ia", "fv", "fs", "f3", "off")}
        rows = np.flatnonzero(base.matrix[:, result.idm.parameter_names.index(Parameter("ia", joint))])
        names, armature = [base.names[row] for row in rows], None
        if len(rows) == 1 and np.count_nonzero(base.matrix[rows[0]]) == 1:  # a base parameter itself
            estimate = result.parameters[names[0]]
            if estimate.value is not None:
                armature = replace(estimate, value=chosen["ia"])
        regrouped = names[0] if names else ""
        names_of_motor = {key: Parameter(kind, joint) for key, kind in ELECTRICAL.items()}
        electrical = {key: result.motors[name] for key, name in names_of_motor.items() if name in result.motors}
        actuators.append(Actuator(joint, limits, gain, delay, electrical, chosen, armature, regrouped))
    return actuators


def export_mujoco(result: IdentifiedModel, out: Path) -> Exported:
    """Write ``NAME_actuators.xml``, and ``NAME.xml``, the bodies that include it; raises GtauError."""
    model, name = consistent_model(result, "mujoco-actuators"), identifier(result.robot.name)
    motors = _actuators(model)
    texts, notes, figures = _body_texts(model, motors)
    notes += _notes(motors)
    if limited := [motor.joint for motor in motors if motor.limits.velocity is not None]:
        notes.append(f"MuJoCo has no limit of speed, so the files do not limit the speed of {', '.join(limited)}")
    if not _delays(imported()) and any(motor.lag for motor in motors):
        notes.append("this MuJoCo has no delay of actuators: delays are not in the files")
    files = {f"{name}.xml": texts["whole"], f"{name}_actuators.xml": texts["actuators"]}
    return Exported(written(out, files), tuple(notes), figures)


def export_mjlab(result: IdentifiedModel, out: Path) -> Exported:
    """Write ``NAME_mjlab.yaml`` and the bodies, ``NAME_body.xml``, into ``out``; raises GtauError."""
    model, name = consistent_model(result, "mjlab"), identifier(result.robot.name)
    motors, body = _actuators(model), f"{name}_body.xml"
    texts, notes, figures = _body_texts(model, motors)
    entries = [{"target_names_expr": [motor.joint], **_fields(motor)} for motor in motors]
    head = MJLAB_HEAD.format(robot=result.robot.name, body=body)
    document = _yaml_file(head, {"timestep": TIMESTEP, "actuators": entries}, motors)
    files = written(out, {f"{name}_mjlab.yaml": document, body: texts["bodies"]})
    return Exported(files, (*notes, *_notes(motors, "mjlab")), figures)


def export_isaaclab(result: IdentifiedModel, out: Path) -> Exported:
    """Write ``NAME_isaaclab.yaml``, and the bodies as in the export to URDF, into ``out``; raises GtauError."""
    model, name = consistent_model(result, "isaaclab"), identifier(result.robot.name)
    bodies, motors = urdf.export(result, out), _actuators(model)
    entries = {motor.joint: _fields(motor) for motor in motors}
    actuator: dict[str, Any] = {"joint_names_expr": list(entries)}
    for field, key in ISAACLAB.items():
        if values := {joint: entry[key] for joint, entry in entries.items() if key in entry}:
            actuator[field] = values
    actuator["min_delay"] = min(entry["delay_min_lag"] for entry in entries.values())
    actuator["max_delay"] = max(entry["delay_max_lag"] for entry in entries.values())
    document: dict[str, Any] = {"timestep": TIMESTEP, "actuator": actuator}
    head = ISAACLAB_HEAD.format(robot=result.robot.name)
    if per_volt := _per_volt(motors):
        document["dc_motor_per_volt"] = per_volt
        head += DC_MOTOR_HEAD
    if result.robot.closures:
        document["serial_equivalent"] = serial_equivalent(model)
        head += OPEN_HEAD
    files = written(out, {f"{name}_isaaclab.yaml": _yaml_file(head, document, motors)})
    lost = what_is_lost(result.robot, "Isaac Lab", name)
    notes = [lost] * bool(lost) + [note for note in bodies.notes if note != bodies.lost]
    return Exported((*files, *bodies.files), (*notes, *_notes(motors, "Isaac Lab")), bodies.figures, lost)


def _per_volt(motors: Sequence[Actuator]) -> dict[str, dict[str, float]]:
    """Compute the stall torque and the speed without load by joint, for a volt of supply; empty without voltages."""
    stall, fastest = dict[str, float](), dict[str, float]()
    for motor in (motor for motor in motors if motor.electrical):
        resistance, back_emf = (abs(motor.electrical[key].value or np.nan) for key in ELECTRICAL)
        stall[motor.joint], fastest[motor.joint] = abs(motor.gain.value or 0.0) / resistance, 1 / back_emf
    return {"saturation_effort": stall, "velocity_limit": fastest} if stall else {}


def _fields(motor: Actuator) -> dict[str, Any]:
    least, most = (max(round(end / TIMESTEP), 0) for end in motor.delay.interval() or (motor.lag, motor.lag))
    fields = {
        "armature": None if motor.armature is None else motor.armature.value,
        "frictionloss": motor.chosen["fs"],
        "viscous_damping": motor.chosen["fv"],
        "effort_limit": motor.limits.effort,
        "velocity_limit": motor.limits.velocity,
        "delay_min_lag": least,
        "delay_max_lag": most,
    }
    return {field: value for field, value in fields.items() if value is not None}


def _notes(motors: Sequence[Actuator], target: str = "") -> list[str]:
    """Note parameters that are not identifiable or missing in the robot's file, or have no field in the ``target``."""
    rotors = [f"'{motor.joint}' ({motor.regrouped or 'no effect'})" for motor in motors if motor.armature is None]
    unlimited = [motor.joint for motor in motors if motor.limits.effort is None]
    unknown = [motor.joint for motor in motors if motor.delay.std is None]
    early = [motor.joint for motor in motors if motor.joint not in unknown and (motor.delay.value or 0.0) < 0]
    bent = [motor.joint for motor in motors if target and motor.chosen["f3"]]
    offset = [motor.joint for motor in motors if target and motor.chosen["off"]]
    unrun = [target] * bool(target)
    notes = {
        "the armature is not identifiable apart from the inertia of links, whose sum is the base parameter in "
        "brackets: {}; its value in the exported bodies was chosen and goes with them alone": rotors,
        "the robot file has no effort limit of {}: none is in the files": unlimited,
        "the delay of {} is not identifiable, and 0 in the files": unknown,
        "the delay of {} is estimated below 0, and 0 in the files": early,
        "the YAML file was not run in {}: its keys are the fields of its documentation": unrun,
        f"{target} has no friction cubic in speed, which is under 'measured': {{}}": bent,
        f"offsets of torque are under 'measured', as {target} has none: {{}}": offset,
    }
    return [note.format(", ".join(names)) for note, names in notes.items() if names]


def _yaml_file(head: str, document: dict[str, Any], motors: Sequence[Actuator]) -> str:
    """Write a YAML file with a comment on top and the identified values of the motors."""
    measured = {motor.joint: motor.measured for motor in motors}
    return textwrap.indent(f"{head}\n", "# ") + yaml_text(document | {"measured": measured})


def _body_texts(
    model: ConsistentModel, motors: Sequence[Actuator]
) -> tuple[dict[str, str], list[str], dict[str, float]]:
    """Split the MJCF export: ``bodies`` alone, a ``whole`` that includes the ``actuators``; with notes and figures."""
    mujoco = imported()
    text, notes, figures = model_text(mujoco, model, delays=True)
    root = ElementTree.fromstring(text)
    driven = {motor.joint for motor in motors}
    section = root.find("actuator")
    assert section is not None
    for element in [element for element in section if element.get("name") in driven]:
        section.remove(element)  # springs stay
    if not len(section):
        root.remove(section)
    texts = {"bodies": xml_text(root)}
    drives = Element("mujoco")
    outer = SubElement(SubElement(drives, "default"), "default", {"class": "drives"})
    for joint in root.iter("joint"):
        if (name := joint.get("name")) in driven:  # an equality names no joint
            values = {key: joint.attrib.pop(key) for key in DRIVE_ATTRIBUTES if key in joint.attrib}
            SubElement(SubElement(outer, "default", {"class": f"drive {name}"}), "joint", values)
            joint.set("class", f"drive {name}")
    elements = SubElement(drives, "actuator")
    for motor in motors:
        SubElement(elements, "general", _general(motor, STEP * _delays(mujoco)))
    numbers = SubElement(drives, "custom") if any(motor.electrical for motor in motors) else drives
    for motor in motors:
        for key, estimate in motor.electrical.items():
            SubElement(numbers, "numeric", {"name": f"{key} {motor.joint}", "data": digits(estimate.value or 0.0)})
    included = f"{identifier(model.result.robot.name)}_actuators.xml"
    root.insert(0, Element("include", {"file": included}))
    texts |= {"whole": xml_text(root), "actuators": xml_text(drives)}
    compiled(lambda: mujoco.MjModel.from_xml_string(texts["whole"], {included: texts["actuators"].encode()}))
    return texts, notes, figures


def _general(motor: Actuator, step: float) -> dict[str, str]:
    """Make an actuator whose ``ctrl`` is the current (A) and whose force is the torque at the joint."""
    gain, offset, effort = motor.gain.value or 0.0, motor.chosen["off"], motor.limits.effort
    attributes = {"name": motor.joint, "joint": motor.joint, "gainprm": digits(gain)}
    if offset:
        attributes |= {"biastype": "affine", "biasprm": digits((-offset, 0.0, 0.0))}
    if effort is not None:
        largest = effort / abs(gain)
        attributes |= {"forcerange": digits((-effort, effort)), "ctrlrange": digits((-largest, largest))}
    if step and motor.lag:
        attributes |= {"delay": digits(motor.lag), "nsample": str(ceil(motor.lag / step) + 1)}
    return attributes


def _delays(mujoco: ModuleType) -> bool:
    return hasattr(mujoco.MjsActuator, "delay")


EXPORTS = {
    "mujoco-actuators": Export(export_mujoco, simulates=True),
    "mjlab": Export(export_mjlab, simulates=True),
    "isaaclab": Export(export_isaaclab, simulates=True),
}
