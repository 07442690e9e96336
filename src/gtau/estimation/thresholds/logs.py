"""What is found in the logs."""

from __future__ import annotations

from gtau.estimation.thresholds.threshold import NONE, Threshold

COSTLY_REPAIR = Threshold(
    0.02,
    "share of the samples that a repair drops or interpolates, from which it is worth mending",
    "up to 0.001 (shared logs, but for those recorded by polling)",
    "0.05 and more are refused",
    "a choice between the two",
)
NEAR_SINGULAR = Threshold(
    0.05,
    "distance to a singularity of type 2, below which errors of the model are magnified",
    "0.49 (Orthoglide)",
    "0.001 is refused",
    "a choice: errors are magnified twentyfold",
)
LAG_STD = Threshold(
    4.0,
    "lag of all commands together behind the motion, in standard errors",
    "below 1.5 where it exceeds a sample (UR10e, xMate 7); no lag in 13 sets of shared logs of ten robots",
    "4.4 (UR10e, 20 ms), 8 (Panda, 10 ms), 10 (TX40, 10 ms), 50 and more (dVRK, Orthoglide)",
    "those logs as they are, and behind a low-pass of first order of 5, 10, 20 and 50 ms, found in 2, 5, 6 and 9 of "
    "the 13; the others have commands that are mostly noise, or led the motion by more before",
)
LAG_SAMPLES = Threshold(
    1.0,
    "the same in samples",
    "at most 0.84 (dVRK, polled at 200 Hz)",
    "1.4 (UR10e, 20 ms) to 200 (TX40, 50 ms)",
    "as above",
)
LAG_LEAST = Threshold(
    3e-3,
    "the same in s",
    "at most 1 ms at 1 kHz and more (Panda)",
    "4.1 ms (Orthoglide, low-pass of 5 ms)",
    "as above",
)
LAG_LOSS = Threshold(
    0.01, "share of a command that a low-pass of that lag takes away at the bandwidth", NONE, NONE, "a choice"
)
DELAY_MOTION = Threshold(
    4.0,
    "standard errors of the share of motion in the current's rate of change",
    NONE,
    NONE,
    "tests/estimation/test_verdicts.py",
)
DELAY_STD = Threshold(
    0.25,
    "relative standard deviation of a delay longer than a sample that is believed",
    "0.01 (Orthoglide)",
    "0.3 (-43 +- 12 ms)",
    "Orthoglide; a log reported by a user",
)
