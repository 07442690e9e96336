"""Wrenches that are not tared, or stated about another point, are named, and the intervals hold what they do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest
from floating_logs import AT_HOOK, AT_SOLE, GAINS, HOOK, POSE, SOLE, Truth, experiment, simulated

from gtau.estimation.effects.known.wrenches import WRENCH_OFFSETS, WRENCH_POINTS
from gtau.findings import Grade
from gtau.result import Result, identify

BASE = f"{{body: trunk, {POSE}}}"


@pytest.fixture(scope="module")
def flange() -> tuple[Truth, Truth]:
    """An arm on the ground without a tool, and with one of 3 kg beyond its force sensor."""
    return simulated(4, moving=False), simulated(5, moving=False, tool=True)


@pytest.fixture(scope="module")
def hanging() -> Truth:
    return simulated(3)


@pytest.fixture(scope="module")
def standing() -> Truth:
    return simulated(2, foot=1.0)


def reading(truth: Truth, offsets: dict[str, float]) -> Truth:
    return Truth(truth.chi, {name: each + offsets.get(name, 0.0) for name, each in truth.columns.items()})


def moved(wrench: str, at: np.ndarray, by: np.ndarray) -> str:
    assert str(at.tolist()) in wrench
    return wrench.replace(str(at.tolist()), str((at + by).tolist()))


def of_flange(folder: Path, flange: tuple[Truth, Truth], offsets: dict[str, float], by: np.ndarray) -> Result:
    bare, carrying = (reading(each, offsets) for each in flange)
    path = experiment(folder, "", bare, f"  wrenches: [{moved(AT_SOLE, SOLE, by)}]")
    pl.DataFrame(carrying.columns).write_csv(folder / "tool.csv")
    path.write_text(path.read_text().replace("runs: [", "runs: [{log: tool.csv}, "))
    return identify(path)


def of_hook(folder: Path, hanging: Truth, offsets: dict[str, float], by: np.ndarray) -> Result:
    base = f"{{body: trunk, {POSE}, wrenches: [{moved(AT_HOOK, HOOK, by)}]}}"
    return identify(experiment(folder, base, reading(hanging, offsets)))


def of_sole(folder: Path, standing: Truth, offsets: dict[str, float], by: np.ndarray) -> Result:
    path = experiment(folder, f"{BASE}\n  wrenches: [{moved(AT_SOLE, SOLE, by)}]", reading(standing, offsets))
    return identify(path)


CASES = {
    "flange": (of_flange, "flange", "3", {"sx": 5.0}, {"sz": 5.0}, True),
    "hook": (of_hook, "hanging", "trunk", {"hx": 5.0, "hz": -3.0}, {"hmy": 1.0}, False),
    "sole": (of_sole, "standing", "3", {"sx": 5.0}, {"sy": -4.0}, True),
}
QUICK = [("flange", "tared"), ("flange", "offset")]
FAULTS = [
    pytest.param(case, fault, marks=[] if (case, fault) in QUICK else [pytest.mark.slow], id=f"{case}, {fault}")
    for case in CASES
    for fault in ("tared", "offset", "other offset", "point")
]


@pytest.mark.parametrize(("case", "fault"), FAULTS)
def test_errors_of_wrenches_are_named(case: str, fault: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    identified, logs, body, one, other, moves = CASES[case]
    offsets = {"offset": one, "other offset": other}.get(fault, {})
    by = np.array([0.02, 0.0, 0.0]) * (fault == "point")
    result = identified(tmp_path, request.getfixturevalue(logs), offsets, by)
    of_wrenches = [effect for effect in result.effects if effect.effect.startswith("wrench")]
    if fault == "tared":
        assert max((effect.share for effect in of_wrenches), default=0.0) < 0.02
        assert all(abs(result.drive_gains[joint].value / gain - 1) < 0.05 for joint, gain in GAINS.items())
        assert not any(each.verdict.outcome == Grade.CONTRADICTORY for each in result.drive_gains.values())
        return
    largest = max(of_wrenches, key=lambda effect: effect.share)
    cause, expected = largest.cause, WRENCH_POINTS if fault == "point" else WRENCH_OFFSETS
    assert (cause.kind, cause.subject) == (expected.name, body)
    if fault == "point":  # the file's point is too far along x
        assert cause.what.endswith("off in x")
        assert largest.size == pytest.approx(-20.0, abs=4.0)
    for joint, gain in GAINS.items():
        each = result.drive_gains[joint]
        low, high = each.interval(0.95) or (0.0, 0.0)
        assert each.verdict.outcome == Grade.CONTRADICTORY or low < gain < high
        assert "payload" not in each.verdict.sentence
    verdicts = [each.verdict for each in result.drive_gains.values()]
    if fault == "point" and moves:
        assert Grade.CONTRADICTORY in {each.outcome for each in verdicts}
    said = [each.finding.causes[0] for each in verdicts if each.finding and each.finding.causes]
    assert set(said) <= {cause.kind}  # and of nothing else
    noted = {note.kind for note in result.notes}
    assert said or "description refuted, gains unmoved" in noted
