"""Conclusions of a result in plain words: what can be trusted, and notes beside the gains."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from gtau.estimation.diagnostics.verdict import Outcome, Verdict
from gtau.estimation.regression.column_blocks import TEMPERATURE_TERMS
from gtau.estimation.results.estimate import Estimate, NearestPose, Requirement
from gtau.estimation.results.payload_body import PayloadEstimate
from gtau.estimation.results.result import Result
from gtau.estimation.results.torque_scale import listed, torque_headline
from gtau.findings import Finding, Grade
from gtau.findings import FindingKind as F
from gtau.findings.finding import named_causes
from gtau.findings.words import moment, percent_text
from gtau.signals.reading.columns import Signals
from gtau.signals.reading.notes import reading
from gtau.signals.reading.statements import FIRST_MOMENTS

INFLATED = 1.8  # ratio of jackknife to white-noise standard errors, from which the summary says so
NEAR_SINGULAR = 0.05  # distance to a singularity of type 2, below which errors of the model are magnified

NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")
NUMBERED = {F.REFUTED, F.WIDE_SCALE, F.WIDE_CAUSE, F.WIDE_RANDOM}
"""Kinds whose sentence takes the number of ``each`` joint."""
NAMED = 2  # groups of contradictory joints whose reason the headline gives
VISIBLE = 0.01  # per cent: a smaller torque error is rounding


@dataclass(frozen=True)
class Reason:
    """Reason why gains are not good, or a remark on good ones, and advice: the same for all ``joints``."""

    outcome: Outcome
    joints: tuple[str, ...]
    why: str
    action: str


def headline(result: Result) -> str:
    """Summarise a result: first what makes it unacceptable, then how many gains are known to which accuracy."""
    return " ".join([*_against(result), _known(result)]).strip()


def _against(result: Result) -> Iterator[str]:
    """Say what contradicts the result, and which requirements it misses; empty where it is accepted."""
    groups = [reason for reason in reasons(result) if reason.outcome == Outcome.CONTRADICTORY]
    for reason in groups[:NAMED]:
        all_joints = 1 < len(reason.joints) == len(result.drive_gains)
        contradict = "All joints contradict" if all_joints else _subject(reason.joints, "contradicts", "contradict")
        yield f"{contradict} the description: {reason.why}."
    if others := [joint for reason in groups[NAMED:] for joint in reason.joints]:
        yield f"{_subject(others, 'contradicts', 'contradict')} it too."
    for name, verdict in _stated(result):
        if verdict.outcome == Outcome.CONTRADICTORY:
            yield f"{name[0].upper()}{name[1:]} contradicts the data: {verdict.why}."
    yield from (f"{note.what[0].upper()}{note.what[1:]}." for note in result.notes if note.kind == F.SMOOTHED)
    if failed := missed(result):
        yield f"Requirement missed: {'; '.join(failed)}."


def _stated(result: Result) -> Iterator[tuple[str, Verdict]]:
    """Name payloads and sensors, with their verdicts."""
    payloads = {payload.name: payload.verdict for payload in result.payloads}
    yield from ((f"payload '{name}'", verdict) for name, verdict in payloads.items())
    yield from ((f"the {sensor.source}", sensor.verdict) for sensor in result.sensors)


def missed(result: Result) -> list[str]:
    """Describe each requirement that is not met."""
    return [
        f"{' of '.join(required(requirement))}: "
        + ("not known" if requirement.found is None else f"{requirement.found:.2f} % (joint '{requirement.joint}')")
        + f", and {requirement.limit:g} % is required"
        for requirement in result.requirements
        if not requirement.met
    ]


def required(requirement: Requirement) -> tuple[str, str]:
    """Name what a requirement limits, and of what."""
    if requirement.name == "gain_interval":
        return "half the 95 % interval", "gains"
    return ("torque error", f"run '{requirement.run}'") if requirement.run else ("torque residual", "rows used")


def _known(result: Result) -> str:
    """State which gains are known to which accuracy."""
    gains = list(result.drive_gains.values())
    if result.kind == "torque":
        return torque_headline(result)
    if all(gain.std is None for gain in gains):
        return "The drive gains were given, not identified."
    accuracy = 100 * result.statistics.get("accuracy", 0.0)
    sentences = [_good(gains, accuracy)]
    if lost := [gain.name for gain in gains if gain.verdict.outcome == Outcome.NOT_IDENTIFIABLE]:
        sentences.append(f"{_subject(lost, 'has no identifiable gain', 'have no identifiable gains')}.")
    weak = {gain.name: gain.half_width or 0.0 for gain in gains if gain.verdict.outcome == Outcome.WEAK}
    wide = [f"'{name}'{{}} to +-{percent_text(width, accuracy)} %" for name, width in weak.items() if width > accuracy]
    if wide:
        sentences.append(listed([text.format("" if k else " is known") for k, text in enumerate(wide)]) + ".")
    # for what is wrong elsewhere
    if doubted := [name for name, width in weak.items() if width <= accuracy]:
        sentences.append(f"{_subject(doubted, 'is', 'are')} in doubt.")
    return " ".join(sentences)


def reasons(result: Result) -> tuple[Reason, ...]:
    """List reasons and advice for the verdicts on gains, the worst first: joints with equal advice share a row.

    What differs between them, a number or the cause, is given of each.
    """
    groups: dict[tuple[Outcome, str, str], dict[str, list[Estimate]]] = {}
    for gain in sorted(result.drive_gains.values(), key=lambda gain: -(gain.half_width or 0.0)):
        if (finding := gain.verdict.finding) is not None:
            remedy = finding.causes[0].action if finding.causes else finding.action
            key = gain.verdict.outcome, finding.kind, remedy
            alike = named_causes(finding.causes) if finding.kind in NUMBERED else finding.what
            groups.setdefault(key, {}).setdefault(alike, []).append(gain)
    merged = []
    for (outcome, *_), parts in groups.items():
        members = [gain for gains in parts.values() for gain in gains]
        why = "; ".join(_why(gains, len(parts) > 1) for gains in parts.values())
        merged.append(Reason(outcome, tuple(gain.name for gain in members), why, members[0].verdict.advice))
    return tuple(sorted(merged, key=lambda reason: -list(Outcome).index(reason.outcome)))


def _why(gains: Sequence[Estimate], named: bool) -> str:
    """Give the reason of gains that differ in a number at most; ``named`` where there are others beside it."""
    findings = {gain.name: gain.verdict.finding for gain in gains if gain.verdict.finding is not None}
    first = next(iter(findings.values()))
    if len(gains) > 1 and first.kind in NUMBERED:
        of_each = [(name, finding.values) for name, finding in findings.items()]
        return replace(first, values={**first.values, "each": of_each}).what
    said = all(repr(name) in first.what for name in findings)
    return f"{first.what} ({', '.join(map(repr, findings))})" if named and not said else first.what


def _good(gains: Sequence[Estimate], accuracy: float) -> str:
    """Count the gains that are known to the ``accuracy``, per cent."""
    good = [gain for gain in gains if gain.verdict.outcome == Outcome.GOOD]
    total = _number(len(gains))
    if len(good) == len(gains):
        widest = max(gain.half_width or 0.0 for gain in good)
        which = {1: "The drive gain is", 2: "Both drive gains are"}.get(len(gains), f"All {total} drive gains are")
        return f"{which} known to within {percent_text(widest)} % (95 % intervals)."
    if not good:
        return f"No drive gain is known to {accuracy:g} %."
    count, verb = _number(len(good)), "is" if len(good) == 1 else "are"
    count = count[0].upper() + count[1:]
    return f"{count} of {total} drive gains {verb} known to {accuracy:g} % (95 % intervals)."


def _subject(joints: Sequence[str], one: str, several: str) -> str:
    """Begin a sentence on joints, with its verb for one of them or several."""
    names = listed([f"'{joint}'" for joint in joints])
    return f"Joint {names} {one}" if len(joints) == 1 else f"Joints {names} {several}"


def _number(count: int) -> str:
    return NUMBERS[count] if count < len(NUMBERS) else str(count)


def findings(result: Result) -> list[Finding]:
    """Collect all notes on a result beside its verdicts: on the fit, the motion, the logs and the robot."""
    return [*remarks(result), *near_singularities(result.singularities), *result.notes]


def remarks(result: Result) -> list[Finding]:
    """Note faults of the fit beside the gains, with advice."""
    notes = []
    for name, verdict in _stated(result):
        if verdict.outcome != Outcome.GOOD:
            said = {"what": f"{name} {verdict.outcome.value}: {verdict.why}", "action": verdict.advice}
            notes.append(Finding(F.MODEL if verdict.finding is None else verdict.finding.kind, values=said))
    for name, payload in {payload.name: payload for payload in result.payloads}.items():
        if "m" not in payload.parameters:
            notes.append(Finding(F.MASS_UNSEEN, (), name, {"sums": sums_with_mass(payload)}))
    lack = result.statistics["lack_of_fit"]
    if lack > INFLATED and any(error.relative > VISIBLE for error in result.residuals):
        notes.append(Finding(F.AUTOCORRELATED, values={"factor": lack}))
    return notes + not_separated([name for name, estimate in result.parameters.items() if estimate.value is None])


def sums_with_mass(payload: PayloadEstimate) -> list[str]:
    """List the identifiable sums that contain an unidentifiable payload mass, as ``my - 0.1445 m``."""
    kinds = FIRST_MOMENTS if set(FIRST_MOMENTS) & set(payload.parameters) else tuple(payload.parameters)
    regroupings = [payload.parameters[kind].regrouping for kind in kinds if kind in payload.parameters]
    return [text.replace("+ -", "- ") for text in regroupings if text.split()[-1] == "m"]


def without_temperature(result: Result, signals: Signals) -> list[Finding]:
    """Note the temperature assumed for logs without one where the model's friction depends on it."""
    warm = result.temperatures
    joints = sorted({name.body for name in result.friction if name.kind in TEMPERATURE_TERMS})
    if warm is None or not joints or signals.temperature is not None:
        return []
    assumed = ", ".join(f"'{joint}' {warm.of_joint[joint]:.4g}" for joint in joints)
    text = f"friction depends on temperature, which these logs lack; the reference is assumed ({assumed} {warm.unit})"
    return [reading("assumed temperature", text=text, advice="add 'temperature' to the signals", joints=joints)]


def not_separated(names: Sequence[str]) -> list[Finding]:
    """Note base parameters that the motions cannot separate from others, if there are any."""
    return [Finding(F.NOT_SEPARATED, values={"parameters": list(names)})] if names else []


def near_singularities(nearest: Iterable[NearestPose]) -> list[Finding]:
    """Note every run so close to a singularity of type 2 that modelling errors are magnified."""
    return [
        Finding(
            "singularity",
            text=f"the motion passes within {pose.distance:.2g} of a type 2 singularity at {moment(pose.time, 4)}, "
            "where errors of position and geometry are amplified",
            advice="keep the motion away from that pose",
            grade=Grade.WARNING,
            source=pose.run,
            time=pose.time,
        )
        for pose in nearest
        if pose.type == 2 and pose.distance < NEAR_SINGULAR
    ]
