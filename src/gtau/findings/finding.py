"""Findings, as data: raised where logs are read and fits are judged, and put into words where a person reads them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from gtau.findings.kind import FindingKind as F
from gtau.findings.kind import Grade, Severity
from gtau.findings.words import Sentence, clock_advice, filled, phrase, write_limits

WORDS = ("text", "advice", "own", "grade", "shown_as")
MAY_BE_WRENCHES = {F.SWAPPED, F.REVERSED, F.ALL_NEGATIVE, F.REFUTED, F.UNEXPLAINED}


@dataclass(frozen=True)
class Finding:
    """One finding of a check; as text, a sentence without its full stop.

    Attributes
    ----------
    kind : str
        What was found: a :class:`FindingKind`, or what a hypothesis names as a cause.
    joints : tuple of str
        Joints whose gains, delays, drives or columns it is about.
    subject : str
        Payload, sensor, parameter, body or leg that it is about, where there is one.
    values : mapping
        Numbers, names and switches of the sentence; shares and moves as ratios, SI units. The sentence itself, ``what``
        and ``action``, where it comes from a file or a refusal.
    causes : tuple of Finding
        What explains it; the first counts most, and all have the same effect.
    size : float
        The larger counts of two findings of one kind on a joint. Beside the verdicts, by how many half widths of its
        95 % interval it may move an estimate, where that is known; the larger stands first.
    source : str
        Name of the run or robot, empty for a finding on all of them.
    time : float, optional
        Instant in the log, s.
    share : float, optional
        Share of the samples that it concerns.
    text, advice : str
        What was found, and what to do about it; empty where the templates have the words. ``{own}`` in the text stands
        for what differs from joint to joint.
    own : str
        What stands for ``{own}`` in the text of this joint, such as ``+-5.3 %``.
    grade : Grade, optional
        How much it matters; None where the kind tells.
    shown_as : str
        What files show as its kind, where several kinds share it; the kind itself otherwise.
    """

    kind: str
    joints: tuple[str, ...] = ()
    subject: str = ""
    values: Mapping[str, Any] = field(default_factory=dict, hash=False)
    causes: tuple[Finding, ...] = ()
    size: float = 0.0
    source: str = ""
    time: float | None = None
    share: float | None = None
    text: str = ""
    advice: str = ""
    own: str = ""
    grade: Grade | None = None
    shown_as: str = ""

    def __str__(self) -> str:
        """Compose the sentence."""
        what, action = self.sentence
        return (f"{self.source}: " if self.source else "") + what + (f"; {action}" if action else "")

    @property
    def what(self) -> str:
        """What was found; of a cause, its name."""
        return self.sentence[0]

    @property
    def action(self) -> str:
        """What to do about it, empty where there is nothing to do."""
        return self.sentence[1]

    @property
    def joint(self) -> str:
        """The joint, empty where it is on none or several."""
        return self.joints[0] if len(self.joints) == 1 else ""

    @property
    def topic(self) -> str:
        """What files show as its kind: the same for kinds that matter alike."""
        if self.text:
            return self.shown_as or self.kind
        return F(self.kind).topic

    @property
    def severity(self) -> Severity:
        """How much it matters."""
        if self.grade is not None:
            return Severity(self.grade)
        return F(self.kind).severity

    @property
    def sentence(self) -> Sentence:
        """What was found and what to do about it, wrenches first where they may be the cause and none of them is."""
        if self.text:
            return self.text.replace("{own}", self.own), self.advice
        if "what" in self.values:
            return self.values["what"], self.values.get("action", "")
        first, last = (self.joints[0], self.joints[-1]) if self.joints else ("", "")
        given: dict[str, Any] = {"also": "", "joint": "", "count": len(self.joints), "payload": True, **self.values}
        given |= {"joints": self.joints, "time": self.time, "subject": self.subject, "joint": first or given["joint"]}
        given |= {
            "other": last,
            "estimate": f"the gain of '{first}'" if first else self.subject or "estimates",
            "clock": clock_advice(self.values.get("rate")),
            "limits": write_limits(self.subject or first),
        }
        if self.causes:
            cause = self.causes[0]
            cause = replace(cause, values={**cause.values, "payload": given["payload"]})
            given |= {"cause": named_causes(self.causes), "to_do": cause.action}
        what, to_do = filled(self.kind, given)
        if self.values.get("wrenches") and self.kind in MAY_BE_WRENCHES and not any(map(_of_wrench, self.causes)):
            to_do = f"{phrase('wrenches')}; otherwise {to_do}"
        return what, to_do

    def of_source(self, source: str) -> Finding:
        """Return the finding with this run or robot as its source; what was its source is a log of that."""
        return replace(self, source=source, text=f"{self.source}: {self.text}" if self.source else self.text)


def _of_wrench(cause: Finding) -> bool:
    return cause.kind in ("wrench offsets", "wrench points")


def named_causes(causes: Sequence[Finding]) -> str:
    """Name causes that have the same effect."""
    return " or ".join(dict.fromkeys(cause.what for cause in causes))


def by_severity(findings: Iterable[Finding]) -> dict[Severity, list[Finding]]:
    """Group findings by severity, the worst first, each sentence once; no severity without findings.

    Within a severity what may move an estimate most stands first, others in their order.
    """
    listed: dict[str, Finding] = {}
    for finding in sorted(findings, key=lambda finding: -finding.size):
        listed.setdefault(str(finding), finding)
    groups = {level: [finding for finding in listed.values() if finding.severity == level] for level in Severity}
    return {level: members for level, members in groups.items() if members}


def finding_document(finding: Finding) -> dict[str, Any]:
    """Describe a finding behind a verdict as a JSON document."""
    return {
        "kind": str(finding.kind),
        "joints": list(finding.joints),
        "subject": finding.subject,
        "values": dict(finding.values),
        "causes": [finding_document(cause) for cause in finding.causes],
        **({key: getattr(finding, key) for key in WORDS} if finding.text else {}),
    }


def note_document(finding: Finding) -> dict[str, Any]:
    """Describe a finding beside the verdicts as a JSON document, with its sentence."""
    what, action = finding.sentence
    return {
        "grade": finding.severity.value,
        "kind": finding.topic,
        "finding": str(finding.kind),
        "source": finding.source or None,
        "joint": finding.joint or None,
        "time": finding.time,
        "share": finding.share,
        "what": what,
        "action": action or None,
    }


def read_note(document: Any) -> Any:
    """Give the JSON document of :func:`note_document` the keys of a :class:`Finding`; raises ValueError."""
    if not isinstance(document, dict):
        return document
    if missing := {"kind", "what"} - set(document):
        raise ValueError(f"the key '{min(missing)}' is missing; add it")
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
