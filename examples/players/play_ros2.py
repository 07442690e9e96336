"""Play a round's motion by FollowJointTrajectory of ros2_control, and record /joint_states as MCAP.

    python play_ros2.py camp/01 --action /joint_trajectory_controller/follow_joint_trajectory [--speed 0.1]

Ctrl-C cancels the goal, and the controller watches the tracking error (``path_tolerance``). Efforts of /joint_states
are taken as currents: name another column in ``signals`` where your driver publishes currents elsewhere.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
from contract import Motion, mount, play_round, read_motion

STATES = "/joint_states"
STARTED = 2.0  # s, until a recording that does not start has said so


def signals(motion: Motion) -> dict[str, Any]:
    """Name the columns of the recorded topic."""
    position, effort = ({name: f"{STATES}.{kind}.{name}" for name in motion.joints} for kind in ("position", "effort"))
    return {"time": f"{STATES}.t", "position": position, "current": effort}


def goal(motion: Motion, messages: Any) -> Any:
    """Make the goal of the action: all samples, with the tolerance of each joint."""
    wanted = messages.FollowJointTrajectory.Goal()
    wanted.trajectory.joint_names = motion.joints
    for t, q, qd, qdd in zip(motion.time, motion.q, motion.qd, motion.qdd, strict=True):
        point = messages.JointTrajectoryPoint(positions=q.tolist(), velocities=qd.tolist(), accelerations=qdd.tolist())
        point.time_from_start = messages.Duration(sec=int(t), nanosec=round(1e9 * (t - int(t))))
        wanted.trajectory.points.append(point)
    for name, most in zip(motion.joints, motion.limits("tracking_tolerance"), strict=True):
        wanted.path_tolerance.append(messages.JointTolerance(name=name, position=float(most)))
    return wanted


def play_run(motion: Motion, run: str, robot: Any) -> tuple[str, str]:
    """Approach the start slowly and play one run; return its log and how it ended.

    ``robot`` has ``positions(joints)``, ``record(folder)`` and ``follow(motion)``. A dry run is not recorded.
    """
    log = f"logs/{run}-{time.strftime('%Y%m%dT%H%M%S')}"  # rosbag2 refuses a folder that is there
    if (end := robot.follow(motion.approach(np.array(robot.positions(motion.joints))))) != "completed":
        return log, end
    with robot.record(motion.folder / log) if motion.speed == 1.0 else nullcontext():
        return log, robot.follow(motion)


class Ros:
    """The robot behind an action server."""

    def __init__(self, action: str) -> None:
        import control_msgs.action
        import control_msgs.msg
        import rclpy
        import rclpy.action
        import sensor_msgs.msg
        import trajectory_msgs.msg
        from builtin_interfaces.msg import Duration

        class messages:
            FollowJointTrajectory = control_msgs.action.FollowJointTrajectory
            JointTolerance = control_msgs.msg.JointTolerance
            JointTrajectoryPoint = trajectory_msgs.msg.JointTrajectoryPoint

        messages.Duration = Duration
        rclpy.init()
        self.rclpy, self.messages, self.latest = rclpy, messages, {}
        self.node = rclpy.create_node("gtau_player")
        self.node.create_subscription(sensor_msgs.msg.JointState, STATES, self.listen, 10)
        self.client = rclpy.action.ActionClient(self.node, messages.FollowJointTrajectory, action)

    def listen(self, state: Any) -> None:
        """Keep the latest positions."""
        self.latest = dict(zip(state.name, state.position, strict=True))

    def positions(self, joints: list[str]) -> list[float]:
        """Wait for the positions of the joints."""
        while not set(joints) <= set(self.latest):
            self.rclpy.spin_once(self.node)
        return [self.latest[name] for name in joints]

    @contextmanager
    def record(self, folder: Path) -> Iterator[None]:
        """Record the states with rosbag2; end the program before the robot moves where that does not start."""
        recording = subprocess.Popen(["ros2", "bag", "record", "-s", "mcap", "-o", str(folder), STATES])
        time.sleep(STARTED)
        if recording.poll() is not None:
            sys.exit("'ros2 bag record' ended at once, see above.")
        try:
            yield
        finally:
            recording.terminate()
            recording.wait()

    def follow(self, motion: Motion) -> str:
        """Send the goal, and wait for its end; Ctrl-C cancels it."""
        self.client.wait_for_server()
        sent = self.client.send_goal_async(goal(motion, self.messages))
        self.rclpy.spin_until_future_complete(self.node, sent)
        handle = sent.result()
        if not handle.accepted:
            return "the controller did not accept the goal"
        result = handle.get_result_async()
        try:
            self.rclpy.spin_until_future_complete(self.node, result)
        except KeyboardInterrupt:
            handle.cancel_goal_async()
            return "stopped by the operator"
        ended = result.result().result
        return "completed" if ended.error_code == ended.SUCCESSFUL else f"stopped: {ended.error_string}"


def main(robot: Any = None) -> None:
    """Play all runs of a round."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("round", type=Path)
    parser.add_argument("--action", default="/joint_trajectory_controller/follow_joint_trajectory")
    parser.add_argument("--speed", type=float, default=1.0)
    options = parser.parse_args()
    robot = robot or Ros(options.action)

    def one_run(run: dict, motion: Motion) -> tuple[str, str]:
        mount(run)
        return play_run(motion, run["name"], robot)

    play_round(options.round, options.speed, one_run, signals(read_motion(options.round)))


if __name__ == "__main__":
    main()
