"""Thresholds of what is read: logs, motion, logged poses."""

from __future__ import annotations

from gtau.estimation.thresholds import Threshold

# What is found in the logs.

NEAR_SINGULAR = Threshold(
    0.05,
    "distance to a singularity of type 2, below which errors of the model are magnified",
    healthy="0.49 (Orthoglide)",
    faulty="0.001 is refused",
    evidence="a choice: errors are magnified twentyfold",
)
LAG_STD = Threshold(
    4.0,
    "lag of all commands together behind the motion, in standard errors",
    healthy="below 1.5 where it exceeds a sample (UR10e, xMate 7); no lag in 13 sets of shared logs of ten robots",
    faulty="4.4 (UR10e, 20 ms), 8 (Panda, 10 ms), 10 (TX40, 10 ms), 50 and more (dVRK, Orthoglide)",
    evidence="those logs as they are, and behind a low-pass of first order of 5, 10, 20 and 50 ms, found in 2, 5, 6 "
    "and 9 of the 13; the others have commands that are mostly noise, or led the motion by more before",
)
LAG_JOINTS = Threshold(
    2.0,
    "joints whose acceleration shows the lag, or all of the robot: friction of one alone may look like it",
    healthy="1 (joint 7 of a KUKA Med 7 at 0.55 Hz: 57 ms, 4.9 standard errors; of a Rokae 4 show it, joint 7 alone "
    "25 ms, 4.3)",
    faulty="3 to 6 (UR10e, TX40, Panda, dVRK, Orthoglide)",
    evidence="shared logs",
)
LAG_SAMPLES = Threshold(
    1.0,
    "the same in samples",
    healthy="at most 0.84 (dVRK, polled at 200 Hz)",
    faulty="1.4 (UR10e, 20 ms) to 200 (TX40, 50 ms)",
    evidence="as above",
)
LAG_LEAST = Threshold(
    3e-3,
    "the same in s",
    healthy="at most 1 ms at 1 kHz and more (Panda)",
    faulty="4.1 ms (Orthoglide, low-pass of 5 ms)",
    evidence="as above",
)
LAG_LOSS = Threshold(
    0.01, "share of a command that a low-pass of that lag takes away at the bandwidth", evidence="a choice"
)
LATE = Threshold(
    0.5,
    "unexplained share of a joint's current, shifted by more than a delay can be, over that as logged",
    healthy="0.70 (Aliengo), 0.91 and more (15 sets of shared logs of nine robots, as they are)",
    faulty="0.02 and less (100 ms), 0.07 to 0.09 (50 ms)",
    evidence="those logs, tests/estimation/test_late_currents.py",
)
LATE_STEADY = Threshold(
    0.6,
    "unexplained share of a joint's current, shifted, over that which gravity, friction and offsets alone leave: with "
    "more, acceleration hardly shows the shift",
    healthy="0.70 (XL330, slow; friction and its servo seem 260 ms early)",
    faulty="0.13 (da Vinci, 100 ms), 0.32 to 0.55 (11 joints of Aliengo, the twelfth 0.79)",
    evidence="those logs, tests/estimation/test_late_currents.py",
)
DELAY_MOTION = Threshold(
    4.0,
    "standard errors of the share of motion in the current's rate of change",
    healthy="the delays of UR10e, TX40, Panda at 200 Hz, da Vinci, Orthoglide and Aliengo are all estimated",
    faulty="Rokae: 14 ms of joint 1 lost in noise; estimated, the error of unused samples is 46 %, else 31 %",
    evidence="shared logs, tests/acceptance/test_slow_logs.py",
)
MIRRORED = Threshold(
    0.05,
    "share of a joint's error by which that at the negative delay must be larger for the delay to be real",
    healthy="0.057 (a five-bar of 0.2 s, 1 ms), 0.45 (xMate7 Pro, 15 ms), of channels whose rate of change is noise",
    faulty="0.00 to 0.045 (Panda at 30 Hz, UPV, joints 1 of Rokae and KUKA)",
    evidence="shared logs, tests/cli/test_cli.py",
)
DELAY_STD = Threshold(
    0.25,
    "relative standard deviation of a delay longer than a sample that is believed",
    healthy="0.01 (Orthoglide)",
    faulty="0.3 (-43 +- 12 ms)",
    evidence="Orthoglide; a log reported by a user",
)


# Whether a log can be of this robot ("shared": the logs of UR10e, TX40, Orthoglide and Aliengo).

BEYOND_LIMITS = Threshold(
    0.02,
    "motion outside a joint's limits, of their range, from which a note says so",
    healthy="never outside (shared)",
    evidence="a choice: less is the offset of an encoder",
)
FAR_BEYOND_LIMITS = Threshold(
    1.0,
    "the same, from which the log is refused: another unit, joint or robot",
    healthy="never outside (shared)",
    faulty="57 times the share of the range that is used (deg read as rad)",
    evidence="tests/estimation/test_motion_limits.py",
)
FASTEST_TURN = Threshold(
    30.0,
    "rms speed of a joint, rad/s, from which the clock or unit is wrong",
    healthy="1.4 (Aliengo), 10 (fast deltas)",
    faulty="77 (Aliengo, deg read as rad)",
    evidence="shared logs; the speed of deltas from experience",
)
FASTEST_SLIDE = Threshold(
    10.0, "the same, m/s", healthy="0.34 (shared)", faulty="340 (ms read as s)", evidence="shared logs"
)
FARTHEST_TURN = Threshold(
    40.0,
    "range of a joint's positions, rad, from which they are rather in deg",
    healthy="1.1 (Aliengo) to 6.0 (UR10e)",
    faulty="62 to 340 (those, deg read as rad)",
    evidence="shared logs",
)
FARTHEST_SLIDE = Threshold(
    30.0,
    "the same of a prismatic joint, in lengths of the robot, from which they are rather in mm",
    healthy="0.40 to 0.64 (Orthoglide)",
    faulty="400 to 640 (Orthoglide, mm read as m)",
    evidence="shared logs",
)
LEAST_TURN = Threshold(
    0.06,
    "range of the joint that turns most, rad, below which positions said to be in deg are rather in rad",
    healthy="0.3 to 6.0",
    faulty="0.005 to 0.1 (rad read as deg)",
    evidence="UR10e, TX40, Panda and Aliengo logs",
)
LEAST_SLIDE = Threshold(
    3e-3,
    "the same of prismatic joints, in lengths of the robot, where positions are said to be in mm",
    healthy="0.40 to 0.64 (Orthoglide)",
    faulty="0.0004 to 0.0006 (m read as mm)",
    evidence="shared logs",
)
LARGEST_CURRENT = Threshold(
    100.0,
    "rms current of a joint, A, from which it is rather in mA",
    healthy="0.05 to 8.1 (five sets of shared logs with currents), 15 (simulated, catalog)",
    faulty="980 (dVRK), 8100 (UR10e, mA read as A)",
    evidence="shared logs; large drives do reach it, so that it is asked and not refused",
)
SMALLEST_CURRENT = Threshold(
    0.02,
    "rms current of the joint with the largest, A, from which it is rather in A and was stated as mA",
    healthy="0.075 (SO-101), 1 (dVRK), 7.2 and 8.1 (UR10e)",
    faulty="0.0072 and 0.0081 (UR10e, A stated as mA)",
    evidence="shared logs; drives that take more than 20 A are left to LARGEST_VOLTAGE",
)
LARGEST_VOLTAGE = Threshold(
    1500.0,
    "rms speed of a joint times its gain, V: what its motor induces, from which a unit is wrong",
    healthy="5.7 (UR10e), 620 (Orthoglide, simulated)",
    faulty="5,700 (UR10e, A stated as mA, or the payload in g)",
    evidence="shared logs; drives of robots are supplied with 12 to 800 V",
)
GRAVITY_RANGE = Threshold(
    0.04,
    "strength of gravity from 9.80 m/s2, or 1.62 on the moon, beyond which it is of no place",
    healthy="-0.036 (Huascaran) to 0.034 (Arctic Ocean)",
    faulty="0.8 (9.0 m/s2: gains 8 to 10 % low)",
    evidence="geodesy",
)
PAYLOAD_DENSITY = Threshold(
    100.0,
    "mass of a payload over the cube of the arm's reach, kg/m3, from which it is rather in g",
    healthy="1.3 (UR10e with 2.8 kg), 6 to 45 (rated: UR10e, UR5e, Panda, Mecademic Meca500, KUKA KR1000, Fanuc "
    "M-2000)",
    faulty="12,000 and more (5 to 25 kg on those of up to 0.85 m reach, in g), 1,300 (UR10e with 2.8 kg in g)",
    evidence="data sheets; on large arms small payloads in g pass",
)
CURRENTS_APART = Threshold(
    30.0,
    "rms current of a joint over the next smaller one, from which units may differ between joints",
    healthy="1.2 to 4.5 (the same logs), 5.0 (simulated, catalog)",
    faulty="60 and more (one of two alike in %, or in counts)",
    evidence="shared logs; the factors between units",
)


# Whether runs repeat a motion.

REPEATED = Threshold(
    0.1,
    "rms difference of the positions of two runs after a shift in time, over the rms of the motion, mean of the joints",
    healthy="0.0001 (UR10e, two pairs with and without payload), 0.004 and 0.006 (dVRK, the same)",
    faulty="1.1 to 1.9 (Orthoglide, four motions)",
    evidence="those logs; runs taken for repeated without need only lose degrees of freedom",
)
REPEATED_PART = Threshold(
    0.7,
    "part of the longer of two runs in which both have the motion",
    healthy="0.91 to 1 (the same pairs)",
    evidence="a choice: the rest of a run is then cut into at most a third as many stretches again",
)


# What torques and logged poses say of the geometry ("UPV": the logs of a real 3UPS+RPU, docs/evidence/zoo.md).

GEOMETRY_SHARE = Threshold(
    0.5,
    "share of the variance of the pose residuals that a length or an encoder zero explains, of what is left",
    healthy="0.02 (UPV, the controller's pose), 0.29 (its tracker), 0.28 (its tracker taken for the controller's "
    "frame)",
    faulty="0.82 to 0.99999 (UPV, one radius or three 26 mm off), above 0.9 (simulated, 1 % off)",
    evidence="tests/estimation/test_geometry.py",
)
GEOMETRY_STD = Threshold(
    6.0,
    "change of a length or zero that explains the pose, in standard deviations",
    healthy="up to 9 where the share is small (UPV, tracker)",
    faulty="24 to 30,000 (UPV, 26 mm off)",
    evidence="tests/estimation/test_geometry.py; the share decides where systematic residuals of a tracker are certain",
)
GEOMETRY_CHANGE = Threshold(
    0.005,
    "that change, of the length, of the robot's mean length (zeros in m) or in rad",
    healthy="0.000003 (UPV, the controller's pose)",
    faulty="0.01 (simulated), 0.08 (UPV, 26 mm off)",
    evidence="a choice: what is less is not worth another robot file",
)
GEOMETRY_RMS = Threshold(
    0.01,
    "distance between logged and computed positions, rms, of the robot's mean length, above which a pose that no "
    "length explains does not confirm the geometry",
    healthy="0.000002 (UPV, the controller's pose), 0.003 (its tracker)",
    faulty="0.02 (UPV, its tracker taken for the controller's frame)",
    evidence="UPV",
)
GEOMETRY_LIKELY = Threshold(
    0.5,
    "share that a constant explains to first order, over GEOMETRY_SHARE, from which it is fitted for good",
    faulty="a fit explains at most 1.09 times what the first order says, where it is more than GEOMETRY_SHARE",
    evidence="tests/estimation/test_geometry.py, UPV",
)
GEOMETRY_ALIKE = Threshold(
    1.5,
    "squares of the residuals that another constant leaves, over those that the best leaves: with less it is as likely",
    healthy="1.02 (a length and a zero that act alike), 1.2 (a tracker taken for the controller's frame)",
    faulty="3 (UPV, tracker), 43 and more elsewhere",
    evidence="tests/estimation/test_geometry.py, UPV",
)
GEOMETRY_FREE = Threshold(
    1e-3,
    "rms effect of a constant on the pose that frames and other free constants leave, over its effect",
    healthy="0.011 and more, of constants that have an effect of their own",
    faulty="0.00015 and less, of constants that have none",
    evidence="tests/estimation/test_geometry.py, UPV",
)
POSE_DELAY_STD = Threshold(
    0.02,
    "standard deviation of the delay of a pose, s, above which it is not shown",
    evidence="a choice: two samples of a camera at 100 Hz",
)
GRAVITY_FELT = Threshold(
    0.06,
    "torque of gravity over the whole, rms, of the joint that feels it most, below which none is tried",
    healthy="0.04 (Orthoglide), 0.05 (delta, simulated), 0.08 and more (all other logs and robots)",
    faulty="0.001 to 0.035 (logs made without gravity)",
    evidence="zoo, benchmarks/effort.py; it decides on a second of work and on a note, not on an outcome",
)
UNFELT = Threshold(
    1e-6,
    "the same, below which no motion of the robot changes what gravity asks of it",
    healthy="0 (SCARA)",
    evidence="rounding",
)
LIMIT_SHARE = Threshold(
    0.02,
    "largest torque over its limit of effort, of the joint that comes nearest, below which torques are those of motors",
    healthy="0.27 (KUKA LBR Med 7), 0.33 (UPV), 1.2 (xMate 7 Pro)",
    faulty="0.003 to 0.012 (the same before gears of 100:1)",
    evidence="zoo",
)
STEPS = Threshold(
    3.0, "largest whole number of commands that are all whole, from which they are shares or counts", evidence="a level"
)
WHOLE = Threshold(
    0.9,
    "share of commands that are whole numbers, from which all were",
    healthy="0 (zoo); 0.5 (steps of 0.5 N m)",
    faulty="0.995 and more (per cent of the rated torque, stale samples interpolated)",
    evidence="zoo, benchmarks/effort.py",
)
UNSEEN_RATIO = Threshold(
    4.0,
    "share of a joint's current that its own equations leave unexplained in a run in which another joint's position "
    "never changes, over the largest in runs in which that one moves",
    faulty="10 to 22 (five joints of a UR10e frozen in one run), 2.4 (its first joint, which gravity does not feel)",
    evidence="UR10e pair, the loaded run; tests/estimation/test_still_joints.py. In its logs of single joints, held "
    "ones move by 2 quanta",
)
UNSEEN_MISFIT = Threshold(
    0.1, "that share itself", healthy="up to 0.04 (UR10e)", faulty="0.23 to 0.52", evidence="the same"
)
