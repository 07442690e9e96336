"""What torques and logged poses say of the geometry ("UPV": the logs of a real 3UPS+RPU described in docs/zoo.md)."""

from __future__ import annotations

from gtau.estimation.thresholds.threshold import NONE, Threshold

LENGTH_SHARE = Threshold(
    0.1, "the same, of another length", "below 0.05 (clean)", "0.24 to 0.96 (bars 2 % off)", "faults"
)
LENGTH_CHANGE = Threshold(
    0.005, "relative change of that length", "below 0.005 where residuals are tiny", "0.02", "faults"
)
LENGTH_TRIED = Threshold(
    0.02,
    "length over the longest of the robot, below which it is not tried",
    "0.042 and more (17 robots of the catalog and of the shared data): all are tried",
    NONE,
    "these robots; docs/catalog.md",
)
LENGTH_ALIKE = Threshold(
    0.8,
    "share that another length explains over the largest, from which both are equally likely",
    "0.85 to 1, of the length that is wrong",
    "0.46 (a bar 2 % off, the next best length)",
    "tests/acceptance/test_faults.py, tests/estimation/test_geometry.py (a forearm 1.4 % off)",
)
GEOMETRY_SHARE = Threshold(
    0.5,
    "share of the variance of the pose residuals that a length or an encoder zero explains, of what is left",
    "0.02 (UPV, the controller's pose), 0.29 (its tracker), 0.28 (its tracker taken for the controller's frame)",
    "0.82 to 0.99999 (UPV, one radius or three 26 mm off), above 0.9 (simulated, 1 % off)",
    "tests/estimation/test_geometry.py",
)
GEOMETRY_STD = Threshold(
    6.0,
    "change of a length or zero that explains the pose, in standard deviations",
    "up to 9 where the share is small (UPV, tracker)",
    "24 to 30,000 (UPV, 26 mm off)",
    "tests/estimation/test_geometry.py; the share decides where systematic residuals of a tracker are certain",
)
GEOMETRY_CHANGE = Threshold(
    0.005,
    "that change, of the length, of the robot's mean length (zeros in m) or in rad",
    "0.000003 (UPV, the controller's pose)",
    "0.01 (simulated), 0.08 (UPV, 26 mm off)",
    "a choice: what is less is not worth another robot file",
)
GEOMETRY_RMS = Threshold(
    0.01,
    "distance between logged and computed positions, rms, of the robot's mean length, above which a pose that no "
    "length explains does not confirm the geometry",
    "0.000002 (UPV, the controller's pose), 0.003 (its tracker)",
    "0.02 (UPV, its tracker taken for the controller's frame)",
    "UPV",
)
GEOMETRY_LIKELY = Threshold(
    0.5,
    "share that a constant explains to first order, over GEOMETRY_SHARE, from which it is fitted for good",
    NONE,
    "a fit explains at most 1.09 times what the first order says, where it is more than GEOMETRY_SHARE",
    "tests/estimation/test_geometry.py, UPV",
)
GEOMETRY_ALIKE = Threshold(
    1.5,
    "squares of the residuals that another constant leaves, over those that the best leaves: with less it is as likely",
    "1.02 (a length and a zero that act alike), 1.2 (a tracker taken for the controller's frame)",
    "3 (UPV, tracker), 43 and more elsewhere",
    "tests/estimation/test_geometry.py, UPV",
)
GEOMETRY_FREE = Threshold(
    1e-3,
    "rms effect of a constant on the pose that frames and other free constants leave, over its effect",
    "0.011 and more, of constants that have an effect of their own",
    "0.00015 and less, of constants that have none",
    "tests/estimation/test_geometry.py, UPV",
)
POSE_DELAY_STD = Threshold(
    0.02,
    "standard deviation of the delay of a pose, s, above which it is not shown",
    NONE,
    NONE,
    "a choice: two samples of a camera at 100 Hz",
)
