"""Currents of one run that are out of scale, on an arm that lifts: errors that look like functions of the position."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gtau.estimation.diagnostics.hypotheses.drives import gain_changes
from gtau.estimation.diagnostics.verdict import Outcome
from gtau.estimation.estimators.maximum_likelihood import ML
from gtau.estimation.identify import identify
from gtau.estimation.regression.dataset import reduce_runs
from gtau.estimation.results.result import Result
from gtau.estimation.thresholds.refutation import DOMINANT
from gtau.findings import FindingKind as F
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.robot import Joint, Mdh, Robot
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run

ARM = Robot(
    "arm",
    (Joint("1", "ground", "revolute", Mdh()), Joint("2", "1", "revolute", Mdh(d=0.4))),
    gravity=(0.0, -9.80665, 0.0),
)
GAINS = (8.0, 5.0)


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    """Three free and three loaded runs of 8 s along sums of sines."""
    model, rng = InverseDynamics(ARM), np.random.default_rng(3)
    chi = dict.fromkeys(model.parameter_names, 0.0)
    for joint, mass in zip("12", (4.0, 2.0), strict=True):
        chi |= {f"m_{joint}": mass, f"mx_{joint}": 0.2 * mass, f"zz_{joint}": 0.06 * mass}
        chi |= {f"ia_{joint}": 0.2, f"fv_{joint}": 1.0, f"fs_{joint}": 1.0}
    time, w = np.arange(3201) / 400.0, 2 * np.pi * np.array([0.3, 0.8, 1.3])[:, None]
    logged = []
    for k in range(6):
        mass = 3.0 * (k % 2)
        angle = w * time[:, None, None] + rng.uniform(0, 2 * np.pi, (3, 2))
        path = (np.sin(angle) / w).sum(1), np.cos(angle).sum(1), (-w * np.sin(angle)).sum(1)
        carried = {"m_2": chi["m_2"] + mass, "mx_2": chi["mx_2"] + 0.1 * mass, "zz_2": chi["zz_2"] + 0.02 * mass}
        current = model.torques(*path, chi | carried) / GAINS
        current += 0.003 * current.std(axis=0) * rng.standard_normal(current.shape)
        payload = Payload(name="steel", mass=mass) if mass else None
        logged.append(Run(f"run {k}", model.actuated, time, path[0], current, payload=payload))
    return logged


def scaled(runs: list[Run], which: int, factor: float) -> list[Run]:
    return [replace(run, command=run.command * factor) if k == which else run for k, run in enumerate(runs)]


@pytest.fixture(scope="module")
def healthy(runs: list[Run]) -> Result:
    return identify(ARM, runs)


def test_runs_in_scale_are_good(healthy: Result) -> None:
    for gain, truth in zip(healthy.drive_gains.values(), GAINS, strict=True):
        assert gain.verdict.outcome == Outcome.GOOD
        assert abs(gain.value - truth) < 3 * gain.std


@pytest.mark.slow
@pytest.mark.parametrize(("which", "factor"), [(0, 1.02), (1, 1.02), (3, 0.98)])
def test_a_run_out_of_scale_is_named(which: int, factor: float, runs: list[Run], healthy: Result) -> None:
    """Not taken for ripple, which it looks like: a torque that lifts is a function of the position."""
    result = identify(ARM, scaled(runs, which, factor))
    causes = [
        each for gain in result.drive_gains.values() if gain.verdict.finding for each in gain.verdict.finding.causes
    ]
    noted = [note for note in result.notes if note.kind == F.SMALL_REFUTATION]
    changes = [each.values for each in causes if each.kind == F.GAIN_CHANGE]
    assert changes or noted
    assert all(each["runs"] == [f"run {which}"] and (each["change"] > 0) == (factor > 1) for each in changes)
    assert all(f"in run 'run {which}'" in str(note) for note in noted)
    for gain, truth in zip(result.drive_gains.values(), GAINS, strict=True):
        low, high = gain.interval() or (0.0, 0.0)
        assert low < truth < high
        assert gain.std > 20 * healthy.drive_gains[gain.name].std  # most of the interval is what the run contradicts
    assert F.RIPPLE not in {note.kind for note in result.notes}


def test_a_halved_current_is_the_cause(runs: list[Run]) -> None:
    """And not a tilt of gravity, which explains as much of one run."""
    result = identify(
        ARM, [replace(run, command=run.command * [1.0, 0.5 if k == 5 else 1.0]) for k, run in enumerate(runs)]
    )
    (cause,) = {cause.kind: cause for cause in result.drive_gains["2"].verdict.finding.causes}.values()
    assert (cause.kind, cause.joints, cause.values["runs"]) == (F.GAIN_CHANGE, ("2",), ["run 5"])


def test_the_difference_is_measured(runs: list[Run]) -> None:
    dataset = reduce_runs(ARM, scaled(runs, 2, 1.03))
    found = list(gain_changes(ML.fit(dataset.system(per_run=True))))
    assert len(found) == 2
    for each in found:
        assert each.causes[0].values["runs"] == ["run 2"]
        assert each.share > DOMINANT
    assert each.size == pytest.approx(0.03, rel=0.1)
