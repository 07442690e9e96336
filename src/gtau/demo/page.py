"""What the demo found beside what was true, as a JSON document and as text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gtau.demo.files import LOGS, RATE
from gtau.errors import install_command
from gtau.estimation.results.estimate import Estimate, Prediction, TorqueError
from gtau.estimation.results.model_document import torque_error
from gtau.estimation.results.result import Result
from gtau.simulation.control_comparison import ControlComparison, table_document
from gtau.simulation.orthoglide_truth import DRIVE_GAINS, PAYLOAD_MASS, PRIOR_GAINS, SECOND_PAYLOAD_MASS

SAME_TRACKING = (
    "The manufacturer's gains track as well as the identified ones: each model was",
    "identified with its own gains, so both ask for nearly the same currents. Wrong",
    "gains show where forces in newtons count: in the weighing above.",
)
COMMANDS = (
    "gtau identify experiment.yaml --out .",
    "gtau validate model.json experiment.yaml",
    "gtau payload model.json second_payload.yaml --gains prior",
    "gtau payload model.json second_payload.yaml --gains identified",
    "gtau compare-control simulation.yaml experiment.yaml",
)


@dataclass(frozen=True, eq=False)
class DemoOutcome:
    """What the demo found: the model, the second payload's mass in both cases, the run not used, the control laws."""

    result: Result
    weighings: Mapping[str, Estimate]
    prediction: Prediction
    errors: tuple[TorqueError, ...]
    comparison: ControlComparison


def document(outcome: DemoOutcome, out: Path, duration: float, files: list[str]) -> dict[str, Any]:
    """Collect what was true and what was found as a JSON document; errors in per cent of the true values."""
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
        "validation": [torque_error(each) for each in outcome.errors],
        "tracking": table_document(outcome.comparison),
        "files": files,
        "commands": list(COMMANDS),
    }


def _percent(value: float | None, true: float) -> float | None:
    return None if value is None else 100 * (value - true) / true


def report(found: Mapping[str, Any], tracking: str) -> str:
    """Print the document as text, with the table of ``tracking`` errors."""
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
    lines += [
        "",
        f"{'Weighing a second payload of ' + str(second['true']) + ' kg':<50}{'kg':>12}{'std':>8}{'error %':>10}",
    ]
    for gains, label in (("prior", "case 1: manufacturer's gains"), ("identified", "case 2: identified gains")):
        mass = second[gains]
        lines.append(f"  {label:<48}{mass['value']:>12.4f}{mass['std']:>8.4f}{mass['error']:>10.2f}")
    lines += [
        "",
        "Predicting a run that was not used: rms error of the forces, away from",
        "reversals and over all samples",
        f"  {'joint':<10}{'force, N':>12}{'error, N':>12}{'error %':>10}{'all, N':>12}{'all %':>10}",
    ]
    lines += [
        f"  {each['joint']:<10}{each['signal']:>12.1f}{each['rms']:>12.2f}{each['relative']:>10.2f}"
        f"{each['rms_all']:>12.2f}{each['relative_all']:>10.2f}"
        for each in found["validation"]
    ]
    lines += [
        "",
        "Following two trajectories, with computed torque by models identified with",
        "three sets of gains",
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
        "  design.yaml            the input of gtau excite: what motion to log next",
        "  model.json             the identified robot",
        "  logs/                  what was logged",
    ]
    if any(name.startswith("figures/") for name in found["files"]):
        lines.append("  figures/               gains, payload, torques, trajectories, tracking errors, the robot")
    else:
        lines.append(f"  (no figures, as matplotlib is not installed; {install_command('plot')} adds it)")
    return "\n".join(
        [*lines, "", "The same step by step, in that folder:", *(f"  {each}" for each in found["commands"])]
    )
