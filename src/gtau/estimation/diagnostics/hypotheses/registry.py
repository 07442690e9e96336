"""The hypotheses that every fit is held against; a new one is a file and a line here."""

from __future__ import annotations

from gtau.estimation.diagnostics.hypotheses.current_lag import CURRENT_LAG
from gtau.estimation.diagnostics.hypotheses.encoder_zeros import ENCODER_ZEROS
from gtau.estimation.diagnostics.hypotheses.friction_drift import FRICTION_DRIFT
from gtau.estimation.diagnostics.hypotheses.friction_shape import FRICTION_SHAPE
from gtau.estimation.diagnostics.hypotheses.gravity import GRAVITY
from gtau.estimation.diagnostics.hypotheses.hypothesis import Hypothesis
from gtau.estimation.diagnostics.hypotheses.torque_constant import GAIN_DRIFT, SATURATION

HYPOTHESES: tuple[Hypothesis, ...] = (
    FRICTION_SHAPE,
    FRICTION_DRIFT,
    SATURATION,
    GAIN_DRIFT,
    CURRENT_LAG,
    ENCODER_ZEROS,
    GRAVITY,
)
