"""Logged poses with the positions of the joints, as they stand together in the rows of a log."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gtau.errors import GtauError
from gtau.signals.aligned import seconds
from gtau.signals.column_units import Units
from gtau.signals.columns import SampleRate, Signals
from gtau.signals.log_file import read_log
from gtau.signals.samples import WHOLE, Part
from gtau.signals.storage import store

FEWEST = 20  # rows of a run that hold a pose


@dataclass(frozen=True, eq=False)
class LoggedPoses:
    """Complete rows of a log: ``time`` (N,) in s, ``q`` (N, n) in the order of the signals, ``values`` (N, columns).

    The values are those of :attr:`gtau.signals.pose_columns.PoseColumns.columns`, SI units.
    """

    run: str
    time: np.ndarray
    q: np.ndarray
    values: np.ndarray


def read_poses(paths: Sequence[Path], signals: Signals, units: Units, part: Part = WHOLE) -> LoggedPoses:
    """Read the poses of a run, which stand in the log of its positions.

    Parameters
    ----------
    paths : sequence of Path
        Its log, or two.
    signals, units : Signals, Units
        Of the experiment, with a pose.
    part : Part
        Which part of the log is used.

    Raises
    ------
    GtauError
        A column is not there, or hardly any row holds a pose.
    """
    pose, path = signals.pose, Path(paths[0])
    assert pose is not None  # whoever calls has looked
    times, n = signals.time_columns, len(signals.joints)
    wanted = [*times, *signals.position.values(), *pose.columns]
    file = read_log(path, wanted)
    order = [file.names.index(name) for name in wanted]
    position_scale, _, time_scale = units.scale(signals)
    scale = np.array([*position_scale, *units.pose.scale(pose)])

    def blocks() -> Iterator[np.ndarray]:
        row = 0
        for values, _ in file.blocks(part.rows):
            found = values[:, order]
            if isinstance(signals.time, SampleRate):
                time = (row + np.arange(len(found))) / signals.time.rate
            else:
                time = seconds(found[:, : len(times)], time_scale)
            row += len(found)
            yield np.column_stack([found[:, len(times) :] * scale, time])

    table = store((each[np.isfinite(each).all(axis=1)] for _, each in part.of(blocks())), (len(scale) + 1,))
    if len(table) < FEWEST:
        raise GtauError(
            f"{path}: {len(table)} rows hold all of the pose ({', '.join(pose.columns)}) and the positions; give the "
            "columns that hold them, or remove 'pose' from the signals."
        )
    return LoggedPoses(path.stem + part.label, table[:, -1], table[:, :n], table[:, n:-1])
