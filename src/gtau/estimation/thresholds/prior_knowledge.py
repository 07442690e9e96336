"""What is known beside the data: data sheets, payloads, likeness of legs, where a body's mass may be."""

from __future__ import annotations

from gtau.estimation.thresholds.threshold import NONE, Threshold

PRIOR_FACTOR = Threshold(
    2.0,
    "gain over its prior, or the inverse",
    "1.1 (data sheets are right to 10 %)",
    "1000 (mA for A)",
    "faults; the paper's introduction",
)
EFFORT_FACTOR = Threshold(2.0, "rms torque over the joint's limit of effort", "below 1", "1000 (g for kg)", "faults")
PAYLOAD_MOVES = Threshold(
    0.01,
    "relative move of the gains when a known payload parameter is estimated instead",
    "below 0.01",
    "above (a parameter 50 % off)",
    "faults",
)
HIDDEN_KNOWN = Threshold(
    0.01,
    "share of the known parameters' torque that no unknown one explains, below which a refusal names it as the cause",
    "0.03 to 0.20 (arm and five-bar of tests/estimation/test_scale.py, priors of moments and inertias)",
    "0.0022 (UPV, CAD masses)",
    "those, and benchmarks/zoo.py --only upv_gains",
)
LEG_PROBABILITY = Threshold(1e-3, "probability that legs which are alike differ by as much", NONE, NONE, "a level")
LEG_DIFFERENCE = Threshold(20.0, "difference of a parameter between like legs, per cent", NONE, NONE, "a choice")
LEG_DIFFERENCE_STD = Threshold(5.0, "the same in standard deviations", NONE, NONE, "a level")
OVERHANG = Threshold(
    0.5,
    "reach of a body's mass beyond the ball around its joints, in lengths of the robot's longest link",
    "median 0.02, 97 % of bodies up to 0.5, at most 1.06 (a Panda file with made-up inertias)",
    "2 (a wrist of 2 kg with a radius of gyration of 1.2 m: UR10e, without the bound)",
    "571 bodies of 62 URDF files (example-robot-data), those of 0.5 % of the robot's mass and more",
)
LAST_OVERHANG = Threshold(
    1.2,
    "the same of a body that no other follows, whose length no joint shows",
    "median 0.43, at most 1.14",
    NONE,
    "150 bodies of the same files",
)
