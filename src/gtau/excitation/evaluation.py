"""Robot motion on a grid of instants, and gradients of functions of the motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import zip_longest

import numpy as np

from gtau.estimation.regression.factors import triangle
from gtau.excitation.gradients import Slopes
from gtau.excitation.information import Criterion, derivative
from gtau.excitation.task import DesignProblem, close
from gtau.model.loops import Motion

PER_HARMONIC = 12  # instants of the design grid per period of the highest harmonic


@dataclass(frozen=True, eq=False)
class Grid:
    """Instants ``step`` s apart, of one period or a whole run, with the series' basis (4, N, free) for a period."""

    step: float
    basis: np.ndarray = field(default_factory=lambda: np.empty((4, 0, 0)))


def design_grid(task: DesignProblem, finer: int = 1) -> Grid:
    """Make the grid of a period on which motions are designed, or a grid ``finer`` times finer."""
    samples = PER_HARMONIC * task.series.harmonics * finer
    step = task.series.period / samples
    return Grid(step, task.series.basis(step * np.arange(samples)))


@dataclass(frozen=True, eq=False)
class Point:
    """The motion of some ``runs``: joints (4, n, N), the whole robot, and the base regressor W (n, N, n_b).

    In platform space, ``platform`` is the motion of the robot driven by its platform.
    """

    task: DesignProblem
    grid: Grid
    runs: tuple[int, ...]
    joints: np.ndarray
    motion: Motion
    platform: Motion | None
    W: np.ndarray

    def to_joints(self, slopes: Slopes) -> np.ndarray:
        """Convert derivatives by the whole robot's motion into derivatives by q, qd and qdd, (3, n, N)."""
        if self.task.pullback is None:
            return np.stack([slopes.c, slopes.yd, slopes.ydd])
        return np.stack(self.task.pullback(self.motion, slopes))

    def to_rows(self, by_joints: np.ndarray) -> np.ndarray:
        """Convert derivatives by q, qd, qdd (3, n, N) into the gradient of every sample by x, (N, series.size)."""
        series, by = self.task.series, by_joints
        if self.platform is not None:
            assert self.task.platform_pullback is not None
            motors = self.task.motors
            model = self.task.platform_pullback.layout
            c, yd, ydd = (np.zeros_like(array) for array in (self.platform.c, self.platform.yd, self.platform.ydd))
            c[motors], yd[motors], ydd[motors] = by
            J = np.zeros((len(model.passive), len(model.actuated), c.shape[1]))
            by = np.stack(self.task.platform_pullback(self.platform, Slopes(c, yd, ydd, J)))
        rows = by.transpose(2, 1, 0) @ self.grid.basis[:3].transpose(1, 0, 2) * series.half[:, None]
        return np.asarray(rows.reshape(len(rows), series.size))

    def rows_by_configuration(self, by_c: np.ndarray) -> np.ndarray:
        """Convert derivatives by c (n_c, N) into the gradient of every sample by x, (N, series.size)."""
        return self.to_rows(self.to_joints(Slopes.by_configuration(by_c, self.motion, self.task.model.layout)))

    def jerk_rows(self, joint: int) -> np.ndarray:
        """Compute the gradient (N, series.size) of a joint's jerk by x."""
        series = self.task.series
        if self.platform is None:
            rows = np.zeros((self.joints.shape[2], len(series.center), series.free))
            rows[:, joint] = self.grid.basis[3] * series.half[joint]
            return rows.reshape(len(rows), series.size)
        by = np.zeros((3, *self.joints.shape[1:]))
        by[2, joint] = 1.0
        return derivative(self.to_rows(by).T, self.grid.step).T


def evaluate(task: DesignProblem, x: np.ndarray, grid: Grid, near: Sequence[Point] = ()) -> tuple[Point, ...]:
    """Evaluate all motions for x (task.size,), closing loops from the configurations of ``near`` if given."""
    parts = zip_longest(np.split(x, len(task.motions)), task.motions, near)
    return tuple(evaluate_one(task, part, grid, runs, closed) for part, runs, closed in parts)


def evaluate_one(
    task: DesignProblem, x: np.ndarray, grid: Grid, runs: tuple[int, ...], near: Point | None = None
) -> Point:
    """Evaluate the motion of some ``runs`` for x (series.size,); see :func:`evaluate`."""
    table, platform = task.series.along(x, grid.basis), None
    if task.platform_model is not None:
        before = near.platform.c if near is not None and near.platform is not None else None
        platform = close(task.platform_model, table, before)
        motors = task.motors
        qdd = platform.ydd[motors]
        table = np.stack([platform.c[motors], platform.yd[motors], qdd, derivative(qdd, grid.step)])
    motion = close(task.model, table, None if near is None else near.motion.c)
    return Point(task, grid, runs, table, motion, platform, task.regressor(motion))


def along(task: DesignProblem, joints: np.ndarray, step: float, runs: tuple[int, ...]) -> Point:
    """Evaluate any motion of the joints (4, n, N), ``step`` s apart."""
    motion = close(task.model, joints)
    return Point(task, Grid(step), runs, joints, motion, None, task.regressor(motion))


def information(points: Sequence[Point]) -> np.ndarray:
    """Compute the triangular factor (P, P) of the information of all runs of all motions."""
    return triangle(*(point.task.information.factor(*_weighted_rows(point)) for point in points))


def _weighted_rows(point: Point) -> tuple[list[np.ndarray], np.ndarray]:
    """Compute the Jacobian rows (n, N, P) of every run of a motion, and their weights (n, N)."""
    info, step = point.task.information, point.grid.step
    counts = info.counts(point.task.window(step).weights(point.joints[1]), step)
    return [info.jacobians(point.W, run, step) for run in point.runs], counts


def objective(points: Sequence[Point], criterion: Criterion, on_regressor: bool) -> tuple[float, np.ndarray]:
    """Compute the logarithm of a criterion of the information or the regressor, and its gradient (task.size,) by x."""
    if on_regressor:
        value, F, f = criterion(triangle(*(point.W.reshape(-1, point.W.shape[2]) for point in points)))
        slopes = [_by_columns(point, 2 * (point.W @ F * f) @ F.T) for point in points]
    else:
        weighted = [_weighted_rows(point) for point in points]
        factors = (point.task.information.factor(*rows) for point, rows in zip(points, weighted, strict=True))
        value, F, f = criterion(triangle(*factors))
        slopes = [_by_information(point, *rows, F, f) for point, rows in zip(points, weighted, strict=True)]
    by_x = [point.to_rows(slope).sum(axis=0) for point, slope in zip(points, slopes, strict=True)]
    return value, np.concatenate(by_x)


def _by_columns(point: Point, by_W: np.ndarray) -> np.ndarray:
    return point.to_joints(point.task.regressor.slopes(point.motion, by_W))


def _by_information(
    point: Point, rows: list[np.ndarray], counts: np.ndarray, F: np.ndarray, f: np.ndarray
) -> np.ndarray:
    """Differentiate a criterion of the information by q, qd and qdd, (3, n, N)."""
    info, step = point.task.information, point.grid.step
    by_W, by_counts = np.zeros_like(point.W), np.zeros_like(counts)
    for run, A in zip(point.runs, rows, strict=True):
        along = A @ F
        by_W += info.back(2 * counts[:, :, None] * ((along * f) @ F.T), run, step)
        by_counts += along**2 @ f
    by_joints = _by_columns(point, by_W)
    by_joints[1] += point.task.window(step).back(point.joints[1], info.counts(by_counts, step))
    return by_joints
