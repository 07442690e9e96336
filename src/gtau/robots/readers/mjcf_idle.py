"""Joints of an MJCF file that no motor moves: of scenery, of bases that roll, and of grippers that tendons pull."""

from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Set as AbstractSet

from gtau.robots.robot import GROUND, Robot


def scenery(robot: Robot) -> set[str]:
    """List the joints of doors, targets and the like: of trees from the ground in which no motor moves anything."""
    moved = _moved(robot)
    found: set[str] = set()
    for tree in _trees(robot):
        if tree.isdisjoint(moved):
            found |= tree
    return found


def moving_base(robot: Robot) -> set[str]:
    """List unactuated joints that carry all actuated ones of their tree: those of a base that rolls or slides."""
    before, moved, found = _carrying(robot), _moved(robot), set()
    for tree in _trees(robot):
        if carried := [before[name] for name in tree & moved]:
            found |= set.intersection(*carried) - moved - {GROUND}
    return found


def with_linkages(robot: Robot, pulled: AbstractSet[str]) -> set[str]:
    """List the joints that tendons pull, and those of their loops, where no motor moves them."""
    found = set(pulled)
    for group in _groups(robot):
        if not group.isdisjoint(pulled) and group.isdisjoint(robot.actuated):
            found |= group
    return found & {joint.name for joint in robot.joints}


def _carrying(robot: Robot) -> dict[str, set[str]]:
    """List the joints, and the ground, that carry each joint."""
    before: dict[str, set[str]] = {GROUND: set()}
    for joint in robot.joints:
        before[joint.name] = before[joint.antecedent] | {joint.antecedent}
    return before


def _trees(robot: Robot) -> Iterator[set[str]]:
    """Group the joints by the trees that stand on the ground."""
    before = _carrying(robot)
    for root in (joint.name for joint in robot.joints if joint.antecedent == GROUND):
        yield {root} | {name for name, carriers in before.items() if root in carriers}


def _moved(robot: Robot) -> set[str]:
    """List the joints with motors, and those that loops and couplings tie to them."""
    found = set(robot.actuated)
    for group in _groups(robot):
        if not group.isdisjoint(robot.actuated):
            found |= group
    return found


def _groups(robot: Robot) -> list[set[str]]:
    """Group the joints (and platforms) that loops and couplings tie to each other."""
    before = _carrying(robot) | {platform.name: {platform.name} for platform in robot.platforms}
    ties = [{coupling.joint, *dict(coupling.ratios)} for coupling in robot.couplings]
    for closure in robot.closures:
        a, b = (before[end.body] | {end.body} for end in (closure.a, closure.b))
        ties.append((a ^ b) - {GROUND})
    groups: list[set[str]] = []
    for tie in ties:
        apart = [group for group in groups if group.isdisjoint(tie)]
        groups = [*apart, tie.union(*(group for group in groups if not group.isdisjoint(tie)))]
    return groups
