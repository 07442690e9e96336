"""A campaign goes on from its folder alone, refuses what is void, and ends with gains that hold."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from mujoco_robots import write_robot
from typer.testing import CliRunner

import gtau
from gtau.campaigns.campaign import CampaignState, _decided, _narrower, _to_play, campaign
from gtau.campaigns.candidates import _simulated, beside_the_axis, candidates, played_again
from gtau.campaigns.decision import Decision, decide, refuse_to_go_on, warming, write_experiment
from gtau.campaigns.folder import Played, Round, read_design_file, read_rounds, read_settings, void, write_json
from gtau.campaigns.page import campaign_page
from gtau.campaigns.rehearsal import Rehearsal, check_contacts, write_motion
from gtau.cli.commands import app
from gtau.documents.files import write_table
from gtau.documents.markup import read_yaml
from gtau.errors import GtauError
from gtau.estimation.effects.effect import EstimatedEffect
from gtau.estimation.effects.known.friction_drift import EFFECT as FRICTION_DRIFT
from gtau.estimation.results.estimate import Estimate
from gtau.excitation.design import Design, check
from gtau.excitation.design_file import make_task, read_design
from gtau.excitation.forecast import sampled_run
from gtau.excitation.nlp import Programme, random_start
from gtau.excitation.prior import KnownGain
from gtau.excitation.task import DesignProblem
from gtau.findings import Finding, Grade, silent
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.report.design import trajectory_table
from gtau.report.terminal import plain
from gtau.robots.readers.native import write_native

PLAYER = Path(__file__).parents[2] / "examples" / "players" / "play_mujoco.py"
DESIGN = """robot: five-bar
rate: 100
period: 3
harmonics: 3
runs: [{payload: none}, {payload: {name: payload, mass: 1.0}}, {payload: {name: payload, mass: 1.0}}, {payload: none}]
"""

LEVEL = """robot: level
joints:
  arm: {antecedent: ground, alpha: pi/2, r: 0.9, theta: q,
        limits: {position: [-1, 1], velocity: 2, effort: 60}}
  forearm: {antecedent: arm, d: 0.5, theta: q, limits: {position: [-1, 1], velocity: 3, effort: 30}}
  hand: {antecedent: forearm, d: 0.3, theta: q, limits: {position: [-1, 1], velocity: 3, effort: 10}}
"""


def play(folder: Path, *more: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, PLAYER, folder, *more], capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, CampaignState, dict[str, float]]:
    """A campaign whose first motion waits to be played, and the true gains."""
    folder = tmp_path_factory.mktemp("campaign")
    (folder / "design.yaml").write_text(DESIGN)
    gains = write_robot("five-bar", folder, 1.0, 1)
    return folder, campaign(folder, accuracy=3), gains


@pytest.fixture
def copied(begun: tuple[Path, CampaignState, dict[str, float]], tmp_path: Path) -> Path:
    return Path(shutil.copytree(begun[0], tmp_path / "camp"))


def test_the_first_call_writes_a_rehearsed_motion(begun: tuple[Path, CampaignState, dict[str, float]]) -> None:
    folder, state, _ = begun
    assert state.next == "play"
    assert state.say.startswith(f"play {folder / '01'}: first with --speed 0.1 (tool up to ")
    motion = json.loads((folder / "01" / "motion.json").read_text())
    assert [run["payload"] and run["payload"]["name"] for run in motion["runs"]] == [None, "payload", "payload", None]
    assert motion["rehearsal"]["used"] <= 1
    assert set(motion["files"]) == {"motion.csv", "../design.yaml"}
    assert any(guard.startswith("jerk: not limited") for guard in motion["guards"])
    assert "rest: runs begin and end at 'left' 2.094 rad, 'right' 1.047 rad; to change: rest" in motion["guards"]
    before = (folder / "01" / "motion.json").stat().st_mtime_ns
    assert campaign(folder).say == state.say  # and nothing is done twice
    assert (folder / "01" / "motion.json").stat().st_mtime_ns == before
    assert "Guards of the last motion" in plain(campaign_page(state))


def test_a_player_refuses_a_void_motion_a_wrong_start_and_writes_nothing_when_slow(copied: Path) -> None:
    slow = play(copied / "01", "--speed", "0.5")
    assert slow.returncode == 0, slow.stderr
    assert not (copied / "01" / "played.json").exists()
    truth = (copied / "mujoco.yaml").read_text()
    (copied / "mujoco.yaml").write_text(truth.replace("quantum: 1.0e-05", "quantum: 1.0e-05, zero: 0.5"))
    assert "the motion starts at" in play(copied / "01").stderr
    (copied / "mujoco.yaml").write_text(truth.replace("bandwidth: 60.0", "bandwidth: 1.0"))
    assert play(copied / "01").returncode == 1
    state = campaign(copied)
    assert state.next == "blocked"
    assert "was not played to its end (tracking error of joint" in state.say
    with (copied / "design.yaml").open("a") as file:
        file.write("limits: {shapes: none}\n")
    assert "has changed, so the rehearsal is void" in play(copied / "01").stderr


def test_files_that_are_not_as_they_were_written_are_named(copied: Path) -> None:
    path = copied / "01" / "motion.json"
    written = path.read_text()
    path.write_text(written.replace('"tracking_tolerance": 0', '"tracking_tolerance": 9'))
    assert f"{path} has changed, so the rehearsal is void" in play(copied / "01").stderr
    assert void(read_rounds(copied)[0]) == "motion.json"
    for content in (written[:300].encode(), b"{}", b"\xff\xfe", b"[]"):
        path.write_bytes(content)
        with pytest.raises(GtauError, match=r"motion\.json is not as it was written; remove it, and run the command"):
            campaign(copied)
        assert "Traceback" not in play(copied / "01").stderr
    path.write_text(written)
    for name in ("played.json", "decision.json"):
        (copied / "01" / name).write_text('{"kind": "done"}')
        with pytest.raises(GtauError, match=rf"{name} is not as it was written"):
            assert read_rounds(copied)[0].decision
        (copied / "01" / name).unlink()
    said = play(copied / "01", "--robot", "none.yaml").stderr
    assert "none.yaml describes the simulated robot and does not exist; write it" in said


@pytest.mark.slow
def test_a_changed_scene_makes_the_motion_anew(copied: Path) -> None:
    before = json.loads((copied / "01" / "motion.json").read_text())["hash"]
    with (copied / "design.yaml").open("a") as file:
        file.write("limits: {velocity: {left: 1.0}}\n")
    assert campaign(copied).next == "play"
    assert json.loads((copied / "01" / "motion.json").read_text())["hash"] != before


def cut_off(folder: Path) -> CampaignState:
    """A campaign whose logs are too short."""
    assert play(folder / "01").returncode == 0
    for log in (folder / "01" / "logs").iterdir():
        log.write_text("".join(log.read_text().splitlines(keepends=True)[:30]))
    return campaign(folder)


def test_logs_that_give_no_result_are_said_and_kept(copied: Path) -> None:
    state = cut_off(copied)
    assert state.next == "blocked"
    assert "no result" in state.say
    assert campaign(copied).say == state.say
    assert len(list((copied / "01" / "logs").iterdir())) == 4


@pytest.mark.slow
def test_logs_may_be_set_aside(copied: Path) -> None:
    cut_off(copied)
    (copied / "01" / "set-aside.txt").write_text("the logger stopped\n")
    state = campaign(copied)
    assert state.next == "play"
    assert [this.folder.name for this in state.rounds] == ["01", "02"]
    assert "round 01 is set aside: the logger stopped" in plain(campaign_page(state))


def test_another_robot_or_payload_than_the_folder_has_is_refused(copied: Path, tmp_path: Path) -> None:
    with pytest.raises(GtauError, match="states robot five-bar and payloads of 1 kg, other than the command"):
        campaign(copied, payload=2.0)
    with pytest.raises(GtauError, match="holds no campaign; begin it with a robot and the mass of a payload"):
        campaign(tmp_path / "none")
    with pytest.raises(GtauError, match="mass"):
        campaign(tmp_path / "none", robot="five-bar", payload=-1.0)
    assert not (tmp_path / "none").exists()
    done = CliRunner().invoke(app, ["campaign", str(copied), "--payload-mass", "1", "--robot", "five-bar", "--json"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["next"] == "play"
    assert gtau.campaign is campaign


def test_a_robot_file_is_named_from_the_new_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_native(load_robot("five-bar"), tmp_path / "arm.yaml")
    for _ in range(2):  # the same command again is harmless
        assert read_settings(Path("camp"), "arm.yaml", 2.0, 4.0).accuracy == 4
    file = read_design_file(Path("camp"))
    assert Path(file.robot).samefile("arm.yaml")
    assert [load and load.mass for load in file.payloads] == [None, 2.0, 2.0, None]
    with pytest.raises(GtauError, match=r"other\.yaml cannot be read: no such file or directory; check the path"):
        read_settings(Path("another"), "other.yaml", 2.0, None)
    assert not Path("another").exists()
    with pytest.raises(GtauError, match=r"camp/design\.yaml states robot arm\.yaml and payloads of 2 kg"):
        read_settings(Path("camp"), "five-bar", 2.0, None)
    Path("arms").mkdir()
    Path("arms/robot.urdf").write_text(URDF)
    for _ in range(2):
        read_settings(Path("third"), "arms", 2.0, None)
    assert read_yaml(Path("third/design.yaml")).data["robot"] == "../arms/robot.urdf"


def gain(joint: str, value: float | None, random: float, model: float, outcome: Grade = Grade.GOOD) -> Estimate:
    std = float(np.hypot(random, model))
    return Estimate(joint, value, std, "N m/A", verdict=Finding(outcome.value, grade=outcome), model_std=model)


def result_of(*gains: Estimate) -> SimpleNamespace:
    return SimpleNamespace(drive_gains={entry.name: entry for entry in gains}, effects=())


def round_of(purpose: str, half: float = 10.0, value: float = 1.0) -> Round:
    known = {"gains": {"a": {"value": value, "half_width": half, "unit": "N m/A"}}}
    this = Round(Path("01"), {"purpose": purpose}, None, "")
    return type("Judged", (Round,), {"decision": known})(**vars(this))


def test_the_larger_part_of_the_worst_interval_decides() -> None:
    first = [round_of("first")]
    assert (
        decide(result_of(gain("a", 1.0, 0.03, 0.01), gain("b", 1.0, 0, 0.02)), 3.0, first, None).kind == "random part"
    )
    limited = decide(result_of(gain("a", 1.0, 0.01, 0.03)), 3.0, first, None)
    assert limited.kind == "model part"
    assert limited.say == (
        "'a' is known to +-6.2 %, the target is 3 %; the model part of its interval is the larger one"
    )
    assert decide(result_of(gain("a", 1.0, 0.005, 0.005)), 3.0, first, None).kind == "confirm"
    five = [round_of("random part") for _ in range(5)]
    assert decide(result_of(gain("a", 1.0, 0.03, 0.01)), 3.0, five, None).say.startswith("five rounds are over")
    wide = result_of(gain("a", 1.0, 0.01, 0.03))
    once = [round_of("first", 6.3), round_of("model part")]
    assert decide(wide, 3.0, once, None).kind == "model part"
    twice = [round_of("first", 6.3), round_of("model part", 6.3), round_of("model part")]
    assert decide(wide, 3.0, twice, None).kind == "stopped"
    narrowed = [round_of("first", 14.0), round_of("model part", 6.3), round_of("model part")]
    assert decide(wide, 3.0, narrowed, None).kind == "model part"


def test_an_effect_that_the_data_show_twice_ends_the_campaign() -> None:
    """It is named in the first round, and no motion is tried against it again."""
    cause = Finding("torque constant", ("a",), text="a falling torque constant", advice="log the current")
    effect = EstimatedEffect("saturation", cause, 0.1, 0.01, "1/A", 30.0, 0.4)
    result = SimpleNamespace(drive_gains={"a": gain("a", 1.0, 0.01, 0.3)}, effects=(effect,))
    once = decide(result, 3.0, [round_of("first")], None)
    assert (once.kind, once.suspect) == ("model part", effect.subject)
    assert once.notes == (f"the data speak for {effect.subject} (40 % of the residual variance)", "log the current")
    before = round_of("first", 90.0)
    before.decision["suspect"] = effect.subject
    twice = decide(result, 3.0, [before, round_of("model part")], None)
    assert twice.kind == "stopped"
    assert twice.say.startswith("another motion does not help: ")


def test_a_drift_asks_for_a_warm_up_run_which_is_played_and_not_evaluated(copied: Path) -> None:
    cause = Finding(FRICTION_DRIFT.name, text="Coulomb friction of 'left' changing along the runs")
    drift = EstimatedEffect(FRICTION_DRIFT.name, cause, -0.2, 0.02, "", 30.0, 0.2)
    cold, file = read_rounds(copied)[0], read_design_file(copied)
    assert warming(SimpleNamespace(effects=(replace(drift, likelihood=1.0),)), cold) == ""
    drifting = SimpleNamespace(drive_gains={"left": gain("left", 1.0, 0.01, 0.3)}, effects=(drift,))
    assert warming(drifting, cold).startswith("the data show Coulomb friction of 'left' changing along the runs, so")
    assert decide(drifting, 3.0, [round_of("first")], None).suspect == ""
    task, _ = read_design(copied / "design.yaml")
    x = random_start(task, np.random.default_rng(0), 0.5)
    purpose = {"purpose": "random part", "after": "01", "warm_up": True}
    done = Rehearsal(0.5, "", 0.1, {}, {}, ())
    write_motion(copied / "02", file, Design(task, "gains", x, 1.0, (), 0), done, purpose)
    with (copied / "mujoco.yaml").open("a") as truth:
        truth.write("cold: {more: 6.0, fades: 4.0}\n")
    assert play(copied / "02").returncode == 0
    logs = [np.loadtxt(copied / "02" / "logs" / f"{run}.csv", delimiter=",", skiprows=1) for run in ("warm-up", "run1")]
    first, second = (np.sqrt(np.mean(log[:, 3:] ** 2, axis=0)) for log in logs)
    assert (first > 1.1 * second).all()
    warm = read_rounds(copied)[1]
    write_experiment(copied / "experiment.yaml", file, [warm])
    assert [run["log"] for run in read_yaml(copied / "experiment.yaml").data["runs"]] == [
        f"02/logs/run{k}.csv" for k in (1, 2, 3, 4)
    ]
    assert warming(SimpleNamespace(effects=()), warm) == "the next round begins with a warm-up run, as this one did"


def test_done_is_what_a_round_that_did_not_decide_confirms() -> None:
    rounds = [round_of("first", 1.4), round_of("confirm")]
    all_rounds = result_of(gain("a", 1.0, 0.005, 0.005))
    before = rounds[0].decision
    assert decide(all_rounds, 3.0, rounds, result_of(gain("a", 1.01, 0.01, 0.01)), before).kind == "done"
    apart = decide(all_rounds, 3.0, rounds, result_of(gain("a", 1.08, 0.01, 0.01)), before)
    assert apart.kind == "blocked"
    assert apart.say == (
        "the last round contradicts those before: 'a' is 1.080 +- 0.028 N m/A by itself, and was 1.000 +- 0.014 N m/A"
    )


def test_a_round_that_widens_the_intervals_leaves_the_result_of_those_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inputs, last = {"design.yaml": "mass"}, round_of("confirm")

    def first(kind: str) -> Round:
        decision = {"kind": kind, "inputs": inputs}
        return type("Judged", (Round,), {"decision": decision})(tmp_path, {"purpose": "first"}, None, "")

    earlier, wide, narrow = (result_of(gain("a", 1.0, std, std)) for std in (0.002, 0.01, 0.001))
    wide.data = ("the logs of all rounds",)
    earlier.replaced = lambda data: SimpleNamespace(drive_gains=earlier.drive_gains, data=data)
    narrow.data = wide.data
    monkeypatch.setattr("gtau.campaigns.campaign.load", lambda path: earlier)
    kept = _narrower(wide, [first("confirm"), last], inputs | {"02/logs/run1.csv": "log"})
    assert (kept.drive_gains, kept.data) == (earlier.drive_gains, wide.data)
    assert _narrower(narrow, [first("confirm"), last], inputs) is narrow
    assert _narrower(wide, [first("confirm"), last], {"design.yaml": "another mass"}) is wide
    assert _narrower(wide, [first("blocked"), last], inputs) is wide  # whose result was not written
    assert _narrower(wide, [last], inputs) is wide


def test_a_motion_that_brings_less_than_a_tenth_ends_the_campaign() -> None:
    result = result_of(gain("a", 1.0, 0.01, 0.03))
    decision = Decision("model part", "'a' is wide")
    worth = [{"motion": "as designed", "half_width": 5.0, "at_hand": True}]
    assert refuse_to_go_on(result, decision, worth).kind == "model part"
    worthless = [{"motion": "as designed", "half_width": 6.1, "at_hand": True},
                 {"motion": "with a payload of 2 kg", "half_width": 3.1, "at_hand": False}]  # fmt: skip
    ended = refuse_to_go_on(result, decision, worthless)
    assert ended.kind == "stopped"
    assert ended.say.startswith(
        "no motion narrows the widest interval by a tenth, but with a payload of 2 kg it would be +-3.1 %: 'a' is wide"
    )


def test_a_payload_on_the_last_axis_is_to_be_mounted_beside_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is simulated there, with a centre that identification does not know."""
    quick(monkeypatch)
    (tmp_path / "arm.yaml").write_text(LEVEL)
    stated = DESIGN.replace("mass: 1.0", "mass: 1.0, parameters: {mx: 0.01, zz: 0.02}")
    (tmp_path / "design.yaml").write_text(stated.replace("five-bar", "arm.yaml"))
    task, _ = read_design(tmp_path / "design.yaml")
    designed = Design(task, "gains", random_start(task, np.random.default_rng(0), 0.5), 1.0, (), 0)
    known = {"mx": 0.01, "my": 0.0, "mz": 0.3}

    def result_with(hand: float) -> SimpleNamespace:
        identified = result_of(
            gain("arm", 1.0, 0.01, 0.0), gain("forearm", 1.0, 0.01, 0.0), gain("hand", 1.0, hand, 0.0)
        )
        identified.robot, identified.payload_values = task.model.robot, {"payload": known}
        return identified

    assert list(beside_the_axis(designed, result_with(0.009))) == []  # the gain of another joint is the least known
    (beside,) = beside_the_axis(designed, result_with(0.05))
    assert beside.label == "with the payload's centre 0.08 m from the axis of 'hand', not 0.01 m,"
    assert beside.beside == pytest.approx((0.07, 0.0, 0.0))
    assert not beside.at_hand
    carried, result = [], result_with(0.05)
    result.gains = np.ones(len(task.model.actuated))
    result.delays = {joint: SimpleNamespace(value=delay) for joint, delay in (("a", None), ("b", 0.0), ("c", 0.01))}
    torques = "gtau.campaigns.candidates.torques"
    monkeypatch.setattr(torques, lambda _, q, qd, qdd, payload: carried.append(payload) or 1 * q)
    runs = list(_simulated(beside, result))
    q, current, step = runs[0].position, runs[0].command, round(0.01 * task.rate)
    np.testing.assert_allclose(current[:, :2], q[:, :2], atol=1e-12)
    np.testing.assert_allclose(current[:-step, 2], q[step:, 2], atol=1e-9)  # a delay leads
    assert carried[1].parameters == pytest.approx({"mx": 0.08, "my": 0.0, "mz": 0.3, "zz": 0.02})
    assert runs[1].payload.parameters == {"zz": 0.02}
    assert carried[0] is runs[0].payload is None

    home = "gtau.campaigns.campaign"
    monkeypatch.setattr(f"{home}.identified", lambda *_: result)
    monkeypatch.setattr(f"{home}.decisions.write_experiment", lambda *_: None)
    monkeypatch.setattr(f"{home}.decisions.warming", lambda *_: "")
    monkeypatch.setattr(f"{home}.decide", lambda *_: Decision("random part", "'hand' is wide"))
    monkeypatch.setattr(f"{home}.save", lambda *_: None)
    result.alternatives, last = (), round_of("first")
    for width, advised in ((2.0, True), (5.9, False)):
        monkeypatch.setattr(f"{home}.expected_width", lambda one, *_, width=width: width if one.beside[0] else 6.0)
        decision = _decided(tmp_path / "02", 3.0, read_design_file(tmp_path), [last], silent, nullcontext)
        advice = f"mount the payload off the axis of the last joint: {beside.label} it would be +-{width:g} %"
        assert (advice in decision.notes) == advised
    known["mx"] = 0.09
    assert list(beside_the_axis(designed, result_with(0.05))) == []  # it is far enough from it


def test_candidates_are_within_the_limits(tmp_path: Path) -> None:
    (tmp_path / "design.yaml").write_text(DESIGN)
    task, _ = read_design(tmp_path / "design.yaml")
    x = random_start(task, np.random.default_rng(0), 0.8)
    assert x is not None
    offered = {one.label: one for one in candidates(Design(task, "gains", x, 1.0, (), 0))}
    assert {"as designed", "at 70 % of the speed", "twice as long"} <= set(offered)
    assert not offered["with a payload of 2 kg"].at_hand
    assert offered["at 50 % of the speed"].design.task.series.period == pytest.approx(6)


URDF = """<robot name="arm"><link name="base"/><link name="bar"/><joint name="a" type="revolute"><parent link="base"/>
<child link="bar"/><axis xyz="0 1 0"/><limit lower="0" upper="2" effort="9" velocity="1"/></joint></robot>"""
ARM = """<mujoco><worldbody>
<geom name="wall" type="box" size="0.9 0.01 0.5" pos="0 {wall} 0"/><geom name="socket" type="sphere" size="0.1"/>
<body name="arm"><joint name="a" axis="0 0 1"/><geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.02"/>
<body name="forearm" pos="0.4 0 0"><joint name="b" axis="0 0 1"/>
<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/></body></body></worldbody>
<actuator><motor joint="a"/><motor joint="b"/></actuator></mujoco>"""


def test_no_motion_through_a_wall_or_the_robot_itself(tmp_path: Path) -> None:
    """The socket overlaps the arm in the drawing, as it does at the start."""
    time, at_rest = np.linspace(0.0, 2.0, 201), np.zeros((2, 201))

    def check(wall: float, a: float, b: float) -> str:
        (tmp_path / "arm.xml").write_text(ARM.format(wall=wall))
        model = InverseDynamics(load_robot(tmp_path / "arm.xml"))
        joints = np.stack([np.outer([a, b], time / 2), at_rest, at_rest])
        return check_contacts(tmp_path / "arm.xml", model, time, joints)

    assert check(1.3, 1.5, 0.0) == ""
    with pytest.raises(GtauError, match=r"'forearm' touches 'wall' at 1\.\d* s"):
        check(0.6, 1.5, 0.0)
    with pytest.raises(GtauError, match=r"'forearm' touches 'socket' at 1\.\d* s"):
        check(1.3, 0.0, 3.1)


@pytest.mark.filterwarnings("error")
def test_a_joint_without_limits_of_position_is_named_and_no_number_is_invalid(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ARM.format(wall=2).replace('name="b"', 'name="b" range="-90 90" limited="true"'))
    limits = "limits: {shapes: none, velocity: {a: 1, b: 1}}"
    (tmp_path / "design.yaml").write_text(DESIGN.replace("robot: five-bar", "robot: arm.xml") + limits)
    task, _ = read_design(tmp_path / "design.yaml")
    assert task.series.half == pytest.approx([np.pi, 0.8 * np.pi / 2])
    assert any(guard.startswith("position: no limit in the file for 'a'") for guard in task.guards)
    assert random_start(task, np.random.default_rng(0), 0.5) is not None


@pytest.mark.parametrize(
    ("robot", "payload", "accuracy", "says"),
    [
        ("nosuch", 1.0, 3.0, "no robot is called"),
        ("five-bar", 0.0, 3.0, r"design\.yaml, runs\.2\.payload\.mass: 0\.0 is out of range"),
        ("five-bar", 1.0, 80.0, r"campaign\.yaml, accuracy: 80\.0 is out of range"),
    ],
)
def test_a_campaign_that_cannot_begin_leaves_nothing(
    tmp_path: Path, robot: str, payload: float, accuracy: float, says: str
) -> None:
    with pytest.raises(GtauError, match=says):
        campaign(tmp_path / "camp", robot=robot, payload=payload, accuracy=accuracy)
    assert not (tmp_path / "camp").exists()


def test_what_a_robots_file_lacks_is_to_be_stated_in_the_design_file_that_was_begun(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ARM.format(wall=2))
    for given in ({"robot": tmp_path / "arm.xml", "payload": 2.0}, {}):
        with pytest.raises(
            GtauError, match=r"camp/design\.yaml: the robot's file has no velocity limit of a, b; add 'limits"
        ):
            campaign(tmp_path / "camp", **given)


def test_a_round_that_was_not_played_cannot_be_set_aside(copied: Path) -> None:
    """It would be designed at every call, and its logs never used."""
    (copied / "01" / "set-aside.txt").write_text("not yet\n")
    with pytest.raises(GtauError, match=r"01 was not played, so there is nothing to set aside; remove its set-aside"):
        campaign(copied)


def test_a_round_confirms_nothing_where_those_before_are_set_aside(
    copied: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from gtau.campaigns import campaign as module

    this = read_rounds(copied)[0]
    last = replace(
        this, motion={**this.motion, "purpose": "confirm"}, played=Played(schema="", hash="", end="completed")
    )
    compared = []

    def decided(result: object, accuracy: float, rounds: list[Round], alone: object, before: object) -> Decision:
        compared.append((alone, before))
        return Decision("stopped", "")

    identified = result_of(gain("left", 1.0, 0.01, 0.01))
    monkeypatch.setattr(module, "save", lambda *_: None)
    monkeypatch.setattr(module, "identified", lambda *_: identified)
    monkeypatch.setattr(module.decisions, "slower", lambda *_: ())
    monkeypatch.setattr(module, "decide", decided)
    for used in ([last], [last, last]):
        decision = module._decided(copied / "02", 3.0, read_design_file(copied), used, silent, nullcontext)
        assert any("payload's mass" in note for note in decision.notes)
    assert compared[0] == (None, None)
    alone, before = compared[1]
    assert alone is identified
    assert before["gains"]["left"]["value"] == 1.0  # identified anew, as no decision is from the files of now


def test_the_page_says_in_short_sentences_what_to_do_and_why(copied: Path) -> None:
    """What one needs next, why, where the model is, and which rounds were judged on other grounds."""
    gains = {"left": {"value": 1.0, "unit": "N m/A", "half_width": 2.0, "random": 1.0, "model": 0.1, "verdict": "good"}}
    decision = {"kind": "model part", "say": "'left' is wide", "next": "02", "gains": gains, "candidates": []}
    inputs = {"design.yaml": "1"}
    write_json(copied / "01" / "decision.json", decision | {"notes": ["of heat"], "suspect": "", "inputs": inputs})
    shutil.copytree(copied / "01", copied / "02")
    (copied / "02" / "decision.json").unlink()
    waiting = _to_play(copied, 3.0, read_rounds(copied))
    said = plain(campaign_page(waiting))
    assert waiting.say.startswith(f"play {copied / '02'}: first with --speed 0.1")
    assert "- 'left' is wide\n- of heat\n" in said
    motion = json.loads((copied / "02" / "motion.json").read_text())
    write_json(copied / "02" / "motion.json", motion | {"rehearsal": motion["rehearsal"] | {"speed": 3.1}})
    fast = _to_play(copied, 3.0, read_rounds(copied))
    assert "first with --speed 0.08 (tool up to 0.25 m/s), then in full (3.1 m/s" in fast.say
    assert "the model is" not in said
    done = decision | {"kind": "done", "notes": [], "suspect": "", "inputs": {"design.yaml": "2"}}
    write_json(copied / "02" / "decision.json", done)
    rounds = tuple(read_rounds(copied))
    said = plain(campaign_page(CampaignState(copied, 3.0, "done", "done: all", rounds, rounds[-1].decision)))
    assert f"- the model is {copied / '02' / 'model.json'}; 'gtau validate'" in said.replace("\n  ", " ")
    assert "- round 01 was judged before a change of design.yaml" in said
    (copied / "01" / "set-aside.txt").write_text("slipped")
    assert _to_play(copied, 3.0, read_rounds(copied)).decision is None


def test_parameters_that_are_those_of_no_robot_are_not_rehearsed(copied: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of an Orthoglide 41 of 61 were not essential after one round, and simulated with them it ran away."""
    from gtau.campaigns import rehearsal

    tried, file = [], read_design_file(copied)
    task, _ = read_design(copied / "design.yaml")
    x = random_start(task, np.random.default_rng(0), 0.5)

    def under_control(design: Design, file: object, model: Path | None, progress: object) -> tuple[dict, dict]:
        tried.append(model)
        if model is not None or len(tried) > 2:
            raise GtauError("the simulated motion cannot be continued")
        return dict.fromkeys(("left", "right"), 0.0), dict.fromkeys(("left", "right"), 0.1)

    monkeypatch.setattr(rehearsal, "_under_control", under_control)
    design, model = Design(task, "gains", x, 1.0, (), 0), copied / "model.json"
    done = rehearsal.rehearse(design, file, model, silent)
    assert done.errors == {"left": 0.0, "right": 0.0}
    assert done.notes[0].startswith("rehearsal: with the inertias of the robot's file")
    assert tried == [model, None]
    with pytest.raises(GtauError, match="cannot be continued"):
        rehearsal.rehearse(design, file, None, silent)


def test_an_interrupted_rehearsal_names_no_folder_that_is_gone(copied: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from gtau.campaigns import rehearsal

    def stopped(*_: object) -> None:
        raise KeyboardInterrupt("logs finished in a folder that is removed")

    monkeypatch.setattr(rehearsal, "simulate", stopped)
    task, _ = read_design(copied / "design.yaml")
    x = random_start(task, np.random.default_rng(0), 0.5)
    with pytest.raises(KeyboardInterrupt, match=r"^$"):
        rehearsal.rehearse(Design(task, "gains", x, 1.0, (), 0), read_design_file(copied), None, silent)


def test_a_motion_that_the_rehearsal_refuses_is_played_slower(copied: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from gtau.campaigns import campaign as module

    task, _ = read_design(copied / "design.yaml")
    x = random_start(task, np.random.default_rng(0), 0.5)
    designed, asked = Design(task, "gains", x, 1.0, (), 0), []

    def rehearse(design: Design, *_: object) -> Rehearsal:
        asked.append(design.task.series.base_frequency * 3)
        if asked[-1] > slowest:
            raise GtauError("'left' strays")
        return Rehearsal(0.9, "limit", 1.0, {}, {}, ("of contacts",))

    monkeypatch.setattr(module, "rehearse", rehearse)
    slowest = 0.6
    slowed, done = module.rehearsed(designed, read_design_file(copied), None, silent)
    assert slowed.task.series.base_frequency == pytest.approx(0.5 / 3)
    assert done.notes == ("of contacts", "rehearsal: at 50 % of the speed, as otherwise 'left' strays")
    slowest = 0.0
    with pytest.raises(GtauError, match="'left' strays"):
        module.rehearsed(designed, read_design_file(copied), None, silent)


def test_a_motion_that_was_played_is_always_there(tmp_path: Path) -> None:
    """A robot found too heavy for its limits of torque, with uncertain gains, goes on from what it has done."""
    (tmp_path / "arm.yaml").write_text(LEVEL)
    (tmp_path / "design.yaml").write_text(DESIGN.replace("five-bar", "arm.yaml") + "limits: {tool_speed: 9}\n")
    task, _ = read_design(tmp_path / "design.yaml")
    x = random_start(task, np.random.default_rng(0), 0.9)
    assert x is not None
    prior = task.prior
    known = tuple(KnownGain(gain.value, (0.4, 1.6), "weak") for gain in prior.known)
    heavy = replace(task, prior=replace(prior, known=known, chi=4 * prior.chi, cautious=4 * prior.cautious))
    assert max(usage.excess for usage in check(heavy, x)) > 1.5  # and so do all others
    refusal = GtauError("no motion within the limits was found")
    time_of, joints = sampled_run(task, x)
    (tmp_path / "01").mkdir()
    write_table(trajectory_table(task, time_of, joints), tmp_path / "01" / "motion.csv")
    motion = {"series": {"period": 3.0, "repetitions": 1, "x": x.tolist()}}
    played = Round(tmp_path / "01", motion, Played(schema="", hash="", speed=0.5, end="completed"), "")
    done, note = played_again(heavy, [played], refusal, silent)
    assert note.startswith("the next motion repeats round 01 with other parts, because no motion within")
    assert done.task.series.period == 6.0  # it was played at half the speed
    assert max(usage.excess for usage in check(done.task, done.x)) <= 1.0

    # no torque is beyond the limit and beyond what was played, which is less at half the speed
    slow = replace(task, series=done.task.series, prior=replace(prior, cautious=heavy.prior.cautious))
    regressor, most = slow.model.columns(slow.base.standard), []
    for q, qd, qdd in ((joints[0], joints[1] / 2, joints[2] / 4), sampled_run(done.task, done.x)[1][:3]):
        motion = slow.model.motion(q, qd, qdd)
        loads = (regressor.torques_along(slow.model.layout, motion, load) for load in slow.information.cautious)
        most.append(np.max([np.abs(load).max(axis=1) for load in loads], axis=0))
    assert np.all(most[1] <= 1.002 * np.maximum(most[0], task.limits.torque))
    assert np.any(most[0] > task.limits.torque)
    assert done.value < np.exp(Programme(done.task, "gains", {}).value(x)[0])  # of other parts, which tell more
    with pytest.raises(GtauError, match="no motion within"):
        played_again(heavy, [replace(played, motion={})], refusal, silent)  # of an earlier version


@pytest.mark.slow
def test_a_second_round_without_a_motion_goes_on_from_the_first(copied: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuses(*_: object, **__: object) -> Design:
        raise GtauError("no motion within the limits was found")

    assert play(copied / "01").returncode == 0
    monkeypatch.setattr("gtau.campaigns.campaign.excite", refuses)
    state = campaign(copied)
    assert state.next == "play"
    assert any(note.startswith("the next motion repeats round 01 with other parts") for note in state.decision["notes"])
    assert play(copied / "02").returncode == 0


def campaigned(folder: Path, accuracy: float) -> Iterator[CampaignState]:
    """Play and judge until the campaign ends."""
    state = campaign(folder, accuracy=accuracy)
    while state.next == "play":
        yield state
        played = play(state.rounds[-1].folder)
        assert played.returncode == 0, played.stderr
        state = campaign(folder)
    yield state


@pytest.mark.slow
def test_a_campaign_ends_with_gains_whose_intervals_hold(
    copied: Path, begun: tuple[Path, CampaignState, dict[str, float]]
) -> None:
    *_, last = campaigned(copied, 5.0)
    assert last.next == "done", last.say
    assert [this.motion["purpose"] for this in last.rounds][-1] == "confirm"
    for joint, true in begun[2].items():
        known = last.decision["gains"][joint]
        assert known["half_width"] <= 5
        assert abs(known["value"] / true - 1) < 1.5 * known["half_width"] / 100
    assert replace(last, say="") == replace(campaign(copied), say="")


@pytest.mark.slow
def test_a_campaign_takes_gains_from_voltages_without_a_payload(tmp_path: Path) -> None:
    """Its first motion is fast enough for the back-EMF; the players' logs hold duties and supply voltages."""
    motor = {"resistance": 0.5, "dead_time": 0.01, "warming": 0.1, "duty_quantum": 1 / 2048}
    gains = write_robot("five-bar", tmp_path, 1.0, 1, drives=motor, supply={"voltage": 48, "resistance": 0.05})
    (tmp_path / "design.yaml").write_text(
        "{robot: five-bar, rate: 250, period: 5, harmonics: 3, repetitions: 2, runs: [{payload: none}], "
        "limits: {shapes: none, floor: none}, drives: {left: {commutation: 0.005}, right: {commutation: 0.005}}}"
    )
    campaign(tmp_path, accuracy=3.0)
    assert play(tmp_path / "01").returncode == 0
    state = campaign(tmp_path)
    for joint, true in gains.items():
        known = state.decision["gains"][joint]
        assert known["half_width"] <= 3
        assert abs(known["value"] / true - 1) < 1.5 * known["half_width"] / 100


@pytest.mark.slow
@pytest.mark.parametrize(("killed", "moments"), [("first call", 10), ("player", 10), ("call after a round", 20)])
def test_killed_at_any_moment_a_command_is_made_up_for_by_the_next(killed: str, moments: int, copied: Path) -> None:
    """Killed at moments spread over a whole call, and called again, it ends where one that was not killed does."""
    command = [sys.executable, "-m", "gtau", "campaign", "."]
    if killed == "first call":
        shutil.rmtree(copied / "01")
    elif killed == "player":
        command = [sys.executable, str(PLAYER), "01"]
    else:
        assert play(copied / "01").returncode == 0

    def called(folder: Path, until: float | None = None) -> dict[str, bytes]:
        run = subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL, start_new_session=True)
        try:
            assert run.wait(until) == 0
        except subprocess.TimeoutExpired:
            os.killpg(run.pid, signal.SIGKILL)
            run.wait()
        kept = {name: content for name, content in files_of(folder).items() if not Path(name).name.startswith(".")}
        return kept | {"report.html": b""}  # it says how long the call took

    uninterrupted, begun = Path(shutil.copytree(copied, copied.with_name("whole"))), time.monotonic()
    wanted = called(uninterrupted)
    duration = time.monotonic() - begun
    for moment in range(moments):
        folder = Path(shutil.copytree(copied, copied.with_name(f"killed {moment}")))
        if called(folder, (moment + 0.5) / moments * duration) != wanted:  # killed before it was done
            assert called(folder) == wanted


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out what takes time: search, rehearsal and identification."""

    def drawn(task: DesignProblem, seed: int, **_: object) -> Design:
        x = random_start(task, np.random.default_rng(seed), 0.5)
        assert x is not None
        return Design(task, "gains", x, 1.0, (), 0)

    home = "gtau.campaigns.campaign"
    saved = SimpleNamespace(effects=())
    monkeypatch.setattr(f"{home}.save", lambda _, path: write_json(path, {"model": 1}))
    monkeypatch.setattr(f"{home}.excite", drawn)
    monkeypatch.setattr(f"{home}.rehearse", lambda *_: Rehearsal(0.9, "limit", 1.0, {}, {}, ()))
    monkeypatch.setattr(f"{home}.identified", lambda *_: saved)
    monkeypatch.setattr(f"{home}.decide", lambda *_: Decision("confirm", "all gains are within 3 %"))
    monkeypatch.setattr(f"{home}.decisions.slower", lambda *_: ())
    monkeypatch.setattr(f"{home}.next_task", lambda file, *_: make_task(file)[0])


@pytest.mark.parametrize("played", [False, True])
def test_interrupted_at_any_write_nothing_is_lost_or_repeated_wrongly(
    played: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before each write of a call: the next call ends where an uninterrupted one does."""
    quick(monkeypatch)
    start = tmp_path / "start"
    start.mkdir()
    (start / "design.yaml").write_text(DESIGN)
    if played:
        campaign(start)
        motion = json.loads((start / "01" / "motion.json").read_text())
        (start / "01" / "logs").mkdir()
        runs = [{"name": run["name"], "log": f"logs/{run['name']}.csv"} for run in motion["runs"]]
        for run in runs:
            (start / "01" / run["log"]).write_text("t\n")
        document = {"schema": "gtau-played/1", "hash": motion["hash"], "end": "completed", "runs": runs}
        write_json(start / "01" / "played.json", document)
    uninterrupted = Path(shutil.copytree(start, tmp_path / "whole"))
    campaign(uninterrupted, accuracy=3)
    wanted, replaced = files_of(uninterrupted), os.replace
    moments = 0
    while True:
        folder = Path(shutil.copytree(start, tmp_path / f"cut {moments}"))
        writes = iter(range(moments))

        def cut(source: str, target: Path, writes: Iterator[int] = writes) -> None:
            if next(writes, None) is None:
                raise KeyboardInterrupt
            replaced(source, target)

        with monkeypatch.context() as patched:
            patched.setattr("gtau.documents.files.os.replace", cut)
            try:
                campaign(folder, accuracy=3)
                break
            except KeyboardInterrupt:
                moments += 1
        campaign(folder, accuracy=3)
        assert files_of(folder) == wanted
    assert moments == (6 if played else 3)
