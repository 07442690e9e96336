"""Show a fleet of robots."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from gtau.documents.files import write_table
from gtau.findings import counted
from gtau.fleets.table import FleetGains, JointOfFleet
from gtau.report.chart import Axis, Chart, Panel, Rule, Series
from gtau.report.page import Column, ColumnOf, Facts, Kind, Page, Section, Text, joint_label, table_of

LISTED = 20  # most outliers or refused robots that are listed
NAMED = 40  # most robots whose names fit below the axis


def fleet_document(fleet: FleetGains) -> dict[str, Any]:
    """Describe the fleet as a JSON document: joints over the fleet, gains by robot, robots that were refused."""
    return {
        "schema": "gtau-fleet/1",
        "joints": [asdict(joint) for joint in fleet.joints],
        "gains": [asdict(gain) for gain in fleet.gains],
        "refused": [{"robot": robot, "why": why} for robot, why in fleet.refused],
    }


def fleet_page(fleet: FleetGains, full: bool = False) -> Page:
    """Show each joint over the robots, outliers and refused robots; in ``full`` also every gain of every robot."""
    gains = table_of(fleet.gains, *GAIN, (Column("why"), "why"), name="gains-table")
    charts = [fleet_chart(fleet, joint) for joint in fleet.joints if full]
    joints = table_of(
        fleet.joints,
        (Column("model"), "model"),
        (Column("joint"), lambda joint: joint_label(joint.joint)),
        (Column("robots", Kind.NUMBER), "robots"),
        (Column("median gain", Kind.NUMBER, 5), "median"),
        (Column("std", Kind.NUMBER, 2), "median_std"),
        (Column("spread, %", Kind.NUMBER, decimals=2), lambda joint: 100 * joint.spread / abs(joint.median)),
        (Column("unit"), "unit"),
    )
    outliers = table_of(fleet.outliers[:LISTED], *GAIN) if fleet.outliers else Text("none")
    more = [Text(f"and {len(fleet.outliers) - LISTED} more")] if len(fleet.outliers) > LISTED else []
    refused = [f"{robot}: {why}" for robot, why in fleet.refused]
    if len(refused) > LISTED and not full:
        refused[LISTED:] = [f"and {len(refused) - LISTED} more"]
    return Page(
        "Drive gains of a fleet",
        _verdict(fleet),
        Section("Joints over the fleet", joints, id="joints"),
        Section("Outliers", outliers, *more, id="outliers"),
        Section("Gains by robot", *charts, id="chart"),
        Section("All gains", gains, id="gains") if full else None,
        Section("Refused robots", Text("", tuple(refused)), id="refused") if refused else None,
        lead=[f"{len(fleet.robots)} robots."] if full else [],
    )


def _verdict(fleet: FleetGains) -> Section:
    outliers, robots = fleet.outliers, {gain.robot for gain in fleet.outliers}
    if not fleet.robots:
        words, style = "No robot could be identified.", "bad"
    elif outliers:
        apart = f"{counted(len(outliers), 'drive gain')} of {counted(len(robots), 'robot')}"
        words = f"{apart} differ{'s' * (len(outliers) == 1)} from the rest of the fleet."
        style = "weak"
    elif any(joint.comparable for joint in fleet.joints):
        words, style = "No drive gain is an outlier in the fleet.", "good"
    else:
        words = "The robots are identified, but they are too few to detect outliers."
        style = "neutral"
    facts = {"identified": len(fleet.robots), "refused": len(fleet.refused), "outliers": len(outliers)}
    verdict = Text(words, tuple(_remarks(fleet)), style)  # type: ignore[arg-type]
    return Section("Verdict", verdict, Facts(facts), id="verdict")


GAIN: tuple[ColumnOf, ...] = (
    (Column("robot"), "robot"),
    (Column("joint"), lambda gain: joint_label(gain.joint)),
    (Column("verdict", Kind.BADGE), lambda gain: "outlier" if gain.outlier else gain.outcome),
    (Column("gain", Kind.NUMBER, 5), "gain"),
    (Column("std", Kind.NUMBER, 2), "std"),
    (Column("unit"), "unit"),
    (Column("from median, %", Kind.NUMBER, 3), "difference_percent"),
    (Column("z", Kind.NUMBER, 3), "z"),
    (Column("limit", Kind.NUMBER, 3), "limit"),
)
"""Columns of a gain and their cells."""


def _remarks(fleet: FleetGains) -> list[str]:
    """List hints on the outliers."""
    joints = Counter(gain.robot for gain in fleet.gains)
    signs = Counter((gain.robot, "large" if (gain.difference_percent or 0) > 0 else "small") for gain in fleet.outliers)
    hints = [
        f"robot '{robot}': all its gains are too {sign}; check the payload's mass in its experiment first"
        for (robot, sign), count in signs.items()
        if 1 < count == joints[robot]
    ]
    few = dict.fromkeys(f"'{joint.model}'" for joint in fleet.joints if not joint.comparable)
    hints += [f"there are too few robots of {', '.join(few)} to find outliers (8 are needed)"] if few else []
    return hints


def fleet_chart(fleet: FleetGains, joint: JointOfFleet) -> Chart:
    """Draw gains of a joint on all robots, in per cent of the median, with 95 % intervals and the spread."""
    gains = [
        gain
        for gain in fleet.gains
        if (gain.model, gain.joint, gain.unit) == (joint.model, joint.joint, joint.unit)
        and gain.difference_percent is not None
    ]
    percent = 100 / abs(joint.median)
    series = []
    for outlier, label, mark in ((False, "robot, 95 % interval", "disc"), (True, "outlier", "diamond")):
        at = np.flatnonzero([gain.outlier == outlier for gain in gains])
        values = np.array([gains[k].difference_percent for k in at], dtype=float)
        halves = percent * np.array([gains[k].half_width or 0.0 for k in at])
        hue = "residual" if outlier else "predicted"
        series += [Series(label, at.astype(float), values, hue, mark, half=halves, upright=True)] if len(at) else []  # type: ignore[arg-type]
    names = {float(k): gain.robot for k, gain in enumerate(gains)} if len(gains) <= NAMED else {}
    band = (-percent * joint.spread, percent * joint.spread)
    title = (
        f"{joint.model}, {joint_label(joint.joint)}: median {joint.median:.5g} {joint.unit}, std {joint.median_std:.2g}"
    )
    axis = Axis("" if names else "robot", names=names)
    panel = Panel(axis, Axis("from median, %"), tuple(series), title, (Rule(y=0.0),), band, height=2.0)
    return Chart((panel,), caption="The band is the spread of the fleet.")


def write_fleet(fleet: FleetGains, out: Path) -> list[Path]:
    """Write ``gains.csv`` and ``gains.parquet``."""
    frame, written = fleet.to_frame(), [out / "gains.csv", out / "gains.parquet"]
    for path in written:
        write_table(frame, path)
    return written
