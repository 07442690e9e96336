"""Checks of the estimated gains: by other descriptions, impossible parameters, and their own intervals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from gtau.estimation.diagnostics.descriptions import MENDED, MISFIT_GIVEN
from gtau.estimation.diagnostics.scale import contradictory_payload
from gtau.estimation.diagnostics.verdict import (
    APART,
    IMPOSSIBLE,
    LONGER,
    MISFIT,
    NEGATIVE_STD,
    WIDE_SCALE,
    WIDTH,
    WRENCHES,
    brakes,
    contradiction,
    half_widths,
    has_wrenches,
    judge_parameter,
    motors,
    unexplained_shares,
    which_payload,
    wrenches_first,
)
from gtau.estimation.effects.effect import RELATIVE, EstimatedEffect
from gtau.estimation.effects.known.torque_scale import EFFECT as TORQUE_SCALE
from gtau.estimation.effects.known.wrenches import WRENCH_ERRORS
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.problem import Estimates
from gtau.findings import MOST_PERCENT, Finding, Grade, percent, percent_text
from gtau.model.base_parameters import regrouped, whole_mass
from gtau.robots.parameter import Parameter, unit_of

Effects = Sequence[EstimatedEffect]

ALIKE_SCALES = 0.05  # probability that the torque scales of joints which share one differ by as much
LOST_GAIN = 0.5  # relative random standard deviation of a gain
NAMED_SHARE = 0.5  # share of the model part in a gain's variance from which its cause is named
ASSUMED = 4 / 3  # how much worse an assumed efficiency of commutation, 1.5 % where 1 to 2 % are common, may be
IMPOSSIBLE_SHARE = 0.02  # share of a joint's rms torque with an impossible sign, below which an effect explains it
OTHER_SCALE = 0.2  # other scale of one joint's torques, beyond three standard deviations, that contradicts them

BASE_MISFIT = 0.15  # share of the forces, or of the moments, on a floating base that is unexplained

ALL_NEGATIVE, REFUTED, WIDE_RANDOM = "all gains negative", "description refuted", "wide interval"
UNEXPLAINED = "unexplained current"


class JudgedGain(NamedTuple):
    """Relative figures of an estimated gain: standard deviation of its random part, and halves of 95 % intervals.

    ``half`` is of all parts together, ``random_half`` of the random part alone.
    """

    std: float
    half: float
    random_half: float


Judged = Mapping[str, JudgedGain]


def judged_gains(fit: Fit, estimates: Estimates) -> Judged:
    """Judge the gains of the joints where they are estimated; the six rows of a base are judged together."""
    if not fit.free_gains:
        return {}
    rows, channels = fit.problem.gain_rows, fit.problem.channels
    random, total = (np.sqrt(np.diag(part)[rows]) for part in (estimates.random, estimates.covariance))
    halves = half_widths(fit, estimates)
    figures = np.transpose([random / np.abs(estimates.values[rows]), halves, halves * random / total]).tolist()
    judged = zip(channels, figures, strict=False)
    return {channel.joint: JudgedGain(*parts) for channel, parts in judged if channel.kind.measures_joint}


def wrench_contradictions(fit: Fit) -> Iterator[Finding]:
    """Find, against all gains, a negative mass of a floating robot, and an unexplained wrench on its base."""
    base, problem = fit.dataset.robot.floating, fit.problem
    if not base:
        return
    name = whole_mass(fit.dataset.base, fit.dataset.model.parameter_names)
    if name in problem.parameters:
        k = problem.parameters.index(name)
        mass, std = float(fit.solution.theta[k]), float(np.sqrt(fit.solution.covariance[k, k]))
        if mass < -NEGATIVE_STD * std:
            text = f"the wrenches imply a robot mass of {mass:.3g} kg"
            advice = "log the forces exerted on the body, not by it, or reverse their signs"
            yield contradiction("negative mass", motors(fit), text, advice, name)
    for part, share in sorted(base_misfit(fit).items(), key=lambda item: -item[1]):
        if share > BASE_MISFIT:
            text = f"the model leaves {percent(share, '.0f')} of the {part} on the base '{base}' unexplained"
            yield contradiction("unexplained base wrench", motors(fit), text, WRENCHES, str(base))


def base_misfit(fit: Fit) -> dict[str, float]:
    """Compute the unexplained shares (rms) of the forces and moments on a floating base, empty for a fixed one.

    Three directions count together, as one may be small; all may be, and the shares are then of the model's terms.
    """
    problem, theta = fit.problem, fit.solution.theta
    rows = problem.base
    residual, measured = fit.solution.sigma[rows] ** 2, problem.balance(theta)[rows] ** 2
    terms = problem.largest_terms(theta)[rows] ** 2
    parts = {"forces": slice(0, 3), "moments": slice(3, 6)} if len(rows) else {}
    # on a base at rest, hung at its centre of mass, the measured moment is noise alone
    return {
        part: float(np.sqrt(residual[axes].sum() / max(measured[axes].sum(), terms[axes].sum() / 9, 1e-300)))
        for part, axes in parts.items()
    }


def unexplained_signals(fit: Fit, wrong: Sequence[Finding]) -> Iterator[Finding]:
    """Find joints whose current or torque is unexplained; where gains are given, by which ``wrong`` payload."""
    problem, kind, free = fit.problem, fit.kind, fit.free_gains
    advice = f"check the position and {kind} columns, their signs and units, the clock of the log, and 'preparation'"
    if free and len(problem.known) and not fit.system.payloads:
        advice = (
            "check the known parameters, on which the scale rests ('priors', 'prior_inertias' and the inertias in the "
            "robot's file), then the columns, their signs and units"
        )
    elif free:
        advice = (
            "check that the position and current columns are of the same joint in all runs, and check their signs and "
            "units"
        )
    payloads = {joint: finding.subject for finding in reversed(wrong) for joint in finding.joints}
    shares = unexplained_shares(fit).tolist()
    for joint, channel, share in zip(problem.joints, problem.channels, shares, strict=False):
        if share <= (MISFIT if free else MISFIT_GIVEN) or (free and not channel.kind.measures_joint):
            continue
        if joint in payloads and not free:
            yield contradictory_payload(payloads[joint], (joint,), given=True)
        else:
            text = f"the model leaves {percent(share, '.0f')} of the joint's {kind} unexplained"
            yield contradiction(UNEXPLAINED, (joint,), text, wrenches_first(fit, advice))


def payloads_in_noise(fit: Fit, judged: Judged) -> Iterator[Finding]:
    """Find gains by total least squares that are noise: what they seem to contradict is noise too."""
    text = "total least squares cannot separate the payload from the noise (standard deviation over "
    text += f"{100 * LOST_GAIN:g} %)"
    advice = "use --method ml, or a heavier payload and longer runs with less noise"
    for joint, gain in judged.items() if "singular_ratio" in fit.solution.statistics else ():
        if gain.std > LOST_GAIN:
            yield Finding("payload lost in noise", (joint,), text=text, advice=advice, grade=Grade.NOT_IDENTIFIABLE)


def all_negative(fit: Fit, better: Effects, judged: Judged, prior_gains: Mapping[str, float]) -> Iterator[Finding]:
    """Find that all gains are negative, if no motor is known to turn against its joint: then all may."""
    names = [joint for joint in judged if joint in motors(fit)]
    negative = bool(names) and fit.gains[[fit.problem.joints.index(joint) for joint in names]].max() < 0
    # by another gravity
    turned = any(all(move < -100 for move in part.moves.values()) for part in better)
    if min(prior_gains.values(), default=1.0) > 0 and negative and not turned:
        advice = wrenches_first(fit, f"check the sign of the currents and positions, gravity{which_payload(fit)}")
        yield contradiction(ALL_NEGATIVE, motors(fit), "all drive gains are negative", advice)


def refuted_descriptions(
    fit: Fit, better: Effects, judged: Judged, wrong: Sequence[Finding], accuracy: float
) -> Iterator[Finding]:
    """Find descriptions that explain the data ``better`` (also than ``wrong`` payloads), and move a gain by enough."""
    least = min((finding.values["remains"] for finding in wrong), default=1.0)
    for part in better:
        if 1 - part.share > least:  # a payload with another value explains more
            continue
        for joint, gain in judged.items():
            move = part.moves[joint] / 100
            # a gain that is noise refutes nothing, unless that comes from the description
            noisy = gain.random_half >= 1 and part.cause.values.get("remains", 1.0) > MENDED
            if abs(move) > accuracy and not noisy:
                turned = ", which reverses its sign" if -MOST_PERCENT / 100 < move < -1 else ""
                text = f"{explained_share(part)} and move the gain by {{own}}"
                yield refuted(fit, part, (joint,), text, percent(move, "+.2g") + turned)
        harmless = part.effect == TORQUE_SCALE.name and abs(part.size) - 3 * part.std <= OTHER_SCALE
        if not (fit.free_gains or harmless) and part.cause.values.get("remains", 0.0) < least:
            joints = (*part.cause.joints, *part.cause.values.get("explained", ())) if part.cause.joints else motors(fit)
            yield refuted(fit, part, tuple(dict.fromkeys(joints)), explained_share(part))


def explained_share(part: EstimatedEffect) -> str:
    """Say what another description explains, with its size."""
    size = ""
    if part.unit:
        size = f"{percent(part.size)} of itself" if part.unit == RELATIVE else f"{part.size:z.2g} {part.unit}"
        size = f" (roughly {size})" if part.beyond else f" ({size})"
    size += part.cause.values.get("as_likely", "")
    return f"{part.subject}{size} would explain {percent(part.share, '.0f')} of the residual variance"


def refuted(fit: Fit, part: EstimatedEffect, joints: tuple[str, ...], text: str, own: str = "") -> Finding:
    """Find, against the gains of some joints, that another description explains the data better."""
    kind, advice = part.cause.kind, part.cause.advice
    if kind not in WRENCH_ERRORS:
        advice = wrenches_first(fit, advice)
    return contradiction(REFUTED, joints, text, advice, causes=(kind,), own=own)


def small_refutations(better: Effects, judged: Judged, accuracy: float) -> Iterator[Finding]:
    """Note parts of the description that the data refute without moving any gain by more than the accuracy."""
    least = min((gain.half for gain in judged.values()), default=np.inf)
    for part in better if judged else ():
        if (move := part.largest_move / 100) <= accuracy:
            yield Finding(
                "description refuted, gains unmoved",
                causes=(part.cause.kind,),
                size=move / least,
                text=f"{explained_share(part)} and move no gain by more than {percent(move)}",
                advice=part.cause.advice,
                shown_as="model",
            )


def gains_without_value(fit: Fit, judged: Judged) -> Iterator[Finding]:
    """Find gains that the data do not determine, the worst first for each joint."""
    advice = unloaded_advice(fit)
    if fit.system.payloads:
        advice = (
            "use a heavier payload, and motions in which the joint lifts or accelerates it; check the direction of "
            f"gravity{which_payload(fit)}"
        )
    if judged and not fit.solution.converged:
        text = "the iteration did not converge, so the data do not determine it"
        first = f"resolve contradictions first; otherwise {advice}"
        yield Finding("not converged", motors(fit), text=text, advice=first, grade=Grade.NOT_IDENTIFIABLE)
    for joint, gain in judged.items():
        kind, text = "sign open", "the 95 % interval includes zero"  # which leaves not even the sign
        if gain.std > LOST_GAIN:
            kind, text = "lost in noise", f"the relative standard deviation is {percent(gain.std, '.0f')}"
        if gain.std > LOST_GAIN or gain.half >= 1:
            yield Finding(kind, (joint,), text=text, advice=advice, grade=Grade.NOT_IDENTIFIABLE)


def unloaded_advice(fit: Fit) -> str:
    """Advise how to narrow an interval without a payload."""
    payload = "" if has_wrenches(fit) else ", or also a payload of known mass"
    return (
        f"use longer runs, motions in which the joint lifts or accelerates more{payload}; check the direction of "
        "gravity"
    )


def impossible_parameters(fit: Fit, estimates: Estimates) -> Iterator[Finding]:
    """Find base parameters that no body or joint has, against the gain of their joint, or all where it has no motor.

    A parameter counts where it has a share of a channel's signal, rms, and is impossible without effects as well, which
    may move what the data hardly determine.
    """
    dataset, problem = fit.dataset, fit.problem
    places, stds = estimates.unknowns.places, np.sqrt(np.diag(estimates.covariance))
    plain = np.sqrt(np.diag(fit.solution.jackknife))
    signals = np.maximum(problem.balance(fit.solution.theta), 1e-300) * np.sqrt(problem.total_rows)
    listed: dict[str, list[str]] = {}
    for name, terms in regrouped(dataset.base, dataset.model.parameter_names).items():
        if name not in places:
            continue
        place, value = places[name], estimates[name]
        std = float(stds[place])
        columns = np.array([np.linalg.norm(R[:, place]) for R in problem.triangles])
        felt = float(np.max(abs(value) * columns / signals)) > IMPOSSIBLE_SHARE
        braking, alone = brakes(fit, estimates, name), problem.unknowns.places[name]
        tried = ((value, std), (float(fit.solution.values[alone]), float(plain[alone])))
        if felt and all(judge_parameter(*one, terms, braking).outcome == Grade.CONTRADICTORY for one in tried):
            unit = unit_of(name.kind, dataset.robot, name.body)
            listed.setdefault(name.body, []).append(f"{name} = {value:.3g} {unit} (standard deviation {std:.2g})")
    for body, parameters in sorted(listed.items(), key=lambda item: -len(item[1])):
        more = f" and {len(parameters) - 3} more" if len(parameters) > 3 else ""
        text = f"physically impossible parameters: {', '.join(parameters[:3])}{more}"
        joints = (body,) if body in motors(fit) else motors(fit)
        yield contradiction("impossible parameters", joints, text, IMPOSSIBLE)


def wide_gains(fit: Fit, effects: Effects, estimates: Estimates, judged: Judged, accuracy: float) -> Iterator[Finding]:
    """Find gains whose intervals are wider than the accuracy, with the largest contribution to each."""
    sized, interval = [effect for effect in effects if effect.std], "the 95 % interval is {own}"
    for joint, gain in judged.items():
        causes: tuple[str, ...] = ()
        row = estimates.unknowns.places[Parameter("gain", joint)]
        random, scale, model = (part[row, row] for part in (estimates.random, estimates.scale, estimates.model))
        assumed = _by_commutation(fit, estimates, row) / max(random + model, 1e-300)
        if gain.half * np.sqrt(1 + assumed * (ASSUMED**2 - 1)) <= accuracy:
            continue
        most = max(sized, key=lambda effect: abs(effect.moves[joint] * effect.std / effect.size), default=None)
        kind, text, advice = WIDE_RANDOM, interval, unloaded_advice(fit)
        if scale > NAMED_SHARE * (random + model):
            kind, text = WIDE_SCALE, f"{interval}, limited by the uncertainty of the scale reference"
            advice = "calibrate the sensors, or weigh the payload, more accurately"
            if fit.dataset.scaled_by_file:
                stated = fit.dataset.prior_inertias or 0.0
                text += f": the inertias of the robot's file, to {100 * stated:.3g} % (standard deviation)"
                advice = "carry a payload of known mass in some runs"
        elif gain.half <= accuracy or assumed > NAMED_SHARE:
            kind, text = WIDE_SCALE, f"{interval}, and rests on an assumed efficiency of commutation"
            advice = "state 'commutation' under 'drives', or carry a payload of known mass in some runs"
        elif model >= NAMED_SHARE * (random + model) and most is not None:
            kind, causes = "wide by an effect", (most.cause.kind,)
            text = f"{interval}, because the data cannot exclude {most.subject}"
            advice = most.cause.advice + (LONGER if gain.random_half > accuracy else "")
        elif fit.system.payloads:
            advice = (
                "use a heavier payload, longer runs, or motions in which the joint lifts or accelerates it more; "
                "if other joints are weak too, check which runs carry the payload, on which body, and gravity"
            )
        width = f"+-{percent_text(100 * gain.half, 100 * accuracy)} %"
        yield Finding(kind, (joint,), causes=causes, text=text, own=width, advice=advice, grade=Grade.WEAK)


def _by_commutation(fit: Fit, estimates: Estimates, row: int) -> float:
    """Compute the part of a gain's variance that follows from assumed efficiencies of commutation."""
    motors = [motor for motor in fit.dataset.motors if not motor.stated]
    at = [estimates.unknowns.places[Parameter("gain", motor.joint)] for motor in motors]
    slopes = [motor.commutation * motor.ke / motor.std**2 for motor in motors]
    return float(np.sum((estimates.covariance[row, at] * slopes) ** 2))


def common_scale(fit: Fit, estimates: Estimates, accuracy: float) -> Iterator[Finding]:
    """Find one factor, other than 1, that explains the torque scales of all joints which rest on one payload's mass."""
    known = {load.name: load.mass for run in fit.dataset.runs if (load := run.payload) and load.mass is not None}
    judged = np.flatnonzero(half_widths(fit, estimates) < 1)
    if not fit.free_gains or fit.kind != "torque" or fit.problem.scaled or len(known) != 1 or len(judged) < 2:
        return
    rows = fit.problem.gain_rows
    covariance = estimates.covariance[rows, rows][np.ix_(judged, judged)]
    gains, precision = fit.gains[judged], np.linalg.pinv(covariance)
    variance = 1 / float(precision.sum())
    scale, std = variance * float(precision.sum(axis=0) @ gains), float(np.sqrt(variance))
    apart = float((gains - scale) @ precision @ (gains - scale))
    if chdtrc(len(judged) - 1, apart) > ALIKE_SCALES and abs(scale - 1) > max(APART * std, accuracy):
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
