"""Identified model for exports: named parameters, gains, reference torques in Python, and CasADi functions.

The functions are expressions of :mod:`gtau.model`: nothing is derived twice. With loops there are two stages: steps of
Newton's method bring the configuration ``c`` to the actuated positions, and everything else is computed from the closed
``c``. A serial robot has ``c = q`` and the second stage alone.

Behind the configuration stand the states z of presliding friction. Where they begin at rest they follow the positions,
so that an update of the configuration updates them too: ``z <- clip(z + ratios . dq / width, -1, 1)``. At home they are
``SLIDING``, and stay so: friction is then that of the velocity given, whatever came before.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from gtau.documents.files import identifier
from gtau.errors import GtauError
from gtau.estimation.friction.law import SHAPES, transmitted
from gtau.estimation.regression.column_blocks import TEMPERATURE_TERMS
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.result import Result
from gtau.model import dynamics
from gtau.model.closures import closed_motion, newton_step
from gtau.model.kinematics import configuration_rates
from gtau.model.loops import Motion
from gtau.robots.parameter import Parameter, parameter_of, torque_unit
from gtau.robots.robot import INERTIAL, PLAIN_FRICTION
from gtau.uses.prediction import torques_along

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
    """Model from which torques are computed.

    Attributes
    ----------
    result : Result
        Its identification.
    name : str
        The robot's name as an identifier of C, MATLAB and Python.
    parameters : tuple of Estimate
        Base parameters, those of friction as the model predicts it, then the friction terms f3, fb and fl.
    payloads : dict
        Name of each identified or known payload to the values of all parameters (n_p,) with it.
    gains : ndarray
        Drive gains (n,), N m/A or N/A; torque scales where the logs hold torques.
    units : tuple of str
        ``N m`` or ``N`` for each actuated joint.
    """

    result: Result
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
        """Values (n_p,) of the parameters, zero for those not identifiable."""
        return np.array([parameter.value or 0.0 for parameter in self.parameters])

    @property
    def friction(self) -> tuple[Parameter, ...]:
        """Names of all parameters of friction, those of base parameters by their standard ones."""
        plain = [name for name in self.result.base.standard if name.kind in PLAIN_FRICTION]
        return (*plain, *self.terms)

    @property
    def terms(self) -> tuple[Parameter, ...]:
        """Names of the friction terms among the parameters (``fl_11``)."""
        return tuple(parameter_of(parameter.name) for parameter in self.parameters[self.result.base.count :])


def identified(result: Result) -> Identified:
    """Collect the data of a result for exports of torques.

    Raises
    ------
    GtauError
        Where the result lacks a base parameter or a drive gain.
    """
    base, robot = result.base, result.robot
    missing = [name for name in base.names if name not in result.parameters]
    if missing:
        raise GtauError(f"the model lacks the base parameter '{missing[0]}'; identify it again.")
    terms = [term for name, term in result.friction.items() if name.kind not in (*TEMPERATURE_TERMS, *SHAPES)]
    parameters = [*(result.parameters[name] for name in base.names), *terms]
    gains = np.array([result.drive_gains[joint].value for joint in robot.actuated], dtype=float)
    values = np.array([parameter.value or 0.0 for parameter in parameters])
    units = tuple(torque_unit(robot, joint) for joint in robot.actuated)
    return Identified(result, identifier(robot.name), tuple(parameters), _payloads(result, values), gains, units)


def torques(
    model: Identified, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, values: np.ndarray | None = None
) -> np.ndarray:
    """Compute torques (N, n) in N m or N along a path of the actuated joints, (N, n) each.

    Parameters
    ----------
    model : Identified
        From :func:`identified`.
    q, qd, qdd : ndarray
        Positions, velocities and accelerations, SI units; the path begins near home.
    values : ndarray, optional
        Parameters (n_p,) other than the identified ones, those of a payload for instance.

    Raises
    ------
    GtauError
        Where the loops cannot be closed, or a pose is too close to a singularity.
    """
    idm = model.result.idm
    return torques_of(model, idm.motion(q.T, qd.T, qdd.T), model.values if values is None else values).T


def torques_of(model: Identified, motion: Motion, values: np.ndarray, z: np.ndarray | None = None) -> np.ndarray:
    """Compute torques (n, N) of a motion, friction included, at states z (s, N) of presliding; sliding without them."""
    base = model.result.base
    names = (*base.standard, *model.terms)
    terms = {name: value for name, value in zip(names, values, strict=True) if name in model.friction}
    return torques_along(model.result, motion, values[: base.count], terms, z)


def _payloads(result: Result, values: np.ndarray) -> dict[str, np.ndarray]:
    base, place = result.base, {name: k for k, name in enumerate(result.idm.parameter_names)}
    loaded = {}
    for name in dict.fromkeys(payload.name for payload in result.payloads):
        weighed = result.payload(name)
        if "m" in weighed:
            with_it = values.copy()
            for kind in INERTIAL:
                with_it[: base.count] += (
                    weighed.get(kind, 0.0) * base.matrix[:, place[Parameter(kind, result.robot.tool)]]
                )
            loaded[name] = with_it
    return loaded


def notes_on(model: Identified) -> tuple[str, ...]:
    """Note parameters without a value, and friction extrapolated beyond the logged speeds."""
    result = model.result
    lost = [name for name, estimate in result.parameters.items() if estimate.value is None]
    notes = [f"not identifiable from the logs and exported as zero: {', '.join(lost)}"] if lost else []
    bent = [name for name in model.terms if name.kind == "f3"]
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

    Attributes
    ----------
    outputs : dict
        By the names of ``OUTPUTS`` and ``OBSERVED``: functions of c and z (n_c + s,), qd, qdd (n,) and the parameters
        (n_p,).
    step, last_step : Function, optional
        Configuration after a step of Newton's method and the size of its correction, rad or lengths over
        ``length``; the last one also gives the condition number of the loops. None for a serial robot.
    home : ndarray
        Closed configuration to start from, with sliding joints, (n_c + s,).
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
        step, last_step = _function("step", [start], stepped[:2]), _function("last_step", [start], stepped)
    p = ca.SX.sym("p", len(model.parameters))
    base, chi = model.result.base, ca.vertsplit(p[: model.result.base.count])
    load = dynamics.torques(layout, c, yd, ydd, J, _standard(model, transmitted(ca, base.standard, chi)))
    law = model.result.friction_law
    z = ca.SX.sym("z", len(law.states))
    friction = _Friction(model, p, yd, J, z)
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
    home = np.concatenate([home, np.full(len(presliding), SLIDING)])
    return Functions(outputs, step, last_step, home, layout.actuated, presliding)


def _function(name: str, inputs: list[ca.SX], outputs: list[ca.SX]) -> ca.Function:
    return ca.Function(name, inputs, [ca.densify(output) for output in outputs], {"cse": True})


def _standard(model: Identified, chi: list[ca.SX]) -> dict[Parameter, ca.SX]:
    """Choose standard parameters with the same torques: base parameters at their representatives, else zero."""
    standard = {name: ca.SX(1, 1) for name in model.result.idm.parameter_names}
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
        forces, speeds = (ca.densify(ca.vertcat(*rows)) for rows in law.forces(ca, self._values, self.yd, load))
        scales = law.scales(ca, forces, speeds)
        if law.states:
            slides = self.z > 1.0
            moving = ca.vertcat(*(ca.sign(self.yd[row]) for row in law.states))
            z = law.directions(ca, self.yd, slides * moving + (1.0 - slides) * self.z)
            forces = ca.densify(ca.vertcat(*law.forces(ca, self._values, self.yd, load, z)[0]))
        return forces, scales

    def _on_motors(self, forces: ca.SX, scales: ca.SX) -> ca.SX:
        joints = self.model.result.robot.joints
        offsets = ca.vertcat(*(self._values.get(Parameter("off", joint.name), 0.0) for joint in joints))
        acting = forces * scales
        return self.J[: len(joints), :].T @ (acting[: len(joints)] + offsets) + acting[len(joints) :]
