"""Conclusions of a result in plain words: what can be trusted, and notes beside the gains."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from gtau.estimation.diagnostics.verdict import Outcome, Verdict
from gtau.estimation.regression.friction import TEMPERATURE_TERMS
from gtau.estimation.results.estimate import Estimate, NearestPose, Requirement
from gtau.estimation.results.payload import PayloadEstimate
from gtau.estimation.results.result import Result
from gtau.estimation.results.torque_scale import listed, torque_headline
from gtau.estimation.thresholds.estimates import INFLATED
from gtau.estimation.thresholds.logs import NEAR_SINGULAR
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.findings.words import percent_text
from gtau.signals.reading.columns import Signals
from gtau.signals.reading.statements import FIRST_MOMENTS

RANKED = (Outcome.CONTRADICTORY, Outcome.NOT_IDENTIFIABLE, Outcome.WEAK, Outcome.GOOD, Outcome.GIVEN)
NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")
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
    groups = [each for each in reasons(result) if each.outcome == Outcome.CONTRADICTORY]
    for each in groups[:NAMED]:
        verb = "contradict" + "s" * (len(each.joints) == 1)
        subject = "All joints" if 1 < len(each.joints) == len(result.drive_gains) else _subject(each.joints)
        yield f"{subject} {verb} the description: {each.why}."
    if rest := [joint for each in groups[NAMED:] for joint in each.joints]:
        yield f"{_subject(rest)} contradict{'s' * (len(rest) == 1)} it too."
    stated = {f"Payload '{payload.name}'": payload.verdict for payload in result.payloads}
    stated |= {f"The {sensor.source}": sensor.verdict for sensor in result.sensors}
    for name, verdict in stated.items():
        if verdict.outcome == Outcome.CONTRADICTORY:
            yield f"{name} contradicts the data: {verdict.why}."
    if failed := missed(result):
        yield f"Requirement missed: {'; '.join(failed)}."


def missed(result: Result) -> list[str]:
    """Describe each requirement that is not met."""
    said = []
    for each in result.requirements:
        if not each.met:
            found = "not known" if each.found is None else f"{each.found:.2f} % (joint '{each.joint}')"
            said.append(f"{' of '.join(required(each))}: {found}, and {each.limit:g} % is required")
    return said


def required(each: Requirement) -> tuple[str, str]:
    """Name what a requirement limits, and of what."""
    if each.name == "gain_interval":
        return "half the 95 % interval", "gains"
    return ("torque error", f"run '{each.run}'") if each.run else ("torque residual", "rows used")


def _known(result: Result) -> str:
    """State which gains are known to which accuracy."""
    gains = list(result.drive_gains.values())
    if result.kind == "torque":
        return torque_headline(result)
    if all(gain.std is None for gain in gains):
        return "The drive gains were given, not identified."
    accuracy = result.statistics.get("accuracy", 0.0)
    sentences = [_good(gains, accuracy)]
    if lost := [gain.name for gain in gains if gain.verdict.outcome == Outcome.NOT_IDENTIFIABLE]:
        sentences.append(
            f"{_subject(lost)} {'has no identifiable gain' if len(lost) == 1 else 'have no identifiable gains'}."
        )
    weak = [gain for gain in gains if gain.verdict.outcome == Outcome.WEAK]
    doubted = [gain for gain in weak if (gain.half_width or 0.0) <= 100 * accuracy]  # for what is wrong elsewhere
    sentences += _weak([gain for gain in weak if gain not in doubted], 100 * accuracy)
    if doubted:
        names = _subject([gain.name for gain in doubted])
        sentences.append(f"{names} {'is' if len(doubted) == 1 else 'are'} in doubt.")
    return " ".join(sentences)


def reasons(result: Result) -> tuple[Reason, ...]:
    """List reasons and advice for the verdicts on gains, the worst first: joints with equal advice share a row."""
    groups: dict[tuple[Outcome, str, str], list[Estimate]] = {}
    for gain in sorted(result.drive_gains.values(), key=lambda gain: -(gain.half_width or 0.0)):
        found = gain.verdict.finding
        if found is not None:
            groups.setdefault((gain.verdict.outcome, found.kind, gain.verdict.advice), []).append(gain)
    ranked = sorted(groups.items(), key=lambda group: RANKED.index(group[0][0]))
    return tuple(
        Reason(outcome, tuple(gain.name for gain in members), _why(members), advice)
        for (outcome, _, advice), members in ranked
    )


def _why(gains: Sequence[Estimate]) -> str:
    """Give the reason for several gains; where the numbers differ, that of the first and worst."""
    whys = dict.fromkeys(gain.verdict.why for gain in gains)
    first = next(iter(whys))
    return first if len(whys) == 1 else f"{first} ('{gains[0].name}')"


def _good(gains: Sequence[Estimate], accuracy: float) -> str:
    good = [gain for gain in gains if gain.verdict.outcome == Outcome.GOOD]
    total = _number(len(gains))
    if len(good) == len(gains):
        widest = max(gain.half_width or 0.0 for gain in good)
        which = {1: "The drive gain is", 2: "Both drive gains are"}.get(len(gains), f"All {total} drive gains are")
        return f"{which} known to within {percent_text(widest)} % (95 % intervals)."
    if not good:
        return f"No drive gain is known to {100 * accuracy:g} %."
    verb = "is" if len(good) == 1 else "are"
    known = f"{_number(len(good))} of {total} drive gains {verb} known to {100 * accuracy:g} % (95 % intervals)."
    return known[0].upper() + known[1:]


def _weak(gains: Sequence[Estimate], accuracy: float) -> list[str]:
    """State the accuracy of the weak gains."""
    if not gains:
        return []
    known = [
        f"'{gain.name}'{'' if k else ' is known'} to +-{percent_text(gain.half_width or 0.0, accuracy)} %"
        for k, gain in enumerate(gains)
    ]
    return [listed(known) + "."]


def _subject(joints: Sequence[str]) -> str:
    names = listed([f"'{joint}'" for joint in joints])
    return f"Joint {names}" if len(joints) == 1 else f"Joints {names}"


def _number(count: int) -> str:
    return NUMBERS[count] if count < len(NUMBERS) else str(count)


def findings(result: Result) -> list[Finding]:
    """Collect all notes on a result beside its verdicts: on the fit, the motion, the logs and the robot."""
    return [*remarks(result), *near_singularities(result.singularities), *result.notes]


def remarks(result: Result) -> list[Finding]:
    """Note faults of the fit beside the gains, with advice."""
    notes = []
    for payload in {each.name: each for each in result.payloads}.values():
        if payload.verdict.outcome != Outcome.GOOD:
            what = f"payload '{payload.name}' {payload.verdict.outcome.value}: {payload.verdict.why}"
            notes.append(_of_verdict(what, payload.verdict))
        if "m" not in payload.parameters:
            notes.append(Finding(F.MASS_UNSEEN, (), payload.name, {"sums": sums_with_mass(payload)}))
    for sensor in result.sensors:
        if sensor.verdict.outcome != Outcome.GOOD:
            what = f"the {sensor.source} {sensor.verdict.outcome.value}: {sensor.verdict.why}"
            notes.append(_of_verdict(what, sensor.verdict))
    lack = result.statistics["lack_of_fit"]
    if lack > INFLATED and any(each.relative > VISIBLE for each in result.residuals):
        notes.append(Finding(F.AUTOCORRELATED, values={"factor": lack}))
    return notes + not_separated([name for name, each in result.parameters.items() if each.value is None])


def sums_with_mass(payload: PayloadEstimate) -> list[str]:
    """List the identifiable sums that contain an unidentifiable payload mass, as ``my - 0.1445 m``."""
    kinds = FIRST_MOMENTS if set(FIRST_MOMENTS) & set(payload.parameters) else tuple(payload.parameters)
    regroupings = [payload.parameters[kind].regrouping for kind in kinds if kind in payload.parameters]
    return [each.replace("+ -", "- ") for each in regroupings if each.split()[-1] == "m"]


def _of_verdict(what: str, verdict: Verdict) -> Finding:
    kind = F.MODEL if verdict.finding is None else verdict.finding.kind
    return Finding(kind, values={"what": what, "action": verdict.advice})


def without_temperature(result: Result, signals: Signals) -> list[str]:
    """Note the temperature assumed for logs without one where the model's friction depends on it."""
    warm = result.temperatures
    depends = {name.body for name in result.friction if name.kind in TEMPERATURE_TERMS}
    if warm is None or not depends or signals.temperature is not None:
        return []
    listed = ", ".join(f"'{joint}' {warm.of_joint[joint]:.4g}" for joint in sorted(depends))
    return [
        f"friction depends on the temperature, which these logs lack; the reference is assumed ({listed} "
        f"{warm.unit}); add 'temperature' to the signals"
    ]


def not_separated(names: Sequence[str]) -> list[Finding]:
    """Note base parameters that the motions cannot separate from others, if there are any."""
    if not names:
        return []
    return [Finding(F.NOT_SEPARATED, values={"parameters": list(names)})]


def near_singularities(nearest: Iterable[NearestPose]) -> list[Finding]:
    """Note every run so close to a singularity of type 2 that modelling errors are magnified."""
    return [
        Finding(F.SINGULARITY, values={"distance": each.distance}, source=each.run, time=each.time)
        for each in nearest
        if each.type == 2 and each.distance < NEAR_SINGULAR
    ]
