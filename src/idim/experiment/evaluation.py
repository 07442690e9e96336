"""A trajectory seen on a grid: what it makes the robot do, and gradients of whatever follows from that."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from idim.estimation.triangle import triangle
from idim.experiment.criteria import Criterion
from idim.experiment.information import derivative
from idim.experiment.motion import Slopes
from idim.experiment.task import Task, close
from idim.model.loops import Motion

PER_HARMONIC = 12  # instants of the design grid in a period of the highest harmonic


@dataclass(frozen=True, eq=False)
class Grid:
    """Instants of one period, evenly spaced, and the trajectory's basis there, (4, N, free)."""

    time: np.ndarray
    step: float
    basis: np.ndarray


def design_grid(task: Task, finer: int = 1) -> Grid:
    """The grid on which designs are made, or one ``finer`` times finer."""
    samples = PER_HARMONIC * task.series.harmonics * finer
    step = task.series.period / samples
    time = step * np.arange(samples)
    return Grid(time, step, task.series.basis(time))


@dataclass(frozen=True, eq=False)
class Point:
    """The motion for one x: joints (4, n, N) with q, qd, qdd and jerk, the whole robot, the base regressor (n, N, n_b).

    In platform space ``platform`` is the motion of the robot driven by its platform.
    """

    task: Task
    grid: Grid
    x: np.ndarray
    joints: np.ndarray
    motion: Motion
    platform: Motion | None
    W: np.ndarray

    def to_joints(self, slopes: Slopes) -> np.ndarray:
        """Slopes (3, n, N) by q, qd, qdd from those by the whole robot's motion."""
        if self.task.pullback is None:
            return np.stack([slopes.c, slopes.yd, slopes.ydd])
        return np.stack(self.task.pullback(self.motion, slopes))

    def to_rows(self, by_joints: np.ndarray) -> np.ndarray:
        """Slopes (N, size) by x, sample by sample, from those (3, n, N) by q, qd, qdd."""
        series, by = self.task.series, by_joints
        if self.platform is not None:
            assert self.task.platform_pullback is not None
            motors = self.task.motors
            model = self.task.platform_pullback.layout
            c, yd, ydd = (np.zeros_like(each) for each in (self.platform.c, self.platform.yd, self.platform.ydd))
            c[motors], yd[motors], ydd[motors] = by
            J = np.zeros((len(model.passive), len(model.actuated), c.shape[1]))
            by = np.stack(self.task.platform_pullback(self.platform, Slopes(c, yd, ydd, J)))
        rows = np.einsum("dmt,dtf->tmf", by, self.grid.basis[:3], optimize=True) * series.half[:, None]
        return np.asarray(rows.reshape(len(self.grid.time), series.size))

    def jerk_rows(self, joint: int) -> np.ndarray:
        """Slopes (N, size) of a joint's jerk by x."""
        series = self.task.series
        if self.platform is None:
            rows = np.zeros((len(self.grid.time), len(series.center), series.free))
            rows[:, joint] = self.grid.basis[3] * series.half[joint]
            return rows.reshape(len(rows), series.size)
        by = np.zeros((3, len(self.task.model.actuated), len(self.grid.time)))
        by[2, joint] = 1.0
        return derivative(self.to_rows(by).T, self.grid.step).T


def evaluate(task: Task, x: np.ndarray, grid: Grid, near: Point | None = None) -> Point:
    """The motion for ``x``; the loops are closed from the configurations of the point ``near`` if there is one.

    Raises
    ------
    IdimError
        Where the trajectory leaves what the robot can reach, or comes too close to a singular pose.
    """
    series, platform = task.series, None
    table = np.einsum("dtf,mf->dmt", grid.basis, x.reshape(-1, series.free) * series.half[:, None], optimize=True)
    table[0] += series.center[:, None]
    if task.platform_model is not None:
        before = near.platform.c if near is not None and near.platform is not None else None
        platform = close(task.platform_model, table[0], table[1], table[2], before)
        motors = task.motors
        qdd = platform.ydd[motors]
        table = np.stack([platform.c[motors], platform.yd[motors], qdd, derivative(qdd, grid.step)])
    motion = close(task.model, table[0], table[1], table[2], None if near is None else near.motion.c)
    return Point(task, grid, x, table, motion, platform, task.regressor(motion))


def information(point: Point) -> np.ndarray:
    """Triangular factor (P, P) of the information of all runs."""
    task, step, info = point.task, point.grid.step, point.task.information
    counts = info.counts(task.window(step).weights(point.joints[1]), step)
    return info.factor([info.jacobians(point.W, run, step) for run in range(len(task.payloads))], counts)


def objective(point: Point, criterion: Criterion, of_regressor: bool) -> tuple[float, np.ndarray]:
    """Logarithm of a criterion and its gradient (size,) by x; ``of_regressor`` for one of the regressor's factor."""
    task, step, info = point.task, point.grid.step, point.task.information
    if of_regressor:
        value, F, f = criterion(triangle(point.W.reshape(-1, point.W.shape[2])))
        by_W = 2 * (point.W @ F * f) @ F.T
        return value, point.to_rows(point.to_joints(task.regressor.slopes(point.motion, by_W))).sum(axis=0)
    window = task.window(step)
    weights = window.weights(point.joints[1])
    counts = info.counts(weights, step)
    rows = [info.jacobians(point.W, run, step) for run in range(len(task.payloads))]
    value, F, f = criterion(info.factor(rows, counts))
    by_W, by_counts = np.zeros_like(point.W), np.zeros_like(counts)
    for run, A in enumerate(rows):
        along = A @ F
        by_W += info.back(2 * counts[:, :, None] * ((along * f) @ F.T), run, step)
        by_counts += along**2 @ f
    by_joints = point.to_joints(task.regressor.slopes(point.motion, by_W))
    by_joints[1] += window.back(point.joints[1], info.counts(by_counts, step))
    return value, point.to_rows(by_joints).sum(axis=0)
