"""ROS bags of joint states, as drivers and recorders make them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

TOPIC = "/joint_states"


def write_bag(
    path: Path,
    joints: Sequence[str],
    time: np.ndarray,
    position: np.ndarray,
    effort: np.ndarray,
    urdf: str | None = None,
    stamped: bool = True,
    apart: bool = False,
    compression: str = "NONE",
) -> Path:
    """Write an MCAP bag of positions and efforts (N, n); the joints' names change their order now and then.

    Receipt is late by some ms, at random. ``urdf`` is in /robot_description, stamps are 0 unless ``stamped``. Efforts
    that are ``apart`` are in an array of another topic, at half the rate; ``compression`` is one of rosbags' modes, in
    Zstandard, or ``LZ4`` of the chunks, which the MCAP tools of C++ and Go write.
    """
    import lz4.frame
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds, late = store.types, np.random.default_rng(3)
    state, text, array = "sensor_msgs/msg/JointState", "std_msgs/msg/String", "std_msgs/msg/Float64MultiArray"
    layout = kinds["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    bag = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    if compression not in ("NONE", "LZ4"):
        bag.set_compression(CompressionMode[compression], CompressionFormat.ZSTD)
    with bag:
        if compression == "LZ4":
            bag.storage.compression, bag.storage.compressor = "lz4", lz4.frame.compress
        states = bag.add_connection(TOPIC, state, typestore=store)
        currents = bag.add_connection("/motor_currents", array, typestore=store) if apart else None
        if urdf is not None:
            description = bag.add_connection("/robot_description", text, typestore=store)
            bag.write(description, 0, store.serialize_cdr(kinds[text](data=urdf), text))
        for k, (t, q, v) in enumerate(zip(time, position, effort, strict=True)):
            stamp = round((50.0 + t) * 1e9)
            received = stamp + int(late.uniform(1e6, 3e6))
            order = slice(None, None, -1 if k % 7 == 3 else 1)
            header = kinds["std_msgs/msg/Header"](
                stamp=kinds["builtin_interfaces/msg/Time"](*divmod(stamp * stamped, 10**9)), frame_id=""
            )
            values = (q, 0 * q, np.empty(0) if apart else v)
            message = kinds[state](
                header, list(joints[order]), *(np.ascontiguousarray(each[order], dtype=float) for each in values)
            )
            bag.write(states, received, store.serialize_cdr(message, state))
            if currents is not None and k % 2 == 0:
                data = np.ascontiguousarray(v, dtype=float)
                bag.write(currents, stamp, store.serialize_cdr(kinds[array](layout, data), array))
    return path
