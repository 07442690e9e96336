"""Experiment files: what they say, and the sentence that a wrong one gets."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from gtau.errors import GtauError
from gtau.robots.robot import Joint, Robot
from gtau.signals.reading.columns import SampleRate
from gtau.signals.reading.experiment import Experiment, check_robot, read_experiment

GOOD = """\
robot: orthoglide
signals: {time: t, position: {11: q11, 12: q12}, current: {11: v1, 12: v2}}
prior_gains: {11: 2001, 12: 2001}
runs:
  - {log: free.csv}
  - {log: loaded.csv, payload: {name: steel, mass: 1.983}}
validation:
  - {log: check.csv, payload: {name: steel, mass: 1.983}}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("free.csv", "loaded.csv", "check.csv", "currents.csv"):
        (tmp_path / name).write_text("t,q11,q12,v1,v2\n")
    return tmp_path


def read(folder: Path, text: str) -> Experiment:
    (folder / "experiment.yaml").write_text(text)
    return read_experiment(folder / "experiment.yaml")


def test_a_good_file(folder: Path) -> None:
    experiment = read(folder, GOOD)
    assert experiment.robot == "orthoglide"
    assert experiment.signals.joints == ("11", "12")
    assert experiment.signals.command == {"11": "v1", "12": "v2"}
    assert experiment.expected_gains == {"11": 2001.0, "12": 2001.0}
    assert [gain.std for gain in experiment.stated_gains.values()] == [None, None]
    assert experiment.runs[0].log == (folder / "free.csv",)
    assert experiment.runs[0].payload is None
    payload = experiment.runs[1].payload
    assert payload is not None
    assert (payload.name, payload.mass, payload.mass_std) == ("steel", 1.983, 0.0)


def test_the_further_keys(folder: Path) -> None:
    text = """\
robot: arm.yaml
signals: {time: {rate: 5000}, position: {on: Joint_1, 01: Joint_2}, torque: {on: Joint_1, 01: Joint_2}}
units: {position: {on: deg, 01: mm}, torque: N m}
runs:
  - log: [free.csv, currents.csv]
    payload: {name: L, mass: 2, mass_std: 0.01, parameters: {mx: 0.1, zz: 1e-2}}
  - {log: loaded.csv, payload: {name: unknown}}
"""
    (folder / "arm.yaml").touch()
    experiment = read(folder, text)
    assert experiment.robot == str(folder / "arm.yaml")
    assert experiment.signals.time == SampleRate(rate=5000)
    assert experiment.signals.kind == "torque"
    assert [experiment.units.position_unit(joint) for joint in ("on", "01")] == ["deg", "mm"]
    assert experiment.runs[0].log == (folder / "free.csv", folder / "currents.csv")
    first, second = experiment.runs[0].payload, experiment.runs[1].payload
    assert first is not None
    assert second is not None
    assert first.parameters == {"mx": 0.1, "zz": 1e-2}
    assert second.mass is None


@pytest.mark.parametrize("written", ["none", "null", "{}"])
def test_no_payload_may_be_written(folder: Path, written: str) -> None:
    assert read(folder, GOOD.replace("log: free.csv", f"log: free.csv, payload: {written}")).runs[0].payload is None


# name, text to replace in GOOD, its replacement, what the error says
BAD = [
    ("no runs", "runs:\n", "rums:\n", "line 4, rums: unknown key 'rums'; did you mean 'runs'?"),
    ("key of no kin", "runs:\n", "foo:\n", "line 4, foo: unknown key 'foo'; choose from drives, preparation"),
    ("a folder", "robot: orthoglide", "robot: ../", "is a folder, not a file; give the path of a file"),
    ("no robot", "robot: orthoglide\n", "", "the key 'robot' is missing; add it"),
    ("three keys", GOOD, "units: {}\n", "the keys 'robot', 'signals' and 'runs' are missing; add them"),
    ("no payload in words", "payload: {name: steel, mass: 1.983}", "payload: nothing", "lines under it, not 'nothing'"),
    ("empty runs", GOOD[GOOD.index("runs:") : GOOD.index("validation")], "runs: []\n", "0 values are written"),
    ("misspelt key", "position:", "postion:", "signals.postion: unknown key 'postion'; did you mean 'position'?"),
    ("time is a group", "time: t", "time: {rat: 5}", "signals.time.rat: unknown key 'rat'; did you mean 'rate'?"),
    ("rate no number", "time: t", "time: {rate: fast}", "signals.time.rate: 'fast' is not a number"),
    ("rate zero", "time: t", "time: {rate: 0}", "signals.time.rate: 0 is out of range"),
    ("no current", ", current: {11: v1, 12: v2}", "", "give the columns of either 'current' or 'torque'"),
    ("both", "current: {", "torque: {11: a, 12: b}, current: {", "give the columns of either 'current' or 'torque'"),
    ("current lacks", "{11: v1, 12: v2}", "{11: v1}", "joint '12' has a position but no current"),
    ("current extra", "{11: v1, 12: v2}", "{11: v1, 12: v2, 13: v3}", "joint '13' has a current but no position"),
    ("one column twice", "12: q12", "12: q11", "the column 'q11' is given for joints '11' and '12'"),
    ("a list of columns", "{11: q11, 12: q12}", "[q11, q12]", "signals.position: write 'key: value' lines"),
    ("joint twice", "12: q12", "11: q12", "line 2: the key '11' is written twice"),
    ("unknown unit", "runs:", "units: {position: degC}\nruns:", "units.position: write 'rad', 'deg', 'm' or 'mm'"),
    ("unit of a stranger", "runs:", "units: {position: {13: m}}\nruns:", "units: the signals have no joint '13'"),
    ("unit unread", "runs:", "units: {torque: N m}\nruns:", "a unit of 'torque' is given, but the signals hold"),
    ("gain of a stranger", "{11: 2001,", "{21: 2001,", "prior_gains: the signals have no joint '21'"),
    ("gain zero", "{11: 2001,", "{11: 0,", "the gain of joint '11' is zero"),
    ("gain a word", "{11: 2001,", "{11: high,", "line 3, prior_gains.11: 'high' is not a number"),
    ("gain's spread", "{11: 2001,", "{11: {value: 2001, std: -3},", "prior_gains.11.std: -3 is out of range"),
    ("gain infinite", "{11: 2001,", "{11: inf,", "prior_gains.11: 'inf' is not a number"),
    ("log missing", "log: free.csv", "log: fre.csv", "fre.csv'; did you mean 'free.csv'?"),
    ("log missing, no match", "log: free.csv", "log: a/b.csv", "paths are relative to the file that names them"),
    ("three logs", "log: free.csv", "log: [a, b, c]", "runs.1.log: 3 values are written; write at most 2"),
    ("log twice", "log: loaded.csv", "log: free.csv", "is listed twice; remove one of them"),
    ("payload unnamed", "{name: steel, mass: 1.983}}\nval", "{mass: 1.983}}\nval", "the key 'name' is missing"),
    ("payload of two lines", "name: steel", 'name: "a\\nb"', r"the name 'a\nb' holds U+000A, a non-printing character"),
    ("mass alone", "{name: steel, mass: 1.983}", "1.983", "not '1.983'; its keys are center, mass, mass_std, name, "),
    ("mass zero", "mass: 1.983", "mass: 0", "runs.2.payload.mass: 0 is out of range"),
    ("mass negative", "mass: 1.983", "mass: -1", "payload.mass: -1 is out of range"),
    ("mass in words", "mass: 1.983", "mass: 1.983 kg", "payload.mass: '1.983 kg' is not a number"),
    ("mass_std alone", "mass: 1.983", "mass_std: 0.1", "'mass_std' is given without 'mass'"),
    ("mass_std negative", "mass: 1.983", "mass: 1.983, mass_std: -1", "mass_std: -1 is out of range"),
    ("parameter m", "mass: 1.983", "parameters: {m: 2}", "write the mass as 'mass'"),
    ("parameter fv", "mass: 1.983", "parameters: {fv: 2}", "a payload has no parameter 'fv'; choose from xx xy"),
    ("same name, other mass", "1.983}}\nval", "1.9}}\nval", "the payload 'steel' is described differently in two runs"),
    ("nothing after a key", "log: free.csv", "log: ", "nothing is written after 'log'"),
    (
        "require a share",
        "runs:",
        "require: {torque_error: 5}\nruns:",
        "require.torque_error: write per cent, such as '5 %'",
    ),
    ("require nothing", "runs:", "require: {torque_error: 0 %}\nruns:", "write a number above 0"),
    ("a tag", "time: t", "time: !!python/name:os.system t", "the tag"),
    ("a torn bracket", "{log: free.csv}", "{log: free.csv", "this is not valid YAML"),
]


@pytest.mark.parametrize(("old", "new", "sentence"), [case[1:] for case in BAD], ids=[case[0] for case in BAD])
def test_a_bad_file_is_refused_in_one_sentence(folder: Path, old: str, new: str, sentence: str) -> None:
    assert old in GOOD
    with pytest.raises(GtauError) as refusal:
        read(folder, GOOD.replace(old, new, 1))
    assert sentence in str(refusal.value)
    assert str(refusal.value).startswith(str(folder / "experiment.yaml"))
    assert "\n" not in str(refusal.value)


def test_the_file_itself_is_missing(tmp_path: Path) -> None:
    with pytest.raises(GtauError, match="cannot be read"):
        read_experiment(tmp_path / "none.yaml")


ARM = Robot("arm", (Joint("11", "ground", "prismatic"), Joint("12", "11", "revolute")))


@pytest.mark.parametrize(
    ("robot", "units", "sentence"),
    [
        (Robot("r", ARM.joints[:1]), "", "names the joint '12', but the actuated joints of robot 'r' are 11"),
        (Robot("r", (*ARM.joints, Joint("13", "12", "revolute"))), "", "lacks the actuated joint '13'"),
        (ARM, "units: {position: deg}\n", "units.position is 'deg' for joint '11', which is prismatic; write m or mm"),
        (ARM, "units: {position: {12: mm}}\n", "is 'mm' for joint '12', which is revolute; write rad or deg"),
    ],
)
def test_the_robot_must_suit_the_signals(folder: Path, robot: Robot, units: str, sentence: str) -> None:
    with pytest.raises(GtauError) as refusal:
        check_robot(read(folder, GOOD + units), robot)
    assert sentence in str(refusal.value)


def test_only_the_robot_of_another_kind_is_refused(folder: Path) -> None:
    experiment = read(folder, GOOD + "units: {position: {11: mm, 12: deg}}\n")
    assert check_robot(experiment, ARM) is None
    with pytest.raises(GtauError, match="mm"):
        check_robot(experiment, replace(ARM, joints=tuple(replace(joint, kind="revolute") for joint in ARM.joints)))
