"""One more unknown at a time: what each would be, how significant, and how much of the errors would go with it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from gtau.estimation.diagnostics.linearisation import LinearisedWindow
from gtau.estimation.estimators.newton import whitening

TOLD = 1e-6  # of the square of what is offered: less is left by the other unknowns, so it could be any of them


@dataclass(frozen=True, eq=False)
class ScoreTests:
    """Of each joint's unknown in each group of pieces, (groups, n).

    Its ``size``, ``t`` in standard deviations, and the ``share`` of the variance of all errors that goes with it.
    """

    size: np.ndarray
    t: np.ndarray
    share: np.ndarray


def score_tests(pieces: Callable[[], Iterable[LinearisedWindow]], members: np.ndarray) -> ScoreTests:
    """Offer each joint the first of the torques ``offered`` in groups of the ``pieces`` (groups, pieces).

    All other unknowns adapt to it. Deviations are found from the pieces, within which errors may hang together.

    Parameters
    ----------
    pieces : callable
        Gives the pieces anew each time, so that they need not be in memory together.
    members : ndarray of bool
        (groups, pieces), which pieces each group has.
    """
    (groups, count), n = members.shape, next(iter(pieces())).errors.shape[0]
    rows = np.concatenate([each.jacobian.reshape(-1, each.jacobian.shape[-1]) for each in pieces()])
    back = whitening(rows, np.zeros(n))

    def whitened() -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        for each in pieces():
            yield each.jacobian @ back, each.errors, each.offered[..., 0]

    # what is offered, c, is of one joint in some of the pieces; J is orthonormal
    J_e, e_e = np.zeros(back.shape[1]), 0.0
    J_c, c_c, c_e = np.zeros((groups, n, back.shape[1])), np.zeros((groups, n)), np.zeros((groups, n))
    for (J, e, c), mine in zip(whitened(), members.T, strict=True):
        J_e, e_e = J_e + np.einsum("jpk,jp->k", J, e), e_e + float(np.sum(e**2))
        J_c[mine] += np.einsum("jpk,jp->jk", J, c)
        c_c[mine] += np.sum(c**2, axis=1)
        c_e[mine] += np.sum(c * e, axis=1)
    left = c_c - np.sum(J_c**2, axis=2)
    told = left > TOLD * np.maximum(c_c, 1e-300)
    left = np.where(told, left, 1.0)
    size = -np.where(told, (c_e - J_c @ J_e) / left, 0.0)
    spread = np.zeros((groups, n))
    for (J, e, c), mine in zip(whitened(), members.T, strict=True):
        own = -np.einsum("ipk,gjk->gjip", J, J_c)  # what the other unknowns leave of it, in the rows of joint i
        own[:, range(n), range(n)] += mine[:, None, None] * c
        rest = e - np.einsum("ipk,k->ip", J, J_e) + size[:, :, None, None] * own
        spread += np.einsum("gjip,gjip->gj", own, rest) ** 2
    deviation = np.sqrt(spread * count / max(count - 1, 1)) / left
    share = size**2 * left / max(e_e - float(J_e @ J_e), 1e-300)
    return ScoreTests(size, np.where(told, size / np.maximum(deviation, 1e-300), 0.0), share)
