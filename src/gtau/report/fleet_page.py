"""A fleet as text, as a JSON document, and as a table in files."""

from __future__ import annotations

import io
import textwrap
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import polars as pl

from gtau.documents.files import write_atomically
from gtau.fleet.gains import FleetGain, FleetTable, table_rows
from gtau.signals.samples import counted

WIDTH = 80
LISTED = 20  # outliers, or robots that were refused; the others stand in the table


def fleet_document(table: FleetTable) -> dict[str, Any]:
    """Describe the fleet as a JSON document: joints over the fleet, gains by robot, robots that were refused."""
    return {
        "schema": "gtau-fleet/1",
        "joints": [asdict(joint) for joint in table.joints],
        "gains": [asdict(gain) for gain in table.gains],
        "refused": [{"robot": robot, "why": why} for robot, why in table.refused],
    }


def fleet_page(table: FleetTable) -> str:
    """Print the fleet: each joint over the robots, outliers, and robots that were refused."""
    lines = [
        f"{counted(len(table.robots), 'robot')} identified, {len(table.refused)} refused",
        "",
        f"{'Drive gains over the fleet':<32}{'robots':>7}{'median':>12}{'std':>10}{'spread %':>10}   unit",
    ]
    lines += [
        f"  {f'{each.model} {each.joint}':<30}{each.robots:>7}{each.median:>12.5g}{each.median_std:>10.2g}"
        f"{100 * each.spread / abs(each.median):>10.2f}   {each.unit}"
        for each in table.joints
    ]
    outliers = table.outliers
    lines += ["", f"{'Outliers':<32}{'gain':>12}{'std':>10}{'off %':>9}{'z':>8}{'limit':>8}"]
    lines += [
        f"  {f'{g.robot} {g.joint}':<30}{g.gain:>12.5g}{g.std:>10.2g}{g.difference_percent:>9.2f}{g.z:>8.1f}"
        f"{g.limit:>8.1f}"
        for g in outliers[:LISTED]
    ] or ["  none"]
    lines += [f"  and {len(outliers) - LISTED} more"] if len(outliers) > LISTED else []
    for sentence in remarks(table):
        lines += textwrap.wrap(sentence, WIDTH, initial_indent="  ", subsequent_indent="  ")
    if table.refused:
        lines += ["", "Refused"]
        whole_words = textwrap.TextWrapper(
            WIDTH, initial_indent="  ", subsequent_indent="    ", break_long_words=False, break_on_hyphens=False
        )
        for robot, why in table.refused[:LISTED]:
            lines += whole_words.wrap(f"{robot}: {why}")
        lines += [f"  and {len(table.refused) - LISTED} more"] if len(table.refused) > LISTED else []
    return "\n".join(lines)


def remarks(table: FleetTable) -> list[str]:
    """List what else is to be said of the outliers."""
    said = [
        f"robot '{robot}': all its gains are {sign} alike; check the payload's mass in its experiment first"
        for robot, sign in _off_alike(table.outliers, table.gains)
    ]
    few = [each for each in table.joints if not each.comparable]
    if few:
        models = ", ".join(dict.fromkeys(f"'{each.model}'" for each in few))
        said.append(f"of {models} there are too few robots to find outliers (8 are needed)")
    return said


def _off_alike(outliers: Sequence[FleetGain], gains: Sequence[FleetGain]) -> list[tuple[str, str]]:
    joints = Counter(gain.robot for gain in gains)
    signs = Counter((g.robot, "too large" if (g.difference_percent or 0) > 0 else "too small") for g in outliers)
    return [key for key, count in signs.items() if 1 < count == joints[key[0]]]


def write_fleet(table: FleetTable, out: Path) -> list[Path]:
    """Write ``gains.csv``, ``gains.parquet`` and, where matplotlib is there, a figure of each robot model."""
    frame = pl.DataFrame(table_rows(table), schema=_SCHEMA)
    parquet = io.BytesIO()
    frame.write_parquet(parquet)
    written = [out / "gains.csv", out / "gains.parquet"]
    write_atomically(written[0], frame.write_csv())
    write_atomically(written[1], parquet.getvalue())
    if find_spec("matplotlib") is not None:
        from gtau.report.fleet_figure import fleet_figure
        from gtau.report.style import save_figure

        models = list(dict.fromkeys(joint.model for joint in table.joints))
        for k, model in enumerate(models):
            written.append(out / ("gains.png" if len(models) == 1 else f"gains_{k + 1}.png"))
            save_figure(fleet_figure(table, model), written[-1])
    return written


_SCHEMA = {
    "robot": pl.String,
    "model": pl.String,
    "joint": pl.String,
    "gain": pl.Float64,
    "std": pl.Float64,
    "unit": pl.String,
    "outcome": pl.String,
    "why": pl.String,
    "difference_percent": pl.Float64,
    "z": pl.Float64,
    "limit": pl.Float64,
    "outlier": pl.Boolean,
}
