"""The page of a campaign: the next step, gains by round with both parts of their intervals, and rehearsals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from gtau.campaigns.campaign import MODEL_FILE, CampaignState
from gtau.campaigns.folder import DESIGN, Round
from gtau.report.chart import Chart, intervals
from gtau.report.page import Column, Kind, Page, Section, Table, Text, joint_label, table_of

Judged = tuple[Round, Mapping[str, Any]]  # a round and its decision
Style = Literal["good", "neutral", "weak", "bad"]
GRADES: Mapping[str, Style] = {"done": "good", "play": "neutral", "stopped": "weak", "blocked": "bad"}


def campaign_page(state: CampaignState) -> Page:
    """Show the state of a campaign."""
    decisions = [(round_, round_.decision) for round_ in state.rounds if not round_.aside]
    judged = [(round_, decision) for round_, decision in decisions if decision and decision["gains"]]
    decision = state.decision or {"say": "", "notes": ()}
    points = [decision["say"]] if state.next == "play" and decision["say"] else []
    points += decision["notes"]
    if state.next in ("done", "stopped"):
        points.append(f"the model is {judged[-1][0].folder / MODEL_FILE}; 'gtau validate' tests it on other logs")
    points += [f"round {round_.folder.name} is set aside: {round_.aside}" for round_ in state.rounds if round_.aside]
    verdict = Text(f"{state.say[0].upper()}{state.say[1:]}.", tuple(points), GRADES[state.next])
    return Page(
        f"Campaign in {state.folder}",
        Section("Next", verdict, id="next"),
        _gains(judged),
        _candidates(judged),
        _rehearsals(state.rounds),
        Section("Guards of the last motion", Text("", tuple(state.rounds[-1].motion["guards"])), id="guards"),
    )


def _gains(judged: list[Judged]) -> Section | None:
    """Tabulate and draw the gains after every round, from the logs of all rounds up to it."""
    if not judged:
        return None
    columns = (
        Column("joint"),
        Column("round"),
        Column("gain", Kind.NUMBER, 5),
        Column("unit"),
        Column("+-95 %", Kind.NUMBER, 2),
        Column("random", Kind.NUMBER, 2),
        Column("model", Kind.NUMBER, 2),
        Column("verdict", Kind.BADGE),
    )
    keys = ("value", "unit", "half_width", "random", "model", "verdict")
    rows = [
        (joint, round_.folder.name, *(gain[key] for key in keys))
        for joint in judged[-1][1]["gains"]
        for round_, decision in judged
        if (gain := decision["gains"].get(joint))
    ]
    now = judged[-1][1]["inputs"].items()
    changed = f"{DESIGN}, the accuracy, a log or the rounds set aside"
    earlier = [round_.folder.name for round_, decision in judged if not decision["inputs"].items() <= now]
    notes = tuple(f"round {name} was judged before a change of {changed}" for name in earlier)
    words = "+-: half the 95 % interval; random, model: standard deviations; % of the gain"
    return Section("Gains round by round", Table(columns, rows), Text(words, notes, "soft"), _chart(judged), id="gains")


def _chart(judged: list[Judged]) -> Chart | None:
    names, values, halves, inner = [], [], [], []
    for joint, final in judged[-1][1]["gains"].items():
        for round_, decision in judged:
            gain = decision["gains"].get(joint)
            if gain is None or not gain["value"] or not final["value"] or gain["half_width"] is None:
                continue
            names.append(f"{joint_label(joint)}, round {round_.number}")
            values.append(100 * (gain["value"] / final["value"] - 1))
            halves.append(gain["half_width"])
            inner.append(1.96 * (gain["random"] or 0.0))
    axis = "gain, % off the gain of the last round"
    return Chart((intervals(names, values, halves, axis, inner, zero=True),)) if names else None


def _candidates(judged: list[Judged]) -> Section | None:
    """Tabulate the motions simulated after the last round."""
    offered = judged[-1][1]["candidates"] if judged else []
    if not offered:
        return None
    columns = (Column("motion"), Column("widest interval then, +- %", Kind.NUMBER, 3), Column("payload at hand"))
    rows = [(motion["motion"], motion["half_width"], "yes" if motion["at_hand"] else "no") for motion in offered]
    return Section("Motions rehearsed", Table(columns, rows), id="candidates")


def _rehearsals(rounds: tuple[Round, ...]) -> Section:
    shown = table_of(
        [(round_, round_.motion["rehearsal"]) for round_ in rounds],
        (Column("round"), lambda pair: pair[0].folder.name),
        (Column("purpose"), lambda pair: pair[0].motion["purpose"]),
        (Column("played"), lambda pair: pair[0].played.end if pair[0].played else "not yet"),
        (Column("tool, m/s", Kind.NUMBER, 2), lambda pair: pair[1]["speed"]),
        (Column("at a tenth", Kind.NUMBER, 2), lambda pair: pair[1]["speed"] / 10),
        (Column("largest use of a limit, %", Kind.SHARE, decimals=0), lambda pair: pair[1]["used"]),
        (Column("of"), lambda pair: pair[1]["limit"]),
    )
    return Section("Rehearsals", shown, id="rehearsals")
