"""Fifty experiments with which nothing is wrong: robots, motions and noise drawn anew, and no alarm."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from plausible_parameters import random_parameters
from scipy.stats import binom
from threadpoolctl import threadpool_limits

import gtau.model.base_parameters
from gtau.estimation.results.conclusions import INFLATED
from gtau.findings import Grade
from gtau.model.base_parameters import BaseParameters, base_parameters
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.result import identify
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run
from gtau.simulation.trajectories import envelope, point_to_point, sines

RATE, SECONDS = 400.0, 8.0
LOADS = (0.0, 0.0, 2.0, 2.0)
NOISE = 0.003  # of the rms current


@pytest.fixture(scope="module", autouse=True)
def quick() -> Iterator[None]:
    """Base parameters found once for each robot, and one thread."""
    found: dict[str, BaseParameters] = {}

    def remembered(model: InverseDynamics, sensors: tuple[str, ...] = ()) -> BaseParameters:
        name = model.robot.name
        return found.setdefault(name, found.get(name) or base_parameters(model, sensors=sensors))

    with pytest.MonkeyPatch.context() as patch, threadpool_limits(1, "blas"):
        patch.setattr(gtau.model.base_parameters, "base_parameters", remembered)
        yield


def experiment(model: InverseDynamics, rng: np.random.Generator) -> tuple[list[Run], np.ndarray]:
    """Runs without and with a payload, friction drifting by 2 % from one to the next, and the true gains."""
    chi, time = random_parameters(model, rng), np.arange(round(SECONDS * RATE) + 1) / RATE
    gains, tool, runs = rng.uniform(1.0, 5.0, len(model.actuated)), f"m_{model.robot.tool}", []
    for k, mass in enumerate(LOADS):
        q, qd, qdd = (sines, point_to_point)[k % 2](envelope(model.robot, 0.7), SECONDS, rng)(time)
        drift = {name: value * (1 + 0.02 * k) for name, value in chi.items() if name.startswith(("fv_", "fs_"))}
        tau = model.torques(q, qd, qdd, {**chi, **drift, tool: chi[tool] + mass})
        noise = NOISE * np.sqrt(np.mean(tau**2, axis=0)) * rng.standard_normal(tau.shape)
        payload = Payload(name="disc", mass=mass) if mass else None
        runs.append(Run(f"run {k}", model.actuated, time, q, (tau + noise) / gains, payload=payload))
    return runs, gains


@pytest.mark.slow
@pytest.mark.parametrize(
    ("source", "seeds"),
    [
        ("five-bar", range(5)),
        pytest.param("five-bar", range(5, 25), marks=pytest.mark.slow),
        pytest.param("delta", range(25), marks=pytest.mark.slow),
    ],
)
def test_no_alarm_in_clean_experiments(source: str, seeds: range) -> None:
    model = InverseDynamics(load_robot(source))
    alarms, outside = [], 0
    for seed in seeds:
        runs, gains = experiment(model, np.random.default_rng([7, seed]))
        result = identify(model.robot, runs)
        found = [gain.verdict for gain in result.drive_gains.values()]
        alarms += [(seed, verdict.sentence) for verdict in found if verdict.outcome == Grade.CONTRADICTORY]
        alarms += [(seed, "lack of fit")] if result.statistics["lack_of_fit"] > INFLATED else []
        for gain, truth in zip(result.drive_gains.values(), gains, strict=True):
            low, high = gain.interval(0.95) or (0.0, 0.0)
            outside += not low < truth < high
    assert alarms == []
    assert outside <= binom.isf(1e-4, len(seeds) * len(gains), 0.05)  # intervals of 95 %
