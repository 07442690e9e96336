"""Gradients through closed loops by the adjoint method, and a regressor with smooth Coulomb friction.

:mod:`gtau.model.loops` solves the closures numerically. This module converts derivatives with respect to the
configuration c, yd, ydd and J of the whole robot into derivatives with respect to q, qd and qdd of its motors. Each of
the equations

    phi(c) = 0,    G yd = 0,    G J = 0,    G ydd + gamma = 0

has a multiplier that eliminates the passive coordinates. A gradient therefore takes one linear solve per sample and
equation, whatever the number of trajectory parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import scipy.linalg

from gtau.errors import GtauError
from gtau.model.closures import closure_expressions
from gtau.model.dynamics import torques
from gtau.model.inverse_dynamics import InverseDynamics, Regressor
from gtau.model.kinematics import Coordinates, configuration_rates, constant
from gtau.model.loops import Motion
from gtau.model.program import Program, compile_program
from gtau.robots.geometry import moved_ends
from gtau.robots.parameter import Parameter
from gtau.robots.placement import compose
from gtau.robots.robot import GROUND, ROTATIONS, TRANSLATIONS, Attachment, Joint, Limits, Pose, Robot


@dataclass(frozen=True, eq=False)
class Slopes:
    """Derivatives of one scalar per sample by c (n_c, N), yd, ydd (n_y, N) and the passive rows of J (n_p, n, N)."""

    c: np.ndarray
    yd: np.ndarray
    ydd: np.ndarray
    J: np.ndarray

    @classmethod
    def by_configuration(cls, by_c: np.ndarray, motion: Motion, layout: Coordinates) -> Slopes:
        """Add zero derivatives to the derivatives of a function of c."""
        zero = np.zeros_like(motion.yd)
        return cls(by_c, zero, zero, np.zeros_like(motion.J[layout.passive]))


@dataclass(frozen=True, eq=False)
class Pullback:
    """Conversion of derivatives by c, yd, ydd and J into derivatives by q, qd and qdd; see :func:`pullback`.

    ``rows`` are the independent rows of the scaled ``G``. ``by_yd`` and ``by_c`` are gradients of the equations
    weighted with multipliers, ``passive_gradient`` is the gradient of the weighted passive columns of ``G``.
    """

    layout: Coordinates
    rows: np.ndarray
    G: Program
    by_yd: Program
    by_c: Program
    passive_gradient: Program

    def __call__(self, motion: Motion, slopes: Slopes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return derivatives by q, qd and qdd of the actuated joints, (n, N) each."""
        layout, samples = self.layout, motion.c.shape[1]
        a, p = layout.actuated, layout.passive
        G = self.columns(motion.c)[self.rows] / layout.unit[:, None]
        G_a, inverse = G[:, a], np.linalg.inv(G[:, p].transpose(2, 1, 0))  # (N, n_p, n_p)

        def multiplier(slope: np.ndarray) -> np.ndarray:
            return -np.einsum("sij,j...s->i...s", inverse, slope)

        on_acceleration = multiplier(slopes.ydd[p])
        on_J = multiplier(slopes.J)
        J = motion.J[p].reshape(-1, samples)
        by_yd = slopes.yd + self.by_yd(motion.c, motion.yd, motion.ydd, on_acceleration)
        on_velocity = multiplier(by_yd[p])
        multipliers = on_acceleration, on_velocity, on_J.reshape(-1, samples)
        by_y = self.by_c(motion.c, motion.yd, motion.ydd, J, *multipliers, slopes.c)
        return tuple(
            slope + np.einsum("ias,is->as", G_a, on)
            for slope, on in ((by_y[a], multiplier(by_y[p])), (by_yd[a], on_velocity), (slopes.ydd[a], on_acceleration))
        )

    def columns(self, c: np.ndarray) -> np.ndarray:
        """Evaluate all rows of the scaled ``G``, (rows, n_y, N)."""
        return self.G(c).reshape(-1, self.layout.n_y, c.shape[1])

    def condition(self, motion: Motion) -> tuple[np.ndarray, Slopes]:
        """Evaluate log sqrt(trace(M) trace(M^-1)), M = G_p^T G_p, which is large near singularities, and its slopes."""
        G = self.columns(motion.c)[:, self.layout.passive]
        M = np.einsum("ips,iqs->spq", G, G)
        inverse = np.linalg.inv(M)
        size, spread = np.trace(M, axis1=1, axis2=2), np.trace(inverse, axis1=1, axis2=2)
        # d(log)/dG = G / trace(M) - G M^-2 / trace(M^-1)
        by_G = G / size - np.einsum("ips,spq->iqs", G, inverse @ inverse) / spread
        by_c = self.passive_gradient(motion.c, by_G.reshape(-1, len(size)))
        return np.log(size * spread) / 2, Slopes.by_configuration(by_c, motion, self.layout)


def pullback(model: InverseDynamics) -> Pullback | None:
    """Compile the conversion of derivatives; None for a robot without closures, where y = q."""
    loops, layout = model.loops, model.layout
    if loops is None:
        return None
    n, passive = len(layout.actuated), layout.passive.tolist()
    c, yd, ydd = (ca.SX.sym(s, k) for s, k in (("c", layout.n_c), ("yd", layout.n_y), ("ydd", layout.n_y)))
    _, velocity, gamma = closure_expressions(layout, c, yd)
    G = ca.jacobian(velocity, yd)
    scaled = G @ constant(np.diag(layout.unit))
    G_program = compile_program([c], [scaled.T])
    at_home = G_program(loops.home[:, None]).reshape(-1, layout.n_y)
    _, _, order = scipy.linalg.qr(at_home[:, passive].T, pivoting=True, mode="economic")
    rows = np.sort(order[: len(passive)])

    G_rows = G[rows.tolist(), :]
    acceleration = G_rows @ ydd + gamma[rows.tolist()]
    on_a, on_v = ca.SX.sym("on_a", len(rows)), ca.SX.sym("on_v", len(rows))
    on_J, J = ca.SX.sym("on_J", len(passive), n), ca.SX.sym("J", len(passive), n)
    slope_c = ca.SX.sym("slope_c", layout.n_c)
    weighted = ca.dot(on_a, acceleration) + ca.dot(on_v, velocity[rows.tolist()]) + ca.dot(slope_c, c)
    for k in range(n):
        column = ca.SX(layout.n_y, 1)
        column[int(layout.actuated[k])] = 1
        column[passive] = J[:, k]
        weighted += ca.dot(on_J[:, k], G_rows @ column)
    by_G = ca.SX.sym("by_G", G.shape[0], len(passive))
    by_passive = ca.gradient(ca.dot(by_G, scaled[:, passive]), c)
    v, by_c = ca.SX.sym("v", layout.n_y), ca.gradient(weighted, c)
    by_displacement = ca.gradient(ca.dot(configuration_rates(layout, c, v), by_c), v)
    # NumPy arrays are in row order, CasADi matrices in column order
    return Pullback(
        layout,
        rows,
        G_program,
        compile_program([c, yd, ydd, on_a], [ca.gradient(ca.dot(on_a, acceleration), yd)]),
        compile_program([c, yd, ydd, J.T, on_a, on_v, on_J.T, slope_c], [by_displacement]),
        compile_program([c, by_G.T], [by_passive]),
    )


def in_platform_space(robot: Robot) -> Robot:
    """Build the robot driven by its platform: platform coordinates become actuated joints, motor joints passive.

    The closure equations then give the inverse kinematics. The platform becomes the last link of a chain of prismatic
    and revolute joints along the base axes.
    """
    if len(robot.platforms) != 1:
        raise GtauError(
            f"robot '{robot.name}' has {len(robot.platforms) or 'no'} platforms; a motion in platform space needs one, "
            "so give the motion in joint space."
        )
    platform = robot.platforms[0]
    turns = [dof for dof in ROTATIONS if dof in platform.dof]
    order = [dof for dof in TRANSLATIONS if dof in platform.dof] + turns[::-1]
    chain, before = [], GROUND
    for k, dof in enumerate(order):
        last = k == len(order) - 1
        axis = tuple(float(axis == dof[-1]) for axis in TRANSLATIONS)
        kind = "prismatic" if dof in TRANSLATIONS else "revolute"
        name = platform.name if last else f"{dof} of {platform.name}"
        # position at home first, orientation last, so that the axes are base axes
        placement = Pose(platform.home.xyz if k == 0 else (0.0, 0.0, 0.0))
        chain.append(Joint(name, before, kind, placement, axis, True, 0.0, Limits(), "none"))  # type: ignore[arg-type]
        before = name
    held = Pose(rpy=platform.home.rpy)

    def moved(end: Attachment) -> Attachment:
        return end if end.body != platform.name else replace(end, placement=compose(held, end.placement))

    return replace(
        robot,
        joints=(*chain, *(replace(joint, actuated=False) for joint in robot.joints)),
        platforms=(),
        springs=(),  # they do not enter the closure equations
        closures=moved_ends(robot, moved)[0],
    )


@dataclass(frozen=True, eq=False)
class SmoothRegressor:
    """Columns of a robot's regressor with smooth Coulomb friction; ``back`` is the gradient of their weighted sum."""

    layout: Coordinates
    entries: Regressor
    back: Program
    width: np.ndarray  # (joints,) rad/s or m/s, speed range in which Coulomb friction changes its sign

    def __call__(self, motion: Motion) -> np.ndarray:
        """Evaluate the columns in the rows of all actuated joints, (n, N, columns)."""
        entries = self.entries.program(*self._inputs(motion))
        W = np.zeros((len(self.layout.actuated), entries.shape[1], len(self.entries.names)))
        W[self.entries.rows, :, self.entries.columns] = entries
        return W

    def slopes(self, motion: Motion, weights: np.ndarray) -> Slopes:
        """Differentiate ``sum(weights * W)`` of every sample, weights (n, N, columns)."""
        layout, weights = self.layout, weights[self.entries.rows, :, self.entries.columns]
        slopes = self.back(*self._inputs(motion), weights)
        c, yd, ydd, J = np.split(slopes, np.cumsum([layout.n_c, layout.n_y, layout.n_y]))
        return Slopes(c, yd, ydd, J.reshape(motion.J[layout.passive].shape))

    def _inputs(self, motion: Motion) -> tuple[np.ndarray, ...]:
        width = np.broadcast_to(self.width[:, None], (len(self.width), motion.c.shape[1]))
        return *self.entries.sources(self.layout, motion), width


def smooth_regressor(model: InverseDynamics, names: Sequence[Parameter], width: np.ndarray) -> SmoothRegressor:
    """Compile columns of a regressor and their gradient, with Coulomb friction ``v / sqrt(v^2 + width^2)``."""
    inputs, J = model.symbols
    (c, yd, ydd, passive), wide = inputs, ca.SX.sym("width", len(model.robot.joints))
    chi = {name: ca.SX.sym(name) for name in model.parameter_names}
    tau = torques(model.layout, c, yd, ydd, J, {name: value for name, value in chi.items() if name.kind != "fs"})
    for k, joint in enumerate(model.robot.joints):
        if Parameter("fs", joint.name) in chi:
            tau += J[k, :].T * chi[Parameter("fs", joint.name)] * yd[k] / ca.sqrt(yd[k] ** 2 + wide[k] ** 2)
    inputs = [*inputs, wide]
    entries = Regressor(tuple(names), inputs, ca.jacobian(tau, ca.vertcat(*(chi[name] for name in names))))
    values = ca.vec(entries.matrix.nz[:])
    weights = ca.SX.sym("weights", values.numel())
    back = ca.gradient(ca.dot(weights, values), ca.veccat(c, yd, ydd, passive))
    return SmoothRegressor(model.layout, entries, compile_program([*inputs, weights], [back]), width)
