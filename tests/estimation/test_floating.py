"""A robot whose base floats, identified from logs of its base's pose, the wrench that holds it, and motor currents.

Its motion is a sum of sines; torques and wrench are Pinocchio's, with a free flyer.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from pathlib import Path

import numpy as np
import pinocchio as pin
import polars as pl
import pytest
from engines import random_parameters
from free_flyer import free_flyer_model, free_state, pinocchio_state
from scipy.spatial.transform import Rotation

from gtau.errors import GtauError
from gtau.estimation.diagnostics.verdict import Outcome
from gtau.estimation.identify import identify
from gtau.estimation.results.result import Result
from gtau.robots.floating import float_base
from gtau.robots.readers.native_text import write_native
from gtau.robots.robot import INERTIAL, Joint, Mdh, Pose, Robot
from gtau.signals.run import read_run

RATE, DURATION = 100.0, 20.0
GAINS = {"1": 11.0, "2": 7.0, "3": 3.0}
DRIVE = {"ia": 0.05, "fv": 0.4, "fs": 0.6, "off": 0.1}
HOOK = np.array([0.1, -0.05, 0.2])  # of the force sensor on the base
PLATE = np.array([0.3, 0.2, -1.0])  # of the force plate in the world


def arm() -> Robot:
    return float_base(
        Robot(
            "arm",
            (
                Joint("1", "ground", "revolute", Mdh(gamma=0.3, b=0.2, alpha=0.1, d=0.1, r=0.3)),
                Joint("2", "1", "revolute", Mdh(alpha=-pi / 2, d=0.1, theta=0.3)),
                Joint("3", "2", "revolute", Pose((0.1, -0.2, 0.3), (0.4, -0.8, 1.1)), (0.6, 0.0, 0.8)),
            ),
        ),
        "trunk",
    )


@dataclass
class Truth:
    """Standard parameters, and the samples of a log without noise."""

    chi: dict[str, float]
    columns: dict[str, np.ndarray]


def simulated(seed: int, moving: bool = True) -> Truth:
    """Motion of base and joints, currents, and the wrench on the base: at the hook, and at the plate in world axes."""
    robot, rng = arm(), np.random.default_rng(seed)
    chi = random_parameters(robot, np.random.default_rng(1)) | {
        f"{kind}_{joint}": value for joint in GAINS for kind, value in DRIVE.items()
    }
    t = np.arange(0, DURATION, 1 / RATE)
    amplitude = np.array([0.08, 0.08, 0.05, 0.25, 0.25, 0.4] if moving else [0.0] * 6)[:, None] / 3
    amplitude = np.vstack([amplitude, np.full((3, 1), 1 / 3)])
    w, phase = 2 * pi * rng.uniform(0.1, 1.0, (2, 9, 6)) * [[[1.0]], [[0.0]]], rng.uniform(0, 2 * pi, (9, 6))
    w = w[0]
    angle = w[:, :, None] * t + phase[:, :, None]
    q = np.einsum("jk,jkt->tj", np.broadcast_to(amplitude, w.shape), np.sin(angle))
    qd = np.einsum("jk,jkt->tj", amplitude * w, np.cos(angle))
    qdd = -np.einsum("jk,jkt->tj", amplitude * w**2, np.sin(angle))
    model = free_flyer_model(robot)
    for number, name in enumerate(("trunk", *GAINS), start=1):
        xx, xy, xz, yy, yz, zz, mx, my, mz, m = (chi[f"{kind}_{name}"] for kind in INERTIAL)
        inertia = pin.Inertia.FromDynamicParameters(np.array([m, mx, my, mz, xx, xy, yy, xz, yz, zz]))
        model.appendBodyToJoint(number, inertia, pin.SE3.Identity())
    data = model.createData()
    hook, plate, tau, quaternion = np.zeros((len(t), 6)), np.zeros((len(t), 6)), np.zeros((len(t), 3)), []
    for k in range(len(t)):
        state = free_state(q[k, :6], qd[k, :6], qdd[k, :6])
        found = pin.rnea(model, data, *pinocchio_state(state, q[k, 6:], qd[k, 6:], qdd[k, 6:]))
        force, moment, tau[k] = found[:3], found[3:6], found[6:]
        hook[k] = [*force, *(moment - np.cross(HOOK, force))]
        plate[k] = [*(state.R @ force), *(state.R @ moment + np.cross(state.p - PLATE, state.R @ force))]
        quaternion.append(Rotation.from_matrix(state.R).as_quat(scalar_first=True))
    for j, joint in enumerate(GAINS):
        tau[:, j] += DRIVE["ia"] * qdd[:, 6 + j] + DRIVE["fv"] * qd[:, 6 + j] + DRIVE["fs"] * np.sign(qd[:, 6 + j])
        tau[:, j] += DRIVE["off"]
        tau[:, j] /= GAINS[joint]
    columns = {"t": t}
    for names, values, noise in (
        ("px py pz", 1e3 * q[:, :3], 0.05),  # mm
        ("qw qx qy qz", np.array(quaternion), 1e-4),
        ("hx hy hz", hook[:, :3], 0.5),
        ("hmx hmy hmz", hook[:, 3:], 0.05),
        ("gx gy gz", plate[:, :3], 0.5),
        ("gmx gmy gmz", plate[:, 3:], 0.05),
        ("q1 q2 q3", q[:, 6:], 2e-5),
        ("i1 i2 i3", tau, 0.01),
    ):
        noisy = values + noise * rng.normal(size=values.shape)
        if names.startswith("qw"):
            noisy *= np.where(rng.random(len(t)) < 0.02, -1.0, 1.0)[:, None]  # trackers change the sign as they like
        columns |= dict(zip(names.split(), noisy.T, strict=True))
    return Truth(chi, columns)


POSE = "position: [px, py, pz], quaternion: [qw, qx, qy, qz]"
AT_HOOK = f"{{force: [hx, hy, hz], moment: [hmx, hmy, hmz], axes: base, at: {HOOK.tolist()}}}"
AT_PLATE = f"{{force: [gx, gy, gz], moment: [gmx, gmy, gmz], axes: world, at: {PLATE.tolist()}}}"


def experiment(folder: Path, base: str, truth: Truth, more: str = "") -> Path:
    write_native(arm(), folder / "arm.yaml")
    pl.DataFrame(truth.columns).write_csv(folder / "log.csv")
    (folder / "experiment.yaml").write_text(
        "robot: arm.yaml\n"
        "signals:\n  time: t\n  position: {1: q1, 2: q2, 3: q3}\n  current: {1: i1, 2: i2, 3: i3}\n"
        f"  base: {base}\n"
        f"units: {{base: {{length: mm}}}}\nruns: [{{log: log.csv}}]\n{more}"
    )
    return folder / "experiment.yaml"


def deviations(result: Result, chi: dict[str, float]) -> np.ndarray:
    """Errors of the base parameters in standard deviations, and of the gains."""
    base = result.base
    true = base.matrix @ np.array([chi.get(name, 0.0) for name in result.model.parameter_names])
    found = [result.parameters[name] for name in base.names]
    pairs = [(each.value - value, each.std) for each, value in zip(found, true, strict=True) if each.std]
    pairs += [(result.drive_gains[joint].value - gain, result.drive_gains[joint].std) for joint, gain in GAINS.items()]
    return np.array([error / std for error, std in pairs])


@pytest.fixture(scope="module")
def hung() -> Truth:
    return simulated(2)


@pytest.mark.parametrize(("wrench", "yaw"), [(AT_HOOK, 0.0), (AT_PLATE, 0.7)], ids=["hook", "plate"])
def test_gains_from_the_wrench_that_holds_the_base(wrench: str, yaw: float, hung: Truth, tmp_path: Path) -> None:
    path = experiment(tmp_path, f"{{body: trunk, {POSE}, yaw: {yaw}, wrenches: [{wrench}]}}", hung)
    result = identify(path)
    assert tuple(result.drive_gains) == ("1", "2", "3")
    assert result.robot.base == ("trunk_x", "trunk_y", "trunk_z", "trunk_rx", "trunk_ry", "trunk")
    for joint, gain in GAINS.items():
        found = result.drive_gains[joint]
        assert found.value == pytest.approx(gain, rel=0.005)
        assert found.verdict.outcome == Outcome.GOOD
        assert dict(found.scale) == pytest.approx({"wrench on 'trunk'": 1.0})
    z = deviations(result, hung.chi)
    assert len(z) == 46
    assert np.sqrt(np.mean(z**2)) < 1.6
    assert np.abs(z).max() < 4.5
    assert not {name for name in result.friction if "trunk" in name}
    result.save(tmp_path / "model.json")
    again = Result.load(tmp_path / "model.json")
    assert again.gains == pytest.approx([1.0] * 6 + [result.drive_gains[joint].value for joint in GAINS])
    errors = again.validate(read_run(tmp_path / "log.csv", **signals(path)))
    assert len(errors) == 9
    assert max(error.relative for error in errors) < 5


def signals(path: Path) -> dict:
    from gtau.signals.experiment import read_experiment

    described = read_experiment(path)
    return {"signals": described.signals, "units": described.units}


def test_an_arm_at_rest_on_a_force_plate(tmp_path: Path) -> None:
    """Without columns of a pose the base does not move: the plate alone gives the scale, no payload is needed."""
    truth = simulated(3, moving=False)
    result = identify(experiment(tmp_path, f"{{body: trunk, wrenches: [{AT_PLATE}]}}", truth))
    for joint, gain in GAINS.items():
        found = result.drive_gains[joint]
        assert found.value == pytest.approx(gain, rel=0.01)
        assert abs(found.value - gain) < 4 * found.std
    assert not [note for note in map(str, result.notes) if "trunk" in note and "moves" in note]


def test_a_wrong_wrench_shows(hung: Truth, tmp_path: Path) -> None:
    """Forces that the robot exerts instead of those that act on it turn all gains around."""
    columns = hung.columns | {name: -hung.columns[name] for name in ("hx", "hy", "hz", "hmx", "hmy", "hmz")}
    result = identify(experiment(tmp_path, f"{{body: trunk, {POSE}, wrenches: [{AT_HOOK}]}}", Truth(hung.chi, columns)))
    assert {gain.verdict.outcome for gain in result.drive_gains.values()} == {Outcome.CONTRADICTORY}


BASE = f"{{body: trunk, {POSE}, wrenches: [{AT_HOOK}]}}"
REFUSED = [
    ("no wrench", f"{{body: trunk, {POSE}}}", {}, "nothing that is measured acts on the base 'trunk' in any run"),
    ("another body", BASE.replace("trunk", "base"), {}, "write 'body: trunk' there"),
    ("tls", BASE, {"method": "tls"}, "method 'tls' does not support floating bases"),
    ("didim", BASE, {"method": "didim"}, "motion is simulated from the currents of motors"),
    ("order of the quaternion", BASE.replace("[qw, qx, qy, qz]", "[q1, qx, qy, qz]"), {}, "has the length"),
    ("twice", BASE.replace("[hx, hy, hz]", "[hx, hy, px]"), {}, "the column 'px' is given twice"),
    ("a pose too", BASE + "\n  pose: {source: tracker, position: {x: px}}", {}, "of one that floats; remove 'pose'"),
    ("nothing", "{body: trunk}", {}, "it names no columns; give 'position' and 'quaternion'"),
]


@pytest.mark.parametrize(
    ("base", "options", "sentence"), [case[1:] for case in REFUSED], ids=[case[0] for case in REFUSED]
)
def test_refusals(base: str, options: dict, sentence: str, hung: Truth, tmp_path: Path) -> None:
    with pytest.raises(GtauError) as refused:
        identify(experiment(tmp_path, base, hung), **options)
    assert sentence in str(refused.value)


def test_a_base_wants_columns_and_a_robot_that_floats(hung: Truth, tmp_path: Path) -> None:
    path = experiment(tmp_path, BASE, hung)
    text = path.read_text()
    for changed, sentence in (
        (
            text.replace(f"  base: {BASE}\n", "").replace("units: {base: {length: mm}}\n", ""),
            "'signals' do not say how",
        ),
        (
            text.replace("robot: arm.yaml", "robot: {file: arm.yaml, base: fixed}"),
            "is fixed; write 'robot: {file: ...,",
        ),
    ):
        path.write_text(changed)
        with pytest.raises(GtauError) as refused:
            identify(path)
        assert sentence in str(refused.value)
