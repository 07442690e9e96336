"""Plant in MuJoCo, independent of the equations of the estimator.

Viscous friction and rotor inertia are MuJoCo's damping and armature. All other friction, as in
:mod:`gtau.simulation.plant`, is an applied force updated in every step. MuJoCo's constraints are slightly compliant.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import ModuleType
from typing import Any

import casadi as ca
import numpy as np
from scipy.spatial.transform import Rotation

from gtau.errors import GtauError, needing
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.kinematics import Coordinates, PlatformSlots
from gtau.robots.parameter import BY_LOAD, Parameter, parameter_of, rigid_body
from gtau.robots.placement import Placement
from gtau.robots.robot import GROUND, ROTATIONS, SPRING, STIFFNESS, TRANSLATIONS, Closure, Platform, Robot, Spring
from gtau.simulation.joint_friction import JointFriction, plain_friction
from gtau.simulation.plant import Compiled, PlantState

STEP = 1e-4  # s
STIFF = ([2 * STEP, 1.0], [0.9999, 0.9999, 1e-3, 0.5, 2.0])  # solref and solimp of closures
LIGHTEST = 1e-6  # kg, kg m2: smallest mass and inertia of a body, as MuJoCo moves no body without


class MujocoPlant:
    """A robot in MuJoCo, with the parameters of :class:`gtau.simulation.plant.Plant`.

    Masses and inertias of bodies are at least 1e-6 kg and kg m2. Couplings and friction by load are not supported.
    """

    def __init__(self, model: InverseDynamics, chi: Mapping[str, float], friction: JointFriction | None = None):
        with needing("the engine 'mujoco' (the engine 'gtau' needs nothing more)", "mujoco", "mujoco"):
            import mujoco  # type: ignore[import-untyped, unused-ignore]
        robot, named = model.robot, f"robot '{model.robot.name}'"
        if robot.couplings:
            raise GtauError(
                f"{named} has couplings, which the engine 'mujoco' does not support; use the engine 'gtau'."
            )
        chi = {name: float(chi.get(name, 0.0)) for name in model.parameter_names}
        friction = friction or plain_friction(model, chi)
        if by_load := [name for name, value in friction.values.items() if value and parameter_of(name).kind in BY_LOAD]:
            raise GtauError(
                f"friction by load ('{by_load[0]}') is not supported by the engine 'mujoco'; use the engine 'gtau'."
            )
        viscous = [Parameter("fv", joint.name) for joint in robot.joints]
        chi |= {name: max(friction.values.get(name, 0.0), 0.0) for name in viscous}
        try:
            self._model = robot_spec(mujoco, robot, chi).compile()
        except ValueError as error:
            raise GtauError(
                f"{named}: MuJoCo does not accept its parameters ({str(error).splitlines()[0]}); give every body a "
                "physically possible mass and inertia, or use the engine 'gtau'."
            ) from None
        self._mujoco, self.model = mujoco, model
        self._data = mujoco.MjData(self._model)
        joints = [self._model.joint(joint.name) for joint in robot.joints]
        position, self._rate = (np.array([getattr(joint, at)[0] for joint in joints]) for at in ("qposadr", "dofadr"))
        self._place, self._motors = position[model.layout.actuated], self._rate[model.layout.actuated]
        self.friction = friction
        yd, z = ca.SX.sym("yd", len(joints)), ca.SX.sym("z", len(friction.law.states))
        rest = friction.on_joints(yd, z) - ca.DM([chi[name] for name in viscous]) * yd
        self._rest = Compiled(ca.Function("rest", [yd, z], [ca.densify(rest)]))

    def start(self, q: np.ndarray) -> PlantState:
        """Return the state at rest at actuated positions ``q`` (n,); raises GtauError if they cannot be reached."""
        c = self.model.path(np.array(q, dtype=float)[:, None])[:, 0]
        qpos = mujoco_positions(self._model, self.model.layout, c)
        rest = np.zeros(len(self.friction.law.states))
        return PlantState(np.array(q, dtype=float), np.zeros(len(q)), qpos, np.zeros(self._model.nv), rest)

    def advance(self, state: PlantState, force: np.ndarray, duration: float) -> PlantState:
        """Advance the state by ``duration`` s under constant forces (n,) of the actuated joints, N m or N."""
        data, applied, z = self._data, np.zeros(self._model.nv), state.z
        steps = max(1, round(duration / STEP))
        self._model.opt.timestep = duration / steps
        data.qpos, data.qvel = state.c, state.v
        for _ in range(steps):
            before = data.qpos[self._place]
            applied[self._rate] = -self._rest(data.qvel[self._rate], z)[0]
            applied[self._motors] += force
            data.qfrc_applied = applied
            self._mujoco.mj_step(self._model, data)
            z = self.friction.moved(z, data.qpos[self._place] - before)
        if not np.isfinite(data.qpos).all() or data.warning[self._mujoco.mjtWarning.mjWARN_BADQACC].number:
            raise GtauError(
                f"robot '{self.model.robot.name}': the motion in MuJoCo diverges; check masses, friction and the "
                "controller."
            )
        q, qd = data.qpos[self._place], data.qvel[self._motors]
        return PlantState(q, qd, data.qpos.copy(), data.qvel.copy(), z)


def mujoco_positions(compiled: Any, layout: Coordinates, c: np.ndarray) -> np.ndarray:
    """Compute the coordinates ``qpos`` of a compiled MuJoCo model for a configuration (n_c,)."""
    qpos: np.ndarray = compiled.qpos0.copy()
    coordinates = {joint.name: c[[k]] for k, joint in enumerate(layout.robot.joints)}
    for slots in layout.platforms:
        coordinates |= platform_coordinates(slots, c)
    for name, values in coordinates.items():
        first = compiled.joint(name).qposadr[0]
        qpos[first : first + len(values)] = values
    return qpos


def platform_coordinates(slots: PlatformSlots, c: np.ndarray) -> dict[str, np.ndarray]:
    """Compute the coordinates of a platform's joints in MuJoCo, relative to its home pose."""
    platform, home = slots.platform, slots.platform.home
    shift = c[slots.position] - home.position
    coordinates = {
        f"{dof}_{platform.name}": shift[[axis]] for axis, dof in enumerate(TRANSLATIONS) if dof in platform.dof
    }
    if slots.quaternion is None:
        return coordinates
    turn = Rotation.from_matrix(home.rotation).inv() * Rotation.from_quat(c[slots.quaternion], scalar_first=True)
    turns = [dof for dof in ROTATIONS if dof in platform.dof]
    if len(turns) == 3:
        return coordinates | {f"turn_{platform.name}": turn.as_quat(scalar_first=True)}
    axis = home.rotation[ROTATIONS.index(turns[0])]
    return coordinates | {f"turn_{platform.name}": np.array([turn.as_rotvec() @ axis])}


def robot_spec(mujoco: ModuleType, robot: Robot, chi: Mapping[str, float]) -> Any:
    """Build the ``MjSpec`` of a robot without Coulomb friction and actuators; links have the names of their joints."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False  # else ranges and rest positions of springs are in degrees
    spec.option.gravity = robot.gravity
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.tolerance = 1e-12
    spec.compiler.boundmass = spec.compiler.boundinertia = LIGHTEST
    body = {GROUND: spec.worldbody}
    for joint in robot.joints:
        body[joint.name] = _add_body(robot, body[joint.antecedent], joint.placement, joint.name, chi)
        added = body[joint.name].add_joint(
            name=joint.name,
            type=mujoco.mjtJoint.mjJNT_HINGE if joint.turns else mujoco.mjtJoint.mjJNT_SLIDE,
            axis=joint.axis,
            armature=chi.get(Parameter("ia", joint.name), 0.0),
            damping=chi.get(Parameter("fv", joint.name), 0.0),
        )
        if joint.spring is not None:
            stiffness = chi.get(Parameter(STIFFNESS, joint.name), 0.0)
            added.stiffness = (stiffness, 0.0, 0.0) if np.size(added.stiffness) == 3 else stiffness
            added.springref = joint.spring
    for platform in robot.platforms:
        body[platform.name] = _add_body(robot, spec.worldbody, platform.home, platform.name, chi)
        _add_freedoms(mujoco, body[platform.name], platform)
    for number, closure in enumerate(robot.closures):
        _add_closure(mujoco, spec, number, closure, body)
    for spring in robot.springs:
        _add_spring(mujoco, spec, spring, chi, body)
    return spec


def link_name(robot: Robot, name: str) -> str:
    """Name a link like its joint or platform, except if MuJoCo's ground has this name."""
    link = name
    while link == "world" or (link != name and link in robot.bodies):
        link += "_"
    return link


def _add_freedoms(mujoco: ModuleType, place: Any, platform: Platform) -> None:
    """Add the joints of a platform, relative to its home."""
    # rows of home: base axes in the platform's frame
    home, hinge = platform.home.rotation, mujoco.mjtJoint.mjJNT_HINGE
    for axis, dof in enumerate(TRANSLATIONS):
        if dof in platform.dof:
            place.add_joint(name=f"{dof}_{platform.name}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=home[axis])
    turns = [dof for dof in ROTATIONS if dof in platform.dof]
    if len(turns) == 3:
        place.add_joint(name=f"turn_{platform.name}", type=mujoco.mjtJoint.mjJNT_BALL)
    elif turns:
        place.add_joint(name=f"turn_{platform.name}", type=hinge, axis=home[ROTATIONS.index(turns[0])])


def _add_closure(mujoco: ModuleType, spec: Any, number: int, closure: Closure, body: Mapping[str, Any]) -> None:
    """Add a closure as an equality of two sites."""
    for label, end in (("a", closure.a), ("b", closure.b)):
        quaternion = Rotation.from_matrix(end.placement.rotation).as_quat(scalar_first=True)
        body[end.body].add_site(name=f"{label} {number}", pos=end.placement.position, quat=quaternion)
    weld = closure.kind == "weld"
    tie = spec.add_equality(
        name1=f"a {number}",
        name2=f"b {number}",
        objtype=mujoco.mjtObj.mjOBJ_SITE,
        type=mujoco.mjtEq.mjEQ_WELD if weld else mujoco.mjtEq.mjEQ_CONNECT,
        solref=STIFF[0],
        solimp=STIFF[1],
    )
    if weld:
        tie.data[10] = 1.0  # equal weight of torques and forces


def spring_attributes(spring: Spring, chi: Mapping[str, float]) -> dict[str, Any] | None:
    """Return ``stiffness``, ``springlength`` and ``damping`` of the tendon equal to a spring; None if there is none.

    A tendon cannot have negative stiffness or rest length, so it cannot be a gas spring of constant force.
    """
    f0, k, c = (chi.get(Parameter(kind, spring.name), 0.0) for kind in SPRING)
    if k < 0 or c < 0 or f0 < 0 or (f0 and not k):
        return None
    rest = f0 / k if k else 0.0
    return {"stiffness": k, "springlength": (rest, rest), "damping": c}


def _add_spring(
    mujoco: ModuleType, spec: Any, spring: Spring, chi: Mapping[str, float], body: Mapping[str, Any]
) -> None:
    """Add a spring as a tendon, or as a tendon with an actuator whose force is independent of its control."""
    tendon = spec.add_tendon(name=spring.name)
    for label, end in (("a", spring.a), ("b", spring.b)):
        site = body[end.body].add_site(name=f"{label} {spring.name}", pos=end.placement.position)
        tendon.wrap_site(site.name)
    if (attributes := spring_attributes(spring, chi)) is not None:
        tendon.springlength = attributes.pop("springlength")
        for name, value in attributes.items():  # numbers, or the first coefficients of polynomials
            setattr(tendon, name, (value, 0.0, 0.0) if np.size(getattr(tendon, name)) == 3 else value)
        return
    f0, k, c = (chi.get(Parameter(kind, spring.name), 0.0) for kind in SPRING)
    actuator = spec.add_actuator(name=spring.name, target=spring.name, trntype=mujoco.mjtTrn.mjTRN_TENDON)
    actuator.gainprm[0] = 0.0
    actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    actuator.biasprm[:3] = f0, 0.0 - k, 0.0 - c  # no -0 in files


def _add_body(robot: Robot, parent: Any, placement: Placement, name: str, chi: Mapping[str, float]) -> Any:
    body = rigid_body(chi, name)
    moments, axes = body.principal
    return parent.add_body(
        name=link_name(robot, name),
        pos=placement.position,
        quat=Rotation.from_matrix(placement.rotation).as_quat(scalar_first=True),
        explicitinertial=True,
        mass=body.mass,
        ipos=body.center,
        iquat=Rotation.from_matrix(axes).as_quat(scalar_first=True),
        inertia=moments,
    )
