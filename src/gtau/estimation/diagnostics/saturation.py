"""Torque constants that fall with the current: whether torques grow less than the currents do.

Iron saturates, and drives log currents before they limit them. A payload then weighs the gain at the largest currents,
and the other parameters take up the rest so well that the size of the errors hardly tells: by its own mass a payload
shows a gain that is 12 per cent off where the constant falls by 10. The shape of the errors does tell.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gtau.estimation.diagnostics.linearisation import central_windows, linearise
from gtau.estimation.diagnostics.score_test import score_tests
from gtau.estimation.diagnostics.verdict import Outcome, Verdict
from gtau.estimation.estimators.solution import Solution
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.rows import Rows
from gtau.estimation.regression.system import System
from gtau.estimation.thresholds import SATURATION_SHARE, SATURATION_STD
from gtau.signals.preparation import InMemoryRun

PIECES = 10  # of a run, within which errors may hang together
LARGE = 2.0  # rms currents: where the fall is told


@dataclass(frozen=True)
class Saturation:
    """By what share a joint's torque constant falls up to the current ``at`` (A).

    How significant that is, and the ``share`` of the variance of the errors that it explains.
    """

    fall: float
    at: float
    t: float
    share: float


def find_saturation(dataset: Dataset, system: System, solution: Solution) -> tuple[Saturation, ...]:
    """What each of the n joints' currents (A) say of its torque constant, falls as shares of it.

    A term ``tau |tau|``, which at the current ``at`` is as large as the torque, is offered to each joint alone.
    """
    n, own = len(dataset.model.actuated), dataset.model.columns(dataset.base.standard)
    currents = LARGE * system.problem.signal
    scale = np.abs(solution.gains) * currents

    def offer(piece: InMemoryRun, values: np.ndarray, rows: Iterator[Rows]) -> Iterator[tuple[Rows, np.ndarray]]:
        for part in rows:
            tau = own.torques(part.entries, values, n)
            yield part, (np.abs(tau) * tau / scale[:, None])[:, :, None]

    pieces = linearise(dataset, system, solution, True, offer, central_windows(dataset, PIECES))
    found = score_tests(lambda: pieces, np.ones((1, len(pieces)), dtype=bool))
    each = zip(found.size[0], currents, found.t[0], found.share[0], strict=True)
    return tuple(Saturation(*map(float, values)) for values in each)


def check_saturation(verdicts: Sequence[Verdict], found: Sequence[Saturation]) -> tuple[Verdict, ...]:
    """Verdicts where the torque constant falls with the current, by as much as the errors say without doubt."""
    return tuple(
        verdict
        if verdict.outcome not in (Outcome.GOOD, Outcome.WEAK)
        or each.t < SATURATION_STD
        or each.share < SATURATION_SHARE
        else Verdict(
            Outcome.CONTRADICTORY,
            f"its torque grows less than its current: {100 * each.share:.0f} % of the errors' variance would go if the "
            f"gain fell by {100 * each.fall:.2g} % up to {each.at:.3g} A",
            "stay at lower currents, with slower motions or a lighter payload, and check that the log holds the "
            "current that flows; friction that grows with the load looks alike",
        )
        for verdict, each in zip(verdicts, found, strict=True)
    )
