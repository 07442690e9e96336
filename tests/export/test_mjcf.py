"""Exported MJCF, loaded by MuJoCo: torques, closures and currents beside the model's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from models_to_export import model_of, preslid, sprung
from robots_for_tests import CLOSED, SERIAL

from gtau.errors import GtauError
from gtau.export import mjcf
from gtau.export.consistent import consistent_model
from gtau.export.mjcf import export
from gtau.model.home import load_robot
from gtau.model.loops import Motion
from gtau.model.singularities import random_motion
from gtau.result import Result
from gtau.robots.robot import Coupling, Joint, Pose, Robot
from gtau.simulation.mujoco_plant import platform_coordinates

GEARED = Robot(
    "geared",
    (
        Joint("1", "ground", "revolute", Pose((0.0, 0.1, 0.2), (0.3, 0.2, 0.1))),
        Joint("2", "1", "revolute", Pose((0.4, 0.0, 0.1), (0.5, 0.0, 0.0)), (0.0, 0.6, 0.8), actuated=False),
        Joint("3", "2", "prismatic", Pose((0.2, 0.1, 0.0), (0.0, 0.9, 0.0)), (1.0, 0.0, 0.0)),
    ),
    couplings=(Coupling("2", (("1", -1.5),), 0.2),),
)
QUICK = ("sprung", "tree", "slider-crank", "five-bar", "geared")
FIT = [*SERIAL, GEARED, sprung(), *(robot for robot in CLOSED if robot.name != "two platforms")]


def state(result: Result, model: mujoco.MjModel, motion: Motion, k: int) -> tuple[np.ndarray, np.ndarray]:
    """MuJoCo's configuration (nq,) of sample k, and the map (nv, n_y) of velocities, whose own axes a ball turns in."""
    layout = result.idm.layout
    qpos, T = model.qpos0.copy(), np.zeros((model.nv, layout.n_y))
    for row, joint in enumerate(result.robot.joints):
        qpos[model.joint(joint.name).qposadr[0]] = motion.c[row, k]
        T[model.joint(joint.name).dofadr[0], row] = 1.0
    for slots in layout.platforms:
        for name, values in platform_coordinates(slots, motion.c[:, k]).items():
            first = model.joint(name).qposadr[0]
            qpos[first : first + len(values)] = values
            dof = model.joint(name).dofadr[0]
            rates = np.arange(slots.rates.start, slots.rates.stop)
            if len(values) == 4:
                data = mujoco.MjData(model)
                data.qpos = qpos
                mujoco.mj_kinematics(model, data)
                T[dof : dof + 3, rates[-3:]] = data.body(slots.platform.name).xmat.reshape(3, 3).T
            else:
                T[dof, rates[slots.platform.dof.index(name.split("_")[0].replace("turn", "rz"))]] = 1.0
    return qpos, T


@pytest.mark.parametrize(
    "robot",
    [pytest.param(robot, marks=() if robot.name in QUICK else pytest.mark.slow, id=robot.name) for robot in FIT],
)
def test_mujoco_moves_with_the_torques_of_the_model(robot: Robot, tmp_path: Path, rng: np.random.Generator) -> None:
    result = model_of(robot)
    result = result.replaced(friction={name: each for name, each in result.friction.items() if name.startswith("f3")})
    idm, standard = result.idm, dict(result.consistency.standard)
    standard |= {f"off_{joint.name}": 0.0 for joint in robot.joints if not joint.actuated}
    result = result.replaced(consistency=replace(result.consistency, standard=standard))
    (path,) = export(result, tmp_path).files
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    motion = random_motion(idm, 10, rng)
    values = np.array([standard[name] for name in idm.parameter_names])
    tau = idm.full.torques_along(idm.layout, motion, values)
    speed = motion.yd[idm.layout.actuated]
    tau += np.array([[result.friction[f"f3_{joint}"].value] for joint in robot.actuated]) * speed**3
    for k in range(10):
        data.qpos, T = state(result, model, motion, k)
        v, a = T @ motion.yd[:, k], T @ motion.ydd[:, k]
        data.qvel = v
        data.ctrl = 0.0
        mujoco.mj_forward(model, data)
        assert np.abs(data.efc_pos[: data.ne]).max(initial=0.0) < 1e-9  # the closures are MuJoCo's too
        Ma = np.zeros(model.nv)
        mujoco.mj_mulM(model, data, Ma, a)
        effort = Ma + data.qfrc_bias - data.qfrc_passive + model.dof_frictionloss * np.sign(v)
        gears = np.array([model.actuator(joint).gear[0] for joint in robot.actuated])
        current = ((T @ motion.J[:, :, k]).T @ (effort - data.qfrc_actuator)) / gears
        np.testing.assert_allclose(gears, [gain for gain, _ in result.consistency.gains.values()])
        np.testing.assert_allclose(current * gears, tau[:, k], atol=1e-7 * np.abs(tau).max())


def test_limits_and_rest_positions_are_in_radians(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the model that the export compiles as in the file; MuJoCo's specs count in degrees unless told."""
    limits = {"1": (-0.5, 1.2), "2": (-2.0, -0.1), "3": (-0.3, 0.7)}
    robot = sprung()
    joints = [replace(joint, limits=replace(joint.limits, position=limits.get(joint.name))) for joint in robot.joints]
    robot, built = replace(robot, joints=tuple(joints)), []
    original = mjcf.compiled
    monkeypatch.setattr(mjcf, "compiled", lambda make: built.append(original(make)) or built[-1])
    (path,) = export(model_of(robot), tmp_path).files
    for model in (*built, mujoco.MjModel.from_xml_path(str(path))):
        for joint in robot.joints:
            compiled = model.joint(joint.name)
            assert bool(compiled.limited[0]) == (joint.name in limits)
            assert tuple(compiled.range) == limits.get(joint.name, (0.0, 0.0))
            if joint.spring is not None:
                assert compiled.qpos_spring[0] == joint.spring
                assert np.ravel(compiled.stiffness)[0] == 3.0
    assert built
    assert any(joint.spring for joint in robot.joints)


@pytest.mark.slow
def test_home_is_closed_and_stays_so(tmp_path: Path) -> None:
    result = model_of(load_robot("orthoglide"), terms=False)
    (path,) = export(result, tmp_path).files
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    for _ in range(200):
        mujoco.mj_step(model, data)
    assert np.abs(data.efc_pos[: data.ne]).max() < 1e-4
    assert load_robot(path).actuated == result.robot.actuated


def test_friction_that_a_coupled_joint_shares_with_its_motor_is_exported_once() -> None:
    result = preslid(model_of(GEARED))
    values = consistent_model(result, "mjcf").values
    shared = result.base.matrix @ [values[name] for name in result.idm.parameter_names]
    exported = dict(zip(result.base.standard, shared, strict=True))
    for name in ("fv_1", "fs_1"):
        assert exported[name] == pytest.approx(result.friction_parameters[name].value, rel=1e-3)


def test_a_joint_coupled_to_two_is_refused(tmp_path: Path) -> None:
    with pytest.raises(GtauError, match=r"joint 'motor_6' is coupled to 2 joints.*; export to urdf or c instead"):
        export(model_of(load_robot("staubli-tx40"), terms=False), tmp_path)


def test_what_mujoco_cannot_express_is_listed(tmp_path: Path) -> None:
    robot = load_robot("five-bar")
    exported = export(model_of(robot), tmp_path)
    notes = " ".join(exported.notes)
    assert "fl_left (proportional to the load)" in notes
    assert "off_left_forearm" in notes or "off_" in notes
    assert "f3_left" not in notes
    assert 0 < max(exported.figures.values()) < 50
    assert max(export(model_of(robot, terms=False), tmp_path).figures.values()) < max(exported.figures.values())


def test_a_model_without_consistent_parameters_is_refused(tmp_path: Path) -> None:
    with pytest.raises(GtauError, match=r"an export to MJCF needs .*; identify it with --consistent"):
        export(model_of(load_robot("five-bar"), consistent=False), tmp_path)


def test_an_actuator_that_is_a_spring_is_said(tmp_path: Path) -> None:
    """Of a gas spring; the coil is a tendon."""
    exported = export(model_of(sprung(), terms=False), tmp_path)
    assert "no tendon has the force of gas: an actuator without gain does, whose ctrl has no effect" in exported.notes
    model = mujoco.MjModel.from_xml_path(str(exported.files[0]))
    stiffness = [float(np.ravel(model.tendon_stiffness[model.tendon(name).id])[0]) for name in ("coil", "gas")]
    assert stiffness == [3.0, 0.0]
    assert [spring.name for spring in load_robot(exported.files[0]).springs] == ["coil", "gas"]
