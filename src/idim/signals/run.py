"""A run: what one log says, checked, in SI units and on a uniform grid."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from idim.errors import IdimError
from idim.signals.checks import Samples, check
from idim.signals.experiment import Payload, SampleRate, Signals, Units, as_payload, as_signals, as_units
from idim.signals.log_file import LogFile, read_log

SI = {"rad": 1.0, "deg": np.pi / 180, "m": 1.0, "mm": 1e-3, "A": 1.0, "mA": 1e-3, "N m": 1.0, "Nm": 1.0, "N": 1.0}
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


@dataclass(frozen=True, eq=False)
class Run:
    """Sampled positions and commands of the actuated joints.

    ``time`` (N,) in s, uniform; ``position`` (N, n) in rad or m; ``command`` (N, n), the current
    references in A or, where ``kind`` says so, torques in N m (forces in N). Where ``valid`` (N,) is
    false the sample was interpolated. ``notes`` say what was repaired.
    """

    name: str
    joints: tuple[str, ...]
    time: np.ndarray
    position: np.ndarray
    command: np.ndarray
    kind: Literal["current", "torque"] = "current"
    payload: Payload | None = None
    notes: tuple[str, ...] = ()
    valid: np.ndarray = field(default_factory=lambda: np.ones(0, dtype=bool))

    def __post_init__(self) -> None:
        shape = (len(self.time), len(self.joints))
        if self.valid.size == 0:
            object.__setattr__(self, "valid", np.ones(len(self.time), dtype=bool))
        if self.position.shape != shape or self.command.shape != shape or self.valid.shape != shape[:1]:
            raise IdimError(
                f"run '{self.name}': positions {self.position.shape} and commands {self.command.shape} must both "
                f"have the shape {shape}, samples by joints."
            )

    @property
    def rate(self) -> float:
        """Sampling rate, Hz."""
        return (len(self.time) - 1) / float(self.time[-1] - self.time[0])


def read_run(
    log: str | Path | Sequence[str | Path],
    signals: Signals | Mapping[str, Any],
    payload: Payload | Mapping[str, Any] | None = None,
    units: Units | Mapping[str, Any] | None = None,
) -> Run:
    """Read the log of one run.

    Parameters
    ----------
    log : path or two paths
        A CSV or Parquet file, or one with the positions (and the time) and one with the commands.
    signals, payload, units : mapping
        As under these keys of an experiment file.

    Returns
    -------
    Run
        Its ``notes`` say what was repaired. The joints stand in the order of `signals`.

    Raises
    ------
    IdimError
        A file cannot be read, lacks a column, or fails the checks of :func:`idim.signals.checks.check`.
    """
    signals, units = as_signals(signals), as_units(units)
    paths = [Path(log)] if isinstance(log, (str, Path)) else [Path(each) for each in log]
    if len(paths) not in (1, 2):
        raise IdimError(f"a run has {len(paths)} logs; give one, or two with the positions and the {signals.kind}s.")
    time_columns = () if isinstance(signals.time, SampleRate) else (signals.time,)
    position_columns, command_columns = (
        tuple(signals.position.values()),
        tuple(signals.command[j] for j in signals.joints),
    )
    columns = (*position_columns, *command_columns)
    if len(paths) == 1:
        both = set(position_columns) & set(command_columns)
        if both:
            raise IdimError(
                f"{paths[0]}: the column '{min(both)}' is given both as a position and as a {signals.kind}; "
                "correct one of the two."
            )
        logs = [read_log(paths[0], (*time_columns, *columns))] * 2
    else:
        logs = [read_log(paths[0], (*time_columns, *position_columns)), read_log(paths[1], command_columns)]
    position, command = (
        np.column_stack([each.columns[name] for name in names])
        for each, names in zip(logs, (position_columns, command_columns), strict=True)
    )
    if len(position) != len(command):
        raise IdimError(
            f"{paths[0]} has {len(position)} rows but {paths[1]} has {len(command)}; "
            "give two logs that were sampled together."
        )
    samples = Samples(
        source=" and ".join(str(path) for path in paths),
        joints=signals.joints,
        columns=(*columns, *(time_columns or ("time",))),
        texts=logs[0].texts | logs[1].texts,
        time=_time(logs[0], signals, units, len(position)),
        position=position * [SI[units.of_position(joint) or "rad"] for joint in signals.joints],
        command=command * SI[units.current or units.torque or "A"],
        rows=np.arange(len(position)),
        first_line=logs[0].first_line,
        line_word=logs[0].line_word,
    )
    uniform = check(samples)
    return Run(
        name=paths[0].stem,
        joints=signals.joints,
        time=uniform.time,
        position=uniform.position,
        command=uniform.command,
        kind=signals.kind,
        payload=as_payload(payload),
        notes=uniform.notes,
        valid=uniform.valid,
    )


def _time(log: LogFile, signals: Signals, units: Units, n: int) -> np.ndarray:
    if isinstance(signals.time, SampleRate):
        return np.arange(n) / signals.time.rate
    return log.columns[signals.time] * SECONDS[units.time or "s"]


def arrange(run: Run, joints: Sequence[str]) -> Run:
    """Order a run's columns as `joints`, a robot's actuated ones.

    Raises
    ------
    IdimError
        The run lacks one of them or has others.
    """
    if set(run.joints) != set(joints) or len(run.joints) != len(joints):
        raise IdimError(
            f"run '{run.name}' has the joints {', '.join(run.joints)}, but the robot's actuated joints are "
            f"{', '.join(joints)}; give signals for exactly these."
        )
    order = [run.joints.index(joint) for joint in joints]
    return replace(run, joints=tuple(joints), position=run.position[:, order], command=run.command[:, order])
