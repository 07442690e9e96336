"""Fixtures for all tests."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

# The tests fill all cores with processes of their own: there BLAS threads only wait for each other (a QR of 4500 x 220
# takes 2.5 s with two threads on two busy cores and 0.02 s with one). Programs that tests start inherit the variables.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("GTAU_THREADS", "1")
threadpool_limits(1, "blas")


@pytest.fixture(scope="session")
def shared() -> Path:
    """Measured and simulated logs beside the checkout."""
    data = Path(__file__).parents[2] / "shared" / "data"
    if not data.is_dir():
        pytest.skip("../shared/data is not beside the checkout")
    return data


@pytest.fixture
def two_estimators(monkeypatch: pytest.MonkeyPatch) -> None:
    """``gtau compare`` with two estimators, where a test is about its page or its input."""
    monkeypatch.setattr("gtau.estimation.identify.NAMES", ("ml", "wls"))


@pytest.fixture
def rng() -> np.random.Generator:
    """The same random numbers in every run."""
    return np.random.default_rng(20261121)
