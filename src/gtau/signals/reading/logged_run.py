"""Run entries of an experiment file: logs, the part used, and the payload."""

from __future__ import annotations

from difflib import get_close_matches
from glob import escape, has_magic
from pathlib import Path
from typing import Annotated, NamedTuple

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, ValidationInfo, field_validator

from gtau.documents.files import beside, matching
from gtau.signals.reading.logs import is_log_folder
from gtau.signals.reading.samples import Part
from gtau.signals.reading.statements import Payload


class Folders(NamedTuple):
    """Folders to which the paths in an experiment file are relative."""

    robot: Path
    logs: Path


def file_or_name(robot: str, folder: Path) -> str:
    """Return the path of a robot file beside an experiment file in ``folder``, or a name of the catalog.

    Raises ValueError where the entry is the path of a file that does not exist.
    """
    file = beside(folder, robot)
    if file.is_file() or (file / "robot.urdf").is_file():
        return str(file)
    if file.suffix or "/" in robot:
        raise ValueError(f"there is no file '{file}'{_close_file(file)}")
    return robot


RobotName = Annotated[
    str, AfterValidator(lambda robot, info: robot if info.context is None else file_or_name(robot, info.context))
]
"""Name of the catalog or path of a file, in a file whose folder is the context of its validation."""


class LoggedRun(Part):
    """One run: its log, or two logs with positions and commands, and the payload carried, if any.

    In a file the logs may be patterns (``free_*.csv``): a run for each match, of two patterns the first match of one
    with the first of the other. A folder of ``.parquet`` files is one log, and so is a rosbag2.
    """

    model_config = ConfigDict(populate_by_name=False)

    log: Annotated[
        tuple[Path, ...],
        BeforeValidator(lambda value: (value,) if isinstance(value, (str, Path)) else value),
        Field(min_length=1, max_length=2),
    ]
    payload: Payload | None = None

    def overlaps(self, other: LoggedRun) -> bool:
        """Decide whether both runs share rows."""
        if self.log != other.log or (None not in (self.episode, other.episode) and self.episode != other.episode):
            return False
        return self.begin < other.end and other.begin < self.end

    @field_validator("log")
    @classmethod
    def _existing(cls, log: tuple[Path, ...], info: ValidationInfo) -> tuple[Path, ...]:
        if info.context is None:
            return log
        placed = tuple(_placed(info.context.logs, path) for path in log)
        matches = [_logs_at(path) for path in placed]
        for written, logs in zip(log, matches, strict=True):
            path = beside(info.context.logs, written)
            if not logs and has_magic(str(written)):
                raise ValueError(f"no file matches '{path}'; paths are relative to the experiment file")
            for existing in logs or [path]:
                if not existing.is_file() and not is_log_folder(existing):
                    if existing.is_dir():
                        raise ValueError(
                            f"the folder '{existing}' holds no .parquet files and is not a rosbag2; give a file, or "
                            "such a folder"
                        )
                    raise ValueError(f"there is no file '{existing}'{_close_file(existing)}")
        if len({len(logs) for logs in matches}) > 1:
            raise ValueError(
                f"'{log[0]}' matches {len(matches[0])} files and '{log[1]}' {len(matches[1])}; they are paired in "
                f"order, so both must match the same number"
            )
        return placed

    def per_match(self) -> list[LoggedRun]:
        """List the runs, one for each match of the patterns."""
        pairs = zip(*(_logs_at(path) for path in self.log), strict=True)
        return [self.model_copy(update={"log": logs}) for logs in pairs]


def _placed(folder: Path, path: Path) -> Path:
    """Join a path to a folder whose name is taken literally."""
    existing = beside(folder, path)
    return existing if existing.exists() else beside(Path(escape(str(folder))), path)


def _logs_at(path: Path) -> list[Path]:
    """List the files that a path or a pattern matches; patterns skip YAML files such as the experiment file."""
    return [match for match in matching(path) if match == path or match.suffix not in (".yaml", ".yml")]


def _close_file(path: Path) -> str:
    if path.is_symlink():
        return f"; it is a link to '{path.readlink()}', which does not exist"
    if path.exists():
        return "; it is a device or a pipe"
    names = [file.name for file in path.parent.iterdir()] if path.parent.is_dir() else []
    close = get_close_matches(path.name, names, n=1)
    if close:
        return f"; did you mean '{close[0]}'?"
    return "; paths are relative to the file that names them"
