"""Result of an identification: its four groups, and what is done with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.display import late, views
from gtau.estimation.diagnostics.alternatives import Alternative
from gtau.estimation.diagnostics.geometry_findings import GeometryTest
from gtau.estimation.diagnostics.inertia_audit import InertiaAudit
from gtau.estimation.diagnostics.verdict import Outcome
from gtau.estimation.estimators.physical_consistency import Consistency
from gtau.estimation.friction.law import SHAPES, FrictionLaw, Shape
from gtau.estimation.results.estimate import (
    Distances,
    Estimate,
    FrictionCurve,
    Named,
    NearestPose,
    ReferenceTemperatures,
    Requirement,
    SensorEstimate,
    TorqueError,
)
from gtau.estimation.results.groups import Evidence, FitRecord, Model, ModelEstimates
from gtau.estimation.results.payload import PayloadEstimate
from gtau.estimation.results.predicted import Prediction, torque_errors
from gtau.findings import Finding
from gtau.model.base_parameters import BaseParameters
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.parameter import Parameter
from gtau.robots.robot import PLAIN_FRICTION, Robot
from gtau.signals.preparation.prepared_run import Preparation
from gtau.signals.reading.statements import Payload, as_payload
from gtau.signals.run import Run

if TYPE_CHECKING:
    import polars as pl


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """Drive gains, parameters and payloads of a robot, identified from its logs.

    Attributes
    ----------
    model : Model
        The robot, its inverse dynamic model and its base parameters.
    estimates : ModelEstimates
        Estimates with which the model predicts.
    fit : FitRecord
        How they were fitted, and to what.
    evidence : Evidence
        What speaks for and against them.

    All fields of these groups are properties of the result, too.
    """

    model: Model
    estimates: ModelEstimates
    fit: FitRecord
    evidence: Evidence = field(default_factory=Evidence)

    def __repr__(self) -> str:
        gains = ", ".join(f"{joint} {gain}" for joint, gain in self.drive_gains.items())
        head = f"{type(self).__name__}({self.robot.name!r}, {self.method!r}: drive gains {gains}; "
        return (
            f"{head}{len(self.parameters)} base parameters, {len(self.essential)} of them essential; "
            "print(result.summary()) shows all)"
        )

    def replaced(self, **values: Any) -> Result:
        """Return the result with other values of fields of its groups, by name."""
        fields = {
            key: value for group in (self.estimates, self.fit, self.evidence) for key, value in vars(group).items()
        }
        return result_of(values.pop("model", self.model), **fields | values)

    @property
    def robot(self) -> Robot:
        """Its robot."""
        return self.model.robot

    @property
    def idm(self) -> InverseDynamics:
        """Its inverse dynamic identification model."""
        return self.model.idm

    @property
    def base(self) -> BaseParameters:
        """Its base parameters."""
        return self.model.base

    @property
    def drive_gains(self) -> Named[str]:
        """Drive gains by joint, N m/A or N/A; of logged torques the factors that make them true."""
        return self.estimates.drive_gains

    @property
    def delays(self) -> Named[str]:
        """Delays of the current references by joint, s."""
        return self.estimates.delays

    @property
    def parameters(self) -> Named[Parameter]:
        """All base parameters, with which the model predicts."""
        return self.estimates.parameters

    @property
    def friction(self) -> Named[Parameter]:
        """Friction with which the model predicts beyond that among the base parameters."""
        return self.estimates.friction

    @property
    def payloads(self) -> tuple[PayloadEstimate, ...]:
        """One entry for each loaded run."""
        return self.estimates.payloads

    @property
    def sensors(self) -> tuple[SensorEstimate, ...]:
        """Sensors of joints, behind their drives."""
        return self.estimates.sensors

    @property
    def covariance_names(self) -> tuple[Parameter, ...]:
        """Names of the rows of the covariance."""
        return self.estimates.covariance_names

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of parameters, gains and delays."""
        return self.estimates.covariance

    @property
    def temperatures(self) -> ReferenceTemperatures | None:
        """Temperatures at which friction has its values."""
        return self.estimates.temperatures

    @property
    def consistency(self) -> Consistency | None:
        """Physically consistent standard parameters."""
        return self.estimates.consistency

    @property
    def method(self) -> str:
        """Name of the estimator."""
        return self.fit.method

    @property
    def kind(self) -> str:
        """``current`` or ``torque``: what was logged."""
        return self.fit.kind

    @property
    def runs(self) -> tuple[str, ...]:
        """Names of the runs."""
        return self.fit.runs

    @property
    def preparation(self) -> Preparation:
        """How the logs were filtered and decimated."""
        return self.fit.preparation

    @property
    def residuals(self) -> tuple[TorqueError, ...]:
        """Torque errors over the rows used."""
        return self.fit.residuals

    @property
    def logged_speeds(self) -> Mapping[str, float]:
        """Largest speed of each actuated joint among these, rad/s or m/s."""
        return self.fit.logged_speeds

    @property
    def statistics(self) -> Mapping[str, float]:
        """Further figures of the method."""
        return self.fit.statistics

    @property
    def singular_values(self) -> tuple[float, ...]:
        """Singular values of ``W_tot`` (eq. 33), in falling order."""
        return self.fit.singular_values

    @property
    def data(self) -> tuple[Run, ...]:
        """The runs; empty for a result read from a file."""
        return self.fit.data

    @property
    def notes(self) -> tuple[Finding, ...]:
        """What was repaired, left out, or is not to be trusted."""
        return self.evidence.notes

    @property
    def alternatives(self) -> tuple[Alternative, ...]:
        """What the model may lack, and by how much that would move the gains."""
        return self.evidence.alternatives

    @property
    def curves(self) -> Mapping[str, FrictionCurve]:
        """What the data say of friction on all samples, by joint."""
        return self.evidence.curves

    @property
    def equation_friction(self) -> Named[Parameter]:
        """Friction in the equations that give gains and inertia."""
        return self.evidence.equation_friction

    @property
    def geometry(self) -> GeometryTest | None:
        """What logged poses say of the robot's geometry."""
        return self.evidence.geometry

    @property
    def audit(self) -> InertiaAudit | None:
        """How well the inertias of the robot's file predict."""
        return self.evidence.audit

    @property
    def requirements(self) -> tuple[Requirement, ...]:
        """What the experiment file requires, and what was found of it."""
        return self.evidence.requirements

    @property
    def singularities(self) -> tuple[NearestPose, ...]:
        """Where each run comes nearest to singularities."""
        return self.evidence.singularities

    @property
    def distances(self) -> tuple[Distances, ...]:
        """Distances to singularities along the runs."""
        return self.evidence.distances

    @cached_property
    def friction_law(self) -> FrictionLaw:
        """Friction of the robot at any speed, for these and other parameters."""
        values = {name: each.value for name, each in self.friction.items()}
        shapes = {
            joint: Shape(values.get(Parameter("width", joint)), values.get(Parameter("vs", joint)))
            for joint in self.curves
        }
        return FrictionLaw(self.idm, self.logged_speeds, shapes)

    @property
    def gains(self) -> np.ndarray:
        """Gains of the rows of the model, (n,): of the motors, N m/A or N/A, and 1 of a floating base."""
        known = self.drive_gains
        return np.array([known[joint].value if joint in known else 1.0 for joint in self.robot.actuated], dtype=float)

    @property
    def essential(self) -> Named[Parameter]:
        """The base parameters that the reduction keeps (paper, section 5.2), with their values in ``parameters``."""
        return Named({name: each for name, each in self.parameters.items() if each.essential})

    @property
    def params(self) -> dict[Parameter, float]:
        """Values of ``parameters`` by name; 0 for one that is not identifiable."""
        return {name: estimate.value or 0.0 for name, estimate in self.parameters.items()}

    @cached_property
    def friction_parameters(self) -> Mapping[Parameter, Estimate]:
        """All friction by the names of standard parameters, its shapes apart."""
        pairs = zip(self.base.standard, self.base.names, strict=True)
        listed = self.parameters
        plain = {name: listed[base] for name, base in pairs if name.kind in PLAIN_FRICTION and base in listed}
        return plain | {name: each for name, each in self.friction.items() if name.kind not in SHAPES}

    def payload(self, name: str) -> dict[str, float]:
        """Return a payload's identified parameters by kind, the mean over its runs; empty for an unknown name."""
        found: dict[str, list[float]] = {}
        for each in self.payloads:
            if each.name == name:
                for kind, estimate in each.parameters.items():
                    if estimate.value is not None:
                        found.setdefault(kind, []).append(estimate.value)
        return {kind: float(np.mean(values)) for kind, values in found.items()}

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
            Positions, velocities and accelerations (N, n) of the actuated joints, SI units. The samples are taken as
            points of a path that starts at home.
        payload : mapping, optional
            As in an experiment file: ``{"name": "steel"}`` for one that was identified, or with its ``mass``, ...

        Returns
        -------
        ndarray
            (N, n), N m or N.

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
        """Whether the result is :attr:`believable` and meets all requirements of the experiment file."""
        return self.believable and all(each.met for each in self.requirements)

    @property
    def plot(self) -> Any:
        """Plot the result, one figure per call: ``result.plot.torques("elbow_joint")``."""
        return views().plots(self)

    def report(self, path: str | Path) -> None:
        """Write the report of the result and its runs as one self-contained HTML file."""
        views().write(self, Path(path))

    def to_frame(self) -> pl.DataFrame:
        """Return all estimates as a Polars table, one row per estimate; ``to_frame().to_pandas()`` converts it."""
        frame: pl.DataFrame = late("estimation.results.table").estimates_frame(self)
        return frame

    def _repr_html_(self) -> str:
        html: str = views().html(self)
        return html

    def save(self, path: str | Path) -> None:
        """Write the result as JSON, atomically; see :mod:`gtau.estimation.results.model_file`."""
        late("estimation.results.model_file").save(self, path)

    @staticmethod
    def load(path: str | Path) -> Result:
        """Load a result written by :meth:`save`; raises GtauError if the file is not one."""
        result: Result = late("estimation.results.model_file").load(path)
        return result


def result_of(model: Model, **values: Any) -> Result:
    """Make a result of the fields of its groups, by name; raises TypeError where one is of none."""
    of_groups = [
        {key: values.pop(key) for key in tuple(values) if key in group.__dataclass_fields__}
        for group in (ModelEstimates, FitRecord, Evidence)
    ]
    if values:
        raise TypeError(f"a result has no '{next(iter(values))}'")
    estimates, fit, evidence = of_groups
    return Result(model, ModelEstimates(**estimates), FitRecord(**fit), Evidence(**evidence))
