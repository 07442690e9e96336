"""How much each finding matters to an identification: the one place that grades notes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import StrEnum
from typing import Any

from gtau.estimation.thresholds.logs import COSTLY_REPAIR
from gtau.signals.notes import Kind, Note


class Grade(StrEnum):
    """How much a finding matters, the worst first."""

    STOPS = "stops the identification"
    MEND = "worth mending"
    INFORMATION = "for information"


GRADES: Mapping[Kind, Grade] = {
    Kind.REFUSED: Grade.STOPS,
    Kind.ROWS: Grade.STOPS,
    Kind.SCALE: Grade.STOPS,
    Kind.VALIDATION: Grade.MEND,
    Kind.SEPARATION: Grade.MEND,
    Kind.MODEL: Grade.MEND,
    Kind.CLIPPED: Grade.MEND,
    Kind.FILTERED: Grade.MEND,
    Kind.HELD: Grade.MEND,
    Kind.NOISE: Grade.MEND,
    Kind.RATE: Grade.MEND,
    Kind.LIMITS: Grade.MEND,
    Kind.UNIT: Grade.MEND,
    Kind.SINGULARITY: Grade.MEND,
    Kind.GEOMETRY: Grade.MEND,
    Kind.REPAIR: Grade.INFORMATION,
    Kind.READING: Grade.INFORMATION,
    Kind.REST: Grade.INFORMATION,
    Kind.ROBOT: Grade.INFORMATION,
    Kind.DATA_SHEET: Grade.INFORMATION,
}
"""Grade of each kind of note."""

EXIT_CODES: Mapping[Grade, int] = {Grade.STOPS: 2, Grade.MEND: 3, Grade.INFORMATION: 0}
"""Exit code of ``gtau check`` by the worst grade; 0 without findings."""


def grade_of(note: Note) -> Grade:
    """Grade a note: by its kind, and repairs by the share of the samples that they cost."""
    if note.kind == Kind.REPAIR and (note.share or 0.0) > COSTLY_REPAIR:
        return Grade.MEND
    return GRADES[note.kind]


def by_grade(notes: Iterable[Note]) -> dict[Grade, list[Note]]:
    """Group notes by grade, the worst first, each sentence once and in order; no grade without notes."""
    listed: dict[str, Note] = {}
    for note in notes:
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


def from_document(document: Mapping[str, Any]) -> Note:
    """Restore a note from the document that :func:`to_document` made."""
    return Note(
        Kind(document["kind"]),
        document["what"],
        document["action"] or "",
        source=document["source"] or "",
        joint=document["joint"] or "",
        time=document["time"],
        share=document["share"],
        finding=document["finding"] or "",
    )
