"""URDF with loops in a YAML file beside it, mimic joints, idle pins, and solving for home."""

from __future__ import annotations

import re
from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np
import pytest
from engines import Mujoco, Pinocchio, closed_torques, random_parameters, tree_torques

from gtau.errors import GtauError
from gtau.model.home import close_home, load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.kinematics import Coordinates
from gtau.model.loop_closure import CLOSED, loop_errors
from gtau.robots.parts import without_idle_pins
from gtau.robots.readers.native import read_native, write_native
from gtau.robots.readers.read import read_robot
from gtau.robots.robot import Attachment, Closure, Coupling, Joint, Limits, Mdh, Pose, Robot

MODELS = ("5bar_linkage", "robot_delta")


def gap(robot: Robot) -> float:
    error, _ = loop_errors(Coordinates(robot))(Coordinates(robot).home)
    return float(np.abs(error).max())


# The models as published


@pytest.mark.parametrize("folder", MODELS)
def test_models_load_as_they_are(folder: str, shared: Path, tmp_path: Path, rng: np.random.Generator) -> None:
    path = shared / "parallel_models" / folder
    robot = load_robot(path)
    assert load_robot(path / "robot.yaml") == robot
    assert load_robot(path / "robot.urdf") == robot
    idm = InverseDynamics(robot)
    assert len(idm.actuated) == 2
    assert gap(robot) < CLOSED
    write_native(robot, tmp_path / "copy.yaml")
    copy = read_native(tmp_path / "copy.yaml")
    assert (copy, copy.notes) == (robot, robot.notes)
    chi = random_parameters(robot, rng)
    home = np.array([joint.home for joint in robot.joints if joint.actuated])
    q, (qd, qdd) = home + 0.05 * rng.uniform(-1, 1, (5, 2)), rng.normal(size=(2, 5, 2))
    expected = closed_torques(robot, chi, q, qd, qdd)
    assert closed_torques(robot, chi, q, qd, qdd, Mujoco) == pytest.approx(expected, rel=1e-9)
    for each in (robot, copy):
        assert InverseDynamics(each).torques(q, qd, qdd, chi) == pytest.approx(expected, rel=1e-9)


def test_what_the_models_notes_say(shared: Path) -> None:
    five_bar, delta = (load_robot(shared / "parallel_models" / folder) for folder in MODELS)
    assert five_bar.actuated == ("mot1", "mot2")
    (heavy,) = (note for note in five_bar.notes if "654,498 kg" in note)
    idle = [note for note in five_bar.notes + delta.notes if "is idle" in note]
    home = [note for note in five_bar.notes + delta.notes if "home was solved" in note]
    assert (heavy.count("654,498 kg"), len(idle), len(home)) == (2, 4, 2)
    assert len(five_bar.notes + delta.notes) == 7
    assert (
        "with mot1_rod1 = 0, mot1_rod2 = 0, is closer to a singularity: condition number 243 instead of 42.9" in home[1]
    )
    assert "singularity" not in home[0]
    assert [len(five_bar.joints), len(delta.joints)] == [5, 11]


def test_home_does_not_depend_on_the_processors_rounding(shared: Path, rng: np.random.Generator) -> None:
    """Placements that differ in their last digits have the same home, though the search for it is long."""
    drawn = read_robot(shared / "parallel_models" / "robot_delta")

    def jittered(joint: Joint) -> Joint:
        assert isinstance(joint.placement, Pose)
        x, y, z = (value * (1 + 2e-16 * rng.normal()) for value in joint.placement.xyz)
        return replace(joint, placement=replace(joint.placement, xyz=(x, y, z)))

    first = close_home(drawn)
    for _ in range(2):
        other = close_home(replace(drawn, joints=tuple(map(jittered, drawn.joints))))
        motors, others = ([robot.joint(name).home for name in first.actuated] for robot in (first, other))
        assert motors == others
        assert [joint.home for joint in other.joints] == pytest.approx(
            [joint.home for joint in first.joints], abs=1e-11
        )
        assert other.notes == first.notes


def test_as_drawn_the_models_have_idle_pins(shared: Path) -> None:
    """Mobility before the pins are locked, from the null space of the closures at a generic closed pose."""
    from gtau.robots.readers.urdf_tree import read_urdf_tree

    names = {"5bar_linkage": [("A", "B")], "robot_delta": [("A", "B"), ("B", "A"), ("A", "B")]}
    mobility = {}
    for folder, pairs in names.items():
        tree = read_urdf_tree(shared / "parallel_models" / folder / "robot.urdf", {})
        closures = tuple(
            Closure("weld", *(tree.frames[f"closedloop{k}_{side}"] for side in pair))
            for k, pair in enumerate(pairs, start=1)
        )
        drawn = close_home(Robot("drawn", tree.joints, closures=closures).with_file(home_given=False))
        _, J = loop_errors(Coordinates(drawn))(Coordinates(drawn).home)
        mobility[folder] = J.shape[1] - np.linalg.matrix_rank(J, tol=1e-7)
    assert mobility == {"5bar_linkage": 3, "robot_delta": 5}


# A five-bar in a tilted plane, as a drawing program writes it


def hinge(name: str, parent: str, child: str, xyz: str, rpy: str = "0 0 0", axis: str = "0 0 1") -> str:
    return (
        f'<joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/></joint>'
    )


URDF = (
    '<robot name="tilted">'
    + "".join(f'<link name="{name}"/>' for name in ("base", "plate", "l1", "l2", "r1", "r2", "pin_a", "pin_b", "tip"))
    + hinge("stand", "base", "plate", "0 0 1", "0.4 -0.7 0.3").replace("continuous", "fixed")
    + hinge("left", "plate", "l1", "-0.1 0 0")
    + hinge("left_2", "l1", "l2", "0.25 0 0.02")
    + hinge("right", "plate", "r1", "0.1 0 0", axis="0 0 -1")
    + hinge("right_2", "r1", "r2", "0.25 0 0")
    + hinge("end_a", "l2", "pin_a", "0.35 0 0", "0 0 0.4")
    + hinge("end_b", "r2", "pin_b", "0.35 0 0.02", axis="0 0 -1")
    + hinge("tip_joint", "r2", "tip", "0.35 0 0.02").replace("continuous", "fixed")
    + "</robot>"
)
LOOPS = "closed_loop: [[end_a, end_b]]\ntype: ['6d']\nname_mot: [left, right]\n"


def written(tmp_path: Path, urdf: str = URDF, loops: str = LOOPS) -> Path:
    (tmp_path / "robot.urdf").write_text(urdf)
    (tmp_path / "robot.yaml").write_text(loops)
    return tmp_path


def test_3d_and_6d_are_the_same_mechanism(tmp_path: Path, rng: np.random.Generator) -> None:
    """The weld with its pin, and a connect of the links that the pins join."""
    welded = load_robot(written(tmp_path))
    tied = load_robot(written(tmp_path, loops=LOOPS.replace("6d", "3D")))
    # both pins pass through the point of the connect, so both are idle there
    assert [len(robot.joints) for robot in (welded, tied)] == [5, 4]
    chi = random_parameters(tied, rng)
    heavy = {f"{kind}_end_a": 0.0 for kind in ("xx", "xy", "xz", "yy", "yz", "zz", "mx", "my", "mz", "m")}
    # the pin counts in the choice of home, so both start from that of one
    tied = replace(tied, joints=tuple(replace(joint, home=welded.joint(joint.name).home) for joint in tied.joints))
    home = np.array([joint.home for joint in tied.joints if joint.actuated])
    q, (qd, qdd) = home + 0.05 * rng.uniform(-1, 1, (5, 2)), rng.normal(size=(2, 5, 2))
    expected = InverseDynamics(tied).torques(q, qd, qdd, chi)
    assert InverseDynamics(welded).torques(q, qd, qdd, chi | heavy) == pytest.approx(expected, rel=1e-9)


def test_joint_types_of_the_side_file(tmp_path: Path) -> None:
    loops = LOOPS + "joint_name: [end_a, right_2, end_b]\njoint_type: [SPHERICAL, CARDAN, FIXED]\n"
    found = load_robot(written(tmp_path, loops=loops))
    names = [joint.name for joint in found.joints]
    assert names == ["left", "left_2", "end_a_x", "end_a_y", "end_a", "right", "right_2_x", "right_2"]
    assert [found.joint(name).parameters for name in ("end_a_x", "end_a", "right_2_x")] == ["none", "inertial", "none"]
    assert gap(found) < CLOSED


OPEN = URDF[: URDF.index('<joint name="end_a"')].replace(
    '<link name="pin_a"/><link name="pin_b"/><link name="tip"/>', ""
)
SIDES = (
    '<predecessor link="l2"><origin xyz="0.35 0 0"/></predecessor>'
    '<successor link="r2"><origin xyz="0.35 0 0.02"/></successor><axis xyz="0 0 2"/>'
)
BALL = (
    '<drake:ball_constraint><drake:ball_constraint_body_A name="l2"/><drake:ball_constraint_body_B name="r2"/>'
    '<drake:ball_constraint_p_AP value="0.35 0 0"/><drake:ball_constraint_p_BQ value="0.35 0 0.02"/>'
    "</drake:ball_constraint>"
)
WRITTEN = {
    "generalized_rbda": f'<loop name="c" type="continuous">{SIDES}</loop>',
    "isaac": '<loop_joint name="c" type="spherical"><link1 link="l2" xyz="0.35 0 0" rpy="0 0 0"/>'
    '<link2 link="r2" xyz="0.35 0 0.02" rpy="0 0 0"/></loop_joint>',
    "drake": BALL,
}


@pytest.mark.parametrize("form", WRITTEN)
def test_loops_that_a_urdf_writes_itself(form: str, tmp_path: Path, rng: np.random.Generator) -> None:
    path = tmp_path / "itself.urdf"
    path.write_text(f"{OPEN}{WRITTEN[form]}</robot>")
    found = load_robot(path)
    frame = hinge("tip_a", "l2", "pin_a", "0.35 0 0").replace("continuous", "fixed")
    frame += hinge("tip_b", "r2", "pin_b", "0.35 0 0.02").replace("continuous", "fixed")
    beside = OPEN.replace('<link name="r2"/>', '<link name="r2"/><link name="pin_a"/><link name="pin_b"/>') + frame
    loops = LOOPS.replace("end_a, end_b", "pin_a, pin_b").replace("6d", "3d")
    expected = load_robot(written(tmp_path, f"{beside}</robot>", loops))
    assert found.actuated == ("left", "right")
    assert any(note.startswith("of the joints in the loops, 'left', 'right' have motors, as") for note in found.notes)
    chi = random_parameters(found, rng)
    found = replace(found, joints=tuple(replace(j, home=expected.joint(j.name).home) for j in found.joints))
    home = np.array([joint.home for joint in found.joints if joint.actuated])
    q, (qd, qdd) = home + 0.05 * rng.uniform(-1, 1, (5, 2)), rng.normal(size=(2, 5, 2))
    torques = [InverseDynamics(robot).torques(q, qd, qdd, chi) for robot in (found, expected)]
    np.testing.assert_allclose(*torques, rtol=1e-9)


def test_a_joint_of_gazebo_closes_a_loop_as_drawn(tmp_path: Path) -> None:
    joint = '<gazebo><joint name="c" type="revolute"><parent>l2</parent><child>r2</child><pose>0.35 0 0.02 0 0 0</pose>'
    text = f"{OPEN}{joint}<axis><xyz>0 0 1</xyz></axis></joint></gazebo></robot>"
    (tmp_path / "drawn.urdf").write_text(text)
    robot = load_robot(tmp_path / "drawn.urdf")
    assert robot.actuated == ("left", "right")
    # r2 is drawn 0.2 m beside l2
    assert robot.closures[0].a.placement.position == pytest.approx([0.55, 0, 0])
    assert any("joins 'right_2' to the point 0.55 0 0 m of 'left_2', where it is while" in note for note in robot.notes)
    (tmp_path / "drawn.urdf").write_text(text.replace("<pose>", '<pose relative_to="l2">'))
    bolted = (
        text.replace("<parent>l2", "<parent>world").replace("<child>r2", "<child>base").replace("revolute", "fixed")
    )
    for no_loop in (bolted, text.replace("<child>r2", "<child>camera")):
        (tmp_path / "open.urdf").write_text(no_loop)
        assert len(load_robot(tmp_path / "open.urdf").actuated) == 4
    with pytest.raises(GtauError, match="'c' of <gazebo>, placed in another frame than its child's, is not read"):
        load_robot(tmp_path / "drawn.urdf")


def test_motors_of_loops_are_those_with_a_transmission_or_named_beside(tmp_path: Path) -> None:
    text = "".join(
        f'<transmission name="t_{name}"><joint name="{name}"/></transmission>' for name in ("left", "left_2")
    )
    path = tmp_path / "itself.urdf"
    path.write_text(f"{OPEN}{WRITTEN['isaac']}{text}</robot>")
    assert load_robot(path).actuated == ("left", "left_2")
    path.with_suffix(".yaml").write_text("name_mot: [right, left_2]\n")
    robot = load_robot(path)
    assert (robot.actuated, len(robot.closures)) == (("left_2", "right"), 1)


@pytest.mark.parametrize(
    ("element", "said"),
    [
        ("<constraint name='c'/>", "<constraint> 'c' is not read; write the frames that it ties under 'closed_loop'"),
        ("<coupling name='c'/>", "<coupling> 'c' is not read"),
        ("<drake:linear_bushing_rpy/>", "<drake:linear_bushing_rpy> is not read"),
        ("<d:linear_bushing_rpy xmlns:d='http://drake.mit.edu'/>", "line 1: <linear_bushing_rpy> is not read"),
        ("<drake:joint name='c' type='ball'/>", "<drake:joint> 'c' is not read"),
        ("<mujoco><equality/></mujoco>", "<mujoco>: its <equality> is not read"),
        ("<loop name='c' type='prismatic'/>", "<loop> 'c', of type 'prismatic' and between 0 links, is not read"),
        (BALL.replace('name="r2"', 'name="r3"'), "<drake:ball_constraint>: unknown link 'r3'; did you mean"),
        (
            BALL.replace('"0.35 0 0"', '"0.35 0"'),
            "the p_AP of line 1: <drake:ball_constraint> is '0.35 0'; write 3 plain",
        ),
        (
            "".join(hinge(f"f{k}", "l2", f"closing_a_{k}", "0 0 0") + f'<link name="closing_a_{k}"/>' for k in (1, 2)),
            "what the frames 'closing_a_1', 'closing_a_2' of onshape-to-robot close is not read; write the frames",
        ),
    ],
)
def test_ties_that_are_not_read_are_refused_by_name(element: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "robot.urdf").write_text(f"{OPEN}{element}</robot>")
    with pytest.raises(GtauError, match=re.escape(said)):
        load_robot(tmp_path / "robot.urdf")


def test_drives_that_are_not_read_are_said(tmp_path: Path) -> None:
    control = (
        "<ros2_control>"
        + "".join(f'<joint name="{name}"><command_interface name="effort"/></joint>' for name in ("left", "left_2"))
        + '<joint name="right"><state_interface name="position"/></joint><transmission name="t"><plugin>transmission_'
        'interface/DifferentialTransmission</plugin><joint name="left"/><joint name="left_2"/></transmission>'
        "</ros2_control></robot>"
    )
    (tmp_path / "robot.urdf").write_text(OPEN + control)
    said = " | ".join(read_robot(tmp_path / "robot.urdf").notes)
    assert "differential or four-bar transmissions were not read: 'left' and 'left_2' (line 1); positions and" in said
    assert "<ros2_control> has no command for 'right', here taken as driven all the same" in said


def test_the_world_need_not_be_declared(tmp_path: Path) -> None:
    weld = hinge("weld", "world", "base", "0 0 1", "0 0 0.5").replace("continuous", "fixed")
    (tmp_path / "robot.urdf").write_text(f"{OPEN}{weld}</robot>")
    (tmp_path / "declared.urdf").write_text(f'{OPEN}<link name="world"/>{weld}</robot>')
    found, declared = (read_robot(tmp_path / f"{name}.urdf") for name in ("robot", "declared"))
    assert found.joints == declared.joints
    assert found.joint("left").placement.position[2] > 1.5


@pytest.mark.parametrize("axes", ["XY", "YZ", "ZX"])
def test_universal_joints_of_the_side_file(axes: str, tmp_path: Path) -> None:
    """About two axes of the joint's frame in turn, as Pinocchio's loader of these files has them."""
    loops = LOOPS + f"joint_name: [right_2]\njoint_type: [UJOINT_{axes}]\n"
    found = load_robot(written(tmp_path, loops=loops))
    first, second = (found.joint(name) for name in (f"right_2_{axes[0].lower()}", "right_2"))
    assert [each.axis.index(1.0) for each in (first, second)] == ["XYZ".index(axis) for axis in axes]
    assert (first.parameters, first.actuated, second.antecedent) == ("none", False, first.name)


def test_a_robot_file_beside_a_urdf_is_no_loops_file(tmp_path: Path) -> None:
    (tmp_path / "robot.urdf").write_text(URDF)
    write_native(load_robot("ur10e"), tmp_path / "robot.yaml")
    assert len(load_robot(tmp_path / "robot.urdf").joints) == 6
    assert load_robot(tmp_path / "robot.yaml") == load_robot("ur10e")


BAD_LOOPS = [
    ("unknown frame", LOOPS.replace("end_b", "end_c"), "closed_loop.1.2: unknown frame 'end_c'; did you mean 'end_"),
    ("one frame", LOOPS.replace(", end_b", ""), "closed_loop.1: 1 value is written; write 2."),
    (
        "frame twice",
        LOOPS.replace("end_b", "end_a"),
        "closure 1 ties 'end_a' to itself; attach its ends to two bodies.",
    ),
    ("unknown motor", LOOPS.replace("right]", "rihgt]"), "name_mot.2: unknown joint 'rihgt'; did you mean 'right'?"),
    ("no motor", LOOPS.replace("[left, right]", "[]"), "no joint is actuated;"),
    ("motors missing", LOOPS.replace("name_mot: [left, right]", ""), "the key 'name_mot' is missing; add it."),
    ("unknown type", LOOPS.replace("6d", "5d"), "type.1: write '3d' or '6d', not '5d'."),
    ("a type too many", LOOPS.replace("['6d']", "['6d', '6d']"), "type: 2 types are written for 1 entries of closed_l"),
    (
        "types of no joints",
        LOOPS + "joint_type: [FIXED]\n",
        "joint_type: 1 types are written for 0 entries of joint_na",
    ),
    ("unknown joint", LOOPS + "joint_name: [x]\njoint_type: [FIXED]\n", "joint_name.1: unknown joint 'x'; choose from"),
    ("unknown joint type", LOOPS + "joint_name: [left]\njoint_type: [BALL]\n", "joint_type.1: write 'SPHERICAL', 'CAR"),
    ("unknown key", LOOPS + "closed_loops: []\n", "unknown key 'closed_loops'; did you mean 'closed_loop'?"),
    ("object tag", LOOPS + "x: !!python/object/apply:os.system [ls]\n", "is not read; write the value without it."),
    ("YAML bomb", LOOPS + "x: &a [1]\ny: [*a, *a]\n", "anchors (&) and aliases (*) are not read;"),
]


@pytest.mark.parametrize(("text", "sentence"), [case[1:] for case in BAD_LOOPS], ids=[case[0] for case in BAD_LOOPS])
def test_bad_loops(text: str, sentence: str, tmp_path: Path) -> None:
    with pytest.raises(GtauError) as refused:
        load_robot(written(tmp_path, loops=text))
    said = str(refused.value)
    assert said.startswith(str(tmp_path / "robot.yaml"))
    assert sentence in said
    assert "\n" not in said


def test_a_loop_that_closes_nowhere(tmp_path: Path) -> None:
    with pytest.raises(GtauError, match=r"nor in any other pose tried, at best closure 1 .* open by .* mm"):
        load_robot(written(tmp_path, urdf=URDF.replace("0.35 0 0.02", "3.5 0 0.02")))


def test_a_side_file_without_its_urdf(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text(LOOPS)
    with pytest.raises(GtauError, match=r"robot.urdf: the file cannot be read \(no such file or directory\)"):
        load_robot(tmp_path / "robot.yaml")


# Mimic joints


def test_mimic_joints_are_coupled(tmp_path: Path, rng: np.random.Generator) -> None:
    """A gripper whose second finger follows the first: torques by the principle of virtual power."""
    text = """<robot name="gripper"><link name="palm"/><link name="a"/><link name="b"/><link name="arm"/>
      <joint name="lift" type="prismatic"><parent link="arm"/><child link="palm"/><axis xyz="0 0 1"/></joint>
      <joint name="one" type="prismatic"><parent link="palm"/><child link="a"/><axis xyz="1 0 0"/></joint>
      <joint name="two" type="revolute"><parent link="palm"/><child link="b"/><axis xyz="0 1 0"/>
        <mimic joint="one" multiplier="-2.5" offset="0.3"/></joint></robot>"""
    (tmp_path / "gripper.urdf").write_text(text)
    robot = load_robot(tmp_path / "gripper.urdf")
    assert robot.actuated == ("lift", "one")
    chi = random_parameters(robot, rng)
    q, qd, qdd = rng.normal(size=(3, 10, 2))
    ratio = np.array([[1.0, 0, 0], [0, 1.0, -2.5]])
    whole = tree_torques(robot, chi, q @ ratio + [0, 0, 0.3], qd @ ratio, qdd @ ratio, Pinocchio)
    assert InverseDynamics(robot).torques(q, qd, qdd, chi) == pytest.approx(whole @ ratio.T, rel=1e-9)


@pytest.mark.parametrize("leader", ["joint", "jointName"])
def test_joints_that_a_plugin_of_gazebo_couples(leader: str, tmp_path: Path) -> None:
    """Without a <mimic> for them: the joint that follows is 'mimicJoint'."""
    text = """<robot name="gripper"><link name="palm"/><link name="a"/><link name="b"/>
      <joint name="one" type="revolute"><parent link="palm"/><child link="a"/><axis xyz="0 0 1"/></joint>
      <joint name="two" type="revolute"><parent link="palm"/><child link="b"/><axis xyz="0 0 1"/></joint>
      <gazebo><plugin name="m" filename="libroboticsgroup_gazebo_mimic_joint_plugin.so"><{0}>one</{0}>
        <mimicJoint>two</mimicJoint><multiplier>-1.5</multiplier></plugin></gazebo></robot>"""
    (tmp_path / "gripper.urdf").write_text(text.format(leader))
    robot = load_robot(tmp_path / "gripper.urdf")
    assert robot.couplings == (Coupling("two", (("one", -1.5),)),)
    assert robot.actuated == ("one",)
    assert "joints coupled as a plugin of <gazebo> moves them, without <mimic>: 'two' to 'one'" in robot.notes


MIMIC = """<robot name="r"><link name="base"/><link name="a"/><link name="b"/>
  <joint name="one" type="revolute"><parent link="base"/><child link="a"/><limit lower="{low}" upper="{high}"
    velocity="inf" effort="1e300"/>{first}</joint>
  <joint name="two" type="revolute"><parent link="a"/><child link="b"/><origin xyz="{x} 0 0"/>{second}</joint></robot>
"""


def mimicking(tmp_path: Path, **changed: str) -> Robot:
    values = {"low": "-1", "high": "1", "x": "0.3", "first": "", "second": '<mimic joint="one"/>'}
    (tmp_path / "r.urdf").write_text(MIMIC.format(**{**values, **changed}))
    return load_robot(tmp_path / "r.urdf")


@pytest.mark.parametrize(("low", "high"), [("-inf", "inf"), ("-1e16", "1e16"), ("0", "Infinity")])
def test_infinite_limits_are_none(low: str, high: str, tmp_path: Path) -> None:
    assert mimicking(tmp_path, low=low, high=high).joint("one").limits == Limits()


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        *(
            ({"x": x}, f"the xyz of joint 'two' is '{x} 0 0'; write 3 plain")
            for x in ("\uff11", "1_000", "nan", "1e300")
        ),
        ({"low": "nan"}, "the lower of joint 'one' is 'nan'; write a plain"),
        ({"second": '<mimic joint="one" multiplier="1e30"/>'}, "the multiplier of <mimic> of joint 'two' is '1e30'"),
        ({"second": '<mimic joint="one" multiplier="1e8"/>'}, "coupling 1 gives 'two' from 'one' by a ratio of 1e"),
        ({"second": '<mimic joint="one" multiplier="1e-8"/>'}, "coupling 1 gives 'two' from 'one' by a ratio of 1e"),
        ({"second": '<mimic joint="two"/>'}, "joint 'two' mimics 'two', so none of them leads;"),
        ({"first": '<mimic joint="two"/>'}, "joint 'one' mimics 'two' mimics 'one', so none of them leads;"),
    ],
)
def test_numbers_and_mimics_that_no_robot_has(changed: dict[str, str], said: str, tmp_path: Path) -> None:
    with pytest.raises(GtauError, match=said):
        mimicking(tmp_path, **changed)


# Idle pins and assembly


def test_pins_that_are_not_coaxial_stay() -> None:
    def robot(b: Pose) -> Robot:
        return Robot(
            "pins",
            (
                Joint("m", "ground", "revolute"),
                Joint("a", "m", "revolute", Mdh(d=0.4), actuated=False),
                Joint("b", "ground", "revolute", b, actuated=False),
            ),
            closures=(Closure("weld", Attachment("a"), Attachment("b")),),
        )

    assert len(without_idle_pins(robot(Pose((0.4, 0.0, 0.0)))).joints) == 2
    tied = robot(Pose((0.4, 0.0, 0.0)))
    shifted = Robot("s", tied.joints, closures=(Closure("weld", Attachment("a", Mdh(d=0.1)), Attachment("b")),))
    assert without_idle_pins(shifted) == shifted
    turned = Robot("t", tied.joints, closures=(Closure("weld", Attachment("a", Mdh(alpha=0.1)), Attachment("b")),))
    assert without_idle_pins(turned) == turned


def test_the_jacobian_of_the_loops_is_a_derivative(rng: np.random.Generator) -> None:
    """Where weld and connect, platforms and couplings are nearly closed, against differences."""
    for name in ("gough-stewart", "3-rrr", "orthoglide", "staubli-tx40", "palletiser"):
        robot = load_robot(name)
        errors = loop_errors(Coordinates(robot))
        home = errors.layout.home
        _, J = errors(home)
        step = rng.normal(size=J.shape[1])
        ahead, behind = (errors(errors.moved(home, h * step))[0] for h in (1e-5, -1e-5))
        assert J @ step == pytest.approx((ahead - behind) / 2e-5, abs=1e-6)


def test_assembly_leaves_a_good_home_alone() -> None:
    for name in ("orthoglide", "gough-stewart", "palletiser", "3-rrr", "ur10e"):
        robot = load_robot(name)
        found = close_home(robot)
        assert found.notes == ()
        assert [joint.home for joint in found.joints] == pytest.approx([joint.home for joint in robot.joints], abs=1e-9)


def test_assembly_of_a_platform_from_afar(rng: np.random.Generator) -> None:
    robot = load_robot("gough-stewart")
    joints = tuple(Joint(**{**vars(joint), "home": joint.home + 0.15 * rng.uniform(-1, 1)}) for joint in robot.joints)
    platform = robot.platforms[0]
    moved = type(platform)(platform.name, platform.dof, Pose((0.1, 0.1, 0.5), (0.3, -0.2, 0.4)))
    found = close_home(Robot("g", joints, (moved,), robot.closures))
    assert gap(found) < CLOSED
    assert "home was solved" in found.notes[0]


def test_assembly_avoids_flat_parallelograms() -> None:
    """At zero all bars lie in one line, which closes, but cannot be moved from by a motor."""
    bars = (
        Joint("1", "ground", "revolute"),
        Joint("2", "1", "revolute", Mdh(d=0.3), actuated=False),
        Joint("3", "ground", "revolute", Mdh(d=0.5), actuated=False),
    )
    flat = Robot("flat", bars, closures=(Closure("connect", Attachment("2", Mdh(d=0.5)), Attachment("3", Mdh(d=0.3))),))
    found = close_home(flat)
    assert gap(found) < CLOSED
    assert abs(np.sin(found.joints[0].home)) > 0.05
    assert InverseDynamics(found).loops is not None
    assert abs(found.joints[0].home) < pi


def arm_with_a_loop(position: float) -> Robot:
    """A four-bar on the ground, beside an arm in no loop whose home and limits do not agree by a little or by much."""
    bars = (
        Joint("1", "ground", "revolute", home=1.0),
        Joint("2", "1", "revolute", Mdh(d=0.3), actuated=False, home=-1.0),
        Joint("3", "ground", "revolute", Mdh(d=0.5), actuated=False, home=1.0),
        Joint("arm", "1", "revolute", Mdh(alpha=pi / 2), home=position, limits=Limits(position=(0.0, 1.0))),
    )
    ends = Attachment("2", Mdh(d=0.5)), Attachment("3", Mdh(d=0.3))
    return Robot("mixed", bars, closures=(Closure("connect", *ends),))


def test_joints_in_no_loop_are_not_moved_to_close_one() -> None:
    rounded = arm_with_a_loop(-1e-5)  # as files round
    assert close_home(rounded) == rounded
    assert close_home(rounded).notes == ()
    moved = close_home(arm_with_a_loop(-0.2))
    assert [joint.home for joint in moved.joints] == pytest.approx([1.0, -1.0, 1.0, 0.0])
    assert moved.notes == (
        "home lay outside the position limits and was moved to the nearest one: joint 'arm' from -0.2 to 0 rad",
    )


def test_a_rough_home_is_solved_and_said_by_how_much() -> None:
    robot = arm_with_a_loop(0.5)
    joints = (replace(joint, home=joint.home + 0.2 * (joint.name == "3")) for joint in robot.joints)
    rough = replace(robot, joints=tuple(joints))
    found = close_home(rough)
    assert gap(found) < CLOSED
    assert found.joint("1").home == 1.0  # motors stay
    (note,) = found.notes
    assert note.startswith("home was solved so that the loops close: joint '3' from 1.2 to 1 rad")
