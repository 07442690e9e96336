"""How much a finding matters."""

from __future__ import annotations

from enum import StrEnum


class Grade(StrEnum):
    """How much a finding matters: the outcomes of judging an estimate, the best first, and the severities of notes."""

    GIVEN = "given"
    GOOD = "good"
    INFORMATION = "information"
    WARNING = "warning"
    WEAK = "weak"
    NOT_IDENTIFIABLE = "not identifiable"
    CONTRADICTORY = "contradictory"
    ERROR = "error"

    @property
    def exit_code(self) -> int:
        """Exit code of ``gtau check`` where this is the worst finding."""
        return {Grade.ERROR: 2, Grade.WARNING: 3}.get(self, 0)

    @property
    def rank(self) -> int:
        """Its place among all grades, the worst last."""
        return list(Grade).index(self)


NOTES = (Grade.ERROR, Grade.WARNING, Grade.INFORMATION)
"""Severities of notes, the worst first."""
VERDICTS = (Grade.WEAK, Grade.NOT_IDENTIFIABLE, Grade.CONTRADICTORY)
"""Grades of findings that lower the verdict on an estimate."""
