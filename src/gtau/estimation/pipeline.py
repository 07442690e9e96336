"""Identify from reduced runs: the steps from factors to a result, the same for every estimator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gtau.estimation.diagnostics.diagnose import diagnose
from gtau.estimation.diagnostics.examine import estimates_of, examine
from gtau.estimation.diagnostics.inertia_audit import audit_inertias, without_file_inertias
from gtau.estimation.diagnostics.other_robots import TOOL_BODIES
from gtau.estimation.diagnostics.stated_constants import weigh_known
from gtau.estimation.estimators.essential import essential_fit, select_friction
from gtau.estimation.estimators.physical_consistency import consistent as find_consistent
from gtau.estimation.experiment_runs import Options
from gtau.estimation.preconditions import Plan
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.plausibility import sensors_of
from gtau.estimation.regression.unknowns import Estimates
from gtau.estimation.results.build import evidence, fit_record, model_estimates
from gtau.estimation.results.friction_curves import friction_step
from gtau.estimation.results.groups import Model
from gtau.estimation.results.result import Result
from gtau.progress import Progress, silent

PAPER_RATIO = 10.0  # the paper's r_sigma for the essential parameters


def estimate(dataset: Dataset, plan: Plan, options: Options, progress: Progress = silent) -> Result:
    """Estimate parameters, drive gains and their uncertainties from reduced runs, with verdicts.

    As in the paper friction is viscous and Coulomb friction, the same in all runs, without delays, covariances are by
    the method's formula, and the gains are estimated again together with the essential parameters. Otherwise friction
    terms are selected from the data, then identified on all samples at these gains and inertial parameters, and
    covariances are by the block jackknife, which allows for residuals correlated in time.

    Parameters
    ----------
    dataset : Dataset
        The reduced runs (eqs. 19 and 20).
    plan : Plan
        The estimator, and the gains that it is given.
    options : Options
        What is asked.
    progress : callable
        Called as the work goes on.

    Raises
    ------
    GtauError
        Where the data do not suit the estimator.
    """
    estimator, as_paper, ratio, accuracy = plan.estimator, options.as_paper, options.ratio, options.accuracy
    if as_paper:
        system = dataset.system(delays=False)  # eqs. (29) to (33)
        ratio = PAPER_RATIO if ratio is None else ratio
    else:
        system = select_friction(dataset, estimator.solver(plan.gains), progress)
    progress("estimation", 0, 1)
    fit = estimator.fit(system, plan.gains, progress)  # eqs. (24) to (28), or (34) to (39)
    examined = examine(fit, progress)
    estimates = estimates_of(fit, examined, correlated=not as_paper)
    essential, reduced, loss = essential_fit(fit, ratio, correlated=not as_paper, joint=as_paper)
    bare = without_file_inertias(fit, estimates.covariance, estimates.effective_freedom)
    # the file is not blamed for a body that it lacks
    loaded = any(alternative.hypothesis == TOOL_BODIES for alternative in examined.alternatives)
    audit = audit_inertias(*bare, fit.dataset.prior_inertias) if bare and not loaded else None
    payloads = weigh_known(bare[0], estimator.name, accuracy) if bare else {}
    priors = options.priors or {}
    bodies = find_consistent(fit.system, fit.solution, priors, fit.free_gains) if options.consistent else None
    progress("estimation", 1, 1)
    if as_paper:  # the gains that go with the essential parameters
        fit = replace(fit, system=replace(fit.system, problem=essential), solution=reduced)
        nothing = np.zeros_like(reduced.covariance)
        estimates = Estimates(essential.unknowns, reduced.values, reduced.covariance, nothing, nothing, None)
    diagnosis = diagnose(fit, examined, estimates, payloads, options.gains, accuracy, audit)
    predicting, curves, errors = (estimates, {}, {}) if as_paper else friction_step(fit, estimates)
    figures = {"reduction_loss": loss, "lack_of_fit": examined.lack_of_fit, "accuracy": float(accuracy)}
    return Result(
        Model(dataset.robot, sensors_of(dataset.robot, dataset.runs)),
        replace(model_estimates(fit, estimates, predicting, curves, diagnosis, essential), consistency=bodies),
        fit_record(fit, estimator.name, errors, figures),
        replace(evidence(fit, estimates, examined, diagnosis, curves), audit=audit),
    )
