"""Currents logged so late, or early, that no delay of the model describes it, are named as such."""

from __future__ import annotations

from dataclasses import replace

import pytest
from five_bar_logs import GAINS, STEEL, Plant

from gtau.estimation.diagnostics.diagnose import examine
from gtau.estimation.diagnostics.effort import columns_of_effort, middle_rows
from gtau.estimation.estimators.maximum_likelihood import ML
from gtau.estimation.regression.dataset import reduce_runs
from gtau.findings import silent
from gtau.model.home import load_robot
from gtau.result import Result, identify
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run

ROBOT = load_robot("five-bar")


def logs(*leads: float) -> list[Run]:
    """Two runs whose currents are those of the motion ``leads`` (s) later."""
    plant = Plant(delays=leads, noise=0.01)
    return [
        plant.run("free", 12.0, seed=1),
        replace(plant.run("loaded", 12.0, STEEL, seed=2), payload=Payload(name="steel", mass=STEEL["m"])),
    ]


def reasons(result: Result) -> dict[str, str]:
    return {joint: gain.verdict.why for joint, gain in result.drive_gains.items()}


@pytest.mark.slow
@pytest.mark.parametrize(("lead", "named"), [(0.1, "100 ms too early"), (-0.1, "100 ms too late")])
def test_a_delay_of_100_ms_is_named_as_one(lead: float, named: str) -> None:
    result = identify(ROBOT, logs(lead, lead))
    for joint, why in reasons(result).items():
        assert why.startswith(f"the currents were logged {named}"), joint
    assert "preparation: {delay: " in next(iter(result.drive_gains.values())).verdict.advice


def test_the_delay_of_one_joint_is_its_own() -> None:
    found = identify(ROBOT, logs(-0.05, 0.004))
    left, right = reasons(found).values()
    assert left.startswith("the currents were logged 50 ms too late")
    assert right.startswith("joint 'left' contradicts the model")


def test_a_lag_is_named_where_the_delays_are_not_estimated() -> None:
    """Where the delays are lost in noise, as of the tutorial's logs, nothing was said of a lag of 100 ms."""
    system = reduce_runs(ROBOT, logs(-0.1, -0.1)).system(delays=False)
    said = str(examine(ML.fit(system, None, silent)).findings[0])
    assert "logged 100 ms too late" in said
    assert "'preparation: {delay: 0.0999}'" in said


@pytest.mark.parametrize("lead", [0.0, 0.02, -0.02])
def test_delays_that_the_model_describes_are_none(lead: float) -> None:
    dataset = reduce_runs(ROBOT, logs(lead, lead))
    assert columns_of_effort(middle_rows(ML.fit(dataset.system(), None, silent))) == ()


def test_currents_of_one_joint_in_another_unit_are_asked_about() -> None:
    """Sixty times as large: the currents are apart by less than units are, the gains are not."""
    runs = [replace(run, command=run.command * [1.0, 60.0]) for run in logs(0.0, 0.0)]
    result = identify(ROBOT, runs)
    assert [gain.verdict.finding.kind for gain in result.drive_gains.values()] == ["gains far apart"] * 2
    assert not result.accepted
    assert result.drive_gains["right"].value == pytest.approx(GAINS[1] / 60, rel=0.01)
    stated = identify(ROBOT, runs, prior_gains={"left": GAINS[0], "right": GAINS[1] / 60})
    assert stated.accepted
