"""The effects that every fit is held against."""

from __future__ import annotations

from gtau.estimation.effects.current_lag import CURRENT_LAG
from gtau.estimation.effects.effect import Effect
from gtau.estimation.effects.elasticity import ELASTICITY
from gtau.estimation.effects.encoder_zeros import ENCODER_ZEROS
from gtau.estimation.effects.friction_drift import FRICTION_DRIFT
from gtau.estimation.effects.gain_drift import GAIN_DRIFT
from gtau.estimation.effects.gain_of_run import GAIN_OF_RUN
from gtau.estimation.effects.gravity import GRAVITY
from gtau.estimation.effects.load_friction import LOAD_FRICTION
from gtau.estimation.effects.position import POSITION
from gtau.estimation.effects.position_scales import POSITION_SCALES
from gtau.estimation.effects.saturation import SATURATION
from gtau.estimation.effects.speed import SPEED
from gtau.estimation.effects.torque_scale import TORQUE_SCALE
from gtau.estimation.effects.wrenches import WRENCH_OFFSETS, WRENCH_POINTS

EFFECTS: tuple[Effect, ...] = (
    POSITION,
    SPEED,
    LOAD_FRICTION,
    FRICTION_DRIFT,
    GAIN_DRIFT,
    GAIN_OF_RUN,
    SATURATION,
    CURRENT_LAG,
    ELASTICITY,
    ENCODER_ZEROS,
    POSITION_SCALES,
    GRAVITY,
    TORQUE_SCALE,
    WRENCH_OFFSETS,
    WRENCH_POINTS,
)
