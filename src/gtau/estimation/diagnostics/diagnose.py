"""Diagnose a fit: the findings of all checks, in the order in which they count, and verdicts from them.

A cross-validated torque says nothing about a wrong gain, as both sides of the equation carry it. The user needs the
possible error of a gain: its interval, with a random part and one from model deficits. It is good where the whole
interval lies within the required accuracy, and contradictory only where the data refute the description of robot and
logs and the gain would move by more than that.

Every scale of logged torques is proportional to the stated mass of the payload; but torques of different motors rarely
share one scale error, while a mistyped mass, or a gripper that was not weighed with its load, has that effect. Gains
and parameters also absorb part of a wrench of wrong sign, body or axes, and lengths or single currents look wrong
instead: so wherever wrenches are measured, the advice names them first. Each check stands alone; units and signs are
checked in :mod:`gtau.estimation.diagnostics.unit_checks`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gtau.estimation.diagnostics.examine import Examination, estimates_of
from gtau.estimation.diagnostics.log_checks import doubtful_commands, motor_side_torques
from gtau.estimation.diagnostics.stated_constants import (
    MISFIT_GIVEN,
    prior_contradictions,
    sensor_contradictions,
    sensor_scales,
)
from gtau.estimation.diagnostics.unit_checks import BEYOND_GEARS, units_and_signs
from gtau.estimation.diagnostics.verdict import (
    APART,
    GIVEN,
    GOOD,
    IMPOSSIBLE,
    LONGER,
    NEGATIVE_STD,
    WIDE_SCALE,
    WIDTH,
    WRENCHES,
    decide,
    delay_verdicts,
    half_widths,
    has_wrenches,
    judge_parameter,
    motors,
    unexplained_shares,
    which_payload,
    wrenches_first,
)
from gtau.estimation.effects.effect import RELATIVE, EstimatedEffect, Levels
from gtau.estimation.effects.torque_scale import TORQUE_SCALE
from gtau.estimation.effects.wrenches import WRENCH_OFFSETS, WRENCH_POINTS
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.maximum_likelihood import MISFIT
from gtau.estimation.regression.problem import Estimates
from gtau.findings import Finding, Grade
from gtau.findings.words import MOST_PERCENT, percent, percent_text
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

ALL_NEGATIVE, REFUTED, UNEXPLAINED = "all gains negative", "description refuted", "unexplained current"
PAYLOAD, WIDE_RANDOM, MODEL_TORQUES = "contradictory payload", "wide interval", "torques of a model"


def diagnose(
    fit: Fit,
    examined: Examination,
    estimates: Estimates,
    payloads: Mapping[str, Finding],
    prior_gains: Mapping[str, float],
    accuracy: float,
    audit: InertiaAudit | None = None,
) -> tuple[Finding, ...]:
    """Collect what speaks against the estimates of a fit, what counts most first, and what else the user should know.

    ``payloads`` are verdicts on known payloads by name, ``prior_gains`` those expected, N m/A or N per A, by joint.
    ``accuracy`` is half the relative width of the 95 % interval up to which a gain is good, and ``audit`` what the data
    say of the inertias of the robot's file.
    """
    problem = fit.system.problem
    gains = judged_gains(fit, estimates) if fit.free_gains else []
    wrong = [verdict for verdict in payloads.values() if verdict.outcome == Grade.CONTRADICTORY]
    wrong.sort(key=lambda finding: -finding.size)
    findings = [*(wrench_contradictions(fit) if fit.dataset.robot.floating else ())]
    if fit.free_gains:
        findings += payloads_in_noise(fit, gains)
    findings += examined.findings
    if fit.free_gains:
        findings += all_negative(fit, examined, gains, prior_gains)
        findings += refuted_descriptions(fit, examined, gains, accuracy)
        findings += unexplained_currents(fit)
        findings += [contradictory_payload(finding.subject, motors(fit)) for finding in wrong]
        if problem.sensor_channels:
            findings += sensor_contradictions(sensor_scales(fit), problem.joints, accuracy)
    else:
        findings += refuted_with_given_gains(fit, examined, wrong)
        findings += unexplained_torques(fit, wrong)
    findings += wrong_priors(fit, examined, estimates, accuracy)
    # a gain without a value: what follows would judge that value
    findings += gains_without_value(fit, gains)
    findings += impossible_parameters(fit, estimates)
    # units and signs, which fit the data whatever they are
    findings += units_and_signs(fit, estimates, prior_gains, audit)
    findings += wide_gains(fit, examined, estimates, gains, accuracy)
    if audit is not None:
        from gtau.estimation.diagnostics.inertia_audit import prior_findings

        findings += prior_findings(audit)
    if fit.free_gains:
        findings += small_refutations(examined, gains, accuracy)
        if fit.dataset.runs[0].kind == "torque":
            findings += common_scale(fit, estimates, accuracy)
    return (*findings, *logged_torques(fit, examined, estimates))


def channel_verdicts(
    fit: Fit, estimates: Estimates, findings: Sequence[Finding], delayed: bool
) -> dict[Parameter, Finding]:
    """Judge the gains of the motors by findings on them, and the delays of all channels, where any is ``delayed``."""
    gains = decide(motors(fit), findings, GOOD if fit.free_gains else GIVEN)
    unknowns = estimates.unknowns
    std = np.sqrt(np.diag(estimates.random))[unknowns.delays]
    period = 1 / min(run.rate for run in fit.dataset.runs)
    delays = delay_verdicts(fit.system.problem, fit.solution, std, period) if delayed else [GOOD] * len(std)
    of_delays = dict(zip(unknowns[unknowns.delays], delays, strict=True))
    return {Parameter("gain", joint): verdict for joint, verdict in gains.items()} | of_delays


@dataclass(frozen=True)
class JudgedGain:
    """A gain that was estimated, with the relative standard deviation of its random part, and halves of its intervals.

    ``half`` is half the relative width of its 95 % interval, ``random_half`` the same of the random part alone.
    """

    joint: str
    row: int
    value: float
    std: float
    half: float
    random_half: float


def judged_gains(fit: Fit, estimates: Estimates) -> list[JudgedGain]:
    """List the gains of the joints; the six rows of a base are judged together."""
    problem, rows = fit.system.problem, fit.system.problem.gain_rows
    values, halves = estimates.values[rows], half_widths(fit, estimates)
    random, total = (np.sqrt(np.diag(part)[rows]) for part in (estimates.random, estimates.covariance))
    parts = values, random / np.abs(values), halves, halves * random / total
    return [
        JudgedGain(joint, rows.start + j, *(float(part[j]) for part in parts))
        for j, joint in enumerate(problem.joints)
        if problem.channels[j].kind.measures_joint
    ]


def wrench_contradictions(fit: Fit) -> Iterator[Finding]:
    """Find, against all gains, a negative mass of a floating robot, and an unexplained wrench on its base."""
    floating, problem = fit.dataset.robot.floating, fit.system.problem
    name = whole_mass(fit.dataset.base, fit.dataset.model.parameter_names)
    if name in problem.parameters:
        k = problem.parameters.index(name)
        mass, std = float(fit.solution.theta[k]), float(np.sqrt(fit.solution.covariance[k, k]))
        if mass < -NEGATIVE_STD * std:
            yield Finding(
                "negative mass",
                motors(fit),
                name,
                text=f"the wrenches imply a robot mass of {mass:.3g} kg",
                advice="log the forces exerted on the body, not by it, or reverse their signs",
                grade=Grade.CONTRADICTORY,
            )
    for part, share in sorted(base_misfit(fit).items(), key=lambda item: -item[1]):
        if share > BASE_MISFIT:
            yield Finding(
                "unexplained base wrench",
                motors(fit),
                str(floating),
                text=f"the model leaves {percent(share, '.0f')} of the {part} on the base '{floating}' unexplained",
                advice=WRENCHES,
                grade=Grade.CONTRADICTORY,
            )


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


def payloads_in_noise(fit: Fit, gains: Iterable[JudgedGain]) -> Iterator[Finding]:
    """Find gains by total least squares that are noise: what they seem to contradict is noise too."""
    for gain in gains:
        if gain.std > LOST_GAIN and "singular_ratio" in fit.solution.statistics:
            yield Finding(
                "payload lost in noise",
                (gain.joint,),
                text="total least squares cannot separate the payload from the noise (standard deviation over "
                f"{100 * LOST_GAIN:g} %)",
                advice="use --method ml, or a heavier payload and longer runs with less noise",
                grade=Grade.NOT_IDENTIFIABLE,
            )


def all_negative(
    fit: Fit, examined: Examination, gains: Sequence[JudgedGain], prior_gains: Mapping[str, float]
) -> Iterator[Finding]:
    """Find that all gains are negative, if no motor is known to turn against its joint: then all may."""
    problem = fit.system.problem
    free = [gain.value for gain in gains if problem.unknown_gains[gain.row - problem.gain_rows.start]]
    turned = any(all(move < -100 for move in part.moves.values()) for part in examined.refits)  # by another gravity
    if min(prior_gains.values(), default=1.0) > 0 and max(free, default=0.0) < 0 and not turned:
        yield Finding(
            ALL_NEGATIVE,
            motors(fit),
            text="all drive gains are negative",
            advice=wrenches_first(fit, f"check the sign of the currents and positions, gravity{which_payload(fit)}"),
            grade=Grade.CONTRADICTORY,
        )


def refuted_descriptions(
    fit: Fit, examined: Examination, gains: Iterable[JudgedGain], accuracy: float
) -> Iterator[Finding]:
    """Find descriptions that explain the data better, and move a gain by more than the accuracy."""
    gains = [gain for gain in gains if gain.random_half < 1]  # a gain that is noise refutes nothing
    for part in examined.contradicting:
        for gain in gains:
            move = part.moves[gain.joint] / 100
            if abs(move) > accuracy:
                turned = ", which reverses its sign" if -MOST_PERCENT / 100 < move < -1 else ""
                text, own = f"{explained_share(part)} and move the gain by {{own}}", percent(move, "+.2g") + turned
                yield refuted(fit, part, (gain.joint,), text, own)


def refuted_with_given_gains(fit: Fit, examined: Examination, wrong: Sequence[Finding]) -> Iterator[Finding]:
    """Find descriptions that explain the data better, and better than ``wrong`` values of payloads do."""
    best = min((finding.values["remains"] for finding in wrong), default=1.0)
    for part in examined.contradicting:
        if part.effect == TORQUE_SCALE.name and not abs(part.size) - 3 * part.std > OTHER_SCALE:
            continue
        if part.cause.values.get("remains", 0.0) < best:
            yield refuted(fit, part, part.cause.joints or motors(fit), explained_share(part))


def explained_share(part: EstimatedEffect) -> str:
    """Say what another description explains, with its size."""
    size = ""
    if part.unit:
        size = f" ({percent(part.size)} of itself)" if part.unit == RELATIVE else f" ({part.size:z.2g} {part.unit})"
    return f"{part.subject}{size} would explain {percent(part.share, '.0f')} of the residual variance"


def refuted(fit: Fit, part: EstimatedEffect, joints: tuple[str, ...], text: str, own: str = "") -> Finding:
    """Find, against the gains of some joints, that another description explains the data better."""
    of_wrench = part.cause.kind in (WRENCH_OFFSETS.name, WRENCH_POINTS.name)
    advice = part.cause.advice if of_wrench else wrenches_first(fit, part.cause.advice)
    causes = (part.cause.kind,)
    return Finding(REFUTED, joints, causes=causes, text=text, own=own, advice=advice, grade=Grade.CONTRADICTORY)


def small_refutations(examined: Examination, gains: Sequence[JudgedGain], accuracy: float) -> Iterator[Finding]:
    """Note parts of the description that the data refute without moving any gain by more than the accuracy."""
    least = min((gain.half for gain in gains), default=np.inf)
    for part in examined.contradicting:
        if (move := part.largest_move / 100) <= accuracy:
            yield Finding(
                "description refuted, gains unmoved",
                causes=(part.cause.kind,),
                size=move / least,
                text=f"{part.subject} would explain {percent(part.share, '.0f')} of the residual variance and move no "
                f"gain by more than {percent(move)}",
                advice=part.cause.advice,
                shown_as="model",
            )


def unexplained_currents(fit: Fit) -> Iterator[Finding]:
    """Find joints of whose current the model leaves too much unexplained, at gains of their own."""
    advice = (
        "check that the position and current columns are of the same joint in all runs, and check their signs and units"
    )
    if len(fit.system.problem.known) and not fit.system.payloads:
        advice = (
            "check the known parameters, on which the scale rests ('priors', 'prior_inertias' and the inertias in the "
            "robot's file), then the columns, their signs and units"
        )
    problem = fit.system.problem
    for joint, channel, share in zip(problem.joints, problem.channels, misfits(fit), strict=False):
        if share > MISFIT and channel.kind.measures_joint:
            yield unexplained(fit, joint, share, advice)


def unexplained_torques(fit: Fit, wrong: Sequence[Finding]) -> Iterator[Finding]:
    """Find joints whose torque at given gains is unexplained.

    Where a wrong value of a payload (``wrong``: findings) leaves a joint unexplained, that is named instead.
    """
    advice = (
        f"check the position and {fit.dataset.runs[0].kind} columns, their signs and units, the clock of the log, and "
        "'preparation'"
    )
    payloads = {joint: finding.subject for finding in reversed(wrong) for joint in finding.joints}
    for joint, share in zip(fit.system.problem.joints, misfits(fit), strict=True):
        if share > MISFIT_GIVEN and joint in payloads:
            yield contradictory_payload(payloads[joint], (joint,), given=True)
        elif share > MISFIT_GIVEN:
            yield unexplained(fit, joint, share, advice)


def misfits(fit: Fit) -> list[float]:
    """List the shares of the joints' signals that the model leaves unexplained."""
    shares: list[float] = unexplained_shares(fit.system.problem, fit.solution)[: len(fit.gains)].tolist()
    return shares


def unexplained(fit: Fit, joint: str, share: float, advice: str) -> Finding:
    """Find that the model leaves a share of a joint's signal unexplained."""
    return Finding(
        UNEXPLAINED,
        (joint,),
        text=f"the model leaves {percent(share, '.0f')} of the joint's {fit.dataset.runs[0].kind} unexplained",
        advice=wrenches_first(fit, advice),
        grade=Grade.CONTRADICTORY,
    )


def contradictory_payload(name: str, joints: tuple[str, ...], given: bool = False) -> Finding:
    """Find, against the gains of some joints, a payload that contradicts the data."""
    text = f"the scale comes from payload '{name}', which contradicts the data"
    if given:
        text = f"payload '{name}', which contradicts the data, leaves this joint unexplained"
    return Finding(PAYLOAD, joints, name, text=text, advice="correct the payload", grade=Grade.CONTRADICTORY)


def wrong_priors(fit: Fit, examined: Examination, estimates: Estimates, accuracy: float) -> Iterator[Finding]:
    """Find contradictory priors; one on the mass of a floating robot is against all gains."""
    dataset = fit.dataset
    mass = whole_mass(dataset.base, dataset.model.parameter_names) if dataset.robot.floating else ""
    if examined.mixed is not None:
        estimates = estimates_of(fit, examined, correlated=True, mixes=False)  # effects explain part of a wrong prior
    for finding in prior_contradictions(fit, estimates.covariance, accuracy):
        if finding.subject == mass:
            yield Finding(
                "contradictory mass",
                motors(fit),
                mass,
                text="the mass of the robot, " + finding.text.removeprefix("the known parameter "),
                advice=finding.advice,
                grade=Grade.CONTRADICTORY,
            )
        yield finding


def gains_without_value(fit: Fit, gains: Sequence[JudgedGain]) -> Iterator[Finding]:
    """Find gains that the data do not determine, the worst first for each joint."""
    if gains and not fit.solution.converged:
        yield Finding(
            "not converged",
            motors(fit),
            text="the iteration did not converge, so the data do not determine it",
            advice="resolve the contradictory joints first",
            grade=Grade.NOT_IDENTIFIABLE,
        )
    advice = unloaded_advice(fit)
    if fit.system.payloads:
        advice = (
            "use a heavier payload, and motions in which the joint lifts or accelerates it; check the direction of "
            f"gravity{which_payload(fit)}"
        )
    for gain in gains:
        kind, text = "sign open", "the 95 % interval includes zero"  # which leaves not even the sign
        if gain.std > LOST_GAIN:
            kind, text = "lost in noise", f"the relative standard deviation is {percent(gain.std, '.0f')}"
        if gain.std > LOST_GAIN or gain.half >= 1:
            yield Finding(kind, (gain.joint,), text=text, advice=advice, grade=Grade.NOT_IDENTIFIABLE)


def unloaded_advice(fit: Fit) -> str:
    """Advise how to narrow an interval without a payload."""
    payload = "" if has_wrenches(fit) else ", or also a payload of known mass"
    return (
        f"use longer runs, motions in which the joint lifts or accelerates more{payload}; check the direction of "
        "gravity"
    )


def impossible_parameters(fit: Fit, estimates: Estimates) -> Iterator[Finding]:
    """Find base parameters that no body or joint has, against the gain of their joint, or all where it has no motor.

    Gains and parameters are estimated together: friction that drives a joint is what a wrong description looks like.
    """
    dataset, places, stds = fit.dataset, estimates.unknowns.places, np.sqrt(np.diag(estimates.covariance))
    listed: dict[str, list[str]] = {}
    for name, terms in regrouped(dataset.base, dataset.model.parameter_names).items():
        if name in places:
            value, std = estimates[name], float(stds[places[name]])
            felt = _felt(fit, places[name], value) > IMPOSSIBLE_SHARE
            if felt and judge_parameter(value, std, terms).outcome == Grade.CONTRADICTORY:
                unit = unit_of(name.kind, dataset.robot, name.body)
                words = f"{name} = {value:.3g} {unit} (standard deviation {std:.2g})"
                listed.setdefault(name.body, []).append(words)
    for body, parameters in sorted(listed.items(), key=lambda item: -len(item[1])):
        more = f" and {len(parameters) - 3} more" if len(parameters) > 3 else ""
        yield Finding(
            "impossible parameters",
            (body,) if body in motors(fit) else motors(fit),
            text=f"physically impossible parameters: {', '.join(parameters[:3])}{more}",
            advice=IMPOSSIBLE,
            grade=Grade.CONTRADICTORY,
        )


def _felt(fit: Fit, place: int, value: float) -> float:
    """Compute the largest share of a channel's signal, rms, that a parameter has with a ``value``."""
    problem = fit.system.problem
    columns = np.array([np.linalg.norm(R[:, place]) for R in problem.triangles]) / np.sqrt(problem.total_rows)
    return float(np.max(abs(value) * columns / np.maximum(problem.balance(fit.solution.theta), 1e-300)))


def wide_gains(
    fit: Fit, examined: Examination, estimates: Estimates, gains: Iterable[JudgedGain], accuracy: float
) -> Iterator[Finding]:
    """Find gains whose intervals are wider than the accuracy, with the largest contribution to each."""
    interval = "the 95 % interval is {own}"
    for gain in gains:
        if gain.half <= accuracy:
            continue
        causes: tuple[str, ...] = ()
        random, model = estimates.random[gain.row, gain.row], estimates.model[gain.row, gain.row]
        sized = [effect for effect in examined.effects if effect.size]
        most = max(sized, key=lambda effect: abs(effect.moves[gain.joint] * effect.std / effect.size), default=None)
        if estimates.scale[gain.row, gain.row] > NAMED_SHARE * (random + model):
            kind = WIDE_SCALE
            text = f"{interval}, limited by the uncertainty of the scale reference"
            advice = "calibrate the sensors, or weigh the payload, more accurately"
            if fit.dataset.scaled_by_file:
                stated = fit.dataset.prior_inertias or 0.0
                text += f": the inertias of the robot's file, to {100 * stated:.3g} % (standard deviation)"
                advice = "carry a payload of known mass in some runs"
        elif model < NAMED_SHARE * (random + model) or most is None:
            kind, text, advice = WIDE_RANDOM, interval, unloaded_advice(fit)
            if fit.system.payloads:
                advice = (
                    "use a heavier payload, longer runs, or motions in which the joint lifts or accelerates it more; "
                    "if other joints are weak too, check which runs carry the payload, on which body, and gravity"
                )
        else:
            kind, causes = "wide by an alternative", (most.cause.kind,)
            text = f"{interval}, because the data cannot exclude {most.subject}"
            advice = most.cause.advice + (LONGER if gain.random_half > accuracy else "")
        own = f"+-{percent_text(100 * gain.half, 100 * accuracy)} %"
        yield Finding(kind, (gain.joint,), causes=causes, text=text, own=own, advice=advice, grade=Grade.WEAK)


def common_scale(fit: Fit, estimates: Estimates, accuracy: float) -> Iterator[Finding]:
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
    scale, std = variance * float(precision.sum(axis=0) @ gains), float(np.sqrt(variance))
    apart = float((gains - scale) @ precision @ (gains - scale))
    if chi2.sf(apart, len(judged) - 1) > ALIKE and abs(scale - 1) > max(APART * std, accuracy):
        ((name, mass),) = known.items()
        yield Finding(
            "common torque scale",
            subject=name,
            size=abs(scale - 1) / (WIDTH * std),
            text=f"one factor, {scale:.3g} (standard deviation {std:.2g}), explains the torque scale of all joints; a "
            f"mass of {mass / scale:.3g} kg for payload '{name}' (stated: {mass:.4g} kg) would explain it equally",
            advice="reweigh the payload before you correct the torques",
            shown_as="model",
        )


def logged_torques(fit: Fit, examined: Examination, estimates: Estimates) -> Iterator[Finding]:
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
        ends = " to ".join(dict.fromkeys(f"{end:.3g}" for end in (scales.min(), scales.max())))
        yield motor_side_torques(f"the true torques are {ends} times those logged")
        return
    joints, known = fit.dataset.robot.motors, set(fit.system.problem.parameters)
    if any({name := Parameter("fs", joint), name + "R"}.isdisjoint(known) for joint in joints):
        return
    rows = [fit.dataset.model.actuated.index(joint) for joint in joints]
    levels = Levels(fit)
    (fv, fs), torques = levels.friction, levels.torques
    friction = float(((fv * levels.speeds + fs) / np.maximum(torques, 1e-300))[rows].max())
    residual = float(unexplained_shares(fit.system.problem, fit.solution)[rows].max())
    if friction < FRICTIONLESS and residual < MODEL_RESIDUAL:
        yield Finding(
            MODEL_TORQUES,
            text=f"the {kind}s have next to no friction ({percent(friction, '.1g')} of a joint's torque at most) and "
            f"{percent(residual)} is unexplained: they come from a model in the controller, not from the motors",
            advice="log measured currents or torques (UR: actual_current, not target_current or target_moment)",
            shown_as="model",
        )
