"""Weighing with a model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import EXPERIMENT, STEEL, Plant, write_log

from gtau.errors import GtauError
from gtau.estimation.identify import identify
from gtau.estimation.results.estimate import Estimate, PayloadEstimate
from gtau.estimation.results.result import Result
from gtau.estimation.weigh import exact_gains, weigh
from gtau.report.render.terminal import plain
from gtau.report.validation import weighing_page
from gtau.signals.experiment import read_experiment

MASS_STD = 0.06  # 5 % of the known payload
LEAD = {"m": 0.8, "mx": 0.1, "my": -0.05, "zz": 0.03}
HEAD = EXPERIMENT[: EXPERIMENT.index("  - {log: loaded.csv")]
KNOWN = f"  - {{log: loaded.csv, payload: {{name: steel, mass: 1.2, mass_std: {MASS_STD}}}}}\n"
UNKNOWN = "  - {log: unknown.csv, payload: {name: lead}}\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("weighing")
    plant = Plant(noise=0.01)
    write_log(found / "free.csv", plant.run("free", seed=1))
    write_log(found / "loaded.csv", plant.run("loaded", payload=STEEL, seed=2))
    write_log(found / "unknown.csv", plant.run("unknown", payload=LEAD, seed=4))
    (found / "identified.yaml").write_text(HEAD + KNOWN)
    return found


@pytest.fixture(scope="module")
def model(folder: Path) -> Result:
    return identify(folder / "identified.yaml")


def weighed(model: Result, folder: Path, runs: str, gains: str) -> PayloadEstimate:
    (folder / "weighing.yaml").write_text(runs)
    (found,) = weigh(model, folder / "weighing.yaml", gains=gains)
    return found


@pytest.mark.parametrize("gains", ["identified", "prior"])
def test_a_known_payload_beside_the_unknown_one_changes_nothing(model: Result, folder: Path, gains: str) -> None:
    alone = weighed(model, folder, HEAD + UNKNOWN, gains).parameters["m"]
    beside = weighed(model, folder, HEAD + KNOWN + UNKNOWN, gains).parameters["m"]
    assert (beside.value, beside.std) == (alone.value, alone.std)


def test_the_deviation_has_that_of_the_mass_behind_the_gains(model: Result, folder: Path) -> None:
    found = weighed(model, folder, HEAD + KNOWN + UNKNOWN, "identified").parameters["m"]
    assert found.value == pytest.approx(LEAD["m"], rel=0.01)
    assert found.std / found.value == pytest.approx(MASS_STD / 1.2, rel=0.1)


def with_prior_gains(model: Result, folder: Path, left: object, right: object) -> Estimate:
    gains = f"{{left: {left}, right: {right}}}".replace("'", "")
    return weighed(model, folder, (HEAD + UNKNOWN).replace("{left: 2.5, right: 4.0}", gains), "prior").parameters["m"]


def test_the_interval_has_that_of_the_prior_gains(model: Result, folder: Path) -> None:
    """Each gain's standard deviation moves the mass as a gain that is larger by it does."""
    stated = {"value": 2.5, "std": 0.05}, {"value": 4.0, "std": 0.12}
    exact, both = with_prior_gains(model, folder, 2.5, 4.0), with_prior_gains(model, folder, *stated)
    assert both.value == exact.value
    larger = with_prior_gains(model, folder, 2.55, 4.0), with_prior_gains(model, folder, 2.5, 4.12)
    moves = [each.value - exact.value for each in larger]
    assert min(map(abs, moves)) > 2 * exact.std
    assert both.std == pytest.approx(np.hypot(exact.std, np.hypot(*moves)), rel=0.02)
    in_python = dict(zip(("left", "right"), stated, strict=True))
    (same,) = weigh(model, folder / "weighing.yaml", gains="prior", prior_gains=in_python)
    assert same.parameters["m"].std == pytest.approx(both.std)
    with pytest.raises(GtauError, match="std: -1 is out of range"):
        weigh(model, folder / "weighing.yaml", gains="prior", prior_gains=in_python | {"left": {"value": 2, "std": -1}})
    # with all gains 3 % too large, the interval holds the mass, which it does not where gains are taken for exact
    wrong = with_prior_gains(model, folder, 2.575, 4.12)
    low, high = wrong.interval(0.95)
    assert not low < LEAD["m"] < high
    low, high = with_prior_gains(model, folder, {"value": 2.575, "std": 0.075}, {"value": 4.12, "std": 0.12}).interval()
    assert low < LEAD["m"] < high


@pytest.mark.parametrize(
    ("gains", "exact"),
    [
        ("{left: 2.5, right: 4.0}", ("left", "right")),
        ("{left: 2.5, right: {value: 4.0, std: 0.1}}", ("left",)),
        ("{left: {value: 2.5, std: 0.1}, right: {value: 4.0, std: 0.1}}", ()),
    ],
)
def test_gains_that_are_taken_for_exact_are_named(
    gains: str, exact: tuple[str, ...], model: Result, folder: Path
) -> None:
    found = weighed(model, folder, (HEAD + UNKNOWN).replace("{left: 2.5, right: 4.0}", gains), "prior")
    experiment = read_experiment(folder / "weighing.yaml")
    assert exact_gains(experiment, "prior") == exact
    assert exact_gains(experiment, "identified") == ()
    said = " ".join(plain(weighing_page(model, [found], "prior", exact)).split())
    assert ("leave out the uncertainty of" in said) == ("taken for exact" in said) == bool(exact)
    assert ("of the gains of left:" in said) == (exact == ("left",))


def test_without_an_empty_run_the_known_payload_is_the_reference(model: Result, folder: Path) -> None:
    others = {kind: value for kind, value in STEEL.items() if kind != "m"}
    known = KNOWN.replace("}}", f", parameters: {others}}}}}".replace("'", ""))
    runs = HEAD[: HEAD.index("  - {log: free.csv")] + known + UNKNOWN
    found = weighed(model, folder, runs, "identified").parameters["m"]
    assert found.value == pytest.approx(LEAD["m"], rel=0.01)
    assert found.std > MASS_STD / 2  # the difference is weighed, so what is not known of the one is not of the other
