"""Design task: robot, motion, payloads, limits and prior knowledge."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import casadi as ca
import numpy as np

from gtau.errors import GtauError
from gtau.excitation.clearance import Clearance
from gtau.excitation.gradients import Pullback, SmoothRegressor, in_platform_space, pullback, smooth_regressor
from gtau.excitation.guards import Guarded
from gtau.excitation.information import Information, Window, information_of
from gtau.excitation.prior import PriorModel
from gtau.excitation.trajectory import FourierSeries, approach_duration
from gtau.model.base_parameters import BaseParameters
from gtau.model.interpreter.program import Program, compile_program
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.kinematics import configuration_rates, frames
from gtau.model.loops import Motion, advance, differentiate
from gtau.signals.preparation.filters import Decimator, decimation_factor
from gtau.signals.preparation.prepared_run import Preparation
from gtau.signals.reading.statements import Payload

SPEED_FRACTION = Preparation.speed_fraction
STILL = 1e-6  # m/s, below which a speed has no direction
SMOOTH = 0.02  # width of passive joints' Coulomb friction in a design, of their speed


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Limits of the actuated joints, (n,) each with inf where there is none, and of the motion as a whole.

    ``position`` (n, 2), ``velocity``, ``acceleration``, ``jerk`` in rad or m and s; ``current`` in A, ``torque`` in N m
    or N, one of them for a joint; ``workspace`` maps x, y, z of the tool's frame to an interval in m, ``tool_speed`` is
    that frame's in m/s; ``condition`` is the largest condition number of the closures; ``away`` the least share of each
    joint's samples away from its reversals; ``guarded`` keeps bodies apart.
    """

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray
    current: np.ndarray
    workspace: Mapping[str, tuple[float, float]]
    condition: float
    away: float
    guarded: Guarded = field(default_factory=lambda: Guarded(None, ()))
    torque: np.ndarray = field(default_factory=lambda: np.full(1, np.inf))
    tool_speed: float = np.inf

    @property
    def clearance(self) -> Clearance | None:
        """Bodies that are kept apart."""
        return self.guarded.clearance


@dataclass(frozen=True, eq=False)
class DesignProblem:
    """The data of an excitation design.

    ``series`` is of the actuated joints, or of the platform, with ``repetitions`` periods in a run at the controller's
    ``rate``, Hz. A run begins and ends in the pose ``rest`` (n,), or has no approach and return where that is None. All
    runs, one for each of the ``payloads``, follow ``one_motion``, or each its own. By the gains of the ``prior``, with
    their intervals, limits of torque and current are converted.
    """

    model: InverseDynamics
    base: BaseParameters
    series: FourierSeries
    rate: float
    repetitions: int
    rest: np.ndarray | None
    payloads: tuple[Payload | None, ...]
    one_motion: bool
    limits: MotionLimits
    prior: PriorModel

    def __repr__(self) -> str:
        return f"DesignProblem({self.model.robot.name!r}, runs: {len(self.payloads)}, rate: {self.rate:g} Hz)"

    def __post_init__(self) -> None:
        if self.bandwidth > 0.1 * self.rate:
            raise GtauError(
                f"the highest harmonic is {self.bandwidth:g} Hz, which a log of {self.rate:g} Hz cannot follow; take "
                "at most a tenth of the rate."
            )

    @property
    def bandwidth(self) -> float:
        """Frequency of the highest harmonic, Hz."""
        return self.series.harmonics * self.series.base_frequency

    @property
    def motions(self) -> tuple[tuple[int, ...], ...]:
        """The runs that follow each motion."""
        runs = range(len(self.payloads))
        return (tuple(runs),) if self.one_motion else tuple((run,) for run in runs)

    @property
    def size(self) -> int:
        """Length of x: the free numbers of the series, motion by motion."""
        return len(self.motions) * self.series.size

    @property
    def guards(self) -> tuple[str, ...]:
        """What keeps the robot from harm, what was guessed, and what is not checked, a sentence each."""
        return self.limits.guarded.said

    @cached_property
    def information(self) -> Information:
        """Unknowns estimated from all runs together, and the information of rows about them, over all repetitions."""
        return information_of(self.model, self.base, self.payloads, self.prior, self.rate * self.repetitions)

    @cached_property
    def decimator(self) -> Decimator:
        """Decimation filter that identification will choose for this bandwidth."""
        return Decimator(decimation_factor(self.rate, self.bandwidth))

    def window(self, step: float) -> Window:
        """Return the loss of rows near reversals on a time grid of spacing ``step``."""
        return Window(step, self.decimator.guard / self.rate, SPEED_FRACTION, self.approach_speed)

    @cached_property
    def approach_speed(self) -> np.ndarray:
        """Upper bound (n,) on the rms speed that approach and return add to a run, rad/s or m/s."""
        if self.rest is None:
            return np.zeros(len(self.prior.sigma))
        limits = self.limits
        way = np.abs(limits.position - self.rest[:, None]).max(axis=1)
        way = np.where(np.isfinite(way), way, 0.0)
        span = approach_duration(way, limits.velocity, limits.acceleration, limits.jerk)
        duration = self.series.period * self.repetitions + 2 * span
        # the mean square speed of a quintic move by 1 in 1 s is 10 / 7
        return np.asarray(way * np.sqrt(2 * 10 / 7 / span / duration))

    @cached_property
    def platform_model(self) -> InverseDynamics | None:
        """The robot driven by its platform, for a motion in platform space."""
        return InverseDynamics(in_platform_space(self.model.robot), "inertial") if self.series.of_platform else None

    @cached_property
    def regressor(self) -> SmoothRegressor:
        """Base columns, with Coulomb friction smoothed where it would jump."""
        joints = self.model.robot.joints
        length = self.model.layout.length if self.model.loops else 1.0
        speed = np.where(np.isfinite(self.limits.velocity), self.limits.velocity, 1.0)
        turn = float(np.median(speed)) / (1.0 if joints[self.model.layout.actuated[0]].turns else length)
        width = np.array([SMOOTH * turn * (1.0 if joint.turns else length) for joint in joints])
        width[self.model.layout.actuated] = SPEED_FRACTION * SMOOTH * speed  # rows in which these jump do not count
        return smooth_regressor(self.model, self.base.standard, width)

    @cached_property
    def pullback(self) -> Pullback | None:
        """Slopes from the whole robot to its actuated joints."""
        return pullback(self.model)

    @cached_property
    def platform_pullback(self) -> Pullback | None:
        """Slopes from the whole robot to its platform."""
        return pullback(self.platform_model) if self.platform_model else None

    @cached_property
    def motors(self) -> list[int]:
        """Indices of the actuated joints among the joints of the robot driven by its platform."""
        assert self.platform_model is not None
        names = [joint.name for joint in self.platform_model.robot.joints]
        return [names.index(name) for name in self.model.actuated]

    @cached_property
    def tool(self) -> tuple[Program, Program]:
        """Position of the tool's frame in the base by c, and the slopes by c of a weighted sum of its coordinates."""
        c, weights = ca.SX.sym("c", self.model.layout.n_c), ca.SX.sym("weights", 3)
        position = frames(self.model.layout, c)[self.model.robot.tool].p_0
        back = ca.gradient(ca.dot(weights, position), c)
        return compile_program([c], [position]), compile_program([c, weights], [back])

    @cached_property
    def tool_speed(self) -> tuple[Program, Program]:
        """Speed of the tool's frame in the base by c and yd, and its slopes by c and yd, one below the other."""
        layout = self.model.layout
        c, yd = ca.SX.sym("c", layout.n_c), ca.SX.sym("yd", layout.n_y)
        position = frames(layout, c)[self.model.robot.tool].p_0
        velocity = ca.jtimes(position, c, configuration_rates(layout, c, yd))
        speed = ca.sqrt(ca.sumsqr(velocity) + STILL**2)
        slopes = ca.densify(ca.gradient(speed, ca.vertcat(c, yd)))
        return compile_program([c, yd], [ca.densify(speed)]), compile_program([c, yd], [slopes])

    def with_payload_mass(self, mass: float) -> DesignProblem:
        """Return the same task with a different ``mass``, kg, of all known payloads."""
        payloads = tuple(
            payload.model_copy(update={"mass": mass}) if payload is not None and payload.mass is not None else payload
            for payload in self.payloads
        )
        return replace(self, payloads=payloads)


def close(model: InverseDynamics, joints: np.ndarray, near: np.ndarray | None = None) -> Motion:
    """Close the loops for q, qd and qdd, (3 or more, n, N), from configurations (n_c, N) that may be ``near``."""
    q, qd, qdd = joints[:3]
    if model.loops is None or near is None or near.shape[1] != q.shape[1]:
        return model.motion(q, qd, qdd)
    c, reached = advance(model.loops, near, q)
    if not reached.all():
        return model.motion(q, qd, qdd)  # says where
    return differentiate(model.loops, c, qd, qdd)
