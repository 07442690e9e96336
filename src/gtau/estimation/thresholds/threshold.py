"""A constant that decides an outcome, with the evidence for it."""

from __future__ import annotations


class Threshold(float):
    """A number that decides an outcome, and why it has its value."""

    statistic: str
    healthy: str
    faulty: str
    evidence: str

    def __new__(cls, value: float, statistic: str, healthy: str, faulty: str, evidence: str) -> Threshold:
        """Make the number and attach the evidence."""
        made = super().__new__(cls, value)
        made.statistic, made.healthy, made.faulty, made.evidence = statistic, healthy, faulty, evidence
        return made

    def __getnewargs__(self) -> tuple[float, str, str, str, str]:  # type: ignore[override]
        """Return the arguments with which copy and pickle rebuild the threshold."""
        return float(self), self.statistic, self.healthy, self.faulty, self.evidence


NONE = "not measured"
