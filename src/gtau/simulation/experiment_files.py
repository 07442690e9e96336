"""Logs of a simulated robot and their experiment file, ready for ``gtau identify``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from os.path import relpath
from pathlib import Path
from typing import Any

import numpy as np

from gtau.documents.files import folder_of, write_atomically
from gtau.documents.validation import FUNCTION, PATH, takes
from gtau.documents.yaml_document import yaml_text
from gtau.errors import GtauError
from gtau.estimation.friction.law import FrictionLaw
from gtau.estimation.results.model_file import load
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.progress import Progress, silent
from gtau.robots.floating import refuse_floating
from gtau.robots.parameter import Parameter, parameter_of
from gtau.robots.readers.native import native_text
from gtau.robots.robot import Robot
from gtau.signals.reading.statements import Payload
from gtau.simulation.closed_loop import Engine, Hardware, Simulated, close_loop, hardware, pid, sample, write_log
from gtau.simulation.joint_friction import STATED, JointFriction, identified_friction
from gtau.simulation.mujoco_plant import MujocoPlant
from gtau.simulation.plant import Plant
from gtau.simulation.simulation_file import SimulatedRun, Simulation, as_simulation, check_joints
from gtau.simulation.trajectories import check_positions, log_column, make_trajectory

HELD = 10  # samples after which the controller updates its inertia matrix


def loaded(chi: Mapping[str, float], robot: Robot, payload: Payload | None) -> dict[str, float]:
    """Add a payload to the standard parameters of the body that carries it."""
    added = {} if payload is None else {"m": payload.mass or 0.0, **payload.parameters}
    names = {Parameter(kind, robot.tool): value for kind, value in added.items()}
    return {**chi, **{name: chi.get(name, 0.0) + value for name, value in names.items()}}


def truth(simulation: Simulation, model: InverseDynamics) -> tuple[dict[str, float], JointFriction]:
    """Return the standard parameters of the simulated robot, and its friction."""
    smoothing = simulation.friction_width.model_dump()
    if simulation.model is not None:
        result = load(simulation.model)
        if native_text(result.robot) != native_text(model.robot):
            raise GtauError(
                f"{simulation.model} was identified with another robot than '{simulation.robot}', or with a robot that "
                "its experiment file corrected; name the same robot file."
            )
        return identified_friction(result, smoothing)
    values = dict(simulation.parameters)
    curves = simulation.curves.items()
    stated = {Parameter("width", joint): curve.width for joint, curve in curves}
    stated |= {Parameter("vs", joint): curve.speed for joint, curve in curves}
    shapes = {name: value for name, value in stated.items() if value}
    friction = JointFriction(FrictionLaw(model, {}, shapes), values, smoothing)
    return {name: value for name, value in values.items() if parameter_of(name).kind not in STATED}, friction


def apparatus(
    simulation: Simulation, model: InverseDynamics, payload: Payload | None
) -> tuple[Engine, Plant, Hardware]:
    """Make the engine that moves the robot with its payload, gtau's plant, and the drives and sensors."""
    parameters, friction = truth(simulation, model)
    chi = loaded(parameters, model.robot, payload)
    plant = Plant(model, chi, friction)
    engine = plant if simulation.engine == "gtau" else MujocoPlant(model, chi, friction)
    return engine, plant, hardware(model.actuated, simulation.drives)


def make_run(
    simulation: Simulation,
    model: InverseDynamics,
    described: SimulatedRun,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Simulated:
    """Simulate a run under PID with velocity feedforward and the robot's true inertia matrix."""
    motion, duration = make_trajectory(described.trajectory, model.robot, f"run '{described.name}'")
    reference = sample(motion, duration, simulation.rate)
    engine, plant, parts = apparatus(simulation, model, described.payload)

    def label(sample: int) -> str:
        return f"{reference.time[sample]:.3f} s of run '{described.name}'"

    c = model.motion(reference.q.T, reference.qd.T, reference.qdd.T, label).c
    for row, joint in enumerate(model.robot.joints):  # passive joints too
        check_positions(c[row], joint, f"run '{described.name}'")
    inertia = np.stack([plant.mass_matrix(pose) for pose in c.T[::HELD]]).repeat(HELD, axis=0)[: c.shape[1]]
    controller = pid(reference, inertia, parts.gain, simulation.bandwidth)
    rng = np.random.default_rng([simulation.seed, *described.name.encode()])
    simulated = close_loop(described.name, engine, controller, parts, rng, model.actuated, progress)
    return replace(simulated, run=replace(simulated.run, payload=described.payload))


@takes(out=PATH, progress=FUNCTION)
def simulate(
    source: str | Path | Simulation | Mapping[str, Any], out: str | Path, progress: Progress = silent
) -> tuple[Path, ...]:
    """Simulate the runs of a simulation file and write their logs and ``experiment.yaml`` to a folder.

    Parameters
    ----------
    source : path, Simulation or mapping
        Simulation file, its parsed content, or a mapping with its keys; paths in a mapping are relative to the working
        directory.
    out : path
        Output folder, created if missing.
    progress : callable, optional
        Called as the work proceeds.

    Returns
    -------
    tuple of Path
        The files written, the experiment file last.

    Raises
    ------
    GtauError
        If the file is wrong, a run cannot be simulated, or a file cannot be written.
    KeyboardInterrupt
        If interrupted; the text lists the finished logs.
    """
    simulation, out = as_simulation(source), folder_of(out)
    robot = load_robot(simulation.robot)
    refuse_floating(robot, "simulation is")
    check_joints(simulation, robot, source if isinstance(source, (str, Path)) else "simulation")
    model = InverseDynamics(robot)
    described = (*simulation.runs, *simulation.validation)
    for run in described:  # report errors before the first simulation
        make_trajectory(run.trajectory, robot, f"run '{run.name}'")
    written: list[Path] = []
    experiment = out / "experiment.yaml"
    experiment.unlink(missing_ok=True)  # it would refer to a mix of new and old logs
    try:
        for run in described:
            simulated = make_run(simulation, model, run, partial(progress, run.name))
            write_log(simulated.run, out / f"{run.name}.csv")
            written.append(out / f"{run.name}.csv")
    except KeyboardInterrupt:
        finished = ", ".join(log.name for log in written) or "none"
        raise KeyboardInterrupt(
            f"logs finished in {out}: {finished}, of {len(described)}; experiment.yaml has not been written"
        ) from None
    write_atomically(experiment, experiment_text(simulation, robot, out))
    return (*written, experiment)


def experiment_text(simulation: Simulation, robot: Robot, out: Path) -> str:
    """Compose the experiment file of a simulation from the contents of its logs and the prior gains."""
    file, joints = Path(simulation.robot), robot.actuated
    position, current = ({joint: log_column(letter, joint) for joint in joints} for letter in "qv")
    document: dict[str, Any] = {
        "robot": relpath(file, out) if file.is_file() else simulation.robot,
        "signals": {"time": "t", "position": position, "current": current},
        "prior_gains": {joint: simulation.prior_gains[joint] for joint in joints if simulation.prior_gains},
        "runs": [_listed(run) for run in simulation.runs],
        "validation": [_listed(run) for run in simulation.validation],
    }
    text = yaml_text({key: value for key, value in document.items() if value})
    return f"# Written by 'gtau simulate'. Paths are relative to this file.\n{text}"


def _listed(run: SimulatedRun) -> dict[str, Any]:
    stated = None if run.payload is None else run.payload.model_dump(exclude_defaults=True)
    payload = {"name": stated["name"]} if stated and run.weigh else stated
    return {"log": f"{run.name}.csv", **({"payload": payload} if payload else {})}
