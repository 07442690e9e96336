"""ROS bags, by the package rosbags: rosbag2 in SQLite (``.db3``) and MCAP, and ROS 1 (``.bag``).

Columns are named as PlotJuggler names its curves: ``/joint_states/elbow/position`` for the joint ``elbow`` of a
``sensor_msgs/JointState`` (or ``control_msgs/DynamicJointState``), ``/TOPIC/FIELD``, ``/TOPIC/FIELD[1]`` or
``/TOPIC/FIELD[1]/FIELD`` for the numbers of any other message. Every topic has its stamps:
``/TOPIC/header/stamp``, where its messages have a header, and ``/TOPIC/received``; both in s.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.errors import GtauError, missing_extra
from gtau.findings import Finding
from gtau.signals.reading.formats import ALL, WIDEST, LogTable, common_length, interpolated, readable, reading
from gtau.signals.storage import block_size, store

if TYPE_CHECKING:
    import polars as pl

STAMPED = 12  # bytes of a message before its frame and names: an encapsulation or a count, and the stamp
LARGEST = 1 << 16  # bytes of a message, all messages like which are looked through
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
    """Find the columns of a bag, a file or a rosbag2 folder, in all messages of each topic.

    Columns of several topics whose messages have one type, as of drives with a topic each, are read at the stamps of
    the first: between theirs by linear interpolation.
    """
    files = [path, *path.glob("*")]  # of a folder
    topics, counts, kinds = _contents(path, tuple((file.stat().st_mtime_ns, file.stat().st_size) for file in files))
    notes = list[Finding]()

    def frames(names: Sequence[str], rows: range) -> Iterator[tuple[pl.DataFrame, float]]:
        import polars as pl

        topic, *others = dict.fromkeys(topics[name] for name in names)
        if different := [other for other in others if kinds[other] != kinds[topic]]:
            common_length(path, {name: counts[topics[name]] for name in names})
            second = next(name for name in names if topics[name] == different[0])
            raise GtauError(
                f"'{names[0]}' and '{second}' come from two topics with separate time stamps; give both (time: "
                "{position: COLUMN, command: COLUMN}).",
                source=path,
            )
        stamp = "header/stamp" if all(f"{one}/header/stamp" in topics for one in (topic, *others)) else "received"
        columns = {one: [name for name in names if topics[name] == one] for one in (topic, *others)}
        with readable(path, "a ROS bag"), _reader(path) as bag:
            beside = {
                other: store((part for part, _ in _rows(bag, other, [f"{other}/{stamp}", *names])), (1 + len(names),))
                for other, names in columns.items()
                if other != topic
            }
            for values, row in _rows(bag, topic, [f"{topic}/{stamp}", *columns[topic]], rows):
                frame = dict(zip(columns[topic], values.T[1:], strict=True))
                for other, log in beside.items():
                    step = float(np.median(np.diff(log[:, 0]))) if len(log) > 1 else 0.0
                    frame |= zip(columns[other], interpolated(log, step, values[:, 0]).T, strict=True)
                yield pl.DataFrame(frame).select(names), min(row / counts[topic], 1.0)
        if others and not notes:
            listed = ", ".join(others[:3]) + ", ..." * (len(others) > 3)
            text = f"read {listed} at the stamps of {topic}, between theirs by linear interpolation"
            notes.append(reading("aligned topics", text=text))

    return LogTable(path, tuple(topics), frames, notes=notes)


@cache
def _contents(
    path: Path, _changed: tuple[tuple[int, int], ...]
) -> tuple[dict[str, str], dict[str, int], dict[str, str]]:
    """Find the topic of each column, and each topic's number of messages and their type.

    Messages like an earlier one, with as many bytes and the same names, have no other columns.
    """
    topics, counts, kinds = dict[str, str](), dict[str, int](), dict[str, str]()
    with readable(path, "a ROS bag"), _reader(path) as bag:
        for connection in bag.connections:
            topic, seen = connection.topic, list[tuple[int, bytes]]()
            for _, received, raw in bag.messages(connections=[connection]):
                if any(len(raw) == length and raw.startswith(names, STAMPED) for length, names in seen):
                    continue
                try:
                    values, last = _values(bag, connection, received, raw)
                except KeyError:  # of a type that neither the bag nor ROS 2 describes
                    break
                topics |= {f"{topic}/{name}": topic for name in values if f"{topic}/{name}" not in topics}
                seen.append((len(raw), raw[STAMPED : max(raw.rfind(last.encode()) + len(last.encode()), STAMPED)]))
                if len(raw) > LARGEST:  # an image or a map
                    break
            if seen or connection.msgcount == 0:
                counts[topic], kinds[topic] = counts.get(topic, 0) + connection.msgcount, connection.msgtype
    return topics, counts, kinds


def _rows(bag: Any, topic: str, names: Sequence[str], rows: range = ALL) -> Iterator[tuple[np.ndarray, int]]:
    """Read blocks of columns (M, .) of a topic, nan where a message lacks one, with the number of rows read so far."""
    parts = [name.removeprefix(f"{topic}/") for name in names]
    connections = [connection for connection in bag.connections if connection.topic == topic]
    messages = islice(bag.messages(connections=connections), rows.start, rows.stop if rows != ALL else None)
    read = (_values(bag, *message)[0] for message in messages)
    table, row = ([values.get(part, np.nan) for part in parts] for values in read), rows.start
    while len(some := np.array(list(islice(table, block_size())))):
        row += len(some)
        yield some, row


def _values(bag: Any, connection: Any, received: int, raw: bytes) -> tuple[dict[str, float], str]:
    """Name the numbers in a message, and its receipt stamp; and return the last of the joints' names in it."""
    fields = vars(bag.deserialize(raw, connection.msgtype))
    joints: list[str] = next((fields[key] for key in ("name", "joint_names") if isinstance(fields.get(key), list)), [])
    values = dict[str, float]()
    for key, field in fields.items():
        if joints and isinstance(field, (list, np.ndarray)) and len(field) == len(joints):
            for joint, item in zip(joints, field, strict=True):
                if hasattr(item, "interface_names"):  # of DynamicJointState
                    pairs = zip(item.interface_names, item.values, strict=False)
                    values |= {f"{joint}/{interface}": float(value) for interface, value in pairs}
                else:
                    values |= _numbers(item, f"{joint}/{key}")
        else:
            values |= _numbers(field, key)
    return values | {"received": received * 1e-9}, str(joints[-1]) if joints else ""


def _numbers(value: Any, name: str) -> Iterator[tuple[str, float]]:
    """Name the numbers in a value, itself called ``name`` (``FIELD/FIELD``) in a message."""
    if isinstance(value, (bool, int, float, np.number)):
        yield name, float(value)
    elif isinstance(value, (list, np.ndarray)) and len(value) <= WIDEST:
        for k, item in enumerate(value, start=1):
            yield from _numbers(item, f"{name}[{k}]")
    elif hasattr(value, "sec"):
        yield name, float(value.sec + getattr(value, "nanosec", getattr(value, "nsec", 0)) * 1e-9)
    elif hasattr(value, "__dict__"):
        for key, field in vars(value).items():
            yield from _numbers(field, f"{name}/{key}")


LOG_FORMATS = {".db3": open_rosbag, ".mcap": open_rosbag, ".bag": open_rosbag}
