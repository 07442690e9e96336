"""Constants of what is said of the inertias that the robot's file states."""

from __future__ import annotations

from gtau.estimation.thresholds import Threshold

INERTIA_CHANCE = Threshold(
    0.05,
    "chance that a file which is right has any base parameter contradicted, all being tested together",
    "2 of 30 simulated arms, one parameter each of 19 that are tested",
    "7 to 9 of 19 parameters of ten arms whose file has a link 30 % too heavy; z of 4 to 59 (UR10e, Panda)",
    "arms of tests/estimation/test_inertia_audit.py, UR10e with its driver's URDF, Panda with MuJoCo Menagerie's MJCF",
)
INERTIA_EXPLAINED = Threshold(
    0.95,
    "share of the torque variance which the file adds that freed links explain, from which on no other is named",
    "the heavy link alone (ten simulated arms, mass 30 % wrong)",
    "two links (UR10e); the rotors and two links (Panda); four calves (Aliengo)",
    "tests/estimation/test_inertia_audit.py, shared logs",
)
