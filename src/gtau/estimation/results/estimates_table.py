"""Table of all estimates of a result, for frames, summaries, reports and exports."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.identified_model import IdentifiedModel
from gtau.robots.parameter import parameter_of

if TYPE_CHECKING:
    import polars as pl

FRICTION = ("fv", "fs", "off")
"""Kinds of base parameters that are listed as friction."""


class Row(NamedTuple):
    """An estimate in its group."""

    group: str
    estimate: Estimate


def estimates_table(result: IdentifiedModel) -> Iterator[Row]:
    """List all estimates of a result, each once.

    Groups: ``drive gain``, ``delay``, ``base parameter``, ``friction`` (viscous, Coulomb and offsets, and then the
    terms that the data ask for), ``predicted friction`` (of all samples, with which the model predicts), ``logged
    speed`` (up to which friction is identified), ``torque sensor JOINT`` and ``payload NAME of RUN``.
    """

    def rows(group: str, estimates: Iterable[Estimate]) -> Iterator[Row]:
        return (Row(group, each) for each in estimates)

    yield from rows("drive gain", result.drive_gains.values())
    yield from rows("delay", result.delays.values())
    of_friction = {name: parameter_of(name).kind in FRICTION for name in result.parameters}
    yield from rows("base parameter", (each for name, each in result.parameters.items() if not of_friction[name]))
    yield from rows("friction", (each for name, each in result.parameters.items() if of_friction[name]))
    yield from rows("friction", result.friction.values())
    for curve in result.curves.values():
        yield from rows("predicted friction", curve.estimates)
    for joint, speed in result.logged_speeds.items():
        unit = "rad/s" if result.robot.joint(joint).kind == "revolute" else "m/s"
        yield Row("logged speed", Estimate(joint, speed, None, unit))
    for sensor in result.sensors:
        yield from rows(f"torque sensor {sensor.joint}", sensor.parameters.values())
    for payload in result.payloads:
        yield from rows(f"payload {payload.name} of {payload.run}", payload.parameters.values())


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
    return pl.DataFrame(list(map(_cells, estimates_table(result))), schema={**texts, **numbers, **rest})


def _cells(row: Row) -> dict[str, Any]:
    each = row.estimate
    low, high = each.interval() or (None, None)
    return {
        "group": row.group,
        "name": each.name,
        "value": each.value,
        "std": each.std,
        "rel_std": each.rel_std,
        "low": low,
        "high": high,
        "unit": each.unit,
        "verdict": each.verdict.outcome.value,
        "essential": each.essential,
        "regrouping": each.regrouping,
    }
