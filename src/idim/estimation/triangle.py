"""The triangular factor, the statistic that all estimators work on."""

from __future__ import annotations

import numpy as np


def triangle(*blocks: np.ndarray) -> np.ndarray:
    """Triangular factor R (min(r, c), c) of the stacked ``blocks`` (., c): ``R^T R = A^T A``.

    Of triangular factors it is the factor of all the rows behind them.
    """
    stacked = blocks[0] if len(blocks) == 1 else np.concatenate(blocks)
    return np.asarray(np.linalg.qr(stacked, mode="r"))
