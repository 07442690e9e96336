"""Thresholds of what refutes the description of robot and logs, the meaning of torques, or the choice of estimator."""

from __future__ import annotations

from gtau.estimation.thresholds import Threshold

CONTRADICTED = Threshold(
    8.0,
    "log-likelihood that is lost without an effect that contradicts the description",
    evidence="a level; see docs/evidence/mixed-model.md",
)
CLOSE = Threshold(
    3.0, "log-likelihood by which a cause is likelier, up to which the other is said too", evidence="20 times as likely"
)
LARGEST_MOVE = Threshold(
    0.5,
    "relative move of a gain by all effects, beyond which the estimates are not moved",
    healthy="0.06 (realism, nine effects at once)",
    evidence="docs/lookup/causes.md; effects are small corrections",
)
HARMLESS_SHARE = Threshold(
    0.3,
    "share of the residual variance that it explains, up to which it is information",
    healthy="0.04 (dVRK), 0.11 to 0.16 (UR10), 0.19 (xMate7 Pro)",
    faulty="0.55 (a Sawyer, zero of joint 2 off by 5.7 degrees), 0.65 (tilted by 4)",
    evidence="shared logs",
)
REFUTED_STD = Threshold(
    6.0,
    "size of a description alternative in standard deviations",
    healthy="up to 4.8 (UR10e pairs), 3.2 (Orthoglide)",
    faulty="8 to 44 (faults)",
    evidence="faults, UR10e pairs, Orthoglide",
)
REFUTED_SHARE = Threshold(
    0.05,
    "share of the residual variance that it explains",
    healthy="up to 0.03 at more than 6 standard deviations with moves above the accuracy: none (UR10e pairs); 0.06 to "
    "0.21 beside a lag or elasticity of 0.07 to 0.39, which then explains it",
    faulty="0.06 to 0.86 (faults)",
    evidence="faults, UR10e pairs; a dVRK arm, and currents low-passed or joints elastic in benchmarks/calibration.py",
)
GRAVITY_SHARE = Threshold(
    0.5,
    "share of the residual variance, in the geometric mean of all joints or of one that it helps, that gravity along "
    "another axis takes away",
    healthy="up to 0.07 (dVRK, whose cables repeat), 0.013 (Rokae), 0 (UR10e, TX40, Panda, KUKA, Orthoglide, five-bar)",
    faulty="0.88 and more along another axis, 0.84 and 0.995 tilted by 11 degrees (UR10e); 0.53 and more (five-bar, "
    "Orthoglide, with a payload), nothing from torques of these two, which hardly see it",
    evidence="shared logs; tests/estimation/test_gravity.py, torques and currents simulated with 0.3 % of noise",
)
GRAVITY_LEAST = Threshold(
    5.0,
    "angle from the stated gravity, degrees, below which a base is not level and the linear test speaks",
    evidence="five times a plausible tilt",
)
GRAVITY_ALIKE = Threshold(
    1.05,
    "residual variance over that of the best axis, below which another one explains as much",
    healthy="1.00 (either normal of a planar robot)",
    faulty="1.5 and more (the next axis of a UR10e)",
    evidence="tests/estimation/test_gravity.py",
)
GRAVITY_MISFIT = Threshold(
    0.1,
    "share of a joint's current or torque that is unexplained, from which gravity along other axes is tried",
    healthy="0.002 to 0.11 (Orthoglide, UR10e, dVRK, TX40), 0.57 (Panda polled at few hertz)",
    faulty="0.08 to 0.98 (gravity along another axis); where it is less, a tilt helps",
    evidence="the same; it decides on some seconds of work, not on an outcome",
)
OTHER_SCALE = Threshold(
    0.2,
    "other scale of one joint's torques, of itself and beyond three standard deviations, that contradicts them",
    healthy="up to 0.15 (KUKA), 0.12 (Panda), 0.10 and less (TX40, Rokae, xMate7 Pro, UPV): 56 joints; more on a leg "
    "of an Aliengo, of whose residuals it explains nothing",
    faulty="0.32 to 0.35 (torques of one joint times 0.7: Panda j2, j3, j4, TX40 motor 3), 0.12 and none (its motors "
    "2 and 4)",
    evidence="those logs as they are, and altered",
)
SWAPPED = Threshold(
    0.5,
    "unexplained share with the other joint's current over that with its own",
    healthy="far above 1",
    faulty="below 0.3",
    evidence="tests/estimation/test_swapped_channels.py",
)
APART = Threshold(
    3.5,
    "standard deviations between a declared value of a payload and what all else gives",
    healthy="below 3 (clean, UR10e pairs)",
    faulty="10 and more (3 % wrong mass of one of two payloads)",
    evidence="clean, faults, 300 Monte Carlo repetitions on the Orthoglide logs",
)
NOISE_STD = Threshold(
    4.0,
    "Hausman's statistic of instrumental variables against the estimator used, of a parameter that moves by more than "
    "its standard deviation, from which noise of the positions is named",
    healthy="no parameter of UR10e pairs, Orthoglide, TX40 or Panda moves by so much; up to 3.9 where it moves less "
    "(UR10e)",
    faulty="4.2 and 4.5 (five-bar, positions noisy by 0.4 mrad behind a filter of 100 Hz, 16 s), 7 to 18 (Aliengo, "
    "whose command is made from the measured position)",
    evidence="shared logs, tests/estimation/test_other_estimators.py",
)
DIFFERENT_STD = Threshold(
    3.0,
    "standard deviations by which another estimator finds a parameter otherwise, from which that is an alternative",
    evidence="a level: one in 370 by chance; differences in a gain are alternatives whatever their size",
)
LOAD_LEFT = Threshold(
    0.5,
    "part of the residual variance, geometric mean of all joints, that is left with the load of one more run unknown, "
    "or with payloads on another body",
    healthy="0.99 and more (UR10e, two pairs); on another body 0.95 (dVRK), 0.999 (Orthoglide), 19 (UR10e) and more",
    faulty="0.025 to 0.11 (UR10e: 2.8 kg not declared, or declared and absent), 0.012 (an arm, on its forearm)",
    evidence="shared logs; tests/estimation/test_tool_bodies.py",
)
REVERSED_LEFT = Threshold(
    0.7,
    "part of the residual variance, geometric mean of all joints, that is left with one torque reversed",
    evidence="LWR 4 with joint 1 reversed, and shared logs of torques as they are",
)
TURNED_LEFT = Threshold(
    0.5,
    "the same with an angle measured from another link",
    evidence="an arm with a parallelogram declared serial, and shared logs as they are",
)
LIKELY_SHARES = Threshold(
    1.92,
    "log likelihood below the largest that bounds a 95 % interval of one unknown",
    healthy="half the 95 % quantile of chi-square with one degree of freedom",
    faulty="the same",
    evidence="Wilks' theorem",
)
SIGN_STD = Threshold(2.0, "size of a coefficient in standard deviations, above which it has a sign", evidence="a level")
RETRIED = Threshold(
    2.0,
    "share that a joint's columns leave over that of its own parameters: more is tried with other columns",
    evidence="a choice",
)
HARDLY_NEGATIVE = Threshold(
    0.05, "most negative value over the largest of a column of magnitudes behind a filter", evidence="a choice"
)
TINY = Threshold(1e-9, "share of a torque that is rounding", evidence="a choice")
MASS_ABSENT = Threshold(
    0.5,
    "part of a declared mass by which the load of a run differs: below it the mass is wrong, above it the body",
    healthy="0.09 (a mass stated 10 % too large, which the payload's own check names)",
    faulty="1.0 (declared and absent)",
    evidence="faults",
)
LOAD_ALIKE = Threshold(
    1.01,
    "the same over the least of all runs, from which on another run explains less",
    healthy="1.0 (either run of a pair)",
    faulty="1.2 and more (of two pairs)",
    evidence="UR10e pairs",
)
UNFELT_PAYLOAD = Threshold(
    1.1,
    "residual of the currents without the payload over that with it",
    healthy="16 (UR10e, actual currents)",
    faulty="1.03 (UR10e, target currents, which never feel the payload)",
    evidence="UR10e logs",
)
ALIKE = Threshold(
    0.05,
    "probability that the torque scales of joints which share one differ by as much",
    healthy="0.4 to 0.9 (five-bar with a mass 25 % off)",
    faulty="below 1e-4 (AIRBOT Play: 1.5 beside 0.83)",
    evidence="tests/estimation/test_torque_scale.py",
)
NO_GRAVITY = Threshold(
    0.1,
    "coefficient of gravity, that of inertia being 1, down to which its interval reaches if torques may have none",
    healthy="0.35 and more, or 0 excluded by 118 of log likelihood (dVRK, slow) in 13 sets of shared logs",
    faulty="0 to 0.1 (the same without gravity)",
    evidence="benchmarks/effort.py",
)
WITH_GRAVITY = Threshold(
    0.75,
    "coefficient of gravity that the interval excludes if torques have none",
    healthy="1",
    evidence="a choice: nearer to 1 it is a scale",
)
MEANING_CLOSE = Threshold(
    3.0,
    "log likelihood by which a meaning of effort is likelier, up to which the other is said too",
    evidence="a level: 20 times as likely",
)
AS_WELL = Threshold(
    1.1,
    "the same, up to which torques show no gravity, if it could be compensated as well as balanced",
    healthy="2.2 and more",
    faulty="1.002 (five-bar)",
    evidence="zoo, benchmarks/effort.py",
)
FRICTIONLESS = Threshold(
    0.02,
    "friction over torque, rms, of the joint with most of it, below which torques are those of a model",
    healthy="0.66 and more (zoo, UPV), 0.2 (delta, simulated)",
    faulty="0.003 (target moments of a UR10e), 0.005 (simulated)",
    evidence="zoo, benchmarks/effort.py",
)
MODEL_RESIDUAL = Threshold(
    0.02,
    "unexplained share of the joint with most of it, below which torques are those of a model",
    healthy="0.05 and more (zoo; 0.0024 simulated, with friction)",
    faulty="0.006 (target moments of a UR10e), 0.01 (simulated)",
    evidence="zoo, benchmarks/effort.py",
)
IMPOSSIBLE_SHARE = Threshold(
    0.02,
    "share of a joint's torque, rms, that a parameter with an impossible sign has, below which it is an effect's",
    healthy="0.007 (friction of a passive joint of a 3-RRR with nine effects at once)",
    faulty="0.1 and more (tests/estimation/test_unit_checks.py)",
    evidence="benchmarks/calibration.py",
)
GEARED = Threshold(
    5.0,
    "least torque scale of the joints, from which torques are those of motors before their gears",
    healthy="up to 4 (constants of firmware: Piper)",
    faulty="83 (Rokae xMate 3 Pro), 6 (the smallest gears of such arms)",
    evidence="zoo; threads of users",
)
BEYOND_GEARS = Threshold(
    1000.0,
    "largest torque scale of motor-side torques: beyond it a unit is wrong, or the torque vanishes",
    evidence="a choice: gears of arms have 30 to 300",
)
