"""Fit the data without gravity, with gravity along another axis than the robot file says, or with another clock.

An arm on a wall or a ceiling, or a tracker whose vertical is y, has gravity where the robot file has none. Parameters
adapt to that, so that a linear test points anywhere: the robot is fitted again with gravity along each axis of the
base, without it, as with a driver that compensates it, and from the best axis freely (Gauss-Newton over directions).

A clock that is s times too fast makes velocities s and accelerations s^2 times too large, and with them the inertial
torques against gravity. Beyond some ten per cent the torques are far from linear in it: the robot is fitted again.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import asin, atan2, hypot

import numpy as np

from gtau.estimation.diagnostics.descriptions import (
    ALIKE,
    LEFT,
    at_middle,
    described_otherwise,
    middle_windows,
    refitted,
    residual_ratio,
)
from gtau.estimation.effects.effect import EstimatedEffect, rms_torques, window_motion
from gtau.estimation.effects.known.gravity import EFFECT as GRAVITY, clock_words, gravity_changes
from gtau.estimation.effects.rows import fitted_sizes
from gtau.estimation.estimators.estimator import Fit
from gtau.findings import Finding, Grade, Progress, percent, silent
from gtau.robots.robot import Robot

REFUTED_SHARE = 0.05  # share of the residual variance that another gravity explains
GRAVITY_LEAST = 5.0  # angle from the stated gravity, degrees, below which the linear test of a tilt speaks
GRAVITY_FELT = 0.06  # torque of gravity over the whole, rms, of the joint that feels it most: below, no test of gravity
UNFELT = 1e-6  # torque of gravity over the whole, rms, below which no motion changes the torque of gravity
STEPS = 4  # of Gauss-Newton, from an axis at most 55 degrees off

FASTEST = 3.0  # times too fast, or too slow, at most: beyond, motions are implausible
CLOSE_ENOUGH = 0.005  # of the factor
EXPLAINED = 0.9  # share of the residual variance that another clock takes away: it explains all but the noise

OTHER_GRAVITY, WITHOUT_GRAVITY, OTHER_CLOCK = "gravity", "torques without gravity", "clock"


def likeliest_gravity(fit: Fit, missing: bool, turned: bool, progress: Progress = silent) -> EstimatedEffect | None:
    """Fit without gravity where that may be ``missing``, and with another one where it may be ``turned``.

    The one with less residual variance counts; where both are similar, only logged torques lack gravity. None where
    gravity as stated explains as much.
    """
    if (unaltered := at_middle(fit)) is None:
        return None
    best, alike, remaining = unaltered, list[Fit](), 1 - REFUTED_SHARE
    without = _with_gravity(unaltered, np.zeros(3)) if missing else None
    # a joint alone may fit as well without, as its other columns stand for its gravity: all of them count
    if without is not None and (ratio := residual_ratio(without, unaltered)) <= remaining:
        best, remaining = without, ratio / ALIKE if fit.kind == "torque" else ratio * ALIKE
    if turned:
        other, others = _other_gravity(unaltered, progress)
        if other is not unaltered and residual_ratio(other, unaltered) < remaining:
            best, alike = other, others
    return None if best is unaltered else _described(unaltered, best, alike)


def other_clock(fit: Fit, progress: Progress = silent) -> EstimatedEffect | None:
    """Fit again with velocities and accelerations of another clock; None where none explains nearly all."""
    from scipy.optimize import minimize_scalar

    if (unaltered := at_middle(fit)) is None:
        return None

    def slowed(factor: float) -> Fit | None:
        along = [replace(at, qd=at.qd / factor, qdd=at.qdd / factor**2, part_of=None) for at in middle_windows(fit)]
        return refitted(unaltered, dataset=fit.dataset.reduced(along=along))

    def remaining(log_factor: float) -> float:
        progress("another clock", 0, 1)
        other = slowed(np.exp(log_factor))
        return 0.0 if other is None else float(np.log(residual_ratio(other, unaltered)))

    end = np.log(FASTEST)
    found = minimize_scalar(remaining, bounds=(-end, end), options={"xatol": CLOSE_ENOUGH})
    if np.isclose(abs(found.x), end, atol=2 * CLOSE_ENOUGH):  # gravity that is not there at all looks ever slower
        return None
    factor, other = float(np.exp(found.x)), slowed(np.exp(found.x))
    if other is None or 1 - residual_ratio(other, unaltered) < EXPLAINED:
        return None
    text, advice = clock_words(fit, factor)
    cause = Finding(OTHER_CLOCK, values={"factor": factor}, text=text, advice=advice)
    # large effects of many kinds together imitate it too, but this one number leaves a tenth of the residuals
    return described_otherwise(GRAVITY.name, cause, other, unaltered, beside=False)


def _with_gravity(fit: Fit, gravity: np.ndarray) -> Fit | None:
    """Fit with another gravity; None where the data do not determine the gains with it."""
    model = fit.dataset.model.altered(gravity=tuple(gravity.tolist()))
    dataset = replace(fit.dataset, equations=replace(fit.dataset.equations, model=model, known=None))
    return refitted(fit, dataset=dataset.reduced(along=middle_windows(fit)))


def _other_gravity(unaltered: Fit, progress: Progress) -> tuple[Fit, list[Fit]]:
    """Find the gravity of the same strength, along an axis or free, that explains most, and others that are alike.

    The unaltered fit where gravity is not seen, or lies within the few degrees that the linear test of a tilt covers.
    """
    declared = np.array(unaltered.dataset.robot.gravity)
    size, tried = float(np.linalg.norm(declared)), [(1.0, unaltered)]
    for k, axis in enumerate(np.vstack([np.eye(3), -np.eye(3)])):
        progress("gravity along other axes", k, 6)
        other = unaltered if _degrees(axis, declared) < GRAVITY_LEAST else _with_gravity(unaltered, size * axis)
        if other is not None:
            tried.append((residual_ratio(other, unaltered), other))
    progress("gravity along other axes", 6, 6)
    remaining, best = min(tried, key=lambda other: other[0])
    alike = [other for ratio, other in tried[1:] if ratio <= ALIKE * remaining and other is not best]
    for better in _freely(best):
        if residual_ratio(better, unaltered) < (1 - REFUTED_SHARE) * remaining:
            remaining, best, alike = residual_ratio(better, unaltered), better, []
    turned = _degrees(np.array(best.dataset.robot.gravity), declared)
    return (unaltered, []) if remaining > LEFT or turned < GRAVITY_LEAST else (best, alike)


def _freely(at: Fit) -> Iterator[Fit]:
    """Rotate gravity to the direction that the residuals favour."""
    for _ in range(STEPS):
        gravity = np.array(at.dataset.robot.gravity)
        size = float(np.linalg.norm(gravity))
        turned = gravity + fitted_sizes(at, at.dataset.windows(), GRAVITY, 2) @ gravity_changes(gravity)[:2]
        if not np.isfinite(turned).all() or np.allclose(turned, gravity, rtol=0, atol=1e-4 * size):
            return
        better = _with_gravity(at, size * turned / np.linalg.norm(turned))
        if better is None:
            return
        at = better
        yield at


def _described(unaltered: Fit, other: Fit, alike: Sequence[Fit]) -> EstimatedEffect | None:
    """Describe a fit with another gravity, on the joints that it explains, or on the one that it explains best."""
    problem, joints, before = unaltered.problem, unaltered.problem.joints, unaltered.solution.sigma
    shares = before / problem.balance(unaltered.solution.theta)
    ratio = other.solution.sigma / before
    most = max(np.sqrt(LEFT), ratio[: len(joints)].min())
    unexplained = {
        joint: [float(share), float(share * remaining)]
        for joint, share, remaining in zip(joints, shares, ratio, strict=False)
        if remaining <= most
    }
    joint, (declared, after) = max(unexplained.items(), key=lambda entry: entry[1][0])
    rest = f", which leaves {100 * after:.2g} % of '{joint}' unexplained instead of {100 * declared:.2g} %,"
    gravity, *also = (list(described.dataset.robot.gravity) for described in (other, *alike))
    floating = bool(unaltered.dataset.robot.floating)
    values = {"gravity": gravity, "also": also, "left": unexplained}
    if any(gravity):
        along = " or ".join(map(_direction, [gravity, *also]))
        zero = "" if floating or also else _or_as_likely(unaltered.dataset.robot, np.array(gravity))
        text = f"gravity along {along} of the {'world' if floating else 'base'}{zero}{rest}"
        advice = gravity_advice(gravity, floating)
        cause = Finding(OTHER_GRAVITY, tuple(unexplained), values=values, text=text, advice=advice)
    else:
        text = f"torques without gravity, as from a driver that compensates it{rest}"
        cause = Finding(WITHOUT_GRAVITY, tuple(unexplained), values=values, text=text, advice=log_with_gravity())
    return described_otherwise(GRAVITY.name, cause, other, unaltered)


def _or_as_likely(robot: Robot, gravity: np.ndarray) -> str:
    """Say what else looks like another gravity: a zero of the joint that carries all others, or reversed axes."""
    first, declared = robot.joints[0], np.array(robot.gravity)
    alone = [joint for joint in robot.joints if joint.antecedent == first.antecedent] == [first]
    axis = np.array(first.placement.rotation) @ np.array(first.axis)
    level = np.allclose([_degrees(axis, along) for along in (gravity, declared)], 90, rtol=0, atol=2.5)
    if not (alone and level and first.turns and first.name in robot.motors) or robot.closures or robot.couplings:
        return ", or the axes of all joints reversed" if _degrees(-gravity, declared) < GRAVITY_LEAST else ""
    angle = np.copysign(_degrees(gravity, declared), np.cross(gravity, declared) @ axis)
    return f", or as likely an error of {angle:.3g} deg in the zero of encoder '{first.name}'"


def gravity_advice(gravity: Sequence[float], floating: bool) -> str:
    """Advise what to write in the robot file, or beside its name, for a robot with this gravity."""
    how = "how the world axes lie" if floating else "how the base is mounted"
    written = ", ".join(f"{round(component, 3) + 0.0:.4g}" for component in gravity)
    x, y, z = gravity
    roll = (atan2(-y, -z) if round(hypot(y, z), 3) else 0.0) + 0.0
    rpy = f"{roll:.4g}, {asin(x / hypot(x, y, z)) + 0.0:.4g}, 0"
    turned = f"or 'base: {{rpy: [{rpy}]}}' beside its 'file' in the experiment file"
    if floating:
        turned = "in axes of the logged poses, or turn the poses so that their z axis points up"
    return f"check {how}, and write 'gravity: [{written}]' in the robot file, {turned}"


def _direction(gravity: Sequence[float]) -> str:
    """Name an axis, or write a direction of unit length."""
    size = hypot(*gravity)
    unit = [round(component / size, 2) + 0.0 for component in gravity]
    along = [k for k in range(3) if unit[k]]
    if len(along) == 1:
        return f"{'-' if unit[along[0]] < 0 else '+'}{'xyz'[along[0]]}"
    return "({:.2g}, {:.2g}, {:.2g})".format(*unit)


def _degrees(one: np.ndarray, other: np.ndarray) -> float:
    cosine = one @ other / (np.linalg.norm(one) * np.linalg.norm(other))
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def gravity_not_shown(fit: Fit) -> Iterator[Finding]:
    """Find that gravity changes the torques too little to show whether they contain it.

    Its share is the ratio of rms gravity torque (about its mean) to rms total torque, of the joint that feels it most.
    """
    dataset, model, n = fit.dataset, fit.dataset.model, len(fit.gains)
    gravity = np.array(dataset.robot.gravity)
    if not gravity.any():
        return
    regressor = model.gravity_torques(dataset.base.standard)
    torques = np.zeros(n)
    for run, window in dataset.windows():
        motion = window_motion(model, window)
        parameters = fit.system.motion(run, fit.solution.theta)
        along = regressor.torques(regressor(model.layout, motion, parameters), gravity, n)
        torques = np.maximum(torques, np.reshape(along, (n, -1)).std(axis=1))
    felt = float(np.max(torques / np.maximum(rms_torques(fit), 1e-300)))
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
