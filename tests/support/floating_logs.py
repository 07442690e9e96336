"""An arm on a floating base, logs of its base's pose, of the wrenches on it and of motor currents.

Its motion is a sum of sines; torques and wrenches are Pinocchio's, with a free flyer.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from pathlib import Path

import numpy as np
import pinocchio as pin
import polars as pl
from engines import random_parameters
from free_flyer import free_flyer_model, free_state, pinocchio_state
from scipy.spatial.transform import Rotation

from gtau.result import Result
from gtau.robots.geometry import float_base
from gtau.robots.readers.native import write_native
from gtau.robots.robot import INERTIAL, Joint, Mdh, Pose, Robot

RATE, DURATION = 100.0, 20.0
GAINS = {"1": 11.0, "2": 7.0, "3": 3.0}
DRIVE = {"ia": 0.05, "fv": 0.4, "fs": 0.6, "off": 0.1}
HOOK = np.array([0.1, -0.05, 0.2])  # of the force sensor on the base
PLATE = np.array([0.3, 0.2, -1.0])  # of the force plate in the world
SOLE = np.array([0.02, 0.0, -0.1])  # of the force sensor in the last link


FIXED = Robot(
    "arm",
    (
        Joint("1", "ground", "revolute", Mdh(gamma=0.3, b=0.2, alpha=0.1, d=0.1, r=0.3)),
        Joint("2", "1", "revolute", Mdh(alpha=-pi / 2, d=0.1, theta=0.3)),
        Joint("3", "2", "revolute", Pose((0.1, -0.2, 0.3), (0.4, -0.8, 1.1)), (0.6, 0.0, 0.8)),
    ),
)
TOOL = pin.Inertia(3.0, np.array([0.05, -0.1, 0.2]), np.diag([0.02, 0.03, 0.01]))


@dataclass
class Truth:
    """Standard parameters, and the samples of a log without noise."""

    chi: dict[str, float]
    columns: dict[str, np.ndarray]


def inertia_of(chi: dict[str, float], body: str) -> pin.Inertia:
    """The inertia of a body about its frame."""
    xx, xy, xz, yy, yz, zz, mx, my, mz, m = (chi[f"{kind}_{body}"] for kind in INERTIAL)
    return pin.Inertia.FromDynamicParameters(np.array([m, mx, my, mz, xx, xy, yy, xz, yz, zz]))


def simulated(
    seed: int,
    moving: bool = True,
    foot: float = 0.0,
    swaying: float = 0.0,
    tool: bool = False,
) -> Truth:
    """Motion of base and joints, currents, and the wrench on the base: at the hook, and at the plate in world axes.

    A share ``foot`` of it, which is ``swaying``, acts on the last link instead, which stands on the plate: what the
    hook shows is the rest. Or the last link carries a ``tool`` of which the robot file knows nothing. The wrench on the
    link is in the columns ``s...``, in axes of the link at its sole, and ``w...``, at the plate.
    """
    robot, rng = float_base(FIXED, "trunk"), np.random.default_rng(seed)
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
        model.appendBodyToJoint(number, inertia_of(chi, name), pin.SE3.Identity())
    data = model.createData()
    base, of_base, sole, world = np.zeros((4, len(t), 6))  # forces and moments about origins
    tau, R = np.zeros((len(t), 3)), np.zeros((len(t), 3, 3))
    for k in range(len(t)):
        state = free_state(q[k, :6], qd[k, :6], qdd[k, :6])
        at = pinocchio_state(state, q[k, 6:], qd[k, 6:], qdd[k, 6:])
        pin.forwardKinematics(model, data, at[0])
        whole = pin.Force(pin.rnea(model, data, *at)[:6])
        share = float(foot + swaying * np.sin(2 * t[k]))
        on_foot = data.oMi[4].actInv(data.oMi[1].act(share * whole))
        if tool:
            on_foot = -(TOOL * data.a_gf[4] + data.v[4].cross(TOOL * data.v[4]))
        found = pin.rnea(model, data, *at, [pin.Force.Zero()] * 4 + [on_foot])
        tau[k], R[k] = found[6:], state.R
        base[k], of_base[k], sole[k] = found[:6], data.oMi[1].act(pin.Force(found[:6])).vector, on_foot.vector
        world[k] = data.oMi[4].act(on_foot).vector
    hook, plate, sole, world = (
        np.hstack([wrench[:, :3], wrench[:, 3:] - np.cross(point, wrench[:, :3])])
        for wrench, point in ((base, HOOK), (of_base, PLATE), (sole, SOLE), (world, PLATE))
    )
    for j, joint in enumerate(GAINS):
        tau[:, j] += DRIVE["ia"] * qdd[:, 6 + j] + DRIVE["fv"] * qd[:, 6 + j] + DRIVE["fs"] * np.sign(qd[:, 6 + j])
        tau[:, j] += DRIVE["off"]
        tau[:, j] /= GAINS[joint]
    columns = {"t": t}
    for names, values, noise in (
        ("px py pz", 1e3 * q[:, :3], 0.05),  # mm
        ("qw qx qy qz", Rotation.from_matrix(R).as_quat(scalar_first=True), 1e-4),
        ("hx hy hz", hook[:, :3], 0.5),
        ("hmx hmy hmz", hook[:, 3:], 0.05),
        ("gx gy gz", plate[:, :3], 0.5),
        ("gmx gmy gmz", plate[:, 3:], 0.05),
        ("q1 q2 q3", q[:, 6:], 2e-5),
        ("i1 i2 i3", tau, 0.01),
        ("sx sy sz", sole[:, :3], 0.5),
        ("smx smy smz", sole[:, 3:], 0.05),
        ("wx wy wz", world[:, :3], 0.5),
        ("wmx wmy wmz", world[:, 3:], 0.05),
    ):
        noisy = values + noise * rng.normal(size=values.shape)
        if names.startswith("qw"):
            noisy *= np.where(rng.random(len(t)) < 0.02, -1.0, 1.0)[:, None]  # trackers change the sign as they like
        columns |= dict(zip(names.split(), noisy.T, strict=True))
    return Truth(chi, columns)


POSE = "position: [px, py, pz], quaternion: [qw, qx, qy, qz]"
AT_HOOK = f"{{force: [hx, hy, hz], moment: [hmx, hmy, hmz], axes: base, at: {HOOK.tolist()}}}"
AT_PLATE = f"{{force: [gx, gy, gz], moment: [gmx, gmy, gmz], axes: world, at: {PLATE.tolist()}}}"
AT_SOLE = f"{{body: 3, force: [sx, sy, sz], moment: [smx, smy, smz], axes: body, at: {SOLE.tolist()}}}"
ON_PLATE = f"{{body: 3, force: [wx, wy, wz], moment: [wmx, wmy, wmz], at: {PLATE.tolist()}}}"


def experiment(folder: Path, base: str, truth: Truth, more: str = "") -> Path:
    robot = float_base(FIXED, "trunk") if base else FIXED
    write_native(robot, folder / "arm.yaml")
    pl.DataFrame(truth.columns).write_csv(folder / "log.csv")
    (folder / "experiment.yaml").write_text(
        "robot: arm.yaml\n"
        "signals:\n  time: t\n  position: {1: q1, 2: q2, 3: q3}\n  current: {1: i1, 2: i2, 3: i3}\n"
        + (f"  base: {base}\nunits: {{base: {{length: mm}}}}\n" if base else "")
        + f"{more}\nruns: [{{log: log.csv}}]\n"
    )
    return folder / "experiment.yaml"


def deviations(result: Result, chi: dict[str, float]) -> np.ndarray:
    """Errors of the base parameters in standard deviations, and of the gains."""
    base = result.base
    true = base.matrix @ np.array([chi.get(name, 0.0) for name in result.idm.parameter_names])
    found = [result.parameters[name] for name in base.names]
    pairs = [(each.value - value, each.std) for each, value in zip(found, true, strict=True) if each.std]
    pairs += [(result.drive_gains[joint].value - gain, result.drive_gains[joint].std) for joint, gain in GAINS.items()]
    return np.array([error / std for error, std in pairs])
