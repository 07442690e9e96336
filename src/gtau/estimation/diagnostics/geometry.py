"""Check the robot's geometry against logged poses, and find lengths that explain a mismatch.

Poses computed from the joints' positions are compared with logged ones; a wrong length leaves residuals that depend on
the pose. Each constant of the geometry is fitted alone, and the one that explains most is selected; further ones are
added while they explain most of the remaining residuals. Torques hardly show a wrong length: a platform 26 mm too large
leaves the torque errors of the UPV robot (docs/evidence/zoo.md) as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.geometry_findings import ConstantChange, GeometryTest, PoseResidual
from gtau.estimation.diagnostics.pose_fit import (
    FLOOR,
    SHORTEST,
    PoseFit,
    Poses,
    component_names,
    first_frames,
    fit_poses,
)
from gtau.estimation.regression.rows import instants
from gtau.estimation.thresholds.logs import (
    GEOMETRY_ALIKE,
    GEOMETRY_CHANGE,
    GEOMETRY_FREE,
    GEOMETRY_LIKELY,
    GEOMETRY_RMS,
    GEOMETRY_SHARE,
    GEOMETRY_STD,
)
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.lengths import Constant, VariableGeometry, variable_geometry
from gtau.progress import Progress, silent
from gtau.robots.geometry import characteristic_length
from gtau.robots.robot import Robot
from gtau.signals.reading.body_columns import PoseColumns
from gtau.signals.reading.side_signals import LoggedPoses

SAMPLES = 400  # of all runs together: residuals are smooth, so that more hardly add anything
STRETCHES = 8  # of a run, whose residuals are taken for independent of each other
LONGEST = 0.1  # s: delays of poses beyond it are none
APART = 5  # rows on either side, over which speeds are taken from positions
TRIED = 4  # constants that are fitted beyond the first order at each step; one that is the explanation was the first
MOST = 4  # constants that may explain the residuals together: the effort of the search; three were the most found


def geometry_test(
    model: InverseDynamics,
    columns: PoseColumns,
    joints: Sequence[str],
    logged: Sequence[LoggedPoses],
    progress: Progress = silent,
) -> GeometryTest:
    """Test the geometry of a robot by logged poses; for parameters and refusals see :func:`fit_frames`."""
    progress("geometry", 0, MOST + 1)
    given = fit_frames(model, columns, joints, logged)
    tried, fit = _tried(given), given
    for k in range(MOST):
        progress("geometry", k + 1, MOST + 1)
        better = _better(fit, _tried(fit) if k else tried, characteristic_length(model.robot))
        if better is None:
            break
        fit = better
    progress("geometry", MOST + 1, MOST + 1)
    runs = [poses.run for poses in logged]
    return _tested(columns, runs, given, fit, tried, model.robot)


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A further free constant: the residual that it explains, to first order or, once fitted, exactly.

    ``left`` are the squares that it leaves.
    """

    constant: int
    change: float
    std: float
    left: float
    fit: PoseFit | None = None


def _tried(fit: PoseFit) -> list[_Candidate]:
    """List the constants with an effect of their own that could be freed next, best first, the likely ones fitted."""
    residual, candidates = fit.beyond(fit.residual), []
    for k in range(len(fit.poses.geometry.constants)):
        column = fit.column(k)
        own = fit.beyond(column)
        if not np.isfinite(own).all() or own @ own <= GEOMETRY_FREE**2 * (column @ column):
            continue
        change = float(own @ residual / (own @ own))
        left = residual - change * own
        scores = (own * left).reshape(len(fit.poses.stretch), -1).sum(axis=1)
        parts = np.bincount(fit.poses.stretch, scores)
        std = float(np.sqrt(np.sum(parts**2) * len(parts) / (len(parts) - 1)) / (own @ own))
        candidates.append(_Candidate(k, change, std, float(left @ left)))
    candidates.sort(key=lambda trial: trial.left)
    likely = [trial for trial in candidates[:TRIED] if 1 - trial.left / fit.left > GEOMETRY_SHARE * GEOMETRY_LIKELY]
    fitted = [_fitted(fit, trial) for trial in likely]
    return sorted([*fitted, *candidates[len(likely) :]], key=lambda trial: trial.left)


def _fitted(before: PoseFit, candidate: _Candidate) -> _Candidate:
    fit = fit_poses(before, (*before.chosen, candidate.constant))
    if fit is None:
        return candidate
    change = float(fit.change[candidate.constant])
    return _Candidate(candidate.constant, change, float(fit.std[-1]), fit.left, fit)


def _better(before: PoseFit, candidates: Sequence[_Candidate], length: float) -> PoseFit | None:
    """Return the fit with the best further constant if it explains much and its change is significant and large."""
    best = next((trial for trial in candidates if trial.fit is not None), None)
    if best is None or best.constant in before.chosen:
        return None
    constant = before.poses.geometry.constants[best.constant]
    scale = constant.value or (length if constant.unit == "m" else 1.0)
    wrong = (
        1 - best.left / before.left > GEOMETRY_SHARE
        and abs(best.change) > GEOMETRY_STD * best.std
        and abs(best.change) > GEOMETRY_CHANGE * scale
    )
    return best.fit if wrong else None


def _tested(
    columns: PoseColumns, runs: Sequence[str], given: PoseFit, fit: PoseFit, tried: Sequence[_Candidate], robot: Robot
) -> GeometryTest:
    """Collect what constants of the geometry explain: from ``given`` frames alone, and with those ``found``."""
    poses, constants, names = given.poses, given.poses.geometry.constants, component_names(columns)
    before, after = (_unexplained(fit) for fit in (given, fit))
    linear = np.array([unit == "m" for _, unit in names])
    distances = {
        kind: (_rms_distance(before[:, which]), _rms_distance(after[:, which]))
        for kind, which in {"position": linear, "angle": ~linear}.items()
        if which.any()
    }
    explained = []
    for k, std in zip(fit.chosen, fit.std[len(fit.std) - len(fit.chosen) :], strict=True):
        alone = next(candidate for candidate in tried if candidate.constant == k)
        alike = [
            constants[candidate.constant].name
            for candidate in tried
            if candidate.constant != k and candidate.left < GEOMETRY_ALIKE * alone.left and len(fit.chosen) == 1
        ]
        change, share = float(fit.change[k]), 1 - alone.left / given.left
        explained.append(_change(constants[k], change, float(std), share, tuple(alike)))
    seen = {candidate.constant for candidate in tried}
    off = linear.any() and distances["position"][1] > GEOMETRY_RMS * characteristic_length(robot)
    residuals = []
    for k, run in enumerate(runs):
        mine = poses.run == k
        for j, (name, unit) in enumerate(names):
            of_time = poses.time[mine], before[mine, j], after[mine, j]
            rms, left = (float(np.sqrt(np.mean(part**2))) for part in of_time[1:])
            residuals.append(PoseResidual(run, name, unit, rms, float(np.mean(of_time[1])), left, *of_time))
    return GeometryTest(
        body=columns.body or robot.tool,
        source=columns.source,
        outcome="unexplained" if off else "other constants" if explained else "confirmed",
        distances=distances,
        explained_by=tuple(explained),
        share=1 - fit.left / given.left,
        tried=tuple(
            _change(constants[trial.constant], trial.change, trial.std, 1 - trial.left / given.left) for trial in tried
        ),
        unseen=tuple(constant.name for k, constant in enumerate(constants) if k not in seen),
        delay=(poses.delay + fit.frames.delay, float(fit.std[0])),
        residuals=tuple(residuals),
    )


def _change(constant: Constant, change: float, std: float, share: float, alike: tuple[str, ...] = ()) -> ConstantChange:
    return ConstantChange(constant.name, constant.value, change, std, constant.unit, share, alike)


def _unexplained(fit: PoseFit) -> np.ndarray:
    """Compute the residuals (N, m) that the free constants and frames do not explain, in m and rad."""
    return fit.beyond(fit.residual).reshape(len(fit.poses.run), -1) / fit.poses.weights


def _rms_distance(residual: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(residual**2, axis=1))))


def fit_frames(
    model: InverseDynamics, columns: PoseColumns, joints: Sequence[str], logged: Sequence[LoggedPoses]
) -> PoseFit:
    """Fit the unknown frames alone, components weighted by the residual that no constant explains to first order.

    ``joints`` is the order of the logged positions, ``logged`` one for each run. Raises GtauError where the loops
    cannot be closed along them, or a run's time does not rise.
    """
    geometry = variable_geometry(model.robot, columns.body or model.robot.tool)
    fit = _fit_delayed(model, geometry, columns, joints, logged, 0.0)
    delay = float(np.clip(fit.frames.delay, -LONGEST, LONGEST))
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
    for k, log in enumerate(logged):
        q, time = np.array(log.q[:, order]), np.asarray(log.time)
        q[:, turning] = np.unwrap(q[:, turning], axis=0)
        count = min(max(SAMPLES // len(logged), 2 * STRETCHES), len(q) - 2 * APART)
        at = np.unique(np.linspace(APART, len(q) - 1 - APART, count).round().astype(int))
        step = time[at + APART] - time[at - APART]
        if not (step > 0).all():
            raise GtauError(f"run '{log.run}': its time does not rise at the logged poses; correct the time column.")
        qd = (q[at + APART] - q[at - APART]) / step[:, None]
        stretch = STRETCHES * k + np.arange(len(at)) * STRETCHES // len(at)
        earlier = np.stack([np.interp(time[at] - delay, time, column) for column in q.T])
        c = model.path(earlier, instants(log.run, time[at]))
        parts.append((np.asarray(log.values[at]), qd, time[at] - time[0], np.full(len(at), k), stretch, c.T))
    values, qd, time, run, stretch, c = (np.concatenate(log) for log in zip(*parts, strict=True))
    weights = np.ones(len(component_names(columns)))
    poses = Poses(geometry, columns, values, qd, time, run, stretch, weights, delay)
    c, change = c.T.copy(), np.zeros(len(geometry.constants))
    body = geometry.pose(c, change)
    fit = fit_poses(PoseFit(poses, first_frames(poses, body), change, c, body, ()), ())
    assert fit is not None  # without other constants the loops stay closed
    seen = np.flatnonzero(np.isfinite(fit.compared[2]).all(axis=(0, 1)))
    left = replace(fit, chosen=tuple(seen.tolist())).beyond(fit.residual).reshape(len(values), -1)
    weights = 1 / np.maximum(np.sqrt(np.mean(left**2, axis=0)), FLOOR)
    weighed = fit_poses(replace(fit, poses=replace(poses, weights=weights)), ())
    assert weighed is not None
    return weighed
