"""The figures of a result, one call each: ``result.plot.torques("elbow_joint")``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.results.result import Result
from gtau.report.chart import Axis, Chart, Panel, Series
from gtau.report.evidence import RunEvidence
from gtau.report.gains import gains_chart
from gtau.report.logs import seconds
from gtau.report.motion import TIME, distances_panels
from gtau.report.render.charts import figure_of
from gtau.report.residuals import residual_panels
from gtau.report.torques import stretch_chart
from gtau.report.uncertainty import correlation_chart, correlation_of, singular_values_chart
from gtau.robots.parameter import torque_unit
from gtau.signals.run import Run
from gtau.uses.prediction import predict

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class Plots:
    """Figures of a result; each call returns a :class:`matplotlib.figure.Figure`.

    A run is given by its name among those of the result, as a :class:`gtau.Run`, or left out for the first. A result
    that was loaded from a file has no runs: give one of :func:`gtau.read_run`.
    """

    result: Result

    def __repr__(self) -> str:
        names = [name for name in dir(self) if not name.startswith("_") and name != "result"]
        return f"figures of {self.result.robot.name!r}: {', '.join(names)}"

    def gains(self, prior: Mapping[str, float] | None = None) -> Figure:
        """Draw drive gains with their 95 % intervals, in per cent of the gain, beside ``prior`` ones."""
        chart = gains_chart(self.result.drive_gains, prior or {})
        if chart is None:
            raise GtauError("the drive gains were given, so there are no intervals to plot; give prior gains.")
        return figure_of(chart)

    def torques(
        self, joint: str | None = None, run: str | Run | None = None, start: float = 0.0, stop: float | None = None
    ) -> Figure:
        """Plot measured and predicted torques and residuals of a joint or all of a run, ``start`` to ``stop`` in s."""
        evidence, joints = self._evidence(joint, run)
        assert evidence.prediction is not None
        end = seconds(evidence.run) if stop is None else stop
        if not start < end:
            raise GtauError(f"the stretch from {start:g} to {end:g} s is empty; give start below stop.")
        complete, prediction = start <= 0 and stop is None, evidence.prediction.of(joints)
        return figure_of(stretch_chart(self.result, evidence.run, prediction, start, end, complete))

    def residuals(self, joint: str, run: str | Run | None = None) -> Figure:
        """Draw a joint's residuals along a run, their histogram, spectrum and autocorrelation."""
        evidence, _ = self._evidence(joint, run)
        assert evidence.prediction is not None
        evidence = replace(evidence, prediction=evidence.prediction.in_band)
        robot = self.result.robot
        unit, values = torque_unit(robot, joint), evidence.residuals[:, robot.actuated.index(joint)]
        line = Series("", evidence.time, values, "residual", width=1.0)
        panels = residual_panels({joint: [(evidence.time, values)]}, {joint: unit})
        along = Panel(TIME, Axis(f"residual, {unit}"), (line,), height=2.0)
        return figure_of(Chart((along, *panels), f"{evidence.run.name}: {joint}", columns=2))

    def correlation(self) -> Figure:
        """Draw the correlation matrix of all estimates."""
        return figure_of(correlation_chart(*correlation_of(self.result)))

    def singular_values(self) -> Figure:
        """Draw the singular values of ``W_tot`` (eq. 33), with the gap before the smallest."""
        if not self.result.singular_values:
            raise GtauError(
                "this result has no singular values: its gains were given, or it was loaded from a file; identify the "
                "gains from the logs again."
            )
        return figure_of(singular_values_chart(np.array(self.result.singular_values)))

    def distances(self) -> Figure:
        """Draw distances to singular poses along the runs."""
        along = zip(self.result.data, self.result.distances, strict=False)
        panels = distances_panels((run.name, float(run.time[0]), distances) for run, distances in along)
        if not panels:
            raise GtauError("a result that was loaded from a file has no distances; identify from the logs again.")
        return figure_of(Chart(tuple(panels)))

    def robot(self) -> Figure:
        """Draw the robot at home."""
        from gtau.report.robot_figure import robot_figure

        return robot_figure(self.result.robot)

    def _evidence(self, joint: str | None, run: str | Run | None) -> tuple[RunEvidence, tuple[str, ...]]:
        joints = self.result.robot.actuated
        if joint is not None and joint not in joints:
            raise GtauError(f"there is no joint '{joint}'; choose from {', '.join(joints)}.")
        chosen = run if isinstance(run, Run) else self._run(run)
        return RunEvidence(chosen, True, predict(self.result, chosen)), joints if joint is None else (joint,)

    def _run(self, name: str | None) -> Run:
        runs = {run.name: run for run in self.result.data}
        if not runs:
            raise GtauError(
                "a result that was loaded from a file has no runs; give one, as in result.plot.torques(joint, "
                "gtau.read_run(...))."
            )
        if name is not None and name not in runs:
            raise GtauError(f"there is no run '{name}'; choose from {', '.join(runs)}.")
        return next(iter(runs.values())) if name is None else runs[name]
