"""Logs in which little moves or all is coarse: a result or one sentence, and no division by zero, on every robot."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from plausible_parameters import random_parameters
from typer.testing import CliRunner

import gtau.robots
from gtau.cli.commands import app
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics

CATALOG = sorted(path.stem for path in (Path(gtau.robots.__file__).parent / "catalog").glob("*.yaml"))
SECONDS, STEEL = 8.0, 2.0  # s, kg
Log = tuple[np.ndarray, np.ndarray, np.ndarray]  # times (N,), positions and currents (N, n)


def simulated(model: InverseDynamics, loaded: bool, rate: float = 250.0, moving: slice = slice(None)) -> Log:
    """Five harmonics of 0.2 Hz around home; other joints than the ``moving`` ones rest."""
    rng = np.random.default_rng(2 + loaded)
    robot, joints = model.robot, model.actuated
    home = np.asarray(model.loops.home if model.loops else model.layout.home)[model.layout.actuated]
    chi = random_parameters(model, np.random.default_rng(3))
    if loaded:
        chi = {**chi, f"m_{robot.tool}": chi.get(f"m_{robot.tool}", 0.0) + STEEL}
    slides = np.array([robot.joint(joint).kind == "prismatic" for joint in joints])
    time = np.arange(int(SECONDS * rate)) / rate
    w = 2 * np.pi * 0.2 * np.arange(1, 6)
    angle = w * time[:, None, None] + rng.uniform(0, 2 * np.pi, (len(joints), 5))
    size = np.zeros((len(joints), 1))
    size[moving] = np.where(slides, 0.03, 0.2)[moving, None]
    q = home + (size / w * np.sin(angle)).sum(axis=2)
    torques = model.torques(q, (size * np.cos(angle)).sum(axis=2), -(size * w * np.sin(angle)).sum(axis=2), chi)
    current = torques / np.where(slides, 100.0, 5.0)
    return time, q, current + 1e-3 * rng.standard_normal(current.shape)


def one_joint(model: InverseDynamics, loaded: bool) -> Log:
    return simulated(model, loaded, moving=slice(0, 1))


def rest_in_the_second_half(model: InverseDynamics, loaded: bool) -> Log:
    time, q, current = simulated(model, loaded)
    half = len(time) // 2
    q[half:], current[half:] = q[half], current[half]
    return time, q, current


def rest_in_the_loaded_run(model: InverseDynamics, loaded: bool) -> Log:
    time, q, current = simulated(model, loaded)
    return time, q[:1] + 0 * q if loaded else q, current


def no_current(model: InverseDynamics, loaded: bool) -> Log:
    time, q, current = simulated(model, loaded)
    current[:, -1] = 0.0
    return time, q, current


def coarse(model: InverseDynamics, loaded: bool) -> Log:
    time, q, current = simulated(model, loaded)
    quantum = np.ptp(q, axis=0) / 100
    return time, np.round(q / quantum) * quantum, current


def slow(model: InverseDynamics, loaded: bool) -> Log:
    return simulated(model, loaded, rate=14.0)


def the_same_twice(model: InverseDynamics, loaded: bool) -> Log:
    return simulated(model, False)


def offset(model: InverseDynamics, loaded: bool) -> Log:
    time, q, current = simulated(model, loaded)
    return time, q, current + 1e4


POOR = [
    one_joint, rest_in_the_second_half, rest_in_the_loaded_run, no_current, coarse, slow, the_same_twice, offset,
]  # fmt: skip


def outcomes(robot: str, made: Callable[[InverseDynamics, bool], Log], folder: Path) -> None:
    model = InverseDynamics(load_robot(robot))
    n = len(model.actuated)
    header = ",".join(["t", *(f"q{k}" for k in range(n)), *(f"v{k}" for k in range(n))])
    for name, loaded in (("free", False), ("loaded", True)):
        table = np.column_stack(made(model, loaded))
        np.savetxt(folder / f"{name}.csv", table, delimiter=",", header=header, comments="", fmt="%.10g")
    columns = [", ".join(f"{joint}: {letter}{k}" for k, joint in enumerate(model.actuated)) for letter in "qv"]
    experiment = folder / "experiment.yaml"
    experiment.write_text(
        f"robot: {robot}\nsignals: {{time: t, position: {{{columns[0]}}}, current: {{{columns[1]}}}}}\n"
        f"runs:\n  - log: free.csv\n  - {{log: loaded.csv, payload: {{name: steel, mass: {STEEL}}}}}\n"
    )
    for command in ("check", "identify"):
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            run = CliRunner().invoke(app, [command, str(experiment), "--out", str(folder / "out")])
        assert run.exception is None or isinstance(run.exception, SystemExit), run.exception
        assert run.exit_code in (0, 2, 3), run.output
        if command == "identify" and run.exit_code == 2:
            assert run.output.startswith("gtau: "), run.output
            assert run.output.rstrip().endswith("."), run.output


@pytest.mark.slow
def test_poor_logs_of_a_five_bar_end_in_a_result_or_a_sentence(tmp_path: Path) -> None:
    for made in (rest_in_the_second_half, coarse, offset):
        outcomes("five-bar", made, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("robot", CATALOG)
def test_poor_logs_of_every_robot_end_in_a_result_or_a_sentence(robot: str, tmp_path: Path) -> None:
    assert len(CATALOG) >= 11
    for made in POOR:
        outcomes(robot, made, tmp_path)
