"""Every public function has an example that runs, in a folder with the logs of the tutorial."""

from __future__ import annotations

import doctest
import inspect
from pathlib import Path

import pytest
from typer.testing import CliRunner

import gtau
from gtau.cli.commands import app
from gtau.demo import write_tutorial

SIMULATION = """
robot: five-bar
parameters: {m_left: 0.9, mx_left: 0.1, zz_left: 0.05, m_right: 1.0, mx_right: 0.1, zz_right: 0.05}
drives: {left: {gain: 2.7}, right: {gain: 3.8}}
rate: 250
runs: [{name: free, trajectory: {sines: {duration: 3}}}]
"""
DESIGN = """
robot: five-bar
runs: [{}, {payload: {name: disc, mass: 1.2}}]
rate: 250
limits: {velocity: {left: 3, right: 3}}
"""
SLOW = ("campaign", "compare", "excite")
FUNCTIONS = [name for name in gtau.__all__ if inspect.isfunction(getattr(gtau, name)) or name == "InverseDynamics"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("examples")
    write_tutorial(folder)
    (folder / "simulation.yaml").write_text(SIMULATION)
    (folder / "design.yaml").write_text(DESIGN)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        logs = ["empty_1.csv", "loaded_1200g.csv", "--robot", "five-bar"]
        assert CliRunner().invoke(app, ["identify", *logs]).exit_code == 0
        assert CliRunner().invoke(app, ["init", *logs]).exit_code == 0
    return folder


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in FUNCTIONS])
def test_an_example_runs(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    shown = inspect.getdoc(getattr(gtau, name)) or ""
    example = doctest.DocTestParser().get_doctest(shown, {"gtau": gtau}, name, None, None)
    assert example.examples, "give it an example"
    report: list[str] = []
    failed, _ = doctest.DocTestRunner(verbose=False).run(example, out=report.append)
    assert not failed, "".join(report)


def test_signatures_can_be_read() -> None:
    assert not [name for name in FUNCTIONS if " at 0x" in str(inspect.signature(getattr(gtau, name)))]
