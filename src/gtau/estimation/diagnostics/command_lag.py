"""Whether the commands in the logs lag behind the motion: low-passed, held by a slower bus, or logged late.

Torque causes acceleration, so the command of a drive comes before the motion by its delay. One that comes after the
motion was filtered or stamped late. A low-pass of first order with time constant T makes ``v + T v'`` of what the
motion asks for; any other filter and a late stamp do so to first order. T follows from each joint's own equations,
whether its gain is estimated, given, or 1.
"""

from __future__ import annotations

import numpy as np

from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.problem import Problem
from gtau.estimation.regression.system import System
from gtau.estimation.thresholds.logs import DELAY_MOTION, LAG_LEAST, LAG_LOSS, LAG_SAMPLES, LAG_STD
from gtau.signals.notes import Kind, Note


def command_lags(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Estimate each joint's lag T of command behind motion, with standard error, both (n,) in s; NaN where unknown.

    It minimises what the joint's own model leaves of ``v + T v'``. Noise n of the command adds ``T^2 n'^2`` to that,
    which ``n n''`` takes away on average (parts integrated). The error is that of a ratio, from its scatter over the
    units.
    """
    lag, error = np.full(len(problem.joints), np.nan), np.full(len(problem.joints), np.nan)
    first = problem.n_theta + 1
    for j in range(len(problem.joints)):
        R, columns = problem.triangles[j], problem.own_columns[j]
        model = np.linalg.lstsq(R[:, columns], R[:, first:], rcond=None)[0]
        rest = problem.blocks[:, j, :, first:] - problem.blocks[:, j][:, :, columns] @ model
        r, rate, change = np.moveaxis(rest, -1, 0)  # (U, p) each
        along, whole = np.einsum("up,up->u", r, rate), np.einsum("up,up->u", rate, rate)
        of_motion = whole + np.einsum("up,up->u", r, change)
        share = of_motion.sum() / max(whole.sum(), 1e-300)
        if share * whole.sum() > DELAY_MOTION * np.linalg.norm(of_motion - share * whole):
            lag[j] = -along.sum() / of_motion.sum()
            error[j] = np.linalg.norm(along + lag[j] * of_motion) / of_motion.sum()
    return lag, error


def lag_notes(dataset: Dataset, system: System) -> list[Note]:
    """Note joints whose commands lag behind the motion in all runs; ``system`` is that of all runs."""
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
    phase = 2 * np.pi * bandwidth * lag
    size = f"by {1e3 * lag:.2g} ms (+-{1e3 * std:.2g} ms)" if phase < 1 else f"by more than {1e3 * lag / phase:.2g} ms"
    loss = 100 * (1 - 1 / np.sqrt(1 + phase**2))
    what = (
        f"the {kind}s lag behind the motion {size}, so they look low-passed, held or logged late; a low-pass of that "
        f"time constant attenuates them by {loss:.2g} % at the bandwidth of the motion, {bandwidth:.3g} Hz"
    )
    action = f"log the {kind}s before any filter and with the time stamps of the positions"
    return [Note(Kind.FILTERED if loss > 100 * LAG_LOSS else Kind.READING, what, action)]
