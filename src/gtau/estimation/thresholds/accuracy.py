"""How well gains, parameters and friction terms must be known, and by what they are named."""

from __future__ import annotations

from gtau.estimation.thresholds.threshold import NONE, Threshold

ACCURACY = Threshold(
    0.03,
    "half the relative width of a gain's 95 % interval",
    "0.11 to 0.17 % (Orthoglide)",
    "above 3 % (faults)",
    "a choice: the accuracy usually asked of a payload or a contact force; --accuracy changes it",
)
LOST_GAIN = Threshold(0.5, "relative random standard deviation of a gain", "below 0.05 (UR10e pairs)", NONE, "a choice")
WEAK_PARAMETER = Threshold(0.2, "relative standard deviation of a parameter", NONE, NONE, "a choice")
NEGATIVE_STD = Threshold(
    4.0,
    "standard deviations below zero of a parameter that cannot be negative",
    NONE,
    "11 (an armature of -0.0022 +- 0.0002 kg m2 from a log filtered wrongly)",
    "a level: one in 30,000 by chance",
)
NAMED_SHARE = Threshold(
    0.5,
    "share of the model part in a gain's variance from which its cause is named",
    NONE,
    NONE,
    "a choice: the larger part is named",
)
FRICTION_TERM_GAIN = Threshold(
    0.02,
    "share of a joint's residual that a friction term takes away",
    "0 (Orthoglide)",
    "0.5 and more (UR10e pairs)",
    "300 Monte Carlo repetitions on the Orthoglide logs",
)
FRICTION_TERM_STD = Threshold(1 / 3, "relative standard deviation of a friction term", NONE, NONE, "a level")
