"""What refutes the description of robot and logs, or the choice of the estimator."""

from __future__ import annotations

from gtau.estimation.thresholds.threshold import NONE, Threshold

PROBABLE = Threshold(
    0.5,
    "probability after the data, from which an alternative counts as true",
    NONE,
    NONE,
    "an even chance: what the data make likelier than the model itself",
)
REFUTED_STD = Threshold(
    6.0,
    "size of a description alternative in standard deviations",
    "up to 4.8 (UR10e pairs), 3.2 (Orthoglide)",
    "8 to 44 (faults)",
    "faults, UR10e pairs, Orthoglide",
)
REFUTED_SHARE = Threshold(
    0.05,
    "share of the residual variance that it explains",
    "up to 0.03 at more than 6 deviations with moves above the accuracy: none (UR10e pairs); 0.06 to 0.21 beside a "
    "lag or elasticity of 0.07 to 0.39, which then explains it",
    "0.06 to 0.86 (faults)",
    "faults, UR10e pairs; a dVRK arm, and currents low-passed or joints elastic in benchmarks/calibration.py",
)
OF_REPEATING = Threshold(
    0.5,
    "share of the residual variance that it explains over that which repeats at the same positions, mean of all joints",
    "0.08 and 0.19 (gravity on a dVRK arm, whose cables repeat)",
    "1.3 and more (base tilted, encoder zeros off, payload off-centre: arm, five-bar, UR10e)",
    "dVRK with 105 and 205 g; benchmarks/calibration.py, 24 experiments",
)
TOGETHER_SHARE = Threshold(
    0.3,
    "the same, of all columns of a hypothesis together",
    "below 0.2 (clean)",
    "0.9 (gravity along another axis)",
    "faults, clean",
)
SAME_EFFECT = Threshold(
    1e-5,
    "1 - cos2 of the torques of two alternatives, below which they count once",
    "0.0009 (two encoder zeros, slow logs), 0.005 and more elsewhere (alternatives to 60 fits of seven robots)",
    "8e-7 (the zero of a leg's first encoder and a tilt of its base), rounding (a hypothesis listed twice)",
    "tests/acceptance, tests/estimation/test_alternatives.py",
)
SWAPPED = Threshold(
    0.5,
    "unexplained share with the other joint's current over that with its own",
    "far above 1",
    "below 0.3",
    "tests/estimation/test_swapped_channels.py",
)
SCALED = Threshold(
    0.3, "change of a current between runs that no motor makes", "0", "2 (reversed), 1000 (units)", "faults"
)
TIE = Threshold(
    1e-6,
    "relative difference of the significance of two changes, below which the first of them counts",
    NONE,
    "rounding (of two runs one is as much larger as the other is smaller)",
    "two runs of a five-bar, whose order rounding had decided",
)
DOMINANT = Threshold(
    0.3,
    "share of the residual variance that goes with currents out of scale in some runs, from which ripple is not "
    "looked for",
    "up to 0.12 (ripple)",
    "0.53 to 0.71 (2 % out of scale)",
    "tests/estimation/test_gain_change.py",
)
APART = Threshold(
    3.5,
    "standard deviations between a declared value of a payload and what all else gives",
    "below 3 (clean, UR10e pairs)",
    "10 and more (3 % wrong mass of one of two payloads)",
    "clean, faults, 300 Monte Carlo repetitions on the Orthoglide logs",
)
APART_REFUTED = Threshold(
    10.0,
    "Hausman's statistic of 2SLS against the estimator used, from which the gain is contradictory",
    "up to 3.1 (clean), 2.6 (UR10e pairs)",
    "127 (an unloaded run declared loaded)",
    "clean, 300 Monte Carlo repetitions on the Orthoglide logs",
)
NOISE_STD = Threshold(
    4.0,
    "Hausman's statistic of instrumental variables against the estimator used, of a parameter that moves by more than "
    "its standard deviation, from which noise of the positions is named",
    "no parameter of UR10e pairs, Orthoglide, TX40 or Panda moves by so much; up to 3.9 where it moves less (UR10e)",
    "4.2 and 4.5 (five-bar, positions noisy by 0.4 mrad behind a filter of 100 Hz, 16 s), 7 to 18 (Aliengo, whose "
    "command is made from the measured position)",
    "shared logs, tests/estimation/test_other_estimators.py",
)
DIFFERENT_STD = Threshold(
    3.0,
    "standard deviations by which another estimator finds a parameter otherwise, from which that is an alternative",
    NONE,
    NONE,
    "a level: one in 370 by chance; differences in a gain are alternatives whatever their size",
)
DIFFERENT_PROBABILITY = Threshold(
    0.1, "probability of such an alternative, from which it is listed", NONE, NONE, "a choice"
)
RIPPLE_SHARE = Threshold(
    0.3,
    "share of a joint's residual variance that repeats at the same positions",
    "below 0.2 (clean)",
    "0.4 to 0.9 (ripple put in)",
    "tests/estimation/test_position_ripple.py",
)
CLOCK_SIZE = Threshold(
    0.9,
    "part of what another gravity explains that another strength of it explains alone: the clock is wrong",
    NONE,
    "0.97 (UR10e at 95 Hz read as 125)",
    "UR10e logs with another rate declared",
)
CLOCK_REVERSED = Threshold(
    -0.9,
    "factor of gravity, below which it is rather reversed than of another strength",
    NONE,
    "-1 (upside down)",
    "faults",
)
UNFELT_PAYLOAD = Threshold(
    1.1,
    "residual of the currents without the payload over that with it",
    "16 (UR10e, actual currents)",
    "1.03 (UR10e, target currents, which never feel the payload)",
    "UR10e logs",
)
