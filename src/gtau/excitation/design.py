"""Designing a motion: many starts, each made to hold its limits between the instants of the design as well."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from gtau.errors import GtauError
from gtau.excitation.constraints import ConstraintUsage, constraint_usages, whole_run
from gtau.excitation.evaluation import Grid, Point, design_grid, evaluate
from gtau.excitation.initial_guesses import promising_start
from gtau.excitation.nlp import Programme, solve
from gtau.excitation.task import SPEED_FRACTION, DesignProblem, close

START = 0.6  # part of the limits that a start uses, so that it lies inside
FINER = 10
MARGIN = 0.99  # part of every limit that a first design may use
ROUNDS = 6  # of designing, checking and tightening
WORTH = 0.97  # another round from where the last one ended has paid if it comes below this part of the criterion


@dataclass(frozen=True, eq=False)
class Design:
    """A motion within its limits: x, the value of its criterion, and the loads on the finer grid."""

    task: DesignProblem
    criterion: str
    x: np.ndarray
    value: float
    constraint_usages: tuple[ConstraintUsage, ...]
    start: int


def nothing(best: Design | None, done: int, total: int) -> None:
    """Progress that nobody watches."""


def never() -> bool:
    """A design that nobody stops."""
    return False


@threadpool_limits.wrap(limits=1, user_api="blas")  # on matrices this small, threads only wait for each other
def design(
    task: DesignProblem,
    criterion: str = "gains",
    starts: int = 2,
    seed: int = 0,
    progress: Callable[[Design | None, int, int], None] = nothing,
    stop: Callable[[], bool] = never,
) -> Design:
    """The best motion that is found from ``starts`` random ones.

    Parameters
    ----------
    task : DesignProblem
        Robot, runs, limits and prior knowledge.
    criterion : str
        See :func:`gtau.excitation.criteria.criterion`.
    starts, seed : int
        Random motions to start from, and the seed of their generator.
    progress : callable, optional
        Called with the best design so far, the starts done and all starts.
    stop : callable, optional
        Asked again and again; when it says True, the best design so far is returned.

    Raises
    ------
    GtauError
        Where no motion within the limits is found, with the limit that does not hold; or nothing has been found yet
        when it is stopped.
    """
    rng = np.random.default_rng(seed)
    best: Design | None = None
    failure: ConstraintUsage | None = None
    done = 0
    for start in range(starts):
        progress(best, done, starts)
        if stop():
            break
        found, worst = _from_one(task, criterion, promising_start(task, criterion, rng, START), start, stop)
        if found is not None and (best is None or found.value < best.value):
            best = found
        if worst is not None and (failure is None or worst.shortfall < failure.shortfall):
            failure = worst
        done = start + 1
    progress(best, done, starts)
    if best is not None:
        return best
    robot = task.model.robot.name
    if failure is not None:
        raise GtauError(
            f"robot '{robot}': no motion holds the limits: the {failure.what} must be {failure.allowed}, and "
            f"the nearest motion found reaches {failure.reached:.4g}; relax this limit, or those that work against it."
        )
    if stop():
        raise GtauError("stopped before a motion within the limits was found; let it run longer.")
    raise GtauError(
        f"robot '{robot}': the loops cannot be closed around the middle of the position limits or of the workspace; "
        "narrow them to what the robot can reach."
    )


def _from_one(
    task: DesignProblem, criterion: str, x: np.ndarray | None, start: int, stop: Callable[[], bool]
) -> tuple[Design | None, ConstraintUsage | None]:
    """Design from one start; else the limit that is exceeded most where IPOPT ends."""
    if x is None:
        return None, None
    tightness = {load.what: MARGIN for load in Programme(task, criterion, {}).constraint_usages(x)}
    kept, worst = None, None
    for _ in range(ROUNDS):
        programme = Programme(task, criterion, tightness)
        ended = solve(programme, x, stop)
        best = programme.best
        if best is None and kept is not None:
            break
        if best is None:
            over = max(programme.constraint_usages(ended), key=lambda load: load.shortfall, default=None)
            return None, over if over is not None and over.shortfall > 0 else worst
        found = check(task, best)
        exceeded = [load for load in found if load.excess > 1.0]
        if exceeded:
            worst = max(exceeded, key=lambda load: load.shortfall)
            tightness = tightness | {load.what: 0.998 * tightness[load.what] / load.excess for load in exceeded}
        else:
            before = np.inf if kept is None else kept.value
            value = float(np.exp(programme.best_value))
            if value < before:
                kept = Design(task, criterion, best, value, found, start)
            if value > WORTH * before:
                break
        if stop():
            break
        x = best
    return kept, None if kept is not None else worst


def check(task: DesignProblem, x: np.ndarray, finer: int = FINER) -> tuple[ConstraintUsage, ...]:
    """Loads of all whole runs, approach and return included, on a grid ``finer`` times finer than the design's.

    Raises
    ------
    GtauError
        Where the robot cannot go there.
    """
    grid = design_grid(task, finer)
    points, shares = [], []
    for period in evaluate(task, x, grid):
        joints = whole_run(task, period.joints, 1 / grid.step)
        motion = close(task.model, joints[0], joints[1], joints[2], None)
        run = Grid(np.arange(joints.shape[2]) * grid.step, grid.step, np.empty((4, 0, 0)))
        points.append(Point(task, run, period.runs, joints, motion, None, task.regressor(motion)))
        rms = np.sqrt(np.mean(joints[1] ** 2, axis=1))
        shares.append(share_away(task, period.joints[1], grid.step, rms))
    return tuple(constraint_usages(points, shares))


def share_away(task: DesignProblem, qd: np.ndarray, step: float, rms: np.ndarray) -> np.ndarray:
    """Share (n,) of the instants of a period, ``step`` apart, whose rows identification will keep.

    ``rms`` (n,) are the joints' rms speeds in the whole run.
    """
    slow = np.abs(qd) < SPEED_FRACTION * rms[:, None]
    slow |= np.sign(qd) != np.sign(np.roll(qd, 1, axis=1))
    reach = round(task.decimator.support / task.rate / step)
    lost = slow.copy()
    for shift in range(1, reach + 1):
        lost |= np.roll(slow, shift, axis=1) | np.roll(slow, -shift, axis=1)
    return np.asarray(1 - lost.mean(axis=1))
