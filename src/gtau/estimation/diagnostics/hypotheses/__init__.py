"""The hypotheses that every fit is tested against; a new one is a module, or a function in one, and a line here."""

from __future__ import annotations

from gtau.estimation.diagnostics.alternatives import Hypothesis
from gtau.estimation.diagnostics.hypotheses import description, drives

HYPOTHESES: tuple[Hypothesis, ...] = (
    drives.FRICTION_SHAPE,
    drives.FRICTION_DRIFT,
    drives.SATURATION,
    drives.GAIN_DRIFT,
    drives.CURRENT_LAG,
    description.ENCODER_ZEROS,
    description.POSITION_SCALES,
    description.GRAVITY,
    description.WRENCH_OFFSETS,
    description.WRENCH_POINTS,
)
