"""Test whether another length of the robot explains the residuals.

A wrong length leaves residuals that depend on the motion, as unmodelled friction does; the two differ in shape, not in
size. The robot is fitted again with each length a little longer and a little shorter: a parabola through the three sums
of squares gives the length that fits best, and the share of the residual variance that goes with it. (All parameters
are fitted anew each time: with a wrong length they are wrong too, so that torques computed with them do not have the
shape of the residuals.)
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TypeVar

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.alternatives import Alternative, established
from gtau.estimation.diagnostics.linearisation import (
    Windows,
    central_windows,
    known_rows,
    least_squares_step,
    linearise,
    stack,
)
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.thresholds.logs import LENGTH_ALIKE, LENGTH_CHANGE, LENGTH_MOST, LENGTH_SHARE, LENGTH_TRIED
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.findings.words import RELATIVE
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.lengths import SAME, models_alike
from gtau.progress import Progress, silent
from gtau.robots.robot import Attachment, Closure, Mdh, Placement, Robot, Spring

Tie = TypeVar("Tie", Closure, Spring)

STEP = 0.01  # relative change of a length
MOST = 12  # lengths that are tried, the longest first: the effort of the search


def other_length(fit: Fit, progress: Progress = silent) -> Alternative | None:
    """Find the length that explains most of the residuals, of similar ones that with the smallest change; or None."""
    found = list(_explaining(fit, progress))
    most = max((each.share for each in found), default=0.0)
    likely = (each for each in found if each.share > LENGTH_ALIKE * most)
    return min(likely, key=lambda each: abs(each.size), default=None)


def _explaining(fit: Fit, progress: Progress) -> Iterator[Alternative]:
    """Try all lengths, and iterate over those that explain a part of the residuals."""
    robot = fit.dataset.robot
    windows = central_windows(fit.dataset)
    longer, shorter = list(_longer(robot, STEP)), list(_longer(robot, -STEP))
    if not longer:
        return
    before, _ = _left(fit, windows, fit.dataset.model)
    models = models_alike([other for _, other in (*longer, *shorter)], fit.dataset.base.standard)
    lengths = list(zip((cause for cause, _ in longer), models, models[len(longer) :], strict=False))
    for k, (cause, *pair) in enumerate(lengths):
        progress("other lengths", k, len(lengths))
        try:
            (above, gains_above), (below, gains_below) = (_left(fit, windows, model) for model in pair)
        except GtauError:
            continue  # the robot cannot be assembled or follow its motion with another length
        slope, curvature = (above - below) / 2, (above + below) / 2 - before
        if curvature <= 0:
            continue
        change = -STEP * slope / (2 * curvature)
        share = slope**2 / (4 * curvature * before)
        if share <= LENGTH_SHARE or not LENGTH_CHANGE < abs(change) < LENGTH_MOST:
            continue
        moves = (gains_above - gains_below) / (2 * STEP) * change / fit.gains
        yield established(fit, "lengths", cause, moves, share, change, unit=RELATIVE)
    progress("other lengths", len(lengths), len(lengths))


def _left(fit: Fit, windows: Windows, model: InverseDynamics) -> tuple[float, np.ndarray]:
    """Fit another ``model`` to first order: sum of its squared residuals, and its gains (n,)."""
    e, J, _ = stack(linearise(fit, None, windows, model))
    errors, known = known_rows(fit, windows)
    e, J = np.concatenate([e, errors]), np.concatenate([J, known])
    step, gains = least_squares_step(J, e), fit.gains
    change = step[fit.system.problem.gain_rows] if fit.free_gains else np.zeros(len(gains))
    return float(np.sum((e + J @ step) ** 2)), gains - gains**2 * change


def _longer(robot: Robot, step: float) -> Iterator[tuple[Finding, Robot]]:
    """Lengthen each length of the robot by a share ``step``, those that are equal together."""
    places = [(joint.name, joint.placement) for joint in robot.joints]
    sides = [(end.body, end.placement) for end in robot.ends]
    lengths: dict[float, list[str]] = {}
    for name, placement in places + sides:
        for length in _lengths(placement):
            same = next((known for known in lengths if abs(known - length) < SAME * known), length)
            if name not in lengths.setdefault(same, []):
                lengths[same].append(name)
    longest = sorted((length for length in lengths if length > LENGTH_TRIED * max(lengths)), reverse=True)[:MOST]
    for length in longest:
        joints = tuple(replace(joint, placement=_scaled(joint.placement, length, step)) for joint in robot.joints)
        closures, springs = _moved(robot.closures, length, step), _moved(robot.springs, length, step)
        longer = replace(robot, joints=joints, closures=closures, springs=springs)
        yield Finding(F.LENGTH, values={"length": length, "bodies": lengths[length]}), longer


def _lengths(placement: Placement) -> list[float]:
    found = (
        [abs(placement.d), abs(placement.r), abs(placement.b)]
        if isinstance(placement, Mdh)
        else [float(np.linalg.norm(placement.xyz))]
    )
    return [length for length in found if length > 0]


def _moved(ties: tuple[Tie, ...], length: float, step: float) -> tuple[Tie, ...]:
    """Place the ends of closures or springs at lengths longer by a share ``step``."""

    def moved(end: Attachment) -> Attachment:
        return replace(end, placement=_scaled(end.placement, length, step))

    return tuple(replace(tie, a=moved(tie.a), b=moved(tie.b)) for tie in ties)


def _scaled(placement: Placement, length: float, step: float) -> Placement:
    """Lengthen the lengths of this size in a placement by a share ``step``."""
    if isinstance(placement, Mdh):
        values = {name: getattr(placement, name) for name in ("d", "r", "b")}
        return replace(
            placement, **{k: v * (1 + step) for k, v in values.items() if abs(abs(v) - length) < SAME * length}
        )
    if abs(float(np.linalg.norm(placement.xyz)) - length) < SAME * length:
        x, y, z = placement.xyz
        return replace(placement, xyz=(x * (1 + step), y * (1 + step), z * (1 + step)))
    return placement
