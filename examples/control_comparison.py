"""Comparison of the five control strategies of the paper's Table 4, on the same robot and trajectories."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.experiment_runs import read_runs
from gtau.estimation.regression.assembly import known_values
from gtau.findings import Progress
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.loops import Motion
from gtau.result import Result, identify
from gtau.robots.geometry import refuse_floating
from gtau.robots.parameter import Parameter
from gtau.signals.reading.experiment import check_robot, read_experiment
from gtau.signals.reading.statements import Payload
from gtau.simulation.closed_loop import (
    BANDWIDTH,
    Controller,
    Reference,
    Simulated,
    close_loop,
    pid,
    sample,
)
from gtau.simulation.simulate import Simulation, apparatus, check_joints, read_simulation
from gtau.simulation.trajectories import make_trajectory
from gtau.uses.prediction import torques_along

ERROR_ON_GAINS = 1.25  # the paper's 25 % on the manufacturer's gains
STRATEGIES = (
    "simple PID",
    "advanced PID",
    "CTC with manufacturer's gains",
    "CTC with identified gains",
    "CTC with error on gains",
)


@dataclass(frozen=True, eq=False)
class Tracking:
    """Tracking error of a strategy on a trajectory: ``maximum`` and ``rms`` (n,), means over the repetitions.

    ``error`` (N, n) is the first repetition's; rad or m, ``time`` (N,) in s.
    """

    trajectory: str
    strategy: str
    maximum: np.ndarray
    rms: np.ndarray
    time: np.ndarray
    error: np.ndarray


@dataclass(frozen=True, eq=False)
class ControlComparison:
    """Tracking of every strategy on every trajectory, with the ``references`` by trajectory and the models by gains."""

    joints: tuple[str, ...]
    units: tuple[str, ...]
    tracking: tuple[Tracking, ...]
    references: Mapping[str, Reference]
    models: Mapping[str, Result]


def models_of_gains(experiment: str | Path, identified: Mapping[str, float], progress: Progress) -> dict[str, Result]:
    """Identify models by WLS with the manufacturer's, the identified and the wrong gains: by strategy.

    Raises
    ------
    GtauError
        Where the experiment file is wrong or lacks ``prior_gains``.
    """
    described = read_experiment(experiment)
    robot = load_robot(described.robot)
    check_robot(described, robot)
    if not described.expected_gains:
        raise GtauError(f"{experiment} has no 'prior_gains', the manufacturer's; add them to compare control laws.")
    runs = [run for run in read_runs(described, described.runs) if run.payload is None or run.payload.mass is not None]
    wrong = {joint: ERROR_ON_GAINS * gain for joint, gain in described.expected_gains.items()}
    gains = zip(STRATEGIES[2:], (described.expected_gains, identified, wrong), strict=True)
    return {name: identify(robot, runs, method="wls", prior_gains=each, progress=progress) for name, each in gains}


def compare_control(
    simulation_file: str | Path,
    experiment: str | Path,
    progress: Progress,
    identified: Mapping[str, float] | None = None,
    repetitions: int = 2,
) -> ControlComparison:
    """Run the five strategies on the ``control`` trajectories of a simulation file (paper, Table 4).

    Parameters
    ----------
    simulation_file : path
        The robot, its true parameters, drives and sensors, and the trajectories.
    experiment : path
        Logs of that robot and the manufacturer's gains, from which each computed torque's model is identified.
    progress : callable
        Called as the work goes on.
    identified : mapping, optional
        Joint to identified gain; by maximum likelihood from the experiment if left out.
    repetitions : int
        Number of runs of every trajectory; the paper's Table 4 holds means of two.

    Raises
    ------
    GtauError
        Where a file is wrong, or the control loop diverges.
    """
    simulation = read_simulation(simulation_file)
    robot = load_robot(simulation.robot)
    refuse_floating(robot, "the comparison of control laws is")
    check_joints(simulation, robot, simulation_file)
    if not simulation.control:
        raise GtauError(f"{simulation_file} has no trajectories under 'control'; list one or more to compare laws on.")
    if identified is None:
        found = identify(experiment, progress=progress)
        identified = {joint: gain.value or 0.0 for joint, gain in found.drive_gains.items()}
    models = models_of_gains(experiment, identified, progress)
    model = InverseDynamics(robot)
    references, tracking = {}, []
    total = len(simulation.control) * len(STRATEGIES) * repetitions
    for number, described in enumerate(simulation.control):
        motion, duration = make_trajectory(described.trajectory, robot, f"control '{described.name}'")
        reference = references[described.name] = sample(motion, duration, simulation.rate)
        engine, _, parts = apparatus(simulation, model, described.payload)
        laws = controllers(reference, models, described.payload, simulation)
        for place, (strategy, law) in enumerate(laws.items()):
            made: list[Simulated] = []
            for repetition in range(repetitions):
                done = (number * len(STRATEGIES) + place) * repetitions + repetition
                progress("control laws", done, total)
                rng = np.random.default_rng([simulation.seed, number, repetition])
                made.append(close_loop(strategy, engine, law, parts, rng, robot.actuated))
            errors = [np.abs(each.error) for each in made]
            maximum = np.mean([each.max(axis=0) for each in errors], axis=0)
            rms = np.mean([np.sqrt(np.mean(each**2, axis=0)) for each in errors], axis=0)
            tracking.append(Tracking(described.name, strategy, maximum, rms, reference.time, made[0].error))
    progress("control laws", total, total)
    units = tuple(robot.joint(joint).unit for joint in robot.actuated)
    return ControlComparison(robot.actuated, units, tuple(tracking), references, models)


def controllers(
    reference: Reference, models: Mapping[str, Result], payload: Payload | None, simulation: Simulation
) -> dict[str, Controller]:
    """Make the five laws, by strategy; the PIDs are tuned by the manufacturer's model at the start of the motion."""
    computed = {
        name: computed_torque(reference, model, payload, simulation.bandwidth) for name, model in models.items()
    }
    known = computed[STRATEGIES[2]]
    inertia = np.diag(np.diag(known.inertia[0]))  # each axis for itself
    pids = {
        name: pid(reference, inertia, known.gains, simulation.bandwidth, weight)
        for name, weight in zip(STRATEGIES, (0.0, 1.0), strict=False)
    }
    return pids | computed


def computed_torque(
    reference: Reference, result: Result, payload: Payload | None = None, bandwidth: float = BANDWIDTH
) -> Controller:
    """Make a computed torque law of an identified model, evaluated along the reference, and that model's gains.

    The known parameters of a ``payload`` go into the model as they are.
    """
    model, n = result.idm, len(result.idm.actuated)
    chi = model_parameters(result, payload)
    regressor = model.columns(result.base.standard)

    def torques(motion: Motion, parameters: np.ndarray = chi) -> np.ndarray:
        return regressor.torques(regressor(model.layout, motion), parameters, n)

    motion = model.motion(reference.q.T, reference.qd.T, reference.qdd.T)
    feedforward = torques_along(result, motion, chi)
    rest = replace(motion, yd=np.zeros_like(motion.yd), ydd=np.zeros_like(motion.ydd))
    weight = torques(rest)
    columns = [torques(replace(rest, ydd=np.ascontiguousarray(motion.J[:, k]))) - weight for k in range(n)]
    inertia = np.stack(columns, axis=2).swapaxes(0, 1)
    gains = np.array([result.drive_gains[joint].value for joint in model.actuated], dtype=float)
    return Controller(reference, inertia, feedforward.T, gains, 1.0, bandwidth)


def model_parameters(result: Result, payload: Payload | None) -> np.ndarray:
    """Return the base parameters (n_b,) of the identified robot with the known parameters of its payload."""
    model, base = result.idm, result.base
    chi = np.array([result.parameters[name].value or 0.0 for name in base.names])
    if payload is not None:
        place = {name: k for k, name in enumerate(model.parameter_names)}
        for kind, value in {**result.payload_values.get(payload.name, {}), **known_values(payload)}.items():
            chi = chi + value * base.matrix[:, place[Parameter(kind, model.robot.tool)]]
    return chi
