"""What a solution means: estimates with names, units, deviations and verdicts."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gtau.estimation.diagnostics.delays import delay_verdicts
from gtau.estimation.diagnostics.misspecification import Misspecification, find_misspecification
from gtau.estimation.diagnostics.position_ripple import PositionRipple
from gtau.estimation.diagnostics.prior_checks import against_limits, against_payloads, against_priors, shared
from gtau.estimation.diagnostics.saturation import find_saturation, saturated
from gtau.estimation.diagnostics.swapped_channels import against_swapped
from gtau.estimation.diagnostics.verdict import (
    GIVEN,
    GOOD,
    LACKING,
    Outcome,
    Verdict,
    gain_verdicts,
    lack_of_fit,
    parameter_verdict,
)
from gtau.estimation.estimators.solution import Solution
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.friction import UNITS
from gtau.estimation.regression.legs import leg_differences
from gtau.estimation.regression.problem import Problem
from gtau.estimation.regression.system import System, known_values
from gtau.estimation.results.estimate import Consistency, Estimate, PayloadEstimate, TorqueError, torque_unit, unit_of
from gtau.estimation.results.result import Result
from gtau.estimation.results.singularity_distances import distances_of, nearest_poses
from gtau.progress import Progress, silent
from gtau.robots.robot import INERTIAL, Robot

UNLIKE = 1e-3  # probability that legs which are alike differ by as much
MUCH, CERTAIN = 20.0, 5.0  # per cent and standard deviations from which on a difference of legs is worth a note
FRICTION = ("fv", "fs", "off")


def make_result(
    dataset: Dataset,
    system: System,
    method: str,
    solution: Solution,
    covariance: np.ndarray,
    essential: Mapping[str, tuple[float, float]],
    known: Mapping[str, Verdict],
    prior_gains: Mapping[str, float],
    freedom: np.ndarray | None,
    locked: PositionRipple | None,
    consistency: Consistency | None = None,
    progress: Progress = silent,
) -> Result:
    """Name what a solution found.

    Parameters
    ----------
    dataset, assembly, method : Dataset, Assembly, str
        What was identified, and by which estimator.
    solution, covariance : Solution, ndarray
        Estimates with all base parameters, and the covariance of (theta, gains, delays).
    essential : mapping
        Essential parameters: name to value and standard deviation.
    known : mapping
        Verdicts on known payloads, by name.
    prior_gains : mapping
        Gains expected, N m/A or N/A, by joint; may be empty.
    freedom : ndarray, optional
        Degrees of freedom behind the deviations of (theta, gains, delays); None for very many.
    locked : PositionRipple, optional
        What of the errors repeats at the same positions, where that was looked for.
    consistency : Consistency, optional
        Standard parameters that rigid bodies can have.
    progress : callable, optional
        Told of the stage, what is done of it, and all there is to do, while looking for what explains the errors.
    """
    robot, problem, joints, base = dataset.robot, system.problem, dataset.model.actuated, dataset.base
    n_theta, n = problem.n_theta, len(joints)
    std = np.sqrt(np.diag(covariance))
    gain_std, delay_std = std[n_theta : n_theta + n], std[n_theta + n :]
    units = [torque_unit(robot, joint) for joint in joints]
    of_current = dataset.runs[0].kind == "current"
    names = tuple(run.name for run in dataset.runs)
    along = [
        (prepared, dataset.preparation.decimator, factors.distances)
        for prepared, factors in zip(dataset.prepared, dataset.factors, strict=True)
        if factors.distances is not None
    ]
    verdicts = (GIVEN,) * n
    torques = np.abs(solution.gains) * problem.signal
    if gain_std.any():
        repeating = locked is not None and locked.found
        verdicts = gain_verdicts(problem, solution, gain_std, system.block_positions, names, repeating)
        if any(each != GOOD for each in verdicts) or lack_of_fit(problem, solution) > LACKING:
            verdicts = accused(
                against_swapped(verdicts, dataset), find_misspecification(dataset, system, solution, progress)
            )
            verdicts = saturated(verdicts, find_saturation(dataset, system, solution))
        verdicts = against_priors(against_payloads(verdicts, known), robot, solution.gains, prior_gains)
    elif lack_of_fit(problem, solution) > LACKING:
        verdicts = against_swapped(verdicts, dataset)
    verdicts = shared(against_limits(verdicts, robot, torques), joints)
    delay_outcomes = delay_verdicts(problem, solution) if delay_std.any() else (GOOD,) * n
    found, free = _named(problem, solution.theta, std), _freedoms(problem, freedom)
    spread = _spread(system, solution.theta)

    def parameter(k: int, values: Mapping[str, tuple[float, float]]) -> Estimate:
        name, (kind, body) = base.names[k], base.standard[k].split("_", 1)
        value, deviation = values.get(name, (None, None))
        unit, verdict = unit_of(kind, robot, body), parameter_verdict(value, deviation)
        return Estimate(name, value, deviation, unit, base.regroupings[name], spread.get(name), verdict, free.get(name))

    return Result(
        robot=robot,
        method=method,
        kind=dataset.runs[0].kind,
        drive_gains={
            joint: Estimate(
                joint,
                float(solution.gains[k]),
                float(gain_std[k]) if gain_std.any() else None,
                f"{units[k]}/A" if of_current else "1",
                verdict=verdicts[k],
                freedom=None if freedom is None else float(freedom[n_theta + k]),
            )
            for k, joint in enumerate(joints)
        },
        delays={
            joint: Estimate(
                joint,
                float(solution.delays[k]),
                float(delay_std[k]) or None if delay_outcomes[k] == GOOD else None,
                "s",
                verdict=delay_outcomes[k],
                freedom=None if freedom is None else float(freedom[n_theta + n + k]),
            )
            for k, joint in enumerate(joints)
        },
        parameters={name: parameter(k, found) for k, name in enumerate(base.names)},
        essential={name: parameter(k, essential) for k, name in enumerate(base.names) if name in essential},
        friction={
            name: Estimate(name, *found[name], unit, verdict=parameter_verdict(*found[name]), freedom=free.get(name))
            for name, unit in _terms(system, robot)
            if name in found
        },
        payloads=payload_estimates(dataset, system, solution.theta, covariance, known, freedom),
        residuals=tuple(
            TorqueError(joint, float(abs(solution.gains[k]) * solution.sigma[k]), float(torques[k]), units[k])
            for k, joint in enumerate(joints)
        ),
        covariance_names=(*problem.parameters, *(f"gain_{j}" for j in joints), *(f"delay_{j}" for j in joints)),
        covariance=covariance,
        preparation=dataset.preparation,
        statistics={
            **solution.statistics,
            "lack_of_fit": lack_of_fit(problem, solution),
        },
        runs=names,
        notes=(
            *dataset.notes,
            *_unlike_legs(dataset, system, solution.theta, covariance),
            *(_locked(locked, joints, solution) if locked is not None else ()),
        ),
        consistency=consistency,
        singularities=tuple(nearest for run in along for nearest in nearest_poses(*run)),
        distances=tuple(distances_of(*run) for run in along),
    )


def accused(verdicts: tuple[Verdict, ...], found: Misspecification | None) -> tuple[Verdict, ...]:
    """Verdicts on the gains where something in the robot's description is suspected, if nothing worse was found."""
    if found is None:
        return verdicts
    return tuple(
        each if each.outcome == Outcome.CONTRADICTORY else Verdict(Outcome.CONTRADICTORY, found.why, found.advice)
        for each in verdicts
    )


def payload_estimates(
    dataset: Dataset,
    system: System,
    theta: np.ndarray,
    covariance: np.ndarray,
    masses: Mapping[str, Verdict],
    freedom: np.ndarray | None,
) -> tuple[PayloadEstimate, ...]:
    """The payload of every loaded run, known and unknown parameters together.

    ``theta`` are the problem's parameters, the first that ``covariance`` is of; ``masses`` are verdicts on
    known payloads, by name; ``freedom`` as in :func:`make_result`.
    """
    robot = dataset.robot
    found = _named(system.problem, theta, np.sqrt(np.diag(covariance)))
    free = _freedoms(system.problem, freedom)
    payloads = []
    for each in system.payloads:
        known = known_values(each.payload)
        label = {kind: name for name, kind in each.unknown.items()}
        estimates = {}
        for kind in INERTIAL:
            unit = unit_of(kind, robot, robot.tool)
            if kind in known:
                deviation = each.payload.mass_std or None if kind == "m" else None
                estimates[kind] = Estimate(kind, known[kind], deviation, unit, kind)
            elif kind in each.regroupings:
                value, deviation = found.get(label[kind], (None, None))
                verdict = parameter_verdict(value, deviation)
                estimates[kind] = Estimate(
                    kind, value, deviation, unit, each.regroupings[kind], verdict=verdict, freedom=free.get(label[kind])
                )
        name, run = each.payload.name, dataset.runs[each.run].name
        payloads.append(PayloadEstimate(name, run, estimates, frozenset(known), masses.get(name, GOOD)))
    return tuple(payloads)


def _named(problem: Problem, theta: np.ndarray, std: np.ndarray) -> dict[str, tuple[float, float]]:
    return {name: (float(theta[k]), float(std[k])) for k, name in enumerate(problem.parameters)}


def _freedoms(problem: Problem, freedom: np.ndarray | None) -> dict[str, float]:
    return {} if freedom is None else dict(zip(problem.parameters, map(float, freedom), strict=False))


def _terms(system: System, robot: Robot) -> list[tuple[str, str]]:
    """Further friction terms and their units."""
    split = [(name, *name.split("_", 1)) for name in system.friction.terms]
    return [(name, UNITS[robot.joint(joint).kind][term]) for name, term, joint in split]


def _unlike_legs(dataset: Dataset, system: System, theta: np.ndarray, covariance: np.ndarray) -> list[str]:
    """Whether legs of the same geometry differ in what they are built of (the paper's check after section 3.1).

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
        if each.probability < UNLIKE
        for name, relative, deviation in zip(each.compared, each.relative, each.deviations, strict=True)
        if name.split("_")[0] not in FRICTION and relative > MUCH and abs(deviation) > CERTAIN
    ]
    if not differences:
        return []
    relative, name, each = max(differences, key=lambda difference: difference[0])
    size = f"{relative:.0f} %" if relative < 1000 else "more than ten times"
    return [
        f"legs of the same geometry differ, most in {name} of leg '{each.leg[0]}' ({size} off the mean of "
        "the others): check that they are built alike"
    ]


def _locked(found: PositionRipple, joints: tuple[str, ...], solution: Solution) -> list[str]:
    """What repeats at the same positions, and what that does to the gains."""
    if not found.found:
        return []
    j = int(np.argmax(found.shares))
    moves = 100 * np.abs(found.moves[-2 * len(joints) : -len(joints)] / solution.gains)
    k = int(np.argmax(moves))
    of_gains = f" (that of the gain of joint '{joints[k]}' {moves[k]:.2g} %)" if moves[k] else ""
    return [
        f"errors repeat at the same positions ({100 * found.shares[j]:.0f} % of the variance at joint '{joints[j]}'): "
        "ripple of the motors, cables or springs, which the model lacks. They do the same in all runs, so no scatter "
        f"shows it; the deviations contain by how much the estimates move when they are modelled{of_gains}"
    ]


def _spread(system: System, theta: np.ndarray) -> dict[str, float]:
    """Standard deviation between runs of each friction parameter that may drift."""
    deviations: dict[str, list[float]] = {}
    for name, value in zip(system.problem.parameters, theta, strict=True):
        if "@" in name:
            deviations.setdefault(name.split("@")[0], []).append(float(value))
    # the deviations of all runs add up to zero, and the last is not listed
    return {name: float(np.std([*each, -sum(each)], ddof=1)) for name, each in deviations.items()}
