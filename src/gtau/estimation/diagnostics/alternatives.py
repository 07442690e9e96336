"""Model uncertainty of the estimates: alternative models, weighted by the data, and the hypotheses that make them.

Each alternative has one unknown more, of size s. The data find s and its standard deviation; experience allows sizes up
to a plausible standard deviation. The Bayes factor between the model with it and without it (s = 0) measures the
support of the data, and the posterior of s gives the shift of the estimates (Bayesian model averaging, to first order):

    E[s^2] = p (m^2 + v),    p the probability of the alternative, m and v mean and variance of s under it.

An alternative that the data refute adds nothing; where the data are uninformative, it adds its plausible size; where
they support it, its full shift counts. Alternatives that would explain the residuals of the same joint compete for p.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.linearisation import Offer
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.scale_source import require_scale
from gtau.estimation.thresholds.estimates import ALTERNATIVE_PRIOR
from gtau.estimation.thresholds.refutation import REFUTED_STD
from gtau.findings import Finding
from gtau.findings.finding import named_causes
from gtau.signals.reading.statements import Payload

CERTAIN = 1e9  # log factor that stands for certainty
SHOWN = float("inf")
"""Plausible size of what a test of its own shows to be significant."""
GAIN_CHANGE, LENGTHS, TOOL_BODIES, RIPPLE = "gain change", "lengths", "tool bodies", "position ripple"
TORQUE_SCALE = "torque scale"
"""Names of hypotheses that others ask for."""


@dataclass(frozen=True, eq=False, repr=False)
class Alternative:
    """The model with one unknown more.

    Attributes
    ----------
    hypothesis : str
        The name of its hypothesis.
    causes : tuple of Finding
        What it is, and what else has the same effect; the first has the largest plausible effect.
    size, std, unit : float, float or None, str
        The unknown as the data find it. Without ``std`` the other unknowns explain as much, or the share of the
        residual variance alone shows how significant it is.
    probability : float
        That it holds: before the data, and by :func:`compete` given them.
    share : float
        Share of the residual variance that goes with it.
    moves : mapping
        By how much the gain of each motor moves at that size, per cent of itself.
    shifts : ndarray
        By how much (theta, gains, delays) move if it holds, rms, (k,); ``model.json`` does not hold them.
    plausible : float
        Standard deviation of the sizes that experience allows, a ``Threshold`` before the data, or ``SHOWN``; 0 where
        it is named, not tried. Not in ``model.json``.
    """

    hypothesis: str
    causes: tuple[Finding, ...]
    size: float
    std: float | None
    unit: str
    probability: float = float(ALTERNATIVE_PRIOR)
    share: float = 0.0
    moves: Mapping[str, float] = field(default_factory=dict)
    shifts: np.ndarray = field(default_factory=lambda: np.zeros(0))
    plausible: float = SHOWN

    def __post_init__(self) -> None:
        # to first order it may be more than all
        object.__setattr__(self, "share", min(self.share, 1.0))

    def __repr__(self) -> str:
        return f"Alternative({self.subject}: probability {self.probability:.2g})"

    @property
    def kind(self) -> str:
        """Kind of its first cause, which ``words.yaml`` puts into words."""
        return self.causes[0].kind

    @property
    def subject(self) -> str:
        """The causes by name."""
        return named_causes(self.causes)

    @property
    def t(self) -> float:
        """Size in standard deviations."""
        return self.size / self.std if self.std else 0.0

    @property
    def significant(self) -> bool:
        """Whether it is significant: by its size, or by the test that showed it."""
        return (self.std is None and self.plausible == SHOWN) or abs(self.t) > REFUTED_STD

    @property
    def largest_move(self) -> float:
        """Largest move of a gain, per cent of itself."""
        return max(map(abs, self.moves.values()), default=0.0)

    def on(self, joint: str = "", subject: str = "", **values: object) -> Alternative:
        """Make it that of a joint, or of a subject, with the values of its words."""
        return replace(self, causes=(Finding(self.kind, (joint,) if joint else (), subject, values),))

    def by_noise(self) -> Alternative:
        """Return it at the size that noise alone would give it (rms), and as probable as before the data."""
        before = replace(self, probability=float(ALTERNATIVE_PRIOR))
        if not self.std:
            return before
        as_found, usual = (support(size, self.std, self.plausible)[1] for size in (self.size, self.std))
        return replace(before, size=self.std, shifts=np.sqrt(usual / as_found) * self.shifts)

    def moving(self, fit: Fit, slopes: np.ndarray) -> Alternative:
        """Add what it does to the estimates: they move by ``slopes`` (k,) for a unit of it."""
        gains, moment = slopes[fit.system.problem.gain_rows], support(self.size, self.std, self.plausible)[1]
        moves = {
            joint: 100 * float(slope * self.size / gain)
            for joint, slope, gain in zip(fit.dataset.model.actuated, gains, fit.gains, strict=True)
            if joint in fit.dataset.robot.motors
        }
        return replace(self, moves=moves, shifts=np.sqrt(moment) * slopes)


def candidate(kind: str, plausible: float = 0.0, unit: str = "") -> Alternative:
    """Make an alternative before its size is known; experience allows ``plausible`` sizes, in its ``unit``."""
    return Alternative("", (Finding(kind),), 0.0, None, unit, plausible=plausible)


def support(size: float, std: float | None, plausible: float) -> tuple[float, float]:
    """Compute the log Bayes factor of an alternative over none, and the second moment of its size under it."""
    if std is None:
        return (np.inf, size**2) if plausible == SHOWN else (0.0, plausible**2)
    ratio = plausible**2 / (plausible**2 + std**2)
    factor = 0.5 * np.log1p(-min(ratio, 1 - 1e-16)) + 0.5 * ratio * (size / std) ** 2
    return float(factor), float((ratio * size) ** 2 + ratio * std**2)


def compete(
    alternatives: Sequence[Alternative], group_of: Callable[[Alternative], Hashable]
) -> tuple[Alternative, ...]:
    """Assign probabilities to the alternatives of each group: one of them holds, or none; without one (None) alone."""
    groups: dict[Hashable, list[Alternative]] = {}
    for k, effect in enumerate(alternatives):
        group = group_of(effect)
        groups.setdefault(k if group is None else group, []).append(effect)
    weighed: list[Alternative] = []
    for members in groups.values():
        prior = [np.log(effect.probability / len(members) / (1 - ALTERNATIVE_PRIOR)) for effect in members]
        # log odds over none, of which certain ones are beyond all others; the largest is taken off against overflow
        factors = [min(support(effect.size, effect.std, effect.plausible)[0], CERTAIN) for effect in members]
        odds = np.append(np.add(prior, factors), 0.0)
        odds = np.exp(odds - odds.max())
        weighed += [
            replace(effect, probability=float(p)) for effect, p in zip(members, odds / odds.sum(), strict=False)
        ]
    return tuple(weighed)


def established(
    fit: Fit, hypothesis: str, cause: Finding, moves: np.ndarray, share: float, size: float = 1.0, unit: str = ""
) -> Alternative:
    """Make an alternative of what a test of its own showed to be significant; ``moves`` (n,) are the gains'."""
    slopes = np.zeros(len(fit.solution.values))
    slopes[fit.system.problem.gain_rows] = moves * fit.gains / size
    return Alternative(hypothesis, (cause,), size, None, unit, share=share).moving(fit, slopes)


def refitted(
    fit: Fit, payloads: Sequence[Payload | None] | None = None, dataset: Dataset | None = None, method: str = "ml"
) -> Fit | None:
    """Fit the same equations with other loads, or another dataset's priors; None where then nothing gives the scale."""
    system = fit.system.again(dataset, payloads=payloads)
    payloads = [run.payload for run in fit.dataset.runs] if payloads is None else payloads
    try:
        if fit.free_gains:
            require_scale(fit.dataset.robot, system, payloads, method)
        solution = fit.solve(system.problem)
    except GtauError:
        return None
    return replace(fit, system=system, solution=solution)


def residual_ratio(other: Fit, own: Fit) -> float:
    """Compute the residual variance relative to ``own``, the geometric mean over all channels (the likelihood's).

    So a single joint that feels gravity, say, counts among many that do not.
    """
    rows = own.system.problem.total_rows
    return float(np.exp(2 * rows @ np.log(other.solution.sigma / own.solution.sigma) / rows.sum()))


def of_refit(fit: Fit, hypothesis: str, cause: Finding, other: Fit, own: Fit) -> Alternative:
    """Make an alternative of a fit with another description beside ``own``, with that of the user."""
    rows, ratio = own.system.problem.total_rows, other.solution.sigma / own.solution.sigma
    moves = other.gains / own.gains - 1 if fit.free_gains else np.zeros(len(fit.gains))
    return established(fit, hypothesis, cause, moves, 1 - float(rows @ ratio**2 / rows.sum()))


def model_covariance(alternatives: Sequence[Alternative], size: int) -> np.ndarray:
    """Compute the covariance of (theta, gains, delays) that all alternatives together add, (k, k)."""
    shifts = np.reshape([np.sqrt(effect.probability) * effect.shifts for effect in alternatives], (-1, size))
    return shifts.T @ shifts


@dataclass(frozen=True)
class Hypothesis:
    """One way in which the model may be wrong.

    Attributes
    ----------
    name : str
        In ``model.json``.
    shared : bool
        Whether a column acts on all joints with one size, or on each joint with a size of its own. Common effects
        are of the links, and reach torque sensors too; those of a single joint are of its drive.
    torques : callable
        From a window of a fit to the candidate torques, a column for each alternative. What they add is its docstring.
    columns : tuple of Alternative, or callable
        What the columns are, before their sizes are known; of a fit where that depends on the robot, none where the
        hypothesis does not apply to it.
    describe : callable, optional
        Finds what sizes (m,) of all columns together mean, where they are to be tried together too; its last argument
        are the shares (m,) of what they explain together that each column explains alone.
    description : bool
        Whether it contradicts the user's description of robot and logs; otherwise it is physics that the model lacks,
        which widens the intervals.
    """

    name: str
    shared: bool
    torques: Offer
    columns: tuple[Alternative, ...] | Callable[[Fit], Iterable[Alternative]]
    describe: Callable[[Fit, np.ndarray, np.ndarray], Finding] | None = None
    description: bool = False

    def offered(self, fit: Fit) -> list[Alternative]:
        """List what its columns are, none where it does not apply to the robot."""
        columns = self.columns(fit) if callable(self.columns) else self.columns
        return [replace(column, hypothesis=self.name) for column in columns]


def friction_levels(fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Return viscous coefficients and Coulomb torques of the actuated joints, (n,) each; 0 where not estimated."""
    estimates = zip(fit.system.problem.parameters, fit.solution.theta, strict=True)
    values = {(name.kind, name.body): abs(value) for name, value in estimates if name.run is None}
    joints = fit.dataset.model.actuated
    fv, fs = ([values.get((kind, joint), 0.0) for joint in joints] for kind in ("fv", "fs"))
    return np.array(fv), np.array(fs)


def rms_torques(fit: Fit) -> np.ndarray:
    """Compute rms torques of the joints, (n,), N m or N."""
    return np.asarray(np.abs(fit.gains) * fit.system.problem.balance(fit.solution.theta)[: len(fit.gains)])


def rms_speeds(fit: Fit) -> np.ndarray:
    """Find the largest rms speed of each joint in a run, (n,), rad/s or m/s."""
    return np.sqrt(np.max([np.diag(run.speeds) for run in fit.dataset.prepared], axis=0))
