"""The design problem (robot, motion, payloads, limits and prior knowledge), and its motions on a grid of instants."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import casadi as ca
import numpy as np

from gtau.errors import GtauError
from gtau.excitation.clearance import Clearance
from gtau.excitation.information import Information, Window, information_of
from gtau.excitation.prior import PriorModel
from gtau.excitation.trajectory import FourierSeries, Pullback, SmoothRegressor, approach_duration, smooth_regressor
from gtau.model.base_parameters import BaseParameters
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.kinematics import configuration_rates, frames
from gtau.model.loops import Motion, advance, differentiate
from gtau.model.program import Program, compile_program
from gtau.signals.preparation.filters import Decimator, Preparation, decimation_factor
from gtau.signals.reading.statements import Payload

SPEED_FRACTION = Preparation.speed_fraction
STILL = 1e-6  # m/s, smoothing of the tool's speed at rest
SMOOTH = 0.02  # speed range of Coulomb friction's change of sign, as a share of the joint's speed
PER_HARMONIC = 12  # instants of the design grid per period of the highest harmonic


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Limits of the actuated joints and of the whole motion, inf where there is none.

    A joint has a limit of ``current``, A, or of ``torque``, N m or N. ``guards`` are sentences on what protects the
    robot, what was guessed, and what is not checked.
    """

    position: np.ndarray  # (n, 2) intervals, rad or m
    rates: np.ndarray  # (3, n) velocity, acceleration and jerk
    current: np.ndarray  # (n,)
    workspace: Mapping[str, tuple[float, float]]  # of the tool frame's x, y and z, m
    condition: float  # largest condition number of the closures
    away: float  # smallest share of a joint's samples away from its reversals
    torque: np.ndarray = field(default_factory=lambda: np.full(1, np.inf))  # (n,)
    tool_speed: float = np.inf  # m/s
    clearance: Clearance | None = None
    guards: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class DesignProblem:
    """The data of an excitation design.

    A run has ``repetitions`` periods of the ``series`` at the controller's ``rate``, Hz. It begins and ends in the pose
    ``rest`` (n,); if ``rest`` is None, it has no approach and return. There is one run per payload, all of one motion.
    The gains of the ``prior``, with their intervals, convert torques to currents.
    """

    model: InverseDynamics
    base: BaseParameters
    series: FourierSeries
    rate: float
    repetitions: int
    rest: np.ndarray | None
    payloads: tuple[Payload | None, ...]
    limits: MotionLimits
    prior: PriorModel

    def __repr__(self) -> str:
        return f"DesignProblem({self.model.robot.name!r}, runs: {len(self.payloads)}, rate: {self.rate:g} Hz)"

    def __post_init__(self) -> None:
        if self.bandwidth > 0.1 * self.rate:
            raise GtauError(
                f"the highest harmonic is {self.bandwidth:g} Hz, too fast for a log of {self.rate:g} Hz; take at most "
                "a tenth of the rate."
            )

    @property
    def bandwidth(self) -> float:
        """Frequency of the highest harmonic, Hz."""
        return self.series.harmonics * self.series.base_frequency

    @property
    def guards(self) -> tuple[str, ...]:
        """Sentences on what protects the robot, what was guessed, and what is not checked."""
        return self.limits.guards

    @cached_property
    def information(self) -> Information:
        """Unknowns of all runs, and the information of rows about them."""
        return information_of(self.model, self.base, self.payloads, self.prior, self.rate * self.repetitions)

    @cached_property
    def decimator(self) -> Decimator:
        """Decimation filter that identification chooses for this bandwidth."""
        return Decimator(decimation_factor(self.rate, self.bandwidth))

    def window(self, step: float) -> Window:
        """Return the weights of rows near reversals on a grid of instants ``step`` s apart."""
        return Window(step, self.decimator.guard / self.rate, SPEED_FRACTION, self.approach_speed)

    @cached_property
    def approach_speed(self) -> np.ndarray:
        """Upper bound (n,) on the rms speed that approach and return add to a run, rad/s or m/s."""
        if self.rest is None:
            return np.zeros(len(self.prior.sigma))
        way = np.abs(self.limits.position - self.rest[:, None]).max(axis=1)
        way = np.where(np.isfinite(way), way, 0.0)
        span = approach_duration(way, self.limits.rates)
        duration = self.series.period * self.repetitions + 2 * span
        # the mean square speed of a quintic move by 1 in 1 s is 10 / 7
        return np.asarray(way * np.sqrt(2 * 10 / 7 / span / duration))

    @cached_property
    def regressor(self) -> SmoothRegressor:
        """Base columns with smooth Coulomb friction."""
        robot, actuated = self.model.robot, self.model.layout.actuated
        length = self.model.layout.length if self.model.loops else 1.0
        units = np.array([1.0 if joint.turns else length for joint in robot.joints])
        speed = np.where(np.isfinite(self.limits.rates[0]), self.limits.rates[0], 1.0)
        width = SMOOTH * float(np.median(speed)) / units[actuated[0]] * units
        width[actuated] = SPEED_FRACTION * SMOOTH * speed  # slower rows are dropped
        return smooth_regressor(self.model, self.base.standard, width)

    @cached_property
    def pullback(self) -> Pullback:
        """Conversion of derivatives from the whole robot to its actuated joints."""
        return Pullback(self.model)

    @cached_property
    def tool(self) -> tuple[Program, Program]:
        """Position of the tool's frame in the base, and the gradient by c of its weighted coordinates."""
        c, weights = ca.SX.sym("c", self.model.layout.n_c), ca.SX.sym("weights", 3)
        position = frames(self.model.layout, c)[self.model.robot.tool].p_0
        back = ca.gradient(ca.dot(weights, position), c)
        return compile_program([c], [position]), compile_program([c, weights], [back])

    @cached_property
    def tool_speed(self) -> tuple[Program, Program]:
        """Speed of the tool's frame in the base, and its gradient by c and yd, stacked."""
        layout = self.model.layout
        c, yd = ca.SX.sym("c", layout.n_c), ca.SX.sym("yd", layout.n_y)
        position = frames(layout, c)[self.model.robot.tool].p_0
        speed = ca.sqrt(ca.sumsqr(ca.jtimes(position, c, configuration_rates(layout, c, yd))) + STILL**2)
        slopes = ca.densify(ca.gradient(speed, ca.vertcat(c, yd)))
        return compile_program([c, yd], [ca.densify(speed)]), compile_program([c, yd], [slopes])

    def with_payload_mass(self, mass: float) -> DesignProblem:
        """Return the same problem with the ``mass``, kg, for all payloads of known mass."""
        payloads = tuple(
            payload.model_copy(update={"mass": mass}) if payload is not None and payload.mass is not None else payload
            for payload in self.payloads
        )
        return replace(self, payloads=payloads)


def close(model: InverseDynamics, joints: np.ndarray, near: np.ndarray | None = None) -> Motion:
    """Close the loops for q, qd and qdd, (3 or more, n, N), starting from configurations ``near`` (n_c, N) if given."""
    q, qd, qdd = joints[:3]
    if model.loops is None or near is None or near.shape[1] != q.shape[1]:
        return model.motion(q, qd, qdd)
    c, reached = advance(model.loops, near, q)
    if not reached.all():
        return model.motion(q, qd, qdd)  # its error names the place
    return differentiate(model.loops, c, qd, qdd)


@dataclass(frozen=True, eq=False)
class Grid:
    """Instants ``step`` s apart, of one period or a whole run, with the series' basis (4, N, free) for a period."""

    step: float
    basis: np.ndarray = field(default_factory=lambda: np.empty((4, 0, 0)))


def design_grid(task: DesignProblem, finer: int = 1) -> Grid:
    """Make the grid of a period on which motions are designed, or a grid ``finer`` times finer."""
    samples = PER_HARMONIC * task.series.harmonics * finer
    step = task.series.period / samples
    return Grid(step, task.series.basis(step * np.arange(samples)))


@dataclass(frozen=True, eq=False)
class Point:
    """A motion: joints (4, n, N), the whole robot, and the base regressor W (n, N, n_b)."""

    task: DesignProblem
    grid: Grid
    joints: np.ndarray
    motion: Motion
    W: np.ndarray

    @cached_property
    def jacobians(self) -> list[np.ndarray]:
        """Jacobian rows (n, N, P) of the currents in every run."""
        information = self.task.information
        return [information.jacobians(self.W, run, self.grid.step) for run in range(len(self.task.payloads))]

    def by_joints(self, by_W: np.ndarray) -> np.ndarray:
        """Convert derivatives by W into derivatives by q, qd, qdd (3, n, N)."""
        return self.task.pullback(self.motion, self.task.regressor.slopes(self.motion, by_W))

    def rows(self, slopes: np.ndarray, by_condition: float = 0.0) -> np.ndarray:
        """Convert derivatives by the whole robot's motion, see :class:`Pullback`, into gradients (N, series.size)."""
        return self.to_rows(self.task.pullback(self.motion, slopes, by_condition))

    def to_rows(self, by: np.ndarray) -> np.ndarray:
        """Convert derivatives by q, qd, qdd (3, n, N) into the gradient of every sample by x, (N, series.size)."""
        series = self.task.series
        rows = by.transpose(2, 1, 0) @ self.grid.basis[:3].transpose(1, 0, 2) * series.half[:, None]
        return np.asarray(rows.reshape(len(rows), series.size))

    def rows_of(self, order: int, joint: int, scale: float) -> np.ndarray:
        """Compute the gradients (N, series.size) of a joint's position, velocity, acceleration or jerk over a scale."""
        series, samples = self.task.series, self.joints.shape[2]
        rows = np.zeros((samples, len(series.center), series.free))
        rows[:, joint] = self.grid.basis[order] * series.half[joint] / scale
        return rows.reshape(samples, series.size)


def evaluate(task: DesignProblem, x: np.ndarray, grid: Grid, near: Point | None = None) -> Point:
    """Evaluate the motion for x (series.size,), closing loops from the configurations of ``near`` if given."""
    joints = task.series.along(x, grid.basis)
    motion = close(task.model, joints, None if near is None else near.motion.c)
    return Point(task, grid, joints, motion, task.regressor(motion))


def along(task: DesignProblem, joints: np.ndarray, step: float) -> Point:
    """Evaluate any motion of the joints (4, n, N), ``step`` s apart."""
    motion = close(task.model, joints)
    return Point(task, Grid(step), joints, motion, task.regressor(motion))
