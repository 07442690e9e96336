"""Friction that changes in the course of a run, as joints warm up."""

from __future__ import annotations

import numpy as np

from gtau.estimation.diagnostics.hypotheses.hypothesis import Candidates, Hypothesis, friction_levels
from gtau.estimation.diagnostics.linearisation import CandidateColumns, at_full_rate
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.thresholds.plausible_sizes import PLAUSIBLE_FRICTION_DRIFT
from gtau.signals.preparation import InMemoryRun


def _candidates(fit: Fit) -> Candidates:
    joints, terms = fit.dataset.model.actuated, fit.system.friction.terms
    # friction that depends on the temperature has a slope of its own for this
    fv, fs = friction_levels(fit) * np.array([f"fvt_{j}" not in terms and f"fst_{j}" not in terms for j in joints])
    spans = {id(each.run): (each.time[0], each.time[-1]) for each in fit.dataset.prepared}

    def offer(window: InMemoryRun, values: np.ndarray) -> CandidateColumns:
        of, (begin, end) = window.samples(), spans[id(window.run)]
        along = ((of.time - begin) / max(end - begin, 1e-12) - 0.5)[:, None]
        return at_full_rate(window, fit.dataset, np.stack([(fv * of.qd * along).T, (fs * np.sign(of.qd) * along).T]))

    return Candidates(
        (
            "viscous friction of {subject} changing along the runs",
            "Coulomb friction of {subject} changing along the runs",
        ),
        ("of itself", "of itself"),
        np.full((2, len(joints)), PLAUSIBLE_FRICTION_DRIFT),
        offer,
    )


FRICTION_DRIFT = Hypothesis(
    "friction drift", False, _candidates, "let the robot warm up before the runs, or split long runs"
)
