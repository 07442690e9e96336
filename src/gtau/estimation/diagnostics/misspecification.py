"""What in the robot's description, if it were otherwise, would explain the errors: its lengths, and gravity.

A wrong length or direction of gravity leaves errors that hang together with the motion, as unmodelled friction does;
the size of the errors does not tell the two apart, their shape does. So the robot is fitted again with each length a
little longer and a little shorter: where one is wrong, a parabola through what the three leave says how much of the
errors would go, and at which length. (All parameters are fitted anew each time: with a wrong length they are wrong too,
and what the length does to the torques, computed with them, is not the shape of the errors.) Torques are linear in
gravity: what it changes is offered to the fit as three further columns.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.linearisation import central_windows, least_squares_step, linearise, nothing, stack
from gtau.estimation.diagnostics.plausibility import other_clock
from gtau.estimation.estimators.solution import Solution
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.rows import Rows, stream_rows
from gtau.estimation.regression.system import System
from gtau.estimation.thresholds import (
    CLOCK_REVERSED,
    CLOCK_SHARE,
    CLOCK_SIZE,
    GRAVITY_SHARE,
    LENGTH_CHANGE,
    LENGTH_SHARE,
)
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.progress import Progress, silent
from gtau.robots.robot import Attachment, Mdh, Placement, Robot
from gtau.signals.preparation import InMemoryRun

STEP = 0.01  # relative change of a length, and of gravity
SHORT = 0.02  # lengths below this share of the longest are not tried
SAME = 1e-6  # relative difference of lengths that are meant to be the same
NEARLY = 0.8  # of the largest share: lengths that explain as much count as alike
MOST = 12  # lengths that are tried, the longest first


@dataclass(frozen=True)
class Misspecification:
    """What may be wrong, the ``share`` of the errors' variance that it explains, and a length's relative ``change``.

    ``decisive`` says that it is the reason of what other checks find.
    """

    why: str
    advice: str
    share: float
    change: float = 0.0
    decisive: bool = False


def find_misspecification(
    dataset: Dataset, system: System, solution: Solution, progress: Progress = silent
) -> Misspecification | None:
    """What explains much of the errors, of several lengths the one that is least wrong; None where nothing does."""
    found = [
        each
        for each in _explained(dataset, system, solution, progress)
        if each.share > GRAVITY_SHARE or (each.share > LENGTH_SHARE and abs(each.change) > LENGTH_CHANGE)
    ]
    most = max((each.share for each in found), default=0.0)
    likely = (each for each in found if each.share > NEARLY * most)
    return min(likely, key=lambda each: abs(each.change), default=None)


def _explained(dataset: Dataset, system: System, solution: Solution, progress: Progress) -> Iterator[Misspecification]:
    yield _gravity(dataset, system, solution)
    before = _left(dataset, system, solution, dataset.model)
    lengths = list(zip(_longer(dataset.robot, STEP), _longer(dataset.robot, -STEP), strict=True))
    for k, ((what, longer), (_, shorter)) in enumerate(lengths):
        progress("other lengths", k, len(lengths))
        try:
            above, below = (_left(dataset, system, solution, InverseDynamics(each)) for each in (longer, shorter))
        except GtauError:
            continue  # the robot cannot be assembled or follow its motion with another length
        slope, curvature = (above - below) / 2, (above + below) / 2 - before
        if curvature <= 0:
            continue
        share, change = slope**2 / (4 * curvature * before), -STEP * slope / (2 * curvature)
        why = (
            f"{_goes(share)} other lengths, such as {what} {100 * abs(change):.2g} % "
            f"{'longer' if change > 0 else 'shorter'}"
        )
        yield Misspecification(why, "check the robot's geometry", share, change)
    progress("other lengths", len(lengths), len(lengths))


def _gravity(dataset: Dataset, system: System, solution: Solution) -> Misspecification:
    robot, n = dataset.robot, len(dataset.model.actuated)
    size, own = STEP * float(np.linalg.norm(robot.gravity)), dataset.model.columns(dataset.base.standard)
    others = [replace(robot, gravity=tuple(np.array(robot.gravity) + size * row)) for row in np.eye(3)]
    models = [(model, model.columns(dataset.base.standard)) for model in map(InverseDynamics, others)]

    def changes(piece: InMemoryRun, values: np.ndarray, rows: Iterator[Rows]) -> Iterator[tuple[Rows, np.ndarray]]:
        decimator = dataset.preparation.at(piece.run.rate).decimator
        moved = [stream_rows(model, regressor, piece, decimator) for model, regressor in models]
        for part, *parts in zip(rows, *moved, strict=True):
            before = own.torques(part.entries, values, n)
            torques = [regressor.torques(p.entries, values, n) for p, (_, regressor) in zip(parts, models, strict=True)]
            yield part, np.stack(torques, axis=-1) - before[..., None]

    e, J, columns = stack(linearise(dataset, system, solution, True, changes, central_windows(dataset)))
    own_way = columns @ np.array(robot.gravity)[:, None] / np.linalg.norm(robot.gravity)
    before = float(np.sum((e + J @ least_squares_step(J, e)) ** 2))
    step, of_size = (least_squares_step(np.hstack([J, more]), e) for more in (columns, own_way))
    share, size_share = (
        1 - float(np.sum((e + np.hstack([J, more]) @ found) ** 2)) / before
        for more, found in ((columns, step), (own_way, of_size))
    )
    x, y, z = np.array(robot.gravity) + size * step[-3:]
    factor = 1 + STEP * float(of_size[-1])
    reversed_ = bool(np.any(solution.gains < 0))  # as where gravity points up
    if size_share > CLOCK_SIZE * share and factor > CLOCK_REVERSED and not reversed_:
        why, advice = other_clock(factor, dataset.runs)
        return Misspecification(f"{_goes(share)} another clock: {why}", advice, share, decisive=share > CLOCK_SHARE)
    return Misspecification(
        f"{_goes(share)} another gravity, about ({x:.1f}, {y:.1f}, {z:.1f}) m/s2",
        "check the direction of gravity, the sampling rate, which runs carry the payload, and on which body",
        share,
    )


def _left(dataset: Dataset, system: System, solution: Solution, model: InverseDynamics) -> float:
    """Squares of the errors that a fit of another ``model`` leaves."""
    e, J, _ = stack(linearise(dataset, system, solution, True, nothing, central_windows(dataset), model))
    return float(np.sum((e + J @ least_squares_step(J, e)) ** 2))


def _goes(share: float) -> str:
    return f"{100 * share:.0f} % of the errors' variance would go with"


def _longer(robot: Robot, step: float) -> Iterator[tuple[str, Robot]]:
    """The robot with each of its lengths longer by a share ``step``, those that are the same together."""
    places = [(joint.name, joint.placement) for joint in robot.joints]
    sides = [(end.body, end.placement) for closure in robot.closures for end in (closure.a, closure.b)]
    lengths: dict[float, list[str]] = {}
    for name, placement in places + sides:
        for length in _lengths(placement):
            same = next((known for known in lengths if abs(known - length) < SAME * known), length)
            if name not in lengths.setdefault(same, []):
                lengths[same].append(name)
    longest = sorted((length for length in lengths if length > SHORT * max(lengths)), reverse=True)[:MOST]
    for length in longest:
        joints = tuple(replace(joint, placement=_scaled(joint.placement, length, step)) for joint in robot.joints)
        closures = tuple(
            replace(closure, a=_moved(closure.a, length, step), b=_moved(closure.b, length, step))
            for closure in robot.closures
        )
        names = ", ".join(f"'{name}'" for name in lengths[length])
        yield f"the length of {1e3 * length:.4g} mm at {names}", replace(robot, joints=joints, closures=closures)


def _lengths(placement: Placement) -> list[float]:
    found = (
        [abs(placement.d), abs(placement.r), abs(placement.b)]
        if isinstance(placement, Mdh)
        else [float(np.linalg.norm(placement.xyz))]
    )
    return [length for length in found if length > 0]


def _moved(end: Attachment, length: float, step: float) -> Attachment:
    return replace(end, placement=_scaled(end.placement, length, step))


def _scaled(placement: Placement, length: float, step: float) -> Placement:
    """The placement with its lengths of this size longer by a share ``step``."""
    if isinstance(placement, Mdh):
        values = {name: getattr(placement, name) for name in ("d", "r", "b")}
        return replace(
            placement, **{k: v * (1 + step) for k, v in values.items() if abs(abs(v) - length) < SAME * length}
        )
    if abs(float(np.linalg.norm(placement.xyz)) - length) < SAME * length:
        x, y, z = placement.xyz
        return replace(placement, xyz=(x * (1 + step), y * (1 + step), z * (1 + step)))
    return placement
