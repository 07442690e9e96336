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
from gtau.estimation.diagnostics.geometry import ConstantChange, GeometryTest, PoseResidual
from gtau.estimation.diagnostics.pose_fit import (
    FLOOR,
    SHORTEST,
    PoseFit,
    Poses,
    component_names,
    fit_poses,
    jackknife_std,
    unfitted,
)
from gtau.estimation.regression.rows import instants
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.lengths import variable_geometry
from gtau.progress import Progress, silent
from gtau.robots.geometry import characteristic_length
from gtau.robots.robot import Robot
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
    given = fit = fit_frames(model, columns, joints, logged)
    candidates = tried = _candidates(given)
    for k in range(MOST):
        if k:
            candidates = _candidates(fit)
        progress("geometry", k + 1, MOST + 1)
        better = _better(fit, candidates, characteristic_length(model.robot))
        if better is None:
            break
        fit = better
    progress("geometry", MOST + 1, MOST + 1)
    return _tested(columns, [poses.run for poses in logged], given, fit, tried, model.robot)


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A further free constant: the residual that it explains, to first order or, once fitted, exactly.

    ``rest`` are the squares that it leaves.
    """

    constant: int
    change: float
    std: float
    rest: float
    fit: PoseFit | None = None


def _candidates(fit: PoseFit) -> list[_Candidate]:
    """List the constants with an effect of their own that could be freed next, best first, the likely ones fitted."""
    residual, candidates = fit.beyond(fit.residual), []
    for k in range(len(fit.poses.geometry.constants)):
        column = fit.column(k)
        effect = fit.beyond(column)
        size = float(effect @ effect)
        if not np.isfinite(effect).all() or size <= GEOMETRY_FREE**2 * (column @ column):
            continue
        change = float(effect @ residual / size)
        rest = residual - change * effect
        scores = (effect * rest).reshape(len(fit.poses.stretch), -1).sum(axis=1)
        std = float(jackknife_std(np.bincount(fit.poses.stretch, scores))) / size
        candidates.append(_Candidate(k, change, std, float(rest @ rest)))
    candidates.sort(key=lambda candidate: candidate.rest)
    for place, candidate in enumerate(candidates[:TRIED]):
        k = candidate.constant
        likely = 1 - candidate.rest / fit.rest > GEOMETRY_SHARE * GEOMETRY_LIKELY
        if likely and (fitted := fit_poses(fit, (*fit.chosen, k))):
            change, std = float(fitted.change[k]), float(fitted.std[-1])
            candidates[place] = _Candidate(k, change, std, fitted.rest, fitted)
    return sorted(candidates, key=lambda candidate: candidate.rest)


def _better(before: PoseFit, candidates: Sequence[_Candidate], length: float) -> PoseFit | None:
    """Return the fit with the best further constant if it explains much and its change is significant and large."""
    best = next((candidate for candidate in candidates if candidate.fit is not None), None)
    if best is None:
        return None
    constant = before.poses.geometry.constants[best.constant]
    scale = constant.value or (length if constant.unit == "m" else 1.0)
    explains = 1 - best.rest / before.rest > GEOMETRY_SHARE
    return best.fit if explains and abs(best.change) > max(GEOMETRY_STD * best.std, GEOMETRY_CHANGE * scale) else None


def _tested(
    columns: PoseColumns, runs: Sequence[str], given: PoseFit, fit: PoseFit, tried: Sequence[_Candidate], robot: Robot
) -> GeometryTest:
    """Collect what constants of the geometry explain: from ``given`` frames alone, and with those that ``fit`` has."""
    poses, constants, names = given.poses, given.poses.geometry.constants, component_names(columns)
    # residuals (N, m) in m and rad that the free constants and frames do not explain
    parts = [state.beyond(state.residual).reshape(len(poses.run), -1) / poses.weights for state in (given, fit)]
    distances = {}
    for kind, unit in (("position", "m"), ("angle", "rad")):
        if chosen := [j for j, name in enumerate(names) if name[1] == unit]:
            before, after = (float(np.sqrt(np.mean(np.sum(part[:, chosen] ** 2, axis=1)))) for part in parts)
            distances[kind] = before, after
    alone = {}
    for candidate in tried:
        constant, share = constants[candidate.constant], 1 - candidate.rest / given.rest
        size = candidate.change, candidate.std
        alone[candidate.constant] = ConstantChange(constant.name, constant.value, *size, constant.unit, share)
    explained = [
        replace(alone[k], change=float(fit.change[k]), std=float(std))
        for k, std in zip(fit.chosen, fit.std[len(fit.std) - len(fit.chosen) :], strict=True)
    ]
    if len(explained) == 1:
        (k,) = fit.chosen
        most = GEOMETRY_ALIKE * next(candidate.rest for candidate in tried if candidate.constant == k)
        alike = [alone[other.constant].name for other in tried if other.constant != k and other.rest < most]
        explained = [replace(explained[0], alike=tuple(alike))]
    far = "position" in distances and distances["position"][1] > GEOMETRY_RMS * characteristic_length(robot)
    residuals = []
    for number, run in enumerate(runs):
        for j, (name, unit) in enumerate(names):
            mine = poses.run == number
            before, after = (part[mine, j] for part in parts)
            rms, rest = (float(np.sqrt(np.mean(part**2))) for part in (before, after))
            bias = float(np.mean(before))
            residuals.append(PoseResidual(run, name, unit, rms, bias, rest, poses.time[mine], before, after))
    return GeometryTest(
        body=columns.body or robot.tool,
        source=columns.source,
        outcome="unexplained" if far else "other constants" if explained else "confirmed",
        distances=distances,
        explained_by=tuple(explained),
        share=1 - fit.rest / given.rest,
        tried=tuple(alone.values()),
        unseen=tuple(constant.name for k, constant in enumerate(constants) if k not in alone),
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

    def fitted(delay: float) -> PoseFit:
        """Fit the frames, with the positions of the joints taken by a ``delay`` earlier than the poses."""
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
        values, qd, time, run, stretch, c = map(np.concatenate, zip(*parts, strict=True))
        weights = np.ones(len(component_names(columns)))
        poses = Poses(geometry, columns, values, qd, time, run, stretch, weights, delay)
        fit = fit_poses(unfitted(poses, c.T.copy()), ())
        assert fit is not None  # without other constants the loops stay closed
        shown = np.flatnonzero(np.isfinite(fit.body.by_constants).all(axis=(0, 1)))
        rest = replace(fit, chosen=tuple(shown.tolist())).beyond(fit.residual).reshape(len(values), -1)
        weights = 1 / np.maximum(np.sqrt(np.mean(rest**2, axis=0)), FLOOR)
        fit = fit_poses(replace(fit, poses=replace(poses, weights=weights)), ())
        assert fit is not None
        return fit

    fit = fitted(0.0)
    delay = float(np.clip(fit.moved[0], -LONGEST, LONGEST))
    # a delay by velocities alone is wrong by half the acceleration times its square, 0.4 mm at 20 ms of a quick arm
    return fitted(delay) if abs(delay) > SHORTEST else fit
