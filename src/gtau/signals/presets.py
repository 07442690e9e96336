"""Columns of the logs that common recorders write, by name.

Looked up in the recorders' sources: libfranka ``log.cpp`` (time in ms, ``state.q[0]`` ...), Universal Robots' RTDE
client (``timestamp``, ``actual_q_0`` ...), PlotJuggler's parser of ``sensor_msgs/JointState``, and the manual of
TwinCAT 3 Scope View (export to CSV: rows of channel properties, time in ms, channels named by the user).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Preset:
    """Time column with its unit, and patterns of the columns by joint: its number from 0 (``{k}``), or its name."""

    time: str
    time_unit: str = "s"
    position: str | None = None
    current: str | None = None
    torque: str | None = None


PRESETS: Mapping[str, Preset] = {
    "ur_rtde": Preset("timestamp", position="actual_q_{k}", current="actual_current_{k}"),
    "franka": Preset("time", "ms", position="state.q[{k}]", torque="state.tau_J[{k}]"),
    "plotjuggler": Preset("__time", position="/joint_states/{joint}/position", torque="/joint_states/{joint}/effort"),
    "twincat_scope": Preset("time", "ms"),
}


def time_unit(preset: str | None) -> str:
    """Return the unit of the time column where none is given."""
    return "s" if preset is None else PRESETS[preset].time_unit


def expanded(signals: Mapping[str, Any]) -> dict[str, Any]:
    """Fill in the columns of a preset for the ``joints`` named, those given by hand first.

    Raises
    ------
    ValueError
        There is no such preset, or its joints are missing; the text says what to write.
    """
    given = {key: value for key, value in signals.items() if key != "joints"}
    preset = PRESETS.get(str(signals["preset"]))
    if preset is None:
        raise ValueError(f"there is no preset '{signals['preset']}'; choose from {', '.join(PRESETS)}")
    patterns = {"position": preset.position, "current": preset.current, "torque": preset.torque}
    if given.keys() & {"current", "torque", "motor_torque"}:
        patterns |= {"current": None, "torque": None}
    wanted = {key: pattern for key, pattern in patterns.items() if pattern is not None and key not in given}
    joints = signals.get("joints")
    if wanted and (not isinstance(joints, Sequence) or isinstance(joints, str) or not joints):
        raise ValueError(f"the preset '{signals['preset']}' needs the joints in their order; add 'joints: [..., ...]'")
    columns = {
        key: {str(joint): pattern.format(k=k, joint=joint) for k, joint in enumerate(joints or ())}
        for key, pattern in wanted.items()
    }
    return {"time": preset.time} | columns | given
