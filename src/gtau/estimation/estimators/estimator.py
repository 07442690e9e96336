"""Interface of the estimators: their inputs and their results."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property

import numpy as np

from gtau.estimation.regression.dataset import Dataset, System
from gtau.estimation.regression.problem import Problem, Unknowns
from gtau.findings import Progress


@dataclass(frozen=True, eq=False)
class Solution:
    """Estimates of one method.

    ``values`` (k,) of the ``unknowns`` are parameters (SI units), gains (N m/A or N per A, 1 of torque sensors) and
    delays (s); ``sigma`` (c,) the standard deviation of each channel's residual, A, of torque sensors N m or N. The
    ``covariance`` (k, k) by the method's formula assumes independent errors, and is zero where a value is given.
    ``replicates`` makes the changes (U, k) of the estimates when one unit after another is left out. ``statistics`` are
    further figures that the method offers, ``prior_covariance`` what priors contribute, which no unit contains.
    """

    unknowns: Unknowns
    values: np.ndarray
    sigma: np.ndarray
    covariance: np.ndarray
    replicates: Callable[[], np.ndarray]
    statistics: Mapping[str, float] = field(default_factory=dict)
    prior_covariance: np.ndarray | float = 0.0
    converged: bool = True

    @property
    def theta(self) -> np.ndarray:
        """Parameters of the model, (n_theta,)."""
        return self.values[self.unknowns.theta]

    @property
    def gains(self) -> np.ndarray:
        """Gains of the channels, (c,)."""
        return self.values[self.unknowns.gains]

    @property
    def delays(self) -> np.ndarray:
        """Delays of the channels, (c,)."""
        return self.values[self.unknowns.delays]

    @cached_property
    def jackknife(self) -> np.ndarray:
        """Covariance (k, k) by the delete-one jackknife."""
        return jackknife(self.replicates()) + self.prior_covariance


def jackknife(replicates: np.ndarray) -> np.ndarray:
    """Compute the delete-one jackknife covariance (k, k) of k estimates from their replicates (U, k)."""
    deviations = replicates - replicates.mean(axis=0)
    blocks = len(replicates)
    return np.asarray((blocks - 1) / blocks * deviations.T @ deviations)


Solve = Callable[[Problem], Solution]


class Gains(Enum):
    """Treatment of the drive gains by an estimator."""

    ESTIMATED = "estimated"
    GIVEN = "given"
    EITHER = "estimated, 1 for torques of which nothing tests the scale"


@dataclass(frozen=True, eq=False)
class Fit:
    """A fit of an estimator to the data.

    ``system`` are the equations solved: those given, or the same reweighted or along simulated motion. ``solve``
    solves them with other known payload values, ``solve_fixed`` for fewer parameters with the gains of ``solution``,
    which were estimated if ``free_gains``. ``unweighted`` are the equations with every row at full weight, if the
    estimator weighted rows.
    """

    system: System
    solution: Solution
    solve: Solve
    solve_fixed: Solve
    free_gains: bool
    unweighted: Problem | None = None

    @property
    def dataset(self) -> Dataset:
        """The runs behind the equations."""
        return self.system.dataset

    @property
    def problem(self) -> Problem:
        """The equations solved."""
        return self.system.problem

    @property
    def kind(self) -> str:
        """What was logged: ``current`` or ``torque``."""
        return self.dataset.runs[0].kind

    @property
    def gains(self) -> np.ndarray:
        """Drive gains of the joints, (n,)."""
        return self.solution.gains[: len(self.problem.joints)]

    @cached_property
    def unrefined(self) -> Fit:
        """The fit with the residuals of one pass, to compare with other fits."""
        return replace(self, solution=replace(self.solution, sigma=self.solve(self.problem).sigma))


FitSystem = Callable[[System, np.ndarray | None, Progress], Fit]
"""Fits a system with gains (n,), or estimates them where they are None."""


@dataclass(frozen=True)
class Estimator:
    """One way to estimate parameters, and the drive gains where currents are logged.

    Attributes
    ----------
    name : str
        As users choose it.
    description : str
        For the head of a summary.
    gains : Gains
        Whether it estimates the gains or takes them.
    solver : callable
        Maps the gains (n,), None if they are to be estimated, to the function that solves a problem: for friction
        selection and sensitivities. N m/A or N per A, for torques the ratio of true to logged ones.
    fit : callable
        Fits a system, with gains or without, and reports its progress. Raises GtauError where the data do not suit the
        method.
    in_paper : bool
        Whether the paper uses it.
    least_squares : bool
        Whether it minimises squares, so that constraints can be added to it.
    takes_priors : bool
        Whether it accepts further equations: known parameters, torque sensors and a floating base.
    """

    name: str
    description: str
    gains: Gains
    solver: Callable[[np.ndarray | None], Solve]
    fit: FitSystem
    in_paper: bool = False
    least_squares: bool = True
    takes_priors: bool = True
