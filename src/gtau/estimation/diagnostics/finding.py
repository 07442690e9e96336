"""Findings: what checks report, as data. Verdicts follow from them in one decision, sentences are made last."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from gtau.signals.notes import Kind

RELATIVE = "of itself"  # unit of a size that is a share of what it changes

Values = Mapping[str, Any]
Sentence = tuple[str, str]
"""Reason and advice, of a cause its name and advice, which is empty where there is nothing to do.

Fields in braces are the values of the finding, its ``subject``, its first ``joint`` and the ``other`` one, the
``estimate`` that it is about, the ``cause`` and what ``to_do`` about it.
"""
Words = Sentence | Callable[[Values], Sentence]
"""The sentence of a kind of finding, or a function that makes it from the values."""


class Outcome(StrEnum):
    """Outcomes of judging an estimate, the best first."""

    GIVEN = "given"
    GOOD = "good"
    WEAK = "weak"
    NOT_IDENTIFIABLE = "not identifiable"
    CONTRADICTORY = "contradictory"


class FindingKind(StrEnum):
    """Kind of a finding of a check; :mod:`gtau.estimation.diagnostics.sentences` has the words for each.

    With the ``outcome`` of an estimate that it is about, or the kind of its ``note``. What may move an estimate by more
    than its interval has an outcome, and thereby decides verdict, headline and exit code; notes are on what the
    intervals include or on nothing that moves them. Kinds with an outcome stand in the order in which they count where
    several are on one estimate.
    """

    outcome: Outcome | None
    note: Kind

    def __new__(cls, name: str, *of: Outcome | Kind) -> FindingKind:
        """Make the name, with an outcome, the kind of a note, or both."""
        made = str.__new__(cls, name)
        made._value_ = name
        made.outcome = next((each for each in of if isinstance(each, Outcome)), None)
        made.note = next((each for each in of if isinstance(each, Kind)), Kind.MODEL)
        return made

    # what the whole estimation rests on
    NEGATIVE_MASS = "negative mass", Outcome.CONTRADICTORY
    BASE_UNEXPLAINED = "unexplained base wrench", Outcome.CONTRADICTORY
    # a gain that is noise: what it seems to contradict is noise too
    TLS_CONFUSED = "payload lost in noise", Outcome.NOT_IDENTIFIABLE
    # the data against the description of robot and logs
    LATE = "currents logged late", Outcome.CONTRADICTORY
    FROZEN = "frozen encoder", Outcome.CONTRADICTORY
    SWAPPED = "swapped channels", Outcome.CONTRADICTORY
    MAGNITUDES = "magnitudes", Outcome.CONTRADICTORY
    REVERSED = "reversed channels", Outcome.CONTRADICTORY
    ALL_NEGATIVE = "all gains negative", Outcome.CONTRADICTORY
    REFUTED = "description refuted", Outcome.CONTRADICTORY
    UNEXPLAINED = "unexplained current", Outcome.CONTRADICTORY
    # stated constants against each other
    PAYLOAD = "contradictory payload", Outcome.CONTRADICTORY
    SENSOR = "contradictory torque sensor", Outcome.CONTRADICTORY
    WHOLE_MASS = "contradictory mass", Outcome.CONTRADICTORY
    # a gain without a value: what follows would judge that value
    UNSETTLED = "not converged", Outcome.NOT_IDENTIFIABLE
    LOST = "lost in noise", Outcome.NOT_IDENTIFIABLE
    SIGN_OPEN = "sign open", Outcome.NOT_IDENTIFIABLE
    OTHER_ESTIMATOR = "other estimator", Outcome.CONTRADICTORY
    IMPOSSIBLE_PARAMETERS = "impossible parameters", Outcome.CONTRADICTORY
    # units and signs, which fit the data whatever they are: sizes that no such robot has
    PRIOR_GAIN = "prior gain", Outcome.CONTRADICTORY
    NEGATIVE_GAIN = "negative gain", Outcome.CONTRADICTORY
    GAINS_APART = "gains far apart", Outcome.CONTRADICTORY
    HEAVY_PAYLOAD = "payload too heavy", Outcome.CONTRADICTORY, Kind.UNIT
    LARGE_CURRENT = "current too large", Outcome.CONTRADICTORY, Kind.UNIT
    UNLIKE_FILE = "inertias out of scale", Outcome.CONTRADICTORY
    EFFORT = "effort limit", Outcome.CONTRADICTORY
    WIDE_SCALE = "uncertain scale", Outcome.WEAK
    WIDE_RIPPLE = "wide by ripple", Outcome.WEAK
    WIDE_CAUSE = "wide by an alternative", Outcome.WEAK
    WIDE_RANDOM = "wide interval", Outcome.WEAK
    COUPLED = "coupled joint", Outcome.WEAK
    # of delays, parameters, payloads and torque sensors
    DELAY_NOISE = "delay lost in noise", Outcome.NOT_IDENTIFIABLE
    DELAY_UNCERTAIN = "uncertain delay", Outcome.WEAK
    IMPOSSIBLE = "physically impossible", Outcome.CONTRADICTORY
    INSEPARABLE = "not separable", Outcome.NOT_IDENTIFIABLE
    NEAR_ZERO = "near zero", Outcome.NOT_IDENTIFIABLE
    UNCERTAIN = "uncertain parameter", Outcome.WEAK
    NEGATIVE_PAYLOAD = "payload of negative mass", Outcome.CONTRADICTORY
    PAYLOAD_MASS = "payload mass", Outcome.CONTRADICTORY
    PAYLOAD_PARAMETER = "payload parameter", Outcome.CONTRADICTORY
    SENSOR_SCALE = "sensor scale", Outcome.CONTRADICTORY
    # beside the verdicts, each a note
    DOUBTFUL_LIMIT = "doubtful effort limit", Kind.LIMITS
    CURRENTS_APART = "currents far apart", Kind.UNIT
    UNLIKE_LEGS = "unlike legs"
    PRIOR = "contradictory prior"
    PRIOR_INERTIA = "contradictory inertias of the robot's file"
    POSITION_NOISE = "position noise", Kind.NOISE
    RIPPLE = "position ripple"
    COMMON_RESIDUALS = "residuals that repeat", Kind.READING
    OPPOSED_RESIDUALS = "residuals that depend on the load"
    SMALL_REFUTATION = "description refuted, gains unmoved"
    UNTESTED = "other estimators not tried", Kind.READING
    WEAK_INSTRUMENTS = "weak instruments", Kind.READING
    AUTOCORRELATED = "autocorrelated residuals"
    NOT_SEPARATED = "parameters not separated", Kind.SEPARATION
    MASS_UNSEEN = "payload mass not identifiable"
    FEW_ROWS = "too few rows for tests"
    SCALE_UNTESTED = "torque scale not tested", Kind.READING
    COMMON_SCALE = "common torque scale"
    NO_GRAVITY_SHOWN = "torques without gravity, or a balanced robot"
    WHOLE_NUMBERS = "whole numbers", Kind.UNIT
    MOTOR_SIDE = "torques of the motors", Kind.UNIT
    MODEL_TORQUES = "torques of a model"
    COMMAND_LAG = "command lag", Kind.FILTERED
    SLIGHT_COMMAND_LAG = "slight command lag", Kind.READING
    # other models and estimators, as causes; those of the hypotheses are in their records
    WITHOUT_GRAVITY = "torques without gravity"
    LENGTH = "length"
    GAIN_CHANGE = "gain change"
    TOOL_BODY = "body at the tool"
    BANDWIDTH = "bandwidth"
    SLOW_ROWS = "rows at low speed"
    TWO_STAGE = "two-stage least squares"
    INSTRUMENTS = "instrumental variables"


@dataclass(frozen=True)
class Finding:
    """One finding of a check.

    Attributes
    ----------
    kind : str
        What was found: a :class:`FindingKind`, or what a hypothesis names as a cause.
    joints : tuple of str
        Joints whose gains, delays or drives it is about.
    subject : str
        Payload, sensor, parameter, body or leg that it is about, where there is one.
    values : mapping
        Numbers, names and switches of the sentence; shares and moves as ratios, SI units.
    causes : tuple of Finding
        What explains it; the first counts most, and all have the same effect.
    severity : float
        Of two findings of one kind on a joint, the larger counts.
    moves : float
        Of a note, by how many half widths of its 95 % interval it may move an estimate; the larger stands first.
    """

    kind: str
    joints: tuple[str, ...] = ()
    subject: str = ""
    values: Mapping[str, Any] = field(default_factory=dict, hash=False)
    causes: tuple[Finding, ...] = ()
    severity: float = 0.0
    moves: float = 0.0


def finding_document(finding: Finding) -> dict[str, Any]:
    """Describe a finding as a JSON document."""
    return {
        "kind": str(finding.kind),
        "joints": list(finding.joints),
        "subject": finding.subject,
        "values": dict(finding.values),
        "causes": [finding_document(each) for each in finding.causes],
    }


def which_payload(values: Values) -> str:
    """Add the payload to what is to be checked, where some run has one."""
    return ", which runs carry the payload, and on which body" if values.get("payload", True) else ""
