"""The hypotheses that every fit is tested against; a new one is a function and a line here."""

from __future__ import annotations

from gtau.estimation.diagnostics.hypotheses.description import ENCODER_ZEROS, GRAVITY
from gtau.estimation.diagnostics.hypotheses.drives import (
    CURRENT_LAG,
    FRICTION_DRIFT,
    FRICTION_SHAPE,
    GAIN_DRIFT,
    SATURATION,
)
from gtau.estimation.diagnostics.hypotheses.hypothesis import Hypothesis
from gtau.estimation.diagnostics.hypotheses.wrenches import WRENCH_OFFSETS, WRENCH_POINTS

HYPOTHESES: tuple[Hypothesis, ...] = (
    FRICTION_SHAPE,
    FRICTION_DRIFT,
    SATURATION,
    GAIN_DRIFT,
    CURRENT_LAG,
    ENCODER_ZEROS,
    GRAVITY,
    WRENCH_OFFSETS,
    WRENCH_POINTS,
)
