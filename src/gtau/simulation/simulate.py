"""Simulation files (robot, parameters, drives, sensors, runs), and the logs and experiment file made from them."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from os.path import relpath
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, FiniteFloat, field_validator, model_validator

from gtau.documents.files import SIMULATION, folder_of, refuse_other_kind, write_atomically
from gtau.documents.markup import Document, read_yaml, yaml_text
from gtau.documents.validation import FUNCTION, PATH, Keys, Positive, expect, takes, validate
from gtau.errors import GtauError
from gtau.estimation.friction.law import FrictionLaw
from gtau.estimation.results.model_file import load
from gtau.findings import Progress, silent
from gtau.model.equations import parameter_names
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.geometry import massless, refuse_floating
from gtau.robots.parameter import Parameter, kinds_where, parameter_of
from gtau.robots.readers.native import native_text
from gtau.robots.robot import DAMPING, INERTIAL, Robot
from gtau.signals.channel import SideValues
from gtau.signals.reading.experiment import RobotName
from gtau.signals.reading.statements import CarriedPayload, Payload
from gtau.signals.run import Log, Run
from gtau.simulation import closed_loop, trajectories
from gtau.simulation.closed_loop import Logged, Supply
from gtau.simulation.joint_friction import STATED, WIDTH, JointFriction, identified_friction
from gtau.simulation.mujoco_plant import MujocoPlant
from gtau.simulation.plant import Plant

ELECTRICAL = (
    *("resistance", "inductance", "warming", "convention", "commutation", "dead_time", "duty_quantum"),
    "proportional_gain",
)
"""Keys of motors on a supply."""
HEAVY = kinds_where(lambda kind: kind.nonnegative and "kg" in kind.units[0])
RUBBING = (*kinds_where(lambda kind: kind.nonnegative and kind.friction), DAMPING)
HELD = 10  # samples after which the controller updates its inertia matrix
NAME = r"\w[\w.-]*"


class SimulatedRun(Keys):
    """A run to simulate; with ``weigh: true``, the experiment file does not contain the mass of the payload."""

    name: str
    trajectory: trajectories.MotionEntry
    payload: CarriedPayload = None
    weigh: bool = False

    @field_validator("name")
    @classmethod
    def _file_name(cls, name: str) -> str:
        if not re.fullmatch(NAME, name, re.ASCII):
            raise ValueError(f"'{name}' names a log; write it with letters, digits, '.', '_' and '-'")
        return name

    @model_validator(mode="after")
    def _payload_has_a_mass(self) -> SimulatedRun:
        if self.payload is not None and self.payload.mass is None:
            raise ValueError(f"the payload '{self.payload.name}' has no mass; a simulation needs it")
        if self.weigh and self.payload is None:
            raise ValueError("'weigh' is given without 'payload'; add a payload or remove it")
        return self


class Friction(Keys):
    """Ranges of speed in which Coulomb friction changes its sign, m/s and rad/s."""

    prismatic: Positive = WIDTH["prismatic"]
    revolute: Positive = WIDTH["revolute"]


class FrictionEntry(Keys):
    """Shape of a joint's friction, see :class:`gtau.estimation.friction.law.FrictionLaw`; rad or m, rad/s or m/s."""

    width: Positive | None = None
    speed: Positive | None = None

    @model_validator(mode="after")
    def _says_something(self) -> FrictionEntry:
        if self.width is None and self.speed is None:
            raise ValueError("neither 'width' nor 'speed' is given; add one, or remove the curve")
        return self


class Simulation(Keys):
    """Content of a simulation file, whose paths are relative to the file.

    The robot has the ``parameters`` and the friction of ``curves``, or an identified ``model``. Motors on a ``supply``
    have voltages, which bound their currents; side signals of them are in the ``logs``, of ``log_rate`` (Hz).
    ``control`` lists trajectories for the comparison of control laws, without logs.
    """

    robot: RobotName
    engine: Literal["gtau", "mujoco"] = "gtau"
    model: trajectories.Existing | None = None
    parameters: dict[str, FiniteFloat] = Field(default_factory=dict)
    curves: dict[str, FrictionEntry] = Field(default_factory=dict)
    drives: dict[str, closed_loop.JointHardware] = Field(min_length=1)
    supply: Supply | None = None
    logs: tuple[Logged, ...] = ()
    friction_width: Friction = Friction()
    rate: Annotated[FiniteFloat, Field(ge=50, le=20000)] = 1000.0
    log_rate: Positive | None = None
    bandwidth: Positive = Field(
        default_factory=lambda fields: min(closed_loop.BANDWIDTH, fields.get("rate", 1000.0) / 5)
    )
    seed: Annotated[int, Field(ge=0)] = 0
    prior_gains: trajectories.PerJoint = Field(default_factory=dict)
    runs: tuple[SimulatedRun, ...] = Field(min_length=1)
    validation: tuple[SimulatedRun, ...] = ()
    control: tuple[SimulatedRun, ...] = ()

    def __repr__(self) -> str:
        return f"Simulation({self.robot!r}, runs: {', '.join(run.name for run in self.runs)})"

    @field_validator("parameters")
    @classmethod
    def _bodies_can_be(cls, parameters: dict[str, float]) -> dict[str, float]:
        for name, value in parameters.items():
            parameter = parameter_of(name)
            kind, rest = parameter.kind, Parameter("fs", parameter.body)
            if kind in HEAVY and value < 0:
                raise ValueError(f"'{name}' is negative, which no mass or inertia is; write 0 or more")
            if kind in RUBBING and value < 0:
                raise ValueError(f"the friction '{name}' is negative, and would drive the robot; write 0 or more")
            if kind == "fb" and parameters.get(rest, 0.0) + value < 0:
                raise ValueError(
                    f"the friction at rest, '{rest}' + '{name}', is negative, and would drive the robot; "
                    "write 0 or more"
                )
        return parameters

    @model_validator(mode="after")
    def _model_or_parameters(self) -> Simulation:
        if self.model is not None and (self.parameters or self.curves):
            raise ValueError(
                "'model' states all parameters and friction; remove 'parameters' and 'curves', or the model"
            )
        for joint, curve in self.curves.items():
            if curve.speed and not self.parameters.get(f"fb_{joint}"):
                raise ValueError(
                    f"the 'speed' of '{joint}' has no effect without friction that falls with it; add 'fb_{joint}' to "
                    "'parameters', or remove 'speed'"
                )
        return self

    @model_validator(mode="after")
    def _electrical(self) -> Simulation:
        stated = {joint: drive.model_dump(exclude_defaults=True) for joint, drive in self.drives.items()}
        idle = [f"'{key}' of '{joint}' is given" for joint in stated for key in ELECTRICAL if key in stated[joint]]
        if self.supply is None and (what := [*(f"'{key}' is logged" for key in self.logs), *idle]):
            raise ValueError(f"{what[0]} without a supply; add 'supply: {{voltage: ...}}', or remove it")
        if lacking := [joint for joint, drive in self.drives.items() if self.supply and drive.resistance is None]:
            raise ValueError(f"the motor of '{lacking[0]}' has no 'resistance', which a supply needs; add its ohms")
        if self.every != self.rate / (self.log_rate or self.rate):
            raise ValueError(f"a log_rate of {self.log_rate:g} Hz is no part of the rate, {self.rate:g} Hz")
        return self

    @property
    def every(self) -> int:
        """Samples of the controller for one in the log."""
        return round(self.rate / (self.log_rate or self.rate))

    @model_validator(mode="after")
    def _names_once(self) -> Simulation:
        names = [run.name for run in (*self.runs, *self.validation, *self.control)]
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise ValueError(f"two runs are called '{twice}'; give every run a different name")
        if self.bandwidth > self.rate / 5:
            raise ValueError(
                f"a bandwidth of {self.bandwidth:g} rad/s is impossible at a rate of {self.rate:g} Hz; write at most "
                f"{self.rate / 5:g}"
            )
        return self


def read_simulation(path: str | Path) -> Simulation:
    """Read a simulation file."""
    refuse_other_kind(path, SIMULATION)
    return validate(Simulation, read_yaml(path), context=Path(path).parent)


def check_joints(simulation: Simulation, robot: Robot, path: str | Path) -> None:
    """Check that drives and prior gains belong to the robot's actuated joints; raises GtauError."""
    trajectories.require_joints(simulation.drives, robot, f"{path}, drives")
    if simulation.prior_gains:
        trajectories.require_joints(simulation.prior_gains, robot, f"{path}, prior_gains")


def parameters_of(simulation: Simulation, robot: Robot) -> dict[str, float]:
    """Return the stated parameters, with the inertias of the robot's file where these state none; raises GtauError."""
    stated, names = simulation.parameters, parameter_names(robot)
    if any(parameter_of(name).kind in INERTIAL for name in stated):
        return dict(stated)
    file = {name: value for name, value in robot.inertias.items() if name in names}  # without the ground's
    if not (light := massless(robot, file)):
        return file | stated
    if not stated:
        raise GtauError(
            f"the robot has no parameters, as the file of '{robot.name}' has no mass and inertia of "
            f"{', '.join(light)}; give 'parameters', or a 'model' of 'gtau identify'."
        )
    return dict(stated)


def _truth(simulation: Simulation, model: InverseDynamics) -> tuple[dict[str, float], JointFriction]:
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
    values, shapes = parameters_of(simulation, model.robot), dict[Parameter, float]()
    for joint, curve in simulation.curves.items():
        stated = {Parameter("width", joint): curve.width, Parameter("vs", joint): curve.speed}
        shapes |= {name: value for name, value in stated.items() if value}
    friction = JointFriction(FrictionLaw(model, {}, shapes), values, smoothing)
    return {name: value for name, value in values.items() if parameter_of(name).kind not in STATED}, friction


def apparatus(
    simulation: Simulation, model: InverseDynamics, payload: Payload | None
) -> tuple[Plant | MujocoPlant, Plant, closed_loop.Hardware]:
    """Make the engine that moves the robot with its payload, gtau's plant, and the drives and sensors."""
    chi, friction = _truth(simulation, model)
    if payload is not None:
        for kind, value in {"m": payload.mass or 0.0, **payload.parameters}.items():
            name = Parameter(kind, model.robot.tool)
            chi[name] = chi.get(name, 0.0) + value
    plant = Plant(model, chi, friction)
    engine = plant if simulation.engine == "gtau" else MujocoPlant(model, chi, friction)
    return engine, plant, closed_loop.hardware(model.actuated, simulation.drives, simulation.supply, simulation.seed)


def make_run(
    simulation: Simulation,
    model: InverseDynamics,
    described: SimulatedRun,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> closed_loop.Simulated:
    """Simulate a run under PID with velocity feedforward and the robot's true inertia matrix."""
    motion, duration = trajectories.make_trajectory(described.trajectory, model.robot, f"run '{described.name}'")
    reference = closed_loop.sample(motion, duration, simulation.rate)
    engine, plant, parts = apparatus(simulation, model, described.payload)

    def label(sample: int) -> str:
        return f"{reference.time[sample]:.3f} s of run '{described.name}'"

    c = model.motion(reference.q.T, reference.qd.T, reference.qdd.T, label).c
    for row, joint in enumerate(model.robot.joints):  # passive joints too
        trajectories.check_positions(c[row], joint, f"run '{described.name}'")
    inertia = np.stack([plant.mass_matrix(pose) for pose in c.T[::HELD]]).repeat(HELD, axis=0)[: c.shape[1]]
    if np.linalg.eigvalsh(inertia + inertia.transpose(0, 2, 1)).min() <= 0:
        raise GtauError(
            f"run '{described.name}': the inertia matrix is not positive definite along the motion, so the masses and "
            "inertias are of no rigid bodies; 'gtau robot ROBOT --verbose' lists those that have an effect."
        )
    controller = closed_loop.pid(reference, inertia, parts.keys["gain"], simulation.bandwidth)
    rng = np.random.default_rng([simulation.seed, *described.name.encode()])
    simulated = closed_loop.close_loop(described.name, engine, controller, parts, rng, model.actuated, progress)
    run, logged = simulated.run, slice(None, None, simulation.every)
    time, side = run.time[logged], dict[str, SideValues]()
    for key in simulation.logs:
        columns = {joint: values[logged] for joint, values in run.side[key].by_joint.items()}
        side[key] = SideValues(time, columns, run.side[key].unit)
    run = Run(run.name, run.joints, time, run.position[logged], run.command[logged], log=Log(side=side))
    return replace(simulated, run=replace(run, payload=described.payload))


@takes(out=PATH, progress=FUNCTION)
def simulate(
    source: str | Path | Simulation | Mapping[str, Any], out: str | Path, progress: Progress | None = None
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

    Examples
    --------
    >>> [file.name for file in gtau.simulate("simulation.yaml", "simulated")]
    ['free.csv', 'experiment.yaml']
    """
    name = source if isinstance(source, (str, Path)) else "simulation"
    if isinstance(source, (str, Path)):
        source = read_simulation(source)
    if not isinstance(source, Simulation):
        expect("a simulation", source, ("the path of a simulation file, or a mapping with its keys", (Mapping,)))
        source = validate(Simulation, Document("simulation", source), context=Path())
    simulation, out = source, folder_of(out)
    robot = load_robot(simulation.robot)
    refuse_floating(robot, "simulation is")
    check_joints(simulation, robot, name)
    model = InverseDynamics(robot)
    described = (*simulation.runs, *simulation.validation)
    for run in described:  # report errors before the first simulation
        trajectories.make_trajectory(run.trajectory, robot, f"run '{run.name}'")
    written: list[Path] = []
    experiment = out / "experiment.yaml"
    experiment.unlink(missing_ok=True)  # it would refer to a mix of new and old logs
    try:
        for run in described:
            simulated = make_run(simulation, model, run, partial(progress or silent, run.name))
            log = out / f"{run.name}.csv"
            closed_loop.write_log(simulated.run, log)
            written.append(log)
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
    letters = {"position": "q", "current": "v"} | {key: f"{key}_" for key in simulation.logs}
    if "supply_current" in simulation.logs:  # in place of the motor's
        del letters["current"]
    signals = {
        key: {joint: trajectories.log_column(letter, joint) for joint in joints} for key, letter in letters.items()
    }
    servos = {joint: simulation.drives[joint].proportional_gain for joint in joints if "goal" in simulation.logs}
    electrical = {"convention", "commutation"}
    drives = {joint: simulation.drives[joint].model_dump(include=electrical) for joint in joints if simulation.logs}
    document: dict[str, Any] = {
        "robot": relpath(file, out) if file.is_file() else simulation.robot,
        "signals": {"time": "t", **signals, **({"proportional_gain": servos} if servos else {})},
        "drives": {joint: {key: value for key, value in drive.items() if value} for joint, drive in drives.items()},
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
