"""Checks of the estimated gains: gains without a value, gains with wide intervals, and impossible parameters."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gtau.estimation.diagnostics.examine import Examination
from gtau.estimation.diagnostics.verdict import (
    IMPOSSIBLE,
    LONGER,
    WIDE_SCALE,
    contradiction,
    half_widths,
    has_wrenches,
    judge_parameter,
    motors,
    which_payload,
)
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.problem import Estimates
from gtau.findings import Finding, Grade
from gtau.findings.words import percent, percent_text
from gtau.model.base_parameters import regrouped
from gtau.robots.parameter import unit_of

LOST_GAIN = 0.5  # relative random standard deviation of a gain
NAMED_SHARE = 0.5  # share of the model part in a gain's variance from which its cause is named
IMPOSSIBLE_SHARE = 0.02  # share of a joint's rms torque with an impossible sign, below which an effect explains it

WIDE_RANDOM = "wide interval"


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


def payloads_in_noise(fit: Fit, gains: Iterable[JudgedGain]) -> Iterator[Finding]:
    """Find gains by total least squares that are noise: what they seem to contradict is noise too."""
    for gain in gains:
        if gain.std > LOST_GAIN and "singular_ratio" in fit.solution.statistics:
            text = "total least squares cannot separate the payload from the noise (standard deviation over "
            text += f"{100 * LOST_GAIN:g} %)"
            advice = "use --method ml, or a heavier payload and longer runs with less noise"
            yield Finding(
                "payload lost in noise", (gain.joint,), text=text, advice=advice, grade=Grade.NOT_IDENTIFIABLE
            )


def gains_without_value(fit: Fit, gains: Sequence[JudgedGain]) -> Iterator[Finding]:
    """Find gains that the data do not determine, the worst first for each joint."""
    if gains and not fit.solution.converged:
        text = "the iteration did not converge, so the data do not determine it"
        advice = "resolve the contradictory joints first"
        yield Finding("not converged", motors(fit), text=text, advice=advice, grade=Grade.NOT_IDENTIFIABLE)
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
    A parameter counts where it has a share of a channel's signal, rms.
    """
    dataset, problem = fit.dataset, fit.system.problem
    places, stds = estimates.unknowns.places, np.sqrt(np.diag(estimates.covariance))
    signals = np.maximum(problem.balance(fit.solution.theta), 1e-300) * np.sqrt(problem.total_rows)
    listed: dict[str, list[str]] = {}
    for name, terms in regrouped(dataset.base, dataset.model.parameter_names).items():
        if name not in places:
            continue
        place, value = places[name], estimates[name]
        std, columns = float(stds[place]), np.array([np.linalg.norm(R[:, place]) for R in problem.triangles])
        felt = float(np.max(abs(value) * columns / signals)) > IMPOSSIBLE_SHARE
        if felt and judge_parameter(value, std, terms).outcome == Grade.CONTRADICTORY:
            unit = unit_of(name.kind, dataset.robot, name.body)
            listed.setdefault(name.body, []).append(f"{name} = {value:.3g} {unit} (standard deviation {std:.2g})")
    for body, parameters in sorted(listed.items(), key=lambda item: -len(item[1])):
        more = f" and {len(parameters) - 3} more" if len(parameters) > 3 else ""
        text = f"physically impossible parameters: {', '.join(parameters[:3])}{more}"
        yield contradiction("impossible parameters", (body,) if body in motors(fit) else motors(fit), text, IMPOSSIBLE)


def wide_gains(
    fit: Fit, examined: Examination, estimates: Estimates, gains: Iterable[JudgedGain], accuracy: float
) -> Iterator[Finding]:
    """Find gains whose intervals are wider than the accuracy, with the largest contribution to each."""
    sized, interval = [effect for effect in examined.effects if effect.size], "the 95 % interval is {own}"
    for gain in gains:
        if gain.half <= accuracy:
            continue
        causes: tuple[str, ...] = ()
        random, model = estimates.random[gain.row, gain.row], estimates.model[gain.row, gain.row]
        most = max(sized, key=lambda effect: abs(effect.moves[gain.joint] * effect.std / effect.size), default=None)
        kind, text, advice = WIDE_RANDOM, interval, unloaded_advice(fit)
        if estimates.scale[gain.row, gain.row] > NAMED_SHARE * (random + model):
            kind, text = WIDE_SCALE, f"{interval}, limited by the uncertainty of the scale reference"
            advice = "calibrate the sensors, or weigh the payload, more accurately"
            if fit.dataset.scaled_by_file:
                stated = fit.dataset.prior_inertias or 0.0
                text += f": the inertias of the robot's file, to {100 * stated:.3g} % (standard deviation)"
                advice = "carry a payload of known mass in some runs"
        elif model >= NAMED_SHARE * (random + model) and most is not None:
            kind, causes = "wide by an effect", (most.cause.kind,)
            text = f"{interval}, because the data cannot exclude {most.subject}"
            advice = most.cause.advice + (LONGER if gain.random_half > accuracy else "")
        elif fit.system.payloads:
            advice = (
                "use a heavier payload, longer runs, or motions in which the joint lifts or accelerates it more; "
                "if other joints are weak too, check which runs carry the payload, on which body, and gravity"
            )
        own = f"+-{percent_text(100 * gain.half, 100 * accuracy)} %"
        yield Finding(kind, (gain.joint,), causes=causes, text=text, own=own, advice=advice, grade=Grade.WEAK)
