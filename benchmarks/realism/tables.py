"""The tables of docs/evidence/index.md, and the CSV files in coverage, from the store of experiments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from table import write_csv

from gtau.findings import Grade
from realism.departures import DEPARTURES, EFFECTS, MOTIONS
from realism.plants import PLANTS

ACCURACY = 0.03
NONE = "none"
COLUMNS = ("worst error, %", "rms z", "intervals with the truth", "good", "wrong good", "contradictory")


@dataclass(frozen=True, eq=False)
class Gains:
    """Gains pooled over experiments, (k,) each: relative error, its z, whether intervals hold, and outcomes.

    Errors and intervals are those of gains that are good or weak: of the others users are told not to take the number.
    """

    error: np.ndarray
    z: np.ndarray
    holds: np.ndarray
    random_holds: np.ndarray
    good: np.ndarray
    contradictory: int
    lost: int

    @property
    def silent(self) -> np.ndarray:
        """Good, and off by more than the accuracy."""
        return self.good & (np.abs(self.error) > ACCURACY)

    def row(self) -> list[str]:
        """Cells of COLUMNS."""
        shown = [""] * 3
        if len(self.error):
            shown = [f"{100 * np.abs(self.error).max():.2g}", f"{rms(self.z):.2f}", count(self.holds)]
        return [*shown, *(str(number) for number in (self.good.sum(), self.silent.sum(), self.contradictory))]


def pooled(records: Sequence[dict]) -> Gains:
    gains = [gain for record in records for gain in record["gains"]]
    outcomes = [gain["outcome"] for gain in gains]
    gains = [gain for gain in gains if gain["outcome"] in (Grade.GOOD, Grade.WEAK)]
    value, truth, truth_std, std, low, high, half = (
        np.array([gain[key] for gain in gains], dtype=float)
        for key in ("value", "truth", "truth_std", "std", "low", "high", "random_half")
    )
    return Gains(
        value / truth - 1,
        (value - truth) / np.hypot(std, truth_std),
        (low < truth) & (truth < high),
        np.abs(value - truth) < half,
        np.array([gain["outcome"] == Grade.GOOD for gain in gains], dtype=bool),
        outcomes.count(Grade.CONTRADICTORY),
        outcomes.count(Grade.NOT_IDENTIFIABLE),
    )


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def share(hits: np.ndarray) -> str:
    return f"{100 * hits.mean():.1f} %"


def count(hits: np.ndarray) -> str:
    return f"{hits.sum()} of {len(hits)}"


def page(records: Sequence[dict]) -> str:
    """Return the goals and one table, as Markdown."""
    real = [record for record in records if record["departure"] not in DEPARTURES | MOTIONS]
    moved = [record for record in records if record["departure"] in MOTIONS]
    made = [record for record in records if record["departure"] in DEPARTURES]
    parts = [goals(made, real)] if made else []
    if made:
        parts.append(notable(made))
    if moved:
        parts.append(of_motions(moved))
    return "\n\n".join(part for part in parts if part) + "\n"


def write_files(records: Sequence[dict], folder: Path) -> None:
    """Write what the page leaves out: every defect, by robot too, missed intervals and refusals, and pairs of logs."""
    made = [record for record in records if record["departure"] in DEPARTURES]
    real = [record for record in records if record["departure"] not in DEPARTURES | MOTIONS]
    folder.mkdir(exist_ok=True)
    tables = {"defects": by_departure(made), "defects-by-robot": by_robot(made)}
    tables |= {"missed": missed(made), "pairs": of_pairs(real)}
    for name, lines in tables.items():
        if len(lines) > 1:
            write_csv(folder / f"{name}.csv", lines)


def _where(records: Sequence[dict], keep) -> Gains:
    return pooled([record for record in records if keep(DEPARTURES[record["departure"]], record["departure"])])


def goals(made: Sequence[dict], real: Sequence[dict]) -> str:
    """Return the headline: all rows count; "visible in the data" leaves out what no data show."""
    clean = _where(made, lambda _, name: name == NONE)
    both = made, [record for record in made if not DEPARTURES[record["departure"]].invisible]
    logs, shown = (_where(each, lambda departure, name: name != NONE and not departure.wrong) for each in both)
    wrong, shown_wrong = (_where(each, lambda departure, _: departure.wrong) for each in both)
    every, seen = (_where(each, lambda _, name: name != NONE) for each in both)
    lines = ["| what | goal | all | visible in the data |", "| --- | --- | --- | --- |"]
    if len(clean.z):
        lines += [
            f"| no defects: random-error intervals contain the truth | 93 to 97 % | {hits(clean.random_holds)} | |",
            f"| no defects: full intervals contain the truth | | {hits(clean.holds)}, rms z {rms(clean.z):.2f} | |",
            f"| no defects: contradictory gains | none | {clean.contradictory} | |",
        ]
    if len(logs.z):
        lines += [
            f"| faulty logs or drives: intervals contain the truth | at least 90 % | {hits(logs.holds)}, "
            f"rms z {rms(logs.z):.2f} | {hits(shown.holds)}, rms z {rms(shown.z):.2f} |",
            f"| faulty logs or drives: contradictory gains | none | {logs.contradictory} | {shown.contradictory} |",
        ]
    if len(wrong.z):
        lines.append(
            f"| wrong description: intervals contain the truth | | {hits(wrong.holds)} | {hits(shown_wrong.holds)} |"
        )
    if len(every.z):
        lines.append(
            f"| wrong 'good' verdicts (error above 3 %) | under 2 % where visible | {hits(every.silent)} | "
            f"{hits(seen.silent)} |"
        )
    if real:
        pairs, alarms = pooled(real), [_alarms(record) for record in real]
        days = pooled([record for record in real if record["departure"].startswith("UR10e")])
        lines += [
            f"| pairs of measured logs: contradictory gains | none | {sum(alarms)} | |",
            f"| pairs of measured logs: rms z of the differences | 0.8 to 1.2 | {rms(pairs.z):.2f} of all "
            f"{len(pairs.z)}, UR10e {rms(days.z):.2f} | |",
        ]
    return "\n".join(lines)


def hits(of: np.ndarray) -> str:
    return f"{share(of)}, {count(of)}"


def by_departure(made: Sequence[dict]) -> list[list[str]]:
    """One row a departure, all robots together."""
    shown = [0, 1, 2, 4]  # of COLUMNS; all of them are in the file by robot
    lines = [["defect", *(COLUMNS[k] for k in shown)]]
    for name in DEPARTURES:
        mine = [record for record in made if record["departure"] == name]
        if mine:
            row = pooled(mine).row()
            lines.append([name, *(row[k] for k in shown)])
    return lines


def widths(made: Sequence[dict]) -> list[list[str]]:
    """One row a departure: do intervals hold, and are they no wider than the errors need."""
    lines = [["defect", "gains", "hold, %", "rms z", "rms error, %", "median error, %", "half width over need"]]
    for name in (*EFFECTS, "all"):
        mine = pooled([record for record in made if name in (record["departure"], "all")])
        if len(mine.z):
            error, std = mine.error, np.abs(mine.error / mine.z)
            lines.append([name, str(len(error)), f"{100 * mine.holds.mean():.1f}", f"{rms(mine.z):.2f}",
                          f"{100 * rms(error):.3f}", f"{100 * np.median(np.abs(error)):.3f}",
                          f"{rms(std) / rms(error):.2f}"])  # fmt: skip
    return lines


def notable(made: Sequence[dict]) -> str:
    """Show the departures under which fewer than nine in ten intervals hold."""
    head, *rows = by_departure(made)
    rows = [row for row in rows if (held := row[3].split(" of "))[1:] and int(held[0]) < 0.9 * int(held[1])]
    return "\n".join(f"| {' | '.join(row)} |" for row in [head, ["---", *["---:"] * (len(head) - 1)], *rows])


def missed(made: Sequence[dict]) -> list[list[str]]:
    """List missed intervals, wrong 'good' verdicts and refusals."""
    lines = [["experiment", "defect", "joint", "error, %", "outcome", "refusal"]]
    for name, departure in DEPARTURES.items():
        for record in made:
            if record["departure"] == name and not departure.invisible:
                which = [f"{record['robot']} {record['seed']}", name]
                lines += [[*which, "", "", "refused", record["refusal"]]] if record["refusal"] else []
                lines += [[*which, *_miss(gain), ""] for gain in record["gains"] if _is_missed(gain)]
    return lines


def _off(gain: dict) -> float:
    return abs(gain["value"] / gain["truth"] - 1)


def _is_missed(gain: dict) -> bool:
    silent = gain["outcome"] == Grade.GOOD and _off(gain) > ACCURACY
    believed = gain["outcome"] in (Grade.GOOD, Grade.WEAK)
    return silent or (believed and not gain["low"] < gain["truth"] < gain["high"])


def _miss(gain: dict) -> list[str]:
    half = 50 * (gain["high"] - gain["low"]) / abs(gain["value"])
    return [gain["joint"], f"{100 * _off(gain):.2g} ± {half:.2g}", gain["outcome"]]


def by_robot(made: Sequence[dict]) -> list[list[str]]:
    """One row a robot and departure; intervals as two numbers."""
    worst, z, holds, *rest = COLUMNS
    lines = [["robot", "defect", worst, z, holds, "intervals", *rest, "not identifiable"]]
    for robot in PLANTS:
        for name in DEPARTURES:
            mine = [record for record in made if (record["robot"], record["departure"]) == (robot, name)]
            if mine:
                gains = pooled(mine)
                error, spread, _, *counts = gains.row()
                held = [str(gains.holds.sum()), str(len(gains.holds))]
                lines.append([robot, name, error, spread, *held, *counts, str(gains.lost)])
    return lines


def _alarms(record: dict) -> int:
    return sum(
        outcome == Grade.CONTRADICTORY
        for gain in record["gains"]
        for outcome in (gain["outcome"], gain["second_outcome"])
    )


def of_motions(moved: Sequence[dict]) -> str:
    """One row for what differs from the model, by whether runs repeat a motion."""
    lines = [
        "| what | random part holds | rms z | half-width, % | both parts hold | rms z | half-width, % |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for name in MOTIONS:
        gains = [gain for each in moved if each["departure"] == name for gain in each["gains"]]
        gains = [gain for gain in gains if gain["outcome"] in (Grade.GOOD, Grade.WEAK)]
        if gains:
            error, std, random_std, random, low, high, truth = (
                np.array([gain[key] for gain in gains], dtype=float)
                for key in ("value", "std", "random_std", "random_half", "low", "high", "truth")
            )
            error = error - truth
            width, wide = (np.exp(np.mean(np.log(each / np.abs(truth)))) for each in (random, (high - low) / 2))
            lines.append(
                f"| {name} | {share(np.abs(error) < random)}, {len(gains)} | {rms(error / random_std):.2f} | "
                f"{100 * width:.2g} | {share((low < truth) & (truth < high))} | {rms(error / std):.2f} | "
                f"{100 * wide:.2g} |"
            )
    return "\n".join(lines)


def of_pairs(real: Sequence[dict]) -> list[list[str]]:
    lines = [["logs", "differences of the gains, %", "z", "rms z", "contradictory"]]
    for record in real:
        gains = pooled([record])
        differences = ", ".join(f"{100 * error:+.2g}" for error in gains.error)
        z = ", ".join(f"{value:+.1f}" for value in gains.z)
        lines.append([record["departure"], differences, z, f"{rms(gains.z):.2f}", str(_alarms(record))])
    return lines
