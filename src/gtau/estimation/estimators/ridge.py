"""Maximum likelihood with priors on all standard parameters: stated ones, and natural sizes of the others.

Every estimator that minimises squares takes the stated priors; choose this one if some parameters are poorly excited
and plausible values are wanted for them. With natural sizes alone it is a mild ridge regression, which draws only
poorly determined estimates towards plausible values.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gtau.estimation.estimators.estimator import Estimator, Fit, Gains, Given, Solution
from gtau.estimation.estimators.least_squares import fit_by
from gtau.estimation.estimators.maximum_likelihood import ml
from gtau.estimation.estimators.standard_parameters import standard_unknowns
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.equations import triangle
from gtau.estimation.regression.priors import of_theta
from gtau.estimation.regression.system import System
from gtau.signals.experiment import Prior


def prior_equations(dataset: Dataset, system: System, solution: Solution, priors: Mapping[str, Prior]) -> np.ndarray:
    """Write normal priors on all standard parameters as equations ``[P | y]`` (k, n_theta + 1) of unit variance.

    Parameters
    ----------
    dataset, system, solution : Dataset, System, Solution
        The identification without natural sizes.
    priors : mapping
        Parameter to its prior; bounds are not used here.
    """
    unknowns, names = standard_unknowns(dataset, system, solution, priors), system.whole.parameters
    kept = [k for k, name in enumerate(names) if name in system.problem.parameters]
    direct = of_theta(dataset.base, dataset.model.parameter_names, names, priors)[:, [*kept, -1]]
    S = unknowns.S[kept]
    # theta = S x is normal with the covariance S diag(spread^2) S^T
    L = triangle((S * unknowns.spread).T).T
    return np.vstack([np.linalg.solve(L, np.column_stack([np.eye(len(L)), S @ unknowns.centre])), direct])


def _fit(dataset: Dataset, system: System, given: Given) -> Fit:
    unrefined = ml(system.problem)
    equations = prior_equations(dataset, system, unrefined, given.priors)
    problem = replace(system.problem, known=equations)
    return fit_by(ml, dataset, replace(system, problem=problem), given, ml(problem), unrefined)


RIDGE = Estimator(
    "ridge", "maximum likelihood with priors on the standard parameters", Gains.ESTIMATED, lambda given: ml, _fit
)
