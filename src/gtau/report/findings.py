"""Show findings: repairs, omissions, warnings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from gtau.findings import Finding
from gtau.findings.finding import by_severity
from gtau.findings.words import moment
from gtau.report.page import Column, Kind, Section, Table, Text, joint_label, section, table

APART = 4  # most findings of one kind on different logs that are listed one by one


def findings_section(notes: Sequence[Finding], most: int | None = None) -> Section:
    """List findings, the worst first, at most ``most`` of them."""
    shown = findings_table(notes, most)
    nothing = Text("Nothing was repaired, left out or flagged.")
    return section("Findings", shown if shown.rows else nothing, id="notes")


def findings_table(notes: Sequence[Finding], most: int | None = None) -> Table:
    """Tabulate findings, the worst first, at most ``most`` of them."""
    rows = [
        (grade.value, note.source, _where(note), note.what, note.advice)
        for grade, members in by_severity(same_in_several(notes)).items()
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


def _where(note: Finding) -> str:
    """Describe joint, time and share of samples of a finding, as far as known."""
    share = None if note.share is None else f"{100 * note.share:.2g} % of the samples"
    time = None if note.time is None else moment(note.time, 4)
    return ", ".join(part for part in (note.joint and joint_label(note.joint), time, share) if part)


def same_in_several(notes: Sequence[Finding]) -> list[Finding]:
    """Merge equal findings on several logs, and findings of one kind on many logs into the worst, without time."""
    alike: dict[tuple[str, str], list[Finding]] = {}
    for note in notes:
        alike.setdefault((note.what, note.advice), []).append(note)
    groups: dict[tuple[str, ...], list[Finding]] = {}
    for same in alike.values():
        sources = ", ".join(dict.fromkeys(note.source for note in same if note.source))
        note = replace(same[0], source=sources, time=None) if len(same) > 1 else same[0]
        groups.setdefault((note.kind, note.joint, note.advice), []).append(note)
    merged = []
    for group in groups.values():
        on_logs = [note for note in group if note.source]
        if len(on_logs) > APART:
            worst = max(on_logs, key=lambda note: note.share or 0.0)
            merged.append(replace(worst, source=f"{worst.source} and {len(on_logs) - 1} more", time=None))
            group = [note for note in group if not note.source]
        merged += group
    return merged
