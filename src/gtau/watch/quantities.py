"""Torque columns of possible changes since the identification along a log, and their normal equations.

The residual of the identified model along a log, ``y = g v(t - d) - tau_model`` (eq. 16), is held against one column a
quantity: the torque that one unit of its change adds. The rows are those of the identification: the same filters,
decimation and exclusion of reversals, after subtraction of the model's friction law.

======  ===========================================  ==============================
kind    change                                       column
======  ===========================================  ==============================
load    mass, first moments, inertia on the tool     those of the payload (eq. 18)
gain    drive gain, at fixed inertia                 ``-tau_model``
zero    encoder zero                                 ``d tau / d q``
delay   lag of the current behind the position       ``-g v'``
fv, fs  viscous and Coulomb friction                 ``qd``, ``sign(qd)``
off     offset of the current                        1
======  ===========================================  ==============================
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.friction.law import transmitted
from gtau.estimation.regression.column_blocks import payload_columns
from gtau.estimation.regression.dataset import at_rate_of
from gtau.estimation.regression.factors import add_products, delayed
from gtau.estimation.regression.plausibility import check_wrenches, prepare_runs
from gtau.estimation.regression.rows import Rows, instants, stream_rows
from gtau.estimation.regression.run_blocks import BLOCKS, block_edges, block_of
from gtau.estimation.results.result import Result
from gtau.robots.parameter import Parameter, unit_of
from gtau.robots.robot import PLAIN_FRICTION
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run
from gtau.uses.prediction import check_temperature_unit, friction_along, loaded_parameters

STEP = 1e-3  # rad or m, of an encoder zero: torques are linear over this
FEWEST_ROWS = 50  # of a joint in a log, as in an identification
ZERO_UNITS = {"revolute": ("deg", np.pi / 180), "prismatic": ("mm", 1e-3)}


class TooShort(GtauError):
    """Error raised for a log that is too short, however the robot moves in it."""


@dataclass(frozen=True)
class Quantity:
    """A watched quantity: its kind (that of a payload's parameter for the load), joint and unit."""

    kind: str
    joint: str
    unit: str

    @property
    def name(self) -> str:
        """Name in tables and files, such as ``gain_elbow``."""
        return Parameter(self.kind, self.joint or "load")

    @property
    def charted(self) -> bool:
        """Whether it has a chart: inertia of the load and offsets are estimated with the others."""
        return self.kind != "off" if self.joint else self.kind in ("m", "mx", "my", "mz")

    @property
    def group(self) -> str:
        """``load``, or the kind itself."""
        return self.kind if self.joint else "load"


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Normal equations of a log, ``A^T A`` with ``A = [columns | y]``, rows divided by the model's own residual.

    ``G`` (blocks, n, p + 1, p + 1) of the equations of each joint in each block that the jackknife leaves out;
    ``rows`` (blocks, n) behind them; ``tau`` (n,) rms torque of each joint, ``sigma`` (n,) the residual by which its
    rows are divided, N m or N, and ``speed`` (n,) its mean absolute velocity.
    """

    quantities: tuple[Quantity, ...]
    G: np.ndarray
    rows: np.ndarray
    tau: np.ndarray
    sigma: np.ndarray
    speed: np.ndarray

    @property
    def friction(self) -> list[int]:
        """Columns of friction and offsets."""
        return [k for k, quantity in enumerate(self.quantities) if quantity.group in PLAIN_FRICTION]

    @property
    def load(self) -> list[int]:
        """Columns of the load."""
        return [k for k, quantity in enumerate(self.quantities) if quantity.group == "load"]

    @property
    def charts(self) -> list[int]:
        """Columns of the charts."""
        return [k for k, quantity in enumerate(self.quantities) if quantity.charted]


def quantities_of(model: Result, of_load: Iterable[str]) -> tuple[Quantity, ...]:
    """List the watched quantities of a model and the parameters ``of_load``, in the order of the columns."""
    robot, motors = model.robot, model.robot.motors
    units = {joint: ZERO_UNITS[robot.joint(joint).kind][0] for joint in motors}
    return (
        *(Quantity(kind, "", unit_of(kind, robot, robot.tool)) for kind in of_load),
        *(Quantity("gain", joint, "1") for joint in motors),
        *(Quantity("zero", joint, units[joint]) for joint in motors),
        *(Quantity("delay", joint, "s") for joint in motors),
        *(
            Quantity(kind, joint, unit_of(kind, robot, joint))
            for kind, joint in product(PLAIN_FRICTION, motors)
            if Parameter(kind, joint) in model.base.standard
        ),
    )


def charts_of(model: Result) -> tuple[Quantity, ...]:
    """List the charts of a model."""
    (payload,) = payload_columns(model.idm, model.base, [Payload(name="load")])
    quantities = quantities_of(model, [name.kind for name in payload.unknown])
    return tuple(quantity for quantity in quantities if quantity.charted)


def normal_equations(model: Result, run: Run) -> NormalEquations:
    """Reduce a log to the normal equations of the watched quantities; raises GtauError."""
    if model.robot.floating:
        raise GtauError(f"the base of robot '{model.robot.name}' floats; only robots with a fixed base are watched.")
    if run.kind != model.kind:
        raise GtauError(
            f"run '{run.name}' holds {run.kind}s, but the model was identified from {model.kind}s; give a log of the "
            "same kind."
        )
    idm, base = model.idm, model.base
    run = run.ordered(idm.actuated, link_side=False)
    check_wrenches(model.robot, run)
    check_temperature_unit(model, run)
    preparation = at_rate_of([run], model.preparation)
    (prepared,) = prepare_runs(idm, [run], preparation)
    decimator, n = preparation.at(run.rate).decimator, len(idm.actuated)
    chi = loaded_parameters(model, run.payload, f"run '{run.name}'")
    load, friction = np.array(transmitted(np, base.standard, chi)), friction_along(model, prepared, chi)
    (payload,) = payload_columns(idm, base, [Payload(name="load")])
    quantities, sigma = quantities_of(model, [name.kind for name in payload.unknown]), _sigma(model)
    p = len(quantities)
    G, rows = np.zeros((BLOCKS, n, p + 1, p + 1)), np.zeros((BLOCKS, n), dtype=int)
    power, way = np.zeros(n), np.zeros(n)
    blocks = block_of(block_edges(prepared), decimator.outputs(len(prepared)))
    if len(blocks) < FEWEST_ROWS:
        least = run.time[-1] - run.time[0]
        least *= FEWEST_ROWS / max(len(blocks), 1)
        raise TooShort(
            f"run '{run.name}' gives {len(blocks)} rows a joint at the rate of the identification, {FEWEST_ROWS} are "
            f"needed; give at least {np.ceil(least):.0f} s of motion."
        )
    regressor = idm.columns(base.standard)
    for part in stream_rows(idm, regressor, prepared, decimator, load, friction=friction):
        A, tau = _columns(model, part, load, payload.columns, quantities, run.name)
        for j, kept in enumerate(part.keep[:n]):
            block = blocks[part.outputs][kept]
            add_products(G[:, j], A[j, kept] / sigma[j], block)
            np.add.at(rows[:, j], block, 1)
            power[j] += float(np.sum(tau[j, kept] ** 2))
            way[j] += float(np.sum(np.abs(part.motion.yd[idm.layout.actuated[j], kept])))
    count = rows.sum(axis=0)
    if not (count >= FEWEST_ROWS).any():
        raise GtauError(
            f"run '{run.name}' has at most {count.max()} usable rows a joint, away from its reversals and gaps; give a "
            "longer log."
        )
    count = np.maximum(count, 1)
    return NormalEquations(quantities, G, rows, np.sqrt(power / count), sigma, way / count)


def _sigma(model: Result) -> np.ndarray:
    """Take the torque residual (n,) of the identification; of a joint without one the median of the others."""
    known = {error.joint: error.rms for error in model.residuals}
    middle = float(np.median([*known.values()])) if known else 1.0
    return np.array([known.get(joint) or middle or 1.0 for joint in model.robot.actuated])


def _columns(
    model: Result, part: Rows, load: np.ndarray, payload: np.ndarray, quantities: Sequence[Quantity], run: str
) -> tuple[np.ndarray, np.ndarray]:
    """Build rows ``[columns | y]`` (n, K, p + 1) and torques (n, K) of base parameters and payload (n_b, k)."""
    idm = model.idm
    n, regressor = len(idm.actuated), idm.columns(model.base.standard)
    W = part.matrix(regressor, n)
    assert part.friction is not None
    tau = W @ load - part.external + part.friction
    delays = np.array([model.delays[joint].value or 0.0 for joint in idm.actuated])
    _, v_d, v_dd = part.currents
    gains = model.gains[:, None]
    measured = gains * np.einsum("ijk,ji->jk", part.currents, delayed(delays))
    rate = gains * (v_d - delays[:, None] * v_dd)
    A = np.zeros((n, len(part.time), len(quantities) + 1))
    A[..., : payload.shape[1]] = W @ payload
    zeros = _of_zeros(model, part, load, run)
    for k, quantity in enumerate(quantities):
        if not quantity.joint:
            continue
        j = idm.actuated.index(quantity.joint)
        match quantity.kind:
            case "gain":
                A[j, :, k] = -tau[j]
            case "delay":
                A[j, :, k] = -rate[j]
            case "zero":
                A[:, :, k] = zeros[j]
            case _:
                A[:, :, k] = W[:, :, model.base.standard.index(quantity.name)]
    A[..., -1] = measured - tau
    return A, tau


def _of_zeros(model: Result, part: Rows, load: np.ndarray, run: str) -> np.ndarray:
    """Differentiate the torques (n, K) with respect to each encoder zero, (n, n, K), per degree or millimetre."""
    idm = model.idm
    n, actuated = len(idm.actuated), idm.layout.actuated
    regressor, motion, labels = idm.columns(model.base.standard), part.motion, instants(run, part.time)
    q, qd, qdd = (np.ascontiguousarray(states[actuated]) for states in (motion.c, motion.yd, motion.ydd))
    before = regressor.torques_along(idm.layout, motion, load)
    columns = np.zeros((n, n, len(part.time)))
    for j, joint in enumerate(idm.actuated):
        moved = q.copy()
        moved[j] += STEP
        try:
            c = idm.near(motion.c, moved, labels)
        except GtauError:
            continue  # the loops do not close there: this zero is not watched
        along = regressor.torques_along(idm.layout, idm.rates(c, qd, qdd, labels), load)
        columns[j] = (along - before) / STEP * ZERO_UNITS[model.robot.joint(joint).kind][1]
    return columns
