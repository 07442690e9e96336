"""How often anything is said against experiments with which nothing is wrong, over all checks together.

    python benchmarks/false_alarms.py arm five-bar --seeds 75
    python benchmarks/false_alarms.py delta --seeds 10 --real

Robots, motions, friction and noise are drawn anew for each experiment: two runs without and two with a payload, 6 s
each, friction that differs by 2 % from run to run, current noise of 0.3 %. "--real" adds the measured logs beside the
checkout. An alarm is a refusal, a contradictory gain, parameter or payload, or a finding that claims a fault of the
logs or of their description. Experiments are written to the store as they are done, and those that stand there are
not repeated. The bound is that of Clopper and Pearson at 95 %, one-sided.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import zoo
from realism.departures import DEPARTURES
from realism.logs import make_logs
from realism.plants import PLANTS
from scipy.stats import beta
from threadpoolctl import threadpool_limits

from gtau.errors import GtauError
from gtau.estimation.results.conclusions import findings
from gtau.findings import Grade
from gtau.result import Result, identify

SECONDS = 6.0
# Of what stands in a log as it was recorded nothing is said that is wrong: clipped, filtered and held signals, rests.
CLAIMS = (
    "model",
    "scale of the gains",
    "position noise",
    "joint limits",
    "sampling rate",
    "filtered command",
    "held signal",
)


def alarms_of(result: Result) -> list[str]:
    """What is said against an experiment, by the kind of check."""
    judged = {
        "gain": [each.verdict for each in result.drive_gains.values()],
        "parameter": [each.verdict for each in result.parameters.values()],
        "payload": [each.verdict for each in result.payloads],
    }
    said = [
        f"{kind}: {verdict.why}"
        for kind, verdicts in judged.items()
        for verdict in verdicts
        if verdict.outcome == Grade.CONTRADICTORY
    ]
    # legs do differ: the parameters of each are drawn by themselves
    claimed = [note for note in findings(result) if note.topic in CLAIMS and note.kind != "unlike legs"]
    return said + [f"{note.kind}: {note.what}" for note in claimed]


def simulated(robot: str, seed: int) -> list[str]:
    plant = replace(PLANTS[robot], seconds=SECONDS)
    try:
        runs, _ = make_logs(plant, DEPARTURES["none"], 1000 + seed)
        return alarms_of(identify(plant.model.robot, runs))
    except GtauError as refusal:
        return [f"refused: {refusal}"]


def measured(entry: zoo.Entry, data: Path) -> list[str]:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "experiment.yaml"
        path.write_text(entry.write(data, Path(folder)), encoding="utf-8")
        try:
            return alarms_of(identify(path))
        except GtauError as refusal:
            return [f"refused: {refusal}"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("robots", nargs="*", help=f"some of {', '.join(PLANTS)}")
    parser.add_argument("--seeds", type=int, default=20, help="experiments of each robot")
    parser.add_argument("--real", action="store_true", help="the measured logs too")
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--store", type=Path, default=Path("false_alarms.jsonl"))
    options = parser.parse_args()
    if unknown := set(options.robots) - set(PLANTS):
        parser.error(f"there is no robot {', '.join(unknown)}; choose from {', '.join(PLANTS)}")
    done = [json.loads(line) for line in options.store.read_text().splitlines()] if options.store.exists() else []
    stands = {(each["robot"], each["seed"]) for each in done}
    todo = [(robot, seed) for seed in range(options.seeds) for robot in options.robots]
    with threadpool_limits(1, "blas"), options.store.open("a", encoding="utf-8") as store:

        def add(robot: str, seed: int, alarms: list[str]) -> None:
            done.append({"robot": robot, "seed": seed, "alarms": alarms})
            store.write(json.dumps(done[-1]) + "\n")
            store.flush()
            if alarms:
                print(f"{robot} {seed}: {'; '.join(alarms)}", flush=True)

        for robot, seed in todo:
            if (robot, seed) not in stands:
                add(robot, seed, simulated(robot, seed))
        for entry in zoo.ENTRIES if options.real else ():
            if (f"{entry.name}, measured", 0) not in stands:
                add(f"{entry.name}, measured", 0, measured(entry, options.data))
    for robot in sorted({each["robot"] for each in done}):
        mine = [each for each in done if each["robot"] == robot]
        print(f"{robot}: {sum(bool(each['alarms']) for each in mine)} of {len(mine)}")
    made = [each for each in done if each["robot"] in PLANTS]
    with_alarm = sum(bool(each["alarms"]) for each in made)
    bound = beta.ppf(0.95, with_alarm + 1, len(made) - with_alarm) if made else float("nan")
    print(f"{with_alarm} of {len(made)} simulated experiments with an alarm: at most {100 * bound:.2g} %")
    print(Counter(alarm.split(":")[0] for each in made for alarm in each["alarms"]))


if __name__ == "__main__":
    main()
