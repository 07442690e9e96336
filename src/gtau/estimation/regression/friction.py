"""Friction beyond the paper's: which terms an actuated joint needs, and how friction drifts between runs.

The paper's friction, viscous and Coulomb, is among the standard parameters of the model. Two terms are
offered on top of it to every actuated joint, and taken where its own equations ask for them:

- ``f3``: cubic in speed, ``f3 qd^3``;
- ``fl``: proportional to the torque that the joint transmits, ``fl |tau_load| sign(qd)``.

Warm-up makes friction drift between runs by per cents, which no single run shows and which ruins the
drive gains; so viscous and Coulomb friction may take a value of their own in every run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gtau.estimation.estimators.solution import Solution
from gtau.estimation.regression.problem import Problem, delayed
from gtau.estimation.regression.triangle import triangle

TERMS = ("f3", "fl")
DRIFTING = ("fv", "fs")
MATTERS = 0.02  # share of a joint's error that a term must take away
TOLD = 1 / 3  # of a term: its largest deviation
UNITS = {"revolute": {"f3": "N m s3/rad3", "fl": "1"}, "prismatic": {"f3": "N s3/m3", "fl": "1"}}


@dataclass(frozen=True)
class Friction:
    """A friction model: the terms taken (``fl_11``), and whether friction may drift between runs."""

    terms: tuple[str, ...] = ()
    per_run: bool = False


PAPER = Friction()
"""Viscous and Coulomb friction and an offset, shared by all runs."""


def term_columns(qd: np.ndarray, effort: np.ndarray) -> np.ndarray:
    """Columns of the terms, (2, n, N), from speeds and transmitted torques (n, N)."""
    return np.stack([qd * qd * qd, np.abs(effort) * np.sign(qd)])  # a power would take ten times as long


def all_terms(joints: tuple[str, ...]) -> tuple[str, ...]:
    """Every term of every joint."""
    return tuple(f"{term}_{joint}" for joint in joints for term in TERMS)


def transmitted(names: Sequence[str]) -> np.ndarray:
    """1 for the base parameters whose torque a joint transmits, 0 for friction and offsets, (n_b,)."""
    return np.array([name.split("_", 1)[0] not in ("fv", "fs", "off") for name in names], dtype=float)


def select_friction_terms(problem: Problem) -> tuple[str, ...]:
    """Terms that the Bayesian information criterion asks for, joint by joint.

    Each joint's current is fitted by its own regressor alone, with every subset of its terms in
    ``problem``; the subset of least ``r log(sigma^2) + k log(r)`` is taken. As the criterion believes in
    independent errors, and real ones are correlated, a term must also lessen the error by 2 per cent.
    """
    chosen: list[str] = []
    for j, joint in enumerate(problem.joints):
        position = {name: k for k, name in enumerate(problem.parameters)}
        offered = [f"{term}_{joint}" for term in TERMS if f"{term}_{joint}" in position]
        rest = [k for k in problem.own_columns[j] if k not in {position[name] for name in offered}]
        current = problem.triangles[j][:, problem.n_theta + 1 :] @ delayed(problem.own_delays[j])
        rows = problem.total_rows[j]

        def criterion(terms: tuple[str, ...]) -> float:
            columns = problem.triangles[j][:, [*rest, *(position[name] for name in terms)]]  # noqa: B023
            left = triangle(np.column_stack([columns, current]))[-1, -1]  # noqa: B023
            price = max(np.log(rows), -2 * rows * np.log(1 - MATTERS))  # noqa: B023
            return float(rows * np.log(max(left**2, 1e-300)) + len(terms) * price)  # noqa: B023

        subsets: list[tuple[str, ...]] = [()]
        for name in offered:
            subsets += [(*subset, name) for subset in subsets]
        criteria = [criterion(subset) for subset in subsets]
        chosen += subsets[int(np.argmin(criteria))]
    return tuple(chosen)


def prune_friction_terms(problem: Problem, friction: Friction, solve: Callable[[Problem], Solution]) -> tuple[str, ...]:
    """The terms whose deviations by the jackknife are less than a third of them, the worst left out first."""
    terms = tuple(name for name in friction.terms if name in problem.parameters)
    while terms:
        solution = solve(problem)
        index = [problem.parameters.index(name) for name in terms]
        relative = np.sqrt(np.diag(solution.jackknife)[index]) / np.abs(solution.theta[index])
        worst = int(np.argmax(relative))
        if relative[worst] <= TOLD:
            break
        problem = problem.without([terms[worst]])
        terms = tuple(name for name in terms if name != terms[worst])
    return terms
