"""The cheat sheet: every cell runs on the logs of the tutorial."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest
import yaml
from c_code import GCC
from typer.testing import CliRunner

from gtau.cli.commands import app
from gtau.demo import write_tutorial
from gtau.signals.reading.experiment import read_experiment

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "lookup" / "cheat-sheet.md").read_text(encoding="utf-8")


def column(name: str) -> list[str]:
    """The code in a column of the tables."""
    cells, at = [], None
    for line in PAGE.splitlines():
        row = [cell.strip() for cell in line[1:-1].split("|")] if line.startswith("|") else []
        if not row:
            at = None
        elif at is None:
            at = row.index(name) if name in row else len(row)
        elif at < len(row):
            cells += re.findall(r"`([^`]+)`", row[at])
    return cells


def block(language: str) -> str:
    return re.search(rf"^```{language}\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)[1]


def command(line: str) -> None:
    result = CliRunner().invoke(app, line.split()[1:])
    assert result.exit_code == 0, (line, result.output)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The logs, and what the first commands of the page write."""
    folder = tmp_path_factory.mktemp("cheat-sheet")
    write_tutorial(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for line in block("console").splitlines()[1:]:
            command(line.removeprefix("$ "))
    return folder


def test_every_cell_of_python_runs(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(folder)
    place: dict = {}
    exec(block("python"), place)
    cells = column("Python")
    assert len(cells) >= 20
    for cell in cells:
        exec(f"made = {cell}", place)
        assert place["made"] is not None or "report(" in cell, cell


def test_every_command_runs(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    lines = column("command")
    assert len(lines) >= 8
    for line in dict.fromkeys(lines):
        command(line)


def test_every_key_is_one_of_an_experiment_file(folder: Path) -> None:
    written = yaml.safe_load((folder / "result" / "experiment.yaml").read_text(encoding="utf-8"))
    written["runs"] = [{"log": str(folder / "empty_1.csv")}]
    for cell in column("key"):
        key = yaml.safe_load(cell)
        runs = [written["runs"][0] | key] if "payload" in key else written["runs"]
        (folder / "key.yaml").write_text(yaml.safe_dump(written | {"runs": runs} | ({} if "payload" in key else key)))
        read_experiment(folder / "key.yaml")


@pytest.mark.skipif(GCC is None, reason="no C compiler")
def test_every_cell_of_c_compiles(folder: Path) -> None:
    lines = [cell if cell.endswith(";") else f"(void){cell};" for cell in column("C")]
    assert len(lines) >= 10
    program = f"""#include "five_bar.h"
#include "five_bar_observer.h"
int main(void) {{
  const double q[2] = {{2.1, 1.0}}, qd[2] = {{0.5, -0.5}}, qdd[2] = {{0.0, 0.0}}, limit[2] = {{9.0, 9.0}};
  double W[2 * FIVE_BAR_PARAMETERS], M[4], torque[2], current[2], external[2];
  five_bar_observer observer;
  {block("c")}
  five_bar_observer_start(&observer, 0.001, 31.4, limit, limit, q);
  {" ".join(lines)}
  return 0;
}}
"""
    (folder / "model_c" / "cells.c").write_text(program)
    sources = ["cells.c", "five_bar.c", "five_bar_observer.c"]
    made = [GCC, "-std=c99", "-Wall", "-Werror", *sources, "-lm", "-o", "cells"]
    subprocess.run(made, cwd=folder / "model_c", check=True)
    subprocess.run(["./cells"], cwd=folder / "model_c", check=True)
