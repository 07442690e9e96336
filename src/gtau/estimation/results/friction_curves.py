"""The friction step: each joint's friction identified on all samples, at fixed gains and inertial parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from gtau.estimation.diagnostics.parameter_checks import parameter_verdict
from gtau.estimation.estimators.estimator import Fit, jackknife
from gtau.estimation.friction.law import FrictionLaw
from gtau.estimation.friction.normal_equations import FINER, Group, normal_equations, sites_of
from gtau.estimation.friction.selection import (
    KINDS,
    WORDS,
    Trial,
    choose,
    parameter_columns,
    shape_values,
    with_shapes,
)
from gtau.estimation.regression.friction import TEMPERATURE_TERMS, UNITS
from gtau.estimation.results.estimate import Estimate, FrictionCurve, ReferenceTemperatures
from gtau.robots.parameter import Parameter
from gtau.robots.robot import Robot
from gtau.robots.units import position_unit, unit_of

# Standard deviation of the logarithm of a width or speed between those tried, whose columns are interpolated: over 18
# widths and 9 speeds of a simulated UR10e and Puma 560 the rms was this where noise gave a fifth of it.
BETWEEN = {"width": 0.09, "speed": 0.07}


def friction_curves(
    fit: Fit, covariance: np.ndarray
) -> tuple[dict[str, FrictionCurve], dict[str, tuple[float, float]]]:
    """Identify the friction of every joint on all samples.

    Parameters
    ----------
    fit : Fit
        Whose gains and inertial parameters stay as they are.
    covariance : ndarray
        Of (theta, gains, delays), whose share in the friction's standard deviations is that of the torque left to it.

    Returns
    -------
    curves : dict
        Of every joint, by name.
    errors : dict
        By motor, the rms of error and torque over all samples, N m or N.

    Raises
    ------
    GtauError
        Where the closures refuse a sample.
    """
    model, temperatures = fit.dataset.model, reference_temperatures(fit)
    law = FrictionLaw(model, {})
    sites = sites_of(fit.dataset, law)
    found: dict[str, FrictionCurve] = {}
    errors: dict[str, tuple[float, float]] = {}

    def unit(kind: str, joint: str) -> str:
        return friction_unit(kind, joint, model.robot, temperatures)

    of_rows = normal_equations(fit, law, sites)  # behind whose filter errors are stated
    for group, rows in zip(normal_equations(fit, law, sites, FINER), of_rows, strict=True):
        if len(group.G):
            trial, plain, evidence = choose(group)
            found |= curves_of(group, trial, plain, evidence, _fixed(fit, covariance), unit)
            motors = (model.actuated[j] for j in group.motors)
            errors |= dict(zip(motors, _errors(rows, trial), strict=True))
    return {site.joint: found[site.joint] for site in sites if site.joint in found}, errors


def reference_temperatures(fit: Fit) -> ReferenceTemperatures | None:
    """Return the mean temperatures of the runs, None where none were logged."""
    warm = fit.dataset.temperatures
    return None if warm is None else ReferenceTemperatures(warm.unit, warm.reference)


def friction_unit(kind: str, joint: str, robot: Robot, temperatures: ReferenceTemperatures | None) -> str:
    """Return the unit of a joint's friction parameter of a kind; ``width`` is that of presliding, ``vs`` a speed."""
    if kind in ("width", "vs"):
        return position_unit(robot, joint) + ("/s" if kind == "vs" else "")
    of_terms = UNITS[robot.joint(joint).kind]
    if kind not in of_terms:
        return unit_of(kind, robot, joint)
    return of_terms[kind] + (f"/{temperatures.per}" if temperatures and kind in TEMPERATURE_TERMS else "")


def _errors(group: Group, trial: Trial) -> list[tuple[float, float]]:
    """Compute the rms of error and torque of each motor over all its rows."""
    left = np.append(-trial.M @ trial.x, 1.0)
    squares = np.einsum("p,bmpq,q->m", left, group.G, left) / group.weights**2
    counts = np.maximum(group.signals[:, 0], 1)
    rms, signal = np.sqrt(np.maximum(squares, 0.0) / counts), np.sqrt(group.signals[:, 1] / counts)
    return list(zip(rms.tolist(), signal.tolist(), strict=True))


def _fixed(fit: Fit, covariance: np.ndarray) -> np.ndarray:
    """Extract the covariance of gains (n,) and base parameters (n_b,) from that of all; 0 where they are known."""
    problem, names, n = fit.system.problem, fit.dataset.base.names, len(fit.dataset.model.actuated)
    place = {name: k for k, name in enumerate(problem.parameters)}
    # friction of the plain law is not subtracted from the torque, so that its errors do not count
    inertial = [place.get(name, -1) if name.kind not in ("fv", "fs", "off") else -1 for name in names]
    index = np.array([*range(problem.n_theta, problem.n_theta + n), *inertial])
    known = index < 0
    found = covariance[np.ix_(np.maximum(index, 0), np.maximum(index, 0))].copy()
    found[known], found[:, known] = 0.0, 0.0
    return found


def _between_values(group: Group, whole: Trial, A: np.ndarray) -> np.ndarray:
    """Compute the covariance (k, k) due to the grid of widths and speeds, to which other parameters adapt.

    One that is tried stands for all up to half the way to the next.
    """
    found = np.zeros_like(A)
    for k, (s, kind) in enumerate(whole.names):
        if kind in BETWEEN:
            tried, number = shape_values(group, s, kind), whole.structures[s][kind]
            std = np.log(tried[1] / tried[0]) / np.sqrt(12) if number == round(number) else BETWEEN[kind]
            others = np.arange(len(A)) != k
            change = np.ones(len(A))
            change[others] = -np.linalg.lstsq(A[np.ix_(others, others)], A[others, k], rcond=1e-12)[0]
            found += std**2 * np.outer(change, change)
    return found


def curves_of(
    group: Group,
    trial: Trial,
    plain: Trial,
    evidence: Mapping[tuple[int, str], float],
    fixed: np.ndarray,
    unit: Callable[[str, str], str],
) -> dict[str, FrictionCurve]:
    """Estimate the friction of the joints of a group, whose parameters by kind and joint have a ``unit``."""
    whole = with_shapes(group, trial)
    A = np.einsum("pa,pq,qc->ac", whole.M, group.G.sum(axis=(0, 1))[:-1, :-1], whole.M)
    size = np.sqrt(np.maximum(np.diag(A), 1e-300))[:, None]
    S = np.linalg.pinv(A / size / size.T, rcond=1e-9, hermitian=True) @ (whole.M.T @ group.cross / size) / size
    covariance = jackknife(whole.left) + S @ fixed @ S.T + _between_values(group, whole, A)
    places, freedom = {name: k for k, name in enumerate(whole.names)}, float(len(group.G) - 1)
    signal = max(float(group.G[..., -1, -1].sum()), 1e-300)
    error, plain_error = (100 * float(np.sqrt(max(each.errors.sum(), 0.0) / signal)) for each in (trial, plain))

    def estimate(kind: str, joint: str, value: float, std: float | None) -> Estimate:
        name, verdict = Parameter(kind, joint), parameter_verdict(value, std)
        return Estimate(name, value, std, unit(kind, joint), verdict=verdict, freedom=freedom)

    made = {}
    for s, (site, structure) in enumerate(zip(group.sites, trial.structures, strict=True)):
        own = {kind: k for k, (of, kind) in enumerate(trial.names) if of == s}
        values: dict[str, float] = dict.fromkeys(parameter_columns(structure, site), 0.0)
        values |= {kind: float(trial.x[k]) for kind, k in own.items()}
        std: dict[str, float | None] = dict.fromkeys(values)
        std |= {kind: float(np.sqrt(covariance[k, k])) for kind, k in own.items()}
        if "fr" in values:  # friction at rest, and what of it is gone in sliding
            of_excess = np.zeros(len(whole.x))
            for kind, sign in (("fr", 1.0), ("fs", -1.0)):
                if kind in own:
                    of_excess[own[kind]] = sign
            values["fb"] = values.pop("fr") - values["fs"]
            std["fb"] = float(np.sqrt(of_excess @ covariance @ of_excess)) or None
        parameters = {
            Parameter(kind, site.joint): estimate(kind, site.joint, value, std[kind]) for kind, value in values.items()
        }
        shape: dict[str, Estimate] = {}
        for kind, name in (("width", "width"), ("speed", "vs")):
            if (number := structure.get(kind)) is not None:
                tried = shape_values(group, s, kind)
                value, k = float(tried[0] * (tried[1] / tried[0]) ** number), places.get((s, kind))
                spread = None if k is None else value * float(np.sqrt(covariance[k, k]))
                shape[kind] = estimate(name, site.joint, value, spread)
        made[site.joint] = FrictionCurve(
            site.joint,
            parameters,
            shape.get("width"),
            shape.get("speed"),
            {WORDS[kind]: float(evidence[s, kind]) for kind in KINDS if (s, kind) in evidence},
            error,
            plain_error,
        )
    return made
