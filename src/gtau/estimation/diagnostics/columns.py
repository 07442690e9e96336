"""Fit the same rows with other readings of the columns of joints, as :mod:`.descriptions` does with other loads.

- With torques reversed, one after the other: joints share the parameters of their links, so that one reversed torque
  contradicts the others. All reversed explain the same, with negative masses.
- With the torques of one joint in another unit, by the scale that the other joints give them.
- With the other sign of a joint's position, or of its current too, by the sign of its gain then; with its zero a
  quarter of a turn off, or the columns of two joints exchanged.
- With an angle measured from another link: a parallelogram holds the angle of a joint against the link before the
  preceding one, and its motor stands there. Fanuc, ABB and palletisers log ``J2 + J3`` as J3. The motor becomes a joint
  of its own, coupled to both.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.descriptions import (
    ALIKE,
    COLUMNS,
    LEFT,
    at_middle,
    described_otherwise,
    middle_windows,
    one_after_the_other,
    refitted,
    residual_ratio,
)
from gtau.estimation.effects.effect import EstimatedEffect, encoders
from gtau.estimation.effects.estimate import CLOSE
from gtau.estimation.effects.rows import weights_of
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.least_squares import fit_by
from gtau.estimation.estimators.maximum_likelihood import ml_or_wls
from gtau.estimation.estimators.newton import solve, stacked, whitening
from gtau.estimation.regression.dataset import reduce_runs
from gtau.estimation.regression.factors import KNOWN, MODEL, SIGNALS, delayed_signal
from gtau.findings import Finding, Progress, listed
from gtau.robots.robot import Coupling, Robot
from gtau.signals.preparation.prepared_run import SampleWindow

REVERSED_LEFT = 0.7  # part of the residual variance that is left with one torque reversed
SCALED_LEFT = 0.85  # the same with the torques of one joint in another unit
OTHER_UNIT = 1.5  # factor of torques, or the inverse, from which it is another unit
SCALES = np.logspace(-4, 4, 49)  # of a joint's gain, of which the likeliest is refined

REVERSED_CHANNELS = "reversed channels"


def reversed_torques(fit: Fit) -> EstimatedEffect | None:
    """Find the joints whose torques are reversed against the other joints; None where gains have their own signs."""
    if fit.free_gains:
        return None
    problem, unaltered = fit.problem, fit.unrefined

    def turned(joints: tuple[int, ...]) -> Fit:
        blocks = problem.blocks.copy()
        blocks[:, joints, :, SIGNALS] *= -1
        other = replace(problem, make_blocks=lambda: blocks)
        return replace(fit, system=replace(fit.system, problem=other), solution=fit.solve(other))

    n = len(problem.joints)
    joints, best = one_after_the_other(unaltered, turned, range(n), n // 2, REVERSED_LEFT)
    if not joints:
        return None
    names = tuple(problem.joints[j] for j in joints)
    text = f"reversed torques of {listed(names)}"
    advice = f"check the signs of the {fit.kind} and position columns of {listed(names)}"
    return described_otherwise(COLUMNS, Finding(REVERSED_CHANNELS, names, text=text, advice=advice), best, unaltered)


def scaled_torques(fit: Fit) -> EstimatedEffect | None:
    """Find the joint whose torques are in another unit than the others' torques; None where gains are estimated."""
    problem = fit.problem
    places = {joint: problem.joints.index(joint) for joint in fit.dataset.robot.motors}
    if fit.free_gains or not places:
        return None

    def freed(joint: str, scale: float) -> Fit:
        channels = list(problem.channels)
        for k, channel in enumerate(channels):
            if channel.joint != joint or not channel.kind.unknown_gain:
                channels[k] = replace(channel, kind=replace(channel.kind, calibration="given"))
        known = replace(problem, channels=tuple(channels), factored=problem.triangles, independent=problem.own_columns)
        values = fit.solution.values.copy()
        values[problem.unknowns.gains] *= np.where(known.unknown_gains, scale, 1.0)
        return replace(fit, solution=solve(known, values, problem.weights, free_gains=True))

    profiles = {joint: _scale_profile(fit, j) for joint, j in places.items()}
    least = min(loss for _, loss in profiles.values())
    likely = {joint: scale for joint, (scale, loss) in profiles.items() if loss < least + CLOSE}
    unaltered, fits = freed("", 1.0), {joint: freed(joint, scale) for joint, scale in likely.items()}
    best = min(fits.values(), key=lambda other: residual_ratio(other, unaltered))
    scales = [fit.gains[places[joint]] / other.gains[places[joint]] for joint, other in fits.items()]
    if residual_ratio(best, unaltered) >= SCALED_LEFT or any(1 / OTHER_UNIT < scale < OTHER_UNIT for scale in scales):
        return None
    times = (f"'{joint}' that are {float(f'{scale:.2g}'):g} times" for joint, scale in zip(fits, scales, strict=True))
    text = f"{fit.kind}s of {' or of '.join(times)} as large as the other joints' {fit.kind}s say"
    advice = f"check the unit of the {fit.kind}s of {listed(fits)}, and the gear ratio"
    return described_otherwise(COLUMNS, Finding(COLUMNS, tuple(fits), text=text, advice=advice), best, unaltered)


def _scale_profile(fit: Fit, j: int) -> tuple[float, float]:
    """Find the likeliest of ``SCALES`` of the gain of joint ``j``, and minus its log-likelihood.

    Errors ``y - X theta`` of the other channels and ``v - c (X_j theta + k)`` of this one, c = 1 / scale, are linear in
    theta for any c; in the eigenvectors of ``X_j^T X_j``, X being whitened, no c needs a solution of its own.
    """
    problem, weights = fit.problem, weights_of(fit)
    blocks = stacked(problem) * weights[:, None, None]
    X = blocks[..., MODEL] / fit.solution.gains[:, None, None]
    k = blocks[..., KNOWN] / fit.solution.gains[:, None]
    v = delayed_signal(blocks, fit.solution.delays)
    others = np.arange(len(X)) != j
    rest = np.concatenate([*X[others], problem.known[:, :-1]])
    y = np.append(v[others] - k[others], problem.known[:, -1])
    B = whitening(np.concatenate([rest, X[j]]))
    _, s, V = np.linalg.svd(X[j] @ B)
    B = B @ V.T
    shares = np.append(s**2, np.zeros(B.shape[1] - len(s)))
    c = 1 / SCALES[:, None]
    theta = ((y @ rest @ B) + c * (v[j] - c * k[j]) @ X[j] @ B) / (1 - shares + c**2 * shares) @ B.T
    factors = np.where(others, 1.0, c)[:, :, None]
    squares = np.sum((v - factors * (np.einsum("sk,npk->snp", theta, X) + k)) ** 2, axis=-1)
    losses = np.log(np.maximum(squares, 1e-300)) @ problem.total_rows / 2
    return float(SCALES[np.argmin(losses)]), float(losses.min())


def other_columns(fit: Fit, beside: bool, than: EstimatedEffect | None, progress: Progress) -> EstimatedEffect | None:
    """Find the joint whose columns have another sign or zero, or the two joints whose columns are exchanged.

    With effects ``beside`` them, or without where the user's description has impossible parameters. None where all
    leave more of the residuals than ``LEFT``, and ``than`` another description leaves.
    """
    if (unaltered := at_middle(fit)) is None:
        return None

    def read(order: np.ndarray, signs: np.ndarray, shift: np.ndarray) -> Fit | None:
        along = [_read_otherwise(at, order, signs, shift) for at in middle_windows(fit)]
        return refitted(unaltered, dataset=fit.dataset.reduced(along=along))

    tried = [(cause, partial(read, *reading)) for cause, *reading in _readings(fit)]
    most = max(LEFT, than.cause.values["remains"]) if than else LEFT
    return _likeliest(unaltered, tried, "other signs, zeros and orders of columns", progress, beside, most)


def _likeliest(
    unaltered: Fit,
    tried: Sequence[tuple[Finding, Callable[[], Fit | None]]],
    stage: str,
    progress: Progress,
    beside: bool = True,
    most: float = LEFT,
) -> EstimatedEffect | None:
    """Fit with other descriptions, and return the one that leaves least of the residuals, ``most`` of them at most.

    Of those that leave as much, mirror images, the one with the fewest negative gains.
    """
    fits = list[tuple[float, Finding, Fit]]()
    for number, (cause, described) in enumerate(tried):
        progress(stage, number, len(tried))
        with suppress(GtauError):  # its loops do not close
            if (other := described()) is not None:
                fits.append((residual_ratio(other, unaltered), cause, other))
    progress(stage, len(tried), len(tried))
    least = min((ratio for ratio, *_ in fits), default=1.0)
    if least >= most:
        return None
    alike = [(cause, other) for ratio, cause, other in fits if ratio <= ALIKE * least]
    cause, other = min(alike, key=lambda described: np.sum(described[1].gains < 0))
    return described_otherwise(COLUMNS, cause, other, unaltered, beside)


def _readings(fit: Fit) -> Iterator[tuple[Finding, np.ndarray, np.ndarray, np.ndarray]]:
    """List what columns may be otherwise: the order of joints, signs (2, n) of positions and commands, and shifts."""
    as_logged = np.arange(len(fit.dataset.model.actuated))
    unturned, unmoved = np.ones((2, len(as_logged))), np.zeros(len(as_logged))
    for joint, place in encoders(fit).items():
        chosen = (as_logged == place).astype(float)
        for alone in (True, False):
            columns = "the position" if alone else f"position and {fit.kind}"
            text = f"the other sign of {columns} of '{joint}'"
            advice = f"check the sign of {columns}, and the joint's axis in the robot file"
            turned = unturned - 2 * chosen * [[1], [0 if alone else 1]]
            yield Finding(COLUMNS, (joint,), text=text, advice=advice), as_logged, turned, unmoved
        for degrees in (90, -90, 180) if fit.dataset.robot.joint(joint).turns else ():
            text = f"an error of {degrees} deg in the zero of encoder '{joint}'"
            cause = Finding(COLUMNS, (joint,), text=text, advice="add it to the positions, or correct the zero")
            yield cause, as_logged, unturned, np.radians(degrees) * chosen
    for (one, first), (other, second) in combinations(encoders(fit).items(), 2):
        joints, order = (one, other), as_logged.copy()
        order[[first, second]] = second, first
        text = f"exchanged positions and {fit.kind}s of {listed(joints)}"
        cause = Finding(COLUMNS, joints, text=text, advice="check the order of the joints' columns")
        yield cause, order, unturned, unmoved


def _read_otherwise(at: SampleWindow, order: np.ndarray, signs: np.ndarray, shift: np.ndarray) -> SampleWindow:
    """Exchange and turn the joints' columns of a window, and shift its positions."""
    beyond = at.command.shape[1] - len(order)  # sensors and wrenches stay
    channels, turned = np.append(order, len(order) + np.arange(beyond)), np.append(signs[1], np.ones(beyond))
    moved = {name: getattr(at, name)[:, order] * signs[0] for name in ("q", "qd", "qdd")}
    moved |= {name: getattr(at, name)[:, channels] * turned for name in ("command", "command_d", "command_dd")}
    moved["q"] += shift
    return replace(at, usable=at.usable[:, channels[: at.usable.shape[1]]], part_of=None, **moved)


def angle_from_another_link(fit: Fit, progress: Progress) -> EstimatedEffect | None:
    """Find a joint whose angle is measured, and whose motor stands, as in a parallelogram."""
    gains, tried = None if fit.free_gains else fit.gains, []

    def described(robot: Robot) -> Fit:
        dataset = reduce_runs(robot, fit.dataset.runs, fit.dataset.preparation)
        return fit_by(ml_or_wls(gains), dataset.system(per_run=len(dataset.runs) > 1), fit.free_gains)

    for joint, before, robot in _with_parallelogram(fit.dataset.robot):
        beside = fit.dataset.robot.joint(before).antecedent
        text = f"an angle of '{joint}' that is measured from '{beside}', as with a parallelogram,"
        advice = (
            "log the angle between the links, or describe the parallelogram in the robot file, as the catalog's "
            f"'palletiser' does: the motor '{joint}' turns beside '{before}', and a rod moves the link"
        )
        tried.append((Finding(COLUMNS, (joint,), text=text, advice=advice), partial(described, robot)))
    return _likeliest(fit.unrefined, tried, "angles from other links", progress)


def _with_parallelogram(robot: Robot) -> Iterator[tuple[str, str, Robot]]:
    """Describe the robot with each motor standing beside the motor before it, where their axes are parallel."""
    joints = {joint.name: joint for joint in robot.joints}
    if robot.closures or robot.couplings:
        return
    for place, joint in enumerate(robot.joints):
        before = joints.get(joint.antecedent)
        if before is None or not (joint.actuated and before.actuated and joint.turns and before.turns):
            continue
        along = float(np.array(before.axis) @ np.array(joint.placement.rotation) @ np.array(joint.axis))
        if not np.isclose(abs(along), 1.0, rtol=0, atol=1e-6):
            continue
        link = replace(joint, name=f"{joint.name} link", actuated=False, parameters="inertial")
        motor = replace(before, name=joint.name, parameters="drive", limits=joint.limits, home=0.0)
        moved = {joint.name: link.name}
        others = [replace(other, antecedent=moved.get(other.antecedent, other.antecedent)) for other in robot.joints]
        others[place : place + 1] = [motor, link]
        sign = 1.0 if along > 0 else -1.0
        coupling = Coupling(link.name, ((joint.name, sign), (before.name, -sign)))
        tool = moved.get(robot.tool, robot.tool)
        yield joint.name, before.name, replace(robot, joints=tuple(others), couplings=(coupling,), named_tool=tool)
