"""Play a round's motion by FollowJointTrajectory of ros2_control, and record /joint_states as MCAP.

    python play_ros2.py camp/01 --action /joint_trajectory_controller/follow_joint_trajectory [--speed 0.1]

The controller watches the tracking error (``path_tolerance``). Efforts of /joint_states are taken as currents: name
another column in ``signals`` where your driver publishes currents elsewhere.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path
from typing import Any

from contract import Motion, read_motion, write_played

STATES = "/joint_states"


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


def play_run(motion: Motion, run: str, robot: Any) -> dict[str, str]:
    """Play one run with a ``robot`` that has ``positions()``, ``record(folder)`` and ``follow(motion)``."""
    motion.refuse_start(robot.positions(motion.joints))
    log = f"logs/{run}"
    recording = robot.record(motion.folder / log)
    try:
        end = robot.follow(motion)
    finally:
        recording.terminate()
        recording.wait()
    return {"name": run, "log": log, "end": end}


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

    def record(self, folder: Path) -> Any:
        """Record the states with rosbag2."""
        return subprocess.Popen(["ros2", "bag", "record", "-s", "mcap", "-o", str(folder), STATES])

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
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("round", type=Path)
    parser.add_argument("--action", default="/joint_trajectory_controller/follow_joint_trajectory")
    parser.add_argument("--speed", type=float, default=1.0)
    asked = parser.parse_args()
    motion, runs, end = read_motion(asked.round), [], "completed"
    robot = robot or Ros(asked.action)
    for run in motion.file["runs"]:
        load = run["payload"]["name"] if run["payload"] else "no payload"
        input(f"{run['name']}: mount {load}, then press Enter: ")
        runs.append(play_run(motion.slower(asked.speed), run["name"], robot))
        if (end := runs[-1]["end"]) != "completed":
            break
    if asked.speed == 1.0:
        write_played(motion, runs, asked.speed, end, signals(motion))
    sys.exit(0 if end == "completed" else end)


if __name__ == "__main__":
    main()
