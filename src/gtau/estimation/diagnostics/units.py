"""Checks of units and signs, against what is known beside the logs.

A wrong unit or sign fits the data as well as the truth, so that only sizes reveal it: grams for kilograms scale all
gains and parameters, milliamperes for amperes a gain. Before any fit, currents, gravity and payloads have sizes. Of a
fit, prior gains settle the size of their joint's gain; else the gains of the other joints speak, what an arm of this
reach carries, what drives take, the inertias of the robot's file, and the limits of effort. Each of these moves a gain
by far more than its interval, so each decides its verdict.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from gtau.estimation.diagnostics.verdict import (
    FAR_APART,
    LARGE_CURRENT,
    NEGATIVE_GAIN,
    NEGATIVE_STD,
    contradiction,
    half_widths,
    motors,
)
from gtau.estimation.effects.effect import rms_speeds
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.problem import Estimates
from gtau.findings import Finding, listed, write_limits
from gtau.robots.parameter import gain_unit, parameter_of, torque_unit
from gtau.robots.robot import GROUND, Robot
from gtau.signals.reading.statements import FIRST_MOMENTS, Payload
from gtau.signals.run import Run
from gtau.signals.storage import block, spans

if TYPE_CHECKING:
    from gtau.estimation.diagnostics.inertia_audit import InertiaAudit

LARGEST_CURRENT = 100.0  # rms current of a joint, A, from which it is rather in mA
SMALLEST_CURRENT = 0.02  # largest rms current of all joints, A, below which a current stated in mA is rather in A
GRAVITY_RANGE = 0.04  # strength of gravity from 9.80 m/s2, or 1.62 on the moon, beyond which it is of no place
PAYLOAD_DENSITY = 100.0  # mass of a payload over the cube of the arm's reach, kg/m3, from which it is rather in g
CURRENTS_APART = 30.0  # rms current of a joint over the next smaller one, from which units may differ between joints
PRIOR_FACTOR = 2.0  # gain over its prior, or the inverse
GAINS_APART = 15.0  # gain of a joint over the next smaller one, turning joints and slides each among themselves
FILE_FACTOR = 2.0  # rms of the identified first moments over the file's, or the inverse
FILE_ALIKE = 1.5  # factor of a moment over the factor of all, or the inverse, within which it has that factor
FILE_SHARE = 2 / 3  # share of the moments within FILE_ALIKE, from which a factor is one of all
LIGHTEST = 0.03  # kg/m, of an arm with the largest first moment of a rod as long as its reach: least, and most
HEAVIEST = 2000.0
OTHER_UNIT = 10.0  # factor from which a unit is wrong
EFFORT_FACTOR = 2.0  # rms torque over the joint's limit of effort
LARGEST_VOLTAGE = 1500.0  # rms speed of a joint times its gain, V: what its motor induces, from which a unit is wrong
BEYOND_GEARS = 1000.0  # largest torque scale of motor-side torques: beyond it a unit is wrong, or the torque vanishes

PRIOR_GAIN, UNLIKE_FILE, SMALL_CURRENT = "prior gain", "inertias out of scale", "current too small"
EFFORT, DOUBTFUL_LIMIT = "effort limit", "doubtful effort limit"
PLACES = (9.80, 1.62)  # m/s2, on earth and on the moon


def doubtful_gravity(robot: Robot) -> Iterator[Finding]:
    """Find a strength of gravity that is of no place where robots are; without gravity there is nothing to doubt."""
    strength = float(np.linalg.norm(robot.gravity))
    if strength and min(abs(strength - place) for place in PLACES) > GRAVITY_RANGE:
        text = (
            f"gravity is {strength:.4g} m/s2 in the robot's description, and 9.76 to 9.84 on earth; gains and "
            "parameters that rest on weights have its error"
        )
        advice = (
            "write 'gravity: [0, 0, -9.81]' in the robot file (in base axes; 'moon' and 'none' are words), or state "
            "'prior_gains' if it is right"
        )
        yield contradiction("strength of gravity", (), text, advice, shown_as="model")


def doubtful_currents(runs: Sequence[Run], base: Collection[str] = ()) -> Iterator[Finding]:
    """Find currents that no drive takes, or that differ much between joints; a floating ``base`` has none."""
    if runs[0].kind != "current":
        return
    joints, squares = runs[0].joints, 0.0
    for run in runs:
        for span in spans(len(run.time)):
            squares = squares + np.sum(block(run.command, *span)[:, : len(joints)] ** 2, axis=0)
    sizes = np.sqrt(squares / sum(len(run.time) for run in runs)).tolist()
    # joints at rest may have no current
    driven = sorted((rms, joint) for joint, rms in zip(joints, sizes, strict=True) if joint not in base and rms > 0)
    if not driven:
        return
    most, largest = driven[-1]
    if large := tuple(joint for rms, joint in driven if rms > LARGEST_CURRENT):
        text = f"the current of joint '{largest}' is {most:.4g} A rms, more than drives of robots take"
        alike = [joint for rms, joint in driven if rms * CURRENTS_APART > most]
        unit = "mA" if len(alike) == len(driven) else f"{{{', '.join(f'{joint}: mA' for joint in alike)}}}"
        advice = f"if it is in mA, write units: {{current: {unit}}}; otherwise state 'prior_gains'"
        yield contradiction(LARGE_CURRENT, large, text, advice, largest, shown_as="unit")
    if most < SMALLEST_CURRENT:
        text = f"the largest current, of joint '{largest}', is {most:.2g} A rms, less than drives of robots take"
        names = tuple(joint for _, joint in driven)
        yield contradiction(SMALL_CURRENT, names, text, check_milliamperes(runs), largest, shown_as="unit")
    for (small, below), (larger, above) in pairwise(driven):
        if larger > CURRENTS_APART * small:
            text = (
                f"the current of joint '{above}' is {larger / small:.3g} times the current of '{below}' ({larger:.3g} "
                f"and {small:.3g} A rms)"
            )
            advice = "check that the columns are in the same unit (A, mA, % or counts), and convert the others"
            yield Finding("currents far apart", (above,), below, text=text, advice=advice, shown_as="unit")


def check_milliamperes(runs: Sequence[Run]) -> str:
    """Advise what to check where currents look too small."""
    mass = " and the payload's mass (kg)" if any(run.payload for run in runs) else ""
    return f"check the unit of the currents (A stated as mA?){mass}; if both are right, state 'prior_gains'"


def doubtful_payloads(robot: Robot, payloads: Iterable[Payload | None]) -> Iterator[Finding]:
    """Find masses too large for an arm of this reach."""
    reach = reach_of(robot) or np.inf
    most = PAYLOAD_DENSITY * reach**3
    for name, mass in dict.fromkeys((payload.name, payload.mass) for payload in payloads if payload):
        if mass is not None and mass > most:
            text = (
                f"payload '{name}' weighs {mass:.4g} kg, more than arms that reach {reach:.2g} m carry (about "
                f"{most:.3g} kg at most); all drive gains are proportional to it"
            )
            advice = f"if it is in g, write 'mass: {0.001 * mass:.4g}' (kg); otherwise state 'prior_gains'"
            yield contradiction("payload too heavy", (), text, advice, name, shown_as="unit")


def reach_of(robot: Robot) -> float | None:
    """Add up the links from the ground to the body that carries payloads, m.

    None where a slide has no limits, and of robots with closures and floating ones, which carry more.
    """
    if robot.closures or robot.floating:
        return None
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


def units_and_signs(
    fit: Fit, estimates: Estimates, prior_gains: Mapping[str, float], audit: InertiaAudit | None
) -> Iterator[Finding]:
    """Find gains, given or estimated, that only a wrong unit or sign explains.

    Prior gains (N m/A or N per A, by joint) settle the size of a gain that is estimated.
    """
    dataset = fit.dataset
    settled = set(prior_gains) if fit.free_gains else set()

    def doubted(findings: Iterable[Finding]) -> Iterator[Finding]:
        """Doubt the gains that no prior settles, all of them where a finding is on no joint."""
        for finding in findings:
            if joints := tuple(joint for joint in finding.joints or motors(fit) if joint not in settled):
                yield replace(finding, joints=joints)

    known = dict[str, float]()
    if fit.free_gains:
        # signed, of joints whose interval excludes zero
        gains = zip(fit.problem.joints, fit.gains, half_widths(fit, estimates), strict=True)
        known = {joint: float(gain) for joint, gain, half in gains if half < 1 and joint not in dataset.robot.base}
        yield from _unlike_priors(fit, known, prior_gains)
        yield from doubted(_gains_apart(fit, known))
    currents = list(doubtful_currents(dataset.runs, dataset.robot.base))
    small = [finding for finding in currents if finding.kind == SMALL_CURRENT]
    yield from doubted(doubtful_payloads(dataset.robot, (run.payload for run in dataset.runs)))
    yield from doubted(finding for finding in currents if finding.kind != SMALL_CURRENT)
    yield from doubted(doubtful_gravity(dataset.robot))
    determined = not fit.free_gains or len(known) >= len(fit.gains) / 2  # without a scale moments are of any size
    unlike = list(_unlike_file(audit, fit)) if audit and determined else []
    yield from doubted(unlike or _unlike_arms(fit, estimates))
    yield from _efforts_exceeded(fit, settled)
    yield from doubted([*_voltages(fit, known), *small])


def _unlike_priors(fit: Fit, known: Mapping[str, float], priors: Mapping[str, float]) -> Iterator[Finding]:
    """Find gains more than a factor of two from their prior (by joint, N m/A or N per A), or of another sign.

    Without a prior they are positive.
    """
    robot, kind = fit.dataset.robot, fit.kind
    least, most = (1 / OTHER_UNIT, BEYOND_GEARS / 2) if kind == "torque" else (0.0, np.inf)
    for joint, gain in zip(fit.problem.joints, fit.gains.tolist(), strict=True):
        prior = priors.get(joint)
        ratio = abs(gain / prior) if prior else 1.0
        if not 1 / PRIOR_FACTOR <= ratio <= PRIOR_FACTOR:
            unit = gain_unit(robot, joint, kind)
            text = f"the gain of '{joint}' is {ratio:.4g} times its prior of {prior:.4g} {unit}"
            check = "the payload's mass (kg), the unit of the currents, and 'prior_gains'"
            if 1 / PRIOR_FACTOR < ratio / 1000 < PRIOR_FACTOR:
                check = "the payload's mass (g entered as kg?) and the unit of the currents (A declared as mA?)"
            elif 1 / PRIOR_FACTOR < 1000 * ratio < PRIOR_FACTOR:
                check = "the unit of the currents (mA declared as A?) and the payload's mass in kg"
            yield contradiction(PRIOR_GAIN, (joint,), text, f"check {check}", shown_as="model")
        elif joint in known and prior is None and not least <= abs(gain) <= most:
            text = f"the true torque of '{joint}' is {abs(gain):.4g} times the logged one"
            advice = "check the unit of the torques (N m, N mm?) and the payload's mass (kg), or state 'prior_gains'"
            yield contradiction(PRIOR_GAIN, (joint,), text, advice, shown_as="model")
        if joint in known and gain * (prior or 1.0) < 0:
            sign, driven = ("negative", "backwards") if gain < 0 else ("positive", "forwards")
            meant = "the drive does turn against its joint, state a negative prior gain"
            if prior is not None:
                meant = "that is intended, reverse the prior gain"
            text = f"{sign} gain: positive {kind} drives '{joint}' {driven}"
            advice = f"reverse the sign of its {kind} or position column ('-COLUMN'); or if {meant}"
            yield contradiction(NEGATIVE_GAIN, (joint,), text, advice, shown_as="model")


def _gains_apart(fit: Fit, known: Mapping[str, float]) -> Iterator[Finding]:
    """Find joints whose gains differ from all others by more than motors and gears of one robot explain."""
    robot, kind = fit.dataset.robot, fit.kind
    by_unit: dict[str, list[tuple[float, str]]] = {}
    for joint, gain in known.items():
        by_unit.setdefault(gain_unit(robot, joint, kind), []).append((abs(gain), joint))
    for unit, gains in by_unit.items():
        gains.sort()
        for k, ((smaller, below), (larger, above)) in enumerate(pairwise(gains), start=1):
            if larger <= GAINS_APART * smaller:
                continue
            # the fewer of the two groups, or both
            few = gains[:k] if 2 * k < len(gains) else gains[k:] if 2 * k > len(gains) else gains
            for gain, joint in few:
                pair = sorted([(gain, joint), (larger, above) if gain <= smaller else (smaller, below)])
                (least, low), (most, high) = pair
                text = (
                    f"the gains of '{low}', {least:.3g} {unit}, and '{high}', {most:.3g} {unit}, differ by a factor of "
                    f"{most / least:.0f}, which is implausible for motors and gears of one robot"
                )
                advice = (
                    f"check that the {kind} columns of these joints are in the same unit, and convert those that are "
                    "not; if the motors do differ, state 'prior_gains'"
                )
                yield contradiction(FAR_APART, (joint,), text, advice, high if joint == low else low, shown_as="model")


def _voltages(fit: Fit, known: Mapping[str, float]) -> Iterator[Finding]:
    """Find gains that are too large for the speed of their joint, as a motor's voltage per speed is its gain."""
    runs, robot = fit.dataset.runs, fit.dataset.robot
    speeds = dict(zip(fit.problem.joints, rms_speeds(fit).tolist(), strict=False))
    volts = {joint: abs(gain) * speeds[joint] for joint, gain in known.items()}
    worst = max(volts, key=lambda joint: volts[joint], default="")
    if runs[0].kind == "current" and worst and volts[worst] > LARGEST_VOLTAGE:
        gain = f"{abs(known[worst]):.4g} {gain_unit(robot, worst, 'current')}"
        text = (
            f"the gain of '{worst}', {gain}, would induce {volts[worst]:.3g} V in its motor at the logged speed (rms), "
            "more than drives of robots supply"
        )
        yield contradiction(SMALL_CURRENT, (), text, check_milliamperes(runs), worst, shown_as="unit")


def reversed_by_file(fit: Fit, audit: InertiaAudit, estimates: Estimates) -> Iterator[Finding]:
    """Find that first moments have the other sign than in the robot's file: all torques may be reversed together.

    The ``estimates`` are without what effects would move them by: effects explain part of reversed torques.
    """
    stds = np.sqrt(np.diag(estimates.covariance))
    without = {} if audit.prior else {str(name): stds[place] for name, place in estimates.unknowns.places.items()}
    (identified, stated), _ = _first_moments(audit, without)
    if fit.free_gains or len(stated) < 2 or identified @ stated > -(stated @ stated) / FILE_FACTOR:
        return
    names, kind = motors(fit), fit.kind
    text = f"the {kind}s of {listed(names)} look reversed: the inertias of the robot file contradict their sign"
    yield contradiction("reversed channels", names, text, f"check the signs of the {kind} and position columns")


def _first_moments(audit: InertiaAudit, stds: Mapping[str, float]) -> tuple[np.ndarray, set[str]]:
    """List first moments that differ from zero by ``stds`` or the audit's, of data and file (2, m), and their links."""
    moments = [
        (audited.value, audited.stated, audited.link)
        for audited in audit.parameters
        if parameter_of(audited.name).kind in FIRST_MOMENTS and audited.value and audited.std and audited.stated
        if abs(audited.value) > NEGATIVE_STD * stds.get(audited.name, audited.std)
    ]
    return np.reshape([both for *both, _ in moments], (-1, 2)).T, {link for *_, link in moments}


def _unlike_file(audit: InertiaAudit, fit: Fit | None = None) -> Iterator[Finding]:
    """Find first moments that are out of scale with the robot's file, by one factor for all."""
    moments, links = _first_moments(audit, {})
    if len(links) < 2:  # one may carry what the file does not know, such as a gripper
        return
    identified, stated = np.abs(moments)
    factor = float(np.linalg.norm(identified) / np.linalg.norm(stated))
    apart, ratios = max(factor, 1 / factor), np.log(identified / stated / factor)
    if apart > FILE_FACTOR and np.mean(np.abs(ratios) < np.log(FILE_ALIKE)) >= FILE_SHARE:
        text = (
            f"the first moments of the links are {factor:.3g} times the first moments in the robot's file (rms of "
            f"{len(stated)})"
        )
        voltages = fit and fit.dataset.motors and not fit.system.payloads
        unit = "unit of the voltages" if voltages else "payload's mass (kg), the unit of the torques"
        advice = f"check the {unit}, and the masses in the file; if the file is wrong, state 'prior_gains'"
        yield contradiction(UNLIKE_FILE, (), text, advice, shown_as="model")


def _unlike_arms(fit: Fit, estimates: Estimates) -> Iterator[Finding]:
    """Find logged torques by which an arm of this reach would be far lighter or heavier than arms are."""
    reach, theta = reach_of(fit.dataset.robot), fit.solution.theta
    if not reach or fit.free_gains or fit.kind != "torque":
        return
    std = np.sqrt(np.diag(estimates.covariance))
    moments = [
        (abs(float(theta[place])), name)
        for name, place in estimates.unknowns.places.items()
        if parameter_of(name).kind in FIRST_MOMENTS and abs(theta[place]) > NEGATIVE_STD * std[place]
    ]
    moment, name = max(moments, default=(0.0, ""))
    weight = 2 * moment / reach**2
    if moments and not LIGHTEST <= weight <= HEAVIEST:
        text = (
            f"the largest first moment, {name} = {moment:.2g} kg m, means an arm of {weight:.2g} kg per metre of its "
            f"reach of {reach:.2g} m, and arms have 0.3 to 300 kg"
        )
        yield contradiction(UNLIKE_FILE, (), text, "check the unit of the torques and the lengths in the robot file")


def _efforts_exceeded(fit: Fit, settled: Collection[str]) -> Iterator[Finding]:
    """Find joints whose torque, rms in N m or N, is more than twice their effort limit.

    The limit, not the torque, is in doubt where the gain is ``settled``, and on an arm with the same limit everywhere.
    """
    robot, problem, kind = fit.dataset.robot, fit.problem, fit.kind
    limits = {joint: robot.joint(joint).limits.effort for joint in problem.joints}
    if len(limits) >= 3 and len(set(limits.values())) == 1 and not robot.closures:
        settled = limits  # a placeholder
    levels = np.abs(fit.solution.gains) * problem.signal
    torques = dict(zip(problem.joints, levels.tolist(), strict=False))
    ratios = {joint: torques[joint] / limit for joint, limit in limits.items() if limit}
    over = sorted((joint for joint, ratio in ratios.items() if ratio > EFFORT_FACTOR), key=lambda name: -ratios[name])
    for limit_doubted in (True, False):
        joints = tuple(joint for joint in over if (joint in settled) == limit_doubted)
        if not joints:
            continue
        worst, unit = joints[0], torque_unit(robot, joints[0])
        text = (
            f"the torque of '{worst}' is {torques[worst]:.3g} {unit} (rms), {ratios[worst]:.3g} times its limit of "
            f"{limits[worst]:.4g} {unit}"
        )
        if len(joints) == len(ratios):
            doubted = "the payload's mass, which sets the scale," if fit.free_gains else f"the unit of the {kind}s"
            text += f", so {doubted} may be wrong"
        advice = (
            f"check the payload's mass (kg) and the unit of the {kind}s; if the limit is a placeholder, "
            f"{write_limits(worst)}"
        )
        if limit_doubted:
            yield Finding(DOUBTFUL_LIMIT, joints, worst, text=text, advice=advice, shown_as="joint limits")
        else:
            yield contradiction(EFFORT, joints, text, advice, worst, shown_as="model")
