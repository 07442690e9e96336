"""Logs of a five-bar that the model itself makes: everything about them is known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np

from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run

JOINTS = ("left", "right")
TOOL = "right_forearm"
GAINS = (2.5, 4.0)  # N m/A
STEEL = {"m": 1.2, "mx": 0.36, "my": 0.06, "zz": 0.12}
RATE = 500.0

CHI: dict[str, float] = {}
for _body, _values in {
    "left": {"m": 0.9, "mx": 0.11, "my": 0.01, "zz": 0.02, "ia": 0.03, "fv": 0.5, "fs": 0.8, "off": 0.1},
    "left_forearm": {"m": 0.5, "mx": 0.09, "my": -0.01, "zz": 0.02, "fv": 0.1, "fs": 0.08},
    "right": {"m": 1.0, "mx": 0.12, "my": 0.02, "zz": 0.025, "ia": 0.028, "fv": 0.6, "fs": 0.7, "off": -0.2},
    TOOL: {"m": 0.6, "mx": 0.1, "my": 0.02, "zz": 0.022, "fv": 0.12, "fs": 0.09},
}.items():
    CHI |= {f"{kind}_{_body}": value for kind, value in _values.items()}


@cache
def five_bar() -> InverseDynamics:
    """The model of the catalog's five-bar."""
    return InverseDynamics(load_robot("five-bar"))


@dataclass(frozen=True)
class Plant:
    """What makes the logs.

    A delay d of a joint means ``v(t - d) g = tau(t)``. ``noise`` is the standard deviation of the currents, A.
    """

    gains: Sequence[float] = GAINS
    delays: Sequence[float] = (0.0, 0.0)
    noise: float = 0.0
    chi: Mapping[str, float] = field(default_factory=lambda: CHI)

    def run(
        self, name: str, seconds: float = 10.0, payload: Mapping[str, float] | None = None, seed: int = 0, **more
    ) -> Run:
        """A run along a path of five sines a joint, with ``payload`` by kind on the tool; ``more`` goes to Run."""
        time = np.arange(round(seconds * RATE)) / RATE
        loaded = dict(self.chi)
        for kind, value in (payload or {}).items():
            loaded[f"{kind}_{TOOL}"] = loaded.get(f"{kind}_{TOOL}", 0.0) + value
        current = np.empty((len(time), 2))
        for j, delay in enumerate(self.delays):
            tau = five_bar().torques(*path(time + delay, seed), loaded)
            current[:, j] = tau[:, j] / self.gains[j]
        current += self.noise * np.random.default_rng(seed + 1000).normal(size=current.shape)
        return Run(name, JOINTS, time, path(time, seed)[0], current, **more)


def pair(plant: Plant) -> list[Run]:
    """A run without and one with the known payload."""
    free, loaded = plant.run("free", 8.0, seed=1), plant.run("loaded", 8.0, STEEL, seed=2)
    return [free, replace(loaded, payload=Payload(name="steel", mass=STEEL["m"]))]


def path(time: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, speed and acceleration (N, 2) of a path around home."""
    rng = np.random.default_rng(seed)
    w = 2 * np.pi * np.array([0.3, 0.7, 1.1, 1.6, 2.3])
    phase = rng.uniform(0, 2 * np.pi, (2, 5))
    angle = w * time[:, None, None] + phase
    size = 0.5 / w
    home = np.radians([120.0, 60.0])
    return (
        home + (size * np.sin(angle)).sum(axis=2),
        (size * w * np.cos(angle)).sum(axis=2),
        (-size * w**2 * np.sin(angle)).sum(axis=2),
    )


def write_log(file: Path, run: Run, digits: int = 7) -> Path:
    """Write a run as CSV with the columns t, q1, q2, v1, v2."""
    table = np.column_stack([run.time, run.position, run.command])
    np.savetxt(file, table, delimiter=",", header="t,q1,q2,v1,v2", comments="", fmt=["%.6f", *4 * [f"%.{digits}f"]])
    return file


EXPERIMENT = """\
robot: five-bar
signals: {time: t, position: {left: q1, right: q2}, current: {left: v1, right: v2}}
prior_gains: {left: 2.5, right: 4.0}
runs:
  - {log: free.csv}
  - {log: loaded.csv, payload: {name: steel, mass: 1.2}}
validation:
  - {log: check.csv, payload: {name: steel, mass: 1.2}}
"""

DESIGN = """
robot: five-bar
rate: 500
period: 4
harmonics: 4
runs:
  - payload: none
  - payload: {name: disc, mass: 1.0}
prior:
  gains: {left: 1.5, right: 1.5}
limits:
  velocity: {left: 4, right: 4}
  jerk: {left: 2000, right: 2000}
  workspace: {x: [0.11, 0.31], z: [0.14, 0.245]}
  away_from_reversals: 0.6
"""


def write_experiment(folder: Path, plant: Plant) -> Path:
    """Write a run without and one with the known payload, one for validation, and the file that describes them."""
    write_log(folder / "free.csv", plant.run("free", seed=1))
    write_log(folder / "loaded.csv", plant.run("loaded", payload=STEEL, seed=2))
    write_log(folder / "check.csv", plant.run("check", payload=STEEL, seed=3, seconds=6.0))
    (folder / "experiment.yaml").write_text(EXPERIMENT)
    return folder / "experiment.yaml"
