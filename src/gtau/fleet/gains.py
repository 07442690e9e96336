"""Table of the drive gains of a fleet, with outliers marked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from gtau.estimation.results.estimate import Estimate
from gtau.fleet.fleet import Report

LEAST = 8  # values: the spread of fewer is too uncertain to call one an outlier
FALSE_ALARM = 0.05  # chance that a fleet without outliers shows one; 0.1 where the spread is small
EFFICIENCY = 0.37  # of a median-based spread, relative to that of the standard deviation
QUARTILE = 0.4549364  # median of the chi-square distribution with one degree of freedom


@dataclass(frozen=True, eq=False)
class Distances:
    """Distances of values from their median.

    Attributes
    ----------
    median, median_std, spread : float
        Weighted median of the values with its standard deviation, and the standard deviation between the values
        beyond those of the values themselves.
    z : ndarray
        (N,) distances from the median, in standard deviations of spread and value together.
    limit : ndarray
        (N,) the ``|z|`` beyond which a value is an outlier; infinite where there are fewer than 8 values.
    """

    median: float
    median_std: float
    spread: float
    z: np.ndarray
    limit: np.ndarray

    @property
    def outlier(self) -> np.ndarray:
        """True for each value that is an outlier, (N,)."""
        return np.abs(self.z) > self.limit


def distances(values: np.ndarray, std: np.ndarray, freedom: np.ndarray, tests: int) -> Distances:
    """Compute the distances of values from their median.

    The spread makes the median of ``(value - median)^2 / (spread^2 + std^2)`` that of a chi-square variable, so it
    breaks down only where half of the values are outliers. The limit is the point of a t distribution that is exceeded
    in ``tests`` draws with a probability of 5 %.

    Parameters
    ----------
    values, std, freedom : ndarray
        (N,) values, their standard deviations, and the degrees of freedom of those (inf: very many).
    tests : int
        Values tested in the whole fleet.
    """
    from scipy.special import stdtrit

    median, spread = float(np.median(values)), 0.0
    for _ in range(20):
        before = median, spread
        spread = _spread((values - median) ** 2, std**2)
        median = _weighted_median(values, 1 / np.maximum(np.hypot(spread, std), 1e-300))
        if (median, spread) == before:
            break
    total = np.hypot(spread, std)
    z = np.divide(values - median, total, out=np.zeros(len(values)), where=total > 0)
    of_spread = max(EFFICIENCY * (len(values) - 1), 1.0)
    # where there is spread, it may well be the larger part: its few degrees of freedom count for both
    both = np.minimum(freedom, of_spread) if spread else freedom
    limit = stdtrit(both, 1 - FALSE_ALARM / (2 * tests))
    median_std = float(np.sqrt(np.pi / 2 / np.sum(1 / np.maximum(total, 1e-150) ** 2)))
    return Distances(median, median_std, spread, z, limit if len(values) >= LEAST else np.full(len(values), np.inf))


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


@dataclass(frozen=True)
class FleetGain:
    """Drive gain of one robot compared with the rest of the fleet.

    ``gain`` and ``std`` in ``unit``, None where the gain is not identifiable; ``difference_percent`` from the median
    of the fleet; ``z`` the same in standard deviations, and ``limit`` the outlier threshold, both None without
    others to compare with. ``outcome`` and ``why`` are the verdict of its own identification,
    and ``half_width`` is half its 95 % interval, in ``unit``.
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
    """Compare the gains of each joint over the robots of the same model; see :func:`gtau.fleet.gains.distances`."""
    models = [(report.member.name, report.model) for report in reports if report.model is not None]
    gains = [
        FleetGain(
            name, model["robot"], g["joint"], g["value"], g["std"], g["unit"], g["outcome"], g["why"],
            half_width=Estimate(g["joint"], g["value"], g["std"], g["unit"], freedom=g["freedom"]).half_interval(),
        )
        for name, model in models
        for g in model["drive_gains"]
    ]  # fmt: skip
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
