"""Show results in notebooks: pages, and figures such as ``result.plot.torques("elbow_joint")``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gtau.documents.files import write_atomically
from gtau.documents.validation import Accepted, takes
from gtau.errors import GtauError, spelled
from gtau.estimation.check_logs import CheckedExperiment
from gtau.estimation.identify import EstimatorComparison
from gtau.estimation.results.estimate import Named
from gtau.estimation.results.payload_body import PayloadEstimate
from gtau.estimation.results.result import IdentifiedModel
from gtau.report import parameters
from gtau.report.chart import TIME, Axis, Chart, Panel, Series, colour
from gtau.report.charts import figure_of, robot_figure
from gtau.report.gains import (
    VALUE,
    comparison_page,
    gains_chart,
    gains_section,
    payloads_section,
    unknown_payloads,
    value_cells,
)
from gtau.report.html import frame, html as rendered, stamped
from gtau.report.identification import report_page, verdict_section
from gtau.report.logs import check_page, seconds, settings_of
from gtau.report.page import Column, Kind, Page, Section, Table, Text, joint_label
from gtau.report.robot import distances_panels
from gtau.report.torques import RunEvidence, gather, residual_panels, torques_chart
from gtau.robots.parameter import torque_unit
from gtau.robots.robot import Robot
from gtau.signals.run import Run
from gtau.uses.prediction import Prediction, predict, suited

if TYPE_CHECKING:
    from matplotlib.figure import Figure

GAINS: Accepted = ("gains by joint, such as {'left': 2.4}", (Mapping,))
SECTIONS = ("verdict", "notes", "logs", "joints")  # sections of a check in a notebook


def html(shown: object) -> str:
    """Write the page of an object as a frame for a notebook."""
    return frame(view(shown))


def write(result: IdentifiedModel, path: Path) -> None:
    """Write the report of a result and its runs to an HTML file."""
    report = report_page(result, gather(result, result.data), {})
    write_atomically(path, rendered(stamped(report, settings_of(result))))


def plot(shown: IdentifiedModel | Prediction | Run | Robot) -> Figure:
    """Draw a result (as ``result.plot()``), a prediction, the signals of a run, or a robot at home.

    Returns
    -------
    Figure
        Of Matplotlib; a notebook shows it, and ``savefig`` writes it.

    Raises
    ------
    GtauError
        For anything else.

    Examples
    --------
    >>> gtau.plot(gtau.load_robot("five-bar")).savefig("five-bar.png")
    """
    match shown:
        case IdentifiedModel():
            return Plots(shown)()
        case Prediction():
            return figure_of(_prediction_chart(shown))
        case Run():
            return figure_of(_run_chart(shown))
        case Robot():
            return robot_figure(shown)
    raise GtauError(
        f"an object of type {type(shown).__name__} has no figure; give a result, a prediction, a run or a robot."
    )


def _prediction_chart(prediction: Prediction) -> Chart:
    return torques_chart(prediction, "", prediction.time - prediction.time[0])


def _run_chart(run: Run) -> Chart:
    time, commands = run.time - run.time[0], run.command[:, : len(run.joints)]
    panels = []
    for values, label in ((run.position, "position, rad or m"), (commands, f"{run.kind}, {run.channels[0].unit}")):
        columns = enumerate(zip(run.joints, values.T, strict=True))
        lines = [Series(joint_label(joint), time, column, colour(k)) for k, (joint, column) in columns]
        panels.append(Panel(TIME, Axis(label), tuple(lines), height=2.0))
    return Chart(tuple(panels), run.name, live=True)


def view(shown: object) -> Page:
    """Make the page of an object."""
    match shown:
        case IdentifiedModel():
            payloads = payloads_section(unknown_payloads(shown))
            return Page("", verdict_section(shown), gains_section(shown, charts=False), payloads)
        case EstimatorComparison():
            return Page("", *comparison_page(shown).sections[:2])
        case PayloadEstimate():
            return Page("", payloads_section([shown]))
        case Named():
            ends = (Column("95 % interval", Kind.INTERVAL), Column("verdict", Kind.BADGE))
            rows = [(name, *value_cells(it), it.interval(), it.verdict.outcome.value) for name, it in shown.items()]
            return Page("", Section("", Table((Column("name", Kind.NAME), *VALUE, *ends), rows)))
        case Prediction():
            return Page("", Section("", _prediction_chart(shown)))
        case CheckedExperiment():
            return Page("", *(part for part in check_page(shown).sections if part.id in SECTIONS))
    return Page("", Section("", Text(repr(shown), style="command")))


@spelled()
@dataclass(frozen=True, eq=False, repr=False)
class Plots:
    """Figures of a result, as :class:`matplotlib.figure.Figure`, which a notebook shows and ``savefig`` writes.

    ``run`` is the name of a run of the result or a :class:`gtau.Run`; by default the first run. A result loaded from a
    file has no runs: pass one from :func:`gtau.read_run`.
    """

    result: IdentifiedModel

    def __repr__(self) -> str:
        names = [name for name in dir(self) if not name.startswith("_") and name != "result"]
        return f"figures of {self.result.robot.name!r}: {', '.join(names)}"

    def __call__(self, joint: None = None) -> Figure:
        """Draw the drive gains, and the torques of the joint that fits worst along the first run."""
        if joint is not None:
            raise GtauError(f"the overview takes no joint; did you mean plot.torques({joint!r})?")
        gains = gains_chart(self.result.drive_gains, {})
        worst = max(self.result.residuals, key=lambda error: error.relative, default=None)
        panels = () if gains is None else gains.panels
        if self.result.data and worst is not None:
            panels += self._torques(worst.joint, None).panels
        if not panels:
            raise GtauError("the drive gains were given, and there is no run; draw result.plot.torques(joint, run).")
        return figure_of(Chart(panels, self.result.robot.name))

    @takes(prior=GAINS)
    def gains(self, prior: Mapping[str, float] | None = None) -> Figure:
        """Draw drive gains with 95 % intervals and ``prior`` gains, in per cent of the gain."""
        joints = self.result.robot.actuated
        if unknown := next((joint for joint in prior or {} if joint not in joints), None):
            raise GtauError(f"there is no joint '{unknown}'; choose from {', '.join(joints)}.")
        chart = gains_chart(self.result.drive_gains, prior or {})
        if chart is None:
            raise GtauError("the drive gains were given, so there are no intervals to plot; give prior gains.")
        return figure_of(chart)

    def torques(
        self, joint: str | None = None, run: str | Run | None = None, start: float = 0.0, stop: float | None = None
    ) -> Figure:
        """Draw measured and predicted torques and residuals of one joint or all, from ``start`` to ``stop`` in s."""
        return figure_of(self._torques(joint, run, start, stop))

    def _torques(
        self, joint: str | None, run: str | Run | None, start: float = 0.0, stop: float | None = None
    ) -> Chart:
        evidence, prediction, joints = self._evidence(joint, run)
        end = seconds(evidence.run) if stop is None else stop
        if not start < end:
            raise GtauError(f"the stretch from {start:g} to {end:g} s is empty; give start below stop.")
        time, title = evidence.time, evidence.run.name
        if start > 0 or stop is not None:
            title += f", {start:.4g} to {end:.4g} s of {seconds(evidence.run):.4g} s"
        window = (time >= start) & (time <= end)
        return torques_chart(prediction.of(joints).part(window), evidence.run.kind, time[window], title=title)

    def friction(self, joint: str | None = None, run: str | Run | None = None) -> Figure:
        """Draw measured and predicted friction of one joint or all over the speed."""
        evidence, prediction, joints = self._evidence(joint, run)
        chart = parameters.friction_chart(self.result, [replace(evidence, prediction=prediction.rows)])
        shown = {joint_label(name) for name in joints}
        panels = tuple(panel for panel in chart.panels if panel.title in shown)
        return figure_of(replace(chart, panels=panels, columns=min(len(panels), 2)))

    def residuals(self, joint: str | None = None, run: str | Run | None = None) -> Figure:
        """Draw residuals of a joint, or of the one that fits worst, along a run, with histogram and spectrum."""
        joint = joint or max(self.result.residuals, key=lambda error: error.relative).joint
        evidence, prediction, _ = self._evidence(joint, run)
        evidence = replace(evidence, prediction=prediction.in_band)
        robot = self.result.robot
        unit, values = torque_unit(robot, joint), evidence.residuals[:, robot.actuated.index(joint)]
        line = Series("", evidence.time, values, "residual", width=1.0)
        panels = residual_panels({joint: [(evidence.time, values)]}, {joint: unit})
        along = Panel(TIME, Axis(f"residual, {unit}"), (line,), height=2.0)
        return figure_of(Chart((along, *panels), f"{evidence.run.name}: {joint}", columns=2))

    def effects(self) -> Figure:
        """Draw the effects that model and description lack, by how much each would move a gain, with intervals."""
        ranked = sorted(self.result.effects, key=lambda effect: -effect.largest_move)
        chart = parameters.effects_chart(ranked, self.result.kind)
        if chart is None:
            raise GtauError("no effect would move a gain, so there is nothing to draw.")
        return figure_of(chart)

    def correlation(self) -> Figure:
        """Draw the correlation matrix of all estimates."""
        return figure_of(parameters.correlation_chart(self.result))

    def singular_values(self) -> Figure:
        """Draw the singular values of ``W_tot`` (eq. 33), with the gap before the smallest."""
        if not self.result.singular_values:
            raise GtauError(
                "this result has no singular values: its gains were given, or it was loaded from a file; identify the "
                "gains from the logs again."
            )
        return figure_of(parameters.singular_values_chart(np.array(self.result.singular_values)))

    def distances(self) -> Figure:
        """Draw distances to singular poses along the runs."""
        along = zip(self.result.data, self.result.distances, strict=False)
        panels = distances_panels((run.name, float(run.time[0]), distances) for run, distances in along)
        if not panels:
            raise GtauError("a result that was loaded from a file has no distances; identify from the logs again.")
        return figure_of(Chart(tuple(panels), "Distance to singular poses"))

    def _evidence(self, joint: str | None, run: str | Run | None) -> tuple[RunEvidence, Prediction, tuple[str, ...]]:
        joints = self.result.robot.actuated
        if joint is not None and joint not in joints:
            raise GtauError(f"there is no joint '{joint}'; choose from {', '.join(joints)}.")
        named = run is None or (isinstance(run, str) and not Path(run).is_file())
        chosen = self._run(run) if named else suited(self.result, run)  # type: ignore[arg-type]
        prediction = predict(self.result, chosen)
        return RunEvidence(chosen, True, prediction), prediction, joints if joint is None else (joint,)

    def _run(self, name: str | None) -> Run:
        runs = {run.name: run for run in self.result.data}
        if not runs:
            raise GtauError(
                "a result that was loaded from a file has no runs; give one, run=gtau.read_run(log, "
                "result.recording.signals)."
            )
        if name is not None and name not in runs:
            raise GtauError(f"there is no run '{name}'; choose from {', '.join(runs)}.")
        return next(iter(runs.values())) if name is None else runs[name]
