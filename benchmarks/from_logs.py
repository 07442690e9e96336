"""From logs to an answer in at most two commands: what is guessed, what is found, and the time it takes.

    python benchmarks/from_logs.py                      # logs beside the checkout (../shared/data)
    python benchmarks/from_logs.py --only airbot
    python benchmarks/from_logs.py --keep FOLDER        # with what was written

Bags and a LeRobot data set are made from the UR10e's table, by rosbags and Polars, before the clock runs. Times are of
the processor, start of Python included.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import polars as pl

sys.path += [str(Path(__file__).parent), str(Path(__file__).parents[1] / "tests" / "support")]
from bags import write_bag
from zoo import PANDA, XMATE3, arm

UR = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
ORDER = [2, 1, 0, 3, 4, 5]  # of the driver's joint states
PAIR = {"empty": "ur-20_02_19_14harm50sec.csv", "load_2.805kg": "ur-20_02_19_14harm50secLoad.csv"}
Commands = list[list[str]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--only", nargs="+", choices=CASES)
    parser.add_argument("--keep", type=Path)
    arguments = parser.parse_args()
    print("| logs | command | guesses to confirm | found | s |\n| --- | --- | --- | --- | ---: |")
    for name, (title, make) in CASES.items():
        if arguments.only and name not in arguments.only:
            continue
        with tempfile.TemporaryDirectory() as made:
            folder = arguments.keep / name if arguments.keep else Path(made)
            folder.mkdir(parents=True, exist_ok=True)
            for command in make(arguments.data.resolve(), folder):
                print(f"| {title} | {row(command, folder)} |", flush=True)


def row(command: list[str], folder: Path) -> str:
    """Run a command and describe what it says."""
    before = os.times()
    module = [sys.executable, "-m", "gtau", *command, "--json"]
    done = subprocess.run(module, cwd=folder, capture_output=True, text=True)
    after = os.times()
    seconds = sum(after[2:4]) - sum(before[2:4])
    shown = f"`gtau {' '.join(Path(word).name if '/' in word else word for word in command)}`"
    if done.returncode not in (0, 3):
        return f"{shown} | - | {done.stderr.strip().splitlines()[-1]} | {seconds:.0f}"
    document = json.loads(done.stdout)
    (folder / "document.json").write_text(done.stdout)
    guesses = [f"{each['what']}" for each in document["notes"] if each["kind"] == "draft"]
    gains = [each for each in document["drive_gains"] if each["value"] is not None]
    outcomes = ", ".join(
        f"{each['value']:.3g} ± {1.96 * each['std']:.2g} {each['unit']} ({each['outcome']})"
        if each["std"]
        else f"{each['value']:.3g} ({each['outcome']})"
        for each in gains
    )
    fit = ", ".join(f"{each['relative']:.2g}" for each in document["residuals"])
    return f"{shown} | {'; '.join(guesses)} | gains {outcomes}; errors {fit} % | {seconds:.0f}"


def ur10e_bags(urdf: bool) -> Callable[[Path, Path], Commands]:
    """The UR10e pair as MCAP of joint states."""

    def make(data: Path, folder: Path) -> Commands:
        text = (data / "ur10e" / "ur10e.urdf").read_text()
        for name, time, q, v in tables(data):
            joints = [UR[k] for k in ORDER]
            write_bag(folder / name, joints, time, q[:, ORDER], v[:, ORDER], urdf=text if urdf else None)
        (folder / "ur10e.urdf").write_text(text)
        return [["identify", *PAIR, "--kind", "current", *([] if urdf else ["--robot", "ur10e.urdf"])]]

    return make


def tables(data: Path) -> Iterator[tuple[str, np.ndarray, np.ndarray, np.ndarray]]:
    """Yield name, time, positions and currents of the UR10e's runs."""
    for name, source in PAIR.items():
        log = np.loadtxt(data / "ur10e" / source, delimiter=",")
        yield name, log[:, 0], log[:, 1:7], log[:, 13:19]


def lerobot(data: Path, folder: Path) -> Commands:
    """The UR10e pair as two LeRobot data sets of one episode."""
    for name, time, q, v in tables(data):
        file = folder / name / "data" / "chunk-000" / "file-000.parquet"
        file.parent.mkdir(parents=True, exist_ok=True)
        columns = {"observation.state": q.tolist(), "observation.current": v.tolist(), "timestamp": time - time[0]}
        columns |= {"action": np.vstack([q[4:], np.repeat(q[-1:], 4, axis=0)]).tolist(), "episode_index": 0 * v[:, 0]}
        pl.DataFrame(columns).with_columns(pl.col("episode_index").cast(pl.Int64)).write_parquet(file)
        features = {each: {"dtype": "float32", "shape": [6], "names": list(UR)} for each in list(columns)[:2]}
        features["action"] = features["observation.state"]
        (folder / name / "meta").mkdir(exist_ok=True)
        (folder / name / "meta" / "info.json").write_text(json.dumps({"fps": 95, "features": features}))
    (folder / "ur10e.urdf").write_text((data / "ur10e" / "ur10e.urdf").read_text())
    return [["identify", *PAIR, "--robot", "ur10e.urdf"]]


def panda(data: Path, folder: Path) -> Commands:
    """The Panda's bag as it was recorded."""
    bag = data / "panda_rosbag2" / "panda_exciting_trajectory.db3"
    return [["identify", str(bag), "--robot", str(arm(folder, "panda-arm", PANDA))]]


def airbot(data: Path, folder: Path) -> Commands:
    """The AIRBOT Play pair."""
    logs = [str(data / "airbot_play" / f"chirp_{name}.csv") for name in ("unloaded", "loaded_480g")]
    return [["identify", *logs, "--robot", str(data / "airbot_play" / "airbot_play_v3_0_gripper.urdf")]]


def rokae(data: Path, folder: Path) -> Commands:
    """The Rokae's log with motors and torque sensors."""
    log = str(data / "rokae_xmate3pro" / "excit.csv")
    return [["identify", log, "--robot", str(arm(folder, "xmate3", XMATE3))]]


CASES: dict[str, tuple[str, Callable[[Path, Path], Commands]]] = {
    "ur10e": ("UR10e pair, MCAP with /robot_description", ur10e_bags(True)),
    "ur10e_urdf": ("UR10e pair, MCAP without it", ur10e_bags(False)),
    "panda": ("Panda, rosbag2", panda),
    "lerobot": ("UR10e pair as LeRobot data sets", lerobot),
    "airbot": ("AIRBOT Play pair, CSV", airbot),
    "rokae": ("Rokae xMate 3 Pro with sensors, CSV", rokae),
}

if __name__ == "__main__":
    main()
