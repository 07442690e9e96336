"""Physically consistent standard parameters behind the identified base parameters.

The data determine sums of standard parameters only. Simulation and control need every one of them, and a positive
definite mass matrix: so the fit is repeated over the standard parameters, with a positive definite pseudo-inertia
``[[Sigma, ms], [ms^T, m]]`` for every link, platform and payload (``Sigma`` is the second moment of its mass; every
such matrix belongs to some body), the mass of every body within reach of its joints, friction and rotor inertia not
negative, and the bounds and priors that are given. With the gains free it is a sequence of convex programmes, each one
Gauss-Newton step of the maximum likelihood in the current domain, solved by the interior-point solver Clarabel.

Unidentifiable directions are taken close to a plausible robot: solid links of equal masses, no friction.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gtau.errors import GtauError, missing_extra
from gtau.estimation.estimators.estimator import Fit, Solution
from gtau.estimation.estimators.newton import errors_of_known, jacobian_of_known, moved, residuals, stacked, weighted
from gtau.estimation.regression.assembly import known_values
from gtau.estimation.regression.dataset import System
from gtau.estimation.regression.factors import triangle
from gtau.estimation.regression.priors import theta_equations
from gtau.robots.geometry import characteristic_length, extent, longest_placement
from gtau.robots.parameter import BASIS, DISSIPATING, KINDS, Parameter, ball_row, pseudo_inertia
from gtau.robots.robot import INERTIAL, STANDARD_GRAVITY, STIFFNESS, Robot
from gtau.signals.channel import Channel
from gtau.signals.reading.statements import Prior

OVERHANG = 0.5  # reach of a body's mass beyond the ball around its joints, in lengths of the robot's longest link
LAST_OVERHANG = 1.2  # the same reach of a body that no other follows, in lengths of the longest link

MARGIN = 1e-6
LOOSE = 10.0  # natural sizes: standard deviation of the prior on parameters without a stated one
SLENDER = 0.2  # radius of gyration of a plausible link, in lengths of the robot
STEPS = 40
CONVERGED = 1e-3  # of a standard deviation


@dataclass(frozen=True, eq=False)
class Body:
    """A body: the place of each of its ten parameters among the unknowns, -1 for ``known`` values (10,)."""

    name: str
    places: np.ndarray
    known: np.ndarray

    def values(self, x: np.ndarray) -> np.ndarray:
        """Return the body's inertial parameters (10,)."""
        return np.where(self.places < 0, self.known, x[self.places])


@dataclass(frozen=True, eq=False)
class RigidBodies:
    """Constraints of unknowns x (c,) by rigid bodies and bounds.

    The pseudo-inertias of ``bodies`` are held above the share MARGIN of ``mass`` (kg), in lengths of ``length`` (m);
    ``unit`` (c,) are natural sizes of the unknowns, between ``lower`` and ``upper`` (c,), and ``within @ x >= 0``.
    """

    bodies: tuple[Body, ...]
    unit: np.ndarray
    mass: float
    length: float
    lower: np.ndarray
    upper: np.ndarray
    within: np.ndarray

    def beside(self, sizes: np.ndarray) -> RigidBodies:
        """Append unknowns of these natural ``sizes`` without constraints."""
        ends = (0, len(sizes))
        lower = np.pad(self.lower, ends, constant_values=-np.inf)
        upper = np.pad(self.upper, ends, constant_values=np.inf)
        within = np.pad(self.within, ((0, 0), ends))
        return replace(self, unit=np.append(self.unit, sizes), lower=lower, upper=upper, within=within)


def unbounded(bodies: Sequence[Body], unit: np.ndarray, mass: float, length: float) -> RigidBodies:
    """Constrain unknowns by rigid bodies alone."""
    free, none = np.full(len(unit), np.inf), np.zeros((0, len(unit)))
    return RigidBodies(tuple(bodies), unit, mass, length, -free, free, none)


def constrained_least_squares(R: np.ndarray, y: np.ndarray, rigid: RigidBodies) -> np.ndarray:
    """Minimise ``|R x - y|``, R (r, c), over unknowns that rigid bodies can have; raises GtauError."""
    try:
        import clarabel
    except ModuleNotFoundError:
        raise missing_extra("a search for physically consistent parameters", "clarabel", "consistency") from None
    from scipy.sparse import csc_array, diags_array, hstack, vstack

    r, c = R.shape
    # unknowns (x / unit, e) with e = R x - y, so that R^T R is never formed
    rows = [hstack([csc_array(R * rigid.unit), -diags_array(np.ones(r))])]
    right, cones = [y], [clarabel.ZeroConeT(r)]
    # bounds and balls, as rows A z <= end of the scaled unknowns z
    unit, eye, low, high = rigid.unit, np.eye(c), np.isfinite(rigid.lower), np.isfinite(rigid.upper)
    limits = np.concatenate([-eye[low], eye[high], -rigid.within * unit])
    ends = np.concatenate([-rigid.lower[low] / unit[low], rigid.upper[high] / unit[high], np.zeros(len(rigid.within))])
    if len(ends):
        rows.append(hstack([csc_array(limits), csc_array((len(ends), r))]))
        right.append(ends)
        cones.append(clarabel.NonnegativeConeT(len(ends)))
    for block, end in _pseudo_inertias(rigid):
        rows.append(hstack([csc_array(block), csc_array((len(end), r))]))
        right.append(end)
        cones.append(clarabel.PSDTriangleConeT(4))
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    objective = diags_array(np.append(np.zeros(c), np.ones(r)), format="csc")
    stacked = csc_array(vstack(rows, format="csc"))
    problem = clarabel.DefaultSolver(objective, np.zeros(c + r), stacked, np.concatenate(right), cones, settings)
    solved = problem.solve()
    if solved.status not in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
        raise GtauError(
            f"no rigid bodies can have these parameters (the solver says '{solved.status}'); "
            "check the bounds under 'priors' and the known parameters of the payloads."
        )
    return np.asarray(solved.x)[:c] * rigid.unit


def _pseudo_inertias(rigid: RigidBodies) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Write the pseudo-inertia of each body, less its lower limit, as ``end - A z``, (10, c) and (10,)."""
    j, i = np.tril_indices(4)  # column by column above the diagonal
    scale = np.append(np.full(3, 1 / rigid.length), 1.0)
    vectors = (BASIS * np.outer(scale, scale))[:, i, j] * np.where(i == j, 1.0, np.sqrt(2.0))  # (10, 10)
    floor = MARGIN * np.where(i == j, 1.0, 0.0)
    for body in rigid.bodies:
        free = body.places >= 0
        block = np.zeros((10, len(rigid.unit)))
        block[:, body.places[free]] = -(vectors[free] * rigid.unit[body.places[free], None]).T / rigid.mass
        yield block, body.known[~free] @ vectors[~free] / rigid.mass - floor


@dataclass(frozen=True, eq=False)
class StandardUnknowns:
    """Unknowns x (c,) of the consistent fit, ``theta = S x``, with means ``centre`` and ``std`` of their priors."""

    names: tuple[Parameter, ...]
    S: np.ndarray
    centre: np.ndarray
    std: np.ndarray
    rigid: RigidBodies


def standard_unknowns(system: System, solution: Solution, priors: Mapping[str, Prior]) -> StandardUnknowns:
    """List the standard parameters behind the problem's, with their priors."""
    robot, problem = system.dataset.robot, system.unreduced
    bodies, names, S = _regrouped(system)
    length = characteristic_length(robot)
    # the mass that the largest rms torque would hold against gravity, kg
    levers = [length if robot.joint(joint).turns else 1.0 for joint in problem.joints]
    held = (np.abs(solution.gains) * problem.signal)[: len(levers)] / levers
    mass = float(np.max(held) / STANDARD_GRAVITY)
    unit = np.array([natural_size(name, robot, mass, length, problem.channels) for name in names])
    centre, std = np.zeros(len(names)), LOOSE * unit
    link, moment = mass / len(robot.bodies), (SLENDER * length) ** 2
    plausible = link * np.array([moment, 0, 0, moment, 0, moment, 0, 0, 0, 1.0])
    for body in bodies:
        free = body.places >= 0
        centre[body.places[free]] = plausible[free]
    dissipates = [name.kind in DISSIPATING and name.run is None for name in names]
    lower = np.where(dissipates, 0.0, -np.inf)
    upper = np.full(len(names), np.inf)
    for k, name in enumerate(names):
        if (prior := priors.get(name)) is None:
            continue
        lower[k] = lower[k] if prior.min is None else prior.min
        upper[k] = upper[k] if prior.max is None else prior.max
        if prior.value is not None and prior.std is not None:
            centre[k], std[k] = prior.value, prior.std
    robot_bodies = bodies[: len(bodies) - len(system.payloads)]
    within, longest = np.zeros((len(robot_bodies), len(names))), longest_placement(robot)
    for row, body in zip(within, robot_bodies, strict=True):  # keeps its mass within reach of its frames; see extent
        middle, radius, ends = extent(robot, body.name)
        row[body.places] = ball_row(middle, radius + (LAST_OVERHANG if ends else OVERHANG) * longest)
    rigid = RigidBodies(tuple(bodies), unit, mass, length, lower, upper, within / (mass * length**2))
    return StandardUnknowns(tuple(names), S, centre, std, rigid)


def _regrouped(system: System) -> tuple[list[Body], list[Parameter], np.ndarray]:
    """List the bodies, payloads last, the unknowns (c,), and what these add to the problem's parameters, (., c)."""
    base = system.dataset.base
    problem = system.unreduced
    names = list(system.dataset.model.parameter_names)
    place = {name: k for k, name in enumerate(names)}
    bodies = [
        Body(body, np.array([place[Parameter(kind, body)] for kind in INERTIAL]), np.zeros(len(INERTIAL)))
        for body in system.dataset.robot.bodies
        if Parameter("m", body) in place
    ]
    for payload in system.payloads:
        label = payload.label
        known = known_values(payload.payload)
        first = len(names)
        summed = {kind: first + k for k, kind in enumerate(payload.summed)}
        places = np.array([summed.get(kind, -1) for kind in INERTIAL])
        bodies.append(Body(label, places, np.array([known.get(kind, 0.0) for kind in INERTIAL])))
        names += [Parameter(kind, label) for kind in payload.summed]
    payload_parameters = {name for payload in system.payloads for name in payload.unknown}
    others = [name for name in problem.parameters[base.count :] if name not in payload_parameters]
    S = np.zeros((len(problem.parameters), len(names) + len(others)))
    S[: base.count, : len(place)] = base.matrix
    end = len(place)
    for payload in system.payloads:
        begin, end = end, end + len(payload.summed)
        S[problem.unknowns.at(payload.unknown), begin:end] = payload.sums
    S[problem.unknowns.at(others), np.arange(end, end + len(others))] = 1.0
    return bodies, [*names, *others], S


def natural_size(name: Parameter, robot: Robot, mass: float, length: float, channels: Sequence[Channel] = ()) -> float:
    """Return a likely size of a standard parameter in a robot of this ``mass`` (kg) and ``length`` (m)."""
    kind, body = name.kind, name.body
    if kind in INERTIAL:
        return mass if kind == "m" else mass * length if kind.startswith("m") else mass * length**2
    if any(spring.name == body for spring in robot.springs):
        return mass * STANDARD_GRAVITY / (length if kind == STIFFNESS else 1.0)
    joint = next((channel.joint for channel in channels if channel.name == body), body)
    turns = robot.joint(joint).turns
    if kind == "ia":
        return mass * length**2 if turns else mass
    if KINDS[kind].units[0] == "1":
        return 1.0
    return mass * STANDARD_GRAVITY * (length if turns else 1.0)


@dataclass(frozen=True)
class Move:
    """Shift of a number by consistency: its value without and with it, and the shift in its standard deviations."""

    name: str
    free: float
    consistent: float
    deviations: float


@dataclass(frozen=True)
class Consistency:
    """Physically consistent ``standard`` parameters by name, SI units.

    ``payloads`` are the ten inertial parameters of each carried payload by label (``L3``), ``gains`` drive gain and
    standard deviation by joint, the latter without constraints, 0 where given; ``moves`` are of every base parameter
    and gain, the most moved first; ``eigenvalues`` the smallest of the pseudo-inertia by body, ``loss`` the growth of
    the residual by joint, per cent; ``open`` standard parameters without effect on actuated joints, chosen and not
    identified.
    """

    standard: Mapping[str, float]
    payloads: Mapping[str, Mapping[str, float]]
    gains: Mapping[str, tuple[float, float]]
    moves: tuple[Move, ...]
    eigenvalues: Mapping[str, float]
    loss: Mapping[str, float]
    open: tuple[str, ...]


def consistent(fit: Fit, plain: Solution, std: np.ndarray, priors: Mapping[str, Prior]) -> Consistency:
    """Find physically consistent standard parameters, alone (gains given) or together with the gains.

    The ``fit`` is without constraints, ``std`` (k,) are the standard deviations of its estimates; ``priors`` constrain
    standard parameters. Where effects beside the model moved it away from the ``plain`` solution, what they add stays
    in the residuals, which the plain ones have there instead.
    Raises GtauError where no rigid bodies agree with the priors and payloads, or the programme does not converge.
    """
    system, solution, free_gains = fit.system, fit.solution, fit.free_gains
    problem, base = system.unreduced, system.dataset.base
    names = system.dataset.model.parameter_names
    base_priors = theta_equations(base, names, problem.parameters, priors)
    unknowns = standard_unknowns(system, solution, priors)
    triangles = stacked(problem)
    free, unmoved = (
        np.concatenate([system.full(found.theta)[:-1], found.gains, found.delays]) for found in (solution, plain)
    )
    channels = len(triangles)

    def errors(blocks: np.ndarray, values: np.ndarray) -> np.ndarray:
        return residuals(blocks, values) - residuals(blocks, free) + residuals(blocks, unmoved)

    def squares(values: np.ndarray) -> np.ndarray:
        return np.asarray(np.sum(errors(triangles, values) ** 2, axis=-1))

    priors_stated = np.insert(base_priors, [problem.n_theta] * ((2 if free_gains else 1) * channels), 0.0, axis=1)
    J_known = jacobian_of_known(problem, free_gains)
    values = free
    for _ in range(STEPS):
        weights = problem.weights(squares(values))
        _, J = weighted(triangles, values, problem, free_gains, weights)
        e = (errors(triangles, values) * weights[:, None]).reshape(-1)
        theta = values[: problem.n_theta]
        linear = np.column_stack([J, J[:, : len(theta)] @ theta - e])  # in theta, and in steps of 1/g and the delays
        volts = np.column_stack([J_known, -errors_of_known(problem, values)])[len(problem.known) :]
        x, rest = _programme(triangle(linear, priors_stated, volts), unknowns)
        step = np.concatenate([unknowns.S @ x - theta, rest])
        values = moved(values, step, channels)
        _, J = weighted(triangles, values, problem, free_gains, weights)
        if np.linalg.norm(J @ step) < CONVERGED * np.sqrt(step.size):
            break
    else:
        raise GtauError(
            "the search did not converge; resolve contradictions first, or give 'priors' for the parameters that the "
            "data leave open."
        )
    bodies = {body.name: body.values(x) for body in unknowns.rigid.bodies}
    shares = 100 * (np.sqrt(squares(values) / squares(free))[: len(problem.joints)] - 1)
    gains = zip(problem.joints, values[problem.gain_rows], std[system.problem.gain_rows], strict=True)
    labels = [load.label for load in system.payloads]
    return Consistency(
        standard=dict(zip(names, x.tolist(), strict=False)),
        payloads={label: dict(zip(INERTIAL, bodies[label].tolist(), strict=True)) for label in labels},
        gains={joint: (float(gain), float(free_std)) for joint, gain, free_std in gains},
        moves=_moves(fit, values, std),
        eigenvalues={body: float(np.linalg.eigvalsh(pseudo_inertia(chi))[0]) for body, chi in bodies.items()},
        loss=dict(zip(problem.joints, shares.tolist(), strict=True)),
        open=base.without_effect,
    )


def _moves(fit: Fit, values: np.ndarray, std: np.ndarray) -> tuple[Move, ...]:
    """List the shifts of parameters, and of free gains, from those of the ``fit``, the largest first."""
    problem, solution = fit.problem, fit.solution
    consistent = dict(zip(fit.system.unreduced.unknowns, values, strict=True))
    names = [name for name in problem.parameters if name.run is None]
    names += problem.unknowns[problem.gain_rows] if fit.free_gains else ()
    moves = []
    for name in names:
        k = solution.unknowns.places[name]
        if std[k]:
            free = float(solution.values[k])
            value = float(consistent[name])
            moves.append(Move(name, free, value, abs(value - free) / float(std[k])))
    return tuple(sorted(moves, key=lambda move: -move.deviations))


def _programme(R: np.ndarray, unknowns: StandardUnknowns) -> tuple[np.ndarray, np.ndarray]:
    parameters, c = unknowns.S.shape
    R, y = R[:-1, :-1], R[:-1, -1]  # the last row is the residual of the unconstrained fit
    rest = R[:, parameters:]
    prior = np.hstack([np.diag(1 / unknowns.std), np.zeros((c, rest.shape[1]))])
    A = np.concatenate([np.hstack([R[:, :parameters] @ unknowns.S, rest]), prior])
    sizes = np.linalg.norm(rest, axis=0)
    rigid = unknowns.rigid.beside(1 / np.where(sizes > 0, sizes, 1.0))
    solved = constrained_least_squares(A, np.concatenate([y, unknowns.centre / unknowns.std]), rigid)
    return solved[:c], solved[c:]
