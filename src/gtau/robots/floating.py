"""Floating bases: a free body that carries the rest of a robot, modelled as six joints of the tree.

The base moves in the world by three slides and three turns without motors, about x, the turned y, and z of the base.
The last of these six joints has the name of the base, and its link is the base. Their rows of the model are the six
base equations: external forces along, and moments about, their axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gtau.errors import GtauError
from gtau.robots.geometry import moved_ends
from gtau.robots.parameter import Parameter, stated_inertias
from gtau.robots.placement import Placement, Pose
from gtau.robots.robot import GROUND, ROTATIONS, TRANSLATIONS, Joint, Robot, base_rows

AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


def base_joints(name: str) -> tuple[Joint, ...]:
    """Build the six joints of a floating base, on the ground, the last with its name."""
    return _chain(base_rows(name), TRANSLATIONS + ROTATIONS, GROUND, Pose())


def turning(name: str, antecedent: str, placement: Placement, axes: str) -> tuple[Joint, ...]:
    """Make a spherical or universal joint: revolute ones about `axes` in turn, with massless links in between."""
    names = [*(f"{name}_{axis}" for axis in axes[:-1]), name]
    return _chain(names, [f"r{axis}" for axis in axes], antecedent, placement)


def _chain(names: Sequence[str], kinds: Sequence[str], antecedent: str, placement: Placement) -> tuple[Joint, ...]:
    """Make joints one after the other, all but the last with massless links: ``x`` slides along x, ``rx`` turns."""
    joints = []
    for name, kind in zip(names, kinds, strict=True):
        joint = Joint(name, antecedent, "revolute" if kind in ROTATIONS else "prismatic", placement, AXES[kind[-1]])
        joints.append(replace(joint, parameters="inertial" if name == names[-1] else "none"))
        antecedent, placement = name, Pose()
    return tuple(joints)


def float_base(robot: Robot, name: str = "base") -> Robot:
    """Let the base of a robot float: a body ``name`` then carries everything mounted on the ground."""
    if robot.floating:
        raise GtauError(f"robot '{robot.name}': its base '{robot.floating}' floats already.")
    for platform in robot.platforms:
        if len(platform.dof) < len(TRANSLATIONS + ROTATIONS):
            raise GtauError(
                f"robot '{robot.name}': platform '{platform.name}' moves in {' '.join(platform.dof)} of the ground "
                "alone, which a floating base carries along; write "
                f"'dof: [{', '.join(TRANSLATIONS + ROTATIONS)}]', its closures constrain the rest."
            )

    def on(body: str) -> str:
        return name if body == GROUND else body

    joints = tuple(replace(joint, antecedent=on(joint.antecedent)) for joint in robot.joints)
    closures, springs = moved_ends(robot, lambda end: replace(end, body=on(end.body)))
    stated = {Parameter(key.kind, on(key.body)): value for key, value in stated_inertias(robot).items()}
    floated = replace(robot, joints=base_joints(name) + joints, closures=closures, springs=springs, floating=name)
    return floated.with_file(inertias=tuple(stated.items()))


def drawn_base(robot: Robot) -> tuple[str, ...]:
    """Find the three slides and three turns, unactuated and untied, that carry all other joints as a floating base."""
    before, six = GROUND, list[Joint]()
    while len(six) < 6:
        following = [joint for joint in robot.joints if joint.antecedent == before]
        if len(following) != 1 or following[0].actuated:
            return ()
        six.append(following[0])
        before = following[0].name
    names = tuple(joint.name for joint in six)
    ends = {GROUND, *names[:-1]}.intersection(end.body for end in robot.ends)
    coupled = {name for tie in robot.couplings for name in tie.terms}
    axes = ([joint.axis for joint in six if joint.kind == kind] for kind in ("prismatic", "revolute"))
    spanning = all(len(directions) == 3 and np.linalg.matrix_rank(directions) == 3 for directions in axes)
    return names if spanning and not ends and coupled.isdisjoint(names) else ()


def refuse_floating(robot: Robot, what: str) -> None:
    """Refuse a robot with a floating base where ``what`` ("exciting trajectories are") requires a fixed one."""
    if robot.floating:
        raise GtauError(
            f"robot '{robot.name}': its base '{robot.floating}' floats, and {what} not supported there; if the base "
            "did not move, fix it by 'robot: {file: ..., base: fixed}'."
        )
