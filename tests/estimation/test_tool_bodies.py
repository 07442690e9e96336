"""Runs that carry another body at the tool than declared are named, with its mass."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import GAINS, STEEL, Plant
from stated_arm import plant, robot

from gtau.estimation.diagnostics.descriptions import PAYLOAD_BODY, TOOL_BODY, other_loads
from gtau.estimation.effects.effect import EstimatedEffect
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.maximum_likelihood import ML
from gtau.estimation.regression.dataset import reduce_runs
from gtau.findings import Grade
from gtau.model.home import load_robot
from gtau.result import Result, identify
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run

FIVE_BAR = load_robot("five-bar")
KNOWN = Payload(name="steel", mass=STEEL["m"])
BODY = {"m": 1.5, "mx": 0.05, "mz": 0.1}


def arm_runs(folder: Path, loaded: tuple[bool, ...]) -> list[Run]:
    made = replace(plant(robot(folder)), tool="j4")
    return [
        replace(made.run(seed, BODY if carries else None), kind="torque", name=f"run {seed}")
        for seed, carries in enumerate(loaded)
    ]


def cause_of(result: Result) -> dict:
    (found,) = (each for each in result.effects if each.effect == "tool bodies")
    cause = found.cause
    assert cause.kind == TOOL_BODY
    assert "an undeclared body of" in cause.what or cause.what.endswith("than in the others")
    return dict(cause.values)


@pytest.mark.parametrize(
    ("loaded", "more"),
    [
        ((False, True), {"run 1": BODY["m"]}),
        pytest.param((False, True, False), {"run 1": BODY["m"]}, marks=pytest.mark.slow),
        pytest.param((True, True, False), {"run 2": -BODY["m"]}, marks=pytest.mark.slow),
    ],
)
def test_an_undeclared_body_is_named_and_the_file_is_not_blamed(
    tmp_path: Path, loaded: tuple[bool, ...], more: dict[str, float]
) -> None:
    result = identify(robot(tmp_path), arm_runs(tmp_path, loaded))
    bodies = cause_of(result)["bodies"]
    assert {each["run"]: each["more"] for each in bodies} == pytest.approx(more, rel=0.03)
    assert all(abs(each["more"] - more[each["run"]]) < each["half"] < 0.1 for each in bodies)
    assert Grade.CONTRADICTORY in {each.verdict.outcome for each in result.drive_gains.values()}
    assert result.audit is None


def test_a_payload_on_another_body_is_named(tmp_path: Path) -> None:
    arm = robot(tmp_path)
    made = replace(plant(arm), tool="j3")
    loaded = replace(made.run(1, BODY), payload=Payload(name="steel", mass=BODY["m"]))
    result = identify(arm, [made.run(0), loaded])
    (found,) = (each for each in result.effects if each.effect == "tool bodies")
    assert (found.cause.kind, found.cause.subject) == (PAYLOAD_BODY, "j3")
    assert Grade.CONTRADICTORY in {each.verdict.outcome for each in result.drive_gains.values()}


def test_runs_with_the_same_load_are_not_suspected(tmp_path: Path) -> None:
    result = identify(robot(tmp_path), arm_runs(tmp_path, (False, False, False)))
    assert "tool bodies" not in {each.effect for each in result.effects}
    assert result.audit is not None


def loaded_runs(carried: tuple[bool, ...], declared: tuple[bool, ...]) -> list[Run]:
    made = Plant(noise=0.01)
    return [
        replace(made.run(f"run {k}", 8.0, STEEL if carries else None, seed=k), payload=KNOWN if says else None)
        for k, (carries, says) in enumerate(zip(carried, declared, strict=True))
    ]


def of_five_bar(carried: tuple[bool, ...], declared: tuple[bool, ...]) -> tuple[Fit, EstimatedEffect | None]:
    fit = ML.fit(reduce_runs(FIVE_BAR, loaded_runs(carried, declared)).system(per_run=True))
    return fit, other_loads(fit)


def test_a_payload_in_another_run_is_named_where_gains_are_noise() -> None:
    result = identify(FIVE_BAR, loaded_runs((False, False, True, True), (True, False, False, True)))
    for gain in result.drive_gains.values():
        assert "an undeclared body of 1.2" in str(gain.verdict)
        assert "at the tool in run 'run 2'" in str(gain.verdict)
        assert "less at the tool in run 'run 0' than payload 'steel'" in str(gain.verdict)


@pytest.mark.parametrize("run", [0, 1])
def test_the_only_payload_in_another_run_is_named(run: int) -> None:
    """An empty run that carries it as well explains as much, with negative gains."""
    result = identify(FIVE_BAR, loaded_runs((False, False, True), (run == 0, run == 1, False)))
    for gain in result.drive_gains.values():
        assert f"payload 'steel' in run 'run 2' in place of run 'run {run}' would explain" in str(gain.verdict)


@pytest.mark.parametrize(
    ("carried", "declared", "more"),
    [
        ((False, True, True), (False, True, False), {"run 2": STEEL["m"]}),
        ((False, True, False), (False, True, True), {"run 2": -STEEL["m"]}),
        ((False, True, False, True), (False, True, False, True), {}),
    ],
    ids=["not declared", "absent", "as declared"],
)
def test_loads_beside_gains(carried: tuple[bool, ...], declared: tuple[bool, ...], more: dict[str, float]) -> None:
    fit, found = of_five_bar(carried, declared)
    bodies = [] if found is None else found.cause.values["bodies"]
    if found is not None:
        absent = next(iter(more.values())) < 0
        assert ("less at the tool in run 'run 2' than payload 'steel'" in found.cause.what) == absent
        assert found.cause.what.startswith("an undeclared body of 1.") != absent
    assert {each["run"]: each["more"] for each in bodies} == pytest.approx(more, rel=0.02)
    if found is not None:  # the gains without it are the true ones
        moved = fit.gains * (1 + np.array(list(found.moves.values())) / 100)
        np.testing.assert_allclose(moved, GAINS, rtol=0.01)


def test_without_an_empty_run_payloads_are_differences_and_said_to_be() -> None:
    made, light = Plant(noise=0.01), {kind: value / 3 for kind, value in STEEL.items()}
    runs = [
        replace(made.run(name, 8.0, load, seed=seed), payload=Payload(name=name, mass=load["m"]))
        for seed, (name, load) in enumerate([("light", light), ("steel", STEEL)], start=1)
    ]
    result = identify(load_robot("five-bar"), runs)
    assert {gain.verdict.outcome for gain in result.drive_gains.values()} == {Grade.GOOD}
    light_mx, steel_mx = (payload.parameters["mx"] for payload in result.payloads)
    assert steel_mx.value is None
    assert light_mx.value == pytest.approx(light["mx"] - STEEL["mx"], rel=0.02)
    assert light_mx.regroups == "mx - mx of run steel"
    assert "add a run without payload" in str(light_mx.verdict)
    holding = {name for name, value in result.parameters.items() if "(with the load of run steel)" in value.regroups}
    assert {"mx_leftR", "zz_leftR", "zz_left_forearmR"} <= holding
    assert not {"my_left", "fs_left"} & holding
