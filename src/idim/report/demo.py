"""The demo: the whole job on logs made on the spot, of an Orthoglide whose true values are known."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import yaml

from idim.estimation.data import Progress, read_runs
from idim.estimation.estimates import Estimate, Prediction, TorqueError
from idim.estimation.identify import identify
from idim.estimation.payload import weigh
from idim.estimation.prediction import torque_errors
from idim.estimation.result import Result
from idim.files import folder_of, write_atomically
from idim.model.inverse_dynamics import InverseDynamics
from idim.robots.load import load_robot
from idim.signals.experiment import read_experiment
from idim.simulation.closed_loop import write_log
from idim.simulation.comparison import Comparison, compare_control, table, table_document
from idim.simulation.controllers import Reference, sample
from idim.simulation.description import read_simulation
from idim.simulation.experiment_files import make_run
from idim.simulation.motions import make_trajectory
from idim.simulation.orthoglide_truth import (
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
# this file, the logs are the same: idim simulate simulation.yaml --out simulated
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
# The motion to log next: idim excite design.yaml --out design
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
SAME_TRACKING = (
    "The manufacturer's gains track as well as the identified ones: each model was identified with its own gains, so",
    "both ask for nearly the same currents. Wrong gains show where torques are told in newtons: in the weighing above.",
)
COMMANDS = (
    "idim identify experiment.yaml --out .",
    "idim validate model.json experiment.yaml",
    "idim payload model.json second_payload.yaml --gains prior",
    "idim payload model.json second_payload.yaml --gains identified",
    "idim compare-control simulation.yaml experiment.yaml",
)


@dataclass(frozen=True, eq=False)
class Outcome:
    """What the demo found: the model, the second payload's mass in both cases, the run not used, the control laws."""

    result: Result
    weighings: Mapping[str, Estimate]
    prediction: Prediction
    errors: tuple[TorqueError, ...]
    comparison: Comparison


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
    IdimError
        Where a file cannot be written.
    """
    exciting = make_experiment(out, duration, progress)
    result = identify(out / "experiment.yaml", progress=progress)
    result.save(out / "model.json")
    weighings = {}
    for case in ("prior", "identified"):
        (payload,) = weigh(result, out / "second_payload.yaml", case, progress)
        weighings[case] = payload.parameters["m"]
    experiment = read_experiment(out / "experiment.yaml")
    (run,) = read_runs(experiment, experiment.validation)
    prediction = result.predict(run)
    gains = {joint: gain.value or 0.0 for joint, gain in result.drive_gains.items()}
    comparison = compare_control(out / "simulation.yaml", out / "experiment.yaml", progress, gains)
    outcome = Outcome(result, weighings, prediction, torque_errors(result, prediction), comparison)
    figures = write_figures(out, outcome, exciting, progress)
    files = [
        "README.txt",
        "simulation.yaml",
        "experiment.yaml",
        "second_payload.yaml",
        "design.yaml",
        "model.json",
        *figures,
    ]
    files += [f"logs/{name}.csv" for name, _, _ in LOGS]
    found = document(outcome, out, duration, files)
    text = report(found, table(comparison))
    write_atomically(
        out / "README.txt", f"{text}\n\n\nThe whole result, as idim identify prints it\n\n{result.summary()}\n"
    )
    return found, text


def make_experiment(out: Path, duration: float, progress: Progress) -> Reference:
    """Simulate the robot: write the logs and the files that describe them; return the first exciting trajectory."""
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
    exciting, _ = make_trajectory(simulation.runs[0].trajectory, model.robot, LOGS[0][0])
    return sample(exciting, duration, RATE)


def simulation_text(duration: float) -> str:
    """The simulation file of the demo, its logs ``duration`` s long."""
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
    return SIMULATION + yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=120)


def _points(points: tuple[tuple[float, ...], ...]) -> list[dict[str, float]]:
    return [dict(zip(DRIVE_GAINS, point, strict=True)) for point in points]


def write_figures(out: Path, outcome: Outcome, exciting: Reference, progress: Progress) -> list[str]:
    """Write the figures; return their paths in ``out``, none where matplotlib is not installed."""
    if find_spec("matplotlib") is None:
        return []
    from idim.report.control_figures import references_figure, tracking_figure
    from idim.report.figures import gains_figure, payload_figure, torques_figure, trajectory_figure
    from idim.report.robot_figure import robot_figure
    from idim.report.style import save_figure

    compared, shown = outcome.comparison, slice(None, None, 5)
    motion = (exciting.q[shown], exciting.qd[shown], exciting.qdd[shown])
    units = [each.unit for each in outcome.errors]
    made = {
        "gains": gains_figure(outcome.result.drive_gains, DRIVE_GAINS, PRIOR_GAINS),
        "payload": payload_figure(outcome.weighings["prior"], outcome.weighings["identified"], SECOND_PAYLOAD_MASS),
        "torques": torques_figure(outcome.prediction, units, 0.0, min(6.0, exciting.time[-1]), VALIDATION),
        "trajectory": trajectory_figure(exciting.time[shown], motion, outcome.prediction.joints, "m"),
        "test_trajectories": references_figure(compared.references, compared.joints, compared.units),
        **{f"tracking_{name}": tracking_figure(compared, name) for name in compared.references},
        "robot": robot_figure(outcome.result.robot),
    }
    folder_of(out / "figures")
    for k, (name, figure) in enumerate(made.items()):
        progress("drawing", k, len(made))
        save_figure(figure, out / "figures" / f"{name}.png")
    progress("drawing", len(made), len(made))
    return [f"figures/{name}.png" for name in made]


def document(outcome: Outcome, out: Path, duration: float, files: list[str]) -> dict[str, Any]:
    """What was true and what was found, as a JSON document; errors in per cent of the true values."""
    return {
        "folder": str(out),
        "robot": outcome.result.robot.name,
        "logs": {"count": len(LOGS), "duration": duration, "rate": RATE},
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
            for joint, each in outcome.result.drive_gains.items()
        ],
        "second_payload": {
            "true": SECOND_PAYLOAD_MASS,
            "unit": "kg",
            **{
                gains: {"value": mass.value, "std": mass.std, "error": _percent(mass.value, SECOND_PAYLOAD_MASS)}
                for gains, mass in outcome.weighings.items()
            },
        },
        "validation": [asdict(each) | {"relative": each.relative} for each in outcome.errors],
        "tracking": table_document(outcome.comparison),
        "files": files,
        "commands": list(COMMANDS),
    }


def _percent(value: float | None, true: float) -> float | None:
    return None if value is None else 100 * (value - true) / true


def report(found: Mapping[str, Any], tracking: str) -> str:
    """The document as text to read, with the table of ``tracking`` errors."""
    logs, second = found["logs"], found["second_payload"]
    size = f"{logs['count']} logs of {logs['duration']:g} s at {logs['rate']:g} Hz"
    lines = [
        f"An Orthoglide whose true values are known: {size},",
        "simulated with friction, force ripple, encoder rounding, noise and held currents, then used like any others.",
        "",
        f"Drive gains, N/A, from a known payload of {found['known_payload']['mass']} kg",
        f"  {'joint':<10}{'true':>10}{'manufacturer':>16}{'error %':>10}{'identified':>14}{'std':>8}{'error %':>10}",
    ]
    lines += [
        f"  {each['joint']:<10}{each['true']:>10.0f}{each['prior']:>16.0f}{each['prior_error']:>10.2f}"
        f"{each['value']:>14.1f}{each['std']:>8.1f}{each['error']:>10.2f}"
        for each in found["drive_gains"]
    ]
    lines += [
        "",
        f"{'Weighing a second payload of ' + str(second['true']) + ' kg':<50}{'kg':>12}{'std':>8}{'error %':>10}",
    ]
    for gains, label in (("prior", "case 1: manufacturer's gains"), ("identified", "case 2: identified gains")):
        mass = second[gains]
        lines.append(f"  {label:<48}{mass['value']:>12.4f}{mass['std']:>8.4f}{mass['error']:>10.2f}")
    lines += ["", f"{'Predicting a run that was not used':<50}{'rms N':>12}{'error':>8}{'error %':>10}"]
    lines += [
        f"  {'joint ' + each['joint']:<48}{each['signal']:>12.1f}{each['rms']:>8.2f}{each['relative']:>10.2f}"
        for each in found["validation"]
    ]
    lines += [
        "",
        "Following two trajectories, with computed torque by models identified with three sets of gains",
        "",
        tracking,
        "",
        *SAME_TRACKING,
        "",
        f"In {found['folder']}:",
        "  README.txt             this text and the whole result",
        "  simulation.yaml        the robot that was simulated",
        "  experiment.yaml        the input; copy it for your own robot",
        "  second_payload.yaml    the same, for weighing",
        "  design.yaml            the input of idim excite: what motion to log next",
        "  model.json             the identified robot",
        "  logs/                  what was logged",
    ]
    if any(name.startswith("figures/") for name in found["files"]):
        lines.append("  figures/               gains, payload, torques, trajectories, tracking errors, the robot")
    else:
        lines.append("  (no figures, as matplotlib is not installed: pip install 'idim[plot]' adds it)")
    return "\n".join(
        [*lines, "", "The same step by step, in that folder:", *(f"  {each}" for each in found["commands"])]
    )
