"""How far joints were from their mean temperature in each stretch of the runs, for friction that depends on it.

Temperature changes so slowly that its mean over a stretch, a twentieth of a run, stands for it there: columns of
``(T - T_mean) qd`` and ``(T - T_mean) sign(qd)`` are then those of viscous and Coulomb friction in each stretch, times
a number, and nothing has to be streamed again for them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.regression.factors import STRETCHES
from gtau.signals.preparation import PreparedRun

INSTANTS = 50  # of a stretch, over which the mean is taken


@dataclass(frozen=True, eq=False)
class Temperatures:
    """Mean temperatures of joints over all runs, in ``unit``, and deviations from them.

    ``reference`` are the means by joint, ``of_stretches`` the deviations (stretches, n) in each run; those of joints
    without a temperature are zero. ``prepared`` are the runs.
    """

    reference: dict[str, float]
    of_stretches: tuple[np.ndarray, ...]
    unit: str
    prepared: tuple[PreparedRun, ...]

    def between(self, run: int, begin: float, end: float) -> np.ndarray:
        """Average the deviations (n,) between two instants of a run."""
        of, time = self.prepared[run].run, np.linspace(begin, end, INSTANTS)
        assert of.temperature is not None  # all runs have one
        means = {joint: of.temperature.at(joint, time).mean() - mean for joint, mean in self.reference.items()}
        return np.array([means.get(joint, 0.0) for joint in of.joints])


def temperatures_of(prepared: Sequence[PreparedRun]) -> Temperatures | None:
    """Find the deviations in all runs; None where none has a temperature, GtauError where some have."""
    found = [each.run.temperature for each in prepared]
    logged = [each for each in found if each is not None]
    if not logged:
        return None
    if len(logged) < len(found):
        lacking = next(each.run.name for each in prepared if each.run.temperature is None)
        raise GtauError(f"run '{lacking}' has no temperature, but other runs have; log it in all runs, or in none.")
    joints, runs = prepared[0].run.joints, []
    known = [joint for joint in joints if all(joint in each.of_joint for each in logged)]
    for each, temperature in zip(prepared, logged, strict=True):
        time = np.linspace(each.time[0], each.time[-1], STRETCHES * INSTANTS)
        means = [temperature.at(joint, time).reshape(STRETCHES, INSTANTS).mean(axis=1) for joint in known]
        runs.append(np.array(means).reshape(len(known), STRETCHES))
    reference = np.mean(np.hstack(runs), axis=1)
    deviations = []
    for of_known in runs:
        of_run = np.zeros((STRETCHES, len(joints)))
        for row, joint in zip(of_known - reference[:, None], known, strict=True):
            of_run[:, joints.index(joint)] = row
        deviations.append(of_run)
    return Temperatures(
        dict(zip(known, map(float, reference), strict=True)), tuple(deviations), logged[0].unit, tuple(prepared)
    )
