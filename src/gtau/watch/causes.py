"""Causes of a change: faults of a log's samples, and competing hypotheses on the charts.

A change of one kind (gain, load, friction, warming, zero, delay, clock) moves all charts in a known way
(``response``). Each hypothesis is fitted by generalised least squares to the difference between the logs after the
change and the logs before it, or the model, with the covariance between healthy logs. All causes that are nearly as
likely as the best one are listed, because they cannot be distinguished. A single cause has the size that its own charts
show (2.82 to 2.84 kg for 2.805 kg on a UR10e; all charts together 2.84 to 2.90). Pairs of causes are tried where no
single cause explains the change. Implausible sizes are not offered, nor changes whose interval includes 0.

With some ten logs and forty charts the empirical covariance is singular; it is shrunk towards the standard deviations
of the logs with the correlations that independent residuals would have (``formula``).

Faults that the samples of the newest log show come first: a frozen encoder, exchanged columns, a rub, a ripple. They
are considered if all quantities, free at every joint, leave a larger residual than in healthy logs. A fault is named if
it leaves far less: after two columns are exchanged back, or after a function of one joint's position is removed from
its residual, by the mixed model of :mod:`gtau.estimation.effects`. A residual that is as uneven along the log as after
a contact is no function of the position. An encoder is frozen if it stands still in such a log and moved in earlier
logs.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, product
from operator import itemgetter

import numpy as np
from scipy.special import stdtrit

from gtau.errors import GtauError
from gtau.estimation.effects.effect import hats
from gtau.estimation.effects.mixed_model import MixedModel, fit_mixed, lag_products
from gtau.estimation.results.result import IdentifiedModel
from gtau.findings import to_width
from gtau.robots.parameter import torque_unit
from gtau.signals.run import Run
from gtau.watch import statistics
from gtau.watch.detectors import FEWEST, mean_of
from gtau.watch.history import Cause

CLOSE = 9.2  # 2 log(100): the best explanation is a hundred times as likely
PER_PARAMETER = 2.0  # minimum improvement of the misfit per additional parameter, by Akaike's criterion
CERTAIN = 3.0  # standard deviations from zero of the parameter stated first: mass, Coulomb friction
EXPLAINED = 0.5  # minimum explained share of the squared change
POOR = 3.0  # misfit per chart of a single cause above which pairs are tried
SECOND = 0.3  # share of this misfit below which a pair explains the change
CORRELATED = 5.7  # logs that count as one: (1 + rho) / (1 - rho) at a correlation of 0.7
REACH = 1.0  # m at most from the flange to the centre of mass of a load
LARGEST = {"zero": (-20.0, 20.0), "delay": (-0.2, 0.2), "rate": (-0.5, 0.5)}  # deg or mm, s, share
STOPPED = -1.1  # least relative change of friction: it cannot fall below 0, with a margin
LEADING = ("m", "fs")  # stated first
RESCALED = 2.0  # a gain that changes by a larger factor is a unit or a sign of the channel

SIGNAL_FAULTS = ("frozen", "exchanged", "rub", "ripple")
FEW_VALUES = 8  # most positions of a frozen encoder; a joint with 4096 steps a turn takes more within a degree
STILL, LIVELY = 0.1, 0.5  # share of a log with one position, and of the command's scatter elsewhere meanwhile
GROWN = 2.0  # residual squares of a joint over healthy logs
LEFT = 0.5  # share of the excess residual that the right fault leaves
NODES = 61  # of a piecewise linear function over a joint's range
STEPS = np.tri(NODES) / np.sqrt(NODES)  # its steps from node to node are what is random
LOOSE = 50.0  # times the residual of the model: standard deviation of the function before the data
EXTREMES = (0.02, 0.98)  # quantiles of it along the log, between which its size is stated

COMMON = {"gain": "drive gain of all drives", "clock": "lag of all currents", "warming": "friction of all joints"}
"""Names of changes of all joints at once."""
ADVICE = {
    "load": "compare the mounted load with the payload set in the controller, and weigh it by 'gtau payload'",
    "gain": "check motor, belt and gear, then identify the robot again",
    "friction": "check temperature, lubrication, brake and gear",
    "warming": "check the temperature of robot and hall",
    "zero": "check the encoder's zero against its mark, and the coupling",
    "delay": "check the current logging and its filters",
    "clock": "check the time stamps of the log",
    "rate": "check the sampling rate and the time stamps of the log",
    "units": "check units, signs and order of the columns of the log",
    "contact": "check for cables and obstacles that touch the robot, and run the motion again",
    "frozen": "check the encoder, its cable and the column of its position",
    "exchanged": "check the order of the columns of the log",
    "rub": "check bearings, seals, covers and cables of the joint",
    "ripple": "check gear and bearings of the joint, and cables or springs that pull at it",
}
Hypothesis = tuple[str, str, np.ndarray]
"""A kind of change, its joint, and combinations (p, c) of the quantities, of which charted ones can be stated."""


def _cause(kind: str, joint: str, size: float, text: str, unit: str = "1") -> Cause:
    return Cause(kind=kind, joint=joint, size=size, unit=unit, text=text, advice=ADVICE[kind])


def causes_of(
    model: IdentifiedModel,
    log: statistics.LogStatistics,
    before: np.ndarray,
    after: np.ndarray,
    healthy: np.ndarray,
    heaviest: float,
) -> tuple[Cause, ...]:
    """Find the causes that fit a change and cannot be distinguished, the best one first.

    Charts (logs, k) ``after`` the change are compared with ``healthy`` (k,); charts ``before`` it give the scatter. The
    motion of the newest ``log`` determines the signature of each change. A load is at most ``heaviest`` kg.
    """
    usable = log.shown & np.isfinite(healthy) & np.isfinite(after).any(axis=0)
    usable &= (np.isfinite(before).sum(axis=0) >= FEWEST) | (len(before) < FEWEST)
    rows = np.flatnonzero(usable & [chart.kind != statistics.RESIDUAL for chart in log.charts])
    if not len(rows):
        return ()
    complete = before[:, rows][np.isfinite(before[:, rows]).all(axis=1)]
    share = sum(1 / max(len(logs) / CORRELATED, 1.0) for logs in (complete, after))
    sigma = share * _covariance(complete, log.formula[np.ix_(rows, rows)])
    L = np.linalg.cholesky(sigma + 1e-12 * np.diag(np.diag(sigma)))
    difference = mean_of(after[:, rows]) - healthy[rows]
    change, response = np.linalg.solve(L, difference), np.linalg.solve(L, log.response[rows])
    charts = np.array([[quantity == log.charts[row] for quantity in log.quantities] for row in rows])
    factor = float(stdtrit(max(len(complete) - 1, FEWEST), 0.975))

    def fit(*several: Hypothesis) -> list[tuple[float, Cause]]:
        """Fit one or two hypotheses together; return misfit and cause, or nothing if one is implausible."""
        columns = [columns for *_, columns in several]
        ends = np.cumsum([part.shape[1] for part in columns])[:-1]
        sizes, std, misfit = _fit(change, response @ np.hstack(columns))
        if len(several) == 1:  # its own charts are estimates of this change alone
            own = charts @ columns[0]
            alone = own.sum(axis=0) == 1
            sizes, std = np.where(alone, difference @ own, sizes), np.where(alone, np.sqrt(np.diag(sigma)) @ own, std)
        parts = zip(several, np.split(sizes, ends), np.split(factor * std, ends), strict=True)
        first, *more = (_stated(model, log, heaviest, *part) for part in parts)
        # where a channel is rescaled, the charts are too far from linear to show another change beside it
        if first is None or any(other is None or (other.kind == "units") != (first.kind == "units") for other in more):
            return []
        return [(misfit, first.model_copy(update={"and_also": more[0] if more else None}))]

    hypotheses = list(_hypotheses(model, log.quantities))
    fits = [fitted for hypothesis in hypotheses for fitted in fit(hypothesis)]
    squares = float(change @ change)
    single = min((misfit for misfit, _ in fits), default=squares)
    if single > POOR * len(rows):
        pairs = [fitted for pair in combinations(hypotheses, 2) for fitted in fit(*pair)]
        fits = [fitted for fitted in pairs if fitted[0] < SECOND * single] or fits
    fits.sort(key=itemgetter(0))
    best = fits[0][0] if fits else np.inf
    if best - PER_PARAMETER > (1 - EXPLAINED) * squares:
        return ()
    scale = max(1.0, best / max(len(rows) - 1, 1))  # large changes are not exactly linear
    return tuple(cause for misfit, cause in fits if misfit - best < CLOSE * scale)


def _fit(y: np.ndarray, S: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Fit a whitened change ``y``: sizes (c,), standard deviations, and misfit."""
    norms = np.linalg.norm(S, axis=0)
    norms[norms == 0] = np.inf
    S = S / norms
    x, _, rank, _ = np.linalg.lstsq(S, y, rcond=1e-6)
    misfit = float(np.sum((y - S @ x) ** 2))
    variances = np.diag(np.linalg.pinv(S.T @ S, rcond=1e-8)) * max(1.0, misfit / max(len(y) - int(rank), 1))
    return x / norms, np.sqrt(variances) / norms, misfit + PER_PARAMETER * int(rank)


def _stated(
    model: IdentifiedModel,
    log: statistics.LogStatistics,
    heaviest: float,
    hypothesis: Hypothesis,
    sizes: np.ndarray,
    halves: np.ndarray,
) -> Cause | None:
    """Make a cause of the first parameter of a hypothesis whose interval excludes 0, if it is certain, or the best."""
    kind, joint, columns = hypothesis
    quantities = [log.quantities[k] for k in np.argmax(np.abs(columns), axis=0)]
    stated = [k for k, quantity in enumerate(quantities) if quantity.charted or kind == "rate"]
    certain = [k for k in stated if abs(sizes[k]) > halves[k]]
    if not certain:
        return None
    t = np.abs(sizes) / np.where(halves > 0, halves, np.inf)
    at = certain[0] if t[certain[0]] > CERTAIN / 2 else max(certain, key=lambda k: t[k])
    size, half, quantity = float(sizes[at]), float(halves[at]), quantities[at]
    if kind == "gain":  # the current shows the model's torque divided by 1 + delta
        apparent = 1 - size
        if 1 / RESCALED < apparent < RESCALED:
            size, half = size / apparent, half / apparent**2
        else:
            kind, size = "units", apparent
    known = statistics.identified(model, quantity.name) if kind == "friction" else 1.0 if kind == "warming" else 0.0
    least, most = LARGEST.get(quantity.kind, (-np.inf, np.inf))
    if kind == "load":
        load = log.run.payload
        carried = 0.0 if load is None else load.mass or model.payload(load.name)["m"]
        least, most = (-carried if quantity.kind == "m" else -heaviest * REACH) - half, heaviest
    if not least <= size <= most or (known and size / known < STOPPED):
        return None
    unit = "1" if kind in ("warming", "units") else quantity.unit
    relative = size / known if known and joint else None
    shown, factor = statistics.SHOWN.get(unit, (unit, 1.0))
    title = quantity.title if joint else COMMON.get(kind, quantity.title)
    width = factor * half
    text = f"{title} {'+' * (size > 0)}{to_width(factor * size, width)} ± {to_width(width, width)} {shown}"
    if kind == "units":
        text = f"scale of the current of {joint or 'all drives'} {size:.3g} times"
    elif relative is not None:
        text += f", {100 * relative:+.0f} % of the model's"
    more = {"quantity": quantity.kind, "half": half, "relative": relative}
    return _cause(kind, joint, size, text, unit).model_copy(update=more)


def _hypotheses(model: IdentifiedModel, quantities: tuple[statistics.Quantity, ...]) -> Iterator[Hypothesis]:
    groups = defaultdict[tuple[str, str], list[int]](list)
    for k, quantity in enumerate(quantities):
        if quantity.kind != "off":
            groups[quantity.group, quantity.joint].append(k)
    for (group, joint), members in groups.items():
        yield group, joint, np.eye(len(quantities))[:, sorted(members, key=lambda k: quantities[k].kind not in LEADING)]
    if len({quantity.joint for quantity in quantities} - {""}) > 1:
        for kind, group in (("clock", "delay"), ("gain", "gain")):
            yield kind, "", np.array([[float(quantity.group == group)] for quantity in quantities])
        felt = [quantity.group == "friction" and quantity.charted for quantity in quantities]
        friction = [statistics.identified(model, quantities[k].name) for k in np.flatnonzero(felt)]
        yield "warming", "", np.eye(len(quantities))[:, felt] @ np.transpose([friction])


def _covariance(values: np.ndarray, formula: np.ndarray) -> np.ndarray:
    """Estimate the covariance (k, k) between healthy logs, with correlations shrunk to the formula's."""
    logs, k = values.shape
    deviations = values - (values.mean(axis=0) if logs else 0.0)
    S = deviations.T @ deviations / max(logs - 1, 1)
    sizes = np.sqrt(np.maximum(np.diag(S), np.diag(formula) / 4))
    formula_std = np.sqrt(np.maximum(np.diag(formula), 1e-300))
    target = formula / formula_std / formula_std[:, None]
    share = k / (k + max(logs - 1, 0))
    R = share * (0.9 * target + 0.1 * np.eye(k)) + (1 - share) * (S / sizes / sizes[:, None])
    np.fill_diagonal(R, 1.0)
    return np.asarray(R * sizes * sizes[:, None])


def contacts_of(log: statistics.LogStatistics, uneven: np.ndarray) -> tuple[Cause, ...]:
    """Suspect a contact if a joint's residual is far more uneven along the log than in any healthy log."""
    ratio = log.uneven / uneven
    j = int(np.argmax(ratio))
    if ratio[j] < statistics.UNEVEN:
        return ()
    joint = [chart.joint for chart in log.charts if chart.kind == statistics.RESIDUAL][j]
    text = f"contact of {joint} (residual {ratio[j]:.3g} times less even than in any healthy log)"
    return (_cause("contact", joint, float(ratio[j]), text),)


def signal_faults(
    model: IdentifiedModel, log: statistics.LogStatistics, healthy: np.ndarray, speed: np.ndarray, uneven: np.ndarray
) -> tuple[Cause, ...]:
    """Name the fault that the samples of a log show, given charts, speeds and unevenness of healthy logs."""
    run = log.run.ordered(model.idm.actuated, link_side=False)
    parts: statistics.Parts = []
    friction = [k for k, quantity in enumerate(log.quantities) if quantity.group == "friction"]
    usual = np.exp(2 * healthy[[chart.kind == statistics.RESIDUAL for chart in log.charts]])
    single, all_free = _mean_squares(model, run, parts, friction, [*range(len(log.quantities))])
    seen, grown = np.isfinite(single + usual), single > GROWN * usual
    if not (all_free > GROWN * usual)[seen].any():
        return ()
    if frozen := tuple(_frozen(run, speed)):
        return frozen
    limit = LEFT * float(np.maximum(all_free - usual, 0.0)[seen].sum())
    local = np.flatnonzero(grown & (log.uneven < statistics.UNEVEN * uneven))
    faults = [_position_fault(model, run, parts, friction, single, j) for j in local.tolist()]
    faults += _exchanged(model, run, friction, grown)
    misfits = [float(np.maximum(squares - usual, 0.0)[seen].sum()) for _, squares in faults]
    best = int(np.argmin([*misfits, limit]))
    return (faults[best][0],) if best < len(faults) else ()


def _mean_squares(
    model: IdentifiedModel, run: Run, parts: statistics.Parts | None, *free: list[int]
) -> list[np.ndarray]:
    """Compute each joint's mean squared residual (n,) over the model's, for each choice of ``free`` columns."""
    G, rows, _ = statistics.normal_equations(model, run, parts)
    return [np.exp(2 * statistics.residuals_of(G, rows, columns, np.ones(len(G), dtype=bool))[0]) for columns in free]


def _frozen(run: Run, speed: np.ndarray) -> Iterator[Cause]:
    """Find joints that moved in earlier logs, whose position is constant while the command is not."""
    for j in np.flatnonzero(speed > 0):
        q, v = run.position[:, j], run.command[:, j]
        begins = np.flatnonzero(np.diff(q, prepend=np.nan) != 0)
        lengths = np.diff(begins, append=len(q))
        still = np.repeat(np.arange(len(begins)) == np.argmax(lengths), lengths)
        share = float(still.mean())
        if len(np.unique(q)) < FEW_VALUES or (STILL < share < 1 and v[still].std() > LIVELY * v[~still].std()):
            joint = run.joints[j]
            text = f"frozen encoder of {joint} (one position in {100 * share:.0f} % of the log)"
            yield _cause("frozen", joint, share, text)


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
        yield _cause("exchanged", joints, 1.0, text), squares


def _position_fault(
    model: IdentifiedModel, run: Run, parts: statistics.Parts, friction: list[int], single: np.ndarray, joint: int
) -> tuple[Cause, np.ndarray]:
    """Fit friction and torque as functions of a joint's position: the likelier cause, and what it leaves (n,)."""
    joints, *rows = (np.concatenate(part) for part in zip(*parts, strict=True))
    q, direction, table = (part[joints == joint] for part in rows)
    shape = hats(q[:, None], np.linspace([q.min()], [q.max()], NODES))[:, 0].T @ STEPS
    columns = np.hstack([direction[:, None] * shape, shape, table[:, [*friction, -1]]])
    products = ((lag_products(columns, np.arange(len(columns)) == 0),),)
    free, part = np.zeros((len(friction) + 1, len(friction) + 1)), np.repeat([0, 1], NODES)
    fit = fit_mixed(MixedModel(products, free, part, np.zeros(0, dtype=int), np.full(2, LOOSE)))
    k = int(np.argmax([fit.lost_without([0]), fit.lost_without([1])]))
    squares, function = single.copy(), shape @ (fit.sizes[k] * fit.at.own_effects[0][part == k])
    squares[joint] = np.mean((columns @ fit.at.coefficients(0)) ** 2)
    name = run.joints[joint]
    unit = torque_unit(model.robot, name)
    rms = {error.joint: error.rms for error in model.residuals}.get(name) or 1.0
    size = float(np.ptp(np.quantile(function, EXTREMES)) * rms)
    kind, what, where = (("rub", "friction", "along its range"), ("ripple", "torque", "with its position"))[k]
    text = f"{kind} of {name} ({what} that differs by {size:.2g} {unit} {where})"
    return _cause(kind, name, size, text, unit), squares
