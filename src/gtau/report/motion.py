"""Show the robot, its motion, and the logs: distances to singular poses, clock, repairs and preparation."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from gtau.estimation.results.conclusions import NEAR_SINGULAR
from gtau.estimation.results.estimate import NearestPose
from gtau.estimation.results.result import IdentifiedModel
from gtau.report.chart import Axis, Chart, Panel, Rule, Series, colour
from gtau.report.evidence import RunEvidence
from gtau.report.page import Column, Kind, Section, Text, joint_label, table_of
from gtau.robots.robot import Robot
from gtau.signals.reading.logs import logged_instants
from gtau.signals.run import Run
from gtau.signals.storage import block, spans

if TYPE_CHECKING:
    from gtau.estimation.check_logs import LogCheck

TYPES = {1: "type 1 (serial)", 2: "type 2 (parallel)"}
"""Names of the types of singularities."""
COLOURS = {1: "c7", 2: "c6"}  # not among the colours of six joints
TIME = Axis("time from the start of the run, s")
LOWEST = 1e-9  # of the peak of a spectrum; lower values are rounding errors
FREQUENCY = Axis("frequency, Hz", log=True)


def motion_section(result: IdentifiedModel, runs: Sequence[RunEvidence]) -> Section:
    """Show the robot, and the distances of its motion to singular poses."""
    used = any(run.used for run in runs)
    starts = {run.run.name: float(run.run.time[0]) for run in runs}
    along = zip(result.runs, result.distances, strict=False)  # empty for a loaded result
    distances = distances_panels((name, starts.get(name, 0.0), run) for name, run in along) if used else []
    return Section(
        "Robot and motion",
        result.robot,
        singularities_section(result.singularities) if used else None,
        *(Section(panel.title, Chart((panel,), live=True), folded=k > 0) for k, panel in enumerate(distances)),
        id="robot",
    )


def joint_panels(
    robot: Robot, joints: Sequence[str], time: np.ndarray, values: np.ndarray, what: str, height: float, per: str = ""
) -> list[Panel]:
    """Draw a quantity (K, n) of joints over time, in one panel for rotations and one for translations."""
    lines: dict[str, list[Series]] = {"rad": [], "m": []}
    for j, joint in enumerate(joints):
        lines[robot.joint(joint).unit].append(Series(joint_label(joint), time, values[:, j], colour(j)))
    drawn = [(Axis(f"{what}, {unit}{per}"), tuple(series)) for unit, series in lines.items() if series]
    return [Panel(TIME, axis, series, height=height) for axis, series in drawn]


def singularities_section(nearest: Sequence[NearestPose]) -> Section | None:
    """Show the poses of runs nearest to singular poses."""
    if not nearest:
        return None
    listed = table_of(
        nearest,
        (Column("run"), "run"),
        (Column("singularity"), lambda pose: TYPES[pose.type]),
        (Column("nearest", Kind.NUMBER, 3), "distance"),
        (Column("at, s", Kind.NUMBER), "time"),
        (Column("pose, rad or m", wide=True), _pose),
    )
    words = "1 at best, 0 at a singular pose; at one of type 1 a motor can move while the tool stands still."
    return Section("Distance to singular poses", listed, Text(words, style="soft"))


def _pose(nearest: NearestPose) -> str:
    return ", ".join(f"{joint} {round(q, 3) + 0.0:.3g}" for joint, q in nearest.pose.items())


def distances_panels(runs: Iterable[tuple[str, float, np.ndarray]]) -> list[Panel]:
    """Draw distances to singular poses along runs, given as name, start (s) and distances."""
    panels = []
    for run, start, distances in runs:
        time = distances["time"] - start
        series = [
            Series(name, time, distances[f"type_{kind}"], COLOURS[kind], width=1.4)
            for kind, name in TYPES.items()
            if np.isfinite(distances[f"type_{kind}"]).any()
        ]
        if len(series) == len(TYPES):  # type 2 magnifies errors
            limit = np.full(len(time), NEAR_SINGULAR)
            series.append(Series(f"near: {NEAR_SINGULAR:g}", time, limit, "bad", width=0.8))
        axis = Axis(series[0].label if len(series) == 1 else "distance", limits=(0.0, 1.05))  # one has no key
        panels += [Panel(TIME, axis, tuple(series), run, height=1.4)] if series else []
    return panels


# Logs


def payload_words(run: Run) -> str:
    """Describe the payload of a run."""
    if run.payload is None:
        return "no payload"
    mass = "of unknown mass" if run.payload.mass is None else f"of {run.payload.mass:g} kg"
    return f"payload '{run.payload.name}' {mass}"


def seconds(run: Run) -> float:
    """Return the duration of a run, s."""
    return float(run.time[-1] - run.time[0])


def logs_section(runs: Sequence[Run]) -> Section | None:
    """Show clock and repairs of logs."""
    if not runs:
        return None
    listed = table_of(
        runs,
        (Column("log"), "name"),
        (Column("samples", Kind.NUMBER, 8), lambda run: len(run.time)),
        (Column("rate, Hz", Kind.NUMBER, 5), "rate"),
        (Column("duration, s", Kind.NUMBER), seconds),
        (Column("repaired, %", Kind.SHARE, 2), lambda run: 1 - valid_share(run)),
        (Column("clock and repairs"), lambda run: "; ".join(map(str, run.notes)) or "uniform clock, no repairs"),
    )
    return Section("Clock and repairs of the logs", listed, id="logs")


def valid_share(run: Run) -> float:
    """Compute the share of samples, over all joints, that were not repaired."""
    return float(np.sum([np.sum(block(run.valid, *span)) for span in spans(len(run.valid))])) / run.valid.size


# Preparation


def preparation_chart(log: LogCheck) -> Chart:
    """Draw the spectra of the joints in a log, the steps of its clock, and the rows used."""
    preparation = log.preparation
    marks = {
        "bandwidth": preparation.bandwidth,
        "position filter": preparation.cutoff,
        "Nyquist of the rows": log.run.rate / preparation.decimator.factor / 2,
    }
    rules = tuple(Rule(x=mark, label=f"{name} {mark:.3g} Hz") for name, mark in marks.items() if mark is not None)
    titles = {"speed": "Power of the velocities", "acceleration": "Power of the accelerations; dots: noise dominates"}
    share = Axis("share of the peak", log=True)
    panels = [Panel(FREQUENCY, share, _shares(log, kind), title, rules, height=2.3) for kind, title in titles.items()]
    return Chart((*panels, *([_steps(log.run)] if log.run.log.paths else []), _used(log)), log.run.name)


def _shares(log: LogCheck, kind: str) -> tuple[Series, ...]:
    """Draw the power spectrum of each joint, with a dot where noise starts to dominate the acceleration."""
    series: list[Series] = []
    for j, joint in enumerate(log.joints):
        spectrum = joint.spectrum
        density, frequency = getattr(spectrum, kind), spectrum.frequency
        shown = density > LOWEST * density.max()
        if not shown.any():
            continue
        share = density / density.max()
        series.append(Series(joint_label(joint.joint), frequency[shown], share[shown], colour(j)))
        if spectrum.moves and kind == "acceleration":
            k = int(np.argmin(np.abs(frequency - spectrum.end)))
            series.append(Series("", frequency[k : k + 1], share[k : k + 1], colour(j), "points", width=3.0))
    return tuple(series)


def _steps(run: Run) -> Panel:
    """Draw the steps of the time column over time, in sampling periods."""
    log = run.log
    assert log.signals is not None and log.units is not None  # noqa: PT018 (it has files)
    stamps = logged_instants(log.paths[0], log.signals, log.units.scale(log.signals)[2])
    begin, end, period = float(run.time[0]), float(run.time[-1]), 1 / run.rate
    stamps = stamps[(stamps >= begin - period) & (stamps <= end + period)]  # drops NaN, too
    time, steps = stamps[1:], np.diff(stamps) / period
    top = max(2.0, 1.1 * float(steps.max(initial=0.0)))
    series = Series("", time - begin, steps, "soft", width=0.6)
    return Panel(TIME, Axis("step, samples", limits=(0.0, top)), (series,), "Steps of the time column", height=1.2)


def _used(log: LogCheck) -> Panel:
    """Draw the decimated rows used of each joint as bars, with gaps at reversals, rests and masked samples."""
    time, series = log.distances["time"] - float(log.run.time[0]), []
    for j in range(len(log.run.joints)):
        edges = np.flatnonzero(np.diff(np.r_[False, log.used[:, j], False]))
        ends = np.column_stack([time[edges[::2]], time[np.minimum(edges[1::2], len(time) - 1)]])
        series.append(Series("", ends, np.array([float(j)]), colour(j), "spans"))
    count = len(log.run.joints)
    names = {float(j): joint_label(joint) for j, joint in enumerate(log.run.joints)}
    return Panel(
        Axis(TIME.label, limits=(0.0, seconds(log.run))),
        Axis("", limits=(count - 0.5, -0.5), names=names),
        tuple(series),
        "Rows used, without reversals, rests, gaps and clipped commands",
        height=0.6 + 0.16 * count,
    )
