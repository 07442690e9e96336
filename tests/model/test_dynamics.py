"""Torques and regressors against two outside engines, and against identities of mechanics."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import polars as pl
import pytest
from engines import Mujoco, Pinocchio, closed_torques, random_parameters, tree_torques
from numpy.testing import assert_allclose
from robots_for_tests import ROBOTS, SERIAL, random_samples, seven_r, trajectory
from scipy.spatial.transform import Rotation

from gtau.errors import GtauError
from gtau.model.base_parameters import BaseParameters, base_parameters, symmetric_order
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.singularities import random_motion
from gtau.robots.robot import DRIVE, INERTIAL, Coupling, Robot

every_robot = pytest.mark.parametrize("robot", ROBOTS, ids=lambda robot: robot.name)


@cache
def model(robot: Robot, parameters: str = "all") -> InverseDynamics:
    return InverseDynamics(robot, parameters)


@cache
def base_of(robot: Robot, parameters: str = "all") -> BaseParameters:
    return base_parameters(model(robot, parameters))


def assert_close(found, expected, share=1e-9):
    """Within a share of the largest torque of the same joint."""
    assert found.shape == expected.shape
    assert (np.abs(found - expected) <= share * np.abs(expected).max(axis=0)).all()


def frictionless(chi):
    return {name: 0.0 if name.split("_")[0] in ("fv", "fs", "off") else value for name, value in chi.items()}


@every_robot
@pytest.mark.parametrize("engine", [Pinocchio, Mujoco])
def test_torques_at_random_states(robot, engine, rng):
    chi = random_parameters(robot, rng)
    q, qd, qdd = random_samples(robot, rng, 8)
    assert_close(model(robot).torques(q, qd, qdd, chi), closed_torques(robot, chi, q, qd, qdd, engine))


@every_robot
@pytest.mark.parametrize("engine", [Pinocchio, Mujoco])
def test_torques_along_a_trajectory(robot, engine, rng):
    """Every 40th of 400 samples: the engines reach each from home, the model each from the one before."""
    chi = random_parameters(robot, rng)
    q, qd, qdd = trajectory(robot, np.arange(400) * 0.02)
    tau = model(robot).torques(q, qd, qdd, chi)
    assert_close(tau[::40], closed_torques(robot, chi, q[::40], qd[::40], qdd[::40], engine))


@every_robot
def test_regressor_times_parameters_is_torque(robot, rng):
    idm, chi = model(robot), random_parameters(robot, rng)
    q, qd, qdd = random_samples(robot, rng, 70)
    W = idm.regressor(q, qd, qdd)
    assert W.shape == (70, len(idm.actuated), len(idm.parameter_names))
    vector = np.array([chi[name] for name in idm.parameter_names])
    tau = idm.torques(q, qd, qdd, chi)
    assert_close(W @ vector, tau, 1e-13)
    assert np.array_equal(idm.torques(q, qd, qdd, vector), tau)


@every_robot
def test_inertial_model_is_the_full_one_without_drives(robot, rng):
    chi = random_parameters(robot, rng)
    inertial = {name: value for name, value in chi.items() if name.split("_")[0] in INERTIAL}
    samples = random_samples(robot, rng, 5)
    idm = model(robot, "inertial")
    assert set(idm.parameter_names) == set(inertial)
    assert_close(idm.torques(*samples, inertial), model(robot).torques(*samples, inertial), 1e-13)


@every_robot
def test_pruned_columns_are_columns_of_the_regressor(robot, rng):
    idm = model(robot)
    samples = random_samples(robot, rng, 5)
    names = tuple(rng.permutation(idm.parameter_names)[:9])
    pruned = idm.columns(names)
    found = np.zeros((5, len(idm.actuated), 9))
    found[:, pruned.rows, pruned.columns] = pruned(idm.layout, idm.motion(*(each.T for each in samples))).T
    expected = idm.regressor(*samples)[:, :, [idm.parameter_names.index(name) for name in names]]
    assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


def tree_state(robot: Robot, tree: Pinocchio, motion):
    """Configuration, velocity and acceleration of Pinocchio's tree in the states of a motion, (N, .) each."""
    layout, samples, n_t = InverseDynamics(robot).layout, motion.c.shape[1], len(robot.joints)
    q, v, vd = np.tile(tree.neutral(), (samples, 1)), np.zeros((samples, tree.nv)), np.zeros((samples, tree.nv))
    q[:, tree.joint_q], v[:, tree.joint_v], vd[:, tree.joint_v] = (
        motion.c[:n_t].T,
        motion.yd[:n_t].T,
        motion.ydd[:n_t].T,
    )
    at_q, at_v = n_t, n_t  # the platforms' chains follow the joints
    for slots in layout.platforms:
        platform, rates = slots.platform, slice(at_v, at_v + len(slots.platform.dof))
        v[:, rates], vd[:, rates] = motion.yd[slots.rates].T, motion.ydd[slots.rates].T
        moved = motion.c[slots.position].T - platform.home.position
        slides = ["xyz".index(name) for name in platform.dof if name in "xyz"]
        q[:, at_q : at_q + len(slides)] = moved[:, slides]
        at_q, at_v = at_q + len(slides), at_v + len(slides)
        if slots.quaternion is not None:
            turned = Rotation.from_quat(motion.c[slots.quaternion].T, scalar_first=True)
            turned = turned * Rotation.from_matrix(platform.home.rotation).inv()
            if len(platform.dof) - len(slides) == 3:
                q[:, at_q : at_q + 4] = turned.as_quat()
                for rate in (v, vd):
                    rate[:, at_v : at_v + 3] = turned.inv().apply(rate[:, at_v : at_v + 3])
                at_q, at_v = at_q + 4, at_v + 3
            else:
                q[:, at_q] = turned.as_rotvec()[:, ["rx", "ry", "rz"].index(platform.dof[-1])]
                at_q, at_v = at_q + 1, at_v + 1
    return q, v, vd


@every_robot
def test_virtual_power(robot, rng):
    """The actuated torques have the power of all bodies' inertia and of all joints' drives (eq. 14)."""
    chi = random_parameters(robot, rng)
    q, qd, qdd = random_samples(robot, rng, 10)
    motion = model(robot).motion(q.T, qd.T, qdd.T)
    tree = Pinocchio(robot, chi)
    states = list(zip(*tree_state(robot, tree, motion), strict=True))
    power = np.array([tree.torques(*state) @ state[1] for state in states])
    for k, joint in enumerate(robot.joints):
        ia, fv, fs, off = (chi[f"{kind}_{joint.name}"] for kind in DRIVE)
        rate, acceleration = motion.yd[k], motion.ydd[k]
        power += (ia * acceleration + fv * rate + off) * rate + fs * np.abs(rate)
    tau = model(robot).torques(q, qd, qdd, chi)
    assert_allclose(np.sum(tau * qd, axis=1), power, rtol=1e-9, atol=1e-9 * np.abs(tau * qd).max())


@every_robot
def test_energy_balance(robot, rng):
    """Without friction and rotors, kinetic and potential energy grow by the power of the torques."""
    chi = frictionless(random_parameters(robot, rng)) | {f"ia_{joint.name}": 0.0 for joint in robot.joints}
    h, stencil = 1e-3, np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12
    times = (np.linspace(0.3, 4.0, 6)[:, None] + h * np.arange(-2, 3)).ravel()
    q, qd, qdd = trajectory(robot, times)
    idm, tree = model(robot), Pinocchio(robot, chi)
    motion = idm.motion(q.T, qd.T, qdd.T)
    energy = []
    for position, velocity, _ in zip(*tree_state(robot, tree, motion), strict=True):
        kinetic = pin.computeKineticEnergy(tree.model, tree.data, position, velocity)
        energy.append(kinetic + pin.computePotentialEnergy(tree.model, tree.data, position))
    rate = np.reshape(energy, (-1, 5)) @ stencil / h
    power = np.sum(idm.torques(q, qd, qdd, chi) * qd, axis=1)[2::5]
    assert_allclose(rate, power, rtol=1e-7, atol=1e-7 * np.abs(power).max())


@every_robot
def test_inertia_matrix_is_symmetric_and_positive(robot, rng):
    """Torques of unit accelerations at rest, less those of rest, are the columns of a mass matrix."""
    chi = frictionless(random_parameters(robot, rng))
    n = len(robot.actuated)
    q = np.tile(random_samples(robot, rng, 1)[0], (n + 1, 1))
    qdd = np.vstack([np.zeros(n), np.eye(n)])
    tau = model(robot).torques(q, 0 * q, qdd, chi)
    inertia = tau[1:] - tau[0]
    assert_allclose(inertia, inertia.T, atol=1e-12 * np.abs(tau).max())
    assert np.linalg.eigvalsh(inertia).min() > 0


@pytest.mark.parametrize("robot", SERIAL, ids=lambda robot: robot.name)
def test_gravity_alone_acts_at_rest(robot, rng):
    """In free fall of the base nothing needs a torque, and tilting gravity tilts the torques linearly."""
    chi = frictionless(random_parameters(robot, rng))
    q = random_samples(robot, rng, 5)[0]

    def at_rest(gravity):
        return InverseDynamics(replace(robot, gravity=gravity)).torques(q, 0 * q, 0 * q, chi)

    assert not at_rest((0.0, 0.0, 0.0)).any()
    parts = [at_rest(tuple(row)) for row in np.eye(3)]
    assert_allclose(at_rest((1.2, -3.4, -8.9)), 1.2 * parts[0] - 3.4 * parts[1] - 8.9 * parts[2], atol=1e-12)


def test_coupled_joints(rng):
    """A passive joint that follows two others adds its torque to theirs by the ratios."""
    arm = seven_r()
    joints = tuple(replace(joint, actuated=joint.name != "4", home=0.1) for joint in arm.joints)
    ratios = (("2", -0.7), ("6", 1.6))
    robot = replace(arm, joints=joints, couplings=(Coupling("4", ratios, 0.2),))
    chi = random_parameters(robot, rng)
    q, qd, qdd = rng.normal(size=(3, 20, 6))
    J = np.zeros((7, 6))
    J[[0, 1, 2, 4, 5, 6], range(6)] = 1.0
    J[3, 1], J[3, 4] = -0.7, 1.6
    offset = 0.2 * np.eye(7)[3]
    expected = tree_torques(arm, chi, q @ J.T + offset, qd @ J.T, qdd @ J.T) @ J
    assert_close(InverseDynamics(robot).torques(q, qd, qdd, chi), expected)


@pytest.mark.parametrize("robot", [each for each in ROBOTS if each.name != "hexapod"], ids=lambda robot: robot.name)
def test_base_parameters_give_the_torques(robot, rng):
    idm, base = model(robot), base_of(robot)
    chi = random_parameters(robot, rng)
    samples = random_samples(robot, rng, 20)
    columns = [idm.parameter_names.index(name) for name in base.standard]
    vector = np.array([chi[name] for name in idm.parameter_names])
    W = idm.regressor(*samples)
    assert_close(W[:, :, columns] @ (base.matrix @ vector), idm.torques(*samples, chi), 1e-9)
    idle = [idm.parameter_names.index(name) for name in base.without_effect]
    assert np.abs(W[:, :, idle]).max(initial=0.0) <= 1e-12 * np.abs(W).max()


@pytest.mark.parametrize("name", ["five-bar", "ur10e"])
def test_regroupings_do_not_depend_on_the_random_states(name):
    robot = load_robot(name)
    assert base_parameters(model(robot), seed=1).regroupings == base_of(robot).regroupings


def test_regroupings_of_the_orthoglide():
    """Number for number those of the paper's list after Fig. 4, as corrected."""
    base = base_of(load_robot("orthoglide"))
    expected = {
        "m_PR": "m_P + 3.2258 mx_31 + m_41 + m_51 + 3.2258 mx_32 + m_42 + m_52 + 3.2258 mx_33 + m_43 + m_53",
        "m_11R": "m_11 + ia_11 + m_21 - 3.2258 mx_31 + m_31",
        "m_12R": "m_12 + ia_12 + m_22 - 3.2258 mx_32 + m_32",
        "m_13R": "m_13 - 0.10197 off_13 + m_23 - 3.2258 mx_33 + m_33",
        "ia_13R": "ia_13 + 0.10197 off_13",
        "xz_33R": "xz_33 - 0.31 mz_43",
        "zz_33R": "zz_33 - 0.31 mx_33 + ia_33 + ia_43",
        "fv_31R": "fv_31 + fv_41",
        "off_22R": "off_22 - off_52",
    }
    assert {name: base.regroupings[name] for name in expected} == expected
    assert len(base.without_effect) == 99
    own = [name for name, standard in zip(base.names, base.standard, strict=True) if name == standard]
    assert {"mx_41", "mx_42", "mx_43", "off_11", "off_12", "fv_13"} <= set(own)


def test_symmetric_order_runs_over_like_legs():
    """Eq. (23): the platform first, then each parameter over the same joint of all legs."""
    idm = model(load_robot("orthoglide"))
    order = symmetric_order(idm.robot, idm.parameter_names)
    assert sorted(order) == sorted(idm.parameter_names)
    assert order[:10] == [f"{kind}_P" for kind in INERTIAL]
    triples = [order[k : k + 3] for k in range(10, len(order), 3)]
    for triple in triples:
        assert [name[:-1] for name in triple] == [triple[0][:-1]] * 3
        assert [name[-1] for name in triple] == ["1", "2", "3"]
    joints = [triple[0].split("_")[1] for triple in triples]
    assert joints == sorted(joints)  # from the motor to the platform


def test_samples_of_other_shapes_are_refused():
    idm = model(load_robot("orthoglide"))
    with pytest.raises(GtauError, match=r"\(N, 3\)"):
        idm.regressor(np.zeros(4), np.zeros(4), np.zeros(4))
    with pytest.raises(GtauError, match=r"\(N, 3\)"):
        idm.regressor(np.zeros((2, 3)), np.zeros((2, 3)), np.zeros((3, 3)))
    with pytest.raises(GtauError, match="220 entries"):
        idm.torques(*np.zeros((3, 1, 3)), np.zeros(7))
    with pytest.raises(GtauError, match="zz_99"):
        idm.torques(*np.zeros((3, 1, 3)), {"zz_99": 1.0})


def test_samples_that_are_no_numbers_or_of_other_joints():
    model = InverseDynamics(load_robot("five-bar"))
    table = pl.DataFrame({"right": [0.1, 0.2], "left": [0.3, 0.4]})
    np.testing.assert_array_equal(model.samples(table)[0], [[0.3, 0.4], [0.1, 0.2]])
    for wrong in ("abc", {"left": [0.1]}, table.rename({"left": "elbow"})):
        with pytest.raises(GtauError, match="no array of numbers, or a table without columns left, right"):
            model.samples(wrong)
    with pytest.raises(GtauError, match="a value of 'right' is not finite at sample 1"):
        model.samples(np.array([[0.0, 1.0], [0.0, np.inf]]))


def test_one_state_is_one_row_of_states():
    idm = model(load_robot("orthoglide"))
    q, qd, qdd = 0.01 * np.ones((3, 1, 3))
    chi = np.linspace(0.1, 1.0, len(idm.parameter_names))
    np.testing.assert_array_equal(idm.regressor(q[0], qd[0], qdd=qdd[0]), idm.regressor(q, qd, qdd)[0])
    np.testing.assert_array_equal(idm.torques(q[0], qd[0], qdd[0], chi), idm.torques(q, qd, qdd, chi)[0])


@every_robot
def test_no_samples(robot):
    idm = model(robot)
    n = len(idm.actuated)
    assert idm.regressor(*np.zeros((3, 0, n))).shape == (0, n, len(idm.parameter_names))


@pytest.mark.parametrize("name", ["ur10e", "five-bar", "orthoglide", "palletiser"])
def test_torques_of_gravity_are_those_of_a_robot_in_another_gravity(name: str, rng: np.random.Generator) -> None:
    robot = load_robot(name)
    own, change = model(robot), rng.normal(size=3)
    other = InverseDynamics(replace(robot, gravity=tuple(np.array(robot.gravity) + change)))
    motion, chi = random_motion(own, 20, rng), rng.normal(size=len(own.parameter_names))
    difference = np.subtract(*(each.full.torques_along(each.layout, motion, chi) for each in (other, own)))
    gravity = own.gravity_torques(own.parameter_names)
    found = gravity.torques(gravity(own.layout, motion, chi), change, len(own.actuated))
    np.testing.assert_allclose(found, difference, atol=1e-10 * np.abs(difference).max())
