"""Whether a log can be of this robot: its motion against the limits of the robot's joints."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gtau.errors import GtauError
from gtau.robots.geometry import characteristic_length
from gtau.robots.robot import Joint, Robot
from gtau.signals.columns import SampleRate
from gtau.signals.notes import Kind, Note
from gtau.signals.preparation import PreparedRun
from gtau.signals.run import Run
from gtau.signals.storage import block, spans

BEYOND = 0.02  # of a joint's range outside its limits, which a user may want to know
FAR_BEYOND = 1.0  # and so much that it is another unit, another joint or another robot
TOO_FAST = 3.0  # rms speed in limits of speed, which no controller lets pass
USUAL = {"revolute": 30.0, "prismatic": 10.0}  # rms speed, rad/s or m/s, where no limit is given; fast deltas reach 10
FAR = {"revolute": 40.0, "prismatic": 30.0}  # rad or lengths of the robot: what spans more is in deg or mm
NARROW = {"revolute": 0.06, "prismatic": 3e-3}  # rad or lengths of the robot: what spans less and is said to be in deg
# or mm is in rad or m. The logs of UR10e, TX40, Panda and Orthoglide span 0.3 to 6 rad, or a third of the lengths.
UNITS = {"revolute": ("rad", "deg"), "prismatic": ("m", "mm")}


def within_limits(robot: Robot, prepared: PreparedRun) -> PreparedRun:
    """Note every joint that leaves its limits in a run.

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
    _check_units(robot, prepared.run, highest - lowest, speeds)
    notes: list[Note] = []
    for name, low, high, speed in zip(prepared.run.joints, lowest, highest, speeds, strict=True):
        notes += _judge(prepared.run.name, robot.joint(name), float(low), float(high), float(speed))
    return replace(prepared, notes=(*prepared.notes, *notes))


def _check_units(robot: Robot, run: Run, span: np.ndarray, speeds: np.ndarray) -> None:
    """Refuse motions that no robot of this size makes, and name the unit or clock behind them; (n,) rad or m, s."""
    # Motors behind gears turn as often as they like, and floating bases go where they like.
    geared = {name for each in robot.couplings for name in (each.joint, *dict(each.ratios))}.union(robot.base)
    for kind, (basic, other) in UNITS.items():
        joints = [j for j, name in enumerate(run.joints) if robot.joint(name).kind == kind and name not in geared]
        if not joints:
            continue
        widest = max(joints, key=lambda j: span[j])
        declared = {run.log.units.of_position(run.joints[j]) or basic for j in joints} if run.log else {basic}
        size = 1.0 if kind == "revolute" else characteristic_length(robot)
        moved = f"{span[widest]:.3g} {basic}"
        if 0 < span[widest] < NARROW[kind] * size and declared == {other}:
            raise GtauError(
                f"run '{run.name}': no {kind} joint moves by more than {moved}, too little for robot "
                f"'{robot.name}', so its positions look like {basic} declared as {other}; write {basic} under "
                "units.position."
            )
        if span[widest] > FAR[kind] * size and declared == {basic}:
            raise GtauError(
                f"run '{run.name}': joint '{run.joints[widest]}' moves by {moved}, too far for robot "
                f"'{robot.name}', so its positions look like {other} taken for {basic}; write {other} "
                "under units.position."
            )
        unlimited = [j for j in joints if robot.joint(run.joints[j]).limits.velocity is None]
        fastest = max(unlimited, key=lambda j: speeds[j], default=None)
        if fastest is not None and speeds[fastest] > USUAL[kind]:
            raise GtauError(
                f"run '{run.name}': joint '{run.joints[fastest]}' has an rms speed of {speeds[fastest]:.3g} {basic}/s "
                f"over a motion of {span[fastest]:.3g} {basic}, which no robot has; {clock_advice(run)}."
            )


def clock_advice(run: Run) -> str:
    """Advise what to correct where a run has a wrong time."""
    if run.log is not None and isinstance(run.log.signals.time, SampleRate):
        return f"correct the sampling rate, 'rate: {run.log.signals.time.rate:g}' under signals.time"
    return "correct the unit of the time (units: {time: ...})"


def _judge(run: str, joint: Joint, low: float, high: float, speed: float) -> Iterator[Note]:
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
            action = "check the zero of its position, or correct the limits in the robot file"
            yield Note(Kind.LIMITS, f"{moved}, outside {limits}", action, joint=joint.name)
    if joint.limits.velocity is not None and speed > TOO_FAST * joint.limits.velocity:
        raise GtauError(
            f"run '{run}': joint '{joint.name}' moves at {speed:.4g} {unit}/s (rms), "
            f"{speed / joint.limits.velocity:.3g} times its limit of {joint.limits.velocity:.4g} {unit}/s; {repair}"
        )
