"""Sequential detection of a change of one chart, with a stated time between false alarms.

A chart is a quantity from log to log, ``x_i = mu + sigma sqrt(w_i) u_i``, with unknown mu and sigma; ``w_i``
is the relative variance due to the motion of log i, and u is Gaussian with the correlation ``memory``
between one log and the next, as friction follows the weather. From log j on the mean may have moved by ``delta sigma``.
For each j the likelihood ratio of all logs so far, with the scale-invariant priors on mu and sigma (the right Haar
measure) and ``delta`` Gaussian with the standard deviation ``KAPPA``, has a closed form (the Bayes factor of the t-test
of Goenen et al., The American Statistician 59, 2005):

    Lambda_j = (1 + r k^2)^(-1/2) [S0 / (S0 - b^2 r k^2 / (1 + r k^2))]^((n - 1) / 2),

with S0 the squares about the mean, b^2 those that the step at j explains and r its information. Its distribution
without a change depends neither on mu nor on sigma, so Lambda_j is a martingale that begins with 1 at log j: an
e-process that is valid for a baseline of few logs, whose mean and scale are not known. Their sum over all j is an
e-detector of the kind Shiryaev-Roberts (Shin, Ramdas and Rinaldo, E-detectors, arXiv:2203.03532, definition 2.2):
``E[M_T] <= E[T]`` for every stopping time T, so that an alarm at ``M >= A`` comes after at least A logs on average, and
so does one of the mean of several charts' detectors, however these depend on each other.

A classic CUSUM accompanies it, of the normal scores of recursive residuals, which are independent and standard normal
without a change (Quesenberry, Journal of Quality Technology 23, 1991), with the limit by Siegmund's formula.

Healthy days differ by more than the interval of one day's log, so the bands of a chart come from the scatter between
the logs of its baseline.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import ndtri, stdtr

FEWEST = 4  # logs of a baseline: mean, scale and two degrees of freedom
MEMORY = 0.7  # correlation from log to log of a healthy robot; a smaller one makes alarms rarer
OF_FRICTION = 0.9  # the same for friction and residuals, which follow weather and seasons
KAPPA = 4.0  # standard deviation of a change, in those between logs
WINDOW = 400  # logs at which a change may have begun; older ones are condensed
REFERENCE = 0.5  # of the CUSUM, in standard deviations: half the change that it finds soonest
OVERSHOOT = 1.166  # 2 * 0.583, by which Siegmund's formula allows for discrete time


@dataclass(frozen=True, eq=False)
class Baseline:
    """Healthy logs: ``mean`` and ``std`` (k,) between logs, of ``count`` (k,) each; NaN where there are too few."""

    mean: np.ndarray
    std: np.ndarray
    count: np.ndarray

    def bands(self, probability: float = 0.95) -> tuple[np.ndarray, np.ndarray]:
        """Compute the prediction interval of one more healthy log at this probability, (k,) each, by Student's t."""
        from scipy.stats import t

        factor = t.ppf((1 + probability) / 2, np.maximum(self.count - 1, 1))
        half = factor * np.sqrt(1 + 1 / np.maximum(self.count, 1)) * self.std
        return self.mean - half, self.mean + half


def baseline_of(values: np.ndarray) -> Baseline:
    """Compute the baseline of healthy logs, ``values`` (logs, k), NaN where a chart is not observable in a log."""
    there = np.isfinite(values)
    count = there.sum(axis=0)
    filled = np.where(there, values, 0.0)
    mean = filled.sum(axis=0) / np.maximum(count, 1)
    squares = np.sum(np.where(there, values - mean, 0.0) ** 2, axis=0)
    std = np.sqrt(squares / np.maximum(count - 1, 1))
    return Baseline(np.where(count > 0, mean, np.nan), np.where(count > 1, std, np.nan), count)


@dataclass(frozen=True, eq=False)
class Chart:
    """A chart: its last logs, and sums over those before them.

    ``x`` and ``w`` (m,) are values and relative variances of the last logs, after ``count`` others with the ``sums`` of
    products of whitened constants h and values y, hh, hy and yy; ``before`` are value and weight of the last of these.
    ``cusum`` are the upper and the lower sum, and ``learning`` how many of the first logs are the baseline. Of a chart
    that is ``rising`` only growth counts: a decreasing residual is not a fault. ``memory`` is the
    correlation from log to log of a healthy robot.
    """

    learning: int
    rising: bool = False
    memory: float = MEMORY
    x: np.ndarray = field(default_factory=lambda: np.zeros(0))
    w: np.ndarray = field(default_factory=lambda: np.zeros(0))
    count: int = 0
    sums: tuple[float, float, float] = (0.0, 0.0, 0.0)
    before: tuple[float, float] | None = None
    cusum: tuple[float, float] = (0.0, 0.0)

    @property
    def total(self) -> int:
        """Number of logs."""
        return self.count + len(self.x)

    def summed(self, h: np.ndarray, y: np.ndarray) -> tuple[float, float, float]:
        """Add the products of further whitened constants and values (m,) to the sums."""
        hh, hy, yy = self.sums
        return hh + float(h @ h), hy + float(h @ y), yy + float(y @ y)


@dataclass(frozen=True)
class Evidence:
    """Logarithm of a chart's e-detector, and the likeliest first log of the change with its interval."""

    log_e: float = -np.inf
    start: int | None = None
    earliest: int | None = None
    latest: int | None = None


def add(chart: Chart, x: float, weight: float = 1.0) -> Chart:
    """Add a log to a chart."""
    added = replace(chart, x=np.append(chart.x, x), w=np.append(chart.w, weight))
    if added.total > max(chart.learning, 2):
        h, y = _whitened(added)
        hh, hy, yy = chart.summed(h[:-1], y[:-1])
        freedom = added.total - 2
        scale = np.sqrt(max((yy - hy**2 / hh) / freedom, 1e-300) * (1 + h[-1] ** 2 / hh))
        score = float(np.clip(ndtri(stdtr(freedom, (y[-1] - h[-1] * hy / hh) / scale)), -8.0, 8.0))
        up, down = chart.cusum
        down = 0.0 if chart.rising else max(down - score - REFERENCE, 0.0)
        added = replace(added, cusum=(max(up + score - REFERENCE, 0.0), down))
    return _condensed(added) if len(added.x) > max(WINDOW, chart.learning) + WINDOW // 4 else added


def evidence(chart: Chart) -> Evidence:
    """Compute the e-detector of a chart; see the head of this module."""
    first = max(chart.learning - chart.count, 0)
    n, m = chart.total, len(chart.x)
    if m <= first or n < 4:
        return Evidence()
    h, y = _whitened(chart)
    hh, hy, yy = chart.summed(h, y)
    S0 = yy - hy**2 / hh
    if 1e-12 * yy >= S0 or S0 <= 0:
        return Evidence()  # a chart that never moves has no scale
    # a step at j is the constant's own column from j + 1 on, and the whole of it, unlagged, at j
    begin = 1 / np.sqrt(chart.w * (1 - chart.memory**2))
    begin[0] = begin[0] if chart.count else h[0]

    def from_each(product: np.ndarray, first_term: np.ndarray) -> np.ndarray:
        after = np.append(np.cumsum(product[::-1])[::-1][1:], 0.0)
        return np.asarray(first_term + after)

    cc, ch, cy = from_each(h * h, begin**2), from_each(h * h, begin * h), from_each(h * y, begin * y)
    r = np.maximum(cc - ch**2 / hh, 0.0)[first:]
    b2 = np.divide((cy - ch * hy / hh)[first:] ** 2, r, out=np.zeros_like(r), where=r > 0)
    shrink = r * KAPPA**2 / (1 + r * KAPPA**2)
    unexplained = np.maximum(S0 - b2 * shrink, 1e-12 * S0)
    ratios = -0.5 * np.log1p(r * KAPPA**2) + (n - 1) / 2 * np.log(S0 / unexplained)
    if chart.rising:  # omitting decreases makes the sum smaller, so the bound still holds
        ratios = np.where((cy - ch * hy / hh)[first:] > 0, ratios, -np.inf)
    top = float(ratios.max())
    if not np.isfinite(top):
        return Evidence()
    shares = np.exp(ratios - top)
    along = np.cumsum(shares) / shares.sum()
    offset = chart.count + first
    return Evidence(
        top + float(np.log(shares.sum())),
        offset + int(np.argmax(ratios)),
        offset + int(np.searchsorted(along, 0.025)),
        offset + min(int(np.searchsorted(along, 0.975)), len(along) - 1),
    )


def combined(log_e: np.ndarray) -> float:
    """Take the logarithm of the mean of several charts' e-detectors (k,), which is one itself."""
    if not len(log_e) or not np.isfinite(log_e).any():
        return -np.inf
    top = float(np.max(log_e))
    return top + float(np.log(np.mean(np.exp(log_e - top))))


def run_length(limit: float, shift: float = 0.0) -> float:
    """Compute the average run length of a one-sided CUSUM of normal scores of mean ``shift``, by Siegmund's formula."""
    drift, height = shift - REFERENCE, limit + OVERSHOOT
    if abs(drift) < 1e-9:
        return height**2
    return float((np.exp(-2 * drift * height) + 2 * drift * height - 1) / (2 * drift**2))


def cusum_limit(logs: float) -> float:
    """Find the limit of a two-sided CUSUM for a given average number of logs between false alarms."""
    from scipy.optimize import brentq

    return float(brentq(lambda limit: run_length(limit) / 2 - logs, 0.0, 60.0))


def _whitened(chart: Chart) -> tuple[np.ndarray, np.ndarray]:
    """Compute constants h and values y (m,) of the last logs with independent errors of equal variance."""
    before, weights, memory = chart.before, 1 / np.sqrt(chart.w), chart.memory
    rows = np.stack([weights, chart.x * weights])
    last = np.array([[1.0], [before[0]]]) / np.sqrt(before[1]) if before else np.zeros((2, 1))
    h, y = (rows - memory * np.hstack([last, rows[:, :-1]])) / np.sqrt(1 - memory**2)
    if before is None:
        h[0], y[0] = rows[:, 0]
    return h, y


def _condensed(chart: Chart) -> Chart:
    """Condense all but the last logs into the sums."""
    h, y = _whitened(chart)
    old = len(chart.x) - WINDOW
    h, y = h[:old], y[:old]
    return replace(
        chart,
        x=chart.x[old:],
        w=chart.w[old:],
        count=chart.count + old,
        sums=chart.summed(h, y),
        before=(float(chart.x[old - 1]), float(chart.w[old - 1])),
    )
