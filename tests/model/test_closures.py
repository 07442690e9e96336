"""Loops closed numerically: residuals, derivatives, assembly modes, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from math import pi

import numpy as np
import pytest
from engines import Mujoco, closed_motion, random_parameters
from numpy.testing import assert_allclose
from robots_for_tests import (
    CLOSED,
    four_bar,
    hexapod,
    home,
    palletizer,
    random_samples,
    seven_r,
    slider_crank,
    trajectory,
    two_platforms,
)
from scipy.spatial.transform import Rotation

from gtau.errors import GtauError
from gtau.model.base_parameters import base_parameters
from gtau.model.home import close_home, load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.kinematics import Coordinates
from gtau.model.loop_closure import loop_errors
from gtau.model.loops import CONDITION, advance, displaced, follow
from gtau.model.singularities import random_motion
from gtau.robots.robot import Coupling, Limits, Pose, Robot

every_robot = pytest.mark.parametrize("robot", CLOSED, ids=lambda robot: robot.name)
winding = pytest.mark.parametrize("robot", [four_bar(), slider_crank(), two_platforms()], ids=lambda robot: robot.name)


@cache
def model(robot: Robot) -> InverseDynamics:
    return InverseDynamics(robot)


def motion_of(robot, q, qd, qdd):
    return model(robot).motion(q.T, qd.T, qdd.T)


def path_of(robot, q, **options):
    return follow(model(robot).loops, q.T, **options)


def refusal(action, *arguments, **options) -> str:
    with pytest.raises(GtauError) as refused:
        action(*arguments, **options)
    message = str(refused.value)
    assert message.endswith(".")
    assert "\n" not in message
    assert "nan" not in message
    return message


# ---- Where everything is ----------------------------------------------------------------------------------------


@every_robot
def test_loops_are_closed(robot):
    q, qd, qdd = trajectory(robot, np.linspace(0.0, 20.0, 700))
    motion = motion_of(robot, q, qd, qdd)
    loops = model(robot).loops
    assert np.array_equal(motion.c[loops.layout.actuated], q.T)
    assert loops.gap(motion.c).max() < 1e-12
    for c in motion.c.T[::100]:
        assert np.abs(loop_errors(loops.layout)(c)[0]).max() < 1e-12


@every_robot
def test_passive_joints_are_where_an_engine_has_them(robot, rng):
    q, qd, qdd = random_samples(robot, rng, 4)
    motion = motion_of(robot, q, qd, qdd)
    expected = closed_motion(robot, random_parameters(robot, rng), q, qd, qdd, Mujoco)
    joints = len(robot.joints)
    for found, theirs in zip((motion.c, motion.yd, motion.ydd), (expected.q, expected.qd, expected.qdd), strict=True):
        assert_allclose(found[:joints].T, theirs, rtol=1e-9, atol=1e-9)
    assert_allclose(motion.J[:joints].transpose(2, 0, 1), expected.J, rtol=1e-9, atol=1e-9)


@every_robot
def test_rates_are_derivatives(robot):
    """Velocities and accelerations are those of the positions, by a difference of fourth order."""
    h, stencil = 2e-3, np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12
    times = (np.linspace(0.4, 7.0, 9)[:, None] + h * np.arange(-2, 3)).ravel()
    motion = motion_of(robot, *trajectory(robot, times))
    layout, joints = model(robot).layout, len(robot.joints)

    def rate(values):
        return values.reshape(len(values), -1, 5) @ stencil / h

    def middle(values):
        return values[..., 2::5]

    def near(found, expected):
        assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())

    near(rate(motion.yd), middle(motion.ydd))
    near(rate(motion.c[:joints]), middle(motion.yd[:joints]))
    for slots in layout.platforms:
        v = dict(zip(slots.platform.dof, middle(motion.yd[slots.rates]), strict=True))
        moved = rate(motion.c[slots.position])
        assert_allclose(moved, [v.get(name, 0 * moved[0]) for name in "xyz"], atol=1e-6 * np.abs(motion.yd).max())
        if slots.quaternion is not None:
            quaternions = motion.c[slots.quaternion]
            assert_allclose(np.linalg.norm(quaternions, axis=0), 1.0, atol=1e-14)
            turned = Rotation.from_quat(quaternions.T, scalar_first=True)
            center = turned[np.repeat(np.arange(2, times.size, 5), 5)]
            omega = rate((turned * center.inv()).as_rotvec().T)
            expected = [v.get(name, 0 * omega[0]) for name in ("rx", "ry", "rz")]
            assert_allclose(omega, expected, atol=1e-6 * np.abs(motion.yd).max())


@every_robot
def test_motion_is_linear_in_velocity_and_acceleration(robot, rng):
    q, qd, qdd = random_samples(robot, rng, 6)
    motion, still = motion_of(robot, q, qd, qdd), motion_of(robot, q, qd, 0 * qdd)
    assert_allclose(motion.yd, np.einsum("ijs,js->is", motion.J, qd.T), rtol=1e-12)
    expected = still.ydd + np.einsum("ijs,js->is", motion.J, qdd.T)
    assert_allclose(motion.ydd, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())
    assert np.array_equal(motion.c, still.c)


# ---- One assembly mode, however the samples come ------------------------------------------------------------------


@every_robot
def test_order_and_company_of_samples_do_not_matter(robot, rng):
    q, qd, qdd = random_samples(robot, rng, 90)
    together = motion_of(robot, q, qd, qdd)
    shuffle = rng.permutation(90)
    shuffled = motion_of(robot, q[shuffle], qd[shuffle], qdd[shuffle])
    for name in ("c", "yd", "ydd", "J"):
        expected = getattr(together, name)
        scale = np.abs(expected).max()
        assert_allclose(getattr(shuffled, name), expected[..., shuffle], rtol=1e-9, atol=1e-10 * scale)
        for sample in (0, 33, 89):
            alone = motion_of(robot, *(each[[sample]] for each in (q, qd, qdd)))
            assert_allclose(getattr(alone, name)[..., 0], expected[..., sample], rtol=1e-9, atol=1e-10 * scale)


@every_robot
def test_segments_are_the_same_path(robot):
    """Followed sample by sample or in parallel segments, the configurations are the same."""
    q = trajectory(robot, np.linspace(0.0, 9.0, 301))[0]
    assert_allclose(follow(model(robot).loops, q.T, segments=1), path_of(robot, q), atol=1e-10)


@winding
@pytest.mark.parametrize("sense", [1, -1])
def test_a_crank_that_turns_round_and_round(robot, sense):
    """After seven turns all is where it was, apart from whole turns, and the path is smooth."""
    q = home(robot) + sense * np.linspace(0.0, 14 * pi, 1401)[:, None]
    c = path_of(robot, q)
    loops = model(robot).loops
    assert loops.gap(c).max() < 1e-12
    turns = (c[: len(robot.joints), -1] - loops.home[: len(robot.joints)]) / (2 * pi)
    assert_allclose(turns, np.round(turns), atol=1e-9)
    assert turns[0] == pytest.approx(7 * sense)
    assert np.abs(np.diff(c[: len(robot.joints)], axis=1)).max() < 0.15
    for slots in loops.layout.platforms:  # a quaternion may come back with its sign changed
        inner = np.sum(c[slots.quaternion, -1] * loops.home[slots.quaternion])
        assert abs(inner) == pytest.approx(1.0, abs=1e-9)
        assert np.abs(np.diff(c[slots.quaternion], axis=1)).max() < 0.1


def test_a_path_goes_on_from_where_it_stopped():
    robot = four_bar()
    q = home(robot) + np.linspace(0.0, 30.0, 901)[:, None]
    whole = path_of(robot, q)
    rest = path_of(robot, q[600:], start=whole[:, 599])
    assert_allclose(rest, whole[:, 600:], atol=1e-10)
    beside = displaced(model(robot).loops, path_of(robot, q + 0.01, start=whole[:, 0]), q.T, str)
    assert_allclose(beside, whole, atol=1e-10)


def test_angles_of_thousands_of_turns_are_no_reason_to_refuse():
    """Rounding leaves such loops open by more than 1e-12."""
    robot = four_bar()
    loops = model(robot).loops
    start = loops.home + np.array([1.0, -1.0, 0.0]) * 2 * pi * 20000
    c = path_of(robot, start[0] + np.linspace(0.0, 6.0, 200)[:, None], start=start)
    near = path_of(robot, loops.home[0] + np.linspace(0.0, 6.0, 200)[:, None])
    assert_allclose(c - start[:, None], near - loops.home[:, None], atol=1e-9)


@pytest.mark.parametrize("corners", [[(0.548, 1.587), (-1.975, 1.764)], [(-2.072, -0.644), (-2.195, 2.395)]])
def test_the_way_decides_not_the_place(corners):
    """Round a singular pose of the five-bar the path comes to the end with other turns than straight from home."""
    robot = load_robot("five-bar")
    loops = model(robot).loops
    corners = home(robot) + np.array([(0.0, 0.0), *corners])
    straight, reached = advance(loops, loops.home[:, None], corners[[2]].T)
    share = np.linspace(0.0, 1.0, 500)[:, None]
    legs = [corners[0] + share * (corners[1] - corners[0]), corners[1] + share * (corners[2] - corners[1])]
    q = np.vstack([*legs, corners[2] - 0.02 * np.sin(9 * share), corners[2] - 0.02 * np.sin(9 * (share + 1.0))])
    c = path_of(robot, q)
    assert not reached[0] or np.abs(c[:, 999] - straight[:, 0]).max() > 6.0
    assert loops.gap(c).max() < 1e-12
    assert np.abs(np.diff(c, axis=1)).max() < 0.1
    assert_allclose(follow(loops, q.T, segments=1), c, atol=1e-10)


@every_robot
def test_random_states_are_feasible(robot, rng):
    idm = model(robot)
    motion = random_motion(idm, 200, rng)
    assert motion.c.shape[1] >= 100
    assert idm.loops.gap(motion.c).max() < 1e-12
    assert motion.condition.max() < CONDITION
    for row, name in zip(motion.c[idm.layout.actuated], robot.actuated, strict=True):
        limits = robot.joint(name).limits.position
        if limits is not None:
            assert limits[0] <= row.min() < row.max() <= limits[1]


# ---- Assembly modes are never changed unseen ----------------------------------------------------------------------


@pytest.mark.parametrize("step", [1.3e-4, 1e-3, 0.013, 0.05, 0.17, 0.4])
@pytest.mark.parametrize("shift", [0.0, 0.37, 0.5])
def test_a_parallelogram_is_not_followed_through_its_flat_pose(step, shift):
    """There it may go on as a parallelogram or crossed: no sample shows which, so the path ends."""
    robot = four_bar(0.3, 0.6, 0.3, 0.6, home=0.6)
    q = 0.6 - step * (np.arange(int(1.2 / step) + 1) + shift)[:, None]
    reached = path_of(robot, q[q > 0.05][:, None])
    assert_allclose(reached[1], -reached[0], atol=1e-10)  # the coupler does not turn
    message = refusal(path_of, robot, q)
    first = int(np.flatnonzero(q[:, 0] <= 1e-9)[0])
    named = int(message.split("sample ")[1].split(" ")[0])
    assert first - 1 - 0.004 / step <= named <= first


def test_a_dead_centre_is_not_passed():
    """The crank of a triple-rocker swings back at its dead centre; the log that does not is refused at that sample."""
    robot = four_bar(0.5, 0.3, 0.4, 0.7, home=0.6)
    dead = np.arccos((0.5**2 + 0.7**2 - (0.3 + 0.4) ** 2) / (2 * 0.5 * 0.7))
    there_and_back = dead - 0.02 - (dead - 0.62) * np.abs(np.linspace(-1.0, 1.0, 401))[:, None]
    c = path_of(robot, there_and_back)
    assert_allclose(c[:, 0], c[:, -1], atol=1e-10)
    beyond = np.linspace(0.6, dead + 0.2, 333)[:, None]
    message = refusal(path_of, robot, beyond)
    first = int(np.flatnonzero(beyond[:, 0] > dead)[0])
    assert f"at sample {first} (q_1 = {beyond[first, 0]:.4g})" in message


def test_the_orthoglide_is_not_led_past_its_parallel_bars():
    """At equal q of 0.31 the bars are parallel; a pose behind can be closed, but in which mode nobody can say."""
    robot = load_robot("orthoglide")
    for samples in (1, 7, 100):
        message = refusal(path_of, robot, np.linspace(0.5 / samples, 0.5, samples)[:, None] * np.ones(3))
        assert "beyond a singular pose" in message


@every_robot
def test_wide_random_poses_keep_the_orientation_of_home(robot, rng):
    """Wherever a straight way leads, the passive columns of G keep the sign of their determinant."""
    loops = model(robot).loops
    span = 0.06 if robot.name == "hexapod" else 1.0
    q = home(robot)[:, None] + span * rng.uniform(-1, 1, (len(robot.actuated), 60))
    c, _ = advance(loops, np.repeat(loops.home[:, None], 60, axis=1), q, shortest=2.0**-6)
    ways = np.linspace(0.0, 1.0, 25)
    start = home(robot)[:, None]
    errors = loop_errors(loops.layout)

    def passive_columns(c: np.ndarray) -> np.ndarray:
        return errors(c)[1][:, loops.layout.passive]

    for lane in range(0, 60, 6):
        way = start + ways * (c[loops.layout.actuated, lane][:, None] - start)
        assert_allclose(follow(loops, way)[: len(robot.joints), -1], c[: len(robot.joints), lane], atol=1e-9)
        steps = np.array([passive_columns(pose) for pose in (loops.home, *follow(loops, way).T)])
        assert (np.linalg.det(steps[:-1].transpose(0, 2, 1) @ steps[1:]) > 0).all()


# ---- What is refused, and how ---------------------------------------------------------------------------------------


def with_actuated(robot: Robot, **actuated: bool) -> Robot:
    joints = tuple(replace(each, actuated=actuated.get(f"_{each.name}", each.actuated)) for each in robot.joints)
    return replace(robot, joints=joints)


def close(robot: Robot) -> object:
    return InverseDynamics(robot).loops


@pytest.mark.parametrize(
    ("robot", "numbers"),
    [
        (
            with_actuated(four_bar(), _3=True),
            "2 actuated joints for 1 dof, where loops or couplings tie 1, 3 at home; mark 1",
        ),
        (
            with_actuated(four_bar(), _2=True, _3=True),
            "3 actuated joints for 1 dof, where loops or couplings tie 1, 2, 3 at home; mark 2",
        ),
        (
            with_actuated(load_robot("orthoglide"), _21=True),
            "4 actuated joints for 3 dof, where loops or couplings tie 21, 12 at home; mark 1",
        ),
        (
            replace(seven_r(), couplings=(Coupling("3", (("2", 1.0),)),)),
            "for 6 dof, where loops or couplings tie 2, 3 at home; mark 1 of them passive",
        ),
    ],
    ids=["four-bar", "all of a four-bar", "orthoglide", "coupling"],
)
def test_redundant_actuation(robot, numbers):
    message = refusal(close, robot)
    assert message.startswith(f"robot '{robot.name}': actuation is redundant, which is not supported")
    assert numbers in message


@pytest.mark.parametrize(
    ("robot", "free", "dof"),
    [
        (with_actuated(load_robot("five-bar"), _right=False), "left_forearm, right, right_forearm", 1),
        (with_actuated(load_robot("orthoglide"), _12=False), "21, 51, 12, 33, 43, x_P", 1),
        (four_bar(0.3, 0.6, 0.3, 0.6, home=0.0), "2, 3", 1),
    ],
    ids=["five-bar", "orthoglide", "flat home"],
)
def test_joints_that_nothing_moves(robot, free, dof):
    message = refusal(close, robot)
    held = ", ".join(robot.actuated)
    assert message.startswith(
        f"robot '{robot.name}': with the actuated joints ({held}) held at the home configuration {free} can still move "
        f"({dof} dof); actuate more joints"
    )


@pytest.mark.parametrize(
    ("robot", "free", "it"),
    [
        (with_actuated(palletizer(), _4=False), "4", "it"),
        (with_actuated(palletizer(), _0=False, _4=False), "0, 4", "them"),
        (with_actuated(seven_r(), _3=False), "3", "it"),
        (replace(four_bar(), closures=()), "2, 3", "them"),
    ],
    ids=["wrist", "turret and wrist", "serial", "no closure"],
)
def test_joints_outside_loops_that_nothing_moves(robot, free, it):
    """Nothing but a motor, or standing still, can hold these; no other home does."""
    message = refusal(close, robot)
    assert message.startswith(
        f"robot '{robot.name}': no motor moves {free} and no closure holds {it}; hold the joints "
    )
    assert f"'held: {{{free.split(', ')[0]}: POSITION}}'" in message
    assert message.endswith("or mark the joint actuated.")


def test_a_leg_of_a_hexapod_that_is_not_driven():
    message = refusal(close, with_actuated(hexapod(), _30=False))
    assert "(31, 32, 33, 34, 35)" in message
    assert "x_P, y_P, z_P, rx_P, ry_P, rz_P can still move (1 dof)" in message


def attached(robot: Robot, a: Pose) -> Robot:
    """The robot with its first closure's end a placed elsewhere."""
    first = replace(robot.closures[0], a=replace(robot.closures[0].a, placement=a))
    return replace(robot, closures=(first, *robot.closures[1:]))


@pytest.mark.parametrize(
    ("robot", "gap"),
    [
        (attached(four_bar(), Pose((0.1, 0.0, 0.0))), "closure 1 ('2' to '3') stays open by"),
        (attached(four_bar(), Pose((0.7, 0.0, 0.02))), "stays open by 20 mm; correct"),
        (attached(slider_crank(), Pose((0.5, 0.0, 0.0), (0.5, 0.0, 0.0))), "stays open by 28.6 degrees;"),
        (attached(slider_crank(), Pose((0.5, 0.0, 0.0), (pi, 0.0, 0.0))), "stays open by 180 degrees;"),
        (attached(slider_crank(), Pose((0.5, 0.0, 0.0), (0.0, pi, 0.0))), "stays open by 180 degrees;"),
        (attached(load_robot("orthoglide"), Pose((0.0, 0.03, 0.0), (-pi / 2, 0.0, 0.0))), "closure 1 ('51' to 'P')"),
    ],
    ids=["short", "out of plane", "askew", "half a turn about x", "half a turn about y", "orthoglide upside down"],
)
def test_loops_that_do_not_close_at_home(robot, gap):
    message = refusal(close, robot)
    assert message.startswith(f"robot '{robot.name}': the loops do not close near the home configuration, closure 1 (")
    assert gap in message
    assert "correct the placements or give the passive joints a 'home'" in message


def test_the_printed_table_of_the_orthoglide_is_refused():
    """The paper's r = q13 + a opens leg 3 by 2 a = 0.68 m at home; it could be assembled in an odd pose alone."""
    robot = load_robot("orthoglide")
    foot = robot.joint("13")
    printed = replace(foot, placement=replace(foot.placement, r=-foot.placement.r))
    wrong = replace(robot, joints=tuple(printed if joint.name == "13" else joint for joint in robot.joints))
    layout = Coordinates(wrong)
    errors = loop_errors(layout)
    distances = np.linalg.norm(errors(layout.home)[0][:18].reshape(3, 2, 3), axis=2) * (layout.length, 1.0)
    assert_allclose(distances, [[0.0, 0.0], [0.0, 0.0], [0.68, 0.0]], atol=1e-12)
    assert "the loops close only far from the home configuration, with '23' " in refusal(close, wrong)
    assert "the loops close only far from the home configuration in the file, with joint" in refusal(close_home, wrong)


def test_home_may_be_rough():
    """Passive joints some tenths of a radian off are put right, and closed to rounding."""
    robot = load_robot("orthoglide")
    rough = replace(
        robot,
        joints=tuple(
            joint if joint.actuated else replace(joint, home=joint.home + 0.2 * (-1) ** k)
            for k, joint in enumerate(robot.joints)
        ),
        platforms=(replace(robot.platforms[0], home=Pose((0.05, -0.04, 0.3))),),
    )
    assert_allclose(close(rough).home, model(robot).loops.home, atol=1e-12)


def test_a_pose_out_of_reach_names_sample_and_pose():
    robot = load_robot("orthoglide")
    times = np.arange(5000) * 1e-3
    q = trajectory(robot, times)[0]
    q[3217:3300, 0] -= 0.5  # as if the zero had been lost
    message = refusal(path_of, robot, q)
    pose = ", ".join(f"q_{name} = {value:.4g}" for name, value in zip(robot.actuated, q[3217], strict=True))
    assert message.startswith(f"robot 'orthoglide': at sample 3217 ({pose}) the loops cannot be closed")
    assert "check the units, signs and zeros" in message
    labels = [f"t = {time:.3f} s of run.csv" for time in times]
    assert "at t = 3.217 s of run.csv (" in refusal(path_of, robot, q, labels=labels.__getitem__)
    loops, start = model(robot).loops, np.tile(model(robot).loops.home[:, None], (1, 2))
    assert "at sample of 1 (" in refusal(displaced, loops, start, q[[0, 3217]].T, "sample of {}".format)


@pytest.mark.parametrize("bad", [0, 1, 250, 598, 599])
@pytest.mark.parametrize("segments", [512, 7, 1])
def test_the_first_bad_sample_is_named(bad, segments):
    """Wherever it stands in its segment, and whatever follows."""
    robot = load_robot("orthoglide")
    q = trajectory(robot, np.linspace(0.0, 5.0, 600))[0]
    q[[bad, -1], 0] -= 0.5
    assert f"at sample {bad} (" in refusal(follow, model(robot).loops, q.T, segments=segments)


def test_a_pose_near_the_orthoglides_singularity_on_the_diagonal():
    """At t = -d4 / sqrt(6), q = -0.06968, the three bars lie in a plane: condition grows, then nothing closes."""
    robot, d4 = load_robot("orthoglide"), 0.31
    t = -d4 / 6**0.5
    singular = t + d4 - (d4**2 - 2 * t**2) ** 0.5
    assert singular == pytest.approx(-0.06968, abs=1e-5)
    down = np.linspace(0.0, 1.0, 400)[:, None] * np.ones(3)
    still = np.zeros((400, 3))
    far = motion_of(robot, down * (singular + 1e-3), still, still)
    assert (far.condition < CONDITION).all()
    assert (np.diff(far.condition[100:]) > 0).all()
    message = refusal(motion_of, robot, down * (singular + 5e-6), still, still)
    assert message.startswith(
        "robot 'orthoglide': at sample 399 (q_11 = -0.06967, q_12 = -0.06967, q_13 = -0.06967) the pose"
    )
    assert "too close to a singularity of type 2" in message
    assert "at most 1000 allowed" in message
    assert "the loops cannot be closed" in refusal(motion_of, robot, down * (singular - 5e-6), still, still)
    assert "too close to a singularity" in refusal(motion_of, robot, np.full((1, 3), 0.306), still[:1], still[:1])


def test_not_a_number_is_refused():
    robot = four_bar()
    q = home(robot) + np.zeros((9, 1))
    q[4] = np.nan
    with pytest.raises(GtauError, match="sample 4"):
        path_of(robot, q)


def test_random_states_that_are_nearly_singular_are_drawn_anew(rng):
    """However few the regular poses are, there are as many states as asked for, or a refusal."""
    idm = model(load_robot("five-bar"))
    for limit in (2.2, 2.05):  # at best the condition number is 2
        for samples in (7, 300):
            motion = random_motion(idm, samples, rng, limit)
            assert motion.J.shape == (4, 2, samples)
            assert motion.condition.max() < limit
        W = np.zeros((2, 300, len(idm.parameter_names)))
        W[idm.full.rows, :, idm.full.columns] = idm.full(idm.layout, motion)
        assert np.linalg.matrix_rank(W.reshape(600, -1), tol=1e-9) == 25  # as many as base parameters
    assert "even close to home" in refusal(random_motion, idm, 7, rng, 2.0)


def test_random_states_leave_home(rng):
    """Within wide limits hardly a pose of a hexapod can be reached: what stays at home counts for nothing."""
    robot = load_robot("gough-stewart")
    wide = Limits(position=(-3.0, 4.0))
    joints = (replace(joint, limits=wide) if joint.actuated else joint for joint in robot.joints)
    far = replace(robot, joints=tuple(joints))
    idm = InverseDynamics(far)
    motion = random_motion(idm, 100, rng)
    start = idm.loops.home[idm.layout.actuated]
    assert np.linalg.norm(motion.c[idm.layout.actuated].T - start, axis=1).min() > 1e-3
    assert base_parameters(idm).count == 148


def test_limits_without_a_workspace_leave_no_random_states(rng):
    robot = load_robot("orthoglide")
    joints = tuple(
        replace(joint, limits=replace(joint.limits, position=(30.0, 40.0))) if joint.actuated else joint
        for joint in robot.joints
    )
    idm = InverseDynamics(replace(robot, joints=joints))
    message = refusal(random_motion, idm, 100, rng)
    assert "hardly any pose within the position limits can be reached" in message
