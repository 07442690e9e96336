"""Floating bases: a free body that carries the rest of a robot, modelled as six joints of the tree.

The base moves in the world by three slides and three turns without motors, about x, the turned y, and z of the base.
The last of these six joints has the name of the base, and its link is the base. Their rows of the model are the six
base equations: forces along, and moments about, their axes, of external forces.
Measured wrenches act on the base, or on other bodies: a foot on a force plate, a flange that carries a force sensor.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from gtau.errors import GtauError
from gtau.robots.geometry import moved_ends
from gtau.robots.parameter import Parameter, parameter_of
from gtau.robots.robot import GROUND, ROTATIONS, TRANSLATIONS, Joint, Robot, base_rows

WRENCH = ("moment_x", "moment_y", "moment_z", "force_x", "force_y", "force_z")
"""Components of a wrench, N m and N."""


class WrenchFrame(NamedTuple):
    """Frame of a wrench: the body on which it acts, and whether axes and origin are the world's or the body's."""

    body: str
    of_world: bool = False


AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


def base_joints(name: str) -> tuple[Joint, ...]:
    """Build the six joints of a floating base, on the ground, the last with its name; none without a name."""
    chain = base_rows(name)
    kinds = (TRANSLATIONS + ROTATIONS)[: len(chain)]
    return tuple(
        Joint(
            joint,
            chain[k - 1] if k else GROUND,
            "prismatic" if kind in TRANSLATIONS else "revolute",
            axis=AXES[kind[-1]],
            parameters="inertial" if joint == name else "none",
        )
        for k, (joint, kind) in enumerate(zip(chain, kinds, strict=True))
    )


def float_base(robot: Robot, name: str = "base") -> Robot:
    """Let the base of a robot float: everything mounted on the ground is then carried by a body ``name``.

    The joints keep their motors; those of the base have none. A platform that does not move in all six degrees of
    freedom is tied to the ground, and refused.
    """
    for problem in _fixed_to_ground(robot):
        raise GtauError(f"robot '{robot.name}': {problem}.")
    joints = tuple(replace(joint, antecedent=_on(name, joint.antecedent)) for joint in robot.joints)
    closures, springs = moved_ends(robot, lambda end: replace(end, body=_on(name, end.body)))
    return replace(
        robot,
        joints=base_joints(name) + joints,
        closures=closures,
        springs=springs,
        floating=name,
        file=replace(
            robot.file, inertias=tuple((_own(name, parameter), value) for parameter, value in robot.file.inertias)
        ),
    )


def drawn_base(robot: Robot) -> tuple[str, ...]:
    """Find six unactuated, untied joints, three slides and three turns, that represent a floating base in a file.

    They form a chain from the ground and carry all others; none if there is no such chain.
    """
    before, six = GROUND, list[Joint]()
    while len(six) < 6:
        following = [joint for joint in robot.joints if joint.antecedent == before]
        if len(following) != 1 or following[0].actuated:
            return ()
        six.append(following[0])
        before = following[0].name
    names = tuple(joint.name for joint in six)
    ends = {GROUND, *names[:-1]}.intersection(end.body for end in robot.ends)
    coupled = {name for coupling in robot.couplings for name in (coupling.joint, *dict(coupling.ratios))}
    axes = ([joint.axis for joint in six if joint.kind == kind] for kind in ("prismatic", "revolute"))
    spanning = all(len(directions) == 3 and np.linalg.matrix_rank(directions) == 3 for directions in axes)
    return names if spanning and not ends and coupled.isdisjoint(names) else ()


def refuse_floating(robot: Robot, what: str) -> None:
    """Refuse a robot with a floating base where ``what`` ("exciting trajectories are") requires a fixed one."""
    if robot.floating:
        raise GtauError(
            f"robot '{robot.name}': its base '{robot.floating}' floats, and {what} not supported there; if the base "
            f"did not move, fix it by"
            " 'robot: {file: ..., base: fixed}', or --base fixed."
        )


def _own(name: str, parameter: str) -> Parameter:
    stated = parameter_of(parameter)
    return Parameter(stated.kind, _on(name, stated.body))


def _on(name: str, body: str) -> str:
    return name if body == GROUND else body


def _fixed_to_ground(robot: Robot) -> Iterator[str]:
    if robot.floating:
        yield f"its base '{robot.floating}' floats already"
    for platform in robot.platforms:
        if len(platform.dof) < len(TRANSLATIONS + ROTATIONS):
            yield (
                f"platform '{platform.name}' moves in {' '.join(platform.dof)} of the ground alone, which a floating "
                f"base carries along; write 'dof: [{', '.join(TRANSLATIONS + ROTATIONS)}]', its closures constrain the "
                "rest"
            )
