"""ROS bags, by the package rosbags: rosbag2 in SQLite (``.db3``) and MCAP, and ROS 1 (``.bag``).

Columns are named as PlotJuggler names its curves: ``/joint_states/elbow/position`` for the joint ``elbow`` of a
``sensor_msgs/JointState``, ``/TOPIC/FIELD`` or ``/TOPIC/FIELD[1]`` for the numbers of any other message. Every topic
has its stamps: ``/TOPIC/header/stamp``, where its messages have a header, and ``/TOPIC/received``; both in s.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.errors import GtauError, missing_extra
from gtau.signals.reading.formats import WIDEST, LogTable, common_length, readable
from gtau.signals.storage import block_size

if TYPE_CHECKING:
    import polars as pl

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
    topics: dict[str, str] = {}  # by column
    counts: dict[str, int] = {}
    with readable(path, "a ROS bag"), _reader(path) as bag:
        for connection in bag.connections:
            first = next(bag.messages(connections=[connection]), None)
            if first is None:
                continue
            try:
                values = _values(bag, *first)
            except KeyError:  # of a type that neither the bag nor ROS 2 describes
                continue
            topic = connection.topic
            counts[topic] = counts.get(topic, 0) + connection.msgcount
            topics |= {f"{topic}/{name}": topic for name in values}

    def frames(names: Sequence[str], rows: range) -> Iterator[tuple[pl.DataFrame, float]]:
        import polars as pl

        topic, *others = dict.fromkeys(topics[name] for name in names)
        count = common_length(path, {name: counts[topics[name]] for name in names})
        if others:
            second = next(name for name in names if topics[name] != topic)
            raise GtauError(
                f"'{names[0]}' and '{second}' come from two topics with separate time stamps; give both (time: "
                "{position: COLUMN, command: COLUMN}).",
                source=path,
            )
        parts = [name.removeprefix(f"{topic}/") for name in names]
        table, filled = np.empty((min(block_size(), count), len(names))), 0
        with readable(path, "a ROS bag"), _reader(path) as bag:
            connections = [connection for connection in bag.connections if connection.topic == topic]
            messages = islice(bag.messages(connections=connections), rows.start, min(rows.stop, count))
            for row, message in enumerate(messages, start=rows.start + 1):
                values = _values(bag, *message)
                table[filled] = [values.get(part, np.nan) for part in parts]  # drivers may leave joints out
                filled += 1
                if filled == len(table):
                    yield pl.DataFrame(table, schema=list(names)), row / count
                    filled = 0
        if filled:
            yield pl.DataFrame(table[:filled], schema=list(names)), 1.0

    return LogTable(path, tuple(topics), frames)


def _values(bag: Any, connection: Any, received: int, raw: bytes) -> dict[str, float]:
    """Name the numbers in a message, and its receipt stamp."""
    message = bag.deserialize(raw, connection.msgtype)
    if connection.msgtype != JOINT_STATE:
        return dict(_numbers(message, "")) | {"received": received * 1e-9}
    values = {"header/stamp": _seconds(message.header.stamp)}
    for field in ("position", "velocity", "effort"):
        pairs = zip(message.name, getattr(message, field), strict=False)
        values |= {f"{joint}/{field}": float(value) for joint, value in pairs}
    return values | {"received": received * 1e-9}


def _numbers(value: Any, name: str) -> Iterator[tuple[str, float]]:
    """Name the numbers in a value, itself called ``name`` (``FIELD/FIELD``) in a message."""
    if isinstance(value, (bool, int, float, np.number)):
        yield name, float(value)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and value.size <= WIDEST:
        for k, item in enumerate(value, start=1):
            yield f"{name}[{k}]", float(item)
    elif hasattr(value, "sec") and hasattr(value, "nanosec"):
        yield name, _seconds(value)
    elif hasattr(value, "__dataclass_fields__"):
        for field in value.__dataclass_fields__:
            if not field.startswith("__"):
                yield from _numbers(getattr(value, field), f"{name}/{field}".lstrip("/"))


def _seconds(stamp: Any) -> float:
    return float(stamp.sec + stamp.nanosec * 1e-9)


LOG_FORMATS = {".db3": open_rosbag, ".mcap": open_rosbag, ".bag": open_rosbag}
