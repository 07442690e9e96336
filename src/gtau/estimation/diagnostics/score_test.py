"""Score tests for one additional unknown: its size, its significance, and by how much it would move the estimates."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from gtau.estimation.diagnostics.linearisation import LinearisedWindow
from gtau.estimation.estimators.newton import whitening

SPANNED = 1e-6  # of the square of a column: less is left by the other unknowns, so it could be any of them


@dataclass(frozen=True, eq=False)
class ScoreTests:
    """Of each candidate column m in each joint's equations, (m, n); n is 1 for columns that act on all joints.

    Its ``size``, the standard deviation ``std`` of that (infinite where the other unknowns span the column), the
    ``share`` of the residual variance that goes with it, and by how much the other unknowns move for a unit of it,
    ``slopes`` (m, n, k), in the order of :func:`gtau.estimation.estimators.newton.jacobian`.
    """

    size: np.ndarray
    std: np.ndarray
    share: np.ndarray
    slopes: np.ndarray

    @property
    def t(self) -> np.ndarray:
        """Sizes in standard deviations."""
        return np.asarray(self.size / np.maximum(self.std, 1e-300))


def score_tests(
    windows: Callable[[], Iterable[LinearisedWindow]],
    hypotheses: Sequence[tuple[slice, bool]],
    clusters: np.ndarray,
    known: np.ndarray | None = None,
) -> tuple[ScoreTests, ...]:
    """Test each candidate column alone, in each channel's equations alone or shared by all channels.

    All other unknowns adapt to it. Standard deviations follow from the scatter over clusters of windows, within which
    residuals may be correlated (a sandwich estimate).

    Parameters
    ----------
    windows : callable
        Gives the windows anew each time, so that they need not be in memory together.
    hypotheses : sequence of (slice, bool)
        Columns that belong together, and whether each of them acts on all channels with one size.
    clusters : ndarray
        (W,) the number of the cluster that each window belongs to, from 0.
    known : ndarray, optional
        Jacobian (., k) of further equations, of known parameters, with errors of unit variance.

    Returns
    -------
    tuple of ScoreTests
        One for each hypothesis.
    """

    def folded(of_joints: np.ndarray) -> list[np.ndarray]:
        """Sum (m, n, ...) by hypothesis, that of shared columns over the channels, (m, 1, ...)."""
        return [
            of_joints[columns].sum(axis=1, keepdims=True) if shared else of_joints[columns]
            for columns, shared in hypotheses
        ]

    count, joints = int(clusters.max()) + 1, next(iter(windows())).errors.shape[0]
    blocks = []
    for each in windows():
        blocks.append(each.jacobian.reshape(-1, each.jacobian.shape[-1]))
    if known is not None:
        blocks.append(known)
    back = whitening(np.concatenate(blocks), np.zeros(joints))
    J_e, e_e = np.zeros(back.shape[1]), 0.0
    sums = [np.zeros(())] * 3
    for each in windows():
        W, e, c = each.jacobian @ back, each.errors, each.offered  # W has orthonormal columns over all windows
        J_e, e_e = J_e + np.einsum("jpk,jp->k", W, e), e_e + float(np.sum(e**2))
        more = _products(W, c, e)
        sums = [before + now for before, now in zip(sums, more, strict=True)]
    J_c, c_c, c_e = (folded(each) for each in sums)
    left = [squares - np.sum(along**2, axis=2) for squares, along in zip(c_c, J_c, strict=True)]
    spanned = [rest <= SPANNED * np.maximum(squares, 1e-300) for rest, squares in zip(left, c_c, strict=True)]
    left = [np.where(lost, 1.0, rest) for lost, rest in zip(spanned, left, strict=True)]
    size = [
        -np.where(lost, 0.0, (score - along @ J_e) / rest)
        for lost, score, along, rest in zip(spanned, c_e, J_c, left, strict=True)
    ]
    scores = [np.zeros((count, *rest.shape)) for rest in left]
    for cluster, each in zip(clusters, windows(), strict=True):
        W, c = each.jacobian @ back, each.offered
        rest = each.errors - W @ J_e
        # the score of a window: what is left of its column, (m, j) of joint j in all rows i, times its residuals
        W_rest, W_W = np.einsum("ipk,ip->k", W, rest), np.einsum("ipk,ipl->kl", W, W, optimize=True)
        own_W, own_own, own_rest = (folded(part) for part in _products(W, c, rest))
        for k, along in enumerate(J_c):
            score = own_rest[k] - along @ W_rest
            square = own_own[k] + np.sum((along @ W_W - 2 * own_W[k]) * along, axis=2)
            scores[k][cluster] += score + size[k] * square
    least = max(e_e - float(J_e @ J_e), 1e-300)
    return tuple(
        ScoreTests(
            size[k],
            np.where(spanned[k], np.inf, np.sqrt(np.sum(scores[k] ** 2, axis=0) * count / max(count - 1, 1)) / left[k]),
            np.where(spanned[k], 0.0, size[k] ** 2 * left[k] / least),
            -J_c[k] @ back.T,
        )
        for k in range(len(hypotheses))
    )


def _products(W: np.ndarray, c: np.ndarray, e: np.ndarray) -> list[np.ndarray]:
    """Multiply columns (c, p, m) with W (c, p, k), themselves and the residuals (c, p), channel by channel."""
    of_joint = c.swapaxes(1, 2)  # (c, m, p)
    return [
        (of_joint @ W).swapaxes(0, 1),
        np.einsum("jpm,jpm->mj", c, c),
        (of_joint @ e[..., None])[..., 0].T,
    ]
