"""Legs of the same geometry, and whether they came out alike."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gtau.robots.robot import GROUND, Placement, Robot

if TYPE_CHECKING:
    from gtau.estimation.regression.base_parameters import BaseParameters

SAME = 9  # decimals, of lengths in m and of directions


@dataclass(frozen=True)
class LegDifference:
    """How far a leg's identified parameters are from the mean of the legs of the same geometry.

    Attributes
    ----------
    leg : tuple of str
        Names of its joints.
    others : tuple of tuple of str
        The legs that it is compared with.
    compared : tuple of str
        Names of its parameters that have counterparts of the same regrouping in all these legs.
    deviations : ndarray
        (compared,): differences from the mean of the others, in standard deviations of the difference.
    relative : ndarray
        (compared,): the same differences in per cent of the mean of the others.
    distance : float
        All differences together, in joint standard deviations (Mahalanobis).
    probability : float
        That legs which are alike differ by as much or more.
    """

    leg: tuple[str, ...]
    others: tuple[tuple[str, ...], ...]
    compared: tuple[str, ...]
    deviations: np.ndarray
    relative: np.ndarray
    distance: float
    probability: float

    @property
    def worst(self) -> tuple[str, float]:
        """The parameter that differs most, and by how many standard deviations."""
        k = int(np.abs(self.deviations).argmax())
        return self.compared[k], float(self.deviations[k])


def legs(robot: Robot) -> list[tuple[str, ...]]:
    """The joints of every chain or tree that starts at the ground, in order."""
    root: dict[str, str] = {}
    found: dict[str, list[str]] = {}
    for joint in robot.joints:
        root[joint.name] = joint.name if joint.antecedent == GROUND else root[joint.antecedent]
        found.setdefault(root[joint.name], []).append(joint.name)
    return [tuple(names) for names in found.values()]


def identical_legs(robot: Robot) -> list[list[tuple[str, ...]]]:
    """Legs grouped by their geometry, each seen in the frame of its own first link.

    Legs are alike whose joints have the same kinds, axes, parameters and placements, and are tied by the same closures
    at the same places. Where a leg stands, its home and its limits do not count.
    """
    groups: dict[tuple, list[tuple[str, ...]]] = {}
    for leg in legs(robot):
        joints = [robot.joint(name) for name in leg]
        tree = tuple(
            (
                joint.kind,
                joint.actuated,
                joint.parameters,
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
        groups.setdefault((tree, tuple(tied), tuple(coupled)), []).append(leg)
    return list(groups.values())


def leg_differences(
    robot: Robot,
    base: BaseParameters,
    names: Sequence[str],
    parameters: np.ndarray,
    covariance: np.ndarray,
) -> list[LegDifference]:
    """Compare every leg's identified parameters with those of the legs of the same geometry.

    Parameters
    ----------
    robot : Robot
    base : BaseParameters
        Of the robot: only parameters that regroup the same standard ones, leg by leg, are compared.
    names : sequence of str
        Base parameters that were identified, all or the essential ones.
    parameters : ndarray
        Their values, (len(names),).
    covariance : ndarray
        (len(names), len(names)).

    Returns
    -------
    list of LegDifference
        One for each leg that has like ones (of two like legs only the first), in the order of the robot; empty for a
        robot without like legs.
    """
    from scipy.stats import chi2

    found = []
    for group in identical_legs(robot):
        if len(group) < 2:
            continue
        tables = [_by_meaning(leg, base, names) for leg in group]
        shared = [meaning for meaning in tables[0] if all(meaning in table for table in tables)]
        if not shared:
            continue
        for k in range(len(group) if len(group) > 2 else 1):
            contrast = np.zeros((len(shared), len(names)))
            for row, meaning in enumerate(shared):
                for j, table in enumerate(tables):
                    contrast[row, table[meaning]] = 1.0 if j == k else -1.0 / (len(group) - 1)
            difference, spread = contrast @ parameters, contrast @ covariance @ contrast.T
            others = np.minimum(contrast, 0.0) @ parameters
            std = np.sqrt(np.diag(spread))
            deviations = difference / std
            correlation = spread / np.outer(std, std)
            square = float(deviations @ np.linalg.pinv(correlation, rcond=1e-10, hermitian=True) @ deviations)
            rank = int(np.linalg.matrix_rank(correlation, tol=1e-10, hermitian=True))
            found.append(
                LegDifference(
                    group[k],
                    tuple(leg for j, leg in enumerate(group) if j != k),
                    tuple(names[tables[k][meaning]] for meaning in shared),
                    deviations,
                    100 * np.abs(np.divide(difference, others, out=np.full(len(shared), np.inf), where=others != 0)),
                    float(np.sqrt(square)),
                    float(chi2.sf(square, rank)),
                )
            )
    return found


def _by_meaning(leg: tuple[str, ...], base: BaseParameters, names: Sequence[str]) -> dict[str, int]:
    """Positions in ``names`` of a leg's parameters, by what they regroup, joints counted from the leg's first."""
    found = {}
    for position, name in enumerate(names):
        words = base.regroupings[name].split()
        if words[0].split("_", 1)[1] in leg:
            found[" ".join(_in_leg(word, leg) for word in words)] = position
    return found


def _in_leg(word: str, leg: tuple[str, ...]) -> str:
    kind, _, joint = word.partition("_")
    return f"{kind}_[{leg.index(joint)}]" if joint in leg else re.sub(r"^(\d+\.\d{3})\d*$", r"\1", word)


def _placement(placement: Placement) -> tuple[float, ...]:
    return _numbers(placement.rotation) + _numbers(placement.position)


def _numbers(array: np.ndarray) -> tuple[float, ...]:
    return tuple((np.round(array, SAME) + 0.0).ravel().tolist())
