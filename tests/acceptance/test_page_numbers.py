"""Numbers on pages: they are those of the files that programs wrote."""

from __future__ import annotations

import csv
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EVIDENCE = ROOT / "docs" / "evidence"


@pytest.fixture
def defects(monkeypatch: pytest.MonkeyPatch) -> dict:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    from realism.departures import DEPARTURES

    yield DEPARTURES
    for name in [name for name in sys.modules if name.split(".")[0] == "realism"]:
        del sys.modules[name]


def test_the_headline_of_coverage_counts_every_row(defects: dict) -> None:
    page = (EVIDENCE / "index.md").read_text(encoding="utf-8")
    with (EVIDENCE / "coverage" / "defects-by-robot.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["defect"] for row in rows} == set(defects)

    def hits(chosen: list[dict[str, str]], column: str = "intervals with the truth", of: str = "intervals") -> str:
        return f"{sum(int(row[column]) for row in chosen)} of {sum(int(row[of]) for row in chosen)}"

    faulty = [row for row in rows if row["defect"] != "none" and not defects[row["defect"]].wrong]
    wrong = [row for row in rows if defects[row["defect"]].wrong]
    named = {
        "no defects: full intervals contain the truth": [row for row in rows if row["defect"] == "none"],
        "faulty logs or drives: intervals contain the truth": faulty,
        "wrong description: intervals contain the truth": wrong,
    }
    for words, chosen in named.items():
        headline = re.search(rf"^\| {re.escape(words)} \|[^|]*\|([^|]*)\|", page, re.MULTILINE)
        assert headline is not None
        assert hits(chosen) in headline[1]
    assert hits([*faulty, *wrong], "wrong good") in page
    assert f"with faulty logs or drives {hits(faulty)}." in (ROOT / "README.md").read_text(encoding="utf-8")
    with (EVIDENCE / "coverage" / "defects.csv").open(encoding="utf-8", newline="") as file:
        summed = {row["defect"]: row for row in csv.DictReader(file)}
    assert set(summed) == set(defects)
    for defect, line in summed.items():  # the sum over the robots; the page has those that hold too rarely
        assert line["intervals with the truth"] == hits([row for row in rows if row["defect"] == defect]), defect
        held, of = line["intervals with the truth"].split(" of ")
        assert (f"| {' | '.join(line.values())} |" in page) == (int(held) < 0.9 * int(of)), defect


def test_the_gains_of_the_orthoglide_are_as_near_as_pages_say() -> None:
    with (EVIDENCE / "measured" / "orthoglide.csv").open(encoding="utf-8", newline="") as file:
        worst = max(abs(float(row["error, %"])) for row in csv.DictReader(file))
    page = (EVIDENCE / "index.md").read_text(encoding="utf-8")
    for sentence in (f"an independent Orthoglide {worst} % from", f"are within {worst} % of the truth"):
        assert sentence in page
    assert f"the gains are within {worst} % of the truth" in (ROOT / "README.md").read_text(encoding="utf-8")


def test_errors_of_the_demonstration_are_those_of_its_gains() -> None:
    """To the last digit shown, as the errors are of gains that are not rounded."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    rows = re.findall(r"^1\d +([\d.]+) +([\d.]+) +(-[\d.]+) +([\d.]+) +[\d.]+ +([-\d.]+)$", readme, re.MULTILINE)
    assert len(rows) == 3
    for true, prior, off, found, error in (map(float, row) for row in rows):
        assert off == pytest.approx(100 * (prior / true - 1), abs=0.006)
        assert error == pytest.approx(100 * (found / true - 1), abs=0.008)
