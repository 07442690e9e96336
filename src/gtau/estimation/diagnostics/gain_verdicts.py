"""Verdicts on drive gains.

A cross-validated torque says nothing about a wrong gain, as both sides of the equation carry it. What the user must
know of a gain is how far it may be off: its interval, with a random part and one from what the model may lack. It is
good where the whole interval lies within the accuracy asked for, and contradictory only where the data refute the
description of robot and logs and the gain would move by more than that.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gtau.estimation.diagnostics.alternatives import Alternative
from gtau.estimation.diagnostics.findings import Findings
from gtau.estimation.diagnostics.other_estimators import TWO_STAGE
from gtau.estimation.diagnostics.uncertainty import Uncertainty
from gtau.estimation.diagnostics.verdict import GOOD, Outcome, Verdict, percent_text
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.thresholds.estimates import APART_REFUTED, LOST_GAIN, MISFIT, NAMED_SHARE

NORMAL = 1.96  # standard deviations in half a 95 % interval
BARE = (
    "use longer runs, motions in which this joint lifts or accelerates more, or also a payload of known mass; check "
    "the direction of gravity"
)
"""Advice where no run carries a payload."""


def gain_verdicts(
    fit: Fit, findings: Findings, uncertainty: Uncertainty, accuracy: float, prior_gains: Mapping[str, float]
) -> tuple[Verdict, ...]:
    """Judge every drive gain that was estimated.

    Parameters
    ----------
    fit, findings, uncertainty : Fit, Findings, Uncertainty
        What was estimated, what the data say against it, and how well it is known.
    accuracy : float
        Half the relative width of the 95 % interval up to which a gain is good.
    prior_gains : mapping
        Gains expected, by joint; where one is negative, a motor turns against its joint, and all may.
    """
    forwards = min(prior_gains.values(), default=1.0) > 0
    return tuple(_verdict(fit, findings, uncertainty, accuracy, forwards, j) for j in range(len(fit.gains)))


def half_widths(fit: Fit, uncertainty: Uncertainty) -> np.ndarray:
    """Compute half the relative widths of the gains' 95 % intervals, (n,)."""
    from scipy.special import ndtri, stdtrit

    gains = fit.system.problem.gain_rows
    std = np.sqrt(np.diag(uncertainty.covariance)[gains]) / np.abs(fit.gains)
    freedom = uncertainty.effective_freedom
    return np.asarray(std * (ndtri(0.975) if freedom is None else stdtrit(freedom[gains], 0.975)))


def _verdict(
    fit: Fit, findings: Findings, uncertainty: Uncertainty, accuracy: float, forwards: bool, j: int
) -> Verdict:
    problem, solution = fit.system.problem, fit.solution
    std = np.sqrt(np.diag(uncertainty.random)[problem.n_theta + j]) / abs(solution.gains[j])
    if std > LOST_GAIN and "singular_ratio" in solution.statistics:
        return Verdict(
            Outcome.NOT_IDENTIFIABLE,
            f"total least squares confuses the payload with the noise (standard deviation over {LOST_GAIN:.0%})",
            "use --method ml, or a heavier payload and longer runs with less noise",
        )
    if forwards and np.all(fit.gains[problem.free[: len(fit.gains)]] < 0):
        return Verdict(
            Outcome.CONTRADICTORY,
            "all drive gains are negative",
            "check the sign of the currents and positions, gravity, which runs carry the payload, and on which body",
        )
    misfit = float(solution.sigma[j] / problem.balance(solution.theta)[j])
    swapped = [each for each in findings.swapped if j in each.joints]
    if swapped:
        return Verdict(Outcome.CONTRADICTORY, swapped[0].why, swapped[0].advice)
    refuted = [each for each in findings.refuted if abs(each.moves[j]) > accuracy]
    if refuted:
        return Verdict(Outcome.CONTRADICTORY, _why(refuted[0], j), refuted[0].advice)
    if misfit > MISFIT:
        return Verdict(
            Outcome.CONTRADICTORY,
            f"the model leaves {100 * misfit:.0f} % of this joint's current unexplained",
            "check that its position and current columns belong together, in all runs, and their signs and units",
        )
    if not solution.settled:
        return Verdict(
            Outcome.NOT_IDENTIFIABLE,
            "the iteration did not converge, so the data do not determine it",
            "resolve the contradictory joints first",
        )
    half = float(half_widths(fit, uncertainty)[j])
    if std > LOST_GAIN or half >= 1:  # an interval that includes zero leaves not even the sign
        return Verdict(
            Outcome.NOT_IDENTIFIABLE,
            f"its standard deviation is {100 * std:.0f} % of it"
            if std > LOST_GAIN
            else "the 95 % interval includes zero",
            "use a heavier payload, and motions in which this joint lifts or accelerates it; check the direction of "
            "gravity, which runs carry the payload, and on which body"
            if fit.system.payloads
            else BARE,
        )
    apart = [
        each
        for each in findings.alternatives
        if each.hypothesis == TWO_STAGE and abs(each.moves[j]) > accuracy and abs(each.t) > APART_REFUTED
    ]
    if apart:
        move = 100 * apart[0].moves[j]
        return Verdict(
            Outcome.CONTRADICTORY,
            f"another estimator (2SLS) finds it {abs(move):.2g} % {'larger' if move > 0 else 'smaller'} from the same "
            f"data, a difference of {abs(apart[0].t):.0f} standard deviations",
            apart[0].advice,
        )
    if half > accuracy:
        width = percent_text(100 * half, 100 * accuracy)
        found = _weak(findings, uncertainty, problem.n_theta + j, width, NORMAL * std > accuracy)
        if fit.system.payloads:
            return found
        advice = found.advice.replace("use a heavier payload and longer runs, too", "use longer runs, too")
        return Verdict(found.outcome, found.why, BARE if advice.startswith("use a heavier payload") else advice)
    if solution.gains[j] < 0:
        return Verdict(
            Outcome.GOOD,
            "negative gain, as the current is positive against the motion",
            "reverse the sign of one of the two if that is not intended",
        )
    return GOOD


def _why(found: Alternative, j: int) -> str:
    size = f" ({found.size:.2g} {found.unit})" if found.unit else ""
    size = f" ({100 * found.size:.2g} % of itself)" if found.unit == "of itself" else size
    return (
        f"{found.subject}{size} would explain {100 * found.share:.0f} % of the residual variance and move this gain "
        f"by {100 * found.moves[j]:+.2g} %"
    )


def _weak(findings: Findings, uncertainty: Uncertainty, row: int, width: str, random_alone: bool) -> Verdict:
    random, model = uncertainty.random[row, row], uncertainty.model[row, row]
    why = f"its 95 % interval is +-{width} %"
    if uncertainty.scale[row, row] > NAMED_SHARE * (random + model):
        return Verdict(
            Outcome.WEAK,
            f"{why}, as what gives its scale is known no better",
            "calibrate the sensors, or weigh the payload, more accurately",
        )
    if model < NAMED_SHARE * (random + model):
        return Verdict(
            Outcome.WEAK,
            why,
            "use a heavier payload, longer runs, or motions in which this joint lifts or accelerates it more; "
            "if other joints are weak too, check which runs carry the payload, on which body, and gravity",
        )
    worst = max(findings.alternatives, key=lambda each: each.mean_square * each.slopes[row] ** 2, default=None)
    more = "; use a heavier payload and longer runs, too" if random_alone else ""
    ripple = findings.ripple.moves[row] ** 2
    if worst is None or ripple > worst.mean_square * worst.slopes[row] ** 2:
        return Verdict(
            Outcome.WEAK,
            f"{why}, as residuals repeat at the same positions (ripple of the motors, cables or springs)",
            f"use other paths in the loaded and unloaded runs{more}",
        )
    return Verdict(
        Outcome.WEAK,
        f"{why}, as the data cannot exclude {worst.subject}",
        worst.advice + more,
    )
