"""The figures of a result, one call each: ``result.plot.torques("elbow_joint")``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.results.estimate import Prediction
from gtau.estimation.results.identified_model import IdentifiedModel
from gtau.estimation.results.prediction import predict
from gtau.report import result_figures
from gtau.report.figures import torques_figure
from gtau.robots.units import torque_unit
from gtau.signals.run import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class Plots:
    """Figures of a result; each call returns a :class:`matplotlib.figure.Figure`.

    A run is given by its name among those of the result, as a :class:`gtau.Run`, or left out for the first. A result
    that was loaded from a file has no runs: give one of :func:`gtau.read_run`.
    """

    result: IdentifiedModel

    def __repr__(self) -> str:
        names = [name for name in dir(self) if not name.startswith("_") and name != "result"]
        return f"figures of {self.result.robot.name!r}: {', '.join(names)}"

    def gains(self, prior: Mapping[str, float] | None = None) -> Figure:
        """Draw drive gains with their 95 % intervals, in per cent of the gain, beside ``prior`` ones."""
        return result_figures.gains_figure(self.result.drive_gains, prior or {})

    def torques(
        self, joint: str | None = None, run: str | Run | None = None, start: float = 0.0, stop: float | None = None
    ) -> Figure:
        """Plot measured and predicted torques and residuals of a joint or all of a run, ``start`` to ``stop`` in s."""
        run, prediction, joints = self._predicted(joint, run)
        units = [torque_unit(self.result.robot, name) for name in prediction.joints]
        chosen = [prediction.joints.index(name) for name in joints]
        part = Prediction(
            joints,
            prediction.time,
            *(array[:, chosen] for array in (prediction.predicted, prediction.measured)),
            *(array[:, chosen] for array in (prediction.keep, prediction.valid)),
        )
        origin = float(run.time[0])
        length = float(run.time[-1]) - origin
        stop = length if stop is None else stop
        if not start < stop:
            raise GtauError(f"the stretch from {start:g} to {stop:g} s is empty; give start below stop.")
        return torques_figure(part, [units[k] for k in chosen], start, stop, run.name, run.kind, origin, length)

    def residuals(self, joint: str, run: str | Run | None = None) -> Figure:
        """Draw histogram, spectrum and autocorrelation of a joint's residuals along a run."""
        run, prediction, (name,) = self._predicted(joint, run)
        j = prediction.joints.index(name)
        values = np.where(prediction.keep[:, j], prediction.measured[:, j] - prediction.predicted[:, j], np.nan)
        unit = torque_unit(self.result.robot, name)
        return result_figures.residuals_figure(prediction.time, values, f"{run.name}: {name}", unit)

    def correlation(self) -> Figure:
        """Draw the correlation matrix of all estimates."""
        return result_figures.correlation_figure(self.result.covariance, self.result.covariance_names)

    def singular_values(self) -> Figure:
        """Draw the singular values of ``W_tot`` (eq. 33), with the gap before the smallest."""
        if not self.result.singular_values:
            raise GtauError(
                "this result has no singular values: its gains were given, or it was loaded from a file; identify the "
                "gains from the logs again."
            )
        return result_figures.singular_values_figure(np.array(self.result.singular_values))

    def distances(self) -> Figure:
        """Draw distances to singular poses along the runs."""
        if not self.result.distances:
            raise GtauError("a result that was loaded from a file has no distances; identify from the logs again.")
        starts = {run.name: float(run.time[0]) for run in self.result.data}
        return result_figures.distances_figure(self.result.distances, starts)

    def robot(self) -> Figure:
        """Draw the robot at home."""
        from gtau.report.robot_figure import robot_figure

        return robot_figure(self.result.robot)

    def _predicted(self, joint: str | None, run: str | Run | None) -> tuple[Run, Prediction, tuple[str, ...]]:
        joints = self.result.robot.actuated
        if joint is not None and joint not in joints:
            raise GtauError(f"there is no joint '{joint}'; choose from {', '.join(joints)}.")
        chosen = run if isinstance(run, Run) else self._run(run)
        return chosen, predict(self.result, chosen), joints if joint is None else (joint,)

    def _run(self, name: str | None) -> Run:
        runs = {run.name: run for run in self.result.data}
        if not runs:
            raise GtauError(
                "a result that was loaded from a file has no runs; give one, as in "
                "result.plot.torques(joint, gtau.read_run(...))."
            )
        if name is not None and name not in runs:
            raise GtauError(f"there is no run '{name}'; choose from {', '.join(runs)}.")
        return next(iter(runs.values())) if name is None else runs[name]
