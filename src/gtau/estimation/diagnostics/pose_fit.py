"""Fit of frames and constants of the geometry to logged poses, with the loops closed anew after each step.

A logged pose is ``T_t(0_T_b(q(t - d))) T_m``: of the body in the base, after a frame ``T_m`` of a tool or marker
fixed to the body, in the frame ``T_t`` of a tracker, delayed by ``d`` to the positions. The unknown ones are estimated
together with any other unknowns, and absorb the residuals that both explain. A tracker may have been moved or
calibrated anew between runs: it has a frame in each (the tracker of the UPV logs moved by 9 mm before the last run).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from gtau.model.lengths import BodyPose, VariableGeometry
from gtau.robots.placement import within_a_turn
from gtau.signals.reading.body_columns import PoseColumns

STEP = 1e-6  # m, rad and s: of differences, between rounding and the second order
SHORTEST = 1e-3  # s: a smaller delay needs no positions of its own
STEPS, SETTLED = 25, 1e-5  # relative change of the squares by a last step
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

    @cached_property
    def orientations(self) -> Rotation | None:
        """The logged orientations; None where they are not logged in full."""
        columns, turned = self.columns, self.values[:, len(self.columns.position) :]
        if columns.quaternion is not None:
            return Rotation.from_quat(turned, scalar_first=True)
        if columns.rotation_vector is not None:
            return Rotation.from_rotvec(turned)
        if columns.angles is not None and len(columns.angles.columns) == 3:
            return Rotation.from_euler(columns.angles.turning[0], turned)
        return None


@dataclass(frozen=True, eq=False)
class Frames:
    """Orientations and positions of the base in the tracker (runs, ...), turned ``about`` points, and of the marker."""

    R_t: np.ndarray
    p_t: np.ndarray
    R_m: np.ndarray
    about: np.ndarray


def component_names(columns: PoseColumns) -> tuple[tuple[str, str], ...]:
    """Name the compared components, with units: columns, and for a whole orientation the rotation between the two."""
    named = [(column, "m") for column in columns.position.values()]
    if columns.angles is not None:
        return (*named, *((column, "rad") for column in columns.angles.turning[1]))
    turns = [(f"turn about {axis}", "rad") for axis in "xyz"] if _turns(columns) else []
    return (*named, *turns)


def _turns(columns: PoseColumns) -> bool:
    """Decide whether anything of the orientation is logged."""
    return any(logged is not None for logged in (columns.angles, columns.quaternion, columns.rotation_vector))


def first_frames(poses: Poses, body: BodyPose) -> Frames:
    """Guess the poses of tracker and marker from full positions and orientations; otherwise leave them unchanged."""
    columns, values, run = poses.columns, poses.values, poses.run
    runs, measured = int(run.max()) + 1, poses.orientations
    R_t, p_t, R_m = np.tile(np.eye(3), (runs, 1, 1)), np.zeros((runs, 3)), np.eye(3)
    if columns.source == "tracker" and len(columns.axes) == 3:
        for k in range(runs):
            logged, computed = values[run == k][:, np.argsort(columns.axes)], body.position[run == k]
            centres = logged.mean(axis=0), computed.mean(axis=0)
            R_t[k] = Rotation.align_vectors(logged - centres[0], computed - centres[1])[0].as_matrix()
            p_t[k] = centres[0] - R_t[k] @ centres[1]
    if columns.source != "controller" and measured is not None:
        on_body = np.swapaxes(R_t[run] @ body.rotation, 1, 2) @ measured.as_matrix()
        R_m = Rotation.from_matrix(on_body).mean().as_matrix()
    return Frames(R_t, p_t, R_m, np.array([body.position[run == k].mean(axis=0) for k in range(runs)]))


def _turned(R: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Rotate vectors (N, 3) by rotation matrices (N, 3, 3)."""
    return np.einsum("nij,nj->ni", R, vectors)


@dataclass(frozen=True, eq=False)
class PoseFit:
    """Poses with ``frames`` that are guessed, ``moved`` by a vector, and the constants ``chosen`` free.

    ``moved`` (7 + 6 runs,) are the delay in s, shift and rotation of the marker, and of the tracker in each run, about
    the middle of its poses. ``change`` (constants,) is of the geometry, and ``c`` (n_c, N) the configurations
    closed with them, where the body is at ``body``.
    """

    poses: Poses
    frames: Frames
    moved: np.ndarray
    change: np.ndarray
    c: np.ndarray
    body: BodyPose
    chosen: tuple[int, ...] = ()

    @cached_property
    def free(self) -> np.ndarray:
        """Entries of ``moved`` that are unknown (7 + 6 runs,)."""
        columns, runs = self.poses.columns, len(self.frames.p_t)
        marker, tracker = columns.source != "controller", columns.source == "tracker"
        # where only a position is logged, nobody sees how a marker is turned
        return np.repeat([True, marker, marker and _turns(columns), tracker], [1, 3, 3, 6 * runs])

    @cached_property
    def _twist(self) -> np.ndarray:
        """Twist (N, 6) of the body, base axes."""
        return np.einsum("nij,nj->ni", self.body.by_joints, self.poses.qd)

    def _apart(self, moved: np.ndarray, position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """Compute logged less computed components (N, m) with the body (N, 3), (N, 3, 3) in the base."""
        poses, frames = self.poses, self.frames
        columns, run, tracker_moves = poses.columns, poses.run, moved[7:].reshape(-1, 6)
        twist = self._twist
        R_b = Rotation.from_rotvec(-moved[0] * twist[:, 3:]).as_matrix() @ rotation
        p_b = position - moved[0] * twist[:, :3] + R_b @ moved[1:4]
        R_t = Rotation.from_rotvec(tracker_moves[:, 3:]).as_matrix() @ frames.R_t
        p_t = frames.p_t + tracker_moves[:, :3] + _turned(frames.R_t, frames.about)
        R = R_t[run] @ R_b @ Rotation.from_rotvec(moved[4:7]).as_matrix() @ frames.R_m
        p = _turned(R_t[run], p_b - frames.about[run]) + p_t[run]
        apart, logged = poses.values[:, : len(columns.axes)] - p[:, list(columns.axes)], len(columns.axes)
        if columns.angles is not None:
            sequence, names = columns.angles.turning
            angles = np.asarray(Rotation.from_matrix(R).as_euler(sequence))[:, : len(names)]
            return np.hstack([apart, within_a_turn(poses.values[:, logged:] - angles)])
        if poses.orientations is None:
            return apart
        return np.hstack([apart, (poses.orientations * Rotation.from_matrix(R).inv()).as_rotvec()])

    @cached_property
    def apart(self) -> np.ndarray:
        """Logged less computed components (N, m), m and rad."""
        return self._apart(self.moved, self.body.position, self.body.rotation)

    @property
    def residual(self) -> np.ndarray:
        """Weighted residuals (N m,)."""
        return (self.apart * self.poses.weights).reshape(-1)

    def _slope(self, other: np.ndarray) -> np.ndarray:
        """Compute the weighted derivative (N m,) of the computed pose from what is apart after a STEP."""
        less = self.apart - other
        angles = [unit == "rad" for _, unit in component_names(self.poses.columns)]
        less[:, angles] = within_a_turn(less[:, angles])
        return (less / STEP * self.poses.weights).reshape(-1)

    def column(self, constant: int) -> np.ndarray:
        """Return the weighted derivatives (N m,) of the computed pose with respect to a constant."""
        step, body = STEP * self.body.by_constants[:, :, constant], self.body
        if not np.isfinite(step).all():
            return np.full(self.apart.size, np.nan)
        rotation = Rotation.from_rotvec(step[:, 3:]).as_matrix() @ body.rotation
        return self._slope(self._apart(self.moved, body.position + step[:, :3], rotation))

    @cached_property
    def columns(self) -> np.ndarray:
        """Weighted derivatives (N m, k) by the delay, the frames that are free, and the constants chosen."""
        steps = self.moved + STEP * np.eye(len(self.moved))[self.free]
        frames = [self._slope(self._apart(step, self.body.position, self.body.rotation)) for step in steps]
        return np.column_stack([*frames, *map(self.column, self.chosen)])

    @cached_property
    def _factors(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Sizes (k,) of the columns, and the singular value decomposition at unit length, the rank kept."""
        size = np.linalg.norm(self.columns, axis=0)
        size[size == 0] = 1.0
        U, sigma, Vt = np.linalg.svd(self.columns / size, full_matrices=False)
        kept = sigma > DEPENDENT * sigma[0]
        return size, U[:, kept], sigma[kept], Vt[kept]

    @cached_property
    def rest(self) -> float:
        """Sum of the squared weighted residuals that the columns do not explain to first order."""
        return float(np.sum(self.beyond(self.residual) ** 2))

    def beyond(self, vector: np.ndarray) -> np.ndarray:
        """Project a ``vector`` (N m,) on the complement of the columns."""
        basis = self._factors[1]
        return vector - basis @ (basis.T @ vector)

    @cached_property
    def std(self) -> np.ndarray:
        """Standard deviations (k,) from the scores of stretches, which hold where residuals are autocorrelated."""
        size, U, sigma, Vt = self._factors
        inverse = Vt.T / sigma @ U.T / size[:, None]
        N = len(self.poses.stretch)
        parts = (inverse * self.beyond(self.residual)).reshape(len(inverse), N, -1).sum(axis=2)
        stretches = np.unique(self.poses.stretch)
        return jackknife_std(np.array([parts[:, self.poses.stretch == k].sum(axis=1) for k in stretches]))


def jackknife_std(scores: np.ndarray) -> np.ndarray:
    """Compute the standard deviation of a sum from its parts (stretches, ...), which are independent."""
    return np.asarray(np.sqrt(np.sum(scores**2, axis=0) * len(scores) / (len(scores) - 1)))


def unfitted(poses: Poses, c: np.ndarray) -> PoseFit:
    """Begin a fit at configurations ``c`` (n_c, N) of the robot's file, frames guessed."""
    change = np.zeros(len(poses.geometry.constants))
    body = poses.geometry.pose(c, change)
    frames = first_frames(poses, body)
    return PoseFit(poses, frames, np.zeros(7 + 6 * len(frames.p_t)), change, c, body)


def fit_poses(start: PoseFit, chosen: Sequence[int]) -> PoseFit | None:
    """Fit the frames and the constants ``chosen`` from a fit on; None where the loops cannot follow."""
    from scipy.optimize import least_squares

    fit, free, geometry = replace(start, chosen=tuple(chosen)), start.free, start.poses.geometry
    if not np.isfinite(fit.columns).all():
        return None

    @lru_cache(maxsize=2)
    def closed(*changes: float) -> tuple[np.ndarray, np.ndarray, BodyPose] | None:
        """Close the loops with these changes of the chosen constants."""
        if not changes:
            return fit.change, fit.c, fit.body
        change = fit.change.copy()
        change[list(fit.chosen)] = changes
        c = geometry.close(fit.c, fit.change, change)
        return None if c is None else (change, c, geometry.pose(c, change))

    def at(unknowns: np.ndarray) -> PoseFit | None:
        """Return the fit at these unknowns (k,); None where the loops cannot follow."""
        moved, count = fit.moved.copy(), np.count_nonzero(free)
        moved[free] = unknowns[:count]
        parts = closed(*unknowns[count:].tolist())
        if parts is None:
            return None
        change, c, body = parts
        return replace(fit, moved=moved, change=change, c=c, body=body)

    def residual(unknowns: np.ndarray) -> np.ndarray:
        other = at(unknowns)
        return np.full(fit.apart.size, np.nan) if other is None else other.residual

    def slopes(unknowns: np.ndarray) -> np.ndarray:
        other = at(unknowns)
        return np.full(fit.columns.shape, np.nan) if other is None else -other.columns

    first = np.concatenate([fit.moved[free], fit.change[list(fit.chosen)]])
    try:
        solved = least_squares(residual, first, slopes, x_scale="jac", ftol=SETTLED, max_nfev=STEPS)
    except ValueError:  # not finite, as the loops cannot follow
        return None
    fitted = at(solved.x)
    return fitted if fitted is not None and np.isfinite(fitted.columns).all() else None
