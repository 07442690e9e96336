"""Rows of what a result says of gains, friction, parameters and payloads, for tables of every form."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.result import Result

FRICTION = ("fv", "fs", "off", "f3", "fl")


@dataclass(frozen=True)
class Row:
    """An estimate in its group: drive gain, delay, friction, base parameter, or payload and its run."""

    group: str
    estimate: Estimate
    essential: bool = True

    def document(self) -> dict[str, object]:
        """Describe the row by column, None where there is no value; ``rel_std`` in per cent, a 95 % interval."""
        each = self.estimate
        low, high = each.interval() or (None, None)
        return {
            "group": self.group,
            "name": each.name,
            "value": each.value,
            "std": each.std,
            "rel_std": each.rel_std,
            "low": low,
            "high": high,
            "unit": each.unit,
            "verdict": each.verdict.outcome.value,
            "essential": self.essential,
            "regrouping": each.regrouping,
        }


def rows(result: Result) -> Iterator[Row]:
    """List all estimates: gains, delays, base parameters (friction by itself), friction terms, speeds, payloads."""
    yield from (Row("drive gain", each) for each in result.drive_gains.values())
    yield from (Row("delay", each) for each in result.delays.values())
    for name, each in result.parameters.items():
        group = "friction" if name.split("_", 1)[0] in FRICTION else "base parameter"
        yield Row(group, each, name in result.essential)
    yield from (Row("friction", each) for each in result.friction.values())
    for joint, speed in result.logged_speeds.items():
        unit = "rad/s" if result.robot.joint(joint).kind == "revolute" else "m/s"
        yield Row("logged speed", Estimate(joint, speed, None, unit))
    for payload in result.payloads:
        yield from (Row(f"payload {payload.name} ({payload.run})", each) for each in payload.parameters.values())
