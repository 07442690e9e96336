"""Sections on the parameters: values, correlation, singular values, and alternatives to the model."""

from __future__ import annotations

import json
from base64 import b64encode

import numpy as np

from gtau.estimation.results.estimate import AlternativeMoves, Estimate
from gtau.estimation.results.result import Result
from gtau.report.evidence import (
    Evidence,
)
from gtau.report.html.document import Section
from gtau.report.html.drawings import Panel, panel_figure
from gtau.report.html.elements import (
    Cell,
    Column,
    escape,
    number,
    paragraph,
    plain,
    table,
    text,
)
from gtau.report.style import joint_label

STRONG = 0.9  # correlation from which on a pair is listed
LISTED = 20
POORLY_KNOWN = 1000.0  # per cent: of a larger standard deviation the value says nothing


def parameters_section(result: Result) -> Section:
    """Show essential, cancelled and friction parameters in one table that sorts and searches."""
    rows, faint = [], []
    for name, each in result.parameters.items():
        role = "essential" if each.essential else "not identifiable" if each.value is None else "not essential"
        rows.append(_parameter_row(name, each, role))
        if not each.essential:
            faint.append(len(rows) - 1)
    rows += [_parameter_row(name, each, "friction, by BIC") for name, each in result.friction.items()]
    columns = [
        Column("parameter"),
        Column("value", True),
        Column("std", True),
        Column("std, %", True),
        Column("unit"),
        Column("role"),
        Column("regroups"),
    ]
    cancelled, loss = len(result.parameters) - len(result.essential), result.statistics.get("reduction_loss", 0.0)
    words = (
        f"{len(result.essential)} of {len(result.parameters)} base parameters are essential; a fit without the "
        f"other {cancelled} raises the torque error of the worst joint by {loss:.2g} %. "
        "A standard deviation above 100 % belongs to a parameter that the torques need but that is known only in sums."
    )
    return Section(
        "parameters", "Parameters", paragraph(words) + table(columns, rows, sortable="parameter-table", cancelled=faint)
    )


def _parameter_row(name: str, each: Estimate, role: str) -> list[Cell]:
    percent = each.rel_std
    relative = (
        Cell("–", True)
        if percent is None
        else Cell(f"{percent:.2f}" if percent < POORLY_KNOWN else f"&gt; {POORLY_KNOWN:g}", True, percent)
    )
    return [
        Cell(f'<span class="mono">{escape(name)}</span>'),
        number(each.value, missing="–"),
        number(each.std, 2),
        relative,
        text(each.unit, "unit"),
        text(role),
        Cell(f'<span class="mono soft">{escape(each.regrouping if each.regrouping != name else "")}</span>'),
    ]


def correlation_section(evidence: Evidence) -> Section | None:
    """Show the correlation matrix of the estimates, and the pairs that are strongly correlated."""
    names, matrix = evidence.correlation
    if len(names) < 2:
        return None
    packed = b64encode(np.round(100 * matrix).astype(np.int8).tobytes()).decode("ascii")
    upper = np.triu(np.abs(matrix), 1)
    strongest = np.argsort(upper, axis=None)[::-1]
    pairs = [np.unravel_index(k, upper.shape) for k in strongest if upper.flat[k] >= STRONG]
    rows = [[text(names[i], "mono"), text(names[j], "mono"), number(float(matrix[i, j]), 3)] for i, j in pairs[:LISTED]]
    hint = "Point at a cell to read it. Blue: positive, orange: negative; the fuller the colour, the stronger."
    drawn = (
        f'<div class="matrix" data-names="{escape(json.dumps(names))}" data-values="{packed}">'
        f'<canvas role="img" aria-label="Correlation matrix of {len(names)} estimates"></canvas>'
        f'<output class="soft">{hint}</output></div>'
    )
    words = (
        f"{len(names)} estimates in the order of model.json: parameters, then drive gains, then delays. "
        f"{len(pairs) or 'No'} pair{'' if len(pairs) == 1 else 's'} with a correlation of {STRONG:g} or more"
        + (f", the {LISTED} strongest listed." if len(pairs) > LISTED else ".")
    )
    shown = paragraph(words) + drawn
    if rows:
        shown += table([Column("estimate"), Column("and"), Column("correlation", True)], rows)
    return Section("correlation", "Correlation", shown)


def singular_values_section(evidence: Evidence) -> Section | None:
    """Show singular values in falling order with the gap before the smallest; None where the result has none."""
    values = np.array(evidence.result.singular_values)
    if len(values) < 2 or values[-1] <= 0:
        return None
    gap = float(values[-2] / values[-1])
    order = np.arange(1, len(values) + 1)
    panel = Panel(
        (0.5, len(values) + 0.5),
        (10.0 ** np.floor(np.log10(values[-1])), 10.0 ** np.ceil(np.log10(values[0]))),
        "number",
        "singular value",
        (420.0, 220.0),
        log_y=True,
    )
    panel.line(order.astype(float), values, "grid")
    panel.points(
        order, values, "predicted", [f"{k}: {plain(value, 4)}" for k, value in zip(order, values, strict=True)]
    )
    panel.points(order[-1:], values[-1:], "residual", [f"smallest: {plain(float(values[-1]), 4)}"])
    words = (
        "Of W_tot (eq. 33), rows weighted by the residuals and columns of unit length. The smallest belongs to the "
        f"solution; the next is {gap:.3g} times larger. A ratio near 1 comes from parameters that the motion hardly "
        "excites, those with large standard deviations, and makes total least squares unreliable."
    )
    return Section(
        "singular-values",
        "Singular values",
        paragraph(words) + panel_figure("Singular values in falling order", panel.svg("Singular values"), "wide-panel"),
    )


def alternatives_section(evidence: Evidence) -> Section | None:
    """Show other models of the same data, and by how much each moves the gains; None where the result lists none."""
    listed = evidence.result.alternatives
    if not listed:
        return None
    weighed = sorted(listed, key=lambda each: -each.probability * max(map(abs, each.moves.values()), default=0.0))
    rows = [
        [
            text(each.subject),
            Cell(_share(each.probability), True, each.probability),
            *(_move_cell(each.moves.get(joint)) for joint in evidence.robot.motors),
            _size_cell(each),
            text(each.unit),
            Cell(_share(each.share), True, each.share),
        ]
        for each in weighed
    ]
    columns = [
        Column("alternative"),
        Column("probability, %", True),
        *(Column(f"moves {joint_label(joint)} by, %", True) for joint in evidence.robot.motors),
        Column("size", True),
        Column("unit"),
        Column("share of the residual, %", True),
    ]
    words = (
        "Each alternative has one unknown more than the model. Its size is what the data find, its probability how "
        "well they support it; what they leave open of it widens the intervals of the gains. The alternatives that "
        "matter most come first: probable ones that would move a gain."
    )
    return Section(
        "alternatives", "Alternatives", paragraph(words) + table(columns, rows, sortable="alternatives-table")
    )


def _size_cell(each: AlternativeMoves) -> Cell:
    if each.std is None:
        return Cell("not identifiable", True)
    return Cell(f"{escape(plain(each.size, 2))} ± {escape(plain(each.std, 2))}", True, each.size)


def _move_cell(move: float | None) -> Cell:
    return Cell("–", True) if move is None else Cell(f"{move:.2f}".replace("-", "\N{MINUS SIGN}"), True, move)


def _share(part: float) -> str:
    return "&lt; 0.1" if 0 < part < 0.001 else f"{100 * part:.1f}"
