"""Prior knowledge of a robot, from a model, given parameters, or roughly from its geometry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field, FiniteFloat, model_validator

from gtau.documents.files import beside
from gtau.documents.validation import Keys, Positive
from gtau.errors import GtauError
from gtau.estimation.results.model_file import load
from gtau.estimation.results.result import IdentifiedModel
from gtau.findings import Grade
from gtau.model.base_parameters import BaseParameters
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.singularities import random_motion
from gtau.robots.geometry import massless, places_on
from gtau.robots.parameter import Parameter, RigidBody, inertial_parameters, payload_label
from gtau.robots.robot import INERTIAL, Robot
from gtau.signals.reading.statements import FIRST_MOMENTS, Drive, Payload

FRICTION = 0.1  # guessed Coulomb friction, and viscous friction at the speed limit, over the rms torque
MODERATE = 0.15  # guessed rms torque over the effort limit
NOISE = 0.005  # guessed noise of a current sample over the effort limit
ERROR = 1.25  # factor on inertias of a robot's file: gravity torques of a real UR10e were 1.04 to 1.22 times its file's
ARM = 0.05  # m along every axis, assumed centre of a payload: a centre on a joint's axis would not load the joint
# friction, viscous at the speed limit, and rotors over effort limits; a UR10e: 5 to 14 %, 8 to 41 %, 0.01 kg m2 per N m
COULOMB, VISCOUS, ROTOR = 0.1, 0.3, 0.0125
STATES = 200

FilePath = Annotated[Path, AfterValidator(lambda path, info: beside(info.context or Path(), path))]


class DesignPrior(Keys):
    """Prior knowledge: a model, or standard parameters and drive gains; and the noise of the currents, A."""

    model: FilePath | None = None
    gains: dict[str, FiniteFloat] = Field(default_factory=dict)
    parameters: dict[str, FiniteFloat] = Field(default_factory=dict)
    noise: dict[str, Positive] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _one_source(self) -> DesignPrior:
        if self.model is not None and (self.gains or self.parameters):
            raise ValueError("the model contains gains and parameters; give either the model, or gains and parameters")
        return self


@dataclass(frozen=True)
class KnownGain:
    """A prior gain, N m/A or N per A, with its 95 % ``interval``; ``source`` is how it is known, or its verdict.

    ``model`` is the part of its standard deviation due to model errors, which more motion does not reduce.
    """

    value: float
    interval: tuple[float, float]
    source: str
    model: float = 0.0

    @property
    def least(self) -> float:
        """Smallest size within the interval, which gives the largest current."""
        return min(map(abs, self.interval))

    @property
    def excess(self) -> float:
        """Largest size within the interval over the size of the value, the factor by which a torque may be larger."""
        return max(map(abs, self.interval)) / abs(self.value)


@dataclass(frozen=True, eq=False)
class PriorModel:
    """Base parameters ``chi`` (n_b,), gains, and standard deviations ``sigma`` (n,) of a current sample, A.

    Torque limits use the base parameters ``cautious`` (n_b,). ``centers`` maps payloads to their centres (3,), m.
    ``covariance`` holds the unknowns of an earlier result and their covariance; ``drives`` are those whose voltages
    will be logged, which give their gains.
    """

    chi: np.ndarray
    known: tuple[KnownGain, ...]
    sigma: np.ndarray
    cautious: np.ndarray
    centers: Mapping[str, np.ndarray] = field(default_factory=dict)
    covariance: tuple[tuple[Parameter, ...], np.ndarray] | None = None
    drives: Mapping[str, Drive] = field(default_factory=dict)

    @property
    def gains(self) -> np.ndarray:
        """Values of the gains (n,)."""
        return np.array([gain.value for gain in self.known])

    def values(
        self, names: Sequence[Parameter], robot: Robot, payloads: Sequence[Payload | None], known: Mapping[str, float]
    ) -> np.ndarray:
        """Look up parameters by name: first moments of payloads, ``known`` base parameters, or zero."""
        values = dict(known)
        for run, payload in enumerate(payloads):
            if payload is not None:  # its unknown parameters are labelled by the run
                moments = zip(FIRST_MOMENTS, self.moments(payload), strict=True)
                values |= {Parameter(kind, payload_label(robot, run)): moment for kind, moment in moments}
        return np.array([values.get(name, 0.0) for name in names])

    def moments(self, load: Payload) -> np.ndarray:
        """Return the first moments (3,) of a payload, kg m, from its known or assumed centre."""
        return np.asarray((load.mass or 1.0) * self.centers.get(load.name, np.full(3, ARM)))


def identified_gains(result: IdentifiedModel, file: Path) -> tuple[KnownGain, ...]:
    """Take the gains of an earlier result with their intervals and verdicts; refuse a gain that cannot be a prior."""
    gains = []
    for joint in result.robot.actuated:
        gain = result.drive_gains.get(joint)
        outcome = Grade.NOT_IDENTIFIABLE if gain is None else gain.verdict.outcome
        why = outcome.value
        if gain is not None and gain.value is not None and outcome not in (Grade.CONTRADICTORY, Grade.NOT_IDENTIFIABLE):
            low, high = gain.interval() or (gain.value, gain.value)
            if low * high > 0:
                gains.append(KnownGain(gain.value, (low, high), outcome.value, gain.model_std or 0.0))
                continue
            why = f"{gain}, which may be zero"
        raise GtauError(
            f"the gain of joint '{joint}' in {file} is {why}, so it cannot be a prior; identify it again, or give "
            "prior.gains from the data sheets in place of prior.model."
        )
    return tuple(gains)


def given_parameters(model: InverseDynamics, base: BaseParameters, parameters: Mapping[str, float]) -> np.ndarray:
    """Compute base parameters (n_b,) from standard parameters by name, zero if missing."""
    for name in parameters:
        if name not in model.parameter_names:
            raise GtauError(
                f"robot '{model.robot.name}' has no standard parameter '{name}'; write one such as "
                f"'{model.parameter_names[0]}' or '{model.parameter_names[-1]}'."
            )
    chi = base.matrix @ np.array([parameters.get(name, 0.0) for name in model.parameter_names])
    return np.where(np.abs(chi) > 1e-12 * np.abs(chi).max(initial=0.0), chi, 0.0)


def rough_parameters(model: InverseDynamics, base: BaseParameters, payload: float) -> tuple[dict[str, float], float]:
    """Guess standard parameters for links that are rods of equal mass; return the parameters and this mass.

    The mass is twice the mass of the ``payload``, kg, or less if the motors are too weak. A rod leads from the origin
    of its frame to the mean origin of its followers. Friction is a tenth of the rms torque of random states.
    """
    robot = model.robot
    chi: dict[str, float] = {}
    for body in robot.bodies:
        if Parameter("m", body) not in model.parameter_names:
            continue
        end = np.mean(places_on(robot, body) or [np.zeros(3)], axis=0)
        rod = RigidBody(1.0, end / 2, (end @ end * np.eye(3) - np.outer(end, end)) / 12 + 1e-3 * np.eye(3))
        chi |= {Parameter(kind, body): value for kind, value in inertial_parameters(rod).items()}
    torque = rms_torque(model, base, given_parameters(model, base, chi))  # of links of 1 kg
    limits = {joint: robot.joint(joint).limits for joint in model.actuated}
    effort = np.array([limit.effort or np.inf for limit in limits.values()])
    mass = float(min(2 * payload, np.min(MODERATE * effort / np.maximum(torque, 1e-12))))
    chi = {name: mass * value for name, value in chi.items()}
    for (joint, limit), size in zip(limits.items(), mass * torque, strict=True):
        chi[Parameter("fs", joint)] = float(FRICTION * size)
        chi[Parameter("fv", joint)] = float(FRICTION * size / (limit.velocity or 1.0))
    return chi, mass


def stated_bodies(model: InverseDynamics) -> list[str]:
    """List the bodies whose mass the robot's file states."""
    return [body for body in model.robot.bodies if model.robot.inertias.get(Parameter("m", body))]


def file_parameters(model: InverseDynamics, rough: Mapping[str, float], margin: float = 1.0) -> dict[str, float]:
    """Take the inertias of the robot's file times a ``margin``, and ``rough`` parameters for all other bodies."""
    stated = {Parameter(kind, body) for body in stated_bodies(model) for kind in INERTIAL}
    chi = {name: value for name, value in rough.items() if name not in stated}
    return chi | {name: margin * value for name, value in model.robot.inertias.items() if name in model.parameter_names}


def with_drives(model: InverseDynamics, chi: Mapping[str, float]) -> dict[str, float]:
    """Raise friction and rotor inertias, which robot files rarely state, to values typical of the joint limits."""
    robot, chi = model.robot, dict(chi)
    for joint in model.actuated:
        limits = robot.joint(joint).limits
        effort = limits.effort or 0.0
        least = {"fs": COULOMB * effort, "fv": VISCOUS * effort / (limits.velocity or 1.0), "ia": ROTOR * effort}
        for kind, value in least.items():
            if (name := Parameter(kind, joint)) in model.parameter_names:
                chi[name] = max(chi.get(name, 0.0), value)
    return chi


def rms_torque(model: InverseDynamics, base: BaseParameters, chi: np.ndarray) -> np.ndarray:
    """Compute rms torques (n,) over random states within the robot's limits, N m or N."""
    motion = random_motion(model, STATES, np.random.default_rng(0))
    torques = model.columns(base.standard).torques_along(model.layout, motion, chi)
    return np.asarray(np.sqrt(np.mean(torques**2, axis=1)))


def prior_of(
    entry: DesignPrior,
    model: InverseDynamics,
    base: BaseParameters,
    payloads: tuple[Payload | None, ...],
    assumed: dict[str, str],
) -> PriorModel:
    """Determine base parameters, gains and noise; add to ``assumed`` a sentence on every assumption."""
    if entry.model is not None:
        prior = _identified(load(entry.model), entry.model, model, base)
    else:
        chi, cautious = _parameters(entry, model, base, payloads, assumed)
        missing = [joint for joint in model.actuated if joint not in entry.gains]
        if missing and entry.gains:
            raise GtauError(f"prior.gains has no gain for joint '{missing[0]}'; give one for every joint or for none.")
        if missing:
            assumed["gains"] = "gains: 1 N m/A or N per A in every joint; currents are then torques"
        if len(entry.noise) < len(model.actuated):
            assumed["noise"] = "noise of the currents: white, 0.5 % of the largest current, a sample"
        gains = [entry.gains.get(joint, 1.0) for joint in model.actuated]
        known = tuple(KnownGain(gain, (gain, gain), "assumed" if missing else "given") for gain in gains)
        largest = zip(model.actuated, rms_torque(model, base, chi) / MODERATE, strict=True)
        efforts = [model.robot.joint(joint).limits.effort or torque for joint, torque in largest]
        prior = PriorModel(chi, known, NOISE * np.array(efforts) / np.abs(gains), cautious)
    stated = [entry.noise.get(joint, rough) for joint, rough in zip(model.actuated, prior.sigma, strict=True)]
    return replace(prior, sigma=np.array(stated))


def _identified(result: IdentifiedModel, file: Path, model: InverseDynamics, base: BaseParameters) -> PriorModel:
    if result.robot.actuated != model.actuated:
        raise GtauError(f"{file} is the model of another robot; give a model of '{model.robot.name}'.")
    known = identified_gains(result, file)
    values = {name: parameter.value or 0.0 for name, parameter in result.parameters.items()}
    chi = np.array([values.get(name, 0.0) for name in base.names])
    rms = np.array([error.rms for error in result.residuals])
    # white noise of the current samples that explains the residuals
    sigma = rms / np.abs([gain.value for gain in known]) * np.sqrt(result.preparation.decimator.factor)
    loads = {load.name: result.payload(load.name) for load in result.payloads}
    centers = {
        name: np.array([load[kind] for kind in FIRST_MOMENTS]) / load["m"]
        for name, load in loads.items()
        if load.get("m") and {*FIRST_MOMENTS} <= {*load}
    }
    return PriorModel(chi, known, sigma, chi, centers)


def _parameters(
    entry: DesignPrior,
    model: InverseDynamics,
    base: BaseParameters,
    payloads: tuple[Payload | None, ...],
    assumed: dict[str, str],
) -> tuple[np.ndarray, np.ndarray]:
    """Take stated base parameters (n_b,) or guess them, and the base parameters for torque limits."""
    if not entry.parameters:
        carried = max((payload.mass or 1.0 for payload in payloads if payload is not None), default=1.0)
        rough, mass = rough_parameters(model, base, carried)
        links = f"every {'other ' if stated_bodies(model) else ''}link a rod of {mass:.3g} kg"
        stated = "the inertias of the robot's file, " if stated_bodies(model) else ""
        assumed["parameters"] = (
            f"parameters: {stated}{links}, and friction a tenth of the torque of rods; "
            "give prior.parameters or prior.model for better predictions"
        )
        cautious = with_drives(model, file_parameters(model, rough, ERROR))
        likely = file_parameters(model, rough)
        return given_parameters(model, base, likely), given_parameters(model, base, cautious)
    if light := massless(model.robot, entry.parameters):
        assumed["massless"] = f"no mass and inertia of {', '.join(light)}: 'prior.parameters' lists none for them"
    given = given_parameters(model, base, entry.parameters)
    return given, given
