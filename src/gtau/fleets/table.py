"""Drive gains of a fleet: each compared with the robots of its model, the outliers among them, and their page."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.documents.files import write_table
from gtau.estimation.results.estimate import Estimate
from gtau.findings import counted
from gtau.report.chart import Axis, Chart, Panel, Rule, Series
from gtau.report.page import Column, ColumnOf, Facts, Kind, Page, Section, Text, joint_label, table_of
from gtau.report.terminal import plain

if TYPE_CHECKING:
    import polars as pl

LEAST = 8  # values: the spread of fewer is too uncertain to call one an outlier
FALSE_ALARM = 0.05  # chance of an outlier in a fleet without outliers; 0.1 where the spread is small
EFFICIENCY = 0.37  # of a median-based spread, relative to the standard deviation
QUARTILE = 0.4549364  # median of the chi-square distribution with one degree of freedom


@dataclass(frozen=True)
class Report:
    """The document of a robot's model, or the reason why it has none."""

    robot: str
    model: dict[str, Any] | None
    sentence: str = ""


@dataclass(frozen=True)
class FleetGain:
    """Drive gain of one robot beside the fleet's median, from which it is ``z`` standard deviations apart.

    ``outcome`` and ``why`` are its own verdict; ``half_width`` is half the 95 % interval, in ``unit``.
    """

    robot: str
    model: str
    joint: str
    gain: float | None
    std: float | None
    unit: str
    outcome: str
    why: str
    difference_percent: float | None = None
    z: float | None = None
    limit: float | None = None
    outlier: bool = False
    half_width: float | None = None


@dataclass(frozen=True)
class JointOfFleet:
    """A joint over all robots of a model: weighted median, its standard deviation, and the spread between robots."""

    model: str
    joint: str
    unit: str
    robots: int
    median: float
    median_std: float
    spread: float
    comparable: bool


@dataclass(frozen=True, repr=False)
class FleetTable:
    """What :func:`gtau.fleet` returns: gains of every robot, joints over the fleet, and refused robots with reasons."""

    gains: tuple[FleetGain, ...]
    joints: tuple[JointOfFleet, ...]
    refused: tuple[tuple[str, str], ...]

    def __repr__(self) -> str:
        counts = f"robots: {len(self.robots)}, outliers: {len(self.outliers)}, refused: {len(self.refused)}"
        return f"FleetTable({counts}; print(table.summary()) shows all)"

    @property
    def robots(self) -> tuple[str, ...]:
        """List the names of the identified robots."""
        return tuple(dict.fromkeys(gain.robot for gain in self.gains))

    @property
    def outliers(self) -> tuple[FleetGain, ...]:
        """List the outliers, the farthest first."""
        outliers = [gain for gain in self.gains if gain.outlier]
        return tuple(sorted(outliers, key=lambda gain: -abs(gain.z or 0.0) / (gain.limit or 1.0)))

    def to_frame(self) -> pl.DataFrame:
        """Return all gains by robot and joint, and the refused robots, as a Polars table: that of ``gains.csv``."""
        import polars as pl

        types = {"str": pl.String, "bool": pl.Boolean}
        schema = {field.name: types.get(str(field.type), pl.Float64) for field in fields(FleetGain)}
        refused = [{"robot": robot, "outcome": "refused", "why": why, "outlier": False} for robot, why in self.refused]
        return pl.DataFrame([asdict(gain) for gain in self.gains] + refused, schema=schema)

    def summary(self) -> str:
        """Summarise the fleet as text, as ``gtau fleet`` prints it."""
        return plain(fleet_page(self))


def fleet_table(reports: Sequence[Report]) -> FleetTable:
    """Compare the gains of each joint over the robots of the same model; see :func:`_median_and_spread`.

    Outliers exceed the ``|z|`` that Student's t exceeds with a probability of 5 % in as many draws as there are gains.
    """
    from scipy.special import stdtrit

    gains, freedoms = list[FleetGain](), list[float]()
    for report in reports:
        if report.model is None:
            continue
        for row in report.model["drive_gains"]:
            joint, gain, std, unit = (row[key] for key in ("joint", "value", "std", "unit"))
            half_width = Estimate(joint, gain, std, unit, freedom=row["freedom"]).half_interval()
            verdict = {"outcome": row["outcome"], "why": row["why"], "half_width": half_width}
            gains.append(FleetGain(report.robot, report.model["robot"], joint, gain, std, unit, **verdict))
            freedoms.append(row["freedom"] or np.inf)
    groups = defaultdict[tuple[str, str, str], list[int]](list)
    for k, gain in enumerate(gains):
        if gain.gain is not None and gain.std is not None:
            groups[gain.model, gain.joint, gain.unit].append(k)
    tests = sum(map(len, groups.values()))
    joints = []
    for group, members in groups.items():
        rows = [(gains[k].gain, gains[k].std, freedoms[k]) for k in members]
        values, std, freedom = np.array(rows, dtype=float).T
        median, spread = _median_and_spread(values, std)
        total = np.hypot(spread, std)
        median_std = float(np.sqrt(np.pi / 2 / np.sum(1 / np.maximum(total, 1e-150) ** 2)))
        comparable = len(members) >= LEAST
        joints.append(JointOfFleet(*group, len(members), median, median_std, spread, comparable))
        z = np.divide(values - median, total, out=np.zeros(len(values)), where=total > 0)
        # a spread may be the larger part: its few degrees of freedom then count for both
        both = np.minimum(freedom, max(EFFICIENCY * (len(members) - 1), 1.0)) if spread else freedom
        limits = stdtrit(both, 1 - FALSE_ALARM / (2 * tests))
        for place, k in enumerate(members):
            if median:
                gains[k] = replace(gains[k], difference_percent=float(100 * (values[place] / median - 1)))
            if comparable:
                distance, limit = float(z[place]), float(limits[place])
                gains[k] = replace(gains[k], z=distance, limit=limit, outlier=abs(distance) > limit)
    refused = tuple((report.robot, report.sentence) for report in reports if report.model is None)
    return FleetTable(tuple(gains), tuple(joints), refused)


def _median_and_spread(values: np.ndarray, std: np.ndarray) -> tuple[float, float]:
    """Compute the weighted median of values (N,), and their spread beyond their own standard deviations ``std``."""
    median, spread = float(np.median(values)), 0.0
    for _ in range(20):
        before = median, spread
        spread = _spread((values - median) ** 2, std**2)
        median = _weighted_median(values, 1 / np.maximum(np.hypot(spread, std), 1e-300))
        if (median, spread) == before:
            break
    return median, spread


def _spread(squares: np.ndarray, variances: np.ndarray) -> float:
    """Find the spread whose square, added to ``variances``, gives ``squares`` the median ratio of chi-square."""
    from scipy.optimize import brentq

    largest = float(squares.max()) / QUARTILE

    def excess(share: float) -> float:
        return float(np.median(squares / np.maximum(share * largest + variances, 1e-300))) - QUARTILE

    return float(np.sqrt(largest * brentq(excess, 0.0, 1.0, xtol=1e-15))) if excess(0.0) > 0 else 0.0


def _weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    order = np.argsort(values)
    cumulated = np.cumsum(weights[order])
    half = cumulated[-1] / 2
    k = int(np.searchsorted(cumulated, half))
    tie = k + 1 < len(values) and np.isclose(cumulated[k], half, rtol=1e-12)
    return float(values[order[k : k + 2 if tie else k + 1]].mean())


LISTED = 20  # most outliers or refused robots that are listed
NAMED = 40  # most robots whose names fit below the axis


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
        lead=[f"{counted(len(fleet.robots), 'robot')}."] if full else [],
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
    return Chart((panel,), caption="The band is the spread of the fleet." * (joint.spread > 0))


def write_fleet(fleet: FleetTable, out: Path) -> list[Path]:
    """Write ``gains.csv`` and ``gains.parquet``."""
    frame, written = fleet.to_frame(), [out / "gains.csv", out / "gains.parquet"]
    for path in written:
        write_table(frame, path)
    return written
