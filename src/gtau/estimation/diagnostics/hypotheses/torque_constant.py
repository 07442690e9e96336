"""Torque constants that are not constant: falling with the current, or along the runs.

Iron saturates, and drives log currents before they limit them. A payload then scales the gain at the largest currents,
and the other parameters absorb the rest so well that the size of the residuals hardly shows it: by its own mass a
payload shows a gain that is 12 per cent off where the constant falls by 10. The shape of the residuals does show it.
A motor that warms up loses torque constant in the course of a run.
"""

from __future__ import annotations

import numpy as np

from gtau.estimation.diagnostics.hypotheses.hypothesis import Candidates, Hypothesis, rms_torques
from gtau.estimation.diagnostics.linearisation import CandidateColumns
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.rows import Rows
from gtau.estimation.thresholds.plausible_sizes import PLAUSIBLE_GAIN_DRIFT, PLAUSIBLE_SATURATION
from gtau.signals.preparation import InMemoryRun

LARGE = 2.0  # rms currents: where the fall is stated


def _saturation(fit: Fit) -> Candidates:
    regressor, n = fit.dataset.model.columns(fit.dataset.base.standard), len(fit.gains)
    scale = LARGE * rms_torques(fit)

    def offer(window: InMemoryRun, values: np.ndarray) -> CandidateColumns:
        def columns(rows: Rows) -> np.ndarray:
            tau = regressor.torques(rows.entries, values, n)
            return (np.abs(tau) * tau / scale[:, None])[:, :, None]

        return columns

    return Candidates(
        ("the torque constant of {subject} falling with its current",),
        (f"of itself up to {LARGE:g} times the rms current",),
        np.full((1, n), PLAUSIBLE_SATURATION),
        offer,
    )


def _drift(fit: Fit) -> Candidates:
    regressor, n = fit.dataset.model.columns(fit.dataset.base.standard), len(fit.gains)
    spans = {id(each.run): (each.time[0], each.time[-1]) for each in fit.dataset.prepared}

    def offer(window: InMemoryRun, values: np.ndarray) -> CandidateColumns:
        begin, end = spans[id(window.run)]

        def columns(rows: Rows) -> np.ndarray:
            along = (rows.time - begin) / max(end - begin, 1e-12) - 0.5
            return (regressor.torques(rows.entries, values, n) * along)[:, :, None]

        return columns

    return Candidates(
        ("the torque constant of {subject} falling along the runs",),
        ("of itself",),
        np.full((1, n), PLAUSIBLE_GAIN_DRIFT),
        offer,
    )


SATURATION = Hypothesis(
    "saturation",
    False,
    _saturation,
    "stay at lower currents, with slower motions or a lighter payload, and check that the log holds the actual "
    "current; friction that grows with the load has the same effect",
)
GAIN_DRIFT = Hypothesis("gain drift", False, _drift, "let the robot warm up before the runs", description=True)
