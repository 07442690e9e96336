"""All runs of an experiment, read and reduced to factors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.regression.assembly import (
    ColumnBlock,
    PayloadColumns,
    Temperatures,
    assemble_problem,
    column_blocks,
    column_map,
    is_transmitted,
    payload_columns,
    require_base_wrench,
    require_rows,
    temperatures_of,
    unexcited,
)
from gtau.estimation.regression.bandwidth_trials import best_of_trials
from gtau.estimation.regression.factors import KNOWN, Factors, reduce_rows
from gtau.estimation.regression.plausibility import check_wrenches, prepare_runs, sensors_of
from gtau.estimation.regression.priors import ReferenceModel, inertia_priors, known_equations, scale_of_file
from gtau.estimation.regression.problem import MotorEquation, Problem, longest_delay
from gtau.estimation.regression.rows import Rows, stream_rows
from gtau.estimation.regression.run_blocks import BLOCKS, PreparedRuns, Windows, block_of
from gtau.findings import Finding, Grade, Progress, silent
from gtau.model.base_parameters import BaseParameters, Equations
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.lengths import VariableTorques
from gtau.model.singularities import singular_distances
from gtau.robots.geometry import oddities, tool_note
from gtau.robots.parameter import BY_LOAD, Parameter
from gtau.robots.robot import INERTIAL, Robot
from gtau.signals.preparation.bandwidth import choose_preparation
from gtau.signals.preparation.filters import Preparation
from gtau.signals.preparation.prepared_run import PreparedRun, SampleWindow
from gtau.signals.reading.statements import Payload, Prior
from gtau.signals.run import Run
from gtau.signals.storage import Store


@dataclass(frozen=True, eq=False)
class Dataset:
    """All runs of an experiment, read and reduced, with the priors, before any estimation.

    ``priors`` constrain standard or base parameters, by name; with the inertias of the robot's file among them, or
    where these give the scale, ``prior_inertias`` is their relative standard deviation, else 0. ``reference`` is a
    model of the same robot whose parameters count as known with their covariance. ``motors`` are what voltages say,
    with ``remarks`` on others.
    """

    equations: Equations
    preparation: Preparation
    prepared: PreparedRuns
    factors: tuple[Factors, ...] = ()
    priors: Mapping[str, Prior] = field(default_factory=dict)
    prior_inertias: float = 0.0
    reference: ReferenceModel | None = None
    motors: tuple[MotorEquation, ...] = ()
    remarks: tuple[Finding, ...] = ()

    @property
    def model(self) -> InverseDynamics:
        """The robot's model."""
        return self.equations.model

    @property
    def base(self) -> BaseParameters:
        """Base parameters of motors and torque sensors together."""
        return self.equations.base

    @property
    def robot(self) -> Robot:
        """The robot of the model."""
        return self.model.robot

    @property
    def stated_priors(self) -> Mapping[str, Prior]:
        """The priors without the inertias of the robot's file."""
        file_priors = inertia_priors(self.robot, self.prior_inertias) if self.prior_inertias else {}
        return {name: prior for name, prior in self.priors.items() if file_priors.get(name) != prior}

    @property
    def scaled_by_file(self) -> bool:
        """Whether the inertias of the robot's file give the scale alone."""
        return self.prior_inertias > 0 and len(self.priors) == len(self.stated_priors)

    @property
    def runs(self) -> tuple[Run, ...]:
        """The runs, their joints in the model's order."""
        return tuple(prepared.run for prepared in self.prepared)

    @cached_property
    def temperatures(self) -> Temperatures | None:
        """Differences of the joints from their mean temperatures, where these are logged."""
        return temperatures_of(self.prepared)

    def windows(self, pieces: int = 1) -> Windows:
        """Cut the middle of every run into windows; see :meth:`.run_blocks.PreparedRuns.windows`."""
        return self.prepared.windows(pieces)

    @cached_property
    def variable(self) -> VariableTorques:
        """Torques of the base columns, and of a payload's, as functions of the robot's lengths."""
        payload = (Parameter(kind, self.robot.tool) for kind in INERTIAL)
        names = (name for name in payload if name in self.model.parameter_names)
        return VariableTorques(self.model, tuple(dict.fromkeys((*self.base.standard, *names))))

    @cached_property
    def travels(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest positions of the joints in the middles of all runs, (n,) each."""
        q = [window.q for _, window in self.windows()]
        return np.min([part.min(axis=0) for part in q], axis=0), np.max([part.max(axis=0) for part in q], axis=0)

    @cached_property
    def rms_accelerations(self) -> np.ndarray:
        """Rms accelerations of the joints over all runs (n,), rad/s2 or m/s2; 1 of a joint that rests."""
        windows = [window for _, window in self.windows()]
        squares = np.sum([np.sum(window.qdd**2, axis=0) for window in windows], axis=0)
        rms = np.sqrt(squares / sum(map(len, windows)))
        return np.where(rms > 0, rms, 1.0)

    @property
    def notes(self) -> tuple[Finding, ...]:
        """Notes on implausible parts of the robot, and on repairs and omissions in each run."""
        notes = robot_notes(self.robot, loaded=any(run.payload for run in self.runs))
        for prepared in self.prepared:
            notes += [note.from_source(prepared.run.name) for note in (*prepared.run.notes, *prepared.notes)]
        return (*notes, *self.remarks)

    def system(
        self,
        terms: tuple[Parameter, ...] = (),
        per_run: bool = False,
        delays: bool | np.ndarray = True,
        payloads: Sequence[Payload | None] | None = None,
    ) -> System:
        """Assemble the estimation problem; raises GtauError.

        ``terms`` are friction beyond the paper's (viscous and Coulomb friction and an offset), which may
        drift between runs if ``per_run``. ``delays`` marks the channels (c,) whose delay is estimated, or all or none.
        ``payloads`` replace the payloads of the runs.
        """
        model, base, measured = self.model, self.base, self.runs[0].channels
        channels = [channel for channel in measured if channel.kind.modelled]
        given = dict.fromkeys(channel.joint for channel in measured if not channel.kind.modelled)
        given.pop(self.robot.floating, None)
        payloads = [run.payload for run in self.runs] if payloads is None else payloads
        payload_blocks = payload_columns(model, base, payloads)
        effects = column_blocks(base, channels, payload_blocks, terms, len(self.runs) if per_run else 1)
        require_base_wrench(model, self.factors)
        longest = longest_delay(self.preparation.bandwidth) * np.asarray(delays)
        warm = None if self.temperatures is None else self.temperatures.by_block
        plain = assemble_problem(effects, channels, self.factors, longest, warm, self.prepared.places[0].tolist())
        if self.reference is None:  # which says what a joint at rest does not
            require_rows(plain)
        known = [known_equations(base, model.parameter_names, plain.parameters, self.priors)]
        if self.scaled_by_file:
            known.append(scale_of_file(model, base, plain, self.prior_inertias))
        if self.reference is not None:
            known.append(self.reference.among(plain.parameters))
        joints = [channel.joint for channel in channels]
        volts = [(joints.index(motor.joint), 1 / motor.ke, motor.ke**2 / motor.std) for motor in self.motors]
        voltages = np.reshape(volts, (-1, 3))
        problem = replace(
            plain, known=np.vstack(known), voltages=voltages, wrenches=tuple(given), factored=plain.triangles
        )
        return System(self, problem.without(unexcited(problem)), problem, effects, payload_blocks, terms)

    def reduced(
        self,
        loads: Sequence[np.ndarray | None] | None = None,
        progress: Progress = silent,
        weigh: Sequence[tuple[np.ndarray, np.ndarray]] | None = None,
        along: Sequence[SampleWindow] | None = None,
    ) -> Dataset:
        """Reduce the same runs with the torques of ``loads`` (one a run) in load-dependent friction.

        ``weigh`` (one a run) reweights the rows; see :func:`reduce_rows`. The motions come from ``along``, if
        given. Distances to singularities are those of the first reduction, along the measured motions.
        """
        factors, begun, total = list[Factors](), 0, sum(map(len, self.prepared))
        columns = self.base.standard
        runs: Sequence[PreparedRun | SampleWindow] = self.prepared if along is None else along
        regressor = self.model.columns(columns)
        near = None if self.factors else singular_distances(self.model)

        def counted(rows: Iterator[Rows], blocks: np.ndarray, samples: int, distances: Store) -> Iterator[Rows]:
            for part in rows:
                if near is not None:
                    distances.append(near(part.motion).T)
                done = begun + samples * int(blocks[part.outputs.stop - 1]) // BLOCKS
                progress("model along the runs", done, total)
                yield part

        for k, run in enumerate(runs):
            decimator = self.preparation.at(run.run.rate).decimator
            blocks = block_of(self.prepared.edges[k], decimator.outputs(len(run)))
            rows = stream_rows(self.model, regressor, run, decimator, loads[k] if loads else None)
            weights = weigh[k] if weigh else None
            distances = Store((2,), np.float32)
            rows = counted(rows, blocks, len(run), distances)
            factor = reduce_rows(self.model, columns, run.run.channels, rows, blocks, weights)
            measured = distances.array() if near else self.factors[k].distances
            factors.append(replace(factor, distances=measured))
            begun += len(run)
        progress("model along the runs", total, total)
        return replace(self, factors=tuple(factors))


@dataclass(frozen=True, eq=False)
class System:
    """Problem of a dataset; ``unreduced`` has also parameters that these motions do not separate from others."""

    dataset: Dataset
    problem: Problem
    unreduced: Problem
    effects: tuple[ColumnBlock, ...]
    payloads: tuple[PayloadColumns, ...]
    terms: tuple[Parameter, ...]

    @property
    def unexcited(self) -> tuple[Parameter, ...]:
        """Parameters of ``unreduced`` that are not identifiable."""
        return tuple(name for name in self.unreduced.parameters if name not in self.problem.parameters)

    @property
    def always_carried(self) -> dict[str, str]:
        """Parameters of a payload that the robot's hold too, as no run is without payload: kind to run."""
        loads = {name: self.dataset.runs[load.run].name for load in self.payloads for name in load.unknown}
        always = all(run.payload is not None for run in self.dataset.runs)
        return {name.kind: loads[name] for name in self.unexcited if always and name in loads}

    @property
    def stated(self) -> tuple[str, ...]:
        """Names of the parameters with a prior value."""
        return tuple(name for name, prior in self.dataset.priors.items() if prior.value is not None)

    @cached_property
    def _filled(self) -> np.ndarray:
        return np.concatenate([factor.rows for factor in self.dataset.factors]).sum(axis=1) > 0

    @property
    def block_positions(self) -> np.ndarray:
        """Numbers of the problem's blocks' runs, and times from their beginning (0) to their end (1), (U, 2)."""
        rows = [len(factor.rows) for factor in self.dataset.factors]
        return np.array([(run, (s + 0.5) / n) for run, n in enumerate(rows) for s in range(n)])[self._filled]

    @property
    def wrench_columns(self) -> np.ndarray | None:
        """Part of measured wrenches in the problem's column ``known``, (U, c, p); None without wrenches."""
        parts = [factor.R[..., KNOWN] for factor in self.dataset.factors]
        return np.concatenate(parts)[self._filled] if self.unreduced.wrenches else None

    def again(
        self,
        dataset: Dataset | None = None,
        terms: tuple[Parameter, ...] | None = None,
        payloads: Sequence[Payload | None] | None = None,
        delays: np.ndarray | None = None,
    ) -> System:
        """Assemble the same effects for another dataset, with other friction terms, payloads or delayed channels."""
        per_run = any(name.run is not None for name in self.unreduced.parameters)
        terms = self.terms if terms is None else terms
        delays = self.unreduced.longest_delays > 0 if delays is None else delays
        return (dataset or self.dataset).system(terms, per_run, delays, payloads)

    def map(self, run: int, above: np.ndarray | None = None) -> np.ndarray:
        """Map a run's factors to the columns of ``unreduced`` (c, p, .), at temperatures ``above`` (n,) the means."""
        if above is None:
            return self._maps[run]
        channels = self.unreduced.channels
        return np.stack([column_map(self.effects, run, channel, above[channel.row]) for channel in channels])

    @cached_property
    def _maps(self) -> list[np.ndarray]:
        runs = range(len(self.dataset.factors))
        warm = self.dataset.temperatures
        still = np.zeros(len(self.dataset.model.actuated))
        return [self.map(run, still if warm is None else warm.by_block[run].mean(axis=0)) for run in runs]

    def full(self, theta: np.ndarray) -> np.ndarray:
        """Extend parameters of the problem to all of ``unreduced`` and a 1 for the known column, (n_theta + 1,)."""
        values = np.zeros(len(self.unreduced.parameters))
        values[self.unreduced.unknowns.at(self.problem.parameters)] = theta
        return np.append(values, 1.0)

    def motion(self, run: int, theta: np.ndarray) -> np.ndarray:
        """Return the base columns' values in ``run``, with its payload and its own friction, (n_b,)."""
        base, joints = self.dataset.base, self.unreduced.joints
        joint_maps = self.map(run)[: len(joints), : base.count, : KNOWN + 1] @ self.full(theta)
        rows = [joints.index(name.body) if name.body in joints else 0 for name in base.standard]  # of their friction
        return np.asarray(joint_maps[rows, np.arange(len(rows))])

    def load(self, run: int, theta: np.ndarray) -> np.ndarray:
        """Return the base columns' values in ``run`` that joints transmit: with payload, without friction, (n_b,)."""
        return self.motion(run, theta) * is_transmitted(self.dataset.base.names)

    def loads(self, theta: np.ndarray) -> list[np.ndarray | None]:
        """Return :meth:`load` of each run, None where no friction depends on it."""
        loaded = any(term.kind in BY_LOAD for term in self.terms)
        return [self.load(run, theta) if loaded else None for run in range(len(self.dataset.factors))]


def robot_notes(robot: Robot, loaded: bool) -> list[Finding]:
    """Note implausible parts of a robot's description, and, where ``loaded``, the body assumed to carry payloads."""
    notes = (*oddities(robot), *(tool_note(robot) if loaded else ()))
    source = f"robot '{robot.name}'"
    return [Finding("robot description", text=note, grade=Grade.INFORMATION, source=source) for note in notes]


def preparation_of(
    equations: Equations, runs: Sequence[Run], decimator: Literal["fir", "chebyshev"] = "fir"
) -> Preparation:
    """Choose the preparation of runs by their spectra, and by trials along the robot's equations; raises GtauError."""
    if decimator == "chebyshev":
        return choose_preparation(runs, decimator)
    runs = [run.ordered(equations.model.actuated) for run in runs]
    return choose_preparation(runs, decimator, lambda chosen: best_of_trials(equations, runs, chosen))


def reduce_runs(
    robot: Robot,
    runs: Sequence[Run],
    preparation: Preparation | None = None,
    decimator: Literal["fir", "chebyshev"] = "fir",
    progress: Progress = silent,
    model: InverseDynamics | None = None,
) -> Dataset:
    """Prepare all runs and reduce them to triangular factors; raises GtauError."""
    model = model or InverseDynamics(robot)
    runs = tuple(run.ordered(model.actuated) for run in runs)
    if len({run.kind for run in runs}) > 1:
        raise GtauError("some runs hold currents and others torques; identify them separately.")
    if len({run.wrenches for run in runs}) > 1:
        raise GtauError("the runs have wrenches on different bodies; give the same 'wrenches' for all runs.")
    for run in runs:
        check_wrenches(robot, run)
    progress("base parameters", 0, 1)
    equations = Equations(model, sensors_of(robot, runs))
    preparation = preparation or preparation_of(equations, runs, decimator)
    return Dataset(equations, preparation, prepare_runs(model, runs, preparation), ()).reduced(progress=progress)
