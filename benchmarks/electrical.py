"""Drive gains from voltages alone: errors, verdicts, and how many 95 % intervals hold the truth.

    python benchmarks/electrical.py [--arms N] [--csv docs/evidence/scale/voltages.csv]

Simulated arms with servos as an SO-101 has them (12 bits of duty and position, 50 Hz, a 7.4 V supply), a UR10e and a
five-bar with field-oriented drives. All have a bridge with dead time, windings that warm up by 15 %, a supply that
sags, iron that saturates by 5 %, gears with an efficiency of 0.97, and torque constants that differ from the back-EMF
constants by 1.5 % (standard deviation); the logs are 30 s of unloaded motion. The SO-101 needs ../shared/data.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, field
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
from gtau.signals.reading.statements import Drive
from gtau.signals.run import Run
from gtau.simulation.trajectories import envelope, sines

ARM = Path(__file__).parents[2] / "shared" / "data" / "so101" / "so101_new_calib.urdf"
SECONDS, RATE = 30.0, 200.0  # s, Hz of the simulation
SATURATION, EFFICIENCY, COMMUTATION = 0.05, 0.97, 0.015


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


def identified(kind: Kind, seed: int) -> tuple[IdentifiedModel, np.ndarray]:
    """Simulate and identify an arm with random parameters; the true gains, too."""
    robot, rng = load_robot(kind.robot), np.random.default_rng([7, seed])
    model, supply = InverseDynamics(robot), kind.motors["supply"]
    chi = {name: kind.masses * value for name, value in random_parameters(model, rng).items()}
    time = np.arange(round(SECONDS * RATE) + 1) / RATE
    q, qd, qdd = sines(envelope(robot, kind.motion), SECONDS, rng)(time)
    tau = model.torques(q, qd, qdd, chi)
    tau += (1 - EFFICIENCY) * np.abs(tau) * np.sign(qd)
    n = len(model.actuated)
    gains = np.exp(0.2 * rng.normal(size=n)) * 0.35 * supply * kind.motors.get("convention", 1) / np.abs(qd).max(axis=0)
    current = tau / gains
    current *= 1 + SATURATION * np.abs(current) / np.abs(current).max(axis=0)
    resistance = 0.25 * supply / float(np.abs(current).max(axis=0).mean())
    motors = Motors(gains, commutation=1 + COMMUTATION * rng.normal(size=n), resistance=resistance, **kind.motors)
    run = motors.logged(Run(f"arm {seed}", model.actuated, time, q, current), "duty")
    step = 2 * np.pi / 2**kind.bits
    run = Run(run.name, run.joints, run.time, np.round(run.position / step) * step, run.command, log=run.log)
    convention = "amplitude" if "convention" in kind.motors else "dc"
    drives = {joint: Drive(convention=convention) for joint in model.actuated}
    return identify_subject(Subject(robot, [run], Options(drives=drives))), gains


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--arms", type=int, default=7, help="of each kind")
    parser.add_argument("--only", default="", help="kinds whose name contains this")
    parser.add_argument("--csv", type=Path, help="the file of the table")
    options = parser.parse_args()
    rows = []
    for name, kind in KINDS.items():
        gains: list[tuple[float, float, float, bool, bool]] = []  # error and std, half width (relative), holds, good
        refused = 0
        for seed in range(options.arms if options.only in name else 0):
            try:
                result, truth = identified(kind, seed)
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
