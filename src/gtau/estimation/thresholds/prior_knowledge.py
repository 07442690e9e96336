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
OWN_BODY = Threshold(
    0.1,
    "share of the torque of measured wrenches that no parameter explains, below which a tool may cause it in all runs",
    "0.49 to 0.69 (with and without a tool of 3 kg); 0.010 to 0.089 (with it, and with 1.02 to 1.2 of it)",
    "0.0034 to 0.037 (the same tool in every run, its force noisy by 0.05 to 5 N); 0.24 and more with a wrong point, "
    "axes or body",
    "the arm of tests/estimation/test_wrenches.py, 20 s with a fixed base, two to three sets of logs; held together "
    "with ANSWERED",
)
ANSWERED = Threshold(
    0.1,
    "share of the squares of what OWN_BODY leaves to which the currents answer, below which it is but noise",
    "0.995 and more (with and without); 0.26 to 0.998 (with 1.02 to 1.2 of it)",
    "0.0003 to 0.030 (the same tool)",
    "the same logs",
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
