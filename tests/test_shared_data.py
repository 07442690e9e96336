"""The main job on the logs beside the checkout: an independent Orthoglide plant, and a real UR10e."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from idim.estimation.identify import identify
from idim.estimation.payload import weigh
from idim.estimation.result import Result
from idim.estimation.verdicts import Outcome
from idim.signals.experiment import read_experiment
from idim.signals.run import read_run

ORTHOGLIDE = """\
robot: orthoglide
signals: {{time: t, position: {{"11": q11, "12": q12, "13": q13}}, current: {{"11": v1, "12": v2, "13": v3}}}}
prior_gains: {{"11": 2001, "12": 2001, "13": 2001}}
runs:
"""
RUNS = """\
  - {{log: {data}/exciting_1_unloaded.csv}}
  - {{log: {data}/exciting_2_unloaded.csv}}
  - {{log: {data}/exciting_3_loaded_1983g.csv, payload: {{name: steel, mass: 1.983}}}}
  - {{log: {data}/exciting_4_loaded_1983g.csv, payload: {{name: steel, mass: 1.983}}}}
validation:
  - {{log: {data}/validation_loaded_1983g.csv, payload: {{name: steel, mass: 1.983}}}}
"""
WEIGHING = """\
  - {{log: {data}/second_payload_unloaded_reference.csv}}
  - {{log: {data}/second_payload_1136g.csv, payload: {{name: second}}}}
"""
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
CONTROLLER = (11.976, 11.976, 9.839, 10.763, 10.76, 10.76)  # N m/A


@pytest.fixture(scope="module")
def folder(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("experiments")
    data = shared / "orthoglide_sim"
    (folder / "orthoglide.yaml").write_text((ORTHOGLIDE + RUNS).format(data=data))
    (folder / "weighing.yaml").write_text((ORTHOGLIDE + WEIGHING).format(data=data))
    names = [f"{joint}_joint" for joint in JOINTS]
    position = ", ".join(f"{name}: {2 + k}" for k, name in enumerate(names))
    current = ", ".join(f"{name}: {14 + k}" for k, name in enumerate(names))
    (folder / "ur10e.yaml").write_text(
        f"robot: ur10e\nsignals: {{time: 1, position: {{{position}}}, current: {{{current}}}}}\nruns:\n"
        f"  - {{log: {shared}/ur10e/ur-20_02_19_14harm50sec.csv}}\n"
        f"  - {{log: {shared}/ur10e/ur-20_02_19_14harm50secLoad.csv, payload: {{name: disc, mass: 2.805}}}}\n"
    )
    return folder


@pytest.fixture(scope="module")
def truth(shared: Path) -> dict:
    return json.loads((shared / "orthoglide_sim" / "truth.json").read_text())


@pytest.fixture(scope="module")
def orthoglide(folder: Path) -> Result:
    return identify(folder / "orthoglide.yaml")


@pytest.fixture(scope="module")
def ur10e(folder: Path) -> Result:
    return identify(folder / "ur10e.yaml")


def test_orthoglide_gains(orthoglide: Result, truth: dict) -> None:
    for estimate, gain in zip(orthoglide.drive_gains.values(), truth["drive_gains"], strict=True):
        assert estimate.value == pytest.approx(gain, rel=0.003)
        assert abs(estimate.value - gain) < 4 * estimate.std
        assert estimate.rel_std < 0.3
        assert estimate.unit == "N/A"
    assert len(orthoglide.parameters) == 61


def test_orthoglide_delay_is_half_a_sample(orthoglide: Result) -> None:
    for delay in orthoglide.delays.values():
        assert delay.value == pytest.approx(5e-4, abs=5e-5)


def test_orthoglide_parameters(orthoglide: Result, truth: dict) -> None:
    # The truth is listed by the standard parameter that each base parameter keeps; it is regrouped all the same.
    listed = truth["base_parameters"]
    told = {name.removesuffix("R"): each for name, each in orthoglide.parameters.items() if each.value is not None}
    compared = [name for name in told if name in listed]
    assert len(compared) >= 40
    for name in compared:
        assert abs(told[name].value - listed[name]) < 6 * told[name].std + 0.002 * abs(listed[name]), name


def test_orthoglide_validation(orthoglide: Result, folder: Path) -> None:
    described = read_experiment(folder / "orthoglide.yaml")
    logged = described.validation[0]
    run = read_run(logged.log, described.signals, logged.payload, described.units)
    for error in orthoglide.validate(run):
        assert error.rms < 0.35  # N, of signals of 93 to 105 N
        assert 80 < error.signal < 120


@pytest.mark.parametrize(("gains", "mass", "off"), [("identified", 1.136, 0.005), ("prior", 1.09, 0.01)])
def test_the_second_payload(orthoglide: Result, folder: Path, gains: str, mass: float, off: float) -> None:
    (second,) = weigh(orthoglide, folder / "weighing.yaml", gains)
    estimate = second.parameters["m"]
    assert (second.name, second.run) == ("second", "second_payload_1136g")
    assert estimate.value == pytest.approx(mass, abs=off)
    assert estimate.std < 0.01


def test_ur10e_gains(ur10e: Result) -> None:
    gains = list(ur10e.drive_gains.values())
    for k in (1, 2):
        assert gains[k].value == pytest.approx(CONTROLLER[k], rel=0.04)
    for k in (3, 4, 5):
        assert gains[k].value == pytest.approx(CONTROLLER[k], rel=0.08)
    assert gains[0].rel_std > 3
    assert [gain.verdict.outcome for gain in gains] == [Outcome.WEAK, *[Outcome.GOOD] * 5]


def test_ur10e_payload_has_ten_parameters(ur10e: Result) -> None:
    (payload,) = ur10e.payloads
    assert payload.known == {"m"}
    assert set(payload.parameters) == {"xx", "xy", "xz", "yy", "yz", "zz", "mx", "my", "mz", "m"}


def test_ur10e_by_total_least_squares_is_not_to_be_trusted(folder: Path) -> None:
    result = identify(folder / "ur10e.yaml", method="tls")
    assert result.statistics["singular_ratio"] < 3
    said = " ".join(result.summary().split())
    assert "not to be trusted" in said
    assert f"ratio of the two smallest singular values of W_tot: {result.statistics['singular_ratio']:.2f}" in said
    assert all(gain.verdict.outcome is Outcome.CONTRADICTORY for gain in result.drive_gains.values())
