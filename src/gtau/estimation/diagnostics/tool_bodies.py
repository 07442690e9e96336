"""Fit the data with other bodies at the tool than declared, or with the payload on another body.

Parameters adapt to a wrong description, so that torques computed with them do not have the shape of the residuals, and
a linear test points anywhere: the robot is fitted again. A body at the tool adds its ten inertial columns in its run
(eq. 18), so the data are fitted again with the load of one run unknown, then of a second one, as long as that explains
much more. An unknown load explains part of any fault that is in one run alone; only a mass far from the declared one is
a body.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from gtau.estimation.diagnostics.refits import described_otherwise, refitted, residual_ratio, unrefined
from gtau.estimation.effects.effect import EstimatedEffect
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.newton import degrees_of_freedom
from gtau.findings import Finding
from gtau.findings.words import to_width
from gtau.robots.parameter import Parameter, payload_label
from gtau.signals.reading.statements import Payload

REFUTED_STD = 6.0  # size of another description in standard deviations
LOAD_LEFT = 0.5  # part of the residual variance that is left with another load of a run, or payloads on another body
MASS_ABSENT = 0.5  # part of a declared mass by which a run's load differs: below, the mass is wrong, above, the body
LOAD_ALIKE = 1.01  # residual variance with another load of one run over the least of all runs: below, as likely

TOOL_BODIES, TOOL_BODY, PAYLOAD_BODY = "tool bodies", "body at the tool", "payload on another body"


def other_body(fit: Fit) -> EstimatedEffect | None:
    """Find the body on which payloads explain the residuals, if it is another one than the tool."""
    unaltered, model = unrefined(fit), fit.dataset.model
    robot, best, remains = model.robot, unaltered, float(LOAD_LEFT)
    for body in robot.bodies:
        if body != robot.tool and Parameter("m", body) in model.parameter_names and fit.system.payloads:
            equations = replace(fit.dataset.equations, model=model.altered(named_tool=body), known=fit.dataset.base)
            other = refitted(fit, dataset=replace(fit.dataset, equations=equations))
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
    return _described(best, unaltered, carried, masses, std)


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


def _described(
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
    text = " and ".join(_at_the_tool(**body) for body in bodies)
    advice = (
        "check which runs carry the payload and its mass, and declare the load of every run ('payload: {name: ..., "
        "mass: ...}' beside its 'log')"
    )
    values = {"bodies": bodies, "remains": residual_ratio(other, unaltered)}
    cause = Finding(TOOL_BODY, joints, values=values, text=text, advice=advice)
    return described_otherwise(unaltered, TOOL_BODIES, cause, other, unaltered)


def _at_the_tool(run: str, more: float, half: float, declared: str) -> str:
    """Describe the body at the tool in a run, by its mass beyond what is ``declared``."""
    low, mass, high = (to_width(abs(more) + side * half, half) for side in (-1, 0, 1))
    sized = f"{mass} kg (95 % interval {low} to {high} kg)"
    if declared:
        return f"{sized} {'more' if more > 0 else 'less'} at the tool in run '{run}' than payload '{declared}'"
    if more < 0:
        return f"{sized} less at the tool in run '{run}' than in the others"
    return f"an undeclared body of {sized} at the tool in run '{run}'"
