"""The momentum observer: its momentum beside Pinocchio, its balance on simulated motions, its estimate, and its C."""

from __future__ import annotations

import ctypes
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from c_code import FLAGS, GCC, SANITIZERS, needs_gcc, sanitizing
from engines import Pinocchio
from models_to_export import model_of, preslid
from robots_for_tests import ROBOTS, home, random_samples, trajectory

import gtau
from gtau.estimation.results.estimate import Estimate
from gtau.export.generated import export_c as export
from gtau.robots.robot import Robot
from gtau.simulation.plant import Plant, PlantState
from gtau.uses.external_torques import momentum_observer, observed
from gtau.uses.identified import functions, identified

DRIVER = Path(__file__).with_name("observer_fuzz.c")
BY_NAME = {robot.name: robot for robot in ROBOTS}


@pytest.mark.parametrize("robot", [BY_NAME["seven-r"], BY_NAME["ur10e"]], ids=str)
def test_momentum_and_its_drift_are_those_of_pinocchio(robot: Robot, rng: np.random.Generator) -> None:
    result = model_of(robot, terms=False)
    chi = result.consistency.standard
    model, engine = identified(result), Pinocchio(robot, chi)
    made, joints = functions(model).outputs, robot.actuated
    ia, fv, fs, off = (np.array([chi[f"{kind}_{joint}"] for joint in joints]) for kind in ("ia", "fv", "fs", "off"))
    data, order = engine.model.createData(), engine.joint_v
    for q, qd, _ in zip(*random_samples(robot, rng, 5), strict=True):
        y, yd = np.zeros(engine.nv), np.zeros(engine.nv)
        y[engine.joint_q], yd[order] = q, qd
        M = pin.crba(engine.model, data, y)
        M = np.triu(M) + np.triu(M, 1).T
        C = pin.computeCoriolisMatrix(engine.model, data, y, yd)
        gravity = pin.computeGeneralizedGravity(engine.model, data, y)
        p = made["momentum"](q, qd, 0, model.values).full().ravel()
        drift = made["drift"](q, qd, 0, model.values).full().ravel()
        expected = (C.T @ yd - gravity)[order] - fv * qd - fs * np.sign(qd) - off
        np.testing.assert_allclose(p, (M @ yd)[order] + ia * qd, rtol=0, atol=1e-11 * np.abs(M).max())
        np.testing.assert_allclose(drift, expected, rtol=0, atol=1e-11 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["tree", "3-RRR", "five-bar"])
def test_momentum_changes_by_torques_and_its_drift_on_simulated_motions(name: str) -> None:
    """The difference of p between two instants is the integral of tau + drift, by Simpson, closed loops included."""
    robot = BY_NAME[name]
    result = model_of(robot, terms=False)
    chi = {key: 0.0 if key[:3] == "fs_" else value for key, value in result.consistency.standard.items()}
    base, model = result.base, identified(result)
    values = base.matrix @ [chi.get(each, 0.0) for each in result.idm.parameter_names]
    made, plant = functions(model).outputs, Plant(result.idm, chi)
    n, step = len(robot.actuated), 1e-3
    tau = 2.0 * np.cos(np.arange(n))
    state = plant.start(home(robot))
    state = PlantState(state.q, 0.8 * np.sin(1 + np.arange(n)), state.c, 0.8 * np.sin(1 + np.arange(n)))
    p, rate = [], []
    for _ in range(101):
        given = state.c, state.qd, 0, values
        p.append(made["momentum"](*given).full().ravel())
        rate.append(tau + made["drift"](*given).full().ravel())
        state = plant.advance(state, tau, step)
    f = np.array(rate)
    integral = step / 3 * (f[0] + 4 * f[1:-1:2].sum(axis=0) + 2 * f[2:-1:2].sum(axis=0) + f[-1])
    np.testing.assert_allclose(p[-1] - p[0], integral, rtol=0, atol=1e-6 * np.abs(f).max())


@pytest.mark.parametrize("name", ["ur10e", "five-bar"])
def test_a_contact_is_seen_behind_a_low_pass_and_from_the_past_alone(name: str) -> None:
    robot = BY_NAME[name]
    result = model_of(robot, terms=False)
    delays = {joint: Estimate(joint, d, None, "s") for joint, d in zip(robot.actuated, (4e-3, -2e-3), strict=False)}
    result = result.replaced(delays=dict(result.delays) | delays)
    late = np.array([result.delays[joint].value for joint in robot.actuated])
    time, n, bandwidth, onset = np.arange(0, 3, 1e-3), len(robot.actuated), 5.0, 1.5
    push = 3.0 * np.cos(np.arange(n))
    torque = np.empty((len(time), n))
    for j, d in enumerate(late):  # v(t - d) g = tau(t)
        at = time + d
        torque[:, j] = result.torques(*trajectory(robot, at))[:, j] - push[j] * (at > onset)
    q = trajectory(robot, time)[0]
    run = gtau.Run("pushed", robot.actuated, time, q, torque / result.gains)
    found = momentum_observer(result, run, bandwidth)
    lag = 2e-3 + 1e-3  # of the currents that are logged late, and of a period
    expected = push * np.clip(1 - np.exp(-2 * np.pi * bandwidth * (time - onset - lag)), 0, 1)[:, None]
    calm = np.ones_like(time, dtype=bool)
    qd = np.gradient(q, time, axis=0)
    turns = np.flatnonzero((np.diff(np.sign(qd), axis=0) != 0).any(axis=1))
    for k in turns:  # where Coulomb friction jumps, between two samples
        calm &= ~((time > time[k] - 0.01) & (time < time[k] + 0.5))
    calm &= time > 0.6
    assert calm.sum() > 100
    assert np.abs(found - expected)[calm].max() < 0.05
    end = 2000
    cut = replace(run, time=time[:end], position=q[:end], command=run.command[:end], valid=run.valid[:end])
    before = momentum_observer(result, cut, bandwidth)
    np.testing.assert_allclose(before, found[:end], rtol=0, atol=1e-10)  # loops are closed in other blocks


class Observer:
    """The exported observer of a result, compiled."""

    def __init__(self, result: gtau.Result, folder: Path) -> None:
        self.model = identified(result)
        export(result, folder)
        name, library = self.model.name, folder / "observer.so"
        sources = [folder / f"{name}.c", folder / f"{name}_observer.c"]
        subprocess.run([GCC, *FLAGS, "-O0", "-shared", "-fPIC", "-o", library, *sources, "-lm"], check=True)
        loaded = ctypes.CDLL(str(library))
        self.start, self.cycle = (getattr(loaded, f"{name}_observer_{each}") for each in ("start", "cycle"))
        self.memory, self.array = ctypes.create_string_buffer(1 << 14), ctypes.c_double * len(self.model.joints)
        self.parameters = (ctypes.c_double * len(self.model.parameters))(*self.model.values)

    def along(self, time: np.ndarray, q: np.ndarray, current: np.ndarray, bandwidth: float) -> np.ndarray:
        array, out, found = self.array, self.array(), []
        period, w = ctypes.c_double(np.median(np.diff(time))), ctypes.c_double(2 * np.pi * bandwidth)
        bounds = array(*[1e3] * q.shape[1])
        assert self.start(self.memory, period, w, bounds, bounds, array(*q[0])) == 0
        for h, each, v in zip(np.diff(time, prepend=2 * time[0] - time[1]), q, current, strict=True):
            assert self.cycle(self.memory, ctypes.c_double(h), array(*each), array(*v), self.parameters, out) == 0
            found.append(list(out))
        return np.array(found)


@needs_gcc
@pytest.mark.parametrize(
    ("name", "slides"),
    [("ur10e", False), ("five-bar", True), pytest.param("orthoglide", True, marks=pytest.mark.slow)],
)
def test_c_observes_what_python_observes(name: str, slides: bool, tmp_path: Path, rng: np.random.Generator) -> None:
    robot = BY_NAME[name]
    result = preslid(model_of(robot, terms=False)) if slides else model_of(robot)
    time = 1.0 + np.cumsum(rng.uniform(0.8e-3, 1.2e-3, 300))
    q = trajectory(robot, time)[0]
    current = rng.normal(size=q.shape)
    c = Observer(result, tmp_path)
    expected = observed(result, c.model.values, time, q, current * c.model.gains, 4.0)
    np.testing.assert_allclose(c.along(time, q, current, 4.0), expected, rtol=0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["five-bar", pytest.param("ur10e", marks=pytest.mark.slow)])
def test_bad_inputs_have_a_status_and_do_not_count(name: str, tmp_path: Path) -> None:
    robot = BY_NAME[name]
    result = model_of(robot)
    export(result, tmp_path)
    (tmp_path / "motion.h").write_text(f"#define HOME_Q {', '.join(map(repr, home(robot).tolist()))}\n")
    c_name = identified(result).name
    text = DRIVER.read_text().replace("robot_", f"{c_name}_").replace("ROBOT_", f"{c_name.upper()}_")
    (tmp_path / "fuzz.c").write_text(text)
    sources = [tmp_path / f"{each}.c" for each in (c_name, f"{c_name}_observer", "fuzz")]
    flags = (*FLAGS, "-O1", *SANITIZERS)
    subprocess.run([sanitizing(tmp_path), *flags, "-o", tmp_path / "fuzz", *sources, "-lm"], check=True)
    ran = subprocess.run([tmp_path / "fuzz"], capture_output=True, text=True)
    assert ran.stdout == "OK\n", ran.stdout + ran.stderr
    assert ran.returncode == 0
