"""One CSV table of gains, delays, friction, base parameters and payloads with their intervals."""

from __future__ import annotations

from pathlib import Path

import polars as pl

from gtau.estimation.results.result import Result
from gtau.export.exported import Exported, written
from gtau.export.identified import identifier
from gtau.export.tables import rows


def export(result: Result, out: Path) -> Exported:
    """Write ``NAME.csv`` into ``out``: a row an estimate; std, 95 % interval and unit beside each value."""
    table = pl.DataFrame([row.document() for row in rows(result)], infer_schema_length=None)
    return Exported(written(out, {f"{identifier(result.robot.name)}.csv": table.write_csv()}))
