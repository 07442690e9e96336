"""Nonlinear programme of a design (IPOPT with exact first derivatives), and random start motions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from gtau.errors import GtauError
from gtau.excitation.constraints import WAY, ConstraintUsage, constraint_usages, usages_of_motion
from gtau.excitation.evaluation import Grid, Point, design_grid, evaluate, evaluate_one, objective
from gtau.excitation.information import criterion
from gtau.excitation.task import DesignProblem, close
from gtau.model.program import single_threaded_blas

ITERATIONS = 100
TOLERANCE = 1e-3  # of the logarithm of the criterion: 0.1 %
IPOPT: Mapping[str, int | float | str] = {
    "print_level": 0,
    "sb": "yes",
    "hessian_approximation": "limited-memory",
    "limited_memory_max_history": 20,
    "limited_memory_aug_solver": "extended",  # instead of one solution for each vector of the history
    "max_iter": ITERATIONS,
    "tol": TOLERANCE,
    "constr_viol_tol": 1e-4,
    "acceptable_tol": 3 * TOLERANCE,
    "acceptable_iter": 8,
    "acceptable_obj_change_tol": 1e-3,
    "mu_strategy": "adaptive",
    "mumps_pivot_order": 6,  # for dense columns: every number of a series acts on all instants
}


class Programme:
    """Criterion and limits of a task as functions of x, evaluated once for each x.

    ``tightness`` maps limits in words to the share of them that may be used; other limits do not count if it is not
    empty. ``best`` is the best x so far within these shares, and ``best_value`` the logarithm of its criterion.
    """

    def __init__(self, task: DesignProblem, criterion_name: str, tightness: Mapping[str, float]):
        self.task, self.tightness = task, tightness
        self.grid = design_grid(task)
        self.on_regressor = criterion_name == "condition"
        self.criterion = criterion(criterion_name, task.information)
        self.best: np.ndarray | None = None
        self.best_value = np.inf
        self._x = np.array([])
        self._last: tuple[Point, ...] = ()
        self._closed: tuple[Point, ...] = ()  # the last motions with closed loops
        self._usages: tuple[ConstraintUsage, ...] | None = None
        self._value: tuple[float, np.ndarray] | None = None

    def points(self, x: np.ndarray) -> tuple[Point, ...]:
        """Evaluate the motions for x; empty if they leave the reachable workspace."""
        if not np.array_equal(self._x, x):
            self._x = x.copy()
            try:
                self._last = self._closed = evaluate(self.task, x, self.grid, self._closed)
            except GtauError:
                self._last = ()
            self._usages = self._value = None
        return self._last

    def constraint_usages(self, x: np.ndarray) -> tuple[ConstraintUsage, ...]:
        """Compute the usage of all limits; empty if the motion is not reachable."""
        points = self.points(x)
        if self._usages is None:
            usages = constraint_usages(points)
            self._usages = tuple(usage for usage in usages if not self.tightness or usage.what in self.tightness)
        return self._usages

    def value(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Compute the logarithm of the criterion and its gradient (task.size,) by x; nan if x is not reachable."""
        points = self.points(x)
        if not points:
            return float("nan"), np.full(len(x), np.nan)
        if self._value is None:
            self._value = value, _ = objective(points, self.criterion, self.on_regressor)
            if self.tightness and value < self.best_value and self.excess(x) <= 1.0 + 1e-6:
                self.best, self.best_value = x.copy(), value
        return self._value

    def excess(self, x: np.ndarray) -> float:
        """Compute the largest usage relative to the tightness; infinite if x is not reachable."""
        if not self.points(x):
            return np.inf
        return max((usage.excess / self.tightness[usage.what] for usage in self.constraint_usages(x)), default=0.0)

    def bounds(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stack the lower and upper bounds of all values."""
        low, high = [], []
        for usage in self.constraint_usages(x):
            allowed = self.tightness[usage.what]
            low.append(np.full(len(usage.values), 1 / allowed if usage.least else -allowed))
            high.append(np.full(len(usage.values), np.inf if usage.least else allowed))
        return np.concatenate(low), np.concatenate(high)


def solve(programme: Programme, x: np.ndarray, stop: Callable[[], bool]) -> np.ndarray:
    """Minimise from the start x, and return the last x; ``programme`` keeps the best feasible one."""
    low, high = programme.bounds(x)

    def constraints(x: np.ndarray) -> np.ndarray:
        values = [usage.values for usage in programme.constraint_usages(x)]
        return np.concatenate(values or [np.full(len(low), np.nan)])

    def jacobian(x: np.ndarray) -> np.ndarray:
        rows = [usage.rows() for usage in programme.constraint_usages(x)]
        return np.concatenate(rows or [np.full((len(low), len(x)), np.nan)])

    symbol = ca.MX.sym("x", len(x))
    # the pattern of nonzeros, at a point without symmetry
    rows, columns = np.nonzero(jacobian(x))
    pattern = ca.Sparsity.triplet(len(low), len(x), rows.tolist(), columns.tolist())
    dense = ca.Sparsity.dense(1, len(x))
    scalar, values = ca.Sparsity.scalar(), ca.Sparsity.dense(len(low), 1)
    slope = dense, lambda x: programme.value(x)[1][None]
    f = _Function("f", [len(x)], scalar, lambda x: programme.value(x)[0], slope)
    g = _Function("g", [len(x)], values, constraints, (pattern, jacobian))
    sizes = {"x": len(x), "f": 1, "g": len(low), "lam_x": len(x), "lam_g": len(low)}
    results = [sizes.get(name, 0) for name in map(ca.nlpsol_out, range(ca.nlpsol_n_out()))]
    ended = _Function("stop", results, scalar, lambda *_: int(stop()))  # polled after every iteration
    solver = ca.nlpsol(
        "design",
        "ipopt",
        {"x": symbol, "f": f(symbol), "g": g(symbol)},
        {
            "iteration_callback": ended,
            "print_time": False,
            "show_eval_warnings": False,
            "ipopt": dict(IPOPT),
        },
    )
    with single_threaded_blas():  # once more, because the solver's libraries are loaded only now
        solution = solver(x0=x, lbg=low, ubg=high)
    return np.array(solution["x"]).ravel()


class _Function(ca.Callback):
    """A NumPy function of vectors of some ``sizes`` as a CasADi function, with its Jacobian if given."""

    def __init__(
        self,
        name: str,
        sizes: Sequence[int],
        pattern: ca.Sparsity,
        function: Callable[..., Any],
        jacobian: tuple[ca.Sparsity, Callable[[np.ndarray], np.ndarray]] | None = None,
        options: Mapping[str, Any] | None = None,
    ):
        ca.Callback.__init__(self)
        self._sizes, self._pattern, self._function, self._jacobian = sizes, pattern, function, jacobian
        self._held: list[ca.Callback] = []
        self.construct(name, dict(options or {}))

    def get_n_in(self) -> int:
        return len(self._sizes)

    def get_sparsity_in(self, k: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._sizes[k], 1)

    def get_sparsity_out(self, k: int) -> ca.Sparsity:
        return self._pattern

    def eval(self, arguments: Sequence[ca.DM]) -> list[Any]:
        return [self._function(*(np.array(argument).ravel() for argument in arguments))]

    def has_jacobian(self) -> bool:
        return self._jacobian is not None

    def get_jacobian(
        self, name: str, inames: Sequence[str], onames: Sequence[str], options: Mapping[str, Any]
    ) -> ca.Function:
        """Return a function of x and of the value, which it ignores."""
        assert self._jacobian is not None
        pattern, jacobian = self._jacobian
        places = np.array(pattern.row()), np.repeat(np.arange(pattern.shape[1]), np.diff(pattern.colind()))
        sizes = (*self._sizes, self._pattern.numel())
        function = _Function(name, sizes, pattern, lambda x, _: ca.DM(pattern, jacobian(x)[places]), options=options)
        self._held.append(function)
        return function


TRIES = 40  # scales of a random motion
CENTERS = 200  # random poses; the one with the most room is the center of a random motion
SPREAD = 0.7  # share of the ranges in which centers are drawn
DRAWS = 20  # random motions; the best is a start. One takes a hundredth of the time of the search that follows


def promising_start(
    task: DesignProblem, criterion: str, rng: np.random.Generator, part: float, stop: Callable[[], bool] = lambda: False
) -> np.ndarray | None:
    """Draw random x that use a ``part`` of the limits, and return the best; None if none is reachable."""
    values, drawn = list[float](), list[np.ndarray]()
    for _ in range(DRAWS):
        if drawn and stop():
            break
        if (x := random_start(task, rng, part)) is not None:
            # a new programme closes the loops from home, not from another motion
            value = Programme(task, criterion, {}).value(x)[0]
            if np.isfinite(value):
                values.append(value)
                drawn.append(x)
    return drawn[int(np.argmin(values))] if drawn else None


def random_start(task: DesignProblem, rng: np.random.Generator, part: float) -> np.ndarray | None:
    """Draw a random x (task.size,) that uses a ``part`` of what rest leaves of the limits; None if not reachable.

    Limits that rest violates, and the time away from reversals, are left to the search.
    """
    grid, parts = design_grid(task), []
    for runs in task.motions:
        x = task.series.random(rng)
        resting = _clear_center(task, rng, x)
        if (motion := _scaled(task, grid, runs, x, resting, part)) is not None:
            parts.append(motion)
    return np.concatenate(parts) if len(parts) == len(task.motions) else None


def _clear_center(task: DesignProblem, rng: np.random.Generator, x: np.ndarray) -> np.ndarray:
    """Draw x (series.size,) at rest in the pose with the most room; zero if no bodies are kept apart.

    If the loops cannot be closed on the way from rest to the center, it is the pose at rest.
    """
    series, clearance = task.series, task.limits.clearance
    resting = np.zeros_like(x)
    if series.in_platform_space:
        return resting
    if task.rest is not None and task.pullback is not None:
        q = task.rest[:, None] + np.outer(series.center - task.rest, WAY)
        try:
            close(task.model, np.stack([q, 0 * q, 0 * q]))
        except GtauError:
            resting.reshape(-1, series.free)[:, 0] = (task.rest - series.center) / series.half
    if clearance is None:
        return resting
    centers = rng.uniform(-SPREAD, SPREAD, (len(series.center), CENTERS))
    poses = series.center[:, None] + series.half[:, None] * centers
    start = poses if task.rest is None else np.broadcast_to(task.rest[:, None], poses.shape)
    q = start[:, :, None] + (poses - start)[:, :, None] * WAY
    q = q.reshape(len(q), -1)
    try:
        c = close(task.model, np.stack([q, 0 * q, 0 * q])).c
    except GtauError:  # not every pose is reachable
        return resting
    room = np.min([near.distance for near in clearance.all_nearest(c, clearance.pairs)], axis=0).reshape(CENTERS, -1)
    narrowest = room.min(axis=1)
    clear = narrowest >= clearance.least
    chosen = np.argmax(np.where(clear, room[:, -1], -np.inf) if clear.any() else narrowest)
    resting.reshape(-1, series.free)[:, 0] = centers[:, chosen]
    x.reshape(-1, series.free)[:, 0] = 0.0
    return resting


def _scaled(
    task: DesignProblem, grid: Grid, runs: tuple[int, ...], x: np.ndarray, resting_x: np.ndarray, part: float
) -> np.ndarray | None:
    """Scale x about ``resting_x`` until the motion uses a ``part`` of what rest leaves of the limits."""
    near: Point | None = None

    def used(x: np.ndarray) -> tuple[ConstraintUsage, ...] | None:
        nonlocal near
        try:
            near = evaluate_one(task, x, grid, runs, near)
        except GtauError:
            return None
        return tuple(usages_of_motion(near))

    resting = used(resting_x)
    if resting is None:
        return None
    at_rest = {usage.what: usage.shortfall for usage in resting if usage.shortfall < 0}

    scale, low, high = 1.0, 0.0, np.inf
    for _ in range(TRIES):
        moving = used(resting_x + scale * x)
        parts = (1 - usage.shortfall / at_rest[usage.what] for usage in moving or () if usage.what in at_rest)
        most = np.inf if moving is None else max(parts, default=1.0)
        if 0.95 * part <= most <= part:
            return resting_x + scale * x
        low, high = (scale, high) if most < part else (low, scale)
        scale = 2 * scale if np.isinf(high) else (low + high) / 2
    return resting_x + low * x
