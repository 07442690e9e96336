"""Signals in the rows of a log beside positions and commands: poses and side signals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from gtau.errors import GtauError
from gtau.signals.channel import SIDE_SIGNALS, SideValues
from gtau.signals.reading.columns import Signals
from gtau.signals.reading.logs import instants, read_log
from gtau.signals.reading.samples import WHOLE, Part
from gtau.signals.reading.units import Units
from gtau.signals.storage import store

FEWEST = 20  # rows of a run that hold a pose


@dataclass(frozen=True, eq=False)
class LoggedPoses:
    """Complete rows of a log: ``time`` (N,) in s, ``q`` (N, n) in the order of the signals, ``values`` (N, columns).

    The values are in the order of :attr:`gtau.signals.reading.body_columns.PoseColumns.columns`, SI units.
    """

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
    scale = [*units.scale(signals)[0], *units.pose.scale(pose)]
    table = _complete_rows(path, columns, signals, units, part, scale)
    if len(table) < FEWEST:
        raise GtauError(
            f"{len(table)} rows hold all of the pose ({', '.join(pose.columns)}) and the positions; give the "
            "columns that hold them, or remove 'pose' from the signals.",
            source=path,
        )
    return LoggedPoses(path.stem + part.label, table[:, -1], table[:, :n], table[:, n:-1])


KEPT = 2000  # instants of a run: its effects are slow


def read_side_signals(
    paths: Sequence[Path], signals: Signals, units: Units, part: Part = WHOLE
) -> dict[str, SideValues]:
    """Read the side signals of a run, by key, from the log of its positions, as means over up to ``KEPT`` parts."""
    values = {}
    for signal in SIDE_SIGNALS:
        by_joint = signals.side_columns(signal)
        columns = list(dict.fromkeys(by_joint.values()))
        if not columns:
            continue
        table = _complete_rows(Path(paths[0]), columns, signals, units, part)
        if not len(table):
            raise GtauError(
                f"no row holds a number in the {signal.key} columns ({', '.join(columns)}); correct them, or "
                f"remove '{signal.key}' from the signals.",
                source=paths[0],
            )
        means = np.array([rows.mean(axis=0) for rows in np.array_split(table, min(KEPT, len(table)))])
        joints = {joint: means[:, columns.index(column)] for joint, column in by_joint.items()}
        values[signal.key] = SideValues(means[:, -1], joints, getattr(units, signal.key) or signal.units[0])
    return values


def _complete_rows(
    path: Path, columns: Sequence[str], signals: Signals, units: Units, part: Part, scale: ArrayLike = 1.0
) -> np.ndarray:
    """Read the rows of a log that hold a number in each of some columns: these, times ``scale``, and the time in s."""
    times, (_, _, time_scale) = signals.time_columns, units.scale(signals)
    table = read_log(path, (*times, *columns))
    at, order = ([table.columns.index(name) for name in names] for names in (times, columns))
    rows = part.rows(table)

    def blocks() -> Iterator[tuple[int, np.ndarray]]:
        row = rows.start
        for values, _ in table.blocks(rows):
            yield row, np.column_stack([values[:, order] * scale, instants(signals, values[:, at], time_scale, row)])
            row += len(values)

    return store((values[np.isfinite(values).all(axis=1)] for _, values in part.of(blocks())), (len(columns) + 1,))
