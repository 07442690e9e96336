"""Actuators for simulators: files that MuJoCo loads with the bodies, and data with fields of mjlab and Isaac Lab."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml
from models_to_export import model_of

from gtau.estimation.results.estimate import Estimate, Named
from gtau.export.exported import export_model
from gtau.result import Result
from gtau.robots.parameter import Parameter
from gtau.robots.robot import Joint, Limits, Pose, Robot

MJLAB = {  # fields of BuiltinMotorActuatorCfg and ActuatorCfg, mjlab.actuator
    *("target_names_expr", "transmission_type", "armature", "velocity_limit", "frictionloss", "viscous_damping"),
    *("delay_min_lag", "delay_max_lag", "delay_hold_prob", "delay_update_period", "effort_limit", "gear"),
}
ISAACLAB = {  # fields of DelayedPDActuatorCfg and ActuatorBaseCfg, isaaclab.actuators
    *("joint_names_expr", "effort_limit", "velocity_limit", "armature", "friction", "dynamic_friction"),
    *("viscous_friction", "stiffness", "damping", "min_delay", "max_delay"),
}
ARM = Robot(
    "arm",
    (
        Joint("a", "ground", "revolute", Pose((0.0, 0.0, 0.3)), limits=Limits((-2.0, 2.0), 3.0, None, 90.0)),
        Joint("b", "a", "revolute", Pose((0.0, 0.1, 0.2)), (0.0, 1.0, 0.0), limits=Limits(None, 3.0, None, 90.0)),
        Joint("c", "b", "revolute", Pose((0.4, 0.0, 0.1), (0.2, 0.1, 0.0)), (0.0, 0.0, 1.0)),
    ),
)
LATE = 0.004  # s


@pytest.fixture(scope="module")
def result() -> Result:
    made = model_of(ARM, terms=False)
    delays = {**made.delays, "b": Estimate("b", LATE, 0.0005, "s"), "c": Estimate("c", -0.002, 0.0005, "s")}
    return made.replaced(delays=delays)


def forces(model: mujoco.MjModel, ctrl: np.ndarray, seed: int) -> np.ndarray:
    """What drives the joints at a random state: actuators, damping, inertia and limits of dry friction."""
    rng, data = np.random.default_rng(seed), mujoco.MjData(model)
    data.qpos, data.qvel, data.ctrl = rng.uniform(-1, 1, model.nq), rng.uniform(-1, 1, model.nv), ctrl
    mujoco.mj_forward(model, data)
    return np.concatenate([data.qfrc_actuator, data.qfrc_passive, data.qfrc_bias, data.qacc, model.dof_frictionloss])


def test_mujoco_drives_bodies_and_actuators_as_the_whole_model(result: Result, tmp_path: Path) -> None:
    undelayed = result.replaced(delays=model_of(ARM, terms=False).delays)
    (whole,) = export_model(undelayed, "mjcf", tmp_path / "whole").files
    divided, _ = export_model(undelayed, "mujoco-actuators", tmp_path / "divided").files
    one, other = (mujoco.MjModel.from_xml_path(str(path)) for path in (whole, divided))
    assert list(other.actuator_forcerange[0]) == [-90.0, 90.0]
    ctrl = np.array([1.5, -2.0, 0.7])
    for seed in range(5):
        np.testing.assert_allclose(forces(one, ctrl, seed), forces(other, ctrl, seed), rtol=1e-9, atol=1e-9)


def test_a_body_of_ones_own_takes_the_actuators(result: Result, tmp_path: Path) -> None:
    export_model(result, "mujoco-actuators", tmp_path)
    own = """<mujoco><include file="arm_actuators.xml"/><worldbody>
      <body><inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/><joint name="a" class="drive a" axis="0 0 1"/>
      <body><inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/><joint name="b" class="drive b" axis="0 1 0"/>
      <body><inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/><joint name="c" class="drive c" axis="0 0 1"/>
      </body></body></body></worldbody></mujoco>"""
    (tmp_path / "own.xml").write_text(own)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "own.xml"))
    standard = result.consistency.standard
    np.testing.assert_allclose(model.dof_armature, [standard[f"ia_{joint}"] for joint in "abc"])
    np.testing.assert_allclose(model.dof_frictionloss, [standard[f"fs_{joint}"] for joint in "abc"])
    np.testing.assert_allclose(np.ravel(model.dof_damping), [standard[f"fv_{joint}"] for joint in "abc"])


def test_a_command_acts_after_its_delay(result: Result, tmp_path: Path) -> None:
    if not hasattr(mujoco.MjsActuator, "delay"):
        pytest.skip("this MuJoCo has no delay of actuators")
    whole, _ = export_model(result, "mujoco-actuators", tmp_path).files
    model = mujoco.MjModel.from_xml_path(str(whole))
    data = mujoco.MjData(model)
    gains = np.array([gain for gain, _ in result.consistency.gains.values()])
    offsets = np.array([result.consistency.standard[f"off_{joint}"] for joint in "abc"])
    data.ctrl = 1.0
    arrived = np.zeros(3)
    while data.time < 2 * LATE:
        mujoco.mj_step(model, data)
        acting = np.isclose(data.actuator_force, gains - offsets, rtol=1e-6)
        arrived = np.where((arrived == 0) & acting, data.time, arrived)
    assert arrived[0] <= 2 * model.opt.timestep
    assert arrived[1] == pytest.approx(LATE, abs=2 * model.opt.timestep)
    assert arrived[2] <= 2 * model.opt.timestep  # a negative delay is none


def test_what_is_not_identifiable_is_said_and_not_invented(result: Result, tmp_path: Path) -> None:
    exported = export_model(result, "mjlab", tmp_path)
    said = " ".join(exported.notes)
    assert "the armature is not identifiable apart from the inertia of links" in said
    assert "'a' (zz_aR)" in said
    assert "no effort limit of c" in said
    document = yaml.safe_load(exported.files[0].read_text())
    entries = {entry["target_names_expr"][0]: entry for entry in document["actuators"]}
    assert "armature" not in entries["a"]
    assert entries["c"]["armature"] == pytest.approx(result.consistency.standard["ia_c"])
    assert "effort_limit" not in entries["c"]
    assert document["measured"]["a"]["armature"]["not_identifiable_apart_from"] == "zz_aR"
    body = mujoco.MjModel.from_xml_path(str(exported.files[1]))
    assert body.nu == 0
    assert body.dof_armature[0] == pytest.approx(result.consistency.standard["ia_a"])  # what mjlab then keeps


def test_keys_are_the_fields_that_the_programs_document(result: Result, tmp_path: Path) -> None:
    entries = yaml.safe_load(export_model(result, "mjlab", tmp_path).files[0].read_text())["actuators"]
    assert all(set(entry) <= MJLAB for entry in entries)
    assert [entry["delay_max_lag"] for entry in entries] == [0, 1, 0]  # of 5 ms
    actuator = yaml.safe_load(export_model(result, "isaaclab", tmp_path).files[0].read_text())["actuator"]
    assert set(actuator) <= ISAACLAB
    assert set(actuator["armature"]) == {"c"}
    assert actuator["viscous_friction"]["b"] == pytest.approx(result.consistency.standard["fv_b"])


def test_motors_with_voltages_have_resistance_and_back_emf(result: Result, tmp_path: Path) -> None:
    """MuJoCo keeps them as numbers; Isaac Lab's DC motor stalls at g / R and idles at 1 / ke for each volt."""
    motors = {"R_a": Estimate("R_a", 0.5, 0.01, "ohm"), "ke_a": Estimate("ke_a", 2.0, 0.02, "V s/rad")}
    known = result.replaced(motors=Named({Parameter("R", "a"): motors["R_a"], Parameter("ke", "a"): motors["ke_a"]}))
    whole, _ = export_model(known, "mujoco-actuators", tmp_path / "mujoco").files
    model = mujoco.MjModel.from_xml_path(str(whole))
    assert [model.numeric(name).data[0] for name in ("resistance a", "back_emf a")] == [0.5, 2.0]
    document = yaml.safe_load(export_model(known, "isaaclab", tmp_path / "isaac").files[0].read_text())
    gain = abs(result.consistency.gains["a"][0])
    per_volt = document["dc_motor_per_volt"]
    assert per_volt == {"saturation_effort": {"a": pytest.approx(gain / 0.5)}, "velocity_limit": {"a": 0.5}}
    assert document["measured"]["a"]["resistance"]["value"] == 0.5
    assert "resistance" not in document["measured"]["b"]
    without = yaml.safe_load(export_model(result, "isaaclab", tmp_path / "without").files[0].read_text())
    assert "dc_motor_per_volt" not in without
