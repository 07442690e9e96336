"""Findings of reading a log, of checking it and of judging a fit: one record, with its words; and progress reports."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from enum import StrEnum
from math import ceil, floor, log10
from typing import Any

from gtau.errors import quoted

MOST_PERCENT = 1000.0
"""Per cent, above which a size is none: what has it is no estimate, and no error of one."""
Progress = Callable[[str, int, int], None]
"""Called in long work with the stage, how much of it is done, and how much there is: 1 where its share is not known."""


def silent(stage: str, done: int, total: int) -> None:
    """Report no progress."""


class Grade(StrEnum):
    """How much a finding matters: the outcomes of judging an estimate, the best first, and the severities of notes."""

    GIVEN = "given"
    GOOD = "good"
    INFORMATION = "information"
    WARNING = "warning"
    WEAK = "weak"
    NOT_IDENTIFIABLE = "not identifiable"
    CONTRADICTORY = "contradictory"
    ERROR = "error"

    @property
    def exit_code(self) -> int:
        """Exit code of ``gtau check`` where this is the worst finding."""
        return {Grade.ERROR: 2, Grade.WARNING: 3}.get(self, 0)

    @property
    def rank(self) -> int:
        """Its place among all grades, the worst last."""
        return list(Grade).index(self)


# severities of notes, the worst first, and grades that lower the verdict on an estimate
NOTES = (Grade.ERROR, Grade.WARNING, Grade.INFORMATION)
VERDICTS = (Grade.WEAK, Grade.NOT_IDENTIFIABLE, Grade.CONTRADICTORY)


@dataclass(frozen=True)
class Finding:
    """One finding of a check; as text, a sentence without its full stop. The verdict on an estimate is one too.

    Attributes
    ----------
    kind : str
        What was found.
    joints : tuple of str
        Joints whose gains, delays, drives or columns it is about.
    subject : str
        Payload, sensor, parameter or body that it is about, where there is one.
    values : mapping
        Numbers that other code needs.
    causes : tuple of str
        Kinds of what explains it, such as the name of an effect; the best first.
    size : float
        By how many half widths of its 95 % interval it may move an estimate, where that is known; of notes alike the
        larger stands first.
    source : str
        Name of the run or robot, empty for a finding on all of them.
    time, share : float, optional
        Instant in the log, s, and share of the samples that it concerns.
    text, advice : str
        What was found, and what to do about it; empty where there is nothing to say. ``{own}`` in the text stands for
        ``own``, what differs from joint to joint, such as ``+-5.3 %``.
    grade : Grade
        How much it matters.
    shown_as : str
        What files show as its kind, where several kinds share it; the kind itself otherwise.
    """

    kind: str
    joints: tuple[str, ...] = ()
    subject: str = ""
    values: Mapping[str, Any] = field(default_factory=dict, hash=False)
    causes: tuple[str, ...] = ()
    size: float = 0.0
    source: str = ""
    time: float | None = None
    share: float | None = None
    text: str = ""
    advice: str = ""
    own: str = ""
    grade: Grade = Grade.WARNING
    shown_as: str = ""

    def __str__(self) -> str:
        """Compose the sentence; the grade where there is nothing to say."""
        source, advice = f"{self.source}: " * bool(self.source), f"; {self.advice}" * bool(self.advice)
        return source + (self.what or self.grade) + advice

    def __repr__(self) -> str:
        return f"Finding({self.grade}, '{self}')"

    @property
    def what(self) -> str:
        """What was found; of a cause, its name."""
        return self.text.replace("{own}", self.own)

    @property
    def joint(self) -> str:
        """The joint, empty where it is on none or several."""
        return self.joints[0] if len(self.joints) == 1 else ""

    @property
    def topic(self) -> str:
        """What files show as its kind: the same for kinds that matter alike."""
        return self.shown_as or self.kind

    @property
    def severity(self) -> Grade:
        """How much it matters beside other notes: what lowers a verdict is a warning."""
        return self.grade if self.grade in NOTES else Grade.WARNING

    @property
    def decisive(self) -> bool:
        """Whether it lowers the verdict on an estimate."""
        return self.grade in VERDICTS

    def from_source(self, source: str) -> Finding:
        """Return the finding with this run or robot as its source; what was its source is a log of that."""
        return replace(self, source=source, text=f"{self.source}: {self.text}" if self.source else self.text)

    # as a verdict on an estimate

    @property
    def outcome(self) -> Grade:
        """How credible the estimate is."""
        return self.grade

    @property
    def why(self) -> str:
        """The reason, empty where nothing speaks against the estimate."""
        return self.what

    @property
    def sentence(self) -> str:
        """The verdict as one sentence, without its subject."""
        return self.grade.value + (f": {self.what}; {self.advice}" if self.text else "")

    @property
    def finding(self) -> Finding | None:
        """What speaks against the estimate; None where nothing does."""
        return self if self.text else None


def by_severity(findings: Iterable[Finding]) -> dict[Grade, list[Finding]]:
    """Group findings by severity, the worst first, each sentence once; no severity without findings.

    Within a severity what may move an estimate most stands first, others in their order.
    """
    listed: dict[str, Finding] = {}
    for finding in sorted(findings, key=lambda finding: -finding.size):
        listed.setdefault(str(finding), finding)
    groups = {grade: [finding for finding in listed.values() if finding.severity == grade] for grade in NOTES}
    return {grade: members for grade, members in groups.items() if members}


def finding_document(finding: Finding) -> dict[str, Any]:
    """Describe a finding behind a verdict, or a cause, as a JSON document."""
    fields = ("kind", "joints", "subject", "values", "causes", "text", "own", "advice", "grade")
    plain = {name: getattr(finding, name) for name in fields}
    lists = {"joints": list(finding.joints), "causes": list(finding.causes)}
    return plain | lists | {"values": dict(finding.values), "grade": finding.grade.value}


def note_document(finding: Finding) -> dict[str, Any]:
    """Describe a finding beside the verdicts as a JSON document, with its sentence."""
    return {
        "grade": finding.severity.value,
        "kind": finding.topic,
        "finding": finding.kind,
        "source": finding.source or None,
        "joint": finding.joint or None,
        "time": finding.time,
        "share": finding.share,
        "what": finding.what,
        "action": finding.advice or None,
    }


def read_note(document: Any) -> Any:
    """Give the JSON document of :func:`note_document` the keys of a :class:`Finding`; raises KeyError."""
    return {
        "kind": document.get("finding") or document["kind"],
        "joints": (document["joint"],) if document.get("joint") else (),
        "text": document["what"],
        "advice": document.get("action") or "",
        "grade": document.get("grade", Grade.WARNING),
        "shown_as": document["kind"],
        "source": document.get("source") or "",
        "time": document.get("time"),
        "share": document.get("share"),
    }


def moment(time: float, digits: int = 9) -> str:
    """Write an instant of a log in s, or as a date where it is one since 1970: ``1.7e+09 s`` says nothing."""
    if time < 1e8:
        return f"{time:.{digits}g} s"
    if time > 1e10:
        return f"{time:.3f} s"
    return f"{datetime.fromtimestamp(time, UTC).isoformat(' ', 'milliseconds')[:-6]} UTC ({time:.3f} s)"


def percent(share: float, spec: str = ".2g") -> str:
    """Write a share in per cent, or "more than 1000 %" above ten times the whole."""
    if abs(share) > MOST_PERCENT / 100:
        return f"more than {MOST_PERCENT:g} %"
    text = format(100 * share, spec if abs(share) < 1 else spec[: spec.index(".")] + ".0f")
    return f"{text if text.strip('+-0.') else text.lstrip('-')} %"


def percents(values: Iterable[float]) -> str:
    """Write the range of shares (per cent), one number where they are alike."""
    shown = [f"{value:.2f}" if value <= MOST_PERCENT else f"more than {MOST_PERCENT:g}" for value in sorted(values)]
    return f"{' to '.join(dict.fromkeys((shown[0], shown[-1])))} %"


def listed(names: Iterable[str], between: str = " and ") -> str:
    """Quote names and join them."""
    return enumerated([*map(quoted, names)], between)


def enumerated(parts: Sequence[str], between: str = " and ") -> str:
    """Join parts by commas, and the last ``between`` them."""
    return between.join(filter(None, (", ".join(parts[:-1]), *parts[-1:])))


def counted(number: int, noun: str) -> str:
    """Write ``1 row``, ``2 rows``."""
    return f"{number} {noun}{'s' * (number != 1)}"


def write_limits(joint: str) -> str:
    """Advise how to correct wrong limits of a joint in its file."""
    return f"state the real one under 'robot' in the experiment file ({{file: ..., limits: {{{joint}: ...}}}})"


def clock_advice(rate: float | None) -> str:
    """Advise what to correct where a run has a wrong time: its ``rate`` (Hz) if that is stated, or the time stamps."""
    if rate is not None:
        return f"correct the sampling rate under signals.time, where 'rate: {rate:g}' is wrong"
    return "correct the unit of the time (units: {time: ...})"


def to_width(value: float, width: float) -> str:
    """Write a number to two digits of half the width of its interval."""
    decimals = max(1 - floor(log10(width)), 0) if 0 < width < float("inf") else 4
    return f"{value:z.{min(decimals, 12)}f}"


def percent_text(share: float, accuracy: float | None = None) -> str:
    """Write a share (per cent) in two significant digits and at most two decimals, without the sign of per cent.

    A share that exceeds the ``accuracy`` (per cent) is rounded up where it would be rounded to it or below.
    """
    if 0 < share < 0.005:
        return "<0.01"
    decimals = min(max(1 - floor(log10(float(f"{share:.2g}"))), 0), 2) if share else 2
    shown = f"{share:.{decimals}f}"
    if accuracy is not None and share > accuracy >= float(shown):
        shown = f"{ceil(share * 10**decimals) / 10**decimals:.{decimals}f}"
    return shown
