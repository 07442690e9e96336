"""Shared logs of robots of many makers, all with default settings: torque errors on logs that were not used."""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import pytest

from gtau.signals.reading.experiment import read_experiment

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"

# Largest torque errors of the joints on logs or stretches that were not used, % of the rms torque: published, or those
# of the README beside the logs, in the order of the model's joints.
PUBLISHED = {
    "tx40": (6.7, 6.4, 10.8, 9.4, 30.0, 22.0),  # weighted least squares of the log's source
    "panda": (8.7, 1.4, 3.7, 1.2, 6.8, 3.4, 19.6),  # weighted least squares behind a 10 Hz filter
}
# Where nothing is published, or the fit itself, errors are those of docs/evidence/zoo/logs.csv.
MEASURED = ("xmate7p", "kuka_med7", "xmate7p_1k", "upv", "rokae_sensor")
PAGE = Path(__file__).parents[2] / "docs" / "evidence" / "zoo" / "logs.csv"


@pytest.fixture
def zoo(monkeypatch: pytest.MonkeyPatch) -> object:
    monkeypatch.setattr(sys, "path", [*sys.path, str(BENCHMARKS)])
    import zoo

    return zoo


@pytest.mark.slow
@pytest.mark.parametrize("name", list(PUBLISHED))
def test_errors_are_below_the_published_ones(name: str, zoo: object, shared: Path, tmp_path: Path) -> None:
    (entry,) = (each for each in zoo.ENTRIES if each.name == name)  # type: ignore[attr-defined]
    (tmp_path / "e.yaml").write_text(entry.write(shared, tmp_path))
    _, errors, _ = zoo.run(read_experiment(tmp_path / "e.yaml"))  # type: ignore[attr-defined]
    for found, published in zip(map(float, errors.split(", ")), PUBLISHED[name], strict=True):
        assert found < published


@pytest.mark.slow
def test_masses_on_a_da_vinci_arm(zoo: object, shared: Path, tmp_path: Path) -> None:
    (entry,) = (each for each in zoo.ENTRIES if each.name == "dvrk_weigh")  # type: ignore[attr-defined]
    (tmp_path / "e.yaml").write_text(entry.write(shared, tmp_path))
    found, _, _ = zoo.run(read_experiment(tmp_path / "e.yaml"))  # type: ignore[attr-defined]
    for payload, mass in zip(found.payloads, (0.105, 0.205), strict=True):
        estimate = payload.parameters["m"]
        assert estimate.value == pytest.approx(mass, abs=2 * estimate.std)
        assert estimate.std < 0.035  # all runs repeat one motion, and blocks are left out of all together


@pytest.mark.slow
@pytest.mark.parametrize("name", MEASURED)
def test_errors_are_those_of_the_page(name: str, zoo: object, shared: Path, tmp_path: Path) -> None:
    """Logs that were refused once: short, of joints about vertical axes, or with few usable rows."""
    (entry,) = (each for each in zoo.ENTRIES if each.name == name)  # type: ignore[attr-defined]
    (tmp_path / "e.yaml").write_text(entry.write(shared, tmp_path))
    _, errors, _ = zoo.run(read_experiment(tmp_path / "e.yaml"))  # type: ignore[attr-defined]
    rows = csv.DictReader(PAGE.read_text(encoding="utf-8").splitlines())
    (shown,) = (row["error on logs not used, % of rms"] for row in rows if row["robot"] == entry.robot)
    found, listed = ([float(each) for each in cell.removeprefix("fit: ").split(", ")] for cell in (errors, shown))
    assert found == pytest.approx(listed, rel=0.1)
