"""Show a fleet as page, document, and tables in files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from gtau.documents.files import write_table
from gtau.findings.words import counted
from gtau.fleet.gains import FleetGain, FleetTable, JointOfFleet
from gtau.report.chart import Axis, Chart, Panel, Rule, Series
from gtau.report.page import Column, Facts, Kind, Page, Section, Table, Text, joint_label, page, section, table_of

LISTED = 20  # outliers, or robots that were refused; the others are in the table
NAMED = 40  # robots whose names find room below the axis


def fleet_document(found: FleetTable) -> dict[str, Any]:
    """Describe the fleet as a JSON document: joints over the fleet, gains by robot, robots that were refused."""
    return {
        "schema": "gtau-fleet/1",
        "joints": [asdict(joint) for joint in found.joints],
        "gains": [gain.row for gain in found.gains],
        "refused": [{"robot": robot, "why": why} for robot, why in found.refused],
    }


def fleet_page(found: FleetTable) -> Page:
    """Show each joint over the robots, outliers, and robots that were refused."""
    return page("Drive gains of a fleet", _verdict(found), _joints(found), _outliers(found), _refused(found, LISTED))


def fleet_report(found: FleetTable) -> Page:
    """Show the fleet with every gain of every robot."""
    charts = [fleet_chart(found, joint) for joint in found.joints]
    return page(
        "Drive gains of a fleet",
        _verdict(found),
        _joints(found),
        _outliers(found),
        section("Gains by robot", *charts, id="chart"),
        section("All gains", _gains(found), id="gains"),
        _refused(found),
        lead=[f"{len(found.robots)} robots."],
    )


def _verdict(found: FleetTable) -> Section:
    outliers = found.outliers
    robots = dict.fromkeys(gain.robot for gain in outliers)
    if not found.robots:
        words, style = "No robot could be identified.", "bad"
    elif outliers:
        apart = f"{counted(len(outliers), 'drive gain')} of {counted(len(robots), 'robot')}"
        words, style = f"{apart} differ from the rest of the fleet.", "weak"
    elif any(joint.comparable for joint in found.joints):
        words, style = "No drive gain is an outlier in the fleet.", "good"
    else:
        words, style = "The robots are identified, but they are too few to detect outliers.", "neutral"
    facts = {"identified": len(found.robots), "refused": len(found.refused), "outliers": len(outliers)}
    return section("Verdict", Text(words, tuple(remarks(found)), style), Facts(facts), id="verdict")  # type: ignore[arg-type]


def _joints(found: FleetTable) -> Section:
    joints = table_of(
        found.joints,
        (Column("model"), lambda each: each.model),
        (Column("joint"), lambda each: joint_label(each.joint)),
        (Column("robots", Kind.NUMBER), lambda each: each.robots),
        (Column("median gain", Kind.NUMBER, 5), lambda each: each.median),
        (Column("std", Kind.NUMBER, 2), lambda each: each.median_std),
        (Column("spread, %", Kind.NUMBER, decimals=2), lambda each: 100 * each.spread / abs(each.median)),
        (Column("unit"), lambda each: each.unit),
    )
    return section("Joints over the fleet", joints, id="joints")


GAIN: tuple[tuple[Column, Callable[[FleetGain], Any]], ...] = (
    (Column("robot"), lambda gain: gain.robot),
    (Column("joint"), lambda gain: joint_label(gain.joint)),
    (Column("verdict", Kind.BADGE), lambda gain: "outlier" if gain.outlier else gain.outcome),
    (Column("gain", Kind.NUMBER, 5), lambda gain: gain.estimate.value),
    (Column("std", Kind.NUMBER, 2), lambda gain: gain.estimate.std),
    (Column("unit"), lambda gain: gain.estimate.unit),
    (Column("from median, %", Kind.NUMBER, 3), lambda gain: gain.difference_percent),
    (Column("z", Kind.NUMBER, 3), lambda gain: gain.z),
    (Column("limit", Kind.NUMBER, 3), lambda gain: gain.limit),
)
"""Columns of a gain with their cells."""


def _outliers(found: FleetTable) -> Section:
    shown = found.outliers[:LISTED]
    more = len(found.outliers) - len(shown)
    return section(
        "Outliers",
        table_of(shown, *GAIN) if shown else Text("none"),
        Text(f"and {more} more") if more else None,
        id="outliers",
    )


def _gains(found: FleetTable) -> Table:
    return table_of(found.gains, *GAIN, (Column("why"), lambda gain: gain.why), name="gains-table")


def _refused(found: FleetTable, most: int | None = None) -> Section | None:
    shown = found.refused[:most]
    if not shown:
        return None
    more = len(found.refused) - len(shown)
    said = [f"{robot}: {why}" for robot, why in shown] + ([f"and {more} more"] if more else [])
    return section("Refused robots", Text("", tuple(said)), id="refused")


def remarks(found: FleetTable) -> list[str]:
    """List what else is to be said of the outliers."""
    said = [
        f"robot '{robot}': all its gains are {sign} alike; check the payload's mass in its experiment first"
        for robot, sign in _off_alike(found.outliers, found.gains)
    ]
    few = [each for each in found.joints if not each.comparable]
    if few:
        models = ", ".join(dict.fromkeys(f"'{each.model}'" for each in few))
        said.append(f"of {models} there are too few robots to find outliers (8 are needed)")
    return said


def _off_alike(outliers: Sequence[FleetGain], gains: Sequence[FleetGain]) -> list[tuple[str, str]]:
    joints = Counter(gain.robot for gain in gains)
    signs = Counter((g.robot, "too large" if (g.difference_percent or 0) > 0 else "too small") for g in outliers)
    return [key for key, count in signs.items() if 1 < count == joints[key[0]]]


def fleet_chart(found: FleetTable, joint: JointOfFleet) -> Chart:
    """Draw gains of a joint on all robots in per cent of the median, with 95 % intervals and the spread."""
    gains = [
        gain
        for gain in found.gains
        if (gain.model, gain.joint, gain.estimate.unit) == (joint.model, joint.joint, joint.unit)
        and gain.difference_percent is not None
    ]
    percent = 100 / abs(joint.median)
    series = []
    for outlier, label, mark in ((False, "robot, 95 % interval", "disc"), (True, "outlier", "diamond")):
        at = np.flatnonzero([gain.outlier == outlier for gain in gains])
        values = np.array([gains[k].difference_percent for k in at], dtype=float)
        halves = percent * np.array([gains[k].estimate.half_interval() or 0.0 for k in at])
        hue = "residual" if outlier else "predicted"
        series += [Series(label, at.astype(float), values, hue, mark, half=halves, upright=True)] if len(at) else []  # type: ignore[arg-type]
    names = {float(k): gain.robot for k, gain in enumerate(gains)} if len(gains) <= NAMED else {}
    band = (-percent * joint.spread, percent * joint.spread)
    title = (
        f"{joint.model}, {joint_label(joint.joint)}: median {joint.median:.5g} ± {joint.median_std:.2g} {joint.unit}"
    )
    axis = Axis("" if names else "robot", names=names)
    panel = Panel(axis, Axis("from median, %"), tuple(series), title, (Rule(y=0.0),), band, height=2.0)
    return Chart((panel,), caption="The band is the spread of the fleet.")


def write_fleet(found: FleetTable, out: Path) -> list[Path]:
    """Write ``gains.csv``, ``gains.parquet`` and a figure of each robot model."""
    from gtau.report.render.charts import save

    refused = [{"robot": robot, "outcome": "refused", "why": why, "outlier": False} for robot, why in found.refused]
    frame = pl.DataFrame([gain.row for gain in found.gains] + refused, schema=_SCHEMA)
    written = [out / "gains.csv", out / "gains.parquet"]
    for path in written:
        write_table(frame, path)
    models = list(dict.fromkeys(joint.model for joint in found.joints))
    for k, model in enumerate(models):
        panels = [fleet_chart(found, joint).panels[0] for joint in found.joints if joint.model == model]
        name = "gains.png" if len(models) == 1 else f"gains_{k + 1}.png"
        written.append(save(Chart(tuple(panels)), out / name))
    return written


_SCHEMA = {
    "robot": pl.String,
    "model": pl.String,
    "joint": pl.String,
    "gain": pl.Float64,
    "std": pl.Float64,
    "unit": pl.String,
    "outcome": pl.String,
    "why": pl.String,
    "difference_percent": pl.Float64,
    "z": pl.Float64,
    "limit": pl.Float64,
    "outlier": pl.Boolean,
    "half_width": pl.Float64,
}
