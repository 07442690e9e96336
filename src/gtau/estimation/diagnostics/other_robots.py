"""Fit the data with another robot than described: other bodies at the tool, another gravity.

Parameters adapt to a wrong description, so that torques computed with them do not have the shape of the residuals, and
a linear test points anywhere: the robot is fitted again.

- A body at the tool adds its ten inertial columns in its run (eq. 18), so the data are fitted again with the load of
  one run unknown, then of a second one, as long as that explains much more. An unknown load explains part of any fault
  that is in one run alone; only a mass far from the declared one is a body.
- An arm on a wall or a ceiling, or a tracker whose vertical is y, has gravity where the robot file has none. The robot
  is fitted again with gravity along each axis of the base, and from the best of them freely (Gauss-Newton over
  directions). Whether torques exclude gravity, as with a driver that compensates it,
  :mod:`gtau.estimation.diagnostics.effort` finds.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from math import asin, atan2, hypot

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.effort import WITHOUT_GRAVITY
from gtau.estimation.diagnostics.refits import described_otherwise, refitted, residual_ratio, unrefined
from gtau.estimation.effects.effect import EstimatedEffect
from gtau.estimation.effects.gravity import GRAVITY, gravity_changes
from gtau.estimation.effects.linearisation import linearise, on_channels
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.least_squares import fit_by
from gtau.estimation.estimators.maximum_likelihood import ml_or_wls
from gtau.estimation.estimators.newton import degrees_of_freedom
from gtau.estimation.regression.run_blocks import PreparedRuns
from gtau.findings import Finding
from gtau.findings.words import to_width
from gtau.model.base_parameters import base_parameters
from gtau.progress import Progress, silent
from gtau.robots.parameter import Parameter, payload_label
from gtau.signals.reading.statements import Payload

REFUTED_STD = 6.0  # size of a description alternative in standard deviations
REFUTED_SHARE = 0.05  # share of the residual variance that a description alternative explains
GRAVITY_SHARE = 0.5  # share of the residual variance that gravity along another axis takes away
GRAVITY_LEAST = 5.0  # angle from the stated gravity, degrees, below which the linear test of a tilt speaks
GRAVITY_ALIKE = 1.05  # residual variance over that of the best axis, below which another one explains as much
LOAD_LEFT = 0.5  # part of the residual variance that is left with another load of a run, or payloads on another body
MASS_ABSENT = 0.5  # part of a declared mass by which a run's load differs: below, the mass is wrong, above, the body
LOAD_ALIKE = 1.01  # residual variance with another load of one run over the least of all runs: below, as likely

TOOL_BODIES, TOOL_BODY, PAYLOAD_BODY = "tool bodies", "body at the tool", "payload on another body"
OTHER_GRAVITY = "gravity"


def other_body(fit: Fit) -> EstimatedEffect | None:
    """Find the body on which payloads explain the residuals, if it is another one than the tool."""
    unaltered, model = unrefined(fit), fit.dataset.model
    robot, best, remains = model.robot, unaltered, float(LOAD_LEFT)
    for body in robot.bodies:
        if body != robot.tool and Parameter("m", body) in model.parameter_names and fit.system.payloads:
            other = refitted(fit, dataset=replace(fit.dataset, model=model.altered(named_tool=body)))
            if other is not None and (ratio := residual_ratio(other, unaltered)) < remains:
                best, remains = other, ratio
    if best is unaltered:
        return None
    body = best.dataset.model.robot.tool
    cause = Finding(
        PAYLOAD_BODY,
        subject=body,
        values={"remains": remains},
        text=f"the payload on '{body}' in place of '{robot.tool}'",
        advice=f"check which body carries the payload; write 'tool: {body}' in the robot file (gtau robot --save makes "
        "one of any robot)",
    )
    return described_otherwise(unaltered, TOOL_BODIES, cause, best, unaltered)


def other_loads(fit: Fit) -> EstimatedEffect | None:
    """Find the runs whose bodies at the tool are other than declared, with their masses; None without any."""
    unaltered = unrefined(fit)
    runs, carried, remaining = range(len(fit.dataset.runs)), tuple[int, ...](), 1.0
    best: Fit | None = None
    while best is None or len(carried) < len(runs) - 1:
        wider = [(*carried, run) for run in runs if run not in carried]
        tried = {runs: other for runs in wider if (other := _loaded(fit, runs)) is not None}
        ratios = {runs: residual_ratio(other, unaltered) for runs, other in tried.items()}
        least = min(ratios.values(), default=1.0)
        if least > LOAD_LEFT * remaining:
            break
        # a body in some runs is one that the others lack: more is forgotten than taken away
        alike = [runs for runs, ratio in ratios.items() if ratio < LOAD_ALIKE * least]
        carried = max(alike, key=lambda runs: _added(tried[runs], runs)[-1])
        best, remaining = tried[carried], ratios[carried]
    if best is None:
        return None
    masses, std = _added(best, carried), np.sqrt(np.diag(best.solution.jackknife))[_places(best, carried)]
    declared = [_declared(fit, run) for run in carried]
    if np.any(np.abs(masses) < np.maximum(REFUTED_STD * std, MASS_ABSENT * np.array(declared))):
        return None
    return _of_bodies(best, unaltered, carried, masses, std)


def _loaded(fit: Fit, runs: tuple[int, ...]) -> Fit | None:
    """Fit with unknown loads in ``runs``; None where a mass is then not identifiable."""
    declared = [run.payload for run in fit.dataset.runs]
    loads = [Payload(name=f"of run {k}") if k in runs else payload for k, payload in enumerate(declared)]
    other = refitted(fit, loads)
    if other is None or not set(_masses(fit, runs)) <= set(other.system.problem.parameters):
        return None
    return other if set(other.system.unexcited) <= set(fit.system.unexcited) else None


def _masses(fit: Fit, runs: Iterable[int]) -> list[Parameter]:
    return [Parameter("m", payload_label(fit.dataset.robot, run)) for run in runs]


def _places(other: Fit, runs: Sequence[int]) -> list[int]:
    """Numbers of the masses of unknown loads among the parameters."""
    return other.system.problem.unknowns.at(_masses(other, runs))


def _added(other: Fit, runs: Sequence[int]) -> np.ndarray:
    """Compute the masses (runs,) of unknown loads beyond what is declared, kg."""
    return np.asarray(other.solution.theta[_places(other, runs)] - [_declared(other, run) for run in runs])


def _declared(fit: Fit, run: int) -> float:
    """Return the declared mass of a run's payload, kg; 0 without one."""
    payload = fit.dataset.runs[run].payload
    return 0.0 if payload is None else payload.mass or 0.0


def _of_bodies(
    other: Fit, unaltered: Fit, carried: Sequence[int], masses: np.ndarray, std: np.ndarray
) -> EstimatedEffect:
    from scipy.special import stdtrit

    freedom = degrees_of_freedom(other.system.problem, other.solution, unaltered.free_gains)
    halves = std * stdtrit(freedom[_places(other, carried)], 0.975)
    bodies = []
    for number, more, half in zip(carried, masses.tolist(), halves.tolist(), strict=True):
        run = unaltered.dataset.runs[number]
        declared = "" if run.payload is None or run.payload.mass is None else run.payload.name
        bodies.append({"run": run.name, "more": more, "half": half, "declared": declared})
    helped = (other.solution.sigma / unaltered.solution.sigma) ** 2 < LOAD_LEFT
    joints = tuple(joint for joint, less in zip(unaltered.system.problem.joints, helped, strict=False) if less)
    cause = Finding(
        TOOL_BODY,
        joints,
        values={"bodies": bodies, "remains": residual_ratio(other, unaltered)},
        text=" and ".join(_of_body(**body) for body in bodies),
        advice="check which runs carry the payload and its mass, and declare the load of every run ('payload: {name: "
        "..., mass: ...}' beside its 'log')",
    )
    return described_otherwise(unaltered, TOOL_BODIES, cause, other, unaltered)


def _of_body(run: str, more: float, half: float, declared: str) -> str:
    """Describe the body at the tool in a run, by its mass beyond what is ``declared``."""
    low, mass, high = (to_width(abs(more) + side * half, half) for side in (-1, 0, 1))
    sized = f"{mass} kg (95 % interval {low} to {high} kg)"
    if declared:
        return f"{sized} {'more' if more > 0 else 'less'} at the tool in run '{run}' than payload '{declared}'"
    if more < 0:
        return f"{sized} less at the tool in run '{run}' than in the others"
    return f"an undeclared body of {sized} at the tool in run '{run}'"


STEPS = 4  # of Gauss-Newton, from an axis at most 55 degrees off


def likeliest_gravity(fit: Fit, missing: bool, turned: bool, progress: Progress = silent) -> EstimatedEffect | None:
    """Fit without gravity where that may be ``missing``, and with another one where it may be ``turned``.

    Of both that with less residual variance is chosen; if similar, only logged torques lack it. Raises GtauError where
    the data do not determine the gains.
    """
    windows = [window for _, window in fit.dataset.windows()]  # the middle of the runs bounds the time
    if not windows:
        return None
    middle = replace(fit.dataset, prepared=PreparedRuns(windows))  # type: ignore[arg-type]  # used as prepared runs
    unaltered = _with_gravity(
        replace(fit, system=replace(fit.system, dataset=middle)), np.array(fit.dataset.robot.gravity)
    )
    without = _without_gravity(fit, unaltered) if missing else None
    other = _other_gravity(fit, unaltered, progress) if turned else None
    if without is None or other is None:
        return without or other
    alike = 1 / GRAVITY_ALIKE if fit.dataset.runs[0].kind == "torque" else GRAVITY_ALIKE
    remaining, of_none = (effect.cause.values["remains"] for effect in (other, without))
    return other if remaining < alike * of_none else without


def _with_gravity(fit: Fit, gravity: np.ndarray) -> Fit:
    """Fit with another gravity; raises GtauError where the data do not determine the gains with it."""
    dataset = fit.dataset
    model, base = dataset.model, dataset.base
    if not np.array_equal(gravity, dataset.robot.gravity):
        model = model.altered(gravity=tuple(gravity.tolist()))
        base = base_parameters(model, sensors=dataset.runs[0].sensors)
    gains = None if fit.free_gains else fit.gains
    terms = tuple(term for term in fit.system.terms if term.kind != "fl")
    other = replace(dataset, model=model, base=base, factors=()).reduced()
    return fit_by(ml_or_wls(gains), fit.system.again(other, terms), fit.free_gains)


def _without_gravity(fit: Fit, unaltered: Fit) -> EstimatedEffect | None:
    """Fit without gravity, for what that explains of each joint and how it moves the gains.

    None where it explains less than with it: a joint alone may fit as well without, as other columns of its own stand
    for its gravity.
    """
    other, n = _with_gravity(unaltered, np.zeros(3)), len(unaltered.gains)
    if residual_ratio(other, unaltered) > 1 - REFUTED_SHARE:
        return None
    ratio = (other.solution.sigma / unaltered.solution.sigma)[:n]
    most = max(np.sqrt(residual_ratio(other, unaltered)), ratio.min())
    return _of_gravity(fit, unaltered, other, most)


def _other_gravity(fit: Fit, unaltered: Fit, progress: Progress) -> EstimatedEffect | None:
    """Find the gravity of the same strength, along an axis or free, that explains most of the residuals, if any does.

    Nothing is found where gravity is not seen, nor within the few degrees of which the linear test speaks.
    """
    declared = np.array(unaltered.dataset.robot.gravity)
    size = float(np.linalg.norm(declared))
    if not size:
        return None
    tried = []
    for k, axis in enumerate(np.vstack([np.eye(3), -np.eye(3)])):
        progress("gravity along other axes", k, 6)
        try:
            other = unaltered if _degrees(axis, declared) < GRAVITY_LEAST else _with_gravity(unaltered, size * axis)
        except GtauError:
            continue  # with it, the data do not determine the gains
        tried.append((residual_ratio(other, unaltered), other))
    progress("gravity along other axes", 6, 6)
    remaining, best = min([(1.0, unaltered), *tried], key=lambda other: other[0])
    alike = [other for rest, other in tried if rest <= GRAVITY_ALIKE * remaining]
    for better in _freely(best):
        if residual_ratio(better, unaltered) < (1 - REFUTED_SHARE) * remaining:
            remaining, best, alike = residual_ratio(better, unaltered), better, []
    gravity = np.array(best.dataset.robot.gravity)
    if 1 - remaining < GRAVITY_SHARE or _degrees(gravity, declared) < GRAVITY_LEAST:
        return None
    also = [list(other.dataset.robot.gravity) for other in alike if other is not best]
    return _of_gravity(fit, unaltered, best, np.sqrt(1 - GRAVITY_SHARE), also)


def _of_gravity(
    fit: Fit, unaltered: Fit, other: Fit, most: float, also: Sequence[Sequence[float]] = ()
) -> EstimatedEffect:
    """Describe a fit with another gravity, on the joints of whose residuals it leaves at ``most`` this ratio."""
    joints, before = unaltered.system.problem.joints, unaltered.solution.sigma
    shares, ratio = before / unaltered.system.problem.balance(unaltered.solution.theta), other.solution.sigma / before
    helped = [j for j in range(len(joints)) if ratio[j] <= most]
    left = {joints[j]: [float(shares[j]), float(shares[j] * ratio[j])] for j in helped}
    gravity, floating = list(other.dataset.robot.gravity), bool(unaltered.dataset.robot.floating)
    values = {"gravity": gravity, "also": also, "left": left, "remains": residual_ratio(other, unaltered)}
    if any(gravity):
        directions = " or ".join(map(_direction, [gravity, *also]))
        kind, text = OTHER_GRAVITY, f"gravity along {directions} of the {'world' if floating else 'base'}"
        advice = gravity_advice(gravity, floating)
    else:
        kind, text = WITHOUT_GRAVITY, "torques without gravity, as from a driver that compensates it"
        advice = (
            "log the torques of the motors (UR: 'use_currents_as_efforts: true'), or write 'robot: {file: ..., "
            "gravity: [0, 0, 0]}' in the experiment file for a model without gravity"
        )
    if left:
        joint, (as_declared, rest) = max(left.items(), key=lambda of: of[1][0])
        text += f", which leaves {100 * rest:.2g} % of '{joint}' unexplained instead of {100 * as_declared:.2g} %,"
    return described_otherwise(
        fit, GRAVITY.name, Finding(kind, tuple(left), values=values, text=text, advice=advice), other, unaltered
    )


def gravity_advice(gravity: Sequence[float], floating: bool) -> str:
    """Advise what to write in the robot file, or beside its name, for a robot with this gravity."""
    how = "how the world axes lie" if floating else "how the base is mounted"
    written = ", ".join(f"{round(component, 3) + 0.0:.4g}" for component in gravity)
    x, y, z = gravity
    roll = atan2(-y, -z) if round(hypot(y, z), 3) else 0.0
    rpy = f"{roll:.4g}, {asin(x / hypot(x, y, z)) + 0.0:.4g}, 0"
    turned = (
        "in axes of the logged poses, or turn the poses so that their z axis points up"
        if floating
        else f"or 'base: {{rpy: [{rpy}]}}' beside its 'file' in the experiment file"
    )
    return f"check {how}, and write 'gravity: [{written}]' in the robot file, {turned}"


def _direction(gravity: Sequence[float]) -> str:
    """Name an axis, or write a direction of unit length."""
    size = hypot(*gravity)
    unit = [round(component / size, 2) + 0.0 for component in gravity]
    along = [k for k in range(3) if unit[k]]
    if len(along) == 1:
        return f"{'-' if unit[along[0]] < 0 else '+'}{'xyz'[along[0]]}"
    return "({:.2g}, {:.2g}, {:.2g})".format(*unit)


def _freely(at: Fit) -> Iterator[Fit]:
    """Rotate gravity to the direction that the residuals favour."""
    windows = list(enumerate(at.dataset.prepared))
    for _ in range(STEPS):
        gravity = np.array(at.dataset.robot.gravity)
        if not gravity.any():
            return
        linear = linearise(at, windows, on_channels(GRAVITY.torques, GRAVITY.shared))  # type: ignore[arg-type]
        size = float(np.linalg.norm(gravity))
        turned = gravity + linear.fitted(slice(2))[0][-2:] @ gravity_changes(gravity)[:2]
        if not np.isfinite(turned).all() or np.allclose(turned, gravity, rtol=0, atol=1e-4 * size):
            return
        try:
            at = _with_gravity(at, size * turned / np.linalg.norm(turned))
        except GtauError:
            return
        yield at


def _degrees(one: np.ndarray, other: np.ndarray) -> float:
    cosine = one @ other / (np.linalg.norm(one) * np.linalg.norm(other))
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
