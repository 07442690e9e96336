"""Predictions follow fast motion up to where the noise of the positions takes over, and are judged by raw torques."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import gtau
from gtau.estimation.regression.rows import stop
from gtau.model.home import load_robot
from gtau.signals.preparation.filters import position_filter
from gtau.signals.run import Run

RATE = 1000.0
MASS, VISCOUS, COULOMB, OFFSET = 95.1, 203.5, 20.4, -3.2
STEP = 1e-6  # m, of the encoder


def drive(seed: int, pulse: float = 0.0) -> Run:
    """Move a carriage to and fro for 16 s; pulses of 25 ms accelerate it by up to ``pulse``, m/s2, every 0.25 s."""
    rng, time = np.random.default_rng(seed), np.arange(16 * int(RATE)) / RATE
    a = np.zeros_like(time)
    for k, way in enumerate(rng.uniform(0.05, 0.12, 8) * (-1.0) ** np.arange(8)):
        a += 2 * np.pi * way * np.sin(2 * np.pi * np.clip(time - 2 * k, 0, 1))
    for k, begin in enumerate(np.arange(0.1, 15.8, 0.25)):
        a += pulse * (-1.0) ** k * np.sin(np.pi * np.clip((time - begin) / 0.025, 0, 1)) ** 2
    v = np.cumsum(a) / RATE
    q = np.cumsum(v) / RATE
    rubbing = COULOMB * stop(q, np.array([3e-5]), np.zeros(1))[0]
    force = MASS * a + VISCOUS * v + rubbing + OFFSET + rng.normal(size=len(time))
    joint = load_robot("emps").actuated[0]
    q = STEP * np.round(q / STEP)
    return Run(f"seed {seed}", (joint,), time, q[:, None], force[:, None], kind="torque")


@pytest.fixture(scope="module")
def result() -> gtau.Result:
    """A result of a log without a pulse."""
    return gtau.identify(load_robot("emps"), [drive(0)])


def raw_error(prediction: np.ndarray, run: Run, valid: np.ndarray) -> float:
    force = run.command[:, 0]
    return 100 * float(np.sqrt(np.mean((force - prediction)[valid] ** 2) / np.mean(force[valid] ** 2)))


def test_pulses_are_predicted_as_well_as_by_a_careful_script(result: gtau.Result) -> None:
    """Every cut-off is tried for the script, which knows the true parameters."""
    run = drive(1, pulse=1.0)
    found = result.predict(run)
    valid = found.valid[:, 0]
    scripts = []
    for cutoff in (20.0, 40.0, 80.0, 160.0):
        q, v, a = (each[:, 0] for each in position_filter(run.position, RATE, cutoff))
        rubbing = COULOMB * stop(q, np.array([3e-5]), np.zeros(1))[0]
        scripts.append(raw_error(MASS * a + VISCOUS * v + rubbing + OFFSET, run, valid))
    ours = raw_error(found.predicted[:, 0], run, valid)
    assert ours < 1.2 * min(scripts)
    assert ours < 0.3 * scripts[0]  # about the filter of identification
    (error,) = result.validate(run)
    assert error.relative_raw == pytest.approx(ours)
    (fast,) = [band for band in error.bands if band.low <= 20.0 < band.high]
    assert fast.rms < 0.1 * fast.signal


def test_positions_with_more_noise_are_filtered_more(result: gtau.Result, rng: np.random.Generator) -> None:
    run = drive(0)
    noisy = replace(run, position=run.position + 10 * STEP * rng.normal(size=run.position.shape))
    (quiet,), (low,) = (
        each.preparation.prediction_cutoffs for each in (result, gtau.identify(load_robot("emps"), [noisy]))
    )
    assert result.preparation.cutoff < quiet
    assert low < quiet / 2


def test_a_model_file_holds_the_filter_and_older_ones_predict(result: gtau.Result, tmp_path: Path) -> None:
    result.save(tmp_path / "model.json")
    again = gtau.load(tmp_path / "model.json")
    assert again.preparation == result.preparation
    document = json.loads((tmp_path / "model.json").read_text())
    del document["preparation"]["prediction_cutoffs"]
    (tmp_path / "old.json").write_text(json.dumps(document))
    old = gtau.load(tmp_path / "old.json")
    assert old.preparation.prediction_cutoffs == ()
    assert old.validate(drive(1))[0].relative_raw is not None
