"""What contradicts measured wrenches: a base whose equations they leave open, a mass below zero, contradictory gains.

A wrench with a wrong sign, point, body or axes is met by other gains and parameters as far as they can, and lengths or
the currents of single joints look wrong instead. So wherever the description is contradicted, wrenches come first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gtau.estimation.diagnostics.verdict import GOOD, Outcome, Verdict
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.flight import whole_mass
from gtau.estimation.thresholds.estimates import BASE_MISFIT, NEGATIVE_STD

WRENCHES = (
    "check the signs, axes, point ('at') and body of each wrench, that none is missing, and that they share the "
    "positions' clock"
)
FLIGHT = "check the position and orientation of the base, and log every wrench that acts on the robot"


def check_wrenches(verdicts: Sequence[Verdict], fit: Fit) -> tuple[Verdict, ...]:
    """Judge gains beside measured wrenches and the equations of a floating base, whose rows are no joints of the user.

    All gains are contradictory where the mass of the robot is negative, or where the model does not explain the forces
    or the moments on the base. Where a gain is contradictory for itself, the advice names the wrenches first.
    """
    problem = fit.system.problem
    measured = bool(problem.wrenches) or not problem.silent[problem.of("base")].all()
    against = (_of_mass(fit) if measured else None) or _of_base(fit, WRENCHES if measured else FLIGHT)
    judged = []
    for channel, each in zip(problem.channels, verdicts, strict=False):  # of the joints
        if channel.kind == "base":
            judged.append(GOOD)  # the six rows are judged together
        elif against is not None:
            judged.append(against)
        elif measured and each.outcome == Outcome.CONTRADICTORY:
            judged.append(replace(each, advice=f"{WRENCHES}; otherwise {each.advice}"))
        else:
            judged.append(each)
    return tuple(judged)


def _of_mass(fit: Fit) -> Verdict | None:
    if not fit.dataset.robot.floating:
        return None
    name, parameters = whole_mass(fit.system.base, fit.dataset.model.parameter_names), fit.system.problem.parameters
    if name not in parameters:
        return None
    k = parameters.index(name)
    mass, std = float(fit.solution.theta[k]), float(np.sqrt(fit.solution.covariance[k, k]))
    if mass >= -NEGATIVE_STD * std:
        return None
    return Verdict(
        Outcome.CONTRADICTORY,
        f"the wrenches give the robot a mass of {mass:.3g} kg",
        "log the forces on the body, or reverse their signs",
    )


def _of_base(fit: Fit, advice: str) -> Verdict | None:
    shares = base_misfit(fit)
    worst = max(shares, key=lambda what: shares[what], default="")
    if not worst or shares[worst] <= BASE_MISFIT:
        return None
    return Verdict(
        Outcome.CONTRADICTORY,
        f"the model leaves {100 * shares[worst]:.0f} % of the {worst} on the base '{fit.dataset.robot.floating}' "
        "unexplained",
        advice,
    )


def base_misfit(fit: Fit) -> dict[str, float]:
    """Compute the unexplained shares (rms) of the forces and moments on a floating base, empty for a fixed one.

    They are shares of all that is measured together, of wrenches on bodies too; of forces and moments in three
    directions each, as what acts in one of them may be small. Where all of it is, of a third of the model's terms.
    """
    problem, theta = fit.system.problem, fit.solution.theta
    rows = problem.of("base")
    left, whole = fit.solution.sigma[rows] ** 2, problem.balance(theta)[rows] ** 2
    terms = problem.largest_terms(theta)[rows] ** 2
    parts = {"forces": slice(0, 3), "moments": slice(3, 6)} if len(rows) else {}
    # a base that hangs still at its centre of mass has hardly a moment but noise
    return {
        what: float(np.sqrt(left[of].sum() / max(whole[of].sum(), terms[of].sum() / 9, 1e-300)))
        for what, of in parts.items()
    }
