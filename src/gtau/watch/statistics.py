"""Statistics of a log: the size of each change, estimated one at a time with friction, and its standard deviation.

The residual of the identified model along a log, ``y = g v(t - d) - tau_model`` (eq. 16), is regressed on one column
per quantity: the torque that one unit of its change adds. Filters, decimation and exclusion of reversals are the same
as in the identification, after subtraction of the model's friction law.

======  ===========================================  ==============================
kind    change                                       column
======  ===========================================  ==============================
load    mass, first moments, inertia on the tool     columns of a payload (eq. 18)
gain    drive gain, at fixed inertia                 ``-tau_model``
zero    encoder zero                                 ``d tau / d q``
delay   lag of the current behind the position       ``-g v'``
rate    clock that is fast, by a share               ``tau`` at speeds that are as much higher
fv, fs  viscous and Coulomb friction                 ``qd``, ``sign(qd)``
off     offset of the current                        1
======  ===========================================  ==============================

Friction of a healthy robot differs from day to day, so friction and offsets of all joints are always free. In addition
one change at a time is estimated: a drive gain at fixed inertia, an encoder zero, a delay, or the load. By the theorem
of Frisch and Waugh each estimate is a fixed linear combination ``x = C A^T y`` of the log's residual; the same
combinations of the columns, ``C A^T A``, give the signature of each kind of change in all estimates.

Standard deviations come from the block jackknife over blocks of the log, as residuals are autocorrelated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.estimators.estimator import jackknife
from gtau.estimation.friction.law import transmitted
from gtau.estimation.regression.assembly import FEWEST_ROWS, payload_columns
from gtau.estimation.regression.factors import add_products, delayed
from gtau.estimation.regression.plausibility import check_wrenches, prepare_runs
from gtau.estimation.regression.rows import Rows, instants, stream_rows
from gtau.estimation.regression.run_blocks import BLOCKS, block_edges, block_of
from gtau.estimation.results.result import IdentifiedModel
from gtau.model.loops import Labels, Motion
from gtau.model.singularities import random_motion
from gtau.robots.geometry import refuse_floating
from gtau.robots.parameter import Parameter, unit_of
from gtau.robots.robot import PLAIN_FRICTION
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run
from gtau.uses.prediction import check_temperature_unit, friction_along, loaded_parameters, suited

STEP = 1e-3  # rad or m of an encoder zero, or share of the rate: torques are linear over this
STATES = 50  # at random, at which the zero of a joint moves some torque, or none does
UNSEEN = 1e-6  # of the largest torque, per degree, below which the zero of a joint moves no torque
SPANNED = 1e-6  # of the square of a column: below this residual it depends linearly on the others
VISIBLE = 0.03  # of a joint's rms torque: most that a change of one standard deviation may move it
LARGEST_ZERO = 1.0  # deg or mm: an encoder zero with a larger standard deviation is not observable
RESIDUAL = "rms"  # kind of the residual's charts
UNEVEN = 2.0  # times as uneven as any healthy log: intermittent forces, such as contacts
TITLES = {
    **{f"m{axis}": f"load (first moment {axis})" for axis in "xyz"},
    "gain": "drive gain",
    "fs": "Coulomb friction",
    "fv": "viscous friction",
    "friction": "friction",
    "zero": "encoder zero",
    "delay": "lag of the current",
    "rate": "rate of the clock",
    RESIDUAL: "residual",
}
"""Names of kinds that people read; all others are of the load."""
SHOWN = {"1": ("%", 100.0), "s": ("ms", 1000.0)}  # units that people read as others, and the factors to them
ZERO_UNITS = {"revolute": ("deg", np.pi / 180), "prismatic": ("mm", 1e-3)}
inverse_of = partial(np.linalg.pinv, rcond=1e-10, hermitian=True)  # directions without any effect are left out

Parts = list[tuple[np.ndarray, ...]]
"""Joint, position, direction and values ``[columns | y]`` (K, p + 1) of rows (K,), part by part."""


class TooShort(GtauError):
    """Error raised for a log that is too short, however the robot moves in it."""


class Quantity(NamedTuple):
    """A watched quantity: its kind (for the load, a payload parameter), joint and unit."""

    kind: str
    joint: str
    unit: str

    @property
    def name(self) -> Parameter:
        """Name in tables and files, such as ``gain_elbow``."""
        return Parameter(self.kind, self.joint or "load")

    @property
    def title(self) -> str:
        """Name that people read, such as ``drive gain of elbow``."""
        return TITLES.get(self.kind, "load") + (f" of {self.joint}" if self.joint else "")

    @property
    def charted(self) -> bool:
        """Whether it has a chart, unlike inertia of the load and offsets (nuisances) and the rate (a cause only)."""
        return self.kind != "off" if self.joint else self.kind in ("m", "mx", "my", "mz")

    @property
    def group(self) -> str:
        """``load``, ``friction``, or the kind itself."""
        if self.kind in PLAIN_FRICTION:
            return "friction"
        return self.kind if self.joint or self.kind == "rate" else "load"


@dataclass(frozen=True, eq=False)
class LogStatistics:
    """Statistics of one log, of which ``run`` holds the samples.

    The k ``charts`` are quantities, then the residual of each joint (logarithm of its rms over the model's residual).
    They have ``values`` (k,), NaN where this motion does not show a change, and a ``covariance`` (k, k) from the
    jackknife, 0 there. ``response`` (k, p) is the change of each chart per unit of each of the ``quantities``, and
    ``formula`` (k, k) the covariance for independent residuals of unit variance, which is not singular. ``uneven``
    (n,) is the largest rms residual of a block over the median one of each joint, as contacts are brief. ``speed``
    (n,) is the mean absolute velocity.
    """

    name: str
    charts: tuple[Quantity, ...]
    values: np.ndarray
    covariance: np.ndarray
    quantities: tuple[Quantity, ...]
    response: np.ndarray
    formula: np.ndarray
    uneven: np.ndarray
    speed: np.ndarray
    run: Run

    @property
    def std(self) -> np.ndarray:
        """Standard deviations (k,), NaN where this motion does not show a change."""
        return np.where(self.shown, np.sqrt(np.diag(self.covariance)), np.nan)

    @property
    def shown(self) -> np.ndarray:
        """Mask (k,) of the charts that are observable in this motion."""
        return np.isfinite(self.values)


def quantities_of(model: IdentifiedModel) -> tuple[tuple[Quantity, ...], np.ndarray]:
    """List the watched quantities of a model in the order of the columns, and the base columns (n_b, k) of a load."""
    robot, standard = model.robot, model.base.standard
    (payload,) = payload_columns(model.idm, model.base, [Payload(name="load")])
    quantities = [Quantity(name.kind, "", unit_of(name.kind, robot, robot.tool)) for name in payload.unknown]
    for kind, joint in product(("gain", "zero", "delay"), robot.motors):
        unit = {"gain": "1", "delay": "s", "zero": ZERO_UNITS[robot.joint(joint).kind][0]}[kind]
        quantities.append(Quantity(kind, joint, unit))
    for kind, joint in product(PLAIN_FRICTION, robot.motors):
        if Parameter(kind, joint) in standard:
            quantities.append(Quantity(kind, joint, unit_of(kind, robot, joint)))
    return (*quantities, Quantity("rate", "", "1")), payload.columns


def charts_of(model: IdentifiedModel) -> tuple[Quantity, ...]:
    """List the charts of a model."""
    quantities, _ = quantities_of(model)
    residuals = (Quantity(RESIDUAL, joint, "log") for joint in model.robot.actuated)
    return (*(quantity for quantity in quantities if quantity.charted), *residuals)


def identified(model: IdentifiedModel, name: Parameter) -> float:
    """Return viscous or Coulomb friction of a joint: of the straight line through its law at the logged speeds."""
    values: Mapping[str, float] = {term: known.value or 0.0 for term, known in model.friction_parameters.items()}
    return model.friction_law.straight(values, name.body)[PLAIN_FRICTION.index(name.kind)]


def statistics_of(model: IdentifiedModel, run: Run) -> LogStatistics:
    """Compute the statistics of a finished log, the model loaded with its payload; raises GtauError."""
    G, rows, speed = normal_equations(model, run)
    (quantities, _), charts = quantities_of(model), charts_of(model)
    total = G.sum(axis=(0, 1))
    blocks = np.arange(len(G))
    friction = _columns_of(quantities, "friction")
    C, usable = _combinations(total, quantities)
    residual, uneven = residuals_of(G, rows, friction, blocks >= 0)
    k, p, K = len(C), len(quantities), len(charts)
    values, replicates = np.concatenate([C @ total[:p, p], residual]), []
    for block in np.flatnonzero(rows.any(axis=1)):
        rest = total - G[block].sum(axis=0)
        without, fine = _combinations(rest, quantities)
        residual, _ = residuals_of(G, rows, friction, blocks != block)
        replicates.append(np.concatenate([np.where(fine, without @ rest[:p, p], values[:k]), residual]))
    covariance = jackknife(np.array(replicates)) if len(replicates) > 1 else np.full((K, K), np.inf)
    std = np.sqrt(np.diag(covariance))
    response, formula = np.zeros((K, p)), np.zeros((K, K))
    response[:k] = C @ total[:p, :p]
    formula[:k, :k] = response[:k] @ C.T
    formula[k:, k:] = np.diag(0.5 / np.maximum(rows.sum(axis=0), 1))  # of the logarithm of an rms
    shown = np.isfinite(values) & (std > 0) & np.isfinite(std)
    shown[:k] &= usable & (np.sqrt(np.diag(formula)[:k]) < _limits(G, quantities))
    values = np.where(shown, values, np.nan)
    covariance = np.where(shown[:, None] & shown, covariance, 0.0)
    return LogStatistics(run.name, charts, values, covariance, quantities, response, formula, uneven, speed, run)


def _columns_of(quantities: Sequence[Quantity], group: str) -> list[int]:
    return [k for k, quantity in enumerate(quantities) if quantity.group == group]


def _combinations(G: np.ndarray, quantities: Sequence[Quantity]) -> tuple[np.ndarray, np.ndarray]:
    """Find the combinations C (k, p) with ``x = C A^T y`` of the charted quantities, and whether each is usable."""
    friction, load = _columns_of(quantities, "friction"), _columns_of(quantities, "load")
    charted = [quantity.charted for quantity in quantities]
    norms = np.sqrt(np.diag(G)[:-1])
    scale = np.where(norms > 0, norms, 1.0)
    N = G[:-1, :-1] / scale / scale[:, None]
    friction_inverse = inverse_of(N[np.ix_(friction, friction)])
    projection = friction_inverse @ N[friction]  # (f, p)
    rest = N - N[:, friction] @ projection
    inverse = np.diag(1 / np.maximum(np.diag(rest), SPANNED))  # one by one, except the load
    inverse[np.ix_(load, load)] = inverse_of(rest[np.ix_(load, load)])
    inverse[friction] = 0.0
    usable = (norms > 0) & (np.diag(rest) > SPANNED) & (np.diag(inverse) < 1 / SPANNED)
    usable[friction] = (norms[friction] > 0) & (np.diag(friction_inverse) < 1 / SPANNED)
    inverse[:, friction] = -inverse @ projection.T
    inverse[np.ix_(friction, friction)] = friction_inverse
    return (inverse / scale / scale[:, None])[charted], usable[charted]


def residuals_of(
    G: np.ndarray, rows: np.ndarray, free: Sequence[int], used: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compute each joint's log ratio of rms residuals in the blocks ``used``, columns ``free``, and its unevenness."""
    n = rows.shape[1]
    rms, uneven = np.full(n, np.nan), np.ones(n)
    for j in np.flatnonzero(rows[used].any(axis=0)):
        total, count = G[used, j].sum(axis=0), rows[:, j]
        x = np.zeros(len(total))
        scale = np.sqrt(np.maximum(np.diag(total)[free], 1e-300))
        N = total[np.ix_(free, free)] / scale / scale[:, None]
        x[free], x[-1] = -inverse_of(N) @ (total[free, -1] / scale) / scale, 1.0
        rms[j] = 0.5 * np.log(max(float(x @ total @ x), 1e-300) / count[used].sum())
        squares = np.einsum("p,spq,q->s", x, G[:, j], x)
        block_rms = np.sqrt(np.maximum(squares, 0.0) / np.maximum(count, 1))[count > 0]
        uneven[j] = block_rms.max() / max(np.median(block_rms), 1e-300)
    return rms, uneven


def _limits(G: np.ndarray, quantities: Sequence[Quantity]) -> np.ndarray:
    """Find the largest standard deviation of an observable chart: it moves no joint's torque by more than VISIBLE.

    It depends on the motion and the model's residual alone, so that no fault makes a chart unobservable. The column of
    a joint's gain gives its rms torque.
    """
    squares = np.einsum("sjpp->jp", G)[:, :-1]
    torque_squares = np.diag(squares[:, _columns_of(quantities, "gain")])
    share = np.sqrt(squares / np.maximum(torque_squares, 1e-300)[:, None]).max(axis=0)
    largest = [LARGEST_ZERO if quantity.kind == "zero" else np.inf for quantity in quantities]
    return np.minimum(VISIBLE / np.maximum(share, 1e-300), largest)[[quantity.charted for quantity in quantities]]


def normal_equations(
    model: IdentifiedModel, run: Run, parts: Parts | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Reduce a log to the normal equations ``A^T A``, ``A = [columns | y]``, of the watched quantities.

    Returns the normal equations of each joint in each jackknife block (blocks, n, p + 1, p + 1), rows divided by the
    model's residual; the number of rows (blocks, n); and the mean absolute velocity (n,) of each joint. If given,
    ``parts`` receives the rows.
    """
    idm, base, n = model.idm, model.base, len(model.idm.actuated)
    name = f"run '{run.name}'"
    refuse_floating(model.robot, "watching is")
    run = suited(model, run).ordered(idm.actuated, link_side=False)
    check_wrenches(model.robot, run)
    check_temperature_unit(model, run)
    (prepared,) = prepare_runs(idm, [run], model.preparation)
    decimator = prepared.preparation.decimator
    blocks = block_of(block_edges(prepared), decimator.outputs(len(prepared)))
    if len(blocks) < FEWEST_ROWS:
        least = (run.time[-1] - run.time[0]) * FEWEST_ROWS / max(len(blocks), 1)
        raise TooShort(
            f"{name} gives {len(blocks)} rows a joint at the rate of the identification, {FEWEST_ROWS} are "
            f"needed; give at least {np.ceil(least):.0f} s of motion."
        )
    chi = loaded_parameters(model, run.payload, name)
    load = np.array(transmitted(np, base.standard, chi))
    friction = friction_along(model, prepared, chi)
    quantities, payload = quantities_of(model)
    rms = {error.joint: error.rms for error in model.residuals}
    middle = float(np.median([*rms.values()])) if rms else 1.0
    sigma = [rms.get(joint) or middle or 1.0 for joint in idm.actuated]  # torque residuals of the identification
    p = len(quantities)
    G, way = np.zeros((BLOCKS, n, p + 1, p + 1)), np.zeros(n)
    rows = np.zeros((BLOCKS, n), dtype=int)
    for part in stream_rows(idm, idm.columns(base.standard), prepared, decimator, load, friction=friction):
        A = _columns(model, part, load, payload, quantities, run.name)
        for j, kept in enumerate(part.keep[:n]):
            block, values = blocks[part.outputs][kept], A[j, kept] / sigma[j]
            add_products(G[:, j], values, block)
            np.add.at(rows[:, j], block, 1)
            motor = idm.layout.actuated[j]
            q, qd = part.motion.c[motor, kept], part.motion.yd[motor, kept]
            way[j] += float(np.sum(np.abs(qd)))
            if parts is not None:
                parts.append((np.full(len(q), j), q, np.sign(qd), values))
    count = rows.sum(axis=0)
    if not (count >= FEWEST_ROWS).any():
        raise GtauError(
            f"{name} has at most {count.max()} usable rows a joint, away from its reversals and gaps; "
            "give a longer log."
        )
    return G, rows, way / np.maximum(count, 1)


def _columns(
    model: IdentifiedModel, part: Rows, load: np.ndarray, payload: np.ndarray, quantities: Sequence[Quantity], run: str
) -> np.ndarray:
    """Build rows ``[columns | y]`` (n, K, p + 1) from base parameters (n_b,) and payload (n_b, k)."""
    idm, standard = model.idm, model.base.standard
    W = part.matrix(idm.columns(standard), len(idm.actuated))
    tau = W @ load - part.external + part.friction
    gains = model.gains[:, None]
    delays = np.array([model.delays[joint].value or 0.0 for joint in idm.actuated])
    _, v_d, v_dd = part.currents
    A = np.zeros((*tau.shape, len(quantities) + 1))
    A[..., : payload.shape[1]] = W @ payload
    A[..., -1] = gains * np.einsum("ijk,ji->jk", part.currents, delayed(delays)) - tau
    zeros, rate = _motion_slopes(model, part.motion, load, instants(run, part.time))
    viscous = {name: estimate.value for name, estimate in model.friction_parameters.items() if name.kind == "fv"}
    A[..., -2] = rate + W @ [viscous.get(name) or 0.0 for name in standard]
    for k, quantity in enumerate(quantities[payload.shape[1] : -1], start=payload.shape[1]):
        j = idm.actuated.index(quantity.joint)
        match quantity.kind:
            case "gain":
                A[j, :, k] = -tau[j]
            case "delay":
                A[j, :, k] = -gains[j] * (v_d[j] - delays[j] * v_dd[j])
            case "zero":
                A[..., k] = zeros[j]
            case _:
                A[..., k] = W[..., standard.index(quantity.name)]
    return A


def unseen_zeros(model: IdentifiedModel) -> tuple[str, ...]:
    """List the joints of a tree whose encoder zero no motion shows, such as a vertical first axis."""
    idm, base = model.idm, model.base
    if model.robot.closures:  # whose poses need not close with another zero
        return ()
    load = np.array(transmitted(np, base.standard, loaded_parameters(model, None, "the robot")))
    motion = random_motion(idm, STATES, np.random.default_rng(0))
    zeros, _ = _motion_slopes(model, motion, load, instants("random states", np.arange(STATES, dtype=float)))
    torques = idm.columns(base.standard).torques_along(idm.layout, motion, load)
    moved = np.abs(zeros).max(axis=(1, 2)) / np.abs(torques).max()
    return tuple(joint for joint, share in zip(idm.actuated, moved, strict=True) if share < UNSEEN)


def _motion_slopes(
    model: IdentifiedModel, motion: Motion, load: np.ndarray, labels: Labels
) -> tuple[np.ndarray, np.ndarray]:
    """Differentiate the torques (n, K) by each encoder zero (n, n, K), per degree or millimetre, and by the rate."""
    idm = model.idm
    regressor = idm.columns(model.base.standard)
    motors = idm.layout.actuated
    q, qd, qdd = (np.ascontiguousarray(x[motors]) for x in (motion.c, motion.yd, motion.ydd))
    before = regressor.torques_along(idm.layout, motion, load)

    def change(c: np.ndarray, faster: float) -> np.ndarray:
        moved = idm.rates(c, faster * qd, faster**2 * qdd, labels)
        return np.asarray((regressor.torques_along(idm.layout, moved, load) - before) / STEP)

    zeros = np.zeros((len(q), *before.shape))
    for j, (joint, shift) in enumerate(zip(idm.actuated, STEP * np.eye(len(q)), strict=True)):
        with suppress(GtauError):  # the loops may not close there: this zero is not watched
            c = idm.near(motion.c, q + shift[:, None], labels)
            zeros[j] = change(c, 1.0) * ZERO_UNITS[model.robot.joint(joint).kind][1]
    return zeros, change(motion.c, 1 + STEP)
