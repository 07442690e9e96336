"""A designed motion as files: the trajectory, its figure, and what identification can be expected to make of it."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from idim.estimation.estimates import torque_unit, unit_of
from idim.experiment.advice import Weak, weak_unknowns
from idim.experiment.design import Design, check
from idim.experiment.forecast import Expected, Forecast, forecast, sampled_run
from idim.experiment.task import Task
from idim.files import write_atomically
from idim.report.style import LINES, light_grid, new_figure, save_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CURVES = ("position", "velocity", "acceleration")
DIGITS = 9


def write_trajectory(design: Design, path: str | Path) -> None:
    """Write a run as CSV at the controller's rate, atomically: ``t``, then q, qd and qdd and each joint's name."""
    import polars as pl

    time, joints = sampled_run(design.task, design.x)
    columns = {"t": np.round(time, DIGITS)}
    for kind, table in zip(("q", "qd", "qdd"), joints, strict=False):
        columns |= {
            f"{kind}_{joint}": np.round(row, DIGITS)
            for joint, row in zip(design.task.model.actuated, table, strict=True)
        }
    write_atomically(path, pl.DataFrame(columns).write_csv())


def trajectory_figure(design: Design) -> Figure:
    """Positions, velocities and accelerations of a run."""
    task = design.task
    time, joints = sampled_run(task, design.x)
    units = {"rad" if task.model.robot.joint(joint).kind == "revolute" else "m" for joint in task.model.actuated}
    unit = " or ".join(sorted(units))
    with styled():
        figure = new_figure(7.2, 6.0)
        rows = figure.subplots(3, 1, sharex=True)
        for order, (axes, what) in enumerate(zip(rows, CURVES, strict=True)):
            for k, joint in enumerate(task.model.actuated):
                axes.plot(time, joints[order, k], label=joint, **LINES[k % len(LINES)])
            axes.set_ylabel(f"{what}, {unit}" + ("", "/s", "/s²")[order])
            light_grid(axes)
        rows[-1].set_xlabel("time, s")
        figure.legend(*rows[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def describe_design(design: Design, assumed: Sequence[str], masses: Sequence[float]) -> dict[str, Any]:
    """What a design promises, as a JSON document; ``masses`` are those of other payloads to be tried with it."""
    task, robot = design.task, design.task.model.robot
    expected = forecast(task, design.x)
    return {
        "schema": "idim-design/1",
        "robot": robot.name,
        "criterion": design.criterion,
        "value": design.value,
        "period": task.series.period,
        "repetitions": task.repetitions,
        "duration": float(sampled_run(task, design.x)[0][-1]),
        "runs": ["none" if payload is None else payload.name for payload in task.payloads],
        "gains": [_entry(each, f"{torque_unit(robot, each.name)}/A") for each in expected.gains],
        "parameters": [_entry(each, _unit(each.name, task)) for each in expected.parameters],
        "rows_kept": [
            {"joint": joint, "share": float(kept)}
            for joint, kept in zip(task.model.actuated, expected.kept, strict=True)
        ],
        "weak": [_advice(each) for each in weak_unknowns(design)],
        "without_effect": list(task.base.without_effect),
        "limits": [
            {"limit": load.what, "value": load.limit, "unit": load.unit, "used": load.excess}
            for load in sorted(design.loads, key=lambda load: -load.excess)
        ],
        "payload_masses": [_with_mass(design, mass) for mass in masses],
        "assumed": list(assumed),
        "x": design.x.tolist(),
    }


def _entry(each: Expected, unit: str) -> dict[str, Any]:
    known = bool(np.isfinite(each.std))
    return {
        "name": each.name,
        "value": each.value,
        "std": each.std if known else None,
        "rel_std": each.relative if known and each.value else None,
        "unit": unit,
    }


def _unit(name: str, task: Task) -> str:
    kind, body = task.base.standard[task.base.names.index(name)].split("_", 1)
    return unit_of(kind, task.model.robot, body)


def _advice(weak: Weak) -> dict[str, Any]:
    if weak.joint is None:
        text = "no motion of one joint within the limits helps; wider limits, or another pose of the robot, may"
    else:
        text = (
            f"a run of joint '{weak.joint}' alone, {weak.how}, would bring it to {100 * weak.then:.3g} %; "
            "it may also be designed for: --criterion " + weak.name
        )
    return {"name": weak.name, "rel_std": 100 * weak.relative, "advice": text}


def _with_mass(design: Design, mass: float) -> dict[str, Any]:
    """Gains to expect where all known payloads weigh ``mass``, and the limits that the motion then exceeds."""
    task = design.task.with_payload_mass(mass)
    expected = forecast(task, design.x)
    exceeded = [load.what for load in check(task, design.x) if load.excess > 1]
    return {
        "mass": mass,
        "rel_std": {each.name: each.relative for each in expected.gains},
        "rms": _rms(expected),
        "exceeded": exceeded,
    }


def _rms(expected: Forecast) -> float:
    return float(np.sqrt(np.mean([each.relative**2 for each in expected.gains])))


def design_page(document: dict[str, Any]) -> str:
    """The description as text."""
    lines = [
        f"{document['robot']}: a motion of {document['duration']:.4g} s, designed for '{document['criterion']}', to be "
        f"carried out with {', '.join('no payload' if run == 'none' else run for run in document['runs'])}",
        "",
        f"  {'drive gain':<26}{'value':>11}{'std':>11}{'%':>9}   unit",
    ]
    lines += [_row(each) for each in document["gains"]]
    lines += ["", f"  {'parameter':<26}{'value':>11}{'std':>11}{'%':>9}   unit"]
    lines += [_row(each) for each in document["parameters"]]
    lines += ["", "  most used limits:"]
    lines += [f"    {100 * each['used']:5.1f} %  {each['limit']}" for each in document["limits"][:6]]
    if document["weak"]:
        lines += ["", "  not identified (30 % or more, of the value or of a typical one):"]
        for each in document["weak"]:
            text = f"{each['name']} ({each['rel_std']:.3g} %): {each['advice']}"
            lines += textwrap.wrap(text, 110, initial_indent="    ", subsequent_indent="        ")
    for each in document["payload_masses"]:
        lines += ["", f"  with a payload of {each['mass']:g} kg: gains within {each['rms']:.3g} % (rms)"]
        lines += [f"    {joint:<24}{relative:9.3g} %" for joint, relative in each["rel_std"].items()]
        if each["exceeded"]:
            lines.append(f"    but this motion exceeds: {', '.join(each['exceeded'])}")
    if document["assumed"]:
        lines += ["", "  assumed:"]
        for each in document["assumed"]:
            lines += textwrap.wrap(each, 110, initial_indent="    ", subsequent_indent="        ")
    return "\n".join(lines)


def _row(each: dict[str, Any]) -> str:
    std = "-" if each["std"] is None else f"{each['std']:.3g}"
    relative = "-" if each["rel_std"] is None else f"{each['rel_std']:.3g}"
    return f"  {each['name']:<26}{each['value']:>11.4g}{std:>11}{relative:>9}   {each['unit']}"


def write_design(design: Design, document: dict[str, Any], folder: Path) -> tuple[Path, ...]:
    """Write ``trajectory.csv``, ``design.json``, and where matplotlib is installed ``trajectory.png``."""
    import json

    written = [folder / "trajectory.csv", folder / "design.json"]
    write_trajectory(design, written[0])
    write_atomically(written[1], json.dumps(document, indent=1, allow_nan=False) + "\n")
    try:
        figure = trajectory_figure(design)
    except ImportError:
        return tuple(written)
    save_figure(figure, folder / "trajectory.png")
    return (*written, folder / "trajectory.png")
