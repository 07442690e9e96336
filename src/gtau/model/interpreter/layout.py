"""Operation codes and memory layout shared by the compiled loops and their callers."""

from __future__ import annotations

import numpy as np

LANES = 64
WIDE = 8  # doubles in a cache line
ROW = LANES + 8  # doubles from a row to the next: strides that are powers of two thrash the cache
TILE = 8  # samples of a path that are put into the results together: a cache line of each row

OPERATIONS = (
    *("MUL", "ADD", "SUB", "MULTIPLY_ADD", "MULTIPLY_SUBTRACT", "SUBTRACT_PRODUCT"),
    *("MUL last", "ADD last", "SUB last", "SUB from last", "MULTIPLY_ADD last", "MULTIPLY_SUBTRACT last"),
    *("SUBTRACT_PRODUCT last", "MULTIPLY_ADD by last", "MULTIPLY_SUBTRACT by last", "SUBTRACT_PRODUCT by last"),
    *("NEG", "DIV", "SQRT", "ASSIGN", "SIGN", "FABS", "FMAX", "SINE_COSINE"),
)
"""Operations of the interpreter; the index in this tuple is the operation code."""

NOWHERE = 2**32 - 1
"""Row of a result that only the next instruction needs."""

_ADDRESSES = (
    *("machine", "step", "step_count", "step_rows", "fast_step", "fast_step_count", "fast_step_rows"),
    *("gap", "gap_count", "gap_rows", "trial", "made", "scale", "actuated", "n_c", "n"),
    *("now", "guess", "past", "tile", "target", "begin"),
)
FOLLOWER = np.dtype(
    [(name, np.int64) for name in _ADDRESSES]
    + [(name, np.float64) for name in ("shortest", "residual", "contraction", "reach")]
)
"""What the loops are followed with: addresses, sizes, and the parameters of the continuation.

The programs read ``trial`` (n_c, ROW) and write ``made``: n_c rows, then size, condition and gap. ``actuated`` (n,) are
rows of the configuration, and ``scale`` (n_c,) is what its entries are multiplied by to become rad or lengths over the
characteristic length, zero for the actuated. The compiled loops work with ``now`` and ``guess`` (n_c, LANES), ``past``
(2, n_c, LANES), ``tile`` (n_c, LANES, TILE), ``target`` and ``begin`` (n, LANES).
"""
