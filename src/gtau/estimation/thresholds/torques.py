"""Thresholds of what torques that are logged mean: their scale, and what 'effort' holds."""

from __future__ import annotations

from gtau.estimation.thresholds import NONE, Threshold

ALIKE = Threshold(
    0.05,
    "probability that the torque scales of joints which share one differ by as much",
    "0.4 to 0.9 (five-bar with a mass 25 % off)",
    "below 1e-4 (AIRBOT Play: 1.5 beside 0.83)",
    "tests/estimation/test_torque_scale.py",
)
GRAVITY_FELT = Threshold(
    0.06,
    "torque of gravity over the whole, rms, of the joint that feels it most, below which none is tried",
    "0.04 (Orthoglide), 0.05 (delta, simulated), 0.08 and more (all other logs and robots)",
    "0.001 to 0.035 (logs made without gravity)",
    "zoo, benchmarks/effort.py; it decides on a second of work, not on an outcome",
)
UNFELT = Threshold(
    1e-6, "the same, below which no motion of the robot changes what gravity asks of it", "0 (SCARA)", NONE, "rounding"
)
NO_GRAVITY = Threshold(
    0.8,
    "residual variance without gravity over that with it, geometric mean of the joints, from which torques have none",
    "2.2 and more (zoo), 400 and more (arm, UR10e, five-bar, delta, simulated)",
    "0.01 to 0.6 (arm, UR10e, delta); 1.0 (five-bar, whose parameters adapt)",
    "zoo, benchmarks/effort.py",
)
AS_WELL = Threshold(
    1.1,
    "the same, up to which torques show no gravity, if it could be compensated as well as balanced",
    "2.2 and more",
    "1.002 (five-bar)",
    "zoo, benchmarks/effort.py",
)
FRICTIONLESS = Threshold(
    0.02,
    "friction over torque, rms, of the joint with most of it, below which torques are those of a model",
    "0.66 and more (zoo, UPV), 0.2 (delta, simulated)",
    "0.003 (target moments of a UR10e), 0.005 (simulated)",
    "zoo, benchmarks/effort.py",
)
MODEL_RESIDUAL = Threshold(
    0.02,
    "unexplained share of the joint with most of it, below which torques are those of a model",
    "0.05 and more (zoo; 0.0024 simulated, with friction)",
    "0.006 (target moments of a UR10e), 0.01 (simulated)",
    "zoo, benchmarks/effort.py",
)
GEARED = Threshold(
    5.0,
    "least torque scale of the joints, from which torques are those of motors before their gears",
    "up to 4 (constants of firmware: Piper)",
    "83 (Rokae xMate 3 Pro), 6 (the smallest gears of such arms)",
    "zoo; threads of users",
)
LIMIT_SHARE = Threshold(
    0.02,
    "largest torque over its limit of effort, of the joint that comes nearest, below which torques are those of motors",
    "0.27 (KUKA LBR Med 7), 0.33 (UPV), 1.2 (xMate 7 Pro)",
    "0.003 to 0.012 (the same before gears of 100:1)",
    "zoo",
)
STEPS = Threshold(
    3.0,
    "largest whole number of commands that are all whole, from which they are shares or counts",
    NONE,
    NONE,
    "a level",
)
WHOLE = Threshold(
    0.9,
    "share of commands that are whole numbers, from which all were",
    "0 (zoo); 0.5 (steps of 0.5 N m)",
    "0.995 and more (per cent of the rated torque, stale samples interpolated)",
    "zoo, benchmarks/effort.py",
)
