"""An identified model as equations of another estimation: its parameters, with their covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gtau.robots.parameter import Parameter

LEAST = 1e-9  # of the largest eigenvalue of the correlations: smaller ones are rounding


@dataclass(frozen=True, eq=False)
class ReferenceModel:
    """Parameters known from elsewhere: ``values`` (k,) of ``names`` with their ``covariance`` (k, k)."""

    names: tuple[Parameter, ...]
    values: np.ndarray
    covariance: np.ndarray

    def among(self, parameters: Sequence[Parameter]) -> np.ndarray:
        """Write those among ``parameters`` (n,) as equations ``[P | y]`` (k, n + 1) with errors of unit variance."""
        places = {name: place for place, name in enumerate(parameters)}
        at = [k for k, name in enumerate(self.names) if name in places]
        std = np.sqrt(np.diag(self.covariance)[at])
        sizes, vectors = np.linalg.eigh(self.covariance[np.ix_(at, at)] / np.outer(std, std))
        whitened = (vectors / np.sqrt(np.maximum(sizes, LEAST * sizes.max(initial=0.0)))).T / std
        rows = np.zeros((len(at), len(parameters) + 1))
        rows[:, [places[self.names[k]] for k in at]] = whitened
        rows[:, -1] = whitened @ self.values[at]
        return rows
