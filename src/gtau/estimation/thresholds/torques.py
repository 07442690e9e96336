"""Thresholds of what torques that are logged mean: their scale, and what 'effort' holds."""

from __future__ import annotations

from gtau.estimation.thresholds import Threshold

ALIKE = Threshold(
    0.05,
    "probability that the torque scales of joints which share one differ by as much",
    "0.4 to 0.9 (five-bar with a mass 25 % off)",
    "below 1e-4 (AIRBOT Play: 1.5 beside 0.83)",
    "tests/estimation/test_torque_scale.py",
)
