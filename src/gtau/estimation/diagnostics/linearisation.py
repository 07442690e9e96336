"""Linearised residuals of a fit along windows of the runs, with candidate columns that the model lacks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.newton import jacobian, jacobian_of_known, residuals
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.equations import FIXED, triangle
from gtau.estimation.regression.factors import EXTRA, equations
from gtau.estimation.regression.rows import Rows, stream_rows
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.signals.preparation.filters import STENCIL
from gtau.signals.preparation.prepared_run import InMemoryRun, PreparedRun, joined

SAMPLES = 24_000  # of all windows together, which bounds the time of the tests for long logs
# Of a window: longer rests are cut out. In the shared measured logs robots rest for 0.49 of one at most (1.8 s); in
# simulated logs with a rest in half of each run (16 windows) no window had a usable row.
REST = 0.5
RANK = 1e-6  # of the largest singular value: directions below it are left out

CandidateColumns = Callable[[Rows], np.ndarray]
"""Gives torques (n, K, m), or (c, K, m) of all channels, in N m or N at each block of a window's rows, in order."""

Windows = Sequence[tuple[int, InMemoryRun]]
"""Windows of runs, each with its run's number."""

Offer = Callable[[InMemoryRun, np.ndarray], CandidateColumns]
"""Makes the candidate columns along a window, from the values (n_b,) of the base columns in its run."""


@dataclass(frozen=True, eq=False)
class LinearisedWindow:
    """Rows of a window reduced to triangles, in standard deviations of the current.

    ``errors`` (c, p), their ``jacobian`` (c, p, k) by the unknowns of
    :func:`gtau.estimation.estimators.newton.jacobian`, and by the m candidate torques ``offered`` (c, p, m).
    """

    errors: np.ndarray
    jacobian: np.ndarray
    offered: np.ndarray


def central_windows(dataset: Dataset, pieces: int = 1, cut: Sequence[list[range]] | None = None) -> Windows:
    """Cut the middle of every run into ``pieces`` windows, each with its run's number.

    Long rests, in which no channel has a usable sample, are cut out; the remainder at either side separates the
    filters' supports. All windows together have at most ``SAMPLES`` samples; runs too short for a row of each window
    are left out.

    Parameters
    ----------
    dataset : Dataset
        Whose runs are cut.
    pieces : int
        Windows of each run.
    cut : sequence of list of range, optional
        From :func:`moving_stretches` of the same runs prepared otherwise, so that windows of both are the same.
    """
    found: list[tuple[int, InMemoryRun]] = []
    cut = moving_stretches(dataset, pieces) if cut is None else cut
    for run, (whole, stretches) in enumerate(zip(dataset.prepared, cut, strict=True)):
        size = sum(map(len, stretches)) // pieces
        if dataset.preparation.at(whole.run.rate).decimator.outputs(size) == 0:
            continue
        kept = _middle(stretches, size * pieces)
        middle = InMemoryRun(whole.run, joined([whole.samples(each.start, each.stop) for each in kept]))
        parts = range(0, size * pieces, size)
        found += [(run, InMemoryRun(whole.run, middle.samples(at, at + size), middle, at)) for at in parts]
    return found


def moving_stretches(dataset: Dataset, pieces: int = 1) -> list[list[range]]:
    """List for each run the stretches in its middle, without long rests, that ``pieces`` windows are cut from."""
    sizes = [min(SAMPLES // len(dataset.prepared), len(each)) // pieces for each in dataset.prepared]
    return [
        _moving_stretches(each, size * pieces, max(int(REST * size), 1))
        for each, size in zip(dataset.prepared, sizes, strict=True)
    ]


def _moving_stretches(prepared: PreparedRun, wanted: int, longest_rest: int) -> list[range]:
    """Search outwards from the middle of a run for ``wanted`` samples in stretches without longer rests."""
    margin = max(prepared.preparation.decimator.support, STENCIL)
    width = wanted
    while True:
        begin = (len(prepared) - width) // 2
        usable = prepared.samples(begin, begin + width).usable.any(axis=1)
        awake = np.concatenate([[-1], np.flatnonzero(usable), [width]])
        long = np.flatnonzero(np.diff(awake) - 1 > max(longest_rest, 2 * margin))
        rests = zip((awake[long] + 1).tolist(), awake[long + 1].tolist(), strict=True)
        edges = [0, *(edge for a, b in rests for edge in (min(a + margin, b), max(b - margin, a))), width]
        found = [range(begin + a, begin + b) for a, b in zip(edges[::2], edges[1::2], strict=True) if a < b]
        if width == len(prepared) or sum(map(len, found)) >= wanted:
            return found
        width = min(2 * width, len(prepared))


def _middle(stretches: Sequence[range], count: int) -> list[range]:
    """Keep the ``count`` samples in the middle of stretches."""
    ends = np.cumsum([0, *map(len, stretches)]).tolist()
    first = (ends[-1] - count) // 2
    cut = [each[max(first - at, 0) : max(first + count - at, 0)] for each, at in zip(stretches, ends, strict=False)]
    return [each for each in cut if each]


def in_step(dataset: Dataset, windows: Windows) -> np.ndarray:
    """Assign numbers (W,) to the windows, equal ones to the nearest windows of runs that repeat a motion."""
    found: list[int] = []
    first: dict[int, tuple[int, list[tuple[float, int]]]] = {}  # of a group, its first run and that one's windows
    for run, window in windows:
        place = dataset.places[run]
        middle = float(window.all.time[len(window) // 2]) - place.begin
        leader, numbered = first.setdefault(place.group, (run, []))
        if run == leader:
            numbered.append((middle, max(found, default=-1) + 1))
        found.append(min(numbered, key=lambda each: abs(each[0] - middle))[1])
    return np.array(found)


def usable_rows(dataset: Dataset, windows: Windows) -> int:
    """Count the decimated rows of all channels in windows that are kept."""
    return sum(
        int(dataset.preparation.at(window.run.rate).decimator.keep(window.all.usable).sum()) for _, window in windows
    )


def linearise(
    fit: Fit,
    offer: Offer | None,
    windows: Windows,
    model: InverseDynamics | None = None,
) -> list[LinearisedWindow]:
    """Linearise the residuals of a fit along windows of its runs.

    Parameters
    ----------
    fit : Fit
        What was estimated.
    offer : callable, optional
        Makes candidate columns of all channels; see :func:`on_channels`.
    windows : sequence
        From :func:`central_windows`.
    model : InverseDynamics, optional
        Another model of the robot, with the same base columns.

    Raises
    ------
    GtauError
        Where the model refuses a sample.
    """
    fast = fit.dataset.model if model is None else model
    reduced = []
    for run, window in windows:
        candidates = None if offer is None else offer(window, fit.system.motion(run, fit.solution.theta))
        A, keep = window_rows(fit, run, window, candidates, fast)
        reduced.append((run, window, [triangle(of_joint[kept]) for of_joint, kept in zip(A, keep, strict=True)]))
    height = max((len(T) for _, _, of_window in reduced for T in of_window), default=0)
    found = []
    for run, window, of_window in reduced:
        T = np.zeros((len(of_window), height, of_window[0].shape[1]))
        for rows, each in zip(T, of_window, strict=True):
            rows[: len(each)] = each
        e, J, weights = errors_and_jacobian(fit, run, window, T)
        offered = -(fit.solution.iterate.b * weights)[:, None, None] * T[:, :, fit.dataset.base.count + EXTRA :]
        found.append(LinearisedWindow(e, J, offered))
    return found


def window_rows(
    fit: Fit, run: int, window: InMemoryRun, candidates: CandidateColumns | None, model: InverseDynamics
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the decimated rows of a window: the columns of the factors and m candidates, and which rows are kept.

    Returns
    -------
    A : ndarray
        (c, K, columns + m), see :class:`gtau.estimation.regression.factors.Factors`.
    keep : ndarray
        (c, K) of bool.
    """
    regressor, c = model.columns(fit.dataset.base.standard), len(fit.system.problem.channels)
    loaded = any(term.kind == "fl" for term in fit.system.friction.terms)
    load = fit.system.load(run, fit.solution.theta) if loaded else None
    decimator = fit.dataset.preparation.at(window.run.rate).decimator
    parts, keep = [], []
    for part in stream_rows(model, regressor, window, decimator, load):
        torques = np.zeros((c, len(part.time), 0)) if candidates is None else candidates(part)
        parts.append(np.concatenate([equations(regressor, fit.system.problem.channels, part), torques], axis=-1))
        keep.append(part.keep)
    return np.concatenate(parts, axis=1), np.concatenate(keep, axis=1)


def errors_and_jacobian(
    fit: Fit, run: int, window: InMemoryRun, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute errors (c, p), their Jacobian (c, p, k), both in standard deviations, and the weights (c,) behind them.

    ``rows`` (c, p, .) begin with the columns of the factors, along a ``window`` of a run.
    """
    system, problem, state = fit.system, fit.system.problem, fit.solution.iterate
    kept = [system.whole.parameters.index(name) for name in problem.parameters]
    columns = [*kept, *range(system.whole.n_theta, system.whole.n_theta + FIXED)]
    warm, time = fit.dataset.temperatures, window.all.time
    maps = system.map(run, None if warm is None else warm.between(run, time[0], time[-1]))[..., columns]
    blocks = rows[..., : maps.shape[1]] @ maps
    weights = 1 / np.maximum(fit.solution.sigma, problem.smallest_sigma)
    e, J = residuals(blocks, state), jacobian(blocks, state, problem, fit.free_gains)
    return e * weights[:, None], J * weights[:, None, None], weights


def stack(windows: Sequence[LinearisedWindow]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stack errors (.,), Jacobian (., k) and candidate columns (., m) of all channels in all windows."""
    return (
        np.concatenate([each.errors.ravel() for each in windows]),
        np.concatenate([of_joint for each in windows for of_joint in each.jacobian]),
        np.concatenate([of_joint for each in windows for of_joint in each.offered]),
    )


def least_squares_step(J: np.ndarray, e: np.ndarray) -> np.ndarray:
    """Solve for the steps (k, ...) that minimise ``e + J step``, in the directions that are excited."""
    scale = np.linalg.norm(J, axis=0)
    scale[scale == 0] = 1.0
    return np.asarray((np.linalg.lstsq(J / scale, -e, rcond=RANK)[0].T / scale).T)


def at_full_rate(window: InMemoryRun, dataset: Dataset, torques: np.ndarray) -> CandidateColumns:
    """Decimate torques (m, n, M), made at every sample of a window, into candidate columns."""
    decimated = dataset.preparation.at(window.run.rate).decimator.apply(torques)  # (m, n, outputs)
    return lambda rows: decimated[:, :, rows.outputs].transpose(1, 2, 0)


def on_channels(offer: Offer, felt: bool) -> Offer:
    """Add a joint's torque to its torque sensor's rows where the sensor has ``felt`` it, otherwise zeros."""

    def with_sensors(window: InMemoryRun, values: np.ndarray) -> CandidateColumns:
        columns = offer(window, values)
        behind = [each.row for each in window.run.channels if each.kind.link_side]

        def of_channels(rows: Rows) -> np.ndarray:
            torques = columns(rows)
            return np.concatenate([torques, torques[behind] * felt]) if behind else torques

        return of_channels

    return with_sensors


def known_rows(fit: Fit, windows: Windows) -> tuple[np.ndarray, np.ndarray]:
    """Compute the residuals (k,) of the known parameters and their Jacobian (k, size), rows beside the windows'.

    They count against as many rows as the windows have.
    """
    problem, dataset = fit.system.problem, fit.dataset
    share = sum(len(window) for _, window in windows) / sum(map(len, dataset.prepared))
    weight = np.sqrt(min(share, 1.0))
    size = problem.n_theta + len(problem.channels) * (2 if fit.free_gains else 1)
    errors = problem.known[:, :-1] @ fit.solution.theta - problem.known[:, -1]
    return weight * errors, weight * jacobian_of_known(problem, size)


def side_by_side(offers: Sequence[Offer]) -> Offer:
    """Build the columns of several hypotheses in one pass over the windows."""

    def offer(window: InMemoryRun, values: np.ndarray) -> CandidateColumns:
        each = [make(window, values) for make in offers]
        return lambda rows: np.concatenate([columns(rows) for columns in each], axis=-1)

    return offer
