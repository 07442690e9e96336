"""The command line: what it prints, writes and refuses."""

from __future__ import annotations

import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import bad_input
import click.testing
import numpy as np
import pytest
import yaml
from bad_input import Case
from five_bar_logs import DESIGN, EXPERIMENT, GAINS, JOINTS, STEEL, Plant, write_experiment, write_log
from programs import LIMIT, start, wait_until, work_of
from typer.testing import CliRunner

import gtau.estimation.experiment_runs
import gtau.estimation.identify
from gtau.cli.commands import COMMANDS, app
from gtau.cli.identification import percent
from gtau.documents.files import beside
from gtau.estimation.estimators import NAMES
from gtau.estimation.experiment_runs import read_runs
from gtau.findings import Grade
from gtau.robots.readers.read import CATALOG, catalog_names
from gtau.signals.reading.experiment import read_experiment

LEAD = {"m": 0.8, "mx": 0.1, "my": -0.05, "zz": 0.03}
WEIGHING = EXPERIMENT.replace("loaded.csv, payload: {name: steel, mass: 1.2}", "unknown.csv, payload: {name: lead}")
ESTIMATE = {"value", "std", "rel_std", "unit"}


@pytest.fixture(scope="session")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A good experiment and the model identified from it."""
    folder = tmp_path_factory.mktemp("good")
    plant = Plant(delays=(1e-3, 1e-3), noise=0.01)
    write_experiment(folder, plant)
    write_log(folder / "unknown.csv", plant.run("unknown", payload=LEAD, seed=4))
    (folder / "weighing.yaml").write_text(WEIGHING)
    arguments = ["identify", str(folder / "experiment.yaml"), "--out", str(folder / "deep" / "out"), "--verbose"]
    result = CliRunner().invoke(app, arguments)
    assert (result.exit_code, result.stderr) == (0, "")
    (folder / "printed.txt").write_text(result.stdout)
    (folder / "model.json").symlink_to(folder / "deep" / "out" / "model.json")
    return folder


@pytest.fixture
def here(good: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory with the good experiment, its logs and its model."""
    for file in good.iterdir():
        (tmp_path / file.name).symlink_to(file)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write_pair(here: Path, noise: float) -> None:
    """Replace the two logs of the experiment by ones of other noise."""
    plant = Plant(delays=(1e-3, 1e-3), noise=noise)
    for name, payload, seed in (("free", None, 1), ("loaded", STEEL, 2)):
        (here / f"{name}.csv").unlink()
        write_log(here / f"{name}.csv", plant.run(name, payload=payload, seed=seed))


def run(*arguments: str) -> click.testing.Result:
    result = CliRunner().invoke(app, list(arguments))
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def document(*arguments: str) -> dict:
    """What a command prints with --json: one document, and nothing else anywhere."""
    result = run(*arguments, "--json")
    assert result.exit_code == 0, result.stderr
    assert result.stderr == ""
    return json.loads(result.stdout)


# Results


def test_identify_writes_and_prints(here: Path) -> None:
    printed = (here / "printed.txt").read_text()
    assert {file.name for file in (here / "deep" / "out").iterdir()} == {
        "model.json",
        "report.html",
        "summary.txt",
    }
    assert (here / "deep" / "out" / "summary.txt").read_text() in printed
    assert "Drive gains" in printed
    assert re.search(r"written: \S*deep/out/model.json", printed)


def test_identify_writes_to_result_without_being_told_where_and_prints_what_it_writes(here: Path) -> None:
    assert "[default: result]" in " ".join(run("identify", "--help").stdout.split())
    printed = document("identify", "experiment.yaml")
    assert printed == json.loads((here / "result" / "model.json").read_text())
    assert (here / "result" / "report.html").exists()


def test_the_model_file_has_the_keys_that_are_promised(here: Path) -> None:
    written = json.loads((here / "model.json").read_text())
    assert written["schema"] == "gtau-model/5"
    assert written["robot"] == "five-bar"
    assert written["method"] == "ml"
    assert [gain["joint"] for gain in written["drive_gains"]] == list(JOINTS)
    for gain, true in zip(written["drive_gains"], GAINS, strict=True):
        assert gain.keys() >= ESTIMATE | {"joint"}
        assert gain["value"] == pytest.approx(true, rel=0.01)
        assert gain["rel_std"] == pytest.approx(100 * gain["std"] / gain["value"])
        assert gain["unit"] == "N m/A"
    assert len(written["parameters"]) == 25
    for parameter in written["parameters"]:
        assert parameter.keys() >= ESTIMATE | {"name", "regrouping", "essential"}
        assert parameter["unit"]
    assert 0 < sum(parameter["essential"] for parameter in written["parameters"]) < 25
    (payload,) = written["payloads"]
    assert payload["name"] == "steel"
    mass = payload["parameters"]["m"]
    assert (mass["value"], mass["std"], mass["rel_std"], mass["known"]) == (1.2, None, None, True)
    assert payload["parameters"]["mx"]["known"] is False
    assert payload["parameters"]["mx"]["rel_std"] > 0


@pytest.mark.slow
@pytest.mark.parametrize("method", ["2sls", "tls", "wls", "ols"])
def test_every_method(here: Path, method: str) -> None:
    if method == "tls":
        write_pair(here, noise=0.003)  # at 0.01 A it fails, see below
    found = document("identify", "experiment.yaml", "--method", method)
    assert found["method"] == method
    given = method in ("wls", "ols")
    for gain, true in zip(found["drive_gains"], GAINS, strict=True):
        assert gain["value"] == pytest.approx(true, rel=0.02)
        assert (gain["std"] is None) == (gain["rel_std"] is None) == (gain["freedom"] is None) == given


def test_total_least_squares_admits_that_noise_hides_the_payload(here: Path) -> None:
    """At ten rows a second and 0.012 A of noise, the smallest singular value belongs to noise; other methods manage."""
    write_pair(here, 0.012)
    result = run("identify", "experiment.yaml", "--method", "tls", "--json")
    assert result.exit_code == 3
    found = json.loads(result.stdout)
    assert found["statistics"]["singular_ratio"] < 1.2
    assert {gain["outcome"] for gain in found["drive_gains"]} == {"not identifiable"}
    shown = " ".join((here / "result" / "summary.txt").read_text().split())
    assert "total least squares cannot separate the payload from the noise" in shown
    assert "use --method ml" in shown
    assert "contradict" not in shown


@pytest.mark.parametrize("rows", [200, 300])
def test_runs_of_half_a_second_give_no_gain(here: Path, rows: int) -> None:
    """Intervals hold the true gains and are honest about their width: one that includes zero is no gain."""
    for name in ("free.csv", "loaded.csv"):
        text = (here / name).read_text().splitlines()[: rows + 1]
        (here / name).unlink()
        (here / name).write_text("\n".join(text) + "\n")
    result = gtau.identify("experiment.yaml")
    for joint, true in zip(JOINTS, GAINS, strict=True):
        low, high = result.drive_gains[joint].interval()
        assert low < true < high
        assert result.drive_gains[joint].verdict.outcome == (Grade.WEAK if low > 0 else Grade.NOT_IDENTIFIABLE)
    assert result.accepted == any(gain.verdict.outcome == Grade.WEAK for gain in result.drive_gains.values())


@pytest.mark.slow
def test_logs_of_torques_are_identified_as_they_are(here: Path) -> None:
    """Currents taken for torques have a scale; without a mass none is tested, but that the joints' differ is seen."""
    declared = EXPERIMENT.replace("current:", "torque:").replace(bad_input.PRIOR, "")
    (here / "torques.yaml").write_text(declared)
    shown = " ".join(run("identify", "torques.yaml", "--out", "scaled").stdout.split())
    assert "The arm reports 0.4" in shown
    assert "of the torque at 'left'" in shown
    scale = yaml.safe_load((here / "scaled" / "torque_scale.yaml").read_text())["torque_scale"]
    assert {joint: each["state"] for joint, each in scale.items()} == {"left": "wrong", "right": "wrong"}
    assert all(
        each["interval"][0] < true < each["interval"][1] for each, true in zip(scale.values(), GAINS, strict=True)
    )
    (here / "torques.yaml").write_text(declared.replace("{name: steel, mass: 1.2}", "{name: steel}"))
    done = run("identify", "torques.yaml", "--out", "torques", "--json")
    found = json.loads(done.stdout)
    assert (done.exit_code, found["method"], found["kind"]) == (3, "wls", "torque")
    assert "torques of 'left' in another scale than the torques of the other joints" in done.stdout
    assert {(gain["value"], gain["std"], gain["unit"]) for gain in found["drive_gains"]} == {(1.0, None, "1")}
    shown = " ".join(run("identify", "torques.yaml", "--verbose").stdout.split())
    assert "their scale was not tested" in shown
    assert not (here / "torques" / "torque_scale.yaml").exists()


def test_validate(here: Path) -> None:
    (run_,) = document("validate", "model.json", "experiment.yaml")["runs"]
    assert run_["log"] == "check"
    for error, gain in zip(run_["joints"], GAINS, strict=True):
        # The noise that is left after decimation.
        assert error["rms"] < 0.01 * gain
        assert error["relative"] == pytest.approx(100 * error["rms"] / error["signal"])
    assert "says nothing about the gains" in run("validate", "model.json", "experiment.yaml").stdout


def test_a_payload_that_the_model_does_not_know_is_a_point_mass_and_said_to_be(here: Path) -> None:
    text = EXPERIMENT.split("validation:")[0] + "validation:\n  - {log: check.csv, payload: {name: iron, mass: 1.2}}\n"
    (here / "iron.yaml").write_text(text)
    (run_,) = document("validate", "model.json", "iron.yaml")["runs"]
    (note,) = run_["notes"]
    assert note.startswith(
        "payload 'iron' is not a payload of the model ('steel'), so it is treated as a point mass of 1.2 kg"
    )
    assert "treated as a point mass" in " ".join(run("validate", "model.json", "iron.yaml").stdout.split())
    assert document("validate", "model.json", "experiment.yaml")["runs"][0]["notes"] == []


def test_logs_of_one_name_in_two_folders_are_two_runs(here: Path) -> None:
    (here / "again").mkdir()
    (here / "again" / "check.csv").symlink_to(here / "free.csv")
    (here / "two.yaml").write_text(EXPERIMENT + "  - {log: again/check.csv}\n")
    assert len(document("validate", "model.json", "two.yaml")["runs"]) == 2


@pytest.mark.parametrize("gains", ["identified", "prior"])
def test_payload(here: Path, gains: str) -> None:
    found = document("payload", "model.json", "weighing.yaml", "--gains", gains)
    (payload,) = found["payloads"]
    assert payload["name"] == "lead"
    for kind, true in LEAD.items():
        estimate = payload["parameters"][kind]
        assert estimate["known"] is False
        assert abs(estimate["value"] - true) < 4.5 * estimate["std"]
    assert payload["parameters"]["m"]["value"] == pytest.approx(0.8, abs=0.01)
    assert found["gain_uncertainty_included"] == (gains == "identified")
    table = run("payload", "model.json", "weighing.yaml", "--gains", gains).stdout
    assert "'lead'" in table
    assert ("with these gains assumed exact, 95 % interval" in " ".join(table.split())) == (gains == "prior")
    assert table.splitlines() == [line.rstrip() for line in table.splitlines()]
    assert f"Weighed with the {gains} drive gains" in table


def test_a_log_alone_is_weighed(here: Path) -> None:
    def mass_of(*logs: str) -> dict:
        (payload,) = json.loads(run("payload", "model.json", *logs, "--json").stdout)["payloads"]
        assert (payload["name"], payload["run"]) == ("unknown", "unknown")
        return payload["parameters"]["m"]

    alone = mass_of("unknown.csv", "--out", "weighed")
    assert abs(alone["value"] - LEAD["m"]) < 2.5 * alone["std"] < 0.1
    assert "payload: {name: unknown}" in (here / "weighed" / "experiment.yaml").read_text()
    beside = mass_of("unknown.csv", "free.csv", "--payload", "free.csv=0", "--out", "beside")
    assert beside["std"] < alone["std"] / 2


def test_a_payload_for_a_controller(here: Path) -> None:
    """A five-bar in a plane shows neither cz nor inertias but Izz; the frame is 0.1 m along its x."""
    arguments = ("payload", "model.json", "weighing.yaml", "--frame", "0.1 0 0 0 0 0", "--to", "ur", "--out", "weighed")
    found = document(*arguments)
    (body,) = found["bodies"]
    values = {key: each["value"] for key, each in body["parameters"].items()}
    assert values["m"] == pytest.approx(0.8, abs=0.01)
    assert values["cx"] == pytest.approx(0.1 / 0.8 - 0.1, abs=0.005)
    assert values["cy"] == pytest.approx(-0.05 / 0.8, abs=0.005)
    assert [key for key, value in values.items() if value is None] == ["cz", "Ixx", "Iyy", "Ixy", "Ixz", "Iyz"]
    (script,) = (file for file in found["files"] if file.endswith("lead.script"))
    (line,) = (each for each in Path(script).read_text().splitlines() if each.startswith("set_target_payload("))
    written = [float(number) for number in re.findall(r"-?\d+\.\d+", line)]
    assert written[:3] == pytest.approx([values["m"], values["cx"], values["cy"]], rel=5e-3)
    assert "the motion does not show cz, Ixx" in found["notes"][1]
    refused = run("payload", "model.json", "weighing.yaml", "--to", "ur", "--out", "unnamed")
    assert refused.exit_code != 0
    assert "need not be the frame of 'right_forearm'; name it by --frame" in " ".join(refused.stderr.split())
    assert not (here / "unnamed").exists()


def test_wrong_prior_gains_weigh_wrong(here: Path) -> None:
    (here / "wrong.yaml").write_text(WEIGHING.replace("left: 2.5, right: 4.0", "left: 2.25, right: 3.6"))
    weighed = {}
    for gains in ("identified", "prior"):
        (payload,) = document("payload", "model.json", "wrong.yaml", "--gains", gains)["payloads"]
        weighed[gains] = payload["parameters"]["m"]["value"]
    assert weighed["prior"] / weighed["identified"] == pytest.approx(0.9, abs=0.005)


@pytest.mark.parametrize("step", [2, 5, 20])
def test_logs_of_another_rate_than_the_model_s(here: Path, step: int) -> None:
    for name in ("free.csv", "unknown.csv", "check.csv"):
        header, *rows = (here / name).read_text().splitlines()
        (here / name).unlink()
        (here / name).write_text("\n".join([header, *rows[::step]]))
    (payload,) = document("payload", "model.json", "weighing.yaml")["payloads"]
    mass = payload["parameters"]["m"]
    assert mass["value"] == pytest.approx(0.8, abs=0.08)
    (run_,) = document("validate", "model.json", "experiment.yaml")["runs"]
    assert max(error["relative"] for error in run_["joints"]) < 10


def test_robot(here: Path) -> None:
    found = document("robot", "five-bar")
    text = json.dumps(found)
    assert "left_forearm" in text
    assert "25" in text
    assert "25" in run("robot", "five-bar").stdout
    assert "mx_left_forearm + mx_right_forearm" not in run("robot", "five-bar").stdout
    assert "mx_left_forearm + mx_right_forearm" in run("robot", "five-bar", "--verbose").stdout


def test_robot_lists_the_catalog_and_fits_a_terminal(here: Path) -> None:
    listed = run("robot").stdout
    assert all(name in listed for name in ("five-bar", "ur10e", "test-bench"))
    assert "no robot is named" in run("robot", "--save", "a.yaml").output
    assert {entry["name"] for entry in document("robot")["catalog"]} == set(catalog_names())
    for page in (listed, run("robot", "ur10e").stdout, run("robot", "orthoglide").stdout):
        assert max(map(len, page.splitlines())) <= 80


def test_a_shell_completes_commands() -> None:
    environment = os.environ | {"_GTAU_COMPLETE": "complete_bash", "COMP_WORDS": "gtau ident", "COMP_CWORD": "1"}
    program = "import sys; from gtau.cli import main; sys.argv = ['gtau']; main()"
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True)
    assert done.stdout.split() == ["identify"]
    assert "--install-completion" in run("--help").stdout


def test_a_path_too_long_for_the_system_is_echoed_short(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text(f"robot: {'9' * 5000}\n")
    program = "import sys; from gtau.cli import main; sys.argv = ['gtau', 'identify', 'a.yaml']; main()"
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 2
    assert "9... cannot be opened" in done.stderr
    assert len(done.stderr) < 200


def test_help_and_version() -> None:
    assert run("--help").exit_code == 0
    assert run("--version").stdout == f"gtau {gtau.__version__}\n"
    for command in ("identify", "validate", "payload", "robot", "demo"):
        assert run(command, "--help").exit_code == 0
    assert "'--version'?" in run("version").stderr
    assert run("-V").stdout == run("--version").stdout
    assert run("help").stdout == run("--help").stdout
    assert run("help", "identify").stdout == run("identify", "--help").stdout
    assert run("identify", "--help").stdout.endswith(
        "\nExamples:\n  gtau identify experiment.yaml\n  gtau identify empty.csv loaded_1.2kg.csv --robot arm.urdf\n"
    )
    said = run("--help").stdout
    assert all(
        f"\n{purpose}:\n" in said and all(f"\n  {each.__name__} " in said for each in group)
        for purpose, group in COMMANDS.items()
    )
    for arguments in (["nonsense"], ["identify"], ["identify", "--nonsense"], ["identify", "x", "--ratio", "0.5"]):
        result = run(*arguments)
        assert result.exit_code == 2
        assert "Traceback" not in result.stderr


@pytest.mark.parametrize(
    ("text", "read"), [("3%", 3.0), ("2.5 %", 2.5), ("4", 4.0), ("0", None), ("3 %%", None), ("nan", None)]
)
def test_an_accuracy_is_per_cent_with_or_without_the_sign(text: str, read: float | None) -> None:
    if read is not None:
        assert percent(text) == read
        return
    result = run("identify", "nowhere.yaml", "--accuracy", text)
    assert result.exit_code == 2
    assert "'--accuracy'" in result.stderr
    assert "from 0.01 to 50" in result.stderr


def test_an_unknown_method_is_told_the_known_ones(here: Path) -> None:
    result = run("identify", "experiment.yaml", "--method", "magic", "--out", "out")
    assert result.exit_code == 2
    for name in ("magic", "ml", "2sls", "tls", "wls", "ols"):
        assert name in result.stderr
    assert not (here / "out").exists()


# Logs as people have them


@pytest.mark.parametrize(
    "dress",
    [
        lambda text: text.replace("\n", "\r\n").encode(),
        lambda text: b"\xef\xbb\xbf" + text.encode(),
        lambda text: text.replace(",", ";").encode(),
        lambda text: text.replace(",", ";").replace(".", ",").encode(),
        lambda text: text.replace(",", "\t").encode(),
        lambda text: text.replace("\n", " \n").encode(),
    ],
    ids=["Windows", "BOM", "semicolons", "decimal commas", "tabs", "trailing spaces"],
)
def test_the_dress_of_a_log_changes_nothing(here: Path, dress) -> None:
    described = read_experiment(here / "experiment.yaml")
    plain = read_runs(described, described.runs)
    text = (here / "free.csv").read_text()
    (here / "free.csv").unlink()
    (here / "free.csv").write_bytes(dress(text))
    for run_, undressed in zip(read_runs(described, described.runs), plain, strict=True):
        for array in ("time", "position", "command"):
            np.testing.assert_array_equal(getattr(run_, array), getattr(undressed, array))
        assert run_.log.notes == undressed.log.notes


def test_an_experiment_file_from_windows(here: Path) -> None:
    (here / "windows.yaml").write_bytes(b"\xef\xbb\xbf" + EXPERIMENT.replace("\n", "\r\n").encode())
    assert read_experiment(here / "windows.yaml") == read_experiment(here / "experiment.yaml")


# Refusals


def place(here: Path, case: Case) -> None:
    for name, content in case.files.items():
        file = here / name
        before = file.read_text() if file.exists() else ""
        file.unlink(missing_ok=True)
        file.parent.mkdir(exist_ok=True)
        if callable(content):
            content = content(before)
            assert content != before
        if content is not None:
            file.write_bytes(content if isinstance(content, bytes) else content.encode())


def files(folder: Path) -> dict[str, int]:
    return {str(file): file.stat().st_mtime_ns for file in folder.rglob("*")}


@pytest.mark.parametrize("case", bad_input.ALL, ids=[case.name for case in bad_input.ALL])
def test_bad_input_gets_one_sentence(here: Path, case: Case) -> None:
    place(here, case)
    before = files(here)
    result = run(*case.command)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert case.says in result.stderr
    assert result.stderr.startswith("gtau: ")
    assert result.stderr.count("\n") == 1
    assert result.stderr.rstrip().endswith((".", "?"))
    assert files(here) == before


def test_the_cases_are_different() -> None:
    assert len(bad_input.ALL) >= 40
    assert len({case.name for case in bad_input.ALL}) == len(bad_input.ALL)


@pytest.mark.parametrize("command", [("identify", "experiment.yaml"), ("robot", "orthoglid"), ("validate", "a", "b")])
def test_a_refusal_is_a_document_too(here: Path, command: tuple[str, ...]) -> None:
    (here / "free.csv").unlink()
    result = run(*command, "--json")
    assert result.exit_code == 2
    assert result.stderr == f"gtau: {json.loads(result.stdout)['error']}\n"
    assert run(*command).stdout == ""


def test_no_gain_to_believe_is_an_exit_code_of_its_own(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import gtau.estimation.diagnostics.gains

    monkeypatch.setattr(gtau.estimation.diagnostics.gains, "LOST_GAIN", 1e-6)  # every deviation is too large for it
    result = run("identify", "experiment.yaml", "--out", "out")
    assert result.exit_code == 3
    written = json.loads((here / "out" / "model.json").read_text())
    assert {gain["outcome"] for gain in written["drive_gains"]} == {"not identifiable"}


def test_a_robot_is_not_written_over_what_it_was_read_from(here: Path) -> None:
    text = (CATALOG / "five-bar.yaml").read_text()
    (here / "mine.yaml").write_text(text)
    result = run("robot", "mine.yaml", "--save", str(here / "mine.yaml"))
    assert result.exit_code == 2
    assert "give it another name" in result.stderr
    assert (here / "mine.yaml").read_text() == text
    for _ in range(2):  # any other file is replaced
        assert run("robot", "mine.yaml", "--save", "other.yaml").exit_code == 0


def test_the_loops_beside_a_urdf_are_not_replaced(here: Path, shared: Path) -> None:
    for file in (shared / "parallel_models" / "5bar_linkage").iterdir():
        (here / file.name).write_bytes(file.read_bytes())
    before = (here / "robot.yaml").read_bytes()
    result = run("robot", "robot.urdf", "--save", "robot.yaml")
    assert (result.exit_code, (here / "robot.yaml").read_bytes()) == (2, before)


def test_a_figure_of_another_kind_is_refused(here: Path) -> None:
    result = run("robot", "five-bar", "--figure", "a.xyz")
    assert (result.exit_code, (here / "a.xyz").exists()) == (2, False)
    assert "let its name end in .png" in result.stderr


def test_masses_are_positive_numbers(here: Path) -> None:
    for words in (["3"], ["--payload-mass", "1,2,x"], ["--payload-mass", "1,-2"]):
        result = run("excite", "design.yaml", *words, "--out", "plan")
        assert result.exit_code == 2
        assert not (here / "plan").exists()


def test_files_of_validation(here: Path) -> None:
    (here / "again").mkdir()
    (here / "again" / "check.csv").symlink_to(here / "free.csv")
    (here / "two.yaml").write_text(EXPERIMENT + "  - {log: again/check.csv}\n")
    stdout = run("validate", "model.json", "two.yaml", "--out", "figures").stdout
    names = ["report.html", *(f"torques_check{k}.parquet" for k in ("-2", ""))]
    assert sorted(path.name for path in (here / "figures").iterdir()) == names
    assert all(f"written: figures/{name}" in stdout for name in names)


def test_a_write_that_fails_leaves_the_old_model(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (here / "out").mkdir()
    (here / "out" / "model.json").write_text("old")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    result = run("identify", "experiment.yaml", "--out", "out")
    assert result.exit_code == 2
    assert "model.json cannot be written (No space left on device)" in result.stderr
    assert [file.name for file in (here / "out").iterdir()] == ["model.json"]
    assert (here / "out" / "model.json").read_text() == "old"


def test_an_interruption_is_no_traceback(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("gtau.estimation.preconditions.reduce_runs", interrupted)
    result = run("identify", "experiment.yaml", "--out", "out")
    assert result.exit_code == 130
    assert result.stderr.startswith("gtau: interrupted")
    assert not (here / "out").exists()


# The real thing


def test_as_a_program(here: Path) -> None:
    stdout, stderr = (process := start(here, "identify", "experiment.yaml", "--json", "--out", "out")).communicate()
    assert (process.returncode, stderr) == (0, "")
    assert json.loads(stdout) == json.loads((here / "out" / "model.json").read_text())
    stdout, stderr = (process := start(here, "identify", "experiment.yaml", "--method", "foo", "--json")).communicate()
    assert process.returncode == 2
    assert json.loads(stdout)["error"] in stderr
    assert stderr == f"gtau: there is no method 'foo'; choose from {', '.join(NAMES)}.\n"


SIGNS = """
import pathlib, gtau.estimation.{module} as module
def signing(*arguments, _original=module.{function}, **options):
    pathlib.Path("begun").touch()
    for _ in range(1000):
        sorted(range(100_000))  # it is interrupted at work
    return _original(*arguments, **options)
module.{function} = signing
"""


@pytest.mark.parametrize(
    ("module", "function"), [("preconditions", "reduce_runs"), ("regression.plausibility", "prepare")]
)
def test_interrupted_as_a_program(here: Path, module: str, function: str) -> None:
    first = SIGNS.format(module=module, function=function)
    process = start(here, "identify", "experiment.yaml", "--out", "out", first=first)
    wait_until((here / "begun").exists, process)
    process.send_signal(signal.SIGINT)
    stdout, stderr = process.communicate(timeout=60)
    assert stderr == "gtau: interrupted; unfinished files were not written.\n"
    assert process.returncode == 130
    assert stdout == ""
    assert not (here / "out").exists()


LONG_COMMANDS = {
    "robot": ("robot", "chain.yaml"),  # longer than the grace after an interruption that an import swallows
    "identify": ("identify", "long.yaml", "--out", "out"),
    "simulate": ("simulate", "simulation.yaml", "--out", "out"),
    "demo": ("demo", "--out", "out"),
}
SIMULATION = """
robot: five-bar
parameters: {m_left: 1.0, m_left_forearm: 0.5, m_right: 1.0, m_right_forearm: 0.5}
drives: {left: {gain: 2.5}, right: {gain: 4.0}}
runs:
  - {name: a, trajectory: {sines: {seed: 1, duration: 100}}}
"""


@pytest.mark.slow
@pytest.mark.parametrize("command", LONG_COMMANDS)
def test_interrupted_at_any_moment(here: Path, command: str) -> None:
    write_log(here / "long.csv", Plant().run("long", seconds=300.0, seed=1))
    (here / "long.yaml").write_text(EXPERIMENT.replace("free.csv", "long.csv"))
    (here / "simulation.yaml").write_text(SIMULATION)
    joints = "".join(
        f"  j{k}: {{antecedent: {f'j{k - 1}' if k else 'ground'}, alpha: {k % 2}*pi/2, d: 0.1, theta: q}}\n"
        for k in range(45)
    )
    (here / "chain.yaml").write_text("robot: chain\njoints:\n" + joints)
    whole = min(work(here, LONG_COMMANDS[command]) for _ in range(2))  # the first one may compile
    for part in (0.1, 0.3, 0.5, 0.7):
        process = interrupted(here, LONG_COMMANDS[command], part * whole)
        before, pressed = children(), work_of(process)
        stdout, stderr = process.communicate(timeout=LIMIT)
        assert children() - before - pressed < 10  # more than it takes to end
        assert process.returncode == 130, stderr
        assert stderr.startswith("gtau: interrupted; ")
        assert stderr.count("\n") == 1
        assert stdout == ""
        assert [path for path in here.rglob(".*") if path.is_file()] == []  # no unfinished file


def children() -> float:
    """Seconds of processor time of all programs that have ended."""
    return sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])


def work(here: Path, command: tuple[str, ...]) -> float:
    """Seconds of processor time that the program takes, 8 at most."""
    before, process = children(), start(here, *command)
    wait_until(lambda: process.poll() is not None or work_of(process) > 8)
    process.kill()
    process.communicate()
    shutil.rmtree(here / "out", ignore_errors=True)
    return children() - before


def interrupted(here: Path, command: tuple[str, ...], moment: float) -> subprocess.Popen:
    """The program, interrupted after ``moment`` s of processor time, or sooner where it has ended by then."""
    sign = here / "begun"
    for earlier in (1.0, 0.85, 0.7):
        sign.unlink(missing_ok=True)
        process = start(here, *command, first=f"from pathlib import Path; Path({str(sign)!r}).touch()")
        wait_until(sign.exists, process)
        wait_until(lambda: process.poll() is not None or work_of(process) > earlier * moment)  # noqa: B023
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            return process
        process.communicate()
        shutil.rmtree(here / "out", ignore_errors=True)
    raise AssertionError(f"'{' '.join(command)}' ends in less than {0.7 * moment:.1f} s, and took longer before")


def test_an_interruption_that_is_swallowed_ends_the_program_all_the_same(here: Path) -> None:
    """As callbacks of compilers and solvers swallow it."""
    first = """
import time, gtau.cli.commands, pathlib
def swallow(*arguments, **options):
    pathlib.Path("begun").touch()
    while True:
        try:
            time.sleep(0.01)
        except KeyboardInterrupt:
            pass
import gtau.model.home
gtau.model.home.load_robot = swallow
"""
    process = start(here, "robot", "five-bar", "--json", first=first)
    wait_until((here / "begun").exists, process)
    process.send_signal(signal.SIGINT)
    stdout, stderr = process.communicate(timeout=LIMIT)
    sentence = "interrupted; unfinished files were not written."
    assert (process.returncode, stderr) == (130, f"gtau: {sentence}\n")
    assert json.loads(stdout) == {"error": sentence}


@pytest.mark.slow
def test_an_interrupted_search_is_a_result_that_says_so(here: Path) -> None:
    (here / "design.yaml").write_text(DESIGN)
    process = start(here, "excite", "design.yaml", "--out", "plan", "--starts", "1000")
    wait_until((here / "plan" / "trajectory.csv").exists, process)
    process.send_signal(signal.SIGINT)
    stdout, stderr = process.communicate(timeout=60)
    assert process.returncode == 0, stderr
    assert stderr == "gtau: stopping the search and writing the best motion so far; Ctrl-C again stops at once.\n"
    assert "the search was cut short" in stdout
    assert json.loads((here / "plan" / "design.json").read_text())["cut_short"] is True


def test_usage_errors_name_the_help_of_the_command(here: Path) -> None:
    for arguments, command in (
        (("identify", "--nonsense"), "gtau identify"),
        (("excite",), "gtau excite"),
        (("nonsense",), "gtau"),
    ):
        _, stderr = start(here, *arguments).communicate()
        assert stderr.endswith(f" See '{command} --help'.\n"), stderr
        assert stderr.count("\n") == 1
    assert run("identify", "-h").stdout == run("identify", "--help").stdout != ""


def test_a_file_for_the_folder_is_refused_before_the_work(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gtau.estimation.experiment_runs, "read_runs", None)  # would fail if it were called
    for command in ("identify", "check"):
        result = run(command, "experiment.yaml", "--out", "free.csv")
        assert result.exit_code == 2
        assert "free.csv cannot be the output folder, because free.csv is a file" in result.stderr


def test_interrupted_while_importing(here: Path) -> None:
    """Python's own imports may be what an impatient user interrupts."""
    (here / "typer.py").write_text("raise KeyboardInterrupt")
    process = start(here, "robot", "ur10e", first="import sys; sys.path.insert(0, '.')")
    sentence = "gtau: interrupted; unfinished files were not written.\n"
    assert process.communicate(timeout=60) == ("", sentence)
    assert process.returncode == 130


@pytest.mark.parametrize(
    ("error", "says", "code"),
    [("MemoryError", "out of memory; ", 2), ("KeyError(7)", "this is a bug in gtau (KeyError: 7)", 1)],
)
def test_a_failure_is_a_json_document_too(error: str, says: str, code: int, tmp_path: Path) -> None:
    fails = f"import gtau.pages; gtau.pages.titles = lambda: (_ for _ in ()).throw({error})"
    process = start(tmp_path, "docs", "--json", first=fails)
    printed, said = process.communicate(timeout=60)
    assert json.loads(printed)["error"].startswith(says)
    assert said.startswith(f"gtau: {says}")
    assert process.returncode == code


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no device that is always full")
@pytest.mark.parametrize("command", [["--help"], ["robot", "five-bar"], ["robot", "five-bar", "--json"]])
def test_a_full_disk_under_what_is_printed(tmp_path: Path, command: list[str]) -> None:
    with Path("/dev/full").open("w") as full:
        process = start(tmp_path, *command, stdout=full)
        _, said = process.communicate(timeout=60)
    assert said == "gtau: the output cannot be written (No space left on device); free some space.\n"
    assert process.returncode == 2


@pytest.mark.parametrize(("option", "value"), [("--seed", "-5"), ("--starts", "0")])
def test_numbers_of_a_search_are_not_negative(option: str, value: str, tmp_path: Path) -> None:
    result = run("excite", "design.yaml", "--out", str(tmp_path), option, value)
    assert result.exit_code == 2
    assert option in result.stderr


def test_an_output_folder_with_a_name_that_is_too_long(here: Path) -> None:
    result = run("identify", "experiment.yaml", "--out", 300 * "x")
    assert result.exit_code == 2
    assert "x... cannot be the output folder (File name too long); choose another one." in result.stderr


def test_an_output_path_through_a_missing_folder_makes_no_folder(here: Path) -> None:
    before = sorted(here.iterdir())
    for refusal in (
        run("identify", "experiment.yaml", "--out", "x/../y/../out").stderr,
        run("simulate", "simulation.yaml", "--out", "x/../y/../out").stderr,
    ):
        assert refusal == "gtau: x/../y/../out leads through x, which does not exist; write out.\n"
    assert sorted(here.iterdir()) == before


def test_paths_of_an_experiment_file_are_said_without_steps_back(here: Path) -> None:
    (here / "deep" / "er").mkdir(parents=True)
    (here / "deep" / "link").symlink_to(here / "deep" / "er")
    text = re.sub(r"(\w+\.csv)", r"../../\1", (here / "experiment.yaml").read_text())
    file = here / "deep" / "er" / "experiment.yaml"
    file.write_text(text.replace("free.csv", "gone/../lost.csv"))
    assert "there is no file 'lost.csv';" in run("check", "deep/er/experiment.yaml").stderr
    file.write_text(text)
    assert read_experiment("deep/er/experiment.yaml").runs[0].log == (Path("free.csv"),)
    (here / "er.csv").write_bytes((here / "free.csv").read_bytes())
    assert beside(Path("deep/link"), "../../er.csv") == Path("er.csv")
    (here / "other").mkdir()
    (here / "deep" / "away").symlink_to(here / "other")
    assert beside(Path("deep/away"), "../er.csv") == Path("deep/away/../er.csv")  # the link leads elsewhere


@pytest.mark.parametrize("kind", ["link", "pipe"])
def test_logs_that_are_no_files(here: Path, kind: str) -> None:
    (here / "free.csv").unlink()
    if kind == "link":
        (here / "free.csv").symlink_to("gone.csv")
    else:
        os.mkfifo(here / "free.csv")
    result = run("check", "experiment.yaml")
    assert result.exit_code == 2
    what = "a link to 'gone.csv', which does not exist" if kind == "link" else "a device or a pipe, not a file"
    assert f"'free.csv' is {what}" in result.stderr


@pytest.mark.parametrize(
    "command",
    [
        ["check", "pipe.csv", "--robot", "five-bar"],
        ["identify", "pipe.yaml"],
        ["validate", "pipe.json", "experiment.yaml"],
        ["robot", "pipe.urdf"],
    ],
)
def test_a_pipe_is_refused_and_not_waited_for(here: Path, command: list[str]) -> None:
    os.mkfifo(here / command[1])
    process = start(here, *command)
    _, said = process.communicate(timeout=60)
    assert f"{command[1]}" in said
    assert "pipe" in said.replace(command[1], "")
    assert process.returncode == 2


@pytest.mark.parametrize("command", [["check"], ["identify"], ["validate", "model.json"], ["robot"]])
def test_a_path_that_is_too_long(here: Path, command: list[str]) -> None:
    process = start(here, *command, 5000 * "x" + ".csv")
    _, said = process.communicate(timeout=60)
    assert "name too long" in said.lower()
    assert process.returncode == 2


def test_a_reader_that_goes_away(here: Path) -> None:
    process = start(here, "robot", "ur10e")
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()
    assert process.stderr.read() == ""
    process.wait(timeout=60)


@pytest.mark.parametrize("command", ["", *(each.__name__ for group in COMMANDS.values() for each in group)])
def test_help_fits_a_terminal_and_names_no_types(command: str) -> None:
    said = CliRunner().invoke(app, [*command.split(), "--help"]).stdout
    assert max(map(len, said.splitlines())) <= 80
    assert not re.search(r"<\w|  .*\.\.\.$", said, re.MULTILINE)
