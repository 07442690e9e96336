"""Every robot of the catalog: torques against two engines, loops, and base parameters counted twice."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from engines import Mujoco, Pinocchio, closed_torques, random_parameters, torques_of

from gtau.model.base_parameters import base_parameters
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.kinematics import Coordinates
from gtau.model.loop_closure import loop_errors
from gtau.robots.readers.read import catalog_names
from gtau.robots.robot import INERTIAL, Robot

DOCS = Path(__file__).parents[2] / "docs"
NAMES = catalog_names()

# dof, joints, closures and couplings, rows, rank, base parameters, of these inertial
COUNTS = {
    "3-rrr": (3, 9, 3, 18, 9, 44, 13),
    "delta": (3, 9, 3, 9, 9, 67, 37),
    "emps": (1, 1, 0, 0, 0, 4, 1),
    "five-bar": (2, 4, 1, 3, 2, 25, 11),
    "gough-stewart": (6, 18, 6, 18, 18, 148, 88),
    "orthoglide": (3, 15, 3, 18, 15, 61, 34),
    "palletiser": (4, 10, 3, 9, 6, 40, 24),
    "puma560": (6, 6, 0, 0, 0, 58, 36),
    "staubli-tx40": (6, 12, 6, 6, 6, 61, 36),
    "test-bench": (1, 1, 0, 0, 0, 6, 3),
    "ur10e": (6, 6, 0, 0, 0, 58, 36),
}


@cache
def model(name: str, parameters: str = "all") -> InverseDynamics:
    return InverseDynamics(load_robot(name), parameters)


def bounds(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Home and half of the way to the nearer position limit of the actuated joints."""
    joints = [joint for joint in robot.joints if joint.actuated]
    home = np.array([joint.home for joint in joints])
    limits = np.array([joint.limits.position or (joint.home - 3.0, joint.home + 3.0) for joint in joints])
    return home, 0.9 * np.abs(limits - home[:, None]).min(axis=1)


def random_states(robot: Robot, rng: np.random.Generator, samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    home, span = bounds(robot)
    return home + span * rng.uniform(-1, 1, (samples, home.size)), *(
        scale * span * rng.normal(size=(samples, home.size)) for scale in (2.0, 8.0)
    )


def trajectory(robot: Robot, samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    home, span = bounds(robot)
    k = np.arange(home.size)
    rate = 1.0 + 0.3 * k
    angle = np.linspace(0.0, 6.0, samples)[:, None] * rate + 0.7 * k
    return home + span * np.sin(angle), span * rate * np.cos(angle), -span * rate**2 * np.sin(angle)


def test_the_table_covers_the_catalog() -> None:
    assert set(COUNTS) == set(NAMES)


@pytest.mark.parametrize("engine", [Pinocchio, Mujoco])
@pytest.mark.parametrize("name", NAMES)
def test_torques_agree_with_engines(name: str, engine, rng: np.random.Generator) -> None:
    robot = load_robot(name)
    chi = random_parameters(robot, rng)
    for states in (random_states(robot, rng, 5), trajectory(robot, 5)):
        expected = closed_torques(robot, chi, *states, engine=engine)
        found = model(name).torques(*states, chi)
        assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()


@pytest.mark.parametrize("name", [name for name in NAMES if COUNTS[name][3]])
def test_loops_close_within_the_limits(name: str, rng: np.random.Generator) -> None:
    robot = load_robot(name)
    idm = model(name)
    motion = idm.motion(*(array.T.copy() for array in random_states(robot, rng, 50)))
    assert idm.loops is not None
    assert idm.loops.gap(motion.c).max() < 1e-12 * max(1.0, np.abs(motion.c).max())
    # and home as written
    error, _ = loop_errors(Coordinates(robot))(Coordinates(robot).home)
    assert np.abs(error).max(initial=0.0) < 1e-12
    assert robot.notes == ()


@pytest.mark.parametrize("name", NAMES)
def test_counts(name: str) -> None:
    robot, idm = load_robot(name), model(name)
    dof, joints, ties, rows, rank, base, inertial = COUNTS[name]
    assert (len(robot.actuated), len(robot.joints), len(robot.closures) + len(robot.couplings)) == (dof, joints, ties)
    assert (idm.loops.rows, len(idm.layout.passive)) == (rows, rank) if idm.loops else rows == 0
    assert (base_parameters(idm).count, base_parameters(model(name, "inertial")).count) == (base, inertial)


@pytest.mark.parametrize("name", NAMES)
def test_counts_by_the_rank_of_torques(name: str, rng: np.random.Generator) -> None:
    """Torques of many random parameter sets, by Pinocchio, span as many dimensions as there are base parameters."""
    robot = load_robot(name)
    counts = COUNTS[name][-2:]
    full, inertial = ([random_parameters(robot, rng) for _ in range(count + 10)] for count in counts)
    inertial = [{key: chi[key] for key in chi if key.split("_", 1)[0] in INERTIAL} for chi in inertial]
    both = torques_of(robot, full + inertial, *random_states(robot, rng, -(-2 * len(full) // len(robot.actuated))))
    for T, count in zip((both[:, : len(full)], both[:, len(full) :]), counts, strict=True):
        sizes = np.linalg.norm(T, axis=1, keepdims=True)
        sigma = np.linalg.svd(T / np.where(sizes > 0, sizes, 1.0), compute_uv=False)
        assert sigma[count - 1] > 1e-9 * sigma[0]
        assert sigma[count:].max() < 1e-13 * sigma[0]


def test_counts_in_the_docs() -> None:
    table = re.findall(
        r"^\| \[([\w-]+)\]\(#[\w-]+\) \|(.*)\|$", (DOCS / "lookup" / "catalog.md").read_text(), flags=re.MULTILINE
    )
    found = {name: tuple(int(n) for n in re.findall(r"\d+", cells)) for name, cells in table}
    assert found == {name: (*counts[:2], *counts[-2:]) for name, counts in COUNTS.items()}


@pytest.mark.parametrize("name", NAMES)
def test_every_robot_has_its_picture(name: str) -> None:
    picture = DOCS / "images" / f"robot-{name}.png"
    assert picture.is_file()
    assert f"images/{picture.name}" in (DOCS / "lookup" / "catalog.md").read_text()
