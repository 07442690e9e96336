"""Whether a log can be of this robot: its motion against the limits of the robot's joints."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gtau.errors import GtauError
from gtau.robots.robot import Joint, Robot
from gtau.signals.preparation import PreparedRun
from gtau.signals.storage import block, spans

BEYOND = 0.02  # of a joint's range outside its limits, which a user may want to know
FAR_BEYOND = 1.0  # and so much that it is another unit, another joint or another robot
TOO_FAST = 3.0  # rms speed in limits of speed, which no controller lets pass


def within_limits(robot: Robot, prepared: PreparedRun) -> PreparedRun:
    """The run, with a note on every joint that leaves its limits.

    Raises
    ------
    GtauError
        Where a joint leaves them by more than its whole range, or is faster all the time than it can be.
    """
    position = prepared.run.position
    extremes = [
        (each.min(axis=0), each.max(axis=0)) for each in (block(position, *span) for span in spans(len(position)))
    ]
    lowest, highest = np.min([low for low, _ in extremes], axis=0), np.max([high for _, high in extremes], axis=0)
    speeds = np.sqrt(np.diag(prepared.speeds))
    notes: list[str] = []
    for name, low, high, speed in zip(prepared.run.joints, lowest, highest, speeds, strict=True):
        notes += _judge(prepared.run.name, robot.joint(name), float(low), float(high), float(speed))
    return replace(prepared, notes=(*prepared.notes, *notes))


def _judge(run: str, joint: Joint, low: float, high: float, speed: float) -> Iterator[str]:
    unit = "rad" if joint.kind == "revolute" else "m"
    other = "deg" if joint.kind == "revolute" else "mm"
    repair = (
        f"if the log is in {other} say so under 'units', else check the columns and the time, or correct the limits in "
        "the robot file."
    )
    if joint.limits.position is not None:
        lower, upper = joint.limits.position
        moved = f"joint '{joint.name}' goes from {low:.4g} to {high:.4g} {unit}"
        limits = f"its limits {lower:.4g} to {upper:.4g} {unit}"
        excess = max(lower - low, high - upper) / (upper - lower)
        if excess > FAR_BEYOND:
            raise GtauError(f"run '{run}': {moved}, far outside {limits}; {repair}")
        if excess > BEYOND:
            yield f"{moved}, outside {limits}"
    if joint.limits.velocity is not None and speed > TOO_FAST * joint.limits.velocity:
        raise GtauError(
            f"run '{run}': joint '{joint.name}' moves at {speed:.4g} {unit}/s (rms), "
            f"{speed / joint.limits.velocity:.3g} times its limit of {joint.limits.velocity:.4g} {unit}/s; {repair}"
        )
