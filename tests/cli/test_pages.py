"""The documents: what they show runs, and they name every key."""

from __future__ import annotations

import csv
import json
import re
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
import yaml
from five_bar_logs import EXPERIMENT, STEEL, Plant, write_log
from pydantic import BaseModel, ValidationError
from typer.testing import CliRunner

from gtau.cli.commands import app
from gtau.excitation.design_file import DesignFile
from gtau.robots.readers.read import catalog_names, read_robot
from gtau.signals.reading.columns import SampleRate, Signals
from gtau.signals.reading.experiment import Experiment, read_experiment
from gtau.signals.reading.statements import Drive, Payload, Prior
from gtau.signals.reading.units import Units
from gtau.simulation.closed_loop import JointHardware
from gtau.simulation.simulate import Friction, SimulatedRun, Simulation
from gtau.simulation.trajectories import Fourier, MotionEntry, Points, RandomMotion

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
LEAD = {"m": 0.8, "mx": 0.1, "my": -0.05, "zz": 0.03}


def blocks(page: Path, language: str) -> list[str]:
    """The code blocks of a page in a language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


def run(*arguments: str) -> str:
    result = CliRunner().invoke(app, list(arguments), catch_exceptions=False)
    assert result.exit_code == 0, result.stderr
    return result.stdout


@pytest.mark.parametrize(
    ("page", "models"),
    [
        ("lookup/experiment-file.md", [Experiment, Signals, SampleRate, Units, Payload, Prior, Drive]),
        (
            "lookup/simulation-file.md",
            [Simulation, JointHardware, RandomMotion, Points, Fourier, MotionEntry, SimulatedRun, Friction],
        ),
    ],
)
def test_a_page_names_every_key(page: str, models: list[type[BaseModel]]) -> None:
    examples = "\n".join(blocks(DOCS / page, "yaml"))
    text = (DOCS / page).read_text(encoding="utf-8")
    for model in models:
        for key in model.model_fields:
            assert re.search(rf"\b{key}:", examples) or re.search(rf"`[^`\n]*\b{key}\b[^`\n]*`", text), key


@pytest.mark.parametrize(
    ("page", "which"),
    [
        ("lookup/experiment-file.md", Experiment),
        ("lookup/simulation-file.md", Simulation),
        ("lookup/design-file.md", DesignFile),
    ],
)
def test_what_an_example_has_as_a_comment_is_a_key_at_its_place(page: str, which: type[BaseModel]) -> None:
    """Each ``# key: value`` is one that the file may have there: uncommented, the file has no unknown key."""
    example, *_ = blocks(DOCS / page, "yaml")
    lines = example.splitlines()
    for k, line in enumerate(lines):
        if found := re.fullmatch(r"( *)# (\w+: .*)", line):
            others = [each for each in lines[:k] if not re.match(rf"{found[1]}{found[2].split(':')[0]}:", each)]
            text = "\n".join([*others, found[1] + found[2], *lines[k + 1 :]])
            try:
                which.model_validate(yaml.safe_load(text))
            except ValidationError as error:
                unknown = [each["loc"] for each in error.errors() if each["type"] == "extra_forbidden"]
                assert not unknown, (line, unknown)


def test_recipes_have_experiments_whose_keys_and_joints_are_right(tmp_path: Path) -> None:
    """Each is read; where its robot is one of the catalog, its joints are those with motors."""
    found, in_catalog = 0, catalog_names()
    for page in sorted([*(DOCS / "do").glob("*.md"), *(DOCS / "lookup/robots").glob("*.md")]):
        for text in blocks(page, "yaml"):
            entries = yaml.safe_load(text)
            if not {"robot", "signals", "runs"} <= set(entries):
                continue
            (tmp_path / "experiment.yaml").write_text(text)
            robot = entries["robot"]["file"] if isinstance(entries["robot"], dict) else entries["robot"]
            logs = [each["log"] for key in ("runs", "validation") for each in entries.get(key, [])]
            for file in [robot, *np.hstack(logs)]:  # files of the reader's own
                if file not in in_catalog:
                    (tmp_path / file).touch()
            experiment = read_experiment(tmp_path / "experiment.yaml")
            found += 1
            if robot in in_catalog and experiment.signals.preset is None:
                actuated = read_robot(robot).actuated
                assert set(experiment.signals.position) == set(actuated), page.name
    assert found >= 15


def test_the_experiment_of_the_page_is_identified(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plant = Plant(noise=0.005)

    def log(name: str, seed: int, payload: dict | None = None) -> None:
        run_ = plant.run(name, payload=payload, seed=seed)
        columns = [1e3 * run_.time, np.degrees(run_.position[:, 0]), run_.position[:, 1], *(1e3 * run_.command.T)]
        names = ["t", "q1", "q2", "v1", "v2"]
        parts = {f"{name}.csv": slice(0, 5)}
        if name == "loaded":
            parts = {"positions.csv": slice(0, 3), "currents.csv": slice(3, 5)}
        for file, part in parts.items():
            header = ";".join(names[part])
            np.savetxt(tmp_path / file, np.column_stack(columns[part]), "%.9g", ";", header=header, comments="")

    log("free_1", 1)
    log("free_2", 2)
    log("loaded", 3, STEEL)
    log("unknown", 4, LEAD)
    log("check", 5)
    text, *_ = blocks(DOCS / "lookup/experiment-file.md", "yaml")
    monkeypatch.chdir(tmp_path)
    Path("experiment.yaml").write_text(text)
    found = json.loads(run("identify", "experiment.yaml", "--out", "result", "--json"))
    assert found["runs"] == ["free_1", "free_2", "positions", "unknown"]
    assert [gain["value"] for gain in found["drive_gains"]] == pytest.approx(plant.gains, rel=0.01)
    weighed = {each["name"]: each["parameters"]["m"]["value"] for each in found["payloads"]}
    assert weighed["lead"] == pytest.approx(LEAD["m"], rel=0.03)
    (errors,) = json.loads(run("validate", "result/model.json", "experiment.yaml", "--json"))["runs"]
    assert max(each["relative"] for each in errors["joints"]) < 1


@pytest.mark.slow
def test_the_simulation_of_the_page_is_identified(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text, *_ = blocks(DOCS / "lookup/simulation-file.md", "yaml")
    monkeypatch.chdir(tmp_path)
    Path("simulation.yaml").write_text(text)
    run("simulate", "simulation.yaml", "--out", "simulated")
    truth = yaml.safe_load(text)
    found = json.loads(run("identify", "simulated/experiment.yaml", "--json"))
    for gain in found["drive_gains"]:
        assert gain["value"] == pytest.approx(truth["drives"][gain["joint"]]["gain"], rel=0.01)
    weighed = {each["name"]: each["parameters"]["m"]["value"] for each in found["payloads"]}
    assert weighed["lead"] == pytest.approx(0.8, rel=0.03)
    assert "control" not in Path("simulated/experiment.yaml").read_text()


@pytest.mark.slow
def test_what_is_designed_is_simulated_and_identified(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = DOCS / "do/simulate.md"
    design, simulation = blocks(page, "yaml")
    (commands,) = blocks(page, "console")
    monkeypatch.chdir(tmp_path)
    Path("design.yaml").write_text(design)
    Path("simulation.yaml").write_text(simulation)
    excite, simulate, check, identify = (line.split("#")[0].split()[2:] for line in commands.splitlines())
    run(*excite)
    run(*simulate)
    run(*check)
    found = json.loads(run(*identify, "--json"))
    truth = yaml.safe_load(simulation)["drives"]
    shown = re.findall(r"([\d.]+) ± ([\d.]+) ", page.read_text(encoding="utf-8"))
    for gain, (value, half) in zip(found["drive_gains"], shown, strict=True):
        assert abs(gain["value"] - truth[gain["joint"]]["gain"]) < 4 * gain["std"]
        assert gain["value"] == pytest.approx(float(value), abs=gain["std"])
        assert (gain["interval"][1] - gain["interval"][0]) / 2 == pytest.approx(float(half), rel=0.15)
        assert gain["rel_std"] < 1  # the design foretells 0.5 % and 0.2 %
    for delay in found["delays"]:  # none was put in, and a current is held for one sample
        assert abs(delay["value"] - 0.5 / 500) < 4 * delay["std"]


def commands() -> dict[str, dict[str, str]]:
    """What the table of the commands' keys says of each, by command."""
    told: dict[str, dict[str, str]] = defaultdict(dict)
    with (DOCS / "lookup/json-keys.csv").open(encoding="utf-8", newline="") as file:
        for command, names, what in list(csv.reader(file))[1:]:
            told[command] |= dict.fromkeys(names.split(", "), what)
    return told


def keys(heading: str) -> set[str]:
    """The keys in the first list under a heading of the page on results, or of a command."""
    if heading.startswith("gtau "):
        return set(commands()[heading])
    text = (DOCS / "lookup/results.md").read_text(encoding="utf-8")
    section = re.split(rf"^#+ {re.escape(heading)}$", text, flags=re.MULTILINE)[1]
    lines = re.search(r"(^- .*\n)+", section, re.MULTILINE)
    assert lines is not None
    named = re.findall(r"^- (`.*?`): ", lines[0], re.MULTILINE)
    return {key for names in named for key in re.findall(r"`(\w+)`", names)}


def documented(heading: str, document: dict) -> None:
    assert keys(heading) == set(document), heading


def named(heading: str, key: str, document: dict) -> None:
    """Every key of a part of a document stands in the line that describes the part."""
    if heading.startswith("gtau "):
        assert set(document) <= set(re.findall(r"\w+", commands()[heading][key])), (heading, key)
        return
    text = (DOCS / "lookup/results.md").read_text(encoding="utf-8")
    section = re.split(rf"^#+ {re.escape(heading)}$", text, flags=re.MULTILINE)[1]
    line = re.search(rf"^- `{key}`: .*$", section, re.MULTILINE)
    assert line is not None
    assert set(document) <= set(re.findall(r"`(\w+)`", line[0])), (heading, key)


@pytest.fixture(scope="module")
def five_bar(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with an experiment, and one in which a payload is to be weighed."""
    folder, plant = tmp_path_factory.mktemp("five-bar"), Plant(noise=0.01)
    for seed, (name, payload) in enumerate([("free", None), ("loaded", STEEL), ("check", STEEL), ("unknown", LEAD)]):
        write_log(folder / f"{name}.csv", plant.run(name, payload=payload, seed=seed + 1))
    (folder / "experiment.yaml").write_text(EXPERIMENT)
    (folder / "weighing.yaml").write_text(
        EXPERIMENT.replace("loaded.csv, payload: {name: steel, mass: 1.2}", "unknown.csv, payload: {name: lead}")
    )
    return folder


@pytest.mark.usefixtures("two_estimators")
def test_the_page_on_results_names_the_keys_that_are_written(five_bar: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(five_bar)
    model = json.loads(run("identify", "experiment.yaml", "--out", "result", "--consistent", "--json"))
    assert model == json.loads(Path("result/model.json").read_text())
    written = {path.name for path in Path("result").iterdir()}
    assert written == {"report.html", "model.json", "summary.txt"}
    documented("model.json", model)
    estimate = {key: each for key, each in model["drive_gains"][0].items() if key not in ("joint", "scale")}
    documented("An estimate", estimate)
    assert {"joint"} ^ set(model["delays"][0]) == set(estimate)
    assert keys("An estimate") | keys("A parameter") == set(model["parameters"][0])
    documented("A payload", model["payloads"][0])
    assert set(model["payloads"][0]["parameters"]["mx"]) == {*estimate, "name", "known", "regrouping"}
    documented("A torque error", model["residuals"][0])
    documented("standard", model["standard"])
    for key in ("preparation", "covariance"):
        named("model.json", key, model[key])
    named("model.json", "singularities", model["singularities"][0])
    for key in ("parameters", "drive_gains", "moves"):
        named("standard", key, model["standard"][key][0])
    named("standard", "payloads", model["standard"]["payloads"][0])
    gain = model["drive_gains"][0]
    assert gain["rel_std"] == pytest.approx(100 * gain["std"] / gain["value"])

    (validated,) = json.loads(run("validate", "result/model.json", "experiment.yaml", "--json"))["runs"]
    named("gtau validate", "runs", validated)
    assert set(validated["joints"][0]) == keys("A torque error")
    documented("gtau payload", json.loads(run("payload", "result/model.json", "weighing.yaml", "--json")))
    compared = json.loads(run("compare", "experiment.yaml", "--json"))
    documented("gtau compare", compared)
    named("gtau compare", "estimators", compared["estimators"][0])
    checked = json.loads(run("check", "experiment.yaml", "--json"))
    documented("gtau check", checked)
    named("gtau check", "logs", checked["logs"][0])
    documented("gtau robot", json.loads(run("robot", "five-bar", "--json")))


def test_check_names_its_joints_and_what_is_to_be_weighed(five_bar: Path, tmp_path: Path) -> None:
    from gtau.report.charts import figure_of
    from gtau.report.logs import check_page, motion_chart
    from gtau.result import check

    checked = check(five_bar / "weighing.yaml")
    (logs,) = (each.items[0] for each in check_page(checked).sections if each.id == "logs")
    assert [(row[0], row[1], row[2]) for row in logs.rows][:2] == [
        ("free", "identification", "no payload"),
        ("unknown", "identification", "'lead' of unknown mass"),
    ]
    figure = figure_of(motion_chart(checked.logs[0], checked.robot))
    (key,) = figure.legends  # beside the curves, not on them
    assert [text.get_text() for text in key.get_texts()][:2] == ["joint left", "joint right"]
    assert figure.axes[0].get_title(loc="left") == "free"


def test_a_chart_of_torques_is_titled_with_its_run() -> None:
    from gtau.report.charts import figure_of
    from gtau.report.torques import torques_chart
    from gtau.signals.preparation.filters import Decimator
    from gtau.uses.prediction import Prediction

    time, torques = np.linspace(0.0, 1.0, 50), np.ones((50, 2))
    kept = np.ones((50, 2), dtype=bool)
    kept[10:20, 0] = False
    prediction = Prediction(
        ("left", "elbow_joint"),
        ("N m", "N"),
        time,
        torques * [1.1, 1.01],
        torques,
        kept,
        kept,
        0 * torques,
        Decimator(1),
    )
    chart = torques_chart(prediction, "current", time, title="loaded")
    labels = [panel.y.label for panel in chart.panels]
    assert labels == ["torque, N m", "residual, N m", "force, N", "residual, N"]
    assert [each.label for each in chart.panels[0].series] == ["measured (current × gain)", "predicted"]
    np.testing.assert_allclose(chart.panels[1].series[0].y, -0.1)
    np.testing.assert_allclose(chart.panels[0].shaded, time[[10, 20]])
    titles = [axes.get_title(loc="left") for axes in figure_of(chart).axes]
    assert titles == ["loaded: joint left", "", "elbow_joint", ""]
