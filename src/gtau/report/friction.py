"""Show the identified friction of each joint, and the friction torque over speed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.identified_model import IdentifiedModel
from gtau.report.evidence import RunEvidence
from gtau.report.page import Axis, Chart, Column, Kind, Panel, Section, Series, Table, Text, joint_label, section, table
from gtau.robots.parameter import Parameter
from gtau.robots.units import position_unit, torque_unit
from gtau.signals.filters import position_filter
from gtau.signals.run import arrange

POINTS = 3000  # of a panel
WORDS = (
    "Friction of each joint, identified on all samples at the gains and inertia above: fv qd + (fs + fb exp(-|qd| / "
    "v_s) + fl |load|) z + off. Predictions and exports use it. z is the sign of the speed where a joint slides; "
    "before that, a spring over the width of presliding. A width or a speed v_s is given where held-out blocks of the "
    "logs support it; a joint without a width keeps the sign. Errors are of held-out blocks, in per cent of the "
    "torque left to friction, with this law and with viscous and Coulomb friction alone. SI units; ± is "
    "half a 95 % interval."
)
CURVES = "The torque that gains and inertia leave to friction, and its prediction, at the rows of the runs."
KINDS = ("fv", "fs", "fb", "fl", "off")


def friction_section(result: IdentifiedModel, runs: Sequence[RunEvidence] = ()) -> Section | None:
    """Show the friction of each joint; with ``runs`` also its curve. None for a result with the plain law alone."""
    if not result.curves:
        return None
    panels = tuple(_panels(result, [each for each in runs if each.used and each.prediction is not None]))
    chart = Chart(panels, columns=2) if panels else None
    of_chart = Text(CURVES, style="soft") if panels else None
    return section("Friction on all samples", Text(WORDS), curves_table(result), of_chart, chart, id="friction")


def curves_table(result: IdentifiedModel) -> Table:
    """Tabulate the friction of each joint, SI units, values with half their 95 % intervals."""
    columns = (
        Column("joint"),
        Column("presliding"),
        Column("v_s"),
        *(Column(kind) for kind in KINDS),
        Column("shown by", wide=True),
        Column("error, %", Kind.NUMBER, decimals=1),
        Column("plain law, %", Kind.NUMBER, decimals=1),
    )
    rows = [
        (
            joint_label(curve.joint),
            _cell(curve.width),
            _cell(curve.speed),
            *(_cell(curve.parameters.get(Parameter(kind, curve.joint).name)) for kind in KINDS),
            ", ".join(f"{term} ({t:.1f} standard errors)" for term, t in curve.evidence.items()),
            curve.error,
            curve.plain_error,
        )
        for curve in result.curves.values()
    ]
    return table(columns, rows)


def _cell(each: Estimate | None) -> str:
    if each is None or each.value is None:
        return "-"
    half = each.half_interval()
    return f"{each.value:.4g}" + ("" if half is None else f" ± {half:.2g}")


def _panels(result: IdentifiedModel, runs: Sequence[RunEvidence]) -> list[Panel]:
    gathered: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]] = []
    for each in runs:
        assert each.prediction is not None
        found, run = each.prediction, arrange(each.run, result.model.actuated)
        count = int(np.searchsorted(run.time, found.time[-1])) + 1
        qd = position_filter(run.position, run.rate, result.preparation.at(run.rate).cutoff, 0, count)[1]
        speeds = qd[np.minimum(np.searchsorted(run.time, found.time), count - 1)]
        gathered.append((speeds, found.measured - found.predicted + found.friction, found.friction, found.valid))
    panels = []
    for j, joint in enumerate(result.model.actuated if gathered else ()):
        if joint in result.robot.base:
            continue
        speed, left, made, valid = (np.concatenate([each[k][:, j] for each in gathered]) for k in range(4))
        shown = np.flatnonzero(valid)
        shown = shown[:: max(1, len(shown) // POINTS)]
        series = (
            Series("left to friction", speed[shown], left[shown], "measured", "points"),
            Series("predicted", speed[shown], made[shown], "predicted", "points"),
        )
        unit, axis = position_unit(result.robot, joint), torque_unit(result.robot, joint)
        panels.append(Panel(Axis(f"speed, {unit}/s"), Axis(f"friction, {axis}"), series, joint_label(joint), height=2))
    return panels
