"""The command and the function that export, and what they refuse."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from models_to_export import model_of
from typer.testing import CliRunner

import gtau
from gtau.cli.commands import app
from gtau.export.exported import HOME
from gtau.extensions import names
from gtau.model.home import load_robot


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


def test_python_takes_results_and_files(model: Path, tmp_path: Path) -> None:
    one = gtau.export_model(model, "c", tmp_path / "one")
    other = gtau.export_model(gtau.Result.load(model), "c", tmp_path / "other")
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
