"""What a file without loops lacks of a robot that has some, and the inertia that its motors move with loops closed.

At rest, torques are ``M(q) qdd + g(q)`` with ``M = J^T I J``: I is the inertia of all bodies and rotors in the
coordinates of the tree, J the motion of these by the motors. A tree of motors alone with ``M`` of its home as their
armature moves like the robot near home, but for gravity.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gtau.export.consistent import ConsistentModel
from gtau.model.singularities import random_motion
from gtau.robots.parameter import torque_unit
from gtau.robots.robot import Robot

POSES = 200  # at random within the workspace


def motor_inertias(model: ConsistentModel) -> np.ndarray:
    """Compute the inertias M (1 + POSES, n, n) at the motors, with loops closed, at home and at random poses."""
    idm = model.result.idm
    assert idm.loops is not None
    poses = random_motion(idm, POSES, np.random.default_rng(0)).c
    c, n = np.column_stack([idm.loops.home, poses]), len(idm.actuated)
    values = np.array([model.standard.get(name, 0.0) for name in idm.parameter_names])
    still = np.zeros((n, c.shape[1]))

    def torques(qdd: np.ndarray) -> np.ndarray:
        return idm.full.torques_along(idm.layout, idm.rates(c, still, qdd), values)

    at_rest = torques(still)
    unit = (np.tile(axis[:, None], c.shape[1]) for axis in np.eye(n))
    return np.stack([torques(qdd) - at_rest for qdd in unit], axis=-1).transpose(1, 0, 2)


def serial_equivalent(model: ConsistentModel) -> dict[str, Any]:
    """Describe the inertia at each motor with loops closed: at home, its range, and its parts."""
    M, robot = motor_inertias(model), model.result.robot
    described = {}
    for k, joint in enumerate(robot.actuated):
        home, armature = float(M[0, k, k]), model.of("ia", joint)
        described[joint] = {
            "inertia": home,
            "range": [float(M[:, k, k].min()), float(M[:, k, k].max())],
            "armature": armature,
            "reflected": home - armature,
            "coupling": dict(zip(robot.actuated, map(float, M[0, k]), strict=True)),
            "unit": torque_unit(robot, joint).replace("N m", "kg m2").replace("N", "kg"),
        }
    return described


def what_is_lost(robot: Robot, target: str, name: str) -> str:
    """Say that the files of a ``target`` have no loops; empty where the robot has none."""
    if not robot.closures:
        return ""
    count = len(robot.closures)
    passive = [joint.name for joint in robot.joints if not joint.actuated]
    passive += [platform.name for platform in robot.platforms]
    tied = "; ".join(f"'{closure.a.body}' to '{closure.b.body}'" for closure in robot.closures)
    return (
        f"OPEN TREE: {target} has no closed loops, so the files lack {count} closure{'s' * (count > 1)} ({tied}), and "
        f"{', '.join(passive)} swing freely: without the closures in {name}.yaml this is another robot; the inertia at "
        f"each motor with loops closed, at home and its range, is under 'serial_equivalent' in {name}_drives.yaml"
    )
