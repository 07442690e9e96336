"""Friction beyond the paper's: further terms of an actuated joint, and drift between runs.

The paper's friction, viscous and Coulomb, is among the standard parameters of the model. Two more
terms are candidates for every actuated joint, and selected if its own equations support them:

- ``f3``: cubic in speed, ``f3 qd^3``;
- ``fl``: proportional to the torque that the joint transmits, ``fl |tau_load| sign(qd)``.

Where temperatures of the joints are logged, two more are:

- ``fvt``, ``fst``: viscous and Coulomb friction per degree above the mean temperature, ``fvt (T - T_mean) qd`` and
  ``fst (T - T_mean) sign(qd)``. Temperature changes so slowly that its mean over a block, a twentieth of a run,
  replaces it there: these columns are then those of viscous and Coulomb friction in each block, times a number,
  and nothing has to be streamed again for them.

The bearing of a joint's torque sensor may have friction of its own, viscous and Coulomb (``fv_2_sensor``).

Warm-up makes friction drift between runs by per cents, which is invisible in a single run and ruins the
drive gains; so viscous and Coulomb friction may have different values in every run.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.regression.equations import BLOCKS
from gtau.robots.parameter import Parameter
from gtau.robots.robot import PLAIN_FRICTION
from gtau.signals.preparation.prepared_run import PreparedRun

TERMS = ("f3", "fl")
TEMPERATURE_TERMS = {"fvt": "fv", "fst": "fs"}
DRIFTING = ("fv", "fs")
BEARING = ("fv", "fs")
UNITS = {
    "revolute": {"f3": "N m s3/rad3", "fl": "1", "fvt": "N m s/rad", "fst": "N m"},
    "prismatic": {"f3": "N s3/m3", "fl": "1", "fvt": "N s/m", "fst": "N"},
}
"""Units of the terms; those of ``fvt`` and ``fst`` per unit of the temperature."""

INSTANTS = 50  # of a block, over which the mean is taken


def term_columns(qd: np.ndarray, effort: np.ndarray) -> np.ndarray:
    """Build the columns of the terms, (2, n, N), from speeds and transmitted torques (n, N)."""
    return np.stack([qd * qd * qd, np.abs(effort) * np.sign(qd)])  # a power would take ten times as long


def all_terms(joints: Sequence[str], terms: Iterable[str] = TERMS) -> tuple[Parameter, ...]:
    """List every one of the ``terms`` of every joint, or torque sensor."""
    return tuple(Parameter(term, joint) for joint in joints for term in terms)


def is_transmitted(names: Sequence[Parameter]) -> np.ndarray:
    """Mark the base parameters whose torque a joint transmits by 1, friction and offsets by 0, (n_b,)."""
    return np.array([name.kind not in PLAIN_FRICTION for name in names], dtype=float)


@dataclass(frozen=True, eq=False)
class Temperatures:
    """Mean temperatures of joints over all runs, in ``unit``, and differences from them.

    ``reference`` are the means by joint, ``of_blocks`` the differences (blocks, n) in each run; those of joints
    without a temperature are zero. ``prepared`` are the runs.
    """

    reference: dict[str, float]
    of_blocks: tuple[np.ndarray, ...]
    unit: str
    prepared: tuple[PreparedRun, ...]

    def between(self, run: int, begin: float, end: float) -> np.ndarray:
        """Average the differences (n,) between two instants of a run."""
        of, time = self.prepared[run].run, np.linspace(begin, end, INSTANTS)
        assert of.temperature is not None  # all runs have one
        means = {joint: of.temperature.at(joint, time).mean() - mean for joint, mean in self.reference.items()}
        return np.array([means.get(joint, 0.0) for joint in of.joints])


def temperatures_of(prepared: Sequence[PreparedRun], edges: Sequence[np.ndarray]) -> Temperatures | None:
    """Compute the differences in all runs, with the ``edges`` of their blocks; None without temperatures.

    Raises GtauError.
    """
    found = [each.run.temperature for each in prepared]
    logged = [each for each in found if each is not None]
    if not logged:
        return None
    if len(logged) < len(found):
        lacking = next(each.run.name for each in prepared if each.run.temperature is None)
        raise GtauError(f"run '{lacking}' has no temperature, but other runs have; log it in all runs, or in none.")
    joints, means = prepared[0].run.joints, []
    known = [joint for joint in joints if all(joint in each.of_joint for each in logged)]
    for each, temperature, cut in zip(prepared, logged, edges, strict=True):
        share = np.interp(np.linspace(0, BLOCKS, BLOCKS * INSTANTS), np.arange(BLOCKS + 1), cut)
        time = each.time[0] + share * (each.time[-1] - each.time[0])
        along = [temperature.at(joint, time).reshape(BLOCKS, INSTANTS).mean(axis=1) for joint in known]
        means.append(np.reshape(along, (len(known), BLOCKS)).T)
    reference = np.mean(np.concatenate(means), axis=0)
    differences = np.zeros((len(prepared), BLOCKS, len(joints)))
    differences[..., [joints.index(joint) for joint in known]] = np.array(means) - reference
    by_joint = dict(zip(known, map(float, reference), strict=True))
    return Temperatures(by_joint, tuple(differences), logged[0].unit, tuple(prepared))
