"""Result of an identification: its four groups, and what is done with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Self, TypeVar, overload

import numpy as np

from gtau.display import html, late, views
from gtau.estimation.diagnostics.verdict import Outcome
from gtau.estimation.effects.effect import EstimatedEffect
from gtau.estimation.friction.law import SHAPES, FrictionLaw
from gtau.estimation.regression.dataset import base_of, model_of
from gtau.estimation.results.estimate import (
    Estimate,
    FrictionCurve,
    Named,
    NearestPose,
    ReferenceTemperatures,
    Requirement,
    SensorEstimate,
    TorqueError,
)
from gtau.estimation.results.groups import Evidence, FitRecord, ModelEstimates, PayloadEstimate
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.model.base_parameters import BaseParameters
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.parameter import Parameter
from gtau.robots.robot import PLAIN_FRICTION, Robot
from gtau.signals.preparation.prepared_run import Preparation
from gtau.signals.reading.statements import Payload, as_payload
from gtau.signals.run import Run

if TYPE_CHECKING:
    import polars as pl

    from gtau.estimation.diagnostics.geometry import GeometryTest
    from gtau.estimation.diagnostics.inertia_audit import InertiaAudit
    from gtau.estimation.estimators.physical_consistency import Consistency
    from gtau.estimation.results.predicted import Prediction

T = TypeVar("T")


class Forwarded(Generic[T]):
    """A field of one of the groups of a result, as a property of the result."""

    def __init__(self, group: str) -> None:
        self.group = group

    def __set_name__(self, owner: type, name: str) -> None:
        self.name, self.__doc__ = name, f"The field ``{name}`` of ``{self.group}``."

    @overload
    def __get__(self, result: None, owner: type) -> Self: ...
    @overload
    def __get__(self, result: Result, owner: type) -> T: ...
    def __get__(self, result: Result | None, owner: type) -> Self | T:
        if result is None:
            return self
        value: T = getattr(getattr(result, self.group), self.name)
        return value


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """Drive gains, parameters and payloads of a robot, identified from its logs.

    Attributes
    ----------
    robot : Robot
        The robot.
    estimates : ModelEstimates
        Estimates with which the model predicts.
    fit : FitRecord
        How they were fitted, and to what.
    evidence : Evidence
        What speaks for and against them.

    All fields of these groups are properties of the result, too.
    """

    robot: Robot
    estimates: ModelEstimates
    fit: FitRecord
    evidence: Evidence = field(default_factory=Evidence)

    drive_gains = Forwarded[Named[str]]("estimates")
    delays = Forwarded[Named[str]]("estimates")
    parameters = Forwarded[Named[Parameter]]("estimates")
    friction = Forwarded[Named[Parameter]]("estimates")
    payloads = Forwarded[tuple[PayloadEstimate, ...]]("estimates")
    sensors = Forwarded[tuple[SensorEstimate, ...]]("estimates")
    covariance_names = Forwarded[tuple[Parameter, ...]]("estimates")
    covariance = Forwarded[np.ndarray]("estimates")
    temperatures = Forwarded[ReferenceTemperatures | None]("estimates")
    consistency: ClassVar[Forwarded[Consistency | None]] = Forwarded("estimates")
    method = Forwarded[str]("fit")
    kind = Forwarded[str]("fit")
    runs = Forwarded[tuple[str, ...]]("fit")
    preparation = Forwarded[Preparation]("fit")
    residuals = Forwarded[tuple[TorqueError, ...]]("fit")
    logged_speeds = Forwarded[Mapping[str, float]]("fit")
    statistics = Forwarded[Mapping[str, float]]("fit")
    scale = Forwarded[Mapping[str, Mapping[str, float]]]("fit")
    singular_values = Forwarded[tuple[float, ...]]("fit")
    data = Forwarded[tuple[Run, ...]]("fit")
    notes = Forwarded[tuple[Finding, ...]]("evidence")
    effects = Forwarded[tuple[EstimatedEffect, ...]]("evidence")
    curves = Forwarded[Mapping[str, FrictionCurve]]("evidence")
    equation_friction = Forwarded[Named[Parameter]]("evidence")
    geometry: ClassVar[Forwarded[GeometryTest | None]] = Forwarded("evidence")
    audit: ClassVar[Forwarded[InertiaAudit | None]] = Forwarded("evidence")
    requirements = Forwarded[tuple[Requirement, ...]]("evidence")
    singularities = Forwarded[tuple[NearestPose, ...]]("evidence")
    distances = Forwarded[tuple[np.ndarray, ...]]("evidence")

    def __repr__(self) -> str:
        gains = ", ".join(f"{joint} {gain}" for joint, gain in self.drive_gains.items())
        head = f"{type(self).__name__}({self.robot.name!r}, {self.method!r}: drive gains {gains}; "
        return (
            f"{head}{len(self.parameters)} base parameters, {len(self.essential)} of them essential; "
            "print(result.summary()) shows all)"
        )

    def replaced(self, **values: Any) -> Result:
        """Return the result with other values of fields of its groups, by name."""
        groups: dict[str, dict[str, Any]] = {}
        for name, value in values.items():
            groups.setdefault(getattr(type(self), name).group, {})[name] = value
        return replace(self, **{group: replace(getattr(self, group), **fields) for group, fields in groups.items()})

    @cached_property
    def idm(self) -> InverseDynamics:
        """Inverse dynamic identification model of the robot."""
        return model_of(self.robot)

    @cached_property
    def base(self) -> BaseParameters:
        """Base parameters of motors and torque sensors together."""
        return base_of(self.robot, tuple(sensor.joint for sensor in self.sensors))

    @cached_property
    def friction_law(self) -> FrictionLaw:
        """Friction of the robot at any speed, for these and other parameters."""
        shapes = {name: estimate.value for name, estimate in self.friction.items() if name.kind in SHAPES}
        return FrictionLaw(self.idm, self.logged_speeds, {name: value for name, value in shapes.items() if value})

    @property
    def gains(self) -> np.ndarray:
        """``drive_gains`` as an array (n,), one for each of ``robot.actuated``; 1 of a floating base."""
        known = self.drive_gains
        return np.array([known[joint].value if joint in known else 1.0 for joint in self.robot.actuated], dtype=float)

    @property
    def essential(self) -> Named[Parameter]:
        """The base parameters that the reduction keeps (paper, section 5.2), with their values in ``parameters``."""
        return Named({name: estimate for name, estimate in self.parameters.items() if estimate.essential})

    @cached_property
    def friction_parameters(self) -> Mapping[Parameter, Estimate]:
        """All friction by the names of standard parameters, its shapes apart."""
        pairs = zip(self.base.standard, self.base.names, strict=True)
        listed = self.parameters
        plain = {name: listed[base] for name, base in pairs if name.kind in PLAIN_FRICTION and base in listed}
        return plain | {name: estimate for name, estimate in self.friction.items() if name.kind not in SHAPES}

    def payload(self, name: str) -> dict[str, float]:
        """Return a payload's identified parameters by kind, the mean over its runs; empty for an unknown name."""
        values_of: dict[str, list[float]] = {}
        for payload in self.payloads:
            if payload.name == name:
                for kind, estimate in payload.parameters.items():
                    if estimate.value is not None:
                        values_of.setdefault(kind, []).append(estimate.value)
        return {kind: float(np.mean(values)) for kind, values in values_of.items()}

    def summary(self, verbose: bool = True) -> str:
        """Summarise the result as text: one screen, or with ``verbose`` all of it."""
        text: str = views().text(self, verbose)
        return text

    def torques(
        self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, payload: Payload | Mapping[str, Any] | None = None
    ) -> np.ndarray:
        """Compute torques of the identified model at given states, including all its friction.

        Parameters
        ----------
        q, qd, qdd : ndarray
            Positions, velocities and accelerations (N, n) of the actuated joints, or (n,) of one state, SI units. The
            samples are taken as points of a path that starts at home.
        payload : mapping, optional
            As in an experiment file: ``{"name": "steel"}`` for one that was identified, or with its ``mass``, ...

        Returns
        -------
        ndarray
            (N, n) or (n,), N m or N.

        Raises
        ------
        GtauError
            Where the loops cannot be closed, a pose is too close to a singularity, or the payload's mass is unknown.
        """
        tau: np.ndarray = late("uses.prediction").torques(self, q, qd, qdd, as_payload(payload))
        return tau

    def currents(
        self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, payload: Payload | Mapping[str, Any] | None = None
    ) -> np.ndarray:
        """Compute the currents (N, n), A, for the torques of :meth:`torques`: ``v = tau / g_tau``.

        Delays are not applied: the current reference leads the motion by ``delays``. From logs of torques, whose gains
        are 1, they are these torques, and so are the rows of a floating base.
        """
        return self.torques(q, qd, qdd, payload) / self.gains

    def predict(self, run: Run) -> Prediction:
        """Predict torques along ``run``, beside the raw measured ``v g_tau``.

        Raises
        ------
        GtauError
            Where the run does not suit the robot, or the model refuses a sample.
        """
        prediction: Prediction = late("uses.prediction").predict(self, run)
        return prediction

    def validate(self, run: Run) -> tuple[TorqueError, ...]:
        """Compute torque errors of each joint on a run: against the raw torque, by frequency, and in the fit's band."""
        from gtau.estimation.results.predicted import torque_errors

        return torque_errors(self.predict(run), self.robot, self.preparation.bandwidth)

    @property
    def believable(self) -> bool:
        """Whether some drive gain is good, weak or given, and nothing contradictory: no estimate, payload or sensor."""
        groups = (self.delays.values(), self.parameters.values(), self.friction.values(), self.payloads, self.sensors)
        verdicts = [judged.verdict for group in groups for judged in group]
        gains = {gain.verdict.outcome for gain in self.drive_gains.values()}
        outcomes = gains | {verdict.outcome for verdict in verdicts}
        return Outcome.CONTRADICTORY not in outcomes and gains != {Outcome.NOT_IDENTIFIABLE}

    @property
    def accepted(self) -> bool:
        """Whether the result is :attr:`believable`, has all that was asked for, and meets all requirements."""
        lacking = any(note.kind == F.NO_BODIES for note in self.notes)
        return self.believable and not lacking and all(requirement.met for requirement in self.requirements)

    @property
    def plot(self) -> Any:
        """Plot the result, one figure per call: ``result.plot.torques("elbow_joint")``."""
        return views().plots(self)

    def report(self, path: str | Path) -> None:
        """Write the report of the result and its runs as one self-contained HTML file."""
        views().write(self, Path(path))

    def to_frame(self) -> pl.DataFrame:
        """Return all estimates as a Polars table, one row per estimate.

        ``pandas.DataFrame(result.to_frame().to_dict(as_series=False))`` is the same table in pandas.
        """
        frame: pl.DataFrame = late("estimation.results.table").estimates_frame(self)
        return frame

    _repr_html_ = html

    def save(self, path: str | Path) -> None:
        """Write the result as JSON, atomically; see :mod:`gtau.estimation.results.model_file`."""
        late("estimation.results.model_file").save(self, path)

    @staticmethod
    def load(path: str | Path) -> Result:
        """Load a result written by :meth:`save`; raises GtauError if the file is not one."""
        result: Result = late("estimation.results.model_file").load(path)
        return result
