"""Conclusions of a result in plain words: what can be trusted, and notes beside the gains."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import yaml

from gtau.estimation.diagnostics.log_checks import MOTOR_SIDE, SMOOTHED
from gtau.estimation.diagnostics.verdict import APART, LONGER
from gtau.estimation.results.estimate import Estimate, NearestPose, Requirement
from gtau.estimation.results.payload_body import PayloadEstimate
from gtau.estimation.results.result import IdentifiedModel
from gtau.findings import Finding, Grade, enumerated, listed, moment, percent_text
from gtau.robots.parameter import TEMPERATURE_TERMS
from gtau.signals.reading.columns import Signals
from gtau.signals.reading.drafting import ASSUMED_UNIT
from gtau.signals.reading.formats import reading
from gtau.signals.reading.statements import FIRST_MOMENTS

KNOWN = (Grade.GOOD, Grade.WEAK)
SCALE_UNTESTED = "torque scale not tested"
HEAD = """\
# Torque scale of '{robot}', identified by gtau from {runs}.
# true torque = factor x reported torque; a command for a wanted torque is the torque divided by the factor.
# Correct the factors whose state is 'wrong'; leave the others at 1. Intervals: 95 %. See 'gtau docs torque-scale'
"""
INFLATED = 1.8  # ratio of jackknife to white-noise standard errors, from which the summary says so
NEAR_SINGULAR = 0.05  # distance to a singularity of type 2, below which errors of the model are magnified
NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")
NAMED = 2  # groups of contradictory joints whose reason the headline gives
VISIBLE = 0.01  # per cent: a smaller torque error is rounding


def torque_scales(result: IdentifiedModel) -> dict[str, str]:
    """Say of each joint's torque scale if it is wrong, consistent with 1, undecided or in doubt; empty if not tested.

    A scale is wrong where it differs from 1 by more than the required accuracy, and by 3.5 standard deviations: of many
    joints some are outside their 95 % interval by chance, and these are undecided.
    """
    gains, accuracy = result.drive_gains, result.statistics.get("accuracy", 0.0)
    if result.kind != "torque" or all(gain.std is None for gain in gains.values()):
        return {}

    def state(gain: Estimate) -> str:
        if gain.verdict.outcome not in KNOWN or gain.value is None:
            return gain.verdict.outcome.value
        if not result.believable:
            return "in doubt"
        off = abs(gain.value - 1)
        if off > max(APART * (gain.std or 0.0), accuracy):
            return "wrong"
        return "consistent with 1" if off <= (gain.half_interval() or 0.0) else "undecided"

    return {joint: state(gain) for joint, gain in gains.items()}


def torque_headline(result: IdentifiedModel) -> str:
    """Summarise the torque scale of each joint, or say that it was not tested and how to test it."""
    gains = result.drive_gains
    if not (states := torque_scales(result)):
        if any(gain.value != 1 for gain in gains.values()):
            return "The torque scales were given, not identified."
        if why := next((note.what for note in result.notes if note.kind == SCALE_UNTESTED), ""):
            return f"{why[0].upper()}{why[1:]}."
        return (
            "The logged torques are assumed to be correct: their scale was not tested. To test it, log one run with a "
            "payload of known mass and one without."
        )
    by_state = defaultdict[str, list[str]](list)
    for joint, state in states.items():
        by_state[state].append(joint)
    sentences = []
    wrong, right, undecided = (by_state[state] for state in ("wrong", "consistent with 1", "undecided"))
    if wrong:
        first, *rest = ((_reported(gains[joint]), f" at '{joint}'") for joint in wrong)
        parts = [" of the torque".join(first), *map("".join, rest)]
        sentences.append(f"The arm reports {enumerated(parts)} (95 % intervals).")
    if right:
        widest = percent_text(max(gains[joint].half_width or 0.0 for joint in right))
        known = f"consistent with 1, known to within {widest} %{'' if wrong else ' (95 % intervals)'}"
        sentences.append(_scales_are(right, known, "all joints" if len(right) == len(states) > 1 else ""))
    if undecided:
        one = len(undecided) == 1
        outside = f"1 is outside {'its 95 % interval' if one else 'their 95 % intervals'}, but by too little to correct"
        sentences.append(_scales_are(undecided, f"undecided: {outside} {'it' if one else 'them'}"))
    for state in ("in doubt", Grade.NOT_IDENTIFIABLE.value):
        if by_state[state]:
            sentences.append(_scales_are(by_state[state], state))
    return " ".join(sentences)


def _scales_are(joints: Sequence[str], state: str, called: str = "") -> str:
    scales = "scales of {} are" if len(joints) > 1 else "scale of {} is"
    return f"The torque {scales.format(called or listed(joints))} {state}."


def _reported(gain: Estimate) -> str:
    """Write the share of its torque that a joint reports, with the ends of the 95 % interval."""
    value, (low, high) = 1 / (gain.value or 1.0), sorted(1 / end for end in gain.interval() or (1.0, 1.0))
    shown = ".2f" if 0.1 <= abs(value) < 10 else ".3g"
    return f"{value:{shown}} ({low:{shown}} to {high:{shown}})"


def torque_scale_text(result: IdentifiedModel) -> str:
    """Write the correction of the torques as YAML: a factor for each joint, with its interval and state."""
    joints: dict[str, dict[str, object]] = {}
    for joint, state in torque_scales(result).items():
        gain = result.drive_gains[joint]
        interval = gain.interval() if gain.verdict.outcome in KNOWN else None
        factor, *ends = (float(f"{value:.4g}") for value in (gain.value, *interval)) if interval else (None,)
        joints[joint] = {"factor": factor, "interval": ends or None, "state": state}
    head = HEAD.format(robot=" ".join(result.robot.name.split()), runs=", ".join(result.runs))
    return head + str(yaml.safe_dump({"torque_scale": joints}, sort_keys=False, default_flow_style=None, width=120))


def headline(result: IdentifiedModel) -> str:
    """Summarise a result: first what makes it unacceptable, then how many gains are known to which accuracy."""
    return " ".join([*_against(result), _known(result)]).strip()


def loses_gains(result: IdentifiedModel) -> bool:
    """Whether a gain is contradictory or not identifiable."""
    return any(gain.verdict.outcome.rank > Grade.WEAK.rank for gain in result.drive_gains.values())


def _against(result: IdentifiedModel) -> Iterator[str]:
    """Say what contradicts the result, and which requirements it misses; empty where it is accepted."""
    groups = [reason for reason in reasons(result) if reason.outcome == Grade.CONTRADICTORY]
    for reason in groups[:NAMED]:
        all_joints = 1 < len(reason.joints) == len(result.drive_gains)
        contradict = "All joints contradict" if all_joints else _subject(reason.joints, "contradicts", "contradict")
        yield f"{contradict} the description: {reason.why}."
    if others := [joint for reason in groups[NAMED:] for joint in reason.joints]:
        yield f"{_subject(others, 'contradicts', 'contradict')} it too."
    for name, verdict in _stated(result):
        if verdict.outcome == Grade.CONTRADICTORY:
            yield f"{name[0].upper()}{name[1:]} contradicts the data: {verdict.why}."
    first = (SMOOTHED, MOTOR_SIDE, ASSUMED_UNIT)[: 3 if loses_gains(result) else 2]  # a wrong unit contradicts all
    notes = [note.what for note in result.notes if note.kind in first]
    yield from (f"{what[0].upper()}{what[1:]}." for what in notes)
    if failed := missed(result):
        yield f"Requirement missed: {'; '.join(failed)}."


def _stated(result: IdentifiedModel) -> Iterator[tuple[str, Finding]]:
    payloads = {payload.name: payload.verdict for payload in result.payloads}
    yield from ((f"payload '{name}'", verdict) for name, verdict in payloads.items())
    yield from ((f"the {sensor.source}", sensor.verdict) for sensor in result.sensors)


def missed(result: IdentifiedModel) -> list[str]:
    """Describe each requirement that is not met."""
    said = []
    for requirement in result.requirements:
        if not requirement.met:
            known = requirement.found is not None
            found = f"{requirement.found:.2f} % (joint '{requirement.joint}')" if known else "not known"
            what = " of ".join(required(requirement))
            said.append(f"{what}: {found}, and {requirement.limit:g} % is required")
    return said


def required(requirement: Requirement) -> tuple[str, str]:
    """Name what a requirement limits, and of what."""
    if requirement.name == "gain_interval":
        return "half the 95 % interval", "gains"
    return ("torque error", f"run '{requirement.run}'") if requirement.run else ("torque residual", "rows used")


def _known(result: IdentifiedModel) -> str:
    gains = list(result.drive_gains.values())
    if result.kind == "torque":
        return torque_headline(result)
    if all(gain.std is None for gain in gains):
        return "The drive gains were given, not identified."
    accuracy = 100 * result.statistics.get("accuracy", 0.0)
    sentences = [_good(gains, accuracy)]
    if lost := [gain.name for gain in gains if gain.verdict.outcome == Grade.NOT_IDENTIFIABLE]:
        sentences.append(f"{_subject(lost, 'has no identifiable gain', 'have no identifiable gains')}.")
    weak = {gain.name: gain.half_width or 0.0 for gain in gains if gain.verdict.outcome == Grade.WEAK}
    wide = [f"'{name}'{{}} to +-{percent_text(width, accuracy)} %" for name, width in weak.items() if width > accuracy]
    if wide:
        sentences.append(enumerated([text.format("" if k else " is known") for k, text in enumerate(wide)]) + ".")
    # for what is wrong elsewhere
    if doubted := [name for name, width in weak.items() if width <= accuracy]:
        sentences.append(f"{_subject(doubted, 'is', 'are')} in doubt.")
    return " ".join(sentences)


def reasons(result: IdentifiedModel) -> tuple[Finding, ...]:
    """List reasons and advice for the verdicts on gains, the worst first; joints with equal advice share one."""
    groups = defaultdict[tuple[Grade, str, str], dict[str, Finding]](dict)
    for gain in sorted(result.drive_gains.values(), key=lambda gain: -(gain.half_width or 0.0)):
        if finding := gain.verdict.finding:
            groups[finding.grade, finding.kind, finding.advice.removesuffix(LONGER)][gain.name] = finding
    merged = []
    for members in groups.values():
        first, *_ = members.values()
        merged.append(replace(first, joints=tuple(members), text=_common_text(members), own=""))
    return tuple(sorted(merged, key=lambda finding: -finding.grade.rank))


def _common_text(members: Mapping[str, Finding]) -> str:
    """Say what holds of several joints, with what differs between them."""
    alike = defaultdict[str, list[str]](list)
    for joint, finding in members.items():
        alike[finding.text].append(joint)
    parts = []
    for text, joints in alike.items():
        if "{own}" in text and len(joints) > 1:
            owns = ", ".join(f"{members[joint].own} ('{joint}')" for joint in joints)
            parts.append(text.replace("{own}", owns))
            continue
        said = members[joints[0]].what
        named = len(alike) == 1 or all(repr(joint) in said for joint in joints)
        parts.append(said if named else f"{said} ({', '.join(map(repr, joints))})")
    return "; ".join(parts)


def _good(gains: Sequence[Estimate], accuracy: float) -> str:
    good = [gain for gain in gains if gain.verdict.outcome == Grade.GOOD]
    count, total = (NUMBERS[n] if n < len(NUMBERS) else str(n) for n in (len(good), len(gains)))
    if len(good) == len(gains):
        widest = max(gain.half_width or 0.0 for gain in good)
        which = {1: "The drive gain is", 2: "Both drive gains are"}.get(len(gains), f"All {total} drive gains are")
        return f"{which} known to within {percent_text(widest)} % (95 % intervals)."
    if not good:
        return f"No drive gain is known to {accuracy:g} %."
    verb = "is" if len(good) == 1 else "are"
    return f"{count.capitalize()} of {total} drive gains {verb} known to {accuracy:g} % (95 % intervals)."


def _subject(joints: Sequence[str], one: str, several: str) -> str:
    names = listed(joints)
    return f"Joint {names} {one}" if len(joints) == 1 else f"Joints {names} {several}"


def findings(result: IdentifiedModel) -> list[Finding]:
    """Collect all notes on a result beside its verdicts: on the fit, the motion, the logs and the robot."""
    return [*remarks(result), *near_singularities(result.singularities), *result.notes]


def remarks(result: IdentifiedModel) -> list[Finding]:
    """Note faults of the fit beside the gains, with advice."""
    notes = []
    for name, verdict in _stated(result):
        if verdict.outcome != Grade.GOOD:
            notes.append(replace(verdict, text=f"{name} {verdict.outcome.value}: {verdict.why}", own=""))
    for name, payload in {payload.name: payload for payload in result.payloads}.items():
        if "m" not in payload.parameters:
            sums = sums_with_mass(payload)
            seen = "it affects no joint torque: the body that carries it turns about a fixed point"
            if sums:
                seen = f"only sums with its other parameters affect the joint torques: {', '.join(sums)}"
            text = f"the mass of payload '{name}' is not identifiable, because {seen}"
            advice = "if its centre of mass is known, write it as 'center: [x, y, z]' of the payload, m"
            kind = "payload mass not identifiable"
            notes.append(Finding(kind, subject=name, text=text, advice=advice, shown_as="model"))
    lack = result.statistics["lack_of_fit"]
    if lack > INFLATED and any(error.relative > VISIBLE for error in result.residuals):
        largest = max(result.effects, key=lambda effect: effect.share, default=None)
        found = f"; the largest found is {largest.subject}" if largest and largest.share else ""
        text = (
            f"residuals are autocorrelated: standard errors are {lack:.1f} times as large as for white noise, so the "
            f"model lacks an effect{found}"
        )
        notes.append(Finding("autocorrelated residuals", text=text, shown_as="model"))
    lost = [name for name, estimate in result.parameters.items() if estimate.value is None]
    return notes + not_separated(lost)


def sums_with_mass(payload: PayloadEstimate) -> list[str]:
    """List the identifiable sums that contain an unidentifiable payload mass, as ``my - 0.1445 m``."""
    kinds = FIRST_MOMENTS if set(FIRST_MOMENTS) & set(payload.parameters) else tuple(payload.parameters)
    regroupings = [payload.parameters[kind].regrouping for kind in kinds if kind in payload.parameters]
    return [text.replace("+ -", "- ") for text in regroupings if text.split()[-1] == "m"]


def without_temperature(result: IdentifiedModel, signals: Signals) -> list[Finding]:
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
    if not names:
        return []
    text = f"these motions cannot separate {', '.join(names)} from the other base parameters: no value is given"
    advice = "add runs with different motions of all joints"
    return [Finding("parameters not separated", text=text, advice=advice, shown_as="separable parameters")]


def near_singularities(nearest: Iterable[NearestPose]) -> list[Finding]:
    """Note every run so close to a singularity of type 2 that modelling errors are magnified."""
    return [
        Finding(
            "singularity",
            text=f"the motion passes within {pose.distance:.2g} of a type 2 singularity at {moment(pose.time, 4)}, "
            "where errors of position and geometry are amplified",
            advice="keep the motion away from that pose",
            source=pose.run,
            time=pose.time,
        )
        for pose in nearest
        if pose.type == 2 and pose.distance < NEAR_SINGULAR
    ]
