"""Currents of a size that no drive has are asked about, by ``check`` and ``identify``; so are payloads."""

from __future__ import annotations

from dataclasses import replace

import pytest
from five_bar_logs import STEEL, Plant

from gtau.estimation.diagnostics.units import doubtful_currents, doubtful_gravity, doubtful_payloads
from gtau.findings import Grade
from gtau.model.home import load_robot
from gtau.result import check, identify
from gtau.robots.geometry import float_base
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run


@pytest.fixture(scope="module")
def run() -> Run:
    return Plant(noise=0.01).run("free", 10.0, seed=1)


def test_currents_of_drives_are_not_doubted(run: Run) -> None:
    assert list(doubtful_currents([run, run])) == []


@pytest.mark.parametrize(
    ("factors", "kind", "joints", "subject"),
    [
        ([1e3, 1e3], "current too large", {"left", "right"}, "right"),
        ([1e-3, 1e-3], "current too small", {"left", "right"}, "right"),
        ([100.0, 1.0], "currents far apart", {"left"}, "right"),
        ([1.0, 60.0], "currents far apart", {"right"}, "left"),
    ],
)
def test_doubtful_sizes_are_worth_mending(
    run: Run, factors: list[float], kind: str, joints: set[str], subject: str
) -> None:
    (note,) = doubtful_currents([replace(run, command=run.command * factors)])
    assert (note.kind, set(note.joints), note.topic, note.severity) == (kind, joints, "unit", Grade.WARNING)
    assert note.subject == subject or kind in ("current too large", "current too small")


def test_milliamperes_are_stated_of_the_joints_that_have_them(run: Run) -> None:
    advice = [next(doubtful_currents([replace(run, command=run.command * x)])).advice for x in ([1e3, 1e3], [1e3, 1])]
    assert [text.partition(";")[0] for text in advice] == [
        "if it is in mA, write units: {current: mA}",
        "if it is in mA, write units: {current: {left: mA}}",
    ]


@pytest.mark.parametrize(
    ("mass", "kinds"), [(STEEL["m"], []), (1e3 * STEEL["m"], ["effort limit", "current too small"])]
)
def test_check_doubts_the_units_that_identify_doubts(run: Run, mass: float, kinds: list[str]) -> None:
    loaded = replace(Plant(noise=0.01).run("loaded", 10.0, STEEL, seed=2), payload=Payload(name="steel", mass=mass))
    robot = load_robot("five-bar")
    of_check = [note.kind for note in check(robot, [run, loaded]).notes if note.decisive]
    verdicts = [gain.verdict for gain in identify(robot, [run, loaded]).drive_gains.values()]
    assert sorted(of_check) == sorted(kinds)
    assert {verdict.finding.kind for verdict in verdicts if verdict.finding} == set(kinds[:1])


def test_a_payload_in_grams_is_asked_about() -> None:
    arm = load_robot("ur10e")
    disc = Payload(name="disc", mass=2800.0)
    (note,) = doubtful_payloads(arm, [None, disc, disc])
    assert (note.kind, note.subject, note.severity) == ("payload too heavy", "disc", Grade.WARNING)
    assert "weighs 2800 kg" in note.what
    assert "'mass: 2.8' (kg)" in note.advice
    assert list(doubtful_payloads(arm, [Payload(name="rated", mass=12.5), Payload(name="weighed")])) == []
    # a closed loop bears what no arm does, and a trunk has no reach
    assert list(doubtful_payloads(load_robot("five-bar"), [Payload(name="slab", mass=500.0)])) == []
    assert list(doubtful_payloads(float_base(arm), [Payload(name="slab", mass=500.0)])) == []


@pytest.mark.parametrize(
    ("gravity", "kinds"),
    [
        ((0.0, 0.0, -9.0), ["strength of gravity"]),
        ((7.0, 0.0, -7.0), ["strength of gravity"]),
        ((0.0, 6.93, -6.93), []),
        ((0, 0, 0), []),
    ],
)
def test_gravity_of_no_place_is_asked_about(gravity: tuple[float, float, float], kinds: list[str]) -> None:
    robot = replace(load_robot("ur10e"), gravity=gravity)
    assert [note.kind for note in doubtful_gravity(robot)] == kinds


def test_gains_are_not_good_under_a_doubtful_gravity(run: Run) -> None:
    robot = load_robot("five-bar")
    robot = replace(robot, gravity=tuple(0.9 * component for component in robot.gravity))
    loaded = replace(
        Plant(noise=0.01).run("loaded", 10.0, STEEL, seed=2), payload=Payload(name="steel", mass=STEEL["m"])
    )
    verdicts = [gain.verdict for gain in identify(robot, [run, loaded]).drive_gains.values()]
    assert {verdict.outcome for verdict in verdicts} == {Grade.CONTRADICTORY}
    assert "strength of gravity" in {note.kind for note in check(robot, [run, loaded]).notes}
