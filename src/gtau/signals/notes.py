"""Notes on logs and robots: finding, location, and remedy."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum


class Kind(StrEnum):
    """Subject of a note; :mod:`gtau.estimation.grades` says how much each matters."""

    REFUSED = "refused"  # a log, or all of them together, cannot be used
    VALIDATION = "validation log"  # one that cannot be used
    ROWS = "usable rows"
    SCALE = "scale of the gains"
    WEIGHING = "weighing"  # limits of logs without a payload of known mass
    SEPARATION = "separable parameters"
    MODEL = "model"  # evidence of the data against the model
    CLIPPED = "clipped command"
    FILTERED = "filtered command"
    HELD = "held signal"
    NOISE = "position noise"
    RATE = "sampling rate"
    LIMITS = "joint limits"
    UNIT = "unit"  # of commands or payloads, doubtful
    SINGULARITY = "singularity"
    REPAIR = "repair"
    DRAFT = "draft"  # assumptions of a drafted experiment file
    READING = "reading"  # how the log was read: its clock, its layout
    REST = "joint at rest"
    ROBOT = "robot description"
    DATA_SHEET = "data sheet"
    GEOMETRY = "geometry"  # evidence of logged poses against it


@dataclass(frozen=True)
class Note:
    """A finding with its remedy; as text, a sentence without its full stop.

    Attributes
    ----------
    kind : Kind
        Subject of the note.
    what, action : str
        The two parts of the sentence; ``action`` is empty where there is nothing to do.
    source : str
        Name of the run or robot, empty for a note on all of them.
    joint : str
        Name of the joint, empty where the note is on none or several.
    time : float, optional
        Instant in the log, s.
    share : float, optional
        Share of the samples that it concerns.
    finding : str
        Kind of the finding of a diagnosis that it states; empty for notes on logs and robots.
    moves : float
        By how many half widths of its 95 % interval it may move an estimate, where that is known.
    """

    kind: Kind
    what: str
    action: str = ""
    source: str = ""
    joint: str = ""
    time: float | None = None
    share: float | None = None
    finding: str = ""
    moves: float = 0.0

    def __str__(self) -> str:
        """Compose the sentence."""
        return (f"{self.source}: " if self.source else "") + self.what + (f"; {self.action}" if self.action else "")

    def of(self, source: str) -> Note:
        """Return the note with this run or robot as its source."""
        return replace(self, what=f"{self.source}: {self.what}" if self.source else self.what, source=source)
