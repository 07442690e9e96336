"""Verdicts: the credibility of an estimate is the finding that counts most against it, or that there is none."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from gtau.estimation.effects.effect import rms_speeds
from gtau.estimation.estimators.estimator import Fit, Solution
from gtau.estimation.regression.problem import Estimates, Problem
from gtau.findings import Finding, Grade, percent
from gtau.robots.parameter import Parameter

MISFIT = 0.25  # share of a joint's current that is unexplained, gains estimated
WEAK_PARAMETER = 0.2  # relative standard deviation of a parameter
NEGATIVE_STD = 4.0  # standard deviations below zero of a parameter that cannot be negative
DELAY_STD = 0.25  # relative standard deviation of a delay longer than a sample that is believed
APART = 3.5  # standard deviations between a declared value of a payload and what all else gives

WIDTH = 1.96  # standard deviations in half a 95 % interval

GIVEN, GOOD = (Finding(grade.value, grade=grade) for grade in (Grade.GIVEN, Grade.GOOD))
NONNEGATIVE = {"m", "xx", "yy", "zz", "ia", "fv", "fs"}
NEGATIVE_GAIN, FAR_APART, LARGE_CURRENT = "negative gain", "gains far apart", "current too large"
WIDE_SCALE = "uncertain scale"
ALONE = frozenset({NEGATIVE_GAIN, FAR_APART, LARGE_CURRENT})
"""Factors of one joint's channel, which its gain takes up whole: the gains of the other joints stay as they are."""
IMPOSSIBLE = "check the signs of positions and currents, gravity, the sampling rate, the units and 'preparation'"
LONGER = "; also use longer runs"
WRENCHES = (
    "check the signs, axes, point ('at') and body of each wrench, that no wrench is missing, and that all use the "
    "clock of the positions"
)


def contradiction(
    kind: str, joints: tuple[str, ...], text: str, advice: str, subject: str = "", **more: Any
) -> Finding:
    """Find what contradicts the gains of some joints; of all joints where none is named."""
    return Finding(kind, joints, subject, text=text, advice=advice, grade=Grade.CONTRADICTORY, **more)


def decide(joints: Sequence[str], findings: Iterable[Finding], otherwise: Finding = GOOD) -> dict[str, Finding]:
    """Judge the gain of each joint by the first finding on it that lowers a verdict, or as ``otherwise``.

    No gain is known beside a contradictory one, since all joints share the parameters of one model, but for what
    concerns the channel of one joint alone.
    """
    first: dict[str, Finding] = {}
    for finding in findings:
        for joint in finding.joints if finding.decisive else ():
            first.setdefault(joint, finding)
    verdicts = {joint: first.get(joint, otherwise) for joint in joints}
    for joint, verdict in verdicts.items():
        if verdict.outcome == Grade.CONTRADICTORY and verdict.kind not in ALONE:
            known = [name for name in joints if verdicts[name].outcome in (Grade.GOOD, Grade.WEAK)]
            return verdicts | {name: coupled(name, joint) for name in known}
    return verdicts


def coupled(joint: str, other: str) -> Finding:
    """Doubt a gain beside a joint that contradicts the model."""
    text = f"joint '{other}' contradicts the model, whose parameters all joints share"
    return Finding("coupled joint", (joint,), other, text=text, advice="resolve that joint first", grade=Grade.WEAK)


def worst(verdicts: Iterable[Finding]) -> Grade:
    """Return the worst outcome of several."""
    return max((verdict.outcome for verdict in verdicts), key=lambda grade: grade.rank, default=Grade.GOOD)


def parameter_verdict(value: float | None, std: float | None) -> Finding:
    """Judge a parameter by its value and standard deviation."""
    if value is None:
        text = "these motions cannot separate it from the parameters listed before it"
        advice = "add runs with different motions of the joints"
        return Finding("not separable", text=text, advice=advice, grade=Grade.NOT_IDENTIFIABLE)
    if std is None:
        return GOOD
    if abs(value) < 2 * std:
        text = "it is within two standard deviations of zero"
        advice = "treat it as small, or move its joint faster and further"
        return Finding("near zero", text=text, advice=advice, grade=Grade.NOT_IDENTIFIABLE)
    if std > WEAK_PARAMETER * abs(value):
        text = f"its standard deviation is {percent(std / abs(value), '.0f')}"
        return Finding("uncertain parameter", text=text, advice="add longer runs", grade=Grade.WEAK)
    return GOOD


def judge_parameter(
    value: float | None, std: float | None, terms: Mapping[Parameter, float], braking: bool = False
) -> Finding:
    """Judge a base parameter from its value, standard deviation, and the ``terms`` that it regroups.

    Any value is possible of viscous friction that is ``braking`` its joint, together with the Coulomb friction.
    """
    if value is None or not std or value >= -NEGATIVE_STD * std or braking or not cannot_be_negative(terms):
        return parameter_verdict(value, std)
    kind = "friction that drives the joint" if next(iter(terms)).kind in ("fv", "fs") else "a negative inertia"
    text = f"it is negative by {-value / std:.0f} standard deviations: {kind}"
    return contradiction("physically impossible", (), text, IMPOSSIBLE)


def brakes(fit: Fit, estimates: Estimates, name: Parameter) -> bool:
    """Decide whether viscous friction may brake its joint at the rms speed, though it falls with the speed (Stribeck).

    Where it does, on a simulated Orthoglide and a cylindrical arm, good gains had been contradictory: the slope was
    negative by 5 standard deviations.
    """
    places, actuated = estimates.unknowns.places, fit.dataset.model.actuated
    coulomb = Parameter("fs", name.body)
    if name.kind != "fv" or not {name, coulomb} <= set(places) or name.body not in actuated:
        return False
    at, slopes = [places[name], places[coulomb]], np.array([rms_speeds(fit)[actuated.index(name.body)], 1.0])
    std = np.sqrt(max(slopes @ estimates.covariance[np.ix_(at, at)] @ slopes, 0.0))
    return bool(slopes @ estimates.values[at] > -NEGATIVE_STD * std)


def cannot_be_negative(terms: Mapping[Parameter, float]) -> bool:
    """Decide from its terms whether a base parameter is a sum of masses, moments of inertia or friction."""
    return all(factor > 0 and name.kind in NONNEGATIVE for name, factor in terms.items())


def delay_verdicts(problem: Problem, solution: Solution, std: np.ndarray, period: float) -> list[Finding]:
    """Judge the delay of every channel, of the joints' currents and of torque sensors, by its ``std`` (c,), s.

    A delay lost in noise was not estimated. One within the ``period`` of the samples, s, is believed whatever its
    relative standard deviation.
    """
    verdicts = []
    for delay, longest, deviation in zip(np.abs(solution.delays), problem.longest_delays, std, strict=True):
        verdict = GOOD
        if not longest:
            text = "the current's rate of change may be nothing but noise"
            advice = "treat it as unknown, or move this joint faster; the drive gain does not depend on it"
            verdict = Finding("delay lost in noise", text=text, advice=advice, grade=Grade.NOT_IDENTIFIABLE)
        elif delay > period and deviation > DELAY_STD * delay:
            text = f"its standard deviation is {1000 * deviation:.2g} ms"
            advice = "treat it as a nuisance parameter, or move this joint faster"
            verdict = Finding("uncertain delay", text=text, advice=advice, grade=Grade.WEAK)
        verdicts.append(verdict)
    return verdicts


def unexplained_shares(fit: Fit) -> np.ndarray:
    """Compute the share of each channel's current or torque that the model leaves unexplained, rms, (c,)."""
    return np.asarray(fit.solution.sigma / fit.problem.balance(fit.solution.theta))


def half_widths(fit: Fit, estimates: Estimates) -> np.ndarray:
    """Compute half the relative widths of the gains' 95 % intervals, (n,)."""
    from scipy.special import ndtri, stdtrit

    rows, freedom = fit.problem.gain_rows, estimates.effective_freedom
    std = np.sqrt(np.diag(estimates.covariance)[rows]) / np.abs(estimates.values[rows])
    return np.asarray(std * (ndtri(0.975) if freedom is None else stdtrit(freedom[rows], 0.975)))


def motors(fit: Fit) -> tuple[str, ...]:
    """List the joints whose gains are judged: all but the joints of a floating base."""
    return tuple(channel.joint for channel in fit.problem.channels if channel.kind.unknown_gain)


def has_wrenches(fit: Fit) -> bool:
    """Decide whether wrenches on bodies or on a floating base are measured."""
    return bool(fit.problem.wrenches or fit.problem.base)


def wrenches_first(fit: Fit, advice: str) -> str:
    """Advise to check measured wrenches before all else: a wrong one has the effects of other faults."""
    return f"{WRENCHES}; otherwise {advice}" if has_wrenches(fit) else advice


def which_payload(fit: Fit) -> str:
    """Continue an advice with what to check of payloads, where there are any."""
    return ", which runs carry the payload, and on which body" if fit.system.payloads else ""
