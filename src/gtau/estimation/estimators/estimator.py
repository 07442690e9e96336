"""What an estimator is, what it is given, and what it returns."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from gtau.estimation.estimators.solution import Solution
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.problem import Problem
from gtau.estimation.regression.system import System
from gtau.progress import Progress, silent
from gtau.signals.experiment import Prior

Solve = Callable[[Problem], Solution]


class Gains(Enum):
    """What an estimator does about the drive gains."""

    ESTIMATED = "estimated"
    GIVEN = "given"
    EITHER = "estimated from currents, 1 for torques"


@dataclass(frozen=True, eq=False)
class Given:
    """What is known before the data.

    Attributes
    ----------
    gains : ndarray, optional
        Drive gains (n,), N m/A or N/A, 1 for torques; None where they are to be estimated.
    priors : Mapping
        Parameter to what is known of it, as in the equations of the dataset; with its bounds.
    progress : Progress
        Called as the work goes on.
    """

    gains: np.ndarray | None = None
    priors: Mapping[str, Prior] = field(default_factory=dict)
    progress: Progress = silent


@dataclass(frozen=True, eq=False)
class Fit:
    """What an estimator makes of the data.

    Attributes
    ----------
    dataset, system : Dataset, System
        The equations solved: those given, or the same reweighted or along simulated motion.
    solution : Solution
        The estimates.
    solve : callable
        Solves the same equations with other known payload values, for sensitivities.
    unrefined : Solution
        What ``solve`` gives for ``system``; it differs from ``solution`` where the estimator goes on from there.
    solve_fixed : callable
        Solves for fewer parameters with the gains of ``solution``.
    free_gains : bool
        Whether the gains were estimated.
    noise_free : bool
        Whether the noise of the positions is kept from biasing the estimates.
    """

    dataset: Dataset
    system: System
    solution: Solution
    solve: Solve
    unrefined: Solution
    solve_fixed: Solve
    free_gains: bool
    noise_free: bool = False

    @property
    def gains(self) -> np.ndarray:
        """Drive gains of the joints, (n,)."""
        return self.solution.gains[: len(self.system.problem.joints)]


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
        From what is given to the function that solves a problem: used to select friction terms, and for sensitivities.
    fit : callable
        Fits a system. Raises GtauError where the data do not suit the method.
    in_paper : bool
        Whether the paper uses it.
    least_squares : bool
        Whether it minimises squares, so that constraints can be added to it.
    takes_priors : bool
        Whether it takes equations beside those of the currents: known parameters, torque sensors and a floating base.
    """

    name: str
    description: str
    gains: Gains
    solver: Callable[[Given], Solve]
    fit: Callable[[Dataset, System, Given], Fit]
    in_paper: bool = False
    least_squares: bool = True
    takes_priors: bool = True
