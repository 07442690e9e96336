"""Drafting of an experiment file from logs: its text, notes on its guesses, and what the user states."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isclose, isfinite, nan
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal
from zlib import crc32

from gtau.documents.files import folder_of, write_atomically
from gtau.documents.markup import yaml_text
from gtau.errors import GtauError, printable
from gtau.findings import Finding, Grade, counted
from gtau.model.home import load_robot
from gtau.robots.robot import Robot
from gtau.signals.channel import SENSOR, SIDE_SIGNALS
from gtau.signals.reading.column_names import parse_column_name
from gtau.signals.reading.columns import PRESETS, Signals
from gtau.signals.reading.discovery import FLOATING, QUESTIONS, Draft, Reasons, Unused, discover
from gtau.signals.reading.experiment import Recording
from gtau.signals.reading.formats import listed
from gtau.signals.reading.formats.rosbag import robot_description
from gtau.signals.reading.logs import find_columns, is_rosbag
from gtau.signals.reading.statements import masses_in_name

DRAFT, ASSUMED_UNIT = "draft", "assumed unit"  # the kinds of what a draft assumes, shown as the former
SEAL = "# as drafted: "  # a checksum of all above follows
URDF = "robot.urdf"  # beside the experiment file, where a bag holds it


@dataclass(frozen=True)
class Stated:
    """What a user states of logs.

    Payloads (``masses``, kg, 0 for none) are by path, name or stem of a log; a ``preset`` gives the kind of commands
    and whether torques include gravity; ``columns`` are patterns by kind (``{"position": "enc_J*"}``), ``xacro`` the
    arguments of a robot's xacro file.
    """

    masses: Mapping[str, float] = field(default_factory=dict)
    kind: Literal["current", "torque"] | None = None
    preset: str | None = None
    columns: Mapping[str, str] | None = None
    xacro: Mapping[str, str] | None = None


def draft_logs(logs: Sequence[Path], robot: str | None = None, base: Any = None, stated: Stated = Stated()) -> Draft:
    """Draft an experiment from logs recorded with the same layout, see :func:`gtau.signals.reading.discovery.discover`.

    ``robot`` is a name of the catalog or the path of a file; if left out, the description that the first bag holds.
    """
    if len(set(logs)) < len(logs):
        twice = next(log for log in logs if list(logs).count(log) > 1)
        raise GtauError(f"the log '{twice}' is given twice; give every log once.")
    urdf = robot_description(logs[0]) if robot is None and is_rosbag(logs[0]) else None
    known = None if robot is None and urdf is None else _robot(logs[0], robot, urdf, base, stated.xacro)
    if known is not None and known.floating:
        raise GtauError(
            f"robot '{known.name}': its base '{known.floating}' floats, and an experiment file with a base that "
            f"floats is not drafted; start from {FLOATING}."
        )
    draft = replace(discover(logs, known, URDF if urdf is not None else robot, base, stated.columns), urdf=urdf)
    draft = replace(draft, robot={**draft.robot, "xacro": dict(stated.xacro)}) if stated.xacro else draft
    draft = draft if stated.preset is None else with_preset(draft, stated.preset)
    draft = draft if stated.kind is None else with_kind(draft, stated.kind)
    return with_masses(draft, _by_log(draft, stated.masses))


def draft_as(recording: Recording, logs: Sequence[Path], robot: str | None, masses: Mapping[str, float]) -> Draft:
    """Draft an experiment from logs of a known recorder."""
    runs, named = tuple((log,) for log in logs), {} if robot is None else {"file": robot}
    units = recording.units.model_dump(mode="json", exclude_defaults=True)
    payloads = {log: read for log in logs if (read := masses_in_name(log.name))}
    draft = Draft(runs, recording.signals, units, named, payloads, Reasons(*["as in the logs of the model"] * 3))
    return with_masses(draft, _by_log(draft, masses))


def with_kind(draft: Draft, kind: Literal["current", "torque"]) -> Draft:
    """Return the draft with commands of known kind."""
    old = draft.signals.kind
    units = {key: unit for key, unit in draft.units.items() if key != old or key == kind}
    signals = draft.signals.model_copy(update={old: None} | {kind: draft.signals.command})
    return replace(_settled(draft, "kind", "motor"), signals=signals, units=units)


def _settled(draft: Draft, *keys: str) -> Draft:
    return replace(draft, open={key: assumed for key, assumed in draft.open.items() if key not in keys})


def with_sensors(draft: Draft) -> Draft:
    """Return the draft with logged torques beside currents as sensor torques where no payload gives a scale."""
    torques = draft.unused.torques
    if not torques or draft.payloads or draft.unused.computed:
        return draft
    assumed = f"{listed(torques.values())} are assumed to be torque sensors behind the gears, which set the scale"
    points = {**draft.open} | {"sensors": assumed}
    signals = draft.signals.model_copy(update={"joint_torque": torques})
    open_ = {key: points[key] for key in QUESTIONS if key in points and key != "torques"}
    return replace(draft, signals=signals, unused=replace(draft.unused, torques={}), open=open_)


def with_preset(draft: Draft, name: str) -> Draft:
    """Return the draft with command kind and gravity of a preset; raises GtauError if its columns are missing."""
    if name not in PRESETS:
        raise GtauError(f"there is no preset '{name}'; choose from {', '.join(PRESETS)}.")
    preset = PRESETS[name]
    kind: Literal["current", "torque"] = "current" if "current" in preset else "torque"
    for k, (joint, column) in enumerate(draft.signals.command.items()):
        if column != preset[kind].format(k=k, n=k + 1, joint=joint):
            raise GtauError(
                f"the logs have no columns of the preset '{name}', as '{column}' is not '{preset[kind]}'; leave "
                "out --preset, and state in the draft whether these are currents or torques."
            )
    robot = {key: entry for key, entry in draft.robot.items() if key != "gravity"} | preset.get("robot", {})
    return replace(_settled(with_kind(draft, kind), "gravity"), robot=robot)


def with_masses(draft: Draft, masses: Mapping[Path, float]) -> Draft:
    """Return the draft with payloads, kg, of logs where they are known, 0 for none."""
    payloads = {**draft.payloads, **{log: (mass,) for log, mass in masses.items()}}
    payloads = {log: readings for log, readings in payloads.items() if readings[0] > 0}
    stated = draft.stated.union(masses)
    settled = ["masses"] * all(len(readings) == 1 for readings in payloads.values())
    settled += ["mass"] * stated.issuperset(payloads)
    return replace(_settled(draft, *settled), payloads=payloads, stated=stated)


def to_weigh(draft: Draft) -> Draft:
    """Return the draft with an unknown payload, of mass NaN, for every log without a mass by option."""
    unknown = (run[0] for run in draft.logs if run[0] not in draft.stated)
    return replace(draft, payloads={**draft.payloads, **dict.fromkeys(unknown, (nan,))})


def drafted_name(mass: float) -> str:
    """Return the name that a draft gives to a payload, kg."""
    return f"load_{1000 * mass:.0f}g"


def alternatives(masses: Sequence[float]) -> str:
    """Write alternative masses, kg."""
    return " or ".join(f"{mass:g}" for mass in masses)


def write_skeleton(logs: Sequence[Path], robot: str | None, masses: Mapping[str, float], file: Path) -> None:
    """Write an experiment file for logs whose columns are not recognised, with all but the names of these."""
    blank = dict.fromkeys(("JOINT",) if robot is None else load_robot(robot).motors, "COLUMN")
    names = [name for name in find_columns(logs[0]).columns if name]
    time = next((name for name in names if parse_column_name(name).kind == "time"), "COLUMN")
    recording = Recording(signals=Signals.model_construct(time=time, position=blank, current=blank))
    draft = draft_as(recording, logs, robot, masses)
    reasons = Reasons("or {rate: HZ}", "write the columns in place of COLUMN", "assumed")
    open_ = dict.fromkeys([*["robot"] * (robot is None), "joints", "kind"], "")
    unused = Unused(others=tuple(name for name in names if name != time))
    write_draft(replace(draft, reasons=reasons, open=open_, unused=unused), file)


def write_draft(draft: Draft, file: Path) -> None:
    """Write the experiment file of a draft, and the robot file from a bag, replacing unedited drafts alone."""
    folder = folder_of(file.parent)
    texts = {} if draft.urdf is None else {folder / URDF: draft.urdf}
    texts[file] = _sealed(draft_text(draft, folder))
    written = file.read_text(encoding="utf-8", errors="replace") if file.is_file() else ""
    edited = SEAL not in written or written != _sealed(written.rpartition(SEAL)[0])
    for path, text in texts.items():
        if edited and path.exists() and path.read_bytes() != text.encode():
            raise GtauError(
                f"{path} exists already and is not an unedited gtau draft; use it (gtau identify {file}), give another "
                "folder (--out), or remove it."
            )
    for path, text in texts.items():
        write_atomically(path, text)


def _sealed(text: str) -> str:
    return f"{text}{SEAL}{crc32(text.encode()):08x}\n"


def _robot(log: Path, robot: str | None, urdf: str | None, base: Any, xacro: Mapping[str, str] | None = None) -> Robot:
    with TemporaryDirectory(prefix="gtau-") as folder:
        source = robot or str(Path(folder) / URDF)
        if urdf is not None:
            Path(source).write_text(urdf)
        try:
            return load_robot(source, base=base, xacro=xacro)
        except GtauError as error:
            if urdf is None:
                raise
            where = str(error).replace(source, f"/robot_description in {log}").rstrip(".")
            raise GtauError(f"{where}; correct it, or give the robot (--robot ROBOT).") from None


def _by_log(draft: Draft, masses: Mapping[str, float]) -> dict[Path, float]:
    by_log = {}
    for name, mass in masses.items():
        path = Path(name)
        logs = [run[0] for run in draft.logs if any(path in (log, Path(log.name), Path(log.stem)) for log in run)]
        logs = logs or [run[0] for run in draft.logs if path.resolve() in [log.resolve() for log in run]]
        if len(logs) != 1:
            count = "more than one" if logs else "no"
            names = ", ".join(run[0].name for run in draft.logs)
            raise GtauError(f"'{name}' names {count} log of a payload; the logs are {names}.")
        if not 0 <= mass < float("inf"):
            raise GtauError(f"the payload of '{name}' is {mass:g} kg; write its mass in kg, 0 for none.")
        by_log[logs[0]] = mass
    return by_log


CHECK = "CHECK: "
WIDTH = 90  # characters of columns on one line


def draft_text(draft: Draft, folder: Path) -> str:
    """Write the experiment file of a draft for ``folder``, each finding with its reason, guesses marked ``CHECK``."""
    doubt = _question(draft, "robot", "unmatched") or "the other joints are held at home" * ("joints" in draft.robot)
    file = draft.robot.get("file", "NAME-OR-FILE")
    if "file" in draft.robot and draft.urdf is None and Path(file).exists():
        file = _relative(Path(file), folder)
    robot = {**draft.robot, "file": file} if "file" in draft.robot and len(draft.robot) > 1 else file
    lines = [
        f"# Drafted by gtau from {counted(len(draft.logs), 'log')}. Edit the lines marked CHECK, then run gtau check.",
        "",
        _line(f"robot: {_flow(robot)}", doubt),
        "",
        "signals:",
        *_signals(draft),
        *_unused(draft),
        "",
        *_units(draft),
        "",
        "runs:",
    ]
    for run in draft.logs:
        paths = [_relative(path, folder) for path in run]
        log = _flow(paths[0] if len(paths) == 1 else paths)
        for episode in find_columns(run[0]).episodes or (None,):
            numbered = [] if episode is None else [f"    episode: {episode}"]
            lines += [f"  - log: {log}", *numbered, *_payload(draft, run[0])]
    if draft.signals.kind == "current" and not draft.payloads and not draft.signals.sensors(SENSOR):
        lines += [
            "# Drive gains need the mass (kg) of the payload of at least one run, and a run with a different payload "
            "or none:",
            "#   payload: {name: steel, mass: 1.2, mass_std: 0.001}",
        ]
    return "\n".join(map(printable, lines)) + "\n"  # a name with a line break begins no line


def _payload(draft: Draft, log: Path) -> list[str]:
    if log not in draft.payloads:
        return []
    mass, *more = draft.payloads[log]
    entry: dict[str, Any] = {"name": draft.names.get(drafted_name(mass), drafted_name(mass)), "mass": mass}
    doubt = f"{CHECK}kg, from the name {log.name}"
    if more:
        entry = {"name": "load", "mass": alternatives(draft.payloads[log])}
        doubt = f"{CHECK}write one of them, kg; without a payload remove this line"
    elif not isfinite(mass):
        entry, doubt = {"name": log.stem}, "to be weighed"
    return [_line(f"    payload: {_flow(entry)}", "" if log in draft.stated else doubt)]


def _signals(draft: Draft) -> Iterator[str]:
    signals, why = draft.signals, draft.reasons
    doubtful = not {"clock", "received", "velocities"}.isdisjoint(draft.open)
    time = signals.model_dump(mode="json")["time"]
    written = _flow(time) if signals.rate is None else f"{{rate: {signals.rate:g}}}"
    yield _line(f"  time: {written}", _question(draft, "rate") or CHECK * doubtful + why.time)
    yield from _by_joint("position", signals.position, CHECK * ("joints" in draft.open) + why.position)
    yield from _by_joint(signals.kind, signals.command, _question(draft, "kind", "motor", "reference", "gravity"))
    if sensors := signals.sensors(SENSOR):
        doubt = _question(draft, "sensors") or "torque sensors behind the gears (by name)"
        yield from _by_joint("joint_torque", sensors, doubt)
    shown = {"time", "position", signals.kind, "joint_torque", "preset"}
    for key, value in signals.model_dump(mode="json", exclude_defaults=True, exclude=shown).items():
        yield f"  {key}: {_flow(value)}"


def _unused(draft: Draft) -> Iterator[str]:
    unused, velocity = draft.unused, draft.reasons.velocity
    for signal in SIDE_SIGNALS:
        if columns := unused.side.get(signal.key):
            yield f"  # {signal.key}: {_flow(columns)}  # {signal.effect}: remove the first '#'"
    if unused.pose:
        yield f"  # A pose tests the robot's geometry; if {listed(unused.pose)} hold one, describe it under 'pose:'."
    if unused.torques:
        yield f"  # {CHECK}{listed(unused.torques.values())}: {QUESTIONS['torques']}."
        yield from (f"  #{line[1:]}" for line in _by_joint("joint_torque", unused.torques, ""))
    if unused.others:
        yield f"  # Not used: columns {'; '.join(unused.others)}."
    if unused.still:
        yield f"  # Not used, as they never change: columns {listed(unused.still)}."
    if velocity:
        yield f"  # {velocity[0].upper()}{velocity[1:]}."


def _question(draft: Draft, *keys: str) -> str:
    return next((CHECK + QUESTIONS[key] for key in keys if key in draft.open), "")


def guesses(draft: Draft, file: Path) -> tuple[Finding, ...]:
    """List the guesses of a draft, each with the entry to change in its ``file``."""
    signals, unused, moving = draft.signals, draft.unused, draft.robot.get("joints", ())
    opposite = "torque" if signals.kind == "current" else "current"
    advice = QUESTIONS | {"kind": f"if they are {opposite}s, state --kind {opposite}"}
    notes = []
    if columns := ", ".join(unused.moving):
        held = f"the log has {', '.join(moving)}, and other joints are held at home, but " * bool(moving)
        text = f"{held}columns {columns} move, too, and are not used, as no joint with a motor has their names"
        notes.append((text, "if they are of a joint, write them at its name in that file"))
    notes += [(assumed, advice[key]) for key, assumed in draft.open.items() if assumed]
    named = [run[0] for run in draft.logs if run[0] not in draft.stated]
    state = "correct this by --payload LOG=KG (0 for none)"
    if loads := [f"{log.name} {mass:g} kg" for log in named if isfinite(mass := draft.payloads.get(log, (nan,))[0])]:
        notes.append((f"payload masses come from the file names: {', '.join(loads)}", state))
    if empty := [log.name for log in named if log not in draft.payloads]:
        notes.append((f"no payload is assumed for {', '.join(empty)}, without a mass in the name", state))
    masses = {run[0]: draft.payloads.get(run[0], (0.0,))[0] for run in draft.logs}
    taken = {log: draft.names.get(drafted_name(mass)) for log, mass in masses.items()}
    if known := [f"{log.name} '{name}'" for log, name in taken.items() if name]:
        notes.append((f"payloads of the model are taken for those of the same mass: {', '.join(known)}", ""))
    read = {log: masses_in_name(log.name) for log in draft.stated}  # names round by up to 5 %
    other = [log for log in read if read[log] and not any(isclose(masses[log], x, rel_tol=0.05) for x in read[log])]
    if off := [f"{log.name} {masses[log]:g} kg, not {alternatives(read[log])}" for log in other]:
        notes.append((f"payload masses are taken as stated, against the file names: {', '.join(off)}", ""))
    for log, *_ in draft.logs:
        if episodes := find_columns(log).episodes:
            text = f"each of the {len(episodes)} episodes in {log.name} is a run"
            notes.append((text, "remove unwanted episodes from 'runs', where each may have a 'payload' of its own"))
    if draft.urdf is not None:
        notes.append(("the robot comes from /robot_description of the bag", "for a different robot give --robot"))
    if moving and not unused.moving:
        notes.append((f"joints missing from the log are held at home; {', '.join(moving)} move", ""))
    if unused.still:
        notes.append((f"columns that never change are no torque sensors: {listed(unused.still)}", ""))
    if (time := signals.time_columns[:1]) and time[0].endswith("/header/stamp"):
        notes.append((f"time is {time[0]}, measurement stamps, not receipt stamps", ""))
    made = (
        Finding(DRAFT, text=text, advice=advice, grade=Grade.INFORMATION, source=str(file)) for text, advice in notes
    )
    unit = draft.open.get("unit")
    return tuple(replace(note, kind=ASSUMED_UNIT, shown_as=DRAFT) if note.text == unit else note for note in made)


def _units(draft: Draft) -> Iterator[str]:
    reason = draft.reasons.unit
    if not draft.units:
        yield f"# SI units ({reason}). For others, for example: units: {{position: deg, current: mA}}"
        return
    yield "units:"
    for key, unit in draft.units.items():
        comment = CHECK * ("unit" in draft.open) + reason if key == "position" else ""
        yield _line(f"  {key}: {_flow(unit)}", _question(draft, "counts") or comment)


def _line(text: str, comment: str) -> str:
    return f"{text}  # {comment}" if comment else text


def _by_joint(key: str, columns: Mapping[str, str], comment: str) -> list[str]:
    flow = _flow(columns)
    if len(flow) < WIDTH:
        return [_line(f"  {key}: {flow}", comment)]
    return [_line(f"  {key}:", comment), *(f"    {_flow({joint: name})[1:-1]}" for joint, name in columns.items())]


def _flow(value: Any) -> str:
    plain = dict(value) if isinstance(value, Mapping) else value
    return yaml_text(plain, flow=True, width=float("inf")).removesuffix("...\n").strip()


def _relative(path: Path, folder: Path) -> str:
    return Path(os.path.relpath(path, folder)).as_posix()
