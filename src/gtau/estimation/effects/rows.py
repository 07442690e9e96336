"""Rows of a fit with the columns of all effects, as products, and their linearisation at any estimates.

The rows hold the columns of the problem itself, from which residuals and Jacobian follow at any estimates: these are
moved by the posterior and linearised again until they stay, without another pass over the logs.

Viscous and Coulomb friction that differ between runs are parameters of the model (``fv_2@0``), as warm-up makes
friction drift by per cents, which is invisible in a single run and ruins the drive gains. How far they lie apart is
found with the sizes of all effects; they drift from run to run as those effects do that differ between runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, compress

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.effects.effect import (
    Effect,
    EffectColumn,
    FitWindow,
    Torques,
    friction_torques,
    plain_friction,
    rms_speeds,
)
from gtau.estimation.effects.known import EFFECTS
from gtau.estimation.effects.mixed_model import BOUNDS, LagProducts, MixedModel, Noise, lag_products
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.newton import errors_of_known, jacobian_of_known, split, squared, to_gains, weighted
from gtau.estimation.regression.assembly import FEWEST_ROWS
from gtau.estimation.regression.factors import EXTRA, FIXED, triangle
from gtau.estimation.regression.rows import Rows
from gtau.estimation.regression.run_blocks import Windows

AS_DESCRIBED = 0.0  # of log s: beside a description that stands, its errors have plausible sizes
UNDETERMINED = 1e-12  # curvature of a direction over the largest, below which nothing determines it
ABSURD = 1e20  # products of effects from which parameters are noise
PRECISE = 1e9  # of effects' products: rounding of larger ones would count beside the precision 1 before the data
RANK = 1e-6  # of the largest singular value: directions below it are left out of a least-squares step
FRICTION_CHANGE = 0.1  # relative change between runs: up to 0.1 between the runs of the UR10e pairs
ALONG = 3.0  # runs over which a drift is forgotten: some minutes of warm-up (experience; 1 and 10 change no interval
# of the experiments in docs/evidence/index.md by more than a fifth)
LEVELS = 4  # of noise at most, as the products of each are in memory
MODES = 8  # largest modes that are kept of a longer series

Acting = Sequence[tuple[Effect, tuple[EffectColumn, ...]]]
"""The effects that act on a fit, with their columns."""


def weights_of(fit: Fit) -> np.ndarray:
    """Compute the weights of the channels' errors, (c,)."""
    return np.asarray(1 / np.maximum(fit.solution.sigma, fit.system.problem.smallest_sigma))


def noise_numbers(fit: Fit) -> list[int]:
    """Give the noise of each run a number, (R,): runs of one motion, or with similar residuals, share one."""
    problem, motions = fit.system.problem, fit.dataset.prepared.places[0]
    of_blocks = motions[fit.system.block_positions[:, 0].astype(int)]
    squares = (squared(problem.blocks, fit.solution.values) * weights_of(fit) ** 2).sum(axis=1)
    left = [squares[of_blocks == k].sum() / max(problem.rows[of_blocks == k].sum(), 1) for k in range(max(motions) + 1)]
    place = np.argsort(np.argsort(left))
    return (place[motions] * min(len(left), LEVELS) // len(left)).tolist()


def known_rows(fit: Fit, windows: Windows) -> tuple[np.ndarray, np.ndarray]:
    """Compute the residuals (q,) of the known parameters and their Jacobian (q, k), rows beside the windows'.

    They count against as many rows as the windows have.
    """
    problem, samples = fit.system.problem, sum(map(len, fit.dataset.prepared))
    weight = np.sqrt(min(sum(len(window) for _, window in windows) / samples, 1.0))
    return weight * errors_of_known(problem, fit.solution.values), weight * jacobian_of_known(problem, fit.free_gains)


def triangles(rows: np.ndarray, keep: np.ndarray) -> np.ndarray:
    """Reduce the rows (c, K, columns) that are kept (c, K) to a triangle a channel, (c, p, columns)."""
    reduced = [triangle(block[kept]) for block, kept in zip(rows, keep, strict=True)]
    height = max(map(len, reduced))
    return np.stack([np.pad(R, ((0, height - len(R)), (0, 0))) for R in reduced])


def fitted_sizes(fit: Fit, windows: Windows, effect: Effect, count: int) -> np.ndarray:
    """Fit the sizes of an effect's first columns together with all unknowns, along windows; raises GtauError."""
    e_known, J_known = known_rows(fit, windows)
    errors, jacobians = [e_known], [np.pad(J_known, ((0, 0), (0, count)))]
    first, scale = fit.dataset.base.count + EXTRA, weights_of(fit) / fit.solution.gains
    for run, window in windows:
        at = FitWindow(fit, run, window)
        R = triangles(*at.rows(_columns_of([effect])))
        e, J = weighted(at.equations(R), fit.solution.values, fit.system.problem, fit.free_gains, weights_of(fit))
        added = -R[..., first : first + count] * scale[:, None, None]
        errors.append(e)
        jacobians.append(np.hstack([J, added.reshape(len(e), count)]))
    J = np.vstack(jacobians)
    norms = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
    return np.asarray((np.linalg.lstsq(J / norms, -np.concatenate(errors), rcond=RANK)[0] / norms)[-count:])


def _columns_of(effects: Sequence[Effect]) -> Callable[[FitWindow], Torques]:
    """Make the columns of several effects in one pass over a window.

    A torque sensor behind a drive feels what links do, the shared effects, and not what drives do.
    """

    def columns(at: FitWindow) -> Torques:
        parts = [effect.torques(at) for effect in effects]
        behind = [channel.row for channel in at.window.run.channels if channel.kind.link_side]

        def by_channel(rows: Rows) -> np.ndarray:
            torques = [
                np.concatenate([part, part[behind] * effect.shared])
                for effect, part in zip(effects, (part(rows) for part in parts), strict=True)
            ]
            return np.concatenate(torques, axis=-1)

        return by_channel

    return columns


def run_covariance(runs: int) -> np.ndarray:
    """Compute the covariance (runs, runs) of a drift of unit variance."""
    order = np.arange(runs)
    return np.exp(-np.abs(order[:, None] - order) / ALONG)


def run_modes(runs: int) -> np.ndarray:
    """Compute the modes (runs, modes) whose sum with independent unit sizes drifts like that."""
    values, vectors = np.linalg.eigh(run_covariance(runs))
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0)))[:, ::-1][:, :MODES])


def difference_root(runs: int) -> np.ndarray:
    """Factor the covariance of the differences from the mean of all runs but the last, (runs - 1, runs - 1)."""
    centred = np.eye(runs) - 1 / runs
    covariance = (centred @ run_covariance(runs) @ centred)[:-1, :-1]
    return np.linalg.cholesky(covariance + 1e-9 * np.eye(runs - 1))


@dataclass(frozen=True, eq=False)
class Layout:
    """The ``columns`` of an effect, and their ``places`` among the own or the ``shared`` ones, one after the other.

    Of an effect that drifts between runs each column has as many places as the drift has modes.
    """

    effect: Effect
    columns: tuple[EffectColumn, ...]
    places: slice


@dataclass(frozen=True, eq=False)
class EffectRows:
    """Rows ``[own | problem | shared]`` of each channel as products, weighted by the standard deviations of the fit.

    Products of runs whose noise differs are apart.
    """

    fit: Fit
    layouts: tuple[Layout, ...]
    products: tuple[tuple[LagProducts, ...], ...]
    known: tuple[np.ndarray, np.ndarray]

    @property
    def acting(self) -> Acting:
        """The effects that act, with their columns."""
        return [(layout.effect, layout.columns) for layout in self.layouts]

    def groups(self, shared: bool) -> np.ndarray:
        """List the number of the effect of each own, or each ``shared`` column."""
        spans = [(layout.places, layout.effect.shared == shared) for layout in self.layouts]
        return np.repeat(np.arange(len(spans)), [(span.stop - span.start) * own for span, own in spans])

    @property
    def squares(self) -> list[np.ndarray]:
        """Products of each channel's rows with themselves."""
        return [np.sum([part.products[0] for part in parts], axis=0) for parts in self.products]

    @property
    def strongest(self) -> float:
        """Largest product of a column of an effect with itself, in noise variances, at its plausible size."""
        own = len(self.groups(shared=False))
        end = own + self.fit.system.problem.n_theta + FIXED
        effects = [np.delete(np.diag(product), np.s_[own:end]) for product in self.squares]
        return float(np.max(effects, initial=0.0))

    def leave_out(self, number: int, channels: np.ndarray) -> None:
        """Set an effect's own columns of some channels (c,) to zero, in place."""
        places = self.layouts[number].places
        for part in chain(*compress(self.products, channels)):
            part.products[:, places] = part.products[:, :, places] = 0.0

    @cached_property
    def in_runs(self) -> tuple[list[int], np.ndarray]:
        """Places of the friction of runs among the unknowns, (r,), and a root (r, r) of its prior covariance."""
        names, joints = self.fit.system.problem.unknowns, self.fit.dataset.model.actuated
        plausible, speeds = friction_torques(self.fit), rms_speeds(self.fit)
        estimates = zip(("fv", "fs"), plain_friction(self.fit), (plausible / speeds, plausible), strict=True)
        sizes = {kind: np.where(level > 0, level, otherwise) for kind, level, otherwise in estimates}
        places = [k for k, name in enumerate(names) if name.run is not None]
        root = np.zeros((len(places), len(places)))
        drift = difference_root(len(self.fit.dataset.runs)) if places else root
        for a, b in np.ndindex(root.shape):
            one, other = names[places[a]], names[places[b]]
            if (one.kind, one.body) == (other.kind, other.body):
                size = FRICTION_CHANGE * sizes[one.kind][joints.index(one.body)]
                root[a, b] = size * drift[one.run, other.run]
        return places, root


def effect_rows(fit: Fit, windows: Windows, acting: Acting | None = None) -> EffectRows:
    """Evaluate the columns of all effects along windows of the runs, in one pass; raises GtauError at a singularity."""
    acting = acting or [(effect, columns) for effect in EFFECTS if (columns := tuple(effect.columns(fit)))]
    by_name = {effect.name: columns for effect, columns in acting}
    modes, starts, layouts = run_modes(len(fit.dataset.runs)), {False: 0, True: 0}, []
    for effect, columns in acting:
        start = starts[effect.shared]
        stop = start + len(columns) * (modes.shape[1] if effect.in_runs else 1)
        layouts.append(Layout(effect, columns, slice(start, stop)))
        starts[effect.shared] = stop
    torques = _columns_of([effect for effect, _ in acting])
    plausible = np.array([column.plausible for _, columns in acting for column in columns])
    weights, gains = weights_of(fit), fit.solution.gains
    driven = fit.system.problem.unknown_gains  # a base that floats, or a sensor, has no drive of its own
    products: list[dict[int, LagProducts]] = [{} for _ in gains]
    numbers = noise_numbers(fit)
    for run, window in windows:
        at = FitWindow(fit, run, window, by_name)
        A, keep = at.rows(torques)
        equations = at.equations(A) * weights[:, None, None]
        columns = -A[..., A.shape[-1] - len(plausible) :] * plausible * (weights / gains)[:, None, None]
        rows = np.concatenate([*_placed(layouts, columns, modes[run], driven, False), equations,
                               *_placed(layouts, columns, modes[run], driven, True)], axis=-1)  # fmt: skip
        used = [np.flatnonzero(kept) for kept in keep]
        parts = [lag_products(block[k], np.diff(k, prepend=-2) != 1) for block, k in zip(rows, used, strict=True)]
        for total, part in zip(products, parts, strict=True):
            if numbers[run] in total:
                total[numbers[run]].add(part)
            else:
                total[numbers[run]] = part
    by_noise = (_by_noise(list(total.values())) for total in products)
    result = EffectRows(fit, tuple(layouts), tuple(by_noise), known_rows(fit, windows))
    if result.strongest > ABSURD:
        raise GtauError("the motions leave the links' parameters too open; move several joints at once.")
    return result


def _by_noise(parts: list[LagProducts]) -> tuple[LagProducts, ...]:
    """Add the parts of a channel up where one has too few rows for a noise of its own."""
    if min(part.counts[0] for part in parts) < FEWEST_ROWS:
        for part in parts[1:]:
            parts[0].add(part)
        return (parts[0],)
    return tuple(parts)


def _placed(
    layouts: Sequence[Layout], columns: np.ndarray, modes: np.ndarray, driven: np.ndarray, shared: bool
) -> Iterator[np.ndarray]:
    """Pick the own or the shared columns (c, K, .) of a window, those that drift between runs by their modes."""
    at = 0
    for layout in layouts:
        part = columns[..., at : at + len(layout.columns)]
        at += len(layout.columns)
        if layout.effect.shared == shared:
            part = part if shared else part * driven[:, None, None]
            yield (part[..., None] * modes).reshape(*part.shape[:2], -1) if layout.effect.in_runs else part


def linear_at(
    rows: EffectRows, values: np.ndarray, noise: tuple[tuple[Noise, ...], ...] = ()
) -> tuple[MixedModel, np.ndarray, np.ndarray]:
    """Linearise the residuals at estimates (k,), with the ``noise`` of the channels found before.

    Returns the mixed model, slopes (k, .) of the values by its common columns, and the origin (k,) from which steps
    count: the values without changes of friction between runs, whose sizes the mixed model estimates whole.
    """
    fit, problem, (errors, J_known) = rows.fit, rows.fit.system.problem, rows.known
    channels = len(problem.channels)
    T = to_gains(values, channels, fit.free_gains)
    per_run, root = rows.in_runs
    free = np.setdiff1d(np.arange(T.shape[1]), per_run)  # the parameters come first in both orders
    origin = values.copy()
    origin[per_run] = 0.0
    own_groups, shared_groups = rows.groups(shared=False), rows.groups(shared=True)
    maps = _channel_maps(fit, values, origin, T.shape[1])
    (theta, gains, delays), (theta_0, gains_0, delays_0) = (split(at, channels) for at in (values, fit.solution.values))
    steps = [theta - theta_0, *([1 / gains - 1 / gains_0] if fit.free_gains else []), delays - delays_0]
    n_own, end = len(own_groups), len(own_groups) + problem.n_theta + FIXED
    squares = [
        M[:, free].T @ product[n_own:end, n_own:end] @ M[:, free] for M, product in zip(maps, rows.squares, strict=True)
    ]
    back, alone = _whitening([J_known[:, free].T @ J_known[:, free], *squares], rows.strongest)
    basis = np.zeros((T.shape[1], back.shape[1] + len(per_run)))
    basis[free, : back.shape[1]] = back
    basis[per_run, back.shape[1] :] = root
    made = [(n_own, np.column_stack([M[:, :-1] @ basis, M[:, -1]])) for M in maps]
    linear = tuple(
        tuple(replace(part, basis=by) for part in parts) for by, parts in zip(made, rows.products, strict=True)
    )
    known = np.column_stack([J_known[:, free] @ back, errors + J_known @ np.concatenate(steps)])
    # a change of friction between runs has no effect on known parameters
    common_groups = np.append(np.full(len(per_run), len(rows.layouts)), shared_groups)
    # sensors of wrenches are often not tared, and where they measure, effects do not move estimates
    prior = np.ones(len(rows.layouts) + 1)
    largest = BOUNDS[1] * prior
    if not problem.wrenches:
        largest[:-1][[layout.effect.description for layout in rows.layouts]] = AS_DESCRIBED
    model = MixedModel(linear, known.T @ known, own_groups, common_groups, prior, noise, largest, alone)
    return model, np.hstack([T @ basis, np.zeros((len(values), len(shared_groups)))]), origin


def _channel_maps(fit: Fit, values: np.ndarray, origin: np.ndarray, columns: int) -> list[np.ndarray]:
    """Map each channel's columns of the problem to the ``columns`` of the Jacobian and its residuals: (., columns + 1).

    The Jacobian is taken at the ``values`` (k,), the residuals at the ``origin`` (k,).
    """
    problem, n = fit.system.problem, fit.system.problem.n_theta
    channels = len(problem.channels)
    theta, gains, delays = split(values, channels)
    maps = []
    for j, (gain, delay) in enumerate(zip(gains, delays, strict=True)):
        M = np.zeros((n + FIXED, columns + 1))
        M[:n, :n] = -np.eye(n) / gain
        if fit.free_gains and problem.unknown_gains[j]:
            M[:n, n + j] = -theta
            M[n, n + j] = -1.0
        if problem.longest_delays[j] > 0:
            M[-2:, columns - channels + j] = -1.0, delay
        M[:n, -1] = -origin[:n] / gain
        M[n:, -1] = -1 / gain, 1.0, -delay, delay**2 / 2
        maps.append(M)
    return maps


def _whitening(squares: Sequence[np.ndarray], largest: float) -> tuple[np.ndarray, Sequence[int] | np.ndarray]:
    """Make unknowns with products (k, k), of known parameters and each channel, orthonormal: (k, r).

    Directions that nothing determines are left out. Those of unknowns that act on one channel alone come last, with
    their channels; none where the ``largest`` product of effects is not ``PRECISE``.
    """
    square, acting = np.sum(squares, axis=0), np.array([np.diag(product) > 0 for product in squares])
    norms = np.sqrt(np.diag(square))
    inverse = np.divide(1.0, norms, out=np.zeros_like(norms), where=norms > 0)[:, None]
    values, vectors = np.linalg.eigh(square * inverse * inverse.T)
    kept = values > UNDETERMINED * max(values[-1], 1e-300)
    back = vectors[:, kept] / np.sqrt(values[kept]) * inverse
    at = np.flatnonzero((acting.sum(axis=0) == 1) & ~acting[0])
    Q, R = np.linalg.qr(back.T @ square[:, at], mode="complete")
    if largest > PRECISE or np.any(np.abs(np.diag(R)) <= RANK * norms[at]):  # or some depend on each other
        return back, ()
    return back @ np.roll(Q, -len(at), axis=1), acting[1:, at].argmax(axis=0)
