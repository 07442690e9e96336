"""Identification of every robot of a fleet, independent of failures of others."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from platform import node
from typing import Annotated

from pydantic import BeforeValidator, Field, model_validator

from gtau.documents.files import digest_of, folder_of, in_order, matching, write_atomically
from gtau.documents.markup import read_yaml
from gtau.documents.validation import FUNCTION, NAMES, PATH, TEXT, WHOLE, Keys, takes, validate
from gtau.errors import GtauError
from gtau.estimation.estimators import estimator_of
from gtau.estimation.estimators.estimator import Gains
from gtau.estimation.results.model_file import model_text
from gtau.findings import Progress, silent
from gtau.fleets.table import FleetTable, Report, fleet_table
from gtau.fleets.workers import Mapper, dask_workers, processes
from gtau.model.home import load_robot
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


Patterns = Annotated[
    tuple[str, ...], BeforeValidator(lambda value: (value,) if isinstance(value, str) else value), Field(min_length=1)
]


class FleetFile(Keys):
    """A fleet file: ``experiments``, one of each robot; or one ``experiment`` for the logs in all ``folders``."""

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
    """List the robots of a fleet file, or of experiment files and patterns; raises GtauError."""
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
    shortest = min(map(len, parts))
    first = next((k for k in range(shortest - 1) if len({names[k] for names in parts}) > 1), shortest - 1)
    room = shortest - first - 1 if len(paths) > 1 else 0
    last = next((k for k in range(room) if len({names[-1 - k] for names in parts}) > 1), room)
    return [("/".join(names[first : len(names) - last]), path) for names, path in zip(parts, paths, strict=True)]


@takes(experiments=NAMES, out=PATH, method=TEXT, jobs=WHOLE, dask=TEXT, progress=FUNCTION)
def fleet(
    experiments: Sequence[str | Path],
    out: str | Path = "fleet",
    method: str = "ml",
    jobs: int | None = None,
    dask: str | None = None,
    progress: Progress | None = None,
) -> FleetTable:
    """Identify many robots, and compare their drive gains, as ``gtau fleet`` does; a failure of one stops no other.

    Parameters
    ----------
    experiments : sequence of path
        Experiment files, one for each robot, or patterns (``"cells/*/experiment.yaml"``); or one fleet file.
    out : path
        Folder of the models, ``out/models/NAME.json``, which are not computed again until an input changes.
    method, progress : optional
        As of :func:`gtau.identify`; a method that estimates drive gains.
    jobs, dask : optional
        Number of processes, by default one for each core; or address of a Dask scheduler, or ``"local"``.

    Raises
    ------
    GtauError
        No file matches, or the method, the workers or the folder cannot be used.

    Examples
    --------
    >>> gtau.fleet(["experiment.yaml"]).robots
    ('experiment',)
    """
    if isinstance(experiments, str) or not all(isinstance(path, (str, Path)) for path in experiments):
        raise GtauError("the experiment files of robots are a list of paths; give ['experiment.yaml'].")
    if estimator_of(method).gains == Gains.GIVEN:
        raise GtauError(f"method '{method}' uses given drive gains; choose one that estimates them.")
    if dask is not None and jobs is not None:
        raise GtauError("'jobs' is for processes without Dask; give one of 'jobs' and 'dask'.")
    members, folder = read_fleet(experiments), folder_of(out)
    workers = dask_workers(dask) if dask is not None else processes(min(jobs or os.cpu_count() or 1, len(members)))
    with workers as mapper:
        return fleet_table(identify_fleet(members, folder, mapper, method, progress or silent))


def identify_fleet(
    members: Sequence[Member], out: Path, mapper: Mapper, method: str = "ml", progress: Progress = silent
) -> tuple[Report, ...]:
    """Identify every robot of a fleet whose inputs (``NAME.key``: program, robot, experiment, logs) have changed.

    Raises GtauError if the folder is not writable; errors of a robot are in its report.
    """
    items = []
    for member in members:
        model, key = _files(out, member)
        items.append((member.anywhere, key.read_text(encoding="utf-8") if model.is_file() and key.is_file() else ""))
    reports: dict[int, Report] = {}
    progress("robots", 0, len(members))
    for k, outcome in mapper(partial(identify_member, method), items):
        reports[k] = _keep(out, members[k], outcome)
        progress("robots", len(reports), len(members))
    return tuple(reports[k] for k in sorted(reports))


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
    """Compute the SHA-256 of all inputs of a model: program, method, robot, settings and logs by name and content."""
    settings = experiment.model_dump_json(exclude={"robot": True, "validation": True, "runs": {"__all__": {"log"}}})
    key = hashlib.sha256(_program())
    for text in (method, settings, native_text(load_robot(experiment.robot).with_file(source=""))):
        key.update(text.encode() + b"\0")
    for path in (log for run in experiment.runs for log in run.log):
        key.update(f"{path.name}\0{digest_of(path)}".encode(errors="surrogateescape"))
    return key.hexdigest()


@cache
def _program() -> bytes:
    files = (path for path in Path(__file__).parents[1].rglob("*") if path.suffix in (".py", ".yaml"))
    return "".join(map(digest_of, in_order(files))).encode()


def _keep(out: Path, member: Member, outcome: tuple[str, str] | GtauError) -> Report:
    model, key = _files(out, member)
    if isinstance(outcome, GtauError):
        key.unlink(missing_ok=True)
        model.unlink(missing_ok=True)
        return Report(member.name, None, str(outcome))
    inputs, text = outcome
    if text:
        key.unlink(missing_ok=True)  # until its model is written
        model.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(model, text)
        write_atomically(key, inputs)
    return Report(member.name, json.loads(model.read_text(encoding="utf-8")))


def _files(out: Path, member: Member) -> tuple[Path, Path]:
    model = out / "models" / f"{member.name}.json"
    return model, model.with_name(f"{model.name.removesuffix('.json')}.key")
