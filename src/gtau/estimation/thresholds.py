"""Every tuned constant that decides an outcome, with the evidence for it.

Each is a number with what it bounds (``statistic``), the range measured where nothing is wrong (``healthy``), that
measured with a fault (``faulty``), and the data or tests behind both (``evidence``). "UR10e pairs" are the two pairs of
real runs described in docs/measured.md; "Orthoglide" the independent simulator's logs described there; "clean" the 50
simulated experiments of tests/acceptance/test_false_alarms.py; "faults" those of tests/acceptance/test_faults.py.

All checks together may raise a false alarm in one healthy experiment of a hundred. An experiment with n joints and p
parameters is held against 4 n + 15 alternatives of its description at 6 standard deviations and 5 % of the residuals
(level 5e-7 each, of Student's distribution with 39 degrees of freedom, so below 3e-5 together), n differences from 2SLS
at 10 (1e-12), n residuals at 25 % of the current (six times the largest of a healthy robot), p signs at 4 (3e-4 each,
and only of parameters near zero), p differences from instrumental variables at 4 that must also exceed the parameter's
own standard deviation (none did), likeness of legs at 1e-3, and one autocorrelation at 1.8 (none of 320 experiments).
benchmarks/false_alarms.py counts what they do together; docs/coverage.md has the result.
"""

from __future__ import annotations


class Threshold(float):
    """A number that decides an outcome, and why it has its value."""

    statistic: str
    healthy: str
    faulty: str
    evidence: str

    def __new__(cls, value: float, statistic: str, healthy: str, faulty: str, evidence: str) -> Threshold:
        """Make the number and attach the evidence."""
        made = super().__new__(cls, value)
        made.statistic, made.healthy, made.faulty, made.evidence = statistic, healthy, faulty, evidence
        return made

    def __getnewargs__(self) -> tuple[float, str, str, str, str]:  # type: ignore[override]
        """Return the arguments with which copy and pickle rebuild the threshold."""
        return float(self), self.statistic, self.healthy, self.faulty, self.evidence


NONE = "not measured"

# How well a gain must be known
ACCURACY = Threshold(
    0.03,
    "half the relative width of a gain's 95 % interval",
    "0.11 to 0.17 % (Orthoglide)",
    "above 3 % (faults)",
    "a choice: the accuracy usually asked of a payload or a contact force; --accuracy changes it",
)
LOST_GAIN = Threshold(0.5, "relative random standard deviation of a gain", "below 0.05 (UR10e pairs)", NONE, "a choice")
WEAK_PARAMETER = Threshold(0.2, "relative standard deviation of a parameter", NONE, NONE, "a choice")
NEGATIVE_STD = Threshold(
    4.0,
    "standard deviations below zero of a parameter that cannot be negative",
    NONE,
    "11 (an armature of -0.0022 +- 0.0002 kg m2 from a log filtered wrongly)",
    "a level: one in 30,000 by chance",
)
NAMED_SHARE = Threshold(
    0.5,
    "share of the model part in a gain's variance from which its cause is named",
    NONE,
    NONE,
    "a choice: the larger part is named",
)

# Whether the model explains the data
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

# What refutes the description of robot and logs
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
TOGETHER_SHARE = Threshold(
    0.3,
    "the same, of all columns of a hypothesis together",
    "below 0.2 (clean)",
    "0.9 (gravity along another axis)",
    "faults, clean",
)
LENGTH_SHARE = Threshold(
    0.1, "the same, of another length", "below 0.05 (clean)", "0.24 to 0.96 (bars 2 % off)", "faults"
)
LENGTH_CHANGE = Threshold(
    0.005, "relative change of that length", "below 0.005 where residuals are tiny", "0.02", "faults"
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

# What is found in the logs
COSTLY_REPAIR = Threshold(
    0.02,
    "share of the samples that a repair drops or interpolates, from which it is worth mending",
    "up to 0.001 (shared logs, but for those recorded by polling)",
    "0.05 and more are refused",
    "a choice between the two",
)
NEAR_SINGULAR = Threshold(
    0.05,
    "distance to a singularity of type 2, below which errors of the model are magnified",
    "0.49 (Orthoglide)",
    "0.001 is refused",
    "a choice: errors are magnified twentyfold",
)

LAG_STD = Threshold(
    4.0,
    "lag of all commands together behind the motion, in standard errors",
    "below 1.5 where it exceeds a sample (UR10e, xMate 7); no lag in 13 sets of shared logs of ten robots",
    "4.4 (UR10e, 20 ms), 8 (Panda, 10 ms), 10 (TX40, 10 ms), 50 and more (dVRK, Orthoglide)",
    "those logs as they are, and behind a low-pass of first order of 5, 10, 20 and 50 ms, found in 2, 5, 6 and 9 of "
    "the 13; the others have commands that are mostly noise, or led the motion by more before",
)
LAG_SAMPLES = Threshold(
    1.0,
    "the same in samples",
    "at most 0.84 (dVRK, polled at 200 Hz)",
    "1.4 (UR10e, 20 ms) to 200 (TX40, 50 ms)",
    "as above",
)
LAG_LEAST = Threshold(
    3e-3,
    "the same in s",
    "at most 1 ms at 1 kHz and more (Panda)",
    "4.1 ms (Orthoglide, low-pass of 5 ms)",
    "as above",
)
LAG_LOSS = Threshold(
    0.01, "share of a command that a low-pass of that lag takes away at the bandwidth", NONE, NONE, "a choice"
)

# What is known beside the data
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
LEG_PROBABILITY = Threshold(1e-3, "probability that legs which are alike differ by as much", NONE, NONE, "a level")
LEG_DIFFERENCE = Threshold(20.0, "difference of a parameter between like legs, per cent", NONE, NONE, "a choice")
LEG_DIFFERENCE_STD = Threshold(5.0, "the same in standard deviations", NONE, NONE, "a level")
DELAY_MOTION = Threshold(
    4.0,
    "standard errors of the share of motion in the current's rate of change",
    NONE,
    NONE,
    "tests/estimation/test_verdicts.py",
)
DELAY_STD = Threshold(
    0.25,
    "relative standard deviation of a delay longer than a sample that is believed",
    "0.01 (Orthoglide)",
    "0.3 (-43 +- 12 ms)",
    "Orthoglide; a log reported by a user",
)

# Which friction terms are kept
FRICTION_TERM_GAIN = Threshold(
    0.02,
    "share of a joint's residual that a friction term takes away",
    "0 (Orthoglide)",
    "0.5 and more (UR10e pairs)",
    "300 Monte Carlo repetitions on the Orthoglide logs",
)
FRICTION_TERM_STD = Threshold(1 / 3, "relative standard deviation of a friction term", NONE, NONE, "a level")

# How far a body's mass may reach beyond its joints, where physically consistent parameters are asked for
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

# How large alternatives may plausibly be: standard deviations before the data, from experience and data sheets
ALTERNATIVE_PRIOR = Threshold(
    0.2,
    "probability of a group of alternatives before the data",
    "rms z between the gains of the UR10e pairs: 0.89 with 0.5, 0.93 with 0.2, 0.95 with 0.1",
    NONE,
    "UR10e pairs; simulated gains without a departure had 0.65 and 0.67 with 0.5 (benchmarks/calibration.py)",
)
PLAUSIBLE_CUBIC = Threshold(
    0.2, "cubic friction at three times the rms speed, of the friction", NONE, NONE, "experience"
)
PLAUSIBLE_LOAD_FRICTION = Threshold(
    0.05, "friction coefficient of the load", "0.02 to 0.1 in strain-wave gears", NONE, "UR10e pairs"
)
PLAUSIBLE_STRIBECK = Threshold(0.3, "Stribeck friction at rest, of the friction", NONE, NONE, "experience")
STRIBECK_SPEED = Threshold(0.1, "Stribeck speed, in rms speeds", NONE, NONE, "experience")
PLAUSIBLE_FRICTION_DRIFT = Threshold(0.1, "relative change of friction along a run", NONE, NONE, "experience")
PLAUSIBLE_SATURATION = Threshold(
    0.03,
    "relative fall of a torque constant up to twice the rms current",
    "0 to 0.05",
    NONE,
    "data sheets of servo motors",
)
PLAUSIBLE_GAIN_DRIFT = Threshold(
    0.005,
    "relative change of a torque constant along a run",
    "0.001 a kelvin of the magnets",
    NONE,
    "data sheets of servo motors",
)
PLAUSIBLE_GAIN_CHANGE = Threshold(
    0.005, "the same between runs", "0.001 a kelvin of the magnets", NONE, "data sheets of servo motors"
)
PLAUSIBLE_LAG = Threshold(
    1e-4,
    "coefficient of the torque's second derivative, s2",
    "elastic at 16 Hz, or a filter of 14 ms",
    NONE,
    "experience",
)
PLAUSIBLE_ZERO = Threshold(0.5, "error of an encoder's zero, degrees or mm", NONE, NONE, "experience")
PLAUSIBLE_TILT = Threshold(1.0, "tilt of the base, degrees", NONE, NONE, "experience")
PLAUSIBLE_GRAVITY = Threshold(
    0.2, "deviation of local gravity from the standard, per cent", "0.26 at most on Earth", NONE, "latitude and height"
)

# What logged poses say of the geometry ("UPV": the logs of a real 3UPS+RPU described in docs/zoo.md)
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
