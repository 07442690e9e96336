"""Summarise which results can be trusted, in plain words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gtau.estimation.diagnostics.sentences import percent_text
from gtau.estimation.diagnostics.verdict import Outcome
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.identified_model import IdentifiedModel
from gtau.estimation.results.torque_scale import torque_headline

RANKED = (Outcome.CONTRADICTORY, Outcome.NOT_IDENTIFIABLE, Outcome.WEAK, Outcome.GOOD, Outcome.GIVEN)
NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")


@dataclass(frozen=True)
class Reason:
    """Reason why gains are not good, or a remark on good ones, and advice: the same for all ``joints``."""

    outcome: Outcome
    joints: tuple[str, ...]
    why: str
    action: str


def headline(result: IdentifiedModel) -> str:
    """Summarise the gains: how many are known to which accuracy, and which contradict the description."""
    gains = list(result.drive_gains.values())
    if result.kind == "torque":
        return torque_headline(result)
    if all(gain.verdict.outcome == Outcome.GIVEN for gain in gains):
        return "The drive gains were given, not identified."
    accuracy = result.statistics.get("accuracy", 0.0)
    estimated = any(gain.std is not None for gain in gains)
    sentences = [_good(gains, accuracy)] if estimated else []
    for outcome in (Outcome.CONTRADICTORY, Outcome.NOT_IDENTIFIABLE):
        sentences += _sentence(outcome, [gain for gain in gains if gain.verdict.outcome == outcome])
    weak = [gain for gain in gains if gain.verdict.outcome == Outcome.WEAK]
    doubted = [gain for gain in weak if (gain.half_width or 0.0) <= 100 * accuracy]  # for what is wrong elsewhere
    sentences += _weak([gain for gain in weak if gain not in doubted], 100 * accuracy)
    if doubted:
        sentences.append(f"{_subject(doubted)} {'is' if len(doubted) == 1 else 'are'} in doubt.")
    return " ".join(sentences)


def reasons(result: IdentifiedModel) -> tuple[Reason, ...]:
    """List reasons and advice for the verdicts on gains, the worst first: joints with equal advice share a row."""
    groups: dict[tuple[Outcome, str, str], list[Estimate]] = {}
    for gain in sorted(result.drive_gains.values(), key=lambda gain: -(gain.half_width or 0.0)):
        found = gain.verdict.finding
        if found is not None:
            groups.setdefault((gain.verdict.outcome, found.kind, gain.verdict.advice), []).append(gain)
    ranked = sorted(groups.items(), key=lambda group: RANKED.index(group[0][0]))
    return tuple(
        Reason(outcome, tuple(gain.name for gain in members), _why(members), advice)
        for (outcome, _, advice), members in ranked
    )


def _why(gains: Sequence[Estimate]) -> str:
    """Give the reason for several gains; where the numbers differ, that of the first and worst."""
    whys = dict.fromkeys(gain.verdict.why for gain in gains)
    first = next(iter(whys))
    return first if len(whys) == 1 else f"{first} ('{gains[0].name}')"


def _good(gains: Sequence[Estimate], accuracy: float) -> str:
    good = [gain for gain in gains if gain.verdict.outcome == Outcome.GOOD]
    total = _number(len(gains))
    if len(good) == len(gains):
        widest = max(gain.half_width or 0.0 for gain in good)
        which = {1: "The drive gain is", 2: "Both drive gains are"}.get(len(gains), f"All {total} drive gains are")
        return f"{which} known to within {percent_text(widest)} % (95 % intervals)."
    if not good:
        return f"No drive gain is known to {100 * accuracy:g} %."
    verb = "is" if len(good) == 1 else "are"
    known = f"{_number(len(good))} of {total} drive gains {verb} known to {100 * accuracy:g} % (95 % intervals)."
    return known[0].upper() + known[1:]


def _weak(gains: Sequence[Estimate], accuracy: float) -> list[str]:
    """State the accuracy of the weak gains."""
    if not gains:
        return []
    known = [
        f"'{gain.name}'{'' if k else ' is known'} to +-{percent_text(gain.half_width or 0.0, accuracy)} %"
        for k, gain in enumerate(gains)
    ]
    return [(known[0] if len(known) == 1 else ", ".join(known[:-1]) + " and " + known[-1]) + "."]


def _sentence(outcome: Outcome, gains: Sequence[Estimate]) -> list[str]:
    if not gains:
        return []
    said = {
        Outcome.CONTRADICTORY: "contradicts the description" if len(gains) == 1 else "contradict the description",
        Outcome.NOT_IDENTIFIABLE: "has no identifiable gain" if len(gains) == 1 else "have no identifiable gains",
    }[outcome]
    return [f"{_subject(gains)} {said}."]


def _subject(gains: Sequence[Estimate]) -> str:
    names = " and ".join(", ".join(f"'{gain.name}'" for gain in gains).rsplit(", ", 1))
    return f"Joint {names}" if len(gains) == 1 else f"Joints {names}"


def _number(count: int) -> str:
    return NUMBERS[count] if count < len(NUMBERS) else str(count)
