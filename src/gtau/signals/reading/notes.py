"""Notes on how a log was read and what was repaired in it."""

from __future__ import annotations

from collections.abc import Sequence

from gtau.errors import quoted
from gtau.findings import Finding, Grade

COSTLY = 0.02
"""Share of the samples that a repair drops or interpolates, from which it is a warning: up to 0.001 in the shared logs,
except logs recorded by polling; 0.05 and more are refused. A choice between the two."""


def reading(kind: str, text: str, advice: str = "", joints: Sequence[str] = ()) -> Finding:
    """Note how a log was read."""
    return Finding(kind, tuple(joints), text=text, advice=advice, grade=Grade.INFORMATION, shown_as="reading")


def repair(
    kind: str, share: float, text: str, advice: str = "", joints: Sequence[str] = (), time: float | None = None
) -> Finding:
    """Note a repair of a ``share`` of the samples: a warning where it costs many of them."""
    grade = Grade.WARNING if share > COSTLY else Grade.INFORMATION
    return Finding(
        kind, tuple(joints), text=text, advice=advice, share=share, time=time, grade=grade, shown_as="repair"
    )


def listed(joints: Sequence[str]) -> str:
    """Write ``joint 'a'``, ``joints 'a' and 'b'``."""
    return f"joint{'s' * (len(joints) > 1)} {' and '.join(map(quoted, joints))}"
