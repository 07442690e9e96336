"""What logged poses say of a robot's geometry."""

from __future__ import annotations

from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from five_bar_logs import STEEL, TOOL, Plant, five_bar
from scipy.spatial.transform import Rotation

from gtau import identify, load_robot
from gtau.documents.validation import read_group
from gtau.errors import GtauError
from gtau.estimation.diagnostics.geometry import GeometryTest, to_document
from gtau.estimation.diagnostics.pose_fit import geometry_test
from gtau.findings import Grade
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.kinematics import frames
from gtau.model.lengths import variable_geometry
from gtau.report.html import html
from gtau.report.logs import check_page
from gtau.report.terminal import plain
from gtau.result import check, load
from gtau.robots.robot import GROUND, Joint, Mdh, Pose, Robot
from gtau.signals.reading.body_columns import PoseColumns
from gtau.signals.reading.columns import Signals
from gtau.signals.reading.logs import LoggedPoses, read_poses
from gtau.signals.reading.units import Units

NOISE = 1e-4  # m and rad


def longer(robot: Robot, joint: str, name: str, share: float) -> Robot:
    """The robot with one length of an MDH placement longer by a share."""
    placement = robot.joint(joint).placement
    assert isinstance(placement, Mdh)
    other = replace(placement, **{name: getattr(placement, name) * (1 + share)})
    return replace(
        robot, joints=tuple(replace(each, placement=other) if each.name == joint else each for each in robot.joints)
    )


def sines(robot: Robot, size: float, rng: np.random.Generator, samples: int = 1500) -> tuple[np.ndarray, np.ndarray]:
    """Time (N,) at 100 Hz and positions (N, n) of all motors around home."""
    model, time = InverseDynamics(robot), np.arange(samples) / 100
    home = model.layout.home if model.loops is None else model.loops.home
    q = np.tile(home[model.layout.actuated], (samples, 1))
    for k in range(q.shape[1]):
        for _ in range(3):
            q[:, k] += size / 3 * np.sin(rng.uniform(0.3, 2.0) * time + rng.uniform(0, 6))
    return time, q


def logged(
    robot: Robot,
    time: np.ndarray,
    q: np.ndarray,
    rng: np.random.Generator,
    delay: float = 0.0,
    tracker: tuple[Rotation, np.ndarray] = (Rotation.identity(), np.zeros(3)),
    marker: tuple[Rotation, np.ndarray] = (Rotation.identity(), np.zeros(3)),
) -> LoggedPoses:
    """Poses of the tool as quaternions, computed for one robot after the other and not by derivatives."""
    model = InverseDynamics(robot)
    late = np.stack([np.interp(time - delay, time, each) for each in q.T])
    c = ca.SX.sym("c", model.layout.n_c)
    at = frames(model.layout, c)[robot.tool]
    pose, values = ca.Function("pose", [c], [at.R_0, at.p_0]), []
    for R, p in ((R.full(), p.full().ravel()) for R, p in map(pose, model.path(late).T)):
        turned = tracker[0] * Rotation.from_matrix(R)
        turned_marker = Rotation.from_rotvec(NOISE * rng.standard_normal(3)) * turned * marker[0]
        position = tracker[0].apply(p) + turned.apply(marker[1]) + tracker[1] + NOISE * rng.standard_normal(3)
        values.append([*position, *turned_marker.as_quat(scalar_first=True)])
    return LoggedPoses("simulated", time, q, np.array(values))


def columns(source: str) -> PoseColumns:
    return PoseColumns.model_validate(
        {
            "source": source,
            "position": {axis: f"p{axis}" for axis in "xyz"},
            "quaternion": {axis: f"q{axis}" for axis in "wxyz"},
        }
    )


def result_of(robot: Robot, source: str, poses_of: LoggedPoses) -> GeometryTest:
    return geometry_test(InverseDynamics(robot), columns(source), robot.actuated, [poses_of])


@pytest.mark.parametrize("name", ["ur10e", "orthoglide"])
def test_derivatives_of_the_pose_by_each_constant(name: str, rng: np.random.Generator) -> None:
    """Against central differences of the pose with the loops closed anew."""
    robot = load_robot(name)
    geometry = variable_geometry(robot, robot.tool)
    _, q = sines(robot, 0.1, rng, 40)
    c, zero = InverseDynamics(robot).path(q.T.copy()), np.zeros(len(geometry.constants))
    at = geometry.pose(c, zero)
    for k in range(len(zero)):
        step = np.where(np.arange(len(zero)) == k, 1e-6, 0.0)
        ends = [geometry.close(c, zero, sign * step) for sign in (1.0, -1.0)]
        assert ends[0] is not None and ends[1] is not None  # noqa: PT018
        above, below = geometry.pose(ends[0], step), geometry.pose(ends[1], -step)
        linear = (above.position - below.position) / 2e-6
        angular = (Rotation.from_matrix(above.rotation) * Rotation.from_matrix(below.rotation).inv()).as_rotvec() / 2e-6
        assert np.hstack([linear, angular]) == pytest.approx(at.by_constants[:, :, k], abs=1e-8)


def test_constants_of_placements_in_coordinates() -> None:
    """Coordinates, and the distance that they make, each with its direction."""
    joints = Joint("a", GROUND, "revolute", Pose((0.3, -0.4, 0.0))), Joint("b", "a", "revolute", Pose((0.0, 0.2, 0.0)))
    geometry = variable_geometry(Robot("placed", joints), "b")
    moves = geometry.pose(np.zeros((2, 1)), np.zeros(len(geometry.constants))).by_constants[0, :3].T
    found = {constant.name: (constant.value, *move) for constant, move in zip(geometry.constants, moves, strict=True)}
    assert found["distance of 'a'"] == pytest.approx((0.5, 0.6, -0.8, 0.0))
    assert found["y of 'a'"] == pytest.approx((0.4, 0.0, -1.0, 0.0))
    assert found["y of 'b'"] == pytest.approx((0.2, 0.0, 1.0, 0.0))
    assert "distance of 'b'" not in found


@pytest.mark.parametrize(
    ("name", "joint", "length"),
    [("ur10e", "elbow_joint", "d"), pytest.param("orthoglide", "41", "d", marks=pytest.mark.slow)],
)
def test_a_length_one_per_cent_off(name: str, joint: str, length: str, rng: np.random.Generator) -> None:
    """The controller's pose confirms the right length, and finds one that is wrong by 1 %."""
    right = load_robot(name)
    time, q = sines(right, 0.8 if name == "ur10e" else 0.1, rng)
    found = logged(right, time, q, rng)
    confirmed = result_of(right, "controller", found)
    assert confirmed.outcome == "confirmed"
    assert confirmed.distances["position"][0] == pytest.approx(NOISE * np.sqrt(3), rel=0.1)
    wrong = result_of(longer(right, joint, length, 0.01), "controller", found)
    assert wrong.outcome == "other constants"
    (change,) = wrong.explained_by
    true = getattr(right.joint(joint).placement, length)
    assert f"{length} of '{joint}'" in (change.name, *change.alike)
    assert change.value + change.change == pytest.approx(true, abs=4 * change.std)
    assert change.std < 1e-4
    assert change.share > 0.9
    assert wrong.distances["position"][1] == pytest.approx(NOISE * np.sqrt(3), rel=0.1)


def test_a_tracker_anywhere_with_a_marker_anywhere(rng: np.random.Generator) -> None:
    """Frames and delay are nuisances: the right geometry is confirmed, a wrong one found, with intervals that hold."""
    right = load_robot("ur10e")
    time, q = sines(right, 0.8, rng)
    tracker = Rotation.from_rotvec([0.4, -1.9, 0.8]), np.array([2.0, -3.0, 1.2])
    marker = Rotation.from_rotvec([1.2, 0.3, -0.7]), np.array([0.05, 0.02, 0.1])
    found = logged(right, time, q, rng, 0.02, tracker, marker)
    confirmed = result_of(right, "tracker", found)
    assert confirmed.outcome == "confirmed"
    assert confirmed.delay[0] == pytest.approx(0.02, abs=1e-3)
    assert "shoulder_height, r of 'shoulder_pan_joint'" in confirmed.unseen  # the tracker may stand higher instead
    wrong = result_of(longer(right, "wrist_1_joint", "d", 0.01), "tracker", found)
    (change,) = wrong.explained_by
    assert change.name == "d of 'wrist_1_joint'"
    assert change.value + change.change == pytest.approx(0.571, abs=4 * change.std)
    taken_for_the_base = result_of(right, "controller", found)
    assert taken_for_the_base.outcome == "unexplained"
    assert "source: tracker" in str(taken_for_the_base.note)


def test_a_tool_of_unknown_place(rng: np.random.Generator) -> None:
    """A TCP as rotation vector, as Universal Robots log it: where it sits on the flange is a nuisance."""
    right = load_robot("ur10e")
    time, q = sines(right, 0.8, rng)
    place = Rotation.from_rotvec([0.0, 0.4, 1.0]), np.array([0.01, -0.03, 0.2])
    found = logged(right, time, q, rng, marker=place)
    turned = Rotation.from_quat(found.values[:, 3:], scalar_first=True).as_rotvec()
    vectors = replace(found, values=np.hstack([found.values[:, :3], turned]))
    positions = {axis: f"p{axis}" for axis in "xyz"}
    of_tool = PoseColumns(source="tool", position=positions, rotation_vector=("rx", "ry", "rz"))
    for robot, names in ((right, []), (longer(right, "elbow_joint", "d", 0.01), ["d of 'elbow_joint'"])):
        result = geometry_test(InverseDynamics(robot), of_tool, robot.actuated, [vectors])
        assert [change.name for change in result.explained_by] == names
        assert result.distances["position"][1] == pytest.approx(NOISE * np.sqrt(3), rel=0.1)
        assert "wrist_2_offset, r of 'wrist_2_joint'" not in result.unseen
        assert "zero of 'wrist_3_joint'" in result.unseen  # the tool may be turned instead
    assert result_of(right, "controller", found).outcome == "unexplained"


def test_an_encoder_zero_is_found_as_such(rng: np.random.Generator) -> None:
    """A joint whose zero is off by 0.01 rad is not taken for a length."""
    robot = load_robot("ur10e")
    time, q = sines(robot, 0.8, rng)
    found = logged(robot, time, q, rng)
    off = replace(found, q=q - 0.01 * (np.array(robot.actuated) == "elbow_joint"))
    (change,) = result_of(robot, "controller", off).explained_by
    assert change.name == "zero of 'elbow_joint'"
    assert change.change == pytest.approx(0.01, abs=4 * change.std)


@pytest.mark.parametrize(
    ("robot_constants", "source", "kind", "largest", "true"),
    [
        ({}, "controller", "x", 1e-4, None),
        pytest.param({}, "tracker", "mocap", 2e-3, None, marks=pytest.mark.slow),
        ({"Rm": 0.326}, "controller", "x", None, 0.3),
        pytest.param({"Rm": 0.326}, "tracker", "mocap", None, 0.3, marks=pytest.mark.slow),
    ],
)
def test_real_parallel_robot(
    shared, tmp_path, robot_constants: dict[str, float], source: str, kind: str, largest: float | None, true: float
) -> None:
    """The logged pose of a real robot confirms its geometry, and finds a platform that is 26 mm too large."""
    folder = shared / "upv_parallel"
    text = (folder / "robot_5p_config1.yaml").read_text()
    for name in robot_constants:
        assert f"{name}: 0.3," in text
        text = text.replace(f"{name}: 0.3,", f"{name}: {robot_constants[name]},")
    (tmp_path / "robot.yaml").write_text(text)
    joints = {"p1": "q0", "p2": "q1", "p3": "q2", "p4": "q3"}
    signals = read_group(
        Signals,
        "signals",
        {
            "time": "t",
            "position": joints,
            "torque": {"p1": "u0", "p2": "u1", "p3": "u2", "p4": "u3"},
            "pose": {
                "source": source,
                "position": {"x": f"{kind}0", "z": f"{kind}1"},
                "angles": {"sequence": "YZ", "columns": [f"{kind}2", f"{kind}3"]},
            },
        },
    )
    found = [read_poses([folder / f"4dof_N_{run}.csv"], signals, Units()) for run in "abc"]
    model = InverseDynamics(load_robot(tmp_path / "robot.yaml"))
    result = geometry_test(model, signals.pose, signals.joints, found)
    if largest is not None:
        assert result.outcome == "confirmed"
        assert result.distances["position"][0] < largest
    else:
        (change,) = result.explained_by
        assert change.name.startswith("Rm at all 3 places")
        assert change.value + change.change == pytest.approx(true, abs=5 * change.std)
        assert change.std < 1e-3


def test_refused_columns() -> None:
    """Contradictory descriptions of a pose are refused in a sentence."""
    signals = {"time": "t", "position": {"1": "a"}, "torque": {"1": "b"}}
    for pose, words in (
        ({"source": "controller"}, "a pose needs columns"),
        ({"source": "controller", "angles": {"sequence": "YZ", "columns": ["c"]}}, "has 2 angles, but 1 columns"),
        ({"source": "controller", "angles": {"sequence": "YY", "columns": ["c", "d"]}}, "repeats an axis"),
        ({"source": "controller", "position": {"x": "c", "y": "c"}}, "given twice"),
        ({"source": "elsewhere", "position": {"x": "c"}}, "'controller'"),
    ):
        with pytest.raises(GtauError, match=words):
            read_group(Signals, "signals", signals | {"pose": pose})
    with pytest.raises(GtauError, match="not a unit of length"):
        read_group(Units, "units", {"pose": {"length": "deg"}})


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Logs of a five-bar with the position (mm) and angle (deg) of its tool, and files of it with other forearms."""
    folder, layout = tmp_path_factory.mktemp("pose"), five_bar().layout
    c = ca.SX.sym("c", layout.n_c)
    at = frames(layout, c)[TOOL]
    pose = ca.Function(
        "pose", [c], [1e3 * at.p_0[0], 1e3 * at.p_0[2], 180 / np.pi * ca.atan2(at.R_0[0, 1], at.R_0[0, 0])]
    )
    for name, payload in (("free", None), ("loaded", STEEL)):
        run = Plant(noise=0.02).run(name, payload=payload)
        found = np.array([pose(each) for each in five_bar().path(run.position.T.copy()).T], dtype=float)[:, :, 0, 0]
        table = np.column_stack([run.time, run.position, run.command, found])
        np.savetxt(folder / f"{name}.csv", table, "%.7f", ",", header="t,q1,q2,v1,v2,x,z,angle", comments="")
    text = (files("gtau") / "robots" / "catalog" / "five-bar.yaml").read_text(encoding="utf-8")
    assert "l2: 0.35 " in text
    (folder / "right.yaml").write_text(text)
    (folder / "wrong.yaml").write_text(text.replace("l2: 0.35 ", "l2: 0.355 "))
    return folder


def described(folder: Path, robot: str) -> Path:
    path = folder / f"{robot}-experiment.yaml"
    path.write_text(
        f"""robot: {robot}.yaml
signals:
  time: t
  position: {{left: q1, right: q2}}
  current: {{left: v1, right: v2}}
  pose: {{source: controller, position: {{x: x, z: z}}, angles: {{sequence: Y, columns: [angle]}}}}
units: {{pose: {{length: mm, angle: deg}}}}
runs:
  - {{log: free.csv}}
  - {{log: loaded.csv, payload: {{name: steel, mass: 1.2}}}}
"""
    )
    return path


def test_check_says_what_poses_say(folder: Path) -> None:
    """In the page, in its document, in the report and as a graded finding."""
    confirmed = check(described(folder, "right"))
    assert confirmed.geometry is not None
    assert confirmed.geometry.outcome == "confirmed"
    assert confirmed.geometry.note.severity == Grade.INFORMATION
    wrong = check(described(folder, "wrong"))
    (change,) = wrong.geometry.explained_by
    assert change.name == "l2 at all 2 places"
    assert change.value + change.change == pytest.approx(0.35, abs=max(5 * change.std, 2e-6))
    assert wrong.geometry.note.severity == Grade.WARNING
    page = plain(check_page(wrong))
    assert "l2 at all 2 places 355 -> 350" in page
    assert "correct the robot file" in page
    assert [line for line in page.splitlines() if len(line) > 80] == []
    assert "Logged pose and geometry" in html(check_page(wrong))


def test_identify_says_what_poses_say(folder: Path) -> None:
    """In the summary, and in model.json, which holds all of it but the residuals in time."""
    result = identify(described(folder, "wrong"))
    assert result.geometry is not None
    assert result.notes[0] == result.geometry.note
    assert "the geometry is off: l2 at all 2 places" in " ".join(result.summary(verbose=False).split())
    result.save(folder / "model.json")
    again = load(folder / "model.json").geometry
    assert again is not None
    assert to_document(again) == to_document(result.geometry)
    assert again.tried == result.geometry.tried


def test_poses_that_are_not_there(folder: Path) -> None:
    """A column that is missing, a body that is none, and units of no pose are refused in a sentence."""
    path = described(folder, "right")
    text = path.read_text()
    for old, new, words in (
        ("[angle]", "[angel]", "did you mean 'angle'"),
        ("source: controller", "source: controller, body: hand", "names the body 'hand'"),
        ("  pose: {source", "  # pose: {source", "a unit of 'pose' is given"),
    ):
        assert old in text
        path.write_text(text.replace(old, new))
        with pytest.raises(GtauError, match=words):
            identify(path)
