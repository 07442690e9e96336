"""Show a designed motion as page, JSON document and files."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.documents.files import write_atomically, write_table
from gtau.excitation.design import Design
from gtau.excitation.forecast import Expected, Outlook, sampled_run
from gtau.excitation.task import DesignProblem
from gtau.report.chart import Chart
from gtau.report.logs import joint_panels
from gtau.report.page import Column, Facts, Kind, Page, Section, Table, Text, joint_label, table_of
from gtau.robots.parameter import Parameter

if TYPE_CHECKING:
    import polars as pl

DESIGN, TRAJECTORY = "design.json", "trajectory.csv"
ORDERS = (("position", ""), ("velocity", "/s"), ("acceleration", "/s²"))
DIGITS = 9
MOST = 1000  # per cent; larger standard deviations are shown as "> 1000"
NEAREST = 3  # limits on the short page
CUT_SHORT = "the search was cut short; a longer search may find a better motion"
NEXT = "Next: play and log the motion with each payload, and identify (gtau identify LOG...)"
NBSP = "\N{NO-BREAK SPACE}"


def write_trajectory(design: Design, folder: Path) -> Path:
    """Write the motion as CSV at the controller's rate; see :func:`trajectory_table`."""
    write_table(trajectory_table(design.task, *sampled_run(design.task, design.x)), folder / TRAJECTORY)
    return folder / TRAJECTORY


def trajectory_table(task: DesignProblem, time: np.ndarray, joints: np.ndarray) -> pl.DataFrame:
    """Tabulate ``t`` (N,), ``q_JOINT``, ``qd_JOINT`` and ``qdd_JOINT`` of ``joints`` (3 or more, n, N)."""
    import polars as pl

    columns = {"t": np.round(time, DIGITS)}
    for kind, rows in zip(("q", "qd", "qdd"), joints, strict=False):
        for joint, row in zip(task.model.actuated, rows, strict=True):
            columns[Parameter(kind, joint)] = np.round(row, DIGITS)
    return pl.DataFrame(columns)


def design_document(outlook: Outlook) -> dict[str, Any]:
    """Describe the predictions of a design as a JSON document."""
    design, task, expected = outlook.design, outlook.task, outlook.forecast
    speed, places = outlook.tool
    return {
        "schema": "gtau-design/1",
        "robot": outlook.robot.name,
        "criterion": design.criterion,
        "value": design.value,
        "cut_short": design.cut_short,
        "period": task.series.period,
        "repetitions": task.repetitions,
        "duration": outlook.duration,
        "runs": ["none" if payload is None else payload.name for payload in task.payloads],
        "gains_rms": outlook.rms,
        "guards": list(task.guards),
        "tool": {"frame": outlook.robot.tool, "speed": speed, **dict(zip("xyz", places.T.tolist(), strict=True))},
        "priors": [
            {"name": joint, **{key: getattr(known, key) for key in ("value", "interval", "source", "model")}}
            for joint, known in zip(outlook.robot.actuated, task.prior.known, strict=False)
        ],
        "gains": [_entry(outlook, gain, "gains" in outlook.assumed) for gain in expected.gains],
        "parameters": [_entry(outlook, value, "parameters" in outlook.assumed) for value in expected.parameters],
        "rows_kept": [
            {"joint": joint, "share": share}
            for joint, share in zip(task.model.actuated, expected.kept.tolist(), strict=True)
        ],
        "weak": [{"name": name, "rel_std": _finite(share)} for name, share in outlook.weak.items()],
        "without_effect": list(task.base.without_effect),
        "limits": [
            {"limit": usage.what, "value": usage.limit, "unit": usage.unit, "used": usage.excess}
            for usage in outlook.usages
        ],
        "payload_masses": [
            {
                "mass": mass,
                "rel_std": {gain.name: gain.relative for gain in variant.forecast.gains},
                "rms": variant.rms,
                "exceeded": variant.exceeded,
            }
            for mass, variant in zip(outlook.masses, outlook.variants, strict=True)
        ],
        "assumed": list(outlook.assumed.values()),
        "x": design.x.tolist(),
    }


def _entry(outlook: Outlook, unknown: Expected, assumed: bool) -> dict[str, Any]:
    return {
        "name": unknown.name,
        "value": unknown.value,
        "std": _finite(unknown.std),
        "rel_std": _finite(unknown.relative),
        "unit": outlook.unit(unknown),
        "assumed": assumed,
    }


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def design_summary(outlook: Outlook) -> Page:
    """Show on one screen what to expect of a design, the limits it comes nearest to, and what it takes for granted."""
    expected, weak = outlook.forecast, len(outlook.weak)
    nearest = [f"{use.what}: {100 * use.excess:.0f} % of the limit, {use.allowed}" for use in outlook.usages[:NEAREST]]
    guards = tuple(guard.partition("; ")[0] for guard in outlook.task.guards)
    of_all = f"{weak} of {len(expected.parameters)} parameters"
    points = [f"{of_all} are not determined (std above 30 %)"] * bool(weak) + [CUT_SHORT] * outlook.design.cut_short
    return Page(
        f"Exciting motion for {outlook.robot.name}",
        Section("", replace(_verdict(outlook), points=tuple(points))),
        Section("Drive gains to expect", _expected_table(outlook, expected.gains, "gains" in outlook.assumed)),
        Section("Nearest to its limits", Text("", tuple(nearest))),
        _masses(outlook),
        Section("Checked under these assumptions", Text("", guards)) if guards else None,
        Section("", Text("All parameters, limits and assumptions: --verbose, or report.html.", (NEXT,))),
    )


def design_page(outlook: Outlook) -> Page:
    """Show the predictions of a design, its motion and the robot."""
    design, task, expected = outlook.design, outlook.task, outlook.forecast
    assumed = "parameters" in outlook.assumed
    loads = ", ".join(f"payload '{load.name}'" if load else "no payload" for load in task.payloads)
    gains = _expected_table(outlook, expected.gains, "gains" in outlook.assumed)
    parameters = _expected_table(outlook, expected.parameters, assumed, name="parameter-table")
    typical = Text("%: of a typical value where the prior value is zero", style="soft")
    facts = {
        "period": f"{task.series.period:.4g} s",
        "repetitions": task.repetitions,
        "duration of a run": f"{outlook.duration:.4g} s",
        "tool along z of the base": "{:.3g} to {:.3g} m".format(*outlook.tool[1][:, 2]),
    }
    limits = table_of(
        outlook.usages,
        (Column("limit"), "what"),
        (Column("allowed"), "allowed"),
        (Column("used, %", Kind.SHARE, decimals=1), "excess"),
    )
    assumptions = Text("", tuple(outlook.assumed.values())) if outlook.assumed else Text("Nothing was assumed.")
    return Page(
        f"Exciting motion for {outlook.robot.name}",
        Section("Verdict", _verdict(outlook), Facts(facts), id="verdict"),
        Section("Drive gains to expect", gains, id="gains"),
        Section("Motion", motion_chart(outlook), id="motion"),
        Section("Robot", outlook.robot, id="robot"),
        Section("Parameters to expect", parameters, typical, id="parameters", folded=True),
        Section("Limits", limits, id="limits"),
        _masses(outlook),
        Section("Assumptions", assumptions, id="assumed"),
        lead=[
            f"The tool moves at up to {outlook.tool[0]:.2g} m/s (frame of '{outlook.robot.tool}').",
            *(f"{guard[0].upper()}{guard[1:]}." for guard in task.guards),
            f"Criterion: {design.criterion}. Runs: {loads}.",
        ],
    )


def _verdict(outlook: Outlook) -> Text:
    words = (
        f"With this motion of {outlook.duration:.4g} s a run, the drive gains can be identified with a standard "
        f"deviation of {outlook.rms:.2g} % (rms over the joints)."
    )
    points = []
    if outlook.weak:
        sizes = (f"{f'{share:.3g}' if share <= MOST else f'>{NBSP}{MOST}'} %" for share in outlook.weak.values())
        names = ", ".join(f"{name} ({size})" for name, size in zip(outlook.weak, sizes, strict=True))
        points.append(f"not determined (std above 30 %): {names}; a motion for some of them: --criterion NAME,NAME")
    if outlook.task.base.without_effect:
        points.append(f"never felt by the motors: {', '.join(outlook.task.base.without_effect)}")
    if outlook.design.cut_short:
        points.append(CUT_SHORT)
    points.append("these standard deviations hold for white noise; model errors add to them")
    return Text(words, tuple(points), "neutral")


def _expected_table(outlook: Outlook, unknowns: Sequence[Expected], assumed: bool, name: str = "") -> Table:
    """Tabulate expected standard deviations; for assumed gains only the relative one is meaningful."""
    hidden = assumed and unknowns is outlook.forecast.gains
    sources = dict.fromkeys((unknown.name for unknown in unknowns), "assumed" if assumed else "given")
    priors = dict(zip(outlook.robot.actuated, outlook.task.prior.known, strict=False))
    for joint, known in priors.items():
        if known.source not in ("given", "assumed"):
            sources[joint] = "{}, {:.4g} to {:.4g}".format(known.source, *known.interval)
    shares = {
        gain.name: 100 * np.hypot(gain.std, priors[gain.name].model) / abs(gain.value)
        for gain in unknowns
        if gain.name in priors and priors[gain.name].model
    }
    return table_of(
        unknowns,
        (Column("name", Kind.NAME), "name"),
        (Column("prior value", Kind.NUMBER, 4), lambda value: None if hidden else value.value),
        (Column("std", Kind.NUMBER, 3), lambda value: None if hidden else _finite(value.std)),
        (Column("%", Kind.NUMBER, 3, most=MOST), lambda value: outlook.shares.get(value.name, value.relative)),
        *([(Column("with model part, %", Kind.NUMBER, 3), lambda gain: shares[gain.name])] if shares else []),
        (Column("unit"), outlook.unit),
        (Column("prior value is"), lambda value: sources[value.name]),
        name=name,
    )


def _masses(outlook: Outlook) -> Section | None:
    """Tabulate standard deviations of the gains with payloads of other masses; None without such masses."""
    if not outlook.masses:
        return None
    labels = ["as designed", *(f"{mass:g} kg" for mass in outlook.masses)]
    cases = (outlook, *outlook.variants)
    columns = [Column("std of the gain, %"), *(Column(label, Kind.NUMBER, 3) for label in labels)]
    rows: list[tuple[Any, ...]] = [("rms", *(case.rms for case in cases))]
    for gains in zip(*(case.forecast.gains for case in cases), strict=True):
        rows.append((joint_label(gains[0].name), *(_finite(gain.relative) for gain in gains)))
    exceeded = [
        f"with {label} this motion exceeds: {', '.join(case.exceeded)}"
        for label, case in zip(labels[1:], cases[1:], strict=True)
        if case.exceeded
    ]
    return Section("Other payload masses", Table(columns, rows), Text("", tuple(exceeded)), id="masses")


def motion_chart(outlook: Outlook) -> Chart:
    """Draw positions, velocities and accelerations."""
    robot, (time, values) = outlook.robot, outlook.run
    panels = [
        panel
        for order, (what, per) in zip(values, ORDERS, strict=False)
        for panel in joint_panels(robot, robot.actuated, time, order.T, what, 1.9, per)
    ]
    return Chart(tuple(panels), robot.name, live=True)


def write_design(outlook: Outlook, folder: Path) -> tuple[Path, ...]:
    """Write the trajectory and ``design.json``."""
    written = (write_trajectory(outlook.design, folder), folder / DESIGN)
    write_atomically(written[1], json.dumps(design_document(outlook), indent=1, allow_nan=False) + "\n")
    return written
