"""Read the columns of effort otherwise than stated: late, exchanged between joints, or magnitudes.

The rows are the equations in the middle of the runs; columns are altered, never the rows or the freedom of the
parameters. A joint's own equations say how late its column is, or which signs it lacks. Then all joints are fitted
again, as parameters that joints share tell columns apart which each joint alone could explain.

Torques that are reversed are tried one by one: :mod:`gtau.estimation.diagnostics.descriptions`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.descriptions import LEFT, residual_ratio
from gtau.estimation.diagnostics.verdict import contradiction, unexplained_shares, wrenches_first
from gtau.estimation.effects.effect import FitWindow
from gtau.estimation.effects.rows import triangles
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.maximum_likelihood import MISFIT
from gtau.estimation.estimators.newton import least_squares
from gtau.estimation.regression.factors import SIGNAL, SIGNALS, delayed
from gtau.estimation.regression.problem import best_delay
from gtau.findings import Finding, listed
from gtau.robots.parameter import Parameter

ALTERED = 0.5  # unexplained share of a joint's current, read otherwise, over that as logged
LATE_STEADY = 0.6  # unexplained share of the shifted current over the share that terms without acceleration leave
MISFIT_TRIED = 0.1  # unexplained share of a joint's signal, from which its column is exchanged with others
HARDLY_NEGATIVE = 0.05  # most negative value over the largest of a column of magnitudes behind a filter

LATE_CURRENTS, SWAPPED_CHANNELS, MAGNITUDES = "currents logged late", "swapped channels", "magnitudes"
TURNING = ("xx", "xy", "xz", "yy", "yz", "zz", "ia")  # parameters that only acceleration shows
REACH = 0.3  # s: lags beyond are other runs, or clocks that were never set
RANK = 1e-8  # of the largest singular value: directions below it are left out
STARTS = 3  # eigenvectors from which signs are chosen
TINY = 1e-9  # share of a torque or a delay that is rounding

Signals = Mapping[int, np.ndarray]
"""Columns (K, 3) with two time derivatives that some joints have instead of their own."""


@dataclass(frozen=True, eq=False)
class MiddleRows:
    """Rows (c, K, p) of a fit's problem in the middle of its runs, of which ``keep`` (c, K) count.

    They are ``step`` (s) apart, and ``reach`` rows at both ends of each run do not count: their neighbours are missing.
    """

    fit: Fit
    rows: np.ndarray
    keep: np.ndarray
    step: float
    reach: int

    def fitted(self, signals: Signals) -> Fit:
        """Fit all joints with other ``signals``; raises GtauError where that does not converge."""
        rows, problem = self.rows.copy(), self.fit.problem
        for j, signal in signals.items():
            rows[j, :, SIGNALS] = signal
        blocks, counts = triangles(rows, self.keep)[None], self.keep.sum(axis=1)[None]
        problem = replace(problem, blocks=blocks, rows=counts, clusters=None)
        return replace(self.fit, system=replace(self.fit.system, problem=problem), solution=self.fit.solve(problem))

    def basis(self, j: int, without: tuple[str, ...] = ()) -> np.ndarray:
        """Orthonormal basis (K, r) of a joint's own columns, but for some kinds of parameters."""
        from scipy.linalg import orth

        kept = [name.kind not in without for name in self.fit.problem.parameters]
        columns = self.rows[j, self.keep[j], :SIGNAL][:, [*kept, True]]
        norms = np.linalg.norm(columns, axis=0)
        return np.asarray(orth(columns[:, norms > 0] / norms[norms > 0], rcond=RANK))


def left(basis: np.ndarray, effort: np.ndarray, longest: float) -> tuple[float, float]:
    """Compute the rms share of a column (K, 3) beside an orthonormal ``basis``, at the delay (s) that leaves least."""
    rest = effort - basis @ (basis.T @ effort)
    delay = best_delay(rest, longest)
    size = float(np.linalg.norm(effort @ delayed(delay)))
    return float(np.linalg.norm(rest @ delayed(delay))) / max(size, 1e-300), delay


def columns_of_effort(fit: Fit) -> tuple[Finding, ...]:
    """Find what the columns of some joints hold instead of their efforts: what leaves least of all joints."""
    middle = middle_rows(fit)
    if middle is None:
        return ()
    try:
        stated = middle.fitted({})
    except GtauError:
        return ()
    before, least, findings = unexplained_shares(stated), 1.0, tuple[Finding, ...]()
    late, shifted = _late(middle)
    readings = {LATE_CURRENTS: shifted, MAGNITUDES: _magnitudes(middle), SWAPPED_CHANNELS: _exchanged(middle, stated)}
    for kind, signals in readings.items():
        try:
            other = middle.fitted(signals)
        except GtauError:
            continue
        altered, after, remains = sorted(signals), unexplained_shares(other), residual_ratio(other, stated)
        # a joint that is late shows it by its own equations, beside others that are late too
        explained = kind == LATE_CURRENTS or np.all(after[altered] < np.minimum(ALTERED * before[altered], MISFIT))
        if altered and explained and remains < least:
            least, findings = remains, (_looks(fit, kind, altered, before[altered], after[altered]),)
            if kind == LATE_CURRENTS:
                findings = late
    return findings


def middle_rows(fit: Fit) -> MiddleRows | None:
    """Make the rows; None where a joint has as many parameters as half its rows, which explain anything."""
    dataset, longest = fit.dataset, float(fit.problem.longest_delays.max())
    rate = dataset.runs[0].rate
    step = dataset.preparation.at(rate).decimator.factor / rate
    reach = int(np.ceil(max(REACH, 2 * longest) / step)) if longest else 0
    rows, keep = [], []
    for run, window in dataset.windows():
        at = FitWindow(fit, run, window)
        A, kept = at.rows()
        inner = np.arange(kept.shape[1])
        rows.append(at.equations(A))
        keep.append(kept & (inner >= reach) & (inner < len(inner) - reach))
    kept = np.concatenate(keep, axis=1) if keep else np.zeros((1, 0), dtype=bool)
    if np.any(kept.sum(axis=1) < [2 * len(columns) + 1 for columns in fit.problem.own_columns]):
        return None
    return MiddleRows(fit, np.concatenate(rows, axis=1), kept, step, reach)


def _late(middle: MiddleRows) -> tuple[tuple[Finding, ...], Signals]:
    """Shift the columns that fit much better at a lag, of either sign, than at any delay that the model describes.

    Acceleration shows the lag: without it friction, stops and the controller look like one.
    """
    fit, findings, signals = middle.fit, list[Finding](), dict[int, np.ndarray]()
    longest, rows = float(fit.problem.longest_delays.max()), range(-middle.reach, middle.reach + 1)
    for j in range(len(fit.gains) if middle.reach else 0):
        kept, basis, signal = np.flatnonzero(middle.keep[j]), middle.basis(j), middle.rows[j, :, SIGNALS]
        tried = {late: left(basis, signal[kept + late], max(longest, middle.step)) for late in rows}
        late = min(tried, key=lambda late: tried[late])
        (share, delay), (logged, _) = tried[late], left(basis, signal[kept], longest)
        lag, steady = late * middle.step - delay, left(middle.basis(j, TURNING), signal[kept + late], longest)[0]
        if abs(late) == middle.reach or abs(lag) <= longest:
            continue
        if share < min(ALTERED * logged, LATE_STEADY * steady, MISFIT):
            text = (
                f"the {fit.kind}s were logged {abs(1000 * lag):.0f} ms too {'late' if lag > 0 else 'early'}: "
                f"{100 * share:.2g} % is unexplained after shifting them, {100 * logged:.2g} % as logged"
            )
            advice = (
                "log them with the time stamps of the positions, or if all joints are equally late, write "
                f"'preparation: {{delay: {lag:.3g}}}'"
            )
            findings.append(contradiction(LATE_CURRENTS, (fit.problem.joints[j],), text, advice, size=logged))
            signals[j] = np.roll(signal, -late, axis=0)
    return tuple(findings), signals


def _exchanged(middle: MiddleRows, stated: Fit) -> Signals:
    """Exchange columns pair by pair, as long as that leaves much less of all joints."""
    n, rows, best = len(middle.fit.gains), middle.rows, stated
    order, wrong = list(range(n)), unexplained_shares(stated) > MISFIT_TRIED
    pairs = [pair for pair in combinations(range(n), 2) if wrong[list(pair)].any()]
    while True:
        tried = list[tuple[float, list[int], Fit]]()
        for one, other in pairs:
            exchanged = order.copy()
            exchanged[one], exchanged[other] = order[other], order[one]
            try:
                fit = middle.fitted({j: rows[k, :, SIGNALS] for j, k in enumerate(exchanged) if j != k})
            except GtauError:
                continue
            tried.append((residual_ratio(fit, best), exchanged, fit))
        ratio, exchanged, fit = min(tried, key=lambda other: other[0], default=(1.0, order, best))
        if ratio > LEFT:
            return {j: rows[k, :, SIGNALS] for j, k in enumerate(order) if j != k}
        order, best = exchanged, fit


def _magnitudes(middle: MiddleRows) -> Signals:
    """Give columns without negative values the signs with which the equations explain most of them."""
    signals, problem = dict[int, np.ndarray](), middle.fit.problem
    for j, joint in enumerate(problem.joints):
        kept, basis, signal = middle.keep[j], middle.basis(j), middle.rows[j, :, SIGNALS].copy()
        logged, effort = left(basis, signal[kept], problem.longest_delays[j])[0], signal[kept, 0]
        if effort.min() > -HARDLY_NEGATIVE * effort.max():
            signal[kept] *= _signs(basis, effort)[:, None]
            parameters = least_squares(middle.rows[j, kept, :SIGNAL], signal[kept, 0])
            signal *= np.sign(parameters[problem.unknowns.places.get(Parameter("fs", joint), 0)])  # friction brakes
            if left(basis, signal[kept], 0.0)[0] < ALTERED * logged:
                signals[j] = signal
    return signals


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


def _looks(fit: Fit, kind: str, altered: list[int], before: np.ndarray, after: np.ndarray) -> Finding:
    """Say what columns look like, by the geometric means of what is left of them."""
    names = tuple(fit.problem.joints[j] for j in altered)
    logged, share = (float(np.exp(np.mean(np.log(np.maximum(shares, TINY))))) for shares in (before, after))
    how, read = "like magnitudes", "with signs that fit the motion"
    advice = "log signed values (some drives store the sign in a separate bit or column)"
    if kind == SWAPPED_CHANNELS:
        how, read = "swapped" if len(names) == 2 else "permuted", "after exchanging them"
        advice = f"check that the position and {fit.kind} columns are of the same joint in all runs"
        advice = wrenches_first(fit, advice)  # wrong ones make single currents look wrong
    text = (
        f"the {fit.kind}s of {listed(names)} look {how}: {100 * share:.2g} % is unexplained {read}, "
        f"{100 * logged:.2g} % as logged"
    )
    return contradiction(kind, names, text, advice, size=1 - share / logged)
