"""Runs: checked signals of a log, in SI units on a uniform grid."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from gtau.documents.validation import FUNCTION, name_problem, read_group, takes
from gtau.errors import GtauError
from gtau.findings import Finding
from gtau.robots.floating import WrenchFrame
from gtau.robots.robot import base_rows
from gtau.signals.channel import Channel, channels_of
from gtau.signals.reading.columns import EXACT, Calibration, Signals
from gtau.signals.reading.log_file import as_log
from gtau.signals.reading.log_set import find_logs
from gtau.signals.reading.samples import WHOLE, Part
from gtau.signals.reading.side_signals import Temperature, read_temperature
from gtau.signals.reading.statements import CHOSEN, Payload, PreparationSettings, as_payload
from gtau.signals.reading.units import Units
from gtau.signals.repair.checks import check
from gtau.signals.storage import block, spans, store


@dataclass(frozen=True)
class Log:
    """Origin of a run: the files, one or two, the columns and their units."""

    paths: tuple[Path, ...]
    signals: Signals
    units: Units


@dataclass(frozen=True, eq=False)
class Run:
    """Sampled positions and commands of the actuated joints, and torques of sensors behind their gears.

    ``time`` (N,) in s, uniform; ``position`` (N, n) in rad or m; ``command`` (N, c), the current references in A or,
    where ``kind`` says so, torques in N m (forces in N), 0 for the joints of a floating base, then those of the torque
    ``sensors`` (names of joints), and then moments and forces of the ``wrenches`` on bodies, six of each about the
    origin of its axes; ``channels`` list them. Where ``valid``
    (N, c) is false the sample was interpolated or clipped. ``notes`` report repairs, ``settings`` are those of
    the preparation made by hand, ``whole`` is the share of whole numbers among the joints' commands before they were
    resampled (None: they were not), ``temperature`` is that of the joints, ``calibration`` the accuracy of sensors,
    ``log`` the origin.

    The arrays of a long log are memory-mapped from a file.
    """

    name: str
    joints: tuple[str, ...]
    time: np.ndarray = field(repr=False)
    position: np.ndarray = field(repr=False)
    command: np.ndarray = field(repr=False)
    kind: Literal["current", "torque"] = "current"
    payload: Payload | None = None
    notes: tuple[Finding, ...] = ()
    valid: np.ndarray = field(default_factory=lambda: np.ones((0, 0), dtype=bool), repr=False)
    settings: PreparationSettings = CHOSEN
    sensors: tuple[str, ...] = ()
    temperature: Temperature | None = None
    wrenches: tuple[WrenchFrame, ...] = ()
    calibration: Calibration = EXACT
    log: Log | None = field(default=None, repr=False)
    whole: float | None = field(default=None, repr=False)

    def __repr__(self) -> str:
        load = "" if self.payload is None else f", payload {self.payload.name!r}"
        return f"Run({self.name!r}, {len(self.time)} samples of joints {', '.join(self.joints)}, {self.kind}s{load})"

    def __post_init__(self) -> None:
        if problem := name_problem(self.name):
            raise GtauError(f"run: {problem}.")
        shape = (len(self.time), len(self.joints))
        measured = (len(self.time), len(self.channels))
        if self.valid.size == 0:
            object.__setattr__(self, "valid", np.broadcast_to(True, measured))
        if self.position.shape != shape or self.command.shape != measured or self.valid.shape != measured:
            more = " and ".join(dict.fromkeys(f"the {each.kind.group}" for each in self.channels[len(self.joints) :]))
            also = f"; commands and what is valid {measured}, with {more}" if more else ""
            raise GtauError(
                f"run '{self.name}': positions {self.position.shape}, commands {self.command.shape} and what is valid "
                f"{self.valid.shape} must all have the shape {shape}, samples by joints{also}."
            )

    @property
    def base(self) -> tuple[str, ...]:
        """The six joints of a floating base, whose columns of ``command`` are 0; empty for a fixed one."""
        return next((rows for joint in self.joints if set(rows := base_rows(joint)) <= set(self.joints)), ())

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The channels in the columns of ``command``."""
        return channels_of(self.joints, self.base, self.sensors, self.wrenches)

    @property
    def sensed(self) -> tuple[str, ...]:
        """The joints whose torque is measured behind their drives, by a sensor of any kind."""
        return tuple(dict.fromkeys(each.joint for each in self.channels if each.kind.behind_drive))

    @property
    def given(self) -> slice:
        """The columns of ``command`` that the model takes as given, those of the wrenches, after all others."""
        return slice(sum(each.kind.modelled for each in self.channels), len(self.channels))

    @property
    def rate(self) -> float:
        """Sampling rate, Hz."""
        return (len(self.time) - 1) / float(self.time[-1] - self.time[0])


@takes(progress=FUNCTION, part=("a gtau.Part", (Part,)))
def read_run(
    log: str | Path | Sequence[str | Path] | Any,
    signals: Signals | Mapping[str, Any],
    payload: Payload | Mapping[str, Any] | None = None,
    units: Units | Mapping[str, Any] | None = None,
    progress: Callable[[float], None] = lambda done: None,
    settings: PreparationSettings | Mapping[str, Any] = CHOSEN,
    part: Part = WHOLE,
) -> Run:
    """Read the log of one run.

    Parameters
    ----------
    log : path, two paths, or a table
        A log in any format of :mod:`gtau.signals.reading.formats`, or one with the positions (and the time) and one
        with the commands; or a Polars or pandas data frame, a mapping of columns, or an array (N, columns), whose
        columns are numbered from 1.
    signals, payload, units : mapping
        As under these keys of an experiment file; columns and joints may be written as integers.
    progress : callable, optional
        Called with the part of the log that has been read.
    settings : PreparationSettings or mapping
        Settings of the preparation made by hand.
    part : Part
        Part of the log to use.

    Returns
    -------
    Run
        Its ``notes`` report repairs. The joints are in the order of `signals`.

    Raises
    ------
    GtauError
        A file cannot be read, lacks a column, or fails the checks of :func:`gtau.signals.repair.checks.check`.
    """
    signals, units = read_group(Signals, "signals", signals), read_group(Units, "units", {} if units is None else units)
    settings = read_group(PreparationSettings, "settings", settings)
    if not (isinstance(log, (str, Path)) or (isinstance(log, (list, tuple)) and all(map(_is_path, log)))):
        with as_log(log) as path:
            return replace(read_run(path, signals, payload, units, progress, settings, part), log=None)
    paths = tuple([Path(log)] if isinstance(log, (str, Path)) else [Path(each) for each in log])
    logged = find_logs(paths, signals, units)
    uniform = check(logged.source, logged.blocks(part.rows, progress=progress), settings, part)
    return Run(
        name=(paths[0].name if paths[0].is_dir() else paths[0].stem) + part.label,
        joints=signals.joints,
        time=uniform.time,
        position=uniform.position,
        command=uniform.command,
        kind=signals.kind,
        payload=as_payload(payload),
        notes=(*logged.notes, *uniform.notes),
        valid=uniform.valid,
        settings=settings,
        sensors=signals.sensors,
        temperature=read_temperature(paths, signals, units, part),
        wrenches=tuple(each.frame for each in signals.all_wrenches),
        calibration=signals.calibration,
        log=Log(paths, signals, units),
        whole=uniform.whole,
    )


def _is_path(each: Any) -> bool:
    return isinstance(each, (str, Path))


def without_sensors(run: Run) -> Run:
    """Return the run without its torque sensors."""
    return _reordered(run, run.joints, ())


def arrange(run: Run, joints: Sequence[str]) -> Run:
    """Order a run's columns, and those of its torque sensors, as `joints`, a robot's actuated ones.

    Raises
    ------
    GtauError
        The run lacks one of them or has others.
    """
    if set(run.joints) != set(joints) or len(run.joints) != len(joints):
        raise GtauError(
            f"run '{run.name}' has the joints {', '.join(run.joints)}, but the robot's actuated joints are "
            f"{', '.join(joints)}; give signals for exactly these."
        )
    return _reordered(run, joints, [joint for joint in joints if joint in run.sensors])


def _reordered(run: Run, joints: Sequence[str], sensors: Sequence[str]) -> Run:
    """Keep the channels of ``joints`` and ``sensors``, in this order, before those that the model takes as given."""
    names, given = [each.name for each in run.channels], [not each.kind.modelled for each in run.channels]
    kept = [names.index(each.name) for each in channels_of(joints, (), sensors)]
    kept += np.flatnonzero(given).tolist()
    if kept == list(range(len(names))):
        return run
    return replace(
        run,
        joints=tuple(joints),
        sensors=tuple(sensors),
        position=_columns(run.position, kept[: len(joints)]),
        command=_columns(run.command, kept),
        valid=_columns(run.valid, kept),
    )


def _columns(array: np.ndarray, order: list[int]) -> np.ndarray:
    parts = (block(array, *span)[:, order] for span in spans(len(array)))
    return store(parts, array.shape[1:], array.dtype.type)
