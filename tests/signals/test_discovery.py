"""``gtau init``: what columns hold, found from their names, ranges and derivatives, and a file that runs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import GAINS, STEEL, Plant, write_log
from scipy.io import savemat
from typer.testing import CliRunner

from gtau.cli.commands import app
from gtau.errors import GtauError
from gtau.model.home import load_robot
from gtau.result import identify
from gtau.robots.robot import Joint, Limits, Mdh, Robot
from gtau.signals.channel import SENSOR, SIDE_SIGNALS
from gtau.signals.reading import logs
from gtau.signals.reading.column_names import parse_column_name
from gtau.signals.reading.discovery import Draft, discover
from gtau.signals.reading.drafting import draft_text, guesses
from gtau.signals.reading.experiment import read_experiment
from gtau.signals.reading.log_contents import LogContents
from gtau.signals.reading.logs import find_columns
from gtau.signals.reading.samples import WHOLE
from gtau.signals.reading.statements import CHOSEN
from gtau.signals.reading.units import Units
from gtau.signals.run import read_parts, read_run

TIME = np.arange(3000) / 250
Q = np.column_stack([np.sin(2 * TIME), 0.4 * np.cos(3 * TIME)])
QD = np.column_stack([2 * np.cos(2 * TIME), -1.2 * np.sin(3 * TIME)])
V = np.column_stack([np.sign(QD[:, 0]) + Q[:, 0], np.sign(QD[:, 1]) + Q[:, 1]])


def save(path: Path, header: str, *columns: np.ndarray) -> Path:
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="")
    return path


@pytest.mark.parametrize(
    ("name", "kind", "label", "unit"),
    [
        ("q1", "position", "1", None),
        ("q_ref3", "position", "3", None),
        ("actual_q_0", "position", "0", None),
        ("state.tau_J[6]", "torque", "6", None),
        ("/joint_states/panda_joint1/position", "position", "panda_joint1", None),
        ("/joint_states/header/stamp", "time", "", None),
        ("Axis1.ActPos [deg]", "position", "1", "deg"),
        ("qm3", "position", "3", None),
        ("qdm3", "velocity", "3", None),
        ("joint_velocity_2", "velocity", "2", None),
        ("dq4", "velocity", "4", None),
        ("tau_ext_3", "other", "3", None),
        ("torque_sensor_3", "sensor", "3", None),
        ("position_sensor_3", "position", "3", None),
        ("actual_current_5", "current", "5", None),
        ("motor2 (mA)", "motor", "2", "mA"),
        ("motor_torque_2", "motor", "2", None),
        ("motor_position_2", "position", "2", None),
        ("posición_2", "position", "2", None),
        ("Gelenkwinkel2 [°]", "position", "2", "deg"),
        ("Motorstrom A2 [mA]", "current", "2", "mA"),
        ("Drehmoment_2 [Nm]", "torque", "2", "N m"),
        ("corriente_2", "current", "2", None),
        ("vitesse2", "velocity", "2", None),
        ("Zeit [ms]", "time", "", "ms"),
        ("v7", "command", "7", None),
        ("timestamp", "time", "", None),
        ("time_nanosec", "time", "", None),
        ("comment", None, "", None),
    ],
)
def test_kinds_by_name(name: str, kind: str | None, label: str, unit: str | None) -> None:
    column = parse_column_name(name)
    assert (column.kind, column.label, column.unit) == (kind, label, unit)
    assert column.reference == (name == "q_ref3")
    assert parse_column_name("Sollstrom3").reference


def test_joints_by_name() -> None:
    column = parse_column_name("elbow_joint.effort", ["joint", "elbow_joint"])
    assert (column.label, column.kind) == ("elbow_joint", "torque")
    assert parse_column_name("qleft", ["left"]).kind == "position"
    assert parse_column_name("vleft", ["left"]).label == "left"
    assert parse_column_name("outleft", ["left"]).label == "left"
    assert parse_column_name("unleftly", ["left"]).label == ""
    assert parse_column_name("q11", ["11", "12"]).label == "11"
    assert parse_column_name("q111", ["11", "12"]).label == "111"


def test_an_ambiguous_name_is_settled_by_the_derivative(tmp_path: Path) -> None:
    """``v`` is a velocity where it is the derivative of the position, and otherwise the command."""
    fast = discover([save(tmp_path / "a.csv", "t,q1,q2,v1,v2,u1,u2", TIME, Q, QD, V)])
    assert fast.signals.command == {"j1": "u1", "j2": "u2"}
    assert fast.unused.others == ("v1 ... v2",)
    slow = discover([save(tmp_path / "b.csv", "t,q1,q2,v1,v2", TIME, Q, V)])
    assert slow.signals.command == {"j1": "v1", "j2": "v2"}
    assert set(slow.open) == {"robot", "kind"}


def test_a_log_without_header(tmp_path: Path) -> None:
    (draft,) = [discover([_bare(tmp_path / "a.csv", TIME, Q, QD, V)])]
    assert draft.signals.time_columns == ("1",)
    assert draft.signals.position == {"j1": "2", "j2": "3"}
    assert draft.signals.command == {"j1": "6", "j2": "7"}
    with pytest.raises(GtauError, match=r"no columns of positions are recognised among 1, 2, 3 \(without names"):
        discover([_bare(tmp_path / "b.csv", TIME, V)])
    stated = discover(
        [_bare(tmp_path / "b.csv", TIME, Q, V)], columns={"time": "1", "position": "2,3", "current": "4,5"}
    )
    assert list(stated.signals.position.values()) == ["2", "3"]


def _bare(path: Path, *columns: np.ndarray) -> Path:
    np.savetxt(path, np.column_stack(columns), delimiter=",")
    return path


@pytest.mark.parametrize(("scale", "unit"), [(1, None), (1e3, "ms"), (1e6, "us"), (1e9, "ns")])
def test_unit_of_time(tmp_path: Path, scale: float, unit: str | None) -> None:
    draft = discover([save(tmp_path / "a.csv", "time,q1,q2,tau1,tau2", scale * TIME, Q, V)])
    assert draft.units.get("time") == unit
    assert "250 Hz" in draft.reasons.time
    assert draft.signals.kind == "torque"


def test_a_row_back_in_time_leaves_the_time_column(tmp_path: Path) -> None:
    order = np.arange(len(TIME))
    order[[900, 901]] = 901, 900
    draft = discover(
        [save(tmp_path / "a.csv", "t,q1,q2,dq1,dq2,tau1,tau2", TIME[order], Q[order], QD[order], V[order])]
    )
    assert draft.signals.time_columns == ("t",)
    assert "velocities" not in draft.open


def test_the_rate_of_a_log_without_time_is_that_of_its_velocities(tmp_path: Path) -> None:
    with_velocity = discover([save(tmp_path / "a.csv", "q1,q2,dq1,dq2,tau1,tau2", Q, QD, V)])
    assert (with_velocity.signals.time_columns, with_velocity.signals.rate) == ((), 250.0)
    assert tuple(with_velocity.open) == ("robot", "velocities")
    assert "time: {rate: 250}  # CHECK: no time column; dq1" in draft_text(with_velocity, tmp_path)
    without = discover([save(tmp_path / "b.csv", "q1,q2,tau1,tau2", Q, V)])
    assert "rate" in without.open


def test_noise_of_positions_does_not_slow_the_rate(tmp_path: Path, rng: np.random.Generator) -> None:
    noisy = Q + 3e-3 * rng.standard_normal(Q.shape)  # a fast joint moves 8e-3 from sample to sample
    assert discover([save(tmp_path / "a.csv", "q1,q2,dq1,dq2,tau1,tau2", noisy, QD, V)]).signals.rate == 250.0
    apart = discover([save(tmp_path / "b.csv", "q1,q2,dq1,dq2,tau1,tau2", Q, QD * [1.0, 1.1], V)])
    assert apart.reasons.time.endswith("by joint 250 to 275 Hz")


def test_masses_in_names_of_files_are_confirmed_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    save(tmp_path / "loaded_1200g.csv", "t,q1,q2,torque1,torque2", TIME, Q, V)
    shown = CliRunner().invoke(app, ["init", "loaded_1200g.csv"]).output
    points = shown.split("edit its lines marked CHECK:")[1]
    assert points.strip().startswith("- confirm the payload masses")


def test_joints_are_sorted_by_number_only_where_all_have_one(tmp_path: Path) -> None:
    log = save(tmp_path / "a.csv", "t,q1,q2,tau1,tau2", TIME, Q, V)

    def drafted(first: str, second: str) -> Draft:
        joints = (Joint(first, "ground", "revolute", Mdh(alpha=1.5)), Joint(second, first, "revolute", Mdh(d=0.5)))
        return discover([log], Robot("arm", joints), "arm")

    chain, sorted_ = drafted("A1", "LJFT"), drafted("p2", "p1")
    assert (chain.signals.position, chain.reasons.position) == (
        {"A1": "q1", "LJFT": "q2"},
        "matched by column order",
    )
    assert sorted_.signals.position == {"p1": "q1", "p2": "q2"}
    assert sorted_.reasons.position == "matched by the numbers in the joints' names"


def test_degrees_by_reach(tmp_path: Path) -> None:
    draft = discover([save(tmp_path / "a.csv", "t,q1,q2,current1,current2", TIME, np.rad2deg(Q), V)])
    assert draft.units == {"position": "deg"}
    assert "unit" in draft.open
    named = discover([save(tmp_path / "b.csv", "t,q1 [deg],q2 [deg],current1 [mA],current2 [mA]", TIME, Q, V)])
    assert named.units == {"position": "deg", "current": "mA"}
    assert "unit" not in named.open


def test_positions_and_commands_in_two_files_by_the_files_names(tmp_path: Path) -> None:
    logs = [
        save(tmp_path / "motor_current_1.csv", "Joint_1,Joint_2", V),
        save(tmp_path / "position_1.csv", "Joint_1,Joint_2", Q),
    ]
    draft = discover(logs)
    assert draft.logs == ((logs[1], logs[0]),)
    assert draft.signals.kind == "current"
    more = [
        save(tmp_path / "motor_current_2.csv", "Joint_1,Joint_2", V),
        save(tmp_path / "position_2.csv", "Joint_1,Joint_2", Q),
    ]
    for given in ([*logs, *more], [logs[0], more[0], logs[1], more[1]]):
        assert discover(given).logs == ((logs[1], logs[0]), (more[1], more[0]))


def test_joints_of_the_robot(tmp_path: Path) -> None:
    robot = load_robot("five-bar")
    by_name = discover([save(tmp_path / "a.csv", "t,q_right,q_left,i_right,i_left", TIME, Q, V)], robot, "five-bar")
    assert by_name.signals.position == {"left": "q_left", "right": "q_right"}
    assert tuple(by_name.open) == ()
    by_order = discover([save(tmp_path / "b.csv", "t,q1,q2,i1,i2", TIME, Q, V)], robot, "five-bar")
    assert by_order.signals.position == {"left": "q1", "right": "q2"}
    assert tuple(by_order.open) == ("joints",)
    with pytest.raises(GtauError, match=r"has positions and commands of 2 joints \(1, 2\), but robot 'ur10e' has 6"):
        discover([tmp_path / "b.csv"], load_robot("ur10e"), "ur10e")


def handed(fingers: int = 2) -> Robot:
    """An arm of two joints, with two fingers and a head."""
    joints = [Joint("j1", "ground", "revolute", Mdh(alpha=1.5)), Joint("j2", "j1", "revolute", Mdh(d=0.5))]
    joints += [Joint(f"f{k}", "j2", "prismatic", Mdh(d=0.1)) for k in range(fingers)]
    return Robot("handed", (Joint("head", "ground", "revolute"), *joints))


@pytest.mark.parametrize(
    ("header", "columns", "unmatched", "open_"),
    [
        ("q_j1,q_j2,i_j1,i_j2", {"j1": "q_j1", "j2": "q_j2"}, None, ()),
        (
            "/s/j1/position,/s/wheel/position,/s/j1/current,/s/wheel/current",
            {"j1": "/s/j1/position"},
            "/s/wheel/position, /s/wheel/current",
            ("unmatched",),
        ),
        ("q1,q2,i1,i2", {"j1": "q1", "j2": "q2"}, None, ("joints",)),
    ],
)
def test_joints_that_the_log_lacks_are_held(
    header: str, columns: dict[str, str], unmatched: str | None, open_: tuple[str, ...], tmp_path: Path
) -> None:
    """By name those that both have; by number the chain to the palm, where no other is as long."""
    log = save(tmp_path / "a.csv", f"t,{header}", TIME, Q, V)
    draft = discover([log], handed(), "handed.urdf")
    assert (draft.signals.position, tuple(draft.open)) == (columns, open_)
    assert draft.robot == {"file": "handed.urdf", "joints": list(columns)}
    assert ", ".join(draft.unused.moving) == (unmatched or "")


def test_two_arms_are_not_told_apart_by_number(tmp_path: Path) -> None:
    log = save(tmp_path / "a.csv", "t,q1,q2,i1,i2", TIME, Q, V)
    arm = handed(0).joints[1:]
    other = (Joint("k1", "ground", "revolute", Mdh(alpha=1.5)), Joint("k2", "k1", "revolute", Mdh(d=0.5)))
    with pytest.raises(GtauError, match=r"\.csv: the log has .* of 2 joints .* has 4 actuated ones; name the columns"):
        discover([log], Robot("twin", (*arm, *other)), "twin.urdf")


def test_what_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(GtauError, match="of 0 joints, but robot 'five-bar' has 2"):
        discover([save(tmp_path / "c.csv", "t,q1,q2,current_a", TIME, Q, V[:, 0])], load_robot("five-bar"), "five-bar")
    with pytest.raises(GtauError, match="no columns of currents or torques are recognised among t, q1, dq1"):
        discover([save(tmp_path / "a.csv", "t,q1,dq1", TIME, Q[:, 0], QD[:, 0])])


def test_the_drafted_file_identifies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Drafted without a question, with masses from the names of the files: the gains come out."""
    monkeypatch.chdir(tmp_path)
    write_log(tmp_path / "free.csv", Plant(noise=0.003).run("free"))
    write_log(tmp_path / "loaded_1200g.csv", Plant(noise=0.003).run("loaded", payload=STEEL))
    command = ["init", "free.csv", "loaded_1200g.csv", "--robot", "five-bar", "--out", "e.yaml"]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    assert "Then: gtau check e.yaml" in done.output
    assert "CHECK: kg, from the name " in (tmp_path / "e.yaml").read_text()
    gains = {joint: gain.value for joint, gain in identify("e.yaml").drive_gains.items()}
    assert gains == pytest.approx(dict(zip(("left", "right"), GAINS, strict=True)), rel=0.01)
    again = CliRunner().invoke(app, command)
    assert again.exit_code == 2


def test_what_an_option_states_is_not_marked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    save(tmp_path / "a.csv", "q_left,q_right,v_left,v_right", Q, V)
    done = CliRunner().invoke(app, ["init", "a.csv", "--robot", "five-bar", "--kind", "torque"])
    assert done.exit_code == 0, done.output
    assert (tmp_path / "experiment.yaml").read_text().count("CHECK:") == 1  # the sampling rate
    experiment = read_experiment(tmp_path / "experiment.yaml")
    assert experiment.signals.torque == {"left": "v_left", "right": "v_right"}
    save(tmp_path / "b.csv", "t,q_left,q_right,i_left,i_right", TIME, Q, V)
    command = ["init", "b.csv", "--robot", "five-bar", "--payload", "b.csv=1.5", "--out", "b.yaml"]
    assert CliRunner().invoke(app, command).exit_code == 0
    (run,) = read_experiment(tmp_path / "b.yaml").runs
    assert run.payload is not None
    assert run.payload.mass == 1.5


def test_columns_that_yaml_would_take_for_something_else(tmp_path: Path) -> None:
    log = save(tmp_path / "a.csv", "t,state.q[0],state.q[1],state.tau_J[0],state.tau_J[1]", TIME, Q, V)
    robot = load_robot("five-bar")
    (tmp_path / "e.yaml").write_text(draft_text(discover([log], robot, "five-bar"), tmp_path))
    experiment = read_experiment(tmp_path / "e.yaml")
    run = read_run(experiment.runs[0].log[0], experiment.signals)
    np.testing.assert_allclose(run.position, Q, atol=1e-9)


SHARED = {
    "orthoglide_sim/exciting_3_loaded_1983g.csv": ("t", ["q11", "q12", "q13"], "current", ["v1", "v2", "v3"]),
    "rokae_xmate3pro/excit.csv": ("t", ["q1", "q2"], "current", ["motor1", "motor2"]),
    "ur10e/ur-20_02_19_14harm50sec.csv": ("1", ["2", "3"], "current", ["14", "15"]),
    "panda_rosbag2/panda_exciting_trajectory.db3": (
        "/joint_states/header/stamp",
        ["/joint_states/fer_joint1/position", "/joint_states/fer_joint2/position"],
        "torque",
        ["/joint_states/fer_joint1/effort", "/joint_states/fer_joint2/effort"],
    ),
    "aliengo/aliengo.csv": ("t", ["q0", "q1"], "torque", ["tau_pd0", "tau_pd1"]),
    "xmate7p/xMate7p_traj1_results.csv": (50.0, ["1", "2"], "torque", ["22", "23"]),
    "dvrk_psm/two_results.csv": (200.0, ["q1", "q2"], "torque", ["tau1", "tau2"]),
    "upv_parallel/4dof_N_a.csv": ("t", ["q0", "q1"], "torque", ["u0", "u1"]),
}


@pytest.mark.parametrize("name", SHARED)
def test_logs_of_several_makers(shared: Path, name: str) -> None:
    time, positions, kind, commands = SHARED[name]
    draft = discover([shared / name])
    assert (draft.signals.time_columns[0] if draft.signals.time_columns else draft.signals.rate) == time
    assert list(draft.signals.position.values())[: len(positions)] == positions
    assert (draft.signals.kind, list(draft.signals.command.values())[: len(commands)]) == (kind, commands)


def test_a_bag_with_commands_in_another_topic(tmp_path: Path) -> None:
    """Joint states without efforts, and currents as an array with stamps of their own: drafted, then aligned."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    state, array = "sensor_msgs/msg/JointState", "std_msgs/msg/Float64MultiArray"
    layout = kinds["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        states = bag.add_connection("/arm/joint_states", state, typestore=store)
        currents = bag.add_connection("/arm/motor_currents", array, typestore=store)
        for time, q, v in zip(TIME, Q, V, strict=True):
            stamp = round((100 + time) * 1e9)
            header = kinds["std_msgs/msg/Header"](
                stamp=kinds["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9)), frame_id=""
            )
            none = np.empty(0)
            message = kinds[state](header, ["left", "right"], q.copy(), none, none)
            bag.write(states, stamp, store.serialize_cdr(message, state))
            bag.write(currents, stamp + 10**6, store.serialize_cdr(kinds[array](layout, v.copy()), array))
    robot = load_robot("five-bar")
    draft = discover([tmp_path / "bag"], robot, "five-bar")
    assert draft.signals.time_columns == ("/arm/joint_states/header/stamp",)
    assert draft.signals.command_time_columns == ("/arm/motor_currents/received",)
    assert draft.signals.kind == "current"
    (tmp_path / "e.yaml").write_text(draft_text(draft, tmp_path))
    experiment = read_experiment(tmp_path / "e.yaml")
    run = read_run(experiment.runs[0].log, experiment.signals, units=experiment.units)
    assert "aligned the currents with the positions" in str(run.notes[0])
    np.testing.assert_allclose(run.position, Q[1:], atol=1e-9)
    np.testing.assert_allclose(run.command[:, 1], 0.75 * V[1:, 1] + 0.25 * V[:-1, 1], atol=1e-6)


def test_what_feeds_a_drive_is_not_its_motor(tmp_path: Path) -> None:
    header = "t,q1,q2,i1,i2,duty1,duty2,supply_voltage1,supply_voltage2,bus_current1,bus_current2"
    log = save(tmp_path / "log.csv", header, TIME, Q, V, Q, 24 + 0 * Q, np.abs(V))
    draft = discover([log], load_robot("five-bar"), "five-bar")
    assert draft.signals.command == {"left": "i1", "right": "i2"}
    held = {"duty": "duty", "supply_voltage": "supply_voltage", "supply_current": "bus_current"}
    assert draft.unused.side == {key: {"left": f"{name}1", "right": f"{name}2"} for key, name in held.items()}


def test_temperatures_and_poses_are_offered_as_comments(tmp_path: Path) -> None:
    """Neither is used unasked; without the comment sign the line is one that a file may hold."""
    header = "t,q1,q2,i1,i2,motor_temp_1,motor_temp_2,tcp_x,tcp_y"
    log = save(tmp_path / "log.csv", header, TIME, Q, V, 30 + TIME, 31 + TIME, Q)
    text = draft_text(discover([log], load_robot("five-bar"), "five-bar"), tmp_path)
    offered = "# temperature: {left: motor_temp_1, right: motor_temp_2}"
    assert offered in text
    assert "if tcp_x, tcp_y hold one" in text
    (tmp_path / "experiment.yaml").write_text(text)
    assert read_experiment(tmp_path / "experiment.yaml").signals.temperature is None
    (tmp_path / "experiment.yaml").write_text(text.replace(offered, offered[2:]))
    columns_by_joint = read_experiment(tmp_path / "experiment.yaml").signals.side_columns(SIDE_SIGNALS[0])
    assert columns_by_joint == {"left": "motor_temp_1", "right": "motor_temp_2"}


@pytest.mark.parametrize("name", ["torque_sensor", "tau"])
def test_torque_sensors_beside_currents(name: str, tmp_path: Path) -> None:
    """By their names they are sensors; torques that may have been computed from currents are offered as a comment."""
    header = f"t,q1,q2,current1,current2,{name}1,{name}2"
    log = save(tmp_path / "log.csv", header, TIME, Q, V, 3 * V + 0.1)
    draft = discover([log])
    columns = {"j1": f"{name}1", "j2": f"{name}2"}
    torques = draft.signals.sensors(SENSOR), draft.unused.torques
    assert torques == ((columns, {}) if "sensor" in name else ({}, columns))
    text = draft_text(draft, tmp_path)
    (line,) = [each for each in text.splitlines() if "joint_torque:" in each]
    assert line.lstrip().startswith("#") == (name == "tau")
    assert ("remove the '#' of joint_torque" in text) == ("torques" in draft.open) == (name == "tau")
    assert "Not used" not in text
    (tmp_path / "experiment.yaml").write_text(text.replace("NAME-OR-FILE", "five-bar"), encoding="utf-8")
    if name == "torque_sensor":
        assert read_experiment(tmp_path / "experiment.yaml").signals.sensors(SENSOR).keys() == {"j1", "j2"}
        assert "Drive gains need the mass" not in text


@pytest.mark.parametrize(("count", "said"), [(1, "load is assumed to be"), (2, "load1 ... load2 are assumed to be")])
def test_commands_that_are_one_column_are_singular(count: int, said: str, tmp_path: Path) -> None:
    names = ["load"] if count == 1 else ["load1", "load2"]
    header = ",".join(["t", *(name.replace("load", "q") for name in names), *names])
    draft = discover([save(tmp_path / "a.csv", header, TIME, Q[:, :count], V[:, :count])])
    assert any(note.what.startswith(said) for note in guesses(draft, tmp_path))


def test_what_is_no_torque_sensor(tmp_path: Path) -> None:
    """Targets are the controller's model, and a column that never changes measures nothing."""
    header = "t,q1,q2,current1,current2,{0}1,{0}2"
    target = discover([save(tmp_path / "a.csv", header.format("target_moment_"), TIME, Q, V, 3 * V + 0.1)])
    assert (target.unused.torques, target.unused.others) == ({}, ("target_moment_1 ... target_moment_2",))
    stuck = np.column_stack([np.zeros(len(TIME)), 3 * V[:, 1]])
    draft = discover([save(tmp_path / "b.csv", header.format("torque_sensor_"), TIME, Q, V, stuck)])
    assert draft.signals.sensors(SENSOR) == {"j2": "torque_sensor_2"}
    assert "never change: columns torque_sensor_1." in draft_text(draft, tmp_path)
    assert [note.what for note in guesses(draft, tmp_path)][-1].endswith("are no torque sensors: torque_sensor_1")
    none = discover([save(tmp_path / "c.csv", header.format("tau_"), TIME, Q, V, 0 * V)])
    assert (none.unused.torques, none.unused.still) == ({}, ("tau_1", "tau_2"))


@pytest.mark.parametrize("name", ["matrix.mat", "matrix.npz"])
def test_an_array_without_names(name: str, tmp_path: Path) -> None:
    """As a table without a header; where that says nothing, what to save is said."""

    def saved(*columns: np.ndarray) -> Path:
        array = np.column_stack(columns)
        savemat(tmp_path / name, {"X": array}) if name.endswith("mat") else np.savez(tmp_path / name, X=array)
        return tmp_path / name

    draft = discover([saved(TIME, Q, QD, V)])
    assert (
        draft.signals.time_columns,
        list(draft.signals.position.values()),
        list(draft.signals.command.values()),
    ) == (
        ("X[1]",),
        ["X[2]", "X[3]"],
        ["X[6]", "X[7]"],
    )
    with pytest.raises(
        GtauError, match=r"X\[5\] \(without names.* or rename columns or arrays, such as q1 and current1"
    ):
        discover([saved(TIME, Q, V)])


@pytest.mark.parametrize(
    ("commands", "others"), [("motor", "torque"), ("motor_torque", "joint_torque"), ("current", "tau_J")]
)
def test_motors_beside_torques_are_the_command(commands: str, others: str, tmp_path: Path) -> None:
    """Whatever the order of the columns; the torques are offered as sensors, and both are marked where in doubt."""
    for order in ((commands, others), (others, commands)):
        header = "t,q1,q2," + ",".join(f"{name}{k}" for name in order for k in (1, 2))
        draft = discover([save(tmp_path / "log.csv", header, TIME, Q, V, 3 * V + 0.1)])
        assert draft.signals.kind == "current"
        assert list(draft.signals.command.values()) == [f"{commands}1", f"{commands}2"]
        assert list(draft.unused.torques.values()) == [f"{others}1", f"{others}2"]
        assert {"torques", "motor"} & set(draft.open) == (
            {"torques"} if commands == "current" else {"torques", "motor"}
        )
        text = draft_text(draft, tmp_path)
        assert "  # joint_torque: " in text
        assert text.count("CHECK: confirm that these are proportional to the currents") == (commands != "current")
        offered = text.replace("  # joint_torque", "  joint_torque").replace("NAME-OR-FILE", "five-bar")
        (tmp_path / "e.yaml").write_text(offered)
        assert read_experiment(tmp_path / "e.yaml").signals.sensors(SENSOR).keys() == {"j1", "j2"}


def test_efforts_and_second_clocks_are_marked(tmp_path: Path) -> None:
    header = "controller_time,host_time,position_1,position_2,effort_1,effort_2"
    draft = discover([save(tmp_path / "log.csv", header, TIME, TIME + 5.0, Q, V)])
    assert (draft.signals.time_columns, draft.signals.kind) == (("controller_time",), "torque")
    assert {"clock", "kind"} < set(draft.open)
    assert "time: controller_time  # CHECK: median step 0.004 s, 250 Hz; host_time grows, too" in draft_text(
        draft, tmp_path
    )


@pytest.mark.parametrize(
    "header",
    [
        "tiempo,posición_1,posición_2,velocidad_1,velocidad_2,corriente_1,corriente_2",
        "Zeit,Winkel1,Winkel2,Geschwindigkeit1,Geschwindigkeit2,Strom1,Strom2",
        "temps,angle1,angle2,vitesse1,vitesse2,courant1,courant2",
        "tempo,posizione_1,posizione_2,velocità_1,velocità_2,corrente_1,corrente_2",
        "Zeit,Lageistwert A1,Lageistwert A2,Drehzahlistwert A1,Drehzahlistwert A2,Stromistwert A1,Stromistwert A2",
        "temps,position axe 1,position axe 2,vitesse axe 1,vitesse axe 2,courant moteur 1,courant moteur 2",
        "时间,关节1角度,关节2角度,关节1角速度,关节2角速度,电机电流1,电机电流2",
        "時間,関節角度1,関節角度2,関節角速度1,関節角速度2,モータ電流1,モータ電流2",
        "시간,관절1 각도,관절2 각도,관절1 속도,관절2 속도,전류1,전류2",
    ],
)
def test_names_in_other_languages(header: str, tmp_path: Path) -> None:
    names = header.split(",")
    draft = discover([save(tmp_path / "log.csv", header, TIME, Q, QD, V)])
    assert (draft.signals.time_columns, draft.signals.kind, tuple(draft.open)) == ((names[0],), "current", ("robot",))
    assert draft.unused.side == {}
    assert [*draft.signals.position.values(), *draft.signals.command.values()] == [*names[1:3], *names[5:]]


@pytest.mark.parametrize(
    ("name", "kind", "reference", "unit"),
    [
        ("关节1角度(度)", "position", False, "deg"),
        ("目标位置1", "position", True, None),
        ("电机力矩1[牛米]", "motor", False, "N m"),
        ("关节1加速度", "acceleration", False, None),
        ("电压1", "other", False, None),
        ("トルク指令値1", "torque", True, None),
        ("モータ電流_1(mA)", "current", False, "mA"),
        ("목표 위치 1", "position", True, None),
        ("토크_1", "torque", False, None),
        ("Sollposition1", "position", True, None),
        ("consigne de couple 1", "torque", True, None),
        ("Par motor 1 [Nm]", "motor", False, "N m"),
    ],
)
def test_words_of_other_languages(name: str, kind: str, reference: bool, unit: str | None) -> None:
    column = parse_column_name(name)
    assert (column.kind, column.reference, column.unit, column.label) == (kind, reference, unit, "1")


@pytest.mark.parametrize("header", ["t,enc_J2,enc_J1,iq_J2,iq_J1", "t,joint_2,joint_1,i_2,i_1", "t,j2,j1,cur2,cur1"])
def test_joints_are_matched_by_number_where_no_name_fits(header: str, tmp_path: Path) -> None:
    """A robot whose joints have names; two of the logs do not say that these are positions."""
    robot = load_robot("five-bar")
    names = header.split(",")
    draft = discover([save(tmp_path / "a.csv", header, TIME, Q[:, ::-1], V[:, ::-1])], robot, "five-bar")
    assert draft.signals.position == dict(zip(robot.actuated, names[2:0:-1], strict=True))
    assert draft.signals.current == dict(zip(robot.actuated, names[4:2:-1], strict=True))
    assert f"left: {names[2]}, right: {names[1]}" in draft.open["joints"]
    taken = f"{names[1]} ... {names[2]} taken for positions"
    assert (taken in draft.open["joints"]) == ("enc" not in header)
    assert "joints" in discover([tmp_path / "a.csv"]).open or "enc" in header


@pytest.mark.parametrize("header", ["t,right,left,i_right,i_left", "t,right,left,right_current,left_current"])
def test_columns_that_are_named_as_the_joints_are_positions(header: str, tmp_path: Path) -> None:
    """Revolutions are no positions of joints where a file is named ``rev``."""
    names = header.split(",")
    log = save(tmp_path / "empty_rev.csv", header, TIME, Q[:, ::-1], V[:, ::-1])
    draft = discover([log], load_robot("five-bar"), "five-bar")
    assert draft.signals.position == {"left": "left", "right": "right"}
    assert draft.signals.current == {"left": names[4], "right": names[3]}
    assert "right ... left taken for positions" in draft.open["joints"]


def test_numbers_in_names_of_a_bag_order_them(tmp_path: Path) -> None:
    """Drivers may list joints by the alphabet; no name is of the robot."""
    columns = [f"/joint_states/arm_j{k}/{field}" for field in ("position", "effort") for k in (2, 1)]
    header = ",".join(["/joint_states/header/stamp", *columns])
    robot = load_robot("five-bar")
    draft = discover([save(tmp_path / "a.csv", header, TIME, Q[:, ::-1], V[:, ::-1])], robot, "five-bar")
    assert draft.signals.position == {"left": columns[1], "right": columns[0]}
    assert "joints" in draft.open


def test_the_base_of_a_robot_is_fixed_in_the_draft(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("arm.xml").write_text(
        "<mujoco><compiler angle='radian'/><worldbody><body name='trunk'><freejoint/><geom size='0.1' mass='1'/>"
        "<body name='a'><joint name='j1' axis='0 1 0' range='-3 3'/><geom size='0.1' mass='1'/>"
        "<body name='b' pos='0 0 0.3'><joint name='j2' axis='0 1 0' range='-3 3'/><geom size='0.1' mass='1'/>"
        "</body></body></body></worldbody>"
        "<actuator><motor joint='j1'/><motor joint='j2'/></actuator></mujoco>"
    )
    save(Path("log.csv"), "t,q1,q2,i1,i2", TIME, Q, V)
    init = ["init", "log.csv", "--robot", "arm.xml"]
    assert "--base fixed" in CliRunner().invoke(app, init).output
    for base, written in (("fixed", "fixed"), ("0, 0, deg(90)", "{rpy: [0, 0, deg(90)]}")):
        drafted = CliRunner().invoke(app, [*init, "--base", base, "--out", "a.yaml"])
        assert drafted.exit_code == 0, drafted.output
        assert f"robot: {{file: arm.xml, base: {written}}}" in Path("a.yaml").read_text()
        assert load_robot(read_experiment(Path("a.yaml")).robot).actuated == ("j1", "j2")
        Path("a.yaml").unlink()
    assert "--base is 'sideways'; write" in CliRunner().invoke(app, [*init, "--base", "sideways"]).output
    assert "--base is '0,0,x': unknown name 'x'" in CliRunner().invoke(app, [*init, "--base", "0,0,x"]).output
    assert "90 rad is more than a turn; write deg(...)" in CliRunner().invoke(app, [*init, "--base", "0,90,0"]).output
    floating = CliRunner().invoke(app, [*init, "--base", "floating"]).output
    assert "is not drafted; start from gtau docs experiment-file, 'A base that floats'." in floating
    assert "also give --robot" in CliRunner().invoke(app, ["init", "log.csv", "--base", "fixed"]).output


def test_a_single_column_without_a_header_is_refused(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "positions.txt", Q.ravel())
    with pytest.raises(GtauError, match=r"recognised among 1 \(without names.*give also the log that holds them"):
        discover([tmp_path / "positions.txt"], load_robot("five-bar"), "five-bar")


@pytest.mark.filterwarnings("error")
def test_a_log_without_rows_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,q1,q2,i1,i2\n")
    with pytest.raises(GtauError, match="0 samples"):
        LogContents.read(tmp_path / "a.csv", None)


def test_an_infinite_position_is_missing(tmp_path: Path) -> None:
    rows = [f"{k / 100},{'inf' if k == 50 else np.sin(k / 20)},{np.cos(k / 9)}" for k in range(200)]
    (tmp_path / "a.csv").write_text("\n".join(["t,q1,i1", *rows]))
    values = LogContents.read(tmp_path / "a.csv", None).values["q1"]
    assert np.flatnonzero(~np.isfinite(values)).tolist() == [50]
    assert np.isnan(values[50])


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("value", ["nan", "inf", "1e308"])
def test_columns_without_a_plausible_number_are_no_warnings_of_numpy(value: str, tmp_path: Path) -> None:
    rows = [f"{k / 100},{value if k % 50 or value == 'nan' else 1},{np.cos(k / 9)}" for k in range(200)]
    (tmp_path / "a.csv").write_text("\n".join(["t,q1,v1", *rows]))
    draft = discover([tmp_path / "a.csv"])
    with pytest.raises(GtauError, match=r"no number|implausible|non-numeric"):
        read_parts([tmp_path / "a.csv"], draft.signals, None, Units(), lambda done: None, CHOSEN, WHOLE)


def test_columns_are_looked_up_and_not_searched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Searches for each of 100,000 columns took minutes."""

    class Names(tuple[str, ...]):
        def _refused(self, name: object) -> int:
            raise AssertionError(f"searched for {name}")

        __contains__ = index = count = _refused

    table = find_columns(save(tmp_path / "a.csv", "t,q1,i1", TIME, Q[:, 0], V[:, 0]))
    monkeypatch.setattr(logs, "find_columns", lambda path: replace(table, columns=Names(table.columns)))
    assert logs.read_log(table.path, ["t", "i1"]).columns == ("t", "i1")


DEGREE = np.pi / 180


@pytest.mark.parametrize(
    ("reach", "velocity", "slower", "unit", "reason"),
    [
        (1.0, 1.0, 1, None, "positions reach"),
        (30.0, 1.0, 10, "rad", "but the velocities are the derivative and reach only 6"),  # a motor of many turns
        (30.0, None, 1, "deg", "too far for SI units"),
        (3000.0, None, 1, "rad", "too far even for deg"),
        (3000.0, 1.0, 1, "rad", "too far even for deg"),
        (10.0, DEGREE, 1, "deg", "their derivative is 57.3 times the velocities"),  # in rad/s, of a small motion
        (60.0, DEGREE, 1, "deg", "their derivative is 57.3 times the velocities"),
        (1.0, 1 / DEGREE, 1, "rad", "their derivative is 0.01745 times the velocities"),
        (60.0, 1.0, 1, "deg", "too far for SI units"),  # 120 deg/s
    ],
)
def test_velocities_decide_between_radians_and_degrees(
    reach: float, velocity: float | None, slower: float, unit: str | None, reason: str, tmp_path: Path
) -> None:
    names, columns = "t,q1,q2,tau1,tau2", [slower * TIME, reach * Q, V]
    if velocity is not None:
        names, columns = f"{names},dq1,dq2", [*columns, velocity * reach * QD / slower]
    draft = discover([save(tmp_path / "a.csv", names, *columns)])
    assert draft.units.get("position") == unit
    assert reason in draft.reasons.unit
    assert ("unit" in draft.open) == (unit is not None)


def test_positions_far_outside_the_limits_of_the_robot_are_in_degrees(tmp_path: Path) -> None:
    """Slow ones, whose velocities in deg/s are their derivatives."""
    robot = load_robot("five-bar")
    log = save(tmp_path / "a.csv", "t,q1,q2,dq1,dq2,tau1,tau2", 10 * TIME, 30 * Q, 3 * QD, V)
    for limits, unit in ((Limits(position=(-2.0, 2.0)), "deg"), (Limits(), "rad")):
        joints = tuple(replace(joint, limits=limits) for joint in robot.joints)
        assert discover([log], replace(robot, joints=joints)).units == {"position": unit}


@pytest.mark.parametrize("limited", [True, False])
@pytest.mark.parametrize(("factor", "unit"), [(1.0, "rad"), (180 / np.pi, "deg")])
def test_motors_before_their_gears_turn_as_far_as_the_joints_behind_them(
    limited: bool, factor: float, unit: str, tmp_path: Path
) -> None:
    """By limits of the motors, or of the joints that couplings tie to them."""
    robot = load_robot("staubli-tx40")
    if not limited:
        joints = (replace(joint, limits=Limits((-3.0, 3.0)) if joint.has_mass else Limits()) for joint in robot.joints)
        robot = replace(robot, joints=tuple(joints))
    motors = [robot.joint(name) for name in robot.actuated]
    angles = [factor * (motor.home + 40.0 * np.sin((k + 1) * TIME)) for k, motor in enumerate(motors)]
    names = ",".join(f"q_{motor.name}" for motor in motors), ",".join(f"i_{motor.name}" for motor in motors)
    log = save(tmp_path / "a.csv", f"t,{names[0]},{names[1]}", TIME, *angles, *[V[:, 0]] * len(motors))
    draft = discover([log], robot)
    assert draft.units["position"] == unit
    assert guesses(draft, tmp_path / "a.yaml")[0].text.startswith(
        f"positions are assumed to be in {unit}: joint 'motor_"
    )


def test_measured_angles_of_motors_are_in_radians(shared: Path) -> None:
    logs = [shared / "tx40" / name for name in ("pos_read_data.csv", "curr_data.csv")]
    assert discover(logs, load_robot("staubli-tx40")).units["position"] == "rad"


def test_a_log_at_ten_hertz_is_plausible(tmp_path: Path) -> None:
    draft = discover([save(tmp_path / "a.csv", "t,q1,q2,tau1,tau2", 26 * TIME, Q, V)])
    assert draft.reasons.time == "median step 0.104 s, 9.615 Hz"


@pytest.mark.parametrize("turn", [2 * np.pi, 360.0])
def test_wrapped_positions_without_header_are_recognised_by_continuity(turn: float, tmp_path: Path) -> None:
    """With steps of 10 to 24 ms, and a second missing."""
    time = np.cumsum(np.random.default_rng(0).choice([0.01, 0.011, 0.024], 1500))
    time[700:] += 0.9
    angle = turn * np.column_stack([0.7 * np.sin(2 * time), 0.55 * np.sin(1.3 * time) + 0.2])
    speed = turn * np.column_stack([1.4 * np.cos(2 * time), 0.715 * np.cos(1.3 * time)])
    wrapped = (angle + turn / 2) % turn - turn / 2
    log = tmp_path / "log.txt"
    np.savetxt(log, np.column_stack([time, wrapped, speed, np.sign(speed) + angle / turn]))
    draft = discover([log])
    assert draft.signals.position == {"j1": "2", "j2": "3"}
    assert list(draft.signals.command.values()) == ["6", "7"]
    unit = {"position": "deg"} if turn == 360 else {}
    runs = read_parts([log], draft.signals, None, Units(**unit), lambda done: None, CHOSEN, WHOLE)
    assert len(runs) == 2
    for run in runs:
        assert "unwrapped angle" in {note.kind for note in run.notes}
        assert np.abs(np.diff(run.position, axis=0)).max() < 0.3
