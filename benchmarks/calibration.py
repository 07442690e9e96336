"""Whether intervals and verdicts hold when one thing departs from the model: logs spoilt one departure at a time.

    python benchmarks/calibration.py five-bar arm --seeds 3

Each experiment has two runs without and two with a payload, 16 s each along sums of sines (or as the departure says),
friction that differs by 2 % from run to run, and current noise of 0.3 %. For each departure the table shows the error
of the worst gain, the rms of the gains' errors over their standard deviations (z), the share of 95 % intervals that
hold, and how many gains are good, good but off by more than 3 %, and contradictory.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from gtau.errors import GtauError
from gtau.estimation.diagnostics.verdict import Outcome
from gtau.estimation.identify import identify
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.geometry import characteristic_length
from gtau.robots.robot import INERTIAL, Joint, Limits, Mdh, Robot
from gtau.signals.run import Run, read_run
from gtau.simulation.trajectories import envelope, point_to_point, sines

SECONDS, RATE, NOISE, MASS = 16.0, 500.0, 0.003, 2.0
LOADED = (False, True, False, True)
ACCURACY = 0.03
ARM = Robot(
    "arm",
    (
        Joint("1", "ground", "revolute", Mdh(), limits=Limits(position=(-2.0, 2.0), velocity=3.0, acceleration=15.0)),
        Joint("2", "1", "revolute", Mdh(d=0.4), limits=Limits(position=(-2.0, 2.0), velocity=3.0, acceleration=15.0)),
    ),
    gravity=(0.0, -9.80665, 0.0),
)


@dataclass(frozen=True)
class Departure:
    """What differs from the model; all off is the baseline.

    ``torque`` adds to the torques (N, n) from (time, q, qd, torques, run), ``current`` changes the currents logged, and
    ``position`` the positions; ``robot`` is what is identified with, ``mass`` the factor of the mass that is declared.
    """

    torque: Callable[..., np.ndarray] | None = None
    current: Callable[[np.ndarray, float, np.random.Generator], np.ndarray] | None = None
    position: Callable[[np.ndarray, np.ndarray, np.random.Generator], np.ndarray] | None = None
    stamps: Callable[[np.ndarray, np.random.Generator], np.ndarray] | None = None
    robot: Callable[[Robot], Robot] | None = None
    rate: float = RATE
    motion: Callable = sines
    mass: float = 1.0


def bits(number: int) -> Callable[..., np.ndarray]:
    quantum = 2 * np.pi / 2**number
    return lambda q, tau, rng: np.round(q / quantum) * quantum


def low_pass(lag: float) -> Callable[..., np.ndarray]:
    def filtered(v: np.ndarray, rate: float, rng: np.random.Generator) -> np.ndarray:
        from scipy.signal import lfilter, lfilter_zi

        a = np.exp(-1 / (lag * rate))
        b, den = [1 - a], [1.0, -a]
        return lfilter(b, den, v, axis=0, zi=lfilter_zi(b, den)[:, None] * v[:1])[0]

    return filtered


def held(period: float) -> Callable[..., np.ndarray]:
    return lambda v, rate, rng: v[(np.arange(len(v)) // round(period * rate)) * round(period * rate)]


def zero(degrees: float) -> Callable[..., np.ndarray]:
    return lambda q, tau, rng: q + np.radians(degrees) * np.r_[0.0, np.ones(q.shape[1] - 1)]


def elastic(frequency: float) -> Callable[..., np.ndarray]:
    """Motor side of a transmission that gives way by the static torque over its stiffness (inertia of 1 kg m2)."""
    return lambda q, tau, rng: q + tau / (2 * np.pi * frequency) ** 2


def jitter(share: float) -> Callable[..., np.ndarray]:
    def late(time: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        step = time[1] - time[0]
        return np.maximum.accumulate(time + share * step * rng.uniform(0, 1, len(time))) + 1e-9 * np.arange(len(time))

    return late


def stale(share: float) -> Callable[..., np.ndarray]:
    def repeated(q: np.ndarray, tau: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        again = np.flatnonzero(rng.uniform(size=len(q)) < share)
        out = q.copy()
        out[again[again > 0]] = q[again[again > 0] - 1]
        return out

    return repeated


def tilted(degrees: float) -> Callable[[Robot], Robot]:
    def tilt(robot: Robot) -> Robot:
        x, y, z = robot.gravity
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        return replace(robot, gravity=(c * x - s * y, s * x + c * y, z))

    return tilt


def longer(robot: Robot) -> Robot:
    """The last joint's placement one per cent longer."""
    last = robot.joints[-1]
    place = last.placement
    moved = replace(place, d=1.01 * place.d) if isinstance(place, Mdh) else place
    return replace(robot, joints=(*robot.joints[:-1], replace(last, placement=moved)))


def friction_level(tau: np.ndarray) -> np.ndarray:
    return 0.1 * np.sqrt(np.mean(tau**2, axis=0))


DEPARTURES: dict[str, Departure] = {
    "none": Departure(),
    "stamps late by up to 30 % of a step": Departure(stamps=jitter(0.3)),
    "5 % stale positions": Departure(position=stale(0.05)),
    "encoders of 18 bits": Departure(position=bits(18)),
    "encoders of 14 bits": Departure(position=bits(14)),
    "encoders of 12 bits": Departure(position=bits(12)),
    "50 Hz": Departure(rate=50.0),
    "2 kHz": Departure(rate=2000.0),
    "point to point": Departure(motion=point_to_point),
    "current low-passed at 5 ms": Departure(current=low_pass(0.005)),
    "current low-passed at 20 ms": Departure(current=low_pass(0.02)),
    "current held for 10 ms": Departure(current=held(0.01)),
    "current noisy by 3 %": Departure(
        current=lambda v, rate, rng: v + 0.03 * np.sqrt(np.mean(v**2, axis=0)) * rng.standard_normal(v.shape)
    ),
    "current in steps of 1 %": Departure(
        current=lambda v, rate, rng: (q := 0.01 * np.abs(v).max(axis=0)) * np.round(v / q)
    ),
    "Stribeck friction": Departure(
        torque=lambda time, q, qd, tau, run: 0.5 * friction_level(tau) * np.sign(qd) * np.exp(-np.abs(qd) / 0.1)
    ),
    "friction falling by 5 % along a run": Departure(
        torque=lambda time, q, qd, tau, run: -0.05 * (time / time[-1])[:, None] * friction_level(tau) * np.sign(qd)
    ),
    "friction falling by 20 % along a run": Departure(
        torque=lambda time, q, qd, tau, run: -0.2 * (time / time[-1])[:, None] * friction_level(tau) * np.sign(qd)
    ),
    "ripple of 1 %, 20 periods a turn": Departure(
        torque=lambda time, q, qd, tau, run: 0.01 * np.sqrt(2 * np.mean(tau**2, axis=0)) * np.sin(20 * q + 1.0)
    ),
    "load-dependent friction of 5 %": Departure(torque=lambda time, q, qd, tau, run: 0.05 * np.abs(tau) * np.sign(qd)),
    "joints elastic at 30 Hz": Departure(position=elastic(30.0)),
    "joints elastic at 10 Hz": Departure(position=elastic(10.0)),
    "torque constants falling by 5 %": Departure(
        current=lambda v, rate, rng: v * (1 + 0.05 * np.abs(v) / np.abs(v).max(axis=0))
    ),
    "encoder zeros off by 1 degree": Departure(position=zero(1.0)),
    "encoder zeros off by 3 degrees": Departure(position=zero(3.0)),
    "base tilted by 3 degrees": Departure(robot=tilted(3.0)),
    "a link 1 % longer": Departure(robot=longer),
    "mass of the payload said 5 % too large": Departure(mass=1.05),
}


def parameters(model: InverseDynamics, rng: np.random.Generator) -> dict[str, float]:
    """Links of a few points of mass, and friction in every joint."""
    robot, chi = model.robot, {}
    length = characteristic_length(robot)
    for body in robot.bodies:
        mass, points = rng.uniform(0.1, 0.4, 6), length * rng.normal(0.0, 0.2, (6, 3))
        moment = sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(mass, points, strict=True))
        values = (*moment[np.triu_indices(3)], *(mass @ points), mass.sum())
        chi |= dict(zip((f"{kind}_{body}" for kind in INERTIAL), values, strict=True))
    for joint in robot.actuated:
        chi |= {f"ia_{joint}": length**2, f"off_{joint}": rng.normal(0.0, 0.3 * length)}
        chi |= {f"fv_{joint}": rng.uniform(4.0, 8.0) * length, f"fs_{joint}": rng.uniform(2.0, 5.0) * length}
    return {name: value for name, value in chi.items() if name in model.parameter_names}


def experiment(model: InverseDynamics, departure: Departure, seed: int) -> tuple[list[Run], np.ndarray]:
    """Runs spoilt by one departure, and the true gains (n,)."""
    rng = np.random.default_rng([11, seed])
    chi, n = parameters(model, rng), len(model.actuated)
    gains, tool, runs = rng.uniform(1.0, 5.0, n), f"m_{model.robot.tool}", []
    time = np.arange(round(SECONDS * departure.rate) + 1) / departure.rate
    for k, loaded in enumerate(LOADED):
        q, qd, qdd = departure.motion(envelope(model.robot, 0.7), SECONDS, rng)(time)
        drift = {name: value * (1 + 0.02 * k) for name, value in chi.items() if name.startswith(("fv_", "fs_"))}
        tau = model.torques(q, qd, qdd, {**chi, **drift, tool: chi[tool] + MASS * loaded})
        if departure.torque is not None:
            tau = tau + departure.torque(time, q, qd, tau, k)
        v = (tau + NOISE * np.sqrt(np.mean(tau**2, axis=0)) * rng.standard_normal(tau.shape)) / gains
        v = v if departure.current is None else departure.current(v, departure.rate, rng)
        q = q if departure.position is None else departure.position(q, tau, rng)
        stamps = time if departure.stamps is None else departure.stamps(time, rng)
        names = [f"{what}{j}" for what in ("q", "v") for j in range(n)]
        table = dict(zip(["t", *names], [stamps, *q.T, *v.T], strict=True))
        signals = {
            "time": "t",
            "position": {joint: f"q{j}" for j, joint in enumerate(model.actuated)},
            "current": {joint: f"v{j}" for j, joint in enumerate(model.actuated)},
        }
        payload = {"name": "disc", "mass": MASS * departure.mass} if loaded else None
        runs.append(replace(read_run(_frame(table), signals, payload), name=f"run {k + 1}"))
    return runs, gains


def _frame(table: dict[str, np.ndarray]) -> object:
    import polars as pl

    return pl.DataFrame(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("robots", nargs="+", help="catalog names, robot files, or 'arm'")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--only", help="departures whose name contains this")
    options = parser.parse_args()
    print(
        "| robot | departure | worst error, % | rms z | intervals that hold, % | good | good and off | contradictory |"
    )
    print("| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: |")
    for source in options.robots:
        model = InverseDynamics(ARM if source == "arm" else load_robot(source))
        for name, departure in DEPARTURES.items():
            if options.only and options.only not in name:
                continue
            print(f"| {source} | {name} | {_row(model, departure, range(options.seeds))} |", flush=True)


def _row(model: InverseDynamics, departure: Departure, seeds: range) -> str:
    robot = model.robot if departure.robot is None else departure.robot(model.robot)
    z, errors, holds, outcomes, refusals = [], [], [], [], set()
    for seed in seeds:
        try:
            runs, gains = experiment(model, departure, seed)
            with threadpool_limits(1, "blas"):
                result = identify(robot, runs)
        except GtauError as refusal:
            refusals.add(str(refusal))
            continue
        for gain, truth in zip(result.drive_gains.values(), gains, strict=True):
            low, high = gain.interval() or (np.nan, np.nan)
            errors.append(gain.value / truth - 1)
            z.append((gain.value - truth) / gain.std)
            holds.append(low < truth < high)
            outcomes.append(gain.verdict.outcome)
    if not errors:
        return f"refused: {min(refusals)} | | | | |"
    wrong = np.abs(errors) > ACCURACY
    good = np.array([each == Outcome.GOOD for each in outcomes])
    return " | ".join(
        [
            f"{100 * np.abs(errors).max():.2g}",
            f"{np.sqrt(np.mean(np.square(z))):.2f}",
            f"{100 * np.mean(holds):.0f}",
            f"{good.sum()} of {len(good)}",
            str(int((good & wrong).sum())),
            str(sum(each == Outcome.CONTRADICTORY for each in outcomes)),
        ]
    )


if __name__ == "__main__":
    main()
