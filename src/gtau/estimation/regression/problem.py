"""The estimation problem, ready to solve: every channel's equations as small matrices (eqs. 29 to 33).

Row block (u, j) holds the equations of channel j in unit u, a block of a run, with the columns of
:mod:`gtau.estimation.regression.factors`: the columns of the model act on the unknown parameters ``theta`` (base
parameters, then what every other effect adds), ``known`` is ``W_kl chi_kl`` minus the torques of measured wrenches, and
v is a current reference, or the torque of a channel with the gain 1. The rows may be those of the decimated system or
their triangular factor: all estimators depend on them only through ``A^T A``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import InitVar, dataclass, field, replace
from functools import cached_property

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.regression.factors import FIXED, KNOWN, MODEL, SIGNAL, delayed_signal, select_columns, triangle
from gtau.model.base_parameters import independent_columns
from gtau.robots.parameter import Parameter
from gtau.signals.channel import Channel


def longest_delay(bandwidth: float) -> float:
    """Return the longest delay, s, that an expansion in derivatives describes of motion of some ``bandwidth``, Hz."""
    return 0.5 / (2 * np.pi * bandwidth)


def best_delay(rest: np.ndarray, longest: float) -> float:
    """Find the delay d, s, with ``|d| < longest`` that leaves least of ``v - d v' + d^2/2 v''`` in rows (., 3)."""
    if len(rest) < 2:
        return 0.0
    r, r1, r2 = rest.T
    # |r - d r1 + d^2/2 r2|^2 is a quartic in d
    quartic = np.array([r2 @ r2 / 4, -(r1 @ r2), r1 @ r1 + r @ r2, -2 * (r @ r1), r @ r])
    stationary = np.roots(np.polyder(quartic))
    real = stationary[np.abs(stationary.imag) < 1e-12].real
    real = real[np.abs(real) < longest]  # none of them without a delay
    return float(real[np.argmin(np.polyval(quartic, real))]) if real.size else 0.0


class Unknowns(tuple[Parameter, ...]):
    """Unknowns in order, (k,): the parameters of the model, theta, then the gains and delays of the channels."""

    @cached_property
    def places(self) -> Mapping[str, int]:
        """Place of each unknown in the vector; raises GtauError where two have one name."""
        places: dict[str, int] = {unknown: k for k, unknown in enumerate(self)}
        if alike := [name for k, name in enumerate(self) if places[name] != k]:
            bodies = " and ".join(f"'{name.body}'" for name in self if name == alike[0])
            raise GtauError(f"parameters of {bodies} are both called '{alike[0]}'; rename one of these joints.")
        return places

    def at(self, names: Iterable[str]) -> list[int]:
        """Find the places of some unknowns, in their order."""
        return [self.places[name] for name in names]

    @property
    def theta(self) -> slice:
        """Places of the model parameters."""
        return slice(0, self.gains.start)

    @cached_property
    def gains(self) -> slice:
        """Places of the channels' gains."""
        return self._of("gain")

    @cached_property
    def delays(self) -> slice:
        """Places of the channels' delays."""
        return self._of("delay")

    def _of(self, kind: str) -> slice:
        places = [k for k, name in enumerate(self) if name.kind == kind]
        return slice(places[0], places[-1] + 1) if places else slice(len(self), len(self))


@dataclass(frozen=True, eq=False)
class Estimates:
    """Estimates of ``unknowns`` (k,): base parameters, parameters of other effects, gains and delays.

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
        return self.freedom * np.divide(total, scatter, out=np.ones_like(total), where=scatter > 0) ** 2

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
        """Replace or append the estimates of ``unknowns`` (m,) by a stage that rests on the others.

        ``slopes`` (m, k) are derivatives of its ``values`` (m,) by the estimates so far; it adds the covariance
        ``scatter`` (m, m), with ``freedom`` degrees of freedom.
        """
        every = Unknowns((*self.unknowns, *(unknown for unknown in unknowns if unknown not in self.unknowns.places)))
        at, more = every.at(unknowns), len(every) - len(self.unknowns)
        T = np.eye(len(every), len(self.unknowns))
        T[at] = slopes
        added = np.zeros((len(every), len(every)))
        added[np.ix_(at, at)] = scatter
        all_values = np.pad(self.values, (0, more))
        all_values[at] = values
        nu = None if self.freedom is None else np.pad(self.freedom, (0, more))
        if nu is not None:
            nu[at] = freedom
        parts = (T @ self.scatter @ T.T + added, T @ self.scale @ T.T, T @ self.model @ T.T)
        return Estimates(every, all_values, *parts, nu)


@dataclass(frozen=True, eq=False)
class MotorEquation:
    """What a joint's voltages alone say, ``u = R i + (ke / c) qd``: its back-EMF constant and resistance.

    ``ke`` (V s/rad or V s/m) and ``resistance`` (ohm) have the ``covariance`` (2, 2); the drive gain differs from ke by
    the relative standard deviation ``commutation``, which is ``stated`` or assumed. ``explained`` is the share of the
    voltage's variance that goes with current, its sign and speed.
    """

    joint: str
    ke: float
    resistance: float
    covariance: np.ndarray
    commutation: float
    stated: bool
    explained: float

    @property
    def std(self) -> float:
        """Standard deviation of the drive gain."""
        return float(np.hypot(np.sqrt(self.covariance[0, 0]), self.commutation * self.ke))


@dataclass(frozen=True)
class Problem:
    """Equations ``v(t - d_j) g_j = W_theta theta + known`` of all channels.

    ``parameters`` are theta (n_theta,), ``channels`` the signals explained (c,), of the n actuated joints and then of
    torque sensors. ``make_blocks`` makes the ``blocks`` (U, c, p, n_theta + 4), rows or triangular factors, when first
    needed; ``rows`` (U, c) count the equations behind each. ``longest_delays`` (c,), s, are the longest that the
    expansion in derivatives can describe, 0 where none is estimated. ``known`` (k, n_theta + 1) are further equations
    ``[P | y]``: ``P theta = y`` with errors of unit variance. ``voltages`` (m, 3) are equations of gains: the number of
    a channel, its ``1 / g``, and one over the standard deviation of this. ``wrenches`` are the bodies with measured
    wrenches, minus whose joint torques are in the column ``known``. ``clusters`` (U,) number the blocks, those alike
    that the jackknife leaves out together, of runs that repeat a motion. ``factored`` and ``independent`` are
    ``triangles`` and ``own_columns`` where known.
    """

    parameters: tuple[Parameter, ...]
    channels: tuple[Channel, ...]
    make_blocks: Callable[[], np.ndarray]
    rows: np.ndarray
    longest_delays: np.ndarray
    known: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    voltages: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    wrenches: tuple[str, ...] = ()
    clusters: np.ndarray | None = None
    factored: InitVar[tuple[np.ndarray, ...] | None] = None
    independent: InitVar[tuple[list[int], ...] | None] = None

    def __post_init__(self, factored: tuple[np.ndarray, ...] | None, independent: tuple[list[int], ...] | None) -> None:
        if not self.known.size:
            object.__setattr__(self, "known", np.zeros((0, len(self.parameters) + 1)))
        for name, value in (("triangles", factored), ("own_columns", independent)):
            if value is not None:
                object.__setattr__(self, name, value)

    @cached_property
    def blocks(self) -> np.ndarray:
        """The blocks, (U, c, p, n_theta + 4)."""
        return self.make_blocks()

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Actuated joints, including the joints of a floating base, (n,)."""
        return tuple(channel.joint for channel in self.channels if not channel.kind.link_side)

    @cached_property
    def sensor_channels(self) -> list[int]:
        """Numbers of the channels that measure a joint's torque itself, with the gain 1."""
        kinds = [channel.kind for channel in self.channels]
        return [k for k, kind in enumerate(kinds) if kind.measures_joint and not kind.unknown_gain]

    @cached_property
    def base(self) -> list[int]:
        """Numbers of the channels that are rows of a floating base."""
        return [k for k, channel in enumerate(self.channels) if not channel.kind.measures_joint]

    @cached_property
    def unknown_gains(self) -> np.ndarray:
        """Mask of the channels with a gain to estimate, (c,)."""
        return np.array([channel.kind.unknown_gain for channel in self.channels])

    @property
    def scaled(self) -> bool:
        """Decide whether sensors, measured wrenches, known parameters or voltages fix the scale of the gains."""
        return not self.unknown_gains.all() or bool(self.wrenches or len(self.known) or len(self.voltages))

    @cached_property
    def units(self) -> tuple[np.ndarray, ...]:
        """Units of the jackknife in turn, (c, ., n_theta + 4): a block, or all blocks in step."""
        if self.clusters is None:
            return tuple(self.blocks)
        together = (self.blocks[self.clusters == number] for number in np.unique(self.clusters))
        return tuple(np.concatenate(blocks, axis=1) for blocks in together)

    @cached_property
    def unknowns(self) -> Unknowns:
        """All unknowns in order, (k,): the parameters, then gains and delays of the channels."""
        names = [channel.name for channel in self.channels]
        return Unknowns((*self.parameters, *(Parameter(kind, name) for kind in ("gain", "delay") for name in names)))

    @property
    def gain_rows(self) -> slice:
        """Places of the joints' gains in ``unknowns``."""
        return slice(self.n_theta, self.n_theta + len(self.joints))

    @property
    def n_theta(self) -> int:
        """Number of unknown parameters."""
        return len(self.parameters)

    @cached_property
    def triangles(self) -> tuple[np.ndarray, ...]:
        """Each channel's triangular factor over all units, c arrays (., n_theta + 4)."""
        return tuple(triangle(*self.blocks[:, j]) for j in range(len(self.channels)))

    @cached_property
    def own_columns(self) -> tuple[list[int], ...]:
        """For each channel, the columns of [W_theta | known] that are independent in its own equations."""
        return tuple(independent_columns(R[:, : KNOWN + 1])[0] for R in self.triangles)

    @cached_property
    def own_currents(self) -> tuple[np.ndarray, ...]:
        """Residuals of v, v', v'' from each channel's own model: (3, 3) triangles, one a channel."""
        signals = range(self.n_theta + 1, self.n_theta + FIXED)
        return tuple(
            select_columns(R, [*columns, *signals])[len(columns) :, len(columns) :]
            for R, columns in zip(self.triangles, self.own_columns, strict=True)
        )

    @cached_property
    def total_rows(self) -> np.ndarray:
        """Equations of each channel, (c,), at least one: of a joint that never moves it says nothing."""
        return np.maximum(self.rows.sum(axis=0), 1)

    @cached_property
    def own_delays(self) -> np.ndarray:
        """Delay of each channel (s), (c,), with the best fit of its own model; zero if beyond ``longest_delays``."""
        return np.array(list(map(best_delay, self.own_currents, self.longest_delays)))

    @cached_property
    def own_sigma(self) -> np.ndarray:
        """Standard deviation of each channel about its own model (eq. 28), (c,)."""
        rest = zip(self.own_currents, self.own_delays, strict=True)
        squares = np.array([np.sum(delayed_signal(T, delay) ** 2) for T, delay in rest])
        free = np.maximum(self.total_rows - [len(columns) for columns in self.own_columns], 1)
        sigma = np.maximum(np.sqrt(squares / free), self.smallest_sigma)
        # without a signal its own model gives no error level: start with the level of the least weight
        return np.where(self.silent, sigma.max() or 1.0, sigma)

    @cached_property
    def signal(self) -> np.ndarray:
        """Each channel's current or torque, rms, (c,)."""
        norms = [np.linalg.norm(R[:, SIGNAL]) for R in self.triangles]
        return np.asarray(norms / np.sqrt(self.total_rows))

    @cached_property
    def silent(self) -> np.ndarray:
        """Mask of the channels without a signal, (c,), such as a direction without forces on a base."""
        return self.signal == 0.0

    def balance(self, theta: np.ndarray) -> np.ndarray:
        """Return each channel's signal, rms, (c,); for a silent one the largest of the terms that cancel each other."""
        return np.where(self.silent, self.largest_terms(theta), self.signal)

    def largest_terms(self, theta: np.ndarray) -> np.ndarray:
        """Return the largest of the model's terms in each channel, rms, (c,)."""
        terms = [np.linalg.norm(R[:, MODEL], axis=0) * np.abs(theta) for R in self.triangles]
        largest = np.array([sizes.max(initial=0.0) for sizes in terms])
        return np.asarray(largest / np.sqrt(self.total_rows))

    @property
    def smallest_sigma(self) -> np.ndarray:
        """Rounding error of each channel, (c,): the lower limit of its error level."""
        return np.maximum(1e-10 * self.signal, 1e-150)

    def weights(self, squares: np.ndarray) -> np.ndarray:
        """Return one over the rms of each channel's residuals, (c,), from the sums of their ``squares`` (c,)."""
        return np.asarray(1 / np.maximum(np.sqrt(squares / self.total_rows), self.smallest_sigma))

    def total_rows_of(self, block: np.ndarray, j: int, signal: np.ndarray | None = None) -> np.ndarray:
        """Build rows ``[-W_theta  V_tau  -known]`` of ``W_tot`` (eq. 33) from a channel's block, with a ``signal``."""
        n = self.n_theta
        rows = np.zeros((len(block), self.n_theta + len(self.channels) + 1))
        rows[:, :n], rows[:, -1] = -block[:, MODEL], -block[:, KNOWN]
        signal = delayed_signal(block, self.own_delays[j]) if signal is None else signal
        rows[:, n + j if self.unknown_gains[j] else -1] += signal
        return rows

    @property
    def total_known(self) -> np.ndarray:
        """Known parameters, and gains from voltages, as rows of ``W_tot``, (k + m, n_theta + c + 1)."""
        signs = np.append(-np.ones(self.n_theta), 1.0)
        parameters = np.insert(self.known * signs, [self.n_theta] * len(self.channels), 0.0, axis=1)
        channels, inverse, weights = self.voltages.T
        gains = np.zeros((len(channels), parameters.shape[1]))
        gains[range(len(gains)), self.n_theta + channels.astype(int)] = -weights * inverse**2
        gains[:, -1] = weights * inverse
        return np.vstack([parameters, gains])

    def columns_of(self, names: Iterable[str]) -> list[int]:
        """Find the columns of some parameters in the blocks, and those behind the model."""
        return [*self.unknowns.at(names), *range(self.n_theta, self.n_theta + FIXED)]

    def without(self, names: Sequence[str]) -> Problem:
        """Set the parameters ``names`` of a problem to zero."""
        kept = tuple(name for name in self.parameters if name not in names)
        columns = self.columns_of(kept)
        known = self.known[:, [*columns[:-FIXED], -1]]
        # the triangles of fewer columns follow from the triangles of all: no pass over the units
        triangles = tuple(select_columns(R, columns) for R in self.triangles)
        # columns that depended on others still do if these are all there, or if there are none
        now = {old: new for new, old in enumerate(columns)}
        independent = tuple(
            [now[k] for k in chosen if k in now]
            if now.keys() >= set(chosen) or len(chosen) == np.count_nonzero(R[:, : KNOWN + 1].any(axis=0))
            else independent_columns(T[:, : KNOWN + 1])[0]
            for chosen, R, T in zip(self.own_columns, self.triangles, triangles, strict=True)
        )

        def blocks() -> np.ndarray:
            return self.blocks[..., columns]

        return replace(
            self, parameters=kept, make_blocks=blocks, known=known, factored=triangles, independent=independent
        )
