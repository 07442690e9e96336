"""Runs cut into blocks, which the jackknife leaves out, and into windows, on which effects are estimated.

Blocks are of as many samples in motion each, windows of the middle of their run without long rests.

Model errors depend mostly on the motion. Runs without and with a payload that repeat one motion share them, and they
cancel in the gains, which depend on the difference of the currents. A jackknife that leaves out blocks of one run
alone counts them as errors of the difference. So runs that repeat a motion are cut at the same positions, and their
blocks are left out together: common errors then cancel in each unit, and differences remain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from gtau.signals.preparation.filters import STENCIL
from gtau.signals.preparation.prepared_run import PreparedRun, SampleWindow, joined
from gtau.signals.storage import rows_at

REPEATED = 0.1  # rms difference of the positions of two shifted runs over the rms of the motion, mean of the joints
REPEATED_PART = 0.7  # part of the longer of two runs in which both have the motion

BLOCKS = 20  # of a run, which the jackknife leaves out in turn
ASLEEP = 1e-6  # weight of a sample in a rest
BLOCK_REST = 0.5  # of a block: shorter rests leave rows in it, and longer ones may leave none
LONGEST = 1 << 16  # positions of a run that are compared, at most

WINDOWS = 10  # of a run, within which residuals may be autocorrelated
SAMPLES = 24_000  # of all windows together, which bounds the time of the tests for long logs
WINDOW_REST = 0.5  # of a window: longer rests are cut out

Windows = Sequence[tuple[int, SampleWindow]]  # windows of runs, each with its run's number


def block_edges(prepared: PreparedRun | SampleWindow) -> np.ndarray:
    """Find the edges of the blocks of a run, as shares of its samples, (BLOCKS + 1,).

    Blocks are equal if the robot does not rest for long; if it does, equal ones would leave all rows to a few.
    """
    at, awake = prepared.awake()
    weight = np.ones(len(awake))
    moving = np.concatenate([[-1], np.flatnonzero(awake), [len(awake)]])
    for k in np.flatnonzero(at[moving[1:]] - at[moving[:-1] + 1] > BLOCK_REST * at[-1] / BLOCKS):
        weight[moving[k] + 1 : moving[k + 1]] = ASLEEP
    along = np.cumsum([0.0, *(np.diff(at) * weight)])
    return np.asarray(np.interp(np.linspace(0.0, along[-1], BLOCKS + 1), along, at / at[-1]))


def block_of(edges: np.ndarray, outputs: int) -> np.ndarray:
    """List the number of the block of each of ``outputs`` rows, (outputs,), from the edges of the blocks."""
    return np.asarray(np.searchsorted(np.round(edges[1:-1] * outputs, 6), np.arange(outputs), side="right"))


class PreparedRuns(tuple[PreparedRun, ...]):
    """Prepared runs, with what follows from their motions alone: groups, blocks and windows."""

    @cached_property
    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Group of each run among those that repeat its motion, (R,), and the group's begin and end, (R, 2).

        These are the instants (s), by the clock of the run, at which the first run of the group begins to move and the
        last one ends. Runs belong together where the rms difference of their positions after a shift in time, over the
        rms of the motion, is below ``REPEATED``, of ``REPEATED_PART`` of the longer one at least. Each is compared with
        the first of every group.
        """
        numbers, spans = np.arange(len(self)), np.zeros((len(self), 2))
        strides = [-(-len(run) // LONGEST) for run in self]
        step = max(stride / run.run.rate for run, stride in zip(self, strides, strict=True))
        paths = []  # positions (N, n) at steps of one length (s)
        for run, stride in zip(self, strides, strict=True):
            at = np.arange(0, len(run), stride)
            time = rows_at(run.time, at) - run.time[0]
            position = rows_at(run.run.position, run.kept.start + at)
            instants = np.arange(0.0, time[-1] + step / 2, step)
            paths.append(np.column_stack([np.interp(instants, time, column) for column in position.T]))
        groups = list[list[tuple[int, float]]]()
        for k, other in enumerate(self):
            for members in groups:
                one = members[0][0]
                lag = _lag(paths[one], paths[k], self[one].moves | other.moves)
                if lag is not None:
                    members.append((k, float(other.time[0] - self[one].time[0] - lag * step)))
                    break
            else:
                groups.append([(k, 0.0)])
        for number, members in enumerate(groups):
            # an instant t of the first run is t + shift by the clock of another
            runs, shifts = (np.array(part) for part in zip(*members, strict=True))
            ends = np.array([self[k].time[[0, -1]] for k in runs]) - shifts[:, None]
            numbers[runs] = number
            spans[runs] = np.array([ends[:, 0].min(), ends[:, 1].max()]) + shifts[:, None]
        return numbers, spans

    @cached_property
    def edges(self) -> tuple[np.ndarray, ...]:
        """Edges of the blocks of each run, as shares (BLOCKS + 1,); at the same positions where motions repeat."""
        cut, (groups, spans) = [], self.places
        for run, group, (begin, _) in zip(self, groups, spans, strict=True):
            members = np.flatnonzero(groups == group).tolist()
            longest = max(members, key=lambda k: len(self[k]) / self[k].run.rate)
            edges = block_edges(self[longest])
            if self[longest] is not run:
                time = self[longest].time
                since = time[0] + edges[1:-1] * (time[-1] - time[0]) - spans[longest, 0]
                edges[1:-1] = np.clip((begin + since - run.time[0]) / (run.time[-1] - run.time[0]), 0.0, 1.0)
            cut.append(edges)
        return tuple(cut)

    @cached_property
    def _windows(self) -> dict[int, Windows]:
        return {}

    def windows(self, pieces: int) -> Windows:
        """Cut the middle of every run into ``pieces`` windows, each with its run's number.

        Long rests, in which no channel has a usable sample, are cut out; the remainder at either side separates the
        filters' supports. All windows together have at most ``SAMPLES`` samples; runs too short for a row of each
        window are left out.
        """
        if pieces in self._windows:
            return self._windows[pieces]
        windows: list[tuple[int, SampleWindow]] = []
        for number, run in enumerate(self):
            wanted = min(SAMPLES // len(self), len(run)) // pieces
            stretches = _moving(run, wanted * pieces, max(int(WINDOW_REST * wanted), 1))
            size = sum(map(len, stretches)) // pieces
            if run.preparation.decimator.outputs(size) == 0:
                continue
            ends = np.cumsum([0, *map(len, stretches)]).tolist()
            first = (ends[-1] - size * pieces) // 2  # sample of all stretches, in the middle
            shifts = [(stretch, first - at) for stretch, at in zip(stretches, ends, strict=False)]
            kept = [stretch[max(begin, 0) : max(begin + size * pieces, 0)] for stretch, begin in shifts]
            middle = joined([run.samples(stretch.start, stretch.stop) for stretch in kept if stretch])
            cuts = range(0, size * pieces, size)
            windows += [(number, replace(middle[at : at + size], part_of=(middle, at))) for at in cuts]
        self._windows[pieces] = windows
        return windows


def _lag(a: np.ndarray, b: np.ndarray, moves: np.ndarray) -> int | None:
    """Find the steps by which path ``a`` lags behind ``b``, by the joints that move; None if the motions differ."""
    from scipy.fft import irfft, next_fast_len, rfft

    least = REPEATED_PART * max(len(a), len(b))
    if min(len(a), len(b)) < least or not moves.any():
        return None
    spread = np.maximum(a.std(axis=0), b.std(axis=0))[moves]
    centre = a.mean(axis=0)[moves]
    a, b = ((path[:, moves] - centre) / (spread * np.sqrt(moves.sum())) for path in (a, b))
    # the mean square of a[i + lag] - b[i] at every lag
    size = next_fast_len(len(a) + len(b) - 1)
    products = (rfft(a, size, axis=0) * np.conj(rfft(b, size, axis=0))).sum(axis=1)
    lags = np.arange(1 - len(b), len(a))
    cross = irfft(products, size)[lags]
    squares_a, squares_b = (np.cumsum(np.append(0.0, np.sum(path**2, axis=1))) for path in (a, b))
    low, high = np.maximum(lags, 0), np.minimum(len(a), len(b) + lags)
    sums = squares_a[high] - squares_a[low] + squares_b[high - lags] - squares_b[low - lags] - 2 * cross
    enough = high - low >= least
    difference = np.where(enough, np.sqrt(np.maximum(sums, 0.0) / np.maximum(high - low, 1)), np.inf)
    best = difference.min(initial=np.inf)
    if best > REPEATED:
        return None
    # of a periodic motion, the shift at which most of both runs overlap
    k = max(np.flatnonzero(difference <= 2 * best), key=lambda k: (high[k] - low[k], -difference[k]))
    return int(lags[k])


def _moving(prepared: PreparedRun, wanted: int, longest_rest: int) -> list[range]:
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
        stretches = [range(begin + a, begin + b) for a, b in zip(edges[::2], edges[1::2], strict=True) if a < b]
        if width == len(prepared) or sum(map(len, stretches)) >= wanted:
            return stretches
        width = min(2 * width, len(prepared))


def usable_rows(windows: Windows, prepared: Sequence[PreparedRun]) -> int:
    """Count the decimated rows of all channels in windows that are kept."""
    return sum(int(prepared[run].preparation.decimator.keep(window.usable).sum()) for run, window in windows)
