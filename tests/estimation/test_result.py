"""The result: what it says of itself, and that it survives being written and read."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from five_bar_logs import CHI, GAINS, JOINTS, STEEL, TOOL, Plant, five_bar, path

from gtau.errors import GtauError
from gtau.estimation.results.model_file import to_document
from gtau.findings import Finding, Grade
from gtau.model.home import load_robot
from gtau.result import Result, identify, load
from gtau.signals.reading.statements import Payload

PLANT = Plant(delays=(1e-3, 2e-3), noise=0.01)
KNOWN = Payload(name="steel", mass=STEEL["m"])


@pytest.fixture(scope="module")
def result() -> Result:
    runs = [PLANT.run("free", seed=1), PLANT.run("loaded", payload=STEEL, seed=2)]
    return identify(load_robot("five-bar"), [runs[0], replace(runs[1], payload=KNOWN)])


@pytest.fixture(scope="module")
def again(result: Result, tmp_path_factory: pytest.TempPathFactory) -> Result:
    file = tmp_path_factory.mktemp("model") / "model.json"
    result.save(file)
    return load(file)


def test_a_model_survives_writing_and_reading(result: Result, again: Result) -> None:
    assert to_document(again) == to_document(result)
    assert again.robot == result.robot
    assert again.preparation == result.preparation
    assert again.parameters == result.parameters
    assert again.payloads == result.payloads
    assert again.residuals == result.residuals
    assert again.summary() == result.summary()


def test_a_finding_survives_writing_and_reading(result: Result, tmp_path: Path) -> None:
    words = {"text": "the 95 % interval is {own}", "own": "+-5 %", "advice": "use longer runs"}
    verdict = Finding("wide interval", ("left",), "3", {"remains": 0.1}, ("gravity",), grade=Grade.WEAK, **words)
    place = {"source": "free", "time": 1.5, "share": 0.1, "text": "10 % of the samples are stale"}
    note = Finding("stale samples", ("left",), grade=Grade.INFORMATION, shown_as="repaired log", **place)
    gains = {name: replace(gain, verdict=verdict) for name, gain in result.drive_gains.items()}
    result.replaced(drive_gains=gains, notes=(note,)).save(tmp_path / "model.json")
    again = load(tmp_path / "model.json")
    assert {gain.verdict for gain in again.drive_gains.values()} == {verdict}
    assert again.notes == (note,)
    np.testing.assert_array_equal(again.covariance, result.covariance)


def test_one_state_is_one_row_of_states(result: Result) -> None:
    states = np.array([[[0.1, 0.2]], [[0.3, -0.1]], [[1.0, 2.0]]])
    for compute in (result.torques, result.currents):
        np.testing.assert_array_equal(compute(*states[:, 0]), compute(*states)[0])


def test_a_model_that_was_read_predicts_the_same(result: Result, again: Result) -> None:
    run = PLANT.run("check", seed=7, seconds=5.0)
    one, other = result.predict(run), again.predict(run)
    for name in ("time", "predicted", "measured", "keep"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert result.validate(run) == again.validate(run)


def test_nothing_in_a_model_is_not_json(result: Result, tmp_path: Path) -> None:
    result.save(tmp_path / "model.json")

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    assert json.loads((tmp_path / "model.json").read_text(), parse_constant=refuse) == json.loads(
        json.dumps(to_document(result))
    )
    assert [file.name for file in tmp_path.iterdir()] == ["model.json"]


def values_of(document: Any, at: tuple = ()) -> Iterator[tuple]:
    """Paths to all values of a document, the first two of each list."""
    items = document.items() if isinstance(document, dict) else enumerate(document[:2])
    for key, value in items:
        yield (*at, key)
        if isinstance(value, dict | list):
            yield from values_of(value, (*at, key))


def edited(document: Any, place: tuple, *value: Any) -> Any:
    """A copy with another value at a place, or with none."""
    key, *rest = place
    copy = dict(document) if isinstance(document, dict) else list(document)
    if rest:
        copy[key] = edited(copy[key], tuple(rest), *value)
    elif value:
        copy[key] = value[0]
    else:
        del copy[key]
    return copy


WRONG = (None, "abc", -3, [], {}, 1e300, "", {"a": {"b": 1}}, [1, "x"], 10**400)


@pytest.mark.slow
def test_an_edited_model_works_or_is_refused_in_a_sentence(result: Result, tmp_path: Path) -> None:
    document = json.loads(json.dumps(to_document(result)))
    file, places = tmp_path / "model.json", list(values_of(document))
    edits = [edited(document, place) for place in places]
    for k, place in enumerate(places):  # all wrong values at each key of the document, two of them at the others
        chosen = WRONG if len(place) == 1 else (WRONG[k % len(WRONG)], WRONG[(k + 3) % len(WRONG)])
        edits += [edited(document, place, value) for value in chosen]
    assert len(edits) > 1000
    refused = []
    for edit in edits:
        file.write_text(json.dumps(edit))
        try:
            found = load(file)
        except GtauError as error:
            refused.append(str(error))
        else:
            assert found.to_frame().height
            assert found.summary()
    assert len(edits) / 2 < len(refused) < len(edits)
    assert all(sentence.startswith(str(file)) for sentence in refused)
    assert max(map(len, refused)) < len(str(file)) + 500


def test_predictions_are_the_plant_s_torques(result: Result) -> None:
    for payload, values in ((None, {}), (KNOWN, STEEL)):
        run = replace(PLANT.run("check", seed=7, payload=values), payload=payload)
        found = result.predict(run).in_band
        assert found.joints == JOINTS
        assert found.predicted.shape == found.measured.shape == found.keep.shape == (len(found.time), 2)
        loaded = dict(CHI)
        for kind, value in values.items():
            loaded[f"{kind}_{TOOL}"] += value
        true = five_bar().torques(*path(found.time, seed=7), loaded)
        rms = np.sqrt(np.mean(true**2))
        for j in range(2):
            kept = found.keep[:, j]
            assert 0.5 < kept.mean() < 1.0
            # The decimation filter takes off a little of the fastest motion, in the same way from both.
            assert np.abs(found.predicted[kept, j] - true[kept, j]).max() < 0.1 * rms
            error = (found.predicted - found.measured)[kept, j]
            assert np.sqrt(np.mean(error**2)) < 0.005 * rms  # the noise of the currents, behind the filter
        for error, residual in zip(result.validate(run), result.residuals, strict=True):
            assert error.rms == pytest.approx(residual.rms, rel=0.3)
            assert error.unit == "N m"
            assert error.relative == 100 * error.rms / error.signal


def test_validation_errors_of_all_samples_stand_beside_those_away_from_reversals(result: Result) -> None:
    run = PLANT.run("check", seed=7)
    raw = result.predict(run)
    found = raw.in_band
    np.testing.assert_allclose(raw.measured, result.gains * run.command[:, :2])
    assert found.valid.mean() > found.keep.mean()
    for j, error in enumerate(result.validate(run)):
        rows = found.valid[:, j]
        every, unfiltered = ((each.predicted - each.measured)[rows, j] for each in (found, raw))
        assert error.rms_all == pytest.approx(np.sqrt(np.mean(every**2)))
        assert error.rms_raw == pytest.approx(np.sqrt(np.mean(unfiltered**2)))
        assert error.rms_raw > 2 * error.rms_all  # the noise of the currents
        for of_all, name in ((error.rms_raw, "rms"), (error.signal_raw, "signal")):
            assert np.sqrt(sum(getattr(band, name) ** 2 for band in error.bands)) == pytest.approx(of_all, rel=0.05)
        assert [band.high for band in error.bands[:-1]] == [band.low for band in error.bands[1:]]
        assert error.bands[-1].high == pytest.approx(run.rate / 2)
        assert error.relative_all == pytest.approx(100 * error.rms_all / error.signal_all)
    gap = np.ones(run.position.shape, dtype=bool)
    gap[1000:1200] = False
    with_gap = result.predict(replace(run, valid=gap))
    lost = found.valid.all(axis=1) & ~with_gap.valid.all(axis=1)
    seconds = with_gap.time[lost]
    assert 0.4 <= np.ptp(seconds) < 0.6
    assert run.time[1000] - 0.1 < seconds[0] <= run.time[1000]


def test_a_prediction_is_shown_in_one_line(result: Result) -> None:
    assert repr(result.predict(PLANT.run("check", seed=7))).count("\n") == 0
    assert len(repr(result.predict(PLANT.run("check", seed=7)))) < 100


def test_nearest_singular_poses_are_timed_from_the_run_s_start() -> None:
    runs = [PLANT.run("free", seed=1), PLANT.run("loaded", payload=STEEL, seed=2)]
    late = [replace(run, time=run.time + 1000.0) for run in (runs[0], replace(runs[1], payload=KNOWN))]
    for pose in identify(load_robot("five-bar"), late).singularities:
        assert 0.0 <= pose.time <= runs[0].time[-1] - runs[0].time[0]


def test_a_payload_that_the_model_knows_needs_no_more_than_its_name(result: Result) -> None:
    run = PLANT.run("check", seed=7, payload=STEEL)
    named, described = (replace(run, payload=Payload(name="steel", mass=mass)) for mass in (None, STEEL["m"]))
    np.testing.assert_array_equal(result.predict(named).predicted, result.predict(described).predicted)
    with pytest.raises(GtauError, match="carries the payload 'lead', whose mass neither the run nor the model knows"):
        result.predict(replace(run, payload=Payload(name="lead")))


def test_a_run_that_does_not_suit(result: Result) -> None:
    run = PLANT.run("check", seed=7, seconds=4.0)
    with pytest.raises(GtauError, match="has the joints a, b, but the robot's actuated joints are left, right"):
        result.predict(replace(run, joints=("a", "b")))
    with pytest.raises(GtauError, match="holds torques, but the model was identified from currents"):
        result.predict(replace(run, kind="torque"))
    short = {name: getattr(run, name)[:40] for name in ("time", "position", "command", "valid")}
    with pytest.raises(GtauError, match="give a longer"):
        result.validate(replace(run, **short))


def test_numbers_have_units_and_deviations(result: Result) -> None:
    assert [(e.name, e.unit) for e in result.drive_gains.values()] == [(joint, "N m/A") for joint in JOINTS]
    units = {"zz": "kg m2", "ia": "kg m2", "mx": "kg m", "my": "kg m", "fv": "N m s/rad", "fs": "N m", "off": "N m"}
    for name, estimate in result.parameters.items():
        assert estimate.unit == units[name.split("_")[0]]
        assert estimate.std > 0
        assert estimate.rel_std == pytest.approx(100 * estimate.std / abs(estimate.value))
        assert estimate.regrouping.startswith(name.removesuffix("R"))
        assert (estimate.regrouping != name) == name.endswith("R")
    assert set(result.essential) <= set(result.parameters)
    prismatic = load_robot("orthoglide")
    assert prismatic.joint("11").kind == "prismatic"


def test_covariance_and_deviations_are_one_thing(result: Result) -> None:
    std = dict(zip(result.covariance_names, np.sqrt(np.diag(result.covariance)), strict=True))
    for joint, gain in result.drive_gains.items():
        assert gain.std == std[f"gain_{joint}"]
        assert result.delays[joint].std == std[f"delay_{joint}"]
    for name, estimate in result.parameters.items():
        assert estimate.std == std[name]
    assert np.linalg.eigvalsh(result.covariance).min() > -1e-12 * np.linalg.eigvalsh(result.covariance).max()


def test_summary_holds_what_a_person_looks_for(result: Result) -> None:
    text = result.summary()
    assert max(map(len, text.splitlines())) <= 80
    for expected in ("five-bar", "maximum likelihood", "free, loaded", "N m/A", "steel", "known", "Torque fit"):
        assert expected in text
    for joint, gain in result.drive_gains.items():
        row = next(line for line in text.splitlines() if line.startswith(f"joint {joint} "))
        assert float(row.split()[3]) == pytest.approx(gain.value, rel=1e-3)
    assert "nan" not in text
    assert "None" not in text


def test_gains_that_are_given_are_not_estimates() -> None:
    prior = dict(zip(JOINTS, GAINS, strict=True))
    found = identify(load_robot("five-bar"), [PLANT.run("free", seed=1)], "wls", prior_gains=prior)
    for joint, gain in found.drive_gains.items():
        assert (gain.value, gain.std, gain.rel_std) == (prior[joint], None, None)
    assert found.payloads == ()
    assert "singular_ratio" not in found.statistics


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"method": "magic"}, "there is no method 'magic'; choose from ml, "),
        ({"runs": []}, "a robot alone cannot be identified; give its runs too"),
        ({"runs": None}, "a robot alone cannot be identified; give its runs too"),
    ],
)
def test_what_cannot_be_asked_for(arguments: dict, sentence: str) -> None:
    with pytest.raises(GtauError) as refused:
        identify(load_robot("five-bar"), **({"runs": [PLANT.run("free", seconds=1.0)]} | arguments))
    assert sentence in str(refused.value)


def test_currents_and_torques_do_not_mix() -> None:
    runs = [PLANT.run("free", seconds=2.0), PLANT.run("torques", seconds=2.0, kind="torque")]
    with pytest.raises(GtauError, match="some runs hold currents and others torques"):
        identify(load_robot("five-bar"), runs, "wls", prior_gains=dict(zip(JOINTS, GAINS, strict=True)))
