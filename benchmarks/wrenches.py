"""Gains whose scale rests on measured wrenches: errors, and how many of them the 95 % intervals hold.

    python benchmarks/wrenches.py [--sets N]

An arm of three joints, 20 s at 100 Hz, with noise of 0.5 N, 0.05 N m, 0.01 A and 2e-5 rad; its plant is Pinocchio's.
Its base floats and hangs on a force sensor (its position tracked with 0.05 mm), or it stands on its last link, whose
wrench a sensor in the sole or a force plate measures, or nothing acts on it and its mass is known to 0.1 %; or its base
is fixed, and a force sensor at the flange measures an unknown tool, which is carried in one of two runs.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import polars as pl

sys.path.append(str(Path(__file__).parents[1] / "tests" / "support"))
from floating_logs import AT_HOOK, AT_SOLE, GAINS, ON_PLATE, POSE, experiment, simulated

from gtau.errors import GtauError
from gtau.result import identify


def experiments(folder: Path, seed: int) -> Iterator[tuple[str, Path]]:
    """Write the logs of each way to measure a wrench, and yield its name and experiment file."""
    base = f"body: trunk, {POSE}"
    hung, standing = simulated(seed), simulated(seed, foot=1.0)
    yield "hook on the base", experiment(folder, f"{{{base}, wrenches: [{AT_HOOK}]}}", hung)
    yield "sensor in the sole", experiment(folder, f"{{{base}}}\n  wrenches: [{AT_SOLE}]", standing)
    yield "force plate under the foot", experiment(folder, f"{{{base}}}\n  wrenches: [{ON_PLATE}]", standing)
    path = experiment(folder, "", simulated(seed, moving=False), f"  wrenches: [{AT_SOLE}]")
    pl.DataFrame(simulated(seed + 1000, moving=False, tool=True).columns).write_csv(folder / "tool.csv")
    path.write_text(path.read_text().replace("runs: [", "runs: [{log: tool.csv}, "))
    yield "sensor at the flange", path


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=16)
    sets = parser.parse_args().sets
    errors: dict[str, list[np.ndarray]] = {}
    for seed in range(sets):
        with TemporaryDirectory() as folder:
            for name, path in experiments(Path(folder), seed):
                try:
                    result = identify(path)
                except GtauError as error:
                    print(f"{name}, set {seed}: {error}", file=sys.stderr)
                    continue
                found = [
                    (each.value - gain, each.std, each.interval()[0] <= gain <= each.interval()[1], each.value / gain)
                    for gain, each in ((gain, result.drive_gains[joint]) for joint, gain in GAINS.items())
                ]
                errors.setdefault(name, []).append(np.array(found))
    print(f"{'wrench':28} {'sets':>4} {'rms of errors, %':>18} {'rms, in std':>18} {'inside 95 %':>12}")
    for name, found in errors.items():
        difference, std, inside, ratio = np.moveaxis(np.array(found), -1, 0)
        percent = " ".join(f"{100 * np.sqrt(np.mean((each - 1) ** 2)):5.2f}" for each in ratio.T)
        scores = " ".join(f"{np.sqrt(np.mean(each**2)):5.2f}" for each in (difference / std).T)
        print(f"{name:28} {len(found):4} {percent:>18} {scores:>18} {int(inside.sum()):5} of {inside.size}")


if __name__ == "__main__":
    main()
