"""Findings on pages: what is said of many logs is said once."""

from __future__ import annotations

from dataclasses import replace

import pytest

from gtau.findings import Finding
from gtau.report.logs import APART, findings_section, same_in_several
from gtau.signals.reading.formats import repair

ADVICE = "log in the controller's own cycle"


def interpolated(count: int) -> list[Finding]:
    """A note of each of so many logs, the last one the worst."""
    return [
        repair("stale samples", 0.01 * k, f"{k + 1} samples are stale", ADVICE, time=1.0 * k).from_source(f"log {k}")
        for k in range(count)
    ]


def test_many_notes_of_one_kind_are_one() -> None:
    (merged,) = same_in_several(interpolated(40))
    assert (merged.what, merged.source) == (
        "40 samples are stale",
        "log 39 and 39 more",
    )
    assert merged.time is None


def test_few_are_listed_one_by_one() -> None:
    assert same_in_several(interpolated(APART)) == interpolated(APART)


@pytest.mark.parametrize("changed", [{"joints": ("left",)}, {"kind": "held signal"}, {"source": ""}])
def test_notes_of_other_kinds_joints_and_actions_stay_apart(changed: dict) -> None:
    """As do those on no log: they are on all of them."""
    other = replace(interpolated(1)[0], **{"text": "another", **changed})
    found = same_in_several([*interpolated(40), other])
    assert other in found
    assert len(found) == 2


def test_equal_notes_list_their_logs() -> None:
    notes = [replace(note, text="the same") for note in interpolated(6)]
    (merged,) = same_in_several(notes)
    assert merged.source == ", ".join(f"log {k}" for k in range(6))


def test_without_notes_only_the_logs_are_said_to_be_in_order() -> None:
    """A verdict may stand above, of findings that are not listed again."""
    (said,) = findings_section(()).items
    assert said.words == "Nothing in the logs was repaired or left out."
