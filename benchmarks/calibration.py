"""Coverage of intervals, and verdicts, with one defect at a time of logs, drives or descriptions.

    python benchmarks/calibration.py arm five-bar --seeds 3 --clean 20
    python benchmarks/calibration.py delta ur10e --resume --clean 8
    python benchmarks/calibration.py seven scara 3-rrr --effects docs/evidence/coverage/effects.csv
    python benchmarks/calibration.py arm five-bar scara --slow --seeds 3 --clean 3 --effects slow-runs.csv
    python benchmarks/calibration.py real --resume --page docs/evidence/index.md

Each experiment has two runs without and two with a payload, friction that differs by 2 % from run to run, and current
noise of 0.3 %; robots and their motions are those of realism/plants.py, departures those of realism/departures.py.
"real" are the measured logs beside the checkout of which there are two experiments. Every experiment is written to
the store as it is done: with ``--resume`` those that stand there are not repeated, and tables are of all that stand
there. Empty the store when the code changes.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from time import process_time

import numpy as np
from realism.departures import DEPARTURES, EFFECTS, MOTIONS, then_slow
from realism.logs import make_logs
from realism.pairs import pairs
from realism.plants import PLANTS
from realism.tables import page, widths, write_files
from scipy.special import stdtrit
from table import write_csv
from threadpoolctl import threadpool_limits

from gtau.errors import GtauError
from gtau.estimation.results.estimate import Estimate
from gtau.result import identify

REAL = "real"


@dataclass(frozen=True)
class Gain:
    """A drive gain as it was found, and what it is compared with.

    ``low`` and ``high`` bound the 95 % interval, ``random_std`` and ``random_half`` are the standard deviation and
    half the interval of the random part alone.
    """

    joint: str
    truth: float
    truth_std: float
    value: float
    std: float
    low: float
    high: float
    random_half: float
    random_std: float
    outcome: str


def gain_of(joint: str, gain: Estimate, truth: float, truth_std: float = 0.0) -> Gain:
    low, high = gain.interval() or (np.nan, np.nan)
    random = gain.random_std or np.nan
    # the random part has fewer degrees of freedom than the sum, of which the model part counts as known
    freedom = np.inf if gain.freedom is None else gain.freedom * (random / gain.std) ** 4
    half = random * float(stdtrit(min(freedom, 1e9), 0.975))
    return Gain(joint, truth, truth_std, gain.value, gain.std, low, high, half, random, gain.verdict.outcome.value)


def simulated(robot: str, departure: str, seed: int, slow: bool) -> list[Gain]:
    """Gains found from one experiment."""
    plant, what = PLANTS[robot], (DEPARTURES | MOTIONS | EFFECTS)[departure]
    runs, gains = make_logs(plant, then_slow(what) if slow else what, seed)
    told = plant.model.robot if what.robot is None else what.robot(plant.model.robot)
    with threadpool_limits(1, "blas"):
        found = identify(told, runs).drive_gains
    return [gain_of(joint, gain, float(truth)) for (joint, gain), truth in zip(found.items(), gains, strict=True)]


def experiments(
    robots: list[str], seeds: int, clean: int, only: str, departures: Iterable[str]
) -> Iterator[tuple[str, str, int]]:
    for robot in robots:
        for name in departures:
            if only in name:
                yield from ((robot, name, seed) for seed in range(clean if name == "none" else seeds))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("robots", nargs="+", choices=[*PLANTS, REAL])
    parser.add_argument("--seeds", type=int, default=1, help="experiments of each robot and departure")
    parser.add_argument("--clean", type=int, default=1, help="experiments of each robot without a departure")
    parser.add_argument("--only", default="", help="departures whose name contains this")
    parser.add_argument("--motions", action="store_true", help="runs that repeat a motion, and runs that do not")
    parser.add_argument(
        "--effects", type=Path, help="effects of physics, one at a time and together: a table of widths"
    )
    parser.add_argument("--slow", action="store_true", help="the last two of four runs at a fifth of the speed")
    parser.add_argument("--store", type=Path, default=Path("calibration.jsonl"))
    parser.add_argument("--resume", action="store_true", help="keep what stands in the store")
    parser.add_argument(
        "--page", type=Path, help="the page whose tables are replaced; the others go to the folder coverage beside it"
    )
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    options = parser.parse_args()
    if not options.resume:
        options.store.unlink(missing_ok=True)
    done = read(options.store)
    departures = EFFECTS if options.effects else MOTIONS if options.motions else DEPARTURES
    names = [robot for robot in options.robots if robot != REAL]
    stands = {(each["robot"], each["departure"], each["seed"]) for each in done}
    todo = [
        each
        for each in experiments(names, options.seeds, options.clean, options.only, departures)
        if each not in stands
    ]
    for number, (robot, departure, seed) in enumerate(todo, start=1):
        begin = process_time()
        record = {"robot": robot, "departure": departure, "seed": seed, "gains": [], "refusal": ""}
        try:
            record["gains"] = [asdict(gain) for gain in simulated(robot, departure, seed, options.slow)]
        except GtauError as refusal:
            record["refusal"] = str(refusal)
        add(options.store, record | {"seconds": round(process_time() - begin, 2)})
        print(f"{number} of {len(todo)}: {robot}, {departure}, {seed}: {said(record)}", flush=True)
    if REAL in options.robots:
        for pair in pairs(options.data):
            second = pair.second
            gains = [
                asdict(gain_of(j, gain, second[j].value, second[j].std)) | {"second_outcome": second[j].verdict.outcome}
                for j, gain in pair.first.items()
            ]
            record = {"robot": REAL, "departure": pair.name, "seed": 0, "gains": gains, "refusal": "", "seconds": 0.0}
            if (REAL, pair.name, 0) not in stands:
                add(options.store, record)
            print(f"{pair.name}: {said(record)}", flush=True)
    if options.effects:
        write_csv(options.effects, widths(read(options.store)))
        return
    tables = page(read(options.store))
    if options.page is None:
        print(tables)
    else:
        replace_tables(options.page, tables)
        write_files(read(options.store), options.page.with_name("coverage"))


def said(record: dict) -> str:
    """A line of progress."""
    if record["refusal"]:
        return record["refusal"]
    return ", ".join(
        f"{100 * (g['value'] / g['truth'] - 1):+.2g} +- {50 * (g['high'] - g['low']) / abs(g['truth']):.2g} % "
        f"{g['outcome']}"
        for g in record["gains"]
    )


def read(store: Path) -> list[dict]:
    return [json.loads(line) for line in store.read_text().splitlines()] if store.exists() else []


def add(store: Path, record: dict) -> None:
    with store.open("a", encoding="utf-8") as file:
        file.write(json.dumps(record) + "\n")


MARKS = "<!-- calibration: begin -->", "<!-- calibration: end -->"


def replace_tables(path: Path, tables: str) -> None:
    text = path.read_text(encoding="utf-8")
    begin, end = (text.index(mark) for mark in MARKS)
    path.write_text(f"{text[:begin]}{MARKS[0]}\n\n{tables}\n{text[end:]}", encoding="utf-8")


if __name__ == "__main__":
    main()
