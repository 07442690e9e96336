"""The result of an identification: one object that people read and programs load."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from idim.estimation.base_parameters import BaseParameters, base_parameters
from idim.estimation.verdicts import GOOD, Verdict
from idim.model.inverse_dynamics import InverseDynamics
from idim.robots.robot import Robot
from idim.signals.experiment import Payload
from idim.signals.preparation import Preparation
from idim.signals.run import Run


@dataclass(frozen=True)
class Estimate:
    """A number with its unit and standard deviation.

    ``value`` is None where the data cannot tell, ``std`` None where the value is known. ``spread`` is the
    standard deviation between runs of a parameter that may drift; its value is then the mean. ``verdict``
    says whether to believe it. ``freedom`` are the degrees of freedom behind ``std``, None for very many.
    """

    name: str
    value: float | None
    std: float | None
    unit: str
    regrouping: str = ""
    spread: float | None = None
    verdict: Verdict = GOOD
    freedom: int | None = None

    def interval(self, level: float = 0.95) -> tuple[float, float] | None:
        """Confidence interval by the t distribution, in ``unit``; None without value or deviation."""
        if self.value is None or self.std is None:
            return None
        from scipy.special import ndtri, stdtrit

        tail = (1 + level) / 2
        half = self.std * float(ndtri(tail) if self.freedom is None else stdtrit(self.freedom, tail))
        return self.value - half, self.value + half

    @property
    def rel_std(self) -> float | None:
        """Relative standard deviation, per cent."""
        return 100 * self.std / abs(self.value) if self.value and self.std is not None else None


@dataclass(frozen=True)
class PayloadEstimate:
    """Inertial parameters of the payload of a run, by kind, in the frame of the body that carries it."""

    name: str
    run: str
    parameters: Mapping[str, Estimate]
    known: frozenset[str]
    verdict: Verdict = GOOD


@dataclass(frozen=True)
class TorqueError:
    """How well torques ``v g_tau`` are met at a joint: rms of error and of signal, N m or N."""

    joint: str
    rms: float
    signal: float
    unit: str

    @property
    def relative(self) -> float:
        """Error over signal, per cent."""
        return 100 * self.rms / self.signal


@dataclass(frozen=True)
class Prediction:
    """Decimated torques along a run: ``time`` (K,), ``predicted`` and ``measured`` (K, n), ``keep`` (K, n).

    ``keep`` is False near reversals and gaps, where the model's friction does not hold.
    """

    joints: tuple[str, ...]
    time: np.ndarray
    predicted: np.ndarray
    measured: np.ndarray
    keep: np.ndarray


@dataclass(frozen=True)
class Move:
    """What consistency did to a number: its value without and with it, and by how many standard deviations it moved."""

    name: str
    free: float
    consistent: float
    deviations: float


@dataclass(frozen=True)
class Consistency:
    """A robot that can exist.

    Attributes
    ----------
    standard : dict
        Every standard parameter by name, SI units.
    payloads : dict
        Label (``L3``) of each carried payload to its ten inertial parameters by kind.
    gains : dict
        Joint to (drive gain, standard deviation) found together with them; the deviation is 0 where given.
    moves : tuple of Move
        Every base parameter and gain, the most moved first.
    eigenvalues : dict
        Smallest eigenvalue of the pseudo-inertia of each body, SI units.
    loss : dict
        Joint to the growth of its residual, per cent.
    open : tuple of str
        Standard parameters that act on no actuated joint, chosen and not identified.
    """

    standard: Mapping[str, float]
    payloads: Mapping[str, Mapping[str, float]]
    gains: Mapping[str, tuple[float, float]]
    moves: tuple[Move, ...]
    eigenvalues: Mapping[str, float]
    loss: Mapping[str, float]
    open: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Result:
    """Drive gains, parameters and payloads of a robot, identified from its logs.

    Attributes
    ----------
    robot : Robot
        The robot.
    method : str
        One of :data:`idim.estimation.identify.METHODS`.
    drive_gains, delays : dict
        Joint name to :class:`Estimate`.
    friction : dict
        Friction terms beyond the paper's that the data ask for; name to Estimate.
    parameters, essential : dict
        All base parameters, and those left by the reduction and re-estimated; name to Estimate. The
        deviation of an essential one is that with all parameters, as it absorbs what cancelled ones did;
        after the paper's ratio rule it takes the cancelled ones for zero, as the rule does.
    payloads : tuple of PayloadEstimate
        One entry for each loaded run.
    residuals : tuple of TorqueError
        Over the rows used.
    covariance : ndarray
        (parameters, gains, delays), with rows named by ``covariance_names``; block jackknife.
    preparation : Preparation
        How the logs were filtered and decimated.
    statistics : dict
        Further figures of the method.
    notes : tuple of str
        What was repaired, left out, or is not to be trusted.
    consistency : Consistency, optional
        Standard parameters that rigid bodies can have, where they were asked for.
    """

    robot: Robot
    method: str
    kind: str
    drive_gains: Mapping[str, Estimate]
    delays: Mapping[str, Estimate]
    parameters: Mapping[str, Estimate]
    essential: Mapping[str, Estimate]
    friction: Mapping[str, Estimate]
    payloads: tuple[PayloadEstimate, ...]
    residuals: tuple[TorqueError, ...]
    covariance_names: tuple[str, ...]
    covariance: np.ndarray
    preparation: Preparation
    statistics: Mapping[str, float]
    runs: tuple[str, ...]
    notes: tuple[str, ...]
    consistency: Consistency | None = None

    @cached_property
    def model(self) -> InverseDynamics:
        """The robot's model."""
        return InverseDynamics(self.robot)

    @cached_property
    def base(self) -> BaseParameters:
        """The robot's base parameters."""
        return base_parameters(self.model)

    @property
    def params(self) -> dict[str, float]:
        """Values of the base parameters by name; 0 for one that the data cannot tell from the others."""
        return {name: estimate.value or 0.0 for name, estimate in self.parameters.items()}

    def summary(self) -> str:
        """The result as a table to print."""
        from idim.estimation.summary import summary

        return summary(self)

    def predict(self, run: Run) -> Prediction:
        """Torques that the model predicts along ``run``, beside the measured ``v g_tau``.

        Raises
        ------
        IdimError
            Where the run does not suit the robot, or the model refuses a sample.
        """
        from idim.estimation.prediction import predict

        return predict(self, run)

    def validate(self, run: Run) -> tuple[TorqueError, ...]:
        """Torque error of each joint on a run, over the samples that identification would use."""
        from idim.estimation.prediction import torque_errors

        return torque_errors(self, self.predict(run))

    def payload(self, name: str) -> dict[str, float]:
        """Identified parameters of a payload by kind, the mean over its runs; empty for an unknown name."""
        found: dict[str, list[float]] = {}
        for each in self.payloads:
            if each.name == name:
                for kind, estimate in each.parameters.items():
                    if estimate.value is not None:
                        found.setdefault(kind, []).append(estimate.value)
        return {kind: float(np.mean(values)) for kind, values in found.items()}

    def save(self, path: str | Path) -> None:
        """Write the result as JSON, atomically; see :mod:`idim.estimation.model_file`."""
        from idim.estimation.model_file import save

        save(self, path)

    @staticmethod
    def load(path: str | Path) -> Result:
        """Read a result that :meth:`save` wrote; raises IdimError where the file is not one."""
        from idim.estimation.model_file import load

        return load(path)


def unit_of(kind: str, robot: Robot, joint: str) -> str:
    """SI unit of a parameter of ``kind`` at a joint or platform."""
    if kind in ("xx", "xy", "xz", "yy", "yz", "zz"):
        return "kg m2"
    if kind in ("mx", "my", "mz"):
        return "kg m"
    if kind == "m":
        return "kg"
    turns = robot.joint(joint).kind == "revolute"
    if kind == "ia":
        return "kg m2" if turns else "kg"
    if kind == "fv":
        return "N m s/rad" if turns else "N s/m"
    return torque_unit(robot, joint)


def torque_unit(robot: Robot, joint: str) -> str:
    """N m for a revolute joint, N for a prismatic one."""
    return "N m" if robot.joint(joint).kind == "revolute" else "N"


def known_parameters(payload: Payload, identified: Mapping[str, float]) -> dict[str, float]:
    """A payload's parameters by kind: the known ones, then the identified ones."""
    mass = {} if payload.mass is None else {"m": payload.mass}
    return {**identified, **mass, **payload.parameters}
