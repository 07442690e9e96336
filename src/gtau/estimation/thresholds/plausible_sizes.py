"""How large alternatives may plausibly be: standard deviations before the data, from experience and data sheets."""

from __future__ import annotations

from gtau.estimation.thresholds.threshold import NONE, Threshold

ALTERNATIVE_PRIOR = Threshold(
    0.2,
    "probability of a group of alternatives before the data",
    "rms z between the gains of the UR10e pairs: 0.89 with 0.5, 0.93 with 0.2, 0.95 with 0.1",
    NONE,
    "UR10e pairs; simulated gains without a departure had 0.65 and 0.67 with 0.5 (benchmarks/calibration.py)",
)
PLAUSIBLE_CUBIC = Threshold(
    0.2, "cubic friction at three times the rms speed, of the friction", NONE, NONE, "experience"
)
PLAUSIBLE_LOAD_FRICTION = Threshold(
    0.05, "friction coefficient of the load", "0.02 to 0.1 in strain-wave gears", NONE, "UR10e pairs"
)
PLAUSIBLE_STRIBECK = Threshold(0.3, "Stribeck friction at rest, of the friction", NONE, NONE, "experience")
STRIBECK_SPEED = Threshold(0.1, "Stribeck speed, in rms speeds", NONE, NONE, "experience")
PLAUSIBLE_FRICTION_DRIFT = Threshold(0.1, "relative change of friction along a run", NONE, NONE, "experience")
PLAUSIBLE_SATURATION = Threshold(
    0.03,
    "relative fall of a torque constant up to twice the rms current",
    "0 to 0.05",
    NONE,
    "data sheets of servo motors",
)
PLAUSIBLE_GAIN_DRIFT = Threshold(
    0.005,
    "relative change of a torque constant along a run",
    "0.001 a kelvin of the magnets",
    NONE,
    "data sheets of servo motors",
)
PLAUSIBLE_GAIN_CHANGE = Threshold(
    0.005, "the same between runs", "0.001 a kelvin of the magnets", NONE, "data sheets of servo motors"
)
PLAUSIBLE_LAG = Threshold(
    1e-4,
    "coefficient of the torque's second derivative, s2",
    "elastic at 16 Hz, or a filter of 14 ms",
    NONE,
    "experience",
)
PLAUSIBLE_ZERO = Threshold(0.5, "error of an encoder's zero, degrees or mm", NONE, NONE, "experience")
PLAUSIBLE_TILT = Threshold(1.0, "tilt of the base, degrees", NONE, NONE, "experience")
PLAUSIBLE_GRAVITY = Threshold(
    0.2, "deviation of local gravity from the standard, per cent", "0.26 at most on Earth", NONE, "latitude and height"
)
