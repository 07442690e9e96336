"""Thresholds of what refutes the description of robot and logs, the meaning of torques, or the choice of estimator."""

from __future__ import annotations

from gtau.estimation.thresholds import Threshold

PROBABLE = Threshold(
    0.5,
    "probability after the data, from which an alternative counts as true",
    evidence="an even chance: what the data make likelier than the model itself",
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
OF_BEST = Threshold(
    0.5,
    "share of the residual variance that it explains over that of the description alternative that explains most",
    healthy="0.19 to 0.25 (a length, a current between runs, beside an offset or a point of a wrench that is off)",
    faulty="1 (itself)",
    evidence="tests/estimation/test_wrench_errors.py",
)
OF_REPEATING = Threshold(
    0.5,
    "share of the residual variance that it explains over that which repeats at the same positions, mean of all joints",
    healthy="0.08 and 0.19 (gravity on a dVRK arm, whose cables repeat)",
    faulty="1.3 and more (base tilted, encoder zeros off, payload off-centre: arm, five-bar, UR10e)",
    evidence="dVRK with 105 and 205 g; benchmarks/calibration.py, 24 experiments",
)
TOGETHER_SHARE = Threshold(
    0.3,
    "the same, of all columns of a hypothesis together",
    healthy="below 0.2 (clean)",
    faulty="0.9 (gravity along another axis)",
    evidence="faults, clean",
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
SAME_EFFECT = Threshold(
    1e-5,
    "1 - cos2 of the torques of two alternatives, below which they count once",
    healthy="0.0009 (two encoder zeros, slow logs), 0.005 and more elsewhere (alternatives to 60 fits of seven robots)",
    faulty="8e-7 (the zero of a leg's first encoder and a tilt of its base), rounding (a hypothesis listed twice)",
    evidence="tests/acceptance, tests/estimation/test_alternatives.py",
)
SWAPPED = Threshold(
    0.5,
    "unexplained share with the other joint's current over that with its own",
    healthy="far above 1",
    faulty="below 0.3",
    evidence="tests/estimation/test_swapped_channels.py",
)
SCALED = Threshold(
    1.5,
    "change of a current between runs; larger ones are a sign or a unit, which other checks name",
    healthy="0",
    faulty="-0.5 (halved), 1 (doubled); not -2 (reversed), 1000 (units)",
    evidence="benchmarks/faults.py",
)
TIE = Threshold(
    1e-6,
    "relative difference of the significance of two changes, below which the first of them counts",
    faulty="rounding (of two runs one is as much larger as the other is smaller)",
    evidence="two runs of a five-bar, whose order rounding had decided",
)
DOMINANT = Threshold(
    0.3,
    "share of the residual variance that goes with currents out of scale in some runs, from which ripple is not "
    "looked for",
    healthy="up to 0.12 (ripple)",
    faulty="0.53 to 0.71 (2 % out of scale)",
    evidence="tests/estimation/test_gain_change.py",
)
APART = Threshold(
    3.5,
    "standard deviations between a declared value of a payload and what all else gives",
    healthy="below 3 (clean, UR10e pairs)",
    faulty="10 and more (3 % wrong mass of one of two payloads)",
    evidence="clean, faults, 300 Monte Carlo repetitions on the Orthoglide logs",
)
APART_REFUTED = Threshold(
    10.0,
    "Hausman's statistic of 2SLS against the estimator used, from which the gain is contradictory",
    healthy="up to 3.1 (clean), 2.6 (UR10e pairs)",
    faulty="127 (an unloaded run declared loaded)",
    evidence="clean, 300 Monte Carlo repetitions on the Orthoglide logs",
)
WEAK_INSTRUMENTS = Threshold(
    6.8,
    "first-stage F of 2SLS (Cragg-Donald, over the square of the lack of fit), below which it is not compared",
    healthy="7.8 (dVRK), 13 (a UR10e pair), 250 (Puma 560, simulated), 1800 (five-bar), 19,000 (Orthoglide)",
    faulty="1.4 (AIRBOT Play, one chirp for all joints: 2SLS moves gains by 50 to 95 % at 9 to 33 standard "
    "deviations, while gains agree to 7 % with those from loaded less unloaded currents)",
    evidence="those logs; above 6.77, 6.23 and 5.94, the largest values of Stock and Yogo (2005), table 5.1, for one, "
    "two and three gains and a bias of at most a fifth of that of least squares (level 5 %, up to 30 "
    "instruments). Those for the size of a test grow with the number of instruments, so the bias left counts "
    "beside the standard deviation",
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
DIFFERENT_PROBABILITY = Threshold(
    0.1, "probability of such an alternative, from which it is listed", evidence="a choice"
)
RIPPLE_SHARE = Threshold(
    0.3,
    "share of a joint's residual variance that repeats at the same positions",
    healthy="below 0.2 (clean)",
    faulty="0.4 to 0.9 (ripple put in)",
    evidence="tests/estimation/test_position_ripple.py",
)
SPRING_SHARE = Threshold(
    0.15,
    "share of the residual variance that a spring across a joint explains",
    healthy="up to 0.01 (UR10e, Orthoglide, an arm), 0.05 (TX40, dVRK), 0.13 (KUKA, about the vertical)",
    faulty="0.47 (60 N m/rad at a shoulder), 0.19 to 0.26 (a balancer of 45 N m)",
    evidence="those logs, tests/estimation/test_position_ripple.py",
)
CORRELATED = Threshold(
    0.3,
    "correlation of a joint's residuals between runs with different loads that repeat a motion, from which it is said",
    healthy="-0.05 to 0.1 (noise alone: five-bar); -0.25 to 0.36 (AIRBOT Play)",
    faulty="0.43 to 0.82 (UR10e pairs, five joints; dVRK); -0.56 (UR10e, wrist 1, where friction may not differ "
    "between runs)",
    evidence="those logs, tests/estimation/test_repeated_motions.py",
)
CORRELATED_STD = Threshold(4.0, "the same in standard deviations", evidence="a level: one in 15,000 by chance")
LOAD_LEFT = Threshold(
    0.5,
    "part of the residual variance, geometric mean of all joints, that is left with the load of one more run unknown, "
    "or with payloads on another body",
    healthy="0.99 and more (UR10e, two pairs); on another body 0.95 (dVRK), 0.999 (Orthoglide), 19 (UR10e) and more",
    faulty="0.025 to 0.11 (UR10e: 2.8 kg not declared, or declared and absent), 0.012 (an arm, on its forearm)",
    evidence="shared logs; tests/estimation/test_tool_bodies.py",
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
LENGTH_MOST = Threshold(
    0.3,
    "relative change beyond which a length explains nothing: it is extrapolated from one per cent",
    healthy="0.02 (the lengths of tests)",
    faulty="18 (currents without gravity)",
    evidence="tests/acceptance/test_faults.py, tests/estimation/test_effort_meaning.py",
)
