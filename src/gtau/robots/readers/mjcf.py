"""MJCF files, through MuJoCo's own compiler: geometry, limits, loops and which joints are driven.

Masses, shapes and meshes are left aside; a model reads without the files of its meshes.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.errors import GtauError, missing_extra
from gtau.robots.geometry import compose, pose_of, rounded, turn
from gtau.robots.readers.idle_joints import without_idle_pins
from gtau.robots.readers.urdf import turning
from gtau.robots.readers.xml_document import read_xml
from gtau.robots.robot import GROUND, Attachment, Closure, Coupling, Joint, Limits, Platform, Pose, Robot

if TYPE_CHECKING:
    import mujoco

HOME = "home"
"""Name of the keyframe that gives home; without one, MuJoCo's reference configuration does."""
SHAPES = ("sensors", "geoms", "pairs", "excludes", "skins", "flexes", "meshes", "textures", "materials", "hfields")


def read_mjcf(path: str | Path) -> Robot:
    """Read a robot from an MJCF file.

    Hinges and slides are joints; a ball becomes three revolute ones, about x, y and z, with massless links in between,
    and a free body that carries no joints a platform. Bodies without joints become part of those that carry them.
    The equalities ``connect``, ``weld`` and ``joint`` (linear) become closures and couplings; a joint with an actuator
    is actuated, and where there are no actuators, every joint that is not coupled.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    Robot
        Joint coordinates are MuJoCo's ``qpos``.

    Raises
    ------
    GtauError
        MuJoCo is not installed or refuses the file, or it holds what a robot of gtau cannot be.
    """
    path = Path(path)
    try:
        if (root := read_xml(path)).tag != "mujoco":
            raise GtauError(f"the outermost element is <{root.tag}>, not <mujoco>; give an MJCF file.")
        robot = replace(_robot(compile_geometry(path), path), name=root.get("model") or path.stem)
        return without_idle_pins(robot)
    except GtauError as error:
        raise GtauError(f"{path}: {error}") from None


def compile_geometry(path: Path) -> mujoco.MjModel:
    """The MuJoCo model of a file without its shapes, all bodies of unit mass; raises GtauError where it is refused."""
    try:
        import mujoco
    except ImportError:
        raise missing_extra("reading an MJCF file", "mujoco", "mujoco") from None
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        for kind in SHAPES:
            for each in list(getattr(spec, kind)):
                spec.delete(each)
        for body in spec.bodies[1:]:
            body.explicitinertial, body.mass, body.inertia = True, 1.0, (1.0, 1.0, 1.0)
            body.iquat, body.fullinertia[0] = (1.0, 0.0, 0.0, 0.0), np.nan
        return spec.compile()
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        said = " ".join(str(error).split()).rstrip(".")
        raise GtauError(f"MuJoCo refuses the file ({said}); correct it.") from None


def _robot(model: mujoco.MjModel, path: Path) -> Robot:
    import mujoco

    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, HOME)
    qpos = model.qpos0 if key < 0 else model.key_qpos[key]
    carried: dict[int, Attachment] = {0: Attachment(GROUND)}
    joints: list[Joint] = []
    platforms: list[Platform] = []
    for body in range(1, model.nbody):
        before = carried[int(model.body_parentid[body])]
        if before.body in {platform.name for platform in platforms} and model.body_jntnum[body]:
            raise GtauError(
                f"body '{_name(model, 'body', body)}' hangs by a joint on '{before.body}', which floats; a floating "
                "body can carry no joints, so build the legs from the ground and close them with connect or weld."
            )
        placement = compose(before.placement, _pose(model.body_pos[body], model.body_quat[body]))
        at = Attachment(before.body, placement)
        own = range(int(model.body_jntadr[body]), int(model.body_jntadr[body]) + int(model.body_jntnum[body]))
        for number in own:
            last = number == own[-1]
            if mujoco.mjtJoint(int(model.jnt_type[number])) == mujoco.mjtJoint.mjJNT_FREE:
                at = Attachment(_name(model, "body", body))
                start = int(model.jnt_qposadr[number])
                dof = ("x", "y", "z", "rx", "ry", "rz")
                platforms.append(Platform(at.body, dof, _pose(qpos[start : start + 3], qpos[start + 3 : start + 7])))
            else:
                made, at = _joints(model, number, at, qpos, last)
                joints += made
        carried[body] = at
    closures, couplings, notes = _equalities(model, carried)
    driven, gears = _actuators(model)
    slaves = {coupling.joint for coupling in couplings}
    actuated = driven if model.nu else {joint.name for joint in joints} - slaves
    return Robot(
        path.stem,
        tuple(replace(joint, actuated=joint.name in actuated) for joint in joints),
        tuple(platforms),
        tuple(closures),
        tuple(couplings),
        tuple(float(rounded(g)) for g in model.opt.gravity),  # type: ignore[arg-type]
        path.name,
        tuple(notes + gears),
        home_given=key >= 0,
    )


def _joints(
    model: mujoco.MjModel, number: int, at: Attachment, qpos: np.ndarray, last: bool
) -> tuple[list[Joint], Attachment]:
    """A joint of a body whose frame, not yet moved by it, is at `at`; and where the frame is after it."""
    import mujoco

    name, start = _name(model, "joint", number), int(model.jnt_qposadr[number])
    kind, axis = mujoco.mjtJoint(int(model.jnt_type[number])), model.jnt_axis[number]
    if kind == mujoco.mjtJoint.mjJNT_SLIDE:
        anchor, reference = np.zeros(3), pose_of(np.eye(3), -axis * model.qpos0[start])
    elif kind == mujoco.mjtJoint.mjJNT_HINGE:
        anchor, reference = model.jnt_pos[number], pose_of(turn(axis, -model.qpos0[start]), np.zeros(3))
    else:
        anchor, reference = model.jnt_pos[number], Pose()
    placement = compose(compose(at.placement, pose_of(np.eye(3), anchor)), reference)
    after = Attachment(name, pose_of(np.eye(3), -anchor))
    if kind == mujoco.mjtJoint.mjJNT_BALL:
        from scipy.spatial.transform import Rotation

        angles = Rotation.from_quat(qpos[start : start + 4], scalar_first=True).as_euler("XYZ")
        chain = turning(name, at.body, placement, "xyz")
        chain = [replace(joint, home=float(angle)) for joint, angle in zip(chain, angles, strict=True)]
        return [*chain[:-1], chain[-1] if last else replace(chain[-1], parameters="none")], after
    low, high = model.jnt_range[number]
    joint = Joint(
        name,
        at.body,
        "prismatic" if kind == mujoco.mjtJoint.mjJNT_SLIDE else "revolute",
        placement,
        tuple(rounded(component) for component in axis),  # type: ignore[arg-type]
        home=rounded(qpos[start]),
        limits=Limits((float(low), float(high)) if model.jnt_limited[number] else None),
        # the joints of one body have no links between them
        parameters="all" if last else "drive",
    )
    return [joint], after


def _equalities(
    model: mujoco.MjModel, carried: dict[int, Attachment]
) -> tuple[list[Closure], list[Coupling], list[str]]:
    import mujoco

    closures, couplings, notes = [], [], []
    for number in range(model.neq):
        name, kind = _name(model, "equality", number), mujoco.mjtEq(int(model.eq_type[number]))
        ends, data = (int(model.eq_obj1id[number]), int(model.eq_obj2id[number])), model.eq_data[number]
        if not model.eq_active0[number]:
            notes.append(f"equality '{name}' is not active in the file and was left out")
        elif kind in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD):
            if int(model.eq_objtype[number]) == int(mujoco.mjtObj.mjOBJ_SITE):
                bodies = [int(model.site_bodyid[site]) for site in ends]
                poses = [_pose(model.site_pos[site], model.site_quat[site]) for site in ends]
            elif kind == mujoco.mjtEq.mjEQ_CONNECT:
                bodies, poses = list(ends), [pose_of(np.eye(3), data[k : k + 3]) for k in (0, 3)]
            else:
                bodies, poses = list(ends), [_pose(data[3:6], data[6:10]), pose_of(np.eye(3), data[:3])]
            a, b = (
                Attachment(carried[body].body, compose(carried[body].placement, pose))
                for body, pose in zip(bodies, poses, strict=True)
            )
            closures.append(Closure("connect" if kind == mujoco.mjtEq.mjEQ_CONNECT else "weld", a, b))
        elif kind == mujoco.mjtEq.mjEQ_JOINT and ends[1] >= 0 and not np.any(data[2:5]):
            slave, master = (_name(model, "joint", end) for end in ends)
            zero_slave, zero_master = (model.qpos0[model.jnt_qposadr[end]] for end in ends)
            offset = zero_slave + data[0] - data[1] * zero_master
            couplings.append(Coupling(slave, ((master, float(data[1])),), float(offset)))
        else:
            raise GtauError(
                f"equality '{name}' is none of connect, weld and a linear joint coupling of two joints; remove it, or "
                "describe the mechanism by these."
            )
    return closures, couplings, notes


def _actuators(model: mujoco.MjModel) -> tuple[set[str], list[str]]:
    """Names of the actuated joints, and notes on gears."""
    import mujoco

    driven, notes = set(), []
    for number in range(model.nu):
        if mujoco.mjtTrn(int(model.actuator_trntype[number])) != mujoco.mjtTrn.mjTRN_JOINT:
            raise GtauError(
                f"actuator '{_name(model, 'actuator', number)}' does not drive a joint; only actuators with joint=... "
                "are read."
            )
        joint, gear = _name(model, "joint", int(model.actuator_trnid[number, 0])), float(model.actuator_gear[number, 0])
        driven.add(joint)
        if gear != 1.0:
            notes.append(
                f"actuator of joint '{joint}' has a gear of {gear:g} in the file; positions are those of the joint, "
                "and a drive gain is in N m (or N) at the joint per unit of the logged signal, gear included"
            )
    return driven, notes


def _pose(position: np.ndarray, quaternion: np.ndarray) -> Pose:
    from scipy.spatial.transform import Rotation

    return pose_of(Rotation.from_quat(quaternion, scalar_first=True).as_matrix(), position)


def _name(model: mujoco.MjModel, kind: str, number: int) -> str:
    element: Any = getattr(model, kind)(number)
    return element.name or f"{kind} {number + 1}"
