"""Identified model written into the robot's original URDF."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from gtau.documents.files import write_atomically
from gtau.errors import GtauError
from gtau.estimation.results.result import Result
from gtau.export.consistent import consistent_model, difference_note, differences
from gtau.export.exported import Exported
from gtau.export.input_file import InputFile, input_file
from gtau.export.names import identifier
from gtau.export.urdf import drives_text, inertial_element, notes
from gtau.robots.rigid_body import rigid_body
from gtau.robots.robot import GROUND


def export(result: Result, source: Path, out: Path) -> Exported:
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
    exported = file.save(out, said, found)
    drives = out / f"{identifier(result.robot.name)}_drives.yaml"
    write_atomically(drives, drives_text(model))
    return Exported((*exported.files, drives), exported.notes, exported.figures)


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
