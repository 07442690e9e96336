"""The contract of players: read and check a round's motion, and write what was played (docs/lookup/players.md)."""

from __future__ import annotations

import csv
import hashlib
import json
import os
import select
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from os.path import normpath
from pathlib import Path

import numpy as np

APPROACH = 3.0  # s, from where the robot stands to where the motion starts


@dataclass(frozen=True)
class Motion:
    """A round's motion: ``time`` (N,), ``q``, ``qd`` and ``qdd`` (N, n) of ``joints``, and motion.json (``file``)."""

    folder: Path
    file: dict
    time: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    speed: float = 1.0

    @property
    def joints(self) -> list[str]:
        """Names of the joints, in order."""
        return [joint["name"] for joint in self.file["joints"]]

    def limits(self, key: str) -> np.ndarray:
        """Return a number of every joint (n,): ``start``, ``start_tolerance`` or ``tracking_tolerance``, rad or m."""
        return np.array([joint[key] for joint in self.file["joints"]])

    def slower(self, speed: float) -> Motion:
        """Return the same path at a fraction of the speed; end the program where that is not above 0 and at most 1."""
        if not 0.0 < speed <= 1.0:
            sys.exit(f"--speed {speed:g} was not rehearsed; give a fraction of the full speed, such as 0.1.")
        qd, qdd = self.qd * speed, self.qdd * speed**2
        return replace(self, time=self.time / speed, qd=qd, qdd=qdd, speed=speed)

    def approach(self, q: np.ndarray) -> Motion:
        """Return a slow motion from positions (n,) to where this one begins; refuse positions that are elsewhere."""
        self.refuse_start(q)
        part = np.linspace(0.0, 1.0, round(APPROACH * self.file["rate"]) + 1)[:, None]
        way = self.q[0] - q
        return replace(
            self,
            time=APPROACH * part[:, 0],
            q=q + (3 - 2 * part) * part**2 * way,
            qd=6 * (1 - part) * part * way / APPROACH,
            qdd=(6 - 12 * part) * way / APPROACH**2,
        )

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position, velocity and acceleration (n,) at an instant."""
        return tuple(
            np.array([np.interp(time, self.time, column) for column in rows.T]) for rows in (self.q, self.qd, self.qdd)
        )

    def refuse_start(self, q: np.ndarray) -> None:
        """Refuse to move from positions (n,) other than those in which the motion begins."""
        for joint, here in zip(self.file["joints"], q, strict=True):
            if abs(here - joint["start"]) > joint["start_tolerance"]:
                sys.exit(f"joint '{joint['name']}' stands at {here:.4g}, the motion starts at {joint['start']:.4g}.")

    def strayed(self, q: np.ndarray, wanted: np.ndarray) -> str:
        """Say which joint is further from where it should be than allowed, empty if none is."""
        for joint, error in zip(self.file["joints"], np.abs(q - wanted), strict=True):
            if error > joint["tracking_tolerance"]:
                return f"tracking error of joint '{joint['name']}': {error:.3g} {joint['unit']}"
        return ""


def hashed(path: Path) -> str:
    """Return the SHA-256 of a file, empty where there is none."""
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""


def seal(file: dict) -> str:
    """Return the SHA-256 of what motion.json holds beside its ``hash``."""
    content = {key: value for key, value in file.items() if key != "hash"}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def read_motion(folder: str | Path) -> Motion:
    """Read a round's motion; end the program where its rehearsal is void, because a file changed since."""
    folder, again = Path(folder), f"run 'gtau campaign {normpath(Path(folder) / '..')}' again."
    try:
        file = json.loads((folder / "motion.json").read_text())
        intact = seal(file) == file["hash"]
    except (OSError, ValueError, KeyError, AttributeError):
        sys.exit(f"{folder / 'motion.json'} cannot be read; give the folder of a round, such as camp/01, or {again}")
    for name, digest in file["files"].items() if intact else [("motion.json", "another")]:
        if hashed(folder / name) != digest:
            sys.exit(f"{normpath(folder / name)} has changed, so the rehearsal is void; {again}")
    with (folder / "motion.csv").open() as lines:
        header = next(csv.reader(lines))
        columns = dict(zip(header, np.loadtxt(lines, delimiter=",").T, strict=True))
    names = [joint["name"] for joint in file["joints"]]
    tables = (np.array([columns[f"{kind}_{name}"] for name in names]).T for kind in ("q", "qd", "qdd"))
    return Motion(folder, file, columns["t"], *tables)


def pressed() -> bool:
    """Whether the operator pressed Enter in the terminal."""
    return bool(select.select([sys.stdin], [], [], 0)[0])


def mount(run: dict) -> None:
    """Wait until the payload of a run is mounted."""
    load = run["payload"]["name"] if run["payload"] else "no payload"
    input(f"{run['name']}: mount {load}, set it in the controller if it has such a setting, then press Enter: ")


def play_round(
    folder: Path, speed: float, play_run: Callable[[dict, Motion], tuple[str, str]], signals: dict | None = None
) -> None:
    """Play the runs of a round until one is stopped, write played.json after a full speed, and end the program.

    ``play_run`` plays one run and returns its log (path from the round's folder) and how it ended.
    """
    motion, runs, end = read_motion(folder).slower(speed), [], "completed"
    played = Path(folder) / "played.json"
    if speed == 1.0 and played.exists():
        sys.exit(f"{folder} was played already; remove {played} to play it again, which replaces its logs.")
    for run in motion.file["runs"]:
        try:
            log, end = play_run(run, motion)
            runs.append({"name": run["name"], "log": log, "end": end})
        except KeyboardInterrupt:
            end = "stopped by the operator"
        print(f"{run['name']}: {end}")
        if end != "completed":
            break
    if speed == 1.0:
        write_played(motion, runs, end, signals)
    sys.exit(end != "completed")


def write_log(
    motion: Motion, run: str, time: np.ndarray, q: np.ndarray, current: np.ndarray, **beside: np.ndarray
) -> str:
    """Write a run's log, but not of a dry run: ``t``, ``q_<joint>``, ``i_<joint>``; return its path in the folder.

    Signals ``beside`` them, such as ``duty``, are further columns: ``duty_<joint>``.
    """
    path = motion.folder / "logs" / f"{run}.csv"
    if motion.speed == 1.0:
        path.parent.mkdir(exist_ok=True)
        kinds = {"q": q, "i": current, **beside}
        header = ",".join(["t", *(f"{kind}_{name}" for kind in kinds for name in motion.joints)])
        part = path.with_suffix(".part")
        np.savetxt(part, np.column_stack([time, *kinds.values()]), "%.9g", ",", header=header, comments="")
        os.replace(part, path)
    return f"logs/{run}.csv"


def write_played(motion: Motion, runs: list[dict], end: str, signals: dict | None = None) -> None:
    """Write played.json: the motion by its hash, its runs with their logs, the speed, and how it ended."""
    played = {"schema": "gtau-played/1", "hash": motion.file["hash"], "speed": motion.speed, "end": end, "runs": runs}
    beside = motion.folder / "played.part"
    beside.write_text(json.dumps(played | ({"signals": signals} if signals else {}), indent=1) + "\n")
    os.replace(beside, motion.folder / "played.json")
