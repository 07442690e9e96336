"""How well a model predicts runs: torque errors as a table and as JSON, and figures of the torques."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gtau.estimation.results.estimate import Prediction, TorqueError
from gtau.estimation.results.model_document import torque_error
from gtau.estimation.results.prediction import torque_errors
from gtau.estimation.results.result import Result
from gtau.report.figures import torques_figure
from gtau.report.style import has_matplotlib, save_figure
from gtau.robots.units import torque_unit
from gtau.signals.run import Run

WIDTH = 80
REVERSALS = (
    "The model holds away from reversals, where Coulomb friction does not change sign; identification uses only those "
    "samples. All samples: the reversals too."
)
CAUTION = (
    "A small error does not prove the gains: both sides carry them. Weigh a known payload ('gtau payload') for that."
)
SHOWN = 10.0  # s of a run in its figure


@dataclass(frozen=True, eq=False)
class Validation:
    """A run, the torques predicted along it, torque errors of the joints that move, and the unit of every joint.

    ``notes`` say what the prediction takes for granted.
    """

    run: Run
    prediction: Prediction
    errors: tuple[TorqueError, ...]
    units: tuple[str, ...]
    notes: tuple[str, ...] = ()


def validate_run(result: Result, run: Run) -> Validation:
    """Predict a run; raises GtauError where it does not suit the robot, or the model refuses a sample."""
    prediction = result.predict(run)
    units = tuple(torque_unit(result.robot, joint) for joint in prediction.joints)
    return Validation(run, prediction, torque_errors(result, prediction), units, _unknown_payload(result, run))


def _unknown_payload(result: Result, run: Run) -> tuple[str, ...]:
    """Note where the model has not seen the payload of a run, and the run gives no more than its mass."""
    payload = run.payload
    if payload is None or payload.parameters or result.payload(payload.name):
        return ()
    known = ", ".join(f"'{name}'" for name in dict.fromkeys(each.name for each in result.payloads))
    return (
        f"payload '{payload.name}' is none of the model's ({known or 'it has none'}), so it counts as a point mass of "
        f"{payload.mass:.4g} kg at the origin of '{result.robot.tool}'; correct the name, or give its 'parameters'",
    )


def describe_validations(validations: Sequence[Validation]) -> dict[str, Any]:
    """Describe torque errors as JSON: ``rms`` and ``signal`` in ``unit``, ``relative`` in per cent."""
    return {
        "runs": [
            {
                "log": each.run.name,
                "joints": [torque_error(error) for error in each.errors],
                "notes": list(each.notes),
            }
            for each in validations
        ]
    }


def validation_page(document: dict[str, Any]) -> str:
    """Print the description."""
    lines = []
    for run in document["runs"]:
        lines += [
            run["log"],
            f"  {'':<20}{'away from reversals':>28}{'all samples':>18}",
            f"  {'joint':<20}{'error':>10}{'torque':>10}{'%':>8}{'error':>10}{'%':>8}   unit, rms",
        ]
        lines += [_row(each) for each in run["joints"]]
        for note in run["notes"]:
            lines += textwrap.wrap(f"- {note}", WIDTH, initial_indent="  ", subsequent_indent="    ")
    return "\n".join([*lines, *textwrap.wrap(REVERSALS, WIDTH), *textwrap.wrap(CAUTION, WIDTH)])


def _row(each: dict[str, Any]) -> str:
    every = "-" if each["rms_all"] is None else f"{each['rms_all']:.4g}"
    relative = "-" if each["relative_all"] is None else f"{each['relative_all']:.2f}"
    return (
        f"  {each['joint'][:20]:<20}{each['rms']:>10.4g}{each['signal']:>10.4g}{each['relative']:>8.2f}{every:>10}"
        f"{relative:>8}   {each['unit']}"
    )


def write_torques(validations: Sequence[Validation], folder: Path) -> list[Path]:
    """Write a figure of measured and predicted torques for each run, around the largest residual.

    Without matplotlib nothing is written; see :func:`gtau.report.style.skipped_figures`.

    Raises
    ------
    GtauError
        Where a file cannot be written.
    """
    if not has_matplotlib():
        return []
    written, used = [], Counter[str]()
    for each in validations:
        used[each.run.name] += 1
        number = "" if used[each.run.name] == 1 else f"-{used[each.run.name]}"
        written.append(folder / f"torques_{each.run.name}{number}.png")
        origin = float(each.run.time[0])
        start, stop = (instant - origin for instant in worst_stretch(each.prediction, SHOWN))
        if (
            start <= float(each.prediction.time[0]) - origin
        ):  # the filter takes the first rows, but the axis begins at 0
            start = 0.0
        length = float(each.run.time[-1]) - origin
        name, kind = each.run.name, each.run.kind
        figure = torques_figure(each.prediction, each.units, start, stop, name, kind, origin, length)
        save_figure(figure, written[-1])
    return written


def worst_stretch(prediction: Prediction, duration: float) -> tuple[float, float]:
    """Find ``duration`` s of a run around the largest difference: begin and end, s; of a shorter run all of it.

    Differences are compared in units of each joint's own rms.
    """
    time = prediction.time
    difference = np.where(prediction.keep, prediction.measured - prediction.predicted, 0.0)
    relative = np.abs(difference) / np.maximum(np.sqrt(np.mean(difference**2, axis=0)), np.finfo(float).tiny)
    worst = float(time[relative.max(axis=1).argmax()])
    start = max(float(time[0]), min(worst - duration / 2, float(time[-1]) - duration))
    return start, min(start + duration, float(time[-1]))
