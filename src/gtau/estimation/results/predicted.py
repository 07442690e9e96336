"""Prediction of a run: torques predicted and measured at every sample, tables of them, and their errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from gtau.estimation.results.estimate import BandError, TorqueError
from gtau.robots.parameter import torque_unit
from gtau.robots.robot import Robot
from gtau.signals.preparation.filters import Decimator

if TYPE_CHECKING:
    import polars as pl


@dataclass(frozen=True)
class Prediction:
    """Torques at every sample of a run: ``time`` (N,) in s, ``predicted`` and ``measured`` (N, n) in N m or N.

    ``friction`` (N, n) is the part of what is predicted that friction and offsets take.

    Measured torques are raw. Predicted torques are at the instants of the commands, and behind no low-pass but the one
    of the positions, up to where their noise takes over; :attr:`in_band` has both behind the low-pass of
    identification, ``decimator``, and :attr:`rows` one sample in its factor. ``keep`` (N, n) is False near a joint's
    reversals and rests, which identification of gains and inertia leaves out, and near gaps; ``valid`` (N, n) is False
    near gaps and repaired samples, and at the ends of the log up to where the motion begins.
    """

    joints: tuple[str, ...]
    time: np.ndarray
    predicted: np.ndarray
    measured: np.ndarray
    keep: np.ndarray
    valid: np.ndarray
    friction: np.ndarray
    decimator: Decimator

    @property
    def in_band(self) -> Prediction:
        """Predicted and measured torques behind the low-pass of identification, as its residuals are."""
        predicted, measured, friction = (
            self.decimator.smooth(torque.T, 0, len(self.time)).T
            for torque in (self.predicted, self.measured, self.friction)
        )
        return replace(self, predicted=predicted, measured=measured, friction=friction, decimator=Decimator(1))

    @property
    def rows(self) -> Prediction:
        """The rows of identification, whose residuals are as independent as its low-pass lets them be."""
        factor = self.decimator.factor
        return self.in_band.part(slice(factor // 2, None, factor))

    def part(self, samples: slice | np.ndarray) -> Prediction:
        """Take some of the samples."""
        names = ("time", "predicted", "measured", "friction", "keep", "valid")
        return replace(self, **{name: getattr(self, name)[samples] for name in names})

    def of(self, joints: Sequence[str]) -> Prediction:
        """Take some of the joints."""
        chosen = [self.joints.index(joint) for joint in joints]
        names = ("predicted", "measured", "friction", "keep", "valid")
        return replace(self, joints=tuple(joints), **{name: getattr(self, name)[:, chosen] for name in names})

    def __repr__(self) -> str:
        return (
            f"Prediction({len(self.time)} samples of joints {', '.join(self.joints)}, {self.time[0]:.4g} to "
            f"{self.time[-1]:.4g} s)"
        )

    def table(self) -> pl.DataFrame:
        """Return the torques as a Polars table, one row per sample.

        Columns: ``t`` (s); for each joint ``motor_J`` (drive gain times current), ``model_J`` (what the motion takes),
        ``external_J`` (the torque that the environment exerts on the joint, model minus motor; N m or N), ``usable_J``
        (``keep``) and ``valid_J``.
        """
        import polars as pl

        columns = {"t": self.time}
        for j, joint in enumerate(self.joints):
            columns |= {
                f"motor_{joint}": self.measured[:, j],
                f"model_{joint}": self.predicted[:, j],
                f"external_{joint}": self.predicted[:, j] - self.measured[:, j],
                f"usable_{joint}": self.keep[:, j],
                f"valid_{joint}": self.valid[:, j],
            }
        return pl.DataFrame(columns)

    def to_frame(self) -> pl.DataFrame:
        """Return the prediction as a Polars table, one row per instant and joint."""
        import polars as pl

        samples, n = self.measured.shape
        return pl.DataFrame(
            {
                "time": np.repeat(self.time, n),
                "joint": np.tile(np.array(self.joints), samples),
                "measured": self.measured.reshape(-1),
                "predicted": self.predicted.reshape(-1),
                "kept": self.keep.reshape(-1),
                "valid": self.valid.reshape(-1),
            }
        )


def torque_errors(prediction: Prediction, robot: Robot, bandwidth: float) -> tuple[TorqueError, ...]:
    """Compute rms of error and signal of each joint that moves, whose motion has a ``bandwidth``, Hz.

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
            np.stack([torques.measured[:, j] - torques.predicted[:, j], torques.measured[:, j]])
            for torques in (behind, prediction)
        )
        (rms, signal), (rms_all, signal_all), (rms_raw, signal_raw) = (
            np.sqrt(np.mean(pair[:, rows] ** 2, axis=1)).tolist()
            for pair, rows in ((smooth, kept), (smooth, valid), (raw, valid))
        )
        bands = _bands(prediction.time, raw, valid, bandwidth)
        unit = torque_unit(robot, joint)
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
