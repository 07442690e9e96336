"""Identified model for exports: named parameters, gains, and reference torques in Python."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.regression.friction import TEMPERATURE_TERMS
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.prediction import torques_along
from gtau.estimation.results.result import Result
from gtau.export.exported import identifier
from gtau.model.loops import Motion
from gtau.robots.parameter import Parameter, parameter_of
from gtau.robots.robot import INERTIAL
from gtau.robots.units import torque_unit


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
        return np.array([each.value or 0.0 for each in self.parameters])

    @property
    def friction(self) -> tuple[str, ...]:
        """Names of all parameters of friction, those of base parameters by their standard ones."""
        plain = [name for name in self.result.base.standard if parameter_of(name).kind in ("fv", "fs", "off")]
        return (*plain, *self.terms)

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the friction terms among the parameters (``fl_11``)."""
        return tuple(each.name for each in self.parameters[self.result.base.count :])


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
    parameters = []
    friction = result.friction_parameters
    for name, standard in zip(base.names, base.standard, strict=True):
        plain = result.parameters[name]
        each = replace(friction[standard], name=name, regrouping=plain.regrouping) if standard in friction else plain
        parameters.append(each)
    parameters += [
        each
        for name, each in friction.items()
        if name not in base.standard and parameter_of(name).kind not in TEMPERATURE_TERMS
    ]
    gains = np.array([result.drive_gains[joint].value for joint in robot.actuated], dtype=float)
    values = np.array([each.value or 0.0 for each in parameters])
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
    idm = model.result.model
    return torques_of(model, idm.motion(q.T, qd.T, qdd.T), model.values if values is None else values).T


def torques_of(model: Identified, motion: Motion, values: np.ndarray, z: np.ndarray | None = None) -> np.ndarray:
    """Compute torques (n, N) of a motion, friction included, at states z (s, N) of presliding; sliding without them."""
    base = model.result.base
    names = (*base.standard, *model.terms)
    terms = {name: value for name, value in zip(names, values, strict=True) if name in model.friction}
    return torques_along(model.result, motion, values[: base.count], terms, z)


def _payloads(result: Result, values: np.ndarray) -> dict[str, np.ndarray]:
    base, place = result.base, {name: k for k, name in enumerate(result.model.parameter_names)}
    loaded = {}
    for name in dict.fromkeys(each.name for each in result.payloads):
        found = result.payload(name)
        if "m" in found:
            with_it = values.copy()
            for kind in INERTIAL:
                with_it[: base.count] += (
                    found.get(kind, 0.0) * base.matrix[:, place[Parameter(kind, result.robot.tool).name]]
                )
            loaded[name] = with_it
    return loaded


def notes_on(model: Identified) -> tuple[str, ...]:
    """Note parameters without a value, and friction extrapolated beyond the logged speeds."""
    result = model.result
    lost = [name for name, each in result.parameters.items() if each.value is None]
    notes = [f"not identifiable from the logs and exported as zero: {', '.join(lost)}"] if lost else []
    bent = [name for name in model.terms if name.startswith("f3_")]
    bent += [each.name for each in model.parameters if each.name.startswith("fv_") and (each.value or 0.0) < 0]
    joints = dict.fromkeys(parameter_of(name).body.removesuffix("R") for name in bent)
    above = [f"{joint} above {result.friction_law.logged(joint)}" for joint in joints if joint in result.robot.actuated]
    if above:
        notes.append(
            f"friction is extrapolated beyond the logged speeds along its slope there, or held: {', '.join(above)}"
        )
    return tuple(notes)
