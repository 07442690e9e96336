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
    0.12,
    "share of the squared error of blocks left out that a term of friction takes away",
    "median 0.09 of the false terms that blocks let in with ripple or a wrong load, 7 of 17 above 0.11",
    "0.2 and more (UR10e, TX40, Panda); 0.12 to 0.9 (Stribeck, 60 logs each)",
    "benchmarks/friction.py, seeds 1000 to 1059, counted on others; at 0.05 false terms are 8 to 18 % of the logs with "
    "ripple or a wrong load instead of 0 to 7 %, and Stribeck is found in 70 to 98 instead of 60 to 97 %",
)
