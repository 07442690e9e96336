"""A robot at home as a skeleton, seen in parallel projection: base, rails, links, joints, closures and payload."""

from __future__ import annotations

from math import floor, log10
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.report.render.charts import new_figure, palette, styled
from gtau.report.robot_scene import foot_of, platform_attachments, scene_of
from gtau.robots.geometry import Frame, attached
from gtau.robots.robot import GROUND, Joint, Robot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

BLACK, BLUE, VERMILION, GREEN, ORANGE, SKY, GREY = (
    palette()[name] for name in ("c3", "c0", "c1", "c2", "c4", "c5", "c7")
)
PALE = palette()["measured"]
LETTER, AWAY = (
    (4.6, 9.0),
    6.0,
)  # points: a letter of a joint's name, width and height, and how far off the joint it stands
CORNERS = ((1, 1), (1, -1), (-1, 1), (-1, -1))  # of a joint, in which its name may stand
WIDTH, LOWEST, HIGHEST, KEY = 4.2, 1.3, 3.8, 1.05  # inches, of the page, of the drawing and of the key below it
LETTERS = 16  # of a name in the legend
SHAPES = {"revolute": "o", "prismatic": "s"}
DRIVEN: dict[str, Any] = {"color": VERMILION, "markeredgecolor": BLACK, "markersize": 7.2}
PASSIVE: dict[str, Any] = {"color": "white", "markeredgecolor": BLACK, "markersize": 5.1}
BASE: dict[str, Any] = {"color": PALE, "linewidth": 2.4, "zorder": 0}
RAIL: dict[str, Any] = {"color": GREY, "linewidth": 5.0, "solid_capstyle": "butt", "zorder": 1}
LINK: dict[str, Any] = {"linewidth": 2.4, "solid_capstyle": "round", "zorder": 2}
RING: dict[str, Any] = {
    "color": "none",
    "markeredgecolor": GREEN,
    "markersize": 13,
    "markeredgewidth": 2.4,
    "zorder": 4,
}
SPRING: dict[str, Any] = {"color": BLACK, "linewidth": 1.2, "solid_joinstyle": "round", "zorder": 3.5}
CLOSING: dict[str, Any] = {"color": ORANGE, "markeredgecolor": BLACK, "markersize": 6.5, "zorder": 7}


def robot_figure(robot: Robot) -> Figure:
    """Draw a robot at home, gravity pointing down the page.

    Pale lines are the base, grey ones the travel of prismatic joints, blue ones links, from a joint to the next, and
    filled faces platforms; the body that carries the payload is green, with the axes of its frame. Discs are revolute
    joints, with their axis through them, and squares prismatic ones, red and named where a motor moves them; diamonds
    close loops, zigzags are springs. Below are the axes of the base, and a scale.

    Raises
    ------
    GtauError
        The loops close nowhere.
    """
    scene = scene_of(robot)
    robot, view, found, joints = scene.robot, scene.view, scene.found, scene.joints
    lines, rails, feet, low, high, size = scene.lines, scene.rails, scene.feet, scene.low, scene.high, scene.size
    height = float(np.clip(WIDTH * (high[1] - low[1] + 0.2 * size) / (1.2 * size), LOWEST, HIGHEST))
    with styled():
        figure, below = new_figure(WIDTH, height + KEY, layout=None), KEY / (height + KEY)
        axes = figure.add_axes((0.02, below, 0.96, 0.92 - below), aspect="equal")
        figure.text(0.03, 0.98, robot.name, va="top", fontsize=9.5, fontweight="bold")
        for foot in feet:
            _line(axes, view, found[GROUND][1], foot, **BASE)
            _stand(axes, view @ foot, 0.06 * size)
        for rail in rails:
            _line(axes, view, *rail, **RAIL)
        for body, line in lines:
            _line(axes, view, *line, color=GREEN if body == robot.tool else BLUE, **LINK)
        _platforms(axes, view, robot, found)
        if robot.tool not in {body for body, _ in lines} | {platform.name for platform in robot.platforms}:
            axes.plot(*(view @ found[robot.tool][1]), marker="o", **RING)
        tool, ends = view @ found[robot.tool][1], 0.13 * size * view @ found[robot.tool][0]
        _triad(axes, tool, ends, GREEN, zorder=6.5)
        places = _joints(axes, view, robot, joints, found, size)
        closings = scene.closings
        for spring in scene.springs:
            axes.plot(*spring.T, **SPRING)
        for place in closings:
            axes.plot(*place, marker="D", **CLOSING)
        strokes = [np.linspace(line[0], line[1], 30) @ view.T for _, line in lines]
        strokes += [
            np.linspace(view @ found[end.body][1], view @ attached(end, found)[1], 30)
            for end in platform_attachments(robot)
        ]
        point = 1.2 * size / (72 * WIDTH)
        marks = np.array([*places.values(), *closings, tool, *(tool + ends.T)])
        _names(axes, robot, places, marks, np.vstack([*strokes, tool]), point)
        axes.margins(0.08)
        _scale(axes, low - [0.0, 0.15 * size], size)
        axes.set_axis_off()
        left, right = (figure.add_axes((x, 0.0, width, below)) for x, width in ((0.02, 0.24), (0.28, 0.7)))
        axes_of = "world" if robot.floating else "base"
        _compass(left, view @ scene.upright, axes_of, bool(np.any(robot.gravity)))
        _legend(right, robot, joints, {body for body, _ in lines})
    return figure


def _line(axes: Axes, view: np.ndarray, start: np.ndarray, end: np.ndarray, **style: Any) -> None:
    axes.plot(*(view @ np.array([start, end]).T), **style)


def _stand(axes: Axes, point: np.ndarray, length: float) -> None:
    """Draw the foot of a joint on the base."""
    x, y = point
    axes.plot([x, x], [y, y - length], **(BASE | {"linewidth": 1.2}))
    axes.plot([x - length / 2, x + length / 2], [y - length, y - length], **BASE)


def _platforms(axes: Axes, view: np.ndarray, robot: Robot, found: dict[str, Frame]) -> None:
    for platform in robot.platforms:
        color = GREEN if platform.name == robot.tool else SKY
        corners = np.array(
            [attached(end, found)[1] for end in platform_attachments(robot) if end.body == platform.name]
        )
        centre = corners.mean(axis=0)
        if np.linalg.norm(corners - centre, axis=1).max() < 1e-6:
            axes.plot(*(view @ centre), marker="h", markersize=11, color=color, markeredgecolor=BLACK, zorder=3)
            continue
        normal = np.linalg.svd(corners - centre)[2]
        angle = np.arctan2((corners - centre) @ normal[1], (corners - centre) @ normal[0])
        axes.fill(*(view @ corners[np.argsort(angle)].T), facecolor=color, edgecolor=BLACK, alpha=0.6, zorder=3)


def _joints(
    axes: Axes, view: np.ndarray, robot: Robot, joints: list[Joint], found: dict[str, Frame], size: float
) -> dict[str, np.ndarray]:
    """Draw the joints; where they are on the page, by name."""
    places = {}
    for joint in joints:
        R, p = found[joint.name]
        driven = joint.name in robot.driven
        if joint.kind == "prismatic":
            p = (p + foot_of(joint, found)) / 2
        else:
            half = (0.06 if driven else 0.04) * size * (R @ np.array(joint.axis))
            _line(axes, view, p - half, p + half, color=BLACK, linewidth=1.0, zorder=4)
        style = DRIVEN if driven else PASSIVE
        axes.plot(*(view @ p), marker=SHAPES[joint.kind], zorder=6 if driven else 5, **style)
        places[joint.name] = view @ p
    return places


def _names(
    axes: Axes, robot: Robot, places: dict[str, np.ndarray], marks: np.ndarray, strokes: np.ndarray, point: float
) -> None:
    """Name what motors move, each in the corner with the fewest marks, then lines, under it; a point is so many m."""
    named: dict[tuple[float, ...], list[str]] = {}
    for joint in places:
        if joint in robot.driven:
            named.setdefault(tuple(np.round(places[joint] / (3 * point))), []).append(joint)
    for names in named.values():
        place, text = places[names[0]], ", ".join(names)
        half = point * np.array([LETTER[0] * len(text), LETTER[1]]) / 2
        centres = place + np.array(CORNERS) * (half + AWAY * point)
        covered = [(_within(marks, centre, half + 4 * point), _within(strokes, centre, half)) for centre in centres]
        best = min(range(len(CORNERS)), key=covered.__getitem__)
        right, up = CORNERS[best]
        label = axes.annotate(
            text, tuple(place), (right * AWAY, up * AWAY), textcoords="offset points",
            ha="left" if right > 0 else "right", va="bottom" if up > 0 else "top", fontsize=7.5, zorder=4.5,
        )  # fmt: skip
        label.set_bbox({"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.6})
        marks = np.vstack([marks, centres[best] + np.linspace(-half, half, 9)])  # no name hides another
        axes.update_datalim([centres[best] - half, centres[best] + half])  # none leaves the figure


def _within(points: np.ndarray, centre: np.ndarray, half: np.ndarray) -> int:
    """Count the points (N, 2) that are in a box."""
    return int((np.abs(points - centre) < half).all(axis=1).sum())


def _triad(axes: Axes, origin: np.ndarray, ends: np.ndarray, color: str, zorder: float = 1) -> None:
    """Draw three axes with their names; ``ends`` (2, 3) relative to ``origin`` (2,)."""
    from matplotlib.patheffects import withStroke

    for end, name in zip(ends.T, "xyz", strict=True):
        axes.annotate(
            name, tuple(origin), tuple(origin + end), color=color, fontsize=7.5, zorder=zorder,
            ha="center", va="center", path_effects=[withStroke(linewidth=1.6, foreground="white")],
            arrowprops={"arrowstyle": "-", "color": color, "linewidth": 1.2, "shrinkA": 0, "shrinkB": 0},
        )  # fmt: skip


def _compass(axes: Axes, base: np.ndarray, name: str, gravity: bool) -> None:
    """Draw the axes of the base (2, 3), and which way gravity points."""
    _triad(axes, np.zeros(2), base, GREY)
    axes.text(0.0, -1.75, name, ha="center", va="center", color=GREY, fontsize=7.5)
    if gravity:
        axes.annotate("", (2.0, -1.0), (2.0, 0.9), arrowprops={"arrowstyle": "-|>", "color": BLACK, "linewidth": 1.3})
        axes.text(2.0, -1.75, "gravity", ha="center", va="center", fontsize=7.5)
    axes.set(xlim=(-1.2, 2.8), ylim=(-2.0, 1.2), aspect="equal")
    axes.set_axis_off()


def _scale(axes: Axes, start: np.ndarray, size: float) -> None:
    """Draw a bar of a round length, about a fifth of the drawing."""
    decade = 10.0 ** floor(log10(0.25 * size))
    length = max(step * decade for step in (1, 2, 5) if step * decade <= 0.25 * size)
    x, y = start
    axes.plot([x, x + length], [y, y], color=BLACK, linewidth=1.2, marker="|", markersize=5, markeredgewidth=1.2)
    label = f"{length:g} m" if length >= 0.1 else f"{1e3 * length:g} mm"
    axes.annotate(label, (x + length, y), (6, 0), textcoords="offset points", va="center", fontsize=7.5)


def _legend(axes: Axes, robot: Robot, joints: list[Joint], linked: set[str]) -> None:
    """Draw the key to what is drawn; ``linked`` are the bodies that have lines."""
    from matplotlib.lines import Line2D

    def mark(marker: str, **style: Any) -> Line2D:
        return Line2D([], [], marker=marker, linestyle="none", **style)

    entries: dict[str, Line2D] = {}
    for joint in joints:
        driven = joint.name in robot.driven
        what = ("motor, " if driven else "passive, ") + ("turns" if joint.kind == "revolute" else "slides")
        entries[what] = mark(SHAPES[joint.kind], **(DRIVEN if driven else PASSIVE))
    if robot.springs:
        entries["spring"] = Line2D([], [], **SPRING)
    if robot.closures:
        entries["closes a loop"] = mark("D", **CLOSING)
    if any(joint.limits.position for joint in joints if joint.kind == "prismatic"):
        entries["travel"] = Line2D([], [], **RAIL)
    if linked - {robot.tool}:
        entries["link"] = Line2D([], [], color=BLUE, **LINK)
    if not robot.floating:
        entries["base"] = Line2D([], [], **BASE)
    hexagon: dict[str, Any] = {"markeredgecolor": BLACK, "markersize": 9}
    if any(platform.name != robot.tool for platform in robot.platforms):
        entries["platform"] = mark("h", color=SKY, **hexagon)
    carrier = any(platform.name == robot.tool for platform in robot.platforms)
    tool = robot.tool if len(robot.tool) <= LETTERS else robot.tool[: LETTERS - 1] + "\u2026"
    if carrier:
        carries = mark("h", color=GREEN, **hexagon)
    elif robot.tool in linked:
        carries = Line2D([], [], color=GREEN, **LINK)
    else:
        carries = mark("o", **(RING | {"markersize": 8, "markeredgewidth": 1.8}))
    entries[f"payload on {tool}"] = carries
    axes.legend(list(entries.values()), list(entries), loc="center", ncols=2, handlelength=1.6, fontsize=7.5)
    axes.set_axis_off()
