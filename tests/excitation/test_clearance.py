"""Bodies kept apart: distances and their slopes, and designs that keep them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from gtau.errors import GtauError
from gtau.excitation.clearance import FLOOR, Capsule, Clearance, Floor, clearance, hull
from gtau.excitation.design import check, excite
from gtau.excitation.design_file import read_design
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.singularities import random_motion
from gtau.robots.readers.native import parse_native
from gtau.robots.robot import Pose

ARM = """robot: arm
joints:
  turret: {antecedent: ground, theta: q, limits: {position: [-1, 1], velocity: 2, acceleration: 10, effort: 200}}
  arm:
    {antecedent: turret, alpha: pi/2, theta: q,
     limits: {position: [-0.5, 1], velocity: 2, acceleration: 10, effort: 200}}
  forearm:
    {antecedent: arm, d: 0.5, theta: q, home: 0.5,
     limits: {position: [-2.9, 2.9], velocity: 3, acceleration: 10, effort: 90}}
"""
DESIGN = """robot: arm.yaml
rate: 200
period: 4
harmonics: 3
runs: [{payload: none}, {payload: {name: disc, mass: 2}}]
limits:
  %s
"""
SHAPES = """clearance: 0.05
  share: 1
  floor: none
  shapes:
    turret: []
    ground: [{capsule: [[0.55, 0.5, -0.2], [0.55, 0.5, 0.4]], radius: 0.05}]
    arm: [{capsule: [[0.05, 0, 0], [0.4, 0, 0]], radius: 0.05}]
    forearm: [{capsule: [[0.1, 0, 0], [0.5, 0, 0]], radius: 0.04}]
"""
CUBE = """v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nv 1 1 0\nv 1 0 1\nv 0 1 1\nv 1 1 1
f 1 2 5\nf 1 5 3\nf 4 6 8\nf 4 8 7\nf 1 2 6\nf 1 6 4\nf 3 5 8\nf 3 8 7\nf 1 3 7\nf 1 7 4\nf 2 5 8\nf 2 8 6
"""


def capsule(start: Iterable[float], end: Iterable[float], radius: float) -> Capsule:
    return Capsule(np.array([*start], dtype=float), np.array([*end], dtype=float), radius)


def written(tmp_path: Path, limits: str) -> Path:
    (tmp_path / "arm.yaml").write_text(ARM)
    path = tmp_path / "design.yaml"
    path.write_text(DESIGN % limits)
    return path


def slopes_agree(built: Clearance, c: np.ndarray, pair: tuple[str, str], ways: np.ndarray) -> None:
    nearest = built.nearest(c, pair)
    slopes, h = np.einsum("cn,cn->n", built.slopes(c, pair, nearest), ways), 1e-6
    ahead, behind = (built.nearest(c + step * ways, pair).distance for step in (h, -h))
    smooth = np.abs(ahead + behind - 2 * nearest.distance) < 1e-9  # not where another point becomes the nearest
    assert smooth.mean() > 0.8
    np.testing.assert_allclose(slopes[smooth], ((ahead - behind) / (2 * h))[smooth], atol=2e-6)


def test_distances_and_slopes_of_capsules(rng: np.random.Generator) -> None:
    robot = parse_native(ARM, "arm.yaml")
    shapes = {
        "ground": [capsule((0, 0.3, 0), (0, 0.3, 0.6), 0.05)],
        "forearm": [capsule((0, 0, 0), (0.4, 0.1, 0), 0.03)],
    }
    built = clearance(InverseDynamics(robot).layout, 0.02, shapes)
    c = rng.uniform(-1, 1, (3, 40))
    nearest = built.nearest(c, ("ground", "forearm"))
    for k in range(40):  # the segments, sampled
        q0, q1, q2 = c[:, k]
        R = np.array([[np.cos(q0), -np.sin(q0), 0], [np.sin(q0), np.cos(q0), 0], [0, 0, 1]])
        lean = np.array([[np.cos(q1 + q2), -np.sin(q1 + q2)], [np.sin(q1 + q2), np.cos(q1 + q2)]])
        elbow = 0.5 * np.array([np.cos(q1), np.sin(q1)])
        plane = elbow[:, None] + np.outer(lean @ [0.4, 0.1], np.linspace(0, 1, 401))
        link = R @ np.array([plane[0], np.zeros(401), plane[1]])
        post = np.array([np.zeros(601), np.full(601, 0.3), np.linspace(0, 0.6, 601)])
        apart = np.linalg.norm(link[:, :, None] - post[:, None, :], axis=0).min() - 0.08
        assert nearest.distance[k] == pytest.approx(apart, abs=1e-3)
    slopes_agree(built, c, ("ground", "forearm"), rng.normal(size=c.shape))


def test_several_pairs_at_once_are_those_one_by_one(rng: np.random.Generator) -> None:
    ends = rng.uniform(-0.5, 0.5, (5, 2, 3))
    capsules = [capsule(*points, radius) for points, radius in zip(ends, (0.01, 0.02, 0.03, 0.04, 0.05), strict=True)]
    shapes = {"ground": capsules[:2], FLOOR: [Floor(-0.1)], "arm": capsules[2:3], "forearm": capsules[3:]}
    built, c = (
        clearance(InverseDynamics(parse_native(ARM, "arm.yaml")).layout, 0.02, shapes),
        rng.uniform(-3, 3, (3, 9)),
    )
    assert len(built.pairs) == 4
    for pair, near in zip(built.pairs, built.all_nearest(c, built.pairs), strict=True):
        alone = [clearance(built.layout, 0.02, dict(zip(pair, ([one], [other]), strict=True))).nearest(c, pair)
                 for one in shapes[pair[0]] for other in shapes[pair[1]]]  # fmt: skip
        closest = np.argmin([contact.distance for contact in alone], axis=0)
        for name in ("distance", "normal", "a", "b"):
            wanted = np.array([getattr(contact, name) for contact in alone])[closest, ..., np.arange(9)].T
            np.testing.assert_allclose(getattr(near, name), wanted, atol=1e-12)


def test_slopes_with_a_platform_and_a_mesh(tmp_path: Path, rng: np.random.Generator) -> None:
    (tmp_path / "cube.obj").write_text(CUBE)
    model = InverseDynamics(load_robot("orthoglide"))
    block = hull(tmp_path / "cube.obj", 0.1, Pose((0.3, 0.3, 0.6)))
    built = clearance(model.layout, 0.02, {"ground": [block], "P": [capsule((0, 0, 0), (0, 0, 0), 0.03)]})
    c = random_motion(model, 20, rng).c
    ways = np.zeros_like(c)
    for slots in model.layout.platforms:
        ways[slots.position] = rng.normal(size=(3, 20))
    slopes_agree(built, c, ("ground", "P"), ways)
    at = c[model.layout.platforms[0].position]
    outside = np.maximum(0, np.maximum(np.array([[0.3], [0.3], [0.6]]) - at, at - np.array([[0.4], [0.4], [0.7]])))
    np.testing.assert_allclose(
        built.nearest(c, ("ground", "P")).distance, np.linalg.norm(outside, axis=0) - 0.03, atol=1e-6
    )


def test_neighbours_may_touch(tmp_path: Path) -> None:
    task, _ = read_design(written(tmp_path, SHAPES))
    assert task.limits.clearance.pairs == (("ground", "arm"), ("ground", "forearm"))


@pytest.mark.slow
def test_a_design_keeps_its_distance(tmp_path: Path) -> None:
    """Without shapes the forearm swings into the post; with them every sample of a run, approach included, is clear."""
    free, _ = read_design(written(tmp_path, "share: 1\n  floor: none\n  shapes: none"))
    task, _ = read_design(written(tmp_path, SHAPES))
    touching = excite(free, starts=1, seed=1)
    pair = ("ground", "forearm")
    named = f"distance of '{pair[1]}' from '{pair[0]}'"
    (usage,) = (usage for usage in check(task, touching.x) if usage.what == named)
    assert usage.reached < 0.05
    clear = excite(task, starts=1, seed=1)
    (usage,) = (usage for usage in clear.constraint_usages if usage.what == named)
    assert usage.reached >= 0.05
    assert usage.allowed == "at least 0.05 m"


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ("shapes: {leg: [{capsule: [[0, 0, 0], [0, 0, 1]], radius: 0.1}]}", "limits.shapes names 'leg', which is no"),
        ("shapes: {arm: [{capsule: [[0, 0, 0], [0, 0, 1]]}]}", "a capsule has a 'radius', m, and a mesh has none"),
        ("shapes: {arm: [{radius: 0.1}]}", "a shape is either 'capsule: "),
        ("shapes: {arm: [{mesh: no.stl}]}", "there is no mesh '.*no.stl'; correct the path"),
        ("shapes: {ground: [{capsule: [[0, 0, 0], [1, 0, 0]], radius: 0.1}], forearm: [{capsule: [[0, 0, 0], "
         "[0, 0, 0]], radius: 0.1}]}", "'ground' and 'forearm' are -0.2 m apart at rest, less than limits.clearance"),
    ],
)  # fmt: skip
def test_shapes_that_cannot_be(limits: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(GtauError, match=message):
        read_design(written(tmp_path, limits))
