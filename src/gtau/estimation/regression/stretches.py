"""Stretches of a run, which the jackknife leaves out in turn: of as many samples in motion each."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from gtau.estimation.regression.equations import STRETCHES
from gtau.signals.preparation import InMemoryRun, PreparedRun

ASLEEP = 1e-6  # weight of a sample in a rest
REST = 0.5  # of a stretch: shorter rests leave rows in it, and longer ones may leave none


def stretch_edges(prepared: PreparedRun | InMemoryRun) -> np.ndarray:
    """Find the edges of the stretches of a run, as shares of its samples, (STRETCHES + 1,).

    Stretches are equal if the robot does not rest for long; if it does, equal ones would leave all rows to a few.
    """
    at, awake = prepared.awake()
    weight = np.ones(len(awake))
    moving = np.concatenate([[-1], np.flatnonzero(awake), [len(awake)]]).tolist()
    for before, after in pairwise(moving):
        if at[after] - at[before + 1] > REST * at[-1] / STRETCHES:
            weight[before + 1 : after] = ASLEEP
    along = np.cumsum([0.0, *(np.diff(at) * weight)])
    return np.asarray(np.interp(np.linspace(0.0, along[-1], STRETCHES + 1), along, at / at[-1]))


def stretch_of(edges: np.ndarray, outputs: int) -> np.ndarray:
    """List the number of the stretch of each of ``outputs`` rows, (outputs,), from the edges of the stretches."""
    return np.asarray(np.searchsorted(np.round(edges[1:-1] * outputs, 6), np.arange(outputs), side="right"))
