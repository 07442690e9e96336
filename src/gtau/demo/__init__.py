"""The demo: simulation, identification and payload estimation on an Orthoglide with known true values."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any

from gtau.documents.files import folder_of, write_atomically
from gtau.estimation.experiment_runs import read_validation
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.model_file import save
from gtau.estimation.results.result import IdentifiedModel
from gtau.findings import Progress
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.pages import write_tutorial as write_tutorial
from gtau.report.identification import write_identification
from gtau.report.page import Column, Facts, Kind, Page, Section, Table, Text
from gtau.report.terminal import plain
from gtau.signals.reading.experiment import read_experiment
from gtau.simulation.closed_loop import write_log
from gtau.simulation.simulate import make_run, read_simulation
from gtau.uses.identify import identify
from gtau.uses.weigh import weigh

FILES = Path(__file__).with_name("orthoglide_files")
"""The simulated robot with its runs, experiment files, and a design file."""
SIMULATION = read_simulation(FILES / "simulation.yaml")
DRIVE_GAINS = {joint: drive.gain for joint, drive in SIMULATION.drives.items()}  # N per A
PRIOR_GAINS = SIMULATION.prior_gains  # N per A, the manufacturer's 637 pi
MASSES = {run.payload.name: run.payload.mass or 0.0 for run in SIMULATION.runs if run.payload}  # kg
LOGS = [run.name for run in (*SIMULATION.runs, *SIMULATION.validation)]
CASES = {"prior": "with the manufacturer's gains", "identified": "with identified gains"}
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
    files += [f"logs/{name}.csv" for name in LOGS]
    document = _document(result, weighings) | {
        "folder": str(out),
        "logs": {"count": len(LOGS), "duration": duration, "rate": SIMULATION.rate},
        "files": files,
        "commands": list(COMMANDS),
    }
    shown = report(document)
    write_atomically(out / "README.txt", f"{plain(shown)}\n")
    return document, shown


def make_experiment(out: Path, duration: float, progress: Progress) -> None:
    """Simulate the robot, and write its logs and the files that describe them."""
    folder_of(out / "logs")
    for file in FILES.iterdir():
        text = file.read_text(encoding="utf-8").replace("duration: 10.0", f"duration: {duration}")
        write_atomically(out / file.name, text)
    simulation = read_simulation(out / "simulation.yaml")
    model = InverseDynamics(load_robot(simulation.robot))
    runs = (*simulation.runs, *simulation.validation)
    for k, run in enumerate(runs):
        progress("simulating", k, len(runs))
        write_log(make_run(simulation, model, run).run, out / "logs" / f"{run.name}.csv")
    progress("simulating", len(runs), len(runs))


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
        case: {"value": mass.value, "std": mass.std, "error": _percent(mass.value, MASSES["second"])}
        for case, mass in weighings.items()
    }
    return {
        "robot": result.robot.name,
        "known_payload": {"mass": MASSES["steel"], "unit": "kg"},
        "drive_gains": gains,
        "second_payload": {"true": MASSES["second"], "unit": "kg", **masses},
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
