"""Estimators against formulas written down here, against Monte Carlo, and against each other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import scipy.optimize

from gtau.estimation.estimators import newton
from gtau.estimation.estimators.essential import essential_parameters
from gtau.estimation.estimators.estimator import Solution
from gtau.estimation.estimators.least_squares import ols, tls, two_stage, wls
from gtau.estimation.estimators.maximum_likelihood import ml
from gtau.estimation.regression.factors import FIXED, KNOWN, SIGNAL, delayed, leave_one_out, triangle
from gtau.estimation.regression.problem import Problem
from gtau.robots.parameter import Parameter
from gtau.signals.channel import MOTOR, Channel
from gtau.signals.preparation.filters import differentiate, low_pass

UNITS = 20
THETA = np.array([1.5, -0.7, 0.4, 2.2, -1.1])
GAINS = np.array([2.0, -5.0])
DELAYS = np.array([2e-3, -1e-3])
SIGMA = np.array([0.02, 0.004])  # of the currents' noise
N, N_THETA = len(GAINS), len(THETA)

METHODS: dict[str, Callable[[Problem], Solution]] = {
    "ols": lambda problem: ols(problem, GAINS),
    "wls": lambda problem: wls(problem, GAINS),
    "ml": ml,
    "tls": tls,
}
every_method = pytest.mark.parametrize("method", METHODS)
least_squares = pytest.mark.parametrize("method", ["ols", "wls", "ml"])


def exact_rows(rng: np.random.Generator, per_unit: int = 15, curved: bool = True) -> np.ndarray:
    """Rows (U, n, p, n_theta + 4) of a random linear model without errors; the last parameter acts on joint 1 alone.

    Not ``curved``: the currents' second derivatives are zero, which makes the delays linear.
    """
    units = rng.normal(size=(UNITS, N, per_unit, N_THETA + 4))
    units[:, 1, :, N_THETA - 1] = 0.0
    units[: UNITS // 2, ..., N_THETA] = 0.0  # without payload
    units[..., -2] *= 50.0
    units[..., -1] *= 5000.0 if curved else 0.0
    tau = units[..., :N_THETA] @ THETA + units[..., N_THETA]
    shift = delayed(DELAYS)[:, 1:]
    units[..., -3] = tau / GAINS[:, None] - np.einsum("ujpk,jk->ujp", units[..., -2:], shift)
    return units


def noisy(units: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The rows with white noise on the currents."""
    units = units.copy()
    units[..., -3] += SIGMA[:, None] * rng.normal(size=units.shape[:3])
    return units


def problem_of(units: np.ndarray) -> Problem:
    channels = tuple(Channel(f"j{k + 1}", MOTOR, f"j{k + 1}", k) for k in range(units.shape[1]))
    parameters = tuple(Parameter(f"p{k + 1}", "") for k in range(units.shape[-1] - 4))
    return Problem(
        parameters,
        channels,
        lambda: units,
        np.full(units.shape[:2], units.shape[2]),
        longest_delays=np.full(len(channels), 0.02),
    )


def reduced(problem: Problem) -> Problem:
    """The same problem from triangular factors."""
    blocks = np.stack([[triangle(block) for block in unit] for unit in problem.blocks])
    return replace(problem, make_blocks=lambda: blocks)


def assert_same(a: Solution, b: Solution, rtol: float) -> None:
    np.testing.assert_allclose(a.values, b.values, rtol=rtol, atol=rtol * 1e-3)
    np.testing.assert_allclose(a.sigma, b.sigma, rtol=rtol)
    for one, other in ((a.covariance, b.covariance), (a.jackknife, b.jackknife)):
        size = np.sqrt(np.outer(np.diag(other), np.diag(other)))
        assert (np.abs(one - other) <= 10 * rtol * size).all()
    assert dict(a.statistics) == pytest.approx(dict(b.statistics), rel=rtol)


# Exactness, and the same from rows and factors


@every_method
def test_data_without_errors_give_the_truth(method: str, rng: np.random.Generator) -> None:
    solution = METHODS[method](problem_of(exact_rows(rng)))
    np.testing.assert_allclose(solution.theta, THETA, rtol=1e-8)
    np.testing.assert_allclose(solution.gains, GAINS, rtol=1e-8)
    np.testing.assert_allclose(solution.delays, DELAYS, rtol=1e-6)
    assert (np.sqrt(np.diag(solution.jackknife)) < 1e-7).all()


@every_method
def test_factors_say_the_same_as_rows(method: str, rng: np.random.Generator) -> None:
    problem = problem_of(noisy(exact_rows(rng), rng))
    assert_same(METHODS[method](reduced(problem)), METHODS[method](problem), 1e-9)


@pytest.mark.parametrize("method", ["ml", "tls"])
def test_a_reversed_current_reverses_its_gain_alone(method: str, rng: np.random.Generator) -> None:
    units = noisy(exact_rows(rng), rng)
    before = METHODS[method](problem_of(units))
    reversed_ = units.copy()
    reversed_[:, 0, :, -3:] *= -1
    after = METHODS[method](problem_of(reversed_))
    np.testing.assert_allclose(after.gains, before.gains * [-1, 1], rtol=1e-9)
    np.testing.assert_allclose(after.theta, before.theta, rtol=1e-9)
    np.testing.assert_allclose(np.diag(after.jackknife), np.diag(before.jackknife), rtol=1e-6)


# Formulas written down again, on all rows


def rows(problem: Problem, j: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """W, known, v, v' of joint j."""
    A = problem.blocks[:, j].reshape(-1, problem.n_theta + 4)
    return A[:, : problem.n_theta], A[:, problem.n_theta], A[:, -3], A[:, -2]


def own_model(problem: Problem, j: int) -> tuple[np.ndarray, float, float]:
    """Of joint j alone: its columns [W | known] that are not zero, its delay, its sigma; v'' is zero."""
    W, known, v, v1 = rows(problem, j)
    X = np.column_stack([W, known])
    X = X[:, np.abs(X).sum(axis=0) > 0]
    x, rss, *_ = np.linalg.lstsq(np.column_stack([X, v1]), v, rcond=None)
    return X, x[-1], float(np.sqrt(rss[0] / (len(v) - X.shape[1])))


@pytest.mark.parametrize("method", ["ols", "wls"])
def test_least_squares_by_lstsq(method: str, rng: np.random.Generator) -> None:
    problem = problem_of(noisy(exact_rows(rng, curved=False), rng))
    weights = [1.0, 1.0] if method == "ols" else [1 / (g * own_model(problem, j)[2]) for j, g in enumerate(GAINS)]
    A, y = [], []
    for j, (g, w) in enumerate(zip(GAINS, weights, strict=True)):
        W, known, v, v1 = rows(problem, j)
        delay = np.zeros((len(v), N))
        delay[:, j] = g * v1
        A.append(w * np.column_stack([W, delay]))
        y.append(w * (g * v - known))
    x = np.linalg.lstsq(np.concatenate(A), np.concatenate(y), rcond=None)[0]
    solution = METHODS[method](problem)
    np.testing.assert_allclose(solution.theta, x[:N_THETA], rtol=1e-9)
    np.testing.assert_allclose(solution.delays, x[N_THETA:], rtol=1e-7)
    np.testing.assert_array_equal(solution.gains, GAINS)
    # Each joint's own error level, propagated through the estimator.
    free = problem.total_rows - len(x) / N
    errors = [b - a @ x for a, b in zip(A, y, strict=True)]
    noise = [np.full(len(e), np.sqrt(e @ e / f)) for e, f in zip(errors, free, strict=True)]
    back = np.linalg.pinv(np.concatenate(A)) * np.concatenate(noise)
    given = [*range(N_THETA), *range(N_THETA + N, N_THETA + 2 * N)]
    np.testing.assert_allclose(solution.covariance[np.ix_(given, given)], back @ back.T, rtol=1e-6, atol=1e-16)
    assert not solution.covariance[N_THETA : N_THETA + N].any()
    assert not solution.jackknife[N_THETA : N_THETA + N].any()


def test_maximum_likelihood_by_an_optimizer(rng: np.random.Generator) -> None:
    units = noisy(exact_rows(rng), rng)
    problem = problem_of(units)

    def errors(x: np.ndarray) -> np.ndarray:
        theta, gains, delays = x[:N_THETA], x[N_THETA : N_THETA + N], 1e-3 * x[N_THETA + N :]
        v = np.einsum("ujpk,jk->ujp", units[..., -3:], delayed(np.array(delays)))
        return (v - (units[..., :N_THETA] @ theta + units[..., N_THETA]) / gains[:, None]).swapaxes(0, 1)

    def cost(x: np.ndarray) -> float:
        """Minus the log-likelihood, the sigmas at their best."""
        return float(np.sum(problem.total_rows * np.log(np.sum(errors(x) ** 2, axis=(1, 2)))) / 2)

    x = np.concatenate([THETA, GAINS, 1e3 * DELAYS])
    for _ in range(8):
        sigma = np.sqrt(np.mean(errors(x) ** 2, axis=(1, 2)))[:, None, None]
        x = scipy.optimize.least_squares(lambda x, s=sigma: (errors(x) / s).ravel(), x, xtol=1e-15, ftol=1e-15).x
    solution = ml(problem)
    ours = np.concatenate([solution.theta, solution.gains, 1e3 * solution.delays])
    np.testing.assert_allclose(ours, x, rtol=1e-5)
    assert cost(ours) <= cost(x) + 1e-9
    # The observed information is the inverse of the covariance; sigma is estimated with fewer degrees of freedom.
    scale = np.concatenate([np.ones(N_THETA + N), np.full(N, 1e3)])
    std = np.sqrt(np.diag(solution.covariance)) * scale
    for k, step in enumerate(std):
        moved = [cost(ours + sign * step * (np.arange(len(ours)) == k)) for sign in (1, -1)]
        information = sum(moved) - 2 * cost(ours)
        assert information >= 0.9  # 1 / (1 - correlation^2)


def total(problem: Problem, weights: list[float]) -> np.ndarray:
    """W_tot of eq. (33), rows weighted by joint, currents at the joints' own delays."""
    blocks = []
    for j, w in enumerate(weights):
        W, known, v, v1 = rows(problem, j)
        V = np.zeros((len(v), N))
        V[:, j] = v - own_model(problem, j)[1] * v1
        blocks.append(w * np.column_stack([-W, V, -known]))
    return np.concatenate(blocks)


def test_total_least_squares_by_svd(rng: np.random.Generator) -> None:
    problem = problem_of(noisy(exact_rows(rng, curved=False), rng))
    weights = []
    for j in range(N):
        X, d, _ = own_model(problem, j)
        _, _, v, v1 = rows(problem, j)
        own = np.column_stack([X, v - d * v1])
        weights.append(np.sqrt(own.shape[0] - own.shape[1]) / np.linalg.svd(own, compute_uv=False)[-1])
    W_tot = total(problem, weights)
    U, s, Vt = np.linalg.svd(W_tot, full_matrices=False)
    chi = Vt[-1] / Vt[-1, -1]
    solution = tls(problem)
    np.testing.assert_allclose(np.r_[solution.theta, solution.gains], chi[:-1], rtol=1e-9)
    assert solution.statistics["singular_ratio"] == pytest.approx(s[-2] / s[-1], rel=1e-9)
    # Eq. (39) with the pseudo-inverse of the compatible system, so that nothing is squared and inverted.
    compatible = (W_tot - s[-1] * np.outer(U[:, -1], Vt[-1]))[:, :-1]
    half = np.linalg.pinv(compatible)
    covariance = s[-1] ** 2 / (W_tot.shape[0] - W_tot.shape[1]) * (1 + chi[:-1] @ chi[:-1]) * half @ half.T
    size = N_THETA + N
    np.testing.assert_allclose(solution.covariance[:size, :size], covariance, rtol=1e-7, atol=1e-14)
    assert (np.diag(solution.covariance)[:size] > 0).all()


def test_2sls_is_a_start_near_the_answer(rng: np.random.Generator) -> None:
    problem = problem_of(noisy(exact_rows(rng), rng))
    first = two_stage(problem)
    gains, theta = first.gains, first.theta
    solution = ml(problem)
    std = np.sqrt(np.diag(solution.covariance))
    assert (np.abs(gains - solution.gains) < 2 * std[N_THETA : N_THETA + N]).all()
    assert (np.abs(theta - solution.theta) < 2 * std[:N_THETA]).all()


# Standard deviations


@pytest.mark.slow
@least_squares
def test_deviations_against_monte_carlo(method: str, rng: np.random.Generator) -> None:
    rows = exact_rows(rng)
    solutions = [METHODS[method](problem_of(noisy(rows, rng))) for _ in range(300)]
    estimates = np.array([each.values for each in solutions])
    free = estimates.std(axis=0) > 0
    actual = estimates.std(axis=0, ddof=1)[free]
    truth = np.concatenate([THETA, GAINS, DELAYS])[free]
    assert (np.abs(estimates.mean(axis=0)[free] - truth) < 4 * actual / np.sqrt(300)).all()
    told = np.sqrt(np.mean([np.diag(each.covariance) for each in solutions], axis=0))
    np.testing.assert_allclose(told[free] / estimates.std(axis=0)[free], 1.0, atol=0.15)
    jackknife = np.sqrt(np.mean([np.diag(each.jackknife) for each in solutions[:100]], axis=0))
    np.testing.assert_allclose(jackknife[free] / estimates.std(axis=0)[free], 1.0, atol=0.2)


def test_deviations_of_total_least_squares(rng: np.random.Generator) -> None:
    # Eq. (39) holds where every entry is equally noisy, which with one joint no zero of V_tau contradicts.
    exact = exact_rows(rng, per_unit=30, curved=False)[:, :1]
    exact[..., -3] -= DELAYS[0] * exact[..., -2]
    exact[..., -2] = 0.0
    estimates, told = [], []
    for _ in range(300):
        units = exact.copy()
        units[..., : N_THETA + 2] += 0.01 * rng.normal(size=units[..., : N_THETA + 2].shape)
        solution = tls(problem_of(units))
        estimates.append(np.r_[solution.theta, solution.gains])
        told.append(np.diag(solution.covariance)[: N_THETA + 1])
    actual = np.std(estimates, axis=0, ddof=1)
    np.testing.assert_allclose(np.sqrt(np.mean(told, axis=0)) / actual, 1.0, atol=0.15)
    assert (np.abs(np.mean(estimates, axis=0) - np.r_[THETA, GAINS[0]]) < 4 * actual / np.sqrt(300)).all()


def smooth(rng: np.random.Generator, shape: tuple[int, ...], decay: float = 0.8) -> np.ndarray:
    """First-order autoregressive noise of unit variance along the first axis."""
    x = rng.normal(size=shape)
    for k in range(1, shape[0]):
        x[k] = decay * x[k - 1] + np.sqrt(1 - decay**2) * x[k]
    return x


@pytest.mark.parametrize("method", ["wls", "ml", "tls"])
def test_only_the_jackknife_sees_coloured_noise(method: str, rng: np.random.Generator) -> None:
    per_unit = 40
    length = UNITS * per_unit
    rows = smooth(rng, (length, N, N_THETA + 1))
    units = np.zeros((UNITS, N, per_unit, N_THETA + 4))
    units[..., : N_THETA + 1] = rows.reshape(UNITS, per_unit, N, -1).swapaxes(1, 2)
    units[: UNITS // 2, ..., N_THETA] = 0.0
    exact = (units[..., :N_THETA] @ THETA + units[..., N_THETA]) / GAINS[:, None]
    solutions = []
    for _ in range(100):
        noise = SIGMA * smooth(rng, (length, N))
        units[..., -3] = exact + noise.reshape(UNITS, per_unit, N).swapaxes(1, 2)
        solutions.append(METHODS[method](problem_of(units.copy())))
    estimates = np.array([each.values for each in solutions])[:, : N_THETA + N]
    free = estimates.std(axis=0) > 0
    actual = estimates.std(axis=0)[free]
    formula, jackknife = (
        np.sqrt(np.mean([np.diag(getattr(each, name))[: N_THETA + N][free] for each in solutions], axis=0))
        for name in ("covariance", "jackknife")
    )
    np.testing.assert_allclose(jackknife / actual, 1.0, atol=0.4)
    if method != "tls":  # its formula is not one for noise of the currents alone
        assert (formula < 0.7 * actual).all()
        assert (formula < 0.75 * jackknife).all()


@every_method
def test_one_step_replaces_estimating_again(method: str, rng: np.random.Generator) -> None:
    problem = problem_of(noisy(exact_rows(rng), rng))
    solution = METHODS[method](problem)
    again = []
    for u in range(UNITS):
        blocks = partial(np.delete, problem.blocks, u, 0)
        rest = replace(problem, make_blocks=blocks, rows=np.delete(problem.rows, u, 0))
        again.append(METHODS[method](rest).values - solution.values)
    std = np.sqrt(np.diag(solution.jackknife))
    some = std > 0
    # Of the jackknife's deviation; the weights and, in the homogeneous methods, the delays stay those of all units.
    assert (np.abs(np.array(again) - solution.replicates())[:, some] < 0.12 * std[some]).all()
    deviations = np.array(again) - np.mean(again, axis=0)
    true = np.sqrt((UNITS - 1) / UNITS * np.sum(deviations**2, axis=0))
    np.testing.assert_allclose(std[some] / true[some], 1.0, atol=0.1)


def test_leave_one_out_is_the_factor_of_the_others(rng: np.random.Generator) -> None:
    blocks = [triangle(rng.normal(size=(12, 5))) for _ in range(7)]
    for u, R in enumerate(leave_one_out(blocks)):
        others = np.concatenate(blocks[:u] + blocks[u + 1 :])
        np.testing.assert_allclose(R.T @ R, others.T @ others, rtol=1e-12)


# What the data cannot tell


def test_delays_beyond_what_can_be_described_are_not_invented(rng: np.random.Generator) -> None:
    problem = problem_of(noisy(exact_rows(rng), rng))
    np.testing.assert_allclose(problem.own_delays, DELAYS, atol=1e-4)
    narrow = replace(problem, longest_delays=np.full(len(problem.channels), 1e-3 / 2))
    np.testing.assert_array_equal(narrow.own_delays, [0.0, 0.0])


# Essential parameters


def with_idle(rng: np.random.Generator) -> Problem:
    """A problem in which the parameters p2 and p4 are zero."""
    units = exact_rows(rng)
    units[..., -3] -= (units[..., [1, 3]] @ THETA[[1, 3]]) / GAINS[:, None]
    return problem_of(noisy(units, rng))


def test_parameters_that_are_nothing_are_cancelled(rng: np.random.Generator) -> None:
    problem = with_idle(rng)
    kept, solution, _ = essential_parameters(problem, problem.parameters, METHODS["wls"])
    assert kept.parameters == ("p1", "p3", "p5")
    std = np.sqrt(np.diag(solution.covariance))[:3]
    assert (np.abs(solution.theta - THETA[[0, 2, 4]]) < 4 * std).all()


def test_the_ratio_rule_holds_and_no_step_too_far(rng: np.random.Generator) -> None:
    problem = problem_of(noisy(exact_rows(rng), rng))

    def relative(of: Problem) -> np.ndarray:
        solution = wls(of, GAINS)
        return np.sqrt(np.diag(solution.jackknife))[: of.n_theta] / np.abs(solution.theta)

    spread = relative(problem).max() / relative(problem).min()
    assert essential_parameters(problem, problem.parameters, METHODS["wls"], ratio=spread * 1.01)[0] is problem
    kept, _, _ = essential_parameters(problem, problem.parameters, METHODS["wls"], ratio=spread * 0.99)
    assert len(kept.parameters) == N_THETA - 1


def test_only_candidates_are_cancelled(rng: np.random.Generator) -> None:
    kept, _, _ = essential_parameters(with_idle(rng), ("p1", "p2", "p3", "p5"), METHODS["wls"])
    assert kept.parameters == ("p1", "p3", "p4", "p5")


def test_slow_motion_under_white_noise_settles(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """The current's derivatives are then mostly noise, and Gauss and Newton's steps in the delays far too short."""
    rate, samples, theta, gain = 100.0, 6000, np.array([1.5, -0.7, 0.4]), 2.0
    time = np.arange(samples) / rate
    units = []
    for mass in (0.0, 1.0):
        w = 2 * np.pi * np.array([0.11, 0.23, 0.31])
        W = np.sin(w * time[:, None] + rng.uniform(0, 6.0, 3))
        known = mass * np.sin(2 * np.pi * 0.17 * time)
        v = (W @ theta + known) / gain + low_pass(0.2 * rng.standard_normal(samples), rate, 10.0)
        whole = np.column_stack([W, known, v, *differentiate(v, rate)])
        units += [whole[part][None] for part in np.array_split(np.arange(samples), 10)]
    problem = Problem(
        tuple(Parameter(kind, "") for kind in "abc"),
        (Channel("j", MOTOR, "j", 0),),
        lambda: np.array(units),
        np.full((20, 1), samples // 10),
        np.array([0.5]),
    )
    far = np.array([*theta, gain, 0.05])

    def weights(squares: np.ndarray) -> np.ndarray:
        return 1 / np.sqrt(squares / problem.total_rows)

    monkeypatch.setattr(newton, "STEPS", 25)
    solution = newton.solve(problem, far, weights, True)
    np.testing.assert_allclose(solution.values, ml(problem).values, rtol=1e-5)
    assert solution.gains[0] == pytest.approx(gain, rel=0.03)
    monkeypatch.setattr(newton, "curvature_of_delays", lambda blocks, *others: np.zeros(blocks.shape[:-2]))
    assert solution.converged
    assert not newton.solve(problem, far, weights, True).converged  # in 150 steps and more it would


def test_a_gain_that_nothing_determines_has_no_deviation_near_zero(rng: np.random.Generator) -> None:
    """One of two joints without a parameter in common, whose scale is another's alone."""
    rows = np.zeros((20, 2, 40, 2 + FIXED))
    rows[:, 0, :, 0], rows[:, 1, :, 1] = rng.standard_normal((2, 20, 40))
    rows[:, 0, :, KNOWN] = rng.standard_normal((20, 40))
    rows[..., SIGNAL] = rows[..., :2].sum(axis=-1) + rows[..., KNOWN] + 0.01 * rng.standard_normal((20, 2, 40))
    channels = tuple(Channel(joint, MOTOR, joint, j) for j, joint in enumerate("ab"))
    names = tuple(Parameter(kind, "") for kind in "xy")
    problem = Problem(names, channels, lambda: rows, np.full((20, 2), 40), np.zeros(2))
    solution = newton.solve(problem, np.array([1.0, 1.0, 1.0, 1.0, 0.0, 0.0]), problem.weights, True)
    deviations = np.sqrt(np.diag(solution.jackknife))[2:4] / np.abs(solution.gains)
    assert deviations[0] < 0.01
    assert deviations[1] > 100


def test_columns_told_apart_without_some_parameters_are_those_found_afresh(rng: np.random.Generator) -> None:
    """Whether what is left out was one of them or not; for joint 1 alone, p3 and p5 depend on the others."""
    units = noisy(exact_rows(rng), rng)
    units[:, 0, :, 2] = units[:, 0, :, 0] - 2 * units[:, 0, :, 1]
    units[:, 0, :, 4] = 3 * units[:, 0, :, 3]
    problem = problem_of(units)
    assert [len(own) for own in problem.own_columns] == [4, N_THETA]
    for gone in (["p1"], ["p3"], ["p4"], ["p3", "p5"], ["p1", "p4"], list(problem.parameters)):
        less = problem.without(gone)
        assert less.own_columns == replace(less).own_columns
