"""Findings are one record with its words; here are sentences with branches that few fits reach."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from pydantic import TypeAdapter

from gtau.estimation.diagnostics.gains import explained_share, refuted, refuted_descriptions
from gtau.estimation.diagnostics.gravity import log_with_gravity
from gtau.estimation.diagnostics.verdict import GOOD, WRENCHES, wrenches_first
from gtau.estimation.effects.effect import RELATIVE, EstimatedEffect
from gtau.estimation.effects.known import EFFECTS
from gtau.estimation.results.conclusions import not_separated
from gtau.findings import Finding, Grade, finding_document, listed, percent, percents
from gtau.model.home import load_robot

ZERO = Finding("encoder zeros", ("left",), text="an error in the zero of encoder 'left'", advice="compare the zeros")


def fit(**problem: Any) -> Any:
    parts = {"wrenches": (), "base": ()} | problem
    return SimpleNamespace(free_gains=True, problem=SimpleNamespace(**parts), system=SimpleNamespace(payloads=()))


def effect(size: float, unit: str, move: float) -> EstimatedEffect:
    return EstimatedEffect("encoder zeros", ZERO, size, 0.1, unit, 30.0, 0.31, {"left": 100 * move})


@pytest.mark.parametrize(
    ("size", "unit", "sized"),
    [(1.2, "deg", " (1.2 deg)"), (-0.12, RELATIVE, " (-12 % of itself)"), (1.0, "", "")],
)
def test_a_description_is_refuted_with_its_size(size: float, unit: str, sized: str) -> None:
    part = effect(size, unit, 0.0)
    assert explained_share(part) == f"{ZERO.what}{sized} would explain 31 % of the residual variance"


@pytest.mark.parametrize(
    ("move", "own"), [(-0.045, "-4.5 %"), (-1.2, "-120 %, which reverses its sign"), (-23.0, "more than 1000 %")]
)
def test_what_a_description_does_to_a_gain(move: float, own: str) -> None:
    gain = SimpleNamespace(random_half=0.1)
    (finding,) = refuted_descriptions(fit(), [effect(1.2, "deg", move)], {"left": gain}, (), 0.03)  # type: ignore[arg-type,dict-item]
    assert finding.what.endswith(f"and move the gain by {own}")
    assert (finding.causes, finding.outcome) == (("encoder zeros",), Grade.CONTRADICTORY)


def test_measured_wrenches_come_first_in_the_advice_unless_one_is_the_cause() -> None:
    assert wrenches_first(fit(), "check the signs") == "check the signs"
    assert wrenches_first(fit(wrenches=("3",)), "check the signs") == f"{WRENCHES}; otherwise check the signs"
    point = replace(effect(1.0, "", 0.1), cause=Finding("wrench points", text="the point", advice="measure the point"))
    assert refuted(fit(wrenches=("3",)), point, ("left",), "so").advice == "measure the point"


def test_currents_are_logged_for_gravity_in_their_own_name() -> None:
    assert log_with_gravity("actual currents").startswith("log the actual currents of the motors, or write 'robot:")
    assert "(UR: 'use_currents_as_efforts: true')" in log_with_gravity()


def test_every_effect_says_what_it_is_and_what_to_do() -> None:
    system, dataset = SimpleNamespace(payloads=("steel",)), SimpleNamespace(robot=load_robot("five-bar"))
    problem = SimpleNamespace(joints=("left",))
    loaded = SimpleNamespace(kind="torque", system=system, dataset=dataset, problem=problem)
    for each in EFFECTS:
        column = SimpleNamespace(joint="left", subject="", about="run", plausible=1.0, waves=(101.0,))
        cause = each.cause(loaded, column, 0.1)  # type: ignore[arg-type]
        assert (cause.kind, cause.joints) == (each.name, ("left",))
        assert cause.what
        assert cause.advice


def test_braces_in_names_stay_braces() -> None:
    (note,) = not_separated(["mx_{}", "mx_{own"])
    assert "cannot separate mx_{}, mx_{own from the other" in note.what


@pytest.mark.parametrize("finding", [GOOD, ZERO, Finding("a", ("b",), "c", {"remains": 0.1}, ("d",), own="+-3 %")])
def test_findings_are_documents(finding: Finding) -> None:
    document = json.dumps(finding_document(finding), allow_nan=False)
    assert TypeAdapter(Finding).validate_json(document) == finding


def test_a_finding_has_a_topic_and_its_sentence() -> None:
    noise = Finding("noisy speeds", ("left",), source="run", text="noise", advice="move", shown_as="position noise")
    assert (noise.topic, noise.joint, noise.severity) == ("position noise", "left", Grade.WARNING)
    assert str(noise) == "run: noise; move"
    assert replace(noise, grade=Grade.CONTRADICTORY).severity == Grade.WARNING
    assert (GOOD.finding, GOOD.why, GOOD.sentence) == (None, "", "good")


def test_numbers_are_written_as_people_write_them() -> None:
    assert percents([65.142, 65.141]) == "65.14 %"
    assert percents([1.2, 65.14]) == "1.20 to 65.14 %"
    assert percents([3923.72, 12.0]) == "12.00 to more than 1000 %"
    assert [percent(share) for share in (0.123, 37.0, -0.0)] == ["12 %", "more than 1000 %", "0 %"]
    assert listed(["a", "b"]) == "'a' and 'b'"
