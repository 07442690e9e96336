"""What an effect is, the windows of a fit along which it acts, and the levels that its columns are scaled by."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.assembly import is_transmitted
from gtau.estimation.regression.factors import channel_rows
from gtau.estimation.regression.rows import Rows, configurations, instants, stream_rows
from gtau.findings import Finding
from gtau.model.inverse_dynamics import InverseDynamics, Regressor
from gtau.model.loops import Motion
from gtau.robots.parameter import BY_LOAD
from gtau.signals.preparation.filters import Decimator
from gtau.signals.preparation.prepared_run import SampleWindow

RELATIVE = "relative"  # unit of a size that is a share of what it changes
STEP = 0.1  # of the unit of a position: the torques' change is linear over this
LEAST_FRICTION = 0.02  # of the rms torque: less is no level to scale columns by

Words = tuple[str, str]
"""The cause in words, and what to do about it."""
Torques = Callable[[Rows], np.ndarray]
"""Gives torques (n, K, m), or (c, K, m) of all channels, in N m or N at each block of a window's rows, in order."""


def window_motion(model: InverseDynamics, window: SampleWindow) -> Motion:
    """Compute the motion along a window; raises GtauError at a singularity."""
    samples = window.samples()
    c, qd, qdd = map(np.ascontiguousarray, (configurations(model, window), samples.qd.T, samples.qdd.T))
    return model.rates(c, qd, qdd, instants(window.run.name, samples.time))


@dataclass(frozen=True, eq=False)
class FitWindow:
    """A ``window`` of a ``run`` (its number), along which effects add what the model of a ``fit`` lacks.

    The effects that act have ``columns``, by the effect's name.
    """

    fit: Fit
    run: int
    window: SampleWindow
    columns: Mapping[str, Sequence[EffectColumn]] = field(default_factory=dict)

    @cached_property
    def motion(self) -> Motion:
        """The motion along the window; raises GtauError at a singularity."""
        return window_motion(self.fit.dataset.model, self.window)

    @cached_property
    def values(self) -> np.ndarray:
        """Values of the base columns in the run, (n_b,)."""
        return self.fit.system.motion(self.run, self.fit.solution.theta)

    @property
    def transmitted(self) -> np.ndarray:
        """Values of the base columns whose torque the gears transmit: 0 of friction and of rotors, (n_b,).

        Base parameters regroup rotors with links, so that a column of an effect takes the rest of each rotor out.
        """
        names = self.fit.dataset.base.names
        return self.values * is_transmitted(names) * [name.kind != "ia" for name in names]

    @property
    def smooth(self) -> np.ndarray:
        """Values of the base columns whose torques vary smoothly with positions, all but dry friction, (n_b,).

        Other positions reverse passive joints at other instants, which no slope describes.
        """
        return self.values * [name.kind != "fs" for name in self.fit.dataset.base.names]

    @property
    def regressor(self) -> Regressor:
        """Regressor of the base columns."""
        return self.fit.dataset.model.columns(self.fit.dataset.base.standard)

    @property
    def decimator(self) -> Decimator:
        """Decimator of the run."""
        return self.fit.dataset.preparation.at(self.window.run.rate).decimator

    @cached_property
    def unmoved(self) -> np.ndarray:
        """Torques (n, N) of the base columns at every sample of the window."""
        return self.torques_along(self.motion, self.values)

    def torques_along(self, motion: Motion, values: np.ndarray) -> np.ndarray:
        """Compute the torques (n, N) of the base columns with some values along a motion."""
        return self.regressor.torques_along(self.fit.dataset.model.layout, motion, values)

    def torques(self, rows: Rows) -> np.ndarray:
        """Compute the model's torques (n, K) at rows of the window."""
        return self.regressor.torques(rows.entries, self.values, len(self.fit.gains))

    def along_run(self, time: np.ndarray) -> np.ndarray:
        """Map instants in the window's run to -0.5 at its beginning, 0.5 at its end."""
        begin, *_, end = self.fit.dataset.prepared[self.run].time[[0, -1]]
        return np.asarray((time - begin) / max(end - begin, 1e-12) - 0.5)

    def decimated(self, torques: np.ndarray) -> Torques:
        """Decimate torques (m, n, N), made at every sample of the window, into columns."""
        decimated = self.decimator.apply(torques)  # (m, n, outputs)
        return lambda rows: decimated[:, :, rows.outputs].transpose(1, 2, 0)

    def with_positions(self, moved: Iterable[Sequence[np.ndarray]], values: np.ndarray) -> Torques:
        """Compute how torques change along other motions (N, n), each moved by a ``STEP`` of its unit, a column each.

        The torques are of the base columns with some ``values``.

        Wrong zeros and scales of positions, and elastic joints, add such torques.
        """
        before = self.torques_along(self.motion, values)
        return self.decimated((self._moved(list(moved), values, before) - before) / STEP)

    def _moved(self, motions: Sequence[Sequence[np.ndarray]], values: np.ndarray, before: np.ndarray) -> np.ndarray:
        """Compute the torques (m, n, N) along m other motions in one call, ``before`` where loops do not close."""
        model, labels = self.fit.dataset.model, instants(self.window.run.name, np.tile(self.window.time, len(motions)))
        q, qd, qdd = (np.concatenate(parts).T.copy() for parts in zip(*motions, strict=True))
        try:  # from each configuration, so that loops are closed as before
            path = model.near(np.tile(self.motion.c, len(motions)), q, labels)
            along = self.torques_along(model.rates(path, qd, qdd, labels), values)
        except GtauError:
            if len(motions) == 1:
                return before[None]  # nothing is said of this joint
            return np.concatenate([self._moved([motion], values, before) for motion in motions])
        return along.reshape(len(along), len(motions), -1).swapaxes(0, 1)

    def rows(self, torques: WindowTorques | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Compute the decimated rows of the window (c, K, columns + m), and which of them are kept (c, K).

        They have the columns of :class:`gtau.estimation.regression.factors.Factors`, and m of the ``torques``.
        """
        system, added = self.fit.system, torques and torques(self)
        loaded = any(term.kind in BY_LOAD for term in system.terms)
        load = system.load(self.run, self.fit.solution.theta) if loaded else None
        rows, keep = [], []
        for part in stream_rows(self.fit.dataset.model, self.regressor, self.window, self.decimator, load):
            A = channel_rows(self.regressor, system.problem.channels, part)
            rows.append(np.concatenate([A, added(part)], axis=-1) if added else A)
            keep.append(part.keep)
        return np.concatenate(rows, axis=1), np.concatenate(keep, axis=1)

    def equations(self, rows: np.ndarray) -> np.ndarray:
        """Map ``rows`` (c, p, .) to the columns of the fit's problem, (c, p, n_theta + 4)."""
        system, warm, time = self.fit.system, self.fit.dataset.temperatures, self.window.time
        above = None if warm is None else warm.between(self.run, time[0], time[-1])
        maps = system.map(self.run, above)[..., system.unreduced.columns_of(system.problem.parameters)]
        return np.asarray(rows[..., : maps.shape[1]] @ maps)


WindowTorques = Callable[[FitWindow], Torques]
"""Makes the columns of an effect along a window."""


def hats(x: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Evaluate hats at ``knots`` (m, n), evenly spaced, along values (N, n) of n joints: a linear spline, (m, n, N)."""
    width = np.maximum(knots[1] - knots[0], 1e-300)
    return np.maximum(0.0, 1 - np.abs(x.T[None] - knots[:, :, None]) / width[None, :, None])


@dataclass(frozen=True)
class EffectColumn:
    """One column of an effect, in the ``unit`` of its size."""

    plausible: float  # standard deviation of the sizes that experience allows
    unit: str = RELATIVE
    joint: str = ""  # empty where the column acts on each joint with a size of its own
    subject: str = ""  # a body
    about: str = ""  # what sets it apart from other columns of the effect, such as an axis or a run
    waves: tuple[float, ...] = ()  # of each joint, 1 / rad or 1 / m, where it repeats with the position
    largest: float = np.inf  # beyond it is no longer what the effect adds: torques are linear in small changes alone
    least: float = -np.inf  # below it is impossible, so that the column stands for something else


@dataclass(frozen=True)
class Effect:
    """One way in which a model, or the description of robot and logs, may differ from what was logged."""

    name: str  # in model.json, reports and messages
    torques: WindowTorques  # of the columns, of size 1 each; zero for joints that the effect does not act on
    columns: Callable[[Fit], Iterable[EffectColumn]]  # none where the effect does not apply to the robot
    say: Callable[[Fit, EffectColumn, float], Words]  # of a column with its joint, and its size
    shared: bool = False  # a column has one size for all joints, as columns of links do, and reaches torque sensors too
    description: bool = False  # it contradicts the user's description; otherwise it is physics that the model lacks
    function: bool = False  # its columns, such as knots, or a sine and a cosine, have one size: their rms torque
    in_runs: bool = False  # it has another size in each run, which drifts from run to run
    of_motion: bool = False  # it moves positions or time, so that its torques are linear in small sizes alone
    harmless: float = np.inf  # beyond this size physics does not explain it, so that it contradicts the description

    def cause(self, fit: Fit, column: EffectColumn, size: float) -> Finding:
        """Return what a column of some size is, and what to do about it, as a finding."""
        text, advice = self.say(fit, column, size)
        return Finding(self.name, (column.joint,) if column.joint else (), column.subject, text=text, advice=advice)


@dataclass(frozen=True, eq=False, repr=False)
class EstimatedEffect:
    """An effect as the data show it, beside all others."""

    effect: str  # its name
    cause: Finding  # what it is, and what to do about it
    size: float  # of its largest column; of a function, its rms torque over the rms torque of the joint
    std: float
    unit: str
    likelihood: float  # its logarithm, which the data lose without the effect, all others being found again
    share: float  # of the residual variance that it explains, at most 1
    moves: Mapping[str, float] = field(default_factory=dict)  # of each motor's gain with it, per cent of the gain
    description: bool = False  # it contradicts the description of robot and logs, as such or by its size
    beyond: bool = False  # it is so large that it does not explain what it seems to

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


# Levels of a fit's joints, (n,) each, by which the columns of effects are scaled


def encoders(fit: Fit) -> dict[str, int]:
    """List the actuated joints with encoders, all but the joints of a floating base, with their places."""
    actuated = fit.dataset.model.actuated
    return {joint: place for place, joint in enumerate(actuated) if joint not in fit.dataset.robot.base}


def geared(fit: Fit) -> dict[str, tuple[float, str]]:
    """List how far each actuated joint moves one by couplings, per rad or m, and that joint; else itself, by 1."""
    actuated, moved = fit.dataset.model.actuated, dict[str, list[tuple[float, str]]]()
    for coupling in fit.dataset.robot.couplings:
        for name, ratio in coupling.ratios:
            turned = coupling.joint in actuated  # the others make it turn
            motor, joint = (coupling.joint, name) if turned else (name, coupling.joint)
            if joint not in actuated:
                moved.setdefault(motor, []).append((1 / abs(ratio) if turned else abs(ratio), joint))
    return {joint: min(moved.get(joint, [(1.0, joint)])) for joint in actuated}


def plain_friction(fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Return viscous coefficients and Coulomb torques of the actuated joints; 0 where they are not estimated."""
    estimates = zip(fit.system.problem.parameters, fit.solution.theta, strict=True)
    values = {(name.kind, name.body): abs(value) for name, value in estimates if name.run is None}
    fv, fs = ([values.get((kind, joint), 0.0) for joint in fit.dataset.model.actuated] for kind in ("fv", "fs"))
    return np.array(fv), np.array(fs)


def rms_torques(fit: Fit) -> np.ndarray:
    """Compute rms torques, N m or N."""
    return np.asarray(np.abs(fit.gains) * fit.system.problem.balance(fit.solution.theta)[: len(fit.gains)])


def rms_speeds(fit: Fit) -> np.ndarray:
    """Return the largest rms speed in a run, rad/s or m/s; 1 of a joint that rests."""
    speeds = np.sqrt(np.max([np.diag(run.speeds) for run in fit.dataset.prepared], axis=0))
    return np.where(speeds > 0, speeds, 1.0)


def friction_torques(fit: Fit) -> np.ndarray:
    """Compute friction at the rms speed, ``LEAST_FRICTION`` of the rms torque at least, N m or N."""
    fv, fs = plain_friction(fit)
    return np.maximum(fv * rms_speeds(fit) + fs, LEAST_FRICTION * rms_torques(fit))
