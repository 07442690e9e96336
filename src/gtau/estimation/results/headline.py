"""What can be believed of a result, in plain words."""

from __future__ import annotations

from collections.abc import Sequence

from gtau.estimation.diagnostics.sentences import percent_text
from gtau.estimation.diagnostics.verdict import Outcome
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.identified_model import IdentifiedModel

NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")


def headline(result: IdentifiedModel) -> str:
    """Say what can be believed of the drive gains: how many are known how well, and what is wrong with the others."""
    gains = list(result.drive_gains.values())
    if all(gain.verdict.outcome == Outcome.GIVEN for gain in gains):
        return (
            "The logs hold torques, so no drive gains were identified."
            if result.kind == "torque"
            else "The drive gains were given, not identified."
        )
    estimated = any(gain.std is not None for gain in gains)
    sentences = [_good(gains, result.statistics.get("accuracy", 0.0))] if estimated else []
    for outcome in (Outcome.CONTRADICTORY, Outcome.NOT_IDENTIFIABLE):
        sentences += [_sentence(outcome, *group) for group in _by_reason(gains, outcome)]
    accuracy = 100 * result.statistics.get("accuracy", 0.0)
    weak = [gain for gain in gains if gain.verdict.outcome == Outcome.WEAK]
    doubted = [gain for gain in weak if (gain.half_width or 0.0) <= accuracy]  # for what is wrong elsewhere
    sentences += _weak([gain for gain in weak if gain not in doubted], accuracy)
    sentences += [
        f"{_subject(members)} {'is' if len(members) == 1 else 'are'} in doubt: {why}; {advice}."
        for members, why, advice in _by_reason(doubted, Outcome.WEAK)
    ]
    remarks = [
        f"{_subject(members)}: {why}; {advice}." for members, why, advice in _by_reason(gains, Outcome.GOOD) if why
    ]
    return " ".join([*sentences, *remarks])


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
    """Say how well the weak gains are known, and what makes the worst of them uncertain."""
    if not gains:
        return []
    widths = [(gain.half_width or 0.0, gain) for gain in gains]
    known = [
        f"'{gain.name}'{'' if k else ' is known'} to +-{percent_text(width, accuracy)} %"
        for k, (width, gain) in enumerate(widths)
    ]
    listed = known[0] if len(known) == 1 else ", ".join(known[:-1]) + " and " + known[-1]
    worst = max(widths, key=lambda pair: pair[0])[1]
    return [f"{listed}. Joint '{worst.name}': {worst.verdict.why}; {worst.verdict.advice}."]


def _sentence(outcome: Outcome, gains: Sequence[Estimate], why: str, advice: str) -> str:
    said = {
        Outcome.CONTRADICTORY: "contradicts the description" if len(gains) == 1 else "contradict the description",
        Outcome.NOT_IDENTIFIABLE: "has no identifiable gain" if len(gains) == 1 else "have no identifiable gains",
    }[outcome]
    return f"{_subject(gains)} {said}: {why}; {advice}."


def _by_reason(gains: Sequence[Estimate], outcome: Outcome) -> list[tuple[list[Estimate], str, str]]:
    """Collect the gains of an outcome that share why and advice, so that these are said once."""
    reasons: dict[tuple[str, str], list[Estimate]] = {}
    for gain in gains:
        if gain.verdict.outcome == outcome:
            reasons.setdefault((gain.verdict.why, gain.verdict.advice), []).append(gain)
    return [(members, why, advice) for (why, advice), members in reasons.items()]


def _subject(gains: Sequence[Estimate]) -> str:
    names = " and ".join(", ".join(f"'{gain.name}'" for gain in gains).rsplit(", ", 1))
    return f"Joint {names}" if len(gains) == 1 else f"Joints {names}"


def _number(count: int) -> str:
    return NUMBERS[count] if count < len(NUMBERS) else str(count)
