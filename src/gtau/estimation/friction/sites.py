"""Sites of friction that is identifiable from all samples: candidate columns of presliding and of falling speed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gtau.estimation.friction.law import FrictionLaw
from gtau.estimation.friction.stop import Follower
from gtau.estimation.regression.dataset import Dataset
from gtau.model.loops import Motion
from gtau.robots.parameter import Parameter
from gtau.signals.storage import block, spans

# Widths, of a joint's travel, and speeds, of its rms speed, that are tried. Presliding of real joints was found at 4e-5
# to 1e-3 of the travel (UR10e, TX40, Panda), friction that bends at 0.1 to 1 of the rms speed; simulators smooth the
# sign at 0.003 to 0.03 of it.
WIDTHS = 10.0 ** np.arange(-5.25, -1.99, 0.25)
SPEEDS = 10.0 ** np.arange(-2.5, 0.51, 0.5)
PLAIN = ("off", "fv", "fs")


@dataclass(frozen=True, eq=False)
class Site:
    """A joint whose friction is identified on all samples.

    Attributes
    ----------
    joint : str
        Its name.
    row : int
        Its row among the robot's joints.
    ratios : ndarray
        (n,) Its speed for unit speeds of the actuated joints: constant.
    motor : int, optional
        The motor that alone moves it.
    widths, speeds : ndarray
        Candidates (w,) of presliding, rad or m, and (s,) of v_s, rad/s or m/s.
    rms_speed : float
        Over all runs, rad/s or m/s.
    plain : tuple of str
        Kinds of friction of it that are base parameters: ``off``, ``fv``, ``fs``.
    warm : bool
        Whether its temperature is logged.
    """

    joint: str
    row: int
    ratios: np.ndarray
    motor: int | None
    widths: np.ndarray
    speeds: np.ndarray
    rms_speed: float
    plain: tuple[str, ...]
    warm: bool

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Columns: those of the plain law, then of each state z (sliding, and each width) times what weighs it."""
        weighed = ["1", *(f"s{k}" for k in range(len(self.speeds))), "fl", "fst"]
        states = [f"{each}:{what}" for each in range(len(self.widths) + 1) for what in weighed]
        return ("off", "fv", "fvt", *states)

    def columns(self, v: np.ndarray, z: np.ndarray, load: np.ndarray | float, above: np.ndarray | float) -> np.ndarray:
        """Build the columns (., N) from speeds (N,), states (w + 1, N), torques transmitted and temperatures (N,)."""
        falling = np.exp(-np.abs(v) / self.speeds[:, None])
        weighed = np.stack([np.ones_like(v), *falling, np.abs(load) + 0 * v, above + 0 * v])
        return np.concatenate(
            [np.stack([np.ones_like(v), v, above * v]), (z[:, None] * weighed).reshape(-1, v.shape[0])]
        )


def sites_of(dataset: Dataset, law: FrictionLaw) -> tuple[Site, ...]:
    """List the joints with friction that moves with the motors at constant ratios."""
    model, standard = dataset.model, dataset.base.standard
    lowest, highest, squares, samples = [], [], np.zeros((len(model.actuated),) * 2), 0
    for each in dataset.prepared:
        position, kept = each.run.position, each.kept
        parts = [block(position, kept.start + a, kept.start + b) @ law.ratios.T for a, b in spans(len(kept))]
        lowest.append(np.min([part.min(axis=0) for part in parts], axis=0))
        highest.append(np.max([part.max(axis=0) for part in parts], axis=0))
        squares, samples = squares + each.speeds * len(each), samples + len(each)
    travel = np.max(np.array(highest) - np.array(lowest), axis=0)
    rms = np.sqrt(np.einsum("ki,ij,kj->k", law.ratios, squares / samples, law.ratios))
    warm = dataset.temperatures
    sites = []
    for row, joint in enumerate(model.robot.joints):
        plain = tuple(kind for kind in PLAIN if Parameter(kind, joint.name).name in standard)
        if not {"fv", "fs"} & set(plain) or not travel[row] or not rms[row]:
            continue
        motor = law.motor(row)
        heated = warm is not None and motor is not None and model.actuated[motor] in warm.reference
        sites.append(
            Site(joint.name, row, law.ratios[row], motor, travel[row] * WIDTHS, rms[row] * SPEEDS, float(rms[row]),
                 plain, heated)
        )  # fmt: skip
    return tuple(sites)


class Columns:
    """Columns of sites along a run that is read in blocks."""

    def __init__(self, sites: Sequence[Site], dataset: Dataset, run: int) -> None:
        self._sites, self._dataset, self._run = sites, dataset, run
        self._followers = [Follower(site.widths) for site in sites]

    def __call__(self, time: np.ndarray, motion: Motion, effort: np.ndarray) -> np.ndarray:
        """Build the columns (., N) of all sites, and then their |speeds| (sites, N), at a block of samples."""
        q, found, speeds = self._dataset.prepared[self._run].path(time), [], []
        for site, follow in zip(self._sites, self._followers, strict=True):
            v = motion.yd[site.row]
            load = 0.0 if site.motor is None else effort[site.motor] / site.ratios[site.motor]
            z = np.vstack([np.sign(v), follow(time, site.ratios @ q)])
            found.append(site.columns(v, z, load, self._above(site, time)))
            speeds.append(np.abs(v))
        return np.vstack([*found, speeds])

    def _above(self, site: Site, time: np.ndarray) -> np.ndarray | float:
        warm, run = self._dataset.temperatures, self._dataset.runs[self._run]
        if warm is None or not site.warm or run.temperature is None or site.motor is None:
            return 0.0
        joint = self._dataset.model.actuated[site.motor]
        return run.temperature.at(joint, time) - warm.reference[joint]


def groups_of(sites: Sequence[Site]) -> list[tuple[list[int], list[int]]]:
    """Split sites into those that share motors: their numbers, and the motors' numbers."""
    from scipy.sparse.csgraph import connected_components

    if not sites:
        return []
    driven = np.array([site.ratios != 0 for site in sites]).astype(int)
    count, label = connected_components(driven @ driven.T, directed=False)
    found = []
    for group in range(count):
        members = np.flatnonzero(label == group)
        found.append((members.tolist(), np.flatnonzero(driven[members].any(axis=0)).tolist()))
    return found
