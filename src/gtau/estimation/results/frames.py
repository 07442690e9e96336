"""Results as Polars tables."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.identified_model import IdentifiedModel

if TYPE_CHECKING:
    import polars as pl


def result_frame(result: IdentifiedModel) -> pl.DataFrame:
    """Tabulate all estimates of a result, one row each.

    Columns: ``group`` (drive gain, delay, parameter, friction, or the payload's name and run), ``name``, ``value``,
    ``std``, ``low`` and ``high`` of the 95 % interval, ``unit``, ``verdict``, whether a parameter is ``essential``
    (null for others), and what it ``regroups``. Essential parameters have the values re-estimated without the others.
    """
    rows = _rows("drive gain", result.drive_gains.values()) + _rows("delay", result.delays.values())
    for name, each in result.parameters.items():
        kept = name in result.essential
        rows.append(_row("parameter", result.essential[name] if kept else each) | {"essential": kept})
    rows += _rows("friction", result.friction.values())
    for payload in result.payloads:
        rows += _rows(f"payload {payload.name} of {payload.run}", payload.parameters.values())
    return _frame(rows)


def _rows(group: str, estimates: Iterable[Estimate]) -> list[dict[str, Any]]:
    return [_row(group, each) for each in estimates]


def _row(group: str, each: Estimate) -> dict[str, Any]:
    low, high = each.interval() or (None, None)
    return {
        "group": group,
        "name": each.name,
        "value": each.value,
        "std": each.std,
        "low": low,
        "high": high,
        "unit": each.unit,
        "verdict": each.verdict.outcome.value,
        "essential": None,
        "regroups": each.regrouping,
    }


def _frame(rows: list[dict[str, Any]]) -> pl.DataFrame:
    import polars as pl

    numbers = dict.fromkeys(("value", "std", "low", "high"), pl.Float64)
    texts = dict.fromkeys(("group", "name"), pl.String)
    rest = {"unit": pl.String, "verdict": pl.String, "essential": pl.Boolean, "regroups": pl.String}
    return pl.DataFrame(rows, schema={**texts, **numbers, **rest})
