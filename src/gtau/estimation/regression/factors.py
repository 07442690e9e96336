"""Triangular factors: a run of any length, reduced to the data that the estimators need.

Each channel's decimated rows ``[W_j  terms_j  known_j  v_j  v_j'  v_j'']`` are reduced by QR to a small triangle, one
for each of the blocks that the jackknife leaves out in turn. Factors of more runs merge by one more QR.

Rows of runs, their factors and the blocks of the problem all end in the same four columns,

    [ model | known | v  v'  v'' ]

behind the columns of the model: of standard parameters and friction terms along a run, of the unknown ``theta`` in the
problem. ``known`` is the known torque added to the model's torque; v is the signal with two time derivatives.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from gtau.estimation.regression.rows import FAST_SAMPLES, Rows, stream_rows
from gtau.estimation.regression.run_blocks import BLOCKS, block_edges, block_of
from gtau.model.inverse_dynamics import InverseDynamics, Regressor
from gtau.robots.parameter import TERMS, Parameter
from gtau.signals.channel import Channel
from gtau.signals.preparation.filters import Decimator
from gtau.signals.preparation.prepared_run import PreparedRun, SampleWindow
from gtau.signals.storage import Store

MODEL, KNOWN, SIGNAL, SIGNALS = slice(None, -4), -4, -3, slice(-3, None)
FIXED = 4  # columns behind the model's
CACHED = 1024  # rows reduced at once: few enough to stay in the cache
ROWS = 512  # merged into triangles at once
EXTRA = len(TERMS) + FIXED  # columns behind the standard parameters'


def delayed(d: float | np.ndarray) -> np.ndarray:
    """Compute the weights of v, v', v'' that make ``v(t - d)``, (..., 3)."""
    return np.stack([np.ones_like(d, dtype=float), -np.asarray(d), np.square(d) / 2], axis=-1)


def delayed_signal(rows: np.ndarray, d: float | np.ndarray) -> np.ndarray:
    """Compute the signal ``v(t - d)`` in rows (..., p, columns), (..., p); ``d`` is one delay or one a channel."""
    return np.asarray(np.einsum("...pk,...k->...p", rows[..., SIGNALS], delayed(d)))


def modelled(rows: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Compute the torques of parameters in rows (..., p, columns), the known part included, (..., p)."""
    return np.asarray(rows[..., MODEL] @ theta + rows[..., KNOWN])


def triangle(*blocks: np.ndarray) -> np.ndarray:
    """Compute the triangular factor R of the stacked ``blocks`` (., c), ``R^T R = A^T A``; of factors too."""
    stacked = blocks[0] if len(blocks) == 1 else np.concatenate(blocks)
    height = max(CACHED, 4 * stacked.shape[1])
    R = np.linalg.qr(stacked[:height], mode="r")
    for start in range(height, len(stacked), height):
        R = np.linalg.qr(np.concatenate([R, stacked[start : start + height]]), mode="r")
    return np.asarray(R)


def select_columns(R: np.ndarray, columns: Sequence[int]) -> np.ndarray:
    """Compute the triangular factor of some ``columns``, in order, of the rows with the triangular factor ``R``."""
    same = next((k for k, column in enumerate(columns) if column != k), len(columns))  # triangular as they are
    rest = triangle(R[same:, columns[same:]])
    T = np.zeros((len(R[:same]) + len(rest), len(columns)))
    T[:same], T[same:, same:] = R[:same, columns], rest
    return T


def leave_one_out(factors: list[np.ndarray]) -> list[np.ndarray]:
    """Merge all but each one of the triangular ``factors``, each (., c), by running merges."""
    empty = np.zeros((0, factors[0].shape[1]))

    def running(parts: list[np.ndarray]) -> list[np.ndarray]:
        merged = [empty]
        for part in parts[:-1]:
            merged.append(triangle(merged[-1], part))
        return merged

    ahead, behind = running(factors), running(factors[::-1])[::-1]
    return [triangle(a, b) for a, b in zip(ahead, behind, strict=True)]


@dataclass(frozen=True, eq=False)
class Factors:
    """A run, reduced.

    ``R`` (blocks, c, p, p) are triangles of ``[W_j terms_j known_j v_j v_j' v_j'']``, p = columns + 6, of the joints
    and then of the torque sensors: these have the regressor's row of their joint, and no further friction. Known is
    minus the contribution of measured wrenches to the torque of the joint. ``rows`` (blocks, c) count those behind
    each. Of logs only, ``distances`` (K, 2) are those to singularities of type 1 and 2 at the decimated samples, in
    single precision, and ``speeds`` (blocks, n) the largest of each actuated joint among its rows, rad/s or m/s.
    ``residuals`` (K, c) are the residuals of weighted runs, before weighting, NaN where the row is not kept; (0, c) of
    others.
    """

    R: np.ndarray
    rows: np.ndarray
    distances: np.ndarray | None = None
    residuals: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))
    speeds: np.ndarray | None = None

    @cached_property
    def merged(self) -> tuple[np.ndarray, ...]:
        """Triangles of all blocks together, one a channel, (., p)."""
        return tuple(triangle(*self.R[:, j]) for j in range(self.R.shape[1]))


def channel_rows(regressor: Regressor, channels: Sequence[Channel], part: Rows) -> np.ndarray:
    """Build the rows ``[W_j terms_j known_j v_j v_j' v_j'']`` (c, K, p) of ``channels``."""
    joints = [channel.row for channel in channels]
    n, width = part.terms.shape[1], len(regressor.names)
    A = np.zeros((len(joints), len(part.time), width + EXTRA))
    A[regressor.rows, :, regressor.columns] = part.entries
    A[n:, :, :width] = A[joints[n:], :, :width]
    A[:n, :, width : width + len(TERMS)] = part.terms.transpose(1, 2, 0)
    A[:, :, KNOWN] = -part.external[joints]
    A[:, :, SIGNALS] = part.currents.transpose(1, 2, 0)
    return A


class Triangles:
    """Triangular factors of equations, by block and channel; ``columns`` of each channel are not zero."""

    def __init__(self, columns: Sequence[np.ndarray]) -> None:
        self._columns = columns
        self.rows = np.zeros((BLOCKS, len(columns)), dtype=int)
        self._factors = [[np.zeros((0, places.size)) for places in columns] for _ in range(BLOCKS)]
        self._waiting: defaultdict[tuple[int, int], list[np.ndarray]] = defaultdict(list)  # of a block and channel
        self._held = 0

    def add(self, A: np.ndarray, keep: np.ndarray, block: np.ndarray) -> None:
        """Add the equations (c, K, p) to keep, (c, K); ``block`` (K,) says to which each belongs."""
        for s in range(block[0], block[-1] + 1):
            for j, columns in enumerate(self._columns):
                kept = A[j, (block == s) & keep[j]]
                if len(kept):
                    self._waiting[s, j].append(kept[:, columns])
                    self.rows[s, j] += len(kept)
        self._held += len(block)
        if self._held >= ROWS:
            self.merged()

    def merged(self) -> list[list[np.ndarray]]:
        """Return the factors of all equations so far, by block and channel."""
        for (s, j), more in self._waiting.items():
            self._factors[s][j] = triangle(self._factors[s][j], *more)
        self._waiting.clear()
        self._held = 0
        return self._factors

    def factors(self, p: int) -> np.ndarray:
        """Return the factors in ``p`` columns, (blocks, c, p, p): rows still begin at the diagonal or right of it."""
        R = np.zeros((BLOCKS, len(self._columns), p, p))
        for s, block_triangles in enumerate(self.merged()):
            for j, small in enumerate(block_triangles):
                R[s, j, : len(small), self._columns[j]] = small.T
        return R


def add_products(G: np.ndarray, rows: np.ndarray, block: np.ndarray) -> None:
    """Add the products of ``rows`` (K, p) to their blocks' products G (blocks, p, p); ``block`` (K,) are numbers."""
    for b in np.unique(block):
        part = rows[block == b]
        G[b] += part.T @ part


def reduce_rows(
    idm: InverseDynamics,
    columns: tuple[Parameter, ...],
    channels: Sequence[Channel],
    rows: Iterable[Rows],
    blocks: np.ndarray,
    weigh: tuple[np.ndarray, np.ndarray] | None = None,
) -> Factors:
    """Reduce the rows of a run to its triangular factors over the standard ``columns``; ``blocks`` (K,) number them.

    With ``weigh``, coefficients (c, p) and limits (c,), rows have the weights ``min(1, limit / |residual|)`` in the sum
    of squares; the product of a row and the coefficients of its channel is its residual.
    """
    regressor = idm.columns(columns)
    channels = [channel for channel in channels if channel.kind.modelled]
    c, p, n = len(channels), len(columns) + EXTRA, len(idm.actuated)
    entries = (regressor.columns[regressor.rows == channel.row] for channel in channels)
    places = [np.append(np.unique(columns), np.arange(p - EXTRA, p)) for columns in entries]
    collected = Triangles(places)
    residuals = Store((c,))
    speeds = np.zeros((BLOCKS, n))
    for part in rows:
        block = blocks[part.outputs]
        A = channel_rows(regressor, channels, part)
        if weigh is not None:
            coefficients, limit = weigh
            e = np.einsum("jkp,jp->jk", A, coefficients)
            residuals.append(np.where(part.keep, e, np.nan).T)
            A *= np.sqrt(np.minimum(1.0, limit[:, None] / np.maximum(np.abs(e), 1e-300)))[:, :, None]
        np.maximum.at(speeds, block, (np.abs(part.motion.yd[idm.layout.actuated]) * part.keep[:n]).T)
        collected.add(A, part.keep, block)
    return Factors(collected.factors(p), collected.rows, residuals=residuals.array(), speeds=speeds)


def reduce_run(
    idm: InverseDynamics,
    columns: tuple[Parameter, ...],
    prepared: PreparedRun | SampleWindow,
    decimator: Decimator,
    fast: int = FAST_SAMPLES,
) -> Factors:
    """Reduce a prepared run by itself, streamed in blocks of ``fast`` samples; raises GtauError."""
    rows = stream_rows(idm, idm.columns(columns), prepared, decimator, fast=fast)
    blocks = block_of(block_edges(prepared), decimator.outputs(len(prepared)))
    return reduce_rows(idm, columns, prepared.run.channels, rows, blocks)
