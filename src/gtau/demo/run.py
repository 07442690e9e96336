"""The demo: simulation, identification and payload estimation on an Orthoglide with known true values.

The identifiable sums (paper, Table 3) are the paper's; we distributed them among the bodies by the dimensions of such a
machine.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any

from gtau.documents.files import folder_of, write_atomically
from gtau.documents.yaml_document import yaml_text
from gtau.estimation.experiment_runs import read_validation
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.model_file import save
from gtau.estimation.results.result import IdentifiedModel
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.progress import Progress
from gtau.report.identification import write_identification
from gtau.report.page import Column, Facts, Kind, Page, Section, Table, Text
from gtau.report.render.terminal import plain
from gtau.signals.reading.experiment import read_experiment
from gtau.simulation.closed_loop import write_log
from gtau.simulation.simulate import make_run, read_simulation
from gtau.uses.identify import identify
from gtau.uses.weigh import weigh

FILES = Path(__file__).with_name("orthoglide_files")
"""Experiment files and a design file, beside this module."""

DRIVE_GAINS = {"11": 2170.0, "12": 2100.0, "13": 2070.0}  # N per A, Table 3
PRIOR_GAINS = {"11": 2001.0, "12": 2001.0, "13": 2001.0}  # N per A, the manufacturer's 637 pi
PAYLOAD_MASS = 1.983  # kg, the known payload
SECOND_PAYLOAD_MASS = 1.136  # kg, the one to be weighed

BAR_LENGTH = 0.31  # m

# Table 3: m_1R (foot, rotor, and the bar's share, kg), fv (N s/m), fs (N); and the offset of the axis, N.
AXES = {"11": (9.40, 85.7, 35.2, 1.8), "12": (8.95, 86.7, 41.7, -1.2), "13": (0.87 + 8.05, 84.0, 24.1, 0.5)}
FOOT_3 = 0.87  # kg, m_13R: on the vertical axis gravity separates the foot from the rotor
PLATFORM = 0.92  # kg, m_6R: with its share of the bars and their joints
BARS = {"1": 0.170, "2": 0.174, "3": 0.172}  # kg, both bars of a parallelogram
# Viscous (N m s/rad) and Coulomb friction (N m) of passive joints 2 to 5.
PASSIVE_FRICTION = {"2": (0.42, 0.30), "3": (0.28, 0.22), "4": (0.27, 0.21), "5": (0.40, 0.28)}
CASES = {"prior": "case 1: manufacturer's gains", "identified": "case 2: identified gains"}
COMMANDS = (
    "gtau identify experiment.yaml --out .",
    "gtau validate model.json experiment.yaml",
    "gtau payload model.json second_payload.yaml --gains prior",
    "gtau payload model.json second_payload.yaml --gains identified",
)
CONTENT = {
    "report.html": "the identification: open it in a browser",
    "README.txt": "this text",
    "simulation.yaml": "the robot that was simulated",
    "experiment.yaml": "the input; copy it for your own robot",
    "second_payload.yaml": "the same, for weighing",
    "design.yaml": "the input of gtau excite: what motion to log next",
    "model.json": "the identified robot",
    "logs/": "what was logged",
}


def drives() -> dict[str, dict[str, Any]]:
    """List drives and sensors as in a simulation file: ball screws of 20 mm lead, 0.4 A at most."""
    return {
        joint: {
            "gain": gain,
            "current_limit": 0.4,
            "ripple": 1.0,
            "ripple_period": round(0.02 / 6, 6),
            "position_quantum": 2.5e-6,
            "current_noise": 3e-4,
            "current_quantum": 1e-5,
        }
        for joint, gain in DRIVE_GAINS.items()
    }


def standard_parameters() -> dict[str, float]:
    """List standard parameters by name, SI units; others are zero."""
    chi: dict[str, float] = {}
    for leg, bar in BARS.items():
        chi |= _leg(leg, bar)
    share = sum(chi[f"mx_3{leg}"] / BAR_LENGTH + chi[f"m_4{leg}"] + chi[f"m_5{leg}"] for leg in BARS)
    return chi | {"m_P": PLATFORM - share}


def _leg(leg: str, bar: float) -> dict[str, float]:
    """List foot and rotor (1), universal joint (2), bar (3), and the joint at the platform (4, 5) of a leg."""
    regrouped, fv, fs, off = AXES[f"1{leg}"]
    knuckle = 0.05  # kg, bodies 2 and 4; body 5 is lighter
    moment = bar * BAR_LENGTH / 2
    carried = knuckle + bar - moment / BAR_LENGTH  # the foot's share of the universal joint and the bar
    foot = (FOOT_3 + off / 9.80665 if leg == "3" else 0.80) - carried
    slender = bar * BAR_LENGTH**2 / 3  # about its end
    chi = {
        f"m_1{leg}": foot,
        f"ia_1{leg}": regrouped - foot - carried,
        f"fv_1{leg}": fv,
        f"fs_1{leg}": fs,
        f"off_1{leg}": off,
        f"m_2{leg}": knuckle,
        f"xx_2{leg}": 2e-5,
        f"yy_2{leg}": 1e-5,
        f"zz_2{leg}": 2e-5,
        f"m_3{leg}": bar,
        f"mx_3{leg}": moment,
        f"xx_3{leg}": 1.5e-4,
        f"yy_3{leg}": slender,
        f"zz_3{leg}": slender + 1.5e-4,
        f"m_4{leg}": knuckle,
        f"xx_4{leg}": 2e-5,
        f"yy_4{leg}": 2e-5,
        f"zz_4{leg}": 1e-5,
        f"m_5{leg}": 0.025,
    }
    for joint, (viscous, coulomb) in PASSIVE_FRICTION.items():
        chi |= {f"fv_{joint}{leg}": viscous, f"fs_{joint}{leg}": coulomb}
    return chi


RATE = 1000.0  # Hz

# Payload entry of a run in the simulation file.
EMPTY: dict[str, Any] = {}
STEEL = {"payload": {"name": "steel", "mass": PAYLOAD_MASS, "mass_std": 0.001}}
SECOND = {"payload": {"name": "second", "mass": SECOND_PAYLOAD_MASS}, "weigh": True}
# Log, kind of trajectory, payload.
LOGS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("exciting_1_unloaded", "sines", EMPTY),
    ("exciting_2_unloaded", "moves", EMPTY),
    ("exciting_3_loaded", "sines", STEEL),
    ("exciting_4_loaded", "moves", STEEL),
    ("validation_loaded", "sines", STEEL),
    ("second_payload", "sines", SECOND),
    ("second_payload_unloaded", "sines", EMPTY),
)
VALIDATION = "validation_loaded"  # the log kept out of the identification
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
# The robot that replaces a real one: its true parameters, its drives and sensors, and the runs. Made again from
# this file, the logs are the same: gtau simulate simulation.yaml --out simulated
"""


def simulation_text(duration: float) -> str:
    """Write the simulation file of the demo, its logs ``duration`` s long."""
    runs = [
        {"name": name, "trajectory": {kind: {"seed": seed, "duration": duration}}, **deepcopy(carried)}
        for seed, (name, kind, carried) in enumerate(LOGS)
    ]
    control = [
        {
            "name": name,
            "trajectory": {"points": {"through": [dict(zip(DRIVE_GAINS, point, strict=True)) for point in points]}},
            **deepcopy(STEEL),
        }
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


# The demo


def demo(out: Path, progress: Progress, duration: float = 10.0) -> tuple[dict[str, Any], Page]:
    """Make logs of ``duration`` s, identify the robot from them, weigh a second payload, and write all to ``out``.

    Returns true values, estimates and files as a JSON document and as a page. Raises GtauError.
    """
    begun = monotonic()
    make_experiment(out, duration, progress)
    file = out / "experiment.yaml"
    experiment = read_experiment(file)
    result = identify(experiment, progress=progress)
    save(result, out / "model.json")
    validation, _ = read_validation(experiment, progress)
    write_identification(result, validation, file, experiment, out, monotonic() - begun, progress)
    weighings = {}
    for case in CASES:
        (payload,) = weigh(result, out / "second_payload.yaml", gains=case, progress=progress)
        weighings[case] = payload.parameters["m"]
    files = [name for name in CONTENT if not name.endswith("/")]
    files += [f"logs/{name}.csv" for name, _, _ in LOGS]
    document = _document(result, weighings) | {
        "folder": str(out),
        "logs": {"count": len(LOGS), "duration": duration, "rate": RATE},
        "files": files,
        "commands": list(COMMANDS),
    }
    shown = report(document)
    write_atomically(out / "README.txt", f"{plain(shown)}\n")
    return document, shown


def make_experiment(out: Path, duration: float, progress: Progress) -> None:
    """Simulate the robot, and write its logs and the files that describe them."""
    write_atomically(out / "simulation.yaml", simulation_text(duration))
    simulation = read_simulation(out / "simulation.yaml")
    model = InverseDynamics(load_robot(simulation.robot))
    folder_of(out / "logs")
    runs = (*simulation.runs, *simulation.validation)
    for k, run in enumerate(runs):
        progress("simulating", k, len(runs))
        write_log(make_run(simulation, model, run).run, out / "logs" / f"{run.name}.csv")
    progress("simulating", len(runs), len(runs))
    for file in FILES.iterdir():
        write_atomically(out / file.name, file.read_bytes())


def _document(result: IdentifiedModel, weighings: Mapping[str, Estimate]) -> dict[str, Any]:
    gains = [
        {
            "joint": joint,
            "true": DRIVE_GAINS[joint],
            "prior": PRIOR_GAINS[joint],
            "prior_error": _percent(PRIOR_GAINS[joint], DRIVE_GAINS[joint]),
            "value": gain.value,
            "std": gain.std,
            "rel_std": gain.rel_std,
            "error": _percent(gain.value, DRIVE_GAINS[joint]),
            "unit": gain.unit,
        }
        for joint, gain in result.drive_gains.items()
    ]
    masses = {
        case: {"value": mass.value, "std": mass.std, "error": _percent(mass.value, SECOND_PAYLOAD_MASS)}
        for case, mass in weighings.items()
    }
    return {
        "robot": result.robot.name,
        "known_payload": {"mass": PAYLOAD_MASS, "unit": "kg"},
        "drive_gains": gains,
        "second_payload": {"true": SECOND_PAYLOAD_MASS, "unit": "kg", **masses},
    }


def _percent(value: float | None, true: float) -> float | None:
    return None if value is None else 100 * (value - true) / true


def report(document: Mapping[str, Any]) -> Page:
    """Show the demo's document."""
    logs, second = document["logs"], document["second_payload"]
    size = f"{logs['count']} logs of {logs['duration']:g} s at {logs['rate']:g} Hz"
    lead = (
        f"An Orthoglide whose true values are known: {size}, simulated with friction, force ripple, encoder rounding, "
        "noise and held currents, then used like measured logs."
    )
    number = partial(Column, kind=Kind.NUMBER)
    error = number("error, %", decimals=2)
    true, prior = number("true, N per A", decimals=0), number("manufacturer", decimals=0)
    columns = (Column("joint"), true, prior, error, number("identified", decimals=1), number("std", decimals=1), error)
    keys = ("joint", "true", "prior", "prior_error", "value", "std", "error")
    gains = Table(columns, [tuple(gain[key] for key in keys) for gain in document["drive_gains"]])
    weighing = Table(
        (Column("gains"), number("mass, kg", decimals=4), number("std", decimals=4), error),
        [(label, *(second[case][key] for key in ("value", "std", "error"))) for case, label in CASES.items()],
    )
    return Page(
        "",
        Section("", Text(lead)),
        Section(f"Drive gains, from a known payload of {document['known_payload']['mass']} kg", gains),
        Section(f"Weighing a second payload of {second['true']} kg", weighing),
        Section(f"In {document['folder']}", Facts(CONTENT)),
        Section("Step by step, in that folder", *map(Text, document["commands"])),
    )
