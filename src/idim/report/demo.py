"""The demo: the whole job on logs made on the spot, of an Orthoglide whose true values are known."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from idim.errors import IdimError
from idim.estimation.data import Progress, read_runs
from idim.estimation.identify import identify
from idim.estimation.payload import weigh
from idim.estimation.prediction import torque_errors
from idim.estimation.result import Estimate, Prediction, Result, TorqueError
from idim.files import write_atomically
from idim.model.inverse_dynamics import InverseDynamics
from idim.robots.load import load_robot
from idim.signals.experiment import Payload, read_experiment
from idim.simulation.orthoglide_truth import (
    DRIVE_GAINS,
    PAYLOAD_MASS,
    PRIOR_GAINS,
    SECOND_PAYLOAD_MASS,
    drives,
    standard_parameters,
)
from idim.simulation.synthetic import synthetic_run, write_log
from idim.simulation.trajectories import Envelope, Trajectory, envelope, point_to_point, sines

RATE = 1000.0  # Hz
SEED = 1

# Log, trajectory, mass of the payload in kg.
LOGS: tuple[tuple[str, Callable[[Envelope, float, np.random.Generator], Trajectory], float], ...] = (
    ("exciting_1_unloaded", sines, 0.0),
    ("exciting_2_unloaded", point_to_point, 0.0),
    ("exciting_3_loaded", sines, PAYLOAD_MASS),
    ("exciting_4_loaded", point_to_point, PAYLOAD_MASS),
    ("validation_loaded", sines, PAYLOAD_MASS),
    ("second_payload", sines, SECOND_PAYLOAD_MASS),
    ("second_payload_unloaded", sines, 0.0),
)

SIGNALS = """\
robot: orthoglide            # a name of the catalog, or a robot file
signals:                     # columns of the logs
  time: t                                        # s
  position: {"11": q11, "12": q12, "13": q13}    # m
  current: {"11": v11, "12": v12, "13": v13}     # A, the references of the current loops
prior_gains: {"11": 2001, "12": 2001, "13": 2001}    # N/A, the manufacturer's
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
COMMANDS = (
    "idim identify experiment.yaml --out .",
    "idim validate model.json experiment.yaml",
    "idim payload model.json second_payload.yaml --gains prior",
    "idim payload model.json second_payload.yaml --gains identified",
)


@dataclass(frozen=True, eq=False)
class Outcome:
    """What the demo found: the model, the second payload's mass in both cases, and the run not used."""

    result: Result
    weighings: Mapping[str, Estimate]
    prediction: Prediction
    errors: tuple[TorqueError, ...]


def demo(out: Path, progress: Progress, duration: float = 20.0) -> tuple[dict[str, Any], str]:
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
    plans = make_experiment(out, duration, progress)
    result = identify(out / "experiment.yaml", progress=progress)
    result.save(out / "model.json")
    weighings = {}
    for gains in ("prior", "identified"):
        (payload,) = weigh(result, out / "second_payload.yaml", gains, progress)
        weighings[gains] = payload.parameters["m"]
    experiment = read_experiment(out / "experiment.yaml")
    (run,) = read_runs(experiment, experiment.validation)
    prediction = result.predict(run)
    outcome = Outcome(result, weighings, prediction, torque_errors(result, prediction))
    figures = write_figures(out, outcome, plans["exciting_1_unloaded"], duration, progress)
    files = ["README.txt", "experiment.yaml", "second_payload.yaml", "model.json", *figures]
    files += [f"logs/{name}.csv" for name, _, _ in LOGS]
    found = document(outcome, out, duration, files)
    text = report(found)
    write_atomically(
        out / "README.txt", f"{text}\n\n\nThe whole result, as idim identify prints it\n\n{result.summary()}\n"
    )
    return found, text


def make_experiment(out: Path, duration: float, progress: Progress) -> dict[str, Trajectory]:
    """Write the logs and the two experiment files; return the trajectories by log."""
    robot = load_robot("orthoglide")
    model, within = InverseDynamics(robot), envelope(robot)
    chi, truth = standard_parameters(), drives()
    time = np.arange(round(duration * RATE) + 1) / RATE
    _make_folder(out / "logs")
    plans: dict[str, Trajectory] = {}
    for k, (name, kind, mass) in enumerate(LOGS):
        progress("making logs", k, len(LOGS))
        rng = np.random.default_rng([SEED, k])
        plans[name] = kind(within, duration, rng)
        payload = Payload(name="payload", mass=mass) if mass else None
        run = synthetic_run(name, model, plans[name], time, chi, truth, rng, payload)
        write_log(run, out / "logs" / f"{name}.csv")
    progress("making logs", len(LOGS), len(LOGS))
    write_atomically(out / "experiment.yaml", EXPERIMENT)
    write_atomically(out / "second_payload.yaml", SECOND_PAYLOAD)
    return plans


def _make_folder(path: Path) -> None:
    try:
        path.mkdir(exist_ok=True)
    except OSError as error:
        raise IdimError(f"the folder {path} cannot be made ({error.strerror}); choose another --out.") from None


def write_figures(out: Path, outcome: Outcome, plan: Trajectory, duration: float, progress: Progress) -> list[str]:
    """Write the figures; return their paths in ``out``, none where matplotlib is not installed."""
    if find_spec("matplotlib") is None:
        return []
    from idim.report.figures import gains_figure, payload_figure, torques_figure, trajectory_figure
    from idim.report.style import save_figure

    time = np.arange(round(duration * 200) + 1) / 200
    units = [each.unit for each in outcome.errors]
    made = {
        "gains": gains_figure(outcome.result.drive_gains, DRIVE_GAINS, PRIOR_GAINS),
        "payload": payload_figure(outcome.weighings["prior"], outcome.weighings["identified"], SECOND_PAYLOAD_MASS),
        "torques": torques_figure(outcome.prediction, units, 0.0, min(6.0, duration)),
        "trajectory": trajectory_figure(time, plan(time), outcome.prediction.joints, "m"),
    }
    _make_folder(out / "figures")
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
        "files": files,
        "commands": list(COMMANDS),
    }


def _percent(value: float | None, true: float) -> float | None:
    return None if value is None else 100 * (value - true) / true


def report(found: Mapping[str, Any]) -> str:
    """The document as text to read."""
    logs, second = found["logs"], found["second_payload"]
    size = f"{logs['count']} logs of {logs['duration']:g} s at {logs['rate']:g} Hz"
    lines = [
        f"An Orthoglide whose true values are known: {size},",
        "made by inverse dynamics with encoder rounding, noise, force ripple and delay, then used like any others.",
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
        f"In {found['folder']}:",
        "  README.txt             this text and the whole result",
        "  experiment.yaml        the input; copy it for your own robot",
        "  second_payload.yaml    the same, for weighing",
        "  model.json             the identified robot",
        "  logs/                  what was logged",
    ]
    if any(name.startswith("figures/") for name in found["files"]):
        lines.append("  figures/               gains, payload, torques, trajectory")
    else:
        lines.append("  (no figures, as matplotlib is not installed: pip install 'idim[plot]' adds it)")
    return "\n".join(
        [*lines, "", "The same step by step, in that folder:", *(f"  {each}" for each in found["commands"])]
    )
