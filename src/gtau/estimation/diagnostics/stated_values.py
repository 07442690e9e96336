"""Stated values of payloads and priors that all other data contradict."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.special import ndtr, ndtri

from gtau.estimation.diagnostics.examine import Examination, estimates_of
from gtau.estimation.diagnostics.refits import refitted, residual_ratio
from gtau.estimation.diagnostics.verdict import APART, GOOD, WIDTH, contradiction, motors, unexplained_shares
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.column_blocks import known_values
from gtau.estimation.regression.problem import Estimates
from gtau.findings import Finding
from gtau.model.base_parameters import whole_mass
from gtau.robots.parameter import unit_of
from gtau.signals.reading.statements import FIRST_MOMENTS, Payload

MISFIT_GIVEN = 0.5  # share of a joint's torque that is unexplained, gains given
PAYLOAD_MOVES = 0.01  # relative move of the gains when a known payload parameter is estimated instead
IN_METRES = 4.0  # times that a moment must be nearer to mass times the stated value, which is then in m
LEAST_OTHERS = 0.001  # share of all else in an estimate that has a prior, below which it is the prior

PAYLOAD, PRIOR = "contradictory payload", "contradictory prior"
PAYLOAD_MASS, PAYLOAD_PARAMETER = "payload mass", "payload parameter"


def contradictory_payload(name: str, joints: tuple[str, ...], given: bool = False) -> Finding:
    """Find, against the gains of some joints, a payload that contradicts the data."""
    text = f"the scale comes from payload '{name}', which contradicts the data"
    if given:
        text = f"payload '{name}', which contradicts the data, leaves this joint unexplained"
    return contradiction(PAYLOAD, joints, text, "correct the payload", name)


def contradictory_priors(fit: Fit, examined: Examination, estimates: Estimates, accuracy: float) -> Iterator[Finding]:
    """Find base parameters that differ without their prior by more than the ``accuracy`` (relative) from it.

    Each estimate is a mean of what all else says and the prior, whose weight is its share in the information; a prior
    that alone sets the scale has the weight 1. A prior on the mass of a floating robot is against all gains.
    """
    dataset, parameters, base = fit.dataset, fit.system.problem.parameters, fit.dataset.base.names
    mass = whole_mass(dataset.base, dataset.model.parameter_names) if dataset.robot.floating else ""
    if examined.mixed is not None:
        estimates = estimates_of(fit, examined, correlated=True, shifted=False)  # effects explain part of a wrong prior
    priors = {name: prior for name, prior in dataset.stated_priors.items() if name in base and name in parameters}
    limit = -ndtri(ndtr(-APART) / max(len(priors), 1))  # of many priors some are further off
    for name, prior in priors.items():
        if prior.value is None or prior.std is None:
            continue
        k = parameters.index(name)
        others = 1 - float(fit.solution.covariance[k, k]) / prior.std**2
        if others < LEAST_OTHERS:
            continue
        value = prior.value + (float(fit.solution.theta[k]) - prior.value) / others
        variance = estimates.covariance[k, k] - ((1 - others) * prior.std) ** 2
        std = float(np.sqrt(max(variance, 0.0))) / others
        apart = float(np.hypot(std, prior.std))
        if abs(value - prior.value) <= max(limit * apart, accuracy * abs(prior.value)):
            continue
        text = f"{name} is {value:.4g} from the data (standard deviation {std:.2g}), but {prior.value:.4g} from its "
        text += f"prior ({prior.std:.2g})"
        advice = "check its value, and the units and signs of the other scale references: payloads, sensors, wrenches"
        if name == mass:
            yield contradiction("contradictory mass", motors(fit), f"the mass of the robot, {text}", advice, mass)
        size = abs(value - prior.value) / (WIDTH * apart)
        text = f"the known parameter {text}"
        yield Finding(PRIOR, subject=name, size=size, text=text, advice=advice, shown_as="model")


def weigh_known(fit: Fit, method: str, accuracy: float) -> dict[str, Finding]:
    """Estimate each known value of a payload in turn, with given gains or gains from the other constants.

    Where the data contradict several values of a payload, the verdict names the one that leaves least when it alone is
    freed. The mass of a single payload that sets the scale alone is not tested. Given gains are taken for exact to the
    ``accuracy`` (relative). Returns verdicts by the names of the payloads that have a value to test.
    """
    payloads = [run.payload for run in fit.dataset.runs if run.payload]
    known = {payload.name: payload for payload in payloads if payload.mass is not None}
    masses = ("m",) if not fit.free_gains or len(known) > 1 or fit.system.problem.scaled else ()
    verdicts = {}
    for name, payload in known.items():
        tried = (_freed(fit, method, payload, kind, accuracy) for kind in (*masses, *payload.parameters))
        if freed := [result for result in tried if result is not None]:
            verdicts[name] = min(freed, key=lambda result: result[0])[1]
    return verdicts


def _freed(fit: Fit, method: str, payload: Payload, kind: str, accuracy: float) -> tuple[float, Finding] | None:
    """Estimate a payload's parameter without stating it: what that leaves, and a verdict; None if not identifiable."""
    values = {other: value for other, value in payload.parameters.items() if other != kind}
    mass = None if kind == "m" else payload.mass
    changed = payload.model_copy(update={"mass": mass, "parameters": values})
    stated = [run.payload for run in fit.dataset.runs]
    other = refitted(fit, [changed if load and load.name == payload.name else load for load in stated], method=method)
    if other is None or not set(other.system.unexcited) <= set(fit.system.unexcited):
        return None  # without this value nothing gives the scale, or it cannot be separated from what is not declared
    problem, theta, stds = other.system.problem, other.solution.theta, np.sqrt(np.diag(other.solution.jackknife))
    columns = [
        problem.unknowns.places[label]
        for load in other.system.payloads
        if load.payload.name == payload.name
        for label, sums in zip(load.unknown, load.sums, strict=True)
        if label.kind == kind and np.count_nonzero(sums) == 1 and label in problem.unknowns.places
    ]
    if not columns:
        return None
    best = min(columns, key=lambda k: float(stds[k]))
    value, declared = float(theta[best]), known_values(payload)[kind]
    std = float(np.hypot(stds[best], payload.mass_std if mass is None else value * payload.mass_std / mass))
    likelihood = float(problem.total_rows @ np.log(other.solution.sigma))
    if fit.free_gains:
        small = kind != "m" and float(np.abs(other.solution.gains / fit.solution.gains - 1).max()) < PAYLOAD_MOVES
    else:
        small = abs(value - declared) <= accuracy * abs(declared)
    if small or abs(value - declared) <= APART * std:
        return likelihood, GOOD
    if mass is None:
        wrong = PAYLOAD_MASS
        text = f"all other data give it a mass of {value:.4g} kg (standard deviation {std:.2g}), not {declared:.4g} kg"
        advice = "reweigh the payloads: a mass is wrong, or a run carries a payload other than declared"
        if not fit.free_gains:
            torques = fit.dataset.runs[0].kind == "torque"
            doubted = "the unit and scale of the torques" if torques else "the given gains"
            again = "use --method ml" if torques else "identify the gains"
            advice = (
                f"check which runs carry the payload, its mass (kg) and {doubted}; if the mass is certain, {again}: it "
                "then sets their scale"
            )
    else:
        wrong, unit = PAYLOAD_PARAMETER, unit_of(kind, fit.dataset.robot, fit.dataset.robot.tool)
        text = (
            f"given its mass and all other data, its {kind} is {value:.4g} {unit} (standard deviation {std:.2g}), not "
            f"{declared:.4g} {unit}"
        )
        advice = f"check {kind}, its frame (the body that carries the payload) and the mass; or omit {kind}"
        if kind in FIRST_MOMENTS and abs(value - mass * declared) < abs(value - declared) / IN_METRES:
            in_metres = f"write '{kind}: {mass * declared:.4g}' (mass times distance, kg m)"
            advice = f"if {declared:.4g} is in m, {in_metres}; otherwise {advice}"
    return likelihood, contradiction(
        wrong,
        _explained(fit, other),
        text,
        advice,
        payload.name,
        values={"remains": residual_ratio(other, fit)},
        size=abs(value - declared) / std,
        shown_as="model",
    )


def _explained(fit: Fit, other: Fit) -> tuple[str, ...]:
    """List the joints whose torque only the fit leaves unexplained, not the other one."""
    before, after = (unexplained_shares(either.system.problem, either.solution) for either in (fit, other))
    joints = zip(fit.system.problem.joints, before, after, strict=False)
    return tuple(joint for joint, share, less in joints if share > MISFIT_GIVEN >= less)
