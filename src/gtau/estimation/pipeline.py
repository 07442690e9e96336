"""Identify from reduced runs: the steps from factors to a result, the same for every estimator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gtau.estimation.diagnostics.diagnose import diagnose
from gtau.estimation.diagnostics.examine import estimates_of, examine
from gtau.estimation.diagnostics.inertia_audit import audit_inertias, without_file_inertias
from gtau.estimation.diagnostics.other_robots import TOOL_BODIES
from gtau.estimation.diagnostics.stated_constants import weigh_known
from gtau.estimation.estimators.essential import essential_fit, select_friction
from gtau.estimation.estimators.estimates import Estimates
from gtau.estimation.estimators.estimator import Estimator, Given
from gtau.estimation.estimators.physical_consistency import consistent as find_consistent
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.friction import PAPER
from gtau.estimation.results.build import build_result
from gtau.estimation.results.friction_curves import FrictionStep, friction_step
from gtau.estimation.results.result import Result
from gtau.estimation.thresholds.estimates import ACCURACY

PAPER_RATIO = 10.0  # the paper's r_sigma for the essential parameters


def estimate(
    dataset: Dataset,
    estimator: Estimator,
    given: Given,
    prior_gains: Mapping[str, float] | None = None,
    consistent: bool = False,
    as_paper: bool = False,
    ratio: float | None = None,
    accuracy: float = ACCURACY,
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
    prior_gains : mapping, optional
        Expected gains, N m/A or N/A, by joint, to compare the estimates with.
    consistent : bool
        Also find physically consistent standard parameters.
    as_paper : bool
        As the paper does: viscous and Coulomb friction, the same in all runs, no delays, covariances by the method's
        formula, and the gains estimated again together with the essential parameters. Otherwise friction terms are
        selected from the data, then identified on all samples at these gains and inertial parameters, and covariances
        are by the block jackknife, which allows for residuals correlated in time.
    ratio : float, optional
        The paper's r_sigma for the essential parameters; without one the Bayesian information criterion decides, or it
        is 10 ``as_paper``.
    accuracy : float
        Half the relative width of the 95 % interval up to which a gain is good.

    Raises
    ------
    GtauError
        Where the data do not suit the estimator.
    """
    progress = given.progress
    if as_paper:
        system = dataset.system(PAPER, delays=False)  # eqs. (29) to (33)
        ratio = PAPER_RATIO if ratio is None else ratio
    else:
        dataset, system = select_friction(dataset, estimator.solver(given), progress)
    progress("estimation", 0, 1)
    fit = estimator.fit(dataset, system, given)  # eqs. (24) to (28), or (34) to (39)
    examined = examine(fit, progress)
    estimates = estimates_of(fit, examined, correlated=not as_paper)
    essential, reduced, loss = essential_fit(fit, ratio, correlated=not as_paper, joint=as_paper)
    bare = without_file_inertias(fit, estimates.covariance, estimates.effective_freedom)
    loaded = any(each.hypothesis == TOOL_BODIES for each in examined.alternatives)  # else the file would be blamed
    audit = audit_inertias(*bare, fit.dataset.prior_inertias) if bare and not loaded else None
    payloads = weigh_known(bare[0], estimator.name, accuracy) if bare else {}
    bodies = find_consistent(dataset, fit.system, fit.solution, given.priors, fit.free_gains) if consistent else None
    progress("estimation", 1, 1)
    if as_paper:  # the gains that go with the essential parameters
        fit = replace(fit, system=replace(fit.system, problem=essential), solution=reduced)
        nothing = np.zeros_like(reduced.covariance)
        estimates = Estimates(essential.unknowns, reduced.stacked, reduced.covariance, nothing, nothing, None)
    diagnosis = diagnose(fit, examined, estimates, payloads, prior_gains or {}, accuracy, audit)
    friction = FrictionStep(estimates) if as_paper else friction_step(fit, estimates)
    return build_result(fit, estimator, examined, estimates, essential, loss, diagnosis, friction, bodies, audit)
