"""Candidate torques that have the same effect, whatever their causes: they count once.

The data determine only the sum of the sizes of such candidates, which would enter the intervals once for each of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gtau.estimation.diagnostics.linearisation import LinearisedWindow
from gtau.estimation.thresholds.refutation import SAME_EFFECT


@dataclass(frozen=True)
class Tried:
    """A candidate: its ``column`` in the windows, and the number of its ``joint``, or None where it acts on all joints.

    ``plausible`` is the standard deviation of the sizes that experience allows. Only candidates which contradict the
    ``description``, or only those which do not, can stand for each other.
    """

    column: int
    joint: int | None
    plausible: float
    description: bool


def same_effects(tried: Sequence[Tried], windows: Sequence[LinearisedWindow]) -> list[list[int]]:
    """Group candidates whose torques are proportional to each other, those without effect each by itself.

    Parameters
    ----------
    tried : sequence of Tried
        All candidates.
    windows : sequence of LinearisedWindow
        Their columns.

    Returns
    -------
    list of list of int
        Positions in ``tried``, those with the largest plausible effect first.
    """
    products = np.sum([np.einsum("jpm,jpn->jmn", each.offered, each.offered) for each in windows], axis=0)
    of_all = products.sum(axis=0)

    def product(one: Tried, other: Tried) -> float:
        return float((of_all if one.joint is None else products[one.joint])[one.column, other.column])

    def same(one: Tried, other: Tried) -> bool:
        if (one.joint, one.description) != (other.joint, other.description):
            return False
        squares = product(one, one) * product(other, other)
        return squares > 0 and 1 - product(one, other) ** 2 / squares < SAME_EFFECT

    groups: list[list[int]] = []
    for k in sorted(range(len(tried)), key=lambda k: -product(tried[k], tried[k]) * tried[k].plausible ** 2):
        group = next((each for each in groups if same(tried[each[0]], tried[k])), None)
        if group is None:
            groups.append([k])
        else:
            group.append(k)
    return groups
