"""Tests of the logs: commands that lag, are no torques or currents, or never felt the payload.

Torque causes acceleration, so the command of a drive comes before the motion by its delay. One that comes after the
motion was filtered or stamped late. For a first-order low-pass with time constant T, ``v + T v'`` is the command that
the motion requires; for any other filter and a late stamp, to first order. T follows from each joint's own equations,
whether its gain is estimated, given, or 1.

Units of positions are checked against the robot's size before (:mod:`gtau.estimation.regression.plausibility`), and
magnitudes without sign are refused where logs are read. :mod:`gtau.estimation.diagnostics.effort` ranks what the
columns may hold.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.units import BEYOND_GEARS
from gtau.estimation.diagnostics.verdict import MISFIT, contradiction, half_widths, unexplained_shares
from gtau.estimation.effects.effect import plain_friction, rms_speeds, rms_torques
from gtau.estimation.estimators.estimator import Fit, Solution
from gtau.estimation.estimators.newton import DELAY_MOTION
from gtau.estimation.regression.dataset import Dataset, System
from gtau.estimation.regression.factors import SIGNAL, SIGNALS
from gtau.estimation.regression.problem import Estimates, Problem
from gtau.findings import Finding, Grade, listed, percent
from gtau.robots.parameter import Parameter
from gtau.robots.robot import Robot
from gtau.signals.preparation.bandwidth import end_of_commands
from gtau.signals.reading.samples import extremes
from gtau.signals.repair.commands import whole_numbers, window_of_commands
from gtau.signals.run import Run

LAG_STD = 4.0  # lag of all commands together behind the motion, in standard errors
LAG_JOINTS = 2  # joints whose acceleration shows the lag, or all of the robot: friction of one alone may look like it
LAG_SAMPLES = 1.0  # lag of all commands together behind the motion, samples
LAG_LEAST = 0.003  # lag of all commands together behind the motion, s
LEAD_LEAST = 0.015  # lead of all commands together, of LAG_JOINTS at least, before the motion, s: drives take less
LAG_LOSS = 0.01  # share of a command that a low-pass of the lag takes away at the bandwidth
LIMIT_SHARE = 0.02  # largest torque over its limit of effort, all joints: below, torques are measured before the gears
STEPS = 3.0  # largest whole number of commands that are all whole, from which they are shares or counts
WHOLE = 0.9  # share of commands that are whole numbers, from which all were
UNSEEN_RATIO = 4.0  # unexplained share of a joint where another's position is frozen, over its share where that moves
UNSEEN_MISFIT = 0.1  # unexplained share of a joint's current in the run with the frozen position
FRICTIONLESS = 0.02  # friction over torque, rms, of the joint with most of it: below, torques come from a model
MODEL_RESIDUAL = 0.02  # unexplained share of the joint with most of it, below which torques come from a model
GEARED = 5.0  # least torque scale of the joints, from which torques are measured before the gears
UNFELT_PAYLOAD = 1.1  # residual of the currents without the payload over the residual with it

COMMAND_LAG, SMOOTHED, WHOLE_NUMBERS = "command lag", "smoothed commands", "whole numbers"
MOTOR_SIDE, FROZEN, MODEL_TORQUES = "torques of the motors", "frozen encoder", "torques of a model"


def command_lags(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Estimate each joint's lag T of command behind motion, with standard error, both (n,) in s; NaN where unknown.

    T minimises what the joint's own model leaves of ``v + T v'``. Noise n of the command adds ``T^2 n'^2`` to that,
    which ``n n''`` takes away on average (integration by parts). The error follows from the scatter over the units.
    """
    lags = np.full((2, len(problem.joints)), np.nan)
    for j in range(len(problem.joints)):
        R, columns = problem.triangles[j], problem.own_columns[j]
        model = np.linalg.lstsq(R[:, columns], R[:, SIGNALS], rcond=None)[0]
        rest = problem.blocks[:, j, :, SIGNALS] - problem.blocks[:, j][:, :, columns] @ model
        r, rate, change = np.moveaxis(rest, -1, 0)  # (U, p) each
        along, rates, changes = (np.einsum("up,up->u", *pair) for pair in ((r, rate), (rate, rate), (r, change)))
        motion = rates + changes
        share = motion.sum() / max(rates.sum(), 1e-300)
        if share * rates.sum() > DELAY_MOTION * np.linalg.norm(motion - share * rates):
            lag = -along.sum() / motion.sum()
            lags[:, j] = lag, np.linalg.norm(along + lag * motion) / motion.sum()
    return lags[0], lags[1]


def command_lag(dataset: Dataset, system: System) -> list[Finding]:
    """Find commands that lag behind the motion, or lead it by more than drives do, in all runs of the ``system``."""
    kind, bandwidth = dataset.runs[0].kind, dataset.preparation.bandwidth
    rate = min(run.rate for run in dataset.runs)
    lags, errors = command_lags(system.problem)
    known = np.isfinite(lags) & (errors > 0)
    if known.sum() < min(LAG_JOINTS, len(lags)):
        return []
    weights = 1 / errors[known] ** 2
    lag = float(weights @ lags[known] / weights.sum())
    scatter = weights @ (lags[known] - lag) ** 2 / max(known.sum() - 1, 1)
    std = float(np.sqrt(max(scatter, 1.0) / weights.sum()))
    if abs(lag) < max(LAG_LEAST if lag > 0 else LEAD_LEAST, LAG_SAMPLES / rate, LAG_STD * std):
        return []
    leads, lag = lag < 0, abs(lag)
    phase = float(2 * np.pi * bandwidth * lag)
    loss = 1 - 1 / np.sqrt(1 + phase**2)
    # of a lag beyond what the motion shows, only that it is longer
    by = f"{1000 * lag:.2g} ms (standard deviation {1000 * std:.2g} ms)"
    by = by if phase < 1 else f"more than {1000 * lag / phase:.2g} ms"
    share = f"{percent(loss)} at the bandwidth of the motion, {bandwidth:.3g} Hz"
    if leads:
        text = (
            f"the {kind}s lead the motion by {by}, so they look like references of an outer loop, or the positions "
            f"filtered or logged late; a loop with that time constant attenuates them by {share}"
        )
        advice = f"log the {kind}s that the motors had, and with them the positions of the same instants"
        lead = Finding("command lead", text=text, advice=advice, shown_as="filtered command")
        return [lead] if loss > LAG_LOSS and known.sum() >= LAG_JOINTS else []
    text = (
        f"the {kind}s lag behind the motion by {by}, so they look low-passed, held or logged late, or the positions "
        f"are references; a low-pass filter with that time constant attenuates them by {share}"
    )
    advice = f"log the {kind}s before any filter, and measured positions of the same instants"
    if loss > LAG_LOSS:
        return [Finding(COMMAND_LAG, text=text, advice=advice, shown_as="filtered command")]
    return [Finding("slight command lag", text=text, advice=advice, grade=Grade.INFORMATION, shown_as="reading")]


def smoothed_commands(runs: Sequence[Run]) -> Iterator[Finding]:
    """Find runs whose commands filters smoothed offline: nothing above some frequency, or a moving average."""
    ends = {run.name: end for run in runs if (end := end_of_commands(run)) is not None}
    windows = {  # as logged: resampled noise has another colour
        run.name: window_of_commands(run.command, run.rate) if run.log.whole_share is None else run.log.window
        for run in runs
        if run.name not in ends
    }
    averaged = {name: window for name, window in windows.items() if window}
    if ends:
        seen = min(run.rate for run in runs if run.name in ends) / 2
        how = f": above {max(ends.values()):.2g} Hz they hold nothing, not even noise, though their rate shows up to "
        yield _smoothed(runs[0].kind, ends, f"{how}{seen:.3g} Hz")
    if averaged:
        yield _smoothed(runs[0].kind, averaged, f" by a moving average over {max(averaged.values()):.2g} s")


def _smoothed(kind: str, runs: Iterable[str], how: str) -> Finding:
    text = f"the {kind}s of {listed(runs)} were smoothed{how}; what a filter takes from motion and friction is in no "
    text += "interval"
    advice = "identify from the logs as they were recorded"
    return Finding(SMOOTHED, text=text, advice=advice, shown_as="filtered command")


def doubtful_commands(runs: Sequence[Run], robot: Robot) -> Iterator[Finding]:
    """Find integer-valued commands, and torques far below all effort limits, in all ``runs``."""
    joints, kind = runs[0].joints, runs[0].kind
    peaks = np.max([np.abs(extremes(run.command)) for run in runs], axis=(0, 1))[: len(joints)]
    integers = min(
        whole_numbers(run.command, len(joints)) if (share := run.log.whole_share) is None else share for run in runs
    )
    if integers > WHOLE and peaks.max() >= STEPS:
        text = (
            f"the {kind}s are whole numbers, up to {peaks.max():.0f}: ‰ of the rated {kind} (CiA 402, object 0x6077), "
            "mA, counts, or SI units without decimals"
        )
        advice = (
            f"state their unit and the rated values (units: {{{kind}: ‰, rated: {{...}}}}), or {{{kind}: mA}}; in SI "
            "units, log them with decimals"
        )
        yield Finding(WHOLE_NUMBERS, text=text, advice=advice, shown_as="unit")
        return
    efforts = {joint: robot.joint(joint).limits.effort for joint in robot.motors}
    limits = {joint: limit for joint, limit in efforts.items() if limit}
    if kind != "torque" or len(set(limits.values())) < 2:  # the same for all joints is a placeholder
        return
    tops = zip(joints, peaks.tolist(), strict=True)
    share, joint = max((peak / limits[joint], joint) for joint, peak in tops if joint in limits)
    if share < LIMIT_SHARE:
        text = f"the torques reach {percent(share)} of the limit of '{joint}' ({limits[joint]:.4g}), and less elsewhere"
        yield motor_side_torques(text, (joint,))


def motor_side_torques(text: str, joints: tuple[str, ...] = ()) -> Finding:
    """Note, for the reason in ``text``, that torques are measured before the gears."""
    text = f"{text}: by their size they are motor-side torques (before the gear) or currents"
    advice = (
        "write 'motor_torque' with the 'gear_ratio' of each joint instead of 'torque', or 'current' if they are in A, "
        "or correct the limits"
    )
    return Finding(MOTOR_SIDE, joints, text=text, advice=advice, shown_as="unit")


def logged_torques(fit: Fit, estimates: Estimates) -> Iterator[Finding]:
    """Find shares of rated values, motor-side torques, or torques and currents of a model: the first that holds."""
    kind, scales = fit.kind, np.zeros(0)
    if doubtful := list(doubtful_commands(fit.dataset.runs, fit.dataset.robot)):
        yield doubtful[0]
        return
    if kind == "torque" and fit.free_gains:
        scales = np.abs(fit.gains)[half_widths(fit, estimates) < 1]
    if len(scales) and scales.min() > GEARED and scales.max() < BEYOND_GEARS:
        ends = " to ".join(dict.fromkeys(f"{end:.3g}" for end in (scales.min(), scales.max())))
        yield motor_side_torques(f"the true torques are {ends} times those logged")
        return
    joints, known = fit.dataset.robot.motors, set(fit.problem.parameters)
    if any({name := Parameter("fs", joint), name + "R"}.isdisjoint(known) for joint in joints):
        return
    rows = [fit.dataset.model.actuated.index(joint) for joint in joints]
    fv, fs = plain_friction(fit)
    friction = float(((fv * rms_speeds(fit) + fs) / np.maximum(rms_torques(fit), 1e-300))[rows].max())
    residual = float(unexplained_shares(fit)[rows].max())
    if friction < FRICTIONLESS and residual < MODEL_RESIDUAL:
        yield Finding(
            MODEL_TORQUES,
            text=f"the {kind}s have next to no friction ({percent(friction, '.1g')} of a joint's torque at most) and "
            f"{percent(residual)} is unexplained: they come from a model in the controller, not from the motors",
            advice="log measured currents or torques (UR: actual_current, not target_current or target_moment)",
            shown_as="model",
        )


def require_payload_excitation(system: System) -> None:
    """Refuse logs whose currents are explained as well without the payload as with it; raises GtauError.

    Each joint's current is fitted by its own equations, once with the columns of all payloads and once with none.
    """
    problem, carried = system.problem, [columns for columns in system.payloads if columns.payload]
    n = len(problem.parameters)
    if not carried or np.any(problem.total_rows < 3 * (n + 1)):
        return  # with so few equations, the robot's own parameters explain whatever the payload does
    loads = {name for columns in system.payloads for name in columns.unknown}
    robot_columns = [k for k, name in enumerate(problem.parameters) if name not in loads]
    without, with_all = (
        np.array([own_share(R, columns) for R in problem.triangles[: len(problem.joints)]])
        for columns in (robot_columns, list(range(n + 1)))
    )
    if np.all(without < UNFELT_PAYLOAD * with_all):
        raise GtauError(
            f"the currents are explained as well without payload '{carried[0].payload.name}' (residual of the worst "
            f"joint {100 * without.max():.2g} % of its current, {100 * with_all.max():.2g} % with it), so they do not "
            "fix the drive gains; give actual currents or the references of the current loops, not targets of the "
            "controller's own model, check which runs carry the payload, or log longer runs with a heavier one."
        )


def own_share(rows: np.ndarray, columns: list[int]) -> float:
    """Compute the share of a joint's current that ``columns`` of its own equations (., p) leave unexplained."""
    A, v = rows[:, columns], rows[:, SIGNAL]
    A = A / np.maximum(np.linalg.norm(A, axis=0), 1e-300)
    return float(np.linalg.norm(v - A @ np.linalg.lstsq(A, v, rcond=1e-9)[0]) / max(float(np.linalg.norm(v)), 1e-300))


def lack_of_fit(problem: Problem, solution: Solution) -> float:
    """Divide standard deviations by the jackknife by those for independent residuals; median over the parameters.

    Near 1 where the residuals are white; well above where they are autocorrelated, as the model lacks something.
    """
    known = np.diag(solution.covariance)[problem.unknowns.theta]
    ratio = np.diag(solution.jackknife)[problem.unknowns.theta][known > 0] / known[known > 0]
    return float(np.sqrt(np.median(ratio))) if ratio.size else 1.0


def frozen_encoders(fit: Fit) -> list[Finding]:
    """Find the joints that never move in a run, by their positions, but whose motion its other joints feel."""
    joints, runs, n = fit.problem.joints, fit.dataset.runs, len(fit.gains)
    moving = np.array([np.subtract(*extremes(run.position)) < 0 for run in runs])
    acting = np.array([np.subtract(*extremes(run.command))[:n] < 0 for run in runs])
    frozen = np.argwhere(acting & ~moving).tolist()
    shares = unexplained_by_run(fit) if frozen else np.zeros(0)
    findings = list[tuple[float, Finding]]()
    for run, joint in frozen:
        usual = shares[moving[:, joint]].max(axis=0, initial=0.0)
        least = np.where(usual > 0, np.maximum(UNSEEN_RATIO * usual, UNSEEN_MISFIT), MISFIT)
        worst = int(np.argmax(shares[run] / least))
        if (share := float(shares[run, worst])) > least[worst]:
            still, felt, name = joints[joint], joints[worst], runs[run].name
            others = f", {percent(usual[worst])} in other runs" if usual[worst] else ""
            text = (
                f"the position of '{still}' never changes in run '{name}', but {percent(share)} of the "
                f"{runs[run].kind} of '{felt}' is then unexplained{others}, so it moved"
            )
            advice = f"check the encoder and the position column of '{still}' in that run, and log it again"
            findings.append((share, contradiction(FROZEN, (still, felt), text, advice)))
    return [finding for _, finding in sorted(findings, key=lambda pair: -pair[0])]


def unexplained_by_run(fit: Fit) -> np.ndarray:
    """Compute the share of each joint's current that its own equations leave unexplained in each run, (runs, n)."""
    problem, block_runs = fit.problem, fit.system.block_positions[:, 0]
    shares = np.zeros((len(fit.dataset.runs), len(problem.joints)))
    for run, joint in np.ndindex(*shares.shape):
        rows = np.concatenate(problem.blocks[block_runs == run, joint])
        shares[run, joint] = own_share(rows, problem.own_columns[joint])
    return shares
