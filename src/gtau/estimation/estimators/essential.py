"""Essential friction terms and parameters, which the data support."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from gtau.estimation.estimators.estimator import Solution, Solve
from gtau.estimation.estimators.newton import delays_lost_in_noise
from gtau.estimation.regression.assembly import all_terms
from gtau.estimation.regression.dataset import Dataset, System
from gtau.estimation.regression.factors import delayed_signal, triangle
from gtau.estimation.regression.problem import Problem
from gtau.findings import Progress
from gtau.robots.parameter import BY_LOAD, DRIFTING, TEMPERATURE_TERMS, TERMS, Parameter

FRICTION_TERM_GAIN = 0.02  # share of a joint's residual that a friction term takes away
FRICTION_TERM_STD = 1 / 3  # relative standard deviation of a friction term

LOAD_PASSES = 6  # at most, over the logs, for load-dependent friction
LOAD_CONVERGED = 1e-4  # relative change of the gains at convergence


def select_friction(dataset: Dataset, solve: Solve, progress: Progress) -> System:
    """Choose the friction terms from the data; load-dependent ones need the torques, and so a fit, first."""
    per_run = len(dataset.runs) > 1
    sensors = [channel.name for channel in dataset.runs[0].channels if channel.kind.link_side]
    warm = () if dataset.temperatures is None else tuple(dataset.temperatures.reference)
    temperature_terms = all_terms(warm, TEMPERATURE_TERMS)
    offered = (*all_terms(dataset.robot.motors), *temperature_terms, *all_terms(sensors, DRIFTING))
    terms, criterion = select_friction_terms(dataset.system(offered, per_run).problem)
    if warm and per_run:  # differences between runs may come from temperature alone
        alone, less = select_friction_terms(dataset.system(offered).problem)
        if less < criterion and set(alone) & set(temperature_terms):
            terms, per_run = alone, False
    if any(term.kind in BY_LOAD for term in terms):
        # Until the torques are known the current stands for them, which explains itself where friction is most of it:
        # the terms are chosen again once a fit without load-dependent ones has given the torques.
        without = tuple(term for term in offered if term.kind not in BY_LOAD)
        plain, _ = select_friction_terms(dataset.system(without, per_run).problem)
        system, gains = dataset.system(plain, per_run), None
        for _ in range(LOAD_PASSES):
            solution = solve(system.problem)
            if gains is not None and np.allclose(solution.gains, gains, rtol=LOAD_CONVERGED, atol=0):
                break
            first, gains = gains is None, solution.gains
            dataset = dataset.reduced([system.load(k, solution.theta) for k in range(len(dataset.runs))], progress)
            if first:
                terms, _ = select_friction_terms(dataset.system(offered, per_run).problem)
            system = dataset.system(terms, per_run)
    else:
        system = dataset.system(terms, per_run)
    system = system.again(terms=prune_friction_terms(system.problem, system.terms, solve))
    # a delay lost in noise would be anything up to the longest, and other parameters with it
    lost = delays_lost_in_noise(system.problem, solve(system.problem))
    return system.again(delays=~lost) if lost.any() else system


def select_friction_terms(problem: Problem) -> tuple[tuple[Parameter, ...], float]:
    """Select friction terms joint by joint by the Bayesian information criterion.

    Each joint's current, or sensor's torque, is fitted by its own regressor alone, with every subset of its terms in
    ``problem``; the subset of least ``r log(sigma^2) + k log(r)`` is taken. As the criterion assumes
    independent errors, and real ones are autocorrelated, a term must also reduce the error by 2 per cent.
    """
    chosen, total = list[Parameter](), 0.0
    position = {name: k for k, name in enumerate(problem.parameters)}
    for j, channel in enumerate(problem.channels):
        kinds = (*TERMS, *TEMPERATURE_TERMS) if channel.kind.unknown_gain else DRIFTING
        offered = [Parameter(term, channel.name) for term in kinds if Parameter(term, channel.name) in position]
        tried = [position[name] for name in offered]
        rest = [k for k in problem.own_columns[j] if k not in tried]
        current = delayed_signal(problem.triangles[j], problem.own_delays[j])
        rows = problem.total_rows[j]
        price = max(np.log(rows), -2 * rows * np.log(1 - FRICTION_TERM_GAIN))
        # the columns common to all subsets are eliminated once; the remainder has few columns
        columns = problem.triangles[j][:, [*rest, *tried]]
        few = triangle(np.column_stack([columns, current]))[len(rest) :, len(rest) :]
        subsets = [subset for count in range(len(offered) + 1) for subset in combinations(range(len(offered)), count)]
        residuals = [triangle(few[:, [*subset, -1]])[-1, -1] for subset in subsets]
        criteria = [
            float(rows * np.log(max(residual**2, 1e-300)) + len(subset) * price)
            for subset, residual in zip(subsets, residuals, strict=True)
        ]
        best = subsets[int(np.argmin(criteria))]
        chosen += [offered[k] for k in best]
        # the criterion itself, with the same price for all columns
        total += min(criteria) - len(best) * price + (len(rest) + len(best)) * np.log(rows)
    return tuple(chosen), float(total)


def prune_friction_terms(problem: Problem, terms: tuple[Parameter, ...], solve: Solve) -> tuple[Parameter, ...]:
    """Keep the terms whose jackknife standard deviations are below a third of them, dropping the worst first."""
    terms = tuple(name for name in terms if name in problem.parameters)
    while terms:
        solution = solve(problem)
        index = [problem.parameters.index(name) for name in terms]
        relative = np.sqrt(np.diag(solution.jackknife)[index]) / np.abs(solution.theta[index])
        worst = int(np.argmax(relative))
        if relative[worst] <= FRICTION_TERM_STD:
            break
        problem = problem.without([terms[worst]])
        terms = tuple(name for name in terms if name != terms[worst])
    return terms


def essential_parameters(
    problem: Problem, candidates: Sequence[str], solve: Solve, ratio: float | None = None, correlated: bool = True
) -> tuple[Problem, Solution, float]:
    """Cancel the parameter of largest relative standard deviation among the ``candidates``, repeatedly.

    With a ``ratio`` (the paper's r_sigma, 10 to 30) until the paper's rule ``max(rel) / min(rel) < ratio`` holds. As
    kept parameters absorb the cancelled ones, that over-prunes if the best parameter is very accurate; so without one,
    until the Bayesian information criterion keeps every parameter: it must be ``sqrt(log r)`` standard deviations
    (about 3) away from zero. (At two, groups of nearly dependent parameters stay with absurd values that cancel each
    other.) ``solve`` keeps the gains, or estimates them again as the paper does; ``correlated`` allows for
    autocorrelated errors, by the initial ratio of the jackknife to the formula.

    Returns the problem and its solution, and by how much the residual of the worst joint grows, per cent.
    """
    whole = solution = solve(problem)
    formula = np.maximum(np.diag(solution.covariance), 1e-300)
    larger = np.sqrt(np.diag(solution.jackknife) / formula) if correlated else np.ones(len(formula))
    inflation = dict(zip(problem.parameters, larger, strict=False))
    significant = 1 / np.sqrt(np.log(problem.total_rows.sum()))
    while True:
        index = [k for k, name in enumerate(problem.parameters) if name in candidates]
        std = np.sqrt(np.diag(solution.covariance)[problem.unknowns.theta])
        std = std * [inflation[name] for name in problem.parameters]
        relative = (std / np.maximum(np.abs(solution.theta), 1e-300))[index]
        worst = int(np.argmax(relative))
        allowed = significant if ratio is None else ratio * relative.min()
        if relative[worst] <= allowed or len(index) == 1:
            return problem, solution, 100 * float(np.max(solution.sigma / whole.sigma) - 1)
        problem = problem.without([problem.parameters[index[worst]]])
        solution = solve(problem)
