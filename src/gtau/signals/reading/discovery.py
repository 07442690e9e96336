"""Draft of an experiment file from the contents of logs; :mod:`gtau.signals.reading.drafting` writes it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from gtau.documents.validation import read_group
from gtau.errors import GtauError, errors_at
from gtau.pages import page
from gtau.robots.robot import Coupling, Robot
from gtau.signals.channel import SENSOR, SIDE_SIGNALS, SUPPLY
from gtau.signals.reading.column_names import POSE, Group, has_word, matched, renamed_labels
from gtau.signals.reading.columns import Signals
from gtau.signals.reading.formats import listed
from gtau.signals.reading.log_contents import COMMANDS, LogContents
from gtau.signals.reading.statements import masses_in_name
from gtau.signals.reading.units import SI, is_unit, read_unit

FLOATING = page("experiment-file", "A base that floats")
QUESTIONS = {
    "masses": "write the payload masses ('or' in the file) that file names give in several ways: they set the scale of "
    "all drive gains",
    "mass": "confirm the payload masses, read from the file names: they set the scale of all drive gains",
    "robot": "name the robot: a name of the catalog (gtau robot), or the path of its URDF, MJCF or robot file",
    "unit": "confirm the unit of the positions (units: {position: ...}), or, of motors before their gears, the "
    "joint's angle for one unit (0.01 rad)",
    "unmatched": "joints that the log lacks are held at home, but columns move that are not used; if they are of such "
    "a joint, write them at its name",
    "counts": "replace counts and unknown units by the size of one count (units: {current: 0.00269 A}); for shares add "
    "the rated values (units: {rated: {JOINT: 5.2}})",
    "joints": "confirm which columns belong to which joint",
    "rate": "write the sampling rate, which is not in the log (time: {rate: HZ})",
    "velocities": "confirm the sampling rate, found from the velocities (time: {rate: HZ})",
    "motor": "confirm that these are proportional to the currents; motor torques, times the gear ratios, are 'torque:'",
    "kind": "confirm whether these are currents or torques (key 'current:' or 'torque:')",
    "gravity": "confirm that the controller compensates gravity in these torques, or remove 'gravity' of the robot",
    "received": "messages without measurement stamps get receipt stamps, with the jitter of the middleware",
    "clock": "confirm the time column, as other columns increase too",
    "torques": "remove the '#' of joint_torque if these come from sensors behind the gears, not from currents",
    "sensors": "if they are computed from currents or by the controller's model, state the mass of a payload instead "
    "(--payload LOG=KG)",
    "reference": "confirm that these are the references of the current loops, not the feed-forward of a model",
}
"""Questions about the open points of a draft, in the order in which they are asked."""


@dataclass(frozen=True)
class Unused:
    """Columns that a draft does not use, by what they may hold.

    ``side`` are side signals by key; ``torques``, by joint, may be of sensors unless they are ``computed`` from the
    currents; ``still`` torques never change; ``moving`` are positions and commands of joints that the robot lacks;
    ``others`` might be meant in place of the columns that are used.
    """

    side: Mapping[str, str | Mapping[str, str]] = field(default_factory=dict)
    torques: Mapping[str, str] = field(default_factory=dict)
    computed: bool = False
    pose: tuple[str, ...] = ()
    still: tuple[str, ...] = ()
    moving: tuple[str, ...] = ()
    others: tuple[str, ...] = ()


@dataclass(frozen=True)
class Reasons:
    """Reasons for the choice of the time column, of the joints' columns and of the positions' unit."""

    time: str
    position: str
    unit: str
    velocity: str = ""


@dataclass(frozen=True)
class Draft:
    """Drafted experiment file, with one file or two of each run; ``robot`` has no ``file`` where it is unknown.

    ``payloads`` are masses (kg) by log: several where the name of the file has several readings, NaN where the payload
    is to be weighed; the logs ``stated`` have masses by option; ``names`` of payloads that are known, by the names that
    drafts give them. ``open`` are the points to confirm, keys of
    ``QUESTIONS``, each with what is assumed. ``urdf`` is the robot's file from a bag.
    """

    logs: tuple[tuple[Path, ...], ...]
    signals: Signals
    units: Mapping[str, Any]
    robot: Mapping[str, Any]
    payloads: Mapping[Path, tuple[float, ...]]
    reasons: Reasons
    open: Mapping[str, str] = field(default_factory=dict)
    unused: Unused = Unused()
    stated: frozenset[Path] = frozenset()
    names: Mapping[str, str] = field(default_factory=dict)
    urdf: str | None = None


class NoColumns(GtauError):
    """Error raised for a log of which no columns are recognised."""


LARGEST_CURRENT = 100.0  # A; commands of unknown kind with larger values are taken for torques, to be checked
# Rad or m; positions with a larger range are in deg or mm, unless velocities or range say that joints turn many times:
# no arm turns by more than two turns either way (deg) or faster than this (rad/s), as motors before their gears do.
TURNS = 20.0
MOST_DEGREES, FASTEST = 720.0, 30.0
UNKNOWN_RATE = 1000.0  # Hz, to be corrected
ALIKE = 0.1  # by which the derivative of positions may differ from the velocities, or from them in another unit
COMPUTED = 0.3  # rest of torques beside a straight line of the currents, of their rms: below, they are computed


def discover(
    paths: Sequence[Path],
    robot: Robot | None = None,
    source: str | None = None,
    base: Any = None,
    columns: Mapping[str, str] | None = None,
) -> Draft:
    """Infer the signals of logs recorded with the same layout, one for each run, or positions and then commands.

    ``source`` is the entry of the ``robot`` in the file. ``columns`` are patterns of the columns of the first log by
    kind, see :meth:`LogContents.stated`; they are matched with the joints by name or in their order.
    """
    if columns:
        log = command_log = LogContents.read(paths[0], robot).stated(columns)
        runs: list[tuple[Path, ...]] = [(path,) for path in paths]
    else:
        log, command_log, runs = _sources(paths, robot)
    positions, commands = _groups(log, command_log, robot)
    with errors_at(paths[0]):
        positions_of, currents, labels, how, by_name = matched(positions, commands, robot)
        for joint in robot.actuated if robot else ():
            column = positions.columns.get(joint)
            if column and joint not in positions_of and not log.is_still(column):
                raise NoColumns(f"'{column}' moves, but no {commands.kind} column is of '{joint}'; log it as well.")
    clock, why_time, open_ = _clock(log, command_log, positions)
    kind, doubts = _kind(commands, command_log, currents)
    sensors, still = _sensors(command_log, "sensor", labels)
    entries = {"time": clock, "position": positions_of, kind: currents} | ({"joint_torque": sensors} if sensors else {})
    signals = read_group(Signals, "signals", entries)
    used = {*positions.columns.values(), *commands.columns.values()}
    unused = _unused(log, command_log, signals, labels, used)
    unused = replace(unused, still=(*still, *unused.still), moving=unused.moving if robot else ())
    unit, why_unit = _position_unit(log, positions, positions_of, robot)
    written = _units(log, "position", positions_of)
    if unit and not written and positions.unit is None:
        open_["unit"] = f"positions are assumed to be in {unit}: {why_unit}"
    units = {"time": log.time_unit()[0]} if log.time else {}
    units |= written or ({"position": unit} if unit else {})
    units |= _units(command_log, kind, currents) | _units(command_log, "joint_torque", sensors)
    stated = {"position"} if "unit" in open_ else set()
    moving = list(positions_of) if robot and len(positions_of) < len(robot.actuated) else None
    gravity = [0, 0, 0] if "gravity" in doubts else None
    entries = {"file": source, "base": base, "gravity": gravity, "joints": moving}
    draft = Draft(
        logs=tuple(runs),
        signals=signals,
        units={key: unit for key, unit in units.items() if key in stated or unit not in tuple(SI)},
        robot={key: entry for key, entry in entries.items() if entry is not None},
        payloads={run[0]: masses for run in runs if (masses := masses_in_name(run[0].name))},
        reasons=Reasons(why_time, how, "units as written in the log" if written else why_unit, log.velocity),
        unused=unused,
    )
    open_ |= doubts | _open_points(draft, by_name)
    return replace(draft, open={key: open_[key] for key in QUESTIONS if key in open_})


def _open_points(draft: Draft, by_name: bool) -> dict[str, str]:
    unused, how = draft.unused, draft.reasons.position
    order = f", {how.partition(', ')[2]}" if " taken for " in how else " in order"
    columns = ", ".join(f"{joint}: {column}" for joint, column in draft.signals.position.items())
    units = {key: unit if isinstance(unit, Mapping) else {"": unit} for key, unit in draft.units.items()}
    known = [
        is_unit(unit, "torque" if key == "joint_torque" else key)  # type: ignore[arg-type]
        for key, by_joint in units.items()
        for unit in by_joint.values()
    ]
    written = [
        f"{key} in " + ", ".join(f"{unit} ({joint})" if joint else unit for joint, unit in by_joint.items())
        for key, by_joint in units.items()
    ]
    computed = ": they are a straight line of the currents, from which they may be computed" * unused.computed
    readings = {len(masses) for masses in draft.payloads.values()}
    points = {
        "masses": (readings - {1}, ""),
        "mass": (1 in readings, ""),
        "robot": ("file" not in draft.robot, ""),
        "unmatched": (unused.moving and "joints" in draft.robot, ""),
        "counts": (not all(known), f"the log gives counts, shares or unknown units ({', '.join(written)})"),
        "joints": (not by_name, f"columns were assigned to the joints{order}: {columns}"),
        "torques": (unused.torques, f"{listed(unused.torques.values())} are not used{computed}"),
    }
    return {key: assumed for key, (is_open, assumed) in points.items() if is_open}


def _sources(paths: Sequence[Path], robot: Robot | None) -> tuple[LogContents, LogContents, list[tuple[Path, ...]]]:
    runs: list[tuple[Path, ...]] = [(path,) for path in paths]
    first, half = LogContents.read(paths[0], robot), len(paths) // 2
    if first.group("position"):
        if first.command_group():
            return first, first, runs
        if (commands := first.command_topic(robot)) is not None:
            return first, commands, runs
    halves = (paths[:half], paths[half:]), (paths[::2], paths[1::2])  # all of one kind before the others, or in turn
    for some, others in halves if len(paths) == 2 * half else ():
        second = LogContents.read(others[0], robot)
        if first.group("position") and second.command_group():
            return first, second, list(zip(some, others, strict=True))
        if second.group("position") and not (first.group("position") or second.command_group()):
            return second, first, list(zip(others, some, strict=True))
    return first, first, runs


def _groups(log: LogContents, command_log: LogContents, robot: Robot | None) -> tuple[Group, Group]:
    """Select the columns of positions and of commands; raises GtauError where a log has none."""
    positions, commands = log.group("position"), command_log.command_group()
    if positions is None or commands is None:
        columns = listed(log.table.columns, 20) + " (without names, and none holds velocities of others)" * (
            not log.groups
        )
        what = "positions" if positions is None else "currents or torques"
        still = [group.listed for group in command_log.groups if group.kind in COMMANDS and positions is not None]
        columns += f" ({'; '.join(still)} never change, are boolean or hold no numbers)" * bool(still)
        named = "" if robot else "give the robot whose joints they name (--robot ROBOT), "
        raise NoColumns(
            f"no columns of {what} are recognised among {columns}; {named}give also the log that holds them (in an "
            f"experiment file 'log: [POSITIONS, CURRENTS]'), write that file by hand ({page('experiment-file')}), name "
            "them by --position, --current and --time, or rename columns or arrays, such as q1 and current1.",
            source=log.table.path,
        )
    return positions, commands


def _clock(log: LogContents, command_log: LogContents, positions: Group) -> tuple[Any, str, dict[str, str]]:
    if not log.time and log.rate:
        how = f"no time column; {log.rate:g} Hz by the description of the data set (meta/info.json)"
        return {"rate": log.rate}, how, {}
    if not log.time:
        rate, how = log.rate_from_velocities(positions)
        points = {"velocities": f"the sampling rate is assumed to be {rate:g} Hz"} if rate else {"rate": ""}
        return {"rate": rate or UNKNOWN_RATE}, how, points
    reason, points = log.time_unit()[1], {}
    apart = command_log.table.path == log.table.path or command_log.rows != log.rows
    stamps = command_log.time if command_log is not log and apart else ()
    if unstamped := [name for name in (*log.time[:1], *stamps[:1]) if name.endswith("/received")]:
        points["received"] = f"time is {' and '.join(unstamped)}, the receipt stamps"
    elif log.time[0].endswith("/header/stamp"):
        reason += "; measurement stamps, not receipt stamps"
    if clocks := log.other_clocks():
        reason += f"; {', '.join(clocks)} grow{'s' * (len(clocks) == 1)}, too"
        points["clock"] = f"time is {' and '.join(log.time)}, but other columns increase too"
    time, command_time = (names[0] if len(names) == 1 else list(names) for names in (log.time, stamps))
    return {"position": time, "command": command_time} if stamps else time, reason, points


def _kind(
    commands: Group, log: LogContents, columns: Mapping[str, str]
) -> tuple[Literal["current", "torque"], dict[str, str]]:
    """Decide whether commands are currents or torques, and list the points to confirm about them."""
    units = [read_unit(log.units[column]) for column in columns.values() if column in log.units]
    unclear = "" if any(unit and unit.measures == "current" for unit in units) else commands.kind
    kind: Literal["current", "torque"] = "current"
    if unclear == "torque" or (unclear == "command" and _reach(log, columns) > LARGEST_CURRENT):
        kind = "torque"
    names = dict.fromkeys([*columns.values()][:: max(len(columns) - 1, 1)])
    these = f"{' ... '.join(names)} {'are' if len(columns) > 1 else 'is'}"
    effort = commands.kind == "torque" and "effort" in commands.first.lower()  # in ROS what the driver writes
    points = {
        "kind": (effort or unclear == "command", f"assumed to be {kind}s"),
        "motor": (unclear == "motor", "assumed to be currents"),
        "gravity": ("current_as_torque" in commands.first.lower(), "assumed to be torques without gravity"),
        "reference": (commands.reference, "references, not measurements"),
    }
    return kind, {key: f"{these} {assumed}" for key, (is_open, assumed) in points.items() if is_open}


def _reach(log: LogContents, columns: Mapping[str, str]) -> float:
    return max(float(np.nanmax(np.abs(log.values[column]), initial=0.0)) for column in columns.values())


def _unused(
    log: LogContents, command_log: LogContents, signals: Signals, labels: Mapping[str, str], used: set[str]
) -> Unused:
    columns = [name for name in log.table.columns if name not in log.time]
    torques, still = dict[str, str](), list[str]()
    if not signals.sensors(SENSOR) and signals.kind == "current":
        torques, still = _sensors(command_log, "torque", labels)
    if torques and (group := command_log.group("torque")):
        used = used | set(group.columns.values())
    side: dict[str, Any] = {}
    for signal in SIDE_SIGNALS:
        supplied = signal.key.startswith("supply")
        names = [name for name in columns if has_word(name, signal.words) and has_word(name, SUPPLY) == supplied]
        if len(names) == len(signals.position):
            side[signal.key] = dict(zip(signals.position, names, strict=True))
        elif len(names) == 1:  # more are ambiguous
            side[signal.key] = names[0]
    chosen = (*signals.position.values(), *signals.command.values())
    command_kind = next((group.kind for group in command_log.groups if chosen[-1] in group.columns.values()), None)
    logs = [command_log] if log.table.path == command_log.table.path else [log, command_log]
    known = (*labels, *labels.values())
    moving = [name for one in logs for name in one.moving_beside(chosen, known, command_kind)]
    groups = {group.listed: group for group in (*log.groups, *command_log.groups)}
    others = {name: group for name, group in groups.items() if group.kind not in ("other", "sensor")}
    computed = _computed(command_log, signals.command, torques)
    pose = tuple(name for name in columns if name not in used and has_word(name, POSE))
    rest = tuple(name for name, group in others.items() if not set(group.columns.values()) <= used)
    return Unused(side, torques, computed, pose, tuple(still), (*moving, *log.elsewhere), rest)


def _sensors(log: LogContents, kind: str, labels: Mapping[str, str]) -> tuple[dict[str, str], list[str]]:
    """Select the measured torques of a kind by joint, and list torques that never change."""
    group = log.group(kind)
    if group is None or group.reference:
        return {}, []
    names = renamed_labels(group, list(labels.values()))[0].columns
    columns = {joint: names[label] for joint, label in labels.items() if label in names}
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


def _units(log: LogContents, key: str, columns: Mapping[str, str]) -> dict[str, Any]:
    """Return what to write under ``key`` of the units: the units in the log, other than SI, one or by joint."""
    written = {joint: unit for joint, column in columns.items() if (unit := log.units.get(column)) and unit not in SI}
    units = set(written.values())
    if not units:
        return {}
    return {key: units.pop() if len(units) == 1 and len(written) == len(columns) else written}


def _position_unit(
    log: LogContents, positions: Group, columns: Mapping[str, str], robot: Robot | None
) -> tuple[str | None, str]:
    """Determine the unit of the positions by names, velocities and range, None for rad and m as usual; and why."""
    if positions.unit in ("deg", "rad", "mm", "m"):
        return positions.unit, "unit in the columns' names"
    reaches = {joint: _reach(log, {joint: column}) for joint, column in columns.items()}
    reach, joint = max((reach, joint) for joint, reach in reaches.items())
    kinds = {robot.joint(name).kind for name in columns} if robot else {"revolute"}
    ratio, fastest = log.slope(positions) if kinds == {"revolute"} else (None, 0.0)
    for unit, per_velocity in (("deg", 180 / np.pi), ("rad", np.pi / 180)):
        if ratio is not None and abs(ratio / per_velocity - 1) < ALIKE:
            return unit, f"their derivative is {ratio:.4g} times the velocities"
    if not reach > TURNS or len(kinds) > 1:
        return None, f"positions reach {reach:.4g}"
    far = f"joint '{joint}' reaches {reach:.4g}"
    if kinds != {"revolute"}:
        return "mm", f"{far}, too far for SI units"
    # Where deg are taken for rad, joints with limits are far outside.
    beyond = robot is not None and any(reaches[name] > 2 * _range(robot, name, np.inf) for name in columns)
    if ratio is not None and abs(ratio - 1) < ALIKE and fastest < FASTEST and not beyond:
        return "rad", f"{far}, but the velocities are the derivative and reach only {fastest:.4g}"
    if reach > MOST_DEGREES and not beyond:
        return "rad", f"{far}, too far even for deg"
    if robot is not None and all(reaches[name] <= _range(robot, name, 2 * np.pi) for name in columns):
        coupled = {name for tie in robot.couplings for name in tie.terms}
        if coupled.issuperset(name for name in columns if reaches[name] > TURNS):
            return "rad", f"{far}, as motors before their gears do"
    return "deg", f"{far}, too far for SI units"


def _range(robot: Robot, name: str, free: float) -> float:
    """Return how far a joint turns by its limits, or by those of joints coupled to it; ``free`` where one has none."""
    ties = [tie for tie in robot.couplings if name in tie.terms and robot.joint(name).limits.position is None]
    terms = Coupling.solved(ties[0].terms, name, 0.0).ratios if ties else ((name, 1.0),)
    return sum(abs(ratio) * max(map(abs, robot.joint(other).limits.position or (free,))) for other, ratio in terms)
