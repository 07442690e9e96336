"""The figure of a fleet: each joint's gain on every robot, from the fleet's median."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gtau.fleet.gains import FleetTable
from gtau.report.style import BLUE, GREY, VERMILION, joint_label, light_grid, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAMED = 40  # robots whose names find room below the axis
INTERVAL = 1.96  # standard deviations to either side of a value


def fleet_figure(table: FleetTable, model: str) -> Figure:
    """Draw gains of the robots of one model in per cent of the median, with 95 % intervals; outliers by name."""
    joints = [each for each in table.joints if each.model == model]
    robots = list(dict.fromkeys(gain.robot for gain in table.gains if gain.model == model))
    with styled():
        figure = new_figure(8, 1.0 + 1.7 * len(joints))
        panels = np.atleast_1d(figure.subplots(len(joints), 1, sharex=True))
        for axes, joint in zip(panels, joints, strict=True):
            gains = [g for g in table.gains if (g.model, g.joint, g.unit) == (model, joint.joint, joint.unit)]
            gains = [g for g in gains if g.difference_percent is not None]
            percent = 100 / abs(joint.median)
            axes.axhspan(-percent * joint.spread, percent * joint.spread, color="#EEEEEE", label="spread of the fleet")
            axes.axhline(0.0, color=GREY, linewidth=0.8)
            for outlier, color, marker in ((False, BLUE, "o"), (True, VERMILION, "D")):
                shown = [g for g in gains if g.outlier == outlier]
                axes.errorbar(
                    [robots.index(g.robot) for g in shown],
                    [g.difference_percent or 0.0 for g in shown],
                    [INTERVAL * percent * (g.std or 0.0) for g in shown],
                    color=color, marker=marker, linestyle="", markersize=3 if len(robots) > NAMED else 5, capsize=0,
                    markerfacecolor="white" if outlier else color, label="outlier" if outlier else "robot",
                )  # fmt: skip
                for g in shown if outlier else ():
                    place = (robots.index(g.robot), g.difference_percent or 0.0)
                    axes.annotate(g.robot, place, xytext=(5, 3), textcoords="offset points", color=color)
            axes.set_title(
                f"{joint_label(joint.joint)}: median {joint.median:.5g} ± {joint.median_std:.2g} {joint.unit}"
            )
            axes.set_ylabel("from median, %")
            light_grid(axes, "y")
        panels[-1].set_xlabel(f"{model}: robots; bars are 95 % intervals")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
        if len(robots) <= NAMED:
            panels[-1].set_xticks(range(len(robots)), robots, rotation=90)
    return figure
