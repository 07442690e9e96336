"""Findings on pages: what is said of many logs is said once."""

from __future__ import annotations

from dataclasses import replace

import pytest

from gtau.report.findings import APART, same_in_several
from gtau.signals.notes import Kind, Note


def interpolated(count: int) -> list[Note]:
    """A note of each of so many logs, the last one the worst."""
    note = Note(Kind.REPAIR, "", "log at a regular rate")
    return [
        replace(note, what=f"{k + 1} samples were interpolated", source=f"log {k}", share=0.01 * k, time=1.0 * k)
        for k in range(count)
    ]


def test_many_notes_of_one_kind_are_one() -> None:
    (merged,) = same_in_several(interpolated(40))
    assert (merged.what, merged.source) == ("40 samples were interpolated", "log 39 and 39 more")
    assert merged.time is None


def test_few_are_listed_one_by_one() -> None:
    assert same_in_several(interpolated(APART)) == interpolated(APART)


@pytest.mark.parametrize("changed", [{"joint": "left"}, {"action": "log faster"}, {"kind": Kind.NOISE}, {"source": ""}])
def test_notes_of_other_kinds_joints_and_actions_stay_apart(changed: dict) -> None:
    """As do those on no log: they are on all of them."""
    other = replace(interpolated(1)[0], what="another", **changed)
    found = same_in_several([*interpolated(40), other])
    assert other in found
    assert len(found) == 2


def test_equal_notes_list_their_logs() -> None:
    notes = [replace(note, what="the same") for note in interpolated(6)]
    (merged,) = same_in_several(notes)
    assert merged.source == ", ".join(f"log {k}" for k in range(6))
