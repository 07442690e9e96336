"""Runs that do not suit their robot: implausible motions, sensors and wrenches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from gtau.errors import GtauError, meant
from gtau.estimation.regression.run_blocks import PreparedRuns
from gtau.findings import Finding, clock_advice, write_limits
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.geometry import characteristic_length
from gtau.robots.robot import Joint, Robot
from gtau.signals.preparation.filters import Preparation
from gtau.signals.preparation.prepared_run import PreparedRun, prepare
from gtau.signals.reading.columns import SampleRate
from gtau.signals.reading.samples import extremes
from gtau.signals.run import Run

BEYOND_LIMITS = 0.02  # motion outside a joint's limits, of their range, from which a note says so
FAR_BEYOND_LIMITS = 1.0  # motion outside a joint's limits, of their range, from which the log is refused
FASTEST_TURN = 30.0  # rms speed of a joint, rad/s, from which the clock or unit is wrong
FASTEST_SLIDE = 10.0  # rms speed of a joint, m/s, from which the clock or unit is wrong
FARTHEST_TURN = 40.0  # range of a joint's positions, rad, from which they are rather in deg
FARTHEST_SLIDE = 30.0  # range of a joint's positions, in lengths of the robot, from which they are rather in mm
LEAST_TURN = 0.06  # range of the joint that turns most, rad, below which positions said to be in deg are rather in rad
LEAST_SLIDE = 0.003  # range of the joint that slides most, in lengths of the robot, below which mm are rather m

FASTEST = {"revolute": FASTEST_TURN, "prismatic": FASTEST_SLIDE}
FARTHEST = {"revolute": FARTHEST_TURN, "prismatic": FARTHEST_SLIDE}
LEAST = {"revolute": LEAST_TURN, "prismatic": LEAST_SLIDE}
UNITS = {"revolute": ("rad", "deg"), "prismatic": ("m", "mm")}


def within_limits(robot: Robot, prepared: PreparedRun, may_rest: bool = False) -> PreparedRun:
    """Note every joint that leaves its limits in a run, or hardly moves unless it ``may_rest``; raises GtauError."""
    lowest, highest = extremes(prepared.run.position)
    speeds = np.sqrt(np.diag(prepared.speeds))
    _check_units(robot, prepared.run, highest - lowest, speeds, may_rest)
    notes: list[Finding] = []
    for name, low, high, speed in zip(prepared.run.joints, lowest, highest, speeds, strict=True):
        notes += _judge(prepared.run.name, robot.joint(name), float(low), float(high), float(speed))
    return replace(prepared, notes=(*prepared.notes, *notes))


def _check_units(robot: Robot, run: Run, span: np.ndarray, speeds: np.ndarray, may_rest: bool) -> None:
    """Refuse motions impossible for a robot of this size, and name the wrong unit or clock; (n,) rad or m, s."""
    # Motors behind gears make any number of turns, and floating bases move without limits.
    units = run.log.units
    geared = _coupled(robot).union(robot.base)
    for kind, (basic, other) in UNITS.items():
        joints = [j for j, name in enumerate(run.joints) if robot.joint(name).kind == kind and name not in geared]
        if not joints:
            continue
        widest = max(joints, key=lambda j: span[j])
        stated = {units.position_unit(run.joints[j]) for j in joints} if units else {None}
        declared = {unit or basic for unit in stated}
        size = 1.0 if kind == "revolute" else characteristic_length(robot)
        moved = f"{span[widest]:.3g} {basic}"
        if 0 < span[widest] < LEAST[kind] * size and declared == {other} and not may_rest:
            raise GtauError(
                f"run '{run.name}': no {kind} joint moves by more than {moved}, too little for robot "
                f"'{robot.name}', so its positions look like {basic} declared as {other}; write {basic} under "
                "units.position."
            )
        far = span[widest] > FARTHEST[kind] * size and declared == {basic}
        if far and None in stated:
            turns = f", or {basic} if it does turn so often, as motors before their gears" if kind == "revolute" else ""
            raise GtauError(
                f"run '{run.name}': joint '{run.joints[widest]}' moves by {moved}, too far for robot "
                f"'{robot.name}', so its positions look like {other} taken for {basic}; write {other} "
                f"under units.position{turns}."
            )
        fastest = max(joints, key=lambda j: speeds[j])
        if not far and speeds[fastest] > max(FASTEST[kind], robot.joint(run.joints[fastest]).limits.velocity or 0.0):
            raise GtauError(
                f"run '{run.name}': joint '{run.joints[fastest]}' has an rms speed of {speeds[fastest]:.3g} {basic}/s "
                f"over a motion of {span[fastest]:.3g} {basic}, which no robot has; {clock_advice(stated_rate(run))}."
            )


def stated_rate(run: Run) -> float | None:
    """Return the sampling rate (Hz) stated for a log's signals; None if the log has time stamps."""
    stated = None if run.log.signals is None else run.log.signals.time
    return stated.rate if isinstance(stated, SampleRate) else None


def _judge(run: str, joint: Joint, low: float, high: float, speed: float) -> Iterator[Finding]:
    unit = joint.unit
    if joint.limits.position is not None:
        lower, upper = joint.limits.position
        if joint.turns:  # encoders of one turn count from 0 to 360 deg what limits count from -180
            turns = np.clip(np.round((lower + upper - low - high) / (4 * np.pi)), -1, 1)
            low, high = low + 2 * np.pi * turns, high + 2 * np.pi * turns
        excess = max(lower - low, high - upper) / (upper - lower)
        far = "far " if excess > FAR_BEYOND_LIMITS else ""
        text = f"joint '{joint.name}' goes from {low:z.4g} to {high:z.4g} {unit}, {far}outside its limits "
        text += f"{lower:z.4g} to {upper:z.4g} {unit}"
        if far:
            raise GtauError(
                f"run '{run}': {text}; if the log is in {'deg' if joint.turns else 'mm'}, write that under 'units'; "
                f"otherwise check the columns and the time, or {write_limits(joint.name)}."
            )
        if excess > BEYOND_LIMITS:
            advice = f"check the zero of its position, or {write_limits(joint.name)}"
            yield Finding("joint limits", (joint.name,), text=text, advice=advice)
    if (limit := joint.limits.velocity) is not None and speed > limit:
        # in many files a placeholder, so no log is refused
        text = f"joint '{joint.name}' moves at {speed:.4g} {unit}/s (rms), {speed / limit:.3g} times its limit of "
        text += f"{limit:.4g} {unit}/s"
        advice = f"check columns and units; if the limit is a placeholder, {write_limits(joint.name)}"
        yield Finding("speed limit", (joint.name,), text=text, advice=advice, shown_as="joint limits")


def sensors_of(robot: Robot, runs: Sequence[Run]) -> tuple[str, ...]:
    """List the joints with a sensor behind the drive, the same in all runs, in the order of its channels.

    The sensor of joint j measures the torque of row j of the model without the terms of its drive: rotor
    inertia, friction of motor and gear, and the offset of the current. It has an offset of its own. The parameters of
    the links are the same, so they carry the scale of the sensor to all drive gains. Raises GtauError.
    """
    behind = [[channel for channel in run.channels if channel.kind.link_side] for run in runs]
    for run, sensors in zip(runs, behind, strict=True):
        for kind in dict.fromkeys(channel.kind for channel in (*behind[0], *sensors)):
            first = [channel.joint for channel in behind[0] if channel.kind == kind]
            other = [channel.joint for channel in sensors if channel.kind == kind]
            if other != first:
                raise GtauError(
                    f"runs '{runs[0].name}' and '{run.name}' have {kind.group} at other joints "
                    f"({', '.join(first) or 'none'}; {', '.join(other) or 'none'}); give '{kind.calibration}' for the "
                    "same joints in all runs."
                )
    coupled = _coupled(robot)
    for sensor in behind[0]:
        joint, kind = sensor.joint, sensor.kind
        if joint in coupled:
            raise GtauError(
                f"joint '{joint}' has a {kind.name}, but couplings of robot '{robot.name}' share it between "
                f"motors, so that no motor's torque is the joint's torque; remove it from '{kind.calibration}'."
            )
        if sensor.name in robot.bodies:
            raise GtauError(f"joint '{sensor.name}' has the name of a {kind.name} of '{joint}'; rename the joint.")
    return runs[0].sensors


def _coupled(robot: Robot) -> set[str]:
    return {name for coupling in robot.couplings for name in (coupling.joint, *dict(coupling.ratios))}


def check_wrenches(robot: Robot, run: Run) -> None:
    """Check that the wrenches of a run act on bodies of the robot, and include no stated payload; raises GtauError."""
    if run.payload is not None and robot.tool in [frame.body for frame in run.wrenches]:
        raise GtauError(
            f"run '{run.name}': the payload '{run.payload.name}' is on '{robot.tool}', whose wrench is measured: "
            "the sensor feels it already; remove the 'payload', or the sensor from 'wrenches'."
        )
    bodies = [body for body in robot.bodies if body not in robot.base]
    for frame in run.wrenches:
        if frame.body not in (*bodies, robot.floating):
            hint = meant(frame.body, bodies)
            raise GtauError(
                f"'wrenches' names the body '{frame.body}', but a body of robot '{robot.name}' has the name of its "
                f"joint: {', '.join(bodies)}; write the joint that moves it{hint and f' ({hint})'}, and, with 'axes: "
                "body', 'at' in that joint's frame."
            )


def prepare_runs(model: InverseDynamics, runs: Sequence[Run], preparation: Preparation) -> PreparedRuns:
    """Prepare runs with joints in the model's order; raises GtauError."""
    ratios = motor_to_joint_speed(model)
    return PreparedRuns(within_limits(model.robot, prepare(run, preparation.at(run.rate), ratios)) for run in runs)


def motor_to_joint_speed(model: InverseDynamics) -> np.ndarray:
    """Compute the speeds (n_y, n) of the joints that motors drive, whose ratios couplings keep constant."""
    n, robot = len(model.actuated), model.robot
    without_friction = [robot.actuated.index(joint) for joint in robot.base]
    if not robot.couplings or robot.closures:
        ratios = np.eye(n)
    else:
        still = np.zeros((n, 1))
        ratios = model.motion(still, still, still).J[:, :, 0]
    ratios[:, without_friction] = 0.0
    return ratios
