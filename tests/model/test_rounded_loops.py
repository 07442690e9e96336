"""Loops written with few digits: the same base parameters as with all of them, and the gap noted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gtau.errors import GtauError
from gtau.model.base_parameters import base_parameters
from gtau.model.home import close_home, load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.loops import close_loops
from gtau.robots.geometry import angles_of
from gtau.robots.robot import Attachment, Closure, Joint, Placement, Pose, Robot

TURNED = Rotation.from_euler("xyz", [0.3, -0.7, 1.1]).as_matrix()
DIGITS = range(3, 13)


def flat(x: float, y: float = 0.0, z: float = 0.0) -> Pose:
    return Pose((x, y, z))


def locomotive() -> Robot:
    """Three equal cranks on one rod: a loop that moves only while the cranks are parallel and of one length."""
    pins = ((0.0, 0.0), (0.4137213, 0.0711), (0.8312377, -0.0312))
    joints = [
        Joint(f"c{k}", "ground", "revolute", flat(x, y, 0.05), home=1.2, actuated=not k)
        for k, (x, y) in enumerate(pins)
    ]
    joints.append(Joint("rod", "c0", "revolute", flat(0.1234567), home=-1.2, actuated=False))
    closures = (
        Closure("connect", Attachment(f"c{k}", flat(0.1234567)), Attachment("rod", flat(*pins[k]))) for k in (1, 2)
    )
    return Robot("locomotive", tuple(joints), closures=tuple(closures), gravity=(0.0, -9.81, 0.0))


def written(robot: Robot, digits: int) -> Robot:
    """The robot mounted at an odd angle, with its numbers written with so many decimals."""

    def rounded(placement: Placement, turn: np.ndarray) -> Pose:
        values = *(turn @ placement.position).tolist(), *angles_of(turn @ placement.rotation)
        x, y, z, roll, pitch, yaw = (round(value, digits) for value in values)
        return Pose((x, y, z), (roll, pitch, yaw))

    def end(at: Attachment) -> Attachment:
        return replace(at, placement=rounded(at.placement, np.eye(3)))

    gx, gy, gz = (TURNED @ robot.gravity).tolist()
    return replace(
        robot,
        joints=tuple(
            replace(joint, placement=rounded(joint.placement, TURNED if joint.antecedent == "ground" else np.eye(3)))
            for joint in robot.joints
        ),
        closures=tuple(replace(each, a=end(each.a), b=end(each.b)) for each in robot.closures),
        gravity=(gx, gy, gz),
    )


def names(robot: Robot) -> tuple[str, ...]:
    return base_parameters(InverseDynamics(robot)).names


@pytest.mark.parametrize("robot", [load_robot("five-bar"), locomotive()], ids=lambda robot: robot.name)
def test_digits_change_no_base_parameter(robot: Robot) -> None:
    exact = names(robot)
    for digits in DIGITS:
        found = close_home(written(robot, digits))
        assert "as the numbers in the file are rounded; placements in the loops were moved by up to" in found.notes[0]
        assert " mm, as the" in found.notes[0]
        assert names(found) == exact, digits
        moved = (
            np.abs(new.placement.position - old.placement.position).max()
            for new, old in zip(found.joints, written(robot, digits).joints, strict=True)
        )
        assert max(moved) < 2 * 10.0**-digits


def test_a_point_out_of_the_plane_by_a_tenth_of_a_nanometre() -> None:
    robot = load_robot("five-bar")
    tip = robot.closures[0].a
    x, y, _ = tip.placement.position.tolist()
    off = replace(robot.closures[0], a=replace(tip, placement=flat(x, y, 1e-10)))
    found = close_home(replace(robot, closures=(off,)))
    assert found.notes[0].startswith("closure 1 ('left_forearm' to 'right_forearm') stays open by 1e-07 mm, as the num")
    assert names(found) == names(robot)
    assert robot.notes == ()


@pytest.mark.parametrize("digits", [3, 6, 9, 12, 16])
def test_a_motor_too_many_is_named_whatever_the_digits(digits: int) -> None:
    robot = load_robot("five-bar")
    joints = (replace(joint, actuated=joint.name != "right_forearm") for joint in robot.joints)
    with pytest.raises(GtauError, match="actuation is redundant, which is not supported: 3 actuated joints for 2 dof"):
        close_loops(close_home(written(replace(robot, joints=tuple(joints)), digits)))


def test_what_a_drawing_does_not_forgive() -> None:
    robot = load_robot("five-bar")
    tip = robot.closures[0].a
    x, y, _ = tip.placement.position.tolist()
    off = replace(robot.closures[0], a=replace(tip, placement=flat(x, y, 0.01)))
    with pytest.raises(GtauError, match=r"the loops do not close near the home .* open by 10 mm"):
        close_home(replace(robot, closures=(off,)))


def test_a_file_as_mujoco_saves_it(tmp_path: Path) -> None:
    """Six digits: of the quaternions by which the two legs stand in a plane at an odd angle."""
    mujoco = pytest.importorskip("mujoco")
    forearm = np.arccos(0.225 / 0.35)
    spec = mujoco.MjSpec.from_string(
        "<mujoco><worldbody/><equality><connect site1='p' site2='q'/></equality>"
        "<actuator><motor joint='a'/><motor joint='b'/></actuator></mujoco>"
    )
    for x, arm, elbow, joint, tip in (
        (-0.1, 2.1, forearm - 2.1, "a", "p"),
        (0.1, np.pi - 2.1, 2.1 - forearm, "b", "q"),
    ):
        first, second = (Rotation.from_euler("z", angle) for angle in (arm, elbow))
        on_ground = (Rotation.from_matrix(TURNED) * first).as_quat(scalar_first=True)
        body = spec.worldbody.add_body(name=joint, pos=TURNED @ [x, 0.2, 0.3], quat=on_ground)
        hinge, axis = mujoco.mjtJoint.mjJNT_HINGE, [0, 0, 1]
        body.add_joint(name=joint, type=hinge, axis=axis)
        body.add_geom(size=[0.01] * 3)
        body = body.add_body(name=f"{joint}2", pos=[0.25, 0, 0], quat=second.as_quat(scalar_first=True))
        body.add_joint(name=f"{joint}2", type=hinge, axis=axis)
        body.add_geom(size=[0.01] * 3)
        body.add_site(name=tip, pos=[0.35, 0, 0])
    spec.compile()
    (tmp_path / "saved.xml").write_text(spec.to_xml())
    found = load_robot(tmp_path / "saved.xml")
    assert any("as the numbers in the file are rounded" in note for note in found.notes)
    assert len(names(found)) == 25
