"""Prediction of a run: torques predicted and measured at every sample, with tables of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from gtau.display import views
from gtau.signals.preparation.filters import Decimator

if TYPE_CHECKING:
    import polars as pl


@dataclass(frozen=True)
class Prediction:
    """Torques at every sample of a run: ``time`` (N,) in s, ``predicted`` and ``measured`` (N, n) in N m or N.

    ``friction`` (N, n) is the part of what is predicted that friction and offsets take.

    Measured torques are raw. Those predicted are at the instants of the commands, and behind no low-pass but that of
    the positions, up to where their noise takes over; :attr:`in_band` has both behind the low-pass of identification,
    ``decimator``, and :attr:`rows` one sample in its factor. ``keep`` (N, n) is False near a joint's reversals and
    rests, which identification of gains and inertia leaves out, and near gaps; ``valid``
    (N, n) is False near gaps and repaired samples, and at the ends of the log up to where the motion begins.
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
            self.decimator.smooth(each.T, 0, len(self.time)).T
            for each in (self.predicted, self.measured, self.friction)
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
        """Return the prediction as a Polars table, one row per instant and joint; ``.to_pandas()`` converts it."""
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

    def _repr_html_(self) -> str:
        html: str = views().html(self)
        return html
