"""A robot at home as inline SVG, in the colours of the page; :mod:`gtau.report.robot_figure` draws the same as PNG."""

from __future__ import annotations

from functools import partial
from math import floor, log10

import numpy as np

from gtau.report.html.elements import escape
from gtau.report.html.series import key
from gtau.report.robot_scene import Scene, platform_attachments, scene_of
from gtau.robots.geometry import attached
from gtau.robots.robot import GROUND, Robot

WIDTH, LEAST, MOST = 420.0, 150.0, 380.0  # pixels of the page: its width, and the range of its height
MARGIN, STRIP = 34.0, 48.0  # around the robot, and below it for the scale and the axes of the base
SHIFTS = ((12, -8, "start"), (-12, -8, "end"), (12, 16, "start"), (-12, 16, "end"))  # of a name from its joint


def robot_drawing(robot: Robot) -> str:
    """Draw a robot at home as a skeleton with a key: base, links, joints, closures and the payload's body.

    Raises
    ------
    GtauError
        The loops close nowhere.
    """
    scene = scene_of(robot)
    robot = scene.robot
    span = scene.high - scene.low
    scale = min((WIDTH - 2 * MARGIN) / max(span[0], 1e-9), (MOST - 2 * MARGIN - STRIP) / max(span[1], 1e-9))
    height = max(scale * span[1] + 2 * MARGIN + STRIP, LEAST)
    page = _Page(scene, scale, height)
    for foot in scene.feet:
        page.line(scene.found[GROUND][1], foot, "line", 3)
        x, y = page.at(foot)
        page.marks.append(f'<path d="M{x:.1f} {y:.1f}v12m-8 0h16" style="stroke:var(--line);stroke-width:2"/>')
    for rail in scene.rails:
        page.line(rail[0], rail[1], "soft", 6, opacity=0.5)
    for body, line in scene.lines:
        page.line(line[0], line[1], "c2" if body == robot.tool else "c0", 3)
    _platforms(page)
    drawn = {body for body, _ in scene.lines} | {platform.name for platform in robot.platforms}
    if robot.tool not in drawn:
        x, y = page.at(scene.found[robot.tool][1])
        style = "fill:none;stroke:var(--c2);stroke-width:3"
        page.marks.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="10" style="{style}"/>')
    _joints(page)
    for spring in scene.springs:
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(page.on_page, spring))
        page.marks.append(f'<polyline points="{points}" style="fill:none;stroke:var(--c3);stroke-width:1.6"/>')
    for x, y in map(page.on_page, scene.closings):
        style = "fill:var(--c4);stroke:var(--page);stroke-width:1.2"
        page.marks.append(f'<path d="M{x - 5:.1f} {y:.1f}l5 -5l5 5l-5 5z" style="{style}"/>')
    _names(page)
    _furniture(page)
    svg = (
        f'<svg viewBox="0 0 {WIDTH:g} {height:.0f}" role="img" aria-label="Robot {escape(robot.name)} at home">'
        f"{''.join(page.marks)}</svg>"
    )
    entries = [("driven joint", "c1"), ("passive joint", "soft"), ("link", "c0"), (f"payload on {robot.tool}", "c2")]
    if not any(joint.name not in robot.driven for joint in scene.joints):
        entries.pop(1)
    if robot.closures:
        entries.append(("closes a loop", "c4"))
    if robot.springs:
        entries.append(("spring", "c3"))
    return svg + key(entries)


class _Page:
    """Where points of the scene stand on the page, and what is drawn so far."""

    def __init__(self, scene: Scene, scale: float, height: float) -> None:
        self.scene, self.scale, self.height = scene, scale, height
        self.middle = (scene.low + scene.high) / 2
        self.marks: list[str] = []

    def at(self, point: np.ndarray) -> tuple[float, float]:
        """Place of a point (3,) of the scene."""
        return self.on_page(self.scene.view @ point)

    def on_page(self, place: np.ndarray) -> tuple[float, float]:
        """Place of a projected point (2,)."""
        x, y = self.scale * (place - self.middle)
        return WIDTH / 2 + float(x), (self.height - STRIP) / 2 - float(y)

    def line(self, start: np.ndarray, end: np.ndarray, colour: str, width: float, opacity: float = 1.0) -> None:
        (a, b), (c, d) = self.at(start), self.at(end)
        self.marks.append(
            f'<line x1="{a:.1f}" y1="{b:.1f}" x2="{c:.1f}" y2="{d:.1f}" '
            f'style="stroke:var(--{colour});stroke-width:{width:g};stroke-linecap:round;opacity:{opacity:g}"/>'
        )


def _platforms(page: _Page) -> None:
    robot, found = page.scene.robot, page.scene.found
    for platform in robot.platforms:
        colour = "c2" if platform.name == robot.tool else "c5"
        ends = [end for end in platform_attachments(robot) if end.body == platform.name]
        corners = np.array([attached(end, found)[1] for end in ends])
        centre = corners.mean(axis=0)
        if np.linalg.norm(corners - centre, axis=1).max() < 1e-6:
            x, y = page.at(centre)
            page.marks.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="12" style="fill:var(--{colour});opacity:.6"/>')
            continue
        normal = np.linalg.svd(corners - centre)[2]
        angle = np.arctan2((corners - centre) @ normal[1], (corners - centre) @ normal[0])
        places = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(page.at, corners[np.argsort(angle)]))
        style = f"fill:var(--{colour});fill-opacity:.5;stroke:var(--{colour});stroke-width:2"
        page.marks.append(f'<polygon points="{places}" style="{style}"/>')


def _joints(page: _Page) -> None:
    robot, found = page.scene.robot, page.scene.found
    for joint in sorted(page.scene.joints, key=lambda joint: joint.name in robot.driven):  # driven ones on top
        R, p = found[joint.name]
        driven = joint.name in robot.driven
        size = 5.5 if driven else 3.8
        style = f"fill:var(--{'c1' if driven else 'page'});stroke:var(--ink);stroke-width:1.2"
        if joint.kind == "revolute":
            half = (18 if driven else 12) / page.scale * (R @ np.array(joint.axis))
            page.line(p - half, p + half, "ink", 1)
            x, y = page.at(p)
            page.marks.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{size}" style="{style}"/>')
        else:
            x, y = page.at(p)
            page.marks.append(
                f'<rect x="{x - size:.1f}" y="{y - size:.1f}" width="{2 * size}" height="{2 * size}" style="{style}"/>'
            )


def _names(page: _Page) -> None:
    """Name the driven joints, each in the corner farthest from other marks; those at one place together."""
    scene = page.scene
    at: dict[tuple[int, int], list[str]] = {}
    for joint in scene.joints:
        if joint.name in scene.robot.driven:
            x, y = page.at(scene.found[joint.name][1])
            at.setdefault((round(x / 4), round(y / 4)), []).append(joint.name)
    marks = [page.at(scene.found[joint.name][1]) for joint in scene.joints]
    marks += [page.on_page(place) for place in scene.closings]
    for _, line in scene.lines:
        marks += [page.at(line[0] + part * (line[1] - line[0])) for part in np.linspace(0, 1, 12)]
    for names in at.values():
        x, y = page.at(scene.found[names[0]][1])
        words = ", ".join(names)
        wide = 6.0 * len(words)

        dx, dy, anchor = min(SHIFTS, key=partial(_covered, x=x, y=y, wide=wide, marks=tuple(marks)))
        page.marks.append(
            f'<text class="strong halo" x="{x + dx:.1f}" y="{y + dy:.1f}" text-anchor="{anchor}">{escape(words)}</text>'
        )
        left = x + dx - (wide if anchor == "end" else 0.0)
        marks += [(left + part * wide, y + dy - 4) for part in np.linspace(0, 1, 9)]


def _covered(
    shift: tuple[int, int, str], x: float, y: float, wide: float, marks: tuple[tuple[float, float], ...]
) -> tuple[bool, int]:
    """Decide whether a name shifted from a joint leaves the page, and count the marks it covers."""
    left = x + shift[0] - (wide if shift[2] == "end" else 0.0)
    covered = sum(left - 4 < a < left + wide + 4 and -14 < b - y - shift[1] < 6 for a, b in marks)
    return left < 0 or left + wide > WIDTH, covered


def _furniture(page: _Page) -> None:
    """Draw axes of the base, the direction of gravity, and a bar of a round length."""
    scene, bottom = page.scene, page.height - 14
    decade = 10.0 ** floor(log10(0.25 * scene.size))
    length = max(step * decade for step in (1, 2, 5) if step * decade <= 0.25 * scene.size)
    words = f"{length:g} m" if length >= 0.1 else f"{1e3 * length:g} mm"
    page.marks.append(
        f'<path class="axis" d="M14 {bottom - 4:.1f}v8m0 -4h{length * page.scale:.1f}m0 -4v8"/>'
        f'<text x="{22 + length * page.scale:.1f}" y="{bottom + 4:.1f}">{words}</text>'
    )
    axes = scene.view @ scene.upright
    x, y = WIDTH - 62, bottom - 22
    for k, name in enumerate("xyz"):
        a, b = x + 22 * axes[0, k], y - 22 * axes[1, k]
        page.marks.append(
            f'<line class="axis" x1="{x:.1f}" y1="{y:.1f}" x2="{a:.1f}" y2="{b:.1f}"/>'
            f'<text class="halo" x="{x + 30 * axes[0, k]:.1f}" y="{y - 30 * axes[1, k] + 3:.1f}" '
            f'text-anchor="middle">{name}</text>'
        )
    if np.any(scene.robot.gravity):
        page.marks.append(
            f'<path class="axis" d="M{WIDTH - 18:.0f} {y - 22:.1f}v30m-4 -6l4 6l4 -6"/>'
            f'<text x="{WIDTH - 18:.0f}" y="{y - 27:.1f}" text-anchor="middle">g</text>'
        )
