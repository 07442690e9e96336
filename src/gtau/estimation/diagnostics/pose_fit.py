"""Fit of frames and constants of the geometry to logged poses, with the loops closed anew after each step.

A logged pose is ``T_t(0_T_b(q(t - d))) T_m``: that of the body in the base, after a frame ``T_m`` of a tool or marker
fixed to the body, in the frame ``T_t`` of a tracker, delayed by ``d`` to the positions. The unknown ones are estimated
together with any other unknowns, and absorb the residuals that both explain. A tracker may have been moved or
calibrated anew between runs: it has a frame in each (that of the UPV logs moved by 9 mm before the last run).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from gtau.model.lengths import BodyPose, VariableGeometry
from gtau.robots.placement import within_a_turn
from gtau.signals.reading.body_columns import PoseColumns

STEP = 1e-6  # rad: of the differences that turn angular velocities into rates of angles
SHORTEST = 1e-3  # s: a smaller delay needs no positions of its own
OWN = 7  # entries of a step that are the delay's and the marker's; six of the tracker's follow for each run


@dataclass(frozen=True, eq=False)
class Frames:
    """Poses of tracker and marker, and the delay of the logged poses.

    ``tracker`` are the orientations (runs, 3, 3) and positions (runs, 3) of the base in the tracker's frame,
    ``marker`` those (3, 3) and (3,) of the marker on the body; ``delay`` in s.
    """

    tracker: tuple[np.ndarray, np.ndarray]
    marker: tuple[np.ndarray, np.ndarray] = (np.eye(3), np.zeros(3))
    delay: float = 0.0

    def moved(self, step: np.ndarray, about: np.ndarray) -> Frames:
        """Step the frames (7 + 6 runs,): delay, marker and tracker, which rotates ``about`` points (runs, 3)."""
        (R, p), (R_m, p_m), of_tracker = self.tracker, self.marker, step[OWN:].reshape(-1, 6)
        turn = Rotation.from_rotvec(of_tracker[:, 3:]).as_matrix()
        away = np.einsum("rij,rj->ri", turn, p - about)
        return Frames(
            (turn @ R, away + about + of_tracker[:, :3]),
            (Rotation.from_rotvec(step[4:OWN]).as_matrix() @ R_m, p_m + step[1:4]),
            self.delay + float(step[0]),
        )


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


def compare(poses: Poses, body: BodyPose, frames: Frames) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Compare logged poses with those of the body, computed from the positions, behind tracker and marker.

    Returns logged less computed components (N, m), and their derivatives: by the steps of :meth:`Frames.moved`, (N, m,
    7 + 6 runs), and by the constants, (N, m, constants); and the points (runs, 3) about which the tracker turns.
    """
    columns, run = poses.columns, poses.run
    R_t, p_t, (R_m, p_m) = frames.tracker[0][run], frames.tracker[1][run], frames.marker
    twist = np.einsum("nij,nj->ni", body.by_joints, poses.qd)  # of the body, base axes
    R_b = Rotation.from_rotvec(-frames.delay * twist[:, 3:]).as_matrix() @ body.rotation
    still = body.position - frames.delay * twist[:, :3] + R_b @ p_m
    R, p = R_t @ R_b @ R_m, _turned(R_t, still) + p_t
    residual, by_twist = _components(columns, poses.values, R, p)
    arm = _turned(R_t @ R_b, np.broadcast_to(p_m, p.shape))  # from the body's frame to the marker, tracker's axes

    def carried(of_body: np.ndarray) -> np.ndarray:
        """Transform twists (N, 6, k) of the body into those of the marker, in the tracker's axes."""
        linear, angular = R_t @ of_body[:, :3], R_t @ of_body[:, 3:]
        return np.concatenate([linear + np.cross(angular, arm[:, :, None], axis=1), angular], axis=1)

    runs = len(frames.tracker[0])
    about = np.array([p[run == k].mean(axis=0) for k in range(runs)])
    by_frames = np.zeros((len(p), 6, OWN + 6 * runs))
    by_frames[:, :, :1] = -carried(twist[:, :, None])
    by_frames[:, :3, 1:4] = by_frames[:, 3:, 4:OWN] = R_t @ R_b
    for k in range(runs):
        mine, first = run == k, OWN + 6 * k
        by_frames[mine, :, first : first + 6] = np.eye(6)
        by_frames[mine, :3, first + 3 : first + 6] = -_cross_matrices(p[mine] - about[k])
    return residual, by_twist @ by_frames, by_twist @ carried(body.by_constants), about


def _first_frames(poses: Poses, body: BodyPose) -> Frames:
    """Guess the poses of tracker and marker from full positions and orientations; otherwise leave them unchanged."""
    columns, values, run = poses.columns, poses.values, poses.run
    runs, measured = int(run.max()) + 1, _orientations(columns, values)
    R_t, p_t = np.tile(np.eye(3), (runs, 1, 1)), np.zeros((runs, 3))
    if columns.source == "tracker" and len(columns.axes) == 3:
        for k in range(runs):
            logged, computed = values[run == k][:, np.argsort(columns.axes)], body.position[run == k]
            centres = logged.mean(axis=0), computed.mean(axis=0)
            R_t[k] = Rotation.align_vectors(logged - centres[0], computed - centres[1])[0].as_matrix()
            p_t[k] = centres[0] - R_t[k] @ centres[1]
    frames = Frames((R_t, p_t))
    if columns.source != "controller" and measured is not None:
        on_body = np.swapaxes(R_t[run] @ body.rotation, 1, 2) @ measured.as_matrix()
        frames = replace(frames, marker=(Rotation.from_matrix(on_body).mean().as_matrix(), np.zeros(3)))
    return frames


def _turned(R: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Rotate vectors (N, 3) by rotation matrices (N, 3, 3)."""
    return np.einsum("nij,nj->ni", R, vectors)


def _orientations(columns: PoseColumns, values: np.ndarray) -> Rotation | None:
    """Return the logged orientations; None where they are not logged in full."""
    turned = values[:, len(columns.position) :]
    if columns.quaternion is not None:
        return Rotation.from_quat(turned, scalar_first=True)
    if columns.rotation_vector is not None:
        return Rotation.from_rotvec(turned)
    if columns.angles is not None and len(columns.angles.columns) == 3:
        return Rotation.from_euler(columns.angles.turning[0], turned)
    return None


def _components(
    columns: PoseColumns, values: np.ndarray, R: np.ndarray, p: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compute logged minus computed components (N, m), and derivatives of the computed ones by a twist (N, m, 6)."""
    axes, logged = list(columns.axes), len(columns.axes)
    residual = values[:, :logged] - p[:, axes]
    by_twist = np.broadcast_to(np.eye(6)[axes], (len(p), logged, 6))
    if columns.angles is not None:
        sequence, names = columns.angles.turning
        count = len(names)

        def angles(turn: np.ndarray) -> np.ndarray:
            return np.asarray(Rotation.from_matrix(turn).as_euler(sequence)[:, :count])

        apart = values[:, logged:] - angles(R)
        by_turn = np.zeros((len(p), count, 6))
        for k, axis in enumerate(np.eye(3)):
            above, below = (angles(Rotation.from_rotvec(sign * STEP * axis).as_matrix() @ R) for sign in (1.0, -1.0))
            by_turn[:, :, 3 + k] = within_a_turn(above - below) / (2 * STEP)
    elif (measured := _orientations(columns, values)) is not None:
        apart = (measured * Rotation.from_matrix(R).inv()).as_rotvec()
        by_turn = np.broadcast_to(np.eye(6)[3:], (len(p), 3, 6))
    else:
        return residual, by_twist
    return np.hstack([residual, within_a_turn(apart)]), np.concatenate([by_twist, by_turn], axis=1)


def _cross_matrices(vectors: np.ndarray) -> np.ndarray:
    """Build the matrices (N, 3, 3) that take the cross product with vectors (N, 3)."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.moveaxis(np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]), 2, 0)


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
class PoseFit:
    """Gauss-Newton solution with the ``frames`` and the constants ``chosen`` free.

    ``change`` (constants,) are those of the geometry, and ``c`` (n_c, N) the configurations closed with them. ``body``
    is the body there, and ``compared`` what :func:`compare` makes of it.
    """

    poses: Poses
    frames: Frames
    change: np.ndarray
    c: np.ndarray
    body: BodyPose
    chosen: tuple[int, ...]

    @cached_property
    def compared(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Residuals (N, m), and their derivatives by frames and by constants; see :func:`compare`."""
        return compare(self.poses, self.body, self.frames)

    @property
    def free(self) -> np.ndarray:
        """Entries of a step of the frames that are unknown (7 + 6 runs,)."""
        columns, runs = self.poses.columns, len(self.frames.tracker[0])
        marker, tracker = columns.source != "controller", columns.source == "tracker"
        # where only a position is logged, nobody sees how a marker is turned
        return np.repeat([True, marker, marker and _turns(columns), tracker], [1, 3, 3, 6 * runs])

    @property
    def residual(self) -> np.ndarray:
        """Weighted residuals (N m,)."""
        return (self.compared[0] * self.poses.weights).reshape(-1)

    def column(self, constant: int) -> np.ndarray:
        """Return the weighted derivatives (N m,) of the computed pose with respect to a constant."""
        return (self.compared[2][:, :, constant] * self.poses.weights).reshape(-1)

    @cached_property
    def columns(self) -> np.ndarray:
        """Weighted derivatives (N m, k) by the delay, the frames that are free, and the constants chosen."""
        frames = self.compared[1][:, :, self.free] * self.poses.weights[:, None]
        return np.hstack([frames.reshape(self.residual.size, -1), *(self.column(k)[:, None] for k in self.chosen)])

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
    def rest(self) -> float:
        """Sum of the squared weighted residuals that the columns do not explain to first order."""
        return float(np.sum(self.beyond(self.residual) ** 2))

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
        stretches = np.unique(self.poses.stretch)
        return jackknife_std(np.array([parts[:, self.poses.stretch == k].sum(axis=1) for k in stretches]))


def jackknife_std(scores: np.ndarray) -> np.ndarray:
    """Compute the standard deviation of a sum from its parts (stretches, ...), which are independent."""
    return np.asarray(np.sqrt(np.sum(scores**2, axis=0) * len(scores) / (len(scores) - 1)))


def unfitted(poses: Poses, c: np.ndarray) -> PoseFit:
    """Begin a fit at configurations ``c`` (n_c, N) of the robot's file, frames guessed."""
    change = np.zeros(len(poses.geometry.constants))
    body = poses.geometry.pose(c, change)
    return PoseFit(poses, _first_frames(poses, body), change, c, body, ())


def fit_poses(start: PoseFit, chosen: Sequence[int]) -> PoseFit | None:
    """Fit the frames and the constants ``chosen`` from a fit on; None where the loops cannot follow.

    Levenberg-Marquardt, as a tracker's frame is hardly determined where little of a pose is logged.
    """
    fit, damping = replace(start, chosen=tuple(chosen)), LEAST_DAMPING
    for _ in range(STEPS):
        moved = _moved(fit, fit.step(damping))
        gained = 0.0 if moved is None else float(np.sum(fit.residual**2) - np.sum(moved.residual**2))
        if moved is None or not gained > 0:
            if damping > 1:
                break
            damping *= 10
            continue
        small = SETTLED * np.sum(moved.residual**2) + (FLOOR * fit.poses.weights.max()) ** 2
        converged = damping < DAMPED and gained <= small
        fit, damping = moved, max(damping / 10, LEAST_DAMPING)
        if converged:
            break
    return fit if np.isfinite(fit.columns).all() else None


def _moved(fit: PoseFit, step: np.ndarray) -> PoseFit | None:
    """Take a step (k,) of the free frames and constants; None where the loops cannot follow."""
    of_frames, count = np.zeros(fit.free.size), np.count_nonzero(fit.free)
    of_frames[fit.free] = step[:count]
    fit = replace(fit, frames=fit.frames.moved(of_frames, fit.compared[3]))
    if not fit.chosen:
        return fit
    change, geometry = fit.change.copy(), fit.poses.geometry
    change[list(fit.chosen)] += step[count:]
    c = geometry.close(fit.c, fit.change, change)
    return None if c is None else replace(fit, change=change, c=c, body=geometry.pose(c, change))
