"""Actuators and tendons of an MJCF file: motors, couplings of joints, and springs between two sites."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Set as AbstractSet
from dataclasses import dataclass

import numpy as np

from gtau.errors import GtauError
from gtau.robots.parts import listed
from gtau.robots.placement import rounded
from gtau.robots.readers.mjcf_file import MjcfFile, mujoco, name_in, pose_in, straight_tendons
from gtau.robots.robot import GROUND, SPRING, Attachment, Coupling, Joint, JointKind, Spring

PLAY = {"revolute": (0.1, "rad"), "prismatic": (1e-3, "m")}
"""Largest play of a joint within the limits of a tendon at which the joint follows others.

ToddlerBot's waist has 0.06 and 0.002 rad; the Shadow hands of Gymnasium, with 0.28 rad at the fingertips, are excluded.
No file with slides was at hand; MuJoCo's grippers have joint limits of 20 to 50 mm.
"""


def fixed_tendons(spec: mujoco.MjSpec) -> dict[str, dict[str, float]]:
    """Read the joints of the fixed tendons and their coefficients in the tendon's length."""
    tendons: dict[str, dict[str, float]] = {}
    for tendon in spec.tendons:
        for part in tendon.path:
            if part.type == mujoco.mjtWrap.mjWRAP_JOINT and part.target:
                tendons.setdefault(tendon.name, {})[part.target.name] = float(part.coef)
    return tendons


def actuators(spec: mujoco.MjSpec) -> list[mujoco.MjsActuator]:
    """List the actuators that are not parts of springs."""
    return [actuator for actuator in spec.actuators if not _is_spring(spec, actuator)]


def efforts(spec: mujoco.MjSpec) -> dict[str, float]:
    """Compute the largest forces, N or N m, of the actuators on each joint, by the smaller ends of their ranges."""

    def most(limited: int, ends: np.ndarray, factor: float = 1.0) -> float:
        return float(np.abs(factor * ends).min()) if _is_limited(spec, limited, ends) else np.inf

    largest: dict[str, float] = {}
    for motor in actuators(spec):
        direct = motor.biastype == mujoco.mjtBias.mjBIAS_NONE and motor.gaintype == mujoco.mjtGain.mjGAIN_FIXED
        force = most(motor.forcelimited, motor.forcerange)
        if direct and motor.dyntype == mujoco.mjtDyn.mjDYN_NONE:
            force = min(force, most(motor.ctrllimited, motor.ctrlrange, motor.gainprm[0]))
        if motor.trntype in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT):
            largest[motor.target] = largest.get(motor.target, 0.0) + abs(float(motor.gear[0])) * force
    for joint in spec.joints:
        largest[joint.name] = min(largest.get(joint.name, 0.0), most(joint.actfrclimited, joint.actfrcrange))
    return {name: rounded(force) for name, force in largest.items() if 0 < force < np.inf}


def _is_spring(spec: mujoco.MjSpec, actuator: mujoco.MjsActuator) -> bool:
    """Return whether an actuator pulls a straight tendon by an uncontrolled force, affine in length and speed."""
    affine = actuator.biastype == mujoco.mjtBias.mjBIAS_AFFINE and not np.any(actuator.gainprm)
    pulls = affine and actuator.trntype == mujoco.mjtTrn.mjTRN_TENDON
    return bool(pulls and actuator.target in straight_tendons(spec))


def site_springs(file: MjcfFile, carried: Mapping[int, Attachment]) -> tuple[list[Spring], list[str]]:
    """Read the straight springs between sites of different bodies, and note tendons that are other springs."""
    model, springs, notes = file.model, list[Spring](), list[str]()
    straight = straight_tendons(file.spec)
    forces = dict[str, np.ndarray]()
    for actuator in file.spec.actuators:
        if _is_spring(file.spec, actuator):
            force = np.asarray(actuator.biasprm[:3], dtype=float)
            forces[actuator.target] = forces.get(actuator.target, np.zeros(3)) + force
    names = {name_in(model, "joint", k) for k in range(model.njnt)} | {at.body for at in carried.values()}
    for tendon in file.spec.tendons:
        k, c = np.ravel(tendon.stiffness), np.ravel(tendon.damping)
        rest = np.ravel(tendon.springlength)
        f0, by_length, by_speed = forces.get(tendon.name, np.zeros(3))
        has = dict(zip(SPRING, (f0 or k[0], by_length or k[0], by_speed or c[0]), strict=True))
        linear = not (k[1:].any() or c[1:].any() or tendon.frictionloss)
        linear &= bool(rest[0] == rest[-1])
        if tendon.name in straight and linear and any(has.values()):
            sites = (model.site(name).id for name in straight[tendon.name])
            a, b = (attached_site(model, site, carried) for site in sites)
            name = f"tendon {tendon.name}" if tendon.name in names else tendon.name
            if a.body != b.body:
                springs.append(Spring(name, a, b, tuple(kind for kind in SPRING if has[kind])))
        elif k.any() or c.any() or tendon.frictionloss:
            notes.append(
                f"tendon '{tendon.name}' acts as a spring, damper or friction in the simulator, which is not modelled, "
                "as it is no linear spring straight between two sites"
            )
    return springs, notes


def attached_site(model: mujoco.MjModel, site: int, carried: Mapping[int, Attachment]) -> Attachment:
    """Find what carries a site."""
    return carried[int(model.site_bodyid[site])].at(pose_in(model.site_pos[site], model.site_quat[site]))


def tied_tendons(file: MjcfFile) -> list[Coupling]:
    """Couple the joints of two fixed tendons that an active equality ties, or of one whose length it keeps constant."""
    tendons, couplings = fixed_tendons(file.spec), []
    for equality in file.spec.equalities:
        if equality.type != mujoco.mjtEq.mjEQ_TENDON or not equality.active:
            continue
        first, second = equality.name1, equality.name2
        constant, factor, *higher = map(float, equality.data[:5])
        if first not in tendons or (second and (second not in tendons or any(higher))):
            raise GtauError(
                f"equality '{equality.name}' ties tendons other than fixed ones, or not linearly, which is not "
                "modelled; remove it, or tie joints by an equality 'joint'."
            )
        terms = dict(tendons[first])
        for name, coefficient in tendons.get(second, {}).items():
            terms[name] = terms.get(name, 0.0) - factor * coefficient
        for name, value in terms.items():
            constant += value * float(file.model.qpos0[int(file.model.joint(name).qposadr[0])])
        leading = next(name for name, value in terms.items() if value)
        couplings.append(Coupling.solved(terms, leading, constant))
    return couplings


def limited_tendons(file: MjcfFile, kinds: Mapping[str, str], tied: AbstractSet[str]) -> Iterator[tuple[Coupling, str]]:
    """Couple motorless joints, not ``tied`` yet, that a fixed tendon lets move only slightly against others."""
    tendons = fixed_tendons(file.spec)
    targets = {actuator.target for actuator in actuators(file.spec)}
    known = targets | tied | {joint for target in targets for joint in tendons.get(target, {})}
    for tendon in file.spec.tendons if targets else ():
        terms = {name: value for name, value in tendons.get(tendon.name, {}).items() if value}
        if len(terms) < 2 or not _is_limited(file.spec, tendon.limited, tendon.range):
            continue
        low, high = map(float, tendon.range)
        for joint in [name for name in terms if name in kinds and name not in known]:
            play, (most, unit) = (high - low) / abs(terms[joint]), PLAY[kinds[joint]]
            if play <= most:
                known |= {joint}
                coupling = Coupling.solved(terms, joint, (low + high) / 2)
                others = listed([name for name, _ in coupling.ratios])
                yield (
                    coupling,
                    f"'{joint}' follows {others} within the limits of tendon '{tendon.name}'; the play of {play:g} "
                    f"{unit} is not modelled",
                )
                break


def _is_limited(spec: mujoco.MjSpec, limited: int, ends: np.ndarray) -> bool:
    if limited == mujoco.mjtLimited.mjLIMITED_AUTO:
        return bool(spec.compiler.autolimits and np.any(ends))
    return bool(limited == mujoco.mjtLimited.mjLIMITED_TRUE)


@dataclass(frozen=True)
class Motors:
    """Joints and tendons driven by the actuators of a file."""

    driven: set[str]  # joints with a motor, shafts included
    pulled: set[str]  # joints that fixed tendons pull, which is not modelled
    shafts: list[Joint]  # motors of tendons, as joints on the ground
    couplings: list[Coupling]  # of joints to shafts
    notes: list[str]


def read_motors(file: MjcfFile, kinds: Mapping[str, JointKind]) -> Motors:
    """Read the actuators; a tendon's becomes a shaft at the tendon's length, if no other actuator drives a joint."""
    tendons, others, pulling = fixed_tendons(file.spec), [], []
    motors = Motors(set(), set(), [], [], [])
    joint_types = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    types = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    movable = {name_in(file.model, "joint", k) for k, kind in enumerate(file.model.jnt_type.tolist()) if kind in types}
    for number, actuator in enumerate(actuators(file.spec), start=1):
        target, gear = actuator.target, float(actuator.gear[0])
        if actuator.trntype in joint_types and target in movable:
            motors.driven.add(target)
            if gear != 1.0:
                motors.notes.append(
                    f"actuator of joint '{target}' has a gear of {gear:g} in the file; positions are measured at the "
                    "joint, and a drive gain is in N m (or N) at the joint per unit of the logged signal, gear included"
                )
        elif actuator.trntype == mujoco.mjtTrn.mjTRN_TENDON and target in tendons:
            pulling.append((number, actuator.name, tendons[target]))
            motors.pulled.update(tendons[target])
        else:
            others.append(actuator.name or target)
    if others:
        s = "s" * (len(others) > 1)
        motors.notes.append(f"actuator{s} {listed(others)} on no hinge, slide or fixed tendon: left out")
    if motors.driven:
        motors.pulled.difference_update(motors.driven)
        return motors
    for number, name, terms in pulling:
        ratios = tuple((joint, factor) for joint, factor in terms.items() if factor)
        shaft = name if name and name not in kinds else f"motor {number}"
        motors.shafts.append(Joint(shaft, GROUND, kinds[ratios[0][0]], parameters="drive"))
        motors.couplings.append(Coupling(shaft, ratios))
        motors.notes.append(
            f"'{shaft}' is the motor that pulls {listed([joint for joint, _ in ratios])} by a fixed tendon; its "
            "position is the tendon's length"
        )
        motors.driven.add(shaft)
    motors.pulled.clear()
    return motors
