"""Vector of estimates: the unknowns of the equations, their values, and their covariance by its parts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gtau.robots.parameter import Parameter


class Unknowns(tuple[Parameter, ...]):
    """Unknowns in order, (k,): the parameters of the model, theta, then the gains and delays of the channels."""

    @cached_property
    def places(self) -> Mapping[str, int]:
        """Place of each unknown in the vector."""
        return {unknown: k for k, unknown in enumerate(self)}

    def at(self, names: Iterable[str]) -> list[int]:
        """Find the places of some unknowns, in their order."""
        return [self.places[name] for name in names]

    def select(self, kind: str | None = None, body: str | None = None) -> Unknowns:
        """Select the unknowns of a kind, of a body, joint or channel, or of both."""
        return Unknowns(name for name in self if kind in (None, name.kind) and body in (None, name.body))

    @cached_property
    def theta(self) -> slice:
        """Those of the model."""
        return slice(0, self.gains.start)

    @cached_property
    def gains(self) -> slice:
        """Gains of the channels."""
        return self._of("gain")

    @cached_property
    def delays(self) -> slice:
        """Delays of the channels."""
        return self._of("delay")

    def _of(self, kind: str) -> slice:
        places = self.at(self.select(kind))
        return slice(places[0], places[-1] + 1) if places else slice(len(self), len(self))


@dataclass(frozen=True, eq=False)
class Estimates:
    """Estimates of ``unknowns`` (k,): base parameters, those of other effects, gains and delays.

    The covariance (k, k) is the sum of ``scatter``, what the ``scale`` adds, and ``model`` deficits. ``freedom`` (k,)
    are the degrees of freedom behind the scatter, None for very many.
    """

    unknowns: Unknowns
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

    def __getitem__(self, name: str) -> float:
        """Value of an unknown."""
        return float(self.values[self.unknowns.places[name]])

    def select(self, unknowns: Sequence[Parameter]) -> Estimates:
        """Return the estimates of some unknowns, in their order."""
        at = self.unknowns.at(unknowns)
        scatter, scale, model = (part[np.ix_(at, at)] for part in (self.scatter, self.scale, self.model))
        freedom = None if self.freedom is None else self.freedom[at]
        return Estimates(Unknowns(unknowns), self.values[at], scatter, scale, model, freedom)

    def updated(
        self, unknowns: Sequence[Parameter], values: np.ndarray, slopes: np.ndarray, scatter: np.ndarray, freedom: float
    ) -> Estimates:
        """Replace the estimates of ``unknowns`` (m,), or append them, by those of a stage that rests on the others.

        ``slopes`` (m, k) are derivatives of its ``values`` (m,) by the estimates so far; it adds the covariance
        ``scatter`` (m, m), with ``freedom`` degrees of freedom.
        """
        every = Unknowns((*self.unknowns, *(unknown for unknown in unknowns if unknown not in self.unknowns.places)))
        at, more = every.at(unknowns), len(every) - len(self.unknowns)
        T = np.eye(len(every), len(self.unknowns))
        T[at] = slopes
        own = np.zeros((len(every), len(every)))
        own[np.ix_(at, at)] = scatter
        all_values = np.pad(self.values, (0, more))
        all_values[at] = values
        nu = None if self.freedom is None else np.pad(self.freedom, (0, more))
        if nu is not None:
            nu[at] = freedom
        parts = (T @ self.scatter @ T.T + own, T @ self.scale @ T.T, T @ self.model @ T.T)
        return Estimates(every, all_values, *parts, nu)
