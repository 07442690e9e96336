"""Known parameters as equations: what the priors say of the base parameters, and so of the scale of the gains.

A base parameter is a sum of standard ones, ``chi = S x``. Of these some are known, with standard deviations, and of the
others nothing: so the priors speak of those combinations of base parameters to which no unknown one adds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from difflib import get_close_matches

import numpy as np

from gtau.errors import GtauError
from gtau.model.base_parameters import BaseParameters
from gtau.signals.experiment import Prior

RANK = 1e-9  # of the largest singular value: a combination to which unknown parameters add no more


def known_equations(
    base: BaseParameters, standard: Sequence[str], parameters: Sequence[str], priors: Mapping[str, Prior]
) -> np.ndarray:
    """Write normal priors as equations ``[P | y]`` (k, n_theta + 1) for ``P theta = y`` with errors of unit variance.

    Parameters
    ----------
    base : BaseParameters
        The first of theta.
    standard : sequence of str
        Names of the standard parameters, the columns of ``base.matrix``.
    parameters : sequence of str
        Names of theta, (n_theta,).
    priors : mapping
        Standard or base parameter, or another of theta, to what is known of it; bounds are not used here.

    Raises
    ------
    GtauError
        Where a prior names no parameter.
    """
    return np.vstack(
        [_of_standard(base, standard, len(parameters), priors), of_theta(base, standard, parameters, priors)]
    )


def of_theta(
    base: BaseParameters, standard: Sequence[str], parameters: Sequence[str], priors: Mapping[str, Prior]
) -> np.ndarray:
    """Build the equations of priors that name one of theta, no standard parameter; see :func:`known_equations`."""
    rows = []
    for name, prior in priors.items():
        if name in standard:
            continue
        if name not in parameters:
            close = get_close_matches(name, [*standard, *base.names], n=1)
            raise GtauError(
                f"'priors' names '{name}', which is no parameter of the robot; "
                + (f"did you mean '{close[0]}'?" if close else f"write kind and joint, such as '{standard[0]}'.")
            )
        if prior.value is not None and prior.std is not None:
            row = np.zeros(len(parameters) + 1)
            row[list(parameters).index(name)], row[-1] = 1 / prior.std, prior.value / prior.std
            rows.append(row)
    return np.reshape(rows, (-1, len(parameters) + 1))


def _of_standard(
    base: BaseParameters, standard: Sequence[str], n_theta: int, priors: Mapping[str, Prior]
) -> np.ndarray:
    stated = {name: prior for name, prior in priors.items() if name in standard and prior.value is not None}
    known = np.array([name in stated for name in standard])
    if not known.any():
        return np.zeros((0, n_theta + 1))
    values = np.array([stated[name].value for name in standard if name in stated], dtype=float)
    spread = np.array([stated[name].std for name in standard if name in stated], dtype=float)
    lengths = np.linalg.norm(base.matrix, axis=0)
    U = base.matrix[:, ~known & (lengths > 0)]
    left, sizes, _ = np.linalg.svd(U / np.linalg.norm(U, axis=0))
    P = left[:, int(np.count_nonzero(sizes > RANK * sizes.max(initial=0.0))) :].T  # P U = 0
    S = P @ base.matrix[:, known]  # P chi = S x of the known x
    L = np.linalg.cholesky((S * spread) @ (S * spread).T) if len(P) else np.zeros((0, 0))
    rows = np.zeros((len(P), n_theta + 1))
    rows[:, : base.count] = np.linalg.solve(L, P)
    rows[:, -1] = np.linalg.solve(L, S @ values)
    return rows
