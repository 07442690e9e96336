"""Weighing with a model."""

from __future__ import annotations

from pathlib import Path

import pytest
from five_bar_logs import EXPERIMENT, STEEL, Plant, write_log

from gtau.estimation.identify import identify
from gtau.estimation.results.estimate import PayloadEstimate
from gtau.estimation.results.result import Result
from gtau.estimation.weigh import weigh

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


def test_without_an_empty_run_the_known_payload_is_the_reference(model: Result, folder: Path) -> None:
    others = {kind: value for kind, value in STEEL.items() if kind != "m"}
    known = KNOWN.replace("}}", f", parameters: {others}}}}}".replace("'", ""))
    runs = HEAD[: HEAD.index("  - {log: free.csv")] + known + UNKNOWN
    found = weighed(model, folder, runs, "identified").parameters["m"]
    assert found.value == pytest.approx(LEAD["m"], rel=0.01)
    assert found.std > MASS_STD / 2  # the difference is weighed, so what is not known of the one is not of the other
