"""What 'effort' holds instead of torques is named from the data; benchmarks/effort.py counts it on five robots."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from five_bar_logs import CHI, JOINTS, STEEL, Plant, five_bar
from gravity_logs import logged, scara

from gtau.errors import GtauError
from gtau.estimation.diagnostics.gravity import WITHOUT_GRAVITY
from gtau.findings import Grade
from gtau.model.home import load_robot
from gtau.result import Result, check, identify, load
from gtau.robots.robot import Robot
from gtau.signals.reading.drafting import Stated, draft_logs, write_draft
from gtau.signals.reading.experiment import read_experiment
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run, read_run

FREE = (0.0, 0.0, 0.0)
FRICTION = ("fv_", "fs_", "off_")
NAMES = {
    WITHOUT_GRAVITY,
    "torques without gravity, or a balanced robot",
    "whole numbers",
    "torques of the motors",
    "torques of a model",
}


def named(result: Result) -> set[str]:
    """Kinds of this module among the findings and the causes of verdicts."""
    found = [each.verdict.finding for each in result.drive_gains.values() if each.verdict.finding]
    kinds = {kind for of in found for kind in (of.kind, *of.causes)} | {each.kind for each in result.notes}
    return kinds & NAMES


def torques(scale: float = 1.0, loaded: bool = False, **plant: object) -> list[Run]:
    """Torques of the five-bar over ``scale``."""
    made = Plant(gains=(scale, scale), noise=0.02 / scale, **plant)  # type: ignore[arg-type]
    free = made.run("free", seed=1, kind="torque")
    steel = replace(made.run("steel", payload=STEEL, seed=2, kind="torque"), payload=Payload(name="steel", mass=1.2))
    return [free, steel] if loaded else [free]


def limited(robot: Robot, efforts: tuple[float, float]) -> Robot:
    limits = dict(zip(robot.actuated, efforts, strict=True))
    joints = (
        replace(each, limits=replace(each.limits, effort=limits.get(each.name, each.limits.effort)))
        for each in robot.joints
    )
    return replace(robot, joints=tuple(joints))


@pytest.fixture(scope="module")
def compensated() -> Result:
    """A UR10e whose driver takes gravity out."""
    robot = load_robot("ur10e")
    return identify(robot, logged(robot, FREE, currents=False))


def test_torques_without_gravity_are_named_and_contradict_the_description(compensated: Result) -> None:
    assert named(compensated) == {WITHOUT_GRAVITY}
    assert {each.verdict.outcome for each in compensated.drive_gains.values()} > {Grade.CONTRADICTORY}
    said = next(each.verdict for each in compensated.drive_gains.values() if each.verdict.finding)
    assert "gravity: [0, 0, 0]" in said.advice


def test_what_to_write_for_torques_without_gravity_helps(tmp_path: Path, compensated: Result) -> None:
    """The key of the experiment file takes gravity out of the model, which then explains the logs."""
    robot = load_robot("ur10e")
    (run,) = logged(robot, FREE, currents=False)
    joints = range(len(run.joints))
    table = (
        {"t": run.time} | {f"q{j}": run.position[:, j] for j in joints} | {f"u{j}": run.command[:, j] for j in joints}
    )
    pl.DataFrame(table).write_csv(tmp_path / "log.csv")
    columns = [", ".join(f"{joint}: {letter}{j}" for j, joint in enumerate(run.joints)) for letter in "qu"]
    (tmp_path / "experiment.yaml").write_text(
        "robot: {file: ur10e, gravity: [0, 0, 0]}\n"
        f"signals: {{time: t, position: {{{columns[0]}}}, torque: {{{columns[1]}}}}}\nruns: [{{log: log.csv}}]\n"
    )
    found = identify(tmp_path / "experiment.yaml")
    assert found.robot.gravity == FREE
    assert not named(found)
    pairs = zip(found.residuals, compensated.residuals, strict=True)
    assert all(mine.rms < 0.7 * theirs.rms for mine, theirs in list(pairs)[1:4])
    found.save(tmp_path / "model.json")
    assert load(tmp_path / "model.json").robot.gravity == FREE


def test_robots_that_gravity_does_not_move_are_not_asked_about_it() -> None:
    assert not named(identify(scara(), logged(scara(), scara().gravity, currents=False)))


def test_a_five_bar_without_gravity_is_asked_whether_it_is_balanced() -> None:
    free = replace(five_bar().robot, gravity=FREE)
    runs = logged(free, FREE, currents=False)
    assert named(identify(five_bar().robot, runs)) == {"torques without gravity, or a balanced robot"}


def test_torques_of_motors_are_named_by_their_scale_and_by_limits_of_effort() -> None:
    robot = five_bar().robot
    result = identify(robot, torques(60.0, loaded=True))
    assert named(result) == {"torques of the motors"}
    assert "by their size they are motor-side" in " ".join(result.summary().split()).partition("The arm reports")[0]
    peaks = np.abs(torques()[0].command).max(axis=0)
    arm = limited(robot, (float(100 * peaks[0]), float(120 * peaks[1])))
    assert named(identify(arm, torques())) == {"torques of the motors"}
    assert not named(identify(limited(robot, (1e4, 1e4)), torques()))  # the same for all: a placeholder


@pytest.mark.parametrize("full", [100.0, 1000.0])
def test_shares_of_the_rated_torque_are_named_by_their_steps(full: float) -> None:
    (run,) = torques()
    run = replace(run, command=np.round(full * run.command / (0.7 * np.abs(run.command).max(axis=0))))
    assert named(identify(five_bar().robot, [run])) == {"whole numbers"}
    assert "whole numbers" in {each.kind for each in check(five_bar().robot, [run]).notes}


def test_torques_that_a_model_computed_are_named() -> None:
    chi = {name: 0.0 if name.startswith(FRICTION) else value for name, value in CHI.items()}
    runs = [replace(run, command=np.round(run.command, 4)) for run in torques(chi=chi)]
    assert named(identify(five_bar().robot, runs)) == {"torques of a model"}


def test_magnitudes_are_refused_where_some_joints_hold_against_gravity() -> None:
    time = np.arange(0.0, 8.0, 0.01)
    q = np.column_stack([np.sin(time), np.cos(1.3 * time)])
    table = pl.DataFrame({"t": time, "q0": q[:, 0], "q1": q[:, 1], "u0": np.abs(q[:, 1]), "u1": 5.0 + q[:, 0]})
    columns = {
        kind: {"a": f"{letter}0", "b": f"{letter}1"} for kind, letter in {"position": "q", "torque": "u"}.items()
    }
    with pytest.raises(GtauError, match="the columns hold magnitudes"):
        read_run(table, {"time": "t", **columns})


# Presets


def recorded(folder: Path, pattern: str) -> Path:
    run = torques()[0]
    names = {joint: pattern.format(joint=joint, k=k) for k, joint in enumerate(JOINTS)}
    table = {"timestamp": run.time} | {f"actual_q_{k}": run.position[:, k] for k in range(2)}
    table |= {names[joint]: run.command[:, k] for k, joint in enumerate(JOINTS)}
    pl.DataFrame(table).write_csv(folder / "log.csv")
    return folder / "log.csv"


def test_ur_torques_computed_from_currents_are_drafted_without_gravity(tmp_path: Path) -> None:
    log = recorded(tmp_path, "actual_current_as_torque_{k}")
    for preset in (None, "ur_rtde_torque"):
        draft = draft_logs([log], "five-bar", stated=Stated(preset=preset))
        assert (draft.signals.kind, "gravity" not in draft.robot, "gravity" in draft.open) == (
            "torque",
            False,
            preset is None,
        )
        write_draft(draft, tmp_path / f"{preset}.yaml")
        source = read_experiment(tmp_path / f"{preset}.yaml").robot
        assert (source.file, source.gravity) == ("five-bar", FREE)


def test_a_preset_says_what_effort_is(tmp_path: Path) -> None:
    run = torques()[0]
    table = {"__time": run.time}
    for k, joint in enumerate(JOINTS):
        table |= {f"/joint_states/{joint}/position": run.position[:, k]}
        table |= {f"/joint_states/{joint}/effort": run.command[:, k]}
    pl.DataFrame(table).write_csv(tmp_path / "log.csv")
    for preset, expected in {
        "ur-current": ("current", True),
        "ur-torque": ("torque", False),
        "franka-ros": ("torque", True),
        "kinova": ("torque", True),
    }.items():
        draft = draft_logs([tmp_path / "log.csv"], "five-bar", stated=Stated(preset=preset))
        assert (draft.signals.kind, "gravity" not in draft.robot, "kind" in draft.open) == (*expected, False)
    with pytest.raises(GtauError, match=r"no columns of the preset 'ur_rtde'.*state in the draft"):
        draft_logs([tmp_path / "log.csv"], "five-bar", stated=Stated(preset="ur_rtde"))
    with pytest.raises(GtauError, match="there is no preset 'ur'; choose from"):
        draft_logs([tmp_path / "log.csv"], "five-bar", stated=Stated(preset="ur"))
