"""Logs of a run, one or two files of any format, as samples in SI units; poses and side signals beside these."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from gtau.documents.expressions import columns_in
from gtau.documents.files import system_refusals
from gtau.errors import GtauError, meant
from gtau.extensions import find
from gtau.findings import Finding, moment
from gtau.signals.channel import LINK_SIDE, SIDE_SIGNALS, SideValues
from gtau.signals.reading.body_columns import at_origins
from gtau.signals.reading.column_names import split_name
from gtau.signals.reading.columns import PRESETS, Signals
from gtau.signals.reading.formats import ALL, MOST_COLUMNS, LogTable, interpolated, listed, reading
from gtau.signals.reading.formats.columnar import INFO
from gtau.signals.reading.formats.rosbag import LOG_FORMATS as BAGS
from gtau.signals.reading.formats.text import open_text
from gtau.signals.reading.samples import WHOLE, Part, Samples, complete, with_signs
from gtau.signals.reading.units import SI, Units, si_factor
from gtau.signals.storage import block, blocks, spans, store

GROUP = "gtau.log_formats"  # of the entry points of other distributions


def reader_of(ending: str) -> Callable[[Path], LogTable] | None:
    """Find the reader of files whose name has an ending (``.npz``); None where it has none of its own."""
    return cast("Callable[[Path], LogTable] | None", find(GROUP, "gtau.signals.reading.formats", ending, Callable))


def read_log(path: str | Path, names: Iterable[str]) -> LogTable:
    """Locate columns of a log by name, or sums and products of them; raises GtauError where it lacks one."""
    table = find_columns(Path(path))
    names = tuple(dict.fromkeys(names))
    known = {*table.columns}
    sums = {name: parts for name in names if name not in known and (parts := _parts(name, known, table.path))}
    _refuse_missing([part for name in names for part in sums.get(name, (name,))], table)
    return replace(table, columns=names, sums=sums)


def _parts(name: str, known: set[str], path: Path) -> tuple[str, ...]:
    """List the columns in a sum or product; none for a mere name, which the log lacks."""
    try:
        parts = columns_in(name)
    except ValueError as error:
        if not known.isdisjoint(re.findall(r"\w+", name)):
            odd = "a column whose name is not of letters, digits and _ alone stands between backticks, as `J 3`"
            raise GtauError(f"{error}; {odd}.", source=path) from None
        return ()
    return parts if "`" in name or not known.isdisjoint(parts) else ()


def find_columns(path: Path) -> LogTable:
    """Find all columns of a log, whatever its format; raises GtauError where it cannot be read."""
    for part in (part for pattern in ("*", "data/*/*") for part in path.glob(pattern)):
        with system_refusals(part):  # a pipe would be read for ever
            pass
    with system_refusals(path):
        ending = path.suffix.lower()
        if path.is_dir():
            ending = ".db3" if is_rosbag(path) else ".parquet"
        else:
            path.open("rb").close()  # the system's reason, not a library's, where there is no such file
        table = (reader_of(ending) or open_text)(path)
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


def _refuse_missing(names: Collection[str], table: LogTable) -> None:
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
        there = f"the columns are {listed(columns, 40)}"
        if table.numbered:
            there = (
                f"the file has no header, so its {len(columns)} columns are named 1 to {len(columns)}; copy the line "
            )
            there += "with the names from a log that has one, or give these numbers"
        elif hint := meant(name, [column for column in columns if column not in names]):
            there = f"{hint} T{there[1:]}"
        raise GtauError(f"there is no column '{name}'; {there}.", source=path)


def read_logs(
    paths: Sequence[Path],
    signals: Signals,
    units: Units,
    notes: list[Finding],
    part: Part = WHOLE,
    progress: Callable[[float], None] = lambda done: None,
) -> Samples:
    """Read the complete samples of a part of a run from its logs, with ``notes`` on what was left out or aligned."""
    if len(paths) not in (1, 2):
        raise GtauError(f"a run has {len(paths)} logs; give one, or two with the positions and the {signals.kind}s.")
    path, base, stamped = paths[0], signals.base, bool(signals.command_time_columns)
    positions = [*signals.position.values(), *(base.pose if base else ())]
    commands = list(signals.measured)
    if len(paths) == 1 and (twice := set(positions) & set(commands)):
        raise GtauError(
            f"the column '{min(twice)}' is given both as a position and as a {signals.kind}; correct one of the two.",
            source=path,
        )
    position_scale, command_scale, time_scale = units.scale(signals)
    scale = np.array([*position_scale, *command_scale])
    beside = commands if len(paths) == 1 and not stamped else []
    table = read_log(path, (*signals.time_columns, *positions, *beside))
    files, rows = [table], part.rows(table)
    if len(paths) == 2 and not stamped:
        files.append(replace(read_log(paths[1], commands), texts=table.texts))
    _refuse_unstated_units(files, signals, units)
    notes += [note.from_source(file.path.name) if len(files) > 1 else note for file in files for note in file.notes]
    commands_at = None
    if stamped:
        inside, commands_at = _aligned(path, paths[-1], signals, time_scale, notes)
        rows = inside[rows.start : rows.stop]
    columns = [(0, name) for name in positions] + [(len(files) - 1, name) for name in commands if not stamped]

    def parts() -> Iterator[tuple[int, np.ndarray]]:
        for row, values, done in _timed(files, columns, signals.rate or signals.time_columns, time_scale, rows):
            progress(done)
            logged, time = values[:, :-1], values[:, -1]
            if commands_at is not None:
                between = commands_at(time)
                between[np.isnan(logged).all(axis=1)] = np.nan  # rows that hold other topics
                logged = np.hstack([logged, between])
            yield row, np.column_stack([_converted(signals, logged * scale), time])

    named = (*_labels(signals), " and ".join(signals.time_columns) or "rate")
    name = " and ".join(map(str, paths))
    samples = complete(name, signals.channels, named, table, parts(), notes, part)
    notes += [note for file in files for note in file.notes if note not in notes]  # on what was found in reading
    joints = list(signals.position)
    scales = dict(zip(joints, position_scale, strict=False)), dict(zip(joints, command_scale, strict=False))
    return with_signs(samples, scales, notes)


def _refuse_unstated_units(files: Sequence[LogTable], signals: Signals, units: Units) -> None:
    """Refuse columns whose unit, by name or log, is not SI if the experiment file states none."""
    written = {name: unit for file in files for name, unit in file.units.items()}
    columns = [("position", *pair) for pair in signals.position.items()]
    columns += [("supply_current" if signals.supplied else signals.kind, *pair) for pair in signals.command.items()]
    columns += [(kind.calibration, *pair) for kind in LINK_SIDE for pair in signals.sensors(kind).items()]
    if len(signals.time_columns) == 1 and "units" not in PRESETS.get(signals.preset or "", {}):
        columns += [("time", "", column) for column in signals.time_columns]
    sums = {name: parts for file in files for name, parts in file.sums.items()}
    for key, joint, column in ((key, joint, part) for key, joint, name in columns for part in sums.get(name, (name,))):
        *_, split = split_name(column, [joint] if joint else [], written.get(column))
        unit = "" if split is None else split.text
        if unit and unit not in SI and units.stated(key, joint) is None:
            raise GtauError(
                f"column '{column}' is in '{unit}' by the log, but the experiment file states no unit; write units: "
                f"{{{key}: {unit}}}, or the SI unit if the log is wrong. Of counts state the size of one, as in "
                "'0.0012 A'; of shares the rated values, too.",
                source=files[0].path,
            )


def _converted(signals: Signals, values: np.ndarray) -> np.ndarray:
    """Prepend the base's six coordinates to positions, pose, commands and wrenches (M, .); move the wrenches."""
    base, acting = signals.base, signals.all_wrenches
    if base is None and not acting:
        return values
    joints, pose = len(signals.position), len(base.pose) if base else 0
    ends = np.cumsum([joints, pose, len(signals.modelled)])
    q, base_pose, commands, wrenches = np.split(values, ends, axis=1)
    wrenches = at_origins(acting, wrenches, base.yaw if base else 0.0)
    if base is None:
        return np.hstack([q, commands, wrenches])
    return np.hstack([base.positions(base_pose), q, np.zeros((len(values), len(base.joints))), commands, wrenches])


def _labels(signals: Signals) -> Iterator[str]:
    base = signals.base
    yield from (*(base.labels if base else ()), *signals.position.values())
    yield from ["no motor"] * (len(base.joints) if base else 0)
    yield from signals.modelled
    yield from (label for wrench in signals.all_wrenches for label in wrench.labels)


Clock = Sequence[str] | float  # columns of the time, or the rate (Hz) of a log without one


def _timed(
    files: Sequence[LogTable], columns: Sequence[tuple[int, str]], clock: Clock, scale: float, rows: range = ALL
) -> Iterator[tuple[int, np.ndarray, float]]:
    """Yield the first row's number, columns of files (M, .) with the time in s behind them, and the fraction read."""
    names = [(k, name) for k, file in enumerate(files) for name in file.columns]
    order = [names.index(column) for column in columns]
    stamps = () if isinstance(clock, float) else clock
    at_times = [names.index((0, name)) for name in stamps]
    row = rows.start
    for values, done in _side_by_side(files, rows):
        _refuse_clocks(files[0].path, {name for file in files for name in file.clocks}, stamps, scale)
        if isinstance(clock, float):
            time = np.arange(row, row + len(values)) / clock
        else:
            seconds, *nanoseconds = values[:, at_times].T
            time = seconds + nanoseconds[0] * 1e-9 if nanoseconds else seconds * scale
        yield row, np.column_stack([values[:, order], time]), done
        row += len(values)


def _refuse_clocks(path: Path, clocks: set[str], times: Sequence[str], scale: float) -> None:
    """Refuse columns of dates, clock times or durations that are not the time, or have a unit; raises GtauError."""
    if wrong := clocks.difference(times if len(times) == 1 else ()):
        remedy = "add it to the other (time: DATE + TIME)" if wrong & {*times} else "give the column that holds numbers"
        raise GtauError(f"column '{min(wrong)}' holds dates, clock times or durations; {remedy}.", source=path)
    if clocks and scale != 1.0:
        text = f"column '{min(clocks)}' holds dates, clock times or durations, which are read in s"
        raise GtauError(f"{text}; remove the unit of the time (units: time).", source=path)


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
        both = np.full((stop - start, sum(log.shape[1] for log in logs)), np.nan)
        for log, columns in zip(logs, np.split(both, [logs[0].shape[1]], axis=1), strict=True):
            part = block(log, start, stop)
            columns[: len(part)] = part
        yield both, stop / max(counts)


CLOSE = 0.01  # of a step: stamps that differ by less are the same, up to rounding


def _aligned(
    path: Path, other_path: Path, signals: Signals, scale: float, notes: list[Finding]
) -> tuple[range, Callable[[np.ndarray], np.ndarray]]:
    """Find the rows of positions between the first and last command, and a function that interpolates commands."""
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
    after = (np.clip(np.searchsorted(stamps, part), 1, len(stamps) - 1) for part in blocks(finite))
    pairs = zip(blocks(finite), after, strict=True)
    gaps = (np.minimum(np.abs(part - stamps[k - 1]), np.abs(stamps[k] - part)) for part, k in pairs)
    apart = float(np.median([np.median(gap) for gap in gaps]))
    if apart > CLOSE * min(steps) or len(rows) < len(clock):
        text = (
            f"aligned the {what} with the positions by linear interpolation between their stamps ({1 / steps[1]:.4g} "
            f"Hz; positions {1 / steps[0]:.4g} Hz; typically {apart * 1e3:.2g} ms from a position to the nearest)"
        )
        if left_out := len(clock) - len(rows):
            text += f"; left out {left_out} positions before the first or after the last of them"
        notes.append(reading("aligned commands", text=text))
    return rows, partial(interpolated, log, max(steps))


def _stamped(path: Path, stamps: Sequence[str], commands: Sequence[str], scale: float, what: str) -> np.ndarray:
    """Read the complete rows of commands and their time in s, (K, 1 + c); of equal stamps the first."""
    file, parts, last = read_log(path, (*stamps, *commands)), list[np.ndarray](), -np.inf
    for row, values, _ in _timed([file], [(0, name) for name in commands], stamps, scale):
        complete = np.isfinite(values).all(axis=1)
        steps = np.diff(values[complete, -1], prepend=last)
        if (steps < 0).any():
            at = row + int(np.flatnonzero(complete)[np.argmax(steps < 0)])
            raise GtauError(
                f"{path}, {file.places([at], 1)}: the time of the {what} goes back; cut the log there into two runs, "
                "or correct the column."
            )
        last = values[complete, -1].max(initial=last)
        parts.append(np.roll(values[complete][steps > 0], 1, axis=1))
    if (count := sum(map(len, parts))) < 2:
        raise GtauError(f"{path} has {count} complete rows of {what}; give the log and columns that hold them.")
    return store(parts, (1 + len(commands),))


def logged_instants(path: Path, signals: Signals, scale: float) -> np.ndarray:
    """Read the times in s of all rows of a log, (N,); ``scale`` converts their columns."""
    table = read_log(path, signals.time_columns or list(signals.position.values())[:1])
    return store(values[:, -1] for _, values, _ in _timed([table], [], signals.rate or signals.time_columns, scale))


FEWEST = 20  # rows of a run that hold a pose
KEPT = 2000  # instants of a run, of slow side signals


@dataclass(frozen=True, eq=False)
class LoggedPoses:
    """Complete rows of a log: ``time`` (N,), ``q`` (N, n), and ``values`` (N, .) of the columns of a pose; SI units."""

    run: str
    time: np.ndarray
    q: np.ndarray
    values: np.ndarray


def read_poses(paths: Sequence[Path], signals: Signals, units: Units, part: Part = WHOLE) -> LoggedPoses:
    """Read the poses of a run from the log of its positions; raises GtauError where hardly any row holds one."""
    pose, path = signals.pose, Path(paths[0])
    assert pose is not None  # checked by the caller
    n = len(signals.joints)
    columns = [*signals.position.values(), *pose.columns]
    scale = [*units.scale(signals)[0], *units.pose.scale(pose), 1.0]
    rows = _complete_rows(path, columns, signals, units, part, "pose", scale)
    return LoggedPoses(path.stem + part.label, rows[:, -1], rows[:, :n], rows[:, n:-1])


def read_side_signals(
    path: Path, signals: Signals, units: Units, notes: list[Finding], part: Part = WHOLE
) -> dict[str, SideValues]:
    """Read the side signals of a run, by key, from the log of its positions; slow ones as means over ``KEPT`` parts.

    A supply voltage may be a number, V; a note lists what was read.
    """
    values, read = {}, []
    for signal in SIDE_SIGNALS:
        by_joint = signals.side_columns(signal)
        columns = list(dict.fromkeys(by_joint.values()))
        if not columns:
            continue
        unit, joints = getattr(units, signal.key), dict[str, np.ndarray]()
        shown = unit or ("in the unit of positions" if signal.position else signal.units[0])
        read.append(f"{signal.key} ({shown}) {listed(columns)}")
        constant = signal.key == "supply_voltage" and all(re.fullmatch(r"\d+\.?\d*", column) for column in columns)
        if constant and not {*columns} & {*find_columns(path).columns}:
            rows = np.array([[*map(float, columns), 0.0]])
        else:
            rows = _complete_rows(path, columns, signals, units, part, signal.key)
        if signal.slow:
            rows = np.array([some.mean(axis=0) for some in np.array_split(rows, min(KEPT, len(rows)))])
        for joint, column in by_joint.items():
            own = units.position_unit(joint) if signal.position and not unit else None
            joints[joint] = (si_factor(own, "position") if own else 1.0) * rows[:, columns.index(column)]
        values[signal.key] = SideValues(rows[:, -1], joints, unit or signal.units[0])
    if read:
        notes.append(reading("side signals", text=f"beside positions and {signals.kind}s are read {'; '.join(read)}"))
    return values


def _complete_rows(
    path: Path, columns: Sequence[str], signals: Signals, units: Units, part: Part, key: str, scale: ArrayLike = 1.0
) -> np.ndarray:
    """Read the rows that hold a number in all columns of a ``key`` of the signals: these and the time in s, scaled."""
    table = read_log(path, (*signals.time_columns, *columns))
    clock, wanted = signals.rate or signals.time_columns, [(0, name) for name in columns]
    timed = _timed([table], wanted, clock, units.scale(signals)[2], part.rows(table))
    parts = part.of((row, values) for row, values, _ in timed)
    rows = store((values[np.isfinite(values).all(axis=1)] * scale for _, values in parts), (len(columns) + 1,))
    if len(rows) < (FEWEST if key == "pose" else 1):
        text = f"{len(rows)} rows hold a number in all {key} columns ({', '.join(columns)})"
        raise GtauError(f"{text}; correct them, or remove '{key}' from the signals.", source=path)
    return rows
