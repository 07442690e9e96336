"""Held-out logs played in MuJoCo by the robot's file, the identified model and draws of it; coverage of the draws.

    python benchmarks/sim_to_real.py [--sets N] [--draws N]

Played: from the measured state of every half second the logged currents drive the model, open loop, and its position is
compared with the measured one 0.1 and 0.5 s later, rms over windows and joints. "file": the URDF's inertias without
friction and armature, with the identified gains; "file, identified drives": with the identified friction too, and as
armature what the file's inertias leave of the identified sums. The spread of the draws is the standard deviation of
their positions at the same instants.

Coverage: of arms of which everything is known, the share of true base parameters and of gains in the central 95 % of
256 draws, over N experiments with other motions and noise, at two levels of it; beside it that of a box of +-10 %
about the estimates.
UR10e: logs and URDF of ../shared/data, if they are there.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np
from scipy.signal import butter, sosfiltfilt

sys.path.append(str(Path(__file__).parents[1] / "tests" / "support"))
from stated_arm import chi, plant, robot

from gtau.export.exported import export_model
from gtau.export.samples import Draws, draw
from gtau.result import Result, identify
from gtau.signals.reading.experiment import read_experiment
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run, read_run

ROOT = Path(__file__).parents[1]
STEP = 1e-3  # s
HORIZONS = (0.1, 0.5)  # s
GAINS = np.array([8.0, 8.0, 6.0, 5.0])
STEEL = {"m": 2.0, "mx": 0.1, "mz": 0.2, "xx": 0.04, "yy": 0.05, "zz": 0.02, "xz": -0.01}


def play(path: Path, time: np.ndarray, q: np.ndarray, current: np.ndarray) -> np.ndarray:
    """Positions (windows, horizons, n) that the model of a file reaches from measured states under logged currents."""
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.timestep = STEP
    data, qd = mujoco.MjData(model), np.gradient(q, time, axis=0)
    starts = np.arange(time[0] + 1.0, time[-1] - 1.0, HORIZONS[-1])
    found = np.zeros((len(starts), len(HORIZONS), q.shape[1]))
    for w, start in enumerate(starts):
        mujoco.mj_resetData(model, data)
        data.qpos, data.qvel = (np.array([np.interp(start, time, column) for column in each.T]) for each in (q, qd))
        for k in range(round(HORIZONS[-1] / STEP)):
            data.ctrl = [np.interp(start + k * STEP, time, column) for column in current.T]
            mujoco.mj_step(model, data)
            for h, horizon in enumerate(HORIZONS):
                if k + 1 == round(horizon / STEP):
                    found[w, h] = data.qpos
    return found


def measured(time: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Measured positions at the same instants."""
    starts = np.arange(time[0] + 1.0, time[-1] - 1.0, HORIZONS[-1])
    at = starts[:, None] + np.array(HORIZONS)
    return np.stack([np.interp(at, time, column) for column in q.T], axis=-1)


def of_file(result: Result, drives: bool) -> Result:
    """The model with the inertias of the robot's file, with or without identified friction and armature."""
    base, names = result.base, result.idm.parameter_names
    standard = dict.fromkeys(names, 0.0) | {
        name: value for name, value in result.robot.inertias.items() if name in names
    }
    if drives:
        standard |= {k: v for k, v in result.consistency.standard.items() if k[:3] in ("fv_", "fs_", "off")}
        left = np.array([each.value or 0.0 for each in result.parameters.values()])
        left = left - base.matrix @ [standard[name] for name in names]
        for joint in result.robot.actuated:
            of_rotor = base.matrix[:, names.index(f"ia_{joint}")]
            standard[f"ia_{joint}"] = max(float(of_rotor @ left / (of_rotor @ of_rotor)), 0.0)
    less = {} if drives else {"curves": {}, "friction": {}}
    return result.replaced(consistency=replace(result.consistency, standard=standard), **less)


def of_truth(result: Result, truth: Mapping[str, float]) -> Result:
    """The model with the parameters of the simulated arm."""
    standard = dict.fromkeys(result.idm.parameter_names, 0.0) | {k: v for k, v in truth.items() if "ground" not in k}
    gains = {joint: (float(gain), 0.0) for joint, gain in zip(result.idm.actuated, GAINS, strict=True)}
    made = replace(result.consistency, standard=standard, gains=gains)
    return result.replaced(consistency=made, curves={}, friction={})


def models(
    result: Result, samples: Draws, folder: Path, count: int, truth: Mapping[str, float]
) -> Iterator[tuple[str, Path]]:
    """Write the models to play, the true one where it is known."""
    named = [
        ("file", of_file(result, False)),
        ("file, identified drives", of_file(result, True)),
        ("identified", result),
    ]
    named += [("true", of_truth(result, truth))] if truth else []
    named += [(f"draw {k}", each) for k, each in zip(range(count), samples.results(), strict=False)]
    for name, each in named:
        (path,) = export_model(each, "mjcf", folder / name.replace(",", "").replace(" ", "_")).files
        text = re.sub(r' range="[^"]*"', "", path.read_text())  # limits of joints act in no log
        path.write_text(text)
        yield name, path


def compare(title: str, result: Result, run: Run, draws: int, truth: Mapping[str, float] | None = None) -> None:
    """Print errors of played positions, in mrad, and the spread of the draws."""
    rate = 1 / float(np.median(np.diff(run.time)))
    low = butter(4, min(result.preparation.cutoff or 15.0, 0.4 * rate), fs=rate, output="sos")
    q = sosfiltfilt(low, np.asarray(run.position), axis=0)
    true, played = measured(run.time, q), {}
    samples = draw(result, max(draws, 1), 1)
    with TemporaryDirectory() as folder:
        for name, path in models(result, samples, Path(folder), draws, truth or {}):
            played[name] = play(path, run.time, q, np.asarray(run.command)[:, : q.shape[1]])
    spread = np.std([each for name, each in played.items() if name.startswith("draw")], axis=0)
    for name in (each for each in played if not each.startswith("draw")):
        errors = 1e3 * np.sqrt(np.mean((played[name] - true) ** 2, axis=(0, 2)))
        print(f"| {title} | {name} | {errors[0]:.2f} | {errors[1]:.1f} |", flush=True)
    wide = 1e3 * np.sqrt(np.mean(spread**2, axis=(0, 2)))
    print(f"| {title} | spread of {draws} draws | {wide[0]:.2f} | {wide[1]:.1f} |")
    if truth:
        apart = 1e3 * np.sqrt(np.mean((played["identified"] - played["true"]) ** 2, axis=(0, 2)))
        print(f"| {title} | identified from true | {apart[0]:.2f} | {apart[1]:.1f} |")
    torques(result, samples, run)


def torques(result: Result, samples: Draws, run: Run) -> None:
    """Print the spread of the draws' torques along the run beside the torque error."""
    prediction = result.predict(run).in_band
    error = np.sqrt(np.mean((prediction.predicted - prediction.measured)[prediction.keep] ** 2))
    motion = result.idm.motion(*_path(run, result))
    base = result.base.standard
    regressor = result.idm.columns(base)
    found = np.stack(
        [regressor.torques_along(result.idm.layout, motion, values) for values in samples.base[: min(len(samples), 32)]]
    )
    print(
        f"|  | torque: error, spread of draws, N m rms | {error:.2f} | {np.sqrt(np.mean(found.std(axis=0) ** 2)):.2f} |"
    )


def _path(run: Run, result: Result) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rate = 1 / float(np.median(np.diff(run.time)))
    low = butter(4, min(result.preparation.cutoff or 15.0, 0.4 * rate), fs=rate, output="sos")
    q = sosfiltfilt(low, np.asarray(run.position), axis=0)[:: max(round(rate / 50), 1)]
    time = run.time[:: max(round(rate / 50), 1)]
    qd = np.gradient(q, time, axis=0)
    return q.T, qd.T, np.gradient(qd, time, axis=0).T


def simulated(
    folder: Path, seed: int, masses: Mapping[str, float] | None = None, noise: float = 0.05
) -> tuple[Result, Run]:
    """An identification of the simulated arm, whose file may have wrong masses, and a run that it has not seen."""
    true = robot(folder)
    made = replace(plant(true, noise=noise), gains=GAINS, tool="j4")
    believed = robot(folder, dict(masses)) if masses else true
    runs = [made.run(seed), made.run(seed + 1, STEEL, Payload(name="steel", mass=STEEL["m"]))]
    return identify(believed, runs, consistent=True), made.run(seed + 2)


def coverage(sets: int, noise: float) -> None:
    """Print the share of true parameters and gains within the central 95 % of the draws."""
    inside, boxed, moved, gains = [], [], [], []
    for seed in range(sets):
        with TemporaryDirectory() as folder:
            result, _ = simulated(Path(folder), 10 * seed, noise=noise)
        samples = draw(result, 256, seed)
        known = [k for k, each in enumerate(result.parameters.values()) if each.value is not None]
        truth = result.base.matrix @ [chi(result.robot).get(name, 0.0) for name in result.idm.parameter_names]
        low, high = np.quantile(samples.base, [0.025, 0.975], axis=0)
        inside += list(((truth >= low) & (truth <= high))[known])
        values = np.array([each.value or 0.0 for each in result.parameters.values()])
        boxed += list((np.abs(truth - values) < 0.1 * np.abs(values))[known])
        low, high = np.quantile(samples.gains, [0.025, 0.975], axis=0)
        gains += list((low <= GAINS) & (high >= GAINS))
        moved.append(samples.moved_share)
    shares = [100 * np.mean(each) for each in (inside, gains, boxed, moved)]
    print(f"| {noise:g} | " + " | ".join(f"{share:.0f}" for share in shares) + " |", flush=True)


def ur10e(data: Path, folder: Path) -> tuple[Result, Run]:
    """The UR10e pair, with the URDF beside it, and a run of another day."""
    entry = (ROOT / "docs" / "evidence" / "measured" / "ur10e.yaml").read_text(encoding="utf-8")
    entry = entry.replace("robot: ur10e", f"robot: {data}/ur10e/ur10e.urdf")
    (folder / "ur10e.yaml").write_text(re.sub(r"([\w-]+\.csv)", lambda log: str(data / "ur10e" / log[1]), entry))
    described = read_experiment(folder / "ur10e.yaml")
    held = described.validation[0]
    run = read_run(held.log, described.signals, None, described.units)
    return identify(folder / "ur10e.yaml", consistent=True), run


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", type=int, default=10)
    parser.add_argument("--draws", type=int, default=10)
    given = parser.parse_args()
    print("| robot | model | 0.1 s, mrad | 0.5 s, mrad |\n| --- | --- | --- | --- |")
    with TemporaryDirectory() as folder:
        truth = chi(robot(Path(folder)))
        compare("simulated arm, right file", *simulated(Path(folder), 500), given.draws, truth)
        compare("simulated arm, link 3 30 % too heavy", *simulated(Path(folder), 500, {"j3": 3.9}), given.draws, truth)
        data = ROOT.parent / "shared" / "data"
        if data.is_dir():
            compare("UR10e", *ur10e(data, Path(folder)), given.draws)
    print("\n| noise, A | true parameters inside 95 % of draws, % | gains, % | inside +-10 %, % | draws moved, % |")
    print("| --- | --- | --- | --- | --- |")
    for noise in (0.05, 0.6):
        coverage(given.sets, noise)


if __name__ == "__main__":
    main()
