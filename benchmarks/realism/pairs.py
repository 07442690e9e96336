"""Real and independently simulated logs of which two experiments exist, or the truth."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from zoo import experiment_file, numbered

from gtau.estimation.results.estimate import Estimate
from gtau.result import Result, identify
from gtau.signals.reading.experiment import read_experiment

UR10E = [f"{joint}_joint" for joint in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")]
UR10E_LOADED = ("02_19_14harm50secLoad", "01_31-load")  # 19 February, 31 January
UR10E_FREE = {  # unloaded runs beside them
    "two days": ("02_19_14harm50sec", "01_31-unload"),
    "free runs of 12 and 5 February": ("02_12-40sec_12harm", "02_05-20sec_8harm"),
    "free runs of 10 and 6 February": ("02_10-30sec_12harm", "02_06-20sec_10harm"),
}
ORTHOGLIDE = ["11", "12", "13"]
DVRK = ["yaw", "pitch", "insertion"]


@dataclass(frozen=True)
class Pair:
    """What is compared: gains of two experiments by joint; of the truth the standard deviation is 0."""

    name: str
    first: dict[str, Estimate]
    second: dict[str, Estimate]


def pairs(data: Path) -> Iterator[Pair]:
    """All pairs of the logs in the folder ``data``."""
    for name, free in UR10E_FREE.items():
        days = [_ur10e(data, *logs) for logs in zip(free, UR10E_LOADED, strict=True)]
        yield Pair(f"UR10e, {name}", *(day.drive_gains for day in days))
    halves = [_orthoglide(data, (k, k + 2)) for k in (1, 2)]
    yield Pair("Orthoglide, halves of the runs", *(half.drive_gains for half in halves))
    truth = json.loads((data / "orthoglide_sim" / "truth.json").read_text(encoding="utf-8"))["drive_gains"]
    known = {joint: Estimate(joint, gain, 0.0, "N per A") for joint, gain in zip(ORTHOGLIDE, truth, strict=True)}
    yield Pair("Orthoglide, truth", _orthoglide(data, (1, 2, 3, 4)).drive_gains, known)
    yield Pair("dVRK, 105 g and 205 g", *(_dvrk(data, grams).drive_gains for grams in (105, 205)))


def _identified(text: str) -> Result:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "experiment.yaml"
        path.write_text(text, encoding="utf-8")
        return identify(read_experiment(path))


def _ur10e(data: Path, free: str, loaded: str) -> Result:
    logs = data / "ur10e"
    runs = [
        (logs / f"ur-20_{free}.csv", ""),
        (logs / f"ur-20_{loaded}.csv", ", payload: {name: disc, mass: 2.805}"),
    ]
    currents = ("current", numbered("", UR10E, 14))
    return _identified(experiment_file("ur10e", "'1'", numbered("", UR10E, 2), currents, runs, []))


def _orthoglide(data: Path, numbers: tuple[int, ...]) -> Result:
    logs = data / "orthoglide_sim"
    runs = [
        (logs / f"exciting_{k}_unloaded.csv", "")
        if k < 3
        else (logs / f"exciting_{k}_loaded_1983g.csv", ", payload: {name: steel, mass: 1.983}")
        for k in numbers
    ]
    currents = ("current", {joint: f"v{k}" for k, joint in enumerate(ORTHOGLIDE, start=1)})
    positions = {joint: f"q{joint}" for joint in ORTHOGLIDE}
    return _identified(experiment_file("orthoglide", "t", positions, currents, runs, []))


def _dvrk(data: Path, grams: int) -> Result:
    logs = data / "dvrk_psm"
    runs = [
        (logs / "one_no_weight_results.csv", ""),
        (logs / f"one_{grams}_grams_parallel_results.csv", f", payload: {{name: weight, mass: {grams / 1000}}}"),
    ]
    currents = ("current", numbered("tau", DVRK))
    return _identified(
        experiment_file(str(logs / "psm_front.yaml"), "{rate: 200}", numbered("q", DVRK), currents, runs, [])
    )
