"""Plot the preparation of a log: spectra, steps of the clock, rows used."""

from __future__ import annotations

import numpy as np

from gtau.estimation.check_logs import LogCheck
from gtau.report.logs import FREQUENCY, LOWEST, seconds
from gtau.report.motion import TIME
from gtau.report.page import Axis, Chart, Panel, Rule, Series, colour, joint_label
from gtau.signals.bandwidth import JointSpectrum
from gtau.signals.log_set import find_logs
from gtau.signals.run import Log, Run


def preparation_chart(log: LogCheck) -> Chart:
    """Draw the spectra of a log's joints, the steps of its clock, and which rows of each joint are used."""
    preparation = log.preparation
    marks = [(preparation.bandwidth, "bandwidth"), (preparation.cutoff, "position filter")]
    marks.append((log.run.rate / preparation.decimator.factor / 2, "Nyquist of the rows"))
    rules = tuple(Rule(x=each, label=f"{name} {each:.3g} Hz") for each, name in marks if each is not None)
    share = Axis("share of the peak", log=True)
    speeds, accelerations = (_shares(log, what) for what in ("speed", "acceleration"))
    ends = "Power of the accelerations; dots: noise dominates"
    panels = [
        Panel(FREQUENCY, share, speeds, "Power of the velocities", rules, height=2.3),
        Panel(FREQUENCY, share, accelerations, ends, rules, height=2.3),
    ]
    stamps = None if log.run.log is None else _stamps(log.run.log)
    panels += [] if stamps is None else [_steps(stamps, log.run)]
    panels.append(_used(log))
    return Chart(tuple(panels), log.run.name)


def _shares(log: LogCheck, what: str) -> tuple[Series, ...]:
    found: list[Series] = []
    for j, (joint, each) in enumerate(zip(log.run.joints, log.spectra, strict=True)):
        density = getattr(each, what)
        shown = density > LOWEST * density.max()
        if not shown.any():
            continue
        found.append(
            Series(joint_label(joint), each.frequency[shown], density[shown] / density.max(), colour(j), width=1.3)
        )
        if each.moves and what == "acceleration":
            found.append(_end(each, density, colour(j)))
    return tuple(found)


def _end(each: JointSpectrum, density: np.ndarray, hue: str) -> Series:
    k = int(np.argmin(np.abs(each.frequency - each.end)))
    return Series("", each.frequency[k : k + 1], density[k : k + 1] / density.max(), hue, "points", width=3.0)


def _stamps(log: Log) -> np.ndarray:
    """Read the time column (N,) of a whole log, s."""
    time = np.concatenate([values[:, -1] for values in find_logs(log.paths, log.signals, log.units).blocks()])
    return np.asarray(time[np.isfinite(time)])


def _steps(stamps: np.ndarray, run: Run) -> Panel:
    """Draw steps of the time column over time, in samples of the grid."""
    begin, end, period = float(run.time[0]), float(run.time[-1]), 1 / run.rate
    stamps = stamps[(stamps >= begin - period) & (stamps <= end + period)]
    time, steps = stamps[1:], np.diff(stamps) / period
    top = max(2.0, 1.1 * float(steps.max(initial=0.0)))
    series = Series("", time - begin, steps, "soft", width=0.6)
    return Panel(TIME, Axis("step, samples", limits=(0.0, top)), (series,), "Steps of the time column", height=1.2)


def _used(log: LogCheck) -> Panel:
    """Draw which decimated rows of each joint are used: bars; the gaps are reversals, rests and masked samples."""
    time, series = log.distances.time - float(log.run.time[0]), []
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
