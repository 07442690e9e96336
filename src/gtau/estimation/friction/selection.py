"""Structures of a joint's friction on all samples, and their selection by the errors on left-out blocks."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from gtau.estimation.friction.normal_equations import SMOOTH, WEIGHTS, WIDTHS, FrictionGroup, FrictionJoint

ROUNDING = 1e-9  # of the way to the next width or speed tried
FREE = ("off", "fvt", "fst")  # parameters of either sign
# terms that the selection tries, and their words
WORDS = {"width": "presliding", "speed": "bent", "load": "load", "temperature": "temperature"}
SHAPE_OF = {"width": "width", "speed": "vs"}  # terms with a value, and the parameters that hold these values
TERM_T = 2.5  # standard errors, over blocks left out, by which friction with a term is better
TERM_SHARE = 0.05  # share of the squared error of blocks left out that a term of friction takes away
FEWEST_BLOCKS = 6
STEPS = 6
SLOW = 0.05  # of the rms speed, up to which bending may be gradual presliding
TILT = 0.01  # of the way to the next width or speed tried, for derivatives


@dataclass(frozen=True)
class Structure:
    """What a joint's friction has beyond the plain law.

    Presliding of a ``width``, rad or m, a bend at a ``speed``, rad/s or m/s, and dependence on the ``load`` and on the
    ``temperature``. The column of a width or speed between two tried values is interpolated. ``gradual`` presliding has
    all widths at once; no result has it, but a bend must improve the fit beyond it.
    """

    width: float | None = None
    speed: float | None = None
    load: bool = False
    temperature: bool = False
    gradual: bool = False

    def changed(self, term: str, value: Any) -> Structure:
        """Return the structure with another value of a term."""
        return replace(self, **{term: value})


def parameter_columns(structure: Structure, joint: FrictionJoint) -> dict[str, np.ndarray]:
    """Combine a joint's columns (p,) for each parameter of a structure; ``fr`` is friction at rest, ``fs + fb``."""
    z = np.eye(1 + len(WIDTHS))[0]
    weights = dict(zip(WEIGHTS, np.eye(len(WEIGHTS)), strict=True))
    if structure.width is not None:
        z = np.append(0.0, shares(structure.width, joint.widths))

    def sliding(weight: np.ndarray, direction: np.ndarray = z) -> np.ndarray:
        return np.concatenate([np.zeros(len(SMOOTH)), np.outer(direction, weight).ravel()])

    alone = dict(zip(SMOOTH, np.eye(len(SMOOTH), joint.count), strict=True))
    columns: dict[str, np.ndarray] = {kind: alone[kind] for kind in ("off", "fv") if kind in joint.plain}
    if "fs" in joint.plain:
        columns["fs"] = sliding(weights["fs"])
        if structure.speed is not None:
            bend = np.zeros(len(WEIGHTS))
            bend[[weight == "fb" for weight in WEIGHTS]] = shares(structure.speed, joint.speeds)
            columns["fr"] = sliding(bend)
            columns["fs"] = columns["fs"] - columns["fr"]
        if structure.gradual:
            states = np.eye(1 + len(WIDTHS))
            columns |= {f"z{k}": sliding(weights["fs"], states[k]) for k in range(1, len(states)) if not z[k]}
        if structure.load:
            columns["fl"] = sliding(weights["fl"])
    if structure.temperature:
        columns |= {"fvt": alone["fvt"], "fst": sliding(weights["fst"])}
    return columns


def place(value: float, tried: np.ndarray) -> float:
    """Return the position of a width or speed among tried values of constant ratio; whole at a tried value."""
    number = float(np.log(value / tried[0]) / np.log(tried[1] / tried[0]))
    return float(round(number)) if abs(number - round(number)) < ROUNDING else number


def shares(value: float, tried: np.ndarray) -> np.ndarray:
    """Interpolate between tried values by a cubic through four (``exp(-|v| / v_s)``: off by at most 0.02)."""
    number, made = place(value, tried), np.zeros(len(tried))
    if number == round(number):
        made[int(number)] = 1.0
        return made
    begin = min(max(int(number) - 1, 0), len(tried) - 4)
    nodes = range(begin, begin + 4)
    for k in nodes:
        made[k] = np.prod([(number - other) / (k - other) for other in nodes if other != k])
    return made


@dataclass(frozen=True, eq=False)
class FrictionFit:
    """A fit of a group by a structure for each joint.

    ``names`` (joint, kind) of the parameters that are not zero, ``x`` (k,) their values, ``replicates`` (K, k) those
    without each block, ``errors`` (K, m) the squared errors of each block and motor by the fit to all others; ``M``
    (p, k) maps parameters to columns.
    """

    structures: tuple[Structure, ...]
    names: tuple[tuple[int, str], ...]
    x: np.ndarray
    replicates: np.ndarray
    errors: np.ndarray
    M: np.ndarray


def fit(group: FrictionGroup, structures: tuple[Structure, ...]) -> FrictionFit:
    """Fit a group by these structures, also without each block; parameters that would be negative stay at zero."""
    from scipy.optimize import nnls

    listed, M = columns_of(group, structures)
    G = reduced(group, M)
    total = G.sum(axis=(0, 1))
    size = np.sqrt(np.maximum(np.diag(total)[:-1], 1e-300))
    A, c = total[:-1, :-1] / size / size[:, None], total[:-1, -1] / size
    # the singular value decomposition of a factor, which the products alone do not need to be of full rank for
    values, vectors = np.linalg.eigh(A)
    kept = values > 1e-9 * values[-1]
    R = np.sqrt(values[kept])[:, None] * vectors[:, kept].T
    d = (vectors[:, kept].T @ c) / np.sqrt(values[kept])
    free = [k for k, (_, kind) in enumerate(listed) if kind in FREE]
    positive = nnls(np.hstack([R, -R[:, free]]), d)[0][: len(listed)] > 0
    active = positive | np.isin(np.arange(len(listed)), free)
    index = np.append(np.flatnonzero(active), len(listed))
    x, replicates, errors = left_out(G[..., index[:, None], index])
    names = tuple(listed[a] for a in np.flatnonzero(active))
    return FrictionFit(structures, names, x, replicates, errors, M[:, active])


def columns_of(group: FrictionGroup, structures: tuple[Structure, ...]) -> tuple[list[tuple[int, str]], np.ndarray]:
    """List the parameters (joint, kind) of structures, and the matrix M (p, k) that maps them to columns."""
    made = [parameter_columns(structure, joint) for structure, joint in zip(structures, group.joints, strict=True)]
    names = [(s, kind) for s, columns in enumerate(made) for kind in columns]
    starts = np.cumsum([0, *(joint.count for joint in group.joints)])
    M = np.zeros((starts[-1], len(names)))
    for k, (s, kind) in enumerate(names):
        M[starts[s] : starts[s + 1], k] = made[s][kind]
    return names, M


def reduced(group: FrictionGroup, M: np.ndarray) -> np.ndarray:
    """Compute the products (K, m, k + 1, k + 1) of the columns that M (p, k) makes, and of the torque."""
    used = np.append(np.flatnonzero(M.any(axis=1)), len(M))  # a few of very many columns
    T = np.zeros((len(used), M.shape[1] + 1))
    T[:-1, :-1], T[-1, -1] = M[used[:-1]], 1.0
    return np.asarray(T.T @ group.G[:, :, used[:, None], used] @ T)


def left_out(G: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solve for x (k,), and without each block (K, k), with the squared errors (K, m) of the blocks left out."""
    k = G.shape[-1] - 1
    size = np.append(np.sqrt(np.maximum(np.diag(G.sum(axis=(0, 1)))[:-1], 1e-300)), 1.0)
    G = G / size / size[:, None]
    total = G.sum(axis=(0, 1))
    others = _solved(total - G.sum(axis=1), k)
    error = np.hstack([-others, np.ones((len(others), 1))])
    errors = np.einsum("bp,bmpq,bq->bm", error, G, error)
    return _solved(total[None], k)[0] / size[:-1], others / size[:-1], errors


def _solved(G: np.ndarray, k: int) -> np.ndarray:
    ridge = 1e-9 * np.eye(k) * np.trace(G[:, :k, :k], axis1=1, axis2=2)[:, None, None] / max(k, 1)
    return np.linalg.solve(G[:, :k, :k] + ridge, G[:, :k, k, None])[..., 0]


def gained(before: FrictionFit, after: FrictionFit) -> tuple[float, float]:
    """Compute the improvement of a candidate on left-out blocks: in standard errors, and as a share of the error.

    Reversals are few, and the squared errors of blocks too unequal for a reliable standard error of their mean. The
    difference of each block and motor counts in units of the errors there, with the mean added, which bounds it.
    """
    difference = before.errors - after.errors
    relative = difference / (before.errors + after.errors + before.errors.mean(axis=0))
    spread = np.std(relative, ddof=1) * np.sqrt(relative.size)
    share = difference.sum() / max(before.errors.sum(), 1e-300)
    return float(relative.sum() / max(spread, 1e-300)), float(share)


def choose(group: FrictionGroup) -> tuple[FrictionFit, FrictionFit, dict[tuple[int, str], float]]:
    """Add one term after another while the errors on left-out blocks decrease.

    Returns the candidate chosen, the plain one, and the gain of each term taken, in standard errors, by (joint, term).

    A term enters where it reduces the squared error of blocks left out noticeably and by more
    standard errors, over the blocks, than the best of many widths and speeds does by chance.
    """
    plain = fit(group, (Structure(),) * len(group.joints))
    best = plain
    evidence: dict[tuple[int, str], float] = {}
    if len(group.G) < FEWEST_BLOCKS:
        return best, plain, evidence
    terms = [(s, term) for s in range(len(group.joints)) for term in WORDS]
    while True:
        offers = []
        for s, term in (untried for untried in terms if untried not in evidence):
            if candidates := _with(group, best, s, term):
                least = min(candidates, key=lambda candidate: candidate.errors.sum())
                t, share = gained(best, least)
                shown = term != "speed" or _beyond(group, least, s)
                if t > TERM_T and share > TERM_SHARE and shown:
                    offers.append((share, t, (s, term), least))
        if not offers:
            return _needed(group, refine(group, best), evidence), plain, evidence
        _, t, key, best = max(offers, key=lambda offer: offer[0])
        evidence[key] = t
        for s, term in product(range(len(group.joints)), SHAPE_OF):  # widths and speeds again, given this term
            if getattr(best.structures[s], term) is not None:
                best = min([best, *_with(group, best, s, term)], key=lambda fit: float(fit.errors.sum()))


def _needed(group: FrictionGroup, candidate: FrictionFit, evidence: dict[tuple[int, str], float]) -> FrictionFit:
    """Leave out the terms that made up for a width or a speed that is finer now, and their evidence."""
    for s, term in tuple(evidence):
        bare = candidate.structures[s].changed(term, getattr(Structure(), term))
        without = fit(group, _changed(candidate, s, bare))
        if without.errors.sum() <= candidate.errors.sum():
            candidate = without
            del evidence[s, term]
    return candidate


def _beyond(group: FrictionGroup, after: FrictionFit, s: int) -> bool:
    """Decide whether friction nonlinear in the speed improves the fit beyond any presliding.

    Presliding of real joints, of LuGre's and of generalized Maxwell slip, turns into sliding gradually, while the joint
    is slow still. One stop turns at once, and friction that bends below a hundredth of the rms speed made up for it.
    Bends at higher speeds skip this test: on motor 6 of a TX40 one reduces the error of unused samples from 16.0 to
    10.4 %.
    """
    bent = replace(after.structures[s], gradual=True)
    assert bent.speed is not None
    if bent.speed > SLOW * group.joints[s].speed:
        return True
    bare = replace(bent, speed=None)
    t, share = gained(*(fit(group, _changed(after, s, structure)) for structure in (bare, bent)))
    return t > TERM_T and share > TERM_SHARE


def _with(group: FrictionGroup, candidate: FrictionFit, s: int, term: str) -> list[FrictionFit]:
    """Fit a candidate with a term of a joint; several times if the term has a value."""
    structure, joint = candidate.structures[s], group.joints[s]
    possible = {"load": joint.motor is not None, "temperature": joint.warm}
    values: Iterable[float] = map(float, joint.tried(term)) if term in SHAPE_OF else [True] * possible[term]
    return [fit(group, _changed(candidate, s, structure.changed(term, value))) for value in values]


def _changed(candidate: FrictionFit, s: int, structure: Structure) -> tuple[Structure, ...]:
    return (*candidate.structures[:s], structure, *candidate.structures[s + 1 :])


def refine(group: FrictionGroup, candidate: FrictionFit) -> FrictionFit:
    """Refine widths and speeds between those tried by Gauss-Newton steps, where errors on left-out blocks decrease.

    Better by as much as for a term. The speed of friction that saturates stays: it says more of speeds beyond the log
    than of logged speeds, and refining it made other days of a UR10e worse (3.35 to 3.40, 4.57 to 4.74 % of torque).
    """
    best = candidate
    for _ in range(STEPS):
        shaped, count = with_shapes(group, best), len(best.names)
        structures = list(best.structures)
        x = dict(zip(best.names, best.x, strict=True))
        for (s, term), step in zip(shaped.names[count:], shaped.x[count:], strict=True):
            if term == "speed" and x.get((s, "fr"), 0.0) < x.get((s, "fs"), 0.0):
                continue
            tried = group.joints[s].tried(term)
            structures[s] = _moved(structures[s], term, tried, step / np.log(tried[1] / tried[0]))
        after = fit(group, tuple(structures))
        if after.errors.sum() >= best.errors.sum():
            break
        best = after
    return best if best.errors.sum() < (1 - TERM_SHARE) * candidate.errors.sum() else candidate


def with_shapes(group: FrictionGroup, candidate: FrictionFit) -> FrictionFit:
    """Append derivatives by log widths and log speeds to a candidate's columns: names (joint, width or speed) and x."""
    names, columns = list(candidate.names), [candidate.M]
    for s, structure in enumerate(candidate.structures):
        for term in SHAPE_OF:
            if getattr(structure, term) is None:
                continue
            tried = group.joints[s].tried(term)
            ends = [_moved(structure, term, tried, step) for step in (-TILT, TILT)]
            made = (columns_of(group, _changed(candidate, s, end)) for end in ends)
            low, high = (A[:, [listed.index(name) for name in candidate.names]] @ candidate.x for listed, A in made)
            slope = (high - low) / np.log(getattr(ends[1], term) / getattr(ends[0], term))
            if slope.any():
                names.append((s, term))
                columns.append(slope[:, None])
    M = np.hstack(columns)
    x, replicates, errors = left_out(reduced(group, M))
    return FrictionFit(candidate.structures, tuple(names), x, replicates, errors, M)


def _moved(structure: Structure, term: str, tried: np.ndarray, step: float) -> Structure:
    """Move a width or speed by ``step`` ways to the next that is tried, by one at most, and within those tried."""
    moved = getattr(structure, term) * (tried[1] / tried[0]) ** np.clip(step, -1.0, 1.0)
    return structure.changed(term, float(np.clip(moved, tried[0], tried[-1])))
