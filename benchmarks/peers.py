"""What the benchmarks compare with: the same work by Pinocchio in a Python loop, as one would write it by hand.

The loops are closed by Newton's method from the sample before, with Pinocchio's frames; the regressor of the tree is
Pinocchio's, projected by NumPy.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pinocchio as pin

from idim.robots.robot import Robot

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from engines import Pinocchio, random_parameters

__all__ = ["PinocchioLoop", "figaroh_regressor", "random_parameters"]
AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


class PinocchioLoop:
    """Regressor of a robot whose inertial parameters are ``chi``, sample by sample."""

    def __init__(self, robot: Robot, chi: dict[str, float]) -> None:
        self.robot, self.tree = robot, Pinocchio(robot, chi)
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
            yield J.T @ pin.computeJointTorqueRegressor(model, data, y, v, vd)


def figaroh_regressor(tree: Pinocchio, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray | None:
    """FIGAROH's regressor of a serial arm, joint by joint; None where FIGAROH is not installed."""
    try:
        from figaroh.tools.regressor import build_regressor_basic
    except ImportError:
        return None
    settings = {"is_joint_torques": True, "act_idxv": list(range(tree.nv))}
    return np.asarray(build_regressor_basic(tree, q, qd, qdd, settings))
