"""Build a result: estimates with names, units, standard deviations and verdicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gtau.estimation.diagnostics.diagnose import Diagnosis
from gtau.estimation.diagnostics.examine import Examination
from gtau.estimation.diagnostics.inertia_audit import InertiaAudit
from gtau.estimation.diagnostics.stated_constants import scale_shares, sensor_verdict
from gtau.estimation.diagnostics.verdict import Outcome, Verdict, judge_parameter, parameter_verdict
from gtau.estimation.estimators.estimates import Estimates
from gtau.estimation.estimators.estimator import Estimator, Fit
from gtau.estimation.estimators.newton import residuals, stacked
from gtau.estimation.estimators.physical_consistency import Consistency
from gtau.estimation.regression.equations import triangle
from gtau.estimation.regression.friction import BEARING
from gtau.estimation.regression.problem import Problem
from gtau.estimation.regression.system import System
from gtau.estimation.results.estimate import (
    Estimate,
    Named,
    SensorEstimate,
    TorqueError,
    distances_of,
    nearest_poses,
)
from gtau.estimation.results.friction_curves import FrictionStep, friction_unit, reference_temperatures
from gtau.estimation.results.groups import Evidence, FitRecord, Model, ModelEstimates
from gtau.estimation.results.payload import payload_estimates
from gtau.estimation.results.result import Result
from gtau.model.base_parameters import regrouped
from gtau.robots.parameter import Parameter, gain_unit, torque_unit, unit_of


def build_result(
    fit: Fit,
    estimator: Estimator,
    examined: Examination,
    estimates: Estimates,
    essential: Problem,
    loss: float,
    diagnosis: Diagnosis,
    friction: FrictionStep,
    consistency: Consistency | None = None,
    audit: InertiaAudit | None = None,
) -> Result:
    """Build the result of an identification.

    Parameters
    ----------
    fit, estimator : Fit, Estimator
        The estimates with all base parameters, and what made them.
    examined : Examination
        What the data say against the model.
    estimates : Estimates
        Of the equations.
    essential, loss : Problem, float
        From :func:`gtau.estimation.estimators.essential.essential_fit`.
    diagnosis : Diagnosis
        What can be believed.
    friction : FrictionStep
        Friction on all samples; without curves the plain law predicts.
    consistency : Consistency, optional
        Physically consistent standard parameters.
    audit : InertiaAudit, optional
        What the data say of the inertias of the robot's file.
    """
    return Result(
        Model(fit.dataset.robot, (), (fit.dataset.model, fit.dataset.base)),
        _estimates(fit, estimates, friction, diagnosis, essential, consistency),
        _fit_record(fit, estimator, estimates, examined, diagnosis, friction, loss),
        _evidence(fit, estimates, examined, diagnosis, friction, audit),
    )


def _estimates(
    fit: Fit,
    estimates: Estimates,
    friction: FrictionStep,
    diagnosis: Diagnosis,
    essential: Problem,
    consistency: Consistency | None,
) -> ModelEstimates:
    """Collect the estimates with which the model predicts."""
    dataset, problem, vector, terms = fit.dataset, fit.system.problem, friction.estimates, fit.system.friction.terms
    temperatures, base_names = reference_temperatures(fit), set(dataset.base.names)
    delays = [
        _estimate(vector, Parameter("delay", channel.name), "s", channel.joint, verdict)
        for channel, verdict in zip(problem.channels, diagnosis.delays, strict=True)
    ]
    sensors = {channel.name for channel in problem.channels if channel.kind.link_side}
    given = {Parameter("gain", sensor) for sensor in sensors}
    if friction.curves:  # terms of the equations that predict nothing
        given |= set(terms) - set(friction.names)
    listed = sorted((name for name in vector.unknowns if name not in given), key=_group)
    predicting = [name for name in (friction.names if friction.curves else terms) if name.body not in sensors]
    return ModelEstimates(
        drive_gains=Named(_gains(fit, vector, diagnosis)),
        delays=Named(zip(dataset.model.actuated, delays, strict=False)),
        parameters=Named(_parameters(fit, vector, essential)),
        friction=Named(
            (name, _estimate(vector, name, friction_unit(name.kind, name.body, dataset.robot, temperatures)))
            for name in predicting
            if name in vector.places and name not in base_names
        ),
        payloads=payload_estimates(
            dataset,
            fit.system,
            fit.solution.theta,
            estimates.covariance,
            diagnosis.payloads,
            estimates.effective_freedom,
        ),
        covariance_names=tuple(listed),
        covariance=vector.select(listed).covariance,
        sensors=_sensors(fit, diagnosis, vector, delays),
        temperatures=temperatures,
        consistency=consistency,
    )


def _fit_record(
    fit: Fit,
    estimator: Estimator,
    estimates: Estimates,
    examined: Examination,
    diagnosis: Diagnosis,
    friction: FrictionStep,
    loss: float,
) -> FitRecord:
    """Record how the estimates were fitted."""
    dataset, solution = fit.dataset, fit.solution
    total, (sigma, signal) = _total(fit.system.problem, solution.sigma), _levels(fit)
    return FitRecord(
        method=estimator.name,
        kind=dataset.runs[0].kind,
        runs=tuple(run.name for run in dataset.runs),
        preparation=dataset.preparation,
        residuals=tuple(
            TorqueError(
                joint,
                float(abs(solution.gains[k]) * sigma[k]),
                float(abs(solution.gains[k]) * signal[k]),
                torque_unit(dataset.robot, joint),
                *friction.errors.get(joint, ()),
            )
            for k, joint in enumerate(dataset.model.actuated)
        ),
        logged_speeds=_logged_speeds(fit),
        statistics={
            **solution.statistics,
            "reduction_loss": loss,
            "lack_of_fit": examined.lack_of_fit,
            "accuracy": float(diagnosis.accuracy),
            "condition_number": _condition_number(total),
        },
        singular_values=tuple(np.linalg.svd(_scaled(total), compute_uv=False).tolist()) if fit.free_gains else (),
        data=dataset.runs,
    )


def _evidence(
    fit: Fit,
    estimates: Estimates,
    examined: Examination,
    diagnosis: Diagnosis,
    friction: FrictionStep,
    audit: InertiaAudit | None,
) -> Evidence:
    """Collect what speaks for and against the estimates."""
    dataset, temperatures = fit.dataset, reference_temperatures(fit)
    replaced = {*friction.names, *fit.system.friction.terms} if friction.curves else set()
    along = [
        (prepared, dataset.preparation.at(prepared.run.rate).decimator, factors.distances)
        for prepared, factors in zip(dataset.prepared, dataset.factors, strict=True)
        if factors.distances is not None
    ]
    return Evidence(
        notes=(*dataset.notes, *diagnosis.notes),
        alternatives=examined.alternatives,
        curves=friction.curves,
        equation_friction=Named(
            (name, _estimate(estimates, name, friction_unit(name.kind, name.body, dataset.robot, temperatures)))
            for name in fit.system.problem.parameters
            if name in replaced
        ),
        audit=audit,
        singularities=tuple(nearest for run in along for nearest in nearest_poses(*run)),
        distances=tuple(distances_of(*run) for run in along),
    )


def _group(name: Parameter) -> int:
    """Order estimates in the covariance: parameters, then gains, then delays."""
    return {"gain": 1, "delay": 2}.get(name.kind, 0)


def _estimate(
    vector: Estimates, name: Parameter, unit: str, called: str = "", verdict: Verdict | None = None
) -> Estimate:
    """Make the estimate of an unknown, by default under its own name and judged by its standard deviation.

    One that is given, or whose value the data do not determine, has no standard deviation.
    """
    k = vector.places[name]
    value, std = float(vector.values[k]), float(np.sqrt(vector.covariance[k, k])) or None
    freedom = None if vector.effective_freedom is None else float(vector.effective_freedom[k])
    judged = verdict or parameter_verdict(value, std)
    if name.kind == "delay" and judged.outcome == Outcome.NOT_IDENTIFIABLE:
        std = None
    model_std = None if std is None else min(float(np.sqrt(vector.model[k, k])), std)
    return Estimate(called or name, value, std, unit, verdict=judged, freedom=freedom, model_std=model_std)


def _gains(fit: Fit, vector: Estimates, diagnosis: Diagnosis) -> dict[str, Estimate]:
    """Collect the drive gains of the motors, with the sources of their scale."""
    robot, kind = fit.dataset.robot, fit.dataset.runs[0].kind
    scales = scale_shares(fit) if fit.free_gains else {}
    return {
        joint: replace(
            _estimate(vector, Parameter("gain", joint), gain_unit(robot, joint, kind), joint, diagnosis.gains[joint]),
            scale={source: float(share[k]) for source, share in scales.items()},
        )
        for k, joint in enumerate(fit.dataset.model.actuated)
        if joint in robot.motors
    }


def _parameters(fit: Fit, vector: Estimates, essential: Problem) -> dict[Parameter, Estimate]:
    """Collect the base parameters, those without a value included."""
    base, robot, spread = fit.dataset.base, fit.dataset.robot, _spread(fit.system, fit.solution.theta)
    found = {}
    for name, terms in regrouped(base, fit.dataset.model.parameter_names).items():
        unit = unit_of(name.kind, robot, name.body)
        made = _estimate(vector, name, unit) if name in vector.places else Estimate(name, None, None, unit)
        found[name] = replace(
            made,
            regrouping=base.regroupings[name],
            spread=spread.get(name),
            verdict=judge_parameter(made.value, made.std, terms),
            essential=name in essential.parameters,
        )
    return found


def _condition_number(total: np.ndarray) -> float:
    """Compute the condition number of the estimated columns of ``W_tot``, scaled to unit length."""
    estimated = _scaled(total[:, :-1])
    return float(np.linalg.cond(estimated)) if estimated.size else 1.0


def _scaled(W: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(W, axis=0)
    return np.asarray(W[:, length > 0] / length[length > 0])


def _total(problem: Problem, sigma: np.ndarray) -> np.ndarray:
    """Build the triangular factor of ``W_tot`` (eq. 33), rows weighted by ``sigma`` (n,)."""
    weights = 1 / np.maximum(sigma, problem.smallest_sigma)
    known = np.zeros((len(problem.known), problem.n_theta + len(problem.channels) + 1))
    known[:, : problem.n_theta], known[:, -1] = -problem.known[:, :-1], problem.known[:, -1]
    rows = (problem.total_rows_of(R, j) * weights[j] for j, R in enumerate(problem.triangles))
    return triangle(*rows, known)


def _logged_speeds(fit: Fit) -> dict[str, float]:
    """Find the largest speed of each actuated joint among the rows of all runs."""
    found = [factors.speeds.max(axis=0) for factors in fit.dataset.factors if factors.speeds is not None]
    largest = np.max(found, axis=0) if found else np.zeros(len(fit.dataset.model.actuated))
    return dict(zip(fit.dataset.model.actuated, map(float, largest), strict=True))


def _levels(fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Compute rms residual and rms signal of each channel, (c,), over rows that all count alike."""
    sigma, state, problem = fit.solution.sigma, fit.solution.iterate, fit.unweighted or fit.system.problem
    if fit.unweighted is not None:
        squares = [np.sum(residuals(stacked(each), state) ** 2, axis=-1) for each in (fit.system.problem, problem)]
        sigma = sigma * np.sqrt(squares[1] / np.maximum(squares[0], 1e-300))
    return sigma, problem.balance(state.theta)


def _sensors(
    fit: Fit, diagnosis: Diagnosis, vector: Estimates, delays: Sequence[Estimate]
) -> tuple[SensorEstimate, ...]:
    """Collect the estimates of the own parameters of sensors behind the drives."""
    robot, problem, sensors, (sigma, signal) = fit.dataset.robot, fit.system.problem, [], _levels(fit)
    for k in problem.sensor_channels:
        channel, joint = problem.channels[k], problem.channels[k].joint
        own = {
            name: _estimate(vector, name, unit_of(kind, robot, joint))
            for kind in ("off", *BEARING)
            if (name := Parameter(kind, channel.name)) in vector.places
        }
        residual = TorqueError(joint, float(sigma[k]), float(signal[k]), torque_unit(robot, joint))
        scale = next((each for each in diagnosis.sensors if each.channel == channel), None)
        ratio = None
        if scale is not None:
            ratio = Estimate(joint, scale.value, scale.std, "1", verdict=sensor_verdict(scale, diagnosis.accuracy))
        sensors.append(SensorEstimate(joint, own, delays[k], residual, ratio, channel.kind))
    return tuple(sensors)


def _spread(system: System, theta: np.ndarray) -> dict[str, float]:
    """Compute the standard deviation between runs of each friction parameter that may drift."""
    differences: dict[str, list[float]] = {}
    for name, value in zip(system.problem.parameters, theta, strict=True):
        if name.run is not None:
            differences.setdefault(Parameter(name.kind, name.body), []).append(float(value))
    # the differences of all runs add up to zero, and the last is not listed
    return {name: float(np.std([*each, -sum(each)], ddof=1)) for name, each in differences.items()}
