"""Frames and collision shapes of a URDF's links, in the frames of the robot's bodies."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from gtau.documents.files import read_at_most
from gtau.errors import GtauError
from gtau.robots.placement import compose
from gtau.robots.readers.source import Base
from gtau.robots.readers.urdf_tree import origin_of, read_urdf_tree
from gtau.robots.readers.xml_document import numbers
from gtau.robots.robot import Placement, Pose

Blob = tuple[np.ndarray, float]
"""Points (K, 3), m, and the radius of a ball about each; the convex hull of the balls encloses a shape."""
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
            if (geometry := collision.find("geometry")) is None:
                continue
            blob = next(filter(None, (_blob(shape, path) for shape in geometry)), None)
            if blob is None:
                missing[at.body] = missing.get(at.body, 0) + 1
                continue
            placement = compose(at.placement, origin_of(collision.find("origin"), "a collision shape")[0])
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


def frame_on(body: str, frame: str | Pose, file: str | Path | None) -> tuple[str, Placement]:
    """Find a frame fixed to a ``body``, a joint or platform: its name, and its pose in the body's frame.

    The ``frame`` is empty for the body's frame, a link of the URDF ``file``, the six numbers ``x y z roll pitch yaw``
    (m, rad) from the body's frame, or a pose.
    """
    body_frame = f"the frame of '{body}'"
    if isinstance(frame, Pose):
        return f"a frame on '{body}'", frame
    if not frame:
        return body_frame, Pose()
    words = frame.replace(",", " ").split()
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        return frame, _link(body, frame, file)
    if len(numbers) != 6:
        raise GtauError(
            f"frame '{frame}' has {len(numbers)} numbers; write 'x y z roll pitch yaw' (m, rad) from {body_frame}."
        )
    x, y, z, roll, pitch, yaw = numbers
    return f"{x:g} {y:g} {z:g} m, {roll:g} {pitch:g} {yaw:g} rad from {body_frame}", Pose((x, y, z), (roll, pitch, yaw))


def links_on(body: str, file: str | Path) -> list[str]:
    """List the links of the robot's ``file`` that are fixed to a ``body``; none if it is not a URDF."""
    if Path(file).suffix.lower() != ".urdf":
        return []
    tree = read_urdf_tree(Path(file), {}, Base())
    links = (link.get("name", "") for link in tree.root.findall("link"))
    return [link for link in links if link in tree.frames and tree.frames[link].body == body]


def _link(body: str, link: str, file: str | Path | None) -> Placement:
    if file is None or Path(file).suffix.lower() != ".urdf":
        raise GtauError(
            f"frame '{link}' is the name of a link, which only a URDF has; give the URDF, or the frame as 'x y z roll "
            f"pitch yaw' (m, rad) from the frame of '{body}'."
        )
    tree = read_urdf_tree(Path(file), {}, Base())
    on_body = [name for name, frame in tree.frames.items() if frame.body == body]
    if link not in tree.frames:
        raise GtauError(f"{file} has no link '{link}'; on '{body}' are {', '.join(on_body) or 'none'}.")
    if link not in on_body:
        raise GtauError(
            f"link '{link}' of {file} is not fixed to '{body}', which carries the payload; choose from "
            f"{', '.join(on_body) or 'none, and write the pose'}."
        )
    return tree.frames[link].placement
