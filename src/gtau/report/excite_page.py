"""A designed motion as files: the trajectory, its figure, and what identification can be expected to make of it."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.documents.files import write_atomically
from gtau.excitation.design import Design, check
from gtau.excitation.forecast import Expected, Forecast, Weak, forecast, sampled_motions, weak_unknowns
from gtau.excitation.task import DesignProblem
from gtau.report.style import LINES, joint_label, light_grid, new_figure, save_figure, styled
from gtau.robots.units import torque_unit, unit_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CURVES = ("position", "velocity", "acceleration")
DIGITS = 9
WIDTH = 80
MOST = 1000  # %, of an assumed value, that are worth printing
CASES = 5  # payloads beside each other in a table


def file_stems(task: DesignProblem) -> tuple[str, ...]:
    """Name without ending of each motion's files: ``trajectory`` of all runs, or ``trajectory_1`` of run 1, ..."""
    return ("trajectory",) if task.one_motion else tuple(f"trajectory_{k + 1}" for k in range(len(task.motions)))


def write_trajectories(design: Design, folder: Path) -> tuple[Path, ...]:
    """Write each motion as CSV at the controller's rate, atomically: ``t``, then q, qd, qdd and each joint's name."""
    import polars as pl

    paths = tuple(folder / f"{stem}.csv" for stem in file_stems(design.task))
    for path, (time, joints) in zip(paths, sampled_motions(design.task, design.x), strict=True):
        columns = {"t": np.round(time, DIGITS)}
        for kind, table in zip(("q", "qd", "qdd"), joints, strict=False):
            columns |= {
                f"{kind}_{joint}": np.round(row, DIGITS)
                for joint, row in zip(design.task.model.actuated, table, strict=True)
            }
        write_atomically(path, pl.DataFrame(columns).write_csv())
    return paths


def trajectory_figure(task: DesignProblem, motion: int, time: np.ndarray, joints: np.ndarray) -> Figure:
    """Draw positions, velocities and accelerations (4, n, N) at ``time`` (N,) of a motion, titled with its runs."""
    units = {"rad" if task.model.robot.joint(joint).kind == "revolute" else "m" for joint in task.model.actuated}
    unit = " or ".join(sorted(units))
    with styled():
        figure = new_figure(7.2, 6.0)
        rows = figure.subplots(3, 1, sharex=True)
        for order, (axes, what) in enumerate(zip(rows, CURVES, strict=True)):
            for k, joint in enumerate(task.model.actuated):
                axes.plot(time, joints[order, k], label=joint_label(joint), **LINES[k % len(LINES)])
            axes.set_ylabel(f"{what}, {unit}" + ("", "/s", "/s²")[order])
            axes.set_xlim(time[0], time[-1])
            light_grid(axes)
        loads = [task.payloads[run] for run in task.motions[motion]]
        named = ["no payload" if load is None else f"payload '{load.name}'" for load in loads]
        runs = [f"run {run + 1} ({load})" for run, load in zip(task.motions[motion], named, strict=True)]
        rows[0].set_title(f"{task.model.robot.name}: {', '.join(runs)}")
        rows[-1].set_xlabel("time from the start of the run, s")
        figure.legend(*rows[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def describe_design(design: Design, assumed: Mapping[str, str], masses: Sequence[float]) -> dict[str, Any]:
    """Describe what a design promises as a JSON document.

    ``assumed`` is what the design file left out, as :func:`gtau.read_design` returns it, and ``masses`` are those of
    other payloads to be tried with it.
    """
    task, robot = design.task, design.task.model.robot
    expected = forecast(task, design.x)
    return {
        "schema": "gtau-design/1",
        "robot": robot.name,
        "criterion": design.criterion,
        "value": design.value,
        "cut_short": design.cut_short,
        "period": task.series.period,
        "repetitions": task.repetitions,
        "duration": max(float(time[-1]) for time, _ in sampled_motions(task, design.x)),
        "motions": "one" if task.one_motion else "each run",
        "runs": ["none" if payload is None else payload.name for payload in task.payloads],
        "gains_rms": _rms(expected),
        "gains": [_entry(each, f"{torque_unit(robot, each.name)}/A", "gains" in assumed) for each in expected.gains],
        "parameters": [_entry(each, _unit(each.name, task), "parameters" in assumed) for each in expected.parameters],
        "rows_kept": [
            {"joint": joint, "share": float(kept)}
            for joint, kept in zip(task.model.actuated, expected.kept, strict=True)
        ],
        "weak": [_advice(each) for each in weak_unknowns(design, expected)],
        "without_effect": list(task.base.without_effect),
        "limits": [
            {"limit": load.what, "value": load.limit, "unit": load.unit, "used": load.excess}
            for load in sorted(design.constraint_usages, key=lambda load: -load.excess)
        ],
        "payload_masses": [_with_mass(design, mass) for mass in masses],
        "assumed": list(assumed.values()),
        "x": design.x.tolist(),
    }


def _entry(each: Expected, unit: str, assumed: bool) -> dict[str, Any]:
    known = bool(np.isfinite(each.std))
    return {
        "name": each.name,
        "value": each.value,
        "std": each.std if known else None,
        "rel_std": each.relative if known and each.value else None,
        "unit": unit,
        "assumed": assumed,
    }


def _unit(name: str, task: DesignProblem) -> str:
    kind, body = task.base.standard[task.base.names.index(name)].split("_", 1)
    return unit_of(kind, task.model.robot, body)


def _advice(weak: Weak) -> dict[str, Any]:
    if weak.joint is None or not 100 * weak.then <= MOST:
        text = "no motion of one joint within the limits helps; wider limits, or another pose of the robot, may"
    else:
        text = (
            f"a run of joint '{weak.joint}' alone, {weak.how}, would bring it to {100 * weak.then:.3g} %; "
            "it may also be designed for: --criterion " + weak.name
        )
    relative = 100 * weak.relative if np.isfinite(weak.relative) else None
    return {"name": weak.name, "rel_std": relative, "advice": text}


def _with_mass(design: Design, mass: float) -> dict[str, Any]:
    """Predict the gains where all known payloads weigh ``mass``, and list the limits that the motion then exceeds."""
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
    """Print the description."""
    runs = ["no payload" if run == "none" else run for run in document["runs"]]
    what = f"of {document['duration']:.4g} s, designed for '{document['criterion']}'"
    if document["motions"] == "one":
        first = f"a motion {what}, to be carried out with {', '.join(runs)}"
    else:
        own = ", ".join(f"{run} (run {k})" for k, run in enumerate(runs, 1))
        first = f"{len(runs)} motions, the longest {what}, one for each run: {own}"
    lines = [
        *textwrap.wrap(f"{document['robot']}: {first}; standard deviations to expect:", WIDTH),
        "",
        f"  {'drive gain':<26}{'value':>11}{'std':>11}{'%':>9}   unit",
    ]
    lines += [_gain_row(each) for each in document["gains"]]
    lines += ["", f"  {'parameter':<26}{'value':>11}{'std':>11}{'%':>9}   unit"]
    lines += [_row(each) for each in document["parameters"]]
    if any(_meaningless(each) for each in document["parameters"]):
        lines += ["", f"  -: of zero, or more than {MOST} % of a value that is only assumed"]
    lines += ["", "  most used limits:"]
    for each in document["limits"][:6]:
        words = f"{100 * each['used']:5.1f} %  {each['limit']}"
        lines += textwrap.wrap(words, WIDTH, initial_indent="    ", subsequent_indent=" " * 13)
    if document["cut_short"]:
        lines += ["", "  the search was cut short; a longer one may find a better motion"]
    if document["weak"]:
        lines += ["", "  not identified (30 % or more, of the value or of a typical one):"]
        for advice in dict.fromkeys(each["advice"] for each in document["weak"]):
            alike = [
                f"{each['name']} ({_share(each['rel_std'])}\N{NO-BREAK SPACE}%)"
                for each in document["weak"]
                if each["advice"] == advice
            ]
            lines += _wrapped(f"{', '.join(alike)}: {advice}")
    if document["without_effect"]:
        lines += ["", "  without any effect on the motors, whatever the motion:"]
        lines += _wrapped(", ".join(document["without_effect"]))
    if document["payload_masses"]:
        lines += _payload_table(document)
    if document["assumed"]:
        lines += ["", "  assumed:"]
        for each in document["assumed"]:
            lines += _wrapped(each)
    return "\n".join(lines)


def _share(relative: float | None) -> str:
    return f"{relative:.3g}" if relative is not None and relative <= MOST else f">\N{NO-BREAK SPACE}{MOST}"


def _wrapped(text: str) -> list[str]:
    lines = textwrap.wrap(text, WIDTH, initial_indent="    ", subsequent_indent="      ", break_on_hyphens=False)
    return [line.replace("\N{NO-BREAK SPACE}", " ") for line in lines]


def _payload_table(document: dict[str, Any]) -> list[str]:
    """Tabulate standard deviations of the gains, per cent, with payloads of other masses."""
    now = {"rms": document["gains_rms"], "rel_std": {each["name"]: each["rel_std"] for each in document["gains"]}}
    cases = [("as designed", now), *((f"{each['mass']:g} kg", each) for each in document["payload_masses"])]
    lines = ["", "  the same motion with other payloads, standard deviations of the gains in %:"]
    for first in range(0, len(cases), CASES):
        shown = cases[first : first + CASES]
        lines.append(f"  {'':<18}" + "".join(f"{label:>12}" for label, _ in shown))
        lines.append(f"  {'rms':<18}" + "".join(f"{each['rms']:>12.3g}" for _, each in shown))
        for gain in document["gains"]:
            values = "".join(f"{each['rel_std'][gain['name']]:>12.3g}" for _, each in shown)
            lines.append(f"  {gain['name'][:18]:<18}{values}")
    for label, each in cases:
        if each.get("exceeded"):
            lines += _wrapped(f"with {label} this motion exceeds: {', '.join(each['exceeded'])}")
    return lines


def _gain_row(each: dict[str, Any]) -> str:
    """Make the row of a gain; of one that is only assumed, just the relative standard deviation is shown."""
    if not each["assumed"]:
        return _row(each)
    return f"  {each['name']:<26}{'(assumed)':>11}{'-':>11}{_relative(each):>9}   {each['unit']}"


def _row(each: dict[str, Any]) -> str:
    std = "-" if each["std"] is None else f"{each['std']:.3g}"
    relative = "-" if _meaningless(each) else _relative(each)
    return f"  {each['name']:<26}{each['value']:>11.4g}{std:>11}{relative:>9}   {each['unit']}"


def _relative(each: dict[str, Any]) -> str:
    return "-" if each["rel_std"] is None else f"{each['rel_std']:.3g}"


def _meaningless(each: dict[str, Any]) -> bool:
    return bool(each["assumed"] and (each["rel_std"] or 0.0) > MOST)


def write_design(design: Design, document: dict[str, Any], folder: Path) -> tuple[Path, ...]:
    """Write the trajectories, ``design.json``, and where matplotlib is installed a figure of each trajectory."""
    import json

    written = [*write_trajectories(design, folder), folder / "design.json"]
    write_atomically(written[-1], json.dumps(document, indent=1, allow_nan=False) + "\n")
    motions = sampled_motions(design.task, design.x)
    try:
        figures = [trajectory_figure(design.task, k, *motion) for k, motion in enumerate(motions)]
    except ImportError:
        return tuple(written)
    for stem, figure in zip(file_stems(design.task), figures, strict=True):
        save_figure(figure, folder / f"{stem}.png")
        written.append(folder / f"{stem}.png")
    return tuple(written)
