"""Logs too short, or too slow, to say anything of delays or of the robot."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from gtau.errors import GtauError
from gtau.estimation.diagnostics.effort import MiddleRows, _late
from gtau.estimation.diagnostics.log_checks import require_motion
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
    problem = SimpleNamespace(parameters=parameters, longest_delays=np.array([0.1]))
    middle = MiddleRows(SimpleNamespace(problem=problem, gains=np.ones(1)), rows, keep, 0.25, 2)  # type: ignore[arg-type]
    lags, _ = _late(middle)
    assert lags == ({0: pytest.approx(0.25)} if late else {})


@pytest.mark.parametrize(("share", "value", "refused"), [(7.0, 0.1, True), (0.3, 0.1, False), (7.0, 9.0, False)])
def test_logs_that_determine_nothing_are_refused(share: float, value: float, refused: bool) -> None:
    run = SimpleNamespace(rate=100.0, kind="torque")

    class Prepared:
        def __init__(self) -> None:
            self.run = run

        def __len__(self) -> int:
            return 291

    parameters = (Parameter("zz", "arm"), Parameter("fv", "arm"))
    problem = SimpleNamespace(
        parameters=parameters,
        n_theta=2,
        gain_rows=slice(2, 2),
        channels=(SimpleNamespace(joint="arm"),),
        balance=lambda theta: np.ones(1),
    )
    solution = SimpleNamespace(theta=np.array([value, 5.0]), sigma=np.array([share]))
    dataset = SimpleNamespace(prepared=[Prepared()], runs=[run])
    fit = SimpleNamespace(problem=problem, kind="torque", dataset=dataset, solution=solution)
    estimates = SimpleNamespace(values=np.array([value, 5.0]), covariance=np.eye(2))
    if refused:
        with pytest.raises(GtauError, match=r"2.91 s of motion determine none of the 1 inertial"):
            require_motion(fit, estimates)  # type: ignore[arg-type]
    else:
        require_motion(fit, estimates)  # type: ignore[arg-type]
