"""Fisher information of a motion about the unknowns, and design criteria with their derivatives.

The rows are the equations of :mod:`gtau.estimation.estimators.maximum_likelihood`, linearised at prior values,

    e_j = v(t - d_j) - (W theta + known) / g_j,

so the inverse of the information matrix is the expected covariance of (theta, log g, d). As in identification, it
covers all runs with their payloads and friction, and drops rows near reversals. Criteria work on triangular factors,
R^T R = M, because forming M would lose half the digits. The derivatives are by hand: CasADi's take six times as long.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from gtau.errors import GtauError, meant
from gtau.estimation.electrical import COMMUTATION
from gtau.estimation.regression.assembly import plain_problem
from gtau.estimation.regression.factors import EXTRA, MODEL, Factors, modelled, triangle
from gtau.excitation.prior import PriorModel
from gtau.model.base_parameters import BaseParameters
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.parameter import Parameter
from gtau.signals.reading.statements import Payload

VAGUE = 1e3  # prior standard deviation of each unknown over its scale: wide enough to have no influence


def _scales(names: tuple[Parameter, ...], theta: np.ndarray, payloads: Sequence[Payload | None]) -> np.ndarray:
    """Estimate the typical size of each parameter from its prior value, or else from the values of its kind."""
    kinds = np.array([name.kind for name in names])
    mass = max((payload.mass or 1.0 for payload in payloads if payload is not None), default=1.0)
    # a load of this mass about 0.1 m from the axis
    usual = {"m": mass, "mx": 0.1 * mass, "my": 0.1 * mass, "mz": 0.1 * mass, "fv": 1.0, "fs": 1.0, "off": 1.0}
    sizes = np.abs(theta)
    for k in np.flatnonzero(sizes == 0.0):
        alike = sizes[(kinds == kinds[k]) & (theta != 0.0)]
        sizes[k] = np.median(alike) if alike.size else usual.get(kinds[k], 0.01 * mass)
    return sizes


@dataclass(frozen=True, eq=False)
class Window:
    """Smooth weights of rows near reversals, on a periodic grid of instants ``step`` s apart.

    Identification drops a row if the joint is slower than ``fraction`` of its rms speed within ``reach`` s, the guard
    of the filter. ``floor`` (n,), rad/s or m/s, adds the speeds of approach and return to the rms; without it a joint
    that hardly moves would lose no rows. Here the loss is gradual: with ``s = u / sqrt(u^2 + fraction^2)`` of the
    relative speed u, a row has the weight ``s^2`` times the product of ``1 - share * (1 - s s') / 2`` over all cells
    of which a ``share`` is within reach.
    """

    step: float
    reach: float
    fraction: float
    floor: np.ndarray

    def weights(self, qd: np.ndarray) -> np.ndarray:
        """Compute the weights (n, N) of all joints' rows from speeds (n, N) over a period."""
        _, s, lost = self._speeds(qd)
        weights = s**2
        for offset, share in self._shares(qd.shape[1]):
            weights = weights * (1 - share * np.roll(lost, -offset, axis=1))
        return weights

    def back(self, qd: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """Convert derivatives (n, N) with respect to the weights into derivatives with respect to qd."""
        rms, s, lost = self._speeds(qd)
        by_weights = slopes * self.weights(qd)
        by_s, by_cell = 2 * by_weights / s, np.zeros_like(s)
        for offset, share in self._shares(qd.shape[1]):
            factor = np.roll(lost, -offset, axis=1)
            by_cell += np.roll(by_weights * -share / (1 - share * factor), offset, axis=1)
        # a cell's loss is (1 - s s') / 2
        by_s += -by_cell / 2 * np.roll(s, -1, axis=1) + np.roll(-by_cell / 2 * s, 1, axis=1)
        by_u = by_s * self.fraction**2 / ((qd / rms) ** 2 + self.fraction**2) ** 1.5
        return by_u / rms - qd * np.sum(by_u * qd, axis=1, keepdims=True) / rms**3 / qd.shape[1]

    def _speeds(self, qd: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return rms speeds (n, 1), s (n, N), and the loss (n, N) of every cell."""
        rms = np.sqrt(np.mean(qd**2, axis=1, keepdims=True) + self.floor[:, None] ** 2 + 1e-300)
        u = qd / rms
        s = np.where(u == 0, 1e-12, u) / np.sqrt(u**2 + self.fraction**2)
        return rms, s, (1 - s * np.roll(s, -1, axis=1)) / 2

    def _shares(self, samples: int) -> list[tuple[int, float]]:
        """List the offsets of cells (instant i + offset to the next) within reach of instant i, and their shares."""
        reach = min(self.reach / self.step, samples / 2 - 1)
        cells = range(-int(np.ceil(reach)), int(np.ceil(reach)))
        # below 1, so that derivatives stay finite where a cell is lost entirely
        overlap = [(cell, min(cell + 1, reach) - max(cell, -reach)) for cell in cells]
        return [(cell, min(share, 0.999)) for cell, share in overlap if share > 0]


def derivative(values: np.ndarray, step: float) -> np.ndarray:
    """Differentiate samples ``step`` apart of a periodic function along the last axis, to fourth order."""
    near, far = (np.roll(values, -k, axis=-1) - np.roll(values, k, axis=-1) for k in (1, 2))
    return np.asarray((8 * near - far) / (12 * step))


@dataclass(frozen=True, eq=False)
class Information:
    """The unknowns (theta, log g, d), and the information of rows about them."""

    names: tuple[Parameter, ...]  # parameters, then gains and delays
    scale: np.ndarray  # (P,) reference values of relative standard deviations
    # (runs, n, n_b, P) from a row of W to a row of the current's Jacobian, except for the delays
    maps: np.ndarray
    load: np.ndarray  # (runs, n_b) prior values of the base columns with payload
    smooth: np.ndarray  # (runs, n_b) the same without Coulomb friction
    cautious: np.ndarray  # (runs, n_b) the values used in torque limits
    gains: np.ndarray  # (n,) prior values
    counts: np.ndarray  # (n,) information of a current, 1/(A2 s)
    known: np.ndarray  # (., P) factor of the prior information: a vague prior, earlier experiments and voltages
    voltages: bool = False  # whether gains follow from voltages

    def jacobians(self, W: np.ndarray, run: int, step: float) -> np.ndarray:
        """Convert columns W (n, N, n_b) on a periodic grid into the Jacobian rows (n, N, P) of a run."""
        A = np.einsum("jsb,jbp->jsp", W, self.maps[run], optimize=True)
        joints = np.arange(len(W))
        A[joints, :, joints - len(W)] = -derivative(W @ self.smooth[run], step) / self.gains[:, None]
        return A

    def back(self, by_A: np.ndarray, run: int, step: float) -> np.ndarray:
        """Convert derivatives with respect to the rows into derivatives with respect to W."""
        by_W = np.einsum("jsp,jbp->jsb", by_A, self.maps[run], optimize=True)
        joints = np.arange(len(by_A))
        by_slope = -by_A[joints, :, joints - len(by_A)] / self.gains[:, None]
        by_W -= derivative(by_slope, step)[:, :, None] * self.smooth[run]
        return by_W


def information_of(
    model: InverseDynamics, base: BaseParameters, payloads: Sequence[Payload | None], prior: PriorModel, rate: float
) -> Information:
    """Assemble the unknowns of an experiment at prior values; ``rate`` is samples a second times the repetitions."""
    n, n_b, runs, gains = len(model.actuated), base.count, len(payloads), prior.gains
    p = n_b + EXTRA
    # identity factors reveal the matrices by which identification combines its runs
    identity = Factors(np.broadcast_to(np.eye(p), (1, n, p, p)).copy(), np.full((1, n), 1000))
    problem = plain_problem(model, base, [identity] * runs, payloads)
    names = problem.unknowns
    M = problem.blocks[:, 0, :n_b]  # (runs, n_b, parameters + 4), the same for all joints
    theta, heavy = (
        prior.values(names[names.theta], model.robot, payloads, dict(zip(base.names, chi, strict=True)))
        for chi in (prior.chi, prior.cautious)
    )
    load = modelled(M, theta)
    smooth = load * np.array([name.kind != "fs" for name in base.standard])
    maps = np.zeros((runs, n, n_b, len(names)))
    for j in range(n):
        maps[:, j, :, names.theta] = -M[..., MODEL] / gains[j]
        maps[:, j, :, names.gains.start + j] = load / gains[j]
    scale = np.concatenate([_scales(problem.parameters, theta, payloads), np.ones(n), np.full(n, 1e-2)])
    known = np.concatenate([np.diag(1 / (VAGUE * scale)), _earlier(names, prior), from_voltages(names, prior)])
    cautious = modelled(M, heavy)
    counts = rate / prior.sigma**2
    return Information(names, scale, maps, load, smooth, cautious, gains, counts, known, bool(prior.drives))


def from_voltages(names: Sequence[Parameter], prior: PriorModel) -> np.ndarray:
    """Compute a factor (m, P) of the information of voltages about log g, which commutation limits."""
    rows = np.zeros((len(prior.drives), len(names)))
    for row, (joint, drive) in zip(rows, prior.drives.items(), strict=True):
        row[names.index(Parameter("gain", joint))] = 1 / (drive.commutation or COMMUTATION)
    return rows


def _earlier(names: Sequence[Parameter], prior: PriorModel) -> np.ndarray:
    """Compute a factor (., P) of the information of an earlier result about the unknowns shared with it."""
    if prior.covariance is None:
        return np.zeros((0, len(names)))
    shared, C = prior.covariance
    kept = [name for name in shared if name in names]
    gains = dict(zip((name for name in names if name.kind == "gain"), prior.gains, strict=True))
    size = np.array([gains.get(name, 1.0) for name in kept])  # gains are relative here
    part = C[np.ix_(*[[shared.index(name) for name in kept]] * 2)] / np.outer(size, size)
    scale = np.sqrt(np.diag(part))
    values, axes = np.linalg.eigh(part / np.outer(scale, scale))
    root = np.zeros((len(kept), len(names)))
    root[:, [names.index(name) for name in kept]] = (axes / np.sqrt(np.maximum(values, 1e-12))).T / scale
    return root


Criterion = Callable[[np.ndarray], tuple[float, np.ndarray, np.ndarray]]
"""Map R, the factor of M, to the logarithm of the criterion and F (P, k), f (k,), its derivative F diag(f) F^T by M."""

NAMED = ("gains", "condition", "logdet", "trace")


def criterion(name: str, unknowns: Information) -> Criterion:
    """Look up a criterion by name.

    ``gains``: rms of the relative standard deviations of the drive gains, where voltages give them of all parameters,
    which need motions that are fast enough for a back-EMF; ``logdet`` (D-optimal): geometric mean of all
    standard deviations; ``trace`` (A-optimal): rms of all relative standard deviations; ``condition``: condition number
    of the base regressor, as in the paper; names of unknowns separated by commas (``gain_11,m_PR``): rms of their
    relative standard deviations. The reference is the prior value, or a typical value if the prior value is zero.
    Raises GtauError if a name is neither a criterion nor an unknown.
    """
    if name == "condition":
        return _condition
    if name == "logdet":
        return partial(_logdet, unknowns.known)
    names = unknowns.names
    estimated = np.array([unknown.kind != "delay" and unknown.run is None for unknown in names])
    # A gain by voltages is as exact as its commutation, whatever the motion: by it alone, a five-bar moved at 0.2 rad/s
    # rms, where its gains were known to 4 %. For all parameters it moves at 0.7 rad/s.
    if name == "trace" or (name == "gains" and unknowns.voltages):
        chosen = estimated
    elif name == "gains":
        chosen = np.array([unknown.kind == "gain" for unknown in names])
    else:
        wanted = [word.strip() for word in name.split(",")]
        if (unknown := next((word for word in wanted if word not in names), None)) is not None:
            choices = [*NAMED, *np.array(names)[estimated].tolist()]
            examples = f"names of gains and base parameters such as {choices[-1]} or {choices[len(NAMED)]}"
            advice = meant(unknown, choices, f"choose {', '.join(NAMED)}, or {examples}.")
            raise GtauError(f"there is no criterion or parameter '{unknown}'; {advice}")
        chosen = np.isin(names, wanted)
    return partial(_weighted_trace, unknowns.known, chosen / unknowns.scale**2 / chosen.sum())


def root_covariance(R: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Compute H (P, P), where H H^T is the covariance, from factors of the information and the prior information."""
    stacked = np.concatenate([R, known])
    size = np.linalg.norm(stacked, axis=0)
    return np.asarray(np.linalg.inv(triangle(stacked / size)) / size[:, None])


def _weighted_trace(known: np.ndarray, weight: np.ndarray, R: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Evaluate ``log sqrt(sum(weight * diag(C)))`` for the covariance C."""
    H = root_covariance(R, known)
    chosen = np.flatnonzero(weight)
    mean = float(weight @ np.sum(H**2, axis=1))
    return np.log(mean) / 2, H @ H[chosen].T, -weight[chosen] / (2 * mean)


def _logdet(known: np.ndarray, R: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Evaluate ``log det(C)^(1 / 2P)`` for the covariance C."""
    H = root_covariance(R, known)
    P = known.shape[1]
    return float(np.linalg.slogdet(H)[1] / P), H, np.full(P, -1 / (2 * P))


def _condition(R: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Evaluate the logarithm of the condition number of R."""
    _, s, Vt = np.linalg.svd(R)
    s = np.maximum(s, 1e-300)
    ends = [0, len(s) - 1]
    return float(np.log(s[0] / s[-1])), Vt[ends].T, np.array([0.5, -0.5]) / s[ends] ** 2
