"""Prior knowledge of a robot, from a model, given parameters, or roughly from its geometry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field, FiniteFloat, ValidationInfo, model_validator

from gtau.documents.files import beside
from gtau.documents.validation import Keys, Positive
from gtau.errors import GtauError
from gtau.estimation.results.model_file import load
from gtau.estimation.results.result import Result
from gtau.findings import Grade
from gtau.model.base_parameters import BaseParameters
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.singularities import random_motion
from gtau.robots.geometry import massless, places_on
from gtau.robots.parameter import Parameter, payload_label
from gtau.robots.robot import INERTIAL, Robot
from gtau.signals.reading.statements import FIRST_MOMENTS, Payload

FRICTION = 0.1  # rough Coulomb friction, and viscous friction at the speed limit, of the rms torque
MODERATE = 0.15  # rough rms torque, of the effort limit
NOISE = 0.005  # rough noise of a current's sample, of the effort limit
ERROR = 1.25  # by which torques of a file's inertias count: gravity of a real UR10e was 1.04 to 1.22 times its file's
# Drives behind limits of torque, of these (80 % of the file's). Of a real UR10e's file: Coulomb friction 5 to 14 %,
# viscous friction at the speed limit 8 to 41 %, rotors 0.009 to 0.010 kg m2 a N m.
ARM = 0.05  # m along each axis, of a payload's centre where none is stated: on a joint's axis it has no effect on it
COULOMB, VISCOUS, ROTOR = 0.1, 0.3, 0.0125
STATES = 200


def _beside_the_file(path: Path, info: ValidationInfo) -> Path:
    return path if info.context is None else beside(info.context, path)


FilePath = Annotated[Path, AfterValidator(_beside_the_file)]


class DesignPrior(Keys):
    """Prior knowledge: a model, or standard parameters and drive gains; and the currents' noise, A."""

    model: FilePath | None = None
    gains: dict[str, FiniteFloat] = Field(default_factory=dict)
    parameters: dict[str, FiniteFloat] = Field(default_factory=dict)
    noise: dict[str, Positive] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _one_source(self) -> DesignPrior:
        if self.model is not None and (self.gains or self.parameters):
            raise ValueError("a model has gains and parameters of its own; give the model, or these")
        return self


@dataclass(frozen=True)
class KnownGain:
    """A gain known beforehand, N m/A or N per A, its 95 % ``interval``, and its ``source``: of a result the verdict.

    ``model`` is the part of its standard deviation that comes from what the model may lack: more motion leaves it.
    """

    value: float
    interval: tuple[float, float]
    source: str
    model: float = 0.0

    @property
    def least(self) -> float:
        """Smallest size within the interval: it gives the largest current."""
        return min(map(abs, self.interval))

    @property
    def excess(self) -> float:
        """Ratio of the largest size within the interval to the size of the value: a torque may be larger by so much."""
        return max(map(abs, self.interval)) / abs(self.value)


@dataclass(frozen=True, eq=False)
class PriorModel:
    """Base parameters ``chi`` (n_b,), gains, and standard deviations ``sigma`` (n,) of a sample of each current, A.

    Limits of torque hold for the base parameters ``cautious`` (n_b,). ``centers`` (3,) are the centres
    of payloads by name, m. ``covariance`` belongs to an earlier result to which a motion adds, with the names of rows.
    """

    chi: np.ndarray
    known: tuple[KnownGain, ...]
    sigma: np.ndarray
    cautious: np.ndarray
    centers: Mapping[str, np.ndarray] = field(default_factory=dict)
    covariance: tuple[tuple[Parameter, ...], np.ndarray] | None = None

    @property
    def gains(self) -> np.ndarray:
        """Values of the gains (n,)."""
        return np.array([gain.value for gain in self.known])

    def values(
        self, names: Sequence[Parameter], robot: Robot, payloads: Sequence[Payload | None], known: Mapping[str, float]
    ) -> np.ndarray:
        """Return the values of parameters by name: the ``known`` base parameters, centres of payloads, or zero."""
        moments: dict[str, float] = {}
        for run, payload in enumerate(payloads):
            if payload is not None:  # whose unknown parameters have the name of the run
                label = payload_label(robot, run)
                moments |= {Parameter(k, label): m for k, m in zip(FIRST_MOMENTS, self.moments(payload), strict=True)}
        return np.array([moments.get(name, known.get(name, 0.0)) for name in names])

    def moments(self, load: Payload) -> np.ndarray:
        """Return the first moments (3,) of a payload, kg m, with the centre that is known or guessed."""
        return np.asarray((load.mass or 1.0) * self.centers.get(load.name, np.full(3, ARM)))


def identified_gains(result: Result, file: Path) -> tuple[KnownGain, ...]:
    """Take the gains of an earlier result, with their intervals and verdicts."""
    gains = []
    for joint in result.robot.actuated:
        gain = result.drive_gains.get(joint)
        outcome = Grade.NOT_IDENTIFIABLE if gain is None else gain.verdict.outcome
        interval = None if gain is None or gain.value is None else gain.interval() or (gain.value, gain.value)
        if outcome in (Grade.CONTRADICTORY, Grade.NOT_IDENTIFIABLE) or gain is None or interval is None:
            raise GtauError(
                f"the gain of joint '{joint}' in {file} is {outcome.value}, so it cannot be a prior; identify it "
                "again, or give prior.gains from the data sheets in place of prior.model."
            )
        if interval[0] * interval[1] <= 0:
            raise GtauError(
                f"the gain of joint '{joint}' in {file} is {gain}, which may be zero, so it cannot be a prior; "
                "identify it again, or give prior.gains from the data sheets in place of prior.model."
            )
        assert gain.value is not None
        gains.append(KnownGain(gain.value, interval, outcome.value, gain.model_std or 0.0))
    return tuple(gains)


def identified_centers(result: Result) -> dict[str, np.ndarray]:
    """Take the centres of payloads that an earlier result found, m by name."""
    estimates = {load.name: result.payload(load.name) for load in result.payloads}
    return {
        name: np.array([moments[kind] / moments["m"] for kind in FIRST_MOMENTS])
        for name, moments in estimates.items()
        if moments.get("m") and {*FIRST_MOMENTS} <= {*moments}
    }


def given_parameters(model: InverseDynamics, base: BaseParameters, parameters: Mapping[str, float]) -> np.ndarray:
    """Compute base parameters (n_b,) from standard ones by name; those not named are zero."""
    for name in parameters:
        if name not in model.parameter_names:
            raise GtauError(
                f"robot '{model.robot.name}' has no standard parameter '{name}'; write one such as "
                f"'{model.parameter_names[0]}' or '{model.parameter_names[-1]}'."
            )
    chi = base.matrix @ np.array([parameters.get(name, 0.0) for name in model.parameter_names])
    return np.where(np.abs(chi) > 1e-12 * np.abs(chi).max(initial=0.0), chi, 0.0)


def rough_parameters(model: InverseDynamics, base: BaseParameters, payload: float) -> tuple[dict[str, float], float]:
    """Guess standard parameters with links as rods of equal mass and matching friction; return that mass too.

    The mass is twice the mass of the ``payload``, kg, or less where the motors are too weak. A rod leads from its
    frame's origin to the mean of its followers'; friction is a tenth of the rms torque of random states.
    """
    robot = model.robot
    chi: dict[str, float] = {}
    for body in robot.bodies:
        if Parameter("m", body) not in model.parameter_names:
            continue
        end = np.mean(places_on(robot, body) or [np.zeros(3)], axis=0)
        inertia = (end @ end * np.eye(3) - np.outer(end, end)) / 3 + 1e-3 * np.eye(3)
        chi |= {Parameter(kind, body): float(value) for kind, value in zip(("mx", "my", "mz"), end / 2, strict=True)}
        places = {"xx": (0, 0), "xy": (0, 1), "xz": (0, 2), "yy": (1, 1), "yz": (1, 2), "zz": (2, 2)}
        chi |= {Parameter(kind, body): float(inertia[place]) for kind, place in places.items()}
        chi[Parameter("m", body)] = 1.0
    torque = rms_torque(model, base, given_parameters(model, base, chi))  # of links of 1 kg
    effort = np.array([robot.joint(joint).limits.effort or np.inf for joint in model.actuated])
    mass = float(min(2 * payload, np.min(MODERATE * effort / np.maximum(torque, 1e-12))))
    chi = {name: mass * value for name, value in chi.items()}
    for joint, size in zip(model.actuated, mass * torque, strict=True):
        chi[Parameter("fs", joint)] = float(FRICTION * size)
        chi[Parameter("fv", joint)] = float(FRICTION * size / (robot.joint(joint).limits.velocity or 1.0))
    return chi, mass


def stated_bodies(model: InverseDynamics) -> list[str]:
    """List the bodies with a mass in the robot's file."""
    return [body for body in model.robot.bodies if model.robot.inertias.get(Parameter("m", body))]


def file_parameters(model: InverseDynamics, rough: Mapping[str, float], margin: float = 1.0) -> dict[str, float]:
    """Take the inertias of the robot's file times a ``margin``, and ``rough`` parameters where there are none."""
    stated = {Parameter(kind, body) for body in stated_bodies(model) for kind in INERTIAL}
    chi = {name: value for name, value in rough.items() if name not in stated}
    return chi | {name: margin * value for name, value in model.robot.inertias.items() if name in model.parameter_names}


def with_drives(model: InverseDynamics, chi: Mapping[str, float]) -> dict[str, float]:
    """Complete parameters with usual drives.

    A file knows neither friction nor, as a rule, rotors: they are at least what the limits of effort and speed suggest.
    """
    robot, chi = model.robot, dict(chi)
    for joint in model.actuated:
        limits = robot.joint(joint).limits
        effort = limits.effort or 0.0
        least = {"fs": COULOMB * effort, "fv": VISCOUS * effort / (limits.velocity or 1.0), "ia": ROTOR * effort}
        for kind, value in least.items():
            if (name := Parameter(kind, joint)) in model.parameter_names:
                chi[name] = max(chi.get(name, 0.0), value)
    return chi


def rough_noise(model: InverseDynamics, base: BaseParameters, chi: np.ndarray) -> np.ndarray:
    """Guess the standard deviation (n,) of a torque sample from the effort limit, or else from the rms torque."""
    torque = rms_torque(model, base, chi) / MODERATE
    joints = [model.robot.joint(name) for name in model.actuated]
    return NOISE * np.array([joint.limits.effort or size for joint, size in zip(joints, torque, strict=True)])


def rms_torque(model: InverseDynamics, base: BaseParameters, chi: np.ndarray) -> np.ndarray:
    """Compute rms torques (n,) over random states within the robot's limits, N m or N."""
    motion = random_motion(model, STATES, np.random.default_rng(0))
    regressor = model.columns(base.standard)
    torques = regressor.torques_along(model.layout, motion, chi)
    return np.asarray(np.sqrt(np.mean(torques**2, axis=1)))


def prior_of(
    entry: DesignPrior,
    model: InverseDynamics,
    base: BaseParameters,
    payloads: tuple[Payload | None, ...],
    assumed: dict[str, str],
) -> PriorModel:
    """Determine base parameters, gains and noise."""
    if entry.model is not None:
        result = load(entry.model)
        if result.robot.actuated != model.actuated:
            raise GtauError(f"{entry.model} is the model of another robot; give one of '{model.robot.name}'.")
        known = identified_gains(result, entry.model)
        values = {name: known.value or 0.0 for name, known in result.parameters.items()}
        chi = np.array([values.get(name, 0.0) for name in base.names])
        rms = np.array([error.rms for error in result.residuals])
        # white noise of the currents' samples that explains the residuals
        sigma = rms / np.abs([gain.value for gain in known]) * np.sqrt(result.preparation.decimator.factor)
        cautious, centers = chi, identified_centers(result)
    else:
        centers = {}
        chi, cautious = _parameters(entry, model, base, payloads, assumed)
        missing = [joint for joint in model.actuated if joint not in entry.gains]
        if missing and entry.gains:
            raise GtauError(f"prior.gains has no gain for joint '{missing[0]}'; give one for every joint or for none.")
        gains = [entry.gains.get(joint, 1.0) for joint in model.actuated]
        known = tuple(KnownGain(gain, (gain, gain), "assumed" if missing else "given") for gain in gains)
        if missing:
            assumed["gains"] = "gains: 1 N m/A or N per A in every joint; currents are then torques"
        sigma = rough_noise(model, base, chi) / np.abs(gains)
        if len(entry.noise) < len(gains):
            assumed["noise"] = "noise of the currents: white, 0.5 % of the largest current, a sample"
    sigma = np.array([entry.noise.get(joint, rough) for joint, rough in zip(model.actuated, sigma, strict=True)])
    return PriorModel(chi, known, sigma, cautious, centers)


def _parameters(
    entry: DesignPrior,
    model: InverseDynamics,
    base: BaseParameters,
    payloads: tuple[Payload | None, ...],
    assumed: dict[str, str],
) -> tuple[np.ndarray, np.ndarray]:
    """Take the base parameters (n_b,) from those stated, or guess them; and those for which limits of torque hold."""
    if not entry.parameters:
        carried = max(payload.mass or 1.0 for payload in payloads if payload is not None)
        rough, mass = rough_parameters(model, base, carried)
        links = f"every {'other ' if stated_bodies(model) else ''}link a rod of {mass:.3g} kg"
        of_file = "the inertias of the robot's file, " if stated_bodies(model) else ""
        assumed["parameters"] = (
            f"parameters: {of_file}{links}, and friction a tenth of the torque of rods; "
            "give prior.parameters or prior.model for better predictions"
        )
        cautious = with_drives(model, file_parameters(model, rough, ERROR))
        return given_parameters(model, base, file_parameters(model, rough)), given_parameters(model, base, cautious)
    if light := massless(model.robot, entry.parameters):
        assumed["massless"] = f"no mass and inertia of {', '.join(light)}: 'prior.parameters' names none of theirs"
    given = given_parameters(model, base, entry.parameters)
    return given, given
