"""Runs that repeat a motion: found, cut in step, left out together; what their residuals have in common."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from five_bar_logs import CHI, GAINS, STEEL, Plant, five_bar

from gtau.estimation.diagnostics.repeating_residuals import repeated_motion_findings, residual_correlations
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.maximum_likelihood import ML, ml
from gtau.estimation.identify import identify
from gtau.estimation.regression.dataset import Dataset, reduce_runs
from gtau.estimation.regression.run_blocks import BLOCKS
from gtau.findings import FindingKind as F
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run

DISC = Payload(name="disc", mass=STEEL["m"])
NOISE = 0.003  # A


def cut(run: Run, first: int, last: int | None = None) -> Run:
    """The samples from ``first`` on, by a clock that begins with them."""
    part = slice(first, last)
    return replace(
        run,
        time=run.time[part] - run.time[first],
        position=run.position[part],
        command=run.command[part],
        valid=run.valid[part],
    )


def experiment(seeds: tuple[int, int], noise: int, ripple: float = 0.0, rub: float = 0.0) -> list[Run]:
    """One run without and one with the payload, with a torque of the positions and friction of the links' load."""
    rng = np.random.default_rng(noise)
    still = Plant(chi={name: value for name, value in CHI.items() if not name.startswith(("fv", "fs"))})
    runs = []
    for seed, payload in zip(seeds, (None, DISC), strict=True):
        carried = STEEL if payload else None
        run = Plant().run("loaded" if payload else "unloaded", payload=carried, seed=seed)
        links = still.run("links", payload=carried, seed=seed).command
        direction = np.sign(np.gradient(run.position, axis=0))
        current = run.command + ripple * np.sin(9.0 * run.position) + rub * np.abs(links) * direction
        current = current + NOISE * rng.standard_normal(current.shape)
        runs.append(replace(run, command=current, payload=payload))
    return runs


def fitted(runs: list[Run]) -> Fit:
    data = reduce_runs(five_bar().robot, runs)
    return ML.fit(data.system(per_run=True))


def gain_std(fit: Fit, together: bool) -> np.ndarray:
    problem = fit.system.problem
    solution = fit.solution if together else ml(replace(problem, clusters=None))
    return np.sqrt(np.diag(solution.jackknife))[problem.gain_rows]


@pytest.fixture(scope="module")
def rippled() -> Fit:
    return fitted(experiment((3, 3), 0, ripple=0.05))


@pytest.fixture(scope="module")
def noisy() -> list[Fit]:
    return [fitted(experiment((3, 3), noise)) for noise in range(4)]


def test_a_repeated_motion_is_found_where_it_begins_and_ends_at_other_times() -> None:
    first, again = experiment((3, 3), 0)
    other = experiment((4, 4), 0)[0]
    data = reduce_runs(five_bar().robot, [cut(first, 0, 4300), other, cut(again, 650)])
    groups, spans = data.prepared.places
    assert groups.tolist() == [0, 1, 0]
    assert spans[0, 0] - spans[2, 0] == pytest.approx(1.3, abs=0.02)


def test_stretches_of_a_repeated_motion_begin_at_the_same_positions() -> None:
    first, again = experiment((3, 3), 0)
    data = reduce_runs(five_bar().robot, [cut(first, 0, 4300), cut(again, 650)])
    starts = []
    for prepared, edges in zip(data.prepared, data.prepared.edges, strict=True):
        at = np.round(edges[6:14] * (len(prepared) - 1)).astype(int)
        starts.append([prepared.samples(k, k + 1).q[0] for k in at])
    assert np.abs(np.subtract(*starts)).max() < 0.02  # rad, 1 % of the range and less
    units = data.system(per_run=True).problem.units
    assert len(units) == BLOCKS


@pytest.mark.parametrize("seeds", [(3, 4), (5, 6)])
def test_runs_of_other_motions_are_left_out_one_at_a_time(seeds: tuple[int, int]) -> None:
    data: Dataset = reduce_runs(five_bar().robot, experiment(seeds, 0))
    assert data.prepared.places[0].tolist() == [0, 1]
    assert len(data.system(per_run=True).problem.units) == 2 * BLOCKS


def test_what_repeats_cancels_in_the_gains_and_leaves_their_intervals(rippled: Fit) -> None:
    """The ripple is in both runs: intervals shrink to a half and hold; those of blocks of one run are too wide."""
    z, ratio = [], []
    for phase in range(8):
        fit = rippled if phase == 0 else fitted(experiment((20 + phase, 20 + phase), phase, ripple=0.05))
        std = gain_std(fit, together=True)
        z.append((fit.gains - GAINS) / std)
        ratio.append(gain_std(fit, together=False) / std)
    assert np.median(ratio) > 1.5
    assert 0.4 < np.sqrt(np.mean(np.square(z))) < 1.6


def test_noise_of_each_run_makes_the_same_intervals_in_step(noisy: list[Fit]) -> None:
    ratio = [gain_std(fit, together=False) / gain_std(fit, together=True) for fit in noisy]
    assert np.exp(np.mean(np.log(ratio))) == pytest.approx(1.0, abs=0.15)


def test_residuals_of_a_ripple_are_common(rippled: Fit) -> None:
    found = residual_correlations(rippled)
    assert found is not None
    assert found[0].min() > 0.8
    (finding,) = repeated_motion_findings(rippled, ())
    assert finding.kind == F.COMMON_RESIDUALS
    assert finding.joints == ("left", "right")


def test_noise_is_not_correlated(noisy: list[Fit]) -> None:
    for fit in noisy:
        assert not list(repeated_motion_findings(fit, ()))


def test_what_changes_sign_with_the_load_is_said_with_its_cause() -> None:
    """Runs of one motion, of which what the payload adds to the friction changes sign between them."""
    runs = experiment((3, 3), 0)
    spoilt = []
    for sign, run in zip((1.0, -1.0), runs, strict=True):
        wave = 0.03 * np.sin(9.0 * run.position)
        spoilt.append(replace(run, command=run.command + sign * wave))
    result = identify(five_bar().robot, spoilt)
    (note,) = [note for note in result.notes if note.kind == F.OPPOSED_RESIDUALS]
    assert "changes sign with the load" in str(note)
    assert "load-dependent friction" in str(note) or "torque constant" in str(note)


def test_other_motions_have_no_correlation() -> None:
    assert residual_correlations(fitted(experiment((3, 4), 0))) is None
