"""Some samples of a log, read as they are in the whole of it.

A process that works on a part of a run reads that part. What concerns the whole log (its clock, what is clipped,
angles that wrap around) was found where all of it was read, and comes with the part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from gtau.errors import GtauError
from gtau.signals.checks import drop_repeated, unwrapped
from gtau.signals.column_units import Units
from gtau.signals.columns import Signals
from gtau.signals.formats.table import Place
from gtau.signals.glitches import without_glitches
from gtau.signals.log_set import find_logs
from gtau.signals.resampling import Findings, Resampling, resampled, unclipped
from gtau.signals.samples import gathered
from gtau.signals.storage import Placed, block, spans

Stamps = tuple[tuple[int, int], ...]


class AnotherLog(GtauError):
    """A log that is not there, or is not the one that was read before."""


@dataclass(frozen=True, eq=False)
class Log:
    """What a run was read from.

    The paths of one log or two with their columns and units, their sizes and times, what was found in all of it, and
    of each file some rows and the bytes at which they begin.
    """

    paths: tuple[Path, ...]
    signals: Signals
    units: Units
    stamps: Stamps
    findings: Findings
    places: tuple[tuple[Place, ...], ...]

    def stamps_read(self) -> np.ndarray:
        """Read the time column (N,) of the whole log again, s."""
        blocks = find_logs(self.paths, self.signals, self.units).blocks()
        time = np.concatenate([values[:, -1] for values in blocks])
        return np.asarray(time[np.isfinite(time)])

    def excerpt(self, joints: Sequence[str], sensors: Sequence[str], samples: range) -> Excerpt:
        """Take some samples of the run, its joints in this order."""
        found, clock = self.findings, self.findings.grid.clock
        reach = [float(clock.time(k, k + 1)[0]) for k in (samples.start, samples.stop - 1)]
        # A landmark more on either side: samples need their surroundings, and may stand beside the clock.
        first = max(int(np.searchsorted(found.instants, reach[0])) - 2, 0)
        last = int(np.searchsorted(found.instants, reach[1])) + 1
        rows = int(found.rows[first]), 1 + int(found.rows[last] if last < len(found.rows) else found.last)
        begin, end = first * found.landmark, min((last + 1) * found.landmark, found.samples)
        return Excerpt(
            paths=tuple(path.absolute() for path in self.paths),  # other processes may stand elsewhere
            signals=self.signals.model_dump_json(),
            units=self.units.model_dump_json(),
            stamps=self.stamps,
            joints=tuple(joints),
            sensors=tuple(sensors),
            samples=(samples.start, samples.stop),
            rows=rows,
            places=tuple(max((at for at in of if at[0] <= rows[0]), default=(0, 0)) for of in self.places),
            first=begin,
            position=tuple(found.position[first].tolist()),
            grid=found.grid.between(begin, end),
            wraps=tuple(found.wraps.tolist()),
        )


@dataclass(frozen=True)
class Excerpt:
    """Some ``samples`` (first, and after the last) of a run: the ``rows`` to read, and what else they depend on.

    ``first`` is the number of the complete sample that the first row holds, and ``position`` (n) its own; see
    :class:`gtau.signals.resampling.Findings`.
    """

    paths: tuple[Path, ...]
    signals: str
    units: str
    stamps: Stamps
    joints: tuple[str, ...]
    sensors: tuple[str, ...]
    samples: tuple[int, int]
    rows: tuple[int, int]
    places: tuple[Place, ...]
    first: int
    position: tuple[float, ...]
    grid: Resampling
    wraps: tuple[bool, ...]


@lru_cache(maxsize=4)  # parts are reduced again where friction depends on what was estimated
def read_excerpt(excerpt: Excerpt) -> dict[str, np.ndarray]:
    """Return ``time`` (N,), ``position``, ``command`` and ``valid`` (N, n) of a run known by an excerpt only.

    ``time`` (N,), ``position`` (N, n), ``command`` and ``valid`` (N, c).

    The other samples are zero and not valid, and the first and the last instant are there.

    Raises
    ------
    GtauError
        Where the logs cannot be read, are not there, or are not those of the excerpt.
    """
    names = " or ".join(str(path) for path in excerpt.paths)
    if missing := [path for path in excerpt.paths if not path.exists()]:
        raise AnotherLog(
            f"there is no log {missing[0]}; share its folder with all workers under that path, or copy the logs there "
            "with their times (rsync -t)."
        )
    if stamps_of(excerpt.paths) != excerpt.stamps:
        raise AnotherLog(
            f"the log {names} is not the one that was read where this was begun, or has changed since; share the "
            "folder, or copy logs with their times, and run again."
        )
    logged = find_logs(
        excerpt.paths, Signals.model_validate_json(excerpt.signals), Units.model_validate_json(excerpt.units)
    )
    samples, _ = gathered(logged.source, logged.blocks(range(*excerpt.rows), excerpt.places))
    if excerpt.grid.without_repeated:
        samples = drop_repeated(samples, [])
    samples = without_glitches(samples, excerpt.grid.glitches)
    samples = unwrapped(samples, np.array(excerpt.wraps), np.array(excerpt.position))
    clock, (begin, end) = excerpt.grid.clock, excerpt.samples
    instants = clock.instants(samples.time, excerpt.first)
    order = [logged.source.joints.index(joint) for joint in excerpt.joints]
    n = len(order)
    wrenches = n + len(excerpt.sensors)
    measured = [*order, *(n + logged.source.sensors.index(joint) for joint in excerpt.sensors)]
    measured += range(wrenches, wrenches + logged.source.components)
    columns = {"position": order, "command": measured, "valid": measured}
    times = Placed(clock.count)
    places = {"position": Placed(clock.count, (n,)), "command": Placed(clock.count, (len(measured),))}
    places["valid"] = Placed(clock.count, (len(measured),), bool)
    for start, stop in ((0, 1), (clock.count - 1, clock.count)):
        times.put(start, clock.time(start, stop))
    for start, stop in ((begin + a, begin + b) for a, b in spans(end - begin)):
        times.put(start, clock.time(start, stop))
        if excerpt.grid.direct:
            mine = start - excerpt.first, stop - excerpt.first
            position, command = block(samples.position, *mine), block(samples.command, *mine)
            found = position, command, unclipped(command, excerpt.grid.clipped)
        else:
            found = resampled(samples, instants, excerpt.grid, start, stop)[:3]
        for (name, place), values in zip(places.items(), found, strict=True):
            place.put(start, values[:, columns[name]])
    return {"time": times.array()} | {name: place.array() for name, place in places.items()}


def stamps_of(paths: Sequence[Path]) -> Stamps:
    """Read sizes in bytes and times of change in ns of the files at ``paths``, and of those in folders."""
    files = [each for path in paths for each in (sorted(path.iterdir()) if path.is_dir() else [path]) if each.is_file()]
    return tuple((status.st_size, status.st_mtime_ns) for status in (each.stat() for each in files))
