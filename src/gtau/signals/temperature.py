"""Temperatures of joints, or the time since they started, along a log: slow signals on which friction may depend."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
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

KEPT = 2000  # instants of a run: what depends on it is slow


@dataclass(frozen=True, eq=False)
class Temperature:
    """Temperatures in ``unit`` by joint, (K,) each, at instants ``time`` (K,) in s."""

    time: np.ndarray
    of_joint: Mapping[str, np.ndarray]
    unit: str

    def at(self, joint: str, time: np.ndarray) -> np.ndarray:
        """Interpolate the temperatures of a joint linearly at other instants (N,)."""
        return np.interp(time, self.time, self.of_joint[joint])


def read_temperature(paths: Sequence[Path], signals: Signals, units: Units, part: Part = WHOLE) -> Temperature | None:
    """Read the temperatures of a run, which stand in the log of its positions; None where the signals have none.

    Parameters
    ----------
    paths : sequence of Path
        Its log, or two.
    signals, units : Signals, Units
        Of the experiment.
    part : Part
        Which part of the log is used.

    Raises
    ------
    GtauError
        A column is not there, or holds no numbers.
    """
    if signals.temperature is None:
        return None
    of_joint, times = signals.temperature_columns, signals.time_columns
    columns = list(dict.fromkeys(of_joint.values()))
    file = read_log(Path(paths[0]), (*times, *columns))
    at, order = ([file.names.index(name) for name in names] for names in (times, columns))
    _, _, time_scale = units.scale(signals)

    def blocks() -> Iterator[np.ndarray]:
        row = part.skip
        for values, _ in file.blocks(part.rows):
            if isinstance(signals.time, SampleRate):
                time = np.arange(row, row + len(values)) / signals.time.rate
            else:
                time = seconds(values[:, at], time_scale)
            row += len(values)
            yield np.column_stack([values[:, order], time])

    table = store((each[np.isfinite(each).all(axis=1)] for _, each in part.of(blocks())), (len(columns) + 1,))
    if not len(table):
        raise GtauError(
            f"{paths[0]}: no row holds a number in the temperature columns ({', '.join(columns)}); correct them, or "
            "remove 'temperature' from the signals."
        )
    parts = np.array_split(np.asarray(table), min(KEPT, len(table)))
    means = np.array([each.mean(axis=0) for each in parts])
    found = {joint: means[:, columns.index(column)] for joint, column in of_joint.items()}
    return Temperature(means[:, -1], found, units.temperature)
