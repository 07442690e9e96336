"""Write tables as CSV, safe from formulas in spreadsheets."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import polars as pl

FORMULA = r"^(\s*[=+\-@])"  # begins a cell that spreadsheets compute


def in_csv(table: pl.DataFrame) -> str:
    """Write a table as CSV; an apostrophe before ``= + - @`` keeps a spreadsheet from computing texts."""
    import polars as pl

    return table.with_columns(pl.col(pl.String).str.replace(FORMULA, "'$1")).write_csv()
