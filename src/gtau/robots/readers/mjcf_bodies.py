"""The bodies of an MJCF file as a tree, and the equalities, fixed tendons and springs that tie them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from gtau.errors import GtauError
from gtau.robots.floating import base_joints
from gtau.robots.geometry import compose, pose_of, rounded, turn
from gtau.robots.parts import listed
from gtau.robots.readers.mjcf_file import MjcfFile, TiedTendons, name_in, pose_in, rotation_in
from gtau.robots.readers.source import BASE_ADVICE, FLOATING, BaseChoice
from gtau.robots.readers.urdf_tree import turning
from gtau.robots.readers.xml_document import numbers, position_limits
from gtau.robots.robot import (
    GROUND,
    ROTATIONS,
    TRANSLATIONS,
    Attachment,
    Closure,
    Coupling,
    Joint,
    Limits,
    Platform,
    Pose,
    Spring,
    base_rows,
)

if TYPE_CHECKING:
    import mujoco


@dataclass
class Bodies:
    """Joints, platforms and floating base of a file, filled along the tree.

    ``joints`` are in the order of the file, those of a floating base first; ``platforms`` are free bodies that carry no
    joints; ``carried`` says which joint or platform carries each body, and where on it the body's frame is;
    ``floating`` is the body that is a floating base, if any, and ``notes`` name bodies that were fixed.
    """

    joints: list[Joint] = field(default_factory=list)
    platforms: list[Platform] = field(default_factory=list)
    carried: dict[int, Attachment] = field(default_factory=lambda: {0: Attachment(GROUND)})
    floating: str = ""
    notes: list[str] = field(default_factory=list)


def read_bodies(model: mujoco.MjModel, qpos: np.ndarray, base: BaseChoice) -> Bodies:
    """Walk the tree of a compiled model, whose joints are at home at ``qpos``."""
    import mujoco

    bodies, carriers = Bodies(), _carriers(model)
    for body in range(1, model.nbody):
        before = bodies.carried[int(model.body_parentid[body])]
        at = Attachment(before.body, compose(before.placement, pose_in(model.body_pos[body], model.body_quat[body])))
        numbers = range(int(model.body_jntadr[body]), int(model.body_jntadr[body]) + int(model.body_jntnum[body]))
        for number in numbers:
            if mujoco.mjtJoint(int(model.jnt_type[number])) == mujoco.mjtJoint.mjJNT_FREE:
                start = int(model.jnt_qposadr[number])
                pose = pose_in(qpos[start : start + 3], qpos[start + 3 : start + 7])
                at = _freed(bodies, name_in(model, "body", body), pose, body in carriers, base)
            else:
                made, at = _joints(model, number, at, qpos, number == numbers[-1])
                bodies.joints += made
        bodies.carried[body] = at
    bodies.joints.sort(key=lambda joint: joint.name not in base_rows(bodies.floating))
    return bodies


def _carriers(model: mujoco.MjModel) -> set[int]:
    """Find the bodies that carry joints, their own not counted."""
    carriers = set()
    for body in range(1, model.nbody):
        if model.body_jntnum[body]:
            while body := int(model.body_parentid[body]):
                carriers.add(body)
    return carriers


def _freed(bodies: Bodies, name: str, pose: Pose, carries: bool, base: BaseChoice) -> Attachment:
    """Make a free body a platform, a floating base or a part of the ground; return the attachment of its frame."""
    if not carries:
        bodies.platforms.append(Platform(name, TRANSLATIONS + ROTATIONS, pose))
        return Attachment(name)
    if base is None:
        raise GtauError(f"body '{name}' floats and carries joints; {BASE_ADVICE}.")
    if base == FLOATING:
        if bodies.floating:
            raise GtauError(f"the bodies '{bodies.floating}' and '{name}' float; give the file of one robot.")
        bodies.floating = name
        bodies.joints += base_joints(name)
        return Attachment(name)
    bodies.notes.append(f"body '{name}' floats in the file and was fixed")
    return Attachment(GROUND, pose if base.rpy is None else Pose())


def _joints(
    model: mujoco.MjModel, number: int, at: Attachment, qpos: np.ndarray, last: bool
) -> tuple[list[Joint], Attachment]:
    """Make the joint of a body whose frame is at `at` before its motion; return the frame's attachment after it."""
    import mujoco

    name, start = name_in(model, "joint", number), int(model.jnt_qposadr[number])
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
        angles = rotation_in(qpos[start : start + 4]).as_euler("XYZ")
        chain = turning(name, at.body, placement, "xyz")
        chain = [replace(joint, home=float(angle)) for joint, angle in zip(chain, angles, strict=True)]
        return [*chain[:-1], chain[-1] if last else replace(chain[-1], parameters="none")], after
    low, high = map(float, model.jnt_range[number])
    joint = Joint(
        name,
        at.body,
        "prismatic" if kind == mujoco.mjtJoint.mjJNT_SLIDE else "revolute",
        placement,
        tuple(rounded(component) for component in axis),  # type: ignore[arg-type]
        home=rounded(qpos[start]),
        limits=Limits(position_limits(low, high) if model.jnt_limited[number] else None),
        # the joints of one body have no links between them
        parameters="all" if last else "drive",
        spring=rounded(model.qpos_spring[start]) if np.any(model.jnt_stiffness[number]) else None,
    )
    return [joint], after


PLAY = {"revolute": (0.1, "rad"), "prismatic": (1e-3, "m")}
"""The most that the limits of a tendon may leave a joint that follows others.

ToddlerBot's waist has 0.06 and 0.002 rad; the Shadow hands of Gymnasium, with 0.28 rad at the fingertips, are left out.
Of slides no file was at hand; MuJoCo's grippers have joint limits of 20 to 50 mm.
"""


def read_ties(
    file: MjcfFile, carried: Mapping[int, Attachment], kinds: Mapping[str, str]
) -> tuple[list[Closure], list[Coupling], dict[str, float], list[str]]:
    """Read the active equalities, and tendons with limits as narrow; ``carried`` places the frames of the bodies.

    Returns closures, couplings, the positions at which an equality holds joints, and notes; ``kinds`` of joints are
    given by their names.
    """
    closures, couplings, held = _equalities(file.model, carried)
    tendons = fixed_tendons(file)
    for tied in file.tied_tendons:
        coupling = _tendon_coupling(file.model, tendons, tied)
        if coupling.ratios:
            couplings.append(coupling)
        else:
            held[coupling.joint] = coupling.offset
    notes = []
    for coupling, note in _within_limits(
        file, tendons, kinds, {coupling.joint for coupling in couplings} | held.keys()
    ):
        couplings.append(coupling)
        notes.append(note)
    return closures, couplings, held, notes


def _equalities(
    model: mujoco.MjModel, carried: Mapping[int, Attachment]
) -> tuple[list[Closure], list[Coupling], dict[str, float]]:
    """Read closures, couplings, and the positions of joints that an equality holds."""
    import mujoco

    closures, couplings, held = [], [], {}
    for number in range(model.neq):
        name, kind = name_in(model, "equality", number), mujoco.mjtEq(int(model.eq_type[number]))
        ends, data = (int(model.eq_obj1id[number]), int(model.eq_obj2id[number])), model.eq_data[number]
        if kind in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD):
            if int(model.eq_objtype[number]) == int(mujoco.mjtObj.mjOBJ_SITE):
                bodies = [int(model.site_bodyid[site]) for site in ends]
                poses = [pose_in(model.site_pos[site], model.site_quat[site]) for site in ends]
            elif kind == mujoco.mjtEq.mjEQ_CONNECT:
                bodies, poses = list(ends), [pose_of(np.eye(3), data[k : k + 3]) for k in (0, 3)]
            else:
                bodies, poses = list(ends), [pose_in(data[3:6], data[6:10]), pose_of(np.eye(3), data[:3])]
            a, b = (
                Attachment(carried[body].body, compose(carried[body].placement, pose))
                for body, pose in zip(bodies, poses, strict=True)
            )
            if a.body != b.body:
                closures.append(Closure("connect" if kind == mujoco.mjtEq.mjEQ_CONNECT else "weld", a, b))
        elif kind == mujoco.mjtEq.mjEQ_JOINT and not (ends[1] >= 0 and np.any(data[2:5])):
            zeros = [float(model.qpos0[model.jnt_qposadr[end]]) for end in ends if end >= 0]
            slave = name_in(model, "joint", ends[0])
            if ends[1] < 0:
                held[slave] = zeros[0] + float(data[0])
                continue
            offset, ratio = zeros[0] + float(data[0]) - float(data[1]) * zeros[1], float(data[1])
            if ratio:
                couplings.append(Coupling(slave, ((name_in(model, "joint", ends[1]), ratio),), offset))
            else:
                held[slave] = offset
        else:
            raise GtauError(
                f"equality '{name}' is neither connect, weld nor a linear joint coupling of two joints; remove it, or "
                "describe the mechanism by these."
            )
    return closures, couplings, held


def site_springs(file: MjcfFile, carried: Mapping[int, Attachment]) -> list[Spring]:
    """Read the springs between sites of different bodies."""
    model, springs = file.model, []
    joints = {name_in(model, "joint", k) for k in range(model.njnt)} | {end.body for end in carried.values()}
    for tendon in file.springs:
        a, b = (_attached_site(model, model.site(name).id, carried) for name in tendon.sites)
        if a.body != b.body:
            name = f"tendon {tendon.name}" if tendon.name in joints else tendon.name
            springs.append(Spring(name, a, b, tendon.parameters))
    return springs


def _attached_site(model: mujoco.MjModel, site: int, carried: Mapping[int, Attachment]) -> Attachment:
    at = carried[int(model.site_bodyid[site])]
    return Attachment(at.body, compose(at.placement, pose_in(model.site_pos[site], model.site_quat[site])))


def fixed_tendons(file: MjcfFile) -> dict[str, dict[str, float]]:
    """Read the joints of the fixed tendons and their coefficients in the tendon's length."""
    return {
        tendon.get("name", ""): {
            joint.get("joint", ""): numbers(joint.get("coef", ""), 1, "coef of a fixed tendon")[0]
            for joint in tendon.iter("joint")
        }
        for root in file.elements
        for tendon in root.iter("fixed")
    }


def _tendon_coupling(model: mujoco.MjModel, tendons: Mapping[str, Mapping[str, float]], tied: TiedTendons) -> Coupling:
    """Make the coupling of joints by two fixed tendons whose lengths are tied, or by one of constant length."""
    constant, factor, *higher = tied.polynomial
    known = tied.tendon in tendons and (not tied.other or tied.other in tendons)
    if not known or (tied.other and any(higher)):
        raise GtauError(
            f"equality '{tied.name}' ties tendons other than fixed ones, or not linearly, which is not modelled; "
            "remove it, or tie joints by an equality 'joint'."
        )
    terms = dict(tendons[tied.tendon])
    for name, coefficient in tendons.get(tied.other, {}).items():
        terms[name] = terms.get(name, 0.0) - factor * coefficient
    zeros = {name: float(model.qpos0[int(model.joint(name).qposadr[0])]) for name in terms}
    length = constant + sum(value * zeros[name] for name, value in terms.items())
    return _solved(terms, next(name for name, value in terms.items() if value), length)


def _solved(terms: Mapping[str, float], joint: str, length: float) -> Coupling:
    """Make the coupling that gives a joint from the others whose sum, each by its factor, is a length."""
    factor = terms[joint]
    ratios = tuple((name, -value / factor) for name, value in terms.items() if value and name != joint)
    return Coupling(joint, ratios, length / factor)


def _within_limits(
    file: MjcfFile, tendons: Mapping[str, Mapping[str, float]], kinds: Mapping[str, str], tied: AbstractSet[str]
) -> Iterator[tuple[Coupling, str]]:
    """Couple joints without a motor that a fixed tendon lets move only a little against its others, as gears do."""
    targets = {target for _, _, target, _ in file.actuators}
    known = targets | tied | {joint for target in targets for joint in tendons.get(target, {})}
    for tendon, low, high in file.limited_tendons if targets else ():
        terms = {name: value for name, value in tendons.get(tendon, {}).items() if value}
        if not tendon or len(terms) < 2:
            continue
        for joint in [name for name in terms if name in kinds and name not in known]:
            play, (most, unit) = (high - low) / abs(terms[joint]), PLAY[kinds[joint]]
            if play <= most:
                known |= {joint}
                coupling = _solved(terms, joint, (low + high) / 2)
                yield (
                    coupling,
                    f"'{joint}' follows {listed([name for name, _ in coupling.ratios])} within the limits of tendon "
                    f"'{tendon}'; the play of {play:g} {unit} is not modelled",
                )
                break
