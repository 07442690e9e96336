"""Windows in the middle of the runs, on which hypotheses are tested."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gtau.estimation.regression.run_blocks import Place
from gtau.signals.preparation.filters import STENCIL
from gtau.signals.preparation.prepared_run import PreparedRun, SampleWindow, joined

WINDOWS = 10  # of a run, within which residuals may be autocorrelated
SAMPLES = 24_000  # of all windows together, which bounds the time of the tests for long logs
# Of a window: longer rests are cut out. In the shared measured logs robots rest for 0.49 of one at most (1.8 s); in
# simulated logs with a rest in half of each run (16 windows) no window had a usable row.
REST = 0.5

Windows = Sequence[tuple[int, SampleWindow]]
"""Windows of runs, each with its run's number."""


def central_windows(prepared: Sequence[PreparedRun], pieces: int, cut: Sequence[list[range]] | None = None) -> Windows:
    """Cut the middle of every run into ``pieces`` windows, each with its run's number.

    Long rests, in which no channel has a usable sample, are cut out; the remainder at either side separates the
    filters' supports. All windows together have at most ``SAMPLES`` samples; runs too short for a row of each window
    are left out. With :func:`moving_stretches` of the same runs prepared otherwise (``cut``), the windows are those.
    """
    windows: list[tuple[int, SampleWindow]] = []
    cut = moving_stretches(prepared, pieces) if cut is None else cut
    for number, (run, stretches) in enumerate(zip(prepared, cut, strict=True)):
        size = sum(map(len, stretches)) // pieces
        if run.preparation.decimator.outputs(size) == 0:
            continue
        kept = _middle(stretches, size * pieces)
        middle = joined([run.samples(each.start, each.stop) for each in kept])
        first = range(0, size * pieces, size)
        windows += [(number, replace(middle[at : at + size], part_of=(middle, at))) for at in first]
    return windows


def moving_stretches(prepared: Sequence[PreparedRun], pieces: int) -> list[list[range]]:
    """List for each run the stretches in its middle, without long rests, that ``pieces`` windows are cut from."""
    sizes = [min(SAMPLES // len(prepared), len(run)) // pieces for run in prepared]
    return [_moving(run, size * pieces, max(int(REST * size), 1)) for run, size in zip(prepared, sizes, strict=True)]


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


def _middle(stretches: Sequence[range], count: int) -> list[range]:
    """Keep the ``count`` samples in the middle of stretches."""
    ends = np.cumsum([0, *map(len, stretches)]).tolist()
    first = (ends[-1] - count) // 2
    cut = [each[max(first - at, 0) : max(first + count - at, 0)] for each, at in zip(stretches, ends, strict=False)]
    return [each for each in cut if each]


def window_clusters(windows: Windows, places: Sequence[Place]) -> np.ndarray:
    """Assign numbers (W,) to the windows, equal ones to the nearest windows of runs that repeat a motion."""
    numbers: list[int] = []
    first: dict[int, tuple[int, list[tuple[float, int]]]] = {}  # of a group, its first run and that one's windows
    for run, window in windows:
        middle = float(window.time[len(window) // 2]) - places[run].begin
        leader, numbered = first.setdefault(places[run].group, (run, []))
        if run == leader:
            numbered.append((middle, max(numbers, default=-1) + 1))
        numbers.append(min(numbered, key=lambda each: abs(each[0] - middle))[1])
    return np.array(numbers)


def usable_rows(windows: Windows, prepared: Sequence[PreparedRun]) -> int:
    """Count the decimated rows of all channels in windows that are kept."""
    return sum(int(prepared[run].preparation.decimator.keep(window.usable).sum()) for run, window in windows)
