"""Build a result: estimates with names, units, standard deviations and verdicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from gtau.estimation.diagnostics.examine import Examination
from gtau.estimation.diagnostics.sensor_scales import sensor_scales, sensor_verdict
from gtau.estimation.diagnostics.stated_constants import scale_shares
from gtau.estimation.diagnostics.verdict import GOOD, judge_parameter, parameter_verdict
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.newton import squared, stacked
from gtau.estimation.friction.curves import FrictionCurve, friction_unit, reference_temperatures
from gtau.estimation.regression.assembly import PayloadColumns, known_values
from gtau.estimation.regression.dataset import System
from gtau.estimation.regression.factors import triangle
from gtau.estimation.regression.problem import Estimates, Problem
from gtau.estimation.results.estimate import (
    Estimate,
    Named,
    SensorEstimate,
    TorqueError,
    distances_along,
    nearest_poses,
)
from gtau.estimation.results.payload_body import PayloadEstimate, Weighed
from gtau.estimation.results.result import Evidence, FitRecord, ModelEstimates
from gtau.findings import Finding, Grade
from gtau.model.base_parameters import regrouped
from gtau.robots.geometry import longest_placement
from gtau.robots.parameter import DRIFTING, FURTHER_FRICTION, Parameter, gain_unit, torque_unit, unit_of
from gtau.robots.robot import INERTIAL, PLAIN_FRICTION, Robot
from gtau.signals.reading.statements import FIRST_MOMENTS, PAYLOAD_KINDS


def model_estimates(
    fit: Fit,
    equations: Estimates,
    predicting: Estimates,
    verdicts: Mapping[Parameter, Finding],
    payloads: Mapping[str, Finding],
    essential: Problem,
) -> ModelEstimates:
    """Collect the estimates with which the model predicts.

    ``equations`` are the estimates of the fit, ``predicting`` the same after the friction step; ``verdicts`` are on
    gains and delays, ``payloads`` those on known payloads by name.
    """
    dataset, channels = fit.dataset, fit.system.problem.channels
    temperatures = reference_temperatures(fit)
    sensors = {channel.name for channel in channels if channel.kind.link_side}
    given = {Parameter("gain", sensor) for sensor in sensors}
    listed = [name for name in predicting.unknowns if name not in given]
    order = {"gain": 1, "delay": 2}  # behind the parameters
    listed.sort(key=lambda name: order.get(name.kind, 0))
    return ModelEstimates(
        drive_gains=Named(_gains(fit, predicting, verdicts)),
        delays=Named((joint, _delay(predicting, joint, joint, verdicts)) for joint in dataset.model.actuated),
        parameters=Named(_parameters(fit, predicting, essential)),
        friction=Named(
            (name, _estimate(predicting, name, friction_unit(name, dataset.robot, temperatures)))
            for name in predicting.unknowns
            if name.kind in FURTHER_FRICTION and name.body not in sensors
        ),
        payloads=payload_estimates(fit.system, equations, payloads),
        covariance_names=tuple(listed),
        covariance=predicting.select(listed).covariance,
        temperatures=temperatures,
    )


def fit_record(
    fit: Fit, method: str, errors: Mapping[str, tuple[float, float]], statistics: Mapping[str, float]
) -> FitRecord:
    """Record how the estimates were fitted, with ``errors`` over all samples by motor and further ``statistics``."""
    dataset, solution = fit.dataset, fit.solution
    total, (sigma, signal) = _total(fit.system.problem, solution.sigma), _levels(fit)
    estimated, gains = _scaled(total[:, :-1]), np.abs(solution.gains)
    condition = float(np.linalg.cond(estimated)) if estimated.size else 1.0
    return FitRecord(
        method=method,
        kind=dataset.runs[0].kind,
        runs=tuple(run.name for run in dataset.runs),
        preparation=dataset.preparation,
        residuals=tuple(
            TorqueError(
                joint,
                float(gains[k] * sigma[k]),
                float(gains[k] * signal[k]),
                torque_unit(dataset.robot, joint),
                *errors.get(joint, ()),
            )
            for k, joint in enumerate(dataset.model.actuated)
        ),
        logged_speeds=_logged_speeds(fit),
        scale=_scale(fit) if fit.free_gains else {},
        statistics={**solution.statistics, **statistics, "condition_number": condition},
        singular_values=tuple(np.linalg.svd(_scaled(total), compute_uv=False).tolist()) if fit.free_gains else (),
        data=dataset.runs,
    )


def _scale(fit: Fit) -> dict[str, dict[str, float]]:
    """List what the scale of each motor's gain rests on, in shares."""
    actuated, shares = fit.dataset.model.actuated, scale_shares(fit)
    return {
        joint: {source: float(share[actuated.index(joint)]) for source, share in shares.items()}
        for joint in fit.dataset.robot.motors
    }


def evidence(
    fit: Fit,
    estimates: Estimates,
    examined: Examination,
    findings: Sequence[Finding],
    curves: Mapping[str, FrictionCurve],
) -> Evidence:
    """Collect what speaks for and against the estimates, including the estimates of the equations."""
    dataset, temperatures = fit.dataset, reference_temperatures(fit)
    replaced = {name for name in dataset.base.names if name.kind in PLAIN_FRICTION and name.body in curves}
    sensors = {channel.name for channel in fit.system.problem.channels if channel.kind.link_side}
    replaced |= {term for term in fit.system.terms if curves and term.body not in sensors}
    along = [
        (prepared, dataset.preparation.at(prepared.run.rate).decimator, factors.distances)
        for prepared, factors in zip(dataset.prepared, dataset.factors, strict=True)
        if factors.distances is not None
    ]
    return Evidence(
        notes=(*dataset.notes, *(finding for finding in findings if not finding.decisive)),
        effects=(*examined.refits, *examined.effects),
        curves=curves,
        equation_friction=Named(
            (name, _estimate(estimates, name, friction_unit(name, dataset.robot, temperatures)))
            for name in fit.system.problem.parameters
            if name in replaced
        ),
        singularities=tuple(nearest for run in along for nearest in nearest_poses(*run)),
        distances=tuple(distances_along(*run) for run in along),
    )


def _estimate(
    vector: Estimates, name: Parameter, unit: str, called: str = "", verdict: Finding | None = None
) -> Estimate:
    """Make the estimate of an unknown, by default under its own name and judged by its standard deviation.

    One that is given, or whose value the data do not determine, has no standard deviation.
    """
    k = vector.unknowns.places[name]
    value, std = float(vector.values[k]), float(np.sqrt(vector.covariance[k, k])) or None
    freedom = None if vector.effective_freedom is None else float(vector.effective_freedom[k])
    judged = verdict or parameter_verdict(value, std)
    if name.kind == "delay" and judged.outcome == Grade.NOT_IDENTIFIABLE:
        std = None
    model_std = None if std is None else min(float(np.sqrt(max(vector.model[k, k], 0.0))), std)  # but for rounding
    return Estimate(called or name, value, std, unit, verdict=judged, freedom=freedom, model_std=model_std)


def _gains(fit: Fit, vector: Estimates, verdicts: Mapping[Parameter, Finding]) -> dict[str, Estimate]:
    """Collect the drive gains of the motors."""
    robot, kind = fit.dataset.robot, fit.dataset.runs[0].kind
    return {
        joint: _estimate(vector, gain, gain_unit(robot, joint, kind), joint, verdicts[gain])
        for joint in robot.motors
        for gain in (Parameter("gain", joint),)
    }


def _delay(vector: Estimates, channel: str, joint: str, verdicts: Mapping[Parameter, Finding]) -> Estimate:
    delay = Parameter("delay", channel)
    return _estimate(vector, delay, "s", joint, verdicts[delay])


def _parameters(fit: Fit, vector: Estimates, essential: Problem) -> dict[Parameter, Estimate]:
    """Collect the base parameters, those without a value included."""
    base, robot, between_runs = fit.dataset.base, fit.dataset.robot, _between_runs(fit.system, fit.solution.theta)
    parameters = {}
    for name, terms in regrouped(base, fit.dataset.model.parameter_names).items():
        unit = unit_of(name.kind, robot, name.body)
        made = _estimate(vector, name, unit) if name in vector.unknowns.places else Estimate(name, None, None, unit)
        parameters[name] = replace(
            made,
            regrouping=base.regroupings[name],
            between_run_std=between_runs.get(name),
            verdict=judge_parameter(made.value, made.std, terms),
            essential=name in essential.parameters,
        )
    return parameters


def _scaled(W: np.ndarray) -> np.ndarray:
    """Scale the columns of ``W_tot`` to unit length."""
    length = np.linalg.norm(W, axis=0)
    return np.asarray(W[:, length > 0] / length[length > 0])


def _total(problem: Problem, sigma: np.ndarray) -> np.ndarray:
    """Build the triangular factor of ``W_tot`` (eq. 33), rows weighted by ``sigma`` (n,)."""
    weights = 1 / np.maximum(sigma, problem.smallest_sigma)
    rows = (problem.total_rows_of(R, j) * weights[j] for j, R in enumerate(problem.triangles))
    return triangle(*rows, problem.total_known)


def _logged_speeds(fit: Fit) -> dict[str, float]:
    """Find the largest speed of each actuated joint among the rows of all runs."""
    speeds = [factors.speeds.max(axis=0) for factors in fit.dataset.factors if factors.speeds is not None]
    largest = np.max(speeds, axis=0) if speeds else np.zeros(len(fit.dataset.model.actuated))
    return dict(zip(fit.dataset.model.actuated, map(float, largest), strict=True))


def _levels(fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Compute rms residual and rms signal of each channel, (c,), over rows that all count alike."""
    problem, solution = fit.system.problem, fit.solution
    if fit.unweighted is None:
        return solution.sigma, problem.balance(solution.theta)
    weighted, unweighted = (squared(stacked(rows), solution.values) for rows in (problem, fit.unweighted))
    ratio = np.sqrt(unweighted / np.maximum(weighted, 1e-300))
    return solution.sigma * ratio, fit.unweighted.balance(solution.theta)


def sensor_estimates(
    fit: Fit, vector: Estimates, verdicts: Mapping[Parameter, Finding], accuracy: float
) -> tuple[SensorEstimate, ...]:
    """Collect the estimates of the own parameters of sensors behind the drives."""
    robot, problem, sensors, (sigma, signal) = fit.dataset.robot, fit.system.problem, [], _levels(fit)
    scales = sensor_scales(fit) if fit.free_gains else ()
    for k in problem.sensor_channels:
        channel, joint = problem.channels[k], problem.channels[k].joint
        parameters = {
            name: _estimate(vector, name, unit_of(kind, robot, joint))
            for kind in ("off", *DRIFTING)
            if (name := Parameter(kind, channel.name)) in vector.unknowns.places
        }
        residual = TorqueError(joint, float(sigma[k]), float(signal[k]), torque_unit(robot, joint))
        scale = next((sensor for sensor in scales if sensor.channel == channel), None)
        ratio = None
        if scale is not None:
            ratio = Estimate(joint, scale.value, scale.std, "1", verdict=sensor_verdict(scale, accuracy))
        delay = _delay(vector, channel.name, joint, verdicts)
        sensors.append(SensorEstimate(joint, parameters, delay, residual, ratio, channel.kind))
    return tuple(sensors)


def _between_runs(system: System, theta: np.ndarray) -> dict[str, float]:
    """Compute the standard deviation between runs of each friction parameter that may drift."""
    differences: dict[str, list[float]] = {}
    for name, value in zip(system.problem.parameters, theta, strict=True):
        if name.run is not None:
            differences.setdefault(Parameter(name.kind, name.body), []).append(float(value))
    # the differences of all runs add up to zero, and the last is not listed
    return {name: float(np.std([*values, -sum(values)], ddof=1)) for name, values in differences.items()}


def payload_estimates(system: System, vector: Estimates, masses: Mapping[str, Finding]) -> tuple[PayloadEstimate, ...]:
    """Collect the payload of every loaded run, known and unknown parameters together.

    ``vector`` are the estimates by the equations, ``masses`` verdicts on known payloads, by name.
    """
    dataset, payloads = system.dataset, []
    for carried in system.payloads:
        known, name = known_values(carried.payload), carried.payload.name
        sums = _sums(carried, vector, dataset.robot)
        estimates = {kind: sums[kind] for kind in PAYLOAD_KINDS if kind in sums}
        if "m" in estimates and carried.payload.center is not None:
            unit = unit_of("mx", dataset.robot, dataset.robot.tool)
            moments = zip(FIRST_MOMENTS, carried.payload.center, strict=True)
            estimates |= {kind: _first_moment(kind, estimates["m"], at, unit) for kind, at in moments}
        weighed = None if "m" in known else _weighed(dataset.robot, carried, vector)
        verdict = masses.get(name) or _possible(estimates.get("m"))
        run = dataset.runs[carried.run].name
        payloads.append(PayloadEstimate(name, run, estimates, frozenset(known), verdict, weighed))
    return tuple(payloads)


def _sums(carried: PayloadColumns, vector: Estimates, robot: Robot) -> dict[str, Estimate]:
    """Collect the parameters of a payload by kind: what is stated, and the identified sums."""
    estimates = {}
    for kind, known in known_values(carried.payload).items():
        stated = carried.payload.mass_std or None if kind == "m" else None
        estimates[kind] = Estimate(kind, known, stated, unit_of(kind, robot, robot.tool), kind)
    for name in carried.unknown:
        if (kind := name.kind) not in estimates:
            value, std, freedom = _estimated(vector, name)
            verdict, unit = parameter_verdict(value, std), unit_of(kind, robot, robot.tool)
            estimates[kind] = Estimate(
                kind, value, std, unit, carried.regrouping(name), verdict=verdict, freedom=freedom
            )
    return estimates


def _estimated(vector: Estimates, name: Parameter) -> tuple[float | None, float | None, float | None]:
    """Return value, standard deviation and degrees of freedom of a sum, None where it is not identifiable."""
    if name not in vector.unknowns.places:
        return None, None, None
    k = vector.unknowns.places[name]
    freedom = None if vector.effective_freedom is None else float(vector.effective_freedom[k])
    return float(vector.values[k]), float(np.sqrt(vector.covariance[k, k])), freedom


def _possible(mass: Estimate | None) -> Finding:
    """Judge a mass that was estimated: contradictory where its 95 % interval lies below zero."""
    ends = None if mass is None else mass.interval()
    if mass is None or mass.value is None or ends is None or ends[1] >= 0:
        return GOOD
    return Finding(
        "payload of negative mass",
        text=f"its mass of {mass.value:.4g} kg (standard deviation {mass.std:.2g}) is negative, which no body has",
        advice="check which runs carry it, as the others may be the loaded ones, the signs of the commands, and "
        "gravity",
        grade=Grade.CONTRADICTORY,
        shown_as="model",
    )


def _weighed(robot: Robot, carried: PayloadColumns, vector: Estimates) -> Weighed:
    """Collect the identified sums of parameters, and the stated values of the others."""
    seen = [name for name in carried.unknown if name in vector.unknowns.places]
    sums = np.zeros((len(seen), len(INERTIAL)))
    rows = [carried.unknown.index(name) for name in seen]
    sums[:, [INERTIAL.index(kind) for kind in carried.summed]] = carried.sums[rows]
    estimates = vector.select(seen)
    unit = dict(zip(INERTIAL, np.eye(len(INERTIAL)), strict=True))
    stated = [(unit[kind], value) for kind, value in known_values(carried.payload).items()]
    center = zip(FIRST_MOMENTS, carried.payload.center or (), strict=False)
    stated += [(unit[kind] - at * unit["m"], 0.0) for kind, at in center]
    return Weighed(
        robot.tool,
        sums,
        estimates.values,
        estimates.covariance,
        np.reshape([row for row, _ in stated], (len(stated), len(INERTIAL))),
        np.array([value for _, value in stated]),
        None if estimates.effective_freedom is None or not seen else float(estimates.effective_freedom.min()),
        longest_placement(robot),
    )


def _first_moment(kind: str, mass: Estimate, at: float, unit: str) -> Estimate:
    """Derive a first moment from a mass whose centre is known."""
    value, std = None if mass.value is None else at * mass.value, None if mass.std is None else abs(at) * mass.std
    return replace(mass, name=kind, value=value, std=std, unit=unit, regrouping=f"{at:.5g} m")
