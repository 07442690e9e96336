"""Whether the logs can be what they are said to be: a clock of another speed, currents that never felt the payload.

Estimators take these for properties of the robot and fail somewhere else. Units of positions are checked against the
robot's size before (:mod:`gtau.estimation.regression.motion_limits`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.regression.motion_limits import clock_advice
from gtau.estimation.regression.problem import Problem
from gtau.estimation.regression.system import System
from gtau.estimation.thresholds.refutation import UNFELT_PAYLOAD
from gtau.signals.run import Run


def other_clock(gravity: float, runs: Sequence[Run]) -> tuple[str, str]:
    """Explain, with advice, residuals that ask for gravity of the same direction, ``gravity`` times as large.

    Time that runs s times too fast makes velocities s and accelerations s^2 times too large, and with them the inertial
    torques against those of gravity, whose length on Earth is known to 0.3 %.
    """
    size, accelerations, rate = ("larger", "large", "high") if gravity > 1 else ("smaller", "small", "low")
    return (
        f"gravity would have to be {size}, as accelerations are too {accelerations}: the sampling rate is too {rate} "
        "(or all lengths of the robot are wrong)",
        f"{clock_advice(runs[0])}; then check the robot's lengths",
    )


def require_felt_payload(system: System) -> None:
    """Refuse logs whose currents are explained as well without the payload as with it.

    Each joint's current is fitted by its own equations, once with the columns of all payloads and once with none.

    Raises
    ------
    GtauError
        Where no joint's residual grows without them: the currents never felt the payload.
    """
    if not any(each.payload for each in system.payloads):
        return
    own = {name for each in system.payloads for name in each.unknown}
    problem = system.problem
    n = problem.n_theta
    if np.any(problem.total_rows < 3 * (n + 1)):
        return  # with so few equations, the robot's own parameters explain whatever the payload does
    robot_columns = [k for k, name in enumerate(problem.parameters) if name not in own]
    without = np.array([_residual(problem, j, robot_columns) for j in range(len(problem.joints))])
    with_all = np.array([_residual(problem, j, list(range(n + 1))) for j in range(len(problem.joints))])
    if np.all(without < UNFELT_PAYLOAD * with_all):
        name = next(each.payload.name for each in system.payloads if each.payload)
        raise GtauError(
            f"the currents are explained as well without payload '{name}' (residual of the worst joint "
            f"{100 * without.max():.2g} % of its current, {100 * with_all.max():.2g} % with it), so they do not fix "
            "the drive gains; give actual currents or the references of the current loops, not targets of the "
            "controller's own model, check which runs carry the payload, or log longer runs with a heavier one."
        )


def _residual(problem: Problem, joint: int, columns: list[int]) -> float:
    """Compute the relative residual of a joint's current, fitted by ``columns`` of its own equations."""
    R, v = problem.triangles[joint], problem.n_theta + 1
    solved = np.linalg.lstsq(R[:, columns], R[:, v], rcond=1e-10)[0]
    return float(np.linalg.norm(R[:, v] - R[:, columns] @ solved) / np.linalg.norm(R[:, v]))
