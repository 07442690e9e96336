"""Result of an identification: the identified model, with its methods to predict, validate, plot and save."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau import display
from gtau.estimation.diagnostics.verdict import Outcome
from gtau.estimation.results.estimate import TorqueError
from gtau.estimation.results.identified_model import IdentifiedModel, estimates_frame
from gtau.estimation.results.model_file import load, save
from gtau.estimation.results.prediction import Prediction, predict, torques
from gtau.estimation.results.torque_errors import torque_errors
from gtau.signals.payload import Payload, as_payload
from gtau.signals.run import Run

if TYPE_CHECKING:
    import polars as pl

    from gtau.report.plots import Plots


@dataclass(frozen=True, eq=False, repr=False)
class Result(IdentifiedModel):
    """Drive gains, parameters and payloads of a robot, identified from its logs.

    See :class:`gtau.estimation.results.identified_model.IdentifiedModel` for its attributes.
    """

    def summary(self, verbose: bool = True) -> str:
        """Summarise the result as text: one screen, or with ``verbose`` all of it."""
        text: str = display.views().text(self, verbose)
        return text

    def torques(
        self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, payload: Payload | Mapping[str, Any] | None = None
    ) -> np.ndarray:
        """Compute torques of the identified model at given states, including all its friction.

        Parameters
        ----------
        q, qd, qdd : ndarray
            Positions, velocities and accelerations (N, n) of the actuated joints, SI units. The samples are taken as
            points of a path that starts at home.
        payload : mapping, optional
            As in an experiment file: ``{"name": "steel"}`` for one that was identified, or with its ``mass``, ...

        Returns
        -------
        ndarray
            (N, n), N m or N.

        Raises
        ------
        GtauError
            Where the loops cannot be closed, a pose is too close to a singularity, or the payload's mass is unknown.
        """
        return torques(self, q, qd, qdd, as_payload(payload))

    def currents(
        self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, payload: Payload | Mapping[str, Any] | None = None
    ) -> np.ndarray:
        """Compute the currents (N, n), A, for the torques of :meth:`torques`: ``v = tau / g_tau``.

        Delays are not applied: the current reference leads the motion by ``delays``. From logs of torques, whose gains
        are 1, they are these torques, and so are the rows of a floating base.
        """
        return self.torques(q, qd, qdd, payload) / self.gains

    def predict(self, run: Run) -> Prediction:
        """Predict torques along ``run``, beside the raw measured ``v g_tau``.

        Raises
        ------
        GtauError
            Where the run does not suit the robot, or the model refuses a sample.
        """
        return predict(self, run)

    def validate(self, run: Run) -> tuple[TorqueError, ...]:
        """Compute torque errors of each joint on a run: against the raw torque, by frequency, and in the fit's band."""
        return torque_errors(self, self.predict(run))

    @property
    def believable(self) -> bool:
        """Whether some drive gain is good, weak or given, and nothing contradictory: no estimate, payload or sensor."""
        estimates = (*self.delays.values(), *self.parameters.values(), *self.friction.values())
        verdicts = [each.verdict for of in (estimates, self.payloads, self.sensors) for each in of]
        gains = {gain.verdict.outcome for gain in self.drive_gains.values()}
        outcomes = gains | {verdict.outcome for verdict in verdicts}
        return Outcome.CONTRADICTORY not in outcomes and gains != {Outcome.NOT_IDENTIFIABLE}

    @property
    def accepted(self) -> bool:
        """Whether the result is :attr:`believable` and meets all requirements of the experiment file."""
        return self.believable and all(each.met for each in self.requirements)

    @property
    def plot(self) -> Plots:
        """Plot the result, one figure per call: ``result.plot.torques("elbow_joint")``."""
        plots: Plots = display.views().plots(self)
        return plots

    def report(self, path: str | Path) -> None:
        """Write the report of the result and its runs as one self-contained HTML file."""
        display.views().write(self, Path(path))

    def to_frame(self) -> pl.DataFrame:
        """Return all estimates as a Polars table, one row per estimate; ``to_frame().to_pandas()`` converts it."""
        return estimates_frame(self)

    def _repr_html_(self) -> str:
        html: str = display.views().html(self)
        return html

    def save(self, path: str | Path) -> None:
        """Write the result as JSON, atomically; see :mod:`gtau.estimation.results.model_file`."""
        save(self, path)

    @staticmethod
    def load(path: str | Path) -> Result:
        """Load a result written by :meth:`save`; raises GtauError if the file is not one."""
        return load(path, Result)
