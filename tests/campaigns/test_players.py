"""Players keep the contract with stubs of the interfaces that they drive."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from mujoco_robots import write_robot

sys.path.append(str(Path(__file__).parents[2] / "examples" / "players"))
import contract
import play_lerobot
import play_mujoco
import play_ros2
import play_ur

RATE, SECONDS = 50, 4.0


@pytest.fixture
def motion(tmp_path: Path) -> contract.Motion:
    """A motion of two joints, there and back."""
    time = np.arange(round(RATE * SECONDS) + 1) / RATE
    w = 2 * np.pi / SECONDS
    q = np.outer(1 - np.cos(w * time), [0.2, -0.1])
    qd, qdd = np.outer(w * np.sin(w * time), [0.2, -0.1]), np.outer(w**2 * np.cos(w * time), [0.2, -0.1])
    header = "t,q_a,q_b,qd_a,qd_b,qdd_a,qdd_b"
    np.savetxt(tmp_path / "motion.csv", np.column_stack([time, q, qd, qdd]), delimiter=",", header=header, comments="")
    joint = {"unit": "rad", "start": 0.0, "start_tolerance": 0.02, "tracking_tolerance": 0.05}
    runs = [{"name": "run1", "payload": None}]
    file = {"rate": RATE, "files": {}, "runs": runs, "joints": [{"name": n, **joint} for n in "ab"]}
    (tmp_path / "motion.json").write_text(json.dumps(file | {"hash": contract.seal(file)}))
    return contract.read_motion(tmp_path)


class Follower:
    """A robot that is where it was last told to be, but for ``behind``."""

    def __init__(self, behind: float = 0.0, scaling: float = 1.0):
        self.behind, self.scaling, self.q, self.now = behind, scaling, [0.0, 0.0], 0.0

    def servoJ(self, q: list[float], *_: float) -> None:
        self.q = [value + self.behind for value in q]
        self.now += 1 / RATE

    def moveJ(self, q: list[float], speed: float) -> None:
        assert 0 < speed < 0.1
        self.q = q

    def __getattr__(self, name: str) -> Any:
        answers = {
            "getActualQ": self.q,
            "getActualCurrent": [1.0, 2.0],
            "getTimestamp": self.now,
            "getSpeedScaling": self.scaling,
            "isProtectiveStopped": False,
        }
        return lambda *_: answers.get(name)


def test_ur_follows_stretches_and_stops(motion: contract.Motion) -> None:
    robot = Follower()
    time, q, current, end = play_ur.play_run(motion, robot, robot, lambda: False)
    assert end == "completed"
    assert q[:200] == pytest.approx(motion.q[:200], abs=1e-6)
    assert current[0].tolist() == [1.0, 2.0]
    slow = Follower(scaling=0.5)
    assert play_ur.play_run(motion, slow, slow, lambda: False)[0][-1] == pytest.approx(2 * time[-1], rel=0.02)
    astray = Follower(behind=0.2)
    assert play_ur.play_run(motion, astray, astray, lambda: False)[3].startswith("tracking error of joint 'a': 0.2")
    assert play_ur.play_run(motion, robot, robot, lambda: True)[3] == "stopped by the operator"
    robot.q = [0.5, 0.0]
    with pytest.raises(SystemExit, match=r"joint 'a' stands at 0\.5, the motion starts at 0"):
        play_ur.play_run(motion, robot, robot, lambda: False)


def test_lerobot_works_in_degrees_and_logs_amperes(motion: contract.Motion) -> None:
    clock, place = [0.0], {"a.pos": 0.0, "b.pos": 0.0}

    def wait(span: float) -> None:
        clock[0] += span

    bus = SimpleNamespace(sync_read=lambda register: {"a": 100, "b": -200})
    robot = SimpleNamespace(bus=bus, get_observation=lambda: place, send_action=place.update)

    def play() -> tuple[Any, ...]:
        return play_lerobot.play_run(motion, robot, lambda: False, lambda: clock[0], wait)

    place["a.pos"] = 1.0  # 0.017 rad, from where it is brought to the start slowly
    time, q, current, end = play()
    assert end == "completed"
    assert clock[0] == pytest.approx(time[-1] + contract.APPROACH, abs=3 / RATE)
    assert q[0] == pytest.approx([0.0, 0.0], abs=1e-3)
    assert np.abs(q).max(axis=0) == pytest.approx([0.4, 0.2], abs=1e-3)
    assert current[0] == pytest.approx([0.65, -1.3])

    commands = []
    robot.send_action = lambda command: (commands.append(command), place.update(dict(command, **{"a.pos": 0.0})))
    place.update({"a.pos": 0.0, "b.pos": 0.0})
    assert play()[-1].startswith("tracking error of joint 'a'")
    assert commands[-2]["a.pos"] > np.rad2deg(0.05)
    assert commands[-1]["a.pos"] == 0.0  # it holds where it is


@pytest.mark.parametrize("speed", [1.2, 0.0, -0.5, np.nan])
def test_only_what_was_rehearsed_is_played(motion: contract.Motion, speed: float) -> None:
    with pytest.raises(SystemExit, match="was not rehearsed; give a fraction of the full speed"):
        motion.slower(speed)


def test_ros2_sends_all_samples_with_tolerances_and_ends_the_recording(motion: contract.Motion) -> None:
    made = SimpleNamespace(
        FollowJointTrajectory=SimpleNamespace(
            Goal=lambda: SimpleNamespace(trajectory=SimpleNamespace(joint_names=[], points=[]), path_tolerance=[])
        ),
        JointTrajectoryPoint=SimpleNamespace, Duration=SimpleNamespace, JointTolerance=SimpleNamespace,
    )  # fmt: skip
    goal = play_ros2.goal(motion.slower(0.5), made)
    assert goal.trajectory.joint_names == ["a", "b"]
    last = goal.trajectory.points[-1].time_from_start
    assert last.sec + 1e-9 * last.nanosec == pytest.approx(2 * SECONDS)
    assert [tolerance.position for tolerance in goal.path_tolerance] == [0.05, 0.05]
    ended, followed = [], []

    @contextmanager
    def record(folder: Path) -> Iterator[None]:
        yield
        ended.append(folder.name)

    def follow(motion: contract.Motion) -> str:
        followed.append(motion)
        return "completed" if len(followed) < 2 else "stopped: path tolerance violated"

    robot = SimpleNamespace(positions=lambda joints: [0.01, 0.0], record=record, follow=follow)
    log, end = play_ros2.play_run(motion, "run1", robot)
    assert (ended, end) == ([Path(log).name], "stopped: path tolerance violated")
    approach = followed[0]
    assert approach.q[[0, -1]].tolist() == [[0.01, 0.0], [0.0, 0.0]]
    assert np.gradient(approach.q[:, 0], approach.time)[1:-1] == pytest.approx(approach.qd[1:-1, 0], abs=1e-4)
    assert play_ros2.signals(motion)["current"] == {"a": "/joint_states.effort.a", "b": "/joint_states.effort.b"}


def test_a_round_is_not_played_twice_over_its_logs(motion: contract.Motion) -> None:
    def log(run: dict[str, Any], motion: contract.Motion) -> tuple[str, str]:
        return contract.write_log(motion, run["name"], motion.time, motion.q, motion.q), "completed"

    for speed in (1.0, 0.1):  # a dry run writes nothing
        with pytest.raises(SystemExit) as ended:
            contract.play_round(motion.folder, speed, log)
        assert ended.value.code == 0
    with pytest.raises(SystemExit, match=r"was played already; remove .*played\.json to play it again, which replaces"):
        contract.play_round(motion.folder, 1.0, log)


def test_ctrl_c_stops_a_round_and_says_so(motion: contract.Motion, capsys: pytest.CaptureFixture[str]) -> None:
    def interrupted(run: dict[str, Any], motion: contract.Motion) -> tuple[str, str]:
        raise KeyboardInterrupt

    with pytest.raises(SystemExit) as ended:
        contract.play_round(motion.folder, 1.0, interrupted)
    assert ended.value.code == 1
    assert capsys.readouterr().out == "run1: stopped by the operator\n"
    played = json.loads((motion.folder / "played.json").read_text())
    assert (played["end"], played["runs"]) == ("stopped by the operator", [])


def test_a_folder_that_is_no_round_is_refused(
    motion: contract.Motion, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("motion.json").write_text(json.dumps(motion.file | {"rate": 60}))
    with pytest.raises(SystemExit, match=r"^motion\.json has changed, .* is void; run 'gtau campaign \.\.' again"):
        contract.read_motion(".")
    monkeypatch.setattr(sys, "argv", ["play_mujoco.py", str(tmp_path.parent)])
    with pytest.raises(SystemExit, match="cannot be read; give the folder of a round, such as camp/01, or run"):
        play_mujoco.main()


def test_what_was_played_is_written_whole(motion: contract.Motion) -> None:
    log = contract.write_log(motion, "run1", motion.time, motion.q, motion.q)
    contract.write_played(motion, [{"name": "run1", "log": log, "end": "completed"}], "completed")
    played = json.loads((motion.folder / "played.json").read_text())
    assert (played["hash"], played["runs"][0]["log"]) == (contract.seal(motion.file), "logs/run1.csv")
    assert (motion.folder / log).read_text().startswith("t,q_a,q_b,i_a,i_b\n")
    assert not list(motion.folder.rglob("*.part"))


def test_players_name_their_options() -> None:
    folder = Path(play_ur.__file__).parent
    stops = {"ur": "Enter in the", "lerobot": "Enter in the", "ros2": "Ctrl-C", "mujoco": ""}
    for name, words in stops.items():
        command = [sys.executable, folder / f"play_{name}.py", "--help"]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        assert "--speed" in done.stdout
        assert words in done.stdout


def test_a_round_that_the_controller_stretched_is_noted(motion: contract.Motion) -> None:
    """The hold before and behind the motion does not count."""
    from gtau.campaigns.decision import slower
    from gtau.campaigns.folder import Played, PlayedRun, Round

    played = Played(schema="gtau-played/1", hash="h", end="completed", runs=(PlayedRun(name="run1", log="l"),))
    this = Round(motion.folder, motion.file, played, "")
    for stretch, noted in ((1.0, ()), (2.0, ("is used as such",))):
        after = 1 + stretch * SECONDS + 0.02 + np.arange(50)
        time = np.concatenate([np.arange(50) / RATE, 1 + stretch * motion.time, after])
        q = np.concatenate([np.zeros((50, 2)), motion.q, np.zeros((50, 2))])
        notes = slower(SimpleNamespace(data=(SimpleNamespace(time=time, position=q),)), [this])
        assert len(notes) == len(noted)
        assert all("was played at 50 % of its speed" in note for note in notes)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("left:", "lefft:", r"mujoco\.yaml lacks: drive 'left'\."),
        ("payload:", "disc:", r"mujoco\.yaml lacks: payload 'payload'\."),
        ("body: right_forearm", "body: hand", r"mujoco\.yaml lacks: body 'hand' in the model\."),
        ("gain:", "gian:", r"mujoco\.yaml lacks: gain of drive 'left', gain of drive 'right'\."),
        ("robot.xml", "none.xml", r"mujoco\.yaml is not as this player's --help describes it: .*none\.xml"),
        ("delay: 0.001", "delay: 1 ms", r"not as this player's --help describes it: could not convert string"),
        ("model:", "]", r"not as this player's --help describes it: "),
    ],
)
def test_what_the_file_of_a_robot_in_mujoco_lacks_is_named(tmp_path: Path, old: str, new: str, says: str) -> None:
    write_robot("five-bar", tmp_path, 1.0, 1)
    path = tmp_path / "mujoco.yaml"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(SystemExit, match=says):
        play_mujoco.described(path, ["left", "right"], "payload")
    with pytest.raises(SystemExit, match=r"does not exist; write it [(]see --help[)], or"):
        play_mujoco.described(tmp_path / "none.yaml", ["left", "right"], "payload")


def test_the_controller_in_mujoco_has_the_same_inertia_at_an_end_of_travel(tmp_path: Path) -> None:
    """The stop, which holds a slide that sinks 0.1 mm into it, made of 5 kg an inertia that no controller bears."""
    (tmp_path / "lift.xml").write_text(
        '<mujoco><worldbody><body><joint name="lift" type="slide" range="0 0.4" limited="true"/>'
        '<geom type="sphere" size="0.1" mass="5"/></body></worldbody></mujoco>'
    )
    (tmp_path / "mujoco.yaml").write_text("{model: lift.xml, drives: {lift: {gain: 40}}}")
    machine = play_mujoco.Machine(tmp_path / "mujoco.yaml", ["lift"], None)
    for place in (0.1, -1e-4):
        machine.data.qpos[:] = place
        assert machine.inertia()[0, 0] == pytest.approx(5.0)


def test_the_payload_in_mujoco_has_the_centre_of_its_file(tmp_path: Path) -> None:
    write_robot("five-bar", tmp_path, 1.0, 1)
    load = yaml.safe_load((tmp_path / "mujoco.yaml").read_text())["payloads"]["payload"]
    bare, loaded = (
        play_mujoco.Machine(tmp_path / "mujoco.yaml", ["left", "right"], name).model for name in (None, "payload")
    )
    added = loaded.body("payload payload")
    assert loaded.body_mass.sum() - bare.body_mass.sum() == pytest.approx(1.0)
    assert added.pos + added.ipos == pytest.approx(load["center"])


@pytest.mark.parametrize("servo", ["", ", proportional_gain: 0.3, dead_band: 0.001"])
def test_motors_in_mujoco_have_voltages(motion: contract.Motion, tmp_path: Path, servo: str) -> None:
    """``u = R i + ke qd``, with a supply that sags; a servo's duty is its gain times goal less position."""
    (tmp_path / "arm.xml").write_text(
        '<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="a" axis="0 0 1" damping="0.5"/>'
        '<geom type="capsule" size="0.03" fromto="0 0 0 0.3 0 0"/><body pos="0.3 0 0"><joint name="b" axis="0 0 1" '
        'damping="0.5"/><geom type="capsule" size="0.03" fromto="0 0 0 0.3 0 0"/></body></body></worldbody></mujoco>'
    )
    drive = f"{{gain: 2.5, resistance: 0.6, convention: amplitude, dead_time: 0.0{servo}}}"
    drives = f"{{a: {drive}, b: {drive}}}"
    (tmp_path / "mujoco.yaml").write_text(
        f"{{model: arm.xml, bandwidth: 8, supply: {{voltage: 24, resistance: 0.1}}, drives: {drives}}}"
    )
    for joint in motion.file["joints"]:
        joint["tracking_tolerance"] = 1.0  # of a slow loop at 50 Hz
    machine = play_mujoco.Machine(tmp_path / "mujoco.yaml", ["a", "b"], None)
    (time, q, i), beside, end = machine.play(motion, np.random.default_rng(0), 0.0)
    assert end == "completed"
    duty, volts = beside["duty"], beside["supply_voltage"]
    qd = np.gradient(q, time, axis=0)
    u = 0.6 * i + 2.5 / 1.5 * qd
    assert np.max(np.abs((u - duty * volts)[5:-5])) < 0.05 * np.max(np.abs(u))
    assert volts[1:] == pytest.approx(24 - 0.1 * np.sum(duty * i, axis=1)[:-1, None] * np.ones(2))
    if servo:
        goal = np.array([motion.at(t - play_mujoco.AHEAD)[0] for t in time])
        pushed = np.sign(goal - q) * np.maximum(np.abs(goal - q) - 0.001, 0)
        assert duty == pytest.approx(np.clip(0.3 * pushed, -1, 1), abs=1e-9)
    log = tmp_path / play_mujoco.write_log(motion, "run1", time, q, i, **beside)
    assert log.read_text().splitlines()[0] == "t,q_a,q_b,i_a,i_b,duty_a,duty_b,supply_voltage_a,supply_voltage_b"
