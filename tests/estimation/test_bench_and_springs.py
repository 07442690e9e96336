"""A test bench for one servo, and springs of both kinds, identified from logs that the model makes."""

from __future__ import annotations

import numpy as np
import pytest
from energies import energy

from gtau.model.base_parameters import base_parameters
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.result import identify
from gtau.robots.readers.native import parse_native
from gtau.robots.robot import Robot
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run
from gtau.simulation.mujoco_plant import MujocoPlant
from gtau.simulation.plant import Plant

RATE, NOISE = 500.0, 0.02
LOAD = Payload(name="disc", mass=2.0, parameters={"mx": 0.5, "mz": 0.0, "yy": 0.13})


def run(robot: Robot, chi: dict[str, float], gain: float, seed: int, payload: Payload | None = None) -> Run:
    """Twenty seconds of five sines, with the payload's parameters on the joint's link."""
    (joint,) = robot.actuated
    time = np.arange(20 * RATE) / RATE
    rng = np.random.default_rng(seed)
    w, phase = 2 * np.pi * np.array([0.2, 0.5, 0.9, 1.4, 2.1]), rng.uniform(0, 2 * np.pi, 5)
    angle, size = w * time[:, None] + phase, 0.9 / w
    q, qd, qdd = ((each * factor).sum(axis=1)[:, None] for each, factor in (
        (np.sin(angle), size), (np.cos(angle), size * w), (-np.sin(angle), size * w**2)
    ))  # fmt: skip
    loaded = dict(chi)
    if payload is not None:
        for kind, value in {"m": payload.mass, **payload.parameters}.items():
            loaded[f"{kind}_{joint}"] = loaded.get(f"{kind}_{joint}", 0.0) + value
    current = InverseDynamics(robot).torques(q, qd, qdd, loaded) / gain
    current += NOISE * rng.normal(size=current.shape)
    return Run(f"run {seed}", (joint,), time, q, current, payload=payload)


def near(estimate: object, truth: float, share: float) -> bool:
    """Within four standard deviations, which are a small share of it."""
    value, std = estimate.value, estimate.std
    return abs(value - truth) < 4 * std and std < share * abs(truth)


def test_a_bench_separates_torque_constant_and_friction() -> None:
    robot = load_robot("test-bench")
    truth = {
        "mx_arm": 0.12,
        "mz_arm": 0.01,
        "yy_arm": 0.03,
        "ia_arm": 0.05,
        "fv_arm": 0.4,
        "fs_arm": 0.9,
        "off_arm": 0.1,
    }
    found = identify(robot, [run(robot, truth, 3.2, 1), run(robot, truth, 3.2, 2, LOAD)])
    assert near(found.drive_gains["arm"], 3.2, 0.01)
    assert near(found.parameters["fs_arm"], 0.9, 0.02)
    assert near(found.parameters["fv_arm"], 0.4, 0.05)
    assert near(found.parameters["mx_arm"], 0.12, 0.1)
    assert near(found.parameters["yy_armR"], 0.08, 0.05)


def test_a_spring_is_identified_beside_gravity_and_friction() -> None:
    text = """robot: sprung
joints: {arm: {antecedent: ground, rpy: [0, pi/2, 0], axis: [0, 1, 0], type: revolute, stiffness: true, springref: 0.3}}
"""
    robot = parse_native(text, "sprung.yaml")
    truth = {"mx_arm": 0.3, "yy_arm": 0.08, "fv_arm": 0.4, "fs_arm": 0.5, "k_arm": 6.0, "off_arm": 0.2}
    found = identify(robot, [run(robot, truth, 2.5, 1), run(robot, truth, 2.5, 2, LOAD)])
    assert near(found.drive_gains["arm"], 2.5, 0.01)
    assert near(found.parameters["k_arm"], 6.0, 0.02)
    assert near(found.parameters["off_arm"], 0.2, 0.3)
    (line,) = (line for line in found.summary().splitlines() if "k_arm" in line)
    assert " N m/rad " in line


def test_a_gas_spring_is_identified_beside_gravity_and_friction() -> None:
    """Its stiffness acts as a moment of mass on one joint, so it is part of ``mx_armR``; the preload is not."""
    text = """robot: balanced
joints: {arm: {antecedent: ground, rpy: [0, pi/2, 0], axis: [0, 1, 0], type: revolute}}
springs: {gas: {between: [{body: ground, xyz: [-0.15, 0, 0.05]}, {body: arm, xyz: [0.3, 0, 0.02]}]}}
"""
    robot = parse_native(text, "balanced.yaml")
    truth = {"mx_arm": 1.2, "yy_arm": 0.6, "fv_arm": 0.8, "fs_arm": 1.5, "off_arm": 0.2, "f0_gas": 90.0, "k_gas": 60.0}
    base = base_parameters(InverseDynamics(robot))
    expected = base.matrix @ [truth.get(name, 0.0) for name in InverseDynamics(robot).parameter_names]
    found = identify(robot, [run(robot, truth, 2.5, 1), run(robot, truth, 2.5, 2, LOAD)])
    assert near(found.drive_gains["arm"], 2.5, 0.01)
    assert near(found.parameters["f0_gas"], 90.0, 0.02)
    for name, value in zip(base.names, expected, strict=True):
        if found.parameters[name].value is not None:
            assert abs(found.parameters[name].value - value) < 4 * found.parameters[name].std
    (line,) = (line for line in found.summary().splitlines() if "f0_gas" in line)
    assert " N " in line


def test_the_plants_have_springs_between_points() -> None:
    """Without friction the energy holds in gtau's plant, and MuJoCo's goes the same way."""
    text = """robot: balanced
joints:
  turret: {antecedent: ground, theta: q}
  arm: {antecedent: turret, alpha: pi/2, theta: q}
springs:
  gas: {between: [{body: turret, xyz: [-0.15, 0, 0.05]}, {body: arm, xyz: [0.3, 0, 0.02]}], stiffness: false}
  coil: {between: [{body: ground, xyz: [0.4, 0, 0.05]}, {body: arm, xyz: [0.3, 0, 0.02]}]}
"""
    model = InverseDynamics(parse_native(text, "balanced.yaml"))
    chi = {f"{kind}_{joint}": 0.5 for kind in ("xx", "yy", "zz") for joint in ("turret", "arm")}
    chi |= {"m_turret": 1.0, "m_arm": 1.0, "mx_arm": 0.3, "f0_gas": 40.0, "f0_coil": 30.0, "k_coil": 100.0}
    plants = Plant(model, chi), MujocoPlant(model, chi)
    states = [plant.start(np.array([0.2, 0.4])) for plant in plants]
    before = energy(plants[0], states[0])
    for _ in range(100):
        states = [plant.advance(state, np.zeros(2), 5e-3) for plant, state in zip(plants, states, strict=True)]
    assert np.abs(states[0].qd).max() > 0.5
    assert energy(plants[0], states[0]) == pytest.approx(before, abs=1e-5)
    np.testing.assert_allclose(states[1].q, states[0].q, atol=1e-3)


@pytest.mark.parametrize("reference", [0.0, 0.4])
def test_a_springs_reference_goes_into_the_offset(reference: float) -> None:
    """What a wrong reference leaves is a constant."""
    text = "robot: s\njoints: {j: {antecedent: ground, theta: q, stiffness: true, springref: %g}}\n" % reference  # noqa: UP031
    model = InverseDynamics(parse_native(text, "s.yaml"))
    q, still = np.linspace(-1, 1, 5)[:, None], np.zeros((5, 1))
    expected = 7.0 * (q - 0.4)
    found = model.torques(q, still, still, {"k_j": 7.0, "off_j": 7.0 * (reference - 0.4)})
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_mujocos_plant_has_the_spring() -> None:
    mujoco = pytest.importorskip("mujoco")
    from gtau.simulation.mujoco_plant import robot_spec

    robot = parse_native(
        "robot: s\njoints: {j: {antecedent: ground, theta: q, stiffness: true, springref: 0.3}}\n", "s"
    )
    compiled = robot_spec(mujoco, robot, {"xx_j": 0.1, "yy_j": 0.1, "zz_j": 0.1, "m_j": 1.0, "k_j": 5.0}).compile()
    data = mujoco.MjData(compiled)
    data.qpos[:] = 1.0
    mujoco.mj_forward(compiled, data)
    assert data.qfrc_passive[0] == pytest.approx(-5.0 * 0.7)
