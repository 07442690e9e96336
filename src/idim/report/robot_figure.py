"""A robot at home as a skeleton in space: links, joints, rails, closures and platforms."""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np

from idim.errors import IdimError
from idim.report.style import BLACK, BLUE, GREY, ORANGE, SKY, VERMILION, new_figure, styled
from idim.robots.assembly import assemble
from idim.robots.geometry import Frame, attached, frames, home_configuration
from idim.robots.robot import GROUND, Joint, Robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d import Axes3D

FLAT = 0.05  # a robot thinner than this share of its size is looked at from the front
PALE = "#D0D0D0"
DRIVEN: dict[str, Any] = {"color": VERMILION, "edgecolor": BLACK}
PASSIVE: dict[str, Any] = {"color": "white", "edgecolor": BLACK}


def robot_figure(robot: Robot) -> Figure:
    """Draw a robot at home, gravity pointing down the page.

    Blue lines are links, from a joint to the next, and filled faces platforms; pale lines are the base. Discs are
    revolute joints, with their axis through them, and squares prismatic ones, red where a motor moves them; diamonds
    close loops.

    Raises
    ------
    IdimError
        The loops close nowhere, or matplotlib is not installed.
    """
    if find_spec("matplotlib") is None:
        raise IdimError("pictures need matplotlib; install it with 'pip install idim[plot]'.")
    robot = assemble(robot)
    upright = _upright(np.array(robot.gravity))
    found = {
        name: (upright @ R, upright @ p) for name, (R, p) in frames(robot, home_configuration(robot)).items()
    }  # fmt: skip
    shafts = {joint.name for joint in robot.joints if joint.parameters == "drive" and joint.antecedent == GROUND}
    joints = [joint for joint in robot.joints if joint.name not in shafts]
    lines = _links(robot, joints, found)
    rails = {joint.name: _rail(joint, found) for joint in joints if joint.kind == "prismatic"}
    points = np.vstack([*lines, *rails.values(), *(frame[1][None] for frame in found.values())])
    low, high = points.min(axis=0), points.max(axis=0)
    size = float((high - low).max()) or 1.0
    with styled():
        figure = new_figure(4.2, 4.2)
        axes: Axes3D = figure.add_subplot(projection="3d", computed_zorder=False)
        for foot in (_foot(joint, found) for joint in joints if joint.antecedent == GROUND):
            axes.plot(*np.array([found[GROUND][1], foot]).T, color=PALE, linewidth=2.4, zorder=0)
        for line in lines:
            axes.plot(*line.T, color=BLUE, linewidth=2.4, solid_capstyle="round", zorder=2)
        for rail in rails.values():
            axes.plot(*rail.T, color=GREY, linewidth=5.0, solid_capstyle="butt", zorder=1)
        _platforms(axes, robot, found)
        _joints(axes, robot, joints, found, size)
        _closures(axes, robot, found)
        _triad(axes, found[GROUND][1], upright, 0.16 * size)
        _look(axes, low, high, size)
        _legend(figure, robot, joints)
        axes.set_title(robot.name)
    return figure


def _upright(gravity: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) after which gravity points along -z, with x where it was if that can be."""
    size = np.linalg.norm(gravity)
    up = -gravity / size if size else np.array([0.0, 0.0, 1.0])
    x = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = x - (x @ up) * up
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(up, x), up])


def _links(robot: Robot, joints: list[Joint], found: dict[str, Frame]) -> list[np.ndarray]:
    """Lines (2, 3) from every joint to what its link carries."""
    lines = []
    for joint in joints:
        foot = _foot(joint, found)
        if joint.antecedent != GROUND:
            lines.append(np.array([found[joint.antecedent][1], foot]))
        if joint.kind == "prismatic":
            lines.append(np.array([foot, found[joint.name][1]]))
    platforms = {platform.name for platform in robot.platforms}
    for end in (end for closure in robot.closures for end in (closure.a, closure.b)):
        if end.body not in platforms | {GROUND}:
            lines.append(np.array([found[end.body][1], attached(end, found)[1]]))
    return [line for line in lines if np.linalg.norm(line[1] - line[0]) > 1e-6] or [np.zeros((2, 3))]


def _foot(joint: Joint, found: dict[str, Frame]) -> np.ndarray:
    """Where a joint stands on the link before it, (3,)."""
    R, p = found[joint.antecedent]
    foot: np.ndarray = p + R @ joint.placement.position
    return foot


def _rail(joint: Joint, found: dict[str, Frame]) -> np.ndarray:
    """The way of a prismatic joint within its limits, (2, 3)."""
    R, p = found[joint.name]
    low, high = joint.limits.position or (joint.home, joint.home)
    return np.array([p + (end - joint.home) * (R @ np.array(joint.axis)) for end in (low, high)])


def _platforms(axes: Axes3D, robot: Robot, found: dict[str, Frame]) -> None:
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    for platform in robot.platforms:
        ends = [end for closure in robot.closures for end in (closure.a, closure.b) if end.body == platform.name]
        corners = np.array([attached(end, found)[1] for end in ends])
        centre = corners.mean(axis=0)
        if np.linalg.norm(corners - centre, axis=1).max() < 1e-6:
            axes.scatter(*centre, marker="h", s=130, color=SKY, edgecolor=BLACK, zorder=3)
            continue
        normal = np.linalg.svd(corners - centre)[2]
        angle = np.arctan2((corners - centre) @ normal[1], (corners - centre) @ normal[0])
        face = Poly3DCollection([corners[np.argsort(angle)]], facecolor=SKY, edgecolor=BLACK, alpha=0.6, zorder=3)
        axes.add_collection3d(face)


def _joints(axes: Axes3D, robot: Robot, joints: list[Joint], found: dict[str, Frame], size: float) -> None:
    for joint in joints:
        R, p = found[joint.name]
        driven = _driven(robot, joint)
        half = (0.075 if driven else 0.045) * size * (R @ np.array(joint.axis))
        if joint.kind == "revolute":
            axes.plot(*np.array([p - half, p + half]).T, color=BLACK, linewidth=1.0, zorder=4)
        style = DRIVEN if driven else PASSIVE
        marker = "o" if joint.kind == "revolute" else "s"
        if joint.kind == "prismatic":
            p = (p + _foot(joint, found)) / 2
        axes.scatter(*p, marker=marker, s=52 if driven else 26, linewidth=0.9, zorder=6 if driven else 5, **style)
        if joint.antecedent == GROUND:
            axes.plot(*np.array([p, p - [0, 0, 0.07 * size]]).T, color=GREY, linewidth=1.0, zorder=1)
            axes.scatter(*(p - [0, 0, 0.07 * size]), marker="_", s=120, color=GREY, linewidth=2.5, zorder=1)


def _driven(robot: Robot, joint: Joint) -> bool:
    return joint.actuated or any(
        joint.name == coupling.joint or joint.name in dict(coupling.ratios) for coupling in robot.couplings
    )


def _closures(axes: Axes3D, robot: Robot, found: dict[str, Frame]) -> None:
    for closure in robot.closures:
        axes.scatter(*attached(closure.a, found)[1], marker="D", s=30, color=ORANGE, edgecolor=BLACK, zorder=7)


def _triad(axes: Axes3D, origin: np.ndarray, upright: np.ndarray, length: float) -> None:
    for direction, name in zip(upright.T, "xyz", strict=True):
        end = origin + length * direction
        axes.plot(*np.array([origin, end]).T, color=GREY, linewidth=1.0, zorder=1)
        axes.text(*(origin + 1.2 * length * direction), name, color=GREY, ha="center", va="center", zorder=1)


def _look(axes: Axes3D, low: np.ndarray, high: np.ndarray, size: float) -> None:
    middle, half = (low + high) / 2, 0.56 * size
    for k, limits in enumerate((axes.set_xlim, axes.set_ylim, axes.set_zlim)):
        limits(middle[k] - half, middle[k] + half)
    axes.set_box_aspect((1, 1, 1), zoom=1.12)
    axes.set_axis_off()
    thin = int(np.argmin(high - low))
    elevation, azimuth = 24.0, -58.0
    if (high - low)[thin] < FLAT * size:
        elevation, azimuth = ((18.0, -20.0), (18.0, -72.0), (62.0, -72.0))[thin]
    axes.view_init(elev=elevation, azim=azimuth)


def _legend(figure: Figure, robot: Robot, joints: list[Joint]) -> None:
    from matplotlib.lines import Line2D

    def mark(marker: str, style: dict[str, Any]) -> Line2D:
        return Line2D([], [], marker=marker, linestyle="none", color=style["color"], markeredgecolor=style["edgecolor"])

    entries = {}
    for joint in joints:
        driven = _driven(robot, joint)
        what = ("motor, " if driven else "passive, ") + ("turns" if joint.kind == "revolute" else "slides")
        entries[what] = mark("o" if joint.kind == "revolute" else "s", DRIVEN if driven else PASSIVE)
    if robot.platforms:
        entries["platform"] = mark("h", {"color": SKY, "edgecolor": BLACK})
    if robot.closures:
        entries["closes a loop"] = mark("D", {"color": ORANGE, "edgecolor": BLACK})
    figure.legend(list(entries.values()), list(entries), loc="outside lower center", ncols=2, handletextpad=0.2)
