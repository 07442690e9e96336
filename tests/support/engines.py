"""Reference torques of any Robot by Pinocchio and by MuJoCo, without a line of ``gtau.model``.

Each engine builds the spanning tree: the joints, and every platform as a chain of its own degrees of
freedom that starts from its home pose. Both chains sum up to the same robot, but the engines differ in
the order and the meaning of their velocity coordinates; torques at the actuated joints do not.
Closures are solved here by Newton on the engine's own frames, and their inverse dynamics follow by
projection; couplings are rows of the closures' equations. ``chi`` maps names of parameters (``xx_J`` .. ``m_J ia_J
fv_J fs_J off_J``) to values; what is absent is zero, masses that are present must be positive.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import pinocchio as pin

from gtau.robots.robot import DRIVE, GROUND, INERTIAL, ROTATIONS, TRANSLATIONS, Robot

Parameters = Mapping[str, float]
MASSLESS = 1e-14


def random_parameters(robot: Robot, rng: np.random.Generator) -> dict[str, float]:
    """Parameters of bodies that could be built: clouds of point masses, whose pseudo-inertia is positive."""
    chi = {}
    kinds = {joint.name: joint.parameters for joint in robot.joints}
    for body in robot.bodies:
        if kinds.get(body, "all") not in ("all", "inertial"):
            continue
        masses = rng.uniform(0.05, 0.5, 10)
        points = rng.uniform(-0.2, 0.2, 3) + rng.normal(0.0, 0.15, (10, 3))
        second = np.einsum("i,ij,ik->jk", masses, points, points)
        inertia = np.trace(second) * np.eye(3) - second  # its off-diagonal is -int x y dm
        values = (*inertia[np.triu_indices(3)], *masses @ points, masses.sum())
        chi |= {f"{kind}_{body}": float(value) for kind, value in zip(INERTIAL, values, strict=True)}
    for joint in robot.joints:
        values = rng.uniform(0.1, 1.0, 4)
        if joint.parameters in ("all", "drive"):
            chi |= {f"{kind}_{joint.name}": float(value) for kind, value in zip(DRIVE, values, strict=True)}
    return chi


@dataclass(frozen=True)
class Frame:
    """A frame fixed to a body, in base axes: pose, Jacobian (linear over angular), acceleration at zero ``vd``."""

    position: np.ndarray  # (3,)
    rotation: np.ndarray  # (3, 3)
    jacobian: np.ndarray  # (6, nv)
    drift: np.ndarray  # (6,)


class Pinocchio:
    """The tree in Pinocchio; frames stand in the order a1, b1, a2, b2, ... of the closures."""

    def __init__(self, robot: Robot, chi: Parameters) -> None:
        model = pin.Model()
        model.gravity.linear = np.array(robot.gravity)
        body: dict[str, tuple[int, pin.SE3]] = {GROUND: (0, pin.SE3.Identity())}  # joint, and the body's frame in it
        for joint in robot.joints:
            axis = np.array(joint.axis)
            kind = pin.JointModelRevoluteUnaligned if joint.kind == "revolute" else pin.JointModelPrismaticUnaligned
            placement = pin.SE3(joint.placement.rotation, joint.placement.position)
            body[joint.name] = (
                model.addJoint(body[joint.antecedent][0], kind(axis), placement, joint.name),
                pin.SE3.Identity(),
            )
        for platform in robot.platforms:
            parent, placement = 0, pin.SE3(np.eye(3), platform.home.position)
            for chain_joint in _platform_joints(platform.dof):
                parent = model.addJoint(parent, chain_joint, placement, f"{platform.name} {model.njoints}")
                placement = pin.SE3.Identity()
            body[platform.name] = (parent, pin.SE3(platform.home.rotation, np.zeros(3)))
        for name in (name for name in robot.bodies if f"m_{name}" in chi):
            xx, xy, xz, yy, yz, zz, mx, my, mz, m = (chi[f"{kind}_{name}"] for kind in INERTIAL)
            inertia = pin.Inertia.FromDynamicParameters(np.array([m, mx, my, mz, xx, xy, yy, xz, yz, zz]))
            model.appendBodyToJoint(body[name][0], inertia, body[name][1])
        self.frames_of_closures = []
        for end in (end for closure in robot.closures for end in (closure.a, closure.b)):
            parent, placement = body[end.body]
            placement = placement * pin.SE3(end.placement.rotation, end.placement.position)
            frame = pin.Frame(f"end {len(self.frames_of_closures)}", parent, 0, placement, pin.FrameType.OP_FRAME)
            self.frames_of_closures.append(model.addFrame(frame))
        self.model, self.data, self.nv = model, model.createData(), model.nv
        self.joint_q = np.array([model.joints[body[joint.name][0]].idx_q for joint in robot.joints])
        self.joint_v = np.array([model.joints[body[joint.name][0]].idx_v for joint in robot.joints])

    def neutral(self) -> np.ndarray:
        """Configuration with zero joints and home platforms, (nq,)."""
        return pin.neutral(self.model)

    def integrate(self, q: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Configuration after a step in velocity coordinates, (nq,)."""
        return pin.integrate(self.model, q, step)

    def frames(self, q: np.ndarray, v: np.ndarray) -> list[Frame]:
        """Frames of the closures' ends."""
        model, data, axes = self.model, self.data, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        pin.computeJointJacobians(model, data, q)
        pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
        pin.updateFramePlacements(model, data)
        return [
            Frame(
                data.oMf[frame].translation.copy(),
                data.oMf[frame].rotation.copy(),
                pin.getFrameJacobian(model, data, frame, axes),
                pin.getFrameClassicalAcceleration(model, data, frame, axes).vector,
            )
            for frame in self.frames_of_closures
        ]

    def torques(self, q: np.ndarray, v: np.ndarray, vd: np.ndarray) -> np.ndarray:
        """Forces of the rigid bodies on the tree's coordinates, (nv,)."""
        return pin.rnea(self.model, self.data, q, v, vd)


def _platform_joints(dof: tuple[str, ...]) -> list:
    axes = np.eye(3)
    slides = [pin.JointModelPrismaticUnaligned(axes[TRANSLATIONS.index(name)]) for name in dof if name in TRANSLATIONS]
    turns = [pin.JointModelRevoluteUnaligned(axes[ROTATIONS.index(name)]) for name in dof if name in ROTATIONS]
    return slides + ([pin.JointModelSpherical()] if len(turns) == 3 else turns)


class Mujoco:
    """The tree in MuJoCo; its sites stand in the order a1, b1, a2, b2, ... of the closures."""

    def __init__(self, robot: Robot, chi: Parameters) -> None:
        spec = mujoco.MjSpec()
        spec.option.gravity = robot.gravity
        spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        body = {GROUND: spec.worldbody}
        for joint in robot.joints:
            body[joint.name] = _add_body(spec, body[joint.antecedent], joint.placement, joint.name, chi)
            kind = mujoco.mjtJoint.mjJNT_HINGE if joint.kind == "revolute" else mujoco.mjtJoint.mjJNT_SLIDE
            body[joint.name].add_joint(name=joint.name, type=kind, axis=joint.axis)
        for platform in robot.platforms:
            body[platform.name] = _add_body(spec, spec.worldbody, platform.home, platform.name, chi)
            home = platform.home.rotation  # its rows are the base axes in the platform's own
            for name in (name for name in TRANSLATIONS if name in platform.dof):
                axis = home[TRANSLATIONS.index(name)]
                body[platform.name].add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
            turns = [name for name in ROTATIONS if name in platform.dof]
            if len(turns) == 3:
                body[platform.name].add_joint(type=mujoco.mjtJoint.mjJNT_BALL)
            elif turns:
                axis = home[ROTATIONS.index(turns[0])]
                body[platform.name].add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis)
        ends = [end for closure in robot.closures for end in (closure.a, closure.b)]
        for number, end in enumerate(ends):
            quat = _quaternion(end.placement.rotation)
            body[end.body].add_site(name=f"end {number}", pos=end.placement.position, quat=quat)
        model = spec.compile()
        self.spec, self.model, self.data, self.nv = spec, model, mujoco.MjData(model), model.nv
        self.sites = [model.site(f"end {number}").id for number in range(len(ends))]
        self.joint_q = np.array([model.joint(joint.name).qposadr[0] for joint in robot.joints])
        self.joint_v = np.array([model.joint(joint.name).dofadr[0] for joint in robot.joints])

    def neutral(self) -> np.ndarray:
        """Configuration with zero joints and home platforms, (nq,)."""
        return self.model.qpos0.copy()

    def integrate(self, q: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Configuration after a step in velocity coordinates, (nq,)."""
        q = q.copy()
        mujoco.mj_integratePos(self.model, q, step, 1.0)
        return q

    def frames(self, q: np.ndarray, v: np.ndarray) -> list[Frame]:
        """Frames of the closures' ends."""
        model, data = self.model, self.data
        data.qpos, data.qvel = q, v
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        frames = []
        for site in self.sites:
            jacobian, rate = np.zeros((6, self.nv)), np.zeros((6, self.nv))
            mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], site)
            mujoco.mj_jacDot(model, data, rate[:3], rate[3:], data.site_xpos[site], model.site_bodyid[site])
            rotation = data.site_xmat[site].reshape(3, 3).copy()
            frames.append(Frame(data.site_xpos[site].copy(), rotation, jacobian, rate @ v))
        return frames

    def torques(self, q: np.ndarray, v: np.ndarray, vd: np.ndarray) -> np.ndarray:
        """Forces of the rigid bodies on the tree's coordinates, (nv,)."""
        data = self.data
        data.qpos, data.qvel, data.qacc = q, v, vd
        mujoco.mj_inverse(self.model, data)
        return data.qfrc_inverse.copy()


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(rotation).ravel())
    return quat


def _add_body(spec, parent, placement, name: str, chi: Parameters):
    if f"m_{name}" not in chi:  # MuJoCo knows no massless bodies
        return parent.add_body(
            name=name,
            pos=placement.position,
            quat=_quaternion(placement.rotation),
            explicitinertial=True,
            mass=MASSLESS,
            inertia=[MASSLESS] * 3,
        )
    xx, xy, xz, yy, yz, zz, mx, my, mz, m = (chi[f"{kind}_{name}"] for kind in INERTIAL)
    com = np.array([mx, my, mz]) / m
    at_com = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) - m * (com @ com * np.eye(3) - np.outer(com, com))
    moments, axes = np.linalg.eigh(at_com)
    axes[:, 0] *= np.linalg.det(axes)
    return parent.add_body(
        name=name,
        pos=placement.position,
        quat=_quaternion(placement.rotation),
        explicitinertial=True,
        mass=m,
        ipos=com,
        iquat=_quaternion(axes),
        inertia=moments,
    )


Engine = Callable[[Robot, Parameters], Pinocchio | Mujoco]


def tree_torques(
    robot: Robot, chi: Parameters, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, engine: Engine = Pinocchio
) -> np.ndarray:
    """Forces of all joints with closures open and platforms left out; all arrays (N, joints)."""
    tree = engine(robot, chi)
    tau = np.empty(np.shape(q))
    for sample, (position, velocity, acceleration) in enumerate(zip(q, qd, qdd, strict=True)):
        configuration, v, vd = tree.neutral(), np.zeros(tree.nv), np.zeros(tree.nv)
        configuration[tree.joint_q], v[tree.joint_v], vd[tree.joint_v] = position, velocity, acceleration
        tau[sample] = tree.torques(configuration, v, vd)[tree.joint_v] + _drive(robot, chi, velocity, acceleration)
    return tau


@dataclass(frozen=True)
class ClosedMotion:
    """Motion of a closed robot over N samples: joints (N, joints), and what the actuated ones move."""

    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    J: np.ndarray  # (N, joints, actuated), d joints / d actuated
    tau: np.ndarray  # (N, actuated)


def closed_torques(
    robot: Robot, chi: Parameters, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, engine: Engine = Pinocchio
) -> np.ndarray:
    """Forces of the actuated joints with closures closed, in home's assembly mode; all arrays (N, actuated)."""
    return closed_motion(robot, chi, q, qd, qdd, engine).tau


@dataclass(frozen=True)
class ClosedState:
    """One state of a closed robot in an engine's own coordinates."""

    y: np.ndarray  # (nq,)
    v: np.ndarray  # (nv,)
    vd: np.ndarray  # (nv,)
    J: np.ndarray  # (nv, actuated)


def closed_states(
    robot: Robot, tree: Pinocchio | Mujoco, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray
) -> list[ClosedState]:
    """States of the whole tree from those of the actuated joints, (N, actuated)."""
    moved = np.array([joint.actuated for joint in robot.joints])
    actuated = tree.joint_v[moved]
    free = np.setdiff1d(np.arange(tree.nv), actuated)
    home = tree.neutral()
    home[tree.joint_q] = [joint.home for joint in robot.joints]
    home = _close(tree, robot, home, free, 1e-13)
    samples = []
    for goal, velocity, acceleration in zip(q, qd, qdd, strict=True):
        y = home
        start = home[tree.joint_q[moved]]
        for part in np.linspace(0.05, 1.0, 20):  # small steps from home keep the assembly mode
            y = y.copy()
            y[tree.joint_q[moved]] = start + part * (goal - start)
            y = _close(tree, robot, y, free, 1e-13 if part == 1.0 else 1e-4)
        _, C, _ = _constraint(tree, robot, y, np.zeros(tree.nv))
        J = np.zeros((tree.nv, actuated.size))
        J[actuated] = np.eye(actuated.size)
        J[free] = -_solve(C[:, free], C[:, actuated])
        v = J @ velocity
        _, _, drift = _constraint(tree, robot, y, v)
        vd = J @ acceleration
        vd[free] -= _solve(C[:, free], drift)
        samples.append(ClosedState(y, v, vd, J))
    return samples


def closed_motion(
    robot: Robot, chi: Parameters, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, engine: Engine = Pinocchio
) -> ClosedMotion:
    """Motion and forces of all joints, from those of the actuated ones, (N, actuated)."""
    tree = engine(robot, chi)
    samples = []
    for state in closed_states(robot, tree, q, qd, qdd):
        motion = state.y[tree.joint_q], state.v[tree.joint_v], state.vd[tree.joint_v], state.J[tree.joint_v]
        samples.append((*motion, _torques(robot, tree, chi, state)))
    return ClosedMotion(*(np.array(rows) for rows in zip(*samples, strict=True)))


def torques_of(robot: Robot, sets: Sequence[Parameters], q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    """Forces of the actuated joints for many sets of parameters, (N * actuated, sets), by Pinocchio."""
    states = closed_states(robot, Pinocchio(robot, sets[0]), q, qd, qdd)
    columns = []
    for chi in sets:
        tree = Pinocchio(robot, chi)
        columns.append(np.concatenate([_torques(robot, tree, chi, state) for state in states]))
    return np.column_stack(columns)


def _torques(robot: Robot, tree: Pinocchio | Mujoco, chi: Parameters, state: ClosedState) -> np.ndarray:
    tau = tree.torques(state.y, state.v, state.vd)
    tau[tree.joint_v] += _drive(robot, chi, state.v[tree.joint_v], state.vd[tree.joint_v])
    return state.J.T @ tau


def _drive(robot: Robot, chi: Parameters, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    ia, fv, fs, off = np.array([[chi.get(f"{kind}_{joint.name}", 0.0) for joint in robot.joints] for kind in DRIVE])
    return ia * qdd + fv * qd + fs * np.sign(qd) + off


def _constraint(
    tree: Pinocchio | Mujoco, robot: Robot, y: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Error of the closures, and C and drift in ``C vd + drift = 0``."""
    error, C, drift = [np.zeros(0)], [np.zeros((0, tree.nv))], [np.zeros(0)]
    frames = tree.frames(y, v)
    for closure, a, b in zip(robot.closures, frames[::2], frames[1::2], strict=True):
        rows = slice(0, 3 if closure.kind == "connect" else 6)
        turn = pin.log3(a.rotation @ b.rotation.T)
        error.append(np.concatenate([a.position - b.position, turn])[rows])
        C.append((a.jacobian - b.jacobian)[rows])
        drift.append((a.drift - b.drift)[rows])
    index = [joint.name for joint in robot.joints]
    for coupling in robot.couplings:
        row = np.zeros(tree.nv)
        row[tree.joint_v[index.index(coupling.joint)]] = 1.0
        for name, ratio in coupling.ratios:
            row[tree.joint_v[index.index(name)]] = -ratio
        error.append(np.array([row[tree.joint_v] @ y[tree.joint_q] - coupling.offset]))
        C.append(row[None, :])
        drift.append(np.zeros(1))
    return np.concatenate(error), np.concatenate(C), np.concatenate(drift)


def _solve(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    solution, _, rank, _ = np.linalg.lstsq(A, B, rcond=1e-10)
    assert rank == A.shape[1], f"the closures fix {rank} of {A.shape[1]} passive coordinates"
    return solution


def _close(tree: Pinocchio | Mujoco, robot: Robot, y: np.ndarray, free: np.ndarray, within: float) -> np.ndarray:
    rest = np.zeros(tree.nv)
    for _ in range(30):
        error, C, _ = _constraint(tree, robot, y, rest)
        if np.abs(error).max(initial=0.0) < within:
            return y
        step = rest.copy()
        step[free] = -_solve(C[:, free], error)
        y = tree.integrate(y, step)
    raise AssertionError(f"the closures stay open by {np.abs(error).max()}")
