"""Distances of the runs of an experiment to singularities (see :mod:`gtau.model.singularities`)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Literal

import numpy as np

from gtau.documents.files import write_atomically
from gtau.model.singularities import TYPES
from gtau.signals.decimation import Decimator
from gtau.signals.preparation import PreparedRun
from gtau.signals.storage import rows_at


@dataclass(frozen=True, eq=False)
class Distances:
    """Distances to singularities along a run: ``time`` (K,) in s, and of each type ``values`` (K, 2).

    Reciprocal condition numbers, 1 at best and 0 at a singularity; NaN for type 2 without closures.
    """

    run: str
    time: np.ndarray
    values: np.ndarray


@dataclass(frozen=True)
class NearestPose:
    """Nearest pose of a run to a singularity of ``type`` 1 or 2: distance, time (s) since the run's start, pose.

    The pose is in rad or m.
    """

    run: str
    type: Literal[1, 2]
    distance: float
    time: float
    pose: Mapping[str, float]


def distances_of(prepared: PreparedRun, decimator: Decimator, values: np.ndarray) -> Distances:
    """Combine the distances ``values`` (K, 2) with the times of the run's decimated samples."""
    return Distances(prepared.run.name, rows_at(prepared.time, decimator.instants(len(prepared))), values)


def nearest_poses(prepared: PreparedRun, decimator: Decimator, values: np.ndarray) -> Iterator[NearestPose]:
    """Find the pose of a run nearest to singularities of each type that the robot can have."""
    instants = decimator.instants(len(prepared.time))
    for kind, distances in zip(TYPES, values.T, strict=True):
        if distances.size and not np.isnan(distances).all():
            k = int(np.nanargmin(distances))
            at = int(instants[k])
            q = prepared.samples(at, at + 1).q[0]
            pose = {joint: float(value) for joint, value in zip(prepared.run.joints, q, strict=True)}
            since_start = float(prepared.time[at] - prepared.run.time[0])
            yield NearestPose(prepared.run.name, kind, float(distances[k]), since_start, pose)


def write_distances(runs: Sequence[Distances], path: str | Path) -> None:
    """Write a table ``run, time, type_1, type_2`` as a Parquet file, atomically; NaN is written as null."""
    import polars

    tables = []
    for each in runs:
        values = {f"type_{kind}": distances for kind, distances in zip(TYPES, each.values.T, strict=True)}
        table = polars.DataFrame({"time": each.time} | values)
        tables.append(table.select(polars.lit(each.run).alias("run"), polars.all()))
    content = BytesIO()
    polars.concat(tables).fill_nan(None).write_parquet(content)
    write_atomically(path, content.getvalue())
