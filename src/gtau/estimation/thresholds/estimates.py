"""Thresholds of what is estimated: accuracy, lack of fit, plausible sizes, prior knowledge."""

from __future__ import annotations

from gtau.estimation.thresholds import Threshold

# How well gains, parameters and friction terms must be known, and by what they are named.

ACCURACY = Threshold(
    0.03,
    "half the relative width of a gain's 95 % interval",
    healthy="0.11 to 0.17 % (Orthoglide)",
    faulty="above 3 % (faults)",
    evidence="a choice: the accuracy usually asked of a payload or a contact force; --accuracy changes it",
)
LOST_GAIN = Threshold(
    0.5, "relative random standard deviation of a gain", healthy="below 0.05 (UR10e pairs)", evidence="a choice"
)
WEAK_PARAMETER = Threshold(0.2, "relative standard deviation of a parameter", evidence="a choice")
NEGATIVE_STD = Threshold(
    4.0,
    "standard deviations below zero of a parameter that cannot be negative",
    faulty="11 (an armature of -0.0022 +- 0.0002 kg m2 from a log filtered wrongly)",
    evidence="a level: one in 30,000 by chance",
)
NAMED_SHARE = Threshold(
    0.5,
    "share of the model part in a gain's variance from which its cause is named",
    evidence="a choice: the larger part is named",
)
FRICTION_TERM_GAIN = Threshold(
    0.02,
    "share of a joint's residual that a friction term takes away",
    healthy="0 (Orthoglide)",
    faulty="0.5 and more (UR10e pairs)",
    evidence="300 Monte Carlo repetitions on the Orthoglide logs",
)
FRICTION_TERM_STD = Threshold(1 / 3, "relative standard deviation of a friction term", evidence="a level")
TERM_T = Threshold(
    2.5,
    "standard errors, over blocks left out, by which friction with a term is better",
    healthy="above in 0 of 80 logs with white or coloured noise, 4 of 80 with ripple or a wrong load",
    faulty="2.6 to 13 (UR10e, TX40, Panda); above in 98 to 100 % (presliding, load), 78 to 98 % (Stribeck) of 40 logs "
    "each",
    evidence="benchmarks/friction.py; at 2.0 false terms are 12 to 24 % with ripple or a wrong load, at 3.0 Stribeck "
    "is found in 65 to 92 %",
)
POSSIBLE = Threshold(
    3.0,
    "friction at rest beyond that of sliding, in rms torques of the motor, from which it is not taken",
    healthy="1.1 and less (nine sets of shared logs)",
    faulty="20 (motor 7 of an xMate7 Pro: another log was predicted with an error of 2100 %, without it 58 %)",
    evidence="shared logs, benchmarks/zoo.py",
)
TERM_SHARE = Threshold(
    0.05,
    "share of the squared error of blocks left out that a term of friction takes away",
    healthy="0.02 lets false terms into 12 % of the logs with ripple instead of 5 %, and finds no more of the right "
    "ones",
    faulty="0.2 and more (UR10e, TX40, Panda)",
    evidence="benchmarks/friction.py",
)


# Whether the model explains the data.

MISFIT = Threshold(
    0.25,
    "share of a joint's current that is unexplained, gains estimated",
    healthy="up to 0.045 (UR10e pairs)",
    faulty="0.5 and more (sign flipped in one run, swapped channels)",
    evidence="faults, UR10e pairs",
)
DETERMINED = Threshold(
    2.0,
    "standard deviations of an inertial parameter, below all of which logs that leave more than a torque say nothing",
    healthy="9 to 12 of 48 to 50 are above (xMate7 Pro of 10 s, Sawyer, Panda at 30 Hz), 5 (KUKA Med 7, poor)",
    faulty="none (3 s of an LWR 4, which leave 7 times a torque)",
    evidence="shared logs, tests/estimation/test_short_logs.py",
)
MISFIT_GIVEN = Threshold(
    0.5,
    "share of a joint's torque that is unexplained, gains given",
    healthy="up to 0.14 (TX40)",
    faulty="0.98 (a log filtered wrongly)",
    evidence="docs/evidence/measured.md; issue reports of a Franka Panda log",
)
BASE_MISFIT = Threshold(
    0.15,
    "share of the forces, or of the moments, on a floating base that is unexplained",
    healthy="up to 0.011 (held or standing)",
    faulty="0.28 and more (wrong axes, point or body of a wrench, the sign of one of two), 0.22 (a foot left out)",
    evidence="the arm of tests/estimation/test_wrenches.py and test_floating.py; no logs of a real floating base",
)
LACKING = Threshold(
    1.3,
    "standard errors by the jackknife over those of white residuals, from which lengths, ripple and swapped "
    "channels are tried",
    healthy="1.0 (Orthoglide), up to 1.2 (clean)",
    faulty="1.8 to 3.5 (faults)",
    evidence="faults, clean",
)
FEWEST_FOR_TESTS = Threshold(
    3.0,
    "rows for each unknown in the middle of the runs, with fewer of which alternatives fit the noise and are not tried",
    healthy="11 (TX40), 16 to 48 (KUKA, Panda, UR10e, five-bar, Orthoglide, and logs that rest), 69 (dVRK), 447 (UPV)",
    evidence="shared logs, five-bar; the level is a choice",
)
INFLATED = Threshold(
    1.8,
    "the same, from which the summary says so",
    healthy="up to 1.7 (320 simulated experiments of 24 s, benchmarks/false_alarms.py), 1.2 (clean)",
    faulty="1.9, 2.2 (UR10e pairs, whose friction is richer than the model)",
    evidence="benchmarks/false_alarms.py, clean, UR10e pairs",
)


# How probable and how large alternatives may be before the data; each hypothesis states what is plausible of it.


# What is known beside the data: data sheets, payloads, likeness of legs, the robot file, where a body's mass may be.

PRIOR_FACTOR = Threshold(
    2.0,
    "gain over its prior, or the inverse",
    healthy="1.1 (data sheets are right to 10 %)",
    faulty="1000 (mA for A)",
    evidence="faults; the paper's introduction",
)
GAINS_APART = Threshold(
    15.0,
    "gain of a joint over the next smaller one, turning joints and slides each among themselves",
    healthy="up to 1.3 (Orthoglide, UR10e, Rokae, dVRK), 1.5 (AIRBOT Play); within 5 by gears and motors (Puma 560, "
    "WAM, KUKA)",
    faulty="15 and more (one of several within a factor of 4 in counts, 60; in %, 100; in mA, 1000)",
    evidence="shared logs, data sheets; the factors between units",
)
FILE_FACTOR = Threshold(
    2.0,
    "rms of the identified first moments over that of the robot's file, or the inverse",
    healthy="1.00 (UR10e), 1.19 (Aliengo), 1.20 (KUKA), 1.34 (xMate 7 Pro)",
    faulty="3.3 (a payload of 1.5 kg stated as 5), 1000 (g for kg, N mm for N m)",
    evidence="shared logs with their URDF and MJCF files, tests/estimation/test_unit_checks.py",
)
FILE_ALIKE = Threshold(
    1.5,
    "factor of a moment over that of all, or the inverse, within which it has that factor",
    healthy="1.6 and 4.7 (the smallest moment of KUKA and UR10e), else up to 1.3",
    evidence="the same logs",
)
FILE_SHARE = Threshold(
    2 / 3,
    "share of the moments within FILE_ALIKE, from which a factor is one of all",
    healthy="2 of 3, 3 of 4, 3 of 4, 3 of 3 (the same logs)",
    faulty="1, 1 and 3 of 6 (files whose link 4, 2 or 3 is ten times too heavy, which the audit names)",
    evidence="the same logs, the arm of tests/support/stated_arm.py",
)
OTHER_UNIT = Threshold(
    10.0, "factor from which a unit is wrong", healthy="up to 1.4 (torques of AIRBOT Play)", evidence="units of files"
)
EFFORT_FACTOR = Threshold(
    2.0, "rms torque over the joint's limit of effort", healthy="below 1", faulty="1000 (g for kg)", evidence="faults"
)
PAYLOAD_MOVES = Threshold(
    0.01,
    "relative move of the gains when a known payload parameter is estimated instead",
    healthy="below 0.01",
    faulty="above (a parameter 50 % off)",
    evidence="faults",
)
IN_METRES = Threshold(
    4.0,
    "times, by which a first moment is nearer to the mass times what is stated than to this, which was rather in m",
    faulty="13 to 2000 (payloads of 0.5 to 5 kg)",
    evidence="arm of tests/support/stated_arm.py",
)
LEAST_OTHERS = Threshold(
    1e-3,
    "share of all else in an estimate that has a prior, below which it is the prior",
    healthy="0.01 (data ten times less certain than the prior) and more",
    faulty="0, up to rounding (a prior that alone sets the scale)",
    evidence="arm of tests/support/stated_arm.py",
)
HIDDEN_KNOWN = Threshold(
    0.01,
    "share of the known parameters' torque that no unknown one explains, below which a refusal names it as the cause",
    healthy="0.03 to 0.20 (arm and five-bar of tests/estimation/test_scale.py, priors of moments and inertias)",
    faulty="0.0022 (UPV, CAD masses)",
    evidence="those, and benchmarks/zoo.py --only upv_gains",
)
OWN_BODY = Threshold(
    0.1,
    "share of the torque of measured wrenches that no parameter explains, below which a tool may cause it in all runs",
    healthy="0.49 to 0.69 (with and without a tool of 3 kg); 0.010 to 0.089 (with it, and with 1.02 to 1.2 of it)",
    faulty="0.0034 to 0.037 (the same tool in every run, its force noisy by 0.05 to 5 N); 0.24 and more with a wrong "
    "point, axes or body",
    evidence="the arm of tests/estimation/test_wrenches.py, 20 s with a fixed base, two to three sets of logs; held "
    "together with ANSWERED",
)
ANSWERED = Threshold(
    0.1,
    "share of the squares of what OWN_BODY leaves to which the currents answer, below which it is but noise",
    healthy="0.995 and more (with and without); 0.26 to 0.998 (with 1.02 to 1.2 of it)",
    faulty="0.0003 to 0.030 (the same tool)",
    evidence="the same logs",
)
LEG_PROBABILITY = Threshold(1e-3, "probability that legs which are alike differ by as much", evidence="a level")
LEG_DIFFERENCE = Threshold(20.0, "difference of a parameter between like legs, per cent", evidence="a choice")
LEG_DIFFERENCE_STD = Threshold(5.0, "the same in standard deviations", evidence="a level")
OVERHANG = Threshold(
    0.5,
    "reach of a body's mass beyond the ball around its joints, in lengths of the robot's longest link",
    healthy="median 0.02, 97 % of bodies up to 0.5, at most 1.06 (a Panda file with made-up inertias)",
    faulty="2 (a wrist of 2 kg with a radius of gyration of 1.2 m: UR10e, without the bound)",
    evidence="571 bodies of 62 URDF files (example-robot-data), those of 0.5 % of the robot's mass and more",
)
LAST_OVERHANG = Threshold(
    1.2,
    "the same of a body that no other follows, whose length no joint shows",
    healthy="median 0.43, at most 1.14",
    evidence="150 bodies of the same files",
)
INERTIA_CHANCE = Threshold(
    0.05,
    "chance that a file which is right has any base parameter contradicted, all being tested together",
    healthy="2 of 30 simulated arms, one parameter each of 19 that are tested",
    faulty="7 to 9 of 19 parameters of ten arms whose file has a link 30 % too heavy; z of 4 to 59 (UR10e, Panda)",
    evidence="arms of tests/estimation/test_inertia_audit.py, UR10e with its driver's URDF, Panda with MuJoCo "
    "Menagerie's MJCF",
)
INERTIA_EXPLAINED = Threshold(
    0.95,
    "share of the torque variance which the file adds that freed links explain, from which on no other is named",
    healthy="the heavy link alone (ten simulated arms, mass 30 % wrong)",
    faulty="two links (UR10e); the rotors and two links (Panda); four calves (Aliengo)",
    evidence="tests/estimation/test_inertia_audit.py, shared logs",
)
