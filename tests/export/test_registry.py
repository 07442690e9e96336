"""The command and the function that export, and what they refuse."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from models_to_export import model_of
from typer.testing import CliRunner

import gtau
from gtau.cli.commands import app
from gtau.estimation.diagnostics.verdict import GOOD
from gtau.export.exported import HOME
from gtau.extensions import names
from gtau.findings import Grade
from gtau.model.home import load_robot
from gtau.robots.robot import Robot


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("model") / "model.json"
    model_of(load_robot("five-bar"), consistent=False).save(path)
    return path


def test_the_command_lists_all_kinds() -> None:
    said = " ".join(CliRunner().invoke(app, ["export", "--help"]).output.split())
    assert ", ".join(names(*HOME)) in said


def test_the_command_writes_and_says_so(model: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["export", str(model), "--to", "c", "--out", str(tmp_path)])
    assert done.exit_code == 0
    assert f"written: {tmp_path / 'five_bar.h'}" in done.output
    done = CliRunner().invoke(app, ["export", str(model), "--to", "c", "--out", str(tmp_path), "--json"])
    document = json.loads(done.stdout)
    assert document["kind"] == "c"
    assert all(Path(file).is_file() for file in document["files"])


def test_notes_of_an_export_fit_a_terminal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    model_of(load_robot("five-bar"), consistent=True).save(Path("model.json"))
    for kind in ("mjcf", "urdf", "orders"):
        done = CliRunner().invoke(app, ["export", "model.json", "--to", kind, "--out", "out"])
        assert done.exit_code == 0, done.output
        assert "\n- " in done.stdout
        assert max(map(len, done.stdout.splitlines())) <= 80


def test_exports_repeat_the_verdict_on_a_model_that_is_not_known(tmp_path: Path) -> None:
    result = model_of(load_robot("five-bar"), consistent=False)

    def notes(grade: Grade) -> tuple[str, ...]:
        verdict = replace(GOOD, grade=grade, text="the gain reverses its sign")
        gains = result.drive_gains | {"left": replace(result.drive_gains["left"], verdict=verdict)}
        return gtau.export_model(result.replaced(drive_gains=gains), "c", tmp_path / "c").notes

    said = notes(Grade.CONTRADICTORY)
    assert said[0].startswith("Joint 'left' contradicts the description: the gain reverses its sign.")
    assert "'left' has no identifiable" in notes(Grade.NOT_IDENTIFIABLE)[0]
    assert gtau.export_model(result, "c", tmp_path / "c").notes == notes(Grade.WEAK) == said[1:]


def test_python_takes_results_and_files(model: Path, tmp_path: Path) -> None:
    one = gtau.export_model(model, "c", tmp_path / "one")
    other = gtau.export_model(gtau.load(model), "c", tmp_path / "other")
    assert [path.read_text() for path in one.files] == [path.read_text() for path in other.files]


@pytest.mark.parametrize(
    ("kind", "into", "sentence"),
    [
        ("C++", None, "no export to 'C\\+\\+'; choose from c"),
        ("c", "robot.urdf", "--into puts a model back into a URDF or MJCF file, not into 'c'"),
    ],
)
def test_what_cannot_be_exported_is_refused(
    model: Path, tmp_path: Path, kind: str, into: str | None, sentence: str
) -> None:
    with pytest.raises(gtau.GtauError, match=sentence):
        gtau.export_model(model, kind, tmp_path, into)


def with_odd_names() -> Robot:
    """A robot whose joints are named as people name them in CAD programs."""
    robot = load_robot("ur10e")
    odd = dict(zip(robot.bodies, ("joint 1", "Revolute 2", "J - 3", "J + 4", "5 R", "joint 6 R"), strict=True))
    joints = (
        replace(joint, name=odd[joint.name], antecedent=odd.get(joint.antecedent, joint.antecedent))
        for joint in robot.joints
    )
    return replace(robot, joints=tuple(joints))


def test_a_saved_model_has_the_same_parameters_whatever_the_names(tmp_path: Path) -> None:
    made = model_of(with_odd_names())
    made.save(tmp_path / "model.json")
    result = gtau.load(tmp_path / "model.json")
    assert list(result.parameters) == list(result.base.names)
    assert [name.regrouped for name in result.parameters] == [name.regrouped for name in made.parameters]
    q = np.full(6, 0.5)
    np.testing.assert_array_equal(result.torques(q, q, q), made.torques(q, q, q))
    for kind in ("c", "urdf", "isaaclab", "mjcf"):
        assert gtau.export_model(result, kind, tmp_path / kind).files
    sums = gtau.export_model(result, "latex", tmp_path).files[0].read_text().split("Par. & Sum")[-1]
    assert r"\mathrm{J\ -\ 3}" in sums


@pytest.mark.parametrize("kind", ["c", "urdf", "isaaclab", "mjcf"])
def test_a_refused_export_leaves_nothing(kind: str, tmp_path: Path) -> None:
    result = model_of(load_robot("ur10e"))
    lacking = result.replaced(parameters={name: e for name, e in result.parameters.items() if name.kind != "fv"})
    with pytest.raises(gtau.GtauError, match="the model lacks the base parameter 'fv_shoulder_pan_joint'"):
        gtau.export_model(lacking, kind, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_refused_draw_leaves_the_files_that_were_there(tmp_path: Path) -> None:
    result = model_of(load_robot("ur10e"))
    gtau.export_model(model_of(load_robot("ur10e"), seed=1), "urdf", tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(gtau.GtauError, match="no standard deviations to draw from"):
        gtau.export_model(result.replaced(covariance=np.zeros_like(result.covariance)), "urdf", tmp_path, samples=2)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
