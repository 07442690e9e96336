"""What the uncertainty of payloads' masses, and of sensors' calibration, adds to the covariance of the estimates."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from gtau.estimation.estimators.estimator import Solution, Solve
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.equations import KNOWN, SIGNALS
from gtau.estimation.regression.flight import whole_mass
from gtau.estimation.regression.problem import Problem
from gtau.estimation.regression.system import System
from gtau.signals.payload import Payload


def scale_uncertainty(dataset: Dataset, system: System, solution: Solution, solve: Solve) -> np.ndarray:
    """Compute the covariance of (theta, gains, delays) that the uncertainty of what gives their scale adds.

    Each known mass, each torque sensor, the wrenches together, and the mass of a robot in flight are larger by a
    standard deviation in turn.
    """
    extra = np.zeros_like(solution.covariance)
    for problem in _with_other_scales(dataset, system):
        shift = solve(problem).stacked - solution.stacked
        extra += np.outer(shift, shift)
    return extra


def _with_other_scales(dataset: Dataset, system: System) -> Iterator[Problem]:
    masses = {run.payload.name: run.payload for run in dataset.runs if run.payload and run.payload.mass_std}
    for payload in masses.values():
        assert payload.mass is not None
        heavier = payload.model_copy(update={"mass": payload.mass + payload.mass_std})
        payloads = with_payload(dataset, payload.name, heavier)
        yield dataset.system(system.friction, system.problem.slowest > 0, payloads).problem
    problem, calibration = system.problem, dataset.runs[0].calibration
    if problem.of("base") and problem.silent[problem.of("base")].all():
        name = whole_mass(dataset.base, dataset.model.parameter_names)
        mass = dataset.priors[name]
        assert mass.value is not None
        assert mass.std is not None
        more = mass.model_copy(update={"value": mass.value + mass.std})
        of_heavier = replace(dataset, priors={**dataset.priors, name: more})
        yield of_heavier.system(system.friction, problem.slowest > 0).problem
    for k in problem.of("sensor") if calibration.joint_torque else ():
        blocks = problem.blocks.copy()
        blocks[:, k, :, SIGNALS] *= 1 + (calibration.joint_torque or 0.0)
        yield replace(problem, blocks=blocks)
    if calibration.wrenches:
        blocks = problem.blocks.copy()
        for k in problem.of("base"):
            blocks[:, k, :, SIGNALS] *= 1 + calibration.wrenches
        if system.of_wrenches is not None:
            blocks[..., KNOWN] += calibration.wrenches * system.of_wrenches
        yield replace(problem, blocks=blocks)


def with_payload(dataset: Dataset, name: str, other: Payload) -> Sequence[Payload | None]:
    """Replace the payload called ``name`` by ``other`` in the runs."""
    return [other if run.payload and run.payload.name == name else run.payload for run in dataset.runs]
