"""Actuators for MuJoCo in a separate file, included by a model of the bodies."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from gtau.estimation.results.result import Result
from gtau.export.actuators import Actuator, actuator_notes, actuators
from gtau.export.consistent import ConsistentModel, consistent_model
from gtau.export.exported import Exported, written
from gtau.export.mjcf import compile_text, digits, imported, model_text
from gtau.export.names import identifier

OF_DRIVE = ("armature", "damping", "frictionloss")
"""Attributes of a joint that belong to its drive."""


@dataclass(frozen=True)
class BodyTexts:
    """MJCF texts: ``body`` alone, the ``whole`` that includes ``actuators``, and these."""

    body: str
    whole: str
    actuators: str


def export(result: Result, out: Path) -> Exported:
    """Write ``NAME_actuators.xml``, and ``NAME.xml``, the bodies that include it, into ``out``.

    Raises
    ------
    GtauError
        Where the result has no physically consistent parameters, or MuJoCo is not installed or refuses them.
    """
    model, name = consistent_model(result, "mujoco-actuators"), identifier(result.robot.name)
    texts, notes, figures = body_texts(model)
    found = actuators(model)
    said = actuator_notes(found)
    if limited := [each.joint for each in found if each.velocity is not None]:
        said.append(f"MuJoCo has no limit of speed, so those of {', '.join(limited)} are not in the files")
    if not _delays(imported()) and any(each.lag for each in found):
        said.append("this MuJoCo has no delay of actuators: delays are not in the files")
    files = written(out, {f"{name}.xml": texts.whole, f"{name}_actuators.xml": texts.actuators})
    return Exported(files, (*notes, *said), figures)


def body_texts(model: ConsistentModel) -> tuple[BodyTexts, tuple[str, ...], dict[str, float]]:
    """Split the MJCF export into bodies and actuators, with its notes and figures."""
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
    texts = BodyTexts(body, _text(root), _text(defaults))
    compile_text(mujoco, texts.whole, {name: texts.actuators})
    return texts, notes, figures


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


def _delays(mujoco: object) -> bool:
    """Decide whether this MuJoCo has delays of actuators."""
    return hasattr(mujoco.MjsActuator, "delay")  # type: ignore[attr-defined]


def _text(root: Element) -> str:
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"
