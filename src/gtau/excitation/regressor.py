"""The regressor with smooth Coulomb friction, and derivatives of anything linear in it carried back to the motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from gtau.excitation.closure_gradients import Slopes
from gtau.model.dynamics import torques
from gtau.model.interpreter.program import Program, compile_program
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.loops import Motion


@dataclass(frozen=True, eq=False)
class SmoothRegressor:
    """Chosen standard columns; Coulomb friction acts as ``v / sqrt(v^2 + width^2)`` instead of ``sign(v)``.

    ``width`` (n_joints,) in rad/s or m/s. The other attributes are as in
    :class:`gtau.model.inverse_dynamics.Regressor`; ``back`` gives the slopes of a weighted sum of the entries.
    """

    model: InverseDynamics
    names: tuple[str, ...]
    width: np.ndarray
    program: Program
    back: Program
    rows: np.ndarray
    columns: np.ndarray

    def __call__(self, motion: Motion) -> np.ndarray:
        """Evaluate the columns of every actuated joint's row, (n, N, columns)."""
        entries = self.program(self._inputs(motion))
        W = np.zeros((len(self.model.actuated), entries.shape[1], len(self.names)))
        W[self.rows, :, self.columns] = entries
        return W

    def slopes(self, motion: Motion, weights: np.ndarray) -> Slopes:
        """Differentiate ``sum(weights * W)`` a sample, weights (n, N, columns)."""
        layout, samples = self.model.layout, motion.c.shape[1]
        found = self.back(np.vstack([self._inputs(motion), weights[self.rows, :, self.columns]]))
        c, yd, ydd, J = np.split(found, np.cumsum([layout.n_c, layout.n_y, layout.n_y]))
        return Slopes(c, yd, ydd, J.reshape(len(layout.passive), len(layout.actuated), samples))

    def _inputs(self, motion: Motion) -> np.ndarray:
        layout, samples = self.model.layout, motion.c.shape[1]
        J = motion.J[layout.passive].reshape(len(layout.passive) * len(layout.actuated), samples)
        width = np.broadcast_to(self.width[:, None], (len(self.width), samples))
        return np.vstack([motion.c, motion.yd, motion.ydd, J, width])


def smooth_regressor(model: InverseDynamics, names: Sequence[str], width: np.ndarray) -> SmoothRegressor:
    """Compile the columns ``names`` of a robot's regressor and the way back through them."""
    layout, n = model.layout, len(model.actuated)
    joints = layout.robot.joints
    sizes = (("c", layout.n_c), ("yd", layout.n_y), ("ydd", layout.n_y), ("width", len(joints)))
    c, yd, ydd, wide = (ca.SX.sym(s, k) for s, k in sizes)
    passive = ca.SX.sym("J", len(layout.passive), n)
    J = ca.SX(layout.n_y, n)
    for k, row in enumerate(layout.actuated):
        J[int(row), k] = 1
    for k, row in enumerate(layout.passive):
        J[int(row), :] = passive[k, :]
    chi = {name: ca.SX.sym(name) for name in model.parameter_names}
    tau = torques(layout, c, yd, ydd, J, {name: each for name, each in chi.items() if not name.startswith("fs_")})
    for k, joint in enumerate(joints):
        if f"fs_{joint.name}" in chi:
            tau += J[k, :].T * chi[f"fs_{joint.name}"] * yd[k] / ca.sqrt(yd[k] ** 2 + wide[k] ** 2)
    W = ca.jacobian(tau, ca.vertcat(*(chi[name] for name in names)))
    rows, columns = (np.array(index, dtype=int) for index in W.sparsity().get_triplet())
    entries = ca.vec(W.nz[:])
    weights = ca.SX.sym("weights", entries.numel())
    inputs = [c, yd, ydd, passive.T, wide]
    back = ca.gradient(ca.dot(weights, entries), ca.veccat(c, yd, ydd, passive.T))
    return SmoothRegressor(
        model,
        tuple(names),
        width,
        compile_program(inputs, [entries]),
        compile_program([*inputs, weights], [back]),
        rows,
        columns,
    )
