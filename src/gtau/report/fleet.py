"""Show estimators compared on the same logs, and a fleet of robots."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.documents.files import write_table
from gtau.estimation.compare import EstimatorComparison
from gtau.findings import counted, percent_text
from gtau.report.chart import Axis, Chart, Panel, Rule, Series, intervals
from gtau.report.page import Column, ColumnOf, Facts, Kind, Page, Section, Table, Text, joint_label, table_of

if TYPE_CHECKING:
    from gtau.fleets.fleet import FleetTable, JointOfFleet

LISTED = 20  # most outliers or refused robots that are listed
NAMED = 40  # most robots whose names fit below the axis
TRUSTED = ("good", "weak")
GAIN_COLUMNS = (
    ("String", "robot model joint"),
    ("Float64", "gain std"),
    ("String", "unit outcome why"),
    ("Float64", "difference_percent z limit"),
    ("Boolean", "outlier"),
    ("Float64", "half_width"),
)
"""Columns of the table of gains in their order, by their Polars type."""


def fleet_document(fleet: FleetTable) -> dict[str, Any]:
    """Describe the fleet as a JSON document: joints over the fleet, gains by robot, robots that were refused."""
    return {
        "schema": "gtau-fleet/1",
        "joints": [asdict(joint) for joint in fleet.joints],
        "gains": [asdict(gain) for gain in fleet.gains],
        "refused": [{"robot": robot, "why": why} for robot, why in fleet.refused],
    }


def fleet_page(fleet: FleetTable, full: bool = False) -> Page:
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


def _verdict(fleet: FleetTable) -> Section:
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


def _remarks(fleet: FleetTable) -> list[str]:
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


def fleet_chart(fleet: FleetTable, joint: JointOfFleet) -> Chart:
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


def write_fleet(fleet: FleetTable, out: Path) -> list[Path]:
    """Write ``gains.csv`` and ``gains.parquet``."""
    import polars as pl

    schema = {name: getattr(pl, kind) for kind, names in GAIN_COLUMNS for name in names.split()}
    refused = [{"robot": robot, "outcome": "refused", "why": why, "outlier": False} for robot, why in fleet.refused]
    frame = pl.DataFrame([asdict(gain) for gain in fleet.gains] + refused, schema=schema)
    written = [out / "gains.csv", out / "gains.parquet"]
    for path in written:
        write_table(frame, path)
    return written


# Estimators


def comparison_page(comparison: EstimatorComparison, prior: Mapping[str, float] | None = None) -> Page:
    """Show the results of each estimator."""
    said = [f"{row.method}: {row.refusal}" for row in comparison.rows if row.refusal]
    judged = [(row.method, row.outcome.value) for row in comparison.rows if row.outcome]
    said += [f"{method}: the gains are {outcome}" for method, outcome in judged if outcome not in TRUSTED]
    said += map(str, comparison.notes)
    verdict = Text(_agreement(comparison), tuple(said), "neutral")
    words = "residual: worst joint, % of its current; time: estimation alone; ±: half the 95 % interval"
    return Page(
        f"Estimators on {comparison.robot}",
        Section("Verdict", verdict, id="verdict"),
        Section("Estimators", comparison_table(comparison), Text(words, style="soft"), id="estimators"),
        Section("Drive gains by estimator", *_charts(comparison, prior or {}), id="gains"),
    )


def _agreement(comparison: EstimatorComparison) -> str:
    """Summarise the agreement of the estimators in one sentence."""
    rows = [row for row in comparison.rows if row.gains is not None and row.std is not None]
    trusted = [row for row in rows if row.outcome is not None and row.outcome.value in TRUSTED]
    if len(trusted) < 2:
        return f"{len(trusted) or 'None'} of {len(rows)} estimators that find drive gains give trustworthy ones."
    gains = np.array([row.gains for row in trusted])
    spread = 100 * np.ptp(gains, axis=0) / np.abs(np.median(gains, axis=0))
    j = int(np.argmax(spread))
    return (
        f"{len(trusted)} of {len(rows)} estimators find trustworthy gains, which agree to "
        f"{percent_text(spread[j])} % or better, and differ most at {comparison.joints[j]}."
    )


def comparison_table(comparison: EstimatorComparison) -> Table:
    """Tabulate each estimator: worst verdict, residual, time, and gains with their 95 % intervals."""
    units = zip(comparison.joints, _units(comparison), strict=True)
    labels = [f"{joint_label(joint)}, {unit}" for joint, unit in units]
    columns = (
        Column("estimator", Kind.NAME),
        Column("worst verdict", Kind.BADGE),
        Column("residual, %", Kind.NUMBER, decimals=2),
        Column("time, s", Kind.NUMBER, decimals=2),
        *(Column(label, Kind.SPREAD, 5) for label in labels),
    )
    rows: list[tuple[object, ...]] = []
    for row in comparison.rows:
        if row.gains is None or row.residuals is None:
            rows.append((row.method, "refused", None, None, *([None] * len(comparison.joints))))
            continue
        halves = np.zeros(len(comparison.joints)) if row.half_widths is None else row.half_widths
        outcome = "given" if row.outcome is None else row.outcome.value
        gains = zip(row.gains.tolist(), halves.tolist(), strict=True)
        rows.append((row.method, outcome, float(row.residuals.max()), row.seconds, *gains))
    return Table(columns, rows)


def _charts(comparison: EstimatorComparison, prior: Mapping[str, float]) -> list[Chart]:
    """Draw the gain of each joint by every estimator, with 95 % intervals and the prior gain."""
    rows = {row.method: (row.gains, row.half_widths) for row in comparison.rows}
    shown = {method: (g.tolist(), h.tolist()) for method, (g, h) in rows.items() if g is not None and h is not None}
    charts = []
    for j, (joint, unit) in enumerate(zip(comparison.joints, _units(comparison), strict=True) if shown else ()):
        values = [gains[j] for gains, _ in shown.values()]
        halves = [half[j] for _, half in shown.values()]
        given, axis = ("prior", [prior.get(joint)] * len(shown)), f"{joint_label(joint)}, {unit}"
        charts.append(Chart((intervals(list(shown), values, halves, axis, other=given),)))
    return charts


def _units(comparison: EstimatorComparison) -> tuple[str, ...]:
    return comparison.units or ("N m/A or N per A",) * len(comparison.joints)
