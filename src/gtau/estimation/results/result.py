"""Identified model of a robot: its estimates, how they were fitted, the evidence on them, and what follows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from gtau.errors import UnknownName
from gtau.estimation.effects.effect import EstimatedEffect
from gtau.estimation.friction.curves import FrictionCurve, ReferenceTemperatures
from gtau.estimation.friction.law import FrictionLaw
from gtau.estimation.results.estimate import Estimate, Named, NearestPose, Requirement, SensorEstimate, TorqueError
from gtau.estimation.results.payload_body import PayloadEstimate
from gtau.findings import Finding, Grade
from gtau.model.base_parameters import BaseParameters, Equations
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.parameter import SHAPES, Parameter
from gtau.robots.robot import PLAIN_FRICTION, Robot
from gtau.signals.preparation.filters import Preparation
from gtau.signals.reading.experiment import Recording
from gtau.signals.run import Run

if TYPE_CHECKING:
    import polars as pl

    from gtau.estimation.diagnostics.geometry import GeometryTest
    from gtau.estimation.diagnostics.inertia_audit import InertiaAudit
    from gtau.estimation.estimators.physical_consistency import Consistency

NO_BODIES = "no physically consistent parameters"


@dataclass(frozen=True, eq=False, repr=False)
class IdentifiedModel:
    """Drive gains, parameters and payloads of a robot, identified from its logs.

    Attributes
    ----------
    equations : Equations
        The robot's inverse dynamic model, and its base parameters.
    drive_gains, delays : dict
        Joint to :class:`Estimate`: N m/A or N per A, for logged torques the factor that makes them true; s.
    parameters : dict
        All base parameters, friction on all samples among them; name to Estimate. If ``as_paper``, only the essential
        ones have a value.
    friction : dict
        Friction beyond that among the base parameters: ``fb_J``, ``fl_J``, ``fvt_J``, ``fst_J``, and in ``width_J`` and
        ``vs_J`` the width of presliding and the speed at which it bends; in the paper's way the terms of the equations,
        ``f3_J`` among them. Name to Estimate.
    payloads : tuple of PayloadEstimate
        One entry for each loaded run.
    covariance_names, covariance : tuple of Parameter, ndarray
        Of parameters, gains and delays, by the block jackknife.
    method, kind : str
        Name of the estimator; whether logs hold currents or torques.
    runs : tuple of str
        Names of the runs.
    preparation : Preparation
        How the logs were filtered and decimated.
    residuals : tuple of TorqueError
        Torque errors of each joint over the rows used.
    logged_speeds : dict
        Actuated joint to its largest speed among the rows used, rad/s or m/s; friction is extrapolated beyond.
    statistics : dict
        Further figures of the method.
    sensors : tuple of SensorEstimate
        Torque sensors of joints, with what was estimated of each.
    temperatures : ReferenceTemperatures, optional
        At which friction has these values, where temperatures were logged.
    consistency : Consistency, optional
        Physically consistent standard parameters, if requested.
    scale : dict
        Joint to what the scale of its drive gain rests on, in shares that add up to one.
    singular_values : tuple of float
        Of ``W_tot`` (eq. 33) in falling order, rows weighted and columns of unit length; empty where the gains were
        given. ``model.json`` holds neither these, nor ``data`` or ``distances``.
    data : tuple of Run
        The runs themselves.
    notes : tuple of Finding
        What was repaired, left out, or is not to be trusted.
    effects : tuple of EstimatedEffect
        What model and description may lack, as the data show it, and by how much that moves the gains.
    curves : dict
        What the data say of friction on all samples; joint to FrictionCurve. Empty for the paper's way.
    equation_friction : dict
        Friction in the equations that give gains and inertia, which leave out samples near reversals.
    geometry : GeometryTest, optional
        What logged poses say of the robot's geometry.
    motors : dict
        Back-EMF constant ``ke_J`` and resistance ``R_J`` of the motors whose voltages were logged; name to Estimate.
    audit : InertiaAudit, optional
        What the data say of the inertias of the robot's file.
    requirements : tuple of Requirement
        What the experiment file requires, and what was found of it.
    singularities : tuple of NearestPose
        Where each run comes nearest to singularities of either type.
    recording : Recording, optional
        Columns and units of its logs, by which further logs of the recorder are read; None where its runs differ.
    distances : tuple of ndarray
        Of each run: ``time``, s, and distances to singularities, ``type_1`` and ``type_2``, at its decimated samples:
        reciprocal condition numbers, 0 at a singularity, NaN where the robot has none of a type.
    """

    equations: Equations
    drive_gains: Named[str]
    delays: Named[str]
    parameters: Named[Parameter]
    friction: Named[Parameter]
    payloads: tuple[PayloadEstimate, ...]
    covariance_names: tuple[Parameter, ...]
    covariance: np.ndarray
    method: str
    kind: str
    runs: tuple[str, ...]
    preparation: Preparation
    residuals: tuple[TorqueError, ...]
    logged_speeds: Mapping[str, float]
    statistics: Mapping[str, float]
    sensors: tuple[SensorEstimate, ...] = ()
    temperatures: ReferenceTemperatures | None = None
    consistency: Consistency | None = None
    scale: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    singular_values: tuple[float, ...] = ()
    data: tuple[Run, ...] = ()
    notes: tuple[Finding, ...] = ()
    effects: tuple[EstimatedEffect, ...] = ()
    curves: Mapping[str, FrictionCurve] = field(default_factory=dict)
    equation_friction: Named[Parameter] = field(default_factory=Named)
    motors: Named[Parameter] = field(default_factory=Named)
    geometry: GeometryTest | None = None
    audit: InertiaAudit | None = None
    requirements: tuple[Requirement, ...] = ()
    singularities: tuple[NearestPose, ...] = ()
    recording: Recording | None = None
    distances: tuple[np.ndarray, ...] = ()

    def __post_init__(self) -> None:
        for name in ("drive_gains", "delays", "parameters", "friction", "equation_friction", "motors"):
            object.__setattr__(self, name, Named(getattr(self, name)))

    def __repr__(self) -> str:
        gains = ", ".join(f"{joint} {gain}" for joint, gain in self.drive_gains.items())
        head = f"{type(self).__name__}({self.robot.name!r}, {self.method!r}: drive gains {gains}; "
        return (
            f"{head}{len(self.parameters)} base parameters, {len(self.essential)} of them essential; "
            "print(result.summary()) shows all)"
        )

    def replaced(self, **values: Any) -> Self:
        """Return the result with other values of some attributes."""
        return replace(self, **values)

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self.equations.model.robot

    @property
    def idm(self) -> InverseDynamics:
        """Inverse dynamic identification model of the robot."""
        return self.equations.model

    @property
    def base(self) -> BaseParameters:
        """Base parameters of motors and torque sensors together."""
        return self.equations.base

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

    @cached_property
    def payload_values(self) -> dict[str, dict[str, float]]:
        """Identified parameters of each payload by its name and by kind, means over its runs."""
        values: dict[str, dict[str, list[float]]] = {payload.name: {} for payload in self.payloads}
        for payload in self.payloads:
            for kind, estimate in payload.parameters.items():
                if estimate.value is not None:
                    values[payload.name].setdefault(kind, []).append(estimate.value)
        return {name: {kind: float(np.mean(of)) for kind, of in kinds.items()} for name, kinds in values.items()}

    def payload(self, name: str) -> dict[str, float]:
        """Return a payload's identified parameters by kind, the mean over its runs; raises GtauError for a new name."""
        if name not in self.payload_values:
            known = ", ".join(self.payload_values) or "none"
            raise UnknownName(f"the model knows no payload '{name}'; choose from {known}.")
        return self.payload_values[name]

    @property
    def believable(self) -> bool:
        """Whether some drive gain is good, weak or given, and none, nor a delay, payload or sensor, contradictory.

        An impossible parameter contradicts gains where it has an effect on them.
        """
        groups = (self.delays.values(), self.payloads, self.sensors)
        verdicts = [judged.verdict for group in groups for judged in group]
        gains = {gain.verdict.outcome for gain in self.drive_gains.values()}
        outcomes = gains | {verdict.outcome for verdict in verdicts}
        return Grade.CONTRADICTORY not in outcomes and gains != {Grade.NOT_IDENTIFIABLE}

    @property
    def accepted(self) -> bool:
        """Whether the result is :attr:`believable`, has all that was asked for, and meets all requirements."""
        lacking = any(note.kind == NO_BODIES for note in self.notes)
        return self.believable and not lacking and all(requirement.met for requirement in self.requirements)


def estimates_table(result: IdentifiedModel) -> Iterator[tuple[str, Estimate]]:
    """List all estimates of a result with their groups, each once.

    Groups: ``drive gain``, ``delay``, ``base parameter``, ``friction`` (viscous, Coulomb and offsets, and then the
    terms that the data ask for), ``motor`` (back-EMF constant and resistance), ``logged speed`` (up to which friction
    is identified), ``torque sensor JOINT`` and ``payload NAME of RUN``.
    """
    friction = {name: name.kind in PLAIN_FRICTION for name in result.parameters}
    robot = result.robot
    speeds = [
        Estimate(joint, speed, None, f"{robot.joint(joint).unit}/s") for joint, speed in result.logged_speeds.items()
    ]
    groups: list[tuple[str, Iterable[Estimate]]] = [
        ("drive gain", result.drive_gains.values()),
        ("delay", result.delays.values()),
        ("base parameter", [estimate for name, estimate in result.parameters.items() if not friction[name]]),
        ("friction", [estimate for name, estimate in result.parameters.items() if friction[name]]),
        ("friction", result.friction.values()),
        ("motor", result.motors.values()),
        ("logged speed", speeds),
        *((f"{sensor.kind.name} {sensor.joint}", sensor.parameters.values()) for sensor in result.sensors),
        *((f"payload {payload.name} of {payload.run}", payload.parameters.values()) for payload in result.payloads),
    ]
    return ((group, estimate) for group, estimates in groups for estimate in estimates)


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
    for group, estimate in estimates_table(result):
        interval = estimate.interval() or (None, None)
        verdict = estimate.verdict.outcome.value
        numbered = (estimate.value, estimate.std, estimate.rel_std, *interval)
        rows.append((group, estimate.name, *numbered, estimate.unit, verdict, estimate.essential, estimate.regrouping))
    return pl.DataFrame(rows, schema={**texts, **numbers, **rest}, orient="row")
