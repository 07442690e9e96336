"""The functions that are exported, as CasADi expressions of :mod:`gtau.model`: nothing is derived twice.

Where the loops are, two stages: steps of Newton's method bring the configuration ``c`` to the actuated positions, and
everything else is computed from the closed ``c``. A serial robot has ``c = q`` and the second stage alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from gtau.estimation.regression.friction import transmitted
from gtau.export.identified import Identified
from gtau.model.closures import closure_maps
from gtau.model.dynamics import torques

OUTPUTS = {
    "torques": "inverse dynamics: torques of the actuated joints",
    "gravity": "torques that hold the robot against gravity and springs",
    "friction": "torques of friction and offsets, to be compensated",
    "inertia": "inertia matrix of the actuated joints, rotors included",
    "regressor": "regressor W, row by row: torques = W parameters",
}


@dataclass(frozen=True, eq=False)
class Functions:
    """CasADi functions of a sample, all outputs dense.

    Attributes
    ----------
    outputs : dict
        By the names of ``OUTPUTS``: functions of c (n_c,), qd, qdd (n,) and the parameters (n_p,).
    step, last_step : Function, optional
        Configuration after a step of Newton's method and the size of its correction, rad or lengths over
        ``length``; the last one also gives the condition number of the loops. None for a serial robot.
    home : ndarray
        Closed configuration (n_c,) to start from.
    actuated : ndarray
        Where the actuated joints stand in c, (n,).
    """

    outputs: dict[str, ca.Function]
    step: ca.Function | None
    last_step: ca.Function | None
    home: np.ndarray
    actuated: np.ndarray


def functions(model: Identified) -> Functions:
    """Build the exported functions of an identified model."""
    idm = model.result.model
    layout, loops, n = idm.layout, idm.loops, len(idm.actuated)
    step = last_step = None
    if loops is None:
        c, qd, qdd = (ca.SX.sym(name, n) for name in ("q", "qd", "qdd"))
        yd, ydd, J, home = qd, qdd, ca.SX.eye(n), layout.home
    else:
        maps = closure_maps(layout)
        c, qd, qdd, yd, ydd, J, home = maps.c, maps.qd, maps.qdd, maps.yd, maps.ydd, maps.J, loops.home
        step = _function("step", [c], [maps.moved, maps.size])
        last_step = _function("last_step", [c], [maps.moved, maps.size, maps.condition])
    p = ca.SX.sym("p", len(model.parameters))
    base = model.result.base
    whole, load = (
        torques(layout, c, yd, ydd, J, _standard(model, p[: base.count] * weight))
        for weight in (np.ones(base.count), transmitted(base.names))
    )
    whole = whole + _terms(model, p, qd, load)
    still = ca.substitute(ca.substitute(load, qd, ca.SX.zeros(n)), qdd, ca.SX.zeros(n))
    made = {
        "torques": whole,
        "gravity": still,
        "friction": whole - load,
        "inertia": ca.jacobian(load, qdd),
        "regressor": _regressor(model, whole, load, p, qd),
    }
    outputs = {name: _function(name, [c, qd, qdd, p], [value.T]) for name, value in made.items()}  # row by row
    return Functions(outputs, step, last_step, home, layout.actuated)


def _function(name: str, inputs: list[ca.SX], outputs: list[ca.SX]) -> ca.Function:
    return ca.Function(name, inputs, [ca.densify(each) for each in outputs], {"cse": True})


def _standard(model: Identified, chi: ca.SX) -> dict[str, ca.SX]:
    """Choose standard parameters of the same torques: base parameters in the places of those they keep, else zero."""
    standard = {name: ca.SX(1, 1) for name in model.result.model.parameter_names}
    return standard | dict(zip(model.result.base.standard, ca.vertsplit(chi), strict=True))


def _terms(model: Identified, p: ca.SX, qd: ca.SX, load: ca.SX) -> ca.SX:
    """Sum the friction beyond viscous and Coulomb: ``f3 qd^3 + fl |load| sign(qd)`` and their like."""
    tau = ca.SX(len(model.joints), 1)
    for k, name in enumerate(model.terms, start=model.result.base.count):
        kind, joint = name.split("_", 1)
        j = model.joints.index(joint)
        tau[j] += p[k] * (qd[j] ** 3 if kind == "f3" else ca.fabs(load[j]) * ca.sign(qd[j]))
    return tau


def _regressor(model: Identified, whole: ca.SX, load: ca.SX, p: ca.SX, qd: ca.SX) -> ca.SX:
    """Build ``W`` (n, n_p) with ``whole = W p``; load-dependent friction takes the load of ``p``."""
    base = model.result.base.count
    linear = whole - _terms(model, p, qd, load)
    columns = [ca.jacobian(linear, p[:base])] if base else []
    frozen = ca.SX.sym("load", load.shape[0])
    columns.append(ca.substitute(ca.jacobian(_terms(model, p, qd, frozen), p[base:]), frozen, load))
    return ca.horzcat(*columns)
