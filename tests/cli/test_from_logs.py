"""``gtau identify LOG...``: from bags to drive gains in one command, with every guess said."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from bags import TOPIC, write_bag
from five_bar_logs import STEEL, Plant, write_log
from models_to_export import model_of
from typer.testing import CliRunner

from gtau.cli.commands import app
from gtau.cli.logs import LogOptions, experiment_of
from gtau.demo import write_tutorial
from gtau.errors import GtauError
from gtau.estimation.results.model_file import load as load_model
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.signals.channel import SENSOR
from gtau.signals.reading.drafting import Stated, draft_logs, draft_text, guesses, with_sensors, write_draft
from gtau.signals.reading.experiment import read_experiment
from gtau.signals.reading.logs import is_log_folder
from gtau.signals.run import Run, read_run
from gtau.uses.identify import drafted, read_log

LINK = """<link name="{0}"><inertial><origin xyz="{2} 0.01 0.02"/><mass value="{1}"/>
<inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{0}" type="{5}"><parent link="{1}"/><child link="{2}"/><origin xyz="{3} 0 0"/><axis xyz="{4}"/>
<limit lower="-6" upper="6" velocity="20" effort="300"/></joint>"""
URDF = "\n".join(
    [
        '<robot name="desk_arm"><link name="base"/>',
        LINK.format("upper", 2.0, 0.15),
        LINK.format("lower", 1.2, 0.12),
        LINK.format("pad", 0.05, 0.01),
        JOINT.format("shoulder", "base", "upper", 0, "0 1 0", "revolute"),
        JOINT.format("elbow", "upper", "lower", 0.4, "0 1 0", "revolute"),
        JOINT.format("finger", "lower", "pad", 0.3, "1 0 0", "prismatic"),
        "</robot>",
    ]
)
GAINS = np.array([8.0, 5.0])  # N m/A
RATE = 200.0
LOADED = "loaded_0.8kg"


@pytest.fixture(scope="module")
def motion(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Time (N,), positions and currents (N, 2) of elbow and shoulder, by log: without load, and with 0.8 kg."""
    file = tmp_path_factory.mktemp("arm") / "arm.urdf"
    file.write_text(URDF)
    arm = InverseDynamics(load_robot(file, joints=["shoulder", "elbow"]))
    logs, rng = {}, np.random.default_rng(8)
    chi = {"m_shoulder": 2.0, "mx_shoulder": 0.3, "zz_shoulder": 0.08, "m_elbow": 1.25, "mx_elbow": 0.18}
    chi |= {"zz_elbow": 0.05, "fv_shoulder": 1.0, "fs_shoulder": 2.0, "fv_elbow": 0.6, "fs_elbow": 1.0}
    for seed, (name, mass) in enumerate({"empty": 0.0, LOADED: 0.8}.items()):
        time = np.arange(round(20 * RATE)) / RATE
        w = 2 * np.pi * np.array([0.2, 0.5, 0.9])
        angle = w * time[:, None, None] + np.random.default_rng(seed).uniform(0, 6, (2, 3))
        size = 0.6 / w
        q, qd, qdd = (
            (size * w**k * f(angle)).sum(axis=2) for k, f in enumerate((np.sin, np.cos, lambda x: -np.sin(x)))
        )
        load = {"m_elbow": 1.25 + mass, "mx_elbow": 0.18 + 0.3 * mass, "zz_elbow": 0.05 + 0.09 * mass}
        tau = arm.torques(q, qd, qdd, chi | load)
        current = tau / GAINS + 0.005 * rng.normal(size=tau.shape)
        logs[name] = time, q[:, ::-1], current[:, ::-1]
    return logs


def bags(folder: Path, motion: Any, **options: Any) -> list[str]:
    return [
        str(write_bag(folder / name, ("elbow", "shoulder"), *log, **options).relative_to(folder))
        for name, log in motion.items()
    ]


def test_moving_columns_that_are_not_used_are_in_the_first_line(
    tmp_path: Path, motion: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "arm.urdf").write_text(URDF)
    header = "t,shoulder_pos,rail_pos,shoulder_current,rail_current"
    np.savetxt(tmp_path / "a.csv", np.column_stack(motion["empty"]), delimiter=",", header=header, comments="")
    experiment_of([tmp_path / "a.csv"], LogOptions(str(tmp_path / "arm.urdf")), tmp_path / "out")
    said = "experiment.yaml is drafted from 1 log, whose columns rail_pos, rail_current move and are not used."
    assert said in capsys.readouterr().err


def test_an_assumed_unit_is_in_the_first_line(tmp_path: Path, motion: Any, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "arm.urdf").write_text(URDF)
    header = "t,shoulder_pos,elbow_pos,shoulder_current,elbow_current"
    time, position, current = motion["empty"]
    table = np.column_stack([time, np.rad2deg(position), current])
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header=header, comments="")
    experiment_of([tmp_path / "a.csv"], LogOptions(str(tmp_path / "arm.urdf")), tmp_path / "out")
    said = "is drafted from 1 log. CHECK: positions are assumed to be in deg: joint 'elbow' reaches"
    assert said in capsys.readouterr().err


def test_one_command_from_bags(tmp_path: Path, motion: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The robot from the bag, without the finger, the load from a name; the guesses are data beside the result."""
    monkeypatch.chdir(tmp_path)
    logs = bags(tmp_path, motion, urdf=URDF)
    done = CliRunner().invoke(app, ["identify", *logs, "--kind", "current", "--json"])
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    gains = {each["joint"]: each["value"] for each in document["drive_gains"]}
    assert gains == pytest.approx({"shoulder": 8.0, "elbow": 5.0}, rel=0.01)
    said = [each["what"] for each in document["notes"] if each["kind"] == "draft"]
    assert [words.split(":")[0] for words in said] == [
        "payload masses come from the file names",
        "no payload is assumed for empty, without a mass in the name",
        "the robot comes from /robot_description of the bag",
        "joints missing from the log are held at home; shoulder, elbow move",
        f"time is {TOPIC}/header/stamp, measurement stamps, not receipt stamps",
    ]
    assert said[0].endswith(f"{LOADED} 0.8 kg")
    assert (tmp_path / "result" / "robot.urdf").read_text() == URDF
    experiment = read_experiment(tmp_path / "result" / "experiment.yaml")
    assert experiment.signals.current == {joint: f"{TOPIC}/{joint}/effort" for joint in ("shoulder", "elbow")}
    summary = (tmp_path / "result" / "report.html").read_text()
    assert "held at home; shoulder, elbow move" in summary
    corrected = (tmp_path / "result" / "experiment.yaml").read_text().replace("mass: 0.8", "mass: 0.9")
    (tmp_path / "result" / "experiment.yaml").write_text(corrected)
    again = CliRunner().invoke(app, ["identify", *logs, "--kind", "current"])
    assert again.exit_code == 2
    assert "result/experiment.yaml exists already and is not an unedited gtau draft" in again.stderr


def test_check_drafts_as_identify_does(tmp_path: Path, motion: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a description the robot is asked for in one sentence, and then taken from --robot."""
    monkeypatch.chdir(tmp_path)
    logs = bags(tmp_path, motion)
    (tmp_path / "arm.urdf").write_text(URDF)
    refused = CliRunner().invoke(app, ["check", *logs])
    assert refused.exit_code == 2
    assert "does not name its robot; give it by --robot ROBOT" in refused.stderr
    command = ["check", *logs, "--robot", "arm.urdf", "--payload", f"{LOADED}=0.75", "--out", "looked", "--json"]
    done = CliRunner().invoke(app, command)
    found = json.loads(done.stdout)
    said = [each["what"] for each in found["findings"] if each["kind"] == "draft"]
    assert said[0] == f"{TOPIC}/shoulder/effort ... {TOPIC}/elbow/effort are assumed to be torques"
    (loaded,) = [run for run in read_experiment(tmp_path / "looked" / "experiment.yaml").runs if run.payload]
    assert loaded.payload is not None
    assert loaded.payload.mass == 0.75
    assert not any("payload masses come from" in words for words in said)
    stated = LogOptions("arm.urdf", [f"{LOADED}=0.75"], kind="current")
    experiment_of([Path(log) for log in logs], stated, Path("looked"))  # an unedited draft is replaced
    assert read_experiment(tmp_path / "looked" / "experiment.yaml").signals.kind == "current"


def test_a_refused_draft_leaves_the_folder_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    model_of(load_robot("five-bar")).save("model.json")
    (tmp_path / "bad.csv").write_text("a,b\n1,2\n3,4\n")
    Plant().run("good", seed=1).to_frame().write_csv("good.csv")

    def refused(*arguments: str) -> str:
        done = CliRunner().invoke(app, [arguments[0], "model.json", *arguments[1:]])
        assert done.exit_code == 2, done.output
        return done.stderr

    left = {"bad.csv", "good.csv", "model.json"}
    for command in ("payload", "validate"):
        for log, *more in (
            ("bad.csv",),
            ("no.csv",),
            ("good.csv", "--payload", "good"),
            ("good.csv", "--position", "z*"),
        ):
            refused(command, log, *more)
            refused(command, log, *more, "--out", "out")
            assert {path.name for path in tmp_path.iterdir()} == left
    assert "there is no export to 'abc'; did you mean 'abb'?" in refused("payload", "good.csv", "--to", "abc")
    assert "name it by --frame" in refused("payload", "good.csv", "--to", "ur")
    assert {path.name for path in tmp_path.iterdir()} == left
    Path("out").mkdir()
    for name in ("robot.yaml", "experiment.yaml"):
        Path("out", name).write_text("mine\n")
    assert "is not an unedited gtau draft" in refused("payload", "good.csv", "--out", "out")
    assert {path.name: path.read_text() for path in Path("out").iterdir()} == dict.fromkeys(
        ("robot.yaml", "experiment.yaml"), "mine\n"
    )


def test_a_log_that_is_refused_has_no_figures(tmp_path: Path, motion: Any) -> None:
    """The page is written and says why; singularities and figures have no samples."""
    time, position, current = (column[:60] for column in motion["empty"])
    head = "t,q_left,q_right,i_left,i_right"
    np.savetxt(tmp_path / "a.csv", np.column_stack([time, position, current]), delimiter=",", header=head, comments="")
    (tmp_path / "experiment.yaml").write_text(
        "robot: five-bar\n"
        "signals: {time: t, position: {left: q_left, right: q_right}, current: {left: i_left, right: i_right}}\n"
        "runs: [{log: a.csv}]\n"
    )
    out = tmp_path / "out"
    done = CliRunner().invoke(app, ["check", str(tmp_path / "experiment.yaml"), "--out", str(out)])
    assert (done.exit_code, "has 60 samples" in " ".join(done.stdout.split())) == (2, True), done.output
    assert {path.name for path in out.iterdir()} == {"report.html"}


def test_the_file_gives_the_scale_and_its_wrong_inertia_is_named(tmp_path: Path, motion: Any) -> None:
    """Nothing else gives it: the gains are those of the masses, whatever a wrong moment of inertia says."""
    (tmp_path / "arm.urdf").write_text(URDF.replace("prismatic", "fixed"))
    head = "t,q_elbow,q_shoulder,i_elbow,i_shoulder"
    np.savetxt(tmp_path / "a.csv", np.column_stack(motion["empty"]), delimiter=",", header=head, comments="")
    robot, out = str(tmp_path / "arm.urdf"), str(tmp_path / "out")
    options = ["--robot", robot, "--prior-inertias", "0.3", "--out", out, "--json"]
    done = CliRunner().invoke(app, ["identify", str(tmp_path / "a.csv"), *options])
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    gains = {gain["joint"]: gain["value"] for gain in document["drive_gains"]}
    assert gains == pytest.approx({"shoulder": 8.0, "elbow": 5.0}, rel=0.05)
    assert "yy_elbow is" in str(document)


def test_what_is_given_wrongly_is_refused(tmp_path: Path, motion: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    logs = bags(tmp_path, motion, urdf=URDF)
    (tmp_path / "experiment.yaml").write_text("signals: {}\n")
    for more, words in (
        (["--payload", "full=1"], "'full' names no log of a payload; the logs are empty, loaded_0.8kg."),
        (["--payload", "empty"], "--payload is 'empty'; write the name of a log and kg"),
        (["--payload", "empty=-1"], "the payload of 'empty' is -1 kg"),
        (logs[:1], "the log 'empty' is given twice; give every log once."),
        (["experiment.yaml"], "experiment.yaml is an experiment file; give either it or logs."),
    ):
        done = CliRunner().invoke(app, ["identify", *logs, *more])
        assert (done.exit_code, words in done.stderr) == (2, True), done.stderr
    done = CliRunner().invoke(app, ["identify", "experiment.yaml", "--robot", "ur10e"])
    assert "--robot is for logs" in done.stderr
    for source, words in (("nowhere", "nowhere cannot be read"), (".", ". is a folder, not an experiment file")):
        assert words in CliRunner().invoke(app, ["identify", source, "--robot", "ur10e"]).stderr
    broken = write_bag(
        tmp_path / "broken", ("a", "b"), *(each[:200] for each in motion["empty"]), urdf="<robot><link/></robot>"
    )
    with pytest.raises(GtauError, match=r"/robot_description in .*broken.*give the robot \(--robot ROBOT\)"):
        draft_logs([broken])


def test_a_refusal_names_the_options_that_correct_the_guesses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_tutorial(tmp_path)
    forgotten = CliRunner().invoke(app, ["identify", "empty_1.csv"])
    assert forgotten.exit_code == 2
    assert "--robot ROBOT" in forgotten.stderr
    refused = CliRunner().invoke(app, ["identify", "empty_1.csv", "--robot", "five-bar"])
    assert refused.exit_code == 2
    *guessed, refusal = refused.stderr.splitlines()
    assert "--payload LOG=KG" in "".join(guessed)
    assert "needs a scale" in refusal
    without_time = np.loadtxt("empty_1.csv", delimiter=",", skiprows=1)[:, 1:]
    np.savetxt("no_time.csv", without_time, delimiter=",", header="q1,q2,i1,i2", comments="")
    refused = CliRunner().invoke(app, ["identify", "no_time.csv", "--robot", "five-bar"])
    assert "name the time column (--time COLUMN)" in refused.stderr


@pytest.mark.parametrize("compression", ["STORAGE", "MESSAGE", "FILE", "LZ4"])
def test_compressed_bags(tmp_path: Path, motion: Any, compression: str) -> None:
    """The numbers of a compressed bag, by the joint's name whatever its place in the message."""
    time, position, current = (each[:300] for each in motion["empty"])
    log = write_bag(
        tmp_path / "bag", ("elbow", "shoulder"), time, position, current, urdf=URDF, compression=compression
    )
    draft = draft_logs([log], stated=Stated(kind="current"))
    write_draft(draft, tmp_path / "experiment.yaml")
    experiment = read_experiment(tmp_path / "experiment.yaml")
    run = read_run(experiment.runs[0].log, experiment.signals, units=experiment.units)
    assert run.joints == ("shoulder", "elbow")
    np.testing.assert_allclose(run.position, position[:, ::-1], atol=1e-9)
    np.testing.assert_allclose(run.command, current[:, ::-1], atol=1e-9)


def test_stamps_of_receipt_are_taken_where_there_are_no_others(tmp_path: Path, motion: Any) -> None:
    log = write_bag(
        tmp_path / "bag", ("elbow", "shoulder"), *(each[:400] for each in motion["empty"]), urdf=URDF, stamped=False
    )
    draft = draft_logs([log])
    assert draft.signals.time_columns == (f"{TOPIC}/received",)
    said = [note.what for note in guesses(draft, Path("e.yaml"))]
    assert f"time is {TOPIC}/received, the receipt stamps" in said


def test_topics_at_rates_of_their_own(tmp_path: Path, motion: Any) -> None:
    """Currents at half the rate in a topic without a header: on the clock of the positions, and said."""
    log = write_bag(
        tmp_path / "bag", ("elbow", "shoulder"), *(each[:600] for each in motion["empty"]), urdf=URDF, apart=True
    )
    draft = draft_logs([log])
    assert (draft.signals.time_columns, draft.signals.command_time_columns) == (
        (f"{TOPIC}/header/stamp",),
        ("/motor_currents/received",),
    )
    said = [note.what for note in guesses(draft, Path("e.yaml"))]
    assert "time is /motor_currents/received, the receipt stamps" in said
    assert any(words.startswith("columns were assigned to the joints in order") for words in said)


def lerobot(path: Path, log: tuple[np.ndarray, ...], episodes: int, arrays: bool) -> Path:
    """Write lists of states, actions (goals of position, reached late) and efforts; time restarts in every episode."""
    time, position, current = log
    length = len(time) // episodes
    goals = np.vstack([position[8:], np.repeat(position[-1:], 8, axis=0)])
    kind = pl.Array(pl.Float64, 2) if arrays else pl.List(pl.Float64)
    pl.DataFrame(
        {
            "action": pl.Series(goals.tolist(), dtype=kind),
            "observation.state": pl.Series(position.tolist(), dtype=kind),
            "observation.effort": pl.Series(current.tolist(), dtype=kind),
            "timestamp": np.arange(len(time)) % length / RATE,
            "episode_index": np.arange(len(time)) // length,
            "task": ["swing"] * len(time),
        }
    ).write_parquet(path)
    return path


@pytest.mark.parametrize("arrays", [False, True])
def test_episodes_of_lists(tmp_path: Path, motion: Any, arrays: bool) -> None:
    """Every episode is a run with its own time; actions are goals of position and no torques."""
    log = lerobot(tmp_path / "file-000.parquet", motion["empty"], 4, arrays)
    (tmp_path / "arm.urdf").write_text(URDF.replace("prismatic", "fixed"))
    draft = draft_logs([log], str(tmp_path / "arm.urdf"))
    assert draft.signals.position == {"shoulder": "observation.state[1]", "elbow": "observation.state[2]"}
    assert draft.signals.command == {"shoulder": "observation.effort[1]", "elbow": "observation.effort[2]"}
    said = [note.what for note in guesses(draft, Path("e.yaml"))]
    assert "each of the 4 episodes in file-000.parquet is a run" in said
    write_draft(draft, tmp_path / "experiment.yaml")
    experiment = read_experiment(tmp_path / "experiment.yaml")
    assert [run.episode for run in experiment.runs] == [0, 1, 2, 3]
    third = read_run(log, experiment.signals, part=experiment.runs[2])
    assert third.name == "file-000 episode 2"
    np.testing.assert_allclose(third.position, motion["empty"][1][2000:3000], atol=1e-9)
    np.testing.assert_allclose(third.command, motion["empty"][2][2000:3000], atol=1e-9)
    text = (tmp_path / "experiment.yaml").read_text()
    (tmp_path / "twice.yaml").write_text(text.replace("episode: 3", "episode: 1"))
    with pytest.raises(GtauError, match=r"file-000.parquet' is listed twice"):
        read_experiment(tmp_path / "twice.yaml")
    (tmp_path / "none.yaml").write_text(text.replace("episode: 3", "episode: 7"))
    with pytest.raises(GtauError, match=r"has no episode 7; its episodes are 0 to 3"):
        read_run(log, experiment.signals, part=read_experiment(tmp_path / "none.yaml").runs[-1])


INFO = {
    "fps": 200,
    "features": {
        "observation.state": {"dtype": "float32", "shape": [2], "names": ["elbow.pos", "shoulder.pos"]},
        "observation.effort": {"dtype": "float32", "shape": [2], "names": {"motors": ["main_elbow", "main_shoulder"]}},
        "action": {"dtype": "float32", "shape": [2], "names": ["elbow.pos", "shoulder.pos"]},
        "timestamp": {"dtype": "float32", "shape": [1], "names": None},
    },
}


def test_a_data_set_names_its_joints_and_rate(tmp_path: Path, motion: Any) -> None:
    """meta/info.json two folders up: joints by name, whatever their order, the rate where no column has the time."""
    (tmp_path / "meta").mkdir()
    (tmp_path / "data" / "chunk-000").mkdir(parents=True)
    (tmp_path / "meta" / "info.json").write_text(json.dumps(INFO))
    (tmp_path / "arm.urdf").write_text(URDF.replace("prismatic", "fixed"))
    log = lerobot(tmp_path / "data" / "chunk-000" / "file-000.parquet", motion["empty"], 2, arrays=False)
    draft = draft_logs([log], str(tmp_path / "arm.urdf"))
    assert draft.signals.position == {"shoulder": "observation.state[2]", "elbow": "observation.state[1]"}
    assert draft.signals.command == {"shoulder": "observation.effort[2]", "elbow": "observation.effort[1]"}
    assert "joints" not in draft.open
    assert set(draft_logs([log]).signals.position) == {"elbow", "shoulder"}
    whole = draft_logs([tmp_path], str(tmp_path / "arm.urdf"))  # the folder of the data set
    assert whole.signals.command == draft.signals.command
    assert is_log_folder(tmp_path)
    pl.read_parquet(log).drop("timestamp").write_parquet(log)
    timeless = draft_logs([log], str(tmp_path / "arm.urdf"))
    assert (timeless.signals.time_columns, timeless.signals.rate) == ((), 200.0)
    assert timeless.reasons.time == "no time column; 200 Hz by the description of the data set (meta/info.json)"
    assert "rate" not in timeless.open
    mixed = {"names": [f"{joint}.{kind}" for joint in ("elbow", "shoulder") for kind in ("pos", "torque")]}
    (tmp_path / "meta" / "info.json").write_text(json.dumps({"features": {"observation.state": mixed}}))
    pl.DataFrame(
        {
            "observation.state": np.stack([motion["empty"][1], motion["empty"][2]], axis=2).reshape(-1, 4).tolist(),
            "timestamp": motion["empty"][0],
        }
    ).write_parquet(log)
    state = draft_logs([log], str(tmp_path / "arm.urdf"))
    assert state.signals.position == {"shoulder": "observation.state[3]", "elbow": "observation.state[1]"}
    assert (state.signals.kind, state.signals.command["elbow"]) == ("torque", "observation.state[2]")
    (tmp_path / "meta" / "info.json").write_text("[]")
    with pytest.raises(GtauError, match=r"info.json is not a readable description of a LeRobot data set"):
        draft_logs([log])


def test_torques_beside_currents_are_sensors_unless_computed_from_them(tmp_path: Path, motion: Any) -> None:
    """They give the scale where no payload does, and this is said; a multiple of the currents is none."""
    time, position, current = motion["empty"]
    (tmp_path / "arm.urdf").write_text(URDF.replace("prismatic", "fixed"))
    rubbing = np.sign(np.gradient(position, axis=0)) * 0.6 * current.std(axis=0)
    drafts = []
    for name, torque in (("sensed", 50 * (current - rubbing)), ("computed", np.round(8 * current, 1))):
        log = np.column_stack([time, position, current, torque])
        head = "t,q_elbow,q_shoulder,motor_elbow,motor_shoulder,torque_elbow,torque_shoulder"
        np.savetxt(tmp_path / f"{name}.csv", log, delimiter=",", header=head, comments="")
        drafts.append(with_sensors(draft_logs([tmp_path / f"{name}.csv"], str(tmp_path / "arm.urdf"))))
    sensed, computed = drafts
    assert sensed.signals.sensors(SENSOR) == {"shoulder": "torque_shoulder", "elbow": "torque_elbow"}
    said = [note.what for note in guesses(sensed, Path("e.yaml"))]
    assert (
        "torque_shoulder, torque_elbow are assumed to be torque sensors behind the gears, which set the scale" in said
    )
    assert not computed.signals.sensors(SENSOR)
    assert computed.unused.torques.keys() == {"shoulder", "elbow"}
    (said,) = [note.what for note in guesses(computed, Path("e.yaml")) if note.what.startswith("torque_")]
    assert said.endswith("are not used: they are a straight line of the currents, from which they may be computed")
    weighed = draft_logs([tmp_path / "sensed.csv"], str(tmp_path / "arm.urdf"), stated=Stated(masses={"sensed": 0.8}))
    assert not with_sensors(weighed).signals.sensors(SENSOR)


def test_goals_alone_are_no_torques(tmp_path: Path, motion: Any) -> None:
    """A data set of states and actions, the usual one, has nothing to identify from, and says so."""
    log = lerobot(tmp_path / "a.parquet", motion["empty"], 2, arrays=False)
    pl.read_parquet(log).drop("observation.effort").write_parquet(log)
    with pytest.raises(GtauError, match="no columns of currents or torques are recognised"):
        draft_logs([log])


def test_one_command_from_episodes(tmp_path: Path, motion: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    arm = (
        URDF.replace("prismatic", "fixed").replace('name="elbow"', 'name="a2"').replace('name="shoulder"', 'name="a1"')
    )
    (tmp_path / "arm.urdf").write_text(arm)
    logs = []
    for name, (time, position, current) in motion.items():  # columns in the order of the joints, as there are no names
        log = (time, position[:, ::-1], current[:, ::-1])
        logs.append(str(lerobot(tmp_path / f"{name}.parquet", log, 1, arrays=False)))
    done = CliRunner().invoke(app, ["identify", *logs, "--robot", "arm.urdf", "--kind", "current", "--json"])
    assert done.exit_code == 0, done.output
    gains = {each["joint"]: each["value"] for each in json.loads(done.stdout)["drive_gains"]}
    assert gains == pytest.approx({"a1": 8.0, "a2": 5.0}, rel=0.01)


@pytest.mark.slow
def test_the_airbot_pair(shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What its N m are worth, in one command: joints 2 and 3 lift, and need about 1.2 to 1.7 times what is reported."""
    monkeypatch.chdir(tmp_path)
    data = shared / "airbot_play"
    logs = [str(data / "chirp_unloaded.csv"), str(data / "chirp_loaded_480g.csv")]
    robot = str(data / "airbot_play_v3_0_gripper.urdf")
    done = CliRunner().invoke(app, ["identify", *logs, "--robot", robot, "--kind", "current", "--json"])
    document = json.loads(done.stdout)
    gains = {each["joint"]: each["value"] for each in document["drive_gains"]}
    assert 1.2 < gains["joint2"] < 1.7
    assert 1.2 < gains["joint3"] < 1.7
    assert [each["what"].split(":")[0] for each in document["notes"] if each["kind"] == "draft"] == [
        "columns were assigned to the joints in order",
        "payload masses come from the file names",
        "no payload is assumed for chirp_unloaded.csv, without a mass in the name",
    ]


@pytest.mark.slow
def test_the_ur10e_pair_as_bags(shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Currents as efforts, joints in the driver's order, the robot in the bag: gains near those of the controller."""
    monkeypatch.chdir(tmp_path)
    data, order = shared / "ur10e", [2, 1, 0, 3, 4, 5]
    joints = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint"]
    joints.append("wrist_3_joint")
    for name, source in (("empty", "ur-20_02_19_14harm50sec.csv"), ("load", "ur-20_02_19_14harm50secLoad.csv")):
        log = np.loadtxt(data / source, delimiter=",")
        columns = (log[:, 1:7][:, order], log[:, 13:19][:, order])
        write_bag(
            tmp_path / name, [joints[k] for k in order], log[:, 0], *columns, urdf=(data / "ur10e.urdf").read_text()
        )
    command = ["identify", "empty", "load", "--payload", "load=2.805", "--kind", "current", "--json"]
    gains = {
        each["joint"]: each["value"] for each in json.loads(CliRunner().invoke(app, command).stdout)["drive_gains"]
    }
    controller = dict(zip(joints, (11.976, 11.976, 9.839, 10.763, 10.76), strict=False))
    assert {joint: gains[joint] for joint in controller} == pytest.approx(controller, rel=0.07)


def test_a_model_reads_further_logs_of_its_recorder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Columns that no name tells are stated once, by patterns; the model remembers them, with their units."""
    monkeypatch.chdir(tmp_path)
    for seed, (name, load) in enumerate({"empty": None, "loaded": STEEL, "again": None, "other": STEEL}.items()):
        run = Plant(noise=0.01).run(name, payload=load, seed=seed)
        table = np.column_stack([1e3 * run.time, run.position, run.command])
        np.savetxt(f"{name}.csv", table, delimiter=",", header="A,bb_1,bb_2,cc_x,cc_y", comments="")
    stated = ["--robot", "five-bar", "--payload", "loaded.csv=1.2"]
    columns = ["--position", "bb_*", "--current", "cc_x,cc_y", "--time", "A"]
    refused = CliRunner().invoke(app, ["identify", "empty.csv", "loaded.csv", *stated, "--position", "dd_*"])
    assert refused.exit_code == 2
    assert "--position is 'dd_*', but no column matches" in refused.stderr
    refused = CliRunner().invoke(app, ["init", "empty.csv", "--robot", "five-bar", "--payload", "empty.csv=0.4"])
    assert "no columns of positions are recognised" in refused.stderr
    assert refused.stderr.endswith("; experiment.yaml is written with all but these columns.\n")
    skeleton = Path("experiment.yaml").read_text()
    assert "  position: {left: COLUMN, right: COLUMN}  # CHECK: write the columns" in skeleton
    assert "  - log: empty.csv\n    payload: {name: load_400g, mass: 0.4}\n" in skeleton
    for old, new in (
        ("left: COLUMN", "left: enc_J1"),
        ("right: COLUMN", "right: enc_J2"),
        ("time: COLUMN", "time: Zeit"),
    ):
        skeleton = skeleton.replace(old, new, 1)
    filled = skeleton.replace("left: COLUMN", "left: cc_x").replace("right: COLUMN", "right: cc_y")
    Path("experiment.yaml").write_text(filled)
    assert read_experiment("experiment.yaml").signals.current == {"left": "cc_x", "right": "cc_y"}
    done = CliRunner().invoke(app, ["identify", "empty.csv", "loaded.csv", *stated, *columns, "--json"])
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert [gain["value"] for gain in document["drive_gains"]] == pytest.approx([2.5, 4.0], rel=0.01)
    assert any("columns were assigned to the joints in order" in note["what"] for note in document["notes"])
    assert document["recording"]["units"] == {"time": "ms"}
    model, free = load_model("result/model.json"), run_of("again.csv")
    assert model.recording == load_model("result/model.json").recording
    for option in (["--preset", "tape"], ["--kind", "torque"]):  # as stated, not as recorded
        refused = CliRunner().invoke(app, ["validate", "result/model.json", "again.csv", *option])
        assert "no columns of positions are recognised" in refused.stderr
    (weighed,) = json.loads(invoke("payload", "other.csv", "again.csv", "--payload", "again.csv=0"))["payloads"]
    mass = next(entry for kind, entry in weighed["parameters"].items() if kind == "m")
    assert mass["value"] == pytest.approx(1.2, rel=0.01)
    Path("other_1200g.csv").write_bytes(Path("other.csv").read_bytes())
    (named,) = json.loads(invoke("payload", "other_1200g.csv"))["payloads"]  # a name states none that is weighed
    assert named["name"] == "other_1200g"
    steel = model.replaced(payloads=tuple(replace(payload, name="steel") for payload in model.payloads))
    draft = drafted([Path("other_1200g.csv")], "five-bar", Stated(), model=steel)
    assert "payload: {name: steel, mass: 1.2}" in draft_text(draft, tmp_path)
    said = " ".join(map(str, guesses(draft, Path())))
    assert "taken for those of the same mass: other_1200g.csv 'steel'" in said
    write_log(Path("lab.csv"), Plant().run("lab", seed=5))
    refused = CliRunner().invoke(app, ["validate", "result/model.json", "lab.csv"])
    assert "the log lacks the columns A, bb_1, bb_2, cc_x, cc_y of the model's logs" in refused.stderr
    errors = json.loads(invoke("validate", "again.csv"))
    assert [run["log"] for run in errors["runs"]] == ["again"]
    used = json.loads(invoke("use", "again.csv"))
    assert [joint["joint"] for joint in used["joints"]] == ["left", "right"]
    assert read_log(model, "again.csv").position == pytest.approx(free.position)
    Path("nothing.csv").write_text("")
    for arguments, words in (
        (
            ["use", "nothing.csv"],
            "nothing.csv is empty or begins with an empty line; give a log with one sample a line.",
        ),
        (["export", "--to", "csv", "--hours", "3"], "are for 'thresholds', not for 'csv'; leave them out."),
    ):
        done = CliRunner().invoke(app, [arguments[0], "result/model.json", *arguments[1:]])
        assert (done.exit_code, done.stderr.rstrip().endswith(words)) == (2, True), done.stderr


def invoke(command: str, *arguments: str) -> str:
    done = CliRunner().invoke(app, [command, "result/model.json", *arguments, "--json"])
    assert done.exit_code == 0, done.output
    return done.stdout


def run_of(name: str) -> Run:
    return read_run(
        name,
        {
            "time": "A",
            "position": {"left": "bb_1", "right": "bb_2"},
            "current": {"left": "cc_x", "right": "cc_y"},
        },
        units={"time": "ms"},
    )
