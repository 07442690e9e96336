"""Multi-start design of an exciting motion that satisfies its limits between grid instants as well."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
from scipy.ndimage import maximum_filter1d

from gtau.documents.validation import FUNCTION, TEXT, WHOLE, takes
from gtau.errors import GtauError
from gtau.excitation.constraints import CONDITION, MARGIN, ConstraintUsage, constraint_usages, whole_run
from gtau.excitation.nlp import ITERATIONS, Programme, promising_start, solve
from gtau.excitation.task import SPEED_FRACTION, DesignProblem, along, design_grid, evaluate
from gtau.findings import Progress, silent
from gtau.model.program import single_threaded_blas

START = 0.6  # share of the limits that a start uses, so that it is feasible
FINER = 10
STAGE = "searching"
CLOSER = 0.8  # factor on the limits of kinds REACH after a round in which loops could not be closed
REACH = ("position", CONDITION)
TIGHTER = 3.0  # largest factor by which a limit is tightened between two rounds
ROUNDS = 6  # of designing, checking and tightening
SMALLER = (1.0, 0.97, 0.93, 0.88, 0.8)  # scales tried for an interrupted motion; the first within all limits is kept


@dataclass(frozen=True, eq=False, repr=False)
class Design:
    """A designed motion x with its criterion and its usages of limits; ``cut_short`` if the search was stopped."""

    task: DesignProblem
    criterion: str
    x: np.ndarray
    value: float
    constraint_usages: tuple[ConstraintUsage, ...]
    start: int
    cut_short: bool = False

    def __repr__(self) -> str:
        cut = ", search cut short" if self.cut_short else ""
        return (
            f"Design({self.task.model.robot.name!r}, {self.criterion!r}: {self.value:.4g}, start {self.start + 1}{cut})"
        )


class Stopped(GtauError):
    """The search was stopped before it found a motion within the limits."""


@takes(
    task=("a design: task, _ = gtau.read_design('design.yaml')", (DesignProblem,)),
    criterion=TEXT,
    starts=WHOLE,
    seed=WHOLE,
    progress=FUNCTION,
    keep=FUNCTION,
    stop=FUNCTION,
)
@single_threaded_blas()
def excite(
    task: DesignProblem,
    criterion: str = "gains",
    starts: int = 2,
    seed: int = 0,
    progress: Progress | None = None,
    keep: Callable[[Design], None] | None = None,
    stop: Callable[[], bool] | None = None,
) -> Design:
    """Search for the motion that minimises a criterion, starting from ``starts`` random motions.

    Parameters
    ----------
    task : DesignProblem
        Robot, runs, limits and prior knowledge.
    criterion : str
        See :func:`gtau.excitation.information.criterion`.
    starts, seed : int
        Number of random starts, and the seed of their generator.
    progress : callable, optional
        Called with the stage, the number of iterations done, and their usual maximum.
    keep : callable, optional
        Called with every design that improves on the best one so far.
    stop : callable, optional
        Called in every iteration; the search ends with the best design so far once it returns True.

    Returns
    -------
    Design
        Best design within all limits.

    Raises
    ------
    GtauError
        If no motion within the limits is found, with the limit that is exceeded;
        :class:`gtau.excitation.design.Stopped` if the search was stopped before it found a motion.

    Examples
    --------
    >>> task, _ = gtau.read_design("design.yaml")
    >>> gtau.excite(task, starts=1).criterion
    'gains'
    """
    require_rest(task)
    reported, stopped = progress or silent, stop or (lambda: False)
    rng = np.random.default_rng(seed)
    best: Design | None = None
    failures: list[ConstraintUsage] = []
    total = starts * ITERATIONS
    ended = _polled(reported, stopped, total)
    reported(STAGE, 0, total)

    def better(candidate: Design) -> None:
        nonlocal best
        if best is None or candidate.value < best.value:
            best = candidate
            if keep is not None:
                keep(candidate)

    for start in range(starts):
        guess = promising_start(task, criterion, rng, START)
        worst = _from_one(task, criterion, guess, start, better, ended)
        if stopped():
            break
        if worst is not None:
            failures.append(worst)
    reported(STAGE, total, total)
    if best is not None:
        return replace(best, cut_short=stopped())
    if stopped():
        raise Stopped(
            "the search was stopped before it found a motion within the limits, so nothing is written; let it run "
            "longer."
        )
    raise _nothing_found(task, failures)


def _nothing_found(task: DesignProblem, failures: Sequence[ConstraintUsage]) -> GtauError:
    """Say why no motion was found, from the most exceeded limit of each start whose motions were reachable."""
    robot = task.model.robot.name
    if not failures:
        return GtauError(
            f"robot '{robot}': the loops cannot be closed along any motion that was tried, from rest to the middle of "
            "the position limits or of the workspace and about it; narrow them to what the robot can reach, lower "
            "limits.condition, or start from another pose ('rest')."
        )
    nearest = min(failures, key=lambda usage: usage.shortfall)
    return GtauError(
        f"robot '{robot}': no motion within the limits was found: the {nearest.what} must be {nearest.allowed}, "
        f"and the nearest motion reaches {nearest.reached:.4g}; relax this limit or the limits that conflict with "
        "it, or start from another pose ('rest')."
    )


@single_threaded_blas()
def redesign(task: DesignProblem, x: np.ndarray, progress: Progress = silent) -> Design | None:
    """Improve the motion ``x``, scaled down if needed; None if no scale is within the limits."""
    kept: list[Design] = []
    if (begin := _smaller(task, "gains", x, 0)) is not None:
        _from_one(task, "gains", begin.x, 0, kept.append, _polled(progress, lambda: False, ITERATIONS))
    return min(kept, key=lambda design: design.value, default=None)


def _polled(progress: Progress, stop: Callable[[], bool], total: int) -> Callable[[], bool]:
    """Make the function called in every iteration, which counts them and returns True to stop."""
    iterations = count()

    def ended() -> bool:
        progress(STAGE, min(next(iterations), total), total)
        return stop()

    return ended


def _from_one(
    task: DesignProblem,
    criterion: str,
    x: np.ndarray | None,
    start: int,
    keep: Callable[[Design], None],
    stop: Callable[[], bool],
) -> ConstraintUsage | None:
    """Design from one start and ``keep`` feasible designs; return the most exceeded limit if there is none."""
    if x is None:
        return None
    at_start = Programme(task, criterion, {}).constraint_usages(x)
    reach = {usage.what for usage in at_start if usage.kind in REACH}
    tightness = {usage.what: MARGIN for usage in at_start}
    if not tightness:  # not reachable from home
        return None
    begin, worst, near = x, None, None
    if (guess := _feasible(task, criterion, x, start)) is not None:
        keep(guess)  # the result of an early interruption
    for number in range(ROUNDS):
        programme = Programme(task, criterion, tightness)
        near = solve(programme, x, stop, near)
        if programme.best is None:
            worst = _most_exceeded(programme.constraint_usages(np.ravel(near["x0"])), 0.0) or worst
            break
        x = programme.best
        if stop() or number == ROUNDS - 1:
            if (within := _smaller(task, criterion, x, start)) is not None:
                keep(within)
            break
        if (usages := _usages(task, x)) is None:
            tightness = tightness | {what: CLOSER * part for what, part in tightness.items() if what in reach}
            x, near = begin, None
            continue
        if exceeded := {usage.what: usage.excess for usage in usages if usage.excess > 1.0}:
            worst = _most_exceeded(usages, -np.inf)
            tighter = {what: 0.98 * tightness[what] / min(excess, TIGHTER) for what, excess in exceeded.items()}
            tightness = tightness | tighter
            continue
        keep(Design(task, criterion, x, float(np.exp(programme.best_value)), usages, start))
        return None
    return worst


def _most_exceeded(usages: Iterable[ConstraintUsage], least: float) -> ConstraintUsage | None:
    """Find the limit that is exceeded most, by more than the share ``least``; None if there is none."""
    exceeded = (usage for usage in usages if usage.shortfall > least)
    return max(exceeded, key=lambda usage: usage.shortfall, default=None)


def _smaller(task: DesignProblem, criterion: str, x: np.ndarray, start: int) -> Design | None:
    """Scale x down until it is within all limits; None if no scale is."""
    return next(filter(None, (_feasible(task, criterion, part * x, start) for part in SMALLER)), None)


def _feasible(task: DesignProblem, criterion: str, x: np.ndarray, start: int) -> Design | None:
    """Return the design of x; None if it exceeds a limit, between the grid instants included."""
    usages = _usages(task, x)
    if usages is None or any(usage.excess > 1.0 for usage in usages):
        return None
    return Design(task, criterion, x, float(np.exp(Programme(task, criterion, {}).value(x)[0])), usages, start)


def _usages(task: DesignProblem, x: np.ndarray) -> tuple[ConstraintUsage, ...] | None:
    """Check x; None if the loops cannot be closed on the way from rest or between the grid instants."""
    try:
        return check(task, x)
    except GtauError:
        return None


def require_rest(task: DesignProblem) -> None:
    """Refuse a pose at rest that exceeds a limit whatever the motion."""
    if task.rest is None:
        return
    joints = np.zeros((4, len(task.rest), 2))
    joints[0] = task.rest[:, None]
    moving = np.full(len(task.rest), np.inf)  # reversals depend on the motion
    if worst := _most_exceeded(constraint_usages(along(task, joints, 1.0), moving), 1e-6):
        raise GtauError(
            f"robot '{task.model.robot.name}': no motion can begin or end at rest there: the {worst.what} must be "
            f"{worst.allowed}, and is {worst.reached:.4g}; start from another pose ('rest'), or relax the limit."
        )


def check(task: DesignProblem, x: np.ndarray) -> tuple[ConstraintUsage, ...]:
    """Compute the usage of limits by a whole run, with approach and return, on a grid ``FINER`` times finer."""
    grid = design_grid(task, FINER)
    period = evaluate(task, x, grid)
    joints = whole_run(task, period, 1 / grid.step)
    rms = np.sqrt(np.mean(joints[1] ** 2, axis=1))
    # the share of instants whose rows identification keeps
    qd, reach = period.joints[1], round(task.decimator.guard / task.rate / grid.step)
    slow = np.abs(qd) < SPEED_FRACTION * rms[:, None]
    slow |= np.sign(qd) != np.sign(np.roll(qd, 1, axis=1))
    share = 1 - maximum_filter1d(slow, 2 * reach + 1, axis=1, mode="wrap").mean(axis=1)
    return tuple(constraint_usages(along(task, joints, grid.step), share))
