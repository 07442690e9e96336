"""Sequential detection of a change of each chart, with a stated time between false alarms.

A chart is a quantity from log to log, ``x = mu + sigma u`` with unknown mu and sigma. Healthy days correlate, nobody
knows how much: u is a Gaussian autoregression of correlation rho from log to log beside white noise, whose share of the
variance is c and whose variance in a log is ``w`` relative to the median log (by the block jackknife). ``GRID``
lists the pairs (rho, c). From log j on the mean may have moved by ``delta sigma``, ``delta`` being Gaussian of standard
deviation ``KAPPA``. With the right Haar priors on mu and sigma the density of the logs at a node g of the grid is

    p_0g = |V|^(-1/2) (h' V^-1 h)^(-1/2) S0^(-(n - 1) / 2),
    p_jg = p_0g (1 + r k^2)^(-1/2) [S0 / (S0 - b^2 r k^2 / (1 + r k^2))]^((n - 1) / 2)

without a change and with one at j, where S0 are the squares about the mean, b^2 r those that the step explains and r
its information. By universal inference (Wasserman, Ramdas and Balakrishnan, PNAS 117, 2020)

    E_j = mean_g p_jg / max_g p_0g

has at most the expectation 1 at whichever node the truth is, as the denominator is at least the true density. The sum
over all j is an e-detector of the kind Shiryaev-Roberts (Shin, Ramdas and Rinaldo, arXiv:2203.03532). Each chart is
compared with its own limit, the number of charts times the robot's limit: no filtration is shared, so that no adjuster
between filtrations is needed, and by the union bound the robot's alarms are no more frequent than stated.

Two guards only delay alarms: the last two logs must both be nearer to the changed mean than to the healthy one
(``confirmed``), and a log that is far off alone (``isolated``) counts as missing until the next one confirms it.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp, stdtrit

FEWEST = 4  # logs of a baseline: mean, scale and two degrees of freedom
GRID = ((0.0, 1.0), *product((0.5, 0.8, 0.9, 0.95, 0.98), (0.0, 0.4, 0.8)))
KAPPA = 4.0  # standard deviation of a change, in those between logs
WINDOW = 400  # last logs that are compared
RARE = 1e-6  # probability beyond which a log is far off, by Student's t


class ChangeEvidence(NamedTuple):
    """For each of k charts: logarithm of the e-detector, likeliest first log of a change, and the first guard."""

    log_e: np.ndarray
    start: np.ndarray
    confirmed: np.ndarray


def evidence(
    values: np.ndarray, variances: np.ndarray, learning: int, rising: np.ndarray | None = None
) -> ChangeEvidence:
    """Compute the e-detectors of charts; see the head of this module.

    There is at least one log. ``values`` (n, k) are NaN where a log does not show a chart; ``variances`` (n, k) come
    from the jackknife. No change begins before ``learning`` logs of a chart. Only growth counts for ``rising`` (k,)
    charts, such as residuals.
    """
    x = np.where(isolated(values), np.nan, values)
    shown, mean = np.isfinite(x), mean_of(x)
    y = np.where(shown, x - mean, 0.0)
    scale = np.sqrt(mean_of(np.where(shown, y**2, np.nan)))
    moving = scale > 1e-12 * np.abs(mean)
    known = np.where(shown & (variances > 0), variances, np.nan)
    w = np.fmax(known / median(known), 1.0)  # relative to the median log; a quieter one counts as that
    log_p0, ratios, up = _densities(y / np.where(moving, scale, 1.0), w, shown)
    if rising is not None:  # omitting decreases makes the sum smaller, so the bound still holds
        ratios = np.where(up | ~rising, ratios, -np.inf)
    ratios = logsumexp(ratios + log_p0, axis=1) - np.log(len(GRID)) - log_p0.max(axis=0)  # (n, k)
    begins = shown & (np.cumsum(shown, axis=0) > learning) & moving & (shown.sum(axis=0) >= FEWEST)
    ratios = np.where(begins, ratios, -np.inf)
    start = np.argmax(ratios, axis=0)
    after = np.arange(len(x))[:, None] >= start
    healthy, changed = (mean_of(np.where(part, x, np.nan)) for part in (~after, after))
    position = (x - healthy) / np.where(changed != healthy, changed - healthy, np.inf)
    newest = shown & (np.cumsum(shown[::-1], axis=0)[::-1] <= 2)
    confirmed = (newest & after & (position > 0.5)).sum(axis=0) == 2
    return ChangeEvidence(logsumexp(ratios, axis=0), start, confirmed)


def isolated(values: np.ndarray) -> np.ndarray:
    """Find values (n, k) that are far off, while the logs before and after are not far off on the same side."""
    return alone(np.where(far_off(values), np.sign(values - median(values)), 0.0))


def far_off(values: np.ndarray) -> np.ndarray:
    """Find values (n, k) that are further from the median than scatter explains."""
    distance = np.abs(values - median(values))
    count = np.isfinite(values).sum(axis=0)
    far = distance > stdtrit(np.maximum(count - 1, 1), 1 - RARE) * 1.4826 * median(distance)
    return np.asarray(far & (count >= FEWEST))


def alone(side: np.ndarray) -> np.ndarray:
    """Find the logs (n, k) whose ``side`` (-1, 0 or 1) is not 0 and differs from the logs before and after."""
    padded = np.pad(side, ((1, 1), (0, 0)))
    return np.asarray((side != 0) & (side != padded[:-2]) & (side != padded[2:]))


def median(values: np.ndarray) -> np.ndarray:
    """Compute the median (k,) of values (n, k) without NaN; NaN where there is none."""
    return np.ma.filled(np.ma.median(np.ma.masked_invalid(values), axis=0), np.nan)


def _densities(y: np.ndarray, w: np.ndarray, shown: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute log p_0 (g, k), log p_j / p_0 (n, g, k), and whether the step at j goes up.

    A Kalman filter whitens values and constant; the step at j is the constant behind it, to whose innovations the
    prediction ``a`` from the constant before it is added, decaying as the filter forgets.
    """
    n, k = y.shape
    rho, c = (np.array(part)[:, None] for part in zip(*GRID, strict=True))
    a, state, log_det = (np.zeros((len(GRID), k)) for _ in range(3))
    P = np.repeat(1.0 - c, k, axis=1)
    ones, scores, precision, decay, predicted = (np.zeros((n, len(GRID), k)) for _ in range(5))
    for t in range(n):
        F = P + c * w[t]
        gain = np.where(shown[t], P / F, 0.0)
        predicted[t], ones[t], scores[t], precision[t] = a, 1.0 - a, y[t] - state, shown[t] / F
        log_det += np.where(shown[t], np.log(F), 0.0)
        a, state = rho * (a + gain * ones[t]), rho * (state + gain * scores[t])
        decay[t] = rho * (1 - gain)
        P = rho**2 * P * (1 - gain) + (1 - rho**2) * (1 - c)
    hh, hy = (np.cumsum((ones * part * precision)[::-1], axis=0)[::-1] for part in (ones, scores))  # from each log on
    information = np.maximum(hh[0], 1e-300)
    r, b, B, C, E = np.zeros_like(ones), np.zeros_like(ones), *np.zeros((3, len(GRID), k))
    for t in reversed(range(n)):
        a = predicted[t]
        B = ones[t] * precision[t] + decay[t] * B
        C = precision[t] + decay[t] ** 2 * C
        E = scores[t] * precision[t] + decay[t] * E
        ch = hh[t] + a * B
        r[t] = np.maximum(ch + a * B + a**2 * C - ch**2 / information, 0.0)
        b[t] = hy[t] + a * E - ch * hy[0] / information
    freedom = np.maximum(shown.sum(axis=0) - 1, 1)
    S0 = np.maximum((scores**2 * precision).sum(axis=0) - hy[0] ** 2 / information, 1e-12)
    explained = b**2 * KAPPA**2 / (1 + r * KAPPA**2)
    ratios = -0.5 * np.log1p(r * KAPPA**2) - freedom / 2 * np.log1p(-np.minimum(explained / S0, 1 - 1e-12))
    log_p0 = -0.5 * (log_det + np.log(information) + freedom * np.log(S0))
    return log_p0, ratios, b > 0


def mean_of(x: np.ndarray) -> np.ndarray:
    """Compute the mean (k,) of logs (n, k) without NaN; NaN where there is none."""
    count = np.isfinite(x).sum(axis=0)
    return np.asarray(np.nansum(x, axis=0) / np.where(count > 0, count, np.nan))
