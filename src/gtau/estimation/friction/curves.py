"""The friction step: each joint's friction identified on all samples, at fixed gains and inertial parameters."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import NonNegativeFloat

from gtau.estimation.estimators.estimator import Fit, jackknife
from gtau.estimation.estimators.maximum_likelihood import CONVERGED, PASSES, TUNING, robust_sigma, sandwich_factor
from gtau.estimation.friction.law import FrictionLaw
from gtau.estimation.friction.normal_equations import (
    FINER,
    FrictionGroup,
    FrictionJoint,
    friction_joints,
    normal_equations,
)
from gtau.estimation.friction.selection import (
    SHAPE_OF,
    WORDS,
    FrictionFit,
    choose,
    parameter_columns,
    place,
    with_shapes,
)
from gtau.estimation.regression.problem import Estimates
from gtau.robots.parameter import TEMPERATURE_TERMS, Parameter, unit_of
from gtau.robots.robot import PLAIN_FRICTION, Robot

# Standard deviation of the logarithm of a width or speed between those tried, whose columns are interpolated: over 18
# widths and 9 speeds of a simulated UR10e and Puma 560 the rms was this where noise gave a fifth of it.
BETWEEN = {"width": 0.09, "speed": 0.07}


@dataclass(frozen=True)
class FrictionCurve:
    """What the data say of the friction of a joint on all samples; see :mod:`gtau.estimation.friction.law`.

    ``evidence`` says by how many standard errors blocks left out are better for ``presliding``, ``bent``, ``load`` and
    ``temperature``; ``error`` and ``plain_error`` are of blocks left out, with this friction and with the plain law,
    per cent of the torque that is left to friction.
    """

    joint: str
    evidence: Mapping[str, float]
    error: NonNegativeFloat
    plain_error: NonNegativeFloat


@dataclass(frozen=True)
class ReferenceTemperatures:
    """Mean temperatures over the runs, by joint, at which friction has its values; ``unit`` of the log."""

    unit: str
    of_joint: Mapping[str, float]

    @property
    def per(self) -> str:
        """Unit of a difference, by which the slopes of friction are divided."""
        return "K" if self.unit == "degC" else self.unit


def friction_step(
    fit: Fit, estimates: Estimates
) -> tuple[Estimates, dict[str, FrictionCurve], dict[str, tuple[float, float]]]:
    """Identify the friction of every joint on all samples; gains and inertial parameters of the fit stay as they are.

    The new friction replaces the friction of the ``estimates``; their covariance enters its covariance through the
    torque left to friction. Returns the updated estimates, without the terms of the equations that the curves replace;
    the curve of each joint (without curves the plain law predicts); and for each motor the rms error and torque over
    all samples, N m or N. Raises GtauError.
    """
    law, base = FrictionLaw(fit.dataset.model, {}), fit.dataset.base
    joints = friction_joints(fit.dataset, law, fit.system.unexcited)
    if not joints:
        return estimates, {}, {}
    name_of = dict(zip(base.standard, base.names, strict=True))
    curves: dict[str, FrictionCurve] = {}
    names_of_curves: list[Parameter] = []
    errors: dict[str, tuple[float, float]] = {}
    fixed = _fixed(fit, estimates, {joint.name for joint in joints})
    groups = _on_all_samples(fit, joints)
    choices = [choose(group) for group in groups]
    mixes: dict[FrictionJoint, np.ndarray] = {}
    for group, (candidate, _, _) in zip(groups, choices, strict=True):
        ends = np.cumsum([joint.count for joint in group.joints])
        mixes |= dict(zip(group.joints, np.split(_error(candidate), ends), strict=False))
    filtered = normal_equations(fit, joints, mixes=mixes)  # errors are stated behind the filter of these rows
    for group, (candidate, plain, evidence), rows in zip(groups, choices, filtered, strict=True):
        names, values, slopes, scatter = group_estimates(group, candidate)
        unknowns = [name_of.get(name, name) for name in names]
        more = len(estimates.unknowns) - fixed.shape[1]  # were appended since
        slopes = np.pad(slopes @ fixed, ((0, 0), (0, more)))
        estimates = estimates.updated(unknowns, values, slopes, scatter, float(len(group.G) - 1))
        names_of_curves += unknowns
        curves |= _curves(group, candidate, plain, evidence)
        motors = (fit.dataset.model.actuated[j] for j in group.motors)
        errors |= dict(zip(motors, _errors(rows), strict=True))
    replaced = set(fit.system.terms).difference(names_of_curves)
    estimates = estimates.select([name for name in estimates.unknowns if name not in replaced])
    return estimates, {joint.name: curves[joint.name] for joint in joints}, errors


def _on_all_samples(fit: Fit, joints: Sequence[FrictionJoint]) -> tuple[FrictionGroup, ...]:
    """Reduce all samples, with Huber's weights until the friction they lead to settles if the fit has weighted rows."""
    groups, before = normal_equations(fit, joints, FINER), None
    if fit.unweighted is None:
        return groups
    limits = [np.full(len(group.motors), TUNING) for group in groups]
    for _ in range(PASSES):
        errors = [_error(choose(group)[0]) for group in groups]
        if before is not None and np.allclose(np.hstack(errors), before, rtol=CONVERGED, atol=0):
            break
        before = np.hstack(errors)
        groups = normal_equations(fit, joints, FINER, list(zip(errors, limits, strict=True)))
        limits = [TUNING * robust_sigma([group.residuals]) for group in groups]
    return groups


def _error(candidate: FrictionFit) -> np.ndarray:
    """Return the coefficients (p + 1,) that combine the columns and the torque to the residual."""
    return np.append(-candidate.M @ candidate.x, 1.0)


def reference_temperatures(fit: Fit) -> ReferenceTemperatures | None:
    """Return the mean temperatures of the runs, None where none were logged."""
    warm = fit.dataset.temperatures
    return None if warm is None else ReferenceTemperatures(warm.unit, warm.reference)


def friction_unit(name: Parameter, robot: Robot, temperatures: ReferenceTemperatures | None) -> str:
    """Return the unit of a friction parameter, of a temperature slope per unit of the temperature."""
    per_temperature = f"/{temperatures.per}" if temperatures and name.kind in TEMPERATURE_TERMS else ""
    return unit_of(name.kind, robot, name.body) + per_temperature


def _errors(group: FrictionGroup) -> list[tuple[float, float]]:
    """Compute rms errors and torques of the motors; the columns of a group are what each joint takes of the torque."""
    squares = np.maximum(group.G.sum(axis=(0, 2, 3)) / group.weights**2, 0.0)
    rms = np.sqrt(np.stack([squares, group.signals[:, 1]]) / np.maximum(group.signals[:, 0], 1))
    return list(zip(*rms.tolist(), strict=True))


def _fixed(fit: Fit, estimates: Estimates, joints: Collection[str]) -> np.ndarray:
    """Select gains and base parameters (n + n_b, k) of all estimates, but for friction of the ``joints``."""
    dataset = fit.dataset
    gains = (Parameter("gain", joint) for joint in dataset.model.actuated)
    subtracted = (name.kind not in PLAIN_FRICTION or name.body not in joints for name in dataset.base.names)
    names = [*gains, *(name if kept else None for name, kept in zip(dataset.base.names, subtracted, strict=True))]
    return np.array([[float(name == unknown) for unknown in estimates.unknowns] for name in names])


def _between_values(group: FrictionGroup, shaped: FrictionFit, A: np.ndarray) -> np.ndarray:
    """Compute the covariance (k, k) due to the grid: a tried value stands for half the way to the next."""
    covariance = np.zeros_like(A)
    for k, (s, term) in enumerate(shaped.names):
        if term in BETWEEN:
            tried = group.joints[s].tried(term)
            between = place(getattr(shaped.structures[s], term), tried) % 1 > 0
            std = BETWEEN[term] if between else np.log(tried[1] / tried[0]) / np.sqrt(12)
            others = np.arange(len(A)) != k
            change = np.ones(len(A))
            change[others] = -np.linalg.lstsq(A[np.ix_(others, others)], A[others, k], rcond=1e-12)[0]
            covariance += std**2 * np.outer(change, change)
    return covariance


def group_estimates(
    group: FrictionGroup, candidate: FrictionFit
) -> tuple[list[Parameter], np.ndarray, np.ndarray, np.ndarray]:
    """Estimate the friction of the joints of a group: names, values, slopes and scatter.

    Names are the friction parameters that each joint has, values (m,) are zero where they would be negative, slopes (m,
    gains and base parameters) derivatives by these, and the scatter (m, m) is the covariance at given ones.
    """
    shaped = with_shapes(group, candidate)
    A = np.einsum("pa,pq,qc->ac", shaped.M, group.G.sum(axis=(0, 1))[:-1, :-1], shaped.M)
    size = np.sqrt(np.maximum(np.diag(A), 1e-300))[:, None]
    S = np.linalg.pinv(A / size / size.T, rcond=1e-9, hermitian=True) @ (shaped.M.T @ group.cross / size) / size
    factor = sandwich_factor([group.residuals]) if group.residuals.size else 1.0
    covariance = factor**2 * jackknife(shaped.replicates) + _between_values(group, shaped, A)
    made: dict[Parameter, tuple[float, dict[tuple[int, str], float]]] = {}  # values, and their derivatives
    x = dict(zip(candidate.names, candidate.x.tolist(), strict=True))
    for s, (joint, structure) in enumerate(zip(group.joints, candidate.structures, strict=True)):
        for kind in parameter_columns(structure, joint):
            if kind == "fr":  # friction at rest: fb is what of it is gone in sliding
                excess = x.get((s, "fr"), 0.0) - x.get((s, "fs"), 0.0)
                made[Parameter("fb", joint.name)] = excess, {(s, "fr"): 1.0, (s, "fs"): -1.0}
            else:
                made[Parameter(kind, joint.name)] = x.get((s, kind), 0.0), {(s, kind): 1.0}
        for term, shape in SHAPE_OF.items():
            if (value := getattr(structure, term)) is not None:
                made[Parameter(shape, joint.name)] = value, {(s, term): value}  # its logarithm is estimated
    T = np.zeros((len(made), len(shaped.names)))
    for row, (_, factors) in zip(T, made.values(), strict=True):
        row[:] = [factors.get(name, 0.0) for name in shaped.names]
    return list(made), np.array([value for value, _ in made.values()]), T @ S, T @ covariance @ T.T


def _curves(
    group: FrictionGroup, candidate: FrictionFit, plain: FrictionFit, evidence: Mapping[tuple[int, str], float]
) -> dict[str, FrictionCurve]:
    signal = max(float(group.G[..., -1, -1].sum()), 1e-300)
    squares = (max(law.errors.sum(), 0.0) for law in (candidate, plain))
    error, plain_error = (100 * float(np.sqrt(square / signal)) for square in squares)
    return {
        joint.name: FrictionCurve(
            joint.name,
            {word: float(evidence[s, term]) for term, word in WORDS.items() if (s, term) in evidence},
            error,
            plain_error,
        )
        for s, joint in enumerate(group.joints)
    }
