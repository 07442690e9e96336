"""Torque columns of possible changes since the identification along a log, and their normal equations.

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
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import product

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.friction.law import transmitted
from gtau.estimation.regression.assembly import payload_columns
from gtau.estimation.regression.dataset import at_rate_of
from gtau.estimation.regression.factors import add_products, delayed
from gtau.estimation.regression.plausibility import check_wrenches, prepare_runs
from gtau.estimation.regression.rows import Rows, instants, stream_rows
from gtau.estimation.regression.run_blocks import BLOCKS, block_edges, block_of
from gtau.estimation.results.result import IdentifiedModel
from gtau.model.loops import Labels, Motion
from gtau.model.singularities import random_motion
from gtau.robots.parameter import Parameter, unit_of
from gtau.robots.robot import PLAIN_FRICTION
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run
from gtau.uses.prediction import check_temperature_unit, friction_along, loaded_parameters

STEP = 1e-3  # rad or m of an encoder zero, or share of the rate: torques are linear over this
FEWEST_ROWS = 50  # of a joint in a log, as in an identification
STATES = 50  # at random, at which the zero of a joint moves some torque, or none does
UNSEEN = 1e-6  # of the largest torque, per degree: 0 of the vertical axes of three arms, 6e-8 with a rounded pi/2 in
# the file; 4e-5 and more of all other axes, least of the last one of a UR10e
TITLES = {
    **{f"m{axis}": f"load (first moment {axis})" for axis in "xyz"},
    "gain": "drive gain",
    "fs": "Coulomb friction",
    "fv": "viscous friction",
    "friction": "friction",
    "zero": "encoder zero",
    "delay": "lag of the current",
    "rate": "rate of the clock",
    "rms": "residual",
}
"""Names of kinds that people read; all others are of the load."""
SHOWN = {"1": ("%", 100.0), "s": ("ms", 1000.0)}
"""Units that people read as others, and the factors to them."""
ZERO_UNITS = {"revolute": ("deg", np.pi / 180), "prismatic": ("mm", 1e-3)}


class TooShort(GtauError):
    """Error raised for a log that is too short, however the robot moves in it."""


@dataclass(frozen=True)
class Quantity:
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


def quantities_of(model: IdentifiedModel) -> tuple[tuple[Quantity, ...], np.ndarray]:
    """List the watched quantities of a model in the order of the columns, and the base columns (n_b, k) of a load."""
    robot, standard = model.robot, model.base.standard

    def unit(kind: str, joint: str) -> str:
        if kind == "zero":
            return ZERO_UNITS[robot.joint(joint).kind][0]
        return {"gain": "1", "delay": "s"}.get(kind) or unit_of(kind, robot, joint)

    (payload,) = payload_columns(model.idm, model.base, [Payload(name="load")])
    load_quantities = (Quantity(name.kind, "", unit(name.kind, robot.tool)) for name in payload.unknown)
    joint_quantities = (
        Quantity(kind, joint, unit(kind, joint))
        for kind, joint in product(("gain", "zero", "delay", *PLAIN_FRICTION), robot.motors)
        if kind not in PLAIN_FRICTION or Parameter(kind, joint) in standard
    )
    return (*load_quantities, *joint_quantities, Quantity("rate", "", "1")), payload.columns


def identified(model: IdentifiedModel, name: Parameter) -> float:
    """Return the identified value of a parameter of friction, 0 where there is none."""
    estimate = model.friction_parameters.get(name)
    return 0.0 if estimate is None else estimate.value or 0.0


def normal_equations(
    model: IdentifiedModel, run: Run, parts: list[tuple[np.ndarray, ...]] | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Reduce a log to the normal equations ``A^T A``, ``A = [columns | y]``, of the watched quantities.

    Returns the normal equations of each joint in each jackknife block (blocks, n, p + 1, p + 1), rows divided by the
    model's residual; the number of rows (blocks, n); and the mean absolute velocity (n,) of each joint. If given,
    ``parts`` receives the joint, position, direction and values ``[columns | y]`` (K, p + 1) of the rows (K,). Raises
    GtauError.
    """
    idm, base, n = model.idm, model.base, len(model.idm.actuated)
    if model.robot.floating:
        raise GtauError(f"the base of robot '{model.robot.name}' floats; only robots with a fixed base are watched.")
    if run.kind != model.kind:
        raise GtauError(
            f"run '{run.name}' holds {run.kind}s, but the model was identified from {model.kind}s; give a log of the "
            "same kind."
        )
    run = run.ordered(idm.actuated, link_side=False)
    check_wrenches(model.robot, run)
    check_temperature_unit(model, run)
    preparation = at_rate_of([run], model.preparation)
    (prepared,) = prepare_runs(idm, [run], preparation)
    decimator = preparation.at(run.rate).decimator
    blocks = block_of(block_edges(prepared), decimator.outputs(len(prepared)))
    if len(blocks) < FEWEST_ROWS:
        least = (run.time[-1] - run.time[0]) * FEWEST_ROWS / max(len(blocks), 1)
        raise TooShort(
            f"run '{run.name}' gives {len(blocks)} rows a joint at the rate of the identification, {FEWEST_ROWS} are "
            f"needed; give at least {np.ceil(least):.0f} s of motion."
        )
    chi = loaded_parameters(model, run.payload, f"run '{run.name}'")
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
            block = blocks[part.outputs][kept]
            add_products(G[:, j], A[j, kept] / sigma[j], block)
            np.add.at(rows[:, j], block, 1)
            q, qd = (states[idm.layout.actuated[j], kept] for states in (part.motion.c, part.motion.yd))
            way[j] += float(np.sum(np.abs(qd)))
            if parts is not None:
                parts.append((np.full(len(q), j), q, np.sign(qd), A[j, kept] / sigma[j]))
    count = rows.sum(axis=0)
    if not (count >= FEWEST_ROWS).any():
        raise GtauError(
            f"run '{run.name}' has at most {count.max()} usable rows a joint, away from its reversals and gaps; give a "
            "longer log."
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
    A[..., -2] = rate + W @ [identified(model, name) * (name.kind == "fv") for name in standard]
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
    q, qd, qdd = (np.ascontiguousarray(states[idm.layout.actuated]) for states in (motion.c, motion.yd, motion.ydd))
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
