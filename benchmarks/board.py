"""How fast, how right: gtau and its peers on the same logs and simulated truths, one row a set and tool.

    python benchmarks/board.py [--data FOLDER] [--only SET ...] [--tools TOOL ...] [--update docs/evidence]

Measured logs lie in FOLDER (``../shared/data`` beside the checkout). Each peer has an environment of its own under
``--cache``, made at the first run, with the versions of PEERS; ``adapters/`` holds a script a peer, which calls it as
its documentation does. All get the same rows: those that gtau has read, even in time. Errors are rms errors over rms
commands of unused rows, per cent, both behind one low-pass, of all rows from the first to the last motion; geometric
means over joints and logs. Seconds are of one processor, of the identification without imports. ``--update`` keeps
rows in benchmarks/board.csv of that folder and puts them into its page.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
import venv
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "JAX_ENABLE_X64"), "1"))
sys.path += [str(Path(__file__).parent / folder) for folder in (".", "adapters", "../tests/support")]
import numpy as np
import zoo
from every_sample import script as by_hand
from false_alarms import alarms_of
from peer_robots import without_meshes, write_urdf
from scipy.signal import butter, sosfiltfilt
from sets import NAMES, Case, arm_of, cases_of, cutoff, moving, states
from table import write_csv

PEERS = {
    "FIGAROH": ("figaroh", "figaroh==1.0.2"),
    "mujoco.sysid": ("sysid", "mujoco[sysid]==4.0.0"),
    "trainnr": ("trainnr", "trainnr[sim]==0.1.0"),
    "jaxterity": ("jaxterity", "jaxterity==1.2.0"),
}
EDGE = 0.5  # s, at both ends of a log, where filters begin
WIDE = 20  # bandwidths of the motion that the filter of script and peers passes; FIGAROH takes 100, its best
LIMIT = 1500  # s, of a peer's process
FEW = {("arms", "mujoco.sysid"): 1}  # experiments, of which each takes a minute of a processor
NONE = "-"


@dataclass(frozen=True)
class Answer:
    """What a tool makes of a case: commands along unused logs (N, n), gains with halves of intervals.

    ``held`` counts intervals that contain the truth, and all; ``why`` is said in place of numbers.
    """

    predicted: Sequence[np.ndarray] = ()
    gains: Sequence[tuple[float, float | None]] = ()
    held: tuple[int, int] = (0, 0)
    alarms: Sequence[str] | None = None
    seconds: float = np.nan
    why: str = ""


def gtau(case: Case) -> Answer:
    """What gtau finds, with default settings."""
    result = case.result
    predicted = [result.predict(run).predicted[moving(case, run)] / result.gains for run in case.checks]
    if case.gains is not None:
        gains = [(gain.value, gain.half_interval()) for gain in result.drive_gains.values()]
        return Answer(predicted, gains, alarms=alarms_of(result), seconds=case.seconds)
    truth = result.base.matrix @ [case.chi.get(name, 0.0) for name in result.idm.parameter_names]
    pairs = [
        (each.value, each.half_interval(), true)
        for each, true in zip(result.parameters.values(), truth, strict=True)
        if case.chi and each.value is not None
    ]
    return Answer(predicted, held=holding(pairs), alarms=alarms_of(result), seconds=case.seconds)


def script(case: Case) -> Answer:
    """A careful engineer's script on Pinocchio, which is given gtau's gains."""
    if case.result.robot.closures:
        return Answer(why="this script closes no loops")
    begin = process_time()
    predict = by_hand(case.result, case.runs, "ends masked", WIDE)[0]
    seconds = process_time() - begin
    return Answer([predict(run)[moving(case, run)] / case.result.gains for run in case.checks], seconds=seconds)


def holding(pairs: Sequence[tuple[float, float | None, float]]) -> tuple[int, int]:
    """Intervals that contain the truth, and all, of values with halves and truths."""
    finite = [(value, half, truth) for value, half, truth in pairs if half is not None and np.isfinite(half * truth)]
    given = [abs(value - truth) <= half for value, half, truth in finite]
    return sum(given), len(given)


def peer(name: str, case: Case, cache: Path, folder: Path) -> Answer:
    """What a peer finds: its adapter runs in its own environment."""
    script, _ = PEERS[name]
    folder.mkdir(exist_ok=True)
    result, run = case.result, case.runs[0]
    if result.robot.closures:
        return Answer(why="for trees, by its README" if name == "FIGAROH" else "not tried: loops")
    robot, ratios = arm_of(result)
    joints = [joint.name for joint in robot.joints]
    loaded = [each for each in case.runs if each.payload is not None][:1]
    used = {"fit": [run, *loaded], "check": case.checks}
    for kind, runs in used.items():
        for k, each in enumerate(runs):
            rows = moving(case, each)
            tau = (case.constants * np.asarray(each.command)[:, : len(joints)]) @ np.linalg.inv(ratios)
            np.savez(folder / f"{kind}_{k}.npz", t=each.time[rows], q=states(result, each)[rows], tau=tau[rows])
    geometry = write_urdf(robot, folder / "geometry.urdf", {})
    masses = case.masses
    if isinstance(masses, dict):
        masses = write_urdf(robot, folder / "masses.urdf", masses)
    elif masses is not None:
        masses = without_meshes(masses, folder / f"masses{masses.suffix}")
    task = {
        "joints": joints,
        "rate": run.rate,
        "cutoff": cutoff(case, run, WIDE),
        "factor": int(np.clip(result.preparation.decimator.factor, 2, 10)),
        "payload": [None if each.payload is None else each.payload.mass for each in used["fit"]],
        "checks": len(case.checks),
        "motors": np.linalg.inv(ratios).tolist(),
        "gains": case.gains is not None,
        "geometry": str(geometry),
        "masses": None if masses is None else str(masses),
        "rotors": [case.masses.get(f"ia_{j}", 0.0) for j in joints] if isinstance(case.masses, dict) else None,
        "truth": case.chi if case.gains is None else {},
    }
    (folder / "task.json").write_text(json.dumps(task), encoding="utf-8")
    adapter = Path(__file__).parent / "adapters" / f"with_{script}.py"
    done = subprocess.run(
        [environment(name, cache) / "bin" / "python", adapter, folder], capture_output=True, text=True, timeout=LIMIT
    )
    if done.returncode:
        print(done.stderr[-2000:], file=sys.stderr)
        return Answer(why=f"failed: {done.stderr.strip().splitlines()[-1]}")
    said = json.loads((folder / "answer.json").read_text(encoding="utf-8"))
    if "why" in said:
        return Answer(why=said["why"])
    with np.load(folder / "predicted.npz") as file:
        predicted = [file[f"check_{k}"] @ ratios / case.constants for k in range(len(case.checks))]
    scales = said.get("scales") or []
    gains = [
        (scale * constant, None if half is None else half * constant)
        for (scale, half), constant in zip(scales, case.constants, strict=bool(scales))
    ]
    return Answer(predicted, gains, tuple(said.get("held", (0, 0))), said.get("alarms"), said["seconds"])


def environment(name: str, cache: Path) -> Path:
    """The peer's own environment, made at the first use."""
    script, requirement = PEERS[name]
    folder = cache / script
    if not (folder / "bin" / "python").exists():
        venv.create(folder, with_pip=True)
        more = ["ipython>=8"] if script == "figaroh" else []  # which it imports without asking for it
        subprocess.run([folder / "bin" / "python", "-m", "pip", "install", "-q", requirement, *more], check=True)
    return folder


def errors(case: Case, answer: Answer) -> list[np.ndarray]:
    """Errors of all joints (n,) of each unused log, per cent of the rms command."""
    found = []
    for run, predicted in zip(case.checks, answer.predicted, strict=True):
        edge = round(EDGE * run.rate)
        low_pass = butter(4, cutoff(case, run), fs=run.rate, output="sos")
        pair = np.asarray(run.command)[moving(case, run), : predicted.shape[1]], predicted
        measured, predicted = (sosfiltfilt(low_pass, values, axis=0)[edge:-edge] for values in pair)
        off = measured - predicted
        found.append(100 * np.sqrt(np.mean(off**2, axis=0) / np.mean(measured**2, axis=0)))
    return found


def row(words: str, tool: str, cases: Sequence[Case], answers: Sequence[Answer]) -> list[str]:
    """One row of the board: a tool on a set."""
    if answers[0].why:
        return [words, tool, *[NONE] * 5, answers[0].why]
    logs = [each for case, answer in zip(cases, answers, strict=True) for each in errors(case, answer)]
    joints = np.exp(np.mean(np.log(logs), axis=0))
    mean = f"{np.exp(np.log(joints).mean()):.3g}"
    gains = [
        (value, half, truth)
        for case, answer in zip(cases, answers, strict=True)
        for (value, half), truth in zip(answer.gains, case.gains if answer.gains else [], strict=True)
        if np.isfinite(truth)
    ]
    off = [100 * (value / truth - 1) for value, _, truth in gains]
    rms = f"{np.sqrt(np.mean(np.square(off))):.2g}" if off else NONE
    held = np.sum([holding(gains), *(answer.held for answer in answers)], axis=0)
    healthy = "simulated" in words  # of others nobody knows
    alarms = [answer.alarms for answer in answers if answer.alarms is not None and healthy]
    said = f"{sum(map(bool, alarms))} of {len(alarms)}" if alarms else NONE
    seconds = f"{float(f'{np.mean([answer.seconds for answer in answers]):.2g}'):g}"
    by_joint = ", ".join(f"{each:.3g}" for each in joints)
    failed = [answer.why for answer in answers if answer.why]
    coverage = f"{held[0]} of {held[1]}" if held[1] else NONE
    return [words, tool, mean, rms, coverage, said, seconds, "; ".join([by_joint, *failed, *chain(*alarms)])]


HEADER = ("set", "tool", "error", "gains", "intervals", "alarms", "seconds", "by joint, or why not")


def main() -> None:
    """Run the tools on the sets, print a row each, and keep them in a CSV file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--cache", type=Path, default=Path.home() / ".cache" / "gtau-board")
    parser.add_argument("--only", nargs="+", metavar="SET", choices=list(NAMES), default=list(NAMES))
    parser.add_argument("--tools", nargs="*", metavar="TOOL", choices=list(PEERS), default=list(PEERS))
    parser.add_argument("--update", type=Path, metavar="FOLDER")
    asked = parser.parse_args()
    rows = []
    for name in asked.only:
        words = NAMES[name]
        with TemporaryDirectory() as folder:
            cases = cases_of(name, asked.data.resolve(), Path(folder))
            for tool in (*OURS, *asked.tools):
                few = cases[: FEW.get((name, tool))]
                if tool in OURS:
                    answers = [OURS[tool](case) for case in few]
                else:
                    places = [Path(folder) / f"{tool}-{k}" for k in range(len(few))]
                    answers = [peer(tool, case, asked.cache, place) for case, place in zip(few, places, strict=True)]
                rows.append(row(words, tool, few, answers))
                if len(few) < len(cases):
                    rows[-1][-1] += f"; of {len(few)} of the {len(cases)} experiments"
                print(zoo.line(rows[-1]), flush=True)
    if asked.update:
        kept = keep(asked.update / "benchmarks" / "board.csv", rows)
        for name, lines in of_page(kept).items():
            zoo.update(
                asked.update / "how-fast-how-right.md", (f"<!-- {name}: begin -->", f"<!-- {name}: end -->"), lines
            )


OURS = {"gtau": gtau, "script": script}


def keep(path: Path, rows: Sequence[Sequence[str]]) -> list[list[str]]:
    """Put rows into the board's file, in its order of sets and tools, in place of older ones; all of them."""
    older = list(csv.reader(path.read_text(encoding="utf-8").splitlines()))[1:] if path.exists() else []
    all_rows = {(words, tool): [words, tool, *rest] for words, tool, *rest in [*older, *rows]}
    order = [(words, tool) for words in NAMES.values() for tool in (*OURS, *PEERS)]
    kept = [all_rows[key] for key in order if key in all_rows]
    write_csv(path, [HEADER, *kept])
    return kept


def of_page(rows: Sequence[Sequence[str]]) -> dict[str, list[str]]:
    """Tables of the page, by name: errors with seconds in brackets, and gains with intervals, of sets by tools."""
    cells = {tuple(cells[:2]): dict(zip(HEADER, cells, strict=True)) for cells in rows}

    def table(column: str, bracket: str) -> list[str]:
        def shown(words: str, tool: str) -> str:
            found = cells.get((words, tool), {})
            value, more = (found.get(kind, NONE).replace(NONE, "") for kind in (column, bracket))
            return f"{value} ({more})" if value and more else value or more

        tools = [tool for tool in (*OURS, *PEERS) if any(shown(words, tool) for words, _ in cells)]
        lines = [
            [words, *(shown(words, tool) for tool in tools)] for words in dict.fromkeys(words for words, _ in cells)
        ]
        head = ["set", *tools], ["---"] * (1 + len(tools))
        return [*map(zoo.line, (*head, *(line for line in lines if any(line[1:]))))]

    return {"errors": table("error", "seconds"), "gains": table("gains", "intervals")}


if __name__ == "__main__":
    main()
