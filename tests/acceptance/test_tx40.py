"""The log of a real Staubli TX40: motor positions and motor torques, a coupled wrist, no payload."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, decimate, filtfilt

from gtau.errors import GtauError
from gtau.model.base_parameters import base_parameters
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.result import identify

RATE = 5000.0
MOTORS = [f"motor_{k}" for k in range(1, 7)]
R = np.diag([32.0, 32, 45, -48, 45, 32])
R[5, 4] = 32.0
# the source's: samples at lower joint speeds (rad/s) are left out, joint by joint
SLOWEST = (0.050, 0.050, 0.075, 0.072, 0.056, 0.122)
REFERENCE = {
    "fv": (8.087, 5.594, 1.983, 1.112, 1.854, 0.648),
    "fs": (7.014, 8.134, 6.283, 2.490, 3.041, 0.304),
    "wrist": (0.616, 1.956),
}


@pytest.fixture(scope="module")
def log(shared: Path) -> np.ndarray:
    """Motor positions (rad) and torques (N m), (45000, 12)."""
    folder = shared / "tx40"
    return np.hstack(
        [np.loadtxt(folder / name, delimiter=",", skiprows=1) for name in ("pos_read_data.csv", "curr_data.csv")]
    )


def weighted(rows: list[np.ndarray], torques: list[np.ndarray]) -> np.ndarray:
    """Least squares, then again with each joint's rows over its error."""
    level = np.ones(len(rows))
    for _ in range(2):
        X, y = (
            np.vstack([A / s for A, s in zip(rows, level, strict=True)]),
            np.concatenate([t / s for t, s in zip(torques, level, strict=True)]),
        )
        size = np.linalg.norm(X, axis=0)
        theta = np.linalg.lstsq(X / size, y, rcond=None)[0] / size
        level = np.array([np.std(t - A @ theta) for A, t in zip(rows, torques, strict=True)])
    return theta


def test_plain_least_squares_as_the_source(log: np.ndarray) -> None:
    """Friction within 3 % of the published values, in the joints' rows, with the source's masks."""
    idm = InverseDynamics(load_robot("staubli-tx40"))
    base = base_parameters(idm)
    assert base.count == 61
    q = filtfilt(*butter(4, 100.0 / (RATE / 2)), log[:, :6], axis=0)
    qd = np.gradient(q, 1 / RATE, axis=0)
    inside = slice(200, -200)
    q, qd, qdd, command = (array[inside] for array in (q, qd, np.gradient(qd, 1 / RATE, axis=0), log[:, 6:]))
    regressor = idm.columns(base.standard)
    entries = regressor(idm.layout, idm.motion(q.T.copy(), qd.T.copy(), qdd.T.copy()))
    W = np.zeros((6, len(q), base.count))
    W[regressor.rows, :, regressor.columns] = entries
    W, tau, speed = np.einsum("ij,inc->jnc", R, W), (command @ R).T, (qd @ np.linalg.inv(R).T).T
    rows, torques = [], []
    for joint in range(6):
        kept = np.abs(speed[joint, ::50]) >= SLOWEST[joint]
        rows.append(decimate(W[joint], 50, axis=0, zero_phase=True)[kept])
        torques.append(decimate(tau[joint], 50, zero_phase=True)[kept])
    theta = weighted(rows, torques)
    found = dict(zip(base.standard, theta, strict=True))
    # the source has no friction in motor 6 but a common one, and joint 6 turns with it
    wrist = 1024 * found["fv_motor_6"], 32 * found["fs_motor_6"]
    gears = np.abs(np.diag(R))[:5]
    fv = np.array([*(gears**2 * [found[f"fv_motor_{k}"] for k in range(1, 6)]), found.get("fv_joint_6", 0.0)])
    fv[4:] += wrist[0]
    fs = np.array([*(gears * [found[f"fs_motor_{k}"] for k in range(1, 6)]), found["fs_joint_6"]])
    assert fv == pytest.approx(REFERENCE["fv"], rel=0.03)
    assert fs == pytest.approx(REFERENCE["fs"], rel=0.03)
    assert wrist == pytest.approx(REFERENCE["wrist"], rel=0.03)
    residual = np.concatenate([t - A @ theta for A, t in zip(rows, torques, strict=True)])
    assert 0.05 < np.linalg.norm(residual) / np.linalg.norm(np.concatenate(torques)) < 0.06


@pytest.fixture(scope="module")
def folder(log: np.ndarray, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tx40")
    header = ",".join(f"{kind}{k}" for kind in "pc" for k in range(1, 7))
    np.savetxt(folder / "log.csv", log, delimiter=",", header=header, comments="", fmt="%.9g")
    for kind in ("torque", "current"):
        columns = {
            key: "{" + ", ".join(f"{name}: {letter}{k}" for k, name in enumerate(MOTORS, start=1)) + "}"
            for key, letter in (("position", "p"), (kind, "c"))
        }
        signals = "".join(f"  {key}: {value}\n" for key, value in columns.items())
        (folder / f"{kind}.yaml").write_text(
            f"robot: staubli-tx40\nsignals:\n  time: {{rate: {RATE:g}}}\n{signals}runs:\n  - {{log: log.csv}}\n"
        )
    return folder


@pytest.mark.slow
def test_identify_takes_the_log_as_it_is(folder: Path) -> None:
    result = identify(folder / "torque.yaml")
    errors = {error.joint: error.relative for error in result.residuals}
    assert list(errors) == MOTORS
    assert max(errors.values()) < 15.0
    assert errors["motor_1"] < 5.0


def test_gains_are_refused_without_a_payload(folder: Path) -> None:
    with pytest.raises(GtauError, match="payload"):
        identify(folder / "current.yaml", method="ml")
    with pytest.raises(GtauError, match="no run has a payload of known mass"):
        identify(folder / "torque.yaml", method="ml")
