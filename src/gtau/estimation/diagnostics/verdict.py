"""Verdicts: whether a number can be believed, why not, and what to do about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import ceil, floor, log10

from gtau.estimation.thresholds.estimates import APART, WEAK_PARAMETER


class Outcome(StrEnum):
    """What can be said of an estimate."""

    GIVEN = "given"
    GOOD = "good"
    WEAK = "weak"
    NOT_IDENTIFIABLE = "not identifiable"
    CONTRADICTORY = "contradictory"


@dataclass(frozen=True)
class Verdict:
    """An outcome, why, and what to do."""

    outcome: Outcome
    why: str = ""
    advice: str = ""

    @property
    def sentence(self) -> str:
        """The verdict as one sentence, without its subject."""
        return self.outcome.value + (f": {self.why}; {self.advice}" if self.why else "")


@dataclass(frozen=True)
class Refutation:
    """What the data refute of the description of robot and logs: for which joints (by number), why, and what to do."""

    joints: tuple[int, ...]
    why: str
    advice: str


GIVEN, GOOD = Verdict(Outcome.GIVEN), Verdict(Outcome.GOOD)


def percent_text(share: float, accuracy: float | None = None) -> str:
    """Write a share (per cent) in two significant digits and at most two decimals, without the sign of per cent.

    A share that exceeds the ``accuracy`` (per cent) is rounded up where it would be rounded to it or below.
    """
    if 0 < share < 0.005:
        return "<0.01"
    decimals = min(max(1 - floor(log10(float(f"{share:.2g}"))), 0), 2) if share else 2
    shown = f"{share:.{decimals}f}"
    if accuracy is not None and share > accuracy >= float(shown):
        shown = f"{ceil(share * 10**decimals) / 10**decimals:.{decimals}f}"
    return shown


def parameter_verdict(value: float | None, std: float | None) -> Verdict:
    """Judge a parameter by its value and standard deviation."""
    if value is None:
        return Verdict(
            Outcome.NOT_IDENTIFIABLE,
            "these motions cannot separate it from the parameters listed before it",
            "add runs that move the joints in other ways",
        )
    if std is None:
        return GOOD
    if abs(value) < 2 * std:
        return Verdict(
            Outcome.NOT_IDENTIFIABLE,
            "it is within two standard deviations of zero",
            "treat it as small, or move its joint faster and further",
        )
    if std > WEAK_PARAMETER * abs(value):
        return Verdict(Outcome.WEAK, f"its standard deviation is {100 * std / abs(value):.0f} %", "add longer runs")
    return GOOD


def known_verdict(kind: str, declared: float, found: float, std: float, block: str) -> Verdict:
    """Judge a known parameter ``kind`` of a payload by its estimate from all else that is known."""
    if abs(found - declared) <= APART * std:
        return GOOD
    if kind == "m":
        return Verdict(
            Outcome.CONTRADICTORY,
            f"with the drive gains from the other payloads it weighs {found:.4g} +- {std:.2g} kg, not "
            f"{declared:.4g} kg",
            "weigh the payloads again; one of the masses is wrong, or a run carries another payload than declared",
        )
    return Verdict(
        Outcome.CONTRADICTORY,
        f"given its mass and all other data its {kind} is {found:.4g} +- {std:.2g} {block}, not {declared:.4g} {block}",
        f"check {kind} and the frame it is given in, that of the body that carries the payload, and the mass; or leave "
        f"{kind} out",
    )


def worst(verdicts: Mapping[str, Verdict] | Sequence[Verdict]) -> Outcome:
    """Return the worst outcome of several."""
    found = list(verdicts.values()) if isinstance(verdicts, Mapping) else list(verdicts)
    order = list(Outcome)
    return max((verdict.outcome for verdict in found), key=order.index, default=Outcome.GOOD)
