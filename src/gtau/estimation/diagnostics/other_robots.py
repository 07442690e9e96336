"""Fit the data with another robot than described: other bodies at the tool, another length, another gravity.

Parameters adapt to a wrong description, so that torques computed with them do not have the shape of the residuals, and
a linear test points anywhere: the robot is fitted again.

- A body at the tool adds its ten inertial columns in its run (eq. 18), so the data are fitted again with the load of
  one run unknown, then of a second one, as long as that explains much more. An unknown load explains part of any fault
  that is in one run alone; only a mass far from the declared one is a body.
- A wrong length leaves residuals that depend on the motion, as unmodelled friction does; the two differ in shape, not
  in size. With each length a little longer and a little shorter, a parabola through the three sums of squares gives the
  length that fits best, and the share of the residual variance that goes with it.
- An arm on a wall or a ceiling, or a tracker whose vertical is y, has gravity where the robot file has none. The robot
  is fitted again with gravity along each axis of the base, and from the best of them freely (Gauss-Newton over
  directions). Whether torques exclude gravity, as with a driver that compensates it,
  :mod:`gtau.estimation.diagnostics.effort` finds.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import TypeVar

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.alternatives import Alternative, established, of_refit, refitted, residual_ratio
from gtau.estimation.diagnostics.hypotheses.description import DEGREE, GRAVITY, OTHER_GRAVITY
from gtau.estimation.diagnostics.linearisation import linearise, on_channels
from gtau.estimation.diagnostics.verdict import unexplained_shares
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.least_squares import fit_by
from gtau.estimation.estimators.maximum_likelihood import ml_or_wls
from gtau.estimation.estimators.newton import degrees_of_freedom
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.run_blocks import PreparedRuns
from gtau.estimation.thresholds.estimates import (
    GRAVITY_ALIKE,
    GRAVITY_LEAST,
    GRAVITY_MISFIT,
    GRAVITY_SHARE,
    LOAD_ALIKE,
    LOAD_LEFT,
    MASS_ABSENT,
    REFUTED_SHARE,
    REFUTED_STD,
)
from gtau.estimation.thresholds.logs import LENGTH_ALIKE, LENGTH_CHANGE, LENGTH_MOST, LENGTH_SHARE, LENGTH_TRIED
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.findings.words import RELATIVE
from gtau.model.base_parameters import base_parameters
from gtau.model.inverse_dynamics import InverseDynamics, models_alike
from gtau.model.kinematics import SAME_LENGTH
from gtau.progress import Progress, silent
from gtau.robots.geometry import moved_ends
from gtau.robots.robot import Attachment, Joint, Mdh, Placement, Robot
from gtau.signals.preparation.prepared_run import SampleWindow
from gtau.signals.reading.statements import Payload

TOOL_BODIES, LENGTHS = "tool bodies", "lengths"


def other_loads(fit: Fit) -> Alternative | None:
    """Find the runs whose bodies at the tool are other than declared, with their masses; None without any."""
    unrefined = fit.solve(fit.system.problem)  # residuals as those of the others
    own = replace(fit, solution=replace(fit.solution, sigma=unrefined.sigma))
    count, carried, left = len(fit.dataset.runs), tuple[int, ...](), 1.0
    best: Fit | None = None
    while best is None or len(carried) < count - 1:
        wider = [(*carried, run) for run in range(count) if run not in carried]
        tried = {runs: other for runs in wider if (other := _loaded(fit, runs)) is not None}
        ratios = {runs: residual_ratio(other, own) for runs, other in tried.items()}
        least = min(ratios.values(), default=1.0)
        if least > LOAD_LEFT * left:
            break
        # a body in some runs is one that the others lack: more is forgotten than taken away
        alike = [runs for runs, ratio in ratios.items() if ratio < LOAD_ALIKE * least]
        carried = max(alike, key=lambda runs: _masses(fit, tried[runs], runs)[-1])
        best, left = tried[carried], ratios[carried]
    if best is None:
        return None
    masses, places = _masses(fit, best, carried), _places(best, carried)
    std = np.sqrt(np.diag(best.solution.jackknife)[places])
    declared = np.array([_declared(fit, run) for run in carried])
    if np.any(np.abs(masses) < np.maximum(REFUTED_STD * std, MASS_ABSENT * declared)):
        return None
    return _of_bodies(fit, best, own, carried)


def _loaded(fit: Fit, runs: tuple[int, ...]) -> Fit | None:
    """Fit with unknown loads in ``runs``; None where a mass is then not identifiable."""
    declared = [run.payload for run in fit.dataset.runs]
    loads = [Payload(name=f"of run {k}") if k in runs else payload for k, payload in enumerate(declared)]
    other = refitted(fit, loads)
    if other is None or not {f"m_L{run + 1}" for run in runs} <= set(other.system.problem.parameters):
        return None
    return other if set(other.system.unexcited) <= set(fit.system.unexcited) else None


def _places(other: Fit, runs: Sequence[int]) -> list[int]:
    """Numbers of the masses of unknown loads among the parameters."""
    return [other.system.problem.parameters.index(f"m_L{run + 1}") for run in runs]


def _masses(fit: Fit, other: Fit, runs: Sequence[int]) -> np.ndarray:
    """Compute the masses (runs,) of unknown loads beyond what is declared, kg."""
    return np.asarray(other.solution.theta[_places(other, runs)] - [_declared(fit, run) for run in runs])


def _declared(fit: Fit, run: int) -> float:
    """Return the declared mass of a run's payload, kg; 0 without one."""
    payload = fit.dataset.runs[run].payload
    return 0.0 if payload is None else payload.mass or 0.0


def _of_bodies(fit: Fit, other: Fit, own: Fit, carried: Sequence[int]) -> Alternative:
    from scipy.special import stdtrit

    runs, places = fit.dataset.runs, _places(other, carried)
    freedom = degrees_of_freedom(other.system.problem, other.solution, fit.free_gains)[places]
    halves = np.sqrt(np.diag(other.solution.jackknife)[places]) * stdtrit(freedom, 0.975)
    bodies = [
        {
            "run": runs[run].name,
            "more": float(more),
            "half": float(half),
            "declared": "" if (load := runs[run].payload) is None or load.mass is None else load.name,
        }
        for run, more, half in zip(carried, _masses(fit, other, carried), halves, strict=True)
    ]
    helped = (other.solution.sigma / own.solution.sigma) ** 2 < LOAD_LEFT
    joints = tuple(joint for joint, less in zip(fit.system.problem.joints, helped, strict=False) if less)
    cause = Finding(F.TOOL_BODY, joints, values={"bodies": bodies, "remains": residual_ratio(other, own)})
    return of_refit(fit, TOOL_BODIES, cause, other, own)


Placed = TypeVar("Placed", Joint, Attachment)

STEP = 0.01  # relative change of a length
MOST = 12  # lengths that are tried, the longest first: the effort of the search


def other_length(fit: Fit, progress: Progress = silent) -> Alternative | None:
    """Find the length that explains most of the residuals, of similar ones that with the smallest change; or None."""
    lengths = list(_explaining(fit, progress))
    most = max((length.share for length in lengths), default=0.0)
    likely = (length for length in lengths if length.share > LENGTH_ALIKE * most)
    return min(likely, key=lambda length: abs(length.size), default=None)


def _explaining(fit: Fit, progress: Progress) -> Iterator[Alternative]:
    """Try all lengths, and iterate over those that explain a part of the residuals."""
    robot = fit.dataset.robot
    longer, shorter = list(_longer(robot, STEP)), list(_longer(robot, -STEP))
    if not longer:
        return
    before, _ = _fitted(fit, fit.dataset.model)
    models = models_alike([other for _, other in (*longer, *shorter)], fit.dataset.base.standard)
    lengths = list(zip((cause for cause, _ in longer), models, models[len(longer) :], strict=False))
    for k, (cause, *pair) in enumerate(lengths):
        progress("other lengths", k, len(lengths))
        try:
            (above, gains_above), (below, gains_below) = (_fitted(fit, model) for model in pair)
        except GtauError:
            continue  # the robot cannot be assembled or follow its motion with another length
        slope, curvature = (above - below) / 2, (above + below) / 2 - before
        if curvature <= 0:
            continue
        change = -STEP * slope / (2 * curvature)
        share = slope**2 / (4 * curvature * before)
        if share <= LENGTH_SHARE or not LENGTH_CHANGE < abs(change) < LENGTH_MOST:
            continue
        moves = (gains_above - gains_below) / (2 * STEP) * change / fit.gains
        yield established(fit, LENGTHS, cause, moves, share, change, RELATIVE)
    progress("other lengths", len(lengths), len(lengths))


def _fitted(fit: Fit, model: InverseDynamics) -> tuple[float, np.ndarray]:
    """Fit another ``model`` to first order: sum of its squared residuals, and its gains (n,)."""
    step, rest = linearise(fit, fit.dataset.windows(), model=model).fitted()
    change = step[fit.system.problem.gain_rows] if fit.free_gains else np.zeros(len(fit.gains))
    return float(np.sum(rest**2)), fit.gains - fit.gains**2 * change


def _longer(robot: Robot, step: float) -> Iterator[tuple[Finding, Robot]]:
    """Lengthen each length of the robot by a share ``step``, those that are equal together."""
    places = [(joint.name, joint.placement) for joint in robot.joints]
    sides = [(end.body, end.placement) for end in robot.ends]
    lengths: dict[float, list[str]] = {}
    for name, placement in places + sides:
        for length in _lengths(placement):
            same = next((known for known in lengths if abs(known - length) < SAME_LENGTH * known), length)
            if name not in lengths.setdefault(same, []):
                lengths[same].append(name)
    longest = sorted((length for length in lengths if length > LENGTH_TRIED * max(lengths)), reverse=True)[:MOST]
    for length in longest:
        scaled = partial(_scaled, length=length, step=step)
        joints = tuple(map(scaled, robot.joints))
        closures, springs = moved_ends(robot, scaled)
        longer = replace(robot, joints=joints, closures=closures, springs=springs)
        yield Finding(F.LENGTH, values={"length": length, "bodies": lengths[length]}), longer


def _lengths(placement: Placement) -> list[float]:
    values = (
        [abs(placement.d), abs(placement.r), abs(placement.b)]
        if isinstance(placement, Mdh)
        else [float(np.linalg.norm(placement.xyz))]
    )
    return [length for length in values if length > 0]


def _scaled(placed: Placed, length: float, step: float) -> Placed:
    """Lengthen the lengths of this size in the placement of a joint or an end by a share ``step``."""
    placement = placed.placement
    if isinstance(placement, Mdh):
        values = {name: getattr(placement, name) for name in ("d", "r", "b")}
        longer = {k: v * (1 + step) for k, v in values.items() if abs(abs(v) - length) < SAME_LENGTH * length}
        return replace(placed, placement=replace(placement, **longer))
    if abs(float(np.linalg.norm(placement.xyz)) - length) < SAME_LENGTH * length:
        x, y, z = placement.xyz
        return replace(placed, placement=replace(placement, xyz=(x * (1 + step), y * (1 + step), z * (1 + step))))
    return placed


STEPS = 4  # of Gauss-Newton, from an axis at most 55 degrees off


def gravity_asked_for(fit: Fit, alternatives: Sequence[Alternative]) -> bool:
    """Decide whether another gravity is worth fitting (seconds per fit): a tilt helps, or the residual is large."""
    of_gravity = [effect.share for effect in alternatives if effect.hypothesis == GRAVITY.name]
    misfit = float(unexplained_shares(fit.system.problem, fit.solution).max())
    return max(of_gravity, default=0.0) > REFUTED_SHARE or misfit > GRAVITY_MISFIT


def other_gravity(fit: Fit, progress: Progress = silent) -> Alternative | None:
    """Find the gravity of the same strength, along an axis or free, that explains most of the residuals, if any does.

    Nothing is found where gravity is not seen, nor within the few degrees of which the linear test speaks.
    """
    declared = np.array(fit.dataset.robot.gravity)
    size = float(np.linalg.norm(declared))
    windows = [window for _, window in fit.dataset.windows()]  # the middle of the runs bounds the time
    middle = replace(fit.dataset, prepared=PreparedRuns(windows))  # type: ignore[arg-type]  # used as prepared runs
    own = fitted(fit, middle, declared) if size and windows else None
    if own is None:
        return None
    tried = []
    for k, axis in enumerate(np.vstack([np.eye(3), -np.eye(3)])):
        progress("gravity along other axes", k, 6)
        other = own if _degrees(axis, declared) < GRAVITY_LEAST else fitted(fit, own.dataset, size * axis)
        if other is not None:
            tried.append((residual_ratio(other, own), other))
    progress("gravity along other axes", 6, 6)
    left, best = min([(1.0, own), *tried], key=lambda other: other[0])
    alike = [other for rest, other in tried if rest <= GRAVITY_ALIKE * left]
    for better in _freely(fit, best, list(enumerate(windows))):
        if residual_ratio(better, own) < (1 - REFUTED_SHARE) * left:
            left, best, alike = residual_ratio(better, own), better, []
    gravity = np.array(best.dataset.robot.gravity)
    if 1 - left < GRAVITY_SHARE or _degrees(gravity, declared) < GRAVITY_LEAST:
        return None
    before, after = own.solution.sigma, best.solution.sigma
    shares = before / own.system.problem.balance(own.solution.theta)
    helped = [j for j in range(len(fit.gains)) if after[j] ** 2 < (1 - GRAVITY_SHARE) * before[j] ** 2]
    joints = tuple(fit.system.problem.joints[j] for j in helped)
    values = {
        "gravity": gravity.tolist(),
        "also": [list(other.dataset.robot.gravity) for other in alike if other is not best],
        "left": {
            joint: [float(shares[j]), float(shares[j] * after[j] / before[j])]
            for joint, j in zip(joints, helped, strict=True)
        },
        "remains": left,
        "floating": bool(fit.dataset.robot.floating),
    }
    return of_refit(fit, GRAVITY.name, Finding(OTHER_GRAVITY.kind, joints, values=values), best, own)


def fitted(fit: Fit, dataset: Dataset, gravity: np.ndarray) -> Fit | None:
    """Fit with another gravity; None where the data do not determine the gains with it."""
    model, base = dataset.model, dataset.base
    if not np.array_equal(gravity, dataset.robot.gravity):
        model = model.with_gravity(gravity)
        base = base_parameters(model, sensors=dataset.runs[0].sensors)
    gains = None if fit.free_gains else fit.gains
    terms = tuple(term for term in fit.system.terms if term.kind != "fl")
    try:
        other = replace(dataset, model=model, base=base, factors=()).reduced()
        return fit_by(ml_or_wls(gains), fit.system.again(other, terms), fit.free_gains)
    except GtauError:
        return None


def _freely(fit: Fit, start: Fit, windows: Sequence[tuple[int, SampleWindow]]) -> Iterator[Fit]:
    """Rotate gravity to the direction that the residuals favour."""
    at: Fit | None = start
    for _ in range(STEPS):
        if at is None or not (columns := GRAVITY.offered(at)):
            return
        linear = linearise(at, windows, on_channels(GRAVITY.torques(at), GRAVITY.shared))
        tilt = DEGREE * linear.fitted(slice(2))[0][-2:]
        gravity = np.array(at.dataset.robot.gravity)
        size = float(np.linalg.norm(gravity))
        turned = gravity + size * tilt @ [column.causes[0].values["towards"] for column in columns[:2]]
        if not np.isfinite(turned).all() or np.allclose(turned, gravity, rtol=0, atol=1e-4 * size):
            return
        at = fitted(fit, at.dataset, size * turned / np.linalg.norm(turned))
        if at is not None:
            yield at


def _degrees(one: np.ndarray, other: np.ndarray) -> float:
    cosine = one @ other / (np.linalg.norm(one) * np.linalg.norm(other))
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)) / DEGREE)


def missing_gravity(fit: Fit) -> Alternative | None:
    """Fit without gravity, for what that explains of each joint and how it moves the gains; None where it cannot be."""
    windows = [window for _, window in fit.dataset.windows()]
    middle = replace(fit.dataset, prepared=PreparedRuns(windows))  # type: ignore[arg-type]  # used as prepared runs
    own, other = (fitted(fit, middle, gravity) for gravity in (np.array(fit.dataset.robot.gravity), np.zeros(3)))
    if own is None or other is None:
        return None
    n, before, after = len(fit.gains), own.solution.sigma, other.solution.sigma
    shares, ratio = before / own.system.problem.balance(own.solution.theta), after / before
    joints, left = fit.system.problem.joints, residual_ratio(other, own)
    helped = [j for j in range(n) if ratio[j] <= max(np.sqrt(left), ratio[:n].min())]
    explained = {joints[j]: [float(shares[j]), float(shares[j] * ratio[j])] for j in helped}
    cause = Finding(F.WITHOUT_GRAVITY, tuple(explained), values={"left": explained, "remains": left})
    return of_refit(fit, GRAVITY.name, cause, other, own)


def likelier_gravity(fit: Fit, missing: Alternative | None, other: Alternative | None) -> Alternative | None:
    """Choose between no gravity and another one by residual variance; if similar, only logged torques lack it."""
    if missing is None or other is None:
        return missing or other
    alike = 1 / GRAVITY_ALIKE if fit.dataset.runs[0].kind == "torque" else GRAVITY_ALIKE
    left, without = (effect.causes[0].values["remains"] for effect in (other, missing))
    return other if left < alike * without else missing
