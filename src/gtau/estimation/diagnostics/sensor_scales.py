"""Scales of torque sensors: the model's torque from the other stated constants, over the sensor's reading."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gtau.estimation.diagnostics.verdict import APART, GOOD
from gtau.estimation.effects.linearisation import slopes_of, weighted, weights_of
from gtau.estimation.estimators.estimator import Fit, jackknife
from gtau.estimation.estimators.newton import jacobian_of_known, one_step, stacked, whitening
from gtau.estimation.regression.factors import modelled, triangle
from gtau.findings import Finding, Grade
from gtau.model.base_parameters import independent_columns
from gtau.signals.channel import Channel

SENSOR = "contradictory torque sensor"
SENSOR_ADVICE = "check the sensor's calibration, unit and joint; a payload's mass or a known parameter may be wrong too"


@dataclass(frozen=True, eq=False)
class SensorScale:
    """Ratio of a joint's torque from the other stated constants to its sensor's torque, with its standard deviation.

    Each gain moves by ``gain_shift`` (n,), a share of itself, where the scale of the sensor is estimated, not taken as
    1.
    """

    channel: Channel
    value: float
    std: float
    gain_shift: np.ndarray


def sensor_verdict(scale: SensorScale, accuracy: float) -> Finding:
    """Judge a scale: contradictory where it differs from 1 significantly and by more than the ``accuracy``."""
    if abs(scale.value - 1) <= max(APART * scale.std, accuracy):
        return GOOD
    return Finding(
        "sensor scale",
        text=f"all other data give torques {scale.value:.4g} times its reading (standard deviation {scale.std:.2g})",
        advice=SENSOR_ADVICE,
        grade=Grade.CONTRADICTORY,
        shown_as="model",
    )


def sensor_scales(fit: Fit) -> tuple[SensorScale, ...]:
    """Estimate the scale of each sensor from the other stated constants, to first order, where there are any.

    Each sensor gets the torque of its model once more, with an unknown factor; all other unknowns adapt to it.
    """
    problem, solution, sensors = fit.system.problem, fit.solution, fit.system.problem.sensor_channels
    if not sensors:
        return ()
    rows, *units = (_with_sensors(fit, blocks) for blocks in (stacked(problem), *problem.units))
    size = rows.shape[1] - len(sensors) - 1
    known = np.zeros((len(problem.known), rows.shape[1]))
    known[:, :size] = jacobian_of_known(problem, True)
    known[:, -1] = problem.known[:, :-1] @ solution.theta - problem.known[:, -1]
    R = triangle(rows, known)
    T = slopes_of(fit)[problem.gain_rows] / fit.gains[:, None]
    scales = []
    for k, sensor in enumerate(sensors):
        columns, channel = [*range(size), size + k], problem.channels[sensor]
        J = R[:, columns]
        if size not in independent_columns(J)[0]:
            continue  # without this sensor nothing gives the scale
        back = whitening(J, np.zeros(len(problem.channels)))
        step = -back @ (back.T @ (J.T @ R[:, -1]))
        sides = []
        for unit in units:
            A, e = unit[:, columns] @ back, unit[:, -1] + unit[:, columns] @ step
            sides.append((A.T @ A, A.T @ e))
        unseen = back[-1] @ (known[:, columns] @ back).T  # what no unit of the data shows
        variance = jackknife(one_step(sides) @ back[-1:].T)[0, 0] + unseen @ unseen
        std = float(np.hypot(np.sqrt(variance), channel.std))
        scales.append(SensorScale(channel, 1 - float(step[-1]), std, T @ step[:-1]))
    return tuple(scales)


def _with_sensors(fit: Fit, blocks: np.ndarray) -> np.ndarray:
    """Build weighted rows ``[J | sensor torques | residuals]`` (., size + m + 1) of all channels in blocks."""
    solution, sensors = fit.solution, fit.system.problem.sensor_channels
    torques = modelled(blocks, solution.theta) * (weights_of(fit) / solution.gains)[:, None]
    again = np.zeros((*torques.shape, len(sensors)))
    again[sensors, :, range(len(sensors))] = -torques[sensors]
    e, J = weighted(fit, blocks)
    rows = np.concatenate([J, again, e[..., None]], axis=-1)
    return np.asarray(rows.reshape(-1, rows.shape[-1]))


def sensor_contradictions(scales: Sequence[SensorScale], joints: Sequence[str], accuracy: float) -> Iterator[Finding]:
    """Find the gains of ``joints`` (n,) that rest on a sensor contradicting the other stated constants."""
    for scale in sorted(scales, key=lambda scale: -float(np.abs(scale.gain_shift).max())):
        moves = np.abs(scale.gain_shift)
        moved = tuple(joint for joint, move in zip(joints, moves, strict=True) if move > accuracy)
        if sensor_verdict(scale, accuracy).outcome == Grade.CONTRADICTORY and moved:
            sensor, joint = scale.channel.kind.name, scale.channel.joint
            text = f"the scale comes from the {sensor} of '{joint}', which contradicts all other data"
            yield Finding(SENSOR, moved, joint, text=text, advice=SENSOR_ADVICE, grade=Grade.CONTRADICTORY)
