"""Read the columns of effort otherwise than stated: late, exchanged between joints, magnitudes, or without gravity.

The rows are the equations in the middle of the runs; columns are altered, never the rows or the freedom of the
parameters. A joint's own equations say how late its column is, or which signs it lacks. Then all joints are fitted
again: parameters that joints share separate columns which each joint alone could explain.

Torques that are reversed are tried one by one: :mod:`gtau.estimation.diagnostics.descriptions`.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.descriptions import LEFT, residual_ratio
from gtau.estimation.diagnostics.verdict import MISFIT, contradiction, has_wrenches, unexplained_shares, wrenches_first
from gtau.estimation.effects.effect import FitWindow, Torques
from gtau.estimation.effects.rows import triangles
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.newton import least_squares
from gtau.estimation.regression.factors import SIGNAL, SIGNALS, channel_rows, delayed, triangle
from gtau.estimation.regression.problem import best_delay, longest_delay
from gtau.estimation.regression.rows import Rows
from gtau.findings import Finding, listed
from gtau.robots.parameter import Parameter
from gtau.robots.robot import DRIVE, INERTIAL

ALTERED = 0.5  # unexplained share of a joint's current, read otherwise, over that as logged
LATE_STEADY = 0.6  # unexplained share of the shifted current over the share that terms without acceleration leave
MISFIT_TRIED = 0.1  # unexplained share of a joint's signal, from which its column is exchanged with others
LESS_GRAVITY = 0.5  # share of gravity with which rows are less likely than without, where torques have none
MEANING_CLOSE = 3.0  # log likelihood by which torques are likelier without gravity, up to which they are not called so
AS_WELL = 1.1  # residual variance without gravity over with it, up to which compensation explains torques as well
HARDLY_NEGATIVE = 0.05  # most negative value over the largest of a column of magnitudes behind a filter

LATE_CURRENTS, SWAPPED_CHANNELS, MAGNITUDES = "currents logged late", "swapped channels", "magnitudes"
REACH = 0.3  # s: lags beyond are other runs, or clocks that were never set
RANK = 1e-8  # of the largest singular value: directions below it are left out
STARTS = 10  # eigenvectors from which signs are chosen
TINY = 1e-9  # share of a torque or a delay that is rounding

Signals = Mapping[int, np.ndarray]
"""Columns (K, 3) with two time derivatives that some joints have instead of their own."""
Reading = tuple[tuple[Finding, ...], Signals]
"""How columns are read: what is found, nothing if as stated, and the columns then."""


@dataclass(frozen=True, eq=False)
class MiddleRows:
    """Rows (c, K, p) of a fit's problem in the middle of its runs, of which ``keep`` (c, K) count.

    ``weight`` (c, K, p) is gravity's part of them. They are ``step`` (s) apart, and ``reach`` rows at both ends of each
    run do not count: their neighbours are missing.
    """

    fit: Fit
    rows: np.ndarray
    weight: np.ndarray
    keep: np.ndarray
    step: float
    reach: int

    def fitted(self, signals: Signals) -> Fit:
        """Fit all joints with other ``signals``; raises GtauError where that does not converge."""
        rows, problem = self.rows.copy(), self.fit.problem
        for j, signal in signals.items():
            rows[j, :, SIGNALS] = signal
        blocks, counts = triangles(rows, self.keep)[None], self.keep.sum(axis=1)[None]
        problem = replace(problem, make_blocks=lambda: blocks, rows=counts, clusters=None)
        return replace(self.fit, system=replace(self.fit.system, problem=problem), solution=self.fit.solve(problem))

    @cached_property
    def bases(self) -> list[np.ndarray]:
        """Orthonormal bases (K, r) of the joints' own columns."""
        return [basis_of(self.rows[j, self.keep[j], :SIGNAL]) for j in range(len(self.fit.gains))]

    @cached_property
    def shares(self) -> np.ndarray:
        """Share that the equations of each joint leave of the column of each joint, (n, n)."""
        n, efforts = len(self.bases), self.rows[..., SIGNALS]
        shares = [left(self.bases[j], efforts[k, self.keep[j]], self.longest)[0] for j, k in np.ndindex(n, n)]
        return np.reshape(shares, (n, n))

    @property
    def longest(self) -> float:
        """Longest delay that the model describes, s, also where the fit lost it in noise."""
        return longest_delay(self.fit.dataset.preparation.bandwidth)


def basis_of(columns: np.ndarray) -> np.ndarray:
    """Make an orthonormal basis (K, r) of columns (K, p)."""
    from scipy.linalg import orth

    norms = np.linalg.norm(columns, axis=0)
    return np.asarray(orth(columns[:, norms > 0] / norms[norms > 0], rcond=RANK))


def left(basis: np.ndarray, effort: np.ndarray, longest: float) -> tuple[float, float]:
    """Compute the rms share of a column (K, 3) beside an orthonormal ``basis``, at the delay (s) that leaves least."""
    rest = effort - basis @ (basis.T @ effort)
    delay = best_delay(rest, longest)
    size = float(np.linalg.norm(effort @ delayed(delay)))
    return float(np.linalg.norm(rest @ delayed(delay))) / max(size, 1e-300), delay


def columns_of_effort(middle: MiddleRows | None) -> tuple[Finding, ...]:
    """Find what the columns of some joints hold instead of their efforts: what leaves least of all joints."""
    if middle is None:
        return ()
    read = [reading for reading in (_late(middle), _magnitudes(middle), _exchanged(middle)) if reading[0]]

    def remains(reading: Reading) -> float:
        with suppress(GtauError):
            return residual_ratio(middle.fitted(reading[1]), middle.fitted({}))
        return np.inf

    findings, _ = min(read, key=remains, default=((), {}))
    return findings


def middle_rows(fit: Fit) -> MiddleRows | None:
    """Make the rows; None where a joint has as many parameters as half its rows, which explain anything."""
    dataset, rate = fit.dataset, fit.dataset.runs[0].rate
    step = dataset.preparation.at(rate).decimator.factor / rate
    reach = int(np.ceil(max(REACH, 2 * longest_delay(dataset.preparation.bandwidth)) / step))
    parts = list[tuple[np.ndarray, ...]]()
    for run, window in dataset.windows():
        at = FitWindow(fit, run, window)
        both, kept = at.rows(_at_rest)
        inner = np.arange(kept.shape[1])
        kept &= (inner >= reach) & (inner < len(inner) - reach)
        parts.append((*map(at.equations, np.split(both, 2, axis=-1)), kept))
    if not parts:
        return None
    rows, weight, keep = (np.concatenate(arrays, axis=1) for arrays in zip(*parts, strict=True))
    if np.any(keep.sum(axis=1) < [2 * len(own) + 1 for own in fit.problem.own_columns]):
        return None
    return MiddleRows(fit, rows, weight, keep, step, reach)


def _at_rest(at: FitWindow) -> Torques:
    """Make the rows that gravity alone would give along a window."""
    layout, regressor, channels = at.fit.dataset.model.layout, at.regressor, at.fit.problem.channels
    falling = np.array([name.kind in INERTIAL for name in at.fit.dataset.base.standard])[regressor.columns, None]

    def rows(part: Rows) -> np.ndarray:
        still = replace(part.motion, yd=np.zeros_like(part.motion.yd), ydd=np.zeros_like(part.motion.ydd))
        entries = regressor(layout, still)[: len(part.entries)] * falling
        terms, currents, external = (np.zeros_like(other) for other in (part.terms, part.currents, part.external))
        rest = replace(part, entries=entries, terms=terms, currents=currents, external=external)
        return channel_rows(regressor, channels, rest)

    return rows


def shows_gravity(middle: MiddleRows, lack: float) -> tuple[bool, bool]:
    """Decide by each joint's own equations whether efforts lack gravity, and whether they fit as well without.

    The log-likelihood of a share of gravity counts rows by ``lack``, how far their residuals are from white noise.
    """
    fit, shares = middle.fit, (1.0, LESS_GRAVITY, 0.0)
    counts = middle.keep.sum(axis=1)[: len(fit.gains)] / max(lack, 1.0) ** 2
    remains = np.zeros((3, len(fit.gains)))
    for j, count in enumerate(counts.tolist()):
        kept = middle.keep[j]
        R, weight = np.split(triangle(np.hstack([middle.rows[j, kept], middle.weight[j, kept]])), 2, axis=1)
        bases = (basis_of((R - (1 - share) * weight)[:, :SIGNAL]) for share in shares)
        remains[:, j] = [count * np.log(max(left(basis, R[:, SIGNALS], middle.longest)[0], TINY)) for basis in bases]
    stated, less, without = -remains.sum(axis=1)
    missing = without > max(less, stated + MEANING_CLOSE) and not has_wrenches(fit)
    return bool(missing), bool(without > stated - counts.sum() / 2 * np.log(AS_WELL))


def _late(middle: MiddleRows) -> Reading:
    """Shift the columns that fit much better at a lag, of either sign, than at any delay that the model describes.

    Acceleration shows the lag: without it friction, stops and the controller look like one.
    """
    fit, findings, signals = middle.fit, list[Finding](), dict[int, np.ndarray]()
    longest, rows = middle.longest, range(-middle.reach, middle.reach + 1)
    rubbing = np.array([name.kind in DRIVE[1:] for name in fit.problem.parameters] + [False])
    for j in range(len(fit.gains)):
        kept, signal, logged = np.flatnonzero(middle.keep[j]), middle.rows[j, :, SIGNALS], float(middle.shares[j, j])
        tried = {late: left(middle.bases[j], signal[kept + late], max(longest, middle.step)) for late in rows}
        late = min(tried, key=lambda late: tried[late])
        share, delay = tried[late]
        lag = late * middle.step - delay
        if abs(late) == middle.reach or abs(lag) <= longest or share > min(ALTERED * logged, MISFIT):
            continue
        still = middle.weight[j, kept, :SIGNAL] + middle.rows[j, kept, :SIGNAL] * rubbing
        steady = left(basis_of(still), signal[kept + late], longest)[0]
        if share < LATE_STEADY * steady:
            text = (
                f"the {fit.kind}s were logged {abs(1000 * lag):.0f} ms too {'late' if lag > 0 else 'early'}: "
                f"{100 * share:.2g} % is unexplained after shifting them, {100 * logged:.2g} % as logged"
            )
            advice = (
                "log measured positions (references lead) and currents with common time stamps; if all are equally "
                f"late, write 'preparation: {{delay: {lag:.3g}}}'"
            )
            findings.append(contradiction(LATE_CURRENTS, (fit.problem.joints[j],), text, advice, size=logged))
            shift = np.array([[1.0, 0.0, 0.0], [-delay, 1.0, 0.0], [delay**2 / 2, -delay, 1.0]])
            signals[j] = np.roll(signal, -late, axis=0) @ shift
    return tuple(findings), signals


def _exchanged(middle: MiddleRows) -> Reading:
    """Exchange columns: each joint has the one that its own equations explain best, or pairs leave much less of all."""
    from scipy.optimize import linear_sum_assignment

    n, signals, logged = len(middle.fit.gains), middle.rows[..., SIGNALS], np.diag(middle.shares)
    joints, best_order = linear_sum_assignment(np.log(np.maximum(middle.shares, TINY)))
    altered, assigned = np.flatnonzero(best_order != joints), middle.shares[joints, best_order]
    if len(altered) and np.all((assigned < ALTERED * logged)[altered]):
        looks = _looks(middle.fit, True, altered.tolist(), logged[altered], assigned[altered])
        return (looks,), {j: signals[best_order[j]] for j in altered.tolist()}
    try:
        stated = best = middle.fitted({})
    except GtauError:
        return (), {}
    order, before = list(range(n)), unexplained_shares(stated)[:n]
    # what a joint's own equations leave of a column, all of them together leave at least
    fits = (before > MISFIT_TRIED)[:, None] & (middle.shares < np.minimum(ALTERED * before, MISFIT)[:, None])
    while True:
        tried = list[tuple[float, list[int], Fit]]()
        for one, other in combinations(range(n), 2):
            if not (fits[one, order[other]] or fits[other, order[one]]):
                continue
            exchanged = order.copy()
            exchanged[one], exchanged[other] = order[other], order[one]
            try:
                fit = middle.fitted({j: signals[k] for j, k in enumerate(exchanged) if j != k})
            except GtauError:
                continue
            tried.append((residual_ratio(fit, best), exchanged, fit))
        ratio, exchanged, fit = min(tried, key=lambda other: other[0], default=(1.0, order, best))
        if ratio > LEFT:
            break
        order, best = exchanged, fit
    altered, after = np.flatnonzero(np.array(order) != range(n)), unexplained_shares(best)
    if not len(altered) or np.any((after[:n] > np.minimum(ALTERED * before, MISFIT))[altered]):
        return (), {}
    looks = _looks(middle.fit, True, altered.tolist(), before[altered], after[altered])
    return (looks,), {j: signals[order[j]] for j in altered.tolist()}


def _magnitudes(middle: MiddleRows) -> Reading:
    """Give columns without negative values the signs with which the equations explain most of them."""
    signals, shares, problem = dict[int, np.ndarray](), list[tuple[float, float]](), middle.fit.problem
    for j, joint in enumerate(problem.joints):
        kept, basis, signal = middle.keep[j], middle.bases[j], middle.rows[j, :, SIGNALS].copy()
        effort = signal[kept, 0]
        if effort.min() > -HARDLY_NEGATIVE * effort.max():
            signal[kept] *= _signs(basis, effort)[:, None]
            parameters = least_squares(middle.rows[j, kept, :SIGNAL], signal[kept, 0])
            signal *= np.sign(parameters[problem.unknowns.places.get(Parameter("fs", joint), 0)])  # friction brakes
            logged, share = float(middle.shares[j, j]), left(basis, signal[kept], 0.0)[0]
            if share < ALTERED * logged:
                signals[j] = signal
                shares.append((logged, share))
    looks = [_looks(middle.fit, False, list(signals), *np.transpose(shares))] if signals else []
    return tuple(looks), signals


def _signs(basis: np.ndarray, effort: np.ndarray) -> np.ndarray:
    """Choose the signs of the parts of a column between minima, one by one from the best of some eigenvectors."""
    lowest = np.flatnonzero((effort[1:-1] <= effort[:-2]) & (effort[1:-1] < effort[2:])) + 1
    part = np.searchsorted(lowest, np.arange(len(effort)), side="right")
    sums = np.zeros((len(lowest) + 1, basis.shape[1]))
    np.add.at(sums, part, effort[:, None] * basis)
    tried = []
    for start in np.linalg.svd(sums, full_matrices=False)[0].T[:STARTS]:
        signs = np.where(start < 0, -1.0, 1.0)
        for _ in signs:
            gains = np.sum(sums**2, axis=1) - signs * (sums @ (signs @ sums))
            k = int(np.argmax(gains))
            if gains[k] <= TINY * np.sum(sums**2):
                break
            signs[k] *= -1
        tried.append(signs)
    return np.asarray(max(tried, key=lambda signs: np.linalg.norm(signs @ sums))[part])


def _looks(fit: Fit, exchanged: bool, altered: list[int], before: np.ndarray, after: np.ndarray) -> Finding:
    """Say what columns look like, by the geometric means of what is left of them."""
    names = tuple(fit.problem.joints[j] for j in altered)
    logged, share = (float(np.exp(np.mean(np.log(np.maximum(shares, TINY))))) for shares in (before, after))
    kind, how, read = MAGNITUDES, "like magnitudes", "with signs that fit the motion"
    advice = "log signed values (some drives store the sign in a separate bit or column)"
    if exchanged:
        kind, how, read = SWAPPED_CHANNELS, "swapped" if len(names) == 2 else "permuted", "after exchanging them"
        advice = f"check that the position and {fit.kind} columns are of the same joint in all runs"
        advice = wrenches_first(fit, advice)  # wrong ones make single currents look wrong
    text = (
        f"the {fit.kind}s of {listed(names)} look {how}: {100 * share:.2g} % is unexplained {read}, "
        f"{100 * logged:.2g} % as logged"
    )
    return contradiction(kind, names, text, advice, size=1 - share / logged)
