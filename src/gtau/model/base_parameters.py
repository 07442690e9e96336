"""Base parameters: the smallest set from which the model can be computed (paper, section 3.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gtau.documents.validation import FUNCTION, NAMES, WHOLE, takes
from gtau.errors import GtauError
from gtau.findings import Progress, silent
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.program import single_threaded_blas
from gtau.model.singularities import random_motion
from gtau.robots.geometry import identical_legs
from gtau.robots.parameter import Parameter
from gtau.robots.robot import DRIVE, INERTIAL, PLAIN_FRICTION, Robot

DEPENDENT = 1e-8  # share of a unit column left outside the columns kept before it
IDLE = 1e-12  # share of the largest column, such as the cube of a motor's speed: a smaller one is rounding
ROWS = 2  # of the regressor for each of its columns that are drawn at once
SAMPLES = 60  # drawn at once at least: they give the rank that 1500 do
COUNTING, STEPS = "counting base parameters", 3  # of a draw: its regressor, factor and rank
SQUARED_JOINTS = 40_000  # whose equations take a minute: 0.25 min of 100, 4 min of 400
DRAWS = 12  # after which the rank must have settled


@dataclass(frozen=True, repr=False)
class BaseParameters:
    """Base parameters, each with the standard parameters that it regroups.

    Attributes
    ----------
    names : tuple of Parameter
        ``count`` parameters; the name of one that regroups others ends in ``R``.
    standard : tuple of Parameter
        The standard parameter whose column each base parameter keeps.
    regroupings : dict
        Name to formula in standard parameters, as text.
    matrix : ndarray
        (count, n_st): base parameters from standard ones, ``chi = matrix @ chi_st``.
    without_effect : tuple of Parameter
        Standard parameters without effect on any actuated joint.
    inertial_count : int
        Number of base parameters without rotor inertia, friction and offset.
    """

    names: tuple[Parameter, ...]
    standard: tuple[Parameter, ...]
    regroupings: dict[Parameter, str]
    matrix: np.ndarray
    without_effect: tuple[Parameter, ...]
    inertial_count: int

    def __repr__(self) -> str:
        first = ", ".join(self.names[:3])
        return f"BaseParameters({self.count} of {self.matrix.shape[1]} standard parameters: {first}, ...)"

    @property
    def count(self) -> int:
        """Number of base parameters, n_b."""
        return len(self.names)


def symmetric_order(robot: Robot, names: Sequence[Parameter]) -> list[Parameter]:
    """Order ``names`` as eq. (23): platforms, then like legs in turn, first joints that lead from ground to motors."""
    order = [Parameter(kind, platform.name) for platform in robot.platforms for kind in INERTIAL]
    kinds = list(dict.fromkeys(name.kind for name in names))
    towards_motors: set[str] = set()
    for joint in reversed(robot.joints):
        if joint.name in robot.driven or joint.name in towards_motors:
            towards_motors |= {joint.name, joint.antecedent}
    joints = [alike for group in identical_legs(robot) for alike in zip(*group, strict=True)]
    for alike in sorted(joints, key=lambda alike: alike[0] not in towards_motors):
        order += [Parameter(kind, joint) for kind in kinds for joint in alike]
    order += [Parameter(kind, spring.name) for spring in robot.springs for kind in spring.parameters]
    if robot.couplings:  # the friction of a joint that a gear moves is regrouped with its motor's
        order.sort(key=lambda name: name.kind in PLAIN_FRICTION and name.body not in robot.actuated)
    return [name for name in order if name in names]


def seen_by_sensor(names: Sequence[Parameter], joint: str) -> np.ndarray:
    """Mark the standard parameters measured by a joint torque sensor with 1, parameters of the drive with 0."""
    return np.array([name.kind not in DRIVE or name.body != joint for name in names], dtype=float)


@takes(idm=("gtau.InverseDynamics(robot)", (InverseDynamics,)), seed=WHOLE, sensors=NAMES, progress=FUNCTION)
@single_threaded_blas()
def base_parameters(
    idm: InverseDynamics, seed: int = 0, sensors: Sequence[str] = (), progress: Progress | None = None
) -> BaseParameters:
    """Find the base parameters from the structure of the robot's model.

    Those are chi of eq. (21). The regressor of random feasible states is factorised by QR without pivoting, its columns
    normalised and in the symmetric order of eq. (23); a column that depends on those kept before it is
    skipped, and its parameter regrouped with theirs (eq. 22). States are drawn until one more draw keeps the rank.

    Parameters
    ----------
    idm : InverseDynamics
        Model of the robot.
    seed : int
        Seed of the random states.
    sensors : sequence of str
        Joints with a torque sensor: their rows without the drive's parameters are added to the others, and separate the
        inertia of a rotor from the inertia of the link.
    progress : callable
        Progress callback.

    Raises
    ------
    GtauError
        No state within the robot's limits is feasible, or the rank keeps growing with more states.

    Examples
    --------
    >>> gtau.base_parameters(gtau.InverseDynamics(gtau.load_robot("five-bar"))).count
    25
    """
    if unknown := [joint for joint in sensors if joint not in idm.actuated]:
        raise GtauError(f"'sensors' names {unknown[0]!r}, but the actuated joints are {', '.join(idm.actuated)}.")
    order = symmetric_order(idm.robot, idm.parameter_names)
    columns = [idm.parameter_names.index(name) for name in order]
    R = _settled_triangle(idm, columns, np.random.default_rng(seed), sensors, progress or silent)
    kept, coefficients, idle = independent_columns(R)
    matrix = np.zeros((len(kept), len(idm.parameter_names)))
    matrix[:, columns] = coefficients
    standard, names, regroupings = [order[k] for k in kept], [], {}
    for parameter, row in zip(standard, matrix, strict=True):
        factors = zip(row, idm.parameter_names, strict=True)
        terms = [_term(factor, name) for factor, name in factors if factor and name != parameter]
        names.append(Parameter(parameter.kind, parameter.body, regrouped=bool(terms)))
        regroupings[names[-1]] = parameter + "".join(terms)
    inertial = [k for k, name in enumerate(order) if name.kind in INERTIAL]
    inertial_count = len(independent_columns(R[:, inertial])[0])
    without_effect = tuple(order[k] for k in idle)
    return BaseParameters(tuple(names), tuple(standard), regroupings, matrix, without_effect, inertial_count)


@dataclass(frozen=True, eq=False)
class Equations:
    """A robot's model, and the base parameters of its motors and ``sensors``, computed when first needed."""

    model: InverseDynamics
    sensors: tuple[str, ...] = ()
    known: BaseParameters | None = None

    @cached_property
    def base(self) -> BaseParameters:
        """Base parameters of motors and torque sensors together."""
        return self.known or base_parameters(self.model, sensors=self.sensors)


def _settled_triangle(
    idm: InverseDynamics, columns: Sequence[int], rng: np.random.Generator, sensors: Sequence[str], progress: Progress
) -> np.ndarray:
    """Factor the regressor's ``columns`` until more random states no longer raise the rank."""
    joints = len(idm.robot.joints)
    minutes = f", about {joints**2 / SQUARED_JOINTS:.0f} min" if joints**2 > SQUARED_JOINTS else ""
    progress(f"deriving the equations of {joints} joints{minutes}", 0, 1)
    full, n, n_st = idm.full, len(idm.actuated), len(idm.parameter_names)
    progress(f"compiling the equations of {joints} joints{minutes}", 0, 1)
    _ = full.program
    seen = {idm.actuated.index(joint): seen_by_sensor(idm.parameter_names, joint) for joint in sensors}
    samples = max(SAMPLES, -(-ROWS * n_st // n))
    R, rank = np.zeros((0, n_st)), -1
    for draw in range(DRAWS):
        steps = iter(range(STEPS * min(draw, 1), STEPS * 2))  # two draws settle most robots
        progress(COUNTING, next(steps), STEPS * 2)
        motion = random_motion(idm, samples, rng)
        W = np.zeros((n, samples, n_st))
        W[full.rows, :, full.columns] = full(idm.layout, motion)
        progress(COUNTING, next(steps), STEPS * 2)
        rows = [W.reshape(-1, n_st), *(W[j] * felt for j, felt in seen.items())]
        R = np.asarray(np.linalg.qr(np.vstack([R, *(block[:, columns] for block in rows)]), mode="r"))
        progress(COUNTING, next(steps), STEPS * 2)
        before, rank = rank, len(independent_columns(R)[0])
        if rank == before:
            return R
    raise GtauError(
        f"robot '{idm.robot.name}': the number of base parameters has not settled at {rank} after {DRAWS * samples} "
        "random states, which stay too close together; narrow the joints' position limits to the workspace, or give "
        "a home in the middle of it."
    )


def independent_columns(A: np.ndarray) -> tuple[list[int], np.ndarray, list[int]]:
    """Select the columns of ``A`` (r, c) that do not depend on those before them.

    Returns their indices ``kept``, coefficients with which ``A = A[:, kept] @ coefficients``, and those that are zero.
    """
    norms = np.linalg.norm(A, axis=0)
    idle = norms <= IDLE * norms.max(initial=0.0)
    order = np.flatnonzero(~idle)
    R, b, tried = np.asarray(np.linalg.qr(A[:, order] / norms[order], mode="r")), 0, len(order)
    while b < min(len(R), tried):
        if abs(R[b, b]) > DEPENDENT:
            b += 1
            continue
        last = [*range(b), *range(b + 1, len(order)), b]  # behind all others
        order, R, tried = order[last], R[:, last], tried - 1
        R[b:, b:] = np.linalg.qr(R[b:, b:], mode="r")
    coefficients, kept = np.zeros((b, A.shape[1])), order[:b].tolist()
    coefficients[:, order] = np.linalg.solve(R[:b, :b], R[:b])
    coefficients[np.abs(coefficients) < 1e-7] = 0.0
    coefficients *= norms / norms[kept][:, None]
    return kept, coefficients, np.flatnonzero(idle).tolist()


def _term(factor: float, name: str) -> str:
    size = "" if abs(abs(factor) - 1.0) < 1e-6 else f"{abs(factor):.5g} "
    return f" {'-' if factor < 0 else '+'} {size}{name}"


def regrouped(base: BaseParameters, standard: Sequence[Parameter]) -> dict[Parameter, dict[Parameter, float]]:
    """List the parameters in each base parameter by factor, the kept one first; ``standard`` are the columns' names."""
    return {
        name: {parameter: 1.0}
        | {other: float(row[k]) for k, other in enumerate(standard) if row[k] and other != parameter}
        for name, parameter, row in zip(base.names, base.standard, base.matrix, strict=True)
    }


def whole_mass(base: BaseParameters, standard: Sequence[Parameter]) -> Parameter | None:
    """Return the base parameter equal to a floating robot's mass (kg), if any; ``standard`` are the columns' names."""
    masses = np.array([name.kind == "m" for name in standard], dtype=float)
    totals = (name for name, row in zip(base.names, base.matrix, strict=True) if np.allclose(row, masses, atol=1e-6))
    return next(totals, None)
