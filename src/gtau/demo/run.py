"""The demo: the whole job on logs made on the spot, of an Orthoglide whose true values are known."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from gtau.demo.orthoglide import (
    DESIGN,
    DRIVE_GAINS,
    EXPERIMENT,
    LOGS,
    PAYLOAD_MASS,
    PRIOR_GAINS,
    RATE,
    SECOND_PAYLOAD,
    SECOND_PAYLOAD_MASS,
    simulation_text,
)
from gtau.documents.files import folder_of, write_atomically
from gtau.errors import install_command
from gtau.estimation.identify import identify
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.result import Result
from gtau.estimation.weigh import weigh
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.progress import Progress
from gtau.simulation.closed_loop import write_log
from gtau.simulation.experiment_files import make_run
from gtau.simulation.simulation_file import read_simulation

CASES = {"prior": "case 1: manufacturer's gains", "identified": "case 2: identified gains"}
COMMANDS = (
    "gtau identify experiment.yaml --out .",
    "gtau validate model.json experiment.yaml",
    "gtau payload model.json second_payload.yaml --gains prior",
    "gtau payload model.json second_payload.yaml --gains identified",
    "gtau compare-control simulation.yaml experiment.yaml",
)
CONTENT = {
    "README.txt": "this text and the whole result",
    "simulation.yaml": "the robot that was simulated",
    "experiment.yaml": "the input; copy it for your own robot",
    "second_payload.yaml": "the same, for weighing",
    "design.yaml": "the input of gtau excite: what motion to log next",
    "model.json": "the identified robot",
    "logs/": "what was logged",
    "figures/gains.png": "the drive gains, beside the true ones",
}


def demo(out: Path, progress: Progress, duration: float = 10.0) -> tuple[dict[str, Any], str]:
    """Make logs, identify the robot from them, weigh a second payload, and write everything to ``out``.

    Parameters
    ----------
    out : Path
        An existing folder.
    progress : callable
        Called as the work goes on.
    duration : float
        Of every log, s.

    Returns
    -------
    dict
        A JSON document: what was true, what was found, and the files.
    str
        The same as text.

    Raises
    ------
    GtauError
        Where a file cannot be written.
    """
    make_experiment(out, duration, progress)
    result = identify(out / "experiment.yaml", progress=progress)
    result.save(out / "model.json")
    weighings = {}
    for case in CASES:
        (payload,) = weigh(result, out / "second_payload.yaml", case, progress)
        weighings[case] = payload.parameters["m"]
    files = [name for name in CONTENT if not name.endswith(("/", ".png"))]
    files += [*_gains_figure(out, result), *(f"logs/{name}.csv" for name, _, _ in LOGS)]
    found = _document(result, weighings) | {
        "folder": str(out),
        "logs": {"count": len(LOGS), "duration": duration, "rate": RATE},
        "files": files,
        "commands": list(COMMANDS),
    }
    text = report(found)
    whole = f"{text}\n\n\nThe whole result, as gtau identify prints it\n\n{result.summary()}\n"
    write_atomically(out / "README.txt", whole)
    return found, text


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
    for name, text in (("experiment", EXPERIMENT), ("second_payload", SECOND_PAYLOAD), ("design", DESIGN)):
        write_atomically(out / f"{name}.yaml", text)


def _gains_figure(out: Path, result: Result) -> list[str]:
    """Draw the drive gains, where matplotlib is installed; return the paths in ``out``."""
    if find_spec("matplotlib") is None:
        return []
    from gtau.report.figures import gains_figure
    from gtau.report.style import save_figure

    folder_of(out / "figures")
    save_figure(gains_figure(result.drive_gains, DRIVE_GAINS, PRIOR_GAINS), out / "figures" / "gains.png")
    return ["figures/gains.png"]


def _document(result: Result, weighings: Mapping[str, Estimate]) -> dict[str, Any]:
    """Collect what was true and what was found; errors in per cent of the true values."""
    return {
        "robot": result.robot.name,
        "known_payload": {"mass": PAYLOAD_MASS, "unit": "kg"},
        "drive_gains": [
            {
                "joint": joint,
                "true": DRIVE_GAINS[joint],
                "prior": PRIOR_GAINS[joint],
                "prior_error": _percent(PRIOR_GAINS[joint], DRIVE_GAINS[joint]),
                "value": each.value,
                "std": each.std,
                "rel_std": each.rel_std,
                "error": _percent(each.value, DRIVE_GAINS[joint]),
                "unit": each.unit,
            }
            for joint, each in result.drive_gains.items()
        ],
        "second_payload": {
            "true": SECOND_PAYLOAD_MASS,
            "unit": "kg",
            **{
                case: {"value": mass.value, "std": mass.std, "error": _percent(mass.value, SECOND_PAYLOAD_MASS)}
                for case, mass in weighings.items()
            },
        },
    }


def _percent(value: float | None, true: float) -> float | None:
    return None if value is None else 100 * (value - true) / true


def report(found: Mapping[str, Any]) -> str:
    """Print the demo's document as text."""
    logs, second = found["logs"], found["second_payload"]
    size = f"{logs['count']} logs of {logs['duration']:g} s at {logs['rate']:g} Hz"
    lines = [
        f"An Orthoglide whose true values are known: {size},",
        "simulated with friction, force ripple, encoder rounding, noise and held",
        "currents, then used like any others.",
        "",
        f"Drive gains in N per A, from a known payload of {found['known_payload']['mass']} kg",
        f"  {'joint':<10}{'true':>10}{'manufacturer':>16}{'error %':>10}{'identified':>14}{'std':>8}{'error %':>10}",
    ]
    lines += [
        f"  {each['joint']:<10}{each['true']:>10.0f}{each['prior']:>16.0f}{each['prior_error']:>10.2f}"
        f"{each['value']:>14.1f}{each['std']:>8.1f}{each['error']:>10.2f}"
        for each in found["drive_gains"]
    ]
    weighing = f"Weighing a second payload of {second['true']} kg"
    lines += ["", f"{weighing:<50}{'kg':>12}{'std':>8}{'error %':>10}"]
    for case, label in CASES.items():
        mass = second[case]
        lines.append(f"  {label:<48}{mass['value']:>12.4f}{mass['std']:>8.4f}{mass['error']:>10.2f}")
    drawn = [name for name in found["files"] if name.endswith(".png")]
    lines += ["", f"In {found['folder']}:"]
    lines += [f"  {name:<22} {what}" for name, what in CONTENT.items() if name in drawn or not name.endswith(".png")]
    if not drawn:
        lines.append(f"  (no figure, as matplotlib is not installed; {install_command('plot')} adds it)")
    lines += ["", "Step by step, in that folder, with predictions and control laws:"]
    return "\n".join([*lines, *(f"  {each}" for each in found["commands"])])
