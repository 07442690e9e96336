"""Read inertias from robot files, to compare with the identified ones or to use as priors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element

import numpy as np

from gtau.robots.parameter import Parameter
from gtau.robots.readers.xml_document import numbers
from gtau.robots.rigid_body import RigidBody, lumped
from gtau.robots.robot import Attachment, Pose

if TYPE_CHECKING:
    import mujoco

TENSOR = [[0, 3, 4], [3, 1, 5], [4, 5, 2]]  # places of xx yy zz xy xz yz in a tensor


def urdf_inertias(root: Element, frames: Mapping[str, Attachment]) -> tuple[tuple[str, float], ...]:
    """Read the inertial parameters of a URDF by the body that carries each link; none if no link has a mass.

    Parameters
    ----------
    root : Element
    frames : mapping
        Attachment of each link's frame.
    """
    return _stated(lumped((frames[name], body) for name, body in _urdf_bodies(root) if name in frames))


def _urdf_bodies(root: Element) -> Iterator[tuple[str, RigidBody]]:
    for link in root.findall("link"):
        name, inertial = link.get("name", ""), link.find("inertial")
        if inertial is None:
            continue
        mass, tensor, origin = (inertial.find(tag) for tag in ("mass", "inertia", "origin"))
        weight = 0.0 if mass is None else numbers(mass.get("value", ""), 1, f"mass of link '{name}'")[0]
        entries = [
            0.0 if tensor is None else numbers(tensor.get(key, "0"), 1, f"{key} of link '{name}'")[0]
            for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        ]
        xyz, rpy = (
            [0.0] * 3 if origin is None else numbers(origin.get(key, "0 0 0"), 3, f"inertial {key} of link '{name}'")
            for key in ("xyz", "rpy")
        )
        rotation = Pose(rpy=(rpy[0], rpy[1], rpy[2])).rotation
        yield name, RigidBody(weight, np.array(xyz), rotation @ np.array(entries)[TENSOR] @ rotation.T)


def mjcf_bodies(spec: mujoco.MjSpec) -> list[tuple[mujoco.MjsBody, RigidBody]]:
    """List the bodies of an MJCF file whose inertia it states, in the frames of the bodies.

    Inertias that MuJoCo would infer from shapes are ignored, as are orientations other than quaternions.
    """
    import mujoco

    from_shapes = spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    stated = [] if from_shapes else [body for body in spec.bodies[1:] if body.explicitinertial]
    if any(body.ialt.type != mujoco.mjtOrientation.mjORIENTATION_QUAT for body in stated):
        return []
    return [(body, _mjcf_body(body)) for body in stated]


def _mjcf_body(body: mujoco.MjsBody) -> RigidBody:
    from scipy.spatial.transform import Rotation

    full = np.array(body.fullinertia)
    tensor = np.diag(body.inertia) if np.isnan(full[0]) else full[TENSOR]
    rotation = Rotation.from_quat(body.iquat, scalar_first=True).as_matrix()
    return RigidBody(float(body.mass), np.array(body.ipos), rotation @ tensor @ rotation.T)


def mjcf_inertias(
    bodies: Mapping[int, RigidBody], carried: Mapping[int, Attachment], armatures: Mapping[str, float]
) -> tuple[tuple[str, float], ...]:
    """Sum the bodies of an MJCF file by their carriers, with armatures of joints as rotor inertias."""
    found = _stated(lumped((carried[number], body) for number, body in bodies.items() if number in carried))
    rotors = ((Parameter("ia", joint).name, armature) for joint, armature in armatures.items() if armature)
    return (*found, *rotors) if found else ()


def _stated(found: Mapping[str, float]) -> tuple[tuple[str, float], ...]:
    return tuple(found.items()) if any(found.values()) else ()
