"""Show findings (repairs, omissions, warnings) as a section of a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from gtau.findings import Finding
from gtau.findings.finding import by_severity
from gtau.report.page import Column, Kind, Section, Table, Text, joint_label, section, table

APART = 4  # notes of one kind on different logs that are still listed one by one


def findings_section(notes: Sequence[Finding], most: int | None = None) -> Section:
    """List notes, the worst first, at most ``most`` of them."""
    shown = findings_table(notes, most)
    nothing = Text("Nothing was repaired, left out or flagged.")
    return section("Findings", shown if shown.rows else nothing, id="notes")


def findings_table(notes: Sequence[Finding], most: int | None = None) -> Table:
    """Tabulate notes, the worst first, at most ``most`` of them."""
    rows = [
        (grade.value, note.source, _where(note), note.what, note.action)
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
    """Describe where in a log a finding is: joint, time and size, as far as they are known."""
    share = None if note.share is None else f"{100 * note.share:.2g} % of the samples"
    time = None if note.time is None else f"{note.time:.4g} s"
    return ", ".join(part for part in (note.joint and joint_label(note.joint), time, share) if part)


def same_in_several(notes: Sequence[Finding]) -> list[Finding]:
    """Merge notes that say the same of several logs, with whatever numbers where many logs have one.

    They keep no time, as each log has its own.
    """
    groups: dict[tuple[str, str], list[Finding]] = {}
    for note in notes:
        groups.setdefault((note.what, note.action), []).append(note)
    return _of_one_kind([_merged(group) for group in groups.values()])


def _merged(group: Sequence[Finding]) -> Finding:
    if len(group) == 1:
        return group[0]
    return replace(group[0], source=", ".join(dict.fromkeys(each.source for each in group if each.source)), time=None)


def _of_one_kind(notes: Sequence[Finding]) -> list[Finding]:
    """Merge notes of one kind that ask for the same, where there are more than ``APART`` of them: the worst counts."""
    groups: dict[tuple[str, ...], list[Finding]] = {}
    for note in notes:
        groups.setdefault((note.kind, note.joint, note.action), []).append(note)
    found = []
    for group in groups.values():
        of_logs = [note for note in group if note.source]
        if len(of_logs) <= APART:
            found += group
            continue
        worst = max(of_logs, key=lambda note: note.share or 0.0)
        found.append(replace(worst, source=f"{worst.source} and {len(of_logs) - 1} more", time=None))
        found += [note for note in group if not note.source]
    return found
