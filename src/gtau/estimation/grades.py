"""Severity of findings: the one place that grades notes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import StrEnum
from typing import Any

from gtau.estimation.thresholds.logs import COSTLY_REPAIR
from gtau.signals.notes import Kind, Note


class Grade(StrEnum):
    """Severity of a finding, the worst first."""

    ERROR = "error"
    WARNING = "warning"
    INFORMATION = "information"


GRADES: Mapping[Kind, Grade] = {
    Kind.REFUSED: Grade.ERROR,
    Kind.ROWS: Grade.ERROR,
    Kind.SCALE: Grade.ERROR,
    Kind.VALIDATION: Grade.WARNING,
    Kind.SEPARATION: Grade.WARNING,
    Kind.MODEL: Grade.WARNING,
    Kind.CLIPPED: Grade.WARNING,
    Kind.FILTERED: Grade.WARNING,
    Kind.HELD: Grade.WARNING,
    Kind.NOISE: Grade.WARNING,
    Kind.RATE: Grade.WARNING,
    Kind.LIMITS: Grade.WARNING,
    Kind.UNIT: Grade.WARNING,
    Kind.SINGULARITY: Grade.WARNING,
    Kind.GEOMETRY: Grade.WARNING,
    Kind.REPAIR: Grade.INFORMATION,
    Kind.WEIGHING: Grade.INFORMATION,
    Kind.DRAFT: Grade.INFORMATION,
    Kind.READING: Grade.INFORMATION,
    Kind.REST: Grade.INFORMATION,
    Kind.ROBOT: Grade.INFORMATION,
    Kind.DATA_SHEET: Grade.INFORMATION,
}
"""Grade of each kind of note."""

EXIT_CODES: Mapping[Grade, int] = {Grade.ERROR: 2, Grade.WARNING: 3, Grade.INFORMATION: 0}
"""Exit code of ``gtau check`` by the worst grade; 0 without findings."""


def grade_of(note: Note) -> Grade:
    """Grade a note by its kind, and repairs by the share of samples lost."""
    if note.kind == Kind.REPAIR and (note.share or 0.0) > COSTLY_REPAIR:
        return Grade.WARNING
    return GRADES[note.kind]


def by_grade(notes: Iterable[Note]) -> dict[Grade, list[Note]]:
    """Group notes by grade, the worst first, each sentence once; no grade without notes.

    Within a grade what may move an estimate most stands first, others in their order.
    """
    listed: dict[str, Note] = {}
    for note in sorted(notes, key=lambda note: -note.moves):
        listed.setdefault(str(note), note)
    found = {grade: [note for note in listed.values() if grade_of(note) == grade] for grade in Grade}
    return {grade: members for grade, members in found.items() if members}


def to_document(note: Note) -> dict[str, Any]:
    """Write a graded note as JSON: what, where (log or robot, joint, time in s, share of the samples), action."""
    return {
        "grade": grade_of(note).value,
        "kind": note.kind.value,
        "finding": note.finding or None,
        "source": note.source or None,
        "joint": note.joint or None,
        "time": note.time,
        "share": note.share,
        "what": note.what,
        "action": note.action or None,
    }
