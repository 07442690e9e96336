"""Position filter of predictions: as wide as the noise of the positions allows, chosen on the identification runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.results.prediction import joint_torques, loaded_parameters, prepared_for
from gtau.estimation.results.result import Result
from gtau.signals.preparation.bandwidth import position_noise
from gtau.signals.preparation.filters import HIGHEST_CUTOFF
from gtau.signals.preparation.prepared_run import PreparedRun
from gtau.signals.run import Run

SAMPLES = 1 << 14  # of all runs together, from the middle of each
STEP = np.sqrt(2.0)  # between the cut-offs tried
# Share by which position noise may raise the error. The error hardly depends on a cut-off below the noise (the
# Panda's from 7 to 50 Hz by 1 %), so the highest one is taken: other motions than those of the logs may be faster.
RAISED = 0.01
NOISY = 2.0  # times its least: noise then rules the error of a joint, and higher cut-offs are not tried


def with_prediction_cutoffs(result: Result, runs: Sequence[Run]) -> Result:
    """Choose the position filter of each joint for predictions, from runs that a model was identified from.

    A lower cut-off loses the torque of fast motion, a higher one lets position noise pass, which inertia and friction
    turn into torque. Of each joint the highest is taken whose error against the raw torque exceeds the least by no more
    than 1 %. A run with faster motion is filtered less, see
    :func:`gtau.signals.preparation.bandwidth.widened`.

    Parameters
    ----------
    result : Result
        The model; a position filter set by hand is kept.
    runs : sequence of Run
        Those of its identification.

    Returns
    -------
    Result
        With ``prediction_cutoffs`` and ``position_noise`` in its preparation.
    """
    preparation = result.preparation
    stretches = [found for run in runs if (found := _stretch(result, run, SAMPLES // len(runs))) is not None]
    if "position_filter" in preparation.given or not stretches:
        return result
    highest, tried = HIGHEST_CUTOFF * min(run.rate for run in runs), [preparation.bandwidth]
    while tried[-1] * STEP < highest:
        tried.append(tried[-1] * STEP)
    errors: list[np.ndarray] = []
    for cutoff in tried:
        errors.append(np.sqrt(np.sum([_squares(result, cutoff, *each) for each in stretches], axis=0)))
        if (errors[-1] > NOISY * np.min(errors, axis=0)).all():
            break
    allowed = np.array(errors) <= (1 + RAISED) * np.min(errors, axis=0)
    last = len(errors) - 1 - np.argmax(allowed[::-1], axis=0)
    cutoffs = tuple(float(tried[k]) if tried[k] < highest else None for k in last)
    noise = np.max([position_noise(each.run, cutoffs) for each, _ in stretches], axis=0)
    preparation = replace(preparation, prediction_cutoffs=cutoffs, position_noise=tuple(noise.tolist()))
    return result.replaced(preparation=preparation)


def _stretch(result: Result, run: Run, samples: int) -> tuple[PreparedRun, np.ndarray] | None:
    """Prepare the middle of a run, with the base parameters (n_b,) of its payload; None if its mass is unknown."""
    prepared, moving = prepared_for(result, run)
    try:
        chi = loaded_parameters(result, run.payload, f"run '{run.name}'")
    except GtauError:
        return None
    middle = (moving.start + moving.stop) // 2
    kept = range(max(moving.start, middle - samples // 2), min(moving.stop, middle + samples // 2))
    return replace(prepared, kept=kept), chi


def _squares(result: Result, cutoff: float, prepared: PreparedRun, chi: np.ndarray) -> np.ndarray:
    """Sum squares (n,) of the errors against the raw torques, with positions behind a ``cutoff`` (Hz)."""
    wide = replace(prepared, cutoffs=(cutoff,) * len(prepared.run.joints))
    predicted, _, measured = joint_torques(result, wide, chi)
    valid = prepared.valid()[:, : len(measured)].T
    return np.asarray(np.sum((measured - predicted) ** 2, axis=1, where=valid))
