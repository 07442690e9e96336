"""Contents of a log: its columns by kind of signal, from their names, ranges and derivatives."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from gtau.documents.validation import some_of
from gtau.errors import GtauError
from gtau.robots.robot import Robot
from gtau.signals.reading import column_names
from gtau.signals.reading.column_names import MEASURED, POSE, Group, has_word, parse_column_name
from gtau.signals.reading.columns import LARGEST_RATE, LEAST_RATE
from gtau.signals.reading.formats import LogTable, with_date
from gtau.signals.reading.formats.columnar import data_set
from gtau.signals.reading.logs import find_columns, read_log
from gtau.signals.reading.samples import refuse_short, register_of
from gtau.signals.reading.units import COMMON

ROWS = 200_000  # of a log that are evaluated
LARGEST = 1e100  # of a number that is evaluated, so that squares of it stay finite; reading refuses far smaller ones
FOLLOWED = 0.3  # rms between commands and positions, in their standard deviation: below, they are positions
ALIKE = 1.03  # ratio of the largest rate by a joint to the smallest; above, the range is named
COMMANDS = ("current", "motor", "torque", "command")  # kinds of columns, by preference
FORWARD = 0.98  # share of the steps of a time that are not back: a row out of order is sorted, or refused, at reading
USUAL_RATES = 50, 60, 100, 125, 200, 250, 400, 500, 800, 1000, 2000, 4000, 5000, 8000  # Hz
TIME_UNITS = COMMON["time"]
DERIVATIVE = 0.9  # correlation with a numerical derivative from which a column is taken for the velocity
ADDED = 50  # samples over which velocities are integrated: in one a position moves little more than its noise
WRAPS = 5.0  # steps that 95 % stay below; a larger one by a turn is a wrap (300 to 1000 of a Gen3), not a motion in deg


@dataclass(frozen=True)
class LogContents:
    """A log with its columns by kind, and the values of the first rows (N,) by column; ``rate`` (Hz) if described.

    ``elsewhere`` are positions of other joints in other topics; ``velocity`` says which columns without names are
    velocities.
    """

    table: LogTable
    values: Mapping[str, np.ndarray]
    time: tuple[str, ...]
    groups: tuple[Group, ...]
    rate: float | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    elsewhere: tuple[str, ...] = ()
    velocity: str = ""

    @classmethod
    def read(
        cls, path: Path, robot: Robot | None, kinds: Sequence[str] = ("position",), but: Collection[str] = ()
    ) -> LogContents:
        """Read a log; of a bag the first topic of one of these ``kinds`` that is not among ``but``, or its like.

        Topics are alike where each has one joint, and the same fields.
        """
        table = find_columns(path)
        joints, (rate, labels) = robot.actuated if robot else (), data_set(path, table.columns)
        names = [
            column_names.parse_item(name, labels[name], joints)
            if name in labels
            else parse_column_name(name, joints, table.units.get(name))
            for name, count in Counter(table.columns).items()
            if name and count == 1
        ]
        kind = parse_column_name(path.stem).kind
        kind_of_file = kind if kind in ("position", "current", "torque") else None
        if kind_of_file in (None, "position") and all(name.kind != "position" for name in names):
            names = [replace(name, kind="position") if name.names_joint(joints) else name for name in names]
        groups = column_names.grouped(names)
        is_matrix = [(group.kind, group.stem[-3:]) for group in groups] == [(None, "[#]")] and not kind_of_file
        if table.numbered or is_matrix:  # one array whose name says nothing of its columns
            values, first = _values(path, table.columns, table), table.columns[:1]
            time = first if _grows(values[first[0]]) and np.ptp(values[first[0]]) else ()
            unnamed, velocity = _unnamed_groups(table, values, time, len(joints))
            return cls(table, values, time, unnamed, velocity=velocity)
        topics, elsewhere = column_names.topics_of(table.columns), list[str]()
        if len(topics) > 1:
            suitable = (column_names.topic_of(group.first, topics) for group in groups if group.kind in kinds)
            main = next((topic for topic in suitable if topic not in but), None)
            positions = [name for name in names if name.kind == "position" and not name.reference]
            names = column_names.of_topics(names, topics, main) or names[:1]
            groups, known = column_names.grouped(names), {name.label for name in names}
            elsewhere = [name.name for name in positions if name.label not in known]
        wanted = [name for name in names if name.kind not in (None, "other")] or names
        values = _values(path, [name.name for name in wanted], table)
        for name in wanted:
            if name.kind != "time" and (register := register_of(values[name.name])):
                values[name.name] = register.signed(values[name.name])
        times = [name.name for name in wanted if name.kind == "time" and not name.label]
        if not (time := _time_columns(times, values)):
            dated = read_log(path, [name.name for name in names if name.kind is None]).dated()
            values |= _values(path, dated, table)
            time = _time_columns(dated, values)
        values |= _values(path, [name for name in time if name not in values], table)  # a date and a clock time
        units = {name.name: name.unit for name in names if name.unit}
        return cls(table, values, time, tuple(_classified(groups, values, kind_of_file)), rate, units, tuple(elsewhere))

    def stated(self, patterns: Mapping[str, str]) -> LogContents:
        """Return the contents with the groups that ``patterns`` of columns state by kind; raises GtauError.

        A pattern is a column, several between commas, or a glob (``enc_J*``); what the asterisk stands for, or else the
        whole name, is the label of a joint.
        """
        names = {kind: self._matching(kind, pattern) for kind, pattern in patterns.items()}
        taken = {name for columns in names.values() for name in columns.values()}
        values = dict(self.values) | _values(self.table.path, sorted(taken), self.table)
        parsed = (parse_column_name(name, (), self.table.units.get(name)) for name in taken)
        units = dict(self.units) | {name.name: name.unit for name in parsed if name.unit}
        others = [group for group in self.groups if taken.isdisjoint(group.columns.values())]
        groups = [
            Group(kind, patterns[kind], columns, in_order="*" not in patterns[kind])
            for kind, columns in names.items()
            if kind != "time"
        ]
        stated = set(COMMANDS if names.keys() & set(COMMANDS) else ()).union(names)
        kept = [group for group in others if group.kind not in stated]
        time = tuple(names["time"].values()) if "time" in names else self.time
        return replace(self, values=values, units=units, groups=(*groups, *kept), time=time, elsewhere=())

    def _matching(self, kind: str, pattern: str) -> dict[str, str]:
        columns: dict[str, str] = {}
        for part in pattern.split(","):
            before, star, after = part.strip().partition("*")
            matches = [name for name in self.table.columns if fnmatchcase(name, part.strip())]
            matches = matches or [part.strip()] * (kind == "time" and " + " in part)
            if not matches:
                raise GtauError(
                    f"--{kind} is '{pattern}', but no column matches '{part.strip()}'; the columns are "
                    f"{some_of(self.table.columns, 20)}.",
                    source=self.table.path,
                )
            for name in matches:
                columns[name[len(before) : len(name) - len(after)] if star else name] = name
        return columns

    def command_topic(self, robot: Robot | None) -> LogContents | None:
        """Return the commands of a bag whose positions are in this topic."""
        topics, positions = column_names.topics_of(self.table.columns), self.group("position")
        columns = positions.columns.values() if positions else ()
        tried = {column_names.topic_of(column, topics) for column in columns} if columns else {*topics}
        while len(tried) < len(topics):
            topic = LogContents.read(self.table.path, robot, COMMANDS, but=tried)
            read = {column_names.topic_of(name, topics) for name in topic.values}
            if topic.command_group() or read <= tried:
                return topic if topic.command_group() else None
            tried |= read
        return None

    @property
    def rows(self) -> int:
        """Number of rows that were read."""
        return max(map(len, self.values.values()), default=0)

    def is_still(self, column: str) -> bool:
        """Return whether a column that was read never changes."""
        values = self.values[column][np.isfinite(self.values[column])]
        return not (values != values[:1]).any()

    def group(self, kind: str) -> Group | None:
        """Return the columns of a kind: moving ones, then measured ones, the group with most joints first."""

        def rank(group: Group) -> tuple[bool, bool, int, bool]:
            return self._is_switch(group), group.reference, -len(group.columns), not has_word(group.stem, MEASURED)

        groups = (group for group in self.groups if group.kind == kind)
        return min((group for group in groups if {*group.columns.values()} <= {*self.values}), key=rank, default=None)

    def _is_switch(self, group: Group) -> bool:
        moving = (self.values[name] for name in group.columns.values() if not self.is_still(name))
        return group.kind in COMMANDS and all(np.isin(np.nan_to_num(column), (0, 1)).all() for column in moving)

    def command_group(self) -> Group | None:
        """Select currents before torques, and torques of motors before torques of joints, which sensors may give."""
        position = self.group("position")
        groups = [group for kind in COMMANDS if (group := self.group(kind)) is not None and not self._is_switch(group)]
        complete = (group for group in groups if position is None or len(group.columns) >= len(position.columns))
        return next(complete, groups[0] if groups else None)

    def moving_beside(self, used: Collection[str], labels: Collection[str], kind: str | None) -> list[str]:
        """List positions, and commands of a kind, that change, are not used, and have none of the labels."""
        return [
            column
            for group in self.groups
            if group.kind in ("position", kind) and not group.reference
            for label, column in group.columns.items()
            if label and label not in labels and column in self.values.keys() - used and not has_word(column, POSE)
            if not self.is_still(column)
        ]

    def other_clocks(self) -> list[str]:
        """List further increasing columns with time names, except the message stamps of a bag."""
        if len(self.time) != 1 or " + " in self.time[0]:
            return []
        time = self.values[self.time[0]]
        return [
            name
            for name, values in self.values.items()
            if name not in self.time and not name.startswith("/") and parse_column_name(name).kind == "time"
            if _grows(values) and not np.array_equal(values, time, equal_nan=True)
        ]

    def seconds(self) -> np.ndarray:
        """Return the time in its own unit."""
        time = self.values[self.time[0]]
        return time if len(self.time) == 1 else time + 1e-9 * self.values[self.time[1]]

    def time_unit(self) -> tuple[str, str]:
        """Determine the time unit, the first with a plausible logging rate of drives, and the reason."""
        step = float(np.nanmedian(np.diff(self.seconds())))
        written = self.units.get(self.time[0])
        if written and written not in TIME_UNITS:
            return written, "unit as written in the log"
        for unit, factor in TIME_UNITS.items():
            rate = 1 / (step * factor) if step > 0 else 0.0
            if LEAST_RATE <= rate <= LARGEST_RATE and written in (None, unit):
                return unit, f"median step {step:.4g} {unit}, {rate:.4g} Hz"
        tried = written or "s, ms, us or ns"
        return written or "s", f"median step {step:.4g}: not a plausible sampling rate in {tried}; correct the column"

    def rate_from_velocities(self, positions: Group) -> tuple[float | None, str]:
        """Find the sampling rate, Hz, at which logged velocities are the positions' derivatives, and the reason."""
        velocities, rates = self.group("velocity"), self._rates(positions)
        rate = float(np.median(rates or [0.0]))
        if velocities is None or not LEAST_RATE <= rate <= LARGEST_RATE:
            return None, "not in the log"
        reason = f"no time column; {velocities.listed} are the velocities at {rate:.4g} Hz"
        if max(rates) > ALIKE * min(rates):
            reason += f", by joint {min(rates):.4g} to {max(rates):.4g} Hz"
        nearest = min(USUAL_RATES, key=lambda usual: abs(usual - rate))
        return float(nearest) if abs(nearest - rate) < 0.03 * nearest else float(f"{rate:.4g}"), reason

    def _rates(self, positions: Group) -> list[float]:
        velocities = self.group("velocity")
        rates = [_rate_of_derivative(*pair) for pair in _pairs(positions, velocities, self.values)]
        return [rate for rate in rates if rate is not None]

    def slope(self, positions: Group) -> tuple[float | None, float]:
        """Compute the ratio of the positions' derivatives to the velocities, None if unknown, and the largest speed."""
        velocities, rates = self.group("velocity"), self._rates(positions)
        second = TIME_UNITS.get(self.time_unit()[0]) if self.time else None
        if velocities is None or not rates or second is None:
            return None, 0.0
        time = self.seconds()
        step = (np.nanmax(time) - np.nanmin(time)) * second / max(len(time) - 1, 1)
        speeds = (np.abs(self.values[column]) for column in velocities.columns.values())
        fastest = max(float(np.nanmax(speed, initial=0.0)) for speed in speeds)
        return 1 / (float(step) * float(np.median(rates))), fastest


def _unnamed_groups(
    table: LogTable, values: Mapping[str, np.ndarray], time: tuple[str, ...], joints: int
) -> tuple[tuple[Group, ...], str]:
    """Group columns without names, velocities being derivatives of the columns n to their left; say which they are."""
    stamps = values[time[0]] if time else None
    rest = table.columns[len(time) :]
    widths = [joints] if joints else range(1, min(len(rest) // 2, 12) + 1)
    scores = {
        n: float(np.median([_correlation(values[rest[k]], values[rest[n + k]], stamps) for k in range(n)]))
        for n in widths
        if 2 * n <= len(rest)
    }
    width = max(scores, key=scores.__getitem__, default=0)
    if scores.get(width, 0.0) <= DERIVATIVE:
        return (), ""
    kinds = ["position", "velocity"]
    blocks = [rest[k : k + width] for k in range(0, len(rest) - len(rest) % width, width)]
    for block in blocks[2:]:
        still = any(not np.ptp(values[name]) for name in block)
        slopes = [_correlation(values[qd], values[column], stamps) for qd, column in zip(blocks[1], block, strict=True)]
        kinds.append("other" if still else "acceleration" if np.median(slopes) > DERIVATIVE else "command")
    groups = [
        Group(kind, f"block {k + 1}", {str(i + 1): name for i, name in enumerate(block)})
        for k, (kind, block) in enumerate(zip(kinds, blocks, strict=True))
    ]
    return tuple(groups), f"columns {groups[1].listed} are the velocities (correlation {scores[width]:.3f})"


def _values(path: Path, names: Sequence[str], table: LogTable) -> dict[str, np.ndarray]:
    """Read the first rows, of the first episode where there are several."""
    if not names:
        return {}
    log = read_log(path, names)
    rows = next(iter(table.episodes.values()), range(ROWS))
    parts = [values for values, _ in log.blocks(rows[:ROWS])]
    refuse_short(str(path), sum(map(len, parts)))
    table_of_rows = np.vstack(parts)
    table_of_rows[np.abs(table_of_rows) > LARGEST] = np.nan
    return {name: table_of_rows[:, k] for k, name in enumerate(log.columns)}


def _time_columns(times: Sequence[str], values: Mapping[str, np.ndarray]) -> tuple[str, ...]:
    """Find the increasing column among columns of times, or the two of seconds and nanoseconds."""
    parts = [name for name in times if re.search(r"nano|nsec", name, re.IGNORECASE)]
    if parts and len(times) > len(parts):
        return next(name for name in times if name not in parts), parts[0]
    growing = [name for name in times if _grows(values[name], FORWARD)]
    stamped = [name for name in growing if "stamp" in name.lower()]
    return tuple(with_date(name, {other: values[other] for other in times}) for name in (stamped or growing)[:1])


def _grows(column: np.ndarray, forward: float = 1.0) -> bool:
    step = np.diff(column[np.isfinite(column)])
    return len(step) > 0 and float((step >= 0).mean()) >= forward and float((step > 0).mean()) > 0.5


def _classified(groups: Sequence[Group], values: Mapping[str, np.ndarray], kind: str | None) -> Iterator[Group]:
    """Classify commands that are derivatives of the positions as velocities, and a lone group by its file."""
    positions = next((group for group in groups if group.kind == "position" and not group.reference), None)
    if len(groups) == 1 and groups[0].kind is None and kind:
        groups = [replace(groups[0], kind=kind)]
    for group in groups:
        pairs = _pairs(positions, group if group.kind == "command" else None, values)
        pairs = [(q, x) for q, x in pairs if np.isfinite(q - x).any()]
        distances = [(np.sqrt(np.nanmean((q - x) ** 2)), float(np.nanstd(q))) for q, x in pairs]
        if pairs and np.median([_correlation(*pair) for pair in pairs]) > DERIVATIVE:
            yield replace(group, kind="velocity")
        elif np.median([rms / std for rms, std in distances if std > 0] or np.inf) < FOLLOWED:
            yield replace(group, kind="position", reference=True)
        else:
            yield group


def _pairs(
    positions: Group | None, group: Group | None, values: Mapping[str, np.ndarray]
) -> list[tuple[np.ndarray, np.ndarray]]:
    if positions is None or group is None:
        return []
    pairs = [(column, group.columns.get(label, "")) for label, column in positions.columns.items()]
    return [(values[q], values[other]) for q, other in pairs if q in values and other in values]


def _rate_of_derivative(position: np.ndarray, velocity: np.ndarray) -> float | None:
    """Find the rate, Hz, at which velocities integrated over ``ADDED`` samples match the positions; None without."""
    span, position = min(ADDED, len(position) // 4), _continuous(position)
    total = np.concatenate([[0.0], np.cumsum(np.nan_to_num((velocity[1:] + velocity[:-1]) / 2))])
    moved, added = position[span:] - position[:-span], total[span:] - total[:-span]
    finite = np.isfinite(moved)
    moved, added = moved[finite], added[finite]
    along = float(added @ moved)
    if along <= 0 or along**2 < DERIVATIVE**2 * float(added @ added) * float(moved @ moved):
        return None
    return float(added @ added) / along


def _continuous(position: np.ndarray) -> np.ndarray:
    """Unwrap positions (N,) in rad or deg where they jump by a turn, WRAPS times as far as usual."""
    step = np.diff(position, prepend=position[:1])
    usual = np.nanquantile(np.abs(step), 0.95)
    for turn in (2 * np.pi, 360.0):
        wraps = (np.abs(np.abs(step) - turn) < 0.08 * turn) & (np.abs(step) > WRAPS * usual)
        position = position - turn * np.cumsum(np.where(wraps, np.sign(step), 0.0))
    return position


def _correlation(position: np.ndarray, velocity: np.ndarray, time: np.ndarray | None = None) -> float:
    """Correlate a column of velocities (N,) with the derivative of positions; 0 where one of them never changes."""
    position = _continuous(position)
    slope, value = (position[2:] - position[:-2]), velocity[1:-1]
    if time is not None:
        step = time[2:] - time[:-2]
        slope = np.where(step > 0, slope / np.where(step > 0, step, 1.0), np.nan)
    finite = np.isfinite(slope) & np.isfinite(value)
    if finite.sum() < 10 or not np.ptp(slope[finite]) or not np.ptp(value[finite]):
        return 0.0
    return float(np.corrcoef(slope[finite], value[finite])[0, 1])
