"""Nonlinear programme of a design (IPOPT with exact first derivatives), and random start motions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any

import casadi as ca
import numpy as np

from gtau.errors import GtauError
from gtau.estimation.regression.factors import triangle
from gtau.excitation.constraints import WAY, ConstraintUsage, constraint_usages
from gtau.excitation.information import Criterion, criterion
from gtau.excitation.task import DesignProblem, Point, close, design_grid, evaluate
from gtau.model.program import single_threaded_blas

ITERATIONS = 150
IPOPT: Mapping[str, int | float | str] = {
    "print_level": 0,
    "sb": "yes",
    "hessian_approximation": "limited-memory",
    "limited_memory_max_history": 20,
    "limited_memory_aug_solver": "extended",  # instead of one solution for each vector of the history
    "max_iter": ITERATIONS,
    "tol": 1e-3,  # of the logarithm of the criterion: 0.1 %
    "constr_viol_tol": 1e-4,
    # The change of the objective alone decides. Of 24 searches of four robots, ending one that gains 0.3 % in twelve
    # iterations is 2 % worse, in six 4 %; three iterations within 2e-4 lose one of an Orthoglide.
    "acceptable_tol": 1e3,
    "acceptable_iter": 5,
    "acceptable_obj_change_tol": 1e-4,
    "mu_strategy": "adaptive",
    "mumps_pivot_order": 6,  # for dense columns: every number of a series acts on all instants
    "mumps_mem_percent": 20,  # instead of 1000, which the kernel would map anew in every factorisation
}
# From a solution for other limits, which a start further from its bounds would lose: twelve motions of four robots take
# two thirds of the time, and have criteria within 0.3 %. With 1e-4 one of a UR10e is 2.5 % higher, with 1e-3 7 %.
AGAIN: Mapping[str, float | str] = {
    "warm_start_init_point": "yes",
    "mu_strategy": "monotone",
    "mu_init": 1e-5,
    **{f"warm_start_{part}": 1e-6 for part in ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac")},
}


def information(point: Point) -> np.ndarray:
    """Compute the triangular factor (P, P) of the information of all runs."""
    size = np.sqrt(_counts(point))[:, :, None]
    return triangle(*((size * A).reshape(-1, A.shape[2]) for A in point.jacobians))


def _counts(point: Point) -> np.ndarray:
    """Compute the information (n, N) of a motion's rows, 1/A2."""
    step, task = point.grid.step, point.task
    return task.window(step).weights(point.joints[1]) * (task.information.counts * step)[:, None]


def objective(point: Point, criterion: Criterion, on_regressor: bool) -> tuple[float, np.ndarray]:
    """Compute the logarithm of a criterion of the information or the regressor, and its gradient by x."""
    if on_regressor:
        value, F, f = criterion(triangle(point.W.reshape(-1, point.W.shape[2])))
        return value, point.to_rows(point.by_joints(2 * (point.W @ F * f) @ F.T)).sum(axis=0)
    value, F, f = criterion(information(point))
    info, step, counts = point.task.information, point.grid.step, _counts(point)
    by_W, by_counts = np.zeros_like(point.W), np.zeros_like(counts)
    for run, A in enumerate(point.jacobians):
        along = A @ F
        by_W += info.back(2 * counts[:, :, None] * ((along * f) @ F.T), run, step)
        by_counts += along**2 @ f
    by_joints = point.by_joints(by_W)
    by_weights = by_counts * (info.counts * step)[:, None]
    by_joints[1] += point.task.window(step).back(point.joints[1], by_weights)
    return value, point.to_rows(by_joints).sum(axis=0)


class Programme:
    """Criterion and limits of a task as functions of x, evaluated once for each x.

    ``tightness`` maps limits in words to the share of them that may be used. ``best`` is the best x so far within these
    shares, and ``best_value`` the logarithm of its criterion.
    """

    def __init__(self, task: DesignProblem, criterion_name: str, tightness: Mapping[str, float]):
        self.task, self.tightness = task, tightness
        self.grid = design_grid(task)
        self.on_regressor = criterion_name == "condition"
        self.criterion = criterion(criterion_name, task.information)
        self.best: np.ndarray | None = None
        self.best_value = np.inf
        self._x = np.array([])
        self._last: Point | None = None
        self._closed: Point | None = None  # the last motion with closed loops
        self._usages: tuple[ConstraintUsage, ...] | None = None
        self._value: tuple[float, np.ndarray] | None = None

    def point(self, x: np.ndarray) -> Point | None:
        """Evaluate the motion for x; None if it leaves the reachable workspace."""
        if not np.array_equal(self._x, x):
            self._x = x.copy()
            try:
                self._last = self._closed = evaluate(self.task, x, self.grid, self._closed)
            except GtauError:
                self._last = None
            self._usages = self._value = None
        return self._last

    def constraint_usages(self, x: np.ndarray) -> tuple[ConstraintUsage, ...]:
        """Compute the usage of all limits; empty if the motion is not reachable."""
        point = self.point(x)
        if self._usages is None:
            self._usages = () if point is None else tuple(constraint_usages(point))
        return self._usages

    def value(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Compute the logarithm of the criterion and its gradient by x; nan if x is not reachable."""
        if (point := self.point(x)) is None:
            return float("nan"), np.full(len(x), np.nan)
        if self._value is None:
            self._value = value, _ = objective(point, self.criterion, self.on_regressor)
            if self.tightness and value < self.best_value and self.excess(x) <= 1.0 + 1e-6:
                self.best, self.best_value = x.copy(), value
        return self._value

    def excess(self, x: np.ndarray) -> float:
        """Compute the largest usage relative to the tightness; infinite if x is not reachable."""
        if self.point(x) is None:
            return np.inf
        return max((usage.excess / self.tightness[usage.what] for usage in self.constraint_usages(x)), default=0.0)


def solve(
    programme: Programme, x: np.ndarray, stop: Callable[[], bool], near: Mapping[str, ca.DM] | None
) -> Mapping[str, ca.DM]:
    """Minimise from x; return the last x and multipliers, ``near`` the next; ``programme`` keeps the best of all x.

    Raises the first exception of Ctrl-C, ``stop`` or a function evaluated; CasADi would print it and go on.
    """
    errors: list[BaseException] = []
    usages = programme.constraint_usages(x)
    sizes = [len(usage.values) for usage in usages]
    allowed = np.array([programme.tightness[usage.what] for usage in usages])
    least = np.array([usage.least for usage in usages])
    low = np.repeat(np.where(least, 1 / allowed, -allowed), sizes)
    high = np.repeat(np.where(least, np.inf, allowed), sizes)

    def limits(x: np.ndarray) -> np.ndarray:
        values = [usage.values for usage in programme.constraint_usages(x)]
        return np.concatenate(values or [np.full(len(low), np.nan)])

    def jacobian(x: np.ndarray) -> np.ndarray:
        rows = [usage.rows() for usage in programme.constraint_usages(x)]
        return np.concatenate(rows or [np.full((len(low), len(x)), np.nan)])

    # the pattern of nonzeros, at a point without symmetry
    rows, columns = np.nonzero(jacobian(x).T)[::-1]
    pattern = ca.Sparsity.triplet(len(low), len(x), rows.tolist(), columns.tolist())
    again: Mapping[str, Any] = near if near is not None and near["lam_g0"].numel() == len(low) else {}

    def solved() -> Mapping[str, ca.DM]:
        scalar, slope, values = (ca.Sparsity.dense(size, 1) for size in (1, len(x), len(low)))
        results = {"x": len(x), "f": 1, "g": len(low), "lam_x": len(x), "lam_g": len(low)}
        f = _Function(errors, [len(x)], [scalar], lambda x: [programme.value(x)[0]])
        g = _Function(errors, [len(x)], [values], lambda x: [limits(x)])
        f_slope = _Function(errors, [len(x), 0], [scalar, slope], programme.value)
        g_slopes = _Function(errors, [len(x), 0], [values, pattern], lambda x: [limits(x), jacobian(x)[rows, columns]])
        polled = [results.get(name, 0) for name in map(ca.nlpsol_out, range(ca.nlpsol_n_out()))]
        ended = _Function(errors, polled, [scalar], lambda _: [bool(errors) or stop()])  # after every iteration
        symbol = ca.MX.sym("x", len(x))
        solver = ca.nlpsol(
            "design",
            "ipopt",
            {"x": symbol, "f": f(symbol), "g": g(symbol)},
            {
                "no_nlp_grad": True,
                "grad_f": f_slope,
                "jac_g": g_slopes,
                "iteration_callback": ended,
                "print_time": False,
                "show_eval_warnings": False,
                "ipopt": {**IPOPT, **(AGAIN if again else {})},
            },
        )
        return solver(**{**again, "x0": x, "lbg": low, "ubg": high})

    solution = _in_thread(single_threaded_blas()(solved), errors)
    return {f"{name}0": solution[name] for name in ("x", "lam_x", "lam_g")}


def _in_thread(solved: Callable[[], Mapping[str, ca.DM]], errors: list[BaseException]) -> Mapping[str, ca.DM]:
    """Solve, which ends at the first of the ``errors``, and raise that; CasADi loses Ctrl-C in the main thread."""
    with ThreadPoolExecutor(1) as thread:
        solution = thread.submit(solved)
        try:
            wait([solution])
        except BaseException as error:
            errors.append(error)
    if errors:
        raise errors[0]
    return solution.result()


class _Function(ca.Callback):
    """A NumPy function of the first of some vectors as a CasADi function; its outputs are the nonzeros of patterns."""

    def __init__(
        self,
        errors: list[BaseException],
        sizes: Sequence[int],
        patterns: Sequence[ca.Sparsity],
        function: Callable[..., Sequence[Any]],
    ):
        ca.Callback.__init__(self)
        self._errors, self._sizes, self._patterns, self._function = errors, sizes, patterns, function
        self.construct("function", {})

    def get_n_in(self) -> int:
        return len(self._sizes)

    def get_n_out(self) -> int:
        return len(self._patterns)

    def get_sparsity_in(self, k: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._sizes[k], 1)

    def get_sparsity_out(self, k: int) -> ca.Sparsity:
        return self._patterns[k]

    def has_eval_buffer(self) -> bool:
        return True

    def eval_buffer(self, arguments: Sequence[memoryview], results: Sequence[memoryview | None]) -> int:
        try:
            for result, value in zip(results, self._function(np.frombuffer(arguments[0])), strict=True):
                if result is not None:  # wanted
                    np.frombuffer(result)[:] = value
        except BaseException as error:
            self._errors.append(error)
        return len(self._errors)


TRIES = 40  # scales of a random motion
CENTERS = 200  # random poses; the one with the most room is the center of a random motion
SPREAD = 0.7  # share of the ranges in which centers are drawn
DRAWS = 20  # random motions; the best is a start. One takes a hundredth of the time of the search that follows


def promising_start(task: DesignProblem, criterion: str, rng: np.random.Generator, part: float) -> np.ndarray | None:
    """Draw random x that use a ``part`` of the limits, and return the best; None if none is reachable."""

    def value(x: np.ndarray) -> float:  # a new programme closes the loops from home, not from another motion
        return float(np.nan_to_num(Programme(task, criterion, {}).value(x)[0], nan=np.inf))

    drawn = (random_start(task, rng, part) for _ in range(DRAWS))
    return min((x for x in drawn if x is not None), key=value, default=None)


def random_start(task: DesignProblem, rng: np.random.Generator, part: float) -> np.ndarray | None:
    """Draw a random x that uses a ``part`` of what rest leaves of the limits; None if not reachable.

    Limits that rest violates, and the time away from reversals, are left to the search.
    """
    x = task.series.random(rng)
    return _scaled(task, x, _clear_center(task, rng, x), part)


def _clear_center(task: DesignProblem, rng: np.random.Generator, x: np.ndarray) -> np.ndarray:
    """Draw x (series.size,) at rest in the pose with the most room; zero if no bodies are kept apart.

    If the loops cannot be closed on the way from rest to the center, it is the pose at rest.
    """
    series, clearance = task.series, task.limits.clearance
    resting = np.zeros_like(x)
    centers = resting.reshape(-1, series.free)[:, 0]
    if task.rest is not None and task.model.loops is not None:
        q = task.rest[:, None] + np.outer(series.center - task.rest, WAY)
        try:
            close(task.model, np.stack([q, 0 * q, 0 * q]))
        except GtauError:
            centers[:] = (task.rest - series.center) / series.half
    if clearance is None:
        return resting
    drawn = rng.uniform(-SPREAD, SPREAD, (len(series.center), CENTERS))
    poses = series.center[:, None] + series.half[:, None] * drawn
    start = poses if task.rest is None else np.broadcast_to(task.rest[:, None], poses.shape)
    q = start[:, :, None] + (poses - start)[:, :, None] * WAY
    q = q.reshape(len(q), -1)
    try:
        c = close(task.model, np.stack([q, 0 * q, 0 * q])).c
    except GtauError:  # not every pose is reachable
        return resting
    distances = [near.distance for near in clearance.all_nearest(c, clearance.pairs)]
    room = np.min(distances, axis=0).reshape(CENTERS, -1)
    narrowest = room.min(axis=1)
    clear = narrowest >= clearance.least
    chosen = np.argmax(np.where(clear, room[:, -1], -np.inf) if clear.any() else narrowest)
    centers[:] = drawn[:, chosen]
    x.reshape(-1, series.free)[:, 0] = 0.0
    return resting


def _scaled(task: DesignProblem, x: np.ndarray, resting_x: np.ndarray, part: float) -> np.ndarray | None:
    """Scale x about ``resting_x`` until the motion uses a ``part`` of what rest leaves of the limits."""
    grid, near = design_grid(task), None

    def used(x: np.ndarray) -> tuple[ConstraintUsage, ...] | None:
        nonlocal near
        try:
            near = evaluate(task, x, grid, near)
        except GtauError:
            return None
        return tuple(constraint_usages(near))

    resting = used(resting_x)
    if resting is None:
        return None
    at_rest = {usage.what: usage.shortfall for usage in resting if usage.shortfall < 0}
    scale, low, high = 1.0, 0.0, np.inf
    for _ in range(TRIES):
        moving = used(resting_x + scale * x)
        counted = (usage for usage in moving or () if usage.what in at_rest)
        parts = (1 - usage.shortfall / at_rest[usage.what] for usage in counted)
        most = np.inf if moving is None else max(parts, default=1.0)
        if 0.95 * part <= most <= part:
            return resting_x + scale * x
        low, high = (scale, high) if most < part else (low, scale)
        scale = 2 * scale if np.isinf(high) else (low + high) / 2
    return resting_x + low * x
