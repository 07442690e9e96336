"""A project of the page: a folder of robot files and logs, whose experiment file is the only state.

What the page changes in the file can be changed by hand as well; comments stay where they are.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Set
from contextlib import suppress
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from gtau.documents.files import LOG, ROBOT, kind_of, write_atomically
from gtau.documents.markup import yaml_text
from gtau.doors.command import Answer, Command, within
from gtau.errors import GtauError
from gtau.model.home import load_robot
from gtau.robots.robot import Robot
from gtau.signals.channel import LINK_SIDE, SIDE_SIGNALS
from gtau.signals.reading.experiment import Experiment
from gtau.signals.reading.logs import find_columns, is_log_folder, reader_of
from gtau.signals.reading.statements import masses_in_name

EXPERIMENT = "experiment.yaml"
COMMANDS = ("current", "torque")
BY_JOINT = ("position", *COMMANDS, *(kind.calibration for kind in LINK_SIDE), *(signal.key for signal in SIDE_SIGNALS))
CHECK = re.compile(r"^(.*?)[ \t]*# CHECK:?[ \t]*(.*)$", re.MULTILINE)
SETTING = re.compile(r"'([a-z_]+: \{[^'{}]+\})'")  # as advice writes a line of the experiment file
POINTS = 2000  # of a trace that is drawn


@dataclass(frozen=True)
class RunEntry:
    """A run of the experiment file: its log as written there, the payload's mass (kg, 0 for none), and its use."""

    log: str
    mass: float | None
    validation: bool


@dataclass
class Project:
    """A folder, the robot chosen before there is an experiment file, the command that runs, and the last answers.

    ``skeleton`` is the text of the experiment file as it was drafted, without the logs ``left_out``.
    """

    folder: Path
    chosen: str | None = None
    running: Command | None = None
    answers: dict[str, Answer] = field(default_factory=dict)
    skeleton: str = ""
    left_out: Set[str] = frozenset()
    _lock: Lock = field(default_factory=Lock, repr=False)
    _robots: dict[tuple[str, float], Robot] = field(default_factory=dict, repr=False)
    _traces: dict[tuple[Path, float], dict[str, np.ndarray]] = field(default_factory=dict, repr=False)

    @property
    def file(self) -> Path:
        """The experiment file."""
        return self.folder / EXPERIMENT

    @property
    def text(self) -> str:
        """Text of the experiment file, empty where there is none."""
        with suppress(OSError):
            return self.file.read_text(encoding="utf-8", errors="surrogateescape")  # refused as YAML
        return ""

    @property
    def version(self) -> object:
        """What pages show: it differs where another page, command or hand has changed it."""
        return self.text, self.chosen, sorted(path.name for path in self.folder.iterdir()), tuple(self.answers.items())

    def cancel(self) -> None:
        """End the command that runs."""
        if self.running is not None:
            self.running.cancel()

    @property
    def content(self) -> Any:
        """Content of the experiment file, empty where there is none; raises GtauError where it is not valid YAML."""
        try:
            content = YAML().load(self.text) or {}
            for key in [key for key, value in content.items() if value is None]:  # none is the same as no key
                del content[key]
            dict(content.get("signals", {})), list(self._entries(content))
            [unit if isinstance(unit, str) else dict(unit) for unit in content.get("units", {}).values()]
            return content
        except (AttributeError, TypeError, ValueError):
            raise GtauError(f"{EXPERIMENT} has wrong content; 'gtau check {EXPERIMENT}' says where.") from None
        except YAMLError as error:
            line = getattr(getattr(error, "problem_mark", None), "line", None)
            place = "" if line is None else f", line {line + 1}"
            raise GtauError(f"{EXPERIMENT}{place}: this is not valid YAML; correct it in an editor.") from None

    def change(self, edit: Callable[[Any], None]) -> None:
        """Change the content of the experiment file, and write it atomically; raises GtauError."""
        with self._lock:
            content, written = self.content, StringIO()
            edit(content)
            yaml = YAML()
            yaml.width = 10_000
            yaml.dump(content, written)
            write_atomically(self.file, written.getvalue())
            self.answers = {name: answer for name, answer in self.answers.items() if not answer.refusal}

    def points(self) -> list[str]:
        """List the lines of a draft that a user is to confirm, with what to confirm."""
        return list(map(_point, CHECK.finditer(self.text)))

    def confirm(self, point: str) -> None:
        """Remove the mark of a point that the user has confirmed."""
        with self._lock:
            text = CHECK.sub(lambda match: match[1] if _point(match) == point else match[0], self.text)
            write_atomically(self.file, text)

    def exchange(self, point: str) -> None:
        """State that what was taken for currents are torques, or the reverse, which settles a point."""
        self.confirm(point)
        was, now = COMMANDS if "current" in self.content["signals"] else reversed(COMMANDS)
        with self._lock:
            write_atomically(self.file, re.sub(rf"^  {was}:", f"  {now}:", self.text, flags=re.MULTILINE))
        self.set_unit(now, "")  # the unit was of the other

    def robot(self) -> str | None:
        """Name or path of the robot, None where none is chosen."""
        robot = self.content.get("robot")
        name = robot.get("file") if isinstance(robot, Mapping) else robot
        return None if name is None else str(name)

    def loaded(self, robot: str) -> Robot:
        """Load a robot of the catalog, or of a file in the folder; raises GtauError."""
        path = self.folder / robot
        at = robot, path.stat().st_mtime if path.exists() else 0.0
        if at not in self._robots:
            self._robots[at] = load_robot(str(path) if path.exists() else robot)
        return self._robots[at]

    def choose(self, robot: str) -> None:
        """Choose a robot by its name or file; raises GtauError where it cannot be read."""
        self.loaded(robot)
        self.chosen = robot
        if self.text:
            self.change(lambda content: content.__setitem__("robot", robot))

    def robot_files(self) -> list[str]:
        """List the files of the folder that are robot files."""
        return [path.name for path in sorted(self.folder.iterdir()) if path.is_file() and kind_of(path) == ROBOT]

    def logs_in_folder(self) -> list[str]:
        """List the files of the folder that are logs."""
        names = [path.name for path in sorted(self.folder.iterdir()) if not path.name.startswith(".") and _is_log(path)]
        used = {Path(run.log).name for run in self.runs()}
        return [name for name in names if name not in used]

    def runs(self) -> list[RunEntry]:
        """List the runs of the experiment file, those for validation last."""
        return [entry for _, _, entry in self._entries(self.content)]

    def _entries(self, content: Any) -> Iterator[tuple[str, Any, RunEntry]]:
        for key in ("runs", "validation"):
            for run in content.get(key) or ():
                log, payload = run.get("log", ""), run.get("payload") or {}
                name = " + ".join(map(str, log)) if isinstance(log, list) else str(log)
                mass = float(payload.get("mass", "nan")) if payload else 0.0
                yield key, run, RunEntry(name, None if np.isnan(mass) else mass, key != "runs")

    def _change_run(self, log: str, edit: Callable[[Any, str, Any], None]) -> None:
        """Change the run of a log, given the content of the file, and the key that lists the run."""

        def change(content: Any) -> None:
            for key, run, entry in self._entries(content):
                if entry.log == log:
                    edit(content, key, run)
                    return
            raise GtauError(f"{log} is no longer a run of {EXPERIMENT}; another page or a hand has changed it.")

        self.change(change)

    def add_run(self, log: str) -> None:
        """Add a log as a run, with the payload that its name states."""
        masses = masses_in_name(Path(log).name)
        run = {"log": log} | ({"payload": _payload(masses[0])} if masses and masses[0] > 0 else {})
        self.change(lambda content: content.setdefault("runs", []).append(run))

    def set_mass(self, log: str, mass: float | None) -> None:
        """State the payload's mass in a run, kg; 0 or None for no payload."""
        if mass is not None and not 0 <= mass < np.inf:
            raise GtauError(f"the payload of {log} is {mass:g} kg; write 0 or a positive mass.")

        def edit(content: Any, key: str, run: Any) -> None:
            if mass:
                run.setdefault("payload", {}).update(_payload(mass))
            else:
                run.pop("payload", None)

        self._change_run(log, edit)

    def set_validation(self, log: str, validation: bool) -> None:
        """Use a run for validation, or for the identification."""

        def edit(content: Any, key: str, run: Any) -> None:
            content[key].remove(run)
            if not content[key] and key == "validation":
                del content[key]
            content.setdefault("validation" if validation else "runs", []).append(run)

        self._change_run(log, edit)

    def remove_run(self, log: str) -> None:
        """Take a run out of the experiment; its log stays in the folder."""
        self._change_run(log, lambda content, key, run: content[key].remove(run))

    def roles(self) -> dict[str, str]:
        """Map columns to their roles, such as ``time`` and ``position elbow``."""
        signals: Mapping[str, Any] = self.content.get("signals") or {}
        roles: dict[str, str] = {}
        for key, value in signals.items():
            if key in BY_JOINT and isinstance(value, Mapping):
                roles |= {str(column): f"{key} {joint}" for joint, column in value.items()}
            elif key in ("time", *BY_JOINT) and isinstance(value, str):
                roles[value] = key
        return roles

    def set_role(self, column: str, role: str | None) -> None:
        """Give a column a role; the column that had it before has none. An empty role takes the column's away."""
        key, _, joint = (role or "").partition(" ")

        def edit(content: Any) -> None:
            signals = content.setdefault("signals", {})
            for other in [name for name in signals if name in ("time", *BY_JOINT)]:
                if isinstance(signals[other], Mapping):
                    for name in [name for name, used in signals[other].items() if str(used) == column]:
                        del signals[other][name]
                    if not signals[other] and other not in ("position", *COMMANDS):
                        del signals[other]
                elif str(signals[other]) == column:
                    del signals[other]
            if not key:
                return
            if not joint:
                signals[key] = column
                return
            for other in set(COMMANDS) - {key} if key in COMMANDS else ():
                signals.pop(other, None)  # a robot's commands are either currents or torques
            columns = signals.setdefault(key, {})
            known = next((name for name in columns if str(name) == joint), joint)
            columns[known] = column

        self.change(edit)

    def unit(self, key: str) -> str:
        """Return the unit stated for a signal, empty for SI."""
        unit = (self.content.get("units") or {}).get(key, "")
        return unit if isinstance(unit, str) else yaml_text(dict(unit), flow=True).strip()

    def set_unit(self, key: str, unit: str) -> None:
        """State the unit of a signal, such as ``deg``; empty for SI."""
        try:
            stated = YAML(typ="safe").load(unit) if unit.startswith("{") else unit
        except YAMLError:
            raise GtauError(f"{unit} is no unit; write one such as deg, or one for each joint: {{q1: deg}}.") from None

        def edit(content: Any) -> None:
            units = content.setdefault("units", {})
            units.pop(key, None)
            if unit:
                units[key] = stated
            if not units:
                del content["units"]

        self.change(edit)

    def apply(self, setting: str) -> None:
        """Write a setting that an advice names, such as ``preparation: {delay: 0.01}``."""
        key, value = next(iter(YAML(typ="safe").load(setting).items()))

        def edit(content: Any) -> None:
            content[key] = {**(content.get(key) or {}), **value}

        self.change(edit)

    def traces(self, log: str) -> dict[str, np.ndarray]:
        """Read some points of every column of a log, (POINTS,) at most; raises GtauError where it cannot be read."""
        path = within(self.folder, log)
        at = path, path.stat().st_mtime
        if at not in self._traces:
            table = find_columns(path)
            parts = [values[:: max(1, len(values) // POINTS)] for values, _ in table.blocks()]
            values = np.concatenate(parts) if parts else np.zeros((0, len(table.columns)))
            values = values[:: -(-len(values) // POINTS) or 1]
            self._traces[at] = dict(zip(table.columns, values.T, strict=True))
        return self._traces[at]


def settings_in(advice: str) -> list[str]:
    """List the settings of an experiment file that an advice writes out."""
    settings = [match[1] for match in SETTING.finditer(advice)]
    return [setting for setting in settings if setting.partition(":")[0] in Experiment.model_fields]


def _point(match: re.Match[str]) -> str:
    return f"{match[1].strip(' :')}: {match[2]}"


def _is_log(path: Path) -> bool:
    if path.is_dir():
        return is_log_folder(path) and not (path / "report.html").exists()  # what a command wrote
    return reader_of(path.suffix.lower()) is not None or kind_of(path) == LOG


def _payload(mass: float) -> dict[str, Any]:
    return {"name": f"load_{mass:g}kg".replace(".", "p"), "mass": mass}
