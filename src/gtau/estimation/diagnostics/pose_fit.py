"""Fit frames and constants of the geometry to logged poses, with the loops closed anew after each step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.poses import Compared, Frames, compare, component_names, first_frames
from gtau.estimation.regression.rows import Labels
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.lengths import BodyPose, VariableGeometry, variable_geometry
from gtau.signals.reading.body_columns import PoseColumns
from gtau.signals.reading.side_signals import LoggedPoses

SAMPLES = 400  # of all runs together: residuals are smooth, so that more hardly add anything
STRETCHES = 8  # of a run, whose residuals are taken for independent of each other
LONGEST = 0.1  # s: delays of poses beyond it are none
SHORTEST = 1e-3  # s: a smaller delay needs no positions of its own
APART = 5  # rows on either side, over which speeds are taken from positions
STEPS = 25
SETTLED = 1e-5  # relative change of the squares by a last step,
DAMPED = 1e-2  # if it was damped less than this
LEAST_DAMPING = 1e-6
DEPENDENT = 1e-6  # of the largest singular value: what frames explain alike is shared among them
FLOOR = 1e-9  # m and rad: what rounding leaves; no component counts for more precise


@dataclass(frozen=True, eq=False)
class Poses:
    """Logged poses ``values`` at samples of all runs, with joint velocities ``qd`` (N, n).

    ``time`` (N,) in s is counted from the start of each run; ``run`` and ``stretch`` (N,) are numbers; ``weights``
    (m,) are 1/std of the components. Positions of the joints were taken ``delay`` (s) earlier, beside what a fit finds.
    """

    geometry: VariableGeometry
    columns: PoseColumns
    values: np.ndarray
    qd: np.ndarray
    time: np.ndarray
    run: np.ndarray
    stretch: np.ndarray
    weights: np.ndarray
    delay: float


@dataclass(frozen=True, eq=False)
class State:
    """Changes (constants,) of the geometry, configurations (n_c, N) closed with them, the body there, and frames."""

    change: np.ndarray
    c: np.ndarray
    body: BodyPose
    frames: Frames


@dataclass(frozen=True, eq=False)
class PoseFit:
    """Gauss-Newton solution with the frames and the constants ``chosen`` free."""

    poses: Poses
    state: State
    compared: Compared
    chosen: tuple[int, ...]

    @property
    def residual(self) -> np.ndarray:
        """Weighted residuals (N m,)."""
        return (self.compared.residual * self.poses.weights).reshape(-1)

    @property
    def squares(self) -> float:
        """Sum of the squared weighted residuals."""
        return float(self.residual @ self.residual)

    def column(self, constant: int) -> np.ndarray:
        """Return the weighted derivatives (N m,) of the computed pose with respect to a constant."""
        return (self.compared.by_constants[:, :, constant] * self.poses.weights).reshape(-1)

    @cached_property
    def columns(self) -> np.ndarray:
        """Weighted derivatives (N m, k) by the delay, the frames that are free, and the constants chosen."""
        frames = self.compared.by_frames[:, :, self.compared.free] * self.poses.weights[:, None]
        found = [frames.reshape(self.residual.size, -1), *(self.column(k)[:, None] for k in self.chosen)]
        return np.hstack(found)

    @cached_property
    def _factors(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Sizes (k,) of the columns, and the singular value decomposition of those of unit length."""
        size = np.linalg.norm(self.columns, axis=0)
        size[size == 0] = 1.0
        return size, *np.linalg.svd(self.columns / size, full_matrices=False)

    @cached_property
    def basis(self) -> np.ndarray:
        """Orthonormal columns (N m, rank) that span them."""
        _, U, sigma, _ = self._factors
        return np.asarray(U[:, sigma > DEPENDENT * sigma[0]])

    @cached_property
    def left(self) -> float:
        """Sum of the squared weighted residuals that the columns do not explain to first order."""
        beyond = self.beyond(self.residual)
        return float(beyond @ beyond)

    def beyond(self, vector: np.ndarray) -> np.ndarray:
        """Project a ``vector`` (N m,) on the complement of the columns."""
        return vector - self.basis @ (self.basis.T @ vector)

    def step(self, damping: float) -> np.ndarray:
        """Compute the next step (k,), damped in the directions that the poses hardly determine."""
        size, U, sigma, Vt = self._factors
        along = sigma / (sigma**2 + damping * sigma[0] ** 2) * (U.T @ self.residual)
        return np.asarray(Vt.T @ along / size)

    @cached_property
    def std(self) -> np.ndarray:
        """Standard deviations (k,) from the scores of stretches, which hold where residuals are autocorrelated."""
        size, U, sigma, Vt = self._factors
        kept = sigma > DEPENDENT * sigma[0]
        inverse = Vt[kept].T / sigma[kept] @ U[:, kept].T / size[:, None]
        N = len(self.poses.stretch)
        parts = (inverse * self.beyond(self.residual)).reshape(len(inverse), N, -1).sum(axis=2)
        scores = np.array([parts[:, self.poses.stretch == k].sum(axis=1) for k in np.unique(self.poses.stretch)])
        return np.asarray(np.sqrt(np.sum(scores**2, axis=0) * len(scores) / (len(scores) - 1)))


def fit_poses(poses: Poses, state: State, chosen: Sequence[int]) -> PoseFit | None:
    """Fit the frames and the constants ``chosen`` from a ``state`` on; None where the loops cannot follow.

    Levenberg-Marquardt, as a tracker's frame is hardly determined where little of a pose is logged.
    """
    fit, damping = _at(poses, state, chosen), LEAST_DAMPING
    for _ in range(STEPS):
        moved = _moved(fit, fit.step(damping))
        if moved is None or not moved.squares < fit.squares:
            if damping > 1:
                break
            damping *= 10
            continue
        gained = fit.squares - moved.squares
        settled = damping < DAMPED and gained <= SETTLED * moved.squares + (FLOOR * poses.weights.max()) ** 2
        fit, damping = moved, max(damping / 10, LEAST_DAMPING)
        if settled:
            break
    return fit if np.isfinite(fit.columns).all() else None


def _moved(fit: PoseFit, step: np.ndarray) -> PoseFit | None:
    """Take a step (k,) of the free frames and constants; None where the loops cannot follow."""
    poses, state, constants = fit.poses, fit.state, list(fit.chosen)
    of_frames = np.zeros(fit.compared.free.size)
    of_frames[fit.compared.free] = step[: len(step) - len(constants)]
    state = replace(state, frames=state.frames.moved(of_frames, fit.compared.about))
    if constants:
        change = state.change.copy()
        change[constants] += step[len(step) - len(constants) :]
        c = poses.geometry.close(state.c, state.change, change)
        if c is None:
            return None
        state = replace(state, change=change, c=c, body=poses.geometry.pose(c, change))
    return _at(poses, state, constants)


def _at(poses: Poses, state: State, chosen: Sequence[int]) -> PoseFit:
    compared = compare(poses.columns, poses.values, state.body, poses.qd, poses.run, state.frames)
    return PoseFit(poses, state, compared, tuple(chosen))


def fit_frames(
    model: InverseDynamics, columns: PoseColumns, joints: Sequence[str], logged: Sequence[LoggedPoses]
) -> PoseFit:
    """Fit the unknown frames alone, components weighted by the residual that no constant explains to first order.

    Parameters
    ----------
    model, columns : InverseDynamics, PoseColumns
        Of the robot, and what is logged.
    joints : sequence of str
        Order of the logged positions.
    logged : sequence of LoggedPoses
        One for each run.

    Raises
    ------
    GtauError
        Where the loops cannot be closed along the logged positions, or a run's time does not rise.
    """
    geometry = variable_geometry(model.robot, columns.body or model.robot.tool)
    fit = _fit_delayed(model, geometry, columns, joints, logged, 0.0)
    delay = float(np.clip(fit.state.frames.delay, -LONGEST, LONGEST))
    # a delay by velocities alone is wrong by half the acceleration times its square, 0.4 mm at 20 ms of a quick arm
    return _fit_delayed(model, geometry, columns, joints, logged, delay) if abs(delay) > SHORTEST else fit


def _fit_delayed(
    model: InverseDynamics,
    geometry: VariableGeometry,
    columns: PoseColumns,
    joints: Sequence[str],
    logged: Sequence[LoggedPoses],
    delay: float,
) -> PoseFit:
    """Fit the frames, with the positions of the joints taken by a ``delay`` earlier than the poses."""
    order = [list(joints).index(joint) for joint in model.actuated]
    turning = [model.robot.joint(joint).turns for joint in model.actuated]
    parts: list[tuple[np.ndarray, ...]] = []
    for k, each in enumerate(logged):
        q, time = np.array(each.q[:, order]), np.asarray(each.time)
        q[:, turning] = np.unwrap(q[:, turning], axis=0)
        count = min(max(SAMPLES // len(logged), 2 * STRETCHES), len(q) - 2 * APART)
        at = np.unique(np.linspace(APART, len(q) - 1 - APART, count).round().astype(int))
        step = time[at + APART] - time[at - APART]
        if not (step > 0).all():
            raise GtauError(f"run '{each.run}': its time does not rise at the logged poses; correct the time column.")
        qd = (q[at + APART] - q[at - APART]) / step[:, None]
        stretch = STRETCHES * k + np.arange(len(at)) * STRETCHES // len(at)
        earlier = np.stack([np.interp(time[at] - delay, time, column) for column in q.T])
        c = model.path(earlier, Labels(each.run, time[at]))
        parts.append((np.asarray(each.values[at]), qd, time[at] - time[0], np.full(len(at), k), stretch, c.T))
    values, qd, time, run, stretch, c = (np.concatenate(each) for each in zip(*parts, strict=True))
    weights = np.ones(len(component_names(columns)))
    poses = Poses(geometry, columns, values, qd, time, run, stretch, weights, delay)
    c, change = c.T.copy(), np.zeros(len(geometry.constants))
    body = geometry.pose(c, change)
    fit = fit_poses(poses, State(change, c, body, first_frames(columns, values, body, run)), ())
    assert fit is not None  # without other constants the loops stay closed
    seen = np.flatnonzero(np.isfinite(fit.compared.by_constants).all(axis=(0, 1)))
    every = PoseFit(poses, fit.state, fit.compared, tuple(seen.tolist()))
    spread = np.sqrt(np.mean(every.beyond(fit.residual).reshape(len(values), -1) ** 2, axis=0))
    weighed = fit_poses(replace(poses, weights=1 / np.maximum(spread, FLOOR)), fit.state, ())
    assert weighed is not None
    return weighed
