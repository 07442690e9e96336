"""A robot at home as a skeleton, seen in parallel projection: base, rails, links, joints, closures and payload."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import cos, floor, log10, sin
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.model.home import close_home
from gtau.model.kinematics import Coordinates, poses
from gtau.report.chart import Shape, Sketch, Word
from gtau.robots.geometry import Frame, attached
from gtau.robots.robot import GROUND, Joint, Robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK, BLUE, RED, GREEN, ORANGE, SKY, GREY = "c3", "c0", "c1", "c2", "c4", "c5", "c7"
WIDTH, TALLEST = 240.0, 240.0  # points, of the sheet, and of the robot on it: a telephone shows words at 10 pixels
MARGIN, HEAD = 12.0, 32.0  # points, around the robot, and above it
STRIP, ROW, GAP = 66.0, 13.0, 24.0  # points: what holds axes and key, a row of the key, and what is above them
LETTER, AWAY = (4.6, 9.0), 6.0  # points: a letter of a name, width and height, and how far off its joint a name stands
CORNERS = np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)])  # of a joint, in which its name may stand
GRID = np.stack(np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 5)), axis=-1).reshape(-1, 2)  # of a box
LETTERS = 14  # of a name in the key
DRIVEN, PASSIVE = (8.2, RED), (6.1, "page")  # size and colour of marks
# corners of marks, by how much of one they are turned, and their radius, as a share of the size
OUTLINES = {"disc": (24, 0.0, 0.5), "square": (4, 0.5, 0.71), "diamond": (4, 0.0, 0.71), "hexagon": (6, 0.0, 0.5)}
COILS = 8  # turns of a spring
PARALLEL = 1e-6  # of a cosine
FLAT = 0.05  # a robot thinner than this share of its size is looked at from the front


def robot_figure(robot: Robot) -> Figure:
    """Draw a robot at home, gravity pointing down the page; see :func:`sketch_of`."""
    from gtau.report.render.charts import figure_of_sketch

    return figure_of_sketch(sketch_of(robot))


def sketch_of(robot: Robot) -> Sketch:
    """Sketch a robot at home, gravity pointing down the page; raises GtauError where its loops close nowhere.

    Pale lines are the base, grey ones the travel of prismatic joints, blue ones links, from a joint to the next, and
    filled faces platforms; the body that carries the payload is green, with the axes of its frame. Discs are revolute
    joints, with their axis through them, and squares prismatic ones, red and named where a motor moves them; diamonds
    close loops, zigzags are springs. Below are the axes of the base, a scale and a key.
    """
    largest = scene_of(robot)
    for share in (1.0, 0.8, 0.6):  # long names beside the robot need room, too
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
    """Return two corners (2, 2) of a word."""
    start = 0.0 if word.side == "start" else -LETTER[0] * len(word.text) / 2
    return word.place + np.array([(start, -LETTER[1] / 2), (start + LETTER[0] * len(word.text), LETTER[1] / 2)])


@dataclass(frozen=True, eq=False)
class Pen:
    """Draws in points, in colours by name; what has a label is explained in the key, by a sample around the origin."""

    items: list[Shape | Word] = field(default_factory=list)
    key: dict[str, Shape] = field(default_factory=dict)

    def line(self, points: Any, colour: str, width: float = 1.2, label: str = "") -> None:
        """Draw a line through points (K, 2)."""
        self.items.append(Shape(np.asarray(points), colour, width))
        if label:
            self.key.setdefault(label, Shape(np.array([(-7.0, 0.0), (7.0, 0.0)]), colour, width))

    def mark(self, place: np.ndarray, look: tuple[str, float, str], edge: str = INK, label: str = "") -> None:
        """Draw a mark of a shape, size and colour at a place (2,)."""
        shape, size, fill = look
        corners, turn, radius = OUTLINES[shape]
        angle = 2 * np.pi * (np.arange(corners) + turn) / corners
        outline = size * radius * np.column_stack([np.sin(angle), np.cos(angle)])
        mark = Shape(outline, edge, 1.0 if fill else 2.4, True, fill)
        self.items.append(replace(mark, points=place + outline))
        if label:
            self.key.setdefault(label, mark)

    def word(self, text: str, place: np.ndarray, colour: str = "ink") -> None:
        """Write words about a place (2,)."""
        self.items.append(Word(text, place, colour=colour))

    def triad(self, origin: np.ndarray, ends: np.ndarray, colour: str) -> None:
        """Draw the axes that do not point at the reader; ``ends`` (2, 3) relative to ``origin`` (2,)."""
        for end, name in zip(ends.T, "xyz", strict=True):
            if np.linalg.norm(end) > 1.0:
                self.line([origin, origin + end], colour)
                self.word(name, origin + end, colour)


def _draw_robot(pen: Pen, scene: Scene) -> None:
    """Draw base, rails, links, platforms, joints, frame of the payload, springs and closures."""
    robot, frames, reach = scene.robot, scene.frames, scene.size
    tool = robot.tool if len(robot.tool) <= LETTERS else robot.tool[: LETTERS - 1] + "\u2026"
    payload = f"payload on {tool}"
    for foot in scene.feet:
        x, y = scene.on_page(foot)
        pen.line([scene.on_page(frames[GROUND][1]), (x, y)], "measured", 2.4, label="" if robot.floating else "base")
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
    if robot.tool not in {body for body, _ in scene.lines} | {platform.name for platform in robot.platforms}:
        pen.mark(scene.on_page(place), ("disc", 13.0, ""), GREEN, payload)
    for joint in sorted(scene.joints, key=lambda joint: joint.name in robot.driven):  # driven ones on top
        driven, centre = joint.name in robot.driven, scene.centre(joint)
        if joint.turns:
            half = (0.06 if driven else 0.04) * reach / scene.scale * (frames[joint.name][0] @ np.array(joint.axis))
            pen.line(scene.on_page(np.array([centre - half, centre + half])), INK, 1.0)
        size, fill = DRIVEN if driven else PASSIVE
        words = ("motor, " if driven else "passive, ") + ("turns" if joint.turns else "slides")
        pen.mark(scene.on_page(centre), ("disc" if joint.turns else "square", size, fill), label=words)
    pen.triad(scene.on_page(place), 0.13 * reach * scene.view @ R, GREEN)
    for spring in robot.springs:
        start, end = (scene.on_page(attached(side, frames)[1]) for side in (spring.a, spring.b))
        pen.line(zigzag(start, end, 0.025 * reach), INK, label="spring")
    for closure in robot.closures:
        pen.mark(scene.on_page(attached(closure.a, frames)[1]), ("diamond", 6.0, ORANGE), label="closes a loop")


def _draw_platform(pen: Pen, scene: Scene, name: str, colour: str, label: str) -> None:
    """Fill the face between the points at which a platform is held, or draw a mark where they are one point."""
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
    """Name what motors move, each in the corner with the fewest marks, then lines, under it."""
    shapes = [item for item in pen.items if isinstance(item, Shape)]
    marks = np.array([shape.points.mean(axis=0) for shape in shapes if shape.closed])
    along = np.linspace(0, 1, 30)[:, None]
    lines = [shape.points for shape in shapes if not shape.closed]
    strokes = np.vstack([ends[:1] + along * (ends[1:2] - ends[:1]) for ends in lines])
    named: dict[tuple[float, ...], tuple[np.ndarray, list[str]]] = {}
    for joint in scene.joints:
        if joint.name in scene.robot.driven:
            place = scene.on_page(scene.centre(joint))
            named.setdefault(tuple(np.round(place / 3)), (place, []))[1].append(joint.name)
    for place, names in named.values():
        names = [text] if len(text := ", ".join(names)) <= LETTERS else names
        half = np.array([LETTER[0] * max(map(len, names)), LETTER[1] * len(names)]) / 2
        centres = (place + CORNERS * (half + AWAY))[:, None]
        hidden = [(np.abs(points - centres) < half + 2.0).all(axis=2).sum(axis=1) for points in (strokes, marks)]
        best = centres[np.lexsort(hidden)[0], 0]
        for k, name in enumerate(names):
            pen.word(name, best + np.array([0.0, LETTER[1] * ((len(names) - 1) / 2 - k)]))
        marks = np.vstack([marks, best + half * GRID])  # no name hides another


def _draw_compass(pen: Pen, scene: Scene, place: np.ndarray) -> None:
    """Draw the axes of the base around a place (2,), and which way gravity points."""
    pen.triad(place, 18.0 * scene.view @ scene.upright, GREY)
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
    """Draw a bar of a round length, about a fifth of the drawing."""
    size = scene.size / scene.scale
    decade = 10.0 ** floor(log10(0.25 * size))
    length = max(step * decade for step in (1, 2, 5) if step * decade <= 0.25 * size)
    (x, y), end = start, start[0] + scene.scale * length
    pen.line([(x, y + 2.5), (x, y - 2.5), (x, y), (end, y), (end, y + 2.5), (end, y - 2.5)], INK)
    words = f"{length:g} m" if length >= 0.1 else f"{1e3 * length:g} mm"
    pen.items.append(Word(words, np.array([end + 6.0, y]), "start"))


@dataclass(frozen=True, eq=False)
class Scene:
    """A robot whose gravity points down the page: ``view`` (2, 3) projects m to the page, whose ``scale`` is points/m.

    ``frames`` are those of all bodies, ``joints`` those that are drawn, ``lines`` bodies with a line (2, 3) of their
    link, ``rails`` prismatic joints with their travel (2, 3), ``feet`` (3,) where joints stand on the base.
    """

    robot: Robot
    upright: np.ndarray
    view: np.ndarray
    scale: float
    size: float  # points, of the larger side
    frames: dict[str, Frame]
    joints: list[Joint]
    lines: list[tuple[str, np.ndarray]]
    rails: list[tuple[Joint, np.ndarray]]
    feet: list[np.ndarray]

    def on_page(self, points: np.ndarray) -> np.ndarray:
        """Project points (..., 3) onto the page, (..., 2)."""
        return np.asarray(self.scale * points @ self.view.T)

    def centre(self, joint: Joint) -> np.ndarray:
        """Locate the mark of a joint, (3,)."""
        place = self.frames[joint.name][1]
        return np.asarray((place + foot_of(joint, self.frames)) / 2 if joint.kind == "prismatic" else place)


def scene_of(robot: Robot) -> Scene:
    """Lay out a robot at home; raises GtauError where its loops close nowhere."""
    robot = close_home(robot)
    upright = upright_rotation(np.array(robot.gravity))
    layout = Coordinates(robot)
    frames = {name: (upright @ R, upright @ p) for name, (R, p) in poses(layout, layout.home).items()}
    shafts = {joint.name for joint in robot.joints if joint.parameters == "drive" and joint.antecedent == GROUND}
    joints = [joint for joint in robot.joints if joint.name not in shafts.union(robot.base)]
    lines = link_lines(robot, joints, frames)
    rails = [(joint, rail_of(joint, frames)) for joint in joints if joint.kind == "prismatic"]
    feet = [foot_of(joint, frames) for joint in joints if joint.antecedent == GROUND]
    ends = [attached(end, frames)[1] for end in robot.ends]
    drawn = (*(line for _, line in lines), *(rail for _, rail in rails))
    points = np.vstack([*drawn, *feet, *ends, *(frame[1] for frame in frames.values())])
    view = view_plane(np.ptp(points, axis=0), normal_of(joints, frames))
    span = np.maximum(np.ptp(points @ view.T, axis=0), 1e-9)
    size = float(span.max()) if span.max() > 1e-9 else 1.0
    scale = float(min((WIDTH - 2 * MARGIN) / (1.2 * size), TALLEST / span[1]))
    return Scene(robot, upright, view, scale, scale * size, frames, joints, lines, rails, feet)


def upright_rotation(gravity: np.ndarray) -> np.ndarray:
    """Compute the rotation (3, 3) after which gravity points along -z, with x where it was if that can be."""
    size = np.linalg.norm(gravity)
    up = -gravity / size if size else np.array([0.0, 0.0, 1.0])
    x = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = x - (x @ up) * up
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(up, x), up])


def view_plane(extent: np.ndarray, normal: np.ndarray | None = None) -> np.ndarray:
    """Choose the plane of the page, to the right and up, (2, 3), for a robot of that extent (3,).

    A planar robot is drawn in its plane, with that ``normal`` (3,).
    """
    if normal is not None:
        level = np.cross([0.0, 0.0, 1.0], normal)
        right = level / np.linalg.norm(level) if np.linalg.norm(level) > 1e-6 else np.array([1.0, 0.0, 0.0])
        right = right if right[np.argmax(np.abs(right))] > 0 else -right
        up = np.cross(normal, right)
        return np.array([right, up if up[np.argmax(np.abs(up))] > 0 else -up])
    thin = int(np.argmin(extent))
    flat = extent[thin] < FLAT * extent.max()
    e, a = np.radians(((18.0, -20.0), (18.0, -72.0), (62.0, -72.0))[thin] if flat else (24.0, -58.0))
    return np.array([[-sin(a), cos(a), 0.0], [-cos(a) * sin(e), -sin(a) * sin(e), cos(e)]])


def normal_of(joints: Sequence[Joint], frames: Mapping[str, Frame]) -> np.ndarray | None:
    """Find the axis (3,) about which all joints of a planar robot turn, and across which they slide; else None."""
    axes = {joint: frames[joint.name][0] @ np.array(joint.axis) for joint in joints}
    turns = [axis for joint, axis in axes.items() if joint.turns]
    if len(turns) < 2:
        return None
    across = [abs(axis @ turns[0]) for joint, axis in axes.items() if not joint.turns]
    parallel = all(abs(axis @ turns[0]) > 1 - PARALLEL for axis in turns)
    return turns[0] if parallel and all(cosine < PARALLEL for cosine in across) else None


def link_lines(robot: Robot, joints: list[Joint], frames: dict[str, Frame]) -> list[tuple[str, np.ndarray]]:
    """List bodies and lines (2, 3) from every joint to what its link carries."""
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
    return [(body, line) for body, line in lines if np.linalg.norm(line[1] - line[0]) > 1e-6]


def zigzag(start: np.ndarray, end: np.ndarray, width: float) -> np.ndarray:
    """Draw a line (points, 2) between two points (2,) that looks like a coil, straight at both ends."""
    along = end - start
    length = max(float(np.linalg.norm(along)), 1e-12)
    across = width / length * np.array([-along[1], along[0]])
    shares = np.concatenate([[0.0, 0.2], np.linspace(0.25, 0.75, COILS), [0.8, 1.0]])
    sides = np.concatenate([[0.0, 0.0], (-1.0) ** np.arange(COILS), [0.0, 0.0]])
    return np.asarray(start + shares[:, None] * along + sides[:, None] * across)


def foot_of(joint: Joint, frames: dict[str, Frame]) -> np.ndarray:
    """Locate where a joint stands on the link before it, (3,)."""
    R, p = frames[joint.antecedent]
    foot: np.ndarray = p + R @ joint.placement.position
    return foot


def rail_of(joint: Joint, frames: dict[str, Frame]) -> np.ndarray:
    """Return the path of a prismatic joint within its limits, (2, 3)."""
    R, p = frames[joint.name]
    low, high = joint.limits.position or (joint.home, joint.home)
    return np.array([p + (end - joint.home) * (R @ np.array(joint.axis)) for end in (low, high)])
