"""Identify from reduced runs: the steps from factors to a result, the same for every estimator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gtau.estimation.diagnostics.diagnose import diagnose
from gtau.estimation.diagnostics.examine import examine, uncertainty_of
from gtau.estimation.diagnostics.inertia_audit import audit_inertias, prior_findings, without_file_inertias
from gtau.estimation.diagnostics.sentences import note
from gtau.estimation.diagnostics.stated_constants import weigh_known
from gtau.estimation.estimators.essential import essential_fit, select_friction
from gtau.estimation.estimators.estimator import Estimator, Given
from gtau.estimation.estimators.physical_consistency import consistent as find_consistent
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.friction import PAPER
from gtau.estimation.results.build import build_result
from gtau.estimation.results.friction_curves import friction_curves
from gtau.estimation.results.result import Result
from gtau.estimation.thresholds.estimates import ACCURACY


@dataclass(frozen=True)
class Options:
    """Options of an identification beside the estimator.

    Attributes
    ----------
    decimator : {"fir", "chebyshev"}
        The compact FIR, or the paper's filter.
    select_friction : bool
        Select friction terms from the data, or take the paper's: viscous and Coulomb friction, the same in all runs.
    delays : bool
        Estimate a delay of each joint's current.
    correlated : bool
        Covariances by the block jackknife, which allows for residuals correlated in time, or by the method's formula.
    ratio : float, optional
        The paper's r_sigma for the essential parameters; without one the Bayesian information criterion decides.
    all_samples : bool
        Identify friction on all samples, at these gains and inertial parameters; predictions take it.
    joint_reduction : bool
        Estimate the gains again together with the essential parameters, as the paper does.
    accuracy : float
        Half the relative width of the 95 % interval up to which a gain is good.
    """

    decimator: Literal["fir", "chebyshev"] = "fir"
    select_friction: bool = True
    delays: bool = True
    correlated: bool = True
    ratio: float | None = None
    all_samples: bool = True
    joint_reduction: bool = False
    accuracy: float = ACCURACY


DEFAULT = Options()
AS_PAPER = Options(
    "chebyshev",
    select_friction=False,
    delays=False,
    correlated=False,
    ratio=10.0,
    all_samples=False,
    joint_reduction=True,
)


def estimate(
    dataset: Dataset,
    estimator: Estimator,
    given: Given,
    options: Options = DEFAULT,
    prior_gains: Mapping[str, float] | None = None,
    consistent: bool = False,
) -> Result:
    """Estimate parameters, drive gains and their uncertainties from reduced runs, with verdicts.

    Parameters
    ----------
    dataset : Dataset
        The reduced runs (eqs. 19 and 20).
    estimator : Estimator
        From the registry.
    given : Given
        Gains, where the estimator takes them, and priors.
    options : Options
        Options beside the estimator.
    prior_gains : mapping, optional
        Expected gains, N m/A or N/A, by joint, to compare the estimates with.
    consistent : bool
        Also find physically consistent standard parameters.

    Raises
    ------
    GtauError
        Where the data do not suit the estimator.
    """
    progress = given.progress
    if options.select_friction:
        dataset, system = select_friction(dataset, estimator.solver(given), progress)
    else:
        system = dataset.system(PAPER, options.delays)  # eqs. (29) to (33)
    progress("estimation", 0, 1)
    fit = estimator.fit(dataset, system, given)  # eqs. (24) to (28), or (34) to (39)
    examined = examine(fit, progress)
    uncertainty = uncertainty_of(fit, examined, options.correlated)
    essential, reduced, loss = essential_fit(fit, options.ratio, options.correlated, options.joint_reduction)
    bare = without_file_inertias(fit, uncertainty.covariance, uncertainty.effective_freedom)
    audit = bare and audit_inertias(*bare, fit.dataset.prior_inertias)
    payloads = weigh_known(bare[0], estimator.name, options.accuracy) if bare else {}
    bodies = find_consistent(dataset, fit.system, fit.solution, given.priors, fit.free_gains) if consistent else None
    progress("estimation", 1, 1)
    if options.joint_reduction:  # the gains that go with the essential parameters
        fit = replace(fit, system=replace(fit.system, problem=essential), solution=reduced)
        covariance = reduced.covariance
        nothing = np.zeros_like(covariance)
        uncertainty = replace(uncertainty, scatter=covariance, scale=nothing, model=nothing)
    diagnosis = diagnose(fit, examined, uncertainty, payloads, prior_gains or {}, options.accuracy)
    diagnosis = replace(diagnosis, notes=(*diagnosis.notes, *map(note, prior_findings(audit))))
    curves, errors = friction_curves(fit, uncertainty.covariance) if options.all_samples else ({}, {})
    return build_result(
        fit, estimator, examined, uncertainty, essential, loss, diagnosis, curves, errors, bodies, audit
    )
