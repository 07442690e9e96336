"""Drive gains of a fleet: each compared with the robots of its model, and the outliers among them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.estimation.results.estimate import Estimate

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


@dataclass(frozen=True)
class FleetGains:
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
        outliers = [gain for gain in self.gains if gain.outlier]
        return tuple(sorted(outliers, key=lambda gain: -abs(gain.z or 0.0) / (gain.limit or 1.0)))

    def to_frame(self) -> pl.DataFrame:
        """Return all gains by robot and joint, and the refused robots, as a Polars table: that of ``gains.csv``."""
        import polars as pl

        types = {"str": pl.String, "bool": pl.Boolean}
        schema = {field.name: types.get(str(field.type), pl.Float64) for field in fields(FleetGain)}
        refused = [{"robot": robot, "outcome": "refused", "why": why, "outlier": False} for robot, why in self.refused]
        return pl.DataFrame([asdict(gain) for gain in self.gains] + refused, schema=schema)


def fleet_table(reports: Sequence[Report]) -> FleetGains:
    """Compare the gains of each joint over the robots of the same model; see :func:`_median_and_spread`."""
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
        limits = _outlier_limits(freedom, spread, tests)
        for place, k in enumerate(members):
            if median:
                gains[k] = replace(gains[k], difference_percent=float(100 * (values[place] / median - 1)))
            if comparable:
                distance, limit = float(z[place]), float(limits[place])
                gains[k] = replace(gains[k], z=distance, limit=limit, outlier=abs(distance) > limit)
    refused = tuple((report.robot, report.sentence) for report in reports if report.model is None)
    return FleetGains(tuple(gains), tuple(joints), refused)


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


def _outlier_limits(freedom: np.ndarray, spread: float, tests: int) -> np.ndarray:
    """Compute the ``|z|`` (N,) that Student's t exceeds with a probability of 5 % in ``tests`` draws."""
    from scipy.special import stdtrit

    spread_freedom = max(EFFICIENCY * (len(freedom) - 1), 1.0)
    # a spread may be the larger part: its few degrees of freedom then count for both
    both = np.minimum(freedom, spread_freedom) if spread else freedom
    return np.asarray(stdtrit(both, 1 - FALSE_ALARM / (2 * tests)))


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
