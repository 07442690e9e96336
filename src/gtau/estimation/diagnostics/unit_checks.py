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

import numpy as np

from gtau.estimation.diagnostics.gain_checks import half_widths
from gtau.estimation.diagnostics.inertia_audit import InertiaAudit
from gtau.estimation.diagnostics.verdict import motors
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.problem import Estimates, Problem
from gtau.estimation.thresholds.estimates import (
    EFFORT_FACTOR,
    FILE_FACTOR,
    GAINS_APART,
    LEG_DIFFERENCE,
    LEG_DIFFERENCE_STD,
    LEG_PROBABILITY,
    NEGATIVE_STD,
    PRIOR_FACTOR,
)
from gtau.estimation.thresholds.logs import CURRENTS_APART, LARGEST_CURRENT, PAYLOAD_DENSITY
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.model.base_parameters import regrouped
from gtau.robots.geometry import identical_legs
from gtau.robots.parameter import Parameter, gain_unit, parameter_of, torque_unit
from gtau.robots.robot import GROUND, PLAIN_FRICTION, Robot
from gtau.signals.reading.statements import FIRST_MOMENTS, Payload
from gtau.signals.run import Run
from gtau.signals.storage import block, spans


def units_and_signs(
    fit: Fit, estimates: Estimates, prior_gains: Mapping[str, float], audit: InertiaAudit | None
) -> Iterator[Finding]:
    """Find gains, given or estimated, that only a wrong unit or sign explains.

    Prior gains (N m/A or N/A, by joint) settle the size of a gain that is estimated.
    """
    dataset = fit.dataset
    settled = set(prior_gains) if fit.free_gains else set()
    if fit.free_gains:
        yield from _prior_gains_off(fit, prior_gains)
        yield from _turned(fit, estimates, prior_gains)
    of_sizes = (
        *(_gains_apart(fit, estimates) if fit.free_gains else ()),
        *doubtful_payloads(dataset.robot, (run.payload for run in dataset.runs)),
        *doubtful_currents(dataset.runs, dataset.robot.base),
        *unlike_file(audit),
    )
    for finding in of_sizes:
        joints = tuple(joint for joint in finding.joints or motors(fit) if joint not in settled)
        if joints:
            yield replace(finding, joints=joints)
    yield from _efforts_exceeded(fit, settled)


def _known_gains(fit: Fit, estimates: Estimates) -> dict[str, float]:
    """Collect the gains, signed, of joints whose interval excludes zero."""
    known = zip(fit.system.problem.joints, fit.gains, half_widths(fit, estimates), strict=True)
    return {joint: float(gain) for joint, gain, half in known if half < 1 and joint not in fit.dataset.robot.base}


def _prior_gains_off(fit: Fit, priors: Mapping[str, float]) -> Iterator[Finding]:
    """Find gains that differ by more than a factor of two from their prior (by joint, N m/A or N/A)."""
    robot = fit.dataset.robot
    for joint, gain in zip(fit.system.problem.joints, fit.gains, strict=True):
        ratio = abs(gain / priors[joint]) if joint in priors else 1.0
        if not 1 / PRIOR_FACTOR <= ratio <= PRIOR_FACTOR:
            unit = gain_unit(robot, joint, fit.dataset.runs[0].kind)
            values = {"ratio": float(ratio), "prior": priors[joint], "unit": unit}
            yield Finding(F.PRIOR_GAIN, (joint,), values=values)


def _turned(fit: Fit, estimates: Estimates, priors: Mapping[str, float]) -> Iterator[Finding]:
    """Find gains of the other sign than their prior, or negative ones without a prior."""
    kind = fit.dataset.runs[0].kind
    for joint, gain in _known_gains(fit, estimates).items():
        if gain * priors.get(joint, 1.0) < 0:
            values = {"kind": kind, "negative": gain < 0, "prior": joint in priors}
            yield Finding(F.NEGATIVE_GAIN, (joint,), values=values)


def _gains_apart(fit: Fit, estimates: Estimates) -> Iterator[Finding]:
    """Find joints whose gains differ from all others by more than motors and gears of one robot explain."""
    robot, kind = fit.dataset.robot, fit.dataset.runs[0].kind
    of_unit: dict[str, list[tuple[float, str]]] = {}
    for joint, gain in _known_gains(fit, estimates).items():
        of_unit.setdefault(gain_unit(robot, joint, kind), []).append((abs(gain), joint))
    for unit, gains in of_unit.items():
        gains.sort()
        for k, ((smaller, below), (larger, above)) in enumerate(pairwise(gains), start=1):
            if larger <= GAINS_APART * smaller:
                continue
            few = [*(gains[:k] if 2 * k <= len(gains) else []), *(gains[k:] if 2 * k >= len(gains) else [])]
            for gain, joint in few:
                peer, of_peer = (above, larger) if gain <= smaller else (below, smaller)
                values = {"ratio": max(gain / of_peer, of_peer / gain), "gain": gain, "unit": unit, "kind": kind}
                yield Finding(F.GAINS_APART, (joint,), peer, {**values, "of_peer": of_peer})


def doubtful_currents(runs: Sequence[Run], base: Collection[str] = ()) -> Iterator[Finding]:
    """Find currents that are too large, or of very different size between joints but those of a floating ``base``."""
    if runs[0].kind != "current":
        return
    squares, samples = np.zeros(len(runs[0].joints)), 0
    for run in runs:
        n = len(run.joints)
        squares += sum(np.sum(block(run.command, *span)[:, :n] ** 2, axis=0) for span in spans(len(run.time)))
        samples += len(run.time)
    # joints at rest may have no current
    driven = sorted(
        (float(rms), joint)
        for joint, rms in zip(runs[0].joints, np.sqrt(squares / samples), strict=True)
        if joint not in base and rms > 0
    )
    if large := tuple(joint for rms, joint in driven if rms > LARGEST_CURRENT):
        yield Finding(F.LARGE_CURRENT, large, large[-1], {"rms": driven[-1][0]})
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


def unlike_file(audit: InertiaAudit | None) -> Iterator[Finding]:
    """Find first moments that are all together out of scale with those of the robot's file."""
    moments = [
        (audited.value, audited.stated)
        for audited in (() if audit is None else audit.parameters)
        if parameter_of(audited.name).kind in FIRST_MOMENTS and audited.value and audited.std and audited.stated
        if abs(audited.value) > NEGATIVE_STD * audited.std
    ]
    if len(moments) >= 2:
        identified, stated = np.linalg.norm(moments, axis=0)
        factor = float(identified / stated)
        if not 1 / FILE_FACTOR <= factor <= FILE_FACTOR:
            yield Finding(F.UNLIKE_FILE, values={"factor": factor, "count": len(moments)})


def _efforts_exceeded(fit: Fit, settled: Collection[str]) -> Iterator[Finding]:
    """Find joints whose torque, rms in N m or N, is more than twice their effort limit.

    The limit, not the torque, is in doubt where the gain is ``settled``, and on an arm with the same limit everywhere.
    """
    robot, problem = fit.dataset.robot, fit.system.problem
    limits = {joint: robot.joint(joint).limits.effort for joint in problem.joints}
    placeholder = len(limits) >= 3 and len(set(limits.values())) == 1 and not robot.closures
    torques = dict(zip(problem.joints, np.abs(fit.solution.gains) * problem.signal, strict=False))
    ratios = {joint: float(torques[joint] / limit) for joint, limit in limits.items() if limit}
    over = sorted((ratio, joint) for joint, ratio in ratios.items() if ratio > EFFORT_FACTOR)
    for kind, joints in (
        (F.DOUBTFUL_LIMIT, [joint for _, joint in over if placeholder or joint in settled]),
        (F.EFFORT, [joint for _, joint in over if not placeholder and joint not in settled]),
    ):
        if joints:
            worst = joints[-1]
            values = {"torque": float(torques[worst]), "limit": limits[worst], "ratio": ratios[worst]}
            of_all = {"all": len(joints) == len(ratios), "given": not fit.free_gains, "kind": fit.dataset.runs[0].kind}
            yield Finding(kind, tuple(joints), worst, {**values, **of_all, "unit": torque_unit(robot, worst)})


def unlike_legs(dataset: Dataset, problem: Problem, theta: np.ndarray, covariance: np.ndarray) -> Iterator[Finding]:
    """Find the leg that differs most from those of the same geometry (the paper's check after section 3.1).

    Their frictions always differ, and the table shows them.
    """
    place = {name: k for k, name in enumerate(problem.parameters)}
    listed = regrouped(dataset.base, dataset.model.parameter_names)
    terms = {name: listed[name] for name in dataset.base.names if name in place}
    index = [place[name] for name in terms]
    if not np.diag(covariance)[index].all():
        return
    unlike = [
        finding
        for finding in leg_differences(dataset.robot, terms, theta[index], covariance[np.ix_(index, index)])
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

    Parameters
    ----------
    robot : Robot
    terms : mapping
        Base parameters that were identified, all or the essential ones, with what each regroups: only those that
        regroup the same standard ones, leg by leg, are compared.
    parameters : ndarray
        Their values, (len(terms),).
    covariance : ndarray
        (len(terms), len(terms)).

    Yields
    ------
    Finding
        By leg that has like ones (of two like legs only the first) and parameter: the difference as ``share`` of the
        mean of the others and in standard deviations, ``t``; and the ``probability`` that legs which are alike differ
        by as much or more in all parameters together (Mahalanobis).
    """
    from scipy.stats import chi2

    names = list(terms)
    for group in identical_legs(robot):
        tables = [{_in_leg(terms[name], leg): k for k, name in enumerate(names) if name.body in leg} for leg in group]
        shared = [meaning for meaning in tables[0] if all(meaning in table for table in tables)]
        if len(group) < 2 or not shared:
            continue
        for k in range(len(group) if len(group) > 2 else 1):
            contrast = np.zeros((len(shared), len(names)))
            for row, meaning in enumerate(shared):
                for j, table in enumerate(tables):
                    contrast[row, table[meaning]] = 1.0 if j == k else -1.0 / (len(group) - 1)
            difference, scatter = contrast @ parameters, contrast @ covariance @ contrast.T
            others, std = np.minimum(contrast, 0.0) @ parameters, np.sqrt(np.diag(scatter))
            correlation, t = scatter / np.outer(std, std), difference / std
            square = float(t @ np.linalg.pinv(correlation, rcond=1e-10, hermitian=True) @ t)
            rank = int(np.linalg.matrix_rank(correlation, tol=1e-10, hermitian=True))
            shares = np.abs(np.divide(difference, others, out=np.full(len(shared), np.inf), where=others != 0))
            for row, meaning in enumerate(shared):
                values = {"parameter": names[tables[k][meaning]], "share": float(shares[row]), "t": float(t[row])}
                probability = float(chi2.sf(square, rank))
                yield Finding(F.UNLIKE_LEGS, (), group[k][0], {**values, "probability": probability})


def _in_leg(terms: Mapping[Parameter, float], leg: Sequence[str]) -> frozenset[tuple[str, int | str, float]]:
    """Describe what a parameter regroups, joints counted from the first of its leg, factors to three decimals."""
    return frozenset(
        (name.kind, leg.index(name.body) if name.body in leg else name.body, round(factor, 3))
        for name, factor in terms.items()
    )
