"""A linear mixed model of residuals: what they share with known shapes of unknown size, by restricted likelihood.

Residuals ``e`` of a fit, their Jacobian ``J`` and the columns ``Z_k`` of each effect k at a plausible size obey

    e = J d + sum_k Z_k u_k + noise,     u_k ~ N(0, s_k^2),     d free,

with noise of each channel and motion that is autoregressive of second order along the rows. All ``s_k`` together
maximise the restricted likelihood (Patterson and Thompson 1971, Harville 1977). The posterior of d moves the estimates
and is their covariance, the posterior of ``u_k`` is how large an effect is beside all others, and the log-likelihood
that is lost without it is the evidence for it.

Each channel has columns of its own beside those that all channels share, so the normal equations are an arrow: blocks
of the channels' own columns, bordered by the shared ones. Rows enter through their products with the two rows before
them alone, so that memory does not grow with the logs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

import numpy as np

BOUNDS = (-7.0, 4.0)  # of log s: an effect from a thousandth to fifty times its plausible size
START = -1.2  # of log s: all effects at a third of their plausible sizes
# Of log s: steps about the likeliest size, over which estimates are averaged; any log s is as likely before the data.
# Half the probability for an absent effect instead hardly matters: docs/evidence/coverage/averaged-sizes.csv.
AROUND = np.arange(-3.0, 3.0)
DETERMINED = 1e-9  # share of a column that no other one explains, below which nothing determines it
ROUNDING = 1e-9  # of the squares of a column, which products of rows without noise may lack
# Sizes below exp(SMALL) begin once more, at exp(LOW), where that would raise the likelihood by more than WORTH, to
# first order. Else eight random starts of a foot on a force plate end 0 to 7 below the best, and with it within 0.02.
SMALL, LOW, WORTH = -4.6, -3.0, 1.0
LITTLE = 3.0  # log-likelihood lost without an effect: of less, nothing is asked
PASSES, SETTLED = 5, 0.03  # of noise and effects in turn, until no standard deviation of the noise changes by more
LARGEST_CORRELATION = 0.98  # partial autocorrelation that is believed
LEAST_STD = 1e-3  # of the noise, in standard deviations of the fit: a channel without a signal has none
LEAST_FREEDOM = 0.2  # share of the rows, at least, that count for the noise


@dataclass(frozen=True, eq=False)
class LagProducts:
    """Sums ``products`` (7, r, r) of rows of a channel times rows before them, and ``counts`` (3,) of these.

    The first three are at the lags 0, 1 and 2. Three are of the two rows at either end of each stretch, from its end:
    the first with itself, the first with the second, the second with itself. The last is of stretches of a single row.
    The model's columns are the rows, those behind the first a times M of the ``basis`` (a, M), whose last comes last.
    """

    products: np.ndarray
    counts: np.ndarray
    basis: tuple[int, np.ndarray]

    def add(self, other: LagProducts) -> None:
        """Add the rows of another part of the logs."""
        self.products[:] += other.products
        self.counts[:] += other.counts

    @cached_property
    def plain(self) -> np.ndarray:
        """Products of all rows with themselves, (p, p)."""
        return self.combined(np.eye(len(self.products))[0])

    def combined(self, weights: Sequence[float] | np.ndarray) -> np.ndarray:
        """Add up the products by their ``weights`` (7,): (p, p)."""
        products, (own, M) = np.tensordot(weights, self.products, 1), self.basis
        for _ in range(2):  # times the basis from either side
            made = products[:, own : own + len(M)] @ M
            products = np.hstack([products[:, :own], made[:, :-1], products[:, own + len(M) :], made[:, -1:]]).T
        return np.asarray(products)

    def squares(self, coefficients: np.ndarray) -> np.ndarray:
        """Sum the products of the residuals, (7,), whose columns are combined by ``coefficients`` (p,)."""
        own, M = self.basis
        first, made, others = np.split(coefficients[:-1], [own, own + M.shape[1] - 1])
        along = np.concatenate([first, M @ np.append(made, coefficients[-1]), others])
        return np.asarray(self.products @ along @ along)


def lag_products(rows: np.ndarray, begins: np.ndarray) -> LagProducts:
    """Multiply rows (K, p) with the rows before them; a stretch without gaps ``begins`` at some rows, (K,)."""
    at = np.arange(len(rows))
    first = np.maximum.accumulate(np.where(begins, at, 0))
    place, length = at - first, np.bincount(first, minlength=len(rows))[first]
    starts = at[(place == 0) & (length > 1)]
    ends = starts + length[starts] - 1
    outer, inner, alone = rows[np.append(starts, ends)], rows[np.append(starts + 1, ends - 1)], rows[length == 1]
    at_lags = [(rows[lag:][place[lag:] >= lag], rows[:-lag][place[lag:] >= lag]) for lag in (1, 2)]
    crossed = [later.T @ before for later, before in (*at_lags, (outer, inner))]
    lag_1, lag_2, ends_crossed = (product + product.T for product in crossed)
    products = [rows.T @ rows, lag_1, lag_2, outer.T @ outer, ends_crossed, inner.T @ inner, alone.T @ alone]
    counts = np.array([len(rows), *(len(later) for later, _ in at_lags)])
    return LagProducts(np.array(products), counts, (0, np.eye(rows.shape[1])))


@dataclass(frozen=True)
class Noise:
    """Noise of rows: standard deviation of what is new in each row, and partial autocorrelations at two lags."""

    std: float = 1.0
    partial: tuple[float, float] = (0.0, 0.0)

    @property
    def weights(self) -> list[float]:
        """Weights of products of rows in those of rows with independent noise of unit variance, (7,).

        The inverse covariance of a stretch is a band that is the same all along it but for the rows at its ends.
        """
        a, b = self.partial[0] * (1 - self.partial[1]), self.partial[1]
        alone = (1 - self.partial[0] ** 2) * (1 - b**2)
        within, ends = (1 + a**2 + b**2, a * b - a, -b), (-(a**2 + b**2), -a * b, -(b**2))
        return [weight / self.std**2 for weight in (*within, *ends, alone - within[0])]


def noise_of(rows: LagProducts, coefficients: np.ndarray, used: float) -> Noise:
    """Estimate the noise from residuals; ``used`` is the number of rows that the estimates take up."""
    sums, counts = rows.squares(coefficients), np.maximum(rows.counts, 1)
    c0, c1, c2 = sums[:3] / counts / (1, 2, 2)
    c0 = max(c0, 0.0)  # but for rounding
    r1, r2 = np.clip([c1, c2], -c0, c0) / max(c0, 1e-300)
    first = np.clip(r1, -LARGEST_CORRELATION, LARGEST_CORRELATION)
    second = np.clip((r2 - r1**2) / max(1 - first**2, 1e-9), -LARGEST_CORRELATION, LARGEST_CORRELATION)
    noise = Noise(1.0, (float(first), float(second)))
    count, squares = float(rows.counts[0]), float(noise.weights @ sums)
    std = float(np.sqrt(max(squares, 0.0) / max(count - used, LEAST_FREEDOM * count, 1.0)))
    return replace(noise, std=max(std, LEAST_STD))


@dataclass(frozen=True, eq=False)
class MixedModel:
    """Products of the ``rows`` ``[own | J | shared | e]`` of each channel, and the groups whose sizes are found.

    Its m own columns, k of the Jacobian, those that all channels share, and the residuals, in parts whose ``noise``
    differs: independent of unit variance where it was not found yet. ``known`` (k + 1, k + 1) are products of further
    equations ``[J | e]`` of the unknowns, of unit variance; ``own_groups`` (m,) and ``shared_groups`` the groups of the
    columns. Before the data the s of each group has a half-normal prior of a standard deviation ``prior``, and log s is
    at most ``largest``, of all groups or each. The last of the unknowns act on the channels ``alone``, each on one.
    """

    rows: tuple[tuple[LagProducts, ...], ...]
    known: np.ndarray
    own_groups: np.ndarray
    shared_groups: np.ndarray
    prior: np.ndarray
    noise: tuple[tuple[Noise, ...], ...] = ()
    largest: float | np.ndarray = BOUNDS[1]
    alone: Sequence[int] | np.ndarray = ()

    @cached_property
    def grams(self) -> np.ndarray:
        """Products (c, p, p) of the channels' rows with independent noise of unit variance."""
        channels = (zip(*channel, strict=True) for channel in zip(self.rows, self.noises, strict=True))
        return np.array([sum(part.combined(noise.weights) for part, noise in parts) for parts in channels])

    @property
    def noises(self) -> tuple[tuple[Noise, ...], ...]:
        """Noise of each channel's parts."""
        return self.noise or tuple((Noise(),) * len(parts) for parts in self.rows)

    @cached_property
    def parts(self) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray, float], ...]:
        """Products of own and common columns, and a log-determinant: of none, and of unknowns that act ``alone``."""
        m, count, first = len(self.own_groups), len(self.alone), [*range(self.unknowns), -1]
        rows, alone = self.grams[:, m:], np.s_[self.unknowns - count : self.unknowns]
        own, crossed, common = self.grams[:, :m, :m].copy(), self.grams[:, :m, m:].copy(), rows[..., m:].sum(axis=0)
        common[np.ix_(first, first)] += self.known
        elsewhere = np.arange(len(rows))[:, None] != self.alone
        L = np.linalg.cholesky(rows[..., m:][:, alone, alone] + elsewhere[:, None] * np.eye(count))
        B, determinant = np.linalg.solve(L, rows[:, alone]), 2 * float(np.log(np.diagonal(L, axis1=1, axis2=2)).sum())
        taken, kept = B.swapaxes(1, 2) @ B, np.delete(np.arange(len(common)), alone)
        left, fewer = own - taken[:, :m, :m], (common - taken[:, m:, m:].sum(axis=0))[np.ix_(kept, kept)]
        return (own, crossed, common, 0.0), (left, (crossed - taken[:, :m, m:])[..., kept], fewer, determinant)

    @property
    def unknowns(self) -> int:
        """Number k of the columns of the Jacobian."""
        return len(self.known) - 1


@dataclass(frozen=True, eq=False)
class Posterior:
    """Estimates of d and ``u / s`` at the ``sizes`` of the groups, and what their covariance follows from.

    The ``scale`` (p,) are these by column of a channel. ``common`` (k + shared,) are d and the shared effects, with the
    ``covariance`` ``half half^T``. ``root`` (c, m, m) factors how each channel's own effects vary beside them, and
    times ``crossed`` (c, m, k + shared + 1) moves them. ``loss`` is minus the restricted log-likelihood.
    """

    model: MixedModel
    sizes: np.ndarray
    scale: np.ndarray
    common: np.ndarray
    covariance: np.ndarray
    half: np.ndarray
    root: np.ndarray
    crossed: np.ndarray
    loss: float

    def coefficients(self, channel: int) -> np.ndarray:
        """Return the coefficients (p,) that combine a channel's columns into its residuals."""
        return self.scale * np.concatenate([self.own_effects[channel], self.common, [1.0]])

    def noises(self, channel: int) -> tuple[Noise, ...]:
        """Estimate the noise of a channel's parts."""
        parts, coefficients = self.model.rows[channel], self.coefficients(channel)
        grams = [part.combined(noise.weights) for part, noise in zip(parts, self.model.noises[channel], strict=True)]
        return tuple(noise_of(part, coefficients, self._used(channel, A)) for part, A in zip(parts, grams, strict=True))

    def _used(self, channel: int, gram: np.ndarray) -> float:
        """Compute how many rows with products ``gram`` own and common effects take up: tr(C X^T X)."""
        m = len(self.model.own_groups)
        A = (gram * self.scale[:, None] * self.scale)[:-1, :-1]
        B, C, root, within = self.response[channel], self.covariance, self.root[channel], A[:m, :m]
        own_effects = float(np.sum((root @ within) * root)) + float(np.sum((B.T @ within @ B) * C))
        return own_effects - 2 * float(np.sum((A[m:, :m] @ B) * C)) + float(np.sum(A[m:, m:] * C))

    @cached_property
    def own_effects(self) -> np.ndarray:
        """Effects of each channel's own, (c, m)."""
        return -((self.crossed @ np.append(self.common, 1.0))[:, None] @ self.root)[:, 0]

    @cached_property
    def response(self) -> np.ndarray:
        """Moves of the own effects, (c, m, k + shared), by minus the common ones."""
        return np.asarray(self.root.transpose(0, 2, 1) @ self.crossed[..., :-1])

    @cached_property
    def variance(self) -> np.ndarray:
        """Variance of the own effects, (c, m)."""
        moved = self.response @ self.half
        return np.asarray(np.sum(self.root**2, axis=1) + np.einsum("cmk,cmk->cm", moved, moved))

    @property
    def slope(self) -> np.ndarray:
        """Slope of the loss by log s_k: ``m_k - |u_k / s_k|^2 - tr C_kk``, C the posterior covariance of ``u / s``."""
        model, k = self.model, len(self.common) - len(self.model.shared_groups)
        own, shared = (1 - self.own_effects**2 - self.variance).sum(axis=0), 1 - self.common[k:] ** 2
        left = np.append(own, shared - np.diag(self.covariance)[k:])
        groups = np.append(model.own_groups, model.shared_groups)
        return (self.sizes / model.prior) ** 2 + np.bincount(groups, left, minlength=len(self.sizes))

    def move(self, common: np.ndarray, own: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Estimate quantities (f,), linear in the common (f, .) and the own effects (f, m), with covariance (f, f)."""
        value, slopes = common @ self.common, common.copy()
        added = np.zeros((len(common), len(common)))
        for F, u, B, root in zip(own, self.own_effects, self.response, self.root, strict=True):
            value = value + F @ u
            slopes -= F @ B
            added += (F @ root.T) @ (F @ root.T).T
        return value, slopes @ self.covariance @ slopes.T + added


def posterior(model: MixedModel, log_s: np.ndarray, eliminated: bool = False) -> Posterior:
    """Solve for d and all u at the sizes ``exp(log_s)``; ``eliminated``, without the part of d that acts ``alone``."""
    from scipy.linalg.lapack import dtrtri

    own, crossed, products, determined = model.parts[eliminated]
    sizes, m, count = np.exp(log_s), len(model.own_groups), len(products) - 1
    k = count - len(model.shared_groups)
    scale = np.concatenate([sizes[model.own_groups], np.ones(k), sizes[model.shared_groups], [1.0]])
    own_sizes, border = scale[:m], scale[m:]
    A = own * np.outer(own_sizes, own_sizes)
    A[:, range(m), range(m)] = (A[:, range(m), range(m)] + 1.0) * (1 + ROUNDING)
    L = np.linalg.cholesky(A)
    root = np.array([dtrtri(factor, lower=1)[0] for factor in L])
    V = root @ (crossed * np.outer(own_sizes, border))
    stacked = V.reshape(-1, len(border))
    S = products * np.outer(border, border) - stacked.T @ stacked
    S[range(k, count), range(k, count)] += 1.0
    half, determinant = _inverse_root(S[:count, :count])
    determinant += determined + 2 * float(np.log(np.diagonal(L, axis1=1, axis2=2)).sum())
    covariance = half @ half.T
    common = -covariance @ S[:count, count]
    square = float(S[count, count] + common @ S[:count, count])
    loss = 0.5 * (square + determinant + float(np.sum((sizes / model.prior) ** 2)))
    return Posterior(model, sizes, scale, common, covariance, half, root, V, loss)


def _inverse_root(S: np.ndarray) -> tuple[np.ndarray, float]:
    """Factor the inverse of ``S`` (k, k) as ``H H^T``, and compute the logarithm of its determinant.

    Directions that nothing determines are left out, so that they stay as they are.
    """
    from scipy.linalg.lapack import dtrtri

    scale = 1 / np.sqrt(np.maximum(np.diag(S), 1e-300))
    S = S * scale[:, None] * scale
    try:
        half = dtrtri(np.linalg.cholesky(S), lower=1)[0].T
        kept = np.diag(half) ** -2.0
    except np.linalg.LinAlgError:
        kept = np.zeros(1)
    if kept.min(initial=1.0) < DETERMINED:
        values, vectors = np.linalg.eigh(S)
        kept = values[values > DETERMINED]
        half = vectors[:, values > DETERMINED] / np.sqrt(kept)
    return scale[:, None] * half, float(np.log(kept).sum() - 2 * np.log(scale).sum())


@dataclass(frozen=True, eq=False)
class MixedFit:
    """A model at its most likely sizes ``s``: exp(log_s)."""

    model: MixedModel
    log_s: np.ndarray

    @cached_property
    def at(self) -> Posterior:
        """Posterior of all effects."""
        return posterior(self.model, self.log_s)

    @property
    def sizes(self) -> np.ndarray:
        """Size of each group, in plausible sizes."""
        return np.exp(self.log_s)

    def at_sizes(self, log_s: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Estimate quantities (f,) by ``slopes`` (f, k + shared) at some sizes, with covariance and lost likelihood."""
        at = self.at if np.array_equal(log_s, self.log_s) else posterior(self.model, log_s)
        scaled = slopes * np.concatenate([np.ones(self.model.unknowns), np.exp(log_s)[self.model.shared_groups]])
        return scaled @ at.common, scaled @ at.covariance @ scaled.T, at.loss - self.at.loss

    def averaged(self, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Estimate quantities over the sizes of one effect after the other, each as likely as the data say.

        Before the data any log s within ``BOUNDS`` is as likely; where it is far below the likeliest, it is the least.
        """
        value, covariance, _ = self.at_sizes(self.log_s, slopes)
        mean, variance, step = value.copy(), np.diag(covariance), 1 / np.ptp(BOUNDS)
        prior = np.array([1 - step * len(AROUND)] + [step] * len(AROUND))
        spread, factor = np.zeros_like(covariance), np.ones_like(value)  # of the variances, which stay positive
        for group in np.flatnonzero(self.log_s > BOUNDS[0] + 1):
            tried = np.tile(self.log_s, (len(prior), 1))
            tried[:, group] = np.append(BOUNDS[0], self.log_s[group] + AROUND)
            parts = zip(*(self.at_sizes(log_s, slopes) for log_s in tried), strict=True)
            values, covariances, lost = map(np.array, parts)
            lost[(tried > self.model.largest)[:, group]] = np.inf  # beyond a bound the data may ask for far more
            weights = prior * np.exp(lost.min() - lost)
            mean += np.average(values, 0, weights) - value
            within = np.average(np.diagonal(covariances, axis1=1, axis2=2), 0, weights)
            factor *= np.divide(within, variance, out=np.ones_like(value), where=variance > 0)
            spread += np.cov(values.T, aweights=weights, ddof=0)
        return mean, covariance * np.sqrt(np.outer(factor, factor)) + spread

    def lost_without(self, groups: Sequence[int]) -> float:
        """Compute the log-likelihood that is lost without some groups, the sizes of the others being found again.

        Where ``LITTLE`` is lost with the others as they are, that bound on it.
        """
        log_s = self.log_s.copy()
        log_s[list(groups)] = BOUNDS[0] - 5.0
        if (bound := posterior(self.model, log_s, eliminated=True).loss - self.at.loss) > LITTLE:
            log_s = find_sizes(self.model, self.log_s, groups).log_s
            bound = posterior(self.model, log_s, eliminated=True).loss - self.at.loss
        return bound


def find_sizes(model: MixedModel, start: np.ndarray, without: Sequence[int] = ()) -> MixedFit:
    """Maximise the restricted likelihood over the sizes of all groups, from a ``start``: log s, (groups,)."""
    from scipy.optimize import minimize

    largest = np.broadcast_to(model.largest, start.shape)
    log_s = np.minimum(start, largest)
    log_s[list(without)] = BOUNDS[0] - 5.0
    free = np.setdiff1d(np.arange(len(start)), without)

    def loss(values: np.ndarray) -> tuple[float, np.ndarray]:
        log_s[free] = values
        at = posterior(model, log_s, eliminated=True)
        return at.loss, at.slope[free]

    options = {"maxiter": 60, "ftol": 1e-7, "gtol": 0.02}
    bounds = [(BOUNDS[0], bound) for bound in largest[free]]
    released = np.zeros(len(free), dtype=bool)
    while True:
        if len(free):
            begin = np.maximum(log_s[free], BOUNDS[0])
            log_s[free] = minimize(loss, begin, jac=True, method="L-BFGS-B", bounds=bounds, options=options).x
        # a small size has no slope by its logarithm to grow by, but one by its square
        growth = posterior(model, log_s, eliminated=True).slope[free] * np.exp(2 * (START - log_s[free])) / 2
        anew = (log_s[free] < SMALL) & (growth < -WORTH) & ~released
        if not anew.any():
            return MixedFit(model, log_s)
        released |= anew
        log_s[free[anew]] = LOW


def fit_mixed(model: MixedModel, near: MixedFit | None = None) -> MixedFit:
    """Find sizes of all effects and the noise of all channels in turn, from those ``near`` them if given."""
    log_s = np.full(len(model.prior), START) if near is None else near.log_s
    for _ in range(PASSES):
        found, before = find_sizes(model, log_s), model.noises
        log_s, noise = found.log_s, tuple(map(found.at.noises, range(len(model.rows))))
        model = replace(model, noise=noise)
        change = [abs(np.log(new.std / old.std)) for new, old in zip(chain(*noise), chain(*before), strict=True)]
        if max(change) < SETTLED:
            break
    return MixedFit(model, log_s)
