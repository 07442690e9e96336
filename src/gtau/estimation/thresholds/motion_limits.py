"""Whether a log can be of this robot ("shared": the logs of UR10e, TX40, Orthoglide and Aliengo)."""

from __future__ import annotations

from gtau.estimation.thresholds.threshold import NONE, Threshold

BEYOND_LIMITS = Threshold(
    0.02,
    "motion outside a joint's limits, of their range, from which a note says so",
    "never outside (shared)",
    NONE,
    "a choice: less is the offset of an encoder",
)
FAR_BEYOND_LIMITS = Threshold(
    1.0,
    "the same, from which the log is refused: another unit, joint or robot",
    "never outside (shared)",
    "57 times the share of the range that is used (deg read as rad)",
    "tests/estimation/test_motion_limits.py",
)
TOO_FAST = Threshold(
    3.0,
    "rms speed over the joint's limit of speed, from which the log is refused",
    "0.57 (shared)",
    "57 (deg read as rad), 1000 (ms read as s)",
    "the factors between units",
)
FASTEST_TURN = Threshold(
    30.0,
    "rms speed of a joint without limit, rad/s, from which the clock or unit is wrong",
    "1.4 (Aliengo), 10 (fast deltas)",
    "77 (Aliengo, deg read as rad)",
    "shared logs; the speed of deltas from experience",
)
FASTEST_SLIDE = Threshold(10.0, "the same, m/s", "0.34 (shared)", "340 (ms read as s)", "shared logs")
FARTHEST_TURN = Threshold(
    40.0,
    "range of a joint's positions, rad, from which they are rather in deg",
    "1.1 (Aliengo) to 6.0 (UR10e)",
    "62 to 340 (those, deg read as rad)",
    "shared logs",
)
FARTHEST_SLIDE = Threshold(
    30.0,
    "the same of a prismatic joint, in lengths of the robot, from which they are rather in mm",
    "0.40 to 0.64 (Orthoglide)",
    "400 to 640 (Orthoglide, mm read as m)",
    "shared logs",
)
LEAST_TURN = Threshold(
    0.06,
    "range of the joint that turns most, rad, below which positions said to be in deg are rather in rad",
    "0.3 to 6.0",
    "0.005 to 0.1 (rad read as deg)",
    "UR10e, TX40, Panda and Aliengo logs",
)
LEAST_SLIDE = Threshold(
    3e-3,
    "the same of prismatic joints, in lengths of the robot, where positions are said to be in mm",
    "0.40 to 0.64 (Orthoglide)",
    "0.0004 to 0.0006 (m read as mm)",
    "shared logs",
)
