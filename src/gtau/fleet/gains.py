"""Table of the drive gains of a fleet, with outliers marked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gtau.estimation.results.estimate import Estimate
from gtau.fleet.fleet import Report

LEAST = 8  # values: the spread of fewer is too uncertain to call one an outlier
FALSE_ALARM = 0.05  # chance of an outlier in a fleet without outliers; 0.1 where the spread is small
EFFICIENCY = 0.37  # of a median-based spread, relative to the standard deviation
QUARTILE = 0.4549364  # median of the chi-square distribution with one degree of freedom


def median_and_spread(values: np.ndarray, std: np.ndarray) -> tuple[float, float]:
    """Compute the weighted median of values, and their spread beyond their own standard deviations ``std`` (N,).

    With this spread ``(value - median)^2 / (spread^2 + std^2)`` has the median of a chi-square variable, so it breaks
    down only if half of the values are outliers.
    """
    median, spread = float(np.median(values)), 0.0
    for _ in range(20):
        before = median, spread
        spread = _spread((values - median) ** 2, std**2)
        median = _weighted_median(values, 1 / np.maximum(np.hypot(spread, std), 1e-300))
        if (median, spread) == before:
            break
    return median, spread


def outlier_limits(freedom: np.ndarray, spread: float, tests: int) -> np.ndarray:
    """Compute the ``|z|`` (N,) beyond which values are outliers.

    A t distribution exceeds the limit with a probability of 5 % in ``tests`` draws, one per value tested in the whole
    fleet. ``freedom`` (N,) are the degrees of freedom of the standard deviations (inf: very many).
    """
    from scipy.special import stdtrit

    spread_freedom = max(EFFICIENCY * (len(freedom) - 1), 1.0)
    # a spread may be the larger part: its few degrees of freedom then count for both
    both = np.minimum(freedom, spread_freedom) if spread else freedom
    limits: np.ndarray = stdtrit(both, 1 - FALSE_ALARM / (2 * tests))
    return limits


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

    ``estimate`` is the gain in the unit of its joint, ``outcome`` and ``why`` are the verdict of its own
    identification; ``difference_percent`` from the median of the fleet; ``z`` the same in standard deviations, and
    ``limit`` the outlier threshold, both None without others to compare with.
    """

    robot: str
    model: str
    estimate: Estimate
    outcome: str
    why: str
    difference_percent: float | None = None
    z: float | None = None
    limit: float | None = None

    @property
    def joint(self) -> str:
        """Name of the joint."""
        return self.estimate.name

    @property
    def outlier(self) -> bool:
        """Whether the gain is an outlier of the fleet."""
        return self.z is not None and self.limit is not None and abs(self.z) > self.limit

    @property
    def row(self) -> dict[str, Any]:
        """Row of the fleet's table; ``half_width`` is half the 95 % interval, in ``unit``."""
        return {
            "robot": self.robot,
            "model": self.model,
            "joint": self.joint,
            "gain": self.estimate.value,
            "std": self.estimate.std,
            "unit": self.estimate.unit,
            "outcome": self.outcome,
            "why": self.why,
            "difference_percent": self.difference_percent,
            "z": self.z,
            "limit": self.limit,
            "outlier": self.outlier,
            "half_width": self.estimate.half_interval(),
        }


@dataclass(frozen=True)
class JointOfFleet:
    """A joint over all robots of one model, in ``unit``: weighted ``median``, its standard deviation and ``spread``.

    The spread is the standard deviation between the robots beyond the gains' own standard deviations; ``comparable``
    says whether there are enough robots to find outliers.
    """

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
    """Compare the gains of each joint over the robots of the same model; see :func:`median_and_spread`."""
    gains, models = [], [(report.member.name, report.model) for report in reports if report.model is not None]
    for robot, model in models:
        for gain in model["drive_gains"]:
            estimate = Estimate(gain["joint"], gain["value"], gain["std"], gain["unit"], freedom=gain["freedom"])
            gains.append(FleetGain(robot, model["robot"], estimate, gain["outcome"], gain["why"]))
    groups: dict[tuple[str, str, str], list[int]] = {}
    for k, member in enumerate(gains):
        if member.estimate.value is not None and member.estimate.std is not None:
            groups.setdefault((member.model, member.joint, member.estimate.unit), []).append(k)
    tests = sum(map(len, groups.values()))
    joints = []
    for group, members in groups.items():
        estimates = [gains[k].estimate for k in members]
        rows = [(gain.value, gain.std, gain.freedom or np.inf) for gain in estimates]
        values, std, freedom = np.array(rows, dtype=float).T
        median, spread = median_and_spread(values, std)
        total = np.hypot(spread, std)
        median_std = float(np.sqrt(np.pi / 2 / np.sum(1 / np.maximum(total, 1e-150) ** 2)))
        comparable = len(members) >= LEAST
        joints.append(JointOfFleet(*group, len(members), median, median_std, spread, comparable))
        distances = np.divide(values - median, total, out=np.zeros(len(values)), where=total > 0)
        limits = outlier_limits(freedom, spread, tests)
        for k, value, z, limit in zip(members, values, distances, limits, strict=True):
            gains[k] = replace(
                gains[k],
                difference_percent=float(100 * (value / median - 1)) if median else None,
                z=float(z) if comparable else None,
                limit=float(limit) if comparable else None,
            )
    refused = tuple((report.member.name, report.sentence) for report in reports if report.model is None)
    return FleetTable(tuple(gains), tuple(joints), refused)
