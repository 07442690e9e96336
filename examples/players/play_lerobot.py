"""Play a round's motion on a robot of LeRobot by send_action, and log get_observation.

    python play_lerobot.py camp/01 --robot so101_follower --port /dev/ttyACM0 [--speed 0.1]

Actions and observations are in degrees (``use_degrees``); currents come from a register of the motors.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from contract import Motion, read_motion, write_log, write_played

CURRENT, UNIT = "Present_Current", 6.5e-3  # register of Feetech motors, A a count


def observe(robot: Any, joints: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Read positions, rad, and currents, A."""
    seen = robot.get_observation()
    counts = robot.bus.sync_read(CURRENT)
    return np.deg2rad([seen[f"{name}.pos"] for name in joints]), UNIT * np.array([counts[name] for name in joints])


def play_run(motion: Motion, robot: Any, clock: Any = time.perf_counter, wait: Any = time.sleep) -> tuple[Any, ...]:
    """Play one run; return time, positions and currents as logged, and how it ended."""
    motion.refuse_start(observe(robot, motion.joints)[0])
    rows, begun, end = [], clock(), "completed"
    while (now := clock() - begun) <= motion.time[-1]:
        wanted = motion.at(now)[0]
        robot.send_action({f"{name}.pos": float(q) for name, q in zip(motion.joints, np.rad2deg(wanted), strict=True)})
        q, current = observe(robot, motion.joints)
        rows.append((now, q, current))
        if end := motion.strayed(q, wanted):
            break
        wait(max(0.0, 1.0 / motion.file["rate"] - (clock() - begun - now)))
    t, q, current = (np.array(column) for column in zip(*rows, strict=True))
    return t, q, current, end or "completed"


def main() -> None:
    """Play all runs of a round."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("round", type=Path)
    parser.add_argument("--robot", default="so101_follower")
    parser.add_argument("--port", required=True)
    parser.add_argument("--speed", type=float, default=1.0)
    asked = parser.parse_args()
    from lerobot.robots import make_robot_from_config
    from lerobot.robots.so101_follower import SO101FollowerConfig

    motion, runs, end = read_motion(asked.round), [], "completed"
    robot = make_robot_from_config(SO101FollowerConfig(port=asked.port, id=asked.robot, use_degrees=True))
    robot.connect()
    for run in motion.file["runs"]:
        load = run["payload"]["name"] if run["payload"] else "no payload"
        input(f"{run['name']}: mount {load}, then press Enter: ")
        t, q, current, end = play_run(motion.slower(asked.speed), robot)
        if asked.speed == 1.0:
            runs.append({"name": run["name"], "log": write_log(motion, run["name"], t, q, current), "end": end})
        if end != "completed":
            break
    if asked.speed == 1.0:
        write_played(motion, runs, asked.speed, end)
    robot.disconnect()
    sys.exit(0 if end == "completed" else end)


if __name__ == "__main__":
    main()
