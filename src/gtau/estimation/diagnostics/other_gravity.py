"""Test whether gravity along another axis of the base, or none, explains the residuals.

An arm on a wall or a ceiling, or a tracker whose vertical is y, has gravity where the robot file has none: beyond the
few degrees of a base that is not level, parameters adapt, and a linear test of tilts points anywhere. So the robot is
fitted again with gravity along each axis of the base, and from the best of them freely (Gauss-Newton over directions).

Whether torques exclude gravity, as with a driver that compensates it, :mod:`gtau.estimation.diagnostics.effort` finds.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.alternatives import Alternative, established
from gtau.estimation.diagnostics.hypotheses.description import DEGREE, GRAVITY, OTHER_GRAVITY
from gtau.estimation.diagnostics.hypotheses.hypothesis import rms_torques, window_motion
from gtau.estimation.diagnostics.linearisation import (
    central_windows,
    known_rows,
    least_squares_step,
    linearise,
    on_channels,
    stack,
)
from gtau.estimation.diagnostics.parameter_checks import unexplained_shares
from gtau.estimation.estimators.estimator import Fit, Given
from gtau.estimation.estimators.least_squares import fit_by
from gtau.estimation.estimators.maximum_likelihood import ml_or_wls
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.friction import Friction
from gtau.estimation.thresholds.estimates import (
    GRAVITY_ALIKE,
    GRAVITY_LEAST,
    GRAVITY_MISFIT,
    GRAVITY_SHARE,
    REFUTED_SHARE,
)
from gtau.estimation.thresholds.logs import GRAVITY_FELT, UNFELT
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.model.base_parameters import base_parameters
from gtau.progress import Progress, silent
from gtau.signals.preparation import InMemoryRun

STEPS = 4  # of Gauss-Newton, from an axis at most 55 degrees off


def gravity_asked_for(fit: Fit, alternatives: Sequence[Alternative]) -> bool:
    """Decide whether another gravity is worth fitting (seconds per fit): a tilt helps, or the residual is large."""
    of_gravity = [each.share for each in alternatives if each.hypothesis == GRAVITY.name]
    misfit = float(unexplained_shares(fit.system.problem, fit.solution).max())
    return max(of_gravity, default=0.0) > REFUTED_SHARE or misfit > GRAVITY_MISFIT


def other_gravity(fit: Fit, progress: Progress = silent) -> Alternative | None:
    """Find the gravity of the same strength, along an axis or free, that explains most of the residuals, if any does.

    Nothing is found where gravity is not seen, nor within the few degrees of which the linear test speaks.
    """
    declared = np.array(fit.dataset.robot.gravity)
    size = float(np.linalg.norm(declared))
    windows = [window for _, window in central_windows(fit.dataset)]  # the middle of the runs bounds the time
    middle = replace(fit.dataset, prepared=tuple(windows))  # type: ignore[arg-type]  # used as prepared runs
    own = fitted(fit, middle, declared) if size and windows else None
    if own is None:
        return None
    found = []
    for k, axis in enumerate(np.vstack([np.eye(3), -np.eye(3)])):
        progress("gravity along other axes", k, 6)
        other = own if _degrees(axis, declared) < GRAVITY_LEAST else fitted(fit, own.dataset, size * axis)
        if other is not None:
            found.append((left_of(other, own), other))
    progress("gravity along other axes", 6, 6)
    left, best = min([(1.0, own), *found], key=lambda each: each[0])
    alike = [other for rest, other in found if rest <= GRAVITY_ALIKE * left]
    for better in _freely(fit, best, list(enumerate(windows))):
        if left_of(better, own) < (1 - REFUTED_SHARE) * left:
            left, best, alike = left_of(better, own), better, []
    gravity = np.array(best.dataset.robot.gravity)
    moves = np.zeros(len(fit.gains)) if not fit.free_gains else best.gains / own.gains - 1
    if 1 - left < GRAVITY_SHARE or _degrees(gravity, declared) < GRAVITY_LEAST:
        return None
    before, after = own.solution.sigma, best.solution.sigma
    shares = before / own.system.problem.balance(own.solution.theta)
    helped = [j for j in range(len(moves)) if after[j] ** 2 < (1 - GRAVITY_SHARE) * before[j] ** 2]
    joints = tuple(fit.system.problem.joints[j] for j in helped)
    values = {
        "gravity": gravity.tolist(),
        "also": [list(each.dataset.robot.gravity) for each in alike if each is not best],
        "left": {
            joint: [float(shares[j]), float(shares[j] * after[j] / before[j])]
            for joint, j in zip(joints, helped, strict=True)
        },
        "remains": left,
        "floating": bool(fit.dataset.robot.floating),
    }
    rows = own.system.problem.total_rows
    share = 1 - float(rows @ (after / before) ** 2 / rows.sum())
    return established(fit, GRAVITY.name, Finding(OTHER_GRAVITY.kind, joints, values=values), moves, share)


def fitted(fit: Fit, dataset: Dataset, gravity: np.ndarray) -> Fit | None:
    """Fit with another gravity; None where the data do not determine the gains with it."""
    model, base = dataset.model, dataset.base
    if not np.array_equal(gravity, dataset.robot.gravity):
        model = model.with_gravity(gravity)
        base = base_parameters(model, sensors=dataset.runs[0].sensed)
    friction, given = fit.system.friction, Given(None if fit.free_gains else fit.gains)
    friction = Friction(tuple(each for each in friction.terms if each.kind != "fl"), friction.per_run)
    try:
        other = replace(dataset, robot=model.robot, model=model, base=base, factors=()).reduced()
        system = other.system(friction, fit.system.problem.slowest > 0)
        return fit_by(ml_or_wls(given), other, system, given)
    except GtauError:
        return None


def _freely(fit: Fit, start: Fit, windows: Sequence[tuple[int, InMemoryRun]]) -> Iterator[Fit]:
    """Rotate gravity to the direction that the residuals favour."""
    at: Fit | None = start
    for _ in range(STEPS):
        if at is None or (candidates := GRAVITY.candidates(at)) is None:
            return
        e, J, offered = stack(linearise(at, on_channels(candidates.offer, GRAVITY.shared), windows))
        errors, known = known_rows(at, windows)
        wide = np.hstack([np.concatenate([J, known]), np.pad(offered[:, :2], ((0, len(known)), (0, 0)))])
        tilt = DEGREE * least_squares_step(wide, np.concatenate([e, errors]))[-2:]
        gravity = np.array(at.dataset.robot.gravity)
        size = float(np.linalg.norm(gravity))
        turned = gravity + size * tilt @ [each.finding.values["towards"] for each in candidates.columns[:2]]
        if not np.isfinite(turned).all() or np.allclose(turned, gravity, rtol=0, atol=1e-4 * size):
            return
        at = fitted(fit, at.dataset, size * turned / np.linalg.norm(turned))
        if at is not None:
            yield at


def left_of(fit: Fit, own: Fit) -> float:
    """Compute the residual variance relative to ``own``, the geometric mean over all channels (the likelihood's).

    So a single joint that feels gravity counts among many that do not.
    """
    rows = own.system.problem.total_rows
    return float(np.exp(2 * rows @ np.log(fit.solution.sigma / own.solution.sigma) / rows.sum()))


def _degrees(one: np.ndarray, other: np.ndarray) -> float:
    cosine = one @ other / (np.linalg.norm(one) * np.linalg.norm(other))
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)) / DEGREE)


def missing_gravity(fit: Fit) -> Alternative | None:
    """Fit without gravity, for what that explains of each joint and how it moves the gains; None where it cannot be."""
    windows = [window for _, window in central_windows(fit.dataset)]
    middle = replace(fit.dataset, prepared=tuple(windows))  # type: ignore[arg-type]  # used as prepared runs
    own, other = (fitted(fit, middle, gravity) for gravity in (np.array(fit.dataset.robot.gravity), np.zeros(3)))
    if own is None or other is None:
        return None
    n, before, after = len(fit.gains), own.solution.sigma, other.solution.sigma
    shares, ratio = before / own.system.problem.balance(own.solution.theta), after / before
    joints, left = fit.system.problem.joints, left_of(other, own)
    helped = [j for j in range(n) if ratio[j] <= max(np.sqrt(left), ratio[:n].min())]
    explained = {joints[j]: [float(shares[j]), float(shares[j] * ratio[j])] for j in helped}
    moves = other.gains / own.gains - 1 if fit.free_gains else np.zeros(n)
    rows = own.system.problem.total_rows
    cause = Finding(F.WITHOUT_GRAVITY, tuple(explained), values={"left": explained, "remains": left})
    return established(fit, GRAVITY.name, cause, moves, 1 - float(rows @ ratio**2 / rows.sum()))


def gravity_not_shown(fit: Fit) -> Iterator[Finding]:
    """Find that hardly any torque of a robot that gravity could move is due to it."""
    felt = float(gravity_shares(fit).max(initial=0.0))
    if UNFELT <= felt < GRAVITY_FELT:
        yield Finding(F.NO_GRAVITY_SHOWN, values={"felt": felt})


def likelier_gravity(fit: Fit, missing: Alternative | None, other: Alternative | None) -> Alternative | None:
    """Choose between no gravity and another one by residual variance; if similar, only logged torques lack it."""
    if missing is None or other is None:
        return missing or other
    alike = 1 / GRAVITY_ALIKE if fit.dataset.runs[0].kind == "torque" else GRAVITY_ALIKE
    left, without = (each.causes[0].values["remains"] for each in (other, missing))
    return other if left < alike * without else missing


def gravity_shares(fit: Fit) -> np.ndarray:
    """Compute the ratio of rms gravity torque (about its mean) to rms total torque of each joint, (n,)."""
    dataset, n = fit.dataset, len(fit.gains)
    gravity = np.array(dataset.robot.gravity)
    if not gravity.any():
        return np.zeros(n)
    regressor, found = dataset.model.gravity_torques(dataset.base.standard), np.zeros(n)
    for run, window in central_windows(dataset):
        entries = regressor(
            dataset.model.layout, window_motion(dataset.model, window), fit.system.motion(run, fit.solution.theta)
        )
        torques = np.reshape(regressor.torques(entries, gravity, n), (n, -1))
        found = np.maximum(found, torques.std(axis=1))
    return np.asarray(found / np.maximum(rms_torques(fit), 1e-300))
