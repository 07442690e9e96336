"""The format version of cached factors: their numbers do not change without a new one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from five_bar_logs import CHI, STEEL, Plant, five_bar

from gtau.estimation.regression.dataset import reduce_runs, reduce_shard
from gtau.estimation.regression.factors import EXTRA, FACTORS_VERSION, Factors, HuberWeights
from gtau.signals.decimation import Decimator
from gtau.signals.preparation import Preparation

DIGESTS = {  # by version; where the test fails and the change is meant, raise FACTORS_VERSION and write the new ones
    4: {
        "plain": [2593556.834, -414908.3283, 311.0, -0.2211146148, 0.0, -1.357657338],
        "chebyshev": [21344740.88, -3310892.806, 316.0, 0.1353615426, 0.0, -1.418245798],
        "load and weights": [172514.521, -2962.906442, 311.0, -0.2211146148, -3.501192885, -1.357657338],
    },
}


def digest(factors: Factors) -> list[float]:
    """Sums over every entry: of the triangles' Gram matrices plain and weighted, of rows, distances and so on."""
    gram = factors.R.swapaxes(-1, -2) @ factors.R
    weights = np.cos(np.arange(gram.size)).reshape(gram.shape)
    found = [float(np.trace(gram, axis1=-2, axis2=-1).sum()), float((weights * gram).sum()), float(factors.rows.sum())]
    for array in (factors.distances, factors.residuals, factors.speeds):
        kept = np.zeros(1) if array is None or not len(array) else np.nan_to_num(np.asarray(array, dtype=float))
        found.append(float(kept.ravel() @ np.cos(np.arange(kept.size))))
    return found


@pytest.mark.parametrize("kind", ["plain", "chebyshev", "load and weights"])
def test_the_numbers_of_factors_are_those_of_their_version(kind: str) -> None:
    run = Plant(delays=(1e-3, 1e-3)).run("loaded", 3.0, payload=STEEL)
    decimator = Decimator(8, "chebyshev" if kind == "chebyshev" else "fir")
    settings = Preparation(bandwidth=4.0, cutoff=40.0, decimator=decimator, speed_fraction=0.05)
    dataset = reduce_runs(five_bar().robot, [run], settings)
    ((shard,),) = dataset.parts()
    if kind == "load and weights":
        columns = np.array([CHI.get(name, 0.0) for name in shard.columns])
        weights = HuberWeights(np.full((2, len(columns) + EXTRA), 0.01), np.full(2, 0.05))
        shard = replace(shard, load=columns, weigh=weights)
    assert digest(reduce_shard(shard)) == pytest.approx(DIGESTS[FACTORS_VERSION][kind], rel=1e-7, abs=1e-6)
