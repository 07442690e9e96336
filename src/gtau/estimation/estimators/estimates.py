"""Vector of estimates: the unknowns of the equations, their values, and their covariance by its parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gtau.robots.parameter import Parameter


@dataclass(frozen=True, eq=False)
class Estimates:
    """Estimates of ``unknowns`` (k,): base parameters, those of other effects, gains and delays.

    The covariance (k, k) is the sum of ``scatter``, what the ``scale`` adds, and ``model`` deficits. ``freedom`` (k,)
    are the degrees of freedom behind the scatter, None for very many.
    """

    unknowns: tuple[Parameter, ...]
    values: np.ndarray
    scatter: np.ndarray
    scale: np.ndarray
    model: np.ndarray
    freedom: np.ndarray | None

    @property
    def random(self) -> np.ndarray:
        """Random part: scatter, and uncertainty of the masses and calibrations that set the scale."""
        return self.scatter + self.scale

    @cached_property
    def covariance(self) -> np.ndarray:
        """All parts together."""
        return self.random + self.model

    @cached_property
    def effective_freedom(self) -> np.ndarray | None:
        """Degrees of freedom of all parts together (k,): all but the scatter counts as known (Satterthwaite)."""
        if self.freedom is None:
            return None
        scatter, total = np.diag(self.scatter), np.diag(self.covariance)
        share = np.divide(total, scatter, out=np.ones_like(total), where=scatter > 0)
        return np.asarray(self.freedom * share**2)

    @cached_property
    def places(self) -> Mapping[str, int]:
        """Place of each unknown in the vector, by its name."""
        return {unknown: k for k, unknown in enumerate(self.unknowns)}

    def select(self, unknowns: Sequence[Parameter]) -> Estimates:
        """Return the estimates of some unknowns, in their order."""
        at = [self.places[unknown] for unknown in unknowns]
        scatter, scale, model = (part[np.ix_(at, at)] for part in (self.scatter, self.scale, self.model))
        freedom = None if self.freedom is None else self.freedom[at]
        return Estimates(tuple(unknowns), self.values[at], scatter, scale, model, freedom)

    def updated(
        self, unknowns: Sequence[Parameter], values: np.ndarray, slopes: np.ndarray, scatter: np.ndarray, freedom: float
    ) -> Estimates:
        """Replace the estimates of ``unknowns``, or append them, by those of a later stage that rests on the others.

        Parameters
        ----------
        unknowns : sequence of Parameter
            Those that the stage estimates, (m,).
        values : ndarray
            (m,).
        slopes : ndarray
            (m, k) derivatives of these by the estimates so far.
        scatter : ndarray
            (m, m) covariance that the stage adds.
        freedom : float
            Degrees of freedom behind it.
        """
        every = (*self.unknowns, *(unknown for unknown in unknowns if unknown not in self.places))
        place = {unknown: k for k, unknown in enumerate(every)}
        at = [place[unknown] for unknown in unknowns]
        T = np.eye(len(every), len(self.unknowns))
        T[at] = slopes
        own = np.zeros((len(every), len(every)))
        own[np.ix_(at, at)] = scatter
        all_values = np.append(self.values, np.zeros(len(every) - len(self.values)))
        all_values[at] = values
        nu = None
        if self.freedom is not None:
            nu = np.append(self.freedom, np.zeros(len(every) - len(self.values)))
            nu[at] = freedom
        parts = (T @ self.scatter @ T.T + own, T @ self.scale @ T.T, T @ self.model @ T.T)
        return Estimates(every, all_values, *parts, nu)
