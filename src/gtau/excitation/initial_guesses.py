"""Random motions that go as far as the limits let them: where a search begins, and what it is compared with."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gtau.errors import GtauError
from gtau.excitation.constraints import ConstraintUsage, usages_of_motion
from gtau.excitation.evaluation import Grid, Point, design_grid, evaluate_one
from gtau.excitation.nlp import Programme
from gtau.excitation.task import DesignProblem

TRIES = 40  # of a scale
DRAWS = 20  # random motions, of which the best is a start: each costs a hundredth of the search that follows


def promising_start(
    task: DesignProblem,
    criterion: str,
    rng: np.random.Generator,
    part: float,
    stop: Callable[[], bool] = lambda: False,
) -> np.ndarray | None:
    """Choose the best x of some random ones that use a ``part`` of the limits; None where the robot cannot move so.

    Where ``stop`` returns True no more are drawn.
    """
    programme = Programme(task, criterion, {})
    drawn: list[np.ndarray] = []
    for _ in range(DRAWS):
        if drawn and stop():
            break
        if (x := random_start(task, rng, part)) is not None:
            drawn.append(x)
    return min(drawn, key=lambda x: programme.value(x)[0], default=None)


def random_start(task: DesignProblem, rng: np.random.Generator, part: float) -> np.ndarray | None:
    """Draw a random x (task.size,), each of its motions scaled until it uses a ``part`` of the limits.

    What a limit allows counts from what rest at the center uses of it already; limits that rest breaks, and those that
    ask for a least value, are left to the search. None where the robot cannot go there.
    """
    grid = design_grid(task)
    parts = [_scaled(task, grid, runs, task.series.random(rng), part) for runs in task.motions]
    return None if any(each is None for each in parts) else np.concatenate([each for each in parts if each is not None])


def _scaled(task: DesignProblem, grid: Grid, runs: tuple[int, ...], x: np.ndarray, part: float) -> np.ndarray | None:
    near: Point | None = None

    def used(x: np.ndarray) -> tuple[ConstraintUsage, ...] | None:
        nonlocal near
        try:
            near = evaluate_one(task, x, grid, runs, near)
        except GtauError:
            return None
        return tuple(usages_of_motion(near))

    resting = used(np.zeros_like(x))
    if resting is None:
        return None
    at_rest = {load.what: load.excess for load in resting if not load.least and load.excess < 1}
    scale, low, high = 1.0, 0.0, np.inf
    for _ in range(TRIES):
        moving = used(scale * x)
        most = np.inf if moving is None else max(
            ((load.excess - at_rest[load.what]) / (1 - at_rest[load.what]) for load in moving if load.what in at_rest),
            default=1.0,
        )  # fmt: skip
        if 0.95 * part <= most <= part:
            return scale * x
        low, high = (scale, high) if most < part else (low, scale)
        scale = 2 * scale if np.isinf(high) else (low + high) / 2
    return low * x
