"""Figures of simulated control: test trajectories and tracking errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from gtau.report.style import (
    BLACK,
    BLUE,
    GREY,
    LINES,
    ORANGE,
    VERMILION,
    joint_label,
    light_grid,
    new_figure,
    styled,
)
from gtau.simulation.control_comparison import STRATEGIES, ControlComparison
from gtau.simulation.controllers import Reference

if TYPE_CHECKING:
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
