"""Figures of the case study: exciting motion, payloads, test trajectories and tracking errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.estimation.results.estimate import Estimate
from gtau.report.figures import INTERVAL
from gtau.report.style import (
    BLACK,
    BLUE,
    GREY,
    IDENTIFIED,
    LINES,
    ORANGE,
    PRIOR,
    VERMILION,
    joint_label,
    light_grid,
    new_figure,
    styled,
    value_label,
    with_interval,
)
from gtau.simulation.control_comparison import STRATEGIES, ControlComparison
from gtau.simulation.controllers import Reference

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MICRO = 1e6
LOOKS: dict[str, dict[str, Any]] = dict(
    zip(
        STRATEGIES,
        (
            {"color": GREY, "linewidth": 1.3},
            {"color": VERMILION, "linestyle": (0, (5, 1.6))},
            {"color": BLACK, "linewidth": 0.9},
            {"color": BLUE, "linewidth": 2.2},
            {"color": ORANGE, "linestyle": (0, (5, 1.4, 1, 1.4))},
        ),
        strict=True,
    )
)


def payload_figure(prior: Estimate, identified: Estimate, truth: float) -> Figure:
    """Draw a payload's mass by the manufacturer's and by the identified gains, and the true one, kg."""
    with styled():
        figure = new_figure(7.2, 2.0)
        axes = figure.subplots()
        axes.axvline(truth, color=BLACK, linewidth=0.9)
        for row, (mass, look) in enumerate(((prior, PRIOR), (identified, IDENTIFIED))):
            value, half = mass.value or 0.0, INTERVAL * (mass.std or 0.0)
            axes.errorbar([value], [row], xerr=[half], **look)
            value_label(axes, f"{with_interval(value, half)} kg", value, row, look["color"])
        axes.annotate(f"true {truth:g} kg", (truth, 1.0), xycoords=("data", "axes fraction"), xytext=(0, 3),
                      textcoords="offset points", ha="center", va="bottom")  # fmt: skip
        axes.set_yticks([0, 1], ["with the manufacturer's gains", "with the identified gains"])
        axes.set_ylim(1.5, -0.9)
        axes.margins(x=0.25)
        axes.spines["left"].set_visible(False)
        axes.set_xlabel("mass of the payload, kg (95 % intervals)")
        light_grid(axes, "x")
    return figure


def trajectory_figure(
    time: np.ndarray,
    motion: tuple[np.ndarray, np.ndarray, np.ndarray],
    joints: Sequence[str],
    unit: str,
    run: str,
    detail: float = 5.0,
) -> Figure:
    """Draw joint positions over a whole run; velocities and accelerations during its first seconds.

    ``run`` is the name of the run, ``time`` (N,) in s, ``motion`` positions, velocities and accelerations, each (N, n),
    in ``unit`` and s.
    """
    early = time <= time[0] + detail
    with styled():
        figure = new_figure(7.2, 5.4)
        whole, speed, push = figure.subplots(3, 1, height_ratios=(1.15, 1, 1))
        _joint_lines(whole, time, motion[0], joints, f"position, {unit}")
        _joint_lines(speed, time[early], motion[1][early], joints, f"velocity, {unit}/s")
        _joint_lines(push, time[early], motion[2][early], joints, f"acceleration, {unit}/s²")
        whole.axvspan(time[0], time[0] + detail, color="#EFEFEF", zorder=0)
        whole.set_title(f"Run {run}")
        speed.set_title(f"The first {detail:g} s of it, grey above")
        speed.tick_params(labelbottom=False)
        push.set_xlabel("time from the start of the run, s")
        figure.align_ylabels()
        figure.legend(handles=whole.get_lines(), loc="outside upper center", ncols=len(joints))
    return figure


def _joint_lines(axes: Axes, time: np.ndarray, values: np.ndarray, joints: Sequence[str], label: str) -> None:
    for j, joint in enumerate(joints):
        axes.plot(time, values[:, j], label=joint_label(joint), **LINES[j % len(LINES)])
    axes.set_ylabel(label)
    axes.set_xlim(time[0], time[-1])
    light_grid(axes)


def references_figure(references: Mapping[str, Reference], joints: Sequence[str], units: Sequence[str]) -> Figure:
    """Draw positions of the actuated joints along the test trajectories (paper, Fig. 6)."""
    with styled():
        figure = new_figure(7.2, 2.6)
        for axes, (name, reference) in zip(
            figure.subplots(1, len(references), sharey=True, squeeze=False)[0], references.items(), strict=True
        ):
            for j, joint in enumerate(joints):
                axes.plot(reference.time, reference.q[:, j], label=joint_label(joint), **LINES[j % len(LINES)])
            axes.set_title(name.replace("_", " ").capitalize())
            axes.set_xlabel("time, s")
            axes.set_xlim(reference.time[0], reference.time[-1])
            light_grid(axes)
        figure.axes[0].set_ylabel(f"position, {units[0]}")
        figure.legend(handles=figure.axes[0].get_lines(), loc="outside upper center", ncols=len(joints))
    return figure


def tracking_figure(comparison: ControlComparison, trajectory: str) -> Figure:
    """Draw tracking errors along a trajectory (paper, Figs. 7 and 8), a row a joint; computed torques apart."""
    tracking = [each for each in comparison.tracking if each.trajectory == trajectory]
    joints = comparison.joints
    with styled():
        figure = new_figure(7.2, 0.7 + 1.55 * len(joints))
        grid = figure.subplots(len(joints), 2, sharex=True, sharey="col", squeeze=False)
        for j, (joint, unit) in enumerate(zip(joints, comparison.units, strict=True)):
            for each in tracking:
                axes = grid[j, 0 if "PID" in each.strategy else 1]
                axes.plot(each.time, MICRO * each.error[:, j], label=each.strategy, **LOOKS[each.strategy])
            grid[j, 0].set_ylabel(f"{joint_label(joint)}, µ{unit}")
            for axes in grid[j]:
                light_grid(axes)
                axes.set_xlim(tracking[0].time[0], tracking[0].time[-1])
        grid[0, 0].set_title("Tracking error, PID")
        grid[0, 1].set_title("Tracking error, computed torque (CTC)")
        for axes in grid[-1]:
            axes.set_xlabel("time, s")
        figure.align_ylabels()
        figure.legend(handles=grid[0, 0].get_lines(), loc="outside upper left")
        figure.legend(handles=grid[0, 1].get_lines(), loc="outside upper right")
    return figure
