"""What was repaired, left out or noticed, as a section of a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from gtau.estimation.grades import by_grade
from gtau.report.page import Column, Kind, Section, Table, Text, joint_label, section, table
from gtau.signals.notes import Note


def findings_section(notes: Sequence[Note], most: int | None = None) -> Section:
    """List notes, the worst first, at most ``most`` of them."""
    shown = findings_table(notes, most)
    nothing = Text("Nothing was repaired, left out or noticed.")
    return section("Findings", shown if shown.rows else nothing, id="notes")


def findings_table(notes: Sequence[Note], most: int | None = None) -> Table:
    """Tabulate notes, the worst first, at most ``most`` of them."""
    rows = [
        (grade.value, note.source, _where(note), note.what, note.action)
        for grade, members in by_grade(same_in_several(notes)).items()
        for note in members
    ]
    columns = (
        Column("grade", Kind.BADGE),
        Column("log or robot"),
        Column("where", wide=True),
        Column("what was found", Kind.SENTENCE),
        Column("what to do", Kind.SENTENCE),
    )
    return table(columns, rows[:most], listed=True)


def _where(note: Note) -> str:
    """Describe where in a log a finding is: joint, time and size, as far as they are known."""
    share = None if note.share is None else f"{100 * note.share:.2g} % of the samples"
    time = None if note.time is None else f"{note.time:.4g} s"
    return ", ".join(part for part in (note.joint and joint_label(note.joint), time, share) if part)


def same_in_several(notes: Sequence[Note]) -> list[Note]:
    """Merge notes that say the same of several logs; they keep no time, as each log has its own."""
    groups: dict[tuple[str, str], list[Note]] = {}
    for note in notes:
        groups.setdefault((note.what, note.action), []).append(note)
    return [
        replace(group[0], source=", ".join(dict.fromkeys(each.source for each in group if each.source)), time=None)
        if len(group) > 1
        else group[0]
        for group in groups.values()
    ]
