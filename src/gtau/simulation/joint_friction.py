"""Friction of a simulated robot, by the same law as identification.

The law is :class:`gtau.estimation.friction.law.FrictionLaw`, with its states z. For a joint without presliding,
``sign(qd)`` becomes ``tanh(qd / width)``, which can be integrated. The state of a joint with presliding is the stop
operator of its position; it is not integrated, so a joint at rest does not creep.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from gtau.errors import GtauError
from gtau.estimation.friction.law import JOINT_TERMS, FrictionLaw
from gtau.estimation.regression.rows import FORMULAS
from gtau.estimation.results.result import IdentifiedModel
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.parameter import BY_LOAD, Parameter, parameter_of
from gtau.robots.robot import PLAIN_FRICTION
from gtau.uses.prediction import friction_values, loaded_parameters

WIDTH = {"prismatic": 1e-3, "revolute": 2e-3}  # m/s, rad/s: sign(v) is tanh(v / width)
STATED = tuple(kind for kind in JOINT_TERMS if kind not in PLAIN_FRICTION)
"""Friction that a simulation may have beyond the standard parameters."""
MISSED = 1e-9  # largest overshoot of a reversal within a step, over the width of presliding
BALANCES = 3  # iterations that scale propelling terms to the resulting load


@dataclass(frozen=True, eq=False)
class JointFriction:
    """Friction and offsets of all joints, by the ``law`` of the robot.

    ``values`` are ``fv``, ``fs``, ``fb``, ``fl``, ``f3`` and ``off`` by name, SI units, zero if missing; ``smoothing``
    is the width of ``sign(qd)`` by kind of joint. Values that the law cannot represent are refused.
    """

    law: FrictionLaw
    values: Mapping[str, float]
    smoothing: Mapping[str, float]

    def __post_init__(self) -> None:
        law, robot = self.law, f"robot '{self.law.model.robot.name}'"
        joints = [joint.name for joint in law.model.robot.joints]
        shares = dict.fromkeys(law.model.actuated, 0.0)
        for kind, joint in ((name.kind, name.body) for name in law.shapes):
            if joint not in joints:
                raise GtauError(f"{robot} has no joint '{joint}', whose friction has a curve; correct it.")
            if kind == "width" and not law.ratios[joints.index(joint)].any():
                raise GtauError(
                    f"joint '{joint}' of {robot} moves at no constant ratio to the motors, so its presliding cannot be "
                    "simulated; give a width to actuated joints only."
                )
        for name, value in self.values.items():
            parameter = parameter_of(name)
            kind, joint = parameter.kind, parameter.body
            if kind in STATED and joint not in joints:
                raise GtauError(f"{robot} has no joint '{joint}' for the friction '{name}'; correct it.")
            if kind == "fb" and value and Parameter("vs", joint) not in law.shapes:
                raise GtauError(
                    f"friction '{name}' needs a speed over which it falls; give the 'speed' of joint '{joint}'."
                )
            if kind in BY_LOAD and value:
                if (motor := law.motor_of(joint)) is None:
                    raise GtauError(
                        f"friction '{name}' depends on the load of a joint that no single motor of {robot} moves; give "
                        "'fl' of other joints."
                    )
                shares[motor] += abs(value)
        for motor, share in shares.items():
            if share >= 1:
                raise GtauError(
                    f"the friction by load ('fl') on motor '{motor}' is {share:g} of the load, so it never moves; give "
                    "less than 1."
                )

    @cached_property
    def reach(self) -> np.ndarray:
        """Derivatives (s, n) of the states by the actuated joints before sliding, 1/rad or 1/m."""
        return self.law.ratios[list(self.law.states)] / self.law.widths[:, None]

    @cached_property
    def propels(self) -> bool:
        """Whether a term of the law may propel and needs scaling down."""
        forces = {kind: self._by_joint(kind) for kind in FORMULAS}
        forces["fb"] += self._by_joint("fs")  # at rest
        return bool(np.min([*forces.values()]) < 0)

    @cached_property
    def offsets(self) -> np.ndarray:
        """Offsets (joints,), N m or N."""
        return self._by_joint("off")

    def _by_joint(self, kind: str) -> np.ndarray:
        """Collect the values of a kind of parameter, (joints,)."""
        return np.array([self.values.get(Parameter(kind, joint.name), 0.0) for joint in self.law.model.robot.joints])

    def moved(self, z: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """Update states (s,) for monotone displacements (n,) of the actuated joints."""
        return np.clip(z + self.reach @ dq, -1.0, 1.0)

    def until_turn(self, z: np.ndarray, before: np.ndarray, after: np.ndarray, step: float) -> float:
        """Compute the part of a step before the first reversal of a sliding joint, from the speeds (n,) at its ends.

        Sliding erases the history of a state, so steps must end at reversals of sliding joints.
        """
        v, w = self.reach @ before, self.reach @ after
        turns = v * w < 0
        part = np.where(turns, v, 1.0) / np.where(turns, v - w, 1.0)
        slid = np.abs(z + v * part * step / 2) > 1
        back = np.abs(w) * (1 - part) * step / 2
        return float(np.min(part, where=turns & slid & (back > MISSED), initial=1.0))

    def effort(self, yd: ca.SX, J: ca.SX, force: ca.SX, z: ca.SX) -> ca.SX:
        """Express the effort e = force - friction (n,) that moves the robot, which is also the load of the joints.

        Friction by load is ``s |e|``, so ``e + s |e|`` is the motor force (n,) minus all other friction.
        """
        (plain, loaded), speeds = self._forces(yd, z)
        n_joints, scales, effort = len(self.offsets), ca.SX.ones(plain.shape[0]), force
        driving = force - J[:n_joints, :].T @ ca.DM(self.offsets)

        def on_motors(acting: ca.SX) -> ca.SX:
            return J[:n_joints, :].T @ acting[:n_joints] + acting[n_joints:]

        for _ in range(1 + BALANCES * self.propels):
            rest = driving - on_motors(scales * plain)
            effort = rest / (1 + on_motors(scales * loaded) * ca.sign(rest))
            if self.propels:
                scales = self.law.scales(ca, plain + loaded * self._felt(effort), speeds)
        return effort

    def on_joints(self, yd: ca.SX, z: ca.SX) -> ca.SX:
        """Express friction (except ``fl``) and offsets of all joints at velocities (joints,) and states."""
        (plain, _), speeds = self._forces(yd, z)
        forces = self.law.scales(ca, plain, speeds) * plain if self.propels else plain
        joints = forces[: len(self.offsets)] + ca.DM(self.offsets)
        joints[self.law.model.layout.actuated.tolist()] += forces[len(self.offsets) :]
        return joints

    def _forces(self, yd: ca.SX, z: ca.SX) -> tuple[tuple[ca.SX, ca.SX], ca.SX]:
        """Express the forces of the law at zero load, their change per unit load, and the speeds they oppose."""
        law, joints, n = self.law, self.law.model.robot.joints, len(self.law.model.actuated)
        sliding = [ca.tanh(yd[row] / self.smoothing[joint.kind]) for row, joint in enumerate(joints)]
        states = dict(zip(law.states, ca.vertsplit(z) if law.states else [], strict=True))
        directions = [states.get(row, slides) for row, slides in enumerate(sliding)]
        (plain, speeds), (loaded, _) = (
            [ca.densify(ca.vertcat(*parts)) for parts in law.forces(ca, self.values, yd, load, directions)]
            for load in (ca.SX.zeros(n), ca.SX.ones(n))
        )
        return (plain, loaded - plain), speeds

    def _felt(self, effort: ca.SX) -> ca.SX:
        """List the absolute motor effort on which every force of the law depends, or 0."""
        motors = [self.law.motor(row) for row in range(len(self.law.ratios))]
        felt = [0.0 if motor is None else ca.fabs(effort[motor]) for motor in motors]
        return ca.vertcat(*felt, ca.SX.zeros(effort.shape[0]))


def plain_friction(
    model: InverseDynamics, values: Mapping[str, float], smoothing: Mapping[str, float] = WIDTH
) -> JointFriction:
    """Make friction with only the parameters ``fv``, ``fs`` and ``off``."""
    return JointFriction(FrictionLaw(model, {}), values, smoothing)


def identified_friction(
    result: IdentifiedModel, smoothing: Mapping[str, float]
) -> tuple[dict[str, float], JointFriction]:
    """Return standard parameters equivalent to an identified model, and its friction."""
    chi = loaded_parameters(result, None, "the robot")
    standard: dict[str, float] = dict(zip(result.base.standard, map(float, chi), strict=True))
    return standard, JointFriction(result.friction_law, friction_values(result, chi), smoothing)
