"""Which friction a group of joints shows: structures are tried, and taken where they help blocks that are left out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from gtau.estimation.friction.normal_equations import Group
from gtau.estimation.friction.sites import Site
from gtau.estimation.thresholds.friction import TERM_SHARE, TERM_T

FEWEST_BLOCKS = 6
KINDS = ("width", "speed", "load", "warm")
WORDS = {"width": "presliding", "speed": "bent", "load": "load", "warm": "temperature"}


@dataclass(frozen=True)
class Structure:
    """What the friction of a joint consists of: numbers of a width and of a speed, None for none; load; temperature.

    ``gradual`` presliding has all widths at once; no friction has it in the end, but terms are to pay beyond it.
    """

    width: int | None = None
    gradual: bool = False
    speed: int | None = None
    load: bool = False
    warm: bool = False

    def options(self, site: Site, kind: str) -> Iterator[Structure]:
        """List structures with another value of a kind, present or not."""
        if kind == "width":
            yield from (replace(self, width=k) for k in range(len(site.widths)))
        elif kind == "speed":
            yield from (replace(self, speed=k) for k in range(len(site.speeds)))
        elif kind == "load" and site.motor is not None:
            yield replace(self, load=True)
        elif kind == "warm" and site.warm:
            yield replace(self, warm=True)

    def has(self, kind: str) -> bool:
        """Whether it has something of a kind."""
        return getattr(self, kind) not in (None, False)

    def columns(self, site: Site) -> dict[str, dict[str, float]]:
        """Combine the site's columns to those of its parameters, of which all but some are not negative.

        ``fr`` is friction at rest, ``fs + fb``.
        """
        z = 0 if self.width is None else self.width + 1
        made: dict[str, dict[str, float]] = {}
        if "off" in site.plain:
            made["off"] = {"off": 1.0}
        if "fv" in site.plain:
            made["fv"] = {"fv": 1.0}
        if "fs" in site.plain:
            made["fs"] = {f"{z}:1": 1.0}
            if self.speed is not None:
                made["fr"] = {f"{z}:s{self.speed}": 1.0}
                made["fs"] |= {f"{z}:s{self.speed}": -1.0}
            if self.gradual:
                made |= {f"z{k}": {f"{k}:1": 1.0} for k in range(1, len(site.widths) + 1) if k != z}
            if self.load:
                made["fl"] = {f"{z}:fl": 1.0}
        if self.warm:
            made |= {"fvt": {"fvt": 1.0}, "fst": {f"{z}:fst": 1.0}}
        return made


FREE = ("off", "fvt", "fst")
"""Parameters of either sign."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A fit of a group by a structure for each site.

    ``names`` (site, kind) of the parameters that are not zero, ``x`` (k,) their values, ``left`` (K, k) those without
    each block, ``errors`` (K, m) the squared errors of each block and motor by the fit to all others; ``M`` (p, k)
    maps parameters to columns.
    """

    structures: tuple[Structure, ...]
    names: tuple[tuple[int, str], ...]
    x: np.ndarray
    left: np.ndarray
    errors: np.ndarray
    M: np.ndarray


@dataclass(frozen=True, eq=False)
class Chosen:
    """The trial that is taken, the plain one, and what each taken term gained, in standard errors, by (site, kind)."""

    trial: Trial
    plain: Trial
    evidence: dict[tuple[int, str], float] = field(default_factory=dict)


def attempt(group: Group, structures: tuple[Structure, ...]) -> Trial:
    """Fit a group by these structures, and without each block; parameters that would be negative are left at zero."""
    from scipy.optimize import nnls

    place = {column: k for k, column in enumerate(group.columns)}
    listed = [
        ((s, kind), made)
        for s, (structure, site) in enumerate(zip(structures, group.sites, strict=True))
        for kind, made in structure.columns(site).items()
    ]
    M = np.zeros((len(group.columns), len(listed)))
    for k, ((s, _), made) in enumerate(listed):
        for column, factor in made.items():
            M[place[s, column], k] = factor
    used = np.append(np.flatnonzero(M.any(axis=1)), len(M))  # a few of very many columns
    T = np.zeros((len(used), M.shape[1] + 1))
    T[:-1, :-1], T[-1, -1] = M[used[:-1]], 1.0
    G = T.T @ group.G[:, :, used[:, None], used] @ T
    whole = G.sum(axis=(0, 1))
    size = np.sqrt(np.maximum(np.diag(whole)[:-1], 1e-300))
    A, c = whole[:-1, :-1] / size / size[:, None], whole[:-1, -1] / size
    # the singular value decomposition of a factor, which the products alone do not need to be of full rank for
    values, vectors = np.linalg.eigh(A)
    kept = values > 1e-9 * values[-1]
    R = np.sqrt(values[kept])[:, None] * vectors[:, kept].T
    d = (vectors[:, kept].T @ c) / np.sqrt(values[kept])
    free = [k for k, ((_, kind), _) in enumerate(listed) if kind in FREE]
    found = nnls(np.hstack([R, -R[:, free]]), d)[0]
    active = (found[: len(listed)] > 0) | np.isin(np.arange(len(listed)), free)
    index = np.append(np.flatnonzero(active), len(listed))
    G = G[..., index[:, None], index]
    scale = np.append(size[active], 1.0)
    G = G / scale / scale[:, None]
    k = len(index) - 1
    whole = G.sum(axis=(0, 1))
    left = _solved(whole - G.sum(axis=1), k)
    x = _solved(whole[None], k)[0]
    error = np.hstack([-left, np.ones((len(left), 1))])
    errors = np.einsum("bp,bmpq,bq->bm", error, G, error)
    names = tuple(listed[a][0] for a in np.flatnonzero(active))
    return Trial(structures, names, x / size[active], left / size[active], errors, M[:, active])


def _solved(G: np.ndarray, k: int) -> np.ndarray:
    ridge = 1e-9 * np.eye(k) * np.trace(G[:, :k, :k], axis1=1, axis2=2)[:, None, None] / max(k, 1)
    return np.linalg.solve(G[:, :k, :k] + ridge, G[:, :k, k, None])[..., 0]


def gained(before: Trial, after: Trial) -> tuple[float, float]:
    """Compute by how much a trial is better on blocks left out: in standard errors, and as a share of the error.

    Reversals are few, and the squared errors of blocks so unequal that a mean of theirs has hardly a standard error.
    The difference of each block and motor counts in units of the errors there, with the mean added, which bounds it.
    """
    difference = before.errors - after.errors
    relative = difference / (before.errors + after.errors + before.errors.mean(axis=0))
    spread = np.std(relative, ddof=1) * np.sqrt(relative.size)
    share = difference.sum() / max(before.errors.sum(), 1e-300)
    return float(relative.sum() / max(spread, 1e-300)), float(share)


def choose(group: Group) -> Chosen:
    """Add one term after another as long as blocks that are left out gain by it.

    A term enters where it takes the squared error of blocks left out down by a share that the eye sees and by more
    standard errors, over the blocks, than the best of many widths and speeds does by chance.
    """
    plain = attempt(group, tuple(Structure() for _ in group.sites))
    best = plain
    evidence: dict[tuple[int, str], float] = {}
    if len(group.G) < FEWEST_BLOCKS:
        return Chosen(best, plain)
    while True:
        offers = []
        for s, kind in ((s, kind) for s in range(len(group.sites)) for kind in KINDS):
            if not best.structures[s].has(kind):
                trials = _with(group, best, s, kind)
                if trials:
                    least = min(trials, key=lambda trial: trial.errors.sum())
                    t, share = gained(best, least)
                    if t > TERM_T and share > TERM_SHARE and (kind != "speed" or _beyond(group, least, s)):
                        offers.append((share, t, (s, kind), least))
        if not offers:
            return Chosen(best, plain, evidence)
        _, t, key, best = max(offers, key=lambda offer: offer[0])
        evidence[key] = t
        best = _refined(group, best)


def _beyond(group: Group, after: Trial, s: int) -> bool:
    """Whether friction that bends with the speed pays beyond any presliding.

    Presliding of real joints, of LuGre's and of generalized Maxwell slip, turns into sliding gradually, while the joint
    is slow still. One stop turns at once, and friction that bends below a hundredth of the rms speed made up for it.
    """

    def gradual(speed: int | None) -> Trial:
        of_site = replace(after.structures[s], speed=speed, gradual=True)
        return attempt(group, (*after.structures[:s], of_site, *after.structures[s + 1 :]))

    t, share = gained(gradual(None), gradual(after.structures[s].speed))
    return t > TERM_T and share > TERM_SHARE


def _with(group: Group, trial: Trial, s: int, kind: str) -> list[Trial]:
    own, others = trial.structures[s], trial.structures
    return [attempt(group, (*others[:s], option, *others[s + 1 :])) for option in own.options(group.sites[s], kind)]


def _refined(group: Group, trial: Trial) -> Trial:
    """Choose widths and speeds again, now that others are there."""
    for s, kind in ((s, kind) for s in range(len(group.sites)) for kind in ("width", "speed")):
        if trial.structures[s].has(kind):
            trial = min([trial, *_with(group, trial, s, kind)], key=lambda each: float(each.errors.sum()))
    return trial


def spread_of_shape(group: Group, trial: Trial, s: int, kind: str) -> float:
    """Compute the standard deviation of the logarithm of a width or speed: jackknife of the best over the grid.

    The grid itself is uniform over a step.
    """
    options = _with(group, trial, s, kind)
    grid = np.log(group.sites[s].widths if kind == "width" else group.sites[s].speeds)
    errors = np.array([each.errors.sum(axis=1) for each in options])  # (options, K)
    without = errors.sum(axis=1)[:, None] - errors
    best = np.array([_lowest(grid, column) for column in without.T])
    blocks, step = len(best), grid[1] - grid[0]
    return float(np.sqrt((blocks - 1) / blocks * ((best - best.mean()) ** 2).sum() + step**2 / 12))


def _lowest(grid: np.ndarray, errors: np.ndarray) -> float:
    """Find the minimum of the parabola through the least error and its neighbours."""
    k = int(np.argmin(errors))
    if k in (0, len(grid) - 1):
        return float(grid[k])
    low, mid, high = errors[k - 1 : k + 2]
    bend = low - 2 * mid + high
    return float(grid[k] + (grid[1] - grid[0]) * (low - high) / (2 * bend) if bend > 0 else grid[k])
