"""Draft of an experiment file from the contents of logs; :mod:`gtau.signals.reading.drafting` writes it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from gtau.errors import GtauError
from gtau.robots.robot import Robot
from gtau.signals.reading.column_names import base_like, is_pose, is_temperature, mass_in_name, wrench_like
from gtau.signals.reading.log_contents import Group, LogContents
from gtau.signals.reading.log_file import find_columns

LARGEST_CURRENT = 100.0  # A; commands of unknown kind with larger values are taken for torques, to be checked
TURNS = 20.0  # rad or m; positions with a larger range are in deg or mm
# Rest of torques beside a straight line of the currents, over their standard deviation, median of the joints; below,
# they are computed from these. Torque sensors of a Rokae: 0.50 (0.40 to 0.80). Currents of a UR10e and that Rokae,
# behind a low-pass of 10 Hz: 0.07 and 0.21; rounded to tenths of their standard deviation: 0.03.
COMPUTED = 0.3


@dataclass(frozen=True)
class Draft:
    """Drafted experiment file: findings (with ``reasons`` by key) and undetermined entries (``open``).

    ``time`` are time columns, one or two, or the ``rate`` (Hz) instead; ``command_time`` those of commands with stamps
    of their own. ``position`` and ``command`` are columns by joint, ``kind`` what the latter hold. ``masses`` (kg) of
    payloads by log come from the names of the files. ``sensors`` are columns of torque sensors by joint, such by their
    names, ``torques`` those that may be. ``others`` are columns that might be meant instead. Columns
    of ``temperature`` are by joint, or one for all; those of a ``pose``, of the ``motion`` of a base and of
    ``wrenches`` are only listed. ``base`` says how the robot's base is placed. Payloads of
    logs that are ``stated`` do not come from their names. ``urdf`` is the text of the robot's file where a bag holds
    it, ``moving`` its joints that the log has, where it lacks others. ``episodes`` are those of logs with several.
    Torques without ``gravity`` are compensated by the controller.
    """

    logs: tuple[tuple[Path, ...], ...]
    robot: str | None
    time: tuple[str, ...]
    rate: float | None
    position: Mapping[str, str]
    command: Mapping[str, str]
    kind: str
    units: Mapping[str, str]
    command_time: tuple[str, ...] = ()
    masses: Mapping[Path, float] = field(default_factory=dict)
    others: tuple[str, ...] = ()
    sensors: Mapping[str, str] = field(default_factory=dict)
    torques: Mapping[str, str] = field(default_factory=dict)
    reasons: Mapping[str, str] = field(default_factory=dict)
    open: tuple[str, ...] = ()
    temperature: Mapping[str, str] | str | None = None
    pose: tuple[str, ...] = ()
    motion: tuple[str, ...] = ()
    wrenches: tuple[str, ...] = ()
    base: Any = None
    stated: frozenset[Path] = frozenset()
    urdf: str | None = None
    moving: tuple[str, ...] = ()
    episodes: Mapping[Path, tuple[int, ...]] = field(default_factory=dict)
    gravity: bool = True


def discover(paths: Sequence[Path], robot: Robot | None = None, source: str | None = None, base: Any = None) -> Draft:
    """Infer the signals of logs recorded with the same layout.

    Parameters
    ----------
    paths : sequence of Path
        The logs, one for each run; or all logs of positions and then as many of commands, run by run.
    robot : Robot, optional
        Its actuated joints are matched with column names; joint types and number help to infer units.
    source : str, optional
        Entry of the experiment file under ``robot``.
    base : optional
        Placement of the robot's base; where it is given, no columns are taken for the motion of a base.

    Raises
    ------
    GtauError
        A log cannot be read, or no positions or no commands are found in it.
    """
    position_log, command_log, runs = _sources(paths, robot)
    positions, commands = position_log.group("position"), command_log.command_group()
    for group, what in ((positions, "positions"), (commands, "currents or torques")):
        if group is None:
            names = position_log.table.columns
            listed = ", ".join(names[:20]) + (", ..." if len(names) > 20 else "")
            raise GtauError(
                f"{paths[0]}: no columns of {what} are recognised among {listed}; write the experiment file by hand "
                "(docs/lookup/experiment-file.md), or rename the columns, such as q1 and current1."
            )
    assert positions is not None and commands is not None  # noqa: PT018 (refused above)
    reasons, unsure, units = dict(position_log.reasons), [], {}
    joints, reasons["position"], by_order = _joints(positions, commands, robot)
    if by_order:
        unsure.append("joints")
    time, rate = position_log.time, None
    if time:
        units["time"], reasons["time"] = position_log.time_unit()
    elif position_log.table.data_set and (rate := position_log.table.data_set.rate) is not None:
        reasons["time"] = f"no time column; {rate:g} Hz by the description of the data set (meta/info.json)"
    else:
        rate, reasons["time"] = position_log.rate_from_velocities(positions)
        unsure.append("rate" if rate is None else "velocities")
    columns = {joint: pair[0] for joint, pair in joints.items()}
    if unit := _position_unit(position_log, positions, columns, robot, reasons):
        units["position"] = unit
        unsure += ["unit"] if positions.unit is None else []
    in_amperes = commands.unit in ("A", "mA")
    kind = "current" if in_amperes or commands.kind in ("current", "motor") else "torque"
    if commands.kind == "motor" and not in_amperes:
        unsure.append("motor")
    elif commands.kind == "torque" and "effort" in commands.first.lower():  # of ROS: content depends on the driver
        unsure.append("kind")
    elif commands.kind == "command" and not in_amperes:
        reach = max(float(np.nanmax(np.abs(command_log.values[pair[1]]))) for pair in joints.values())
        kind = "torque" if reach > LARGEST_CURRENT else "current"
        unsure.append("kind")
    gravity = "current_as_torque" not in commands.first.lower()
    unsure += [] if gravity else ["gravity"]
    if commands.unit in ("A", "mA", "N m", "N"):
        units[kind] = commands.unit
    command_time: tuple[str, ...] = ()
    apart = command_log.path == position_log.path or command_log.rows != position_log.rows
    if command_log is not position_log and command_log.time and apart:
        command_time = command_log.time
    if unstamped := [each for each in (*time[:1], *command_time[:1]) if each.endswith("/received")]:
        reasons["received"] = " and ".join(unstamped)
        unsure.append("received")
    elif time and time[0].endswith("/header/stamp"):
        reasons["time"] += "; measurement stamps, not receipt stamps"
    clocks = position_log.other_clocks()
    if clocks:
        reasons["time"] += f"; {', '.join(clocks)} grow{'s' * (len(clocks) == 1)}, too"
        unsure.append("clock")
    alike = {group.listed: group for group in (*position_log.groups, *command_log.groups) if group.kind != "other"}
    label = {
        joint: next(each for each, name in positions.columns.items() if name == columns[joint]) for joint in joints
    }
    sensors, torques = (_beside(command_log.group(each), label) for each in ("sensor", "torque"))
    currents = {joint: pair[1] for joint, pair in joints.items()}
    if sensors or kind != "current":
        torques = {}
    unsure += ["torques"] if torques else []
    if _computed(command_log, currents, torques):
        reasons["torques"] = "a straight line of the currents, from which they may be computed"
    masses = {run[0]: mass for run in runs if (mass := mass_in_name(run[0].name)) is not None}
    weighed = ["mass"] if masses else []
    used = {positions.listed, commands.listed, *(each.listed for each in command_log.groups if each.kind == "sensor")}
    used |= {
        group.listed for group in command_log.groups if torques and set(torques.values()) <= set(group.columns.values())
    }
    used_names = {*positions.columns.values(), *commands.columns.values()}
    free = [name for name in position_log.table.columns if name not in (*used_names, *time)]
    motion, wrenches = base_like(free) if base is None else (), wrench_like(free)
    unsure += ["base"] * bool(motion) + ["wrenches"] * bool(wrenches)
    draft = Draft(
        logs=tuple(runs),
        robot=source,
        time=time,
        rate=rate,
        position=columns,
        command=currents,
        kind=kind,
        units={key: unit for key, unit in units.items() if unit not in ("s", "rad", "m", "A", "N m", "N")},
        command_time=command_time,
        temperature=_temperature([name for name in position_log.table.columns if name not in time], columns),
        pose=tuple(name for name in free if is_pose(name)),
        motion=motion,
        wrenches=wrenches,
        base=base,
        gravity=gravity,
        masses=masses,
        episodes={run[0]: tuple(of) for run in runs if (of := find_columns(run[0]).episodes)},
        others=tuple(
            listed
            for listed, group in alike.items()
            if listed not in used and not set(group.columns.values()) <= {*motion, *wrenches}
        ),
        sensors=sensors,
        torques=torques,
        reasons=reasons,
        open=(*weighed, *["robot"] * (source is None), *unsure),
    )
    return replace(draft, open=(*draft.open, "reference")) if commands.reference else draft


def _computed(log: LogContents, commands: Mapping[str, str], torques: Mapping[str, str]) -> bool:
    """Decide whether torques are linear functions of the commands and hence computed from them."""
    rests = []
    for joint, column in torques.items():
        x, y = log.values[commands[joint]], log.values[column]
        whole = np.isfinite(x) & np.isfinite(y)
        if whole.sum() > 2 and np.ptp(x[whole]) and np.ptp(y[whole]):
            rests.append(np.sqrt(max(0.0, 1 - np.corrcoef(x[whole], y[whole])[0, 1] ** 2)))
    return bool(rests) and float(np.median(rests)) < COMPUTED


def _beside(group: Group | None, label: Mapping[str, str]) -> dict[str, str]:
    """Map joints to the columns of a group, by the ``label`` that each joint has in the names of columns."""
    return {} if group is None else {joint: group.columns[of] for joint, of in label.items() if of in group.columns}


def _sources(paths: Sequence[Path], robot: Robot | None) -> tuple[LogContents, LogContents, list[tuple[Path, ...]]]:
    """List the logs of the first run's positions and commands, often one, and the files of every run."""
    runs: list[tuple[Path, ...]] = [(path,) for path in paths]
    first, half = LogContents.read(paths[0], robot), len(paths) // 2
    if first.group("position") and first.command_group():
        return first, first, runs
    if first.group("position") and (other := first.of_another_topic(robot)) is not None:
        return first, other, runs
    if not half or len(paths) % 2:
        return first, first, runs
    second = LogContents.read(paths[half], robot)
    if not first.group("position") and second.group("position"):
        return second, first, list(zip(paths[half:], paths[:half], strict=True))
    return first, second, list(zip(paths[:half], paths[half:], strict=True))


def _joints(positions: Group, commands: Group, robot: Robot | None) -> tuple[dict[str, tuple[str, str]], str, bool]:
    """Match columns of positions and commands to joints; also return how, and whether by their order alone."""
    common = [label for label in positions.columns if label in commands.columns]
    pairs = {label: (positions.columns[label], commands.columns[label]) for label in common}
    by_order = False
    if not common and len(positions.columns) == len(commands.columns):
        columns = zip(_ordered(positions.columns), _ordered(commands.columns), strict=True)
        pairs = {q: (positions.columns[q], commands.columns[v]) for q, v in columns}
        by_order = True
    if robot is None:
        named = {label if not label.isdigit() else f"j{label}": pair for label, pair in pairs.items()}
        return named, "joint names from the log", by_order
    joints = robot.actuated
    if set(joints) <= set(pairs):
        how = "positions matched by joint name, commands by column order" if by_order else "matched by joint name"
        return {joint: pairs[joint] for joint in joints}, how, by_order
    if len(pairs) < len(joints):
        raise GtauError(
            f"the log has positions and commands of {len(pairs)} joints ({', '.join(pairs)}), but robot "
            f"'{robot.name}' has {len(joints)} actuated ones; give matching logs and robot."
        )
    numbers = {joint: int(found[-1]) for joint in joints if (found := re.findall(r"\d+", joint))}
    how = "matched by column order"
    if len(set(numbers.values())) == len(joints):  # p4 p1 p2 p3 of the robot, 0 1 2 3 of the log
        by_number = tuple(sorted(joints, key=numbers.__getitem__))
        how = how if by_number == joints else "matched by the numbers in the joints' names"
        joints = by_number
    taken = zip(joints, _ordered(pairs), strict=False)
    return {joint: pairs[label] for joint, label in taken}, how, True


def _ordered(labels: Iterable[str]) -> list[str]:
    """Sort labels by their number; keep the order of those without."""
    labels = list(labels)
    return sorted(labels, key=int) if all(label.isdigit() for label in labels) else labels


def _position_unit(
    log: LogContents, positions: Group, columns: Mapping[str, str], robot: Robot | None, reasons: dict[str, str]
) -> str | None:
    """Determine the unit of the positions, as written or from their range; None for rad and m."""
    if positions.unit in ("deg", "rad", "mm", "m"):
        reasons["unit"] = "unit in the columns' names"
        return positions.unit
    reach = {joint: float(np.nanmax(np.abs(log.values[column]))) for joint, column in columns.items()}
    largest = max(reach, key=reach.__getitem__)
    kinds = {robot.joint(joint).kind for joint in columns} if robot else {"revolute"}
    if reach[largest] > TURNS and len(kinds) == 1:
        unit = "deg" if kinds == {"revolute"} else "mm"
        reasons["unit"] = f"joint '{largest}' reaches {reach[largest]:.4g}, too far for SI units"
        return unit
    reasons["unit"] = f"positions reach {reach[largest]:.4g}"
    return None


def _temperature(names: Sequence[str], joints: Mapping[str, str]) -> Mapping[str, str] | str | None:
    """Match temperature columns to joints, in the order of the joints, or the only one; None where ambiguous."""
    found = [name for name in names if is_temperature(name)]
    if len(found) == len(joints):
        return dict(zip(joints, found, strict=True))
    return found[0] if len(found) == 1 else None
