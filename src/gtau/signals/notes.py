"""Notes on logs: sentences that know what they are about."""

from __future__ import annotations

from enum import StrEnum
from typing import Any


class Kind(StrEnum):
    """What a note is about; :mod:`gtau.estimation.grades` says how much each matters."""

    REFUSED = "refused"  # a log, or all of them together, cannot be used
    VALIDATION = "validation log"  # one that cannot be used
    ROWS = "usable rows"
    SCALE = "scale of the gains"
    SEPARATION = "separable parameters"
    MODEL = "model"  # what the data say against the model
    CLIPPED = "clipped command"
    FILTERED = "filtered command"
    HELD = "held signal"
    NOISE = "position noise"
    RATE = "sampling rate"
    LIMITS = "joint limits"
    SINGULARITY = "singularity"
    REPAIR = "repair"
    READING = "reading"  # how the log was read: its clock, its layout
    REST = "joint at rest"
    ROBOT = "robot description"
    DATA_SHEET = "data sheet"
    GEOMETRY = "geometry"  # what logged poses say against it


class Note(str):
    """A sentence without its full stop: what was found, and what to do about it.

    Attributes
    ----------
    kind : Kind
        What it is about.
    what, action : str
        The two parts of the sentence; ``action`` is empty where there is nothing to do.
    source : str
        Name of the run or robot, empty where the note is on all of them.
    joint : str
        Name of the joint, empty where the note is on none or several.
    time : float, optional
        Instant in the log, s.
    share : float, optional
        Share of the samples that it concerns.
    """

    kind: Kind
    what: str
    action: str
    source: str
    joint: str
    time: float | None
    share: float | None

    def __new__(
        cls,
        kind: Kind,
        what: str,
        action: str = "",
        *,
        source: str = "",
        joint: str = "",
        time: float | None = None,
        share: float | None = None,
    ) -> Note:
        """Put the sentence together."""
        note = super().__new__(cls, (f"{source}: " if source else "") + what + (f"; {action}" if action else ""))
        note.kind, note.what, note.action, note.source = kind, what, action, source
        note.joint, note.time, note.share = joint, time, share
        return note

    def __getnewargs_ex__(self) -> tuple[tuple[Any, ...], dict[str, Any]]:
        """Return the arguments with which copy and pickle rebuild the note."""
        where = {"source": self.source, "joint": self.joint, "time": self.time, "share": self.share}
        return (self.kind, self.what, self.action), where

    def of(self, source: str) -> Note:
        """Return the same note on a run or robot of this name."""
        what = f"{self.source}: {self.what}" if self.source else self.what
        return Note(self.kind, what, self.action, source=source, joint=self.joint, time=self.time, share=self.share)
