"""The drive gains of a fleet in one table, outliers marked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from gtau.fleet.fleet import Report
from gtau.fleet.outliers import Distances, distances


@dataclass(frozen=True)
class FleetGain:
    """A drive gain of one robot beside those of the others.

    ``gain`` and ``std`` in ``unit``, None where the gain is not identifiable; ``difference_percent`` from the median
    of the fleet; ``z`` the same in standard deviations, and ``limit`` where an outlier begins, both None where there
    is nothing to compare with. ``outcome`` and ``why`` are the verdict of its own identification.
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


@dataclass(frozen=True)
class JointOfFleet:
    """A joint over all robots of one model: ``median``, its standard deviation and ``spread`` in ``unit``."""

    model: str
    joint: str
    unit: str
    robots: int
    median: float
    median_std: float
    spread: float
    comparable: bool


@dataclass(frozen=True)
class FleetTable:
    """Every gain of every robot, the joints over the fleet, and the refused robots with the reason."""

    gains: tuple[FleetGain, ...]
    joints: tuple[JointOfFleet, ...]
    refused: tuple[tuple[str, str], ...]

    @property
    def robots(self) -> tuple[str, ...]:
        """List the names of the identified robots."""
        return tuple(dict.fromkeys(gain.robot for gain in self.gains))

    @property
    def outliers(self) -> tuple[FleetGain, ...]:
        """List the outliers, the farthest first."""
        return tuple(sorted((g for g in self.gains if g.outlier), key=lambda g: -abs(g.z or 0.0) / (g.limit or 1.0)))


def fleet_table(reports: Sequence[Report]) -> FleetTable:
    """Compare the gains of each joint over the robots of the same model; see :func:`gtau.fleet.outliers.distances`."""
    models = [(report.member.name, report.model) for report in reports if report.model is not None]
    gains = [
        FleetGain(name, model["robot"], g["joint"], g["value"], g["std"], g["unit"], g["outcome"], g["why"])
        for name, model in models
        for g in model["drive_gains"]
    ]
    freedom = [g["freedom"] or np.inf for _, model in models for g in model["drive_gains"]]
    known = [k for k, g in enumerate(gains) if g.gain is not None and g.std is not None]
    groups: dict[tuple[str, str, str], list[int]] = {}
    for k in known:
        groups.setdefault((gains[k].model, gains[k].joint, gains[k].unit), []).append(k)
    joints = []
    for group, index in groups.items():
        values, std = (np.array([getattr(gains[k], what) for k in index], dtype=float) for what in ("gain", "std"))
        found = distances(values, std, np.array([freedom[k] for k in index], dtype=float), len(known))
        comparable = bool(np.isfinite(found.limit).all())
        joints.append(JointOfFleet(*group, len(index), found.median, found.median_std, found.spread, comparable))
        for place, k in enumerate(index):
            gains[k] = _compared(gains[k], found, place)
    refused = tuple((report.member.name, report.sentence) for report in reports if report.model is None)
    return FleetTable(tuple(gains), tuple(joints), refused)


def _compared(gain: FleetGain, found: Distances, place: int) -> FleetGain:
    difference = 100 * ((gain.gain or 0.0) / found.median - 1) if found.median else None
    if not np.isfinite(found.limit[place]):
        return replace(gain, difference_percent=difference)
    return replace(
        gain,
        difference_percent=difference,
        z=float(found.z[place]),
        limit=float(found.limit[place]),
        outlier=bool(found.outlier[place]),
    )


def table_rows(table: FleetTable) -> list[dict[str, Any]]:
    """Return the rows of the table: one for each gain, and one for each refused robot."""
    names = [field.name for field in fields(FleetGain)]
    refused = [{"robot": name, "outcome": "refused", "why": why, "outlier": False} for name, why in table.refused]
    return [asdict(gain) for gain in table.gains] + [dict.fromkeys(names) | row for row in refused]
