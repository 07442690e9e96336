"""The tables of docs/evidence/coverage.md from the store of experiments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gtau.estimation.diagnostics.verdict import Outcome
from realism.departures import DEPARTURES, MOTIONS
from realism.plants import PLANTS

ACCURACY = 0.03
NONE = "none"
COLUMNS = "worst error, % | rms z | 95 % intervals that hold | good | good and off | contradictory | not identifiable"
RULE = " | ".join(7 * ["---:"])


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

    def row(self) -> str:
        if len(self.error):
            believed = f"{100 * np.abs(self.error).max():.2g} | {rms(self.z):.2f} | {count(self.holds)}"
        else:
            believed = "| | "
        return f"{believed} | {self.good.sum()} | {self.silent.sum()} | {self.contradictory} | {self.lost}"


def pooled(records: Sequence[dict]) -> Gains:
    gains = [gain for record in records for gain in record["gains"]]
    outcomes = [gain["outcome"] for gain in gains]
    gains = [gain for gain in gains if gain["outcome"] in (Outcome.GOOD, Outcome.WEAK)]
    value, truth, truth_std, std, low, high, half = (
        np.array([gain[key] for gain in gains], dtype=float)
        for key in ("value", "truth", "truth_std", "std", "low", "high", "random_half")
    )
    return Gains(
        value / truth - 1,
        (value - truth) / np.hypot(std, truth_std),
        (low < truth) & (truth < high),
        np.abs(value - truth) < half,
        np.array([gain["outcome"] == Outcome.GOOD for gain in gains], dtype=bool),
        outcomes.count(Outcome.CONTRADICTORY),
        outcomes.count(Outcome.NOT_IDENTIFIABLE),
    )


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def share(hits: np.ndarray) -> str:
    return f"{100 * hits.mean():.1f} %"


def count(hits: np.ndarray) -> str:
    return f"{hits.sum()} of {len(hits)}"


def page(records: Sequence[dict]) -> str:
    """All tables, as Markdown."""
    real = [record for record in records if record["departure"] not in DEPARTURES | MOTIONS]
    moved = [record for record in records if record["departure"] in MOTIONS]
    made = [record for record in records if record["departure"] in DEPARTURES]
    parts = [goals(made, real)] if made else []
    if made:
        parts += [by_departure(made), missed(made), by_robot(made)]
    if real:
        parts.append(of_pairs(real))
    if moved:
        parts.append(of_motions(moved))
    return "\n\n".join(part for part in parts if part) + "\n"


def _where(records: Sequence[dict], keep) -> Gains:
    return pooled([record for record in records if keep(DEPARTURES[record["departure"]], record["departure"])])


def goals(made: Sequence[dict], real: Sequence[dict]) -> str:
    clean = _where(made, lambda _, name: name == NONE)
    both = made, [record for record in made if not DEPARTURES[record["departure"]].invisible]
    logs, shown = (_where(each, lambda departure, name: name != NONE and not departure.wrong) for each in both)
    wrong, shown_wrong = (_where(each, lambda departure, _: departure.wrong) for each in both)
    every, seen = (_where(each, lambda _, name: name != NONE) for each in both)
    lines = ["| what | goal | measured |", "| --- | --- | --- |"]
    if len(clean.z):
        lines += [
            f"| nothing departs: intervals of the random part hold | 93 to 97 % | {share(clean.random_holds)}, "
            f"{count(clean.random_holds)} |",
            f"| the same, of both parts | | {share(clean.holds)}, rms z {rms(clean.z):.2f} |",
            f"| the same, contradictory gains | none | {clean.contradictory} |",
        ]
    if len(logs.z):
        lines += [
            f"| logs or drives depart: intervals hold | at least 90 % | {share(logs.holds)}, {count(logs.holds)}, "
            f"rms z {rms(logs.z):.2f} |",
            f"| the same, without what no data show | | {share(shown.holds)}, {count(shown.holds)}, "
            f"rms z {rms(shown.z):.2f} |",
            f"| the same, contradictory gains | none | {logs.contradictory} |",
        ]
    if len(wrong.z):
        lines += [
            f"| a description is wrong: intervals hold | | {share(wrong.holds)}, {count(wrong.holds)} |",
            f"| the same, without what no data show | | {share(shown_wrong.holds)}, {count(shown_wrong.holds)} |",
        ]
    if len(every.z):
        lines += [
            f"| good and off by more than 3 % | | {share(every.silent)}, {count(every.silent)} |",
            f"| the same, without what no data show | under 2 % | {share(seen.silent)}, {count(seen.silent)} |",
        ]
    if real:
        pairs, alarms = pooled(real), [_alarms(record) for record in real]
        lines += [
            f"| pairs of logs: contradictory gains | none | {sum(alarms)} |",
            f"| pairs of logs: rms z of the differences | 0.8 to 1.2 | {rms(pairs.z):.2f} of all {len(pairs.z)}, "
            f"UR10e {rms(pooled(real[:1]).z):.2f} |",
        ]
    return "\n".join(lines)


def by_departure(made: Sequence[dict]) -> str:
    """One row a departure, all robots together."""
    lines = [f"| departure | {COLUMNS} | refused |", f"| --- | {RULE} | ---: |"]
    for name in DEPARTURES:
        mine = [record for record in made if record["departure"] == name]
        if mine:
            refused = sum(bool(record["refusal"]) for record in mine)
            lines.append(f"| {name} | {pooled(mine).row()} | {refused or ''} |")
    return "\n".join(lines)


def missed(made: Sequence[dict]) -> str:
    """Which gains the intervals miss, which are good and off, what was refused, and what no data show."""
    lines = []
    for name, departure in DEPARTURES.items():
        for record in made:
            if record["departure"] == name and not departure.invisible:
                which = f"| {record['robot']} {record['seed']} | {name}"
                lines += [f"{which} | refused: {record['refusal']} | | |"] if record["refusal"] else []
                lines += [f"{which} | {_miss(gain)} |" for gain in record["gains"] if _is_missed(gain)]
    table = [
        "Gains whose interval does not hold the truth or that are good and off, and what was refused:",
        "",
        "| experiment | departure | joint | off by, % | outcome |",
        "| --- | --- | --- | ---: | --- |",
        *lines,
        "",
    ]
    invisible = [f"- {name}: {each.invisible}." for name, each in DEPARTURES.items() if each.invisible]
    return "\n".join([*(table if lines else []), "What no data show:", "", *invisible])


def _off(gain: dict) -> float:
    return abs(gain["value"] / gain["truth"] - 1)


def _is_missed(gain: dict) -> bool:
    silent = gain["outcome"] == Outcome.GOOD and _off(gain) > ACCURACY
    believed = gain["outcome"] in (Outcome.GOOD, Outcome.WEAK)
    return silent or (believed and not gain["low"] < gain["truth"] < gain["high"])


def _miss(gain: dict) -> str:
    half = 50 * (gain["high"] - gain["low"]) / abs(gain["value"])
    return f"{gain['joint']} | {100 * _off(gain):.2g} ± {half:.2g} | {gain['outcome']}"


def by_robot(made: Sequence[dict]) -> str:
    """One row a robot, and all rows in a fold."""
    robots = [robot for robot in PLANTS if any(record["robot"] == robot for record in made)]
    lines = [f"| robot | experiments | processor s each | {COLUMNS} |", f"| --- | ---: | ---: | {RULE} |"]
    for robot in robots:
        mine = [record for record in made if record["robot"] == robot]
        seen = [record for record in mine if not DEPARTURES[record["departure"]].invisible]
        seconds = np.median([record["seconds"] for record in mine])
        lines.append(f"| {robot} | {len(mine)} | {seconds:.1f} | {pooled(seen).row()} |")
    lines += ["", "<details><summary>Every robot and departure</summary>", ""]
    lines += [f"| robot | departure | {COLUMNS} |", f"| --- | --- | {RULE} |"]
    for robot in robots:
        for name in DEPARTURES:
            mine = [record for record in made if (record["robot"], record["departure"]) == (robot, name)]
            if mine:
                lines.append(f"| {robot} | {name} | {pooled(mine).row()} |")
    return "\n".join([*lines, "", "</details>"])


def _alarms(record: dict) -> int:
    return sum(
        outcome == Outcome.CONTRADICTORY
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
        gains = [gain for gain in gains if gain["outcome"] in (Outcome.GOOD, Outcome.WEAK)]
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


def of_pairs(real: Sequence[dict]) -> str:
    lines = ["| logs | differences of the gains, % | z | rms z | contradictory |", "| --- | --- | --- | ---: | ---: |"]
    for record in real:
        found = pooled([record])
        lines.append(
            f"| {record['departure']} | {', '.join(f'{100 * each:+.2g}' for each in found.error)} | "
            f"{', '.join(f'{each:+.1f}' for each in found.z)} | {rms(found.z):.2f} | {_alarms(record)} |"
        )
    return "\n".join(lines)
