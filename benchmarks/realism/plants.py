"""The robots whose logs are made: their geometry, parameters drawn anew for each experiment, motions and payload."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.robot import Joint, Limits, Mdh, Robot
from gtau.simulation.trajectories import Envelope, envelope

sys.path.append(str(Path(__file__).parents[2] / "tests" / "support"))
from plausible_parameters import body_parameters, random_parameters

Parameters = Callable[[InverseDynamics, np.random.Generator], dict[str, float]]


@dataclass(frozen=True)
class Plant:
    """A robot as it is, and how it is logged.

    ``seconds`` and ``rate`` (Hz) of a run; ``mass`` (kg) of the payload, a disc about ``centre`` (m, in the frame of
    the body that carries it); ``gains`` are the range in which drive gains are drawn, (n, 2) or (2,) in N m/A.
    """

    robot: Callable[[], Robot]
    parameters: Parameters
    within: Callable[[Robot], Envelope]
    mass: float
    centre: tuple[float, float, float]
    gains: np.ndarray
    seconds: float = 16.0
    rate: float = 500.0

    @cached_property
    def model(self) -> InverseDynamics:
        return InverseDynamics(self.robot())

    def payload(self) -> dict[str, float]:
        """Inertial parameters of the payload, by kind: a disc of 80 mm radius."""
        spread = 0.08 / np.sqrt(2) * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
        named = body_parameters("", np.full(4, self.mass / 4), np.array(self.centre) + spread)
        return {name.rstrip("_"): value for name, value in named.items()}


ARM = Robot(
    "arm",
    (
        Joint("1", "ground", "revolute", Mdh(), limits=Limits(position=(-2.0, 2.0), velocity=3.0, acceleration=15.0)),
        Joint("2", "1", "revolute", Mdh(d=0.4), limits=Limits(position=(-2.0, 2.0), velocity=3.0, acceleration=15.0)),
    ),
    gravity=(0.0, -9.80665, 0.0),
)

# A UR10e that moves and rubs like the one of docs/evidence/measured. Links: mass in kg and centre in m in the frames
# of the catalog, by the maker's description; viscous and Coulomb friction, rotor inertias (the first two with the share
# that the links leave) and gains as identified from the pair of real runs; reach, speed and acceleration of those runs.
LINKS = (
    (7.78, (0.0, 0.0, 0.0)),
    (12.93, (0.3065, 0.0, 0.0)),
    (3.87, (0.2855, 0.0, 0.0)),
    (1.96, (0.0, 0.0, 0.0)),
    (1.96, (0.0, 0.0, 0.0)),
    (0.202, (0.0, 0.0, 0.09)),
)
UR10E: Mapping[str, np.ndarray] = {
    "ia": np.array([6.0, 6.0, 1.6, 0.48, 0.48, 0.47]),
    "fv": np.array([17.0, 25.0, 8.8, 3.4, 1.8, 2.7]),
    "fs": np.array([14.0, 11.0, 5.7, 2.8, 3.2, 2.5]),
    "off": np.array([0.2, 0.3, 0.1, 0.05, 0.05, 0.05]),
}
UR10E_GAINS = np.array([12.0, 12.0, 9.8, 10.8, 10.8, 10.3])
UR10E_MOTION = Envelope(
    center=np.array([0.0, -1.72, 0.12, -1.23, 0.0, 0.17]),
    reach=np.array([2.95, 1.52, 1.44, 1.18, 1.55, 1.57]),
    velocity=np.array([1.3, 1.0, 1.2, 0.85, 1.05, 1.25]),
    acceleration=np.array([1.4, 1.25, 1.2, 0.8, 1.0, 1.1]),
)


def ur10e_parameters(model: InverseDynamics, rng: np.random.Generator) -> dict[str, float]:
    """Links of six points of mass about their centres, drives with friction; all drawn within about 10 %."""
    chi: dict[str, float] = {}
    for joint, (mass, centre) in zip(model.actuated, LINKS, strict=True):
        points = np.array(centre) * rng.uniform(0.1, 1.9, (6, 1)) + rng.normal(0.0, 0.04, (6, 3))
        chi |= body_parameters(joint, mass * rng.dirichlet(np.full(6, 10.0)), points)
    for kind, values in UR10E.items():
        drawn = values * rng.uniform(0.9, 1.1, len(values)) * (rng.choice([-1, 1], len(values)) if kind == "off" else 1)
        chi |= {f"{kind}_{joint}": float(value) for joint, value in zip(model.actuated, drawn, strict=True)}
    return {name: value for name, value in chi.items() if name in model.parameter_names}


def rubbing_parameters(model: InverseDynamics, rng: np.random.Generator) -> dict[str, float]:
    """Random parameters whose passive joints have a tenth of the friction of motors, where the robot has it."""
    chi = random_parameters(model, rng)
    motors = {kind: np.mean([chi[f"{kind}_{joint}"] for joint in model.actuated]) for kind in ("fv", "fs")}
    passive = {name: 0.1 * motors[name[:2]] for name in model.parameter_names if name[:2] in motors}
    return passive | chi


def of_limits(robot: Robot) -> Envelope:
    return envelope(robot, 0.7)


def limited(reach: float, velocity: float, acceleration: float) -> Limits:
    return Limits(position=(-reach, reach), velocity=velocity, acceleration=acceleration)


SCARA = Robot(
    "scara",
    (
        Joint("1", "ground", "revolute", Mdh(), limits=limited(2.2, 4.0, 25.0)),
        Joint("2", "1", "revolute", Mdh(d=0.225), limits=limited(2.4, 6.0, 35.0)),
        Joint("3", "2", "revolute", Mdh(d=0.175), limits=limited(3.0, 8.0, 60.0)),
        Joint("4", "3", "prismatic", Mdh(), limits=limited(0.1, 0.9, 8.0)),
    ),
)
CYLINDRICAL = Robot(
    "cylindrical",
    (
        Joint("1", "ground", "revolute", Mdh(), limits=limited(2.5, 2.5, 12.0)),
        Joint("2", "1", "prismatic", Mdh(), limits=limited(0.25, 0.8, 5.0)),
        Joint("3", "2", "prismatic", Mdh(alpha=np.pi / 2, d=0.1, r=0.3), limits=limited(0.25, 0.8, 5.0)),
    ),
)
TURNS = np.pi / 2 * np.array([0, -1, 1, 1, -1, -1, 1])
SEVEN = Robot(
    "seven axes",
    tuple(
        Joint(
            str(k + 1),
            str(k) if k else "ground",
            "revolute",
            Mdh(alpha=turn, r=length),
            limits=limited(2.0, 2.0, 8.0),
        )
        for k, (turn, length) in enumerate(zip(TURNS, (0.36, 0, 0.42, 0, 0.4, 0, 0.126), strict=True))
    ),
)


def puma() -> Robot:
    """The catalog's, whose file has no limits of speed."""
    robot = load_robot("puma560")

    def slow(joint: Joint) -> Joint:
        low, high = joint.limits.position
        within = Limits(position=(max(low, -2.5), min(high, 2.5)), velocity=1.5, acceleration=6.0)
        return replace(joint, limits=within)

    return replace(robot, joints=tuple(map(slow, robot.joints)))


ANY = np.array([1.0, 5.0])
PLANTS: dict[str, Plant] = {
    "arm": Plant(lambda: ARM, random_parameters, of_limits, 2.0, (0.3, 0.02, 0.0), ANY),
    "five-bar": Plant(lambda: load_robot("five-bar"), rubbing_parameters, of_limits, 2.0, (0.35, 0.01, 0.0), ANY),
    "delta": Plant(lambda: load_robot("delta"), random_parameters, of_limits, 2.0, (0.02, 0.01, -0.05), ANY),
    "ur10e": Plant(
        lambda: load_robot("ur10e"),
        ur10e_parameters,
        lambda robot: UR10E_MOTION,
        2.805,
        (0.03, -0.02, 0.15),
        np.stack([0.9 * UR10E_GAINS, 1.1 * UR10E_GAINS], axis=1),
        seconds=40.0,
        rate=125.0,
    ),
    "scara": Plant(lambda: SCARA, random_parameters, of_limits, 1.5, (0.05, 0.03, 0.02), ANY),
    "cylindrical": Plant(lambda: CYLINDRICAL, random_parameters, of_limits, 2.0, (0.1, 0.05, 0.05), ANY),
    "seven": Plant(lambda: SEVEN, random_parameters, of_limits, 3.0, (0.05, 0.04, 0.1), ANY, 12.0, 200.0),
    "puma560": Plant(puma, random_parameters, of_limits, 2.5, (0.05, 0.03, 0.1), ANY, 10.0, 250.0),
    "3-rrr": Plant(lambda: load_robot("3-rrr"), rubbing_parameters, of_limits, 2.0, (0.03, 0.01, 0.0), ANY),
    "orthoglide": Plant(
        lambda: load_robot("orthoglide"), random_parameters, of_limits, 2.0, (0.03, 0.01, 0.02), ANY, rate=250.0
    ),
    "palletiser": Plant(
        lambda: load_robot("palletiser"), random_parameters, of_limits, 20.0, (0.1, 0.05, -0.1), ANY, rate=250.0
    ),
}
