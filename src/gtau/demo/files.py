"""The files of the demo: what is simulated, what is identified from it, and what motion to log next."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

from gtau.documents.yaml_document import yaml_text
from gtau.simulation.orthoglide_truth import (
    DRIVE_GAINS,
    PAYLOAD_MASS,
    PRIOR_GAINS,
    SECOND_PAYLOAD_MASS,
    drives,
    standard_parameters,
)

RATE = 1000.0  # Hz

# What a run carries, as a simulation file says it.
EMPTY: dict[str, Any] = {}
STEEL = {"payload": {"name": "steel", "mass": PAYLOAD_MASS, "mass_std": 0.001}}
SECOND = {"payload": {"name": "second", "mass": SECOND_PAYLOAD_MASS}, "weigh": True}
# Log, kind of trajectory, what is carried.
LOGS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("exciting_1_unloaded", "sines", EMPTY),
    ("exciting_2_unloaded", "moves", EMPTY),
    ("exciting_3_loaded", "sines", STEEL),
    ("exciting_4_loaded", "moves", STEEL),
    ("validation_loaded", "sines", STEEL),
    ("second_payload", "sines", SECOND),
    ("second_payload_unloaded", "sines", EMPTY),
)
VALIDATION = "validation_loaded"  # the log that is not identified from
# Points (m) of joints 11, 12 and 13 on which control laws are compared: in a horizontal plane, where the vertical axis
# 13 hardly moves, and in space.
CONTROL: dict[str, tuple[tuple[float, float, float], ...]] = {
    "trajectory_1": (
        (0.015, 0.015, 0.015),
        (0.08, -0.05, 0.015),
        (0.08, 0.08, 0.02),
        (-0.05, 0.08, 0.015),
        (-0.05, -0.05, 0.01),
        (0.015, 0.015, 0.015),
    ),
    "trajectory_2": (
        (0.015, 0.015, 0.015),
        (0.09, 0.07, 0.05),
        (-0.06, -0.04, -0.05),
        (0.09, -0.05, 0.08),
        (-0.03, 0.09, -0.05),
        (0.015, 0.015, 0.015),
    ),
}
SIMULATION = """\
# The robot that stands in for a real one: its true parameters, its drives and sensors, and the runs. Made again from
# this file, the logs are the same: gtau simulate simulation.yaml --out simulated
"""

SIGNALS = """\
robot: orthoglide            # a name of the catalog, or a robot file
signals:                     # columns of the logs
  time: t                                        # s
  position: {11: q11, 12: q12, 13: q13}          # m
  current: {11: v11, 12: v12, 13: v13}           # A, the references of the current loops
prior_gains: {11: 2001, 12: 2001, 13: 2001}      # N/A, the manufacturer's
"""
EXPERIMENT = f"""\
# What was logged, and what is known of it. Paths are relative to this file.
{SIGNALS}runs:
  - {{log: logs/exciting_1_unloaded.csv}}
  - {{log: logs/exciting_2_unloaded.csv}}
  - {{log: logs/exciting_3_loaded.csv, payload: {{name: steel, mass: {PAYLOAD_MASS}, mass_std: 0.001}}}}
  - {{log: logs/exciting_4_loaded.csv, payload: {{name: steel, mass: {PAYLOAD_MASS}, mass_std: 0.001}}}}
validation:                  # not used for the identification
  - {{log: logs/validation_loaded.csv, payload: {{name: steel, mass: {PAYLOAD_MASS}, mass_std: 0.001}}}}
"""
SECOND_PAYLOAD = f"""\
# A payload to be weighed: it has a name, but no mass.
{SIGNALS}runs:
  - {{log: logs/second_payload_unloaded.csv}}
  - {{log: logs/second_payload.csv, payload: {{name: second}}}}
"""
DESIGN = f"""\
# The motion to log next: gtau excite design.yaml --out design
robot: orthoglide
rate: {RATE:g}                   # of the controller, Hz
period: 5                    # s
harmonics: 8                 # sines and cosines of each joint
runs:
  - {{payload: none}}
  - {{payload: {{name: steel, mass: {PAYLOAD_MASS}}}}}
prior:
  model: model.json          # of the identification: parameters, gains and noise
"""


def simulation_text(duration: float) -> str:
    """Write the simulation file of the demo, its logs ``duration`` s long."""
    runs = [
        {"name": name, "trajectory": {kind: {"seed": seed, "duration": duration}}, **deepcopy(carried)}
        for seed, (name, kind, carried) in enumerate(LOGS)
    ]
    control = [
        {"name": name, "trajectory": {"points": {"through": _points(points)}}, **deepcopy(STEEL)}
        for name, points in CONTROL.items()
    ]
    document = {
        "robot": "orthoglide",
        "rate": RATE,
        "seed": 1,
        "prior_gains": PRIOR_GAINS,
        "drives": drives(),
        "parameters": standard_parameters(),
        "runs": [run for run in runs if run["name"] != VALIDATION],
        "validation": [run for run in runs if run["name"] == VALIDATION],
        "control": control,
    }
    return SIMULATION + yaml_text(document)


def _points(points: tuple[tuple[float, ...], ...]) -> list[dict[str, float]]:
    return [dict(zip(DRIVE_GAINS, point, strict=True)) for point in points]
