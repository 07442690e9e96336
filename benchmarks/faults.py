"""Thirty faults in logs and files: what `gtau identify` says of each, the largest error of a gain, and the exit code.

    python benchmarks/faults.py five-bar [ur10e] [--out docs/evidence/coverage/faults.csv]

The logs are those of the tutorial (simulated) and a pair measured on a UR10e; each is spoilt in one way, at the joint
'left' or 'elbow_joint'. Errors are relative to the gains from the logs as they are. "Said" is the kind of finding that
decides the verdict of the worst gain, or the end of a refusal.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from textwrap import shorten
from typing import Any

import numpy as np
import polars as pl
import yaml
from table import write_csv

UR10E = "ur10e/ur-20_02_19_14harm50sec{}.csv"
Frames = list[pl.DataFrame]
Spoil = Callable[["Case"], None]


@dataclass
class Case:
    """Logs of a robot, the first ones without payload and the last with one, and their experiment file."""

    logs: Frames
    time: str
    position: dict[str, str]
    current: dict[str, str]
    payload: dict[str, Any]
    robot: str
    joint: str
    other: str
    payloads: list[dict[str, Any] | None] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.payloads = [None] * (len(self.logs) - 1) + [dict(self.payload)]

    def change(self, column: str, function: Callable[[np.ndarray], np.ndarray], runs: Sequence[int] = ()) -> None:
        """Replace a column in all logs, or some of them."""
        for k in runs or range(len(self.logs)):
            values = function(self.logs[k][column].to_numpy().astype(float))
            self.logs[k] = self.logs[k].with_columns(pl.Series(column, values))

    def swap(self, columns: dict[str, str]) -> None:
        """Exchange the columns of the two joints."""
        a, b = columns[self.joint], columns[self.other]
        self.logs = [log.rename({a: b, b: a}) for log in self.logs]

    def write(self, folder: Path) -> Path:
        """Write logs and experiment file."""
        runs = []
        for k, (log, payload) in enumerate(zip(self.logs, self.payloads, strict=True)):
            log.write_csv(folder / f"log_{k}.csv")
            runs.append({"log": f"log_{k}.csv"} | ({"payload": payload} if payload else {}))
        signals = {"time": self.time, "position": self.position, "current": self.current}
        path = folder / "experiment.yaml"
        path.write_text(yaml.safe_dump({"robot": self.robot, "signals": signals, "runs": runs}), encoding="utf-8")
        return path


def five_bar(data: Path, folder: Path) -> Case:
    """Take the logs of the tutorial."""
    subprocess.run([sys.executable, "-m", "gtau", "tutorial", str(folder / "t")], check=True, capture_output=True)
    logs = [pl.read_csv(folder / "t" / f"{name}.csv") for name in ("empty_1", "empty_2", "loaded_1200g")]
    position, current = ({joint: f"{letter}{joint}" for joint in ("left", "right")} for letter in "qv")
    return Case(logs, "t", position, current, {"name": "w", "mass": 1.2}, "five-bar", "left", "right")


def ur10e(data: Path, folder: Path) -> Case:
    """Take a pair of logs of a UR10e."""
    joints = [f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")]
    logs = [pl.read_csv(data / UR10E.format(end), has_header=False) for end in ("", "Load")]
    logs = [log.rename({name: f"c{k + 1}" for k, name in enumerate(log.columns)}) for log in logs]
    position, current = ({joint: f"c{k + first}" for k, joint in enumerate(joints)} for first in (2, 14))
    return Case(logs, "c1", position, current, {"name": "disc", "mass": 2.805}, "ur10e", "elbow_joint", "wrist_1_joint")


CASES = {"five-bar": five_bar, "ur10e": ur10e}


def current(function: Callable[[np.ndarray], np.ndarray], one_run: bool = False) -> Spoil:
    """Spoil the currents of the joint, in all runs or the last."""
    return lambda case: case.change(case.current[case.joint], function, [len(case.logs) - 1] if one_run else ())


def position(function: Callable[[np.ndarray], np.ndarray], one_run: bool = False) -> Spoil:
    """Spoil the positions of the joint, in all runs or the last."""
    return lambda case: case.change(case.position[case.joint], function, [len(case.logs) - 1] if one_run else ())


def every(columns: str, function: Callable[[np.ndarray], np.ndarray]) -> Spoil:
    """Spoil the ``position`` or ``current`` columns of all joints."""

    def spoil(case: Case) -> None:
        for column in getattr(case, columns).values():
            case.change(column, function)

    return spoil


def stamps(function: Callable[[np.ndarray], np.ndarray]) -> Spoil:
    """Spoil the time stamps."""
    return lambda case: case.change(case.time, function)


def mass(factor: float) -> Spoil:
    """State another mass."""
    return lambda case: case.payloads[-1].update(mass=factor * case.payload["mass"])  # type: ignore[union-attr]


def late(samples: int) -> Callable[[np.ndarray], np.ndarray]:
    """Delay a column."""
    return lambda x: np.concatenate([np.full(samples, x[0]), x[:-samples]])


def saturated(case: Case) -> None:
    """Let the motor's torque fall by a tenth towards the largest current of all logs."""
    column = case.current[case.joint]
    largest = max(np.abs(log[column].to_numpy()).max() for log in case.logs)
    case.change(column, lambda x: x * (1 + 0.1 * (x / largest) ** 2))


def frozen(x: np.ndarray) -> np.ndarray:
    """Stop at the middle."""
    return np.where(np.arange(len(x)) < len(x) // 2, x, x[len(x) // 2])


def renumbered(case: Case) -> None:
    """Drop packets of 5 samples, 2 % of all, and number the stamps anew."""
    rng = np.random.default_rng(1)
    for k, log in enumerate(case.logs):
        starts = np.flatnonzero(rng.random(len(log)) < 0.004)
        kept = np.setdiff1d(np.arange(len(log)), (starts[:, None] + np.arange(5)).ravel())
        case.logs[k] = log[kept].with_columns(log[case.time][: len(kept)])


def lowpassed(x: np.ndarray) -> np.ndarray:
    """Average over 51 samples."""
    return np.convolve(np.pad(x, 25, "edge"), np.full(51, 1 / 51), "valid")


def spikes(x: np.ndarray) -> np.ndarray:
    """Replace one sample in 200 by a large value."""
    return np.where(np.random.default_rng(2).random(len(x)) < 0.005, 20 * np.abs(x).max(), x)


def reordered(payloads: Callable[[Case], list[dict[str, Any] | None]]) -> Spoil:
    """State payloads of other runs."""

    def spoil(case: Case) -> None:
        case.payloads = payloads(case)

    return spoil


FAULTS: dict[str, Spoil] = {
    "none": lambda case: None,
    "sign of a current": current(np.negative),
    "sign of a current in one run": current(np.negative, one_run=True),
    "a current in mA": current(lambda x: 1000 * x),
    "all currents in mA": every("current", lambda x: 1000 * x),
    "a current halved in one run": current(lambda x: x / 2, one_run=True),
    "magnitude of a current": current(np.abs),
    "two currents swapped": lambda case: case.swap(case.current),
    "a current clipped at 60 %": current(lambda x: np.clip(x, -0.6 * np.abs(x).max(), 0.6 * np.abs(x).max())),
    "a current saturates (10 %)": saturated,
    "a current averaged over 51 samples": current(lowpassed),
    "spikes in a current": current(spikes),
    "a current 5 samples late": current(late(5)),
    "sign of a position": position(np.negative),
    "a position halved": position(lambda x: x / 2),
    "a position 5 % too large": position(lambda x: 1.05 * x),
    "an encoder's zero off by 2 degrees": position(lambda x: x + np.radians(2)),
    "two positions swapped": lambda case: case.swap(case.position),
    "a position frozen": position(lambda x: np.full_like(x, x[0])),
    "a position freezes in one run": position(frozen, one_run=True),
    "a position 5 samples late": position(late(5)),
    "degrees as radians": every("position", np.degrees),
    "stamps in ms": stamps(lambda t: 1000 * t),
    "clock 5 % fast": stamps(lambda t: 1.05 * t),
    "stamps renumbered after drops": renumbered,
    "grams for kilograms": mass(1000),
    "pounds for kilograms": mass(2.2046),
    "mass 5 % too large": mass(1.05),
    "payload not declared": reordered(lambda case: [None] * len(case.logs)),
    "payload on another run": reordered(lambda case: case.payloads[::-1]),
    "payload stated for all runs": reordered(lambda case: [dict(case.payload) for _ in case.logs]),
}


def outcome(path: Path) -> tuple[int, str, dict[str, float | None]]:
    """Identify: exit code, what is said, and the gains by joint."""
    command = [sys.executable, "-m", "gtau", "identify", str(path), "--out", str(path.parent / "out"), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    document = json.loads(done.stdout) if done.stdout.startswith("{") else {}
    if "drive_gains" not in document:
        refusal = document.get("error") or done.stderr.strip().splitlines()[-1].removeprefix("gtau: ")
        return done.returncode, shorten(refusal.replace(f"{path.parent}/", ""), 100, placeholder=" ..."), {}
    gains = {gain["joint"]: gain["value"] for gain in document["drive_gains"]}
    if "validation" in document:
        del document["validation"]
    return done.returncode, "; ".join(dict.fromkeys(_said(document))) or "-", gains


def _said(document: dict[str, Any]) -> Iterator[str]:
    """List the kinds of findings that decide verdicts, worst gains first, with the causes found beside them."""
    worst = [gain for gain in document["drive_gains"] if gain["outcome"] == "contradictory"]
    for gain in worst or [gain for gain in document["drive_gains"] if gain["outcome"] == "weak"]:
        finding = gain["finding"] or {}
        yield from filter(
            None, (" ".join(filter(None, map(finding.get, ("kind", "subject")))), *finding.get("causes", ()))
        )
    yield from (note["finding"] for note in document["notes"] if note["grade"] in ("warning", "contradictory"))


def rows(robot: str, data: Path) -> Iterator[tuple[str, str, str, str]]:
    """Try all faults on the logs of a robot: fault, exit code, largest error of a gain, what is said."""
    right: dict[str, float | None] = {}
    for fault, spoil in FAULTS.items():
        with TemporaryDirectory() as name:
            case = CASES[robot](data, Path(name))
            spoil(case)
            code, said, gains = outcome(case.write(Path(name)))
        right = right or gains
        errors = [abs(gains[joint] / value - 1) for joint, value in right.items() if value and gains.get(joint)]
        yield fault, str(code), f"{100 * max(errors):.2g} %" if errors else "refused", said


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="+", choices=CASES)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--out", type=Path, help="CSV file")
    arguments = parser.parse_args()
    lines = [("robot", "fault", "exit code", "largest error of a gain", "said")]
    for robot in arguments.robots:
        for cells in rows(robot, arguments.data.resolve()):
            lines.append((robot, *cells))
            print(" | ".join(lines[-1]), flush=True)
    if arguments.out:
        write_csv(arguments.out, lines)


if __name__ == "__main__":
    main()
