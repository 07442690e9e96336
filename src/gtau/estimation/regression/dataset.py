"""All runs of an experiment, read and reduced to factors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.regression.factors import Factors, reduce_run
from gtau.estimation.regression.friction import PAPER, Friction, Temperatures, temperatures_of
from gtau.estimation.regression.plausibility import within_limits
from gtau.estimation.regression.priors import inertia_priors
from gtau.estimation.regression.run_blocks import Place, aligned_edges, find_places
from gtau.estimation.regression.system import System, assemble_system
from gtau.estimation.regression.windows import Windows, central_windows
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.model.base_parameters import BaseParameters, base_parameters
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.progress import Progress, silent
from gtau.robots.plausibility import oddities, tool_note
from gtau.robots.robot import Robot
from gtau.signals.preparation.choice import choose_preparation
from gtau.signals.preparation.prepared_run import Preparation, PreparedRun, SampleWindow, prepare
from gtau.signals.reading.statements import Payload, Prior
from gtau.signals.run import Run


@lru_cache(maxsize=8)
def model_of(robot: Robot) -> InverseDynamics:
    """Return the model of a robot, built once."""
    return InverseDynamics(robot)


@lru_cache(maxsize=8)
def base_of(robot: Robot, sensors: tuple[str, ...] = ()) -> BaseParameters:
    """Return the base parameters of a robot's motors and ``sensors``, found once."""
    return base_parameters(model_of(robot), sensors=sensors)


@dataclass(frozen=True, eq=False)
class Dataset:
    """All runs of an experiment, read and reduced, with the priors, before any estimation.

    ``priors`` are those of standard or base parameters, by name; with the inertias of the robot's file among them,
    ``prior_inertias`` is their relative standard deviation, else 0.
    """

    robot: Robot
    model: InverseDynamics
    base: BaseParameters
    preparation: Preparation
    prepared: tuple[PreparedRun, ...]
    factors: tuple[Factors, ...]
    priors: Mapping[str, Prior] = field(default_factory=dict)
    prior_inertias: float = 0.0

    @property
    def stated_priors(self) -> Mapping[str, Prior]:
        """The priors without the inertias of the robot's file."""
        of_file = inertia_priors(self.robot, self.prior_inertias) if self.prior_inertias else {}
        return {name: prior for name, prior in self.priors.items() if of_file.get(name) != prior}

    @property
    def runs(self) -> tuple[Run, ...]:
        """The runs, their joints in the model's order."""
        return tuple(each.run for each in self.prepared)

    @cached_property
    def temperatures(self) -> Temperatures | None:
        """Differences of the joints from their mean temperatures, where these are logged."""
        return temperatures_of(self.prepared, self.edges)

    @cached_property
    def places(self) -> tuple[Place, ...]:
        """Place of each run among those that repeat its motion."""
        return find_places(self.prepared)

    @cached_property
    def edges(self) -> tuple[np.ndarray, ...]:
        """Edges of the blocks of each run, as shares of its samples, (BLOCKS + 1,)."""
        return aligned_edges(self.prepared, self.places)

    @cached_property
    def _windows(self) -> dict[int, Windows]:
        return {}

    def windows(self, pieces: int = 1) -> Windows:
        """Cut the middle of every run into windows; see :func:`gtau.estimation.regression.windows.central_windows`."""
        if pieces not in self._windows:
            self._windows[pieces] = central_windows(self.prepared, pieces)
        return self._windows[pieces]

    @property
    def notes(self) -> tuple[Finding, ...]:
        """Notes on implausible parts of the robot, and on repairs and omissions in each run."""
        runs = (note.of_source(each.run.name) for each in self.prepared for note in (*each.run.notes, *each.notes))
        of_robot = robot_notes(self.robot, loaded=any(run.payload for run in self.runs))
        return (*of_robot, *runs)

    def system(
        self, friction: Friction = PAPER, delays: bool = True, payloads: Sequence[Payload | None] | None = None
    ) -> System:
        """Assemble the estimation problem with this friction, without delays if so wanted, or with other payloads."""
        payloads = [run.payload for run in self.runs] if payloads is None else payloads
        slowest = 0.5 / (2 * np.pi * self.preparation.bandwidth) if delays else 0.0
        return assemble_system(
            self.model,
            self.base,
            self.factors,
            payloads,
            slowest,
            friction,
            self.runs[0].channels,
            self.priors,
            None if self.temperatures is None else self.temperatures.of_blocks,
            [each.group for each in self.places],
        )

    def reduced(
        self,
        loads: Sequence[np.ndarray | None] | None = None,
        progress: Progress = silent,
        weigh: Sequence[tuple[np.ndarray, np.ndarray]] | None = None,
        along: Sequence[SampleWindow] | None = None,
    ) -> Dataset:
        """Reduce the same runs with the torques of ``loads`` (one a run) in load-dependent friction.

        ``weigh`` (one a run) reweights the rows; see :func:`reduce_run`. The motions are those of ``along``, if
        given, but distances to singularities stay those of the measured ones.
        """
        factors: list[Factors] = []
        begun, total = 0, sum(map(len, self.prepared))
        runs: Sequence[PreparedRun | SampleWindow] = self.prepared if along is None else along

        def advance(samples: int) -> None:
            progress("model along the runs", begun + samples, total)

        for k, each in enumerate(runs):
            advance(0)
            decimator = self.preparation.at(each.run.rate).decimator
            load, weights = None if loads is None else loads[k], None if weigh is None else weigh[k]
            factor = reduce_run(
                self.model, self.base.standard, each, decimator, load, weights, advance, edges=self.edges[k]
            )
            factors.append(factor if along is None else replace(factor, distances=self.factors[k].distances))
            begun += len(each)
        advance(0)
        return self.with_factors(factors)

    def with_factors(self, factors: Sequence[Factors]) -> Dataset:
        """Take other factors of the same runs, cut at the same rows."""
        other = replace(self, factors=tuple(factors))
        kept = ("places", "edges", "_windows")
        other.__dict__.update({name: self.__dict__[name] for name in kept if name in self.__dict__})
        return other


def robot_notes(robot: Robot, loaded: bool) -> list[Finding]:
    """Note implausible parts of a robot's description, and, where ``loaded``, the body assumed to carry payloads."""
    found = oddities(robot) + (tool_note(robot) if loaded else ())
    return [Finding(F.ROBOT, values={"what": note}, source=f"robot '{robot.name}'") for note in found]


def at_rate_of(runs: Sequence[Run], preparation: Preparation) -> Preparation:
    """Adapt a preparation chosen for other runs to the sampling rate of these."""
    return preparation.at(min(run.rate for run in runs))


def reduce_runs(
    robot: Robot,
    runs: Sequence[Run],
    preparation: Preparation | None = None,
    decimator: Literal["fir", "chebyshev"] = "fir",
    progress: Progress = silent,
    priors: Mapping[str, Prior] | None = None,
    prior_inertias: float = 0.0,
) -> Dataset:
    """Prepare all runs and reduce them to triangular factors.

    ``priors`` are those of parameters; see :class:`Dataset`.

    Raises
    ------
    GtauError
        Where a run does not suit the robot, or the robot's loops cannot be closed along it; where runs have wrenches on
        different bodies, or one that the robot lacks, or a payload beyond a sensor that already measures it.
    """
    model = model_of(robot)
    runs = tuple(run.ordered(model.actuated) for run in runs)
    if len({run.kind for run in runs}) > 1:
        raise GtauError("some runs hold currents and others torques; identify them separately.")
    if len({run.wrenches for run in runs}) > 1:
        raise GtauError("the runs have wrenches on different bodies; give the same 'wrenches' for all runs.")
    for run in runs:
        check_wrenches(robot, run)
    preparation = preparation or choose_preparation(runs, decimator)
    progress("base parameters", 0, 1)
    base = base_of(robot, sensors_of(robot, runs))
    prepared = prepare_runs(model, runs, preparation)
    dataset = Dataset(robot, model, base, preparation, prepared, (), priors or {}, prior_inertias)
    return dataset.reduced(progress=progress)


def sensors_of(robot: Robot, runs: Sequence[Run]) -> tuple[str, ...]:
    """List the joints with a sensor behind the drive, the same in all runs, in the order of its channels.

    The sensor of joint j measures the torque of row j of the model without the terms of its drive: rotor
    inertia, friction of motor and gear, and the offset of the current. It has an offset of its own. The parameters of
    the links are the same, so they carry the scale of the sensor to all drive gains.

    Raises
    ------
    GtauError
        Where runs differ in their sensors, or a motor drives a sensor's joint through a coupling.
    """
    behind = [[each for each in run.channels if each.kind.link_side] for run in runs]
    for run, own in zip(runs, behind, strict=True):
        for kind in dict.fromkeys(each.kind for each in (*behind[0], *own)):
            first, other = ([each.joint for each in of if each.kind == kind] for of in (behind[0], own))
            if other != first:
                raise GtauError(
                    f"runs '{runs[0].name}' and '{run.name}' have {kind.group} at other joints "
                    f"({', '.join(first) or 'none'}; {', '.join(other) or 'none'}); give '{kind.calibration}' for the "
                    "same joints in all runs."
                )
    coupled = {name for each in robot.couplings for name in (each.joint, *dict(each.ratios))}
    for each in behind[0]:
        if each.joint in coupled:
            raise GtauError(
                f"joint '{each.joint}' has a {each.kind.name}, but couplings of robot '{robot.name}' share it between "
                f"motors, so that no motor's torque is that of the joint; remove it from '{each.kind.calibration}'."
            )
        if each.name in robot.bodies:
            raise GtauError(
                f"joint '{each.name}' has the name of a {each.kind.name} of '{each.joint}'; rename the joint."
            )
    return runs[0].sensors


def check_wrenches(robot: Robot, run: Run) -> None:
    """Check that the wrenches of a run act on bodies of the robot, and include no stated payload.

    Raises
    ------
    GtauError
        A body is unknown, or the payload sits on a body whose wrench is measured.
    """
    if run.payload is not None and robot.tool in [frame.body for frame in run.wrenches]:
        raise GtauError(
            f"run '{run.name}': the payload '{run.payload.name}' is on '{robot.tool}', whose wrench is measured: "
            "the sensor feels it already; remove the 'payload', or the sensor from 'wrenches'."
        )
    bodies = [body for body in robot.bodies if body not in robot.base]
    for frame in run.wrenches:
        if frame.body not in (*bodies, robot.floating):
            close = get_close_matches(frame.body, bodies, n=1)
            hint = f" (did you mean '{close[0]}'?)" if close else ""
            raise GtauError(
                f"'wrenches' names the body '{frame.body}', but a body of robot '{robot.name}' has the name of its "
                f"joint: {', '.join(bodies)}; write the joint that moves it{hint}, and, with 'axes: "
                "body', 'at' in that joint's frame."
            )


def prepare_runs(model: InverseDynamics, runs: Sequence[Run], preparation: Preparation) -> tuple[PreparedRun, ...]:
    """Prepare runs with joints in the model's order.

    Raises
    ------
    GtauError
        Where nothing moves in a run, or its log is shorter than its filters.
    """
    ratios = motor_to_joint_speed(model)
    return tuple(within_limits(model.robot, prepare(run, preparation.at(run.rate), ratios)) for run in runs)


def motor_to_joint_speed(model: InverseDynamics) -> np.ndarray:
    """Compute speeds (n_y, n) of the joints that each motor drives, through couplings too, for their friction.

    The ratios do not change along a run. With closures each motor drives only its own joint.
    """
    n, robot = len(model.actuated), model.robot
    without_friction = [robot.actuated.index(joint) for joint in robot.base]
    if not robot.couplings or robot.closures:
        ratios = np.eye(n)
    else:
        still = np.zeros((n, 1))
        ratios = model.motion(still, still, still).J[:, :, 0]
    ratios[:, without_friction] = 0.0
    return ratios
