"""Groups of a result: the estimates and payloads, how they were fitted, and the evidence on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from gtau.estimation.effects.effect import EstimatedEffect
from gtau.estimation.results.estimate import (
    FrictionCurve,
    Named,
    NearestPose,
    ReferenceTemperatures,
    Requirement,
    SensorEstimate,
    TorqueError,
)
from gtau.estimation.results.payload_body import PayloadEstimate
from gtau.findings import Finding
from gtau.robots.parameter import Parameter
from gtau.signals.preparation.prepared_run import Preparation
from gtau.signals.run import Run

if TYPE_CHECKING:
    from gtau.estimation.diagnostics.geometry import GeometryTest
    from gtau.estimation.diagnostics.inertia_audit import InertiaAudit
    from gtau.estimation.estimators.physical_consistency import Consistency


@dataclass(frozen=True, eq=False)
class ModelEstimates:
    """Estimates with which the model predicts.

    Attributes
    ----------
    drive_gains, delays : dict
        Joint name to :class:`Estimate`.
    parameters : dict
        All base parameters, friction on all samples among them; name to Estimate. ``essential`` of each says whether
        the reduction keeps it. As in the paper, ``as_paper`` estimates the kept ones again without the others, whose
        value is then None.
    friction : dict
        Friction beyond that among the base parameters: ``fb_J``, ``fl_J``, ``fvt_J``, ``fst_J``, and in ``width_J`` and
        ``vs_J`` the width of presliding and the speed at which it bends; for the paper's way the terms of the
        equations, ``f3_J`` among them. Name to Estimate.
    payloads : tuple of PayloadEstimate
        One entry for each loaded run.
    covariance_names, covariance : tuple of Parameter, ndarray
        Of parameters, gains and delays, by the block jackknife.
    sensors : tuple of SensorEstimate
        Sensors of joints, behind their drives, with what was estimated of each.
    temperatures : ReferenceTemperatures, optional
        At which friction has these values, where temperatures were logged.
    consistency : Consistency, optional
        Physically consistent standard parameters, if requested.
    """

    drive_gains: Named[str]
    delays: Named[str]
    parameters: Named[Parameter]
    friction: Named[Parameter]
    payloads: tuple[PayloadEstimate, ...]
    covariance_names: tuple[Parameter, ...]
    covariance: np.ndarray
    sensors: tuple[SensorEstimate, ...] = ()
    temperatures: ReferenceTemperatures | None = None
    consistency: Consistency | None = None

    def __post_init__(self) -> None:
        for name in ("drive_gains", "delays", "parameters", "friction"):
            object.__setattr__(self, name, Named(getattr(self, name)))


@dataclass(frozen=True, eq=False)
class FitRecord:
    """How the estimates were fitted, and to what.

    Attributes
    ----------
    method, kind : str
        A name of :data:`gtau.estimation.estimators.registry.NAMES`; whether logs hold currents or torques.
    runs : tuple of str
        Names of the runs.
    preparation : Preparation
        How the logs were filtered and decimated.
    residuals : tuple of TorqueError
        Over the rows used.
    logged_speeds : dict
        Actuated joint to its largest speed among the rows used, rad/s or m/s; beyond it friction is extrapolated (see
        :mod:`gtau.estimation.friction.law`).
    statistics : dict
        Further figures of the method.
    scale : dict
        Joint to what the scale of its drive gain rests on, in shares that add up to one; see
        :func:`gtau.estimation.diagnostics.stated_constants.scale_shares`.
    singular_values : tuple of float
        Of ``W_tot`` (eq. 33) in falling order, rows weighted by the residuals and columns of unit length; empty where
        the gains were given, and not held by ``model.json``.
    data : tuple of Run
        The runs themselves, for predictions and figures; ``model.json`` does not hold them.
    """

    method: str
    kind: str
    runs: tuple[str, ...]
    preparation: Preparation
    residuals: tuple[TorqueError, ...]
    logged_speeds: Mapping[str, float]
    statistics: Mapping[str, float]
    scale: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    singular_values: tuple[float, ...] = ()
    data: tuple[Run, ...] = ()


@dataclass(frozen=True, eq=False)
class Evidence:
    """What speaks for and against the estimates.

    Attributes
    ----------
    notes : tuple of Finding
        What was repaired, left out, or is not to be trusted; each has its ``severity``.
    effects : tuple of EstimatedEffect
        What model and description may lack, as the data show it, and by how much that moves the gains.
    curves : dict
        What the data say of friction on all samples, at these gains and inertia; joint to FrictionCurve. Empty for the
        paper's way.
    equation_friction : dict
        Friction in the equations that give gains and inertia, which leave out samples near reversals; name to Estimate.
        Empty for the paper's way, whose equations predict.
    geometry : GeometryTest, optional
        What logged poses say of the robot's geometry.
    audit : InertiaAudit, optional
        How well the inertias of the robot's file predict the torques, and which of them the data contradict; None where
        the file states none.
    requirements : tuple of Requirement
        What the experiment file requires, and what was found of it.
    singularities : tuple of NearestPose
        Where each run comes nearest to singularities of either type.
    distances : tuple of ndarray
        Of each run: ``time``, s, and distances to singularities, ``type_1`` and ``type_2``, at its decimated samples.
        They are reciprocal condition numbers, 1 at best and 0 at a singularity, NaN where the robot has none of a type.
        ``model.json`` does not hold them.
    """

    notes: tuple[Finding, ...] = ()
    effects: tuple[EstimatedEffect, ...] = ()
    curves: Mapping[str, FrictionCurve] = field(default_factory=dict)
    equation_friction: Named[Parameter] = field(default_factory=Named)
    geometry: GeometryTest | None = None
    audit: InertiaAudit | None = None
    requirements: tuple[Requirement, ...] = ()
    singularities: tuple[NearestPose, ...] = ()
    distances: tuple[np.ndarray, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "equation_friction", Named(self.equation_friction))
