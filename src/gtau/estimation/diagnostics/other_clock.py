"""Fit the data with another clock: time that runs too fast or too slowly, which gravity tells.

A clock that is s times too fast makes velocities s and accelerations s^2 times too large, and with them the inertial
torques against gravity. Beyond some ten per cent the torques are far from linear in it: the robot is fitted again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.refits import described_otherwise, residual_ratio
from gtau.estimation.effects.effect import EstimatedEffect
from gtau.estimation.effects.known.gravity import EFFECT as GRAVITY
from gtau.estimation.effects.known.gravity import clock_words
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.least_squares import fit_by
from gtau.estimation.estimators.maximum_likelihood import ml_or_wls
from gtau.estimation.regression.run_blocks import PreparedRuns
from gtau.findings import Finding
from gtau.findings.words import percent
from gtau.progress import Progress, silent
from gtau.robots.parameter import BY_LOAD

FASTEST = 3.0  # times too fast, or too slow, at most: beyond, motions are implausible
CLOSE_ENOUGH = 0.005  # of the factor
EXPLAINED = 0.9  # share of the residual variance that another clock takes away: it explains all but the noise
OTHER_CLOCK = "clock"


def other_clock(fit: Fit, progress: Progress = silent) -> EstimatedEffect | None:
    """Fit again with velocities and accelerations of another clock; None where none explains nearly all."""
    from scipy.optimize import minimize_scalar

    windows = [window for _, window in fit.dataset.windows()]  # the middle of the runs bounds the time
    if not windows:
        return None
    dataset = replace(fit.dataset, prepared=PreparedRuns(windows))  # type: ignore[arg-type]
    terms = tuple(term for term in fit.system.terms if term.kind not in BY_LOAD)
    gains = None if fit.free_gains else fit.gains

    def slowed(factor: float) -> Fit:
        along = [replace(at, qd=at.qd / factor, qdd=at.qdd / factor**2, part_of=None) for at in windows]
        return fit_by(ml_or_wls(gains), fit.system.again(dataset.reduced(along=along), terms), fit.free_gains)

    def remaining(log_factor: float) -> float:
        progress("another clock", 0, 1)
        try:
            return float(np.log(residual_ratio(slowed(np.exp(log_factor)), unaltered)))
        except GtauError:
            return 0.0  # with it, the data do not determine the gains

    unaltered, end = slowed(1.0), np.log(FASTEST)
    log_factor = float(minimize_scalar(remaining, bounds=(-end, end), options={"xatol": CLOSE_ENOUGH}).x)
    factor, other = float(np.exp(log_factor)), slowed(np.exp(log_factor))
    if 1 - residual_ratio(other, unaltered) < EXPLAINED:
        return None
    text, advice = clock_words(fit, factor - 1, f" by {percent(abs(factor - 1), '.2g')}")
    values = {"remains": residual_ratio(other, unaltered), "factor": factor}
    return described_otherwise(
        fit, GRAVITY.name, Finding(OTHER_CLOCK, values=values, text=text, advice=advice), other, unaltered
    )
