"""Links of a URDF: collision shapes, in the frames of the robot's bodies, and masses and inertias, checked.

Masses are read to compare them with the identified ones, or to use them as priors.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import product
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from gtau.documents.files import read_at_most
from gtau.documents.validation import some_of
from gtau.errors import GtauError
from gtau.robots.parameter import RigidBody
from gtau.robots.readers.source import Base
from gtau.robots.readers.urdf_tree import origin_of, read_urdf_tree
from gtau.robots.readers.xml_document import line_of, numbers
from gtau.robots.robot import GROUND, Attachment, Pose

Blob = tuple[np.ndarray, float]
"""Points (K, 3), m, and the radius of a ball about each; the convex hull of the balls encloses a shape."""
LARGEST_MESH = 64 * 2**20  # bytes
RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
TENSOR = [[0, 3, 4], [3, 1, 5], [4, 5, 2]]  # places of xx yy zz xy xz yz in a tensor
TINY = 1e-9  # kg m2: smaller inertias belong to frames that have none
SLACK = 1e-2  # of the largest principal moment over the sum of the others, as files round
HEAVIEST = 1000.0  # largest mass in kg, and over the median mass of the file
SHOWN = 4  # bodies that a note lists


def urdf_shapes(path: Path) -> tuple[dict[str, list[Blob]], dict[str, list[np.ndarray]], dict[str, int]]:
    """Read the collision shapes of a URDF, origins of links fixed to each body, and counts of meshes not read."""
    tree = read_urdf_tree(path, {}, Base())
    shapes: dict[str, list[Blob]] = {}
    ends: dict[str, list[np.ndarray]] = {}
    missing: dict[str, int] = {}
    for link in tree.root.findall("link"):
        at = tree.frames.get(link.get("name", ""))
        if at is None:
            continue
        ends.setdefault(at.body, []).append(at.placement.position)
        for collision in link.findall("collision"):
            if (geometry := collision.find("geometry")) is None:
                continue
            blob = next(filter(None, (_blob(shape, path) for shape in geometry)), None)
            if blob is None:
                missing[at.body] = missing.get(at.body, 0) + 1
                continue
            placement = at.at(origin_of(collision.find("origin"), "a collision shape")[0]).placement
            points = blob[0] @ placement.rotation.T + placement.position
            shapes.setdefault(at.body, []).append((np.asarray(points), blob[1]))
    return shapes, ends, missing


def _blob(shape: Element, path: Path) -> Blob | None:
    """Turn a box, sphere, cylinder, capsule or mesh into points and a radius; None for a missing mesh."""

    def number(key: str, count: int = 1) -> list[float]:
        return numbers(shape.get(key, ""), count, f"{key} of a {shape.tag} in <collision>")

    if shape.tag == "box":
        return np.array([*product((-0.5, 0.5), repeat=3)]) * number("size", 3), 0.0
    if shape.tag == "sphere":
        return np.zeros((1, 3)), number("radius")[0]
    if shape.tag in ("cylinder", "capsule"):
        return np.array([[0.0, 0.0, -0.5], [0.0, 0.0, 0.5]]) * number("length"), number("radius")[0]
    if shape.tag != "mesh":
        return None
    scale = numbers(shape.get("scale", "1 1 1"), 3, "scale of a mesh")
    for file in _places(shape.get("filename", ""), path):
        if file.is_file() and (points := mesh_points(file)) is not None:
            return points * scale, 0.0
    return None


def _places(name: str, path: Path) -> Iterator[Path]:
    """List possible places of a mesh file: below the folders that contain the robot's file."""
    scheme, _, rest = name.rpartition("://")
    inside = rest.partition("/")[2]
    if scheme == "package":
        yield from (folder / part for folder in path.resolve().parents for part in (rest, inside))
    elif scheme in ("", "file"):
        yield path.parent / rest


def mesh_points(path: Path) -> np.ndarray | None:
    """Read the corners (K, 3) of an STL or OBJ mesh; None for other formats or an empty mesh."""
    content = read_at_most(LARGEST_MESH, path, f"{path}: the mesh is larger than 64 MiB; give a simpler one.")
    if path.suffix.lower() == ".stl" and len(content) == 84 + RECORD.itemsize * int.from_bytes(
        content[80:84], "little"
    ):
        points = np.frombuffer(content[84:], RECORD)["corners"].reshape(-1, 3).astype(float)
    elif path.suffix.lower() in (".stl", ".obj"):
        words = (line.split() for line in content.decode("latin-1").splitlines())
        try:
            points = np.array([[*map(float, line[1:4])] for line in words if line and line[0] in ("v", "vertex")])
        except ValueError:
            raise GtauError(f"{path} is not a valid mesh: a corner is not three numbers; correct it.") from None
    else:
        return None
    return np.unique(points, axis=0) if points.ndim == 2 and len(points) and np.isfinite(points).all() else None


def urdf_bodies(root: Element) -> Iterator[tuple[str, RigidBody]]:
    """Read the mass and inertia of each link that states them."""
    for link in root.findall("link"):
        if (inertial := link.find("inertial")) is not None:
            yield link.get("name", ""), _body(link.get("name", ""), inertial)


def _body(name: str, inertial: Element) -> RigidBody:
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


def urdf_masses(root: Element, frames: Mapping[str, Attachment]) -> Iterator[str]:
    """Note implausible masses and inertias of a URDF file; ``frames`` say which body carries each link."""
    links = {link.get("name", ""): link for link in root.findall("link")}
    bodies = dict(urdf_bodies(root))
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
