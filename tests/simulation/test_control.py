"""A robot under control: drives and sensors, control laws, simulation files, and the way back by identification."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import stated_arm
from engines import random_parameters
from typer.testing import CliRunner

from gtau.cli.commands import app
from gtau.errors import GtauError
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.result import identify
from gtau.robots.readers.native import native_text
from gtau.robots.robot import Joint, Limits, Robot
from gtau.signals.reading.experiment import read_experiment
from gtau.signals.run import read_run
from gtau.simulation import simulate as module
from gtau.simulation.closed_loop import (
    JointHardware,
    Reference,
    close_loop,
    hardware,
    pid,
    write_log,
)
from gtau.simulation.plant import Plant
from gtau.simulation.simulate import read_simulation, simulate
from gtau.simulation.trajectories import Envelope, MotionEntry, envelope, make_trajectory, moves_through, sines

RATE = 1000.0


def silent(*_):
    pass


@pytest.fixture(scope="module")
def slide() -> tuple[InverseDynamics, Plant]:
    """One mass on a rail, 2 kg."""
    limits = Limits((-1.0, 1.0), 1.0, 10.0)
    model = InverseDynamics(
        Robot("slide", (Joint("x", "ground", "prismatic", limits=limits),), gravity=(0.0, 0.0, 0.0))
    )
    return model, Plant(model, {"m_x": 2.0})


def step(length: float = 0.01, duration: float = 1.0) -> Reference:
    time = np.arange(round(duration * RATE)) / RATE
    q = np.full((len(time), 1), length)
    q[0] = 0.0
    return Reference(time, q, np.zeros_like(q), np.zeros_like(q))


def run(plant, controller, seed=0, **drive):
    parts = hardware(("x",), {"x": JointHardware(gain=5.0, **drive)})
    return close_loop("r", plant, controller, parts, np.random.default_rng(seed), joints=("x",))


def test_the_loop_has_the_bandwidth_asked_for(slide):
    """A triple pole at 100 rad/s: the simple PID answers a step as w^3 / (s + w)^3 (3 w s + w^2 ...) does."""
    _, plant = slide
    out = run(plant, pid(step(), np.array([[2.0]]), np.array([5.0]), weight=0.0))
    time, w = out.run.time, 100.0
    decay = np.exp(-w * time)
    expected = 0.01 * decay * (1 + w * time - w**2 * time**2)  # error, by partial fractions
    assert out.error[5:, 0] == pytest.approx(expected[5:], abs=0.0012)


def test_velocity_feedforward_follows_a_ramp(slide):
    _, plant = slide
    time = np.arange(1000) / RATE
    q = 0.5 * time[:, None]
    ramp = Reference(time, q, np.full_like(q, 0.5), np.zeros_like(q))
    late, prompt = (
        np.abs(run(plant, pid(ramp, np.array([[2.0]]), np.array([5.0]), weight=weight)).error).max()
        for weight in (0.0, 1.0)
    )
    assert prompt < 0.4 * late


def test_currents_are_limited_held_and_logged(slide):
    _, plant = slide
    limited = {"current_limit": 3.0, "position_quantum": 1e-4, "current_quantum": 1e-2}
    out = run(plant, pid(step(), np.array([[2.0]]), np.array([5.0]), weight=0.0), **limited)
    assert np.abs(out.run.command).max() == 3.0
    for logged, quantum in ((out.run.position, 1e-4), (out.run.command, 1e-2)):
        assert logged / quantum == pytest.approx(np.round(logged / quantum), abs=1e-6)
    assert np.abs(out.error[-1, 0]) < 2e-4  # no windup


def test_positions_are_late_by_the_delay(slide):
    _, plant = slide
    reference = Reference(*(np.arange(1500) / RATE,), *(np.zeros((1500, 1)),) * 3)
    swing = 0.1 * (1 - np.cos(4 * reference.time))[:, None]
    reference = Reference(reference.time, swing, np.zeros_like(swing), np.zeros_like(swing))
    law = pid(reference, np.array([[2.0]]), np.array([5.0]))
    out = run(plant, law, delay=2.3e-3)
    true = reference.q[:, 0] - out.error[:, 0]
    seen = np.interp(reference.time - 2.3e-3, reference.time, true)
    assert out.run.position[100:, 0] == pytest.approx(seen[100:], abs=2e-6)


def test_noise_and_ripple_have_their_size(slide):
    _, plant = slide
    still = Reference(np.arange(2000) / RATE, *(np.zeros((2000, 1)),) * 3)
    law = pid(still, np.array([[2.0]]), np.array([5.0]))
    noisy = run(plant, law, current_noise=0.02)
    assert noisy.run.command.std() == pytest.approx(0.02, rel=0.1)
    rippled = run(plant, law, seed=2, ripple=1.0, ripple_period=0.01)
    assert 0.02 < np.abs(rippled.run.command[1500:] * 5.0).max() <= 1.0


def test_a_log_reads_back_as_it_was_made(slide, tmp_path):
    _, plant = slide
    coarse = {"position_quantum": 1e-6, "current_noise": 1e-3, "current_quantum": 1e-4}
    out = run(plant, pid(step(), np.array([[2.0]]), np.array([5.0]), weight=0.0), **coarse)
    write_log(out.run, tmp_path / "r.csv")
    back = read_run(tmp_path / "r.csv", {"time": "t", "position": {"x": "qx"}, "current": {"x": "vx"}})
    np.testing.assert_array_equal(back.position, out.run.position)
    np.testing.assert_array_equal(back.command, out.run.command)


def motion(**kind) -> MotionEntry:
    return MotionEntry(**kind)


def test_the_five_kinds_of_trajectory(slide, tmp_path):
    robot = slide[0].robot
    (tmp_path / "m.csv").write_text(
        "t,q_x\n" + "".join(f"{t:.3f},{0.3 * np.sin(t) ** 3:.9f}\n" for t in np.arange(0, 4, 0.01)), encoding="utf-8"
    )
    kinds = {
        "sines": {"duration": 4.0},
        "moves": {"duration": 4.0},
        "points": {"through": [{"x": 0.0}, {"x": 0.5}, {"x": -0.2}]},
        "fourier": {
            "duration": 4.0,
            "frequency": [0.5, 1.0],
            "center": {"x": 0.1},
            "amplitude": {"x": [0.1, 0.05]},
            "phase": {"x": [0.0, 1.0]},
        },
        "csv": tmp_path / "m.csv",
    }
    for kind, written in kinds.items():
        trajectory, duration = make_trajectory(motion(**{kind: written}), robot, "run 'r'")
        time, h = np.arange(0.05, duration - 0.05, 0.01), 1e-5
        before, (_, qd, qdd), after = (trajectory(time + shift) for shift in (-h, 0.0, h))
        assert (after[0] - before[0]) / (2 * h) == pytest.approx(qd, abs=2e-4), kind
        assert (after[1] - before[1]) / (2 * h) == pytest.approx(qdd, abs=2e-2), kind
        assert np.abs(trajectory(np.array([0.0]))[1]).max() < 0.01


@pytest.mark.parametrize("name", ["palletiser", "ur10e", "orthoglide"])
def test_sines_are_slower_rather_than_smaller(name):
    """Inside the limits; and where accelerations are low, speed or reach is used all the same."""
    within = envelope(load_robot(name))
    q, qd, qdd = sines(within, 20.0, np.random.default_rng(1))(np.arange(0.0, 20.0, 0.002))
    reach, speed, acceleration = (
        np.abs(entry).max(axis=0) / most
        for entry, most in ((q - within.center, within.reach), (qd, within.velocity), (qdd, within.acceleration))
    )
    assert max(reach.max(), speed.max(), acceleration.max()) < 1.01
    assert np.maximum(reach, speed).min() > 0.75


def test_moves_use_what_the_limits_allow():
    within = Envelope(np.zeros(2), np.ones(2), np.array([1.0, 0.5]), np.array([5.0, 5.0]))
    moves = moves_through(np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.8]]), within, 0.1)
    _, qd, qdd = moves(np.arange(0.0, 4.0, 1e-4))
    assert np.abs(qdd[:, 0]).max() == pytest.approx(5.0, rel=1e-3)
    assert np.abs(qd[:, 1]).max() == pytest.approx(0.5, rel=1e-3)


def described(name: str, seed: int, duration: float, share: float = 0.9, payload=None) -> tuple[dict, dict, dict]:
    """A simulation file of a robot with bodies that could be built; its parameters and gains."""
    robot, rng = load_robot(name), np.random.default_rng(seed)
    chi = random_parameters(robot, rng)
    for joint in robot.joints:
        if not joint.actuated:  # light friction, and no motor
            chi |= {f"{kind}_{joint.name}": 0.05 * chi[f"{kind}_{joint.name}"] for kind in ("fv", "fs")}
            chi |= {f"{kind}_{joint.name}": 0.0 for kind in ("ia", "off")}
    drives, gains = {}, {}
    for k, joint in enumerate(robot.actuated):
        turns = robot.joint(joint).kind == "revolute"
        gains[joint] = 20.0 + 3 * k if turns else 1000.0 + 50 * k
        drives[joint] = {
            "gain": gains[joint],
            "ripple": 0.05 if turns else 1.0,
            "ripple_period": 0.05 if turns else 0.003,
            "position_quantum": 5e-6 if turns else 2e-6,
            "current_noise": 3e-4,
            "current_quantum": 1e-5,
        }
    load = {"payload": {"name": "steel", "mass": 3.0, **(payload or {})}}
    runs = [
        {
            "name": f"run_{k}",
            "trajectory": {kind: {"seed": k, "duration": duration, "share": share}},
            **(load if k > 1 else {}),
        }
        for k, kind in enumerate(("sines", "moves", "sines", "moves"))
    ]
    return {"robot": name, "parameters": chi, "drives": drives, "runs": runs}, chi, gains


@pytest.mark.slow
@pytest.mark.parametrize("name", ["five-bar", pytest.param("delta", marks=pytest.mark.slow)])
def test_identification_finds_what_was_simulated(name, tmp_path):
    """Gains within 0.2 %, and the base parameters within their uncertainty; six seconds a run are little."""
    document, chi, gains = described(name, 5, 6.0)
    (tmp_path / "simulation.yaml").write_text(json.dumps(document), encoding="utf-8")
    simulate(tmp_path / "simulation.yaml", tmp_path, silent)
    result = identify(tmp_path / "experiment.yaml")
    for joint, gain in gains.items():
        assert result.drive_gains[joint].value == pytest.approx(gain, rel=2e-3)
        assert result.delays[joint].value == pytest.approx(0.5 / RATE, abs=5e-5)  # the held current
    standard = [chi.get(name, 0.0) for name in result.idm.parameter_names]
    true = dict(zip(result.base.names, result.base.matrix @ standard, strict=True))
    z = np.array(
        [(entry.value - true[x]) / entry.std for x, entry in result.parameters.items() if entry.value is not None]
    )
    assert np.sqrt(np.mean(z**2)) < 1.5
    assert np.abs(z).max() < 4.0


FEET = ("11", "12", "13")
SIMULATION = {
    "robot": "orthoglide",
    "parameters": {"ia_11": 9.0, "ia_12": 9.0, "ia_13": 9.0, "m_P": 1.0},
    "drives": {joint: {"gain": 2000.0} for joint in ("11", "12", "13")},
    "runs": [
        {"name": "a", "trajectory": {"sines": {"duration": 3.0}}},
        {"name": "b", "trajectory": {"sines": {"duration": 3.0}}, "payload": {"name": "p", "mass": 1.0}, "weigh": True},
    ],
    "validation": [
        {"name": "c", "trajectory": {"moves": {"duration": 3.0}}, "payload": {"name": "q", "mass": 2.0}},
    ],
}


def written(tmp_path: Path, **changes) -> Path:
    path = tmp_path / "simulation.yaml"
    path.write_text(json.dumps({**SIMULATION, **changes}), encoding="utf-8")
    return path


@pytest.mark.slow
def test_the_command_writes_what_identify_reads(tmp_path):
    done = CliRunner().invoke(app, ["simulate", str(written(tmp_path)), "--out", str(tmp_path / "out"), "--json"])
    assert done.exit_code == 0, done.output
    files = json.loads(done.stdout)["files"]
    assert [Path(file).name for file in files] == ["a.csv", "b.csv", "c.csv", "experiment.yaml"]
    experiment = read_experiment(files[-1])
    assert [entry.payload.mass if entry.payload else 0 for entry in (*experiment.runs, *experiment.validation)] == [
        0,
        None,
        2.0,
    ]
    assert "position: {11: q11, 12: q12, 13: q13}\n" in Path(files[-1]).read_text(encoding="utf-8")
    light = [f"{k}{leg}" for leg in (1, 2, 3) for k in (1, 2, 3, 4, 5)]
    assert sorted(json.loads(done.stdout)["massless"]) == sorted(light)  # 'parameters' names rotors and the platform
    first = (tmp_path / "out" / "a.csv").read_bytes()
    simulate(written(tmp_path), tmp_path / "out", silent)
    assert (tmp_path / "out" / "a.csv").read_bytes() == first


def test_an_interruption_says_what_is_finished(tmp_path, monkeypatch):
    made = module.make_run

    def interrupted(simulation, model, described, progress):
        if described.name == "b":
            raise KeyboardInterrupt
        return made(simulation, model, described, progress)

    monkeypatch.setattr(module, "make_run", interrupted)
    out = tmp_path / "out"
    out.mkdir()
    (out / "experiment.yaml").write_text("old", encoding="utf-8")
    done = CliRunner().invoke(app, ["simulate", str(written(tmp_path)), "--out", str(out)])
    assert done.exit_code == 130
    assert "logs finished" in done.output
    assert "a.csv, of 3; experiment.yaml has not been written" in done.output
    assert [path.name for path in out.iterdir()] == ["a.csv"]


def test_a_bandwidth_that_nobody_wrote_suits_the_rate(tmp_path):
    for rate, bandwidth in ((100, 20.0), (1000, 100.0)):
        assert read_simulation(written(tmp_path, rate=rate)).bandwidth == bandwidth


RUN = {"name": "a", "trajectory": {"sines": {"duration": 3.0}}}


def fourier(frequency: float, amplitude: float) -> dict:
    """One sine of all joints."""
    every = {"center": dict.fromkeys(FEET, 0.015), "phase": {joint: [0.0] for joint in FEET}}
    return {
        "fourier": {"duration": 4.0, "frequency": [frequency], "amplitude": {joint: [amplitude] for joint in FEET}}
        | every
    }


def drive(**keys: float) -> dict:
    """Keys of one drive of three."""
    return {"drives": {joint: {"gain": 2000.0, **(keys if joint == "12" else {})} for joint in FEET}}


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"drives": {"11": {"gain": 1.0}}}, "drives: joint '12' is missing; the actuated joints"),
        ({"drives": {"11": {"gain": 0}}}, "a drive with a gain of 0 gives no torque"),
        ({"seed": -1}, "-1 is out of range"),
        ({"parameters": {"m_99": 1.0}}, "has no standard parameter 'm_99'"),
        ({"rate": 100, "bandwidth": 100}, "bandwidth of 100 rad/s is impossible at a rate of 100 Hz; write at most 20"),
        ({"runs": [RUN, RUN]}, "two runs are called 'a'"),
        ({"runs": [{**RUN, "name": "../a"}]}, "'../a' names a log"),
        ({"runs": [{**RUN, "weigh": True}]}, "'weigh' is given without 'payload'"),
        ({"runs": [{**RUN, "payload": {"name": "p"}}]}, "the payload 'p' has no mass"),
        ({"runs": [{"name": "a", "trajectory": {}}]}, "give one trajectory"),
        ({"runs": [{"name": "a", "trajectory": {"csv": "no.csv"}}]}, "there is no file"),
        ({"runs": [{"name": "a", "trajectory": {"sine": {}}}]}, "did you mean 'sines'"),
        (
            {"runs": [{"name": "a", "trajectory": {"points": {"through": [{"11": 0}, {"11": 0.1}]}}}]},
            "run 'a', trajectory: joint '12' is missing",
        ),
        (
            {
                "runs": [
                    {"name": "a", "trajectory": {"points": {"through": [dict.fromkeys(FEET, x) for x in (0, 0.2)]}}}
                ]
            },
            "joint '11' would move from 0 to 0.2, beyond its limits",
        ),
        (
            {"runs": [{"name": "a", "trajectory": fourier(3.0, 0.08)}]},
            "joint '11' would reach 1.508 m/s, beyond its limit of 1.2",
        ),
        (
            {"runs": [{"name": "a", "trajectory": fourier(8.0, 0.01)}]},
            "joint '11' would reach 25.22 m/s2, beyond its limit of 20 m/s2",
        ),
        ({"engine": "bullet"}, "write 'gtau' or 'mujoco', not 'bullet'"),
        (
            {"parameters": {}},
            "the robot has no parameters, as the file of 'orthoglide' has no mass and inertia of 11, 21",
        ),
        (drive(ripple_period=0.1), "'ripple_period' has no effect without 'ripple'"),
        (drive(dead_band=0.1), "'dead_band' has no effect without 'proportional_gain'"),
        (drive(inductance=1e-3), "'inductance' of '12' is given without a supply; add 'supply: {voltage: ...}'"),
        (drive(proportional_gain=2.0), "'proportional_gain' of '12' is given without a supply"),
        ({"parameters": {"m_P": -1.0}}, "'m_P' is negative, which no mass or inertia is; write 0 or more"),
        (drive(gain=1e-300), "a drive with a gain of 1e-300 gives no torque"),
        (
            {"runs": [{"name": "a", "trajectory": {"csv": "slow.csv"}}]},
            "run 'a' would last 4000 s; give a trajectory of",
        ),
        ({"curves": {"11": {}}}, "neither 'width' nor 'speed' is given"),
        ({"curves": {"11": {"speed": 0.1}}}, "the 'speed' of '11' has no effect without friction that falls with it"),
    ],
)
def test_what_a_simulation_file_may_not_say(changes, sentence, tmp_path):
    (tmp_path / "slow.csv").write_text("t,q_11,q_12,q_13\n" + "".join(f"{500 * k},0,0,0\n" for k in range(9)))
    with pytest.raises(GtauError) as refused:
        simulate(written(tmp_path, **changes), tmp_path, silent)
    assert sentence in str(refused.value)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["simulation.yaml", "slow.csv"]


def test_inertias_that_only_the_robots_file_states_are_taken(tmp_path):
    """With friction alone under 'parameters', and without any; a stated mass leaves the file's out."""
    (tmp_path / "arm.urdf").write_text(stated_arm.urdf(), encoding="utf-8")
    described = {"robot": "arm.urdf", "rate": 250, "drives": {joint: {"gain": 2.0} for joint in stated_arm.MASSES}}
    described |= {"runs": [{"name": "a", "trajectory": {"sines": {"duration": 3.0}}}]}
    logs = []
    stated = {name: value for name, value in load_robot(tmp_path / "arm.urdf").inertias.items() if "ground" not in name}
    for parameters in (
        {},
        {"fv_j1": 1.5},
        stated | {"fv_j1": 1.5},
        {"m_j4": 1.0, **{f"ia_j{k}": 1.0 for k in (1, 2, 3, 4)}},
    ):
        path = tmp_path / "simulation.yaml"
        path.write_text(json.dumps(described | {"parameters": parameters}), encoding="utf-8")
        done = CliRunner().invoke(app, ["simulate", str(path), "--out", str(tmp_path / "out")])
        assert done.exit_code == 0, done.output
        assert ("inertias are of the robot's file arm.urdf" in done.output) == (len(parameters) < 2)
        logs.append(read_run(tmp_path / "out" / "a.csv", read_experiment(tmp_path / "out" / "experiment.yaml").signals))
    without, rubbing, pasted, _ = (run.command for run in logs)
    assert rubbing == pytest.approx(pasted)
    assert np.abs(rubbing - without).max() > 0.1


def test_bodies_that_cannot_be_are_refused_before_they_move(tmp_path):
    bodies = {"m_left": 1.0, "zz_left": 0.03, "m_right": 1.0, "zz_right": 0.03, "m_right_forearm": 0.5}
    lever = {"mx_right_forearm": 0.7, "zz_right_forearm": 0.021}  # beyond what 0.5 kg can have
    drives, runs = {"left": {"gain": 2.7}, "right": {"gain": 3.8}}, [{"name": "a", "trajectory": {"sines": {}}}]
    described = {"robot": "five-bar", "parameters": bodies | lever, "drives": drives, "rate": 250, "runs": runs}
    with pytest.raises(GtauError, match=r"run 'a': the inertia matrix is not positive definite along the motion"):
        simulate(described, tmp_path)


def test_passive_joints_keep_to_their_limits_too(tmp_path):
    narrow = native_text(load_robot("orthoglide")).replace("31: {", "31: {limits: {position: [-0.1, 0.1]}, ", 1)
    (tmp_path / "narrow.yaml").write_text(narrow, encoding="utf-8")
    with pytest.raises(GtauError, match=r"run 'a': joint '31' would move from -0\.\d+ to 0\.\d+, beyond its limits"):
        simulate(written(tmp_path, robot="narrow.yaml"), tmp_path, silent)


def test_a_run_through_a_singular_pose_is_refused_with_its_time(tmp_path):
    robot = load_robot("five-bar")
    free = Limits((-3.0, 6.0), *(getattr(robot.joint("left").limits, key) for key in ("velocity", "acceleration")))
    joints = tuple(replace(joint, limits=free) if joint.actuated else joint for joint in robot.joints)
    (tmp_path / "wide.yaml").write_text(native_text(replace(robot, joints=joints)), encoding="utf-8")
    through = [{"left": 2.0944, "right": 1.0472}, {"left": 3.5944, "right": -0.4528}]
    simulation = {
        "robot": str(tmp_path / "wide.yaml"),
        "parameters": {"ia_left": 0.02, "ia_right": 0.02},
        "drives": {"left": {"gain": 2.5}, "right": {"gain": 4.0}},
        "runs": [{"name": "far", "trajectory": {"points": {"through": through}}}],
    }
    with pytest.raises(GtauError, match=r"at 0\.\d+ s of run 'far' \(q_left = 3\.14"):
        simulate(simulation, tmp_path / "out")


@pytest.mark.slow
def test_the_mujoco_engine_makes_the_same_run(tmp_path):
    from gtau.simulation.simulate import make_run

    simulation = read_simulation(written(tmp_path))
    model = InverseDynamics(load_robot("orthoglide"))
    ours, theirs = (
        make_run(simulation.model_copy(update={"engine": engine}), model, simulation.runs[0]).run
        for engine in ("gtau", "mujoco")
    )
    assert theirs.position == pytest.approx(ours.position, abs=5e-5)
    assert np.abs(theirs.command - ours.command).max() < 0.03 * np.abs(ours.command).max()
