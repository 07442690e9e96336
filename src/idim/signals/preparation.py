"""From a run to what the model and the estimators take: q, qd, qdd, the command, and a mask."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from idim.errors import IdimError
from idim.signals.decimation import Decimator, decimation_factor
from idim.signals.filters import STENCIL, bandwidth, cutoff_frequency, differentiate, joint_bandwidths, position_filter
from idim.signals.run import Run


@dataclass(frozen=True)
class Preparation:
    """How the runs of an experiment are prepared, the same for all.

    ``bandwidth`` of the motion and ``cutoff`` of the position filter (None: no filter) in Hz. A joint's
    row is left out where its speed is below ``speed_fraction`` of the joint's rms speed.
    """

    bandwidth: float
    cutoff: float | None
    decimator: Decimator
    speed_fraction: float = 0.05


@dataclass(frozen=True, eq=False)
class Prepared:
    """A run ready for the model; all arrays share the sample axis N and the joints' axis n.

    ``q``, ``qd``, ``qdd`` (N, n) in rad or m, s; ``command`` (N, n) and its time derivatives
    ``command_d``, ``command_dd``, the columns of a delay. ``usable`` (N, n) is False where a joint's row
    must not be used: around the joint's reversals and rests, at gaps, at the ends of the filter, and
    always for a joint that does not move. ``time`` (N,) in s, ``rate`` in Hz.
    """

    run: Run
    time: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    command: np.ndarray
    command_d: np.ndarray
    command_dd: np.ndarray
    usable: np.ndarray
    rate: float
    notes: tuple[str, ...] = ()


def choose_preparation(runs: Sequence[Run], decimator: Literal["fir", "chebyshev"] = "fir") -> Preparation:
    """Choose the preparation of an experiment from its runs.

    The bandwidth is the largest of the runs'; filter and decimation follow from it and from the lowest
    sampling rate.

    Parameters
    ----------
    runs : sequence of Run
        All runs of the experiment.
    decimator : {"fir", "chebyshev"}
        The compact FIR, or the paper's filter.

    Returns
    -------
    Preparation

    Raises
    ------
    IdimError
        In a run nothing moves, or the runs' sampling rates differ by more than a tenth.
    """
    slowest, fastest = min(runs, key=lambda run: run.rate), max(runs, key=lambda run: run.rate)
    if fastest.rate > 1.1 * slowest.rate:
        raise IdimError(
            f"run '{slowest.name}' is sampled at {slowest.rate:.4g} Hz and run '{fastest.name}' at "
            f"{fastest.rate:.4g} Hz; give runs of one rate."
        )
    highest = max(bandwidth(run) for run in runs)
    return Preparation(
        bandwidth=highest,
        cutoff=cutoff_frequency(highest, slowest.rate),
        decimator=Decimator(decimation_factor(slowest.rate, highest), decimator),
    )


def prepare(run: Run, preparation: Preparation) -> Prepared:
    """Filter, differentiate, mask and trim a run.

    The rest at the beginning and the end, where no joint exceeds its speed threshold, is cut off.

    Parameters
    ----------
    run : Run
        One run.
    preparation : Preparation
        Of its experiment.

    Returns
    -------
    Prepared
        Not decimated: the decimator takes the columns of the model.

    Raises
    ------
    IdimError
        No joint moves, or the log is shorter than its filters.
    """
    q, qd, qdd, edge = position_filter(run.position, run.rate, preparation.cutoff)
    moves = np.isfinite(joint_bandwidths(run.position, run.rate))
    valid = _shrink(run.valid, STENCIL)
    valid[:edge] = valid[len(valid) - edge :] = False
    moving = faster(qd, preparation.speed_fraction) & moves & valid[:, None]
    if not moving.any():
        raise IdimError(
            f"run '{run.name}': no joint moves between its filters' ends ({edge} of {len(valid)} samples at either "
            "side); give a longer log of a moving robot."
        )
    awake = np.flatnonzero(moving.any(axis=1))
    kept = slice(int(awake[0]), int(awake[-1]) + 1)
    command_d, command_dd = differentiate(run.command, run.rate)
    return Prepared(
        run=run,
        time=run.time[kept],
        q=q[kept],
        qd=qd[kept],
        qdd=qdd[kept],
        command=run.command[kept],
        command_d=command_d[kept],
        command_dd=command_dd[kept],
        # Once more, as rest lowers the rms speed that the threshold refers to.
        usable=faster(qd[kept], preparation.speed_fraction) & moves & valid[kept, None],
        rate=run.rate,
        notes=tuple(
            f"joint '{joint}' hardly moves: its rows are left out"
            for joint, moving in zip(run.joints, moves, strict=True)
            if not moving
        ),
    )


def faster(qd: np.ndarray, fraction: float) -> np.ndarray:
    """Where each joint is faster than a fraction of its rms speed (N, n)."""
    return np.abs(qd) >= fraction * np.sqrt(np.mean(qd**2, axis=0))


def _shrink(valid: np.ndarray, margin: int) -> np.ndarray:
    """A mask with its false parts widened by `margin` samples to either side."""
    bad = np.convolve(~valid, np.ones(2 * margin + 1), mode="same") > 0.5
    return ~bad
