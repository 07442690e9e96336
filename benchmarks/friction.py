"""Friction on all samples: torque errors on measured logs, and which terms of simulated friction are found.

    python benchmarks/friction.py                    # both tables
    python benchmarks/friction.py --logs             # measured logs beside the checkout (../shared/data)
    python benchmarks/friction.py --simulated 50     # so many logs of each kind

Errors of a log are rms torque errors over rms torques, geometric means over the joints, on runs or stretches that were
not used. The simulated joint follows five harmonics with friction of known kinds; its other torque is known, but for an
error that is white, coloured, a ripple locked to the position, or a wrong load.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np
from scipy.special import stdtrit

sys.path.append(str(Path(__file__).parent))
from zoo import ENTRIES

from gtau.estimation.experiment_runs import read_runs
from gtau.estimation.friction.identify import _of_group
from gtau.estimation.friction.normal_equations import Group
from gtau.estimation.friction.selection import Chosen, choose
from gtau.estimation.friction.sites import PLAIN, SPEEDS, WIDTHS, Site
from gtau.estimation.friction.stop import stop
from gtau.estimation.identify import identify
from gtau.estimation.results.result import Result
from gtau.signals.decimation import Decimator
from gtau.signals.experiment import read_experiment
from gtau.signals.run import Run

LOGS = ("ur10e", "panda", "tx40", "dvrk", "xmate7p", "rokae_motor")
RATE, BLOCKS, NOISE = 200.0, 20, 0.05  # Hz; of a log; of the rms torque
TRUTHS = ("viscous and Coulomb", "Maxwell slip", "LuGre", "Stribeck", "load")
ERRORS = ("white", "coloured", "ripple", "wrong load")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", action="store_true")
    parser.add_argument("--simulated", type=int, default=0)
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    arguments = parser.parse_args()
    if arguments.logs or not arguments.simulated:
        measured(arguments.data)
    if arguments.simulated or not arguments.logs:
        simulated(arguments.simulated or 50)


def measured(data: Path) -> None:
    """Print errors of logs that were not used, by the plain law and by friction of all samples."""
    print("| log | all samples, plain law | all samples | away from reversals, plain law | away from reversals | s |")
    print("| --- | ---: | ---: | ---: | ---: | ---: |")
    for entry in (entry for entry in ENTRIES if entry.name in LOGS):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "experiment.yaml"
            path.write_text(entry.write(data, Path(folder)), encoding="utf-8")
            experiment = read_experiment(path)
            begin = perf_counter()
            found = identify(experiment)
            seconds = perf_counter() - begin
            plain = replace(found, curves={})
            for run in read_runs(experiment, experiment.validation):
                made = [
                    np.array([(each.relative_all, each.relative) for each in result.validate(run)])
                    for result in (plain, found)
                ]
                (all_before, before), (all_after, after) = (np.exp(np.log(each).mean(axis=0)) for each in made)
                errors = " | ".join(f"{each:.2f}" for each in (all_before, all_after, before, after))
                print(f"| {entry.robot}, {run.name} | {errors} | {seconds:.0f} |")
                pairs = zip(made[0][:, 0], made[1][:, 0], strict=True)
                quiet = [largest(result, run) for result in (plain, found)]
                print(
                    "  largest, N m or N:", *(f"{one:.2g} -> {other:.2g}," for one, other in zip(*quiet, strict=True))
                )
                print("  joints, all samples:", *(f"{one:.1f} -> {other:.1f}," for one, other in pairs))


def largest(result: Result, run: Run) -> np.ndarray:
    """The largest error of each joint over all samples: the collision threshold without a false alarm on this run."""
    prediction = result.predict(run)
    return np.abs(np.where(prediction.valid, prediction.measured - prediction.predicted, 0.0)).max(axis=0)


def simulated(count: int) -> None:
    """Print the share of logs in which each term was taken, and of parameters in their 95 % intervals, per cent."""
    print("\n| friction | error | presliding | bent | load | false terms | in 95 % intervals |")
    print("| --- | --- | ---: | ---: | ---: | ---: | ---: |")
    right = dict(zip(TRUTHS, (set(), {"width"}, {"width"}, {"speed"}, {"load"}), strict=True))
    for truth in TRUTHS:
        for error in ERRORS:
            found: Counter[str] = Counter()
            inside: list[bool] = []
            for seed in range(count):
                group = experiment(truth, error, seed)
                chosen = choose(group)
                kinds = {kind for _, kind in chosen.evidence}
                inside += covered(group, chosen, truth) if kinds == right[truth] else []
                found.update(kinds)
                found["false"] += bool(kinds - right[truth])
            shares = " | ".join(f"{100 * found[kind] / count:.0f}" for kind in ("width", "speed", "load", "false"))
            share = f"{100 * np.mean(inside):.0f}" if inside else "-"
            print(f"| {truth} | {error} | {shares} | {share} |", flush=True)


def covered(group: Group, chosen: Chosen, truth: str) -> list[bool]:
    """Whether each parameter is in its interval."""
    (found,) = _of_group(group, chosen, np.zeros((0, 0)))
    true = {"off": 0.3, "fv": 0.8, "fs": 2.0} | ({"fb": 1.0} if truth == "Stribeck" else {})
    true |= {"fl": 0.1} if truth == "load" else {}
    half = stdtrit(found.freedom, 0.975)
    inside = [abs(found.values[kind] - value) <= half * (found.std[kind] or 0.0) for kind, value in true.items()]
    if truth == "Maxwell slip":
        width = group.sites[0].widths[0] / WIDTHS[0] * 10**-3.5
        inside.append(abs(found.shape.width - width) <= half * found.spread.width)
    return inside


def experiment(truth: str, error: str, seed: int) -> Group:
    """A joint's log of 30 s, reduced."""
    rng = np.random.default_rng(seed)
    t, h = np.arange(int(30 * RATE)) / RATE, np.arange(1, 6)
    phase = 2 * np.pi * 0.1 * h[:, None] * t
    q = (rng.normal(size=5) / h) @ np.sin(phase) + (rng.normal(size=5) / h) @ np.cos(phase)
    q *= 2.5 / np.ptp(q)
    v = np.gradient(q, t)
    rms, travel = float(np.sqrt(np.mean(v**2))), float(np.ptp(q))
    load = 10 * np.sin(q + rng.uniform(0, 6)) + 3 * np.gradient(v, t)
    site = Site("j", 0, np.ones(1), 0, travel * WIDTHS, rms * SPEEDS, rms, PLAIN, False)
    y = 0.3 + 0.8 * v + friction(truth, q, v, load, travel, rms)
    e = disturbance(error, q, load, rng) * NOISE * np.std(y)
    z = np.vstack([np.sign(v), stop(q, site.widths, np.full(len(site.widths), np.sign(v[0])))])
    rows = Decimator(20).apply(np.vstack([site.columns(v, z, load, 0.0), y + e]))
    place = np.arange(rows.shape[1]) * BLOCKS // rows.shape[1]
    G = np.array([[rows[:, place == b] @ rows[:, place == b].T] for b in range(BLOCKS)])
    columns, none = tuple((0, name) for name in site.names), np.zeros((0, 0))
    return Group((site,), columns, G, np.bincount(place), np.zeros((len(columns), 0)), (0,), none, none)


def friction(truth: str, q: np.ndarray, v: np.ndarray, load: np.ndarray, travel: float, rms: float) -> np.ndarray:
    """Friction of 2 N m of a kind; widths are 10^-3.5 of the travel."""
    width = travel * 10**-3.5
    if truth == "Maxwell slip":
        return 2 * stop(q, np.array([width]), np.sign(v[:1]))[0]
    if truth == "LuGre":
        z, steps = np.sign(v[0]), 5
        found = np.empty(len(v))
        for k, speed in enumerate(v):
            for _ in range(steps):  # implicit, so that it is stable at any speed
                z = (z + speed / (width * RATE * steps)) / (1 + abs(speed) / (width * RATE * steps))
            found[k] = z
        return 2 * found
    height = 2 + {"Stribeck": np.exp(-np.abs(v) / (0.1 * rms)), "load": 0.1 * np.abs(load)}.get(truth, 0.0)
    return height * np.sign(v)


def disturbance(error: str, q: np.ndarray, load: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """An error of about unit rms."""
    white = rng.normal(size=len(q))
    if error == "white":
        return 3 * white  # of which the low-pass takes most
    if error == "coloured":  # over 0.1 s
        from scipy.signal import lfilter

        c = np.exp(-10 / RATE)
        return lfilter([np.sqrt(1 - c * c)], [1, -c], white)
    if error == "ripple":
        return np.sqrt(2) * np.sin(30 * q + rng.uniform(0, 6)) + 0.2 * white
    return np.sqrt(2) * np.sin(2 * q + rng.uniform(0, 6)) + 0.3 * white + 0.5 * load / np.std(load)


if __name__ == "__main__":
    main()
