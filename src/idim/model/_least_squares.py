"""Many small least-squares problems at once, one a sample, samples along the last axis."""

import numpy as np
from numba import njit

LANES = 64


@njit(cache=True, error_model="numpy")
def solve(a, pattern, b, refine):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Solve ``min |a x - b|`` for every sample by Cholesky of the normal equations.

    ``a`` is (m, n, N), zero where ``pattern`` (m, n) is False, and ``b`` (m, k, N). With ``refine``
    one step of iterative refinement gives back the digits that normal equations lose.

    Returns
    -------
    x : (n, k, N)
    condition : (N,), the square root of ``trace(M) trace(M^-1)``, ``M = a^T a``: at least the
        condition number of ``a``, at most n times it; not finite where ``a`` is singular.
    """
    m, n, samples = a.shape
    k = b.shape[1]
    x = np.zeros((n, k, samples))
    condition = np.zeros(samples)
    L = np.zeros((n, n, LANES))
    inverse = np.zeros((n, n, LANES))
    rest = np.zeros((m, LANES))
    y = np.zeros((n, LANES))
    trace = np.zeros(LANES)
    spread = np.zeros(LANES)
    for start in range(0, samples, LANES):
        lanes = min(LANES, samples - start)
        trace[:] = 0.0
        spread[:] = 0.0
        for i in range(n):
            for j in range(i + 1):
                s = L[i, j]
                s[:] = 0.0
                for r in range(m):
                    if pattern[r, i] and pattern[r, j]:
                        for p in range(lanes):
                            s[p] += a[r, i, start + p] * a[r, j, start + p]
            for p in range(lanes):
                trace[p] += L[i, i, p]
        for j in range(n):
            for q in range(j):
                for p in range(lanes):
                    L[j, j, p] -= L[j, q, p] * L[j, q, p]
            for p in range(lanes):
                L[j, j, p] = np.sqrt(L[j, j, p])
            for i in range(j + 1, n):
                for q in range(j):
                    for p in range(lanes):
                        L[i, j, p] -= L[i, q, p] * L[j, q, p]
                for p in range(lanes):
                    L[i, j, p] /= L[j, j, p]
        # the inverse of the triangle gives the condition number
        for j in range(n):
            for i in range(j, n):
                s = inverse[i, j]
                s[:] = 1.0 if i == j else 0.0
                for q in range(j, i):
                    for p in range(lanes):
                        s[p] -= L[i, q, p] * inverse[q, j, p]
                for p in range(lanes):
                    s[p] /= L[i, i, p]
                    spread[p] += s[p] * s[p]
        for p in range(lanes):
            condition[start + p] = np.sqrt(trace[p] * spread[p])
        for column in range(k):
            for step in range(2 if refine else 1):
                for r in range(m):
                    for p in range(lanes):
                        rest[r, p] = b[r, column, start + p]
                    if step > 0:
                        for i in range(n):
                            if pattern[r, i]:
                                for p in range(lanes):
                                    rest[r, p] -= a[r, i, start + p] * x[i, column, start + p]
                for i in range(n):
                    s = y[i]
                    s[:] = 0.0
                    for r in range(m):
                        if pattern[r, i]:
                            for p in range(lanes):
                                s[p] += a[r, i, start + p] * rest[r, p]
                    for q in range(i):
                        for p in range(lanes):
                            s[p] -= L[i, q, p] * y[q, p]
                    for p in range(lanes):
                        s[p] /= L[i, i, p]
                for i in range(n - 1, -1, -1):
                    s = y[i]
                    for q in range(i + 1, n):
                        for p in range(lanes):
                            s[p] -= L[q, i, p] * y[q, p]
                    for p in range(lanes):
                        s[p] /= L[i, i, p]
                        x[i, column, start + p] += s[p]
    return x, condition
