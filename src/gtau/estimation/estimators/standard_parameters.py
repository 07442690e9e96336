"""The standard parameters behind the base parameters, and their priors.

Their natural sizes follow from the robot's size and torques; the user may state values and bounds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gtau.estimation.estimators.estimator import Solution
from gtau.estimation.estimators.semidefinite import Body, ball_row
from gtau.estimation.regression.column_blocks import known_values
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.problem import Problem
from gtau.estimation.regression.system import System
from gtau.estimation.thresholds.estimates import LAST_OVERHANG, OVERHANG
from gtau.robots.geometry import characteristic_length, extent, longest_placement
from gtau.robots.parameter import Parameter, parameter_of
from gtau.robots.robot import DAMPING, INERTIAL, STANDARD_GRAVITY, STIFFNESS, Robot
from gtau.signals.experiment import Prior

LOOSE = 10.0  # natural sizes: standard deviation of the prior on parameters without a stated one
SLENDER = 0.2  # radius of gyration of a plausible link, in lengths of the robot


@dataclass(frozen=True, eq=False)
class StandardUnknowns:
    """Unknowns x (c,) of the consistent fit, ``theta = S x`` of the problem, (n_theta, c), and ``within @ x >= 0``."""

    names: tuple[str, ...]
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
        Body(body, np.array([position[Parameter(kind, body).name] for kind in INERTIAL]), np.zeros(10))
        for body in robot.bodies
        if Parameter("m", body).name in position
    ]
    for each in system.payloads:
        known = known_values(each.payload)
        label = f"L{each.run + 1}"
        first = len(names)
        names += [Parameter(kind, label).name for kind in each.free]
        places = [first + each.free.index(kind) if kind in each.free else -1 for kind in INERTIAL]
        bodies.append(Body(label, np.array(places), np.array([known.get(kind, 0.0) for kind in INERTIAL])))
    carried = {name for each in system.payloads for name in each.unknown}
    others = [name for name in problem.parameters[dataset.base.count :] if name not in carried]
    names += others
    S = np.zeros((problem.n_theta, len(names)))
    S[: dataset.base.count, : len(position)] = dataset.base.matrix
    row = {name: k for k, name in enumerate(problem.parameters)}
    column = {name: k for k, name in enumerate(names)}
    for each in system.payloads:
        columns = [column[f"{kind}_L{each.run + 1}"] for kind in each.free]
        S[np.ix_([row[name] for name in each.unknown], columns)] = each.sums
    for name in others:
        S[row[name], column[name]] = 1.0
    length = characteristic_length(robot)
    mass = _mass_scale(robot, problem, solution, length)
    unit = np.array([natural_size(name, robot, mass, length) for name in names])
    centre, spread = np.zeros(len(names)), LOOSE * unit
    lower, upper = np.full(len(names), -np.inf), np.full(len(names), np.inf)
    for body in bodies:
        plausible = np.array([mass / len(robot.bodies) * (SLENDER * length) ** 2] * 10)
        plausible[[1, 2, 4, 6, 7, 8]] = 0.0
        plausible[9] = mass / len(robot.bodies)
        centre[body.places[body.places >= 0]] = plausible[body.places >= 0]
    for k, name in enumerate(names):
        if parameter_of(name).kind in ("ia", "fv", "fs", "fl", DAMPING) and parameter_of(name).run is None:
            lower[k] = 0.0
    for name, prior in priors.items():
        if name not in column:  # a base parameter: see known_equations
            continue
        k = column[name]
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
    lever = [length if robot.joint(joint).kind == "revolute" else 1.0 for joint in problem.joints]
    torques = (np.abs(solution.gains) * problem.signal)[: len(lever)]
    return float(np.max(torques / np.array(lever)) / STANDARD_GRAVITY)


def natural_size(name: str, robot: Robot, mass: float, length: float) -> float:
    """Return a size of a standard parameter that a robot of this ``mass`` (kg) and ``length`` (m) might have."""
    kind, body, _ = parameter_of(name)
    if kind in INERTIAL:
        return mass if kind == "m" else mass * length if kind.startswith("m") else mass * length**2
    if any(spring.name == body for spring in robot.springs):
        return mass * STANDARD_GRAVITY / (length if kind == STIFFNESS else 1.0)
    joint = body if body in robot.bodies else body.removesuffix("_sensor")
    turns = robot.joint(joint).kind == "revolute"
    if kind == "ia":
        return mass * length**2 if turns else mass
    if kind == "fl":
        return 1.0
    return mass * STANDARD_GRAVITY * (length if turns else 1.0)
