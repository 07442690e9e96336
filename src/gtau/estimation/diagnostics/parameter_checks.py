"""Checks of parameters, delays and legs, and the share of a current that the model leaves unexplained."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from gtau.estimation.diagnostics.verdict import GOOD, Outcome, Verdict, judge_parameter, verdict_of
from gtau.estimation.estimators.estimator import Fit, Solution
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.equations import SIGNALS, modelled
from gtau.estimation.regression.problem import Problem
from gtau.estimation.regression.unknowns import Estimates
from gtau.estimation.thresholds.estimates import LEG_DIFFERENCE, LEG_DIFFERENCE_STD, LEG_PROBABILITY
from gtau.estimation.thresholds.logs import DELAY_MOTION, DELAY_STD
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.model.base_parameters import regrouped
from gtau.robots.geometry import identical_legs
from gtau.robots.parameter import Parameter, unit_of
from gtau.robots.robot import PLAIN_FRICTION, Robot


def unexplained_shares(problem: Problem, solution: Solution) -> np.ndarray:
    """Compute the share of each channel's current or torque that the model leaves unexplained, rms, (c,)."""
    return np.asarray(solution.sigma / problem.balance(solution.theta))


def motors(fit: Fit) -> tuple[str, ...]:
    """List the joints whose gains are judged: all but those of a floating base."""
    return tuple(channel.joint for channel in fit.system.problem.channels if channel.kind.unknown_gain)


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


def delay_verdicts(problem: Problem, solution: Solution, std: np.ndarray, period: float) -> tuple[Verdict, ...]:
    """Judge the delay of every channel: of the joints' currents, and of torque sensors.

    A delay is read off the current's rate of change. Where a joint moves slowly, that is mostly noise, which looks the
    same at any delay. What the expansion ``v - d v' + d^2/2 v''`` makes of the noise then places the minimum, and gives
    it a curvature of its own: the standard deviation ``std`` (c,), s, means nothing. A delay within the ``period`` of
    the samples, s, is believed whatever its relative standard deviation.
    """
    verdicts = []
    for share, error, delay, deviation in zip(*moving_share(problem, solution), solution.delays, std, strict=True):
        if share <= DELAY_MOTION * error:
            verdicts.append(verdict_of(Finding(F.DELAY_NOISE)))
        elif abs(delay) > period and deviation > DELAY_STD * abs(delay):
            verdicts.append(verdict_of(Finding(F.DELAY_UNCERTAIN, values={"std": float(deviation)})))
        else:
            verdicts.append(GOOD)
    return tuple(verdicts)


def moving_share(problem: Problem, solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Compute the share of motion in the mean square of each channel's rate of change, and its standard error, (c,).

    The rest is noise n, of which ``n n''`` takes away on average what ``n'^2`` adds (parts integrated). The error is
    that of a ratio, from its scatter over the units.
    """
    v, rate, change = np.moveaxis(problem.blocks[..., SIGNALS], -1, 0)  # (U, c, p) each
    e = v - modelled(problem.blocks, solution.theta) / solution.gains[:, None]
    squares = np.einsum("ujp,ujp->uj", rate, rate)
    of_motion = squares + np.einsum("ujp,ujp->uj", e, change)
    total = np.maximum(squares.sum(axis=0), 1e-300)
    share = of_motion.sum(axis=0) / total
    return share, np.linalg.norm(of_motion - share * squares, axis=0) / total


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
