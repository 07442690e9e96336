"""Campaigns end to end on robots in MuJoCo whose truth gtau does not know.

    python benchmarks/campaign.py five-bar 20 [--fault zero]

writes a line of JSON a seed to build/campaign/ROBOT.jsonl: how the campaign ended, its rounds, errors of the gains in
their intervals, and the same for as many runs of the first motion and of the best of 200 random ones.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "tests" / "support")]

from mujoco_robots import write_robot  # noqa: E402

import gtau  # noqa: E402
from gtau.campaigns.campaign import campaign  # noqa: E402
from gtau.campaigns.decision import write_experiment  # noqa: E402
from gtau.campaigns.folder import read_design_file, read_rounds  # noqa: E402
from gtau.campaigns.rehearsal import rehearse, write_motion  # noqa: E402
from gtau.documents.files import folder_of  # noqa: E402
from gtau.documents.markup import yaml_text  # noqa: E402
from gtau.errors import GtauError  # noqa: E402
from gtau.excitation.design import Design, check  # noqa: E402
from gtau.excitation.design_file import make_task  # noqa: E402
from gtau.excitation.nlp import Programme, random_start  # noqa: E402

PLAYER = ROOT / "examples" / "players" / "play_mujoco.py"
PLANT = ("design.yaml", "mujoco.yaml", "robot.xml", "robot.urdf")
MASSES = {"five-bar": 1.0, "orthoglide": 2.0, "ur10e": 5.0, "panda": 2.0}
RESTS = {  # where such arms stand before work
    "ur10e": {"shoulder_lift_joint": -1.5708, "wrist_1_joint": -1.5708},
    "panda": {"panda_joint2": -0.7854, "panda_joint4": -2.3562, "panda_joint6": 1.5708, "panda_joint7": 0.7854},
}
FAULTS = {
    "saturation": {"saturation": 0.01},  # of the torque constant, per A
    "zero": {"zero": 0.015},  # rad, within the tolerance of the start
    "unsigned": {"unsigned": True},
}


def processor() -> float:
    """Return the processor's time, s, of this process and its players."""
    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def play(folder: Path, seed: int) -> bool:
    """Play a round; return whether to its end."""
    command = [sys.executable, PLAYER, folder, "--seed", str(seed)]
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


def judged(gains: dict[str, dict], truth: dict[str, float]) -> dict:
    """Errors of gains, per cent, and in halves of their intervals."""
    known = {joint: gain for joint, gain in gains.items() if gain["value"] is not None and gain["half_width"]}
    error = {joint: 100 * (gain["value"] / truth[joint] - 1) for joint, gain in known.items()}
    widths = [gain["half_width"] for gain in known.values()]
    return {
        "widest": max(widths) if len(widths) == len(truth) else None,
        "error": {joint: round(value, 3) for joint, value in error.items()},
        "in_halves": {joint: round(abs(value) / known[joint]["half_width"], 3) for joint, value in error.items()},
    }


def one_shot(folder: Path, beside: Path, x: np.ndarray | None, rounds: int, truth: dict[str, float], seed: int) -> dict:
    """Play one motion as often as the campaign had rounds, the first of it where x is None, and identify."""
    file = read_design_file(folder)
    for source in filter(Path.is_file, (folder / name for name in PLANT)):
        (folder_of(beside) / source.name).write_text(source.read_text())
    for k in range(rounds):
        place = folder_of(beside / f"{k + 1:02d}")
        if x is None:
            for name in ("motion.csv", "motion.json"):
                (place / name).write_bytes((folder / "01" / name).read_bytes())
        else:
            design = Design(make_task(file)[0], "gains", x, 1.0, (), 0)
            rehearsal = rehearse(design, file, None, lambda *_: None)
            write_motion(place, file, design, rehearsal, {"purpose": "first", "after": "", "warm_up": False})
        if not play(place, seed + 1000):
            return {"refused": "not played"}
    try:
        result = gtau.identify(write_experiment(beside / "experiment.yaml", file, read_rounds(beside)))
    except GtauError as refusal:
        return {"refused": str(refusal)}
    gains = {joint: {"value": gain.value, "half_width": gain.half_width} for joint, gain in result.drive_gains.items()}
    return judged(gains, truth)


def without_gripper(robot: Path, folder: Path) -> Path:
    """Copy a robot's file with its sliding fingers fixed."""
    copy = folder_of(folder) / "robot.urdf"
    copy.write_text(robot.read_text().replace('type="prismatic"', 'type="fixed"'))
    return copy


def best_random(folder: Path, draws: int = 200) -> np.ndarray:
    """Find the best of random motions within the limits."""
    task = make_task(read_design_file(folder))[0]
    programme, rng, best = Programme(task, "gains", {}), np.random.default_rng(0), (np.inf, np.zeros(0))
    for _ in range(draws):
        x = random_start(task, rng, 0.9)
        if x is not None and (value := programme.value(x)[0]) < best[0] and all(u.excess <= 1 for u in check(task, x)):
            best = value, x
    return best[1]


def run(robot: str, seed: int, out: Path, fault: str, accuracy: float, compare: bool) -> dict:
    """Run a campaign to its end."""
    name, begun, used = Path(robot).stem, time.time(), processor()
    folder, mass = out / f"{name}-{fault or 'healthy'}-{seed}", MASSES[name]
    robot = str(without_gripper(Path(robot), folder)) if Path(robot).is_file() else robot
    truth = write_robot(robot, folder, mass, seed, FAULTS.get(fault))
    if fault == "no payload":
        text = (folder / "mujoco.yaml").read_text()
        (folder / "mujoco.yaml").write_text(text.replace(f"mass: {mass}", "mass: 0.0001"))
    stated = mass * (1.05 if fault == "wrong mass" else 1.0)
    runs = [{"payload": {"name": "payload", "mass": stated} if loaded else "none"} for loaded in (0, 1, 1, 0)]
    described = {"robot": robot, "rate": 250, "period": 6, "harmonics": 4, "runs": runs, "rest": RESTS.get(name, {})}
    (folder / "design.yaml").write_text(yaml_text(described))
    state = campaign(folder, accuracy=accuracy)
    while state.next == "play":
        if not play(state.rounds[-1].folder, seed):
            return {"seed": seed, "end": "not played", "rounds": len(state.rounds)}
        state = campaign(folder)
    gains, notes = (state.decision["gains"], state.decision["notes"]) if state.decision else ({}, [])
    line = {"seed": seed, "fault": fault, "end": state.next, "say": state.say, "rounds": len(state.rounds)}
    line |= judged(gains, truth) | {
        "notes": notes,
        "seconds": round(time.time() - begun),
        "cpu": round(processor() - used),
    }
    if compare:
        line["one_shot"] = one_shot(folder, folder / "shot", None, len(state.rounds), truth, seed)
        x = best_random(folder)
        line["random"] = one_shot(folder, folder / "random", x, len(state.rounds), truth, seed)
    return line


def main() -> None:
    """Run some seeds of a robot."""
    parser = argparse.ArgumentParser()
    parser.add_argument("robot")
    parser.add_argument("seeds", type=int)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--fault", default="")
    parser.add_argument("--accuracy", type=float, default=3.0)
    parser.add_argument("--alone", action="store_true", help="without the comparison with single motions")
    asked = parser.parse_args()
    out = folder_of(ROOT / "build" / "campaign")
    for seed in range(asked.first, asked.first + asked.seeds):
        try:
            line = run(asked.robot, seed, out, asked.fault, asked.accuracy, not (asked.fault or asked.alone))
        except GtauError as refusal:
            line = {"seed": seed, "fault": asked.fault, "end": "refused", "say": str(refusal)}
        with (out / f"{Path(asked.robot).stem}.jsonl").open("a") as file:
            file.write(json.dumps(line) + "\n")
        print(json.dumps(line), flush=True)


if __name__ == "__main__":
    main()
