"""Estimate all effects of a fit with its parameters, gains and delays, and describe them: what they are and explain."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gtau.estimation.effects.effect import EffectColumn, EstimatedEffect
from gtau.estimation.effects.mixed_model import BOUNDS, MixedFit, Noise, fit_mixed
from gtau.estimation.effects.rows import EffectRows, Layout, effect_rows, linear_at, run_modes, weights_of
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.newton import finish
from gtau.estimation.regression.run_blocks import WINDOWS

FLOOR = 2e-4  # of a gain, as robots have effects that are not on the list
# Of a gain, times the squares of its moves by effects of motion, whose columns hold for small sizes.
CURVATURE = 2.0
NONLINEAR, FAR = 0.005, 0.5  # moves of a gain between which columns are made again
REPEATS = 3  # of the columns: a constant that falls by 5 % leaves gains of an arm 8, 1.1, 0.18 and 0.01 % off in turn
STEPS, STAYS = 4, 1e-4  # of the estimates, until no gain moves by more

# Standard deviations beyond a possible size, from which an effect stands for something else and is left out.
IMPOSSIBLE = 3.5
DELAY_MOVES = 3.0  # standard deviations by which effects move a delay; below, it stays as it was
CONTRADICTED = 8.0  # log-likelihood that is lost without an effect that contradicts the description
CLOSE = 3.0  # log-likelihood by which a cause is likelier, up to which the other is said too

LOST = 0.5  # relative standard deviation of a gain, from which the data do not determine it
SPANNED = 1e-6  # information on a column beside others, in plausible sizes: less, and they span it
SEEN = 0.02  # of its plausible size: an effect below is not listed


@dataclass(frozen=True, eq=False)
class Mixed:
    """Estimates of a ``fit`` with all effects beside them, whose columns are those of ``rows``.

    The ``slopes`` (k, .) of its values are by the common columns of the mixed model, whose steps count from ``origin``.
    It is ``settled`` if columns made once more would hardly move a gain.
    """

    fit: Fit
    rows: EffectRows
    mixed: MixedFit
    slopes: np.ndarray
    origin: np.ndarray
    settled: bool = True

    @property
    def likeliest(self) -> np.ndarray:
        """Values (k,) at the likeliest sizes of all effects."""
        values = self.origin + self.mixed.at_sizes(self.mixed.log_s, self.slopes)[0]
        return np.where(self._stays(values), self.fit.solution.values, values)

    @cached_property
    def _averaged(self) -> tuple[np.ndarray, np.ndarray]:
        step, covariance = self.mixed.averaged(self.slopes)
        return self.origin + step, covariance

    @cached_property
    def values(self) -> np.ndarray:
        """Values (k,) over all sizes, each as likely as the data say."""
        return np.where(self._stays(self._averaged[0]), self.fit.solution.values, self._averaged[0])

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance (k, k) of the values."""
        covariance, gain_rows = self._averaged[1].copy(), self.fit.system.problem.gain_rows
        plain = np.diag(self.fit.solution.jackknife)
        # what the fit does not determine may be among the directions that the mixed model leaves out
        left, values = self._stays(self._averaged[0]), self.fit.solution.values
        left[gain_rows] |= (np.sqrt(plain) > LOST * np.abs(values))[gain_rows]
        wider = np.where(left, plain - np.diag(covariance), 0.0)
        covariance += np.diag(np.maximum(wider, 0.0))
        if self.fit.free_gains:
            known = np.diag(covariance)[gain_rows] == 0
            explained, squares = Influence(self), np.zeros_like(self.values[gain_rows])
            for number, layout in enumerate(self.rows.layouts):
                if layout.effect.of_motion and self.mixed.sizes[number] >= SEEN:
                    _, moves, _ = explained(*self.sizes_of(number))
                    for joint, move in moves.items():
                        squares[self.fit.dataset.model.actuated.index(joint)] += (move / 100) ** 2
            share = np.hypot(FLOOR, CURVATURE * squares)
            covariance[gain_rows, gain_rows] += np.diag(np.where(known, 0.0, (share * self.values[gain_rows]) ** 2))
        return covariance

    def sizes_of(self, number: int) -> tuple[np.ndarray, list[np.ndarray]]:
        """Return the sizes of an effect's columns among the common ones, and among each channel's own."""
        mixed, places = self.mixed, self.rows.layouts[number].places
        common, own = np.zeros(len(mixed.at.common)), [np.zeros(len(mixed.model.own_groups)) for _ in mixed.model.rows]
        if self.rows.layouts[number].effect.shared:
            first = mixed.model.unknowns + len(self.rows.in_runs[0])
            at = slice(first + places.start, first + places.stop)
            common[at] = mixed.sizes[number] * mixed.at.common[at]
        else:
            for part, effects in zip(own, mixed.at.own_effects, strict=True):
                part[places] = mixed.sizes[number] * effects[places]
        return common, own

    @cached_property
    def random(self) -> np.ndarray:
        """Part (k, k) of the covariance that noise alone gives."""
        random = self.mixed.at_sizes(np.full(len(self.mixed.log_s), BOUNDS[0] - 10.0), self.slopes)[1]
        total, alone = np.diag(self.covariance), np.diag(random)
        part = np.sqrt(np.divide(total, alone, out=np.ones_like(alone), where=alone > total))  # 1 but for rounding
        return random * part[:, None] * part

    def _stays(self, values: np.ndarray) -> np.ndarray:
        """Find the delays, (k,), that effects hardly move: they stay those of the fit."""
        plain = self.fit.solution
        stays = np.abs(values - plain.values) < DELAY_MOVES * np.sqrt(np.diag(plain.jackknife))
        stays[: self.fit.system.problem.unknowns.delays.start] = False
        return np.asarray(stays)

    def applied(self, fit: Fit) -> Fit:
        """Move the estimates of a fit, which scatter as the noise does."""
        solution = finish(fit.system.problem, self.values, weights_of(fit), fit.free_gains)
        values, vectors = np.linalg.eigh(self.random)
        root = (vectors * np.sqrt(np.maximum(values, 0.0))).T
        # as many replicates on either side, whose jackknife is this covariance
        replicates = np.concatenate([root, -root]) * np.sqrt(len(root) / (2 * len(root) - 1))
        solution = replace(solution, covariance=self.covariance, replicates=lambda: replicates, prior_covariance=0.0)
        return replace(fit, solution=solution)


def estimate_effects(fit: Fit) -> Mixed | None:
    """Estimate all effects together; None where no window has rows. Raises GtauError at a singularity.

    Where they move a gain, they move the torques that their columns are made of: these are then made again.
    """
    mixed, gains, gain_rows = effects_beside(fit), fit.gains, fit.system.problem.gain_rows
    for _ in range(REPEATS if fit.free_gains else 0):
        if mixed is None:
            break
        values = mixed.likeliest
        before, gains = gains, values[gain_rows]
        if not NONLINEAR < float(np.max(np.abs(gains / before - 1))) < FAR:
            break
        solution = finish(fit.system.problem, values, weights_of(fit), fit.free_gains)
        # weighted as before: without the effects beside them, the values moved leave larger residuals
        solution = replace(solution, sigma=fit.solution.sigma)
        if (again := effects_beside(replace(fit, solution=solution), mixed)) is None:
            return None
        last = float(np.max(np.abs(again.likeliest[gain_rows] / gains - 1)))
        if last > FAR:
            return replace(mixed, fit=fit, settled=False)
        mixed = replace(again, fit=fit, settled=last <= NONLINEAR)
    return mixed


def effects_beside(fit: Fit, before: Mixed | None = None) -> Mixed | None:
    """Estimate all effects as :func:`estimate_effects` does, with columns of the torques of the fit alone.

    The effects that act are those found ``before``, from whose sizes it begins.
    """
    windows = fit.dataset.windows(WINDOWS)
    if not windows:
        return None
    rows = effect_rows(fit, windows, before.rows.acting if before else None)
    near = before.mixed if before else None
    values, gain_rows = fit.solution.values, fit.system.problem.gain_rows
    noise: tuple[tuple[Noise, ...], ...] = ()
    absent = np.full(len(rows.layouts) + 1, np.inf)
    for _ in range(STEPS):
        model, slopes, origin = linear_at(rows, values, noise)
        mixed = near = fit_mixed(replace(model, largest=np.minimum(model.largest, absent)), near)
        if impossible := list(_impossible(rows, mixed)):
            for number, channels in impossible:
                if rows.layouts[number].effect.shared:
                    absent[number] = BOUNDS[0]
                else:
                    rows.leave_out(number, channels)
            model, slopes, origin = linear_at(rows, values, noise)
            mixed = near = fit_mixed(replace(model, largest=np.minimum(model.largest, absent)), mixed)
        noise = mixed.model.noise
        step = origin + mixed.at_sizes(mixed.log_s, slopes)[0] - values
        farthest = float(np.max(np.abs(step[gain_rows] / values[gain_rows]), initial=0.0))
        values = values + step * min(1.0, FAR / max(farthest, 1e-300))
        if farthest <= STAYS:
            break
    return Mixed(fit, rows, mixed, slopes, origin)


def _impossible(rows: EffectRows, mixed: MixedFit) -> Iterator[tuple[int, np.ndarray]]:
    """List effects with a size that is impossible by several standard deviations, and at which channels it is."""
    first, variances = mixed.model.unknowns + len(rows.in_runs[0]), np.diag(mixed.at.covariance)
    for number, layout in enumerate(rows.layouts):
        if layout.effect.in_runs or mixed.log_s[number] <= BOUNDS[0]:
            continue
        places = layout.places
        sizes, variance = mixed.at.own_effects[:, places], mixed.at.variance[:, places]
        if layout.effect.shared:
            places = slice(first + places.start, first + places.stop)
            sizes, variance = mixed.at.common[places], variances[places]
        scale = mixed.sizes[number] * np.array([column.plausible for column in layout.columns])
        below = scale * (sizes + IMPOSSIBLE * np.sqrt(variance)) < [column.least for column in layout.columns]
        if below.any():
            yield number, below.any(axis=-1)


def estimated_effects(result: Mixed) -> tuple[EstimatedEffect, ...]:
    """List all effects with a size, the best supported first."""
    return tuple(sorted(_estimated(result), key=lambda effect: -effect.likelihood))


def _estimated(result: Mixed) -> Iterator[EstimatedEffect]:
    """List the effects: each column that all joints share, and of each drive the largest one."""
    mixed, explained = result.mixed, Influence(result)
    for number, layout in enumerate(result.rows.layouts):
        if mixed.sizes[number] < SEEN:
            continue
        effect, lost = layout.effect, mixed.lost_without([number])
        for column, common, parts in _columns(result, number, layout):
            value, covariance = mixed.at.move(common[None], [part[None] for part in parts])
            size, std = float(value[0]), float(np.sqrt(covariance[0, 0]))
            if not size:
                continue
            all_sizes = np.zeros_like(common), [np.zeros_like(part) for part in parts]
            if effect.shared:
                all_sizes[0][common != 0] = mixed.sizes[number] * mixed.at.common[common != 0]
            else:
                j = result.rows.fit.system.problem.joints.index(column.joint)
                all_sizes[1][j][layout.places] = mixed.sizes[number] * mixed.at.own_effects[j, layout.places]
            share, moves, torque = explained(*all_sizes)
            if effect.function:
                size, std = torque, torque * std / abs(size)
            against = effect.description or abs(size) - 2 * std > effect.harmless
            cause, beyond = effect.cause(result.rows.fit, column, size), abs(size) > column.largest
            yield EstimatedEffect(effect.name, cause, size, std, column.unit, lost, share, moves, against, beyond)


def contradictions(result: Mixed) -> tuple[EstimatedEffect, ...]:
    """Find the columns that contradict the description one by one, the best first, all physics beside them.

    Columns that look alike share the posterior, so that none of them is sure. What the data say of all of them without
    any prior, their information matrix and score, gives each alone: its size, and the likelihood that it adds.
    """
    mixed = result.mixed
    against = [n for n, layout in enumerate(result.rows.layouts) if layout.effect.description]
    log_s = mixed.log_s.copy()
    log_s[against] = 0.0
    opened = replace(result, mixed=MixedFit(mixed.model, log_s))
    listed = [(result.rows.layouts[n].effect, *column)
              for n in against for column in _columns(opened, n, result.rows.layouts[n])]  # fmt: skip
    if not listed:
        return ()
    plausible = np.array([column.plausible for _, column, *_ in listed])
    F = np.array([common for _, _, common, _ in listed])
    F_own = [np.array([parts[j] for *_, parts in listed]) for j in range(len(mixed.model.rows))]
    mean, covariance = opened.mixed.at.move(F / plausible[:, None], [part / plausible[:, None] for part in F_own])
    precision = np.linalg.pinv(covariance, rcond=SPANNED, hermitian=True)
    information, score = precision - np.eye(len(listed)), precision @ mean
    explained, chosen, effects = Influence(result), list[int](), list[EstimatedEffect]()
    while len(chosen) < len(listed):
        # what is left of each once those chosen are fitted
        held = information[np.ix_(chosen, chosen)]
        slopes = np.linalg.solve(held, information[chosen]) if chosen else np.zeros((0, len(listed)))
        remaining = score - score[chosen] @ slopes
        curvature = np.diag(information) - np.einsum("ij,ij->j", information[chosen], slopes)
        curvature = np.where(np.isin(range(len(listed)), chosen) | (curvature < SPANNED), np.inf, curvature)
        gains = remaining**2 / curvature / 2
        best = int(np.argmax(gains))
        if gains[best] < CONTRADICTED:
            break
        chosen.append(best)
        effect, column, common, parts = listed[best]
        size = float(remaining[best] / curvature[best])
        share, moves, _ = explained(size * (common != 0), [size * (part != 0) for part in parts])
        size, std = size * column.plausible, float(column.plausible / np.sqrt(curvature[best]))
        cause = effect.cause(result.rows.fit, column, size)
        alike = [
            k for k in np.argsort(-gains) if k != best and gains[k] > gains[best] - CLOSE and np.isfinite(curvature[k])
        ]
        if alike:
            other, other_column = listed[alike[0]][:2]
            other_size = float(remaining[alike[0]] / curvature[alike[0]] * other_column.plausible)
            also, _ = other.say(result.rows.fit, other_column, other_size)
            said = f", or as likely {also} ({other_size:z.2g} {other_column.unit})"
            cause = replace(cause, values={"as_likely": said})
        likelihood, beyond = float(gains[best]), abs(size) > column.largest
        effects.append(
            EstimatedEffect(effect.name, cause, size, std, column.unit, likelihood, share, moves, True, beyond)
        )
    return tuple(effects)


def _columns(result: Mixed, number: int, layout: Layout) -> Iterator[tuple[EffectColumn, np.ndarray, list[np.ndarray]]]:
    """List what of an effect has a size of its own, as functionals of the common and of each channel's own effects."""
    mixed, fit, effect = result.mixed, result.rows.fit, layout.effect
    nothing = [np.zeros(len(mixed.model.own_groups)) for _ in mixed.model.rows]
    common, scale = np.zeros(len(mixed.at.common)), mixed.sizes[number]
    modes = run_modes(len(fit.dataset.runs))
    modes = modes - modes.mean(axis=0)

    def of_run(column: EffectColumn, u: np.ndarray) -> tuple[EffectColumn, np.ndarray]:
        """Name the run that differs most from the mean of all, and weigh the modes for it."""
        run = int(np.argmax(np.abs(modes @ u)))
        return replace(column, about=fit.dataset.runs[run].name), scale * column.plausible * modes[run]

    if effect.shared:
        first = mixed.model.unknowns + len(result.rows.in_runs[0]) + layout.places.start
        width = modes.shape[1] if effect.in_runs else 1
        for k, column in enumerate(layout.columns):
            functional, places = common.copy(), slice(first + k * width, first + (k + 1) * width)
            functional[places] = scale * column.plausible
            if effect.in_runs:
                column, functional[places] = of_run(column, mixed.at.common[places])
            yield column, functional, nothing
        return
    for j, joint in enumerate(fit.system.problem.joints):
        if joint not in fit.dataset.robot.motors:
            continue
        u, std = mixed.at.own_effects[j, layout.places], np.sqrt(mixed.at.variance[j, layout.places])
        parts = [part.copy() for part in nothing]
        k = 0 if effect.in_runs else int(np.argmax(np.abs(u) / std))
        column = replace(layout.columns[k], joint=joint)
        if effect.in_runs:
            column, parts[j][layout.places] = of_run(column, u)
        else:
            parts[j][layout.places.start + k] = scale * column.plausible
        yield column, common, parts


class Influence:
    """What columns of some size explain of the residuals of plain least squares, and by how much they move gains."""

    def __init__(self, result: Mixed) -> None:
        self.result, model, fit = result, result.mixed.model, result.rows.fit
        self.levels = weights_of(fit) * np.maximum(fit.system.problem.balance(fit.solution.theta), 1e-300)
        m, k = len(model.own_groups), model.unknowns
        self.unknown = slice(m, m + k)
        self.plain = [np.sum([part.plain for part in parts], axis=0) for parts in model.rows]
        J = model.known[:k, :k] + sum(part[self.unknown, self.unknown] for part in self.plain)
        self.inverse = np.linalg.pinv(J, rcond=1e-10, hermitian=True)
        e = model.known[:k, k] + sum(part[self.unknown, -1] for part in self.plain)
        square = sum(float(part[-1, -1]) for part in self.plain)
        self.e, self.squares = e, max(square - float(e @ self.inverse @ e), 1e-300)

    def __call__(self, common: np.ndarray, own: Sequence[np.ndarray]) -> tuple[float, dict[str, float], float]:
        """Compute share, moves of the gains (per cent), and the largest rms torque over the torque of its joint.

        Sizes of the columns, in plausible sizes, are those among the ``common`` and each channel's ``own`` ones.
        """
        model, fit = self.result.mixed.model, self.result.rows.fit
        k = model.unknowns
        J_c, c_e, c_c, torque = np.zeros(k), 0.0, 0.0, 0.0
        for j, (part, u) in enumerate(zip(self.plain, own, strict=True)):
            column = np.concatenate([u, np.zeros(k), common[k:], [0.0]])
            if not column.any():
                continue
            product = part @ column
            J_c += product[self.unknown]
            c_e += float(product[-1])
            c_c += float(column @ product)
            count = max(sum(float(part.counts[0]) for part in model.rows[j]), 1.0)
            torque = max(torque, np.sqrt(max(float(column @ product), 0.0) / count) / self.levels[j])
        step = self.inverse @ J_c
        rest = c_c - float(J_c @ step)
        share = -(2 * (c_e - float(step @ self.e)) + rest) / self.squares
        move = -self.result.slopes[:, :k] @ step  # to the estimates with the effect
        gains = fit.solution.gains
        moves = {
            joint: 100 * float(move[fit.system.problem.gain_rows][j] / gains[j])
            for j, joint in enumerate(fit.dataset.model.actuated)
            if joint in fit.dataset.robot.motors
        }
        return min(max(share, 0.0), 1.0), moves, float(torque)
