"""Bags as drivers record them: publishers that differ, arrays of messages, a topic for each joint, messages in JSON."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gtau.errors import GtauError
from gtau.robots.robot import Joint, Mdh, Robot
from gtau.signals.reading.discovery import discover
from gtau.signals.reading.logs import find_columns, read_log
from gtau.signals.run import read_run

pytest.importorskip("rosbags")
N, RATE = 600, 200.0
TIME = 5.0 + np.arange(N) / RATE
JOINTS = ("shoulder", "elbow")
ARM = Robot(
    "arm",
    tuple(
        Joint(name, antecedent, "revolute", Mdh(d=0.3), actuated=True)
        for name, antecedent in (("shoulder", "ground"), ("elbow", "shoulder"))
    ),
)
STATE, HEADER, STAMP = "sensor_msgs/msg/JointState", "std_msgs/msg/Header", "builtin_interfaces/msg/Time"
EXTRA = {  # of packages that the ROS 2 distribution's types lack
    "control_msgs/msg/InterfaceValue": "string[] interface_names\nfloat64[] values",
    "control_msgs/msg/DynamicJointState": "std_msgs/Header header\nstring[] joint_names\n"
    "control_msgs/InterfaceValue[] interface_values",
    "maker_msgs/msg/MotorState": "uint8 mode\nfloat32 q\nfloat32 dq\nfloat32 tau_est",
    "maker_msgs/msg/LowState": "maker_msgs/MotorState[3] motor_state\nuint32 tick",
    "maker_msgs/msg/Drive": "std_msgs/Header header\nfloat64 position\nfloat64 velocity\nfloat64 current",
}


def q(joint: int, time: Any) -> Any:
    return np.sin((1.5 + joint) * time)


def tau(joint: int, time: Any) -> Any:
    return np.sign(np.cos((1.5 + joint) * time)) + 0.5 * q(joint, time)


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Write messages ``(seconds, topic, type, fields)`` to a bag; a header is made from the stamp."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, definition in EXTRA.items():
        if name not in store.fielddefs:
            store.register(get_types_from_msg(definition, name))
    kinds = store.types

    def written(messages: Iterator[tuple[float, str, str, dict[str, Any]]]) -> Path:
        with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
            topics: dict[str, Any] = {}
            for time, topic, kind, fields in sorted(messages, key=lambda message: message[0]):
                if topic not in topics:
                    topics[topic] = bag.add_connection(topic, kind, typestore=store)
                nanoseconds = round(time * 1e9)
                if "header" in kinds[kind].__dataclass_fields__:
                    stamp = kinds[STAMP](*divmod(nanoseconds, 10**9))
                    fields = {"header": kinds[HEADER](stamp=stamp, frame_id="base")} | fields
                bag.write(topics[topic], nanoseconds, store.serialize_cdr(kinds[kind](**fields), kind))
        return tmp_path / "bag"

    written.kinds = kinds  # type: ignore[attr-defined]
    return written


def state(time: float, joints: tuple[str, ...], effort: bool = True) -> dict[str, Any]:
    numbers = [JOINTS.index(joint) if joint in JOINTS else 5 for joint in joints]
    position = np.array([q(k, time) for k in numbers])
    torque = np.array([tau(k, time) if effort else np.nan for k in numbers])
    return {"name": list(joints), "position": position, "velocity": np.empty(0), "effort": torque}


def test_columns_are_those_of_all_messages(write: Callable[..., Path]) -> None:
    """A gripper speaks first, with names as long as the arm's, and a wrist once, in the last message."""

    def messages() -> Iterator[tuple[float, str, str, dict[str, Any]]]:
        for time in TIME:
            yield time - 0.002, "/joint_states", STATE, state(time, ("gripper_", "fing_"))
            yield time, "/joint_states", STATE, state(time, ("shoulder", "elbow"))
        yield TIME[-1] + 0.001, "/joint_states", STATE, state(TIME[-1], ("lifting_", "wrist"))

    bag = write(messages())
    columns = find_columns(bag).columns
    joints = (*JOINTS, "gripper_", "fing_", "lifting_", "wrist")
    assert {f"/joint_states/{joint}/position" for joint in joints} <= {*columns}
    draft = discover([bag], ARM, "arm.yaml")
    assert draft.signals.position == {joint: f"/joint_states/{joint}/position" for joint in JOINTS}
    run = read_run(bag, draft.signals)
    assert "rows that hold only other signals" in str(run.notes)
    np.testing.assert_allclose(run.position, np.column_stack([q(k, run.time) for k in (0, 1)]), atol=1e-6)


def test_dynamic_joint_states(write: Callable[..., Path]) -> None:
    def messages() -> Iterator[tuple[float, str, str, dict[str, Any]]]:
        for time in TIME:
            values = [
                write.kinds["control_msgs/msg/InterfaceValue"](  # type: ignore[attr-defined]
                    interface_names=["position", "effort"], values=np.array([q(k, time), tau(k, time)])
                )
                for k in range(2)
            ]
            fields = {"joint_names": list(JOINTS), "interface_values": values}
            yield time, "/dynamic_joint_states", "control_msgs/msg/DynamicJointState", fields

    draft = discover([write(messages())], ARM, "arm.yaml")
    assert draft.signals.position == {joint: f"/dynamic_joint_states/{joint}/position" for joint in JOINTS}
    assert draft.signals.torque == {joint: f"/dynamic_joint_states/{joint}/effort" for joint in JOINTS}


def test_arrays_of_messages(write: Callable[..., Path]) -> None:
    kind = "maker_msgs/msg/MotorState"

    def messages() -> Iterator[tuple[float, str, str, dict[str, Any]]]:
        for time in TIME:
            motors = [write.kinds[kind](1, q(k, time), 0.0, tau(k, time)) for k in range(3)]  # type: ignore[attr-defined]
            yield time, "/lowstate", "maker_msgs/msg/LowState", {"motor_state": motors, "tick": round(1e3 * time)}

    bag = write(messages())
    values = read_log(bag, ["/lowstate/motor_state[2]/q"]).arrays()["/lowstate/motor_state[2]/q"]
    np.testing.assert_allclose(values, q(1, TIME), atol=1e-6)
    draft = discover([bag], ARM, "arm.yaml")
    assert list(draft.signals.position.values()) == [f"/lowstate/motor_state[{k}]/q" for k in (1, 2)]
    assert list(draft.signals.command.values()) == [f"/lowstate/motor_state[{k}]/tau_est" for k in (1, 2)]
    assert "joints" in draft.open


@pytest.mark.parametrize("kind", [STATE, "maker_msgs/msg/Drive"])
def test_a_topic_for_every_joint(kind: str, write: Callable[..., Path]) -> None:
    """Each drive has stamps of its own; the second's are 1 ms later, and pause for 30 ms."""

    def messages() -> Iterator[tuple[float, str, str, dict[str, Any]]]:
        for number, joint in enumerate(JOINTS):
            for time in TIME + 0.001 * number:
                if number and 6.0 < time < 6.03:
                    continue
                position, current = float(q(number, time)), float(tau(number, time))
                drive = {"position": position, "velocity": 0.0, "current": current}
                fields = state(time, (joint,)) if kind == STATE else drive
                yield time, f"/{joint}/state", kind, fields

    bag = write(messages())
    draft = discover([bag], ARM, "arm.yaml")
    name = "/{0}/state/{0}/position" if kind == STATE else "/{0}/state/position"
    assert draft.signals.position == {joint: name.format(joint) for joint in JOINTS}
    assert draft.signals.time == "/shoulder/state/header/stamp"
    run = read_run(bag, draft.signals)
    assert "read /elbow/state at the stamps of /shoulder/state, between theirs by linear int" in str(run.notes)
    expected = np.column_stack([q(k, run.time) for k in (0, 1)])
    np.testing.assert_allclose(run.position[run.valid], expected[run.valid], atol=1e-4)
    gap = (run.time > 6.006) & (run.time < 6.024)
    assert gap.any()
    assert not run.valid[gap].any()


def test_efforts_that_are_nan_give_way_to_a_topic_with_numbers(write: Callable[..., Path]) -> None:
    array = "std_msgs/msg/Float64MultiArray"

    def messages() -> Iterator[tuple[float, str, str, dict[str, Any]]]:
        layout = write.kinds["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)  # type: ignore[attr-defined]
        for time in TIME:
            yield time, "/joint_states", STATE, state(time, JOINTS, effort=False)
            yield time, "/arm/torque_limit", array, {"layout": layout, "data": np.array([40.0, 40.0])}
            yield time, "/arm/torques", array, {"layout": layout, "data": np.array([tau(k, time) for k in (0, 1)])}

    draft = discover([write(messages())], ARM, "arm.yaml")
    assert draft.signals.torque == {joint: f"/arm/torques/data[{k}]" for k, joint in enumerate(JOINTS, 1)}


def mcap(path: Path, topic: str, messages: Iterator[tuple[float, Any]], encoding: str = "json") -> Path:
    """Write messages in JSON, as Foxglove's library does: a header, a schema, a channel, and no index."""

    def text(value: str) -> bytes:
        return struct.pack("<I", len(value)) + value.encode()

    def record(kind: int, content: bytes) -> bytes:
        return struct.pack("<BQ", kind, len(content)) + content

    schema = struct.pack("<H", 1) + text("State") + text("jsonschema") + text("{}")
    channel = struct.pack("<HH", 1, 1) + text(topic) + text(encoding) + struct.pack("<I", 0)
    records = [record(1, text("") + text("")), record(3, schema), record(4, channel)]
    for time, message in messages:
        stamp = round(time * 1e9)
        records.append(record(5, struct.pack("<HIQQ", 1, 0, stamp, stamp) + json.dumps(message).encode()))
    magic = b"\x89MCAP0\r\n"
    path.write_bytes(magic + b"".join(records) + record(15, bytes(4)) + record(2, bytes(20)) + magic)
    return path


def test_messages_in_json(tmp_path: Path) -> None:
    """Two layouts: names beside arrays, and a list of joints."""
    pytest.importorskip("mcap")

    def arrays(time: float) -> dict[str, Any]:
        stamp = {"sec": int(time), "nsec": round(1e9 * (time % 1))}
        columns = {"position": [q(k, time) for k in (0, 1)], "current": [tau(k, time) for k in (0, 1)]}
        return {"stamp": stamp, "name": [*JOINTS], **columns, "note": "x"}

    bag = mcap(tmp_path / "a.mcap", "/arm", ((time, arrays(time)) for time in TIME))
    signals = {
        "time": "/arm/stamp",
        "position": {joint: f"/arm/{joint}/position" for joint in JOINTS},
        "current": {joint: f"/arm/{joint}/current" for joint in JOINTS},
    }
    run = read_run(bag, signals)
    np.testing.assert_allclose(run.command, np.column_stack([tau(k, TIME) for k in (0, 1)]), atol=1e-12)
    draft = discover([bag], ARM, "arm.yaml")
    assert (draft.signals.position, draft.signals.current) == (signals["position"], signals["current"])
    listed = ((time, {"joints": [{"q": q(k, time), "tau": tau(k, time)} for k in (0, 1)]}) for time in TIME)
    values = read_log(mcap(tmp_path / "b.mcap", "/arm", listed), ["/arm/joints[2]/q"]).arrays()
    np.testing.assert_allclose(values["/arm/joints[2]/q"], q(1, TIME))
    broken = mcap(tmp_path / "c.mcap", "/arm", ((time, [1, 2]) for time in TIME))
    with pytest.raises(GtauError, match=r"there is no column '/arm/q'; the columns are /arm/data\[1\], "):
        read_log(broken, ["/arm/q"])
    mcap(tmp_path / "d.mcap", "/arm", ((time, 1) for time in TIME), "protobuf")
    with pytest.raises(GtauError, match="its messages are in 'protobuf'; record them by ROS 2, or in JSON"):
        find_columns(tmp_path / "d.mcap")
    (tmp_path / "e.mcap").write_bytes(bag.read_bytes()[:2000])
    with pytest.raises(GtauError, match=r"e\.mcap cannot be read as a ROS bag \("):
        find_columns(tmp_path / "e.mcap")
