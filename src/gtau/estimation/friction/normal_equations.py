"""Normal equations of friction on all samples, at fixed gains and inertia, in blocks of the runs.

Each joint with friction has candidate columns of presliding, and of friction that falls with the speed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.friction.law import JOINT_TERMS, FrictionLaw, PreslidingState
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.factors import add_products, delayed_signal
from gtau.estimation.regression.rows import Law, Rows, Sliding, column, stream_rows
from gtau.estimation.regression.run_blocks import BLOCKS
from gtau.model.loops import Motion
from gtau.robots.parameter import DRY, TEMPERATURE_TERMS, Parameter
from gtau.robots.robot import PLAIN_FRICTION
from gtau.signals.preparation.filters import Decimator
from gtau.signals.storage import Store, block, spans

# Tried widths over a joint's travel, and tried speeds over its rms speed. Presliding of real joints was found at 4e-5
# to 1e-3 of the travel (UR10e, TX40, Panda), friction that bends at 0.1 to 1 of the rms speed; simulators smooth the
# sign at 0.003 to 0.03 of it.
WIDTHS = 10.0 ** np.arange(-5.25, -1.99, 0.25)
SPEEDS = 10.0 ** np.arange(-2.5, 0.51, 0.5)
MOST_BLOCKS = 60  # of all runs
FINER = 2  # rows for one of identification: a reversal is short
RESTING = 0.01  # of the rms speed: a joint whose filtered speed is lower rests
SMOOTH = ("off", *(kind for kind in (*JOINT_TERMS, *TEMPERATURE_TERMS) if kind not in DRY))
"""Kinds of the first columns of a joint, without a direction."""
WEIGHTS = tuple(weight for kind in DRY for weight in (kind,) * (len(SPEEDS) if kind == "fb" else 1))
"""Kinds of the other columns, for sliding and for every width; ``fb`` for every speed."""


@dataclass(frozen=True, eq=False)
class FrictionJoint:
    """A joint whose friction is identified on all samples.

    ``row`` is its row among the robot's joints, ``ratios`` (n,) its speed for unit speeds of the actuated joints, and
    ``motor`` the one that alone moves it, if any. Its ``travel`` (rad or m) and rms ``speed`` are over all runs.
    ``plain`` are the kinds of its friction that are base parameters, of ``off``, ``fv`` and ``fs``; ``warm`` says
    whether its temperature is logged.

    Its columns are ``SMOOTH``, and then ``WEIGHTS`` times each direction: sliding, and presliding of each width.
    """

    name: str
    row: int
    ratios: np.ndarray
    motor: int | None
    travel: float
    speed: float
    plain: tuple[str, ...]
    warm: bool

    @property
    def widths(self) -> np.ndarray:
        """Candidates (w,) of presliding, rad or m."""
        return self.travel * WIDTHS

    @property
    def speeds(self) -> np.ndarray:
        """Candidates (s,) of v_s, rad/s or m/s."""
        return self.speed * SPEEDS

    def tried(self, term: str) -> np.ndarray:
        """Candidates of a ``width`` or ``speed``."""
        return self.widths if term == "width" else self.speeds

    @property
    def count(self) -> int:
        """Number of columns."""
        return len(SMOOTH) + (1 + len(WIDTHS)) * len(WEIGHTS)

    def columns(self, v: np.ndarray, z: np.ndarray, load: np.ndarray | float, above: np.ndarray | float) -> np.ndarray:
        """Build the columns (., N) from speeds (N,), states (w + 1, N), torques transmitted and temperatures (N,)."""
        falling = np.exp(-np.abs(v) / self.speeds[:, None])
        at = Sliding(v, np.ones_like(v), np.abs(load), falling, above)
        shape = (-1, len(v))
        smooth = np.stack([np.ones_like(v), *(column(kind, at) for kind in SMOOTH[1:])])
        weighed = np.concatenate([np.reshape(column(kind, at), shape) for kind in DRY])
        return np.concatenate([smooth, (z[:, None] * weighed).reshape(shape)])


def friction_joints(dataset: Dataset, law: FrictionLaw, unexcited: Sequence[Parameter]) -> tuple[FrictionJoint, ...]:
    """List the joints with friction that moves with the motors at constant ratios, without ``unexcited`` parameters."""
    model, warm = dataset.model, dataset.temperatures
    travels, squares, samples = [], np.zeros((len(model.actuated),) * 2), 0
    for run in dataset.prepared:
        position, kept = run.run.position, run.kept
        parts = (block(position, kept.start + a, kept.start + b) @ law.ratios.T for a, b in spans(len(kept)))
        ends = [(part.min(axis=0), part.max(axis=0)) for part in parts]
        travels.append(np.max([high for _, high in ends], axis=0) - np.min([low for low, _ in ends], axis=0))
        squares = squares + run.speeds * len(run)
        samples = samples + len(run)
    pairs = zip(dataset.base.standard, dataset.base.names, strict=True)
    seen = {standard for standard, name in pairs if name not in unexcited}
    travel = np.max(travels, axis=0)
    rms = np.sqrt(np.einsum("ki,ij,kj->k", law.ratios, squares / samples, law.ratios))
    joints = []
    for row, joint in enumerate(model.robot.joints):
        plain = tuple(kind for kind in PLAIN_FRICTION if Parameter(kind, joint.name) in seen)
        if {"fv", "fs"} & set(plain) and travel[row] and rms[row]:
            motor = law.motor(row)
            heated = warm is not None and motor is not None and model.actuated[motor] in warm.reference
            sizes = float(travel[row]), float(rms[row])
            joints.append(FrictionJoint(joint.name, row, law.ratios[row], motor, *sizes, plain, heated))
    return tuple(joints)


def columns_along(
    joints: Sequence[FrictionJoint], dataset: Dataset, run: int, mixes: Mapping[FrictionJoint, np.ndarray] | None
) -> Law:
    """Make the columns (., N) of all joints along a run in blocks, and then their |speeds| (joints, N).

    With ``mixes``, coefficients of a joint's columns, their sum is its only one.
    """
    prepared, warm = dataset.prepared[run], dataset.temperatures
    states = [PreslidingState(joint.widths) for joint in joints]

    def above(joint: FrictionJoint, time: np.ndarray) -> np.ndarray | float:
        if warm is None or joint.motor is None or not joint.warm:
            return 0.0
        motor = dataset.model.actuated[joint.motor]
        return prepared.run.side["temperature"].at(motor, time) - warm.reference[motor]

    def columns(time: np.ndarray, motion: Motion, effort: np.ndarray) -> np.ndarray:
        q, parts, speeds = prepared.path(time), [], []
        for joint, state in zip(joints, states, strict=True):
            v = motion.yd[joint.row]
            load = 0.0 if joint.motor is None else effort[joint.motor] / joint.ratios[joint.motor]
            z = np.vstack([np.sign(v), state(time, joint.ratios @ q)])
            made = joint.columns(v, z, load, above(joint, time))
            parts.append(made if mixes is None else mixes[joint] @ made)
            speeds.append(np.abs(v))
        return np.vstack([*parts, speeds])

    return columns


@dataclass(frozen=True, eq=False)
class FrictionGroup:
    """Joints that share motors: the products of their columns, by block and motor.

    ``G`` (K, m, p + 1, p + 1) are the products of the joints' columns and of the torque that is left to friction, the
    last, all times the ``weights`` (m,) of the motors: one over their residuals. ``cross`` (p, gains and base
    parameters) are products with what gains and base parameters add to the torque. ``motors`` are the numbers of the
    actuated joints, ``signals`` (m, 2) count the rows of each and add up the squares of its measured torque.
    ``residuals`` (K, m) belong to weighted rows, times the ``weights`` of the motors.
    """

    joints: tuple[FrictionJoint, ...]
    motors: tuple[int, ...]
    weights: np.ndarray
    G: np.ndarray
    cross: np.ndarray
    signals: np.ndarray
    residuals: np.ndarray


def groups_of(joints: Sequence[FrictionJoint]) -> list[tuple[tuple[FrictionJoint, ...], tuple[int, ...]]]:
    """Group joints that share motors, with the numbers of the motors."""
    from scipy.sparse.csgraph import connected_components

    driven = np.array([joint.ratios != 0 for joint in joints]).astype(int)
    count, label = connected_components(driven @ driven.T, directed=False)
    members = [np.flatnonzero(label == group) for group in range(count)]
    return [
        (tuple(joints[k] for k in group.tolist()), tuple(np.flatnonzero(driven[group].any(axis=0)).tolist()))
        for group in members
    ]


def normal_equations(
    fit: Fit,
    joints: Sequence[FrictionJoint],
    finer: int = 1,
    weigh: Sequence[tuple[np.ndarray, np.ndarray]] | None = None,
    mixes: Mapping[FrictionJoint, np.ndarray] | None = None,
) -> tuple[FrictionGroup, ...]:
    """Stream all runs and reduce the torque that friction has to explain, to ``finer`` rows for one of identification.

    Rows count where speeds rest on good samples and some joint of the group moves: at rest, anything within the band of
    friction holds it. With ``weigh``, for each group coefficients (p + 1,) and limits (m,), rows have Huber's weights
    ``min(1, limit / |residual|)``, as in :func:`gtau.estimation.regression.factors.reduce_rows`. With ``mixes`` a joint
    has the sum of its columns by these coefficients alone. Raises GtauError.
    """
    dataset, n, runs = fit.dataset, len(fit.gains), len(fit.dataset.prepared)
    count = max(min(BLOCKS, MOST_BLOCKS // runs), 1)
    weights = 1 / np.maximum(np.abs(fit.gains) * fit.solution.sigma[:n], 1e-300)
    groups, residuals = [], []
    for members, motors in groups_of(joints):
        p, m = len(members) if mixes else sum(joint.count for joint in members), len(motors)
        G = np.zeros((runs * count, m, p + 1, p + 1))
        cross = np.zeros((p, n + dataset.base.count))
        residuals.append(Store((m,)))
        groups.append(FrictionGroup(members, motors, weights[list(motors)], G, cross, np.zeros((m, 2)), np.empty(0)))
    regressor = dataset.model.columns(dataset.base.standard)
    for run, prepared in enumerate(dataset.prepared):
        decimator = dataset.preparation.at(prepared.run.rate).decimator
        decimator = replace(decimator, factor=max(decimator.factor // finer, 1))
        outputs = decimator.outputs(len(prepared))
        for part, columns, torques in _rows_along(fit, joints, run, decimator, mixes):
            first, last = (decimator.factor * k for k in (part.outputs.start, part.outputs.stop - 1))
            valid = decimator.keep(prepared.valid(first, last + 2 * decimator.support + 1)[:, :n]).T
            blocks = run * count + np.arange(part.outputs.start, part.outputs.stop) * count // outputs
            W = part.matrix(regressor, n)
            for k, group in enumerate(groups):
                moving = np.any([columns[joint][-1] > RESTING * joint.speed for joint in group.joints], axis=0)
                e = np.full((len(blocks), len(group.motors)), np.nan)
                for m, j in enumerate(group.motors):
                    if (kept := valid[j] & moving).any():
                        base = np.vstack([part.currents[0, j, kept], -W[j, kept].T])
                        friction = [joint.ratios[j] * columns[joint][:-1, kept] for joint in group.joints]
                        rows = np.vstack([*friction, torques[:, j, kept]])
                        if weigh is not None:
                            coefficients, limit = weigh[k]
                            e[kept, m] = group.weights[m] * (coefficients @ rows[:-1])
                            root = np.sqrt(np.minimum(1.0, limit[m] / np.maximum(np.abs(e[kept, m]), 1e-300)))
                            rows[:-1], base = root * rows[:-1], root * base
                        _add(group, m, rows, base, blocks[kept])
                if weigh is not None:
                    residuals[k].append(e)
    return tuple(
        replace(group, G=group.G[np.einsum("kmpp->k", group.G) > 0], residuals=rows.array())
        for group, rows in zip(groups, residuals, strict=True)
    )


def _rows_along(
    fit: Fit,
    joints: Sequence[FrictionJoint],
    run: int,
    decimator: Decimator,
    mixes: Mapping[FrictionJoint, np.ndarray] | None,
) -> Iterator[tuple[Rows, dict[FrictionJoint, np.ndarray], np.ndarray]]:
    """Stream a run: its rows, the columns (., K) of each joint with its |speed| last, and torques (2, n, K).

    These are the torque left to friction, and the measured one. Left is ``g_tau v(t + d)``, less what the inertial
    parameters give at their estimates, less the friction of passive joints, which no motor alone shows, and less what
    the friction of the run differs by from its mean over all runs. It and the columns of friction pass the same
    low-pass and decimation.
    """
    dataset, solution, model = fit.dataset, fit.solution, fit.dataset.model
    n, base = len(fit.gains), fit.dataset.base
    names = {joint.name for joint in joints}
    friction = columns_along(joints, dataset, run, mixes)
    load = fit.system.load(run, solution.theta)
    parameters = fit.system.problem.parameters
    mean = dict(zip(parameters, solution.theta, strict=True))
    cold = solution.theta * [name.kind not in TEMPERATURE_TERMS for name in parameters]
    sought = [mean.get(name, 0.0) if name.kind in PLAIN_FRICTION and name.body in names else 0.0 for name in base.names]
    known = fit.system.motion(run, cold) - sought
    ends = np.cumsum([1 if mixes else joint.count for joint in joints])
    regressor = model.columns(base.standard)
    for part in stream_rows(model, regressor, dataset.prepared[run], decimator, load, friction=friction):
        assert part.friction is not None
        *made, speeds = np.split(part.friction, ends)
        measured = fit.gains[:, None] * delayed_signal(np.moveaxis(part.currents[:, :n], 0, -1), solution.delays[:n])
        columns = {joint: np.vstack([A, speed]) for joint, A, speed in zip(joints, made, speeds, strict=True)}
        left = measured + part.external - regressor.torques(part.entries, known, n)
        yield part, columns, np.stack([left, measured])


def _add(group: FrictionGroup, m: int, rows: np.ndarray, base: np.ndarray, blocks: np.ndarray) -> None:
    """Add a motor's rows (columns, torque left, torque); ``base`` is what gain and base parameters add."""
    A, measured = group.weights[m] * rows[:-1], rows[-1]
    products = group.weights[m] * A[:-1] @ base.T
    group.cross[:, group.motors[m]] += products[:, 0]
    group.cross[:, 1 - len(base) :] += products[:, 1:]
    group.signals[m] += len(measured), measured @ measured
    add_products(group.G[:, m], A.T, blocks)
