"""What a user is shown of a robot before it is identified: the payload's body, limits, gravity, oddities, a picture."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import CHI, GAINS, STEEL, Plant

from gtau import identify
from gtau.estimation.estimators.maximum_likelihood import ML
from gtau.estimation.regression.dataset import reduce_runs
from gtau.model.base_parameters import BaseParameters, base_parameters
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.report.chart import Shape, Word
from gtau.report.charts import robot_figure
from gtau.report.robot import robot_document, robot_page
from gtau.report.robot_figure import scene_of, sketch_of
from gtau.report.terminal import plain
from gtau.robots.geometry import float_base, oddities, tool_note
from gtau.robots.readers.native import native_text, parse_native
from gtau.robots.readers.read import catalog_names
from gtau.robots.robot import GROUND, Joint, Limits, Mdh, Robot
from gtau.signals.reading.statements import Payload

# A coupling bar stands last in the file, so the payload is taken to sit on it.
BAR_ARM = """\
robot: bar-arm
joints:
  shoulder: {antecedent: ground, alpha: pi/2, theta: q, actuated: true, home: deg(60)}
  forearm: {antecedent: shoulder, d: 0.3, theta: q, home: deg(-80)}
  crank: {antecedent: ground, alpha: pi/2, theta: q, actuated: true, home: deg(160)}
  bar: {antecedent: crank, d: 0.15, theta: q, home: deg(-100)}
closures:
  - connect: [{body: bar, d: 0.3}, {body: forearm, d: -0.15}]
"""


def derived(robot: Robot) -> tuple[InverseDynamics, BaseParameters]:
    model = InverseDynamics(robot)
    return model, base_parameters(model)


def slide(**more) -> Robot:
    return Robot("slide", (Joint("1", GROUND, "prismatic", **more),))


def turn(**more) -> Robot:
    return Robot("turn", (Joint("1", GROUND, "revolute", **more),))


# The body that carries the payload


def test_the_payload_is_where_the_robot_file_says() -> None:
    five_bar = load_robot("five-bar")
    steel_on_left = CHI | {
        f"{kind}_left_forearm": CHI.get(f"{kind}_left_forearm", 0.0) + value for kind, value in STEEL.items()
    }
    loaded = replace(Plant(chi=steel_on_left).run("loaded", seed=1), payload=Payload(name="steel", mass=STEEL["m"]))
    runs = [Plant().run("free"), loaded]
    right = identify(replace(five_bar, named_tool="left_forearm"), runs)
    assert "Payload  on 'left_forearm'" in right.summary()
    np.testing.assert_allclose(right.gains, GAINS, rtol=2e-3)
    wrong = reduce_runs(replace(five_bar, named_tool="right_forearm"), runs).system()
    assert np.abs(ML.fit(wrong).gains / GAINS - 1).max() > 0.05


def test_a_tool_that_nobody_named_is_said() -> None:
    robot = parse_native(BAR_ARM, "bar.yaml")
    assert robot.tool == "bar"
    (note,) = tool_note(robot)
    assert note.startswith("the payload is assumed to be on 'bar'")
    assert "tool: BODY" in note
    assert note in " ".join(plain(robot_page(*derived(robot))).split())
    named = parse_native(BAR_ARM + "tool: forearm\n", "bar.yaml")
    assert (named.tool, tool_note(named)) == ("forearm", ())
    assert parse_native(native_text(named), "again.yaml") == named != robot
    # two fingers, of which only one can carry it
    hand = Robot("hand", tuple(Joint(name, "ground", "prismatic") for name in ("left", "right")))
    assert len(tool_note(hand)) == 1


def branched(*chains: str, floating: str = "") -> Robot:
    """Joints by the chains in which they stand, such as ``a b c``, which begin on the ground."""
    carriers = {joint: before for chain in chains for before, joint in pairwise(["ground", *chain.split()])}
    robot = Robot("branched", tuple(Joint(joint, before, "revolute") for joint, before in carriers.items()))
    return float_base(robot, floating) if floating else robot


def test_a_payload_is_on_what_carries_the_fingers() -> None:
    fingers = [f"1 2 3 4 5 6 f{k}a f{k}b" for k in range(3)]
    hand = branched(*fingers, "1 2 3 4 5 6 thumb")
    assert branched("1 2 3 4 5 6 thumb", *fingers).tool == "6"
    assert hand.tool == "6"
    assert "on '6', which carries the fingers" in tool_note(hand)[0]
    assert replace(hand, named_tool="thumb").tool == "thumb"
    assert branched("1 2 3 4 5 6 f", "1 2 3 4 5 6 g").tool == "6"
    # not fingers: a rod beside a wrist, the arms of a torso, the legs of a dog
    assert branched("1 2 rod", "1 2 3 4 5").tool == "5"
    assert branched("waist l1 l2 l3", "waist r1 r2 r3").tool == "r3"
    assert branched(*(f"h{k} t{k} s{k}" for k in range(4)), floating="trunk").tool == "s3"


def test_what_takes_long_is_said() -> None:
    """Of a robot of many joints the equations and the counting take minutes."""
    said: list[tuple[str, int, int]] = []
    base_parameters(InverseDynamics(load_robot("five-bar")), progress=lambda *stage: said.append(stage))
    stages = list(dict.fromkeys(stage for stage, *_ in said))
    assert stages == [
        "deriving the equations of 4 joints",
        "compiling the equations of 4 joints",
        "counting base parameters",
    ]
    assert all(done < total for _, done, total in said)


@pytest.mark.parametrize("name", catalog_names())
def test_nothing_is_odd_in_the_catalog(name: str) -> None:
    robot = load_robot(name)
    assert tuple(oddities(robot)) == tool_note(robot) == ()


# Oddities


@pytest.mark.parametrize(
    ("robot", "note"),
    [
        (turn(limits=Limits((-130.0, 130.0))), "position limits of many turns: joint '1' (-130 to 130 rad);"),
        (turn(placement=Mdh(d=350.0)), "joint '1' is placed 350 m away: lengths are in m, so check whether"),
        (slide(limits=Limits((-100.0, 66.0))), "the position limits of joint '1' are -100 to 66 m: lengths are in m"),
        (
            turn(limits=Limits((-3.0, -0.1))),
            "home lies outside the position limits of joint '1' (0 rad, limits -3 to -0.1 rad); write a 'home' within",
        ),
    ],
    ids=["degrees", "mm", "travel in mm", "home outside"],
)  # fmt: skip
def test_what_is_hardly_meant_is_noted(robot: Robot, note: str) -> None:
    (found,) = oddities(robot)
    assert found.startswith(note)
    assert found in robot_document(*derived(robot))["notes"]


@pytest.mark.parametrize(
    "robot",
    [
        turn(limits=Limits((-4 * np.pi, 4 * np.pi))),
        turn(limits=Limits((0.0, 1.0))),  # home on a limit
        turn(limits=Limits((-300.0, 300.0)), parameters="drive"),  # a shaft before its gear
        slide(placement=Mdh(r=19.0), limits=Limits((-10.0, 10.0))),  # a crane
    ],
)
def test_what_may_well_be_meant_is_not_noted(robot: Robot) -> None:
    assert tuple(oddities(robot)) == ()


def test_identification_says_what_is_odd_in_the_robot() -> None:
    five_bar = load_robot("five-bar")
    forearm = replace(five_bar.joints[1], limits=Limits((-130.0, 130.0)))
    robot = replace(five_bar, joints=(five_bar.joints[0], forearm, *five_bar.joints[2:]), named_tool="")
    loaded = replace(Plant().run("loaded", payload=STEEL, seed=1), payload=Payload(name="steel", mass=STEEL["m"]))
    notes = list(map(str, identify(robot, [Plant().run("free"), loaded]).notes))
    assert any(note.startswith("robot 'five-bar': position limits of many turns") for note in notes)
    assert any(note.startswith("robot 'five-bar': the payload is assumed to be on 'right_forearm'") for note in notes)


# The page


def test_page_shows_gravity_limits_and_the_payload() -> None:
    model, base = derived(load_robot("five-bar"))
    found = robot_document(model, base)
    assert json.loads(json.dumps(found))["payload_on"] == "right_forearm"
    assert found["gravity"] == [0.0, 0.0, -9.80665]
    limits = found["joints"][0]["limits"]
    assert limits == {"position": (np.pi / 2, np.deg2rad(150)), "velocity": 6, "acceleration": 100, "effort": 30}
    assert "mx_left_forearmR" not in plain(robot_page(model, base))
    assert "25 base parameters of" in plain(robot_page(model, base))
    page = plain(robot_page(model, base, verbose=True))
    assert "[0, 0, -9.80665] m/s2 in base axes" in page
    assert re.search(r"payload on +right_forearm", page)
    assert re.search(r"mx_left_forearmR +kg m +mx_left_forearm \+ mx_right_forearm\n", page)
    assert found["base_parameters"]["units"]["fv_left"] == "N m s/rad"
    assert "1.571 to 2.618 rad" in page
    assert "-0.066 to 0.1 m" in plain(robot_page(*derived(load_robot("orthoglide"))))


def test_a_motor_keeps_its_own_base_parameters() -> None:
    base = base_parameters(InverseDynamics(parse_native(BAR_ARM, "bar.yaml")))
    kept = {kind: [name for name in base.standard if name.startswith(kind)] for kind in ("off_", "zz_", "fv_")}
    assert kept["off_"] == ["off_shoulder", "off_crank"]
    assert kept["zz_"] == ["zz_shoulder", "zz_crank"]
    assert {"fv_shoulder", "fv_crank"} < set(base.names)
    for motor, other in (("shoulder", "crank"), ("crank", "shoulder")):
        assert f"off_{other}" not in base.regroupings[f"off_{motor}R"]


# The picture


def texts(robot: Robot) -> list[str]:
    from matplotlib.text import Text

    return [words.get_text() for words in robot_figure(robot).findobj(Text)]


def test_picture_names_motors_payload_and_gravity() -> None:
    said = texts(load_robot("ur10e"))
    assert {"gravity", "base", "link", "motor, turns", "payload on wrist_3_joint", "elbow_joint"} < set(said)
    assert "gravity" not in texts(replace(load_robot("ur10e"), gravity=(0.0, 0.0, 0.0)))
    said = texts(load_robot("orthoglide"))
    assert {"travel", "closes a loop", "payload on P", "11", "12", "13"} < set(said)


def test_gravity_points_down_the_page_or_into_it() -> None:
    def extent(name: str) -> np.ndarray:
        strokes = [item.points for item in sketch_of(load_robot(name)).items if isinstance(item, Shape)]
        return np.ptp([points for points in strokes if points.shape == (5, 2)][-1], axis=0)

    assert extent("five-bar")[1] > 5 * extent("five-bar")[0]
    assert extent("3-rrr")[1] == pytest.approx(extent("3-rrr")[0])  # a cross: the plane of the robot is level
    assert "z" not in texts(load_robot("3-rrr"))


def test_words_of_the_picture_have_nine_pixels_on_a_telephone() -> None:
    sketch = sketch_of(load_robot("ur10e"))
    smallest = min(item.size for item in sketch.items if isinstance(item, Word) and item.text == "elbow_joint")
    assert 350 / sketch.size[0] * smallest > 9


def test_the_last_link_is_drawn_to_its_centre_of_mass() -> None:
    robot = load_robot("ur10e")
    bare, last = dict(scene_of(robot).lines), robot.tool
    stated = (("m_" + last, 2.0), ("mz_" + last, 0.2))
    line = dict(scene_of(replace(robot, file=replace(robot.file, inertias=stated))).lines)[last]
    assert last not in bare
    assert np.linalg.norm(line[1] - line[0]) == pytest.approx(0.1)


def test_picture_explains_only_what_it_shows() -> None:
    assert "link" not in texts(load_robot("emps"))  # a carriage on a rail


@pytest.mark.parametrize("name", ["gough-stewart", "ur10e", "palletiser", "orthoglide"])
def test_picture_hides_no_name_under_a_joint_or_another_name(name: str) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    robot = load_robot(name)
    figure = robot_figure(robot)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    (axes,) = figure.axes
    names = [text for text in axes.texts if set(text.get_text().split(", ")) <= robot.driven]
    assert sorted(", ".join(text.get_text() for text in names).split(", ")) == sorted(robot.driven)
    boxes = [text.get_window_extent(canvas.get_renderer()) for text in names]
    marks = axes.transData.transform([patch.get_xy()[:-1].mean(axis=0) for patch in axes.patches])
    whole = figure.bbox
    for k, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[:k])
        assert not any(box.contains(*mark) for mark in marks)
        assert whole.contains(box.x0, box.y0)
        assert whole.contains(box.x1, box.y1)


def arrows(name: str) -> list[np.ndarray]:
    """Arrows of positive directions, (K, 2) each, without their heads."""
    shapes = (item for item in sketch_of(load_robot(name)).items if isinstance(item, Shape))
    return [
        shape.points[:-3] for shape in shapes if shape.stroke == "c1" and not shape.closed and len(shape.points) > 2
    ]


@pytest.mark.parametrize(("name", "sense"), [("five-bar", 1.0), ("test-bench", -1.0), ("3-rrr", 1.0)])
def test_arrows_turn_as_the_joints_do(name: str, sense: float) -> None:
    """About axes towards the reader counter-clockwise, about those away from the reader clockwise."""
    for arc in arrows(name):
        x, y = (arc - arc.mean(axis=0)).T
        assert sense * np.sum(x[:-1] * np.diff(y) - y[:-1] * np.diff(x)) > 100  # square points


def test_the_arrow_of_a_level_axis_is_level_and_points_where_it_slides() -> None:
    ((first, *_, last),) = arrows("emps")
    assert last[1] == pytest.approx(first[1])
    assert last[0] < first[0] - 10  # along -y, which points to the left: q is along z of a frame turned about x


@pytest.mark.parametrize("name", ["puma560", "staubli-tx40"])
def test_joints_that_meet_in_a_point_are_drawn_apart(name: str) -> None:
    scene = scene_of(load_robot(name))
    driven = [joint for joint in scene.joints if joint.name in scene.robot.driven]
    places = np.array([scene.on_page(scene.centre(joint)) for joint in driven])
    apart = np.linalg.norm(places[:, None] - places, axis=2)[np.triu_indices(len(driven), 1)]
    assert apart.min() > 10  # points
    for joint in driven:  # on their own axes
        axis = scene.frames[joint.name][0] @ np.array(joint.axis)
        assert np.linalg.norm(np.cross(scene.shifts.get(joint.name, 0 * axis), axis)) < 1e-9


def test_no_line_looks_like_a_strut() -> None:
    """The base of an Orthoglide has no spokes to its motors, that of a platform has."""

    def spokes(name: str) -> int:
        shapes = [item for item in sketch_of(load_robot(name)).items if isinstance(item, Shape)]
        return sum(shape.stroke == "measured" and np.ptp(shape.points, axis=0).max() > 20 for shape in shapes)

    assert spokes("orthoglide") == 0
    assert spokes("gough-stewart") == 6


@pytest.mark.parametrize("length", [3e-4, 0.03, 1.0, 350.0])
def test_picture_has_a_scale_in_any_size(length: float, tmp_path: Path) -> None:
    from gtau.report.charts import save_figure

    robot = Robot("r", (Joint("1", GROUND, "revolute"), Joint("2", "1", "revolute", Mdh(d=length))))
    (scale,) = [text for text in texts(robot) if text.endswith((" m", " mm"))]
    number, unit = scale.split()
    assert 0.05 * length < float(number) * {"m": 1.0, "mm": 1e-3}[unit] < 0.5 * length
    save_figure(robot_figure(robot), tmp_path / "r.png")
