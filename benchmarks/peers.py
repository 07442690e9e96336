"""What the benchmarks compare with: the same work by Pinocchio in a Python loop, as one would write it by hand.

The loops are closed by Newton's method from the sample before, with Pinocchio's frames; the regressor of the tree is
Pinocchio's, projected by NumPy.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pinocchio as pin
import polars as pl

from gtau.excitation.task import DesignProblem, Grid
from gtau.robots.robot import Robot

sys.path.append(str(Path(__file__).parents[1] / "tests" / "support"))
from engines import Pinocchio, random_parameters

__all__ = ["PinocchioLoop", "figaroh_regressor", "random_parameters"]
AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


class PinocchioLoop:
    """Regressor of a robot whose inertial parameters are ``chi``, sample by sample.

    With ``drives`` rotor, viscous and Coulomb friction and offset of every joint, passive ones too, follow.
    """

    def __init__(self, robot: Robot, chi: dict[str, float], drives: bool = False) -> None:
        self.robot, self.tree, self.drives = robot, Pinocchio(robot, chi), drives
        model = self.tree.model
        self.chi = np.concatenate([model.inertias[k].toDynamicParameters() for k in range(1, model.njoints)])
        moved = np.array([joint.actuated for joint in robot.joints])
        self.at, self.actuated = self.tree.joint_q[moved], self.tree.joint_v[moved]
        self.free = np.setdiff1d(np.arange(model.nv), self.actuated)
        self.rows = [slice(0, 3 if closure.kind == "connect" else 6) for closure in robot.closures]

    def home(self) -> np.ndarray:
        y = self.tree.neutral()
        y[self.tree.joint_q] = [joint.home for joint in self.robot.joints]
        return y

    def _constraint(self) -> tuple[np.ndarray, np.ndarray]:
        """Error and Jacobian of the closures at the configuration last given to Pinocchio."""
        model, data, frames = self.tree.model, self.tree.data, self.tree.frames_of_closures
        pin.updateFramePlacements(model, data)
        error, C = [], []
        for rows, a, b in zip(self.rows, frames[::2], frames[1::2], strict=True):
            A, B = data.oMf[a], data.oMf[b]
            gap = A.translation - B.translation
            if rows.stop == 6:
                gap = np.concatenate([gap, pin.log3(A.rotation @ B.rotation.T)])
            error.append(gap)
            C.append((pin.getFrameJacobian(model, data, a, AXES) - pin.getFrameJacobian(model, data, b, AXES))[rows])
        return np.concatenate(error), np.concatenate(C)

    def _close(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        model, data = self.tree.model, self.tree.data
        for _ in range(20):
            pin.computeJointJacobians(model, data, y)
            error, C = self._constraint()
            if np.abs(error).max() < 1e-12:
                return y, C
            step = np.zeros(model.nv)
            C_p = C[:, self.free]
            step[self.free] = -np.linalg.solve(C_p.T @ C_p, C_p.T @ error)
            y = pin.integrate(model, y, step)
        raise ArithmeticError("the loops stay open")

    def __call__(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> Iterator[np.ndarray]:
        """Inertial regressor (n, 10 bodies) of every sample of a path (N, n) that begins near home."""
        model, data = self.tree.model, self.tree.data
        if not self.robot.closures:
            for sample in zip(q, qd, qdd, strict=True):
                yield pin.computeJointTorqueRegressor(model, data, *sample)
            return
        y, J = self.home(), np.zeros((model.nv, len(self.actuated)))
        J[self.actuated] = np.eye(len(self.actuated))
        for goal, velocity, acceleration in zip(q, qd, qdd, strict=True):
            y = y.copy()
            y[self.at] = goal
            y, C = self._close(y)
            C_p = C[:, self.free]
            normal = np.linalg.inv(C_p.T @ C_p) @ C_p.T
            J[self.free] = -normal @ C[:, self.actuated]
            v = J @ velocity
            pin.forwardKinematics(model, data, y, v, np.zeros(model.nv))
            frames = self.tree.frames_of_closures
            drift = [
                (
                    pin.getFrameClassicalAcceleration(model, data, a, AXES).vector
                    - pin.getFrameClassicalAcceleration(model, data, b, AXES).vector
                )[rows]
                for rows, a, b in zip(self.rows, frames[::2], frames[1::2], strict=True)
            ]
            vd = J @ acceleration
            vd[self.free] -= normal @ np.concatenate(drift)
            W = J.T @ pin.computeJointTorqueRegressor(model, data, y, v, vd)
            if self.drives:
                joints = self.tree.joint_v
                effects = np.stack([vd[joints], v[joints], np.sign(v[joints]), np.ones(len(joints))], axis=1)
                W = np.hstack([W, (J[joints].T[:, :, None] * effects).reshape(len(W), -1)])
            yield W


def read_by_hand(log: Path, cutoff: float) -> tuple[np.ndarray, ...]:
    """Positions, velocities, accelerations and commands (N, n) of a log, filtered forwards and backwards by SciPy."""
    from scipy.signal import butter, filtfilt

    table = pl.read_parquet(log)
    time = table["t"].to_numpy()
    q, v = (table.select(name for name in table.columns if name.startswith(kind)).to_numpy() for kind in "qv")
    step = (time[-1] - time[0]) / (len(time) - 1)
    q = filtfilt(*butter(4, min(2 * cutoff * step, 0.99)), q, axis=0)
    qd = np.gradient(q, step, axis=0)
    return q, qd, np.gradient(qd, step, axis=0), v


def with_drives(W: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    """The regressor (N, n, columns) of a serial arm with rotor, friction and offset of each joint."""
    effects = np.stack([qdd, qd, np.sign(qd), np.ones_like(qd)], axis=2)
    drives = np.einsum("tjk,ji->tjik", effects, np.eye(qd.shape[1])).reshape(*qd.shape, -1)
    return np.concatenate([W, drives], axis=2)


def base_columns(W: np.ndarray) -> np.ndarray:
    """Columns of (rows, columns) that do not depend on others, by SciPy's QR with pivoting."""
    from scipy.linalg import qr

    size = np.linalg.norm(W, axis=0)
    R, order = qr(W / np.where(size > 0, size, 1.0), mode="r", pivoting=True)[:2]
    rank = int((np.abs(np.diag(R)) > 1e-7 * abs(R[0, 0])).sum())
    return np.sort(order[:rank])


def gains_by_hand(robot: Robot, folder: Path, mass: float, cutoff: float, factor: int, steps: int) -> np.ndarray:
    """Drive gains (n,) from a run without and one with a mass at the platform, by least squares.

    Then ``steps`` columns are left out, the one of largest relative deviation each time, by an SVD of all rows.
    """
    from scipy.signal import decimate

    loop = PinocchioLoop(robot, random_parameters(robot, np.random.default_rng(1)), drives=True)
    heavy = 10 * int(loop.tree.model.njoints - 2)  # the mass of the platform, the last body
    blocks, n = [], len(robot.actuated)
    for name, load in (("0", 0.0), ("1", mass)):
        q, qd, qdd, v = read_by_hand(folder / f"{name}.parquet", cutoff)
        W = np.array(list(loop(q, qd, qdd)))
        W, v = decimate(W, factor, axis=0), decimate(v, factor, axis=0)
        W, v = W[20:-20], v[20:-20]  # where the filter has begun
        V = np.einsum("tj,ji->tji", v, np.eye(n))
        blocks.append(np.concatenate([V, -W, load * W[:, :, [heavy]]], axis=2))
    total = np.concatenate(blocks).reshape(-1, blocks[0].shape[2])
    some = total[:: max(1, len(total) // 6000), n:-1]
    A, y = total[:, [*range(n), *(n + base_columns(some))]], total[:, -1]
    found, deviation = _least_squares(A, y)
    gains = found[:n]
    for _ in range(steps):
        worst = int((deviation[n:] / np.abs(found[n:])).argmax())
        A = np.delete(A, n + worst, axis=1)
        found, deviation = _least_squares(A, y)
    return gains


def _least_squares(A: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least squares by SVD, and the standard deviations."""
    U, s, Vt = np.linalg.svd(A, full_matrices=False)
    x = Vt.T @ ((U.T @ y) / s)
    sigma = np.linalg.norm(y - A @ x) / np.sqrt(len(y) - len(x))
    return x, sigma * np.linalg.norm(Vt.T / s, axis=1)


class ExcitationByHand:
    """The criterion of an excitation task sample by sample, and its gradient by finite differences."""

    def __init__(self, task: DesignProblem, grid: Grid) -> None:
        self.task, self.grid = task, grid
        robot = task.model.robot
        self.loop = PinocchioLoop(robot, random_parameters(robot, np.random.default_rng(1)))
        order = {kind: k for k, kind in enumerate(("m", "mx", "my", "mz", "xx", "xy", "yy", "xz", "yz", "zz"))}
        bodies = {name: k for k, name in enumerate(robot.bodies)}
        names = (name.split("_", 1) for name in task.base.standard)
        drives = {kind: k for k, kind in enumerate(("ia", "fv", "fs", "off"))}
        self.columns = [
            10 * bodies[body] + order[kind] if kind in order else 10 * len(bodies) + 4 * bodies[body] + drives[kind]
            for kind, body in names
        ]

    def value(self, x: np.ndarray) -> float:
        """Logarithm of the base regressor's condition number."""
        series, parts = self.task.series, []
        for part in x.reshape(-1, series.size):
            numbers = part.reshape(-1, series.free) * series.half[:, None]
            q, qd, qdd = (basis @ numbers.T for basis in self.grid.basis[:3])
            W = with_drives(np.array(list(self.loop(q + series.center, qd, qdd))), qd, qdd)
            n, width = qd.shape[1], self.task.regressor.width
            smooth = qd / np.sqrt(qd**2 + width**2)
            W[:, :, -4 * n :].reshape(len(W), n, n, 4)[:, range(n), range(n), 2] = smooth
            parts.append(W[:, :, self.columns].reshape(-1, len(self.columns)))
        s = np.linalg.svd(np.linalg.qr(np.concatenate(parts), mode="r"), compute_uv=False)
        return float(np.log(s[0] / s[-1]))

    def gradient(self, x: np.ndarray, step: float = 1e-6) -> np.ndarray:
        value = self.value(x)
        return np.array([(self.value(x + step * e) - value) / step for e in np.eye(len(x))])


def figaroh_wls(
    robot: Robot, chi: dict[str, float], folder: Path, cutoff: float, factor: int
) -> Callable[[], tuple[np.ndarray, np.ndarray]] | None:
    """FIGAROH's way from a log's file to torques predicted and measured; None without FIGAROH.

    Filter, derivatives, regressor, base parameters and weighted least squares are its public functions; the columns are
    decimated by SciPy, as in its examples. The board calls its classes.
    """
    if find_spec("figaroh") is None:
        return None

    def work() -> tuple[np.ndarray, np.ndarray]:
        from figaroh.identification.identification_tools import low_pass_filter_data, weigthed_least_squares
        from figaroh.tools.qrdecomposition import QRDecomposer
        from figaroh.tools.regressor import build_regressor_basic, build_regressor_reduced, get_index_eliminate
        from scipy.signal import decimate

        table = pl.read_parquet(folder / "0.parquet")
        time = table["t"].to_numpy()
        step = (time[-1] - time[0]) / (len(time) - 1)
        q, tau = (table.select(name for name in table.columns if name.startswith(kind)).to_numpy() for kind in "qv")
        tree, n = Pinocchio(robot, chi), q.shape[1]
        inertial = ("m", "mx", "my", "mz", "xx", "xy", "yy", "xz", "yz", "zz")
        names = [f"{kind}_{name}" for name in robot.bodies for kind in inertial]
        names += [f"{kind}_{name}" for kind in ("fv", "fs", "ia", "off") for name in robot.actuated]
        settings = {"ts": step, "cut_off_frequency_butterworth": min(4 * cutoff, 1.98 / step), "is_joint_torques": True}
        settings |= {"has_friction": True, "has_actuator_inertia": True, "has_joint_offset": True}
        settings["act_idxv"] = [*range(n)]
        q = low_pass_filter_data(q, settings)
        qd = np.gradient(q, step, axis=0)
        W = build_regressor_basic(tree, q, qd, np.gradient(qd, step, axis=0), settings)  # joint by joint
        W = np.concatenate([decimate(block, factor, axis=0)[20:-20] for block in np.split(W, n)])
        tau = np.concatenate([decimate(column, factor)[20:-20] for column in tau[25:-25].T])
        index, kept = get_index_eliminate(W, dict.fromkeys(names, 0.0), 1e-3)
        W, _, _, phi, *_ = QRDecomposer().double_decomposition(tau, build_regressor_reduced(W, index), kept)
        settings["idx_tau_stop"] = [len(tau) // n * (j + 1) for j in range(n)]
        phi = weigthed_least_squares(tree, phi, W, tau, W @ phi, settings)
        return W @ phi, tau

    return work


def figaroh_regressor(tree: Pinocchio, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray | None:
    """FIGAROH's regressor of a serial arm, joint by joint; None where FIGAROH is not installed."""
    try:
        from figaroh.tools.regressor import build_regressor_basic
    except ImportError:
        return None
    settings = {"is_joint_torques": True, "act_idxv": list(range(tree.nv))}
    return np.asarray(build_regressor_basic(tree, q, qd, qdd, settings))
