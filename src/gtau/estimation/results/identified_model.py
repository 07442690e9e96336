"""Identified model: plain data that people read and programs load, and the table of all its estimates."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from gtau.estimation.diagnostics.geometry_findings import GeometryTest
from gtau.estimation.diagnostics.inertia_audit import InertiaAudit
from gtau.estimation.diagnostics.verdict import Outcome
from gtau.estimation.estimators.physical_consistency import Consistency
from gtau.estimation.friction.law import FrictionLaw, Shape
from gtau.estimation.results.estimate import (
    AlternativeMoves,
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
from gtau.estimation.results.payload import PayloadEstimate
from gtau.model.base_parameters import BaseParameters, base_parameters
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.parameter import parameter_of
from gtau.robots.robot import Robot
from gtau.signals.notes import Note
from gtau.signals.preparation import Preparation
from gtau.signals.run import Run

if TYPE_CHECKING:
    import polars as pl

FRICTION = ("fv", "fs", "off")
"""Kinds of base parameters that are listed as friction."""


@dataclass(frozen=True, eq=False, repr=False)
class IdentifiedModel:
    """Drive gains, parameters and payloads of a robot, identified from its logs.

    Attributes
    ----------
    robot : Robot
        The robot.
    method : str
        One of :data:`gtau.estimation.estimators.registry.ESTIMATORS`.
    drive_gains, delays : dict
        Joint name to :class:`Estimate`.
    friction : dict
        Friction terms beyond the paper's that the data ask for, in the equations that give gains and inertia; name to
        Estimate.
    curves : dict
        Friction as the model predicts it, identified on all samples at these gains and inertia; joint to FrictionCurve.
        Empty for the paper's way, where ``parameters`` and ``friction`` predict.
    parameters : dict
        All base parameters, with which the model predicts; name to Estimate. ``essential`` of each says whether the
        reduction keeps it. As in the paper, ``as_paper`` estimates the kept ones again without the others, whose value
        is then None.
    payloads : tuple of PayloadEstimate
        One entry for each loaded run.
    residuals : tuple of TorqueError
        Over the rows used.
    covariance : ndarray
        (parameters, gains, delays), with rows named by ``covariance_names``; block jackknife.
    preparation : Preparation
        How the logs were filtered and decimated.
    logged_speeds : dict
        Actuated joint to its largest speed among the rows used, rad/s or m/s; beyond it friction is extrapolated (see
        :mod:`gtau.estimation.friction.law`).
    statistics : dict
        Further figures of the method.
    notes : tuple of Note
        What was repaired, left out, or is not to be trusted; :mod:`gtau.estimation.grades` grades them.
    consistency : Consistency, optional
        Physically consistent standard parameters, if requested.
    alternatives : tuple of AlternativeMoves
        What the model may lack, and by how much that would move the gains.
    temperatures : ReferenceTemperatures, optional
        At which friction has the values of ``parameters``, where temperatures were logged.
    geometry : GeometryTest, optional
        What logged poses say of the robot's geometry.
    singularities : tuple of NearestPose
        Where each run comes nearest to singularities of either type.
    distances : tuple of Distances
        The distances to singularities at each run's decimated samples; ``model.json`` does not hold them.
    data : tuple of Run
        The runs themselves, for predictions and figures; ``model.json`` does not hold them.
    sensors : tuple of SensorEstimate
        Sensors of joints, behind their drives, with what was estimated of each.
    singular_values : tuple of float
        Of ``W_tot`` (eq. 33) in falling order, rows weighted by the residuals and columns of unit length; empty where
        the gains were given, and not held by ``model.json``.
    audit : InertiaAudit, optional
        How well the inertias of the robot's file predict the torques, and which of them the data contradict; None where
        the file states none.
    requirements : tuple of Requirement
        What the experiment file requires, and what was found of it.
    known : tuple of InverseDynamics and BaseParameters, optional
        The robot's model and base parameters, where the identification has them already; else they are derived.
    """

    robot: Robot
    method: str
    kind: str
    drive_gains: Mapping[str, Estimate]
    delays: Mapping[str, Estimate]
    parameters: Mapping[str, Estimate]
    friction: Mapping[str, Estimate]
    payloads: tuple[PayloadEstimate, ...]
    residuals: tuple[TorqueError, ...]
    covariance_names: tuple[str, ...]
    covariance: np.ndarray
    preparation: Preparation
    logged_speeds: Mapping[str, float]
    statistics: Mapping[str, float]
    runs: tuple[str, ...]
    notes: tuple[Note, ...]
    consistency: Consistency | None = None
    alternatives: tuple[AlternativeMoves, ...] = ()
    singularities: tuple[NearestPose, ...] = ()
    distances: tuple[Distances, ...] = ()
    data: tuple[Run, ...] = ()
    sensors: tuple[SensorEstimate, ...] = ()
    singular_values: tuple[float, ...] = ()
    geometry: GeometryTest | None = None
    temperatures: ReferenceTemperatures | None = None
    curves: Mapping[str, FrictionCurve] = field(default_factory=dict)
    requirements: tuple[Requirement, ...] = ()
    audit: InertiaAudit | None = None
    known: tuple[InverseDynamics, BaseParameters] | None = None

    def __post_init__(self) -> None:
        for name in ("drive_gains", "delays", "parameters", "friction"):
            object.__setattr__(self, name, Named(getattr(self, name)))

    def __repr__(self) -> str:
        gains = ", ".join(f"{joint} {gain}" for joint, gain in self.drive_gains.items())
        head = f"{type(self).__name__}({self.robot.name!r}, {self.method!r}: drive gains {gains}; "
        return (
            f"{head}{len(self.parameters)} base parameters, {len(self.essential)} of them essential; "
            "print(result.summary()) shows all)"
        )

    @cached_property
    def model(self) -> InverseDynamics:
        """The robot's model."""
        return self.known[0] if self.known else InverseDynamics(self.robot)

    @cached_property
    def base(self) -> BaseParameters:
        """The robot's base parameters, of motors and torque sensors together."""
        if self.known:
            return self.known[1]
        return base_parameters(self.model, sensors=[each.joint for each in self.sensors])

    @cached_property
    def friction_law(self) -> FrictionLaw:
        """Friction of the robot at any speed, for these and other parameters."""
        shapes = {
            joint: Shape(*(None if each is None else each.value for each in (curve.width, curve.speed)))
            for joint, curve in self.curves.items()
        }
        return FrictionLaw(self.model, self.logged_speeds, shapes)

    @property
    def gains(self) -> np.ndarray:
        """Gains of the rows of the model, (n,): of the motors, N m/A or N/A, and 1 of a floating base."""
        known = self.drive_gains
        return np.array([known[joint].value if joint in known else 1.0 for joint in self.robot.actuated], dtype=float)

    @property
    def essential(self) -> Named:
        """The base parameters that the reduction keeps (paper, section 5.2), with their values in ``parameters``."""
        return Named({name: each for name, each in self.parameters.items() if each.essential})

    @property
    def params(self) -> dict[str, float]:
        """Values of ``parameters`` by name; 0 for one that is not identifiable."""
        return {name: estimate.value or 0.0 for name, estimate in self.parameters.items()}

    @cached_property
    def friction_parameters(self) -> Mapping[str, Estimate]:
        """Friction used in predictions, by the names of standard parameters: of the curves, else of the plain law."""
        if not self.curves:
            return self.friction
        return {name: each for curve in self.curves.values() for name, each in curve.parameters.items()}

    @property
    def believable(self) -> bool:
        """Whether some drive gain is good, weak or given, and nothing contradictory: no estimate, payload or sensor."""
        estimates = (*self.delays.values(), *self.parameters.values(), *self.friction.values())
        verdicts = [each.verdict for of in (estimates, self.payloads, self.sensors) for each in of]
        gains = {gain.verdict.outcome for gain in self.drive_gains.values()}
        outcomes = gains | {verdict.outcome for verdict in verdicts}
        return Outcome.CONTRADICTORY not in outcomes and gains != {Outcome.NOT_IDENTIFIABLE}

    def payload(self, name: str) -> dict[str, float]:
        """Return a payload's identified parameters by kind, the mean over its runs; empty for an unknown name."""
        found: dict[str, list[float]] = {}
        for each in self.payloads:
            if each.name == name:
                for kind, estimate in each.parameters.items():
                    if estimate.value is not None:
                        found.setdefault(kind, []).append(estimate.value)
        return {kind: float(np.mean(values)) for kind, values in found.items()}


class Row(NamedTuple):
    """An estimate in its group."""

    group: str
    estimate: Estimate


def estimates_table(result: IdentifiedModel) -> Iterator[Row]:
    """List all estimates of a result, each once.

    Groups: ``drive gain``, ``delay``, ``base parameter``, ``friction`` (viscous, Coulomb and offsets, and then the
    terms that the data ask for), ``predicted friction`` (of all samples, with which the model predicts), ``logged
    speed`` (up to which friction is identified), ``torque sensor JOINT`` and ``payload NAME of RUN``.
    """
    friction = {name: parameter_of(name).kind in FRICTION for name in result.parameters}
    robot = result.robot
    speeds = [
        Estimate(joint, speed, None, f"{robot.joint(joint).unit}/s") for joint, speed in result.logged_speeds.items()
    ]
    groups: list[tuple[str, Iterable[Estimate]]] = [
        ("drive gain", result.drive_gains.values()),
        ("delay", result.delays.values()),
        ("base parameter", [each for name, each in result.parameters.items() if not friction[name]]),
        ("friction", [each for name, each in result.parameters.items() if friction[name]]),
        ("friction", result.friction.values()),
        *(("predicted friction", curve.estimates) for curve in result.curves.values()),
        ("logged speed", speeds),
        *((f"{each.kind.name} {each.joint}", each.parameters.values()) for each in result.sensors),
        *((f"payload {each.name} of {each.run}", each.parameters.values()) for each in result.payloads),
    ]
    return (Row(group, each) for group, estimates in groups for each in estimates)


def estimates_frame(result: IdentifiedModel) -> pl.DataFrame:
    """Tabulate all estimates of a result, one row each.

    Columns: ``group`` (see :func:`estimates_table`), ``name``, ``value``, ``std``, ``rel_std`` (per cent), ``low`` and
    ``high`` of the 95 % interval, ``unit``, ``verdict``, ``essential`` (whether the reduction keeps a base parameter;
    null for other estimates) and ``regrouping``. Null where there is no value.
    """
    import polars as pl

    numbers = dict.fromkeys(("value", "std", "rel_std", "low", "high"), pl.Float64)
    texts = dict.fromkeys(("group", "name"), pl.String)
    rest = {"unit": pl.String, "verdict": pl.String, "essential": pl.Boolean, "regrouping": pl.String}
    rows = []
    for group, each in estimates_table(result):
        interval, verdict = each.interval() or (None, None), each.verdict.outcome.value
        numbered = (each.value, each.std, each.rel_std, *interval)
        rows.append((group, each.name, *numbered, each.unit, verdict, each.essential, each.regrouping))
    return pl.DataFrame(rows, schema={**texts, **numbers, **rest}, orient="row")
