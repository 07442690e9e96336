"""Score tests for one additional unknown: its size, its significance, and by how much it would move the estimates."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
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

    def of(self, columns: slice) -> ScoreTests:
        """The tests of some columns."""
        return ScoreTests(self.size[columns], self.std[columns], self.share[columns], self.slopes[columns])


def score_tests(
    windows: Callable[[], Iterable[LinearisedWindow]], shared: bool = False, known: np.ndarray | None = None
) -> ScoreTests:
    """Test each candidate column alone, in each channel's equations alone or ``shared`` by all channels.

    All other unknowns adapt to it. Standard deviations follow from the scatter over the windows, within which
    residuals may be autocorrelated (a sandwich estimate with windows as clusters).

    Parameters
    ----------
    windows : callable
        Gives the windows anew each time, so that they need not be in memory together.
    shared : bool
        Whether a column acts on all channels with one size.
    known : ndarray, optional
        Jacobian (., k) of further equations, of known parameters, with errors of unit variance.
    """

    def each() -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        for window in windows():
            J, e, c = window.jacobian, window.errors, window.offered
            if shared:
                J, e, c = J.reshape(1, -1, J.shape[-1]), e.reshape(1, -1), c.reshape(1, -1, c.shape[-1])
            yield J, e, c

    count, joints = 0, next(iter(windows())).errors.shape[0]
    blocks = []
    for J, _, _ in each():
        blocks.append(J.reshape(-1, J.shape[-1]))
        count += 1
    if known is not None:
        blocks.append(known)
    back = whitening(np.concatenate(blocks), np.zeros(joints))
    J_e, e_e = np.zeros(back.shape[1]), 0.0
    J_c, c_c, c_e = (np.zeros(()) for _ in range(3))
    for J, e, c in each():
        W = J @ back  # orthonormal columns over all windows
        J_e, e_e = J_e + np.einsum("jpk,jp->k", W, e), e_e + float(np.sum(e**2))
        J_c = J_c + np.einsum("jpk,jpm->mjk", W, c)
        c_c = c_c + np.einsum("jpm,jpm->mj", c, c)
        c_e = c_e + np.einsum("jpm,jp->mj", c, e)
    left = c_c - np.sum(J_c**2, axis=2)
    spanned = left <= SPANNED * np.maximum(c_c, 1e-300)
    left = np.where(spanned, 1.0, left)
    size = -np.where(spanned, 0.0, (c_e - J_c @ J_e) / left)
    scatter = np.zeros(left.shape)
    for J, e, c in each():
        W = J @ back
        rest = e - np.einsum("jpk,k->jp", W, J_e)
        # the score of a window: what is left of its column, (m, j) of joint j in all rows i, times its residuals
        W_rest, W_W = np.einsum("ipk,ip->k", W, rest), np.einsum("ipk,ipl->kl", W, W)
        own_rest = np.einsum("jpm,jp->mj", c, rest)
        own_W = np.einsum("jpm,jpk->mjk", c, W)
        own_own = np.einsum("jpm,jpm->mj", c, c)
        score = own_rest - J_c @ W_rest
        square = own_own - 2 * np.sum(own_W * J_c, axis=2) + np.einsum("mjk,kl,mjl->mj", J_c, W_W, J_c)
        scatter += (score + size * square) ** 2
    std = np.where(spanned, np.inf, np.sqrt(scatter * count / max(count - 1, 1)) / left)
    share = np.where(spanned, 0.0, size**2 * left / max(e_e - float(J_e @ J_e), 1e-300))
    return ScoreTests(size, std, share, -J_c @ back.T)
