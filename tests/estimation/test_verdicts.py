"""Intervals, and verdicts on what is known to be right or wrong."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.stats
from five_bar_logs import GAINS, JOINTS, STEEL, Plant, five_bar, pair

from gtau.errors import GtauError
from gtau.estimation.diagnostics.diagnose import Examination, diagnose, estimates_of
from gtau.estimation.diagnostics.gains import BASE_MISFIT, base_misfit
from gtau.estimation.diagnostics.verdict import (
    GOOD,
    LONGER,
    NEGATIVE_GAIN,
    cannot_be_negative,
    coupled,
    decide,
    judge_parameter,
    parameter_verdict,
    worst,
)
from gtau.estimation.effects.effect import EstimatedEffect
from gtau.estimation.estimators.maximum_likelihood import ML
from gtau.estimation.regression.dataset import reduce_runs
from gtau.estimation.regression.run_blocks import BLOCKS
from gtau.estimation.results.conclusions import INFLATED, headline, reasons
from gtau.estimation.results.estimate import Estimate
from gtau.findings import Finding, Grade, by_severity, percent_text
from gtau.model.home import load_robot
from gtau.report.identification import summary_page
from gtau.report.terminal import plain
from gtau.result import Result, identify, load
from gtau.robots.parameter import parameter_of
from gtau.signals.reading.drafting import ASSUMED_UNIT, DRAFT
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run

FIVE_BAR = load_robot("five-bar")
NEGATIVE = Finding("all gains negative", text="all drive gains are negative", advice="turn", grade=Grade.CONTRADICTORY)


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
    assert weak.drive_gains["left"].verdict.own == f"+-{shown} %"
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
    loaded = load(tmp_path / "model.json")
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
    assert {each.verdict.outcome for each in result.delays.values()} == {Grade.GOOD}
    plant, known = Plant(noise=0.02), Payload(name="steel", mass=STEEL["m"])
    free, loaded = plant.run("free", 8.0, seed=1), plant.run("loaded", 8.0, STEEL, seed=2)
    noisy = np.random.default_rng(3)
    drowned = [
        replace(run, command=run.command + noisy.standard_normal(run.command.shape) * [0.0, 30.0])
        for run in (free, replace(loaded, payload=known))
    ]
    left, right = identify(FIVE_BAR, drowned).delays.values()
    assert left.verdict.outcome == Grade.GOOD
    assert left.std is not None
    assert right.verdict.outcome == Grade.NOT_IDENTIFIABLE
    assert right.std is None


# Verdicts


def test_verdicts_of_parameters() -> None:
    assert parameter_verdict(None, None).outcome == Grade.NOT_IDENTIFIABLE
    assert parameter_verdict(1.0, None).outcome == Grade.GOOD
    assert parameter_verdict(1.0, 0.05).outcome == Grade.GOOD
    assert parameter_verdict(-1.0, 0.3).outcome == Grade.WEAK
    assert parameter_verdict(1.0, 0.6).outcome == Grade.NOT_IDENTIFIABLE


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
    assert outcome == (Grade.CONTRADICTORY if nonnegative else Grade.GOOD)
    assert judge_parameter(-0.0022, 0.0015, terms).outcome != Grade.CONTRADICTORY
    assert judge_parameter(0.0022, 0.0002, terms).outcome == Grade.GOOD


@pytest.mark.parametrize("braking", [True, False])
def test_friction_may_fall_with_the_speed_but_not_drive_a_joint(runs: list[Run], braking: bool) -> None:
    """Stribeck friction that falls by more than viscous friction grows, or a current of the other sign."""

    def rubbing(run: Run) -> Run:
        speed = np.gradient(run.position, run.time, axis=0)
        rms = np.sqrt(np.mean(speed**2, axis=0))
        friction = np.sign(speed) * np.maximum(1 - np.abs(speed) / (4 * rms), 0.0) if braking else -speed / rms
        return replace(run, command=run.command + np.std(run.command, axis=0) * friction)

    gains = identify(FIVE_BAR, [rubbing(run) for run in runs]).drive_gains.values()
    assert {gain.verdict.outcome for gain in gains} == {Grade.GOOD if braking else Grade.CONTRADICTORY}


def test_the_first_finding_that_lowers_a_verdict_counts() -> None:
    note = Finding("note", ("a",), text="so", grade=Grade.WARNING)
    wide, wrong, turned = (
        Finding(kind, joints, text=kind, grade=grade)
        for kind, joints, grade in (
            ("wide", ("a",), Grade.WEAK),
            ("wrong", ("a", "b"), Grade.CONTRADICTORY),
            (NEGATIVE_GAIN, ("b",), Grade.CONTRADICTORY),
        )
    )
    assert decide("ab", [note]) == {"a": GOOD, "b": GOOD}
    assert decide("ab", [note, wide, wrong]) == {"a": coupled("a", "b"), "b": wrong}
    assert decide("ab", [note, wide]) == {"a": wide, "b": GOOD}
    assert decide("ab", [wrong, wide]) == {"a": wrong, "b": wrong}
    assert decide("abc", [wrong])["c"] == coupled("c", "a")
    assert decide("ab", [turned]) == {"a": GOOD, "b": turned}  # a factor of its own channel


def test_the_worst_of_several() -> None:
    good, weak, lost = parameter_verdict(1.0, 0.0), parameter_verdict(1.0, 0.3), parameter_verdict(None, None)
    assert worst([]) == worst([good]) == Grade.GOOD
    assert worst([good, weak]) == worst(iter([weak, good])) == Grade.WEAK
    assert worst([lost, weak]) == Grade.NOT_IDENTIFIABLE


def test_every_number_has_a_verdict_and_good_ones_say_nothing(result: Result) -> None:
    for gain in result.drive_gains.values():
        assert gain.verdict.outcome == Grade.GOOD
        assert gain.verdict.sentence == "good"
    for each in result.parameters.values():
        assert each.verdict == parameter_verdict(each.value, each.std)
        assert bool(each.verdict.advice) == (each.verdict.outcome != Grade.GOOD)


def test_no_gain_is_called_known_that_another_joint_makes_doubtful(result: Result) -> None:
    wrong, doubt = NEGATIVE, coupled(JOINTS[1], JOINTS[0])
    gains = [
        replace(gain, verdict=each) for gain, each in zip(result.drive_gains.values(), (wrong, doubt), strict=True)
    ]
    doubtful = result.replaced(drive_gains=dict(zip(JOINTS, gains, strict=True)))
    said = headline(doubtful)
    assert f"Joint '{JOINTS[1]}' is in doubt." in said
    assert reasons(doubtful)[1] == doubt
    assert "is known to +-" not in said


def test_a_light_payload_is_weak_or_with_more_noise_refused() -> None:
    light = Payload(name="light", mass=0.02)

    def pair(noise: float) -> list[Run]:
        plant = Plant(noise=noise)
        return [plant.run("free", 8.0, seed=1), replace(plant.run("loaded", 8.0, {"m": 0.02}, seed=2), payload=light)]

    verdicts = [gain.verdict for gain in identify(FIVE_BAR, pair(0.05)).drive_gains.values()]
    assert {verdict.outcome for verdict in verdicts} == {Grade.WEAK}
    assert {verdict.finding.kind for verdict in verdicts} == {"wide interval"}
    assert all("heavier payload" in verdict.advice for verdict in verdicts)
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
        assert (gain.verdict.outcome == Grade.GOOD) == good or abs(error) < 0.03
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
    turned = NEGATIVE
    both = result.replaced(drive_gains={j: replace(gain, verdict=turned) for j, gain in result.drive_gains.items()})
    (row,) = reasons(both)
    assert (set(row.joints), row.why, row.advice) == (set(JOINTS), turned.why, turned.advice)
    assert " ".join(both.summary(False).split()).count(turned.advice) == 1


SAID = ((Grade.WARNING, "slight", 0.2), (Grade.ERROR, "refusal", 0.0), (Grade.WARNING, "large", 3.0))


def test_notes_that_may_move_an_estimate_most_stand_first() -> None:
    notes = [Finding("model", text=text, grade=grade, size=size) for grade, text, size in SAID]
    listed = {grade: [each.what for each in members] for grade, members in by_severity(notes).items()}
    assert listed == {Grade.ERROR: ["refusal"], Grade.WARNING: ["large", "slight"]}


@pytest.mark.parametrize("causes", [{}, {joint: f"saturation of '{joint}'" for joint in JOINTS}])
def test_reasons_that_differ_in_numbers_or_causes_are_one_row_with_those_of_each(
    result: Result, causes: dict[str, str]
) -> None:
    gains = {}
    for (joint, gain), half in zip(result.drive_gains.items(), (10, 20), strict=True):
        text = "the 95 % interval is {own}" + (f", because of {causes[joint]}" if causes else "")
        advice = "log the current" + LONGER * (half > 15)
        finding = Finding("wide", (joint,), text=text, own=f"+-{half} %", advice=advice, grade=Grade.WEAK)
        gains[joint] = replace(gain, std=half / 196 * gain.value, verdict=finding)
    (row,) = reasons(result.replaced(drive_gains=gains))
    assert row.joints == JOINTS[::-1]
    for joint, number in zip(JOINTS, ("10 %", "20 %"), strict=True):
        assert number in row.why
        assert f"'{joint}'" in row.why
        assert causes.get(joint, "") in row.why


@pytest.mark.parametrize(("grade", "first"), [(Grade.WEAK, False), (Grade.CONTRADICTORY, True)])
def test_an_assumed_unit_is_in_the_headline_where_gains_contradict(result: Result, grade: Grade, first: bool) -> None:
    note = Finding(ASSUMED_UNIT, text="positions are assumed to be in deg", advice="confirm", shown_as=DRAFT)
    gains = {
        joint: replace(gain, verdict=Finding("misfit", (joint,), text="a misfit", grade=grade))
        for joint, gain in result.drive_gains.items()
    }
    changed = result.replaced(drive_gains=gains, notes=(*result.notes, note))
    assert ("Positions are assumed to be in deg." in headline(changed)) == first
    assert "Assumed; correct it in" in plain(summary_page(changed))


@pytest.mark.parametrize(("left", "unexplained"), [(0.05, False), (1.0, True)])
def test_moments_of_a_base_that_hangs_still_are_no_misfit(left: float, unexplained: bool) -> None:
    """Hung above its centre of mass a base has moments of 0.05 N m, all noise, while its terms of 3 N m cancel."""
    problem = SimpleNamespace(
        base=list(range(6)),
        balance=lambda theta: np.array([2.0, 2.0, 100.0, left, left, left]),
        largest_terms=lambda theta: np.array([2.0, 2.0, 100.0, 3.0, 3.0, 3.0]),
    )
    solution = SimpleNamespace(theta=np.zeros(1), sigma=np.array([0.5, 0.5, 0.5, left, left, left]))
    shares = base_misfit(SimpleNamespace(problem=problem, solution=solution))
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
    tilt = Finding("gravity", text="gravity tilted towards (1, 0, 0)")
    moves = dict.fromkeys(("left", "right"), 40.0)
    effect = EstimatedEffect("gravity", tilt, 4.0, 0.1, "deg", 100.0, 0.6, moves, description=True)
    findings = diagnose(fit, Examination(contradicting=(effect,)), estimates, {}, {}, (), 0.03)
    verdicts = decide(("left", "right"), findings)
    outcome = Grade.CONTRADICTORY if refuted else Grade.NOT_IDENTIFIABLE
    assert {verdict.outcome for verdict in verdicts.values()} == {outcome}
