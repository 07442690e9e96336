"""Whether the torque sensors agree with each other and with all else that is known of the scale."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gtau.estimation.diagnostics.finding import Finding
from gtau.estimation.diagnostics.finding import FindingKind as F
from gtau.estimation.diagnostics.verdict import GOOD, Outcome, Verdict, verdict_of
from gtau.estimation.estimators.estimator import Fit, Iterate, jackknife
from gtau.estimation.estimators.newton import (
    jacobian,
    jacobian_of_known,
    one_step,
    residuals,
    stacked,
    to_gains,
    whitening,
)
from gtau.estimation.regression.equations import modelled, triangle
from gtau.estimation.regression.problem import Problem
from gtau.estimation.thresholds.estimates import APART
from gtau.model.base_parameters import independent_columns


@dataclass(frozen=True, eq=False)
class SensorScale:
    """The torque of a joint by all else that is known, over that of its sensor, and the standard deviation of this.

    ``moves`` (n,) is by what share of itself each gain moves where the sensor's scale is found instead of taken for 1.
    """

    joint: str
    value: float
    std: float
    moves: np.ndarray


def sensor_verdict(scale: SensorScale, accuracy: float) -> Verdict:
    """Judge a scale: contradictory where it differs from 1 significantly and by more than the ``accuracy``."""
    if abs(scale.value - 1) <= max(APART * scale.std, accuracy):
        return GOOD
    return verdict_of(Finding(F.SENSOR_SCALE, values={"scale": scale.value, "std": scale.std}))


def sensor_scales(fit: Fit) -> tuple[SensorScale, ...]:
    """Find the scale of each torque sensor from all else that is known, to first order, where there is such.

    Each sensor is offered the torque of its model once more, with an unknown factor; all other unknowns adapt to it.

    Parameters
    ----------
    fit : Fit
        With gains that were estimated.
    """
    problem, solution, sensors = fit.system.problem, fit.solution, fit.system.problem.of("sensor")
    if not sensors:
        return ()
    state = solution.iterate
    weights = 1 / np.maximum(solution.sigma, problem.smallest_sigma)
    whole, *units = (_linear(block, problem, state, weights) for block in (stacked(problem), *problem.blocks))
    size = whole.shape[1] - len(sensors) - 1
    of_known = np.zeros((len(problem.known), whole.shape[1]))
    of_known[:, :size] = jacobian_of_known(problem, size)
    of_known[:, -1] = problem.known[:, :-1] @ solution.theta - problem.known[:, -1]
    R = triangle(whole, of_known)
    T = to_gains(state, problem.n_theta, True)[problem.gain_rows] / fit.gains[:, None]
    found = []
    for k, sensor in enumerate(sensors):
        columns = [*range(size), size + k]
        J, e = R[:, columns], R[:, -1]
        if size not in independent_columns(J)[0]:
            continue  # without this sensor nothing gives the scale
        back = whitening(J, np.zeros(len(problem.channels)))
        step = -back @ (back.T @ (J.T @ e))
        sides = []
        for unit in units:
            A = unit[:, columns] @ back
            sides.append((A.T @ A, A.T @ (unit[:, -1] + unit[:, columns] @ step)))
        of_known_part = back[-1] @ (of_known[:, columns] @ back).T  # what no unit of the data shows
        variance = jackknife(one_step(sides) @ back[-1:].T)[0, 0] + of_known_part @ of_known_part
        std = float(np.hypot(np.sqrt(variance), fit.dataset.runs[0].calibration.joint_torque or 0.0))
        found.append(SensorScale(problem.channels[sensor].joint, 1 - float(step[-1]), std, T @ step[:-1]))
    return tuple(found)


def _linear(block: np.ndarray, problem: Problem, state: Iterate, weights: np.ndarray) -> np.ndarray:
    """Build weighted rows ``[J | sensor torques | residuals]`` (., size + m + 1) of all channels in a block."""
    torques, sensors = modelled(block, state.theta) * state.b[:, None], problem.of("sensor")
    offered = np.zeros((*torques.shape, len(sensors)))
    offered[sensors, :, range(len(sensors))] = -torques[sensors]
    J, e = jacobian(block, state, problem, True), residuals(block, state)
    rows = np.concatenate([J, offered, e[..., None]], axis=-1) * weights[:, None, None]
    return np.asarray(rows.reshape(-1, rows.shape[-1]))


def sensor_contradictions(found: Sequence[SensorScale], joints: Sequence[str], accuracy: float) -> Iterator[Finding]:
    """Find the gains of ``joints`` (n,) that rest on a torque sensor contradicting all else that is known."""
    for each in found:
        moves = np.abs(each.moves)
        moved = tuple(joint for joint, move in zip(joints, moves, strict=True) if move > accuracy)
        if sensor_verdict(each, accuracy).outcome == Outcome.CONTRADICTORY and moved:
            yield Finding(F.SENSOR, moved, each.joint, severity=float(moves.max()))
