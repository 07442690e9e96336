"""Thresholds of the friction step: when a term of friction enters."""

from __future__ import annotations

from gtau.estimation.thresholds import Threshold

TERM_T = Threshold(
    2.5,
    "standard errors, over blocks left out, by which friction with a term is better",
    "above in 0 of 50 logs with white and coloured noise, 2 of 50 with ripple or a wrong load",
    "3.2 to 13 (UR10e, TX40, Panda); above in 97 to 100 % (presliding, load), 84 to 96 % (Stribeck) of 100 logs",
    "benchmarks/friction.py; at 2.0 the share of false terms is 18 % with ripple, at 3.0 power for Stribeck is 60 %",
)
TERM_SHARE = Threshold(
    0.02,
    "share of the squared error of blocks left out that a term of friction takes away",
    "0.05 halves no rate of false terms",
    "0.2 and more (UR10e, TX40, Panda)",
    "benchmarks/friction.py; less is not worth a term",
)
