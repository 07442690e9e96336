"""Findings on pages: what is said of many logs is said once."""

from __future__ import annotations

from dataclasses import replace

import pytest

from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.report.findings import APART, same_in_several


def interpolated(count: int) -> list[Finding]:
    """A note of each of so many logs, the last one the worst."""
    return [
        Finding(
            F.STALE,
            values={"signal": "currents", "stale": k + 1},
            source=f"log {k}",
            time=1.0 * k,
            share=0.01 * k,
        )
        for k in range(count)
    ]


def test_many_notes_of_one_kind_are_one() -> None:
    (merged,) = same_in_several(interpolated(40))
    assert (merged.what, merged.source) == (
        "40 samples of the currents are stale (repeat the previous one): interpolated",
        "log 39 and 39 more",
    )
    assert merged.time is None


def test_few_are_listed_one_by_one() -> None:
    assert same_in_several(interpolated(APART)) == interpolated(APART)


@pytest.mark.parametrize("changed", [{"joints": ("left",)}, {"kind": F.HELD}, {"source": ""}])
def test_notes_of_other_kinds_joints_and_actions_stay_apart(changed: dict) -> None:
    """As do those on no log: they are on all of them."""
    other = replace(
        interpolated(1)[0], **{"values": {"what": "another", "action": "log in the controller's own cycle"}, **changed}
    )
    found = same_in_several([*interpolated(40), other])
    assert other in found
    assert len(found) == 2


def test_equal_notes_list_their_logs() -> None:
    notes = [replace(note, values={"what": "the same"}) for note in interpolated(6)]
    (merged,) = same_in_several(notes)
    assert merged.source == ", ".join(f"log {k}" for k in range(6))
