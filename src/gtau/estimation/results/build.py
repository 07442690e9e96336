"""Build a result: estimates with names, units, standard deviations and verdicts."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gtau.estimation.diagnostics.diagnose import Examination
from gtau.estimation.diagnostics.scale import SensorScale, scale_shares
from gtau.estimation.diagnostics.verdict import GOOD, brakes, judge_parameter, parameter_verdict
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.newton import squared, stacked
from gtau.estimation.friction.curves import FrictionCurve, friction_unit, reference_temperatures
from gtau.estimation.regression.assembly import PayloadColumns, known_values
from gtau.estimation.regression.dataset import System
from gtau.estimation.regression.factors import triangle
from gtau.estimation.regression.problem import Estimates, Problem
from gtau.estimation.results.estimate import Estimate, SensorEstimate, TorqueError, distances_along, nearest_poses
from gtau.estimation.results.payload_body import PayloadEstimate, Weighed
from gtau.findings import Finding, Grade
from gtau.model.base_parameters import regrouped
from gtau.robots.geometry import longest_placement
from gtau.robots.parameter import DRIFTING, FURTHER_FRICTION, Parameter, gain_unit, torque_unit, unit_of
from gtau.robots.robot import INERTIAL, PLAIN_FRICTION, Robot
from gtau.signals.reading.experiment import Recording
from gtau.signals.reading.statements import FIRST_MOMENTS, PAYLOAD_KINDS
from gtau.signals.reading.units import Units
from gtau.signals.run import Run


def model_estimates(
    fit: Fit,
    equations: Estimates,
    predicting: Estimates,
    verdicts: Mapping[Parameter, Finding],
    payloads: Mapping[str, Finding],
    essential: Problem,
) -> dict[str, Any]:
    """Collect estimates, those of ``equations`` for payloads, and ``predicting`` ones after the friction step."""
    robot = fit.dataset.robot
    temperatures, sensors = reference_temperatures(fit), _link_side(fit)
    listed = [name for name in predicting.unknowns if name.kind != "gain" or name.body not in sensors]
    listed.sort(key=lambda name: {"gain": 1, "delay": 2}.get(name.kind, 0))  # behind the parameters
    gains = {joint: Parameter("gain", joint) for joint in robot.motors}
    delays = {joint: Parameter("delay", joint) for joint in robot.actuated}
    return {
        "drive_gains": {
            joint: _estimate(predicting, gain, gain_unit(robot, joint, fit.kind), joint, verdicts[gain])
            for joint, gain in gains.items()
        },
        "delays": {joint: _estimate(predicting, delay, "s", joint, verdicts[delay]) for joint, delay in delays.items()},
        "parameters": _parameters(fit, predicting, essential),
        "friction": {
            name: _estimate(predicting, name, friction_unit(name, robot, temperatures))
            for name in predicting.unknowns
            if name.kind in FURTHER_FRICTION and name.body not in sensors
        },
        "payloads": payload_estimates(fit.system, equations, payloads),
        "covariance_names": tuple(listed),
        "covariance": predicting.select(listed).covariance,
        "temperatures": temperatures,
    }


def fit_record(
    fit: Fit, method: str, errors: Mapping[str, tuple[float, float]], statistics: Mapping[str, float]
) -> dict[str, Any]:
    """Record how the estimates were fitted, with ``errors`` over all samples by motor and further ``statistics``."""
    dataset, problem, solution = fit.dataset, fit.problem, fit.solution
    robot, joints = dataset.robot, dataset.model.actuated
    weights = 1 / np.maximum(solution.sigma, problem.smallest_sigma)
    rows = (problem.total_rows_of(R, j) * weights[j] for j, R in enumerate(problem.triangles))
    W_tot = triangle(*rows, problem.total_known)  # eq. (33)
    estimated = _unit_columns(W_tot[:, :-1])
    singular = np.linalg.svd(_unit_columns(W_tot), compute_uv=False) if fit.free_gains else np.empty(0)
    condition = float(np.linalg.cond(estimated)) if estimated.size else 1.0
    sizes = np.abs(solution.gains) * _levels(fit)
    speeds = [factors.speeds.max(axis=0) for factors in dataset.factors if factors.speeds is not None]
    fastest = np.max(speeds, axis=0) if speeds else np.zeros(len(joints))
    shares = scale_shares(fit) if fit.free_gains else {}
    return {
        "method": method,
        "kind": dataset.runs[0].kind,
        "runs": tuple(run.name for run in dataset.runs),
        "preparation": dataset.preparation,
        "residuals": tuple(
            TorqueError(joint, float(rms), float(signal), torque_unit(robot, joint), *errors.get(joint, ()))
            for joint, rms, signal in zip(joints, *sizes[:, : len(joints)], strict=True)
        ),
        "logged_speeds": dict(zip(joints, map(float, fastest), strict=True)),
        "scale": {
            joint: {source: float(share[joints.index(joint)]) for source, share in shares.items()}
            for joint in (robot.motors if fit.free_gains else ())
        },
        "statistics": {**solution.statistics, **statistics, "condition_number": condition},
        "singular_values": tuple(singular.tolist()),
        "data": dataset.runs,
        "recording": _recording(dataset.runs),
    }


def _recording(runs: Sequence[Run]) -> Recording | None:
    """Return the columns and units of the runs' logs, None where they differ or are of arrays."""
    signals, units = runs[0].log.signals, runs[0].log.units or Units()
    alike = all((run.log.signals, run.log.units or Units()) == (signals, units) for run in runs)
    return Recording(signals=signals, units=units) if alike and signals is not None else None


def evidence(
    fit: Fit,
    estimates: Estimates,
    examined: Examination,
    findings: Sequence[Finding],
    curves: Mapping[str, FrictionCurve],
) -> dict[str, Any]:
    """Collect what speaks for and against the estimates, including the estimates of the equations."""
    dataset, temperatures, sensors = fit.dataset, reference_temperatures(fit), _link_side(fit)
    replaced = {name for name in dataset.base.names if name.kind in PLAIN_FRICTION and name.body in curves}
    replaced |= {term for term in fit.system.terms if curves and term.body not in sensors}
    along = [
        (prepared, dataset.preparation.at(prepared.run.rate).decimator, factors.distances)
        for prepared, factors in zip(dataset.prepared, dataset.factors, strict=True)
        if factors.distances is not None
    ]
    return {
        "notes": (*dataset.notes, *(finding for finding in findings if not finding.decisive)),
        "effects": examined.effects,
        "curves": curves,
        "equation_friction": {
            name: _estimate(estimates, name, friction_unit(name, dataset.robot, temperatures))
            for name in fit.system.problem.parameters
            if name in replaced
        },
        "singularities": tuple(nearest for run in along for nearest in nearest_poses(*run)),
        "distances": tuple(distances_along(*run) for run in along),
    }


def _link_side(fit: Fit) -> set[str]:
    return {channel.name for channel in fit.system.problem.channels if channel.kind.link_side}


def _estimate(
    vector: Estimates, name: Parameter, unit: str, called: str = "", verdict: Finding | None = None
) -> Estimate:
    """Make the estimate of an unknown, without a standard deviation where it is given, or not determined."""
    k = vector.unknowns.places[name]
    value, std, freedom = _numbers(vector, name)
    judged = verdict or parameter_verdict(value, std or None)
    if not std or (name.kind == "delay" and judged.outcome == Grade.NOT_IDENTIFIABLE):
        return Estimate(called or name, value, None, unit, verdict=judged, freedom=freedom)
    model_std = min(max(float(vector.model[k, k]), 0.0) ** 0.5, std)
    return Estimate(called or name, value, std, unit, verdict=judged, freedom=freedom, model_std=model_std)


def _numbers(vector: Estimates, name: Parameter) -> tuple[float | None, float | None, float | None]:
    """Return value, standard deviation and degrees of freedom of an unknown, None where it is not identifiable."""
    if name not in vector.unknowns.places:
        return None, None, None
    k = vector.unknowns.places[name]
    freedom = None if vector.effective_freedom is None else float(vector.effective_freedom[k])
    variance = max(float(vector.covariance[k, k]), 0.0)  # but for rounding
    return float(vector.values[k]), variance**0.5, freedom


def _parameters(fit: Fit, vector: Estimates, essential: Problem) -> dict[Parameter, Estimate]:
    base, robot = fit.dataset.base, fit.dataset.robot
    parameters, differences = {}, defaultdict[str, list[float]](list)  # between runs, of friction that may drift
    for name, value in zip(fit.system.problem.parameters, fit.solution.theta.tolist(), strict=True):
        if name.run is not None:
            differences[Parameter(name.kind, name.body)].append(value)
    # they add up to zero over all runs, and the last is not listed
    between_runs = {name: float(np.std([*values, -sum(values)], ddof=1)) for name, values in differences.items()}
    always = fit.system.always_carried
    of_tool = {Parameter(kind, robot.tool) for kind in always}
    load = f" (with the load of run {next(iter(always.values()))})" if always else ""
    for name, terms in regrouped(base, fit.dataset.model.parameter_names).items():
        unit, known = unit_of(name.kind, robot, name.body), name in vector.unknowns.places
        made = _estimate(vector, name, unit) if known else Estimate(name, None, None, unit)
        parameters[name] = replace(
            made,
            regrouping=base.regroupings[name] + load * bool(of_tool & terms.keys()),
            between_run_std=between_runs.get(name),
            verdict=judge_parameter(made.value, made.std, terms, brakes(fit, vector, name)),
            essential=name in essential.parameters,
        )
    return parameters


def _unit_columns(W: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(W, axis=0)
    return np.asarray(W[:, length > 0] / length[length > 0])


def _levels(fit: Fit) -> np.ndarray:
    """Compute rms residual and rms signal of each channel, (2, c), over rows that all count alike."""
    problem, solution = fit.problem, fit.solution
    if fit.unweighted is None:
        return np.stack([solution.sigma, problem.balance(solution.theta)])
    weighted, unweighted = (squared(stacked(rows), solution.values) for rows in (problem, fit.unweighted))
    ratio = np.sqrt(unweighted / np.maximum(weighted, 1e-300))
    return np.stack([solution.sigma * ratio, fit.unweighted.balance(solution.theta)])


def sensor_estimates(
    fit: Fit, vector: Estimates, verdicts: Mapping[Parameter, Finding], found: Sequence[SensorScale], accuracy: float
) -> tuple[SensorEstimate, ...]:
    """Collect the estimates of the own parameters of sensors behind the drives."""
    robot, problem, sensors = fit.dataset.robot, fit.system.problem, []
    scales = {scale.channel.name: scale for scale in found}
    sigma, signal = _levels(fit).tolist()
    for k in problem.sensor_channels:
        channel = problem.channels[k]
        joint, scale, name = channel.joint, scales.get(channel.name), Parameter("delay", channel.name)
        own = [Parameter(kind, channel.name) for kind in ("off", *DRIFTING)]
        parameters = {
            name: _estimate(vector, name, unit_of(name.kind, robot, joint))
            for name in own
            if name in vector.unknowns.places
        }
        ratio = None
        if scale is not None:
            ratio = Estimate(joint, scale.value, scale.std, "1", verdict=scale.verdict(accuracy))
        delay = _estimate(vector, name, "s", joint, verdicts[name])
        residual = TorqueError(joint, sigma[k], signal[k], torque_unit(robot, joint))
        sensors.append(SensorEstimate(joint, parameters, delay, residual, ratio, channel.kind))
    return tuple(sensors)


NO_EMPTY_RUN = Finding(
    "difference of payloads",
    text="as no run is without payload, it is a difference between payloads",
    advice="add a run without payload",
    grade=Grade.NOT_IDENTIFIABLE,
)


def payload_estimates(system: System, vector: Estimates, masses: Mapping[str, Finding]) -> tuple[PayloadEstimate, ...]:
    """Collect the payload of every loaded run, with verdicts on known ``masses`` by name of the payload."""
    robot, runs, payloads = system.dataset.robot, system.dataset.runs, []
    always = system.always_carried
    for carried in system.payloads:
        payload, known = carried.payload, known_values(carried.payload)
        sums = {}
        for kind, value in known.items():
            stated = payload.mass_std or None if kind == "m" else None
            sums[kind] = Estimate(kind, value, stated, unit_of(kind, robot, robot.tool), kind)
        for kind, name in ((name.kind, name) for name in carried.unknown):
            unit, (number, std, freedom) = unit_of(kind, robot, robot.tool), _numbers(vector, name)
            verdict, regrouping = parameter_verdict(number, std), carried.regrouping(name)
            if kind in always and number is not None:
                verdict, regrouping = NO_EMPTY_RUN, f"{regrouping} - {kind} of run {always[kind]}"
            sums[kind] = Estimate(kind, number, std, unit, regrouping, verdict=verdict, freedom=freedom)
        estimates = {kind: sums[kind] for kind in PAYLOAD_KINDS if kind in sums}
        if (mass := estimates.get("m")) and payload.center is not None:
            for kind, at in zip(FIRST_MOMENTS, payload.center, strict=True):
                moment = None if mass.value is None else at * mass.value
                spread, unit = None if mass.std is None else abs(at) * mass.std, unit_of(kind, robot, robot.tool)
                text = f"{at:.5g} m"
                estimates[kind] = replace(mass, name=kind, value=moment, std=spread, unit=unit, regrouping=text)
        weighed = None if "m" in known else _weighed(robot, carried, vector)
        judged = masses.get(payload.name) or _possible(mass)
        run = runs[carried.run].name
        payloads.append(PayloadEstimate(payload.name, run, estimates, frozenset(known), judged, weighed))
    return tuple(payloads)


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
    seen = [name for name in carried.unknown if name in vector.unknowns.places]
    sums = np.zeros((len(seen), len(INERTIAL)))
    rows = [carried.unknown.index(name) for name in seen]
    sums[:, [INERTIAL.index(kind) for kind in carried.summed]] = carried.sums[rows]
    estimates = vector.select(seen)
    freedom = estimates.effective_freedom
    least = None if freedom is None or not seen else float(freedom.min())
    unit = dict(zip(INERTIAL, np.eye(len(INERTIAL)), strict=True))
    stated = [(unit[kind], value) for kind, value in known_values(carried.payload).items()]
    center = zip(FIRST_MOMENTS, carried.payload.center or (), strict=False)
    stated += [(unit[kind] - at * unit["m"], 0.0) for kind, at in center]
    exact = np.reshape([row for row, _ in stated], (len(stated), len(INERTIAL)))
    values = np.array([value for _, value in stated])
    reach = longest_placement(robot)
    return Weighed(robot.tool, sums, estimates.values, estimates.covariance, exact, values, least, reach)
