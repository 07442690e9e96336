"""Verdicts on parameters, friction, delays and payloads, and the comparison of like legs."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gtau.estimation.diagnostics.verdict import GOOD, Verdict, verdict_of
from gtau.estimation.estimators.estimator import Solution
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.equations import SIGNALS, modelled
from gtau.estimation.regression.problem import Problem
from gtau.estimation.regression.system import System
from gtau.estimation.thresholds.estimates import (
    APART,
    LEG_DIFFERENCE,
    LEG_DIFFERENCE_STD,
    LEG_PROBABILITY,
    NEGATIVE_STD,
    WEAK_PARAMETER,
)
from gtau.estimation.thresholds.logs import DELAY_MOTION, DELAY_STD
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.model.base_parameters import BaseParameters
from gtau.robots.geometry import identical_legs
from gtau.robots.parameter import Parameter, parameter_of
from gtau.robots.robot import PLAIN_FRICTION, Robot

NONNEGATIVE = {"m", "xx", "yy", "zz", "ia", "fv", "fs"}
TERM = re.compile(r"([+-])\s*(?:[\d.e+-]+ )?([a-z]+\d?)_")


def parameter_verdict(value: float | None, std: float | None) -> Verdict:
    """Judge a parameter by its value and standard deviation."""
    if value is None:
        return verdict_of(Finding(F.INSEPARABLE))
    if std is None:
        return GOOD
    if abs(value) < 2 * std:
        return verdict_of(Finding(F.NEAR_ZERO))
    if std > WEAK_PARAMETER * abs(value):
        return verdict_of(Finding(F.UNCERTAIN, values={"std": std / abs(value)}))
    return GOOD


def judge_parameter(value: float | None, std: float | None, regrouping: str) -> Verdict:
    """Judge a base parameter from its value, standard deviation, and what it regroups."""
    if value is None or std is None or not std or value >= -NEGATIVE_STD * std or not cannot_be_negative(regrouping):
        return parameter_verdict(value, std)
    friction = regrouping.startswith(("fv", "fs"))
    return verdict_of(Finding(F.IMPOSSIBLE, values={"t": -value / std, "friction": friction}))


def cannot_be_negative(regrouping: str) -> bool:
    """Decide from its regrouping whether a base parameter is a sum of masses, moments of inertia or friction."""
    terms = TERM.findall(f"+ {regrouping}")
    return bool(terms) and all(sign == "+" and kind in NONNEGATIVE for sign, kind in terms)


def known_verdict(
    parameter: str,
    declared: float,
    found: float,
    std: float,
    unit: str,
    given: str = "",
    explained: tuple[str, ...] = (),
    remains: float = 1.0,
) -> Verdict:
    """Judge a known ``parameter`` of a payload by its estimate from the other known constants and the data.

    ``given`` is the kind of the commands where gains are given, else empty; ``explained`` the joints whose torque only
    the declared value leaves unexplained, and ``remains`` what the other leaves of the residual variance, the geometric
    mean of all channels.
    """
    if abs(found - declared) <= APART * std:
        return GOOD
    values = {"parameter": parameter, "declared": declared, "found": found, "std": std, "unit": unit}
    values |= {"given": given, "remains": remains}
    kind = F.PAYLOAD_MASS if parameter == "m" else F.PAYLOAD_PARAMETER
    return verdict_of(Finding(kind, explained, values=values, size=abs(found - declared) / std))


def unexplained_shares(problem: Problem, solution: Solution) -> np.ndarray:
    """Compute the share of each channel's current or torque that the model leaves unexplained, rms, (c,)."""
    return np.asarray(solution.sigma / problem.balance(solution.theta))


def moving_share(problem: Problem, solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Compute the share of motion in the mean square of each channel's rate of change, and its standard error, (c,).

    The rest is noise n, of which ``n n''`` takes away on average what ``n'^2`` adds (parts integrated). The error is
    that of a ratio, from its scatter over the units.
    """
    v, rate, change = np.moveaxis(problem.blocks[..., SIGNALS], -1, 0)  # (U, c, p) each
    e = v - modelled(problem.blocks, solution.theta) / solution.gains[:, None]
    whole = np.einsum("ujp,ujp->uj", rate, rate)
    of_motion = whole + np.einsum("ujp,ujp->uj", e, change)
    total = np.maximum(whole.sum(axis=0), 1e-300)
    share = of_motion.sum(axis=0) / total
    return share, np.linalg.norm(of_motion - share * whole, axis=0) / total


def delay_verdicts(problem: Problem, solution: Solution, std: np.ndarray, period: float) -> tuple[Verdict, ...]:
    """Judge the delay of every channel: of the joints' currents, and of torque sensors.

    A delay is read off the current's rate of change. Where a joint moves slowly, that is mostly noise, which looks the
    same at any delay. What the expansion ``v - d v' + d^2/2 v''`` makes of the noise then places the minimum, and gives
    it a curvature of its own: the standard deviation means nothing.

    Parameters
    ----------
    problem, solution : Problem, Solution
        What was solved.
    std : ndarray
        Standard deviations of the delays (c,), s.
    period : float
        Of the samples, s; a delay within one is believed whatever its relative standard deviation.
    """
    found = []
    for share, error, delay, deviation in zip(*moving_share(problem, solution), solution.delays, std, strict=True):
        if share <= DELAY_MOTION * error:
            found.append(verdict_of(Finding(F.DELAY_NOISE)))
        elif abs(delay) > period and deviation > DELAY_STD * abs(delay):
            found.append(verdict_of(Finding(F.DELAY_UNCERTAIN, values={"std": float(deviation)})))
        else:
            found.append(GOOD)
    return tuple(found)


@dataclass(frozen=True)
class LegDifference:
    """Differences between a leg's identified parameters and the mean of the legs of the same geometry.

    Attributes
    ----------
    leg : tuple of str
        Names of its joints.
    compared : tuple of str
        Names of its parameters that have counterparts of the same regrouping in all these legs.
    deviations : ndarray
        (compared,): differences from the mean of the others, in their standard deviations.
    relative : ndarray
        (compared,): the same differences in per cent of the mean of the others.
    probability : float
        That legs which are alike differ by as much or more, all differences together (Mahalanobis).
    """

    leg: tuple[str, ...]
    compared: tuple[Parameter, ...]
    deviations: np.ndarray
    relative: np.ndarray
    probability: float


def leg_differences(
    robot: Robot,
    base: BaseParameters,
    names: Sequence[Parameter],
    parameters: np.ndarray,
    covariance: np.ndarray,
) -> list[LegDifference]:
    """Compare every leg's identified parameters with those of the legs of the same geometry.

    Parameters
    ----------
    robot : Robot
    base : BaseParameters
        Of the robot: only parameters that regroup the same standard ones, leg by leg, are compared.
    names : sequence of Parameter
        Base parameters that were identified, all or the essential ones.
    parameters : ndarray
        Their values, (len(names),).
    covariance : ndarray
        (len(names), len(names)).

    Returns
    -------
    list of LegDifference
        One for each leg that has like ones (of two like legs only the first), in the order of the robot; empty for a
        robot without like legs.
    """
    from scipy.stats import chi2

    found = []
    for group in identical_legs(robot):
        if len(group) < 2:
            continue
        tables = [_by_meaning(leg, base, names) for leg in group]
        shared = [meaning for meaning in tables[0] if all(meaning in table for table in tables)]
        if not shared:
            continue
        for k in range(len(group) if len(group) > 2 else 1):
            contrast = np.zeros((len(shared), len(names)))
            for row, meaning in enumerate(shared):
                for j, table in enumerate(tables):
                    contrast[row, table[meaning]] = 1.0 if j == k else -1.0 / (len(group) - 1)
            difference, spread = contrast @ parameters, contrast @ covariance @ contrast.T
            others = np.minimum(contrast, 0.0) @ parameters
            std = np.sqrt(np.diag(spread))
            deviations = difference / std
            correlation = spread / np.outer(std, std)
            square = float(deviations @ np.linalg.pinv(correlation, rcond=1e-10, hermitian=True) @ deviations)
            rank = int(np.linalg.matrix_rank(correlation, tol=1e-10, hermitian=True))
            found.append(
                LegDifference(
                    group[k],
                    tuple(names[tables[k][meaning]] for meaning in shared),
                    deviations,
                    100 * np.abs(np.divide(difference, others, out=np.full(len(shared), np.inf), where=others != 0)),
                    float(chi2.sf(square, rank)),
                )
            )
    return found


def _by_meaning(leg: tuple[str, ...], base: BaseParameters, names: Sequence[Parameter]) -> dict[str, int]:
    """Locate a leg's parameters in ``names`` by what they regroup, joints counted from the leg's first."""
    found = {}
    for position, name in enumerate(names):
        words = base.regroupings[name].split()
        if name.body in leg:
            found[" ".join(_in_leg(word, leg) for word in words)] = position
    return found


def _in_leg(word: str, leg: tuple[str, ...]) -> str:
    term = parameter_of(word)
    return f"{term.kind}_[{leg.index(term.body)}]" if term.body in leg else re.sub(r"^(\d+\.\d{3})\d*$", r"\1", word)


def unlike_legs(dataset: Dataset, system: System, theta: np.ndarray, covariance: np.ndarray) -> list[Finding]:
    """Test whether legs of the same geometry have different parameters (the paper's check after section 3.1).

    Their frictions always differ, and the table shows them.
    """
    place = {name: k for k, name in enumerate(system.problem.parameters)}
    names = [name for name in dataset.base.names if name in place]
    index = [place[name] for name in names]
    if not np.diag(covariance)[index].all():
        return []
    found = leg_differences(dataset.robot, dataset.base, names, theta[index], covariance[np.ix_(index, index)])
    differences = [
        (float(relative), name, each)
        for each in found
        if each.probability < LEG_PROBABILITY
        for name, relative, deviation in zip(each.compared, each.relative, each.deviations, strict=True)
        if name.kind not in PLAIN_FRICTION and relative > LEG_DIFFERENCE and abs(deviation) > LEG_DIFFERENCE_STD
    ]
    if not differences:
        return []
    relative, name, each = max(differences, key=lambda difference: difference[0])
    return [Finding(F.UNLIKE_LEGS, subject=each.leg[0], values={"parameter": name, "share": relative / 100})]
