"""Groups of a result: the estimates and payloads, how they were fitted, and the evidence on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gtau import display
from gtau.documents.validation import PATH, takes
from gtau.estimation.diagnostics.verdict import GOOD, Verdict
from gtau.estimation.effects.effect import EstimatedEffect
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
from gtau.findings import Finding
from gtau.robots.parameter import Parameter, RigidBody
from gtau.robots.robot import Pose
from gtau.signals.preparation.prepared_run import Preparation
from gtau.signals.run import Run

if TYPE_CHECKING:
    from gtau.estimation.diagnostics.geometry import GeometryTest
    from gtau.estimation.diagnostics.inertia_audit import InertiaAudit
    from gtau.estimation.estimators.physical_consistency import Consistency


@dataclass(frozen=True, eq=False)
class Weighed:
    """Result of a weighing for the parameters chi (10,), in the order of INERTIAL, at the frame of ``body``.

    ``sums @ chi`` (k, 10) are ``values`` with ``covariance``, ``exact @ chi`` (r, 10) are ``stated`` by the user.
    ``freedom`` are the degrees of freedom behind the covariance, None for very many; ``reach`` is the longest placement
    of the robot, m; ``by_model`` says that no other load was logged, so that the model's parameters are the reference.
    """

    body: str
    sums: np.ndarray
    values: np.ndarray
    covariance: np.ndarray
    exact: np.ndarray
    stated: np.ndarray
    freedom: float | None
    reach: float
    by_model: bool = False


@dataclass(frozen=True, eq=False)
class PayloadBody:
    """Mass, centre of mass and inertia about it of a payload, in axes of ``frame``.

    ``parameters`` are the ``QUANTITIES`` by name, without a value where the motion does not show them; products of
    inertia are entries of the tensor (``Ixy = -int x y dm``). ``rigid`` is a body that can exist: where the motion
    shows nothing, what a compact one would have; None where the mass is not identifiable. ``named`` says whether the
    frame was chosen; else it is that of the carrier.
    """

    name: str
    run: str
    frame: str
    parameters: Mapping[str, Estimate]
    rigid: RigidBody | None
    named: bool = True

    @property
    def unseen(self) -> tuple[str, ...]:
        """Names of the quantities that are not identifiable from the motion."""
        return tuple(name for name, estimate in self.parameters.items() if estimate.value is None)


@dataclass(frozen=True, repr=False)
class PayloadEstimate:
    """Inertial parameters of the payload of a run, by kind, in the frame of the body that carries it.

    ``weighed`` is what :meth:`in_frame` needs, None where the mass is known or the estimate was read from a file.
    """

    name: str
    run: str
    parameters: Mapping[str, Estimate]
    known: frozenset[str]
    verdict: Verdict = GOOD
    weighed: Weighed | None = field(default=None, compare=False)

    def __repr__(self) -> str:
        return (
            f"PayloadEstimate({self.name!r} of run {self.run!r}: mass {self.parameters.get('m', 'not identifiable')})"
        )

    _repr_html_ = display.html

    @takes(frame=("the name of a link, 'x y z roll pitch yaw', or a pose", (str, Pose)), file=PATH)
    def in_frame(self, frame: str | Pose = "", file: str | Path | None = None) -> PayloadBody:
        """Compute mass, centre of mass and inertia about it, of a physically possible body, with intervals.

        Parameters
        ----------
        frame : str or Pose
            A link of the URDF ``file`` that is fixed to the carrier (``tool0``), or the pose ``"x y z roll pitch yaw"``
            (m, rad) from the carrier's own frame, which it is by default.
        file : path, optional
            The robot's URDF.

        Raises
        ------
        GtauError
            Where there is no such frame, or the payload was not weighed.
        """
        body: PayloadBody = display.late("uses.payload_body").payload_body(self, frame, file)
        return body


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
