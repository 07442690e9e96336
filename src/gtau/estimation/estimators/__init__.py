"""The estimators by name; a new one is a file and a line here, in another distribution an entry point.

Names are cheap to import, for the help of the command line; the estimators themselves are imported on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, cast

from gtau.errors import GtauError
from gtau.extensions import added, registered

if TYPE_CHECKING:
    from gtau.estimation.estimators.estimator import Estimator

PLACES = {
    "ml": "maximum_likelihood.ML",
    "huber": "maximum_likelihood.HUBER",
    "iv": "simulated_motion.IV",
    "didim": "simulated_motion.DIDIM",
    "2sls": "least_squares.TWO_STAGE",
    "tls": "least_squares.TLS",
    "wls": "least_squares.WLS",
    "ols": "least_squares.OLS",
}
"""Where each estimator stands, in this folder."""

NAMES = tuple(PLACES)
GROUP = "gtau.estimators"  # of the entry points of other distributions


def estimator_of(name: str) -> Estimator:
    """Find an estimator by name; raises GtauError for one that does not exist."""
    if name in PLACES:
        module, constant = PLACES[name].split(".")
        return cast("Estimator", getattr(import_module(f"gtau.estimation.estimators.{module}"), constant))
    if name not in registered(GROUP):
        raise GtauError(f"there is no method '{name}'; choose from {', '.join((*NAMES, *registered(GROUP)))}.")
    from gtau.estimation.estimators.estimator import Estimator

    return cast(Estimator, added(GROUP, name, Estimator))


def estimators() -> dict[str, Estimator]:
    """Import all built-in estimators, by name."""
    return {name: estimator_of(name) for name in PLACES}
