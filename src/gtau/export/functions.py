"""Exported functions, as CasADi expressions of :mod:`gtau.model`: nothing is derived twice.

With loops there are two stages: steps of Newton's method bring the configuration ``c`` to the actuated positions, and
everything else is computed from the closed ``c``. A serial robot has ``c = q`` and the second stage alone.

Behind the configuration stand the states z of presliding friction. They follow the positions, so that an update of the
configuration updates them too: ``z <- clip(z + ratios . dq / width, -1, 1)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from gtau.estimation.friction.law import carried
from gtau.export.identified import Identified
from gtau.model.closures import closure_maps
from gtau.model.dynamics import torques
from gtau.model.kinematics import configuration_rates
from gtau.robots.parameter import Parameter

OUTPUTS = {
    "torques": "inverse dynamics: torques of the actuated joints",
    "gravity": "torques that hold the robot against gravity and springs",
    "friction": "torques of friction and offsets, to be compensated",
    "inertia": "inertia matrix of the actuated joints, rotors included",
    "regressor": "regressor W, row by row: torques = W parameters",
}
OBSERVED = {
    "momentum": "generalized momentum M qd",
    "drift": "rate of the momentum without torques of motors and contacts: C^T qd less gravity, springs and friction",
}


@dataclass(frozen=True, eq=False)
class Functions:
    """CasADi functions of one sample, all outputs dense.

    Attributes
    ----------
    outputs : dict
        By the names of ``OUTPUTS`` and ``OBSERVED``: functions of c and z (n_c + s,), qd, qdd (n,) and the parameters
        (n_p,).
    step, last_step : Function, optional
        Configuration after a step of Newton's method and the size of its correction, rad or lengths over
        ``length``; the last one also gives the condition number of the loops. None for a serial robot.
    home : ndarray
        Closed configuration to start from, with states at rest, (n_c + s,).
    actuated : ndarray
        Indices of the actuated joints in c, (n,).
    presliding : tuple
        Of each state, its place behind c: its width, rad or m, and the ratios of actuated joints, by place in c.
    """

    outputs: dict[str, ca.Function]
    step: ca.Function | None
    last_step: ca.Function | None
    home: np.ndarray
    actuated: np.ndarray
    presliding: tuple[tuple[float, dict[int, float]], ...]


def functions(model: Identified) -> Functions:
    """Build the exported functions of an identified model."""
    idm = model.result.model
    layout, loops, n = idm.layout, idm.loops, len(idm.actuated)
    step = last_step = None
    if loops is None:
        c, qd, qdd = (ca.SX.sym(name, n) for name in ("q", "qd", "qdd"))
        yd, ydd, J, home, cd = qd, qdd, ca.SX.eye(n), layout.home, qd
    else:
        maps = closure_maps(layout)
        c, qd, qdd, yd, ydd, J, home = maps.c, maps.qd, maps.qdd, maps.yd, maps.ydd, maps.J, loops.home
        cd = configuration_rates(layout, c, yd)
        step = _function("step", [c], [maps.moved, maps.size])
        last_step = _function("last_step", [c], [maps.moved, maps.size, maps.condition])
    p = ca.SX.sym("p", len(model.parameters))
    base, chi = model.result.base, ca.vertsplit(p[: model.result.base.count])
    load = torques(layout, c, yd, ydd, J, _standard(model, carried(ca, base.standard, chi)))
    law = model.result.friction_law
    z = ca.SX.sym("z", len(law.states))
    friction = _Friction(model, p, yd, J, z)
    rubbing = friction(load)
    coasting = ca.substitute(load, qdd, ca.SX.zeros(n))
    still = ca.substitute(coasting, qd, ca.SX.zeros(n))
    # dp/dt = M qdd + M' qd, and M' qd - C qd = C^T qd = d(qd^T M qd / 2)/dq: M' is exact along the closed loops too
    momentum = ca.jtimes(load, qdd, qd)
    turning = ca.jtimes(momentum, c, cd)
    made = {
        "torques": load + rubbing,
        "gravity": still,
        "friction": rubbing,
        "inertia": ca.jacobian(load, qdd),
        "regressor": friction.regressor(load),
        "momentum": momentum,
        "drift": turning - coasting - friction(coasting),
    }
    outputs = {
        name: _function(name, [ca.vertcat(c, z), qd, qdd, p], [value.T]) for name, value in made.items()
    }  # row by row
    presliding = tuple(
        (float(width), {int(layout.actuated[j]): float(law.ratios[row, j]) for j in np.flatnonzero(law.ratios[row])})
        for row, width in zip(law.states, law.widths, strict=True)
    )
    home = np.concatenate([home, np.zeros(len(presliding))])
    return Functions(outputs, step, last_step, home, layout.actuated, presliding)


def _function(name: str, inputs: list[ca.SX], outputs: list[ca.SX]) -> ca.Function:
    return ca.Function(name, inputs, [ca.densify(each) for each in outputs], {"cse": True})


def _standard(model: Identified, chi: list[ca.SX]) -> dict[str, ca.SX]:
    """Choose standard parameters with the same torques: base parameters at their representatives, else zero."""
    standard = {name: ca.SX(1, 1) for name in model.result.model.parameter_names}
    return standard | dict(zip(model.result.base.standard, chi, strict=True))


@dataclass(frozen=True, eq=False)
class _Friction:
    """Torques of friction and offsets by :class:`gtau.estimation.friction.law.FrictionLaw`, of parameters p."""

    model: Identified
    p: ca.SX
    yd: ca.SX
    J: ca.SX
    z: ca.SX

    def __call__(self, load: ca.SX) -> ca.SX:
        forces, scales = self._scaled(load)
        return self._on_motors(forces, scales)

    def regressor(self, load: ca.SX) -> ca.SX:
        """Build ``W`` (n, n_p) with ``load + friction = W p``: load-dependent friction and scales take those of p."""
        _, scales = self._scaled(load)
        frozen, at = ca.SX.sym("load", load.shape[0]), ca.SX.sym("scales", scales.shape[0])
        columns = ca.jacobian(self._on_motors(self._scaled(frozen)[0], at), self.p)
        return ca.jacobian(load, self.p) + ca.substitute(ca.substitute(columns, frozen, load), at, scales)

    @property
    def _values(self) -> dict[str, ca.SX]:
        names = (*self.model.result.base.standard, *self.model.terms)
        return dict(zip(names, ca.vertsplit(self.p), strict=True))

    def _scaled(self, load: ca.SX) -> tuple[ca.SX, ca.SX]:
        law = self.model.result.friction_law
        forces, speeds = (ca.densify(ca.vertcat(*each)) for each in law.forces(ca, self._values, self.yd, load))
        scales = law.scales(ca, forces, speeds)
        if law.states:
            z = law.directions(ca, self.yd, self.z)
            forces = ca.densify(ca.vertcat(*law.forces(ca, self._values, self.yd, load, z)[0]))
        return forces, scales

    def _on_motors(self, forces: ca.SX, scales: ca.SX) -> ca.SX:
        joints = self.model.result.robot.joints
        offsets = ca.vertcat(*(self._values.get(Parameter("off", joint.name).name, 0.0) for joint in joints))
        acting = forces * scales
        return self.J[: len(joints), :].T @ (acting[: len(joints)] + offsets) + acting[len(joints) :]
