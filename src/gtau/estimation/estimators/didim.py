"""DIDIM: parameters from the currents alone, the motion being simulated (Gautier, Janot and Vandanjon).

The regressor is taken along the motion of the robot simulated in closed loop with the current estimate. No measured
position enters it, so nothing is differentiated and no noise is amplified; the next estimate is simulated again, until
the gains converge. Choose it where encoders are coarse or noisy, beside ``iv``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.estimators.estimator import Estimator, Fit, Gains, Solve
from gtau.estimation.estimators.least_squares import fit_by
from gtau.estimation.estimators.maximum_likelihood import ml_or_wls
from gtau.estimation.estimators.simulated_motion import resimulated_runs
from gtau.estimation.regression.dataset import System
from gtau.progress import Progress, silent

PASSES = 10
CONVERGED = 0.1  # standard deviations: convergence of every gain and delay
SWITCHING = 1.0  # and of every parameter: Coulomb friction of a passive joint switches with the sign of single samples


def along_simulated_motion(system: System, solve: Solve, progress: Progress) -> System:
    """Iterate between simulated motion and the estimates of ``solve`` until they converge; raises GtauError."""
    measured, solution = system.dataset, solve(system.problem)
    for k in range(PASSES):
        progress("simulation", k, PASSES)
        simulated = resimulated_runs(system, solution)
        system = system.again(measured.reduced(system.loads(solution.theta), along=simulated))
        before, solution = solution, solve(system.problem)
        std = np.sqrt(np.diag(solution.covariance))
        limits = CONVERGED * std
        limits[solution.unknowns.theta] = SWITCHING * std[solution.unknowns.theta]
        if len(before.values) == len(std) and np.all(np.abs(solution.values - before.values) <= limits):
            progress("simulation", PASSES, PASSES)
            return system
    raise GtauError(
        "simulation and estimate do not converge, so the estimated parameters do not reproduce the measured motion; "
        "use --method ml, or add runs that excite the parameters better."
    )


def _fit(system: System, gains: np.ndarray | None = None, progress: Progress = silent) -> Fit:
    solver = ml_or_wls(gains)
    fit = fit_by(solver, along_simulated_motion(system, solver, progress), gains is None)
    return replace(fit, noise_free=True)


DIDIM = Estimator("didim", "parameters from the currents, the motion simulated (DIDIM)", Gains.EITHER, ml_or_wls, _fit)
