"""Text of a drafted experiment file, and notes on every guess in it."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gtau.documents.yaml_document import yaml_text
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.signals.discovery import Draft

CHECK = "CHECK: "
WIDTH = 90  # characters of columns on one line
UNSURE = {
    "robot": "name the robot: a name of the catalog (gtau robot), or the path of its URDF, MJCF or robot file",
    "joints": "confirm that the columns are in the order of the joints",
    "unit": "confirm the unit of the positions (units: {position: ...})",
    "rate": "write the sampling rate, which is not in the log (time: {rate: HZ})",
    "velocities": "confirm the sampling rate, found from the velocities (time: {rate: HZ})",
    "mass": "confirm the payload masses, read from the file names: they set the scale of all drive gains",
    "kind": "confirm whether these are currents or torques (key 'current:' or 'torque:')",
    "motor": "confirm that these are proportional to the currents; motor torques are 'motor_torque:', with a "
    "'gear_ratio:'",
    "clock": "confirm the time column, as other columns increase too",
    "gravity": "confirm that the controller compensates gravity in these torques, or remove 'gravity' of the robot",
    "received": "messages without measurement stamps get receipt stamps, with the jitter of the middleware",
    "torques": "remove the '#' of joint_torque if those are sensors behind the gears, not computed from currents",
    "sensors": "if they are computed from currents or by the controller's model, state the mass of a payload instead "
    "(--payload LOG=KG)",
    "base": "if the base of the robot moved, write 'base: floating' and the columns of its motion "
    "(docs/lookup/experiment-file.md, 'A base that floats')",
    "wrenches": "if forces that act on the robot are logged, describe them under 'wrenches:', those on a floating "
    "base under 'base:' (docs/lookup/experiment-file.md, 'Wrenches on bodies')",
    "reference": "confirm that these are the references of the current loops, not the feed-forward of a model",
}
"""Questions to the user, by the open points of the draft."""


def draft_text(draft: Draft, folder: Path) -> str:
    """Write the experiment file of a draft for ``folder``, each finding with its reason.

    Guesses are marked ``CHECK``.
    """
    why = draft.reasons
    lines = [
        f"# Drafted by gtau from {_count(len(draft.logs))}. Edit the lines marked CHECK, then run gtau check.",
        "",
        _line(f"robot: {_flow(_robot(draft, folder))}", _of(draft, "robot", "")),
        "",
        "signals:",
    ]
    if draft.time:
        time: Any = draft.time[0] if len(draft.time) == 1 else list(draft.time)
        if draft.command_time:
            other = draft.command_time[0] if len(draft.command_time) == 1 else list(draft.command_time)
            time = {"position": time, "command": other}
        doubtful = not {"clock", "received"}.isdisjoint(draft.open)
        lines.append(_line(f"  time: {_flow(time)}", CHECK * doubtful + why.get("time", "")))
    else:
        rate = 1000.0 if draft.rate is None else draft.rate
        found = CHECK * ("velocities" in draft.open) + why.get("time", "")
        lines.append(_line(f"  time: {{rate: {rate:g}}}", _of(draft, "rate", found)))
    matched = why.get("position", "")
    lines += _by_joint("position", draft.position, CHECK * ("joints" in draft.open) + matched)
    found = why.get("velocity", "")
    doubt = next((CHECK + UNSURE[key] for key in ("kind", "motor", "reference", "gravity") if key in draft.open), "")
    lines += _by_joint(draft.kind, draft.command, doubt)
    if draft.temperature is not None:
        lines.append(f"  # temperature: {_flow(draft.temperature)}  # friction may depend on it: remove the first '#'")
    if draft.pose:
        lines.append(
            f"  # A pose tests the robot's geometry; if {_first(draft.pose)} hold one, describe it under 'pose:'."
        )
    if draft.motion:
        lines += [
            f"  # {CHECK}{_first(draft.motion)} look like the motion of a base. If it moved, write",
            "  # 'robot: {file: ..., base: floating}' above and describe them under 'base:' here",
            "  # (docs/lookup/experiment-file.md, 'A base that floats').",
        ]
    if draft.wrenches:
        lines += [
            f"  # {CHECK}{_first(draft.wrenches)} look like forces and moments. Describe those that act",
            "  # on the robot from outside under 'wrenches:', on a base that floats as 'wrenches' of 'base:'",
            "  # (docs/lookup/experiment-file.md, 'Wrenches on bodies').",
        ]
    if draft.sensors:
        doubt = CHECK + UNSURE["sensors"] if "sensors" in draft.open else "torque sensors behind the gears (by name)"
        lines += _by_joint("joint_torque", draft.sensors, doubt)
    if draft.torques:
        lines.append(
            f"  # {CHECK}torques of sensors behind the gears, not computed from currents, fix the scale of the"
        )
        lines.append("  # gains; if these columns are such torques, remove the '#':")
        lines += [f"  #{line[1:]}" for line in _by_joint("joint_torque", draft.torques, "")]
    if draft.others:
        lines.append(f"  # Not used: columns {'; '.join(draft.others)}.")
    if found:
        lines.append(f"  # {found[0].upper()}{found[1:]}.")
    lines += ["", *_units(draft), "runs:"]
    for run in draft.logs:
        paths = [_relative(path, folder) for path in run]
        for episode in draft.episodes.get(run[0], (None,)):
            lines.append(f"  - log: {_flow(paths[0] if len(paths) == 1 else paths)}")
            lines += [] if episode is None else [f"    episode: {episode}"]
            if (mass := draft.masses.get(run[0])) is not None:
                payload = {"name": f"load_{1000 * mass:.0f}g", "mass": mass}
                doubt = "" if run[0] in draft.stated else f"{CHECK}kg, from the file name"
                lines.append(_line(f"    payload: {_flow(payload)}", doubt))
    if draft.kind == "current" and not draft.masses and not draft.sensors:
        lines += [
            "# Drive gains need the mass (kg) of the payload of at least one run, and a run with a different payload "
            "or none:",
            "#   payload: {name: steel, mass: 1.2, mass_std: 0.001}",
        ]
    return "\n".join(lines) + "\n"


def guesses(draft: Draft, file: Path) -> tuple[Finding, ...]:
    """List the guesses of a draft, each with the entry to change in its ``file``."""
    commands, columns = list(draft.command.values()), _pairs(draft.position)
    first = " ... ".join(dict.fromkeys((commands[0], commands[-1])))
    taken = {
        "joints": f"columns were assigned to the joints in order: {columns}",
        "unit": f"positions are assumed to be in {draft.units.get('position')}: {draft.reasons.get('unit')}",
        "velocities": f"the sampling rate is assumed to be {draft.rate or 0:g} Hz",
        "kind": f"{first} are assumed to be {draft.kind}s",
        "motor": f"{first} are assumed to be currents",
        "gravity": f"{first} are assumed to be torques without gravity",
        "clock": f"time is {' and '.join(draft.time)}, but other columns increase too",
        "received": f"time is {draft.reasons.get('received', '')}, the receipt stamps",
        "torques": f"{_first(tuple(draft.torques.values()))} are not used"
        + (f": they are {draft.reasons['torques']}" if "torques" in draft.reasons else ""),
        "sensors": f"{_first(tuple(draft.sensors.values()))} are assumed to be torque sensors behind the gears, which "
        f"set the scale",
        "base": f"{_first(draft.motion)} are not used: the base is assumed to be fixed",
        "wrenches": f"{_first(draft.wrenches)} are not used: no external contact is assumed",
        "reference": f"{first} are references, not measurements",
    }
    other = "torque" if draft.kind == "current" else "current"
    advice = UNSURE | {"kind": f"if they are {other}s, correct it by --kind {other}"}
    found = [(taken[key], advice[key]) for key in draft.open if key in taken]
    named = [run[0] for run in draft.logs if run[0] not in draft.stated]
    loads = [f"{path.name} {draft.masses[path]:g} kg" for path in named if path in draft.masses]
    if loads:
        found.append((f"payload masses come from the file names: {', '.join(loads)}", STATE))
    if empty := [path.name for path in named if path not in draft.masses]:
        found.append((f"no payload is assumed for {', '.join(empty)}, without a mass in the name", STATE))
    for log, episodes in draft.episodes.items():
        what = f"each of the {len(episodes)} episodes in {log.name} is a run"
        found.append((what, "remove unwanted episodes from 'runs'"))
    if draft.urdf is not None:
        found.append(("the robot comes from /robot_description of the bag", "for a different robot give --robot"))
    if draft.moving:
        found.append((f"joints missing from the log are held at home; {', '.join(draft.moving)} move", ""))
    if draft.time and draft.time[0].endswith("/header/stamp"):
        found.append((f"time is {draft.time[0]}, measurement stamps, not receipt stamps", ""))
    return tuple(Finding(F.DRAFT, values={"what": what, "action": action}, source=str(file)) for what, action in found)


STATE = "correct them by --payload LOG=KG (0 for none)"


def _pairs(columns: Mapping[str, str]) -> str:
    return ", ".join(f"{joint}: {column}" for joint, column in columns.items())


def _first(columns: Sequence[str]) -> str:
    return ", ".join(columns[:8]) + (", ..." if len(columns) > 8 else "")


def _robot(draft: Draft, folder: Path) -> Any:
    if draft.robot is None:
        return "NAME-OR-FILE"
    path = Path(draft.robot)
    file = _relative(path, folder) if draft.urdf is None and path.exists() else draft.robot
    more = {"base": draft.base} if draft.base is not None else {}
    if not draft.gravity:
        more["gravity"] = [0, 0, 0]
    if draft.moving:
        more["joints"] = list(draft.moving)
    return {"file": file} | more if more else file


def _units(draft: Draft) -> list[str]:
    if not draft.units:
        reason = draft.reasons.get("unit", "")
        return [f"# SI units ({reason}). For others, for example: units: {{position: deg, current: mA}}", ""]
    lines = ["units:"]
    for key, unit in draft.units.items():
        comment = draft.reasons.get("unit", "") if key == "position" else ""
        lines.append(_line(f"  {key}: {unit}", CHECK * (key == "position" and "unit" in draft.open) + comment))
    return [*lines, ""]


def _of(draft: Draft, key: str, otherwise: str) -> str:
    return CHECK + UNSURE[key] if key in draft.open else otherwise


def _line(text: str, comment: str) -> str:
    return f"{text}  # {comment}" if comment else text


def _by_joint(key: str, columns: Mapping[str, str], comment: str) -> list[str]:
    """Write columns in braces, or on lines of their own where that would be too long."""
    flow = _flow(columns)
    if len(flow) < WIDTH:
        return [_line(f"  {key}: {flow}", comment)]
    return [_line(f"  {key}:", comment), *(f"    {_flow({joint: name})[1:-1]}" for joint, name in columns.items())]


def _flow(value: Any) -> str:
    plain = dict(value) if isinstance(value, Mapping) else value
    return yaml_text(plain, flow=True, width=float("inf")).removesuffix("...\n").strip()


def _relative(path: Path, folder: Path) -> str:
    return Path(os.path.relpath(path, folder)).as_posix()


def _count(logs: int) -> str:
    return f"{logs} log{'s' * (logs != 1)}"
