"""Build a result: estimates with names, units, standard deviations and verdicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from gtau.estimation.diagnostics.alternatives import Alternative
from gtau.estimation.diagnostics.diagnose import Diagnosis
from gtau.estimation.diagnostics.examine import Examination, Uncertainty
from gtau.estimation.diagnostics.inertia_audit import InertiaAudit
from gtau.estimation.diagnostics.parameter_checks import judge_parameter
from gtau.estimation.diagnostics.stated_constants import scale_shares, sensor_verdict
from gtau.estimation.diagnostics.verdict import Outcome
from gtau.estimation.estimators.estimator import Estimator, Fit
from gtau.estimation.estimators.newton import residuals, stacked
from gtau.estimation.estimators.physical_consistency import Consistency
from gtau.estimation.regression.equations import triangle
from gtau.estimation.regression.friction import BEARING
from gtau.estimation.regression.problem import Problem
from gtau.estimation.regression.system import System
from gtau.estimation.results.estimate import (
    AlternativeMoves,
    Estimate,
    FrictionCurve,
    SensorEstimate,
    TorqueError,
    distances_of,
    nearest_poses,
)
from gtau.estimation.results.friction_curves import friction_unit, reference_temperatures
from gtau.estimation.results.payload import named_estimates, payload_estimates
from gtau.estimation.results.result import Result
from gtau.robots.parameter import Parameter
from gtau.robots.robot import Robot
from gtau.robots.units import gain_unit, torque_unit, unit_of


def build_result(
    fit: Fit,
    estimator: Estimator,
    examined: Examination,
    uncertainty: Uncertainty,
    essential: Problem,
    loss: float,
    diagnosis: Diagnosis,
    curves: Mapping[str, FrictionCurve],
    errors: Mapping[str, tuple[float, float]],
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
    uncertainty : Uncertainty
        Covariances of (theta, gains, delays), and the degrees of freedom behind them.
    essential, loss : Problem, float
        From :func:`gtau.estimation.estimators.essential.essential_fit`.
    diagnosis : Diagnosis
        What can be believed.
    curves, errors : mappings
        Friction on all samples; see :func:`friction_curves`. Empty where the plain law is to predict.
    consistency : Consistency, optional
        Physically consistent standard parameters.
    audit : InertiaAudit, optional
        What the data say of the inertias of the robot's file.
    """
    dataset, system, solution = fit.dataset, fit.system, fit.solution
    covariance, freedom = uncertainty.covariance, uncertainty.effective_freedom
    robot, problem, joints, base = dataset.robot, system.problem, dataset.model.actuated, dataset.base
    n_theta, n = problem.n_theta, len(problem.channels)
    named = [*range(n_theta), *range(n_theta, n_theta + len(joints)), *range(n_theta + n, n_theta + 2 * n)]
    std, model_std = (np.sqrt(np.diag(each)) for each in (covariance, uncertainty.model))
    gain_std = std[n_theta : n_theta + n]
    along = [
        (prepared, dataset.preparation.at(prepared.run.rate).decimator, factors.distances)
        for prepared, factors in zip(dataset.prepared, dataset.factors, strict=True)
        if factors.distances is not None
    ]
    found, total = named_estimates(problem, solution.theta, std, freedom), _total(problem, solution.sigma)
    spread = _spread(system, solution.theta)
    model_part = {name: min(float(model_std[k]), float(std[k])) for k, name in enumerate(problem.parameters)}

    def parameter(name: Parameter) -> Estimate:
        each, regrouping = found.get(name, Estimate(name, None, None, "")), base.regroupings[name]
        return replace(
            each,
            unit=unit_of(name.kind, robot, name.body),
            regrouping=regrouping,
            spread=spread.get(name),
            verdict=judge_parameter(each.value, each.std, regrouping),
            model_std=model_part.get(name),
            essential=name in essential.parameters,
        )

    delays = [
        Estimate(
            channel.joint,
            float(solution.delays[k]),
            # none where the value is not identifiable or given
            None if verdict.outcome == Outcome.NOT_IDENTIFIABLE else float(std[n_theta + n + k]) or None,
            "s",
            verdict=verdict,
            freedom=None if freedom is None else float(freedom[n_theta + n + k]),
        )
        for k, (channel, verdict) in enumerate(zip(problem.channels, diagnosis.delays, strict=True))
    ]
    scales, (sigma, signal) = scale_shares(fit) if fit.free_gains else {}, _levels(fit)
    temperatures = reference_temperatures(fit)
    return Result(
        robot=robot,
        method=estimator.name,
        kind=dataset.runs[0].kind,
        drive_gains={
            joint: Estimate(
                joint,
                float(solution.gains[k]),
                float(gain_std[k]) if gain_std.any() else None,
                gain_unit(robot, joint, dataset.runs[0].kind),
                verdict=diagnosis.gains[joint],
                freedom=None if freedom is None else float(freedom[n_theta + k]),
                model_std=float(model_std[n_theta + k]) if gain_std.any() else None,
                scale={source: float(share[k]) for source, share in scales.items()},
            )
            for k, joint in enumerate(joints)
            if joint in robot.motors
        },
        delays=dict(zip(joints, delays, strict=False)),
        parameters={name: parameter(name) for name in base.names},
        friction={
            term: replace(found[term], unit=friction_unit(term.kind, term.body, robot, temperatures))
            for term in system.friction.terms
            if term in found
        },
        curves=curves,
        sensors=_sensors(fit, diagnosis, found, delays),
        payloads=payload_estimates(dataset, system, solution.theta, covariance, diagnosis.payloads, freedom),
        residuals=tuple(
            TorqueError(
                joint,
                float(abs(solution.gains[k]) * sigma[k]),
                float(abs(solution.gains[k]) * signal[k]),
                torque_unit(robot, joint),
                *errors.get(joint, ()),
            )
            for k, joint in enumerate(joints)
        ),
        covariance_names=(
            *problem.parameters,
            *(Parameter("gain", joint) for joint in joints),
            *(Parameter("delay", channel.name) for channel in problem.channels),
        ),
        covariance=covariance[np.ix_(named, named)],
        preparation=dataset.preparation,
        logged_speeds=_logged_speeds(fit),
        statistics={
            **solution.statistics,
            "reduction_loss": loss,
            "lack_of_fit": examined.lack_of_fit,
            "accuracy": float(diagnosis.accuracy),
            "condition_number": _condition_number(total),
        },
        temperatures=temperatures,
        runs=tuple(run.name for run in dataset.runs),
        notes=(*dataset.notes, *diagnosis.notes),
        consistency=consistency,
        audit=audit,
        alternatives=tuple(_moves(each, robot) for each in examined.alternatives),
        singularities=tuple(nearest for run in along for nearest in nearest_poses(*run)),
        distances=tuple(distances_of(*run) for run in along),
        data=dataset.runs,
        known=(dataset.model, base),
        singular_values=tuple(np.linalg.svd(_scaled(total), compute_uv=False).tolist()) if gain_std.any() else (),
    )


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


def _moves(each: Alternative, robot: Robot) -> AlternativeMoves:
    return AlternativeMoves(
        each.hypothesis,
        each.causes,
        each.size,
        each.std if np.isfinite(each.std) else None,
        each.unit,
        each.probability,
        each.share,
        {
            joint: 100 * float(move)
            for joint, move in zip(robot.actuated, each.moves, strict=True)
            if joint in robot.motors
        },
    )


def _levels(fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Compute rms residual and rms signal of each channel, (c,), over rows that all count alike."""
    sigma, state, problem = fit.solution.sigma, fit.solution.iterate, fit.unweighted or fit.system.problem
    if fit.unweighted is not None:
        squares = [np.sum(residuals(stacked(each), state) ** 2, axis=-1) for each in (fit.system.problem, problem)]
        sigma = sigma * np.sqrt(squares[1] / np.maximum(squares[0], 1e-300))
    return sigma, problem.balance(state.theta)


def _sensors(
    fit: Fit, diagnosis: Diagnosis, found: Mapping[Parameter, Estimate], delays: Sequence[Estimate]
) -> tuple[SensorEstimate, ...]:
    """Collect the estimates of the own parameters of sensors behind the drives."""
    robot, problem, sensors, (sigma, signal) = fit.dataset.robot, fit.system.problem, [], _levels(fit)
    for k in problem.sensor_channels:
        channel, joint = problem.channels[k], problem.channels[k].joint
        own = {
            name: replace(found[name], unit=unit_of(kind, robot, joint))
            for kind in ("off", *BEARING)
            if (name := Parameter(kind, channel.name)) in found
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
