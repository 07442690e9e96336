"""Samples of the identified distribution: models as far apart as the data allow, each physically consistent.

Parameters, drive gains and delays are drawn together, with the correlations of the result's covariance and the marginal
distributions of their intervals (Student's t), among rigid bodies only. Directions that the data leave open are drawn
about the inertias of the robot's file.

The density is the likelihood of the estimates times a Wishart prior on the pseudo-inertia P of every body,
``|P|^k exp(-nu/2 tr(P0^-1 P))``: its exponent is the entropic (log-determinant) divergence from the file's P0. It is
sampled within the cone of positive definite P by Hamiltonian paths (Duane et al., 1987), so that no draw has to be
moved into the cone from outside.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import chdtri, gammaln, ndtri, stdtr

from gtau.errors import GtauError
from gtau.estimation.estimators.physical_consistency import SLENDER, natural_size
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.result import IdentifiedModel
from gtau.export.consistent import consistent_model
from gtau.robots.geometry import characteristic_length
from gtau.robots.parameter import BASIS, DISSIPATING, SHAPES, Parameter, pseudo_inertia
from gtau.robots.robot import INERTIAL, PLAIN_FRICTION

ALLOWED = 1.0  # standard deviations by which a draw may lie outside what was identified
TRUST = 0.3  # relative standard deviation of a body's mass where the data say nothing, as --prior-inertias 0.3
FREEDOM = 2 / TRUST**2  # of the Wishart distribution, whose diagonal has the relative variance 2 / freedom
EXPONENT = (FREEDOM - 5) / 2  # of the determinant of a 4 x 4 matrix
THINNER = 0.02  # least radius of gyration of a body, in lengths of the robot: files have point masses
LEAST = 0.1  # share of a correlation's variance that directions without scatter have: the jackknife has few blocks
BARRIER = 0.1  # exponent of what is not negative: small beside FREEDOM
SMALL = 1e-3  # natural sizes: where the search for what is not negative begins
GIVEN = 1e-6  # natural sizes: standard deviation of what has none
PATHS = 4  # from draw to draw
LENGTH = 1.5  # of a path, in standard deviations
STEP = (0.1, 0.25)
STEPS = 500  # of Newton's method
ROUNDING = 1e-9  # share of a step that is too short to matter
SETTLED = 1e-6  # square of the last step, in standard deviations
TOO_FAR = (
    "no rigid bodies near the robot file have the identified parameters, so there is nothing to draw; settle "
    "what contradicts in the result and the file, or leave out --samples."
)


@dataclass(frozen=True, eq=False)
class Draws:
    """Draws of an identified model, N of each quantity, SI units.

    ``standard`` parameters (N, n_st) are in the order of the robot's model, ``gains`` and ``delays`` (N, n) in the
    order of its actuated joints; the model predicts with ``friction`` (N,). ``moved`` (N,) is the distance by which
    rigid bodies keep each draw outside the 95 % region of the estimates, in standard deviations; ``shifts`` the
    distance of the mean of the draws from each estimate, in its standard deviations.
    """

    result: IdentifiedModel
    standard: np.ndarray
    gains: np.ndarray
    delays: np.ndarray
    friction: dict[Parameter, np.ndarray]
    moved: np.ndarray
    shifts: Mapping[Parameter, float]
    seed: int

    @property
    def base(self) -> np.ndarray:
        """Base parameters (N, n_b)."""
        return self.standard @ self.result.base.matrix.T

    @property
    def moved_share(self) -> float:
        """Share of the draws that lie outside the identified region by more than ``ALLOWED``."""
        return float(np.mean(self.moved > ALLOWED))

    @property
    def note(self) -> str:
        """Report the number of draws, their masses, and how far rigid bodies keep them from the estimates."""
        names = self.result.idm.parameter_names
        masses = self.standard[:, [name.kind == "m" for name in names]].sum(axis=1)
        low, middle, high = np.quantile(masses, [0.025, 0.5, 0.975])
        worst = max(self.shifts, key=lambda name: self.shifts[name])
        said = (
            f"{len(self.moved)} draws of the identified model (seed {self.seed}), all of rigid bodies: "
            f"the moving mass is {middle:.3g} kg ({low:.3g} to {high:.3g}); "
            "the mean of the draws differs from the estimates by at most "
            f"{self.shifts[worst]:.2g} standard deviations ('{worst}')"
        )
        if not self.moved_share:
            return f"{said}, and no draw lies more than {ALLOWED:g} outside their 95 % region"
        return (
            f"{said}; {100 * self.moved_share:.0f} % of the draws lie more than {ALLOWED:g} standard deviation outside "
            f"the 95 % region of the estimates (at most {self.moved.max():.2g}), as rigid bodies near it do not exist: "
            "do not use the draws before the verdicts and the robot file are settled"
        )

    def npz(self) -> bytes:
        """Return the draws as an NPZ file with names."""
        model, file = self.result.idm, io.BytesIO()
        np.savez(
            file,
            joints=np.array(model.actuated),
            standard_names=np.array(model.parameter_names),
            standard=self.standard,
            base_names=np.array(self.result.base.names),
            base=self.base,
            gains=self.gains,
            delays=self.delays,
            friction_names=np.array(list(self.friction), dtype=str),
            friction=np.column_stack([*self.friction.values()] or [np.zeros((len(self.moved), 0))]),
            moved=self.moved,
            seed=np.array(self.seed),
        )
        return file.getvalue()

    def results(self) -> Iterator[IdentifiedModel]:
        """Convert each draw to a result, the input of every export."""
        result, consistency = self.result, self.result.consistency
        assert consistency is not None
        names, joints = result.idm.parameter_names, result.idm.actuated
        for k, base in enumerate(self.base):
            gains = dict(zip(joints, self.gains[k].tolist(), strict=True))
            standard = dict(zip(names, self.standard[k].tolist(), strict=True))
            exact = {joint: (gain, 0.0) for joint, gain in gains.items()}
            friction = {name: values[k] for name, values in self.friction.items()}
            yield result.replaced(
                consistency=replace(consistency, standard=standard, gains=exact),
                drive_gains=_with(result.drive_gains, joints, self.gains[k]),
                parameters=_with(result.parameters, result.base.names, base),
                friction=_with(result.friction, friction, friction.values()),
                delays=_with(result.delays, joints, self.delays[k]),
            )


def _with(estimates: Mapping[Any, Estimate], names: Iterable[Any], values: Iterable[float]) -> dict[Any, Estimate]:
    drawn = {name: float(value) for name, value in zip(names, values, strict=True)}
    return {name: replace(old, value=drawn.get(name, old.value)) for name, old in estimates.items()}


def draw(result: IdentifiedModel, count: int, seed: int = 0) -> Draws:
    """Draw ``count`` models from the distribution identified with ``consistent=True``."""
    consistent_model(result, "samples")
    if not 0 < count <= 100_000:
        raise GtauError(f"the number of samples is {count}; ask for 1 to 100000.")
    if not np.diag(result.covariance).any():
        raise GtauError("the model has no standard deviations to draw from; identify it again.")
    base, n = result.base, len(result.idm.parameter_names)
    estimates = _estimates(result)
    target, unit, start = _target_of(result, estimates)
    y = target.draws(start, count, seed)
    x = y[:, :n] * unit
    deviations = target.deviations(y)
    changes = dict(zip(list(estimates)[len(estimates) - y.shape[1] + n :], (y[:, n:]).T, strict=True))
    unchanged = np.zeros(count)

    def by_joint(kind: str, values: Iterable[float | None]) -> np.ndarray:
        drawn = [changes.get(Parameter(kind, joint), unchanged) for joint in result.idm.actuated]
        return np.column_stack([(value or 0.0) + change for value, change in zip(values, drawn, strict=True)])

    for name, standard, values in zip(base.names, base.standard, (x @ base.matrix.T).T, strict=True):
        changes[standard] = values - (result.parameters[name].value or 0.0)
    friction = {}
    for name, estimate in result.friction_parameters.items():
        value = estimate.value or 0.0
        friction[name] = value + changes.get(name, unchanged)
        if name.kind in PLAIN_FRICTION and name.kind in DISSIPATING and value >= 0:
            friction[name] = np.maximum(friction[name], 0.0)
    shifts = dict(zip(estimates, map(float, np.abs(deviations.mean(axis=0))), strict=True))
    gains = by_joint("gain", result.gains)
    delays = by_joint("delay", (delay.value for delay in result.delays.values()))
    return Draws(result, x, gains, delays, friction, target.outside(deviations), shifts, seed)


def _estimates(result: IdentifiedModel) -> dict[Parameter, Estimate]:
    """Collect the estimates that are drawn, by their names in the covariance; base parameters come first."""
    deviations = dict(zip(result.covariance_names, np.diag(result.covariance), strict=True))
    more = {Parameter("gain", joint): estimate for joint, estimate in result.drive_gains.items()}
    more |= {Parameter("delay", joint): estimate for joint, estimate in result.delays.items()}
    more |= {name: estimate for name, estimate in result.friction.items() if name.kind not in SHAPES}
    base = {name: estimate for name, estimate in result.parameters.items() if estimate.value is not None}
    return base | {name: estimate for name, estimate in more.items() if deviations.get(name) and name not in base}


@dataclass(frozen=True, eq=False)
class Target:
    """Density of unknowns y (n + r,): standard parameters and other estimates, over their natural sizes.

    ``S @ y`` are estimates of ``means``, in standard deviations, of which ``information`` is the inverse correlation;
    ``freedom`` is infinite where they are normal. Body b has the pseudo-inertia ``sum_k y[places[b, k]] basis[b, k]``,
    in units in which the pseudo-inertia of the file is the identity; the rest is ``about`` values with a ``stiffness``,
    (n + r,).
    """

    S: np.ndarray
    means: np.ndarray
    information: np.ndarray
    freedom: np.ndarray
    places: np.ndarray
    basis: np.ndarray
    positive: np.ndarray
    about: np.ndarray
    stiffness: np.ndarray

    def deviations(self, y: np.ndarray) -> np.ndarray:
        """Return differences from the estimates, in standard deviations."""
        return np.asarray(y @ self.S.T - self.means)

    def scores(self, u: np.ndarray) -> np.ndarray:
        """Compute normal scores of standardised differences ``u``."""
        t = np.isfinite(self.freedom)
        z = u.copy()
        z[..., t] = -np.sign(u[..., t]) * ndtri(stdtr(self.freedom[t], -np.abs(u[..., t])))
        return z

    def outside(self, u: np.ndarray) -> np.ndarray:
        """Compute how far standardised differences (N, m) lie outside the 95 % region, in standard deviations."""
        z = self.scores(u)
        distance = np.sqrt(np.einsum("ni,ij,nj->n", z, self.information, z))
        return np.asarray(np.maximum(distance - np.sqrt(chdtri(len(self.means), 0.05)), 0.0))

    def bodies(self, y: np.ndarray) -> np.ndarray:
        """Return the pseudo-inertias (b, 4, 4)."""
        return np.einsum("bk,bkij->bij", y[self.places], self.basis)

    def energy(self, y: np.ndarray, normal: bool = False) -> tuple[float, np.ndarray]:
        """Compute the negative logarithm of the density and its gradient, inf outside the cone."""
        P = self.bodies(y)
        if y[self.positive].min(initial=1.0) <= 0 or np.linalg.eigvalsh(P)[:, 0].min() <= 0:
            return np.inf, np.zeros_like(y)
        u = self.deviations(y)
        if normal:
            slope = self.information @ u
            value = u @ slope / 2
        else:
            t, f = np.isfinite(self.freedom), self.freedom[np.isfinite(self.freedom)]
            z = self.scores(u)
            slope = self.information @ z
            value = (z @ slope - z[t] @ z[t]) / 2 + np.sum((f + 1) / 2 * np.log1p(u[t] ** 2 / f))
            density = np.exp(gammaln((f + 1) / 2) - gammaln(f / 2) + z[t] ** 2 / 2) * np.sqrt(2 / f)
            density *= (1 + u[t] ** 2 / f) ** (-(f + 1) / 2)  # dz/du: density of Student's t over the normal density
            slope[t] = (slope[t] - z[t]) * density + (f + 1) * u[t] / (f + u[t] ** 2)
        apart = y - self.about
        pulled = self.stiffness * apart
        value += apart @ pulled / 2 - BARRIER * np.log(y[self.positive]).sum()
        value += FREEDOM / 2 * np.trace(P, axis1=1, axis2=2).sum() - EXPONENT * np.linalg.slogdet(P)[1].sum()
        gradient = self.S.T @ slope + pulled
        gradient[self.positive] -= BARRIER / y[self.positive]
        if not np.isfinite(value):  # so far outside that Student's t has no score
            return np.inf, np.zeros_like(y)
        pull = FREEDOM / 2 * np.eye(4) - EXPONENT * np.linalg.inv(P)
        gradient[self.places] += np.einsum("bij,bkij->bk", pull, self.basis)
        return float(value), gradient

    def mode(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Find the mode and the Hessian there of normal estimates, from ``y`` within the cone."""
        data_precision = self.S.T @ self.information @ self.S + np.diag(self.stiffness)
        for _ in range(STEPS):
            now, gradient = self.energy(y, normal=True)
            turned = np.einsum("bij,bkjl->bkil", np.linalg.inv(self.bodies(y)), self.basis)
            H = data_precision.copy()
            H[self.places[:, :, None], self.places[:, None, :]] += EXPONENT * np.einsum(
                "bkij,blji->bkl", turned, turned
            )
            H[self.positive, self.positive] += BARRIER / y[self.positive] ** 2
            step, size = -np.linalg.solve(H, gradient), 1.0
            decrease = float(-gradient @ step)
            if decrease < SETTLED:
                return y, H
            while self.energy(y + size * step, normal=True)[0] > now - 0.1 * size * decrease:
                size /= 2
                if size < ROUNDING:
                    return y, H
            y = y + size * step
        raise GtauError(TOO_FAR)

    def near(self, y: np.ndarray) -> Target:
        """Return the density whose prior is about the bodies of ``y``."""
        turn = np.linalg.inv(np.linalg.cholesky(self.bodies(y)))[:, None]
        return replace(self, basis=turn @ self.basis @ turn.swapaxes(-1, -2))

    def draws(self, start: np.ndarray, count: int, seed: int) -> np.ndarray:
        """Draw unknowns (count, n + r)."""
        rng = np.random.default_rng(seed)
        y, H = self.mode(start)
        try:
            T = np.linalg.inv(np.linalg.cholesky(H)).T  # unknowns of unit variance, were the density normal
        except np.linalg.LinAlgError:  # of a mode at the edge of the cone
            raise GtauError(TOO_FAR) from None
        value, gradient = self.energy(y)
        if not np.isfinite(value):
            raise GtauError(TOO_FAR)
        drawn = np.zeros((count, len(y)))
        for k in range(count * PATHS):
            new, p = y, rng.standard_normal(len(y))
            energy, step = value + p @ p / 2, rng.uniform(*STEP)
            ahead, slope = value, gradient
            for _ in range(round(LENGTH / step)):
                p = p - step / 2 * (T.T @ slope)
                new = new + step * (T @ p)
                ahead, slope = self.energy(new)
                if not np.isfinite(ahead):
                    break
                p = p - step / 2 * (T.T @ slope)
            if np.log(rng.uniform()) < energy - ahead - p @ p / 2:
                y, value, gradient = new, ahead, slope
            drawn[k // PATHS] = y
        return drawn


def _target_of(
    result: IdentifiedModel, estimates: Mapping[Parameter, Estimate]
) -> tuple[Target, np.ndarray, np.ndarray]:
    """Build the density of parameters and ``estimates``, with natural sizes (n,) and a start (n + r,)."""
    robot, base, names = result.robot, result.base, result.idm.parameter_names
    assert result.consistency is not None
    standard = np.array([result.consistency.standard[name] for name in names])
    place = {name: k for k, name in enumerate(names)}
    bodies = [body for body in robot.bodies if Parameter("m", body) in place]
    places = np.array([[place[Parameter(kind, body)] for kind in INERTIAL] for body in bodies])
    length, mass = characteristic_length(robot), float(standard[places[:, -1]].sum())
    unit = np.array([natural_size(name, robot, mass, length) for name in names])
    rows = [base.names.index(name) for name in estimates if name in base.names]
    n, r = len(names), len(estimates) - len(rows)
    S = np.zeros((len(estimates), n + r))
    S[: len(rows), :n], S[len(rows) :, n:] = base.matrix[rows] * unit, np.eye(r)
    order = {name: k for k, name in enumerate(result.covariance_names)}
    seen = np.array([name in order for name in estimates])
    chosen = [order[name] for name in estimates if name in order]
    C = np.zeros((len(estimates), len(estimates)))
    C[np.ix_(seen, seen)] = result.covariance[np.ix_(chosen, chosen)]
    std = np.sqrt(np.diag(C))
    given = std == 0
    std[given] = GIVEN * np.linalg.norm(S[given], axis=1)
    C[given, given] = std[given] ** 2
    sizes, axes = np.linalg.eigh(C / np.outer(std, std))
    information = axes / (np.maximum(sizes, 0.0) + LEAST) @ axes.T
    means = np.array([estimate.value for estimate in estimates.values()], dtype=float)
    means[len(rows) :] = 0.0
    freedom = np.array([estimate.freedom or np.inf for estimate in estimates.values()])
    about, stiffness = np.append(standard / unit, np.zeros(r)), np.append(np.ones(n), np.zeros(r))
    stiffness[[place[name] for name in base.without_effect]] = GIVEN**-2
    stiffness[places] = 0.0
    y = about.copy()
    for body, at in zip(bodies, places, strict=True):
        stated = np.array([dict(robot.inertias).get(Parameter(kind, body), 0.0) for kind in INERTIAL])
        if stated[-1] > 0:
            y[at] = _plausible(stated, THINNER * length) / unit[at]
        else:
            y[at] = _plausible(y[at] * unit[at], SLENDER * length) / unit[at]
    positive = np.flatnonzero([name.kind in DISSIPATING for name in names])
    y[positive] = np.maximum(y[positive], SMALL)
    basis = BASIS * unit[places][:, :, None, None]
    scaled = S / std[:, None]
    target = Target(scaled, means / std, information, freedom, places, basis, positive, about, stiffness)
    return target.near(y), unit, y


def _plausible(values: np.ndarray, least: float) -> np.ndarray:
    """Return parameters (10,) of a body with radii of gyration of at least ``least``, m, about its centre of mass."""
    P, m = pseudo_inertia(values), values[-1]
    center = P[:3, 3] / m
    spread, axes = np.linalg.eigh(P[:3, :3] - m * np.outer(center, center))
    sigma = (axes * np.maximum(spread, m * least**2)) @ axes.T + m * np.outer(center, center)
    tensor = np.trace(sigma) * np.eye(3) - sigma
    return np.array([*tensor[np.triu_indices(3)], *(m * center), m])
