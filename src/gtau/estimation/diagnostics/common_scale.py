"""Find a scale factor common to all joints, which a wrong payload mass explains as well as wrong torques.

Every scale is proportional to the stated mass. Torques of different motors rarely share one scale error; a mistyped
mass, or a gripper that was not weighed with its load, has that effect.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gtau.estimation.diagnostics.examine import Uncertainty
from gtau.estimation.diagnostics.finding import Finding
from gtau.estimation.diagnostics.finding import FindingKind as F
from gtau.estimation.diagnostics.gain_checks import half_widths
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.thresholds.estimates import APART
from gtau.estimation.thresholds.torques import ALIKE


def common_scale(fit: Fit, uncertainty: Uncertainty, accuracy: float) -> Iterator[Finding]:
    """Find one factor, other than 1, that explains the torque scales of all joints which rest on one payload's mass."""
    from scipy.stats import chi2

    masses = {run.payload.name: run.payload.mass for run in fit.dataset.runs if run.payload}
    known = {name: mass for name, mass in masses.items() if mass is not None}
    judged = np.flatnonzero(half_widths(fit, uncertainty) < 1)
    if fit.dataset.runs[0].kind != "torque" or fit.system.problem.scaled or len(known) != 1 or len(judged) < 2:
        return
    rows = np.arange(fit.system.problem.n_theta, fit.system.problem.n_theta + len(fit.gains))[judged]
    gains, precision = fit.gains[judged], np.linalg.pinv(uncertainty.covariance[np.ix_(rows, rows)])
    variance = 1 / float(precision.sum())
    scale = variance * float(precision.sum(axis=0) @ gains)
    apart = float((gains - scale) @ precision @ (gains - scale))
    if chi2.sf(apart, len(judged) - 1) > ALIKE and abs(scale - 1) > max(APART * np.sqrt(variance), accuracy):
        ((name, mass),) = known.items()
        values = {"scale": scale, "std": np.sqrt(variance), "mass": mass / scale, "declared": mass}
        yield Finding(F.COMMON_SCALE, (), name, {key: float(each) for key, each in values.items()})
