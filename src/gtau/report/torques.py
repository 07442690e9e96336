"""Measured and predicted torques and their residuals, on pages."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gtau.estimation.results.estimate import Prediction, TorqueError
from gtau.estimation.results.identified_model import IdentifiedModel
from gtau.report.evidence import RunEvidence
from gtau.report.logs import payload_words
from gtau.report.motion import TIME
from gtau.report.page import (
    Axis,
    Chart,
    Column,
    Kind,
    Panel,
    Section,
    Series,
    Table,
    Text,
    colour,
    joint_label,
    section,
    table,
)
from gtau.report.render.live import stretches
from gtau.report.residual_statistics import autocorrelation, histogram, spectrum
from gtau.robots.units import torque_unit

REVERSALS = (
    "Gains and inertia are identified away from reversals, where friction does not change its sign. All samples: "
    "including reversals, with the friction identified on them."
)
TORQUE = (Column("torque", Kind.NUMBER, 4), Column("%", Kind.NUMBER, decimals=2))

ALL = (Column("error, all", Kind.NUMBER, 4), Column("%, all", Kind.NUMBER, decimals=2))
"""Of errors over all samples."""


def errors_table(runs: Sequence[RunEvidence]) -> Table:
    """Tabulate torque errors of each joint on each run, away from reversals and over all samples."""
    columns = (
        Column("run"),
        Column("", wide=True),
        Column("joint"),
        Column("error", Kind.NUMBER, 4),
        *TORQUE,
        *ALL,
        Column("unit, rms"),
    )
    rows = [
        (
            run.run.name,
            "used" if run.used else "validation",
            error.joint,
            error.rms,
            error.signal,
            error.relative,
            error.rms_all,
            error.relative_all,
            error.unit,
        )
        for run in runs
        for error in run.errors
    ]
    return table(columns, rows)


def fit_table(residuals: Sequence[TorqueError], title: str) -> Table:
    """Tabulate the torque residuals of a fit."""
    every = any(each.rms_all is not None for each in residuals)
    rows = []
    for each in residuals:
        over_all = (each.rms_all, each.relative_all) if every else ()
        rows.append((each.joint, each.rms, each.signal, each.relative, *over_all, each.unit))
    columns = (Column(title), Column("residual", Kind.NUMBER, 4), *TORQUE, *(ALL if every else ()))
    return table((*columns, Column("unit, rms")), rows)


def largest_errors_table(runs: Sequence[RunEvidence]) -> Table:
    """Tabulate largest torque error and R² of each joint on the runs used, and on those kept for validation."""
    groups = [
        (words, [each for each in runs if each.used == used and each.errors])
        for words, used in (("runs used", True), ("validation", False))
    ]
    groups = [(words, members) for words, members in groups if members]
    columns = [Column("largest torque error of one run, %")]
    shares = [determination(members) for _, members in groups]
    for words, _ in groups:
        columns.append(Column(f"{words}: away from reversals", Kind.NUMBER, decimals=2))
        columns.append(Column(f"{words}: all samples", Kind.NUMBER, decimals=2))
        columns.append(Column(f"{words}: R²", Kind.NUMBER, decimals=4))
    rows = []
    for joint in dict.fromkeys(error.joint for run in runs for error in run.errors):
        row: list[object] = [joint_label(joint)]
        for (_, members), share in zip(groups, shares, strict=True):
            errors = [error for run in members for error in run.errors if error.joint == joint]
            row.append(max((error.relative for error in errors), default=None))
            row.append(max((each.relative_all for each in errors if each.relative_all is not None), default=None))
            row.append(share.get(joint))
        rows.append(row)
    return table(columns, rows)


def determination(runs: Sequence[RunEvidence]) -> dict[str, float]:
    """Compute R² of each joint over runs, away from reversals: 1 - error^2 / (measured - its mean)^2."""
    found = {}
    predictions = [each.prediction for each in runs if each.prediction is not None]
    for j, joint in enumerate(predictions[0].joints if predictions else ()):
        measured = np.concatenate([each.measured[each.keep[:, j], j] for each in predictions])
        predicted = np.concatenate([each.predicted[each.keep[:, j], j] for each in predictions])
        about = np.sum((measured - measured.mean()) ** 2) if measured.size else 0.0
        if about > 0:
            found[joint] = float(1 - np.sum((measured - predicted) ** 2) / about)
    return found


def torques_section(result: IdentifiedModel, runs: Sequence[RunEvidence]) -> Section | None:
    """Show measured and predicted torques of every joint along every run, used and not used."""
    if not runs:
        return None
    parts, opened = [], {True: False, False: False}
    for run in runs:
        title = f"{run.run.name} ({'used' if run.used else 'validation, not used'}; {payload_words(run.run)})"
        if run.prediction is None:
            parts.append(section(title, Text(f"Not predicted: {run.refusal}"), folded=True))
            continue
        cut = f"Only the first {run.time[-1]:.4g} s of this long run are shown."
        shown = Text(cut, style="soft") if run.cut else None
        chart = torques_chart(run.prediction, units_of(result, run.prediction), run.run.kind, run.time, run.errors)
        parts.append(section(title, shown, chart, folded=opened[run.used]))
        opened[run.used] = True
    words = (
        "A small residual does not validate the gains, because they scale both sides. In the shaded intervals "
        "friction changes its sign or samples are missing; the identification of gains and inertia excludes them."
    )
    each_run = (
        "Torque errors are of single runs at every sample; the torque residuals of the fit are of the decimated rows "
        "used, over all runs. R²: share of the measured torque's variance that the model "
        "explains, over all these runs, away from reversals."
    )
    every = section("Torque errors of every run", errors_table(runs), Text(REVERSALS, style="soft"), folded=True)
    return section(
        "Torques", Text(words), largest_errors_table(runs), Text(each_run, style="soft"), every, *parts, id="torques"
    )


def units_of(result: IdentifiedModel, prediction: Prediction) -> list[str]:
    """List the units of the predicted torques."""
    return [torque_unit(result.robot, joint) for joint in prediction.joints]


def torques_chart(
    prediction: Prediction,
    units: Sequence[str],
    kind: str,
    time: np.ndarray,
    errors: Sequence[TorqueError] = (),
    title: str = "",
) -> Chart:
    """Draw measured and predicted torques of each joint over ``time`` (K,), and below them the residuals.

    Where ``kind`` is current, what is measured is ``v g_tau``. Stretches near reversals, where the model's friction
    does not hold, and near gaps are shaded.
    """
    of_joint = {error.joint: error for error in errors}
    label = "measured (current × gain)" if kind == "current" else "measured"
    panels = []
    for j, (joint, unit) in enumerate(zip(prediction.joints, units, strict=True)):
        words, error = joint_label(joint), of_joint.get(joint)
        if error is not None:
            words += f": torque error {error.relative:.2f} %"
            words += f", {error.relative_all:.2f} % over all samples" if error.relative_all is not None else ""
        measured, predicted = prediction.measured[:, j], prediction.predicted[:, j]
        masked = stretches(time, ~prediction.keep[:, j])
        both = (Series(label, time, measured, "measured", width=2.6), Series("predicted", time, predicted, width=1.2))
        axis = Axis(f"{'force' if unit == 'N' else 'torque'}, {unit}")
        panels.append(Panel(TIME, axis, both, words, shaded=masked))
        residual = Series("residual", time, measured - predicted, "residual", width=1.0)
        panels.append(Panel(TIME, Axis(f"residual, {unit}"), (residual,), shaded=masked, height=1.3))
    return Chart(tuple(panels), title, live=True)


def part_of(prediction: Prediction, time: np.ndarray, start: float, stop: float) -> tuple[Prediction, np.ndarray]:
    """Take the part of a prediction between two instants of its ``time`` (K,), s."""
    window = (time >= start) & (time <= stop)
    return prediction.part(window), time[window]


def stretch_title(name: str, start: float, stop: float, length: float) -> str:
    """Name a stretch of a run, s."""
    return f"{name}, {start:.4g} to {stop:.4g} s of {length:.4g} s"


def residuals_section(result: IdentifiedModel, runs: Sequence[RunEvidence]) -> Section | None:
    """Show histogram, spectrum and autocorrelation of the residuals of each joint, over all runs used."""
    used = [each for each in runs if each.used and each.prediction is not None]
    if not used:
        return None
    joints = used[0].prediction.joints if used[0].prediction else ()
    series = {joint: [(each.time, each.residuals[:, j]) for each in used] for j, joint in enumerate(joints)}
    words = (
        "Over all runs used, masked samples left out. White residuals have a flat spectrum and an autocorrelation "
        "within the band; where they do not, the block jackknife accounts for it in the standard deviations."
    )
    units = {joint: torque_unit(result.robot, joint) for joint in joints}
    panels = residual_panels(series, units)
    found = {joint: histogram(each) for joint, each in series.items()}
    rows = [(joint_label(joint), each and each.mean, each and each.std, units[joint]) for joint, each in found.items()]
    columns = (Column("joint"), Column("mean", Kind.NUMBER, 2), Column("std", Kind.NUMBER, 3), Column("unit"))
    chart = Chart(panels, columns=3) if panels else None
    return section("Residuals", Text(words), chart, table(columns, rows), id="residuals")


def residual_panels(series: dict[str, list[tuple[np.ndarray, np.ndarray]]], units: dict[str, str]) -> tuple[Panel, ...]:
    """Draw histograms, spectra (one panel for each unit) and autocorrelations of residuals by joint."""
    bars: list[Series] = []
    lags: list[Series] = []
    bands: list[float] = []
    spectra: dict[str, list[Series]] = {}
    for j, (joint, each) in enumerate(series.items()):
        density, power, correlation = histogram(each), spectrum(each), autocorrelation(each)
        if density is not None:
            edges = (density.edges - density.mean) / density.std
            bars.append(Series(joint_label(joint), edges, density.density * density.std, colour(j), "steps"))
        if power is not None and (power.density > 0).any():
            shown = power.density > 0
            line = Series(joint_label(joint), power.frequency[shown], np.sqrt(power.density[shown]), colour(j))
            spectra.setdefault(units[joint], []).append(line)
        if correlation is not None:
            lags.append(Series(joint_label(joint), correlation.lag, correlation.value, colour(j)))
            bands.append(correlation.band)
    panels = []
    if bars:
        x = np.linspace(-4.0, 4.0, 90)
        normal = Series("normal density", x, np.exp(-(x**2) / 2) / np.sqrt(2 * np.pi), "soft", width=0.8)
        axis = Axis("residual / standard deviation", limits=(-4.5, 4.5))
        panels.append(Panel(axis, Axis("density"), (*bars, normal), "Histogram", height=2))
    for unit, lines in spectra.items():
        axis = Axis("frequency, Hz")
        panels.append(Panel(axis, Axis(f"{unit}/√Hz", log=True), tuple(lines), "Amplitude spectral density", height=2))
    if lags:
        title, band = "Autocorrelation; band: white noise, 95 %", (-max(bands), max(bands))
        panels.append(Panel(Axis("lag, s"), Axis("autocorrelation"), tuple(lags), title, band=band, height=2))
    return tuple(panels)
