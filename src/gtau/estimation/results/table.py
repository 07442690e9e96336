"""Table of all estimates of a result, each once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, NamedTuple

from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.result import IdentifiedModel
from gtau.robots.robot import PLAIN_FRICTION

if TYPE_CHECKING:
    import polars as pl


class Row(NamedTuple):
    """An estimate in its group."""

    group: str
    estimate: Estimate


def estimates_table(result: IdentifiedModel) -> Iterator[Row]:
    """List all estimates of a result, each once.

    Groups: ``drive gain``, ``delay``, ``base parameter``, ``friction`` (viscous, Coulomb and offsets, and then the
    terms that the data ask for), ``logged speed`` (up to which friction is identified), ``torque sensor JOINT`` and
    ``payload NAME of RUN``.
    """
    friction = {name: name.kind in PLAIN_FRICTION for name in result.parameters}
    robot = result.robot
    speeds = [
        Estimate(joint, speed, None, f"{robot.joint(joint).unit}/s") for joint, speed in result.logged_speeds.items()
    ]
    groups: list[tuple[str, Iterable[Estimate]]] = [
        ("drive gain", result.drive_gains.values()),
        ("delay", result.delays.values()),
        ("base parameter", [estimate for name, estimate in result.parameters.items() if not friction[name]]),
        ("friction", [estimate for name, estimate in result.parameters.items() if friction[name]]),
        ("friction", result.friction.values()),
        ("logged speed", speeds),
        *((f"{sensor.kind.name} {sensor.joint}", sensor.parameters.values()) for sensor in result.sensors),
        *((f"payload {payload.name} of {payload.run}", payload.parameters.values()) for payload in result.payloads),
    ]
    return (Row(group, estimate) for group, estimates in groups for estimate in estimates)


def estimates_frame(result: IdentifiedModel) -> pl.DataFrame:
    """Tabulate all estimates of a result, one row each.

    Columns: ``group`` (see :func:`estimates_table`), ``name``, ``value``, ``std``, ``rel_std`` (per cent), ``low`` and
    ``high`` of the 95 % interval, ``unit``, ``verdict``, ``essential`` (whether the reduction keeps a base parameter;
    null for other estimates) and ``regrouping``. Null where there is no value.
    """
    import polars as pl

    numbers = dict.fromkeys(("value", "std", "rel_std", "low", "high"), pl.Float64)
    texts = dict.fromkeys(("group", "name"), pl.String)
    rest = {"unit": pl.String, "verdict": pl.String, "essential": pl.Boolean, "regrouping": pl.String}
    rows = []
    for group, estimate in estimates_table(result):
        interval, verdict = estimate.interval() or (None, None), estimate.verdict.outcome.value
        numbered = (estimate.value, estimate.std, estimate.rel_std, *interval)
        rows.append((group, estimate.name, *numbered, estimate.unit, verdict, estimate.essential, estimate.regrouping))
    return pl.DataFrame(rows, schema={**texts, **numbers, **rest}, orient="row")
