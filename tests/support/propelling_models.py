"""Identified models whose fitted friction would drive the robot: coefficients like those of a real UR10e, and worse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from models_to_export import model_of

from gtau.estimation.results.estimate import Estimate
from gtau.result import Result
from gtau.robots.parameter import Parameter
from gtau.robots.robot import Robot

LOGGED = 1.3  # rad/s, m/s: the fastest speed of the made-up logs
CUBIC, VISCOUS, COULOMB = -6.4, 29.2, 13.7  # N m: of the first joint of a UR10e, identified


def propelling(robot: Robot, load: float = 0.0, worse: bool = False) -> Result:
    """A model without offsets whose actuated joints have the UR10e's friction, beyond 1.3 rad/s of cubic propulsion.

    ``load`` is fl. Where ``worse``, it propels at logged speeds, too: by negative fs, and fv of passive joints.
    """
    result, actuated = model_of(robot, terms=False), robot.actuated
    values = {f"fv_{joint}": VISCOUS for joint in actuated} | {f"fs_{joint}": COULOMB for joint in actuated}
    values |= {f"off_{joint.name}": 0.0 for joint in robot.joints}
    standard = {name: values.get(name, value) for name, value in result.consistency.standard.items()}
    if worse:
        standard |= {f"fs_{joint}": -3.0 for joint in actuated}
        standard |= {f"fv_{each.name}": -20.0 for each in robot.joints if not each.actuated}
    base = result.base.matrix @ [standard[name] for name in result.idm.parameter_names]
    parameters = {
        name: replace(each, value=float(value))
        for (name, each), value in zip(result.parameters.items(), base, strict=True)
    }
    friction = {Parameter("f3", joint): Estimate(f"f3_{joint}", CUBIC, 0.1, "N m s3/rad3") for joint in actuated}
    if load:
        friction |= {Parameter("fl", joint): Estimate(f"fl_{joint}", load, 0.01, "1") for joint in actuated}
    return result.replaced(
        parameters=parameters,
        friction=friction,
        consistency=replace(result.consistency, standard=standard),
        logged_speeds=dict.fromkeys(actuated, LOGGED),
    )


def speeds(n: int, rng: np.random.Generator, count: int = 60) -> np.ndarray:
    """Speeds (3 count, n) up to five times the logged ones: each alone, all together, and near standstill."""
    together = rng.uniform(-5, 5, (count, n)) * LOGGED
    alone = together * np.eye(n)[np.arange(count) % n]
    return np.concatenate([together, alone, 1e-3 * together])


def held(speed: float) -> float:
    """The friction of ``propelling``, by hand: the polynomial falls at 1.3 rad/s, and stays at that value."""
    polynomial = np.polynomial.Polynomial([COULOMB, VISCOUS, 0.0, CUBIC])
    assert polynomial.deriv()(LOGGED) < 0 < polynomial(LOGGED)
    return float(np.sign(speed) * polynomial(min(abs(speed), LOGGED)))


def states(result: Result, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Speeds and accelerations (N, n): these make loads far beyond any log."""
    qd = speeds(len(result.robot.actuated), rng)
    return qd, rng.normal(0.0, 300.0, qd.shape)
