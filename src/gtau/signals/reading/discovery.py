"""Draft of an experiment file from the contents of logs; :mod:`gtau.signals.reading.drafting` writes it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from gtau.errors import GtauError, short
from gtau.findings.words import counted
from gtau.robots.robot import Robot
from gtau.signals.reading.column_names import base_like, is_pose, is_temperature, resembling, wrench_like
from gtau.signals.reading.log_contents import COMMANDS, Group, LogContents
from gtau.signals.reading.masses import masses_in_name
from gtau.signals.reading.units import si_factor
from gtau.signals.reading.written_units import SI, read_unit

LARGEST_CURRENT = 100.0  # A; commands of unknown kind with larger values are taken for torques, to be checked
# Rad or m; positions with a larger range are in deg or mm, unless velocities or range say that joints turn many times:
# no arm turns by more than two turns either way (deg) or faster than this (rad/s), as motors before their gears do.
TURNS = 20.0
MOST_DEGREES, FASTEST = 720.0, 30.0
ALIKE = 0.1  # by which the derivative of positions may differ from the velocities, or from them in another unit
# Rest of torques beside a straight line of the currents, over their standard deviation, median of the joints; below,
# they are computed from these. Torque sensors of a Rokae: 0.50 (0.40 to 0.80). Currents of a UR10e and that Rokae,
# behind a low-pass of 10 Hz: 0.07 and 0.21; rounded to tenths of their standard deviation: 0.03.
COMPUTED = 0.3

UNSURE = {
    "masses": "write the payload masses ('or' in the file) that file names give in several ways: they set the scale of "
    "all drive gains",
    "mass": "confirm the payload masses, read from the file names: they set the scale of all drive gains",
    "robot": "name the robot: a name of the catalog (gtau robot), or the path of its URDF, MJCF or robot file",
    "unmatched": "joints that the log lacks are held at home, but columns move that are not used; if they are of such "
    "a joint, write them at its name",
    "counts": "replace counts and unknown units by the size of one count (units: {current: 0.00269 A}); for shares add "
    "the rated values (units: {rated: {JOINT: 5.2}})",
    "joints": "confirm which columns are of which joint",
    "rate": "write the sampling rate, which is not in the log (time: {rate: HZ})",
    "velocities": "confirm the sampling rate, found from the velocities (time: {rate: HZ})",
    "unit": "confirm the unit of the positions (units: {position: ...}), or, of motors before their gears, the "
    "joint's angle for one unit (0.01 rad)",
    "motor": "confirm that these are proportional to the currents; motor torques are 'motor_torque:', with a "
    "'gear_ratio:'",
    "kind": "confirm whether these are currents or torques (key 'current:' or 'torque:')",
    "gravity": "confirm that the controller compensates gravity in these torques, or remove 'gravity' of the robot",
    "received": "messages without measurement stamps get receipt stamps, with the jitter of the middleware",
    "clock": "confirm the time column, as other columns increase too",
    "torques": "remove the '#' of joint_torque if those are sensors behind the gears, not computed from currents",
    "sensors": "if they are computed from currents or by the controller's model, state the mass of a payload instead "
    "(--payload LOG=KG)",
    "base": "if the base of the robot moved, write 'base: floating' and the columns of its motion "
    "(docs/lookup/experiment-file.md, 'A base that floats')",
    "wrenches": "if forces that act on the robot are logged, describe them under 'wrenches:', those on a floating "
    "base under 'base:' (docs/lookup/experiment-file.md, 'Wrenches on bodies')",
    "reference": "confirm that these are the references of the current loops, not the feed-forward of a model",
}
"""Questions to the user, by the open points of a draft, in the order in which they are asked."""


@dataclass(frozen=True)
class Draft:
    """Drafted experiment file, with the ``reasons`` of its entries by key, and undetermined entries (``open``).

    ``logs`` are one file or two of each run; ``signals``, ``units`` and ``robot`` are as under these keys of the file,
    but ``robot`` has no ``file`` where it is unknown, and a rate is None. ``masses`` (kg) of payloads by log come from
    the names of the files where they are not ``stated``; NaN is to be weighed. ``readings`` are those of names with
    several. ``beside`` are columns that are not used, some by joint: ``temperature``, ``torques`` that may be of
    sensors, a ``pose``, the ``motion`` of a base, ``wrenches``, and ``others`` that might be meant instead, torques
    that are ``still``. ``urdf`` is the text of the robot's file where a bag holds it.
    """

    logs: tuple[tuple[Path, ...], ...]
    signals: Mapping[str, Any]
    units: Mapping[str, Any]
    robot: Mapping[str, Any]
    masses: Mapping[Path, float]
    reasons: Mapping[str, str]
    open: tuple[str, ...]
    readings: Mapping[Path, tuple[float, ...]] = field(default_factory=dict)
    stated: frozenset[Path] = frozenset()
    beside: Mapping[str, Any] = field(default_factory=dict)
    urdf: str | None = None

    @property
    def kind(self) -> str:
        """Kind of the commands."""
        return "current" if "current" in self.signals else "torque"

    @property
    def command(self) -> Mapping[str, str]:
        """Columns of the commands by joint."""
        return self.signals[self.kind]

    @property
    def time(self) -> tuple[str, ...]:
        """Columns of the positions' time, one or two, or none."""
        time = self.signals["time"]
        time = time.get("position", ()) if isinstance(time, Mapping) else time
        return (time,) if isinstance(time, str) else tuple(time)

    @property
    def rate(self) -> float | None:
        """Sampling rate of a log without time column, Hz, where it is known."""
        time = self.signals["time"]
        return time.get("rate") if isinstance(time, Mapping) else None


def discover(paths: Sequence[Path], robot: Robot | None = None, source: str | None = None, base: Any = None) -> Draft:
    """Infer the signals of logs recorded with the same layout, one for each run, or positions and then commands.

    The actuated joints of the ``robot`` are matched with column names; joint types and number help to infer units.
    ``source`` is its entry in the experiment file. Where the placement of its ``base`` is given, no columns are taken
    for the motion of a base. Raises GtauError where a log cannot be read, or holds no positions or no commands.
    """
    position_log, command_log, runs = _sources(paths, robot)
    positions, commands = position_log.group("position"), command_log.command_group()
    if positions is None or commands is None:
        names = position_log.table.columns
        listed = ", ".join(map(short, names[:20])) + (", ..." if len(names) > 20 else "")
        what = "positions" if positions is None else "currents or torques"
        still = [group.listed for group in command_log.groups if group.kind in COMMANDS and positions is not None]
        listed += f" ({'; '.join(still)} never change, or are boolean)" * bool(still)
        named = "" if robot else "give the robot whose joints they name (--robot ROBOT), "
        raise GtauError(
            f"no columns of {what} are recognised among {listed}; {named}write the experiment file by hand "
            "(docs/lookup/experiment-file.md), or rename columns or arrays, such as q1 and current1.",
            source=paths[0],
        )
    reasons, units = dict(position_log.reasons), dict[str, Any]()
    if position_log.elsewhere and len(positions.columns) == 1:
        listed = ", ".join((positions.first, *position_log.elsewhere[:7]))
        raise GtauError(
            f"every joint has a topic of its own ({listed}), but gtau takes the positions of a run from one; merge the "
            "topics into a table with one clock.",
            source=paths[0],
        )
    alike = dict[str, str]()
    if robot:
        positions, commands = (_alike(group, robot.actuated, alike) for group in (positions, commands))
    joints, reasons["position"], by_order = _joints(positions, commands, robot)
    reasons["position"] += "".join(f", {label} taken for {joint}" for label, joint in alike.items())
    unsure = {"joints"} if by_order or alike else set()
    columns, currents = ({joint: pair[k] for joint, pair in joints.items()} for k in (0, 1))
    time = _time(position_log, command_log, positions, units, reasons, unsure)
    if written := _units(position_log, "position", columns):
        units, reasons["unit"] = units | written, "units as written in the log"
    elif unit := _position_unit(position_log, positions, columns, robot, reasons):
        units["position"] = unit
        unsure |= {"unit"} if positions.unit is None else set()
    kind, doubts = _kind(commands, command_log, currents)
    compensated = "current_as_torque" in commands.first.lower()
    unsure |= doubts | ({"gravity"} if compensated else set()) | ({"reference"} if commands.reference else set())
    units |= _units(command_log, kind, currents)
    labels = {name: label for label, name in positions.columns.items()}
    logged = {joint: labels[column] for joint, column in columns.items()}
    sensors, still = _sensors(command_log, "sensor", logged)
    torques = dict[str, str]()
    if not sensors and kind == "current":
        torques, others = _sensors(command_log, "torque", logged)
        still += others
    if _computed(command_log, currents, torques):
        reasons["torques"] = "a straight line of the currents, from which they may be computed"
    units |= _units(command_log, "joint_torque", sensors)
    unsure |= {"counts"} if any(_unread(key, unit) for key, unit in units.items()) else set()
    logs = {log.table.path: log for log in (position_log, command_log)}.values()
    taken, known = (*columns.values(), *currents.values()), (*logged, *logged.values())
    lonely = [column for log in logs for column in log.moving_beside(taken, known, commands.kind)]
    lonely += position_log.elsewhere
    if robot and lonely:
        reasons["unmatched"] = ", ".join(lonely)
        unsure |= {"unmatched"} if len(joints) < len(robot.actuated) else set()
    used = {*positions.columns.values(), *commands.columns.values()}
    beside = _unused(position_log, command_log, used, columns, torques, base is not None) | {"still": still}
    readings = {run[0]: masses for run in runs if (masses := masses_in_name(run[0].name))}
    several = {log: masses for log, masses in readings.items() if len(masses) > 1}
    doubtful = beside | {"base": beside["motion"], "mass": readings, "masses": several, "robot": source is None}
    unsure |= {key for key in ("torques", "wrenches", "base", "mass", "masses", "robot") if doubtful[key]}
    moving = list(joints) if robot and len(joints) < len(robot.actuated) else None
    entries = {"file": source, "base": base, "gravity": [0, 0, 0] if compensated else None, "joints": moving}
    return Draft(
        logs=tuple(runs),
        signals={"time": time, "position": columns, kind: currents} | ({"joint_torque": sensors} if sensors else {}),
        units={
            key: unit
            for key, unit in units.items()
            if unit not in ("s", "rad", "m", "A", "N m", "N") or (key == "position" and "unit" in unsure)
        },
        robot={key: entry for key, entry in entries.items() if entry is not None},
        masses={log: masses[0] for log, masses in readings.items()},
        readings=several,
        reasons=reasons,
        open=tuple(key for key in UNSURE if key in unsure),
        beside=beside,
    )


def _time(
    log: LogContents,
    command_log: LogContents,
    positions: Group,
    units: dict[str, Any],
    reasons: dict[str, str],
    unsure: set[str],
) -> Any:
    """Find the time columns of positions, and of commands with stamps of their own, or the sampling rate."""
    if not log.time:
        rate = log.rate
        reasons["time"] = f"no time column; {rate or 0:g} Hz by the description of the data set (meta/info.json)"
        if rate is None:
            rate, reasons["time"] = log.rate_from_velocities(positions)
            unsure.add("rate" if rate is None else "velocities")
        return {"rate": rate}
    unit, reasons["time"] = log.time_unit()
    units |= {"time": unit} if unit != "s" else {}
    apart = command_log.table.path == log.table.path or command_log.rows != log.rows
    stamps = command_log.time if command_log is not log and apart else ()
    if unstamped := [name for name in (*log.time[:1], *stamps[:1]) if name.endswith("/received")]:
        reasons["received"] = " and ".join(unstamped)
        unsure.add("received")
    elif log.time[0].endswith("/header/stamp"):
        reasons["time"] += "; measurement stamps, not receipt stamps"
    if clocks := log.other_clocks():
        reasons["time"] += f"; {', '.join(clocks)} grow{'s' * (len(clocks) == 1)}, too"
        unsure.add("clock")
    time, command_time = (times[0] if len(times) == 1 else list(times) for times in (log.time, stamps))
    return {"position": time, "command": command_time} if stamps else time


def _kind(commands: Group, log: LogContents, columns: Mapping[str, str]) -> tuple[str, set[str]]:
    """Decide whether commands are currents or torques, and whether that is to be confirmed."""
    written = [read_unit(log.units[column]) for column in columns.values() if column in log.units]
    in_amperes = any(unit and unit.measures == "current" for unit in written)
    if commands.kind == "torque":  # efforts of ROS are what the driver writes
        return "current" if in_amperes else "torque", {"kind"} if "effort" in commands.first.lower() else set()
    if commands.kind == "motor" and not in_amperes:
        return "current", {"motor"}
    if commands.kind == "command" and not in_amperes:
        reach = max(float(np.nanmax(np.abs(log.values[column]))) for column in columns.values())
        return "torque" if reach > LARGEST_CURRENT else "current", {"kind"}
    return "current", set()


def _unused(
    log: LogContents,
    command_log: LogContents,
    used: set[str],
    joints: Mapping[str, str],
    torques: Mapping[str, str],
    placed: bool,
) -> dict[str, Any]:
    """List the columns that are not used, by what they may hold; no motion of a base that is ``placed``."""
    columns = [name for name in log.table.columns if name not in log.time]
    unused = [name for name in columns if name not in used]
    motion, wrenches = () if placed else base_like(unused), wrench_like(unused)
    if torques and (group := command_log.group("torque")):
        used = used | set(group.columns.values())
    groups = {group.listed: group for group in (*log.groups, *command_log.groups)}
    candidates = {listed: group for listed, group in groups.items() if group.kind not in ("other", "sensor")}
    named = {*used, *motion, *wrenches}
    temperatures = [name for name in columns if is_temperature(name)]
    temperature: Any = temperatures[0] if len(temperatures) == 1 else None  # ambiguous
    if len(temperatures) == len(joints):
        temperature = dict(zip(joints, temperatures, strict=True))
    return {
        "temperature": temperature,
        "torques": torques,
        "pose": tuple(name for name in unused if is_pose(name)),
        "motion": motion,
        "wrenches": wrenches,
        "others": tuple(listed for listed, group in candidates.items() if not set(group.columns.values()) <= named),
    }


def _sensors(log: LogContents, kind: str, labels: Mapping[str, str]) -> tuple[dict[str, str], list[str]]:
    """Select the measured torques of a kind by joint, and list those that never change."""
    group = log.group(kind)
    if group is None or group.reference:
        return {}, []
    group = _alike(group, list(labels.values()), {})
    columns = {joint: group.columns[label] for joint, label in labels.items() if label in group.columns}
    still = [column for column in columns.values() if log.is_still(column)]
    return {joint: column for joint, column in columns.items() if column not in still}, still


def _computed(log: LogContents, commands: Mapping[str, str], torques: Mapping[str, str]) -> bool:
    """Decide whether torques are linear functions of the commands and hence computed from them."""
    rests = []
    for joint, column in torques.items():
        x, y = log.values[commands[joint]], log.values[column]
        finite = np.isfinite(x) & np.isfinite(y)
        if finite.sum() > 2 and np.ptp(x[finite]) and np.ptp(y[finite]):
            rests.append(np.sqrt(max(0.0, 1 - np.corrcoef(x[finite], y[finite])[0, 1] ** 2)))
    return bool(rests) and float(np.median(rests)) < COMPUTED


def _sources(paths: Sequence[Path], robot: Robot | None) -> tuple[LogContents, LogContents, list[tuple[Path, ...]]]:
    """List the logs of the first run's positions and commands, often one, and the files of every run."""
    runs: list[tuple[Path, ...]] = [(path,) for path in paths]
    first, half = LogContents.read(paths[0], robot), len(paths) // 2
    if first.group("position"):
        if first.command_group():
            return first, first, runs
        if (other := first.of_another_topic(robot)) is not None:
            return first, other, runs
    if not half or len(paths) % 2:
        return first, first, runs
    second = LogContents.read(paths[half], robot)
    if second.group("position") and not first.group("position"):
        return second, first, list(zip(paths[half:], paths[:half], strict=True))
    return first, second, list(zip(paths[:half], paths[half:], strict=True))


def _joints(positions: Group, commands: Group, robot: Robot | None) -> tuple[dict[str, tuple[str, str]], str, bool]:
    """Match columns of positions and commands to joints, of a robot without loops some of them.

    Also return how they were matched, and whether by their order alone.
    """
    common = [label for label in positions.columns if label in commands.columns]
    pairs = {label: (positions.columns[label], commands.columns[label]) for label in common}
    by_order = False
    if not common and len(positions.columns) == len(commands.columns):
        columns = zip(_ordered(positions.columns), _ordered(commands.columns), strict=True)
        pairs = {q: (positions.columns[q], commands.columns[v]) for q, v in columns}
        by_order = True
    if robot is None:
        named = {f"j{label or 1}" if label.isdigit() or not label else label: pair for label, pair in pairs.items()}
        return named, "joint names from the log", by_order
    joints = robot.actuated
    known, unknown = [joint for joint in joints if joint in pairs], [name for name in pairs if name not in joints]
    some = known and not robot.closures and not any(name.isdigit() for name in unknown)
    if some or len(known) == len(joints):
        how = "positions matched by joint name, commands by column order" if by_order else "matched by joint name"
        return {joint: pairs[joint] for joint in known}, how, by_order
    if 0 < len(pairs) < len(joints) and len(chain := _chain(robot)) == len(pairs):
        joints = chain
    if len(pairs) < len(joints):
        listed = f" ({', '.join(pairs)})" if pairs and all(pairs) else ""
        raise GtauError(
            f"the log has positions and commands of {counted(len(pairs), 'joint')}{listed}, but robot "
            f"'{robot.name}' has {len(joints)} actuated ones; "
            + (f"name the columns after their joints (q_{joints[0]}), or " if not robot.closures else "")
            + "give matching logs and robot."
        )
    numbers = {joint: int(digits[-1]) for joint in joints if (digits := re.findall(r"\d+", joint))}
    how = "matched by column order"
    if len(set(numbers.values())) == len(joints):  # p4 p1 p2 p3 of the robot, 0 1 2 3 of the log
        by_number = tuple(sorted(joints, key=numbers.__getitem__))
        how = how if by_number == joints else "matched by the numbers in the joints' names"
        joints = by_number
    ordered = _ordered(pairs)
    assigned = {joint: pairs[label] for joint, label in zip(joints, ordered, strict=False)}
    return assigned, how, True


def _alike(group: Group, joints: Sequence[str], alike: dict[str, str]) -> Group:
    """Rename labels that are no joint's name but nearly, and collect them in ``alike``."""
    unknown = [label for label in group.columns if label not in joints and not label.isdigit()]
    renamed = resembling(unknown, [joint for joint in joints if joint not in group.columns])
    alike |= renamed
    return replace(group, columns={renamed.get(label, label): column for label, column in group.columns.items()})


def _chain(robot: Robot) -> tuple[str, ...]:
    """List the actuated joints that carry the tool; none where another branch has as many."""
    chains: dict[str, tuple[str, ...]] = {}
    for joint in robot.joints:
        chains[joint.name] = chains.get(joint.antecedent, ()) + (joint.name,) * joint.actuated
    chain = chains.get(robot.tool, ())
    return chain if sum(len(other) == len(chain) for other in set(chains.values())) == 1 else ()


def _ordered(labels: Iterable[str]) -> list[str]:
    """Sort labels by their number; keep the order of those without."""
    labels = list(labels)
    return sorted(labels, key=int) if all(label.isdigit() for label in labels) else labels


def _units(log: LogContents, key: str, columns: Mapping[str, str]) -> dict[str, Any]:
    """Return what to write under ``key`` of the units: the units in the log, other than SI, one or by joint."""
    written = {joint: unit for joint, column in columns.items() if (unit := log.units.get(column)) and unit not in SI}
    units = set(written.values())
    if not units:
        return {}
    return {key: units.pop() if len(units) == 1 and len(written) == len(columns) else written}


def _unread(key: Any, units: Any) -> bool:
    """Decide whether an experiment file refuses one of these units, as that of a count."""
    try:
        for unit in units.values() if isinstance(units, Mapping) else [units]:
            si_factor(unit, "torque" if key == "joint_torque" else key)
    except ValueError:
        return True
    return False


def _position_unit(
    log: LogContents, positions: Group, columns: Mapping[str, str], robot: Robot | None, reasons: dict[str, str]
) -> str | None:
    """Determine the unit of the positions, as written or from velocities and range; None for rad and m as usual."""
    if positions.unit in ("deg", "rad", "mm", "m"):
        reasons["unit"] = "unit in the columns' names"
        return positions.unit
    reach, joint = max((float(np.nanmax(np.abs(log.values[column]))), joint) for joint, column in columns.items())
    kinds = {robot.joint(name).kind for name in columns} if robot else {"revolute"}
    ratio, fastest = log.slope(positions) if kinds == {"revolute"} else (None, 0.0)
    for unit, per_velocity in (("deg", 180 / np.pi), ("rad", np.pi / 180)):
        if ratio is not None and abs(ratio / per_velocity - 1) < ALIKE:
            reasons["unit"] = f"their derivative is {ratio:.4g} times the velocities"
            return unit
    if not reach > TURNS or len(kinds) > 1:
        reasons["unit"] = f"positions reach {reach:.4g}"
        return None
    reasons["unit"] = f"joint '{joint}' reaches {reach:.4g}, too far for SI units"
    if kinds != {"revolute"}:
        return "mm"
    limits = {name: robot.joint(name).limits.position for name in columns} if robot else {}
    beyond = any(  # where deg are taken for rad, joints with limits are far outside
        limit and float(np.nanmax(np.abs(log.values[columns[name]]))) > 2 * max(map(abs, limit))
        for name, limit in limits.items()
    )
    alike = ratio is not None and abs(ratio - 1) < ALIKE and fastest < FASTEST and not beyond
    if beyond or not (alike or reach > MOST_DEGREES):
        return "deg"
    reasons["unit"] = f"joint '{joint}' reaches {reach:.4g}, " + (
        f"but the velocities are the derivative and reach only {fastest:.4g}" if alike else "too far even for deg"
    )
    return "rad"
