"""Parts of the page: refusals, reports, traces of columns, and drawings of a robot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from nicegui import ui

from gtau.doors.command import Answer
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


def refused(sentence: str) -> None:
    """Show a sentence of refusal."""
    ui.label(sentence).classes("text-negative").props("role=alert")


def refusal_of(answer: Answer | None) -> None:
    """Show with which sentence a command refused, if it did."""
    if answer is not None and answer.refusal:
        refused(answer.refusal)


def report(folder: Path, name: str) -> None:
    """Show the report that a command wrote to a project's ``folder``."""
    path = folder / name / "report.html"
    if path.exists():
        address = f"/files/{name}/report.html?{path.stat().st_mtime:.0f}"
        ui.link("Open the report alone", address, new_tab=True)
        ui.element("iframe").classes("report").props(f'src="{address}" title="report of {name}"')


def trace(values: list[float]) -> None:
    """Draw a column over its samples, to be zoomed by the wheel."""
    options = {
        "xAxis": {"type": "category", "show": False, "data": list(range(len(values)))},
        "yAxis": {"type": "value", "scale": True, "axisLabel": {"fontSize": 9}, "splitNumber": 2},
        "grid": {"left": 52, "right": 8, "top": 6, "bottom": 6},
        "dataZoom": [{"type": "inside"}],
        "animation": False,
        "series": [{"type": "line", "data": [None if value != value else value for value in values], "symbol": "none"}],
    }
    ui.echart(options).classes("grow").style("height: 90px; min-width: 200px")


def drawing_of(drawing: Drawing) -> ui.scene:
    """Draw a robot that can be turned."""
    size = max(float(abs(line).max()) for line in drawing[0])
    with ui.scene(width=340, height=260, grid=(round(4 * size + 1), 10), background_color="#dde3ea").classes(
        "max-w-full"
    ) as scene:
        draw_in(scene, drawing)
    scene.move_camera(x=0.9 * size, y=-1.5 * size, z=0.9 * size, look_at_z=0.4 * size, duration=0)
    return scene


def draw_in(scene: ui.scene, drawing: Drawing) -> None:
    """Draw lines and driven joints into a scene."""
    lines, joints = drawing
    size = max(float(abs(line).max()) for line in lines)
    with scene:
        for start, end in (line.tolist() for line in lines):
            middle = [(a + b) / 2 for a, b in zip(start, end, strict=True)]
            scene.quadratic_bezier_tube(start, middle, end, 2, 0.01 * size).material("#1f4e79")
        for name, place in joints.items():
            scene.sphere(0.02 * size).move(*place.tolist()).material("#c0392b")
            scene.text(name, "color: #222").move(*place.tolist())
