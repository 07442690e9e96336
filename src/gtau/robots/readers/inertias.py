"""Masses and inertias in robot files: read, to compare with the identified ones or to use as priors, and checked."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element

import numpy as np

from gtau.documents.validation import some_of
from gtau.robots.parameter import Parameter, RigidBody, lumped
from gtau.robots.readers.xml_document import line_of, numbers
from gtau.robots.robot import GROUND, Attachment, Pose

if TYPE_CHECKING:
    from gtau.robots.readers.mjcf_file import MjcfFile

TENSOR = [[0, 3, 4], [3, 1, 5], [4, 5, 2]]  # places of xx yy zz xy xz yz in a tensor
TINY = 1e-9  # kg m2: smaller inertias belong to frames that have none
SLACK = 1e-2  # excess of the largest principal moment over the sum of the others: files round to a few digits
HEAVIEST = 1000.0  # largest mass in kg, and over the median mass of the file
SHOWN = 4  # bodies that a note lists


def urdf_inertias(root: Element, frames: Mapping[str, Attachment]) -> tuple[tuple[str, float], ...]:
    """Read the inertial parameters of a URDF by the body that carries each link; none if no link has a mass."""
    return _stated(lumped((frames[name], body) for name, body in _urdf_bodies(root) if name in frames))


def _urdf_bodies(root: Element) -> Iterator[tuple[str, RigidBody]]:
    for link in root.findall("link"):
        if (inertial := link.find("inertial")) is not None:
            yield link.get("name", ""), _urdf_body(link.get("name", ""), inertial)


def _urdf_body(name: str, inertial: Element) -> RigidBody:
    def read(tag: str, key: str, default: str, what: str) -> list[float]:
        element, count = inertial.find(tag), len(default.split()) or 1
        if element is None:
            return [0.0] * count
        return numbers(element.get(key, default), count, f"{what} of link '{name}'")

    (mass,) = read("mass", "value", "", "mass")
    moments = [read("inertia", f"i{axes}", "0", f"i{axes}")[0] for axes in ("xx", "yy", "zz", "xy", "xz", "yz")]
    xyz, rpy = (read("origin", key, "0 0 0", f"inertial {key}") for key in ("xyz", "rpy"))
    rotation = Pose(rpy=(rpy[0], rpy[1], rpy[2])).rotation
    return RigidBody(mass, np.array(xyz), rotation @ np.array(moments)[TENSOR] @ rotation.T)


def mjcf_inertias(file: MjcfFile, carried: Mapping[int, Attachment]) -> tuple[tuple[str, float], ...]:
    """Sum MuJoCo's inertias of an MJCF file by the carriers of the bodies; armatures of joints are rotor inertias."""
    from gtau.robots.readers.mjcf_file import name_in, rotation_in

    model = file.model
    if not file.has_masses:
        return ()

    def body(number: int) -> RigidBody:
        rotation = rotation_in(model.body_iquat[number]).as_matrix()
        tensor = rotation @ np.diag(model.body_inertia[number]) @ rotation.T
        return RigidBody(float(model.body_mass[number]), model.body_ipos[number].copy(), tensor)

    inertias = _stated(lumped((carried[number], body(number)) for number in range(1, model.nbody)))
    rotors = (
        (Parameter("ia", name_in(model, "joint", number)), float(model.dof_armature[model.jnt_dofadr[number]]))
        for number in range(model.njnt)
    )
    return (*inertias, *((name, armature) for name, armature in rotors if armature))


def _stated(parameters: Mapping[str, float]) -> tuple[tuple[str, float], ...]:
    return tuple(parameters.items()) if any(parameters.values()) else ()


def urdf_masses(root: Element, frames: Mapping[str, Attachment]) -> Iterator[str]:
    """Note implausible masses and inertias of a URDF file; ``frames`` say which body carries each link."""
    links = {link.get("name", ""): link for link in root.findall("link")}
    bodies = dict(_urdf_bodies(root))
    carried = {link: at.body for link, at in frames.items() if link in links and at.body != GROUND}
    odd = []
    for name in bodies:
        if name in carried:
            odd += _impossible(f"link '{name}'", links[name], bodies[name].inertia)
    masses = {name: bodies[name].mass if name in bodies else 0.0 for name in links}
    typical = float(np.median([mass for mass in masses.values() if mass > 1e-6] or [1.0]))
    for name, mass in masses.items():
        if mass < 0.0 or mass > max(HEAVIEST * typical, HEAVIEST):
            odd.append(f"link '{name}' (line {line_of(links[name])}) weighs {mass:,.0f} kg")
    if odd:
        yield (
            f"physically impossible masses and inertias: {some_of(odd, SHOWN, '; ')}; they are identified, not read, "
            "but correct them before you use the file elsewhere"
        )
    moved: dict[str, list[str]] = {}
    for link, joint in carried.items():
        moved.setdefault(joint, []).append(link)
    light = [group[0] for group in moved.values() if not any(masses[link] for link in group)]
    if light and any(masses.values()):  # else the file has no masses at all
        names = some_of([f"'{name}' (line {line_of(links[name])})" for name in light], SHOWN)
        yield (
            f"these links have no mass in the file, though a joint moves them: {names}; here they have parameters "
            "all the same, and where one is really massless, write 'parameters: none' for it in a saved robot file"
        )


def _impossible(name: str, element: Element, tensor: np.ndarray) -> list[str]:
    """Report impossible moments of an inertia (3, 3), kg m2: negative ones, or one above the sum of the others."""
    moments = np.linalg.eigvalsh(tensor)
    if np.abs(moments).max() < TINY:
        return []
    shown = ", ".join(f"{moment:.3g}" for moment in moments)
    where = f"{name} (line {line_of(element)}) has the principal moments {shown} kg m2"
    if moments[0] < -SLACK * abs(moments[2]):
        return [f"{where}, one of them negative"]
    if moments[2] > (1.0 + SLACK) * (moments[0] + moments[1]):
        return [f"{where}, the largest above the sum of the others"]
    return []
