"""Read every robot file under folders, and compare torques with Pinocchio (URDF) or MuJoCo (MJCF).

    python benchmarks/robot_files.py [--floating] FOLDER...

For each file: is it read, does its model build, and does the engine give the same torques? A floating base is fixed;
with --floating the base of every robot floats, a URDF's root link on Pinocchio's free flyer, and the rank of the six
base equations alone is compared with that of all equations, and with that of Pinocchio's own regressor.
The engine's torques are explained by some standard parameters of the model, the best in the least-squares sense: what
is left is the difference, as a share of the largest torque. So frames, axes, gravity, closures, couplings and springs
are compared without a second reader of inertias.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any
from xml.etree import ElementTree

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tests" / "support"))
from free_flyer import free_state, pinocchio_state

from gtau.documents.markup import read_xml
from gtau.errors import GtauError
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.loops import Motion
from gtau.model.singularities import random_motion
from gtau.robots.placement import exact_angle
from gtau.robots.robot import Robot

SAME = 1e-9  # share of the largest torque
SAMPLES = 40
LARGEST = 60  # joints of a robot that is compared, since the least squares grow with their cube


@dataclass(frozen=True)
class Outcome:
    """What became of a file: ``kind`` for the counts, and what was said or measured."""

    path: Path
    kind: str
    text: str
    difference: float = np.nan


def robot_files(folder: Path) -> Iterator[Path]:
    """URDF and MJCF files below a folder, parts to be included left out."""
    for path in sorted(folder.rglob("*")):
        if path.suffix == ".urdf":
            yield path
        elif path.suffix in (".xml", ".mjcf"):
            try:
                root = ElementTree.parse(path).getroot()
            except ElementTree.ParseError:
                continue
            if (root.tag == "mujoco" and next(root.iter("joint"), None) is not None) or next(
                root.iter("include"), None
            ):
                yield path


def examined(path: Path, rng: np.random.Generator, base: str = "fixed") -> Outcome:
    """Read a file, build its model and compare its torques, and of a floating base the ranks of its regressor."""
    engine = pinocchio_torques if path.suffix == ".urdf" else mujoco_torques
    try:
        robot = load_robot(path, base=base)
        model = InverseDynamics(robot)
        _ = model.loops
    except GtauError as error:
        said = str(error).removeprefix(f"{path}: ")
        return Outcome(path, "without joints" if "it has no joints" in said else "refused", said)
    if len(robot.joints) > LARGEST:
        return Outcome(path, "read, not compared", f"{len(robot.joints)} joints")
    try:
        motion = random_states(model, rng)
        whole = engine(path, robot, motion, rng)
    except Exception as error:  # of the engine, or no pose is feasible
        return Outcome(path, "read, not compared", " ".join(str(error).split())[:100])
    if whole is None:
        return Outcome(path, "read, not compared", "balls, platforms or joints held by an equality")
    tau = np.einsum("jnk,jk->kn", motion.J[: len(robot.joints)], whole)  # (N, n) of the actuated joints
    W = np.zeros((*tau.shape, len(model.parameter_names)))
    model.full.fill(model.layout, motion, W)
    ranks = _ranks(W, pinocchio_rank(path, robot, rng)) if robot.floating else ""
    W = W.reshape(tau.size, -1)
    W = W / np.maximum(np.linalg.norm(W, axis=0), 1e-300)
    chi = np.linalg.lstsq(W, tau.ravel(), rcond=1e-13)[0]
    difference = float(np.abs(W @ chi - tau.ravel()).max() / max(np.abs(tau).max(), 1e-12))
    kind = "same torques" if difference < SAME else "OTHER TORQUES"
    return Outcome(path, kind + (", other ranks" if "but" in ranks else ""), f"{difference:.1e}{ranks}", difference)


def _ranks(W: np.ndarray, outside: int | None) -> str:
    """Ranks of the inertial columns in the six base equations and in all, of a regressor (N, n, n_st)."""
    found = []
    for rows in (W[:, :6], W):
        columns = rows.reshape(-1, W.shape[2])
        norms = np.linalg.norm(W[:, :6].reshape(-1, W.shape[2]), axis=0)
        inertial = norms > 1e-9 * norms.max()  # friction and rotors do not act on the base
        found.append(int(np.linalg.matrix_rank(columns[:, inertial] / norms[inertial], tol=1e-8)))
    text = f", rank {found[0]} of the base equations" + (f" but {found[1]} of all" if found[0] != found[1] else "")
    if outside is None:
        return text
    return text + (f" but {outside} by Pinocchio" if outside != found[1] else " and by Pinocchio")


def pinocchio_rank(path: Path, robot: Robot, rng: np.random.Generator) -> int | None:
    """Rank of Pinocchio's own regressor on a free flyer; of none where it moves more joints, as those that mimic."""
    if path.suffix != ".urdf" or robot.couplings:
        return None
    import pinocchio as pin

    model = pinocchio_model(path, robot)
    if model.njoints - 2 != len(robot.joints) - len(robot.base):
        return None
    data, rows = model.createData(), []
    for _ in range(max(SAMPLES, 30 * model.njoints // model.nv)):
        q = pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq))
        rows.append(pin.computeJointTorqueRegressor(model, data, q, *rng.normal(size=(2, model.nv))))
    columns = np.vstack(rows)
    norms = np.linalg.norm(columns, axis=0)
    return int(np.linalg.matrix_rank(columns[:, norms > 0] / norms[norms > 0], tol=1e-8))


def random_states(model: InverseDynamics, rng: np.random.Generator) -> Motion:
    """Motion over random states, enough for every column of the regressor."""
    robot, n = model.robot, len(model.actuated)
    samples = max(SAMPLES, 30 * len(robot.joints) // (6 if robot.floating else n))
    if model.loops is not None:
        return random_motion(model, samples, rng)
    return model.motion(*(rng.uniform(-1, 1, (3, n, samples)) * np.array([1.0, 2.0, 5.0])[:, None, None]))


def pinocchio_model(path: Path, robot: Robot) -> Any:
    """Read a URDF by Pinocchio, with angles written short as the reader takes them."""
    import pinocchio as pin

    tree = ElementTree.ElementTree(read_xml(path))  # which forgives prefixes that are declared nowhere
    for origin in tree.getroot().findall("joint/origin"):
        if "rpy" in origin.attrib:
            origin.set("rpy", " ".join(repr(exact_angle(float(each))) for each in origin.get("rpy", "").split()))
    with TemporaryDirectory() as folder:
        copy = Path(folder) / "robot.urdf"
        tree.write(copy)
        free = (pin.JointModelFreeFlyer(),) if robot.floating else ()
        return pin.buildModelFromUrdf(str(copy), *free)


def pinocchio_torques(path: Path, robot: Robot, motion: Motion, rng: np.random.Generator) -> np.ndarray | None:
    """Torques (joints, N) of the file's own masses by Pinocchio."""
    import pinocchio as pin

    model = pinocchio_model(path, robot)
    loose = len(robot.base)
    if robot.platforms or not {joint.name for joint in robot.joints[loose:]} <= set(model.names):
        return None
    model.gravity.linear = np.array(robot.gravity)
    data = model.createData()
    tau = np.zeros((len(robot.joints), motion.c.shape[1]))
    for k in range(tau.shape[1]):
        configuration, v, a = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
        state = free_state(*(each[:loose, k] for each in (motion.c, motion.yd, motion.ydd))) if loose else None
        if state is not None:
            configuration[:7], v[:6], a[:6] = pinocchio_state(state, *np.zeros((3, 0)))
        for row, joint in enumerate(robot.joints[loose:], start=loose):
            own, y = model.joints[model.getJointId(joint.name)], motion.c[row, k]
            # a joint without limits is a point of the unit circle in Pinocchio
            configuration[own.idx_q : own.idx_q + own.nq] = y if own.nq == 1 else (np.cos(y), np.sin(y))
            v[own.idx_v], a[own.idx_v] = motion.yd[row, k], motion.ydd[row, k]
        whole = pin.rnea(model, data, configuration, v, a)
        if state is not None:
            tau[:loose, k] = state.six(whole[:3], whole[3:6])
        tau[loose:, k] = [whole[model.joints[model.getJointId(joint.name)].idx_v] for joint in robot.joints[loose:]]
    return tau


def mujoco_torques(path: Path, robot: Robot, motion: Motion, rng: np.random.Generator) -> np.ndarray | None:
    """Torques (joints, N) of made-up masses by MuJoCo, which reads the file itself, and of the springs in it.

    Closures and couplings are open in MuJoCo; the model's motion closes them, and its Jacobian projects the torques.
    """
    import mujoco

    from gtau.robots.readers.mjcf_file import SHAPES

    spec = mujoco.MjSpec.from_file(str(path))
    home = next((np.array(key.qpos, dtype=float) for key in spec.keys if key.name == "home"), None)
    constant = any(tie.type == mujoco.mjtEq.mjEQ_JOINT and not tie.name2 for tie in spec.equalities)
    springs = {spring.name.removeprefix("tendon ") for spring in robot.springs}
    forces = [each for each in spec.actuators if each.target not in springs]  # a gas spring's stays
    tendons = [each for each in spec.tendons if each.name not in springs]
    for each in (*forces, *spec.equalities, *tendons, *spec.keys):
        spec.delete(each)
    for each in (one for kind in SHAPES for one in getattr(spec, kind)):
        spec.delete(each)
    for body in spec.bodies[1:]:
        body.explicitinertial, body.mass = True, float(rng.uniform(0.5, 2.0))
        body.inertia, body.fullinertia[0] = rng.uniform(0.9, 1.1, 3), np.nan
        body.ipos, body.iquat, body.gravcomp = rng.uniform(-0.1, 0.1, 3), rng.normal(size=4), 0.0
    for site in spec.sites:
        site.material = ""
    for joint in (each for each in spec.joints if each.type == mujoco.mjtJoint.mjJNT_FREE):  # as said in a note
        joint.armature, joint.frictionloss = 0.0, 0.0
        joint.damping, joint.stiffness = 0.0 * joint.damping, 0.0 * joint.stiffness
    spec.option.density = spec.option.viscosity = 0.0
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    model = spec.compile()
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)  # limits, contacts, Coulomb friction
    kinds = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    names = [model.joint(k).name or f"joint {k + 1}" for k in range(model.njnt)]
    free = [k for k in range(model.njnt) if model.jnt_type[k] == mujoco.mjtJoint.mjJNT_FREE]
    loose, number = len(robot.base), {}  # of MuJoCo's joints by row; the shafts of motors are none of them
    for row, joint in enumerate(robot.joints[loose:], start=loose):
        if joint.name in names and int(model.jnt_type[names.index(joint.name)]) in kinds:
            number[row] = names.index(joint.name)
        elif joint.name not in {coupling.joint for coupling in robot.couplings}:
            return None
    if loose and len(free) != 1:
        raise ValueError("no free joint, or several, in the file")
    if constant or robot.platforms:
        return None
    data = mujoco.MjData(model)
    tau = np.zeros((len(robot.joints), motion.c.shape[1]))
    rows, joints = list(number), list(number.values())
    for k in range(tau.shape[1]):
        mujoco.mj_resetData(model, data)
        if home is not None and home.size == model.nq:
            data.qpos[:] = home
        data.qpos[model.jnt_qposadr[joints]] = motion.c[rows, k]
        data.qvel[model.jnt_dofadr[joints]] = motion.yd[rows, k]
        data.qacc[:] = 0.0
        data.qacc[model.jnt_dofadr[joints]] = motion.ydd[rows, k]
        state = free_state(*(each[:loose, k] for each in (motion.c, motion.yd, motion.ydd))) if loose else None
        if state is not None:
            at, dof = model.jnt_qposadr[free[0]], model.jnt_dofadr[free[0]]
            data.qpos[at : at + 3] = state.p
            mujoco.mju_mat2Quat(data.qpos[at + 3 : at + 7], state.R.ravel())
            data.qvel[dof : dof + 6] = [*state.v, *state.omega]
            data.qacc[dof : dof + 6] = [*state.a, *state.alpha]
        mujoco.mj_inverse(model, data)
        effort = data.qfrc_inverse - data.qfrc_actuator
        tau[rows, k] = effort[model.jnt_dofadr[joints]]
        if state is not None:
            tau[:loose, k] = state.six(state.R.T @ effort[dof : dof + 3], effort[dof + 3 : dof + 6])
    return tau


def main(folders: list[str]) -> None:
    """Examine all files and print counts, the largest difference and each refusal."""
    floating = "--floating" in folders
    folders = [folder for folder in folders if folder != "--floating"]
    if not folders:
        sys.exit(__doc__)
    for folder in map(Path, folders):
        start, outcomes = perf_counter(), []
        files = list(robot_files(folder))
        for k, path in enumerate(files, start=1):
            print(f"\r{k}/{len(files)} {path.name[:60]:60}", end="", file=sys.stderr, flush=True)
            outcomes.append(examined(path, np.random.default_rng(0), "floating" if floating else "fixed"))
        print(file=sys.stderr)
        counts = Counter(outcome.kind for outcome in outcomes)
        print(f"{folder}: {len(files)} files, {perf_counter() - start:.0f} s")
        print("  " + ", ".join(f"{count} {kind}" for kind, count in counts.most_common()))
        compared = [outcome.difference for outcome in outcomes if not np.isnan(outcome.difference)]
        if compared:
            print(f"  largest difference: {max(compared):.1e} of the largest torque")
        for outcome in outcomes:
            if floating or outcome.kind != "same torques":
                print(f"    {outcome.path.relative_to(folder)}: {outcome.kind}: {outcome.text}")


if __name__ == "__main__":
    main(sys.argv[1:])
