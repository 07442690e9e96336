"""Thresholds of the friction step: when a term of friction enters."""

from __future__ import annotations

from gtau.estimation.thresholds import Threshold

TERM_T = Threshold(
    2.5,
    "standard errors, over blocks left out, by which friction with a term is better",
    "above in 0 of 80 logs with white or coloured noise, 4 of 80 with ripple or a wrong load",
    "2.6 to 13 (UR10e, TX40, Panda); above in 98 to 100 % (presliding, load), 78 to 98 % (Stribeck) of 40 logs each",
    "benchmarks/friction.py; at 2.0 false terms are 12 to 24 % with ripple or a wrong load, at 3.0 Stribeck is found "
    "in 65 to 92 %",
)
TERM_SHARE = Threshold(
    0.05,
    "share of the squared error of blocks left out that a term of friction takes away",
    "0.02 lets false terms into 12 % of the logs with ripple instead of 5 %, and finds no more of the right ones",
    "0.2 and more (UR10e, TX40, Panda)",
    "benchmarks/friction.py",
)
