"""Shared logs of robots of many makers, all with default settings: torque errors on logs that were not used."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from gtau.signals.experiment import read_experiment

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"

# Largest torque errors of the joints on logs or stretches that were not used, % of the rms torque: published, or those
# of the README beside the logs, in the order of the model's joints.
PUBLISHED = {
    "tx40": (6.7, 6.4, 10.8, 9.4, 30.0, 22.0),  # weighted least squares of the log's source
    "panda": (8.7, 1.4, 3.7, 1.2, 6.8, 3.4, 19.6),  # weighted least squares behind a 10 Hz filter
}


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
        assert estimate.std < 0.025


@pytest.mark.slow
@pytest.mark.parametrize("name", ["xmate7p", "kuka_med7", "upv", "rokae_sensor"])
def test_logs_once_refused_give_usable_rows(name: str, zoo: object, shared: Path, tmp_path: Path) -> None:
    """Every joint is identified, and its torques are explained better than by nothing."""
    (entry,) = (each for each in zoo.ENTRIES if each.name == name)  # type: ignore[attr-defined]
    (tmp_path / "e.yaml").write_text(entry.write(shared, tmp_path))
    found, _, _ = zoo.run(read_experiment(tmp_path / "e.yaml"))  # type: ignore[attr-defined]
    assert len(found.residuals) == len(found.robot.actuated)
    assert max(each.relative for each in found.residuals) < 60
