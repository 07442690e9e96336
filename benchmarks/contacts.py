"""Contacts of 5, 20 and 100 N laid over measured logs: delay and noise of the force that is estimated.

    python benchmarks/contacts.py                       # logs beside the checkout (../shared/data)

A model is identified from the first runs of a row of the zoo. From the motors' torques of a validation run those of a
force are taken that acts at the flange along x, y and z of its frame in turn, 0.4 s long every 0.8 s, and rises in
10 ms. A contact is found where its force exceeds more standard deviations than any force estimated without contacts:
none is found in vain. The noise is the median force without contacts, of those that the pose shows.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parent))
from zoo import ENTRIES

from gtau.estimation.experiment_runs import read_runs
from gtau.result import Result, identify
from gtau.robots.placement import WrenchFrame
from gtau.robots.robot import Pose
from gtau.signals.reading.experiment import read_experiment
from gtau.signals.run import Run
from gtau.uses.external_torques import momentum_observer, predict_under_load, wrench_along_log

LOGS = ("ur10e", "rokae_sensor")
FORCES = (5.0, 20.0, 100.0)  # N
BANDWIDTHS = (2.0, 5.0, 20.0)  # Hz
FIRST, EVERY, LENGTH, RISE = 2.0, 0.8, 0.4, 0.01  # s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    arguments = parser.parse_args()
    print("| robot | estimate | noise, N | threshold, N | half of a step after, ms |", end="")
    print("".join(f" {force:g} N found, % | after, ms |" for force in FORCES))
    print("| --- | --- |" + " ---: |" * (3 + 2 * len(FORCES)))
    for entry in (entry for entry in ENTRIES if entry.name in LOGS):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "experiment.yaml"
            path.write_text(entry.write(arguments.data, Path(folder)), encoding="utf-8")
            experiment = read_experiment(path)
            result = identify(experiment)
            run = next(iter(read_runs(experiment, experiment.validation or experiment.runs)))
            for line in rows(result, run):
                print(f"| {entry.robot}, {run.rate:.0f} Hz | {line}", flush=True)


def rows(result: Result, run: Run) -> Iterator[str]:
    """Yield a row of each estimate."""
    onsets = np.arange(FIRST, run.time[-1] - run.time[0] - EVERY, EVERY) + run.time[0]
    pressed = [pushed(result, run, onsets, force) for force in FORCES]
    for bandwidth in (None, *BANDWIDTHS):
        free, std = forces(result, run, bandwidth)
        found = [forces(result, each, bandwidth)[0] for each in pressed]
        free[run.time < run.time[0] + 1.0] = np.nan
        threshold = std * np.nanmax(np.abs(free / std), axis=0)  # (N, 3)
        noise = np.nanmedian(np.abs(free))
        cells = []
        near = [(run.time > onset - 0.2) & (run.time < onset + LENGTH) for onset in onsets]
        whole = [(k, onset) for k, onset in enumerate(onsets) if np.isfinite(free[near[k], k % 3]).all()]
        for each in found:
            delays = [delay(run.time, each[:, k % 3], onset, threshold[:, k % 3]) for k, onset in whole]
            seen = [d for d in delays if np.isfinite(d)]
            cells += [f"{100 * len(seen) / len(delays):.0f}", f"{1e3 * np.median(seen):.0f}" if seen else "-"]
        response = (found[-1] - free) / FORCES[-1]
        half = [delay(run.time, response[:, k % 3], onset, np.full(len(free), 0.5)) for k, onset in whole]
        name = "zero-phase" if bandwidth is None else f"observer, {bandwidth:g} Hz"
        cells = [f"{noise:.1f}", f"{np.nanmedian(threshold):.0f}", f"{1e3 * np.nanmedian(half):.0f}", *cells]
        yield f"{name} ({len(whole)} contacts) | {' | '.join(cells)} |"


def shape(time: np.ndarray, onsets: np.ndarray) -> np.ndarray:
    """Compute the force (N, 3) of unit size at any times."""
    found = np.zeros((len(time), 3))
    for k, onset in enumerate(onsets):
        found[:, k % 3] += np.clip((time - onset) / RISE, 0, 1) * (time < onset + LENGTH)
    return found


def pushed(result: Result, run: Run, onsets: np.ndarray, force: float) -> Run:
    """Take the torques of the contacts from the commands, each at its delayed time."""
    model, n = result.idm, len(run.joints)
    columns = model.wrenches([WrenchFrame(result.robot.tool)])
    motion = model.motion(run.position.T, 0 * run.position.T, 0 * run.position.T)
    A = np.zeros((len(run.time), n, 6))
    columns.fill(model.layout, motion, A)
    command = np.array(run.command)
    for j, joint in enumerate(run.joints):
        at = shape(run.time + (result.delays[joint].value or 0.0), onsets)  # v(t - d) g = tau(t)
        command[:, j] -= force * np.einsum("ix,ix->i", A[:, j, 3:], at) / result.gains[j]
    return replace(run, command=command)


def forces(result: Result, run: Run, bandwidth: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Estimate forces (N, 3) at the flange, by the zero-phase estimate or the observer, and their deviations."""
    prediction = predict_under_load(result, run).in_band
    if bandwidth is not None:
        observed = momentum_observer(result, run, bandwidth)
        prediction = replace(prediction, measured=prediction.predicted - observed)
    found = wrench_along_log(result, run, prediction, ("flange", Pose()))
    valid = prediction.valid.all(axis=1)[:, None]
    return np.where(valid, found.wrench[:, 3:], np.nan), found.interval[:, 3:] / 1.96


def delay(time: np.ndarray, force: np.ndarray, onset: float, threshold: np.ndarray) -> float:
    """Find how long after its onset a contact exceeds a threshold; negative where the estimate knows what follows."""
    near = (time > onset - 0.2) & (time < onset + LENGTH)
    beyond = np.flatnonzero(near & (force > threshold))
    return float(time[beyond[0]] - onset) if beyond.size else np.nan


if __name__ == "__main__":
    main()
