"""Doubtful entries of robot files: wrong units, a home out of reach, a payload on an unnamed body, missing masses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import pi

import numpy as np

from gtau.robots.parameter import parameter_of
from gtau.robots.robot import INERTIAL, Joint, Placement, Robot

TURNS = 2  # a wider range either way suggests limits in degrees
FAR = 20.0  # m; a longer link suggests mm
REACHED = 1e-9  # rad or m; a home on a limit is within it


def oddities(robot: Robot) -> tuple[str, ...]:
    """Note implausible entries, a sentence each: links of 350 m, limits of 130 rad, a home outside the limits."""
    return (*_lengths(robot), *_angles(robot), *_homes(robot))


def tool_note(robot: Robot) -> tuple[str, ...]:
    """Note that the payload's body is assumed if the file names none and several are possible."""
    antecedents = {joint.antecedent for joint in robot.joints}
    ends = [joint for joint in robot.joints if joint.has_mass and joint.name not in antecedents]
    if robot.named_tool or robot.platforms or not (robot.closures or len(ends) > 1):
        return ()
    last = [joint.name for joint in robot.joints if joint.has_mass][-1:] == [robot.tool]
    why = "the last link of the robot's file" if last else "which carries the fingers"
    return (
        f"the payload is assumed to be on '{robot.tool}', {why}; if it is on another body, write"
        " 'tool: BODY' in the robot file (gtau robot --save makes one of any robot)",
    )


def massless(robot: Robot, parameters: Iterable[str]) -> tuple[str, ...]:
    """List links and platforms without a mass, moment or inertia in ``parameters``, which are massless."""
    named = {parameter_of(name).body for name in parameters if parameter_of(name).kind in INERTIAL}
    links = [joint.name for joint in robot.joints if joint.has_mass]
    return tuple(body for body in (*links, *(platform.name for platform in robot.platforms)) if body not in named)


def _lengths(robot: Robot) -> Iterator[str]:
    placed: list[tuple[str, Placement]] = [(f"joint '{joint.name}'", joint.placement) for joint in robot.joints]
    placed += [(f"home of platform '{platform.name}'", platform.home) for platform in robot.platforms]
    for number, closure in enumerate(robot.closures, start=1):
        placed += [(f"closure {number} on '{end.body}'", end.placement) for end in (closure.a, closure.b)]
    for spring in robot.springs:
        placed += [(f"spring '{spring.name}' on '{end.body}'", end.placement) for end in (spring.a, spring.b)]
    long = [
        f"{what} is placed {size:.4g} m away"
        for what, place in placed
        if (size := np.linalg.norm(place.position)) > FAR
    ]
    long += [
        f"the position limits of joint '{joint.name}' are {_limits(joint)}"
        for joint in robot.joints
        if not joint.turns and _reach(joint) > FAR
    ]
    if long:
        yield f"{'; '.join(long)}: lengths are in m, so check whether these are mm"


def _angles(robot: Robot) -> Iterator[str]:
    far = [
        f"joint '{joint.name}' ({_limits(joint)})"
        for joint in robot.joints
        # a motor's shaft, before its gear, does turn that often
        if joint.turns and joint.parameters != "drive" and _reach(joint) > TURNS * 2 * pi
    ]
    if far:
        yield (
            f"position limits of many turns: {', '.join(far)}; angles are in rad; if these are degrees, divide them by"
            " 57.2958, or write deg(...) in a robot file"
        )


def _homes(robot: Robot) -> Iterator[str]:
    outside = []
    for joint in robot.joints:
        low, high = joint.limits.position or (-np.inf, np.inf)
        if not low - REACHED <= joint.home <= high + REACHED:
            outside.append(f"joint '{joint.name}' ({joint.home:.4g} {joint.unit}, limits {_limits(joint)})")
    if outside:
        names = ", ".join(outside)
        yield f"home lies outside the position limits of {names}; write a 'home' within them in the robot file"


def _reach(joint: Joint) -> float:
    return max(map(abs, joint.limits.position or (0.0,)))


def _limits(joint: Joint) -> str:
    assert joint.limits.position is not None
    low, high = joint.limits.position
    return f"{low:.4g} to {high:.4g} {joint.unit}"
