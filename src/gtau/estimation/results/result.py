"""The result of an identification: the identified model, with what can be done with it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gtau.estimation.results.estimate import Prediction, TorqueError
from gtau.estimation.results.identified_model import IdentifiedModel
from gtau.estimation.results.model_file import load, save
from gtau.estimation.results.prediction import predict, torque_errors
from gtau.estimation.results.summary import summary
from gtau.signals.run import Run


@dataclass(frozen=True, eq=False, repr=False)
class Result(IdentifiedModel):
    """Drive gains, parameters and payloads of a robot, identified from its logs.

    See :class:`gtau.estimation.results.identified_model.IdentifiedModel` for its attributes.
    """

    def summary(self) -> str:
        """The result as a table to print."""
        return summary(self)

    def predict(self, run: Run) -> Prediction:
        """Torques that the model predicts along ``run``, beside the measured ``v g_tau``.

        Raises
        ------
        GtauError
            Where the run does not suit the robot, or the model refuses a sample.
        """
        return predict(self, run)

    def validate(self, run: Run) -> tuple[TorqueError, ...]:
        """Torque error of each joint on a run, over the samples that identification would use."""
        return torque_errors(self, self.predict(run))

    def save(self, path: str | Path) -> None:
        """Write the result as JSON, atomically; see :mod:`gtau.estimation.results.model_file`."""
        save(self, path)

    @staticmethod
    def load(path: str | Path) -> Result:
        """Read a result that :meth:`save` wrote; raises GtauError where the file is not one."""
        return load(path, Result)
