"""Drive gains from voltages alone: errors, verdicts, and how many 95 % intervals hold the truth.

    python benchmarks/electrical.py [--arms N] [--first SEED] [--csv docs/evidence/scale/voltages.csv]

Simulated arms with servos as an SO-101 has them (12 bits of duty and position, 50 Hz, a 7.4 V supply), a UR10e and a
five-bar with field-oriented drives. All have a bridge with dead time, windings that warm up by 15 %, a supply that
sags, iron that saturates by 5 %, gears that lose 3 % of the torque that they transmit to the links, and torque
constants that differ from the back-EMF constants by 1.5 % (standard deviation); the logs are 30 s of unloaded motion.
The SO-101 needs ../shared/data.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from table import write_csv

sys.path.append(str(Path(__file__).parents[1] / "tests" / "support"))
from motor_logs import Motors
from plausible_parameters import random_parameters

from gtau.errors import GtauError
from gtau.estimation.experiment_runs import Options, Subject
from gtau.estimation.identify import identify_subject
from gtau.estimation.results.result import IdentifiedModel
from gtau.findings import Grade
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.signals.reading.statements import Drive, Payload
from gtau.signals.run import Run
from gtau.simulation.trajectories import envelope, sines

ARM = Path(__file__).parents[2] / "shared" / "data" / "so101" / "so101_new_calib.urdf"
SECONDS, RATE = 30.0, 200.0  # s, Hz of the simulation
SATURATION, EFFICIENCY, COMMUTATION = 0.05, 0.97, 0.015
PAYLOAD = 2.0  # kg, times the scale of the masses
MOTOR_SIDE = "ia_", "fv_", "fs_", "off_"  # rotor, its friction and offset, which the gear does not transmit


@dataclass(frozen=True)
class Kind:
    """A kind of arm: its robot, share of the speed limits, scale of the masses, bits of the encoders, and motors."""

    robot: str
    motion: float
    masses: float
    bits: int
    motors: dict[str, float] = field(default_factory=dict)


HARD = {"dead": 0.02, "warming": 0.15, "noise": 0.01}
KINDS = {
    "SO-101": Kind(str(ARM), 0.5, 1 / 16, 12,
                   HARD | {"supply": 7.4, "sag": 0.2, "bits": 12, "rate": 50.0}),
    "UR10e": Kind("ur10e", 0.7, 1.0, 18, HARD | {"supply": 48.0, "sag": 0.05, "bits": 14, "convention": 1.5}),
    "five-bar": Kind("five-bar", 0.7, 1.0, 14, HARD | {"supply": 24.0, "sag": 0.05, "bits": 14, "convention": 1.5}),
}  # fmt: skip


def identified(name: str, seed: int, stated: float | None = None) -> tuple[IdentifiedModel, np.ndarray]:
    """Simulate and identify an arm with random parameters; the true gains, too.

    Beside a second run with a payload, of which the share ``stated`` of its mass is stated.
    """
    kind, rng = KINDS[name], np.random.default_rng([seed, *name.encode()])  # no two kinds share their draws
    robot = load_robot(kind.robot)
    model, supply = InverseDynamics(robot), kind.motors["supply"]
    chi = {name: kind.masses * value for name, value in random_parameters(model, rng).items()}
    time = np.arange(round(SECONDS * RATE) + 1) / RATE
    n, step, motors, runs = len(model.actuated), 2 * np.pi / 2**kind.bits, None, []
    for mass in (0.0,) if stated is None else (0.0, PAYLOAD * kind.masses):
        q, qd, qdd = sines(envelope(robot, kind.motion), SECONDS, rng)(time)
        loaded = chi | {f"m_{robot.tool}": chi[f"m_{robot.tool}"] + mass} if mass else chi
        transmitted = {key: 0.0 if key.startswith(MOTOR_SIDE) else value for key, value in loaded.items()}
        tau = model.torques(q, qd, qdd, loaded)
        tau += (1 - EFFICIENCY) * np.abs(model.torques(q, qd, qdd, transmitted)) * np.sign(qd)
        if motors is None:
            gains = np.exp(0.2 * rng.normal(size=n)) * 0.35 * supply / np.abs(qd).max(axis=0)
            gains *= kind.motors.get("convention", 1)
            largest = np.abs(tau / gains).max(axis=0)
            ratio = 1 + COMMUTATION * rng.normal(size=n)
            resistance = 0.25 * supply / float(largest.mean()) / (1 + SATURATION)
            motors = Motors(gains, commutation=ratio, resistance=resistance, seed=seed, **kind.motors)
        current = tau / gains
        current *= 1 + SATURATION * np.abs(current) / largest
        motors = replace(motors, seed=seed + 1000 * len(runs))  # of its noise
        run = motors.logged(Run(f"{mass:g} kg", model.actuated, time, q, current), "duty")
        payload = Payload(name="steel", mass=stated * mass) if stated and mass else None
        runs.append(replace(run, position=np.round(run.position / step) * step, payload=payload))
    convention = "amplitude" if "convention" in kind.motors else "dc"
    drives = {joint: Drive(convention=convention) for joint in model.actuated}
    return identify_subject(Subject(robot, runs, Options(drives=drives))), gains


def payloads_found(name: str, seeds: range, wrong: float) -> str:
    """Say how many masses that are wrong by a share either way are found, and how many right ones are refused."""
    light, right, heavy = (
        sum(not identified(name, seed, stated)[0].believable for seed in seeds)
        for stated in (1 - wrong, 1.0, 1 + wrong)
    )
    return f"{name}: of {len(seeds)} each {light} too light and {heavy} too heavy are found, {right} right ones refused"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--arms", type=int, default=7, help="of each kind")
    parser.add_argument("--first", type=int, default=200, help="seed of the first arm")
    parser.add_argument("--only", default="", help="kinds whose name contains this")
    parser.add_argument("--csv", type=Path, help="the file of the table")
    parser.add_argument("--payload", type=float, help="instead, the share by which the mass of a payload is wrong")
    options = parser.parse_args()
    rows = []
    for name in KINDS:
        gains: list[tuple[float, float, float, bool, bool]] = []  # error and std, half width (relative), holds, good
        refused = 0
        seeds = range(options.first, options.first + (options.arms if options.only in name else 0))
        if options.payload is not None:
            print(payloads_found(name, seeds, options.payload), flush=True)
            continue
        for seed in seeds:
            try:
                result, truth = identified(name, seed)
            except GtauError as error:
                refused += 1
                print(f"{name}, arm {seed}: {error}", file=sys.stderr)
                continue
            for gain, true in zip(result.drive_gains.values(), truth.tolist(), strict=True):
                low, high = gain.interval() or (np.nan, np.nan)
                good = gain.verdict.outcome == Grade.GOOD
                gains.append((gain.value / true - 1, (gain.std or np.nan) / true, (high - low) / true / 2,
                              low <= true <= high, good))  # fmt: skip
            errors = ", ".join(f"{100 * error:.2f}" for error, *_ in gains[-len(truth) :])
            print(f"{name}, arm {seed}, errors in %: {errors}", file=sys.stderr, flush=True)
        if not gains:
            continue
        error, std, half, holds, good = np.array(gains, dtype=float).T
        rows.append({
            "arms": name,
            "gains": len(error),
            "refused arms": refused,
            "rms error, %": f"{100 * np.sqrt(np.mean(error**2)):.2f}",
            "median half width, %": f"{100 * np.median(half):.2f}",
            "intervals that hold": int(holds.sum()),
            "rms of error over std": f"{np.sqrt(np.mean((error / std) ** 2)):.2f}",
            "good": int(good.sum()),
            "good and off by over 3 %": int(np.sum((np.abs(error) > 0.03) & (good > 0))),
        })  # fmt: skip
        print(rows[-1], flush=True)
    if options.csv:
        write_csv(options.csv, [list(rows[0]), *([str(value) for value in row.values()] for row in rows)])


if __name__ == "__main__":
    main()
