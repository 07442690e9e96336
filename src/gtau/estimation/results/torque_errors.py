"""Torque errors of predictions: raw, in the band of identification, by frequency; and what the experiment requires."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.results.estimate import BandError, Requirement, TorqueError
from gtau.estimation.results.predicted import Prediction
from gtau.estimation.results.prediction import predict
from gtau.estimation.results.result import Result
from gtau.robots.units import torque_unit
from gtau.signals.reading.statements import Requirements
from gtau.signals.run import Run


def torque_errors(result: Result, prediction: Prediction) -> tuple[TorqueError, ...]:
    """Compute rms of error and signal of each joint that moves.

    Behind the low-pass of identification over the kept rows, and over all valid ones; and over these against the raw
    torque, as a whole and by frequency.
    """
    errors = []
    behind = prediction.in_band
    for j, joint in enumerate(prediction.joints):
        kept, valid = prediction.keep[:, j], prediction.valid[:, j]
        if not kept.any() or not prediction.measured[:, j].any():  # nothing may act on a base in some direction
            continue
        smooth, raw = (
            np.stack([each.measured[:, j] - each.predicted[:, j], each.measured[:, j]]) for each in (behind, prediction)
        )
        (rms, signal), (rms_all, signal_all), (rms_raw, signal_raw) = (
            np.sqrt(np.mean(pair[:, rows] ** 2, axis=1)).tolist()
            for pair, rows in ((smooth, kept), (smooth, valid), (raw, valid))
        )
        bands = _bands(prediction.time, raw, valid, result.preparation.bandwidth)
        unit = torque_unit(result.robot, joint)
        errors.append(TorqueError(joint, rms, signal, unit, rms_all, signal_all, rms_raw, signal_raw, bands))
    return tuple(errors)


def _bands(time: np.ndarray, raw: np.ndarray, valid: np.ndarray, bandwidth: float) -> tuple[BandError, ...]:
    """Compute rms of error and signal (2, N) in octaves from the ``bandwidth`` (Hz) of the motion to Nyquist."""
    from scipy.signal.windows import tukey

    rate = (len(time) - 1) / float(time[-1] - time[0])
    window = tukey(len(time), 0.1) * valid
    frequency = np.fft.rfftfreq(len(time), 1 / rate)
    power = []
    for values in raw:
        mean = values[valid].mean()  # apart, as its sidelobes would reach far
        density = 2 * np.abs(np.fft.rfft(window * (values - mean))) ** 2 / (len(time) * (window**2).sum())
        density[0] = mean**2
        power.append(np.concatenate([[0.0], np.cumsum(density)]))
    octave = 2.0 ** np.ceil(np.log2(bandwidth))
    octaves = octave * 2.0 ** np.arange(max(np.ceil(np.log2(0.5 * rate / octave)), 0))
    edges = np.array([0.0, *octaves, 0.5 * rate])
    at = np.searchsorted(frequency, edges)
    at[-1] = len(frequency)
    rms = np.sqrt(np.diff(np.array(power)[:, at], axis=1))
    listed = np.column_stack([edges[:-1], edges[1:], *rms]).tolist()
    return tuple(BandError(*values) for values in listed)


def judge(result: Result, require: Requirements, validation: Sequence[Run]) -> tuple[Requirement, ...]:
    """Compare a result with its requirements, its torque errors also on the runs kept for ``validation``."""
    return tuple(_judged(result, require, validation))


def _judged(result: Result, require: Requirements, validation: Sequence[Run]) -> Iterator[Requirement]:
    if require.torque_error is not None:
        yield _of_torques(require.torque_error, result.residuals)
        for run in validation:
            try:
                errors = torque_errors(result, predict(result, run))
            except GtauError:
                errors = ()
            yield _of_torques(require.torque_error, errors, run.name)
    if require.gain_interval is not None:
        widths = {joint: gain.half_width for joint, gain in result.drive_gains.items()}
        unknown = [joint for joint, width in widths.items() if width is None]
        joint = unknown[0] if unknown else max(widths, key=lambda name: widths[name] or 0.0)
        yield Requirement("gain_interval", require.gain_interval, widths[joint], joint)


def _of_torques(limit: float, errors: Iterable[TorqueError], run: str = "") -> Requirement:
    worst = max(errors, key=lambda each: each.relative, default=None)
    if worst is None:
        return Requirement("torque_error", limit, None, run=run)
    return Requirement("torque_error", limit, worst.relative, worst.joint, run)
