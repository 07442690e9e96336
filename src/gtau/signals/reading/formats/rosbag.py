"""ROS bags, by the package rosbags: rosbag2 in SQLite (``.db3``) and MCAP, and ROS 1 (``.bag``).

Columns are named as PlotJuggler names its curves: ``/joint_states/elbow/position`` for the joint ``elbow`` of a
``sensor_msgs/JointState`` (or ``control_msgs/DynamicJointState``), ``/TOPIC/FIELD``, ``/TOPIC/FIELD[1]`` or
``/TOPIC/FIELD[1]/FIELD`` for the numbers of any other message, also in JSON. Every topic has its stamps:
``/TOPIC/header/stamp``, where its messages have a header, and ``/TOPIC/received``; both in s.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import cache
from io import BytesIO
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.errors import GtauError, needing
from gtau.findings import Finding
from gtau.signals.reading.formats import ALL, WIDEST, LogTable, common_length, interpolated, listed, readable, reading
from gtau.signals.storage import block_size, store

if TYPE_CHECKING:
    import polars as pl

STAMPED = 12  # bytes of a message before its frame and names: an encapsulation or a count, and the stamp
LARGEST = 1 << 16  # bytes of a message, all messages like which are looked through
MCAP, HEAD = b"\x89MCAP0\r\n\x01", 64  # the beginning of such a file, and bytes with its profile
STRING = "std_msgs/msg/String"


def _reader(path: Path) -> Any:
    with needing(f"reading {path} (a ROS bag)", "rosbags", "ros"):
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    with path.open("rb") if path.is_file() else nullcontext(BytesIO()) as file:
        head = file.read(HEAD)
    if head.startswith(MCAP) and not head[len(MCAP) + 12 :].startswith(b"ros2"):
        return _mcap(path)
    return AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))


@contextmanager
def _mcap(path: Path) -> Iterator[Any]:
    """Open an MCAP file of another profile than ROS 2, as AnyReader does; its messages must be in JSON."""
    with needing(f"reading {path} (an MCAP file without ROS)", "mcap", "ros"):
        from mcap.reader import make_reader
    with path.open("rb") as file:
        read = make_reader(file).iter_messages
        try:
            channels = {channel.topic: (channel, schema) for schema, channel, _ in read()}
        except OSError as error:  # of a file that was cut, as its end is looked up first
            raise ValueError(f"its end is missing: {error.strerror}") from None
        counts = Counter(channel.topic for _, channel, _ in read())
        encodings = {channel.message_encoding for channel, _ in channels.values()}
        if encodings and "json" not in encodings:
            raise GtauError(f"its messages are in '{min(encodings)}'; record them by ROS 2, or in JSON.", source=path)
        connections = {
            topic: SimpleNamespace(
                topic=topic,
                msgtype=schema.name if schema else "",
                msgcount=counts[topic],
                ext=SimpleNamespace(serialization_format="json"),
            )
            for topic, (channel, schema) in channels.items()
            if channel.message_encoding == "json"
        }

        def messages(connections: Sequence[Any]) -> Iterator[tuple[Any, int, bytes]]:
            wanted = {connection.topic: connection for connection in connections}
            return ((wanted[channel.topic], one.log_time, one.data) for _, channel, one in read(topics=[*wanted]))

        yield SimpleNamespace(connections=[*connections.values()], messages=messages)


def robot_description(path: Path) -> str | None:
    """Find the URDF that a bag holds in a topic ``robot_description``, a text; raises GtauError."""
    with readable(path, "a ROS bag"), _reader(path) as bag:
        for connection in bag.connections:
            if connection.topic.split("/")[-1] != "robot_description" or connection.msgtype != STRING:
                continue
            for _, _, raw in bag.messages(connections=[connection]):
                text = _message(bag, connection, raw).data
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
            text = f"read {listed(others, 3)} at the stamps of {topic}, between theirs by linear interpolation"
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
    fields = vars(_message(bag, connection, raw))
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


def _message(bag: Any, connection: Any, raw: bytes) -> Any:
    if getattr(connection.ext, "serialization_format", "") != "json":
        return bag.deserialize(raw, connection.msgtype)
    message = json.loads(raw, object_hook=lambda entries: SimpleNamespace(**entries))
    return message if hasattr(message, "__dict__") else SimpleNamespace(data=message)


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
