"""What the uncertainty of the payloads' masses adds to the covariance of the estimates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gtau.estimation.estimators.estimator import Solve
from gtau.estimation.estimators.solution import Solution
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.system import System
from gtau.signals.payload import Payload


def mass_uncertainty(dataset: Dataset, system: System, solution: Solution, solve: Solve) -> np.ndarray:
    """Compute the covariance of (theta, gains, delays) that the uncertainty of the known masses adds."""
    extra = np.zeros_like(solution.covariance)
    masses = {run.payload.name: run.payload for run in dataset.runs if run.payload and run.payload.mass_std}
    for payload in masses.values():
        assert payload.mass is not None
        heavier = payload.model_copy(update={"mass": payload.mass + payload.mass_std})
        payloads = with_payload(dataset, payload.name, heavier)
        shift = (
            solve(dataset.system(system.friction, system.problem.slowest > 0, payloads).problem).stacked
            - solution.stacked
        )
        extra += np.outer(shift, shift)
    return extra


def with_payload(dataset: Dataset, name: str, other: Payload) -> Sequence[Payload | None]:
    """Replace the payload called ``name`` by ``other`` in the runs."""
    return [other if run.payload and run.payload.name == name else run.payload for run in dataset.runs]
