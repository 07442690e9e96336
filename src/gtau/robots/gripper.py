"""Detect the fingers of a gripper, which carry no payload by themselves."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping


def palm(carriers: Mapping[str, str], last: str, links: Collection[str], base: Collection[str]) -> str:
    """Find the link that carries the fingers if ``last`` is one of them; else ``last`` itself.

    Fingers are branches of an arm: another has as many joints, or three others are alike as beside a thumb, and none
    has more joints than there are before them. So the arms of a torso, and legs, are none.

    Parameters
    ----------
    carriers : mapping
        Carrier of each joint; every carrier precedes its followers.
    last : str
        A joint.
    links : collection of str
        Joints whose link has a mass.
    base : collection of str
        Joints of a floating base, which do not belong to an arm.
    """
    before: dict[str, tuple[str, ...]] = {}  # from the ground to each joint
    for joint, carrier in carriers.items():
        before[joint] = (*before.get(carrier, ()), joint)
    for depth, carrying in enumerate(before[last][:-1], start=1):
        lengths: dict[str, int] = {}
        for chain in before.values():
            if len(chain) > depth and chain[depth - 1] == carrying:
                lengths[chain[depth]] = max(lengths.get(chain[depth], 0), len(chain) - depth)
        alike = Counter(lengths.values())
        fingers = alike[lengths[before[last][depth]]] > 1 or max(alike.values()) > 2
        if carrying in links and fingers and max(lengths.values()) <= depth - len(base):
            return carrying
    return last
