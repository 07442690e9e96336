"""Whether the torque sensors agree with each other and with all else that is known of the scale."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gtau.estimation.diagnostics.linearisation import LinearisedWindow
from gtau.estimation.diagnostics.score_test import score_tests
from gtau.estimation.diagnostics.verdict import GOOD, Outcome, Verdict
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.newton import jacobian, jacobian_of_known, modelled, residuals, to_gains
from gtau.estimation.thresholds import APART


@dataclass(frozen=True, eq=False)
class SensorScale:
    """The torque of a joint by all else that is known, over that of its sensor, and the standard deviation of this.

    ``moves`` (n,) is by what share of itself each gain moves where the sensor's scale is found instead of taken for 1.
    """

    joint: str
    value: float
    std: float
    moves: np.ndarray

    def verdict(self, accuracy: float) -> Verdict:
        """Contradictory where it is not 1, by more than chance and by more than the ``accuracy``."""
        if abs(self.value - 1) <= max(APART * self.std, accuracy):
            return GOOD
        return Verdict(
            Outcome.CONTRADICTORY,
            f"by all else that is known its torques are {self.value:.4g} +- {self.std:.2g} times what it reads",
            "check its calibration and unit, and where it sits; a payload's mass or a known parameter may be wrong too",
        )


def sensor_scales(fit: Fit) -> tuple[SensorScale, ...]:
    """Find the scale of each torque sensor from all else that is known, to first order; of those where there is such.

    Each sensor is offered the torque of its model once more, see :func:`score_tests`.

    Parameters
    ----------
    fit : Fit
        With gains that were estimated.
    """
    problem, solution = fit.system.problem, fit.solution
    if not problem.sensors:
        return ()
    state, n = solution.iterate, len(problem.joints)
    weights = 1 / np.maximum(solution.sigma, problem.smallest_sigma)

    def windows() -> Iterator[LinearisedWindow]:
        for block in problem.blocks:
            e, J = residuals(block, state, problem.n_theta), jacobian(block, state, problem, True)
            torque = modelled(block, state.theta) * state.b[:, None]
            yield LinearisedWindow(
                e * weights[:, None], J * weights[:, None, None], -(torque * weights[:, None])[..., None]
            )

    known = jacobian_of_known(problem, problem.n_theta + 2 * len(problem.channels))
    (tests,) = score_tests(windows, [(slice(None), False)], known)
    T = to_gains(state, problem.n_theta, True)
    return tuple(
        SensorScale(
            joint,
            1 - float(tests.size[0, k]),
            float(tests.std[0, k]),
            (T @ tests.slopes[0, k])[problem.gain_rows] * tests.size[0, k] / fit.gains,
        )
        for k, joint in enumerate(problem.sensors, start=n)
        if np.isfinite(tests.std[0, k])
    )


def check_sensors(verdicts: Sequence[Verdict], found: Sequence[SensorScale], accuracy: float) -> tuple[Verdict, ...]:
    """Verdicts on the gains where a torque sensor that they rest on contradicts all else that is known."""
    wrong = [each for each in found if each.verdict(accuracy).outcome == Outcome.CONTRADICTORY]
    checked = list(verdicts)
    for each in sorted(wrong, key=lambda each: -float(np.abs(each.moves).max())):
        why = f"it rests on the torque sensor of '{each.joint}', which contradicts what else is known"
        for j in np.flatnonzero(np.abs(each.moves) > accuracy):
            if checked[j].outcome != Outcome.CONTRADICTORY:
                checked[j] = Verdict(Outcome.CONTRADICTORY, why, each.verdict(accuracy).advice)
    return tuple(checked)
