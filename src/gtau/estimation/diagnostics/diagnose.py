"""Diagnose a fit: verdicts on gains and delays from the findings of all checks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from gtau.estimation.diagnostics.examine import Examination
from gtau.estimation.diagnostics.gain_checks import (
    common_scale,
    estimated_gains,
    given_gains,
    half_widths,
    impossible_parameters,
    logged_torques,
    wrench_contradictions,
)
from gtau.estimation.diagnostics.inertia_audit import InertiaAudit, prior_findings
from gtau.estimation.diagnostics.other_estimators import position_noise
from gtau.estimation.diagnostics.stated_constants import (
    SensorScale,
    prior_contradictions,
    sensor_contradictions,
    sensor_scales,
)
from gtau.estimation.diagnostics.unit_checks import units_and_signs, unlike_legs
from gtau.estimation.diagnostics.verdict import GIVEN, GOOD, OUTCOMES, Outcome, Verdict, decide, delay_verdicts, motors
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.problem import Estimates
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
    dataset, problem = fit.dataset, fit.system.problem
    sensors = sensor_scales(fit) if fit.free_gains else ()
    findings = [
        *wrench_contradictions(fit),
        *impossible_parameters(fit, estimates),
        *unlike_legs(dataset, problem, fit.solution.theta, estimates.covariance),
        *_wrong_priors(fit, estimates, accuracy),
        *(prior_findings(audit) if audit else ()),
        *units_and_signs(fit, estimates, prior_gains, audit),
        *position_noise(fit, examined.alternatives),
        *(examined.ripple.causes if examined.ripple else ()),
    ]
    if len(set(dataset.prepared.places[0].tolist())) < len(dataset.runs):  # some repeat a motion
        from gtau.estimation.diagnostics.repeating_residuals import repeated_motion_findings

        findings += repeated_motion_findings(fit, examined.alternatives)
    if fit.free_gains:
        findings += [
            *estimated_gains(fit, examined, estimates, accuracy, prior_gains),
            *sensor_contradictions(sensors, problem.joints, accuracy),
            *_wrong_payloads(fit, payloads),
            *_small_refutations(examined, accuracy),
            *common_scale(fit, estimates, accuracy),
        ]
    else:
        findings += given_gains(fit, examined, payloads)
    findings += [*logged_torques(fit, examined, estimates), *examined.findings]
    in_context = [_in_context(fit, finding) for finding in findings]
    against = [finding for finding in in_context if finding.kind in OUTCOMES]
    halves = half_widths(fit, estimates) if fit.free_gains else np.zeros(0)
    delay_std = np.sqrt(np.diag(estimates.random))[problem.unknowns.delays]
    period = 1 / min(run.rate for run in dataset.runs)
    return Diagnosis(
        dict(zip(motors(fit), decide(motors(fit), against, GOOD if fit.free_gains else GIVEN), strict=True)),
        delay_verdicts(problem, fit.solution, delay_std, period) if delay_std.any() else (GOOD,) * len(delay_std),
        payloads,
        tuple(replace(note, size=_moves(note, halves)) for note in in_context if note.kind not in OUTCOMES),
        accuracy,
        sensors,
    )


def _wrong_priors(fit: Fit, estimates: Estimates, accuracy: float) -> Iterator[Finding]:
    """Find contradictory priors; one on the mass of a floating robot is against all gains."""
    dataset = fit.dataset
    mass = whole_mass(dataset.base, dataset.model.parameter_names) if dataset.robot.floating else ""
    for finding in prior_contradictions(fit, estimates.covariance, accuracy):
        yield finding
        if finding.subject == mass:
            yield replace(finding, kind=F.WHOLE_MASS, joints=motors(fit))


def _wrong_payloads(fit: Fit, payloads: Mapping[str, Verdict]) -> Iterator[Finding]:
    for name, verdict in payloads.items():
        if verdict.finding is not None and verdict.outcome == Outcome.CONTRADICTORY:
            yield Finding(F.PAYLOAD, motors(fit), name, size=verdict.finding.size)


def _small_refutations(examined: Examination, accuracy: float) -> Iterator[Finding]:
    """Find the parts of the description that the data refute without moving any gain by more than the accuracy."""
    for part in examined.refuted:
        move = part.largest_move / 100
        if move <= accuracy:
            yield Finding(F.SMALL_REFUTATION, values={"share": part.share, "move": move}, causes=part.causes)


def _in_context(fit: Fit, finding: Finding) -> Finding:
    """Note in a finding whether there is a payload, or a wrench on a body or a floating base, for its advice."""
    wrenches = bool(fit.system.problem.wrenches or fit.system.problem.base)
    return replace(finding, values={"payload": bool(fit.system.payloads), "wrenches": wrenches, **finding.values})


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
