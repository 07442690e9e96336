"""Slow motions logged at low rates: few rows after decimation, and hardly any motion in the currents' rate."""

from __future__ import annotations

import numpy as np
import pytest
from orthoglide_logs import orthoglide

from gtau.demo import SIMULATION
from gtau.estimation.diagnostics.log_checks import lack_of_fit
from gtau.estimation.estimators.maximum_likelihood import ml
from gtau.estimation.estimators.newton import FLATTEST, curved, delays_lost_in_noise
from gtau.estimation.regression.dataset import reduce_runs
from gtau.findings import Grade
from gtau.model.home import load_robot
from gtau.result import identify
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run

ROBOT = load_robot("orthoglide")
GAIN, MASS = 2100.0, 1.983


def logs(rate: float, slowest: float, seconds: float, noise: float) -> list[Run]:
    """A free and a loaded run along the same five harmonics of ``slowest`` Hz, with white noise of the currents."""
    rng, chi = np.random.default_rng(4), SIMULATION.parameters
    t = np.arange(round(seconds * rate))[:, None] / rate
    q, qd, qdd = (np.zeros((len(t), 3)) for _ in range(3))
    draw = np.random.default_rng(0)
    for w in 2 * np.pi * slowest * np.arange(1, 6):
        a, b = 0.008 * draw.normal(size=(2, 3))
        q += a * np.sin(w * t) + b * (np.cos(w * t) - 1)
        qd += w * (a * np.cos(w * t) - b * np.sin(w * t))
        qdd -= w * w * (a * np.sin(w * t) + b * np.cos(w * t))
    q += [ROBOT.joint(joint).home for joint in ROBOT.actuated]
    runs = []
    for mass in (0.0, MASS):
        current = orthoglide().torques(q, qd, qdd, {**chi, "m_P": chi["m_P"] + mass}) / GAIN
        current += noise * current.std(axis=0) * rng.standard_normal(current.shape)
        payload = Payload(name="known", mass=mass) if mass else None
        runs.append(Run(f"{mass:g} kg", ROBOT.actuated, t[:, 0], q, current, payload=payload))
    return runs


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rate", "slowest", "seconds", "noise"),
    [
        pytest.param(
            80.0, 0.3, 75.0, 1e-3, marks=pytest.mark.slow
        ),  # once "did not settle", as steps cannot be smaller than rounding
        pytest.param(30.0, 0.2, 100.0, 1e-3, marks=pytest.mark.slow),
        pytest.param(50.0, 0.3, 120.0, 1e-2, marks=pytest.mark.slow),
        (40.0, 0.3, 120.0, 1e-2),  # once contradictory, by delays that a joint's own equations do not tell
        (80.0, 0.3, 75.0, 1e-2),  # once not identifiable, as the rest of one stretch had no curvature in a delay
    ],
)
def test_gains_of_slow_logs(rate: float, slowest: float, seconds: float, noise: float) -> None:
    """With noise of one per cent, slow motions leave a small tilt of gravity open, which '12' does not settle."""
    result = identify(ROBOT, logs(rate, slowest, seconds, noise))
    weak = {joint for joint, gain in result.drive_gains.items() if gain.verdict.outcome == Grade.WEAK}
    assert weak <= ({"12"} if noise > 1e-3 else set())
    for joint, gain in result.drive_gains.items():
        assert joint in weak or gain.verdict.outcome == Grade.GOOD
        assert gain.value == pytest.approx(GAIN, rel=2 * noise)
        assert abs((gain.value or 0.0) - GAIN) < 3.5 * (gain.std or 0.0) < 0.15 * GAIN


def test_delays_lost_in_noise_are_told_from_those_that_are_not() -> None:
    """They would be anything up to the longest: 13 ms here, where there is none."""
    problem = reduce_runs(ROBOT, logs(20.0, 0.05, 100.0, 5e-2)).system(per_run=True).problem
    assert delays_lost_in_noise(problem, ml(problem)).tolist() == [True, True, False]


@pytest.mark.slow
def test_a_delay_lost_in_noise_is_not_estimated() -> None:
    delays = identify(ROBOT, logs(20.0, 0.05, 100.0, 5e-2)).delays
    assert {joint for joint, delay in delays.items() if delay.value == 0.0} == {"11", "12"}
    assert {delays[joint].verdict.outcome for joint in ("11", "12")} == {Grade.NOT_IDENTIFIABLE}
    assert delays["13"].value == pytest.approx(0.0, abs=2 * (delays["13"].std or 0.0))


def test_leaving_a_stretch_out_keeps_the_curvature() -> None:
    data = reduce_runs(ROBOT, logs(80.0, 0.3, 75.0, 1e-2))
    problem = data.system(per_run=True).problem
    assert lack_of_fit(problem, ml(problem)) == pytest.approx(1.1, abs=0.4)


def test_curvature_is_kept_where_there_is_enough_and_raised_where_not() -> None:
    rng = np.random.default_rng(3)
    A, v = rng.normal(size=(9, 4)), rng.normal(size=4)
    gauss = A.T @ A
    smallest = 1 / (v @ np.linalg.solve(gauss, v))  # of v v^T, that takes all curvature away in one direction
    np.testing.assert_array_equal(
        curved(gauss, -0.5 * smallest * np.outer(v, v)), gauss - 0.5 * smallest * np.outer(v, v)
    )
    for share in (1.0, 3.0):
        raised = curved(gauss, -share * smallest * np.outer(v, v))
        shares = np.linalg.eigvals(np.linalg.solve(gauss, raised)).real
        np.testing.assert_allclose(np.sort(shares), [FLATTEST, 1, 1, 1], rtol=1e-9)
