"""`compare` and `identify` are one pipeline: the same gains, standard deviations and verdicts from every estimator."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import EXPERIMENT, STEEL, Plant, write_log

from gtau.errors import GtauError
from gtau.estimation.diagnostics.verdict import worst
from gtau.estimation.estimators import NAMES, estimators
from gtau.result import compare, identify


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
    monkeypatch.setattr("gtau.estimation.identify.NAMES", (method,))
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
    from gtau.cli.console import METHOD

    assert METHOD.split("|") == list(NAMES) == [each.name for each in estimators().values()]
