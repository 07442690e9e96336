"""Read every robot file under folders, and compare torques with Pinocchio (URDF) or MuJoCo (MJCF).

    python benchmarks/robot_files.py [--floating] FOLDER...

For each file: is it read, does its model build, and does the engine give the same torques? A floating base is fixed;
with --floating the base of every robot floats, a URDF's root link on Pinocchio's free flyer, and the rank of the six
base equations alone is compared with that of all equations.
The engine's torques are explained by some standard parameters of the model, the best in the least-squares sense: what
is left is the difference, as a share of the largest torque. So frames, axes, gravity, couplings and springs are
compared without a second reader of inertias.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from xml.etree import ElementTree

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tests" / "support"))
from free_flyer import free_state, pinocchio_state

from gtau.errors import GtauError
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.geometry import exact_angle
from gtau.robots.readers.xml_document import read_xml
from gtau.robots.robot import Robot

SAME = 1e-9  # share of the largest torque
SAMPLES = 40
LARGEST = 60  # joints of a robot that is compared, since the least squares grow with their cube
Torques = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # q, qd, qdd, tau, (N, n) each


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
        torques = engine(path, robot, rng)
    except Exception as error:  # of the engine
        return Outcome(path, "read, not compared", f"by the engine: {' '.join(str(error).split())[:100]}")
    if torques is None:
        return Outcome(path, "read, not compared", "loops, couplings or joints held")
    q, qd, qdd, tau = torques
    W = model.regressor(q, qd, qdd)
    ranks = _ranks(W) if robot.floating else ""
    W = W.reshape(tau.size, -1)
    W = W / np.maximum(np.linalg.norm(W, axis=0), 1e-300)
    chi = np.linalg.lstsq(W, tau.ravel(), rcond=1e-13)[0]
    difference = float(np.abs(W @ chi - tau.ravel()).max() / max(np.abs(tau).max(), 1e-12))
    kind = "same torques" if difference < SAME else "OTHER TORQUES"
    return Outcome(path, kind + (", other ranks" if "but" in ranks else ""), f"{difference:.1e}{ranks}", difference)


def _ranks(W: np.ndarray) -> str:
    """Ranks of the inertial columns in the six base equations and in all, of a regressor (N, n, n_st)."""
    found = []
    for rows in (W[:, :6], W):
        columns = rows.reshape(-1, W.shape[2])
        norms = np.linalg.norm(W[:, :6].reshape(-1, W.shape[2]), axis=0)
        inertial = norms > 1e-9 * norms.max()  # friction and rotors do not act on the base
        found.append(int(np.linalg.matrix_rank(columns[:, inertial] / norms[inertial], tol=1e-8)))
    return f", rank {found[0]} of the base equations" + (f" but {found[1]} of all" if found[0] != found[1] else "")


def random_states(robot: Robot, rng: np.random.Generator) -> np.ndarray:
    """q, qd and qdd of the actuated joints, (3, N, n), enough for every column of the regressor."""
    n = len(robot.actuated)
    samples = max(SAMPLES, 30 * len(robot.joints) // (6 if robot.floating else n))
    return rng.uniform(-1, 1, (3, samples, n)) * np.array([1.0, 2.0, 5.0])[:, None, None]


def plain(robot: Robot) -> bool:
    """Whether the engine's joints are the robot's, one by one."""
    return not (robot.closures or robot.couplings or robot.platforms) and all(joint.actuated for joint in robot.joints)


def pinocchio_torques(path: Path, robot: Robot, rng: np.random.Generator) -> Torques | None:
    """Torques of the file's own masses by Pinocchio, with angles written short written out, as the reader does."""
    import pinocchio as pin

    tree = ElementTree.ElementTree(read_xml(path))  # which forgives prefixes that are declared nowhere
    for origin in tree.getroot().findall("joint/origin"):
        if "rpy" in origin.attrib:
            origin.set("rpy", " ".join(repr(exact_angle(float(each))) for each in origin.get("rpy", "").split()))
    coupled = {joint.get("name") for joint in tree.getroot().findall("joint") if joint.find("mimic") is not None}
    with TemporaryDirectory() as folder:
        copy = Path(folder) / "robot.urdf"
        tree.write(copy)
        free = (pin.JointModelFreeFlyer(),) if robot.floating else ()
        model = pin.buildModelFromUrdf(str(copy), *free)
    model.gravity.linear = np.array(robot.gravity)
    data = model.createData()
    q, qd, qdd = random_states(robot, rng)
    loose = len(robot.base)
    ratios = np.zeros((len(robot.joints), len(robot.actuated)))  # of all joints by those with motors
    offsets = np.zeros(len(robot.joints))
    index = {joint.name: k for k, joint in enumerate(robot.joints)}
    for k, name in enumerate(robot.actuated):
        ratios[index[name], k] = 1.0
    for _ in robot.couplings:  # masters may be slaves themselves
        for coupling in robot.couplings:
            row = index[coupling.joint]
            ratios[row] = sum(ratio * ratios[index[name]] for name, ratio in coupling.ratios)
            offsets[row] = coupling.offset + sum(ratio * offsets[index[name]] for name, ratio in coupling.ratios)
    if robot.closures or robot.platforms or coupled != {coupling.joint for coupling in robot.couplings}:
        return None
    tau = np.zeros_like(q)
    for k in range(len(q)):
        y, yd, ydd = ratios @ q[k] + offsets, ratios @ qd[k], ratios @ qdd[k]
        configuration, v, a = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
        state = free_state(q[k, :loose], qd[k, :loose], qdd[k, :loose]) if loose else None
        if state is not None:
            configuration[:7], v[:6], a[:6] = pinocchio_state(state, *np.zeros((3, 0)))
        for joint in robot.joints[loose:]:
            own, at = model.joints[model.getJointId(joint.name)], index[joint.name]
            angle = [np.cos(y[at]), np.sin(y[at])] if own.nq == 2 else [y[at]]
            configuration[own.idx_q : own.idx_q + own.nq], v[own.idx_v], a[own.idx_v] = angle, yd[at], ydd[at]
        whole = pin.rnea(model, data, configuration, v, a)
        six = [] if state is None else state.six(whole[:3], whole[3:6])
        rest = [whole[model.joints[model.getJointId(joint.name)].idx_v] for joint in robot.joints[loose:]]
        tau[k] = ratios.T @ np.concatenate([six, rest])
    return q, qd, qdd, tau


def mujoco_torques(path: Path, robot: Robot, rng: np.random.Generator) -> Torques | None:
    """Torques of made-up masses by MuJoCo, which reads the file itself, and of the springs in it."""
    import mujoco

    from gtau.robots.readers.mjcf_file import SHAPES

    if not plain(robot):
        return None
    loose = len(robot.base)
    spec = mujoco.MjSpec.from_file(str(path))
    for each in (*spec.actuators, *spec.tendons, *spec.keys, *(one for kind in SHAPES for one in getattr(spec, kind))):
        spec.delete(each)
    for body in spec.bodies[1:]:
        body.explicitinertial, body.mass = True, float(rng.uniform(0.5, 2.0))
        body.inertia, body.fullinertia[0] = rng.uniform(0.9, 1.1, 3), np.nan
        body.ipos, body.iquat, body.gravcomp = rng.uniform(-0.1, 0.1, 3), rng.normal(size=4), 0.0
    for site in spec.sites:
        site.material = ""
    spec.option.density = spec.option.viscosity = 0.0
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    model = spec.compile()
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)  # limits, contacts, Coulomb friction
    names = [model.joint(k).name or f"joint {k + 1}" for k in range(model.njnt)]
    free = [k for k in range(model.njnt) if model.jnt_type[k] == mujoco.mjtJoint.mjJNT_FREE]
    if set(robot.actuated[loose:]) - set(names) or model.neq or (loose and len(free) != 1):
        return None
    number = [names.index(name) for name in robot.actuated[loose:]]
    data = mujoco.MjData(model)
    q, qd, qdd = random_states(robot, rng)
    tau = np.zeros_like(q)
    for k in range(len(q)):
        mujoco.mj_resetData(model, data)
        if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "home") >= 0:
            mujoco.mj_resetDataKeyframe(model, data, mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "home"))
        acceleration = np.zeros(model.nv)
        state = free_state(q[k, :loose], qd[k, :loose], qdd[k, :loose]) if loose else None
        if state is not None:
            at, dof = model.jnt_qposadr[free[0]], model.jnt_dofadr[free[0]]
            data.qpos[at : at + 3] = state.p
            mujoco.mju_mat2Quat(data.qpos[at + 3 : at + 7], state.R.ravel())
            data.qvel[dof : dof + 6] = [*state.v, *state.omega]
            acceleration[dof : dof + 6] = [*state.a, *state.alpha]
        for i, joint in enumerate(number, start=loose):
            data.qpos[model.jnt_qposadr[joint]], data.qvel[model.jnt_dofadr[joint]] = q[k, i], qd[k, i]
            acceleration[model.jnt_dofadr[joint]] = qdd[k, i]
        data.qacc[:] = acceleration
        mujoco.mj_inverse(model, data)
        tau[k, loose:] = data.qfrc_inverse[model.jnt_dofadr[number]]
        if state is not None:
            wrench = data.qfrc_inverse[dof : dof + 6]
            tau[k, :6] = state.six(state.R.T @ wrench[:3], wrench[3:])
    return q, qd, qdd, tau


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
