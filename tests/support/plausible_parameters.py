"""Plausible standard parameters for a robot of which only the geometry is known, drawn at random."""

from __future__ import annotations

import numpy as np

from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.geometry import characteristic_length
from gtau.robots.robot import INERTIAL, Robot

POINTS = 6  # of mass make a body


def random_bodies(robot: Robot, rng: np.random.Generator) -> dict[str, float]:
    """Draw inertial parameters, each body a few points of 0.1 to 0.4 kg spread about its frame: physically consistent.

    Parameters
    ----------
    robot : Robot
        The robot; the spread is a fifth of its characteristic length.
    rng : numpy.random.Generator
        The source of random numbers.

    Returns
    -------
    dict
        Name to value of all ten parameters of all bodies, kg, kg m and kg m2.
    """
    length = characteristic_length(robot)
    chi: dict[str, float] = {}
    for body in robot.bodies:
        masses, points = rng.uniform(0.1, 0.4, POINTS), length * rng.normal(0.0, 0.2, (POINTS, 3))
        chi |= body_parameters(body, masses, points)
    return chi


def body_parameters(body: str, masses: np.ndarray, points: np.ndarray) -> dict[str, float]:
    """Compute, by name, inertial parameters of point ``masses`` (k,) in kg at ``points`` (k, 3) in m, in its frame."""
    moment = sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(masses, points, strict=True))
    values = (*np.asarray(moment)[np.triu_indices(3)], *(masses @ points), masses.sum())
    return {f"{kind}_{body}": float(value) for kind, value in zip(INERTIAL, values, strict=True)}


def random_parameters(model: InverseDynamics, rng: np.random.Generator) -> dict[str, float]:
    """Draw the standard parameters of a robot: bodies of :func:`random_bodies`, and motors with friction.

    Parameters
    ----------
    model : InverseDynamics
        The robot's model, which says what parameters it has.
    rng : numpy.random.Generator
        The source of random numbers.

    Returns
    -------
    dict
        Name to value, SI units.
    """
    robot = model.robot
    length, chi = characteristic_length(robot), random_bodies(robot, rng)
    for joint in robot.actuated:
        chi |= {f"ia_{joint}": length**2, f"off_{joint}": rng.normal(0.0, 0.3 * length)}
        chi |= {f"fv_{joint}": rng.uniform(4.0, 8.0) * length, f"fs_{joint}": rng.uniform(2.0, 5.0) * length}
    return {name: value for name, value in chi.items() if name in model.parameter_names}
