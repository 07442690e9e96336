"""The wrench at a frame from the torques of the joints, beside Jacobians of Pinocchio and the power of a platform."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import polars as pl
import pytest
from engines import Pinocchio
from models_to_export import model_of
from robots_for_tests import home, seven_r, trajectory
from typer.testing import CliRunner

import gtau
from gtau.cli.commands import app
from gtau.estimation.results.estimate import Estimate, TorqueError
from gtau.model.home import load_robot
from gtau.robots.parameter import Parameter
from gtau.robots.placement import WRENCH
from gtau.robots.readers.read import frame_on
from gtau.robots.robot import Robot
from gtau.simulation.closed_loop import write_log
from gtau.uses.external_torques import USABLE, torques_along_log

SCREW = np.array([1.0, -2.0, 0.5, 10.0, 20.0, -15.0])  # moment, force
FRAME = "0.05 -0.1 0.2 0.3 -0.4 0.5"


def known(robot: Robot, rms: float | np.ndarray, signal: float = 1e3) -> gtau.Result:
    """A model whose gains are known, with residuals of this rms along torques of the rms ``signal``, N m or N."""
    result, each = model_of(robot, terms=False), np.broadcast_to(rms, len(robot.actuated))
    residuals = tuple(
        TorqueError(joint, float(r), signal, "N m") for joint, r in zip(robot.actuated, each, strict=True)
    )
    return result.replaced(residuals=residuals, covariance=1e-14 * result.covariance)


def pressed(result: gtau.Result, wrench: np.ndarray, noise: float = 0.0, path: tuple | None = None) -> gtau.Run:
    """A run along which a wrench acts at FRAME, whose Jacobian is Pinocchio's, with white noise of the torques."""
    robot = result.robot
    time = np.arange(3000 if path is None else len(path[0])) * 2e-3
    q, qd, qdd = trajectory(robot, time) if path is None else path
    engine = Pinocchio(robot, {})
    joint = engine.model.getJointId(robot.tool)
    _, at = frame_on(robot.tool, FRAME, None)
    place = pin.SE3(at.rotation, at.position)
    frame = engine.model.addFrame(pin.Frame("contact", joint, 0, place, pin.FrameType.OP_FRAME))
    data, external = engine.model.createData(), np.empty_like(q)
    for k, each in enumerate(q):
        y = np.zeros(engine.model.nq)
        y[engine.joint_q] = each
        J = pin.computeFrameJacobian(engine.model, data, y, frame, pin.ReferenceFrame.LOCAL)[:, engine.joint_v]
        external[k] = J[3:].T @ wrench[:3] + J[:3].T @ wrench[3:]
    torque = result.torques(q, qd, qdd) - external
    torque += noise * np.random.default_rng(1).normal(size=torque.shape)
    return gtau.Run("pressed", robot.actuated, time, q, torque / result.gains)


@pytest.mark.parametrize("robot", [load_robot("ur10e"), seven_r()], ids=str)
def test_six_and_seven_motors_give_the_wrench_within_its_intervals(robot: Robot) -> None:
    at = frame_on(robot.tool, FRAME, None)
    exact = torques_along_log(known(robot, 0.1), pressed(known(robot, 0.1), SCREW), at).wrench
    usable = exact.usable & exact.seen.all(axis=1)
    assert usable.mean() > 0.2
    error = np.abs(exact.wrench[usable] - SCREW)
    assert np.median(error) < 0.01
    assert (error < 0.2 + exact.interval[usable]).mean() > 0.98

    free = pressed(known(robot, 0.1), 0 * SCREW, noise=1.0)
    alone = torques_along_log(known(robot, 0.1), free)
    rms = float(np.mean([each.rms for each in alone.joints]))  # of the noise behind the low-pass
    found = torques_along_log(known(robot, rms), pressed(known(robot, rms), SCREW, noise=1.0), at).wrench
    inside = np.abs(found.wrench - SCREW) < found.interval
    assert 0.91 < inside[found.seen & found.usable[:, None]].mean() < 0.98
    force = found.components[WRENCH.index("force_y")]
    assert force.rms == pytest.approx(20.0, rel=0.2)
    assert force.unit == "N"
    still = torques_along_log(known(robot, rms), free, at).wrench
    assert max(each.share for each in still.components) < 0.01  # beyond 4 standard deviations
    assert USABLE == 4.0


def swing(middle: tuple[float, ...]) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Time (N,) and a motion of a UR10e about a posture, q, qd, qdd (N, 6)."""
    time, way = np.arange(0, 4, 8e-3), np.array([0.5, 0.4, 0.4, 0.3, 0.3, 0.5])
    sine, cosine = np.outer(np.sin(2 * time), way), np.outer(np.cos(2 * time), way)
    return time, (np.array(middle) + sine, 2 * cosine, -4 * sine)


def test_a_body_that_the_model_does_not_know_is_the_force_within_its_intervals() -> None:
    """Friction depends on the load: on that of the body too. Its weight and inertia are those of Pinocchio's frame."""
    robot, mass, place = load_robot("ur10e"), 2.8, np.array([0.02, 0.05, 0.1])
    free = known(robot, 0.3)
    friction = {Parameter("fl", joint): Estimate(f"fl_{joint}", 0.07, 0.002, "1") for joint in robot.actuated}
    x, y, z = place
    body = {"m": mass, "mx": mass * x, "my": mass * y, "mz": mass * z, "xx": mass * (y * y + z * z),
            "yy": mass * (x * x + z * z), "zz": mass * (x * x + y * y), "xy": -mass * x * y, "xz": -mass * x * z,
            "yz": -mass * y * z}  # fmt: skip
    standard = free.consistency.standard
    heavier = dict(standard) | {f"{k}_{robot.tool}": standard[f"{k}_{robot.tool}"] + v for k, v in body.items()}
    loaded = model_of(robot, terms=False, chi=heavier).replaced(friction=friction)
    free = free.replaced(friction=friction)
    engine = Pinocchio(robot, {})
    data, joint = engine.model.createData(), engine.model.getJointId(robot.tool)
    inside, halves = [], []
    for middle in (
        (0.3, -1.2, 1.5, -0.6, 1.2, 0.2),
        (-0.8, -0.7, 0.9, -1.4, -1.3, 1.0),
        (1.0, -1.9, -1.6, 0.5, 1.6, 0.0),
    ):
        time, (q, qd, qdd) = swing(middle)
        at, turned = np.empty((len(q), 3)), np.empty((len(q), 3, 3))
        for k, each in enumerate(q):
            posture = np.zeros(engine.model.nq)
            posture[engine.joint_q] = each
            pin.forwardKinematics(engine.model, data, posture)
            turned[k], at[k] = data.oMi[joint].rotation, data.oMi[joint].act(place)
        pull = mass * (engine.model.gravity.linear - np.gradient(np.gradient(at, time, axis=0), time, axis=0))
        force = np.einsum("kji,kj->ki", turned, pull)
        torque = loaded.torques(q, qd, qdd) + np.random.default_rng(3).normal(size=q.shape)
        run = gtau.Run("held", robot.actuated, time, q, torque / free.gains)
        found = torques_along_log(free, run, frame_on(robot.tool, "", None)).wrench
        kept = found.seen[:, 3:] & found.usable[:, None]
        inside.append((np.abs(found.wrench[:, 3:] - force) < found.interval[:, 3:])[kept])
        halves.append(found.interval[:, 3:][kept])
        assert kept.sum() > 150
    assert np.mean(np.concatenate(inside)) > 0.9
    assert np.median(np.concatenate(halves)) < 6.0  # N


def test_intervals_grow_with_the_load() -> None:
    """A model that errs by a tenth of the torques of its logs errs by a tenth of what comes on top."""
    robot = load_robot("ur10e")
    result, at, (_, path) = (
        known(robot, 1.0, signal=10.0),
        frame_on(robot.tool, FRAME, None),
        swing((0.3, -1.2, 1.5, -0.6, 1.2, 0.2)),
    )
    light, heavy = (
        torques_along_log(result, pressed(result, w, path=path), at).wrench for w in (0 * SCREW, 20 * SCREW)
    )
    kept = light.seen & light.usable[:, None]
    assert np.median(heavy.interval[kept] / light.interval[kept]) > 1.5


@pytest.mark.parametrize("rms", [0.1, np.array([2.0, 2.0, 1.0, 0.1, 0.1, 0.05])], ids=["alike", "precise wrists"])
def test_a_straight_wrist_has_no_value(rms: float | np.ndarray) -> None:
    """Through q5 = 0 the force and moment along one direction are lost: no value, while others stay exact."""
    robot = load_robot("ur10e")
    result = known(robot, rms)
    time = np.arange(0, 4, 2e-3)
    way = np.array([0.3, 0.15, 0.2, 0.1, 0.3, 0.3])
    q = np.array([0.3, -1.2, 1.5, -0.6, 0.0, 0.2]) + np.outer(np.sin(2 * time), way)
    run = pressed(result, SCREW, path=(q, np.outer(2 * np.cos(2 * time), way), np.outer(-4 * np.sin(2 * time), way)))
    at = frame_on(robot.tool, FRAME, None)
    along = torques_along_log(result, run, at)
    found = along.wrench
    straight = np.abs(q[:, 4]) < 0.01
    assert (found.directions[straight] == 5).all()
    assert (found.directions[np.abs(q[:, 4]) > 0.05] == 6).all()
    lost = ~found.seen
    assert lost[straight].any(axis=1).all()
    assert np.isnan(found.wrench[lost]).all()
    assert np.isnan(found.interval[lost]).all()
    kept = found.seen & found.usable[:, None]
    assert (np.abs(found.wrench - SCREW)[kept] < 0.1 + found.interval[kept]).all()
    assert along.table.filter(~pl.col("moment_x_seen"))["moment_x"].is_null().all()


def test_three_motors_of_a_parallel_robot_see_forces_and_no_moment() -> None:
    robot = load_robot("orthoglide")
    result = known(robot, 0.5)
    time = np.arange(0, 3, 2e-3)
    q, qd, qdd = trajectory(robot, time)
    at = result.idm.layout.platforms[0].position
    force, step = np.array([5.0, -8.0, 12.0]), 1e-5
    slopes = [result.idm.path((q + step * e).T)[at] - result.idm.path((q - step * e).T)[at] for e in np.eye(3)]
    external = np.einsum("kxi,x->ik", np.array(slopes) / (2 * step), force)  # tau dq = F dx
    run = gtau.Run("pushed", robot.actuated, time, q, (result.torques(q, qd, qdd) - external) / result.gains)
    found = torques_along_log(result, run, frame_on(robot.tool, "", None)).wrench
    assert not found.seen[:, :3].any()
    assert found.seen[:, 3:].all()
    assert (found.directions == 3).all()
    np.testing.assert_allclose(found.wrench[found.usable, 3:], np.tile(force, (found.usable.sum(), 1)), atol=0.05)


def test_two_motors_see_a_force_where_there_is_no_moment() -> None:
    """A planar arm feels the moment about its axes too; only where it is known to be none are forces seen."""
    robot = load_robot("five-bar")
    result = known(robot, 0.1)
    time = np.arange(0, 3, 2e-3)
    q, qd, qdd = trajectory(robot, time)
    run = gtau.Run("free", robot.actuated, time, q, result.torques(q, qd, qdd) / result.gains)
    at = frame_on(robot.tool, "0.3 0 0 0 0 0", None)
    plain = torques_along_log(result, run, at).wrench
    assert (plain.directions == 2).all()
    assert not plain.seen.any()
    point = torques_along_log(result, run, at, force_only=True).wrench
    assert point.seen[:, 3:5].all()
    assert not point.seen[:, [0, 1, 2, 5]].any()
    assert np.abs(home(robot)).any()


def test_the_command_writes_wrench_and_observer(tmp_path: Path) -> None:
    result = known(load_robot("ur10e"), 0.1)
    result.save(tmp_path / "model.json")
    write_log(pressed(result, SCREW), tmp_path / "log.csv")
    command = ["use", str(tmp_path / "model.json"), str(tmp_path / "log.csv"), "--frame", FRAME]
    out = tmp_path / "all.csv"
    done = CliRunner().invoke(app, [*command, "--observer", "10", "--out", str(out)])
    assert not done.exit_code, done.output
    assert "External wrench" in done.output
    assert "half the 95 % interval" in done.output
    table = pl.read_csv(out)
    assert {"force_x", "force_x_interval", "force_x_seen", "wrench_directions", "observed_wrist_3_joint"} <= set(
        table.columns
    )
    document = json.loads(CliRunner().invoke(app, [*command, "--json"]).stdout)
    assert [each["name"] for each in document["wrench"]["components"]] == list(WRENCH)
    for wrong, sentence in (
        (["--frame", "tool0"], "only a URDF has"),
        (["--force-only"], "name it by --frame LINK"),
        (["--observer", "-1"], "write a positive number"),
    ):
        refused = CliRunner().invoke(app, [*command[:3], *wrong])
        assert refused.exit_code == 2
        assert sentence in " ".join(refused.stderr.split())


def test_a_joint_without_residual_has_no_interval() -> None:
    result = known(load_robot("five-bar"), 0.1).replaced(residuals=())
    time = np.arange(0, 3, 2e-3)
    q, qd, qdd = trajectory(result.robot, time)
    run = gtau.Run("free", result.robot.actuated, time, q, result.torques(q, qd, qdd) / result.gains)
    with pytest.raises(gtau.GtauError, match="no residual of joint 'left'"):
        torques_along_log(result, run, frame_on(result.robot.tool, "", None))
