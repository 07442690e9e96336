"""Normal equations of friction on all samples, at fixed gains and inertia, in blocks of the runs.

Their columns are candidates: of presliding, and of friction that falls with the speed, at each site of friction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.friction.law import FrictionLaw, PreslidingState
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.rows import Law, stream_rows
from gtau.model.loops import Motion
from gtau.robots.parameter import Parameter
from gtau.robots.robot import PLAIN_FRICTION
from gtau.signals.storage import block, spans

# Widths, of a joint's travel, and speeds, of its rms speed, that are tried. Presliding of real joints was found at 4e-5
# to 1e-3 of the travel (UR10e, TX40, Panda), friction that bends at 0.1 to 1 of the rms speed; simulators smooth the
# sign at 0.003 to 0.03 of it.
WIDTHS = 10.0 ** np.arange(-5.25, -1.99, 0.25)
SPEEDS = 10.0 ** np.arange(-2.5, 0.51, 0.5)
BLOCKS = 20  # of a run, as many as the blocks of identification
MOST_BLOCKS = 60  # of all runs
# Rows for one of identification: a reversal is short. With 1, 2, 3 and 4, errors over all samples of runs not used are
# 5.26, 5.17, 5.21 and 5.20 % (geometric mean of UR10e, TX40, Panda, xMate7, xMate3 and da Vinci), those of the TX40's
# motor 6 are 17.4, 11.5, 10.2 and 10.2 %, and from 3 on a wrist joint of the UR10e loses its presliding.
FINER = 2
RESTING = 0.01  # of the rms speed: a joint whose mean speed behind the filter is less rests, and slides nowhere


@dataclass(frozen=True, eq=False)
class JointFriction:
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


def sites_of(dataset: Dataset, law: FrictionLaw) -> tuple[JointFriction, ...]:
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
        plain = tuple(kind for kind in PLAIN_FRICTION if Parameter(kind, joint.name) in standard)
        if not {"fv", "fs"} & set(plain) or not travel[row] or not rms[row]:
            continue
        motor = law.motor(row)
        heated = warm is not None and motor is not None and model.actuated[motor] in warm.reference
        sites.append(
            JointFriction(
                joint.name,
                row,
                law.ratios[row],
                motor,
                travel[row] * WIDTHS,
                rms[row] * SPEEDS,
                float(rms[row]),
                plain,
                heated,
            )
        )
    return tuple(sites)


def columns_along(sites: Sequence[JointFriction], dataset: Dataset, run: int) -> Law:
    """Make the columns (., N) of all sites along a run in blocks, and then their |speeds| (sites, N)."""
    prepared, warm = dataset.prepared[run], dataset.temperatures
    followers = [PreslidingState(site.widths) for site in sites]

    def above(site: JointFriction, time: np.ndarray) -> np.ndarray | float:
        if warm is None or not site.warm or prepared.run.temperature is None or site.motor is None:
            return 0.0
        joint = dataset.model.actuated[site.motor]
        return prepared.run.temperature.at(joint, time) - warm.reference[joint]

    def columns(time: np.ndarray, motion: Motion, effort: np.ndarray) -> np.ndarray:
        q, found, speeds = prepared.path(time), [], []
        for site, follow in zip(sites, followers, strict=True):
            v = motion.yd[site.row]
            load = 0.0 if site.motor is None else effort[site.motor] / site.ratios[site.motor]
            z = np.vstack([np.sign(v), follow(time, site.ratios @ q)])
            found.append(site.columns(v, z, load, above(site, time)))
            speeds.append(np.abs(v))
        return np.vstack([*found, speeds])

    return columns


def groups_of(sites: Sequence[JointFriction]) -> list[tuple[list[int], list[int]]]:
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


@dataclass(frozen=True, eq=False)
class FrictionGroup:
    """Joints that share motors: the products of their columns, by block and motor.

    ``columns`` name (site, column) of (p,); ``G`` (K, m, p + 1, p + 1) are the products of the columns and of the
    torque that is left to friction, the last, all times the ``weights`` (m,) of the motors: one over their residuals.
    ``cross`` (p, gains and base parameters) are products with what gains and base parameters
    add to the torque. ``motors`` are the numbers of the actuated joints, ``signals`` (m, 2) count the rows of each and
    add up the squares of its measured torque.
    """

    sites: tuple[JointFriction, ...]
    columns: tuple[tuple[int, str], ...]
    G: np.ndarray
    cross: np.ndarray
    motors: tuple[int, ...]
    weights: np.ndarray
    signals: np.ndarray


def normal_equations(
    fit: Fit, law: FrictionLaw, sites: Sequence[JointFriction], finer: int = 1
) -> tuple[FrictionGroup, ...]:
    """Stream all runs and reduce the torque that friction has to explain, to ``finer`` rows for one of identification.

    The torque that is left is ``g_tau v(t + d)``, less what the inertial parameters give at their estimates, less the
    friction of passive joints, which no motor alone shows. It and the columns of friction pass the same low-pass and
    decimation. Rows count where speeds rest on good samples and some joint of the group moves: at rest, anything within
    the band of friction holds it.

    Raises
    ------
    GtauError
        Where the closures refuse a sample.
    """
    dataset, solution, model = fit.dataset, fit.solution, fit.dataset.model
    base, n, runs = dataset.base, len(model.actuated), len(dataset.prepared)
    gains, delays = fit.gains, solution.delays[:n, None]
    weights = 1 / np.maximum(np.abs(gains) * solution.sigma[:n], 1e-300)
    regressor, names = model.columns(base.standard), {site.joint for site in sites}
    each = max(min(BLOCKS, MOST_BLOCKS // runs), 1)
    starts = np.cumsum([0, *(len(site.names) for site in sites)])
    groups = []
    for members, motors in groups_of(sites):
        columns = tuple((k, name) for k, member in enumerate(members) for name in sites[member].names)
        p, m = len(columns), len(motors)
        sums = np.zeros((runs * each, m, p + 1, p + 1)), np.zeros((p, n + base.count))
        own_sites = tuple(sites[k] for k in members)
        groups.append(
            (members, FrictionGroup(own_sites, columns, *sums, tuple(motors), weights[motors], np.zeros((m, 2))))
        )
    for run, prepared in enumerate(dataset.prepared):
        decimator = dataset.preparation.at(prepared.run.rate).decimator
        decimator = replace(decimator, factor=max(decimator.factor // finer, 1))
        load, follow = fit.system.load(run, solution.theta), columns_along(sites, dataset, run)
        values = dict(zip(base.standard, fit.system.motion(run, solution.theta), strict=True))
        passive = {
            Parameter(kind, joint.name): values.get(Parameter(kind, joint.name), 0.0)
            for joint in model.robot.joints
            if joint.name not in names
            for kind in PLAIN_FRICTION
        }

        def friction(time, motion, effort, follow=follow, passive=passive):  # type: ignore[no-untyped-def]
            return np.vstack([follow(time, motion, effort), effort, law.torques(motion, passive, effort)])

        outputs = decimator.outputs(len(prepared))
        for part in stream_rows(model, regressor, prepared, decimator, load, friction=friction):
            assert part.friction is not None
            made, speeds, effort, rest = np.split(part.friction, np.cumsum([starts[-1], len(sites), n]))
            v, v_d, v_dd = part.currents[:, :n]
            measured = gains[:, None] * (v - delays * v_d + delays**2 / 2 * v_dd)
            y = measured - effort - rest
            first, last = (decimator.factor * k for k in (part.outputs.start, part.outputs.stop - 1))
            valid = decimator.keep(prepared.valid(first, last + 2 * decimator.support + 1)[:, :n]).T
            place = run * each + np.arange(part.outputs.start, part.outputs.stop) * each // outputs
            W = np.zeros((n, base.count, len(y[0])))
            W[regressor.rows, regressor.columns] = part.entries
            for members, group in groups:
                moving = np.any([speeds[k] > RESTING * sites[k].rms_speed for k in members], axis=0)
                for m, j in enumerate(group.motors):
                    kept = valid[j] & moving
                    if not kept.any():
                        continue
                    own = [sites[k].ratios[j] * made[starts[k] : starts[k + 1], kept] for k in members]
                    A = np.vstack([*own, y[j, kept]])
                    group.signals[m] += kept.sum(), measured[j, kept] @ measured[j, kept]
                    A *= weights[j]
                    fixed = np.zeros((n + base.count, int(kept.sum())))
                    fixed[j], fixed[n:] = v[j, kept], -W[j][:, kept]
                    group.cross[:] += weights[j] * A[:-1] @ fixed.T
                    for b in np.unique(place[kept]):
                        of_block = A[:, place[kept] == b]
                        group.G[b, m] += of_block @ of_block.T
    return tuple(replace(group, G=group.G[group.G.any(axis=(1, 2, 3))]) for _, group in groups)
