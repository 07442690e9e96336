"""All runs of an experiment, read and reduced to factors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from idim.errors import IdimError
from idim.estimation.assembly import Assembly, assemble
from idim.estimation.base_parameters import BaseParameters, base_parameters
from idim.estimation.factors import Factors, Weigh, reduce_run
from idim.estimation.friction import PAPER, Friction
from idim.model.inverse_dynamics import InverseDynamics
from idim.robots.load import load_robot
from idim.robots.robot import Robot
from idim.signals.decimation import decimation_factor
from idim.signals.experiment import Experiment, LoggedRun, Payload, check_robot, read_experiment
from idim.signals.filters import cutoff_frequency
from idim.signals.preparation import Preparation, Prepared, choose_preparation, faster, prepare
from idim.signals.run import Run, arrange, read_run

if TYPE_CHECKING:
    from idim.estimation.result import Result

Progress = Callable[[str, int, int], None]
"""Called with what is being done, how much of it is done, and how much there is."""


def silent(what: str, done: int, total: int) -> None:
    """Progress that nobody watches."""


@dataclass(frozen=True, eq=False)
class Data:
    """All runs of an experiment, read and reduced, before any estimation."""

    robot: Robot
    model: InverseDynamics
    base: BaseParameters
    preparation: Preparation
    prepared: tuple[Prepared, ...]
    factors: tuple[Factors, ...]

    @property
    def runs(self) -> tuple[Run, ...]:
        """The runs, their joints in the model's order."""
        return tuple(each.run for each in self.prepared)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was repaired or left out of each run."""
        return tuple(f"{each.run.name}: {note}" for each in self.prepared for note in (*each.run.notes, *each.notes))

    def assembly(
        self, friction: Friction = PAPER, delays: bool = True, payloads: Sequence[Payload | None] | None = None
    ) -> Assembly:
        """The estimation problem with this friction; if need be without delays, or with other known payload values."""
        payloads = [run.payload for run in self.runs] if payloads is None else payloads
        slowest = 0.5 / (2 * np.pi * self.preparation.bandwidth) if delays else 0.0
        return assemble(self.model, self.base, self.factors, payloads, slowest, friction)

    def reduced(
        self,
        loads: Sequence[np.ndarray] | None = None,
        progress: Progress = silent,
        weigh: Sequence[Weigh] | None = None,
    ) -> Data:
        """The same runs reduced to factors, with the torques of ``loads`` (one a run) in load-dependent friction.

        ``weigh`` (one a run) gives the rows weights; see :func:`reduce_run`.
        """
        decimator = self.preparation.decimator
        total = sum(len(decimator.instants(len(each.time))) for each in self.prepared)
        done = 0

        def advance(outputs: int) -> None:
            nonlocal done
            done += outputs
            progress("model along the runs", done, total)

        factors = [
            reduce_run(
                self.model,
                self.base.standard,
                each,
                decimator,
                None if loads is None else loads[k],
                advance,
                None if weigh is None else weigh[k],
            )
            for k, each in enumerate(self.prepared)
        ]
        return replace(self, factors=tuple(factors))


def read_runs(experiment: Experiment, runs: Sequence[LoggedRun]) -> tuple[Run, ...]:
    """Read logged runs of an experiment file; raises IdimError."""
    return tuple(read_run(run.log, experiment.signals, run.payload, experiment.units) for run in runs)


def experiment_of(model: Result, path: str | Path) -> Experiment:
    """Read an experiment file that is to be used with an identified model.

    Raises
    ------
    IdimError
        Where the file is wrong, or its robot or signals are not those of the model.
    """
    experiment = read_experiment(path)
    robot = load_robot(experiment.robot)
    check_robot(experiment, robot)
    if replace(robot, name="", source="") != replace(model.robot, name="", source=""):
        raise IdimError(
            f"{path} describes the robot '{robot.name}', but the model is of '{model.robot.name}' or of "
            "another geometry; give the model of this robot."
        )
    if experiment.signals.kind != model.kind:
        raise IdimError(
            f"the logs of {path} hold {experiment.signals.kind}s, but the model was identified from {model.kind}s; "
            "give logs of the same kind."
        )
    return experiment


def at_rate_of(runs: Sequence[Run], preparation: Preparation) -> Preparation:
    """A preparation chosen for other runs, with filters for the sampling rate of these."""
    rate = min(run.rate for run in runs)
    factor = decimation_factor(rate, preparation.bandwidth)
    return replace(
        preparation,
        cutoff=cutoff_frequency(preparation.bandwidth, rate),
        decimator=replace(preparation.decimator, factor=factor),
    )


def reduce_runs(
    robot: Robot,
    runs: Sequence[Run],
    preparation: Preparation | None = None,
    decimator: Literal["fir", "chebyshev"] = "fir",
    progress: Progress = silent,
) -> Data:
    """Prepare all runs and reduce them to triangular factors.

    Raises
    ------
    IdimError
        Where a run does not suit the robot, or the robot's loops cannot be closed along it.
    """
    model = InverseDynamics(robot)
    runs = tuple(arrange(run, model.actuated) for run in runs)
    if len({run.kind for run in runs}) > 1:
        raise IdimError("some runs hold currents and others torques; identify them apart.")
    preparation = preparation or choose_preparation(runs, decimator)
    progress("base parameters", 0, 1)
    base = base_parameters(model)
    prepared = tuple(_coupled(model, prepare(run, preparation), preparation) for run in runs)
    return Data(robot, model, base, preparation, prepared, ()).reduced(progress=progress)


def _coupled(model: InverseDynamics, prepared: Prepared, preparation: Preparation) -> Prepared:
    """Leave out the rows of a motor near reversals of the joints that it drives through couplings too.

    Their Coulomb friction acts in the motor's row; the ratios do not change along a run.
    """
    robot = model.robot
    if not robot.couplings or robot.closures:
        return prepared
    still = np.zeros((len(model.actuated), 1))
    J = model.motion(still, still, still).J[:, :, 0]
    slow = ~faster(prepared.qd @ J.T, preparation.speed_fraction)  # (N, n_y)
    near = slow.astype(float) @ (np.abs(J) > 1e-9) > 0
    return replace(prepared, usable=prepared.usable & ~near)
