"""Drafting of an experiment file from logs: shared by ``gtau init`` and ``gtau identify LOG...``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal
from zlib import crc32

from gtau.documents.files import folder_of, write_atomically
from gtau.errors import GtauError
from gtau.model.home import load_robot
from gtau.robots.robot import Robot
from gtau.signals.column_names import PRESETS
from gtau.signals.discovery import Draft, discover
from gtau.signals.draft_file import draft_text
from gtau.signals.formats.rosbag import robot_description
from gtau.signals.log_file import find_columns, is_rosbag

SEAL = "# as drafted: "  # a checksum of all above follows
URDF = "robot.urdf"  # beside the experiment file, where a bag holds it


def draft_logs(
    logs: Sequence[Path],
    robot: str | None = None,
    base: Any = None,
    masses: Mapping[str, float] | None = None,
    kind: Literal["current", "torque"] | None = None,
    preset: str | None = None,
) -> Draft:
    """Draft an experiment from logs recorded with the same layout.

    Parameters
    ----------
    logs : sequence of Path
        As for :func:`gtau.signals.discovery.discover`.
    robot : str, optional
        A name of the catalog or the path of a file; if left out, the description that the first bag holds.
    base : optional
        How the robot's base is placed.
    masses : mapping, optional
        Payloads, kg, by path, name or stem of a log; 0 for none.
    kind : {"current", "torque"}, optional
        Kind of the commands, where it is known.
    preset : str, optional
        A name of :data:`gtau.signals.column_names.PRESETS`, which gives the kind and whether torques include gravity.

    Raises
    ------
    GtauError
        A log or the robot cannot be read, a mass is of no log, or the logs do not have the columns of the preset.
    """
    if len(set(logs)) < len(logs):
        twice = next(log for log in logs if list(logs).count(log) > 1)
        raise GtauError(f"the log '{twice}' is given twice; give every log once.")
    urdf = robot_description(logs[0]) if robot is None and is_rosbag(logs[0]) else None
    known, moving = (None, ()) if robot is None and urdf is None else _robot(logs[0], robot, urdf, base)
    if known is not None and known.floating:
        raise GtauError(
            f"robot '{known.name}': its base '{known.floating}' floats, and an experiment file with a base that "
            "floats is not drafted; start from docs/lookup/experiment-file.md, 'A base that floats'."
        )
    found = discover(logs, known, URDF if urdf is not None else robot, base)
    found = replace(found, urdf=urdf, moving=moving)
    found = found if preset is None else with_preset(found, preset)
    found = found if kind is None else with_kind(found, kind)
    return with_masses(found, _of_logs(found, masses or {}))


def with_kind(draft: Draft, kind: Literal["current", "torque"]) -> Draft:
    """Return the draft with commands of known kind."""
    settled = {"kind", "motor"}
    units = {key: unit for key, unit in draft.units.items() if key in ("time", "position", kind)}
    return replace(draft, kind=kind, units=units, open=tuple(key for key in draft.open if key not in settled))


def with_sensors(draft: Draft) -> Draft:
    """Return the draft with logged torques beside currents as sensor torques where no payload gives a scale."""
    if not draft.torques or draft.masses or "torques" in draft.reasons:
        return draft
    open_ = tuple("sensors" if key == "torques" else key for key in draft.open)
    return replace(draft, sensors=draft.torques, torques={}, open=open_)


def with_preset(draft: Draft, name: str) -> Draft:
    """Return the draft with command kind and gravity of a preset; raises GtauError if its columns are missing."""
    if name not in PRESETS:
        raise GtauError(f"there is no preset '{name}'; choose from {', '.join(PRESETS)}.")
    preset = PRESETS[name]
    pattern = preset.current or preset.torque
    strange = [
        column
        for k, (joint, column) in enumerate(draft.command.items())
        if pattern is not None and column != pattern.format(k=k, n=k + 1, joint=joint)
    ]
    if strange:
        raise GtauError(
            f"the logs have no columns of the preset '{name}', as '{strange[0]}' is not '{pattern}'; leave out "
            "--preset, and state what the commands are (--kind current|torque)."
        )
    found = draft if pattern is None else with_kind(draft, "current" if preset.current else "torque")
    open_ = tuple(key for key in found.open if key != "gravity")
    return replace(found, gravity=preset.gravity, open=open_)


def with_masses(draft: Draft, masses: Mapping[Path, float]) -> Draft:
    """Return the draft with payloads, kg, of logs where they are known, 0 for none."""
    kept = {log: mass for log, mass in ({**draft.masses, **masses}).items() if mass > 0}
    stated = draft.stated.union(masses)
    settled = {"mass"} if set(kept) <= stated else set()
    open_ = tuple(key for key in draft.open if key not in settled)
    return replace(draft, masses=kept, stated=stated, open=open_)


def write_draft(draft: Draft, file: Path) -> list[Path]:
    """Write the experiment file of a draft, and the robot file from a bag, replacing those of earlier drafts.

    Raises
    ------
    GtauError
        Other files with these names exist, or an earlier draft has been edited.
    """
    folder = folder_of(file.parent)
    texts = {} if draft.urdf is None else {folder / URDF: draft.urdf}
    texts[file] = _sealed(draft_text(draft, folder))
    for path, text in texts.items():
        if path.exists() and path.read_bytes() != text.encode() and not _unedited(file):
            raise GtauError(
                f"{path} exists already and is no draft as gtau wrote it; use it (gtau identify {file}), give another "
                "folder (--out), or remove it."
            )
    for path, text in texts.items():
        write_atomically(path, text)
    return list(texts)


def _sealed(text: str) -> str:
    return f"{text}{SEAL}{crc32(text.encode()):08x}\n"


def _unedited(file: Path) -> bool:
    """Decide by its last line whether a file is an unedited draft."""
    text = file.read_text(encoding="utf-8", errors="replace") if file.is_file() else ""
    return SEAL in text and text == _sealed(text.rpartition(SEAL)[0])


def _robot(log: Path, robot: str | None, urdf: str | None, base: Any) -> tuple[Robot, tuple[str, ...]]:
    """Load the robot; list its logged joints where a log of joint states lacks some, such as fingers."""
    with TemporaryDirectory(prefix="gtau-") as folder:
        source = robot or str(Path(folder) / URDF)
        if urdf is not None:
            Path(source).write_text(urdf)
        try:
            known = load_robot(source, base=base)
            columns = find_columns(log).columns
            moving = tuple(
                joint for joint in known.actuated if any(each.endswith(f"/{joint}/position") for each in columns)
            )
            if not 0 < len(moving) < len(known.actuated):
                return known, ()
            return load_robot(source, base=base, joints=moving), moving
        except GtauError as error:
            if urdf is None:
                raise
            where = str(error).replace(source, f"/robot_description in {log}").rstrip(".")
            raise GtauError(f"{where}; correct it, or give the robot (--robot ROBOT).") from None


def _of_logs(draft: Draft, masses: Mapping[str, float]) -> dict[Path, float]:
    found = {}
    for name, mass in masses.items():
        logs = [run[0] for run in draft.logs if any(name in (str(log), log.name, log.stem) for log in run)]
        if len(logs) != 1:
            names = ", ".join(run[0].name for run in draft.logs)
            raise GtauError(
                f"'{name}' names {'no' if not logs else 'more than one'} log of a payload; the logs are {names}."
            )
        if not 0 <= mass < float("inf"):
            raise GtauError(f"the payload of '{name}' is {mass:g} kg; write its mass in kg, 0 for none.")
        found[logs[0]] = mass
    return found
