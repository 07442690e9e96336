"""Every tuned constant that decides an outcome, with the evidence for it.

Each is a number with what it bounds (``statistic``), the range measured where nothing is wrong (``healthy``), that
measured with a fault (``faulty``), and the data or tests behind both (``evidence``). "UR10e pairs" are the two pairs of
real runs described in docs/evidence/measured.md; "Orthoglide" the independent simulator's logs described there; "clean"
the 50 simulated experiments of tests/acceptance/test_false_alarms.py; "faults" those of test_faults.py there.

All checks together may raise a false alarm in one healthy experiment of a hundred. An experiment with n joints and p
parameters is held against 4 n + 15 alternatives of its description at 6 standard deviations and 5 % of the residuals
(level 5e-7 each, of Student's distribution with 39 degrees of freedom, so below 3e-5 together), n differences from 2SLS
at 10 (1e-12), n residuals at 25 % of the current (six times the largest of a healthy robot), p signs at 4 (3e-4 each,
and only of parameters near zero), p differences from instrumental variables at 4 that must also exceed the parameter's
own standard deviation (none did), likeness of legs at 1e-3, and one autocorrelation at 1.8 (none of 320 experiments).
benchmarks/false_alarms.py counts what they do together; docs/evidence/coverage.md has the result.
"""

from __future__ import annotations

NONE = "not measured"


class Threshold(float):
    """A number that decides an outcome, with the evidence for it.

    Attributes
    ----------
    statistic : str
        The quantity that it bounds, with its unit.
    healthy, faulty : str
        Range of that quantity measured where nothing is wrong, and with a fault.
    evidence : str
        Data, tests or source behind both; "experience", "a choice" or "a level" (of significance) where there are none.
    """

    statistic: str
    healthy: str
    faulty: str
    evidence: str

    def __new__(
        cls, value: float, statistic: str, healthy: str = NONE, faulty: str = NONE, *, evidence: str
    ) -> Threshold:
        """Make the number and attach the evidence."""
        made = super().__new__(cls, value)
        made.statistic, made.healthy, made.faulty, made.evidence = statistic, healthy, faulty, evidence
        return made

    def __getnewargs_ex__(self) -> tuple[tuple[float, str], dict[str, str]]:
        """Return the arguments with which copy and pickle rebuild the threshold."""
        more = {"healthy": self.healthy, "faulty": self.faulty, "evidence": self.evidence}
        return (float(self), self.statistic), more
