"""Robot files, URDF files and the catalog."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from gtau.documents.markup import read_yaml
from gtau.errors import GtauError
from gtau.model.home import load_robot
from gtau.robots.placement import exact_angle, in_degrees
from gtau.robots.readers.native import native_text, read_native, write_native
from gtau.robots.readers.read import catalog_names
from gtau.robots.readers.source import RobotSource
from gtau.robots.readers.urdf import read_urdf
from gtau.robots.robot import (
    GROUND,
    Attachment,
    Closure,
    Coupling,
    Joint,
    Limits,
    Mdh,
    Platform,
    Pose,
    Robot,
    RobotFile,
)

Frames = dict[str, tuple[np.ndarray, np.ndarray]]


def place(frame: tuple[np.ndarray, np.ndarray], placement: Mdh | Pose) -> tuple[np.ndarray, np.ndarray]:
    rotation, position = frame
    return rotation @ placement.rotation, position + rotation @ placement.position


def forward(robot: Robot, q: dict[str, float]) -> Frames:
    """Orientation and origin of every link."""
    frames: Frames = {GROUND: (np.eye(3), np.zeros(3))}
    for joint in robot.joints:
        rotation, position = place(frames[joint.antecedent], joint.placement)
        axis = np.array(joint.axis)
        if joint.kind == "revolute":
            rotation = rotation @ pinocchio.exp3(axis * q[joint.name])
        else:
            position = position + rotation @ axis * q[joint.name]
        frames[joint.name] = rotation, position
    return frames


def read(text: str, tmp_path: Path, name: str = "robot.yaml") -> Robot:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return load_robot(path)


# The catalog


@pytest.mark.parametrize("name", catalog_names())
def test_catalog_survives_writing_and_reading(name: str, tmp_path: Path) -> None:
    robot = load_robot(name)
    assert robot.name == name
    assert robot.source
    write_native(robot, tmp_path / "copy.yaml")
    assert read_native(tmp_path / "copy.yaml") == robot
    assert [file.name for file in tmp_path.iterdir()] == ["copy.yaml"]


def assert_closed_at_home(robot: Robot, within: float = 1e-15) -> None:
    frames = forward(robot, {joint.name: joint.home for joint in robot.joints})
    for platform in robot.platforms:
        frames[platform.name] = platform.home.rotation, platform.home.position
    for closure in robot.closures:
        (rotation_a, a), (rotation_b, b) = (place(frames[end.body], end.placement) for end in (closure.a, closure.b))
        np.testing.assert_allclose(a, b, atol=within)
        if closure.kind == "weld":
            np.testing.assert_allclose(rotation_a, rotation_b, atol=within)


@pytest.mark.parametrize("name", catalog_names())
def test_catalog_closes_at_home(name: str) -> None:
    assert_closed_at_home(load_robot(name))


def test_orthoglide_is_the_paper_s() -> None:
    robot = load_robot("orthoglide")
    assert robot.actuated == ("11", "12", "13")
    assert robot.tool == "P"
    assert robot.gravity == (0.0, 9.80665, 0.0)
    feet = forward(robot, {joint.name: joint.home for joint in robot.joints})
    expected = {"11": (0, 0, 0), "12": (-0.34, 0, 0.34), "13": (0, -0.34, 0.34)}
    for name, position in expected.items():
        np.testing.assert_allclose(feet[name][1], position, atol=1e-15)
    # Frames of the legs (eq. 40): columns x, y, z.
    np.testing.assert_allclose(feet["12"][0], np.eye(3)[:, [1, 2, 0]], atol=1e-15)
    np.testing.assert_allclose(feet["13"][0], np.eye(3)[:, [2, 0, 1]], atol=1e-15)


def test_orthoglide_bar_ends_where_the_paper_says(rng: np.random.Generator) -> None:
    robot = load_robot("orthoglide")
    q = dict(zip((joint.name for joint in robot.joints), rng.uniform(-1, 1, 15), strict=True))
    frames = forward(robot, q)
    for leg in "123":
        q2, q3 = q["2" + leg], q["3" + leg]
        rotation, foot = frames["1" + leg]
        bar = 0.31 * np.array([np.cos(q2) * np.cos(q3), -np.sin(q3), -np.sin(q2) * np.cos(q3)])
        np.testing.assert_allclose(frames["5" + leg][1], foot + rotation @ bar, atol=1e-15)


def test_ur10e_is_the_maker_s(shared: Path, rng: np.random.Generator) -> None:
    urdf = shared / "ur10e" / "ur10e.urdf"
    robot = load_robot("ur10e")
    model = pinocchio.buildModelFromUrdf(str(urdf))
    data = model.createData()
    from_urdf = read_urdf(urdf)
    assert [joint.name for joint in robot.joints] == list(model.names)[1:]
    tool = None
    for q in rng.uniform(-np.pi, np.pi, (20, 6)):
        pinocchio.forwardKinematics(model, data, q)
        ours = forward(robot, dict(zip(model.names[1:], q, strict=True)))
        theirs = forward(from_urdf, dict(zip(model.names[1:], q, strict=True)))
        for index, joint in enumerate(from_urdf.joints, start=1):
            np.testing.assert_allclose(theirs[joint.name][0], data.oMi[index].rotation, atol=1e-9)
            np.testing.assert_allclose(theirs[joint.name][1], data.oMi[index].translation, atol=1e-9)
            axis = data.oMi[index].rotation @ np.array(joint.axis)
            rotation, position = ours[joint.name]
            np.testing.assert_allclose(rotation[:, 2], axis, atol=1e-9)
            np.testing.assert_allclose(np.cross(position - data.oMi[index].translation, axis), 0.0, atol=1e-9)
        rotation, position = ours["wrist_3_joint"]
        np.testing.assert_allclose(position, data.oMi[6].translation, atol=1e-9)
        turn = data.oMi[6].rotation.T @ rotation
        tool = turn if tool is None else tool
        np.testing.assert_allclose(turn, tool, atol=1e-9)
    for ours_, theirs_ in zip(robot.joints, from_urdf.joints, strict=True):
        np.testing.assert_allclose(ours_.limits.position, theirs_.limits.position, atol=1e-9)
        assert (ours_.limits.velocity, ours_.limits.effort) == (theirs_.limits.velocity, theirs_.limits.effort)


# Loading


def test_load_robot_accepts_what_people_have(tmp_path: Path) -> None:
    robot = load_robot("five-bar")
    assert load_robot(robot) is robot
    write_native(robot, tmp_path / "mine.yml")
    assert load_robot(str(tmp_path / "mine.yml")) == robot


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("orthoglid", "no robot is called 'orthoglid' (did you mean 'orthoglide'?)"),
        ("xyz", "no robot is called 'xyz'; choose from the catalog (3-rrr, delta, emps, five-bar,"),
        ("missing.yaml", "missing.yaml cannot be read: no such file or directory"),
        ("missing.urdf", "missing.urdf: the file cannot be read (no such file or directory)"),
        ("arm.xacro", "no robot is called 'arm.xacro'"),
        (
            "robot.sdf",
            "robot.sdf is an SDF file, which is not read; make an MJCF file of it by 'sdf2mjcf robot.sdf robot.xml'",
        ),
        (
            __file__,
            "ends in none of .yaml, .urdf, .xacro, .xml (MJCF), .par or .csv; give it the ending of its format.",
        ),
    ],
)
def test_load_robot_refuses(name: str, sentence: str) -> None:
    with pytest.raises(GtauError) as refused:
        load_robot(name)
    assert sentence in str(refused.value)


def test_a_file_beside_is_suggested(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").touch()
    with pytest.raises(GtauError, match=r"no robot is called .* [(]did you mean .*arm\.urdf'[?][)]"):
        load_robot(tmp_path / "arm.udrf")


# The robot file


def test_example_of_the_docs(tmp_path: Path) -> None:
    docs = Path(__file__).parents[2] / "docs" / "lookup" / "robot-file.md"
    robot = read(docs.read_text(encoding="utf-8").split("```yaml\n")[1].split("```")[0], tmp_path)
    assert robot.actuated == ("left", "right")
    assert_closed_at_home(robot)


def test_the_five_bar_of_the_docs(tmp_path: Path) -> None:
    docs = Path(__file__).parents[2] / "docs" / "do" / "describe-robot.md"
    robot = read(docs.read_text(encoding="utf-8").split("```yaml\n")[1].split("```")[0], tmp_path)
    assert robot.actuated == ("left", "right")
    assert robot.tool == "right_forearm"  # which carries the disc of the tutorial's logs
    assert_closed_at_home(robot, 1e-9)  # home is solved, from one near it


def test_names_stay_as_written(tmp_path: Path) -> None:
    text = "robot: 007\njoints:\n"
    antecedent = "ground"
    for name in ("on", "01", "1e3", "no", "null", "11"):
        text += f"  {name}: {{antecedent: {antecedent}, theta: q}}\n"
        antecedent = name
    robot = read(text, tmp_path)
    assert robot.name == "007"
    assert [joint.name for joint in robot.joints] == ["on", "01", "1e3", "no", "null", "11"]


def test_constants_may_use_the_ones_above(tmp_path: Path) -> None:
    robot = read(
        "robot: r\nconstants: {a: 2, b: a/4}\njoints: {j: {antecedent: ground, d: a*b, r: q - b, home: -a}}\n", tmp_path
    )
    assert robot.joints[0] == Joint("j", "ground", "prismatic", Mdh(d=1.0, r=-0.5), home=-2.0)


def test_who_is_actuated(tmp_path: Path) -> None:
    chain = "robot: r\njoints:\n  a: {antecedent: ground, theta: q}\n  b: {antecedent: a, d: 1, theta: q%s}\n"
    loop = "closures: [{connect: [{body: b, d: 1}, {body: ground, d: 1}]}]\n"
    assert read(chain % "", tmp_path).actuated == ("a", "b")
    assert read(chain % ", actuated: false", tmp_path).actuated == ("a",)
    (tmp_path / "loop.yaml").write_text(chain % ", actuated: true" + loop)
    assert read_native(tmp_path / "loop.yaml").actuated == ("b",)


names = st.text(
    st.characters(categories=("L", "N", "P", "S", "Zs"), exclude_characters="@"), min_size=1, max_size=8
).filter(lambda name: name.isprintable() and name not in (GROUND, "b", "P"))
numbers = st.floats(-1e3, 1e3).filter(lambda number: not in_degrees(number) and exact_angle(number) == number)
triples = st.tuples(numbers, numbers, numbers)
placements = st.builds(Mdh, *6 * [numbers]) | st.builds(Pose, triples, triples)
positive = st.none() | st.floats(1e-3, 1e3)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])  # on a machine that others use
@given(
    robot=names,
    name=names,
    source=st.text(max_size=8).filter(lambda text: text.isprintable()),
    first=placements,
    second=placements,
    ends=st.tuples(placements, placements),
    kinds=st.tuples(*2 * [st.sampled_from(("revolute", "prismatic"))]),
    closed=st.booleans(),
    actuated=st.booleans(),
    home=numbers,
    limits=st.builds(Limits, st.none() | st.just((-0.1, 0.2)), positive, positive, positive),
    gravity=triples,
    parameters=st.sampled_from(("all", "inertial", "drive", "none")),
    coupled=st.none() | st.tuples(positive.filter(bool), numbers),
    tool=st.integers(0, 2),
    notes=st.lists(st.text(st.characters(categories=("L", "N", "P", "S")), min_size=1, max_size=8), max_size=2),
)
def test_any_robot_survives_writing_and_reading(
    tmp_path_factory: pytest.TempPathFactory, robot, name, source, first, second, ends, kinds, closed, actuated, home,
    limits, gravity, parameters, coupled, tool, notes,
) -> None:  # fmt: skip
    joints = (
        Joint(name, GROUND, kinds[0], first, home=home, limits=limits),
        Joint("b", name, kinds[1], second, actuated=actuated, parameters=parameters),
    )
    platform = Platform("P", ("x", "rz"), Pose((home, 0.0, 0.0)))
    closures = (
        Closure("weld", Attachment("b", ends[0]), Attachment("P", ends[1])),
        Closure("connect", Attachment(GROUND, Mdh()), Attachment("b")),
    )
    couplings = (Coupling("b", ((name, coupled[0]),), coupled[1]),) if coupled else ()
    named = ("", name, "P" if closed else "")[tool]
    file = RobotFile(source, tuple(notes))
    made = Robot(
        robot, joints, (platform,) * closed, closures * closed, couplings, gravity, named_tool=named, file=file
    )
    path = tmp_path_factory.getbasetemp() / "any.yaml"
    path.write_text(native_text(made), encoding="utf-8")
    read_back = read_native(path)
    assert read_back == made
    assert read_back.notes == made.notes


def test_a_write_that_fails_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(GtauError, match=r"cannot be written \(No such file or directory\)"):
        write_native(load_robot("ur10e"), tmp_path / "nowhere" / "robot.yaml")
    (tmp_path / "taken").mkdir()
    with pytest.raises(GtauError, match="cannot be written"):
        write_native(load_robot("ur10e"), tmp_path / "taken")
    assert [file.name for file in tmp_path.iterdir()] == ["taken"]


def test_the_command_saves_and_draws(tmp_path: Path) -> None:
    from typer.testing import CliRunner

    from gtau.cli.commands import app

    saved, drawn = tmp_path / "five-bar.yaml", tmp_path / "five-bar.png"
    done = CliRunner().invoke(app, ["robot", "five-bar", "--save", str(saved), "--figure", str(drawn)])
    assert done.exit_code == 0
    assert "1 closure, 3 equations of rank 2" in done.output
    assert done.output.endswith(f"written: {saved}\nwritten: {drawn}\n")
    quiet = CliRunner().invoke(app, ["robot", "five-bar", "--save", str(saved), "--json"])
    assert quiet.exit_code == 0
    assert "written:" not in quiet.output
    assert read_native(saved) == load_robot("five-bar")
    assert "\n  11: {antecedent: ground, " in native_text(load_robot("orthoglide"))  # a number, without quotes
    assert drawn.read_bytes()[:4] == b"\x89PNG"
    # what cannot be moved yet, such as a table to which closures will be added, can be saved all the same
    table = tmp_path / "table.csv"
    table.write_text("j,a,mu,sigma,gamma,b,alpha,d,theta,r\n1,0,1,0,0,0,0,0,q,0\n2,1,0,0,0,0,0,1,q,0\n")
    refused = CliRunner().invoke(app, ["robot", str(table), "--save", str(saved)])
    assert refused.exit_code == 2
    assert read_native(saved) == load_robot(table)


def test_mdh_axis_other_than_z_has_no_words() -> None:
    robot = Robot("r", (Joint("j", GROUND, "revolute", Mdh(), axis=(1.0, 0.0, 0.0)),))
    with pytest.raises(GtauError, match="joint 'j' has an MDH placement but its axis is not z; place it by a Pose"):
        native_text(robot)


GOOD = """\
robot: r
constants: {a: 0.3}
joints:
  j: {antecedent: ground, d: a, theta: q}
  k: {antecedent: j, xyz: [0, 0, a], type: prismatic}
platforms:
  P: {dof: [x, z]}
closures:
  - connect: [{body: k}, {body: P, d: a}]
"""


def good(old: str, new: str) -> str:
    assert old in GOOD
    return GOOD.replace(old, new)


JOINT = "{antecedent: ground, d: a, theta: q}"
CLOSURE = "connect: [{body: k}, {body: P, d: a}]"

# (what is wrong, text, what the sentence says after the file's path)
BAD_FILES: list[tuple[str, str | bytes, str]] = [
    # YAML
    ("empty", "", " is empty; write 'key: value' lines."),
    ("only a comment", "# nothing\n", " is empty; write 'key: value' lines."),
    ("list at the root", "- a\n", ", line 1: the file must consist of 'key: value' lines."),
    ("text at the root", "robot\n", ", line 1: the file must consist of 'key: value' lines."),
    (
        "syntax",
        "robot: r\njoints: {j: {antecedent: ground\n",
        ": this is not valid YAML: a bracket or brace is not closed",
    ),
    (
        "tab",
        "robot: r\njoints:\n\tj: 1\n",
        ", line 3: this is not valid YAML: a tab or a special character begins it; indent with spaces,",
    ),
    ("indentation", "robot: r\n  name: a\n", ", line 2: this is not valid YAML: a key stands deeper than"),
    ("control characters", "robot: r\x01\n", " holds control characters; save it as plain text."),
    ("not UTF-8", b"robot: r\nsource: caf\xe9\n", ", line 2: the text is not UTF-8; save the file in that encoding."),
    ("huge", "#" * (1 << 20) + "\n", " is larger than 1 MiB;"),
    ("repeated key", GOOD + "robot: s\n", ", line 10: the key 'robot' is written twice; keep one of them."),
    ("repeated joint", good("  k:", "  j:"), ", line 5: the key 'j' is written twice; keep one of them."),
    ("bomb", "a: &a [1]\nb: [*a, *a]\n", ", line 1: anchors (&) and aliases (*) are not read; write the value out."),
    ("alias", "robot: *a\n", ", line 1: anchors (&) and aliases (*) are not read; write the value out."),
    ("key with anchor", "&a robot: r\n", ", line 1: a key must be plain text."),
    (
        "python tag",
        "robot: !!python/object/apply:os.system [ls]\n",
        "os.system' is not read; write the value without it.",
    ),
    ("harmless tag", "robot: !!str 3\n", ", line 1: the tag 'tag:yaml.org,2002:str' is not read;"),
    ("deep", "robot: " + "[" * 5000, ", line 1: values are nested more than 64 levels deep; write them flatter."),
    ("two documents", GOOD + "---\n" + GOOD, ", line 10: a second document begins here; keep one document in a file."),
    ("key that is a list", "[a, b]: 1\n", ", line 1: a key must be plain text."),
    ("empty value", good("robot: r", "robot:"), ", line 1: nothing is written after 'robot'; write a value or remove"),
    (
        "comma in an expression",
        "name: r\nconstants: {h: 0.3, a: 0.4, s: atan2(h, a)}\n",
        ", line 2: the comma before 'a)' ends a value; quote the expression, as in s: 'atan2(h, a)'.",
    ),
    (
        "comma in an expression in a list",
        "name: r\njoints:\n  a: {xyz: [0, atan2(h, a), 0]}\n",
        ", line 3: the comma before 'a)' ends a value; quote the expression, as in s: 'atan2(h, a)'.",
    ),
    ("empty item", good("{dof: [x, z]}", "\n    dof:\n      - x\n      -"), ", line 10: nothing is written after '-';"),
    # Keys
    ("no name", good("robot: r\n", ""), ": the key 'robot' is missing; add it."),
    (
        "tab in a name",
        good("  k:", '  "k\\t":'),
        " holds U+0009, a non-printing character; remove it.",
    ),
    (
        "long name",
        good("  k:", f"  {'k' * 101}:"),
        "the name 'kkkkkkkkkkkkkkkkkkkk'... has 101 characters; write 100 at most.",
    ),
    (
        "robot of two lines",
        good("robot: r", 'robot: "r\\nx"'),
        ": robot: the name 'r\\nx' holds U+000A, a non-printing character",
    ),
    ("no joints", "robot: r\n", ": the key 'joints' is missing; add it."),
    ("joints empty", "robot: r\njoints: {}\n", ": robot 'r': it has no joints; list at least one under 'joints'."),
    ("unknown key", GOOD + "gravitiy: 9\n", ", line 10, gravitiy: unknown key 'gravitiy'; did you mean 'gravity'?"),
    (
        "unknown key of a joint",
        good("theta: q", "teta: q"),
        ", line 4, joints.j.teta: unknown key 'teta'; did you mean 'theta'?",
    ),
    (
        "unknown limit",
        good("theta: q", "theta: q, limits: {postion: [0, 1]}"),
        ", line 4, joints.j.limits.postion: unknown key 'postion'; did you mean 'position'?",
    ),
    (
        "unlike any key",
        good("{dof: [x, z]}", "{dof: [x], qqq: 3}"),
        ", line 7, platforms.P.qqq: unknown key 'qqq'; choose from dof, home.",
    ),
    (
        "mass of a joint",
        good("theta: q", "theta: q, mass: 3"),
        ", line 4, joints.j: masses and inertias are identified, so leave 'mass' out; values known beforehand, as from",
    ),
    ("mass of a platform", good("{dof: [x, z]}", "{dof: [x, z], inertia: 1}"), "platforms.P: masses and inertias are"),
    (
        "unknown key in a closure",
        good("{body: k}", "{bdy: k}"),
        ", line 9, closures.1.connect.1.bdy: unknown key 'bdy'; did you mean 'body'?",
    ),
    ("no antecedent", good("antecedent: ground, ", ""), ", line 4, joints.j: the key 'antecedent' is missing; add it."),
    (
        "joint is text",
        good(JOINT, "revolute"),
        ", line 4, joints.j: write 'key: value' lines under it, not 'revolute'; its keys are ",
    ),
    ("joints is a list", "robot: r\njoints: [j]\n", ", line 2, joints: write 'key: value' lines under it, not a list."),
    ("name is a list", good("robot: r", "robot: [r]"), ", line 1, robot: write a single value, not a list."),
    # Numbers
    ("unknown constant", good("d: a,", "d: d4,"), ", line 4, joints.j.d: unknown name 'd4'; choose from a, acos,"),
    ("not a number", good("d: a,", "d: 30 mm,"), ", line 4, joints.j.d: '30 mm' is not a number or expression;"),
    (
        "code",
        good("d: a,", "d: __import__('os').abort(),"),
        ", line 4, joints.j.d: '__import__('os').abort()' is not a",
    ),
    ("number is a list", good("d: a,", "d: [1],"), ", line 4, joints.j.d: write a single number or expression."),
    ("constant below", good("{a: 0.3}", "{a: b, b: 1}"), ", line 2, constants.a: unknown name 'b'; choose from acos,"),
    ("constant called q", good("{a: 0.3}", "{q: 1}"), ", line 2, constants.q: 'q' cannot name a constant; use letters"),
    ("constant with space", good("{a: 0.3}", "{a b: 1}"), ", line 2, constants.a b: 'a b' cannot name a constant;"),
    ("constants is text", good("{a: 0.3}", "0.3"), ", line 2, constants: write 'name: value' lines under it."),
    ("two numbers of three", good("[0, 0, a]", "[0, a]"), ", line 5, joints.k.xyz: 2 values are written; write 3."),
    (
        "four of three",
        good("[0, 0, a]", "[0, 0, 0, a]"),
        ", line 5, joints.k.xyz: 4 values are written; write 3.",
    ),
    ("gravity", GOOD + "gravity: 9.81\n", ", line 10, gravity: write three numbers, m/s2 in base axes, such as"),
    ("actuated", good("theta: q", "theta: q, actuated: maybe"), "joints.j.actuated: write true or false, not 'maybe'."),
    # Joints
    ("q missing", good("theta: q", "theta: 0"), ", line 4, joints.j: the joint coordinate q is missing; write it in"),
    ("q twice", good("theta: q", "theta: q, r: q"), ", line 4, joints.j: q appears in both theta and r;"),
    ("-q", good("theta: q", "theta: -q"), ", line 4, joints.j: q is multiplied by -1; write it plain, and turn the z"),
    ("q elsewhere", good("d: a,", "d: q,"), "joints.j.d: the joint coordinate q is allowed in theta or r"),
    ("MDH and xyz", good("d: a,", "xyz: [0, 0, 0],"), ", line 4, joints.j: place it either by gamma, b, alpha, d,"),
    (
        "MDH and axis",
        good("d: a,", "axis: [0, 0, 1],"),
        ", line 4, joints.j: the keys type and axis go with xyz and rpy;",
    ),
    ("no type", good(", type: prismatic", ""), ", line 5, joints.k: the key 'type' is missing; write 'type: revolute'"),
    ("kind", good("prismatic", "sliding"), ", line 5, joints.k.type: write 'revolute' or 'prismatic', not 'sliding'."),
    (
        "axis",
        good("type:", "axis: [0, 1, 1], type:"),
        ": robot 'r': the axis of joint 'k' is not a unit vector; divide",
    ),
    (
        "antecedent",
        good("antecedent: j", "antecedent: i"),
        ": robot 'r': joint 'k' has the antecedent 'i', which is no",
    ),
    ("run of a parameter", good("  j:", "  j@2:"), ": robot 'r': the name 'j@2' holds '@', which marks the run of a"),
    ("joint called ground", good("  j:", "  ground:"), ": robot 'r': the name 'ground' is used twice;"),
    (
        "limits reversed",
        good("theta: q", "theta: q, limits: {position: [1, -1]}"),
        ": robot 'r': the position limits of joint 'j' are 1 to -1; write the lower one first, or leave them out.",
    ),
    (
        "limit of zero",
        good("theta: q", "theta: q, limits: {effort: 0}"),
        ": robot 'r': the effort limit of joint 'j' is 0; write a positive number, or leave it out.",
    ),
    (
        "tool of no robot",
        good("theta: q", "theta: q, actuated: true") + "tool: l\n",
        ": robot 'r': the tool 'l' is not a body with a mass; choose from j, k, P.",
    ),
    (
        "massless tool",
        good("theta: q", "theta: q, parameters: none") + "tool: j\n",
        ": robot 'r': the tool 'j' is not a body with a mass; choose from k, P.",
    ),
    ("nobody actuated", GOOD, ": robot 'r': no joint is actuated; mark the motors' joints with 'actuated: true'."),
    # Platforms and closures
    ("degree of freedom", good("[x, z]", "[x, yaw]"), ": robot 'r': platform 'P' has the degree of freedom 'yaw';"),
    ("same twice", good("[x, z]", "[x, x]"), ": robot 'r': the degrees of freedom of platform 'P' must be one or more"),
    ("two rotations", good("[x, z]", "[rx, rz]"), ": robot 'r': platform 'P' has two rotations; give it none, one or"),
    ("platform loose", good("body: P", "body: j"), ": robot 'r': no closure holds platform 'P'; add one or remove the"),
    (
        "closure to nothing",
        good("body: k", "body: x"),
        ": robot 'r': closure 1 is attached to 'x', which is not a joint,",
    ),
    ("closure to itself", good("body: k", "body: P"), ": robot 'r': closure 1 ties 'P' to itself; attach its ends"),
    ("one end", good("{body: k}, ", ""), ", line 9, closures.1.connect: 1 value is written; write 2."),
    ("three ends", good("{body: k}", "{body: k}, {body: j}"), ", line 9, closures.1.connect: 3 values are written;"),
    ("no kind", good(CLOSURE, "{}"), ", line 9, closures.1: a closure is either 'connect: [.., ..]' (points) or"),
    ("ratio", GOOD + "couplings: [{joint: k, ratios: {j: x}}]\n", "couplings.1.ratios.j: unknown name 'x'; choose"),
    ("no ratios", GOOD + "couplings: [{joint: k, ratios: {}}]\n", ": robot 'r': coupling 1 must give 'k' from one or"),
    ("coupled to nothing", GOOD + "couplings: [{joint: k, ratios: {z: 2}}]\n", ": coupling 1 names 'z', which is no"),
    ("ratio of zero", GOOD + "couplings: [{joint: k, ratios: {j: 0}}]\n", "coupling 1 of 'k' has a ratio of zero;"),
    (
        "joint's parameters",
        good("theta: q", "theta: q, parameters: few"),
        "joints.j.parameters: write 'all', 'inertial'",
    ),
    ("both placings", good("{body: k}", "{body: k, d: 1, rpy: [0, 0, 0]}"), "closures.1.connect.1: place it either by"),
    ("q in a closure", good("{body: k}", "{body: k, r: q}"), "closures.1.connect.1.r: the joint coordinate q is"),
]


@pytest.mark.parametrize(("text", "sentence"), [case[1:] for case in BAD_FILES], ids=[case[0] for case in BAD_FILES])
def test_bad_robot_file(text: str | bytes, sentence: str, tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    with pytest.raises(GtauError) as refused:
        read_native(path)
    said = str(refused.value)
    assert said.startswith(str(path))
    assert sentence in said.removeprefix(str(path))
    assert "\n" not in said


def test_good_but_for_one_thing_is_good(tmp_path: Path) -> None:
    robot = read(good("theta: q", "theta: q, actuated: true"), tmp_path)
    assert robot.joints[1].placement == Pose((0.0, 0.0, 0.3))


def test_lines_of_a_document(tmp_path: Path) -> None:
    path = tmp_path / "d.yaml"
    path.write_text("a:\n  b:\n    - x\n    - {c: y}\n", encoding="utf-8")
    document = read_yaml(path)
    assert document.data == {"a": {"b": ["x", {"c": "y"}]}}
    assert [document.line(keys) for keys in [(), ("a",), ("a", "b"), ("a", "b", 1, "c"), ("a", "z")]] == [
        None,
        1,
        2,
        4,
        1,
    ]


# URDF

TREE = """<?xml version="1.0"?>
<robot name="tree">
  <link name="world"/><link name="base"/><link name="l1"/><link name="bracket"/><link name="plate"/><link name="l2"/>
  <link name="l3"/><link name="l4"/><link name="tip"/>
  <joint name="last" type="prismatic">
    <parent link="plate"/><child link="l4"/><origin xyz="0.1 -0.2 0.3" rpy="0.3 1.5707963267948966 -0.7"/>
    <axis xyz="1 2 -2"/><limit lower="-0.1" upper="0.3" effort="0" velocity="0.5"/>
  </joint>
  <joint name="stand" type="fixed"><parent link="world"/><child link="base"/><origin xyz="1 2 3" rpy="1 2 3"/></joint>
  <joint name="first" type="revolute">
    <parent link="base"/><child link="l1"/><origin rpy="0.4 -0.5 0.6"/><axis xyz="0 3 4"/>
    <limit lower="-1" upper="2" effort="10" velocity="3"/>
  </joint>
  <joint name="f1" type="fixed">
    <parent link="l1"/><child link="bracket"/><origin xyz="0 0 0.2" rpy="0 -1.57079632679 1"/>
  </joint>
  <joint name="f2" type="fixed">
    <parent link="bracket"/><child link="plate"/><origin xyz="0.1 0 0" rpy="0.2 0.1 0"/>
  </joint>
  <joint name="second" type="continuous">
    <parent link="plate"/><child link="l2"/><origin xyz="0 0.1 0" rpy="0 0 1.2"/>
    <limit effort="5" velocity="4"/>
  </joint>
  <joint name="third" type="revolute">
    <parent link="l2"/><child link="l3"/><axis xyz="0 0 -1"/><limit effort="5" velocity="0"/>
  </joint>
  <joint name="tip_joint" type="fixed"><parent link="l4"/><child link="tip"/></joint>
</robot>
"""


def test_urdf_tree_agrees_with_pinocchio(tmp_path: Path, rng: np.random.Generator) -> None:
    robot = read(TREE, tmp_path, "tree.urdf")
    assert [joint.name for joint in robot.joints] == ["first", "last", "second", "third"]
    assert [joint.antecedent for joint in robot.joints] == [GROUND, "first", "first", "second"]
    assert robot.joint("first").limits == Limits((-1.0, 2.0), 3.0, None, 10.0)
    assert robot.joint("last").limits == Limits((-0.1, 0.3), 0.5)
    assert robot.joint("second").limits == Limits(None, 4.0, None, 5.0)
    model = pinocchio.buildModelFromXML(TREE)
    data = model.createData()
    for values in rng.uniform(-3, 3, (10, 4)):
        q = {joint.name: value for joint, value in zip(robot.joints, values, strict=True)}
        configuration = pinocchio.neutral(model)
        for name, value in q.items():
            joint = model.joints[model.getJointId(name)]
            circle = joint.nq == 2  # continuous
            configuration[joint.idx_q : joint.idx_q + joint.nq] = [np.cos(value), np.sin(value)] if circle else [value]
        pinocchio.forwardKinematics(model, data, configuration)
        for name, (rotation, position) in forward(robot, q).items():
            if name != GROUND:
                frame = data.oMi[model.getJointId(name)]
                np.testing.assert_allclose(rotation, frame.rotation, atol=1e-9)
                np.testing.assert_allclose(position, frame.translation, atol=1e-9)
    write_native(robot, tmp_path / "tree.yaml")
    assert read_native(tmp_path / "tree.yaml") == robot


def test_urdf_rounding_is_undone(shared: Path) -> None:
    placement = read_urdf(shared / "ur10e" / "ur10e.urdf").joint("shoulder_lift_joint").placement
    assert placement == Pose((0.0, 0.176, 0.0), (0.0, np.pi / 2, 0.0))


def test_urdf_of_real_robots(shared: Path) -> None:
    assert len(read_urdf(shared / "tx40" / "tx40_mdh_modified.urdf").joints) == 6
    assert len(read_urdf(shared / "parallel_models" / "robot_delta" / "robot.urdf").joints) == 14
    assert len(read_urdf(shared / "parallel_models" / "5bar_linkage" / "robot.urdf").joints) == 6


def arm(joint: str, links: str = '<link name="a"/><link name="b"/>') -> str:
    return f'<robot name="r">{links}{joint}</robot>'


HINGE = '<joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>{}</joint>'
BOMB = '<!DOCTYPE r [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;">]><robot name="r"><link name="&b;"/></robot>'
FILE_ENTITY = '<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/passwd">]><robot name="&a;"/>'

BAD_URDFS: list[tuple[str, str, str]] = [
    ("not XML", "robot: r\n", ": this is not valid XML (syntax error: line 1, column 0); correct the file."),
    ("entity bomb", BOMB, ": the file declares entities or a document type; write their values out."),
    ("file entity", FILE_ENTITY, ": the file declares entities or a document type; write their values out."),
    ("not a robot", "<sdf/>", ": the outermost element is <sdf>, not <robot>; give a URDF file."),
    (
        "xacro",
        '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include filename="a"/></robot>',
        ": the file holds xacro macros; end its name in .xacro, so that they are expanded.",
    ),
    ("empty", "<robot name='r'/>", ": robot 'r': it has no joints;"),
    (
        "floating",
        arm('<joint name="j" type="floating"/>'),
        ": joint 'j' is floating; write 'robot: {file: ..., base: fixed}' in the",
    ),
    (
        "planar",
        arm('<joint name="j" type="planar"/>'),
        ": joint 'j' is planar; write 'robot: {file: ..., base: fixed}' in the",
    ),
    (
        "mimic of nothing",
        arm(HINGE.format('<mimic joint="k"/>')),
        ": joint 'j' mimics 'k', which is not a joint that moves; correct its <mimic>",
    ),
    ("mimic of itself", arm(HINGE.format('<mimic joint="j"/>')), ": joint 'j' mimics 'j', so none of them leads;"),
    ("mimic unnamed", arm(HINGE.format("<mimic/>")), ": <mimic> of joint 'j' has no joint; write joint="),
    (
        "mimic ratio",
        arm(HINGE.format('<mimic joint="k" multiplier="x"/>')),
        ": the multiplier of <mimic> of joint 'j' is",
    ),
    ("deep", "<robot>" + "<a>" * 300 + "</a>" * 300 + "</robot>", ": elements are nested more than 200 levels deep;"),
    (
        "mass",
        '<robot name="r"><link name="a"><inertial><mass value="heavy"/></inertial></link></robot>',
        ": the mass of link 'a' is 'heavy'; write a plain decimal number, at most 1e+09 in size.",
    ),
    ("no type", arm('<joint name="j"/>'), ": joint 'j' has no type; write type=\"...\"."),
    ("no name", arm('<joint type="fixed"/>'), ': a joint has no name; write name="...".'),
    ("no parent", arm('<joint name="j" type="fixed"/>'), ": joint 'j' has no <parent link=...>; add it."),
    ("unknown link", arm(HINGE.format(""), '<link name="a"/>'), ": joint 'j' refers to the link 'b', which is not in"),
    ("two roots", arm(HINGE.format(""), '<link name="a"/><link name="b"/><link name="c"/>'), ": the links a, c are no"),
    ("two joints of a name", arm(HINGE.format("") * 2), ": two joints are called 'j'; give each its own name."),
    ("two links of a name", arm("", '<link name="a"/>' * 2), ": two links are called 'a'; give each its own name."),
    (
        "two parents",
        arm(HINGE.format("") + HINGE.format("").replace('"j"', '"k"')),
        ": link 'b' is the child of two joints; a URDF is a tree, so describe loops with closures in a robot file",
    ),
    (
        "circle",
        arm(HINGE.format("") + '<joint name="k" type="fixed"><parent link="b"/><child link="a"/></joint>'),
        ": joint 'j' is in a loop of parents and children;",
    ),
    ("zero axis", arm(HINGE.format("").replace("0 0 1", "0 0 0")), ": the axis of joint 'j' is zero; give it a"),
    (
        "short axis",
        arm(HINGE.format("").replace("0 0 1", "0 1")),
        ": the axis of joint 'j' is '0 1'; write 3 plain decimal num",
    ),
    ("origin", arm(HINGE.format('<origin xyz="0 nan 0"/>')), ": the xyz of joint 'j' is '0 nan 0'; write 3 plain dec"),
    (
        "limit",
        arm(HINGE.format('<limit effort="high"/>')),
        ": the effort of joint 'j' is 'high'; write a plain decimal n",
    ),
]


@pytest.mark.parametrize(("text", "sentence"), [case[1:] for case in BAD_URDFS], ids=[case[0] for case in BAD_URDFS])
def test_bad_urdf(text: str, sentence: str, tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(GtauError) as refused:
        read_urdf(path)
    said = str(refused.value)
    assert said.startswith(str(path))
    assert sentence in said.removeprefix(str(path))


# What is noted, and angles in degrees


def test_limits_that_leave_no_way_are_dropped_with_a_note(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(arm(HINGE.format('<limit lower="1" upper="-1" velocity="0"/>')))
    robot = load_robot(tmp_path / "arm.urdf")
    assert robot.joints[0].limits == Limits()
    assert robot.notes == ("empty position limits were ignored: joint 'j' (1 to -1)",)


@pytest.mark.parametrize(
    ("written", "degrees"),
    [("1.5708", 90), ("-1.57", -90), ("3.14159", 180), ("3.14", 180), ("1.57079637050", 90), ("1.5707", 90),
     ("0.785", 45), ("0.7854", 45), ("-0.52360", -30), ("2.0944", 120), ("0.2617", 15), ("1.30899694", 75), ("3e-7", 0),
     ("1.5712", None), ("1.5688", None), ("0.001", None), ("0.786", None), ("0.79", None), ("0.26", None),
     ("0.7855", None), ("0.785401", None), ("1e-5", None), ("1.5e-5", None)],
)  # fmt: skip
def test_angles_written_short(written: str, degrees: int | None, tmp_path: Path) -> None:
    """What stands for multiples of 15 degrees is taken for them, with a note; calibrated angles stay as they are."""
    angle = float(written) if degrees is None else np.radians(degrees)
    (tmp_path / "arm.csv").write_text(f"j,a,mu,sigma,gamma,b,alpha,d,theta,r\n1,0,1,0,0,0,{written},0,0,0\n")
    robot = load_robot(tmp_path / "arm.csv")
    assert robot.joints[0].placement.alpha == pytest.approx(angle, abs=1e-15)
    assert len(robot.notes) == (degrees is not None)
    origin = f'<origin xyz="0 0 0" rpy="{written} 0 0"/>'
    (tmp_path / "arm.urdf").write_text(arm(HINGE.format(origin)))
    robot = load_robot(tmp_path / "arm.urdf")
    assert robot.joints[0].placement.rpy == pytest.approx((angle, 0.0, 0.0), abs=1e-15)
    assert len(robot.notes) == (degrees is not None)
    robot = read(f"robot: r\njoints:\n  j: {{antecedent: ground, alpha: {written}, theta: q}}\n", tmp_path)
    assert robot.joints[0].placement.alpha == pytest.approx(angle, abs=1e-15)
    assert len(robot.notes) == (degrees is not None)


@pytest.mark.parametrize("key", ["alpha: 90", "gamma: -45", "theta: q + 180", "theta: q, home: 30"])
def test_angles_in_degrees_are_refused(key: str, tmp_path: Path) -> None:
    keys = key if "theta" in key else f"{key}, theta: q"
    with pytest.raises(GtauError, match=r"line \d+, joints.j.*write deg\(...\) where these are degrees, such as deg\("):
        read(f"robot: r\njoints:\n  j: {{antecedent: ground, {keys}}}\n", tmp_path)


def test_prefixes_that_are_declared_nowhere_do_no_harm(tmp_path: Path) -> None:
    plugin = "<gazebo><controller:camera name='c'/></gazebo></robot>"
    (tmp_path / "arm.urdf").write_text(arm(HINGE.format("")).replace("</robot>", plugin))
    assert load_robot(tmp_path / "arm.urdf").actuated == ("j",)
    (tmp_path / "arm.urdf").write_text(arm(HINGE.format("")).replace("</robot>", "<xacro:arm/></robot>"))
    with pytest.raises(GtauError, match="holds xacro macros; end its name"):
        load_robot(tmp_path / "arm.urdf")


@pytest.mark.parametrize(("word", "strength"), [("moon", 1.62), ("none", 0.0)])
def test_gravity_may_be_a_word(word: str, strength: float, tmp_path: Path) -> None:
    arm = "robot: r\njoints:\n  j: {antecedent: ground, d: 0.3, theta: q, actuated: true}\n"
    (tmp_path / "robot.yaml").write_text(f"{arm}gravity: {word}\n")
    assert np.linalg.norm(load_robot(tmp_path / "robot.yaml").gravity) == strength
    assert RobotSource(file="ur10e", gravity=word).gravity == load_robot(tmp_path / "robot.yaml").gravity
