"""A ROS 2 node that watches a robot: joint states in, diagnostics out.

    python ros2_watch_node.py --ros-args -p model:=result/model.json -p history:=history -p block:=30.0

It collects ``/joint_states`` (``effort`` is what the model was identified from: motor currents in A, or torques) and
publishes on ``/diagnostics`` after each block what :class:`gtau.Watch` says of it: OK, WARN while the baseline is being
learned or the block says nothing, ERROR with the explanation of an alarm. It is no safety function.
"""

from __future__ import annotations

import numpy as np

import gtau
from gtau.report.watch import alarm_words


class Watcher:
    """Blocks of joint states to diagnostics; the message classes are those of ROS, or others with the same fields."""

    def __init__(self, watch: gtau.Watch, seconds: float, array: type, status: type, pair: type):
        self.watch, self.seconds = watch, seconds
        self.array, self.status, self.pair = array, status, pair
        self.joints = watch.model.robot.actuated
        self.rows: list[list[float]] = []

    def add(self, state):
        """Take a JointState; return a DiagnosticArray when it ends a block, else None."""
        time = state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec
        order = [list(state.name).index(joint) for joint in self.joints]
        self.rows.append([time, *(state.position[k] for k in order), *(state.effort[k] for k in order)])
        if time - self.rows[0][0] < self.seconds:
            return None
        table, self.rows = np.array(self.rows), []
        names = ["t", *(f"q_{joint}" for joint in self.joints), *(f"v_{joint}" for joint in self.joints)]
        signals = {
            "time": "t",
            "position": {joint: f"q_{joint}" for joint in self.joints},
            self.watch.model.kind: {joint: f"v_{joint}" for joint in self.joints},
        }
        try:
            run = gtau.read_run(dict(zip(names, table.T, strict=True)), signals)
            return self.message(state.header, self.watch.update(run))
        except gtau.GtauError as refusal:
            return self.array(header=state.header, status=[self.diagnostic(1, str(refusal), {})])

    def message(self, header, known):
        """Write what is known after a block."""
        if known.alarm is not None:
            level, words = 2, alarm_words(known.alarm)[0]
        elif known.phase == "baseline":
            level, words = 1, f"baseline, {self.watch.count} of {self.watch.settings.baseline} blocks"
        else:
            level, words = 0, "no change since the baseline"
        return self.array(header=header, status=[self.diagnostic(level, words, known.values)])

    def diagnostic(self, level: int, words: str, values):
        """Write one DiagnosticStatus."""
        pairs = [self.pair(key=key, value=f"{value:.6g}") for key, value in values.items()]
        name = f"gtau watch: {self.watch.model.robot.name}"
        return self.status(level=bytes([level]), name=name, message=words, hardware_id=name, values=pairs)


def main() -> None:
    """Run the node."""
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    from rclpy.node import Node
    from sensor_msgs.msg import JointState

    rclpy.init()
    node = Node("gtau_watch")
    model, history, block = (
        node.declare_parameter(name, value).value
        for name, value in (("model", "model.json"), ("history", "history"), ("block", 30.0))
    )
    watch = gtau.Watch(gtau.load(model), history)
    watcher = Watcher(watch, block, DiagnosticArray, DiagnosticStatus, KeyValue)
    publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)

    def listen(state: JointState) -> None:
        if (found := watcher.add(state)) is not None:
            publisher.publish(found)

    node.create_subscription(JointState, "/joint_states", listen, 1000)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
