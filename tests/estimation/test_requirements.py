"""What an experiment requires of its result: met or missed, and shown wherever the result is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import Plant, write_experiment

import gtau
from gtau.estimation.effects.effect import EstimatedEffect
from gtau.estimation.results.estimate import Requirement
from gtau.estimation.results.model_file import to_document
from gtau.findings import Finding
from gtau.report.identification import report_page, summary_page, verdict_section
from gtau.report.page import Page, Text
from gtau.report.parameters import correlation_section, effects_chart
from gtau.report.terminal import plain
from gtau.report.torques import RunEvidence, determination, gather
from gtau.robots.parameter import parameter_of
from gtau.signals.preparation.filters import Decimator
from gtau.uses.prediction import Prediction


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> gtau.Result:
    file = write_experiment(tmp_path_factory.mktemp("required"), Plant(noise=0.02))
    file.write_text(f"{file.read_text()}require: {{torque_error: 50 %, gain_interval: 0.01 %}}\n")
    return gtau.identify(file)


def test_limits_are_held_against_fit_validation_and_intervals(result: gtau.Result) -> None:
    fit, check, gains = result.requirements
    worst = max(result.residuals, key=lambda each: each.relative)
    assert fit == Requirement("torque_error", 50.0, worst.relative, worst.joint)
    assert (check.run, check.met) == ("check", True)
    assert check.found is not None
    assert 0.1 < check.found < 10
    widest = max(result.drive_gains.values(), key=lambda gain: gain.half_width or 0.0)
    assert gains == Requirement("gain_interval", 0.01, widest.half_width, widest.name)
    assert not gains.met
    assert result.believable
    assert not result.accepted
    assert result.replaced(requirements=(fit, check)).accepted
    assert not Requirement("torque_error", 5.0, None, run="refused").met


def test_they_are_shown_and_kept(result: gtau.Result, tmp_path: Path) -> None:
    result.save(tmp_path / "model.json")
    assert gtau.load(tmp_path / "model.json").requirements == result.requirements
    assert [each["met"] for each in to_document(result)["requirements"]] == [True, True, False]
    for page in (summary_page(result), report_page(result, (), {})):
        assert "failed" in plain(page)
        assert "run 'check'" in plain(page)
    verdict = verdict_section(result).items[0]
    assert isinstance(verdict, Text)
    assert verdict.style == "bad"
    assert "1 of 3 requirements missed" in verdict.words


def test_the_condition_number_is_that_of_the_observation_matrix(result: gtau.Result) -> None:
    # by Cauchy's interlacing: the observation matrix is W_tot less its last column
    s, condition = result.singular_values, result.statistics["condition_number"]
    assert s[1] / s[-2] <= condition <= s[0] / s[-1]


def test_r_squared_is_of_the_kept_samples_of_all_runs() -> None:
    def run(measured: list[float], predicted: list[float]) -> RunEvidence:
        kept = np.array([[True], [True], [False]])
        arrays = [np.array(each)[:, None] for each in (predicted, measured)]
        arrays += [kept, kept, arrays[0]]
        return RunEvidence(None, True, Prediction(("q",), ("N m",), np.arange(3.0), *arrays, Decimator(1)))  # type: ignore[arg-type]

    runs = [run([1.0, 2.0, 99.0], [1.0, 2.5, 0.0]), run([3.0, 6.0, 0.0], [3.0, 5.0, 99.0])]
    assert determination(runs)["q"] == pytest.approx(1 - (0.5**2 + 1.0) / (2.0**2 + 1.0 + 0.0 + 3.0**2))
    assert determination([]) == {}


def test_names_of_drifting_parameters_and_many_estimates_are_explained(result: gtau.Result) -> None:
    names = ("fv_left@2", *(f"p{k}" for k in range(69)))
    shown = correlation_section(result.replaced(covariance_names=(*map(parameter_of, names),), covariance=np.eye(70)))
    assert shown is not None
    text = plain(Page("", shown))
    assert "fv_left@2: by how much fv_left in run 2, 'loaded', differs from its mean" in text


def test_effects_of_one_name_are_shown_by_their_words() -> None:
    def effect(name: str, words: str, move: float) -> EstimatedEffect:
        cause = Finding(name, ("left",), text=words, advice="move more slowly")
        return EstimatedEffect(name, cause, 1.0, 0.1, "", 9.0, 0.1, {"left": move})

    rows = effect("elasticity", "an elastic joint", 2.0), effect("elasticity", "its rotor", 1.0), effect("lag", "", 0.5)
    chart = effects_chart(rows, "torque")
    assert chart is not None
    assert [*chart.panels[0].y.names.values()] == ["an elastic joint", "its rotor", "lag left"]
    assert chart.panels[0].x.label == "moves a scale by, %"


def test_the_report_counts_r_squared_of_its_runs(result: gtau.Result) -> None:
    shares = determination(gather(result, result.data))
    assert all(0.99 < each < 1 for each in shares.values())
