"""The folder of a campaign, its only state: design file, settings, and rounds with motion, logs and decision."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from os.path import normpath, relpath
from pathlib import Path
from typing import Annotated, Any

from pydantic import ConfigDict, Field, FiniteFloat

from gtau.documents.files import digest_of, folder_of, json_in, system_refusals, write_atomically
from gtau.documents.markup import Document, read_yaml, yaml_text
from gtau.documents.validation import Keys, Positive, validate
from gtau.errors import GtauError
from gtau.excitation.design_file import DesignFile
from gtau.model.home import load_robot

DESIGN, SETTINGS, MOTION = "design.yaml", "campaign.yaml", "motion.json"
PLAYED, DECISION, ASIDE = "played.json", "decision.json", "set-aside.txt"
WARM_UP = "warm-up"  # name of a run that is played but not evaluated
RATE = 250.0  # Hz, accepted by common controllers
PAYLOAD = "payload"
ORDER = (False, True, True, False)  # loaded runs: drift affects both loads alike, and the payload is mounted once


class Settings(Keys):
    """Aim of a campaign: half-width of every gain's 95 % interval, per cent of its value."""

    accuracy: Annotated[FiniteFloat, Field(gt=0, le=50)] = 3.0


class PlayedRun(Keys):
    """A run played: its log in the round's folder, and how it ended."""

    name: str
    log: str
    end: str = "completed"


class Played(Keys):
    """Record of a player: hash of the motion, speed, how it ended, runs, and the columns of its logs if not usual."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    format: str = Field(alias="schema")
    hash: str
    speed: Positive = 1.0
    end: str
    runs: tuple[PlayedRun, ...] = ()
    signals: dict[str, Any] | None = None


@dataclass(frozen=True)
class Round:
    """A round: its folder, its motion, the record of the player, and why its logs are set ``aside`` (empty if not)."""

    folder: Path
    motion: Mapping[str, Any]
    played: Played | None
    aside: str

    @property
    def number(self) -> int:
        """Number of the round, starting with 1."""
        return int(self.folder.name)

    @property
    def runs(self) -> tuple[PlayedRun, ...]:
        """Runs played, without the warm-up."""
        return tuple(run for run in self.played.runs if run.name != WARM_UP) if self.played else ()

    @property
    def decision(self) -> Mapping[str, Any] | None:
        """Decision from the rounds up to this one, if there is one."""
        return _json(self.folder / DECISION, "kind say next gains candidates notes suspect inputs")


def read_settings(folder: Path, robot: str | Path | None, payload: float | None, accuracy: float | None) -> Settings:
    """Read the aim of a campaign, or begin the campaign with a robot and a payload's mass, kg."""
    path = folder / SETTINGS
    given = None if accuracy is None else validate(Settings, Document(path, {"accuracy": accuracy}))
    begin(folder, robot, payload)
    if given is not None:
        write_atomically(path, yaml_text(given.model_dump()))
    return validate(Settings, read_yaml(path)) if path.exists() else Settings()


def begin(folder: Path, robot: str | Path | None, payload: float | None) -> None:
    """Write the design file of a new campaign; refuse a robot or payload that an existing one does not state."""
    path = folder / DESIGN
    if robot is not None and (Path(robot) / "robot.urdf").is_file():  # a folder may name a robot
        robot = Path(robot) / "robot.urdf"
    if not path.exists():
        if robot is None or payload is None:
            raise GtauError(
                f"{folder} holds no campaign; begin it with a robot and the mass of a payload, or put a {DESIGN} of "
                "'gtau excite' there."
            )
        runs = [{"payload": {"name": PAYLOAD, "mass": payload} if loaded else "none"} for loaded in ORDER]
        load_robot(robot)  # before the folder is made
        source = relpath(robot, folder) if Path(robot).is_file() else str(robot)
        design = {"robot": source, "rate": RATE, "runs": runs}
        validate(DesignFile, Document(path, design))
        write_atomically(folder_of(folder) / DESIGN, yaml_text(design))
        return
    file = read_design_file(folder)
    masses = {f"{load.mass:g}" for load in file.payloads if load is not None and load.mass}
    differs = robot is not None and str(robot) != file.robot and Path(robot).resolve() != Path(file.robot).resolve()
    if differs or (payload is not None and f"{payload:g}" not in masses):
        raise GtauError(
            f"{path} states robot {normpath(file.robot)} and payloads of {', '.join(masses)} kg, other than the "
            "command; change the file, or begin another folder."
        )


def read_design_file(folder: Path) -> DesignFile:
    """Read the design file of a campaign."""
    return validate(DesignFile, read_yaml(folder / DESIGN), context=folder)


def read_rounds(folder: Path) -> list[Round]:
    """Read the rounds with a motion; a folder without one was interrupted and is made again."""
    rounds = []
    for path in sorted(path for path in folder.iterdir() if re.fullmatch(r"\d\d", path.name)):
        motion = _json(path / MOTION, "hash files joints runs guards rehearsal purpose after")
        played, aside = _json(path / PLAYED, "hash"), path / ASIDE
        if motion is None:
            continue
        record = None if played is None else validate(Played, Document(path / PLAYED, played))
        reason = aside.read_text(encoding="utf-8").strip() or "without a reason" if aside.exists() else ""
        rounds.append(Round(path, motion, record, reason))
    return rounds


def _json(path: Path, keys: str) -> Mapping[str, Any] | None:
    """Read a JSON document with these keys; None if there is no file."""
    if not path.exists():
        return None
    try:
        with system_refusals(path):
            content = json_in(path.read_text(encoding="utf-8"))
    except ValueError:
        content = None
    if not isinstance(content, dict) or not {*keys.split()} <= content.keys():
        raise GtauError(f"{path} is not as it was written; remove it, and run the command that wrote it again.")
    return content


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Write a JSON document atomically."""
    write_atomically(path, json.dumps(document, indent=1, allow_nan=False) + "\n")


def digest(paths: Iterable[Path], base: Path) -> dict[str, str]:
    """Hash files (SHA-256) by their paths relative to ``base``; the hash of a missing file is empty."""
    return {Path(relpath(path, base)).as_posix(): digest_of(path) if path.is_file() else "" for path in paths}


def seal(motion: Mapping[str, Any]) -> str:
    """Hash a motion.json with the hashes of its files (SHA-256 of everything but its ``hash``, keys sorted)."""
    content = {key: value for key, value in motion.items() if key != "hash"}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def scene(folder: Path, file: DesignFile) -> list[Path]:
    """List the files on which a rehearsal depends, apart from the motion: design file, robot, meshes of shapes."""
    shapes = {} if file.limits.shapes == "none" else file.limits.shapes
    meshes = [shape.mesh for entries in shapes.values() for shape in entries if shape.mesh is not None]
    robot = Path(file.robot)
    return [folder / DESIGN, *([robot] if robot.is_file() else []), *meshes]


def void(this: Round) -> str:
    """Name the first file that has changed since the motion of a round was rehearsed; empty if none has."""
    if seal(this.motion) != this.motion["hash"]:
        return MOTION
    files: Mapping[str, str] = this.motion["files"]
    now = digest((this.folder / name for name in files), this.folder)
    return next((name for name, hashed in files.items() if now[name] != hashed), "")
