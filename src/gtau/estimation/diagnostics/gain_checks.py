"""Checks of drive gains, as findings: each check stands alone, and :func:`verdict.decide` ranks what they find.

A cross-validated torque says nothing about a wrong gain, as both sides of the equation carry it. The user needs the
possible error of a gain: its interval, with a random part and one from model deficits. It is good where the whole
interval lies within the required accuracy, and contradictory only where the data refute the description of robot and
logs and the gain would move by more than that.

Every scale of logged torques is proportional to the stated mass of the payload; but torques of different motors rarely
share one scale error, while a mistyped mass, or a gripper that was not weighed with its load, has that effect. Gains
and parameters also absorb part of a wrench of wrong sign, body or axes, and lengths or single currents look wrong
instead: so wherever wrenches are measured, the advice names them first. Units and signs are checked in
:mod:`gtau.estimation.diagnostics.unit_checks`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from gtau.estimation.diagnostics.alternatives import friction_levels, rms_speeds, rms_torques
from gtau.estimation.diagnostics.effort import stated_meaning
from gtau.estimation.diagnostics.examine import Examination
from gtau.estimation.diagnostics.log_checks import doubtful_commands
from gtau.estimation.diagnostics.verdict import Verdict, judge_parameter, motors, unexplained_shares
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.problem import Estimates
from gtau.estimation.thresholds.estimates import (
    APART,
    APART_REFUTED,
    BASE_MISFIT,
    LOST_GAIN,
    MISFIT,
    MISFIT_GIVEN,
    NAMED_SHARE,
    NEGATIVE_STD,
)
from gtau.estimation.thresholds.logs import ALIKE, BEYOND_GEARS, FRICTIONLESS, GEARED, MODEL_RESIDUAL
from gtau.findings import Finding, Outcome
from gtau.findings import FindingKind as F
from gtau.model.base_parameters import regrouped, whole_mass
from gtau.robots.parameter import Parameter, unit_of


def estimated_gains(
    fit: Fit, examined: Examination, estimates: Estimates, accuracy: float, prior_gains: Mapping[str, float]
) -> Iterator[Finding]:
    """Check drive gains that were estimated by their own equations; see :func:`diagnose` for what it takes."""
    problem, solution, gains = fit.system.problem, fit.solution, fit.gains
    stds = np.sqrt(np.diag(estimates.random))[problem.gain_rows] / np.abs(gains)
    halves = half_widths(fit, estimates)
    random_halves = halves * stds / (np.sqrt(np.diag(estimates.covariance)[problem.gain_rows]) / np.abs(gains))
    misfits = unexplained_shares(problem, solution)
    unknown = problem.unknown_gains[: len(gains)]
    turned = any(all(move < -100 for move in part.moves.values()) for part in examined.refuted)  # by another gravity
    # a negative prior gain says that a motor turns against its joint, and all may
    if min(prior_gains.values(), default=1.0) > 0 and np.all(gains[unknown] < 0) and not turned:
        yield Finding(F.ALL_NEGATIVE, motors(fit))
    if not solution.converged:
        yield Finding(F.UNSETTLED, motors(fit))
    for j, joint in enumerate(problem.joints):
        if not problem.channels[j].kind.of_joint:
            continue  # the six rows of a base are judged together
        std, half, mine = float(stds[j]), float(halves[j]), (joint,)
        if std > LOST_GAIN:
            yield Finding(F.LOST, mine, values={"std": std})
            if "singular_ratio" in solution.statistics:
                yield Finding(F.TLS_CONFUSED, mine, values={"limit": float(LOST_GAIN)})
        for part in examined.refuted:
            move = part.moves[joint] / 100
            if abs(move) > accuracy:
                values = {"size": part.size, "unit": part.unit, "share": part.share, "move": move}
                yield Finding(F.REFUTED, mine, values=values, causes=part.causes, size=part.share)
        if misfits[j] > MISFIT:
            values = {"share": float(misfits[j]), "kind": fit.dataset.runs[0].kind, "given": False}
            yield Finding(F.UNEXPLAINED, mine, values=values)
        if half >= 1:  # an interval that includes zero leaves not even the sign
            yield Finding(F.SIGN_OPEN, mine)
        for other in examined.alternatives:
            move = other.moves[joint] / 100
            if other.hypothesis == F.TWO_STAGE and abs(move) > accuracy and abs(other.t) > APART_REFUTED:
                values = {"move": move, "t": other.t}
                yield Finding(F.OTHER_ESTIMATOR, mine, values=values, causes=other.causes, size=abs(other.t))
        if half > accuracy:
            values = {"half": half, "accuracy": accuracy, "random": bool(random_halves[j] > accuracy)}
            kind, causes = _widest(examined, estimates, problem.gain_rows.start + j)
            yield Finding(kind, mine, values=values, causes=causes)


def half_widths(fit: Fit, estimates: Estimates) -> np.ndarray:
    """Compute half the relative widths of the gains' 95 % intervals, (n,)."""
    from scipy.special import ndtri, stdtrit

    gains = fit.system.problem.gain_rows
    std = np.sqrt(np.diag(estimates.covariance)[gains]) / np.abs(fit.gains)
    freedom = estimates.effective_freedom
    return np.asarray(std * (ndtri(0.975) if freedom is None else stdtrit(freedom[gains], 0.975)))


def _widest(examined: Examination, estimates: Estimates, row: int) -> tuple[F, tuple[Finding, ...]]:
    """Find the largest contribution to the interval of an estimate."""
    random, model = estimates.random[row, row], estimates.model[row, row]
    if estimates.scale[row, row] > NAMED_SHARE * (random + model):
        return F.WIDE_SCALE, ()
    if model < NAMED_SHARE * (random + model):
        return F.WIDE_RANDOM, ()
    effects = (*examined.alternatives, *([examined.ripple] if examined.ripple else []))
    most = max(effects, key=lambda other: other.probability * other.shifts[row] ** 2, default=None)
    if most is None or most is examined.ripple:
        return F.WIDE_RIPPLE, ()
    return F.WIDE_CAUSE, most.causes


def given_gains(fit: Fit, examined: Examination, payloads: Mapping[str, Verdict]) -> Iterator[Finding]:
    """Check gains that are given, or 1 for torques: the model has to explain each joint.

    Where a wrong value of a payload (``payloads``: verdicts by name) leaves a joint unexplained, that is named instead.
    """
    misfit = unexplained_shares(fit.system.problem, fit.solution)[: len(fit.gains)]
    wrong = {name: verdict.finding for name, verdict in payloads.items() if verdict.finding is not None}
    of_payload = {
        joint: Finding(F.PAYLOAD, (joint,), name, {"given": True})
        for name, finding in wrong.items()
        for joint in finding.joints
    }
    best = min((finding.values["remains"] for finding in wrong.values()), default=1.0)
    for part in examined.refuted:
        cause = part.causes[0]
        if cause.values.get("remains", best) < best:
            values = {"size": part.size, "unit": part.unit, "share": part.share}
            yield Finding(F.REFUTED, cause.joints, values=values, causes=part.causes, size=part.share)
    for joint, share in zip(fit.system.problem.joints, misfit, strict=True):
        if share > MISFIT_GIVEN:
            values = {"share": float(share), "kind": fit.dataset.runs[0].kind, "given": True}
            yield of_payload.get(joint, Finding(F.UNEXPLAINED, (joint,), values=values))


def impossible_parameters(fit: Fit, estimates: Estimates) -> Iterator[Finding]:
    """Find base parameters that no body or joint has, against the gain of their joint, or all where it has no motor.

    Gains and parameters are estimated together: friction that drives a joint is what a wrong description looks like.
    """
    dataset, stds = fit.dataset, np.sqrt(np.diag(estimates.covariance))
    listed: dict[str, list[list[object]]] = {}
    for name, terms in regrouped(dataset.base, dataset.model.parameter_names).items():
        if name not in estimates.unknowns.places:
            continue
        value, std = (
            float(fit.solution.theta[estimates.unknowns.places[name]]),
            float(stds[estimates.unknowns.places[name]]),
        )
        if judge_parameter(value, std, terms).outcome == Outcome.CONTRADICTORY:
            unit = unit_of(name.kind, dataset.robot, name.body)
            listed.setdefault(name.body, []).append([name, value, std, unit])
    for body, parameters in listed.items():
        joints = (body,) if body in motors(fit) else motors(fit)
        yield Finding(F.IMPOSSIBLE_PARAMETERS, joints, values={"parameters": parameters}, size=len(parameters))


def wrench_contradictions(fit: Fit) -> Iterator[Finding]:
    """Find contradictions of measured wrenches: a negative mass of the robot, or an unexplained wrench on its base.

    Both are against all gains.
    """
    floating, problem = fit.dataset.robot.floating, fit.system.problem
    name = whole_mass(fit.dataset.base, fit.dataset.model.parameter_names) if floating else ""
    if name in problem.parameters:
        k = problem.parameters.index(name)
        mass, std = float(fit.solution.theta[k]), float(np.sqrt(fit.solution.covariance[k, k]))
        if mass < -NEGATIVE_STD * std:
            yield Finding(F.NEGATIVE_MASS, motors(fit), name, {"mass": mass})
    for part, share in base_misfit(fit).items():
        if share > BASE_MISFIT:
            yield Finding(F.BASE_UNEXPLAINED, motors(fit), floating, {"share": share, "part": part}, size=share)


def base_misfit(fit: Fit) -> dict[str, float]:
    """Compute the unexplained shares (rms) of the forces and moments on a floating base, empty for a fixed one.

    They are shares of everything measured together, wrenches on bodies included; of forces and moments in three
    directions each, as a single component may be small. Where all are small, they are shares of a third of the model's
    terms.
    """
    problem, theta = fit.system.problem, fit.solution.theta
    rows = problem.base
    residual, measured = fit.solution.sigma[rows] ** 2, problem.balance(theta)[rows] ** 2
    terms = problem.largest_terms(theta)[rows] ** 2
    parts = {"forces": slice(0, 3), "moments": slice(3, 6)} if len(rows) else {}
    # a base that hangs still at its centre of mass has hardly a moment but noise
    return {
        part: float(np.sqrt(residual[axes].sum() / max(measured[axes].sum(), terms[axes].sum() / 9, 1e-300)))
        for part, axes in parts.items()
    }


def logged_torques(fit: Fit, examined: Examination, estimates: Estimates) -> Iterator[Finding]:
    """Find shares of rated values, motor-side torques, or torques and currents of a model: the first that holds."""
    kind, scales = fit.dataset.runs[0].kind, np.zeros(0)
    if doubtful := list(doubtful_commands(fit.dataset.runs, fit.dataset.robot)):
        yield doubtful[0]
        return
    if kind == "torque" and fit.free_gains:
        scales = np.abs(fit.gains)[half_widths(fit, estimates) < 1]
    elif kind == "torque" and (scale := stated_meaning(examined.effort).values.get("scale")):
        share, std = scale
        scales = 1 / np.maximum([abs(share) + 2 * std, abs(share) - 2 * std], 1e-300)
    if len(scales) and scales.min() > GEARED and scales.max() < BEYOND_GEARS:
        yield Finding(F.MOTOR_SIDE, values={"least": float(scales.min()), "most": float(scales.max())})
        return
    joints, known = fit.dataset.robot.motors, set(fit.system.problem.parameters)
    if any({name := Parameter("fs", joint), name + "R"}.isdisjoint(known) for joint in joints):
        return
    rows = [fit.dataset.model.actuated.index(joint) for joint in joints]
    (fv, fs), torques = friction_levels(fit), rms_torques(fit)
    friction = ((fv * rms_speeds(fit) + fs) / np.maximum(torques, 1e-300))[rows].max()
    residual = unexplained_shares(fit.system.problem, fit.solution)[rows].max()
    if friction < FRICTIONLESS and residual < MODEL_RESIDUAL:
        values = {"kind": kind, "friction": float(friction), "residual": float(residual)}
        yield Finding(F.MODEL_TORQUES, values=values)


def common_scale(fit: Fit, estimates: Estimates, accuracy: float) -> Iterator[Finding]:
    """Find one factor, other than 1, that explains the torque scales of all joints which rest on one payload's mass."""
    from scipy.stats import chi2

    masses = {run.payload.name: run.payload.mass for run in fit.dataset.runs if run.payload}
    known = {name: mass for name, mass in masses.items() if mass is not None}
    judged = np.flatnonzero(half_widths(fit, estimates) < 1)
    if fit.dataset.runs[0].kind != "torque" or fit.system.problem.scaled or len(known) != 1 or len(judged) < 2:
        return
    rows = fit.system.problem.gain_rows
    covariance = estimates.covariance[rows, rows][np.ix_(judged, judged)]
    gains, precision = fit.gains[judged], np.linalg.pinv(covariance)
    variance = 1 / float(precision.sum())
    scale = variance * float(precision.sum(axis=0) @ gains)
    apart = float((gains - scale) @ precision @ (gains - scale))
    if chi2.sf(apart, len(judged) - 1) > ALIKE and abs(scale - 1) > max(APART * np.sqrt(variance), accuracy):
        ((name, mass),) = known.items()
        values = {"scale": scale, "std": float(np.sqrt(variance)), "mass": float(mass / scale), "declared": float(mass)}
        yield Finding(F.COMMON_SCALE, (), name, values)
