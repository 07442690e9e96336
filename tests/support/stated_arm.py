"""An arm of four joints whose URDF states inertias, and logs of the arm that has them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from sensed_logs import SensedPlant

from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.robot import Robot
from gtau.signals.run import Run

MASSES = {"j1": 6.0, "j2": 5.0, "j3": 3.0, "j4": 1.2}
JOINTS = {  # origin, axis
    "j1": ("0 0 0.3", "0 0 1"),
    "j2": ("0 0.1 0.2", "0 1 0"),
    "j3": ("0 -0.05 0.4", "0 1 0"),
    "j4": ("0.05 0 0.3", "1 0 0"),
}
FRICTION = {"fv": 1.5, "fs": 2.0, "off": 0.2, "ia": 0.4}


def urdf(masses: dict[str, float] | None = None, inertias: bool = True) -> str:
    """The file, with other masses at the same centre and radii, or without inertias."""
    links, joints, parent = ['<link name="base"/>'], [], "base"
    for name, mass in (MASSES | (masses or {})).items():
        moments = f'ixx="{0.012 * mass}" iyy="{0.011 * mass}" izz="{0.006 * mass}" ixy="{0.001 * mass}" ixz="0" iyz="0"'
        inertial = f'<origin xyz="0.03 0.01 0.12" rpy="0.2 0 0.1"/><mass value="{mass}"/><inertia {moments}/>'
        links.append(f'<link name="of_{name}">{f"<inertial>{inertial}</inertial>" if inertias else ""}</link>')
        origin, axis = JOINTS[name]
        joints.append(
            f'<joint name="{name}" type="revolute"><origin xyz="{origin}"/><parent link="{parent}"/>'
            f'<child link="of_{name}"/><axis xyz="{axis}"/>'
            '<limit lower="-2.8" upper="2.8" velocity="3" effort="150"/></joint>'
        )
        parent = f"of_{name}"
    return f'<robot name="stated arm">{"".join(links)}{"".join(joints)}</robot>'


def robot(folder: Path, masses: dict[str, float] | None = None, inertias: bool = True) -> Robot:
    """Read the robot from the file."""
    (folder / "arm.urdf").write_text(urdf(masses, inertias))
    return load_robot(folder / "arm.urdf")


def chi(true: Robot) -> dict[str, float]:
    """Standard parameters of the arm: those of its file, with rotors and friction."""
    drives = {f"{kind}_{joint}": value for joint in MASSES for kind, value in FRICTION.items()}
    return dict(true.inertias) | drives


def plant(true: Robot, amplitudes: tuple[float, ...] = (1.2, 0.9, 1.2, 1.5), noise: float = 0.3) -> SensedPlant:
    """The arm that the file describes, moved by torques that are logged with ``noise`` (N m)."""
    return SensedPlant(InverseDynamics(true), chi(true), np.ones(4), (0.0, 0.3, 0.8, 0.0), amplitudes, noise=noise)


def torque_run(made: SensedPlant, seed: int) -> Run:
    """A run whose log holds torques."""
    return replace(made.run(seed), kind="torque")
