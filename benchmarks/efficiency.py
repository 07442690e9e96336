"""How much of what the logs hold of the gains is used: variances over the Cramer-Rao bound of the simulated truth.

    python benchmarks/efficiency.py five-bar orthoglide delta 3-rrr ur10e

Four runs of benchmarks/random_part.py, of a robot whose parameters are known. The bound is that of all samples of the
logs with the noise's true covariance, white or coloured (1 % correlated for 0.1 s, and 0.3 % white); friction differs
between runs, and delays are unknown. Variances of the estimator follow from its equations, to first order: of all
samples, of those that the mask leaves, and of the decimated rows that are used. They say where the loss lies.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from random_part import NOISE, QUIET, RATE, Case, make_case, spoilt
from scipy.linalg import toeplitz
from scipy.signal import lfilter
from threadpoolctl import threadpool_limits

from gtau.estimation.effects.effect import FitWindow
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.maximum_likelihood import ML
from gtau.estimation.estimators.newton import jacobian, to_gains
from gtau.estimation.regression.dataset import reduce_runs
from gtau.signals.preparation.bandwidth import choose_preparation
from gtau.signals.preparation.filters import Decimator, Preparation

DECAY = 0.1  # s


def fitted(case: Case, preparation: Preparation) -> Fit:
    """The truth, as a fit to logs without noise."""
    runs = list(spoilt(case, "none", np.random.default_rng(0)))
    data = reduce_runs(case.model.robot, runs, preparation)
    return ML.fit(data.system(per_run=True))


def jacobians(fit: Fit) -> list[tuple[np.ndarray, np.ndarray]]:
    """Of each run the residuals' Jacobian (c, K, k) in A, and which rows are kept (c, K)."""
    found = []
    for run, prepared in enumerate(fit.dataset.prepared):
        window = FitWindow(fit, run, prepared.samples())
        A, keep = window.rows()
        J = jacobian(window.equations(A), fit.solution.values, fit.system.problem, fit.free_gains)
        found.append((J, keep))
    return found


def autocovariance(coloured: bool, count: int) -> np.ndarray:
    """Of the noise of a current of 1 A rms, at lags of up to ``count`` samples."""
    lags = np.arange(count)
    white = np.where(lags == 0, (QUIET if coloured else NOISE) ** 2, 0.0)
    return white + coloured * NOISE**2 * np.exp(-lags / (DECAY * RATE))


def bound(rows: list[tuple[np.ndarray, np.ndarray]], coloured: bool, T: np.ndarray) -> np.ndarray:
    """Variances (n,) of the gains by the Cramer-Rao bound of all samples."""
    information = 0.0
    a = np.exp(-1 / (DECAY * RATE))
    # coloured and white noise together are the output of (1 - b z) / (1 - a z) to white noise
    drive, white = NOISE**2 * (1 - a**2), QUIET**2
    c0, c1 = drive + white * (1 + a**2), -a * white
    b = (c0 - np.sqrt(c0**2 - 4 * c1**2)) / (2 * -c1)
    level = np.sqrt(-c1 / b) if coloured else NOISE
    for J, _ in rows:
        for of_joint in J:
            W = lfilter([1.0, -a], [1.0, -b], of_joint, axis=0) if coloured else of_joint
            information = information + W.T @ W / level**2
    return variances(np.linalg.pinv(scaled(information)[0], hermitian=True, rcond=1e-13), scaled(information)[1], T)


def scaled(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    size = np.sqrt(np.diag(A))
    size[size == 0] = 1.0
    return A / np.outer(size, size), size


def variances(C: np.ndarray, size: np.ndarray, T: np.ndarray) -> np.ndarray:
    return np.einsum("ij,jk,ik->i", T / size, C, T / size)


def least_squares(
    rows: list[tuple[np.ndarray, np.ndarray]], decimator: Decimator, coloured: bool, T: np.ndarray, masked: bool
) -> np.ndarray:
    """Variances (n,) of the gains by maximum likelihood that takes rows for independent."""
    h = decimator.kernel if decimator.factor > 1 else np.ones(1)
    normal, middle = 0.0, 0.0
    longest = max(J.shape[1] for J, _ in rows)
    full = autocovariance(coloured, longest * decimator.factor + 2 * len(h))
    along = np.convolve(h, h[::-1])  # weights of the lags within the filter
    lags = np.abs(np.arange(longest)[:, None] * decimator.factor + np.arange(1 - len(h), len(h)))
    covariance = full[lags] @ along
    for J, keep in rows:
        for of_joint, kept in zip(J, keep, strict=True):
            part = of_joint[kept] if masked else of_joint
            at = np.flatnonzero(kept) if masked else np.arange(len(of_joint))
            normal = normal + part.T @ part
            if coloured or decimator.factor > 1:
                C = toeplitz(covariance[: at[-1] + 1])[np.ix_(at, at)] if len(at) else np.zeros((0, 0))
                middle = middle + part.T @ (C @ part)
            else:
                middle = middle + covariance[0] * (part.T @ part)
    A, size = scaled(normal)
    inverse = np.linalg.pinv(A, hermitian=True, rcond=1e-13)
    return variances(inverse @ (middle / np.outer(size, size)) @ inverse, size, T)


def report(source: str) -> None:
    case = make_case(source)
    runs = list(spoilt(case, "white", np.random.default_rng(1)))
    chosen = choose_preparation(runs)
    every = replace(chosen, cutoff=None, decimator=Decimator(1), speed_fraction=0.0)
    for name, coloured in (("white", False), ("coloured", True)):
        fits = {"all": fitted(case, every), "rows": fitted(case, chosen)}
        masked = fitted(case, replace(every, speed_fraction=chosen.speed_fraction))
        found = {}
        for key, fit in {**fits, "mask": masked}.items():
            problem = fit.system.problem
            T = to_gains(fit.solution.values, len(fit.solution.gains), True)[problem.gain_rows] / case.gains[:, None]
            rows = jacobians(fit)
            if key == "all":
                found["bound"] = bound(rows, coloured, T)
            found[key] = least_squares(rows, fit.dataset.preparation.decimator, coloured, T, key != "all")
        ratio = [f"{np.exp(np.mean(np.log(found['bound'] / found[key]))):.2f}" for key in ("all", "mask", "rows")]
        kept = np.mean([keep.mean() for _, keep in jacobians(fits["rows"])])
        print(
            f"| {source} | {name} | {100 * np.sqrt(np.exp(np.mean(np.log(found['bound'])))):.2g} | {' | '.join(ratio)} "
            f"| {chosen.decimator.factor} | {100 * kept:.0f} |",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("robots", nargs="+", help="catalog names or robot files")
    options = parser.parse_args()
    print(
        "| robot | noise | bound of the gains, % | all samples | without slow ones | rows used | decimated by | "
        "rows kept, % |"
    )
    print("| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: |")
    with threadpool_limits(1):
        for source in options.robots:
            report(source)


if __name__ == "__main__":
    main()
