"""Checks against what is known beside the logs: units and signs, and legs of the same geometry.

A wrong unit or sign fits the data as well as the truth, so that only sizes reveal it.
Grams for kilograms scale all gains and parameters, milliamperes for amperes a gain, a reversed column turns its sign.
What is known beside the logs speaks then: prior gains first, which settle the size of their joint's gain; else the
gains of the other joints, what an arm of this reach carries, what drives take, the inertias of the robot's file, and
the limits of effort. Each of these moves a gain by far more than its interval, so each decides its verdict.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from gtau.estimation.diagnostics.verdict import NEGATIVE_STD, half_widths, motors
from gtau.estimation.effects.effect import Levels
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.problem import Estimates
from gtau.findings import Finding, Grade
from gtau.findings import FindingKind as F
from gtau.model.base_parameters import regrouped
from gtau.robots.geometry import identical_legs
from gtau.robots.parameter import Parameter, gain_unit, parameter_of, torque_unit
from gtau.robots.robot import GROUND, PLAIN_FRICTION, Robot
from gtau.signals.reading.statements import FIRST_MOMENTS, Payload
from gtau.signals.run import Run
from gtau.signals.storage import block, spans

if TYPE_CHECKING:
    from gtau.estimation.diagnostics.inertia_audit import InertiaAudit

PRIOR_FACTOR = 2.0  # gain over its prior, or the inverse
GAINS_APART = 15.0  # gain of a joint over the next smaller one, turning joints and slides each among themselves
FILE_FACTOR = 2.0  # rms of the identified first moments over that of the robot's file, or the inverse
FILE_ALIKE = 1.5  # factor of a moment over that of all, or the inverse, within which it has that factor
FILE_SHARE = 2 / 3  # share of the moments within FILE_ALIKE, from which a factor is one of all
LIGHTEST = 0.03  # kg/m, of an arm whose largest first moment is that of a rod as long as its reach, and at most
HEAVIEST = 2000.0
OTHER_UNIT = 10.0  # factor from which a unit is wrong
EFFORT_FACTOR = 2.0  # rms torque over the joint's limit of effort
LEG_PROBABILITY = 0.001  # probability that legs which are alike differ by as much
LEG_DIFFERENCE = 20.0  # difference of a parameter between like legs, per cent
LEG_DIFFERENCE_STD = 5.0  # difference of a parameter between like legs, standard deviations
LARGEST_CURRENT = 100.0  # rms current of a joint, A, from which it is rather in mA
SMALLEST_CURRENT = 0.02  # largest rms current of all joints, A, below which a current stated in mA is rather in A
LARGEST_VOLTAGE = 1500.0  # rms speed of a joint times its gain, V: what its motor induces, from which a unit is wrong
GRAVITY_RANGE = 0.04  # strength of gravity from 9.80 m/s2, or 1.62 on the moon, beyond which it is of no place
PAYLOAD_DENSITY = 100.0  # mass of a payload over the cube of the arm's reach, kg/m3, from which it is rather in g
CURRENTS_APART = 30.0  # rms current of a joint over the next smaller one, from which units may differ between joints
BEYOND_GEARS = 1000.0  # largest torque scale of motor-side torques: beyond it a unit is wrong, or the torque vanishes

PLACES = (9.80, 1.62)  # m/s2, on earth and on the moon


def units_and_signs(
    fit: Fit, estimates: Estimates, prior_gains: Mapping[str, float], audit: InertiaAudit | None
) -> Iterator[Finding]:
    """Find gains, given or estimated, that only a wrong unit or sign explains.

    Prior gains (N m/A or N per A, by joint) settle the size of a gain that is estimated.
    """
    dataset, apart = fit.dataset, []
    settled = set(prior_gains) if fit.free_gains else set()
    if fit.free_gains:
        # signed, of joints whose interval excludes zero
        of_joints = zip(fit.system.problem.joints, fit.gains, half_widths(fit, estimates), strict=True)
        base = dataset.robot.base
        known = {joint: float(gain) for joint, gain, half in of_joints if half < 1 and joint not in base}
        yield from _unlike_priors(fit, known, prior_gains)
        apart = [*_gains_apart(fit, known), *_voltages(fit, known)]
    of_sizes = (
        *apart,
        *doubtful_gravity(dataset.robot),
        *doubtful_payloads(dataset.robot, (run.payload for run in dataset.runs)),
        *doubtful_currents(dataset.runs, dataset.robot.base),
        *((list(unlike_file(audit)) if audit else ()) or unlike_arms(fit, estimates)),
    )
    for finding in of_sizes:
        joints = finding.joints or motors(fit)
        if doubted := tuple(joint for joint in joints if joint not in settled):
            yield replace(finding, joints=doubted)
    yield from _efforts_exceeded(fit, settled)


def _unlike_priors(fit: Fit, known: Mapping[str, float], priors: Mapping[str, float]) -> Iterator[Finding]:
    """Find gains more than a factor of two from their prior (by joint, N m/A or N per A), or of another sign.

    Without a prior they are positive.
    """
    robot, kind = fit.dataset.robot, fit.dataset.runs[0].kind
    least, most = (1 / OTHER_UNIT, BEYOND_GEARS / 2) if kind == "torque" else (0.0, np.inf)
    for joint, gain in zip(fit.system.problem.joints, fit.gains.tolist(), strict=True):
        prior = priors.get(joint)
        ratio = abs(gain / prior) if prior else 1.0
        if not 1 / PRIOR_FACTOR <= ratio <= PRIOR_FACTOR:
            values = {"ratio": ratio, "prior": prior, "unit": gain_unit(robot, joint, kind)}
            yield Finding(F.PRIOR_GAIN, (joint,), values=values)
        elif joint in known and prior is None and not least <= abs(gain) <= most:
            yield Finding(F.PRIOR_GAIN, (joint,), values={"ratio": abs(gain)})
        if joint in known and gain * (prior or 1.0) < 0:
            values = {"kind": kind, "negative": gain < 0, "prior": prior is not None}
            yield Finding(F.NEGATIVE_GAIN, (joint,), values=values)


def _gains_apart(fit: Fit, known: Mapping[str, float]) -> Iterator[Finding]:
    """Find joints whose gains differ from all others by more than motors and gears of one robot explain."""
    robot, kind = fit.dataset.robot, fit.dataset.runs[0].kind
    of_unit: dict[str, list[tuple[float, str]]] = {}
    for joint, gain in known.items():
        of_unit.setdefault(gain_unit(robot, joint, kind), []).append((abs(gain), joint))
    for unit, gains in of_unit.items():
        gains.sort()
        for k, ((smaller, below), (larger, above)) in enumerate(pairwise(gains), start=1):
            if larger <= GAINS_APART * smaller:
                continue
            # the fewer of the two groups, or both
            few = gains[:k] if 2 * k < len(gains) else gains[k:] if 2 * k > len(gains) else gains
            for gain, joint in few:
                peer, of_peer = (above, larger) if gain <= smaller else (below, smaller)
                ratio = max(gain / of_peer, of_peer / gain)
                values = {"ratio": ratio, "gain": gain, "unit": unit, "kind": kind, "of_peer": of_peer}
                yield Finding(F.GAINS_APART, (joint,), peer, values)


def _voltages(fit: Fit, known: Mapping[str, float]) -> Iterator[Finding]:
    """Find gains that are too large for the speed of their joint, as a motor's voltage per speed is its gain."""
    problem, kind = fit.system.problem, fit.dataset.runs[0].kind
    speeds = dict(zip(problem.joints, Levels(fit).speeds.tolist(), strict=False))
    volts = {joint: abs(gain) * speeds[joint] for joint, gain in known.items()}
    worst = max(volts, key=lambda joint: volts[joint], default="")
    if kind == "current" and worst and volts[worst] > LARGEST_VOLTAGE:
        values = {"gain": abs(known[worst]), "unit": gain_unit(fit.dataset.robot, worst, kind), "volts": volts[worst]}
        yield Finding(F.SMALL_CURRENT, (), worst, values)


def doubtful_gravity(robot: Robot) -> Iterator[Finding]:
    """Find a strength of gravity that is of no place where robots are; without gravity there is nothing to doubt."""
    strength = float(np.linalg.norm(robot.gravity))
    if strength and min(abs(strength - place) for place in PLACES) > GRAVITY_RANGE:
        yield Finding(F.STRENGTH, values={"strength": strength})


def doubtful_currents(runs: Sequence[Run], base: Collection[str] = ()) -> Iterator[Finding]:
    """Find currents of a size of no drive, or very different between joints but those of a floating ``base``."""
    if runs[0].kind != "current":
        return
    joints = runs[0].joints
    squares = sum(
        np.sum(block(run.command, *span)[:, : len(joints)] ** 2, axis=0)
        for run in runs
        for span in spans(len(run.time))
    )
    sizes = np.sqrt(squares / sum(len(run.time) for run in runs)).tolist()
    # joints at rest may have no current
    driven = sorted((rms, joint) for joint, rms in zip(joints, sizes, strict=True) if joint not in base and rms > 0)
    if large := tuple(joint for rms, joint in driven if rms > LARGEST_CURRENT):
        yield Finding(F.LARGE_CURRENT, large, large[-1], {"rms": driven[-1][0]})
    if driven and driven[-1][0] < SMALLEST_CURRENT:
        yield Finding(F.SMALL_CURRENT, tuple(joint for _, joint in driven), driven[-1][1], {"rms": driven[-1][0]})
    for (small, below), (larger, above) in pairwise(driven):
        if larger > CURRENTS_APART * small:
            yield Finding(F.CURRENTS_APART, (above,), below, {"larger": larger, "smaller": small})


def doubtful_payloads(robot: Robot, payloads: Iterable[Payload | None]) -> Iterator[Finding]:
    """Find masses too large for an arm of this reach; robots with closures, and floating ones, carry more."""
    reach = None if robot.closures or robot.floating else _reach(robot)
    if not reach:
        return
    most = PAYLOAD_DENSITY * reach**3
    for name, mass in dict.fromkeys((payload.name, payload.mass) for payload in payloads if payload and payload.mass):
        if mass is not None and mass > most:
            yield Finding(F.HEAVY_PAYLOAD, (), name, {"mass": mass, "reach": reach, "most": most})


def _reach(robot: Robot) -> float | None:
    """Add up the links from the ground to the body that carries payloads, m; None where a slide has no limits."""
    reach, body = 0.0, robot.tool
    while body != GROUND:
        joint = robot.joint(body)
        reach += float(np.linalg.norm(joint.placement.position))
        if joint.kind == "prismatic":
            if joint.limits.position is None:
                return None
            reach += max(map(abs, joint.limits.position))
        body = joint.antecedent
    return reach


def unlike_file(audit: InertiaAudit) -> Iterator[Finding]:
    """Find first moments that are out of scale with those of the robot's file, by one factor for all."""
    moments = [
        (audited.value, audited.stated)
        for audited in audit.parameters
        if parameter_of(audited.name).kind in FIRST_MOMENTS and audited.value and audited.std and audited.stated
        if abs(audited.value) > NEGATIVE_STD * audited.std
    ]
    if len(moments) >= 2:
        identified, stated = np.abs(np.transpose(moments))
        factor = float(np.linalg.norm(identified) / np.linalg.norm(stated))
        apart, own = max(factor, 1 / factor), np.log(identified / stated / factor)
        common = np.mean(np.abs(own) < np.log(FILE_ALIKE)) >= FILE_SHARE  # no link alone that is far too heavy
        if apart > OTHER_UNIT or (apart > FILE_FACTOR and common):
            yield Finding(F.UNLIKE_FILE, values={"factor": factor, "count": len(moments)})


def unlike_arms(fit: Fit, estimates: Estimates) -> Iterator[Finding]:
    """Find logged torques by which an arm of this reach would be far lighter or heavier than arms are."""
    robot, theta = fit.dataset.robot, fit.solution.theta
    reach = None if robot.closures or robot.floating else _reach(robot)
    if not reach or fit.free_gains or fit.dataset.runs[0].kind != "torque":
        return
    std = np.sqrt(np.diag(estimates.covariance))
    moments = [
        (abs(float(theta[place])), name)
        for name, place in estimates.unknowns.places.items()
        if parameter_of(name).kind in FIRST_MOMENTS and abs(theta[place]) > NEGATIVE_STD * std[place]
    ]
    moment, name = max(moments, default=(0.0, ""))
    if moments and not LIGHTEST <= (weight := 2 * moment / reach**2) <= HEAVIEST:
        yield Finding(
            F.UNLIKE_FILE,
            text=f"the largest first moment, {name} of {moment:.2g} kg m, is that of an arm of {weight:.2g} kg "
            f"per metre of its reach of {reach:.2g} m, and arms have 0.3 to 300 kg",
            advice="check the unit of the torques and the lengths in the robot file",
            grade=Grade.CONTRADICTORY,
        )


def _efforts_exceeded(fit: Fit, settled: Collection[str]) -> Iterator[Finding]:
    """Find joints whose torque, rms in N m or N, is more than twice their effort limit.

    The limit, not the torque, is in doubt where the gain is ``settled``, and on an arm with the same limit everywhere.
    """
    robot, problem = fit.dataset.robot, fit.system.problem
    limits = {joint: robot.joint(joint).limits.effort for joint in problem.joints}
    if len(limits) >= 3 and len(set(limits.values())) == 1 and not robot.closures:
        settled = limits  # a placeholder
    levels = np.abs(fit.solution.gains) * problem.signal
    torques = dict(zip(problem.joints, levels.tolist(), strict=False))
    ratios = {joint: torques[joint] / limit for joint, limit in limits.items() if limit}
    context = {"given": not fit.free_gains, "kind": fit.dataset.runs[0].kind}
    over = sorted((joint for joint, ratio in ratios.items() if ratio > EFFORT_FACTOR), key=lambda name: ratios[name])
    doubtful = tuple(joint for joint in over if joint in settled)
    exceeded = tuple(joint for joint in over if joint not in settled)
    for kind, joints in ((F.DOUBTFUL_LIMIT, doubtful), (F.EFFORT, exceeded)):
        for worst in joints[-1:]:
            values = {"torque": torques[worst], "limit": limits[worst], "ratio": ratios[worst]}
            values |= {"all": len(joints) == len(ratios), "unit": torque_unit(robot, worst)}
            yield Finding(kind, joints, worst, values | context)


def unlike_legs(fit: Fit, estimates: Estimates) -> Iterator[Finding]:
    """Find the leg that differs most from those of the same geometry (the paper's check after section 3.1).

    Their frictions always differ, and the table shows them.
    """
    dataset, unknowns = fit.dataset, estimates.unknowns
    listed = regrouped(dataset.base, dataset.model.parameter_names)
    terms = {name: regrouping for name, regrouping in listed.items() if name in unknowns.places}
    index = unknowns.at(terms)
    covariance = estimates.covariance[np.ix_(index, index)]
    if not np.diag(covariance).all():
        return
    unlike = [
        finding
        for finding in leg_differences(dataset.robot, terms, fit.solution.theta[index], covariance)
        if finding.values["probability"] < LEG_PROBABILITY
        and finding.values["parameter"].kind not in PLAIN_FRICTION
        and 100 * finding.values["share"] > LEG_DIFFERENCE
        and abs(finding.values["t"]) > LEG_DIFFERENCE_STD
    ]
    if unlike:
        yield max(unlike, key=lambda finding: finding.values["share"])


def leg_differences(
    robot: Robot, terms: Mapping[Parameter, Mapping[Parameter, float]], parameters: np.ndarray, covariance: np.ndarray
) -> Iterator[Finding]:
    """Compare every leg's identified parameters with the mean of those of the legs of the same geometry.

    ``terms`` are base parameters (k,) that were identified, with what each regroups: only those that regroup the same
    standard ones, leg by leg, are compared. ``parameters`` (k,) are their values, with ``covariance`` (k, k). Yields by
    leg that has like ones (of two like legs only the first) and parameter: the difference as ``share`` of the mean of
    the others and in standard deviations, ``t``; and the ``probability`` that legs which are alike differ by as much or
    more in all parameters together (Mahalanobis).
    """
    from scipy.stats import chi2

    names = list(terms)
    for group in identical_legs(robot):
        tables = [{_in_leg(terms[name], leg): k for k, name in enumerate(names) if name.body in leg} for leg in group]
        shared = set.intersection(*map(set, tables))
        # (legs, parameters), in the order of the first leg
        places = np.array([[table[meaning] for meaning in tables[0] if meaning in shared] for table in tables])
        if len(group) < 2 or not shared:
            continue
        for k in range(len(group) if len(group) > 2 else 1):
            contrast = np.zeros((len(shared), len(names)))
            contrast[range(len(shared)), places] = -1.0 / (len(group) - 1)
            contrast[range(len(shared)), places[k]] = 1.0
            difference, scatter = contrast @ parameters, contrast @ covariance @ contrast.T
            others, std = np.minimum(contrast, 0.0) @ parameters, np.sqrt(np.diag(scatter))
            correlation, t = scatter / np.outer(std, std), difference / std
            square = float(t @ np.linalg.pinv(correlation, rcond=1e-10, hermitian=True) @ t)
            rank = int(np.linalg.matrix_rank(correlation, tol=1e-10, hermitian=True))
            shares = np.abs(np.divide(difference, others, out=np.full(len(shared), np.inf), where=others != 0))
            probability = float(chi2.sf(square, rank))
            for place, share, by in zip(places[k], shares.tolist(), t.tolist(), strict=True):
                values = {"parameter": names[place], "share": share, "t": by, "probability": probability}
                yield Finding(F.UNLIKE_LEGS, (), group[k][0], values)


def _in_leg(terms: Mapping[Parameter, float], leg: Sequence[str]) -> frozenset[tuple[str, int | str, float]]:
    """Describe what a parameter regroups, joints counted from the first of its leg, factors to three decimals."""
    return frozenset(
        (name.kind, leg.index(name.body) if name.body in leg else name.body, round(factor, 3))
        for name, factor in terms.items()
    )
