"""Fit frames and constants of the geometry to logged poses, and find the constants that explain a mismatch.

A logged pose is ``T_t(0_T_b(q(t - d))) T_m``: of the body in the base, after a frame ``T_m`` of a tool or marker
fixed to the body, in the frame ``T_t`` of a tracker, delayed by ``d`` to the positions. The unknown ones are estimated
together with any other unknowns, and absorb the residuals that both explain. A tracker may have been moved or
calibrated anew between runs: it has a frame in each (the tracker of the UPV logs moved by 9 mm before the last run).

A wrong length leaves residuals that depend on the pose. Each constant of the geometry is fitted alone, and the one that
explains most is selected; further ones are added while they explain most of the remaining residuals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from gtau.errors import GtauError
from gtau.estimation.diagnostics.geometry import ConstantChange, GeometryTest, PoseResidual
from gtau.estimation.regression.rows import instants
from gtau.findings import Progress, silent
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.lengths import BodyPose, VariableGeometry, variable_geometry
from gtau.robots.geometry import characteristic_length
from gtau.robots.placement import within_a_turn
from gtau.signals.reading.body_columns import PoseColumns
from gtau.signals.reading.logs import LoggedPoses

GEOMETRY_SHARE = 0.5  # share of the remaining variance of the pose residuals that a length or an encoder zero explains
GEOMETRY_STD = 6.0  # change of a length or zero that explains the pose, in standard deviations
GEOMETRY_CHANGE = 0.005  # change of that constant, of its length, of the robot's mean length (zeros in m), or in rad
GEOMETRY_RMS = 0.01  # rms distance of logged and computed positions, of the mean length: with more, not confirmed
GEOMETRY_LIKELY = 0.5  # share explained to first order, over GEOMETRY_SHARE, from which a constant is fitted for good
GEOMETRY_ALIKE = 1.5  # squares of the residuals with another constant over those with the best: with less, as likely
GEOMETRY_FREE = 0.001  # rms effect of a constant on the pose that other free constants leave, over its whole effect

SAMPLES = 400  # of all runs together: residuals are smooth, so that more hardly add anything
STRETCHES = 8  # of a run, whose residuals are taken for independent of each other
LONGEST = 0.1  # s: delays of poses beyond it are none
SHORTEST = 1e-3  # s: a smaller delay needs no positions of its own
APART = 5  # rows on either side, over which speeds are taken from positions
TRIED = 4  # constants that are fitted beyond the first order at each step; one that is the explanation was the first
MOST = 4  # constants that may explain the residuals together: the effort of the search; three were the most found
STEP = 1e-6  # m, rad and s: of differences, between rounding and the second order
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
        return self.columns.orientations(self.values[:, len(self.columns.position) :])


Frames = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Orientations, positions of the base in the tracker (runs, ...), orientation of the marker, points to turn about."""


def guessed_frames(poses: Poses, body: BodyPose) -> Frames:
    """Guess the frames of tracker and marker from full positions and orientations; otherwise leave them unchanged."""
    columns, run, measured = poses.columns, poses.run, poses.orientations
    runs = int(run.max()) + 1
    R_t, p_t, R_m = np.tile(np.eye(3), (runs, 1, 1)), np.zeros((runs, 3)), np.eye(3)
    if columns.source == "tracker" and len(columns.axes) == 3:
        for k in range(runs):
            logged = poses.values[run == k][:, np.argsort(columns.axes)]
            computed = body.position[run == k]
            centres = logged.mean(axis=0), computed.mean(axis=0)
            R_t[k] = Rotation.align_vectors(logged - centres[0], computed - centres[1])[0].as_matrix()
            p_t[k] = centres[0] - R_t[k] @ centres[1]
    if columns.source != "controller" and measured is not None:
        on_body = np.swapaxes(R_t[run] @ body.rotation, 1, 2) @ measured.as_matrix()
        R_m = Rotation.from_matrix(on_body).mean().as_matrix()
    return R_t, p_t, R_m, np.array([body.position[run == k].mean(axis=0) for k in range(runs)])


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
        source = self.poses.columns.source
        turns = any(unit == "rad" for _, unit in self.poses.columns.components)
        marker, tracker = source != "controller", source == "tracker"
        # where only a position is logged, nobody sees how a marker is turned
        return np.repeat([True, marker, marker and turns, tracker], [1, 3, 3, len(self.moved) - 7])

    def _apart(self, moved: np.ndarray, position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """Compute logged less computed components (N, m) with the body (N, 3), (N, 3, 3) in the base."""
        poses, (R_tracker, p_tracker, R_m, about) = self.poses, self.frames
        columns, run, tracker = poses.columns, poses.run, moved[7:].reshape(-1, 6)
        shift = -moved[0] * _turned(self.body.by_joints, poses.qd)  # (N, 6), base axes
        R_b = Rotation.from_rotvec(shift[:, 3:]).as_matrix() @ rotation
        p_b = position + shift[:, :3] + R_b @ moved[1:4]
        R_t = Rotation.from_rotvec(tracker[:, 3:]).as_matrix() @ R_tracker
        p_t = p_tracker + tracker[:, :3] + _turned(R_tracker, about)
        R = R_t[run] @ R_b @ Rotation.from_rotvec(moved[4:7]).as_matrix() @ R_m
        p = _turned(R_t[run], p_b - about[run]) + p_t[run]
        n = len(columns.axes)
        apart = poses.values[:, :n] - p[:, list(columns.axes)]
        if columns.angles is not None:
            sequence, names = columns.angles.turning
            angles = np.asarray(Rotation.from_matrix(R).as_euler(sequence))[:, : len(names)]
            return np.hstack([apart, within_a_turn(poses.values[:, n:] - angles)])
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
        less = np.where([unit == "rad" for _, unit in self.poses.columns.components], within_a_turn(less), less)
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
    def _factors(self) -> tuple[np.ndarray, np.ndarray]:
        """Orthonormal basis (N m, r) of the columns, and the inverse (k, N m) that gives unknowns."""
        size = np.linalg.norm(self.columns, axis=0)
        size[size == 0] = 1.0
        U, sigma, Vt = np.linalg.svd(self.columns / size, full_matrices=False)
        kept = sigma > DEPENDENT * sigma[0]
        return U[:, kept], Vt[kept].T / sigma[kept] @ U[:, kept].T / size[:, None]

    def beyond(self, vector: np.ndarray) -> np.ndarray:
        """Project a ``vector`` (N m,) on the complement of the columns."""
        basis, _ = self._factors
        return vector - basis @ (basis.T @ vector)

    @cached_property
    def rest(self) -> float:
        """Sum of the squared weighted residuals that the columns do not explain to first order."""
        return float(np.sum(self.beyond(self.residual) ** 2))

    def scatter(self, scores: np.ndarray) -> np.ndarray:
        """Compute the standard deviations of sums of ``scores`` (k, N m), whose sums over stretches are independent."""
        N, stretches = len(self.poses.stretch), np.unique(self.poses.stretch)
        parts = scores.reshape(len(scores), N, -1).sum(axis=2)
        sums = np.array([parts[:, self.poses.stretch == k].sum(axis=1) for k in stretches])
        return np.asarray(np.sqrt(np.sum(sums**2, axis=0) * len(sums) / (len(sums) - 1)))

    @cached_property
    def std(self) -> np.ndarray:
        """Standard deviations (k,) from the scores of stretches, which hold where residuals are autocorrelated."""
        return self.scatter(self._factors[1] * self.beyond(self.residual))


def fit_poses(fit: PoseFit, chosen: Sequence[int]) -> PoseFit | None:
    """Fit the frames and the constants ``chosen`` from a fit on; None where the loops cannot follow."""
    from scipy.optimize import least_squares

    start, free, geometry = replace(fit, chosen=tuple(chosen)), fit.free, fit.poses.geometry
    if not np.isfinite(start.columns).all():
        return None
    places = list(start.chosen)

    @lru_cache(maxsize=2)
    def at(*unknowns: float) -> PoseFit | None:
        """Return the fit at these unknowns (k,); None where the loops cannot follow."""
        moved, change = start.moved.copy(), start.change.copy()
        moved[free], change[places] = np.split(unknowns, [len(unknowns) - len(places)])
        if not places:
            return replace(start, moved=moved)
        c = geometry.close(start.c, start.change, change)
        return None if c is None else replace(start, moved=moved, change=change, c=c, body=geometry.pose(c, change))

    def residual(unknowns: np.ndarray) -> np.ndarray:
        other = at(*unknowns)
        return np.full(start.apart.size, np.nan) if other is None else other.residual

    def slopes(unknowns: np.ndarray) -> np.ndarray:
        other = at(*unknowns)
        return np.full(start.columns.shape, np.nan) if other is None else -other.columns

    first = np.concatenate([start.moved[free], start.change[places]])
    try:
        solved = least_squares(residual, first, slopes, x_scale="jac", ftol=SETTLED, max_nfev=STEPS)
    except ValueError:  # not finite, as the loops cannot follow
        return None
    fitted = at(*solved.x)
    return fitted if fitted and np.isfinite(fitted.columns).all() else None


def geometry_test(
    model: InverseDynamics,
    columns: PoseColumns,
    joints: Sequence[str],
    logged: Sequence[LoggedPoses],
    progress: Progress = silent,
) -> GeometryTest:
    """Test the geometry of a robot by logged poses; for parameters and refusals see :func:`fit_frames`."""
    progress("geometry", 0, MOST + 1)
    given = fit = fit_frames(model, columns, joints, logged)
    length, alone = characteristic_length(model.robot), _candidates(given)
    candidates = alone
    for k in range(MOST):
        progress("geometry", k + 1, MOST + 1)
        if (better := _better(candidates, length)) is None:
            break
        fit, candidates = better, _candidates(better)
    progress("geometry", MOST + 1, MOST + 1)
    return _tested(columns.body or model.robot.tool, [poses.run for poses in logged], given, fit, alone, length)


Candidate = tuple[float, int, ConstantChange, PoseFit | None]
"""Squares that a further constant leaves, its number and change, and its fit beyond first order."""


def _candidates(fit: PoseFit) -> list[Candidate]:
    """List the constants with an effect of their own that could be freed next, best first, the likely ones fitted."""
    residual, candidates = fit.beyond(fit.residual), list[Candidate]()
    for k, constant in enumerate(fit.poses.geometry.constants):
        column = fit.column(k)
        effect = fit.beyond(column)
        size = float(effect @ effect)
        if not np.isfinite(effect).all() or size <= GEOMETRY_FREE**2 * (column @ column):
            continue
        change = float(effect @ residual / size)
        rest = residual - change * effect
        std, left = float(fit.scatter((effect * rest)[None])[0]) / size, float(rest @ rest)
        changed = ConstantChange(constant.name, constant.value, change, std, constant.unit, 1 - left / fit.rest)
        candidates.append((left, k, changed, None))
    candidates.sort(key=lambda candidate: candidate[0])
    for place, (_, k, changed, _) in enumerate(candidates[:TRIED]):
        likely = changed.share > GEOMETRY_SHARE * GEOMETRY_LIKELY
        if likely and (fitted := fit_poses(fit, (*fit.chosen, k))):
            change, share = float(fitted.change[k]), 1 - fitted.rest / fit.rest
            changed = replace(changed, change=change, std=float(fitted.std[-1]), share=share)
            candidates[place] = fitted.rest, k, changed, fitted
    return sorted(candidates, key=lambda candidate: candidate[0])


def _better(candidates: Sequence[Candidate], length: float) -> PoseFit | None:
    """Return the fit with the best further constant if it explains much and its change is significant and large."""
    for _, _, constant, fit in candidates:
        if fit is not None:
            scale = constant.value or (length if constant.unit == "m" else 1.0)
            large = abs(constant.change) > max(GEOMETRY_STD * constant.std, GEOMETRY_CHANGE * scale)
            return fit if large and constant.share > GEOMETRY_SHARE else None
    return None


def _tested(
    body: str, runs: Sequence[str], given: PoseFit, fit: PoseFit, tried: Sequence[Candidate], length: float
) -> GeometryTest:
    """Collect what constants of the geometry explain: from ``given`` frames alone, and with those that ``fit`` has."""
    poses = given.poses
    # residuals (N, m) in m and rad that the free constants and frames do not explain
    parts = [state.beyond(state.residual).reshape(len(poses.run), -1) / poses.weights for state in (given, fit)]
    distances = {}
    for kind, unit in (("position", "m"), ("angle", "rad")):
        if places := [j for j, component in enumerate(poses.columns.components) if component[1] == unit]:
            before, after = (float(np.sqrt(np.mean(np.sum(part[:, places] ** 2, axis=1)))) for part in parts)
            distances[kind] = before, after
    alone = {k: change for _, k, change, _ in tried}
    chosen = zip(fit.chosen, fit.std[len(fit.std) - len(fit.chosen) :].tolist(), strict=True)
    explained = [replace(alone[k], change=float(fit.change[k]), std=std) for k, std in chosen]
    if len(explained) == 1:
        most = GEOMETRY_ALIKE * next(rest for rest, k, *_ in tried if k == fit.chosen[0])
        alike = [alone[k].name for rest, k, *_ in tried if k != fit.chosen[0] and rest < most]
        explained = [replace(explained[0], alike=tuple(alike))]
    far = distances.get("position", (0.0, 0.0))[1] > GEOMETRY_RMS * length
    residuals = []
    for number, run in enumerate(runs):
        mine = poses.run == number
        for j, (name, unit) in enumerate(poses.columns.components):
            before, after = (part[mine, j] for part in parts)
            rms, rest = (float(np.sqrt(np.mean(part**2))) for part in (before, after))
            bias, time = float(np.mean(before)), poses.time[mine]
            residuals.append(PoseResidual(run, name, unit, rms, bias, rest, time, before, after))
    return GeometryTest(
        body=body,
        source=poses.columns.source,
        outcome="unexplained" if far else "other constants" if explained else "confirmed",
        distances=distances,
        explained_by=tuple(explained),
        share=1 - fit.rest / given.rest,
        tried=tuple(alone.values()),
        unseen=tuple(constant.name for k, constant in enumerate(poses.geometry.constants) if k not in alone),
        delay=(poses.delay + float(fit.moved[0]), float(fit.std[0])),
        residuals=tuple(residuals),
    )


def fit_frames(
    model: InverseDynamics, columns: PoseColumns, joints: Sequence[str], logged: Sequence[LoggedPoses]
) -> PoseFit:
    """Fit the unknown frames alone, components weighted by the residual that no constant explains to first order.

    ``joints`` is the order of the logged positions, ``logged`` one for each run. Raises GtauError where the loops
    cannot be closed along them, or a run's time does not rise.
    """
    geometry = variable_geometry(model.robot, columns.body or model.robot.tool)
    order = [list(joints).index(joint) for joint in model.actuated]
    turning = [model.robot.joint(joint).turns for joint in model.actuated]

    def sampled(delay: float) -> tuple[Poses, np.ndarray]:
        """Sample the poses, with the positions of the joints a ``delay`` earlier, and configurations there."""
        parts: list[tuple[np.ndarray, ...]] = []
        for k, log in enumerate(logged):
            q, time = np.array(log.q[:, order]), np.asarray(log.time)
            q[:, turning] = np.unwrap(q[:, turning], axis=0)
            count = min(max(SAMPLES // len(logged), 2 * STRETCHES), len(q) - 2 * APART)
            at = np.unique(np.linspace(APART, len(q) - 1 - APART, count).round().astype(int))
            step = time[at + APART] - time[at - APART]
            if not (step > 0).all():
                raise GtauError(
                    f"run '{log.run}': its time does not rise at the logged poses; correct the time column."
                )
            qd = (q[at + APART] - q[at - APART]) / step[:, None]
            stretch = STRETCHES * k + np.arange(len(at)) * STRETCHES // len(at)
            earlier = np.stack([np.interp(time[at] - delay, time, column) for column in q.T])
            c = model.path(earlier, instants(log.run, time[at]))
            parts.append((np.asarray(log.values[at]), qd, time[at] - time[0], np.full(len(at), k), stretch, c.T))
        values, qd, since, run, stretch, c = map(np.concatenate, zip(*parts, strict=True))
        return Poses(geometry, columns, values, qd, since, run, stretch, np.ones(1), delay), c.T.copy()

    def fitted(delay: float) -> PoseFit:
        poses, c = sampled(delay)
        change = np.zeros(len(geometry.constants))
        body, still = geometry.pose(c, change), np.zeros(7 + 6 * len(logged))
        fit = fit_poses(PoseFit(poses, guessed_frames(poses, body), still, change, c, body), ())
        assert fit is not None  # without other constants the loops stay closed
        shown = np.flatnonzero(np.isfinite(fit.body.by_constants).all(axis=(0, 1)))
        rest = replace(fit, chosen=tuple(shown.tolist())).beyond(fit.residual).reshape(fit.apart.shape)
        weights = 1 / np.maximum(np.sqrt(np.mean(rest**2, axis=0)), FLOOR)
        fit = fit_poses(replace(fit, poses=replace(poses, weights=weights)), ())
        assert fit is not None
        return fit

    fit = fitted(0.0)
    delay = float(np.clip(fit.moved[0], -LONGEST, LONGEST))
    # a delay by velocities alone is wrong by half the acceleration times its square, 0.4 mm at 20 ms of a quick arm
    return fitted(delay) if abs(delay) > SHORTEST else fit
