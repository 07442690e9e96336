"""Thresholds of what logged torques mean: their scale, and what 'effort' holds."""

from __future__ import annotations

from gtau.estimation.thresholds import Threshold

ALIKE = Threshold(
    0.05,
    "probability that the torque scales of joints which share one differ by as much",
    healthy="0.4 to 0.9 (five-bar with a mass 25 % off)",
    faulty="below 1e-4 (AIRBOT Play: 1.5 beside 0.83)",
    evidence="tests/estimation/test_torque_scale.py",
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
