"""Least squares over rigid bodies: parameters whose pseudo-inertias are positive definite.

A body of positive density has a positive definite pseudo-inertia ``[[Sigma, ms], [ms^T, m]]``, where
``Sigma`` is the second moment of its mass, and every such matrix belongs to some body. The
convex programme is solved by the interior-point solver Clarabel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gtau.errors import GtauError, missing_extra
from gtau.robots.robot import INERTIAL

ROOT2 = np.sqrt(2.0)
MARGIN = 1e-6


def _basis() -> np.ndarray:
    """Build the pseudo-inertias of unit parameters, in the order of INERTIAL, (10, 4, 4)."""
    basis = np.zeros((10, 4, 4))
    for k, name in enumerate(INERTIAL):
        axes = ["xyz".index(letter) for letter in name if letter in "xyz"]
        if name == "m":
            basis[k, 3, 3] = 1.0
        elif name.startswith("m"):
            basis[k, axes[0], 3] = basis[k, 3, axes[0]] = 1.0
        elif axes[0] == axes[1]:
            basis[k, :3, :3] = np.eye(3) / 2  # Sigma = tr(I)/2 - I
            basis[k, axes[0], axes[0]] -= 1.0
        else:
            basis[k, axes[0], axes[1]] = basis[k, axes[1], axes[0]] = -1.0  # xy = -int x y dm
    return basis


BASIS = _basis()


def pseudo_inertia(values: np.ndarray) -> np.ndarray:
    """Build the pseudo-inertia (4, 4) of inertial parameters (10,), in the order of INERTIAL, SI units."""
    return np.einsum("k,kij->ij", values, BASIS)


def ball_row(centre: np.ndarray, radius: float) -> np.ndarray:
    """Build the row (10,) whose product with a body's parameters is not negative if its mass lies within a ball.

    It is ``tr(J Q)`` of the pseudo-inertia J, the integral of ``radius^2 - |x - centre|^2`` over the mass: it bounds
    the distance of the centre of mass, and the radius of gyration about the centre of the ball, by the ball's radius
    (Wensing, Kim and Slotine, 2018).
    """
    Q = np.zeros((4, 4))
    Q[:3, :3], Q[3, 3] = -np.eye(3), radius**2 - centre @ centre
    Q[:3, 3] = Q[3, :3] = centre
    return np.einsum("kij,ij->k", BASIS, Q)


@dataclass(frozen=True, eq=False)
class Body:
    """A body: the place of each of its ten parameters among the unknowns, -1 for ``known`` values (10,)."""

    name: str
    places: np.ndarray
    known: np.ndarray

    def values(self, x: np.ndarray) -> np.ndarray:
        """Return the body's inertial parameters (10,)."""
        return np.where(self.places < 0, self.known, x[self.places])


def constrained_least_squares(
    R: np.ndarray,
    y: np.ndarray,
    bodies: Sequence[Body],
    lower: np.ndarray,
    upper: np.ndarray,
    unit: np.ndarray,
    mass: float,
    length: float,
    within: np.ndarray | None = None,
) -> np.ndarray:
    """Minimise ``|R x - y|`` over unknowns that are consistent with rigid bodies.

    Parameters
    ----------
    R, y : ndarray
        (r, c) and (r,); every unknown must enter ``R``.
    bodies : sequence of Body
        Bodies whose pseudo-inertias are held above the share MARGIN of ``mass`` (kg), in lengths of ``length`` (m).
    lower, upper : ndarray
        Bounds of the unknowns (c,), infinite where there are none.
    unit : ndarray
        Natural size of each unknown, (c,), for the solver's scaling.
    within : ndarray, optional
        Rows (k, c) of ``within @ x >= 0``; see :func:`ball_row`.

    Returns
    -------
    ndarray
        The unknowns, (c,).

    Raises
    ------
    GtauError
        If no unknowns satisfy bounds and known values, or the solver is not installed.
    """
    try:
        import clarabel
    except ModuleNotFoundError:
        raise missing_extra("a search for physically consistent parameters", "clarabel", "consistency") from None
    from scipy.sparse import csc_array, diags_array, hstack, vstack

    r, c = R.shape
    scaled = csc_array(R * unit)
    # unknowns (x / unit, e) with e = R x - y, so that R^T R is never formed
    rows = [hstack([scaled, -diags_array(np.ones(r))])]
    right = [y]
    cones = [clarabel.ZeroConeT(r)]
    bounded = [(np.isfinite(lower), -1.0, lower), (np.isfinite(upper), 1.0, upper)]
    for chosen, sign, bound in bounded:
        k = np.flatnonzero(chosen)
        if k.size:
            rows.append(csc_array((np.full(k.size, sign), (np.arange(k.size), k)), shape=(k.size, c + r)))
            right.append(sign * bound[k] / unit[k])
            cones.append(clarabel.NonnegativeConeT(k.size))
    if within is not None and len(within):
        rows.append(hstack([csc_array(-within * unit), csc_array((len(within), r))]))
        right.append(np.zeros(len(within)))
        cones.append(clarabel.NonnegativeConeT(len(within)))
    upper_triangle = [(i, j) for j in range(4) for i in range(j + 1)]
    i, j = np.array(upper_triangle).T
    scale = np.append(np.full(3, 1 / length), 1.0)
    vectors = (BASIS * np.outer(scale, scale))[:, i, j] * np.where(i == j, 1.0, ROOT2)  # (10, 10)
    floor = MARGIN * np.where(i == j, 1.0, 0.0)
    for body in bodies:
        free = body.places >= 0
        block = np.zeros((10, c + r))
        block[:, body.places[free]] = -(vectors[free] * unit[body.places[free], None]).T / mass
        rows.append(csc_array(block))
        right.append(body.known[~free] @ vectors[~free] / mass - floor)
        cones.append(clarabel.PSDTriangleConeT(4))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    objective = diags_array(np.append(np.zeros(c), np.ones(r)), format="csc")
    problem = clarabel.DefaultSolver(
        objective, np.zeros(c + r), csc_array(vstack(rows, format="csc")), np.concatenate(right), cones, settings
    )
    solved = problem.solve()
    if solved.status not in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
        raise GtauError(
            f"no rigid bodies can have these parameters (the solver says '{solved.status}'); "
            "check the bounds under 'priors' and the known parameters of the payloads."
        )
    return np.asarray(solved.x)[:c] * unit
