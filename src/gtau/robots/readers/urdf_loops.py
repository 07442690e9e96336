"""Loops beside a URDF: the side YAML of the Gepetto models of parallel robots.

``closed_loop`` names pairs of frames that a loop ties, ``type`` says how (``3d`` or ``6d``, the default), ``name_mot``
names the motors, and ``joint_name`` with ``joint_type`` names joints that a URDF cannot describe.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, field_validator

from gtau.documents.validation import unknown, validate
from gtau.documents.yaml_document import Document, read_yaml
from gtau.errors import GtauError
from gtau.robots.readers.idle_joints import without_idle_pins
from gtau.robots.readers.urdf import UrdfTree, read_urdf_tree
from gtau.robots.robot import Attachment, Closure, Robot

KEYS = ("closed_loop", "name_mot")
"""Keys that distinguish such a file from a robot file."""


class _Loops(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    closed_loop: list[tuple[str, str]] = []
    type: list[Literal["3d", "6d"]] = []
    name_mot: list[str]
    joint_name: list[str] = []
    joint_type: list[Literal["SPHERICAL", "CARDAN", "UJOINT_XY", "UJOINT_YZ", "UJOINT_ZX", "FIXED"]] = []

    @field_validator("type", mode="before")
    @classmethod
    def _lower(cls, types: object) -> object:
        return [kind.lower() if isinstance(kind, str) else kind for kind in types] if isinstance(types, list) else types


def is_loops_file(path: Path) -> bool:
    """Decide whether the file at `path` exists and defines loops beside a URDF."""
    return path.is_file() and any(key in read_yaml(path).data for key in KEYS)


def read_urdf_with_loops(urdf: str | Path, loops: str | Path) -> Robot:
    """Read a robot from a URDF file and the YAML file beside it.

    The tree is that of :func:`gtau.robots.readers.urdf.read_urdf`. One of two coaxial pins at a loop is locked; notes
    of the robot say so.

    Parameters
    ----------
    urdf, loops : str or Path

    Returns
    -------
    Robot
        Only the joints in ``name_mot`` are actuated.

    Raises
    ------
    GtauError
        One of the files is not accepted, they do not fit each other, or no joint is actuated.
    """
    document = read_yaml(loops)
    entry = validate(_Loops, document)
    for key, other in (("type", "closed_loop"), ("joint_type", "joint_name")):
        count, needed = len(getattr(entry, key)), len(getattr(entry, other))
        if count != needed and (count or key == "joint_type"):
            raise document.error(
                (key,), f"{count} types are written for {needed} entries of {other}; write one for each"
            )
    tree = read_urdf_tree(Path(urdf), dict(zip(entry.joint_name, entry.joint_type, strict=True)))
    names = [joint.name for joint in tree.joints]
    for position, name in enumerate(entry.name_mot):
        if name not in names:
            raise document.error(("name_mot", position), unknown(f"joint '{name}'", name, names))
    for position, name in enumerate(entry.joint_name):
        if name not in tree.frames:
            raise document.error(("joint_name", position), unknown(f"joint '{name}'", name, names))
    types = entry.type or ["6d"] * len(entry.closed_loop)
    try:
        robot = Robot(
            tree.name,
            tuple(replace(joint, actuated=joint.name in entry.name_mot) for joint in tree.joints),
            closures=tuple(_closure(document, tree, k, types[k], pair) for k, pair in enumerate(entry.closed_loop)),
            couplings=tree.couplings,
            source=f"{Path(urdf).name} with {Path(loops).name}",
            notes=tree.notes,
            home_given=False,
            inertias=tree.inertias,
        )
        return without_idle_pins(robot)
    except GtauError as error:
        raise error if str(error).startswith(str(document.path)) else GtauError(f"{document.path}: {error}") from None


def _closure(document: Document, tree: UrdfTree, k: int, kind: str, pair: tuple[str, str]) -> Closure:
    ends: list[Attachment] = []
    for position, name in enumerate(pair):
        if name not in tree.frames:
            raise document.error(("closed_loop", k, position), unknown(f"frame '{name}'", name, tree.frames))
        ends.append(tree.frames[name])
    return Closure("connect" if kind == "3d" else "weld", *ends)
