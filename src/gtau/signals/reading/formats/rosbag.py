"""ROS bags, by the package rosbags: rosbag2 in SQLite (``.db3``) and MCAP, and ROS 1 (``.bag``).

Columns are named as PlotJuggler names its curves: ``/joint_states/elbow/position`` for the joint ``elbow`` of a
``sensor_msgs/JointState``, ``/TOPIC/FIELD`` or ``/TOPIC/FIELD[1]`` for the numbers of any other message. Every topic
has its stamps: ``/TOPIC/header/stamp``, where its messages have a header, and ``/TOPIC/received``; both in s.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.errors import GtauError, missing_extra
from gtau.signals.reading.formats import WIDEST, LogTable, common_length, readable
from gtau.signals.storage import block_size

if TYPE_CHECKING:
    import polars as pl

Getter = Callable[[Any], float]

JOINT_STATE = "sensor_msgs/msg/JointState"
STRING = "std_msgs/msg/String"


def _reader(path: Path) -> Any:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise missing_extra(f"reading {path} (a ROS bag)", "rosbags", "ros") from None
    return AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))


def robot_description(path: Path) -> str | None:
    """Find the URDF that a bag holds in a topic ``robot_description``, a text; raises GtauError."""
    with readable(path, "a ROS bag"), _reader(path) as bag:
        for connection in bag.connections:
            if connection.topic.split("/")[-1] != "robot_description" or connection.msgtype != STRING:
                continue
            for _, _, raw in bag.messages(connections=[connection]):
                text = bag.deserialize(raw, connection.msgtype).data
                if "<robot" in text:
                    return str(text)
    return None


def open_rosbag(path: Path) -> LogTable:
    """Find the columns of a bag, a file or a rosbag2 folder, from the first message of every topic."""
    columns: dict[str, tuple[str, Getter | None]] = {}  # topic, and what gets its value from a message; None: receipt
    counts: dict[str, int] = {}
    with readable(path, "a ROS bag"), _reader(path) as bag:
        for connection in bag.connections:
            first = next(bag.messages(connections=[connection]), None)
            if first is None:
                continue
            try:
                message = bag.deserialize(first[2], connection.msgtype)
            except KeyError:  # of a type that neither the bag nor ROS 2 describes
                continue
            topic = connection.topic
            counts[topic] = counts.get(topic, 0) + connection.msgcount
            for name, getter in _getters(message, connection.msgtype):
                columns[f"{topic}/{name}"] = topic, getter
            columns[f"{topic}/received"] = topic, None

    def frames(names: Sequence[str], rows: range) -> Iterator[tuple[pl.DataFrame, float]]:
        import polars as pl

        topics = [columns[name][0] for name in names]
        count = common_length(path, {name: counts[topic] for name, topic in zip(names, topics, strict=True)})
        if len(set(topics)) > 1:
            second = next(name for name, topic in zip(names, topics, strict=True) if topic != topics[0])
            raise GtauError(
                f"'{names[0]}' and '{second}' come from two topics with separate time stamps; give both (time: "
                "{position: COLUMN, command: COLUMN}).",
                source=path,
            )
        getters = [columns[name][1] for name in names]
        values = np.empty((min(block_size(), count), len(names)))
        filled = 0
        with readable(path, "a ROS bag"), _reader(path) as bag:
            connections = [connection for connection in bag.connections if connection.topic == topics[0]]
            for row, (connection, received, raw) in enumerate(bag.messages(connections=connections)):
                if row < rows.start:
                    continue
                if row >= rows.stop:
                    break
                message = bag.deserialize(raw, connection.msgtype)
                values[filled] = [getter(message) if getter else received * 1e-9 for getter in getters]
                filled += 1
                if filled == len(values):
                    yield pl.DataFrame(values, schema=list(names)), (row + 1) / count
                    filled = 0
        if filled:
            yield pl.DataFrame(values[:filled], schema=list(names)), 1.0

    return LogTable(path, tuple(columns), frames)


def _getters(message: Any, kind: str) -> Iterator[tuple[str, Getter]]:
    """Name the numbers in a message, each with a function that gets it from later messages."""
    if kind != JOINT_STATE:
        yield from _numbers(message, "")
        return
    yield "header/stamp", lambda message: _seconds(message.header.stamp)
    for field in ("position", "velocity", "effort"):
        for k, joint in enumerate(message.name[: len(getattr(message, field))]):
            yield f"{joint}/{field}", partial(_joint_value, field, joint, k)


def _joint_value(field: str, joint: str, k: int, message: Any) -> float:
    names, values = message.name, getattr(message, field)
    if k >= len(names) or names[k] != joint:
        k = names.index(joint) if joint in names else len(values)
    return float(values[k]) if k < len(values) else np.nan  # drivers may leave joints out


def _numbers(value: Any, name: str) -> Iterator[tuple[str, Getter]]:
    """Name the numbers in a value, itself called ``name`` (``FIELD/FIELD``) in a message."""
    getter = attrgetter(name.replace("/", "."))
    if isinstance(value, (bool, int, float, np.number)):
        yield name, lambda message: float(getter(message))
    elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and value.size <= WIDEST:
        for k in range(value.size):
            yield f"{name}[{k + 1}]", partial(_item_value, getter, k)
    elif hasattr(value, "sec") and hasattr(value, "nanosec"):
        yield name, lambda message: _seconds(getter(message))
    elif hasattr(value, "__dataclass_fields__"):
        for field in value.__dataclass_fields__:
            if not field.startswith("__"):
                yield from _numbers(getattr(value, field), f"{name}/{field}".lstrip("/"))


def _item_value(getter: Callable[[Any], Any], k: int, message: Any) -> float:
    array = getter(message)
    return float(array[k]) if k < len(array) else np.nan


def _seconds(stamp: Any) -> float:
    return float(stamp.sec + stamp.nanosec * 1e-9)


LOG_FORMATS = {".db3": open_rosbag, ".mcap": open_rosbag, ".bag": open_rosbag}
