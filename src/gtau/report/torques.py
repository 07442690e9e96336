"""Predict runs, and show measured and predicted torques, their residuals, and external torques."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.results.estimate import TorqueError
from gtau.estimation.results.result import IdentifiedModel
from gtau.findings import Finding, Progress, silent
from gtau.report.chart import TIME, Axis, Chart, Panel, Series, colour
from gtau.report.page import Column, ColumnOf, Kind, Page, Section, Table, Text, joint_label, table_of
from gtau.robots.parameter import torque_unit
from gtau.signals.run import Run
from gtau.uses.external_torques import TorquesAlongLog
from gtau.uses.prediction import Prediction, other_unit, predict, torque_errors
from gtau.uses.weigh import undeclared_load

REVERSALS = (
    "Raw: against the measured torque. In band: both behind the low-pass filter of the identification, with reversals. "
    "Without reversals: as used for gains and inertia, because friction changes its sign at reversals."
)
BANDS = (
    "Against the raw torque at all samples; each band starts where the previous one ends. Near 100 % the model does "
    "not explain the torque in a band: the torque is noise, or faster than the positions show."
)
EXTERNAL = Text(
    "Behind the low-pass filter of the identification.",
    (
        "rms, largest, over 4 residuals: without reversals",
        "rms, all: with reversals",
        "residual: torque residual of the identification",
        "over 4 residuals: share of samples, by chance 0.006 %; a contact or an unknown payload raises it",
    ),
)
SEEN = "seen: share of samples whose pose shows the component; elsewhere the component has no value."
LONGEST = 300_000  # samples; of longer runs only the beginning is predicted
SHORTEST = 1e-3  # of the duration: stretches closer together are shaded as one
SEGMENT = 256  # most samples in a segment of the spectrum
FEWEST = 16  # samples needed for a statistic
Residuals = Sequence[tuple[np.ndarray, np.ndarray]]
"""Times (K,) in s on a uniform grid and residuals (K,) of each run, NaN where masked."""


@dataclass(frozen=True, eq=False)
class RunEvidence:
    """A run that the model was identified from (``used``) or not, and its prediction, or the reason for having none."""

    run: Run
    used: bool
    prediction: Prediction | None = None  # at the rows of the identification, behind its low-pass filter
    samples: Prediction | None = None  # at every sample, raw, if asked for
    errors: tuple[TorqueError, ...] = ()  # of each joint over all samples
    refusal: str = ""
    cut: bool = False  # only the beginning of the run is shown
    notes: tuple[Finding, ...] = ()  # undeclared load at the tool, and assumptions of the prediction

    @property
    def time(self) -> np.ndarray:
        """Instants of the prediction from the start of the run, (K,) in s."""
        assert self.prediction is not None
        return np.asarray(self.prediction.time - float(self.run.time[0]))

    @property
    def residuals(self) -> np.ndarray:
        """Measured minus predicted torques (K, n), NaN at masked samples (:class:`Prediction`, ``keep``)."""
        assert self.prediction is not None
        return np.where(self.prediction.keep, self.prediction.measured - self.prediction.predicted, np.nan)


def gather(
    result: IdentifiedModel, runs: Iterable[Run], validation: Iterable[Run] = (), progress: Progress = silent
) -> tuple[RunEvidence, ...]:
    """Predict the runs of an identification and of its validation; one that cannot be predicted gets a ``refusal``."""
    listed = [(run, True) for run in runs] + [(run, False) for run in validation]
    gathered = []
    for k, (run, used) in enumerate(listed):
        progress("report", k, len(listed))
        try:
            gathered.append(predicted(result, run, used, progress=progress))
        except GtauError as refusal:
            gathered.append(RunEvidence(run, used, refusal=str(refusal)))
    progress("report", len(listed), len(listed))
    return tuple(gathered)


def predicted(
    result: IdentifiedModel, run: Run, used: bool = False, whole: bool = False, progress: Progress = silent
) -> RunEvidence:
    """Predict a run, or its beginning unless ``whole``, and look for an undeclared load; raises GtauError."""
    cut = not whole and len(run.time) > LONGEST
    beginning: dict[str, Any] = {
        name: np.asarray(getattr(run, name)[:LONGEST]) for name in ("time", "position", "command", "valid")
    }
    prediction = predict(result, replace(run, **beginning) if cut else run)
    errors = torque_errors(prediction, result.robot, result.preparation.bandwidth)
    load = None if used or cut else other_unit(prediction, run.kind) or undeclared_load(result, run, errors, progress)
    notes = (*((load,) if load else ()), *prediction.notes)
    return RunEvidence(run, used, prediction.rows, prediction if whole else None, errors, cut=cut, notes=notes)


def payload_words(run: Run) -> str:
    """Describe the payload of a run."""
    if run.payload is None:
        return "no payload"
    mass = "of unknown mass" if run.payload.mass is None else f"of {run.payload.mass:g} kg"
    return f"payload '{run.payload.name}' {mass}"


def errors_table(runs: Sequence[RunEvidence]) -> Table:
    """Tabulate torque errors of each joint on each run, raw and in the band of the identification."""
    share = partial(Column, kind=Kind.NUMBER, decimals=2)
    return table_of(
        [(run, error) for run in runs for error in run.errors],
        (Column("run"), lambda pair: pair[0].run.name),
        (Column("used for", wide=True), lambda pair: "identification" if pair[0].used else "validation"),
        (Column("joint"), lambda pair: pair[1].joint),
        (Column("raw error", Kind.NUMBER, 4), lambda pair: pair[1].rms_raw),
        (Column("raw torque", Kind.NUMBER, 4), lambda pair: pair[1].signal_raw),
        (Column("unit, rms"), lambda pair: pair[1].unit),
        (share("raw, %"), lambda pair: pair[1].relative_raw),
        (share("in band, %"), lambda pair: pair[1].relative_all),
        (share("in band without reversals, %"), lambda pair: pair[1].relative),
    )


def bands_section(errors: Sequence[TorqueError], folded: bool | None = None) -> Section | None:
    """Tabulate raw torque errors and torques of each joint by frequency, over all runs; None without runs."""
    bands = sorted({(band.low, band.high) for error in errors for band in error.bands})
    if not bands:
        return None
    edges = [f"to {high:.4g} Hz" for _, high in bands]
    shares, torques = [], []
    for joint in dict.fromkeys(error.joint for error in errors):
        joint_errors = [error for error in errors if error.joint == joint]
        squares = np.zeros((len(bands), 2))
        for band in (band for error in joint_errors for band in error.bands):
            squares[bands.index((band.low, band.high))] += band.rms**2, band.signal**2
        rms, signal = np.sqrt(squares.T / len(joint_errors))
        shares.append((joint_label(joint), *(100 * rms / np.maximum(signal, np.finfo(float).tiny)).tolist()))
        torques.append((joint_label(joint), *signal.tolist(), joint_errors[0].unit))
    percent = [Column(edge, Kind.NUMBER, decimals=1, most=999) for edge in edges]
    columns = [Column("measured torque, rms"), *(Column(edge, Kind.NUMBER, 2) for edge in edges), Column("unit")]
    return Section(
        "Torque errors by frequency",
        Table([Column("error, % of the torque in the band"), *percent], shares),
        Table(columns, torques),
        Text(BANDS, style="soft"),
        id="" if folded else "bands",
        folded=folded,
    )


def fit_table(residuals: Sequence[TorqueError], title: str) -> Table:
    """Tabulate the torque residuals of a fit."""
    columns: list[ColumnOf] = [
        (Column(title), "joint"),
        (Column("residual", Kind.NUMBER, 4), "rms"),
        (Column("torque", Kind.NUMBER, 4), "signal"),
        (Column("%", Kind.NUMBER, decimals=2), "relative"),
    ]
    if any(residual.rms_all is not None for residual in residuals):
        columns.append((Column("error, all", Kind.NUMBER, 4), "rms_all"))
        columns.append((Column("%, all", Kind.NUMBER, decimals=2), "relative_all"))
    return table_of(residuals, *columns, (Column("unit, rms"), "unit"))


def external_page(torques: TorquesAlongLog) -> Page:
    """Show external torques along a log, the external wrench if asked for, and torque errors by frequency."""
    rms = (Column("rms", Kind.NUMBER), "rms")
    more: list[ColumnOf] = [
        (Column("largest", Kind.NUMBER), "largest"),
        (Column("at, s", Kind.NUMBER), "time"),
        (Column("over 4 residuals, %", Kind.SHARE, decimals=2), "share"),
        (Column("unit"), "unit"),
    ]
    joint = ((Column("rms, all", Kind.NUMBER), "rms_all"), (Column("residual", Kind.NUMBER), "residual"))
    listed = table_of(torques.joints, (Column(""), "joint"), rms, *joint, *more)
    sections = [Section("External torque", listed, EXTERNAL)]
    if (wrench := torques.wrench) is not None:
        component = ((Column("±", Kind.NUMBER), "interval"), (Column("seen, %", Kind.SHARE, decimals=0), "seen"))
        listed = table_of(wrench.components, (Column(""), "name"), rms, *component, *more)
        words = f"At {wrench.frame}, in its axes. ±: half the 95 % interval (median). {SEEN}"
        sections.append(Section("External wrench", listed, Text(words)))
    return Page("", *sections, bands_section(torques.errors))


def determination(runs: Sequence[RunEvidence]) -> dict[str, float]:
    """Compute R² of each joint over runs, without reversals: 1 - error^2 / (measured - its mean)^2."""
    shares = {}
    predictions = [run.prediction for run in runs if run.prediction is not None]
    for j, joint in enumerate(predictions[0].joints if predictions else ()):
        measured = np.concatenate([run.measured[run.keep[:, j], j] for run in predictions])
        predicted = np.concatenate([run.predicted[run.keep[:, j], j] for run in predictions])
        about = np.sum((measured - measured.mean()) ** 2) if measured.size else 0.0
        if about > 0:
            shares[joint] = float(1 - np.sum((measured - predicted) ** 2) / about)
    return shares


def torques_section(result: IdentifiedModel, runs: Sequence[RunEvidence]) -> Section | None:
    """Show measured and predicted torques of every joint along every run, with the torque errors."""
    if not runs:
        return None
    parts, unfolded = [], min(runs, key=lambda run: (run.prediction is None, run.used))
    for run in runs:
        title = f"{run.run.name} ({'used' if run.used else 'validation, not used'}; {payload_words(run.run)})"
        if run.prediction is None:
            parts.append(Section(title, Text(f"Not predicted: {run.refusal}"), folded=True))
            continue
        cut = Text(f"Only the first {run.time[-1]:.4g} s of this long run are shown.", style="soft")
        chart = torques_chart(run.prediction, run.run.kind, run.time, run.errors)
        parts.append(Section(title, cut if run.cut else None, chart, folded=run is not unfolded))
    words = "A small residual says nothing about the gains, which scale measured and predicted torque alike."
    judged = [run for run in runs if not run.used and run.errors] or runs
    return Section(
        "Torques",
        Text(words),
        errors_table(judged),
        Text(REVERSALS, style="soft"),
        Section("Torque errors of every run", errors_table(runs), folded=True) if len(judged) < len(runs) else None,
        bands_section([error for run in runs for error in run.errors], folded=True),
        *parts,
        id="torques",
    )


def torques_chart(
    prediction: Prediction, kind: str, time: np.ndarray, errors: Sequence[TorqueError] = (), title: str = ""
) -> Chart:
    """Draw measured and predicted torques of each joint over ``time`` (K,), and the residuals below.

    If ``kind`` is current, the measured torque is ``v g_tau``. Reversals, where the friction of the model does not
    hold, and gaps are shaded.
    """
    error_by_joint = {error.joint: error for error in errors}
    label = "measured (current × gain)" if kind == "current" else "measured"
    panels = []
    for j, (joint, unit) in enumerate(zip(prediction.joints, prediction.units, strict=True)):
        words, error = joint_label(joint), error_by_joint.get(joint)
        if error is not None:
            words += f": torque error {error.relative:.2f} % in band without reversals"
            words += f", {error.relative_raw:.2f} % raw" if error.relative_raw is not None else ""
        measured, predicted = prediction.measured[:, j], prediction.predicted[:, j]
        masked = stretches(time, ~prediction.keep[:, j])
        both = (Series(label, time, measured, "measured", width=3.2), Series("predicted", time, predicted, width=1.2))
        axis = Axis(f"{'force' if unit == 'N' else 'torque'}, {unit}")
        panels.append(Panel(TIME, axis, both, words, shaded=masked))
        residual = Series("residual", time, measured - predicted, "residual", width=1.0)
        panels.append(Panel(TIME, Axis(f"residual, {unit}"), (residual,), shaded=masked, height=1.3))
    return Chart(tuple(panels), title, live=True)


def stretches(time: np.ndarray, masked: np.ndarray) -> np.ndarray:
    """List starts and ends, s, (2 K,) of the stretches where ``masked`` (K,) holds; near stretches are joined."""
    shortest = SHORTEST * float(time[-1] - time[0])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], masked, [False]]).astype(np.int8)))
    starts, stops = time[edges[::2]], time[np.minimum(edges[1::2], len(time) - 1)]
    apart = starts[1:] - stops[:-1] >= shortest
    if len(starts):
        starts, stops = starts[np.r_[True, apart]], stops[np.r_[apart, True]]
    return np.column_stack([starts, stops]).reshape(-1).astype(float)


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
    return Section("Residuals", Text(words), Chart(panels, columns=2) if panels else None, id="residuals")


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
    window = np.hanning(length + 1)[:-1]
    total, weight = np.zeros(length // 2 + 1), 0.0
    for time, values in long_enough:
        kept, rate = np.isfinite(values), (len(time) - 1) / (time[-1] - time[0])
        centred = np.where(kept, values - values[kept].mean(), 0.0)
        segments = np.lib.stride_tricks.sliding_window_view(centred, length)[:: length - length // 2]
        power = np.mean(np.abs(np.fft.rfft(segments * window)) ** 2, axis=0)
        power[1 : (length + 1) // 2] *= 2  # one-sided
        total, weight = total + len(kept) * power / (rate * np.sum(window**2)), weight + kept.sum()
    return np.fft.rfftfreq(length, 1 / rate)[1:], total[1:] / weight
