"""What the pages show of a result: the one place that reads results, runs and predictions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.verdict import Outcome
from gtau.estimation.results.estimate import Estimate, Prediction, TorqueError
from gtau.estimation.results.prediction import torque_errors
from gtau.estimation.results.result import Result
from gtau.progress import Progress, silent
from gtau.robots.robot import Robot
from gtau.robots.units import torque_unit
from gtau.signals.run import Run
from gtau.signals.storage import rows_at

LONGEST = 300_000  # samples of a run that are predicted; of a longer one its beginning
POSES = 1500  # of a run, in the path of the payload's body
GOOD_OUTCOMES = (Outcome.GOOD, Outcome.GIVEN)


@dataclass(frozen=True, eq=False)
class RunEvidence:
    """A run beside what the model predicts of it; ``refusal`` says why nothing is predicted."""

    run: Run
    used: bool
    prediction: Prediction | None
    errors: tuple[TorqueError, ...] = ()
    refusal: str = ""
    cut: bool = False  # whether the run is longer than what is shown

    @property
    def payload(self) -> str:
        """What the run carries, in words."""
        return payload_words(self.run)

    @property
    def time(self) -> np.ndarray:
        """Instants of the prediction from the start of the run, (K,) in s."""
        assert self.prediction is not None
        return np.asarray(self.prediction.time - float(self.run.time[0]))


@dataclass(frozen=True, eq=False)
class Evidence:
    """A result with the runs that it came from, those kept for validation, and what was expected of it."""

    result: Result
    runs: tuple[RunEvidence, ...] = ()
    prior_gains: Mapping[str, float] = field(default_factory=dict)

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self.result.robot

    @property
    def joints(self) -> tuple[str, ...]:
        """Actuated joints in the order of the result."""
        return self.robot.actuated

    @property
    def units(self) -> list[str]:
        """Unit of each joint's torque or force."""
        return [torque_unit(self.robot, joint) for joint in self.joints]

    @cached_property
    def correlation(self) -> tuple[tuple[str, ...], np.ndarray]:
        """Names and correlations (m, m) of all estimates that have a variance."""
        covariance = self.result.covariance
        std = np.sqrt(np.clip(np.diag(covariance), 0.0, None))
        known = np.flatnonzero(std > 0)
        names = tuple(self.result.covariance_names[k] for k in known)
        part = covariance[np.ix_(known, known)] / np.outer(std[known], std[known])
        return names, np.clip(part, -1.0, 1.0)

    def residuals(self, joint: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """Yield of each run used times (K,), s, and residuals (K,) of a joint, NaN where they are masked."""
        found = []
        for each in self.runs:
            if each.used and each.prediction is not None:
                prediction = each.prediction
                rest = prediction.measured[:, joint] - prediction.predicted[:, joint]
                found.append((each.time, np.where(prediction.keep[:, joint], rest, np.nan)))
        return found


def payload_words(run: Run) -> str:
    """Describe in words what a run carries."""
    if run.payload is None:
        return "no payload"
    mass = "of unknown mass" if run.payload.mass is None else f"of {run.payload.mass:g} kg"
    return f"payload '{run.payload.name}' {mass}"


def gather(
    result: Result,
    runs: Iterable[Run],
    validation: Iterable[Run] = (),
    prior_gains: Mapping[str, float] | None = None,
    progress: Progress = silent,
) -> Evidence:
    """Predict the runs that a result was identified from, and those kept for validation.

    A run that the model cannot predict is listed with the reason.
    """
    listed = [(run, True) for run in runs] + [(run, False) for run in validation]
    found = []
    for k, (run, used) in enumerate(listed):
        progress("report", k, len(listed))
        found.append(_predicted(result, run, used))
    progress("report", len(listed), len(listed))
    return Evidence(result, tuple(found), dict(prior_gains or {}))


def settings_of(result: Result) -> dict[str, str]:
    """List the settings of an identification by name."""
    preparation = result.preparation
    cutoff = preparation.cutoff
    return {
        "estimator": result.method,
        "bandwidth of the motion": f"{preparation.bandwidth:.4g} Hz",
        "position filter": "none" if cutoff is None else f"{cutoff:.4g} Hz",
        "decimation": f"{preparation.decimator.factor} ({preparation.decimator.kind})",
        "rows masked below": f"{100 * preparation.speed_fraction:g} % of the rms speed",
        **{name.replace("_", " "): f"{value:.4g}" for name, value in result.statistics.items()},
    }


def _predicted(result: Result, run: Run, used: bool) -> RunEvidence:
    cut = len(run.time) > LONGEST
    shown = _beginning(run) if cut else run
    try:
        prediction = result.predict(shown)
    except GtauError as refusal:
        return RunEvidence(run, used, None, refusal=str(refusal), cut=cut)
    return RunEvidence(run, used, prediction, torque_errors(result, prediction), cut=cut)


def _beginning(run: Run) -> Run:
    time, position, command, valid = (
        np.asarray(each[:LONGEST]) for each in (run.time, run.position, run.command, run.valid)
    )
    return replace(run, time=time, position=position, command=command, valid=valid)


def interval_parts(gain: Estimate) -> tuple[tuple[float, float] | None, tuple[float, float] | None]:
    """Compute the 95 % interval of an estimate, and its random part alone where a model part is known too."""
    whole = gain.interval()
    if whole is None or not gain.model_std or gain.value is None or not gain.std:
        return whole, None
    half = (whole[1] - whole[0]) / 2 * (gain.random_std or 0.0) / gain.std
    return whole, (gain.value - half, gain.value + half)


def body_path(result: Result, run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Compute times (P,), s, from the start of a run, and positions (P, 3), m, of the body that carries the payload."""
    import casadi as ca

    from gtau.model.kinematics import frames
    from gtau.signals.run import arrange

    model = result.model
    run = arrange(run, model.actuated)
    shown = np.arange(0, len(run.time), -(-len(run.time) // POSES))
    c = model.path(np.ascontiguousarray(rows_at(run.position, shown).T))
    symbol = ca.SX.sym("c", model.layout.n_c)
    place = ca.Function("p", [symbol], [frames(model.layout, symbol)[result.robot.tool].p_0])
    return rows_at(run.time, shown) - run.time[0], np.asarray(place(c)).T
