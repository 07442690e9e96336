"""What an effect is, and the levels of a fit that its columns are scaled by."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from gtau.estimation.effects.linearisation import WindowTorques
from gtau.estimation.estimators.estimator import Fit
from gtau.findings import Finding

RELATIVE = "of itself"  # unit of a size that is a share of what it changes
Words = tuple[str, str]
"""The cause in words, and what to do about it."""


@dataclass(frozen=True)
class EffectColumn:
    """One column of an effect.

    Attributes
    ----------
    plausible : float
        Standard deviation of the sizes that experience allows, in its ``unit``.
    joint, subject : str
        What it is about: a joint, for columns that act on each joint with a size of its own left empty, or a body.
    about : str
        What sets it apart from the other columns of the effect, such as an axis or a run.
    largest : float
        Size beyond which the column is no longer what the effect adds, as torques are linear in small changes alone.
    """

    plausible: float
    unit: str = RELATIVE
    joint: str = ""
    subject: str = ""
    about: str = ""
    largest: float = np.inf


@dataclass(frozen=True)
class Effect:
    """One way in which a model, or the description of robot and logs, may differ from what was logged.

    Attributes
    ----------
    name : str
        In ``model.json``, reports and messages.
    torques : callable
        From a window of a fit to the torques of the columns, each of unit size.
    columns : callable
        From a fit to its columns; none where the effect does not apply to the robot.
    say : callable
        From a fit, a column with its joint, and its size to the cause in words, and what to do about it.
    shared : bool
        Whether a column acts on all joints with one size, as columns of links do, and reaches torque sensors too;
        otherwise it is of a drive, with a size for each joint.
    description : bool
        Whether it contradicts the user's description of robot and logs; otherwise it is physics that the model lacks.
    function : bool
        Whether its columns are the knots of one function, which has no size of a single column.
    in_runs : bool
        Whether it has another size in each run, which drifts from run to run.
    harmless : float
        Size beyond which physics does not explain it either, so that it contradicts the description.
    """

    name: str
    torques: WindowTorques
    columns: Callable[[Fit], Iterable[EffectColumn]]
    say: Callable[[Fit, EffectColumn, float], Words]
    shared: bool = False
    description: bool = False
    function: bool = False
    in_runs: bool = False
    harmless: float = np.inf

    def cause(self, fit: Fit, column: EffectColumn, size: float) -> Finding:
        """Return what a column of some size is, and what to do about it, as a finding."""
        text, advice = self.say(fit, column, size)
        return Finding(self.name, (column.joint,) if column.joint else (), column.subject, text=text, advice=advice)


@dataclass(frozen=True, eq=False, repr=False)
class EstimatedEffect:
    """An effect as the data show it, beside all others.

    Attributes
    ----------
    effect : str
        Its name.
    cause : Finding
        What it is, and what to do about it.
    size, std, unit : float, float, str
        Size of its largest column with the standard deviation; of a function its rms torque over the rms torque of the
        joint.
    likelihood : float
        Log-likelihood that the data lose without this effect, all others being found again.
    share : float
        Share of the residual variance that it explains, at most 1.
    moves : mapping
        By how much the gain of each motor would move without it, per cent of itself.
    description : bool
        Whether it contradicts the description of robot and logs: as such, or by its size.
    beyond : bool
        Whether it is so large that it does not explain what it seems to.
    """

    effect: str
    cause: Finding
    size: float
    std: float
    unit: str
    likelihood: float
    share: float
    moves: Mapping[str, float] = field(default_factory=dict)
    description: bool = False
    beyond: bool = False

    def __repr__(self) -> str:
        return f"EstimatedEffect({self.subject}: {self.size:.3g} +- {self.std:.2g} {self.unit})"

    @property
    def subject(self) -> str:
        """The effect in words."""
        return self.cause.what

    @property
    def largest_move(self) -> float:
        """Largest move of a gain, per cent of itself."""
        return max(map(abs, self.moves.values()), default=0.0)


@dataclass(frozen=True, eq=False)
class Levels:
    """Levels of a fit's joints, (n,) each, by which the columns of effects are scaled."""

    fit: Fit

    @cached_property
    def friction(self) -> tuple[np.ndarray, np.ndarray]:
        """Viscous coefficients and Coulomb torques of the actuated joints; 0 where they are not estimated."""
        estimates = zip(self.fit.system.problem.parameters, self.fit.solution.theta, strict=True)
        values = {(name.kind, name.body): abs(value) for name, value in estimates if name.run is None}
        joints = self.fit.dataset.model.actuated
        fv, fs = ([values.get((kind, joint), 0.0) for joint in joints] for kind in ("fv", "fs"))
        return np.array(fv), np.array(fs)

    @cached_property
    def torques(self) -> np.ndarray:
        """Rms torques, N m or N."""
        problem, gains = self.fit.system.problem, self.fit.gains
        return np.asarray(np.abs(gains) * problem.balance(self.fit.solution.theta)[: len(gains)])

    @cached_property
    def speeds(self) -> np.ndarray:
        """Largest rms speed in a run, rad/s or m/s; 1 of a joint that rests."""
        speeds = np.sqrt(np.max([np.diag(run.speeds) for run in self.fit.dataset.prepared], axis=0))
        return np.where(speeds > 0, speeds, 1.0)

    @cached_property
    def accelerations(self) -> np.ndarray:
        """Rms accelerations over all runs, rad/s2 or m/s2; 1 of a joint that rests."""
        windows = [window for _, window in self.fit.dataset.windows()]
        squares = np.sum([np.sum(window.qdd**2, axis=0) for window in windows], axis=0)
        rms = np.sqrt(squares / sum(len(window.qdd) for window in windows))
        return np.where(rms > 0, rms, 1.0)

    @cached_property
    def friction_torques(self) -> np.ndarray:
        """Friction at the rms speed, 2 % of the rms torque at least, N m or N."""
        fv, fs = self.friction
        return np.maximum(fv * self.speeds + fs, 0.02 * self.torques)
