"""Logs too slow to say anything of delays."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from gtau.estimation.diagnostics.effort import MiddleRows, _late
from gtau.robots.parameter import Parameter


@pytest.mark.parametrize(("inertia", "late"), [(1.0, True), (0.0, False)])
def test_no_lag_without_acceleration_that_shows_it(rng: np.random.Generator, inertia: float, late: bool) -> None:
    """A current of friction alone fits better a quarter of a second earlier, as controllers lead at reversals."""
    acceleration, friction, other = np.linalg.qr(rng.standard_normal((402, 3)))[0].T
    effort = inertia * acceleration + friction + 0.1 * other
    logged = np.roll(effort, 1)  # by a row
    signals = np.column_stack([logged, *np.zeros((2, 402))])
    rows = np.column_stack([acceleration, friction, np.zeros(402), signals])[None]
    parameters, keep = (Parameter("ia", "arm"), Parameter("fv", "arm")), np.zeros((1, 402), dtype=bool)
    keep[0, 2:-2] = True
    problem = SimpleNamespace(parameters=parameters, joints=("arm",))
    dataset = SimpleNamespace(preparation=SimpleNamespace(bandwidth=0.8))
    middle = MiddleRows(
        SimpleNamespace(problem=problem, gains=np.ones(1), kind="current", dataset=dataset),
        rows,
        0 * rows,
        keep,
        0.25,
        2,
    )  # type: ignore[arg-type]
    findings, _ = _late(middle)
    assert ["250 ms too late" in finding.text for finding in findings] == [True] * late
