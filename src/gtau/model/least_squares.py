"""Solve small least-squares problems symbolically: every sample then runs the same few instructions."""

from __future__ import annotations

import casadi as ca


def solve(a: ca.SX, b: ca.SX, refine: bool) -> tuple[ca.SX, ca.SX]:
    """Solve ``min |a x - b|`` by the sparse ``L D L^T`` of the normal equations.

    Rows and columns are eliminated in an order that keeps zeros, so robots with many legs cost no more than
    each leg and the platform. With ``refine`` one step of iterative refinement restores the digits that the
    normal equations lose.

    Parameters
    ----------
    a : SX
        (m, n), m >= n, with structural zeros where it is zero.
    b : SX
        (m, k).
    refine : bool
        Whether to refine.

    Returns
    -------
    x : SX
        (n, k).
    condition : SX
        Square root of ``trace(M) trace(M^-1)``, ``M = a^T a``: at least the condition number of ``a``, at most n
        times it; not a number, infinite or huge where ``a`` is singular.
    """
    normal = a.T @ a
    d, lt, order = ca.ldl(normal, True)
    x = ca.ldl_solve(a.T @ b, d, lt, order)
    if refine:
        x += ca.ldl_solve(a.T @ (b - a @ x), d, lt, order)
    inverse = _inverse(lt)
    spread = ca.sum1(ca.sum2(inverse**2 / ca.repmat(d.T, d.numel(), 1)))
    return x, ca.sqrt(ca.trace(normal) * spread)


def _inverse(upper: ca.SX) -> ca.SX:
    """Invert a unit upper triangle, given without its diagonal, by sparse back substitution."""
    n = upper.shape[0]
    found = ca.SX(n, n)
    for column in range(n):
        found[column, column] = 1
        for row in range(column - 1, -1, -1):
            rest = ca.mtimes(upper[row, row + 1 : column + 1], found[row + 1 : column + 1, column])
            if rest.nnz():
                found[row, column] = -rest
    return ca.sparsify(found)
