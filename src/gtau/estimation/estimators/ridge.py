"""Maximum likelihood with priors on the standard parameters.

Choose it where values are known beforehand, from a data sheet or a CAD model, with their standard deviations. A base
parameter is a sum of standard ones, so what is known of those is known of it. With natural sizes alone this is a mild
ridge regression, which draws only those estimates towards plausible values that the data leave open.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gtau.estimation.estimators.estimator import Estimator, Fit, Gains, Given
from gtau.estimation.estimators.least_squares import fit_free
from gtau.estimation.estimators.maximum_likelihood import ml
from gtau.estimation.estimators.solution import Solution
from gtau.estimation.estimators.standard_parameters import standard_unknowns
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.system import System
from gtau.estimation.regression.triangle import triangle
from gtau.signals.experiment import Prior


def prior_equations(dataset: Dataset, system: System, solution: Solution, priors: Mapping[str, Prior]) -> np.ndarray:
    """Normal priors on the standard parameters as equations ``[P | y]`` (n_theta, n_theta + 1) of unit variance.

    Parameters
    ----------
    dataset, system, solution : Dataset, System, Solution
        What was identified without priors.
    priors : mapping
        Standard parameter to what is known of it; bounds are not used here.
    """
    unknowns, names = standard_unknowns(dataset, system, solution, priors), system.whole.parameters
    S = unknowns.S[[k for k, name in enumerate(names) if name in system.problem.parameters]]
    # theta = S x is normal with the covariance S diag(spread^2) S^T
    L = triangle((S * unknowns.spread).T).T
    return np.asarray(np.linalg.solve(L, np.column_stack([np.eye(len(L)), S @ unknowns.centre])))


def _fit(dataset: Dataset, system: System, given: Given) -> Fit:
    unrefined = ml(system.problem)
    equations = prior_equations(dataset, system, unrefined, given.priors)
    fit = fit_free(ml, dataset, system, ml(system.problem, equations), unrefined)
    return replace(fit, prior=equations[:, :-1])


RIDGE = Estimator(
    "ridge", "maximum likelihood with priors on the standard parameters", Gains.ESTIMATED, lambda given: ml, _fit
)
