"""Columns whose names are nearly those of joints: matched and asked about; what moves and is not used is said first."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gtau.errors import GtauError
from gtau.robots.robot import Joint, Mdh, Robot
from gtau.signals.reading.column_names import parse_column_name, resembling
from gtau.signals.reading.discovery import discover
from gtau.signals.reading.drafting import draft_text, guesses

TIME = np.arange(500) / 250
JOINTS = ("base_yaw", "shoulder", "elbow")
ARM = Robot(
    "arm",
    tuple(
        Joint(joint, antecedent, "revolute", Mdh(d=0.3, alpha=1.5))
        for joint, antecedent in zip(JOINTS, ("ground", *JOINTS), strict=False)
    ),
)


def save(path: Path, header: str, still: str = "") -> Path:
    names = header.split(",")
    columns = [np.sin((k + 1) * TIME) * (name != still) for k, name in enumerate(names)]
    np.savetxt(path, np.column_stack([TIME, *columns]), delimiter=",", header=f"t,{header}", comments="")
    return path


@pytest.mark.parametrize(
    ("name", "label", "stem"),
    [
        ("elbow_pos", "elbow", "#_pos"),
        ("posElbow", "Elbow", "pos#"),
        ("base_yaw.effort", "base_yaw", "#.effort"),
        ("joint_position", "", "joint_position"),
        ("goal_position", "", "goal_position"),
        ("torque_enable", "", "torque_enable"),
        ("controller_time", "", "controller_time"),
        ("comment", "", "comment"),
    ],
)
def test_what_is_no_word_of_signals_is_a_joint(name: str, label: str, stem: str) -> None:
    column = parse_column_name(name)
    assert (column.label, column.stem) == (label, stem)


def test_resembling_names() -> None:
    robot = ["shoulder", "elbow", "wrist_1_joint", "wrist_2_joint", "fl_hip", "fr_hip", "knee_joint"]
    matched = {"elbo": "elbow", "kneee": "knee_joint", "shoulder_lift": "shoulder", "wrist1": "wrist_1_joint"}
    assert resembling([*matched, "rail", "rr_hip"], robot) == matched
    assert resembling(["wrist", "hip"], robot) == {}  # of two, neither


@pytest.mark.parametrize(
    "header",
    [
        "base_yaw_pos,shoulder_pos,elbo_pos,base_yaw_torque,shoulder_torque,elbo_torque",
        "base_yaw_pos,shoulder_pos,elbo_pos,base_yaw_torque,shoulder_torque,elbow_torque",
        "base_yaw_pos,shoulder_lift_pos,elbow_pos,base_yaw_torque,shoulder_lift_torque,elbow_torque",
        "base_pos,shoulder_pan_pos,elbow_flex_pos,base_tau,shoulder_pan_tau,elbow_flex_tau",
        "yaw_pos,shoulder_pan_pos,elbow_joint_pos,yaw_tau,shoulder_pan_tau,elbow_joint_tau",
        "pos.base_yaw,pos.shoulder,pos.elbow2,tau.base_yaw,tau.shoulder,tau.elbow2",
    ],
)
def test_misspelt_joints_are_matched_and_asked_about(header: str, tmp_path: Path) -> None:
    draft = discover([save(tmp_path / "a.csv", header)], ARM, "arm.urdf")
    names = header.split(",")
    assert draft.signals.position == dict(zip(JOINTS, names[:3], strict=True))
    assert draft.signals.command == dict(zip(JOINTS, names[3:], strict=True))
    assert tuple(draft.open) == ("joints",)
    assert " taken for " in str(guesses(draft, tmp_path)[0])


def test_names_that_differ_in_their_case(tmp_path: Path) -> None:
    header = "base_yaw_pos,Shoulder_Pos,ELBOW_POS,base_yaw_torque,Shoulder_Torque,ELBOW_TORQUE"
    draft = discover([save(tmp_path / "a.csv", header)], ARM, "arm.urdf")
    assert (tuple(draft.signals.position), tuple(draft.open)) == (JOINTS, ())


@pytest.mark.parametrize(
    ("header", "unused"),
    [
        ("base_yaw_pos,shoulder_pos,rail_pos,base_yaw_tau,shoulder_tau,rail_tau", "rail_pos, rail_tau"),
        ("base_yaw_pos,shoulder_pos,base_yaw_tau,shoulder_tau,elbow_tau", "elbow_tau"),
    ],
)
def test_columns_that_move_unused_beside_held_joints_are_asked_about_first(
    header: str, unused: str, tmp_path: Path
) -> None:
    draft = discover([save(tmp_path / "a.csv", header)], ARM, "arm.urdf")
    assert ", ".join(draft.unused.moving) == unused
    assert tuple(draft.open) == ("unmatched",)
    assert f"columns {unused} move, too, and are not used" in str(guesses(draft, tmp_path)[0])
    assert "CHECK: joints that the log lacks are held at home" in draft_text(draft, tmp_path).split("signals:")[0]


def test_a_joint_that_moves_without_a_command_is_not_held_at_home(tmp_path: Path) -> None:
    header = "base_yaw_pos,shoulder_pos,elbow_pos,base_yaw_tau,shoulder_tau"
    with pytest.raises(GtauError, match="'elbow_pos' moves, but no torque column is of 'elbow'; log it as well"):
        discover([save(tmp_path / "a.csv", header)], ARM, "arm.urdf")
    resting = discover([save(tmp_path / "b.csv", header, "elbow_pos")], ARM, "arm.urdf")
    assert resting.robot["joints"] == ["base_yaw", "shoulder"]


def test_a_further_axis_is_named_and_one_that_never_moves_is_not(tmp_path: Path) -> None:
    header = "base_yaw_pos,shoulder_pos,elbow_pos,rail_pos,base_yaw_tau,shoulder_tau,elbow_tau"
    moving, resting = (discover([save(tmp_path / "a.csv", header, still)], ARM, "a") for still in ("", "rail_pos"))
    assert (tuple(moving.open), moving.unused.moving) == ((), ("rail_pos",))
    assert "rail_pos move, too" in str(guesses(moving, tmp_path)[0])
    assert not resting.unused.moving


def test_without_a_robot_joints_have_the_names_of_the_columns(tmp_path: Path) -> None:
    draft = discover([save(tmp_path / "a.csv", "j1_base_pos,j2_arm_pos,j1_base_tau,j2_arm_tau")])
    assert draft.signals.position == {"j1_base": "j1_base_pos", "j2_arm": "j2_arm_pos"}
    single = discover([save(tmp_path / "b.csv", "position,speed,load,torque_enable", still="torque_enable")])
    assert (single.signals.position, single.signals.command) == ({"j1": "position"}, {"j1": "load"})


@pytest.mark.parametrize("names", [("con", "meas"), ("meas", "con"), ("des", "act"), ("cmd", "meas"), ("", "measured")])
def test_measured_torques_come_before_commanded_ones(names: tuple[str, str], tmp_path: Path) -> None:
    header = "pos1,pos2," + ",".join(f"tau_{name}{k}" for name in (*names, "fric") for k in (1, 2))
    draft = discover([save(tmp_path / "a.csv", header)])
    measured = next(name for name in names if name in ("meas", "act", "measured"))
    assert list(draft.signals.command.values()) == [f"tau_{measured}1", f"tau_{measured}2"]
    assert tuple(draft.open) == ("robot",)


@pytest.mark.parametrize("still", ["motor_torque1", "torque1"])
def test_constant_and_boolean_columns_are_no_commands(still: str, tmp_path: Path) -> None:
    """Whatever their names; where nothing else is logged, that is said."""
    header = f"q1,{still},i1"
    draft = discover([save(tmp_path / "a.csv", header, still)])
    assert draft.signals.command == {"j1": "i1"}
    table = np.column_stack([TIME, np.sin(TIME), np.sin(TIME) > 0, np.cos(TIME)])
    log = tmp_path / "b.csv"
    np.savetxt(log, table, delimiter=",", header=f"t,{header}", comments="")
    assert discover([log]).signals.command == {"j1": "i1"}
    with pytest.raises(
        GtauError,
        match=rf"no columns of currents or torques are .*\({still} never change, are boolean or hold no numbers\)",
    ):
        discover([save(tmp_path / "c.csv", f"q1,{still}", still)])
