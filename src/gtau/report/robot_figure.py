"""Drawing of a robot at home as a skeleton in parallel projection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import cos, floor, log10, sin
from typing import Any

import numpy as np

from gtau.model.home import close_home
from gtau.model.kinematics import Coordinates, poses
from gtau.report.chart import Shape, Sketch, Word
from gtau.robots.geometry import Frame, attached
from gtau.robots.parameter import rigid_body
from gtau.robots.robot import GROUND, Joint, Robot

INK, BLUE, RED, GREEN, ORANGE, SKY, GREY = "c3", "c0", "c1", "c2", "c4", "c5", "c7"
WIDTH, TALLEST = 240.0, 240.0  # points: width of the sheet, height of the robot; a phone shows words at 10 pixels
MARGIN, HEAD = 12.0, 32.0  # points, around the robot, and above it
STRIP, ROW, GAP = 66.0, 13.0, 24.0  # points: strip for axes and key, a row of the key, and the gap above the strip
LETTER, AWAY = (4.6, 9.0), 6.0  # points: width and height of a letter, and distance of a name from its joint
APART = 14.0  # points, of a name from other joints where a corner allows
CORNERS = np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)])  # of a joint, for its name
GRID = np.stack(np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 5)), axis=-1).reshape(-1, 2)  # of a box
LETTERS = 14  # most letters of a name in the key
DRIVEN, PASSIVE = (8.2, RED), (6.1, "page")  # size and colour of marks
# number of corners of marks, turn as a share of a corner, and radius as a share of the size
OUTLINES = {"disc": (24, 0.0, 0.5), "square": (4, 0.5, 0.71), "diamond": (4, 0.0, 0.71), "hexagon": (6, 0.0, 0.5)}
PARALLEL = 1e-6  # tolerance of a cosine
FLAT = 0.05  # share of its size below which a robot is drawn from the front
TIP = 0.25  # m, of an arm whose length no file states


def sketch_of(robot: Robot) -> Sketch:
    """Sketch a robot at home, with gravity down the page; raises GtauError if its loops do not close.

    Pale lines are the base, grey lines the travel of prismatic joints, blue lines links, and filled faces platforms;
    the body with the payload is green, with the axes of its frame. Discs are revolute joints with their axes, squares
    prismatic joints; driven joints are red and named. Diamonds close loops. The strip below holds
    the axes of the base, a scale and a key.
    """
    largest = scene_of(robot)
    for share in (1.0, 0.8, 0.6):  # smaller to make room for long names
        scene, pen = replace(largest, scale=share * largest.scale, size=share * largest.size), Pen()
        _draw_robot(pen, scene)
        _draw_names(pen, scene)
        points = np.vstack([item.points if isinstance(item, Shape) else _box(item) for item in pen.items])
        low, high = points.min(axis=0), points.max(axis=0)
        if high[0] - low[0] + 2 * MARGIN <= WIDTH:
            break
    strip = max(STRIP, ROW * (len(pen.key) + 1))
    size = np.array([max(WIDTH, high[0] - low[0] + 2 * MARGIN), strip + GAP + high[1] - low[1] + HEAD])
    corner = np.array([(low[0] + high[0] - size[0]) / 2, low[1] - GAP - strip])
    _draw_scale(pen, scene, corner + np.array([MARGIN, strip + 8.0]))
    _draw_compass(pen, scene, corner + np.array([34.0, strip / 2 + 4.0]))
    pen.items.append(Word(robot.name, corner + np.array([6.0, size[1] - 9.0]), "start", size=9.5, bold=True))
    for k, (label, sample) in enumerate(pen.key.items()):
        place = corner + np.array([112.0, strip - ROW * (k + 1)])
        pen.items.append(replace(sample, points=sample.points + place))
        pen.items.append(Word(label, place + np.array([12.0, 0.0]), "start", "soft", 7.0))
    return Sketch(corner, size, tuple(pen.items))


def _box(word: Word) -> np.ndarray:
    """Return two opposite corners (2, 2) of a word."""
    start = 0.0 if word.side == "start" else -LETTER[0] * len(word.text) / 2
    return word.place + np.array([(start, -LETTER[1] / 2), (start + LETTER[0] * len(word.text), LETTER[1] / 2)])


@dataclass(frozen=True, eq=False)
class Pen:
    """Collects shapes and words, in points; the key explains shapes with a label by a sample around the origin."""

    items: list[Shape | Word] = field(default_factory=list)
    key: dict[str, Shape] = field(default_factory=dict)

    def line(self, points: Any, colour: str, width: float = 1.2, label: str = "") -> None:
        """Draw a line through points (K, 2)."""
        self.items.append(Shape(np.asarray(points), colour, width))
        if label:
            self.key.setdefault(label, Shape(np.array([(-7.0, 0.0), (7.0, 0.0)]), colour, width))

    def mark(self, place: np.ndarray, look: tuple[str, float, str], edge: str = INK, label: str = "") -> None:
        """Draw a mark (shape, size, colour) at a place (2,)."""
        shape, size, fill = look
        corners, turn, radius = OUTLINES[shape]
        angle = 2 * np.pi * (np.arange(corners) + turn) / corners
        outline = size * radius * np.column_stack([np.sin(angle), np.cos(angle)])
        mark = Shape(outline, edge, 1.0 if fill else 2.4, True, fill)
        self.items.append(replace(mark, points=place + outline))
        if label:
            self.key.setdefault(label, mark)

    def word(self, text: str, place: np.ndarray, colour: str = "ink") -> None:
        """Write words centred at a place (2,)."""
        self.items.append(Word(text, place, colour=colour))

    def triad(self, origin: np.ndarray, ends: np.ndarray, colour: str) -> None:
        """Draw axes with ``ends`` (2, 3) relative to ``origin`` (2,), except an axis towards the reader."""
        for end, name in zip(ends.T, "xyz", strict=True):
            if np.linalg.norm(end) > 1.0:
                self.line([origin, origin + end], colour)
                self.word(name, origin + end, colour)


def _draw_robot(pen: Pen, scene: Scene) -> None:
    robot, frames, reach = scene.robot, scene.frames, scene.size
    tool = robot.tool if len(robot.tool) <= LETTERS else robot.tool[: LETTERS - 1] + "\u2026"
    payload = f"payload on {tool}"
    spokes = [float(np.linalg.norm(foot - frames[GROUND][1])) for foot in scene.feet]
    hub = len(spokes) < 3 or np.ptp(spokes) < FLAT * max(spokes)  # else lines to the feet would look like struts
    for foot in scene.feet:
        x, y = scene.on_page(foot)
        origin = scene.on_page(frames[GROUND][1]) if hub else (x, y)
        pen.line([origin, (x, y)], "measured", 2.4, label="" if robot.floating else "base")
        pen.line([(x, y), (x, y - 0.06 * reach)], "measured")
        pen.line([(x - 0.03 * reach, y - 0.06 * reach), (x + 0.03 * reach, y - 0.06 * reach)], "measured", 2.4)
    for joint, rail in scene.rails:
        pen.line(scene.on_page(rail), GREY, 5.0, "travel" if joint.limits.position else "")
    for body, line in scene.lines:
        colour, label = (GREEN, payload) if body == robot.tool else (BLUE, "link")
        pen.line(scene.on_page(line), colour, 2.4, label=label)
    for platform in robot.platforms:
        colour, label = (GREEN, payload) if platform.name == robot.tool else (SKY, "platform")
        _draw_platform(pen, scene, platform.name, colour, label)
    R, place = frames[robot.tool]
    place = place + scene.shifts.get(robot.tool, 0.0)
    if robot.tool not in {body for body, _ in scene.lines} | {platform.name for platform in robot.platforms}:
        pen.mark(scene.on_page(place), ("disc", 13.0, ""), GREEN, payload)
    for joint in sorted(scene.joints, key=lambda joint: joint.name in robot.driven):  # driven joints on top
        driven, centre = joint.name in robot.driven, scene.centre(joint)
        if joint.turns:
            half = (0.06 if driven else 0.04) * reach / scene.scale * (frames[joint.name][0] @ np.array(joint.axis))
            pen.line(scene.on_page(np.array([centre - half, centre + half])), INK, 1.0)
        size, fill = DRIVEN if driven else PASSIVE
        if driven:
            _draw_direction(pen, scene, joint)
        words = ("motor, " if driven else "passive, ") + ("turns" if joint.turns else "slides")
        pen.mark(scene.on_page(centre), ("disc" if joint.turns else "square", size, fill), label=words)
    pen.triad(scene.on_page(place), 0.13 * reach * scene.view @ R, GREEN)
    for spring in robot.springs:
        ends = np.array([attached(side, frames)[1] for side in (spring.a, spring.b)])
        pen.line(scene.on_page(ends), INK, label="spring")
    for closure in robot.closures:
        pen.mark(scene.on_page(attached(closure.a, frames)[1]), ("diamond", 6.0, ORANGE), label="closes a loop")


def _draw_direction(pen: Pen, scene: Scene, joint: Joint) -> None:
    """Draw an arrow in the positive direction of a joint: around its axis, or beside it."""
    axis, reach = scene.frames[joint.name][0] @ np.array(joint.axis), 0.08 * scene.size / scene.scale
    if joint.turns:
        angle = np.pi * np.linspace(0.2, 1.5, 20)[:, None]
        x = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        x /= np.linalg.norm(x)
        path = scene.on_page(scene.centre(joint) + reach * (np.cos(angle) * x + np.sin(angle) * np.cross(axis, x)))
    else:
        path = scene.on_page(scene.centre(joint) + reach * np.linspace(-1.0, 1.0, 5)[:, None] * axis)
    back = path[-3] - path[-1]
    back *= 4.5 / max(float(np.linalg.norm(back)), 1e-9)
    across = np.array([-back[1], back[0]])
    path = path if joint.turns else path + 2.2 * across
    wings = [path[-1] + 0.8 * back + side * across for side in (0.5, -0.5)]
    pen.line([*path, wings[0], path[-1], wings[1]], RED, label="positive direction")


def _draw_platform(pen: Pen, scene: Scene, name: str, colour: str, label: str) -> None:
    """Fill the face between the attachment points of a platform, or mark them if they coincide."""
    ends = [end for closure in scene.robot.closures for end in (closure.a, closure.b) if end.body == name]
    points = np.array([attached(end, scene.frames)[1] for end in ends])
    corners = points - points.mean(axis=0)
    if np.linalg.norm(corners, axis=1).max() < 1e-6:
        pen.mark(scene.on_page(points.mean(axis=0)), ("hexagon", 11.0, colour), label=label)
        return
    normal = np.linalg.svd(corners)[2]
    order = np.argsort(np.arctan2(corners @ normal[1], corners @ normal[0]))
    face = Shape(scene.on_page(points[order]), INK, 1.0, True, colour, 0.6)
    pen.items.append(face)
    pen.key.setdefault(label, replace(face, points=np.array([(-7.0, -3.0), (7.0, -3.0), (7.0, 3.0), (-7.0, 3.0)])))


def _draw_names(pen: Pen, scene: Scene) -> None:
    """Name driven joints, in the corner that covers the fewest marks, then is nearest to fewest others, then lines."""
    shapes = [item for item in pen.items if isinstance(item, Shape)]
    marks = np.array([shape.points.mean(axis=0) for shape in shapes if shape.closed])
    along = np.linspace(0, 1, 30)[:, None]
    lines = [shape.points for shape in shapes if not shape.closed]
    strokes = np.vstack([*(ends[:1] + along * (ends[1:2] - ends[:1]) for ends in lines), *lines])
    named: dict[tuple[float, ...], tuple[np.ndarray, list[str]]] = {}
    for joint in scene.joints:
        if joint.name in scene.robot.driven:
            place = scene.on_page(scene.centre(joint))
            named.setdefault(tuple(np.round(place / 3)), (place, []))[1].append(joint.name)
    places = np.array([place for place, _ in named.values()])
    for place, names in named.values():
        names = [text] if len(text := ", ".join(names)) <= LETTERS else names
        half = np.array([LETTER[0] * max(map(len, names)), LETTER[1] * len(names)]) / 2
        centres = (place + CORNERS * (half + AWAY))[:, None]
        margins = ((strokes, 2.0), (places, APART), (marks, 2.0))
        hidden = [(np.abs(points - centres) < half + far).all(axis=2).sum(axis=1) for points, far in margins]
        corner = np.lexsort(hidden)[0]
        best = centres[corner, 0]
        if hidden[1][corner] > 1:  # another joint is near
            pen.line(place + np.outer((3.2, AWAY + 1.0), CORNERS[corner]), "soft", 0.8)
        for k, name in enumerate(names):
            pen.word(name, best + np.array([0.0, LETTER[1] * ((len(names) - 1) / 2 - k)]))
        marks = np.vstack([marks, best + half * GRID])  # no name hides another


def _draw_compass(pen: Pen, scene: Scene, place: np.ndarray) -> None:
    """Draw the axes of the base around a place (2,), and the direction of gravity."""
    pen.triad(place, 18.0 * scene.view @ upright_rotation(np.array(scene.robot.gravity)), GREY)
    x, y = place
    pen.word("world" if scene.robot.floating else "base", np.array([x, y - 31.0]), colour=GREY)
    if not np.any(scene.robot.gravity):
        return
    pen.word("gravity", np.array([x + 42.0, y - 31.0]))
    if scene.view[1, 2] < PARALLEL:  # away from the reader
        centre, half = np.array([x + 42.0, y]), 3.9 * CORNERS[[0, 3, 2, 1]]
        pen.mark(centre, ("disc", 11.0, "page"))
        pen.line(centre + np.insert(half, 2, 0.0, axis=0), INK, 1.3)
        return
    tip = (x + 42.0, y - 18.0)
    pen.line([(x + 42.0, y + 16.0), tip, (x + 39.0, y - 12.0), tip, (x + 45.0, y - 12.0)], INK, 1.3)


def _draw_scale(pen: Pen, scene: Scene, start: np.ndarray) -> None:
    """Draw a scale bar of a round length, about a fifth of the drawing."""
    size = scene.size / scene.scale
    decade = 10.0 ** floor(log10(0.25 * size))
    length = max(step * decade for step in (1, 2, 5) if step * decade <= 0.25 * size)
    (x, y), end = start, start[0] + scene.scale * length
    pen.line([(x, y + 2.5), (x, y - 2.5), (x, y), (end, y), (end, y + 2.5), (end, y - 2.5)], INK)
    words = f"{length:g} m" if length >= 0.1 else f"{1e3 * length:g} mm"
    pen.items.append(Word(words, np.array([end + 6.0, y]), "start"))


@dataclass(frozen=True, eq=False)
class Scene:
    """Layout of a robot with gravity down the page; ``view`` (2, 3) projects m to the page at ``scale`` points/m.

    ``frames`` holds the frames of all bodies, ``joints`` the drawn joints, ``lines`` bodies and lines (2, 3) of their
    links, ``rails`` prismatic joints and their travel (2, 3), ``feet`` (3,) the points where joints stand on the base,
    ``shifts`` (3,) of joints that meet in one point, along their axes.
    """

    robot: Robot
    view: np.ndarray
    scale: float
    size: float  # points, larger side
    frames: dict[str, Frame]
    joints: list[Joint]
    lines: list[tuple[str, np.ndarray]]
    rails: list[tuple[Joint, np.ndarray]]
    feet: list[np.ndarray]
    shifts: dict[str, np.ndarray]

    def on_page(self, points: np.ndarray) -> np.ndarray:
        """Project points (..., 3) onto the page, (..., 2)."""
        return np.asarray(self.scale * points @ self.view.T)

    def centre(self, joint: Joint) -> np.ndarray:
        """Locate the mark of a joint, (3,)."""
        place = self.frames[joint.name][1] + self.shifts.get(joint.name, 0.0)
        return np.asarray((place + foot_of(joint, self.frames)) / 2 if joint.kind == "prismatic" else place)


def scene_of(robot: Robot) -> Scene:
    """Lay out a robot at home; raises GtauError if its loops do not close."""
    robot = close_home(robot)
    upright = upright_rotation(np.array(robot.gravity))
    layout = Coordinates(robot)
    frames = {name: (upright @ R, upright @ p) for name, (R, p) in poses(layout, layout.home).items()}
    shafts = {joint.name for joint in robot.joints if joint.parameters == "drive" and joint.antecedent == GROUND}
    joints = [joint for joint in robot.joints if joint.name not in shafts.union(robot.base)]
    shifts = shifts_of([joint for joint in joints if joint.name in robot.driven], frames)
    lines = link_lines(robot, joints, frames)
    lines += [(name, frames[name][1] + np.array([0.0 * shift, shift])) for name, shift in shifts.items()]
    rails = []
    for joint in (joint for joint in joints if joint.kind == "prismatic"):
        R, p = frames[joint.name]
        ends = joint.limits.position or (joint.home, joint.home)
        rails.append((joint, np.array([p + (end - joint.home) * (R @ np.array(joint.axis)) for end in ends])))
    if not lines and not rails:  # the link of one joint, drawn along x
        R, p = frames[robot.tool]
        lines = [(robot.tool, p + np.array([0.0 * R[:, 0], TIP * R[:, 0]]))]
    feet = [foot_of(joint, frames) + shifts.get(joint.name, 0.0) for joint in joints if joint.antecedent == GROUND]
    attachments = [attached(end, frames)[1] for end in robot.ends]
    drawn = (*(line for _, line in lines), *(rail for _, rail in rails))
    points = np.vstack([*drawn, *feet, *attachments, *(frame[1] for frame in frames.values())])
    view = view_plane(np.ptp(points, axis=0), normal_of(joints, frames))
    span = np.maximum(np.ptp(points @ view.T, axis=0), 1e-9)
    size = float(span.max()) if span.max() > 1e-9 else 1.0
    scale = float(min((WIDTH - 2 * MARGIN) / (1.2 * size), TALLEST / span[1]))
    return Scene(robot, view, scale, scale * size, frames, joints, lines, rails, feet, shifts)


def shifts_of(joints: Sequence[Joint], frames: Mapping[str, Frame]) -> dict[str, np.ndarray]:
    """Move joints of a chain that meet in a point apart, (3,) each, along their axes, of which any point is as good.

    The first moves towards its link, the last of three away from it.
    """
    places = {joint.name: frames[joint.name][1] for joint in joints}
    reach = float(np.ptp(np.vstack([*places.values(), np.zeros(3)]), axis=0).max())
    shifts = {}
    for first in joints:
        group = [other for other in joints if np.linalg.norm(places[other.name] - places[first.name]) <= FLAT * reach]
        if first != group[0] or not 1 < len({joint.antecedent for joint in group if joint.turns}) == len(group):
            continue
        back = frames[first.antecedent][1] - places[first.name]
        down = back if np.linalg.norm(back) > FLAT * reach else np.array([0.0, 0.0, -1.0])
        for joint, side in ((first, 1.0), *([(group[-1], -1.0)] if len(group) > 2 else [])):
            axis = frames[joint.name][0] @ np.array(joint.axis)
            shifts[joint.name] = side * 0.14 * reach * (axis if axis @ down > 0 else -axis)
    return shifts


def upright_rotation(gravity: np.ndarray) -> np.ndarray:
    """Compute the rotation (3, 3) that turns gravity to -z and keeps x if possible."""
    size = np.linalg.norm(gravity)
    up = -gravity / size if size else np.array([0.0, 0.0, 1.0])
    x = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = x - (x @ up) * up
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(up, x), up])


def view_plane(extent: np.ndarray, normal: np.ndarray | None = None) -> np.ndarray:
    """Choose right and up on the page, (2, 3), for a robot of some extent (3,), or a planar one with a normal (3,)."""
    if normal is not None:
        level = np.cross([0.0, 0.0, 1.0], normal)
        right = level / np.linalg.norm(level) if np.linalg.norm(level) > 1e-6 else np.array([1.0, 0.0, 0.0])
        right = right if right[np.argmax(np.abs(right))] > 0 else -right
        up = np.cross(normal, right)
        return np.array([right, up if up[np.argmax(np.abs(up))] > 0 else -up])
    wide = extent > FLAT * extent.max()
    if wide.sum() == 1 and not wide[2]:  # a level line
        return np.array([wide.astype(float), [0.0, 0.0, 1.0]])
    thin = int(np.argmin(extent))
    flat = extent[thin] < FLAT * extent.max()
    e, a = np.radians(((18.0, -20.0), (18.0, -72.0), (62.0, -72.0))[thin] if flat else (24.0, -58.0))
    return np.array([[-sin(a), cos(a), 0.0], [-cos(a) * sin(e), -sin(a) * sin(e), cos(e)]])


def normal_of(joints: Sequence[Joint], frames: Mapping[str, Frame]) -> np.ndarray | None:
    """Return the common axis (3,) of a planar robot's revolute joints, normal to its prismatic ones; else None."""
    axes = {joint: frames[joint.name][0] @ np.array(joint.axis) for joint in joints}
    turns = [axis for joint, axis in axes.items() if joint.turns]
    if not turns:
        return None
    across = [abs(axis @ turns[0]) for joint, axis in axes.items() if not joint.turns]
    parallel = all(abs(axis @ turns[0]) > 1 - PARALLEL for axis in turns)
    return turns[0] if parallel and all(cosine < PARALLEL for cosine in across) else None


def link_lines(robot: Robot, joints: list[Joint], frames: dict[str, Frame]) -> list[tuple[str, np.ndarray]]:
    """List bodies and the lines (2, 3) of their links, from each joint to the next; the last to its centre of mass."""
    lines = []
    for joint in joints:
        foot = foot_of(joint, frames)
        if joint.antecedent != GROUND:
            lines.append((joint.antecedent, np.array([frames[joint.antecedent][1], foot])))
        if joint.kind == "prismatic":
            lines.append((joint.name, np.array([foot, frames[joint.name][1]])))
    platforms = {platform.name for platform in robot.platforms}
    for end in robot.ends:
        if end.body not in platforms | {GROUND}:
            lines.append((end.body, np.array([frames[end.body][1], attached(end, frames)[1]])))
    (R, p), drawn = frames[robot.tool], platforms.union(body for body, _ in lines)
    if robot.tool not in drawn:
        lines.append((robot.tool, np.array([p, p + R @ rigid_body(robot.inertias, robot.tool).center])))
    return [(body, line) for body, line in lines if np.linalg.norm(line[1] - line[0]) > 1e-6]


def foot_of(joint: Joint, frames: dict[str, Frame]) -> np.ndarray:
    """Locate the foot of a joint on the link before it, (3,)."""
    R, p = frames[joint.antecedent]
    return np.asarray(p + R @ joint.placement.position)
