"""Which joints of an MJCF file have motors: those with an actuator or, in a gripper alone, shafts that pull tendons."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from gtau.robots.parts import listed
from gtau.robots.readers.mjcf_file import MjcfFile
from gtau.robots.readers.mjcf_model import name_in
from gtau.robots.readers.mjcf_ties import fixed_tendons
from gtau.robots.robot import GROUND, Coupling, Joint

Kind = Literal["revolute", "prismatic"]


@dataclass(frozen=True)
class Motors:
    """What the actuators of a file drive.

    Attributes
    ----------
    driven : frozenset of str
        Joints with a motor, shafts among them.
    pulled : frozenset of str
        Other joints, pulled by fixed tendons, which are not modelled.
    shafts, couplings : tuple
        Motors of tendons, as joints on the ground, and the joints coupled to them.
    notes : tuple of str
    """

    driven: frozenset[str]
    pulled: frozenset[str]
    shafts: tuple[Joint, ...]
    couplings: tuple[Coupling, ...]
    notes: tuple[str, ...]


def read_motors(file: MjcfFile, joints: Sequence[Joint]) -> Motors:
    """Read the actuators; those that pull fixed tendons become motors only where no other drives a joint."""
    tendons, notes = fixed_tendons(file), list[str]()
    driven, pulled = _actuated_joints(file, tendons, notes)
    if driven or not pulled:
        return Motors(frozenset(driven), frozenset(pulled - driven), (), (), tuple(notes))
    shafts, couplings = [], []
    for shaft, coupling in _tendon_motors(file, tendons, {joint.name: joint.kind for joint in joints}):
        shafts.append(shaft)
        couplings.append(coupling)
        notes.append(
            f"'{shaft.name}' is the motor that pulls {listed([name for name, _ in coupling.ratios])} by a fixed "
            "tendon; its position is the tendon's length"
        )
    driven = {shaft.name for shaft in shafts}
    return Motors(frozenset(driven), frozenset(), tuple(shafts), tuple(couplings), tuple(notes))


def _actuated_joints(
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


def _tendon_motors(
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
