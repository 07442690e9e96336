"""All runs of an experiment, read and reduced to factors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from idim.errors import IdimError
from idim.estimation.assembly import Assembly, assemble
from idim.estimation.base_parameters import BaseParameters, base_parameters
from idim.estimation.factors import Factors, reduce_run
from idim.model.inverse_dynamics import InverseDynamics
from idim.robots.robot import Robot
from idim.signals.experiment import Experiment, LoggedRun, Payload
from idim.signals.preparation import Preparation, choose_preparation, prepare
from idim.signals.run import Run, arrange, read_run

Progress = Callable[[str, int, int], None]
"""Called with what is being done, how much of it is done, and how much there is."""


@dataclass(frozen=True, eq=False)
class Data:
    """All runs of an experiment, read and reduced, before any estimation."""

    robot: Robot
    model: InverseDynamics
    base: BaseParameters
    preparation: Preparation
    runs: tuple[Run, ...]
    factors: tuple[Factors, ...]
    notes: tuple[str, ...]

    def assembly(self, payloads: Sequence[Payload | None] | None = None) -> Assembly:
        """The estimation problem, if need be with other known payload values."""
        payloads = [run.payload for run in self.runs] if payloads is None else payloads
        return assemble(self.model, self.base, self.factors, payloads, self.preparation.bandwidth)


def read_runs(experiment: Experiment, runs: Sequence[LoggedRun]) -> tuple[Run, ...]:
    """Read logged runs of an experiment file; raises IdimError."""
    return tuple(read_run(run.log, experiment.signals, run.payload, experiment.units) for run in runs)


def reduce_runs(
    robot: Robot,
    runs: Sequence[Run],
    preparation: Preparation | None = None,
    decimator: Literal["fir", "chebyshev"] = "fir",
    progress: Progress = lambda what, done, total: None,
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
    prepared = [prepare(run, preparation) for run in runs]
    total = sum(len(preparation.decimator.instants(len(each.time))) for each in prepared)
    done = 0

    def advance(outputs: int) -> None:
        nonlocal done
        done += outputs
        progress("model along the runs", done, total)

    factors = tuple(reduce_run(model, base.standard, each, preparation.decimator, advance) for each in prepared)
    notes = tuple(f"{each.run.name}: {note}" for each in prepared for note in (*each.run.notes, *each.notes))
    return Data(robot, model, base, preparation, runs, factors, notes)
