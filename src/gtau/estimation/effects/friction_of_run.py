"""Viscous and Coulomb friction that differ between runs: how far the per-run parameters of the model may lie apart.

Warm-up makes friction drift between runs by per cents, which is invisible in a single run and ruins the drive gains.
The parameters belong to the model (``fv_2@0``); their spread is found with the sizes of all effects.
"""

from __future__ import annotations

PLAUSIBLE = 0.1  # relative change between runs: up to 0.1 between the runs of the UR10e pairs
NAME = "friction of a run"
