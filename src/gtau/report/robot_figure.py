"""A robot at home as a skeleton, seen in parallel projection: base, rails, links, joints, closures and payload."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import floor, log10
from typing import TYPE_CHECKING

import numpy as np

from gtau.report.render.charts import new_figure, palette, styled
from gtau.report.render.sketch import Item, Mark, Path, Sketch, Word, draw_sketch
from gtau.report.robot_scene import Scene, foot_of, platform_attachments, scene_of
from gtau.robots.geometry import attached
from gtau.robots.robot import GROUND, Joint, Robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK, BLUE, RED, GREEN, ORANGE, SKY, GREY = "c3", "c0", "c1", "c2", "c4", "c5", "c7"
WIDTH, TALLEST = 302.0, 274.0  # points, of the sheet, and of the robot on it
MARGIN = 12.0  # points, around the robot
KEY, ROW = 66.0, 13.0  # points, of the strip with the axes of the base below it, and of a row of the key
LETTER, AWAY = (4.6, 9.0), 6.0  # points: a letter of a name, width and height, and how far off its joint a name stands
CORNERS = ((1, 1), (1, -1), (-1, 1), (-1, -1))  # of a joint, in which its name may stand
LETTERS = 16  # of a name in the key
ORIGIN = np.zeros(2)
DRIVEN = Mark(ORIGIN, size=8.2, fill=RED, stroke=INK)
PASSIVE = Mark(ORIGIN, size=6.1, fill="page", stroke=INK)
BASE = Path(ORIGIN, "measured", 2.4)
RAIL = Path(ORIGIN, GREY, 5.0)
LINK = Path(ORIGIN, BLUE, 2.4, round=True)
RING = Mark(ORIGIN, size=13.0, stroke=GREEN, width=2.4)
SPRING = Path(ORIGIN, INK, 1.2, round=True)
CLOSING = Mark(ORIGIN, "diamond", 6.0, ORANGE, INK)
AXLE = Path(ORIGIN, INK, 1.0)


def robot_figure(robot: Robot) -> Figure:
    """Draw the sketch of a robot as a figure.

    Raises
    ------
    GtauError
        The loops close nowhere.
    """
    sketch = robot_sketch(robot)
    with styled():
        figure = new_figure(sketch.size[0] / 72, sketch.size[1] / 72, layout=None)
        draw_sketch(figure.add_axes((0.0, 0.0, 1.0, 1.0)), sketch, palette())
    return figure


def robot_sketch(robot: Robot) -> Sketch:
    """Lay out a robot at home, gravity pointing down the page.

    Pale lines are the base, grey ones the travel of prismatic joints, blue ones links, from a joint to the next, and
    filled faces platforms; the body that carries the payload is green, with the axes of its frame. Discs are revolute
    joints, with their axis through them, and squares prismatic ones, red and named where a motor moves them; diamonds
    close loops, zigzags are springs. Below are the axes of the base, a scale and a key.

    Raises
    ------
    GtauError
        The loops close nowhere.
    """
    scene = scene_of(robot)
    span = np.maximum(scene.high - scene.low, 1e-9)
    scale = float(min((WIDTH - 2 * MARGIN) / (1.2 * scene.size), TALLEST / span[1]))
    drawn = [*_skeleton(scene, scale)]
    drawn += _names(scene, scale, drawn)
    corners = np.vstack([_corners(each) for each in drawn])
    low, high = corners.min(axis=0), corners.max(axis=0)
    entries = list(_entries(scene))
    strip = max(KEY, ROW * (len(entries) // 2 + 1))
    width = max(WIDTH, high[0] - low[0] + 2 * MARGIN)
    head = 20.0 + MARGIN
    height = strip + 24.0 + high[1] - low[1] + head
    shift = np.array([(width - low[0] - high[0]) / 2, strip + 24.0 - low[1]])
    items = [*(_moved(each, shift) for each in drawn), *_scale_bar(scale, scene.size, np.array([MARGIN, strip + 8.0]))]
    items += _compass(scene, np.array([34.0, strip / 2 + 4.0]))
    for k, (words, sample) in enumerate(entries):
        alone = k == len(entries) - 1  # the longest, below the others
        column, row = (0, (k + 1) // 2) if alone else (k % 2, k // 2)
        place = np.array([108.0 + 96.0 * column, strip - ROW * (row + 0.6)])
        items += [_sample(sample, place), Word(words, _beside(place, 13.0, 0.0), "start")]
    title = Word(scene.robot.name, np.array([6.0, height - 9.0]), "start", "ink", 9.5, bold=True)
    return Sketch((width, height), (*items, title))


def _skeleton(scene: Scene, scale: float) -> Iterator[Item]:
    """Draw base, links, platforms, joints, springs and closures; the origin is that of the scene."""
    robot, found = scene.robot, scene.found

    def on_page(*points: np.ndarray) -> np.ndarray:
        return np.asarray(scale * np.array(points) @ scene.view.T)

    for foot in scene.feet:
        yield replace(BASE, points=on_page(found[GROUND][1], foot))
        (x, y), size = on_page(foot)[0], 0.06 * scale * scene.size
        yield replace(BASE, points=np.array([(x, y), (x, y - size)]), width=1.2)
        yield replace(BASE, points=np.array([(x - size / 2, y - size), (x + size / 2, y - size)]))
    for rail in scene.rails:
        yield replace(RAIL, points=on_page(*rail))
    for body, line in scene.lines:
        yield replace(LINK, points=on_page(*line), stroke=GREEN if body == robot.tool else BLUE)
    for platform in robot.platforms:
        colour = GREEN if platform.name == robot.tool else SKY
        ends = [attached(end, found)[1] for end in platform_attachments(robot) if end.body == platform.name]
        corners = np.array(ends) - np.mean(ends, axis=0)
        if np.linalg.norm(corners, axis=1).max() < 1e-6:
            yield Mark(on_page(np.mean(ends, axis=0))[0], "hexagon", 11.0, colour, INK)
            continue
        normal = np.linalg.svd(corners)[2]
        angle = np.arctan2(corners @ normal[1], corners @ normal[0])
        yield Path(on_page(*np.array(ends)[np.argsort(angle)]), INK, 1.0, colour, 0.6)
    R, tool = found[robot.tool]
    if robot.tool not in {body for body, _ in scene.lines} | {platform.name for platform in robot.platforms}:
        yield replace(RING, place=on_page(tool)[0])
    for joint in sorted(scene.joints, key=lambda joint: joint.name in robot.driven):  # driven ones on top
        if joint.turns:
            half = (0.06 if joint.name in robot.driven else 0.04) * scene.size
            axis, place = half * (found[joint.name][0] @ np.array(joint.axis)), _place(scene, joint)
            yield replace(AXLE, points=on_page(place - axis, place + axis))
        yield _mark(joint, robot, on_page(_place(scene, joint))[0])
    yield from _triad(on_page(tool)[0], 0.13 * scale * scene.size * scene.view @ R, GREEN)
    yield from (replace(SPRING, points=scale * spring) for spring in scene.springs)
    yield from (replace(CLOSING, place=scale * place) for place in scene.closings)


def _place(scene: Scene, joint: Joint) -> np.ndarray:
    """Locate the mark of a joint, (3,)."""
    place = scene.found[joint.name][1]
    return np.asarray((place + foot_of(joint, scene.found)) / 2 if joint.kind == "prismatic" else place)


def _mark(joint: Joint, robot: Robot, place: np.ndarray) -> Mark:
    style = DRIVEN if joint.name in robot.driven else PASSIVE
    return replace(style, place=place, shape="disc" if joint.turns else "square")


def _names(scene: Scene, scale: float, drawn: list[Item]) -> list[Item]:
    """Name what motors move, each in the corner with the fewest marks, then lines, under it."""
    marks = np.array([each.place for each in drawn if not isinstance(each, Path)])
    strokes = np.vstack([each.points[:1] + np.linspace(0, 1, 30)[:, None] * (each.points[1:2] - each.points[:1])
                         for each in drawn if isinstance(each, Path)])  # fmt: skip
    named: dict[tuple[float, ...], tuple[np.ndarray, list[str]]] = {}
    for joint in scene.joints:
        if joint.name in scene.robot.driven:
            place = scale * (scene.view @ _place(scene, joint))
            named.setdefault(tuple(np.round(place / 3)), (place, []))[1].append(joint.name)
    words: list[Item] = []
    for place, names in named.values():
        text = ", ".join(names)
        half = np.array([LETTER[0] * len(text), LETTER[1]]) / 2
        centres = place + np.array(CORNERS) * (half + AWAY)
        best = min(centres, key=lambda centre: (_within(marks, centre, half + 4.0), _within(strokes, centre, half)))
        words.append(Word(text, best, colour="ink", halo=True))
        marks = np.vstack([marks, best + np.linspace(-half, half, 9)])  # no name hides another
    return words


def _within(points: np.ndarray, centre: np.ndarray, half: np.ndarray) -> int:
    """Count the points (N, 2) that are in a box."""
    return int((np.abs(points - centre) < half).all(axis=1).sum())


def _corners(item: Item) -> np.ndarray:
    """Return the corners (K, 2) of the space that an item takes."""
    if isinstance(item, Path):
        return item.points
    half = (
        np.array([LETTER[0] * len(item.text), LETTER[1]]) / 2 if isinstance(item, Word) else np.full(2, item.size / 2)
    )
    return np.array([item.place - half, item.place + half])


def _moved(item: Item, shift: np.ndarray) -> Item:
    if isinstance(item, Path):
        return replace(item, points=item.points + shift)
    return replace(item, place=item.place + shift)


def _beside(place: np.ndarray, right: float, up: float) -> np.ndarray:
    return np.asarray(place + np.array([right, up]))


def _sample(sample: Item, place: np.ndarray) -> Item:
    """Place a sample of a mark or a line in the key."""
    if isinstance(sample, Path):
        return replace(sample, points=place + np.array([(-8.0, 0.0), (8.0, 0.0)]))
    return _moved(sample, place)


def _triad(origin: np.ndarray, ends: np.ndarray, colour: str) -> Iterator[Item]:
    """Draw three axes with their names; ``ends`` (2, 3) relative to ``origin`` (2,)."""
    for end in ends.T:
        yield Path(np.array([origin, origin + end]), colour, 1.2)
    for end, name in zip(ends.T, "xyz", strict=True):
        yield Word(name, origin + end, colour=colour, halo=True)


def _compass(scene: Scene, place: np.ndarray) -> Iterator[Item]:
    """Draw the axes of the base around a place (2,), and which way gravity points."""
    yield from _triad(place, 18.0 * scene.view @ scene.upright, GREY)
    yield Word("world" if scene.robot.floating else "base", _beside(place, 0.0, -31.0), colour=GREY)
    if np.any(scene.robot.gravity):
        tip = _beside(place, 38.0, -18.0)
        yield Path(np.array([_beside(tip, 0.0, 34.0), tip]), INK, 1.3)
        yield Path(np.array([_beside(tip, -3.0, 6.0), tip, _beside(tip, 3.0, 6.0)]), INK, 1.3)
        yield Word("gravity", _beside(tip, 0.0, -13.0), colour="ink")


def _scale_bar(scale: float, size: float, start: np.ndarray) -> Iterator[Item]:
    """Draw a bar of a round length, about a fifth of the drawing."""
    decade = 10.0 ** floor(log10(0.25 * size))
    length = max(step * decade for step in (1, 2, 5) if step * decade <= 0.25 * size)
    (x, y), end = start, start[0] + scale * length
    yield Path(np.array([(x, y + 2.5), (x, y - 2.5), (x, y), (end, y), (end, y + 2.5), (end, y - 2.5)]), INK, 1.2)
    yield Word(f"{length:g} m" if length >= 0.1 else f"{1e3 * length:g} mm", np.array([end + 6.0, y]), "start", "ink")


def _entries(scene: Scene) -> Iterator[tuple[str, Item]]:
    """List the words of the key and what they explain."""
    robot, linked = scene.robot, {body for body, _ in scene.lines}
    kinds = {(joint.name in robot.driven, joint.kind): joint for joint in scene.joints}
    for (driven, kind), joint in kinds.items():
        words = ("motor, " if driven else "passive, ") + ("turns" if kind == "revolute" else "slides")
        yield words, _mark(joint, robot, ORIGIN)
    if robot.springs:
        yield "spring", SPRING
    if robot.closures:
        yield "closes a loop", CLOSING
    if any(joint.limits.position for joint in scene.joints if joint.kind == "prismatic"):
        yield "travel", RAIL
    if linked - {robot.tool}:
        yield "link", LINK
    if not robot.floating:
        yield "base", BASE
    if any(platform.name != robot.tool for platform in robot.platforms):
        yield "platform", Mark(ORIGIN, "hexagon", 9.0, SKY, INK)
    tool = robot.tool if len(robot.tool) <= LETTERS else robot.tool[: LETTERS - 1] + "\u2026"
    green: Item = replace(LINK, stroke=GREEN) if robot.tool in linked else replace(RING, size=8.0, width=1.8)
    if any(platform.name == robot.tool for platform in robot.platforms):
        green = Mark(ORIGIN, "hexagon", 9.0, GREEN, INK)
    yield f"payload on {tool}", green
