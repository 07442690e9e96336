"""Commands with stamps of their own, interpolated onto the clock of the positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gtau.errors import GtauError
from gtau.signals.log_file import LogFile, read_log
from gtau.signals.notes import Kind, Note
from gtau.signals.storage import block, spans, store

LONGEST_STEP = 3.0  # usual steps of the commands, beyond which they are not interpolated but missing
CLOSE = 0.01  # of a step: stamps that differ by less are the same, up to rounding


@dataclass(frozen=True, eq=False)
class Aligned:
    """Commands (K, n) at ``time`` (K,) in s; ``rows`` of the positions' log lie between the first and the last of them.

    ``longest`` (s) is the step over which they are interpolated; beyond it they are missing. ``note`` reports it.
    """

    time: np.ndarray
    command: np.ndarray
    longest: float
    rows: range
    note: Note | None

    def at(self, time: np.ndarray) -> np.ndarray:
        """Interpolate commands (M, n) linearly between stamps at other instants (M,); nan where they are missing."""
        known = np.isfinite(time)
        found = np.full((len(time), self.command.shape[1]), np.nan)
        if not known.any():
            return found
        begin = max(int(np.searchsorted(self.time, np.min(time[known]), side="right")) - 1, 0)
        end = int(np.searchsorted(self.time, np.max(time[known]))) + 1
        stamps, commands = block(self.time, begin, end), block(self.command, begin, end)
        after = np.clip(np.searchsorted(stamps, time[known], side="left"), 0, len(stamps) - 1)
        before = np.maximum(after - (stamps[after] != time[known]), 0)
        between = (stamps[after] - stamps[before] <= self.longest) & (stamps[after] >= time[known])
        values = np.column_stack([np.interp(time[known], stamps, each) for each in commands.T])
        found[known] = np.where(between[:, None], values, np.nan)
        return found


def align(
    path: Path, columns: Sequence[str], times: tuple[LogFile, Sequence[str]], scale: float, what: str
) -> Aligned:  # fmt: skip
    """Read commands and their stamps, and compare these with the stamps of the positions.

    Parameters
    ----------
    path : Path
        The log of the commands.
    columns : sequence of str
        Their time, one column or two (seconds and nanoseconds), then the commands.
    times : pair
        The log of the positions, of their time columns alone, and the time columns of the commands.
    scale : float
        Of a time column, in s.
    what : str
        ``currents`` or ``torques``.

    Raises
    ------
    GtauError
        Their stamps go back, or the two clocks do not overlap.
    """
    positions, stamp_names = times
    file = read_log(path, columns)
    wide = len(stamp_names)
    stamps = [file.names.index(name) for name in stamp_names]
    others = [file.names.index(name) for name in columns[wide:]]

    parts = []
    row, last = 0, -np.inf
    kept = 0
    for values, _ in file.blocks():
        whole = np.isfinite(values).all(axis=1)
        time = seconds(values[:, stamps], scale)
        back = np.flatnonzero(np.diff(time[whole], prepend=last) < 0)
        if back.size:
            at = row + int(np.flatnonzero(whole)[back[0]]) + file.table.first_line
            raise GtauError(
                f"{path}, {file.table.line_word} {at}: the time of the {what} goes back; cut the log there into two "
                "runs, or correct the column."
            )
        whole[whole] = np.diff(time[whole], prepend=last) > 0  # of equal stamps the first
        parts.append(np.column_stack([time[whole], values[np.ix_(whole, others)]]))
        row, kept = row + len(values), kept + int(whole.sum())
        if whole.any():
            last = float(time[whole][-1])
    if kept < 2:
        raise GtauError(f"{path} has {kept} complete rows of {what}; give the log and columns that hold them.")
    table = store(parts, (1 + len(others),))
    own, commands = table[:, 0], table[:, 1:]

    clock = store(seconds(values, scale) for values, _ in positions.blocks())
    inside = np.flatnonzero((clock >= own[0]) & (clock <= own[-1]))
    finite = clock[np.isfinite(clock)]
    if not inside.size or not finite.size:
        spanned = f"{finite[0]:.9g} to {finite[-1]:.9g} s" if finite.size else "no time"
        raise GtauError(
            f"{positions.path} holds positions from {spanned}, but {path} {what} from {own[0]:.9g} to {own[-1]:.9g} s: "
            "their clocks do not overlap; log both with one clock, or give the logs of one run."
        )
    rows = range(int(inside[0]), int(inside[-1]) + 1)
    steps = [float(np.median(np.diff(each))) for each in (finite, own)]
    apart = _distances(finite, own)
    longest = LONGEST_STEP * max(steps)
    said = ""
    if apart > CLOSE * min(steps) or len(rows) < len(clock):
        said = (
            f"aligned the {what} with the positions by linear interpolation between their stamps "
            f"({1 / steps[1]:.4g} Hz; positions {1 / steps[0]:.4g} Hz; typically {apart * 1e3:.2g} ms from a "
            "position to the nearest)"
        )
        if out := len(clock) - len(rows):
            said += f"; left out {out} positions before the first or after the last of them"
    return Aligned(own, commands, longest, rows, Note(Kind.READING, said) if said else None)


def seconds(stamps: np.ndarray, scale: float) -> np.ndarray:
    """Convert one column, or two with seconds and nanoseconds, to times (M,) in s."""
    return stamps[:, 0] * scale if stamps.shape[1] == 1 else stamps[:, 0] + stamps[:, 1] * 1e-9


def _distances(time: np.ndarray, stamps: np.ndarray) -> float:
    """Compute the usual distance in s from an instant to the closest stamp."""
    found = []
    for span in spans(len(time)):
        part = block(time, *span)
        after = np.clip(np.searchsorted(stamps, part), 1, len(stamps) - 1)
        found.append(np.median(np.minimum(np.abs(part - stamps[after - 1]), np.abs(stamps[after] - part))))
    return float(np.median(found))
