"""Motions for the next round, each rehearsed whole: simulated with the identified model, then identified."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.examine import Examination, estimates_of
from gtau.estimation.effects.estimate import estimate_effects
from gtau.estimation.estimators.essential import select_friction
from gtau.estimation.estimators.registry import estimator_of
from gtau.estimation.regression.dataset import reduce_runs
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.result import Result
from gtau.excitation.design import Design, check
from gtau.excitation.forecast import Outlook
from gtau.excitation.task import DesignProblem
from gtau.model.interpreter.program import single_threaded_blas
from gtau.progress import silent
from gtau.robots.parameter import Parameter
from gtau.signals.reading.statements import FIRST_MOMENTS, Payload
from gtau.signals.run import Run
from gtau.uses.prediction import torques

# of 23 choices between eight motions of five-bars and Orthoglides fourteen were of the longer and six of a slower one,
# none of one with 70 or 50 % of the amplitude or with the other load first, which are not tried any more
SPEEDS = (0.7, 0.5)
HEAVIER = 2.0  # times the mass, of a payload that is not at hand
BESIDE = 0.08  # m from the axis of the last joint to the centre of a payload that is mounted beside it


@dataclass(frozen=True)
class Candidate:
    """A motion that could be played next, or with ``at_hand`` False a payload that would have to be found first.

    ``beside`` (3,) is by how much payloads are mounted further off, m in the frame of the body that carries them.
    """

    label: str
    design: Design
    at_hand: bool = True
    beside: tuple[float, ...] = (0.0, 0.0, 0.0)


def candidates(design: Design) -> Iterator[Candidate]:
    """Vary speed, length and payload of a design, within the limits."""
    task, x = design.task, design.x
    yield Candidate("as designed", design)
    for part in SPEEDS:
        slower = replace(task.series, base_frequency=part * task.series.base_frequency)
        yield from _within(f"at {100 * part:g} % of the speed", design, replace(task, series=slower), x)
    yield from _within("twice as long", design, replace(task, repetitions=2 * task.repetitions), x)
    masses = [payload.mass for payload in task.payloads if payload is not None and payload.mass]
    heavier = task.with_payload_mass(HEAVIER * max(masses))
    yield from _within(f"with a payload of {HEAVIER * max(masses):g} kg", design, heavier, x, at_hand=False)


def beside_the_axis(design: Design, result: Result) -> Iterator[Candidate]:
    """Mount the payload beside the axis of the last joint, where it is near and the gain there is the least known."""
    robot, wide = result.robot, widths(result)
    worst, last = max(wide, key=lambda joint: wide[joint]), robot.tool
    driven = worst == last or any({worst, last} <= coupling.terms.keys() for coupling in robot.couplings)
    heaviest = max((load for load in design.task.payloads if load is not None), key=lambda load: load.mass or 0.0)
    if (
        not driven
        or last not in {joint.name for joint in robot.joints}
        or not robot.joint(last).turns
        or not heaviest.mass
    ):
        return
    moments, axis = result.payload(heaviest.name), np.array(robot.joint(last).axis)
    center = np.array([moments.get(kind, 0.0) for kind in FIRST_MOMENTS]) / heaviest.mass
    off = float(np.linalg.norm(center - (center @ axis) * axis))
    if off < BESIDE:
        way = center if off > 1e-3 else np.eye(3)[np.argmin(np.abs(axis))]
        way = way - (way @ axis) * axis
        beside = (BESIDE - off) * way / np.linalg.norm(way)
        label = f"with the payload's centre {BESIDE:g} m from the axis of '{last}', not {off:.2g} m,"
        yield Candidate(label, design, False, tuple(beside.tolist()))


def _within(
    label: str, design: Design, task: DesignProblem, x: np.ndarray, at_hand: bool = True
) -> Iterator[Candidate]:
    """Make a candidate if it is within all limits."""
    try:
        usages = check(task, x)
    except GtauError:  # not reachable
        return
    if all(usage.excess <= 1 for usage in usages):
        yield Candidate(label, replace(design, task=task, x=x, constraint_usages=usages), at_hand)


def widths(result: Result) -> dict[str, float]:
    """Half the 95 % interval of each gain, per cent, infinite where it is not identifiable."""
    return {
        joint: np.inf if gain.half_width is None or gain.value is None else gain.half_width
        for joint, gain in result.drive_gains.items()
    }


def expected_width(candidate: Candidate | None, result: Result, seed: int) -> float:
    """Expect half the widest interval of a gain, per cent, after a candidate too; infinite where none is found.

    The noise is the same for all candidates.
    """
    estimator = estimator_of("ml")
    try:
        runs = () if candidate is None else _simulated(candidate, result, seed)
        with single_threaded_blas():
            dataset = reduce_runs(result.robot, [*result.data, *runs])
            fit = estimator.fit(select_friction(dataset, estimator.solver(None), silent), None, silent)
            estimates = estimates_of(fit, Examination(mixed=estimate_effects(fit)), correlated=True, moved=True)
    except GtauError:
        return np.inf
    gains = estimates.select([Parameter("gain", joint) for joint in result.drive_gains])
    stds, freedom = np.sqrt(np.diag(gains.covariance)), gains.effective_freedom
    return max(
        Estimate("", value, std, "", freedom=None if freedom is None else freedom[k]).half_width or np.inf
        for k, (value, std) in enumerate(zip(gains.values, stds, strict=True))
    )


def _simulated(candidate: Candidate, result: Result, seed: int) -> Iterator[Run]:
    """Make logs of a candidate as the identified robot with its friction would, with the same white noise for all."""
    design = candidate.design
    ((time, joints),) = Outlook(design, {}).motions
    q, qd, qdd = (rows.T for rows in joints[:3])
    for k, payload in enumerate(design.task.payloads):
        carried = _carried(payload, result)
        if payload is not None and carried is not None and any(candidate.beside):
            moments = carried.parameters
            moved = np.array([moments.get(kind, 0.0) for kind in FIRST_MOMENTS])
            moved += (carried.mass or 0.0) * np.array(candidate.beside)
            of_mount = dict(zip(FIRST_MOMENTS, moved.tolist(), strict=True))
            carried = carried.model_copy(update={"parameters": moments | of_mount})
            unknown = {kind: value for kind, value in payload.parameters.items() if kind not in FIRST_MOMENTS}
            payload = payload.model_copy(update={"parameters": unknown})
        current = torques(result, q, qd, qdd, carried) / result.gains
        noise = np.random.default_rng([seed, k]).standard_normal(current.shape)
        current = current + design.task.prior.sigma * noise
        yield Run(f"candidate{k + 1}", result.robot.actuated, time, q, current, payload=payload)


def _carried(payload: Payload | None, result: Result) -> Payload | None:
    """Give a payload the centre that was identified, at its mass."""
    if payload is None or payload.mass is None:
        return payload
    known = result.payload(payload.name)
    scale = payload.mass / known["m"] if known.get("m") else 1.0
    moments = {kind: known[kind] * scale for kind in FIRST_MOMENTS if kind in known}
    return payload.model_copy(update={"parameters": moments | payload.parameters})


def best(
    offered: Sequence[Candidate], width_of: Callable[[Candidate], float]
) -> tuple[Candidate, list[dict[str, float | str | bool | None]]]:
    """Find the candidate at hand with the narrowest interval, and list all."""
    halfwidths = [(candidate, width_of(candidate)) for candidate in offered]
    chosen, _ = min((pair for pair in halfwidths if pair[0].at_hand), key=lambda pair: pair[1])
    listed: list[dict[str, float | str | bool | None]] = [
        {"motion": candidate.label, "half_width": width if np.isfinite(width) else None, "at_hand": candidate.at_hand}
        for candidate, width in halfwidths
    ]
    return chosen, listed
