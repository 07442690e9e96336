"""Linearised residuals of a fit, and what further unknowns explain of them: the engine of all effects.

Residuals are linearised along windows of the runs, or in the jackknife's blocks, beside candidate columns that the
model lacks. Columns are fitted together with all unknowns, or each is tested alone by a score test, which gives its
size, its significance, and by how much it would move the estimates.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.newton import jacobian, jacobian_of_known, residuals, to_gains, whitening
from gtau.estimation.regression.factors import EXTRA, channel_rows, triangle
from gtau.estimation.regression.rows import Rows, configurations, instants, stream_rows
from gtau.estimation.regression.run_blocks import Windows, window_clusters
from gtau.model.inverse_dynamics import InverseDynamics, Regressor
from gtau.model.loops import Motion
from gtau.robots.parameter import BY_LOAD
from gtau.signals.preparation.filters import Decimator
from gtau.signals.preparation.prepared_run import SampleWindow

RANK = 1e-6  # of the largest singular value: directions below it are left out
SPANNED = 1e-6  # of the square of a column: less is left by the other unknowns, so it could be any of them

Torques = Callable[[Rows], np.ndarray]
"""Gives torques (n, K, m), or (c, K, m) of all channels, in N m or N at each block of a window's rows, in order."""


@dataclass(frozen=True, eq=False)
class FitWindow:
    """A ``window`` of a ``run`` (its number), along which effects add what the model of a ``fit`` lacks."""

    fit: Fit
    run: int
    window: SampleWindow

    @cached_property
    def motion(self) -> Motion:
        """The motion along the window; raises GtauError at a singularity."""
        return window_motion(self.fit.dataset.model, self.window)

    @cached_property
    def values(self) -> np.ndarray:
        """Values of the base columns in the run, (n_b,)."""
        return self.fit.system.motion(self.run, self.fit.solution.theta)

    @property
    def regressor(self) -> Regressor:
        """Regressor of the base columns."""
        return self.fit.dataset.model.columns(self.fit.dataset.base.standard)

    @property
    def decimator(self) -> Decimator:
        """Decimator of the run."""
        return self.fit.dataset.preparation.at(self.window.run.rate).decimator

    def torques_along(self, motion: Motion, values: np.ndarray) -> np.ndarray:
        """Compute the torques (n, N) of the base columns with some values along a motion."""
        return self.regressor.torques_along(self.fit.dataset.model.layout, motion, values)

    def torques(self, rows: Rows) -> np.ndarray:
        """Compute the model's torques (n, K) at rows of the window."""
        return self.regressor.torques(rows.entries, self.values, len(self.fit.gains))

    def along_run(self, time: np.ndarray) -> np.ndarray:
        """Map instants in the window's run to -0.5 at its beginning, 0.5 at its end."""
        begin, *_, end = self.fit.dataset.prepared[self.run].time[[0, -1]]
        return np.asarray((time - begin) / max(end - begin, 1e-12) - 0.5)

    def decimated(self, torques: np.ndarray) -> Torques:
        """Decimate torques (m, n, N), made at every sample of the window, into candidate columns."""
        decimated = self.decimator.apply(torques)  # (m, n, outputs)
        return lambda rows: decimated[:, :, rows.outputs].transpose(1, 2, 0)

    def rows(self, torques: WindowTorques | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Compute the decimated rows of the window (c, K, columns + m), and which of them are kept (c, K).

        They have the columns of :class:`gtau.estimation.regression.factors.Factors`, and m of the ``torques``.
        """
        system, added = self.fit.system, torques and torques(self)
        loaded = any(term.kind in BY_LOAD for term in system.terms)
        load = system.load(self.run, self.fit.solution.theta) if loaded else None
        rows, keep = [], []
        for part in stream_rows(self.fit.dataset.model, self.regressor, self.window, self.decimator, load):
            A = channel_rows(self.regressor, system.problem.channels, part)
            rows.append(np.concatenate([A, added(part)], axis=-1) if added else A)
            keep.append(part.keep)
        return np.concatenate(rows, axis=1), np.concatenate(keep, axis=1)

    def errors_and_jacobian(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute errors (c, p) and their Jacobian (c, p, k), both in standard deviations.

        ``rows`` (c, p, .) begin with the columns of the factors.
        """
        system, warm, time = self.fit.system, self.fit.dataset.temperatures, self.window.time
        above = None if warm is None else warm.between(self.run, time[0], time[-1])
        columns = system.unreduced.columns_of(system.problem.parameters)
        maps = system.map(self.run, above)[..., columns]
        return weighted(self.fit, rows[..., : maps.shape[1]] @ maps)


WindowTorques = Callable[[FitWindow], Torques]
"""Makes the candidate columns along a window."""


@dataclass(frozen=True, eq=False)
class Linearised:
    """Residuals in W windows or blocks, each reduced to a triangle a channel, in standard deviations of the current.

    ``errors`` (W, c, p), their ``jacobian`` (W, c, p, k) by the unknowns of
    :func:`gtau.estimation.estimators.newton.jacobian`, and by the m ``added`` torques (W, c, p, m).
    ``known`` are residuals (q,) of known parameters and their Jacobian (q, k), of unit variance. In a cluster (W,) of
    windows, numbered from 0, residuals may be correlated.
    """

    errors: np.ndarray
    jacobian: np.ndarray
    added: np.ndarray
    known: tuple[np.ndarray, np.ndarray]
    clusters: np.ndarray

    @cached_property
    def rows(self) -> tuple[np.ndarray, np.ndarray]:
        """Errors (.,) and Jacobian (., k) of all windows, and then of the known parameters."""
        e, J = self.known
        rows = self.jacobian.reshape(-1, J.shape[1])
        return np.append(self.errors, e), np.concatenate([rows, J])

    def fitted(self, columns: slice | Sequence[int] = ()) -> tuple[np.ndarray, np.ndarray]:
        """Fit all unknowns together with some candidate columns: their step (k + m,), and the errors (.,) left."""
        e, J = self.rows
        added = self.added[..., columns].reshape(self.errors.size, -1)
        beside = np.zeros((len(self.known[0]), added.shape[1]))
        wide = np.hstack([J, np.concatenate([added, beside])])
        step = least_squares_step(wide, e)
        return step, e + wide @ step

    @cached_property
    def back(self) -> np.ndarray:
        """Matrix (k, r) that makes the Jacobian's columns orthonormal over all windows."""
        return whitening(self.rows[1], np.zeros(self.errors.shape[1]))

    @cached_property
    def _white(self) -> tuple[np.ndarray, ...]:
        """Orthonormal Jacobian W (W, c, p, r), ``W^T e`` (r,), and of what is left of e, ``W^T e`` and ``W^T W``."""
        W = self.jacobian @ self.back
        W_e = np.einsum("wjpk,wjp->k", W, self.errors)
        remaining = self.errors - W @ W_e
        W_left = np.einsum("wipk,wip->wk", W, remaining)
        return W, W_e, remaining, W_left, np.einsum("wipk,wipl->wkl", W, W, optimize=True)

    def score_tests(self, columns: slice, shared: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Test each candidate column alone, in each channel's equations alone or ``shared`` by all channels.

        All other unknowns adapt to it. Standard deviations follow from the scatter over clusters of windows (a sandwich
        estimate).

        Returns
        -------
        tuple of ndarray
            Of each column in the equations of each channel, (m, n), of one for all if shared: its size, its
            standard deviation, infinite where the other unknowns span the column, the share of the residual variance
            that goes with it, and by how much the other unknowns move for a unit of it, (m, n, k).
        """
        W, W_e, remaining, W_left, W_W = self._white
        added = self.added[..., columns].swapaxes(2, 3)  # (W, c, m, p)

        def folded(by_channel: np.ndarray) -> np.ndarray:
            """Order (W, c, m, ...) as (W, m, n, ...), shared columns summed over the channels."""
            by_column = by_channel.swapaxes(1, 2)
            return by_column.sum(axis=2, keepdims=True) if shared else by_column

        # of each window, products of its column, (m, j) of joint j in all rows i, with W, itself and the residuals
        c_W, c_c = folded(added @ W), folded(np.sum(added**2, axis=-1))
        c_e, c_left = (folded((added @ e[..., None])[..., 0]) for e in (self.errors, remaining))
        along, squares = c_W.sum(axis=0), c_c.sum(axis=0)
        rest = squares - np.sum(along**2, axis=-1)
        spanned = rest <= SPANNED * np.maximum(squares, 1e-300)
        rest = np.where(spanned, 1.0, rest)
        size = -np.where(spanned, 0.0, (c_e.sum(axis=0) - along @ W_e) / rest)
        score = c_left - np.einsum("mjk,wk->wmj", along, W_left)
        turned = np.einsum("mjk,wkl->wmjl", along, W_W, optimize=True)
        square = c_c + np.sum((turned - 2 * c_W) * along, axis=-1)
        count = int(self.clusters.max()) + 1
        scores = np.zeros((count, *rest.shape))
        np.add.at(scores, self.clusters, score + size * square)
        std = np.sqrt(np.sum(scores**2, axis=0) * count / max(count - 1, 1)) / rest
        least = max(float(np.sum(self.errors**2)) - float(W_e @ W_e), 1e-300)
        share = np.where(spanned, 0.0, size**2 * rest / least)
        return size, np.where(spanned, np.inf, std), share, -along @ self.back.T


def linearise(fit: Fit, windows: Windows, torques: WindowTorques | None = None) -> Linearised:
    """Linearise the residuals of a fit along windows of its runs, with candidate columns of all channels.

    Raises GtauError where the model refuses a sample.
    """
    fit_windows = [FitWindow(fit, run, window) for run, window in windows]
    reduced = []
    for window in fit_windows:
        A, keep = window.rows(torques)
        reduced.append([triangle(block[kept]) for block, kept in zip(A, keep, strict=True)])
    T = stacked_triangles(reduced)
    parts = [window.errors_and_jacobian(rows) for window, rows in zip(fit_windows, T, strict=True)]
    e, J = (np.stack(part) for part in zip(*parts, strict=True))
    weights = weights_of(fit) / fit.solution.gains
    added = -weights[:, None, None] * T[..., fit.dataset.base.count + EXTRA :]
    clusters = window_clusters(windows, *fit.dataset.prepared.places)
    return Linearised(e, J, added, known_rows(fit, windows), clusters)


def stacked_triangles(reduced: Sequence[Sequence[np.ndarray]]) -> np.ndarray:
    """Stack the triangles (., columns) of W windows and c channels, (W, c, p, columns), filled up with zero rows."""
    height = max(len(R) for window in reduced for R in window)
    T = np.zeros((len(reduced), len(reduced[0]), height, reduced[0][0].shape[1]))
    for w, c in np.ndindex(T.shape[:2]):
        T[w, c, : len(reduced[w][c])] = reduced[w][c]
    return T


def weighted(fit: Fit, blocks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute errors (..., c, p) of a problem's blocks and their Jacobian (..., c, p, k), in standard deviations."""
    values, weights = fit.solution.values, weights_of(fit)[:, None]
    J = jacobian(blocks, values, fit.system.problem, fit.free_gains)
    return residuals(blocks, values) * weights, J * weights[..., None]


def weights_of(fit: Fit) -> np.ndarray:
    """Compute the weights of the channels' errors, (c,)."""
    return np.asarray(1 / np.maximum(fit.solution.sigma, fit.system.problem.smallest_sigma))


def slopes_of(fit: Fit) -> np.ndarray:
    """Differentiate (theta, gains, delays) by the unknowns of the Jacobian, (k, .)."""
    return to_gains(fit.solution.values, len(fit.solution.gains), fit.free_gains)


def window_motion(model: InverseDynamics, window: SampleWindow) -> Motion:
    """Compute configurations, velocities and accelerations along a window; raises GtauError at a singularity."""
    return motion_along(model, window, configurations(model, window))


def motion_along(model: InverseDynamics, window: SampleWindow, c: np.ndarray) -> Motion:
    """Compute the motion with configurations ``c`` (n_c, N) along a window."""
    samples = window.samples()
    c, qd, qdd = map(np.ascontiguousarray, (c, samples.qd.T, samples.qdd.T))
    return model.rates(c, qd, qdd, instants(window.run.name, samples.time))


def least_squares_step(J: np.ndarray, e: np.ndarray) -> np.ndarray:
    """Solve for the steps (k, ...) that minimise ``e + J step``, in the directions that are excited."""
    scale = np.linalg.norm(J, axis=0)
    scale[scale == 0] = 1.0
    return np.asarray((np.linalg.lstsq(J / scale, -e, rcond=RANK)[0].T / scale).T)


def known_rows(fit: Fit, windows: Windows) -> tuple[np.ndarray, np.ndarray]:
    """Compute the residuals (q,) of the known parameters and their Jacobian (q, k), rows beside the windows'.

    They count against as many rows as the windows have.
    """
    problem, samples = fit.system.problem, sum(map(len, fit.dataset.prepared))
    weight = np.sqrt(min(sum(len(window) for _, window in windows) / samples, 1.0))
    errors = problem.known[:, :-1] @ fit.solution.theta - problem.known[:, -1]
    return weight * errors, weight * jacobian_of_known(problem, fit.free_gains)


def on_channels(torques: WindowTorques, felt: bool) -> WindowTorques:
    """Add a joint's torque to its torque sensor's rows where the sensor has ``felt`` it, otherwise zeros."""

    def with_sensors(at: FitWindow) -> Torques:
        columns = torques(at)
        behind = [channel.row for channel in at.window.run.channels if channel.kind.link_side]

        def by_channel(rows: Rows) -> np.ndarray:
            torques = columns(rows)
            return np.concatenate([torques, torques[behind] * felt]) if behind else torques

        return by_channel

    return with_sensors


def side_by_side(several: Sequence[WindowTorques]) -> WindowTorques:
    """Build the columns of several effects in one pass over the windows."""

    def columns(at: FitWindow) -> Torques:
        parts = [torques(at) for torques in several]
        return lambda rows: np.concatenate([columns(rows) for columns in parts], axis=-1)

    return columns
