"""Exported URDF, loaded by Pinocchio and by gtau: torques and loops beside the model's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
import yaml
from models_to_export import model_of, sprung
from robots_for_tests import CLOSED, SERIAL
from scipy.spatial.transform import Rotation

from gtau.errors import GtauError
from gtau.export.urdf import export
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.singularities import random_motion
from gtau.robots.robot import ROTATIONS, TRANSLATIONS, Robot

QUICK = ("sprung", "seven-r", "tree", "slider-crank", "five-bar")


def rotation_columns(angles: np.ndarray) -> np.ndarray:
    """Angular velocity in base axes for unit rates of angles about x, then the y and z turned with it, (3, 3)."""
    x, y = (Rotation.from_euler(axis, angle).as_matrix() for axis, angle in zip("xy", angles[:2], strict=True))
    return np.column_stack([np.eye(3)[0], x[:, 1], (x @ y)[:, 2]])


def spring_torques(model: pin.Model, data: pin.Data, q: np.ndarray, v: np.ndarray, springs: dict) -> np.ndarray:
    """Torques against the springs between two points, by Pinocchio's Jacobians of the links that they name."""
    tau = np.zeros(model.nv)
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    for spring in springs.values():
        ends = []
        for end in spring["between"]:
            frame, xyz = model.getFrameId(end["link"]), np.array(end["xyz"])
            J = pin.getFrameJacobian(model, data, frame, pin.ReferenceFrame.LOCAL)
            at = data.oMf[frame]
            ends.append((at.translation + at.rotation @ xyz, at.rotation @ (J[:3] - pin.skew(xyz) @ J[3:])))
        (p_a, J_a), (p_b, J_b) = ends
        length = np.linalg.norm(p_b - p_a)
        rate = (p_b - p_a) / length @ (J_b - J_a)  # (nv,)
        preload, stiffness, damping = (
            spring.get(key, {"value": 0.0})["value"] for key in ("preload", "stiffness", "damping")
        )
        tau += (stiffness * length + damping * (rate @ v) - preload) * rate
    return tau


@pytest.mark.parametrize(
    "robot",
    [
        pytest.param(robot, marks=() if robot.name in QUICK else pytest.mark.slow, id=robot.name)
        for robot in (*SERIAL, *CLOSED, sprung())
    ],
)
def test_pinocchio_moves_with_the_torques_of_the_model(robot: Robot, tmp_path: Path, rng: np.random.Generator) -> None:
    result = model_of(robot, terms=False)
    exported = export(result, tmp_path)
    idm, standard = result.idm, result.consistency.standard
    model = pin.buildModelFromUrdf(str(exported.files[0]))
    model.gravity.linear = np.array([0.0, 0.0, -np.linalg.norm(robot.gravity)])
    data = model.createData()
    beside = yaml.safe_load(exported.files[1].read_text())
    drives = beside["joints"]
    motion = random_motion(idm, 10, rng)
    tau = idm.full.torques_along(idm.layout, motion, np.array([standard[name] for name in idm.parameter_names]))
    for k in range(10):
        # numbers by joint of the file: joints as they are, and a chain of joints for each platform
        q = dict(zip((joint.name for joint in robot.joints), motion.c[:, k], strict=False))
        T = {joint.name: np.eye(idm.layout.n_y)[row] for row, joint in enumerate(robot.joints)}
        drift = dict.fromkeys(q, 0.0)
        v = motion.yd[:, k]
        for slots in idm.layout.platforms:
            platform, rows = slots.platform, np.eye(idm.layout.n_y)[slots.rates]
            shift = motion.c[slots.position, k] - platform.home.position
            angles = np.zeros(3)
            if slots.quaternion is not None:
                now = Rotation.from_quat(motion.c[slots.quaternion, k], scalar_first=True).as_matrix()
                angles = Rotation.from_matrix(now @ platform.home.rotation.T).as_euler("XYZ")
            turning = [dof for dof in platform.dof if dof in ROTATIONS]
            E = rotation_columns(angles)
            if len(turning) == 3:
                inverse = np.linalg.inv(E)
                rates = inverse @ (rows @ v)[-3:]
                step = 1e-6
                change = (rotation_columns(angles + step * rates) - rotation_columns(angles - step * rates)) / (
                    2 * step
                )
            for number, dof in enumerate(platform.dof):
                name = f"{dof}_{platform.name}"
                drift[name] = 0.0
                if dof in TRANSLATIONS:
                    q[name], T[name] = shift[TRANSLATIONS.index(dof)], rows[number]
                elif len(turning) == 3:
                    q[name], T[name] = angles[ROTATIONS.index(dof)], inverse[ROTATIONS.index(dof)] @ rows[-3:]
                    drift[name] = -float(inverse[ROTATIONS.index(dof)] @ change @ rates)
                else:
                    q[name], T[name] = angles[ROTATIONS.index(dof)], rows[number]
        configuration, map_ = pin.neutral(model), np.zeros((model.nv, idm.layout.n_y))
        a0, passive = np.zeros(model.nv), np.zeros(idm.layout.n_y)
        for name in model.names[1:]:
            at = model.joints[model.getJointId(name)]
            value = q[name]
            # a joint without limits is a point of the unit circle in Pinocchio
            configuration[at.idx_q : at.idx_q + at.nq] = value if at.nq == 1 else (np.cos(value), np.sin(value))
            map_[at.idx_v], a0[at.idx_v] = T[name], drift[name]
        acceleration = map_ @ motion.ydd[:, k] + a0
        effort = map_.T @ pin.rnea(model, data, configuration, map_ @ v, acceleration)
        for row, joint in enumerate(robot.joints):
            at = model.joints[model.getJointId(joint.name)].idx_v
            drive = drives.get(joint.name, {})
            passive[row] = model.damping[at] * v[row]
            passive[row] += np.abs(model.upperDryFrictionLimit[at]) * np.sign(v[row])
            passive[row] += drive.get("armature", {"value": 0.0})["value"] * motion.ydd[row, k]
            passive[row] += drive.get("offset", {"value": 0.0})["value"]
            if "stiffness" in drive:
                passive[row] += drive["stiffness"]["value"] * (motion.c[row, k] - drive["springref"]["value"])
        effort += map_.T @ spring_torques(model, data, configuration, map_ @ v, beside.get("springs", {}))
        found = motion.J[:, :, k].T @ (effort + passive)
        np.testing.assert_allclose(found, tau[:, k], atol=1e-8 * np.abs(tau).max())


@pytest.mark.parametrize("name", ["ur10e", "five-bar", "orthoglide"])
def test_gtau_reads_the_robot_back(name: str, tmp_path: Path) -> None:
    robot = load_robot(name)
    exported = export(model_of(robot, terms=False), tmp_path)
    again = load_robot(exported.files[0])
    assert again.actuated == robot.actuated
    assert len(again.closures) == len(robot.closures)
    for joint in robot.joints:
        assert again.joint(joint.name).limits == replace(joint.limits, acceleration=None)
    for limit in ElementTree.parse(exported.files[0]).iter("limit"):  # of simulators, in which 0 holds a joint
        assert min(float(limit.get("velocity")), float(limit.get("effort"))) > 0
    if name != "orthoglide":
        idm, other = InverseDynamics(robot), InverseDynamics(again)
        q = np.array([[joint.home for joint in robot.joints if joint.actuated]]) + 0.05
        names = [each for each in idm.parameter_names if each in other.parameter_names]
        chi = {each: 0.1 + 0.01 * k for k, each in enumerate(names)}
        np.testing.assert_allclose(idm.torques(q, q, q, chi), other.torques(q, q, q, chi), rtol=1e-8)


def test_what_a_urdf_cannot_express_is_listed(tmp_path: Path) -> None:
    notes = " ".join(export(model_of(load_robot("five-bar")), tmp_path).notes)
    assert "fl_left (proportional to the load)" in notes
    assert "five_bar_drives.yaml" in notes


def test_what_a_urdf_cannot_be_is_refused(tmp_path: Path) -> None:
    with pytest.raises(GtauError, match="identify it with --consistent"):
        export(model_of(load_robot("five-bar"), consistent=False), tmp_path)
    with pytest.raises(GtauError, match=r"'motor_6' is coupled to 2 joints.* mimics one; export to c instead"):
        export(model_of(load_robot("staubli-tx40"), terms=False), tmp_path)
