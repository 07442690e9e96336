"""One thing at a time in which a log departs from the model, or a description from the robot."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from gtau.robots.robot import Mdh, Pose, Robot
from gtau.simulation.trajectories import (
    REST,
    Envelope,
    PointToPoint,
    Trajectory,
    moves_through,
    point_to_point,
    sines,
)

Torque = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, "Drives"], np.ndarray]
Current = Callable[[np.ndarray, float, np.random.Generator, "Drives"], np.ndarray]
Deflection = Callable[[np.ndarray, np.ndarray, float], np.ndarray]
STRIBECK_SPEED = 0.1  # rad/s
GEAR = 100.0  # turns of the wave generator in a turn of the joint


@dataclass(frozen=True, eq=False)
class Drives:
    """What the drives' departures are measured by, (n,) each: rms torque, speed and peak current in the first run.

    They are the same in all runs: a motor does not know which payload it carries.
    """

    torque: np.ndarray
    speed: np.ndarray
    current: np.ndarray

    @property
    def friction(self) -> np.ndarray:
        """A friction torque of common size, (n,): a tenth of the rms torque."""
        return 0.1 * self.torque


@dataclass(frozen=True)
class Departure:
    """What differs from the model; all off is the baseline.

    Attributes
    ----------
    rate : float, optional
        Of the log, Hz, where it is not the plant's own.
    motion : callable
        Makes a trajectory from an envelope, a duration and random numbers.
    torque : callable, optional
        Torques (N, n) added to the motors' from (time, q, qd, torques, the part of these that the links take, drives).
    deflection : callable, optional
        By how much the motors' positions, which are logged, lead the links', (N, n) in rad, from the torques that the
        transmissions carry (N, n), the inertia about each joint (n,), and the rate.
    current, position, stamps : callable, optional
        Change what is logged, from (currents, rate, rng, drives), (positions, rng) and (time, rng).
    robot : callable, optional
        The robot that identification is told of.
    mass : float
        Factor of the payload's mass that is declared.
    centre_off : float, optional
        The payload's centre is declared, so many m off along x; without it only the mass is.
    wrong : bool
        Whether a description is wrong that no log can be blamed for.
    invisible : str
        Why no data can show it, where none can.
    repeated : bool
        Whether a run with the payload repeats the motion of the one without before it.
    """

    rate: float | None = None
    motion: Callable[[Envelope, float, np.random.Generator], Trajectory] = sines
    torque: Torque | None = None
    deflection: Deflection | None = None
    current: Current | None = None
    position: Callable[[np.ndarray, np.random.Generator], np.ndarray] | None = None
    stamps: Callable[[np.ndarray, np.random.Generator], np.ndarray] | None = None
    robot: Callable[[Robot], Robot] | None = None
    mass: float = 1.0
    centre_off: float | None = None
    wrong: bool = False
    invisible: str = ""
    repeated: bool = False


# What is logged


def bits(number: int) -> Departure:
    quantum = 2 * np.pi / 2**number
    return Departure(position=lambda q, rng: np.round(q / quantum) * quantum)


def low_passed(lag: float) -> Departure:
    def filtered(v: np.ndarray, rate: float, rng: np.random.Generator, drives: Drives) -> np.ndarray:
        from scipy.signal import lfilter, lfilter_zi

        a = np.exp(-1 / (lag * rate))
        b, den = [1 - a], [1.0, -a]
        return lfilter(b, den, v, axis=0, zi=lfilter_zi(b, den)[:, None] * v[:1])[0]

    return Departure(current=filtered)


def held(period: float) -> Departure:
    def steps(v: np.ndarray, rate: float, rng: np.random.Generator, drives: Drives) -> np.ndarray:
        samples = max(round(period * rate), 2)
        return v[np.arange(len(v)) // samples * samples]

    return Departure(current=steps)


def noisy(share: float) -> Departure:
    return Departure(
        current=lambda v, rate, rng, drives: v + share * np.sqrt(np.mean(v**2, axis=0)) * rng.standard_normal(v.shape)
    )


def quantised(share: float) -> Departure:
    return Departure(current=lambda v, rate, rng, drives: (step := share * np.abs(v).max(axis=0)) * np.round(v / step))


def saturating(share: float) -> Departure:
    return Departure(current=lambda v, rate, rng, drives: v * (1 + share * np.abs(v) / drives.current))


def jitter(share: float) -> Departure:
    def late(time: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        step = time[1] - time[0]
        return np.maximum.accumulate(time + share * step * rng.uniform(0, 1, len(time))) + 1e-9 * np.arange(len(time))

    return Departure(stamps=late)


def stale(share: float) -> Departure:
    def repeated(q: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        fresh = rng.uniform(size=len(q)) >= share
        fresh[0] = True
        return q[np.maximum.accumulate(np.where(fresh, np.arange(len(q)), 0))]

    return Departure(position=repeated)


# How the robot moves


def through(within: Envelope, duration: float, targets: Iterator[np.ndarray], rest: float = REST) -> PointToPoint:
    """Moves from the center through endless targets, -1 to 1 of the reach: one at least, and all that end in time."""
    points, planned = [within.center], None
    while True:
        points.append(within.center + within.reach * next(targets))
        longer = moves_through(np.array(points), within, rest)
        if planned is not None and longer.starts[-1] + longer.spans[-1] > duration:
            return planned
        planned = longer


def one_joint(within: Envelope, duration: float, rng: np.random.Generator) -> PointToPoint:
    """Each joint in turn, the others at rest."""

    def targets() -> Iterator[np.ndarray]:
        n = len(within.center)
        now, k = np.zeros(n), 0
        while True:
            now = now.copy()
            now[k % n] = rng.uniform(0.3, 1.0) * (-1.0 if now[k % n] > 0 else 1.0)
            k += 1
            yield now

    return through(within, duration, targets())


def pick_and_place(within: Envelope, duration: float, rng: np.random.Generator) -> PointToPoint:
    """The same cycle over and over: down, up, across, down, up, across, with 0.3 s of rest after each."""
    ends = rng.uniform(-0.8, 0.8, (2, len(within.center)))
    above = ends + 0.2 * rng.choice([-1.0, 1.0], len(within.center))
    cycle = [above[0], ends[0], above[0], above[1], ends[1], above[1]]

    def targets() -> Iterator[np.ndarray]:
        while True:
            yield from cycle

    return through(within, duration, targets(), rest=0.3)


# What the drives do beside the model


def cooling(share: float) -> Departure:
    """Coulomb friction that falls along a run."""
    return Departure(
        torque=lambda time, q, qd, tau, carried, drives: (
            -share * (time / time[-1])[:, None] * drives.friction * np.sign(qd)
        )
    )


def thinning(share: float) -> Departure:
    """Viscous friction, of half the torque at the rms speed, that falls along a run."""

    def torque(
        time: np.ndarray, q: np.ndarray, qd: np.ndarray, tau: np.ndarray, carried: np.ndarray, drives: Drives
    ) -> np.ndarray:
        slope = 5.0 * drives.friction / drives.speed
        return -share * (time / time[-1])[:, None] * slope * qd

    return Departure(torque=torque)


def ripple(share: float, periods: float) -> Departure:
    return Departure(
        torque=lambda time, q, qd, tau, carried, drives: share * np.sqrt(2) * drives.torque * np.sin(periods * q + 1.0)
    )


def strain_wave(share: float) -> Departure:
    """Two ripples a turn of the wave generator, and one half as large."""

    def torque(
        time: np.ndarray, q: np.ndarray, qd: np.ndarray, tau: np.ndarray, carried: np.ndarray, drives: Drives
    ) -> np.ndarray:
        shape = np.sin(2 * GEAR * q + 1.0) + 0.5 * np.sin(GEAR * q)
        return share * np.sqrt(2) * drives.torque * shape

    return Departure(torque=torque)


STRIBECK = Departure(
    torque=lambda time, q, qd, tau, carried, drives: (
        0.5 * drives.friction * np.sign(qd) * np.exp(-np.abs(qd) / STRIBECK_SPEED)
    )
)


def presliding(width: float) -> Departure:
    """Friction whose contacts bend over a width, rad, before they slide."""

    def torque(
        time: np.ndarray, q: np.ndarray, qd: np.ndarray, tau: np.ndarray, carried: np.ndarray, drives: Drives
    ) -> np.ndarray:
        states = np.empty_like(q)
        states[0] = np.sign(qd[1])
        for k, step in enumerate(np.diff(q, axis=0) / width, start=1):
            states[k] = np.clip(states[k - 1] + step, -1.0, 1.0)
        return drives.friction * states

    return Departure(torque=torque)


LOAD_FRICTION = Departure(torque=lambda time, q, qd, tau, carried, drives: 0.05 * np.abs(carried) * np.sign(qd))
LOSSES = Departure(
    torque=lambda time, q, qd, tau, carried, drives: 0.05 * np.abs(tau) * np.sign(qd),
    invisible="where friction exceeds what the links take, the motor drives nearly always, and a gear that loses a "
    "share of all that it transmits is the same as a smaller gain",
)


def elastic(frequency: float) -> Departure:
    """Transmissions on which the inertia about each joint swings at this frequency, Hz."""
    return Departure(deflection=lambda tau, inertia, rate: tau / (inertia * (2 * np.pi * frequency) ** 2))


def backlash(gap: float) -> Departure:
    """The motor crosses the gap (rad) within some 40 ms where the torque that it transmits changes sign."""

    def across(tau: np.ndarray, inertia: np.ndarray, rate: float) -> np.ndarray:
        from scipy.ndimage import gaussian_filter1d

        return gap / 2 * gaussian_filter1d(np.sign(tau), 0.01 * rate, axis=0)

    return Departure(deflection=across)


def runs_differ(std: float) -> Departure:
    """Torque constants that differ from run to run."""
    return Departure(current=lambda v, rate, rng, drives: v * (1 + std * rng.standard_normal(v.shape[1])))


def together(*parts: Departure) -> Departure:
    """Several at once: torques add up, and currents pass from one to the next."""

    def torque(*at: object) -> np.ndarray:
        return sum(part.torque(*at) for part in parts if part.torque)

    def current(v: np.ndarray, rate: float, rng: np.random.Generator, drives: Drives) -> np.ndarray:
        for part in parts:
            v = part.current(v, rate, rng, drives) if part.current else v
        return v

    bent = [part.deflection for part in parts if part.deflection]
    return Departure(torque=torque, current=current, deflection=bent[0] if bent else None)


# What is said of the robot


def zeros(degrees: float) -> Departure:
    return Departure(position=lambda q, rng: q + np.radians(degrees) * (-1.0) ** np.arange(q.shape[1]), wrong=True)


def tilted(degrees: float) -> Departure:
    def tilt(robot: Robot) -> Robot:
        """Gravity turned towards the base's x axis, which is horizontal in all robots here."""
        gravity, angle = np.array(robot.gravity), np.radians(degrees)
        turned = np.cos(angle) * gravity + np.sin(angle) * np.linalg.norm(gravity) * np.array([1.0, 0.0, 0.0])
        return replace(robot, gravity=tuple(map(float, turned)))

    return Departure(robot=tilt, wrong=True)


def stretched(robot: Robot, factor: float) -> Robot:
    """The robot with its longest link of a moving joint another length."""

    def length(k: int) -> float:
        joint = robot.joints[k]
        return 0.0 if joint.antecedent == "ground" else float(np.linalg.norm(joint.placement.position))

    longest = max(range(len(robot.joints)), key=length)
    joint = robot.joints[longest]
    place = joint.placement
    if isinstance(place, Mdh):
        place = replace(place, d=factor * place.d, r=factor * place.r, b=factor * place.b)
    elif isinstance(place, Pose):
        place = replace(place, xyz=tuple(factor * x for x in place.xyz))
    return replace(
        robot, joints=(*robot.joints[:longest], replace(joint, placement=place), *robot.joints[longest + 1 :])
    )


SCALE = "with a single payload its mass scales all gains, and nothing else in the data depends on it"
DEPARTURES: dict[str, Departure] = {
    "none": Departure(),
    "stamps late by up to 30 % of a step": jitter(0.3),
    "5 % stale positions": stale(0.05),
    "encoders of 20 bits": bits(20),
    "encoders of 18 bits": bits(18),
    "encoders of 16 bits": bits(16),
    "encoders of 14 bits": bits(14),
    "encoders of 12 bits": bits(12),
    "20 Hz": Departure(rate=20.0),
    "50 Hz": Departure(rate=50.0),
    "2 kHz": Departure(rate=2000.0),
    "4 kHz": Departure(rate=4000.0),
    "point to point": Departure(motion=point_to_point),
    "pick and place": Departure(motion=pick_and_place),
    "one joint at a time": Departure(motion=one_joint),
    "current low-passed at 5 ms": low_passed(0.005),
    "current low-passed at 20 ms": low_passed(0.02),
    "current low-passed at 50 ms": low_passed(0.05),
    "current held for 10 ms": held(0.01),
    "current noisy by 3 %": noisy(0.03),
    "current in steps of 1 %": quantised(0.01),
    "torque constants falling by 5 %": saturating(0.05),
    "Stribeck friction": STRIBECK,
    "friction of 5 % of the links' torque": LOAD_FRICTION,
    "friction of 5 % of the whole torque": LOSSES,
    "Coulomb friction falling by 5 % along a run": cooling(0.05),
    "Coulomb friction falling by 20 % along a run": cooling(0.2),
    "viscous friction falling by 20 % along a run": thinning(0.2),
    "ripple of 1 %, 20 periods a turn": ripple(0.01, 20.0),
    "strain-wave ripple of 1 %, 200 periods a turn": strain_wave(0.01),
    "joints elastic at 30 Hz": elastic(30.0),
    "joints elastic at 10 Hz": elastic(10.0),
    "backlash of 1 mrad": backlash(1e-3),
    "encoder zeros off by 1 degree": zeros(1.0),
    "encoder zeros off by 3 degrees": zeros(3.0),
    "base tilted by 3 degrees": tilted(3.0),
    "a link 1 % longer": Departure(robot=lambda robot: stretched(robot, 1.01), wrong=True),
    "payload declared 30 mm off-centre": Departure(centre_off=0.03, wrong=True),
    "payload mass declared 5 % too high": Departure(mass=1.05, wrong=True, invisible=SCALE),
}

# What effects of physics stand for, one at a time and together
EFFECTS: dict[str, Departure] = {
    name: DEPARTURES[name]
    for name in (
        "none",
        "joints elastic at 30 Hz",
        "torque constants falling by 5 %",
        "friction of 5 % of the links' torque",
        "current low-passed at 5 ms",
        "Coulomb friction falling by 20 % along a run",
        "viscous friction falling by 20 % along a run",
    )
} | {
    "torque constants that differ by 0.5 % from run to run": runs_differ(0.005),
    "presliding over 3 mrad": presliding(0.003),
    "ripple of 1 % and Stribeck friction": together(ripple(0.01, 20.0), STRIBECK),
    "friction of three kinds": together(STRIBECK, cooling(0.2), LOAD_FRICTION),
    "nine at once": together(
        ripple(0.005, 20.0),
        STRIBECK,
        cooling(0.1),
        thinning(0.1),
        LOAD_FRICTION,
        elastic(30.0),
        saturating(0.02),
        low_passed(0.005),
        runs_differ(0.003),
    ),
}


# What the payload does not change stands in two runs that repeat a motion, and what depends on it in neither or one.


def common(shape: Callable[[np.ndarray], np.ndarray], share: float) -> Departure:
    """A torque of the positions, ``share`` of what rotors and friction take, rms, which is the same with a payload."""

    def torque(
        time: np.ndarray, q: np.ndarray, qd: np.ndarray, tau: np.ndarray, carried: np.ndarray, drives: Drives
    ) -> np.ndarray:
        return share * np.sqrt(2 * np.mean((tau - carried) ** 2, axis=0)) * shape(q)

    return Departure(torque=torque)


def coloured(share: float) -> Departure:
    """Noise of a joint's rms current whose correlation decays in 0.1 s."""

    def spoilt(v: np.ndarray, rate: float, rng: np.random.Generator, drives: Drives) -> np.ndarray:
        from scipy.signal import lfilter

        decay = np.exp(-1 / (0.1 * rate))
        white = np.sqrt(1 - decay**2) * rng.standard_normal((round(rate) + len(v), v.shape[1]))
        noise = lfilter([1.0], [1.0, -decay], white, axis=0)[-len(v) :]
        return v + share * np.sqrt(np.mean(v**2, axis=0)) * noise

    return Departure(current=spoilt)


def then_slow(departure: Departure) -> Departure:
    """Runs after the second at a fifth of the speed and acceleration; for one experiment."""
    run = count()

    def motion(within: Envelope, duration: float, rng: np.random.Generator) -> Trajectory:
        slow = replace(within, velocity=0.2 * within.velocity, acceleration=0.2 * within.acceleration)
        return departure.motion(within if next(run) < 2 else slow, duration, rng)

    return replace(departure, motion=motion)


SPOILT = {
    "nothing": Departure(),
    "ripple": common(lambda q: np.sin(20.0 * q + 1.0), 0.03),
    "cables": common(lambda q: np.sin(2.0 * q + 0.5 + np.arange(q.shape[1])), 0.05),
    "load-dependent friction": LOAD_FRICTION,
    "coloured noise": coloured(0.01),
}
MOTIONS = {
    f"{what}, motions {word}": replace(each, repeated=repeated)
    for repeated, word in ((False, "differ"), (True, "repeat"))
    for what, each in SPOILT.items()
}
