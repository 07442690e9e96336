"""Play a round's motion on a robot of LeRobot by send_action, and log get_observation.

    python play_lerobot.py camp/01 --robot so101_follower --port /dev/ttyACM0 [--speed 0.1]

Enter in the terminal stops the motion, as does a tracking error. Actions and observations are in degrees
(``use_degrees``); currents come from a register of the motors.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
from contract import Motion, mount, play_round, pressed, write_log

CURRENT, UNIT = "Present_Current", 6.5e-3  # register of Feetech motors, A a count


def observe(robot: Any, joints: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Read positions, rad, and currents, A."""
    seen = robot.get_observation()
    counts = robot.bus.sync_read(CURRENT)
    return np.deg2rad([seen[f"{name}.pos"] for name in joints]), UNIT * np.array([counts[name] for name in joints])


def follow(motion: Motion, robot: Any, stopped: Any, clock: Any, wait: Any) -> tuple[Any, ...]:
    """Follow a motion; return time, positions and currents as logged, and how it ended."""
    rows, begun, end = [], clock(), "completed"
    while end == "completed" and (now := clock() - begun) <= motion.time[-1]:
        wanted = motion.at(now)[0]
        send(robot, motion.joints, wanted)
        q, current = observe(robot, motion.joints)
        rows.append((now, q, current))
        end = motion.strayed(q, wanted) or ("stopped by the operator" if stopped() else "completed")
        wait(max(0.0, 1.0 / motion.file["rate"] - (clock() - begun - now)))
    if end != "completed":
        send(robot, motion.joints, q)  # it holds where it is: what it was last told may lie behind an obstacle
    t, q, current = (np.array(column) for column in zip(*rows, strict=True))
    return t, q, current, end


def send(robot: Any, joints: list[str], q: np.ndarray) -> None:
    """Send positions, rad."""
    robot.send_action({f"{name}.pos": float(degrees) for name, degrees in zip(joints, np.rad2deg(q), strict=True)})


def play_run(
    motion: Motion, robot: Any, stopped: Any = pressed, clock: Any = time.perf_counter, wait: Any = time.sleep
) -> tuple[Any, ...]:
    """Approach the start slowly and play one run; return time, positions and currents as logged, and how it ended."""
    approach = motion.approach(observe(robot, motion.joints)[0])
    before = follow(approach, robot, stopped, clock, wait)
    return before if before[3] != "completed" else follow(motion, robot, stopped, clock, wait)


def main() -> None:
    """Play all runs of a round."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("round", type=Path)
    parser.add_argument("--robot", default="so101_follower")
    parser.add_argument("--port", required=True)
    parser.add_argument("--speed", type=float, default=1.0)
    options = parser.parse_args()
    from lerobot.robots import make_robot_from_config
    from lerobot.robots.so101_follower import SO101FollowerConfig

    robot = make_robot_from_config(
        SO101FollowerConfig(
            port=options.port, id=options.robot, use_degrees=True,
            disable_torque_on_disconnect=False,  # the arm would fall
        )
    )  # fmt: skip

    def one_run(run: dict, motion: Motion) -> tuple[str, str]:
        mount(run)
        *log, end = play_run(motion, robot)
        return write_log(motion, run["name"], *log), end

    robot.connect()
    try:
        play_round(options.round, options.speed, one_run)
    finally:
        robot.disconnect()


if __name__ == "__main__":
    main()
