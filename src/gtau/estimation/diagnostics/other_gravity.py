"""Fit the data without gravity, or with gravity along another axis than the robot file says.

An arm on a wall or a ceiling, or a tracker whose vertical is y, has gravity where the robot file has none. Parameters
adapt to that, so that a linear test points anywhere: the robot is fitted again with gravity along each axis of the
base, and from the best of them freely (Gauss-Newton over directions). Whether torques exclude gravity, as with a driver
that compensates it, is found in :mod:`gtau.estimation.diagnostics.effort`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import asin, atan2, hypot

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.refits import described_otherwise, residual_ratio
from gtau.estimation.effects.effect import EstimatedEffect, Levels
from gtau.estimation.effects.known.gravity import EFFECT as GRAVITY
from gtau.estimation.effects.known.gravity import gravity_changes
from gtau.estimation.effects.linearisation import linearise, on_channels, window_motion
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.least_squares import fit_by
from gtau.estimation.estimators.maximum_likelihood import ml_or_wls
from gtau.estimation.regression.run_blocks import PreparedRuns
from gtau.findings import Finding, Grade
from gtau.findings.words import percent
from gtau.progress import Progress, silent
from gtau.robots.parameter import BY_LOAD

REFUTED_SHARE = 0.05  # share of the residual variance that another gravity explains
GRAVITY_SHARE = 0.5  # share of the residual variance that gravity along another axis takes away
GRAVITY_LEAST = 5.0  # angle from the stated gravity, degrees, below which the linear test of a tilt speaks
GRAVITY_FELT = 0.06  # torque of gravity over the whole, rms, of the joint that feels it most: below, no test of gravity
UNFELT = 1e-6  # torque of gravity over the whole, rms, below which no motion changes the torque of gravity
GRAVITY_ALIKE = 1.05  # residual variance over the least of all axes, below which another one explains as much
OTHER_GRAVITY, WITHOUT_GRAVITY = "gravity", "torques without gravity"
STEPS = 4  # of Gauss-Newton, from an axis at most 55 degrees off


def likeliest_gravity(fit: Fit, missing: bool, turned: bool, progress: Progress = silent) -> EstimatedEffect | None:
    """Fit without gravity where that may be ``missing``, and with another one where it may be ``turned``.

    Returns the fit with less residual variance; where both are similar, only logged torques lack gravity. Raises
    GtauError where the data do not determine the gains.
    """
    windows = [window for _, window in fit.dataset.windows()]  # the middle of the runs bounds the time
    if not windows:
        return None
    middle = replace(fit.dataset, prepared=PreparedRuns(windows))  # type: ignore[arg-type]  # used as prepared runs
    unaltered = _with_gravity(
        replace(fit, system=replace(fit.system, dataset=middle)), np.array(fit.dataset.robot.gravity)
    )
    without = _without_gravity(fit, unaltered) if missing else None
    other = _other_gravity(fit, unaltered, progress) if turned else None
    if without is None or other is None:
        return without or other
    alike = 1 / GRAVITY_ALIKE if fit.dataset.runs[0].kind == "torque" else GRAVITY_ALIKE
    remaining, remaining_without = (effect.cause.values["remains"] for effect in (other, without))
    return other if remaining < alike * remaining_without else without


def _with_gravity(fit: Fit, gravity: np.ndarray) -> Fit:
    """Fit with another gravity; raises GtauError where the data do not determine the gains with it."""
    dataset = fit.dataset
    equations = dataset.equations
    if not np.array_equal(gravity, dataset.robot.gravity):
        equations = replace(equations, model=dataset.model.altered(gravity=tuple(gravity.tolist())), known=None)
    gains = None if fit.free_gains else fit.gains
    terms = tuple(term for term in fit.system.terms if term.kind not in BY_LOAD)
    other = replace(dataset, equations=equations, factors=()).reduced()
    return fit_by(ml_or_wls(gains), fit.system.again(other, terms), fit.free_gains)


def _without_gravity(fit: Fit, unaltered: Fit) -> EstimatedEffect | None:
    """Fit without gravity, for what that explains of each joint and how it moves the gains.

    None where that explains less than gravity does: a joint alone may fit as well without, as its other columns stand
    for its gravity.
    """
    other, n = _with_gravity(unaltered, np.zeros(3)), len(unaltered.gains)
    if residual_ratio(other, unaltered) > 1 - REFUTED_SHARE:
        return None
    ratio = (other.solution.sigma / unaltered.solution.sigma)[:n]
    most = max(np.sqrt(residual_ratio(other, unaltered)), ratio.min())
    return _described(fit, unaltered, other, most)


def _other_gravity(fit: Fit, unaltered: Fit, progress: Progress) -> EstimatedEffect | None:
    """Find the gravity of the same strength, along an axis or free, that explains most of the residuals, if any does.

    None where gravity is not seen, or lies within the few degrees that the linear test of a tilt covers.
    """
    declared = np.array(unaltered.dataset.robot.gravity)
    size = float(np.linalg.norm(declared))
    if not size:
        return None
    tried = []
    for k, axis in enumerate(np.vstack([np.eye(3), -np.eye(3)])):
        progress("gravity along other axes", k, 6)
        try:
            other = unaltered if _degrees(axis, declared) < GRAVITY_LEAST else _with_gravity(unaltered, size * axis)
        except GtauError:
            continue  # with it, the data do not determine the gains
        tried.append((residual_ratio(other, unaltered), other))
    progress("gravity along other axes", 6, 6)
    remaining, best = min([(1.0, unaltered), *tried], key=lambda other: other[0])
    alike = [other for rest, other in tried if rest <= GRAVITY_ALIKE * remaining]
    for better in _freely(best):
        if residual_ratio(better, unaltered) < (1 - REFUTED_SHARE) * remaining:
            remaining, best, alike = residual_ratio(better, unaltered), better, []
    gravity = np.array(best.dataset.robot.gravity)
    if 1 - remaining < GRAVITY_SHARE or _degrees(gravity, declared) < GRAVITY_LEAST:
        return None
    also = [list(other.dataset.robot.gravity) for other in alike if other is not best]
    return _described(fit, unaltered, best, np.sqrt(1 - GRAVITY_SHARE), also)


def _described(
    fit: Fit, unaltered: Fit, other: Fit, most: float, also: Sequence[Sequence[float]] = ()
) -> EstimatedEffect:
    """Describe a fit with another gravity, on the joints of whose residuals it leaves at ``most`` this ratio."""
    joints, before = unaltered.system.problem.joints, unaltered.solution.sigma
    shares, ratio = before / unaltered.system.problem.balance(unaltered.solution.theta), other.solution.sigma / before
    helped = [j for j in range(len(joints)) if ratio[j] <= most]
    unexplained = {joints[j]: [float(shares[j]), float(shares[j] * ratio[j])] for j in helped}
    rest = ""
    if unexplained:
        joint, (declared, after) = max(unexplained.items(), key=lambda entry: entry[1][0])
        rest = f", which leaves {100 * after:.2g} % of '{joint}' unexplained instead of {100 * declared:.2g} %,"
    gravity, floating = list(other.dataset.robot.gravity), bool(unaltered.dataset.robot.floating)
    values = {"gravity": gravity, "also": also, "left": unexplained, "remains": residual_ratio(other, unaltered)}
    if any(gravity):
        along = " or ".join(map(_direction, [gravity, *also]))
        text = f"gravity along {along} of the {'world' if floating else 'base'}{rest}"
        advice = gravity_advice(gravity, floating)
        cause = Finding(OTHER_GRAVITY, tuple(unexplained), values=values, text=text, advice=advice)
    else:
        text = f"torques without gravity, as from a driver that compensates it{rest}"
        cause = Finding(WITHOUT_GRAVITY, tuple(unexplained), values=values, text=text, advice=log_with_gravity())
    return described_otherwise(fit, GRAVITY.name, cause, other, unaltered)


def gravity_advice(gravity: Sequence[float], floating: bool) -> str:
    """Advise what to write in the robot file, or beside its name, for a robot with this gravity."""
    how = "how the world axes lie" if floating else "how the base is mounted"
    written = ", ".join(f"{round(component, 3) + 0.0:.4g}" for component in gravity)
    x, y, z = gravity
    roll = atan2(-y, -z) if round(hypot(y, z), 3) else 0.0
    rpy = f"{roll:.4g}, {asin(x / hypot(x, y, z)) + 0.0:.4g}, 0"
    turned = (
        "in axes of the logged poses, or turn the poses so that their z axis points up"
        if floating
        else f"or 'base: {{rpy: [{rpy}]}}' beside its 'file' in the experiment file"
    )
    return f"check {how}, and write 'gravity: [{written}]' in the robot file, {turned}"


def _direction(gravity: Sequence[float]) -> str:
    """Name an axis, or write a direction of unit length."""
    size = hypot(*gravity)
    unit = [round(component / size, 2) + 0.0 for component in gravity]
    along = [k for k in range(3) if unit[k]]
    if len(along) == 1:
        return f"{'-' if unit[along[0]] < 0 else '+'}{'xyz'[along[0]]}"
    return "({:.2g}, {:.2g}, {:.2g})".format(*unit)


def _freely(at: Fit) -> Iterator[Fit]:
    """Rotate gravity to the direction that the residuals favour."""
    windows = list(enumerate(at.dataset.prepared))
    for _ in range(STEPS):
        gravity = np.array(at.dataset.robot.gravity)
        if not gravity.any():
            return
        linear = linearise(at, windows, on_channels(GRAVITY.torques, GRAVITY.shared))  # type: ignore[arg-type]
        size = float(np.linalg.norm(gravity))
        turned = gravity + linear.fitted(slice(2))[0][-2:] @ gravity_changes(gravity)[:2]
        if not np.isfinite(turned).all() or np.allclose(turned, gravity, rtol=0, atol=1e-4 * size):
            return
        try:
            at = _with_gravity(at, size * turned / np.linalg.norm(turned))
        except GtauError:
            return
        yield at


def _degrees(one: np.ndarray, other: np.ndarray) -> float:
    cosine = one @ other / (np.linalg.norm(one) * np.linalg.norm(other))
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def gravity_not_shown(fit: Fit) -> Iterator[Finding]:
    """Find that gravity changes the torques too little to show whether they contain it.

    Its share is the ratio of rms gravity torque (about its mean) to rms total torque, of the joint that feels it most.
    """
    dataset, n = fit.dataset, len(fit.gains)
    gravity = np.array(dataset.robot.gravity)
    if not gravity.any():
        return
    model, regressor, torques = dataset.model, dataset.model.gravity_torques(dataset.base.standard), np.zeros(n)
    for run, window in dataset.windows():
        motion, parameters = window_motion(model, window), fit.system.motion(run, fit.solution.theta)
        along = regressor.torques(regressor(model.layout, motion, parameters), gravity, n)
        torques = np.maximum(torques, np.reshape(along, (n, -1)).std(axis=1))
    felt = float(np.max(torques / np.maximum(Levels(fit).torques, 1e-300)))
    if UNFELT <= felt < GRAVITY_FELT:
        kind = dataset.runs[0].kind
        # drivers of arms that compensate gravity report torques
        named = bool(dataset.robot.closures) or kind == "current"
        yield Finding(
            "torques without gravity, or a balanced robot",
            text=f"the data do not show whether the torques contain gravity ({percent(felt, '.1g')} of a joint's "
            "torque at most): it hardly varies along these motions, the robot is balanced, or a driver compensates it",
            advice=f"if a driver compensates it, {log_with_gravity(f'actual {kind}s' if named else '')}",
            grade=Grade.INFORMATION,
            shown_as="model",
        )


def log_with_gravity(signal: str = "") -> str:
    """Advise to log torques with gravity, or a ``signal`` that has it, or to describe the robot without."""
    signal = f"{signal} of the motors" if signal else "torques of the motors (UR: 'use_currents_as_efforts: true')"
    return (
        f"log the {signal}, or write 'robot: {{file: ..., gravity: [0, 0, 0]}}' in the experiment file for a model "
        "without gravity"
    )
