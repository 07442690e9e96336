"""Logs of a run, one file or two, as samples in SI units; commands with separate time stamps are interpolated."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gtau.errors import GtauError
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.signals.reading.body_columns import at_origins
from gtau.signals.reading.columns import SampleRate, Signals
from gtau.signals.reading.formats import ALL, Table
from gtau.signals.reading.log_file import read_log
from gtau.signals.reading.samples import Source
from gtau.signals.reading.units import Units
from gtau.signals.storage import block, spans, store


@dataclass(frozen=True, eq=False)
class Logged:
    """Logs of a run, located but not yet read.

    Of the ``files``' columns side by side, ``order`` are those of positions and channels, or the
    positions where the others are ``aligned``, and ``times`` the time, in one column or two; ``scale`` and
    ``time_scale`` bring them to SI units. ``notes`` report what was left out or aligned.
    """

    files: tuple[Table, ...]
    source: Source
    signals: Signals
    order: tuple[int, ...]
    scale: tuple[float, ...]
    times: tuple[int, ...]
    time_scale: float
    aligned: Aligned | None
    notes: tuple[Finding, ...]

    def blocks(self, rows: range = ALL, progress: Callable[[float], None] = lambda done: None) -> Iterator[np.ndarray]:
        """Read samples (M, n + c + 1) in order: positions, commands, torque sensors, wrenches and time.

        Parameters
        ----------
        rows : range
            Those wanted.
        progress : callable
            Called with the part of the log that has been read.

        Raises
        ------
        GtauError
            Where a file cannot be read on, or two files have different lengths.
        """
        row = rows.start
        if self.aligned is not None:
            shift = self.aligned.rows.start
            rows = range(rows.start + shift, min(rows.stop + shift, self.aligned.rows.stop))
        for values, done in _side_by_side(self.files, rows):
            progress(done)
            time = instants(self.signals, values[:, self.times], self.time_scale, row)
            found = values[:, self.order]
            if self.aligned is not None:
                commands = self.aligned.at(time)
                commands[np.isnan(found).all(axis=1)] = np.nan  # rows that hold other topics
                found = np.hstack([found, commands])
            row += len(values)
            yield np.column_stack([self._converted(found * self.scale), time])

    def _converted(self, values: np.ndarray) -> np.ndarray:
        """Prepend the base's six coordinates, whose commands are 0; move the wrenches to the origins of their axes.

        The columns (M, .) are those of positions, pose, commands and sensors, and wrenches.
        """
        base = self.signals.base
        own = len(base.joints) if base else 0
        joints, modelled = len(self.source.joints) - own, sum(each.kind.modelled for each in self.source.channels) - own
        widths = [joints, len(base.pose) if base else 0, modelled]
        q, pose, commands, wrenches = np.split(values, np.cumsum(widths), axis=1)
        wrenches = at_origins(self.signals.all_wrenches, wrenches, base.yaw if base else 0.0)
        if base is None:
            return np.hstack([q, commands, wrenches])
        return np.hstack([base.positions(pose), q, np.zeros((len(values), own)), commands, wrenches])


def find_logs(paths: Sequence[Path], signals: Signals, units: Units) -> Logged:
    """Find the columns of a run in its logs; raises GtauError."""
    if len(paths) not in (1, 2):
        raise GtauError(f"a run has {len(paths)} logs; give one, or two with the positions and the {signals.kind}s.")
    times, stamps, base = signals.time_columns, signals.command_time_columns, signals.base
    positions, commands = [*signals.position.values(), *(base.pose if base else ())], list(signals.measured)
    position_scale, command_scale, time_scale = units.scale(signals)
    if len(paths) == 1 and set(positions) & set(commands):
        raise GtauError(
            f"{paths[0]}: the column '{min(set(positions) & set(commands))}' is given both as a position and as a "
            f"{signals.kind}; correct one of the two."
        )
    beside = commands if len(paths) == 1 and not stamps else []
    files = [read_log(paths[0], (*times, *positions, *beside))]
    aligned = None
    if stamps:
        clock = read_log(paths[0], times)
        aligned = align(paths[-1], (*stamps, *commands), (clock, stamps), time_scale, f"{signals.kind}s")
    elif len(paths) == 2:
        files.append(read_log(paths[1], commands))
    columns = [(k, name) for k, file in enumerate(files) for name in file.columns]
    wanted = [(0, name) for name in positions]
    wanted += [(len(files) - 1, name) for name in commands if not stamps]
    first = files[0]
    source = Source(
        name=" and ".join(str(path) for path in paths),
        joints=signals.joints,
        channels=signals.channels,
        columns=(*_labels(signals), " and ".join(times) or "rate"),
        texts=ChainMap(*(file.texts for file in reversed(files))),
        first_line=(first.first_line or 1) + (aligned.rows.start if aligned else 0),
        line_word="row" if first.first_line is None else "line",
    )
    notes = [note.of_source(file.path.name) if len(files) > 1 else note for file in files for note in file.notes]
    return Logged(
        files=tuple(files),
        source=source,
        signals=signals,
        order=tuple(columns.index(column) for column in wanted),
        scale=(*position_scale, *command_scale),
        times=tuple(columns.index((0, name)) for name in times),
        time_scale=time_scale,
        aligned=aligned,
        notes=(*notes, *([aligned.note] if aligned and aligned.note else [])),
    )


def _labels(signals: Signals) -> Iterator[str]:
    """Name the columns of positions and channels, for messages."""
    base = signals.base
    own = len(base.joints) if base else 0
    yield from (*(base.labels if base else ()), *signals.position.values())
    yield from ["no motor"] * own
    yield from signals.measured[: sum(each.kind.modelled for each in signals.channels) - own]
    yield from (label for each in signals.all_wrenches for label in each.labels)


def _side_by_side(files: Sequence[Table], wanted: range) -> Iterator[tuple[np.ndarray, float]]:
    """Join rows of logs that were sampled together, with the fraction of the first read so far."""
    streams = [file.blocks(wanted) for file in files]
    held = [next(stream, None) for stream in streams]
    rows = [0] * len(files)
    while all(each is not None for each in held):
        count = min(len(each[0]) for each in held if each)
        yield np.hstack([each[0][:count] for each in held if each]), held[0][1] if held[0] else 1.0
        for k, (each, stream) in enumerate(zip(held, streams, strict=True)):
            rows[k] += count
            if each is not None:
                held[k] = (each[0][count:], each[1]) if len(each[0]) > count else next(stream, None)
    for k, (each, stream) in enumerate(zip(held, streams, strict=True)):
        rows[k] += (len(each[0]) if each else 0) + sum(len(values) for values, _ in stream)
    if len(set(rows)) > 1:
        raise GtauError(
            f"{files[0].path} has {rows[0]} rows but {files[1].path} has {rows[1]}; give two logs that were sampled "
            "together, or the stamps of each (time: {position: COLUMN, command: COLUMN})."
        )


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
    note: Finding | None

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
    path: Path, columns: Sequence[str], times: tuple[Table, Sequence[str]], scale: float, what: str
) -> Aligned:  # fmt: skip
    """Read commands and their time stamps, and compare these with the stamps of the positions.

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
    stamps = [file.columns.index(name) for name in stamp_names]
    others = [file.columns.index(name) for name in columns[wide:]]

    parts = []
    row, last = 0, -np.inf
    kept = 0
    for values, _ in file.blocks():
        whole = np.isfinite(values).all(axis=1)
        time = seconds(values[:, stamps], scale)
        back = np.flatnonzero(np.diff(time[whole], prepend=last) < 0)
        if back.size:
            at = row + int(np.flatnonzero(whole)[back[0]]) + (file.first_line or 1)
            raise GtauError(
                f"{path}, {'row' if file.first_line is None else 'line'} {at}: the time of the {what} goes back; cut "
                "the log there into two runs, or correct the column."
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
    if apart <= CLOSE * min(steps) and len(rows) == len(clock):
        return Aligned(own, commands, longest, rows, None)
    said = {"signal": what, "rate": 1 / steps[1], "position_rate": 1 / steps[0], "apart": apart * 1e3}
    aligned = Finding(F.ALIGNED, values={**said, "left_out": len(clock) - len(rows)})
    return Aligned(own, commands, longest, rows, aligned)


def instants(signals: Signals, stamps: np.ndarray, scale: float, row: int) -> np.ndarray:
    """Compute the times (M,) in s of rows from ``row`` on, from their time columns (M, 0 to 2) or the given rate."""
    if isinstance(signals.time, SampleRate):
        return np.arange(row, row + len(stamps)) / signals.time.rate
    return seconds(stamps, scale)


def seconds(stamps: np.ndarray, scale: float) -> np.ndarray:
    """Convert one column, or two with seconds and nanoseconds, to times (M,) in s."""
    return stamps[:, 0] * scale if stamps.shape[1] == 1 else stamps[:, 0] + stamps[:, 1] * 1e-9


def _distances(time: np.ndarray, stamps: np.ndarray) -> float:
    """Compute the typical distance in s from an instant to the closest stamp."""
    found = []
    for span in spans(len(time)):
        part = block(time, *span)
        after = np.clip(np.searchsorted(stamps, part), 1, len(stamps) - 1)
        found.append(np.median(np.minimum(np.abs(part - stamps[after - 1]), np.abs(stamps[after] - part))))
    return float(np.median(found))
