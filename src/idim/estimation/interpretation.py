"""What a solution means: estimates with names, units, deviations and verdicts."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from idim.estimation.assembly import Assembly, known_values
from idim.estimation.data import Data
from idim.estimation.estimates import Consistency, Estimate, PayloadEstimate, TorqueError, torque_unit, unit_of
from idim.estimation.friction import UNITS
from idim.estimation.problem import Problem
from idim.estimation.result import Result
from idim.estimation.solution import Solution
from idim.estimation.symmetry import leg_differences
from idim.estimation.verdicts import GOOD, Verdict, gain_verdicts, lack_of_fit, parameter_verdict
from idim.robots.robot import INERTIAL, Robot

UNLIKE = 1e-3  # probability that legs which are alike differ by as much


def make_result(
    data: Data,
    assembly: Assembly,
    method: str,
    solution: Solution,
    covariance: np.ndarray,
    essential: Mapping[str, tuple[float, float]],
    masses: Mapping[str, Verdict],
    freedom: int | None,
    consistency: Consistency | None = None,
) -> Result:
    """Name what a solution found.

    Parameters
    ----------
    data, assembly, method : Data, Assembly, str
        What was identified, and by which estimator.
    solution, covariance : Solution, ndarray
        Estimates with all base parameters, and the covariance of (theta, gains, delays).
    essential : mapping
        Essential parameters: name to value and standard deviation.
    masses : mapping
        Verdicts on known payloads, by name.
    freedom : int, optional
        Degrees of freedom behind ``covariance``; None for very many.
    consistency : Consistency, optional
        Standard parameters that rigid bodies can have.
    """
    robot, problem, joints, base = data.robot, assembly.problem, data.model.actuated, data.base
    n_theta, n = problem.n_theta, len(joints)
    std = np.sqrt(np.diag(covariance))
    gain_std, delay_std = std[n_theta : n_theta + n], std[n_theta + n :]
    units = [torque_unit(robot, joint) for joint in joints]
    of_current = data.runs[0].kind == "current"
    names = tuple(run.name for run in data.runs)
    verdicts = (GOOD,) * n
    if gain_std.any():
        verdicts = gain_verdicts(problem, solution, gain_std, assembly.places, names)
    found = _named(problem, solution.theta, std)
    spread = _spread(assembly, solution.theta)

    def parameter(k: int, values: Mapping[str, tuple[float, float]]) -> Estimate:
        name, (kind, body) = base.names[k], base.standard[k].split("_", 1)
        value, deviation = values.get(name, (None, None))
        unit, verdict = unit_of(kind, robot, body), parameter_verdict(value, deviation)
        return Estimate(name, value, deviation, unit, base.regroupings[name], spread.get(name), verdict, freedom)

    signal = [
        float(np.linalg.norm(R[:, n_theta + 1]) / np.sqrt(rows))
        for R, rows in zip(problem.triangles, problem.total_rows, strict=True)
    ]
    return Result(
        robot=robot,
        method=method,
        kind=data.runs[0].kind,
        drive_gains={
            joint: Estimate(
                joint,
                float(solution.gains[k]),
                float(gain_std[k]) if gain_std.any() else None,
                f"{units[k]}/A" if of_current else "1",
                verdict=verdicts[k],
                freedom=freedom,
            )
            for k, joint in enumerate(joints)
        },
        delays={
            joint: Estimate(joint, float(solution.delays[k]), float(delay_std[k]) or None, "s", freedom=freedom)
            for k, joint in enumerate(joints)
        },
        parameters={name: parameter(k, found) for k, name in enumerate(base.names)},
        essential={name: parameter(k, essential) for k, name in enumerate(base.names) if name in essential},
        friction={
            name: Estimate(name, *found[name], unit, verdict=parameter_verdict(*found[name]), freedom=freedom)
            for name, unit in _terms(assembly, robot)
            if name in found
        },
        payloads=payload_estimates(data, assembly, solution.theta, covariance, masses, freedom),
        residuals=tuple(
            TorqueError(joint, float(abs(solution.gains[k]) * solution.sigma[k]), abs(solution.gains[k]) * v, units[k])
            for k, (joint, v) in enumerate(zip(joints, signal, strict=True))
        ),
        covariance_names=(*problem.parameters, *(f"gain_{j}" for j in joints), *(f"delay_{j}" for j in joints)),
        covariance=covariance,
        preparation=data.preparation,
        statistics={
            **solution.statistics,
            "lack_of_fit": lack_of_fit(problem, solution),
            "largest_condition": max(each.condition for each in data.factors),
        },
        runs=names,
        notes=(*data.notes, *_unlike_legs(data, assembly, solution.theta, covariance)),
        consistency=consistency,
    )


def payload_estimates(
    data: Data,
    assembly: Assembly,
    theta: np.ndarray,
    covariance: np.ndarray,
    masses: Mapping[str, Verdict],
    freedom: int | None,
) -> tuple[PayloadEstimate, ...]:
    """The payload of every loaded run, known and unknown parameters together.

    ``theta`` are the problem's parameters, the first that ``covariance`` is of; ``masses`` are verdicts on
    known payloads, by name; ``freedom`` as in :func:`make_result`.
    """
    robot = data.robot
    found = _named(assembly.problem, theta, np.sqrt(np.diag(covariance)))
    payloads = []
    for each in assembly.payloads:
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
                    kind, value, deviation, unit, each.regroupings[kind], verdict=verdict, freedom=freedom
                )
        name, run = each.payload.name, data.runs[each.run].name
        payloads.append(PayloadEstimate(name, run, estimates, frozenset(known), masses.get(name, GOOD)))
    return tuple(payloads)


def _named(problem: Problem, theta: np.ndarray, std: np.ndarray) -> dict[str, tuple[float, float]]:
    return {name: (float(theta[k]), float(std[k])) for k, name in enumerate(problem.parameters)}


def _terms(assembly: Assembly, robot: Robot) -> list[tuple[str, str]]:
    """Further friction terms and their units."""
    split = [(name, *name.split("_", 1)) for name in assembly.friction.terms]
    return [(name, UNITS[robot.joint(joint).kind][term]) for name, term, joint in split]


def _unlike_legs(data: Data, assembly: Assembly, theta: np.ndarray, covariance: np.ndarray) -> list[str]:
    """Which legs of the same geometry differ in what was identified (the paper's check after section 3.1)."""
    place = {name: k for k, name in enumerate(assembly.problem.parameters)}
    names = [name for name in data.base.names if name in place]
    index = [place[name] for name in names]
    if not np.diag(covariance)[index].all():
        return []
    found = leg_differences(data.robot, data.base, names, theta[index], covariance[np.ix_(index, index)])
    return [
        f"leg '{each.leg[0]}' is not like the {len(each.others)} of the same geometry, most in {each.worst[0]} "
        f"(by {abs(each.worst[1]):.1f} standard deviations): friction and wear differ, or the legs are not built alike"
        for each in found
        if each.probability < UNLIKE
    ]


def _spread(assembly: Assembly, theta: np.ndarray) -> dict[str, float]:
    """Standard deviation between runs of each friction parameter that may drift."""
    deviations: dict[str, list[float]] = {}
    for name, value in zip(assembly.problem.parameters, theta, strict=True):
        if "@" in name:
            deviations.setdefault(name.split("@")[0], []).append(float(value))
    # the deviations of all runs add up to zero, and the last is not listed
    return {name: float(np.std([*each, -sum(each)], ddof=1)) for name, each in deviations.items()}
