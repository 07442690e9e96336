"""Standard parameters behind the base parameters, and least squares over those of rigid bodies.

A body of positive density has a positive definite pseudo-inertia ``[[Sigma, ms], [ms^T, m]]``, where
``Sigma`` is the second moment of its mass, and every such matrix belongs to some body. The
convex programme is solved by the interior-point solver Clarabel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gtau.errors import GtauError, missing_extra
from gtau.estimation.estimators.estimator import Solution
from gtau.estimation.regression.column_blocks import known_values
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.problem import Problem
from gtau.estimation.regression.system import System
from gtau.estimation.thresholds.estimates import LAST_OVERHANG, OVERHANG
from gtau.robots.geometry import characteristic_length, extent, longest_placement
from gtau.robots.parameter import Parameter
from gtau.robots.robot import DAMPING, INERTIAL, STANDARD_GRAVITY, STIFFNESS, Robot
from gtau.signals.channel import Channel
from gtau.signals.reading.statements import Prior

ROOT2 = np.sqrt(2.0)
MARGIN = 1e-6
LOOSE = 10.0  # natural sizes: standard deviation of the prior on parameters without a stated one
SLENDER = 0.2  # radius of gyration of a plausible link, in lengths of the robot


def _basis() -> np.ndarray:
    """Build the pseudo-inertias of unit parameters, in the order of INERTIAL, (10, 4, 4)."""
    basis = np.zeros((10, 4, 4))
    for k, name in enumerate(INERTIAL):
        axes = ["xyz".index(letter) for letter in name if letter in "xyz"]
        if name == "m":
            basis[k, 3, 3] = 1.0
        elif name.startswith("m"):
            basis[k, axes[0], 3] = basis[k, 3, axes[0]] = 1.0
        elif axes[0] == axes[1]:
            basis[k, :3, :3] = np.eye(3) / 2  # Sigma = tr(I)/2 - I
            basis[k, axes[0], axes[0]] -= 1.0
        else:
            basis[k, axes[0], axes[1]] = basis[k, axes[1], axes[0]] = -1.0  # xy = -int x y dm
    return basis


BASIS = _basis()


def pseudo_inertia(values: np.ndarray) -> np.ndarray:
    """Build the pseudo-inertia (4, 4) of inertial parameters (10,), in the order of INERTIAL, SI units."""
    return np.einsum("k,kij->ij", values, BASIS)


def ball_row(centre: np.ndarray, radius: float) -> np.ndarray:
    """Build the row (10,) whose product with a body's parameters is not negative if its mass lies within a ball.

    It is ``tr(J Q)`` of the pseudo-inertia J, the integral of ``radius^2 - |x - centre|^2`` over the mass: it bounds
    the distance of the centre of mass, and the radius of gyration about the centre of the ball, by the ball's radius
    (Wensing, Kim and Slotine, 2018).
    """
    Q = np.zeros((4, 4))
    Q[:3, :3], Q[3, 3] = -np.eye(3), radius**2 - centre @ centre
    Q[:3, 3] = Q[3, :3] = centre
    return np.einsum("kij,ij->k", BASIS, Q)


@dataclass(frozen=True, eq=False)
class Body:
    """A body: the place of each of its ten parameters among the unknowns, -1 for ``known`` values (10,)."""

    name: str
    places: np.ndarray
    known: np.ndarray

    def values(self, x: np.ndarray) -> np.ndarray:
        """Return the body's inertial parameters (10,)."""
        return np.where(self.places < 0, self.known, x[self.places])


def constrained_least_squares(
    R: np.ndarray,
    y: np.ndarray,
    bodies: Sequence[Body],
    lower: np.ndarray,
    upper: np.ndarray,
    unit: np.ndarray,
    mass: float,
    length: float,
    within: np.ndarray | None = None,
) -> np.ndarray:
    """Minimise ``|R x - y|`` over unknowns that are consistent with rigid bodies.

    Parameters
    ----------
    R, y : ndarray
        (r, c) and (r,); every unknown must enter ``R``.
    bodies : sequence of Body
        Bodies whose pseudo-inertias are held above the share MARGIN of ``mass`` (kg), in lengths of ``length`` (m).
    lower, upper : ndarray
        Bounds of the unknowns (c,), infinite where there are none.
    unit : ndarray
        Natural size of each unknown, (c,), for the solver's scaling.
    within : ndarray, optional
        Rows (k, c) of ``within @ x >= 0``; see :func:`ball_row`.

    Returns
    -------
    ndarray
        The unknowns, (c,).

    Raises
    ------
    GtauError
        If no unknowns satisfy bounds and known values, or the solver is not installed.
    """
    try:
        import clarabel
    except ModuleNotFoundError:
        raise missing_extra("a search for physically consistent parameters", "clarabel", "consistency") from None
    from scipy.sparse import csc_array, diags_array, hstack, vstack

    r, c = R.shape
    scaled = csc_array(R * unit)
    # unknowns (x / unit, e) with e = R x - y, so that R^T R is never formed
    rows = [hstack([scaled, -diags_array(np.ones(r))])]
    right = [y]
    cones = [clarabel.ZeroConeT(r)]
    bounded = [(np.isfinite(lower), -1.0, lower), (np.isfinite(upper), 1.0, upper)]
    for chosen, sign, bound in bounded:
        k = np.flatnonzero(chosen)
        if k.size:
            rows.append(csc_array((np.full(k.size, sign), (np.arange(k.size), k)), shape=(k.size, c + r)))
            right.append(sign * bound[k] / unit[k])
            cones.append(clarabel.NonnegativeConeT(k.size))
    if within is not None and len(within):
        rows.append(hstack([csc_array(-within * unit), csc_array((len(within), r))]))
        right.append(np.zeros(len(within)))
        cones.append(clarabel.NonnegativeConeT(len(within)))
    upper_triangle = [(i, j) for j in range(4) for i in range(j + 1)]
    i, j = np.array(upper_triangle).T
    scale = np.append(np.full(3, 1 / length), 1.0)
    vectors = (BASIS * np.outer(scale, scale))[:, i, j] * np.where(i == j, 1.0, ROOT2)  # (10, 10)
    floor = MARGIN * np.where(i == j, 1.0, 0.0)
    for body in bodies:
        free = body.places >= 0
        block = np.zeros((10, c + r))
        block[:, body.places[free]] = -(vectors[free] * unit[body.places[free], None]).T / mass
        rows.append(csc_array(block))
        right.append(body.known[~free] @ vectors[~free] / mass - floor)
        cones.append(clarabel.PSDTriangleConeT(4))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    objective = diags_array(np.append(np.zeros(c), np.ones(r)), format="csc")
    problem = clarabel.DefaultSolver(
        objective, np.zeros(c + r), csc_array(vstack(rows, format="csc")), np.concatenate(right), cones, settings
    )
    solved = problem.solve()
    if solved.status not in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
        raise GtauError(
            f"no rigid bodies can have these parameters (the solver says '{solved.status}'); "
            "check the bounds under 'priors' and the known parameters of the payloads."
        )
    return np.asarray(solved.x)[:c] * unit


@dataclass(frozen=True, eq=False)
class StandardUnknowns:
    """Unknowns x (c,) of the consistent fit, ``theta = S x`` of the problem, (n_theta, c), and ``within @ x >= 0``."""

    names: tuple[Parameter, ...]
    S: np.ndarray
    bodies: tuple[Body, ...]
    lower: np.ndarray
    upper: np.ndarray
    centre: np.ndarray
    spread: np.ndarray
    unit: np.ndarray
    within: np.ndarray
    mass: float
    length: float


def standard_unknowns(
    dataset: Dataset, system: System, solution: Solution, priors: Mapping[str, Prior]
) -> StandardUnknowns:
    """List the standard parameters behind the problem's, with their priors."""
    robot, problem = dataset.robot, system.whole
    names = list(dataset.model.parameter_names)
    position = {name: k for k, name in enumerate(names)}
    bodies = [
        Body(body, np.array([position[Parameter(kind, body)] for kind in INERTIAL]), np.zeros(10))
        for body in robot.bodies
        if Parameter("m", body) in position
    ]
    for each in system.payloads:
        known = known_values(each.payload)
        label = f"L{each.run + 1}"
        first = len(names)
        names += [Parameter(kind, label) for kind in each.free]
        places = [first + each.free.index(kind) if kind in each.free else -1 for kind in INERTIAL]
        bodies.append(Body(label, np.array(places), np.array([known.get(kind, 0.0) for kind in INERTIAL])))
    carried = {name for each in system.payloads for name in each.unknown}
    others = [name for name in problem.parameters[dataset.base.count :] if name not in carried]
    names += others
    S = np.zeros((len(problem.parameters), len(names)))
    S[: dataset.base.count, : len(position)] = dataset.base.matrix
    row = {name: k for k, name in enumerate(problem.parameters)}
    column: dict[str, int] = {name: k for k, name in enumerate(names)}
    for each in system.payloads:
        columns = [column[Parameter(kind, f"L{each.run + 1}")] for kind in each.free]
        S[np.ix_([row[name] for name in each.unknown], columns)] = each.sums
    for name in others:
        S[row[name], column[name]] = 1.0
    length = characteristic_length(robot)
    mass = _mass_scale(robot, problem, solution, length)
    unit = np.array([natural_size(name, robot, mass, length, problem.channels) for name in names])
    centre, spread = np.zeros(len(names)), LOOSE * unit
    lower, upper = np.full(len(names), -np.inf), np.full(len(names), np.inf)
    for body in bodies:
        plausible = np.array([mass / len(robot.bodies) * (SLENDER * length) ** 2] * 10)
        plausible[[1, 2, 4, 6, 7, 8]] = 0.0
        plausible[9] = mass / len(robot.bodies)
        centre[body.places[body.places >= 0]] = plausible[body.places >= 0]
    for k, parameter in enumerate(names):
        if parameter.kind in ("ia", "fv", "fs", "fl", DAMPING) and parameter.run is None:
            lower[k] = 0.0
    for stated, prior in priors.items():
        if stated not in column:  # a base parameter: see known_equations
            continue
        k = column[stated]
        lower[k] = lower[k] if prior.min is None else prior.min
        upper[k] = upper[k] if prior.max is None else prior.max
        if prior.value is not None and prior.std is not None:
            centre[k], spread[k] = prior.value, prior.std
    within = within_reach(robot, bodies[: len(bodies) - len(system.payloads)], len(names)) / (mass * length**2)
    return StandardUnknowns(tuple(names), S, tuple(bodies), lower, upper, centre, spread, unit, within, mass, length)


def within_reach(robot: Robot, bodies: Sequence[Body], count: int) -> np.ndarray:
    """Build rows (bodies, count) that keep the mass of each body within reach of its frames; see :func:`extent`."""
    longest, rows = longest_placement(robot), np.zeros((len(bodies), count))
    for row, body in zip(rows, bodies, strict=True):
        middle, radius, ends = extent(robot, body.name)
        row[body.places] = ball_row(middle, radius + (LAST_OVERHANG if ends else OVERHANG) * longest)
    return rows


def _mass_scale(robot: Robot, problem: Problem, solution: Solution, length: float) -> float:
    """Compute the mass that the largest rms torque would hold against gravity, kg."""
    lever = [length if robot.joint(joint).turns else 1.0 for joint in problem.joints]
    torques = (np.abs(solution.gains) * problem.signal)[: len(lever)]
    return float(np.max(torques / np.array(lever)) / STANDARD_GRAVITY)


def natural_size(name: Parameter, robot: Robot, mass: float, length: float, channels: Sequence[Channel] = ()) -> float:
    """Return a size of a standard parameter that a robot of this ``mass`` (kg) and ``length`` (m) might have.

    The parameter may be one of the ``channels``' own.
    """
    kind, body = name.kind, name.body
    if kind in INERTIAL:
        return mass if kind == "m" else mass * length if kind.startswith("m") else mass * length**2
    if any(spring.name == body for spring in robot.springs):
        return mass * STANDARD_GRAVITY / (length if kind == STIFFNESS else 1.0)
    joint = next((each.joint for each in channels if each.name == body), body)
    turns = robot.joint(joint).turns
    if kind == "ia":
        return mass * length**2 if turns else mass
    if kind == "fl":
        return 1.0
    return mass * STANDARD_GRAVITY * (length if turns else 1.0)
