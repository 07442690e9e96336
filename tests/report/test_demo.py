"""The demo, on a simulated Orthoglide."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import gtau
from gtau.cli.commands import app
from gtau.demo import COMMANDS, CONTENT, LOGS, MASSES, SIMULATION, demo
from gtau.errors import GtauError
from gtau.excitation.design_file import read_design
from gtau.model.home import load_robot
from gtau.report.terminal import plain
from gtau.robots.robot import Joint, Robot
from gtau.signals.reading.experiment import read_experiment
from gtau.signals.reading.statements import Payload
from gtau.simulation.simulate import experiment_text, read_simulation
from gtau.simulation.trajectories import envelope, point_to_point, sines


def silent(what: str, done: int, total: int) -> None:
    assert 0 <= done <= total


@pytest.fixture(scope="module")
def model() -> gtau.InverseDynamics:
    return gtau.InverseDynamics(load_robot("orthoglide"))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any], str]:
    out = tmp_path_factory.mktemp("demo")
    found, page = demo(out, silent, duration=5.0)
    return out, found, plain(page)


@pytest.mark.parametrize("plan", [sines, point_to_point])
@pytest.mark.parametrize("name", ["orthoglide", "ur10e"])
def test_trajectories_stay_in_their_envelope_and_are_consistent(plan: Any, name: str, rng: np.random.Generator) -> None:
    within = envelope(load_robot(name))
    time, step = np.arange(-200, 8201) / 1000, 1e-5
    trajectory = plan(within, 8.0, rng)
    q, qd, qdd = trajectory(time)
    used = np.array(
        [
            np.abs(each).max(axis=0) / limit
            for each, limit in ((q - within.center, within.reach), (qd, within.velocity), (qdd, within.acceleration))
        ]
    )
    assert 0.95 < used.max() < 1.01
    for outside in (time <= 0, time >= 8):
        assert np.ptp(q[outside], axis=0).max() < 1e-12
        assert np.abs(qd[outside]).max() < 1e-9
        assert np.abs(qdd[outside]).max() < 1e-6
    after, before = trajectory(time + step), trajectory(time - step)
    np.testing.assert_allclose((after[0] - before[0]) / (2 * step), qd, atol=1e-6 * np.abs(qd).max())
    np.testing.assert_allclose((after[1] - before[1]) / (2 * step), qdd, atol=2e-3 * np.abs(qdd).max())


def test_a_joint_without_limits_is_refused() -> None:
    robot = Robot("arm", (Joint("a", "ground", "revolute"),))
    with pytest.raises(GtauError, match="joint 'a' has no position limit"):
        envelope(robot)


def test_the_true_orthoglide_has_the_sums_of_the_papers_table_3(model: gtau.InverseDynamics) -> None:
    base = gtau.base_parameters(model)
    chi = SIMULATION.parameters
    value = dict(zip(base.names, base.matrix @ [chi.get(name, 0.0) for name in model.parameter_names], strict=True))
    table = {"m_11R": 9.40, "m_12R": 8.95, "m_13R": 0.87, "ia_13R": 8.05, "m_PR": 0.92, "fv_12": 86.7, "fs_13": 24.1}
    assert {name: value[name] for name in table} == pytest.approx(table, abs=1e-4)
    masses = [number for name, number in chi.items() if name.startswith(("m_", "ia_"))]
    assert min(masses) > 0


@pytest.mark.slow
def test_the_files_of_the_demo_fit_each_other(made: tuple[Path, dict[str, Any], str]) -> None:
    out, _, _ = made
    simulation = read_simulation(out / "simulation.yaml")
    (out / "simulated.yaml").write_text(experiment_text(simulation, load_robot(simulation.robot), out))
    for run in (*simulation.runs, *simulation.validation):
        (out / f"{run.name}.csv").symlink_to(out / "logs" / f"{run.name}.csv")
    try:
        simulated = read_experiment(out / "simulated.yaml")
    finally:
        (out / "simulated.yaml").unlink()
        for link in out.glob("*.csv"):
            link.unlink()
    experiment = read_experiment(out / "experiment.yaml")
    payloads = [[run.payload for run in each.runs] for each in (experiment, simulated)]
    assert payloads[1][:4] == payloads[0]
    assert payloads[1][4:] == [Payload(name="second"), None]
    assert [run.payload for run in simulated.validation] == [run.payload for run in experiment.validation]
    task, _ = read_design(out / "design.yaml")
    assert [load and load.mass for load in task.payloads] == [None, MASSES["steel"]]


@pytest.mark.slow
def test_the_demo_finds_the_gains_and_weighs_the_payload(made: tuple[Path, dict[str, Any], str]) -> None:
    _, document, text = made
    for gain in document["drive_gains"]:
        assert abs(gain["error"]) < 0.3
        assert abs(gain["value"] - gain["true"]) < 4 * gain["std"]
        assert gain["prior_error"] < -3
        assert f"{gain['value']:.1f}" in text
    second = document["second_payload"]
    assert second["identified"]["value"] == pytest.approx(1.136, abs=0.005)
    assert second["prior"]["value"] == pytest.approx(1.09, abs=0.01)


@pytest.mark.slow
def test_the_readme_shows_what_the_demo_finds(tmp_path: Path) -> None:
    """Gains to 0.05 %, standard deviations to 30 %: other processors round other samples."""
    document, _ = demo(tmp_path, silent)
    root = Path(__file__).parents[2]
    readme = (root / "README.md").read_text(encoding="utf-8")
    for gain in document["drive_gains"]:
        row = re.search(rf"^{gain['joint']} +[\d.]+ +[\d.]+ +-[\d.]+ +([\d.]+) +([\d.]+) ", readme, re.MULTILINE)
        assert row is not None
        assert [*map(float, row.groups())] == [
            pytest.approx(gain["value"], rel=5e-4),
            pytest.approx(gain["std"], rel=0.3),
        ]
    masses = [document["second_payload"][gains]["value"] for gains in ("prior", "identified")]
    assert [*map(float, re.findall(r"^with .*? gains +([\d.]+) ", readme, re.MULTILINE))] == pytest.approx(
        masses, rel=2e-3
    )


@pytest.mark.slow
def test_the_demo_writes_what_it_lists_and_nothing_else(made: tuple[Path, dict[str, Any], str]) -> None:
    out, document, text = made
    json.dumps(document, allow_nan=False)
    assert sorted(document["files"]) == sorted(str(p.relative_to(out)) for p in out.rglob("*") if p.is_file())
    assert {"logs/" if "/" in name else name for name in document["files"]} == set(CONTENT)
    assert next(iter(CONTENT)) == "report.html"
    assert (out / "README.txt").read_text(encoding="utf-8") == f"{text}\n"
    assert "same geometry" not in (out / "report.html").read_text(encoding="utf-8")  # unlike frictions are no news


@pytest.mark.slow
def test_the_printed_commands_give_the_same_numbers(
    made: tuple[Path, dict[str, Any], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out, document, _ = made
    monkeypatch.chdir(out)
    before = (out / "model.json").read_bytes()
    found = []
    for command in COMMANDS:
        done = CliRunner().invoke(app, [*command.split()[1:], "--json"])
        assert done.exit_code == 0, done.output
        found.append(json.loads(done.stdout))
    assert (out / "model.json").read_bytes() == before
    identified, validated, *weighed = found
    assert [each["value"] for each in identified["drive_gains"]] == [each["value"] for each in document["drive_gains"]]
    assert all(joint["relative"] < 1.0 for joint in validated["runs"][0]["joints"])
    for gains, each in zip(("prior", "identified"), weighed, strict=True):
        assert each["payloads"][0]["parameters"]["m"]["value"] == document["second_payload"][gains]["value"]


def test_an_interrupted_demo_leaves_no_half_written_file(tmp_path: Path) -> None:
    class Stop(Exception):
        pass

    def stop(what: str, done: int, total: int) -> None:
        if done == 1:
            raise Stop

    with pytest.raises(Stop):
        demo(tmp_path, stop, duration=3.0)
    assert [path.name for path in (tmp_path / "logs").iterdir()] == [f"{LOGS[0]}.csv"]


def test_a_figure_leaves_the_users_settings_alone_and_is_the_same_each_time(tmp_path: Path) -> None:
    matplotlib = pytest.importorskip("matplotlib")
    from gtau.estimation.results.estimate import Estimate
    from gtau.report.charts import figure_of, save_figure
    from gtau.report.gains import gains_chart

    before = dict(matplotlib.rcParams)
    matplotlib.rcParams["font.size"] = 20
    try:
        for k in range(2):
            matplotlib.rcParams["lines.linewidth"] = 1.0 + k
            figure = figure_of(gains_chart({"11": Estimate("11", 2100.0, 1.0, "N per A")}, {}))
            save_figure(figure, tmp_path / f"{k}.png")
        assert matplotlib.rcParams["font.size"] == 20
    finally:
        matplotlib.rcParams.update(before)
    assert (tmp_path / "0.png").read_bytes() == (tmp_path / "1.png").read_bytes()


@pytest.mark.slow
@pytest.mark.usefixtures("two_estimators")
def test_the_examples_of_the_readme_run_in_the_demo(
    made: tuple[Path, dict[str, Any], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, document, _ = made
    readme = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    (example,), (commands,), (snippet,) = (
        re.findall(rf"^```{language}\n(.*?)^```$", readme, re.DOTALL | re.MULTILINE)
        for language in ("yaml", "sh", "python")
    )
    for path in out.iterdir():
        (tmp_path / path.name).symlink_to(path)
    monkeypatch.chdir(tmp_path)
    Path("mine.yaml").write_text(example)
    lines = [line.split("#")[0].split() for line in commands.splitlines()]
    commands_shown = {"robot", "check", "identify", "validate", "payload", "compare", "export", "use"}
    assert {words[1] for words in lines} == commands_shown
    for words in lines:
        done = CliRunner().invoke(app, words[1:], catch_exceptions=False)
        assert (words[0], done.exit_code) == ("gtau", 0), done.output
    mine = json.loads(Path("result/model.json").read_text())
    found = {each["joint"]: each["value"] for each in document["drive_gains"]}
    assert {each["joint"]: each["value"] for each in mine["drive_gains"]} == pytest.approx(
        found
    )  # std differs: mass_std
    assert all(Path(folder, "report.html").exists() for folder in ("result", "check"))
    names: dict[str, Any] = {}
    exec(snippet, names)
    assert names["tau"].shape == (5, 3)
    assert names["W"].shape == (5, 3, len(names["idm"].parameter_names))
    assert gtau.load("again.json").drive_gains["11"].value == found["11"]
