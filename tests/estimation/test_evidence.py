"""docs/evidence/thresholds.csv has the evidence for the constants that decide outcomes, with the values of the code."""

from __future__ import annotations

import ast
import csv
from fractions import Fraction
from importlib import import_module
from pathlib import Path

import gtau.estimation

SOURCE = Path(gtau.estimation.__file__).parent
TABLE = Path(__file__).parents[2] / "docs" / "evidence" / "thresholds.csv"
ROWS = list(csv.DictReader(TABLE.read_text(encoding="utf-8").splitlines()))


def test_every_row_has_the_value_of_the_code() -> None:
    keys = [(row["module"], row["name"]) for row in ROWS]
    assert keys == sorted(set(keys))
    for row in ROWS:
        value = getattr(import_module(row["module"]), row["name"])
        assert value == float(Fraction(row["value"])), row["name"]
        assert all(row[column] for column in ("statistic", "healthy", "faulty", "evidence")), row["name"]


def test_every_number_that_decides_an_outcome_has_a_row() -> None:
    """Where outcomes are decided, numbers are compared with counts, factors of units and constants of the table."""
    plain = {0, 1, 2, 3, 100, 1000, 0.001, 0.999}  # the last is where printed per cents round
    numerical = {"pose_fit.py", "linearisation.py"}  # whose constants are tolerances of their arithmetic
    allowed = {"NORMAL", *(row["name"] for row in ROWS)}  # the normal distribution
    decide = {*(SOURCE / "diagnostics").rglob("*.py"), SOURCE / "regression" / "plausibility.py"}
    for path in sorted(path for path in decide if path.name not in numerical):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        own = {
            target.id
            for node in tree.body
            if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant)
            for target in node.targets
            if isinstance(target, ast.Name) and isinstance(node.value.value, (int, float))
        }
        for part in (part for node in ast.walk(tree) if isinstance(node, ast.Compare) for part in ast.walk(node)):
            if isinstance(part, ast.Constant) and isinstance(part.value, (int, float)):
                assert part.value in plain, f"{path.name}:{part.lineno} compares with {part.value}"
            if isinstance(part, ast.Name):
                assert part.id not in own - allowed, f"{path.name}:{part.lineno}: {part.id} has no row in {TABLE.name}"
