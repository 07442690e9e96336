"""Whether the model explains the data."""

from __future__ import annotations

from gtau.estimation.thresholds.threshold import Threshold

MISFIT = Threshold(
    0.25,
    "share of a joint's current that is unexplained, gains estimated",
    "up to 0.045 (UR10e pairs)",
    "0.5 and more (sign flipped in one run, swapped channels)",
    "faults, UR10e pairs",
)
MISFIT_GIVEN = Threshold(
    0.5,
    "share of a joint's torque that is unexplained, gains given",
    "up to 0.14 (TX40)",
    "0.98 (a log filtered wrongly)",
    "docs/measured.md; issue reports of a Franka Panda log",
)
BASE_MISFIT = Threshold(
    0.15,
    "share of the forces, or of the moments, on a floating base that is unexplained",
    "up to 0.011 (held or standing), 0.021 (in flight)",
    "0.28 and more (wrong axes, point or body of a wrench, the sign of one of two), 0.22 (a foot left out)",
    "the arm of tests/estimation/test_wrenches.py and test_floating.py; no logs of a real floating base",
)
LACKING = Threshold(
    1.3,
    "standard errors by the jackknife over those of white residuals, from which lengths, ripple and swapped "
    "channels are tried",
    "1.0 (Orthoglide), up to 1.2 (clean)",
    "1.8 to 3.5 (faults)",
    "faults, clean",
)
INFLATED = Threshold(
    1.8,
    "the same, from which the summary says so",
    "up to 1.7 (320 simulated experiments of 24 s, benchmarks/false_alarms.py), 1.2 (clean)",
    "1.9, 2.2 (UR10e pairs, whose friction is richer than the model)",
    "benchmarks/false_alarms.py, clean, UR10e pairs",
)
