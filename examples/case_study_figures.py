"""Figures of the case study: exciting motion, payloads, test trajectories and tracking errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from control_comparison import STRATEGIES, ControlComparison

from gtau.estimation.results.estimate import Estimate
from gtau.report.chart import Axis, Chart, Panel, Rule, Series, colour, intervals
from gtau.report.page import joint_label
from gtau.simulation.closed_loop import Reference

MICRO = 1e6
TIME = Axis("time, s")
COLOURS = dict(zip(STRATEGIES, ("c7", "c1", "c3", "c0", "c4"), strict=True))


def payload_chart(prior: Estimate, identified: Estimate, truth: float) -> Chart:
    """Draw a payload's mass by the manufacturer's and by the identified gains, and the true one, kg."""
    masses = (prior, identified)
    panel = intervals(
        ["with the manufacturer's gains", "with the identified gains"],
        [mass.value for mass in masses],
        [mass.half_interval() for mass in masses],
        "mass of the payload, kg (95 % intervals)",
    )
    return Chart((replace(panel, rules=(Rule(x=truth, label=f"true {truth:g} kg"),), height=1.6),))


def trajectory_chart(
    time: np.ndarray,
    motion: tuple[np.ndarray, np.ndarray, np.ndarray],
    joints: Sequence[str],
    unit: str,
    run: str,
    detail: float = 5.0,
) -> Chart:
    """Draw joint positions over a whole run; velocities and accelerations during its first seconds.

    ``run`` is the name of the run, ``time`` (N,) in s, ``motion`` positions, velocities and accelerations, each (N, n),
    in ``unit`` and s.
    """
    early = time <= time[0] + detail
    shown = (slice(None), early, early)
    names = (f"position, {unit}", f"velocity, {unit}/s", f"acceleration, {unit}/s²")
    titles = ("", f"The first {detail:g} s of it, shaded above", "")
    panels = [
        Panel(TIME, Axis(name), _lines(time[part], values[part], joints), title)
        for values, part, name, title in zip(motion, shown, names, titles, strict=True)
    ]
    first = replace(panels[0], shaded=np.array([time[0], time[0] + detail]))
    return Chart((first, *panels[1:]), f"Run {run}")


def _lines(time: np.ndarray, values: np.ndarray, joints: Sequence[str]) -> tuple[Series, ...]:
    return tuple(Series(joint_label(joint), time, values[:, j], colour(j)) for j, joint in enumerate(joints))


def references_chart(references: Mapping[str, Reference], joints: Sequence[str], units: Sequence[str]) -> Chart:
    """Draw positions of the actuated joints along the test trajectories (paper, Fig. 6)."""
    panels = [
        Panel(TIME, Axis(f"position, {units[0]}"), _lines(each.time, each.q, joints), _title(name), height=1.8)
        for name, each in references.items()
    ]
    return Chart(tuple(panels), columns=len(panels))


def tracking_chart(comparison: ControlComparison, trajectory: str) -> Chart:
    """Draw tracking errors along a trajectory (paper, Figs. 7 and 8), a row a joint; computed torques apart."""
    tracking = [each for each in comparison.tracking if each.trajectory == trajectory]
    panels = []
    for j, (joint, unit) in enumerate(zip(comparison.joints, comparison.units, strict=True)):
        for pid in (True, False):
            lines = [
                Series(each.strategy, each.time, MICRO * each.error[:, j], COLOURS[each.strategy], width=1.0)
                for each in tracking
                if ("PID" in each.strategy) == pid
            ]
            law = "PID" if pid else "computed torque (CTC)"
            title = f"Tracking error, {law}" if j == 0 else ""
            panels.append(Panel(TIME, Axis(f"{joint_label(joint)}, µ{unit}"), tuple(lines), title))
    return Chart(tuple(panels), columns=2)


def _title(name: str) -> str:
    return name.replace("_", " ").capitalize()
