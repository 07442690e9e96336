"""The section on findings: what was repaired, left out or noticed, by grade."""

from __future__ import annotations

from collections.abc import Sequence

from gtau.estimation.grades import by_grade
from gtau.estimation.results.summary import same_in_several
from gtau.report.html.document import Section
from gtau.report.html.elements import (
    Column,
    badge,
    paragraph,
    sentence,
    table,
    text,
)
from gtau.report.style import joint_label
from gtau.signals.notes import Note


def notes_section(notes: Sequence[Note]) -> Section:
    """List everything that was repaired, left out or noticed."""
    shown = findings_table(notes) or paragraph("Nothing was repaired, left out or noticed.")
    return Section("notes", "Findings", shown)


def findings_table(notes: Sequence[Note]) -> str:
    """Tabulate notes, the worst first; empty without notes."""
    rows = [
        [badge(grade.value), text(_where(note)), text(sentence(note.what)), text(note.action and sentence(note.action))]
        for grade, members in by_grade(same_in_several(notes)).items()
        for note in members
    ]
    columns = [Column("grade"), Column("where"), Column("what was found"), Column("what to do")]
    return table(columns, rows, css="findings") if rows else ""


def _where(note: Note) -> str:
    """Describe where a finding is: log or robot, joint, time and size, as far as they are known."""
    share = None if note.share is None else f"{100 * note.share:.2g} % of the samples"
    time = None if note.time is None else f"{note.time:.4g} s"
    return ", ".join(part for part in (note.source, note.joint and joint_label(note.joint), time, share) if part)
