"""Tests of the logs: commands that lag, are late, swapped, no torques or currents, or never felt the payload.

Torque causes acceleration, so the command of a drive comes before the motion by its delay. One that comes after the
motion was filtered or stamped late. For a first-order low-pass with time constant T, ``v + T v'`` is the command that
the motion requires; for any other filter and a late stamp, to first order. T follows from each joint's own equations,
whether its gain is estimated, given, or 1.

Units of positions are checked against the robot's size before (:mod:`gtau.estimation.regression.plausibility`), and
magnitudes without sign are refused where logs are read. Torques without gravity are found by
:mod:`gtau.estimation.diagnostics.other_gravity`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.finding import Finding
from gtau.estimation.diagnostics.finding import FindingKind as F
from gtau.estimation.diagnostics.linearisation import central_windows, least_squares_step
from gtau.estimation.estimators.estimator import Solution
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.equations import SIGNAL, SIGNALS
from gtau.estimation.regression.problem import Problem
from gtau.estimation.regression.rows import stream_rows
from gtau.estimation.regression.system import System
from gtau.estimation.thresholds.estimates import SWAPPED, UNFELT_PAYLOAD
from gtau.estimation.thresholds.logs import (
    DELAY_MOTION,
    LAG_LEAST,
    LAG_LOSS,
    LAG_SAMPLES,
    LAG_STD,
    LATE,
    LIMIT_SHARE,
    STEPS,
    WHOLE,
)
from gtau.robots.robot import Robot
from gtau.signals.run import Run
from gtau.signals.storage import block, spans

REACH = 0.3  # s: lags beyond are other runs, or clocks that were never set
COARSE, FINE = 2, 16  # lags tried in the longest delay that the model describes, everywhere and about the best


def command_lags(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Estimate each joint's lag T of command behind motion, with standard error, both (n,) in s; NaN where unknown.

    It minimises what the joint's own model leaves of ``v + T v'``. Noise n of the command adds ``T^2 n'^2`` to that,
    which ``n n''`` takes away on average (parts integrated). The error is that of a ratio, from its scatter over the
    units.
    """
    lag, error = np.full(len(problem.joints), np.nan), np.full(len(problem.joints), np.nan)
    for j in range(len(problem.joints)):
        R, columns = problem.triangles[j], problem.own_columns[j]
        model = np.linalg.lstsq(R[:, columns], R[:, SIGNALS], rcond=None)[0]
        rest = problem.blocks[:, j, :, SIGNALS] - problem.blocks[:, j][:, :, columns] @ model
        r, rate, change = np.moveaxis(rest, -1, 0)  # (U, p) each
        along, whole = np.einsum("up,up->u", r, rate), np.einsum("up,up->u", rate, rate)
        of_motion = whole + np.einsum("up,up->u", r, change)
        share = of_motion.sum() / max(whole.sum(), 1e-300)
        if share * whole.sum() > DELAY_MOTION * np.linalg.norm(of_motion - share * whole):
            lag[j] = -along.sum() / of_motion.sum()
            error[j] = np.linalg.norm(along + lag[j] * of_motion) / of_motion.sum()
    return lag, error


def command_lag(dataset: Dataset, system: System) -> list[Finding]:
    """Find commands that lag behind the motion in all runs; ``system`` is that of all runs."""
    kind, bandwidth = dataset.runs[0].kind, dataset.preparation.bandwidth
    rate = min(run.rate for run in dataset.runs)
    lags, errors = command_lags(system.problem)
    known = np.isfinite(lags) & (errors > 0)
    if not known.any():
        return []
    weights = 1 / errors[known] ** 2
    lag = float(weights @ lags[known] / weights.sum())
    scatter = weights @ (lags[known] - lag) ** 2 / max(known.sum() - 1, 1)
    std = float(np.sqrt(max(scatter, 1.0) / weights.sum()))
    if lag < max(LAG_LEAST, LAG_SAMPLES / rate) or lag < LAG_STD * std:
        return []
    loss = 1 - 1 / np.sqrt(1 + (2 * np.pi * bandwidth * lag) ** 2)
    values = {"kind": kind, "lag": lag, "std": std, "bandwidth": float(bandwidth)}
    return [Finding(F.COMMAND_LAG if loss > LAG_LOSS else F.SLIGHT_COMMAND_LAG, values=values)]


def unexplained(dataset: Dataset) -> np.ndarray:
    """Compute the share of each joint's current (columns) that each joint's regressor (rows) leaves unexplained.

    Each joint is fitted by itself, with other parameters for each payload.
    """
    n, windows = len(dataset.model.actuated), list(_windows(dataset))
    left = np.zeros((n, n))
    for j in range(n):
        W = np.concatenate([each.own[j] for each in windows])
        V = np.concatenate([each.currents[0, :n, each.kept[j]] for each in windows])
        rest = V + W @ least_squares_step(W, V)
        left[j] = np.linalg.norm(rest, axis=0) / np.maximum(np.linalg.norm(V, axis=0), 1e-300)
    return left


def swapped_channels(dataset: Dataset) -> tuple[Finding, ...]:
    """Find the pairs of joints whose currents (or torques) look swapped."""
    left, joints, found = unexplained(dataset), dataset.model.actuated, []
    for j, k in combinations(range(len(joints)), 2):
        if left[j, k] < SWAPPED * left[j, j] and left[k, j] < SWAPPED * left[k, k]:
            exchanged, as_logged = float(max(left[j, k], left[k, j])), float(min(left[j, j], left[k, k]))
            values = {"kind": dataset.runs[0].kind, "exchanged": exchanged, "as_logged": as_logged}
            found.append(Finding(F.SWAPPED, (joints[j], joints[k]), values=values, severity=1 - exchanged / as_logged))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class _Window:
    """Rows of a window, with margins for shifts: ``currents`` (3, c, K) with derivatives, every ``step`` (s).

    Of each joint the rows ``kept`` and its own columns there, (., k), other ones for each payload.
    """

    currents: np.ndarray
    step: float
    kept: list[np.ndarray]
    own: list[np.ndarray]

    def shifted(self, joint: int, lags: np.ndarray) -> np.ndarray:
        """Compute the currents of a joint's rows ``lags`` later (rows, lags)."""
        whole = np.round(lags / self.step).astype(int)
        rest = (lags - whole * self.step)[:, None]
        v, v_d, v_dd = self.currents[:, joint][:, self.kept[joint] + whole[:, None]]
        return np.asarray((v + rest * v_d + rest**2 / 2 * v_dd).T)


def late_currents(dataset: Dataset, slowest: float) -> tuple[Finding, ...]:
    """Find joints whose current (or torque) fits the motion only when it is shifted by more than ``slowest`` (s).

    Each joint is fitted by itself, with other parameters for each payload, at lags of either sign.
    """
    from scipy.linalg import orth

    if not slowest:
        return ()
    reach = max(REACH, 2 * slowest)
    windows = list(_windows(dataset, reach + slowest))
    coarse = slowest / COARSE * np.arange(-round(COARSE * reach / slowest), round(COARSE * reach / slowest) + 1)
    found = []
    for j, joint in enumerate(dataset.model.actuated if windows else ()):
        W = np.concatenate([each.own[j] for each in windows])
        norms = np.linalg.norm(W, axis=0)
        U = orth(W / np.where(norms > 0, norms, 1.0))
        if len(W) < 2 * U.shape[1]:
            continue  # as many parameters fit any shift

        def left(lags: np.ndarray, j: int = j, U: np.ndarray = U) -> np.ndarray:
            V = np.concatenate([each.shifted(j, lags) for each in windows])
            return np.asarray(np.linalg.norm(V - U @ (U.T @ V), axis=0) / np.maximum(np.linalg.norm(V, axis=0), 1e-300))

        shares = left(coarse)
        k, as_logged = int(np.argmin(shares)), float(shares[np.abs(coarse) <= slowest].min())
        if not 0 < k < len(coarse) - 1 or shares[k] == as_logged:
            continue
        fine = coarse[k] + slowest / FINE * np.arange(-FINE // COARSE, FINE // COARSE + 1)
        shares = left(fine)
        k = int(np.argmin(shares))
        if abs(fine[k]) > slowest and shares[k] < LATE * as_logged:
            a, b, c = np.take(shares, [k - 1, k, k + 1], mode="clip") ** 2
            within = (a - c) / (2 * (a - 2 * b + c)) if min(a, c) > b else 0.0
            lag = float(fine[k] + slowest / FINE * within)
            values = {"kind": dataset.runs[0].kind, "lag": lag, "shifted": float(shares[k])}
            found.append(Finding(F.LATE, (joint,), values=values | {"as_logged": as_logged}, severity=as_logged))
    return tuple(found)


def _windows(dataset: Dataset, reach: float = 0.0) -> Iterator[_Window]:
    """Iterate over the middle of the runs, with currents available up to ``reach`` (s) before and after."""
    joints, regressor = range(len(dataset.model.actuated)), dataset.model.columns(dataset.base.standard)
    loads = [None if run.payload is None else run.payload.name for run in dataset.runs]
    kinds = list(dict.fromkeys(loads))
    for run, piece in central_windows(dataset):
        mine = np.array([loads[run] == kind for kind in kinds], dtype=float)
        decimator = dataset.preparation.at(piece.run.rate).decimator
        parts = list(stream_rows(dataset.model, regressor, piece, decimator))
        currents = np.concatenate([part.currents for part in parts], axis=2)
        entries = np.concatenate([part.entries for part in parts], axis=1)
        step = decimator.factor / piece.run.rate
        margin = int(np.ceil(reach / step))
        inner = slice(margin, max(currents.shape[2] - margin, 0))
        kept = [np.arange(currents.shape[2])[inner][np.concatenate([p.keep[j] for p in parts])[inner]] for j in joints]
        own = [np.kron(mine, entries[regressor.rows == j][:, kept[j]].T) for j in joints]
        yield _Window(currents, step, kept, own)


def doubtful_commands(runs: Sequence[Run], robot: Robot) -> Iterator[Finding]:
    """Find integer-valued commands, and torques far below all effort limits, in all ``runs``."""
    n, kind = len(runs[0].joints), runs[0].kind
    whole, values, peaks = 0, 0, np.zeros(n)
    for run in runs:
        for span in spans(len(run.time)):
            command = block(run.command, *span)[:, :n]
            whole, values = whole + int(np.sum(command == np.round(command))), values + command.size
            peaks = np.maximum(peaks, np.abs(command).max(axis=0))
    if whole > WHOLE * values and peaks.max() >= STEPS:  # stale samples were interpolated
        yield Finding(F.WHOLE_NUMBERS, values={"kind": kind, "largest": float(peaks.max())})
        return
    limits = {
        each.name: each.limits.effort for each in robot.joints if each.limits.effort and each.name in robot.motors
    }
    shares = {joint: peak / limits[joint] for joint, peak in zip(runs[0].joints, peaks, strict=True) if joint in limits}
    if kind != "torque" or len(set(limits.values())) < 2:  # the same for all joints is a placeholder
        return
    joint = max(shares, key=lambda name: shares[name])
    if shares[joint] < LIMIT_SHARE:
        yield Finding(F.MOTOR_SIDE, (joint,), values={"share": float(shares[joint]), "limit": limits[joint]})


def require_felt_payload(system: System) -> None:
    """Refuse logs whose currents are explained as well without the payload as with it.

    Each joint's current is fitted by its own equations, once with the columns of all payloads and once with none.

    Raises
    ------
    GtauError
        Where no joint's residual grows without them: the currents never felt the payload.
    """
    if not any(each.payload for each in system.payloads):
        return
    own = {name for each in system.payloads for name in each.unknown}
    problem = system.problem
    n = problem.n_theta
    if np.any(problem.total_rows < 3 * (n + 1)):
        return  # with so few equations, the robot's own parameters explain whatever the payload does
    robot_columns = [k for k, name in enumerate(problem.parameters) if name not in own]
    without = np.array([_residual(problem, j, robot_columns) for j in range(len(problem.joints))])
    with_all = np.array([_residual(problem, j, list(range(n + 1))) for j in range(len(problem.joints))])
    if np.all(without < UNFELT_PAYLOAD * with_all):
        name = next(each.payload.name for each in system.payloads if each.payload)
        raise GtauError(
            f"the currents are explained as well without payload '{name}' (residual of the worst joint "
            f"{100 * without.max():.2g} % of its current, {100 * with_all.max():.2g} % with it), so they do not fix "
            "the drive gains; give actual currents or the references of the current loops, not targets of the "
            "controller's own model, check which runs carry the payload, or log longer runs with a heavier one."
        )


def _residual(problem: Problem, joint: int, columns: list[int]) -> float:
    """Compute the relative residual of a joint's current, fitted by ``columns`` of its own equations."""
    R, v = problem.triangles[joint], SIGNAL
    solved = np.linalg.lstsq(R[:, columns], R[:, v], rcond=1e-10)[0]
    return float(np.linalg.norm(R[:, v] - R[:, columns] @ solved) / np.linalg.norm(R[:, v]))


def lack_of_fit(problem: Problem, solution: Solution) -> float:
    """Divide standard deviations by the jackknife by those for independent residuals; median over the parameters.

    Near 1 where the residuals are white; well above where they are autocorrelated, as the model lacks something.
    """
    known = np.diag(solution.covariance)[: problem.n_theta]
    ratio = np.diag(solution.jackknife)[: problem.n_theta][known > 0] / known[known > 0]
    return float(np.sqrt(np.median(ratio))) if ratio.size else 1.0
