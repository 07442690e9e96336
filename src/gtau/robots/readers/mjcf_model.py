"""Names and poses in a compiled MuJoCo model."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.robots.geometry import pose_of
from gtau.robots.robot import Pose

if TYPE_CHECKING:
    import mujoco
    from scipy.spatial.transform import Rotation


def name_in(model: mujoco.MjModel, kind: str, number: int) -> str:
    """Return the name of an element, or its kind and number where it has none."""
    element: Any = getattr(model, kind)(number)
    return element.name or f"{kind} {number + 1}"


def rotation_in(quaternion: np.ndarray) -> Rotation:
    """Make the rotation of a quaternion (4,), w first; of zeros no rotation, as MuJoCo takes it in a keyframe."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(quaternion, scalar_first=True) if np.any(quaternion) else Rotation.identity()


def pose_in(position: np.ndarray, quaternion: np.ndarray) -> Pose:
    """Make the pose of a position (3,) and a quaternion (4,), w first."""
    return pose_of(rotation_in(quaternion).as_matrix(), position)
