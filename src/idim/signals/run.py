"""A run: what one log says, checked, in SI units and on a uniform grid."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from idim.errors import IdimError
from idim.signals.checks import check
from idim.signals.columns import SampleRate, Signals, Units, as_signals, as_units
from idim.signals.experiment import Payload, as_payload
from idim.signals.log_file import LogFile, read_log
from idim.signals.samples import Source
from idim.signals.storage import block, spans, store

SI = {"rad": 1.0, "deg": np.pi / 180, "m": 1.0, "mm": 1e-3, "A": 1.0, "mA": 1e-3, "N m": 1.0, "Nm": 1.0, "N": 1.0}
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


Stamps = tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Log:
    """Where a run was read from: the paths of one log or two, their columns and units, and their sizes and times."""

    paths: tuple[Path, ...]
    signals: Signals
    units: Units
    stamps: Stamps


@dataclass(frozen=True, eq=False)
class Run:
    """Sampled positions and commands of the actuated joints.

    ``time`` (N,) in s, uniform; ``position`` (N, n) in rad or m; ``command`` (N, n), the current
    references in A or, where ``kind`` says so, torques in N m (forces in N). Where ``valid`` (N, n) is
    false the joint's sample was interpolated or clipped. ``notes`` say what was repaired.

    The arrays of a long log lie in a file, of which NumPy reads what is looked at. A run that was read from a ``log``
    is pickled as that, and read again (once in a process) where it arrives.
    """

    name: str
    joints: tuple[str, ...]
    time: np.ndarray = field(repr=False)
    position: np.ndarray = field(repr=False)
    command: np.ndarray = field(repr=False)
    kind: Literal["current", "torque"] = "current"
    payload: Payload | None = None
    notes: tuple[str, ...] = ()
    valid: np.ndarray = field(default_factory=lambda: np.ones((0, 0), dtype=bool), repr=False)
    log: Log | None = field(default=None, init=False, repr=False)  # what is made by dataclasses.replace has none

    def __post_init__(self) -> None:
        shape = (len(self.time), len(self.joints))
        if self.valid.size == 0:
            object.__setattr__(self, "valid", np.broadcast_to(True, shape))
        if self.position.shape != shape or self.command.shape != shape or self.valid.shape != shape:
            raise IdimError(
                f"run '{self.name}': positions {self.position.shape}, commands {self.command.shape} and what is valid "
                f"{self.valid.shape} must all have the shape {shape}, samples by joints."
            )

    @property
    def rate(self) -> float:
        """Sampling rate, Hz."""
        return (len(self.time) - 1) / float(self.time[-1] - self.time[0])

    def __reduce_ex__(self, protocol: Any) -> Any:
        if self.log is None:
            return super().__reduce_ex__(protocol)
        signals, units = self.log.signals.model_dump_json(), self.log.units.model_dump_json()
        return _again, (self.log.paths, self.log.stamps, signals, units, self.joints, self.payload)


def read_run(
    log: str | Path | Sequence[str | Path],
    signals: Signals | Mapping[str, Any],
    payload: Payload | Mapping[str, Any] | None = None,
    units: Units | Mapping[str, Any] | None = None,
    progress: Callable[[float], None] = lambda done: None,
) -> Run:
    """Read the log of one run.

    Parameters
    ----------
    log : path or two paths
        A CSV or Parquet file (or a folder of the latter), or one with the positions (and the time) and one with the
        commands.
    signals, payload, units : mapping
        As under these keys of an experiment file.
    progress : callable, optional
        Called with the part of the log that has been read.

    Returns
    -------
    Run
        Its ``notes`` say what was repaired. The joints stand in the order of `signals`.

    Raises
    ------
    IdimError
        A file cannot be read, lacks a column, or fails the checks of :func:`idim.signals.checks.check`.
    """
    signals, units = as_signals(signals), as_units(units)
    paths = tuple([Path(log)] if isinstance(log, (str, Path)) else [Path(each) for each in log])
    if len(paths) not in (1, 2):
        raise IdimError(f"a run has {len(paths)} logs; give one, or two with the positions and the {signals.kind}s.")
    times = () if isinstance(signals.time, SampleRate) else (signals.time,)
    positions, commands = (
        [columns[joint] for joint in signals.joints] for columns in (signals.position, signals.command)
    )
    if len(paths) == 1 and set(positions) & set(commands):
        raise IdimError(
            f"{paths[0]}: the column '{min(set(positions) & set(commands))}' is given both as a position and as a "
            f"{signals.kind}; correct one of the two."
        )
    files = [read_log(paths[0], (*times, *positions, *(commands if len(paths) == 1 else ())))]
    if len(paths) == 2:
        files.append(read_log(paths[1], commands))
    stamps = _stamps(paths)
    beside = [(k, name) for k, file in enumerate(files) for name in file.names]
    wanted = [*((0, name) for name in positions), *((len(files) - 1, name) for name in commands)]
    wanted += [(0, name) for name in times]
    scale = [SI[units.of_position(joint) or "rad"] for joint in signals.joints]
    scale += [SI[units.current or units.torque or "A"]] * len(commands) + [SECONDS[units.time or "s"]] * len(times)
    order = [beside.index(column) for column in wanted]

    def blocks() -> Iterator[np.ndarray]:
        rows = 0
        for values, done in _side_by_side(files):
            progress(done)
            found = values[:, order] * scale
            if isinstance(signals.time, SampleRate):
                found = np.column_stack([found, np.arange(rows, rows + len(found)) / signals.time.rate])
            rows += len(found)
            yield found

    source = Source(
        name=" and ".join(str(path) for path in paths),
        joints=signals.joints,
        columns=(*positions, *commands, *(times or ("rate",))),
        texts=ChainMap(*(file.texts for file in reversed(files))),
        first_line=files[0].first_line,
        line_word=files[0].line_word,
    )
    uniform = check(source, blocks())
    run = Run(
        name=paths[0].stem,
        joints=signals.joints,
        time=uniform.time,
        position=uniform.position,
        command=uniform.command,
        kind=signals.kind,
        payload=as_payload(payload),
        notes=uniform.notes,
        valid=uniform.valid,
    )
    return _from(Log(paths, signals, units, stamps), run)


def _side_by_side(files: Sequence[LogFile]) -> Iterator[tuple[np.ndarray, float]]:
    """Rows of logs that were sampled together, with the part of the first that is then done."""
    streams = [file.blocks() for file in files]
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
        raise IdimError(
            f"{files[0].path} has {rows[0]} rows but {files[1].path} has {rows[1]}; "
            "give two logs that were sampled together."
        )


def _from(log: Log | None, run: Run) -> Run:
    object.__setattr__(run, "log", log)
    return run


def _again(
    paths: tuple[Path, ...],
    stamps: Stamps,
    signals: str,
    units: str,
    joints: tuple[str, ...],
    payload: Payload | None,
) -> Run:
    """A run read in this process, with this payload; raises IdimError where its logs have changed since."""
    run = _read_once(paths, stamps, signals, units, joints)
    return _from(run.log, replace(run, payload=payload))


def _stamps(paths: Sequence[Path]) -> Stamps:
    """Sizes in bytes and times of change in ns of the files at ``paths``, and of those in folders."""
    files = [each for path in paths for each in (sorted(path.iterdir()) if path.is_dir() else [path]) if each.is_file()]
    return tuple((status.st_size, status.st_mtime_ns) for status in (each.stat() for each in files))


@lru_cache(maxsize=4)
def _read_once(paths: tuple[Path, ...], stamps: Stamps, signals: str, units: str, joints: tuple[str, ...]) -> Run:
    if _stamps(paths) != stamps:
        raise IdimError(
            f"the log {' or '.join(str(path) for path in paths)} is not the one that was read where this was begun, "
            "or has changed since; share the folder, or copy logs with their times, and run again."
        )
    columns, scales = Signals.model_validate_json(signals), Units.model_validate_json(units)
    return arrange(read_run(paths, columns, None, scales), joints)


def arrange(run: Run, joints: Sequence[str]) -> Run:
    """Order a run's columns as `joints`, a robot's actuated ones.

    Raises
    ------
    IdimError
        The run lacks one of them or has others.
    """
    if set(run.joints) != set(joints) or len(run.joints) != len(joints):
        raise IdimError(
            f"run '{run.name}' has the joints {', '.join(run.joints)}, but the robot's actuated joints are "
            f"{', '.join(joints)}; give signals for exactly these."
        )
    order = [run.joints.index(joint) for joint in joints]
    if order == list(range(len(order))):
        return run
    ordered = replace(
        run,
        joints=tuple(joints),
        position=_columns(run.position, order),
        command=_columns(run.command, order),
        valid=_columns(run.valid, order),
    )
    return _from(run.log, ordered)


def _columns(array: np.ndarray, order: list[int]) -> np.ndarray:
    parts = (block(array, *span)[:, order] for span in spans(len(array)))
    return store(parts, array.shape[1:], array.dtype.type)
