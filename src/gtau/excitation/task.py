"""The design problem: robot, motion, payloads, limits and prior knowledge."""

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
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.kinematics import configuration_rates, frames
from gtau.model.loops import Motion, advance, differentiate
from gtau.model.program import Program, compile_program
from gtau.signals.preparation.filters import Decimator, decimation_factor
from gtau.signals.preparation.prepared_run import Preparation
from gtau.signals.reading.statements import Payload

SPEED_FRACTION = Preparation.speed_fraction
STILL = 1e-6  # m/s, smoothing of the tool's speed at rest
SMOOTH = 0.02  # speed range of Coulomb friction's change of sign, as a share of the joint's speed


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Limits of the actuated joints and of the whole motion, inf where there is none.

    Attributes
    ----------
    position : (n, 2)
        Intervals, rad or m.
    rates : (3, n)
        Velocity, acceleration and jerk, rad or m and s.
    current, torque : (n,)
        A, and N m or N; a joint has one of the two.
    workspace : mapping
        Intervals of the tool frame's x, y and z, m.
    condition : float
        Largest condition number of the closures.
    away : float
        Smallest share of a joint's samples away from its reversals.
    guarded : Guarded
        Bodies to keep apart.
    tool_speed : float
        Speed of the tool's frame, m/s.
    """

    position: np.ndarray
    rates: np.ndarray
    current: np.ndarray
    workspace: Mapping[str, tuple[float, float]]
    condition: float
    away: float
    guarded: Guarded = field(default_factory=lambda: Guarded(None, ()))
    torque: np.ndarray = field(default_factory=lambda: np.full(1, np.inf))
    tool_speed: float = np.inf

    @property
    def clearance(self) -> Clearance | None:
        """Bodies to keep apart."""
        return self.guarded.clearance


@dataclass(frozen=True, eq=False)
class DesignProblem:
    """The data of an excitation design.

    A run has ``repetitions`` periods of the ``series`` at the controller's ``rate``, Hz. It begins and ends in the pose
    ``rest`` (n,); if ``rest`` is None, it has no approach and return. There is one run per payload; the runs share
    ``one_motion`` or have a motion each. The gains of the ``prior``, with their intervals, convert torques to currents.
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
                f"the highest harmonic is {self.bandwidth:g} Hz, too fast for a log of {self.rate:g} Hz; take at most "
                "a tenth of the rate."
            )

    @property
    def bandwidth(self) -> float:
        """Frequency of the highest harmonic, Hz."""
        return self.series.harmonics * self.series.base_frequency

    @property
    def motions(self) -> tuple[tuple[int, ...], ...]:
        """Indices of the runs that follow each motion."""
        runs = range(len(self.payloads))
        return (tuple(runs),) if self.one_motion else tuple((run,) for run in runs)

    @property
    def size(self) -> int:
        """Length of x: the free numbers of all motions."""
        return len(self.motions) * self.series.size

    @property
    def guards(self) -> tuple[str, ...]:
        """Sentences on what protects the robot, what was guessed, and what is not checked."""
        return self.limits.guarded.notes

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
        limits = self.limits
        way = np.abs(limits.position - self.rest[:, None]).max(axis=1)
        way = np.where(np.isfinite(way), way, 0.0)
        span = approach_duration(way, limits.rates)
        duration = self.series.period * self.repetitions + 2 * span
        # the mean square speed of a quintic move by 1 in 1 s is 10 / 7
        return np.asarray(way * np.sqrt(2 * 10 / 7 / span / duration))

    @cached_property
    def platform_model(self) -> InverseDynamics | None:
        """Model of the robot driven by its platform, for a motion in platform space."""
        return (
            InverseDynamics(in_platform_space(self.model.robot), "inertial") if self.series.in_platform_space else None
        )

    @cached_property
    def regressor(self) -> SmoothRegressor:
        """Base columns with smooth Coulomb friction."""
        joints = self.model.robot.joints
        length = self.model.layout.length if self.model.loops else 1.0
        speed = np.where(np.isfinite(self.limits.rates[0]), self.limits.rates[0], 1.0)
        turn = float(np.median(speed)) / (1.0 if joints[self.model.layout.actuated[0]].turns else length)
        width = np.array([SMOOTH * turn * (1.0 if joint.turns else length) for joint in joints])
        width[self.model.layout.actuated] = SPEED_FRACTION * SMOOTH * speed  # slower rows are dropped
        return smooth_regressor(self.model, self.base.standard, width)

    @cached_property
    def pullback(self) -> Pullback | None:
        """Conversion of derivatives from the whole robot to its actuated joints."""
        return pullback(self.model)

    @cached_property
    def platform_pullback(self) -> Pullback | None:
        """Conversion of derivatives from the whole robot to its platform."""
        return pullback(self.platform_model) if self.platform_model else None

    @cached_property
    def motors(self) -> list[int]:
        """Indices of the motors among the joints of the robot driven by its platform."""
        assert self.platform_model is not None
        names = [joint.name for joint in self.platform_model.robot.joints]
        return [names.index(name) for name in self.model.actuated]

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
        velocity = ca.jtimes(position, c, configuration_rates(layout, c, yd))
        speed = ca.sqrt(ca.sumsqr(velocity) + STILL**2)
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
