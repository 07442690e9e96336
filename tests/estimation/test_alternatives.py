"""Alternatives to the model: their sizes, their support by the data, and what they do to gains and intervals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import GAINS, JOINTS, STEEL, Plant
from stated_arm import plant, robot

from gtau.estimation.diagnostics.alternatives import SHOWN, Alternative, Hypothesis, compete, model_covariance, support
from gtau.estimation.diagnostics.examine import Examination
from gtau.estimation.diagnostics.hypotheses import (
    HYPOTHESES,
    description,
    drives,
    find_alternatives,
    ranked,
    same_effects,
)
from gtau.estimation.diagnostics.linearisation import CandidateColumns, FitWindow
from gtau.estimation.diagnostics.verdict import Outcome
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.maximum_likelihood import ML
from gtau.estimation.identify import identify
from gtau.estimation.regression.dataset import reduce_runs
from gtau.estimation.thresholds.estimates import ALTERNATIVE_PRIOR
from gtau.findings import Finding
from gtau.model.home import load_robot
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run

ROBOT = load_robot("five-bar")


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    plant, known = Plant(noise=0.01), Payload(name="steel", mass=STEEL["m"])
    free, loaded = plant.run("free", 10.0, seed=1), plant.run("loaded", 10.0, STEEL, seed=2)
    return [free, replace(loaded, payload=known)]


def fit_of(runs: list[Run]) -> Fit:
    dataset = reduce_runs(ROBOT, runs)
    return ML.fit(dataset.system(per_run=True))


def found(runs: list[Run], kind: str, joint: str) -> Alternative:
    return next(each for each in find_alternatives(fit_of(runs)) if Finding(kind, (joint,)) in each.causes)


def currents(runs: list[Run], change: Callable[[Run], np.ndarray]) -> list[Run]:
    return [replace(run, command=change(run)) for run in runs]


def test_a_torque_constant_that_falls_has_its_size_and_moves_its_gain(runs: list[Run]) -> None:
    rms = np.sqrt(np.mean([np.mean(run.command**2, axis=0) for run in runs], axis=0))
    fall = 0.02  # up to twice the rms current
    faulty = currents(runs, lambda run: run.command * (1 + fall * np.abs(run.command) / (2 * rms) * [1.0, 0.0]))
    each = found(faulty, drives.FALLING_CONSTANT.kind, "left")
    assert each.size == pytest.approx(fall, rel=0.25)
    assert each.t > 6
    # taking it into account brings the gain to the truth, to first order
    gain = fit_of(faulty).solution.gains[0]
    assert abs(gain * (1 + each.moves["left"] / 100) / GAINS[0] - 1) < 0.4 * abs(gain / GAINS[0] - 1)


def test_a_torque_constant_that_falls_along_the_runs_has_its_size(runs: list[Run]) -> None:
    def warmer(run: Run) -> np.ndarray:
        along = np.linspace(-0.5, 0.5, len(run.time))[:, None]
        return run.command * (1 + 0.02 * along * [1.0, 0.0])

    faulty = currents(runs, warmer)
    assert found(faulty, drives.DRIFTING_CONSTANT.kind, "left").size == pytest.approx(0.02, rel=0.2)
    assert abs(found(faulty, drives.DRIFTING_CONSTANT.kind, "right").t) < 5


def test_an_encoder_zero_has_its_size(runs: list[Run]) -> None:
    shifted = [replace(run, position=run.position + np.array([np.radians(1.0), 0.0])) for run in runs]
    each = found(shifted, description.ZERO.kind, "left")
    # the position is too large by a degree, so taking a degree off it gives the right torques
    assert each.size == pytest.approx(-1.0, abs=max(0.3, 3 * each.std))


@pytest.mark.parametrize(("joint", "scale"), [pytest.param("j3", 0.5, marks=pytest.mark.slow), ("j2", 1.03)])
def test_a_wrong_gear_ratio_is_named(tmp_path: Path, joint: str, scale: float) -> None:
    body = {"m": 1.5, "mx": 0.05, "mz": 0.1}
    made = replace(plant(robot(tmp_path), noise=0.02), tool="j4", gains=(8.0, 9.0, 7.0, 5.0))
    runs = [made.run(1), made.run(2, body, Payload(name="disc", mass=body["m"]))]
    factor = np.where(np.array(made.model.actuated) == joint, scale, 1.0)
    result = identify(robot(tmp_path), [replace(run, position=run.position * factor) for run in runs])
    scales = [each for each in result.alternatives if each.hypothesis == "position scales"]
    best = max(scales, key=lambda each: each.share)
    assert best.causes[0].joints == (joint,)
    assert best.size == pytest.approx(100 * (1 / scale - 1), rel=0.3)
    assert Outcome.CONTRADICTORY in {each.verdict.outcome for each in result.drive_gains.values()}


def test_clean_logs_support_no_alternative(runs: list[Run]) -> None:
    alternatives = ranked(find_alternatives(fit_of(runs)))
    assert alternatives
    assert all(each.unit for each in alternatives)
    assert max(each.share for each in alternatives) < 0.02
    assert all(np.isfinite(each.shifts).all() for each in alternatives)


def under_another_name(hypothesis: Hypothesis) -> Hypothesis:
    """The same effects in other words, and sizes in another unit."""

    def torques(at: FitWindow) -> CandidateColumns:
        columns = hypothesis.torques(at)
        return lambda rows: 3.0 * columns(rows)

    def columns(fit: Fit) -> list[Alternative]:
        return [
            replace(each, causes=(replace(each.causes[0], subject="another"),), plausible=each.plausible / 3.0)
            for each in hypothesis.offered(fit)
        ]

    return replace(hypothesis, name=f"another {hypothesis.name}", torques=torques, columns=columns)


@pytest.mark.parametrize("fall", [0.0, 0.05])
def test_effects_that_are_offered_twice_count_once(runs: list[Run], fall: float) -> None:
    """Neither a hypothesis listed twice nor its copy in other words changes the intervals, asked for or not."""
    rms = np.sqrt(np.mean([np.mean(run.command**2, axis=0) for run in runs], axis=0))
    fit = fit_of(currents(runs, lambda run: run.command * (1 + fall * np.abs(run.command) / (2 * rms))))
    once = ranked(find_alternatives(fit))
    expected = model_covariance(once, len(fit.solution.values))
    assert (max(each.t for each in once if each.hypothesis == "saturation") > 6) == (fall > 0)
    for more in (HYPOTHESES, [under_another_name(each) for each in HYPOTHESES]):
        twice = ranked(find_alternatives(fit, [*HYPOTHESES, *more]), [*HYPOTHESES, *more])
        np.testing.assert_allclose(model_covariance(twice, len(expected)), expected, rtol=1e-6)
        assert [each.probability for each in twice if each.significant] == pytest.approx(
            [each.probability for each in once if each.significant]
        )


def test_hypotheses_have_names_of_their_own() -> None:
    assert len({each.name for each in HYPOTHESES}) == len(HYPOTHESES)


def test_one_effect_of_two_causes_is_named_by_both() -> None:
    """A tilt of its base and its encoder's zero are the same to a pendulum; the larger one stands for both."""
    columns = np.random.default_rng(3).standard_normal((50, 3))[:, [0, 1, 2, 0]] * [1.0, 1.0, 0.0, 1.0]
    assert sorted(same_effects(columns.T @ columns, np.array([0.5, 0.1, 1.0, 1.0]))) == [[1], [2], [3, 0]]


def test_support_by_the_data() -> None:
    assert support(0.0, None, 0.1) == (0.0, pytest.approx(0.01))  # nothing said: what is plausible remains
    assert support(2.0, None, SHOWN) == (np.inf, 4.0)
    factor, moment = support(0.0, 1e-4, 0.1)
    assert factor < -5  # refuted
    assert moment < 2e-8
    factor, moment = support(0.05, 1e-3, 0.1)
    assert factor > 500  # asked for
    assert moment == pytest.approx(0.05**2, rel=0.01)


def test_alternatives_of_a_group_compete() -> None:
    def weighed(*groups: tuple[str, float | None]) -> list[float]:
        """Weigh alternatives by their group and their size in standard deviations, None where a test showed them."""
        tried = [
            Alternative(group, (), t or 0.0, 1.0, "", plausible=1e3)
            if t is not None
            else Alternative(group, (), 1.0, None, "")
            for group, t in groups
        ]
        return [each.probability for each in compete(tried, lambda each: each.hypothesis)]

    def odds(t: float, members: int) -> float:
        return ALTERNATIVE_PRIOR / members / (1 - ALTERNATIVE_PRIOR) * float(np.exp(support(t, 1.0, 1e3)[0]))

    pair = weighed(("a", 3.6), ("a", 3.6))
    assert pair == [pytest.approx(odds(3.6, 2) / (1 + 2 * odds(3.6, 2)))] * 2
    strong = weighed(("a", 12.0), ("a", 6.0), ("b", 0.0))
    assert strong == [
        pytest.approx(1.0),
        pytest.approx(0.0, abs=1e-6),
        pytest.approx(odds(0.0, 1) / (1 + odds(0.0, 1))),
    ]
    huge = weighed(("a", 156.0), ("a", 72.0), ("c", None))
    assert huge == [pytest.approx(1.0), pytest.approx(0.0), pytest.approx(1.0)]


def test_the_largest_of_several_is_less_likely() -> None:
    alone, one_of_three = (
        compete([Alternative("h", (), 4.0, 1.0, "", prior, plausible=10.0)], lambda each: None)[0].probability
        for prior in (float(ALTERNATIVE_PRIOR), ALTERNATIVE_PRIOR / 3)
    )
    assert alone / (1 - alone) == pytest.approx(3 * one_of_three / (1 - one_of_three))


@pytest.mark.parametrize("share", [0.05, pytest.param(0.2, marks=pytest.mark.slow)])
def test_friction_that_falls_along_a_run_widens_intervals_and_contradicts_nothing(share: float) -> None:
    plant, known = Plant(noise=0.01), Payload(name="steel", mass=STEEL["m"])
    logged = []
    for name, payload, seed in (("free", None, 1), ("loaded", STEEL, 2)):
        cold, warm = (
            replace(plant, chi={k: v * (factor if k[:2] in ("fv", "fs") else 1) for k, v in plant.chi.items()}).run(
                name, 10.0, payload, seed=seed
            )
            for factor in (1 + share / 2, 1 - share / 2)
        )
        along = np.linspace(0.0, 1.0, len(cold.time))[:, None]
        logged.append(replace(cold, command=(1 - along) * cold.command + along * warm.command))
    result = identify(ROBOT, [logged[0], replace(logged[1], payload=known)])
    for joint, truth in zip(JOINTS, GAINS, strict=True):
        gain = result.drive_gains[joint]
        assert gain.verdict.outcome in (Outcome.GOOD, Outcome.WEAK), gain.verdict.sentence
        low, high = gain.interval() or (0.0, 0.0)
        assert low < truth < high


def test_intervals_hold_a_random_and_a_model_part(runs: list[Run]) -> None:
    result = identify(ROBOT, runs)
    for gain in result.drive_gains.values():
        assert gain.std == pytest.approx(np.hypot(gain.random_std or 0.0, gain.model_std or 0.0))
    assert {each.hypothesis for each in result.alternatives} >= {"friction shape", "saturation", "encoder zeros"}
    assert all(set(each.moves) == set(JOINTS) for each in result.alternatives)


def test_a_description_is_refuted_only_where_it_explains_more_than_missing_physics() -> None:
    """Tried alone, gravity explains part of what the lag leaves: it refutes only where it explains more."""

    def alternative(hypothesis: str, share: float) -> Alternative:
        return Alternative(hypothesis, (), 10.0, 1.0, "", 1.0, share)

    def refuted(*alternatives: Alternative, repeating: float = 0.0) -> list[str]:
        examined = Examination(alternatives, ripple=alternative("position ripple", repeating))
        return [each.hypothesis for each in examined.refuted]

    gravity, lag = alternative("gravity", 0.3), [alternative("current lag", 0.2)] * 2
    assert refuted(gravity) == ["gravity"]
    assert refuted(gravity, lag[0]) == ["gravity"]
    assert refuted(gravity, *lag) == []  # 0.4 in both joints
    assert refuted(replace(gravity, share=0.9), *lag) == ["gravity"]
    assert refuted(replace(gravity, share=0.03)) == []
    # cables repeat at the same positions, of which gravity explains little; a wrong gravity explains most of it
    assert refuted(gravity, repeating=0.7) == []
    assert refuted(gravity, repeating=0.5) == ["gravity"]
