"""The logs of a run, one file or two that were sampled together, as samples in SI units."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gtau.documents.kinds import LOG, refuse_other_kind
from gtau.errors import GtauError
from gtau.signals.columns import SampleRate, Signals, Units
from gtau.signals.log_file import ALL, LogFile, Place, read_log
from gtau.signals.samples import Source

SI = {"rad": 1.0, "deg": np.pi / 180, "m": 1.0, "mm": 1e-3, "A": 1.0, "mA": 1e-3, "N m": 1.0, "Nm": 1.0, "N": 1.0}
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


@dataclass(frozen=True, eq=False)
class Logged:
    """The logs of a run, found but not yet read.

    ``order`` and ``scale`` (2n or 2n + 1) make positions, commands and times in SI units of the ``files``' columns
    side by side; ``rate`` (Hz) stands for a time column that there is not.
    """

    files: tuple[LogFile, ...]
    source: Source
    order: tuple[int, ...]
    scale: tuple[float, ...]
    rate: float | None

    @property
    def places(self) -> tuple[tuple[Place, ...], ...]:
        """Of each file, as far as it has been read, rows and the bytes at which they begin."""
        return tuple(tuple(file.places) for file in self.files)

    def blocks(
        self,
        rows: range = ALL,
        places: Sequence[Place] | None = None,
        progress: Callable[[float], None] = lambda done: None,
    ) -> Iterator[np.ndarray]:
        """Samples (M, 2n + 1) in order: positions, commands and time.

        Parameters
        ----------
        rows : range
            Those wanted.
        places : sequence, optional
            Where each file is to be read from: a row, at or before the first of them, and its byte.
        progress : callable
            Called with the part of the log that has been read.

        Raises
        ------
        GtauError
            Where a file cannot be read on, or two files have different lengths.
        """
        row = rows.start
        for values, done in _side_by_side(self.files, rows, places or [(0, 0)] * len(self.files)):
            progress(done)
            found = values[:, self.order] * self.scale
            if self.rate is not None:
                found = np.column_stack([found, np.arange(row, row + len(found)) / self.rate])
            row += len(found)
            yield found


def find_logs(paths: Sequence[Path], signals: Signals, units: Units) -> Logged:
    """Find the columns of a run in its logs; raises GtauError."""
    if len(paths) not in (1, 2):
        raise GtauError(f"a run has {len(paths)} logs; give one, or two with the positions and the {signals.kind}s.")
    for path in paths:
        if not path.is_dir():  # a folder may hold the parts of a log
            refuse_other_kind(path, LOG)
    times = () if isinstance(signals.time, SampleRate) else (signals.time,)
    positions, commands = (
        [columns[joint] for joint in signals.joints] for columns in (signals.position, signals.command)
    )
    if len(paths) == 1 and set(positions) & set(commands):
        raise GtauError(
            f"{paths[0]}: the column '{min(set(positions) & set(commands))}' is given both as a position and as a "
            f"{signals.kind}; correct one of the two."
        )
    files = [read_log(paths[0], (*times, *positions, *(commands if len(paths) == 1 else ())))]
    if len(paths) == 2:
        files.append(read_log(paths[1], commands))
    beside = [(k, name) for k, file in enumerate(files) for name in file.names]
    wanted = [*((0, name) for name in positions), *((len(files) - 1, name) for name in commands)]
    wanted += [(0, name) for name in times]
    scale = [SI[units.of_position(joint) or "rad"] for joint in signals.joints]
    scale += [SI[units.current or units.torque or "A"]] * len(commands) + [SECONDS[units.time or "s"]] * len(times)
    source = Source(
        name=" and ".join(str(path) for path in paths),
        joints=signals.joints,
        columns=(*positions, *commands, *(times or ("rate",))),
        texts=ChainMap(*(file.texts for file in reversed(files))),
        first_line=files[0].first_line,
        line_word=files[0].line_word,
    )
    return Logged(
        files=tuple(files),
        source=source,
        order=tuple(beside.index(column) for column in wanted),
        scale=tuple(scale),
        rate=signals.time.rate if isinstance(signals.time, SampleRate) else None,
    )


def _side_by_side(
    files: Sequence[LogFile], wanted: range, places: Sequence[Place]
) -> Iterator[tuple[np.ndarray, float]]:
    """Rows of logs that were sampled together, with the part of the first that is then done."""
    streams = [file.blocks(wanted, place) for file, place in zip(files, places, strict=True)]
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
            f"{files[0].path} has {rows[0]} rows but {files[1].path} has {rows[1]}; "
            "give two logs that were sampled together."
        )
