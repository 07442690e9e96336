"""Diagnose a fit: the findings of all checks, and verdicts on gains and delays from them.

A cross-validated torque says nothing about a wrong gain, as both sides of the equation carry it. The user needs the
possible error of a gain: its interval, with a random part and one from model deficits. It is good where the whole
interval lies within the required accuracy, and contradictory only where the data refute the description of robot and
logs and the gain would move by more than that.

Every scale of logged torques is proportional to the stated mass of the payload; but torques of different motors rarely
share one scale error, while a mistyped mass, or a gripper that was not weighed with its load, has that effect. Gains
and parameters also absorb part of a wrench of wrong sign, body or axes, and lengths or single currents look wrong
instead: so wherever wrenches are measured, the advice names them first. Each check stands alone, and
:func:`verdict.decide` ranks what they find; units and signs are checked in
:mod:`gtau.estimation.diagnostics.unit_checks`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.estimation.diagnostics.examine import Examination, estimates_of
from gtau.estimation.diagnostics.log_checks import doubtful_commands
from gtau.estimation.diagnostics.stated_constants import (
    MISFIT_GIVEN,
    prior_contradictions,
    sensor_contradictions,
    sensor_scales,
)
from gtau.estimation.diagnostics.unit_checks import BEYOND_GEARS, units_and_signs, unlike_legs
from gtau.estimation.diagnostics.verdict import (
    APART,
    GIVEN,
    GOOD,
    NEGATIVE_STD,
    OUTCOMES,
    Outcome,
    Verdict,
    decide,
    delay_verdicts,
    half_widths,
    judge_parameter,
    motors,
    unexplained_shares,
)
from gtau.estimation.effects.effect import Levels
from gtau.estimation.effects.torque_scale import TORQUE_SCALE
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.maximum_likelihood import MISFIT
from gtau.estimation.regression.problem import Estimates
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.model.base_parameters import regrouped, whole_mass
from gtau.robots.parameter import Parameter, unit_of

if TYPE_CHECKING:
    from gtau.estimation.diagnostics.inertia_audit import InertiaAudit

LOST_GAIN = 0.5  # relative random standard deviation of a gain
NAMED_SHARE = 0.5  # share of the model part in a gain's variance from which its cause is named
BASE_MISFIT = 0.15  # share of the forces, or of the moments, on a floating base that is unexplained
OTHER_SCALE = 0.2  # other scale of one joint's torques, beyond three standard deviations, that contradicts them
ALIKE = 0.05  # probability that the torque scales of joints which share one differ by as much
FRICTIONLESS = 0.02  # friction over torque, rms, of the joint with most of it: below, torques are those of a model
MODEL_RESIDUAL = 0.02  # unexplained share of the joint with most of it, below which torques are those of a model
IMPOSSIBLE_SHARE = 0.02  # share of a joint's rms torque with an impossible sign, below which an effect explains it
GEARED = 5.0  # least torque scale of the joints, from which torques are those of motors before their gears

WIDTH = 1.96  # standard deviations in half a 95 % interval


def diagnose(
    fit: Fit,
    examined: Examination,
    estimates: Estimates,
    payloads: Mapping[str, Verdict],
    prior_gains: Mapping[str, float],
    accuracy: float,
    audit: InertiaAudit | None = None,
) -> tuple[Finding, ...]:
    """Collect what speaks against the estimates of a fit, and what the user should know beside that.

    ``payloads`` are verdicts on known payloads by name, ``prior_gains`` those expected, N m/A or N per A, by joint.
    ``accuracy`` is half the relative width of the 95 % interval up to which a gain is good, and ``audit`` what the data
    say of the inertias of the robot's file.
    """
    problem, robot = fit.system.problem, fit.dataset.robot
    findings = [
        *(_wrench_contradictions(fit) if robot.floating else ()),
        *_impossible_parameters(fit, estimates),
        *unlike_legs(fit, estimates),
        *_wrong_priors(fit, examined, estimates, accuracy),
        *units_and_signs(fit, estimates, prior_gains, audit),
    ]
    if audit is not None:
        from gtau.estimation.diagnostics.inertia_audit import prior_findings

        findings += prior_findings(audit)
    if fit.free_gains:
        findings += _estimated_gains(fit, examined, estimates, accuracy, prior_gains)
        if problem.sensor_channels:
            findings += sensor_contradictions(sensor_scales(fit), problem.joints, accuracy)
        findings += [
            Finding(F.PAYLOAD, motors(fit), name, size=verdict.finding.size)
            for name, verdict in payloads.items()
            if verdict.finding and verdict.outcome == Outcome.CONTRADICTORY
        ]
        # parts of the description that the data refute without moving any gain by more than the accuracy
        findings += [
            Finding(F.SMALL_REFUTATION, values={"share": part.share, "move": move}, causes=(part.cause,))
            for part in examined.contradicting
            if (move := part.largest_move / 100) <= accuracy
        ]
        if fit.dataset.runs[0].kind == "torque":
            findings += _common_scale(fit, estimates, accuracy)
    else:
        findings += _given_gains(fit, examined, payloads)
    findings += [*_logged_torques(fit, examined, estimates), *examined.findings]
    # their advice depends on whether there is a payload, or a wrench on a body or a floating base
    context: dict[str, Any] = {"payload": bool(fit.system.payloads), "wrenches": bool(problem.wrenches or problem.base)}
    context |= {"file": fit.dataset.prior_inertias} if fit.dataset.scaled_by_file else {}
    halves = half_widths(fit, estimates) if fit.free_gains else np.zeros(0)
    advised = (replace(finding, values={**context, **finding.values}) for finding in findings)
    return tuple(
        finding if finding.kind in OUTCOMES else replace(finding, size=_moves(finding, halves)) for finding in advised
    )


def channel_verdicts(
    fit: Fit, estimates: Estimates, findings: Sequence[Finding], delayed: bool
) -> dict[Parameter, Verdict]:
    """Judge the gains of the motors by findings on them, and the delays of all channels, where any is ``delayed``."""
    gains = decide(motors(fit), findings, GOOD if fit.free_gains else GIVEN)
    unknowns = estimates.unknowns
    std = np.sqrt(np.diag(estimates.random))[unknowns.delays]
    period = 1 / min(run.rate for run in fit.dataset.runs)
    delays = delay_verdicts(fit.system.problem, fit.solution, std, period) if delayed else [GOOD] * len(std)
    of_delays = dict(zip(unknowns[unknowns.delays], delays, strict=True))
    return {Parameter("gain", joint): verdict for joint, verdict in gains.items()} | of_delays


def _estimated_gains(
    fit: Fit, examined: Examination, estimates: Estimates, accuracy: float, prior_gains: Mapping[str, float]
) -> Iterator[Finding]:
    """Check drive gains that were estimated by their own equations; see :func:`diagnose` for what it takes."""
    problem, solution, rows = fit.system.problem, fit.solution, fit.system.problem.gain_rows
    gains = estimates.values[rows]
    random, total = (np.sqrt(np.diag(part)[rows]) for part in (estimates.random, estimates.covariance))
    stds, halves = random / np.abs(gains), half_widths(fit, estimates)
    at_random = halves * random / total
    misfits = unexplained_shares(problem, solution)
    unknown = problem.unknown_gains[: len(gains)]
    turned = any(all(move < -100 for move in part.moves.values()) for part in examined.refits)  # by another gravity
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
        for part in examined.contradicting:
            move = part.moves[joint] / 100
            if abs(move) > accuracy and at_random[j] < 1:  # a gain that is noise refutes nothing
                values = {"size": part.size, "unit": part.unit, "share": part.share, "move": move}
                yield Finding(F.REFUTED, mine, values=values, causes=(part.cause,), size=part.share)
        if misfits[j] > MISFIT:
            yield _unexplained(fit, joint, misfits[j])
        if half >= 1:  # an interval that includes zero leaves not even the sign
            yield Finding(F.SIGN_OPEN, mine)
        if half > accuracy:
            values = {"half": half, "accuracy": accuracy, "random": bool(at_random[j] > accuracy)}
            kind, causes = _widest(examined, estimates, rows.start + j, joint)
            yield Finding(kind, mine, values=values, causes=causes)


def _unexplained(fit: Fit, joint: str, share: float) -> Finding:
    values = {"share": float(share), "kind": fit.dataset.runs[0].kind, "given": not fit.free_gains}
    stated = bool(len(fit.system.problem.known)) and not fit.system.payloads
    return Finding(F.UNEXPLAINED, (joint,), values=values | ({"stated": True} if stated else {}))


def _widest(examined: Examination, estimates: Estimates, row: int, joint: str) -> tuple[F, tuple[Finding, ...]]:
    """Find the largest contribution to the interval of the gain of a ``joint``."""
    random, model = estimates.random[row, row], estimates.model[row, row]
    if estimates.scale[row, row] > NAMED_SHARE * (random + model):
        return F.WIDE_SCALE, ()
    if model < NAMED_SHARE * (random + model):
        return F.WIDE_RANDOM, ()
    sized = [effect for effect in examined.effects if effect.size]
    most = max(sized, key=lambda effect: abs(effect.moves[joint] * effect.std / effect.size), default=None)
    return (F.WIDE_RANDOM, ()) if most is None else (F.WIDE_CAUSE, (most.cause,))


def _given_gains(fit: Fit, examined: Examination, payloads: Mapping[str, Verdict]) -> Iterator[Finding]:
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
    for part in examined.contradicting:
        if part.effect == TORQUE_SCALE.name and not abs(part.size) - 3 * part.std > OTHER_SCALE:
            continue
        if part.cause.values.get("remains", 0.0) < best:
            values = {"size": part.size, "unit": part.unit, "share": part.share}
            joints = part.cause.joints or motors(fit)
            yield Finding(F.REFUTED, joints, values=values, causes=(part.cause,), size=part.share)
    for joint, share in zip(fit.system.problem.joints, misfit, strict=True):
        if share > MISFIT_GIVEN:
            yield of_payload.get(joint, _unexplained(fit, joint, share))


def _impossible_parameters(fit: Fit, estimates: Estimates) -> Iterator[Finding]:
    """Find base parameters that no body or joint has, against the gain of their joint, or all where it has no motor.

    Gains and parameters are estimated together: friction that drives a joint is what a wrong description looks like.
    """
    dataset, places, stds = fit.dataset, estimates.unknowns.places, np.sqrt(np.diag(estimates.covariance))
    listed: dict[str, list[list[object]]] = {}
    for name, terms in regrouped(dataset.base, dataset.model.parameter_names).items():
        if name in places:
            value, std = estimates[name], float(stds[places[name]])
            felt = _felt(fit, places[name], value) > IMPOSSIBLE_SHARE
            if felt and judge_parameter(value, std, terms).outcome == Outcome.CONTRADICTORY:
                unit = unit_of(name.kind, dataset.robot, name.body)
                listed.setdefault(name.body, []).append([name, value, std, unit])
    for body, parameters in listed.items():
        joints = (body,) if body in motors(fit) else motors(fit)
        yield Finding(F.IMPOSSIBLE_PARAMETERS, joints, values={"parameters": parameters}, size=len(parameters))


def _felt(fit: Fit, place: int, value: float) -> float:
    """Compute the largest share of a channel's signal, rms, that a parameter has with a ``value``."""
    problem = fit.system.problem
    columns = np.array([np.linalg.norm(R[:, place]) for R in problem.triangles]) / np.sqrt(problem.total_rows)
    return float(np.max(abs(value) * columns / np.maximum(problem.balance(fit.solution.theta), 1e-300)))


def _wrench_contradictions(fit: Fit) -> Iterator[Finding]:
    """Find, against all gains, a negative mass of a floating robot, and an unexplained wrench on its base."""
    floating, problem = fit.dataset.robot.floating, fit.system.problem
    name = whole_mass(fit.dataset.base, fit.dataset.model.parameter_names)
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
    # on a base at rest, hung at its centre of mass, the measured moment is noise alone
    return {
        part: float(np.sqrt(residual[axes].sum() / max(measured[axes].sum(), terms[axes].sum() / 9, 1e-300)))
        for part, axes in parts.items()
    }


def _wrong_priors(fit: Fit, examined: Examination, estimates: Estimates, accuracy: float) -> Iterator[Finding]:
    """Find contradictory priors; one on the mass of a floating robot is against all gains."""
    dataset = fit.dataset
    mass = whole_mass(dataset.base, dataset.model.parameter_names) if dataset.robot.floating else ""
    mixed = examined.mixed
    if mixed is not None and len(mixed.values) == len(estimates.values):  # not the paper's essential ones
        estimates = estimates_of(fit, examined, correlated=True, mixes=False)  # effects explain part of a wrong prior
    for finding in prior_contradictions(fit, estimates.covariance, accuracy):
        yield finding
        if finding.subject == mass:
            yield replace(finding, kind=F.WHOLE_MASS, joints=motors(fit))


def _logged_torques(fit: Fit, examined: Examination, estimates: Estimates) -> Iterator[Finding]:
    """Find shares of rated values, motor-side torques, or torques and currents of a model: the first that holds."""
    kind, scales = fit.dataset.runs[0].kind, np.zeros(0)
    if doubtful := list(doubtful_commands(fit.dataset.runs, fit.dataset.robot)):
        yield doubtful[0]
        return
    if kind == "torque" and fit.free_gains:
        scales = np.abs(fit.gains)[half_widths(fit, estimates) < 1]
    elif kind == "torque" and examined.effort.scale is not None:
        share, std = examined.effort.scale
        scales = 1 / np.maximum([abs(share) + 2 * std, abs(share) - 2 * std], 1e-300)
    if len(scales) and scales.min() > GEARED and scales.max() < BEYOND_GEARS:
        yield Finding(F.MOTOR_SIDE, values={"least": float(scales.min()), "most": float(scales.max())})
        return
    joints, known = fit.dataset.robot.motors, set(fit.system.problem.parameters)
    if any({name := Parameter("fs", joint), name + "R"}.isdisjoint(known) for joint in joints):
        return
    rows = [fit.dataset.model.actuated.index(joint) for joint in joints]
    levels = Levels(fit)
    (fv, fs), torques = levels.friction, levels.torques
    friction = ((fv * levels.speeds + fs) / np.maximum(torques, 1e-300))[rows].max()
    residual = unexplained_shares(fit.system.problem, fit.solution)[rows].max()
    if friction < FRICTIONLESS and residual < MODEL_RESIDUAL:
        values = {"kind": kind, "friction": float(friction), "residual": float(residual)}
        yield Finding(F.MODEL_TORQUES, values=values)


def _common_scale(fit: Fit, estimates: Estimates, accuracy: float) -> Iterator[Finding]:
    """Find one factor, other than 1, that explains the torque scales of all joints which rest on one payload's mass."""
    from scipy.stats import chi2

    masses = {run.payload.name: run.payload.mass for run in fit.dataset.runs if run.payload}
    known = {name: mass for name, mass in masses.items() if mass is not None}
    judged = np.flatnonzero(half_widths(fit, estimates) < 1)
    if fit.system.problem.scaled or len(known) != 1 or len(judged) < 2:
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


def _moves(finding: Finding, halves: np.ndarray) -> float:
    """Compute by how many half widths of its interval what is noted may move an estimate; 0 where that is not known."""
    values = finding.values
    if finding.size:
        return finding.size
    if finding.kind == F.PRIOR:
        return float(abs(values["found"] - values["prior"]) / (WIDTH * np.hypot(values["std"], values["prior_std"])))
    if finding.kind == F.COMMON_SCALE:
        return float(abs(values["scale"] - 1) / (WIDTH * values["std"]))
    return float(abs(values.get("move") or 0.0) / halves.min()) if halves.size else 0.0
