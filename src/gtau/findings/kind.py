"""Kinds of findings: how bad each is, and what it makes of an estimate."""

from __future__ import annotations

from enum import StrEnum


class Grade(StrEnum):
    """How much a finding matters: for a log, information, a warning or an error; for an estimate, the other values."""

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


class Outcome(StrEnum):
    """Outcomes of judging an estimate, the best first."""

    GIVEN = "given"
    GOOD = "good"
    WEAK = "weak"
    NOT_IDENTIFIABLE = "not identifiable"
    CONTRADICTORY = "contradictory"


class Severity(StrEnum):
    """Severity of a finding, the worst first."""

    ERROR = "error"
    WARNING = "warning"
    INFORMATION = "information"

    @property
    def exit_code(self) -> int:
        """Exit code of ``gtau check`` where this is the worst finding."""
        return {Severity.ERROR: 2, Severity.WARNING: 3, Severity.INFORMATION: 0}[self]


class FindingKind(StrEnum):
    """Kind of a finding; :mod:`gtau.findings.words` puts it into words.

    With the ``topic`` that files show as its kind, the ``severity`` of all findings on that topic, and the ``outcome``
    of an estimate that it is about. What may move an estimate by more than its interval has an outcome, and thereby
    decides verdict, headline and exit code; others are on what the intervals include or on nothing that moves them.
    Kinds with an outcome stand in the order in which they count where several are on one estimate.
    """

    outcome: Outcome | None
    topic: str
    severity: Severity

    def __new__(cls, name: str, *marks: Outcome | Severity | tuple[str, Severity]) -> FindingKind:
        """Make the name of a topic of some severity, or of a kind with an outcome, another topic, or both."""
        made = str.__new__(cls, name)
        made._value_ = name
        made.outcome, made.topic, made.severity = None, "model", Severity.WARNING
        for mark in marks:
            if isinstance(mark, Outcome):
                made.outcome = mark
            elif isinstance(mark, Severity):
                made.topic, made.severity = name, mark
            else:
                made.topic, made.severity = mark
        return made

    # topics, most of which are kinds too
    SEPARATION = "separable parameters", Severity.WARNING
    MODEL = "model", Severity.WARNING  # evidence of the data against the model
    FILTERED = "filtered command", Severity.WARNING
    LIMITS = "joint limits", Severity.WARNING
    UNIT = "unit", Severity.WARNING  # of commands or payloads, doubtful
    READING = "reading", Severity.INFORMATION  # how the log was read: its clock, its layout
    ROBOT = "robot description", Severity.INFORMATION

    # of the logged poses

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
    IMPOSSIBLE_PARAMETERS = "impossible parameters", Outcome.CONTRADICTORY
    # units and signs, which fit the data whatever they are: sizes that no such robot has
    PRIOR_GAIN = "prior gain", Outcome.CONTRADICTORY
    NEGATIVE_GAIN = "negative gain", Outcome.CONTRADICTORY
    GAINS_APART = "gains far apart", Outcome.CONTRADICTORY
    HEAVY_PAYLOAD = "payload too heavy", Outcome.CONTRADICTORY, UNIT
    LARGE_CURRENT = "current too large", Outcome.CONTRADICTORY, UNIT
    STRENGTH = "strength of gravity", Outcome.CONTRADICTORY
    UNLIKE_FILE = "inertias out of scale", Outcome.CONTRADICTORY
    EFFORT = "effort limit", Outcome.CONTRADICTORY
    SMALL_CURRENT = "current too small", Outcome.CONTRADICTORY, UNIT
    WIDE_SCALE = "uncertain scale", Outcome.WEAK
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
    DOUBTFUL_LIMIT = "doubtful effort limit", LIMITS
    CURRENTS_APART = "currents far apart", UNIT
    UNLIKE_LEGS = "unlike legs"
    PRIOR = "contradictory prior"
    SMALL_REFUTATION = "description refuted, gains unmoved"
    AUTOCORRELATED = "autocorrelated residuals"
    NOT_SEPARATED = "parameters not separated", SEPARATION
    MASS_UNSEEN = "payload mass not identifiable"
    NO_BODIES = "no physically consistent parameters"
    SCALE_UNTESTED = "torque scale not tested", READING
    COMMON_SCALE = "common torque scale"
    NO_GRAVITY_SHOWN = "torques without gravity, or a balanced robot", ("model", Severity.INFORMATION)
    WHOLE_NUMBERS = "whole numbers", UNIT
    MOTOR_SIDE = "torques of the motors", UNIT
    MODEL_TORQUES = "torques of a model"
    COMMAND_LAG = "command lag", FILTERED
    SMOOTHED = "smoothed commands", FILTERED
    SLIGHT_COMMAND_LAG = "slight command lag", READING
