"""Robots in MuJoCo that nobody identified: an MJCF file and mujoco.yaml with drawn inertias, friction and drives."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from plausible_parameters import random_bodies

from gtau.documents.markup import yaml_text
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.robot import Robot
from gtau.simulation.mujoco_plant import mujoco_positions, robot_spec


def drawn_parameters(robot: Robot, rng: np.random.Generator) -> dict[str, float]:
    """Inertias within 15 % of the file's, or random ones; rotors and viscous friction by the motors' effort."""
    stated = robot.inertias
    chi = random_bodies(robot, rng)
    if stated:
        factors = {body: rng.uniform(0.85, 1.15) for body in robot.bodies}
        chi |= {
            f"{kind}_{body}": value * factors[body]
            for (kind, body), value in by_body(stated).items()
            if body in factors and kind != "ia"
        }
    for name in robot.actuated:
        limits = robot.joint(name).limits
        effort = limits.effort or 10.0
        chi[f"ia_{name}"] = float(rng.uniform(0.003, 0.008) * effort)
        chi[f"fv_{name}"] = float(rng.uniform(0.03, 0.1) * effort / (limits.velocity or 1.0))
    return chi


def by_body(parameters: Mapping[str, float]) -> dict[tuple[str, str], float]:
    """Parameters by kind and body."""
    return {tuple(name.split("_", 1)): value for name, value in parameters.items()}  # type: ignore[misc]


def write_robot(
    source: str, folder: Path, mass: float, seed: int, drives: Mapping[str, Any] | None = None, **more: Any
) -> dict[str, float]:
    """Write robot.xml and mujoco.yaml of a robot with payload ``payload`` of this mass; return the true gains.

    ``drives`` are further entries of every drive, ``more`` those of the file.
    """
    rng, robot = np.random.default_rng(seed), load_robot(source)
    chi = drawn_parameters(robot, rng)
    spec = robot_spec(mujoco, robot, chi)
    gains, described = {}, {}
    for name in robot.actuated:
        joint = robot.joint(name)
        effort = joint.limits.effort or 10.0
        gains[name] = float(effort / rng.uniform(20.0, 40.0))
        spec.joint(name).frictionloss = float(rng.uniform(0.02, 0.05) * effort)
        quantum = 1e-5 if joint.turns else 1e-6
        noise = 0.002 * effort / gains[name]
        described[name] = {"gain": gains[name], "delay": 0.001, "noise": noise, "quantum": quantum, **(drives or {})}
    model = InverseDynamics(robot)
    home = np.array([[robot.joint(name).home] for name in robot.actuated])
    c = model.motion(home, 0 * home, 0 * home).c[:, 0]
    spec.add_key(name="home", qpos=mujoco_positions(spec.compile(), model.layout, c))
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.xml").write_text(spec.to_xml())
    load = {"body": robot.tool, "mass": mass, "center": rng.uniform(0.03, 0.08, 3).round(4).tolist()}
    truth = {"model": "robot.xml", "bandwidth": 60.0, "drives": described, "payloads": {"payload": load}}
    (folder / "mujoco.yaml").write_text(yaml_text(truth | more))
    return gains
