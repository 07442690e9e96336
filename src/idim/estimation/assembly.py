"""From the factors of all runs to the estimation problem: payloads and what the motions can tell (eqs. 29 to 33)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from idim.errors import IdimError
from idim.estimation.base_parameters import BaseParameters, independent_columns
from idim.estimation.factors import CURRENTS, Factors
from idim.estimation.problem import Problem
from idim.model.inverse_dynamics import InverseDynamics
from idim.robots.robot import INERTIAL
from idim.signals.experiment import Payload


@dataclass(frozen=True)
class CarriedPayload:
    """The payload of one run.

    ``unknown`` maps the name in the problem of each unknown parameter that acts on some actuated joint
    to its kind, and ``regroupings`` the kind to the formula of what it stands for.
    """

    run: int
    payload: Payload
    unknown: Mapping[str, str]
    regroupings: Mapping[str, str]


@dataclass(frozen=True)
class Assembly:
    """The problem, and what its parameters are.

    ``unexcited`` are base parameters that these motions cannot tell from those before them; they are
    not part of the problem.
    """

    problem: Problem
    base: BaseParameters
    payloads: tuple[CarriedPayload, ...]
    unexcited: tuple[str, ...]


def known_values(payload: Payload) -> dict[str, float]:
    """Known inertial parameters of a payload, by kind; empty for an unknown payload."""
    mass = {} if payload.mass is None else {"m": payload.mass}
    return {**mass, **payload.parameters}


def assemble(
    idm: InverseDynamics,
    base: BaseParameters,
    factors: Sequence[Factors],
    payloads: Sequence[Payload | None],
    bandwidth: float,
) -> Assembly:
    """Join the runs' factors into one problem.

    A payload is a further body on the robot's last link or platform (eq. 18), so its columns are
    combinations of the base columns, and each run's factor becomes a block of the problem by one
    product with a small matrix.

    Parameters
    ----------
    idm, base : InverseDynamics, BaseParameters
        Model and base parameters, whose columns the factors have.
    factors, payloads : sequences
        One entry a run; None for a run without payload.
    bandwidth : float
        Of the motion, Hz: bounds the delays that can be described.

    Raises
    ------
    IdimError
        Where some joint has no usable row in any run.
    """
    tool, n_b = idm.robot.tool, base.count
    position = {name: k for k, name in enumerate(idm.parameter_names)}
    carried: list[CarriedPayload] = []
    maps: list[tuple[np.ndarray, np.ndarray]] = []  # of each run: unknown payload columns and the known column
    for run, payload in enumerate(payloads):
        unknown, known = np.zeros((n_b, 0)), np.zeros(n_b)
        if payload is not None:
            values = known_values(payload)
            free = [kind for kind in INERTIAL if kind not in values]
            columns = base.matrix[:, [position[f"{kind}_{tool}"] for kind in free]]
            kept, coefficients, _ = independent_columns(columns)
            unknown = columns[:, kept]
            known = base.matrix[:, [position[f"{kind}_{tool}"] for kind in values]] @ np.array(list(values.values()))
            formulas = {
                free[k]: " + ".join(
                    f"{coefficients[row, other]:.5g} {kind}" if other != k else kind
                    for other, kind in enumerate(free)
                    if coefficients[row, other]
                )
                for row, k in enumerate(kept)
            }
            labels = {f"{free[k]}_L{run + 1}": free[k] for k in kept}
            carried.append(CarriedPayload(run, payload, labels, formulas))
        maps.append((unknown, known))
    n_theta = n_b + sum(unknown.shape[1] for unknown, _ in maps)
    begin = n_b
    units = []
    for factor, (unknown, known) in zip(factors, maps, strict=True):
        M = np.zeros((n_b + CURRENTS, n_theta + 1 + CURRENTS))
        M[:n_b, :n_b] = np.eye(n_b)
        M[:n_b, begin : begin + unknown.shape[1]] = unknown
        begin += unknown.shape[1]
        M[:n_b, n_theta] = known
        M[n_b:, n_theta + 1 :] = np.eye(CURRENTS)
        units.append(factor.R @ M)
    names = [*base.names, *(name for each in carried for name in each.unknown)]
    problem = Problem(
        tuple(names),
        idm.actuated,
        np.concatenate(units),
        np.concatenate([factor.rows for factor in factors]),
        slowest=0.5 / (2 * np.pi * bandwidth),
    )
    for joint, rows in zip(idm.actuated, problem.total_rows, strict=True):
        if rows < 50:
            raise IdimError(
                f"joint '{joint}' has {rows} usable rows in all runs together, away from its reversals and gaps; "
                "add runs in which it moves, or longer ones."
            )
    filled = problem.rows.sum(axis=1) > 0
    problem = Problem(problem.parameters, problem.joints, problem.units[filled], problem.rows[filled], problem.slowest)
    unexcited = _unexcited(problem)
    return Assembly(problem.without(unexcited), base, tuple(carried), unexcited)


def _unexcited(problem: Problem) -> tuple[str, ...]:
    stacked = np.concatenate(
        [R[:, : problem.n_theta] / sigma for R, sigma in zip(problem.triangles, problem.own_sigma, strict=True)]
    )
    kept, _, _ = independent_columns(stacked)
    return tuple(name for k, name in enumerate(problem.parameters) if k not in kept)


def require_scale(assembly: Assembly, payloads: Sequence[Payload | None], method: str) -> None:
    """Check that the runs can fix the scale of the drive gains (section 3.3).

    Raises
    ------
    IdimError
        Without a run with a known payload, without a second load, or where the known parameters of the
        payloads act on no joint in a way of their own.
    """
    other = "or use --method wls with prior_gains"
    if not any(payload is not None and payload.mass is not None for payload in payloads):
        raise IdimError(
            f"method '{method}' needs a run with a payload of known mass to find the drive gains, and no run has one; "
            f"add 'payload: {{name: ..., mass: ...}}' to a loaded run, {other}."
        )
    if len({None if payload is None else payload.name for payload in payloads}) < 2:
        raise IdimError(
            f"method '{method}' needs runs with two different loads to find the drive gains, and all runs carry "
            "the same payload; "
            f"add a run without payload, {other}."
        )
    problem = assembly.problem
    stacked = np.concatenate(
        [R[:, : problem.n_theta + 1] / sigma for R, sigma in zip(problem.triangles, problem.own_sigma, strict=True)]
    )
    if problem.n_theta not in independent_columns(stacked)[0]:
        raise IdimError(
            "the payload's known parameters have no effect of their own on any actuated joint, so they cannot "
            "give the scale of the "
            f"drive gains; give more known 'parameters' of the payload, {other}."
        )
