"""What ties the joints of an MJCF file, and what drives them: equalities, fixed tendons and actuators."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from gtau.errors import GtauError
from gtau.robots.geometry import compose, pose_of
from gtau.robots.parts import listed
from gtau.robots.readers.mjcf_file import MjcfFile, TiedTendons
from gtau.robots.readers.xml_document import numbers
from gtau.robots.robot import GROUND, Attachment, Closure, Coupling, Joint, Pose, Spring

if TYPE_CHECKING:
    import mujoco

Kind = Literal["revolute", "prismatic"]


def equalities(
    model: mujoco.MjModel, carried: dict[int, Attachment]
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
    model, found = file.model, []
    joints = {name_in(model, "joint", k) for k in range(model.njnt)} | {end.body for end in carried.values()}
    for each in file.springs:
        a, b = (_attached_site(model, model.site(name).id, carried) for name in each.sites)
        if a.body != b.body:
            name = f"tendon {each.name}" if each.name in joints else each.name
            found.append(Spring(name, a, b, each.parameters))
    return found


def _attached_site(model: mujoco.MjModel, site: int, carried: Mapping[int, Attachment]) -> Attachment:
    at = carried[int(model.site_bodyid[site])]
    return Attachment(at.body, compose(at.placement, pose_in(model.site_pos[site], model.site_quat[site])))


def fixed_tendons(file: MjcfFile) -> dict[str, dict[str, float]]:
    """Read the joints of the fixed tendons and what a tendon's length gains by a unit of each."""
    return {
        tendon.get("name", ""): {
            joint.get("joint", ""): numbers(joint.get("coef", ""), 1, "coef of a fixed tendon")[0]
            for joint in tendon.iter("joint")
        }
        for root in file.elements
        for tendon in root.iter("fixed")
    }


def tendon_coupling(model: mujoco.MjModel, tendons: Mapping[str, Mapping[str, float]], tied: TiedTendons) -> Coupling:
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
    offset = constant + sum(value * zeros[name] for name, value in terms.items())
    (first, own), *rest = [(name, value) for name, value in terms.items() if value]
    return Coupling(first, tuple((name, -value / own) for name, value in rest), offset / own)


def actuated_joints(
    file: MjcfFile, tendons: Mapping[str, Mapping[str, float]], notes: list[str]
) -> tuple[set[str], set[str]]:
    """Name the joints that actuators drive, and those that they pull by fixed tendons; add notes."""
    import mujoco

    model, others = file.model, []
    driven: set[str] = set()
    pulled: set[str] = set()
    turning_or_sliding = {
        name_in(model, "joint", k)
        for k in range(model.njnt)
        if mujoco.mjtJoint(int(model.jnt_type[k])) in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    }
    for name, transmission, target, gear in file.actuators:
        of_joint = transmission in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
        if of_joint and target in turning_or_sliding:
            driven.add(target)
            if gear != 1.0:
                notes.append(
                    f"actuator of joint '{target}' has a gear of {gear:g} in the file; positions are those of the "
                    "joint, and a drive gain is in N m (or N) at the joint per unit of the logged signal, gear included"
                )
        elif transmission == mujoco.mjtTrn.mjTRN_TENDON and target in tendons:
            pulled |= tendons[target].keys()
        else:
            others.append(name or target)
    if others:
        s = "s" * (len(others) > 1)
        notes.append(f"actuator{s} {listed(others)} on no hinge, slide or fixed tendon: left out")
    return driven, pulled


def tendon_motors(
    file: MjcfFile, tendons: Mapping[str, Mapping[str, float]], kinds: Mapping[str, Kind]
) -> Iterator[tuple[Joint, Coupling]]:
    """Convert motors that pull fixed tendons to shafts on the ground whose position is the tendon's length.

    The force along a tendon acts on a joint by the coefficient of the joint in the tendon's length.
    """
    import mujoco

    for number, (name, transmission, target, _) in enumerate(file.actuators, start=1):
        if transmission == mujoco.mjtTrn.mjTRN_TENDON and target in tendons:
            ratios = tuple((joint, factor) for joint, factor in tendons[target].items() if factor)
            shaft = name if name and name not in kinds else f"motor {number}"
            yield Joint(shaft, GROUND, kinds[ratios[0][0]], parameters="drive"), Coupling(shaft, ratios)


def pose_in(position: np.ndarray, quaternion: np.ndarray) -> Pose:
    """Make the pose of a position (3,) and a unit quaternion (4,), w first."""
    from scipy.spatial.transform import Rotation

    return pose_of(Rotation.from_quat(quaternion, scalar_first=True).as_matrix(), position)


def name_in(model: mujoco.MjModel, kind: str, number: int) -> str:
    """Return the name of an element, or its kind and number where it has none."""
    element: Any = getattr(model, kind)(number)
    return element.name or f"{kind} {number + 1}"
