"""Lines of a robot in space, at home or along a motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gtau.model.home import close_home
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.kinematics import Coordinates, poses
from gtau.report.robot_figure import foot_of, link_lines, upright_rotation
from gtau.robots.geometry import Frame
from gtau.robots.robot import GROUND, Robot

FRAMES = 60  # of an animation

Drawing = tuple[list[np.ndarray], dict[str, np.ndarray]]
"""Lines (2, 3) of links, and places (3,) of the driven joints by name, m, with gravity along -z."""


def at_home(robot: Robot) -> Drawing:
    """Draw a robot at home; raises GtauError if its loops do not close."""
    layout = Coordinates(close_home(robot))
    return _drawing(layout, layout.home)


def along(robot: Robot, motion: Path) -> list[Drawing]:
    """Draw a robot along a table of its positions, with the columns that ``gtau campaign`` writes."""
    import polars as pl

    idm = InverseDynamics(robot)
    table = pl.read_csv(motion, comment_prefix="#")
    q = table.select([f"q_{joint}" for joint in idm.actuated]).to_numpy()
    q = q[:: -(-len(q) // FRAMES)].T
    still = np.zeros_like(q)
    layout = Coordinates(close_home(robot))
    return [_drawing(layout, c) for c in idm.motion(q, still, still).c.T]


def _drawing(layout: Coordinates, c: np.ndarray) -> Drawing:
    robot = layout.robot
    upright = upright_rotation(np.array(robot.gravity))
    frames: dict[str, Frame] = {name: (upright @ R, upright @ p) for name, (R, p) in poses(layout, c).items()}
    joints = [joint for joint in robot.joints if joint.name not in robot.base]
    lines = [line for _, line in link_lines(robot, joints, frames)]
    feet = [np.array([frames[GROUND][1], foot_of(joint, frames)]) for joint in joints if joint.antecedent == GROUND]
    return lines + feet, {name: frames[name][1] for name in robot.actuated}
