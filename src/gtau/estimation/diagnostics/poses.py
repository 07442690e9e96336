"""Comparison of logged poses with those computed from the joint positions.

A logged pose is ``T_t(0_T_b(q(t - d))) T_m``: that of the body in the base, after a frame ``T_m`` of a tool or marker
fixed to the body, in the frame ``T_t`` of a tracker, delayed by ``d`` to the positions. The unknown ones are estimated
together with any other unknowns, and absorb the residuals that both explain. A tracker may have been moved or
calibrated anew between runs: it has a frame in each (that of the UPV logs moved by 9 mm before the last run).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from gtau.model.lengths import BodyPose
from gtau.signals.reading.body_columns import PoseColumns

STEP = 1e-6  # rad: of the differences that turn angular velocities into rates of angles
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


@dataclass(frozen=True, eq=False)
class Compared:
    """Logged less computed components (N, m), and their derivatives by unknown frames and by constants.

    ``by_frames`` (N, m, 7 + 6 runs) is by the steps of :meth:`Frames.moved`, of which ``free`` are unknown, ``about``
    (runs, 3) the points about which the tracker turns; ``by_constants`` (N, m, constants).
    """

    residual: np.ndarray
    by_frames: np.ndarray
    by_constants: np.ndarray
    free: np.ndarray
    about: np.ndarray


def free_steps(columns: PoseColumns, runs: int) -> np.ndarray:
    """Mark the entries of a step of the frames that are unknown (7 + 6 runs,)."""
    turns = columns.angles is not None or columns.quaternion is not None or columns.rotation_vector is not None
    marker, tracker = columns.source != "controller", columns.source == "tracker"
    # where only a position is logged, nobody sees how a marker is turned
    return np.array([True, *[marker] * 3, *[marker and turns] * 3, *[tracker] * (6 * runs)])


def component_names(columns: PoseColumns) -> tuple[tuple[str, str], ...]:
    """Name the compared components, with units: columns, and for a whole orientation the rotation between the two."""
    named = [(column, "m") for column in columns.position.values()]
    if columns.angles is not None:
        return (*named, *((column, "rad") for column in columns.angles.turning[1]))
    if columns.quaternion is not None or columns.rotation_vector is not None:
        named += [(f"turn about {axis}", "rad") for axis in "xyz"]
    return tuple(named)


def compare(
    columns: PoseColumns, values: np.ndarray, body: BodyPose, qd: np.ndarray, run: np.ndarray, frames: Frames
) -> Compared:
    """Compare logged poses with computed ones.

    Parameters
    ----------
    columns, values : PoseColumns, ndarray
        What is logged, (N, columns).
    body : BodyPose
        Computed from the positions.
    qd : ndarray
        Joint velocities (N, n).
    run : ndarray
        Numbers (N,) of the runs.
    frames : Frames
        Of tracker and marker.
    """
    R_t, p_t, (R_m, p_m) = frames.tracker[0][run], frames.tracker[1][run], frames.marker
    twist = np.einsum("nij,nj->ni", body.by_joints, qd)  # of the body, base axes
    R_b = Rotation.from_rotvec(-frames.delay * twist[:, 3:]).as_matrix() @ body.rotation
    still = body.position - frames.delay * twist[:, :3] + R_b @ p_m
    R, p = R_t @ R_b @ R_m, _turned(R_t, still) + p_t
    residual, by_twist = _components(columns, values, R, p)
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
    free = free_steps(columns, runs)
    return Compared(residual, by_twist @ by_frames, by_twist @ carried(body.by_constants), free, about)


def first_frames(columns: PoseColumns, values: np.ndarray, body: BodyPose, run: np.ndarray) -> Frames:
    """Guess the poses of tracker and marker from full positions and orientations; otherwise leave them unchanged."""
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
            by_turn[:, :, 3 + k] = _wrapped(above - below) / (2 * STEP)
    elif (measured := _orientations(columns, values)) is not None:
        apart = (measured * Rotation.from_matrix(R).inv()).as_rotvec()
        by_turn = np.broadcast_to(np.eye(6)[3:], (len(p), 3, 6))
    else:
        return residual, by_twist
    return np.hstack([residual, _wrapped(apart)]), np.concatenate([by_twist, by_turn], axis=1)


def _wrapped(angle: np.ndarray) -> np.ndarray:
    return np.remainder(angle + np.pi, 2 * np.pi) - np.pi


def _cross_matrices(vectors: np.ndarray) -> np.ndarray:
    """Build the matrices (N, 3, 3) that take the cross product with vectors (N, 3)."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.moveaxis(np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]), 2, 0)
