"""Runs: checked signals of a log, in SI units on a uniform grid, and the spectra of their second differences."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from gtau.documents.validation import FUNCTION, name_problem, read_group, takes
from gtau.errors import GtauError, spelled
from gtau.findings import Finding
from gtau.robots.placement import WrenchFrame
from gtau.robots.robot import base_rows
from gtau.signals.channel import BASE, SENSOR, SIDE_SIGNALS, Channel, SideValues, channels_of
from gtau.signals.reading.columns import Signals
from gtau.signals.reading.formats.columnar import as_log
from gtau.signals.reading.logs import read_logs, read_side_signals
from gtau.signals.reading.samples import WHOLE, Part
from gtau.signals.reading.statements import CHOSEN, Payload, PreparationSettings, as_payload
from gtau.signals.reading.units import Units
from gtau.signals.repair.checks import check, parts_between_gaps
from gtau.signals.repair.commands import motor_currents
from gtau.signals.storage import block, blocks, store

if TYPE_CHECKING:
    import polars as pl


@dataclass(frozen=True)
class Log:
    """Origin of a run: files, one or two, and their columns and units; none where it was built of arrays or a table.

    ``whole_share`` is the share of whole numbers among the joints' commands before they were resampled (None: they were
    not), ``window`` (s) the length of a moving average that had smoothed the commands, and ``updates`` (Hz) the rate at
    which held signals change.
    """

    paths: tuple[Path, ...] = ()
    signals: Signals | None = None
    units: Units | None = None
    settings: PreparationSettings = CHOSEN
    notes: tuple[Finding, ...] = ()
    whole_share: float | None = None
    side: Mapping[str, SideValues] = field(default_factory=dict)
    window: float | None = None
    updates: float | None = None


@spelled(plot="gtau.plot(run)")
@dataclass(frozen=True, eq=False, init=False)
class Run:
    """Sampled positions and commands of the actuated joints, and torques of sensors on the link side of their gears.

    Attributes
    ----------
    name : str
        Name in messages and results.
    joints : tuple of str
        Names of the joints, in the order of the columns.
    time, position : ndarray
        (N,) in s, uniform, and (N, n) in rad or m.
    command : ndarray
        (N, c) Columns of the channels: the current references in A or, where ``kind`` says so, torques in N m (forces
        in N), 0 for the joints of a floating base, then torques of sensors, and then moments and forces of wrenches on
        bodies, six of each about the origin of its axes.
    kind : {"current", "torque"}
        Of the commands.
    payload : Payload, optional
        What the robot carried.
    valid : ndarray
        (N, c) False where the sample was interpolated or clipped; all are valid if left out.
    channels : tuple of Channel
        By default a channel for each joint, and for each of the torque ``sensors`` (names of joints).
    log : Log
        The origin; its fields, such as ``settings`` and ``notes``, and side signals by key, such as
        ``temperature``, may be given in its place.

    The arrays of a long log are memory-mapped from a file.
    """

    name: str
    joints: tuple[str, ...]
    time: np.ndarray = field(repr=False)
    position: np.ndarray = field(repr=False)
    command: np.ndarray = field(repr=False)
    kind: Literal["current", "torque"]
    payload: Payload | None
    valid: np.ndarray = field(repr=False)
    channels: tuple[Channel, ...] = field(repr=False)
    log: Log = field(repr=False)

    def __init__(
        self,
        name: str,
        joints: Sequence[str],
        time: np.ndarray,
        position: np.ndarray,
        command: np.ndarray,
        kind: Literal["current", "torque"] = "current",
        payload: Payload | None = None,
        valid: np.ndarray | None = None,
        channels: Sequence[Channel] = (),
        log: Log | None = None,
        sensors: Sequence[str] = (),
        **origin: Any,
    ) -> None:
        if problem := name_problem(name):
            raise GtauError(f"run: {problem}.")
        base = next((rows for joint in joints if set(rows := base_rows(joint)) <= set(joints)), ())
        log = log or Log()
        side = {signal.key: origin.pop(signal.key) for signal in SIDE_SIGNALS if signal.key in origin}
        known = {key: values for key, values in side.items() if values is not None}
        log = replace(log, **{"side": {**log.side, **known}, **origin})
        channels = tuple(channels or channels_of(joints, base, {SENSOR: sensors}))
        unit = "A" if kind == "current" else "N m"
        channels = tuple(replace(channel, unit=unit) if channel.name in joints else channel for channel in channels)
        if valid is None or not valid.size:
            valid = np.broadcast_to(True, (len(time), len(channels)))
        values = (name, tuple(joints), time, position, command, kind, payload, valid, channels, log)
        for attribute, value in zip(fields(self), values, strict=True):
            object.__setattr__(self, attribute.name, value)
        shape, measured = (len(time), len(joints)), (len(time), len(channels))
        if position.shape != shape or command.shape != measured or valid.shape != measured:
            groups = " and ".join(dict.fromkeys(f"the {channel.kind.group}" for channel in channels[len(joints) :]))
            also = f"; commands and valid {measured}, with {groups}" if groups else ""
            raise GtauError(
                f"run '{name}': positions {position.shape}, commands {command.shape} and valid "
                f"{valid.shape} must all have the shape {shape}, samples by joints{also}."
            )

    def __repr__(self) -> str:
        load = "" if self.payload is None else f", payload {self.payload.name!r}"
        return f"Run({self.name!r}, {len(self.time)} samples of joints {', '.join(self.joints)}, {self.kind}s{load})"

    @property
    def notes(self) -> tuple[Finding, ...]:
        """Notes on repairs of the log."""
        return self.log.notes

    @property
    def side(self) -> Mapping[str, SideValues]:
        """Side signals by key, as far as they were logged."""
        return self.log.side

    @property
    def base(self) -> tuple[str, ...]:
        """The six joints of a floating base, whose columns of ``command`` are 0; empty for a fixed one."""
        return tuple(channel.joint for channel in self.channels if channel.kind == BASE)

    @property
    def sensors(self) -> tuple[str, ...]:
        """The joints whose torque is measured on the link side, by a sensor of any kind."""
        return tuple(dict.fromkeys(channel.joint for channel in self.channels if channel.kind.link_side))

    @property
    def wrenches(self) -> tuple[WrenchFrame, ...]:
        """The frames of the measured wrenches, six channels each."""
        return tuple(channel.frame for channel in self.channels if channel.frame and channel.row % 6 == 0)

    @property
    def given(self) -> slice:
        """The columns of ``command`` that the model takes as given, the wrenches, after all others."""
        return slice(sum(channel.kind.modelled for channel in self.channels), len(self.channels))

    @property
    def rate(self) -> float:
        """Sampling rate, Hz."""
        return (len(self.time) - 1) / float(self.time[-1] - self.time[0])

    def to_frame(self) -> pl.DataFrame:
        """Return the run as a Polars table of ``t``, ``qJOINT`` and ``vJOINT`` (``tauJOINT`` for torques), SI units."""
        import polars as pl

        letter = "v" if self.kind == "current" else "tau"
        columns = {f"q{joint}": column for joint, column in zip(self.joints, self.position.T, strict=True)}
        commands = zip(self.joints, self.command.T, strict=False)  # sensors come after the joints
        columns |= {f"{letter}{joint}": column for joint, column in commands}
        return pl.DataFrame({"t": self.time, **columns})

    @property
    def updates(self) -> float:
        """Rate at which all signals change, Hz: lower than the sampling rate where they are held."""
        return min(self.log.updates or self.rate, self.rate)

    @cached_property
    def accelerations(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Frequencies (K,), Hz; power densities (K, n) of accelerations; gains (K,) of a double difference, 1/s2."""
        return second_differences(self.position, self.rate, self.updates)

    def ordered(self, joints: Sequence[str], link_side: bool = True) -> Run:
        """Return the run with its channels in the order of ``joints``, with or without those on the ``link_side``."""
        if set(self.joints) != set(joints) or len(self.joints) != len(joints):
            raise GtauError(
                f"run '{self.name}' has the joints {', '.join(self.joints)}, but the robot's actuated joints are "
                f"{', '.join(joints)}; give signals for exactly these."
            )
        place = [joints.index(joint) for joint in self.joints]
        rows = [place[channel.row] if channel.kind.modelled else channel.row for channel in self.channels]
        kinds = [channel.kind for channel in self.channels]
        kept = [k for k, kind in enumerate(kinds) if link_side or not kind.link_side]
        order = sorted(kept, key=lambda k: (not kinds[k].modelled, kinds[k].link_side, rows[k]))
        if order == list(range(len(kinds))):
            return self

        def columns(array: np.ndarray, chosen: Sequence[int]) -> np.ndarray:
            return store((part[:, chosen] for part in blocks(array)), (len(chosen),), array.dtype.type)

        position = columns(self.position, np.argsort(place).tolist())
        command, valid = (columns(array, order) for array in (self.command, self.valid))
        channels = tuple(replace(self.channels[k], row=rows[k]) for k in order)
        return replace(self, joints=tuple(joints), position=position, command=command, valid=valid, channels=channels)


@takes(progress=FUNCTION, part=("a gtau.Part", (Part,)))
def read_run(
    log: str | Path | Sequence[str | Path] | Any,
    signals: Signals | Mapping[str, Any],
    payload: Payload | Mapping[str, Any] | None = None,
    units: Units | Mapping[str, Any] | None = None,
    progress: Callable[[float], None] | None = None,
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
        Called with the fraction of the log read so far.
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

    Examples
    --------
    >>> position, current = {"left": "qleft", "right": "qright"}, {"left": "vleft", "right": "vright"}
    >>> gtau.read_run("empty_1.csv", {"time": "t", "position": position, "current": current}).rate
    250.0
    """
    payload = as_payload(payload)
    signals, units = read_group(Signals, "signals", signals), read_group(Units, "units", {} if units is None else units)
    settings = read_group(PreparationSettings, "settings", settings)
    paths = [log] if isinstance(log, (str, Path)) else log
    if not isinstance(paths, (list, tuple)) or not all(isinstance(path, (str, Path)) for path in paths):
        with as_log(log) as path:
            run = read_run(path, signals, payload, units, progress, settings, part)
        return replace(run, log=replace(run.log, paths=(), signals=None, units=None))
    logs, reported = [Path(path) for path in paths], progress or (lambda done: None)
    (run,) = read_parts(logs, signals, payload, units, reported, settings, part, cut=False)
    return run


def read_parts(
    paths: Sequence[Path],
    signals: Signals,
    payload: Payload | Mapping[str, Any] | None,
    units: Units,
    progress: Callable[[float], None],
    settings: PreparationSettings,
    part: Part,
    cut: bool = True,
) -> tuple[Run, ...]:
    """Read a log as :func:`read_run` does, but ``cut`` it into several runs at gaps that are too long to be bridged."""
    notes = list[Finding]()
    samples = read_logs(paths, signals, units, notes, part, progress)
    channels = tuple(replace(channel, delay=settings.delay) for channel in samples.channels)
    samples = replace(samples, channels=channels)
    side, runs = read_side_signals(paths[0], signals, units, notes, part), list[Run]()
    stem, load = paths[0].name if paths[0].is_dir() else paths[0].stem, as_payload(payload)
    for piece in parts_between_gaps(samples, notes, settings.clock) if cut else [samples]:
        driven, beside, unsure = motor_currents(piece, side, signals, notes)
        checked, valid, whole_share, window, updates = check(driven, notes, settings.clock)
        if unsure.any():
            small = [np.interp(checked.time, piece.time, column) > 0 for column in unsure.T.astype(float)]
            valid = valid & ~np.column_stack(small)
        arrays = checked.time, checked.position, checked.command
        log = Log(tuple(paths), signals, units, settings, tuple(notes), whole_share, beside, window, updates)
        runs.append(Run(stem + checked.part.label, signals.joints, *arrays, signals.kind, load, valid, channels, log))
        notes = []
    return tuple(runs)


SEGMENT = 1 << 17  # maximum samples per periodogram: periodograms of a longer log are averaged
SEGMENTS = 16  # of a long log, spread over it
ENDS = 0.05  # of the samples, at either side, that a window fades in and out
TOP = 0.45  # of the rate at which signals change: highest frequency evaluated


def second_differences(values: np.ndarray, rate: float, updates: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute the spectra of the second derivatives of ``values`` (N, n), by differences.

    Returns frequencies (K,) up to ``TOP`` of the rate of ``updates`` (Hz), power densities (K, n), and the gains (K,)
    of a double difference.
    """
    count = len(values) - 2
    segments, length = min(-(-count // SEGMENT), SEGMENTS), min(count, SEGMENT)
    # the window keeps a log that begins or ends in motion from looking like a jump
    window = taper(length)[:, None]
    power = np.zeros((length // 2 + 1, values.shape[1]))
    for start in np.linspace(0, count - length, segments).astype(int):
        part = block(values, start, start + length + 2)
        power += np.abs(np.fft.rfft((part[2:] - 2 * part[1:-1] + part[:-2]) * (rate**2 * window), axis=0)) ** 2
    frequency = np.fft.rfftfreq(length, 1 / rate)
    used = slice(1, int(np.searchsorted(frequency, TOP * updates, side="right")))
    gain = (2 * rate * np.sin(np.pi * frequency[used] / rate)) ** 2
    return frequency[used], power[used] * (2 / (segments * rate * (window**2).sum())), gain


def taper(length: int) -> np.ndarray:
    """Compute the weights (length,) of a window with cosine ends (Tukey's)."""
    samples = np.arange(length)
    share = np.minimum(samples, samples[::-1]) / (ENDS * max(length - 1, 1))
    return 0.5 - 0.5 * np.cos(np.pi * np.minimum(share, 1.0))
