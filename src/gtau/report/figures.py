"""The figures: data in, :class:`matplotlib.figure.Figure` out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from gtau.estimation.results.estimate import Estimate, Prediction
from gtau.report.style import (
    BLACK,
    BLUE,
    GREY,
    IDENTIFIED,
    PRIOR,
    VERMILION,
    joint_label,
    light_grid,
    new_figure,
    styled,
    value_label,
    with_interval,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INTERVAL = 1.96  # standard deviations to either side, 95 %


def gains_figure(gains: Mapping[str, Estimate], truth: Mapping[str, float], prior: Mapping[str, float]) -> Figure:
    """Draw identified drive gains with 95 % intervals, and the manufacturer's, in per cent off the true gains.

    On the left both on one scale, on the right the identified ones alone on their own.
    """
    joints = list(gains)
    rows = np.arange(len(joints))
    true, given = (np.array([values[joint] for joint in joints]) for values in (truth, prior))
    found = np.array([gains[joint].value for joint in joints], dtype=float)
    half = INTERVAL * np.array([gains[joint].std or 0.0 for joint in joints])
    error, bar, off = (100 * each / true for each in (found - true, half, given - true))
    with styled():
        figure = new_figure(7.2, 1.2 + 0.62 * len(joints))
        wide, close = figure.subplots(1, 2, sharey=True, width_ratios=(1.25, 1))
        for axes in (wide, close):
            axes.axvline(0.0, color=BLACK, linewidth=0.9, label="true")
            axes.errorbar(error, rows, xerr=bar, linestyle="none", label="identified, 95 % interval", **IDENTIFIED)
            light_grid(axes, "x")
            axes.spines["left"].set_visible(False)
        wide.plot(off, rows, linestyle="none", label="manufacturer's", **PRIOR)
        for row in range(len(joints)):
            value_label(wide, f"{given[row]:.5g}", off[row], row, PRIOR["color"])
            value_label(close, with_interval(found[row], half[row]), error[row], row, IDENTIFIED["color"])
            wide.annotate(f"{true[row]:.5g}", (0, row), xytext=(0, 9), textcoords="offset points",
                          ha="center", bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0})  # fmt: skip
        span = 1.3 * np.max(np.abs(error) + bar)
        close.set_xlim(-span, span)
        wide.set_xlim(min(1.25 * off.min(), -1.0), max(1.25 * off.max(), 1.3))
        wide.set_yticks(rows, [f"{joint_label(joint)}\n{gains[joint].unit}" for joint in joints])
        wide.set_ylim(len(joints) - 0.6, -0.75)
        wide.set_title("All gains")
        close.set_title("Identified gains, closer")
        figure.legend(*wide.get_legend_handles_labels(), loc="outside upper center", ncols=3)
        figure.supxlabel("error of the drive gain, % of the true one", fontsize=9)
    return figure


def torques_figure(
    prediction: Prediction,
    units: Sequence[str],
    start: float,
    stop: float,
    title: str,
    kind: str = "current",
    origin: float = 0.0,
    length: float | None = None,
) -> Figure:
    """Draw measured and predicted torques of each joint between two instants, and the residuals.

    ``start`` and ``stop`` are in s from the start of the run, which the prediction's clock calls ``origin``; a stretch
    that is not the whole run, of ``length`` s, stands in the title. Where ``kind`` is current, what is measured is
    ``v g_tau``. Where the model's friction does not hold, near reversals, the residual is left out.
    """
    since_start = prediction.time - origin
    window = (since_start >= start) & (since_start <= stop)
    if not window.all():
        title = f"{title}, {start:.4g} to {stop:.4g} s of {length or since_start[-1]:.4g} s"
    time = since_start[window]
    measured, predicted, keep = (each[window] for each in (prediction.measured, prediction.predicted, prediction.keep))
    difference = np.where(keep, measured - predicted, np.nan)
    largest = 1.15 * np.where(keep, np.abs(measured - predicted), 0.0).max(axis=0, initial=0.0)
    n = len(prediction.joints)
    label = "measured (current × gain)" if kind == "current" else "measured"
    with styled():
        figure = new_figure(7.2, 0.5 + 2.2 * n)
        grid = figure.add_gridspec(3 * n - 1, 1, height_ratios=([2.4, 1, 0.12] * n)[:-1])  # third rows: space
        for j, joint in enumerate(prediction.joints):
            above, below = (figure.add_subplot(grid[3 * j + k]) for k in (0, 1))
            above.plot(time, measured[:, j], color="#B8B8B8", linewidth=3.4, label=label)
            above.plot(time, predicted[:, j], color=BLUE, linewidth=1.1, label="predicted")
            above.set_ylabel(f"{'force' if units[j] == 'N' else 'torque'}, {units[j]}")
            above.set_title(f"{title}: {joint_label(joint)}" if j == 0 else joint_label(joint))
            below.axhline(0.0, color=GREY, linewidth=0.8)
            below.plot(time, difference[:, j], color=VERMILION, linewidth=1.0, label="residual (reversals left out)")
            limit = largest[j] or 1.0
            below.set_ylim(-limit, limit)
            below.set_ylabel(units[j])
            for axes in (above, below):
                light_grid(axes)
                axes.set_xlim(start, stop)
                axes.tick_params(labelbottom=j == n - 1 and axes is below)
                axes.spines["bottom"].set_visible(j == n - 1 and axes is below)
        below.set_xlabel("time from the start of the run, s")
        figure.align_ylabels()
        handles = above.get_legend_handles_labels()[0] + below.get_legend_handles_labels()[0]
        figure.legend(handles=handles, loc="outside upper center", ncols=3)
    return figure
