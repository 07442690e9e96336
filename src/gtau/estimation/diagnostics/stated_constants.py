"""Stated constants: known payloads, torque sensors, measured wrenches and priors, and how the estimates depend on them.

Currents alone leave the scale open: gains and parameters may all be twice as large. It comes from constants stated in
N m or kg. The derivative of the estimates with respect to each constant, at the solution, gives the sources of the
scale, the uncertainty that the constants add to the estimates, and the contradiction between a constant and all other
data. With all constants larger by one per cent, every gain and parameter is larger by one per cent too; so the shares
by which a gain grows with each source alone add up to one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr, ndtri

from gtau.estimation.diagnostics.refits import refitted, residual_ratio
from gtau.estimation.diagnostics.verdict import APART, GOOD, WIDTH, unexplained_shares
from gtau.estimation.effects.linearisation import slopes_of, weighted, weights_of
from gtau.estimation.estimators.estimator import Fit, Solve, jackknife
from gtau.estimation.estimators.newton import (
    curvature_of_delays,
    jacobian,
    jacobian_of_known,
    one_step,
    stacked,
    whitening,
)
from gtau.estimation.regression.column_blocks import known_values
from gtau.estimation.regression.dataset import System
from gtau.estimation.regression.factors import FIXED, KNOWN, SIGNALS, delayed_signal, modelled, triangle
from gtau.estimation.regression.problem import Problem
from gtau.findings import Finding, Grade
from gtau.model.base_parameters import independent_columns
from gtau.robots.parameter import Parameter, unit_of
from gtau.signals.channel import Channel
from gtau.signals.reading.statements import FIRST_MOMENTS, Payload

MISFIT_GIVEN = 0.5  # share of a joint's torque that is unexplained, gains given
PAYLOAD_MOVES = 0.01  # relative move of the gains when a known payload parameter is estimated instead
IN_METRES = 4.0  # times that a moment must be nearer to mass times the stated value, which is then in m
LEAST_OTHERS = 0.001  # share of all else in an estimate that has a prior, below which it is the prior

SCALED_BY_FILE = "the inertias of the robot's file"
SENSOR, PRIOR = "contradictory torque sensor", "contradictory prior"
PAYLOAD_MASS, PAYLOAD_PARAMETER = "payload mass", "payload parameter"
SENSOR_ADVICE = "check the sensor's calibration, unit and joint; a payload's mass or a known parameter may be wrong too"


@dataclass(frozen=True, eq=False)
class StatedConstant:
    """A constant that sets the scale: its ``source``, ``value`` and standard deviation, 0 if taken as exact.

    The derivatives by it: of the ``columns`` (U, c, p, 4) behind the model, known torques and signals, and of the
    residuals of the ``known`` parameters (k,).
    """

    source: str
    value: float
    std: float
    columns: np.ndarray
    known: np.ndarray

    def changed(self, problem: Problem, by: float) -> Problem:
        """Return a problem with the constant, no known parameter, increased ``by`` an amount."""
        blocks = problem.blocks.copy()
        blocks[..., KNOWN:] += by * self.columns
        return replace(problem, blocks=blocks)


def stated_constants(system: System) -> list[StatedConstant]:
    """List all constants that give the scale: payloads' parameters, torque sensors, wrenches, known parameters.

    The last three are scales, of value 1, of each sensor, of all wrenches, and of all known parameters together.
    """
    problem, constants = system.problem, list[StatedConstant]()
    known = problem.known[:, -1]
    of_channels = np.eye(len(problem.channels))[:, :, None, None]

    def add(
        source: str, value: float, std: float, torques: np.ndarray | float, readings: np.ndarray | float, share: float
    ) -> None:
        columns = np.zeros((*problem.blocks.shape[:3], FIXED))
        columns[..., KNOWN] = torques
        columns[..., SIGNALS] = readings * problem.blocks[..., SIGNALS]
        constants.append(StatedConstant(source, value, std, columns, -share * known))

    payloads: dict[str, Payload] = {}
    for load in system.payloads:
        if load.acts:
            payloads.setdefault(load.payload.name, load.payload)
    for name, payload in payloads.items():
        for kind, value in known_values(payload).items():
            std = payload.mass_std if kind == "m" else 0.0
            add(f"payload '{name}'", value, std, _torques_of_unit(system, name, kind), 0.0, 0.0)
    for k in problem.sensor_channels:
        channel = problem.channels[k]
        add(f"{channel.kind.name} of '{channel.joint}'", 1.0, channel.std, 0.0, of_channels[k], 0.0)
    if problem.base or system.wrench_columns is not None:
        torques = 0.0 if system.wrench_columns is None else system.wrench_columns
        channels = system.dataset.runs[0].channels
        std = max((channel.std for channel in channels if not channel.kind.measures_joint), default=0.0)
        add(_wrenches(problem), 1.0, std, torques, of_channels[problem.base].sum(axis=0), 0.0)
    if len(known):
        source = SCALED_BY_FILE if system.dataset.scaled_by_file else "known parameters"
        add(source, 1.0, 0.0, 0.0, 0.0, 1.0)
    return constants


def _torques_of_unit(system: System, name: str, kind: str) -> np.ndarray:
    """Compute the torques (U, c, p) of a unit of a payload's parameter, in the rows of the problem."""
    dataset = system.dataset
    parts, channels = [np.zeros(factor.R.shape[:3]) for factor in dataset.factors], system.problem.channels
    for run, label in ((item.run, item.label) for item in system.payloads if item.payload.name == name):
        block = next(item for item in system.effects if Parameter(kind, label) in item.stated)
        k, R = block.names.index(Parameter(kind, label)), dataset.factors[run].R
        of_channels = [block.columns(run, channel, np.zeros(()))[:, k] for channel in channels]
        parts[run] = np.stack([R[:, j] @ column for j, column in enumerate(of_channels)], axis=1)
    filled = np.concatenate([factor.rows for factor in dataset.factors]).sum(axis=1) > 0
    return np.concatenate(parts)[filled]


def _wrenches(problem: Problem) -> str:
    """Name the measured wrenches; with a base that floats they are those on the base too."""
    base = [problem.channels[k].joint for k in problem.base]
    if base and problem.wrenches:
        return "measured wrenches"
    bodies = problem.wrenches or base[-1:]
    return f"wrench{'es' * (len(bodies) > 1)} on {', '.join(repr(body) for body in bodies)}"


def estimate_slopes(fit: Fit, constants: Sequence[StatedConstant]) -> np.ndarray:
    """Differentiate (theta, gains, delays) with respect to stated constants, (k, m), at the solution."""
    problem, solution, weights = fit.system.problem, fit.solution, weights_of(fit)
    triangles, known = stacked(problem), jacobian_of_known(problem, fit.free_gains)
    J = weighted(fit, triangles)[1].reshape(-1, known.shape[1])
    back = whitening(np.concatenate([J, known]), curvature_of_delays(triangles, solution.values, problem, weights))
    of_blocks = jacobian(problem.blocks, solution.values, problem, fit.free_gains)
    sides = []
    for constant in constants:
        read, torques = delayed_signal(constant.columns, solution.delays), constant.columns[..., KNOWN]
        change = read - torques / solution.gains[:, None]
        side = np.einsum("ujpk,ujp,j->k", of_blocks, change, weights**2)
        sides.append(side + known.T @ constant.known)
    T = slopes_of(fit)
    return np.asarray(-(T @ back) @ (back.T @ np.reshape(sides, (-1, len(back))).T))


def scale_shares(fit: Fit) -> dict[str, np.ndarray]:
    """Find the share of each source in the scale of the joints' estimated gains, source to (n,); they add up to one."""
    constants, shares = stated_constants(fit.system), dict[str, np.ndarray]()
    slopes = estimate_slopes(fit, constants)[fit.system.problem.gain_rows]
    for constant, slope in zip(constants, slopes.T, strict=True):
        shares[constant.source] = shares.get(constant.source, 0.0) + constant.value * slope / fit.gains
    total = np.sum(list(shares.values()), axis=0)  # one, up to the curvature that the linear equations lack
    total = np.where(total == 0.0, 1.0, total)  # of a base, whose gain is known
    return {source: share / total for source, share in shares.items()}


def scale_uncertainty(system: System, solve: Solve) -> np.ndarray:
    """Compute the covariance of (theta, gains, delays) that the uncertainty of stated constants adds, (k, k).

    Each constant is larger and smaller by its standard deviation, and ``solve`` says how far the estimates move: those
    of an estimator that minimises no squares do not have the derivatives of :func:`estimate_slopes`. The uncertainty of
    known parameters is in the solution's own covariance.
    """
    problem = system.problem
    extra = np.zeros((len(problem.unknowns),) * 2)
    for constant in stated_constants(system):
        if std := constant.std:
            above, below = (solve(constant.changed(problem, by)).values for by in (std, -std))
            extra += np.outer(above - below, above - below) / 4
    return extra


@dataclass(frozen=True, eq=False)
class SensorScale:
    """Ratio of a joint's torque from the other stated constants to that of its sensor, with its standard deviation.

    By ``gain_shift`` (n,), a share of itself, each gain moves where the scale of the sensor is found, not taken for 1.
    """

    channel: Channel
    value: float
    std: float
    gain_shift: np.ndarray


def sensor_verdict(scale: SensorScale, accuracy: float) -> Finding:
    """Judge a scale: contradictory where it differs from 1 significantly and by more than the ``accuracy``."""
    if abs(scale.value - 1) <= max(APART * scale.std, accuracy):
        return GOOD
    return Finding(
        "sensor scale",
        text=f"all other data give torques {scale.value:.4g} times its reading (standard deviation {scale.std:.2g})",
        advice=SENSOR_ADVICE,
        grade=Grade.CONTRADICTORY,
        shown_as="model",
    )


def sensor_scales(fit: Fit) -> tuple[SensorScale, ...]:
    """Estimate the scale of each sensor from the other stated constants, to first order, where there are any.

    Each sensor is offered the torque of its model once more, with an unknown factor; all other unknowns adapt to it.
    """
    problem, solution, sensors = fit.system.problem, fit.solution, fit.system.problem.sensor_channels
    if not sensors:
        return ()
    rows, *units = (_with_sensors(fit, blocks) for blocks in (stacked(problem), *problem.units))
    size = rows.shape[1] - len(sensors) - 1
    of_known = np.zeros((len(problem.known), rows.shape[1]))
    of_known[:, :size] = jacobian_of_known(problem, True)
    of_known[:, -1] = problem.known[:, :-1] @ solution.theta - problem.known[:, -1]
    R = triangle(rows, of_known)
    T = slopes_of(fit)[problem.gain_rows] / fit.gains[:, None]
    scales = []
    for k, sensor in enumerate(sensors):
        columns, channel = [*range(size), size + k], problem.channels[sensor]
        J = R[:, columns]
        if size not in independent_columns(J)[0]:
            continue  # without this sensor nothing gives the scale
        back = whitening(J, np.zeros(len(problem.channels)))
        step = -back @ (back.T @ (J.T @ R[:, -1]))
        sides = []
        for unit in units:
            A, e = unit[:, columns] @ back, unit[:, -1] + unit[:, columns] @ step
            sides.append((A.T @ A, A.T @ e))
        of_known_part = back[-1] @ (of_known[:, columns] @ back).T  # what no unit of the data shows
        variance = jackknife(one_step(sides) @ back[-1:].T)[0, 0] + of_known_part @ of_known_part
        std = float(np.hypot(np.sqrt(variance), channel.std))
        scales.append(SensorScale(channel, 1 - float(step[-1]), std, T @ step[:-1]))
    return tuple(scales)


def _with_sensors(fit: Fit, blocks: np.ndarray) -> np.ndarray:
    """Build weighted rows ``[J | sensor torques | residuals]`` (., size + m + 1) of all channels in blocks."""
    solution, sensors = fit.solution, fit.system.problem.sensor_channels
    torques = modelled(blocks, solution.theta) * (weights_of(fit) / solution.gains)[:, None]
    offered = np.zeros((*torques.shape, len(sensors)))
    offered[sensors, :, range(len(sensors))] = -torques[sensors]
    e, J = weighted(fit, blocks)
    rows = np.concatenate([J, offered, e[..., None]], axis=-1)
    return np.asarray(rows.reshape(-1, rows.shape[-1]))


def sensor_contradictions(scales: Sequence[SensorScale], joints: Sequence[str], accuracy: float) -> Iterator[Finding]:
    """Find the gains of ``joints`` (n,) that rest on a sensor contradicting the other stated constants."""
    for scale in sorted(scales, key=lambda scale: -float(np.abs(scale.gain_shift).max())):
        moves = np.abs(scale.gain_shift)
        moved = tuple(joint for joint, move in zip(joints, moves, strict=True) if move > accuracy)
        if sensor_verdict(scale, accuracy).outcome == Grade.CONTRADICTORY and moved:
            sensor, joint = scale.channel.kind.name, scale.channel.joint
            text = f"the scale comes from the {sensor} of '{joint}', which contradicts all other data"
            yield Finding(SENSOR, moved, joint, text=text, advice=SENSOR_ADVICE, grade=Grade.CONTRADICTORY)


def prior_contradictions(fit: Fit, covariance: np.ndarray, accuracy: float) -> list[Finding]:
    """Find base parameters whose estimates without their prior differ from it by more than the ``accuracy`` (relative).

    ``covariance`` (k, k) is that of (theta, gains, delays). Each estimate is a mean of what all else says and the
    prior, whose weight is its share in the information; that of a prior which alone sets the scale is 1.
    """
    parameters, base, wrong = fit.system.problem.parameters, fit.dataset.base.names, []
    priors = {name: prior for name, prior in fit.dataset.stated_priors.items() if name in base and name in parameters}
    limit = -ndtri(ndtr(-APART) / max(len(priors), 1))  # of many priors some are further off
    for name, prior in priors.items():
        if prior.value is None or prior.std is None:
            continue
        k = parameters.index(name)
        others = 1 - float(fit.solution.covariance[k, k]) / prior.std**2
        if others < LEAST_OTHERS:
            continue
        value = prior.value + (float(fit.solution.theta[k]) - prior.value) / others
        std = float(np.sqrt(max(covariance[k, k] - ((1 - others) * prior.std) ** 2, 0.0))) / others
        if abs(value - prior.value) > max(limit * np.hypot(std, prior.std), accuracy * abs(prior.value)):
            wrong.append(
                Finding(
                    PRIOR,
                    subject=name,
                    size=abs(value - prior.value) / (WIDTH * float(np.hypot(std, prior.std))),
                    text=f"the known parameter {name} is {value:.4g} from the data (standard deviation {std:.2g}), but "
                    f"{prior.value:.4g} from its prior ({prior.std:.2g})",
                    advice="check its value, and the units and signs of the other scale references: payloads, sensors, "
                    "wrenches",
                    shown_as="model",
                )
            )
    return wrong


def weigh_known(fit: Fit, method: str, accuracy: float) -> dict[str, Finding]:
    """Estimate each known value of a payload in turn, with given gains or gains from the other constants.

    Of several values of a payload that the data contradict, the one is named that leaves least when it alone is freed.
    A single payload's mass is not among them where it sets the scale alone. Gains that are given are taken for exact
    to the ``accuracy`` (relative). Verdicts are those of payloads, by name, with a value that can be tested.
    """
    payloads = [run.payload for run in fit.dataset.runs if run.payload]
    known = {payload.name: payload for payload in payloads if payload.mass is not None}
    of_mass = ("m",) if not fit.free_gains or len(known) > 1 or fit.system.problem.scaled else ()
    verdicts = {}
    for name, payload in known.items():
        kinds = (*of_mass, *payload.parameters)
        freed = [result for kind in kinds if (result := _freed(fit, method, payload, kind, accuracy))]
        if freed:
            verdicts[name] = min(freed, key=lambda result: result[0])[1]
    return verdicts


def _freed(fit: Fit, method: str, payload: Payload, kind: str, accuracy: float) -> tuple[float, Finding] | None:
    """Estimate a payload's parameter without stating it: what that leaves, and a verdict; None if not identifiable."""
    values = {other: value for other, value in payload.parameters.items() if other != kind}
    mass = None if kind == "m" else payload.mass
    changed = payload.model_copy(update={"mass": mass, "parameters": values})
    stated = [run.payload for run in fit.dataset.runs]
    other = refitted(fit, [changed if load and load.name == payload.name else load for load in stated], method=method)
    if other is None or not set(other.system.unexcited) <= set(fit.system.unexcited):
        return None  # without this value nothing gives the scale, or it cannot be separated from what is not declared
    problem, theta, stds = other.system.problem, other.solution.theta, np.sqrt(np.diag(other.solution.jackknife))
    columns = [
        problem.unknowns.places[label]
        for load in other.system.payloads
        if load.payload.name == payload.name
        for label, sums in zip(load.unknown, load.sums, strict=True)
        if label.kind == kind and np.count_nonzero(sums) == 1 and label in problem.unknowns.places
    ]
    if not columns:
        return None
    best = min(columns, key=lambda k: float(stds[k]))
    value, declared = float(theta[best]), known_values(payload)[kind]
    if fit.free_gains:
        small = kind != "m" and float(np.abs(other.solution.gains / fit.solution.gains - 1).max()) < PAYLOAD_MOVES
    else:
        small = abs(value - declared) <= accuracy * abs(declared)
    of_mass = payload.mass_std if mass is None else value * payload.mass_std / mass
    std = float(np.hypot(stds[best], of_mass))
    likelihood = float(problem.total_rows @ np.log(other.solution.sigma))
    if small or abs(value - declared) <= APART * std:
        return likelihood, GOOD
    if kind == "m":
        wrong = PAYLOAD_MASS
        text = f"all other data give it a mass of {value:.4g} kg (standard deviation {std:.2g}), not {declared:.4g} kg"
        advice = "reweigh the payloads: a mass is wrong, or a run carries a payload other than declared"
        if not fit.free_gains:
            torques = fit.dataset.runs[0].kind == "torque"
            advice = (
                "check which runs carry the payload, its mass (kg) and "
                f"{'the unit and scale of the torques' if torques else 'the given gains'}; if the mass is certain, "
                f"{'use --method ml' if torques else 'identify the gains'}: it then sets their scale"
            )
    else:
        wrong, unit = PAYLOAD_PARAMETER, unit_of(kind, fit.dataset.robot, fit.dataset.robot.tool)
        text = (
            f"given its mass and all other data, its {kind} is {value:.4g} {unit} (standard deviation {std:.2g}), not "
            f"{declared:.4g} {unit}"
        )
        advice = f"check {kind}, its frame (that of the body that carries the payload) and the mass; or omit {kind}"
        if kind in FIRST_MOMENTS and mass and abs(value - mass * declared) < abs(value - declared) / IN_METRES:
            in_metres = f"write '{kind}: {mass * declared:.4g}' (mass times distance, kg m)"
            advice = f"if {declared:.4g} is in m, {in_metres}; otherwise {advice}"
    verdict = Finding(
        wrong,
        _explained(fit, other),
        payload.name,
        values={"remains": residual_ratio(other, fit)},
        size=abs(value - declared) / std,
        text=text,
        advice=advice,
        grade=Grade.CONTRADICTORY,
        shown_as="model",
    )
    return likelihood, verdict


def _explained(fit: Fit, other: Fit) -> tuple[str, ...]:
    """List the joints whose torque only the fit leaves unexplained, not the other one."""
    before, after = (unexplained_shares(either.system.problem, either.solution) for either in (fit, other))
    joints = zip(fit.system.problem.joints, before, after, strict=False)
    return tuple(joint for joint, share, less in joints if share > MISFIT_GIVEN >= less)
