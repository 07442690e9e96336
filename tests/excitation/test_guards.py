"""A design without limits keeps off the floor and itself, and says what it guessed; checked by MuJoCo and Pinocchio."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from gtau.errors import GtauError
from gtau.estimation.results.estimate import Estimate
from gtau.excitation.clearance import FLOOR, Capsule, bounding_capsule
from gtau.excitation.constraints import constraint_usages
from gtau.excitation.design import Design, check, excite
from gtau.excitation.design_file import read_design
from gtau.excitation.forecast import Outlook, sampled_run
from gtau.excitation.guards import speed_of_tool
from gtau.excitation.nlp import random_start
from gtau.excitation.prior import COULOMB, ERROR, ROTOR, VISCOUS, KnownGain, identified_gains
from gtau.excitation.task import DesignProblem, design_grid, evaluate
from gtau.findings import Finding, Grade
from gtau.report.design import design_page
from gtau.report.terminal import plain

ARM = """robot: arm
%s
joints:
  turret: {antecedent: ground, r: 0.35, theta: q, limits: {position: [-1, 1], velocity: 2, effort: 200}}
  arm: {antecedent: turret, alpha: pi/2, theta: q, limits: {position: [-2, 2], velocity: 2, effort: 200}}
  forearm: {antecedent: arm, d: 0.5, theta: q, home: 0.5, limits: {position: [-2.9, 2.9], velocity: 3, effort: 90}}
  wrist: {antecedent: forearm, d: 0.4, theta: q, limits: {position: [-2.9, 2.9], velocity: 3, effort: 30}}
"""
DESIGN = """robot: arm.yaml
rate: 200
period: 4
harmonics: 3
runs: [{payload: none}, {payload: {name: disc, mass: 2}}]
%s
"""
URDF = """<robot name="shaped">
<link name="base"><collision><geometry><box size="0.2 0.2 0.1"/></geometry></collision></link>
<link name="one"><collision><origin xyz="0 0 0.2" rpy="0.3 0 0.2"/><geometry><cylinder radius="0.05" length="0.4"/>
</geometry></collision></link>
<link name="two"><collision><origin xyz="0 0.1 0.2" rpy="0 0.5 0"/><geometry><mesh filename="package://shaped/two.obj"
 scale="0.1 0.1 0.3"/></geometry></collision></link>
<link name="tip"><collision><geometry><sphere radius="0.06"/></geometry></collision></link>
<joint name="a" type="revolute"><parent link="base"/><child link="one"/><origin xyz="0 0 0.1"/><axis xyz="1 0 0"/>
<limit lower="-2" upper="2" velocity="2" effort="50"/></joint>
<joint name="b" type="revolute"><parent link="one"/><child link="two"/><origin xyz="0 0 0.4"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" velocity="2" effort="50"/></joint>
<joint name="c" type="fixed"><parent link="two"/><child link="tip"/><origin xyz="0 0 0.45"/></joint></robot>"""
CUBE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nv 1 1 0\nv 1 0 1\nv 0 1 1\nv 1 1 1\nf 1 2 5\nf 4 6 8\nf 1 5 3\nf 4 8 7\n"


def written(folder: Path, more: str = "", robot: str = "") -> Path:
    (folder / "arm.yaml").write_text(ARM % robot)
    (folder / "design.yaml").write_text(DESIGN % more)
    return folder / "design.yaml"


def least_distance(designed: Design, names: list[str]) -> float:
    """Least distance by MuJoCo between all capsules of bodies that no joint joins, and from the plane of the floor."""
    clearance = designed.task.limits.clearance
    assert clearance is not None
    spec = mujoco.MjSpec()
    body, place = (
        spec.worldbody,
        {"turret": (0, 0, 0.35), "arm": (0, 0, 0), "forearm": (0.5, 0, 0), "wrist": (0.4, 0, 0)},
    )
    for name in ("ground", *names):
        if name != "ground":
            turn = (np.sqrt(0.5), np.sqrt(0.5), 0, 0) if name == "arm" else (1, 0, 0, 0)
            body = body.add_body(name=name, pos=place[name], quat=turn, mass=1, inertia=(1, 1, 1))
            body.add_joint(axis=(0, 0, 1))
        for k, shape in enumerate(clearance.shapes[name]):
            assert isinstance(shape, Capsule)
            ends = (*shape.start, *shape.end)
            if np.allclose(shape.start, shape.end):
                body.add_geom(
                    name=f"{name} {k}", type=mujoco.mjtGeom.mjGEOM_SPHERE, pos=shape.start, size=[shape.radius, 0, 0]
                )
            else:
                body.add_geom(
                    name=f"{name} {k}", type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=ends, size=[shape.radius, 0, 0]
                )
    model = spec.compile()
    data, least, height = mujoco.MjData(model), np.inf, clearance.shapes[FLOOR][0].height
    owners = [model.geom(k).name.split()[0] for k in range(model.ngeom)]
    chain = ["ground", *names]
    # 'ground' and 'arm' are joined by the turret, and their distance does not change
    pairs = [
        (i, j) for i, one in enumerate(owners) for j, other in enumerate(owners)
        if chain.index(other) > chain.index(one) + 1 and (one, other) != ("ground", "arm")
    ]  # fmt: skip
    moving = [k for k, owner in enumerate(owners) if owner not in ("ground", "turret")]
    halves = np.where(model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE, model.geom_size[:, 1], 0)
    _, joints = sampled_run(designed.task, designed.x)
    for q in joints[0].T[::4]:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        bottoms = data.geom_xpos[:, 2] - np.abs(data.geom_xmat[:, 8]) * halves - model.geom_size[:, 0]
        least = min(least, *(mujoco.mj_geomDistance(model, data, i, j, 9.0, None) for i, j in pairs))
        least = min(least, float(bottoms[moving].min()) - height)
    return float(least)


def test_a_bare_arm_keeps_off_the_floor_and_itself(tmp_path: Path) -> None:
    task, _ = read_design(written(tmp_path))
    assert task.limits.rates[0] == pytest.approx([1.6, 1.6, 2.4, 2.4])  # 80 %
    assert task.limits.torque == pytest.approx([160, 160, 72, 24])
    assert any(FLOOR in pair for pair in task.limits.clearance.pairs)
    designed = excite(task, starts=1)
    assert least_distance(designed, list(task.model.actuated)) >= task.limits.clearance.least - 1e-4
    assert Outlook(designed, {}).tool[0] <= 1.5
    lines = plain(design_page(Outlook(designed, {}))).splitlines()[:14]
    first = " ".join(lines)
    for words in ("The tool moves at up to", "m/s",
                  "Floor: guessed at z = 0 m of the base; state 'limits: {floor: HEIGHT}'",
                  "Self-collision: bodies are capsules, guessed about lines from joint to joint for",
                  "Limits: 80 % of the robot file's", "change with limits.share"):  # fmt: skip
        assert words in first


def test_without_guards_the_same_arm_crashes(tmp_path: Path) -> None:
    guarded, _ = read_design(written(tmp_path))
    bare, _ = read_design(written(tmp_path, "limits: {shapes: none, floor: none, share: 1}"))
    assert bare.limits.clearance is None
    assert bare.guards[1] == "self-collision: not checked, as 'limits.shapes: none' says"
    x = random_start(bare, np.random.default_rng(0), 0.99)
    assert x is not None
    over = [usage.what for usage in check(replace(bare, limits=guarded.limits), x) if usage.excess > 1]
    assert any(FLOOR in what for what in over)


@pytest.mark.parametrize("robot", ["orthoglide", "five-bar"])
def test_closed_loops_are_neither_guessed_nor_forbidden(robot: str, tmp_path: Path) -> None:
    path = tmp_path / "design.yaml"
    path.write_text((DESIGN % "").replace("arm.yaml", robot))
    task, _ = read_design(path)
    assert task.limits.clearance is None
    assert task.guards[0].startswith("floor: none guessed")
    assert task.guards[1].startswith("self-collision: not checked")
    assert all("state " in said for said in task.guards[:2])


def test_a_stated_floor_is_kept_whatever_is_said_of_shapes(tmp_path: Path) -> None:
    """Distances from the floor equal the guard with all bodies, and the lowest body of the arm stays above it."""
    full, _ = read_design(written(tmp_path, "limits: {floor: 0.0}"))
    task, _ = read_design(written(tmp_path, "limits: {floor: 0.0, shapes: none}"))
    kept = task.limits.clearance
    assert {body for pair in kept.pairs for body in pair} == {FLOOR, "arm", "forearm", "wrist"}
    assert task.guards[0] == "floor: 0 m along z of the base, as stated"
    c = np.array([[0.0, 0.0], [-0.9, 0.9], [0.0, 0.0], [0.0, 0.0]])  # 0.9 m long and 0.35 m high, it dives and rises
    distances = {body: kept.nearest(c, (FLOOR, body)).distance for body in ("arm", "forearm", "wrist")}
    for body, distance in distances.items():
        assert distance == pytest.approx(full.limits.clearance.nearest(c, (FLOOR, body)).distance)
    assert distances["wrist"][0] < 0.35 - 0.9 * np.sin(0.9) < 0.9 < distances["wrist"][1]


def test_links_of_closed_loops_keep_off_a_stated_floor(tmp_path: Path) -> None:
    """Of their shapes nothing is guessed but the lines between their joints."""
    path = tmp_path / "design.yaml"
    path.write_text((DESIGN % "limits: {floor: -1.2}").replace("arm.yaml", "delta"))
    task, _ = read_design(path)
    assert task.limits.clearance is not None
    assert all(FLOOR in pair for pair in task.limits.clearance.pairs)
    assert task.model.robot.tool in {body for pair in task.limits.clearance.pairs for body in pair}
    assert "lines from joint to joint without thickness" in task.guards[0]
    path.write_text(path.read_text().replace("-1.2", "-0.5"))
    with pytest.raises(
        GtauError, match=r"m above the floor at rest \(limits.floor: -0.5\), less than limits.clearance"
    ):
        read_design(path)


def test_a_body_that_rests_close_to_a_stated_floor_is_not_left_out(tmp_path: Path) -> None:
    """The guess of its thickness gives way, not the floor."""
    robot = (ARM % "").replace("r: 0.35", "r: 0.04")
    written(tmp_path, "limits: {floor: 0.0}")
    (tmp_path / "arm.yaml").write_text(robot)
    task, _ = read_design(tmp_path / "design.yaml")
    clearance = task.limits.clearance
    assert (FLOOR, "arm") in clearance.pairs
    assert "'arm', 'forearm' taken thinner than guessed" in task.guards[0]
    rest = np.array([[0.0], [0.0], [0.5], [0.0]])
    assert clearance.nearest(rest, (FLOOR, "arm")).distance >= clearance.least


def test_the_tool_is_no_faster_than_its_limit(tmp_path: Path) -> None:
    """Stated, or allowed by the maker, or 1.5 m/s; kept by approaches, which begin as fast as joints may."""
    limits = {"": 1.5, "limits: {tool_speed: 0.3}": 0.3}
    for more, limit in limits.items():
        task, _ = read_design(written(tmp_path, more))
        assert task.limits.tool_speed == limit
        assert any(said.startswith(f"tool: at most {limit:g} m/s") for said in task.guards)
    x = np.zeros((4, 5))
    x[1, 0] = 0.7  # lifts the arm, and does not move there
    time, joints = sampled_run(task, x.ravel())
    place = task.tool[0](joints[0])
    speed = np.linalg.norm(np.gradient(place, time, axis=1), axis=0).max()
    assert 0.2 < speed <= 0.3
    used = {usage.what: usage for usage in check(task, x.ravel())}["speed of the tool's frame"]
    assert used.excess * 0.3 == pytest.approx(speed, rel=0.01)
    assert speed_of_tool(replace(task.model.robot, name="Panda_hand"), None) == (
        1.7,
        "tool: at most 1.7 m/s, which the maker of 'Panda_hand' allows; state limits.tool_speed",
    )
    assert speed_of_tool(replace(task.model.robot, name="kinova_gen3"), None)[0] == 0.5


def test_floors_that_make_no_sense_are_not_guessed(tmp_path: Path) -> None:
    hanging, _ = read_design(written(tmp_path, "rest: {arm: -1.5}"))
    assert "reaches below z = 0 of the base; state" in hanging.guards[0]
    assert not any(FLOOR in pair for pair in hanging.limits.clearance.pairs)
    ceiling, _ = read_design(written(tmp_path, robot="gravity: [0, 0, 9.81]"))
    assert "the plane of its mounting: the position of the real floor is unknown" in ceiling.guards[0]
    stated, _ = read_design(written(tmp_path, "limits: {floor: -0.5}"))
    assert stated.guards[0] == "floor: -0.5 m along z of the base, as stated"
    assert stated.limits.clearance.shapes[FLOOR][0].height == -0.5
    none, _ = read_design(written(tmp_path, "limits: {floor: none}"))
    assert none.guards[0] == "floor: not checked, as 'limits: {floor: none}' says"


def test_a_robot_that_moves_in_the_base_plane_has_no_floor(tmp_path: Path) -> None:
    (tmp_path / "arm.yaml").write_text(
        """robot: planar
joints:
  one: {antecedent: ground, theta: q, limits: {position: [-2, 2], velocity: 2, effort: 20}}
  two: {antecedent: one, d: 0.4, theta: q, limits: {position: [-2, 2], velocity: 2, effort: 20}}
  slide: {antecedent: two, d: 0.3, alpha: pi/2, r: q, limits: {position: [-0.2, 0.2], velocity: 2, effort: 20}}
"""
    )
    (tmp_path / "design.yaml").write_text(DESIGN % "")
    task, _ = read_design(tmp_path / "design.yaml")
    assert task.guards[0].startswith("floor: none guessed, as no body that moves up or down has a shape")


def test_capsules_enclose_the_shapes_of_a_file(tmp_path: Path, rng: np.random.Generator) -> None:
    """Distances of capsules are never more than those that Pinocchio finds between the shapes themselves."""
    (tmp_path / "two.obj").write_text(CUBE)
    (tmp_path / "arm.urdf").write_text(URDF)
    (tmp_path / "design.yaml").write_text((DESIGN % "").replace("arm.yaml", "arm.urdf"))
    task, _ = read_design(tmp_path / "design.yaml")
    assert task.guards[1].endswith("about the robot file's shapes for ground, a, b; state limits.shapes")
    (pair,) = (pair for pair in task.limits.clearance.pairs if pair == ("ground", "b"))
    model = pin.buildModelFromUrdf(str(tmp_path / "arm.urdf"))
    (tmp_path / "pin.urdf").write_text(URDF.replace("package://shaped/", f"{tmp_path}/"))
    geometry = pin.buildGeomFromUrdf(model, str(tmp_path / "pin.urdf"), pin.GeometryType.COLLISION)
    index = {entry.name: k for k, entry in enumerate(geometry.geometryObjects)}
    for name in ("two_0", "tip_0"):
        geometry.addCollisionPair(pin.CollisionPair(index["base_0"], index[name]))
    data, shape_data = model.createData(), pin.GeometryData(geometry)
    c = rng.uniform(-2, 2, (2, 50))
    ours = task.limits.clearance.nearest(c, pair).distance
    for k in range(50):
        pin.computeDistances(model, data, geometry, shape_data, c[:, k])
        true = min(entry.min_distance for entry in shape_data.distanceResults)
        assert ours[k] <= true + 1e-6
        assert ours[k] > true - 0.25


def test_a_capsule_bounds_points(rng: np.random.Generator) -> None:
    for spread in ((1, 1, 1), (3, 1, 0.2), (0, 0, 0), (1, 0, 0)):
        points = rng.normal(size=(30, 3)) * spread + [1, 2, 3]
        enclosing = bounding_capsule(points)
        line = enclosing.end - enclosing.start
        part = np.clip((points - enclosing.start) @ line / max(line @ line, 1e-300), 0, 1)
        assert np.linalg.norm(points - enclosing.start - part[:, None] * line, axis=1).max() <= enclosing.radius + 1e-9


def level(folder: Path, effort: int) -> DesignProblem:
    """Return the task of an arm that rests stretched out level, and holds 8 kg with about 95 N m there."""
    path = written(folder, "limits: {shapes: none, share: 1}\nrest: {forearm: 0}")
    path.write_text(path.read_text().replace("mass: 2", "mass: 8"))
    arm = (folder / "arm.yaml").read_text()
    (folder / "arm.yaml").write_text(
        arm.replace("velocity: 2, effort: 200}}\n  f", f"velocity: 5, effort: {effort}}}}}\n  f")
    )
    return read_design(path)[0]


def test_an_approach_is_as_slow_as_its_torques_ask_for(tmp_path: Path) -> None:
    x = np.zeros((4, 5))
    x[1, 0] = 0.5  # lifts the arm
    torques = [
        {usage.what: usage.excess for usage in check(task, x.ravel())}["torque of joint 'arm' with payload 'disc'"]
        * effort
        for effort in (125, 400)
        for task in [level(tmp_path, effort)]
    ]
    assert torques[0] <= 125 < torques[1]  # the second one is free to be fast


def test_a_pose_at_rest_that_exceeds_a_limit_is_refused_before_a_search(tmp_path: Path) -> None:
    with pytest.raises(GtauError, match="torque of joint 'arm' with payload 'disc' must be at most 80 N m"):
        excite(level(tmp_path, 80), progress=lambda *_: pytest.fail("searched"))


HEAVY = """<inertial><origin xyz="0 0.05 %g" rpy="0.2 0 0.1"/><mass value="%g"/>
<inertia ixx="0.3" ixy="0.01" ixz="0" iyy="0.25" iyz="0.02" izz="0.1"/></inertial>"""


def test_torques_are_limited_with_the_inertias_of_the_file(tmp_path: Path) -> None:
    """They are Pinocchio's by a margin, with friction and rotors of the effort limits; predictions have no margin."""
    text = URDF.replace('<link name="one">', f'<link name="one">{HEAVY % (0.2, 12)}')
    text = text.replace('<link name="two">', f'<link name="two">{HEAVY % (0.3, 8)}')
    text = text.replace('<link name="tip">', f'<link name="tip">{HEAVY % (0.05, 2)}')
    (tmp_path / "two.obj").write_text(CUBE)
    (tmp_path / "arm.urdf").write_text(text)
    (tmp_path / "design.yaml").write_text((DESIGN % "").replace("arm.yaml", "arm.urdf"))
    task, assumed = read_design(tmp_path / "design.yaml")
    assert any(said.startswith("torque: with the inertias of the robot's file and 25 %") for said in task.guards)
    x = random_start(task, np.random.default_rng(0), 0.5)
    assert x is not None
    point = evaluate(task, x, design_grid(task))
    q, qd, qdd = point.joints[:3]
    model = pin.buildModelFromUrdf(str(tmp_path / "arm.urdf"))
    data, effort = model.createData(), 0.8 * 50
    rigid = np.array([pin.rnea(model, data, *state) for state in zip(q.T, qd.T, qdd.T, strict=True)]).T
    expected = ERROR * rigid + ROTOR * effort * qdd + VISCOUS * effort / 1.6 * qd + COULOMB * effort * np.sign(qd)
    usages = {usage.what: usage for usage in constraint_usages(point)}
    for j, joint in enumerate(task.model.actuated):
        fast = np.abs(qd[j]) > 0.3 * np.abs(qd[j]).max()
        counted = effort * usages[f"torque of joint '{joint}'"].values
        assert counted[fast] == pytest.approx(expected[j, fast], abs=0.02 * effort)
        links = task.information.load[0] * [not name.startswith(("fv", "fs")) for name in task.base.names]
        assert point.W[j] @ links == pytest.approx(rigid[j], abs=1e-3 * effort)  # gravity differs by 3e-4
    assert assumed["parameters"].startswith("parameters: the inertias of the robot's file, every other link a rod of")


def result_with(value: float, std: float, outcome: Grade) -> SimpleNamespace:
    gain = Estimate("gain_arm", value, std, "N m/A", verdict=Finding(outcome.value, grade=outcome))
    return SimpleNamespace(robot=SimpleNamespace(actuated=("arm",)), drive_gains={"arm": gain})


def test_contradictory_gains_are_no_priors() -> None:
    with pytest.raises(
        GtauError, match=r"gain of joint 'arm' in m.json is contradictory, so it cannot be a prior; identify"
    ):
        identified_gains(result_with(0.00039, 1e-5, Grade.CONTRADICTORY), Path("m.json"))
    with pytest.raises(GtauError, match="which may be zero, so it cannot be a prior"):
        identified_gains(result_with(1.0, 0.8, Grade.WEAK), Path("m.json"))
    (weak,) = identified_gains(result_with(10.0, 1.0, Grade.WEAK), Path("m.json"))
    assert weak.source == "weak"
    assert weak.interval == pytest.approx((8.04, 11.96), abs=0.01)


def test_limits_hold_at_the_worst_end_of_a_gain(tmp_path: Path) -> None:
    """A limit of torque is not turned into amperes; one of current counts for the least gain."""
    task, _ = read_design(
        written(tmp_path, "limits: {current: {arm: 20}}\nprior: {gains: {turret: 10, arm: 10, forearm: 10, wrist: 10}}")
    )
    assert task.limits.current.tolist() == [np.inf, 20, np.inf, np.inf]
    x = random_start(task, np.random.default_rng(0), 0.5)
    assert x is not None
    gains = tuple(KnownGain(10.0, (8.0, 12.0), "weak") for _ in range(4))
    exact, ranged = (
        {usage.what: usage for usage in constraint_usages(evaluate(entry, x, design_grid(entry)))}
        for entry in (task, replace(task, prior=replace(task.prior, known=gains)))
    )
    assert {usage.unit for what, usage in exact.items() if what.startswith("torque")} == {"N m"}
    assert ranged["torque of joint 'forearm'"].excess == pytest.approx(1.2 * exact["torque of joint 'forearm'"].excess)
    assert ranged["current of joint 'arm'"].excess == pytest.approx(exact["current of joint 'arm'"].excess / 0.8)


def test_a_limit_in_amperes_needs_gains(tmp_path: Path) -> None:
    with pytest.raises(GtauError, match=r"limits\.current needs the drive gains; add prior\.gains"):
        read_design(written(tmp_path, "limits: {current: {arm: 20}}"))
