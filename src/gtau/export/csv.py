"""CSV table of gains, delays, friction, base parameters and payloads with their intervals."""

from __future__ import annotations

from pathlib import Path

from gtau.documents.files import in_csv
from gtau.estimation.results.result import Result
from gtau.export.exported import Exported, written
from gtau.export.names import identifier


def export(result: Result, out: Path) -> Exported:
    """Write ``NAME.csv`` into ``out``: one row per estimate, with value, std, 95 % interval and unit."""
    return Exported(written(out, {f"{identifier(result.robot.name)}.csv": in_csv(result.to_frame())}))
