"""Identification of every robot of a fleet from its own experiment, independent of failures of others."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from platform import node
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, model_validator

from gtau.documents.files import in_order, matching, system_refusals, write_atomically
from gtau.documents.validation import Keys, validate
from gtau.documents.yaml_document import read_yaml
from gtau.errors import GtauError
from gtau.estimation.results.model_file import model_text
from gtau.fleet.workers import Mapper
from gtau.model.home import load_robot
from gtau.progress import Progress, silent
from gtau.robots.readers.native import native_text
from gtau.signals.reading.experiment import Experiment, read_experiment


@dataclass(frozen=True)
class Member:
    """A robot of a fleet: its name, its experiment file, and the folder of its logs, if different."""

    name: str
    experiment: Path
    logs: Path | None = None

    @property
    def anywhere(self) -> Member:
        """The same member with absolute paths, for processes that run in another folder."""
        return Member(self.name, self.experiment.absolute(), self.logs and self.logs.absolute())


@dataclass(frozen=True)
class Report:
    """A member with the document of its model, or the reason why it has none."""

    member: Member
    model: dict[str, Any] | None
    sentence: str = ""


Patterns = Annotated[
    tuple[str, ...], BeforeValidator(lambda value: (value,) if isinstance(value, str) else value), Field(min_length=1)
]


class FleetFile(Keys):
    """A fleet file: ``experiments``, one of each robot; or one ``experiment`` with the folders of all robots' logs.

    Paths and patterns are relative to the file. Log paths of the one experiment are relative to each of the
    ``folders``.
    """

    experiments: Patterns | None = None
    experiment: Path | None = None
    folders: Patterns | None = None

    @model_validator(mode="after")
    def _one_way(self) -> FleetFile:
        ways = [self.experiments is None, self.experiment is None, self.folders is None]
        if ways not in ([False, True, True], [True, False, False]):
            raise ValueError("give 'experiments', one file for each robot; or 'experiment' and 'folders', one for all")
        return self


def read_fleet(paths: Sequence[str | Path]) -> tuple[Member, ...]:
    """List the robots of one fleet file, or of experiment files and patterns that match some.

    They are named after the parts in which their paths differ. Raises GtauError if no file matches, or a fleet file is
    wrong.
    """
    files = _matches(map(Path, paths))
    if len(files) == 1:
        document, folder = read_yaml(files[0]), files[0].parent
        keys = document.data.keys()
        if not keys.isdisjoint(FleetFile.model_fields) or keys.isdisjoint(Experiment.model_fields):
            fleet = validate(FleetFile, document)
            if fleet.experiment is not None:
                folders = [path for path in _matches(folder / path for path in fleet.folders or ()) if path.is_dir()]
                if not folders:
                    raise GtauError(f"{files[0]}: 'folders' matches no folder; give the folders of the robots' logs.")
                return tuple(Member(name, folder / fleet.experiment, logs) for name, logs in _named(folders))
            files = _matches(folder / path for path in fleet.experiments or ())
    return tuple(Member(name, path) for name, path in _named(files))


def _matches(patterns: Iterable[Path]) -> list[Path]:
    matches: list[Path] = []
    for pattern in patterns:
        if not (files := matching(pattern)):
            raise GtauError(f"no file matches '{pattern}'; give experiment files, one for each robot.")
        matches += files
    return matches


def _named(paths: list[Path]) -> list[tuple[str, Path]]:
    """Name paths, each once, by the part between their common beginning and end."""
    paths = in_order(dict.fromkeys(paths))
    parts = [(path if path.is_dir() else path.with_suffix("")).absolute().parts for path in paths]
    if len(set(parts)) < len(parts):  # a.yaml and a.yml
        parts = [path.absolute().parts for path in paths]
    shortest = min(len(names) for names in parts)
    first = next((k for k in range(shortest - 1) if len({names[k] for names in parts}) > 1), shortest - 1)
    room = shortest - first - 1
    last = next((k for k in range(room) if len({names[-1 - k] for names in parts}) > 1), room)
    if len(paths) == 1:
        last = 0
    return [("/".join(names[first : len(names) - last]), path) for names, path in zip(parts, paths, strict=True)]


def identify_fleet(
    members: Sequence[Member], out: Path, mapper: Mapper, method: str = "ml", progress: Progress = silent
) -> tuple[Report, ...]:
    """Identify every robot of a fleet; finished models are kept and not computed again.

    Each model is written to ``out/models/NAME.json``, and a key of its inputs to ``NAME.key``. A model is reused while
    program, robot, experiment and logs are unchanged; any edit of the program counts as a change.

    ``out`` is an existing folder, ``mapper`` comes from :mod:`gtau.fleet.workers`, ``method`` is passed to
    :func:`gtau.identify`, and ``progress`` is called after each robot. Raises GtauError if the folder is not writable;
    errors of a robot are in its report.
    """
    known = [_read_text(_file(out, member, "key")) if _file(out, member).is_file() else "" for member in members]
    items = [(member.anywhere, key) for member, key in zip(members, known, strict=True)]
    reports: dict[int, Report] = {}
    progress("robots", 0, len(members))
    for k, outcome in mapper(partial(identify_member, method), items):
        reports[k] = _keep(out, members[k], outcome)
        progress("robots", len(reports), len(members))
    return tuple(report for _, report in sorted(reports.items(), key=lambda item: item[0]))


def identify_member(method: str, item: tuple[Member, str]) -> tuple[str, str] | GtauError:
    """Identify a member: the key of its inputs and the text of its model, empty if the key is the known one."""
    from gtau.estimation.experiment_runs import options_of
    from gtau.uses.identify import identify

    member, known = item
    try:
        experiment = read_experiment(member.experiment, member.logs)
        key = inputs_key(experiment, method)
        return key, "" if key == known else model_text(identify(experiment, options=options_of(method=method)))
    except GtauError as error:
        return GtauError(str(error))
    except OSError as error:
        return GtauError(f"the machine {node()} failed ({error}); check its disks and network.")
    except Exception as error:  # the other robots are identified all the same
        return GtauError(
            f"internal error ({type(error).__name__}: {error}); report it with the output of "
            f"'GTAU_DEBUG=1 gtau identify {member.experiment}'."
        )


def inputs_key(experiment: Experiment, method: str) -> str:
    """Compute the SHA-256 of all inputs of a model: program, method, robot, settings and logs by name and content.

    Raises GtauError if the robot or a log cannot be read.
    """
    settings = experiment.model_dump_json(exclude={"robot": True, "validation": True, "runs": {"__all__": {"log"}}})
    key = hashlib.sha256(_program())
    for text in (method, settings, native_text(load_robot(experiment.robot).with_file(source=""))):
        key.update(text.encode() + b"\0")
    for path in (log for run in experiment.runs for log in run.log):
        for file in in_order(path.iterdir()) if path.is_dir() else [path]:
            key.update(f"{path.name}/{file.name}".encode(errors="surrogateescape") + b"\0" + _digest(file))
    return key.hexdigest()


@cache
def _program() -> bytes:
    root = Path(__file__).parents[1]
    return hashlib.sha256(b"".join(_digest(path) for path in in_order(root.rglob("*.py")))).digest()


def _digest(path: Path) -> bytes:
    with system_refusals(path), path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").digest()


def _keep(out: Path, member: Member, outcome: tuple[str, str] | GtauError) -> Report:
    model, key = _file(out, member), _file(out, member, "key")
    if isinstance(outcome, GtauError):
        key.unlink(missing_ok=True)
        model.unlink(missing_ok=True)
        return Report(member, None, str(outcome))
    inputs, text = outcome
    if text:
        key.unlink(missing_ok=True)  # until its model is written
        model.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(model, text)
        write_atomically(key, inputs)
    return Report(member, json.loads(_read_text(model)))


def _file(out: Path, member: Member, ending: str = "json") -> Path:
    return out / "models" / f"{member.name}.{ending}"


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError:
        return ""
