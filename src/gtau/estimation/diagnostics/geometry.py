"""Check the robot's geometry against logged poses, and find lengths that explain a mismatch.

Poses computed from the joints' positions are compared with logged ones; a wrong length leaves residuals that depend on
the pose. Each constant of the geometry is fitted alone, and the one that explains most is selected; further ones are
added while they explain most of the remaining residuals. Torques hardly show a wrong length: a platform 26 mm too large
leaves the torque errors of the UPV robot (docs/evidence/zoo.md) as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gtau.estimation.diagnostics.geometry_findings import ConstantChange, GeometryTest, PoseResidual
from gtau.estimation.diagnostics.pose_fit import PoseFit, component_names, fit_frames, fit_poses
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
from gtau.model.lengths import Constant
from gtau.progress import Progress, silent
from gtau.robots.geometry import characteristic_length
from gtau.robots.robot import Robot
from gtau.signals.reading.body_columns import PoseColumns
from gtau.signals.reading.side_signals import LoggedPoses

TRIED = 4  # constants that are fitted beyond the first order at each step; one that is the explanation was the first
MOST = 4  # constants that may explain the residuals together: the effort of the search; three were the most found


def geometry_test(
    model: InverseDynamics,
    columns: PoseColumns,
    joints: Sequence[str],
    logged: Sequence[LoggedPoses],
    progress: Progress = silent,
) -> GeometryTest:
    """Test the geometry of a robot by logged poses.

    Parameters and errors raised are those of :func:`gtau.estimation.diagnostics.pose_fit.fit_frames`; ``progress`` is
    called as the work goes on.
    """
    progress("geometry", 0, MOST + 1)
    given = fit_frames(model, columns, joints, logged)
    tried, found = _tried(given), given
    for k in range(MOST):
        progress("geometry", k + 1, MOST + 1)
        better = _better(found, _tried(found) if k else tried, characteristic_length(model.robot))
        if better is None:
            break
        found = better
    progress("geometry", MOST + 1, MOST + 1)
    runs = [each.run for each in logged]
    return _tested(columns, runs, given, found, tried, model.robot)


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
    candidates.sort(key=lambda each: each.left)
    likely = [each for each in candidates[:TRIED] if 1 - each.left / fit.left > GEOMETRY_SHARE * GEOMETRY_LIKELY]
    fitted = [_fitted(fit, each) for each in likely]
    return sorted([*fitted, *candidates[len(likely) :]], key=lambda each: each.left)


def _fitted(before: PoseFit, candidate: _Candidate) -> _Candidate:
    fit = fit_poses(before, (*before.chosen, candidate.constant))
    if fit is None:
        return candidate
    change = float(fit.change[candidate.constant])
    return _Candidate(candidate.constant, change, float(fit.std[-1]), fit.left, fit)


def _better(before: PoseFit, candidates: Sequence[_Candidate], length: float) -> PoseFit | None:
    """Return the fit with the best further constant if it explains much and its change is significant and large."""
    best = next((each for each in candidates if each.fit is not None), None)
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
    columns: PoseColumns, runs: Sequence[str], given: PoseFit, found: PoseFit, tried: Sequence[_Candidate], robot: Robot
) -> GeometryTest:
    """Collect what constants of the geometry explain: from ``given`` frames alone, and with those ``found``."""
    poses, constants, names = given.poses, given.poses.geometry.constants, component_names(columns)
    before, after = (_unexplained(fit) for fit in (given, found))
    linear = np.array([unit == "m" for _, unit in names])
    distances = {
        kind: (_rms_distance(before[:, which]), _rms_distance(after[:, which]))
        for kind, which in {"position": linear, "angle": ~linear}.items()
        if which.any()
    }
    explained = []
    for k, std in zip(found.chosen, found.std[len(found.std) - len(found.chosen) :], strict=True):
        alone = next(candidate for candidate in tried if candidate.constant == k)
        alike = [
            constants[candidate.constant].name
            for candidate in tried
            if candidate.constant != k and candidate.left < GEOMETRY_ALIKE * alone.left and len(found.chosen) == 1
        ]
        change, share = float(found.change[k]), 1 - alone.left / given.left
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
        share=1 - found.left / given.left,
        tried=tuple(
            _change(constants[each.constant], each.change, each.std, 1 - each.left / given.left) for each in tried
        ),
        unseen=tuple(constant.name for k, constant in enumerate(constants) if k not in seen),
        delay=(poses.delay + found.frames.delay, float(found.std[0])),
        residuals=tuple(residuals),
    )


def _change(constant: Constant, change: float, std: float, share: float, alike: tuple[str, ...] = ()) -> ConstantChange:
    return ConstantChange(constant.name, constant.value, change, std, constant.unit, share, alike)


def _unexplained(fit: PoseFit) -> np.ndarray:
    """Compute the residuals (N, m) that the free constants and frames do not explain, in m and rad."""
    return fit.beyond(fit.residual).reshape(len(fit.poses.run), -1) / fit.poses.weights


def _rms_distance(residual: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(residual**2, axis=1))))
