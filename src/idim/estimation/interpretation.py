"""What a solution means: estimates with names, units and deviations, and what is not to be trusted."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from idim.estimation.assembly import Assembly, known_values
from idim.estimation.data import Data
from idim.estimation.friction import UNITS
from idim.estimation.problem import Problem
from idim.estimation.result import Estimate, PayloadEstimate, Result, TorqueError, torque_unit, unit_of
from idim.estimation.solution import Solution
from idim.robots.robot import INERTIAL, Robot


def make_result(
    data: Data,
    assembly: Assembly,
    method: str,
    solution: Solution,
    covariance: np.ndarray,
    kept: Problem,
    reduced: Solution,
) -> Result:
    """Name what a solution found, with units, standard deviations and warnings.

    ``covariance`` is that of (theta, gains, delays); ``reduced`` solves ``kept``, the problem with the
    essential parameters only.
    """
    robot, problem, joints = data.robot, assembly.problem, data.model.actuated
    n_theta, n = problem.n_theta, len(joints)
    std = np.sqrt(np.diag(covariance))
    finds_gains = bool(std[n_theta : n_theta + n].any())
    found = {name: (solution.theta[k], std[k]) for k, name in enumerate(problem.parameters)}
    reduced_std = np.sqrt(np.diag(reduced.jackknife))
    essential_found = {name: (reduced.theta[k], reduced_std[k]) for k, name in enumerate(kept.parameters)}
    current = data.runs[0].kind == "current"

    def estimate(name: str, column: str, regrouping: str, values: Mapping[str, tuple[float, float]]) -> Estimate:
        kind, body = column.split("_", 1)
        value, deviation = values.get(name, (None, None))
        return Estimate(
            name, _number(value), _number(deviation), unit_of(kind, robot, body), regrouping, spread.get(name)
        )

    spread = _spread(assembly, solution.theta)

    base = data.base
    described = list(zip(base.names, base.standard, (base.regroupings[name] for name in base.names), strict=True))
    unit = {joint: torque_unit(robot, joint) for joint in joints}
    signal = [
        np.linalg.norm(R[:, n_theta + 1]) / np.sqrt(rows)
        for R, rows in zip(problem.triangles, problem.total_rows, strict=True)
    ]
    gains = {
        joint: Estimate(
            joint,
            float(solution.gains[k]),
            float(std[n_theta + k]) if finds_gains else None,
            f"{unit[joint]}/A" if current else "1",
        )
        for k, joint in enumerate(joints)
    }
    return Result(
        robot=robot,
        method=method,
        kind=data.runs[0].kind,
        drive_gains=gains,
        delays={
            joint: Estimate(joint, float(solution.delays[k]), float(std[n_theta + n + k]), "s")
            for k, joint in enumerate(joints)
        },
        parameters={name: estimate(name, column, text, found) for name, column, text in described},
        essential={
            name: estimate(name, column, text, essential_found)
            for name, column, text in described
            if name in kept.parameters
        },
        friction={
            name: Estimate(name, *map(float, found[name]), term_unit(robot, name))
            for name in assembly.friction.terms
            if name in found
        },
        payloads=payload_estimates(data, assembly, solution.theta, covariance),
        residuals=tuple(
            TorqueError(joint, float(abs(g) * s), float(abs(g) * v), unit[joint])
            for joint, g, s, v in zip(joints, solution.gains, solution.sigma, signal, strict=True)
        ),
        covariance_names=(*problem.parameters, *(f"gain_{j}" for j in joints), *(f"delay_{j}" for j in joints)),
        covariance=covariance,
        preparation=data.preparation,
        statistics={**solution.statistics, "largest_condition": max(each.condition for each in data.factors)},
        runs=tuple(run.name for run in data.runs),
        notes=(*data.notes, *_warnings(assembly, solution, std[n_theta : n_theta + n])),
    )


def term_unit(robot: Robot, name: str) -> str:
    """Unit of a friction term such as ``f3_11``."""
    term, joint = name.split("_", 1)
    return UNITS[robot.joint(joint).kind][term]


def _spread(assembly: Assembly, theta: np.ndarray) -> dict[str, float]:
    """Standard deviation between runs of each friction parameter that may drift."""
    values = dict(zip(assembly.problem.parameters, theta, strict=True))
    deviations: dict[str, list[float]] = {}
    for name, value in values.items():
        if "@" in name:
            deviations.setdefault(name.split("@")[0], []).append(float(value))
    # the deviations of all runs add up to zero, and the last is not listed
    return {name: float(np.std([*each, -sum(each)], ddof=1)) for name, each in deviations.items()}


def payload_estimates(
    data: Data, assembly: Assembly, theta: np.ndarray, covariance: np.ndarray
) -> tuple[PayloadEstimate, ...]:
    """The payload of every loaded run, known and unknown parameters together.

    ``theta`` are the problem's parameters, the first that ``covariance`` is of.
    """
    robot = data.robot
    std = np.sqrt(np.diag(covariance))
    found = {name: (theta[k], std[k]) for k, name in enumerate(assembly.problem.parameters)}
    payloads = []
    for each in assembly.payloads:
        known = known_values(each.payload)
        estimates = {}
        for kind in INERTIAL:
            unit = unit_of(kind, robot, robot.tool)
            if kind in known:
                deviation = each.payload.mass_std or None if kind == "m" else None
                estimates[kind] = Estimate(kind, known[kind], deviation, unit, kind)
            elif kind in each.regroupings:
                name = next(name for name, of in each.unknown.items() if of == kind)
                value, deviation = found.get(name, (None, None))
                estimates[kind] = Estimate(kind, _number(value), _number(deviation), unit, each.regroupings[kind])
        payloads.append(PayloadEstimate(each.payload.name, data.runs[each.run].name, estimates, frozenset(known)))
    return tuple(payloads)


def _number(value: float | None) -> float | None:
    return None if value is None else float(value)


def _warnings(assembly: Assembly, solution: Solution, gain_std: np.ndarray) -> list[str]:
    notes = []
    if assembly.unexcited:
        notes.append(
            f"these motions cannot tell {', '.join(assembly.unexcited)} from the parameters listed before them: "
            "no value is given; "
            "add runs that move all joints in other ways"
        )
    ratio = solution.statistics.get("singular_ratio")
    if ratio is not None and ratio < 3:
        notes.append(
            "this result is not to be trusted: the two smallest singular values of W_tot differ by a factor of "
            f"only {ratio:.2f} (3 is "
            "needed), so the noise decides which of two directions is the solution; use --method ml"
        )
    if not gain_std.any():
        return notes
    if np.all(solution.gains < 0):
        notes.append(
            "all drive gains are negative: the sign of all currents or of all positions, or of gravity, is "
            "likely to be wrong"
        )
    for joint, gain, std in zip(assembly.problem.joints, solution.gains, gain_std, strict=True):
        if std > 0.03 * abs(gain):
            notes.append(
                f"the drive gain of joint '{joint}' is weak (standard deviation {100 * std / abs(gain):.1f} %): "
                "use a heavier payload, or "
                "motions in which this joint lifts or accelerates it more"
            )
    return notes
