"""Diagnose a fit: verdicts on gains and delays from the findings of all checks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from gtau.estimation.diagnostics.examine import Examination
from gtau.estimation.diagnostics.gain_checks import (
    common_scale,
    estimated_gains,
    given_gains,
    half_widths,
    impossible_parameters,
    in_context,
    logged_torques,
    motors,
    wrench_contradictions,
)
from gtau.estimation.diagnostics.inertia_audit import InertiaAudit, prior_findings
from gtau.estimation.diagnostics.other_estimators import position_noise
from gtau.estimation.diagnostics.parameter_checks import delay_verdicts, unlike_legs
from gtau.estimation.diagnostics.repeating_residuals import repeated_motion_findings, ripple_findings
from gtau.estimation.diagnostics.stated_constants import (
    SensorScale,
    prior_contradictions,
    sensor_contradictions,
    sensor_scales,
)
from gtau.estimation.diagnostics.unit_checks import units_and_signs
from gtau.estimation.diagnostics.verdict import GIVEN, GOOD, OUTCOMES, Outcome, Verdict, decide
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.unknowns import Estimates
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.model.base_parameters import whole_mass

WIDTH = 1.96  # standard deviations in half a 95 % interval


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Verdicts on gains, delays and known payloads, and notes on the findings.

    Of the drive ``gains`` by joint, the ``delays`` (c,), with those of torque sensors, and the ``payloads`` by name.
    ``accuracy`` is half the relative width of the 95 % interval up to which a gain is good; ``sensors`` are the scales
    of torque sensors from the other stated constants.
    """

    gains: Mapping[str, Verdict]
    delays: tuple[Verdict, ...]
    payloads: Mapping[str, Verdict]
    notes: tuple[Finding, ...]
    accuracy: float
    sensors: tuple[SensorScale, ...] = ()


def diagnose(
    fit: Fit,
    examined: Examination,
    estimates: Estimates,
    payloads: Mapping[str, Verdict],
    prior_gains: Mapping[str, float],
    accuracy: float,
    audit: InertiaAudit | None = None,
) -> Diagnosis:
    """Judge which estimates of a fit can be trusted.

    Parameters
    ----------
    fit, examined, estimates : Fit, Examination, Estimates
        What was estimated, what the data say against it, and how well it is known.
    payloads : mapping
        Verdicts on known payloads, by name.
    prior_gains : mapping
        Gains expected, N m/A or N/A, by joint; may be empty.
    accuracy : float
        Half the relative width of the 95 % interval up to which a gain is good.
    audit : InertiaAudit, optional
        What the data say of the inertias of the robot's file.
    """
    dataset, problem, joints = fit.dataset, fit.system.problem, motors(fit)
    sensors = sensor_scales(fit) if fit.free_gains else ()
    priors = prior_contradictions(fit, estimates.covariance, accuracy)
    mass = whole_mass(dataset.base, dataset.model.parameter_names) if dataset.robot.floating else ""
    impossible = tuple(impossible_parameters(fit, estimates))
    sizes = tuple(units_and_signs(fit, estimates, prior_gains, audit))
    against = [
        *wrench_contradictions(fit),
        *impossible,
        *(each for each in sizes if each.kind in OUTCOMES),
        *(replace(each, kind=F.WHOLE_MASS, joints=joints) for each in priors if each.subject == mass),
    ]
    if fit.free_gains:
        against += [
            *estimated_gains(fit, examined, estimates, accuracy, prior_gains),
            *sensor_contradictions(sensors, problem.joints, accuracy),
            *(
                Finding(F.PAYLOAD, joints, name, size=each.finding.size)
                for name, each in payloads.items()
                if each.finding is not None and each.outcome == Outcome.CONTRADICTORY
            ),
        ]
    else:
        against += given_gains(fit, examined, payloads)
    delay_std = np.sqrt(np.diag(estimates.random))[problem.unknowns.delays]
    period = 1 / min(run.rate for run in dataset.runs)
    delays = delay_verdicts(problem, fit.solution, delay_std, period) if delay_std.any() else (GOOD,) * len(delay_std)
    beside = [
        *unlike_legs(dataset, fit.system, fit.solution.theta, estimates.covariance),
        *priors,
        *prior_findings(audit),
        *(each for each in sizes if each.kind not in OUTCOMES),
        *position_noise(fit, examined.alternatives),
        *ripple_findings(examined.ripple, fit),
        *repeated_motion_findings(fit, examined.alternatives),
        *(_small_refutations(examined, accuracy) if fit.free_gains else []),
        *(common_scale(fit, estimates, accuracy) if fit.free_gains else []),
        *logged_torques(fit, examined, estimates),
        *examined.untested,
    ]
    halves = half_widths(fit, estimates) if fit.free_gains else np.zeros(0)
    beside = [replace(each, size=_moves(each, halves)) for each in beside]
    against, beside = ([in_context(fit, each) for each in found] for found in (against, beside))
    gains = dict(zip(joints, decide(joints, against, GOOD if fit.free_gains else GIVEN), strict=True))
    return Diagnosis(gains, tuple(delays), payloads, tuple(beside), accuracy, sensors)


def _small_refutations(examined: Examination, accuracy: float) -> list[Finding]:
    """List the parts of the description that the data refute without moving any gain by more than the accuracy."""
    moves = [(each, float(np.abs(each.moves).max())) for each in examined.refuted]
    return [
        Finding(F.SMALL_REFUTATION, values={"share": each.share, "move": move}, causes=each.causes)
        for each, move in moves
        if move <= accuracy
    ]


def _moves(finding: Finding, halves: np.ndarray) -> float:
    """Compute by how many half widths of its interval what is noted may move an estimate; 0 where that is not known."""
    values = finding.values
    if finding.kind == F.PRIOR:
        return float(abs(values["found"] - values["prior"]) / (WIDTH * np.hypot(values["std"], values["prior_std"])))
    if finding.kind == F.PRIOR_INERTIA:
        apart = [
            abs(value - stated) / (WIDTH * np.hypot(std, values["std"] * stated))
            for _, value, std, stated, _ in values["parameters"]
        ]
        return float(max(apart))
    if finding.kind == F.COMMON_SCALE:
        return float(abs(values["scale"] - 1) / (WIDTH * values["std"]))
    if finding.kind == F.POSITION_NOISE:
        return float(values["deviations"] / WIDTH)
    return float(abs(values.get("move") or 0.0) / halves.min()) if halves.size else 0.0
