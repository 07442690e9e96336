"""Equations of an identified model: terms of its dynamics, and torques in Python and as CasADi functions for exports.

The functions are expressions of :mod:`gtau.model`: nothing is derived twice. With loops there are two stages: steps of
Newton's method bring the configuration ``c`` to the actuated positions, and everything else is computed from the closed
``c``. A serial robot has ``c = q`` and the second stage alone.

Behind the configuration stand the states z of presliding friction. Where they begin at rest they follow the positions,
so that an update of the configuration updates them too: ``z <- clip(z + ratios . dq / width, -1, 1)``. At home they are
``SLIDING``, and stay so: friction then follows from the given velocity, whatever came before.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from gtau.documents.files import identifier
from gtau.estimation.friction.law import transmitted
from gtau.estimation.regression.rows import SLOPES
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.result import IdentifiedModel
from gtau.model import equations
from gtau.model.equations import closed_motion, newton_step
from gtau.model.inverse_dynamics import one_or_many
from gtau.model.kinematics import configuration_rates
from gtau.model.loops import Motion
from gtau.robots.parameter import SHAPES, TEMPERATURE_TERMS, Parameter, parameter_of, torque_unit
from gtau.robots.robot import DAMPING, PLAIN_FRICTION
from gtau.signals.reading.statements import Payload
from gtau.uses.prediction import loaded_parameters, on_tool, require_all_parameters, torques_along

SLIDING = 2.0  # beyond every state: the joint slides, its friction has the sign of the velocity
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
class Identified:
    """Model from which torques are computed: its identification, and the robot's ``name`` as an identifier of C.

    ``parameters`` are the base parameters, with friction as the model predicts it, then the friction terms f3, fb, fl;
    ``payloads`` the values of all (n_p,) with each payload, by name. ``gains`` (n,) are N m/A or N per A, torque scales
    where the logs hold torques; ``units`` of the actuated joints ``N m`` or ``N``.
    """

    result: IdentifiedModel
    name: str
    parameters: tuple[Estimate, ...]
    payloads: Mapping[str, np.ndarray]
    gains: np.ndarray
    units: tuple[str, ...]

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the actuated joints, in order."""
        return self.result.robot.actuated

    @property
    def values(self) -> np.ndarray:
        """Values (n_p,) of the parameters, zero where not identifiable."""
        return np.array([parameter.value or 0.0 for parameter in self.parameters])

    @property
    def friction(self) -> tuple[Parameter, ...]:
        """Names of all friction parameters, base parameters among them by their standard names."""
        return (*[name for name in self.result.base.standard if name.kind in PLAIN_FRICTION], *self.terms)

    @property
    def terms(self) -> tuple[Parameter, ...]:
        """Names of the friction terms among the parameters (``fl_11``)."""
        return tuple(parameter_of(parameter.name) for parameter in self.parameters[self.result.base.count :])


def identified(result: IdentifiedModel) -> Identified:
    """Collect the data of a result for exports of torques; raises GtauError where it lacks a base parameter."""
    require_all_parameters(result)
    robot = result.robot
    terms = [term for name, term in result.friction.items() if name.kind not in (*TEMPERATURE_TERMS, *SHAPES)]
    parameters = (*(result.parameters[name] for name in result.base.names), *terms)
    units = tuple(torque_unit(robot, joint) for joint in robot.actuated)
    payloads = {}
    for name, weighed in result.payload_values.items():
        if "m" in weighed:
            payloads[name] = np.array([parameter.value or 0.0 for parameter in parameters])
            payloads[name][: result.base.count] += on_tool(result, weighed)
    return Identified(result, identifier(robot.name), parameters, payloads, result.gains, units)


def torques_of(model: Identified, motion: Motion, values: np.ndarray, z: np.ndarray | None = None) -> np.ndarray:
    """Compute torques (n, N) of a motion, friction included, at states z (s, N) of presliding; sliding without them."""
    base = model.result.base
    names = (*base.standard, *model.terms)
    terms = {name: value for name, value in zip(names, values, strict=True) if name in model.friction}
    return torques_along(model.result, motion, values[: base.count], terms, z)


def notes_on(model: Identified) -> tuple[str, ...]:
    """Note parameters without a value, and friction extrapolated beyond the logged speeds."""
    result = model.result
    lost = [name for name, estimate in result.parameters.items() if estimate.value is None]
    notes = [f"not identifiable from the logs and exported as zero: {', '.join(lost)}"] if lost else []
    bent = [name for name in model.terms if name.kind in SLOPES]
    values = dict(zip((*result.base.names, *model.terms), model.values, strict=True))
    bent += [name for name, value in values.items() if name.kind == "fv" and value < 0]
    joints = dict.fromkeys(name.body for name in bent)
    above = [f"{joint} above {result.friction_law.logged(joint)}" for joint in joints if joint in result.robot.actuated]
    if above:
        notes.append(
            f"friction is extrapolated beyond the logged speeds along its slope there, or held: {', '.join(above)}"
        )
    return tuple(notes)


@dataclass(frozen=True, eq=False)
class Functions:
    """CasADi functions of one sample, all outputs dense.

    ``outputs``, named as ``OUTPUTS`` and ``OBSERVED``, take c and z (n_c + s,), qd, qdd (n,) and the parameters (n_p,).
    ``step`` gives c after a step of Newton's method and the size of its correction, ``last_step`` also the condition
    number of the loops; None for a serial robot. ``home`` (n_c + s,) is where to start, ``actuated`` (n,) the places of
    the actuated joints in c. ``presliding`` has of each state its width, and ratios of joints by place in c.
    """

    outputs: dict[str, ca.Function]
    step: ca.Function | None
    last_step: ca.Function | None
    home: np.ndarray
    actuated: np.ndarray
    presliding: tuple[tuple[float, dict[int, float]], ...]


def functions(model: Identified) -> Functions:
    """Build the exported functions of an identified model."""
    idm = model.result.idm
    layout, loops, n = idm.layout, idm.loops, len(idm.actuated)
    step = last_step = None
    if loops is None:
        c, qd, qdd = (ca.SX.sym(name, n) for name in ("q", "qd", "qdd"))
        yd, ydd, J, home, cd = qd, qdd, ca.SX.eye(n), layout.home, qd
    else:
        (c, qd, qdd), (_, yd, ydd, J) = closed_motion(layout)
        home, cd = loops.home, configuration_rates(layout, c, yd)
        start, stepped = newton_step(layout)
        step = _function("step", [start], stepped[:2])
        last_step = _function("last_step", [start], stepped[:3])
    p = ca.SX.sym("p", len(model.parameters))
    base = model.result.base
    chi = ca.vertsplit(p[: model.result.base.count])
    # standard parameters with the same torques: base parameters at their representatives, else zero
    standard = {name: ca.SX(1, 1) for name in idm.parameter_names}
    standard |= dict(zip(base.standard, transmitted(ca, base.standard, chi), strict=True))
    load = equations.torques(layout, c, yd, ydd, J, standard)
    law = model.result.friction_law
    z = ca.SX.sym("z", len(law.states))
    friction, regressor = _friction(model, p, yd, J, z)
    friction_torque = friction(load)
    coasting = ca.substitute(load, qdd, ca.SX.zeros(n))
    still = ca.substitute(coasting, qd, ca.SX.zeros(n))
    # dp/dt = M qdd + M' qd, and M' qd - C qd = C^T qd = d(qd^T M qd / 2)/dq: M' is exact along the closed loops too
    momentum = ca.jtimes(load, qdd, qd)
    turning = ca.jtimes(momentum, c, cd)
    made = {
        "torques": load + friction_torque,
        "gravity": still,
        "friction": friction_torque,
        "inertia": ca.jacobian(load, qdd),
        "regressor": regressor(load),
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
    home = np.concatenate([home, np.full(len(presliding), SLIDING)])
    return Functions(outputs, step, last_step, home, layout.actuated, presliding)


def _function(name: str, inputs: list[ca.SX], outputs: list[ca.SX]) -> ca.Function:
    return ca.Function(name, inputs, [ca.densify(output) for output in outputs], {"cse": True})


def _friction(
    model: Identified, p: ca.SX, yd: ca.SX, J: ca.SX, z: ca.SX
) -> tuple[Callable[[ca.SX], ca.SX], Callable[[ca.SX], ca.SX]]:
    law, joints = model.result.friction_law, model.result.robot.joints
    names = (*model.result.base.standard, *model.terms)
    values: dict[str, ca.SX] = dict(zip(names, ca.vertsplit(p), strict=True))
    offsets = ca.vertcat(*(values.get(Parameter("off", joint.name), 0.0) for joint in joints))

    def scaled(load: ca.SX) -> tuple[ca.SX, ca.SX]:
        forces, speeds = (ca.densify(ca.vertcat(*rows)) for rows in law.forces(ca, values, yd, load))
        scales = law.scales(ca, forces, speeds)
        if law.states:
            slides = z > 1.0
            moving = ca.vertcat(*(ca.sign(yd[row]) for row in law.states))
            directions = law.directions(ca, yd, slides * moving + (1.0 - slides) * z)
            forces = ca.densify(ca.vertcat(*law.forces(ca, values, yd, load, directions)[0]))
        return forces, scales

    def on_motors(forces: ca.SX, scales: ca.SX) -> ca.SX:
        acting = forces * scales
        return J[: len(joints), :].T @ (acting[: len(joints)] + offsets) + acting[len(joints) :]

    def regressor(load: ca.SX) -> ca.SX:
        """Build ``W`` (n, n_p) with ``load + friction = W p``: load-dependent friction and scales are in p."""
        _, scales = scaled(load)
        frozen = ca.SX.sym("load", load.shape[0])
        at = ca.SX.sym("scales", scales.shape[0])
        columns = ca.jacobian(on_motors(scaled(frozen)[0], at), p)
        return ca.jacobian(load, p) + ca.substitute(ca.substitute(columns, frozen, load), at, scales)

    return lambda load: on_motors(*scaled(load)), regressor


Torques = Callable[[np.ndarray, np.ndarray], np.ndarray]


def _torques_at(result: IdentifiedModel, q: np.ndarray, payload: Payload | None) -> tuple[Torques, np.ndarray]:
    """Return the function from ``qd`` and ``qdd`` (n, N) to torques (n, N) at ``q`` (N, n), and the torques at rest."""
    model, standard = result.idm, result.base.standard
    lossy = [name.kind in (*PLAIN_FRICTION, DAMPING) for name in standard]
    chi = np.where(lossy, 0.0, loaded_parameters(result, payload, "the robot"))
    (positions,) = model.samples(q)
    c, columns = model.path(positions), model.columns(standard)

    def torques(qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        return columns.torques_along(model.layout, model.rates(c, qd, qdd), chi)

    still = np.zeros_like(positions)
    return torques, torques(still, still)


@one_or_many
def gravity(result: IdentifiedModel, q: np.ndarray, payload: Payload | None) -> np.ndarray:
    """Compute the torques of gravity and springs; see :meth:`gtau.Result.gravity`."""
    return _torques_at(result, q, payload)[1].T


@one_or_many
def inertia(result: IdentifiedModel, q: np.ndarray, payload: Payload | None) -> np.ndarray:
    """Compute the inertia matrix; see :meth:`gtau.Result.inertia`."""
    torques, rest = _torques_at(result, q, payload)
    still = np.zeros_like(rest)
    columns = [torques(still, still + unit) - rest for unit in np.eye(len(rest))[:, :, None]]
    return np.stack(columns, axis=1).transpose(2, 0, 1)


@one_or_many
def coriolis(result: IdentifiedModel, q: np.ndarray, qd: np.ndarray, payload: Payload | None) -> np.ndarray:
    """Compute the Coriolis matrix of Christoffel's symbols; see :meth:`gtau.Result.coriolis`.

    Coriolis torques are a quadratic form ``h(qd)`` whose symmetric matrices hold the symbols, so column j of the matrix
    is ``(h(qd + e_j) - h(qd) - h(e_j)) / 2``.
    """
    torques, rest = _torques_at(result, q, payload)
    still = np.zeros_like(rest)
    (speeds,) = result.idm.samples(qd)

    def h(speeds: np.ndarray) -> np.ndarray:
        return torques(speeds, still) - rest

    columns = [(h(speeds + unit) - h(speeds) - h(still + unit)) / 2 for unit in np.eye(len(rest))[:, :, None]]
    return np.stack(columns, axis=1).transpose(2, 0, 1)
