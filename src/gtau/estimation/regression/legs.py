"""Legs of the same geometry."""

from __future__ import annotations

import numpy as np

from gtau.robots.robot import GROUND, Placement, Robot

SAME = 9  # decimals, of lengths in m and of directions


def legs(robot: Robot) -> list[tuple[str, ...]]:
    """List the joints of every chain or tree that starts at the ground, or at a base that floats, in order."""
    root: dict[str, str] = {}
    found: dict[str, list[str]] = {}
    for joint in robot.joints:
        root[joint.name] = joint.name if joint.antecedent in (GROUND, robot.floating) else root[joint.antecedent]
        found.setdefault(root[joint.name], []).append(joint.name)
    return [tuple(names) for names in found.values()]


def identical_legs(robot: Robot) -> list[list[tuple[str, ...]]]:
    """Group legs by their geometry, each seen in the frame of its own first link.

    Legs are alike whose joints have the same kinds, axes, parameters and placements, and are tied by the same closures
    and springs at the same places. Where a leg stands, its home and its limits do not count.
    """
    groups: dict[tuple, list[tuple[str, ...]]] = {}
    for leg in legs(robot):
        joints = [robot.joint(name) for name in leg]
        tree = tuple(
            (
                joint.kind,
                joint.actuated,
                joint.parameters,
                joint.spring,
                _numbers(np.array(joint.axis)),
                leg.index(joint.antecedent) if k else -1,
                _placement(joint.placement) if k else (),
            )
            for k, joint in enumerate(joints)
        )
        ends = ((closure.kind, end) for closure in robot.closures for end in (closure.a, closure.b) if end.body in leg)
        tied = sorted((kind, leg.index(end.body), _placement(end.placement)) for kind, end in ends)
        coupled = sorted(
            (name == coupling.joint, leg.index(name), ratio)
            for coupling in robot.couplings
            for name, ratio in ((coupling.joint, 1.0), *coupling.ratios)
            if name in leg
        )
        sprung = sorted(
            (spring.parameters, leg.index(end.body), _placement(end.placement))
            for spring in robot.springs
            for end in (spring.a, spring.b)
            if end.body in leg
        )
        groups.setdefault((tree, tuple(tied), tuple(coupled), tuple(sprung)), []).append(leg)
    return list(groups.values())


def _placement(placement: Placement) -> tuple[float, ...]:
    return _numbers(placement.rotation) + _numbers(placement.position)


def _numbers(array: np.ndarray) -> tuple[float, ...]:
    return tuple((np.round(array, SAME) + 0.0).ravel().tolist())
