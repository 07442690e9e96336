"""Detect torque or 'effort' columns with other contents: shares of a rated value, motor-side or model torques.

Torques without gravity are found by :mod:`gtau.estimation.diagnostics.other_gravity`, late ones by ``log_checks``, and
magnitudes without sign are refused where logs are read.

Every scale of torques is proportional to the stated mass of the payload. Torques of different motors rarely share one
scale error; a mistyped mass, or a gripper that was not weighed with its load, has that effect.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from gtau.estimation.diagnostics.examine import Uncertainty
from gtau.estimation.diagnostics.finding import Finding
from gtau.estimation.diagnostics.finding import FindingKind as F
from gtau.estimation.diagnostics.gain_checks import half_widths
from gtau.estimation.diagnostics.hypotheses.hypothesis import friction_levels, rms_speeds, rms_torques
from gtau.estimation.diagnostics.parameter_checks import unexplained_shares
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.thresholds.estimates import APART
from gtau.estimation.thresholds.logs import ALIKE, FRICTIONLESS, GEARED, LIMIT_SHARE, MODEL_RESIDUAL, STEPS, WHOLE
from gtau.robots.parameter import Parameter
from gtau.robots.robot import Robot
from gtau.signals.run import Run
from gtau.signals.storage import block, spans


def doubtful_commands(runs: Sequence[Run], robot: Robot) -> Iterator[Finding]:
    """Find integer-valued commands, and torques far below all effort limits, in all ``runs``."""
    n, kind = len(runs[0].joints), runs[0].kind
    whole, values, peaks = 0, 0, np.zeros(n)
    for run in runs:
        for span in spans(len(run.time)):
            command = block(run.command, *span)[:, :n]
            whole, values = whole + int(np.sum(command == np.round(command))), values + command.size
            peaks = np.maximum(peaks, np.abs(command).max(axis=0))
    if whole > WHOLE * values and peaks.max() >= STEPS:  # stale samples were interpolated
        yield Finding(F.WHOLE_NUMBERS, values={"kind": kind, "largest": float(peaks.max())})
        return
    limits = {
        each.name: each.limits.effort for each in robot.joints if each.limits.effort and each.name in robot.motors
    }
    shares = {joint: peak / limits[joint] for joint, peak in zip(runs[0].joints, peaks, strict=True) if joint in limits}
    if kind != "torque" or len(set(limits.values())) < 2:  # the same for all joints is a placeholder
        return
    joint = max(shares, key=lambda name: shares[name])
    if shares[joint] < LIMIT_SHARE:
        yield Finding(F.MOTOR_SIDE, (joint,), values={"share": float(shares[joint]), "limit": limits[joint]})


def logged_torques(fit: Fit, uncertainty: Uncertainty) -> Iterator[Finding]:
    """Find motor-side torques, by their scale, and torques or currents computed by a model."""
    kind = fit.dataset.runs[0].kind
    yield from doubtful_commands(fit.dataset.runs, fit.dataset.robot)
    if fit.free_gains and kind == "torque":
        scales = np.abs(fit.gains)[half_widths(fit, uncertainty) < 1]
        if len(scales) and scales.min() > GEARED:
            yield Finding(F.MOTOR_SIDE, values={"least": float(scales.min()), "most": float(scales.max())})
    joints, known = fit.dataset.robot.motors, set(fit.system.problem.parameters)
    if any({f"fs_{joint}R", Parameter("fs", joint).name}.isdisjoint(known) for joint in joints):
        return
    rows = [fit.dataset.model.actuated.index(joint) for joint in joints]
    (fv, fs), torques = friction_levels(fit), rms_torques(fit)
    friction = ((fv * rms_speeds(fit) + fs) / np.maximum(torques, 1e-300))[rows].max()
    residual = unexplained_shares(fit.system.problem, fit.solution)[rows].max()
    if friction < FRICTIONLESS and residual < MODEL_RESIDUAL:
        values = {"kind": kind, "friction": float(friction), "residual": float(residual)}
        yield Finding(F.MODEL_TORQUES, values=values)


def common_scale(fit: Fit, uncertainty: Uncertainty, accuracy: float) -> Iterator[Finding]:
    """Find one factor, other than 1, that explains the torque scales of all joints which rest on one payload's mass."""
    from scipy.stats import chi2

    masses = {run.payload.name: run.payload.mass for run in fit.dataset.runs if run.payload}
    known = {name: mass for name, mass in masses.items() if mass is not None}
    judged = np.flatnonzero(half_widths(fit, uncertainty) < 1)
    if fit.dataset.runs[0].kind != "torque" or fit.system.problem.scaled or len(known) != 1 or len(judged) < 2:
        return
    rows = np.arange(fit.system.problem.n_theta, fit.system.problem.n_theta + len(fit.gains))[judged]
    gains, precision = fit.gains[judged], np.linalg.pinv(uncertainty.covariance[np.ix_(rows, rows)])
    variance = 1 / float(precision.sum())
    scale = variance * float(precision.sum(axis=0) @ gains)
    apart = float((gains - scale) @ precision @ (gains - scale))
    if chi2.sf(apart, len(judged) - 1) > ALIKE and abs(scale - 1) > max(APART * np.sqrt(variance), accuracy):
        ((name, mass),) = known.items()
        values = {"scale": scale, "std": np.sqrt(variance), "mass": mass / scale, "declared": mass}
        yield Finding(F.COMMON_SCALE, (), name, {key: float(each) for key, each in values.items()})
