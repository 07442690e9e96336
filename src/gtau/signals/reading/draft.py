"""A drafted experiment file, and the questions about it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gtau.errors import short
from gtau.signals.reading.columns import Signals

QUESTIONS = {
    "masses": "write the payload masses ('or' in the file) that file names give in several ways: they set the scale of "
    "all drive gains",
    "mass": "confirm the payload masses, read from the file names: they set the scale of all drive gains",
    "robot": "name the robot: a name of the catalog (gtau robot), or the path of its URDF, MJCF or robot file",
    "unmatched": "joints that the log lacks are held at home, but columns move that are not used; if they are of such "
    "a joint, write them at its name",
    "counts": "replace counts and unknown units by the size of one count (units: {current: 0.00269 A}); for shares add "
    "the rated values (units: {rated: {JOINT: 5.2}})",
    "joints": "confirm which columns belong to which joint",
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
    "torques": "remove the '#' of joint_torque if these come from sensors behind the gears, not from currents",
    "sensors": "if they are computed from currents or by the controller's model, state the mass of a payload instead "
    "(--payload LOG=KG)",
    "base": "if the base of the robot moved, write 'base: floating' and the columns of its motion "
    "(docs/lookup/experiment-file.md, 'A base that floats')",
    "wrenches": "if forces that act on the robot are logged, describe them under 'wrenches:', those on a floating "
    "base under 'base:' (docs/lookup/experiment-file.md, 'Wrenches on bodies')",
    "reference": "confirm that these are the references of the current loops, not the feed-forward of a model",
}
"""Questions about the open points of a draft, in the order in which they are asked."""


@dataclass(frozen=True)
class Unused:
    """Columns that a draft does not use, by what they may hold.

    ``side`` are side signals by key, a column or one for each joint; ``torques``, by joint, may be of sensors unless
    they are ``computed`` from the currents; ``still`` torques never change; ``moving`` are positions and commands of
    joints that the robot lacks; ``others`` might be meant in place of the columns that are used.
    """

    side: Mapping[str, str | Mapping[str, str]]
    torques: Mapping[str, str]
    computed: bool
    pose: tuple[str, ...]
    motion: tuple[str, ...]
    wrenches: tuple[str, ...]
    still: tuple[str, ...]
    moving: tuple[str, ...]
    others: tuple[str, ...]


@dataclass(frozen=True)
class Reasons:
    """Reasons for the choice of the time column, of the joints' columns and of the positions' unit."""

    time: str
    position: str
    unit: str
    velocity: str = ""


@dataclass(frozen=True)
class Draft:
    """Drafted experiment file.

    ``logs`` are one file or two of each run; ``units`` and ``robot`` are as under these keys of the file, but ``robot``
    has no ``file`` where it is unknown. ``payloads`` are masses (kg) by log: several where the name of the file has
    several readings, NaN where the payload is to be weighed; the logs ``stated`` have masses by option. ``open`` are
    the points to confirm, keys of ``QUESTIONS``, each with what is assumed. ``urdf`` is the robot's file from a bag.
    """

    logs: tuple[tuple[Path, ...], ...]
    signals: Signals
    units: Mapping[str, Any]
    robot: Mapping[str, Any]
    payloads: Mapping[Path, tuple[float, ...]]
    reasons: Reasons
    open: Mapping[str, str]
    unused: Unused
    stated: frozenset[Path] = frozenset()
    urdf: str | None = None


def listed(columns: Iterable[str]) -> str:
    """List some columns, the first eight of many."""
    columns = tuple(columns)
    return ", ".join(map(short, columns[:8])) + (", ..." if len(columns) > 8 else "")


def listed_units(units: Mapping[str, Any]) -> str:
    """List units, by joint where they differ."""
    by_joint = {
        key: unit if isinstance(unit, str) else ", ".join(f"{one} ({joint})" for joint, one in unit.items())
        for key, unit in units.items()
    }
    return ", ".join(f"{key} in {unit}" for key, unit in by_joint.items())
