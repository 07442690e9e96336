"""Logs of a run: files of any format, one or two of them, as samples in SI units.

Commands with separate time stamps are interpolated.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np

from gtau.documents.files import system_refusals
from gtau.errors import GtauError, short
from gtau.extensions import find
from gtau.findings import Finding
from gtau.findings.words import moment
from gtau.signals.reading.body_columns import at_origins
from gtau.signals.reading.columns import Signals
from gtau.signals.reading.formats import MOST_COLUMNS, LogTable
from gtau.signals.reading.formats.columnar import INFO
from gtau.signals.reading.formats.rosbag import LOG_FORMATS as BAGS
from gtau.signals.reading.formats.text import open_text
from gtau.signals.reading.notes import reading
from gtau.signals.reading.registers import with_signs
from gtau.signals.reading.samples import WHOLE, Part, Samples, complete
from gtau.signals.reading.units import Units, refuse_unstated_units
from gtau.signals.storage import Store, block, blocks, spans, store

GROUP = "gtau.log_formats"
"""Of the entry points of other distributions."""


def reader_of(ending: str) -> Callable[[Path], LogTable] | None:
    """Find the reader of files whose name has an ending (``.npz``); None where it has none of its own."""
    reader = find(GROUP, "gtau.signals.reading.formats", ending, Callable)
    return cast("Callable[[Path], LogTable] | None", reader)


def read_log(path: str | Path, names: Iterable[str]) -> LogTable:
    """Locate columns of a log by name, unchecked; raises GtauError where it cannot be read, or lacks one."""
    table = find_columns(Path(path))
    names = tuple(dict.fromkeys(names))
    _refuse_missing(names, table)
    return replace(table, columns=names)


def find_columns(path: Path) -> LogTable:
    """Find all columns of a log, whatever its format; raises GtauError where it cannot be read."""
    for part in (part for pattern in ("*", "data/*/*") for part in path.glob(pattern)):
        with system_refusals(part):  # a pipe would be read for ever
            pass
    with system_refusals(path):
        if not path.is_dir():
            path.open("rb").close()  # the system's reason, not a library's, where there is no such file
        folder_ending = ".db3" if is_rosbag(path) else ".parquet"
        reader = reader_of(folder_ending if path.is_dir() else path.suffix.lower()) or open_text
        table = reader(path)
    if len(table.columns) > MOST_COLUMNS:
        raise GtauError(
            f"it has {len(table.columns)} columns, and at most {MOST_COLUMNS} are read; export the signals alone.",
            source=path,
        )
    return table


def is_log_folder(path: Path) -> bool:
    """Decide whether a folder is one log: a rosbag2, Parquet files, or a LeRobot data set."""
    return any((path / name).is_file() for name in ("metadata.yaml", INFO)) or any(path.glob("*.parquet"))


def is_rosbag(path: Path) -> bool:
    """Decide by its name whether a path is a bag."""
    return path.suffix.lower() in BAGS or (path / "metadata.yaml").is_file()


def _refuse_missing(names: Iterable[str], table: LogTable) -> None:
    path, columns = table.path, table.columns
    if not columns:
        raise GtauError(
            f"{path} holds no columns of numbers; save the signals as plain numeric arrays, not as objects such as "
            "tables or time series."
        )
    counts = Counter(columns)
    for name in names:
        if counts[name] > 1:
            raise GtauError(f"{path} has {counts[name]} columns named '{name}'; rename them.")
        if counts[name]:
            continue
        if table.numbered:
            raise GtauError(
                f"there is no column '{name}'; the file has no header, so its {len(columns)} columns are named "
                f"1 to {len(columns)}.",
                source=path,
            )
        close = get_close_matches(name, columns, n=1)
        hint = f"did you mean '{close[0]}'? The" if close else "the"
        listed = ", ".join(map(short, columns[:40])) + (", ..." if len(columns) > 40 else "")
        raise GtauError(f"there is no column '{name}'; {hint} columns are {listed}.", source=path)


LONGEST_STEP = 3.0  # usual steps of the commands, beyond which they are not interpolated but missing
CLOSE = 0.01  # of a step: stamps that differ by less are the same, up to rounding


def read_logs(
    paths: Sequence[Path],
    signals: Signals,
    units: Units,
    notes: list[Finding],
    part: Part = WHOLE,
    progress: Callable[[float], None] = lambda done: None,
) -> Samples:
    """Read the complete samples of a part of a run from its logs; raises GtauError.

    ``notes`` report what was left out or aligned; ``progress`` is called with the part of the log that has been read.
    """
    if len(paths) not in (1, 2):
        raise GtauError(f"a run has {len(paths)} logs; give one, or two with the positions and the {signals.kind}s.")
    times, stamps, base = signals.time_columns, signals.command_time_columns, signals.base
    positions, commands = [*signals.position.values(), *(base.pose if base else ())], list(signals.measured)
    if len(paths) == 1 and (twice := set(positions) & set(commands)):
        raise GtauError(
            f"the column '{min(twice)}' is given both as a position and as a {signals.kind}; correct one of the two.",
            source=paths[0],
        )
    position_scale, command_scale, time_scale = units.scale(signals)
    table = read_log(paths[0], (*times, *positions, *(commands if len(paths) == 1 and not stamps else ())))
    files, rows, commands_at = [table], part.rows(table), None
    if len(paths) == 2 and not stamps:
        files.append(replace(read_log(paths[1], commands), texts=table.texts))
    refuse_unstated_units(files, signals, units)
    notes += [note.from_source(file.path.name) if len(files) > 1 else note for file in files for note in file.notes]
    if stamps:
        inside, commands_at = _aligned(paths[0], paths[-1], signals, time_scale, notes)
        rows = inside[rows.start : rows.stop]
    columns = [(k, name) for k, file in enumerate(files) for name in file.columns]
    wanted = [(0, name) for name in positions] + [(len(files) - 1, name) for name in commands if not stamps]
    order, at_times = [columns.index(column) for column in wanted], [columns.index((0, name)) for name in times]

    def parts() -> Iterator[tuple[int, np.ndarray]]:
        row = rows.start
        for values, done in _side_by_side(files, rows):
            progress(done)
            time = instants(signals, values[:, at_times], time_scale, row)
            logged = values[:, order]
            if commands_at is not None:
                between = commands_at(time)
                between[np.isnan(logged).all(axis=1)] = np.nan  # rows that hold other topics
                logged = np.hstack([logged, between])
            yield row, np.column_stack([_converted(signals, logged * [*position_scale, *command_scale]), time])
            row += len(values)

    named = (*_labels(signals), " and ".join(times) or "rate")
    empty = Samples(" and ".join(map(str, paths)), signals.channels, named, table)
    joints = list(signals.position)
    scales = dict(zip(joints, position_scale, strict=False)), dict(zip(joints, command_scale, strict=False))
    return with_signs(complete(empty, parts(), notes, part), scales, notes)


def _converted(signals: Signals, values: np.ndarray) -> np.ndarray:
    """Prepend the base's six coordinates, whose commands are 0; move the wrenches to the origins of their axes.

    The columns (M, .) hold positions, pose, commands and sensors, and wrenches.
    """
    base, acting = signals.base, signals.all_wrenches
    if base is None and not acting:
        return values
    joints, pose = len(signals.position), len(base.pose) if base else 0
    modelled = len(signals.measured) - sum(len(wrench.columns) for wrench in acting)
    q, base_pose, commands, wrenches = np.split(values, np.cumsum([joints, pose, modelled]), axis=1)
    wrenches = at_origins(acting, wrenches, base.yaw if base else 0.0)
    if base is None:
        return np.hstack([q, commands, wrenches])
    return np.hstack([base.positions(base_pose), q, np.zeros((len(values), len(base.joints))), commands, wrenches])


def _labels(signals: Signals) -> Iterator[str]:
    """Name the columns of positions and channels, for messages."""
    base, acting = signals.base, signals.all_wrenches
    yield from (*(base.labels if base else ()), *signals.position.values())
    yield from ["no motor"] * (len(base.joints) if base else 0)
    yield from signals.measured[: len(signals.measured) - sum(len(wrench.columns) for wrench in acting)]
    yield from (label for wrench in acting for label in wrench.labels)


def _side_by_side(files: Sequence[LogTable], rows: range) -> Iterator[tuple[np.ndarray, float]]:
    """Join rows of logs that were sampled together, with the fraction read so far; one may lack the last row."""
    if len(files) == 1:
        yield from files[0].blocks(rows)
        return
    logs = [store((values for values, _ in file.blocks(rows)), (len(file.columns),)) for file in files]
    counts = [len(log) for log in logs]
    if abs(counts[0] - counts[1]) > 1:
        raise GtauError(
            f"{files[0].path} has {counts[0]} rows but {files[1].path} has {counts[1]}; give two logs that were "
            "sampled together, or the stamps of each (time: {position: COLUMN, command: COLUMN})."
        )
    for start, stop in spans(max(counts)):
        parts = [block(log, start, stop) for log in logs]
        lacking = [[(0, stop - start - len(part)), (0, 0)] for part in parts]
        yield (
            np.hstack([np.pad(part, ends, constant_values=np.nan) for part, ends in zip(parts, lacking, strict=True)]),
            (stop / max(counts)),
        )


def _interpolated(log: np.ndarray, longest: float, time: np.ndarray) -> np.ndarray:
    """Interpolate a ``log`` (K, 1 + c) at instants (M,): commands (M, c), nan in steps longer than ``longest`` (s)."""
    known = np.isfinite(time)
    commands = np.full((len(time), log.shape[1] - 1), np.nan)
    if not known.any():
        return commands
    begin = max(int(np.searchsorted(log[:, 0], np.min(time[known]), side="right")) - 1, 0)
    end = int(np.searchsorted(log[:, 0], np.max(time[known]))) + 1
    stamps, *logged = block(log, begin, end).T
    after = np.clip(np.searchsorted(stamps, time[known], side="left"), 0, len(stamps) - 1)
    before = np.maximum(after - (stamps[after] != time[known]), 0)
    between = (stamps[after] - stamps[before] <= longest) & (stamps[after] >= time[known])
    values = np.column_stack([np.interp(time[known], stamps, command) for command in logged])
    commands[known] = np.where(between[:, None], values, np.nan)
    return commands


def _stamped(path: Path, stamps: Sequence[str], commands: Sequence[str], scale: float, what: str) -> np.ndarray:
    """Read the complete rows of commands and their time in s, (K, 1 + c); of equal stamps the first."""
    file = read_log(path, (*stamps, *commands))
    at_stamps, at_commands = ([file.columns.index(name) for name in names] for names in (stamps, commands))
    parts, row, last, count = [], 0, -np.inf, 0
    for values, _ in file.blocks():
        complete = np.isfinite(values).all(axis=1)
        time = seconds(values[:, at_stamps], scale)
        steps = np.diff(time[complete], prepend=last)
        if (steps < 0).any():
            at = row + int(np.flatnonzero(complete)[np.argmax(steps < 0)]) + (file.first_line or 1)
            raise GtauError(
                f"{path}, {'row' if file.first_line is None else 'line'} {at}: the time of the {what} goes back; cut "
                "the log there into two runs, or correct the column."
            )
        last = float(time[complete][-1]) if complete.any() else last
        complete[complete] = steps > 0
        parts.append(np.column_stack([time[complete], values[np.ix_(complete, at_commands)]]))
        row, count = row + len(values), count + len(parts[-1])
    if count < 2:
        raise GtauError(f"{path} has {count} complete rows of {what}; give the log and columns that hold them.")
    return store(parts, (1 + len(commands),))


def _aligned(
    path: Path, other_path: Path, signals: Signals, scale: float, notes: list[Finding]
) -> tuple[range, Callable[[np.ndarray], np.ndarray]]:
    """Find the rows of positions between the first and the last command, and a function that interpolates the commands.

    ``scale`` converts the columns of both times to s.
    """
    what = f"{signals.kind}s"
    log = _stamped(other_path, signals.command_time_columns, signals.measured, scale, what)
    clock, stamps = logged_instants(path, signals, scale), log[:, 0]
    inside = np.flatnonzero((clock >= stamps[0]) & (clock <= stamps[-1]))
    finite = clock[np.isfinite(clock)]
    if not inside.size or not finite.size:
        spanned = f"{moment(finite[0])} to {moment(finite[-1])}" if finite.size else "no time"
        raise GtauError(
            f"{path} holds positions from {spanned}, but {other_path} {what} from {moment(stamps[0])} to "
            f"{moment(stamps[-1])}: their clocks do not overlap; log both with one clock, or give the logs of one run."
        )
    rows = range(int(inside[0]), int(inside[-1]) + 1)
    steps = [float(np.median(np.diff(time))) for time in (finite, stamps)]
    apart = float(np.median([_distance(part, stamps) for part in blocks(finite)]))
    if apart > CLOSE * min(steps) or len(rows) < len(clock):
        text = (
            f"aligned the {what} with the positions by linear interpolation between their stamps ({1 / steps[1]:.4g} "
            f"Hz; positions {1 / steps[0]:.4g} Hz; typically {apart * 1e3:.2g} ms from a position to the nearest)"
        )
        if left_out := len(clock) - len(rows):
            text += f"; left out {left_out} positions before the first or after the last of them"
        notes.append(reading("aligned commands", text=text))
    return rows, partial(_interpolated, log, LONGEST_STEP * max(steps))


def _distance(time: np.ndarray, stamps: np.ndarray) -> float:
    """Compute the median distance in s from instants to the closest stamp."""
    after = np.clip(np.searchsorted(stamps, time), 1, len(stamps) - 1)
    return float(np.median(np.minimum(np.abs(time - stamps[after - 1]), np.abs(stamps[after] - time))))


def logged_instants(path: Path, signals: Signals, scale: float) -> np.ndarray:
    """Read the times in s of all rows of a log, (N,); ``scale`` converts their columns."""
    table = read_log(path, signals.time_columns or list(signals.position.values())[:1])
    row, times = 0, Store()
    for values, _ in table.blocks():
        times.append(instants(signals, values, scale, row))
        row += len(values)
    return times.array()


def instants(signals: Signals, stamps: np.ndarray, scale: float, row: int) -> np.ndarray:
    """Compute the times (M,) in s of rows from ``row`` on, from their time columns (M, 0 to 2) or the given rate."""
    if signals.rate is not None:
        return np.arange(row, row + len(stamps)) / signals.rate
    return seconds(stamps, scale)


def seconds(stamps: np.ndarray, scale: float) -> np.ndarray:
    """Convert one column, or two with seconds and nanoseconds, to times (M,) in s."""
    return stamps[:, 0] * scale if stamps.shape[1] == 1 else stamps[:, 0] + stamps[:, 1] * 1e-9
