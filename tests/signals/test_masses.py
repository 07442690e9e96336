"""Masses in the names of logs: read where there is one reading, asked where there are several."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from gtau.cli.commands import app
from gtau.signals.reading.discovery import discover
from gtau.signals.reading.drafting import draft_text, with_masses
from gtau.signals.reading.statements import masses_in_name


@pytest.mark.parametrize(
    ("name", "masses"),
    [
        ("free.csv", ()),
        ("loaded_1983g.csv", (1.983,)),
        ("exciting_3_loaded_1983g.csv", (1.983,)),
        ("loaded_1.5kg.csv", (1.5,)),
        ("loaded_1.200,5g.csv", (0.2005, 1.2005)),
        ("１．２kg.csv", (1.2,)),
        ("loaded_1,5kg.csv", (1.5,)),
        ("loaded1_1.5kg.csv", (1.5,)),  # log 1
        ("load1-1p5kg.csv", (1.5,)),
        ("load_1.1.5kg.csv", (1.5, 5.0)),
        ("load_1p5kg.csv", (1.5,)),
        ("load_1,500g.csv", (1.5,)),  # no payload has 1.5 g
        ("run_003_5 Kg.csv", (5.0,)),  # no decimal number begins with 003
        ("2024-05-13_5kg.csv", (5.0,)),
        ("20240513_143000_5kg.csv", (5.0,)),
        ("load-5-kg.csv", (5.0,)),
        ("load_5kilos.csv", (5.0,)),
        ("load_500grams.csv", (0.5,)),
        ("5lb.csv", (2.267962,)),
        ("0kg.csv", (0.0,)),
        ("inertia_5kgm2.csv", ()),
        ("loaded_1_5kg.csv", (1.5, 5.0)),
        ("0.7+0.5kg.csv", (0.5, 0.0)),
        ("steel_2+plate_1kg.csv", (1.0,)),
        ("1-5kg.csv", (1.5, 5.0)),
        ("load_0_48kg.csv", (0.48, 48.0)),
        ("load_1kg5.csv", (1.0, 0.0)),
        ("run_2_500g.csv", (2.5, 0.5)),
        ("payload.5kg.csv", (5.0, 0.5)),
        ("2x1.25kg.csv", (1.25, 0.0)),
        ("tool_0.5kg_load_1kg.csv", (0.5, 1.0, 1.5)),
        ("1 1/2kg", (2.0, 0.0)),
        ("load_1½kg.csv", (2.0, 0.0)),
        ("load_3⁄4kg.csv", (4.0, 0.0)),
        ("run1e2kg.csv", (2.0, 0.0)),
        ("without_2kg.csv", (2.0, 0.0)),
        ("no_5kg.csv", (5.0, 0.0)),
        ("no_load_5kg.csv", (5.0, 0.0)),
        ("domino_5kg.csv", (5.0,)),
        ("chirp_0.5g.csv", (0.0005, 0.0)),  # an acceleration?
    ],
)
def test_readings_of_names(name: str, masses: tuple[float, ...]) -> None:
    assert masses_in_name(name) == masses


def test_a_name_with_two_readings_is_asked_about(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """First of all; the draft cannot be used before the mass is written, and logs not before it is stated."""
    monkeypatch.chdir(tmp_path)
    time = np.arange(500) / 250
    table = np.column_stack([time, np.sin(time), np.cos(time), np.cos(2 * time), np.sin(time)])
    log = Path("loaded_1_5kg.csv")
    np.savetxt(log, table, delimiter=",", header="t,q_left,q_right,i_left,i_right", comments="")
    robot = ["--robot", "five-bar"]
    shown = CliRunner().invoke(app, ["init", str(log), *robot]).output
    assert shown.split("marked CHECK:")[1].strip().startswith("- write the payload masses")
    assert "confirm the payload masses" not in shown
    assert "mass: 1.5 or 5}  # CHECK: write one of them" in Path("experiment.yaml").read_text()
    assert "'1.5 or 5' is not a number" in CliRunner().invoke(app, ["check", "experiment.yaml"]).output
    refused = CliRunner().invoke(app, ["check", str(log), *robot])
    assert refused.exit_code == 2
    assert "state it by --payload loaded_1_5kg.csv=1.5" in " ".join(refused.output.split())
    stated = with_masses(discover([log]), {log: 5.0})
    assert not {"mass", "masses"} & set(stated.open)
    assert "mass: 5.0}" in draft_text(stated, tmp_path)
