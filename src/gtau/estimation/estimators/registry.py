"""The estimators by name; a new one is a file and a line here."""

from __future__ import annotations

from gtau.errors import GtauError
from gtau.estimation.estimators.didim import DIDIM
from gtau.estimation.estimators.estimator import Estimator
from gtau.estimation.estimators.huber import HUBER
from gtau.estimation.estimators.instrumental_variables import IV
from gtau.estimation.estimators.least_squares import OLS, WLS
from gtau.estimation.estimators.maximum_likelihood import ML
from gtau.estimation.estimators.mixed_least_squares import MIXED
from gtau.estimation.estimators.ridge import RIDGE
from gtau.estimation.estimators.total_least_squares import TLS
from gtau.estimation.estimators.two_stage import TWO_STAGE

ESTIMATORS: dict[str, Estimator] = {
    each.name: each for each in (ML, HUBER, RIDGE, IV, DIDIM, TWO_STAGE, MIXED, TLS, WLS, OLS)
}


def estimator_of(name: str) -> Estimator:
    """Find an estimator by name; raises GtauError for one that does not exist."""
    if name not in ESTIMATORS:
        raise GtauError(f"there is no method '{name}'; choose from {', '.join(ESTIMATORS)}.")
    return ESTIMATORS[name]
