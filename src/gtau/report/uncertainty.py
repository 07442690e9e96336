"""Show the sources of uncertainty: correlations, singular values and effects beside the model."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from functools import partial

import numpy as np

from gtau.estimation.effects.effect import EstimatedEffect
from gtau.estimation.results.result import IdentifiedModel
from gtau.report.chart import Axis, Chart, Panel, Series, intervals
from gtau.report.page import Column, Kind, Section, Text, joint_label, section, table, table_of

STRONG = 0.9  # smallest correlation that is listed
LISTED = 20
PAPER = "Briot and Gautier 2015"  # Multibody System Dynamics 33
SHOWN = 60  # most estimates whose names fit beside a matrix
DRAWN, VISIBLE = 12, 0.02  # most effects in the chart, and the smallest move of a gain, per cent


def correlation_of(result: IdentifiedModel) -> tuple[tuple[str, ...], np.ndarray]:
    """Compute names and correlation matrix (m, m) of all estimates with a variance."""
    covariance = result.covariance
    std = np.sqrt(np.clip(np.diag(covariance), 0.0, None))
    known = np.flatnonzero(std > 0)
    part = covariance[np.ix_(known, known)] / np.outer(std[known], std[known])
    return tuple(result.covariance_names[k] for k in known), np.clip(part, -1.0, 1.0)


def correlation_chart(names: tuple[str, ...], matrix: np.ndarray) -> Chart:
    """Draw a correlation matrix, with names if they fit."""
    shown = {float(k): name for k, name in enumerate(names)} if len(names) <= SHOWN else {}
    axis = Axis("" if shown else "number of the estimate", names=shown)
    return Chart((Panel(axis, axis, matrix=matrix, height=5.2),), "Correlations")


def correlation_section(result: IdentifiedModel) -> Section | None:
    """Show the correlation matrix of the estimates and the strongest pairs."""
    names, matrix = correlation_of(result)
    if len(names) < 2:
        return None
    upper = np.triu(np.abs(matrix), 1)
    strongest = np.argsort(upper, axis=None)[::-1]
    pairs = [np.unravel_index(k, upper.shape) for k in strongest if upper.flat[k] >= STRONG]
    rows = [(names[i], names[j], float(matrix[i, j])) for i, j in pairs[:LISTED]]
    columns = (Column("estimate", Kind.NAME), Column("and", Kind.NAME), Column("correlation", Kind.NUMBER, 3))
    words = (
        f"{len(names)} estimates in the order of model.json: parameters, then drive gains, then delays. "
        f"{len(pairs) or 'No'} pair{'' if len(pairs) == 1 else 's'} with a correlation of {STRONG:g} or more"
        + (f", the {LISTED} strongest listed. " if len(pairs) > LISTED else ". ")
        + "Blue: positive, orange: negative; the fuller the colour, the stronger."
    )
    return section(
        "Correlation",
        Text(words),
        _drift_text(names, result),
        correlation_chart(names, matrix),
        table(columns, rows) if rows else None,
        id="correlation",
    )


def singular_values_chart(values: np.ndarray) -> Chart:
    """Draw singular values (K,) in falling order and mark the smallest."""
    order = np.arange(1.0, len(values) + 1)
    series = (
        Series("singular values", order[:-1], values[:-1], "predicted", "points"),
        Series("the smallest", order[-1:], values[-1:], "residual", "points", width=2.5),
    )
    return Chart((Panel(Axis("number"), Axis("singular value", log=True), series, height=2.2),))


def effects_chart(effects: Sequence[EstimatedEffect]) -> Chart | None:
    """Draw the largest effects by the largest move of a gain, per cent, with 95 % intervals."""
    drawn = [effect for effect in effects if effect.largest_move > VISIBLE and effect.size][:DRAWN]
    if not drawn:
        return None
    moves = [max(effect.moves.values(), key=abs) for effect in drawn]
    halves = [1.96 * abs(move * effect.std / effect.size) for move, effect in zip(moves, drawn, strict=True)]
    labels = [f"{effect.effect} {effect.cause.joint}".strip() for effect in drawn]
    return Chart((intervals(labels, moves, halves, "moves a gain by, %", zero=True),), "Effects")


def effects_section(result: IdentifiedModel) -> Section | None:
    """Show the effects beside the model with their sizes and the moves of the gains."""
    if not result.effects:
        return None
    ranked = sorted(result.effects, key=lambda effect: -effect.largest_move)
    move = partial(Column, kind=Kind.NUMBER, decimals=2)
    moves = [(move(f"moves {joint_label(joint)} by, %"), partial(_moved, joint)) for joint in result.robot.motors]
    listed = table_of(
        ranked,
        (Column("effect"), "subject"),
        (Column("size", Kind.NUMBER, 2), "size"),
        (Column("std", Kind.NUMBER, 2), "std"),
        (Column("unit"), "unit"),
        (Column("log-likelihood", Kind.NUMBER, decimals=1), "likelihood"),
        (Column("share of the residual, %", Kind.SHARE, decimals=1), "share"),
        *moves,
        name="effects-table",
    )
    words = (
        "All effects are random effects of one mixed model, estimated together with the parameters. Log-likelihood: "
        "loss of a fit without the effect; below 3 the data hardly show it. The estimates and intervals include all "
        "effects. Effects are sorted by the largest move of a gain."
    )
    full_list = section(f"All {len(ranked)} effects", listed, folded=True)
    drifting = _drift_text([effect.subject for effect in ranked], result)
    return section("Effects beside the model", Text(words), drifting, effects_chart(ranked), full_list, id="effects")


def _moved(joint: str, effect: EstimatedEffect) -> float | None:
    return effect.moves.get(joint)


def _drift_text(texts: Iterable[str], result: IdentifiedModel) -> Text | None:
    """Explain names such as ``fv_left@2``, if there are any."""
    drift = next(filter(None, (re.search(r"(\w+)@(\d+)", text) for text in texts)), None)
    if drift is None:
        return None
    name, number = drift.groups()
    run = result.runs[int(number) - 1]
    words = f"{drift[0]}: by how much {name} in run {number}, '{run}', differs from its mean over the runs"
    return Text(words, style="soft")
