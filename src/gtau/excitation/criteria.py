"""What is made small: functions of the information matrix, or of the regressor's Gram matrix, with derivatives.

They work on triangular factors, R^T R = M: the matrices themselves would cost half the digits.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from difflib import get_close_matches

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.regression.triangle import triangle
from gtau.excitation.information import DesignUnknowns

Criterion = Callable[[np.ndarray], tuple[float, np.ndarray, np.ndarray]]
"""From the factor R of M to the criterion's logarithm, and F (P, k), f (k,): its derivative by M is F diag(f) F^T."""

NAMED = ("gains", "condition", "logdet", "trace")


def criterion(name: str, unknowns: DesignUnknowns) -> Criterion:
    """Look up the criterion called ``name``.

    ``gains``: rms of the relative standard deviations of the drive gains; ``logdet`` (D-optimal): geometric mean of all
    deviations; ``trace`` (A-optimal): rms of all relative deviations; ``condition``: condition number of the base
    regressor, as in the paper; or names of unknowns, separated by commas (``gain_11,m_PR``): rms of their relative
    deviations. A deviation is relative to the prior value, or to a typical one where that is zero.

    Raises
    ------
    GtauError
        Where a name is neither a criterion nor an unknown.
    """
    estimated = np.array([not each.startswith("delay_") and "@" not in each for each in unknowns.names])
    if name == "condition":
        return condition
    if name == "logdet":
        return lambda R: logdet(R, unknowns.precision)
    if name == "trace":
        chosen = estimated
    elif name == "gains":
        chosen = np.array([each.startswith("gain_") for each in unknowns.names])
    else:
        wanted = [each.strip() for each in name.split(",")]
        for each in wanted:
            if each not in unknowns.names:
                known = [*NAMED, *np.array(unknowns.names)[estimated].tolist()]
                close = get_close_matches(each, known, n=1)
                names = f"names of gains and base parameters such as {known[-1]} or {known[len(NAMED)]}"
                advice = f"did you mean '{close[0]}'?" if close else f"choose {', '.join(NAMED)}, or {names}."
                raise GtauError(f"there is no criterion or parameter '{each}'; {advice}")
        chosen = np.isin(unknowns.names, wanted)
    weight = chosen / unknowns.scale**2 / chosen.sum()
    return lambda R: weighted_trace(R, unknowns.precision, weight)


def root_covariance(R: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """Compute ``H`` (P, P) with ``H H^T`` the covariance, from the information's factor and the prior's precision."""
    stacked = np.concatenate([R, np.diag(np.sqrt(precision))])
    size = np.linalg.norm(stacked, axis=0)
    return np.asarray(np.linalg.inv(triangle(stacked / size)) / size[:, None])


def weighted_trace(R: np.ndarray, precision: np.ndarray, weight: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Evaluate ``log sqrt(sum(weight * diag(C)))``, C the covariance."""
    H = root_covariance(R, precision)
    chosen = np.flatnonzero(weight)
    mean = float(weight @ np.sum(H**2, axis=1))
    return np.log(mean) / 2, H @ H[chosen].T, -weight[chosen] / (2 * mean)


def logdet(R: np.ndarray, precision: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Evaluate ``log det(C)^(1 / 2P)``, C the covariance."""
    H = root_covariance(R, precision)
    P = len(precision)
    return float(np.linalg.slogdet(H)[1] / P), H, np.full(P, -1 / (2 * P))


def condition(R: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Evaluate the logarithm of the condition number of a matrix with the factor R."""
    _, s, Vt = np.linalg.svd(R)
    s = np.maximum(s, 1e-300)
    ends = [0, len(s) - 1]
    return float(np.log(s[0] / s[-1])), Vt[ends].T, np.array([0.5, -0.5]) / s[ends] ** 2


def relative_deviations(R: np.ndarray, unknowns: DesignUnknowns, names: Sequence[str]) -> np.ndarray:
    """Compute relative standard deviations of the unknowns ``names`` from the factor of the information."""
    index = [unknowns.names.index(name) for name in names]
    deviations = np.linalg.norm(root_covariance(R, unknowns.precision), axis=1)
    return np.asarray((deviations / unknowns.scale)[index])
