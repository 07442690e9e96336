"""Samples of the identified distribution: models as far apart as the data allow, each physically consistent.

Parameters, drive gains and delays are drawn together, with the correlations of the result's covariance and, each by
itself, the distribution of its interval (Student's t). An inconsistent draw is moved to the nearest consistent one,
with distances in standard deviations (as in
:mod:`gtau.estimation.estimators.physical_consistency`). Parameters without effect on any motor are unchanged.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.estimators.standard_parameters import Body, constrained_least_squares, natural_size, within_reach
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.result import Result
from gtau.export.consistent import PLAIN, consistent_model
from gtau.robots.geometry import characteristic_length
from gtau.robots.parameter import Parameter
from gtau.robots.robot import DAMPING, INERTIAL

LEAST = 1e-4  # share of a correlation's variance that directions without scatter have: the jackknife has few blocks
LOOSE = 1e-3  # weight of staying where the data leave parameters open, in natural sizes
MOVED = 0.1  # standard deviations: a draw that is moved less far is one of rigid bodies


@dataclass(frozen=True, eq=False)
class Samples:
    """Draws of an identified model.

    Attributes
    ----------
    result : Result
        Identification result.
    standard, base : ndarray
        Standard parameters (N, n_st) and base parameters (N, n_b), SI units, in the order of the robot's model.
    gains, delays : ndarray
        Drive gains (N, n) and delays (N, n) of the actuated joints, N m/A or N/A, and s.
    friction : dict
        Draws (N,) of the friction with which the model predicts, by name.
    moved : ndarray
        Distance by which each draw was moved to be physically consistent, in standard deviations, (N,).
    seed : int
    """

    result: Result
    standard: np.ndarray
    base: np.ndarray
    gains: np.ndarray
    delays: np.ndarray
    friction: dict[Parameter, np.ndarray]
    moved: np.ndarray
    seed: int

    def __len__(self) -> int:
        return len(self.standard)

    @property
    def moved_share(self) -> float:
        """Share of the draws that were moved."""
        return float(np.mean(self.moved > MOVED))

    @property
    def note(self) -> str:
        """Report the number of draws, and how many were moved."""
        share, distance = 100 * self.moved_share, float(np.median(self.moved))
        return (
            f"{len(self)} draws of what was identified (seed {self.seed}): {share:.0f} % of them were moved to "
            f"parameters that rigid bodies have, by {distance:.2g} standard deviations (median)"
        )

    def npz(self) -> bytes:
        """Return the draws as an NPZ file with names."""
        model, file = self.result.idm, io.BytesIO()
        np.savez(
            file,
            joints=np.array(model.actuated),
            standard_names=np.array(model.parameter_names),
            standard=self.standard,
            base_names=np.array(self.result.base.names),
            base=self.base,
            gains=self.gains,
            delays=self.delays,
            friction_names=np.array(list(self.friction), dtype=str),
            friction=np.column_stack(list(self.friction.values())) if self.friction else np.zeros((len(self), 0)),
            moved=self.moved,
            seed=np.array(self.seed),
        )
        return file.getvalue()

    def results(self) -> Iterator[Result]:
        """Convert each draw to a result, the input of every export."""
        return (self._result(k) for k in range(len(self)))

    def _result(self, k: int) -> Result:
        result, names = self.result, self.result.idm.parameter_names
        assert result.consistency is not None
        gains = dict(zip(result.idm.actuated, map(float, self.gains[k]), strict=True))
        standard: dict[str, float] = dict(zip(names, map(float, self.standard[k]), strict=True))
        base = dict(zip(result.base.names, map(float, self.base[k]), strict=True))

        friction = {str(name): float(values[k]) for name, values in self.friction.items()}

        def drawn(each: Estimate) -> Estimate:
            return replace(each, value=friction.get(each.name, each.value))

        return result.replaced(
            consistency=replace(
                result.consistency, standard=standard, gains={joint: (gain, 0.0) for joint, gain in gains.items()}
            ),
            drive_gains={joint: replace(each, value=gains[joint]) for joint, each in result.drive_gains.items()},
            parameters={name: replace(each, value=base[name]) for name, each in result.parameters.items()},
            friction={name: drawn(each) for name, each in result.friction.items()},
            delays={
                joint: replace(each, value=float(self.delays[k, j]))
                for j, (joint, each) in enumerate(result.delays.items())
            },
        )


def draw(result: Result, count: int, seed: int = 0) -> Samples:
    """Draw models from the identified distribution.

    Parameters
    ----------
    result : Result
        Identified with ``consistent=True``.
    count : int
        Number of draws.
    seed : int
        The same seed gives the same draws.

    Raises
    ------
    GtauError
        Where the result has no physically consistent parameters, or no standard deviations.
    """
    consistent_model(result, "samples")
    if not 0 < count <= 100_000:
        raise GtauError(f"the number of samples is {count}; ask for 1 to 100000.")
    changes = _drawn(result, count, seed)
    base, names, joints = result.base, result.idm.parameter_names, result.idm.actuated
    values = {name: each.value for name, each in result.parameters.items() if each.value is not None}
    values |= {Parameter("gain", joint): gain for joint, gain in zip(joints, result.gains, strict=True)}
    drawn = {name: value + changes.get(name, np.zeros(count)) for name, value in values.items()}
    nearest = _projection(result, tuple(values))
    x, moved = np.zeros((count, len(names))), np.zeros(count)
    gains = np.zeros((count, len(joints)))
    for k in range(count):
        x[k], gains[k], moved[k] = nearest(np.array([drawn[name][k] for name in values]))
    found = x @ base.matrix.T
    delays = [
        (each.value or 0.0) + changes.get(Parameter("delay", joint), np.zeros(count))
        for joint, each in result.delays.items()
    ]
    of_base = {
        own: found[:, k] - values.get(name, 0.0)
        for k, (name, own) in enumerate(zip(base.names, base.standard, strict=True))
    }
    friction = {
        name: (each.value or 0.0) + (of_base[name] if name in of_base else changes.get(name, np.zeros(count)))
        for name, each in result.friction_parameters.items()
    }
    for name, each in friction.items():
        if name.kind in PLAIN[:2] and (result.friction_parameters[name].value or 0.0) >= 0:
            friction[name] = np.maximum(each, 0.0)
    return Samples(result, x, found, gains, np.column_stack(delays), friction, moved, seed)


def _drawn(result: Result, count: int, seed: int) -> dict[str, np.ndarray]:
    """Draw changes (N,) of all estimates in the covariance, by name: jointly normal, with Student's t marginals."""
    from scipy.special import ndtr, stdtrit

    std = np.sqrt(np.diag(result.covariance))
    known = std > 0
    if not known.any():
        raise GtauError("the model has no standard deviations to draw from; identify it again.")
    names = [name for name, each in zip(result.covariance_names, known, strict=True) if each]
    C = result.covariance[np.ix_(known, known)] / np.outer(std[known], std[known])
    sizes, axes = np.linalg.eigh(C)
    normal = np.random.default_rng(seed).standard_normal((count, len(names)))
    normal = normal @ (axes * np.sqrt(np.maximum(sizes, 0.0))).T
    freedom = _freedom(result)
    return {
        name: size * (stdtrit(freedom[name], ndtr(z)) if name in freedom else z)
        for name, size, z in zip(names, std[known], normal.T, strict=True)
    }


def _freedom(result: Result) -> dict[str, float]:
    """Return the degrees of freedom of estimates by their names in the covariance."""
    named = {**result.parameters, **result.friction}
    named |= {Parameter("gain", joint): each for joint, each in result.drive_gains.items()}
    named |= {Parameter("delay", joint): each for joint, each in result.delays.items()}
    return {name: each.freedom for name, each in named.items() if each.freedom is not None}


def _projection(
    result: Result, values: tuple[str, ...]
) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, float]]:
    """Prepare the projection of drawn ``values``, base parameters and gains, onto physically consistent ones.

    It gives standard parameters (n_st,), gains (n,), and the distance moved, in standard deviations.
    """
    robot, base, names = result.robot, result.base, result.idm.parameter_names
    assert result.consistency is not None
    standard = np.array([result.consistency.standard[name] for name in names])
    place = {name: k for k, name in enumerate(names)}
    bodies = tuple(
        Body(body, np.array([place[Parameter(kind, body)] for kind in INERTIAL]), np.zeros(10))
        for body in robot.bodies
        if Parameter("m", body) in place
    )
    length = characteristic_length(robot)
    mass = sum(float(standard[place[Parameter("m", body.name)]]) for body in bodies)
    own = [base.names.index(name) for name in values if name in result.parameters]
    n, gains = len(names), len(values) - len(own)
    S = np.zeros((len(values), n + gains))
    S[: len(own), :n], S[len(own) :, n:] = base.matrix[own], np.eye(gains)
    order: dict[str, int] = {name: k for k, name in enumerate(result.covariance_names)}
    rows = [order[name] for name in values if name in order]
    C = np.eye(len(values))
    there = np.array([name in order for name in values])
    C[np.ix_(there, there)] = result.covariance[np.ix_(rows, rows)]
    std = np.sqrt(np.diag(C))
    given = std == 0  # a given gain is kept
    std[given], C[given, given] = 1e-6, 1e-12
    sizes, axes = np.linalg.eigh(C / np.outer(std, std))
    R = (axes / np.sqrt(np.maximum(sizes, 0.0) + LEAST)).T / std
    unit = np.array([natural_size(name, robot, mass, length) for name in names])
    stay = np.zeros((n, n + gains))
    stay[:, :n] = np.diag(LOOSE / unit)
    lower = np.array([0.0 if name.kind in ("ia", *PLAIN[:2], DAMPING) else -np.inf for name in names])
    within = np.pad(within_reach(robot, bodies, n), ((0, 0), (0, gains))) / (mass * length**2)

    def nearest(drawn: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        found = constrained_least_squares(
            np.vstack([R @ S, stay]),
            np.concatenate([R @ drawn, LOOSE * standard / unit]),
            bodies,
            np.concatenate([lower, np.full(gains, -np.inf)]),
            np.full(n + gains, np.inf),
            np.concatenate([unit, np.ones(gains)]),
            mass,
            length,
            within,
        )
        return found[:n], found[n:], float(np.linalg.norm(R @ (S @ found - drawn)))

    return nearest
