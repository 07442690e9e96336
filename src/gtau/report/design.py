"""Show a designed motion as document, page and files."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gtau.documents.files import write_atomically, write_table
from gtau.excitation.design import Design, check
from gtau.excitation.forecast import Expected, Forecast, Weak, forecast, sampled_motions, weak_unknowns
from gtau.excitation.prior import KnownGain
from gtau.excitation.task import DesignProblem, close
from gtau.report.chart import Chart
from gtau.report.motion import joint_panels
from gtau.report.page import Column, Facts, Kind, Page, Section, Table, Text, joint_label, page, section, table
from gtau.robots.parameter import Parameter, parameter_of, torque_unit, unit_of

ORDERS = (("position", ""), ("velocity", "/s"), ("acceleration", "/s²"))
DIGITS = 9
MOST = 1000  # %, of an assumed value, that are worth printing


def file_stems(task: DesignProblem) -> tuple[str, ...]:
    """Name without ending of each motion's files: ``trajectory`` of all runs, or ``trajectory_1`` of run 1, ..."""
    return ("trajectory",) if task.one_motion else tuple(f"trajectory_{k + 1}" for k in range(len(task.motions)))


def write_trajectories(design: Design, folder: Path) -> tuple[Path, ...]:
    """Write each motion as CSV at the controller's rate, atomically: ``t``, then q, qd, qdd and each joint's name."""
    import polars as pl

    paths = tuple(folder / f"{stem}.csv" for stem in file_stems(design.task))
    for path, (time, joints) in zip(paths, sampled_motions(design.task, design.x), strict=True):
        columns = {"t": np.round(time, DIGITS)}
        for kind, rows in zip(("q", "qd", "qdd"), joints, strict=False):
            columns |= {
                Parameter(kind, joint): np.round(row, DIGITS)
                for joint, row in zip(design.task.model.actuated, rows, strict=True)
            }
        write_table(pl.DataFrame(columns), path)
    return paths


def design_document(design: Design, assumed: Mapping[str, str], masses: Sequence[float]) -> dict[str, Any]:
    """Describe the predictions of a design as a JSON document.

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
        "guards": list(task.guards),
        "tool": _tool(design),
        "priors": [_prior_gain(*each) for each in zip(robot.actuated, task.known, strict=False)],
        "gains": [_entry(each, f"{torque_unit(robot, each.name)}/A", "gains" in assumed) for each in expected.gains],
        "parameters": [
            _entry(each, _unit(parameter_of(each.name), task), "parameters" in assumed) for each in expected.parameters
        ],
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


def _prior_gain(joint: str, known: KnownGain) -> dict[str, Any]:
    return {"name": joint, "value": known.value, "interval": list(known.interval), "source": known.source}


def _tool(design: Design) -> dict[str, Any]:
    """Compute the greatest speed, m/s, and the least and greatest coordinates, m, of the tool's frame in the base."""
    task, speeds, places = design.task, [], []
    for time, joints in sampled_motions(task, design.x):
        place = task.tool[0](close(task.model, joints[0], joints[1], joints[2], None).c)
        speeds.append(float(np.linalg.norm(np.gradient(place, time, axis=1), axis=0).max()))
        places.append(place)
    every = np.concatenate(places, axis=1)
    limits = zip("xyz", every.min(axis=1).tolist(), every.max(axis=1).tolist(), strict=True)
    return {"frame": task.model.robot.tool, "speed": max(speeds)} | {axis: [low, high] for axis, low, high in limits}


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


def _unit(name: Parameter, task: DesignProblem) -> str:
    return unit_of(name.kind, task.model.robot, name.body)


def _advice(weak: Weak) -> dict[str, Any]:
    if weak.joint is None or not 100 * weak.then <= MOST:
        text = "no motion of one joint within the limits helps; wider limits, or another pose of the robot, may"
    else:
        text = (
            f"a run of joint '{weak.joint}' alone, {weak.how}, would bring it to {100 * weak.then:.3g} %; "
            "or use it as criterion: --criterion " + weak.name
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


def design_page(document: dict[str, Any]) -> Page:
    """Show the predictions of a design, from the document of :func:`design_document`."""
    short = any(_meaningless(each) for each in document["parameters"])
    words = f"-: the value is zero, or assumed and its standard deviation exceeds {MOST} %"
    unknown = Text(words, style="soft") if short else None
    return page(
        f"Exciting motion for {document['robot']}",
        section("Verdict", _verdict(document), _facts(document), id="verdict"),
        section("Drive gains to expect", _expected(document["gains"], known=document["priors"]), id="gains"),
        section("Parameters to expect", _expected(document["parameters"], "parameter-table"), unknown, id="parameters"),
        section("Limits", _limits(document["limits"]), id="limits"),
        _masses(document),
        section(
            "Assumptions",
            Text("", tuple(document["assumed"])) if document["assumed"] else Text("Nothing was assumed."),
            id="assumed",
        ),
        lead=[
            f"The tool moves at up to {document['tool']['speed']:.2g} m/s (frame of '{document['tool']['frame']}').",
            *(f"{said[0].upper()}{said[1:]}." for said in document["guards"]),
            f"Criterion: {document['criterion']}. Runs: {', '.join(map(_load, document['runs']))}.",
        ],
    )


def design_report(design: Design, document: dict[str, Any]) -> Page:
    """Add the motion and the robot to the page."""
    short, robot = design_page(document), design.task.model.robot
    motions = (section(title, chart) for title, chart in motion_charts(design))
    drawn = (section("Motion", *motions, id="motion"), section("Robot", robot, id="robot"))
    return replace(short, sections=(*short.sections[:2], *drawn, *short.sections[2:]))


def _load(run: str) -> str:
    return "no payload" if run == "none" else f"payload '{run}'"


def _verdict(document: dict[str, Any]) -> Text:
    words = (
        f"With this motion of {document['duration']:.4g} s a run, the drive gains can be identified with a standard "
        f"deviation of {document['gains_rms']:.2g} % (rms over the joints)."
    )
    weak: dict[str, list[str]] = {}
    for each in document["weak"]:
        share = f">\N{NO-BREAK SPACE}{MOST}" if (each["rel_std"] or np.inf) > MOST else f"{each['rel_std']:.3g}"
        weak.setdefault(each["advice"], []).append(f"{each['name']} ({share} %)")
    said = [
        f"not identified (30 % or more, of the value or of a typical one): {', '.join(names)}; {advice}"
        for advice, names in weak.items()
    ]
    if document["without_effect"]:
        said.append(f"no effect on the motors along any motion: {', '.join(document['without_effect'])}")
    if document["cut_short"]:
        said.append("the search was cut short; a longer one may find a better motion")
    said.append("these standard deviations are for white noise; model errors add to them")
    return Text(words, tuple(said), "neutral")


def _facts(document: dict[str, Any]) -> Facts:
    return Facts(
        {
            "period": f"{document['period']:.4g} s",
            "repetitions": document["repetitions"],
            "duration of a run": f"{document['duration']:.4g} s",
            "tool along z of the base": "{:.3g} to {:.3g} m".format(*document["tool"]["z"]),
            "motions": "one for all runs" if document["motions"] == "one" else "one for each run",
        }
    )


def _expected(entries: Sequence[Mapping[str, Any]], name: str = "", known: Sequence[Mapping[str, Any]] = ()) -> Table:
    """Tabulate standard deviations to expect; of a gain that is only assumed, just the relative one means something."""
    columns = (
        Column("name", Kind.NAME),
        Column("prior value", Kind.NUMBER, 4),
        Column("std", Kind.NUMBER, 3),
        Column("%", Kind.NUMBER, 3),
        Column("unit"),
        Column("prior value is"),
    )
    sources = {prior["name"]: prior["source"] for prior in known if prior["source"] not in ("given", "assumed")}
    ranges = {prior["name"]: "{:.4g} to {:.4g}".format(*prior["interval"]) for prior in known}
    rows = [
        (
            each["name"],
            *((None, None) if each["assumed"] and "/A" in each["unit"] else (each["value"], each["std"])),
            None if _meaningless(each) else each["rel_std"],
            each["unit"],
            f"{sources[each['name']]}, {ranges[each['name']]}"
            if each["name"] in sources
            else "assumed"
            if each["assumed"]
            else "given",
        )
        for each in entries
    ]
    return table(columns, rows, name=name)


def _meaningless(each: Mapping[str, Any]) -> bool:
    return bool(each["assumed"] and (each["rel_std"] or 0.0) > MOST)


def _limits(limits: Sequence[Mapping[str, Any]]) -> Table:
    used = Column("used, %", Kind.SHARE, decimals=1)
    columns = (Column("limit"), Column("value", Kind.NUMBER, 4), Column("unit"), used)
    return table(columns, [(each["limit"], each["value"], each["unit"], each["used"]) for each in limits])


def _masses(document: dict[str, Any]) -> Section | None:
    """Tabulate standard deviations of the gains with payloads of other masses, a column each; None without any."""
    if not document["payload_masses"]:
        return None
    names = [each["name"] for each in document["gains"]]
    now = {"rms": document["gains_rms"], "rel_std": {each["name"]: each["rel_std"] for each in document["gains"]}}
    cases = [("as designed", now), *((f"{each['mass']:g} kg", each) for each in document["payload_masses"])]
    columns = [Column("std of the gain, %"), *(Column(label, Kind.NUMBER, 3) for label, _ in cases)]
    rows: list[tuple[Any, ...]] = [("rms", *(each["rms"] for _, each in cases))]
    rows += [(joint_label(name), *(each["rel_std"][name] for _, each in cases)) for name in names]
    exceeded = [
        f"with {label} this motion exceeds: {', '.join(each['exceeded'])}"
        for label, each in cases
        if each.get("exceeded")
    ]
    return section("Other payload masses", table(columns, rows), Text("", tuple(exceeded)), id="masses")


def motion_charts(design: Design) -> list[tuple[str, Chart]]:
    """Draw positions, velocities and accelerations of each motion, with its title."""
    robot, joints = design.task.model.robot, design.task.model.actuated
    charts = []
    for k, (time, values) in enumerate(sampled_motions(design.task, design.x)):
        loads = [design.task.payloads[run] for run in design.task.motions[k]]
        named = [_load("none" if load is None else load.name) for load in loads]
        runs = [f"run {run + 1} ({load})" for run, load in zip(design.task.motions[k], named, strict=True)]
        panels = [
            panel
            for each, (what, per) in zip(values, ORDERS, strict=False)
            for panel in joint_panels(robot, joints, time, each.T, what, 1.9, per)
        ]
        charts.append((f"Motion {k + 1}: {', '.join(runs)}", Chart(tuple(panels), robot.name, live=True)))
    return charts


def write_design(design: Design, document: dict[str, Any], folder: Path) -> tuple[Path, ...]:
    """Write the trajectories, ``design.json``, and a figure of each trajectory."""
    from gtau.report.render.charts import save

    written = [*write_trajectories(design, folder), folder / "design.json"]
    write_atomically(written[-1], json.dumps(document, indent=1, allow_nan=False) + "\n")
    for stem, (title, chart) in zip(file_stems(design.task), motion_charts(design), strict=True):
        written.append(save(replace(chart, title=f"{chart.title}: {title}"), folder / f"{stem}.png"))
    return tuple(written)
