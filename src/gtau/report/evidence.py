"""What pages rest on: findings, and runs compared with the predictions of a model."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.results.estimate import TorqueError
from gtau.estimation.results.result import IdentifiedModel
from gtau.findings import Finding, Progress, by_severity, moment, silent
from gtau.report.html import Inputs
from gtau.report.page import Column, Kind, Section, Table, Text, joint_label
from gtau.signals.preparation.filters import Preparation
from gtau.signals.reading.experiment import Experiment, read_experiment
from gtau.signals.run import Run
from gtau.uses.prediction import Prediction, predict, torque_errors
from gtau.uses.weigh import undeclared_load

APART = 4  # most findings of one kind on different logs that are listed one by one
SHARES = {"accuracy": "accuracy, relative", "reduction_loss": "reduction loss, %"}  # names of statistics
LONGEST = 300_000  # samples; of longer runs only the beginning is predicted


def findings_section(notes: Sequence[Finding]) -> Section:
    """List findings, the worst first."""
    nothing = Text("Nothing in the logs was repaired or left out.")
    return Section("Findings", findings_table(notes) if notes else nothing, id="notes")


def findings_table(notes: Sequence[Finding]) -> Table:
    """Tabulate findings, the worst first."""
    rows = [
        (grade.value, note.source, _where(note), note.what, note.advice)
        for grade, members in by_severity(same_in_several(notes)).items()
        for note in members
    ]
    columns = (
        Column("grade", Kind.BADGE),
        Column("log or robot"),
        Column("where", wide=True),
        Column("what was found", Kind.SENTENCE),
        Column("what to do", Kind.SENTENCE),
    )
    return Table(columns, rows, listed=True)


def _where(note: Finding) -> str:
    """Describe joint, time and share of samples of a finding, as far as known."""
    share = None if note.share is None else f"{100 * note.share:.2g} % of the samples"
    time = None if note.time is None else moment(note.time, 4)
    return ", ".join(part for part in (note.joint and joint_label(note.joint), time, share) if part)


def same_in_several(notes: Sequence[Finding]) -> list[Finding]:
    """Merge equal findings on several logs, and findings of one kind on many logs into the worst, without time."""
    alike: dict[tuple[str, str], list[Finding]] = {}
    for note in notes:
        alike.setdefault((note.what, note.advice), []).append(note)
    groups: dict[tuple[str, ...], list[Finding]] = {}
    for same in alike.values():
        sources = ", ".join(dict.fromkeys(note.source for note in same if note.source))
        note = replace(same[0], source=sources, time=None) if len(same) > 1 else same[0]
        groups.setdefault((note.kind, note.joint, note.advice), []).append(note)
    merged = []
    for group in groups.values():
        on_logs = [note for note in group if note.source]
        if len(on_logs) > APART:
            worst = max(on_logs, key=lambda note: note.share or 0.0)
            merged.append(replace(worst, source=f"{worst.source} and {len(on_logs) - 1} more", time=None))
            group = [note for note in group if not note.source]
        merged += group
    return merged


@dataclass(frozen=True, eq=False)
class RunEvidence:
    """A run that the model was identified from (``used``) or not, and its prediction, or the reason for having none."""

    run: Run
    used: bool
    prediction: Prediction | None = None  # at the rows of the identification, behind its low-pass filter
    samples: Prediction | None = None  # at every sample, raw, if asked for
    errors: tuple[TorqueError, ...] = ()  # of each joint over all samples
    refusal: str = ""
    cut: bool = False  # only the beginning of the run is shown
    notes: tuple[Finding, ...] = ()  # undeclared load at the tool, and assumptions of the prediction

    @property
    def time(self) -> np.ndarray:
        """Instants of the prediction from the start of the run, (K,) in s."""
        assert self.prediction is not None
        return np.asarray(self.prediction.time - float(self.run.time[0]))

    @property
    def residuals(self) -> np.ndarray:
        """Measured minus predicted torques (K, n), NaN at masked samples (:class:`Prediction`, ``keep``)."""
        assert self.prediction is not None
        return np.where(self.prediction.keep, self.prediction.measured - self.prediction.predicted, np.nan)


def gather(
    result: IdentifiedModel, runs: Iterable[Run], validation: Iterable[Run] = (), progress: Progress = silent
) -> tuple[RunEvidence, ...]:
    """Predict the runs of an identification and of its validation; one that cannot be predicted gets a ``refusal``."""
    listed = [(run, True) for run in runs] + [(run, False) for run in validation]
    gathered = []
    for k, (run, used) in enumerate(listed):
        progress("report", k, len(listed))
        try:
            gathered.append(predicted(result, run, used, progress=progress))
        except GtauError as refusal:
            gathered.append(RunEvidence(run, used, refusal=str(refusal)))
    progress("report", len(listed), len(listed))
    return tuple(gathered)


def predicted(
    result: IdentifiedModel, run: Run, used: bool = False, whole: bool = False, progress: Progress = silent
) -> RunEvidence:
    """Predict a run, or its beginning unless ``whole``, and look for an undeclared load; raises GtauError."""
    cut = not whole and len(run.time) > LONGEST
    beginning: dict[str, Any] = {
        name: np.asarray(getattr(run, name)[:LONGEST]) for name in ("time", "position", "command", "valid")
    }
    prediction = predict(result, replace(run, **beginning) if cut else run)
    errors = torque_errors(prediction, result.robot, result.preparation.bandwidth)
    load = None if used or cut else undeclared_load(result, run, errors, progress)
    notes = (*((load,) if load else ()), *prediction.notes)
    return RunEvidence(run, used, prediction.rows, prediction if whole else None, errors, cut=cut, notes=notes)


def preparation_words(preparation: Preparation, digits: int = 3) -> tuple[str, str, str]:
    """Describe bandwidth of the motion, position filter and decimation."""
    decimator, cutoff = preparation.decimator, preparation.cutoff
    return f"{preparation.bandwidth:.{digits}g} Hz", _low_pass(cutoff, digits), f"{decimator.factor} ({decimator.kind})"


def _low_pass(cutoff: float | None, digits: int = 4) -> str:
    return "none" if cutoff is None else f"{cutoff:.{digits}g} Hz"


def settings_of(result: IdentifiedModel) -> dict[str, str]:
    """List the settings of an identification by name."""
    preparation = result.preparation
    bandwidth, low_pass, decimation = preparation_words(preparation, 4)
    return {
        "estimator": result.method,
        "bandwidth of the motion": bandwidth,
        "position filter": low_pass,
        "position filter of predictions": ", ".join(map(_low_pass, preparation.prediction_cutoffs)) or low_pass,
        "decimation": decimation,
        "rows masked below": f"{100 * preparation.speed_fraction:g} % of the rms speed",
        **{SHARES.get(name, name.replace("_", " ")): f"{value:.4g}" for name, value in result.statistics.items()},
    }


def inputs_of(path: Path, experiment: Experiment | None = None, runs: bool = True) -> Inputs:
    """List an experiment file, its robot file and its logs; without ``runs`` only the validation logs."""
    experiment = experiment or read_experiment(path)
    source = experiment.robot
    robot = Path(source if isinstance(source, str) else source.file)
    listed: Sequence = (*(experiment.runs if runs else ()), *experiment.validation)
    logs = tuple(("log", log) for run in listed for log in run.log)
    return (("experiment", path), *((("robot", robot),) if robot.exists() else ()), *logs)
