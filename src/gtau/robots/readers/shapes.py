"""Collision shapes of a URDF's links, as points within a radius, in the frames of the robot's bodies."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from gtau.documents.files import read_at_most
from gtau.errors import GtauError
from gtau.robots.geometry import compose
from gtau.robots.readers.source import Base
from gtau.robots.readers.urdf_tree import read_urdf_tree
from gtau.robots.readers.xml_document import numbers
from gtau.robots.robot import Placement, Pose

Blob = tuple[np.ndarray, float]
"""Points (K, 3), m, and the radius about each: their convex hull encloses a shape."""
LARGEST_MESH = 64 * 2**20  # bytes
RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def urdf_shapes(path: Path) -> tuple[dict[str, list[Blob]], dict[str, list[np.ndarray]], dict[str, int]]:
    """Read the collision shapes of a URDF, origins of links fixed to each body, and counts of meshes not read.

    Meshes are STL or OBJ, beside the file, or below the folder that ``package://`` names. Body ``ground`` is included.
    """
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
            geometry = collision.find("geometry")
            blob = None if geometry is None else next(filter(None, (_blob(shape, path) for shape in geometry)), None)
            if blob is not None:
                placement = compose(at.placement, _origin(collision))
                shapes.setdefault(at.body, []).append((_placed(blob[0], placement), blob[1]))
            elif geometry is not None:
                missing[at.body] = missing.get(at.body, 0) + 1
    return shapes, ends, missing


def _placed(points: np.ndarray, placement: Placement) -> np.ndarray:
    return np.asarray(points @ placement.rotation.T + placement.position)


def _origin(collision: Element) -> Pose:
    origin = collision.find("origin")
    if origin is None:
        return Pose()
    xyz, rpy = (numbers(origin.get(key, "0 0 0"), 3, f"{key} of a collision shape") for key in ("xyz", "rpy"))
    return Pose((xyz[0], xyz[1], xyz[2]), (rpy[0], rpy[1], rpy[2]))


def _blob(shape: Element, path: Path) -> Blob | None:
    """Turn a box, sphere, cylinder, capsule or mesh into points and a radius; None for a mesh that is not there."""

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
    """List where the file of a mesh may be: below one of the folders that hold the robot's file."""
    scheme, _, rest = name.rpartition("://")
    inside = rest.partition("/")[2]
    if scheme == "package":
        yield from (folder / part for folder in path.resolve().parents for part in (rest, inside))
    elif scheme in ("", "file"):
        yield path.parent / rest


def mesh_points(path: Path) -> np.ndarray | None:
    """Read the corners (K, 3) of a mesh of STL or OBJ; None for any other format, or where it holds no corner."""
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
