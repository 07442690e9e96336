"""Motions for the next round, compared by simulating and identifying them, and motions played before."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gtau.campaigns.folder import Round
from gtau.campaigns.rehearsal import CSV
from gtau.errors import GtauError
from gtau.estimation.diagnostics.diagnose import Examination, estimates_of
from gtau.estimation.effects.estimate import effects_beside
from gtau.estimation.electrical import with_voltages
from gtau.estimation.estimators import estimator_of
from gtau.estimation.estimators.essential import select_friction
from gtau.estimation.regression.dataset import reduce_runs
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.result import IdentifiedModel
from gtau.excitation.design import Design, check, redesign
from gtau.excitation.design_file import DesignFile, make_task
from gtau.excitation.forecast import sampled_run
from gtau.excitation.prior import DesignPrior
from gtau.excitation.task import DesignProblem, along
from gtau.findings import Progress, silent
from gtau.model.program import single_threaded_blas
from gtau.robots.parameter import Parameter
from gtau.robots.robot import INERTIAL
from gtau.signals.reading.logs import read_log
from gtau.signals.reading.statements import FIRST_MOMENTS, Drive, Payload
from gtau.signals.run import Run
from gtau.uses.prediction import torques

SPEEDS = (0.7, 0.5)  # of the designed speed; of 23 best candidates 14 were longer and six slower
HEAVIER = 2.0  # mass of a payload that is not at hand over the mass of the heaviest payload
BESIDE = 0.08  # m from the axis of the last joint to the centre of a payload mounted beside it


@dataclass(frozen=True)
class Candidate:
    """A motion to play next; with ``at_hand`` False, its payload or mount must be obtained first.

    ``beside`` (3,) is the displacement of all payloads, m in the frame of the body that carries them.
    """

    label: str
    design: Design
    at_hand: bool = True
    beside: tuple[float, ...] = (0.0, 0.0, 0.0)


def candidates(design: Design) -> Iterator[Candidate]:
    """Vary the speed, length and payload of a design within the limits."""
    task, x = design.task, design.x
    yield Candidate("as designed", design)
    for part in SPEEDS:
        slower = replace(task.series, base_frequency=part * task.series.base_frequency)
        yield from _within(f"at {100 * part:g} % of the speed", design, replace(task, series=slower), x)
    yield from _within("twice as long", design, replace(task, repetitions=2 * task.repetitions), x)
    masses = [payload.mass for payload in task.payloads if payload is not None and payload.mass]
    if masses:
        heavier = task.with_payload_mass(HEAVIER * max(masses))
        yield from _within(f"with a payload of {HEAVIER * max(masses):g} kg", design, heavier, x, at_hand=False)


def beside_the_axis(design: Design, result: IdentifiedModel) -> Iterator[Candidate]:
    """Mount the payload beside the axis of the last joint if it is near and the gain there is the widest."""
    robot, wide = result.robot, widths(result)
    worst, last = max(wide, key=lambda joint: wide[joint]), robot.tool
    driven = worst == last or any({worst, last} <= coupling.terms.keys() for coupling in robot.couplings)
    turns = any(joint.name == last and joint.turns for joint in robot.joints)
    loads = [load for load in design.task.payloads if load is not None]
    heaviest = max(loads, key=lambda load: load.mass or 0.0, default=None)
    if not driven or not turns or heaviest is None or not heaviest.mass:
        return
    moments, axis = result.payload_values.get(heaviest.name, {}), np.array(robot.joint(last).axis)
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
    """Yield a candidate if it is within all limits."""
    try:
        usages = check(task, x)
    except GtauError:  # not reachable
        return
    if all(usage.excess <= 1 for usage in usages):
        yield Candidate(label, replace(design, task=task, x=x, constraint_usages=usages), at_hand)


def widths(result: IdentifiedModel) -> dict[str, float]:
    """Half-widths of the 95 % intervals of all gains, per cent; infinite if not identifiable."""
    halves = {joint: gain.half_width for joint, gain in result.drive_gains.items()}
    return {joint: np.inf if half is None else half for joint, half in halves.items()}


def expected_width(candidate: Candidate, result: IdentifiedModel, drives: Mapping[str, Drive]) -> float:
    """Predict the widest half-interval of a gain, per cent, once the candidate is played as well; infinite if it fails.

    Logs are simulated without noise, as draws of it differ by more than candidates do: an Orthoglide was to reach 3.7
    and 5.0 %, and reached 1.4 %. Predictions are now 0.4 to 1.1 of what seven rounds of five-bars and Orthoglides led
    to, mostly 0.7. ``drives`` are of the design file.
    """
    estimator = estimator_of("ml")
    try:
        runs = [*result.data, *_simulated(candidate, result)]
        with single_threaded_blas():
            dataset = reduce_runs(result.robot, runs, result.preparation, model=result.idm)
            dataset = with_voltages(dataset, drives)  # of the logs alone, as no motion adds to what limits them
            fit = estimator.fit(select_friction(dataset, estimator.solver(None), silent), None, silent)
            estimates = estimates_of(fit, Examination(mixed=effects_beside(fit)), correlated=True, moved=True)
    except GtauError:
        return np.inf
    gains = estimates.select([Parameter("gain", joint) for joint in result.drive_gains])
    stds, freedom = np.sqrt(np.diag(gains.covariance)), gains.effective_freedom
    return max(
        Estimate("", value, std, "", freedom=None if freedom is None else freedom[k]).half_width or np.inf
        for k, (value, std) in enumerate(zip(gains.values, stds, strict=True))
    )


def _simulated(candidate: Candidate, result: IdentifiedModel) -> Iterator[Run]:
    """Simulate logs of a candidate with the identified model, friction and delays included."""
    design = candidate.design
    time, joints = sampled_run(design.task, design.x)
    q, qd, qdd = (rows.T for rows in joints[:3])
    for k, payload in enumerate(design.task.payloads):
        carried = _carried(payload, result)
        if payload is not None and carried is not None and any(candidate.beside):
            moments, mass = carried.parameters, carried.mass or 0.0
            moved = {k: moments.get(k, 0.0) + mass * d for k, d in zip(FIRST_MOMENTS, candidate.beside, strict=True)}
            carried = carried.model_copy(update={"parameters": moments | moved})
            unknown = {kind: value for kind, value in payload.parameters.items() if kind not in FIRST_MOMENTS}
            payload = payload.model_copy(update={"parameters": unknown})
        current = torques(result, q, qd, qdd, carried) / result.gains
        led = zip(current.T, result.delays.values(), strict=True)
        current = np.column_stack([np.interp(time + (delay.value or 0.0), time, column) for column, delay in led])
        yield Run(f"candidate{k + 1}", result.robot.actuated, time, q, current, payload=payload)


def _carried(payload: Payload | None, result: IdentifiedModel) -> Payload | None:
    """Give a payload its identified centre, scaled to its mass."""
    if payload is None or payload.mass is None:
        return payload
    known = result.payload_values.get(payload.name, {})
    scale = payload.mass / known["m"] if known.get("m") else 1.0
    moments = {kind: known[kind] * scale for kind in FIRST_MOMENTS if kind in known}
    return payload.model_copy(update={"parameters": moments | payload.parameters})


def next_task(file: DesignFile, result: IdentifiedModel, model: Path) -> DesignProblem:
    """Make the task of the next motion with the result as prior, or with the file's prior if a gain is not trusted."""
    try:
        task, _ = make_task(file.model_copy(update={"prior": DesignPrior(model=model)}))
    except GtauError:  # a gain that may be zero, or is not identifiable
        return make_task(file)[0]
    return replace(task, prior=replace(task.prior, covariance=_shared(result)))


def _shared(result: IdentifiedModel) -> tuple[tuple[Parameter, ...], np.ndarray]:
    """Compute the covariance of the parameters shared with later rounds, with only the random part of the gains."""
    names, kept, part = result.covariance_names, list[int](), list[float]()
    for k, name in enumerate(names):
        gain = result.drive_gains.get(name.body) if name.kind == "gain" else None
        # the mount of a payload may change between rounds, and friction drifts
        if name.kind == "gain" or (name.kind in INERTIAL and name.body in result.robot.bodies):
            kept.append(k)
            part.append(gain.random_std / gain.std if gain and gain.std and gain.random_std else 1.0)
    return tuple(names[k] for k in kept), result.covariance[np.ix_(kept, kept)] * np.outer(part, part)


def played_again(task: DesignProblem, used: list[Round], refusal: GtauError, progress: Progress) -> tuple[Design, str]:
    """Improve a motion that was played, after the search from random motions failed; raise its ``refusal`` otherwise.

    The drives can repeat the torques of that motion, so they count as within the limits whatever is identified. Gains
    count with their values, not with the worst ends of their intervals.
    """
    known = tuple(replace(gain, interval=(gain.value, gain.value)) for gain in task.prior.known)
    task = replace(task, prior=replace(task.prior, known=known))
    for round_ in reversed(used):
        x = np.array(round_.motion.get("series", {}).get("x", ()))
        if round_.played is None or x.size != task.series.size:
            continue
        series = round_.motion["series"]
        speed = round_.played.speed  # at which it was played
        columns = [f"{kind}_{joint}" for kind in ("q", "qd", "qdd") for joint in task.model.actuated]
        log = read_log(round_.folder / CSV, ("t", *columns)).arrays()
        q, qd, qdd = np.array([log[name] for name in columns]).reshape(3, -1, len(log["t"]))
        joints = np.stack([q, speed * qd, speed**2 * qdd, 0 * q])
        played = along(task, joints, (log["t"][1] - log["t"][0]) / speed)
        torques = [np.abs(played.W @ load).max(axis=1) for load in task.information.cautious]
        torque = np.maximum(task.limits.torque, (1 + 1e-3) * np.max(torques, axis=0))
        slowed = replace(task.series, base_frequency=speed / series["period"])
        limits = replace(task.limits, torque=torque)
        again = replace(task, series=slowed, repetitions=series["repetitions"], limits=limits)
        if improved := redesign(again, x, progress):
            return improved, f"the next motion repeats round {round_.folder.name} with other parts, because {refusal}"
    raise refusal
