"""Estimate all effects of a fit together with its parameters, gains and delays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gtau.estimation.effects.effect import Effect
from gtau.estimation.effects.linearisation import weights_of
from gtau.estimation.effects.mixed_model import BOUNDS, MixedFit, fit_mixed, posterior
from gtau.estimation.effects.registry import EFFECTS
from gtau.estimation.effects.rows import EffectRows, Linear, effect_rows, linear_at
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.newton import finish
from gtau.estimation.regression.run_blocks import WINDOWS

# The posterior takes the sizes of effects and noise for known, and robots have effects that are not on the list. Chosen
# on seven robots, and tested on others: docs/evidence/coverage.md.
WIDER = 1.15  # of a gain's standard deviation
FLOOR = 5e-4  # of a gain
NONLINEAR, FAR = 0.005, 0.5  # moves of a gain between which columns are made again
STEPS, STAYS = 4, 1e-4  # of the estimates, until no gain moves by more


@dataclass(frozen=True, eq=False)
class Mixed:
    """Estimates of a fit with all effects beside them.

    ``values`` (k,) are moved, ``covariance`` (k, k) is theirs, of which noise alone gives ``random``.
    """

    rows: EffectRows
    mixed: MixedFit
    linear: Linear
    values: np.ndarray
    covariance: np.ndarray
    random: np.ndarray

    def applied(self, fit: Fit) -> Fit:
        """Move the estimates of a fit, which scatter as the noise does."""
        solution = finish(fit.system.problem, self.values, weights_of(fit), fit.free_gains)
        values, vectors = np.linalg.eigh(self.random)
        root = (vectors * np.sqrt(np.maximum(values, 0.0))).T
        # as many replicates on either side, whose jackknife is this covariance
        replicates = np.concatenate([root, -root]) * np.sqrt(len(root) / (2 * len(root) - 1))
        solution = replace(solution, covariance=self.covariance, replicates=lambda: replicates, prior_covariance=0.0)
        return replace(fit, solution=solution)


def estimate_effects(fit: Fit, effects: Sequence[Effect] = EFFECTS) -> Mixed | None:
    """Estimate all effects together; None where no window has rows. Raises GtauError at a singularity.

    Where they move a gain, they move the torques that their columns are made of: these are then made again.
    """
    mixed = _estimate(fit, effects)
    if mixed is None or not fit.free_gains:
        return mixed
    gains = mixed.values[fit.system.problem.gain_rows]
    if not NONLINEAR < float(np.max(np.abs(gains / fit.gains - 1))) < FAR:
        return mixed
    return _estimate(mixed.applied(fit), effects, mixed.mixed)


def _estimate(fit: Fit, effects: Sequence[Effect], near: MixedFit | None = None) -> Mixed | None:
    windows = fit.dataset.windows(WINDOWS)
    if not windows:
        return None
    rows = effect_rows(fit, windows, effects)
    values, gain_rows = fit.solution.values, fit.system.problem.gain_rows
    linear = linear_at(rows, values)
    for step_number in range(STEPS):
        if step_number:
            linear = linear_at(rows, values, linear.model)
        mixed = near = fit_mixed(linear.model, near)
        own = [np.zeros((len(values), rows.own))] * len(rows.products)
        step, covariance = mixed.at.move(linear.slopes @ np.diag(_scale(mixed)), own)
        before, values = values, linear.origin + step
        gains, moved = before[gain_rows], values[gain_rows]
        linear = replace(linear, model=mixed.model)
        if np.all(np.abs(moved - gains) <= STAYS * np.abs(gains)):
            break
    # without effects the model has the delay of the plain fit: a lag stands for a part of it
    delays = fit.system.problem.unknowns.delays
    values = np.concatenate([values[: delays.start], fit.solution.values[delays]])
    random = _random(mixed, linear)
    if fit.free_gains:
        wider = np.ones(len(values))
        wider[gain_rows] = WIDER
        covariance = covariance * np.outer(wider, wider)
        known = np.diag(covariance)[gain_rows] == 0
        covariance[gain_rows, gain_rows] += np.diag(np.where(known, 0.0, (FLOOR * values[gain_rows]) ** 2))
    part = np.sqrt(np.minimum(np.diag(covariance) / np.maximum(np.diag(random), 1e-300), 1.0))  # but for rounding
    return Mixed(rows, mixed, linear, values, covariance, random * part[:, None] * part)


def _scale(mixed: MixedFit) -> np.ndarray:
    return np.concatenate([np.ones(mixed.model.unknowns), mixed.sizes[mixed.model.shared]])


def _random(mixed: MixedFit, linear: Linear) -> np.ndarray:
    """Compute the covariance (k, k) that the noise alone gives the values."""
    alone = posterior(mixed.model, mixed.grams, np.full(len(mixed.log_s), BOUNDS[0] - 10.0))
    k = mixed.model.unknowns
    slopes = linear.slopes[:, :k]
    return np.asarray(slopes @ alone.covariance[:k, :k] @ slopes.T)
