"""The mixed model against dense matrices: its likelihood, its posterior, and how often its intervals hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag, toeplitz

from gtau.estimation.effects.mixed_model import (
    LagProducts,
    MixedFit,
    MixedModel,
    Noise,
    find_sizes,
    fit_mixed,
    lag_products,
    posterior,
)

NOISE = (Noise(0.4, (0.7, -0.3)), Noise(1.3, (-0.2, 0.1)))
NOISES = tuple((noise,) for noise in NOISE)
ROWS, OWN, FREE, SHARED = 60, 3, 4, 2
GROUPS = np.array([0, 0, 1]), np.array([2, 2])


def autocovariance(noise: Noise, rows: int) -> np.ndarray:
    """Covariance (rows, rows) of an autoregressive process, by its own recursion (Yule-Walker)."""
    first, second = noise.partial
    a = first * (1 - second), second
    correlations = [1.0, first]
    while len(correlations) < rows:
        correlations.append(a[0] * correlations[-1] + a[1] * correlations[-2])
    variance = noise.std**2 / ((1 - first**2) * (1 - second**2))
    return variance * toeplitz(correlations[:rows])


def stretches(rows: int) -> np.ndarray:
    begins = np.zeros(rows, dtype=bool)
    begins[[0, 25, 26, 28]] = True  # of 25, 1, 2 and the remaining rows
    return begins


def covariance(noise: Noise, begins: np.ndarray) -> np.ndarray:
    lengths = np.diff([*np.flatnonzero(begins), len(begins)])
    return block_diag(*(autocovariance(noise, int(length)) for length in lengths))


@pytest.fixture
def columns() -> list[np.ndarray]:
    """Rows [own | J | shared | e] of two channels."""
    rng = np.random.default_rng(4)
    return [rng.standard_normal((ROWS, OWN + FREE + SHARED + 1)) for _ in NOISE]


def model_of(columns: list[np.ndarray]) -> MixedModel:
    products = tuple((lag_products(rows, stretches(len(rows))),) for rows in columns)
    return MixedModel(products, np.zeros((FREE + 1, FREE + 1)), *GROUPS, np.full(3, 1e9), NOISES)


def dense(columns: list[np.ndarray], log_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Covariance of the errors, Jacobian, effects' columns at their sizes, and errors."""
    sizes = np.exp(log_s)
    V = block_diag(*(covariance(noise, stretches(ROWS)) for noise in NOISE))
    own = block_diag(*(rows[:, :OWN] * sizes[GROUPS[0]] for rows in columns))
    shared = np.vstack([rows[:, -1 - SHARED : -1] * sizes[GROUPS[1]] for rows in columns])
    Z = np.hstack([own, shared])
    J = np.vstack([rows[:, OWN : OWN + FREE] for rows in columns])
    return V + Z @ Z.T, J, Z, np.concatenate([rows[:, -1] for rows in columns])


def restricted_loss(columns: list[np.ndarray], log_s: np.ndarray) -> float:
    V, J, _, e = dense(columns, log_s)
    inverse = np.linalg.inv(V)
    A = J.T @ inverse @ J
    P = inverse - inverse @ J @ np.linalg.solve(A, J.T @ inverse)
    return 0.5 * float(e @ P @ e + np.linalg.slogdet(V)[1] + np.linalg.slogdet(A)[1])


LOG_S = np.array([-0.3, 0.5, 0.1])


def test_the_loss_is_the_restricted_likelihood(columns: list[np.ndarray]) -> None:
    model = model_of(columns)
    model = replace(model, noise=NOISES)
    constant = 0.5 * sum(np.linalg.slogdet(covariance(noise, stretches(ROWS)))[1] for noise in NOISE)
    for log_s in (LOG_S, LOG_S - 1.0):
        found = posterior(model, log_s)
        assert found.loss + constant == pytest.approx(restricted_loss(columns, log_s), rel=1e-8)


def test_the_slope_is_the_derivative_of_the_loss(columns: list[np.ndarray]) -> None:
    model = replace(model_of(columns), prior=np.full(3, 0.7))
    model = replace(model, noise=NOISES)
    slope = posterior(model, LOG_S).slope
    for k in range(3):
        step = 1e-5 * np.eye(3)[k]
        above, below = (posterior(model, LOG_S + sign * step).loss for sign in (1, -1))
        assert slope[k] == pytest.approx((above - below) / 2e-5, rel=1e-5)


def test_sizes_are_as_likely_with_unknowns_of_one_channel_eliminated(columns: list[np.ndarray]) -> None:
    for channel, rows in enumerate(columns):
        rows[:, OWN + FREE - 2 :][:, [1 - channel]] = 0.0
    model = replace(model_of(columns), alone=(0, 1))
    whole, less = (posterior(model, LOG_S, eliminated) for eliminated in (False, True))
    assert len(less.common) == len(whole.common) - 2
    assert less.loss == pytest.approx(whole.loss, rel=1e-7)
    np.testing.assert_allclose(less.slope, whole.slope, atol=1e-6)


def test_the_posterior_is_generalised_least_squares(columns: list[np.ndarray]) -> None:
    model = model_of(columns)
    model = replace(model, noise=NOISES)
    found = posterior(model, LOG_S)
    V, J, Z, e = dense(columns, LOG_S)
    inverse = np.linalg.inv(V)
    A = np.linalg.inv(J.T @ inverse @ J)
    d = -A @ J.T @ inverse @ e
    np.testing.assert_allclose(found.common[:FREE], d, rtol=1e-7)
    np.testing.assert_allclose(found.covariance[:FREE, :FREE], A, rtol=1e-7)
    u = -Z.T @ inverse @ (e + J @ d)  # best linear unbiased prediction
    np.testing.assert_allclose(np.concatenate([*found.own_effects, found.common[FREE:]]), u, rtol=1e-7)
    variance = np.eye(len(u)) - Z.T @ (inverse - inverse @ J @ A @ J.T @ inverse) @ Z
    np.testing.assert_allclose(found.variance.ravel(), np.diag(variance)[: 2 * OWN], rtol=1e-7)
    value, spread = found.move(np.eye(1, FREE + SHARED), [np.eye(1, OWN), np.zeros((1, OWN))])
    assert value[0] == pytest.approx(d[0] + u[0])
    cross = -(A @ J.T @ inverse @ Z)[0, 0]
    assert spread[0, 0] == pytest.approx(A[0, 0] + variance[0, 0] + 2 * cross, rel=1e-7)


def simulated(
    rng: np.random.Generator, rows: int = 400, alike: float = 0.0, levels: tuple[float, ...] = (1.0,)
) -> tuple[MixedModel, np.ndarray]:
    """Two channels with effects of plausible sizes and correlated noise, and what d should be.

    Columns of the shared effects that look ``alike`` those of d have no size. Each of the ``levels`` of noise has rows.
    """
    truth, columns = rng.standard_normal(FREE), []
    shared = rng.standard_normal(SHARED) * (not alike)
    begins = np.zeros(rows, dtype=bool)
    begins[::100] = True
    for noise in NOISE:
        motions = [rng.standard_normal((rows, OWN + FREE + SHARED)) for _ in levels]
        for X in motions:
            X[:, :OWN] = np.cumsum(X[:, :OWN], axis=0) / 10
            X[:, -SHARED:] += alike * X[:, OWN : OWN + SHARED]
        u = np.concatenate([rng.standard_normal(OWN), truth, shared])
        root = np.linalg.cholesky(covariance(noise, begins))
        errors = (-X @ u + level * root @ rng.standard_normal(rows) for X, level in zip(motions, levels, strict=True))
        parts = (lag_products(np.column_stack([X, e]), begins) for X, e in zip(motions, errors, strict=True))
        columns.append(tuple(parts))
    known = np.zeros((FREE + 1, FREE + 1))
    return MixedModel(tuple(columns), known, *GROUPS, np.full(3, 3.0)), truth


def test_rows_count_by_the_noise_of_their_motion() -> None:
    """A tenth of the noise in half of the rows: with one noise for both, errors are three times as large."""
    rng, errors, z, noises = np.random.default_rng(6), [], [], []
    for _ in range(40):
        model, truth = simulated(rng, levels=(1.0, 0.1))
        fit, together = fit_mixed(model), fit_mixed(replace(model, rows=tuple(map(joined, model.rows))))
        error = fit.at.common[:FREE] - truth
        z.append(error / np.sqrt(np.diag(fit.at.covariance)[:FREE]))
        errors.append((error, together.at.common[:FREE] - truth))
        noises.append([[noise.std for noise in channel] for channel in fit.model.noise])
    apart, one = np.sqrt(np.mean(np.square(errors), axis=(0, 2)))
    assert apart < one / 3
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.15)
    expected = np.outer([noise.std for noise in NOISE], (1.0, 0.1))
    np.testing.assert_allclose(np.mean(noises, axis=0), expected, rtol=0.05)


def joined(parts: tuple[LagProducts, ...]) -> tuple[LagProducts]:
    return (
        replace(parts[0], products=sum(part.products for part in parts), counts=sum(part.counts for part in parts)),
    )


def test_no_size_is_beyond_its_bound() -> None:
    model, _ = simulated(np.random.default_rng(5))
    free = fit_mixed(model).log_s
    largest = np.array([4.0, free[1] - 1.0, 4.0])
    bounded = fit_mixed(replace(model, largest=largest)).log_s
    assert bounded[1] == pytest.approx(largest[1])
    assert (bounded <= largest).all()


def test_a_size_far_beyond_its_bound_counts_for_nothing() -> None:
    model, _ = simulated(np.random.default_rng(5))
    scaled = replace(model, noise=tuple((replace(noise, std=1e-3),) for noise in NOISE), largest=-5.0)
    log_s = np.full(3, -5.0)
    fit = MixedFit(scaled, log_s)
    assert posterior(scaled, log_s + 2.0).loss < fit.at.loss - 800  # its exponential would be infinite
    value, covariance = fit.averaged(np.eye(FREE, FREE + SHARED))
    assert np.isfinite(value).all()
    assert np.isfinite(covariance).all()


def test_intervals_hold_and_noise_is_found() -> None:
    rng, z, noises = np.random.default_rng(11), [], []
    for _ in range(40):
        model, truth = simulated(rng)
        fit = fit_mixed(model)
        std = np.sqrt(np.diag(fit.at.covariance)[:FREE])
        z.append((fit.at.common[:FREE] - truth) / std)
        noises.append([(noise.std, *noise.partial) for (noise,) in fit.model.noise])
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.15)
    expected = [(noise.std, *noise.partial) for noise in NOISE]
    np.testing.assert_allclose(np.mean(noises, axis=0), expected, atol=0.03)


def test_an_effect_that_is_absent_moves_averaged_estimates_less() -> None:
    rng, errors, z, slopes = np.random.default_rng(2), [], [], np.eye(FREE, FREE + SHARED)
    for _ in range(40):
        model, truth = simulated(rng, alike=3.0)
        fit = fit_mixed(model)
        value, covariance = fit.averaged(slopes)
        errors.append((fit.at.common[:FREE] - truth, value - truth))
        z.append((value - truth) / np.sqrt(np.diag(covariance)))
    likeliest, averaged = np.sqrt(np.mean(np.square(errors), axis=(0, 2)))
    assert averaged < 0.9 * likeliest
    assert 0.7 < np.sqrt(np.mean(np.square(z))) < 1.1


def test_an_effect_that_is_sure_is_not_averaged_away() -> None:
    model, _ = simulated(np.random.default_rng(3))
    fit = fit_mixed(model)
    value, covariance = fit.averaged(np.eye(FREE, FREE + SHARED))
    np.testing.assert_allclose(value, fit.at.common[:FREE], atol=2e-3)
    np.testing.assert_allclose(np.diag(covariance), np.diag(fit.at.covariance)[:FREE], rtol=0.05)


def test_the_evidence_for_an_effect_is_what_is_lost_without_it() -> None:
    model, _ = simulated(np.random.default_rng(3))
    fit = fit_mixed(model)
    for group in range(3):
        assert fit.lost_without([group]) > 20
    without = find_sizes(fit.model, fit.log_s, [0])
    assert without.sizes[0] < 1e-4
    absent = replace(model, rows=tuple((replace(part, products=_without(part.products)),) for (part,) in model.rows))
    assert fit_mixed(absent).lost_without([0]) < 3


@pytest.mark.parametrize("seed", [0, 11])
def test_sizes_do_not_depend_on_where_their_search_begins(seed: int) -> None:
    """A size near zero has no slope by its logarithm, and stayed there in these two of twelve experiments."""
    model, _ = simulated(np.random.default_rng(seed))
    losses = [find_sizes(model, np.full(3, start)).at.loss for start in (-1.2, -7.0, 4.0)]
    assert np.ptp(losses) < 0.05


def _without(products: np.ndarray) -> np.ndarray:
    """Products of the same rows, of whose errors the first group explains nothing: its columns are noise."""
    made = products.copy()
    made[:, :2, :], made[:, :, :2] = 0.0, 0.0
    made[:, range(2), range(2)] = 1.0
    return made
