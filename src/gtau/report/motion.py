"""The robot, the path of its payload's body, and distances to singular poses, on pages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from gtau.estimation.results.singularity_distances import Distances, NearestPose
from gtau.estimation.thresholds.logs import NEAR_SINGULAR
from gtau.report.page import Axis, Chart, Column, Kind, Panel, Section, Series, Text, colour, section, table

TYPES = {1: "type 1 (serial)", 2: "type 2 (parallel)"}
"""Names of the types of singularities."""
COLOURS = {1: "c4", 2: "c6"}  # others than those of the first joints
TIME = Axis("time from the start of the run, s")


def singularities_section(nearest: Sequence[NearestPose]) -> Section | None:
    """Show where runs come nearest to singular poses."""
    if not nearest:
        return None
    rows = [
        (
            each.run,
            TYPES[each.type],
            each.distance,
            each.time,
            ", ".join(f"{joint} {value:.3g}" for joint, value in each.pose.items()),
        )
        for each in nearest
    ]
    columns = (
        Column("run"),
        Column("singularity"),
        Column("nearest", Kind.NUMBER, 3),
        Column("at, s", Kind.NUMBER),
        Column("pose, rad or m", wide=True),
    )
    words = "Reciprocal condition numbers: 1 at best, 0 at a singular pose."
    return section("Distance to singular poses", table(columns, rows), Text(words, style="soft"))


def distances_panel(distances: Distances, start: float) -> Panel | None:
    """Draw distances to singular poses along a run that begins at ``start``, s; None where it has none."""
    time = distances.time - start
    series = [
        Series(name, time, values, COLOURS[kind], width=1.4)
        for (kind, name), values in zip(TYPES.items(), distances.values.T, strict=True)
        if np.isfinite(values).any()
    ]
    if not series:
        return None
    if len(series) == len(TYPES):  # at singularities of type 2 alone errors are magnified
        near = Series(f"near: {NEAR_SINGULAR:g}", time, np.full(len(time), NEAR_SINGULAR), "c7", width=0.8)
        series.append(near)
    return Panel(TIME, Axis("distance", limits=(0.0, 1.05)), tuple(series), height=1.4)


def distances_panels(distances: Sequence[Distances], starts: Mapping[str, float]) -> list[Panel]:
    """Draw distances to singular poses along runs that begin at ``starts``, s, by name."""
    panels = [(each.run, distances_panel(each, starts.get(each.run, 0.0))) for each in distances]
    return [replace(panel, title=name) for name, panel in panels if panel is not None]


def paths_chart(paths: Sequence[tuple[str, np.ndarray]]) -> Chart:
    """Draw paths (P, 3), m, of runs by name, in three projections."""
    panels = [
        Panel(
            Axis(f"{'xyz'[a]}, m"),
            Axis(f"{'xyz'[b]}, m"),
            tuple(Series(name, path[:, a], path[:, b], colour(k), width=1.0) for k, (name, path) in enumerate(paths)),
            f"{'xyz'[a]}-{'xyz'[b]} plane of the base",
            height=2.4,
            equal=True,
        )
        for a, b in combinations(range(3), 2)
    ]
    return Chart(tuple(panels), columns=3)
