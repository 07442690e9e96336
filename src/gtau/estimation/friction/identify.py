"""The friction step: each joint's friction identified on all samples, at fixed gains and inertial parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from gtau.estimation.estimators.estimator import Fit, jackknife
from gtau.estimation.friction.law import FrictionLaw, Shape
from gtau.estimation.friction.normal_equations import FINER, Group, normal_equations, sites_of
from gtau.estimation.friction.selection import KINDS, WORDS, Chosen, Trial, choose, shape_values, with_shapes

# Standard deviation of the logarithm of a width or speed between those tried, whose columns are interpolated: over 18
# widths and 9 speeds of a simulated UR10e and Puma 560 the rms was this where noise gave a fifth of it.
BETWEEN = {"width": 0.09, "speed": 0.07}


@dataclass(frozen=True, eq=False)
class IdentifiedFriction:
    """Friction of a joint identified from its logs.

    Attributes
    ----------
    joint : str
        Its name.
    shape : Shape
        Width of presliding and speed of bending.
    spread : Shape
        Their standard deviations.
    values, std : dict
        By kind (``off``, ``fv``, ``fs``, ``fb``, ``fl``, ``fvt``, ``fst``), SI units; one that would be negative is 0.
    freedom : float
        Degrees of freedom behind the standard deviations.
    evidence : dict
        Of each term taken (``presliding``, ``bent``, ``load``, ``temperature``): by how many standard errors blocks
        that were left out are better for it.
    error, plain_error : float
        Of blocks left out, with this friction and with the plain law, rms over the rms torque left to friction; of all
        joints that share motors.
    """

    joint: str
    shape: Shape
    spread: Shape
    values: Mapping[str, float]
    std: Mapping[str, float | None]
    freedom: float
    evidence: Mapping[str, float]
    error: float
    plain_error: float


@dataclass(frozen=True)
class FrictionStep:
    """The friction of every ``joint``, and by motor the rms ``errors`` and torque over all samples, N m or N."""

    joints: tuple[IdentifiedFriction, ...] = ()
    errors: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def identify_friction(fit: Fit, covariance: np.ndarray) -> FrictionStep:
    """Identify the friction of every joint on all samples.

    Parameters
    ----------
    fit : Fit
        Whose gains and inertial parameters stay as they are.
    covariance : ndarray
        Of (theta, gains, delays), whose share in the friction's standard deviations is that of the torque left to it.

    Raises
    ------
    GtauError
        Where the closures refuse a sample.
    """
    law = FrictionLaw(fit.dataset.model, {})
    sites = sites_of(fit.dataset, law)
    found: list[IdentifiedFriction] = []
    errors: dict[str, tuple[float, float]] = {}
    of_rows = normal_equations(fit, law, sites)  # behind whose filter errors are stated
    for group, rows in zip(normal_equations(fit, law, sites, FINER), of_rows, strict=True):
        if len(group.G):
            chosen = choose(group)
            found += _of_group(group, chosen, _fixed(fit, covariance))
            motors = (fit.dataset.model.actuated[j] for j in group.motors)
            errors |= dict(zip(motors, _errors(rows, chosen.trial), strict=True))
    order = {site.joint: k for k, site in enumerate(sites)}
    return FrictionStep(tuple(sorted(found, key=lambda each: order[each.joint])), errors)


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
    inertial = [place.get(name, -1) if name.split("_")[0] not in ("fv", "fs", "off") else -1 for name in names]
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
            tried, number = shape_values(group, s, kind), getattr(whole.structures[s], kind)
            std = np.log(tried[1] / tried[0]) / np.sqrt(12) if number == round(number) else BETWEEN[kind]
            others = np.arange(len(A)) != k
            change = np.ones(len(A))
            change[others] = -np.linalg.lstsq(A[np.ix_(others, others)], A[others, k], rcond=1e-12)[0]
            found += std**2 * np.outer(change, change)
    return found


def _of_group(group: Group, chosen: Chosen, fixed: np.ndarray) -> list[IdentifiedFriction]:
    trial, whole = chosen.trial, with_shapes(group, chosen.trial)
    A = np.einsum("pa,pq,qc->ac", whole.M, group.G.sum(axis=(0, 1))[:-1, :-1], whole.M)
    size = np.sqrt(np.maximum(np.diag(A), 1e-300))[:, None]
    S = np.linalg.pinv(A / size / size.T, rcond=1e-9, hermitian=True) @ (whole.M.T @ group.cross / size) / size
    covariance = jackknife(whole.left) + S @ fixed @ S.T + _between_values(group, whole, A)
    places = {name: k for k, name in enumerate(whole.names)}
    signal = max(float(group.G[..., -1, -1].sum()), 1e-300)
    error, plain = (float(np.sqrt(max(each.errors.sum(), 0.0) / signal)) for each in (trial, chosen.plain))
    made = []
    for s, (site, structure) in enumerate(zip(group.sites, trial.structures, strict=True)):
        own = {kind: k for k, (of, kind) in enumerate(trial.names) if of == s}
        values: dict[str, float] = dict.fromkeys(structure.columns(site), 0.0)
        values |= {kind: float(trial.x[k]) for kind, k in own.items()}
        std: dict[str, float | None] = dict.fromkeys(values)
        std |= {kind: float(np.sqrt(covariance[k, k])) for kind, k in own.items()}
        if "fr" in values:  # friction at rest, and what of it is gone in sliding
            unit = np.zeros(len(whole.x))
            for kind, sign in (("fr", 1.0), ("fs", -1.0)):
                if kind in own:
                    unit[own[kind]] = sign
            values["fb"], std["fb"] = values.pop("fr") - values["fs"], float(np.sqrt(unit @ covariance @ unit)) or None
            del std["fr"]
        shape: dict[str, float] = {}
        spread: dict[str, float] = {}
        for kind in ("width", "speed"):
            if (number := getattr(structure, kind)) is not None:
                tried = shape_values(group, s, kind)
                shape[kind] = float(tried[0] * (tried[1] / tried[0]) ** number)
                if (s, kind) in places:
                    k = places[s, kind]
                    spread[kind] = shape[kind] * float(np.sqrt(covariance[k, k]))
        evidence = {WORDS[kind]: chosen.evidence[s, kind] for kind in KINDS if (s, kind) in chosen.evidence}
        shapes, freedom = (Shape(**shape), Shape(**spread)), float(len(group.G) - 1)
        made.append(IdentifiedFriction(site.joint, *shapes, values, std, freedom, evidence, error, plain))
    return made
