"""Parameters that no robot can have: friction that drives, negative inertias."""

from __future__ import annotations

import re

from gtau.estimation.diagnostics.verdict import Outcome, Verdict, parameter_verdict
from gtau.estimation.thresholds.estimates import NEGATIVE_STD

NONNEGATIVE = {"m", "xx", "yy", "zz", "ia", "fv", "fs"}
TERM = re.compile(r"([+-])\s*(?:[\d.e+-]+ )?([a-z]+\d?)_")


def cannot_be_negative(regrouping: str) -> bool:
    """Decide from its regrouping whether a base parameter is a sum of masses, moments of inertia or friction."""
    terms = TERM.findall(f"+ {regrouping}")
    return bool(terms) and all(sign == "+" and kind in NONNEGATIVE for sign, kind in terms)


def judge_parameter(value: float | None, std: float | None, regrouping: str) -> Verdict:
    """Judge a base parameter from its value, standard deviation, and what it regroups."""
    if value is None or std is None or not std or value >= -NEGATIVE_STD * std or not cannot_be_negative(regrouping):
        return parameter_verdict(value, std)
    what = "friction would drive the joint" if regrouping.startswith(("fv", "fs")) else "it would be a negative inertia"
    return Verdict(
        Outcome.CONTRADICTORY,
        f"it is negative by {-value / std:.0f} standard deviations, so that {what}",
        "check the signs of positions and currents, the sampling rate, the units and 'preparation'",
    )
