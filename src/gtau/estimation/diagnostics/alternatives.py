"""Model uncertainty of the estimates: alternative models, weighted by the data.

Each alternative has one unknown more, of size s. The data find s and its standard deviation; experience allows sizes up
to a plausible standard deviation. The Bayes factor between the model with it and without it (s = 0) measures the
support of the data, and the posterior of s gives the shift of the estimates (Bayesian model averaging, to first order):

    E[s^2] = p (m^2 + v),    p the probability of the alternative, m and v mean and variance of s under it.

An alternative that the data refute adds nothing; where the data are uninformative, it adds its plausible size; where
they support it, its full shift counts. Alternatives that would explain the residuals of the same joint compete for p.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from gtau.estimation.diagnostics.linearisation import (
    CandidateColumns,
    Offer,
    at_full_rate,
)
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.rows import Labels, configurations
from gtau.estimation.thresholds.estimates import ALTERNATIVE_PRIOR, REFUTED_STD
from gtau.findings import Finding
from gtau.findings.words import Words
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.loops import Motion
from gtau.signals.preparation.prepared_run import InMemoryRun

CERTAIN = 1e9  # log factor that stands for certainty


@dataclass(frozen=True, eq=False)
class Alternative:
    """The model with one unknown more.

    Attributes
    ----------
    hypothesis : str
        The name of its hypothesis.
    causes : tuple of Finding
        What it is, and what else has the same effect; the first has the largest plausible effect.
    size, std, unit : float, float, str
        The unknown as the data find it; ``std`` is infinite where the other unknowns explain as much, and NaN where
        the share of the residual variance alone shows how significant it is.
    plausible : float
        Standard deviation of the sizes that experience allows.
    group : tuple of str
        Alternatives of one group compete: they would explain the same residuals.
    log_factor, second_moment : float
        See :func:`support`.
    probability : float
        That it holds, given the data; see :func:`compete`.
    share : float
        Share of the residual variance that goes with it.
    slopes : ndarray
        By how much (theta, gains, delays) move for a unit of it, (k,).
    moves : ndarray
        By what share of itself each gain moves at that size, (n,).
    description : bool
        Whether it contradicts the user's description of robot and logs.
    """

    hypothesis: str
    causes: tuple[Finding, ...]
    size: float
    std: float
    unit: str
    plausible: float
    group: tuple[str, ...]
    log_factor: float
    second_moment: float
    share: float
    slopes: np.ndarray
    moves: np.ndarray
    description: bool
    probability: float = 0.0

    @property
    def t(self) -> float:
        """Size in standard deviations."""
        return self.size / self.std if 0 < self.std < np.inf else 0.0

    @property
    def significant(self) -> bool:
        """Whether it is significant: by its size, or by the share that made it an alternative."""
        return bool(np.isnan(self.std)) or abs(self.t) > REFUTED_STD

    @property
    def mean_square(self) -> float:
        """Posterior mean square of its size, given the data."""
        return self.probability * self.second_moment


def support(size: float, std: float, plausible: float) -> tuple[float, float]:
    """Compute the log Bayes factor of an alternative over none, and the second moment of its size under it.

    Parameters
    ----------
    size, std : float
        The size as the data find it; ``std`` is infinite where they say nothing of it.
    plausible : float
        Standard deviation of the sizes that experience allows.
    """
    if not np.isfinite(std):
        return 0.0, plausible**2
    ratio = plausible**2 / (plausible**2 + std**2)
    factor = 0.5 * np.log1p(-min(ratio, 1 - 1e-16)) + 0.5 * ratio * (size / std) ** 2
    return float(factor), float((ratio * size) ** 2 + ratio * std**2)


def compete(alternatives: Sequence[Alternative]) -> tuple[Alternative, ...]:
    """Assign probabilities to the alternatives of each group: one of them holds, or none."""
    groups: dict[tuple[str, ...], list[Alternative]] = {}
    for each in alternatives:
        groups.setdefault(each.group, []).append(each)
    found: list[Alternative] = []
    for members in groups.values():
        prior = np.log(ALTERNATIVE_PRIOR / len(members) / (1 - ALTERNATIVE_PRIOR))
        # log odds over none, of which certain ones are beyond all others; the largest is taken off against overflow
        odds = np.append(prior + np.minimum([each.log_factor for each in members], CERTAIN), 0.0)
        odds = np.exp(odds - odds.max())
        found += [replace(each, probability=float(p)) for each, p in zip(members, odds[:-1] / odds.sum(), strict=True)]
    return tuple(found)


def established(
    fit: Fit,
    hypothesis: str,
    cause: Finding,
    moves: np.ndarray,
    share: float,
    size: float = 1.0,
    std: float = np.nan,
    unit: str = "",
) -> Alternative:
    """Make an alternative of what a separate test found to be significant; ``moves`` (n,) are those of the gains."""
    slopes = np.zeros(len(fit.solution.values))
    slopes[fit.system.problem.gain_rows] = moves * fit.gains / size
    group = (cause.kind, *cause.joints)
    return Alternative(
        hypothesis, (cause,), size, std, unit, abs(size), group, np.inf, size**2, share, slopes, moves, description=True
    )


def model_covariance(alternatives: Sequence[Alternative], size: int) -> np.ndarray:
    """Compute the covariance of (theta, gains, delays) that all alternatives together add, (k, k)."""
    total = np.zeros((size, size))
    for each in alternatives:
        total += each.mean_square * np.outer(each.slopes, each.slopes)
    return total


@dataclass(frozen=True)
class Candidate:
    """A column of candidate torques.

    Attributes
    ----------
    finding : Finding
        What it is; one that is tried joint by joint is given its joint later.
    unit : str
        Of its size.
    plausible : float
        Standard deviation of the size that experience allows before the data.
    """

    finding: Finding
    unit: str
    plausible: float


@dataclass(frozen=True, eq=False)
class Candidates:
    """Candidate torques of a hypothesis.

    Attributes
    ----------
    columns : sequence of Candidate
        What each of the m columns is.
    offer : callable
        Makes them, in this order.
    describe : callable, optional
        Finds what sizes (m,) of all columns together mean, where they are to be tried together too; its second argument
        are the shares (m,) of what they explain together that each column explains alone.
    """

    columns: Sequence[Candidate]
    offer: Offer
    describe: Callable[[np.ndarray, np.ndarray], Finding] | None = None


@dataclass(frozen=True)
class Cause:
    """An effect that a hypothesis names as the cause of a finding.

    Attributes
    ----------
    kind : str
        Of the findings on it.
    words : tuple of str or callable
        Its name and advice.
    plausible : Threshold or float
        Standard deviation of the sizes that experience allows before the data; 0 where it is named, not tried.
    unit : str
        Of its size, where all its columns have the same.
    """

    kind: str
    words: Words
    plausible: float = 0.0
    unit: str = ""

    @property
    def candidate(self) -> Candidate:
        """Its column, tried joint by joint."""
        return Candidate(Finding(self.kind), self.unit, self.plausible)


@dataclass(frozen=True)
class Hypothesis:
    """One way in which the model may be wrong.

    Attributes
    ----------
    name : str
        In ``model.json``.
    shared : bool
        Whether a candidate acts on all joints with one size, or on each joint with a size of its own. Common effects
        are of the links, and reach torque sensors too; those of a single joint are of its drive.
    candidates : callable
        From a fit to its candidates; None where the hypothesis does not apply to this robot. What it adds is its
        docstring.
    causes : tuple of Cause
        What its candidates are, and what they may mean together.
    description : bool
        Whether it contradicts the user's description of robot and logs; otherwise it is physics that the model lacks,
        which widens the intervals.
    """

    name: str
    shared: bool
    candidates: Callable[[Fit], Candidates | None]
    causes: tuple[Cause, ...]
    description: bool = False


def joint_by_joint(
    fit: Fit, causes: Sequence[Cause], torques: Callable[[InMemoryRun, np.ndarray], Mapping[Cause, np.ndarray]]
) -> Candidates:
    """Make candidates that are tried joint by joint, from the ``torques`` (n, M) of each cause along a window."""

    def offer(window: InMemoryRun, values: np.ndarray) -> CandidateColumns:
        of = torques(window, values)
        return at_full_rate(window, fit.dataset, np.stack([of[each] for each in causes]))

    return Candidates([each.candidate for each in causes], offer)


def friction_levels(fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Return viscous coefficients and Coulomb torques of the actuated joints, (n,) each; 0 where not estimated."""
    estimates = zip(fit.system.problem.parameters, fit.solution.theta, strict=True)
    values = {(name.kind, name.body): abs(value) for name, value in estimates if name.run is None}

    def of(kind: str) -> np.ndarray:
        joints = fit.dataset.model.actuated
        return np.array([values.get((kind, joint), 0.0) for joint in joints])

    return of("fv"), of("fs")


def rms_torques(fit: Fit) -> np.ndarray:
    """Compute rms torques of the joints, (n,), N m or N."""
    return np.asarray(np.abs(fit.gains) * fit.system.problem.balance(fit.solution.theta)[: len(fit.gains)])


def rms_speeds(fit: Fit) -> np.ndarray:
    """Find the largest rms speed of each joint in a run, (n,), rad/s or m/s."""
    return np.sqrt(np.max([np.diag(run.speeds) for run in fit.dataset.prepared], axis=0))


@lru_cache(maxsize=2)  # hypotheses are tried window by window
def window_motion(model: InverseDynamics, window: InMemoryRun) -> Motion:
    """Compute configurations, velocities and accelerations of a ``model`` along a window.

    Raises
    ------
    GtauError
        Where the loops cannot be closed at a sample, or a pose is too close to a singularity.
    """
    return _motion(model, window, configurations(model, window))


def moved(window: InMemoryRun, factor: np.ndarray, shift: np.ndarray) -> InMemoryRun:
    """Scale the positions of a window by a ``factor`` (n,), and shift them by ``shift`` (n,)."""
    of = window.samples()
    return InMemoryRun(window.run, replace(of, q=of.q * factor + shift, qd=of.qd * factor, qdd=of.qdd * factor))


def moved_motion(model: InverseDynamics, window: InMemoryRun, start: np.ndarray) -> Motion:
    """Compute the motion along a window whose positions were :func:`moved`, from a configuration ``start`` (n_c,).

    That is near the first one, so that loops are closed as before.
    """
    of = window.samples()
    return _motion(model, window, model.path(np.ascontiguousarray(of.q.T), Labels(window.run.name, of.time), start))


def _motion(model: InverseDynamics, window: InMemoryRun, c: np.ndarray) -> Motion:
    of = window.samples()
    qd, qdd = (np.ascontiguousarray(each.T) for each in (of.qd, of.qdd))
    return model.rates(np.ascontiguousarray(c), qd, qdd, Labels(window.run.name, of.time))
