"""Show torque residuals, and the sources of uncertainty: correlations, singular values, effects beside the model."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from functools import partial

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from gtau.estimation.effects.effect import EstimatedEffect
from gtau.estimation.results.result import IdentifiedModel
from gtau.report.chart import Axis, Chart, Panel, Series, colour, intervals
from gtau.report.evidence import RunEvidence
from gtau.report.page import Column, Kind, Section, Table, Text, joint_label, table_of
from gtau.robots.parameter import torque_unit

SEGMENT = 256  # most samples in a segment of the spectrum
FEWEST = 16  # samples needed for a statistic

Residuals = Sequence[tuple[np.ndarray, np.ndarray]]
"""Times (K,) in s on a uniform grid and residuals (K,) of each run, NaN where masked."""
STRONG = 0.9  # smallest correlation that is listed
LISTED = 20
PAPER = "Briot and Gautier 2015"  # Multibody System Dynamics 33
SHOWN = 60  # most estimates whose names fit beside a matrix
EFFECTS = (
    "All effects are random effects of one mixed model, estimated together with the parameters. Log-likelihood: loss "
    "of a fit without the effect; below 3 the data hardly show it. The estimates and intervals include all effects. "
    "Effects are sorted by the largest move of a gain."
)
DRAWN, VISIBLE = 12, 0.02  # most effects in the chart, and the smallest move of a gain, per cent


def residuals_section(result: IdentifiedModel, runs: Sequence[RunEvidence]) -> Section | None:
    """Show the residuals of each joint over all runs used."""
    used = [run for run in runs if run.used and run.prediction is not None]
    if not used:
        return None
    joints = used[0].prediction.joints if used[0].prediction else ()
    residuals = {joint: [(run.time, run.residuals[:, j]) for run in used] for j, joint in enumerate(joints)}
    units = {joint: torque_unit(result.robot, joint) for joint in joints}
    words = (
        "Over all runs used, without masked samples. White residuals have a flat spectrum; for other residuals the "
        "block jackknife corrects the standard deviations."
    )
    panels = residual_panels(residuals, units)
    chart = Chart(panels, columns=2) if panels else None
    return Section("Residuals", Text(words), chart, id="residuals")


def residual_panels(residuals: Mapping[str, Residuals], units: Mapping[str, str]) -> tuple[Panel, ...]:
    """Draw histograms and spectra (a panel per unit) of the residuals of joints."""
    bars: list[Series] = []
    spectra: dict[str, list[Series]] = {}
    for j, (joint, runs) in enumerate(residuals.items()):
        label = joint_label(joint)
        if (bins := histogram(runs)) is not None:
            bars.append(Series(label, *bins, colour(j), "steps"))
        if (densities := spectrum(runs)) is not None and (densities[1] > 0).any():
            frequency, density = (part[densities[1] > 0] for part in densities)
            spectra.setdefault(units[joint], []).append(Series(label, frequency, np.sqrt(density), colour(j)))
    panels = []
    if bars:
        x = np.linspace(-4.0, 4.0, 90)
        normal = Series("normal density", x, np.exp(-(x**2) / 2) / np.sqrt(2 * np.pi), "soft", width=0.8)
        axis = Axis("residual / standard deviation", limits=(-4.5, 4.5))
        panels.append(Panel(axis, Axis("density"), (*bars, normal), "Histogram", height=2))
    for unit, lines in spectra.items():
        axis, density_axis = Axis("frequency, Hz"), Axis(f"{unit}/√Hz", log=True)
        panels.append(Panel(axis, density_axis, tuple(lines), "Amplitude spectral density", height=2))
    return tuple(panels)


def histogram(residuals: Residuals) -> tuple[np.ndarray, np.ndarray] | None:
    """Compute bin edges (B + 1,) and density (B,) of the unmasked residuals, in standard deviations about the mean."""
    values = np.concatenate([values[np.isfinite(values)] for _, values in residuals])
    if len(values) < FEWEST or not np.ptp(values):
        return None
    bins = int(np.clip(np.sqrt(len(values)), 8, 40))
    low, high = np.quantile(values, [0.001, 0.999])
    density, edges = np.histogram(np.clip(values, low, high), bins=bins, range=(low, high), density=True)
    return (edges - values.mean()) / values.std(), density * values.std()


def spectrum(residuals: Residuals) -> tuple[np.ndarray, np.ndarray] | None:
    """Compute frequencies (F,), Hz, and Welch's one-sided power spectral density (F,) over all runs.

    Masked residuals count as zero, and the density is scaled by the share of unmasked ones.
    """
    long_enough = [(time, values) for time, values in residuals if np.isfinite(values).sum() >= FEWEST]
    if not long_enough:
        return None
    length = min(SEGMENT, *(len(values) for _, values in long_enough))
    window = 0.5 - 0.5 * np.cos(2 * np.pi / length * np.arange(length))
    total, weight = np.zeros(length // 2 + 1), 0.0
    for time, values in long_enough:
        kept, step = np.isfinite(values), (time[-1] - time[0]) / (len(time) - 1)
        centred = np.where(kept, values - values[kept].mean(), 0.0)
        parts = sliding_window_view(centred, length)[:: length - length // 2] * window
        power = np.mean(np.abs(np.fft.rfft(parts)) ** 2, axis=0)
        total += step * len(kept) * power / (window**2).sum()
        weight += kept.sum()
    total[: (length + 1) // 2] *= 2
    return np.fft.rfftfreq(length, step)[1:], total[1:] / weight


# Correlations, singular values and effects


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
    return Section(
        "Correlation",
        Text(words),
        _drift_text(names, result),
        correlation_chart(names, matrix),
        Table(columns, rows) if rows else None,
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
    moves = [
        (move(f"moves {joint_label(joint)} by, %"), lambda effect, joint=joint: effect.moves.get(joint))
        for joint in result.robot.motors
    ]
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
    full_list = Section(f"All {len(ranked)} effects", listed, folded=True)
    drifting = _drift_text([effect.subject for effect in ranked], result)
    return Section("Effects beside the model", Text(EFFECTS), drifting, effects_chart(ranked), full_list, id="effects")


def _drift_text(texts: Iterable[str], result: IdentifiedModel) -> Text | None:
    """Explain names such as ``fv_left@2``, if there are any."""
    drift = next(filter(None, (re.search(r"(\w+)@(\d+)", text) for text in texts)), None)
    if drift is None:
        return None
    name, number = drift.groups()
    run = result.runs[int(number) - 1]
    words = f"{drift[0]}: by how much {name} in run {number}, '{run}', differs from its mean over the runs"
    return Text(words, style="soft")
