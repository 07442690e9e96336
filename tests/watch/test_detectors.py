"""Detectors of a change: the recursions against matrices, and false alarms and delays on simulated days."""

from __future__ import annotations

import numpy as np
import pytest

from gtau.watch.detectors import GRID, KAPPA, alone, evidence, isolated, median


def by_matrices(x: np.ndarray, weights: np.ndarray, learning: int) -> float:
    """The e-detector from the definition: generalised least squares with the covariance written out."""
    n, lag = len(x), np.abs(np.subtract.outer(np.arange(len(x)), np.arange(len(x))))
    healthy, changed = [], []
    for rho, c in GRID:
        V = (1 - c) * (rho**lag if rho else np.eye(n)) + c * np.diag(weights)
        white = np.linalg.inv(np.linalg.cholesky(V))
        y, h = white @ x, white @ np.ones(n)
        S0 = y @ y - (h @ y) ** 2 / (h @ h)
        p0 = np.linalg.det(V) ** -0.5 * (h @ h) ** -0.5 * S0 ** (-(n - 1) / 2)
        healthy.append(p0)
        for j in range(learning, n):
            step = white @ (np.arange(n) >= j).astype(float)
            step = step - h * (h @ step) / (h @ h)
            r = step @ step
            rest = S0 - (step @ y) ** 2 / r * r * KAPPA**2 / (1 + r * KAPPA**2)
            changed.append(p0 * (1 + r * KAPPA**2) ** -0.5 * (S0 / rest) ** ((n - 1) / 2))
    return float(np.log(np.sum(changed) / len(GRID) / max(healthy)))


def test_the_recursions_are_those_of_the_definition(rng: np.random.Generator) -> None:
    x, weights = rng.normal(size=30), rng.uniform(1.0, 9.0, 30)
    weights[np.argsort(weights)[:16]] = 1.0  # the median log and those below count as 1
    for n in (8, 30):
        x_n, w = x[:n], np.maximum(weights[:n] / median(weights[:n, None]), 1.0)
        y = (x_n - x_n.mean()) / x_n.std()
        log_e = evidence(x_n[:, None], weights[:n, None], 5).log_e[0]
        assert log_e == pytest.approx(by_matrices(y, w, 5), rel=1e-9)
        gaps = np.full((2 * n, 1), np.nan)  # logs that show nothing lie between
        gaps[n:, 0] = x_n
        assert evidence(gaps, np.ones_like(gaps), 5).log_e[0] == pytest.approx(
            evidence(x_n[:, None], np.ones((n, 1)), 5).log_e[0], rel=1e-9
        )
    moved = evidence(3.0 + 1e-3 * x[:, None], weights[:, None], 5)  # neither mean nor scale matters
    assert moved.log_e[0] == pytest.approx(evidence(x[:, None], weights[:, None], 5).log_e[0], rel=1e-6)


@pytest.mark.parametrize("memory", [0.0, 0.85])
def test_false_alarms_come_no_sooner_than_stated(memory: float, rng: np.random.Generator) -> None:
    stated, days, robots = 30.0, 90, 60
    x = rng.normal(size=(days, robots))
    for t in range(1, days):
        x[t] = memory * x[t - 1] + np.sqrt(1 - memory**2) * x[t]
    healthy = np.ones(robots, dtype=bool)
    for t in range(12, days, 4):
        proof = evidence(x[: t + 1], np.ones((t + 1, robots)), 10)
        healthy &= ~((proof.log_e >= np.log(stated)) & proof.confirmed)
    # of 80 days at one in 30, Markov's inequality allows all robots; a detector that holds its rate alarms in few
    assert np.mean(~healthy) < 0.3


def test_a_shift_is_found_and_dated(rng: np.random.Generator) -> None:
    x = rng.normal(size=(24, 1))
    x[20:] += 8.0
    ones = np.ones_like(x)
    proof = evidence(x, ones, 10)
    assert proof.log_e[0] > np.log(1e4)
    assert (proof.start[0], proof.confirmed[0]) == (20, True)
    assert evidence(x[:21], ones[:21], 10).log_e[0] < 3.0  # one log is not enough
    rising = np.array([True])
    assert evidence(-x, ones, 10).log_e[0] == pytest.approx(proof.log_e[0])
    assert evidence(-x, ones, 10, rising).log_e[0] < 3.0  # of a residual only growth counts
    assert evidence(np.full((24, 1), 2.5), ones, 10).log_e[0] == -np.inf  # a chart without any scatter says nothing


def test_logs_far_off_alone_are_isolated(rng: np.random.Generator) -> None:
    x = rng.normal(size=(30, 2))
    x[12, 0], x[20:22, 1] = 30.0, 30.0
    assert np.argwhere(isolated(x)).tolist() == [[12, 0]]
    assert alone(np.array([[1.0], [-1.0], [0.0], [1.0], [1.0]])).ravel().tolist() == [True, True, False, False, False]
    x[12, 0] = 0.0
    x[25, 0] = 40.0  # one bad log between healthy ones hides nothing and starts nothing
    assert evidence(x[:, :1], np.ones((30, 1)), 10).log_e[0] < np.log(50)
