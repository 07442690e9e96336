"""The example of the page on extensions is installed beside gtau, as another distribution, and used."""

from __future__ import annotations

import re
import shutil
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import GAINS, Plant, write_experiment
from models_to_export import model_of
from typer.testing import CliRunner

import gtau
from gtau.cli.commands import app
from gtau.extensions import registered
from gtau.signals.reading.logs import read_log

ROOT = Path(__file__).parents[2]
PAGE, EXAMPLE = ROOT / "docs" / "lookup" / "extending.md", ROOT / "examples" / "extension"


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[object]:
    """Yield a function that installs a distribution of these entry points, by group."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def distribution(points: dict[str, dict[str, str]]) -> None:
        info = tmp_path / "my_lab-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-lab\nVersion: 1.0\n")
        groups = (f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in names.items()) for group, names in points.items())
        (info / "entry_points.txt").write_text("\n".join(groups))
        registered.cache_clear()

    yield distribution
    registered.cache_clear()


@pytest.fixture
def my_lab(tmp_path: Path, install) -> None:
    """Copy the example, whose files the page links to."""
    shutil.copytree(EXAMPLE, tmp_path, dirs_exist_ok=True)
    links = re.findall(r"examples/extension/([\w/.]+)\)", PAGE.read_text(encoding="utf-8"))
    files = {path.relative_to(EXAMPLE).as_posix() for path in EXAMPLE.rglob("*.*") if path.suffix != ".pyc"}
    assert {name for name in files if "__init__" not in name} == set(links)
    install(tomllib.loads((tmp_path / "pyproject.toml").read_text())["project"]["entry-points"])


@pytest.mark.usefixtures("my_lab")
def test_an_export_is_added(tmp_path: Path) -> None:
    result = model_of(gtau.load_robot("five-bar"), consistent=False)
    exported = gtau.export_model(result, "gains-ini", tmp_path / "out")
    (file,) = exported.files
    assert file.read_text().splitlines()[1] == f"left = {result.drive_gains['left'].value!r} ; N m/A"
    assert exported.notes
    said = " ".join(CliRunner().invoke(app, ["export", "--help"]).output.split())
    assert "fmu, gains-ini, isaaclab" in said


@pytest.mark.usefixtures("my_lab")
def test_a_log_format_is_added(tmp_path: Path) -> None:
    rows = np.random.default_rng(0).normal(size=(250_000, 2))
    log = tmp_path / "log.RAW"
    log.write_bytes(b"t q1\n" + rows.tobytes())
    assert np.array_equal(read_log(log, ["q1"]).arrays()["q1"], rows[:, 1])


@pytest.mark.usefixtures("my_lab")
def test_robots_are_added() -> None:
    assert gtau.load_robot("pendulum").actuated == ("swing",)
    assert "our laboratory" in CliRunner().invoke(app, ["robot"]).output


@pytest.mark.usefixtures("my_lab")
def test_an_estimator_is_added(tmp_path: Path) -> None:
    pooled = gtau.identify(write_experiment(tmp_path, Plant(noise=0.01)), method="pooled")
    assert pooled.method == "pooled"
    assert [gain.value for gain in pooled.drive_gains.values()] == pytest.approx(GAINS, rel=0.01)
    pooled.save(tmp_path / "model.json")
    assert gtau.load(tmp_path / "model.json").summary(True) == pooled.summary(True)


@pytest.mark.parametrize(("value", "why"), [("no_such_module:X", "ModuleNotFoundError"), ("math:pi", "of type float")])
def test_a_broken_one_is_named_where_it_is_asked_for(install, tmp_path: Path, value: str, why: str) -> None:
    install({"gtau.exports": {"mine": value}, "gtau.estimators": {"mine": value}, "gtau.robots": {"mine": value}})
    result = model_of(gtau.load_robot("five-bar"), consistent=False)
    gtau.export_model(result, "csv", tmp_path / "out")
    named = rf"entry point 'mine' of gtau\.\w+ of the distribution my-lab \({value}\) .*{why}"
    with pytest.raises(gtau.GtauError, match=named):
        gtau.export_model(result, "mine", tmp_path / "out")
    with pytest.raises(gtau.GtauError, match=named):
        gtau.identify(write_experiment(tmp_path, Plant()), method="mine")
    with pytest.raises(gtau.GtauError, match=named):
        gtau.load_robot("no-such-robot")
