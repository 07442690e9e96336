"""Fit the same rows under other descriptions of robot and logs, and compare them with the user's by their likelihood.

Parameters adapt to a wrong description, so that torques computed with them do not have the shape of the residuals, and
a linear test points anywhere: the robot is fitted again.

- With a body at the tool in some runs: its ten inertial columns (eq. 18) are unknown in the run where that explains
  most, then in a second one, as long as it explains much more. An unknown load explains part of any fault of one run
  alone; only a mass far from the declared one is a body.
- With payloads on another body, or in another run.
- Without one of the runs: where the others agree, they predict its currents, which may have another sign or unit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.verdict import contradiction, motors, unexplained_shares
from gtau.estimation.effects.effect import EstimatedEffect
from gtau.estimation.effects.estimate import contradictions, effects_beside
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.maximum_likelihood import ml_or_wls
from gtau.estimation.estimators.newton import degrees_of_freedom
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.factors import KNOWN, SIGNAL
from gtau.estimation.regression.priors import require_scale
from gtau.estimation.regression.run_blocks import PreparedRuns
from gtau.findings import Finding, listed, to_width
from gtau.robots.parameter import BY_LOAD, Parameter, payload_label
from gtau.signals.preparation.prepared_run import SampleWindow
from gtau.signals.reading.statements import Payload

MISFIT_GIVEN = 0.5  # share of a joint's torque that is unexplained, gains given
LEFT = 0.5  # part of the residual variance, geometric mean of all joints, that is left with another description
BESIDE_LEFT = 0.9  # the same, with all effects beside both descriptions
ODD_TRIED = 0.1  # share of a joint's signal that is unexplained, from which runs are left out, or loads exchanged
MENDED = 0.1  # part of the squares that is left, at most, where one run or load explains what was unexplained
ALIKE = 1.05  # residual variance over the least of all: below, as likely
REFUTED_STD = 6.0  # size of another description in standard deviations
MASS_ABSENT = 0.5  # part of a declared mass by which a run's load differs: below, the mass is wrong, above, the body

TOOL_BODIES, TOOL_BODY, PAYLOAD_BODY = "tool bodies", "body at the tool", "payload on another body"
EXCHANGED_LOADS, ODD_RUN, COLUMNS = "payload of another run", "odd run", "columns"


def refitted(
    fit: Fit, payloads: Sequence[Payload | None] | None = None, dataset: Dataset | None = None, method: str = "ml"
) -> Fit | None:
    """Fit the same equations with other loads, or another dataset's priors.

    None where then nothing gives the scale, or more gains are negative: the mirror image of another description.
    """
    system = fit.system.again(dataset, payloads=payloads)
    payloads = [run.payload for run in fit.dataset.runs] if payloads is None else payloads
    try:
        if fit.free_gains:
            require_scale(fit.dataset.robot, system.problem, system.stated, payloads, method)
        solution = fit.solve(system.problem)
    except GtauError:
        return None
    other = replace(fit, system=system, solution=solution)
    return other if np.sum(other.gains < 0) <= np.sum(fit.gains < 0) else None


def middle_windows(fit: Fit) -> list[SampleWindow]:
    """List the middle of each run, which bounds the time; a run too short for that whole."""
    windows = dict(fit.dataset.windows())
    return [windows.get(k) or run.samples() for k, run in enumerate(fit.dataset.prepared)]


def at_middle(fit: Fit) -> Fit | None:
    """Fit the middle of the runs; None where that does not determine the gains."""
    gains = None if fit.free_gains else fit.gains
    terms = tuple(term for term in fit.system.terms if term.kind not in BY_LOAD)
    plain = replace(fit, system=replace(fit.system, terms=terms), solve=ml_or_wls(gains))
    return refitted(plain, dataset=fit.dataset.reduced(along=middle_windows(fit))) if fit.dataset.windows() else None


def residual_ratio(other: Fit, unaltered: Fit) -> float:
    """Compute the residual variance relative to another fit, the geometric mean over all channels (the likelihood's).

    So a single joint that feels gravity, say, counts among many that do not.
    """
    rows = unaltered.problem.total_rows
    return float(np.exp(2 * rows @ np.log(other.solution.sigma / unaltered.solution.sigma) / rows.sum()))


def explained_joints(fit: Fit, other: Fit) -> tuple[str, ...]:
    """List the joints whose torque only the fit leaves unexplained, not the other one."""
    before, after = map(unexplained_shares, (fit, other))
    joints = zip(fit.problem.joints, before, after, strict=False)
    return tuple(joint for joint, share, less in joints if share > MISFIT_GIVEN >= less)


def noise_beside_effects(fit: Fit, allowed: float = 0.0) -> np.ndarray:
    """Return the standard deviations of what all effects together leave of each channel, (c,); raises GtauError.

    Effects count for nothing where one of them is beyond the range of its columns and explains the ``allowed`` share:
    any share beside the user's description, since its refits are beyond that range.
    """
    result = effects_beside(fit)
    if result is None or any(effect.beyond and effect.share >= allowed for effect in contradictions(result)):
        return fit.solution.sigma
    levels = []
    for noises, parts in zip(result.mixed.model.noise, result.mixed.model.rows, strict=True):
        squares, counts = [noise.std**2 for noise in noises], [max(part.counts[0], 1) for part in parts]
        levels.append(np.sqrt(np.average(squares, weights=counts)))
    return result.rows.fit.solution.sigma * levels


def described_otherwise(
    effect: str, cause: Finding, other: Fit, unaltered: Fit, beside: bool = True
) -> EstimatedEffect | None:
    """Compare a fit with another description to the ``unaltered`` one, with the user's description.

    None if effects ``beside`` the user's description explain nearly as much as they do beside the other.
    """
    rows, ratio = unaltered.problem.total_rows, other.solution.sigma / unaltered.solution.sigma
    noise = noise_beside_effects(other, 1 - BESIDE_LEFT) / noise_beside_effects(unaltered) if beside else ratio
    if np.exp(2 * rows @ np.log(noise) / rows.sum()) > BESIDE_LEFT:
        return None
    likelihood = -float(rows @ np.log(ratio))
    share = min(1 - float(rows @ ratio**2 / rows.sum()), 1.0)
    change = 100 * (other.gains / unaltered.gains - 1) if unaltered.free_gains else np.zeros(len(unaltered.gains))
    moves = dict(zip(unaltered.dataset.model.actuated, change.tolist(), strict=True))
    moves = {joint: moves[joint] for joint in unaltered.dataset.robot.motors}
    values = {"remains": residual_ratio(other, unaltered), "explained": explained_joints(unaltered, other)}
    cause = replace(cause, values={**cause.values, **values})
    return EstimatedEffect(effect, cause, 1.0, 0.0, "", likelihood, share, moves, description=True)


def one_after_the_other(
    unaltered: Fit,
    alter: Callable[[tuple[int, ...]], Fit | None],
    numbers: range,
    most: int,
    left: float,
    preferred: Callable[[Fit, tuple[int, ...]], tuple[float, ...]] = lambda other, chosen: (),
) -> tuple[tuple[int, ...], Fit]:
    """Alter one joint or run more as long as that leaves at most ``left`` of the residuals."""
    chosen, best, remains = tuple[int, ...](), unaltered, 1.0
    while len(chosen) < most:
        tried = {}
        for number in numbers:
            wider = (*chosen, number)
            if number not in chosen and (other := alter(wider)) is not None:
                tried[wider] = residual_ratio(other, unaltered), other
        least = min((ratio for ratio, _ in tried.values()), default=1.0)
        if least > left * remains:
            break
        alike = [wider for wider, (ratio, _) in tried.items() if ratio <= ALIKE * least]
        chosen = max(alike, key=lambda wider: (preferred(tried[wider][1], wider), -tried[wider][0]))
        remains, best = tried[chosen]
    return chosen, best


def other_body(fit: Fit) -> EstimatedEffect | None:
    """Find the body on which payloads explain the residuals, if it is another one than the tool."""
    unaltered, model = fit.unrefined, fit.dataset.model
    robot, best, remains = model.robot, unaltered, LEFT
    for body in robot.bodies:
        if body != robot.tool and Parameter("m", body) in model.parameter_names and fit.system.payloads:
            equations = replace(fit.dataset.equations, model=model.altered(named_tool=body), known=fit.dataset.base)
            other = refitted(fit, dataset=replace(fit.dataset, equations=equations))
            if other is not None and (ratio := residual_ratio(other, unaltered)) < remains:
                best, remains = other, ratio
    if best is unaltered:
        return None
    body = best.dataset.model.robot.tool
    text = f"the payload on '{body}' in place of '{robot.tool}'"
    advice = (
        f"check which body carries the payload; write 'tool: {body}' in the robot file (gtau robot --save makes one of "
        "any robot)"
    )
    cause = Finding(PAYLOAD_BODY, subject=body, text=text, advice=advice)
    return described_otherwise(TOOL_BODIES, cause, best, unaltered)


def other_loads(fit: Fit) -> EstimatedEffect | None:
    """Find the runs whose loads are other than declared; None without any."""
    return _undeclared_bodies(fit) or _exchanged_loads(fit)


def _undeclared_bodies(fit: Fit) -> EstimatedEffect | None:
    """Find the runs whose bodies at the tool are other than declared, with their masses."""
    from scipy.special import stdtrit

    runs, unaltered = fit.dataset.runs, fit.unrefined
    declared = np.array([run.payload.mass or 0.0 if run.payload else 0.0 for run in runs])

    def masses(carried: tuple[int, ...]) -> list[Parameter]:
        return [Parameter("m", payload_label(fit.dataset.robot, run)) for run in carried]

    def loaded(carried: tuple[int, ...]) -> Fit | None:
        loads = [Payload(name=f"of run {k}") if k in carried else run.payload for k, run in enumerate(runs)]
        other = refitted(fit, loads)
        if other is None or not set(masses(carried)) <= set(other.problem.parameters):
            return None
        return other if set(other.system.unexcited) <= set(fit.system.unexcited) else None

    def added(other: Fit, carried: tuple[int, ...]) -> np.ndarray:
        return np.asarray(other.solution.theta[other.problem.unknowns.at(masses(carried))] - declared[list(carried)])

    def deviations(other: Fit, carried: tuple[int, ...]) -> np.ndarray:
        return np.asarray(np.sqrt(np.diag(other.solution.jackknife))[other.problem.unknowns.at(masses(carried))])

    def preferred(other: Fit, carried: tuple[int, ...]) -> tuple[float, ...]:
        more, least = added(other, carried)[-1], REFUTED_STD * deviations(other, carried)[-1]
        return other.gains.min() > 0, abs(more) > least, more

    # a body in some runs is one that the others lack: more is forgotten than taken away; gains of the other sign fit
    # other loads
    carried, other = one_after_the_other(unaltered, loaded, range(len(runs)), max(len(runs) - 1, 1), LEFT, preferred)
    if not carried or other.gains.max() < 0:  # all negative: the mirror image of another load
        return None
    problem, more, std = other.problem, added(other, carried), deviations(other, carried)
    if np.any(np.abs(more) < np.maximum(REFUTED_STD * std, MASS_ABSENT * declared[list(carried)])):
        return None
    freedom = degrees_of_freedom(problem, other.solution, fit.free_gains)[problem.unknowns.at(masses(carried))]
    halves = std * stdtrit(freedom, 0.975)
    bodies = []
    for number, mass, half in zip(carried, more.tolist(), halves.tolist(), strict=True):
        payload = runs[number].payload
        name = "" if payload is None or payload.mass is None else payload.name
        bodies.append({"run": runs[number].name, "more": mass, "half": half, "declared": name})
    helped = (other.solution.sigma / unaltered.solution.sigma) ** 2 < LEFT
    joints = tuple(joint for joint, less in zip(problem.joints, helped, strict=False) if less)
    text = " and ".join(_at_the_tool(**body) for body in bodies)
    advice = (
        "check which runs carry the payload and its mass, and declare the load of every run ('payload: {name: ..., "
        "mass: ...}' beside its 'log')"
    )
    cause = Finding(TOOL_BODY, joints, values={"bodies": bodies}, text=text, advice=advice)
    return described_otherwise(TOOL_BODIES, cause, other, unaltered)


def _exchanged_loads(fit: Fit) -> EstimatedEffect | None:
    """Find the two runs of which each carries what the other one declares."""
    runs, tried = fit.dataset.runs, list[tuple[float, str, Fit]]()
    for pair in combinations(range(len(runs)), 2) if unexplained_shares(fit).max() > ODD_TRIED else ():
        (payload, name), (instead, other) = ((runs[k].payload, runs[k].name) for k in pair)
        if payload != instead:
            loads = [{pair[0]: instead, pair[1]: payload}.get(k, run.payload) for k, run in enumerate(runs)]
            if (fitted := refitted(fit, loads)) is not None and fitted.gains.max() > 0:
                moves = ((payload, name, other), (instead, other, name))
                text = " and ".join(
                    f"payload '{load.name}' in run '{carrier}' in place of run '{run}'"
                    for load, run, carrier in moves
                    if load
                )
                tried.append((residual_ratio(fitted, fit.unrefined), text, fitted))
    remains, text, best = min(tried, key=lambda described: described[0], default=(1.0, "", fit))
    if remains > LEFT:
        return None
    cause = Finding(EXCHANGED_LOADS, text=text, advice="check which runs carry the payload")
    return described_otherwise(TOOL_BODIES, cause, best, fit.unrefined)


def _at_the_tool(run: str, more: float, half: float, declared: str) -> str:
    """Describe the body at the tool in a run, by its mass beyond what is ``declared``."""
    low, mass, high = (to_width(abs(more) + side * half, half) for side in (-1, 0, 1))
    sized = f"{mass} kg (95 % interval {low} to {high} kg)"
    if declared:
        return f"{sized} {'more' if more > 0 else 'less'} at the tool in run '{run}' than payload '{declared}'"
    if more < 0:
        return f"{sized} less at the tool in run '{run}' than in the others"
    return f"an undeclared body of {sized} at the tool in run '{run}'"


def odd_run(fit: Fit, than: EstimatedEffect | None) -> Finding | None:
    """Find the run without which the others agree, if they do much more ``than`` with another load in it.

    It may have reversed, exchanged or scaled columns of its own. None of fewer than three runs.
    """
    dataset, unaltered, tried = fit.dataset, fit.unrefined, dict[int, tuple[float, Fit]]()
    before = unexplained_shares(unaltered)
    for k in range(len(dataset.runs) if len(dataset.runs) > 2 else 0):
        kept = [number for number in range(len(dataset.runs)) if number != k]
        prepared = PreparedRuns(dataset.prepared[number] for number in kept)
        rest = replace(dataset, prepared=prepared, factors=tuple(dataset.factors[number] for number in kept))
        other = refitted(fit, [run.payload for run in rest.runs], rest)
        if other is None or not set(other.system.unexcited) <= set(fit.system.unexcited):
            continue
        if np.any((before > ODD_TRIED) & (unexplained_shares(other) ** 2 < MENDED * before**2)):
            tried[k] = residual_ratio(other, unaltered), other
    k, (ratio, other) = min(tried.items(), key=lambda entry: entry[1][0], default=(0, (1.0, unaltered)))
    if ratio >= (1.0 if than is None else LEFT * than.cause.values["remains"]):
        return None
    run, after = dataset.runs[k].name, unexplained_shares(other)
    worst = int(np.argmax(before[: len(fit.gains)]))
    joint, logged, share = fit.problem.joints[worst], before[worst], after[worst]
    text = (
        f"a fault in run '{run}' alone{_differences(fit, other, k)}: without it {100 * share:.2g} % of '{joint}' is "
        f"unexplained, {100 * logged:.2g} % with it"
    )
    advice = f"check the signs, units and order of the columns of run '{run}', and its payload, or leave it out"
    return contradiction(ODD_RUN, motors(fit), text, advice, size=1 - float(share / logged))


def _differences(fit: Fit, other: Fit, run: int) -> str:
    """Say at which joints the torques of a ``run`` are not what the ``other`` runs predict, and how they differ."""
    problem, shared = fit.problem, [name for name in fit.problem.parameters if name in other.problem.parameters]
    theta = np.append(np.zeros(problem.n_theta), 1.0)
    theta[problem.unknowns.at(shared)] = other.solution.theta[other.problem.unknowns.at(shared)]
    R = np.concatenate([*problem.blocks[fit.system.block_positions[:, 0] == run]], axis=1)[: len(fit.gains)]
    expected, logged = R[..., : KNOWN + 1] @ theta / other.gains[:, None], R[..., SIGNAL]
    factors = proportions(expected, logged)
    scaled = {
        joint: factor for joint, factor in zip(problem.joints, factors, strict=True) if abs(factor - 1) > MISFIT_GIVEN
    }
    if scaled:
        return f", whose {fit.kind}s of {times_of(scaled)} what the other runs predict"
    odd = np.linalg.norm(logged - expected, axis=1) > MISFIT_GIVEN * np.linalg.norm(logged, axis=1)
    whose = listed(np.array(problem.joints)[odd].tolist())
    return f", whose {fit.kind}s of {whose} the other runs do not predict" if odd.any() else ""


def proportions(expected: np.ndarray, logged: np.ndarray) -> list[float]:
    """Compute the factor by which each joint's logged torques (n, N) are the expected ones; NaN where none fits."""
    factors = np.sum(expected * logged, axis=1) / np.maximum(np.sum(expected**2, axis=1), 1e-300)
    rest, sizes = (np.linalg.norm(part, axis=1) for part in (logged - factors[:, None] * expected, logged))
    return np.where(rest < MISFIT_GIVEN * sizes, factors, np.nan).tolist()


def times_of(factors: Mapping[str, float]) -> str:
    """Say by which factors the torques of joints are larger."""
    times = " and ".join(dict.fromkeys(f"{float(f'{factor:.1g}'):g}" for factor in factors.values()))
    return f"{listed(factors)} are about {times} times"
