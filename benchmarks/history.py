"""How the rows of benchmarks.json changed, commit by commit.

    python benchmarks/history.py [--row WORDS] [--csv FILE]

Each commit that changed benchmarks.json is a column of measurements of its own machine; ratios to the peer compare
better than times. A row is named by its work and peer.
"""

from __future__ import annotations

import argparse
import json
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path

from table import write_csv

ROOT = Path(__file__).parents[1]
FILE = "benchmarks.json"


def git(*arguments: str) -> str:
    done = subprocess.run(["git", "-C", str(ROOT), *arguments], check=True, capture_output=True, text=True)
    return done.stdout


def versions() -> Iterator[tuple[str, str, Mapping[str, dict]]]:
    """Iterate over commits, oldest first: hash, date, and rows by name."""
    for line in git("log", "--reverse", "--format=%h %as", "--", FILE).splitlines():
        commit, date = line.split()
        document = json.loads(git("show", f"{commit}:{FILE}"))
        yield commit, date, {f"{row['work']} | {row['peer']}".rstrip(" |"): row for row in document["rows"]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--row", default="", help="rows whose name contains this")
    parser.add_argument("--csv", type=Path, help="write the table: row, unit, commit, date, ours, ratio")
    options = parser.parse_args()
    lines = [["row", "unit", "commit", "date", "ours", "ratio"]]
    for commit, date, rows in versions():
        for name, row in rows.items():
            if options.row in name:
                ratio = "" if row["ratio"] is None else f"{row['ratio']:.3g}"
                lines.append([name, row["unit"], commit, date, f"{row['ours']:.4g}", ratio])
    head, *body = lines
    for line in [head, *sorted(body, key=lambda cells: cells[0])]:
        print(" | ".join(line))
    if options.csv:
        write_csv(options.csv, lines)


if __name__ == "__main__":
    main()
