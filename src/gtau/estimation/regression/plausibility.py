"""Preparation of the runs of a robot: implausible motions, sensors and wrenches, and trials of position filters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from difflib import get_close_matches

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.regression.factors import EXTRA, KNOWN, SIGNAL, channel_rows
from gtau.estimation.regression.rows import stream_rows
from gtau.estimation.regression.run_blocks import PreparedRuns
from gtau.findings import Finding, Grade
from gtau.findings.words import clock_advice, write_limits
from gtau.model.base_parameters import Equations
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.geometry import characteristic_length
from gtau.robots.robot import Joint, Robot
from gtau.signals.preparation.choice import LEAST_WIDTH
from gtau.signals.preparation.filters import HIGHEST_CUTOFF, PASSED, Decimator, cutoff_at_ends
from gtau.signals.preparation.prepared_run import Preparation, PreparedRun, prepare
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


def within_limits(robot: Robot, prepared: PreparedRun) -> PreparedRun:
    """Note every joint that leaves its limits in a run; raises GtauError."""
    position = prepared.run.position
    lowest, highest = extremes(position)
    speeds = np.sqrt(np.diag(prepared.speeds))
    _check_units(robot, prepared.run, highest - lowest, speeds)
    notes: list[Finding] = []
    for name, low, high, speed in zip(prepared.run.joints, lowest, highest, speeds, strict=True):
        notes += _judge(prepared.run.name, robot.joint(name), float(low), float(high), float(speed))
    return replace(prepared, notes=(*prepared.notes, *notes))


def _check_units(robot: Robot, run: Run, span: np.ndarray, speeds: np.ndarray) -> None:
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
        if 0 < span[widest] < LEAST[kind] * size and declared == {other}:
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
        if excess > FAR_BEYOND_LIMITS:
            raise GtauError(
                f"run '{run}': joint '{joint.name}' goes from {low:.4g} to {high:.4g} {unit}, far outside its limits "
                f"{lower:.4g} to {upper:.4g} {unit}; if the log is in {'deg' if joint.turns else 'mm'}, write that "
                f"under 'units'; otherwise check the columns and the time, or {write_limits(joint.name)}."
            )
        if excess > BEYOND_LIMITS:
            yield Finding(
                "joint limits",
                (joint.name,),
                text=f"joint '{joint.name}' goes from {low:z.4g} to {high:z.4g} {unit}, outside its limits "
                f"{lower:z.4g} to {upper:z.4g} {unit}",
                advice=f"check the zero of its position, or {write_limits(joint.name)}",
                grade=Grade.WARNING,
            )
    if joint.limits.velocity is not None and speed > joint.limits.velocity:
        # in many files a placeholder, so no log is refused
        limit = joint.limits.velocity
        yield Finding(
            "speed limit",
            (joint.name,),
            text=f"joint '{joint.name}' moves at {speed:.4g} {unit}/s (rms), {speed / limit:.3g} times its limit of "
            f"{limit:.4g} {unit}/s",
            advice=f"check columns and units; if the limit is a placeholder, {write_limits(joint.name)}",
            grade=Grade.WARNING,
            shown_as="joint limits",
        )


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
            close = get_close_matches(frame.body, bodies, n=1)
            hint = f" (did you mean '{close[0]}'?)" if close else ""
            raise GtauError(
                f"'wrenches' names the body '{frame.body}', but a body of robot '{robot.name}' has the name of its "
                f"joint: {', '.join(bodies)}; write the joint that moves it{hint}, and, with 'axes: "
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


LOWEST, HIGHEST = 5.0, 40.0  # Hz, of the cut-offs tried: half the chosen one, a quarter, and so on
BANDS = 5.0, 20.0  # Hz, within which the low-pass of the rows is when they are compared
# Of all runs together, evaluated behind each cut-off. With 800 rows a filter of 10 Hz seems to halve the errors of the
# UPV robot (13.7 Hz), of which 3000 say that it raises them by 10 %.
ROWS, SAMPLES = 3000, 6000
STRETCHES = 16  # of all runs together, at least four of each
FINE = 5.0  # times the highest cut-off: rate of the samples
# Errors over the least, from which the chosen cut-off is given up: up to 1.08 in 15 shared sets and a Sawyer's;
# 1.17 (pendulum), 1.49 (double pendulum that hunts at 41 Hz; XL330, slow). On the first 70 % of Aliengo's log
# the bandwidth falls from 13 to 3.3 Hz, and the error of the rest from 15.8 to 7.1 %.
MARGIN = 0.15
SMALLEST = 1e-3  # singular value of normed columns
FEWEST = 4  # rows of half the stretches for each column


def best_of_trials(equations: Equations, runs: Sequence[Run], preparation: Preparation) -> Preparation:
    """Lower the cut-off and the bandwidth of a preparation where parameters found behind it predict clearly worse.

    Spectra show where noise takes over in the accelerations of a sample. What filters do to parameters is another
    matter: noise averages out over a long log, and what a filter takes away does not; a small oscillation of the
    controller may look like motion. So stretches spread over the logs are fitted behind some cut-offs, every channel by
    its own equations alone, which needs no gains, and the parameters predict the stretches between. Parameters found
    behind one cut-off are tested along the motions behind all, and the best counts: noise that biases them is then no
    excuse for their errors.
    """
    cutoffs = _cutoffs(runs, preparation)
    if len(cutoffs) == 1:
        return preparation
    try:
        errors = _errors(equations, runs, preparation, cutoffs)
    except GtauError:  # positions that the robot cannot have: the checks of the runs say why
        return preparation
    good = errors <= (1 + MARGIN) * np.min(errors)
    if good[0] or not good.any():
        return preparation
    cutoff = cutoffs[int(np.argmin(errors))]
    assert cutoff is not None
    return replace(preparation, cutoff=cutoff, bandwidth=min(preparation.bandwidth, cutoff / LEAST_WIDTH))


def _cutoffs(runs: Sequence[Run], preparation: Preparation) -> list[float | None]:
    lowest = max(LOWEST, cutoff_at_ends(float(np.mean([len(run.time) / run.rate for run in runs]))))
    tried = [preparation.cutoff]
    cutoff = min(preparation.cutoff or HIGHEST_CUTOFF * preparation.rate, 2 * HIGHEST) / 2
    while cutoff >= lowest:
        tried.append(cutoff)
        cutoff /= 2
    return tried


def _errors(
    equations: Equations, runs: Sequence[Run], preparation: Preparation, cutoffs: Sequence[float | None]
) -> np.ndarray:
    """Compute the relative errors behind each cut-off (C,), the geometric mean of the channels; NaN with few rows."""
    loads = [run.payload for run in runs]
    alike = [run for run in runs if run.payload == max(loads, key=loads.count)]
    run_rows = [_rows(equations, run, preparation, cutoffs, len(alike)) for run in alike]
    A, keep, odd = (np.concatenate(parts, axis=-1) for parts in zip(*run_rows, strict=True))
    channels = [_log_errors(A[:, j, :, kept], odd[kept]) for j, kept in enumerate(keep)]
    known = [errors for errors in channels if np.isfinite(errors).all()]
    return np.exp(np.mean(known, axis=0)) if known else np.full(len(cutoffs), np.nan)


def _log_errors(rows: np.ndarray, odd: np.ndarray) -> np.ndarray:
    """Compute the logarithms of a channel's relative errors (C,) from rows ``[W known | v]`` (K, C, p)."""
    rows = np.moveaxis(rows, 0, 1)
    norms = np.linalg.norm(rows, axis=(0, 1))
    rows = rows[..., norms > 0] / norms[norms > 0]
    squares = np.zeros((len(rows), len(rows)))
    for fitted in (odd, ~odd):
        if norms[-1] == 0 or fitted.sum() < FEWEST * rows.shape[2]:
            return np.full(len(rows), np.nan)
        thetas = [np.linalg.lstsq(A[fitted, :-1], A[fitted, -1], rcond=SMALLEST)[0] for A in rows]
        errors = rows[:, ~fitted, :-1] @ np.array(thetas).T - rows[:, ~fitted, -1:]  # (C along, K, C fitted)
        squares += np.sum(errors**2, axis=1).T
    return np.log(np.maximum(squares.min(axis=1), 1e-300)) / 2


def _rows(
    equations: Equations, run: Run, preparation: Preparation, cutoffs: Sequence[float | None], runs: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute rows (C, c, p, K) behind the cut-offs, masks of the usable (c, K) and of odd stretches (K,)."""
    model, standard = equations.model, equations.base.standard
    prepared = prepare(run, preparation.at(run.rate), motor_to_joint_speed(model))
    stride = max(1, int(run.rate / (FINE * max(cutoff or run.rate for cutoff in cutoffs))))
    band = float(np.clip(preparation.decimator.cutoff(preparation.rate), *BANDS))
    decimator = Decimator(max(1, int(PASSED / 2 * run.rate / stride / band)))
    pieces = max(STRETCHES // runs, 4)
    length = min(min(ROWS * decimator.factor, SAMPLES) // runs // pieces * stride, len(prepared) // pieces)
    regressor, p = model.columns(standard), len(standard) + EXTRA
    channels = [channel for channel in run.channels if channel.kind.modelled]
    used = [*range(p - EXTRA), p + KNOWN, p + SIGNAL]
    A: list[list[np.ndarray]] = [[] for _ in cutoffs]
    if runs * pieces * decimator.outputs(length // stride) < 2 * FEWEST * np.bincount(regressor.rows).min():
        pieces = 0  # not worth the time
    keep, odd = [np.zeros((len(channels), 0), bool)], [np.zeros(0, bool)]
    for number, start in enumerate(np.linspace(0, len(prepared) - length, pieces).astype(int).tolist()):
        usable = []
        for rows, cutoff in zip(A, cutoffs, strict=True):
            behind = replace(prepared, preparation=replace(prepared.preparation, cutoff=cutoff))
            window = behind.samples(start, start + length)[::stride]
            parts = list(stream_rows(model, regressor, window, decimator))
            rows += [channel_rows(regressor, channels, part)[..., used].swapaxes(1, 2) for part in parts]
            usable.append(np.concatenate([keep[0], *(part.keep for part in parts)], axis=1))
        keep.append(np.all(usable, axis=0))
        odd.append(np.full(keep[-1].shape[1], number % 2 == 1))
    empty = np.zeros((len(channels), len(used), 0))
    stacked = np.stack([np.concatenate([empty, *rows], axis=-1) for rows in A])
    return stacked, np.concatenate(keep, axis=1), np.concatenate(odd)
