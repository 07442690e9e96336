"""Distances to singularities of both types against closed forms of our own, and what users are told of them."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import cache
from math import acos, atan2, pi
from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import EXPERIMENT, STEEL, Plant, five_bar, write_experiment, write_log
from numpy.testing import assert_allclose
from robots_for_tests import seven_r, slider_crank
from typer.testing import CliRunner

from gtau.cli.commands import app
from gtau.errors import GtauError
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.loops import Motion
from gtau.model.singularities import random_motion, singular_distances, tool_jacobian
from gtau.robots.geometry import attached
from gtau.robots.readers.native import parse_native
from gtau.robots.readers.read import CATALOG
from gtau.robots.robot import GROUND, Robot


@cache
def model(name: str) -> InverseDynamics:
    return InverseDynamics(load_robot(name))


def at_rest(idm: InverseDynamics, q: np.ndarray) -> Motion:
    """The motion at poses (N, n), reached along the straight lines between them."""
    still = np.zeros((len(idm.actuated), len(q)))
    return idm.motion(np.ascontiguousarray(q.T), still, still)


def index(J: np.ndarray) -> np.ndarray:
    """Type 1 by its definition, from scaled Jacobians (N, rows, n) of full rank."""
    n = J.shape[2]
    eye = np.broadcast_to(np.eye(n), (len(J), n, n))
    basis = np.linalg.qr(np.concatenate([eye, J], axis=1))[0][:, n:]
    gram = basis.transpose(0, 2, 1) @ basis
    return n / np.sqrt(np.trace(gram, axis1=1, axis2=2) * np.trace(np.linalg.inv(gram), axis1=1, axis2=2))


def same_up_to_turns(found: np.ndarray, expected: np.ndarray) -> None:
    """Equal J^T J: the tool's axes do not matter."""
    for part in (slice(0, 3), slice(3, 6)):
        a, b = (each[:, part].transpose(0, 2, 1) @ each[:, part] for each in (found, expected))
        assert_allclose(a, b, rtol=1e-9, atol=1e-9 * max(1.0, np.abs(b).max()))


# ---- The five-bar -----------------------------------------------------------------------------------------------

C, L1, L2 = 0.10, 0.25, 0.35


def five_bar_pose(x: float, z: float) -> np.ndarray:
    """Angles of the motors that hold the point at (x, z), elbows outwards."""
    angles = []
    for foot, side in ((-C, 1.0), (C, -1.0)):
        reach = np.hypot(x - foot, z)
        bend = acos((L1**2 + reach**2 - L2**2) / (2 * L1 * reach))
        angles.append(atan2(z, x - foot) + side * bend)
    return np.array(angles)


def five_bar_bars(q: np.ndarray, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Forearms as vectors (2, 2), and the velocities of the elbows for unit speeds of the motors (2, 2)."""
    arms = L1 * np.stack([np.cos(q), np.sin(q)], axis=1)
    elbows = np.array([[-C, 0.0], [C, 0.0]]) + arms
    return point - elbows, np.stack([-arms[:, 1], arms[:, 0]], axis=1)


POINTS = [(0.0, 0.4), (0.12, 0.42), (-0.2, 0.3), (0.05, 0.25), (-0.1, 0.45)]


@pytest.mark.parametrize("point", POINTS)
def test_the_five_bar_has_its_closed_forms(point: tuple[float, float]) -> None:
    idm = five_bar()
    q = five_bar_pose(*point)
    motion = at_rest(idm, q[None])
    forearms, elbow_speeds = five_bar_bars(q, np.array(point))
    A, B = forearms, np.diag(np.einsum("ij,ij->i", forearms, elbow_speeds))  # A v = B qd
    J = np.linalg.solve(A, B) / idm.layout.length
    found = tool_jacobian(idm)(motion)[0]
    assert_allclose(found.T @ found, J.T @ J, rtol=1e-10, atol=1e-12)
    type_1, type_2 = singular_distances(idm)(motion)[:, 0]
    assert type_1 == pytest.approx(index(J[None])[0], rel=1e-9)
    # type 2: det(A) = L2^2 sin(angle between the forearms), and the two columns of G_p are as long as each other
    assert type_2 == pytest.approx(abs(np.linalg.det(A)) / L2**2, rel=1e-9)


def test_a_stretched_leg_is_of_type_1_alone() -> None:
    """The distance falls with det(B), the sine between arm and forearm; the forearms stay apart."""
    found = []
    for short in (1e-4, 1e-6, 1e-8):
        reach, angle = L1 + L2 - short, 0.9  # of the left leg
        q = five_bar_pose(-C + reach * np.cos(angle), reach * np.sin(angle))
        found.append(singular_distances(five_bar())(at_rest(five_bar(), q[None]))[:, 0])
    type_1, type_2 = np.array(found).T
    assert_allclose(type_1[1:] / type_1[:-1], 0.1, rtol=0.1)  # the sine goes by the root of what the leg lacks
    assert type_1[-1] < 2e-3
    assert type_2.min() > 0.5


def test_forearms_side_by_side_are_of_type_2_alone() -> None:
    """The elbows meet where both arms lean inwards by cos(q) = C / L1; J grows without bound."""
    meet = acos(C / L1)
    found = []
    for short in (0.3, 0.1, 0.03, 0.01):
        q = np.array([meet + short, pi - meet - short])
        motion = at_rest(five_bar(), q[None])
        found.append(singular_distances(five_bar())(motion)[:, 0])
    type_1, type_2 = np.array(found).T
    assert (np.diff(type_2) < 0).all()
    assert type_2[-1] < 0.03
    assert type_1.min() > 0.3
    assert np.linalg.cond(tool_jacobian(five_bar())(motion)[0]) > 10  # of J_t itself: no measure of type 1
    with pytest.raises(GtauError, match=r"too close to a singularity of type 2, where passive joints can move"):
        at_rest(five_bar(), np.array([[meet + 4e-4, pi - meet - 4e-4]]))


def test_a_larger_robot_is_as_far_from_singularities() -> None:
    text = (CATALOG / "five-bar.yaml").read_text()
    larger = text.replace("c: 0.10", "c: 10").replace("l1: 0.25", "l1: 25").replace("l2: 0.35", "l2: 35")
    q = np.array([five_bar_pose(*point) for point in POINTS])
    large = InverseDynamics(parse_native(larger, "five-bar.yaml"))
    expected = singular_distances(five_bar())(at_rest(five_bar(), q))
    assert_allclose(singular_distances(large)(at_rest(large, q)), expected, rtol=1e-9)


# ---- Other robots -----------------------------------------------------------------------------------------------


def some_motion(idm: InverseDynamics, rng: np.random.Generator) -> Motion:
    return random_motion(idm, 40, rng)


def places(robot: Robot, c: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Frames of all bodies at a configuration (n_c,), composed from the robot's placements, without the model."""
    from scipy.spatial.transform import Rotation

    found = {GROUND: (np.eye(3), np.zeros(3))}
    for joint, value in zip(robot.joints, c[: len(robot.joints)], strict=True):
        R, p = found[joint.antecedent]
        R, p = R @ joint.placement.rotation, p + R @ joint.placement.position
        axis = np.array(joint.axis)
        turned = Rotation.from_rotvec(value * axis).as_matrix() if joint.kind == "revolute" else np.eye(3)
        found[joint.name] = (R @ turned, p + value * (R @ axis) * (joint.kind == "prismatic"))
    rest = c[len(robot.joints) :]
    rotation = Rotation.from_quat(rest[3:7], scalar_first=True).as_matrix() if rest.size == 7 else np.eye(3)
    return found | {platform.name: (rotation, rest[:3]) for platform in robot.platforms}


def test_the_orthoglide_has_the_jacobian_of_its_bars(rng: np.random.Generator) -> None:
    """u_i . v = (u_i . e_i) qd_i, with u_i along the bars and e_i along the slides; isotropic at home."""
    idm = model("orthoglide")
    motion = some_motion(idm, rng)
    e = np.array([[0, 0, 1.0], [1.0, 0, 0], [0, 1.0, 0]])
    d4 = 0.31
    moved = (motion.c[15:18] - idm.loops.home[15:18, None]).T[:, None, :] - motion.c[[0, 5, 10]].T[:, :, None] * e
    signs = [s for s in (1.0, -1.0) if np.allclose(np.linalg.norm(s * d4 * e + moved, axis=2), d4)]
    assert len(signs) == 1  # which way the bars point from the carriages
    bars = signs[0] * d4 * e + moved
    J = np.linalg.solve(bars, np.eye(3) * np.einsum("kij,ij->ki", bars, e)[:, None, :])
    expected = np.concatenate([J, 0 * J], axis=1)
    same_up_to_turns(tool_jacobian(idm)(motion), expected)
    found = singular_distances(idm)(motion)
    assert_allclose(found[0], index(J), rtol=1e-9)
    home = singular_distances(idm)(at_rest(idm, np.zeros((1, 3))))
    assert home[0, 0] == pytest.approx(1.0, abs=1e-12)


def test_the_orthoglides_type_2_falls_as_the_bars_come_into_a_plane() -> None:
    """On the diagonal the determinant of the bars' directions goes to zero at t = -d4 / sqrt(6)."""
    idm, d4 = model("orthoglide"), 0.31
    t = -d4 / 6**0.5 + np.array([3e-2, 1e-2, 4e-3])
    q = t + d4 - np.sqrt(d4**2 - 2 * t**2)
    bars = (t - q - -d4)[:, None, None] * np.eye(3) + t[:, None, None] * (1 - np.eye(3))
    assert_allclose(np.linalg.norm(bars, axis=2), d4)
    volume = np.abs(np.linalg.det(bars / d4))
    type_1, type_2 = singular_distances(idm)(at_rest(idm, np.repeat(q[:, None], 3, axis=1)))
    ratio = type_2 / volume
    assert_allclose(ratio[1:] / ratio[:-1], 1.0, atol=0.2)
    assert type_2[-1] < 0.05
    assert type_1.min() > 0.2


def test_the_3rrr_has_the_jacobian_of_its_forearms(rng: np.random.Generator) -> None:
    """d_i . (v + w z x r_i) = d_i . (z x a_i) qd_i with arms a_i, forearms d_i and pins at r_i from the centre."""
    idm = model("3-rrr")
    robot, motion, length = idm.robot, some_motion(idm, rng), idm.layout.length
    z = np.array([0, 0, 1.0])
    expected = []
    for c in motion.c.T:
        at = places(robot, c)
        A, B = np.zeros((3, 3)), np.zeros((3, 3))
        for k in range(3):
            motor, elbow, pin = (at[f"{joint}{k + 1}"][1] for joint in "123")
            d, r = pin - elbow, pin - at["P"][1]
            A[k] = [*(d[:2]), d @ np.cross(z, r)]
            B[k, k] = d @ np.cross(z, elbow - motor)
        v_x, v_y, w = np.linalg.solve(A, B)
        expected.append([v_x / length, v_y / length, 0 * w, 0 * w, 0 * w, w])
    same_up_to_turns(tool_jacobian(idm)(motion), np.array(expected))


def test_the_gough_stewart_has_the_lines_of_its_legs(rng: np.random.Generator) -> None:
    """The inverse Jacobian's rows are the legs' Pluecker coordinates about the platform's origin."""
    idm = model("gough-stewart")
    robot, motion, length = idm.robot, some_motion(idm, rng), idm.layout.length
    expected = []
    for c in motion.c.T:
        at = places(robot, c)
        lines = []
        for k, closure in enumerate(robot.closures):
            ball = attached(closure.b, at)[1]
            leg = ball - at[f"cross_{k + 1}"][1]
            u = leg / np.linalg.norm(leg)
            lines.append([*u, *(np.cross(ball - at["P"][1], u) / length)])  # times (v / length, w) is qd / length
        expected.append(np.linalg.inv(lines))
    same_up_to_turns(tool_jacobian(idm)(motion), np.array(expected))
    assert_allclose(singular_distances(idm)(motion)[0], index(np.array(expected)), rtol=1e-9)


def test_a_wrist_whose_axes_align_is_of_type_1(rng: np.random.Generator) -> None:
    idm = model("puma560")
    q = rng.uniform(-1.0, 1.0, (1, 6))
    near = np.repeat(q, 3, axis=0)
    near[:, 4] = [1e-1, 1e-3, 1e-5]
    type_1, type_2 = singular_distances(idm)(at_rest(idm, near))
    assert_allclose(type_1[1:] / type_1[:-1], 0.01, rtol=0.2)
    assert np.isnan(type_2).all()


def test_more_motors_than_freedoms_of_the_tool_are_no_singularity(rng: np.random.Generator) -> None:
    idm = InverseDynamics(seven_r())
    assert singular_distances(idm)(some_motion(idm, rng))[0].min() > 1e-3


def test_the_dead_centre_of_a_driven_crank() -> None:
    """One degree of freedom has nothing to compare with in the pose: the slider's speed is compared between poses."""
    robot = slider_crank()
    slider = replace(robot, joints=(*robot.joints[:3], replace(robot.joints[3], parameters="none")))
    idm = InverseDynamics(slider)
    dead = atan2(0.8, 0.6)  # the crank in line with the slider's way
    q = np.array([[dead - 1.0], [dead - 1e-3], [dead]])
    assert slider.tool == "3"
    speed = np.abs(at_rest(idm, q).J[2, 0])
    type_1, type_2 = singular_distances(idm)(at_rest(idm, q))
    assert_allclose(type_1 / type_1[0], speed / speed[0], atol=1e-12)
    assert type_1[-1] < 1e-12
    assert type_2.min() > 0.5


@pytest.mark.parametrize("name", ["orthoglide", "gough-stewart", "delta", "3-rrr", "palletiser", "five-bar", "ur10e"])
def test_distances_are_between_0_and_1(name: str, rng: np.random.Generator) -> None:
    found = singular_distances(model(name))(some_motion(model(name), rng))
    closed = found[~np.isnan(found)]
    assert (closed > 0).all()
    assert (closed <= 1 + 1e-12).all()
    assert np.isnan(found[1]).all() == (name == "ur10e")


# ---- In results and in the check of the logs ---------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_experiment(tmp_path_factory.mktemp("logs"), Plant(noise=0.01)).parent


def run(*arguments: str, code: int = 0) -> str:
    result = CliRunner().invoke(app, list(arguments))
    assert result.exit_code == code, result.stderr
    return result.stdout


def test_a_check_tells_of_joints_that_have_too_few_rows(folder: Path, tmp_path: Path) -> None:
    for name, payload, seed in (("free", None, 1), ("loaded", STEEL, 2), ("check", STEEL, 3)):
        moving = Plant(noise=0.01).run(name, 6.0, payload, seed)
        position = moving.position * [1, 0] + [0, moving.position[0, 1]]  # its second motor stands still
        write_log(tmp_path / f"{name}.csv", replace(moving, position=position))
    (tmp_path / "experiment.yaml").write_text(EXPERIMENT)
    said = " ".join(run("check", str(tmp_path / "experiment.yaml"), code=2).split())
    refused = CliRunner().invoke(app, ["identify", str(tmp_path / "experiment.yaml")])
    assert refused.exit_code == 2
    found = re.search(r"joint '(\w+)' has (\d+) usable rows in all runs together", refused.stderr)
    assert found is not None, refused.stderr
    assert found[0] in said
    assert json.loads(run("check", str(folder / "experiment.yaml"), "--json"))["findings"] == []


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_check_tells_what_identification_tells_later(folder: Path) -> None:
    identified = folder / "identified"
    run("identify", str(folder / "experiment.yaml"), "--out", str(identified))
    summary = (identified / "summary.txt").read_text()
    assert "type 1 (serial)" in summary
    assert "type 2 (parallel)" in summary
    document = json.loads(run("check", str(folder / "experiment.yaml"), "--json"))
    model_file = json.loads((identified / "model.json").read_text())
    logs = {log["log"]: log for log in document["logs"]}
    assert list(logs) == ["free", "loaded", "check"]
    assert [log["validation"] for log in document["logs"]] == [False, False, True]
    assert document["preparation"]["decimation"] == model_file["preparation"]["decimation"]
    assert len(model_file["singularities"]) == 4
    for nearest in model_file["singularities"]:
        same = next(each for each in logs[nearest["run"]]["singularities"] if each["type"] == nearest["type"])
        assert same["distance"] == pytest.approx(nearest["distance"], rel=1e-6)
        assert same["time"] == nearest["time"]
        assert same["pose"] == pytest.approx(nearest["pose"])
        # the pose at that time has this distance, from the motor angles alone
        q = np.array([[nearest["pose"]["left"], nearest["pose"]["right"]]])
        again = singular_distances(five_bar())(at_rest(five_bar(), q))[nearest["type"] - 1, 0]
        assert again == pytest.approx(nearest["distance"], rel=1e-5)


def test_a_check_counts_rows_and_repairs(folder: Path) -> None:
    lines = (folder / "free.csv").read_text().splitlines()
    lines[700] = lines[700].rsplit(",", 1)[0] + ",nan"
    for k in range(1, len(lines)):  # one joint rests
        t, q1, _, v1, v2 = lines[k].split(",")
        lines[k] = ",".join([t, q1, "1.0471976", v1, v2])
    (folder / "resting.csv").write_text("\n".join(lines))
    (folder / "resting.yaml").write_text(EXPERIMENT.replace("free.csv", "resting.csv"))
    document = json.loads(run("check", str(folder / "resting.yaml"), "--json", code=2))  # as identify refuses it
    log = document["logs"][0]
    assert [each["moves"] for each in log["joints"]] == [True, False]
    assert log["joints"][1]["usable"] == 0
    assert 0.4 < log["joints"][0]["usable"] < 1.0
    assert log["joints"][0]["unit"] == "rad"
    findings = [(each["grade"], each["source"]) for each in document["findings"] if "line 701" in each["what"]]
    assert findings == [("information", "resting")]
    assert log["samples"] == 5000
    assert log["rate"] == pytest.approx(500.0)
    text = run("check", str(folder / "resting.yaml"), code=2)
    assert "rest" in text
    assert "type 2 (parallel)" in text


def test_a_check_names_where_the_loops_do_not_close(folder: Path) -> None:
    (folder / "swapped.yaml").write_text(EXPERIMENT.replace("left: q1, right: q2", "left: q2, right: q1"))
    findings = json.loads(run("check", str(folder / "swapped.yaml"), "--json", code=2))["findings"]
    refused = [each["what"] for each in findings if each["grade"] == "error"]
    assert "of run 'free'" in refused[0]
