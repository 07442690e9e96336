"""Checks of the logged torques, currents and wrenches: what the model leaves unexplained, and what they are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from gtau.estimation.diagnostics.examine import Examination
from gtau.estimation.diagnostics.gain_units import BEYOND_GEARS
from gtau.estimation.diagnostics.log_checks import doubtful_commands, motor_side_torques
from gtau.estimation.diagnostics.stated_values import MISFIT_GIVEN, contradictory_payload
from gtau.estimation.diagnostics.verdict import (
    APART,
    NEGATIVE_STD,
    WIDTH,
    WRENCHES,
    contradiction,
    half_widths,
    motors,
    unexplained_shares,
    wrenches_first,
)
from gtau.estimation.effects.effect import Levels
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.maximum_likelihood import MISFIT
from gtau.estimation.regression.problem import Estimates
from gtau.findings import Finding
from gtau.findings.words import percent
from gtau.model.base_parameters import whole_mass
from gtau.robots.parameter import Parameter

BASE_MISFIT = 0.15  # share of the forces, or of the moments, on a floating base that is unexplained
ALIKE = 0.05  # probability that the torque scales of joints which share one differ by as much
FRICTIONLESS = 0.02  # friction over torque, rms, of the joint with most of it: below, torques come from a model
MODEL_RESIDUAL = 0.02  # unexplained share of the joint with most of it, below which torques come from a model
GEARED = 5.0  # least torque scale of the joints, from which torques are measured before the gears

UNEXPLAINED, MODEL_TORQUES = "unexplained current", "torques of a model"


def wrench_contradictions(fit: Fit) -> Iterator[Finding]:
    """Find, against all gains, a negative mass of a floating robot, and an unexplained wrench on its base."""
    base, problem = fit.dataset.robot.floating, fit.system.problem
    name = whole_mass(fit.dataset.base, fit.dataset.model.parameter_names)
    if name in problem.parameters:
        k = problem.parameters.index(name)
        mass, std = float(fit.solution.theta[k]), float(np.sqrt(fit.solution.covariance[k, k]))
        if mass < -NEGATIVE_STD * std:
            text = f"the wrenches imply a robot mass of {mass:.3g} kg"
            advice = "log the forces exerted on the body, not by it, or reverse their signs"
            yield contradiction("negative mass", motors(fit), text, advice, name)
    for part, share in sorted(base_misfit(fit).items(), key=lambda item: -item[1]):
        if share > BASE_MISFIT:
            text = f"the model leaves {percent(share, '.0f')} of the {part} on the base '{base}' unexplained"
            yield contradiction("unexplained base wrench", motors(fit), text, WRENCHES, str(base))


def base_misfit(fit: Fit) -> dict[str, float]:
    """Compute the unexplained shares (rms) of the forces and moments on a floating base, empty for a fixed one.

    They are shares of everything measured together, wrenches on bodies included; of forces and moments in three
    directions each, as a single component may be small. Where all are small, they are shares of a third of the model's
    terms.
    """
    problem, theta = fit.system.problem, fit.solution.theta
    rows = problem.base
    residual, measured = fit.solution.sigma[rows] ** 2, problem.balance(theta)[rows] ** 2
    terms = problem.largest_terms(theta)[rows] ** 2
    parts = {"forces": slice(0, 3), "moments": slice(3, 6)} if len(rows) else {}
    # on a base at rest, hung at its centre of mass, the measured moment is noise alone
    return {
        part: float(np.sqrt(residual[axes].sum() / max(measured[axes].sum(), terms[axes].sum() / 9, 1e-300)))
        for part, axes in parts.items()
    }


def unexplained_signals(fit: Fit, wrong: Sequence[Finding]) -> Iterator[Finding]:
    """Find joints of whose current or torque the model leaves too much unexplained.

    Where gains are given and a wrong value of a payload (``wrong``: findings) leaves a joint unexplained, that is named
    instead.
    """
    problem, kind, free = fit.system.problem, fit.dataset.runs[0].kind, fit.free_gains
    advice = f"check the position and {kind} columns, their signs and units, the clock of the log, and 'preparation'"
    if free and len(problem.known) and not fit.system.payloads:
        advice = (
            "check the known parameters, on which the scale rests ('priors', 'prior_inertias' and the inertias in the "
            "robot's file), then the columns, their signs and units"
        )
    elif free:
        advice = (
            "check that the position and current columns are of the same joint in all runs, and check their signs and "
            "units"
        )
    payloads = {joint: finding.subject for finding in reversed(wrong) for joint in finding.joints}
    shares = unexplained_shares(problem, fit.solution).tolist()
    for joint, channel, share in zip(problem.joints, problem.channels, shares, strict=False):
        if share <= (MISFIT if free else MISFIT_GIVEN) or (free and not channel.kind.measures_joint):
            continue
        if joint in payloads and not free:
            yield contradictory_payload(payloads[joint], (joint,), given=True)
        else:
            text = f"the model leaves {percent(share, '.0f')} of the joint's {kind} unexplained"
            yield contradiction(UNEXPLAINED, (joint,), text, wrenches_first(fit, advice))


def common_scale(fit: Fit, estimates: Estimates, accuracy: float) -> Iterator[Finding]:
    """Find one factor, other than 1, that explains the torque scales of all joints which rest on one payload's mass."""
    from scipy.stats import chi2

    masses = {run.payload.name: run.payload.mass for run in fit.dataset.runs if run.payload}
    known = {name: mass for name, mass in masses.items() if mass is not None}
    judged = np.flatnonzero(half_widths(fit, estimates) < 1)
    if fit.dataset.runs[0].kind != "torque" or fit.system.problem.scaled or len(known) != 1 or len(judged) < 2:
        return
    rows = fit.system.problem.gain_rows
    covariance = estimates.covariance[rows, rows][np.ix_(judged, judged)]
    gains, precision = fit.gains[judged], np.linalg.pinv(covariance)
    variance = 1 / float(precision.sum())
    scale, std = variance * float(precision.sum(axis=0) @ gains), float(np.sqrt(variance))
    apart = float((gains - scale) @ precision @ (gains - scale))
    if chi2.sf(apart, len(judged) - 1) > ALIKE and abs(scale - 1) > max(APART * std, accuracy):
        ((name, mass),) = known.items()
        yield Finding(
            "common torque scale",
            subject=name,
            size=abs(scale - 1) / (WIDTH * std),
            text=f"one factor, {scale:.3g} (standard deviation {std:.2g}), explains the torque scale of all joints; a "
            f"mass of {mass / scale:.3g} kg for payload '{name}' (stated: {mass:.4g} kg) would explain it equally",
            advice="reweigh the payload before you correct the torques",
            shown_as="model",
        )


def logged_torques(fit: Fit, examined: Examination, estimates: Estimates) -> Iterator[Finding]:
    """Find shares of rated values, motor-side torques, or torques and currents of a model: the first that holds."""
    kind, scales = fit.dataset.runs[0].kind, np.zeros(0)
    if doubtful := list(doubtful_commands(fit.dataset.runs, fit.dataset.robot)):
        yield doubtful[0]
        return
    if kind == "torque" and fit.free_gains:
        scales = np.abs(fit.gains)[half_widths(fit, estimates) < 1]
    elif kind == "torque" and examined.effort.scale is not None:
        share, std = examined.effort.scale
        scales = 1 / np.maximum([abs(share) + 2 * std, abs(share) - 2 * std], 1e-300)
    if len(scales) and scales.min() > GEARED and scales.max() < BEYOND_GEARS:
        ends = " to ".join(dict.fromkeys(f"{end:.3g}" for end in (scales.min(), scales.max())))
        yield motor_side_torques(f"the true torques are {ends} times those logged")
        return
    joints, known = fit.dataset.robot.motors, set(fit.system.problem.parameters)
    if any({name := Parameter("fs", joint), name + "R"}.isdisjoint(known) for joint in joints):
        return
    rows = [fit.dataset.model.actuated.index(joint) for joint in joints]
    levels = Levels(fit)
    (fv, fs), torques = levels.friction, levels.torques
    friction = float(((fv * levels.speeds + fs) / np.maximum(torques, 1e-300))[rows].max())
    residual = float(unexplained_shares(fit.system.problem, fit.solution)[rows].max())
    if friction < FRICTIONLESS and residual < MODEL_RESIDUAL:
        yield Finding(
            MODEL_TORQUES,
            text=f"the {kind}s have next to no friction ({percent(friction, '.1g')} of a joint's torque at most) and "
            f"{percent(residual)} is unexplained: they come from a model in the controller, not from the motors",
            advice="log measured currents or torques (UR: actual_current, not target_current or target_moment)",
            shown_as="model",
        )
