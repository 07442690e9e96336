"""Loops written with few digits: the same base parameters as with all of them, and the gap noted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import parallel_robots
import pytest
from engines import closed_torques, random_parameters
from parallel_robots import KINDS, draw
from scipy.spatial.transform import Rotation

from gtau.errors import GtauError
from gtau.model.base_parameters import base_parameters
from gtau.model.home import close_home, load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.loops import close_loops
from gtau.robots.placement import angles_of
from gtau.robots.robot import Attachment, Closure, Joint, Mdh, Placement, Platform, Pose, Robot

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
    for digits in (DIGITS[0], 7, DIGITS[-1]):
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


def test_angles_in_degrees() -> None:
    robot = written(load_robot("five-bar"), 17)
    joints = []
    for joint in robot.joints:
        placement = joint.placement
        assert isinstance(placement, Pose)
        roll, pitch, yaw = (float(np.radians(round(np.degrees(angle), 4))) for angle in placement.rpy)
        turned = Pose(placement.xyz, (roll, pitch, yaw)) if joint.antecedent == "ground" else placement
        joints.append(replace(joint, placement=turned))
    found = close_home(replace(robot, joints=tuple(joints)))
    change = [np.subtract(a.placement.rpy, b.placement.rpy) for a, b in zip(found.joints, joints, strict=True)]  # type: ignore[union-attr]
    assert np.degrees(np.abs(change).max()) < 0.5001e-4
    assert names(found) == names(robot)


def three_rrr() -> Robot:
    """Exact numbers; motors 0.3 rad from home are beyond the reach of the platform."""
    joints, closures = [], []
    for k in range(3):
        angle = 2 * np.pi * k / 3
        joints += [
            Joint(f"motor{k}", "ground", "revolute", Mdh(gamma=angle, d=0.4), home=2.24),
            Joint(f"leg{k}", f"motor{k}", "revolute", flat(0.25), home=1.8, actuated=False),
        ]
        pin = Attachment("plate", Mdh(gamma=angle, d=0.1))
        closures.append(Closure("connect", Attachment(f"leg{k}", flat(0.25)), pin))
    platforms = (Platform("plate", ("x", "y", "rz")),)
    return Robot("3-rrr", tuple(joints), platforms, tuple(closures), gravity=(0.0, -9.81, 0.0))


def numbers(robot: Robot) -> np.ndarray:
    ends = (end for closure in robot.closures for end in (closure.a, closure.b))
    return np.array([[*part.placement.xyz, *part.placement.rpy] for part in (*robot.joints, *ends)])  # type: ignore[union-attr]


def test_out_of_reach_is_no_rounding(rng: np.random.Generator) -> None:
    robot = three_rrr()
    found = close_home(robot)
    assert not any("rounded" in note for note in found.notes)
    for before, after in zip(robot.joints, found.joints, strict=True):
        assert after.placement == before.placement
    assert found.closures == robot.closures
    chi = random_parameters(found, rng)
    home = np.array([joint.home for joint in found.joints if joint.actuated])
    states = home + rng.uniform(-0.02, 0.02, (5, 3)), rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    expected = closed_torques(found, chi, *states)
    np.testing.assert_allclose(InverseDynamics(found).torques(*states, chi), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("digits", [6, 17])
def test_a_gap_beyond_the_digits_is_refused(digits: int) -> None:
    """Half a millimetre out of the plane is no rounding of numbers with six decimals, nor of any with all digits."""
    robot = written(load_robot("five-bar"), digits)
    tip = robot.closures[0].a
    x, y, z = tip.placement.position.tolist()
    off = replace(robot.closures[0], a=replace(tip, placement=Pose((x, y, z + 5e-4), tip.placement.rpy)))  # type: ignore[union-attr]
    with pytest.raises(GtauError, match=r"the loops do not close near the home .* stays open by 0\.[345]"):
        close_home(replace(robot, closures=(off,)))


def check(kind: parallel_robots.Kind, seed: int, digits: int) -> None:
    """An exact robot stays as it is; a rounded one moves by no more than its digits, and has its base parameters."""
    exact = draw(kind, seed)
    assert close_home(exact) == exact
    given = parallel_robots.written(exact, digits)
    found = close_home(given)
    assert np.abs(numbers(found) - numbers(given)).max() < 0.5001 * 10.0**-digits
    assert names(found) == names(exact)


@pytest.mark.parametrize(("kind", "digits"), [(KINDS[1], 5), (KINDS[7], 4), (KINDS[9], 8)])
def test_published_robots(kind: parallel_robots.Kind, digits: int) -> None:
    check(kind, digits, digits)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("kind", KINDS)
def test_all_published_robots(kind: parallel_robots.Kind, seed: int) -> None:
    check(kind, seed, DIGITS[seed % len(DIGITS)])


FIVE_BAR = """<mujoco><compiler angle="radian"/><worldbody>{}</worldbody>
<equality><connect site1="tip0" site2="tip1"/></equality><actuator><motor joint="a0"/><motor joint="a1"/></actuator>
</mujoco>"""
LEG = """<body pos="{}" quat="{}"><joint name="a{n}" axis="{}"/><geom size="1"/><body pos="{}" quat="{}">
<joint name="f{n}" axis="{}"/><geom size="1"/><site name="tip{n}" pos="{}"/></body></body>"""
JOINT = """<joint name="{}{n}" type="continuous"><origin xyz="{}" rpy="{}"/><parent link="{}"/><child link="{}"/>
<axis xyz="{}"/></joint><link name="{}"/>"""


def five_bar_file(folder: Path, kind: str, digits: str) -> Path:
    """A five-bar whose frames lie at random in its links, so that its axes have digits, too."""
    rng, parts = np.random.default_rng(1), []

    def text(values: np.ndarray | tuple[float, ...]) -> str:
        return " ".join(f"{value:.{digits}}" for value in values)

    def turned(rotation: np.ndarray) -> str:
        quat = Rotation.from_matrix(rotation).as_quat(scalar_first=True)
        return text(quat if kind == "xml" else angles_of(rotation))

    plane, forearm = Rotation.random(random_state=rng).as_matrix(), np.arccos(0.225 / 0.35)
    for n, (x, *angles) in enumerate(((-0.1, 2.1, forearm), (0.1, np.pi - 2.1, np.pi - forearm))):
        first, second = (Rotation.random(random_state=rng).as_matrix() for _ in range(2))
        arm, tip = (
            plane @ [length * np.cos(angle), length * np.sin(angle), 0.0]
            for length, angle in zip((0.25, 0.35), angles, strict=True)
        )
        axis, other = text(first.T @ plane[:, 2]), text(second.T @ plane[:, 2])
        foot, pin, end = text(plane @ [x, 0.2, 0.3]), text(first.T @ arm), text(second.T @ tip)
        turns = turned(first), turned(first.T @ second)
        if kind == "xml":
            parts.append(LEG.format(foot, turns[0], axis, pin, turns[1], other, end, n=n))
            continue
        parts.append(JOINT.format("a", foot, turns[0], "base", f"arm{n}", axis, f"arm{n}", n=n))
        parts.append(JOINT.format("f", pin, turns[1], f"arm{n}", f"forearm{n}", other, f"forearm{n}", n=n))
        fixed = JOINT.format("tip", end, "0 0 0", f"forearm{n}", f"tip_link{n}", "1 0 0", f"tip_link{n}", n=n)
        parts.append(fixed.replace("continuous", "fixed"))
    if kind == "xml":
        (folder / "five-bar.xml").write_text(FIVE_BAR.format("".join(parts)))
        return folder / "five-bar.xml"
    (folder / "five-bar.urdf").write_text(f'<robot name="five-bar"><link name="base"/>{"".join(parts)}</robot>')
    (folder / "five-bar.yaml").write_text("closed_loop: [[tip0, tip1]]\ntype: [3d]\nname_mot: [a0, a1]\n")
    return folder / "five-bar.yaml"


@pytest.mark.parametrize("digits", ["5f", "7f", "9f", "5g"])
@pytest.mark.parametrize("kind", ["xml", "urdf"])
def test_frames_at_odd_angles(kind: str, digits: str, tmp_path: Path) -> None:
    """Axes that are nearly parallel would meet far away: a spherical linkage, which has 28 parameters.

    Of significant digits (g), small numbers have more decimals than large ones.
    """
    assert len(names(load_robot(five_bar_file(tmp_path, kind, digits)))) == 25
