"""Normal equations of friction on all samples, at fixed gains and inertia, in blocks of the runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.friction.law import FrictionLaw
from gtau.estimation.friction.sites import Columns, Site, groups_of
from gtau.estimation.regression.rows import stream_rows
from gtau.robots.parameter import Parameter

BLOCKS = 20  # of a run, as many as the stretches of identification
MOST_BLOCKS = 60  # of all runs
# Rows for one of identification: a reversal is short. With 1, 2, 3 and 4, errors over all samples of runs not used are
# 5.26, 5.17, 5.21 and 5.20 % (geometric mean of UR10e, TX40, Panda, xMate7, xMate3 and da Vinci), those of the TX40's
# motor 6 are 17.4, 11.5, 10.2 and 10.2 %, and from 3 on a wrist joint of the UR10e loses its presliding.
FINER = 2
RESTING = 0.01  # of the rms speed: a joint whose mean speed behind the filter is less rests, and slides nowhere


@dataclass(frozen=True, eq=False)
class Group:
    """Joints that share motors: the products of their columns, by block and motor.

    ``columns`` name (site, column) of (p,); ``G`` (K, m, p + 1, p + 1) are the products of the columns and of the
    torque that is left to friction, the last, all times the ``weights`` (m,) of the motors: one over their residuals.
    ``rows`` (K,) count them. ``cross`` (p, gains and base parameters) are products with what gains and base parameters
    add to the torque. ``motors`` are the numbers of the actuated joints, ``signals`` (m, 2) count the rows of each and
    add up the squares of its measured torque.
    """

    sites: tuple[Site, ...]
    columns: tuple[tuple[int, str], ...]
    G: np.ndarray
    rows: np.ndarray
    cross: np.ndarray
    motors: tuple[int, ...]
    weights: np.ndarray
    signals: np.ndarray


def normal_equations(fit: Fit, law: FrictionLaw, sites: Sequence[Site], finer: int = 1) -> tuple[Group, ...]:
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
    groups = groups_of(sites)
    starts = np.cumsum([0, *(len(site.names) for site in sites)])
    sizes = [sum(len(sites[k].names) for k in members) for members, _ in groups]
    G = [
        np.zeros((runs * each, len(motors), size + 1, size + 1))
        for (_, motors), size in zip(groups, sizes, strict=True)
    ]
    cross = [np.zeros((size, n + base.count)) for size in sizes]
    rows = [np.zeros(runs * each, dtype=int) for _ in groups]
    signals = [np.zeros((len(motors), 2)) for _, motors in groups]
    for run, prepared in enumerate(dataset.prepared):
        decimator = dataset.preparation.at(prepared.run.rate).decimator
        decimator = replace(decimator, factor=max(decimator.factor // finer, 1))
        load, follow = fit.system.load(run, solution.theta), Columns(sites, dataset, run)
        values = dict(zip(base.standard, fit.system.motion(run, solution.theta), strict=True))
        passive = {
            Parameter(kind, joint.name).name: values.get(Parameter(kind, joint.name).name, 0.0)
            for joint in model.robot.joints
            if joint.name not in names
            for kind in ("fv", "fs", "off")
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
            for g, (members, motors) in enumerate(groups):
                moving = np.any([speeds[k] > RESTING * sites[k].rms_speed for k in members], axis=0)
                for m, j in enumerate(motors):
                    kept = valid[j] & moving
                    if not kept.any():
                        continue
                    own = [sites[k].ratios[j] * made[starts[k] : starts[k + 1], kept] for k in members]
                    A = np.vstack([*own, y[j, kept]])
                    signals[g][m] += kept.sum(), measured[j, kept] @ measured[j, kept]
                    A *= weights[j]
                    fixed = np.zeros((n + base.count, int(kept.sum())))
                    fixed[j], fixed[n:] = v[j, kept], -W[j][:, kept]
                    cross[g] += weights[j] * A[:-1] @ fixed.T
                    for b in np.unique(place[kept]):
                        of_block = A[:, place[kept] == b]
                        G[g][b, m] += of_block @ of_block.T
                        rows[g][b] += of_block.shape[1]
    made_groups = []
    for g, (members, motors) in enumerate(groups):
        used = rows[g] > 0
        listed = tuple((k, name) for k, member in enumerate(members) for name in sites[member].names)
        own_sites = tuple(sites[k] for k in members)
        of_group = (cross[g], tuple(motors), weights[motors], signals[g])
        made_groups.append(Group(own_sites, listed, G[g][used], rows[g][used], *of_group))
    return tuple(made_groups)
