"""Findings: what checks report, as data. Verdicts follow from them in one decision, sentences are made last."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

RELATIVE = "of itself"  # unit of a size that is a share of what it changes


class FindingKind(StrEnum):
    """Kind of a finding; :mod:`gtau.estimation.diagnostics.sentences` has the words for each."""

    # against drive gains, in the order of their rank
    NEGATIVE_MASS = "negative mass"
    BASE_UNEXPLAINED = "unexplained base wrench"
    TLS_CONFUSED = "payload lost in noise"
    ALL_NEGATIVE = "all gains negative"
    SWAPPED = "swapped channels"
    LATE = "currents logged late"
    REFUTED = "description refuted"
    UNEXPLAINED = "unexplained current"
    PAYLOAD = "contradictory payload"
    SENSOR = "contradictory torque sensor"
    WHOLE_MASS = "contradictory mass"
    UNSETTLED = "not converged"
    LOST = "lost in noise"
    SIGN_OPEN = "sign open"
    OTHER_ESTIMATOR = "other estimator"
    PRIOR_GAIN = "prior gain"
    EFFORT = "effort limit"
    WIDE_SCALE = "uncertain scale"
    WIDE_RANDOM = "wide interval"
    WIDE_RIPPLE = "wide by ripple"
    WIDE_CAUSE = "wide by an alternative"
    COUPLED = "coupled joint"
    NEGATIVE_GAIN = "negative gain"
    # against delays, parameters, payloads, torque sensors
    DELAY_NOISE = "delay lost in noise"
    DELAY_UNCERTAIN = "uncertain delay"
    INSEPARABLE = "not separable"
    NEAR_ZERO = "near zero"
    UNCERTAIN = "uncertain parameter"
    IMPOSSIBLE = "physically impossible"
    PAYLOAD_MASS = "payload mass"
    PAYLOAD_PARAMETER = "payload parameter"
    SENSOR_SCALE = "sensor scale"
    # notes
    UNLIKE_LEGS = "unlike legs"
    PRIOR = "contradictory prior"
    PRIOR_INERTIA = "contradictory inertias of the robot's file"
    GAINS_APART = "gains far apart"
    POSITION_NOISE = "position noise"
    RIPPLE = "position ripple"
    COMMON_RESIDUALS = "residuals that repeat"
    OPPOSED_RESIDUALS = "residuals that depend on the load"
    SMALL_REFUTATION = "description refuted, gains unmoved"
    UNTESTED = "other estimators not tried"
    WEAK_INSTRUMENTS = "weak instruments"
    AUTOCORRELATED = "autocorrelated residuals"
    IMPOSSIBLE_PARAMETERS = "impossible parameters"
    NOT_SEPARATED = "parameters not separated"
    MASS_UNSEEN = "payload mass not identifiable"
    FEW_ROWS = "too few rows for tests"
    SCALE_UNTESTED = "torque scale not tested"
    COMMON_SCALE = "common torque scale"
    NO_GRAVITY_SHOWN = "torques without gravity, or a balanced robot"
    WHOLE_NUMBERS = "whole numbers"
    MOTOR_SIDE = "torques of the motors"
    MODEL_TORQUES = "torques of a model"
    COMMAND_LAG = "command lag"
    SLIGHT_COMMAND_LAG = "slight command lag"
    # what the model may lack, or the description have wrong
    CUBIC_FRICTION = "cubic friction"
    LOAD_FRICTION = "load-dependent friction"
    STRIBECK_FRICTION = "Stribeck friction"
    VISCOUS_DRIFT = "drifting viscous friction"
    COULOMB_DRIFT = "drifting Coulomb friction"
    SATURATION = "saturation"
    GAIN_DRIFT = "gain drift"
    CURRENT_LAG = "current lag"
    ENCODER_ZERO = "encoder zero"
    GRAVITY_TILT = "gravity tilt"
    GRAVITY_STRENGTH = "gravity strength"
    GRAVITY = "gravity"
    WITHOUT_GRAVITY = "torques without gravity"
    WRENCH_OFFSET = "wrench offset"
    WRENCH_POINT = "wrench point"
    CLOCK = "clock"
    LENGTH = "length"
    GAIN_CHANGE = "gain change"
    BANDWIDTH = "bandwidth"
    SLOW_ROWS = "rows at low speed"
    TWO_STAGE = "two-stage least squares"
    INSTRUMENTS = "instrumental variables"


@dataclass(frozen=True)
class Finding:
    """One finding of a check.

    Attributes
    ----------
    kind : FindingKind
        What was found.
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
    """

    kind: FindingKind
    joints: tuple[str, ...] = ()
    subject: str = ""
    values: Mapping[str, Any] = field(default_factory=dict, hash=False)
    causes: tuple[Finding, ...] = ()
    severity: float = 0.0


def finding_document(finding: Finding) -> dict[str, Any]:
    """Describe a finding as a JSON document."""
    return {
        "kind": finding.kind.value,
        "joints": list(finding.joints),
        "subject": finding.subject,
        "values": dict(finding.values),
        "causes": [finding_document(each) for each in finding.causes],
    }
