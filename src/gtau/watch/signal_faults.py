"""Faults that the samples of the newest log show: a frozen encoder, exchanged columns, a rub, a ripple.

They are considered if all quantities, free at every joint, leave a larger residual than in healthy logs. A fault is
named if it leaves far less: after two columns are exchanged back, or after a function of one joint's position is
removed from its residual, by the mixed model of :mod:`gtau.estimation.effects`. A residual that is as uneven along the
log as after a contact is no function of the position. An encoder is frozen if it stands still in such a log and moved
in earlier logs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, product

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.effects.knots import hats
from gtau.estimation.effects.mixed_model import MixedModel, fit_mixed, lag_products
from gtau.estimation.results.result import IdentifiedModel
from gtau.robots.parameter import torque_unit
from gtau.signals.run import Run
from gtau.watch.history import Cause
from gtau.watch.quantities import normal_equations
from gtau.watch.statistics import RESIDUAL, UNEVEN, LogStatistics, residuals_of, unevenness

SIGNAL_FAULTS = ("frozen", "exchanged", "rub", "ripple")
FEW_VALUES = 8  # most positions of a frozen encoder; a joint with 4096 steps a turn takes more within a degree
STILL, LIVELY = 0.1, 0.5  # share of a log with one position, and of the command's scatter elsewhere meanwhile: of
# joints at rest in healthy logs of a UR10e, 8 of 30 exceed both, but all quantities leave nothing there
GROWN = 2.0  # residual squares of a joint over healthy logs: at most 1.8 in 14 healthy logs of two measured arms
LEFT = 0.5  # share of the excess residual that the right fault leaves: at most 0.04 for 46 faults put into healthy logs
# of a five-bar, a UR10e and an xMate 7 Pro; 11 and more for the same faults in logs with lags of 20 and 40 ms
NODES = 61  # of a piecewise linear function over a joint's range
STEPS = np.tri(NODES) / np.sqrt(NODES)  # its steps from node to node are what is random
LARGEST = 50.0  # times the residual of the model: standard deviation of the function before the data
EXTREMES = (0.02, 0.98)  # quantiles of it along the log, between which its size is stated


def signal_faults(
    model: IdentifiedModel, log: LogStatistics, healthy: np.ndarray, speed: np.ndarray, uneven: np.ndarray
) -> tuple[Cause, ...]:
    """Name the fault that the samples of a log show.

    Earlier logs had ``healthy`` charts (k,), mean velocities ``speed`` (n,) and ``uneven`` residuals (n,).
    """
    run, parts = log.run.ordered(model.idm.actuated, link_side=False), list[tuple[np.ndarray, ...]]()
    friction = [k for k, quantity in enumerate(log.quantities) if quantity.group == "friction"]
    usual = np.exp(2 * healthy[[chart.kind == RESIDUAL for chart in log.charts]])
    single, all_free = _mean_squares(model, run, parts, friction, [*range(len(log.quantities))])
    seen, grown = np.isfinite(single + usual), single > GROWN * usual
    if not (all_free > GROWN * usual)[seen].any():
        return ()
    if frozen := tuple(_frozen(run, speed)):
        return frozen
    limit = LEFT * float(np.maximum(all_free - usual, 0.0)[seen].sum())
    faults = [
        _position_fault(model, run, parts, friction, single, j)
        for j in np.flatnonzero(grown & (unevenness(log, uneven) < UNEVEN)).tolist()
    ]
    faults += _exchanged(model, run, friction, grown)
    misfits = [float(np.maximum(squares - usual, 0.0)[seen].sum()) for _, squares in faults]
    best = int(np.argmin([*misfits, limit]))
    return (faults[best][0],) if best < len(faults) else ()


def _mean_squares(
    model: IdentifiedModel, run: Run, parts: list[tuple[np.ndarray, ...]] | None, *free: list[int]
) -> list[np.ndarray]:
    """Compute each joint's mean squared residual (n,) over the model's, for each choice of ``free`` columns."""
    G, rows, _ = normal_equations(model, run, parts)
    return [np.exp(2 * residuals_of(G, rows, columns, np.ones(len(G), dtype=bool))[0]) for columns in free]


def _frozen(run: Run, speed: np.ndarray) -> Iterator[Cause]:
    """Find joints that moved in earlier logs and whose position is now constant while the command is not.

    The size of the fault is the share of the log with one position.
    """
    for joint, q, v in ((run.joints[j], run.position[:, j], run.command[:, j]) for j in np.flatnonzero(speed > 0)):
        begins = np.flatnonzero(np.diff(q, prepend=np.nan) != 0)
        lengths = np.diff(begins, append=len(q))
        still = np.repeat(np.arange(len(begins)) == np.argmax(lengths), lengths)
        share = float(still.mean())
        if len(np.unique(q)) < FEW_VALUES or (STILL < share < 1 and v[still].std() > LIVELY * v[~still].std()):
            text = f"frozen encoder of {joint} (one position in {100 * share:.0f} % of the log)"
            advice = "check the encoder, its cable and the column of its position"
            yield Cause(kind="frozen", joint=joint, size=share, text=text, advice=advice)


def _exchanged(
    model: IdentifiedModel, run: Run, friction: list[int], grown: np.ndarray
) -> Iterator[tuple[Cause, np.ndarray]]:
    """Exchange columns of two joints back, and compute the mean squared residuals (n,)."""
    for pair, column in product(combinations(np.flatnonzero(grown), 2), ("position", "command")):
        values = getattr(run, column).copy()
        values[:, pair] = values[:, pair[::-1]]
        try:
            (squares,) = _mean_squares(model, replace(run, **{column: values}), None, friction)
        except GtauError:  # the loops do not close there
            continue
        joints = " and ".join(run.joints[j] for j in pair)
        text = f"{run.kind if column == 'command' else column}s of {joints} exchanged"
        advice = "check the order of the columns of the log"
        yield Cause(kind="exchanged", joint=joints, size=1.0, text=text, advice=advice), squares


def _position_fault(
    model: IdentifiedModel,
    run: Run,
    parts: list[tuple[np.ndarray, ...]],
    friction: list[int],
    single: np.ndarray,
    joint: int,
) -> tuple[Cause, np.ndarray]:
    """Fit friction and torque as functions of a joint's position, and compute the mean squared residuals (n,) then.

    The one whose removal loses more likelihood is the cause.
    """
    joints, *rows = (np.concatenate(part) for part in zip(*parts, strict=True))
    q, direction, table = (part[joints == joint] for part in rows)
    shape = hats(q[:, None], np.linspace([q.min()], [q.max()], NODES))[:, 0].T @ STEPS
    columns = np.hstack([direction[:, None] * shape, shape, table[:, [*friction, -1]]])
    products = (lag_products(columns, np.arange(len(columns)) == 0),)
    free, part = np.zeros((len(friction) + 1, len(friction) + 1)), np.repeat([0, 1], NODES)
    fit = fit_mixed(MixedModel(products, free, part, np.zeros(0, dtype=int), np.full(2, LARGEST)))
    k = int(np.argmax([fit.lost_without([0]), fit.lost_without([1])]))
    squares, function = single.copy(), shape @ (fit.sizes[k] * fit.at.own[0][part == k])
    squares[joint] = np.mean((columns @ fit.model.coefficients(fit.sizes, fit.at, 0)) ** 2)
    name, rms = run.joints[joint], {error.joint: error.rms for error in model.residuals}
    unit, size = torque_unit(model.robot, name), float(np.ptp(np.quantile(function, EXTREMES)) * (rms.get(name) or 1.0))
    if k == 0:
        kind, text = "rub", f"rub of {name} (friction that differs by {size:.2g} {unit} along its range)"
        advice = "check bearings, seals, covers and cables of the joint"
    else:
        kind, text = "ripple", f"ripple of {name} (torque that differs by {size:.2g} {unit} with its position)"
        advice = "check gear and bearings of the joint, and cables or springs that pull at it"
    return Cause(kind=kind, joint=name, size=size, unit=unit, text=text, advice=advice), squares
