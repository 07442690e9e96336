"""Intervals, and verdicts on what is known to be right or wrong."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from random import Random
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.stats
from five_bar_logs import GAINS, JOINTS, STEEL, Plant, five_bar, pair
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import gtau.estimation.diagnostics.diagnose
from gtau.errors import GtauError
from gtau.estimation.diagnostics.diagnose import BASE_MISFIT, _estimated_gains, base_misfit
from gtau.estimation.diagnostics.examine import Examination, estimates_of
from gtau.estimation.diagnostics.verdict import (
    GOOD,
    OUTCOMES,
    Outcome,
    Verdict,
    cannot_be_negative,
    decide,
    judge_parameter,
    known_verdict,
    parameter_verdict,
    verdict_of,
    worst,
)
from gtau.estimation.effects.effect import EstimatedEffect
from gtau.estimation.estimators.maximum_likelihood import ML
from gtau.estimation.regression.dataset import reduce_runs
from gtau.estimation.regression.run_blocks import BLOCKS
from gtau.estimation.results.conclusions import INFLATED, Reason, headline, reasons
from gtau.estimation.results.estimate import Estimate
from gtau.findings import Finding, Grade, Severity
from gtau.findings import FindingKind as F
from gtau.findings.finding import by_severity
from gtau.findings.words import percent_text
from gtau.model.home import load_robot
from gtau.result import Result, identify
from gtau.robots.parameter import parameter_of
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run

FIVE_BAR = load_robot("five-bar")


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    return pair(Plant(noise=0.02))


@pytest.fixture(scope="module")
def result(runs: list[Run]) -> Result:
    return identify(FIVE_BAR, runs)


# Intervals


@pytest.mark.parametrize("freedom", [5, 39, None])
@pytest.mark.parametrize("level", [0.5, 0.95, 0.999])
def test_intervals_are_those_of_the_t_distribution(freedom: int | None, level: float) -> None:
    estimate = Estimate("k", 3.0, 0.2, "N m", freedom=freedom)
    law = scipy.stats.norm(3.0, 0.2) if freedom is None else scipy.stats.t(freedom, 3.0, 0.2)
    assert estimate.interval(level) == pytest.approx(law.interval(level))


@pytest.mark.parametrize(
    ("share", "accuracy", "words"),
    [
        (0.0, None, "0.00"),
        (0.004, None, "<0.01"),
        (0.2, None, "0.20"),
        (3.002, None, "3.0"),
        (3.002, 3.0, "3.1"),
        (2.98, 3.0, "3.0"),
        (9.96, None, "10"),
        (99.7, 3.0, "100"),
        (123.4, 3.0, "123"),
        (0.2201, 0.22, "0.23"),
    ],
)
def test_shares_have_two_digits_and_none_that_exceeds_the_accuracy_rounds_to_it(
    share: float, accuracy: float | None, words: str
) -> None:
    assert percent_text(share, accuracy) == words


def test_the_width_of_an_interval_is_rounded_alike_everywhere(runs: list[Run], result: Result) -> None:
    half = result.drive_gains["left"].half_width
    assert half is not None
    weak = identify(FIVE_BAR, runs, accuracy=(1 - 1e-6) * half / 100)
    shown = percent_text(half, (1 - 1e-6) * half)
    assert float(shown) >= half - 0.005
    assert weak.drive_gains["left"].verdict.finding.values["half"] == pytest.approx(half / 100)
    headline, table = weak.summary().split("Drive gains ", 1)
    assert f"'left' is known to +-{shown} %" in " ".join(headline.split())
    assert (
        next(line for line in table.splitlines() if line.startswith("joint left")).split("m/A")[1].split()[0] == shown
    )


def test_what_is_known_or_unknown_has_no_interval() -> None:
    assert Estimate("k", 3.0, None, "kg").interval() is None
    assert Estimate("k", None, None, "kg").interval() is None


def test_intervals_of_other_estimators_rest_on_the_blocks_and_are_saved(runs: list[Run], tmp_path: Path) -> None:
    result = identify(FIVE_BAR, runs, "2sls")
    for each in (*result.drive_gains.values(), *result.parameters.values()):
        assert each.freedom is not None
        assert each.random_std is not None
        # the model part counts as known (Satterthwaite), so that only the random part rests on the blocks
        assert 1 <= each.freedom * (each.random_std / each.std) ** 4 <= 2 * BLOCKS - 1 + 1e-9
    result.save(tmp_path / "model.json")
    document = json.loads((tmp_path / "model.json").read_text())
    for entry in (*document["drive_gains"], *document["parameters"], *document["delays"]):
        low, high = entry["interval"]
        half = scipy.stats.t(entry["freedom"]).ppf(0.975) * entry["std"]
        assert (low, high) == pytest.approx((entry["value"] - half, entry["value"] + half))
    loaded = Result.load(tmp_path / "model.json")
    assert loaded.drive_gains["left"].interval(0.9) == result.drive_gains["left"].interval(0.9)


def test_the_paper_s_deviations_rest_on_all_rows(runs: list[Run]) -> None:
    result = identify(FIVE_BAR, runs, as_paper=True)
    assert result.method == "tls"
    assert result.drive_gains["left"].freedom is None
    with pytest.raises(GtauError, match=r"the paper has no method 'ml'.*choose from tls, wls, ols"):
        identify(FIVE_BAR, runs, "ml", as_paper=True)


# Delays


@pytest.mark.slow
def test_a_delay_that_noise_hides_is_not_identifiable_and_has_no_deviation(result: Result) -> None:
    assert {each.verdict.outcome for each in result.delays.values()} == {Outcome.GOOD}
    plant, known = Plant(noise=0.02), Payload(name="steel", mass=STEEL["m"])
    free, loaded = plant.run("free", 8.0, seed=1), plant.run("loaded", 8.0, STEEL, seed=2)
    noisy = np.random.default_rng(3)
    drowned = [
        replace(run, command=run.command + noisy.standard_normal(run.command.shape) * [0.0, 30.0])
        for run in (free, replace(loaded, payload=known))
    ]
    left, right = identify(FIVE_BAR, drowned).delays.values()
    assert left.verdict.outcome == Outcome.GOOD
    assert left.std is not None
    assert right.verdict.outcome == Outcome.NOT_IDENTIFIABLE
    assert right.std is None


# Verdicts


def test_verdicts_of_parameters() -> None:
    assert parameter_verdict(None, None).outcome == Outcome.NOT_IDENTIFIABLE
    assert parameter_verdict(1.0, None).outcome == Outcome.GOOD
    assert parameter_verdict(1.0, 0.05).outcome == Outcome.GOOD
    assert parameter_verdict(-1.0, 0.3).outcome == Outcome.WEAK
    assert parameter_verdict(1.0, 0.6).outcome == Outcome.NOT_IDENTIFIABLE


@pytest.mark.parametrize(
    ("terms", "nonnegative"),
    [
        ({"fv_2": 1.0}, True),
        ({"fv_21": 1.0, "fv_51": 1.0}, True),
        ({"ia_1": 1.0, "zz_1": 1.0, "m_2": 0.16}, True),
        ({"m_1": 1.0, "mx_3": -3.2258, "m_3": 1.0}, False),
        ({"xx_3": 1.0, "yy_3": -1.0}, False),
        ({"off_1": 1.0}, False),
        ({"mx_2": 1.0}, False),
    ],
)
def test_parameters_that_cannot_be_negative(terms: dict[str, float], nonnegative: bool) -> None:
    terms = {parameter_of(name): factor for name, factor in terms.items()}
    assert cannot_be_negative(terms) == nonnegative
    outcome = judge_parameter(-0.0022, 0.0002, terms).outcome
    assert outcome == (Outcome.CONTRADICTORY if nonnegative else Outcome.GOOD)
    assert judge_parameter(-0.0022, 0.0015, terms).outcome != Outcome.CONTRADICTORY
    assert judge_parameter(0.0022, 0.0002, terms).outcome == Outcome.GOOD


def test_verdicts_of_masses() -> None:
    values = {"parameter": "m", "declared": 2.0, "found": 2.02, "std": 0.01, "unit": "kg"}
    assert known_verdict(values).outcome == Outcome.GOOD
    wrong = known_verdict(values | {"found": 2.05})
    assert wrong.outcome == Outcome.CONTRADICTORY
    assert wrong.finding.kind == F.PAYLOAD_MASS
    assert (wrong.finding.values["declared"], wrong.finding.values["found"]) == (2.0, 2.05)


GAIN_KINDS = list(OUTCOMES)[: list(OUTCOMES).index(F.COUPLED) + 1]


@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])  # on a machine that others use
@given(
    st.lists(
        st.builds(
            Finding,
            st.sampled_from(GAIN_KINDS),
            st.lists(st.sampled_from(["a", "b", "c"]), min_size=1, unique=True).map(tuple),
            st.sampled_from(["", "steel", "lead"]),
            size=st.sampled_from([0.0, 0.5, 2.0]),
        ),
        max_size=6,
    ),
    st.randoms(use_true_random=False),
)
def test_verdicts_do_not_depend_on_the_order_of_the_checks(findings: list[Finding], random: Random) -> None:
    found = decide("abc", findings)
    shuffled = random.sample(findings, len(findings))
    assert decide("abc", shuffled) == found
    assert decide("abc", [*shuffled, *findings]) == found
    for joint, verdict in found.items():
        mine = [each for each in findings if joint in each.joints]
        ranks = [GAIN_KINDS.index(each.kind) for each in mine]
        if verdict.finding is not None and verdict.finding.kind == F.COUPLED and verdict.finding not in mine:
            assert all(OUTCOMES[each.kind] == Outcome.GOOD for each in mine)
            assert found[verdict.finding.subject].outcome == Outcome.CONTRADICTORY
        elif mine:
            assert GAIN_KINDS.index(verdict.finding.kind) == min(ranks)
            assert verdict.finding.size == max(each.size for each in mine if each.kind == verdict.finding.kind)
        else:
            assert verdict == GOOD


@pytest.mark.parametrize("fault", ["none", "prior", "sign"])
def test_the_checks_of_a_fit_may_run_in_any_order(fault: str, runs: list[Run], monkeypatch: pytest.MonkeyPatch) -> None:
    """The same verdicts where the one decision sees the findings backwards."""
    priors = {"left": 9.0 * GAINS[0], "right": GAINS[1]} if fault == "prior" else None
    logged = [replace(run, command=run.command * [1.0, -1.0]) for run in runs[:1]] if fault == "sign" else runs[:1]

    def either_way(joints: Sequence[str], findings: Iterable[Finding], otherwise: Verdict) -> dict[str, Verdict]:
        forwards = list(findings)
        assert decide(joints, forwards[::-1], otherwise) == decide(joints, forwards, otherwise)
        return decide(joints, forwards, otherwise)

    monkeypatch.setattr(gtau.estimation.diagnostics.diagnose, "decide", either_way)
    result = identify(FIVE_BAR, [*logged, *runs[1:]], prior_gains=priors)
    verdicts = [gain.verdict for gain in result.drive_gains.values()]
    assert ({verdict.outcome for verdict in verdicts} == {Outcome.GOOD}) == (fault == "none")


def test_the_worst_of_several() -> None:
    good, weak, lost = parameter_verdict(1.0, 0.0), parameter_verdict(1.0, 0.3), parameter_verdict(None, None)
    assert worst([]) == worst([good]) == Outcome.GOOD
    assert worst([good, weak]) == worst(iter([weak, good])) == Outcome.WEAK
    assert worst([lost, weak]) == Outcome.NOT_IDENTIFIABLE


def test_every_number_has_a_verdict_and_good_ones_say_nothing(result: Result) -> None:
    for gain in result.drive_gains.values():
        assert gain.verdict.outcome == Outcome.GOOD
        assert gain.verdict.sentence == "good"
    for each in result.parameters.values():
        assert each.verdict == parameter_verdict(each.value, each.std)
        assert bool(each.verdict.advice) == (each.verdict.outcome != Outcome.GOOD)


def test_no_gain_is_called_known_that_another_joint_makes_doubtful(result: Result) -> None:
    wrong, doubt = verdict_of(Finding(F.ALL_NEGATIVE)), verdict_of(Finding(F.COUPLED, (), JOINTS[0]))
    gains = [
        replace(gain, verdict=each) for gain, each in zip(result.drive_gains.values(), (wrong, doubt), strict=True)
    ]
    doubtful = result.replaced(drive_gains=dict(zip(JOINTS, gains, strict=True)))
    said = headline(doubtful)
    assert f"Joint '{JOINTS[1]}' is in doubt." in said
    assert reasons(doubtful)[1] == Reason(doubt.outcome, (JOINTS[1],), doubt.why, doubt.advice)
    assert "is known to +-" not in said


def test_a_light_payload_is_weak_or_with_more_noise_refused() -> None:
    light = Payload(name="light", mass=0.02)

    def pair(noise: float) -> list[Run]:
        plant = Plant(noise=noise)
        return [plant.run("free", 8.0, seed=1), replace(plant.run("loaded", 8.0, {"m": 0.02}, seed=2), payload=light)]

    verdicts = [gain.verdict for gain in identify(FIVE_BAR, pair(0.05)).drive_gains.values()]
    assert {verdict.outcome for verdict in verdicts} == {Outcome.WEAK}
    assert {verdict.finding.kind for verdict in verdicts} == {F.WIDE_RANDOM}
    assert all(verdict.finding.values["payload"] for verdict in verdicts)
    with pytest.raises(GtauError, match=r"explained as well without payload 'light'.*longer runs with a heavier one"):
        identify(FIVE_BAR, pair(0.2))


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "good"), [(0.005, True), (0.05, False), (0.2, False)])
def test_deviations_and_not_singular_values_condemn_total_least_squares(noise: float, good: bool) -> None:
    """The ratio of the two smallest singular values is 2.7 with the right gains, and 3.4 and 3.6 with absurd ones."""
    result = identify(FIVE_BAR, pair(Plant(noise=noise)), method="tls")
    assert (result.statistics["singular_ratio"] < 3) == good
    gains = result.drive_gains.values()
    errors = np.array([gain.value / truth - 1 for gain, truth in zip(gains, GAINS, strict=True)])
    assert (np.abs(errors).max() < 0.005) == good
    for gain, error in zip(gains, errors, strict=True):
        assert (gain.verdict.outcome == Outcome.GOOD) == good or abs(error) < 0.03
        assert abs(error * gain.value) < 4 * gain.std


# Drift and lack of fit


def test_autocorrelated_residuals_are_a_lack_of_fit(result: Result, runs: list[Run]) -> None:
    assert result.statistics["lack_of_fit"] < INFLATED
    slow = []
    for k, run in enumerate(runs):
        phase = np.linspace(0, 2 * np.pi * 13, len(run.time))[:, None] * [1.0, 1.3] + k
        slow.append(replace(run, command=run.command + 0.1 * np.sin(phase)))
    lacking = identify(FIVE_BAR, slow)
    assert lacking.statistics["lack_of_fit"] > INFLATED
    assert "the model lacks an effect" in " ".join(lacking.summary().split())
    assert "the model lacks an effect" not in " ".join(result.summary().split())
    for joint in JOINTS:
        assert (lacking.drive_gains[joint].std or 0.0) > (result.drive_gains[joint].std or 0.0)


def test_what_is_said_of_several_gains_is_said_once(result: Result) -> None:
    turned = verdict_of(Finding(F.ALL_NEGATIVE))
    both = result.replaced(drive_gains={j: replace(gain, verdict=turned) for j, gain in result.drive_gains.items()})
    (row,) = reasons(both)
    assert (set(row.joints), row.why, row.action) == (set(JOINTS), turned.why, turned.advice)
    assert " ".join(both.summary(False).split()).count(turned.advice) == 1


SAID = ((Grade.WARNING, "slight", 0.2), (Grade.ERROR, "refusal", 0.0), (Grade.WARNING, "large", 3.0))


def test_notes_that_may_move_an_estimate_most_stand_first() -> None:
    notes = [Finding("model", text=text, grade=grade, size=size) for grade, text, size in SAID]
    listed = {grade: [each.what for each in members] for grade, members in by_severity(notes).items()}
    assert listed == {Severity.ERROR: ["refusal"], Severity.WARNING: ["large", "slight"]}


def test_reasons_that_differ_in_numbers_or_causes_are_one_row_with_those_of_each(result: Result) -> None:
    drives = {joint: Finding("saturation", (joint,), "", {"what": f"saturation of '{joint}'"}) for joint in JOINTS}
    for kind, causes in ((F.WIDE_RANDOM, {}), (F.WIDE_CAUSE, drives)):
        gains = {}
        for (joint, gain), half in zip(result.drive_gains.items(), (10.0, 20.0), strict=True):
            values = {"half": half / 100, "accuracy": 0.03, "payload": True, "wrenches": False, "random": half > 15}
            finding = Finding(kind, (joint,), values=values, causes=(causes[joint],) if causes else ())
            gains[joint] = replace(gain, std=half / 196 * gain.value, verdict=verdict_of(finding))
        (row,) = reasons(result.replaced(drive_gains=gains))
        assert row.joints == JOINTS[::-1]
        for joint, number, cause in zip(JOINTS, ("10 %", "20 %"), drives.values(), strict=True):
            assert number in row.why
            assert f"'{joint}'" in row.why
            assert (cause.what in row.why) == bool(causes)


@pytest.mark.parametrize(("left", "unexplained"), [(0.05, False), (1.0, True)])
def test_moments_of_a_base_that_hangs_still_are_no_misfit(left: float, unexplained: bool) -> None:
    """Hung above its centre of mass a base has moments of 0.05 N m, all noise, while its terms of 3 N m cancel."""
    problem = SimpleNamespace(
        base=list(range(6)),
        balance=lambda theta: np.array([2.0, 2.0, 100.0, left, left, left]),
        largest_terms=lambda theta: np.array([2.0, 2.0, 100.0, 3.0, 3.0, 3.0]),
    )
    solution = SimpleNamespace(theta=np.zeros(1), sigma=np.array([0.5, 0.5, 0.5, left, left, left]))
    shares = base_misfit(SimpleNamespace(system=SimpleNamespace(problem=problem), solution=solution))
    assert shares["forces"] < 0.01
    assert (shares["moments"] > BASE_MISFIT) == unexplained


@pytest.mark.parametrize(("factor", "refuted"), [(1.0, True), (400.0, False)])
def test_a_gain_that_is_noise_refutes_nothing(factor: float, refuted: bool) -> None:
    """A tilt that would move a gain by 40 % is evidence at an interval of 1 %, not at one of 400 %."""
    plant = Plant(noise=0.02)
    runs = [
        plant.run("free", seed=1),
        replace(plant.run("loaded", payload=STEEL, seed=2), payload=Payload(name="steel", mass=STEEL["m"])),
    ]
    fit = ML.fit(reduce_runs(five_bar().robot, runs).system())
    estimates = estimates_of(fit, Examination(), correlated=True)
    estimates = replace(estimates, scatter=factor**2 * estimates.scatter)
    tilt = Finding("gravity", values={"what": "gravity tilted towards (1, 0, 0)"})
    moves = dict.fromkeys(("left", "right"), 40.0)
    effect = EstimatedEffect("gravity", tilt, 4.0, 0.1, "deg", 100.0, 0.6, moves, description=True)
    findings = list(_estimated_gains(fit, Examination(refits=(effect,)), estimates, 0.03, {}))
    verdicts = decide(("left", "right"), findings)
    outcome = Outcome.CONTRADICTORY if refuted else Outcome.NOT_IDENTIFIABLE
    assert {verdict.outcome for verdict in verdicts.values()} == {outcome}
