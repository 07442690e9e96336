"""Exported C code, compiled and run, beside the model in Python."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from c_code import FLAGS, GCC, Compiled, Controller, needs_gcc
from control_comparison import computed_torque
from energies import energy
from models_to_export import model_of, preslid, sprung, torques
from propelling_models import LOGGED, held, propelling, states
from robots_for_tests import ROBOTS, home, random_samples, slider_crank, trajectory, tree
from scipy.integrate import solve_ivp

from gtau.estimation.results.estimate import Estimate, Named
from gtau.export.generated import export_c as export
from gtau.robots.parameter import Parameter
from gtau.robots.robot import Joint, Mdh, Robot
from gtau.simulation.closed_loop import JointHardware, Reference, close_loop, hardware
from gtau.simulation.plant import Plant, PlantState
from gtau.uses.identified import identified, torques_of


def relative(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest difference over the largest number."""
    return float(np.abs(found - expected).max() / np.abs(expected).max())


QUICK = (
    "sprung",
    "tree",
    "ur10e",
    "slider-crank",
    "five-bar",
    "two platforms",
)  # the others take gcc too long for every day


@needs_gcc
@pytest.mark.parametrize(
    "robot",
    [
        pytest.param(robot, marks=() if robot.name in QUICK else pytest.mark.slow, id=robot.name)
        for robot in (*ROBOTS, sprung())
    ],
)
def test_c_gives_what_python_gives(robot: Robot, tmp_path: Path, rng: np.random.Generator) -> None:
    result = model_of(robot)
    c = Compiled(result, tmp_path)
    model, n, n_p = c.model, c.n, c.n_p
    q, qd, qdd = random_samples(robot, rng, 5)
    loaded = next(iter(model.payloads.values()))
    for values in (model.values, loaded):
        expected = torques(model, q, qd, qdd, values)
        still = torques(model, q, 0 * qd, 0 * qdd, values)
        for k in range(len(q)):
            assert c("start", q[k]) == 0
            tau = c("torques", qd[k], qdd[k], values, size=n)
            assert relative(tau, expected[k]) < 1e-12
            assert relative(c("currents", qd[k], qdd[k], values, size=n), expected[k] / model.gains) < 1e-12
            W = c("regressor", qd[k], qdd[k], values, size=n * n_p).reshape(n, n_p)
            assert relative(W @ values, expected[k]) < 1e-11
            gravity = c("gravity", values, size=n)
            friction = c("friction", qd[k], qdd[k], values, size=n)
            offsets = c("friction", 0 * qd[k], 0 * qdd[k], values, size=n)
            assert relative(gravity + offsets, still[k]) < 1e-12
            M = c("inertia", values, size=n * n).reshape(n, n)
            np.testing.assert_allclose(M, M.T, atol=1e-12 * np.abs(M).max())
            slower = tau - c("torques", qd[k], 0 * qdd[k], values, size=n)
            slower -= friction - c("friction", qd[k], 0 * qdd[k], values, size=n)
            assert np.abs(M @ qdd[k] - slower).max() < 1e-11 * np.abs(expected[k]).max()


@needs_gcc
def test_payloads_of_names_alike_are_two_arrays(tmp_path: Path) -> None:
    result = model_of(tree())
    (load,) = result.payloads
    loads = tuple(replace(load, name=name, run=name) for name in ("a-b", "a_b", "*/ =é"))
    c = Compiled(result.replaced(payloads=loads), tmp_path)
    for end in ("a_b", "a_b_2", "_____"):
        array = (ctypes.c_double * c.n_p).in_dll(c.library, f"{c.model.name}_parameters_with_{end}")
        np.testing.assert_array_equal(np.array(array), c.model.payloads["a-b"])


@needs_gcc
def test_payloads_stand_in_the_code(tmp_path: Path) -> None:
    c = Compiled(model_of(ROBOTS[1]), tmp_path)
    array = (ctypes.c_double * c.n_p).in_dll(c.library, "tree_parameters_with_tool_2")
    np.testing.assert_array_equal(np.array(array), c.model.payloads["tool 2"])
    assert not np.array_equal(np.array(array), c.model.values)


@needs_gcc
def test_motors_with_voltages_stand_in_the_code(tmp_path: Path) -> None:
    result = model_of(ROBOTS[1])
    first, *_ = result.robot.actuated
    known = {Parameter(kind, first): Estimate(f"{kind}_{first}", value, 0.1, "") for kind, value in
             (("R", 0.5), ("ke", 2.0))}  # fmt: skip
    c = Compiled(result.replaced(motors=Named(known)), tmp_path)
    for name, value in (("resistances", 0.5), ("back_emfs", 2.0)):
        array = (ctypes.c_double * c.n).in_dll(c.library, f"tree_{name}")
        assert list(array) == [value] + [0.0] * (c.n - 1)


@needs_gcc
def test_a_pose_out_of_reach_has_a_status_and_leaves_the_last_pose(tmp_path: Path) -> None:
    robot = next(robot for robot in ROBOTS if robot.name == "five-bar")
    c = Compiled(model_of(robot), tmp_path)
    q = home(robot)
    assert c("start", q) == 0
    before = c.pose.copy()
    assert c("move", np.array([np.pi, 0.0])) == 1  # the forearms do not meet
    np.testing.assert_array_equal(c.pose, before)
    assert c("move", np.full(2, np.nan)) == 3
    np.testing.assert_array_equal(c.pose, before)
    assert c("move", q + 1e-3) == 0


@needs_gcc
@pytest.mark.slow
def test_the_loops_close_along_a_fast_motion(tmp_path: Path) -> None:
    robot = next(robot for robot in ROBOTS if robot.name == "orthoglide")
    result = model_of(robot)
    c = Compiled(result, tmp_path)
    time = np.arange(0, 0.5, 1e-3)
    q = home(robot) + 0.08 * np.sin(2 * np.pi * 3 * time[:, None] + np.arange(3))  # 1.5 m/s
    closed = result.idm.path(q.T)
    assert c("start", q[0]) == 0
    for k in range(len(time)):
        assert c("move", q[k]) == 0
        np.testing.assert_allclose(c.pose, closed[:, k], atol=1e-12)


@needs_gcc
def test_example_and_cmake_file_work(tmp_path: Path) -> None:
    # the wheel of the extra 'test' puts it beside Python
    beside = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    cmake = shutil.which("cmake", path=beside)
    if cmake is None:
        pytest.skip("cmake is not installed (pip install 'gtau[test]' brings it)")
    robot = next(robot for robot in ROBOTS if robot.name == "five-bar")
    export(model_of(robot), tmp_path)
    options = f"-DCMAKE_C_FLAGS={' '.join(FLAGS)}"
    for command in ([cmake, "-S", tmp_path, "-B", tmp_path / "build", options], [cmake, "--build", tmp_path / "build"]):
        subprocess.run(command, check=True, capture_output=True)
    text = subprocess.check_output([tmp_path / "build" / "five_bar_example"], text=True)
    lines = text.splitlines()
    assert lines[0] == "t,vleft,vright,uleft,uright,cleft,cright"
    table = np.array([[float(entry) for entry in line.split(",")] for line in lines[1:]])
    assert table.shape == (1000, 7)
    model = identified(model_of(robot))
    t = table[:, :1]
    w = 2 * np.pi
    amplitude = 0.02
    path = (
        home(robot) + amplitude * (1 - np.cos(w * t)) / 2 + np.zeros(2),
        amplitude * w * np.sin(w * t) / 2 + np.zeros(2),
        amplitude * w**2 * np.cos(w * t) / 2 + np.zeros(2),
    )
    expected = torques(model, *path) / model.gains
    moving = np.abs(np.sin(w * t[:, 0])) > 1e-6  # at rest the sign of a velocity is chance
    np.testing.assert_allclose(table[moving, 1:5], np.tile(expected[moving], 2), rtol=1e-6, atol=1e-6)
    c = Compiled(model_of(robot), tmp_path)
    q, qd, qdd = (signal[137] for signal in path)
    c("start", q)
    torque = c("gravity", model.values, size=2) + c("friction", qd, qdd, model.values, size=2)
    np.testing.assert_allclose(table[137, 5:], torque / model.gains, rtol=1e-6)


class Replay:
    """An engine that gives recorded states, whatever the forces."""

    def __init__(self, q: np.ndarray) -> None:
        self.q, self.k = q, 0

    def start(self, q: np.ndarray) -> PlantState:
        return self._state(0)

    def advance(self, state: PlantState, force: np.ndarray, duration: float) -> PlantState:
        self.k += 1
        return self._state(min(self.k, len(self.q) - 1))

    def _state(self, k: int) -> PlantState:
        return PlantState(self.q[k], np.zeros_like(self.q[k]), self.q[k], self.q[k])


@needs_gcc
def test_the_controller_gives_the_currents_of_the_one_in_python(tmp_path: Path, rng: np.random.Generator) -> None:
    robot = next(robot for robot in ROBOTS if robot.name == "five-bar")
    result = model_of(robot)
    c = Compiled(result, tmp_path)
    time = np.arange(100) * 1e-3
    reference = Reference(time, *trajectory(robot, time))
    measured = reference.q + rng.normal(0.0, 1e-3, reference.q.shape)
    limits = {joint: JointHardware(gain=1.0, current_limit=20.0) for joint in c.model.joints}
    law = computed_torque(reference, result, bandwidth=80.0)
    made = close_loop("replayed", Replay(measured), law, hardware(c.model.joints, limits), rng, joints=c.model.joints)
    assert (np.abs(made.run.command) == 20.0).any()  # some at the limit
    assert (np.abs(made.run.command) < 20.0).any()
    controller = Controller(c, reference.q[0], bandwidth=80.0, limit=20.0, velocity=20.0, following=0.5)
    for k in range(len(time)):
        status, current = controller(reference.q[k], reference.qd[k], reference.qdd[k], measured[k])
        assert status == 0
        np.testing.assert_allclose(current, made.run.command[k], atol=2e-9)  # logs have nine decimals


def swinging(robot: Robot, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A reference that swings by 0.3 rad or m about home in 3 s, from rest."""
    w, one = 2 * np.pi / 3, np.ones(len(robot.actuated))
    way = 0.15 * (1 - np.cos(w * t)), 0.15 * w * np.sin(w * t), 0.15 * w**2 * np.cos(w * t)
    return home(robot) + way[0] * one, way[1] * one, way[2] * one


@needs_gcc
def test_an_encoder_that_stands_still_or_jumps_is_no_position(tmp_path: Path, rng: np.random.Generator) -> None:
    robot = tree()
    c = Compiled(preslid(model_of(robot, terms=False)), tmp_path)

    def statuses(measured: Callable[[float, np.ndarray], np.ndarray], cycles: int = 3000) -> np.ndarray:
        controller = Controller(c, home(robot), limit=30.0, velocity=3.0, following=0.09)
        found = []
        for k in range(cycles):
            q, qd, qdd = swinging(robot, k * 1e-3)
            status, current = controller(q, qd, qdd, measured(k * 1e-3, q))
            assert status == 0 or not current.any()
            found.append(status)
        return np.array(found)

    def rounded(t: float, q: np.ndarray) -> np.ndarray:  # constant for 35 ms at reversals, where friction jumps
        return np.round(q, 4)

    def frozen(t: float, q: np.ndarray) -> np.ndarray:  # one joint, in motion
        return np.where(np.arange(c.n) == 1, swinging(robot, min(t, 0.7))[0], q + rng.normal(0, 1e-5, c.n))

    def jumped(t: float, q: np.ndarray) -> np.ndarray:
        return q + 1.0 * (1.0 < t < 2.0)

    assert not statuses(rounded).any()
    standing = statuses(lambda t, q: home(robot))
    assert 0 < np.flatnonzero(standing)[0] < 400
    assert standing[400:].all()
    assert 9 in standing
    stuck = statuses(frozen)
    assert not stuck[:700].any()
    assert (stuck[900:1500] >= 8).all()
    bad = statuses(jumped)
    assert bad[1001:2000].all()
    assert (bad[1400:1900] == 8).all()
    assert not bad[2400:].any()


@needs_gcc
@pytest.mark.parametrize("name", ["math", "example", "kernel", "int", "3-RRR", "naïve bot", "Ω", ""])
def test_names_become_valid_identifiers(name: str, tmp_path: Path) -> None:
    robot = Robot(name, (Joint("a*/b/* %d", "ground", "revolute", Mdh(r=0.3)),))
    export(model_of(robot), tmp_path)
    sources = sorted(tmp_path.glob("*.c"))
    assert len(sources) == 4
    made = subprocess.run(
        [GCC, *FLAGS, "-O0", "-I", tmp_path, "-o", tmp_path / "all", *sources, "-lm"], capture_output=True, text=True
    )
    assert made.returncode == 0, made.stderr
    assert subprocess.check_output([tmp_path / "all"], text=True).startswith("t,v")


@needs_gcc
def test_code_for_finite_numbers_alone_is_refused(tmp_path: Path) -> None:
    export(model_of(slider_crank()), tmp_path)
    for source in ("slider_crank.c", "slider_crank_controller.c"):
        command = [GCC, "-fsyntax-only", tmp_path / source]
        assert subprocess.run(command, capture_output=True).returncode == 0
        refused = subprocess.run([*command, "-ffast-math"], capture_output=True, text=True)
        assert "compile without" in refused.stderr


@needs_gcc
def test_c_code_takes_energy_and_swings_down(tmp_path: Path, rng: np.random.Generator) -> None:
    result = propelling(tree(), -0.3)
    c = Compiled(result, tmp_path)
    n, values = c.n, c.model.values
    assert c("start", home(tree())) == 0
    for qd, qdd in zip(*states(result, rng), strict=True):
        friction = c("friction", qd, qdd, values, size=n)
        assert (friction * qd).min() >= -1e-9  # W: rounding
    result = propelling(tree())
    (tmp_path / "swing").mkdir()
    c, plant = Compiled(result, tmp_path / "swing"), Plant(result.idm, {
        name: value for name, value in result.consistency.standard.items() if name[:3] not in ("fv_", "fs_")
    })  # fmt: skip
    for speed in (-5.0, 0.4, 1.3, 3.1, 6.0):
        friction = c("friction", np.full(n, speed), np.zeros(n), values := c.model.values, size=n)
        np.testing.assert_allclose(friction, held(speed), rtol=1e-12)

    def derivative(_: float, x: np.ndarray) -> np.ndarray:
        q, qd = np.split(x, 2)
        assert c("move", q) == 0
        M = c("inertia", values, size=n * n).reshape(n, n)
        return np.concatenate([qd, np.linalg.solve(M, -c("torques", qd, 0 * qd, values, size=n))])

    def at_rest(_: float, x: np.ndarray) -> float:  # of one joint, where Coulomb friction jumps
        return float(np.abs(x[n:]).min() - 0.05)

    at_rest.terminal = True
    start = np.concatenate([home(tree()), np.full(n, 3 * LOGGED)])
    swing = solve_ivp(derivative, (0.0, 0.3), start, rtol=1e-8, events=at_rest)
    assert len(swing.t) > 10
    energies = []
    for x in swing.y.T:
        state = plant.start(x[:n])
        energies.append(energy(plant, replace(state, qd=x[n:])))
    assert np.diff(energies).max() < 1e-5 * (energies[0] - energies[-1])
    assert energies[-1] < energies[0]


@needs_gcc
@pytest.mark.parametrize("robot", [tree(), ROBOTS[[each.name for each in ROBOTS].index("five-bar")]], ids=str)
def test_friction_before_sliding_follows_the_pose(robot: Robot, tmp_path: Path) -> None:
    """Through reversals C gives what the law gives along the same path, from where it is told that the robot rests."""
    result = preslid(model_of(robot, terms=False))
    c, model = Compiled(result, tmp_path), identified(result)
    time = np.linspace(0, 0.4, 41)
    way = 0.02 * np.sin(2 * np.pi * 4 * time)[:, None]
    q, qd, qdd = home(robot) + way, np.gradient(way, time, axis=0) + 0 * home(robot), 0 * home(robot) + 0 * way
    motion = result.idm.motion(*(np.ascontiguousarray(each.T) for each in (q, qd, qdd)))
    law, z = result.friction_law, np.zeros((len(c.model.joints), len(time)))
    for k in range(1, len(time)):
        z[:, k] = np.clip(z[:, k - 1] + (q[k] - q[k - 1]) / law.widths, -1, 1)
    assert (np.abs(z) < 0.9).any(axis=1).all()
    expected = torques_of(model, motion, model.values, z).T
    assert c("start", q[0]) == 0
    for k, each in enumerate(q):  # without a state: friction that slides, from the first call on
        assert c("move", each) == 0
        sliding = torques_of(model, motion[k : k + 1], model.values).T
        assert relative(c("torques", qd[k], qdd[k], model.values, size=c.n), sliding[0]) < 1e-9
    assert c("start", q[0]) == 0
    c("rest")
    for k, each in enumerate(q):
        assert c("move", each) == 0
        assert relative(c("torques", qd[k], qdd[k], model.values, size=c.n), expected[k]) < 1e-9
