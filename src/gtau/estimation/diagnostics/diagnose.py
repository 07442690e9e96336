"""Diagnose a fit: the findings of all checks, in the order in which they count, and verdicts from them.

A cross-validated torque says nothing about a wrong gain, as both sides of the equation carry it. The user needs the
possible error of a gain: its interval, with a random part and one from model deficits. It is good where the whole
interval lies within the required accuracy, and contradictory only where the data refute the description of robot and
logs and the gain would move by more than that.

Every scale of logged torques is proportional to the stated mass of the payload; but torques of different motors rarely
share one scale error, while a mistyped mass, or a gripper that was not weighed with its load, has that effect. Gains
and parameters also absorb part of a wrench of wrong sign, body or axes, and lengths or single currents look wrong
instead: so wherever wrenches are measured, the advice names them first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from gtau.estimation.diagnostics.examine import Examination
from gtau.estimation.diagnostics.gain_units import units_and_signs
from gtau.estimation.diagnostics.gains import (
    gains_without_value,
    impossible_parameters,
    judged_gains,
    payloads_in_noise,
    wide_gains,
)
from gtau.estimation.diagnostics.refutations import (
    all_negative,
    refuted_descriptions,
    refuted_with_given_gains,
    small_refutations,
)
from gtau.estimation.diagnostics.sensor_scales import sensor_contradictions, sensor_scales
from gtau.estimation.diagnostics.stated_values import contradictory_payload, contradictory_priors
from gtau.estimation.diagnostics.torques import (
    common_scale,
    logged_torques,
    unexplained_signals,
    wrench_contradictions,
)
from gtau.estimation.diagnostics.verdict import GIVEN, GOOD, decide, delay_verdicts, motors
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.problem import Estimates
from gtau.findings import Finding, Grade
from gtau.robots.parameter import Parameter

if TYPE_CHECKING:
    from gtau.estimation.diagnostics.inertia_audit import InertiaAudit


def diagnose(
    fit: Fit,
    examined: Examination,
    estimates: Estimates,
    payloads: Mapping[str, Finding],
    prior_gains: Mapping[str, float],
    accuracy: float,
    audit: InertiaAudit | None = None,
) -> tuple[Finding, ...]:
    """Collect what speaks against the estimates of a fit, what counts most first, and what else the user should know.

    ``payloads`` are verdicts on known payloads by name, ``prior_gains`` those expected, N m/A or N per A, by joint.
    ``accuracy`` is half the relative width of the 95 % interval up to which a gain is good, and ``audit`` what the data
    say of the inertias of the robot's file.
    """
    gains = judged_gains(fit, estimates) if fit.free_gains else []
    wrong = [verdict for verdict in payloads.values() if verdict.outcome == Grade.CONTRADICTORY]
    wrong.sort(key=lambda finding: -finding.size)
    findings = [*(wrench_contradictions(fit) if fit.dataset.robot.floating else ())]
    findings += payloads_in_noise(fit, gains)
    findings += examined.findings
    if fit.free_gains:
        findings += all_negative(fit, examined, gains, prior_gains)
        findings += refuted_descriptions(fit, examined, gains, accuracy)
        findings += unexplained_signals(fit, wrong)
        findings += [contradictory_payload(finding.subject, motors(fit)) for finding in wrong]
        findings += sensor_contradictions(sensor_scales(fit), fit.system.problem.joints, accuracy)
    else:
        findings += refuted_with_given_gains(fit, examined, wrong)
        findings += unexplained_signals(fit, wrong)
    findings += contradictory_priors(fit, examined, estimates, accuracy)
    # a gain without a value: what follows would judge that value
    findings += gains_without_value(fit, gains)
    findings += impossible_parameters(fit, estimates)
    # units and signs, which fit the data whatever they are
    findings += units_and_signs(fit, estimates, prior_gains, audit)
    findings += wide_gains(fit, examined, estimates, gains, accuracy)
    if audit is not None:
        from gtau.estimation.diagnostics.inertia_audit import prior_findings

        findings += prior_findings(audit)
    if fit.free_gains:
        findings += small_refutations(examined, gains, accuracy)
        findings += common_scale(fit, estimates, accuracy)
    return (*findings, *logged_torques(fit, examined, estimates))


def channel_verdicts(
    fit: Fit, estimates: Estimates, findings: Sequence[Finding], delayed: bool
) -> dict[Parameter, Finding]:
    """Judge the gains of the motors by findings on them, and the delays of all channels, where any is ``delayed``."""
    gains = decide(motors(fit), findings, GOOD if fit.free_gains else GIVEN)
    unknowns = estimates.unknowns
    std = np.sqrt(np.diag(estimates.random))[unknowns.delays]
    period = 1 / min(run.rate for run in fit.dataset.runs)
    delays = delay_verdicts(fit.system.problem, fit.solution, std, period) if delayed else [GOOD] * len(std)
    judged = dict(zip(unknowns[unknowns.delays], delays, strict=True))
    return {Parameter("gain", joint): verdict for joint, verdict in gains.items()} | judged
