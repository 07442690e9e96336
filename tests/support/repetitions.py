"""The same experiment made again and again with new noise, and identified each time."""

from __future__ import annotations

import numpy as np
from threadpoolctl import threadpool_limits

from gtau.errors import GtauError
from gtau.estimation.estimators.maximum_likelihood import ml
from gtau.estimation.regression.assembly import plain_problem
from gtau.estimation.regression.factors import EXTRA, SIGNALS, Factors, triangle
from gtau.estimation.regression.rows import stream_rows
from gtau.excitation.forecast import expected_runs
from gtau.excitation.task import DesignProblem
from gtau.signals.preparation.bandwidth import choose_preparation
from gtau.signals.preparation.filters import differentiate
from gtau.signals.preparation.prepared_run import prepare


@threadpool_limits.wrap(limits=1, user_api="blas")
def repeated_gains(task: DesignProblem, x: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Drive gains (count, n) identified by maximum likelihood from logs with white current noise.

    A row is nan where the iteration does not converge. Identification is linear in the currents up to the triangular
    factors, so the regressor's rows are made once.
    """
    runs = expected_runs(task, x)
    preparation = choose_preparation(runs)
    decimator, names = preparation.decimator, task.base.standard
    n, p = len(task.prior.gains), len(names) + EXTRA
    regressor = task.model.columns(names)
    clean, kept, cuts = [], [], []
    for run in runs:
        prepared = prepare(run, preparation)
        parts = list(stream_rows(task.model, regressor, prepared, decimator))
        A = np.zeros((n, sum(len(part.time) for part in parts), p))
        entries = np.concatenate([part.entries for part in parts], axis=1)
        A[regressor.rows, :, regressor.columns] = entries
        A[:, :, SIGNALS] = np.concatenate([part.currents for part in parts], axis=2).transpose(1, 2, 0)
        clean.append(A)
        kept.append(np.concatenate([part.keep for part in parts], axis=1))
        first = int(np.argmin(np.abs(run.time - prepared.time[0])))
        cuts.append((len(run.time), slice(first, first + len(prepared.time))))
    slowest = 0.5 / (2 * np.pi * preparation.bandwidth)
    gains = []
    for _ in range(count):
        factors = []
        for A, keep, (samples, cut) in zip(clean, kept, cuts, strict=True):
            noise = rng.normal(size=(samples, n)) * task.prior.sigma
            slopes = differentiate(noise, task.rate)
            noisy = A.copy()
            noisy[:, :, SIGNALS] += np.stack(
                [decimator.apply(np.ascontiguousarray(each[cut].T)) for each in (noise, *slopes)], axis=2
            )
            R = np.zeros((1, n, p, p))
            for j in range(n):
                T = triangle(noisy[j, keep[j]])
                R[0, j, : len(T)] = T
            factors.append(Factors(R, keep.sum(axis=1)[None]))
        problem = plain_problem(task.model, task.base, factors, task.payloads, slowest)
        try:
            gains.append(ml(problem).gains)
        except GtauError:
            gains.append(np.full(n, np.nan))
    return np.array(gains)
