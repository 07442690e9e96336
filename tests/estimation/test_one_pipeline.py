"""`compare` and `identify` are one pipeline: the same gains, standard deviations and verdicts from every estimator."""

from __future__ import annotations

import ast
import re
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

import numpy as np
import pytest
from five_bar_logs import EXPERIMENT, STEEL, Plant, write_log

import gtau.estimation
from gtau.errors import GtauError
from gtau.estimation import thresholds
from gtau.estimation.compare import compare
from gtau.estimation.diagnostics.verdict import worst
from gtau.estimation.estimators.registry import NAMES, estimators
from gtau.estimation.identify import identify
from gtau.estimation.thresholds import Threshold

SOURCE = Path(gtau.estimation.__file__).parent


@pytest.fixture(scope="module")
def experiment(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Logs whose torque constants fall by 8 % up to the largest currents."""
    folder, plant = tmp_path_factory.mktemp("saturating"), Plant(noise=0.02)
    for name, payload, seed in (("free", None, 1), ("loaded", STEEL, 2), ("check", STEEL, 3)):
        run = plant.run(name, 8.0, payload, seed=seed)
        share = np.abs(run.command) / np.abs(run.command).max(axis=0)
        write_log(folder / f"{name}.csv", replace(run, command=run.command * (1 + 0.08 * share)))
    (folder / "experiment.yaml").write_text(EXPERIMENT)
    return folder / "experiment.yaml"


@pytest.mark.parametrize(
    "method",
    ["ml", *(pytest.param(m, marks=pytest.mark.slow) for m in NAMES if m != "ml")],
)
def test_compare_says_what_identify_says(method: str, experiment: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gtau.estimation.compare.NAMES", (method,))
    (row,) = compare(experiment).rows
    if row.refusal:
        with pytest.raises(GtauError, match=re.escape(row.refusal)):
            identify(experiment, method=method)
        return
    result = identify(experiment, method=method)
    gains = list(result.drive_gains.values())
    np.testing.assert_allclose(row.gains, [gain.value for gain in gains], rtol=1e-12)
    if row.std is not None:
        np.testing.assert_allclose(row.std, [gain.std for gain in gains], rtol=1e-9)
        assert row.outcome == worst([gain.verdict for gain in gains])


def test_the_command_line_offers_every_estimator() -> None:
    from gtau.cli.console import METHODS

    assert METHODS.split("|") == list(NAMES) == [each.name for each in estimators().values()]


def test_every_threshold_says_what_it_rests_on() -> None:
    found = {
        f"{module.name}.{name}": value
        for module in iter_modules(thresholds.__path__)
        for name, value in vars(import_module(f"{thresholds.__name__}.{module.name}")).items()
        if name.isupper() and name != "NONE"
    }
    assert len(found) > 60
    for name, value in found.items():
        assert isinstance(value, Threshold), name
        assert value.statistic, name
        assert value.evidence, name


def test_no_threshold_stands_outside_the_tables() -> None:
    """Where outcomes are decided, numbers are compared with counts, factors of units and imported constants alone."""
    plain = {0, 1, 2, 3, 100, 1000, 0.001, 0.999}  # the last is where printed per cents round
    numerical = {"pose_fit.py", "linearisation.py"}  # whose constants are tolerances of their arithmetic
    words = {"sentences.py", "note_sentences.py"}  # which decide nothing
    named = {"NORMAL"}  # the normal distribution
    decide = {*(SOURCE / "diagnostics").rglob("*.py"), SOURCE / "regression" / "plausibility.py"}
    decide = sorted(path for path in decide if path.name not in numerical | words)
    assert len(decide) > 15
    for path in decide:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        own = {
            target.id
            for node in tree.body
            if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant)
            for target in node.targets
            if isinstance(target, ast.Name) and isinstance(node.value.value, (int, float))
        }
        for node in ast.walk(tree):
            if not isinstance(node, ast.Compare):
                continue
            for part in ast.walk(node):
                if isinstance(part, ast.Constant) and isinstance(part.value, (int, float)):
                    assert part.value in plain, f"{path.name}:{part.lineno} compares with {part.value}"
                if isinstance(part, ast.Name):
                    assert part.id not in own - named, f"{path.name}:{part.lineno}: {part.id} belongs into thresholds"
