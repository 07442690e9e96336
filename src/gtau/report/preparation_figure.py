"""A figure of how a log is prepared: spectra with the chosen bandwidth, steps of the clock, and what is left out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gtau.estimation.check_logs import ExperimentCheck, LogCheck
from gtau.report.style import BLACK, GREY, LINES, joint_label, light_grid, new_figure, save_figure, styled
from gtau.signals.log_set import find_logs
from gtau.signals.run import Log, Run

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LOWEST = 1e-9  # of a spectrum's peak: what lies lower is arithmetic
LEGEND = 95  # letters in a line of the legend


def preparation_figure(log: LogCheck) -> Figure:
    """Draw the spectra of a log's joints, the steps of its clock, and which rows of each joint are used."""
    stamps = None if log.run.log is None else _stamps(log.run.log)
    joints = log.run.joints
    with styled():
        figure = new_figure(7.2, 6.4 + 0.16 * len(joints) + (1.6 if stamps is not None else 0.0))
        heights = [2.4, 2.4] + ([1.2] if stamps is not None else []) + [0.5 + 0.16 * len(joints)]
        panels = figure.subplots(len(heights), 1, height_ratios=heights)
        speed, acceleration, *clock, used = panels
        _spectra(speed, log, "speed")
        _spectra(acceleration, log, "acceleration")
        speed.set_title(f"{log.run.name}: power of the velocities")
        acceleration.set_title("Power of the accelerations; the signal ends where noise takes over (dots)")
        acceleration.set_xlabel("frequency, Hz")
        if stamps is not None:
            _steps(clock[0], stamps, log.run)
        _used(used, log)
        width = max(len(joint_label(joint)) for joint in joints) + 9  # letters, and the line beside them
        columns = min(len(joints), max(LEGEND // width, 1))
        figure.legend(handles=speed.get_lines()[: len(joints)], loc="outside upper center", ncols=columns)
    return figure


def _stamps(log: Log) -> np.ndarray:
    """Read the time column (N,) of a whole log, s."""
    time = np.concatenate([values[:, -1] for values in find_logs(log.paths, log.signals, log.units).blocks()])
    return np.asarray(time[np.isfinite(time)])


def _spectra(axes: Axes, log: LogCheck, what: str) -> None:
    """Draw spectra of all joints that move; end of the signal, bandwidth, filter and rate of rows."""
    preparation = log.preparation
    for j, (joint, each) in enumerate(zip(log.run.joints, log.spectra, strict=True)):
        density = getattr(each, what)
        peak = density.max()
        if peak > 0:
            look = {**LINES[j % len(LINES)], **({} if each.moves else {"alpha": 0.35})}
            axes.loglog(
                each.frequency,
                np.where(density > LOWEST * peak, density / peak, np.nan),
                label=joint_label(joint),
                **look,
            )
            if each.moves and what == "acceleration":
                end = np.argmin(np.abs(each.frequency - each.end))
                axes.plot(each.frequency[end], density[end] / peak, "o", color=LINES[j % len(LINES)]["color"])
    marks = [(preparation.bandwidth, "bandwidth", "-")]
    if preparation.cutoff is not None:
        marks.append((preparation.cutoff, "position filter", "--"))
    marks.append((log.run.rate / preparation.decimator.factor / 2, "Nyquist of the rows", ":"))
    for frequency, name, style in marks:
        axes.axvline(frequency, color=BLACK, linewidth=0.9, linestyle=style)
        if what == "speed":
            axes.annotate(f" {name} {frequency:.3g} Hz", (frequency, 1.0), xycoords=("data", "axes fraction"),
                          rotation=90, va="top", ha="right", fontsize=7.5,
                          bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.5})  # fmt: skip
    for axis in (axes.xaxis, axes.yaxis):  # the style parses no mathematics, which powers of ten would need
        axis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.set_ylabel("share of the peak")
    light_grid(axes)


def _steps(axes: Axes, stamps: np.ndarray, run: Run) -> None:
    """Draw steps of the time column over time, in samples of the grid."""
    begin, end = float(run.time[0]), float(run.time[-1])
    period = 1 / run.rate
    stamps = stamps[(stamps >= begin - period) & (stamps <= end + period)]
    time, steps = stamps[1:], np.diff(stamps) / period
    if len(steps) > 20000:  # of a long log the extremes of each stretch
        size = len(steps) // 5000
        whole = steps[: len(steps) // size * size].reshape(-1, size)
        time, steps = (
            np.repeat(time[: whole.size : size], 2),
            np.column_stack([whole.min(axis=1), whole.max(axis=1)]).ravel(),
        )
    axes.plot(time, steps, ".", color=GREY, markersize=2)
    axes.set_ylabel("step, samples")
    axes.set_xlim(begin, end)
    axes.set_ylim(0, max(2.0, 1.1 * float(steps.max(initial=0.0))))
    axes.set_title("Steps of the time column")
    light_grid(axes)


def _used(axes: Axes, log: LogCheck) -> None:
    """Draw which decimated rows of each joint are used: bars; the gaps are reversals, rests and masked samples."""
    time = log.distances.time
    for j, look in enumerate(LINES[k % len(LINES)] for k in range(len(log.run.joints))):
        edges = np.flatnonzero(np.diff(np.r_[False, log.used[:, j], False]))
        starts, stops = time[edges[::2]], time[np.minimum(edges[1::2], len(time) - 1)]
        axes.broken_barh(list(zip(starts, stops - starts, strict=True)), (j - 0.35, 0.7), color=look["color"])
    axes.set_yticks(range(len(log.run.joints)), [joint_label(joint) for joint in log.run.joints], fontsize=7.5)
    axes.set_ylim(len(log.run.joints) - 0.5, -0.5)
    axes.set_xlim(float(log.run.time[0]), float(log.run.time[-1]))
    axes.set_xlabel("time, s")
    axes.set_title("Rows used, without reversals, rests, gaps and clipped commands")


def write_preparation_figures(checked: ExperimentCheck, folder: Path) -> list[Path]:
    """Write the figure of every log to ``folder``; raises GtauError."""
    written: list[Path] = []
    for name, log in zip(unique_names([log.run.name for log in checked.logs]), checked.logs, strict=True):
        written.append(folder / f"{name}-preparation.png")
        save_figure(preparation_figure(log), written[-1])
    return written


def unique_names(names: Sequence[str]) -> list[str]:
    """Name files, with a number where a name recurs."""
    return [name if names.index(name) == k else f"{name}-{names[: k + 1].count(name)}" for k, name in enumerate(names)]
