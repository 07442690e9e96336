"""Bad input: the files that a person might give, and the sentence that each gets.

Every case is a change to a good experiment: a folder with ``experiment.yaml`` and the logs ``free.csv``,
``loaded.csv`` and ``check.csv`` (see :mod:`five_bar_logs`). What wrong robot files, experiment files and logs
get from their own readers stands in the tests of those.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from five_bar_logs import EXPERIMENT

Content = str | bytes | None
"""Text or bytes of a file; None for one that is not there."""

IDENTIFY = ("identify", "experiment.yaml", "--out", "out")


@dataclass(frozen=True)
class Case:
    """Files to change or add, the command, and a part of what it says."""

    name: str
    says: str
    files: dict[str, Content | Callable[[str], Content]] = field(default_factory=dict)
    command: tuple[str, ...] = IDENTIFY


def experiment(*changes: tuple[str, str]) -> dict[str, Content]:
    """The experiment file with texts replaced."""
    text = EXPERIMENT
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    return {"experiment.yaml": text}


def lines(change: Callable[[list[str]], list[str]]) -> dict[str, Callable[[str], Content]]:
    """The unloaded log with its lines, the header among them, changed."""
    return {"free.csv": lambda text: "\n".join(change(text.splitlines())) + "\n"}


def numbers(change: Callable[[np.ndarray], np.ndarray], *logs: str) -> dict[str, Callable[[str], Content]]:
    """Logs, the unloaded one if none is named, with their table of numbers changed."""

    def changed(text: str) -> str:
        header, *rows = text.splitlines()
        table = change(np.array([row.split(",") for row in rows], dtype=float))
        return "\n".join([header, *(",".join(f"{x:.9g}" for x in row) for row in table)]) + "\n"

    return dict.fromkeys(logs or ("free.csv",), changed)


def column(k: int, value: Callable[[np.ndarray], np.ndarray | float]) -> dict[str, Callable[[str], Content]]:
    """The unloaded log with one column of numbers changed."""
    return numbers(
        lambda table: np.column_stack([value(x) * np.ones(len(table)) if j == k else x for j, x in enumerate(table.T)])
    )


def method(name: str) -> tuple[str, ...]:
    """The command with another estimator."""
    return (*IDENTIFY, "--method", name)


SCALE = (
    "to find the drive gains, and no run has a payload of known mass; add 'payload: {name: ..., mass: ...}' to a "
    "loaded run (--payload LOG=KG with logs), torque sensors ('joint_torque' under 'signals'), voltages ('voltage' or "
    "'duty' there), or known parameters ('priors', or 'prior_inertias' for the inertias of the robot's file), or use "
    "--method wls with prior_gains.",
    "to find the drive gains, and all runs carry the same payload; add a run without payload, or use --method wls "
    "with prior_gains.",
)
LOADED = ", payload: {name: steel, mass: 1.2}"
PRIOR = "prior_gains: {left: 2.5, right: 4.0}\n"
FREE = "log: free.csv"
TWO_R = """\
robot: two-r
joints:
  left: {antecedent: ground, alpha: pi/2, theta: q, actuated: true}
  right: {antecedent: left, d: 0.3, theta: q, home: pi/2, actuated: %s}
"""
CLOSED = "closures:\n  - connect: [{body: right, d: 0.2}, {body: ground, xyz: [0.3, 0, 0.2]}]\n"

LOGS = [
    Case("empty log", "free.csv is empty or begins with an empty line", {"free.csv": ""}),
    Case("header alone", "free.csv has 0 samples", lines(lambda x: x[:1])),
    Case("three rows", "free.csv has 3 samples; identification needs a log of several seconds", lines(lambda x: x[:4])),
    Case(
        "short runs",
        "the currents are explained as well without payload 'steel'",
        numbers(lambda x: x[:150], "free.csv", "loaded.csv"),
    ),
    Case("zeros", "free.csv: no position ever changes; give a log of a moving robot", numbers(lambda x: 0 * x)),
    Case("stuck current", "column 'v2' (joint 'right') is stuck at 0.5", column(4, lambda x: 0.5)),
    Case(
        "a joint at rest",
        "joint 'right' has 0 usable rows in all runs",
        numbers(lambda x: x * [1, 1, 0, 1, 1] + [0, 0, 1.05, 0, 0], "free.csv", "loaded.csv"),
    ),
    Case(
        "a fifth is nan",
        "has 1000 of 5000 rows with missing or non-numeric values",
        column(1, lambda x: np.where(np.arange(len(x)) % 5, x, np.nan)),
    ),
    Case("infinite", "column 'v1' holds no number (it begins with 'inf')", column(3, lambda x: np.inf)),
    Case("far out", "which is implausible for a joint or drive", column(1, lambda x: 1e100 * x)),
    Case(
        "degrees for radians",
        "its positions look like deg taken for rad; write deg under units.position",
        numbers(lambda x: x * [1, 57.3, 57.3, 1, 1]),
    ),
    Case("joints exchanged", "outside the assembly mode of home", lines(lambda x: ["t,q2,q1,v1,v2", *x[1:]])),
    Case(
        "positions and currents exchanged",
        "no joint's motion exceeds its position noise",
        lines(lambda x: ["t,v1,v2,q1,q2", *x[1:]]),
    ),
    Case(
        "noise for positions",
        "no joint's motion exceeds its position noise",
        numbers(lambda x: x * [1, 0, 0, 1, 1] + np.random.default_rng(1).normal(size=x.shape) * [0, 1e-3, 1e-3, 0, 0]),
    ),
    Case("a column renamed", "no column 'q1'; did you mean 'q_1'?", lines(lambda x: ["t,q_1,q2,v1,v2", *x[1:]])),
    Case("no header", "the file has no header, so its 5 columns are named 1 to 5", lines(lambda x: x[1:])),
    Case(
        "a column twice",
        "free.csv has 2 columns named 'q1'; rename them",
        lines(lambda x: [f"{row},{row.split(',')[1]}" for row in x]),
    ),
    Case(
        "decimal commas between commas",
        "line 2 has 10 columns where the header in line 1 has 5; correct the line (a header must name every column,",
        lines(lambda x: [x[0], *(row.replace(".", ",") for row in x[1:])]),
    ),
    Case("backwards", "so time does not advance; give the time column", lines(lambda x: [x[0], *x[:0:-1]])),
    Case(
        "a ring buffer",
        "as in a ring buffer; sort the rows by time",
        lines(lambda x: [x[0], *x[3000:], *x[1:3000]]),
    ),
    Case("time stands still", "so time does not advance; give the time column", column(0, lambda x: 0.0)),
    Case("time without numbers", "column 't' holds no number", column(0, lambda x: np.nan)),
    Case(
        "time in milliseconds",
        "give the unit of that column (units: {time: ms}, for all logs",
        column(0, lambda x: 1000 * x),
    ),
    Case("a picture", "free.csv is a picture, not a log", {"free.csv": b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 9}),
    Case(
        "Latin-1",
        "free.csv: there is no column 't'; the columns are temps écoulé, q1, q2, v1, v2.",
        {"free.csv": lambda text: text.replace("t,", "temps \xe9coul\xe9,").encode("latin-1")},
    ),
    Case("UTF-16", "free.csv: the log is text in UTF-16; save", {"free.csv": lambda text: text.encode("utf-16")}),
    Case(
        "no Parquet",
        "is not a readable Parquet file",
        {"free.parquet": b"PAR1 is not enough", **experiment((FREE, "log: free.parquet"))},
    ),
    Case("one endless line", "has 200001 columns, and at most 20000 are read", {"free.csv": "1," * 200000}),
]

EXPERIMENTS = [
    Case(
        "joints that differ",
        "joint 'left' has a position but no current, and 'lift' has a current but no position",
        experiment(("current: {left", "current: {lift")),
    ),
    Case(
        "no such robot file",
        "line 1, robot: there is no file 'robots/mine.yaml'; paths are relative to the file that names them",
        experiment(("robot: five-bar", "robot: robots/mine.yaml")),
    ),
    Case(
        "a robot file almost named",
        "line 1, robot: there is no file 'experment.yaml'; did you mean 'experiment.yaml'?",
        experiment(("robot: five-bar", "robot: experment.yaml")),
    ),
    Case(
        "no such file", "nowhere.yaml cannot be read: no such file or directory", command=("identify", "nowhere.yaml")
    ),
    Case(
        "a folder",
        "logs is a folder, not an experiment file; give the file itself.",
        {"logs/x": ""},
        ("identify", "logs"),
    ),
    Case(
        "a log for the experiment",
        "free.csv does not name its robot; give it by --robot ROBOT",
        command=("identify", "free.csv"),
    ),
    Case("not UTF-8", "the text is not UTF-8", {"experiment.yaml": b"robot: caf\xe9\n"}),
    Case("binary", "experiment.yaml", {"experiment.yaml": bytes(range(256))}),
    Case("ten megabytes", "is larger than 1 MiB", {"experiment.yaml": EXPERIMENT + "# long\n" * 1500000}),
    Case(
        "a bomb",
        "anchors (&) and aliases (*) are not read",
        {"experiment.yaml": 'a: &a ["x", "x"]\nb: &b [*a, *a]\nc: [*b, *b]\n' + EXPERIMENT},
    ),
    Case("code", "the tag", experiment(("robot: five-bar", "robot: !!python/object/apply:os.system [ls]"))),
    Case("deep", "nested more than 64 levels deep", {"experiment.yaml": "robot: " + "[" * 9000}),
    Case(
        "a key nobody reads",
        "unknown key 'payloads'; did you mean 'payload'?",
        experiment(("payload: {name: steel, mass: 1.2}}\nval", "payloads: {name: steel}}\nval")),
    ),
    Case(
        "a robot nobody knows",
        "no robot is called 'fivebar' (did you mean 'five-bar'?)",
        experiment(("five-bar", "fivebar")),
    ),
    Case(
        "a joint that the robot lacks",
        "names the joint 'lift', but the actuated joints of robot 'five-bar' are left, right",
        experiment(("left:", "lift:")),
    ),
    Case(
        "another robot's signals",
        "names the joint 'left', but the actuated joints of robot 'orthoglide' are",
        experiment(("five-bar", "orthoglide")),
    ),
    Case(
        "lengths for angles",
        "units.position is 'mm' for joint 'left', which is revolute; write rad or deg",
        experiment((PRIOR, "units: {position: mm}\n")),
    ),
    Case(
        "a log that is missing",
        "there is no file 'fre.csv'; did you mean 'free.csv'?",
        experiment((FREE, "log: fre.csv")),
    ),
    Case("a column missing in the log", "there is no column 'v3'", experiment(("right: v2", "right: v3"))),
    Case(
        "one mass, two values",
        "the payload 'steel' is described differently in two runs",
        experiment(("1.2}}\nval", "1.3}}\nval")),
    ),
    Case(
        "mass without effect",
        "have no effect of their own on any actuated joint",
        experiment(("mass: 1.2", "mass: 1e-15")),
    ),
    *(
        Case(
            f"{name} without payload",
            f"method '{name}' needs a scale {SCALE[0]}",
            experiment((LOADED, "")),
            method(name),
        )
        for name in ("ml", "tls")
    ),
    *(
        Case(
            f"{name} with one load state",
            f"method '{name}' needs runs with two different loads {SCALE[1]}",
            experiment((FREE, FREE + LOADED)),
            method(name),
        )
        for name in ("ml", "tls")
    ),
    Case("payload of unknown mass", "no run has a payload of known mass", experiment((", mass: 1.2", ""))),
    Case("wls without gains", "joint 'left' has none; add 'prior_gains'", experiment((PRIOR, "")), method("wls")),
    Case("ols without gains", "joint 'left' has none; add 'prior_gains'", experiment((PRIOR, "")), method("ols")),
    Case(
        "torques by ml without a payload",
        f"method 'ml' needs a scale {SCALE[0]}",
        experiment(("current:", "torque:"), (PRIOR, ""), (", mass: 1.2", "")),
        method("ml"),
    ),
    Case(
        "no way to make the folder",
        "experiment.yaml/out cannot be the output folder, because experiment.yaml is a file",
        command=("identify", "experiment.yaml", "--out", "experiment.yaml/out"),
    ),
    Case(
        "a file where the folder should be",
        "taken cannot be the output folder, because taken is a file",
        {"taken": "x"},
        ("identify", "experiment.yaml", "--out", "taken"),
    ),
    Case(
        "validation by a run that was used",
        "the log 'free.csv' is listed under 'runs' and under 'validation'",
        experiment(("log: check.csv, payload: {name: steel, mass: 1.2}", "log: free.csv")),
    ),
    Case(
        "no validation runs",
        "keeps no run for validation; list one under 'validation'",
        experiment((EXPERIMENT[EXPERIMENT.index("validation") :], "")),
        ("validate", "model.json", "experiment.yaml"),
    ),
]

ROBOTS = [
    Case(
        "no such robot", "no robot is called 'orthoglid' (did you mean 'orthoglide'?)", command=("robot", "orthoglid")
    ),
    Case("robot file missing", "cannot be read", command=("robot", "arm.yaml")),
    Case(
        "an experiment for a robot",
        "is an experiment file, not a robot file; use it with 'gtau check'",
        command=("robot", "experiment.yaml"),
    ),
    Case(
        "a model for the experiment",
        "model.json is a model that 'gtau identify' wrote, not an experiment file; use it with 'gtau validate",
        command=("identify", "model.json"),
    ),
    Case("a model for a robot", "not a robot file; use it with 'gtau validate", command=("robot", "model.json")),
    Case("an experiment to simulate", "not a simulation file", command=("simulate", "experiment.yaml", "--out", "out")),
    Case("an experiment to design", "not a design file", command=("excite", "experiment.yaml", "--out", "out")),
    Case(
        "a simulation for the experiment",
        "is a simulation file, not an experiment file; use it with 'gtau simulate'",
        {"experiment.yaml": "robot: five-bar\ndrives: {left: {gain: 2}}\nruns: []\n"},
    ),
    Case(
        "a design for the experiment",
        "is a design file, not an experiment file; use it with 'gtau excite'",
        {"experiment.yaml": "robot: five-bar\nperiod: 5\nruns: []\n"},
    ),
    Case(
        "a robot for the experiment",
        "is a robot file, not an experiment file; use it with 'gtau robot'",
        {"experiment.yaml": TWO_R % "true"},
    ),
    Case(
        "a fleet for the experiment",
        "is a fleet file, not an experiment file; use it with 'gtau fleet'",
        {"experiment.yaml": "experiments: [a.yaml]\n"},
    ),
    Case(
        "the folder of an experiment",
        "is a folder, not an experiment file; give the file itself, such as cell/experiment.yaml.",
        {"cell/experiment.yaml": EXPERIMENT},
        ("identify", "cell"),
    ),
    Case("an experiment for a log", "is an experiment file, not a log", experiment((FREE, "log: experiment.yaml"))),
    Case("a log for a model", "free.csv is a log, not a model", command=("payload", "free.csv", "weighing.yaml")),
    Case("a picture for a robot", "r.urdf is a picture", {"r.urdf": b"\x89PNG\r\n"}, ("robot", "r.urdf")),
    Case("a log for a robot", "free.csv is a log, not a robot file", command=("robot", "free.csv")),
    Case(
        "redundant",
        "actuation is redundant, which is not supported",
        {"r.yaml": TWO_R % "true" + CLOSED},
        ("robot", "r.yaml"),
    ),
    Case(
        "open loop",
        "the loops do not close near the home configuration",
        {"r.yaml": TWO_R % "false" + CLOSED.replace("0.3", "3")},
        ("robot", "r.yaml"),
    ),
    Case(
        "code in a number",
        "is not a number or expression",
        {"r.yaml": TWO_R.replace("0.3", "__import__('os')") % "true"},
        ("robot", "r.yaml"),
    ),
    Case(
        "entity bomb",
        "declares entities",
        {"r.urdf": '<!DOCTYPE r [<!ENTITY a "ha"><!ENTITY b "&a;&a;">]><robot name="&b;"/>'},
        ("robot", "r.urdf"),
    ),
    Case("no XML", "not valid XML", {"r.urdf": "robot: r"}, ("robot", "r.urdf")),
]


def _model(change: Callable[[str], str]) -> dict[str, Callable[[str], Content]]:
    return {"model.json": change}


VALIDATE = ("validate", "model.json", "experiment.yaml")
WEIGH = ("payload", "model.json", "experiment.yaml")
UNKNOWN = experiment((LOADED + "}\nval", ", payload: {name: lead}}\nval"))

MODELS = [
    Case(
        "no model",
        "nowhere.json cannot be read: no such file or directory",
        command=("validate", "nowhere.json", "experiment.yaml"),
    ),
    Case(
        "an experiment for a model",
        "is an experiment file, not a model that 'gtau identify' wrote",
        command=("validate", "experiment.yaml", "experiment.yaml"),
    ),
    Case("a torn model", "model.json is not a JSON file", _model(lambda text: text[:4000]), VALIDATE),
    Case("some other JSON", "model.json is not a model", _model(lambda text: '{"a": 1}'), WEIGH),
    Case(
        "nan in a model",
        "model.json is not a JSON file",
        _model(lambda text: text.replace('"value": ', '"value": NaN, "old": ', 1)),
        WEIGH,
    ),
    Case(
        "a size beyond all robots in a model",
        "model.json is damaged (1e300 is out of range)",
        _model(lambda text: text.replace('"std": ', '"std": 1e300, "old": ', 1)),
        WEIGH,
    ),
    Case("deep JSON", "model.json is not a JSON file", _model(lambda text: "[" * 100000), VALIDATE),
    Case(
        "of tomorrow",
        "model.json has the schema 'gtau-model/9', but this version reads 'gtau-model/5'",
        _model(lambda text: text.replace("gtau-model/5", "gtau-model/9")),
        VALIDATE,
    ),
    Case(
        "a key gone",
        "model.json: the key 'drive_gains' is missing; add it",
        _model(lambda text: text.replace('"drive_gains"', '"gains"')),
        VALIDATE,
    ),
    Case(
        "a joint renamed",
        "the drive gains are not of the joints left, right",
        _model(lambda text: text.replace('"joint": "left"', '"joint": "lift"')),
        WEIGH,
    ),
    Case(
        "a gain gone",
        "one of the drive gains is null",
        _model(lambda text: text.replace('"value": ', '"value": null, "old": ', 1)),
        VALIDATE,
    ),
    Case(
        "a cut-off above half the rate",
        "'preparation.cutoff' is 5000 Hz",
        _model(lambda text: re.sub('"cutoff": [^,]*', '"cutoff": 5000', text, count=1)),
        VALIDATE,
    ),
    Case(
        "noise of one joint",
        "'prediction_cutoffs' and 'position_noise' do not have a value for each joint",
        _model(lambda text: re.sub(r'"position_noise": \[[^]]*', '"position_noise": [0.0', text, count=1)),
        VALIDATE,
    ),
    Case(
        "a speed of no joint",
        "'logged_speeds' names 'nobody', which is no joint",
        _model(lambda text: re.sub(r'"logged_speeds": {\s*"left"', '"logged_speeds": {"nobody"', text)),
        WEIGH,
    ),
    Case(
        "a gain in words",
        "model.json, drive_gains.1.value: 'high' is not a number",
        _model(lambda text: text.replace('"value": ', '"value": "high", "old": ', 1)),
        VALIDATE,
    ),
    Case(
        "a parameter renamed",
        "the model lacks the base parameter 'mx_leftR'",
        _model(lambda text: text.replace("mx_leftR", "mx_lost")),
        VALIDATE,
    ),
    Case(
        "covariance of something else",
        "the covariance does not have the size of its names",
        _model(lambda text: text.replace('"gain_left"', '"gain_left", "more"')),
        WEIGH,
    ),
    Case(
        "a robot file torn",
        "is not valid YAML",
        _model(lambda text: text.replace('"robot_file": "', '"robot_file": "{')),
        VALIDATE,
    ),
    Case(
        "model of another geometry",
        "or of another geometry; give the model of this robot",
        {"mine.yaml": TWO_R % "true", **experiment(("five-bar", "mine.yaml"))},
        VALIDATE,
    ),
    Case(
        "torques for a model of currents",
        "hold torques, but the model was identified from currents",
        experiment(("current:", "torque:"), (PRIOR, "")),
        VALIDATE,
    ),
    Case("nothing to weigh", "no run has an unknown payload; leave out 'mass'", {}, WEIGH),
    Case(
        "nothing to compare with",
        "the runs cannot separate the payload from the robot itself",
        experiment((f"  - {{{FREE}}}\n", ""), (LOADED + "}\nval", ", payload: {name: lead}}\nval")),
        (*WEIGH, "--gains", "prior"),
    ),
    Case(
        "weighing without prior gains",
        "there are no 'prior_gains'; add them, or weigh with the identified gains",
        experiment((PRIOR, ""), (LOADED + "}\nval", ", payload: {name: lead}}\nval")),
        (*WEIGH, "--gains", "prior"),
    ),
    Case(
        "validation of an unknown mass",
        "carries the payload 'lead', whose mass neither the run nor the model knows",
        experiment(("check.csv" + LOADED, "check.csv, payload: {name: lead}")),
        VALIDATE,
    ),
]

ALL = [*LOGS, *EXPERIMENTS, *ROBOTS, *MODELS]
