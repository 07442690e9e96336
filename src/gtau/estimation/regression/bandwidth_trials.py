"""Trials of a few position filters on the logs themselves: which one predicts the commands of stretches not used.

Spectra show where noise takes over in the accelerations of a sample. What filters do to parameters is another matter:
noise averages out over a long log, and what a filter takes away does not; a small oscillation of the controller may
look like motion. So stretches spread over the logs are fitted behind some cut-offs, every channel by its own equations
alone, which needs no gains, and the parameters predict the stretches between. Parameters found behind one cut-off are
tested along the motions behind all, and the best counts: noise that biases them is then no excuse for their errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.regression.factors import EXTRA, KNOWN, SIGNAL, channel_rows
from gtau.estimation.regression.plausibility import motor_to_joint_speed
from gtau.estimation.regression.rows import stream_rows
from gtau.model.base_parameters import Equations
from gtau.signals.preparation.bandwidth import LEAST_WIDTH
from gtau.signals.preparation.filters import HIGHEST_CUTOFF, PASSED, Decimator, Preparation, cutoff_at_ends
from gtau.signals.preparation.prepared_run import prepare
from gtau.signals.run import Run

LOWEST = 5.0
HIGHEST = 40.0  # Hz, of the cut-offs tried: half the chosen one, a quarter, and so on
BANDS = 5.0, 20.0  # Hz, within which the low-pass of the rows is when they are compared
# Of all runs together, evaluated behind each cut-off. With 800 rows a filter of 10 Hz seems to halve the errors of the
# UPV robot (13.7 Hz), of which 3000 say that it raises them by 10 %.
ROWS, SAMPLES = 3000, 6000
STRETCHES = 16  # of all runs together, at least four of each
FINE = 5.0  # times the highest cut-off: rate of the samples
MARGIN = 0.15  # errors over the least, less 1, from which the chosen cut-off is given up
SMALLEST = 1e-3  # singular value of normed columns
FEWEST = 4  # rows of half the stretches for each column


def best_of_trials(equations: Equations, runs: Sequence[Run], preparation: Preparation) -> Preparation:
    """Lower the cut-off and the bandwidth of a preparation where parameters found behind it predict clearly worse."""
    lowest = max(LOWEST, cutoff_at_ends(float(np.mean([len(run.time) / run.rate for run in runs]))))
    cutoffs = [preparation.cutoff]
    lower = min(preparation.cutoff or HIGHEST_CUTOFF * preparation.rate, 2 * HIGHEST) / 2
    while lower >= lowest:
        cutoffs.append(lower)
        lower /= 2
    if len(cutoffs) == 1:
        return preparation
    try:
        errors = _errors(equations, runs, preparation, cutoffs)
    except GtauError:  # positions that the robot cannot have: the checks of the runs say why
        return preparation
    good = errors <= (1 + MARGIN) * np.min(errors)
    if good[0] or not good.any():
        return preparation
    cutoff = cutoffs[int(np.argmin(errors))]
    assert cutoff is not None
    return replace(preparation, cutoff=cutoff, bandwidth=min(preparation.bandwidth, cutoff / LEAST_WIDTH))


def _errors(
    equations: Equations, runs: Sequence[Run], preparation: Preparation, cutoffs: Sequence[float | None]
) -> np.ndarray:
    """Compute the relative errors behind each cut-off (C,), the geometric mean of the channels; NaN with few rows."""
    loads = [run.payload for run in runs]
    alike = [run for run in runs if run.payload == max(loads, key=loads.count)]
    run_rows = [_rows(equations, run, preparation, cutoffs, len(alike)) for run in alike]
    A, keep, odd = (np.concatenate(parts, axis=-1) for parts in zip(*run_rows, strict=True))
    channels = [_log_errors(A[:, j, :, kept], odd[kept]) for j, kept in enumerate(keep)]
    known = [errors for errors in channels if np.isfinite(errors).all()]
    return np.exp(np.mean(known, axis=0)) if known else np.full(len(cutoffs), np.nan)


def _log_errors(rows: np.ndarray, odd: np.ndarray) -> np.ndarray:
    """Compute the logarithms of a channel's relative errors (C,) from rows ``[W known | v]`` (K, C, p)."""
    rows = np.moveaxis(rows, 0, 1)
    norms = np.linalg.norm(rows, axis=(0, 1))
    rows = rows[..., norms > 0] / norms[norms > 0]
    squares = np.zeros((len(rows), len(rows)))
    for fitted in (odd, ~odd):
        if norms[-1] == 0 or fitted.sum() < FEWEST * rows.shape[2]:
            return np.full(len(rows), np.nan)
        thetas = [np.linalg.lstsq(A[fitted, :-1], A[fitted, -1], rcond=SMALLEST)[0] for A in rows]
        errors = rows[:, ~fitted, :-1] @ np.array(thetas).T - rows[:, ~fitted, -1:]  # (C along, K, C fitted)
        squares += np.sum(errors**2, axis=1).T
    return np.log(np.maximum(squares.min(axis=1), 1e-300)) / 2


def _rows(
    equations: Equations, run: Run, preparation: Preparation, cutoffs: Sequence[float | None], runs: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute rows (C, c, p, K) behind the cut-offs, masks of the usable (c, K) and of odd stretches (K,)."""
    model, standard = equations.model, equations.base.standard
    prepared = prepare(run, preparation.at(run.rate), motor_to_joint_speed(model))
    stride = max(1, int(run.rate / (FINE * max(cutoff or run.rate for cutoff in cutoffs))))
    band = float(np.clip(preparation.decimator.cutoff(preparation.rate), *BANDS))
    decimator = Decimator(max(1, int(PASSED / 2 * run.rate / stride / band)))
    pieces = max(STRETCHES // runs, 4)
    length = min(min(ROWS * decimator.factor, SAMPLES) // runs // pieces * stride, len(prepared) // pieces)
    regressor, p = model.columns(standard), len(standard) + EXTRA
    channels = [channel for channel in run.channels if channel.kind.modelled]
    used = [*range(p - EXTRA), p + KNOWN, p + SIGNAL]
    A: list[list[np.ndarray]] = [[] for _ in cutoffs]
    if runs * pieces * decimator.outputs(length // stride) < 2 * FEWEST * np.bincount(regressor.rows).min():
        pieces = 0  # not worth the time
    keep, odd = [np.zeros((len(channels), 0), bool)], [np.zeros(0, bool)]
    for number, start in enumerate(np.linspace(0, len(prepared) - length, pieces).astype(int).tolist()):
        usable = []
        for rows, cutoff in zip(A, cutoffs, strict=True):
            behind = replace(prepared, preparation=replace(prepared.preparation, cutoff=cutoff))
            window = behind.samples(start, start + length)[::stride]
            parts = list(stream_rows(model, regressor, window, decimator))
            rows += [channel_rows(regressor, channels, part)[..., used].swapaxes(1, 2) for part in parts]
            usable.append(np.concatenate([keep[0], *(part.keep for part in parts)], axis=1))
        keep.append(np.all(usable, axis=0))
        odd.append(np.full(keep[-1].shape[1], number % 2 == 1))
    empty = np.zeros((len(channels), len(used), 0))
    stacked = np.stack([np.concatenate([empty, *rows], axis=-1) for rows in A])
    return stacked, np.concatenate(keep, axis=1), np.concatenate(odd)
