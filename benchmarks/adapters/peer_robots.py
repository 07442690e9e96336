"""Robots as files that peers read: a URDF of a tree that gtau knows, and files without what is only seen."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from engines import Pinocchio

from gtau.robots.robot import INERTIAL, Robot


def write_urdf(robot: Robot, path: Path, chi: dict[str, float]) -> Path:
    """A URDF of a tree: bodies of ``chi``, or of 1 kg each where only the geometry is known."""
    dull = dict.fromkeys(INERTIAL, 0.0) | {"m": 1.0, "xx": 0.1, "yy": 0.1, "zz": 0.1}
    full = {f"{kind}_{joint.name}": value for joint in robot.joints for kind, value in dull.items()}
    model = Pinocchio(robot, chi or full).model
    root = ElementTree.Element("robot", name="robot")

    def pose(parent: ElementTree.Element, translation: np.ndarray, rotation: np.ndarray) -> None:
        numbers = {"xyz": translation, "rpy": pin.rpy.matrixToRpy(rotation)}
        written = {key: " ".join(map(repr, map(float, values))) for key, values in numbers.items()}
        ElementTree.SubElement(parent, "origin", written)

    ElementTree.SubElement(root, "link", name="base")
    names = ["base", *(f"link_{joint.name}" for joint in robot.joints)]
    tilt = rotation_to(np.array(robot.gravity))
    for k, joint in enumerate(robot.joints, start=1):
        link = ElementTree.SubElement(ElementTree.SubElement(root, "link", name=names[k]), "inertial")
        body = model.inertias[k]
        pose(link, body.lever, np.eye(3))
        ElementTree.SubElement(link, "mass", value=repr(float(body.mass)))
        entries = {f"i{a}{b}": repr(float(body.inertia[i, j])) for (i, a), (j, b) in PAIRS}
        ElementTree.SubElement(link, "inertia", entries)
        element = ElementTree.SubElement(root, "joint", name=joint.name, type=joint.kind)
        ElementTree.SubElement(element, "parent", link=names[model.parents[k]])
        ElementTree.SubElement(element, "child", link=names[k])
        placement = model.jointPlacements[k]
        first = tilt if model.parents[k] == 0 else np.eye(3)
        pose(element, first @ placement.translation, first @ placement.rotation)
        ElementTree.SubElement(element, "axis", xyz=" ".join(map(str, joint.axis)))
        ElementTree.SubElement(element, "limit", effort="1e4", velocity="1e3", lower="-1e3", upper="1e3")
    ElementTree.ElementTree(root).write(path)
    return path


PAIRS = [(a, b) for k, a in enumerate(enumerate("xyz")) for b in list(enumerate("xyz"))[k:]]


def rotation_to(gravity: np.ndarray) -> np.ndarray:
    """The base's rotation (3, 3) that lets gravity point along -z, as in every URDF."""
    down = np.array([0.0, 0.0, -1.0])
    size = np.linalg.norm(gravity)
    return np.eye(3) if size == 0 else pin.Quaternion.FromTwoVectors(gravity / size, down).matrix()


def without_meshes(source: Path, path: Path) -> Path:
    """A robot's file without what is only seen or touched."""
    tree = ElementTree.parse(source)
    for parent in list(tree.getroot().iter()):
        for child in [each for each in parent if each.tag in ("visual", "collision", "mesh", "material", "gazebo")]:
            parent.remove(child)
        for child in [each for each in parent if each.tag == "geom" and "mesh" in each.attrib]:
            parent.remove(child)
    for element in tree.getroot().iter():  # a name that MuJoCo keeps for itself
        element.attrib |= {key: "stand" for key, name in element.attrib.items() if name == "world"}
    if source.suffix == ".urdf":  # MuJoCo compiles no link without mass
        extension = ElementTree.SubElement(tree.getroot(), "mujoco")
        ElementTree.SubElement(extension, "compiler", boundmass="1e-3", boundinertia="1e-6")
    tree.write(path)
    return path
